"""Points of strands packed for a page: on a grid of 16 bits, as differences, in planes of bytes, deflated.

A strand's first point stands as it is, every other as its difference from the one before; the high bytes of all
points come first and then the low ones, axis by axis, since the former are nearly all alike.
"""

from __future__ import annotations

import base64
import os
import zlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detangled.groom import offsets_of
from detangled.usable import FARTHEST

STEPS = 65535  # of the grid along the box's longest side
PLANES = 6
LEVEL = 6  # of deflate: 9 takes three times as long for less than one in a hundred


@dataclass(frozen=True)
class Gridded:
    """Strands on a grid; those that could not be drawn are left out.

    places: (P, 3) uint16. offsets: (S + 1,). ids: (S,) the strand's index among those given.
    origin: (3,) [cm], of the grid. step: of the grid [cm]. high: (3,) [cm], the box's far corner.
    """

    places: NDArray[np.uint16]
    offsets: NDArray[np.int64]
    ids: NDArray[np.int64]
    origin: NDArray[np.float64]
    step: float
    high: NDArray[np.float64]

    def points(self) -> NDArray[np.float64]:
        """The points (P, 3) [cm], each within half a step of the one given along every axis."""
        return self.origin + self.step * self.places


def gridded(points: NDArray[np.float64], offsets: NDArray[np.int64]) -> Gridded:
    """Put strands (P, 3) [cm] by offsets (S + 1,) on a grid over the box around them.

    Left out: points that are not finite or beyond 10 km, points that fall on the one before, and strands of fewer than
    two points then.
    """
    strand = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    good = (np.abs(points) < FARTHEST).all(axis=1)  # false for NaN
    if not good.all():
        points, strand = points[good], strand[good]
    if len(points) == 0:
        nothing = np.empty(0, dtype=np.int64)
        return Gridded(np.empty((0, 3), np.uint16), offsets_of(nothing), nothing, np.zeros(3), 1.0, np.zeros(3))
    low, high = points.min(axis=0), points.max(axis=0)
    step = float((high - low).max()) / STEPS or 1.0
    places = np.rint((points - low) / step).astype(np.uint16)
    kept = np.ones(len(places), dtype=bool)
    kept[1:] = (places[1:] != places[:-1]).any(axis=1) | (strand[1:] != strand[:-1])
    counts = np.bincount(strand[kept], minlength=len(offsets) - 1)
    kept &= counts[strand] >= 2
    ids = np.flatnonzero(counts >= 2)
    return Gridded(places if kept.all() else places[kept], offsets_of(counts[ids]), ids, low, step, high)


def byte_planes(places: NDArray[np.uint16], offsets: NDArray[np.int64]) -> list[NDArray[np.uint8]]:
    """Places (P, 3) on a grid, in strands by offsets (S + 1,), as PLANES arrays (P,)."""
    steps = places.copy()
    steps[1:] -= places[:-1]  # modulo 65536, as the page adds them up again
    first = offsets[:-1][np.diff(offsets) > 0]
    steps[first] = places[first]
    pairs = np.ascontiguousarray(steps.T, dtype="<u2").view(np.uint8).reshape(3, -1, 2)  # (3, P, low and high)
    return [np.ascontiguousarray(pairs[axis, :, k]) for axis in range(3) for k in (1, 0)]


def packed(arrays: Sequence[NDArray[Any]], threads: int | None = None) -> list[str]:
    """Arrays as text: their bytes, lowest first, deflated (zlib's format), in base64.

    threads: to use at most, all cores where None; the texts do not depend on it.
    """
    # zlib lets go of the interpreter's lock.
    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        return list(pool.map(_text, arrays))


def _text(array: NDArray[Any]) -> str:
    ordered = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
    return base64.b64encode(zlib.compress(ordered.tobytes(), LEVEL)).decode("ascii")
