"""A head as it is drawn: smooth triangles in camera axes, in the same z-buffer as the hair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.head import Head
from detangled.kernels import kernel
from detangled.view.camera import Camera
from detangled.view.lighting import light_at
from detangled.view.shading import shade_surface

FIRST_FACE = -2  # in a buffer of what is seen a face f is FIRST_FACE - f, nothing -1, hair 0 and more


@dataclass(frozen=True)
class Surface:
    """Triangles in camera axes [cm].

    vertices, normals: (V, 3) float32, normals outwards and of unit length. faces: (F, 3) int32.
    """

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    faces: NDArray[np.int32]


def drawable_surface(head: Head, rotation: NDArray[np.float64], origin: NDArray[np.float64]) -> Surface:
    """Turn a head into camera axes about ``origin``, without triangles of coordinates that are not finite.

    Vertices at one place share a normal, as files repeat them along seams.
    """
    finite = np.asarray(np.isfinite(head.vertices).all(axis=1))
    faces = head.faces[finite[head.faces].all(axis=1)]
    vertices = np.where(np.isfinite(head.vertices), head.vertices - origin, 0.0) @ rotation.T
    corners = vertices[faces]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    _, place = np.unique(vertices, axis=0, return_inverse=True)
    normals = np.zeros((len(vertices), 3))
    for corner in range(3):
        np.add.at(normals, place.reshape(-1)[faces[:, corner]], outward)
    normals = normals[place.reshape(-1)]
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Surface(vertices.astype(np.float32), normals.astype(np.float32), np.ascontiguousarray(faces, dtype=np.int32))


def on_screen(surface: Surface, camera: Camera, samples: int) -> NDArray[np.float64]:
    """Place of each vertex in samples, and 1 / its depth in units of the camera's distance, (V, 3).

    What lies behind the eye has a depth below 0 and is not drawn.
    """
    depth = 1.0 - camera.nearness * (surface.vertices[:, 2].astype(np.float64) - camera.centre[2])
    safe = np.where(np.abs(depth) < 1e-3, 1e-3, depth)
    offset = surface.vertices[:, :2].astype(np.float64) - np.asarray(camera.centre[:2])
    x = camera.principal[0] + camera.scale * offset[:, 0] / safe
    y = camera.principal[1] - camera.scale * offset[:, 1] / safe
    return np.stack([samples * x, samples * y, 1.0 / safe], axis=1)


@kernel
def _weights(screen, faces, f, x, y, out):  # type: ignore[no-untyped-def]
    """Perspective-correct barycentric weights of a place on the screen into ``out``; whether it is inside."""
    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
    ax, ay = screen[a, 0] - x, screen[a, 1] - y
    bx, by = screen[b, 0] - x, screen[b, 1] - y
    cx, cy = screen[c, 0] - x, screen[c, 1] - y
    wa, wb, wc = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
    area = wa + wb + wc
    if area == 0.0:
        return False
    inside = (wa >= 0.0 and wb >= 0.0 and wc >= 0.0) or (wa <= 0.0 and wb <= 0.0 and wc <= 0.0)
    wa, wb, wc = wa * screen[a, 2], wb * screen[b, 2], wc * screen[c, 2]
    total = wa + wb + wc
    if total == 0.0:
        return False
    out[0], out[1], out[2] = wa / total, wb / total, wc / total
    return inside


@kernel
def cover_faces(screen, vertices, faces, top, nearest, seen):  # type: ignore[no-untyped-def]
    """Write into a band's buffers, whose first row is ``top``, the faces that are nearest at its samples."""
    rows, columns = seen.shape
    weight = np.empty(3)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if screen[a, 2] <= 0.0 or screen[b, 2] <= 0.0 or screen[c, 2] <= 0.0:
            continue
        low = min(screen[a, 1], screen[b, 1], screen[c, 1]) - top
        high = max(screen[a, 1], screen[b, 1], screen[c, 1]) - top
        if high < 0.0 or low > rows:
            continue
        left, right = min(screen[a, 0], screen[b, 0], screen[c, 0]), max(screen[a, 0], screen[b, 0], screen[c, 0])
        if right < 0.0 or left > columns:
            continue
        for r in range(int(max(0.0, np.floor(low))), int(min(rows - 1.0, np.ceil(high))) + 1):
            for k in range(int(max(0.0, np.floor(left))), int(min(columns - 1.0, np.ceil(right))) + 1):
                if not _weights(screen, faces, f, k + 0.5, r + top + 0.5, weight):
                    continue
                z = weight[0] * vertices[a, 2] + weight[1] * vertices[b, 2] + weight[2] * vertices[c, 2]
                if z > nearest[r, k]:
                    nearest[r, k] = z
                    seen[r, k] = FIRST_FACE - f


@kernel
def colour_faces(  # type: ignore[no-untyped-def]
    screen,  # (V, 3)
    vertices,  # (V, 3)
    normals,  # (V, 3)
    faces,  # (F, 3)
    seen,  # (rows * samples, columns * samples)
    top,
    samples,
    skin,  # (3,)
    values,  # (nx, ny, nz, 3)
    origin,
    cell,
    view,
    key,
    rim,
    picture,  # (rows, columns, 3), the background; the head is drawn over it, where no hair is seen
):
    """Shade the faces that are seen, each once a pixel, at the mean place of its samples there."""
    rows, columns, _ = picture.shape
    weight, reach, colour, total = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    p, n = np.empty(3), np.empty(3)
    count = samples * samples
    pixel = np.empty(count, dtype=np.int32)
    for r in range(rows):
        for c in range(columns):
            behind, hits = 0, 0
            for k in range(count):
                pixel[k] = seen[r * samples + k // samples, c * samples + k % samples]
                behind += pixel[k] == -1
            total[:] = 0.0
            for first in range(count):
                if pixel[first] > FIRST_FACE:
                    continue
                f = FIRST_FACE - pixel[first]
                x, y, alike = 0.0, 0.0, 0
                for k in range(first, count):
                    if pixel[k] == FIRST_FACE - f:
                        x += c * samples + k % samples + 0.5
                        y += r * samples + k // samples + 0.5
                        alike += 1
                        pixel[k] = -1
                _weights(screen, faces, f, x / alike, top + y / alike, weight)
                square = 0.0
                for k in range(3):
                    p[k], n[k] = 0.0, 0.0
                    for corner in range(3):
                        p[k] += weight[corner] * vertices[faces[f, corner], k]
                        n[k] += weight[corner] * normals[faces[f, corner], k]
                    square += n[k] * n[k]
                norm = 1.0 / max(np.sqrt(square), 1e-9)
                for k in range(3):
                    n[k] *= norm
                # Light is looked up a little outside, where the head itself is not in its way.
                light_at(
                    values,
                    (p[0] - origin[0]) / cell + n[0],
                    (p[1] - origin[1]) / cell + n[1],
                    (p[2] - origin[2]) / cell + n[2],
                    reach,
                )
                shade_surface(p, n, skin, reach, view, key, rim, colour)
                hits += alike
                for k in range(3):
                    total[k] += alike * colour[k]
            if hits > 0:
                for k in range(3):
                    picture[r, c, k] = (behind * picture[r, c, k] + total[k]) / (behind + hits)
