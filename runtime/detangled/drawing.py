"""Strands of a texture in canonical space: synthesised, read where the texture settles, and drawn again if need be.

How often a strand twists cannot be changed once it is drawn. So those that twist far too often, or too seldom, are
drawn anew from other noise, and the nearest is kept. So are those whose axis wanders where a texture was
fitted to strands without twists: to straighten it adds torsion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from detangled.base_texture import Texture
from detangled.engines import Engine
from detangled.groom import offsets_of
from detangled.grooming.lengths import canonical_strands
from detangled.synthesis import synthesise

REDRAWN = 4  # times at most
# A strand further off is drawn anew: in T_f, and in arc length over chord of an axis, less 1.
FAR_TWIST, FAR_WANDER = 0.08, 0.1


@dataclass(frozen=True)
class ToDraw:
    """What strands (S,) are to be drawn.

    arcs: arc lengths [cm]. kept: of them, from the root, as it will be written. names: numbers that tell them apart.
    cut: which will be cut to length instead of scaled. straight: whose axes are taken to be straight. dropped: arc
    lengths [cm] that are lost at the roots.
    """

    arcs: NDArray[np.float64]
    kept: NDArray[np.float64]
    names: NDArray[np.int64]
    cut: NDArray[np.bool_]
    straight: NDArray[np.bool_]
    dropped: NDArray[np.float64]

    def select(self, chosen: NDArray[np.int64]) -> ToDraw:
        """These of them alone."""
        return ToDraw(
            self.arcs[chosen],
            self.kept[chosen],
            self.names[chosen],
            self.cut[chosen],
            self.straight[chosen],
            self.dropped[chosen],
        )


class Drawn(NamedTuple):
    """Strands (S,): signals (C, 3) by starts (S + 1,), points (P, 3) [cm] in canonical space by offsets (S + 1,).

    sizes: (S, 2), factors of radius and wavelength that settle them; 1 where the texture does not. off: (S,), over 1
    for those that are to be drawn anew.
    """

    values: NDArray[np.float64]
    starts: NDArray[np.int64]
    points: NDArray[np.float64]
    offsets: NDArray[np.int64]
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


def off_by_wander(texture: Texture, wander: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far off strands are (S,), over 1 if they are to be drawn anew, by arc length over chord of their axes."""
    return (wander - 1.0) / FAR_WANDER if texture.stiff else np.zeros(len(wander))


def _drawn(
    texture: Texture, what: ToDraw, seed: int, steps: int, progress: Callable[[int], object] | None, engine: Engine
) -> Drawn:
    """Strands, each drawn once."""
    values, starts = synthesise(texture, what.arcs, what.names, seed, steps, progress, engine)
    points, offsets, wander = canonical_strands(values, starts, what.straight, what.dropped, texture.axis)
    sizes, off = np.ones((len(what.arcs), 2)), off_by_wander(texture, wander)
    if texture.settling is not None:
        sizes, twists = texture.settling.settle(points, offsets, what.kept)
        if texture.settling.twist is not None:
            off = np.abs(twists - texture.settling.twist) / FAR_TWIST
    return Drawn(values, starts, points, offsets, sizes, off)


def _replaced(drawn: Drawn, rows: NDArray[np.int64], others: Drawn, chosen: NDArray[np.int64]) -> Drawn:
    """Strands, these of them replaced by some others of as many cells."""
    values, sizes, off = drawn.values.copy(), drawn.sizes.copy(), drawn.off.copy()
    points = np.split(drawn.points, drawn.offsets[1:-1])
    for row, other in zip(rows, chosen, strict=True):
        values[drawn.starts[row] : drawn.starts[row + 1]] = others.values[
            others.starts[other] : others.starts[other + 1]
        ]
        points[row] = others.points[others.offsets[other] : others.offsets[other + 1]]
    sizes[rows], off[rows] = others.sizes[chosen], others.off[chosen]
    return Drawn(values, drawn.starts, np.concatenate(points), offsets_of([len(p) for p in points]), sizes, off)
