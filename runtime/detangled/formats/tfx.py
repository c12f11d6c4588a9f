"""TressFX hair (.tfx), versions 3.0 and 4.0: strands of one count of points each. 4.0 is what is written.

Little-endian, a header with byte offsets of arrays, 0 where there is none. AMD's exporter negates z in 3.0 and
leaves it in 4.0; here z is turned back, so that both are right-handed. y is up; no unit is said.

In 4.0 a point has four numbers, the last its inverse mass: 0 where it is pinned. Read as the attribute
``inverse_mass``; where a groom has none, the first two points of a strand are written as pinned, as AMD's exporter
does. A strand of fewer points than the longest gets more, on its own segments, so that no curve changes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detangled.errors import ReadError, WriteError
from detangled.formats import objects, register
from detangled.formats.blocks import Blocks, as_float32
from detangled.formats.even import evened
from detangled.groom import Attribute, Groom, Scope

HEADER_3 = np.dtype(
    [
        ("version", "<f4"),
        ("strands", "<u4"),
        ("points", "<u4"),
        ("follow", "<u4"),
        ("both_ends", "<u4"),
        ("reserved", "<u4", 31),
        ("position", "<u4"),
        ("width", "<u4"),
        ("uv", "<u4"),
        ("color", "<u4"),
        ("guide", "<u4"),
        ("vertex_uv", "<u4"),
        ("reserved_2", "<u4", 32),
    ]
)
HEADER_4 = np.dtype(
    [
        ("version", "<f4"),
        ("strands", "<u4"),
        ("points", "<u4"),
        ("position", "<u4"),
        ("uv", "<u4"),
        ("vertex_uv", "<u4"),
        ("width", "<u4"),
        ("color", "<u4"),
        ("reserved", "<u4", 32),
    ]
)
FIELDS_4 = HEADER_4.names or ()
# Arrays beside the positions: scope, shape and type of a value.
ARRAYS: dict[str, tuple[Scope, tuple[int, ...], str]] = {
    "uv": (Scope.STRAND, (2,), "<f4"),
    "vertex_uv": (Scope.POINT, (2,), "<f4"),
    "width": (Scope.STRAND, (), "<f4"),
    "color": (Scope.POINT, (4,), "<f4"),
    "guide": (Scope.STRAND, (), "<u4"),
}
DEFAULT_UP = "y"
INVERSE_MASS, FOLLOW, BOTH_ENDS = "inverse_mass", "follow_hairs", "both_ends_pinned"
PINNED_AT_ROOT = 2
# What TressFX's own programs take (its header file): a power of two from 4 to 64.
POINTS_TAKEN = (4, 8, 16, 32, 64)
ALIGNMENT = 8


def read(path: Path) -> Groom:
    """Read a groom, lengths as they stand in the file. Raises ReadError where header and size do not agree."""
    blocks = Blocks(path)
    version = float(blocks.take("the version", 0, 1, "<f4")[0])
    if version not in (3.0, 4.0):
        raise ReadError(f"{path}: no TressFX file of version 3.0 or 4.0 (its first number is {version:g})")
    layout = HEADER_3 if version == 3.0 else HEADER_4
    header = blocks.take("the header", 0, 1, layout)[0]
    strands, count = int(header["strands"]), int(header["points"])
    width = 3 if version == 3.0 else 4
    if int(header["position"]) < layout.itemsize:
        raise ReadError(f"{path}: holds no points, by its header")
    rows = blocks.take("its points", int(header["position"]), strands * count * width, "<f4").reshape(-1, width)
    if count == 0:
        raise ReadError(f"{path}: holds strands without points")
    points = rows[:, :3].astype(np.float64)
    attributes = {}
    if version == 3.0:
        points[:, 2] = -points[:, 2]
        for name, value in ((FOLLOW, int(header["follow"])), (BOTH_ENDS, bool(header["both_ends"]))):
            if value:
                attributes[name] = Attribute(np.array([value]), Scope.GROOM)
    else:
        attributes[INVERSE_MASS] = Attribute(rows[:, 3], Scope.POINT)
    for name, (scope, shape, dtype) in ARRAYS.items():
        at = int(header[name]) if name in (layout.names or ()) else 0
        if at:
            size = (strands if scope is Scope.STRAND else strands * count) * int(np.prod(shape, dtype=int))
            attributes[name] = Attribute(blocks.take(f"values of {name}", at, size, dtype).reshape(-1, *shape), scope)
    offsets = np.arange(strands + 1, dtype=np.int64) * count
    return Groom(points, offsets, attributes=attributes, up=DEFAULT_UP)


def write(groom: Groom, path: Path) -> list[str]:
    """Write strands whose lengths are in the file's unit as TressFX 4.0, z as it is.

    The sentences say what was not kept, and what TressFX's own programs may not take. Raises WriteError where the
    file would be larger than its offsets can say.
    """
    lost = []
    empty = int(np.count_nonzero(groom.point_counts == 0))
    if empty:
        lost.append(f"{empty} strand{'s' if empty > 1 else ''} without points left out")
        groom = groom.select(groom.point_counts > 0)
    counts = groom.point_counts
    longest = int(counts.max(initial=1))
    if np.any(counts != longest):
        longest = next((taken for taken in POINTS_TAKEN if taken >= longest), longest)
        short = int(np.count_nonzero(counts < longest))
        lost.append(f"{short:,} strands got more points on their segments, {longest} each: .tfx knows one count only")
        groom = evened(groom, longest)
    if longest not in POINTS_TAKEN:
        lost.append(
            f"strands of {longest} points were written; TressFX's own programs take {', '.join(map(str, POINTS_TAKEN))}"
        )
    if groom.up != DEFAULT_UP:
        lost.append(f"{groom.up} stays up, but a .tfx file cannot say so: most programs will take {DEFAULT_UP}")
    found, said = _arrays(groom)
    arrays = {"position": np.column_stack([as_float32(groom.points), _inverse_masses(groom, longest)]), **found}
    header = np.zeros(1, dtype=HEADER_4)
    header["version"], header["strands"], header["points"] = 4.0, groom.strand_count, longest
    at = HEADER_4.itemsize
    for name, array in arrays.items():
        if at > np.iinfo(np.uint32).max:
            raise WriteError(f"{path}: too large for a .tfx file, whose offsets end at 4 GiB")
        header[name] = at
        at += array.nbytes + -array.nbytes % ALIGNMENT
    with open(path, "wb") as file:
        file.write(header.tobytes())
        for array in arrays.values():
            array.tofile(file)
            file.write(bytes(-array.nbytes % ALIGNMENT))
    return lost + objects.lost_names(groom) + said


def _inverse_masses(groom: Groom, count: int) -> NDArray[np.float32]:
    """0 where a point is pinned, (P,)."""
    given = groom.attributes.get(INVERSE_MASS)
    if given is not None and given.scope is Scope.POINT and given.values.ndim == 1 and given.values.dtype.kind in "fiu":
        return as_float32(given.values)
    masses = np.ones((groom.strand_count, count), dtype="<f4")
    masses[:, :PINNED_AT_ROOT] = 0.0
    both = groom.attributes.get(BOTH_ENDS)
    if both is not None and both.scope is Scope.GROOM and np.any(both.values):
        masses[:, -PINNED_AT_ROOT:] = 0.0
    return masses.ravel()


def _arrays(groom: Groom) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """What 4.0 has a place for beside the positions, in the order of its header, and sentences about the rest."""
    found: dict[str, NDArray[Any]] = {}
    said = []
    for name, attribute in objects.other_attributes(groom).items():
        place = "vertex_uv" if name == "uv" and attribute.scope is Scope.POINT else name
        scope, _, dtype = ARRAYS.get(place, (None, (), ""))
        values = attribute.values
        if name == INVERSE_MASS and attribute.scope is Scope.POINT and values.ndim == 1 and values.dtype.kind in "fiu":
            continue
        if name == BOTH_ENDS and attribute.scope is Scope.GROOM:
            continue
        if place not in FIELDS_4 or place in found or values.dtype.kind != "f" or not _fits(place, values):
            said.append(f"attribute {name!r} was not kept: .tfx files have no place for it")
            continue
        if attribute.scope is Scope.POINT and scope is Scope.STRAND:
            if _changes_along(groom, values):
                said.append(f"attribute {name!r} is kept once a strand, by its mean")
            values = np.add.reduceat(values, groom.offsets[:-1], axis=0) / _tall(groom.point_counts, values)
        elif attribute.scope is not scope:
            per = {Scope.STRAND: groom.strand_count, Scope.POINT: len(groom.points)}[scope or Scope.POINT]
            repeats = groom.point_counts if attribute.scope is Scope.STRAND else per
            values = np.repeat(values, repeats, axis=0)
        if place == "color" and values.shape[1:] == (3,):
            values = np.column_stack([values, np.ones(len(values))])
        found[place] = values.astype(dtype)
    return {name: found[name] for name in FIELDS_4 if name in found}, said


def _fits(place: str, values: NDArray[Any]) -> bool:
    # A colour without its fourth number is opaque.
    return values.shape[1:] == ARRAYS[place][1] or (place == "color" and values.shape[1:] == (3,))


def _changes_along(groom: Groom, values: NDArray[Any]) -> bool:
    first = np.repeat(values[groom.offsets[:-1]], groom.point_counts, axis=0)
    return not np.array_equal(values, first, equal_nan=True)


def _tall(counts: NDArray[np.int64], values: NDArray[Any]) -> NDArray[np.int64]:
    return counts.reshape(-1, *[1] * (values.ndim - 1))


register((".tfx",), read, write)
