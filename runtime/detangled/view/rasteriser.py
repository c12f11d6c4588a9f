"""Strands and a head to pixels: round ribbons and triangles with a z-buffer, supersampled, shaded where seen.

Rows of pixels are drawn in bands. A band owns its pixels and meets its segments in one order, so a picture
does not depend on the number of threads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.groom import offsets_of
from detangled.kernels import kernel
from detangled.view.camera import Camera
from detangled.view.curves import Curves, lens, trace
from detangled.view.lighting import KEY, RIM, LightGrid, light_at
from detangled.view.shading import Look, shade, tints
from detangled.view.surface import Surface, colour_faces, cover_faces, on_screen
from detangled.view.threads import spread

SAMPLES = 3  # along each side of a pixel
BAND_ROWS = 16  # pixels; low enough that a band's buffers stay in the cache
BIN_CHUNKS = 64  # parts that strands are sorted into bands by
NARROWEST_PX = 0.7  # thinner strands break into dots
TILE = 16  # samples; a tile knows its farthest sample, so that segments behind all of it are passed over
TILE_REFRESH = 4096  # segments drawn between updates of what tiles know; late only costs time


def background(camera: Camera, look: Look) -> NDArray[np.float32]:
    """Linear RGB behind the hair, (height, width, 3): a grey that darkens downwards."""
    y = (np.arange(camera.height) + 0.5) / camera.height
    top, bottom = np.array(look.sky_top), np.array(look.sky_bottom)
    rows = top + (bottom - top) * (y * y * (3.0 - 2.0 * y))[:, None]
    return np.repeat(rows[:, None, :], camera.width, axis=1).astype(np.float32)


def draw(
    curves: Curves,
    camera: Camera,
    light: LightGrid,
    width: float,
    look: Look,
    *,
    colours: NDArray[np.floating] | None = None,
    surface: Surface | None = None,
) -> NDArray[np.uint8]:
    """The picture, (height, width, 3) sRGB, of strands ``width`` [cm] wide.

    colours: linear RGB of every strand of the groom, (S, 3), in place of the look's. surface: a head under the hair.
    """
    view = lens(camera, SAMPLES)
    vertices, strands = trace(curves, view, SAMPLES)
    half = np.array([0.5 * width, 0.5 * NARROWEST_PX * SAMPLES])
    bands = -(-camera.height // BAND_ROWS)
    segments, ends = _binned(curves, vertices, strands, view, half, bands)

    linear = background(camera, look)
    tint = tints(curves.ids, look, colours)
    screen = None if surface is None else on_screen(surface, camera, SAMPLES)
    skin = np.array(look.skin)

    def draw_bands(begin: int, end: int) -> None:
        for band in range(begin, end):
            top = band * BAND_ROWS
            rows = min(BAND_ROWS, camera.height - top)
            shape = (rows * SAMPLES, camera.width * SAMPLES)
            seen, place = np.full(shape, -1, dtype=np.int32), np.empty((*shape, 2), dtype=np.int8)
            nearest = np.full(shape, -np.inf, dtype=np.float32)
            farthest = np.full((-(-shape[0] // TILE), -(-shape[1] // TILE)), -np.inf, dtype=np.float32)
            mine = segments[ends[band] : ends[band + 1]]
            here = linear[top : top + rows]
            lit = (light.values, light.origin, light.cell, view, KEY, RIM, here)
            if surface is not None:
                cover_faces(screen, surface.vertices, surface.faces, top * SAMPLES, nearest, seen)
            _cover(vertices, mine, top * SAMPLES, view, half, nearest, farthest, seen, place)
            if surface is not None:
                mesh = (screen, surface.vertices, surface.normals, surface.faces)
                colour_faces(*mesh, seen, top * SAMPLES, SAMPLES, skin, *lit)
            _colour(vertices, strands, seen, place, tint, *lit)

    spread(draw_bands, bands)
    return encoded(linear)


def encoded(linear: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Linear RGB as sRGB bytes (IEC 61966-2-1)."""
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1.0 / 2.4) - 0.055)
    return np.asarray(255.0 * np.clip(curve, 0.0, 1.0) + 0.5).astype(np.uint8)


def _binned(
    curves: Curves,
    vertices: NDArray[np.float32],
    strands: NDArray[np.int32],
    view: NDArray[np.float64],
    half: NDArray[np.float64],
    bands: int,
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Segments that touch each band, band after band, and where each band's begin and the last one's end.

    Those of near strands come first, so that most of what they hide is passed over when it is met.
    """
    order = np.argsort(-np.maximum.reduceat(curves.points[:, 2], curves.offsets[:-1]), kind="stable")
    starts = np.searchsorted(strands, np.arange(len(order) + 1)).astype(np.int64)
    chunks = min(len(order), BIN_CHUNKS)
    edges = [len(order) * k // chunks for k in range(chunks + 1)]
    counts = np.zeros((chunks, bands), dtype=np.int64)
    given = (order, starts, vertices, view, half)

    def count(begin: int, end: int) -> None:
        for k in range(begin, end):
            _bin(edges[k], edges[k + 1], *given, False, counts[k], np.empty(0, dtype=np.int32))

    spread(count, chunks)
    places = np.cumsum(counts.T).reshape(bands, chunks).T - counts
    segments = np.empty(counts.sum(), dtype=np.int32)

    def fill(begin: int, end: int) -> None:
        for k in range(begin, end):
            _bin(edges[k], edges[k + 1], *given, True, places[k].copy(), segments)

    spread(fill, chunks)
    return segments, offsets_of(counts.sum(axis=0))


@kernel
def _project(vertices, i, view):  # type: ignore[no-untyped-def]
    """Place on the screen [samples] of a vertex, and samples per cm there."""
    scale = view[0] / max(1.0 - view[1] * (vertices[i, 2] - view[4]), 1e-3)
    return view[5] + scale * (vertices[i, 0] - view[2]), view[6] - scale * (vertices[i, 1] - view[3]), scale


@kernel
def _bin(begin, end, order, starts, vertices, view, half, fill, rows, segments):  # type: ignore[no-untyped-def]
    """Count in ``rows`` the segments of some strands that touch each band, or with ``fill`` list them from there on."""
    bands = len(rows)
    height = SAMPLES * BAND_ROWS
    for place in range(begin, end):
        s = order[place]
        ay, a_margin = 0.0, 0.0
        for i in range(starts[s], starts[s + 1]):
            _, by, scale = _project(vertices, i, view)
            b_margin = max(half[0] * scale, half[1])
            if i > starts[s]:
                margin = max(a_margin, b_margin)
                low, high = (min(ay, by) - margin) / height, (max(ay, by) + margin) / height
                if high >= 0.0 and low < bands:
                    for band in range(max(0, int(low)), min(bands - 1, int(high)) + 1):
                        if fill:
                            segments[rows[band]] = i - 1
                        rows[band] += 1
            ay, a_margin = by, b_margin


@kernel
def _cover(vertices, segments, top, view, half, nearest, farthest, seen, place):  # type: ignore[no-untyped-def]
    """Find the nearest segment at each sample of a band.

    nearest: (rows, columns), the camera axis z [cm]. farthest: its least value in each tile, or less.
    seen: the segment. place: (rows, columns, 2), where on it: along (-127 its start, 127 its end) and across.
    """
    rows, columns = seen.shape
    tile_rows, tile_columns = farthest.shape
    for number in range(len(segments)):
        if number % TILE_REFRESH == TILE_REFRESH - 1:
            for r in range(tile_rows):
                for c in range(tile_columns):
                    least = np.float32(np.inf)
                    for y in range(r * TILE, min(rows, (r + 1) * TILE)):
                        for x in range(c * TILE, min(columns, (c + 1) * TILE)):
                            least = min(least, nearest[y, x])
                    farthest[r, c] = least
        i = segments[number]
        ax, ay, scale = _project(vertices, i, view)
        bx, by, _ = _project(vertices, i + 1, view)
        ay -= top
        dx, dy = bx - ax, by - top - ay
        az = float(vertices[i, 2])
        dz = float(vertices[i + 1, 2]) - az
        radius = max(half[0] * scale, half[1])
        bulge = radius / scale
        inverse = 1.0 / max(dx * dx + dy * dy, 1e-6)
        sine = np.sqrt(inverse) / radius
        per_row = 1.0 / dy if abs(dy) > 1e-3 else 0.0
        thin = 1.0 / (radius * radius)
        first = max(0, int(np.ceil(min(ay, ay + dy) - radius - 0.5)))
        last = min(rows - 1, int(np.floor(max(ay, ay + dy) + radius - 0.5)))
        front = max(az, az + dz) + bulge
        leftmost = max(0, int(min(ax, bx) - radius) // TILE)
        rightmost = min(tile_columns - 1, int(max(ax, bx) + radius) // TILE)
        hidden = True
        for r in range(first // TILE, last // TILE + 1):
            for c in range(leftmost, rightmost + 1):
                hidden = hidden and front <= farthest[r, c]
        if hidden:
            continue
        for r in range(first, last + 1):
            y = r + 0.5 - ay
            # Only a part of the segment is within reach of this row: no need to try its whole box.
            t0, t1 = 0.0, 1.0
            if per_row != 0.0:
                middle, spread_ = y * per_row, abs(radius * per_row)
                t0, t1 = max(0.0, middle - spread_), min(1.0, middle + spread_)
            left = ax + min(t0 * dx, t1 * dx) - radius
            right = ax + max(t0 * dx, t1 * dx) + radius
            for c in range(max(0, int(np.ceil(left - 0.5))), min(columns - 1, int(np.floor(right - 0.5))) + 1):
                x = c + 0.5 - ax
                t = min(max((x * dx + y * dy) * inverse, 0.0), 1.0)
                ex, ey = x - t * dx, y - t * dy
                off = (ex * ex + ey * ey) * thin
                z = az + t * dz
                if off >= 1.0 or z + bulge <= nearest[r, c]:
                    continue
                z += bulge * np.sqrt(1.0 - off)
                if z > nearest[r, c]:
                    nearest[r, c] = z
                    seen[r, c] = i
                    place[r, c, 0] = int(254.0 * t - 126.5)
                    place[r, c, 1] = int(127.0 * min(max((y * dx - x * dy) * sine, -1.0), 1.0))


@kernel
def _tangent(vertices, strands, i, out):  # type: ignore[no-untyped-def]
    """Direction of the strand at vertex i, root to tip."""
    a = i - 1 if i > 0 and strands[i - 1] == strands[i] else i
    b = i + 1 if i + 1 < len(strands) and strands[i + 1] == strands[i] else i
    square = 0.0
    for c in range(3):
        out[c] = vertices[b, c] - vertices[a, c]
        square += out[c] * out[c]
    for c in range(3):
        out[c] /= max(np.sqrt(square), 1e-12)


@kernel
def _colour(  # type: ignore[no-untyped-def]
    vertices,  # (V, 3)
    strands,  # (V,)
    seen,  # (rows * SAMPLES, columns * SAMPLES)
    place,  # (rows * SAMPLES, columns * SAMPLES, 2)
    tint,  # (S, 4)
    values,  # (nx, ny, nz, 3)
    origin,
    cell,
    view,
    key,
    rim,
    picture,  # (rows, columns, 3), the background; hair is drawn over it
):
    """Shade what is seen. Samples of a pixel that see one segment are shaded once, at their mean place."""
    rows, columns, _ = picture.shape
    reach, colour, total = np.empty(3), np.empty(3), np.empty(3)
    tangent, other = np.empty(3), np.empty(3)
    pixel = np.empty(SAMPLES * SAMPLES, dtype=np.int32)
    for r in range(rows):
        for c in range(columns):
            for k in range(SAMPLES * SAMPLES):
                pixel[k] = seen[r * SAMPLES + k // SAMPLES, c * SAMPLES + k % SAMPLES]
            hits = 0
            total[:] = 0.0
            for first in range(SAMPLES * SAMPLES):
                i = pixel[first]
                if i < 0:
                    continue
                along, across, alike = 0.0, 0.0, 0
                for k in range(first, SAMPLES * SAMPLES):
                    if pixel[k] == i:
                        y, x = r * SAMPLES + k // SAMPLES, c * SAMPLES + k % SAMPLES
                        along += place[y, x, 0]
                        across += place[y, x, 1]
                        alike += 1
                        pixel[k] = -1
                t, u = 0.5 + along / (254.0 * alike), across / (127.0 * alike)
                _tangent(vertices, strands, i, tangent)
                _tangent(vertices, strands, i + 1, other)
                square = 0.0
                for k in range(3):
                    tangent[k] += t * (other[k] - tangent[k])
                    square += tangent[k] * tangent[k]
                    other[k] = vertices[i, k] + t * (vertices[i + 1, k] - vertices[i, k])
                norm = 1.0 / max(np.sqrt(square), 1e-9)
                tx, ty, tz = tangent[0] * norm, tangent[1] * norm, tangent[2] * norm
                px, py, pz = other[0], other[1], other[2]
                light_at(values, (px - origin[0]) / cell, (py - origin[1]) / cell, (pz - origin[2]) / cell, reach)
                shade(px, py, pz, tx, ty, tz, u, tint[strands[i]], reach, view, key, rim, colour)
                hits += alike
                for k in range(3):
                    total[k] += alike * colour[k]
            if hits > 0:
                gap = 1.0 - hits / (SAMPLES * SAMPLES)
                for k in range(3):
                    picture[r, c, k] = gap * picture[r, c, k] + total[k] / (SAMPLES * SAMPLES)
