"""C2 cubic splines through strands, over the arc length of their polyline.

Paper section "Differentiable Curves": an interpolating piecewise cubic, whose two free parameters at each end are
set by the derivative of the cubic through the first or last four points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import kernel

NEAREST = 1e-9  # of a strand's length: nearer points are one, whatever their rounding says


@kernel
def chord_lengths(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cumulated polyline length at each point, (n,) [cm], starting at 0."""
    n = points.shape[0]
    t = np.zeros(n)
    for i in range(1, n):
        dx = points[i, 0] - points[i - 1, 0]
        dy = points[i, 1] - points[i - 1, 1]
        dz = points[i, 2] - points[i - 1, 2]
        t[i] = t[i - 1] + np.sqrt(dx * dx + dy * dy + dz * dz)
    return t


@kernel
def uniform_grid(length: float, intervals: int) -> NDArray[np.float64]:
    """Parameters (intervals + 1,) from 0 to ``length`` at even distances."""
    grid = np.empty(intervals + 1)
    for i in range(intervals + 1):
        grid[i] = i * (length / intervals)
    return grid


@kernel
def _end_slope(t: NDArray[np.float64], values: NDArray[np.float64], at_end: bool, c: int) -> float:
    """Derivative at one end of the polynomial through the (up to four) points nearest to it."""
    n = t.shape[0]
    count = min(4, n)
    first = n - count if at_end else 0
    here = n - 1 if at_end else 0
    slope = 0.0
    for j in range(first, first + count):
        if j == here:
            weight = 0.0
            for m in range(first, first + count):
                if m != here:
                    weight += 1.0 / (t[here] - t[m])
        else:
            weight = 1.0 / (t[j] - t[here])
            for m in range(first, first + count):
                if m != here and m != j:
                    weight *= (t[here] - t[m]) / (t[j] - t[m])
        slope += weight * values[j, c]
    return slope


@kernel
def spline_slopes(t: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """First derivatives at the knots of the C2 cubic spline through ``values`` (n, C) at increasing ``t`` (n,).

    With n = 2 the spline is the straight line. Solved by the Thomas algorithm; the system is diagonally dominant.
    """
    n, channels = values.shape
    slopes = np.empty((n, channels))
    for c in range(channels):
        slopes[0, c] = _end_slope(t, values, False, c)
        slopes[n - 1, c] = _end_slope(t, values, True, c)
    if n <= 2:
        return slopes
    ratio = np.zeros(n)
    for i in range(1, n - 1):
        h0 = t[i] - t[i - 1]
        h1 = t[i + 1] - t[i]
        pivot = 2.0 * (h0 + h1) - h1 * ratio[i - 1]
        ratio[i] = h0 / pivot
        for c in range(channels):
            right = 3.0 * (h1 * (values[i, c] - values[i - 1, c]) / h0 + h0 * (values[i + 1, c] - values[i, c]) / h1)
            slopes[i, c] = (right - h1 * slopes[i - 1, c]) / pivot
    for i in range(n - 2, 0, -1):
        for c in range(channels):
            slopes[i, c] -= ratio[i] * slopes[i + 1, c]
    return slopes


@kernel
def spline_sample(
    t: NDArray[np.float64],
    values: NDArray[np.float64],
    slopes: NDArray[np.float64],
    at: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Values (m, C) at increasing parameters ``at`` (m,) of the cubic with these knots; straight lines beyond."""
    n, channels = values.shape
    out = np.empty((at.shape[0], channels))
    k = 0
    for i in range(at.shape[0]):
        s = at[i]
        while k < n - 2 and s > t[k + 1]:
            k += 1
        h = t[k + 1] - t[k]
        u = (s - t[k]) / h
        if u < 0.0:
            for c in range(channels):
                out[i, c] = values[k, c] + slopes[k, c] * (s - t[k])
        elif u > 1.0:
            for c in range(channels):
                out[i, c] = values[k + 1, c] + slopes[k + 1, c] * (s - t[k + 1])
        else:
            a = 1.0 - u
            h00 = a * a * (1.0 + 2.0 * u)
            h10 = a * a * u * h
            h01 = u * u * (3.0 - 2.0 * u)
            h11 = -u * u * a * h
            for c in range(channels):
                out[i, c] = h00 * values[k, c] + h10 * slopes[k, c] + h01 * values[k + 1, c] + h11 * slopes[k + 1, c]
    return out


@kernel
def uniform_slopes(values: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """First derivatives (m, C) at the knots of the C2 spline through ``values`` (m, C) at a uniform ``step``.

    The same spline as ``spline_slopes``; on a uniform grid its derivative at the knots is all that the smoothed
    derivatives of a curve need. m must be at least 4.
    """
    m, channels = values.shape
    slopes = np.empty((m, channels))
    ratio = np.zeros(m)
    scale = 3.0 / step
    sixth = 1.0 / (6.0 * step)
    for c in range(channels):
        slopes[0, c] = sixth * (-11 * values[0, c] + 18 * values[1, c] - 9 * values[2, c] + 2 * values[3, c])
        slopes[m - 1, c] = -sixth * (
            -11 * values[m - 1, c] + 18 * values[m - 2, c] - 9 * values[m - 3, c] + 2 * values[m - 4, c]
        )
    for i in range(1, m - 1):
        pivot = 4.0 - ratio[i - 1]
        ratio[i] = 1.0 / pivot
        for c in range(channels):
            slopes[i, c] = (scale * (values[i + 1, c] - values[i - 1, c]) - slopes[i - 1, c]) / pivot
    for i in range(m - 2, 0, -1):
        for c in range(channels):
            slopes[i, c] -= ratio[i] * slopes[i + 1, c]
    return slopes


@kernel
def distinct_points(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points (k, 3) without those that lie on the one before: a doubled point has no direction.

    Points nearer than NEAREST of the strand's length count as the same. A strand whose length is not a finite
    number has no points to speak of.
    """
    n = points.shape[0]
    length = chord_lengths(points)[n - 1] if n > 0 else 0.0
    if not length < np.inf:
        return np.empty((0, 3))
    kept = np.empty((n, 3))
    k = 0
    for i in range(n):
        if k > 0:
            gap = 0.0
            for c in range(3):
                gap += (points[i, c] - kept[k - 1, c]) ** 2
            if np.sqrt(gap) <= NEAREST * length:
                continue
        for c in range(3):
            kept[k, c] = points[i, c]
        k += 1
    out = np.empty((k, 3))
    for i in range(k):
        for c in range(3):
            out[i, c] = kept[i, c]
    return out
