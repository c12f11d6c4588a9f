"""The guides that each strand is interpolated from, for Unreal: the three with the nearest roots."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from detangled.groom import Groom

GUIDES_A_STRAND = 3
# A strand whose root is its guide's follows it alone; distances below this share of the groom's size are none.
NO_DISTANCE = 1e-9


def closest_guides(
    groom: Groom, guide: NDArray[np.bool_], groups: NDArray[np.int64], ids: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Ids (S, 3) of the nearest guides by root within each strand's group, and their weights (S, 3), sum 1.

    guide: (S,), which strands are guides. Weights fall with the distance; where a group has fewer than three guides
    the nearest stands in with no weight, and where it has none the id is -1.
    """
    roots = groom.points[groom.offsets[:-1]]
    closest = np.full((groom.strand_count, GUIDES_A_STRAND), -1, dtype=np.int32)
    weights = np.zeros((groom.strand_count, GUIDES_A_STRAND), dtype=np.float32)
    least = NO_DISTANCE * max(float(np.ptp(roots, axis=0).max()), 1e-300)
    for group in np.unique(groups):
        members = np.flatnonzero(groups == group)
        guides = members[guide[members]]
        if len(guides) == 0:
            continue
        count = min(GUIDES_A_STRAND, len(guides))
        distances, found = cKDTree(roots[guides]).query(roots[members], k=np.arange(1, count + 1))
        near = 1.0 / np.maximum(distances, least)
        closest[members] = ids[guides[found[:, :1]]]
        closest[members, :count] = ids[guides[found]]
        weights[members, :count] = near / near.sum(axis=1, keepdims=True)
    return closest, weights
