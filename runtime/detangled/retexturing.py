"""Give a groom another texture on its own style guides: the pipeline from end to end.

Paper section "Texture Editing": guides from the input groom, one new strand a guide, its length guided and then set
exactly by scaling v, mapped from canonical space onto the guide.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.base_texture import Texture
from detangled.diffusion.sampler import DEFAULT_STEPS
from detangled.drawing import ToDraw, draw_strands
from detangled.engines import engine_of
from detangled.errors import TextureError
from detangled.fitting import POINTS_PER_TURN
from detangled.geometry.arc import arc_lengths
from detangled.geometry.inputs import compiled_input
from detangled.groom import Groom, offsets_of
from detangled.grooming.density import check_points
from detangled.grooming.guide_density import guides_for
from detangled.grooming.guides import StyleGuides, resampled_attributes, style_guides
from detangled.grooming.interpenetration import OnPenetration
from detangled.grooming.keeping_out import Keeper, Penetration
from detangled.grooming.lengths import Length, Seats, strands_on_guides
from detangled.grooming.placing import resample, unbend_roots
from detangled.head import Head
from detangled.usable import check_usable

CHUNK = 512  # strands made at once: the memory that a groom needs beside its own points
# A strand of fewer turns has no axis to find: it is made this long, and cut.
FEWEST_TURNS = 8.0
MOST_TURNS = 10_000  # of a strand: 20 m of the tightest curls have about half as many, a wrong unit gives more
CUT_MARGIN = 1.1
# An axis is known least well at a strand's ends. Hair shorter than a texture's examples is as their middles are: it
# loses so much at its root. Longer hair has ends as theirs are read.
DROPPED_TURNS = 1.5
LENGTH_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Options:
    """How to retexture.

    max_points: most points a strand may have, None for as many as the texture needs. head: what the groom grows on
    (``grooming.head_fit.fitted_to`` says whether they fit), None where nothing is known of it. on_penetration: what to
    do with hair that is in it. density: factor of the number of style guides, None for as many as the texture's radius
    needs.
    """

    length: Length = Length.GUIDE
    seed: int = 0
    steps: int = DEFAULT_STEPS
    max_points: int | None = None
    head: Head | None = None
    on_penetration: OnPenetration = OnPenetration.ROTATE
    density: float | None = 1.0


@dataclass(frozen=True)
class Result:
    """The new groom and what there is to say about it.

    strands: how many of its strands were retextured. passed_through: its strands (B,) that could not be, and are
    unchanged; where none was added or taken away, these are their numbers in the old groom too.
    lost: attributes that could not be carried over, one sentence each. warnings: other sentences. notes: what was done
    beside, one sentence each.
    penetration: hair in the head before and after; None where no head was given.
    """

    groom: Groom
    strands: int
    passed_through: NDArray[np.int64]
    lost: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    penetration: Penetration | None = None
    notes: list[str] = field(default_factory=list)


def retexture(
    groom: Groom,
    texture: Texture,
    options: Options | None = None,
    progress: Callable[[int], object] | None = None,
) -> Result:
    """Make one new strand of the texture on each style guide of a groom.

    Strand count, order, roots and attributes stay, but where the density is to change and for strands that are deleted
    since they enter the head; new strands come after the others. Strands without two distinct finite points pass
    through as they are. The same seed gives the same strands, whatever the number of threads. progress: told how many
    strands were finished. Raises ReadError where no strand can be used, DetangledError where the density is none or
    makes too many strands or points, TextureError where a strand would have more than ten thousand turns.
    """
    options = options or Options()
    check_usable(groom)
    guides = style_guides(groom)
    goals = _goals(guides, options.length)
    total = points_to_make(texture, goals, options.length, guides.groom.point_counts, options.max_points)
    keeper = None if options.head is None else Keeper(options.head, groom, texture, options.on_penetration)
    notes: list[str] = []
    lost_here: list[str] = []
    warned: list[str] = []
    if options.density != 1.0:
        dense, said = guides_for(
            groom, guides, texture.radius, options.density, options.head, keeper, options.seed, total
        )
        groom, guides = dense.groom, dense.guides
        notes, lost_here, warned = [said], list(dense.lost), list(dense.notes)
    else:
        check_points(len(guides.kept), total)
        guides = guides if keeper is None else keeper.turned(guides)
    goals = _goals(guides, options.length)
    wanted = strands_to_make(texture, goals, options.length, guides.kept)
    seats = Seats(
        guides=replace(guides.groom, points=guides.points, attributes={}),
        roots=unbend_roots(
            compiled_input(guides.groom.points[guides.groom.offsets[:-1]], np.float64),
            compiled_input(guides.points, np.float64),
            compiled_input(guides.groom.offsets, np.int64),
        ),
        turns=turns_about_axis(options.seed, guides.kept),
        goals=goals,
        cut=wanted.cut,
        straight=wanted.straight,
        dropped=wanted.dropped,
        axis=texture.axis,
        shape=texture.shape,
        room=None if keeper is None else keeper.room,
    )
    passed_through = np.setdiff1d(np.arange(groom.strand_count), guides.kept)
    strands: list[NDArray[np.float64]] = [np.empty((0, 3))] * groom.strand_count
    for index in passed_through:
        strands[index] = groom.strand(index)
    reached = np.ones(len(guides.kept))
    per_turn = np.full(len(guides.kept), float(POINTS_PER_TURN))
    # Strands on grids of one size are made together.
    engine = engine_of(texture)
    order = np.argsort(texture.grid_cells(wanted.arcs), kind="stable")
    for first in range(0, len(order), CHUNK):
        members = np.sort(order[first : first + CHUNK])
        drawn = draw_strands(texture, wanted.select(members), options.seed, options.steps, progress, engine)
        here = replace(seats.select(members), sizes=drawn.sizes, dropped=drawn.dropped)
        signals, canonical = (drawn.values, drawn.starts), (drawn.points, drawn.offsets)
        made = strands_on_guides(*signals, canonical, here, options.length)
        reached[members] = made.reached
        needed = _points_needed(texture, made.points, made.offsets)
        counts = np.maximum(needed, guides.groom.point_counts[members])
        if options.max_points is not None:
            counts = np.minimum(counts, max(options.max_points, 2))
        per_turn[members] = POINTS_PER_TURN * np.minimum(counts / needed, 1.0)
        offsets = offsets_of(counts)
        points = resample(made.points, made.offsets, offsets)
        points[offsets[:-1]] = guides.groom.points[guides.groom.offsets[members]]
        if options.length is Length.STRAND:
            # Fewer points follow less of a kink: the percent of arc that this takes is given back.
            scale = goals[members] * made.reached / arc_lengths(points, offsets)
            root = points[offsets[:-1]].repeat(counts, axis=0)
            points = root + (points - root) * scale.repeat(counts)[:, None]
        for k, name in enumerate(guides.kept[members]):
            strands[name] = points[offsets[k] : offsets[k + 1]]

    offsets = offsets_of([len(s) for s in strands])
    attributes, lost = resampled_attributes(groom, offsets)
    made_groom = replace(groom, points=np.concatenate(strands), offsets=offsets, attributes=attributes)
    stay, penetration = (np.ones(groom.strand_count, dtype=np.bool_), None)
    if keeper is not None:
        stay, penetration = keeper.finished(made_groom)
        made_groom = made_groom if stay.all() else made_groom.select(stay)
    return Result(
        groom=made_groom,
        strands=int(np.count_nonzero(stay[guides.kept])),
        passed_through=np.searchsorted(np.flatnonzero(stay), passed_through[stay[passed_through]]),
        lost=[*lost_here, *lost],
        warnings=[*warned, *_warnings(per_turn, reached, options)],
        penetration=penetration,
        notes=notes,
    )


def strands_to_make(texture: Texture, goals: NDArray[np.float64], length: Length, names: NDArray[np.int64]) -> ToDraw:
    """What to draw for strands of these lengths (S,) [cm] and names (S,)."""
    kept = drawn_arcs(texture, goals, length)
    none, every = np.zeros(len(kept), dtype=np.bool_), np.ones(len(kept), dtype=np.bool_)
    nothing = np.zeros(len(kept))
    ends = np.full(len(kept), DROPPED_TURNS * texture.turn)
    if texture.waves:
        # Ends without an axis, of every strand.
        return ToDraw(CUT_MARGIN * kept + 2.0 * ends, kept, names, every, none, ends, nothing)
    least = FEWEST_TURNS * texture.turn
    if texture.median_arc < least:
        short, ends = none, nothing
    else:
        short = kept < least
        ends[kept >= texture.median_arc] = 0.0
    arcs = np.where(short, CUT_MARGIN * least, kept) + ends
    piece = arcs < texture.shortest_drawn
    arcs = np.maximum(arcs, texture.shortest_drawn)
    spare = np.where(piece, np.maximum(arcs - CUT_MARGIN * kept - 2.0 * ends, 0.0), 0.0)
    return ToDraw(arcs, kept, names, short | piece, short & ~piece & texture.stiff, ends, spare)


def drawn_arcs(texture: Texture, goals: NDArray[np.float64], length: Length) -> NDArray[np.float64]:
    """Arc lengths (S,) [cm] that strands of these lengths have as they are drawn: before they are given a shape.

    Raises TextureError where one would have more than MOST_TURNS turns.
    """
    by_guide = length is Length.GUIDE
    arcs = goals * texture.arc_per_axis if by_guide else goals.copy()
    if texture.shape is not None:
        arcs *= texture.shape.drawn_depth if by_guide else texture.shape.drawn_arc
    turns = float(arcs.max(initial=0.0)) / texture.turn
    if turns > MOST_TURNS:
        raise TextureError(
            f"hair of {goals.max():.3g} cm would have {turns:,.0f} turns of this texture, {texture.turn:.2g} cm each, "
            f"and at most {MOST_TURNS:,} are made: say the unit of the texture's strands (--target-unit, or --unit of "
            "fit), or ask for shorter hair"
        )
    return arcs


def points_to_make(
    texture: Texture,
    goals: NDArray[np.float64],
    length: Length,
    fewest: ArrayLike = 2,
    most: int | None = None,
) -> float:
    """About how many points all strands of these lengths (S,) [cm] will have, each from ``fewest`` to ``most``."""
    needed = POINTS_PER_TURN * drawn_arcs(texture, goals, length) / texture.finest_turn + 1.0
    return float(np.minimum(np.maximum(needed, fewest), most or np.inf).sum())


def _goals(guides: StyleGuides, length: Length) -> NDArray[np.float64]:
    """Lengths (S,) [cm] that new strands on these guides are to have."""
    return guides.lengths if length is Length.GUIDE else arc_lengths(guides.groom.points, guides.groom.offsets)


def _warnings(per_turn: NDArray[np.float64], reached: NDArray[np.float64], options: Options) -> list[str]:
    """What to say of strands with too few points a turn (S,), or that fell short of their lengths (S,)."""
    said = []
    scarce = np.count_nonzero(per_turn < POINTS_PER_TURN)
    if scarce:
        said.append(
            f"{scarce} strands need more than {options.max_points} points: they got as few as {per_turn.min():.1f} a "
            f"turn where {POINTS_PER_TURN} keep the texture; raise --max-points"
            f"{'' if options.length is Length.STRAND else ', or make less hair of it with --length strand'}"
        )
    too_short = np.count_nonzero(reached < 1.0 - LENGTH_TOLERANCE)
    if too_short:
        said.append(f"{too_short} strands are shorter than they should be, by up to {100 * (1 - reached.min()):.1f} %")
    return said


def turns_about_axis(seed: int, names: NDArray[np.int64]) -> NDArray[np.float64]:
    """By how much strands (S,) are turned about their axes [rad].

    From streams of their own, beside those that signals are drawn from.
    """
    return np.array([np.random.default_rng([seed, int(name), 1]).uniform(-np.pi, np.pi) for name in names])


def _points_needed(texture: Texture, points: NDArray[np.float64], offsets: NDArray[np.int64]) -> NDArray[np.int64]:
    """Points (S,) that give every turn of the texture enough."""
    return np.ceil(POINTS_PER_TURN * arc_lengths(points, offsets) / texture.finest_turn).astype(np.int64) + 1
