"""Material frames of strands, and the quaternions that hold them.

A frame is a unit quaternion (w, x, y, z) that takes x to the tangent, y to the section's major axis and z to its minor.
Frames are carried along a strand by the least turn from each tangent to the next (Bishop 1975).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.errors import TextureError
from detangled.geometry.inputs import compiled_input
from detangled.kernels import kernel, parallel_kernel, prange


@dataclass(frozen=True)
class Pose:
    """Strands free of stress: points (P, 3) [cm], offsets (S + 1,), and frames (P, 4), of the segment after each point.

    A strand's last row of frames repeats the one before.
    """

    points: NDArray[np.float64]
    offsets: NDArray[np.int64]
    frames: NDArray[np.float64]


def posed(points: ArrayLike, offsets: ArrayLike, roll: ArrayLike = 0.0) -> Pose:
    """Strands with frames that are carried along them without twist, from the root.

    roll: (S,) or one [rad], the turn of the major axis at the root, right-handed about the first segment, from the
    coordinate axis that is least along it.
    """
    points = compiled_input(points, np.float64)
    offsets = compiled_input(offsets, np.int64)
    angles = np.broadcast_to(np.asarray(roll, dtype=np.float64), (len(offsets) - 1,))
    frames = np.full((len(points), 4), np.nan)
    _pose_all(points, offsets, compiled_input(angles, np.float64), frames)
    return Pose(points, offsets, frames)


def checked(points: ArrayLike, offsets: ArrayLike, fibres: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points and offsets as kernels take them. Raises TextureError where they do not fit, or fibres are not as many."""
    points = compiled_input(points, np.float64)
    offsets = compiled_input(offsets, np.int64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise TextureError(f"points must have the shape (P, 3), not {points.shape}")
    if offsets.ndim != 1 or len(offsets) == 0 or offsets[0] != 0 or offsets[-1] != len(points):
        raise TextureError(f"offsets must run from 0 to the number of points, {len(points)}")
    if np.any(np.diff(offsets) < 0):
        raise TextureError("offsets must not decrease")
    if fibres != len(offsets) - 1:
        raise TextureError(f"there are {fibres} fibres for {len(offsets) - 1} strands")
    return points, offsets


@kernel
def product(a: tuple, b: tuple) -> tuple:
    """The quaternion a b."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@kernel
def conjugate(a: tuple) -> tuple:
    return (a[0], -a[1], -a[2], -a[3])


@kernel
def unit(a: tuple) -> tuple:
    size = np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + a[3] * a[3])
    return (a[0] / size, a[1] / size, a[2] / size, a[3] / size)


@kernel
def row(q: NDArray[np.float64], i: int) -> tuple:
    return (q[i, 0], q[i, 1], q[i, 2], q[i, 3])


@kernel
def tangent_of(q: tuple) -> tuple:
    """Where a frame takes x."""
    w, x, y, z = q
    return (w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z), 2.0 * (x * z - w * y))


@kernel
def carried(frame: tuple, old: tuple, new: tuple) -> tuple:
    """A frame after the least rotation that takes the direction ``old``, its tangent, to ``new``."""
    dot = old[0] * new[0] + old[1] * new[1] + old[2] * new[2]
    if dot < -1.0 + 1e-12:
        # No least rotation: half a turn about the major axis.
        return product(frame, (0.0, 0.0, 1.0, 0.0))
    turn = (
        1.0 + dot,
        old[1] * new[2] - old[2] * new[1],
        old[2] * new[0] - old[0] * new[2],
        old[0] * new[1] - old[1] * new[0],
    )
    return unit(product(unit(turn), frame))


@kernel
def direction(points: NDArray[np.float64], i: int) -> tuple:
    """Unit vector and length from point i to the next; NaN where they coincide."""
    x = points[i + 1, 0] - points[i, 0]
    y = points[i + 1, 1] - points[i, 1]
    z = points[i + 1, 2] - points[i, 2]
    size = np.sqrt(x * x + y * y + z * z)
    return (x / size, y / size, z / size), size


@kernel
def _pose(points: NDArray[np.float64], roll: float, frames: NDArray[np.float64]) -> None:
    n = points.shape[0]
    if n < 2:
        for i in range(n):
            frames[i] = np.array([1.0, 0.0, 0.0, 0.0])
        return
    old, _ = direction(points, 0)
    # Two turns: x to the tangent by the frame whose y is the chosen axis made perpendicular, then the roll.
    axis = 0
    for c in range(1, 3):
        if abs(old[c]) < abs(old[axis]) - 1e-9:
            axis = c
    major = np.zeros(3)
    major[axis] = 1.0
    for c in range(3):
        major[c] -= old[axis] * old[c]
    major /= np.sqrt((major * major).sum())
    start = (1.0, 0.0, 0.0, 0.0)
    frame = carried(start, (1.0, 0.0, 0.0), old)
    y = product(product(frame, (0.0, 0.0, 1.0, 0.0)), conjugate(frame))
    z = product(product(frame, (0.0, 0.0, 0.0, 1.0)), conjugate(frame))
    cosine = y[1] * major[0] + y[2] * major[1] + y[3] * major[2]
    sine = z[1] * major[0] + z[2] * major[1] + z[3] * major[2]
    half = 0.5 * (np.arctan2(sine, cosine) + roll)
    frame = product(frame, (np.cos(half), np.sin(half), 0.0, 0.0))
    for j in range(n - 1):
        if j > 0:
            new, _ = direction(points, j)
            frame = carried(frame, old, new)
            old = new
        for c in range(4):
            frames[j, c] = frame[c]
    frames[n - 1] = frames[n - 2]


@parallel_kernel
def _pose_all(
    points: NDArray[np.float64], offsets: NDArray[np.int64], roll: NDArray[np.float64], frames: NDArray[np.float64]
) -> None:
    for s in prange(offsets.shape[0] - 1):
        _pose(points[offsets[s] : offsets[s + 1]], roll[s], frames[offsets[s] : offsets[s + 1]])
