"""Grooms that move: a first frame as every reader gives it, and the points of each frame, one at a time."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.errors import WriteError
from detangled.formats import in_file_units, read, replacing
from detangled.groom import Groom

# Modules that know frames, by suffix. Each has ``open_frames(path)``, which gives times (F,) [s] and a function from a
# frame's index to its points as they stand in the file; and ``write_frames(groom, times, points, path)``, which gets
# lengths as they are to stand in the file and says what it could not keep.
ONLY_FIRST = "only the first is kept"  # ends what is said of a file whose frames were not asked for
_MODULES = {".abc": "detangled.formats.abc_frames"}
Points = Callable[[int], NDArray[np.float64]]


@dataclass(frozen=True)
class Frames:
    """A groom that moves.

    groom: its first frame. times: (F,) [s]. points: gives a frame's points (P, 3) [cm] by its index, read when asked
    for; strands and their points are those of the first frame.
    """

    groom: Groom
    times: NDArray[np.float64]
    points: Points

    def __len__(self) -> int:
        return len(self.times)

    def mapped(self, groom: Groom, function: Callable[[int, NDArray[np.float64]], NDArray[np.float64]]) -> Frames:
        """Frames of another groom, whose points are a function of a frame's index and these points."""
        return Frames(groom, self.times, lambda index: function(index, self.points(index)))

    def __iter__(self) -> Iterator[NDArray[np.float64]]:
        return (self.points(index) for index in range(len(self)))


def still(groom: Groom) -> Frames:
    """A groom that stands still, as one frame."""
    return Frames(groom, np.zeros(1), lambda _: groom.points)


def holds_frames(path: str | os.PathLike[str]) -> bool:
    """Whether files of this suffix can hold frames that are read and written."""
    return Path(path).suffix.lower() in _MODULES


def read_frames(path: str | os.PathLike[str], unit: str | None = None) -> Frames:
    """Open a groom that moves; a file of one frame, or of a format without any, is a groom that stands still.

    unit: as for ``read``. Raises ReadError as ``read`` does, and where a frame has other strands or points than the
    first when it is read.
    """
    path = Path(path)
    groom = read(path, unit=unit)
    if not holds_frames(path):
        return still(groom)
    times, points = import_module(_MODULES[path.suffix.lower()]).open_frames(path)
    groom = replace(groom, notes=tuple(note for note in groom.notes if not note.endswith(ONLY_FIRST)))
    if len(times) < 2:
        return still(groom)
    return Frames(groom, times, lambda index: points(index) * groom.unit_cm)


def write_frames(
    groom: Groom, times: ArrayLike, points: Iterable[NDArray[np.float64]], path: str | os.PathLike[str]
) -> list[str]:
    """Write a groom that moves in its own unit, and return sentences that say what was not kept.

    groom: its first frame. times: (F,) [s], increasing. points: the points (P, 3) [cm] of all frames, the first too;
    each is written before the next is asked for. The file is whole or as it was before. Raises WriteError where the
    format holds no frames, or a frame does not fit the groom.
    """
    path = Path(path)
    times = np.asarray(times, dtype=np.float64)
    if not holds_frames(path):
        raise WriteError(f"{path}: {path.suffix} files hold no frames; these do: {', '.join(sorted(_MODULES))}")
    if times.ndim != 1 or len(times) == 0 or not (np.isfinite(times).all() and (np.diff(times) > 0.0).all()):
        raise WriteError(f"{path}: the times of its frames must be finite and increase")
    fitting = _fitting(groom, len(times), points, path)
    with replacing(path) as beside:
        module = import_module(_MODULES[path.suffix.lower()])
        said: list[str] = module.write_frames(in_file_units(groom), times, fitting, beside)
    return said


def _fitting(groom: Groom, count: int, points: Iterable[NDArray[np.float64]], path: Path) -> Iterator[np.ndarray]:
    """The frames' points as they are to stand in the file, each checked against the groom."""
    number = 0
    for frame in points:
        if number == count:
            raise WriteError(f"{path}: more frames than the {count} times given")
        if frame.shape != groom.points.shape:
            raise WriteError(f"{path}: frame {number} has points {frame.shape}, the groom {groom.points.shape}")
        number += 1
        yield frame / groom.unit_cm
    if number < count:
        raise WriteError(f"{path}: {number} frames for {count} times")
