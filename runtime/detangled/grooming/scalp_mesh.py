"""Places on a head's mesh: where points project to, and the texture coordinates there.

Projection is in space, not in texture coordinates, so scalps over several tiles and meshes without any do alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from detangled.errors import DetangledError
from detangled.geometry.triangles import nearest_on_triangle
from detangled.head import Head
from detangled.kernels import parallel_kernel, prange, thread_count

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
        best, gap = _nearest(points[todo], corners.reshape(-1, 9), around.astype(np.int64))
        found[todo] = best
        # A face further down the list has its centre at least so far away, and reaches no further than the largest.
        open_ = distances[:, -1] - reach.max() < gap
        if many == len(centres):
            break
        todo = todo[open_]
        many = min(4 * many, len(centres))
    faces = owner[found]
    corners = head.vertices[head.faces[faces]]
    weights = _feet(points, corners.reshape(-1, 9))
    return Places(np.einsum("nk,nkc->nc", weights, corners), faces, weights)


def _pieces(head: Head) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Faces cut in four until none is large: the face that each is of (M,), and corners (M, 3, 3)."""
    owner, corners = np.arange(len(head.faces)), head.vertices[head.faces]
    size = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    limit = LARGE * np.median(size)
    while True:
        size = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        large = size > limit
        if not large.any() or limit <= 0.0 or len(corners) + 3 * np.count_nonzero(large) > MOST_PIECES:
            return owner, corners
        a, b, c = (corners[large, k] for k in range(3))
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        quarters = [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        corners = np.concatenate([corners[~large], *quarters])
        owner = np.concatenate([owner[~large], np.tile(owner[large], 4)])


@parallel_kernel
def _nearest(
    points: NDArray[np.float64], corners: NDArray[np.float64], around: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Which of some triangles (N, k), of corners (M, 9), is nearest to each point (N, 3), and how far it is."""
    best = np.zeros(points.shape[0], dtype=np.int64)
    gap = np.full(points.shape[0], np.inf)
    for i in prange(points.shape[0]):
        for j in range(around.shape[1]):
            d2, _, _ = nearest_on_triangle(points[i, 0], points[i, 1], points[i, 2], corners[around[i, j]])
            if d2 < gap[i]:
                gap[i] = d2
                best[i] = around[i, j]
    return best, np.sqrt(gap)


@parallel_kernel
def _feet(points: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Barycentric weights (N, 3) of the nearest points of triangles (N, 9) to points (N, 3)."""
    out = np.empty((points.shape[0], 3))
    for i in prange(points.shape[0]):
        _, v, w = nearest_on_triangle(points[i, 0], points[i, 1], points[i, 2], corners[i])
        out[i, 0] = 1.0 - v - w
        out[i, 1] = v
        out[i, 2] = w
    return out
