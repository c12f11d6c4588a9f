"""Render hairs: many hairs of a groom's guide strands, each with a texture of its own that belongs to its wisp.

Paper appendix "Render Hairs Implementation", which leaves this to Houdini's interpolation and clumping. There, as in
Blender, textured strands are averaged, and coils out of step cancel; here style guides are interpolated, and a hair
takes the texture of its wisp's guide strand, in canonical space, onto its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from detangled.errors import DetangledError, ReadError
from detangled.geometry.arc import arc_lengths
from detangled.geometry.winding import winding
from detangled.groom import Attribute, Groom, Scope, offsets_of
from detangled.grooming.density import MOST_STRANDS, STRAIGHT_RADIUS
from detangled.grooming.density_resampling import new_roots
from detangled.grooming.guides import StyleGuides, style_guides
from detangled.grooming.hair_laying import RANDOMS, axes_between, laid
from detangled.grooming.head_fit import check_fit
from detangled.grooming.interpolation import diverging, joined, mixed_attributes
from detangled.grooming.placing import resample
from detangled.grooming.scalp import Scalp, scalp_of
from detangled.grooming.scalp_mesh import places_on
from detangled.grooming.wisps import Wisps, wisps_of
from detangled.head import Head
from detangled.texture import Profile
from detangled.usable import GREATEST_EXTENT, WHY_UNUSABLE

AXIS_POINTS = 64  # of a hair's smooth axis: the style bends slowly
MOST_POINTS = 24_000_000  # of all hairs: about a gigabyte with all that is made of them
FEWEST_PER_TURN = 8.0  # points: fewer show corners
WIDTH_CM = 0.008  # of a hair
# A wisp is so wide beside the place that its guide has, or beside its coil: a wider one would fill the coil's middle.
WISP_OF_PLACE = 0.5
WISP_OF_COIL = 0.5
ALONE_CM = 0.3  # where no neighbour says how far hairs of one guide may grow from it
CHUNK = 4096  # hairs between two words on progress
GUIDE, CLOSEST, WEIGHTS, ID = "groom_guide", "groom_closest_guides", "groom_guide_weights", "groom_id"


@dataclass(frozen=True)
class HairOptions:
    """How to make render hairs.

    count: hairs. wisp_radius: [cm] from a guide within which its hairs gather, None for half of what it has room for.
    clump: from 0, wisps as wide as that, to 1, all of a wisp's hairs on its guide; times clump_profile at each place
    from root to tip. sub_clumps: tufts in a wisp, and in each tuft again; 0 for none. flyaways: share of the hairs that
    leave their wisps. variation: from 0, a wisp's hairs alike, to 1. points: of each hair, None for as many as its
    guide strand has. width: [cm] of a hair. with_guides: whether the guide strands come first in the result.
    """

    count: int = 100_000
    wisp_radius: float | None = None
    clump: float = 0.5
    clump_profile: Profile = field(default_factory=lambda: Profile((0.0, 1.0)))
    sub_clumps: int = 4
    flyaways: float = 0.02
    variation: float = 0.3
    points: int | None = None
    width: float = WIDTH_CM
    seed: int = 0
    with_guides: bool = False

    def __post_init__(self) -> None:
        shares = [("clump", self.clump), ("flyaways", self.flyaways), ("variation", self.variation)]
        for name, value in [*shares, *(("clump profile", value) for value in self.clump_profile.values)]:
            if not 0.0 <= value <= 1.0:
                raise DetangledError(f"{name} {value:g} must be from 0 to 1")
        if not 1 <= self.count <= MOST_STRANDS:
            raise DetangledError(f"{self.count} hairs cannot be made: ask for 1 to {MOST_STRANDS:,}")
        if self.points is not None and self.points < 2:
            raise DetangledError(f"a hair of {self.points} points is none: give 2 or more")
        if self.points is not None and self.points * self.count > MOST_POINTS:
            raise DetangledError(
                f"{self.count} hairs of {self.points} points are {self.points * self.count:.3g} points, and at most "
                f"{MOST_POINTS:,} are made: give fewer points, {MOST_POINTS // self.count} here, or fewer hairs"
            )
        for name, size in (("wisp radius", self.wisp_radius), ("width", self.width)):
            if size is not None and not 0.0 < size < GREATEST_EXTENT:
                raise DetangledError(f"{name} {size:g} cm must be more than zero, and less than 20 m")
        if self.sub_clumps < 0:
            raise DetangledError(f"{self.sub_clumps} sub-clumps are none: give 0 or more")


@dataclass(frozen=True)
class RenderHairs:
    """Hairs and what there is to say about them.

    groom: the guide strands first where asked for, then the hairs. wisp_radius: [cm], as used. away: (N,) [cm], how
    far each hair's axis is from its guide's, at most, from where it has joined its wisp. wisp: (N,), the strand of the
    input that leads each hair. notes, lost: one sentence each.
    """

    groom: Groom
    wisp_radius: float
    away: NDArray[np.float64]
    wisp: NDArray[np.int64]
    notes: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Places:
    """Where hairs grow: roots (N, 3) [cm], and the guides (N, 3) with weights (N, 3) that each is between."""

    roots: NDArray[np.float64]
    parents: NDArray[np.int64]
    weights: NDArray[np.float64]

    @property
    def nearest(self) -> NDArray[np.int64]:
        return self.parents[np.arange(len(self.parents)), self.weights.argmax(axis=1)]


def render_hairs(
    groom: Groom,
    options: HairOptions | None = None,
    head: Head | None = None,
    progress: Callable[[int], object] | None = None,
) -> RenderHairs:
    """Make render hairs of a groom of guide strands, textured or not.

    Of a groom with strands flagged by ``groom_guide`` those alone are guides. head: in the groom's frame [cm]; hairs
    then grow on it. The same seed gives the same hairs, whatever the number of threads. progress: told how many hairs
    were finished. Raises ReadError where no strand can be used, DetangledError for fewer hairs than guides and a head
    away from the roots.
    """
    options = options or HairOptions()
    groom, flagged = _guide_strands(groom)
    guides = style_guides(groom)
    usable = len(guides.kept)
    if usable == 0:
        raise ReadError(f"none of the {groom.strand_count} strands can be a guide: {WHY_UNUSABLE}")
    if options.count < usable:
        raise DetangledError(
            f"{options.count} hairs of {usable} guide strands leave wisps without any: ask for {usable} or more"
        )
    strand_roots = guides.groom.points[guides.groom.offsets[:-1]]
    notes = [flagged] if flagged else []
    if usable < groom.strand_count:
        notes.append(f"{groom.strand_count - usable} strands cannot be guides, and have no hairs")
    if head is not None:
        check_fit(head, guides.groom)
    scalp = scalp_of(strand_roots)
    places = _places(guides, scalp, options)
    if head is not None:
        places = replace(places, roots=places_on(places.roots, head).positions)
    wisps = wisps_of(
        places.nearest,
        places.roots,
        strand_roots,
        options.sub_clumps,
        options.flyaways,
        np.random.default_rng([options.seed, 1]),
    )
    canonical = guides.canonical()
    coil, wavelength = winding(canonical, guides.groom.offsets)
    radius = options.wisp_radius or _wisp_radius(scalp, coil)
    counts = _point_counts(guides.groom.point_counts, wisps.guide, options)
    turns = np.where((coil >= STRAIGHT_RADIUS) & (wavelength > 0.0), guides.lengths / wavelength, 0.0)
    notes += _scarce(counts / np.maximum(turns, 1e-9))
    textures = resample(canonical, guides.groom.offsets, offsets_of(counts))
    points, away = _laid(guides, scalp, places, wisps, textures, counts, radius, options, progress)
    hairs = counts[wisps.guide]
    attributes, lost = _attributes(groom, guides, places, hairs, options)
    source = replace(groom, attributes=_guide_attributes(groom, options))
    if not options.with_guides:
        source = source.select(np.zeros(0, dtype=np.int64))
    whole = joined(source, points, hairs, attributes)
    return RenderHairs(whole, radius, away, guides.kept[wisps.guide], tuple(notes), tuple(lost))


def _guide_strands(groom: Groom) -> tuple[Groom, str]:
    """The strands that are flagged as guides, where only some are, and a sentence on that."""
    flag = groom.attributes.get(GUIDE)
    if flag is None or flag.scope is not Scope.STRAND or flag.values.ndim != 1:
        return groom, ""
    chosen = flag.values.astype(np.float64) > 0.5
    if chosen.all() or not chosen.any():
        return groom, ""
    return groom.select(chosen), f"{chosen.sum()} strands flagged as guides are used, the others are left out"


def _places(guides: StyleGuides, scalp: Scalp, options: HairOptions) -> _Places:
    """Roots between guides; around them where they span no scalp. Where guides part only near each of them."""
    usable = len(guides.kept)
    if len(scalp.triangles) == 0:
        return _around(guides, scalp, options)
    every = np.ones(len(scalp.triangles), dtype=np.bool_)
    factor = max(options.count / usable, 1.0)
    parts = diverging(guides.as_groom(), scalp)
    roots = new_roots(scalp, every, options.count, factor, options.seed, corners=parts)
    weights = roots.weights
    alone = np.eye(3)[weights.argmax(axis=1)]
    weights = np.where(parts[roots.triangles][:, None], alone, weights)
    return _Places(roots.positions, scalp.triangles[roots.triangles], weights)


def _around(guides: StyleGuides, scalp: Scalp, options: HairOptions) -> _Places:
    """Roots in discs around guides, across the way that each starts."""
    usable = len(guides.kept)
    rng = np.random.default_rng([options.seed, 0])
    guide = np.arange(options.count) % usable
    first = guides.points[guides.groom.offsets[:-1]]
    ahead = guides.points[guides.groom.offsets[1:] - 1] - first
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-300)
    side = np.cross(ahead, np.eye(3)[np.abs(ahead).argmin(axis=1)])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(ahead, side)
    reach = np.where(scalp.nearest > 0.0, np.minimum(0.5 * scalp.nearest, ALONE_CM), ALONE_CM)[guide]
    r, angle = np.sqrt(rng.random(options.count)) * reach, rng.uniform(0.0, 2.0 * np.pi, options.count)
    roots = scalp.roots[guide] + (r * np.cos(angle))[:, None] * side[guide] + (r * np.sin(angle))[:, None] * up[guide]
    return _Places(roots, np.repeat(guide[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (options.count, 1)))


def _wisp_radius(scalp: Scalp, coil: NDArray[np.float64]) -> float:
    """Radius [cm] of wisps: half of what a guide has room for, or half of its coil's if that is less."""
    place = float(np.median(scalp.packing_radius()))
    place = WISP_OF_PLACE * place if place > 0.0 else ALONE_CM
    curled = coil[coil >= STRAIGHT_RADIUS]
    if 2 * len(curled) < len(coil):
        return place
    return min(place, WISP_OF_COIL * float(np.median(curled)))


def _point_counts(guides: NDArray[np.int64], wisp: NDArray[np.int64], options: HairOptions) -> NDArray[np.int64]:
    """Points of the hairs of each guide (G,)."""
    if options.points is not None:
        return np.full(len(guides), options.points)
    most = MOST_POINTS // options.count
    return np.clip(guides, 2, max(most, 2))


def _scarce(per_turn: NDArray[np.float64]) -> list[str]:
    """What to say where hairs have few points a turn of their texture (G,)."""
    if per_turn.min() >= FEWEST_PER_TURN:
        return []
    return [
        f"hairs have as few as {per_turn.min():.1f} points a turn of their texture, where {FEWEST_PER_TURN:g} show it "
        "round: raise --points, or lower --count"
    ]


def _laid(
    guides: StyleGuides,
    scalp: Scalp,
    places: _Places,
    wisps: Wisps,
    textures: NDArray[np.float64],
    counts: NDArray[np.int64],
    radius: float,
    options: HairOptions,
    progress: Callable[[int], object] | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points of all hairs (P, 3) [cm], and how far the axis of each is from its guide's, (N,) [cm]."""
    usable = len(guides.kept)
    offsets = guides.groom.offsets
    even = resample(guides.points, offsets, np.arange(usable + 1) * AXIS_POINTS).reshape(usable, AXIS_POINTS, 3)
    lengths = arc_lengths(even.reshape(-1, 3), np.arange(usable + 1) * AXIS_POINTS)
    lifts = guides.points[offsets[:-1]] - guides.groom.points[offsets[:-1]]
    axes = axes_between(even, lengths, lifts, scalp.normals, places.parents, places.weights, places.roots)
    rng = np.random.default_rng([options.seed, 2])
    # Uniform numbers, and normal ones within three deviations.
    random = np.concatenate(
        [rng.random((options.count, 6)), np.clip(rng.normal(size=(options.count, RANDOMS - 6)), -3.0, 3.0)], axis=1
    )
    t = np.linspace(0.0, 1.0, AXIS_POINTS)
    profile = options.clump_profile(t)
    texture_offsets = offsets_of(counts)
    hairs = offsets_of(counts[wisps.guide])
    out = np.empty((hairs[-1], 3))
    away = np.empty(options.count)
    for first in range(0, options.count, CHUNK):
        last = min(first + CHUNK, options.count)
        rows = slice(hairs[first], hairs[last])
        out[rows], away[first:last] = laid(
            axes,
            even,
            lengths,
            textures,
            texture_offsets,
            wisps.guide,
            wisps.rank,
            wisps.flyaway,
            wisps.leaders,
            places.roots,
            random,
            radius,
            options.clump * profile,
            max(options.clump, 0.5) * profile,
            options.variation,
            first,
            hairs[first : last + 1] - hairs[first],
        )
        if progress is not None:
            progress(last - first)
    return out, away


def _ids(groom: Groom) -> NDArray[np.int32]:
    """Ids (S,) of a groom's strands: its own where they are distinct whole numbers, else their indices."""
    own = groom.attributes.get(ID)
    if own is not None and own.scope is Scope.STRAND and own.values.ndim == 1 and own.values.dtype.kind in "iu":
        fits = own.values.min(initial=0) >= 0 and own.values.max(initial=0) < 2**31 - MOST_STRANDS
        if fits and len(np.unique(own.values)) == len(own.values):
            return own.values.astype(np.int32)
    return np.arange(groom.strand_count, dtype=np.int32)


def _guide_attributes(groom: Groom, options: HairOptions) -> dict[str, Attribute]:
    """Attributes of the guide strands, those of the hairs among them."""
    ids = _ids(groom)
    count = groom.strand_count
    closest = np.repeat(ids[:, None], 3, axis=1)
    weights = np.tile(np.array([1.0, 0.0, 0.0], dtype=np.float32), (count, 1))
    return {
        **groom.attributes,
        "width": groom.attributes.get("width", Attribute(np.full(count, options.width), Scope.STRAND)),
        ID: Attribute(ids, Scope.STRAND),
        GUIDE: Attribute(np.ones(count, dtype=np.int16), Scope.STRAND),
        CLOSEST: Attribute(closest, Scope.STRAND),
        WEIGHTS: Attribute(weights, Scope.STRAND),
    }


def _attributes(
    groom: Groom, guides: StyleGuides, places: _Places, counts: NDArray[np.int64], options: HairOptions
) -> tuple[dict[str, Attribute], list[str]]:
    """Attributes of hairs with ``counts`` (N,) points, and sentences on those that they cannot have."""
    own = _guide_attributes(groom, options)
    replaced = (ID, GUIDE, CLOSEST, WEIGHTS, "width")
    others = replace(groom, attributes={name: a for name, a in groom.attributes.items() if name not in replaced})
    kept, lost = mixed_attributes(others, guides.kept[places.parents], places.weights, offsets_of(counts))
    hairs = len(counts)
    ids = own[ID].values
    order = np.argsort(-places.weights, axis=1, kind="stable")
    closest = np.take_along_axis(places.parents, order, axis=1)
    weights = np.take_along_axis(places.weights, order, axis=1)
    scope = own["width"].scope
    size = {Scope.GROOM: 1, Scope.STRAND: hairs, Scope.POINT: int(counts.sum())}[scope]
    first = int(ids.max(initial=-1)) + 1
    kept.update(
        {
            "width": Attribute(np.full(size, options.width, dtype=own["width"].values.dtype), scope),
            ID: Attribute(np.arange(first, first + hairs, dtype=np.int32), Scope.STRAND),
            GUIDE: Attribute(np.zeros(hairs, dtype=np.int16), Scope.STRAND),
            CLOSEST: Attribute(ids[guides.kept[closest]], Scope.STRAND),
            WEIGHTS: Attribute(weights.astype(np.float32), Scope.STRAND),
        }
    )
    return kept, lost
