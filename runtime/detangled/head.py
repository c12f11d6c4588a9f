"""Head: the mesh that a groom grows on. Never mutated: every change is a copy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.errors import DetangledError


@dataclass(frozen=True)
class Head:
    """Triangles of a head, a body or a scalp.

    vertices: (V, 3) float64 [cm], in the frame of the groom that it goes with.
    faces: (F, 3) int64, indices of vertices, counter-clockwise seen from outside.
    uv: (F, 3, 2) float64, texture coordinates of each face's corners; None where the file has none. Tiles beyond the
        first (u or v over 1) are kept as they are.
    notes: what the reader could not keep or had to assume, one sentence each.
    unit_cm: centimetres in one unit of the file that it came from.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    uv: NDArray[np.float64] | None = None
    notes: tuple[str, ...] = ()
    unit_cm: float = 1.0

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, dtype=np.float64)
        faces = np.ascontiguousarray(self.faces, dtype=np.int64)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise DetangledError(f"vertices must have the shape (V, 3), not {vertices.shape}")
        if faces.ndim != 2 or faces.shape[1] != 3:
            raise DetangledError(f"faces must have the shape (F, 3), not {faces.shape}")
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise DetangledError(f"faces must name vertices 0 to {len(vertices) - 1}")
        if self.uv is not None and np.shape(self.uv) != (len(faces), 3, 2):
            raise DetangledError(f"uv must have the shape {(len(faces), 3, 2)}, not {np.shape(self.uv)}")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
