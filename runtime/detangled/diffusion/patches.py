"""A denoiser in closed form from a handful of strands: no weights, no training.

The best prediction of the clean signal that may only look at a neighbourhood is, at each position, the mean of the
examples' values weighted by how well the patch around them explains the noisy patch (Kamb and Ganguli 2024, "An
analytic theory of creativity in convolutional diffusion models"): weights exp(-|x / alpha - y|^2 alpha^2 / (2
sigma^2)), wide patches at high noise, narrow ones at low noise. Distances between all patches of two strands are
running sums along their diagonals, so their cost does not depend on the patch's width.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import kernel, parallel_kernel, prange

BLOCK = 128  # cells over which the window of positions stays put, where strand and example differ in length
NEGLIGIBLE = -30.0  # logarithm of a weight, relative to the largest, that changes nothing in float64


@dataclass(frozen=True)
class PatchSchedule:
    """Half-widths of patches, in cells, by noise level: geometric in sigma / alpha between two levels.

    widest, narrowest: half-widths at and beyond the two levels.
    high, low: noise levels sigma / alpha.
    window: how far, in cells, an example's position may lie from the strand's own.
    """

    widest: int = 100
    narrowest: int = 6
    high: float = 4.0
    low: float = 0.1
    window: int = 24

    def half_width(self, alpha: float, sigma: float) -> int:
        level = np.log(max(sigma / alpha, 1e-12))
        part = np.clip((level - np.log(self.low)) / (np.log(self.high) - np.log(self.low)), 0.0, 1.0)
        return round(self.narrowest * (self.widest / self.narrowest) ** float(part))


@kernel
def _pointwise(
    x: NDArray[np.float64], y: NDArray[np.float64], i: int, j: int, sums: NDArray[np.float64], sign: float
) -> None:
    """Add ``sign`` times the squared differences of cell i of x (3, L) and cells j, j + 1, ... of y (3, M)."""
    a = x[0, i]
    b = x[1, i]
    c = x[2, i]
    for k in range(sums.shape[0]):
        da = a - y[0, j + k]
        db = b - y[1, j + k]
        dc = c - y[2, j + k]
        sums[k] += sign * (da * da + db * db + dc * dc)


@kernel
def denoise_strand(
    x: NDArray[np.float64],
    examples: NDArray[np.float64],
    starts: NDArray[np.int64],
    chosen: NDArray[np.int64],
    shifts: NDArray[np.float64],
    half_width: int,
    window: int,
    precision: float,
    out: NDArray[np.float64],
) -> None:
    """Predict the clean signal of one strand.

    x: (3, L), the noisy signal divided by alpha. examples: (3, C), example e in columns starts[e] to starts[e + 1].
    chosen: (E,), the examples that this strand looks at. shifts: (E,), where its first cell lies in each, in cells;
    longer strands than the example are mapped in proportion. precision: alpha^2 / (2 sigma^2). out: (3, L).
    """
    cells = x.shape[1]
    count = chosen.shape[0]
    widest = 0
    for e in range(count):
        widest = max(widest, starts[chosen[e] + 1] - starts[chosen[e]])
    # Candidates of one example lie side by side: entry k of its row is the diagonal j = i + first[e] + k.
    sums = np.empty((count, min(2 * window + BLOCK, widest + cells) + 2))
    scores = np.empty_like(sums)
    first = np.empty(count, dtype=np.int64)
    last = np.empty(count, dtype=np.int64)  # one beyond the last diagonal
    block_end = 0
    for i in range(cells):
        fresh = i == block_end
        if fresh:
            block_end = cells
            for e in range(count):
                if starts[chosen[e] + 1] - starts[chosen[e]] < cells:
                    block_end = min(cells, i + BLOCK)
            for e in range(count):
                begin = starts[chosen[e]]
                length = starts[chosen[e] + 1] - begin
                slope = (length - 1.0) / max(cells - 1, 1) if length < cells else 1.0
                low = shifts[e] + i * slope - i
                high = shifts[e] + (block_end - 1) * (slope - 1.0)
                if low > high:
                    low, high = high, low
                first[e] = int(np.floor(low)) - window
                last[e] = int(np.ceil(high)) + window + 1
                sums[e, : last[e] - first[e]] = 0.0
        largest = -np.inf
        for e in range(count):
            begin = starts[chosen[e]]
            length = starts[chosen[e] + 1] - begin
            y = examples[:, begin : begin + length]
            row = sums[e]
            # Cells entering and leaving the patches; at the start of a block all of them enter.
            enter_from = max(0, i - half_width) if fresh else i + half_width
            for k in range(enter_from, min(cells, i + half_width + 1)):
                low_k = max(0, -(k + first[e]))
                high_k = min(last[e] - first[e], length - (k + first[e]))
                if high_k > low_k:
                    _pointwise(x, y, k, k + first[e] + low_k, row[low_k:high_k], 1.0)
            k = i - half_width - 1
            if not fresh and k >= 0:
                low_k = max(0, -(k + first[e]))
                high_k = min(last[e] - first[e], length - (k + first[e]))
                if high_k > low_k:
                    _pointwise(x, y, k, k + first[e] + low_k, row[low_k:high_k], -1.0)
            # A patch cut short by an end counts as a whole one with the same mean square.
            before = min(i, half_width)
            after = min(cells - 1 - i, half_width)
            full = 2 * half_width + 1.0
            low_k = max(0, -(i + first[e]))
            high_k = min(last[e] - first[e], length - (i + first[e]))
            for k in range(low_k, high_k):
                j = i + first[e] + k
                here = min(before, j) + min(after, length - 1 - j) + 1
                score = -row[k] * (full / here) * precision
                scores[e, k] = score
                largest = max(largest, score)
        total = 0.0
        mean0 = 0.0
        mean1 = 0.0
        mean2 = 0.0
        for e in range(count):
            begin = starts[chosen[e]]
            length = starts[chosen[e] + 1] - begin
            low_k = max(0, -(i + first[e]))
            high_k = min(last[e] - first[e], length - (i + first[e]))
            for k in range(low_k, high_k):
                score = scores[e, k] - largest
                if score > NEGLIGIBLE:
                    weight = np.exp(score)
                    j = begin + i + first[e] + k
                    total += weight
                    mean0 += weight * examples[0, j]
                    mean1 += weight * examples[1, j]
                    mean2 += weight * examples[2, j]
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
    chosen: NDArray[np.int64],
    shifts: NDArray[np.float64],
    half_width: int,
    window: int,
) -> NDArray[np.float64]:
    """Predicted clean signals (B, 3, L) of noisy ones; ``chosen`` and ``shifts`` are (B, E), the rest as above."""
    out = np.empty_like(noisy)
    precision = 0.5 * (alpha / sigma) ** 2
    for b in prange(noisy.shape[0]):
        denoise_strand(noisy[b] / alpha, examples, starts, chosen[b], shifts[b], half_width, window, precision, out[b])
    return out
