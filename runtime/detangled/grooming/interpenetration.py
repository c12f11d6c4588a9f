"""Hair in the head: how much of it, and guides turned about their roots until they are out.

Paper section "Treating Interpenetrations". The first millimetres belong to the skin that hair grows in, and do not
count.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.geometry.arc import resample_strand
from detangled.geometry.inputs import compiled_input
from detangled.geometry.spline import chord_lengths, distinct_points
from detangled.grooming.head_distance import HeadDistance, distance_and_gradient, distance_at
from detangled.kernels import kernel, parallel_kernel, prange

ROOT = 0.3  # [cm] along the hair, from its root, that may be in the skin
# A root below the skin has so many times its depth to come out.
WAY_OUT = 1.5
SAMPLE = 0.15  # [cm] along a guide, from one look at it to the next: about a node of the grid
AXES = 16  # about which turns are tried, around the guide's chord
FIRST_TURN = np.deg2rad(3.0)
MOST_TURN = np.deg2rad(20.0)  # beyond it, it is another hairstyle: the tip of 50 cm moves by 17 cm
HALVINGS = 8  # of a turn, to find the least
REFINEMENTS = 4  # of the best axis, each of half the angle


class OnPenetration(str, Enum):
    """What to do with hair in the head: turn and lift it out; also delete what stays in it; or leave it there."""

    ROTATE = "rotate"
    DELETE = "delete"
    KEEP = "keep"


class Inside(NamedTuple):
    """What of some strands is inside a head, their roots' first millimetres apart.

    points: (S,) inside of each strand. counted: (S,), how many were looked at. depths: (S,) [cm], of the deepest
    point; below 0 where none is inside.
    """

    points: NDArray[np.int64]
    counted: NDArray[np.int64]
    depths: NDArray[np.float64]


def inside(points: ArrayLike, offsets: ArrayLike, head: HeadDistance) -> Inside:
    """Count the points (P, 3) [cm] of strands with these offsets (S + 1,) that are inside a head."""
    arrays = compiled_input(points, np.float64), compiled_input(offsets, np.int64)
    return Inside(*_inside(*arrays, head))


def entering(points: ArrayLike, offsets: ArrayLike, head: HeadDistance, deeper_than: float = 0.0) -> NDArray[np.bool_]:
    """Which strands (S,) enter a head, also between their points, deeper than so much [cm]."""
    arrays = compiled_input(points, np.float64), compiled_input(offsets, np.int64)
    return _clearances(*arrays, head) < -deeper_than


class Turned(NamedTuple):
    """Guides (P, 3) [cm], by how much each was turned (S,) [rad], and which could not be turned out of the head."""

    points: NDArray[np.float64]
    angles: NDArray[np.float64]
    stuck: NDArray[np.bool_]


def turned_out(points: ArrayLike, offsets: ArrayLike, head: HeadDistance, clearance: float = 0.0) -> Turned:
    """Turn the strands that enter a head about their roots, each by the least angle that brings it out.

    clearance: [cm] how far outside they have to be. Rigid turns: lengths and shapes stay, and so do roots. A strand
    that no turn of up to 20 degrees brings out is left as it is.
    """
    arrays = compiled_input(points, np.float64), compiled_input(offsets, np.int64)
    return Turned(*_turned_out(*arrays, head, clearance))


@parallel_kernel
def _inside(
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    head: HeadDistance,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    count = offsets.shape[0] - 1
    within = np.zeros(count, dtype=np.int64)
    counted = np.zeros(count, dtype=np.int64)
    depths = np.full(count, -np.inf)
    for s in prange(count):
        strand = points[offsets[s] : offsets[s + 1]]
        along = chord_lengths(strand)
        for i in range(strand.shape[0]):
            if along[i] > ROOT:
                d = distance_at(head, strand[i, 0], strand[i, 1], strand[i, 2])
                counted[s] += 1
                within[s] += d < 0.0
                depths[s] = max(depths[s], -d)
    return within, counted, depths


@kernel
def _samples(points: NDArray[np.float64], head: HeadDistance) -> NDArray[np.float64]:
    """Points (n, 3), close enough to each other to miss nothing, of a strand without what may be in the skin."""
    strand = distinct_points(points)
    if strand.shape[0] < 2:
        return np.empty((0, 3))
    length = chord_lengths(strand)[-1]
    dense = resample_strand(strand, max(int(np.ceil(length / SAMPLE)), 1) + 1)
    root = distance_at(head, strand[0, 0], strand[0, 1], strand[0, 2])
    hidden = ROOT + WAY_OUT * max(-root, 0.0)
    first = int(np.floor(hidden / length * (dense.shape[0] - 1))) + 1
    return dense[min(first, dense.shape[0]) :]


@kernel
def _clearance(
    samples: NDArray[np.float64],
    root: NDArray[np.float64],
    axis: NDArray[np.float64],
    angle: float,
    head: HeadDistance,
    enough: float,
) -> float:
    """Least distance [cm] of the samples (n, 3), turned about an axis (3,) through the root, or any below ``enough``.

    Rodrigues' formula.
    """
    cosine, sine = np.cos(angle), np.sin(angle)
    least = np.inf
    # From the tip: what is furthest from the root is moved most.
    for i in range(samples.shape[0] - 1, -1, -1):
        x, y, z = samples[i, 0] - root[0], samples[i, 1] - root[1], samples[i, 2] - root[2]
        along = (axis[0] * x + axis[1] * y + axis[2] * z) * (1.0 - cosine)
        px = root[0] + x * cosine + (axis[1] * z - axis[2] * y) * sine + axis[0] * along
        py = root[1] + y * cosine + (axis[2] * x - axis[0] * z) * sine + axis[1] * along
        pz = root[2] + z * cosine + (axis[0] * y - axis[1] * x) * sine + axis[2] * along
        least = min(least, distance_at(head, px, py, pz))
        if least < enough:
            return least
    return least


@parallel_kernel
def _clearances(
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    head: HeadDistance,
) -> NDArray[np.float64]:
    out = np.full(offsets.shape[0] - 1, np.inf)
    for s in prange(offsets.shape[0] - 1):
        samples = _samples(points[offsets[s] : offsets[s + 1]], head)
        for i in range(samples.shape[0]):
            out[s] = min(out[s], distance_at(head, samples[i, 0], samples[i, 1], samples[i, 2]))
    return out


@kernel
def _least_turn(
    samples: NDArray[np.float64],
    root: NDArray[np.float64],
    axis: NDArray[np.float64],
    most: float,
    head: HeadDistance,
    clearance: float,
) -> float:
    """The least turn [rad] about an axis that brings all samples out, below ``most``; infinite if none does."""
    low, high = 0.0, FIRST_TURN
    while _clearance(samples, root, axis, high, head, clearance) < clearance:
        low = high
        high += FIRST_TURN
        if high >= most:
            return np.inf
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _clearance(samples, root, axis, middle, head, clearance) < clearance:
            low = middle
        else:
            high = middle
    return high


@kernel
def _outward_axes(
    samples: NDArray[np.float64],
    root: NDArray[np.float64],
    head: HeadDistance,
    clearance: float,
) -> NDArray[np.float64]:
    """Two axes (2, 3) across the guide: that about which the head's surface would turn it, and one across that."""
    axes = np.zeros((2, 3))
    chord = np.zeros(3)
    for i in range(samples.shape[0]):
        r = samples[i] - root
        d, gx, gy, gz = distance_and_gradient(head, samples[i, 0], samples[i, 1], samples[i, 2])
        need = max(clearance - d, 0.0)
        axes[0, 0] += need * (r[1] * gz - r[2] * gy)
        axes[0, 1] += need * (r[2] * gx - r[0] * gz)
        axes[0, 2] += need * (r[0] * gy - r[1] * gx)
        chord += need * r
    size = np.sqrt((axes[0] ** 2).sum())
    if size > 0.0:
        axes[0] /= size
    else:
        k = np.argmin(np.abs(chord))
        axes[0, k] = 1.0
    for c in range(3):
        axes[1, c] = chord[(c + 1) % 3] * axes[0, (c + 2) % 3] - chord[(c + 2) % 3] * axes[0, (c + 1) % 3]
    size = np.sqrt((axes[1] ** 2).sum())
    axes[1] /= size if size > 0.0 else 1.0
    return axes


@parallel_kernel
def _turned_out(
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    head: HeadDistance,
    clearance: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    out = points.copy()
    angles = np.zeros(offsets.shape[0] - 1)
    stuck = np.zeros(offsets.shape[0] - 1, dtype=np.bool_)
    for s in prange(offsets.shape[0] - 1):
        strand = points[offsets[s] : offsets[s + 1]]
        samples = _samples(strand, head)
        if samples.shape[0] == 0:
            continue
        root = strand[0].copy()
        if _clearance(samples, root, root, 0.0, head, clearance) >= clearance:
            continue
        axes = _outward_axes(samples, root, head, clearance)
        best, where = MOST_TURN, 0.0
        for a in range(AXES):
            around = 2.0 * np.pi * a / AXES
            axis = np.cos(around) * axes[0] + np.sin(around) * axes[1]
            turn = _least_turn(samples, root, axis, best, head, clearance)
            if turn < best:
                best, where = turn, around
        if best >= MOST_TURN:
            stuck[s] = True
            continue
        aside = np.pi / AXES
        for _ in range(REFINEMENTS):
            middle = where
            for side in (-1.0, 1.0):
                around = middle + side * aside
                axis = np.cos(around) * axes[0] + np.sin(around) * axes[1]
                turn = _least_turn(samples, root, axis, best, head, clearance)
                if turn < best:
                    best, where = turn, around
            aside *= 0.5
        axis = np.cos(where) * axes[0] + np.sin(where) * axes[1]
        angles[s] = best
        cosine, sine = np.cos(best), np.sin(best)
        for i in range(offsets[s], offsets[s + 1]):
            x, y, z = points[i, 0] - root[0], points[i, 1] - root[1], points[i, 2] - root[2]
            along = (axis[0] * x + axis[1] * y + axis[2] * z) * (1.0 - cosine)
            out[i, 0] = root[0] + x * cosine + (axis[1] * z - axis[2] * y) * sine + axis[0] * along
            out[i, 1] = root[1] + y * cosine + (axis[2] * x - axis[0] * z) * sine + axis[1] * along
            out[i, 2] = root[2] + z * cosine + (axis[0] * y - axis[1] * x) * sine + axis[2] * along
        out[offsets[s]] = root
    return out, angles, stuck
