"""What ``benchmarks/retexture.py`` measures: lengths on guides, axes, windings, likeness and distributions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import wasserstein_distance

from detangled import Groom
from detangled.diffusion.whitening import Whitening
from detangled.geometry.arc import arc_lengths, arc_positions
from detangled.geometry.canonical import guide_frames
from detangled.geometry.centerline import centerlines
from detangled.geometry.signal import signals
from detangled.geometry.spline import chord_lengths, distinct_points, spline_sample, spline_slopes
from detangled.groom import offsets_of
from detangled.grooming.guides import style_guides
from detangled.grooming.placing import place, unbend_roots

JUDGE = Path(__file__).parent / "judge"  # labelers that had no part in making what they judge
# A guide of 50 cm is then sampled every 0.25 mm: a hundredth of a turn.
GUIDE_SAMPLES = 2000
SHIFTS = 40  # cells by which two strands may be shifted to find where they are most alike
LEAST_OVERLAP = 0.8
FEWEST_PIECE_SEGMENTS = 100
FEWEST_CELLS = 8  # of a strand whose signal is looked at

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Canonical:
    """Strands in canonical space: points (P, 3) [cm] and offsets (S + 1,)."""

    points: Floats
    offsets: NDArray[np.int64]

    def strands(self) -> Iterator[Floats]:
        yield from rows(self.points, self.offsets)

    def select(self, chosen: NDArray[np.int64]) -> Canonical:
        groom = Groom(self.points, self.offsets).select(chosen)
        return Canonical(groom.points, groom.offsets)


def rows(points: Floats, offsets: NDArray[np.int64]) -> Iterator[Floats]:
    """Each strand's points, one after another."""
    for a, b in pairwise(offsets):
        yield points[a:b]


def smooth(points: Floats, count: int = GUIDE_SAMPLES) -> Floats:
    """The smooth curve through a guide's points at ``count`` even steps, (count + 1, 3)."""
    knots = distinct_points(np.ascontiguousarray(points, dtype=np.float64))
    t = chord_lengths(knots)
    return spline_sample(t, knots, spline_slopes(t, knots), np.linspace(0.0, t[-1], count + 1))


def beyond_end(tip: Floats, guide: Floats) -> tuple[float, float]:
    """How far [cm] a tip lies beyond (+) or before (-) the plane across its guide's end, and the guide's arc length.

    Not the place on the guide nearest to the tip: where a guide bends more tightly than the strand is wide, several
    places are.
    """
    curve = smooth(guide)
    tangent = np.gradient(curve[-3:], axis=0, edge_order=2)[-1]
    return float((tip - curve[-1]) @ tangent / np.linalg.norm(tangent)), float(chord_lengths(curve)[-1])


def guide_length_errors(groom: Groom, guides: Groom) -> Floats:
    """How far tips lie beyond (+) or before (-) their guides' ends, as shares of the guides' arc lengths, (S,).

    What float32 coordinates cannot resolve is not counted: a combed-over hair may be a tenth of a millimetre long.
    """
    out = np.empty(groom.strand_count)
    for i, (strand, guide) in enumerate(
        zip(rows(groom.points, groom.offsets), rows(guides.points, guides.offsets), strict=True)
    ):
        beyond, length = beyond_end(strand[-1], guide)
        out[i] = _beyond_rounding(beyond, strand, groom.unit_cm) / length
    return out


def arc_length_errors(groom: Groom, old: Groom) -> Floats:
    """New arc length over the old strand's, less one, (S,); float32 rounding of both ends is not counted."""
    new, was = arc_lengths(groom.points, groom.offsets), arc_lengths(old.points, old.offsets)
    missing = [
        _beyond_rounding(a - b, s, groom.unit_cm)
        for a, b, s in zip(new, was, rows(groom.points, groom.offsets), strict=True)
    ]
    return np.array(missing) / was


def _beyond_rounding(difference: float, strand: Floats, unit_cm: float) -> float:
    """A difference of lengths [cm] less what the two ends' coordinates in float32 may be off."""
    step = float(np.spacing(np.float32(np.abs(strand).max() / unit_cm))) * unit_cm
    return float(np.sign(difference) * max(abs(difference) - np.sqrt(3.0) * step, 0.0))


def distances(groom: Groom, guides: Groom) -> Floats:
    """Median distance (S,) [cm] of each strand's points to its guide."""
    return np.array(
        [
            np.median(cKDTree(smooth(guide)).query(strand)[0])
            for strand, guide in zip(
                rows(groom.points, groom.offsets), rows(guides.points, guides.offsets), strict=True
            )
        ]
    )


def refined(groom: Groom, step: float) -> Groom:
    """The same strands, at points at most ``step`` [cm] apart on average."""
    usable = style_guides(groom).groom
    counts = np.ceil(arc_lengths(usable.points, usable.offsets) / step).astype(np.int64)
    strands = rows(usable.points, usable.offsets)
    return Groom.from_strands(
        smooth(strand, max(int(count), len(strand) - 1)) for strand, count in zip(strands, counts, strict=True)
    )


def in_world(groom: Groom) -> Canonical:
    """The strands as they lie, style and all."""
    return Canonical(groom.points, groom.offsets)


def own_axis(groom: Groom) -> Canonical:
    """The strands in the canonical space of their own guides, extracted anew."""
    guides = style_guides(groom)
    if len(guides.kept) != groom.strand_count:
        raise ValueError(f"{groom.strand_count - len(guides.kept)} strands cannot be measured")
    return Canonical(guides.canonical(), guides.groom.offsets)


def given_axis(groom: Groom, guides: Groom) -> Canonical:
    """The strands in the canonical space of given guides: each point in the frame of the place it lies across from.

    That is where (p - G(s)) . T(s) = 0. Where a guide bends more tightly than the strand is wide there are several
    such places: taken is the one nearest to the last point's, from the root on.
    """
    out = np.empty_like(groom.points)
    for i in range(groom.strand_count):
        strand = groom.strand(i)
        curve = smooth(guides.strand(i))
        # Straight on beyond both ends, as far as the strand may reach.
        beyond = 1.0 + np.ptp(strand, axis=0).max()
        first, last = curve[0] - curve[1], curve[-1] - curve[-2]
        steps = np.linspace(0.0, beyond, 100)[1:, None]
        curve = np.concatenate(
            [
                curve[0] + first / np.linalg.norm(first) * steps[::-1],
                curve,
                curve[-1] + last / np.linalg.norm(last) * steps,
            ]
        )
        frames, along = guide_frames(curve), chord_lengths(curve)
        down = -frames[:, 2]
        ahead = strand @ down.T - np.einsum("ij,ij->i", curve, down)
        crossings = (ahead[:, :-1] >= 0.0) & (ahead[:, 1:] < 0.0)
        here = beyond
        for j in range(len(strand)):
            found = np.flatnonzero(crossings[j])
            k = found[np.argmin(np.abs(along[found] - here))] if len(found) else len(down) - 2
            part = ahead[j, k] / (ahead[j, k] - ahead[j, k + 1])
            here = along[k] + part * (along[k + 1] - along[k])
            foot = curve[k] + part * (curve[k + 1] - curve[k])
            frame = frames[k] + part * (frames[k + 1] - frames[k])
            out[groom.offsets[i] + j] = frame @ (strand[j] - foot)
            out[groom.offsets[i] + j, 2] += beyond - here
    return Canonical(out, groom.offsets)


def axial_lengths(canonical: Canonical) -> Floats:
    """How far down the axis each strand reaches, (S,) [cm]."""
    return np.array([-strand[:, 2].min() for strand in canonical.strands()])


def without_ends(canonical: Canonical, arc: float) -> Canonical:
    """Strands without so much arc length [cm] at either end, from their new roots down; all must be longer."""
    along = arc_positions(canonical.points, canonical.offsets)
    strands = []
    for a, b in pairwise(canonical.offsets):
        inner = (along[a:b] >= arc) & (along[a:b] <= along[b - 1] - arc)
        strand = canonical.points[a:b][inner]
        strands.append(strand - [0.0, 0.0, strand[0, 2]])
    groom = Groom.from_strands(strands)
    return Canonical(groom.points, groom.offsets)


def pieces_on_guides(targets: Canonical, groom: Groom, guides: Groom, rng: np.random.Generator) -> Groom:
    """Strands on a groom's guides, each a piece of a random target that is as long along the axis as the guide.

    Guides must be shorter than the shortest target.

    What retexturing would give at best: the targets' own texture, seated at the same roots.
    """
    usable = style_guides(groom)
    roots = unbend_roots(groom.points[groom.offsets[:-1]], guides.points, guides.offsets)
    pieces = []
    for length in usable.lengths:
        k = rng.integers(len(targets.offsets) - 1)
        pieces.append(_piece(targets.points[targets.offsets[k] : targets.offsets[k + 1]], float(length), rng))
    canonical = Groom.from_strands(pieces)
    angles = rng.uniform(-np.pi, np.pi, groom.strand_count)
    points = place(canonical.points, canonical.offsets, guides.points, guides.offsets, roots, angles)
    return Groom(points, canonical.offsets)


def _piece(strand: Floats, length: float, rng: np.random.Generator) -> Floats:
    """A random piece of a canonical strand, ``length`` [cm] along its axis or up to the strand's tip."""
    down = -strand[:, 2]
    first = np.flatnonzero(down >= rng.uniform(0.0, down.max() - length))[0]
    beyond = np.flatnonzero(down[first:] >= down[first] + length)
    piece = strand[first : first + beyond[0] + 1] if len(beyond) else strand[first:]
    # Enough points to follow the guide that it is bent onto.
    return smooth(piece, max(len(piece) - 1, FEWEST_PIECE_SEGMENTS))


def middle_radius(canonical: Canonical) -> Floats:
    """Median distance (S,) [cm] of each strand's points to the axis."""
    return np.array([np.median(np.hypot(strand[:, 0], strand[:, 1])) for strand in canonical.strands()])


def mixed(first: Canonical, second: Canonical, use_first: NDArray[np.bool_]) -> Canonical:
    """Strands of the first where ``use_first`` (S,) says so, else of the second; both have the same point counts."""
    chosen = np.repeat(use_first, np.diff(first.offsets))[:, None]
    return Canonical(np.where(chosen, first.points, second.points), first.offsets)


def strand_signals(canonical: Canonical, cell_width: float) -> list[Floats]:
    """kappa, tau, v (L, 3) of each strand on cells of one width [cm]."""
    arcs = arc_lengths(canonical.points, canonical.offsets)
    cells = np.maximum(np.round(arcs / cell_width).astype(np.int64), FEWEST_CELLS)
    starts = offsets_of(cells)
    return list(rows(signals(canonical.points, canonical.offsets, starts), starts))


def wander(points: Floats, offsets: NDArray[np.int64]) -> Floats:
    """Arc length of each strand's centreline over the distance of its ends, (S,)."""
    axes, _ = centerlines(points, offsets)
    chords = np.linalg.norm(axes[offsets[1:] - 1] - axes[offsets[:-1]], axis=1)
    return arc_lengths(axes, offsets) / chords


def wasserstein(a: list[Floats], b: list[Floats]) -> tuple[float, float]:
    """Wasserstein-1 distance [1/cm] between the pooled kappa, and between the pooled |tau|, of two sets of signals."""
    x, y = np.concatenate(a), np.concatenate(b)
    return (
        float(wasserstein_distance(x[:, 0], y[:, 0])),
        float(wasserstein_distance(np.abs(x[:, 1]), np.abs(y[:, 1]))),
    )


@dataclass(frozen=True)
class Windows:
    """Windows of whitened kappa and tau, (W, 2, L), and the strand each is from, (W,)."""

    values: Floats
    strand: NDArray[np.int64]

    def one_a_strand(self, count: int, rng: np.random.Generator) -> Windows:
        """One window of each of at most ``count`` strands, at random."""
        order = rng.permutation(len(self.strand))
        _, first = np.unique(self.strand[order], return_index=True)
        chosen = rng.permutation(order[first])[:count]
        return Windows(self.values[chosen], self.strand[chosen])


def windows(values: list[Floats], whitening: Whitening, length: int) -> Windows:
    """All strands of at least ``length`` cells, cut into windows of that many cells, the last one up to the tip."""
    found, strand = [], []
    for i, signal in enumerate(values):
        if len(signal) < length:
            continue
        channels = whitening.whiten(signal)[:2]
        ends = [*range(length, len(signal), length), len(signal)]
        found += [channels[:, end - length : end] for end in ends]
        strand += [i] * len(ends)
    return Windows(np.array(found).reshape(-1, 2, length), np.array(strand, dtype=np.int64))


def nearest(some: Windows, others: Windows, same_set: bool) -> Floats:
    """Distance (W,) of each window to the one most like it among the others, of another strand in the same set.

    The root mean square over cells of the whitened kappa and tau, least over shifts of at most SHIFTS cells that
    leave LEAST_OVERLAP of the windows in common.
    """
    length = some.values.shape[2]
    shifts = min(SHIFTS, int((1.0 - LEAST_OVERLAP) * length))
    least = np.full((len(some.strand), len(others.strand)), np.inf)
    for shift in range(-shifts, shifts + 1):
        a = some.values[:, :, max(shift, 0) : length + min(shift, 0)].reshape(len(some.strand), -1)
        b = others.values[:, :, max(-shift, 0) : length + min(-shift, 0)].reshape(len(others.strand), -1)
        squares = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2.0 * a @ b.T
        np.minimum(least, squares / (length - abs(shift)), out=least)
    if same_set:
        least[some.strand[:, None] == others.strand] = np.inf
    return np.sqrt(np.maximum(least.min(axis=1), 0.0))
