"""Centrelines of strands: a rough one from low frequencies, then the paper's optimised one.

Paper section "Canonical Space & Style Guides". The start keeps the lowest frequencies of the discrete cosine
transform of the segments (Chen et al. 2024, "Doubly Hierarchical Geometric Representations for Strand-based Human
Hairstyle Generation"); the optimisation makes all points of the strand equally far from the axis.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.geometry.canonical import guide_frames, phi
from detangled.geometry.inputs import compiled_input
from detangled.geometry.spline import (
    chord_lengths,
    distinct_points,
    spline_sample,
    spline_slopes,
    uniform_grid,
)
from detangled.kernels import kernel, parallel_kernel, prange

SAMPLES_PER_SEGMENT = 2
FEWEST_SAMPLES = 64
ENOUGH_SAMPLES = 512
# The axis is smooth: it needs no more samples than this, and more would only slow the optimiser and spoil the
# condition of its equations.
SAMPLES_PER_TURN = 16
FEWEST_FREQUENCIES, MOST_FREQUENCIES = 3, 8
TURNS_PER_FREQUENCY = 3.0
# Below so many swings about its lowest frequencies a strand has no curl to take away, and neither has one that
# swings too weakly for its number of turns (sine squared of the helix' angle, times turns squared): those bends are
# style, and the strand is its own guide. Types III to VIII are above from 2.5 turns up; a wave of type II (0.45 cm
# by 9 cm) from 4.7 turns; a swept lock with two or three gentle bends stays below.
FEWEST_TURNS = 2.5
LEAST_CURL = 2.0
EXTENSION = 0.1  # of the points, duplicated and reflected beyond each end
STRAIGHT = 1e-6  # second differences this small beside the first leave an end no normal

# Weights of the regularisers beside the spread of the distances. Lengths are measured in turns / 2 pi.
WEIGHT_ADJACENT = 1.0
WEIGHT_DISPLACEMENT = 1e-2
WEIGHT_CURVATURE = 3.0
# A style bends over the whole strand, so the more turns there are the longer its bends, in turns: beyond so many the
# axis is stiffened by this power of their number. A soft axis follows the twists of a coil of 20 turns and gives its
# canonical strand a torsion that the strand has not; a stiff one misses the S of a guide with 4.
SOFT_TURNS = 4.0
STIFFENING = 3.0
MOST_ITERATIONS = 40
# Steps this small beside the mean distance, or gains this small beside the objective, end the optimisation.
SMALL_STEP = 1e-3
SMALL_GAIN = 1e-4
TOUCHING = 1e-9  # of the mean distance: the axis runs through the strand there
FIRST_DAMPING = 1e-6
LEAST_DAMPING = 1e-2  # tried first where a step does not descend; about WEIGHT_DISPLACEMENT, or it changes nothing
MOST_DAMPING = 1e6
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
    for i in range(n):
        for c in range(3):
            out[extra + i, c] = canonical[i, c]
    for end in range(2):
        root = 0 if end == 0 else n - 1
        inward = 1 if end == 0 else -1
        normal = _end_normal(canonical, root, inward)
        for k in range(1, extra + 1):
            row = root - inward * k + extra
            onto = 0.0
            for c in range(3):
                onto += 2.0 * normal[c] * (canonical[root + inward * k, c] - canonical[root, c])
            for c in range(3):
                out[row, c] = 2.0 * canonical[root, c] + onto * normal[c] - canonical[root + inward * k, c]
    return out


@kernel
def _end_normal(points: NDArray[np.float64], root: int, inward: int) -> tuple[float, float, float]:
    """Unit normal at an end: turned on from the two points beside it, then made to stand on the tangent there.

    The second differences of a helix point at its axis however coarse the sampling, and all turn alike. The tangent
    is that of the cubic through four points: without it, the rough centreline's errors would leave a corner. Zero
    where the end is straight.
    """
    tangent = np.empty(3)
    bend1 = np.empty(3)
    bend2 = np.empty(3)
    for c in range(3):
        p0 = points[root, c]
        p1 = points[root + inward, c]
        p2 = points[root + 2 * inward, c]
        p3 = points[root + 3 * inward, c]
        tangent[c] = (-11.0 * p0 + 18.0 * p1 - 9.0 * p2 + 2.0 * p3) / 6.0
        bend1[c] = p0 - 2.0 * p1 + p2
        bend2[c] = p1 - 2.0 * p2 + p3
    least2 = (STRAIGHT * _norm(tangent)) ** 2
    if not min(_norm(bend1) ** 2, _norm(bend2) ** 2) > least2:
        return 0.0, 0.0, 0.0
    both = _inner(bend1, bend2) / (_norm(bend1) * _norm(bend2))
    normal = np.empty(3)
    for c in range(3):
        normal[c] = 2.0 * both * bend1[c] / _norm(bend1) - bend2[c] / _norm(bend2)
    along = _inner(normal, tangent) / _inner(tangent, tangent)
    for c in range(3):
        normal[c] -= along * tangent[c]
    size = _norm(normal)
    if not size > STRAIGHT:
        return 0.0, 0.0, 0.0
    return normal[0] / size, normal[1] / size, normal[2] / size


@kernel
def _inner(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def _norm(a: NDArray[np.float64]) -> float:
    return np.sqrt(_inner(a, a))


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
def _distances(axis: NDArray[np.float64], strand: NDArray[np.float64], r: NDArray[np.float64]) -> float:
    """Fill r (n,) with the distances between an axis (n, 2) and a strand (n, 3) at each height; return their mean."""
    n = axis.shape[0]
    total = 0.0
    for i in range(n):
        r[i] = np.sqrt((axis[i, 0] - strand[i, 0]) ** 2 + (axis[i, 1] - strand[i, 1]) ** 2)
        total += r[i]
    return total / n


@kernel
def objective(axis: NDArray[np.float64], r: NDArray[np.float64], mean: float, unit: float, stiffness: float) -> float:
    """What ``optimise`` minimises, for an axis (n, 2) and its distances r (n,) of a known mean."""
    n = axis.shape[0]
    adjacent = WEIGHT_ADJACENT * unit**2
    curvature = stiffness * unit**4
    total = 0.0
    for i in range(n):
        total += (r[i] - mean) ** 2
        total += WEIGHT_DISPLACEMENT * (axis[i, 0] ** 2 + axis[i, 1] ** 2)
        if i > 0:
            total += adjacent * (r[i] - r[i - 1]) ** 2
        if 0 < i < n - 1:
            for c in range(2):
                total += curvature * (axis[i + 1, c] - 2.0 * axis[i, c] + axis[i - 1, c]) ** 2
    return 0.5 * total


@kernel
def _directions(
    axis: NDArray[np.float64], strand: NDArray[np.float64], r: NDArray[np.float64], mean: float, u: NDArray[np.float64]
) -> None:
    """Fill u (n, 2) with the derivatives of the distances: unit vectors from the strand to the axis."""
    n = axis.shape[0]
    for i in range(n):
        if r[i] > TOUCHING * mean:
            for c in range(2):
                u[i, c] = (axis[i, c] - strand[i, c]) / r[i]
        else:
            # The axis touches the strand: it should leave towards the inside of the bend.
            a = max(i - 1, 0)
            b = min(i + 1, n - 1)
            x = strand[a, 0] + strand[b, 0] - 2.0 * strand[i, 0]
            y = strand[a, 1] + strand[b, 1] - 2.0 * strand[i, 1]
            size = np.sqrt(x * x + y * y)
            u[i, 0] = x / size if size > 0.0 else 0.0
            u[i, 1] = y / size if size > 0.0 else 0.0


@kernel
def _normal_equations(
    axis: NDArray[np.float64],
    r: NDArray[np.float64],
    mean: float,
    u: NDArray[np.float64],
    unit: float,
    stiffness: float,
    damping: float,
    band: NDArray[np.float64],
    right: NDArray[np.float64],
) -> None:
    """Fill the Gauss-Newton matrix (2n, BAND + 1) and, in column 0 of ``right`` (2n, 2), the descent direction.

    The mean distance is held there; column 1 holds its coupling to the unknowns.
    """
    n = axis.shape[0]
    adjacent = WEIGHT_ADJACENT * unit**2
    curvature = stiffness * unit**4
    band[:] = 0.0
    for i in range(n):
        for c in range(2):
            right[2 * i + c, 0] = -u[i, c] * (r[i] - mean) - WEIGHT_DISPLACEMENT * axis[i, c]
            right[2 * i + c, 1] = u[i, c]
        # Each difference of distances weighs on its own point and, at i > 0, on the one before.
        share = 1.0 + adjacent * ((1.0 if i > 0 else 0.0) + (1.0 if i < n - 1 else 0.0))
        band[2 * i, 0] = share * u[i, 0] * u[i, 0] + WEIGHT_DISPLACEMENT + damping
        band[2 * i + 1, 0] = share * u[i, 1] * u[i, 1] + WEIGHT_DISPLACEMENT + damping
        band[2 * i + 1, 1] = share * u[i, 0] * u[i, 1]
        if i > 0:
            for c in range(2):
                step = adjacent * (r[i] - r[i - 1])
                right[2 * i + c, 0] -= step * u[i, c]
                right[2 * i - 2 + c, 0] += step * u[i - 1, c]
                for d in range(2):
                    band[2 * i + c, 2 + c - d] = -adjacent * u[i, c] * u[i - 1, d]
    for i in range(1, n - 1):
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


@kernel
def optimise(strand: NDArray[np.float64], unit: float, stiffness: float = WEIGHT_CURVATURE) -> NDArray[np.float64]:
    """Axis (n, 2) [cm] that a canonical strand (n, 3) winds around at an even distance, each point at its own height.

    Minimises half the sum of (r_i - mean r)^2, of the weighted squares of the steps of r between neighbours, of the
    displacement from the z-axis, and, by ``stiffness``, of the axis' second differences, over lengths measured in
    ``unit``, samples per radian of a turn. Gauss-Newton on the banded normal equations; the mean distance moves along
    as one more unknown, eliminated by its Schur complement; Levenberg's damping where a step would not descend.
    """
    n = strand.shape[0]
    axis = np.zeros((n, 2))
    trial = np.empty((n, 2))
    r = np.empty(n)
    trial_r = np.empty(n)
    u = np.empty((n, 2))
    band = np.empty((2 * n, BAND + 1))
    right = np.empty((2 * n, 2))
    damping = FIRST_DAMPING
    mean = _distances(axis, strand, r)
    value = objective(axis, r, mean, unit, stiffness)
    for _ in range(MOST_ITERATIONS):
        _directions(axis, strand, r, mean, u)
        _normal_equations(axis, r, mean, u, unit, stiffness, damping, band, right)
        descends = False
        largest = np.inf
        if _solve_band(band, right):
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
            mean_there = _distances(trial, strand, trial_r)
            there = objective(trial, trial_r, mean_there, unit, stiffness)
            descends = there <= value
            if descends:
                gain = value - there
                axis, trial = trial, axis
                r, trial_r = trial_r, r
                mean = mean_there
                value = there
                if gain <= SMALL_GAIN * value:
                    break
                damping *= 0.1
        if largest <= SMALL_STEP * mean:
            break
        if not descends:
            damping = max(10.0 * damping, LEAST_DAMPING)
            if damping > MOST_DAMPING:
                break
    return axis


@kernel
def _centerline(
    points: NDArray[np.float64], styleless_turns: float, out: NDArray[np.float64], rough: NDArray[np.float64]
) -> None:
    """Fill ``out`` (n, 3) with the world-space centreline of a strand (n, 3), and ``rough`` (n, 3) with its start.

    A strand without curl, or of fewer than three distinct points, is its own centreline.
    """
    for i in range(points.shape[0]):
        for c in range(3):
            out[i, c] = points[i, c]
            rough[i, c] = points[i, c]
    knots = distinct_points(points)
    if knots.shape[0] < 3:
        return
    at = chord_lengths(points)
    t = chord_lengths(knots)
    slopes = spline_slopes(t, knots)
    segments = knots.shape[0] - 1
    m = max(FEWEST_SAMPLES, min(SAMPLES_PER_SEGMENT * segments, max(ENOUGH_SAMPLES, segments)))
    grid = uniform_grid(t[-1], m)
    dense = spline_sample(t, knots, slopes, grid)
    guide = dct_centerline(dense, FEWEST_FREQUENCIES)
    turns, curl = curl_turns(dense, guide)
    if not (turns >= FEWEST_TURNS and curl * turns * turns >= LEAST_CURL):
        _interpolate(grid, guide, at, rough)
        return
    enough = max(FEWEST_SAMPLES, int(SAMPLES_PER_TURN * turns))
    if enough < m:
        m = enough
        grid = uniform_grid(t[-1], m)
        dense = spline_sample(t, knots, slopes, grid)
    style_turns = turns if styleless_turns == 0.0 else styleless_turns
    most = MOST_FREQUENCIES * max(turns / style_turns, 1.0)
    frequencies = min(max(np.round(turns / TURNS_PER_FREQUENCY), FEWEST_FREQUENCIES), most)
    guide = dct_centerline(dense, int(frequencies))
    _interpolate(grid, guide, at, rough)
    extra = int(EXTENSION * m)
    stiffness = WEIGHT_CURVATURE * max(1.0, style_turns / SOFT_TURNS) ** STIFFENING
    axis = optimise(_extend(phi(dense, guide), extra), m / (2.0 * np.pi * turns), stiffness)
    rotation = guide_frames(guide)
    for i in range(m + 1):
        x = axis[extra + i, 0]
        y = axis[extra + i, 1]
        for c in range(3):
            guide[i, c] += rotation[i, 0, c] * x + rotation[i, 1, c] * y
    _interpolate(grid, guide, at, out)


@kernel
def _interpolate(
    grid: NDArray[np.float64], guide: NDArray[np.float64], at: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    """Fill ``out`` (n, 3) with the spline through a guide on a grid, at parameters ``at`` (n,)."""
    values = spline_sample(grid, guide, spline_slopes(grid, guide), at)
    for i in range(at.shape[0]):
        for c in range(3):
            out[i, c] = values[i, c]


@parallel_kernel
def _centerlines(
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    styleless_turns: float,
    guides: NDArray[np.float64],
    starts: NDArray[np.float64],
) -> None:
    for s in prange(offsets.shape[0] - 1):
        a = offsets[s]
        b = offsets[s + 1]
        _centerline(points[a:b], styleless_turns, guides[a:b], starts[a:b])


def centerlines(
    points: ArrayLike, offsets: ArrayLike, styleless_turns: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centrelines (P, 3) [cm] of all strands, and their rough starts (P, 3) from the lowest frequencies alone.

    points: (P, 3), strand s in rows offsets[s] to offsets[s + 1]. A strand without curl, of fewer than three
    distinct points, or with a coordinate that is not finite is its own centreline. ``styleless_turns``: the axes may
    bend as those of strands of exactly so many turns do, however many there are; for strands that have no style to
    follow. 0: the more turns, the stiffer, as a style's bends are as long as the strand.
    """
    points = compiled_input(points, np.float64)
    guides = np.empty(points.shape)
    starts = np.empty(points.shape)
    _centerlines(points, compiled_input(offsets, np.int64), float(styleless_turns), guides, starts)
    return guides, starts
