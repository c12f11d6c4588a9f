"""Which strands of a groom can be used as hair."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.errors import ReadError
from detangled.groom import Groom

# Float32 files resolve a head's coordinates to about this much [cm]; a strand within it is a single point.
LEAST_EXTENT = 1e-6
# No hair is longer than some metres: beyond this [cm] a coordinate is damaged, or the unit is wrong.
GREATEST_EXTENT = 2e3
# What is larger is drawn all the same, but nothing beyond ten kilometres [cm]: that is a broken file.
FARTHEST = 1e6
WHY_UNUSABLE = (
    "each has fewer than two distinct points, a coordinate that is not finite, or is longer than 20 m (is the unit "
    "right?)"
)
WHY_UNDRAWN = "no strand of two distinct points that are finite and within 10 km (is the unit right?)"


def extents(groom: Groom) -> NDArray[np.float64]:
    """The longest side of each strand's box (S,) [cm]: not finite where a coordinate is not, 0 without points."""
    extent = np.zeros(groom.strand_count)
    filled = groom.point_counts > 0
    if filled.any():
        first = groom.offsets[:-1][filled]
        with np.errstate(invalid="ignore", over="ignore"):
            span = np.maximum.reduceat(groom.points, first) - np.minimum.reduceat(groom.points, first)
        extent[filled] = span.max(axis=1)
    return extent


def usable_strands(groom: Groom) -> NDArray[np.bool_]:
    """Which strands (S,) have finite coordinates throughout, at least two distinct points, and a hair's extent."""
    extent = extents(groom)
    return np.asarray((extent > LEAST_EXTENT) & (extent < GREATEST_EXTENT))


def check_usable(groom: Groom, name: object = None) -> None:
    """Raise ReadError, which names the groom where it has a name, if none of its strands can be used."""
    if not usable_strands(groom).any():
        of = "" if name is None else f"{name}: "
        raise ReadError(f"{of}none of the {groom.strand_count} strands can be used: {WHY_UNUSABLE}")
