"""A texture that is asked for by its numbers: radius, wavelength and twist prevalence, without examples.

It is learned, as from any strands, from those of a library that are most like it: in how steep their coils are, how
often they twist, and roughly in size. Each of them is first made exactly as large and as steep as asked, about its own
axis.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from detangled.errors import TextureError
from detangled.fitted import FittedTexture
from detangled.fitting import PATCH_GRID, measured_canonical
from detangled.generation import generate
from detangled.geometry.waves import is_weak
from detangled.geometry.winding import winding
from detangled.library import Library, load_library
from detangled.retexturing import FEWEST_TURNS
from detangled.shape import Shape
from detangled.texture import HAIR_TYPES, TWISTS_PER_CM, HairType, Profile, TextureParameters, arc_of_a_turn

CHOSEN = 24  # strands of the library that a texture is learned from
# Differences that count alike: of the logarithms of slope and size, and of the twist prevalence.
SLOPE_AWAY, SIZE_AWAY, TWIST_AWAY = 0.25, 0.7, 0.05
FAR = 2.0  # such differences
FEW_TWISTS = (0.15, 0.25)  # prevalences: up to the one winding is believed, from the other on it is not
ROUNDS, DRAWN, DRAWN_TURNS = 2, 48, 8.0
CALIBRATION_SEED = 1 << 30
MOST_RESIZED = 1.6  # in one round
KNOTS = 64  # of profiles, where they are put together


@dataclass(frozen=True)
class Asked:
    """What is asked for: radius and wavelength along the strand [cm], from root to tip, and the twist prevalence.

    Raises TextureError where a number is outside what hair has.
    """

    radius: Profile
    wavelength: Profile
    twist: float

    def __post_init__(self) -> None:
        for radius in self.radius.values:
            TextureParameters(radius, self.wavelength.values[0], self.twist)
        for wavelength in self.wavelength.values:
            TextureParameters(self.radius.values[0], wavelength, self.twist)

    def __str__(self) -> str:
        sizes = (
            " to ".join(f"{value:.2g}" for value in profile.values[: 1 if profile.constant else None])
            for profile in (self.radius, self.wavelength)
        )
        return "radius {} cm, wavelength {} cm, twist {:.2g}".format(*sizes, self.twist)


def asked(
    hair: HairType | None = None,
    radius: Profile | None = None,
    wavelength: Profile | None = None,
    twist: float | None = None,
) -> Asked:
    """The texture of a hair type, of numbers, or of a type but for some numbers.

    Without a type, numbers that are not given are those that hair of the given ones usually has. Raises TextureError
    where nothing is given, or a number is outside what hair has.
    """
    if hair is not None:
        usual = hair.parameters()
        numbers = usual.radius, usual.wavelength, usual.twist
    else:
        numbers = _usual(radius, wavelength, twist)
    return Asked(
        radius or Profile((numbers[0],)),
        wavelength or Profile((numbers[1],)),
        numbers[2] if twist is None else twist,
    )


def _usual(radius: Profile | None, wavelength: Profile | None, twist: float | None) -> tuple[float, float, float]:
    """Radius, wavelength and twist prevalence of hair between the types, by what is known of it.

    From type to type the wavelength falls and the twist prevalence rises; the radius falls from type IV on.
    """
    types = [hair.parameters() for hair in HAIR_TYPES]
    radii, wavelengths = (np.log([getattr(t, name) for t in types]) for name in ("radius", "wavelength"))
    twists = np.array([t.twist for t in types])
    place = np.arange(len(types), dtype=np.float64)
    if wavelength is not None:
        at = np.interp(-np.log(np.mean(wavelength.values)), -wavelengths, place)
    elif twist is not None:
        at = np.interp(twist, twists, place)
    elif radius is not None:
        widest = int(radii.argmax())
        at = np.interp(-np.log(np.mean(radius.values)), -radii[widest:], place[widest:])
    else:
        raise TextureError("nothing is asked for: give a hair type, or a radius, wavelength or twist prevalence")
    at = np.nan_to_num(at)  # what is no number is refused by its own name, not by what follows from it
    return (
        float(np.exp(np.interp(at, place, radii))),
        float(np.exp(np.interp(at, place, wavelengths))),
        float(np.interp(at, place, twists)),
    )


def asked_texture(what: Asked, library: Library | None = None) -> FittedTexture:
    """The texture of these numbers, drawn by patches.

    Warns where the library holds no hair like it. Raises ModelError where the library is missing or damaged.
    """
    library = library or load_library()
    radius, wavelength = (float(np.exp(np.log(p.values).mean())) for p in (what.radius, what.wavelength))
    away = _away(library, radius, wavelength, what.twist)
    chosen = np.sort(np.argsort((away**2).sum(axis=0), kind="stable")[:CHOSEN])
    _warn_if_far(library, what, away[:, chosen])
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
    texture = _calibrated(points, offsets, radius, wavelength, what.twist)
    if what.radius.constant and what.wavelength.constant:
        return texture
    at = (np.arange(KNOTS) + 0.5) / KNOTS
    radii, wavelengths = what.radius(at), what.wavelength(at)
    return replace(texture, shape=Shape(radii.tolist(), wavelengths.tolist(), radius, wavelength))


def _calibrated(
    points: NDArray[np.float64], offsets: NDArray[np.int64], radius: float, wavelength: float, twist: float
) -> FittedTexture:
    """The texture of canonical strands, resized, where hair hardly twists, until strands drawn of it wind as asked.

    Where it twists a lot, winding counts its twists, and tells of neither radius nor wavelength.
    """
    factor = np.ones(2)
    trust = float(np.interp(twist, FEW_TWISTS, (1.0, 0.0)))
    for remaining in reversed(range(ROUNDS + 1 if trust > 0.0 else 1)):
        scaled = points * factor[[0, 0, 1]]
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
            drawn = generate(texture, DRAWN, DRAWN_TURNS * texture.turn, CALIBRATION_SEED)
            wound = np.array([float(np.nanmedian(values)) for values in winding(drawn.points, drawn.offsets)])
            wrong = np.clip(np.array([radius, wavelength]) / wound, 1.0 / MOST_RESIZED, MOST_RESIZED)
            factor *= np.where(np.isfinite(wrong), wrong, 1.0) ** trust
    return texture


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


def _warn_if_far(library: Library, what: Asked, away: NDArray[np.float64]) -> None:
    """Warn where the strands that a texture is learned from (3, CHOSEN) are not like it."""
    if (np.median(np.abs(away), axis=1) <= FAR).all():
        return
    ranges = (np.percentile(x, (1, 99)) for x in (library.radius, library.wavelength / library.radius))
    radii, slopes = (f"{low:.2g} to {high:.2g}" for low, high in ranges)
    warnings.warn(
        f"{what} is unlike the hair that was simulated, and is made of the nearest there is: radii of {radii} cm, "
        f"wavelengths of {slopes} radii, with fewer twists the larger the curls",
        stacklevel=3,
    )
