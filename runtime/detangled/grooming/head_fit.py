"""Whether a head and a groom belong together: its roots lie on the head, in one unit and with one axis up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from detangled.errors import ReadError
from detangled.groom import Groom
from detangled.grooming.guides import usable_strands
from detangled.grooming.head_distance import exact_distances
from detangled.grooming.head_inside import winding_tree
from detangled.head import Head
from detangled.units import CM_PER_UNIT, unit_name

ROOTS = 200  # of a groom are looked at, evenly over its strands
FEW_ROOTS = 8  # every so many of them, for each way in which a head could be mistaken
TOUCHING = 1.0  # [cm] from the surface, in the median: hair cards and caps lie that far off
SAME = 1e-3  # of a factor between units
BESIDE = 3.0  # [cm] beyond which a groom is on another head
# What takes an axis up to another: y to z, and z to y.
_TURNS = {
    ("y", "z"): np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    ("z", "y"): np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}


def fitted_to(head: Head, groom: Groom) -> Head:
    """The head as it goes with a groom, with notes on what was done or looks wrong.

    A head whose roots only lie on it with another axis up is turned. Raises ReadError where it has another scale than
    the groom, saying which, or where the roots are elsewhere.
    """
    kept = np.flatnonzero(usable_strands(groom))
    if len(kept) == 0 or len(head.faces) == 0:
        return head
    chosen = kept[np.unique(np.linspace(0, len(kept) - 1, ROOTS).astype(np.int64))]
    roots = groom.points[groom.offsets[chosen]]
    off = _distance(head, roots)
    if off <= TOUCHING:
        return head
    few = roots[::FEW_ROOTS]
    for (old, new), turn in _TURNS.items():
        turned = replace(head, vertices=head.vertices @ turn.T)
        if _distance(turned, few) <= TOUCHING:
            return replace(turned, notes=(*head.notes, f"turned from {old} up to {new} up, as the groom is"))
    scales = [
        (_distance(replace(head, vertices=factor * head.vertices @ turn.T), few) / min(1.0, factor), factor)
        for turn in (np.eye(3), *_TURNS.values())
        for factor in _factors(head, groom)
    ]
    nearest, factor = min(scales)
    if nearest <= TOUCHING:
        raise ReadError(_other_scale(head, groom, factor))
    size = " x ".join(f"{side:.3g}" for side in np.ptp(head.vertices[head.faces].reshape(-1, 3), axis=0))
    if off > BESIDE:
        raise ReadError(
            f"the groom does not grow on this head: in the median its roots are {off:.3g} cm from the head, which is "
            f"{size} cm large; both must be in one place, with one axis up (--head-unit and --unit say their units)"
        )
    return replace(head, notes=(*head.notes, f"the roots are {off:.2g} cm from its surface in the median"))


def _distance(head: Head, roots: NDArray[np.float64]) -> float:
    """Distance [cm] of these points from the surface, in the median."""
    return float(np.median(np.abs(exact_distances(winding_tree(head), roots))))


def _factors(head: Head, groom: Groom) -> list[float]:
    """By how much a head would grow were it, or the groom, in another unit that has a name."""
    units = CM_PER_UNIT.values()
    found = {unit / head.unit_cm for unit in units} | {groom.unit_cm / unit for unit in units}
    return sorted(factor for factor in found if abs(factor - 1.0) > SAME)


def _other_scale(head: Head, groom: Groom, factor: float) -> str:
    size = f"{1.0 / factor:.3g} times too large" if factor < 1.0 else f"{factor:.3g} times too small"
    ways = [
        (f"{what} in {unit_name(unit_cm)}, not in {unit_name(was)}", f"--{option} {unit_name(unit_cm)}")
        for what, option, was, unit_cm in (
            ("the head", "head-unit", head.unit_cm, head.unit_cm * factor),
            ("the groom", "unit", groom.unit_cm, groom.unit_cm / factor),
        )
        if any(abs(unit_cm / known - 1.0) < SAME for known in CM_PER_UNIT.values())
    ]
    seems, say = (" or ".join(part) for part in zip(*ways, strict=True))
    return f"the head is {size} for the groom: {seems}? Say so with {say}"
