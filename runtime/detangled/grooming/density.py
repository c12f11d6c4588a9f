"""How much denser or sparser style guides must be to carry another texture.

Paper section "Style guide resampling": the radii of input and target in canonical space are mean distances from the
z-axis, values beyond three standard deviations left out; the square of their ratio is the change of density, as of
circles packed on the scalp.

A straight strand is its own guide and has radius 0, by which formula any straight hair would have to be thinned to
nothing. But a guide without curl stands for a wisp, and that is as wide as the place it has to itself: half of the
distance to its neighbours, were they packed hexagonally. So that is a straight strand's radius here.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from detangled.errors import DetangledError
from detangled.geometry.winding import mean_without_outliers, winding
from detangled.grooming.guides import StyleGuides
from detangled.grooming.scalp import Scalp, scalp_of

STRAIGHT_RADIUS = 0.01  # [cm] about a hair's width: nobody sees such a curl, and a guide does not have it
# Tightest of the eight types from the widest is 28 times denser; beyond this the radii are not what they seem.
MOST_FACTOR = 32.0
MOST_STRANDS = 4_000_000  # what an engine takes of one groom, and more than fits in most memories
MOST_POINTS = 250_000_000  # of all strands: some 15 GB with all that is made of them


@dataclass(frozen=True)
class DensityChange:
    """By which factor the density of guides is to change, from which radii [cm], and what there is to say of it.

    straight: the share of the input's strands that have no curl, whose radius is half of their spacing.
    """

    factor: float
    input_radius: float
    target_radius: float
    straight: float
    notes: tuple[str, ...] = ()


def input_radius(guides: StyleGuides, scalp: Scalp | None = None) -> tuple[float, float]:
    """Radius [cm] of a groom's strands in canonical space, and the share of them that are straight."""
    radius, _ = winding(guides.canonical(), guides.groom.offsets)
    straight = radius < STRAIGHT_RADIUS
    if straight.any():
        scalp = scalp or scalp_of(guides.groom.points[guides.groom.offsets[:-1]])
        radius = np.where(straight, scalp.packing_radius(), radius)
    return float(mean_without_outliers(radius)), float(straight.mean()) if len(straight) else 0.0


def density_change(guides: StyleGuides, target_radius: float, scalp: Scalp | None = None) -> DensityChange:
    """The change of density that a texture of radius ``target_radius`` [cm] needs on these guides."""
    own, straight = input_radius(guides, scalp)
    if target_radius < STRAIGHT_RADIUS:
        return DensityChange(1.0, own, target_radius, straight, ("straight hair needs no other density; it is kept",))
    if own < STRAIGHT_RADIUS:
        said = "the input has neither curl nor neighbours to tell its density by; it is kept"
        return DensityChange(1.0, own, target_radius, straight, (said,))
    asked = (own / target_radius) ** 2
    factor = min(max(asked, 1.0 / MOST_FACTOR), MOST_FACTOR)
    notes = []
    if factor != asked:
        notes.append(
            f"radius {own:.2g} cm to {target_radius:.2g} cm asks for {asked:.3g} times the density; "
            f"{factor:.3g} times is done: give a factor for more"
        )
    return DensityChange(factor, own, target_radius, straight, tuple(notes))


def checked_factor(factor: float, strands: int) -> float:
    """The factor itself, by which so many strands become more or fewer.

    Raises DetangledError where it is not finite, not more than zero, or makes more strands than four million.
    """
    if not 0.0 < factor < inf:
        raise DetangledError(f"a change of density of {factor:g} is none: give a number above zero, such as 2.5")
    if factor * strands > MOST_STRANDS:
        raise DetangledError(
            f"{factor:g} times the density would be {factor * strands:.3g} strands: at most {MOST_STRANDS:,} are made"
        )
    return float(factor)


def check_points(strands: float, points: float, options: str = "--density or --max-points") -> None:
    """Raise DetangledError, which names the options to lower, where strands would have too many points in all."""
    if points > MOST_POINTS:
        raise DetangledError(
            f"{strands:,.0f} strands would have {points:.3g} points: at most {MOST_POINTS:,} are made; lower {options}"
        )
