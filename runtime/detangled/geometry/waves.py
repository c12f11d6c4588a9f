"""Axes of weak waves whose wavelength is known: running means over a turn.

A wave that is long beside its radius hardly shows where its axis is: a centreline that knows nothing of it would take
it for style, or its axis' bends for it. A mean over one turn of a helix lies on its axis; three in a row are smooth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.geometry.spline import chord_lengths
from detangled.kernels import kernel, parallel_kernel, prange

WEAK = 1.0  # wavelengths by circumferences: above, a wave is weak
PASSES = 3
END_TURNS = 0.5 * PASSES  # at either end the axis is not known, and goes straight on


def is_weak(radius: ArrayLike, wavelength: ArrayLike) -> NDArray[np.bool_]:
    """Whether waves of these radii and wavelengths [cm] are weak; arrays broadcast."""
    return np.asarray(wavelength) > WEAK * 2.0 * np.pi * np.asarray(radius)


@kernel
def _running_mean(points: NDArray[np.float64], half: int) -> NDArray[np.float64]:
    """Means (n, 3) over ``half`` points to either side, or as many as there are to both."""
    n = points.shape[0]
    total = np.zeros((n + 1, 3))
    for i in range(n):
        total[i + 1] = total[i] + points[i]
    out = np.empty((n, 3))
    for i in range(n):
        reach = min(half, i, n - 1 - i)
        out[i] = (total[i + reach + 1] - total[i - reach]) / (2 * reach + 1)
    return out


@kernel
def _wave_axis(points: NDArray[np.float64], turn: float) -> NDArray[np.float64]:
    n = points.shape[0]
    along = chord_lengths(points)
    per_turn = turn * (n - 1) / max(along[n - 1], 1e-12)
    axis = points
    for _ in range(PASSES):
        axis = _running_mean(axis, round(0.5 * per_turn))
    known = round(END_TURNS * per_turn)
    if 2 * known >= n - 1:
        first = points[0].copy()
        step = (points[n - 1] - first) / (n - 1)
        axis = np.empty((n, 3))
        for i in range(n):
            axis[i] = first + i * step
        return axis
    reach = min(max(known // 3, 1), n - 1 - 2 * known)
    for i in range(known):
        axis[i] = axis[known] + (known - i) * (axis[known] - axis[known + reach]) / reach
        j = n - 1 - i
        axis[j] = axis[n - 1 - known] + (known - i) * (axis[n - 1 - known] - axis[n - 1 - known - reach]) / reach
    return axis


@parallel_kernel
def wave_axes(
    points: NDArray[np.float64], offsets: NDArray[np.int64], turns: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Axes (P, 3) [cm] of strands (P, 3), whose points lie at even steps, by offsets (S + 1,).

    turns: (S,), arc length [cm] of a turn of each. A strand too short to have an axis gets a straight one.
    """
    out = np.empty(points.shape)
    for s in prange(offsets.shape[0] - 1):
        out[offsets[s] : offsets[s + 1]] = _wave_axis(points[offsets[s] : offsets[s + 1]], turns[s])
    return out
