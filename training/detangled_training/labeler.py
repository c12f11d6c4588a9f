"""The labelers: radius, wavelength and twist prevalence of a strand from its kappa, tau and v.

Paper section "Inferencing texture parameters". A bidirectional LSTM with attention tells the twist prevalence; a
transformer encoder tells the torsion that characterises the lower section, from channels that say where twists disturb
it least; the curvature that characterises it is that of low frequencies; the helix equations give the rest. Beyond the
paper both networks also see the strand as it lies in the world, whose curls no straightening has stretched; and the
encoder tells where each of the two counts, and a factor on the curvature.

Bahdanau et al. 2016 (attention), Vaswani et al. 2017 (encoder), Xiong et al. 2020 (normalisation before each layer).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from detangled.labeling import CELLS, LOWER_PART, WORLD
from detangled_training.recurrence import BidirectionalLSTM

# Low frequencies of curvature: a Gaussian of a sixteenth of the length.
LOW_PASS_CELLS = CELLS / 16
# A cell counts less, the further it is from the low frequencies: so many of the mean distance halve its weight. Each
# pass leaves out what the one before found.
SPREAD = 0.1
PASSES = 3
LOWER_FROM = CELLS - round(LOWER_PART * CELLS)

SMALL_ANGLE = 0.05  # [rad] that a cell bends or twists by, from where on its logarithm counts
TYPICAL_CELL = 0.08  # [cm]
LEAST_RATE = 1e-3  # [1/cm]: hair that bends less is straight
# Disturbances below this part of a signal count alike: a weight must not turn on the sign of what is next to nothing.
ROUNDED = 0.1
LEAST_SIZE = 1e-5  # [1/cm]
# Logarithms of how much less a cell above the lower section counts: in torsion to begin with, in curvature always.
UPPER, NEVER = -3.0, -30.0
CHANNELS = 5 + 2 * WORLD  # of the encoder: the paper's, and of the world each signal with its low frequencies
LEAST_TORSION = 0.02  # of the curvature, so that a torsion of zero has a logarithm


@dataclass(frozen=True)
class LabelerSizes:
    """Sizes of the networks. Cells go into the LSTM and the encoder several at a time."""

    lstm_width: int = 128
    lstm_cells: int = 2
    encoder_width: int = 256
    encoder_cells: int = 4
    layers: int = 2
    heads: int = 4
    feed_forward: int = 512
    dropout: float = 0.1


class Labels(NamedTuple):
    """Of each signal (B,): radius, wavelength [cm], twist (T_f), and the curvature and torsion [1/cm] behind them."""

    radius: Tensor
    wavelength: Tensor
    twist: Tensor
    kappa: Tensor
    tau: Tensor


class Labeler(nn.Module):
    """Both networks, and what needs no network."""

    def __init__(self, sizes: LabelerSizes | None = None) -> None:
        super().__init__()
        self.sizes = sizes or LabelerSizes()
        self.twist = TwistNetwork(self.sizes)
        self.helix = HelixNetwork(self.sizes)
        self.low_pass: Tensor
        self.register_buffer("low_pass", gaussian_matrix(CELLS, LOW_PASS_CELLS), persistent=False)

    def forward(self, signals: Tensor) -> Labels:
        """Labels of signals (B, CELLS, 5): kappa, tau [1/cm] and v [cm per t], and kappa and tau in the world.

        Of (B, CELLS, 3) as well: the strand lies as it does in canonical space.
        """
        if signals.shape[2] == 3:
            signals = in_canonical_space(signals)
        return self.knowing(signals, self.twist(signals))

    def knowing(self, signals: Tensor, twist: Tensor) -> Labels:
        """Labels of signals (B, CELLS, 5) whose twist prevalence (B,) is known."""
        kappa, tau = self.helix(signals, twist, self.low_pass)
        total = kappa**2 + tau**2
        return Labels(kappa / total, 2.0 * math.pi * tau / total, twist, kappa, tau)


def in_canonical_space(signals: Tensor) -> Tensor:
    """Signals (B, L, 5) of strands (B, L, 3 or 5) that lie in the world as they do in canonical space."""
    return torch.cat([signals[:, :, :3], signals[:, :, :WORLD]], dim=2)


class TwistNetwork(nn.Module):
    """T_f (B,) of signals (B, CELLS, 5)."""

    def __init__(self, sizes: LabelerSizes) -> None:
        super().__init__()
        self.cells = sizes.lstm_cells
        width = 2 * sizes.lstm_width
        self.lstm = BidirectionalLSTM((3 + WORLD) * sizes.lstm_cells, sizes.lstm_width)
        self.attention = nn.Sequential(nn.Linear(width, sizes.lstm_width), nn.Tanh(), nn.Linear(sizes.lstm_width, 1))
        self.head = _head(width, (128, 64), sizes.dropout)

    def forward(self, signals: Tensor) -> Tensor:
        width = signals[:, :, 2:3] / CELLS  # [cm] of a cell
        angles, in_world = (torch.asinh(x * width / SMALL_ANGLE) for x in (signals[:, :, :2], signals[:, :, 3:]))
        x = torch.cat([angles, torch.log(width / TYPICAL_CELL), in_world], dim=2)
        hidden = self.lstm(x.reshape(x.shape[0], -1, (3 + WORLD) * self.cells))
        share = torch.softmax(self.attention(hidden), dim=1)
        return torch.sigmoid(self.head((share * hidden).sum(dim=1)))[:, 0]


class HelixNetwork(nn.Module):
    """The characteristic curvature and torsion (B,) [1/cm]: a mean of each over places, times a factor.

    The encoder says both: how much each place counts in either mean, and by its mean pooling and the last layers the
    factors. To begin with curvature is the mean of its low frequencies over the lower section, torsion that over the
    places which twists disturb least; in the world both are means over such places.
    """

    def __init__(self, sizes: LabelerSizes) -> None:
        super().__init__()
        self.cells = sizes.encoder_cells
        self.embed = nn.Linear(CHANNELS * sizes.encoder_cells, sizes.encoder_width)
        self.place = nn.Parameter(0.02 * torch.randn(CELLS // sizes.encoder_cells, sizes.encoder_width))
        self.layers = nn.ModuleList(EncoderLayer(sizes) for _ in range(sizes.layers))
        self.norm = nn.LayerNorm(sizes.encoder_width)
        self.share = nn.Linear(sizes.encoder_width, 4)
        self.kappa_factor = _head(sizes.encoder_width, (256, 128), sizes.dropout)
        self.tau_factor = _head(sizes.encoder_width, (256, 128), sizes.dropout)
        for last in (self.share, self.kappa_factor[-1], self.tau_factor[-1]):
            assert isinstance(last, nn.Linear)
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)

    def forward(self, signals: Tensor, twist: Tensor, low_pass: Tensor) -> tuple[Tensor, Tensor]:
        bend = bends(signals[:, :, 0], low_pass)
        tau = signals[:, :, 1]
        weighted = tau * bend.weight
        low = undisturbed(tau, low_pass)
        clear = _weight(_size(tau - low, tau))
        world = signals[:, :, 3], signals[:, :, 4]
        world_low = [undisturbed(x, low_pass) for x in world]
        world_clear = [_weight(_size(x - own, x)) for x, own in zip(world, world_low, strict=True)]
        scale = bend.kappa[:, None]
        # Torsion is told of either hand alike: as if the lower section were right-handed.
        hand = torch.where(low[:, LOWER_FROM:].mean(dim=1) < 0.0, -1.0, 1.0)[:, None]
        channels = (
            bend.curvature / scale,
            bend.low / scale,
            torch.asinh(hand * tau / scale),
            torch.asinh(hand * weighted / scale),
            twist[:, None].expand_as(tau),
            world[0] / scale,
            world_low[0] / scale,
            torch.asinh(hand * world[1] / scale),
            torch.asinh(hand * world_low[1] / scale),
        )
        x = torch.stack(channels, dim=2)
        x = self.embed(x.reshape(x.shape[0], -1, CHANNELS * self.cells)) + self.place
        for layer in self.layers:
            x = layer(x)
        x = self.norm(x)
        said = [share.expand(-1, -1, self.cells).reshape(x.shape[0], CELLS) for share in self.share(x).split(1, dim=2)]
        lower = torch.arange(CELLS, device=x.device) >= LOWER_FROM
        in_world = torch.log(world_clear[0]) + torch.log(world_clear[1])
        counts = (said[0], said[1] + in_world)
        kappa = _mean_of_both((bend.low, world[0]), counts, torch.where(lower, 0.0, NEVER)).clamp_min(LEAST_RATE)
        counts = (said[2] + torch.log(clear), said[3] + in_world)
        plain = _mean_of_both((tau, world[1]), counts, torch.where(lower, 0.0, UPPER))
        tau = torch.sqrt(plain**2 + (LEAST_TORSION * kappa) ** 2)
        mean = x.mean(dim=1)
        return kappa * torch.exp(self.kappa_factor(mean)[:, 0]), tau * torch.exp(self.tau_factor(mean)[:, 0])


class EncoderLayer(nn.Module):
    """Self-attention and two linear maps over tokens (B, N, C), each on what is normalised, and added."""

    def __init__(self, sizes: LabelerSizes) -> None:
        super().__init__()
        width = sizes.encoder_width
        self.heads = sizes.heads
        self.before_attention, self.before_forward = nn.LayerNorm(width), nn.LayerNorm(width)
        self.query_key_value = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.widen, self.narrow = nn.Linear(width, sizes.feed_forward), nn.Linear(sizes.feed_forward, width)
        self.dropout = nn.Dropout(sizes.dropout)

    def forward(self, x: Tensor) -> Tensor:
        batch, tokens, width = x.shape
        parts = self.query_key_value(self.before_attention(x)).view(batch, tokens, 3 * self.heads, -1).transpose(1, 2)
        query, key, value = parts.split(self.heads, dim=1)
        scores = torch.matmul(query * (width // self.heads) ** -0.5, key.transpose(2, 3))
        seen = torch.matmul(torch.softmax(scores, dim=-1), value).transpose(1, 2).reshape(batch, tokens, width)
        x = x + self.dropout(self.out(seen))
        return x + self.dropout(self.narrow(functional.relu(self.widen(self.before_forward(x)))))


class Bends(NamedTuple):
    """Curvature [1/cm] of signals: itself, its low frequencies, and how little each cell is disturbed, (B, L) each.

    kappa: (B,), what characterises the lower section.
    """

    curvature: Tensor
    low: Tensor
    weight: Tensor
    kappa: Tensor


def bends(curvature: Tensor, low_pass: Tensor) -> Bends:
    """What curvature (B, L) says of where twists are, and the curvature that characterises the lower section."""
    low = undisturbed(curvature, low_pass)
    kappa = low[:, LOWER_FROM:].mean(dim=1).clamp_min(LEAST_RATE)
    # A twist is where the difference changes suddenly.
    change = functional.pad(curvature - low, (1, 1))
    change = _size(change[:, :-2] + change[:, 2:] - 2.0 * change[:, 1:-1], curvature)
    return Bends(curvature, low, _weight(change), kappa)


def undisturbed(x: Tensor, low_pass: Tensor) -> Tensor:
    """The low frequencies (B, L) of a signal (B, L), of its cells that twists disturb least."""
    weight = torch.ones_like(x)
    for _ in range(PASSES):
        low = torch.matmul(x * weight, low_pass) / torch.matmul(weight, low_pass)
        weight = _weight(_size(x - low, x))
    return torch.matmul(x * weight, low_pass) / torch.matmul(weight, low_pass)


def _mean_of_both(signals: tuple[Tensor, Tensor], counts: tuple[Tensor, Tensor], place: Tensor) -> Tensor:
    """The mean (B,) of two signals (B, L), each cell counting by logarithms: of its own, and of its place (L,)."""
    shares = torch.softmax(torch.cat([count + place for count in counts], dim=1), dim=1)
    return (shares * torch.cat(signals, dim=1)).sum(dim=1)


def _size(x: Tensor, of: Tensor) -> Tensor:
    """Magnitudes (B, L), smooth where they are next to nothing beside a signal (B, L)."""
    least = ROUNDED * of.abs().mean(dim=1, keepdim=True) + LEAST_SIZE
    return torch.sqrt(x * x + least * least)


def _weight(disturbance: Tensor) -> Tensor:
    """Weights (B, L), least where a disturbance (B, L) is greatest beside its mean."""
    return SPREAD / (disturbance / disturbance.mean(dim=1, keepdim=True) + SPREAD)


def gaussian_matrix(cells: int, deviation: float) -> Tensor:
    """A symmetric matrix (L, L) of Gaussian weights between cells; what is divided by the same of ones is a mean."""
    at = torch.arange(cells, dtype=torch.float64)
    return torch.exp(-0.5 * ((at[:, None] - at) / deviation) ** 2).float() / (deviation * math.sqrt(2.0 * math.pi))


def _head(given: int, widths: tuple[int, int], dropout: float) -> nn.Sequential:
    """Three fully connected layers, to one number."""
    first, second = widths
    return nn.Sequential(
        nn.Linear(given, first), nn.ReLU(), nn.Dropout(dropout),
        nn.Linear(first, second), nn.ReLU(), nn.Dropout(dropout),
        nn.Linear(second, 1),
    )  # fmt: skip
