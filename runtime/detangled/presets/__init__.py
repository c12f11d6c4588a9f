"""Grooms as an engine wants them: its unit and axes, its limits, its attributes.

Limits and attributes are those of the engines' own documentation (Unreal: "Alembic for Grooms Specification"; Unity:
the package com.unity.demoteam.hair).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from detangled.axes import turned, turned_vectors
from detangled.errors import DetangledError
from detangled.formats import objects
from detangled.formats.frames import Frames
from detangled.groom import Groom
from detangled.grooming.fewer_points import FewerPoints, fewer_points, points_at
from detangled.grooming.guides import attributes_at
from detangled.presets import unreal
from detangled.presets.sizes import mixed_units
from detangled.units import cm_per_unit, unit_name
from detangled.usable import WHY_UNUSABLE, usable_strands

# With fewer points a turn than this a curl becomes a zigzag: an octagon still misses its circle by 8 % of the radius.
LEAST_A_TURN = 8.0
STRAIGHT_TURNS = 2.0  # a strand of fewer turns has no curl to lose


@dataclass(frozen=True)
class Engine:
    """What an engine takes.

    suffixes: of the files that it imports. up: its axis, None where the file says its own. most_points: of a strand.
    most_strands, most_group_points: of a group of strands, or of the whole where ``groups`` is false.
    settings: what to set in its import window.
    """

    title: str
    suffixes: tuple[str, ...]
    unit: str
    up: str | None
    most_points: int | None = None
    most_strands: int | None = None
    most_group_points: int | None = None
    groups: bool = False
    settings: str = ""


UNREAL, UNITY, BLENDER = "unreal", "unity", "blender"
ENGINES = {
    UNREAL: Engine(
        "Unreal",
        (".abc",),
        "cm",
        "z",
        most_points=255,
        most_strands=4_194_303,
        most_group_points=2**24 - 1,
        groups=True,
        settings="import into Unreal with rotation 0, 0, 0 and scale 1, -1, 1, since its axes are left-handed",
    ),
    UNITY: Engine(
        "Unity",
        (".abc",),
        "m",
        "y",
        most_points=128,
        most_strands=64_000,
        settings="import into Unity with a scale factor of 1",
    ),
    BLENDER: Engine("Blender", (".abc", ".usd", ".usda", ".usdc"), "m", "y"),
}


@dataclass(frozen=True)
class Prepared:
    """A groom made ready for an engine, and how, so that its later frames can be made ready alike.

    sentences: what was changed, and what an artist should know. kept: (S,) strands of the old groom that are left.
    fewer: which of their points. old_up: the axis that pointed up.
    """

    groom: Groom
    sentences: tuple[str, ...]
    old_offsets: NDArray[np.int64]
    kept: NDArray[np.int64]
    fewer: FewerPoints | None
    old_up: str

    def points(self, old: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (Q, 3) [cm] of the groom made ready, for old points (P, 3) of any frame."""
        counts = np.diff(self.old_offsets)[self.kept]
        ends = np.cumsum(counts)
        rows = np.arange(ends[-1]) - np.repeat(ends - counts - self.old_offsets[self.kept], counts)
        points = old[rows] if len(rows) < len(old) else old
        if self.fewer is not None:
            points = points_at(points, np.concatenate([[0], ends]), self.fewer)
        return turned_vectors(points, self.old_up, self.groom.up)


def preset(groom: Groom, name: str, root_uv: NDArray[np.float64] | None = None, suffix: str = ".abc") -> Prepared:
    """Make a groom ready for an engine by its name in ``ENGINES``.

    root_uv: (S, 2), texture coordinates of all roots on their head, for a groom that has none. suffix: of the file
    that it will be written to. Raises DetangledError where an engine cannot take it, whatever is changed.
    """
    if name not in ENGINES:
        raise DetangledError(f"unknown preset {name!r}: use one of {', '.join(ENGINES)}")
    engine = ENGINES[name]
    said = [*_wrong_suffix(engine, suffix), *mixed_units(groom)]
    old_offsets = groom.offsets
    kept = np.flatnonzero(usable_strands(groom))
    dropped = groom.strand_count - len(kept)
    if len(kept) == 0:
        raise DetangledError(f"{engine.title} can use none of the {groom.strand_count} strands: {WHY_UNUSABLE}")
    if dropped:
        said.append(f"{dropped} strands without two distinct finite points were dropped: {engine.title} takes none")
        groom = groom.select(kept)
        root_uv = None if root_uv is None else root_uv[kept]
    groom, fewer, more = _capped(groom, engine)
    said += more
    old_up, up = groom.up, engine.up
    if up is not None and suffix == ".abc" and groom.up != up:
        said.append(f"turned so that {up} is up instead of {groom.up}")
        groom = turned(groom, up)
    if groom.unit_cm != cm_per_unit(engine.unit):
        said.append(f"written in {engine.unit} instead of {unit_name(groom.unit_cm)}")
        groom = replace(groom, unit_cm=cm_per_unit(engine.unit), unit_source="given")
    if engine.groups:
        groom, more = unreal.with_schema(groom, root_uv)
        said += more
        groom, more = _split(groom, engine)
        said += more
    elif engine.most_strands is not None and groom.strand_count > engine.most_strands:
        raise DetangledError(
            f"{groom.strand_count:,} strands, {engine.title} takes {engine.most_strands:,}: make fewer, or write them "
            "in several files"
        )
    if name == BLENDER and suffix == ".abc":
        groom, more = _widths_alone(groom)
        said += more
    if engine.settings:
        said.append(engine.settings)
    return Prepared(groom, tuple(said), old_offsets, kept, fewer, old_up)


def prepared_frames(
    frames: Frames, name: str, suffix: str = ".abc", root_uv: NDArray[np.float64] | None = None
) -> tuple[Frames, tuple[str, ...]]:
    """Make a groom that moves ready for an engine, all frames alike, and say what was changed: see ``preset``."""
    ready = preset(frames.groom, name, root_uv, suffix)
    return frames.mapped(ready.groom, lambda _, points: ready.points(points)), ready.sentences


def _wrong_suffix(engine: Engine, suffix: str) -> list[str]:
    if suffix in engine.suffixes:
        return []
    return [f"{engine.title} imports {', '.join(engine.suffixes)}, not {suffix or 'files without a suffix'}"]


def _capped(groom: Groom, engine: Engine) -> tuple[Groom, FewerPoints | None, list[str]]:
    """The groom with at most the engine's number of points a strand, where from, and what to say of it."""
    most = engine.most_points
    if most is None or groom.point_counts.max() <= most:
        return groom, None, []
    fewer = fewer_points(groom.points, groom.offsets, most)
    over = groom.point_counts > most
    said = [
        f"{np.count_nonzero(over)} strands of more than {most} points, up to {groom.point_counts.max():,}, were left "
        f"that many, placed where they bend: off their old shape by {fewer.deviation.max():.2g} cm at most"
    ]
    curly = over & (fewer.turns > STRAIGHT_TURNS)
    per_turn = most / np.maximum(fewer.turns, STRAIGHT_TURNS)
    scarce = curly & (per_turn < LEAST_A_TURN)
    if scarce.any():
        said.append(
            f"{np.count_nonzero(scarce)} strands have as few as {per_turn[scarce].min():.1f} points a turn left, where "
            f"{LEAST_A_TURN:g} keep a curl round: {engine.title} takes {most} a strand, so give them less hair "
            "(retexture with --length strand), wider turns, or cut them shorter"
        )
    capped = replace(
        groom,
        points=points_at(groom.points, groom.offsets, fewer),
        offsets=fewer.offsets,
        attributes=attributes_at(groom, fewer.offsets, fewer.at),
    )
    return capped, fewer, said


def _widths_alone(groom: Groom) -> tuple[Groom, list[str]]:
    """The groom with no attribute that Blender's Alembic import leaves behind (seen in 4.5): all but widths."""
    kept = {name: a for name, a in groom.attributes.items() if name in ("width", objects.ATTRIBUTE)}
    left = groom.attributes.keys() - kept.keys()
    if not left:
        return groom, []
    said = f"attributes left out, since Blender drops them from an .abc: {', '.join(sorted(left))}; .usd keeps them"
    return replace(groom, attributes=kept), [said]


def _split(groom: Groom, engine: Engine) -> tuple[Groom, list[str]]:
    """The groom with groups beyond the engine's limits split into several."""
    if engine.most_strands is None or engine.most_group_points is None:
        return groom, []
    return unreal.split_groups(groom, engine.most_strands, engine.most_group_points)
