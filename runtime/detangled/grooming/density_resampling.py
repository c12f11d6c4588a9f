"""More or fewer style guides: new roots by blue noise where hair grows, guides between their neighbours.

Paper section "Style guide resampling".
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from detangled.geometry.arc import arc_lengths
from detangled.groom import Attribute, Groom, Scope, offsets_of
from detangled.grooming.blue_noise import CANDIDATES, spread_out
from detangled.grooming.density import checked_factor
from detangled.grooming.guides import StyleGuides
from detangled.grooming.head_fit import check_fit
from detangled.grooming.interpolation import diverging, interpolated, joined, mixed_attributes
from detangled.grooming.scalp import HEXAGONAL, Scalp, scalp_of
from detangled.grooming.scalp_mesh import SAME_UV, places_on
from detangled.head import Head


@dataclass(frozen=True)
class Roots:
    """New roots: positions (N, 3) [cm], the triangles of the scalp that they lie in (N,), and weights (N, 3) there."""

    positions: NDArray[np.float64]
    triangles: NDArray[np.int64]
    weights: NDArray[np.float64]


@dataclass(frozen=True)
class Resampled:
    """A groom with another density of style guides.

    groom: the original strands that stay, in their order, then the new ones, which are style guides themselves.
    guides: the style guides of all of its usable strands. original: (S,) which strand of the old groom each is, -1 for
    a new one. factor: how many strands there are for each one before, of the usable ones. refused: share of the
    scalp where neighbours diverge, and no guide was made. notes: what there is to say, one sentence each.
    lost: attributes that could not be carried over.
    """

    groom: Groom
    guides: StyleGuides
    original: NDArray[np.int64]
    factor: float
    refused: float
    notes: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()


def resampled(
    groom: Groom,
    guides: StyleGuides,
    factor: float,
    head: Head | None = None,
    seed: int = 0,
    scalp: Scalp | None = None,
) -> Resampled:
    """The groom with ``factor`` times as many style guides, as dense in one place beside another as before.

    guides: of this groom (``style_guides``). head: in the groom's frame [cm]; new roots then lie on it. The same seed
    gives the same guides. Raises DetangledError for a factor that is none, a head without faces or away from the
    roots, and more than four million strands.
    """
    usable = len(guides.kept)
    factor = checked_factor(factor, usable)
    roots = guides.groom.points[guides.groom.offsets[:-1]]
    scalp = scalp or scalp_of(roots)
    notes: list[str] = []
    if head is not None:
        check_fit(head, guides.groom)
    if factor < 1.0:
        return _thinned(groom, guides, factor, scalp, notes)
    parts = diverging(guides.as_groom(), scalp)
    total = scalp.mass.sum()
    refused = float(scalp.mass[parts].sum() / total) if total > 0.0 else 0.0
    count = round((factor - 1.0) * usable * (1.0 - refused)) if len(scalp.triangles) else 0
    new = new_roots(scalp, ~parts, count, factor, seed)
    if factor > 1.0 and len(new.positions) == 0 and round((factor - 1.0) * usable) > 0:
        notes.append(
            "no guide was added: the roots span no surface, or all guides diverge"
            if usable > 2
            else f"no guide was added: {usable} strands span no scalp, three at least do"
        )
    return _densified(groom, guides, scalp, new, head, refused, notes)


def new_roots(
    scalp: Scalp,
    allowed: NDArray[np.bool_],
    count: int,
    factor: float,
    seed: int,
    corners: NDArray[np.bool_] | None = None,
) -> Roots:
    """Blue-noise roots in the allowed triangles (T,), each with its share by the roots that it has already.

    factor: of all roots to the old ones, from which follows how far apart they should lie. corners: triangles (T,) of
    which only the thirds next to their corners are used, and what is between stays bare.
    """
    narrow = np.zeros(len(allowed), dtype=np.bool_) if corners is None else corners
    mass = np.where(narrow, scalp.mass / 3.0, scalp.mass)
    triangles = np.flatnonzero(allowed & (mass > 0.0))
    if count <= 0 or len(triangles) == 0:
        return Roots(np.zeros((0, 3)), np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    rng = np.random.default_rng([seed, 0])
    ends = np.cumsum(mass[triangles])
    tries = ceil(CANDIDATES * count)
    # Even steps through the triangles' shares, shifted at random: no triangle gets more or less by chance.
    at = np.minimum(np.searchsorted(ends, (np.arange(tries) + rng.random(tries)) * (ends[-1] / tries)), len(ends) - 1)
    triangle = triangles[at]
    across, down = np.sqrt(rng.random(tries)), rng.random(tries)
    weights = np.stack([1.0 - across, across * (1.0 - down), across * down], axis=1)
    # A third as long and wide, a corner's piece holds a ninth of its triangle.
    near = np.eye(3)[weights.argmax(axis=1)]
    weights = np.where(narrow[triangle][:, None], (2.0 * near + weights) / 3.0, weights)
    candidates = scalp.at(triangle, weights)
    area = scalp.area_per_root()
    own = np.einsum("nk,nk->n", weights, area[scalp.triangles[triangle]])
    touched = np.unique(scalp.triangles[triangles])
    radii = np.sqrt(HEXAGONAL / (np.pi * factor) * np.concatenate([area[touched], own]))
    fixed = np.arange(len(radii)) < len(touched)
    chosen = spread_out(np.concatenate([scalp.roots[touched], candidates]), radii, count, fixed) - len(touched)
    return Roots(candidates[chosen], triangle[chosen], weights[chosen])


def _thinned(groom: Groom, guides: StyleGuides, factor: float, scalp: Scalp, notes: list[str]) -> Resampled:
    """The strands that lie well apart, in their order; those that are no guides stay."""
    usable = len(guides.kept)
    radii = scalp.packing_radius() / np.sqrt(factor)
    chosen = spread_out(scalp.roots, radii, max(round(factor * usable), min(usable, 1)))
    keep = np.setdiff1d(np.arange(groom.strand_count), np.delete(guides.kept, chosen))
    strands = guides.groom.select(chosen)
    rows = np.repeat(np.isin(np.arange(usable), chosen), guides.groom.point_counts)
    fewer = StyleGuides(
        strands, np.searchsorted(keep, guides.kept[chosen]), guides.points[rows], guides.lengths[chosen]
    )
    return Resampled(groom.select(keep), fewer, keep, len(chosen) / max(usable, 1), 0.0, tuple(notes))


def _densified(
    groom: Groom,
    guides: StyleGuides,
    scalp: Scalp,
    new: Roots,
    head: Head | None,
    refused: float,
    notes: list[str],
) -> Resampled:
    """The groom followed by guides that grow from new roots."""
    count = len(new.positions)
    original = np.concatenate([np.arange(groom.strand_count), np.full(count, -1)])
    if count == 0:
        return Resampled(groom, guides, original, 1.0, refused, tuple(notes))
    parents = scalp.triangles[new.triangles]
    nearest = parents[np.arange(count), new.weights.argmax(axis=1)]
    counts = np.maximum(guides.groom.point_counts[nearest], 2)
    roots = new.positions if head is None else places_on(new.positions, head).positions
    points = interpolated(guides.as_groom(), scalp, parents, new.weights, roots, counts)
    offsets = offsets_of(counts)
    # Fresh ids must be fresh beside the strands too that are no guides: the whole groom's attributes, by its indices.
    attributes, lost = mixed_attributes(groom, guides.kept[parents], new.weights, offsets)
    if head is not None:
        attributes.update(_uv_from_head(groom, guides, scalp.roots, roots, head))
    whole = joined(groom, points, counts, attributes)
    added = np.arange(groom.strand_count, whole.strand_count)
    kept = np.concatenate([guides.kept, added])
    strands = whole if len(kept) == whole.strand_count else whole.select(kept)
    more = StyleGuides(
        strands,
        kept,
        np.concatenate([guides.points, points]),
        np.concatenate([guides.lengths, arc_lengths(points, offsets)]),
    )
    return Resampled(whole, more, original, len(kept) / len(guides.kept), refused, tuple(notes), tuple(lost))


def _uv_from_head(
    groom: Groom, guides: StyleGuides, old: NDArray[np.float64], new: NDArray[np.float64], head: Head
) -> dict[str, Attribute]:
    """Root texture coordinates of new strands, read off the head where the old ones' are those of the head."""
    found: dict[str, Attribute] = {}
    for name, attribute in groom.attributes.items():
        values = attribute.values
        if head.uv is None or attribute.scope is not Scope.STRAND or "uv" not in name.lower():
            continue
        if values.shape[1:] != (2,) or not np.issubdtype(values.dtype, np.floating):
            continue
        there = places_on(old, head).uv(head)
        if there is not None and np.median(np.abs(there - values[guides.kept])) < SAME_UV:
            uv = places_on(new, head).uv(head)
            if uv is not None:
                found[name] = Attribute(uv.astype(values.dtype), Scope.STRAND)
    return found
