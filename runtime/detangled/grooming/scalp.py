"""Scalp: the surface that a groom's roots span, and how densely they lie on it.

Roots are triangulated in their tangent planes: each is joined to its Delaunay neighbours there, and a triangle counts
where two of its three corners agree on it (after Freedman 2002, "Efficient simplicial reconstructions of manifolds
from their samples"). So the surface needs no head and no texture coordinates, and has neither their seams nor their
stretch; where there is no hair, a bald patch or an ear, there is no triangle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from detangled.kernels import kernel, parallel_kernel, prange, thread_count

NEIGHBOURS = 24  # of a root, among which its triangles are looked for; a Delaunay star has six, in the mean
NEIGHBOURS_FOR_NORMAL = 12
TYPICAL_OF = 6  # nearest roots, whose mean distance is a root's spacing
# An edge so many spacings long spans a place without hair: between blue-noise roots none is longer than about 2, and
# roots strewn at random leave gaps of 3.
LONGEST_EDGE = 3.5
SAME_ROOT = 1e-5  # [cm]: nearer roots are one place
AGREEING = 2  # of the corners of a triangle
# Circles that touch their six neighbours cover this share of the plane.
HEXAGONAL = np.pi / (2.0 * np.sqrt(3.0))


@dataclass(frozen=True)
class Scalp:
    """Roots and the triangles between them.

    roots: (S, 3) [cm], of all strands. normals: (S, 3), unit, of either sign. triangles: (T, 3) int64, indices of
    strands. areas: (T,) [cm^2]. mass: (T,), how many roots belong to each triangle: a root is shared out among its
    triangles by their areas. nearest: (S,), [cm] mean distance to the nearest six roots.
    """

    roots: NDArray[np.float64]
    normals: NDArray[np.float64]
    triangles: NDArray[np.int64]
    areas: NDArray[np.float64]
    mass: NDArray[np.float64]
    nearest: NDArray[np.float64]

    def area_per_root(self) -> NDArray[np.float64]:
        """Surface (S,) [cm^2] that belongs to each root, smoothed over its neighbours; NaN for one in no triangle."""
        count = len(self.roots)
        corners = self.triangles.ravel()
        own = np.bincount(corners, np.repeat(self.areas / 3.0, 3), count)
        joined = np.bincount(corners, minlength=count)
        around = np.bincount(corners, np.repeat(own[self.triangles].mean(axis=1), 3), count)
        with np.errstate(invalid="ignore"):
            return np.where(joined > 0, around / joined, np.nan)

    def packing_radius(self) -> NDArray[np.float64]:
        """Radius (S,) [cm] of the circle that a root has to itself, hexagonally packed: half of their distance."""
        area = self.area_per_root()
        # A root in no triangle has only its distance to others, or nothing, to go by.
        return np.where(np.isfinite(area), np.sqrt(HEXAGONAL * area / np.pi), 0.5 * self.nearest)

    def at(self, triangle: NDArray[np.int64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (N, 3) [cm] in triangles (N,) at barycentric weights (N, 3), on the curved surface.

        Phong tessellation (Boubekeur and Alexa 2008): flat points drawn towards the corners' tangent planes.
        """
        corners = self.triangles[triangle]
        flat = np.einsum("nk,nkc->nc", weights, self.roots[corners])
        normals = self.normals[corners]
        off = np.einsum("nkc,nkc->nk", self.roots[corners] - flat[:, None], normals)
        return flat + PHONG * np.einsum("nk,nk,nkc->nc", weights, off, normals)


PHONG = 0.75  # the authors' choice


def scalp_of(roots: NDArray[np.float64]) -> Scalp:
    """The surface that roots (S, 3) [cm] span; without triangles where fewer than three are distinct, or all in a line.

    Roots at one place count as one, the first of them.
    """
    roots = np.ascontiguousarray(roots, dtype=np.float64)
    _, first = np.unique(np.round(roots / SAME_ROOT), axis=0, return_index=True)
    first = np.sort(first)
    distinct = roots[first]
    normals = np.tile([0.0, 0.0, 1.0], (len(roots), 1))
    nearest = np.zeros(len(roots))
    none = Scalp(roots, normals, np.zeros((0, 3), dtype=np.int64), np.zeros(0), np.zeros(0), nearest)
    if len(distinct) < 2:
        return none
    tree = cKDTree(distinct)
    distances, around = tree.query(distinct, k=min(NEIGHBOURS + 1, len(distinct)), workers=thread_count())
    spacing = distances[:, 1 : TYPICAL_OF + 1].mean(axis=1)
    found = _normals(distinct[around[:, : NEIGHBOURS_FOR_NORMAL + 1]])
    _, same = tree.query(roots, workers=thread_count())
    normals, nearest = found[same], spacing[same]
    if len(distinct) < 3:
        return Scalp(roots, normals, none.triangles, none.areas, none.mass, nearest)
    stars = _stars(distinct, found, around.astype(np.int64), spacing)
    triangles = np.sort(stars[stars[:, 0] >= 0], axis=1)
    if len(triangles):
        triangles, agreed = np.unique(triangles, axis=0, return_counts=True)
        triangles = triangles[agreed >= min(AGREEING, len(distinct) - 1)]
    corners = distinct[triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = 0.5 * np.linalg.norm(cross, axis=1)
    triangles, areas = triangles[areas > 0.0], areas[areas > 0.0]
    total = np.bincount(triangles.ravel(), np.repeat(areas, 3), len(distinct))
    with np.errstate(invalid="ignore", divide="ignore"):
        mass = (areas[:, None] / total[triangles]).sum(axis=1)
    return Scalp(roots, normals, first[triangles], areas, mass, nearest)


def _normals(patches: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit normals (R, 3) of patches of points (R, k, 3): the direction in which each is thinnest."""
    centred = patches - patches.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("rki,rkj->rij", centred, centred))
    return np.ascontiguousarray(vectors[:, :, 0])


@kernel
def _chart(normal: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two unit vectors (3,) that span the plane across a unit normal (3,)."""
    least = 0
    for c in range(1, 3):
        if abs(normal[c]) < abs(normal[least]):
            least = c
    x = -normal * normal[least]
    x[least] += 1.0
    x /= np.sqrt((x * x).sum())
    y = np.empty(3)
    y[0] = normal[1] * x[2] - normal[2] * x[1]
    y[1] = normal[2] * x[0] - normal[0] * x[2]
    y[2] = normal[0] * x[1] - normal[1] * x[0]
    return x, y


@kernel
def _turn(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> float:
    """Twice the signed area of a triangle in the plane."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@kernel
def hull(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Corners of the convex hull of points (n, 2), counter-clockwise (Andrew 1979)."""
    n = points.shape[0]
    order = np.argsort(points[:, 0], kind="mergesort")
    # Equal x by y: few, so a pass of insertion is enough.
    for i in range(1, n):
        j = i
        while (
            j > 0 and points[order[j], 0] == points[order[j - 1], 0] and points[order[j], 1] < points[order[j - 1], 1]
        ):
            order[j], order[j - 1] = order[j - 1], order[j]
            j -= 1
    out = np.empty(2 * n + 1, dtype=np.int64)
    size = 0
    for i in range(n):
        while size >= 2 and _turn(points[out[size - 2]], points[out[size - 1]], points[order[i]]) <= 0.0:
            size -= 1
        out[size] = order[i]
        size += 1
    lower = size + 1
    for i in range(n - 2, -1, -1):
        while size >= lower and _turn(points[out[size - 2]], points[out[size - 1]], points[order[i]]) <= 0.0:
            size -= 1
        out[size] = order[i]
        size += 1
    return out[: max(size - 1, 1)].copy()


@parallel_kernel
def _stars(
    roots: NDArray[np.float64],
    normals: NDArray[np.float64],
    around: NDArray[np.int64],
    spacing: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Delaunay triangles of each root in its tangent plane, (R * k, 3); rows that are not used hold -1.

    Circles through a root are lines once the plane is inverted about it, so its Delaunay triangles are the edges of
    the hull of the inverted neighbours.
    """
    count, k = around.shape
    out = np.full((count * k, 3), -1, dtype=np.int64)
    for r in prange(count):
        x, y = _chart(normals[r])
        flat = np.empty((k, 2))
        inverted = np.empty((k, 2))
        names = np.empty(k, dtype=np.int64)
        n = 0
        for j in range(k):
            other = around[r, j]
            if other == r:
                continue
            step = roots[other] - roots[r]
            u = (step * x).sum()
            v = (step * y).sum()
            size2 = u * u + v * v
            # A root straight above another has no place in its plane.
            if size2 < 0.01 * (step * step).sum():
                continue
            flat[n, 0] = u
            flat[n, 1] = v
            inverted[n, 0] = u / size2
            inverted[n, 1] = v / size2
            names[n] = other
            n += 1
        if n < 2:
            continue
        corners = hull(inverted[:n])
        m = corners.shape[0]
        if m < 2:
            continue
        zero = np.zeros(2)
        for i in range(m if m > 2 else 1):
            a = corners[i]
            b = corners[(i + 1) % m]
            # Seen from outside the hull an edge is no triangle: the root lies on the rim there.
            if m > 2 and _turn(zero, inverted[a], inverted[b]) <= 0.0:
                continue
            longest = LONGEST_EDGE * max(spacing[r], spacing[names[a]], spacing[names[b]])
            ab = np.sqrt(((roots[names[a]] - roots[names[b]]) ** 2).sum())
            ra = np.sqrt(((roots[names[a]] - roots[r]) ** 2).sum())
            rb = np.sqrt(((roots[names[b]] - roots[r]) ** 2).sum())
            if max(ab, ra, rb) > longest:
                continue
            if abs(_turn(zero, flat[a], flat[b])) < 1e-9 * longest * longest:
                continue
            out[r * k + i, 0] = r
            out[r * k + i, 1] = names[a]
            out[r * k + i, 2] = names[b]
    return out
