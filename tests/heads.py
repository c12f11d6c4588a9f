"""Heads and hair for tests: spheres, boxes, and short hair on the scalp of a real mesh."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from detangled.groom import Groom
from detangled.head import Head

RADIUS = 9.0


def head_of(mesh: trimesh.Trimesh) -> Head:
    return Head(np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces))


def sphere(subdivisions: int = 4) -> Head:
    """About the origin, of RADIUS: its facets are 0.02 cm inside of it at most."""
    return head_of(trimesh.creation.icosphere(subdivisions, radius=RADIUS))


def hair_on(head: Head, roots: NDArray[np.float64], normals: NDArray[np.float64], length: float = 4.0) -> Groom:
    """A strand of eight points on each root (S, 3), which leaves the head and falls down to one side."""
    t = np.linspace(0.0, length, 8)
    down = np.array([0.3, -1.0, 0.0])
    strands = [r + t[:, None] * n + (0.12 * t**2)[:, None] * down for r, n in zip(roots, normals, strict=True)]
    return Groom.from_strands(strands)


def scalp_hair(head: Head, count: int = 40) -> Groom:
    """Hair on the topmost tenth of a head of 25 cm, above its highest point less 6 cm."""
    corners = head.vertices[head.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    middle = corners.mean(axis=1)
    up = np.flatnonzero((middle[:, 1] > head.vertices[:, 1].max() - 6.0) & (normals[:, 1] > 0.3))
    chosen = up[np.linspace(0, len(up) - 1, count).astype(int)]
    return hair_on(head, middle[chosen], normals[chosen])
