"""Strands of one count of points, for formats that know no other: points put between, so that no curve changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from detangled.groom import Attribute, Groom, Scope


def evened(groom: Groom, count: int) -> Groom:
    """The groom with ``count`` points on every strand: new ones lie on its segments, those it has all stay.

    Strands must have 1 to ``count`` points; of a single one all points lie there. A segment gets as many new points
    as any other of its strand, or one more, the first ones first. Numbers of a point are interpolated; whole numbers,
    texts and truth values are those of the point before.
    """
    before, fraction = _places(groom.point_counts, groom.offsets[:-1], count)
    after = np.minimum(before + 1, np.repeat(groom.offsets[1:] - 1, count))
    attributes = {
        name: Attribute(_between(a.values, before, after, fraction), a.scope) if a.scope is Scope.POINT else a
        for name, a in groom.attributes.items()
    }
    return replace(
        groom,
        points=_between(groom.points, before, after, fraction),
        offsets=np.arange(groom.strand_count + 1, dtype=np.int64) * count,
        attributes=attributes,
    )


def _places(
    counts: NDArray[np.int64], begins: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """For each new point the old one before it, and how far it is on the way to the next, (S * count,)."""
    segments = np.maximum(counts - 1, 1)[:, None]  # (S, 1)
    share, more = np.divmod(count - 1, segments)  # steps of each segment; how many segments take one more
    step = np.broadcast_to(np.arange(count), (len(counts), count))
    in_long = step < more * (share + 1)
    late = step - more * (share + 1)
    segment = np.where(in_long, step // (share + 1), more + late // np.maximum(share, 1))
    within = np.where(in_long, step % (share + 1), late % np.maximum(share, 1))
    fraction = within / np.where(in_long, share + 1, np.maximum(share, 1))
    fraction = np.where(counts[:, None] == 1, 0.0, fraction)
    segment = np.where(counts[:, None] == 1, 0, segment)
    return (begins[:, None] + segment).ravel(), fraction.ravel()


def _between(
    values: NDArray, before: NDArray[np.int64], after: NDArray[np.int64], fraction: NDArray[np.float64]
) -> NDArray:
    if values.dtype.kind != "f":
        return values[before]
    weight = fraction.reshape(-1, *[1] * (values.ndim - 1))
    low, high = values[before], values[after]
    # The old points to the bit, also where the next one is not finite.
    with np.errstate(all="ignore"):
        return np.where(weight == 0.0, low, low + weight * (high - low)).astype(values.dtype)
