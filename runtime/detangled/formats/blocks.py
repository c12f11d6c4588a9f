"""A binary file's bytes as arrays, each checked to be there before it is taken: a header's counts may lie."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from detangled.errors import ReadError


class Blocks:
    """The bytes of a file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.bytes = np.frombuffer(path.read_bytes(), dtype=np.uint8)

    def __len__(self) -> int:
        return len(self.bytes)

    def take(self, what: str, at: int, count: int, dtype: DTypeLike) -> NDArray[Any]:
        """The ``count`` values that begin at a byte, (count,): a view, or a copy where they begin at an odd one.

        Raises ReadError, before any memory is asked for, where they would lead beyond the end of the file.
        """
        dtype = np.dtype(dtype)
        end = at + count * dtype.itemsize
        if count < 0 or at < 0 or end > len(self.bytes):
            raise ReadError(
                f"{self.path}: damaged or cut short: by its header {what} reach to byte {end:,}, "
                f"the file has {len(self.bytes):,}"
            )
        # Not everything that takes arrays takes those whose numbers straddle words.
        return np.require(self.bytes[at:end].view(dtype), requirements="A")


def as_float32(values: NDArray[Any]) -> NDArray[np.float32]:
    """The values in little-endian float32; those too large for it become infinite."""
    with np.errstate(over="ignore"):
        return values.astype("<f4")
