"""Units of length: centimetres inside detangled, in files whatever their author used."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from detangled.errors import ReadError

CM_PER_UNIT = {"mm": 0.1, "cm": 1.0, "dm": 10.0, "m": 100.0, "in": 2.54}

# A groom spans a head or a swatch: its bounding box has a diagonal near this, within a factor of about three.
TYPICAL_DIAGONAL_CM = 35.0
# Some programs' unit is none of these: TressFX's samples are about 2.5 mm a unit.
_SIZE = re.compile(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)? ?([a-z]+)")
SIZES = (1e-6, 1e6)  # [cm] of units: beyond them hair in a file of float32 may be infinite, or a point
GUESSED_UNITS = ("m", "cm", "mm")
POINTS_TO_GUESS_FROM = 20_000
STRAY_QUANTILES = (0.01, 0.99)


def guess_unit(points: NDArray[np.floating]) -> str:
    """Name the unit in which ``points`` (P, 3) would be nearest to the size of a head of hair.

    Decided by where most of the points lie, so that a few stray ones do not; those that are not finite are ignored.
    Without two distinct finite points the answer is ``"cm"``.
    """
    sample = points[:: max(1, len(points) // POINTS_TO_GUESS_FROM)].astype(np.float64)
    sample = sample[np.isfinite(sample).all(axis=1)]
    if len(sample) == 0:
        return "cm"
    low, high = np.quantile(sample, STRAY_QUANTILES, axis=0)
    diagonal = float(np.linalg.norm(high - low))
    if diagonal == 0.0:
        return "cm"
    return min(GUESSED_UNITS, key=lambda name: abs(np.log(diagonal * CM_PER_UNIT[name] / TYPICAL_DIAGONAL_CM)))


def cm_per_unit(name: str) -> float:
    """Centimetres in one unit called ``name``, or in so many of one (``"2.5mm"``).

    Raises ReadError for a unit that is not known, or beyond SIZES.
    """
    size = _SIZE.fullmatch(name)
    cm = float(size[1] or 1) * CM_PER_UNIT.get(size[2], 0.0) if size else 0.0
    if not SIZES[0] <= cm <= SIZES[1]:
        raise ReadError(f"unknown unit {name!r}: use one of {', '.join(CM_PER_UNIT)}, or so many of one, as 2.5mm")
    return cm


def unit_name(cm: float) -> str:
    """Name the unit of ``cm`` centimetres, or say it in numbers where it has no name."""
    for name, size in CM_PER_UNIT.items():
        if abs(cm - size) <= 1e-9 * size:
            return name
    return f"{cm:g} cm"
