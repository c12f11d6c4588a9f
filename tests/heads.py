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


def hair_on(roots: NDArray[np.float64], directions: NDArray[np.float64], length: float = 4.0) -> Groom:
    """A strand of eight points on each root (S, 3), which sets out in a direction (S, 3) and falls down."""
    t = np.linspace(0.0, length, 8)[:, None]
    falling = 0.02 * t**2 * np.array([0.3, -1.0, 0.0])
    return Groom.from_strands([root + t * way + falling for root, way in zip(roots, directions, strict=True)])


def scalp(head: Head, count: int = 40) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Roots (S, 3) and normals (S, 3) of a head's surface, no more than 6 cm below its highest point."""
    corners = head.vertices[head.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    middle = corners.mean(axis=1)
    up = np.flatnonzero((middle[:, 1] > head.vertices[:, 1].max() - 6.0) & (normals[:, 1] > 0.5))
    chosen = up[np.linspace(0, len(up) - 1, count).astype(int)]
    return middle[chosen], normals[chosen]


def scalp_hair(head: Head, count: int = 40) -> Groom:
    """Short hair that leaves the top of a head."""
    return hair_on(*scalp(head, count))
