"""Heads in mesh files: .obj, .ply, .stl, .glb and .gltf through trimesh, .abc through Alembic's own library.

Polygons become triangles, several meshes one, and texture coordinates stay with the corners that they belong to.
"""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from detangled.errors import ReadError
from detangled.formats.mesh_groups import faces_of_group, few
from detangled.geometry.orientation import orientation
from detangled.head import Head
from detangled.units import cm_per_unit

SUFFIXES = (".abc", ".glb", ".gltf", ".obj", ".ply", ".stl")
# Largest extents [cm] of what hair grows on: a head with some of its neck, a whole body.
TYPICAL_EXTENTS_CM = (27.0, 170.0)
GUESSED_UNITS = ("m", "dm", "cm", "mm")
GLTF_UNIT_CM = 100.0  # its specification says metres
_WORDS = {"m": "metres", "dm": "decimetres", "cm": "centimetres", "mm": "millimetres"}


class _Part(NamedTuple):
    """Triangles of one mesh in a file: vertices (V, 3), faces (F, 3), uv (F, 3, 2) or None."""

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    uv: NDArray[np.float64] | None


def read_head(path: Path, unit: str | None = None, group: str | None = None) -> Head:
    """Read the mesh that a groom grows on, in cm, in the file's own axes, its faces looking outwards.

    unit: name of the file's unit; by default what the file says (.glb, .gltf), else the one in which it would be
    nearest to the size of a head or a whole body, with a note. group: names of groups, objects or materials of faces,
    with commas between them; by default what is named as skin (``body``, or ``face``, ``head``, ``scalp``), else all.
    Raises ReadError where the file is missing, damaged, of another kind, or has no faces, or not the group.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        said = f"files ending in {path.suffix}" if suffix else "files without a suffix"
        raise ReadError(f"{path}: {said} are not known as heads; these are: {', '.join(SUFFIXES)}")
    try:
        parts, notes = _parts(path, suffix, group)
    except FileNotFoundError:
        raise ReadError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise ReadError(f"{path}: a folder, not a file") from None
    except OSError as error:
        raise ReadError(f"{path}: cannot be read: {error.strerror or error}") from error
    vertices, faces, uv, more = _merged(parts)
    notes += more
    if len(faces) == 0:
        raise ReadError(f"{path}: the head has no faces: it takes a mesh of polygons")
    if unit is not None:
        unit_cm = cm_per_unit(unit)
    elif suffix in (".glb", ".gltf"):
        unit_cm = GLTF_UNIT_CM
    else:
        name = _guessed_unit(vertices[faces].reshape(-1, 3))
        unit_cm = cm_per_unit(name)
        notes.append(f"taken as {_WORDS[name]} from its size; --head-unit says otherwise")
    found = orientation(vertices, faces)
    if found.crowded:
        notes.append(f"{found.crowded} edges have more than two faces: what is inside is told by winding numbers")
    if found.askew:
        notes.append(f"{np.count_nonzero(found.turned)} faces looked another way than their neighbours: turned over")
    elif found.turned.any():
        notes.append("its faces looked inwards: turned over")
    faces = np.where(found.turned[:, None], faces[:, ::-1], faces)
    if uv is not None:
        uv = np.where(found.turned[:, None, None], uv[:, ::-1], uv)
    return Head(vertices * unit_cm, faces, uv, tuple(notes), unit_cm)


def _parts(path: Path, suffix: str, group: str | None) -> tuple[list[_Part], list[str]]:
    """The meshes of a file that are asked for, and what there is to say."""
    if suffix == ".abc":
        from detangled.formats.abc_meshes import read_meshes

        with open(path, "rb"):
            pass  # so that a missing file is said to be missing
        parts = [_fanned(*mesh) for mesh in read_meshes(path)]
        return _named(parts, group, path), []
    content = path.read_bytes()
    if not content:
        raise ReadError(f"{path}: the file is empty (0 bytes)")
    if suffix == ".obj":
        content, said = faces_of_group(content, group, str(path))
        return _by_trimesh(path, suffix, content), [said] if said else []
    return _named(_by_trimesh(path, suffix, content), group, path), []


@contextmanager
def _hushed() -> Iterator[None]:
    """Without what trimesh tells its own log of what it skips: what counts is told here."""
    log = logging.getLogger("trimesh")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)


@_hushed()
def _by_trimesh(path: Path, suffix: str, content: bytes) -> list[_Part]:
    import trimesh

    try:
        resolver = trimesh.resolvers.FilePathResolver(str(path)) if suffix == ".gltf" else None
        scene: Any = trimesh.load(
            io.BytesIO(content), file_type=suffix[1:], process=False, resolver=resolver, skip_materials=True
        )
    except Exception as error:  # whatever its many parsers meet in a damaged file
        raise ReadError(f"{path}: damaged, or not what its name says: {error}") from error
    if isinstance(scene, trimesh.Scene):
        placed = [(node, *scene.graph[node]) for node in scene.graph.nodes_geometry]
        meshes = [(f"{node} {name}", scene.geometry[name], matrix) for node, matrix, name in placed]
    else:
        meshes = [(path.stem, scene, np.eye(4))]
    return [_part(name, mesh, matrix) for name, mesh, matrix in meshes if isinstance(mesh, trimesh.Trimesh)]


def _part(name: str, mesh: Any, matrix: NDArray[np.float64]) -> _Part:
    faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    with np.errstate(all="ignore"):
        vertices = np.asarray(mesh.vertices, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    uv = getattr(mesh.visual, "uv", None)
    fits = uv is not None and len(uv) == len(vertices)
    corners = np.asarray(uv, dtype=np.float64)[faces] if fits else None
    if np.linalg.det(matrix[:3, :3]) < 0.0:
        faces = faces[:, ::-1]
        corners = None if corners is None else corners[:, ::-1]
    return _Part(name, vertices, faces, corners)


def _fanned(
    name: str,
    points: NDArray[np.float64],
    counts: NDArray[np.int64],
    corners: NDArray[np.int64],
    uv: NDArray[np.float64] | None,
) -> _Part:
    """Polygons as triangles about their first corners. Raises ReadError where their counts and indices do not agree."""
    if counts.sum() != len(corners) or (len(corners) and not 0 <= corners.min() <= corners.max() < len(points)):
        raise ReadError(f"damaged: the faces of the mesh {name!r} do not fit its {len(points)} points")
    fans = np.maximum(counts - 2, 0)
    first = np.repeat(np.cumsum(counts) - counts, fans)
    inner = np.arange(int(fans.sum())) - np.repeat(np.cumsum(fans) - fans, fans)
    rows = np.stack([first, first + inner + 1, first + inner + 2], axis=1)
    return _Part(name, points, corners[rows], None if uv is None else uv[rows])


def _named(parts: list[_Part], group: str | None, path: Path) -> list[_Part]:
    """The meshes with one of these names in theirs. Raises ReadError where a name is in none, with those there are."""
    if group is None:
        return parts
    wanted = {name.strip() for name in group.split(",") if name.strip()}
    found = [{part.name, *part.name.split()} for part in parts]
    missing = sorted(wanted.difference(*found))
    if missing or not wanted:
        names = few([part.name for part in parts])
        raise ReadError(f"{path}: has no mesh {few(missing) or repr(group)}: it has {names or 'none'}")
    return [part for part, own in zip(parts, found, strict=True) if wanted & own]


def _merged(
    parts: list[_Part],
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64] | None, list[str]]:
    """Vertices, faces and uv of all meshes as one; vertices in one place are one, and faces without extent go."""
    if not parts:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), None, []
    notes: list[str] = []
    before = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, before, strict=False)])
    vertices, same = np.unique(np.concatenate([part.vertices for part in parts]), axis=0, return_inverse=True)
    faces = same.reshape(-1)[faces]
    some = [part for part in parts if part.uv is not None]
    uv = None
    if some:
        uv = np.concatenate([np.zeros((len(part.faces), 3, 2)) if part.uv is None else part.uv for part in parts])
        if len(some) < len(parts):
            notes.append("texture coordinates are zero where meshes have none")
    finite = np.isfinite(vertices).all(axis=1)[faces].all(axis=1)
    if not finite.all():
        notes.append(f"{np.count_nonzero(~finite)} faces with coordinates that are not finite were left out")
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    kept = finite & distinct
    used, faces = np.unique(faces[kept], return_inverse=True)
    return vertices[used], faces.reshape(-1, 3), None if uv is None else uv[kept], notes


def _guessed_unit(corners: NDArray[np.float64]) -> str:
    """The unit in which these points (N, 3) would be nearest to the size of a head or a body."""
    extent = float(np.ptp(corners, axis=0).max())
    if not 0.0 < extent < np.inf:
        return "cm"

    def off(unit: str) -> float:
        return min(abs(np.log(extent * cm_per_unit(unit) / typical)) for typical in TYPICAL_EXTENTS_CM)

    return min(GUESSED_UNITS, key=off)
