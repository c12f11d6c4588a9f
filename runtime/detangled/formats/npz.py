"""Grooms as NumPy archives (.npz): ``cnt`` and ``data``, or one plain (S, N, 3) array.

``cnt``: (S,) whole numbers, points of each strand; ``data``: (P, 3), all points, root first. Files written
here add ``unit_cm``, ``up``, ``objects`` and one ``attr:<scope>:<name>`` array an attribute. Coordinates are
float32.
"""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detangled.archives import DAMAGE, read_arrays, write_arrays
from detangled.errors import DetangledError, ReadError
from detangled.formats import register
from detangled.groom import Attribute, Groom, Scope, offsets_of

COUNTS, POINTS, UNIT, UP, OBJECTS = "cnt", "data", "unit_cm", "up", "objects"
ATTRIBUTE_PREFIX = "attr:"
DEFAULT_UP = "z"


def read(path: Path) -> Groom:
    """Read a groom, lengths as they stand in the file. Raises ReadError where the arrays make no groom."""
    if not zipfile.is_zipfile(path):
        raise ReadError(f"{path}: not a .npz file (a zip archive of arrays), or cut short")
    try:
        arrays = read_arrays(path)
    except DAMAGE as error:
        raise ReadError(f"{path}: its arrays cannot be read: {error}") from error
    if COUNTS in arrays or POINTS in arrays:
        return _from_counts(path, arrays)
    return _from_grid(path, arrays)


def write(groom: Groom, path: Path) -> list[str]:
    """Write a groom whose lengths are in the file's unit; say which attributes have no plain array type."""
    arrays: dict[str, NDArray[Any]] = {
        COUNTS: groom.point_counts.astype(np.int32),
        POINTS: _float32(groom.points),
        UNIT: np.array([groom.unit_cm]),
        UP: np.array([groom.up]),
        OBJECTS: np.array(groom.objects, dtype=np.str_),
    }
    lost = []
    for name, attribute in groom.attributes.items():
        if attribute.values.dtype.hasobject:
            lost.append(f"attribute {name!r} was not kept: its values are Python objects")
        else:
            arrays[f"{ATTRIBUTE_PREFIX}{attribute.scope.value}:{name}"] = attribute.values
    write_arrays(path, arrays)
    return lost


def _from_counts(path: Path, arrays: dict[str, NDArray[Any]]) -> Groom:
    missing = {COUNTS, POINTS} - arrays.keys()
    if missing:
        raise ReadError(f"{path}: has no array {missing.pop()!r}, only {', '.join(sorted(arrays))}")
    counts, points = arrays[COUNTS], arrays[POINTS]
    if counts.ndim != 1 or counts.dtype.kind not in "iu":
        raise ReadError(f"{path}: 'cnt' must be whole numbers of shape (S,), not {counts.dtype} {counts.shape}")
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise ReadError(f"{path}: 'data' must be numbers of shape (P, 3), not {points.dtype} {points.shape}")
    counts = counts.astype(np.int64)
    if np.any(counts < 0) or np.any(counts > len(points)) or int(counts.sum()) != len(points):
        below = np.flatnonzero(counts < 0)
        negative = f" and gives strand {below[0]} {counts[below[0]]} points" if len(below) else ""
        raise ReadError(f"{path}: 'cnt' adds up to {int(counts.sum())} points{negative}, 'data' holds {len(points)}")
    fields: dict[str, Any] = {"up": DEFAULT_UP}
    if UNIT in arrays:
        fields |= {"unit_cm": _unit(path, arrays[UNIT]), "unit_source": "file"}
    if UP in arrays:
        fields["up"] = _up(path, arrays[UP])
    if OBJECTS in arrays and arrays[OBJECTS].dtype.kind == "U" and arrays[OBJECTS].size:
        fields["objects"] = tuple(arrays[OBJECTS].ravel().tolist())
    attributes = {}
    notes = []
    for key in arrays.keys() - {COUNTS, POINTS, UNIT, UP, OBJECTS}:
        if not key.startswith(ATTRIBUTE_PREFIX):
            notes.append(f"array {key!r} was left out: its name does not say what it belongs to")
    for key, values in arrays.items():
        if key.startswith(ATTRIBUTE_PREFIX):
            scope, _, name = key[len(ATTRIBUTE_PREFIX) :].partition(":")
            if scope not in {s.value for s in Scope} or not name:
                raise ReadError(f"{path}: array {key!r} names no scope (groom, strand or point) and attribute")
            attributes[name] = Attribute(values, Scope(scope))
    offsets = offsets_of(counts)
    try:
        return Groom(points, offsets, attributes=attributes, notes=tuple(sorted(notes)), **fields)
    except DetangledError as error:
        raise ReadError(f"{path}: {error}") from None


def _from_grid(path: Path, arrays: dict[str, NDArray[Any]]) -> Groom:
    grids = {k: a for k, a in arrays.items() if a.ndim == 3 and a.shape[2] == 3 and a.dtype.kind in "fiu"}
    if len(grids) != 1:
        held = ", ".join(f"{k} {a.dtype} {a.shape}" for k, a in sorted(arrays.items())) or "nothing"
        raise ReadError(f"{path}: needs 'cnt' and 'data', or one array of shape (S, N, 3); it holds {held}")
    (name, grid), *_ = grids.items()
    others = sorted(arrays.keys() - {name})
    notes = (f"left out the arrays {', '.join(others)}",) if others else ()
    offsets = np.arange(grid.shape[0] + 1, dtype=np.int64) * grid.shape[1]
    return Groom(grid.reshape(-1, 3), offsets, up=DEFAULT_UP, notes=notes)


def _unit(path: Path, values: NDArray[Any]) -> float:
    if values.size != 1 or values.dtype.kind not in "fiu" or not 0.0 < float(values.ravel()[0]) < np.inf:
        raise ReadError(f"{path}: 'unit_cm' must be one number above 0")
    return float(values.ravel()[0])


def _up(path: Path, values: NDArray[Any]) -> str:
    if values.size != 1 or str(values.ravel()[0]) not in ("x", "y", "z"):
        raise ReadError(f"{path}: 'up' must be x, y or z")
    return str(values.ravel()[0])


def _float32(points: NDArray[np.float64]) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):
        return points.astype(np.float32)


register((".npz",), read, write)
