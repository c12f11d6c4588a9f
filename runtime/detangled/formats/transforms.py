"""Transforms above curves in a scene, applied to their points and to attributes that stand in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.axes import Role, role_of
from detangled.groom import Attribute


def to_world(
    points: NDArray[np.float64], found: dict[str, Attribute], matrix: NDArray[np.float64]
) -> tuple[NDArray[np.float64], dict[str, Attribute]]:
    """Apply a matrix (4, 4) of row vectors to points (P, 3), and to lengths, directions and places among attributes.

    Lengths grow by the cube root of the volume's growth; normals turn by the inverse transpose and keep their length.
    """
    if np.array_equal(matrix, np.eye(4)):
        return points, found
    turn = matrix[:3, :3]
    scale = abs(np.linalg.det(turn)) ** (1 / 3)
    found = dict(found)
    with np.errstate(all="ignore"):
        points = points @ turn + matrix[3, :3]
        for name, a in found.items():
            role = role_of(name, a)
            if role is None or (role is Role.NORMAL and not scale > 0):
                continue
            values = a.values.astype(np.float64)
            if role is Role.LENGTH:
                values = values * scale
            elif role is Role.NORMAL:
                turned = values @ np.linalg.inv(turn).T
                length = np.linalg.norm(turned, axis=1, keepdims=True)
                values = turned * np.where(length > 0, np.linalg.norm(values, axis=1, keepdims=True) / length, 1)
            elif role is Role.PLACE:
                values = values @ turn + matrix[3, :3]
            else:
                values = values @ turn
            # Whole numbers that grow are fractions.
            found[name] = Attribute(values.astype(a.values.dtype) if a.values.dtype.kind == "f" else values, a.scope)
    return points, found
