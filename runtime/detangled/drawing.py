"""Strands of a texture in canonical space: synthesised, read where the texture settles, and drawn again if need be.

How often a strand twists cannot be changed once it is drawn. So those that twist far too often, or too seldom, are
drawn anew from other noise, and the nearest is kept. So are those whose axis wanders where a texture was
fitted to strands without twists: to straighten it adds torsion. A piece of a strand is taken from where its
axis does not wander.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from detangled.base_texture import Texture
from detangled.engines import Engine
from detangled.geometry.arc import arc_positions
from detangled.groom import offsets_of
from detangled.grooming.lengths import Straightened, straightened, without_roots
from detangled.kernels import parallel_kernel, prange
from detangled.synthesis import synthesise

REDRAWN = 4  # times at most
# A strand further off is drawn anew: in T_f, and in arc length over chord of an axis, less 1.
FAR_TWIST, FAR_WANDER = 0.08, 0.1
TRIED = 8  # places that a piece of a strand may be taken from
_PIECE = 3  # tells what chooses them from the stream that noise is drawn from


@dataclass(frozen=True)
class ToDraw:
    """What strands (S,) are to be drawn.

    arcs: arc lengths [cm]. kept: of them, from the new root on, as it will be written. names: numbers that tell them
    apart. cut: which will be cut to length instead of scaled. straight: whose axes are taken to be straight. dropped:
    arc lengths [cm] that are lost at the roots. spare: how much further down [cm] a piece of a strand may begin; 0 of a
    strand that is no piece.
    """

    arcs: NDArray[np.float64]
    kept: NDArray[np.float64]
    names: NDArray[np.int64]
    cut: NDArray[np.bool_]
    straight: NDArray[np.bool_]
    dropped: NDArray[np.float64]
    spare: NDArray[np.float64]

    def select(self, chosen: NDArray[np.int64]) -> ToDraw:
        """These of them alone."""
        return ToDraw(
            self.arcs[chosen],
            self.kept[chosen],
            self.names[chosen],
            self.cut[chosen],
            self.straight[chosen],
            self.dropped[chosen],
            self.spare[chosen],
        )


class Drawn(NamedTuple):
    """Strands (S,): signals (C, 3) by starts (S + 1,), points (P, 3) [cm] in canonical space by offsets (S + 1,).

    dropped: (S,) [cm] of arc that they have lost at the root. sizes: (S, 2), factors of radius and wavelength that
    settle them; 1 where the texture does not. off: (S,), over 1 for those that are to be drawn anew.
    """

    values: NDArray[np.float64]
    starts: NDArray[np.int64]
    points: NDArray[np.float64]
    offsets: NDArray[np.int64]
    dropped: NDArray[np.float64]
    sizes: NDArray[np.float64]
    off: NDArray[np.float64]


def draw_strands(
    texture: Texture,
    what: ToDraw,
    seed: int,
    steps: int,
    progress: Callable[[int], object] | None,
    engine: Engine,
) -> Drawn:
    """Draw strands. The same seed gives the same strand of a name, whatever the others. progress: told how many are."""
    drawn = _drawn(texture, what, seed, steps, progress, engine)
    for attempt in range(1, REDRAWN + 1):
        far = np.flatnonzero(drawn.off > 1.0)
        if len(far) == 0:
            break
        # Streams of their own: beside those of the seed that was given.
        other = int(np.random.SeedSequence(seed, spawn_key=(attempt,)).generate_state(1, np.uint64)[0])
        again = _drawn(texture, what.select(far), other, steps, None, engine)
        nearer = np.flatnonzero(again.off < drawn.off[far])
        drawn = _replaced(drawn, far[nearer], again, nearer)
    return drawn


def off_by_wander(texture: Texture, strands: Straightened) -> NDArray[np.float64]:
    """How far off strands are (S,), over 1 if they are to be drawn anew, by arc length over chord of their axes."""
    count = len(strands.offsets) - 1
    return _off(texture, strands, np.zeros((count, 1)), np.full(count, np.inf), np.ones(count))[:, 0]


def _drawn(
    texture: Texture, what: ToDraw, seed: int, steps: int, progress: Callable[[int], object] | None, engine: Engine
) -> Drawn:
    """Strands, each drawn once."""
    values, starts = synthesise(texture, what.arcs, what.names, seed, steps, progress, engine)
    whole = straightened(values, starts, what.straight, texture.axis)
    dropped, off = _lost_at_roots(texture, whole, what, seed)
    points, offsets = without_roots(whole.points, whole.offsets, dropped)
    sizes = np.ones((len(what.arcs), 2))
    if texture.settling is not None:
        sizes, twists = texture.settling.settle(points, offsets, what.kept)
        if texture.settling.twist is not None:
            off = np.abs(twists - texture.settling.twist) / FAR_TWIST
    return Drawn(values, starts, points, offsets, dropped, sizes, off)


def _lost_at_roots(
    texture: Texture, whole: Straightened, what: ToDraw, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Arc lengths (S,) [cm] that strands lose at their roots, and how far off they are by their axes (S,).

    A piece is taken from the first of some random places where it is not far off, or else from the best.
    """
    pieces = what.spare > 0.0
    chances = np.zeros((len(pieces), TRIED))
    for row in np.flatnonzero(pieces):
        chances[row] = np.random.default_rng([seed, int(what.names[row]), _PIECE]).random(TRIED)
    dropped = what.dropped[:, None] + what.spare[:, None] * chances
    off = _off(
        texture,
        whole,
        np.where(pieces[:, None], dropped, 0.0),
        np.where(pieces, what.kept, np.inf),
        np.where(pieces, what.kept / what.arcs, 1.0),
    )
    chosen = np.where((off <= 1.0).any(axis=1), (off <= 1.0).argmax(axis=1), off.argmin(axis=1))
    return dropped[np.arange(len(chosen)), chosen], off[np.arange(len(chosen)), chosen]


def _off(
    texture: Texture,
    strands: Straightened,
    places: NDArray[np.float64],
    lengths: NDArray[np.float64],
    share: NDArray[np.float64],
) -> NDArray[np.float64]:
    """How far off strands (S,) are by their axes from places (S, K) on, over so much arc length (S,) [cm], (S, K).

    share: (S,), of the whole strand: so much less may its axis bend there.
    """
    if not texture.stiff:
        return np.zeros(places.shape)
    along = arc_positions(strands.points, strands.offsets)
    return (_wander(strands.axes, along, strands.offsets, places, lengths) - 1.0) / (FAR_WANDER * share[:, None])


@parallel_kernel
def _wander(
    axes: NDArray[np.float64],
    along: NDArray[np.float64],
    offsets: NDArray[np.int64],
    places: NDArray[np.float64],
    lengths: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Arc length over chord of axes (P, 3), by offsets (S + 1,), from places (S, K) on over lengths (S,), (S, K).

    Both are arc lengths [cm] of the strands, whose points have the arc positions ``along`` (P,).
    """
    out = np.ones(places.shape)
    for s in prange(places.shape[0]):
        last = offsets[s + 1] - 1
        for k in range(places.shape[1]):
            if k > 0 and places[s, k] == places[s, 0]:
                out[s, k] = out[s, 0]
                continue
            first = offsets[s]
            while first < last and along[first] < places[s, k]:
                first += 1
            arc = 0.0
            i = first
            while i < last and along[i] < places[s, k] + lengths[s]:
                arc += np.sqrt(((axes[i + 1] - axes[i]) ** 2).sum())
                i += 1
            chord = np.sqrt(((axes[i] - axes[first]) ** 2).sum())
            out[s, k] = arc / max(chord, 1e-12) if i > first else 1.0
    return out


def _replaced(drawn: Drawn, rows: NDArray[np.int64], others: Drawn, chosen: NDArray[np.int64]) -> Drawn:
    """Strands, these of them replaced by some others of as many cells."""
    values, dropped, sizes, off = drawn.values.copy(), drawn.dropped.copy(), drawn.sizes.copy(), drawn.off.copy()
    points = np.split(drawn.points, drawn.offsets[1:-1])
    for row, other in zip(rows, chosen, strict=True):
        values[drawn.starts[row] : drawn.starts[row + 1]] = others.values[
            others.starts[other] : others.starts[other + 1]
        ]
        points[row] = others.points[others.offsets[other] : others.offsets[other + 1]]
    dropped[rows], sizes[rows], off[rows] = others.dropped[chosen], others.sizes[chosen], others.off[chosen]
    offsets = offsets_of([len(p) for p in points])
    return Drawn(values, drawn.starts, np.concatenate(points), offsets, dropped, sizes, off)
