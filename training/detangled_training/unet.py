"""The denoiser: a 1-D U-Net told the noise level, which predicts the clean signal. Paper, section Architecture.

Four stages of one residual block each go down by stride-two convolutions and up again beside them (Ronneberger et al.
2015), with Swish (Ramachandran et al. 2017), group normalisation (Wu and He 2018), and self-attention (Vaswani et al.
2017) at the third level and in the bottleneck. The log-SNR enters every residual block as a scale and a shift of its
channels (FiLM, Perez et al. 2018), and so does the texture asked for, where one is.

The network is written once, over layers that come in two kinds (``layers``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from detangled.models import CONDITION_NAMES
from detangled_training.layers import CONVOLUTIONS, Layers

CHANNELS = 3  # of a signal: whitened curvature, torsion, speed
CONDITIONS = len(CONDITION_NAMES)
WAVES = (1.0, 2.0)  # periods that the ramp's sinusoids make from root to tip, a sine and a cosine of each

# Sinusoids of the log-SNR turn between 10 radians a unit and 0.001: the schedule spans 20 units, and what should be
# predicted changes over about one.
FASTEST = 10.0
SLOWEST_PART = 1e-4


@dataclass(frozen=True)
class Architecture:
    """Sizes of a denoiser.

    channels: after each downsampling stage. attention: the level, from 0, with self-attention; the bottleneck has it
    too. embedding: numbers that tell a block the noise level and the texture. groups: of normalisation. heads: of
    attention.
    """

    channels: tuple[int, ...] = (64, 128, 256, 256)
    attention: int = 2
    embedding: int = 256
    groups: int = 8
    heads: int = 4

    def __post_init__(self) -> None:
        if not self.channels or min(*self.channels, self.embedding, self.groups, self.heads, 10**9) < 1:
            raise ValueError(f"sizes must be 1 or more: {self}")
        if not 0 <= self.attention < len(self.channels):
            raise ValueError(f"attention must be one of the {len(self.channels)} levels, not {self.attention}")
        if any(width % self.groups for width in self.channels):
            raise ValueError(f"channels {self.channels} must be multiples of the {self.groups} groups")
        if any(width % self.heads for width in (self.channels[self.attention], self.channels[-1])):
            raise ValueError(f"channels {self.channels} must be multiples of the {self.heads} heads, with attention")
        if self.embedding % 2:
            raise ValueError(f"embedding must be even, half sines and half cosines, not {self.embedding}")

    @property
    def multiple(self) -> int:
        """What a signal's number of cells must be a multiple of."""
        return int(2 ** len(self.channels))


class ResidualBlock(nn.Module):
    def __init__(self, given: int, made: int, sizes: Architecture, layers: Layers) -> None:
        super().__init__()
        self.swish = layers.swish
        self.norm_in = layers.normalization(given, sizes.groups)
        self.convolution_in = layers.convolution(given, made)
        self.norm_out = layers.normalization(made, sizes.groups)
        self.convolution_out = layers.convolution(made, made)
        self.around = layers.convolution(given, made, 1) if given != made else nn.Identity()
        nn.init.zeros_(self.convolution_out.weight)

    def forward(self, x: Tensor, film: Tensor) -> Tensor:
        """film: (B, 2 C), the scale of each channel and its shift."""
        scale, shift = film.chunk(2, 1)
        hidden = self.convolution_in(self.swish(self.norm_in(x)))
        made: Tensor = self.convolution_out(self.swish(self.norm_out(hidden, scale, shift)))
        return self.around(x) + made


class Attention(nn.Module):
    def __init__(self, channels: int, sizes: Architecture, layers: Layers) -> None:
        super().__init__()
        self.heads, self.attend = sizes.heads, layers.attend
        self.norm = layers.normalization(channels, sizes.groups)
        # Without a bias: softmax takes no notice of the keys', so its gradient is 0, and AdamW blows its rounding up.
        self.given = layers.convolution(channels, 3 * channels, 1, bias=False)
        self.made = layers.convolution(channels, channels, 1)
        nn.init.zeros_(self.made.weight)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.made(self.attend(self.given(self.norm(x)), self.heads))


class UNet(nn.Module):
    """The denoiser.

    layers: CONVOLUTIONS or MATRICES; the two have parameters of the same names, the latter's with their axes reversed.
    """

    def __init__(self, sizes: Architecture | None = None, layers: Layers = CONVOLUTIONS) -> None:
        super().__init__()
        self.sizes = sizes = sizes or Architecture()
        self.layers, self.swish = layers, layers.swish
        width = sizes.embedding
        self.noise_in, self.noise_out = layers.linear(width, width), layers.linear(width, width)
        self.condition_in, self.condition_out = layers.linear(2 * CONDITIONS, width), layers.linear(width, width)
        # All blocks' in one: a product this wide is summed in the same order by one thread and by two.
        self.film_sizes = [2 * made for made in (*sizes.channels, sizes.channels[-1], *reversed(sizes.channels))]
        self.film = layers.linear(width, sum(self.film_sizes))
        levels = list(zip((sizes.channels[0], *sizes.channels), sizes.channels, strict=False))
        self.stem = layers.convolution(CHANNELS + 1 + 2 * len(WAVES), sizes.channels[0])
        self.down = nn.ModuleList(ResidualBlock(given, made, sizes, layers) for given, made in levels)
        self.shrink = nn.ModuleList(layers.convolution(made, made, step="down") for _, made in levels)
        self.bottleneck = ResidualBlock(sizes.channels[-1], sizes.channels[-1], sizes, layers)
        above = (*sizes.channels[1:], sizes.channels[-1])
        self.grow = nn.ModuleList(
            layers.convolution(given, made, step="up") for given, made in zip(above, sizes.channels, strict=True)
        )
        self.up = nn.ModuleList(ResidualBlock(2 * made, made, sizes, layers) for made in sizes.channels)
        third = sizes.channels[sizes.attention]
        self.attention_down = Attention(third, sizes, layers)
        self.attention_bottleneck = Attention(sizes.channels[-1], sizes, layers)
        self.attention_up = Attention(third, sizes, layers)
        self.norm = layers.normalization(sizes.channels[0], sizes.groups)
        self.head = layers.convolution(sizes.channels[0], CHANNELS)
        nn.init.zeros_(self.head.weight)

    def forward(self, noisy: Tensor, log_snr: Tensor, position: Tensor, condition: Tensor, known: Tensor) -> Tensor:
        """Predict the clean signal (B, 3, L).

        noisy: (B, 3, L), whitened; L a multiple of ``sizes.multiple``. log_snr: (B,), log(alpha^2 / sigma^2).
        position: (B, L), 0 at the root to 1 at the tip: a crop of a strand is given its part of that.
        condition: (B, CONDITIONS), what ``CONDITION_NAMES`` says, logarithms of cm; known: of the same shape, 1 where
        that is asked for, 0 where it is not and the condition is ignored (it must be finite).
        """
        films = iter(self.film(self.swish(self._embed(log_snr, condition, known))).split(self.film_sizes, 1))
        x = torch.cat([noisy, _features(position)], dim=1)
        x = self.stem(self.layers.arrange(x))
        passed = []
        for level, (block, shrink) in enumerate(zip(self.down, self.shrink, strict=True)):
            x = block(x, next(films))
            if level == self.sizes.attention:
                x = self.attention_down(x)
            passed.append(x)
            x = shrink(x)
        x = self.attention_bottleneck(self.bottleneck(x, next(films)))
        for level, (grow, block) in reversed(list(enumerate(zip(self.grow, self.up, strict=True)))):
            x = block(torch.cat([grow(x), passed.pop()], dim=self.layers.channel_axis), next(films))
            if level == self.sizes.attention:
                x = self.attention_up(x)
        return self.layers.restore(self.head(self.swish(self.norm(x))))

    def _embed(self, log_snr: Tensor, condition: Tensor, known: Tensor) -> Tensor:
        half = self.sizes.embedding // 2
        rates = torch.tensor([FASTEST * SLOWEST_PART ** (k / half) for k in range(half)], device=log_snr.device)
        angles = log_snr[:, None] * rates
        noise = self.noise_out(self.swish(self.noise_in(torch.cat([angles.sin(), angles.cos()], dim=1))))
        asked = torch.cat([condition * known, known], dim=1)
        return noise + self.condition_out(self.swish(self.condition_in(asked)))


def _features(position: Tensor) -> Tensor:
    """The ramp (B, L) and its sinusoids, (B, 5, L)."""
    angles = [2.0 * math.pi * wave * position for wave in WAVES]
    return torch.stack([position, *(f(angle) for angle in angles for f in (torch.sin, torch.cos))], dim=1)
