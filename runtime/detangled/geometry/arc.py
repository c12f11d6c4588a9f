"""Arc lengths of strands, of the smooth curve through their points."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.geometry.inputs import compiled_input
from detangled.geometry.spline import chord_lengths, distinct_points, spline_sample, spline_slopes
from detangled.kernels import kernel, parallel_kernel, prange

# Gauss-Legendre nodes and weights on [0, 1], three points: exact for polynomials of degree 5.
NODES = (0.5 - 0.5 * 0.6**0.5, 0.5, 0.5 + 0.5 * 0.6**0.5)
WEIGHTS = (5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0)


@kernel
def arc_length(points: NDArray[np.float64]) -> float:
    """Arc length [cm] of the cubic spline through distinct points (n, 3); 0 for fewer than two."""
    n = points.shape[0]
    if n < 2:
        return 0.0
    t = chord_lengths(points)
    slopes = spline_slopes(t, points)
    total = 0.0
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        for g in range(3):
            u = NODES[g]
            speed2 = 0.0
            for c in range(3):
                rise = (points[i + 1, c] - points[i, c]) / h
                d = (
                    6.0 * u * (1.0 - u) * rise
                    + (1.0 - u) * (1.0 - 3.0 * u) * slopes[i, c]
                    + u * (3.0 * u - 2.0) * slopes[i + 1, c]
                )
                speed2 += d * d
            total += WEIGHTS[g] * np.sqrt(speed2) * h
    return total


def arc_lengths(points: ArrayLike, offsets: ArrayLike) -> NDArray[np.float64]:
    """Arc length [cm] of each strand, (S,), of the smooth curve through its distinct points (P, 3)."""
    return _arc_lengths(compiled_input(points, np.float64), compiled_input(offsets, np.int64))


@parallel_kernel
def _arc_lengths(points: NDArray[np.float64], offsets: NDArray[np.int64]) -> NDArray[np.float64]:
    out = np.zeros(offsets.shape[0] - 1)
    for s in prange(offsets.shape[0] - 1):
        out[s] = arc_length(distinct_points(points[offsets[s] : offsets[s + 1]]))
    return out


@parallel_kernel
def arc_positions(points: NDArray[np.float64], offsets: NDArray[np.int64]) -> NDArray[np.float64]:
    """Arc length (P,) [cm] from each strand's root to its points, of the smooth curve through them (P, 3).

    The polyline's length, scaled to the curve's over the whole strand. Each strand is summed up by itself.
    """
    out = np.zeros(points.shape[0])
    for s in prange(offsets.shape[0] - 1):
        strand = points[offsets[s] : offsets[s + 1]]
        along = chord_lengths(strand)
        if along[-1] > 0.0:
            along *= arc_length(distinct_points(strand)) / along[-1]
        out[offsets[s] : offsets[s + 1]] = along
    return out


@kernel
def resample_strand(points: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """``count`` points (count, 3), evenly along the spline through distinct points (n, 3), both ends kept."""
    t = chord_lengths(points)
    out = spline_sample(t, points, spline_slopes(t, points), np.linspace(0.0, t[-1], count))
    out[0] = points[0]
    out[count - 1] = points[-1]
    return out
