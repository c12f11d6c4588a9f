"""Strands settled to their numbers: each is resized in canonical space until it reads as asked.

About its own axis a strand may be made wider and longer without becoming another. So what is left of the way to the
numbers, after whatever drew it, is gone at once, and along a strand its natural variation stays.

Strands of many twists are read by the labelers. Where there are few, the helix equations say as much of a few turns,
and also of waves too weak for the labelers: the helix of a strand's median curvature and torsion that is as steep as
it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from detangled.geometry.arc import arc_lengths, arc_positions
from detangled.geometry.signal import signals
from detangled.groom import Groom, offsets_of
from detangled.grooming.placing import cut, resample
from detangled.labeling import CELLS, Reading, label
from detangled.texture import arc_of_a_turn

BY_LABELS, BY_HELIX = "labels", "helix"
MOST_RESIZED = 1.2  # one strand, beside the others of its texture; so much more hair is drawn, to cut from
ENDS = 0.08  # of a strand at either end, where axes are known least well
MOST_CELLS = 4096
# Of strands that are read, about as they will be written: reading what is drawn, finer still, takes minutes.
POINTS_PER_TURN, FEWEST_POINTS = 32.0, 64
STEEPEST = 0.9999  # fall over arc


@dataclass(frozen=True)
class Settling:
    """What is to be read in each strand, BY_LABELS or BY_HELIX: radius and wavelength [cm].

    Raises ValueError where they are not finite, or not positive, or ``by`` is another.
    """

    by: str
    radius: float
    wavelength: float

    def __post_init__(self) -> None:
        if self.by not in (BY_LABELS, BY_HELIX) or not (0.0 < self.radius < np.inf and 0.0 < self.wavelength < np.inf):
            raise ValueError(f"nothing to settle strands to: {self}")

    def sizes(
        self, points: NDArray[np.float64], offsets: NDArray[np.int64], lengths: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Factors (S, 2) of radius and wavelength for canonical strands (P, 3) by offsets (S + 1,); 1 if not read.

        lengths: (S,) [cm], the arcs from their roots that will be kept of them, and are read. Raises ModelError where
        the labelers are missing or damaged.
        """
        kept, bounds = cut(points, offsets, arc_positions(points, offsets), lengths)
        turns = arc_lengths(kept, bounds) / float(arc_of_a_turn(self.radius, self.wavelength))
        enough = offsets_of(np.clip(np.ceil(POINTS_PER_TURN * turns).astype(np.int64), FEWEST_POINTS, np.diff(bounds)))
        found = sizes_read(Groom(resample(kept, bounds, enough), enough), self.by)
        wanted = np.array([self.radius, self.wavelength])
        sizes = np.clip(wanted / np.maximum(found, 1e-3), 1.0 / MOST_RESIZED, MOST_RESIZED)
        return np.where(np.isfinite(sizes).all(axis=1, keepdims=True), sizes, 1.0)


def sizes_read(strands: Groom, by: str) -> NDArray[np.float64]:
    """Radius and wavelength (S, 2) [cm] of canonical strands; NaN where they cannot be read."""
    if by == BY_LABELS:
        labels = label(strands)
        read = labels.reading == Reading.READ
        return np.where(read[:, None], np.stack([labels.radius, labels.wavelength], axis=1), np.nan)
    starts = offsets_of(np.clip(np.diff(strands.offsets), CELLS, MOST_CELLS))
    values = signals(strands.points, strands.offsets, starts)
    inner = [slice(a + round(ENDS * (b - a)), b - round(ENDS * (b - a))) for a, b in pairwise(starts)]
    medians = np.array([np.median(values[part, :2], axis=0) for part in inner])
    rate = np.maximum(np.hypot(*medians.T), 1e-9)
    ends = strands.points[strands.offsets[1:] - 1, 2], strands.points[strands.offsets[:-1], 2]
    steepness = np.clip(np.abs(ends[0] - ends[1]) / arc_lengths(strands.points, strands.offsets), 0.0, STEEPEST)
    return np.stack([np.sqrt(1.0 - steepness**2) / rate, 2.0 * np.pi * steepness / rate], axis=1)
