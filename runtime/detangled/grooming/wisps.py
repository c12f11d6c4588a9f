"""Wisps: which hairs go together, how far from their guide, and which of them in tufts.

Each hair belongs to the wisp of one guide, and in it to a tuft, and in that to a smaller one; the hairs in the middle
of tufts lead them. Some hairs, the flyaways, belong nowhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import parallel_kernel, prange

LEVELS = 2  # of tufts: of a wisp, and of its tufts
FEWEST_IN_TUFT = 4  # hairs: fewer do not part again
LEAST_RANK = 0.05  # the innermost hair is not quite its guide


@dataclass(frozen=True)
class Wisps:
    """What each hair (N,) belongs to.

    guide: the guide of its wisp. rank: how far out it lies in its wisp, from 0 in the middle to 1 at the rim.
    flyaway: whether it leaves the wisp. leaders: (N, LEVELS), the hair in the middle of its tuft, the larger tuft
    first; itself where there is none.
    """

    guide: NDArray[np.int64]
    rank: NDArray[np.float64]
    flyaway: NDArray[np.bool_]
    leaders: NDArray[np.int64]


def wisps_of(
    guide: NDArray[np.int64],
    roots: NDArray[np.float64],
    middles: NDArray[np.float64],
    tufts: int,
    flyaways: float,
    rng: np.random.Generator,
) -> Wisps:
    """Gather hairs into the wisps of their guides (N,), by their roots (N, 3) [cm] around those of the guides (G, 3).

    tufts: in a wisp, and in each tuft again; fewer than 2 for none. flyaways: share of the hairs, exact but for half
    a hair.
    """
    count = len(guide)
    away = np.linalg.norm(roots - middles[guide], axis=1)
    widest = np.zeros(len(middles))
    np.maximum.at(widest, guide, away)
    rank = np.clip(away / np.maximum(widest[guide], 1e-12), LEAST_RANK, 1.0)
    flyaway = np.zeros(count, dtype=np.bool_)
    flyaway[rng.permutation(count)[: round(flyaways * count)]] = True
    leaders = np.repeat(np.arange(count)[:, None], LEVELS, axis=1)
    if tufts >= 2:
        # Flyaways are in no tuft, and so each in a group of its own.
        group = np.where(flyaway, len(middles) + np.arange(count), guide)
        for level in range(LEVELS):
            leaders[:, level] = _leaders(group, roots, tufts)
            group = leaders[:, level]
    return Wisps(guide, rank, flyaway, leaders)


def _leaders(group: NDArray[np.int64], roots: NDArray[np.float64], tufts: int) -> NDArray[np.int64]:
    """The hair (N,) that leads each hair's tuft, of ``tufts`` in a group."""
    order = np.argsort(group, kind="stable")
    starts = np.flatnonzero(np.diff(group[order], prepend=-1, append=-1))
    leader = np.empty(len(group), dtype=np.int64)
    leader[order] = order[_spread_leaders(roots[order], starts, tufts)]
    return leader


@parallel_kernel
def _spread_leaders(roots: NDArray[np.float64], starts: NDArray[np.int64], tufts: int) -> NDArray[np.int64]:
    """Leaders (N,) of sorted hairs: in each group those furthest apart (Gonzalez 1985), each of its nearest hairs."""
    leader = np.arange(roots.shape[0])
    for g in prange(starts.shape[0] - 1):
        first = starts[g]
        size = starts[g + 1] - first
        many = min(tufts, size // FEWEST_IN_TUFT)
        if many < 2:
            continue
        gap = np.full(size, np.inf)
        chosen = 0
        for _ in range(many):
            for i in range(size):
                d = 0.0
                for c in range(3):
                    d += (roots[first + i, c] - roots[first + chosen, c]) ** 2
                if d < gap[i]:
                    gap[i] = d
                    leader[first + i] = first + chosen
            chosen = int(np.argmax(gap))
    return leader
