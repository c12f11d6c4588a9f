"""Signed distance from a head, on a grid that is made once and read many millions of times.

Near the surface each node holds its distance from the nearest triangle; further out, the least from the triangles that
are nearest to the nodes of that band nearest to it and to the nodes around it, which may be a tenth too large beside
edges. The sign is that of the generalised winding number.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

from detangled.errors import ReadError
from detangled.geometry.inputs import compiled_input
from detangled.geometry.triangles import distance2_to_triangle
from detangled.grooming.head_inside import INSIDE, WindingTree, winding_number, winding_tree
from detangled.head import Head
from detangled.kernels import kernel, parallel_kernel, prange

FINEST_STEP = 0.12  # [cm] finer than most triangles of a head: nothing would be gained
MOST_NODES = 8_000_000  # a head at 0.16 cm; 32 MB, and a few seconds to fill
MARGIN = 1.0  # [cm] around what is covered
BAND = 2  # nodes beside each triangle that are given exact distances
AROUND = 2  # nodes away: whose triangles are tried too, further out
BLOCK = 8  # nodes a side whose sign is found at once where there is no surface, else in smaller blocks
SURE = 0.2  # of winding number: a block that differs by more from INSIDE is in or out as a whole
FAR_OFF = 1e3  # [cm] where there is no surface at all


class HeadDistance(NamedTuple):
    """Signed distances from a head [cm], negative inside.

    values: (X, Y, Z) float32 [cm], at origin + step * index. origin: (3,) [cm]. step: [cm].
    """

    values: NDArray[np.float32]
    origin: NDArray[np.float64]
    step: float

    def at(self, points: ArrayLike) -> NDArray[np.float64]:
        """Distances (P,) [cm] of points (P, 3) [cm] from the head, negative inside."""
        return _distances(self, compiled_input(points, np.float64))

    def with_gradient(self, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Distances (P,) [cm] of points (P, 3) [cm], and the directions (P, 3) in which they grow, not normalised."""
        return _gradients(self, compiled_input(points, np.float64))


def head_distance(head: Head, around: ArrayLike | None = None, finest: float = FINEST_STEP) -> HeadDistance:
    """Fill the grid of a head, its nodes no closer than ``finest`` [cm], further apart where it is large.

    around: (N, 3) [cm], points whose box is all that need be covered, as the hair on a whole body; None for the
    whole head. Beyond the grid, distances are those at its border and the way there, on the outside.
    Raises ReadError where the head has no faces.
    """
    if len(head.faces) == 0:
        raise ReadError("the head has no faces: nothing can be inside or outside of it")
    used = head.vertices[head.faces].reshape(-1, 3)
    low, high = used.min(axis=0), used.max(axis=0)
    if around is not None:
        points = np.asarray(around, dtype=np.float64).reshape(-1, 3)
        points = points[np.isfinite(points).all(axis=1)]
        if len(points):
            # A box beside the head keeps a corner of it: there is always a grid.
            low = np.minimum(np.maximum(low, points.min(axis=0)), high)
            high = np.maximum(np.minimum(high, points.max(axis=0)), low)
    low, high = low - MARGIN, high + MARGIN
    step = max(finest, float(np.cbrt(np.prod(high - low) / MOST_NODES)))
    shape = np.ceil((high - low) / step).astype(np.int64) + 1
    tree = winding_tree(head)
    near, nearest = _band(tree.corners, *_by_plane(tree.corners, low, step, int(shape[0])), low, step, shape)
    if (nearest < 0).all():
        return HeadDistance(np.full(shape, FAR_OFF, dtype=np.float32), low, step)
    if (nearest < 0).any():
        sources = distance_transform_edt(nearest < 0, return_distances=False, return_indices=True)
        _fill_far(tree.corners, sources, nearest, near, low, step)
    return HeadDistance(np.where(_inside(tree, near, low, step), -near, near), low, step)


def exact_distances(tree: WindingTree, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Signed distances (P,) [cm] of points (P, 3) from all triangles, one by one: what the grid is measured by."""
    return _exact(tree, np.ascontiguousarray(points, dtype=np.float64))


@kernel
def distance_at(head: HeadDistance, x: float, y: float, z: float) -> float:
    """Distance [cm] of one point [cm], trilinear between nodes."""
    return distance_and_gradient(head, x, y, z)[0]


@kernel
def distance_and_gradient(head: HeadDistance, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Distance [cm] of one point [cm] and its gradient (3), of the trilinear interpolant."""
    values, origin, step = head
    nx, ny, nz = values.shape
    gx, gy, gz = (x - origin[0]) / step, (y - origin[1]) / step, (z - origin[2]) / step
    cx, cy, cz = min(max(gx, 0.0), nx - 1.0), min(max(gy, 0.0), ny - 1.0), min(max(gz, 0.0), nz - 1.0)
    i, j, k = min(int(cx), nx - 2), min(int(cy), ny - 2), min(int(cz), nz - 2)
    u, v, w = cx - i, cy - j, cz - k
    a, b = values[i, j, k], values[i, j, k + 1]
    c, d = values[i, j + 1, k], values[i, j + 1, k + 1]
    e, f = values[i + 1, j, k], values[i + 1, j, k + 1]
    g, h = values[i + 1, j + 1, k], values[i + 1, j + 1, k + 1]
    ab, cd, ef, gh = a + w * (b - a), c + w * (d - c), e + w * (f - e), g + w * (h - g)
    low, high = ab + v * (cd - ab), ef + v * (gh - ef)
    distance = low + u * (high - low)
    dx = (high - low) / step
    dy = ((cd - ab) * (1.0 - u) + (gh - ef) * u) / step
    dz = (((b - a) * (1.0 - v) + (d - c) * v) * (1.0 - u) + ((f - e) * (1.0 - v) + (h - g) * v) * u) / step
    ox, oy, oz = (gx - cx) * step, (gy - cy) * step, (gz - cz) * step
    beyond = np.sqrt(ox * ox + oy * oy + oz * oz)
    if beyond > 0.0:
        return max(distance, 0.0) + beyond, ox / beyond, oy / beyond, oz / beyond
    return distance, dx, dy, dz


@parallel_kernel
def _distances(head: HeadDistance, points: NDArray[np.float64]) -> NDArray[np.float64]:
    out = np.empty(points.shape[0])
    for p in prange(points.shape[0]):
        out[p] = distance_at(head, points[p, 0], points[p, 1], points[p, 2])
    return out


@parallel_kernel
def _gradients(head: HeadDistance, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    out = np.empty(points.shape[0])
    gradient = np.empty((points.shape[0], 3))
    for p in prange(points.shape[0]):
        out[p], gradient[p, 0], gradient[p, 1], gradient[p, 2] = distance_and_gradient(
            head, points[p, 0], points[p, 1], points[p, 2]
        )
    return out, gradient


def _by_plane(
    corners: NDArray[np.float64], origin: NDArray[np.float64], step: float, planes: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangles by the planes of nodes that they are near to: those of plane i are listed[starts[i]:starts[i + 1]]."""
    x = (corners[:, 0::3] - origin[0]) / step
    first = np.clip(np.floor(x.min(axis=1)).astype(np.int64) - BAND, 0, planes)
    last = np.clip(np.ceil(x.max(axis=1)).astype(np.int64) + BAND + 1, 0, planes)
    counts = np.maximum(last - first, 0)
    begin = np.cumsum(counts) - counts
    triangle = np.repeat(np.arange(len(corners)), counts)
    plane = np.arange(int(counts.sum())) - np.repeat(begin - first, counts)
    starts = np.concatenate([[0], np.cumsum(np.bincount(plane, minlength=planes))]).astype(np.int64)
    return triangle[np.argsort(plane, kind="stable")], starts


@parallel_kernel
def _band(
    corners: NDArray[np.float64],
    listed: NDArray[np.int64],
    starts: NDArray[np.int64],
    origin: NDArray[np.float64],
    step: float,
    shape: NDArray[np.int64],
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Distances of the nodes near triangles, and which triangle is the nearest; inf and -1 for other nodes."""
    near = np.full((shape[0], shape[1], shape[2]), np.float32(np.inf))
    nearest = np.full((shape[0], shape[1], shape[2]), np.int32(-1))
    for i in prange(shape[0]):
        x = origin[0] + i * step
        # Nodes further off have been near to some triangles and not to others.
        best = np.full((shape[1], shape[2]), (BAND * step) ** 2)
        for n in range(starts[i], starts[i + 1]):
            t = corners[listed[n]]
            low_y, high_y = min(t[1], t[4], t[7]) - origin[1], max(t[1], t[4], t[7]) - origin[1]
            low_z, high_z = min(t[2], t[5], t[8]) - origin[2], max(t[2], t[5], t[8]) - origin[2]
            first_j = max(int(np.floor(low_y / step)) - BAND, 0)
            last_j = min(int(np.ceil(high_y / step)) + BAND + 1, shape[1])
            first_k = max(int(np.floor(low_z / step)) - BAND, 0)
            last_k = min(int(np.ceil(high_z / step)) + BAND + 1, shape[2])
            for j in range(first_j, last_j):
                for k in range(first_k, last_k):
                    d2 = distance2_to_triangle(x, origin[1] + j * step, origin[2] + k * step, t)
                    if d2 < best[j, k]:
                        best[j, k] = d2
                        nearest[i, j, k] = listed[n]
        for j in range(shape[1]):
            for k in range(shape[2]):
                if nearest[i, j, k] >= 0:
                    near[i, j, k] = np.sqrt(best[j, k])
    return near, nearest


@parallel_kernel
def _fill_far(
    corners: NDArray[np.float64],
    sources: NDArray[np.int32],
    nearest: NDArray[np.int32],
    near: NDArray[np.float32],
    origin: NDArray[np.float64],
    step: float,
) -> None:
    """Give the nodes without a triangle the distance from those of the nodes nearest to them. Fills ``near``."""
    nx, ny, nz = near.shape
    for plane in prange(nx):
        i = np.int64(plane)
        for j in range(ny):
            for k in range(nz):
                if nearest[i, j, k] >= 0:
                    continue
                x, y, z = origin[0] + i * step, origin[1] + j * step, origin[2] + k * step
                best = np.inf
                last = -1
                for n in range(7):
                    side = AROUND * (2 * (n % 2) - 1)
                    a = min(max(i + side, 0), nx - 1) if n // 2 == 0 and n < 6 else i
                    b = min(max(j + side, 0), ny - 1) if n // 2 == 1 else j
                    c = min(max(k + side, 0), nz - 1) if n // 2 == 2 else k
                    triangle = nearest[sources[0, a, b, c], sources[1, a, b, c], sources[2, a, b, c]]
                    if triangle != last:
                        best = min(best, distance2_to_triangle(x, y, z, corners[triangle]))
                    last = triangle
                near[i, j, k] = np.sqrt(best)


@parallel_kernel
def _inside(
    tree: WindingTree,
    near: NDArray[np.float32],
    origin: NDArray[np.float64],
    step: float,
) -> NDArray[np.bool_]:
    """Which nodes are inside: a block without any surface (``near``) by its middle, others by their halves."""
    inside = np.zeros(near.shape, dtype=np.bool_)
    nx, ny, nz = near.shape
    across, deep = (ny + BLOCK - 1) // BLOCK, (nz + BLOCK - 1) // BLOCK
    for slab in prange((nx + BLOCK - 1) // BLOCK):
        # Blocks to do: where each begins, and its nodes a side. No more wait at once than eight a halving.
        waiting = np.empty((across * deep + 64, 4), dtype=np.int64)
        count = 0
        for b in range(across):
            for c in range(deep):
                waiting[count, 0], waiting[count, 1], waiting[count, 2] = slab * BLOCK, b * BLOCK, c * BLOCK
                waiting[count, 3] = BLOCK
                count += 1
        while count > 0:
            count -= 1
            i, j, k, size = waiting[count, 0], waiting[count, 1], waiting[count, 2], waiting[count, 3]
            if i >= nx or j >= ny or k >= nz:
                continue
            half = 0.5 * (size - 1)
            a, b, c = min(i + size // 2, nx - 1), min(j + size // 2, ny - 1), min(k + size // 2, nz - 1)
            # From the node by the block's middle to its furthest corner.
            if size == 1 or near[a, b, c] > np.sqrt(3.0) * (size // 2) * step:
                x, y, z = origin[0] + (i + half) * step, origin[1] + (j + half) * step, origin[2] + (k + half) * step
                w = winding_number(tree, x, y, z)
                if size == 1 or abs(w - INSIDE) > SURE:
                    inside[i : i + size, j : j + size, k : k + size] = w > INSIDE
                    continue
            size //= 2
            for corner in range(8):
                waiting[count, 0] = i + size * (corner & 1)
                waiting[count, 1] = j + size * ((corner >> 1) & 1)
                waiting[count, 2] = k + size * (corner >> 2)
                waiting[count, 3] = size
                count += 1
    return inside


@parallel_kernel
def _exact(tree: WindingTree, points: NDArray[np.float64]) -> NDArray[np.float64]:
    out = np.empty(points.shape[0])
    for p in prange(points.shape[0]):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        best = np.inf
        for f in range(tree.corners.shape[0]):
            best = min(best, distance2_to_triangle(x, y, z, tree.corners[f]))
        inside = winding_number(tree, x, y, z) > INSIDE
        out[p] = -np.sqrt(best) if inside else np.sqrt(best)
    return out
