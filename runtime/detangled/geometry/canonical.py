"""Canonical space: strands straightened along their centreline, which lies on the negative z-axis.

Paper section "Canonical Space & Style Guides": phi aligns each segment of a centreline with -z by the least rotation,
root to tip, carrying the strand's point at the segment's start and all that follows rigidly; its inverse bends the
axis onto a style guide.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.geometry.frenet import any_perpendicular, cross, dot, transport
from detangled.kernels import kernel

_DOWN = (0.0, 0.0, -1.0)


@kernel
def guide_frames(guide: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations (n, 3, 3) that phi applies at each point of a guide (n, 3): world to canonical directions.

    Rotation i turns segment i to -z, reached from rotation i - 1 by the least turn; the last point shares the last
    segment's. A segment of no length keeps the rotation before it.
    """
    n = guide.shape[0]
    out = np.empty((n, 3, 3))
    # Columns of the inverse, that is the world directions of canonical x, y and -z, carried from root to tip.
    down = _DOWN
    x = (1.0, 0.0, 0.0)
    for i in range(n):
        if i < n - 1:
            step = (
                guide[i + 1, 0] - guide[i, 0],
                guide[i + 1, 1] - guide[i, 1],
                guide[i + 1, 2] - guide[i, 2],
            )
            size = np.sqrt(dot(step, step))
            if size > 0.0:
                tangent = (step[0] / size, step[1] / size, step[2] / size)
                x = transport(x, down, tangent)
                down = tangent
                # Rounding adds up over thousands of segments: keep x a unit vector across the tangent.
                along = dot(x, down)
                x = (x[0] - along * down[0], x[1] - along * down[1], x[2] - along * down[2])
                size = np.sqrt(dot(x, x))
                x = (x[0] / size, x[1] / size, x[2] / size) if size > 0.0 else any_perpendicular(down)
        y = cross(x, down)
        for c in range(3):
            out[i, 0, c] = x[c]
            out[i, 1, c] = y[c]
            out[i, 2, c] = -down[c]
    return out


@kernel
def phi(strand: NDArray[np.float64], guide: NDArray[np.float64]) -> NDArray[np.float64]:
    """The strand (n, 3) in the canonical space of a guide with as many points (n, 3), the guide's root at 0."""
    n = strand.shape[0]
    rotation = guide_frames(guide)
    out = np.empty((n, 3))
    along = 0.0
    for i in range(n):
        if i > 0:
            along += _gap(guide, i)
        for c in range(3):
            total = 0.0
            for k in range(3):
                total += rotation[i, c, k] * (strand[i, k] - guide[i, k])
            out[i, c] = total
        out[i, 2] -= along
    return out


@kernel
def phi_inverse(canonical: NDArray[np.float64], guide: NDArray[np.float64]) -> NDArray[np.float64]:
    """The canonical strand (n, 3) bent onto a guide with as many points (n, 3): the inverse of ``phi``."""
    n = canonical.shape[0]
    rotation = guide_frames(guide)
    out = np.empty((n, 3))
    along = 0.0
    for i in range(n):
        if i > 0:
            along += _gap(guide, i)
        for k in range(3):
            out[i, k] = (
                guide[i, k]
                + rotation[i, 0, k] * canonical[i, 0]
                + rotation[i, 1, k] * canonical[i, 1]
                + rotation[i, 2, k] * (canonical[i, 2] + along)
            )
    return out


@kernel
def _gap(points: NDArray[np.float64], i: int) -> float:
    return np.sqrt(
        (points[i, 0] - points[i - 1, 0]) ** 2
        + (points[i, 1] - points[i - 1, 1]) ** 2
        + (points[i, 2] - points[i - 1, 2]) ** 2
    )
