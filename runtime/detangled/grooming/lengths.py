"""New strands exactly as long as they should be, on their guides.

Paper section "Adjusting Strand Length": v is scaled by a constant, which keeps curvature and torsion per centimetre
and so the texture. What is left over, up to a few percent, is cut off the tip; strands of few turns are made longer
and cut.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from detangled.geometry.arc import arc_positions
from detangled.geometry.centerline import centerlines
from detangled.geometry.signal import curve_counts, curves
from detangled.geometry.waves import wave_axes
from detangled.groom import Groom, offsets_of
from detangled.grooming.guides import to_canonical
from detangled.grooming.lifting import Room, place_outside
from detangled.grooming.placing import cut, place
from detangled.shape import Shape

# v is scaled until a strand is as long as it should be or this share longer. The axial length of a scaled strand
# scatters by a percent or two, so nothing finer would be reached by scaling alone. After some rounds any strand that
# is long enough will do, and the others are scaled further and further beyond.
MOST_CUT = 0.04
STRICT_ROUNDS = 3
MOST_ROUNDS = 12
MOST_SCALE = 4.0  # of v in one round: a strand that curls back on itself may have hardly any axial length
OFF_AXIS = 0.1  # an old root further out than this share of the new one's distance has a direction to keep
# A new strand's axis may bend as sharply as that of a coil of so many turns. To unbend a stiffer one adds less torsion;
# twists turn an axis more.
STIFF_TURNS, TWISTED_TURNS = 36.0, 24.0


class Length(str, Enum):
    """What a new strand keeps: its guide's length along the axis, or the old strand's arc length."""

    GUIDE = "guide"
    STRAND = "strand"


@dataclass(frozen=True)
class Axis:
    """How the axes of new strands are found.

    bends_over: an axis may bend as sharply as that of a coil of so many turns. wave_turn: arc length [cm] of a turn
    where the strands are weak waves, whose axes are means over it; else 0.
    """

    bends_over: float = STIFF_TURNS
    wave_turn: float = 0.0


@dataclass(frozen=True)
class Seats:
    """Where new strands go.

    guides: a groom of style guides. roots: (S, 3) [cm], where each strand starts in its guide's canonical space. turns:
    (S,) [rad], by how much a strand is turned about its axis where its root lies on the guide. goals: (S,) [cm],
    lengths. cut: (S,), strands that are made too long and cut. straight: (S,), those whose axes are taken to be
    straight: a few turns do not say how an axis bends, and to unbend what was found of it would add torsion. dropped:
    (S,), arc lengths [cm] that strands lose at the root. axis: how theirs are found. shape: given to canonical strands.
    sizes: (S, 2), factors that radius and wavelength of canonical strands are given first; None for none. room: what
    keeps the strands out of a head; None where there is none.
    """

    guides: Groom
    roots: NDArray[np.float64]
    turns: NDArray[np.float64]
    goals: NDArray[np.float64]
    cut: NDArray[np.bool_]
    straight: NDArray[np.bool_]
    dropped: NDArray[np.float64]
    axis: Axis = field(default_factory=Axis)
    shape: Shape | None = None
    sizes: NDArray[np.float64] | None = None
    room: Room | None = None

    def select(self, chosen: NDArray[np.int64]) -> Seats:
        """These seats alone."""
        return Seats(
            self.guides.select(chosen),
            self.roots[chosen],
            self.turns[chosen],
            self.goals[chosen],
            self.cut[chosen],
            self.straight[chosen],
            self.dropped[chosen],
            self.axis,
            self.shape,
            None if self.sizes is None else self.sizes[chosen],
            self.room,
        )


class Built(NamedTuple):
    """Strands (P, 3) [cm] in the world and in canonical space, their offsets (S + 1,), and their lengths uncut (S,)."""

    world: NDArray[np.float64]
    canonical: NDArray[np.float64]
    offsets: NDArray[np.int64]
    lengths: NDArray[np.float64]


class Straightened(NamedTuple):
    """Strands in canonical space, and the axes that they had, both (P, 3) [cm], finely sampled; offsets (S + 1,)."""

    points: NDArray[np.float64]
    axes: NDArray[np.float64]
    offsets: NDArray[np.int64]


class Seated(NamedTuple):
    """World-space strands (P, 3) [cm], finely sampled, their offsets (S + 1,), and how much of its length each has."""

    points: NDArray[np.float64]
    offsets: NDArray[np.int64]
    reached: NDArray[np.float64]


def strands_on_guides(
    values: NDArray[np.float64],
    starts: NDArray[np.int64],
    drawn: tuple[NDArray[np.float64], NDArray[np.int64]],
    seats: Seats,
    length: Length,
) -> Seated:
    """Build strands of signals (C, 3), those of strand s from row starts[s] on, on their guides at their lengths.

    drawn: these straightened and without what they lose at the root, points (P, 3) [cm] and offsets (S + 1,).
    """
    values = values.copy()
    count = len(starts) - 1
    done: list[NDArray[np.float64]] = [np.empty((0, 3))] * count
    straight: list[NDArray[np.float64]] = [np.empty((0, 3))] * count
    reached = np.zeros(count)
    todo = np.arange(count)
    for rounds in range(1, MOST_ROUNDS + 1):
        goals = seats.goals[todo]
        chosen = seats.select(todo)
        if rounds > 1:
            rows = _rows(values, starts, todo)
            whole = straightened(*rows, chosen.straight, chosen.axis)
            drawn = without_roots(whole.points, whole.offsets, chosen.dropped)
        built = _built(*drawn, chosen, length)
        lengths, offsets = built.lengths, built.offsets
        longest = (1.0 + MOST_CUT) * goals
        longest[seats.cut[todo] | (rounds > STRICT_ROUNDS)] = np.inf
        ready = (lengths >= goals) & (lengths <= longest) | (rounds == MOST_ROUNDS)
        scale = np.clip(
            (1.0 + 0.5 * MOST_CUT * rounds) * goals / np.maximum(lengths, 1e-12), 1.0 / MOST_SCALE, MOST_SCALE
        )
        reached[todo] = np.minimum(lengths / goals, 1.0)
        for k, index in enumerate(todo):
            if ready[k]:
                done[index] = built.world[offsets[k] : offsets[k + 1]]
                straight[index] = built.canonical[offsets[k] : offsets[k + 1]]
            else:
                values[starts[index] : starts[index + 1], 2] *= scale[k]
        todo = todo[~ready]
        if len(todo) == 0:
            break
    points, offsets = np.concatenate(done), offsets_of([len(d) for d in done])
    if seats.room is not None:
        canonical = np.concatenate(straight)
        points = place_outside(canonical, offsets, *_places(canonical, offsets, seats), seats.room).points
    return Seated(points, offsets, reached)


def _built(canonical: NDArray[np.float64], offsets: NDArray[np.int64], seats: Seats, length: Length) -> Built:
    """Canonical strands (P, 3), as they are drawn, on their seats, cut at their goals."""
    if seats.sizes is not None:
        canonical = resized(canonical, offsets, seats.sizes)
    if seats.shape is not None:
        canonical = seats.shape.given_to(canonical, offsets, seats.goals, length is Length.GUIDE)
    if length is Length.GUIDE:
        down = canonical[offsets[:-1], 2].repeat(np.diff(offsets)) - canonical[:, 2]
        lengths = np.maximum.reduceat(down, offsets[:-1])
        canonical, offsets = cut(canonical, offsets, down, seats.goals)
    world = place(canonical, offsets, *_places(canonical, offsets, seats))
    if length is Length.STRAND:
        along = arc_positions(world, offsets)
        lengths = along[offsets[1:] - 1]
        canonical, _ = cut(canonical, offsets, along, seats.goals)
        world, offsets = cut(world, offsets, along, seats.goals)
    return Built(world, canonical, offsets, lengths)


def _places(
    canonical: NDArray[np.float64], offsets: NDArray[np.int64], seats: Seats
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Guides, their offsets, roots and angles about the axes, of canonical strands on their seats."""
    angles = _angles(canonical[offsets[:-1]], seats.roots, seats.turns)
    return seats.guides.points, seats.guides.offsets, seats.roots, angles


def straightened(
    values: NDArray[np.float64], starts: NDArray[np.int64], straight: NDArray[np.bool_], axis: Axis
) -> Straightened:
    """Strands of signals (C, 3), strand s from row starts[s] on, in canonical space.

    straight: (S,), those whose axes are taken to be straight.
    """
    offsets = offsets_of(curve_counts(values, starts))
    points = curves(values, starts, offsets)
    if axis.wave_turn > 0.0:
        axes = wave_axes(points, offsets, np.full(len(straight), axis.wave_turn))
    else:
        axes, _ = centerlines(points, offsets, axis.bends_over)
        axes = _straight_where(axes, offsets, straight)
    return Straightened(to_canonical(points, axes, offsets), axes, offsets)


def resized(points: NDArray[np.float64], offsets: NDArray[np.int64], sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Canonical strands (P, 3) with factors (S, 2) of radius and wavelength."""
    return points * np.repeat(sizes[:, [0, 0, 1]], np.diff(offsets), axis=0)


def _straight_where(
    axes: NDArray[np.float64], offsets: NDArray[np.int64], chosen: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Axes (P, 3), those of the chosen strands (S,) straight from their first point to their last.

    A few turns do not say how their axis bends: to unbend what was found of it would add torsion.
    """
    if not chosen.any():
        return axes
    counts = np.diff(offsets)
    inner = np.arange(len(axes)) - np.repeat(offsets[:-1], counts)
    share = (inner / np.repeat(np.maximum(counts - 1, 1), counts))[:, None]
    first, last = (np.repeat(axes[rows], counts, axis=0) for rows in (offsets[:-1], offsets[1:] - 1))
    return np.where(np.repeat(chosen, counts)[:, None], first + share * (last - first), axes)


def without_roots(
    canonical: NDArray[np.float64], offsets: NDArray[np.int64], dropped: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Strands without their first ``dropped`` (S,) [cm], and their offsets."""
    counts = np.diff(offsets)
    kept = arc_positions(canonical, offsets) >= dropped.repeat(counts)
    # Two points are left of any strand.
    kept[offsets[1:] - 1] = True
    kept[offsets[1:] - 2] = True
    return canonical[kept], offsets_of(np.add.reduceat(kept.astype(np.int64), offsets[:-1]))


def _angles(starts: NDArray[np.float64], roots: NDArray[np.float64], turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles (S,) to turn strands by: the new root over the old one where that lies off its guide, else at random."""
    new = np.arctan2(starts[:, 1], starts[:, 0])
    old = np.arctan2(roots[:, 1], roots[:, 0])
    off = np.hypot(roots[:, 0], roots[:, 1]) > OFF_AXIS * np.hypot(starts[:, 0], starts[:, 1])
    return np.where(off, old - new, turns)


def _rows(
    values: NDArray[np.float64], starts: NDArray[np.int64], chosen: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The signals of the chosen strands, one after another, and where each starts."""
    counts = np.diff(starts)[chosen]
    new = offsets_of(counts)
    rows = np.arange(new[-1]) - np.repeat(new[:-1] - starts[chosen], counts)
    return values[rows], new
