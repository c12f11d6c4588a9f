"""What hair is made of: sections, stiffnesses and masses of fibres, dry and wet.

Paper section "Simulation". Hair is hung wet, for its shape sets as it dries; what water does to the stiffness is in the
moduli that are given, what it does to the mass follows from porosity here. Units are cm, g, s: forces in dyn. Numbers:
Kamath, Hornby and Weigmann 1984 and Robbins, "Chemical and Physical Behavior of Human Hair", for hair's moduli, its
density, and the 31 % of its own weight that it takes up in water.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.errors import TextureError
from detangled.geometry.inputs import compiled_input
from detangled.kernels import parallel_kernel, prange
from detangled.texture import (
    AXIS_RATIO_LIMITS,
    SHARE_LIMITS,
    THICKNESS_LIMITS,
    USUAL_AXIS_RATIO,
    USUAL_POROSITY,
    USUAL_THICKNESS,
)

DENSITY = 1.32  # [g/cm^3] of dry hair
DRY_YOUNGS, DRY_SHEAR = 3.9, 0.85  # [GPa]
WET_YOUNGS, WET_SHEAR = 1.5, 0.2  # [GPa]; E is from 1.3 to 1.9
MODULUS_LIMITS = (1e-3, 20.0)  # [GPa], wide enough for soft test rods, too narrow for a value in MPa or in Pa

# Wet mass over dry mass. No published figures of how porosity spreads the water were found: the ramp is our proposal.
EVEN_WATER = 1.30  # all along at porosity 0, near the 31 % of saturated hair
ROOT_WATER = 1.20  # at porosity 1
TIP_WATER = 1.90

CM_PER_UM = 1e-4
DYN_PER_CM2_IN_GPA = 1e10


@dataclass(frozen=True)
class Fibres:
    """The material of S strands, an array each; a single number counts for all of them.

    thickness: (S,) [um], the diameter of the circle that has the area of the section, 20 to 180.
    axis_ratio: (S,) minor over major axis of the elliptic section, 0.55 to 1. porosity: (S,) 0 to 1.
    youngs, shear: (S,) [GPa], the moduli in the state that is simulated: those of wet hair where it hangs wet.

    Raises TextureError where a value is not finite or out of its limits, or the arrays differ in length.
    """

    thickness: NDArray[np.float64]
    axis_ratio: NDArray[np.float64]
    porosity: NDArray[np.float64]
    youngs: NDArray[np.float64]
    shear: NDArray[np.float64]

    def __post_init__(self) -> None:
        limits = {
            "thickness": (*THICKNESS_LIMITS, " um"),
            "axis_ratio": (*AXIS_RATIO_LIMITS, ""),
            "porosity": (*SHARE_LIMITS, ""),
            "youngs": (*MODULUS_LIMITS, " GPa"),
            "shear": (*MODULUS_LIMITS, " GPa"),
        }
        try:
            arrays = np.broadcast_arrays(
                *(np.atleast_1d(np.asarray(getattr(self, f.name), dtype=np.float64)) for f in fields(self))
            )
        except ValueError as error:
            raise TextureError("the arrays of fibres must have one value a strand each") from error
        if arrays[0].ndim != 1:
            raise TextureError(f"the arrays of fibres must have the shape (S,), not {arrays[0].shape}")
        for (name, (least, most, unit)), values in zip(limits.items(), arrays, strict=True):
            wrong = ~((values >= least) & (values <= most))  # true of NaN too
            if wrong.any():
                s = int(np.argmax(wrong))
                called = name.replace("_", " ")
                raise TextureError(
                    f"fibre {s} has the {called} {values[s]:g}{unit}, outside {least:g} to {most:g}{unit}"
                )
            values = np.array(values)
            values.flags.writeable = False
            object.__setattr__(self, name, values)

    def __len__(self) -> int:
        return len(self.thickness)

    @classmethod
    def usual(cls, count: int, wet: bool = True) -> Fibres:
        """``count`` fibres in the middle of what hair has, with the moduli of wet or of dry hair."""
        youngs, shear = (WET_YOUNGS, WET_SHEAR) if wet else (DRY_YOUNGS, DRY_SHEAR)
        ones = np.ones(count)
        return cls(ones * USUAL_THICKNESS, ones * USUAL_AXIS_RATIO, ones * USUAL_POROSITY, ones * youngs, ones * shear)

    def dried(self) -> Fibres:
        """The same fibres with the moduli of dry hair."""
        return replace(self, youngs=np.full(len(self), DRY_YOUNGS), shear=np.full(len(self), DRY_SHEAR))

    def isotropic(self) -> Fibres:
        """Fibres that bend about any axis, and twist, with one stiffness: round, and G = E / 2, so that G J = E I."""
        return replace(self, axis_ratio=np.ones(len(self)), shear=self.youngs / 2.0)

    def semi_axes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Half the major and half the minor axis of the section [cm], (S,) each."""
        radius = 0.5 * CM_PER_UM * self.thickness
        return radius / np.sqrt(self.axis_ratio), radius * np.sqrt(self.axis_ratio)

    def area(self) -> NDArray[np.float64]:
        """Area of the section [cm^2], (S,)."""
        return np.pi * (0.5 * CM_PER_UM * self.thickness) ** 2

    def bending(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Stiffness E I [dyn cm^2] of bending about the major axis, the weaker, and about the minor; (S,) each."""
        a, b = self.semi_axes()
        youngs = DYN_PER_CM2_IN_GPA * self.youngs
        return youngs * np.pi * a * b**3 / 4.0, youngs * np.pi * a**3 * b / 4.0

    def torsion(self) -> NDArray[np.float64]:
        """Stiffness G J [dyn cm^2] of twisting, (S,); J of an ellipse after Saint-Venant."""
        a, b = self.semi_axes()
        return DYN_PER_CM2_IN_GPA * self.shear * np.pi * (a * b) ** 3 / (a**2 + b**2)

    def axial(self) -> NDArray[np.float64]:
        """Stiffness E A [dyn] of stretching, (S,)."""
        return DYN_PER_CM2_IN_GPA * self.youngs * self.area()

    def dry_mass(self) -> NDArray[np.float64]:
        """Mass of dry hair [g/cm] per length of arc, (S,)."""
        return DENSITY * self.area()

    def wet_mass(self, share: ArrayLike) -> NDArray[np.float64]:
        """Mass of wet hair [g/cm] at shares (..., S) of the arc, 0 at the root and 1 at the tip."""
        return self.dry_mass() * water(self.porosity, share)


def water(porosity: ArrayLike, share: ArrayLike) -> NDArray[np.float64]:
    """Wet over dry mass at shares of the arc, 0 at the root and 1 at the tip; arrays broadcast.

    Hair of low porosity holds water evenly; in hair of high porosity it runs down and gathers towards the tip. Between
    them the two are blended in proportion. The numbers are our proposal.
    """
    p = np.asarray(porosity, dtype=np.float64)
    ramp = ROOT_WATER + (TIP_WATER - ROOT_WATER) * np.asarray(share, dtype=np.float64)
    return (1.0 - p) * EVEN_WATER + p * ramp


def point_masses(
    points: NDArray[np.float64], offsets: NDArray[np.int64], fibres: Fibres, wet: bool = True
) -> NDArray[np.float64]:
    """Mass [g] of each point (P,) of strands (S + 1 offsets): half of the segments beside it, wet or dry."""
    lengths, shares = np.zeros(len(points)), np.zeros(len(points))
    _segments(compiled_input(points, np.float64), compiled_input(offsets, np.int64), lengths, shares)
    strand = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    masses = fibres.dry_mass()[strand] * lengths
    if wet:
        masses *= water(fibres.porosity[strand], shares)
    half = 0.5 * masses
    half[1:] += 0.5 * masses[:-1]  # the segment after a strand's last point has no mass
    return half


@parallel_kernel
def _segments(
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    lengths: NDArray[np.float64],
    shares: NDArray[np.float64],
) -> None:
    """Fill length and share of the arc, at its middle, of the segment after each point; zeros after the last."""
    for s in prange(offsets.shape[0] - 1):
        total = 0.0
        for i in range(offsets[s], offsets[s + 1] - 1):
            lengths[i] = np.sqrt(((points[i + 1] - points[i]) ** 2).sum())
            shares[i] = total + 0.5 * lengths[i]
            total += lengths[i]
        for i in range(offsets[s], offsets[s + 1] - 1):
            shares[i] = shares[i] / total if total > 0.0 else 0.0
