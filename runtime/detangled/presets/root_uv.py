"""Texture coordinates of roots, for a groom that has none of a head."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.groom import Groom

_AXES = "xyz"


def spherical(groom: Groom) -> NDArray[np.float32]:
    """Coordinates (S, 2) of roots seen from the middle of them all: longitude about the up axis, latitude from below.

    What Unreal makes for a groom without root UVs. Strands of no points get 0, 0.
    """
    out = np.zeros((groom.strand_count, 2), dtype=np.float32)
    filled = groom.point_counts > 0
    roots = groom.points[groom.offsets[:-1][filled]]
    if not len(roots):
        return out
    up = _AXES.index(groom.up)
    away = roots - 0.5 * (roots.min(axis=0) + roots.max(axis=0))
    height = away[:, up]
    east, north = away[:, (up + 1) % 3], away[:, (up + 2) % 3]
    out[filled, 0] = 0.5 + np.arctan2(north, east) / (2.0 * np.pi)
    out[filled, 1] = 0.5 + np.arctan2(height, np.hypot(east, north)) / np.pi
    return out
