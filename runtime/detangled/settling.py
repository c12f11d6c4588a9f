"""Strands settled to their numbers: each is resized in canonical space until it reads as asked.

About its own axis a strand may be made wider and longer without becoming another. So what is left of the way to the
numbers, after whatever drew it, is gone at once, and along a strand its natural variation stays.

Strands of many twists are read by the labelers. Where there are few, and also of waves too weak for the labelers, what
a strand extends about its axis says as much: the root mean square of its distance from it, and how long its way across
the axis is beside its mean distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.geometry.arc import arc_lengths, arc_positions
from detangled.geometry.waves import is_weak
from detangled.groom import Groom, offsets_of
from detangled.grooming.lengths import resized
from detangled.grooming.placing import cut, resample
from detangled.kernels import parallel_kernel, prange
from detangled.labeling import Reading, label
from detangled.texture import arc_of_a_turn

BY_LABELS, BY_EXTENT = "labels", "extent"
ROUNDS = 2  # of resizing: a strand made larger is cut earlier
MOST_RESIZED = 1.4  # one strand, beside the others of its texture; so much more hair is drawn, to cut from
MOST_WIDENED = 4.0  # the radius of a wave that is weak even if so wide: of its arc it loses less than 1.4 times
# Of strands that are read, about as they will be written: reading what is drawn, finer still, takes minutes.
POINTS_PER_TURN, FEWEST_POINTS = 32.0, 64


@dataclass(frozen=True)
class Settling:
    """What is to be read in each strand, BY_LABELS or BY_EXTENT: radius and wavelength [cm], and twists (T_f).

    twist: None where it does not matter. Raises ValueError where sizes are not finite, or not positive, where the
    twist is no number, or ``by`` is another.
    """

    by: str
    radius: float
    wavelength: float
    twist: float | None = None

    def __post_init__(self) -> None:
        if self.by not in (BY_LABELS, BY_EXTENT) or not (0.0 < self.radius < np.inf and 0.0 < self.wavelength < np.inf):
            raise ValueError(f"nothing to settle strands to: {self}")
        if self.twist is not None and not 0.0 <= self.twist <= 1.0:
            raise ValueError(f"no twist prevalence to settle strands to: {self}")

    def settle(
        self, points: NDArray[np.float64], offsets: NDArray[np.int64], lengths: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Factors (S, 2) of radius and wavelength for canonical strands (P, 3) by offsets (S + 1,); 1 if not read.

        And how often they twist, (S,), NaN if not read. lengths: (S,) [cm], the arcs from their roots that will be kept
        of them, and are read. Raises ModelError where the labelers are missing or damaged.
        """
        wanted = np.array([self.radius, self.wavelength])
        gentle = self.by == BY_EXTENT and is_weak(MOST_WIDENED * self.radius, self.wavelength)
        most = np.array([MOST_WIDENED if gentle else MOST_RESIZED, MOST_RESIZED])
        sizes, twists = np.ones((len(offsets) - 1, 2)), np.full(len(offsets) - 1, np.nan)
        for _ in range(ROUNDS):
            now = resized(points, offsets, sizes)
            found, twists = self._read(*cut(now, offsets, arc_positions(now, offsets), lengths))
            better = np.clip(sizes * wanted / np.maximum(found, 1e-3), 1.0 / most, most)
            sizes = np.where(np.isfinite(better).all(axis=1, keepdims=True), better, sizes)
        return sizes, twists

    def _read(
        self, points: NDArray[np.float64], offsets: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """What canonical strands read, of about as many points as will be written."""
        turns = arc_lengths(points, offsets) / float(arc_of_a_turn(self.radius, self.wavelength))
        counts = np.ceil(POINTS_PER_TURN * turns).astype(np.int64)
        enough = offsets_of(np.clip(counts, FEWEST_POINTS, np.diff(offsets)))
        return read(Groom(resample(points, offsets, enough), enough), self.by)


def read(strands: Groom, by: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Radius and wavelength (S, 2) [cm] of canonical strands, and twists (S,) [T_f]; NaN where they cannot be read."""
    if by == BY_EXTENT:
        return _extents(strands.points, strands.offsets), np.full(strands.strand_count, np.nan)
    labels = label(strands)
    found = np.stack([labels.radius, labels.wavelength, labels.twist], axis=1)
    found[labels.reading != Reading.READ] = np.nan
    return found[:, :2], found[:, 2]


@parallel_kernel
def _extents(points: NDArray[np.float64], offsets: NDArray[np.int64]) -> NDArray[np.float64]:
    """Radius and wavelength (S, 2) [cm] of canonical strands by their distances from the axis; NaN if on it.

    Of a helix, whatever hand it has where, both are its own.
    """
    out = np.full((offsets.shape[0] - 1, 2), np.nan)
    for s in prange(offsets.shape[0] - 1):
        first, last = offsets[s], offsets[s + 1] - 1
        arc = 0.0
        away = 0.0  # the distance, over the arc
        squares = 0.0  # and its square
        across = 0.0  # the way across the axis
        for i in range(first, last):
            x, y, z = points[i + 1] - points[i]
            step = np.sqrt(x * x + y * y + z * z)
            middle_x, middle_y = 0.5 * (points[i, 0] + points[i + 1, 0]), 0.5 * (points[i, 1] + points[i + 1, 1])
            square = middle_x * middle_x + middle_y * middle_y
            arc += step
            away += step * np.sqrt(square)
            squares += step * square
            across += np.sqrt(x * x + y * y)
        fall = abs(points[last, 2] - points[first, 2])
        if squares > 0.0 and across > 0.0 and fall > 0.0:
            out[s, 0] = np.sqrt(squares / arc)
            out[s, 1] = 2.0 * np.pi * away / across * fall / arc
    return out
