"""Grooms of too many points for a page: fewer points a strand, as long as curls stay, then fewer strands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from detangled.groom import Groom, offsets_of

MOST_POINTS = 6_000_000  # of a groom: a page of about 30 MB, which browsers open in two or three seconds
# The page draws smooth curves through the points, which hold a turn's shape with these.
POINTS_PER_TURN = 8.0
FEWEST_POINTS = 8  # of a strand, where it had more
SAMPLE = 500  # strands whose points a turn are counted; they come shuffled


def thinned(groom: Groom, most_points: int = MOST_POINTS) -> tuple[Groom, NDArray[np.int64], list[str]]:
    """A groom of at most ``most_points``, but for one strand; which strands it is made of; and what was done to it.

    Its attributes are left behind. Strands must come in random order: where there are too many, the first are kept.
    """
    total = len(groom.points)
    if total <= most_points:
        return groom, np.arange(groom.strand_count), []
    from detangled.grooming.placing import resample
    from detangled.labeling import points_per_turn
    from detangled.usable import usable_strands

    rows = np.flatnonzero(usable_strands(groom))
    if len(rows) == 0:
        return groom.select(rows), rows, []
    groom = replace(groom, attributes={}).select(rows)
    some = groom.select(np.arange(min(SAMPLE, groom.strand_count)))
    spare = float(np.median(points_per_turn(some.points, some.offsets))) / POINTS_PER_TURN
    factor = max(1.0, min(len(groom.points) / most_points, spare))
    counts = groom.point_counts
    fewer = np.minimum(counts, np.maximum(np.floor(counts / factor).astype(np.int64), FEWEST_POINTS))
    strands = max(1, int(np.searchsorted(np.cumsum(fewer), most_points, side="right")))
    notes = []
    if strands < groom.strand_count:
        notes.append(f"{groom.strand_count:,} strands are too many for a page: {strands:,} of them are shown")
        rows, fewer, groom = rows[:strands], fewer[:strands], groom.select(np.arange(strands))
    if factor > 1.0:
        offsets = offsets_of(fewer)
        groom = replace(groom, points=resample(groom.points, groom.offsets, offsets), offsets=offsets)
        notes.append(f"{total:,} points are too many for a page: strands are shown with one in {factor:.1f} of theirs")
    return groom, rows, notes
