"""Hair texture in numbers: five parameters, eight hair types, and the names that people have for them.

Paper section "Strand Texture". The paper builds on the eight curl types of De la Mettrie et al. 2007, whose table was
not to be had: the means and deviations here are this project's own estimate. Their order is sure, the means are right
within about a factor of 1.5, and the deviations are inflated on purpose, so that hair between the types is sampled too.
"""

from __future__ import annotations

import difflib
import math
import re
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri

from detangled.errors import TextureError
from detangled.units import CM_PER_UNIT

TWISTS_PER_CM = 1.5  # at a twist prevalence of 1, per cm of arc (paper section "Procedural Modeling")

# Least and greatest of each. Thickness and axis ratio: paper section "Thickness". Of radius, wavelength and length the
# least are where hair ends, or what can be told from it; the greatest are beyond five deviations of every type.
THICKNESS_LIMITS = (20.0, 180.0)  # [um]
AXIS_RATIO_LIMITS = (0.55, 1.0)
RADIUS_LIMITS = (0.05, 3.0)  # [cm]
WAVELENGTH_LIMITS = (0.15, 60.0)  # [cm]
SHARE_LIMITS = (0.0, 1.0)  # twist prevalence, porosity
FEW_TWISTS = 0.2  # prevalence up to which winding tells radius and wavelength: twists wind too
LENGTH_LIMITS = (2.0, 100.0)  # [cm], of sampled strands

# The eight types say nothing of these: values in the middle of what hair has.
USUAL_THICKNESS = 70.0  # [um]
USUAL_AXIS_RATIO = 0.8
USUAL_POROSITY = 0.5


@dataclass(frozen=True)
class TextureParameters:
    """The texture of hair: one characteristic value of each parameter. Raises TextureError for one out of its limits.

    radius: of the cylinder that a curl winds on [cm], 0.05 to 3.
    wavelength: from a curl to the next along the axis [cm], 0.15 to 60.
    twist: prevalence T_f of sudden twists, 0 to 1; at 1 there are 1.5 per cm of arc.
    thickness: diameter of the fibre [um], 20 to 180. axis_ratio: minor over major axis of its section, 0.55 to 1.
    porosity: how much water it takes up, 0 to 1.
    """

    radius: float
    wavelength: float
    twist: float = 0.0
    thickness: float = USUAL_THICKNESS
    axis_ratio: float = USUAL_AXIS_RATIO
    porosity: float = USUAL_POROSITY

    def __post_init__(self) -> None:
        _check("curl radius", self.radius, RADIUS_LIMITS, "cm")
        _check("curl wavelength", self.wavelength, WAVELENGTH_LIMITS, "cm")
        _check("twist prevalence", self.twist, SHARE_LIMITS, "")
        check_thickness(self.thickness)
        _check("axis ratio", self.axis_ratio, AXIS_RATIO_LIMITS, "")
        check_porosity(self.porosity)


def check_thickness(thickness: float) -> None:
    """Raise TextureError for a thickness [um] outside what hair has."""
    _check("thickness", thickness, THICKNESS_LIMITS, "um")


def check_porosity(porosity: float) -> None:
    """Raise TextureError for a porosity outside 0 to 1."""
    _check("porosity", porosity, SHARE_LIMITS, "")


def _check(name: str, value: float, limits: tuple[float, float], unit: str) -> None:
    least, most = limits
    if least <= value <= most:
        return
    after = f" {unit}" if unit else ""
    hint = f"; did you mean {value:g}mm?" if unit == "cm" and least <= 0.1 * value <= most else ""
    raise TextureError(f"a {name} of {value:g}{after} is outside what hair has, {least:g} to {most:g}{after}{hint}")


def arc_of_a_turn(radius: ArrayLike, wavelength: ArrayLike) -> NDArray[np.float64]:
    """Arc length [cm] of one turn of a helix of these radii and wavelengths [cm]; arrays broadcast."""
    return np.hypot(2.0 * np.pi * np.asarray(radius, dtype=np.float64), wavelength)


@dataclass(frozen=True)
class Spread:
    """A normal distribution cut off at ``least`` and ``most``; mean and deviation are those before the cut."""

    mean: float
    deviation: float
    least: float
    most: float

    def at(self, share: ArrayLike) -> NDArray[np.float64]:
        """The values below which these shares (...) in [0, 1] of all lie."""
        low = ndtr((self.least - self.mean) / self.deviation)
        high = ndtr((self.most - self.mean) / self.deviation)
        values = self.mean + self.deviation * ndtri(low + (high - low) * np.asarray(share, dtype=np.float64))
        return np.clip(values, self.least, self.most)


@dataclass(frozen=True)
class HairType:
    """One of the eight types, or the middle of two. The numbers are our estimate (see the module).

    name: ``"IV"``. walker: letters of Walker's chart, ``"3A"``. radius, wavelength [cm], twist (T_f), and length:
    arc length of a strand [cm].
    """

    name: str
    walker: str
    radius: Spread
    wavelength: Spread
    twist: Spread
    length: Spread

    def parameters(self) -> TextureParameters:
        """The type's means; thickness, axis ratio and porosity are not the type's and keep their usual values."""
        return TextureParameters(self.radius.mean, self.wavelength.mean, self.twist.mean)

    def at(self, shares: ArrayLike) -> NDArray[np.float64]:
        """Radius, wavelength, twist, length (..., 4) at quantiles (..., 4) in [0, 1] of each."""
        shares = np.asarray(shares, dtype=np.float64)
        spreads = (self.radius, self.wavelength, self.twist, self.length)
        return np.stack([spread.at(shares[..., i]) for i, spread in enumerate(spreads)], axis=-1)

    def sample(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        """Radius [cm], wavelength [cm], twist (T_f) and arc length [cm] of ``count`` strands, (count, 4)."""
        return self.at(rng.random((count, 4)))


def _row(name: str, walker: str, *numbers: float) -> HairType:
    """A row of the table: mean and inflated deviation of radius, wavelength, twist, length."""
    limits = (RADIUS_LIMITS, WAVELENGTH_LIMITS, SHARE_LIMITS, LENGTH_LIMITS)
    spreads = [Spread(numbers[2 * i], numbers[2 * i + 1], *limits[i]) for i in range(4)]
    return HairType(name, walker, *spreads)


HAIR_TYPES = (
    _row("I", "1A to 1C", 0.20, 0.25, 20.0, 8.0, 0.02, 0.04, 30.0, 12.0),
    _row("II", "2A", 0.45, 0.30, 9.0, 3.0, 0.05, 0.06, 30.0, 12.0),
    _row("III", "2B to 2C", 0.75, 0.35, 6.0, 2.0, 0.08, 0.08, 28.0, 11.0),
    _row("IV", "3A", 0.95, 0.35, 3.8, 1.3, 0.12, 0.10, 25.0, 10.0),
    _row("V", "3B", 0.65, 0.25, 2.2, 0.8, 0.22, 0.15, 22.0, 9.0),
    _row("VI", "3C to 4A", 0.42, 0.16, 1.25, 0.5, 0.40, 0.20, 18.0, 8.0),
    _row("VII", "4A to 4B", 0.28, 0.11, 0.75, 0.35, 0.60, 0.22, 14.0, 6.0),
    _row("VIII", "4B to 4C", 0.18, 0.08, 0.42, 0.22, 0.80, 0.20, 12.0, 5.0),
)

# Walker's letters that lie in two of the types: 4A goes by what it is compared with, a coffee stirrer's 0.3 to 0.5 cm;
# 4B is the middle of the two.
WALKER = {
    "1A": "I",
    "1B": "I",
    "1C": "I",
    "2A": "II",
    "2B": "III",
    "2C": "III",
    "3A": "IV",
    "3B": "V",
    "3C": "VI",
    "4A": "VII",
    "4B": "VII-VIII",
    "4C": "VIII",
}
# What curls are compared with, by diameter.
THINGS = {
    "sidewalk chalk": "3A",
    "chalk": "3A",
    "marker": "3B",
    "straw": "3C",
    "drinking straw": "3C",
    "coffee stirrer": "4A",
    "stirrer": "4A",
}


def _middle(one: HairType, other: HairType, walker: str) -> HairType:
    """The type halfway between two: sizes by their geometric means, the twist prevalence by its plain one."""

    def between(a: Spread, b: Spread) -> Spread:
        return Spread(math.sqrt(a.mean * b.mean), math.sqrt(a.deviation * b.deviation), a.least, a.most)

    a, b = one.twist, other.twist
    return HairType(
        f"{one.name}-{other.name}",
        walker,
        between(one.radius, other.radius),
        between(one.wavelength, other.wavelength),
        Spread((a.mean + b.mean) / 2, (a.deviation + b.deviation) / 2, a.least, a.most),
        between(one.length, other.length),
    )


@cache
def _known() -> dict[str, HairType]:
    """Hair types by every name that ``hair_type`` takes, in lower case."""
    types = {kind.name: kind for kind in HAIR_TYPES}
    types["VII-VIII"] = _middle(types["VII"], types["VIII"], "4B")
    names = {name.lower().replace("-", " "): kind for name, kind in types.items()}
    # A bare 1 to 4 may be one of Walker's groups as well: see ``hair_type``.
    names.update({str(number): HAIR_TYPES[number - 1] for number in range(5, 9)})
    names.update({letters.lower(): types[name] for letters, name in WALKER.items()})
    names.update({thing: types[WALKER[letters]] for thing, letters in THINGS.items()})
    return names


def hair_type(name: str) -> HairType:
    """The hair type that people call ``name``: I to VIII, 1A to 4C, or what a curl compares with (``"straw"``).

    Upper or lower case; a leading "type" is ignored. Raises TextureError for other names, and for a bare 1 to 4,
    which may be one of the eight types or a group of Walker's.
    """
    wanted = re.sub(r"^(hair )?type ", "", " ".join(re.split(r"[\s_-]+", name.strip().lower())))
    known = _known()
    if wanted in known:
        return known[wanted]
    if wanted in ("1", "2", "3", "4"):
        letters = [key for key in WALKER if key.startswith(wanted)]
        raise TextureError(
            f"hair type {name.strip()!r} can mean {HAIR_TYPES[int(wanted) - 1].name} of the eight types, or "
            f"{letters[0]} to {letters[-1]}: say which"
        )
    near = difflib.get_close_matches(wanted, known, n=3, cutoff=0.5)
    shown = [match.upper() if len(match) <= 4 and match not in THINGS else match for match in near]
    hint = f"did you mean {' or '.join(shown)}?" if shown else "use I to VIII, 1A to 4C, or a thing such as straw"
    raise TextureError(f"unknown hair type {name.strip()!r}: {hint}")


_UNITS = {
    **CM_PER_UNIT,
    "um": 1e-4,
    "µm": 1e-4,  # the micro sign, and below it the Greek letter
    "μm": 1e-4,
    '"': 2.54,
    "inch": 2.54,
    "inches": 2.54,
}
_QUANTITY = re.compile(r"(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*(?P<unit>[^\d\s.,+-]*)")


def parse_length(text: str, name: str = "length") -> float:
    """The length [cm] in ``"4mm"``, ``"0.4 cm"``, ``"0.05in"``, or a bare number of centimetres.

    name: what an error calls it. Raises TextureError where it is no length, or not more than zero.
    """
    return _split(text, name)[0]


def _split(text: str, name: str) -> tuple[float, str]:
    """The length [cm] in a text, and the unit as it was typed, empty for a bare number."""
    found = _QUANTITY.fullmatch(text.strip().lower())
    if found is None:
        pointed = text.strip().replace(",", ".")
        hint = f"{pointed}, with a point" if _QUANTITY.fullmatch(pointed.lower()) else "4mm, 0.4cm, or a number in cm"
        raise TextureError(f"{name} {text.strip()!r} is not a length: write {hint}")
    unit = found["unit"]
    if unit and unit not in _UNITS:
        near = difflib.get_close_matches(unit, _UNITS, n=1)
        hint = f"did you mean {near[0]}?" if near else f"use one of {', '.join(CM_PER_UNIT)}"
        raise TextureError(f"{name} {text.strip()!r} has the unknown unit {unit!r}: {hint}")
    value = float(found["number"]) * _UNITS[unit or "cm"]
    if not 0.0 < value < math.inf:
        raise TextureError(f"{name} {text.strip()!r} must be more than zero, and finite")
    return value, unit


@dataclass(frozen=True)
class Profile:
    """A value that varies along a strand: ``values`` (K,) at even steps from root to tip, linear between them."""

    values: tuple[float, ...]

    def __call__(self, t: ArrayLike) -> NDArray[np.float64]:
        """The values at positions t (...), 0 at the root and 1 at the tip."""
        return np.interp(np.asarray(t, dtype=np.float64), np.linspace(0.0, 1.0, len(self.values)), self.values)

    @property
    def constant(self) -> bool:
        return len(set(self.values)) == 1


def parse_profile(text: str, name: str = "length") -> Profile:
    """The lengths [cm] along a strand in ``"0.6:0.3"`` (root:tip), ``"6mm:4mm:3mm"``, or one length for all of it.

    Raises TextureError as ``parse_length`` does, and where only some of the lengths have a unit.
    """
    parts = [_split(part, name) for part in text.split(":")]
    if len({bool(unit) for _, unit in parts}) > 1:
        raise TextureError(f"{name} {text.strip()!r}: give each length its unit, or none for centimetres")
    return Profile(tuple(value for value, _ in parts))
