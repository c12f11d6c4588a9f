"""Colours of hair, by name, as #rrggbb, or by the pigments in it.

Pigments absorb as in d'Eon, Francois, Hill, Letteri and Aubry (2011), "An energy-conserving hair reflectance model":
so many times these coefficients a hair's radius. What colour a head of such hair has, and back, is from Chiang,
Bitterli, Tappan and Burley (2016), "A practical and controllable hair and fur model for production path tracing".
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from detangled.errors import DetangledError

EUMELANIN = np.array([0.419, 0.697, 1.37])  # absorption for red, green, blue, per unit of concentration
PHEOMELANIN = np.array([0.187, 0.4, 1.05])
ROUGHNESS = 0.3  # azimuthal, beta_N
MOST_MELANIN = 10.0
# The rasteriser sees a strand's own light and not what its neighbours pass on; twice as much looks like such hair,
# and a little comes back from the surface whatever is inside. Set by eye.
GAIN, SURFACE = 2.0, 0.008
BRIGHTEST = 0.55

# Eumelanin and pheomelanin; the amounts were chosen by eye, blond and brown near those usual in renderers.
MELANIN = {
    "black": (3.0, 0.0),
    "darkbrown": (0.9, 0.05),
    "brown": (0.6, 0.1),
    "lightbrown": (0.38, 0.1),
    "auburn": (0.3, 1.1),
    "red": (0.02, 1.0),
    "blond": (0.2, 0.06),
    "platinum": (0.05, 0.0),
}
PLAIN = {"grey": (0.14, 0.14, 0.143), "white": (0.5, 0.5, 0.5)}
_SPELLINGS = {"blonde": "blond", "gray": "grey", "ginger": "red"}


Colour = tuple[float, float, float]


def hair_colour(text: str) -> Colour:
    """Linear RGB, as the rasteriser takes it, of what people write.

    That is a name, ``#rrggbb``, or ``EUMELANIN`` or ``EUMELANIN/PHEOMELANIN``.

    Raises DetangledError where it is none of these.
    """
    said = re.sub(r"(?<=[a-z])[-_ ](?=[a-z])", "", text.strip().lower())
    said = _SPELLINGS.get(said, said)
    if said in MELANIN:
        return by_melanin(*MELANIN[said])
    if said in PLAIN:
        return PLAIN[said]
    if re.fullmatch(r"#[0-9a-f]{6}", said):
        coded = np.array([int(said[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
        return _triple(np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4))
    try:
        amounts = [float(part) for part in said.split("/")]
    except ValueError:
        amounts = []
    if 1 <= len(amounts) <= 2 and all(0.0 <= amount <= MOST_MELANIN for amount in amounts):
        return by_melanin(*amounts)
    raise DetangledError(
        f"{text!r} is not a hair colour: use one of {', '.join([*MELANIN, *PLAIN])}, #rrggbb, or amounts of eumelanin "
        f"and pheomelanin from 0 to {MOST_MELANIN:g}, such as 1.3 or 0.3/0.8"
    )


def by_melanin(eumelanin: float, pheomelanin: float = 0.0) -> Colour:
    """Linear RGB, as the rasteriser takes it, of hair with so much of either pigment."""
    absorption = eumelanin * EUMELANIN + pheomelanin * PHEOMELANIN
    return _triple(np.minimum(GAIN * np.exp(-_spread() * np.sqrt(absorption)) + SURFACE, BRIGHTEST))


def absorption_of(reflectance: NDArray[np.floating]) -> NDArray[np.float64]:
    """Absorption per radius of a hair, (..., 3), of hair that the rasteriser draws in linear RGB (..., 3)."""
    within = np.clip((np.asarray(reflectance, dtype=np.float64) - SURFACE) / GAIN, 1e-4, 0.95)
    return np.asarray((np.log(within) / _spread()) ** 2)


def _spread() -> float:
    """Chiang et al. (2016), equation 9: how often light goes through hairs of a roughness, in the mean."""
    b = ROUGHNESS
    return 5.969 - 0.215 * b + 2.532 * b**2 - 10.73 * b**3 + 5.574 * b**4 + 0.245 * b**5


def _triple(values: NDArray[np.float64]) -> Colour:
    return float(values[0]), float(values[1]), float(values[2])
