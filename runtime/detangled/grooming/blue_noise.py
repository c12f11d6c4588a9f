"""Blue noise: of many candidates those are kept that lie well apart.

Weighted sample elimination (Yuksel 2015, "Sample Elimination for Generating Poisson Disk Sample Sets"): the candidate
most crowded by its neighbours goes, until as many are left as are wanted. Each point has a radius of its own, so that
a density that varies is kept; some points may be fixed, and crowd the others only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from detangled.kernels import kernel, thread_count

CANDIDATES = 5  # for each point that is wanted: the paper's choice
CROWDING = 24  # nearest neighbours that count; at five candidates a point about 18 lie within twice the radius
EXPONENT = 8.0  # the paper's alpha


def spread_out(
    points: NDArray[np.float64], radii: NDArray[np.float64], count: int, fixed: NDArray[np.bool_] | None = None
) -> NDArray[np.int64]:
    """Indices, increasing, of ``count`` points (N, 3) that lie well apart, beside the fixed ones (N,), not returned.

    radii: (N,) [cm], half the distance that points should have there. No randomness: the order of points decides ties.
    """
    held = np.zeros(len(points), dtype=np.bool_) if fixed is None else np.asarray(fixed, dtype=np.bool_)
    free = np.flatnonzero(~held)
    count = max(count, 0)
    if count >= len(free):
        return free
    if count == 0:
        return free[:0]
    tree = cKDTree(points)
    apart, around = tree.query(points, k=min(CROWDING + 1, len(points)), workers=thread_count())
    share = apart / np.maximum(radii[:, None] + radii[around], 1e-300)
    one, place = np.nonzero((share < 1.0) & (around != np.arange(len(points))[:, None]))
    other, weight = around[one, place], (1.0 - share[one, place]) ** EXPONENT
    free_pair = ~(held[one] & held[other])
    one, other, weight = one[free_pair], other[free_pair], weight[free_pair]
    # Each pair once, whichever of the two has the other among its nearest.
    pairs = np.minimum(one, other) * len(points) + np.maximum(one, other)
    order = np.argsort(pairs, kind="stable")
    once = order[np.diff(pairs[order], prepend=-1) > 0]
    one, other, weight = one[once], other[once], weight[once]
    ends = np.concatenate([one, other])
    order = np.argsort(ends, kind="stable")
    starts = np.searchsorted(ends[order], np.arange(len(points) + 1))
    gone = _eliminated(
        starts, np.concatenate([other, one])[order], np.concatenate([weight, weight])[order], held, len(free) - count
    )
    return np.flatnonzero(~gone & ~held)


@kernel
def _sift(heap: NDArray[np.int64], place: NDArray[np.int64], crowd: NDArray[np.float64], at: int, size: int) -> None:
    """Move an item down a heap, most crowded first, to where it belongs."""
    item = heap[at]
    while True:
        child = 2 * at + 1
        if child >= size:
            break
        if child + 1 < size and crowd[heap[child + 1]] > crowd[heap[child]]:
            child += 1
        if crowd[heap[child]] <= crowd[item]:
            break
        heap[at] = heap[child]
        place[heap[at]] = at
        at = child
    heap[at] = item
    place[item] = at


@kernel
def _eliminated(
    starts: NDArray[np.int64],
    around: NDArray[np.int64],
    weight: NDArray[np.float64],
    held: NDArray[np.bool_],
    surplus: int,
) -> NDArray[np.bool_]:
    """Which points (N,) go: the ``surplus`` most crowded, one after another, those that are held apart."""
    n = held.shape[0]
    crowd = np.zeros(n)
    for i in range(n):
        for e in range(starts[i], starts[i + 1]):
            crowd[i] += weight[e]
    heap = np.flatnonzero(~held)
    size = heap.shape[0]
    place = np.full(n, -1, dtype=np.int64)
    for k in range(size):
        place[heap[k]] = k
    for k in range(size // 2 - 1, -1, -1):
        _sift(heap, place, crowd, k, size)
    gone = np.zeros(n, dtype=np.bool_)
    for _ in range(surplus):
        worst = heap[0]
        gone[worst] = True
        place[worst] = -1
        size -= 1
        if size > 0:
            heap[0] = heap[size]
            _sift(heap, place, crowd, 0, size)
        for e in range(starts[worst], starts[worst + 1]):
            near = around[e]
            if place[near] >= 0:
                crowd[near] -= weight[e]
                _sift(heap, place, crowd, place[near], size)
    return gone
