"""Centrelines of strands: a rough one from low frequencies, then the paper's optimised one.

Paper section "Canonical Space & Style Guides". The start keeps the lowest frequencies of the discrete cosine
transform of the segments (Chen et al. 2024, "Doubly Hierarchical Geometric Representations for Strand-based Human
Hairstyle Generation"); the optimisation makes all points of the strand equally far from the axis.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.geometry.canonical import guide_frames, phi
from detangled.geometry.spline import (
    chord_lengths,
    spline_sample,
    spline_slopes,
)
from detangled.kernels import kernel, parallel_kernel, prange

SAMPLES_PER_SEGMENT = 2
FEWEST_SAMPLES = 64
ENOUGH_SAMPLES = 512
FEWEST_FREQUENCIES, MOST_FREQUENCIES = 3, 8
# Below so many swings about its lowest frequencies a strand has no curl to take away, and neither has one that
# swings too weakly for its number of turns (sine squared of the helix' angle, times turns squared): those bends are
# style, and the strand is its own guide. Types III to VIII are above from 2.5 turns up; a wave of type II (0.45 cm
# by 9 cm) from 4.7 turns; a swept lock with two or three gentle bends stays below.
FEWEST_TURNS = 2.5
LEAST_CURL = 2.0
EXTENSION = 0.1  # of the points, duplicated and reflected beyond each end

# Weights of the regularisers beside the spread of the distances. Lengths are measured in turns / 2 pi.
WEIGHT_ADJACENT = 1.0
WEIGHT_DISPLACEMENT = 1e-2
WEIGHT_CURVATURE = 5.0
MOST_ITERATIONS = 40
BAND = 5  # half-bandwidth of the normal equations with x and y interleaved


@kernel
def dct_centerline(points: NDArray[np.float64], frequencies: int) -> NDArray[np.float64]:
    """Rough centreline (n, 3) of a strand (n, 3): its segments' lowest ``frequencies`` cosines over arc length.

    The limit of the transform for a fine uniform resampling, in closed form on the polyline. Keeps both endpoints.
    """
    n = points.shape[0]
    s = chord_lengths(points)
    length = s[n - 1]
    out = np.empty((n, 3))
    for i in range(n):
        for c in range(3):
            out[i, c] = points[0, c] + (points[n - 1, c] - points[0, c]) * (s[i] / length)
    coefficient = np.empty(3)
    for k in range(1, frequencies):
        w = np.pi * k / length
        coefficient[:] = 0.0
        for i in range(n - 1):
            h = s[i + 1] - s[i]
            if h > 0.0:
                weight = (np.sin(w * s[i + 1]) - np.sin(w * s[i])) / (w * h)
                for c in range(3):
                    coefficient[c] += weight * (points[i + 1, c] - points[i, c])
        for i in range(n):
            wave = np.sin(w * s[i]) * 2.0 / (w * length)
            for c in range(3):
                out[i, c] += wave * coefficient[c]
    return out


@kernel
def curl_turns(strand: NDArray[np.float64], rough: NDArray[np.float64]) -> tuple[float, float]:
    """Turns of a densely sampled strand (n, 3) about its rough centreline, and how much it curls.

    The part of the tangent that the centreline lacks circles at the curl's rate: its root mean square frequency
    gives the turns, its mean square (the sine of the helix' angle, squared) the second value.
    """
    n = strand.shape[0]
    length = 0.0
    size = 0.0
    change = 0.0
    previous = np.zeros(3)
    for i in range(n - 1):
        step2 = 0.0
        for c in range(3):
            step2 += (strand[i + 1, c] - strand[i, c]) ** 2
        step = np.sqrt(step2) + 1e-300
        length += step
        here2 = 0.0
        change2 = 0.0
        for c in range(3):
            here = (strand[i + 1, c] - strand[i, c] - rough[i + 1, c] + rough[i, c]) / step
            here2 += here * here
            change2 += (here - previous[c]) ** 2
            previous[c] = here
        size += here2 * step
        if i > 0:
            change += change2 / step
    if size == 0.0:
        return 0.0, 0.0
    return length * np.sqrt(change / size) / (2.0 * np.pi), size / length


@kernel
def _extend(canonical: NDArray[np.float64], extra: int) -> NDArray[np.float64]:
    """Continue a strand (n, 3) by ``extra`` points at each end: reflected there, the end frames aligned.

    Half a turn about the normal at an end maps a helix onto its own continuation.
    """
    n = canonical.shape[0]
    out = np.empty((n + 2 * extra, 3))
    out[extra : extra + n] = canonical
    normal = np.empty(3)
    tangent = np.empty(3)
    for end in range(2):
        root = 0 if end == 0 else n - 1
        inward = 1 if end == 0 else -1
        p0 = canonical[root]
        p1 = canonical[root + inward]
        p2 = canonical[root + 2 * inward]
        p3 = canonical[root + 3 * inward]
        for c in range(3):
            tangent[c] = -11.0 * p0[c] + 18.0 * p1[c] - 9.0 * p2[c] + 2.0 * p3[c]
            normal[c] = 2.0 * p0[c] - 5.0 * p1[c] + 4.0 * p2[c] - p3[c]
        along = (normal * tangent).sum() / (tangent * tangent).sum()
        across = normal - along * tangent
        size = np.sqrt((across * across).sum())
        straight = size <= 1e-6 * np.sqrt((tangent * tangent).sum())
        for k in range(1, extra + 1):
            offset = canonical[root + inward * k] - p0
            if straight:
                offset = -offset
            else:
                onto = 2.0 * (offset * across).sum() / (size * size)
                offset = onto * across - offset
            out[extra - k if end == 0 else extra + n - 1 + k] = p0 + offset
    return out


@kernel
def _solve_band(band: NDArray[np.float64], right: NDArray[np.float64]) -> bool:
    """Solve a symmetric positive definite banded system in place (Cholesky); False where it is not definite.

    band: (m, BAND + 1), band[i, k] is the entry (i, i - k). right: (m, c), replaced by the solution.
    """
    m, columns = right.shape
    for i in range(m):
        for k in range(min(BAND, i), -1, -1):
            j = i - k
            total = band[i, k]
            for p in range(max(0, i - BAND), j):
                total -= band[i, i - p] * band[j, j - p]
            if k > 0:
                band[i, k] = total / band[j, 0]
            else:
                if total <= 0.0:
                    return False
                band[i, 0] = np.sqrt(total)
        for c in range(columns):
            total = right[i, c]
            for p in range(max(0, i - BAND), i):
                total -= band[i, i - p] * right[p, c]
            right[i, c] = total / band[i, 0]
    for i in range(m - 1, -1, -1):
        for c in range(columns):
            total = right[i, c]
            for p in range(i + 1, min(m, i + BAND + 1)):
                total -= band[p, p - i] * right[p, c]
            right[i, c] = total / band[i, 0]
    return True


@kernel
def _objective(
    axis: NDArray[np.float64], strand: NDArray[np.float64], unit: float, weights: NDArray[np.float64]
) -> float:
    """The paper's objective and its three regularisers for an axis (n, 2) of a strand (n, 3); see ``optimise``."""
    n = axis.shape[0]
    r = np.empty(n)
    for i in range(n):
        r[i] = np.sqrt((axis[i, 0] - strand[i, 0]) ** 2 + (axis[i, 1] - strand[i, 1]) ** 2)
    mean = r.mean()
    adjacent = weights[0] * unit * unit
    curvature = weights[2] * unit**4
    total = 0.0
    for i in range(n):
        total += (r[i] - mean) ** 2
        total += weights[1] * (axis[i, 0] ** 2 + axis[i, 1] ** 2)
        if i > 0:
            total += adjacent * (r[i] - r[i - 1]) ** 2
        if 0 < i < n - 1:
            for c in range(2):
                total += curvature * (axis[i + 1, c] - 2.0 * axis[i, c] + axis[i - 1, c]) ** 2
    return 0.5 * total


@kernel
def optimise(strand: NDArray[np.float64], unit: float, weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Axis (n, 2) [cm] that a canonical strand (n, 3) winds around at an even distance, each point at its own height.

    Minimises 1/2 sum (r_i - mean r)^2, plus weights (3,) times: the steps of r between neighbours, the spread of the
    displacement from the z-axis, and the axis' curvature, over lengths measured in ``unit``, samples per radian of
    a turn. Gauss-Newton on the banded normal equations; the three means are unknowns of their own, eliminated by
    the bordered system; Levenberg's damping where a step would not descend.
    """
    n = strand.shape[0]
    axis = np.zeros((n, 2))
    adjacent = weights[0] * unit * unit
    displacement = weights[1]
    curvature = weights[2] * unit**4
    r = np.empty(n)
    u = np.empty((n, 2))
    band = np.empty((2 * n, BAND + 1))
    right = np.empty((2 * n, 2))
    trial = np.empty((n, 2))
    damping = 1e-6
    value = _objective(axis, strand, unit, weights)
    for _ in range(MOST_ITERATIONS):
        for i in range(n):
            dx = axis[i, 0] - strand[i, 0]
            dy = axis[i, 1] - strand[i, 1]
            r[i] = np.sqrt(dx * dx + dy * dy)
            if r[i] > 1e-12:
                u[i, 0] = dx / r[i]
                u[i, 1] = dy / r[i]
            else:
                # The axis touches the strand: it should leave towards the inside of the bend.
                a = max(i - 1, 0)
                b = min(i + 1, n - 1)
                bx = strand[a, 0] + strand[b, 0] - 2.0 * strand[i, 0]
                by = strand[a, 1] + strand[b, 1] - 2.0 * strand[i, 1]
                size = np.sqrt(bx * bx + by * by) + 1e-30
                u[i, 0] = bx / size
                u[i, 1] = by / size
        mean = r.mean()
        band[:] = 0.0
        right[:] = 0.0
        for i in range(n):
            for c in range(2):
                right[2 * i + c, 0] -= u[i, c] * (r[i] - mean) + displacement * axis[i, c]
                right[2 * i + c, 1] = u[i, c]
                band[2 * i + c, 0] += displacement + damping
            band[2 * i, 0] += u[i, 0] * u[i, 0]
            band[2 * i + 1, 0] += u[i, 1] * u[i, 1]
            band[2 * i + 1, 1] += u[i, 0] * u[i, 1]
            if i > 0:
                step = adjacent * (r[i] - r[i - 1])
                for c in range(2):
                    right[2 * i + c, 0] -= step * u[i, c]
                    right[2 * i - 2 + c, 0] += step * u[i - 1, c]
                    band[2 * i + c, 0] += adjacent * u[i, c] * u[i, c]
                    band[2 * i - 2 + c, 0] += adjacent * u[i - 1, c] * u[i - 1, c]
                    for d in range(2):
                        band[2 * i + c, 2 + c - d] -= adjacent * u[i, c] * u[i - 1, d]
                band[2 * i + 1, 1] += adjacent * u[i, 0] * u[i, 1]
                band[2 * i - 1, 1] += adjacent * u[i - 1, 0] * u[i - 1, 1]
            if 0 < i < n - 1:
                for c in range(2):
                    bend = curvature * (axis[i + 1, c] - 2.0 * axis[i, c] + axis[i - 1, c])
                    right[2 * i + 2 + c, 0] -= bend
                    right[2 * i + c, 0] += 2.0 * bend
                    right[2 * i - 2 + c, 0] -= bend
                    band[2 * i + 2 + c, 0] += curvature
                    band[2 * i + c, 0] += 4.0 * curvature
                    band[2 * i - 2 + c, 0] += curvature
                    band[2 * i + 2 + c, 2] -= 2.0 * curvature
                    band[2 * i + c, 2] -= 2.0 * curvature
                    band[2 * i + 2 + c, 4] += curvature
        if not _solve_band(band, right):
            damping = max(10.0 * damping, 1e-6)
            continue
        # The mean moves along with the axis: one more unknown, eliminated by its Schur complement.
        top = 0.0
        bottom = float(n)
        for i in range(n):
            for c in range(2):
                top += u[i, c] * right[2 * i + c, 0]
                bottom -= u[i, c] * right[2 * i + c, 1]
        mean_move = top / max(bottom, 1e-9 * n)
        largest = 0.0
        for i in range(n):
            for c in range(2):
                move = right[2 * i + c, 0] + mean_move * right[2 * i + c, 1]
                trial[i, c] = axis[i, c] + move
                largest = max(largest, abs(move))
        trial_value = _objective(trial, strand, unit, weights)
        if trial_value <= value:
            axis[:] = trial
            done = largest <= 1e-3 * mean or value - trial_value <= 1e-4 * value
            value = trial_value
            damping *= 0.1
            if done:
                break
        else:
            if damping > 1e6:
                break
            damping = max(10.0 * damping, 1e-3)
    return axis


@kernel
def centerline(
    points: NDArray[np.float64], weights: NDArray[np.float64], passes: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """World-space centreline (n, 3) of a strand (n, 3) of distinct points, and its rough start."""
    n = points.shape[0]
    if n < 3:
        return points.copy(), points.copy()
    t = chord_lengths(points)
    segments = n - 1
    m = max(FEWEST_SAMPLES, min(SAMPLES_PER_SEGMENT * segments, max(ENOUGH_SAMPLES, segments)))
    grid = np.arange(m + 1) * (t[n - 1] / m)
    dense = spline_sample(t, points, spline_slopes(t, points), grid)
    guide = dct_centerline(dense, FEWEST_FREQUENCIES)
    turns, curl = curl_turns(dense, guide)
    if turns < FEWEST_TURNS or curl * turns * turns < LEAST_CURL:
        return points.copy(), spline_sample(grid, guide, spline_slopes(grid, guide), t)
    frequencies = int(min(max(np.round(turns), FEWEST_FREQUENCIES), MOST_FREQUENCIES))
    if frequencies > FEWEST_FREQUENCIES:
        guide = dct_centerline(dense, frequencies)
    start = spline_sample(grid, guide, spline_slopes(grid, guide), t)
    unit = m / (2.0 * np.pi * turns)
    extra = max(4, int(EXTENSION * m))
    for _ in range(passes):
        canonical = phi(dense, guide)
        extended = _extend(canonical, extra)
        axis = optimise(extended, unit, weights)
        rotation = guide_frames(guide)
        moved = np.empty_like(guide)
        for i in range(m + 1):
            x = axis[extra + i, 0]
            y = axis[extra + i, 1]
            for c in range(3):
                moved[i, c] = guide[i, c] + rotation[i, 0, c] * x + rotation[i, 1, c] * y
        guide = moved
    return spline_sample(grid, guide, spline_slopes(grid, guide), t), start


@parallel_kernel
def centerlines(
    points: NDArray[np.float64], offsets: NDArray[np.int64], weights: NDArray[np.float64], passes: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centrelines (P, 3) of all strands, and their rough starts (P, 3)."""
    out = points.copy()
    start = points.copy()
    for s in prange(offsets.shape[0] - 1):
        a = offsets[s]
        b = offsets[s + 1]
        if b - a >= 3:
            out[a:b], start[a:b] = centerline(points[a:b], weights, passes)
    return out, start
