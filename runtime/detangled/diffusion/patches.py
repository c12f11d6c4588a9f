"""A denoiser in closed form from a handful of strands: no weights, no training.

The best prediction of the clean signal that may only look at a neighbourhood is, at each position, the mean of the
examples' values weighted by how well the patch around them explains the noisy patch (Kamb and Ganguli 2024, "An
analytic theory of creativity in convolutional diffusion models"): weights exp(-|x / alpha - y|^2 alpha^2 / (2
sigma^2)), wide patches at high noise, narrow ones at low noise. Distances between all patches of two strands are
running sums along their diagonals, so their cost does not depend on the patch's width.

A strand is made in stretches, each offered a few examples of its own, so that none can be copied from root to tip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import kernel, parallel_kernel, prange

NEGLIGIBLE = -30.0  # logarithm of a weight, relative to the largest, that changes nothing in float64


@dataclass(frozen=True)
class PatchSchedule:
    """Half-widths of patches, in cells, by noise level: geometric in sigma / alpha between two levels.

    widest, narrowest: half-widths at and beyond the two levels.
    high, low: noise levels sigma / alpha.
    window: how far, in cells, an example's position may lie from where the strand's own falls in it.
    """

    widest: int = 100
    narrowest: int = 12
    high: float = 4.0
    low: float = 0.1
    window: int = 24

    def half_width(self, alpha: float, sigma: float) -> int:
        """Half-width of the patches at this noise level."""
        level = np.log(max(sigma / alpha, 1e-12))
        part = np.clip((level - np.log(self.low)) / (np.log(self.high) - np.log(self.low)), 0.0, 1.0)
        return round(self.narrowest * (self.widest / self.narrowest) ** float(part))


@kernel
def _add_distances(
    x: NDArray[np.float64], y: NDArray[np.float64], i: int, j: int, sign: float, sums: NDArray[np.float64]
) -> None:
    """Add ``sign`` times the squared distance of cell i of x (3, L) to cells j, j + 1, ... of y (3, M) to ``sums``."""
    a = x[0, i]
    b = x[1, i]
    c = x[2, i]
    for k in range(sums.shape[0]):
        da = a - y[0, j + k]
        db = b - y[1, j + k]
        dc = c - y[2, j + k]
        sums[k] += sign * (da * da + db * db + dc * dc)


@kernel
def denoise_stretch(
    x: NDArray[np.float64],
    begin: int,
    end: int,
    examples: NDArray[np.float64],
    starts: NDArray[np.int64],
    chosen: NDArray[np.int64],
    diagonals: NDArray[np.int64],
    half_width: int,
    window: int,
    precision: float,
    out: NDArray[np.float64],
) -> None:
    """Predict cells ``begin`` to ``end`` of the clean signal of one strand.

    x: (3, L), the noisy signal divided by alpha. examples: (3, C), example e in columns starts[e] to starts[e + 1].
    chosen: (E,), the examples offered here; diagonals: (E,), example cell minus strand cell where the window of each
    is centred. precision: alpha^2 / (2 sigma^2). out: (3, L).
    """
    cells = x.shape[1]
    count = chosen.shape[0]
    span = 2 * window + 1
    sums = np.zeros((count, span))  # squared distance of the patches, by example and diagonal
    scores = np.empty((count, span))
    for i in range(begin, end):
        largest = -np.inf
        for e in range(count):
            first = diagonals[e] - window
            length = starts[chosen[e] + 1] - starts[chosen[e]]
            y = examples[:, starts[chosen[e]] : starts[chosen[e]] + length]
            # Cells that enter the patches, all of them at the first position, and the one that leaves.
            for k in range(max(0, i - half_width) if i == begin else i + half_width, min(cells, i + half_width + 1)):
                low = max(0, -(k + first))
                high = min(span, length - (k + first))
                if high > low:
                    _add_distances(x, y, k, k + first + low, 1.0, sums[e, low:high])
            k = i - half_width - 1
            if i > begin and k >= 0:
                low = max(0, -(k + first))
                high = min(span, length - (k + first))
                if high > low:
                    _add_distances(x, y, k, k + first + low, -1.0, sums[e, low:high])
            # A patch cut short by an end counts as a whole one with the same mean square.
            before = min(i, half_width)
            after = min(cells - 1 - i, half_width)
            full = (2 * half_width + 1.0) * precision
            for k in range(max(0, -(i + first)), min(span, length - (i + first))):
                j = i + first + k
                score = -sums[e, k] * full / (min(before, j) + min(after, length - 1 - j) + 1)
                scores[e, k] = score
                largest = max(largest, score)
        total = 0.0
        mean0 = 0.0
        mean1 = 0.0
        mean2 = 0.0
        for e in range(count):
            first = diagonals[e] - window
            length = starts[chosen[e] + 1] - starts[chosen[e]]
            column = starts[chosen[e]] + i + first
            for k in range(max(0, -(i + first)), min(span, length - (i + first))):
                score = scores[e, k] - largest
                if score > NEGLIGIBLE:
                    weight = np.exp(score)
                    total += weight
                    mean0 += weight * examples[0, column + k]
                    mean1 += weight * examples[1, column + k]
                    mean2 += weight * examples[2, column + k]
        out[0, i] = mean0 / total
        out[1, i] = mean1 / total
        out[2, i] = mean2 / total


@parallel_kernel
def denoise_strands(
    noisy: NDArray[np.float64],
    alpha: float,
    sigma: float,
    examples: NDArray[np.float64],
    starts: NDArray[np.int64],
    bounds: NDArray[np.int64],
    chosen: NDArray[np.int64],
    diagonals: NDArray[np.int64],
    half_width: int,
    window: int,
) -> NDArray[np.float64]:
    """Predicted clean signals (B, 3, L) of noisy ones.

    bounds: (K + 1,), where the stretches of all these strands begin and end. chosen, diagonals: (B, K, E).
    """
    out = np.empty_like(noisy)
    precision = 0.5 * (alpha / sigma) ** 2
    for b in prange(noisy.shape[0]):
        x = noisy[b] / alpha
        for p in range(bounds.shape[0] - 1):
            denoise_stretch(
                x, bounds[p], bounds[p + 1], examples, starts, chosen[b, p], diagonals[b, p], half_width, window,
                precision, out[b],
            )  # fmt: skip
    return out


def plan_stretches(
    rng: np.random.Generator, lengths: NDArray[np.int64], cells: int, bounds: NDArray[np.int64], offered: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Choose the examples offered to each stretch of one strand, (K, E), and the diagonals they lie on, (K, E).

    lengths: cells of each example. A strand shorter than an example is laid over a random part of it; along a
    longer one positions are mapped in proportion. Neighbouring stretches share no example while there are enough;
    where there are few, each is offered at several places.
    """
    stretches = len(bounds) - 1
    order = rng.permutation(len(lengths))
    while len(order) < stretches * offered:
        order = np.concatenate([order, rng.permutation(len(lengths))])
    chosen = order[: stretches * offered].reshape(stretches, offered)
    length = lengths[chosen]
    middle = 0.5 * (bounds[:-1] + bounds[1:])[:, None]
    spread = np.abs(length - cells) if len(lengths) >= stretches * offered else np.maximum(length, cells)
    shorter = rng.uniform(0.0, 1.0, chosen.shape) * np.maximum(length - cells, 0)
    longer = np.where(length < cells, middle * (length / cells - 1.0), 0.0)
    jitter = np.zeros(chosen.shape)
    if len(lengths) < stretches * offered:
        jitter = rng.uniform(-0.25, 0.25, chosen.shape) * np.minimum(length, spread)
    diagonals = np.round(shorter + longer + jitter).astype(np.int64)
    # As much of the stretch as can should lie inside the example.
    lowest = np.minimum(-bounds[:-1, None], length - bounds[1:, None])
    highest = np.maximum(-bounds[:-1, None], length - bounds[1:, None])
    return chosen, np.clip(diagonals, lowest, highest)
