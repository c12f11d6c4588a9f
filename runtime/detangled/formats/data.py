"""USC-HairSalon's strands (.data): a count of strands; of each its count of points and the points themselves.

Little-endian: int32 strands; for each int32 n and n x 3 float32 (Hu, Ma, Luo, Li 2015, "Single-View Hair Modeling
Using A Hairstyle Database"). Strands of one point occur. The file says neither unit nor up axis; the database's own
are y up, in metres.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from detangled.errors import ReadError
from detangled.formats import objects, register
from detangled.formats.blocks import Blocks, as_float32
from detangled.groom import Groom, offsets_of
from detangled.kernels import kernel

DEFAULT_UP = "y"
WORD = 4  # bytes of an int32 or float32


def read(path: Path) -> Groom:
    """Read a groom, lengths as they stand in the file. Raises ReadError where its counts lead beyond its end."""
    blocks = Blocks(path)
    strands = int(blocks.take("the number of strands", 0, 1, "<i4")[0])
    words = blocks.take("whole words", 0, len(blocks) // WORD, "<i4")
    if strands < 0 or strands >= len(words):
        raise ReadError(
            f"{path}: no .data file, or cut short: it tells of {strands:,} strands and has {len(blocks):,} bytes"
        )
    counts, found = _counts(np.ascontiguousarray(words, dtype=np.int32), strands)
    if found < strands:
        at = 1 + found + 3 * int(counts[:found].sum())
        if at >= len(words):
            raise ReadError(f"{path}: cut short: it tells of {strands:,} strands and ends after {found:,}")
        raise ReadError(
            f"{path}: damaged or cut short: strand {found} tells of {int(words[at]):,} points, "
            f"and {WORD * (len(words) - at - 1):,} bytes are left"
        )
    offsets = offsets_of(counts)
    end = 1 + strands + 3 * int(offsets[-1])
    is_point = np.ones(end, dtype=bool)
    is_point[0] = False
    is_point[_count_places(offsets)] = False
    points = words[:end].view("<f4")[is_point].reshape(-1, 3)
    left = len(blocks) - WORD * end
    notes = (f"{left:,} bytes behind the last strand were left out",) if left else ()
    return Groom(points, offsets, up=DEFAULT_UP, notes=notes)


def write(groom: Groom, path: Path) -> list[str]:
    """Write strands whose lengths are in the file's unit; the sentences say what such a file has no place for."""
    words = np.empty(1 + groom.strand_count + 3 * len(groom.points), dtype="<i4")
    is_point = np.ones(len(words), dtype=bool)
    is_point[0] = False
    places = _count_places(groom.offsets)
    is_point[places] = False
    words[0] = groom.strand_count
    words[places] = groom.point_counts
    words.view("<f4")[is_point] = as_float32(groom.points).ravel()
    words.tofile(path)
    lost = objects.lost_names(groom)
    if groom.up != DEFAULT_UP:
        lost.append(f"{groom.up} stays up, but a .data file cannot say so: most programs will take {DEFAULT_UP}")
    lost += [f"attribute {name!r} was not kept: .data files hold none" for name in objects.other_attributes(groom)]
    return lost


def _count_places(offsets: NDArray[np.int64]) -> NDArray[np.int64]:
    """Which word of the file holds each strand's count, (S,)."""
    return 1 + np.arange(len(offsets) - 1) + 3 * offsets[:-1]


@kernel
def _counts(words: NDArray[np.int32], strands: int) -> tuple[NDArray[np.int64], int]:
    """Points of each strand (S,), and how many strands the words hold before one leads beyond their end."""
    counts = np.zeros(strands, dtype=np.int64)
    at = 1
    for strand in range(strands):
        if at >= len(words):
            return counts, strand
        count = words[at]
        if count < 0 or count > (len(words) - at - 1) // 3:
            return counts, strand
        counts[strand] = count
        at += 1 + 3 * count
    return counts, strands


register((".data",), read, write)
