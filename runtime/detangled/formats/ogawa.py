"""Ogawa, the container of .abc files: a tree of groups and data, read with every offset and size checked.

A file is a 16-byte header (``Ogawa``, a byte that says it was closed, a version, the root's position), then
groups (a count, then one 64-bit entry a child) and data (a size, then that many bytes) in any order. An
entry's top bit tells data from a group; the rest is a position, or zero for an empty one.
"""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from detangled.errors import ReadError

MAGIC = b"Ogawa"
HDF5_MAGIC = b"\x89HDF"
HEADER_BYTES = 16
CLOSED = 0xFF
VERSION = 1

DATA_BIT = 1 << 63


class Container:
    """A mapped Ogawa file. Entries are the 64-bit words that groups hold; errors name ``path``."""

    def __init__(self, path: Path, view: mmap.mmap) -> None:
        self.path = path
        self._view = view
        if view[:4] == HDF5_MAGIC:
            raise ReadError(f"{path}: an Alembic file of the old HDF5 kind: export it again as Ogawa, today's kind")
        if view[:5] != MAGIC:
            raise ReadError(f"{path}: not an Alembic file (it does not begin with 'Ogawa')")
        if len(view) < HEADER_BYTES:
            raise self.damaged("it ends within its header")
        if view[5] != CLOSED:
            raise self.damaged("whoever wrote it did not finish")
        if int.from_bytes(view[6:8], "big") != VERSION:
            raise ReadError(f"{path}: Ogawa of version {int.from_bytes(view[6:8], 'big')}, only {VERSION} is known")
        self.root = int.from_bytes(view[8:16], "little")

    def children(self, entry: int) -> list[int]:
        """The entries of the group that ``entry`` leads to."""
        if entry & DATA_BIT:
            raise self.damaged(f"data where a group should be, at byte {entry ^ DATA_BIT}")
        if entry == 0:
            return []
        begin, count = self._sized(entry, "group")
        if count > (len(self._view) - begin) // 8:
            raise self.damaged(f"the group at byte {entry} reaches beyond its end")
        return np.frombuffer(self._view[begin : begin + 8 * count], dtype="<u8").tolist()

    def data_size(self, entry: int) -> int:
        """Bytes in the data that ``entry`` leads to."""
        if not entry & DATA_BIT:
            raise self.damaged(f"a group where data should be, at byte {entry}")
        position = entry ^ DATA_BIT
        if position == 0:
            return 0
        begin, size = self._sized(position, "data")
        if size > len(self._view) - begin:
            raise self.damaged(f"the data at byte {position} reach beyond its end")
        return size

    def data(self, entry: int) -> bytes:
        """The data that ``entry`` leads to."""
        size = self.data_size(entry)
        begin = (entry ^ DATA_BIT) + 8
        return self._view[begin : begin + size]

    def damaged(self, what: str) -> ReadError:
        """An error for damage of this file."""
        return ReadError(f"{self.path}: damaged or cut short: {what}")

    def _sized(self, position: int, what: str) -> tuple[int, int]:
        if position < HEADER_BYTES or position + 8 > len(self._view):
            raise self.damaged(f"{what} should stand at byte {position}, it has {len(self._view)} bytes")
        return position + 8, int.from_bytes(self._view[position : position + 8], "little")


@contextmanager
def opened(path: Path) -> Iterator[Container]:
    """Map the Ogawa file at ``path``. Raises ReadError where it is not one."""
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as view:
        yield Container(path, view)
