"""Which points are inside a head: its generalised winding number, also where the mesh is open or not a manifold.

Jacobson, Kavan and Sorkine-Hornung (2013), "Robust inside-outside segmentation using generalized winding numbers":
the solid angle of all triangles, over the whole sphere. Triangles far off count as one dipole, after Barill, Dickson,
Schmidt, Levin and Jacobson (2018), "Fast winding numbers for soups and clouds".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from detangled.geometry.triangles import solid_angle
from detangled.head import Head
from detangled.kernels import kernel, parallel_kernel, prange

INSIDE = 0.5  # winding number: 1 within, 0 without, between where the mesh is open
LEAF = 8  # triangles summed up one by one
FAR = 2.5  # of a node's radius: from there on it is a dipole
DEEPEST = 64  # nodes on the stack: more than twice the levels of any mesh's tree


class WindingTree(NamedTuple):
    """Triangles in an order in which neighbours are near, and a balanced binary tree over them.

    corners: (F, 9) [cm]. levels: of the tree; node n (from 1) has the children 2 n and 2 n + 1. centres: (N, 3) [cm],
    radii: (N,) [cm], dipoles: (N, 3) [cm2], the area vectors of each node's triangles added up.
    """

    corners: NDArray[np.float64]
    levels: int
    centres: NDArray[np.float64]
    radii: NDArray[np.float64]
    dipoles: NDArray[np.float64]


def winding_tree(head: Head) -> WindingTree:
    """The tree of a head's triangles."""
    corners = head.vertices[head.faces].reshape(-1, 9)
    corners = np.ascontiguousarray(corners[np.argsort(_morton(corners), kind="stable")])
    levels = max(0, int(np.ceil(np.log2(max(len(corners), 1) / LEAF))))
    return WindingTree(corners, levels, *_summed(corners, levels))


def winding_numbers(tree: WindingTree, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Winding numbers (P,) at points (P, 3) [cm]: 1 inside, 0 outside."""
    return _winding_numbers(tree, np.ascontiguousarray(points, dtype=np.float64))


@parallel_kernel
def _winding_numbers(tree: WindingTree, points: NDArray[np.float64]) -> NDArray[np.float64]:
    out = np.empty(points.shape[0])
    for p in prange(points.shape[0]):
        out[p] = winding_number(tree, points[p, 0], points[p, 1], points[p, 2])
    return out


@kernel
def winding_number(tree: WindingTree, x: float, y: float, z: float) -> float:
    """Winding number of one point [cm]."""
    corners, levels, centres, radii, dipoles = tree
    stack = np.empty(DEEPEST, dtype=np.int64)
    stack[0] = 1
    size = 1
    first_leaf = 1 << levels
    total = 0.0
    while size > 0:
        size -= 1
        node = stack[size]
        dx, dy, dz = centres[node, 0] - x, centres[node, 1] - y, centres[node, 2] - z
        d2 = dx * dx + dy * dy + dz * dz
        if d2 > (FAR * radii[node]) ** 2:
            total += (dipoles[node, 0] * dx + dipoles[node, 1] * dy + dipoles[node, 2] * dz) / (d2 * np.sqrt(d2))
        elif node >= first_leaf:
            leaf = node - first_leaf
            for f in range((corners.shape[0] * leaf) >> levels, (corners.shape[0] * (leaf + 1)) >> levels):
                total += solid_angle(x, y, z, corners[f])
        else:
            stack[size] = 2 * node
            stack[size + 1] = 2 * node + 1
            size += 2
    return total / (4.0 * np.pi)


@kernel
def _summed(
    corners: NDArray[np.float64], levels: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Centres (N, 3), radii (N,) and area vectors (N, 3) of all nodes, each of its own triangles."""
    count = corners.shape[0]
    nodes = 2 << levels
    centres = np.zeros((nodes, 3))
    radii = np.zeros(nodes)
    dipoles = np.zeros((nodes, 3))
    for node in range(1, nodes):
        level = 0
        while node >> (level + 1):
            level += 1
        j = node - (1 << level)
        first, last = (count * j) >> level, (count * (j + 1)) >> level
        weight = 0.0
        for f in range(first, last):
            t = corners[f]
            nx = 0.5 * ((t[4] - t[1]) * (t[8] - t[2]) - (t[5] - t[2]) * (t[7] - t[1]))
            ny = 0.5 * ((t[5] - t[2]) * (t[6] - t[0]) - (t[3] - t[0]) * (t[8] - t[2]))
            nz = 0.5 * ((t[3] - t[0]) * (t[7] - t[1]) - (t[4] - t[1]) * (t[6] - t[0]))
            # Triangles of no area count a little, so that every node has a centre.
            area = np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-30
            weight += area
            dipoles[node, 0] += nx
            dipoles[node, 1] += ny
            dipoles[node, 2] += nz
            for c in range(3):
                centres[node, c] += area * (t[c] + t[3 + c] + t[6 + c]) / 3.0
        if weight > 0.0:
            centres[node] /= weight
        for f in range(first, last):
            for k in range(3):
                d2 = 0.0
                for c in range(3):
                    d2 += (corners[f, 3 * k + c] - centres[node, c]) ** 2
                radii[node] = max(radii[node], np.sqrt(d2))
    return centres, radii, dipoles


def _morton(corners: NDArray[np.float64]) -> NDArray[np.int64]:
    """A number (F,) for each triangle by which near ones come near each other: the bits of its place, interleaved."""
    centres = corners.reshape(-1, 3, 3).mean(axis=1)
    if len(centres) == 0:
        return np.zeros(0, dtype=np.int64)
    span = np.ptp(centres, axis=0).max()
    places = ((centres - centres.min(axis=0)) * (1023.0 / span if span > 0.0 else 0.0)).astype(np.int64)
    code = np.zeros(len(centres), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((places[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code
