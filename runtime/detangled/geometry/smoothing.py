"""Adaptive Gaussian smoothing of densely sampled channels, until no edge stands out.

Paper section "Differentiable Curves": per channel, an edge is the step sqrt(dx^2 + dt^2) between two samples; edges
at least three standard deviations longer than the mean offend; a Gaussian whose width follows the edge's length is
applied around them, and again, until none offends.

Edges are found channel by channel, but what one of them calls for is done to all channels alike: smoothing x more
than y would turn derivatives out of the plane in which the strand bends, which is torsion it does not have.

Unbounded, that rule blurs what the grid of cells still resolves: a lone step on an otherwise even channel offends
until it has spread over a tenth of the strand. The blur spent on any one sample can therefore be bounded; the
signal bounds it by the width of its cells, since their means cannot alias anything narrower.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import kernel

OFFENCE_DEVIATIONS = 3.0
# Rounding alone makes edges of a straight channel differ: those are no offence.
RELATIVE_TOLERANCE = 1e-6
# A lone step needs some hundreds of rounds to spread out; the cap only bounds pathological input.
MOST_ROUNDS = 2000
NARROWEST_KERNEL = 0.75  # standard deviations of the Gaussian, in samples
WIDEST_KERNEL = 6.0
NEARLY_ALL = 0.99  # of the blur spent: what is left would change nothing


@kernel
def _edges(values: NDArray[np.float64], c: int, step: float, edges: NDArray[np.float64]) -> tuple[float, float]:
    """Fill ``edges`` (m - 1,) of channel c; return the length from which an edge offends, and the mean length."""
    count = edges.shape[0]
    total = 0.0
    for i in range(count):
        d = values[i + 1, c] - values[i, c]
        edges[i] = np.sqrt(d * d + step * step)
        total += edges[i]
    mean = total / count
    variance = 0.0
    for i in range(count):
        variance += (edges[i] - mean) ** 2
    deviation = np.sqrt(variance / count)
    return mean + max(OFFENCE_DEVIATIONS * deviation, RELATIVE_TOLERANCE * mean), mean


@kernel
def smooth_channels(values: NDArray[np.float64], step: float, most_blur: float) -> int:
    """Smooth ``values`` (m, C), sampled at a uniform ``step``, in place; return the edges that still offend.

    most_blur: standard deviation, in samples, that the Gaussians applied to one sample may add up to; infinite for
    the rule as the paper states it, which leaves no offending edge. Endpoints keep their values: the Gaussian sees
    the channel continued by point reflection.
    """
    m, channels = values.shape
    edges = np.empty(m - 1)
    width = np.empty(m)
    spent = np.zeros(m)
    old = np.empty(m)
    most = most_blur * most_blur
    for round_ in range(MOST_ROUNDS + 1):
        width[:] = 0.0
        offending = 0
        spendable = False
        for c in range(channels):
            limit, mean = _edges(values, c, step, edges)
            for i in range(m - 1):
                if edges[i] >= limit:
                    offending += 1
                    wide = min(max(edges[i] / mean, NARROWEST_KERNEL), WIDEST_KERNEL)
                    reach = int(np.ceil(2.0 * wide))
                    for j in range(max(1, i - reach), min(m - 1, i + reach + 2)):
                        if spent[j] < NEARLY_ALL * most:
                            width[j] = max(width[j], min(wide, np.sqrt(most - spent[j])))
                            spendable = True
        if not spendable or round_ == MOST_ROUNDS:
            return offending
        for c in range(channels):
            for i in range(m):
                old[i] = values[i, c]
            for i in range(1, m - 1):
                if width[i] > 0.0:
                    values[i, c] = _gaussian_mean(old, i, width[i])
        for i in range(m):
            spent[i] += width[i] * width[i]
    return 0


@kernel
def _gaussian_mean(old: NDArray[np.float64], i: int, wide: float) -> float:
    """Gaussian mean of ``old`` (m,) around i, continued beyond the ends by point reflection."""
    m = old.shape[0]
    reach = min(int(np.ceil(3.0 * wide)), m - 1)
    inverse = 0.5 / (wide * wide)
    total = old[i]
    weights = 1.0
    for k in range(1, reach + 1):
        weight = np.exp(-k * k * inverse)
        below = old[i - k] if i - k >= 0 else 2.0 * old[0] - old[k - i]
        above = old[i + k] if i + k < m else 2.0 * old[m - 1] - old[2 * (m - 1) - i - k]
        total += weight * (below + above)
        weights += 2.0 * weight
    return total / weights
