"""A texture that is asked for by its numbers: radius, wavelength and twist prevalence, without examples."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from detangled.base_texture import Texture
from detangled.draws import trends
from detangled.errors import TextureError
from detangled.from_library import library_texture
from detangled.from_network import network_texture
from detangled.library import Library, load_library
from detangled.numbered import METHODS as NETWORK_METHODS
from detangled.shape import Shape
from detangled.texture import HAIR_TYPES, HairType, Profile, TextureParameters

LIBRARY = "library"
METHODS = (LIBRARY, *NETWORK_METHODS)
DEFAULT_METHOD = LIBRARY
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


def asked_texture(
    what: Asked, method: str = DEFAULT_METHOD, library: Library | None = None, finite_differences: bool = False
) -> Texture:
    """The texture of these numbers.

    method: LIBRARY, by patches of strands most like it, from ``library`` or the one that comes with detangled; or by
    the pretrained network: CONDITIONED, told the numbers; GUIDED to them by the labelers; BOTH. finite_differences:
    guide without the labelers' exported gradients. Warns where no simulated hair is like it. Raises TextureError for
    an unknown method, ModelError where a model is missing or damaged.
    """
    if method not in METHODS:
        raise TextureError(f"there is no method {method!r}: it is one of {', '.join(METHODS)}")
    radius, wavelength = (float(np.exp(np.log(p.values).mean())) for p in (what.radius, what.wavelength))
    # The network was shown hair like the library's.
    library = library or load_library()
    if not library.has_hair_like(radius, wavelength, what.twist):
        warnings.warn(f"{what} is unlike the hair that was simulated: {library.range}", stacklevel=2)
    texture: Texture
    if method == LIBRARY:
        texture = library_texture(radius, wavelength, what.twist, library)
    else:
        texture = network_texture(radius, wavelength, what.twist, method, finite_differences)
    if what.radius.constant and what.wavelength.constant:
        return texture
    at = (np.arange(KNOTS) + 0.5) / KNOTS
    own = np.exp(np.outer(trends(texture), at - 0.5))  # what strands do of themselves is not to be done again
    radii, wavelengths = what.radius(at) / own[0], what.wavelength(at) / own[1]
    return replace(texture, shape=Shape(radii.tolist(), wavelengths.tolist(), radius, wavelength))
