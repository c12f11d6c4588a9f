"""The library of strands that textures asked for by their numbers are learned from; it comes with the models."""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from detangled.archives import DAMAGE, read_arrays
from detangled.geometry.arc import arc_lengths
from detangled.groom import Groom
from detangled.models import LIBRARY, blaming, verified
from detangled.texture import TWISTS_PER_CM, arc_of_a_turn

CHOSEN = 24  # strands of the library that a texture is learned from
# Differences that count alike: of the logarithms of slope and size, and of the twist prevalence.
SLOPE_AWAY, SIZE_AWAY, TWIST_AWAY = 0.25, 0.7, 0.05
FAR = 2.0  # such differences


@dataclass(frozen=True)
class Library:
    """Canonical strands, points (P, 3) [cm] by offsets (S + 1,), and their numbers, (S,) each.

    radius, wavelength [cm]: means over the strand, as it hangs without twists. twists: how many there are.
    """

    points: NDArray[np.float64]
    offsets: NDArray[np.int64]
    radius: NDArray[np.float64]
    wavelength: NDArray[np.float64]
    twists: NDArray[np.int64]

    def __post_init__(self) -> None:
        count = len(self.offsets) - 1
        if self.points.ndim != 2 or self.points.shape[1] != 3 or self.offsets[-1] != len(self.points):
            raise ValueError("points that do not fit the offsets")
        if count < 1 or self.offsets[0] != 0 or np.diff(self.offsets).min() < 2:
            raise ValueError("no strands, or strands of no extent")
        if not all(values.shape == (count,) for values in (self.radius, self.wavelength, self.twists)):
            raise ValueError("not one number a strand")
        sizes = np.concatenate([self.radius, self.wavelength])
        if not (np.isfinite(self.points).all() and np.isfinite(sizes).all() and sizes.min() > 0.0):
            raise ValueError("points or sizes that are not finite, or not positive")

    @cached_property
    def arcs(self) -> NDArray[np.float64]:
        """Arc length of each strand [cm], (S,)."""
        return arc_lengths(self.points, self.offsets)

    def away(self, radius: float, wavelength: float, twist: float) -> NDArray[np.float64]:
        """How far strands are from hair of these numbers [cm], T_f: in slope, size and twists, (3, S)."""
        slope = np.log(self.wavelength / self.radius) - np.log(wavelength / radius)
        # As large as asked, a strand has other twists a length.
        ratio = arc_of_a_turn(radius, wavelength) / arc_of_a_turn(self.radius, self.wavelength)
        twists = self.twists / (TWISTS_PER_CM * self.arcs * ratio) - twist
        return np.stack([slope / SLOPE_AWAY, np.log(ratio) / SIZE_AWAY, twists / TWIST_AWAY])

    def nearest(self, radius: float, wavelength: float, twist: float) -> NDArray[np.int64]:
        """The strands (CHOSEN,) most like hair of these numbers [cm], T_f."""
        away = (self.away(radius, wavelength, twist) ** 2).sum(axis=0)
        return np.sort(np.argsort(away, kind="stable")[:CHOSEN])

    def has_hair_like(self, radius: float, wavelength: float, twist: float) -> bool:
        """Whether the strands most like hair of these numbers [cm], T_f, are like it."""
        chosen = self.nearest(radius, wavelength, twist)
        away = self.away(radius, wavelength, twist)[:, chosen]
        return bool((np.median(np.abs(away), axis=1) <= FAR).all())

    @property
    def range(self) -> str:
        """What hair there is, in words."""
        ranges = (np.percentile(x, (1, 99)) for x in (self.radius, self.wavelength / self.radius))
        radii, slopes = (f"{low:.2g} to {high:.2g}" for low, high in ranges)
        return f"radii of {radii} cm, wavelengths of {slopes} radii, with fewer twists the larger the curls"

    def select(self, chosen: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Points and offsets of some strands."""
        some = Groom(self.points, self.offsets).select(chosen)
        return some.points, some.offsets


def load_library(folder: Path | None = None) -> Library:
    """Read and verify the library that comes with detangled. Raises ModelError where it is missing or damaged."""
    _, path, data = verified(LIBRARY, folder)
    with blaming(path):
        try:
            arrays = read_arrays(io.BytesIO(data))
            return Library(
                points=arrays["points"].astype(np.float64),
                offsets=arrays["offsets"].astype(np.int64),
                radius=arrays["radius"].astype(np.float64),
                wavelength=arrays["wavelength"].astype(np.float64),
                twists=arrays["twists"].astype(np.int64),
            )
        except DAMAGE as error:
            raise ValueError(f"not a library: {error}") from error
