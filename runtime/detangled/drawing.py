"""Strands of a texture in canonical space: synthesised, read where the texture settles, and drawn again if need be.

How often a strand twists cannot be changed once it is drawn. So those that twist far too often, or too seldom, are
drawn anew from other noise, and the nearest is kept.
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

REDRAWN = 2  # times at most
FAR_TWIST = 0.08  # in T_f: a strand further off is drawn anew


@dataclass(frozen=True)
class ToDraw:
    """What strands (S,) are to be drawn.

    arcs: arc lengths [cm]. kept: of them, from the root, as it will be written. names: numbers that tell them apart.
    straight: whose axes are taken to be straight. dropped: arc lengths [cm] that are lost at the roots.
    """

    arcs: NDArray[np.float64]
    kept: NDArray[np.float64]
    names: NDArray[np.int64]
    straight: NDArray[np.bool_]
    dropped: NDArray[np.float64]

    def select(self, chosen: NDArray[np.int64]) -> ToDraw:
        """These of them alone."""
        return ToDraw(
            self.arcs[chosen], self.kept[chosen], self.names[chosen], self.straight[chosen], self.dropped[chosen]
        )


class Drawn(NamedTuple):
    """Strands (S,): signals (C, 3) by starts (S + 1,), points (P, 3) [cm] in canonical space by offsets (S + 1,).

    sizes: (S, 2), factors of radius and wavelength that settle them; 1 where the texture does not.
    """

    values: NDArray[np.float64]
    starts: NDArray[np.int64]
    points: NDArray[np.float64]
    offsets: NDArray[np.int64]
    sizes: NDArray[np.float64]


def draw_strands(
    texture: Texture,
    what: ToDraw,
    seed: int,
    steps: int,
    progress: Callable[[int], object] | None,
    engine: Engine,
) -> Drawn:
    """Draw strands. The same seed gives the same strand of a name, whatever the others. progress: told how many are."""
    drawn, twists = _drawn(texture, what, seed, steps, progress, engine)
    if texture.settling is None or texture.settling.twist is None:
        return drawn
    off = np.abs(twists - texture.settling.twist)
    for attempt in range(1, REDRAWN + 1):
        far = np.flatnonzero(off > FAR_TWIST)
        if len(far) == 0:
            break
        # Streams of their own: beside those of the seed that was given.
        other = int(np.random.SeedSequence(seed, spawn_key=(attempt,)).generate_state(1, np.uint64)[0])
        again, twists = _drawn(texture, what.select(far), other, steps, None, engine)
        now = np.abs(twists - texture.settling.twist)
        nearer = np.flatnonzero(now < off[far])
        drawn = _replaced(drawn, far[nearer], again, nearer)
        off[far[nearer]] = now[nearer]
    return drawn


def _drawn(
    texture: Texture, what: ToDraw, seed: int, steps: int, progress: Callable[[int], object] | None, engine: Engine
) -> tuple[Drawn, NDArray[np.float64]]:
    """Strands, and how often they twist where that is read, (S,)."""
    values, starts = synthesise(texture, what.arcs, what.names, seed, steps, progress, engine)
    points, offsets = canonical_strands(values, starts, what.straight, what.dropped, texture.axis)
    drawn = Drawn(values, starts, points, offsets, np.ones((len(what.arcs), 2)))
    if texture.settling is None:
        return drawn, np.full(len(what.arcs), np.nan)
    sizes, twists = texture.settling.settle(points, offsets, what.kept)
    return drawn._replace(sizes=sizes), twists


def _replaced(drawn: Drawn, rows: NDArray[np.int64], others: Drawn, chosen: NDArray[np.int64]) -> Drawn:
    """Strands, these of them replaced by some others of as many cells."""
    values, sizes = drawn.values.copy(), drawn.sizes.copy()
    points = np.split(drawn.points, drawn.offsets[1:-1])
    for row, other in zip(rows, chosen, strict=True):
        values[drawn.starts[row] : drawn.starts[row + 1]] = others.values[
            others.starts[other] : others.starts[other + 1]
        ]
        points[row] = others.points[others.offsets[other] : others.offsets[other + 1]]
    sizes[rows] = others.sizes[chosen]
    return Drawn(values, drawn.starts, np.concatenate(points), offsets_of([len(p) for p in points]), sizes)
