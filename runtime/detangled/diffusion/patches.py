"""A denoiser in closed form from a handful of strands: no weights, no training.

The best prediction of the clean signal that may only look at a neighbourhood is, at each position, the mean of the
examples' values weighted by how well the patch around them explains the noisy patch (Kamb and Ganguli 2024, "An
analytic theory of creativity in convolutional diffusion models"): weights exp(-|x / alpha - y|^2 alpha^2 / (2
sigma^2)), wide patches at high noise, narrow ones at low noise. Distances between all patches of two strands are
running sums along their diagonals, so their cost does not depend on the patch's width.

A strand is made in stretches, each offered a few examples of its own, so that none longer than half
an example can be copied from root to tip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import kernel, parallel_kernel, prange, vector_kernel

NEGLIGIBLE = -30.0  # logarithm of a weight, relative to the largest, that changes nothing in float64
FEW_SPREAD = 0.25  # where examples are few, how far along, as a share of its length, one is offered away from its place
NO_PATCH = -1e300  # score where an example has no cell


@dataclass(frozen=True)
class PatchSchedule:
    """Half-widths of patches, in cells, by noise level: geometric in sigma / alpha between two levels.

    widest, narrowest: half-widths at and beyond the two levels; the widest is cut to what a stretch allows.
    high, low: noise levels sigma / alpha.
    window: how far, in cells, an example's position may lie from where the strand's own falls in it.
    """

    widest: int = 200
    narrowest: int = 24
    high: float = 4.0
    low: float = 0.1
    window: int = 24

    def __post_init__(self) -> None:
        if not (1 <= self.narrowest <= self.widest and 0.0 < self.low < self.high and self.window >= 0):
            raise ValueError(f"not a schedule of patches: {self}")

    def half_width(self, alpha: float, sigma: float) -> int:
        """Half-width of the patches at this noise level."""
        level = np.log(max(sigma / alpha, 1e-12))
        part = np.clip((level - np.log(self.low)) / (np.log(self.high) - np.log(self.low)), 0.0, 1.0)
        return round(self.narrowest * (self.widest / self.narrowest) ** float(part))


@vector_kernel
def _add_distances(
    x: NDArray[np.float64],
    entering: int,
    leaving: int,
    examples: NDArray[np.float64],
    begin: int,
    end: int,
    first: int,
    span: int,
    sums: NDArray[np.float64],
    row: int,
) -> None:
    """Move the sums of one example's diagonals on by a cell: add the cell that enters, take off the one that leaves.

    x: (3, L). The example is in columns ``begin`` to ``end`` of examples (3, C), and its diagonals are ``first``,
    first + 1, ..., ``span`` of them, whose sums stand in sums from ``row`` on. A cell of -1 or beyond the strand
    neither enters nor leaves.
    """
    cells = x.shape[1]
    enters = 0 <= entering < cells
    leaves = 0 <= leaving < cells
    new = begin + entering + first
    old = begin + leaving + first
    if enters and leaves and old >= begin and new + span <= end:
        a = x[0, entering]
        b = x[1, entering]
        c = x[2, entering]
        a0 = x[0, leaving]
        b0 = x[1, leaving]
        c0 = x[2, leaving]
        # Unsigned indices need no check for counting from the end, which would keep these loops scalar.
        to = np.uintp(row)
        at = np.uintp(new)
        at0 = np.uintp(old)
        for k in range(np.uintp(span)):
            da = a - examples[0, at + k]
            db = b - examples[1, at + k]
            dc = c - examples[2, at + k]
            da0 = a0 - examples[0, at0 + k]
            db0 = b0 - examples[1, at0 + k]
            dc0 = c0 - examples[2, at0 + k]
            sums[to + k] += da * da + db * db + dc * dc - (da0 * da0 + db0 * db0 + dc0 * dc0)
        return
    if enters:
        low = max(0, begin - new)
        high = min(span, end - new)
        if high > low:
            a = x[0, entering]
            b = x[1, entering]
            c = x[2, entering]
            to = np.uintp(row + low)
            at = np.uintp(new + low)
            for k in range(np.uintp(high - low)):
                da = a - examples[0, at + k]
                db = b - examples[1, at + k]
                dc = c - examples[2, at + k]
                sums[to + k] += da * da + db * db + dc * dc
    if leaves:
        low = max(0, begin - old)
        high = min(span, end - old)
        if high > low:
            a = x[0, leaving]
            b = x[1, leaving]
            c = x[2, leaving]
            to = np.uintp(row + low)
            at = np.uintp(old + low)
            for k in range(np.uintp(high - low)):
                da = a - examples[0, at + k]
                db = b - examples[1, at + k]
                dc = c - examples[2, at + k]
                sums[to + k] -= da * da + db * db + dc * dc


@vector_kernel
def _score(
    sums: NDArray[np.float64],
    begin: int,
    end: int,
    j: int,
    length: int,
    before: int,
    after: int,
    factor: float,
    scores: NDArray[np.float64],
) -> float:
    """Fill ``scores`` from ``begin`` to ``end`` for patches around example cells j, j + 1, ...; return the largest.

    A patch cut short by an end counts as a whole one with the same mean square: ``factor`` is that of a mean.
    """
    largest = NO_PATCH
    left = float(before)
    right = float(after)
    row = np.uintp(begin)
    first = float(j)
    for k in range(np.uintp(end - begin)):
        at = first + float(k)
        score = factor * sums[row + k] / (min(left, at) + min(right, length - 1.0 - at) + 1.0)
        scores[row + k] = score
        largest = max(largest, score)
    return largest


@vector_kernel
def _exponentials(scores: NDArray[np.float64], largest: float, weights: NDArray[np.float64]) -> float:
    """Fill ``weights`` with exp(score - largest), negligible ones with 0, and return their sum.

    exp(u) = exp(u / 256)^256, the inner one by its Taylor series: to 1e-8 of itself, in vector instructions.
    """
    total = 0.0
    for k in range(scores.shape[0]):
        u = scores[k] - largest
        v = max(u, NEGLIGIBLE) / 256.0
        w = 1.0 + v * (1.0 + v * (0.5 + v * (1.0 / 6.0 + v * (1.0 / 24.0 + v * (1.0 / 120.0 + v / 720.0)))))
        w *= w
        w *= w
        w *= w
        w *= w
        w *= w
        w *= w
        w *= w
        w *= w
        w = w if u > NEGLIGIBLE else 0.0
        weights[k] = w
        total += w
    return total


@vector_kernel
def _weighted_sums(
    weights: NDArray[np.float64], begin: int, end: int, examples: NDArray[np.float64], column: int
) -> tuple[float, float, float]:
    """Sums of the examples' three values (3, C) from ``column`` on, weighted by ``weights`` from begin to end."""
    s0 = 0.0
    s1 = 0.0
    s2 = 0.0
    row = np.uintp(begin)
    at = np.uintp(column)
    for k in range(np.uintp(end - begin)):
        w = weights[row + k]
        s0 += w * examples[0, at + k]
        s1 += w * examples[1, at + k]
        s2 += w * examples[2, at + k]
    return s0, s1, s2


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
    # Flat, by example and diagonal: slices cost more than the few sums in each.
    sums = np.zeros(count * span)  # squared distances of the patches
    scores = np.empty(count * span)
    weights = np.empty(count * span)
    factor = -precision * (2 * half_width + 1)
    for i in range(begin, end):
        before = min(i, half_width)
        after = min(cells - 1 - i, half_width)
        scores[:] = NO_PATCH
        largest = NO_PATCH
        for e in range(count):
            first = diagonals[e] - window
            low = starts[chosen[e]]
            high = starts[chosen[e] + 1]
            row = e * span
            if i == begin:
                for k in range(i - before, i + after + 1):
                    _add_distances(x, k, -1, examples, low, high, first, span, sums, row)
            else:
                _add_distances(x, i + half_width, i - half_width - 1, examples, low, high, first, span, sums, row)
            j = i + first
            from_k = max(0, -j)
            to_k = min(span, high - low - j)
            if to_k > from_k:
                best = _score(sums, row + from_k, row + to_k, j + from_k, high - low, before, after, factor, scores)
                largest = max(largest, best)
        total = _exponentials(scores, largest, weights)
        mean0 = 0.0
        mean1 = 0.0
        mean2 = 0.0
        for e in range(count):
            low = starts[chosen[e]]
            j = i + diagonals[e] - window
            from_k = max(0, -j)
            to_k = min(span, starts[chosen[e] + 1] - low - j)
            if to_k > from_k:
                row = e * span
                s0, s1, s2 = _weighted_sums(weights, row + from_k, row + to_k, examples, low + j + from_k)
                mean0 += s0
                mean1 += s1
                mean2 += s2
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
    scaled = noisy / alpha
    stretches = bounds.shape[0] - 1
    # Stretches of a strand do not depend on each other: few strands, too, fill all threads.
    for part in prange(noisy.shape[0] * stretches):
        b = part // stretches
        p = part % stretches
        denoise_stretch(
            scaled[b], bounds[p], bounds[p + 1], examples, starts, chosen[b, p], diagonals[b, p], half_width, window,
            precision, out[b],
        )  # fmt: skip
    return out


def plan_stretches(
    rng: np.random.Generator, lengths: NDArray[np.int64], cells: int, bounds: NDArray[np.int64], offered: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Choose the examples offered to each stretch of one strand, (K, E), and the diagonals they lie on, (K, E).

    lengths: cells of each example. A strand shorter than an example is laid over a random part of it; along a
    longer one positions are mapped in proportion. Examples are dealt out in shuffled rounds, so that neighbouring
    stretches share few or none; where there are few examples, each is offered at several places. Where there is an
    example as long as the stretch, one such is offered, so that no cell is without a patch.
    """
    stretches = len(bounds) - 1
    order = rng.permutation(len(lengths))
    while len(order) < stretches * offered:
        order = np.concatenate([order, rng.permutation(len(lengths))])
    chosen = order[: stretches * offered].reshape(stretches, offered)
    spans = np.diff(bounds)
    for k in np.flatnonzero(lengths[chosen].max(axis=1) < spans):
        long_enough = np.flatnonzero(lengths >= spans[k])
        chosen[k, -1] = rng.choice(long_enough) if len(long_enough) else np.argmax(lengths)
    length = lengths[chosen]
    middle = 0.5 * (bounds[:-1] + bounds[1:])[:, None]
    shorter = rng.uniform(0.0, 1.0, chosen.shape) * np.maximum(length - cells, 0)
    longer = np.where(length < cells, middle * (length / cells - 1.0), 0.0)
    jitter = np.zeros(chosen.shape)
    if len(lengths) < stretches * offered:
        jitter = rng.uniform(-FEW_SPREAD, FEW_SPREAD, chosen.shape) * length
    diagonals = np.round(shorter + longer + jitter).astype(np.int64)
    # As much of the stretch as can should lie inside the example.
    lowest = np.minimum(-bounds[:-1, None], length - bounds[1:, None])
    highest = np.maximum(-bounds[:-1, None], length - bounds[1:, None])
    return chosen, np.clip(diagonals, lowest, highest)
