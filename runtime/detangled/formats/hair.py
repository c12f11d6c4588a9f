"""Cem Yuksel's .hair files: a header of 128 bytes, then arrays over all strands or points.

Little-endian (cyHairFile.h, Yuksel 2007): ``HAIR``; uint32 strands, points, flags, default segments; float32 default
thickness and transparency; 3 float32 default colour; 88 characters of any text. Then, where flagged and in this
order: uint16 segments a strand (points less one); float32 points (3), thickness, transparency, colour (3), all a
point. Such files say neither unit nor up axis (the models on his page are z up); files written here say both in the
text.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detangled.errors import ReadError, WriteError
from detangled.formats import objects, register
from detangled.formats.blocks import Blocks, as_float32
from detangled.groom import Attribute, Groom, Scope, offsets_of

MAGIC = b"HAIR"
HEADER = np.dtype(
    [
        ("magic", "S4"),
        ("strands", "<u4"),
        ("points", "<u4"),
        ("flags", "<u4"),
        ("segments", "<u4"),
        ("width", "<f4"),
        ("transparency", "<f4"),
        ("color", "<f4", 3),
        ("text", "S88"),
    ]
)
SEGMENTS, POINTS = 1, 2
# Attributes by their flags, the shape of a value, and what the header of a file without them says (cyHairFile.h).
ATTRIBUTES: dict[str, tuple[int, tuple[int, ...], float]] = {
    "width": (4, (), 1.0),
    "transparency": (8, (), 0.0),
    "color": (16, (3,), 1.0),
}
MOST_SEGMENTS = np.iinfo(np.uint16).max
MOST_POINTS = np.iinfo(np.uint32).max
DEFAULT_UP = "z"
TEXT = re.compile(r"^detangled: 1 unit is ([0-9.e+-]+) cm, ([xyz]) is up")


def read(path: Path) -> Groom:
    """Read a groom, lengths as they stand in the file. Raises ReadError where header and size do not agree."""
    blocks = Blocks(path)
    if blocks.bytes[: len(MAGIC)].tobytes() != MAGIC:
        raise ReadError(f"{path}: no .hair file: it does not begin with 'HAIR'")
    header = blocks.take("the header", 0, 1, HEADER)[0]
    strands, points, flags = int(header["strands"]), int(header["points"]), int(header["flags"])
    if not flags & POINTS:
        raise ReadError(f"{path}: holds no points, by its header")
    at = HEADER.itemsize
    if flags & SEGMENTS:
        segments = blocks.take("the segments of its strands", at, strands, "<u2")
        at += segments.nbytes
        told = int(segments.sum(dtype=np.int64)) + strands
    else:
        told = strands * (int(header["segments"]) + 1)
    if told != points:
        raise ReadError(f"{path}: damaged: its header tells of {points:,} points, its {strands:,} strands of {told:,}")
    positions = blocks.take("its points", at, 3 * points, "<f4").reshape(-1, 3)
    at += positions.nbytes
    counts = segments.astype(np.int64) + 1 if flags & SEGMENTS else np.full(strands, int(header["segments"]) + 1)
    attributes = {}
    for name, (flag, shape, default) in ATTRIBUTES.items():
        if flags & flag:
            values = blocks.take(f"values of {name}", at, points * int(np.prod(shape, dtype=int)), "<f4")
            at += values.nbytes
            attributes[name] = Attribute(values.reshape(-1, *shape), Scope.POINT)
        elif np.any(header[name] != default):
            attributes[name] = Attribute(np.array([header[name]], dtype=np.float32), Scope.GROOM)
    fields: dict[str, Any] = {"up": DEFAULT_UP}
    said = TEXT.match(header["text"].decode("latin-1"))
    if said and _is_unit(said[1]):
        fields = {"unit_cm": float(said[1]), "unit_source": "file", "up": said[2]}
    return Groom(positions, offsets_of(counts), attributes=attributes, **fields)


def write(groom: Groom, path: Path) -> list[str]:
    """Write strands whose lengths are in the file's unit.

    Widths, transparencies and colours are kept, other attributes listed. Raises WriteError for strands of more than
    65,536 points, and more than 4,294,967,295 points in all.
    """
    longest = int(groom.point_counts.max(initial=0))
    if longest > MOST_SEGMENTS + 1:
        raise WriteError(
            f"{path}: strand {int(np.argmax(groom.point_counts))} has {longest:,} points, "
            f".hair files take {MOST_SEGMENTS + 1:,} a strand: write another format"
        )
    if len(groom.points) > MOST_POINTS:
        raise WriteError(f"{path}: {len(groom.points):,} points, .hair files take {MOST_POINTS:,}")
    empty = int(np.count_nonzero(groom.point_counts == 0))
    lost = []
    if empty:
        lost.append(f"{empty} strand{'s' if empty > 1 else ''} without points left out")
        groom = groom.select(groom.point_counts > 0)
    header = np.zeros(1, dtype=HEADER)
    header["magic"], header["strands"], header["points"] = MAGIC, groom.strand_count, len(groom.points)
    header["flags"] = SEGMENTS | POINTS
    header["text"] = f"detangled: 1 unit is {groom.unit_cm!r} cm, {groom.up} is up".encode()
    arrays: list[NDArray[Any]] = [(groom.point_counts - 1).astype("<u2"), as_float32(groom.points)]
    kept = set()
    for name, (flag, shape, default) in ATTRIBUTES.items():
        header[name] = default
        attribute = groom.attributes.get(name)
        if attribute is None or attribute.values.dtype.kind != "f" or attribute.values.shape[1:] != shape:
            continue
        kept.add(name)
        values = as_float32(attribute.values)
        if attribute.scope is Scope.GROOM and np.any(values != np.float32(default)):
            header[name] = values[0]
        else:
            header["flags"] |= flag
            arrays.append(_a_point(groom, values, attribute.scope))
    with open(path, "wb") as file:
        file.write(header.tobytes())
        for array in arrays:
            array.tofile(file)
    lost += objects.lost_names(groom)
    others = [name for name in objects.other_attributes(groom) if name not in kept]
    return lost + [f"attribute {name!r} was not kept: .hair files have no place for it" for name in others]


def _a_point(groom: Groom, values: NDArray[np.float32], scope: Scope) -> NDArray[np.float32]:
    if scope is Scope.POINT:
        return values
    return np.repeat(values, groom.point_counts if scope is Scope.STRAND else len(groom.points), axis=0)


def _is_unit(text: str) -> bool:
    try:
        return 0.0 < float(text) < np.inf
    except ValueError:
        return False


register((".hair",), read, write)
