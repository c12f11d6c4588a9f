"""A texture of given numbers by patches of a library: learned, as from any strands, from those most like it.

They are chosen by how steep their coils are, how often they twist, and roughly by size. Each of them is first made
exactly as large and as steep as asked, about its own axis.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from detangled.draws import numbers_drawn, settled
from detangled.fitted import FittedTexture
from detangled.fitting import PATCH_GRID, measured_canonical
from detangled.geometry.waves import is_weak
from detangled.library import Library, load_library
from detangled.retexturing import FEWEST_TURNS
from detangled.texture import TWISTS_PER_CM, arc_of_a_turn

CHOSEN = 24  # strands of the library that a texture is learned from
# Differences that count alike: of the logarithms of slope and size, and of the twist prevalence.
SLOPE_AWAY, SIZE_AWAY, TWIST_AWAY = 0.25, 0.7, 0.05
FAR = 2.0  # such differences
ROUNDS = 1
MOST_RESIZED = 1.6  # in one round


def library_texture(
    radius: float, wavelength: float, twist: float, library: Library | None = None, rounds: int = ROUNDS
) -> FittedTexture:
    """The texture of these numbers [cm], T_f.

    rounds: how often its examples are resized until strands drawn of them are as asked; with none, strands are not
    settled either. Warns where the library holds no hair like it.
    Raises ModelError where the library is missing or damaged.
    """
    library = library or load_library()
    away = _away(library, radius, wavelength, twist)
    chosen = np.sort(np.argsort((away**2).sum(axis=0), kind="stable")[:CHOSEN])
    _warn_if_far(library, (radius, wavelength, twist), away[:, chosen])
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
    return _calibrated(points, offsets, radius, wavelength, twist, rounds)


def _calibrated(
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    radius: float,
    wavelength: float,
    twist: float,
    rounds: int,
) -> FittedTexture:
    """The texture of canonical strands, resized until strands drawn of it are as asked."""
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


def _away(library: Library, radius: float, wavelength: float, twist: float) -> NDArray[np.float64]:
    """How far the strands of a library are from a texture in slope, size and twist prevalence, (3, S)."""
    slope = np.log(library.wavelength / library.radius) - np.log(wavelength / radius)
    # As large as asked, a strand has other twists a length.
    ratio = arc_of_a_turn(radius, wavelength) / arc_of_a_turn(library.radius, library.wavelength)
    twists = library.twists / (TWISTS_PER_CM * library.arcs * ratio) - twist
    return np.stack([slope / SLOPE_AWAY, np.log(ratio) / SIZE_AWAY, twists / TWIST_AWAY])


def _warn_if_far(library: Library, numbers: tuple[float, float, float], away: NDArray[np.float64]) -> None:
    """Warn where the strands that a texture is learned from (3, CHOSEN) are not like it."""
    if (np.median(np.abs(away), axis=1) <= FAR).all():
        return
    ranges = (np.percentile(x, (1, 99)) for x in (library.radius, library.wavelength / library.radius))
    radii, slopes = (f"{low:.2g} to {high:.2g}" for low, high in ranges)
    asked = "radius {:.2g} cm, wavelength {:.2g} cm, twist {:.2g}".format(*numbers)
    warnings.warn(
        f"{asked} is unlike the hair that was simulated, and is made of the nearest there is: radii of {radii} cm, "
        f"wavelengths of {slopes} radii, with fewer twists the larger the curls",
        stacklevel=4,
    )
