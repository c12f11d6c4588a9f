"""Alembic (.abc) over time: the points of each frame, read and written one at a time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from alembic3d import Abc, AbcGeom
from numpy.typing import NDArray

from detangled.errors import ReadError
from detangled.formats import abc_check
from detangled.formats.abc import Scene, collected, counts_and_points, evaluated
from detangled.formats.abc_values import BINDING_ERRORS
from detangled.formats.abc_walk import matrix_of
from detangled.formats.abc_write import write_frames
from detangled.formats.transforms import to_world

__all__ = ["open_frames", "write_frames"]


def open_frames(path: Path) -> tuple[NDArray[np.float64], Callable[[int], NDArray[np.float64]]]:
    """Times (F,) [s] of a file's frames, and a function from a frame's index to its points, as they stand in it.

    The times are those of whatever has most samples, a curve object or a transform above one; the others are read at
    their samples nearest to each. Raises ReadError where the file is damaged; the function does where a frame has
    other strands or points than the first.
    """
    abc_check.check(path, frames=True)
    try:
        archive = Abc.IArchive(str(path))
        scene = collected(archive.getTop())
        times = _times(scene)
        first = [_of_curves(path, entry, float(times[0]))[0] for entry in scene.curves]
    except BINDING_ERRORS as error:
        raise ReadError(f"{path}: damaged, or not as Alembic lays it down: {error}") from error

    # The archive lives as long as what reads from it.
    def points(index: int, _archive: Any = archive) -> NDArray[np.float64]:
        time = float(times[index])
        try:
            read = [_of_curves(path, entry, time) for entry in scene.curves]
        except BINDING_ERRORS as error:
            raise ReadError(f"{path}: frame {index} cannot be read: {error}") from error
        for (curves, _), (counts, _), expected in zip(scene.curves, read, first, strict=True):
            if not np.array_equal(counts, expected):
                raise ReadError(f"{path}: {_difference(curves.getName(), index, time, counts, expected)}")
        return np.concatenate([part for _, part in read])

    return times, points


def _difference(name: str, index: int, time: float, counts: NDArray[np.int64], expected: NDArray[np.int64]) -> str:
    if len(counts) != len(expected):
        what = f"has {len(counts)} strands, the first frame {len(expected)}"
    else:
        strand = int(np.flatnonzero(counts != expected)[0])
        what = f"has {counts[strand]} points on strand {strand}, the first frame {expected[strand]}"
    return f"frame {index} ({time:g} s) of {name!r} {what}: all frames must hold the same strands, point for point"


def _times(scene: Scene) -> NDArray[np.float64]:
    schemas = [schema for curves, above in scene.curves for schema in (curves.getSchema(), *above)]
    longest = max(schemas, key=lambda schema: schema.getNumSamples())
    sampling = longest.getTimeSampling()
    return np.array([sampling.getSampleTime(i) for i in range(longest.getNumSamples())], dtype=np.float64)


def _of_curves(
    path: Path, entry: tuple[Any, tuple[Any, ...]], time: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    curves, above = entry
    selector = Abc.ISampleSelector(time, Abc.ISampleSelector.TimeIndexType.kNearIndex)
    sample = curves.getSchema().getValue(selector)
    counts, points = counts_and_points(path, curves.getName(), sample)
    points, _ = to_world(points, {}, matrix_of(above, selector))
    if sample.getType() != AbcGeom.CurveType.kLinear:
        counts, points, _, _ = evaluated(path, curves.getName(), sample, counts, points, {})
    return counts, points
