"""A strand as curvature, torsion and speed (kappa, tau, v) on a grid of cells, and back.

Paper sections "Differentiable Curves" and "Strand Reconstruction". Each cell holds the mean over its width, which is
smoothing before sampling, so a twist narrower than a cell keeps its angle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.geometry.frenet import TINY, bend_angle, frames, integrate, lift_tiny, twist_angle
from detangled.geometry.inputs import compiled_input
from detangled.geometry.smoothing import smooth_channels
from detangled.geometry.spline import (
    NEAREST,
    chord_lengths,
    distinct_points,
    spline_sample,
    spline_slopes,
    uniform_grid,
    uniform_slopes,
)
from detangled.kernels import kernel, parallel_kernel, prange

SAMPLES_PER_SEGMENT = 8
FEWEST_SAMPLES = 256
# Beyond this many samples a strand was densely sampled by its author already, and twice its points suffice.
ENOUGH_SAMPLES = 1024
# The smoothing may blur a sample as much as the mean over a cell does: that is the deviation of a box one cell wide.
# Unbounded, it moves the rebuilt strand several times as far from the strand (benchmarks/fidelity.py).
MOST_BLUR_CELLS = 1.0 / 12.0**0.5
# Coordinates rounded to float32 (6e-8 of their size, which may be several times the strand's length) bend a straight
# strand of n points by some n^2 times this [rad]: less bend than that says nothing of the normal. The cap leaves the
# normals of finely sampled strands that bend on purpose.
ROUNDING_BEND = 2e-6
MOST_ROUNDING_BEND = 0.25
MOST_TURN = 0.35  # [rad] in one step of integration: the local error of RK4 is then below 1e-4 rad
MOST_SUBSTEPS = 64


@kernel
def dense_count(points: int, cells: int) -> int:
    """Number of intervals of the dense grid for a strand of so many points, fine enough for so many cells."""
    segments = points - 1
    wanted = max(FEWEST_SAMPLES, min(SAMPLES_PER_SEGMENT * segments, max(ENOUGH_SAMPLES, 2 * segments)))
    return max(wanted, 2 * cells)


@kernel
def derivatives(
    points: NDArray[np.float64], samples: int, most_blur: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Smoothed gamma' and gamma'' (samples + 1, 3) of a strand (n, 3) of distinct points, and their distance [cm].

    The grid is uniform over the polyline's length; most_blur is in samples (``smooth_channels``).
    """
    t = chord_lengths(points)
    step = t[-1] / samples
    curve = spline_sample(t, points, spline_slopes(t, points), uniform_grid(t[-1], samples))
    smooth_channels(curve, step, most_blur)
    first = uniform_slopes(curve, step)
    lift_tiny(first)
    smooth_channels(first, step, most_blur)
    second = uniform_slopes(first, step)
    lift_tiny(second)
    smooth_channels(second, step, most_blur)
    return first, second, step


@kernel
def cumulated(
    first: NDArray[np.float64], second: NDArray[np.float64], step: float, per_segment: float, least_bend: float
) -> NDArray[np.float64]:
    """Angle of bending, angle of torsion [rad] and arc length [cm] from the root to each sample, (m, 3).

    The integrals of kappa, tau and 1 over arc length. Each interval adds the angle between its two tangents, and
    the angle about them between its two normals: the numerical differentiation of T and N that the paper allows.
    It keeps angles whole however narrow the event, stays finite where the speed vanishes, and rebuilds the strand
    more closely than gamma'' and gamma''' do (benchmarks/fidelity.py). Where the normal is not the curve's own, the
    bending is the part towards it, which may be negative: rounding and ringing then cancel out.
    """
    tangent, normal, own = frames(first, second, step, per_segment, least_bend)
    m = first.shape[0]
    total = np.zeros((m, 3))
    before = 0.0
    for i in range(m):
        speed = np.sqrt(first[i, 0] ** 2 + first[i, 1] ** 2 + first[i, 2] ** 2)
        if i > 0:
            bend = 0.0
            if own[i - 1] or own[i]:
                bend = bend_angle(tangent, i - 1)
            else:
                for c in range(3):
                    bend += 0.5 * (normal[i - 1, c] + normal[i, c]) * (tangent[i, c] - tangent[i - 1, c])
            total[i, 0] = total[i - 1, 0] + bend
            total[i, 1] = total[i - 1, 1] + twist_angle(tangent, normal, i - 1)
            total[i, 2] = total[i - 1, 2] + 0.5 * (before + speed) * step
        before = speed
    return total


@kernel
def cell_means(total: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Fill ``out`` (L, 3) with kappa, tau and v of L equal cells, from their integrals (m + 1, 3) on a finer grid."""
    cells = out.shape[0]
    m = total.shape[0] - 1
    # A cell that the strand crosses in no time (it folds back on itself there) keeps its angles.
    least_arc = 1e-9 * total[m, 2] / cells
    before = np.empty(3)
    here = np.zeros(3)
    for j in range(cells):
        at = (j + 1) * m / cells
        i = min(int(at), m - 1)
        for c in range(3):
            before[c] = here[c]
            here[c] = total[i, c] + (at - i) * (total[i + 1, c] - total[i, c])
        arc = max(here[2] - before[2], least_arc)
        out[j, 0] = (here[0] - before[0]) / arc
        out[j, 1] = (here[1] - before[1]) / arc
        out[j, 2] = arc * cells


@kernel
def _signal(points: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Fill ``out`` (L, 3) with kappa, tau, v of one strand (n, 3); leave it where the strand has no length."""
    strand = distinct_points(points)
    n = strand.shape[0]
    cells = out.shape[0]
    if n < 2 or cells == 0:
        return
    samples = dense_count(n, cells)
    first, second, step = derivatives(strand, samples, MOST_BLUR_CELLS * samples / cells)
    least_bend = min(ROUNDING_BEND * n * n, MOST_ROUNDING_BEND)
    cell_means(cumulated(first, second, step, samples / (n - 1), least_bend), out)


@parallel_kernel
def _signals(
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    cell_offsets: NDArray[np.int64],
    out: NDArray[np.float64],
) -> None:
    for s in prange(offsets.shape[0] - 1):
        _signal(points[offsets[s] : offsets[s + 1]], out[cell_offsets[s] : cell_offsets[s + 1]])


def signals(points: ArrayLike, offsets: ArrayLike, cell_offsets: ArrayLike) -> NDArray[np.float64]:
    """kappa, tau, v of all strands, (C, 3) with strand s in rows cell_offsets[s] to cell_offsets[s + 1].

    points: (P, 3) [cm], strand s in rows offsets[s] to offsets[s + 1]. kappa, tau in 1/cm; v in cm per unit of t,
    with t from 0 to 1 along the strand's polyline, so the mean of v is the strand's arc length. A strand of fewer
    than two distinct points, or with a coordinate that is not finite, gets zeros.
    """
    cells = compiled_input(cell_offsets, np.int64)
    out = np.zeros((cells[-1], 3))
    _signals(compiled_input(points, np.float64), compiled_input(offsets, np.int64), cells, out)
    return out


@kernel
def substeps_for(signal: NDArray[np.float64]) -> int:
    """Integration steps a cell of a signal (L, 3) needs so that none turns the frame by more than MOST_TURN."""
    cells = signal.shape[0]
    most = 0.0
    for i in range(cells):
        most = max(most, np.sqrt(signal[i, 0] ** 2 + signal[i, 1] ** 2) * signal[i, 2] / cells)
    return int(max(np.ceil(min(most / MOST_TURN, MOST_SUBSTEPS)), 2))


@kernel
def finer_cells(signal: NDArray[np.float64], parts: int) -> NDArray[np.float64]:
    """The signal (L, 3) on cells of a part of the width, (L * parts, 3), with the same means over the old cells.

    A cubic spline goes through the angles that the edges of the cells are turned by, so that kappa and tau go on
    smoothly from cell to cell. Taken as constant in each cell, they would be averaged twice, once when a strand was
    measured and again when what is rebuilt is looked at on other cells (benchmarks/fidelity.py).
    """
    cells = signal.shape[0]
    arcs = np.zeros(cells + 1)
    turned = np.zeros((cells + 1, 2))
    least_width = max(NEAREST * np.mean(signal[:, 2]) / cells, TINY)
    for i in range(cells):
        width = max(signal[i, 2] / cells, least_width)
        arcs[i + 1] = arcs[i] + width
        for c in range(2):
            turned[i + 1, c] = turned[i, c] + signal[i, c] * width
    fine = np.empty(cells * parts + 1)
    for i in range(cells):
        for j in range(parts):
            fine[i * parts + j] = arcs[i] + (arcs[i + 1] - arcs[i]) * (j / parts)
    fine[cells * parts] = arcs[cells]
    smooth = spline_sample(arcs, turned, spline_slopes(arcs, turned), fine)
    out = np.empty((cells * parts, 3))
    for i in range(cells):
        width = (arcs[i + 1] - arcs[i]) / parts
        least = 0.0
        for j in range(i * parts, (i + 1) * parts):
            for c in range(2):
                out[j, c] = (smooth[j + 1, c] - smooth[j, c]) / width
            out[j, 2] = signal[i, 2]
            least = min(least, out[j, 0])
        if least < 0.0:
            # The spline may not make curvature negative: less of it, the mean kept. A mean below 0, of a straight
            # strand's rounding, stays.
            mean = signal[i, 0]
            share = max(mean, 0.0) / (max(mean, 0.0) - least)
            for j in range(i * parts, (i + 1) * parts):
                out[j, 0] = max(mean + share * (out[j, 0] - mean), min(mean, 0.0))
    return out


@kernel
def curve_of(signal: NDArray[np.float64]) -> NDArray[np.float64]:
    """The curve (L * substeps + 1, 3) [cm] of a signal (L, 3), from the origin, starting along -z."""
    return integrate(finer_cells(signal, substeps_for(signal)), 1)


@parallel_kernel
def curve_counts(values: NDArray[np.float64], starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Points (S,) of the curve that ``curve_of`` makes of each signal."""
    out = np.empty(starts.shape[0] - 1, dtype=np.int64)
    for s in prange(starts.shape[0] - 1):
        signal = values[starts[s] : starts[s + 1]]
        out[s] = signal.shape[0] * substeps_for(signal) + 1
    return out


@parallel_kernel
def curves(values: NDArray[np.float64], starts: NDArray[np.int64], offsets: NDArray[np.int64]) -> NDArray[np.float64]:
    """Curves (P, 3) [cm] of signals (C, 3); ``offsets`` are the cumulated ``curve_counts``."""
    out = np.empty((offsets[-1], 3))
    for s in prange(starts.shape[0] - 1):
        out[offsets[s] : offsets[s + 1]] = curve_of(values[starts[s] : starts[s + 1]])
    return out
