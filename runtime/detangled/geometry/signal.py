"""A strand as curvature, torsion and speed (kappa, tau, v) on a grid of cells, and back.

Paper sections "Differentiable Curves" and "Strand Reconstruction". Each cell holds the mean over its width, which is
smoothing before sampling, so a twist narrower than a cell keeps its angle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.geometry.frenet import frames, integrate, lift_tiny, twist_angle
from detangled.geometry.smoothing import smooth_channels
from detangled.geometry.spline import (
    chord_lengths,
    distinct_points,
    spline_sample,
    spline_slopes,
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
MOST_TURN = 0.35  # [rad] in one step of integration: the local error of RK4 is then below 1e-4 rad


@kernel
def dense_count(points: int) -> int:
    """Number of intervals of the dense grid for a strand of so many points."""
    segments = points - 1
    return max(FEWEST_SAMPLES, min(SAMPLES_PER_SEGMENT * segments, max(ENOUGH_SAMPLES, 2 * segments)))


@kernel
def dense_signal(
    points: NDArray[np.float64], cells: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]:
    """kappa, tau [1/cm] and speed (m + 1,) of one strand (n, 3) of distinct points, on a uniform grid of its length.

    Speed is arc length per polyline length; the last value returned is the polyline's length [cm]. The grid is fine
    enough for means over ``cells`` cells. tau is the angle by which the normal turns about the tangent carried
    along, between the neighbours of a sample: the numerical derivative that the paper allows in place of the third,
    which keeps the angles and rebuilds the strand more closely.
    """
    t = chord_lengths(points)
    length = t[-1]
    m = max(dense_count(points.shape[0]), 2 * cells)
    step = length / m
    most_blur = MOST_BLUR_CELLS * m / cells
    curve = spline_sample(t, points, spline_slopes(t, points), np.arange(m + 1) * step)
    smooth_channels(curve, step, most_blur)
    first = uniform_slopes(curve, step)
    lift_tiny(first)
    smooth_channels(first, step, most_blur)
    second = uniform_slopes(first, step)
    lift_tiny(second)
    smooth_channels(second, step, most_blur)
    tangent, normal, _ = frames(first, second)
    kappa = np.empty(m + 1)
    tau = np.empty(m + 1)
    speed = np.empty(m + 1)
    for i in range(m + 1):
        speed2 = 0.0
        bend = 0.0
        for c in range(3):
            speed2 += first[i, c] ** 2
            bend += second[i, c] * normal[i, c]
        speed[i] = np.sqrt(speed2)
        kappa[i] = max(bend, 0.0) / speed2
        low = max(i - 1, 0)
        high = min(i + 1, m)
        tau[i] = twist_angle(tangent, normal, low, high) / ((high - low) * step * speed[i])
    return kappa, tau, speed, length


@kernel
def cell_means(
    kappa: NDArray[np.float64],
    tau: NDArray[np.float64],
    speed: NDArray[np.float64],
    length: float,
    cells: int,
) -> NDArray[np.float64]:
    """Means (cells, 3) of a dense signal over each cell; kappa and tau by arc length, v in cm per unit of t."""
    m = kappa.shape[0] - 1
    total = np.zeros((m + 1, 3))  # angle of bending, angle of torsion, arc length, summed up from the root
    for i in range(m):
        total[i + 1, 0] = total[i, 0] + 0.5 * (kappa[i] * speed[i] + kappa[i + 1] * speed[i + 1])
        total[i + 1, 1] = total[i, 1] + 0.5 * (tau[i] * speed[i] + tau[i + 1] * speed[i + 1])
        total[i + 1, 2] = total[i, 2] + 0.5 * (speed[i] + speed[i + 1])
    out = np.empty((cells, 3))
    before = np.zeros(3)
    here = np.zeros(3)
    for j in range(cells):
        at = (j + 1) * m / cells
        i = min(int(at), m - 1)
        for c in range(3):
            here[c] = total[i, c] + (at - i) * (total[i + 1, c] - total[i, c])
        arc = here[2] - before[2]
        out[j, 0] = (here[0] - before[0]) / arc
        out[j, 1] = (here[1] - before[1]) / arc
        out[j, 2] = arc * cells * length / m
        before[:] = here
    return out


@parallel_kernel
def signals(
    points: NDArray[np.float64], offsets: NDArray[np.int64], cell_offsets: NDArray[np.int64]
) -> NDArray[np.float64]:
    """kappa, tau, v of all strands, (C, 3) with strand s in rows cell_offsets[s] to cell_offsets[s + 1].

    kappa, tau in 1/cm; v in cm per unit of t, with t from 0 to 1 along the strand, so the mean of v is its arc
    length. A strand of fewer than two distinct points gets zeros.
    """
    out = np.zeros((cell_offsets[-1], 3))
    for s in prange(offsets.shape[0] - 1):
        strand = distinct_points(points[offsets[s] : offsets[s + 1]])
        cells = cell_offsets[s + 1] - cell_offsets[s]
        if strand.shape[0] >= 2 and cells > 0:
            kappa, tau, speed, length = dense_signal(strand, cells)
            out[cell_offsets[s] : cell_offsets[s + 1]] = cell_means(kappa, tau, speed, length, cells)
    return out


@kernel
def substeps_for(signal: NDArray[np.float64]) -> int:
    """Integration steps a cell of a signal (L, 3) needs so that none turns the frame by more than MOST_TURN."""
    cells = signal.shape[0]
    most = 0.0
    for i in range(cells):
        most = max(most, np.sqrt(signal[i, 0] ** 2 + signal[i, 1] ** 2) * signal[i, 2] / cells)
    return int(min(max(np.ceil(most / MOST_TURN), 2), 64))


@kernel
def curve_of(signal: NDArray[np.float64]) -> NDArray[np.float64]:
    """The curve (L * substeps + 1, 3) [cm] of a signal (L, 3), from the origin, starting along -z."""
    return integrate(signal[:, 0], signal[:, 1], signal[:, 2], substeps_for(signal))
