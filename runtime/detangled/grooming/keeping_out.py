"""A groom kept out of a head while it is retextured: guides first, then the strands on them, counted throughout."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from detangled.base_texture import Texture
from detangled.groom import Groom
from detangled.grooming.guides import StyleGuides
from detangled.grooming.head_distance import HeadDistance, head_distance
from detangled.grooming.interpenetration import Inside, OnPenetration, entering, inside, turned_out
from detangled.grooming.lifting import Room
from detangled.head import Head
from detangled.usable import usable_strands

HAIR_WIDTH = 0.008  # [cm] of hair, where a groom does not say
THICKEST = 0.05  # [cm] what is said to be thicker is a strip or a tube
SPARE = 0.02  # [cm] beyond half a hair's width: what the grid and the way between points may be off
# [cm] What enters less deep is lifted off when strands are placed: of long hair the least turn swings the tips further.
LIFTED = 0.3
WIDEST_WINDOW = 1.5  # [cm] of a guide that is lifted together, also where hair hardly curls
LEAST_WINDOW = 0.2
LISTED = 5  # strands in a sentence


@dataclass(frozen=True)
class Penetration:
    """How much hair was in the head, the first 3 mm at roots apart, and what became of it.

    before, after: points inside. of_before, of_after: points looked at. deepest_before, deepest_after: [cm].
    turned: guides turned about their roots. deleted: strands that were taken away. entering: indices in the new groom
    of the strands that still enter.
    """

    before: int
    of_before: int
    deepest_before: float
    after: int
    of_after: int
    deepest_after: float
    turned: int
    deleted: int
    entering: NDArray[np.int64]

    def __str__(self) -> str:
        said = (
            f"inside the head: {self.before} of {self.of_before} points before, {self.after} of {self.of_after} after"
        )
        if self.after:
            said += f", the deepest {self.deepest_after:.2g} cm (before: {self.deepest_before:.2g} cm)"
        if self.turned:
            said += f"; {self.turned} guides turned"
        if self.deleted:
            said += f"; {self.deleted} strands deleted"
        return said

    def warnings(self) -> list[str]:
        """What a person should look at, one sentence each."""
        if not len(self.entering):
            return []
        some = ", ".join(str(index) for index in self.entering[:LISTED])
        more = ", ..." if len(self.entering) > LISTED else ""
        return [f"{len(self.entering)} strands still enter the head: {some}{more}; --on-penetration delete drops them"]


class Keeper:
    """Keeps the strands of one groom out of a head, as asked."""

    def __init__(self, head: Head, groom: Groom, texture: Texture, wish: OnPenetration) -> None:
        self.distance: HeadDistance = head_distance(head, groom.points)
        self._wish = wish
        self._before = inside(groom.points, groom.offsets, self.distance)
        self._turned = 0
        around = texture.turn / texture.arc_per_axis
        self._room = Room(
            self.distance, _clearance(groom), float(np.clip(around, LEAST_WINDOW, WIDEST_WINDOW)), texture.turn
        )

    @property
    def room(self) -> Room | None:
        """What new strands need; None where they are to stay as they come."""
        return None if self._wish is OnPenetration.KEEP else self._room

    def turned(self, guides: StyleGuides) -> StyleGuides:
        """Guides that enter the head deeply turned out of it, where that takes no more than a small turn."""
        if self._wish is OnPenetration.KEEP:
            return guides
        strands = replace(guides.groom, points=guides.points, attributes={})
        deep = self.deep(strands)
        some = strands.select(deep)
        found = turned_out(some.points, some.offsets, self.distance, self._room.clearance)
        self._turned = int(np.count_nonzero(found.angles))
        points = guides.points.copy()
        points[np.repeat(deep, strands.point_counts)] = found.points
        return replace(guides, points=points)

    def deep(self, guides: Groom) -> NDArray[np.bool_]:
        """Which guides (S,) enter the head more deeply than strands on them are lifted."""
        return entering(guides.points, guides.offsets, self.distance, LIFTED)

    def finished(self, groom: Groom) -> tuple[NDArray[np.bool_], Penetration]:
        """Which strands (S,) of the new groom stay, and what there is to say of those."""
        after = inside(groom.points, groom.offsets, self.distance)
        stay = np.ones(groom.strand_count, dtype=np.bool_)
        if self._wish is OnPenetration.DELETE:
            usable = usable_strands(groom)  # others may be of any size
            strands = groom.select(usable)
            stay = after.points == 0
            stay[usable] &= ~entering(strands.points, strands.offsets, self.distance, SPARE)
            after = Inside(*(values[stay] for values in after))
        before = self._before
        return stay, Penetration(
            before=int(before.points.sum()),
            of_before=int(before.counted.sum()),
            deepest_before=_deepest(before),
            after=int(after.points.sum()),
            of_after=int(after.counted.sum()),
            deepest_after=_deepest(after),
            turned=self._turned,
            deleted=int(np.count_nonzero(~stay)),
            entering=np.flatnonzero(after.points),
        )


def _clearance(groom: Groom) -> float:
    """How far [cm] the middle of a hair has to be outside."""
    width = groom.attributes.get("width")
    if width is None or not len(width.values):
        return 0.5 * HAIR_WIDTH + SPARE
    return 0.5 * min(float(np.median(width.values)), THICKEST) + SPARE


def _deepest(found: Inside) -> float:
    return max(float(found.depths.max(initial=0.0)), 0.0)
