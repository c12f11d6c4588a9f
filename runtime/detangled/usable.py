"""Which strands of a groom can be used as hair."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.groom import Groom

# Float32 files resolve a head's coordinates to about this much [cm]; a strand within it is a single point.
LEAST_EXTENT = 1e-6
# No hair is longer than some metres: beyond this [cm] a coordinate is damaged, or the unit is wrong.
GREATEST_EXTENT = 2e3


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
