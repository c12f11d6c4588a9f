"""Transforms above curves in a scene, applied to their points and to the attributes that turn or grow with them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.axes import DIRECTIONS
from detangled.groom import Attribute

NORMALS = frozenset({"N", "normal", "normals", "surface_normal"})


def to_world(
    points: NDArray[np.float64], found: dict[str, Attribute], matrix: NDArray[np.float64]
) -> tuple[NDArray[np.float64], dict[str, Attribute]]:
    """Apply a matrix (4, 4) of row vectors to points (P, 3), and to the widths and directions among attributes.

    Widths grow by the cube root of the volume's growth; normals turn by the inverse transpose and keep their length.
    """
    if np.array_equal(matrix, np.eye(4)):
        return points, found
    turn = matrix[:3, :3]
    scale = abs(np.linalg.det(turn)) ** (1 / 3)
    found = dict(found)
    with np.errstate(all="ignore"):
        points = points @ turn + matrix[3, :3]
        for name, a in found.items():
            if a.values.dtype.kind != "f":
                continue
            values = a.values.astype(np.float64)
            if name == "width":
                values = values * scale
            elif name in NORMALS and values.shape[1:] == (3,) and scale > 0:
                turned = values @ np.linalg.inv(turn).T
                length = np.linalg.norm(turned, axis=1, keepdims=True)
                values = turned * np.where(length > 0, np.linalg.norm(values, axis=1, keepdims=True) / length, 1)
            elif name in DIRECTIONS - NORMALS and values.shape[1:] == (3,):
                values = values @ turn
            else:
                continue
            found[name] = Attribute(values.astype(a.values.dtype), a.scope)
    return points, found
