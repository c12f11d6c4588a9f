"""A texture of given numbers by patches of a library: learned, as from any strands, from those most like it.

They are chosen by how steep their coils are, how often they twist, and roughly by size. Each of them is first made
exactly as large and as steep as asked, about its own axis.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from detangled.draws import numbers_of, settled, some_drawn
from detangled.fitted import FittedTexture
from detangled.fitting import PATCH_GRID, measured_canonical
from detangled.geometry.waves import is_weak
from detangled.library import Library, load_library
from detangled.retexturing import FEWEST_TURNS

MOST_RESIZED = 1.6


def library_texture(
    radius: float, wavelength: float, twist: float, library: Library | None = None, as_drawn: bool = False
) -> FittedTexture:
    """The texture of these numbers [cm], T_f.

    as_drawn: neither are its examples resized until strands drawn of them are as asked, nor are strands settled. Raises
    ModelError where the library is missing or damaged.
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
    waves = bool(is_weak(radius, wavelength))
    texture = _learned(points, offsets, waves)
    if as_drawn:
        return texture
    wrong = np.array([radius, wavelength]) / numbers_of(some_drawn(texture)).sizes(twist)
    wrong = np.clip(np.where(np.isfinite(wrong), wrong, 1.0), 1.0 / MOST_RESIZED, MOST_RESIZED)
    return settled(_learned(points * wrong[[0, 0, 1]], offsets, waves), radius, wavelength, twist)


def _learned(points: NDArray[np.float64], offsets: NDArray[np.int64], waves: bool) -> FittedTexture:
    """The texture of canonical strands."""
    axis = np.abs(points[offsets[1:] - 1, 2] - points[offsets[:-1], 2])
    texture = measured_canonical(points, offsets, axis, PATCH_GRID)
    longer = max(texture.median_arc, FEWEST_TURNS * texture.turn)
    return replace(texture, median_arc=longer, both_hands=True, stiff=False, waves=waves)


def _hands(points: NDArray[np.float64], offsets: NDArray[np.int64]) -> NDArray[np.float64]:
    """1 for canonical strands (S,) that wind to the right as they go down, -1 for others."""
    first, then = points[:-1], points[1:]
    turned = first[:, 0] * then[:, 1] - first[:, 1] * then[:, 0]
    turned = np.append(turned, 0.0)
    turned[offsets[1:] - 1] = 0.0
    return np.where(np.add.reduceat(turned, offsets[:-1]) > 0.0, -1.0, 1.0)
