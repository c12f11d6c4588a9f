"""The denoiser: a 1-D U-Net told the noise level, which predicts the clean signal. Paper, section Architecture.

Four stages of one residual block each go down by stride-two convolutions and up again beside them (Ronneberger et al.
2015), with Swish (Ramachandran et al. 2017), group normalisation (Wu and He 2018), and self-attention (Vaswani et al.
2017) at the third level and in the bottleneck. The log-SNR enters every residual block as a scale and a shift of its
channels (FiLM, Perez et al. 2018), and so does the texture asked for, where one is.

The network is written once, over layers that come in two kinds with the same parameters. ``CONVOLUTIONS`` are torch's
own, for training and for drawing strands; signals are (B, C, 1, L), since inference engines are fastest on images.
``MATRICES`` do the same by matrix products over windows of (B, L, C), with
gradients by hand, for the graphs that run without torch: nothing in them is left that an inference engine lacks.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

CHANNELS = 3  # of a signal: whitened curvature, torsion, speed
CONDITIONS = 4  # log radius, log wavelength, T_f, log length
WAVES = (1.0, 2.0)  # periods that the ramp's sinusoids make from root to tip, a sine and a cosine of each
WIDTH = 3  # cells that a convolution sees
NORM_EPSILON = 1e-5

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


class Convolution(nn.Module):
    """A convolution over (B, C, 1, L), padded with zeros; ``step`` "down" takes each second cell, "up" doubles them."""

    def __init__(self, given: int, made: int, width: int = WIDTH, step: str = "", bias: bool = True) -> None:
        super().__init__()
        self.width, self.step = width, step
        self.weight = nn.Parameter(self.stored(torch.empty(made, given, width)))
        self.bias = nn.Parameter(torch.zeros(made)) if bias else None
        nn.init.normal_(self.weight, std=1.0 / math.sqrt(given * width))

    def stored(self, weight: Tensor) -> Tensor:
        return weight

    def forward(self, x: Tensor) -> Tensor:
        if self.step == "up":
            x = functional.interpolate(x, scale_factor=(1.0, 2.0), mode="nearest")
        stride = (1, 2 if self.step == "down" else 1)
        return functional.conv2d(x, self.weight[:, :, None], self.bias, stride, (0, self.width // 2))


class Linear(nn.Module):
    """A linear map of the last axis."""

    def __init__(self, given: int, made: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(self.stored(torch.empty(made, given)))
        self.bias = nn.Parameter(torch.zeros(made))
        nn.init.normal_(self.weight, std=1.0 / math.sqrt(given))

    def stored(self, weight: Tensor) -> Tensor:
        return weight

    def forward(self, x: Tensor) -> Tensor:
        return functional.linear(x, self.weight, self.bias)


class Normalization(nn.Module):
    """Group normalisation, then a scale and a shift of each channel: its own, and those of a sample (B, C)."""

    def __init__(self, channels: int, groups: int) -> None:
        super().__init__()
        self.groups = groups
        self.weight = nn.Parameter(torch.ones(channels))
        self.bias = nn.Parameter(torch.zeros(channels))

    def forward(self, x: Tensor, scale: Tensor | None = None, shift: Tensor | None = None) -> Tensor:
        if scale is None or shift is None:
            return functional.group_norm(x, self.groups, self.weight, self.bias, NORM_EPSILON)
        x = functional.group_norm(x, self.groups, eps=NORM_EPSILON)
        return (
            x * (self.weight * (1.0 + scale))[:, :, None, None] + (self.bias * (1.0 + scale) + shift)[:, :, None, None]
        )


def attend(x: Tensor, heads: int) -> Tensor:
    """Self-attention of queries, keys and values (B, 3 C, 1, L): (B, C, 1, L)."""
    batch, channels, _, cells = x.shape
    width = channels // (3 * heads)
    query, key, value = x.view(batch, 3 * heads, width, cells).split(heads, 1)
    scores = torch.matmul((query * width**-0.5).transpose(2, 3), key)
    return torch.matmul(value, torch.softmax(scores, -1).transpose(2, 3)).reshape(batch, -1, 1, cells)


class _Convolve(torch.autograd.Function):
    """x (B, L, C) by weight (W, C, D): (B, L', D), as one matrix product over windows; so are both its gradients."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor | None, step: str) -> Tensor:
        windows = _windows(x, weight.shape[0], step)
        ctx.step, ctx.biased = step, bias is not None
        ctx.save_for_backward(windows, weight)
        return _product(windows, weight, bias)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        windows, weight = ctx.saved_tensors
        (gradient,) = gradients
        width, given, made = weight.shape
        rows = gradient.reshape(-1, made)
        by_weight = torch.mm(windows.reshape(-1, width * given).t(), rows).view(width, given, made)
        if width == 1:
            by_x = torch.mm(rows, weight[0].t()).view(*gradient.shape[:2], given)
        elif ctx.step == "down":
            # Cell 2 i was seen by window i alone, at its middle; cell 2 i + 1 by windows i and i + 1, at their ends.
            after = functional.pad(gradient, (0, 0, 0, 1))[:, 1:]
            even = torch.mm(rows, weight[1].t())
            odd = torch.mm(
                torch.cat([gradient, after], dim=2).view(-1, 2 * made), torch.cat([weight[2], weight[0]], dim=1).t()
            )
            by_x = torch.stack([even, odd], dim=1).view(gradient.shape[0], -1, given)
        else:
            seen = _windows(gradient, width, "").view(-1, width * made)
            row = torch.arange(given)[:, None] + given * torch.arange(width - 1, -1, -1)
            mirrored = weight.view(-1, made)[row].view(given, -1)  # its last tap first
            by_x = torch.mm(seen, mirrored.t()).view(*gradient.shape[:2], given)
            if ctx.step == "up":
                by_x = by_x.view(gradient.shape[0], -1, 2, given).sum(2)
        return by_x, by_weight, rows.sum(0) if ctx.biased else None, None


def _windows(x: Tensor, width: int, step: str) -> Tensor:
    """The cells each output cell sees, (B, L', W C), of x (B, L, C): zeros beyond the ends."""
    if width == 1:
        return x
    half = width // 2
    cells = x.shape[1]
    made = {"": cells, "down": cells // 2, "up": 2 * cells}[step]
    cell = torch.arange(made)[:, None] * (2 if step == "down" else 1) + torch.arange(width)
    if step == "up":
        cell = torch.div(cell + half, 2, rounding_mode="floor")
    return functional.pad(x, (0, 0, half, half))[:, cell].flatten(2)


def _product(windows: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    rows, matrix = windows.reshape(-1, windows.shape[2]), weight.reshape(-1, weight.shape[2])
    made = torch.mm(rows, matrix) if bias is None else torch.addmm(bias, rows, matrix)
    return made.view(windows.shape[0], -1, weight.shape[2])


class MatrixConvolution(Convolution):
    """The same over (B, L, C), its weight stored as (W, C, D)."""

    def stored(self, weight: Tensor) -> Tensor:
        return weight.permute(2, 1, 0).contiguous()

    def forward(self, x: Tensor) -> Tensor:
        if not torch.is_grad_enabled():
            return _product(_windows(x, self.width, self.step), self.weight, self.bias)
        return _Convolve.apply(x, self.weight, self.bias, self.step)


class MatrixLinear(Linear):
    """The same, its weight stored as (C, D)."""

    def stored(self, weight: Tensor) -> Tensor:
        return weight.t().contiguous()

    def forward(self, x: Tensor) -> Tensor:
        return torch.addmm(self.bias, x, self.weight)


class _Normalize(torch.autograd.Function):
    """x (B, L, C) to zero mean and unit variance in each group of channels, times scale (B, C), plus shift (B, C)."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, scale: Tensor, shift: Tensor, groups: int) -> Tensor:
        centred, deviation = _centred(x, groups)
        ctx.groups = groups
        ctx.save_for_backward(centred, deviation, scale)
        return centred * (scale / deviation)[:, None] + shift[:, None]

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        centred, deviation, scale = ctx.saved_tensors
        (gradient,) = gradients
        factor = scale / deviation
        by_shift = gradient.sum(1)
        by_factor = (gradient * centred).sum(1)
        cells = centred.shape[1]
        mean = _group_mean(factor * by_shift, ctx.groups) / cells
        slope = _group_mean(factor * by_factor, ctx.groups) / (cells * deviation * deviation)
        by_x = gradient * factor[:, None] - centred * slope[:, None] - mean[:, None]
        return by_x, by_factor / deviation, by_shift, None


def _group_mean(x: Tensor, groups: int) -> Tensor:
    """Means over each group's channels of x (B, C), at every channel."""
    width = x.shape[1] // groups
    member = (torch.arange(x.shape[1])[:, None] // width == torch.arange(groups)).float()
    return torch.mm(torch.mm(x, member / width), member.t())


def _centred(x: Tensor, groups: int) -> tuple[Tensor, Tensor]:
    """x (B, L, C) less its groups' means, and the deviation (B, C) of what is left."""
    centred = x - _group_mean(x.mean(1), groups)[:, None]
    return centred, torch.sqrt(_group_mean((centred * centred).mean(1), groups) + NORM_EPSILON)


class MatrixNormalization(Normalization):
    """The same over (B, L, C)."""

    def forward(self, x: Tensor, scale: Tensor | None = None, shift: Tensor | None = None) -> Tensor:
        if scale is not None and shift is not None:
            factor = self.weight * (1.0 + scale)
            term = self.bias * (1.0 + scale) + shift
        else:
            factor, term = self.weight.expand(x.shape[0], -1), self.bias.expand(x.shape[0], -1)
        if not torch.is_grad_enabled():
            centred, deviation = _centred(x, self.groups)
            return centred * (factor / deviation)[:, None] + term[:, None]
        return _Normalize.apply(x, factor, term, self.groups)


class _Swish(torch.autograd.Function):
    """x sigmoid(x), with no more passes over memory in its gradient than it needs."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        part = torch.sigmoid(x)
        made = x * part
        ctx.save_for_backward(part, made)
        return made

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        part, made = ctx.saved_tensors
        return gradients[0] * (part + made - made * part)


def matrix_swish(x: Tensor) -> Tensor:
    return _Swish.apply(x) if torch.is_grad_enabled() else x * torch.sigmoid(x)


def matrix_attend(x: Tensor, heads: int) -> Tensor:
    """Self-attention of queries, keys and values (B, L, 3 C): (B, L, C)."""
    batch, cells, channels = x.shape
    width = channels // (3 * heads)
    query, key, value = x.view(batch, cells, 3 * heads, width).transpose(1, 2).split(heads, 1)
    scores = torch.matmul(query * width**-0.5, key.transpose(2, 3))
    return torch.matmul(torch.softmax(scores, -1), value).transpose(1, 2).reshape(batch, cells, -1)


class Layers(NamedTuple):
    """What a network is built of: a kind of each layer, how signals (B, C, L) are arranged for it, and back."""

    convolution: Callable[..., Convolution]
    linear: Callable[[int, int], Linear]
    normalization: Callable[[int, int], Normalization]
    attend: Callable[[Tensor, int], Tensor]
    swish: Callable[[Tensor], Tensor]
    channel_axis: int
    arrange: Callable[[Tensor], Tensor]
    restore: Callable[[Tensor], Tensor]


CONVOLUTIONS = Layers(
    Convolution, Linear, Normalization, attend, functional.silu, 1, lambda x: x.unsqueeze(2), lambda x: x.squeeze(2)
)
MATRICES = Layers(
    MatrixConvolution,
    MatrixLinear,
    MatrixNormalization,
    matrix_attend,
    matrix_swish,
    2,
    lambda x: x.transpose(1, 2),
    lambda x: x.transpose(1, 2),
)


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
        condition: (B, 4), log radius, log wavelength [cm], T_f, log length; known: (B, 4), 1 where that is asked
        for, 0 where it is not and the condition is ignored (it must be finite).
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
