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
TOUCHING = 1.0  # [cm] from the surface: hair cards and caps lie that far off
SAME = 1e-3  # of a factor between units
BESIDE = 3.0  # [cm] in the median, beyond which a groom is on another head
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
    roots = _some_roots(groom)
    if len(roots) == 0 or len(head.faces) == 0:
        return head
    off = _distances(head, roots)
    if not np.median(off) <= TOUCHING:
        few = roots[::FEW_ROOTS]
        for (old, new), turn in _TURNS.items():
            turned = replace(head, vertices=head.vertices @ turn.T)
            if np.median(_distances(turned, few)) <= TOUCHING:
                return replace(turned, notes=(*head.notes, f"turned from {old} up to {new} up, as the groom is"))
        check_fit(head, groom)
    away = np.count_nonzero(off > TOUCHING)
    if away == 0:
        return head
    said = f"{away} of {len(off)} roots that were looked at lie off its surface, by up to {off.max():.2g} cm"
    return replace(head, notes=(*head.notes, said))


def check_fit(head: Head, groom: Groom) -> None:
    """Raise ReadError, saying why, where a groom cannot grow on a head as it is."""
    if why := misfit(head, groom):
        raise ReadError(why)


def misfit(head: Head, groom: Groom) -> str | None:
    """Why a groom cannot grow on a head as it is, in a sentence; None where it can, or has no usable strand."""
    finite = np.asarray(np.isfinite(head.vertices).all(axis=1))
    faces = head.faces[finite[head.faces].all(axis=1)]
    if len(faces) == 0:
        return "the head has no faces: nothing can grow on it"
    head = replace(head, faces=faces, uv=None)
    roots = _some_roots(groom)
    off = float(np.median(_distances(head, roots))) if len(roots) else 0.0
    if off <= TOUCHING:
        return None
    few = roots[::FEW_ROOTS]
    scales = [
        (float(np.median(_distances(changed, few))) / min(1.0, factor), factor)
        for turn in (np.eye(3), *_TURNS.values())
        for factor in _factors(head, groom)
        for changed in [replace(head, vertices=factor * head.vertices @ turn.T)]
    ]
    nearest, factor = min(scales)
    if nearest <= TOUCHING:
        return _other_scale(head, groom, factor)
    if off <= BESIDE:
        return None
    size = " x ".join(f"{side:.3g}" for side in np.ptp(head.vertices[head.faces].reshape(-1, 3), axis=0))
    return (
        f"the groom does not grow on this head: in the median its roots are {off:.3g} cm from the head, which is "
        f"{size} cm large; both must be in one place, with one axis up (--head-unit and --unit say their units)"
    )


def _some_roots(groom: Groom) -> NDArray[np.float64]:
    """Roots (R, 3) [cm] of usable strands, evenly over all of them."""
    kept = np.flatnonzero(usable_strands(groom))
    if len(kept) == 0:
        return np.zeros((0, 3))
    chosen = kept[np.unique(np.linspace(0, len(kept) - 1, ROOTS).astype(np.int64))]
    return groom.points[groom.offsets[chosen]]


def _distances(head: Head, roots: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances (R,) [cm] of these points from the surface."""
    return np.abs(exact_distances(winding_tree(head), roots))


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
