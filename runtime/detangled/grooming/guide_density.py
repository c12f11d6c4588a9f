"""Style guides as dense as a texture needs them, those that would grow into the head left out.

Paper sections "Style guide resampling" and "Treating Interpenetrations".
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from detangled.groom import Groom
from detangled.grooming.density import check_points, checked_factor, density_change
from detangled.grooming.density_resampling import Resampled, resampled
from detangled.grooming.guides import StyleGuides
from detangled.grooming.keeping_out import Keeper
from detangled.grooming.scalp import scalp_of
from detangled.head import Head


def guides_for(
    groom: Groom,
    guides: StyleGuides,
    radius: float,
    factor: float | None,
    head: Head | None,
    keeper: Keeper | None,
    seed: int,
    points: float,
) -> tuple[Resampled, str]:
    """A groom with guides for a texture of this radius [cm], and a sentence that says how many.

    factor: of the density; None for the square of the ratio of the groom's radius to the texture's. head: in the
    groom's frame. keeper: what turns guides out of it; those between others that lie deep in it are left out.
    points: that strands of the texture would have in all on the guides there are. Raises DetangledError for a factor
    that is none, or makes too many strands or points.
    """
    scalp = scalp_of(guides.groom.points[guides.groom.offsets[:-1]])
    reason = "as asked"
    notes: tuple[str, ...] = ()
    if factor is None:
        change = density_change(guides, radius, scalp)
        factor, notes = change.factor, change.notes
        reason = f"radius {change.input_radius:.2g} cm to {change.target_radius:.2g} cm asks for {factor:.2f} times"
    factor = checked_factor(factor, len(guides.kept))
    check_points(factor * len(guides.kept), factor * max(points, len(guides.points)))
    # A turned guide is no longer its strand's own: radii are told before.
    if keeper is not None:
        guides = keeper.turned(guides)
    dense = resampled(groom, guides, factor, head, seed, scalp)
    dropped = 0
    if keeper is not None:
        dense, dropped = _kept_out(dense, keeper)
    before, after = len(guides.kept), len(dense.guides.kept)
    said = f"style guides: {before} to {after}, {after / max(before, 1):.2f} times ({reason})"
    if dropped:
        said += f"; {dropped} that would lie deep in the head were left out"
    if dense.refused:
        said += f"; none on {100.0 * dense.refused:.0f} % of the scalp, where neighbours part"
    return replace(dense, notes=(*notes, *dense.notes)), said


def _kept_out(dense: Resampled, keeper: Keeper) -> tuple[Resampled, int]:
    """Without the guides between others that would lie deep in the head, and how many these were."""
    new = dense.original[dense.guides.kept] < 0
    deep = new & keeper.deep(replace(dense.guides.groom, points=dense.guides.points, attributes={}))
    return _without(dense, deep), int(np.count_nonzero(deep))


def _without(dense: Resampled, dropped: NDArray[np.bool_]) -> Resampled:
    """The same without some of its usable strands (S,)."""
    if not dropped.any():
        return dense
    guides = dense.guides
    stay = np.setdiff1d(np.arange(dense.groom.strand_count), guides.kept[dropped])
    left = StyleGuides(
        guides.groom.select(~dropped),
        np.searchsorted(stay, guides.kept[~dropped]),
        guides.points[np.repeat(~dropped, guides.groom.point_counts)],
        guides.lengths[~dropped],
    )
    return replace(dense, groom=dense.groom.select(stay), guides=left, original=dense.original[stay])
