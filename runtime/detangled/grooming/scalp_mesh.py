"""Places on a head's mesh: where points project to, and the texture coordinates there.

Projection is in space, not in texture coordinates, so scalps over several tiles and meshes without any do alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from detangled.errors import DetangledError
from detangled.head import Head
from detangled.kernels import kernel, parallel_kernel, prange, thread_count

# Faces larger than so many medians are searched by pieces: a few huge ones would widen every search.
LARGE = 3.0
MOST_PIECES = 2_000_000
CLOSEST = 16  # face centres looked at first
SAME_UV = 0.02  # texture coordinates of a groom and of its head that differ by less, in the median, are one set


@dataclass(frozen=True)
class Places:
    """Where points (N,) project to on a mesh: positions (N, 3) [cm], faces (N,), barycentric weights (N, 3)."""

    positions: NDArray[np.float64]
    faces: NDArray[np.int64]
    weights: NDArray[np.float64]

    def uv(self, head: Head) -> NDArray[np.float64] | None:
        """Texture coordinates (N, 2) there, tiles kept; None where the head has none."""
        return None if head.uv is None else np.einsum("nk,nkc->nc", self.weights, head.uv[self.faces])


def places_on(points: NDArray[np.float64], head: Head) -> Places:
    """The nearest places of a head's mesh to points (N, 3) [cm]: exact, whatever the sizes of its faces.

    Raises DetangledError where the head has no faces.
    """
    if len(head.faces) == 0:
        raise DetangledError("the head has no faces: nothing can grow on it")
    owner, corners = _pieces(head)
    centres = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    tree = cKDTree(centres)
    found = np.zeros(len(points), dtype=np.int64)
    todo = np.arange(len(points))
    many = min(CLOSEST, len(centres))
    while len(todo):
        distances, around = tree.query(points[todo], k=[*range(1, many + 1)], workers=thread_count())
        best, gap = _nearest(points[todo], corners, around.astype(np.int64))
        found[todo] = best
        # A face further down the list has its centre at least so far away, and reaches no further than the largest.
        open_ = distances[:, -1] - reach.max() < gap
        if many == len(centres):
            break
        todo = todo[open_]
        many = min(4 * many, len(centres))
    faces = owner[found]
    weights = _feet(points, head.vertices[head.faces[faces]])
    return Places(np.einsum("nk,nkc->nc", weights, head.vertices[head.faces[faces]]), faces, weights)


def _pieces(head: Head) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Faces cut in four until none is large: the face that each is of (M,), and corners (M, 3, 3)."""
    owner, corners = np.arange(len(head.faces)), head.vertices[head.faces]
    size = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    limit = LARGE * np.median(size)
    while True:
        size = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        large = size > limit
        if not large.any() or limit <= 0.0 or len(corners) + 3 * np.count_nonzero(large) > MOST_PIECES:
            return owner, np.ascontiguousarray(corners)
        a, b, c = (corners[large, k] for k in range(3))
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        quarters = [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        corners = np.concatenate([corners[~large], *quarters])
        owner = np.concatenate([owner[~large], np.tile(owner[large], 4)])


@kernel
def _foot(p: NDArray[np.float64], triangle: NDArray[np.float64]) -> tuple[float, float]:
    """Weights of a triangle's second and third corner in its nearest point to p.

    Ericson 2004, "Real-Time Collision Detection", section 5.1.5.
    """
    a = triangle[0]
    ab = triangle[1] - a
    ac = triangle[2] - a
    ap = p - a
    d1 = (ab * ap).sum()
    d2 = (ac * ap).sum()
    v = 0.0
    w = 0.0
    bp = p - triangle[1]
    d3 = (ab * bp).sum()
    d4 = (ac * bp).sum()
    cp = p - triangle[2]
    d5 = (ab * cp).sum()
    d6 = (ac * cp).sum()
    vc = d1 * d4 - d3 * d2
    vb = d5 * d2 - d1 * d6
    va = d3 * d6 - d5 * d4
    if d1 <= 0.0 and d2 <= 0.0:
        v, w = 0.0, 0.0
    elif d3 >= 0.0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v, w = (d1 / (d1 - d3) if d1 > d3 else 0.0), 0.0
    elif d6 >= 0.0 and d5 <= d6:
        v, w = 0.0, 1.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        v, w = 0.0, (d2 / (d2 - d6) if d2 > d6 else 0.0)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        total = (d4 - d3) + (d5 - d6)
        w = (d4 - d3) / total if total > 0.0 else 0.0
        v = 1.0 - w
    else:
        total = va + vb + vc
        v, w = (vb / total, vc / total) if total != 0.0 else (0.0, 0.0)
    return v, w


@parallel_kernel
def _nearest(
    points: NDArray[np.float64], corners: NDArray[np.float64], around: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Which of some triangles (N, k) is nearest to each point (N, 3), and how far it is."""
    best = np.zeros(points.shape[0], dtype=np.int64)
    gap = np.full(points.shape[0], np.inf)
    for i in prange(points.shape[0]):
        for j in range(around.shape[1]):
            triangle = corners[around[i, j]]
            v, w = _foot(points[i], triangle)
            d2 = 0.0
            for c in range(3):
                d2 += ((1.0 - v - w) * triangle[0, c] + v * triangle[1, c] + w * triangle[2, c] - points[i, c]) ** 2
            d = np.sqrt(d2)
            if d < gap[i]:
                gap[i] = d
                best[i] = around[i, j]
    return best, gap


@parallel_kernel
def _feet(points: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Barycentric weights (N, 3) of the nearest points of triangles (N, 3, 3) to points (N, 3)."""
    out = np.empty((points.shape[0], 3))
    for i in prange(points.shape[0]):
        v, w = _foot(points[i], corners[i])
        out[i, 0] = 1.0 - v - w
        out[i, 1] = v
        out[i, 2] = w
    return out
