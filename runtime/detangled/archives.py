"""Arrays in a zip archive (.npz): the same bytes for the same arrays, and nothing pickled."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

# Zip archives know no date before this one; any fixed date gives the same bytes for the same arrays.
ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)
ZIP_SYSTEM_UNIX = 3
# What numpy and zipfile raise for damaged archives.
DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    OSError,
    ValueError,
    EOFError,
    KeyError,
    RuntimeError,  # an encrypted member, or one packed in a way that zipfile does not know
    SyntaxError,
    TypeError,
)


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write plain arrays by name."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy", date_time=ZIP_EPOCH)
            member.create_system = ZIP_SYSTEM_UNIX
            with archive.open(member, "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.ascontiguousarray(array), allow_pickle=False)


def read_arrays(file: Path | BinaryIO) -> dict[str, NDArray[Any]]:
    """Read arrays by name. Raises one of DAMAGE where the archive is none, or damaged."""
    with np.load(file, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    # What is no .npy file inside the archive comes as bytes.
    return {name: array for name, array in arrays.items() if isinstance(array, np.ndarray)}
