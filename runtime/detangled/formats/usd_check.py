"""A look at a binary USD file (a crate) before the library opens it: lists whose counts lie ask it for all memory.

The library checks its arrays against the size of the file, but not the lists of names, paths and numbers among a
file's values. Where those lie is told by the section FIELDS: a packed table of values, each 64 bits: flags, a type,
and the byte where the value begins (crateFile.h in OpenUSD). What this cannot make out is left to the library.
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from detangled.errors import ReadError

MAGIC = b"PXR-USDC"
# Values were not packed before this version, which is of 2016.
FIRST_PACKED = (0, 4, 0)
# Bytes of an entry, by the type of a list; list operations hold up to this many lists behind a byte of flags.
VECTORS = {40: 4, 41: 4, 48: 8, 49: 16, 50: 4}
OPERATIONS = {32: 4, 33: 4, 34: 4, 35: 4, 36: 4, 37: 8, 38: 4, 39: 8, 55: 4}
# The bits of an operation's flags that each stand for one list that follows.
LISTS = 0b1111110
ARRAY, INLINED = 1 << 63, 1 << 62
TYPE_SHIFT, TYPE_MASK, PLACE_MASK = 48, 0xFF, (1 << 48) - 1
# Values of one file beyond which it is none that people make: unpacking stops there.
MOST_FIELDS = 1 << 24


def check(path: Path) -> None:
    """Raise ReadError where a list of a crate leads beyond the end of the file."""
    with open(path, "rb") as file:
        begin = file.read(len(MAGIC) + 3)
        if not begin.startswith(MAGIC) or tuple(begin[len(MAGIC) :]) < FIRST_PACKED:
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            _check(path, content)


def _check(path: Path, content: mmap.mmap) -> None:
    try:
        values = _values(content)
    except (struct.error, IndexError, ValueError, OverflowError):
        return
    kinds = (values >> np.uint64(TYPE_SHIFT)) & np.uint64(TYPE_MASK)
    stored = (values & np.uint64(ARRAY | INLINED)) == 0
    places = values & np.uint64(PLACE_MASK)
    for kind, at in zip(kinds[stored].tolist(), places[stored].tolist(), strict=True):
        if kind in VECTORS:
            _pass_list(path, content, at, VECTORS[kind])
        elif kind in OPERATIONS and at < len(content):
            place = at + 1
            for _ in range((content[at] & LISTS).bit_count()):
                place = _pass_list(path, content, place, OPERATIONS[kind])
                if kind in (35, 55):
                    # Entries of references differ in size: what lies behind the first list is not known.
                    break


def _pass_list(path: Path, content: mmap.mmap, at: int, size: int) -> int:
    """Where a list of entries of this size ends."""
    count = int.from_bytes(content[at : at + 8], "little")
    end = at + 8 + count * size
    if at + 8 > len(content) or end > len(content):
        raise ReadError(
            f"{path}: damaged: the list at byte {at:,} reaches to byte {end:,}, the file has {len(content):,}"
        )
    return end


def _values(content: mmap.mmap) -> NDArray[np.uint64]:
    """The table of the section FIELDS, (n,): each value's flags, type and place."""
    (contents,) = struct.unpack_from("<q", content, 16)
    (sections,) = struct.unpack_from("<Q", content, contents)
    for index in range(min(sections, 64)):
        name, start, _ = struct.unpack_from("<16sqq", content, contents + 8 + 32 * index)
        if name.rstrip(b"\0") == b"FIELDS":
            break
    else:
        raise ValueError("no FIELDS")
    count, names = struct.unpack_from("<QQ", content, start)
    (packed,) = struct.unpack_from("<Q", content, start + 16 + names)
    if count > MOST_FIELDS:
        raise ValueError("too many fields")
    begin = start + 24 + names
    if begin + packed > len(content) or content[begin] != 0:
        # More than one block is for tables beyond 2 GB.
        raise ValueError("not one block")
    table = _unpacked(content[begin + 1 : begin + packed], 8 * count)
    return np.frombuffer(table, dtype="<u8")


def _unpacked(block: bytes, size: int) -> bytes:
    """A block packed by LZ4 (its published block format): literals, and repeats of what stands before."""
    out = bytearray()
    at = 0
    while at < len(block):
        token = block[at]
        at += 1
        literals, at = _length(block, at, token >> 4)
        out += block[at : at + literals]
        at += literals
        if at >= len(block):
            break
        back = int.from_bytes(block[at : at + 2], "little")
        repeat, at = _length(block, at + 2, token & 15)
        repeat += 4
        if not 0 < back <= len(out) or len(out) + repeat > size:
            raise ValueError("not packed by LZ4")
        piece = out[-back:] if back >= repeat else out[-back:] * (repeat // back + 1)
        out += piece[:repeat]
    if len(out) != size:
        raise ValueError("not packed by LZ4")
    return bytes(out)


def _length(block: bytes, at: int, length: int) -> tuple[int, int]:
    """A length that goes on in further bytes where its four bits are full, and where it ends."""
    if length == 15:
        while True:
            more = block[at]
            at += 1
            length += more
            if more != 255:
                break
    return length, at
