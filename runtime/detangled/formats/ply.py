"""Strands in PLY files, in the two ways they are found.

- ``vertex`` (x, y, z; red, green, blue, alpha; thickness), ``strand`` (``nsegs``, points less one) and ``edge``
  elements. This one is written.
- ``vertex`` alone, the same count of points for all strands, each strand in a colour of its own, as trimesh writes the
  point clouds of image-based methods: the count is told by the colours, else it is 100.

Every scalar property of vertices and strands is an attribute; those of several numbers are written as several
properties and put together again by a comment in the header, which also says unit, up axis and objects. Other files
say none of these; y is taken to be up.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detangled.axes import AXES
from detangled.errors import ReadError
from detangled.formats import register
from detangled.formats.blocks import as_float32
from detangled.formats.ply_tables import Table, read_tables, write_tables
from detangled.groom import Attribute, Groom, Scope, offsets_of

VERTEX, STRAND, EDGE, SEGMENTS = "vertex", "strand", "edge", "nsegs"
POSITION = ("x", "y", "z")
# Properties that other programs know, for the attributes that go by other names here.
KNOWN: dict[str, tuple[tuple[str, ...], ...]] = {
    "color": (("red", "green", "blue", "alpha"), ("red", "green", "blue")),
    "N": (("nx", "ny", "nz"),),
    "uv": (("s", "t"), ("u", "v"), ("texture_u", "texture_v")),
    "width": (("thickness",),),
    "transparency": (("alpha",),),
}
DEFAULT_UP = "y"
POINTS_A_STRAND = 100
MARK = "detangled "


def read(path: Path) -> Groom:
    """Read a groom, lengths as they stand in the file. Raises ReadError where its elements make no strands."""
    tables, comments, left = read_tables(path)
    if VERTEX not in tables or not set(POSITION) <= set(tables[VERTEX].dtype.names or ()):
        raise ReadError(f"{path}: holds no vertices with x, y and z")
    vertices = tables[VERTEX]
    said = _said(comments)
    points = np.column_stack([vertices[name] for name in POSITION]).astype(np.float64)
    found = _attributes(vertices, Scope.POINT, said, set(POSITION))
    notes = [f"skipped the elements {', '.join(left)}"] if left else []
    if STRAND in tables and SEGMENTS in (tables[STRAND].dtype.names or ()):
        counts = tables[STRAND][SEGMENTS].astype(np.int64) + 1
        if np.any(counts < 1) or int(counts.sum()) != len(points):
            raise ReadError(
                f"{path}: damaged: it holds {len(points):,} points, its {len(counts):,} strands {int(counts.sum()):,}"
            )
        found |= _attributes(tables[STRAND], Scope.STRAND, said, {SEGMENTS})
    else:
        count, note = _points_a_strand(path, found.get("color"), len(points))
        notes.append(note)
        counts = np.full(len(points) // count, count, dtype=np.int64)
        if "color" in found:
            found["color"] = Attribute(found["color"].values[::count], Scope.STRAND)
    fields: dict[str, Any] = {"up": DEFAULT_UP}
    unit, up, names = said.get("unit_cm"), said.get("up"), said.get("objects")
    if isinstance(unit, int | float) and 0.0 < unit < np.inf:
        fields |= {"unit_cm": float(unit), "unit_source": "file"}
    if up in AXES:
        fields["up"] = up
    if isinstance(names, list) and names and all(isinstance(name, str) for name in names):
        fields["objects"] = tuple(names)
    return Groom(points, offsets_of(counts), attributes=found, notes=tuple(notes), **fields)


def write(groom: Groom, path: Path) -> list[str]:
    """Write strands whose lengths are in the file's unit, as vertices, strands and edges, in binary.

    Attributes of the whole groom are written once a strand. Texts, and whole numbers beyond 32 bits, are listed as
    lost.
    """
    lost = []
    empty = int(np.count_nonzero(groom.point_counts == 0))
    if empty:
        lost.append(f"{empty} strand{'s' if empty > 1 else ''} without points left out")
        groom = groom.select(groom.point_counts > 0)
    segments = groom.point_counts - 1
    columns: dict[Scope, dict[str, NDArray[Any]]] = {Scope.POINT: {}, Scope.STRAND: {}}
    columns[Scope.POINT] = dict(zip(POSITION, as_float32(groom.points).T, strict=True))
    # Other readers look for 16 bits; longer strands are not theirs to read then.
    small = int(segments.max(initial=0)) <= np.iinfo(np.uint16).max
    columns[Scope.STRAND] = {SEGMENTS: segments.astype("<u2" if small else "<u4")}
    if not small:
        lost.append("a strand of more than 65,536 points needs counts of 32 bits, which few other programs read")
    about: dict[str, Any] = {}
    for name, attribute in groom.attributes.items():
        scope = Scope.POINT if attribute.scope is Scope.POINT else Scope.STRAND
        values = _storable(attribute.values)
        if values is None:
            lost.append(f"attribute {name!r} was not kept: PLY has no place for {attribute.values.dtype} values")
            continue
        if attribute.scope is Scope.GROOM:
            values = np.repeat(values, groom.strand_count, axis=0)
        shape = list(values.shape[1:])
        flat = values.reshape(len(values), int(np.prod(shape, dtype=np.int64)))
        fields = _fields(name, flat.shape[1], values.dtype, columns[scope])
        columns[scope] |= dict(zip(fields, flat.T, strict=True))
        about.setdefault(scope.value, {})[name] = {
            "fields": fields,
            "shape": shape,
            "type": str(attribute.values.dtype),
            "groom": attribute.scope is Scope.GROOM,
        }
    starts = np.arange(len(groom.points))[_leads_on(groom)]
    edges = {"vertex1": starts.astype("<i4"), "vertex2": (starts + 1).astype("<i4")}
    said = {"unit_cm": groom.unit_cm, "up": groom.up, "objects": list(groom.objects), "attributes": about}
    tables = {VERTEX: _table(columns[Scope.POINT]), STRAND: _table(columns[Scope.STRAND]), EDGE: _table(edges)}
    write_tables(path, tables, [MARK + json.dumps(said)])
    return lost


def _leads_on(groom: Groom) -> NDArray[np.bool_]:
    """Whether a point has a next one on its strand, (P,)."""
    leads = np.ones(len(groom.points), dtype=bool)
    leads[groom.offsets[1:] - 1] = False
    return leads


def _said(comments: list[str]) -> dict[str, Any]:
    """What a file written here says of itself."""
    for comment in comments:
        if comment.startswith(MARK):
            try:
                said = json.loads(comment[len(MARK) :])
            except ValueError:
                continue
            if isinstance(said, dict):
                return said
    return {}


def _attributes(table: Table, scope: Scope, said: dict[str, Any], taken: set[str]) -> dict[str, Attribute]:
    """The attributes that the fields of a table make: as the file says, as people know them, or each by itself."""
    found: dict[str, Attribute] = {}
    free = [name for name in table.dtype.names or () if name not in taken]
    told = said.get("attributes", {})
    for name, entry in (told.get(scope.value, {}) if isinstance(told, dict) else {}).items():
        made = _as_told(table, scope, entry, free)
        if made is not None:
            found[name] = made
            free = [field for field in free if field not in entry["fields"]]
    for name, ways in KNOWN.items():
        for way in ways:
            if name not in found and set(way) <= set(free) and len({table.dtype[field] for field in way}) == 1:
                values = np.column_stack([table[field] for field in way])
                found[name] = Attribute(_native(values if len(way) > 1 else values[:, 0]), scope)
                free = [field for field in free if field not in way]
    return found | {name: Attribute(_native(table[name]), scope) for name in free if name not in found}


def _as_told(table: Table, scope: Scope, entry: Any, free: list[str]) -> Attribute | None:
    """One attribute as the file's comment has it; None where the comment does not fit the fields."""
    try:
        fields, shape, dtype = entry["fields"], tuple(map(int, entry["shape"])), np.dtype(entry["type"])
        if not fields or not set(fields) <= set(free) or dtype.kind not in "biuf":
            return None
        values = np.column_stack([table[field] for field in fields]).reshape(len(table), *shape).astype(dtype)
    except (KeyError, TypeError, ValueError):
        return None
    if entry.get("groom") and len(values):
        return Attribute(values[:1], Scope.GROOM)
    return Attribute(values, scope)


def _points_a_strand(path: Path, color: Attribute | None, points: int) -> tuple[int, str]:
    """How many points every strand has in a file that does not say it, and how it was told."""
    if color is not None and points:
        changes = np.flatnonzero(np.any(np.diff(color.values.astype(np.int64), axis=0) != 0, axis=1)) + 1
        # Neighbours may have the same colour by chance: their common measure is what a strand has.
        count = int(np.gcd.reduce(np.diff([0, *changes.tolist(), points])))
        if 1 < count < points:
            return count, f"taken as strands of {count} points, by their colours"
    if points % POINTS_A_STRAND:
        raise ReadError(
            f"{path}: does not say where its strands begin: it has no element 'strand' with {SEGMENTS!r}, "
            f"no colours that tell them apart, and its {points:,} points are not strands of {POINTS_A_STRAND}"
        )
    return POINTS_A_STRAND, f"taken as strands of {POINTS_A_STRAND} points, since the file does not say"


def _fields(name: str, width: int, dtype: np.dtype[Any], taken: dict[str, Any]) -> list[str]:
    """Property names for an attribute: those people know, else its own, numbered where it has several numbers."""
    for way in KNOWN.get(name, ()):
        # Colours that others can read are bytes, and the alpha of a colour is no transparency.
        fits = name != "transparency" and (name != "color" or dtype == np.uint8)
        if fits and len(way) == width and not set(way) & set(taken):
            return list(way)
    plain = "".join(c if c.isascii() and (c.isalnum() or c in "_.:-") else "_" for c in name) or "attribute"
    fields = [plain] if width == 1 else [f"{plain}_{i}" for i in range(width)]
    while set(fields) & set(taken):
        fields = [f"{field}_" for field in fields]
    return fields


def _storable(values: NDArray[Any]) -> NDArray[Any] | None:
    """The values in a type that PLY has, or None."""
    kind, size = values.dtype.kind, values.dtype.itemsize
    if values.size == 0 and values.ndim > 1:
        return None
    if kind == "b":
        return values.astype(np.uint8)
    if kind == "f":
        return values.astype(np.float32 if size <= 4 else np.float64)
    if kind in "iu" and size <= 4:
        return values
    if kind in "iu" and values.size:
        for dtype in (np.int32, np.uint32):
            if values.min() >= np.iinfo(dtype).min and values.max() <= np.iinfo(dtype).max:
                return values.astype(dtype)
    return None


def _table(columns: dict[str, NDArray[Any]]) -> Table:
    length = len(next(iter(columns.values())))
    table = np.empty(length, dtype=[(name, column.dtype.newbyteorder("<")) for name, column in columns.items()])
    for name, column in columns.items():
        table[name] = column
    return table


def _native(values: NDArray[Any]) -> NDArray[Any]:
    return values.astype(values.dtype.newbyteorder("="))


register((".ply",), read, write)
