"""Fewer points a strand, placed where it bends: what is left of a strand that an engine would cut off.

A chord over an arc of curvature kappa and length h misses it by kappa h^2 / 8, so the same error everywhere asks for
points at a density of sqrt(kappa): de Boor (1973), "Good approximation by splines with variable knots".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.geometry.inputs import compiled_input
from detangled.geometry.spline import chord_lengths, distinct_points, spline_sample, spline_slopes
from detangled.groom import offsets_of
from detangled.kernels import kernel, parallel_kernel, prange

# Straight parts get this share of the strand's mean density: rounding in them would ask for none, or for any.
LEAST_DENSITY = 0.25


@dataclass(frozen=True)
class FewerPoints:
    """Where strands keep points.

    offsets: (S + 1,) of the new strands. at: (Q,), each new point's place among its strand's old points, 1.5 halfway
    between the second and the third. deviation: (S,) [cm], how far the old points lie from the new polyline at most;
    0 where a strand keeps all its points. turns: (S,), how often the old strand goes round, its bends added up.
    """

    offsets: NDArray[np.int64]
    at: NDArray[np.float64]
    deviation: NDArray[np.float64]
    turns: NDArray[np.float64]


def fewer_points(points: ArrayLike, offsets: ArrayLike, most: int) -> FewerPoints:
    """Places for at most ``most`` (2 or more) points on each of the strands (P, 3) [cm], both ends among them.

    A strand of no more points keeps them to the bit; so does one without two distinct finite points, but for those
    beyond ``most``.
    """
    old = compiled_input(points, np.float64), compiled_input(offsets, np.int64)
    new = offsets_of(np.minimum(np.diff(old[1]), most))
    at, deviation, turns = _places(*old, new)
    return FewerPoints(new, at, deviation, turns)


def points_at(points: ArrayLike, offsets: ArrayLike, fewer: FewerPoints) -> NDArray[np.float64]:
    """The new points (Q, 3) [cm] of strands (P, 3), on the smooth curve through the old ones."""
    return _points_at(compiled_input(points, np.float64), compiled_input(offsets, np.int64), fewer.offsets, fewer.at)


@kernel
def _bends(points: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how much (n,) [rad] a polyline of distinct points turns at each of them; 0 at its ends."""
    n = points.shape[0]
    out = np.zeros(n)
    for i in range(1, n - 1):
        along = 0.0
        for c in range(3):
            along += (points[i, c] - points[i - 1, c]) * (points[i + 1, c] - points[i, c])
        along /= (t[i] - t[i - 1]) * (t[i + 1] - t[i])
        out[i] = np.arccos(min(max(along, -1.0), 1.0))
    return out


@kernel
def _by_bends(t: NDArray[np.float64], bends: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """``count`` parameters from 0 to t[-1], the denser the more the polyline bends there."""
    n = t.shape[0]
    total = t[n - 1]
    # Bends lie at points and curvature between them: a mean over the new points' distance either way.
    reach = total / (count - 1)
    summed = np.zeros(n + 1)
    for i in range(n):
        summed[i + 1] = summed[i] + bends[i]
    density = np.empty(n - 1)
    low = 0
    high = 0
    mean = 0.0
    for i in range(n - 1):
        middle = 0.5 * (t[i] + t[i + 1])
        while low < n and t[low] < middle - max(reach, middle - t[i]):
            low += 1
        while high < n and t[high] <= middle + max(reach, t[i + 1] - middle):
            high += 1
        span = min(middle + reach, total) - max(middle - reach, 0.0)
        density[i] = np.sqrt(max(summed[high] - summed[low], 0.0) / max(span, t[i + 1] - t[i]))
        mean += density[i] * (t[i + 1] - t[i]) / total
    grown = np.zeros(n)
    for i in range(n - 1):
        grown[i + 1] = grown[i] + max(density[i], LEAST_DENSITY * mean) * (t[i + 1] - t[i])
    if not grown[n - 1] > 0.0:
        return np.linspace(0.0, total, count)
    out = np.interp(np.linspace(0.0, grown[n - 1], count), grown, t)
    out[0] = 0.0
    out[count - 1] = total
    return out


@kernel
def _deviation(
    points: NDArray[np.float64], t: NDArray[np.float64], new: NDArray[np.float64], at: NDArray[np.float64]
) -> float:
    """How far points (n, 3) at t lie, at most, from the polyline through new points (m, 3) at parameters ``at``."""
    worst = 0.0
    k = 0
    m = at.shape[0]
    for i in range(t.shape[0]):
        while k < m - 2 and t[i] > at[k + 1]:
            k += 1
        length2 = 0.0
        along = 0.0
        for c in range(3):
            step = new[k + 1, c] - new[k, c]
            length2 += step * step
            along += step * (points[i, c] - new[k, c])
        share = min(max(along / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
        gap = 0.0
        for c in range(3):
            gap += (points[i, c] - new[k, c] - share * (new[k + 1, c] - new[k, c])) ** 2
        worst = max(worst, gap)
    return np.sqrt(worst)


@parallel_kernel
def _places(
    points: NDArray[np.float64], offsets: NDArray[np.int64], new_offsets: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    strands = offsets.shape[0] - 1
    at = np.empty(new_offsets[-1])
    deviation = np.zeros(strands)
    turns = np.zeros(strands)
    for s in prange(strands):
        begin = new_offsets[s]
        count = new_offsets[s + 1] - begin
        strand = points[offsets[s] : offsets[s + 1]]
        for i in range(count):
            at[begin + i] = i
        kept = distinct_points(strand)
        if kept.shape[0] < 2:
            continue
        t = chord_lengths(kept)
        bends = _bends(kept, t)
        turns[s] = bends.sum() / (2.0 * np.pi)
        if count == strand.shape[0]:
            continue
        slopes = spline_slopes(t, kept)
        chosen = _by_bends(t, bends, count)
        deviation[s] = _deviation(kept, t, spline_sample(t, kept, slopes, chosen), chosen)
        even = np.linspace(0.0, t[-1], count)
        evenly = _deviation(kept, t, spline_sample(t, kept, slopes, even), even)
        if evenly < deviation[s]:
            deviation[s] = evenly
            chosen = even
        along = chord_lengths(strand)
        k = 0
        for i in range(count):
            while k < strand.shape[0] - 2 and chosen[i] > along[k + 1]:
                k += 1
            gap = along[k + 1] - along[k]
            at[begin + i] = k + (min(max((chosen[i] - along[k]) / gap, 0.0), 1.0) if gap > 0.0 else 0.0)
        at[begin + count - 1] = strand.shape[0] - 1
    return at, deviation, turns


@parallel_kernel
def _points_at(
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    new_offsets: NDArray[np.int64],
    at: NDArray[np.float64],
) -> NDArray[np.float64]:
    out = np.empty((new_offsets[-1], 3))
    for s in prange(offsets.shape[0] - 1):
        strand = points[offsets[s] : offsets[s + 1]]
        begin = new_offsets[s]
        count = new_offsets[s + 1] - begin
        kept = distinct_points(strand)
        if count == strand.shape[0] or kept.shape[0] < 2:
            for i in range(count):
                out[begin + i] = strand[int(at[begin + i])]
            continue
        along = chord_lengths(strand)
        t = chord_lengths(kept)
        # Points left out as doubled leave the distances along the strand a rounding apart.
        along *= t[-1] / along[-1]
        wanted = np.empty(count)
        for i in range(count):
            k = min(int(at[begin + i]), strand.shape[0] - 2)
            wanted[i] = along[k] + (at[begin + i] - k) * (along[k + 1] - along[k])
        out[begin : begin + count] = spline_sample(t, kept, spline_slopes(t, kept), wanted)
        out[begin] = strand[0]
        out[begin + count - 1] = strand[strand.shape[0] - 1]
    return out
