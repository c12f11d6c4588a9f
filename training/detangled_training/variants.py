"""What a data set is made of: procedural strands, the same hung wet, and both as a groom's file would hold them.

Paper sections "Simulation" and "Data Generation and Curation". Every base strand comes as it was constructed, or hung
several times with fibres of its own. Some also come as they are read from a file: with few points, with noise, bent by
a hairstyle, and straightened without the hair before their root and beyond their tip, which a file has not; half of
these as retextured hair lies, straight but for its style.

A hung strand's radius and wavelength are those of its twin, the same strand without twists under the same load: paper
and all, there are no hand labels here. Of such a smooth coil they follow from curvature and torsion at each place.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from detangled.errors import TextureError
from detangled.geometry.signal import signals
from detangled.groom import Groom, offsets_of
from detangled.grooming.placing import resample
from detangled.labeling import CELLS, CELLS_PER_TURN, WORLD, Reading, lower_signals
from detangled.texture import RADIUS_LIMITS, Spread, arc_of_a_turn
from detangled_training.hanging import differ, hang
from detangled_training.material import Fibres
from detangled_training.signals import lower_begin, margins, on_grids, straightened
from detangled_training.strands import Recipes, Strands, characteristic, draw_recipes, helix_means, make_strands

FIBRE_COLUMNS = ("thickness", "axis_ratio", "porosity", "youngs", "shear")
TWIN_CELLS = 256
FEWEST_POINTS = 8  # of a strand in a file
POINTS_PER_TURN = (5.0, 32.0)  # of strands in files, in the logarithm
NOISE = (1e-4, 1e-2)  # of a strand's radius, in the logarithm
BENDS = (0.01, 0.3)  # [1/cm] of hairstyles, in the logarithm
MOST_BENT = 4.0  # [rad] from root to tip, about
FILE_DIGITS = 1e-5  # [cm] least noise: what float32 leaves of coordinates on a head

# Fibres that strands are hung with: thickness [um] as people have it, the moduli [GPa] of wet hair.
THICKNESS, THICKNESS_DEVIATION, THICKNESSES = 70.0, 20.0, (30.0, 140.0)
AXIS_RATIOS = (0.55, 1.0)
WET_YOUNGS = (1.3, 1.9)
WET_SHEAR = (0.15, 0.3)

# A twin beyond these is no coil any more, beside what it was made as.
LEAST_NARROWED, MOST_WIDENED, MOST_STRETCHED = 0.15, 1.25, 4.0

_FIBRE, _READ = 3, 4  # tell a strand's streams of random numbers apart


@dataclass(frozen=True)
class VariantOptions:
    """What is made of each base strand.

    hung: times it is hung, with fibres of its own; 0 where it is not simulated. read_share: share of base strands
    that also come as a file would hold them. cells: of a signal. untyped: share of base strands of none of the types
    (``draw_recipes``).
    """

    hung: int = 0
    read_share: float = 0.5
    cells: int = CELLS
    untyped: float = 0.0


Columns = dict[str, NDArray]


def make_variants(first: int, count: int, seed: int, options: VariantOptions) -> tuple[NDArray[np.float32], Columns]:
    """Signals (V, cells, 3) of all variants of base strands ``first`` to ``first + count``, and their labels.

    A column (V, ...) each. world: (V, cells, 2) kappa and tau as it lies in the world, beside those of its signals, in
    canonical space. base: the strand's number. variant: which time it was hung, -1 where it was not. stretched:
    whether it hung from the stretched pose, where that ends otherwise. read: whether it is as a file holds it, then
    with points_per_turn and noise [cm], and laid: whether it lies there as retextured hair does. kind: index into
    HAIR_TYPES, or UNTYPED. radius, wavelength [cm]: of the signal's lower part, without twists. twist (T_f), twists
    (how many), length [cm] of arc, hand: as constructed. turns: of the whole strand. position (2): the part of root to
    tip that the signal covers. thickness [um], axis_ratio, porosity, youngs, shear [GPa]: of the fibre, NaN where it is
    not hung.

    Depends on the seed and each strand's number alone. Strands that could not be hung or read are left out.
    """
    if options.read_share > 0.0 and options.cells != CELLS:
        raise TextureError(f"strands that are read have signals of {CELLS} cells, not of {options.cells}")
    recipes = draw_recipes(count, seed, first, untyped=options.untyped)
    parts = []
    if options.hung == 0:
        strands = make_strands(recipes, seed, margins(recipes))
        parts.extend(_both(strands, recipes, None, None, seed, options, _unhung(count)))
    for variant in range(options.hung):
        for hung in hung_strands(recipes, seed, variant):
            own = len(hung.recipes)
            about: Columns = {
                "variant": np.full(own, variant, dtype=np.int8),
                "stretched": np.full(own, hung.stretched),
            }
            about |= hung.fibres
            parts.extend(_both(hung.strands, hung.recipes, hung.radius, hung.wavelength, seed, options, about))
    if not parts:
        strands = make_strands(recipes, seed, margins(recipes))
        ((values, columns), *_) = _both(strands, recipes, None, None, seed, options, _unhung(count))
        return values[:0], {name: column[:0] for name, column in columns.items()}
    values = np.concatenate([values for values, _ in parts])
    columns = {name: np.concatenate([column[name] for _, column in parts]) for name in parts[0][1]}
    order = np.argsort(columns["base"], kind="stable")
    return values[order], {name: column[order] for name, column in columns.items()}


def _unhung(count: int) -> Columns:
    about: Columns = {"variant": np.full(count, -1, dtype=np.int8), "stretched": np.zeros(count, dtype=np.bool_)}
    return about | {name: np.full(count, np.nan) for name in FIBRE_COLUMNS}


def _both(
    strands: Strands,
    recipes: Recipes,
    radius: NDArray[np.float64] | None,
    wavelength: NDArray[np.float64] | None,
    seed: int,
    options: VariantOptions,
    about: Columns,
) -> list[tuple[NDArray[np.float32], Columns]]:
    """Strands as they are and, some of them, as read. radius, wavelength: (S, N) along each; None as constructed."""
    variant = about["variant"]
    streams = [
        np.random.default_rng([seed, int(number), _READ, int(which) + 1])
        for number, which in zip(recipes.number, variant, strict=True)
    ]
    uniform = np.array([rng.random(6) for rng in streams])
    if radius is None or wavelength is None:
        turns = strands.length / arc_of_a_turn(strands.radius, strands.wavelength)
    else:
        turns = strands.length / arc_of_a_turn(*helix_means(radius, wavelength))

    def labelled(position: NDArray[np.float64], chosen: NDArray[np.int64], more: Columns) -> Columns:
        begin, end = lower_begin(position), position[:, 1]
        if radius is None or wavelength is None:
            own = characteristic(recipes.select(chosen), begin, end)
        else:
            own = means_between(radius[chosen], wavelength[chosen], begin, end)
        known = {
            "base": recipes.number, "kind": strands.kind, "twist": strands.twist, "twists": strands.twists,
            "length": strands.length, "hand": strands.hand, "turns": turns, **about,
        }  # fmt: skip
        return {"radius": own[0], "wavelength": own[1], "position": position} | {
            name: np.asarray(column)[chosen] for name, column in (known | more).items()
        }

    everyone = np.arange(len(recipes))
    nan = np.full(len(recipes), np.nan)
    values = np.empty((len(recipes), options.cells, 3), dtype=np.float32)
    world = np.empty((len(recipes), options.cells, WORLD), dtype=np.float32)
    body, offsets = bodies(strands)
    canonical = straightened(strands)
    for points, out in ((canonical.points, values), (body, world)):
        position = on_grids(points, offsets, turns, CELLS_PER_TURN, uniform[:, 0], out)
    no = np.zeros(len(recipes), dtype=np.bool_)
    unread = {"world": world, "read": no, "laid": no, "points_per_turn": nan, "noise": nan}
    parts = [(values, labelled(position, everyone, unread))]

    chosen = np.flatnonzero(uniform[:, 1] < options.read_share)
    if len(chosen) == 0:
        return parts
    per_turn = np.exp(np.interp(uniform[:, 2], (0.0, 1.0), np.log(POINTS_PER_TURN)))
    noise = np.exp(np.interp(uniform[:, 3], (0.0, 1.0), np.log(NOISE))) * strands.radius + FILE_DIGITS
    laid = uniform[:, 4] < 0.5
    style = np.array([rng.standard_normal((2, 3)) for rng in streams])
    style *= np.exp(np.interp(uniform[:, 5], (0.0, 1.0), np.log(BENDS)))[:, None, None]
    lying = np.where(np.repeat(laid, np.diff(offsets))[:, None], canonical.points, body)
    lying = bent(lying, offsets, style)
    counts = np.maximum(np.ceil(per_turn * turns), FEWEST_POINTS).astype(np.int64) + 1
    sparse = offsets_of(counts)
    points = resample(lying, offsets, sparse)
    for s in chosen:
        points[sparse[s] : sparse[s + 1]] += noise[s] * streams[s].standard_normal((counts[s], 3))
    lower = lower_signals(*_selected(points, sparse, chosen))
    readable = lower.reading == Reading.READ
    chosen = chosen[readable]
    position = np.stack([1.0 - lower.part[readable], np.ones(len(chosen))], axis=1)
    values = lower.values[readable].astype(np.float32)
    read = {"read": ~no, "laid": laid, "points_per_turn": per_turn, "noise": noise}
    columns = labelled(position, chosen, read)
    parts.append((values[:, :, :3], {"world": values[:, :, 3:], **columns}))
    return parts


def bent(points: NDArray[np.float64], offsets: NDArray[np.int64], style: NDArray[np.float64]) -> NDArray[np.float64]:
    """Strands (P, 3) [cm] bent as hairstyles bend them: each segment turned, so that arc lengths stay.

    style: (S, 2, 3) [1/cm] how fast segments turn along the arc about either of two axes: a constant rate, half a wave
    and a whole one from root to tip. Rates are lowered where that would be more than MOST_BENT.
    """
    out = points.copy()
    for (a, b), rates in zip(pairwise(offsets), style, strict=True):
        segments = np.diff(points[a:b], axis=0)
        arc = np.cumsum(np.linalg.norm(segments, axis=1))
        share = arc / arc[-1]
        waves = np.stack([share, np.sin(np.pi * share) / np.pi, np.sin(2.0 * np.pi * share) / (2.0 * np.pi)])
        angles = rates * min(arc[-1], MOST_BENT / max(np.abs(rates).max(), 1e-12))
        turn = Rotation.from_euler("xy", (angles @ waves).T)
        out[a + 1 : b] = points[a] + np.cumsum(turn.apply(segments), axis=0)
    return out


@dataclass(frozen=True)
class Hanging:
    """Strands as they hang, with margins; of each the recipe it was made by.

    radius, wavelength: (S, N) [cm] along each strand's twin, which hangs without twists. stretched: whether they hung
    from the stretched pose. fibres: (S,) each.
    """

    strands: Strands
    recipes: Recipes
    radius: NDArray[np.float64]
    wavelength: NDArray[np.float64]
    stretched: bool
    fibres: Columns


def hung_strands(
    recipes: Recipes,
    seed: int,
    variant: int,
    poses: tuple[bool, ...] = (False, True),
    margin: NDArray[np.float64] | None = None,
) -> Iterator[Hanging]:
    """Strands hung wet with fibres of their own, from the rest pose and, where it ends otherwise, from a stretched one.

    Those that could not be hung, or that weight pulls straight, are left out; a pose of which none is left as well.
    margin: (S,) [cm] of more hair at either end, ``margins`` where none is given.
    """
    twins = make_strands(replace(recipes, twist=np.zeros(len(recipes))), seed)
    strands = upright(make_strands(recipes, seed, margins(recipes) if margin is None else margin), twins)
    fibres, roll = draw_fibres(recipes.number, seed, variant)
    body, offsets = bodies(strands)
    twin = hang(twins.points, twins.offsets, fibres, roll=roll)
    rest = None
    for stretched in poses:
        pose = hang(body, offsets, fibres, roll=roll, stretched=stretched)
        kept = twin.converged & pose.converged
        if rest is None:
            rest = pose.points
        else:
            kept &= differ(rest, pose.points, offsets)
        chosen = np.flatnonzero(kept)
        radius, wavelength = _local(*_selected(twin.points, twins.offsets, chosen))
        curled = still_curled(radius, wavelength, recipes.select(chosen))
        chosen, radius, wavelength = chosen[curled], radius[curled], wavelength[curled]
        if len(chosen):
            yield Hanging(
                strands=_with_margins(strands, pose.points, offsets, chosen),
                recipes=recipes.select(chosen),
                radius=radius,
                wavelength=wavelength,
                stretched=stretched,
                fibres={name: getattr(fibres, name)[chosen] for name in FIBRE_COLUMNS},
            )


def still_curled(radius: NDArray[np.float64], wavelength: NDArray[np.float64], recipes: Recipes) -> NDArray[np.bool_]:
    """Which twins (S,) hang as coils, by what their places (S, N) tell.

    Weight narrows and stretches a coil. Where it has pulled the hair straight the bend of its own fall is all that is
    left, and tells of neither radius nor wavelength.
    """
    found = helix_means(radius, wavelength)
    made = recipes.radius.mean(axis=1), recipes.wavelength.mean(axis=1)
    lengths = np.minimum(recipes.length, MOST_STRETCHED * made[1])
    least = np.maximum(LEAST_NARROWED * made[0], RADIUS_LIMITS[0])
    return (found[0] >= least) & (found[0] <= MOST_WIDENED * made[0]) & (found[1] <= lengths)


def draw_fibres(numbers: NDArray[np.int64], seed: int, variant: int) -> tuple[Fibres, NDArray[np.float64]]:
    """Fibres of wet hair, and how far each strand's section is turned (S,) [rad]: by seed, number and variant alone."""
    uniform = np.array([np.random.default_rng([seed, int(n), _FIBRE, variant]).random(6) for n in numbers])
    thickness = Spread(THICKNESS, THICKNESS_DEVIATION, *THICKNESSES).at(uniform[:, 0])
    ratio, youngs, shear = (
        low + (high - low) * uniform[:, k]
        for k, (low, high) in enumerate((AXIS_RATIOS, WET_YOUNGS, WET_SHEAR), start=1)
    )
    return Fibres(thickness, ratio, uniform[:, 4], youngs, shear), 2.0 * np.pi * uniform[:, 5]


def bodies(strands: Strands) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The strands between their margins: points and offsets."""
    counts = np.diff(strands.body, axis=1)[:, 0]
    offsets = offsets_of(counts)
    return strands.points[np.arange(offsets[-1]) + np.repeat(strands.body[:, 0] - offsets[:-1], counts)], offsets


def upright(strands: Strands, twins: Strands) -> Strands:
    """Strands turned and moved so that their bodies begin as their twins do: at the origin, winding downwards."""
    first, goal = strands.body[:, 0], twins.offsets[:-1]
    turn = np.swapaxes(_frames(twins.points, goal, 1), 1, 2) @ _frames(strands.points, first, 1)
    counts = np.diff(strands.offsets)
    origin = np.repeat(strands.points[first], counts, axis=0)
    points = np.einsum("pij,pj->pi", np.repeat(turn, counts, axis=0), strands.points - origin)
    return replace(strands, points=points + np.repeat(twins.points[goal], counts, axis=0))


def _with_margins(
    strands: Strands, hung: NDArray[np.float64], offsets: NDArray[np.int64], chosen: NDArray[np.int64]
) -> Strands:
    """Some strands with their bodies hung. The hair before a root stays, the hair beyond a tip has no weight."""
    made, bounds, body = [], [0], []
    before = _frames(strands.points, strands.body[:, 1] - 1, -1)
    after = _frames(hung, offsets[1:] - 1, -1)
    for s in chosen:
        a, b = strands.offsets[s], strands.offsets[s + 1]
        first, last = strands.body[s]
        turn = after[s].T @ before[s]
        tip = hung[offsets[s + 1] - 1]
        beyond = (strands.points[last:b] - strands.points[last - 1]) @ turn.T + tip
        made.extend([strands.points[a:first], hung[offsets[s] : offsets[s + 1]], beyond])
        body.append((bounds[-1] + first - a, bounds[-1] + last - a))
        bounds.append(bounds[-1] + b - a)
    columns = {
        name: getattr(strands, name)[chosen]
        for name in ("kind", "radius", "wavelength", "twist", "length", "hand", "twists")
    }
    return Strands(np.concatenate(made), np.array(bounds), body=np.array(body), **columns)


def _frames(points: NDArray[np.float64], at: NDArray[np.int64], way: int) -> NDArray[np.float64]:
    """Right-handed frames (S, 3, 3), rows the directions, of the two segments from points ``at`` (S,) on or back."""
    along = points[at + way] - points[at]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    further = points[at + 2 * way] - points[at + way]
    across = further - (further * along).sum(axis=1, keepdims=True) * along
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    return np.stack([along, across, np.cross(along, across)], axis=1)


def _local(points: NDArray[np.float64], offsets: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Radius and wavelength (S, N) [cm] at places along smooth coils, by the helix equations."""
    cells = np.arange(len(offsets), dtype=np.int64) * TWIN_CELLS
    values = signals(points, offsets, cells).reshape(-1, TWIN_CELLS, 3)
    kappa, tau = np.abs(values[:, :, 0]), np.abs(values[:, :, 1])
    total = np.maximum(kappa**2 + tau**2, 1e-12)
    return kappa / total, np.maximum(2.0 * np.pi * tau / total, 1e-6)


def means_between(
    radius: NDArray[np.float64], wavelength: NDArray[np.float64], begin: NDArray[np.float64], end: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """``helix_means`` of local values (S, N) from begin to end (S,) of the arc."""
    at = (np.arange(radius.shape[1]) + 0.5) / radius.shape[1]
    shares = begin[:, None] + (end - begin)[:, None] * at
    rows = np.arange(len(radius))[:, None]
    cells = np.minimum((shares * radius.shape[1]).astype(np.int64), radius.shape[1] - 1)
    return helix_means(radius[rows, cells], wavelength[rows, cells])


def _selected(
    points: NDArray[np.float64], offsets: NDArray[np.int64], chosen: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The points and offsets of some strands."""
    some = Groom(points, offsets).select(chosen)
    return some.points, some.offsets
