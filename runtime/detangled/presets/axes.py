"""Grooms turned so that another axis points up: rotations alone, so that no curl changes hands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from detangled.groom import Attribute, Groom

_AXES = "xyz"
# Attributes of three numbers that are directions.
DIRECTIONS = ("N", "velocities")


def turn(old: str, new: str) -> NDArray[np.float64]:
    """The quarter turn (3, 3) that takes the axis ``old`` to ``new``; points are rows: ``points @ turn``.

    From y to z it takes (x, y, z) to (x, -z, y), as all programs do.
    """
    a, b = _AXES.index(old), _AXES.index(new)
    matrix = np.eye(3)
    if a != b:
        matrix[[a, b], [a, b]] = 0.0
        matrix[a, b], matrix[b, a] = 1.0, -1.0
    return matrix


def turned(groom: Groom, matrix: NDArray[np.float64], up: str) -> Groom:
    """The groom, its normals and velocities turned by a rotation (3, 3); ``up`` is its new axis."""
    attributes = {
        name: Attribute((a.values @ matrix).astype(a.values.dtype), a.scope)
        if name in DIRECTIONS and a.values.shape[1:] == (3,) and a.values.dtype.kind == "f"
        else a
        for name, a in groom.attributes.items()
    }
    return replace(groom, points=groom.points @ matrix, attributes=attributes, up=up)
