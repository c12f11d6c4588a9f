"""Give a groom another texture on its own style guides: the pipeline from end to end.

Paper section "Texture Editing": guides from the input groom, one new strand a guide, its length guided and then set
exactly by scaling v, mapped from canonical space onto the guide.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from detangled.diffusion.sampler import DEFAULT_STEPS
from detangled.errors import ReadError
from detangled.fitted import FittedTexture
from detangled.geometry.arc import arc_lengths
from detangled.geometry.centerline import centerlines
from detangled.geometry.signal import curve_counts, curves
from detangled.groom import Groom
from detangled.grooming.guides import StyleGuides, resampled_attributes, style_guides, to_canonical
from detangled.grooming.placing import cut, place, resample
from detangled.synthesis import grid_cells, synthesise

POINTS_PER_TURN = 12
CHUNK = 512  # strands made at once: the memory that a groom needs beside its own points
# A strand of fewer turns has no axis to find: it is made this long, and cut.
FEWEST_TURNS = 6.0
CUT_MARGIN = 1.25
# v is scaled until a strand is as long as it should be or this share longer; what is over is cut off its tip. The
# axial length of a scaled strand scatters by a percent or two, so nothing finer would be reached by scaling alone.
# After some rounds any strand that is long enough will do, and the others are scaled further and further beyond.
MOST_CUT = 0.04
STRICT_ROUNDS = 3
MOST_ROUNDS = 12
LENGTH_TOLERANCE = 1e-3


class Length(str, Enum):
    """What a new strand keeps: its guide's length along the axis, or the old strand's arc length."""

    GUIDE = "guide"
    STRAND = "strand"


@dataclass(frozen=True)
class Options:
    """How to retexture. max_points: most points a strand may have, None for as many as the texture needs."""

    length: Length = Length.GUIDE
    seed: int = 0
    steps: int = DEFAULT_STEPS
    max_points: int | None = None


@dataclass(frozen=True)
class Result:
    """The new groom and what there is to say about it.

    strands: how many were retextured. passed_through: indices (B,) of those that could not be, and are unchanged.
    lost: attributes that could not be carried over, one sentence each. warnings: other sentences.
    length_rounds: rounds of scaling v that the lengths took, the most of any strand.
    shortest: least length of a new strand, as a share of what it should be.
    """

    groom: Groom
    strands: int
    passed_through: NDArray[np.int64]
    lost: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    length_rounds: int = 0
    shortest: float = 1.0


def retexture(
    groom: Groom,
    texture: FittedTexture,
    options: Options | None = None,
    progress: Callable[[int], object] | None = None,
) -> Result:
    """Make one new strand of the texture on each style guide of a groom.

    Strand count, order, roots and attributes stay; strands without two distinct finite points pass through as they
    are. The same seed gives the same strands, whatever the number of threads. progress: told how many strands were
    finished. Raises ReadError where no strand can be used.
    """
    options = options or Options()
    guides = style_guides(groom)
    if len(guides.kept) == 0:
        raise ReadError(
            f"none of the {groom.strand_count} strands can be used: each has fewer than two distinct points or a "
            "coordinate that is not finite"
        )
    goals = guides.lengths
    if options.length is Length.STRAND:
        goals = arc_lengths(guides.groom.points, guides.groom.offsets)
    arcs, short = _arcs_to_make(texture, goals, options.length)
    roots = guides.canonical()[guides.groom.offsets[:-1]]

    strands: list[NDArray[np.float64]] = [np.empty((0, 3))] * groom.strand_count
    for index in np.setdiff1d(np.arange(groom.strand_count), guides.kept):
        strands[index] = groom.strand(index)
    rounds = 0
    shortest = 1.0
    scarce = 0
    fewest_per_turn = float(POINTS_PER_TURN)
    # Strands on grids of one size are made together.
    order = np.argsort(grid_cells(texture, arcs), kind="stable")
    for first in range(0, len(order), CHUNK):
        members = np.sort(order[first : first + CHUNK])
        made = _make(texture, guides, members, arcs, goals, short, roots, options, progress)
        rounds = max(rounds, made.rounds)
        shortest = min(shortest, made.shortest)
        wanted = _points_wanted(texture, made.points, made.offsets, guides.groom.point_counts[members])
        counts = wanted if options.max_points is None else np.minimum(wanted, max(options.max_points, 2))
        if np.any(counts < wanted):
            scarce += int(np.count_nonzero(counts < wanted))
            fewest_per_turn = min(fewest_per_turn, float((POINTS_PER_TURN * counts / wanted).min()))
        new_offsets = np.concatenate([[0], np.cumsum(counts)])
        new_points = resample(made.points, made.offsets, new_offsets)
        new_points[new_offsets[:-1]] = guides.groom.points[guides.groom.offsets[members]]
        for k, member in enumerate(members):
            strands[guides.kept[member]] = new_points[new_offsets[k] : new_offsets[k + 1]]

    offsets = _offsets_of(strands)
    attributes, lost = resampled_attributes(groom, offsets)
    warnings = []
    if scarce:
        warnings.append(
            f"{scarce} strands need more than {options.max_points} points: they got as few as {fewest_per_turn:.1f} a "
            f"turn where {POINTS_PER_TURN} keep the texture; raise --max-points, or keep arcs with --length strand"
        )
    if shortest < 1.0 - LENGTH_TOLERANCE:
        warnings.append(f"a strand came out at {100.0 * shortest:.1f} % of its length")
    return Result(
        groom=replace(groom, points=np.concatenate(strands), offsets=offsets, attributes=attributes),
        strands=len(guides.kept),
        passed_through=np.setdiff1d(np.arange(groom.strand_count), guides.kept),
        lost=lost,
        warnings=warnings,
        length_rounds=rounds,
        shortest=shortest,
    )


def _arcs_to_make(
    texture: FittedTexture, goals: NDArray[np.float64], length: Length
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Arc lengths (S,) [cm] to ask the sampler for, and which strands will be cut to length instead of scaled."""
    arcs = goals * texture.arc_per_axis if length is Length.GUIDE else goals.copy()
    least = FEWEST_TURNS * texture.turn
    short = (arcs < least) & (texture.median_arc >= least)
    arcs[short] = CUT_MARGIN * least
    return arcs, short


class _Made(NamedTuple):
    """World-space strands (P, 3), finely sampled, their offsets, the rounds of scaling, and the least share reached."""

    points: NDArray[np.float64]
    offsets: NDArray[np.int64]
    rounds: int
    shortest: float


def _make(
    texture: FittedTexture,
    guides: StyleGuides,
    members: NDArray[np.int64],
    all_arcs: NDArray[np.float64],
    all_goals: NDArray[np.float64],
    all_short: NDArray[np.bool_],
    all_roots: NDArray[np.float64],
    options: Options,
    progress: Callable[[int], object] | None,
) -> _Made:
    """New strands for these guides."""
    names = guides.kept[members]
    goals, short = all_goals[members], all_short[members]
    values, starts = synthesise(texture, all_arcs[members], names, options.seed, options.steps, progress)
    guide_groom = replace(guides.groom, points=guides.points, attributes={}).select(members)
    roots = all_roots[members]
    turns = np.array([np.random.default_rng([options.seed, int(n), 1]).uniform(-np.pi, np.pi) for n in names])

    done: list[NDArray[np.float64]] = [np.empty((0, 3))] * len(members)
    reached = np.zeros(len(members))
    todo = np.arange(len(members))
    rounds = 0
    while len(todo):
        rounds += 1
        signal, signal_starts = _rows(values, starts, todo)
        offsets = np.concatenate([[0], np.cumsum(curve_counts(signal, signal_starts))])
        points = curves(signal, signal_starts, offsets)
        axes, _ = centerlines(points, offsets)
        canonical = to_canonical(points, axes, offsets)
        goal = goals[todo]
        if options.length is Length.GUIDE:
            down = canonical[offsets[:-1], 2].repeat(np.diff(offsets)) - canonical[:, 2]
            length = np.maximum.reduceat(down, offsets[:-1])
            canonical, offsets = cut(canonical, offsets, down, goal)
        own_guides = guide_groom.select(todo)
        angles = _angles(canonical[offsets[:-1]], roots[todo], turns[todo])
        world = place(canonical, offsets, own_guides.points, own_guides.offsets, roots[todo], angles)
        if options.length is Length.STRAND:
            along = _arc_positions(world, offsets)
            length = along[offsets[1:] - 1]
            world, offsets = cut(world, offsets, along, goal)
        longest = np.where(short[todo] | (rounds > STRICT_ROUNDS), np.inf, (1.0 + MOST_CUT) * goal)
        ready = (length >= goal) & (length <= longest) | (rounds == MOST_ROUNDS)
        scale = np.clip((1.0 + 0.5 * MOST_CUT * rounds) * goal / np.maximum(length, 1e-12), 0.25, 4.0)
        reached[todo] = np.minimum(length / goal, 1.0)
        for k, index in enumerate(todo):
            if ready[k]:
                done[index] = world[offsets[k] : offsets[k + 1]]
            else:
                values[starts[index] : starts[index + 1], 2] *= scale[k]
        todo = todo[~ready]
    return _Made(np.concatenate(done), _offsets_of(done), rounds, float(reached.min()))


def _arc_positions(world: NDArray[np.float64], offsets: NDArray[np.int64]) -> NDArray[np.float64]:
    """Arc length (P,) [cm] from each strand's root to its points, of the smooth curve through them."""
    steps = np.zeros(len(world))
    steps[1:] = np.linalg.norm(np.diff(world, axis=0), axis=1)
    steps[offsets[:-1]] = 0.0
    total = np.cumsum(steps)
    counts = np.diff(offsets)
    chord = total - total[offsets[:-1]].repeat(counts)
    return chord * (arc_lengths(world, offsets) / chord[offsets[1:] - 1]).repeat(counts)


def _offsets_of(strands: list[NDArray[np.float64]]) -> NDArray[np.int64]:
    """Where each of some strands starts when they stand one after another, (S + 1,)."""
    return np.concatenate([[0], np.cumsum([len(s) for s in strands])]).astype(np.int64)


def _angles(starts: NDArray[np.float64], roots: NDArray[np.float64], turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles (S,) to turn strands by: the new root over the old one where that lies off its guide, else at random."""
    new = np.arctan2(starts[:, 1], starts[:, 0])
    old = np.arctan2(roots[:, 1], roots[:, 0])
    off = np.hypot(roots[:, 0], roots[:, 1]) > 0.1 * np.hypot(starts[:, 0], starts[:, 1])
    return np.where(off, old - new, turns)


def _points_wanted(
    texture: FittedTexture, points: NDArray[np.float64], offsets: NDArray[np.int64], old: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Points (S,) that give every turn of the texture enough, and a strand no fewer than it had."""
    arcs = arc_lengths(points, offsets)
    return np.maximum(np.ceil(POINTS_PER_TURN * arcs / texture.turn).astype(np.int64) + 1, old)


def _rows(
    values: NDArray[np.float64], starts: NDArray[np.int64], chosen: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The signals of the chosen strands, one after another, and where each starts."""
    counts = np.diff(starts)[chosen]
    new = np.concatenate([[0], np.cumsum(counts)])
    rows = np.arange(new[-1]) - np.repeat(new[:-1] - starts[chosen], counts)
    return values[rows], new
