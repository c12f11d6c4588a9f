"""A texture of given numbers by patches of a library: learned, as from any strands, from those most like it.

They are chosen by how steep their coils are, how often they twist, and roughly by size. Each of them is first made
exactly as large and as steep as asked, about its own axis.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from detangled.draws import numbers_drawn, settled
from detangled.fitted import FittedTexture
from detangled.fitting import PATCH_GRID, measured_canonical
from detangled.geometry.waves import is_weak
from detangled.library import Library, load_library
from detangled.retexturing import FEWEST_TURNS

ROUNDS = 1
MOST_RESIZED = 1.6  # in one round


def library_texture(
    radius: float, wavelength: float, twist: float, library: Library | None = None, rounds: int = ROUNDS
) -> FittedTexture:
    """The texture of these numbers [cm], T_f.

    rounds: how often its examples are resized until strands drawn of them are as asked; with none, strands are not
    settled either. Raises ModelError where the library is missing or damaged.
    """
    library = library or load_library()
    chosen = library.nearest(radius, wavelength, twist)
    points, offsets = library.select(chosen)
    # Patches of one hand: the mean of both would have no torsion. New strands are mirrored at random.
    sizes = np.stack(
        [
            radius / library.radius[chosen],
            radius / library.radius[chosen] * _hands(points, offsets),
            wavelength / library.wavelength[chosen],
        ]
    )
    points = points * np.repeat(sizes, np.diff(offsets), axis=1).T
    return _calibrated(points, offsets, (radius, wavelength, twist), rounds)


def _calibrated(
    points: NDArray[np.float64], offsets: NDArray[np.int64], numbers: tuple[float, float, float], rounds: int
) -> FittedTexture:
    """The texture of canonical strands, resized until strands drawn of it are as asked."""
    radius, wavelength, twist = numbers
    scaled = points
    for remaining in reversed(range(rounds + 1)):
        axis = np.abs(scaled[offsets[1:] - 1, 2] - scaled[offsets[:-1], 2])
        texture = measured_canonical(scaled, offsets, axis, PATCH_GRID)
        texture = replace(
            texture,
            median_arc=max(texture.median_arc, FEWEST_TURNS * texture.turn),
            both_hands=True,
            stiff=False,
            waves=bool(is_weak(radius, wavelength)),
        )
        if remaining:
            wrong = np.array([radius, wavelength]) / numbers_drawn(texture).sizes(twist)
            wrong = np.clip(np.where(np.isfinite(wrong), wrong, 1.0), 1.0 / MOST_RESIZED, MOST_RESIZED)
            scaled = scaled * wrong[[0, 0, 1]]
    return settled(texture, radius, wavelength, twist) if rounds else texture


def _hands(points: NDArray[np.float64], offsets: NDArray[np.int64]) -> NDArray[np.float64]:
    """1 for canonical strands (S,) that wind to the right as they go down, -1 for others."""
    first, then = points[:-1], points[1:]
    turned = first[:, 0] * then[:, 1] - first[:, 1] * then[:, 0]
    turned = np.append(turned, 0.0)
    turned[offsets[1:] - 1] = 0.0
    return np.where(np.add.reduceat(turned, offsets[:-1]) > 0.0, -1.0, 1.0)
