"""Polygon meshes in Alembic files, read through the official library's bindings, every transform above them applied."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from alembic3d import Abc, AbcGeom
from numpy.typing import NDArray

from detangled.errors import ReadError
from detangled.formats import abc_check
from detangled.formats.abc_values import BINDING_ERRORS
from detangled.formats.abc_walk import matrix_of, walk

_UV = "uv"


class AbcMesh(NamedTuple):
    """A mesh as it stands in a file: positions (V, 3), corners a face (F,), their vertices (C,), uv (C, 2) or None."""

    name: str
    points: NDArray[np.float64]
    counts: NDArray[np.int64]
    corners: NDArray[np.int64]
    uv: NDArray[np.float64] | None


def read_meshes(path: Path) -> list[AbcMesh]:
    """All meshes of the first time sample, in the world's frame, lengths as they stand in the file.

    Raises ReadError where the file is no Alembic file or is damaged.
    """
    abc_check.check(path)
    try:
        archive = Abc.IArchive(str(path))
        found = []
        for thing, above in walk(archive.getTop()):
            for kind in (AbcGeom.IPolyMesh, AbcGeom.ISubD):
                if kind.matches(thing.getHeader()):
                    found += _mesh(kind(thing.getParent(), thing.getName()), matrix_of(above))
        return found
    except BINDING_ERRORS as error:
        raise ReadError(f"{path}: damaged, or not as Alembic lays it down: {error}") from error


def _mesh(thing: Any, matrix: NDArray[np.float64]) -> list[AbcMesh]:
    schema = thing.getSchema()
    if not schema.getNumSamples():
        return []
    sample = schema.getValue()
    points = np.array(np.asarray(sample.getPositions()), dtype=np.float64).reshape(-1, 3)
    counts = np.array(np.asarray(sample.getFaceCounts()), dtype=np.int64).reshape(-1)
    corners = np.array(np.asarray(sample.getFaceIndices()), dtype=np.int64).reshape(-1)
    points = points @ matrix[:3, :3] + matrix[3, :3]
    # Alembic's faces are clockwise seen from outside; a mirroring transform turns them once more.
    if np.linalg.det(matrix[:3, :3]) > 0.0:
        starts = np.repeat(np.cumsum(counts) - counts, counts)
        last = starts + np.repeat(counts, counts) - 1
        order = last - (np.arange(len(corners)) - starts) if len(starts) == len(corners) else np.arange(len(corners))
    else:
        order = np.arange(len(corners))
    return [AbcMesh(thing.getName(), points, counts, corners[order], _uv(schema, corners, order))]


def _uv(schema: Any, corners: NDArray[np.int64], order: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """Texture coordinates of each corner, where the mesh has some that fit it."""
    parameter = schema.getUVsParam()
    if not parameter.valid() or parameter.getNumSamples() == 0:
        return None
    values = np.array(np.asarray(parameter.getExpandedValue().getVals()), dtype=np.float64).reshape(-1, 2)
    if len(values) == len(corners):
        return values[order]
    if len(corners) and len(values) == corners.max() + 1:
        return values[corners[order]]
    return None
