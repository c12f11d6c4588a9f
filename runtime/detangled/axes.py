"""Which axis points up: the turn from one to another, and grooms turned by it; and what attributes are in space."""

from __future__ import annotations

from dataclasses import replace
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detangled.errors import DetangledError
from detangled.groom import Attribute, Groom

AXES = ("x", "y", "z")


class Role(Enum):
    """What the numbers of an attribute are in space, and with that how they turn, grow and move."""

    LENGTH = "length"
    NORMAL = "normal"
    DIRECTION = "direction"
    MOTION = "motion"  # a direction whose length is one in space
    PLACE = "place"


# By the names that Alembic, USD, Houdini, Unreal and Blender give them.
_NAMES = {
    Role.LENGTH: ("width", "groom_width"),
    Role.NORMAL: ("N", "normal", "normals", "surface_normal", "rest_normal"),
    Role.DIRECTION: ("tangent", "tangents", "up"),
    Role.MOTION: ("velocities", "velocity", "v", "acceleration", "accelerations"),
    Role.PLACE: ("rest", "rest_position", "Pref", "root_position", "surface_position"),
}
ROLES = {name: role for role, names in _NAMES.items() for name in names}
# Roles whose numbers change with the unit of length.
MEASURED = frozenset({Role.LENGTH, Role.MOTION, Role.PLACE})
# Roles of three numbers.
VECTORS = frozenset({Role.NORMAL, Role.DIRECTION, Role.MOTION, Role.PLACE})

# What takes a point with this axis up to one with y up, as whole numbers, so that nothing is rounded. Columns are
# where x, y and z go; z up to y up is how Blender turns what it exports.
_TO_Y = {
    "x": np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], dtype=np.float64),
    "y": np.eye(3),
    "z": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=np.float64),
}


def role_of(name: str, attribute: Attribute) -> Role | None:
    """What an attribute is by its name, where its values can be that; None for all others.

    Vectors are three fractions: ``v`` may be a texture coordinate too.
    """
    role, values = ROLES.get(name), attribute.values
    if role in VECTORS:
        return role if values.dtype.kind == "f" and values.shape[1:] == (3,) else None
    return role if values.dtype.kind in "fiu" else None


def check_axis(axis: str) -> str:
    """The axis itself. Raises DetangledError where it is not x, y or z."""
    if axis not in AXES:
        raise DetangledError(f"{axis!r} is no axis that could point up: use x, y or z")
    return axis


def turn_between(up: str, wanted: str) -> NDArray[np.float64]:
    """The rotation R (3, 3) that turns ``up`` into ``wanted``: points (P, 3) are turned by ``points @ R.T``."""
    return _TO_Y[check_axis(wanted)].T @ _TO_Y[check_axis(up)]


def turned(groom: Groom, up: str) -> Groom:
    """The groom with this axis up: its points turned, and its attributes that are directions or places.

    Which those are is known by their names (``role_of``); other attributes of three numbers stay.
    Raises DetangledError where ``up`` is not x, y or z.
    """
    if check_axis(up) == groom.up:
        return groom
    attributes = {
        name: Attribute(turned_vectors(a.values, groom.up, up), a.scope) if role_of(name, a) in VECTORS else a
        for name, a in groom.attributes.items()
    }
    return replace(groom, points=turned_vectors(groom.points, groom.up, up), attributes=attributes, up=up)


def turned_vectors(vectors: NDArray[Any], up: str, wanted: str) -> NDArray[Any]:
    """Points or directions (n, 3) turned as ``turn_between`` turns them, to the bit."""
    rotation = turn_between(up, wanted)
    # Picked and negated rather than multiplied: a product with zeros would spread what is not finite.
    source = np.argmax(np.abs(rotation), axis=1)
    signs = rotation[np.arange(3), source].astype(vectors.dtype)
    return vectors[:, source] * signs
