"""A texture that goes with a groom through its frames: made once, on the first, and carried by its style guides.

Each point of a styled strand keeps its place in the frame of its guide, the paper's canonical space ("Canonical Space
& Style Guides"), at the same distance along the guide; the frame is carried along the guide without twist from the
root, and at the root it follows the scalp. So a curl neither slides along its strand nor turns about it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from detangled.errors import ReadError
from detangled.formats.frames import Frames
from detangled.geometry.inputs import compiled_input
from detangled.groom import Groom
from detangled.grooming.carrying import bound, carried, first_frames
from detangled.grooming.following import followed_guides, root_rotations, windows
from detangled.grooming.guides import StyleGuides, style_guides
from detangled.usable import usable_strands

# A styled root this far from the old one [cm] is still the same.
SAME_ROOT = 1e-4


@dataclass(frozen=True)
class Carrier:
    """What is kept of a groom's first frame to give any other the same texture.

    rest: the groom as it was, first frame. styled: the groom with its new texture, first frame. guides: style guides
    of the strands of ``rest``. drivers: (S,), which of the guides each styled strand goes with, -1 for none: it goes
    as the strand of its own number. places: (Q,) [cm], where along its guide each styled point is; local: (Q, 3) [cm],
    where it is in the guide's frame there. roots: (R, 3, 3), frames of the guides at their roots. reaches: (R,),
    surroundings by which the guides follow.
    """

    rest: Groom
    styled: Groom
    guides: StyleGuides
    drivers: NDArray[np.int64]
    places: NDArray[np.float64]
    local: NDArray[np.float64]
    roots: NDArray[np.float64]
    reaches: NDArray[np.int64]

    def points(self, now: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (Q, 3) [cm] of the styled groom where the old one has the points ``now`` (P, 3).

        Every strand is as long as it was, and starts at its root. Raises ReadError where a strand has a coordinate
        that is not finite, or shrinks to a point.
        """
        kept = self.guides.groom
        here = now if len(now) == len(kept.points) else now[self._rows()]
        unusable = ~usable_strands(replace(kept, points=here, attributes={}))
        if unusable.any():
            raise ReadError(
                f"strand {self.guides.kept[np.flatnonzero(unusable)[0]]} cannot be followed: it shrinks to a point, or "
                "has a coordinate that is not finite"
            )
        first = kept.offsets[:-1]
        rotations = root_rotations(kept.points[first], here[first])
        rest = kept.points, self.guides.points, kept.offsets, self.reaches
        guides = followed_guides(*_inputs(*rest, rotations, here))
        strands = self.local, self.places, self.styled.offsets, self.drivers, self.styled.polyline_lengths()
        out = carried(*_inputs(*strands, guides, kept.offsets, self.roots, rotations))
        return self._seated(out, now)

    def _rows(self) -> NDArray[np.bool_]:
        """Which points (P,) of the old groom belong to strands that have guides."""
        mask = np.zeros(self.rest.strand_count, dtype=np.bool_)
        mask[self.guides.kept] = True
        return np.repeat(mask, self.rest.point_counts)

    def _seated(self, out: NDArray[np.float64], now: NDArray[np.float64]) -> NDArray[np.float64]:
        """The carried points with roots where the old roots are, and strands without guides as they move themselves."""
        counts = self.styled.point_counts
        out = np.where(np.repeat(self.drivers < 0, counts)[:, None], self.styled.points, out)
        if self.rest.strand_count != self.styled.strand_count:
            return out
        rooted = (counts > 0) & (self.rest.point_counts > 0) & (self.drivers >= 0)
        before = self.rest.points[self.rest.offsets[:-1][rooted]]
        styled = self.styled.points[self.styled.offsets[:-1][rooted]]
        same = np.linalg.norm(styled - before, axis=1) <= SAME_ROOT
        shift = np.zeros((self.styled.strand_count, 3))
        moved = now[self.rest.offsets[:-1][rooted]] - before + styled - out[self.styled.offsets[:-1][rooted]]
        shift[rooted] = np.where(same[:, None], moved, 0.0)
        out = out + np.repeat(shift, counts, axis=0)
        for strand in np.flatnonzero((self.drivers < 0) & (counts == self.rest.point_counts)):
            old = slice(self.rest.offsets[strand], self.rest.offsets[strand + 1])
            out[self.styled.offsets[strand] : self.styled.offsets[strand + 1]] = now[old]
        return out


def _inputs(*arrays: NDArray[Any]) -> list[NDArray[Any]]:
    return [compiled_input(array, array.dtype) for array in arrays]


def carrier(rest: Groom, styled: Groom) -> Carrier:
    """Keep of a groom's first frame, before and after it was given a texture, what its other frames need.

    Where the styled groom has as many strands, each goes with the old one of its number; else with the one whose root
    is nearest. Raises ReadError where no strand can be followed.
    """
    guides = style_guides(rest)
    if len(guides.kept) == 0:
        raise ReadError(f"none of the {rest.strand_count} strands can be followed: no two distinct finite points each")
    usable = usable_strands(styled)
    if styled.strand_count == rest.strand_count:
        drivers = np.full(rest.strand_count, -1, dtype=np.int64)
        drivers[guides.kept] = np.arange(len(guides.kept))
        drivers[~usable] = -1
    else:
        drivers = np.full(styled.strand_count, -1, dtype=np.int64)
        roots = cKDTree(guides.groom.points[guides.groom.offsets[:-1]])
        drivers[usable] = roots.query(styled.points[styled.offsets[:-1][usable]])[1]
    on = guides.points, guides.groom.offsets
    places, local = bound(*_inputs(styled.points, styled.offsets, drivers, *on))
    return Carrier(
        rest,
        styled,
        guides,
        drivers,
        places,
        local,
        roots=first_frames(*_inputs(*on)),
        reaches=windows(guides.groom.points, *on),
    )


def carried_frames(frames: Frames, styled: Groom) -> Frames:
    """The frames of a styled groom: what its first frame got, carried through those of the old groom.

    frames: of the old groom. styled: its first frame with a texture, in the same unit and axes. A frame is made when
    it is asked for, so memory does not grow with them; each raises what ``Carrier.points`` does, with its number.
    """
    carry = carrier(frames.groom, styled)

    def points(index: int, now: NDArray[np.float64]) -> NDArray[np.float64]:
        try:
            return carry.points(now)
        except ReadError as error:
            raise ReadError(f"frame {index} ({frames.times[index]:g} s): {error}") from error

    return frames.mapped(styled, points)
