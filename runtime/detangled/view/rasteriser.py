"""Strands and a head to pixels: round ribbons and triangles with a z-buffer, supersampled, shaded where seen.

Rows of pixels are drawn in bands. A band owns its pixels and meets its segments in one order, so a picture
does not depend on the number of threads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import kernel
from detangled.view.camera import Camera
from detangled.view.curves import Curves, lens, trace
from detangled.view.lighting import KEY, RIM, LightGrid, light_at
from detangled.view.shading import Look, shade, tints
from detangled.view.surface import Surface, colour_faces, cover_faces, on_screen
from detangled.view.threads import spread

SAMPLES = 3  # along each side of a pixel
BAND_ROWS = 16  # pixels; low enough that a band's buffers stay in the cache
BIN_CHUNKS = 32  # parts that segments are sorted by
SLABS = 64  # of depth: the nearest segments are met first, and those they hide are passed over
NARROWEST_PX = 0.7  # thinner strands break into dots
TILE = 8  # samples; a tile knows its farthest sample, so that segments behind all of it are passed over
TILE_REFRESH = 2048  # segments drawn between updates of what tiles know; late only costs time


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
    spread(lambda begin, end: _to_screen(begin, end, view, vertices), len(vertices))
    segments, ends = _binned(vertices, strands, view, half, bands)

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
    vertices: NDArray[np.float32],
    strands: NDArray[np.int32],
    view: NDArray[np.float64],
    half: NDArray[np.float64],
    bands: int,
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Segments that touch each band, band after band, and where each band's begin and the last one's end.

    In a band those of near slabs come first, and in a slab those of earlier strands.
    """
    chunks = min(len(vertices) - 1, BIN_CHUNKS)
    edges = [(len(vertices) - 1) * k // chunks for k in range(chunks + 1)]
    counts = np.zeros((chunks, bands, SLABS), dtype=np.int64)
    near, far = float(vertices[:, 2].max()), float(vertices[:, 2].min())
    per_cm = SLABS / max(near - far, 1e-6)
    given = (vertices, strands, view, half, near, per_cm)

    def count(begin: int, end: int) -> None:
        for k in range(begin, end):
            _bin(edges[k], edges[k + 1], *given, False, counts[k], np.empty(0, dtype=np.int32))

    spread(count, chunks)
    ends = np.cumsum(counts.transpose(1, 2, 0)).reshape(bands, SLABS, chunks).transpose(2, 0, 1)
    places = np.ascontiguousarray(ends - counts)
    segments = np.empty(int(ends[-1, -1, -1]), dtype=np.int32)

    def fill(begin: int, end: int) -> None:
        for k in range(begin, end):
            _bin(edges[k], edges[k + 1], *given, True, places[k], segments)

    spread(fill, chunks)
    return segments, np.concatenate([[0], ends[-1, :, -1]])


@kernel
def _depth(z, view):  # type: ignore[no-untyped-def]
    """Distance from the eye, in that of the camera's centre."""
    return max(1.0 - view[1] * (z - view[4]), 1e-3)


@kernel
def _to_screen(begin, end, view, vertices):  # type: ignore[no-untyped-def]
    """Turn x and y of vertices from camera axes [cm] to the screen [samples]; z stays."""
    for i in range(begin, end):
        scale = view[0] / _depth(vertices[i, 2], view)
        vertices[i, 0] = view[5] + scale * (vertices[i, 0] - view[2])
        vertices[i, 1] = view[6] - scale * (vertices[i, 1] - view[3])


@kernel
def _from_screen(vertices, i, view, out):  # type: ignore[no-untyped-def]
    """The place of a vertex in camera axes [cm] into ``out``."""
    cm = _depth(vertices[i, 2], view) / view[0]
    out[0] = view[2] + cm * (vertices[i, 0] - view[5])
    out[1] = view[3] - cm * (vertices[i, 1] - view[6])
    out[2] = vertices[i, 2]


@kernel
def _bin(begin, end, vertices, strands, view, half, near, per_cm, fill, rows, segments):  # type: ignore[no-untyped-def]
    """Count in ``rows`` (bands, slabs) the segments that touch each, or with ``fill`` list them from there on."""
    bands, slabs = rows.shape
    height = SAMPLES * BAND_ROWS
    for i in range(begin, end):
        if strands[i] != strands[i + 1]:
            continue
        ay, by = float(vertices[i, 1]), float(vertices[i + 1, 1])
        front = max(vertices[i, 2], vertices[i + 1, 2])
        margin = max(half[0] * view[0] / _depth(front, view), half[1])
        low, high = (min(ay, by) - margin) / height, (max(ay, by) + margin) / height
        if high >= 0.0 and low < bands:
            slab = min(int((near - front) * per_cm), slabs - 1)
            for band in range(max(0, int(low)), min(bands - 1, int(high)) + 1):
                if fill:
                    segments[rows[band, slab]] = i
                rows[band, slab] += 1


@kernel
def _cover(vertices, segments, top, view, half, nearest, farthest, seen, place):  # type: ignore[no-untyped-def]
    """Find the nearest segment at each sample of a band.

    nearest: (rows, columns), the camera axis z [cm]. farthest: its least value in each tile, or less.
    seen: the segment. place: (rows, columns, 2), where on it: along (-127 its start, 127 its end) and across.
    """
    rows, columns = seen.shape
    tile_rows, tile_columns = farthest.shape
    drawn = 0
    for i in segments:
        ax, ay, az = float(vertices[i, 0]), float(vertices[i, 1]) - top, float(vertices[i, 2])
        dx, dy = vertices[i + 1, 0] - ax, vertices[i + 1, 1] - top - ay
        dz = vertices[i + 1, 2] - az
        depth = _depth(az, view)
        radius = max(half[0] * view[0] / depth, half[1])
        bulge = radius * depth / view[0]
        front = max(az, az + dz) + bulge
        left, right = min(ax, ax + dx) - radius, max(ax, ax + dx) + radius
        low, high = min(ay, ay + dy) - radius, max(ay, ay + dy) + radius
        hidden = True
        for r in range(max(0, int(low / TILE)), min(tile_rows, int(high / TILE) + 1)):
            for c in range(max(0, int(left / TILE)), min(tile_columns, int(right / TILE) + 1)):
                hidden = hidden and front <= farthest[r, c]
        if hidden:
            continue
        square = max(dx * dx + dy * dy, 1e-6)
        length = np.sqrt(square)
        thin = 1.0 / (radius * length)
        stretch = length / radius
        per_row = 1.0 / dy if abs(dy) > 1e-3 else 0.0
        for r in range(max(0, int(np.ceil(low - 0.5))), min(rows - 1, int(np.floor(high - 0.5))) + 1):
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
                along = (x * dx + y * dy) / square
                t = min(max(along, 0.0), 1.0)
                z = az + t * dz
                # Off the segment's line, and beyond its ends, in radii.
                across, beyond = (y * dx - x * dy) * thin, (along - t) * stretch
                off = across * across + beyond * beyond
                if off >= 1.0 or z + bulge <= nearest[r, c]:
                    continue
                z += bulge * np.sqrt(1.0 - off)
                if z > nearest[r, c]:
                    nearest[r, c] = z
                    seen[r, c] = i
                    place[r, c, 0] = int(254.0 * t - 126.5)
                    place[r, c, 1] = int(127.0 * across)
        drawn += 1
        if drawn % TILE_REFRESH == 0:
            _refresh(nearest, farthest)


@kernel
def _refresh(nearest, farthest):  # type: ignore[no-untyped-def]
    """Find the least of ``nearest`` (rows, columns) in each tile."""
    rows, columns = nearest.shape
    for r in range(len(farthest)):
        for c in range(farthest.shape[1]):
            least = np.float32(np.inf)
            for y in range(r * TILE, min(rows, (r + 1) * TILE)):
                for x in range(c * TILE, min(columns, (c + 1) * TILE)):
                    least = min(least, nearest[y, x])
            farthest[r, c] = least


@kernel
def _tangent(vertices, strands, i, view, start, out):  # type: ignore[no-untyped-def]
    """Direction of the strand at vertex i, root to tip, into ``out``; ``start``: room for a place."""
    _from_screen(vertices, i - 1 if i > 0 and strands[i - 1] == strands[i] else i, view, start)
    _from_screen(vertices, i + 1 if i + 1 < len(strands) and strands[i + 1] == strands[i] else i, view, out)
    square = 0.0
    for c in range(3):
        out[c] -= start[c]
        square += out[c] * out[c]
    for c in range(3):
        out[c] /= max(np.sqrt(square), 1e-12)


@kernel
def _colour(  # type: ignore[no-untyped-def]
    vertices,  # (V, 3), on the screen
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
    tangent, other, start, stop = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
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
                _tangent(vertices, strands, i, view, start, tangent)
                _tangent(vertices, strands, i + 1, view, start, other)
                _from_screen(vertices, i, view, start)
                _from_screen(vertices, i + 1, view, stop)
                square = 0.0
                for k in range(3):
                    tangent[k] += t * (other[k] - tangent[k])
                    square += tangent[k] * tangent[k]
                    other[k] = start[k] + t * (stop[k] - start[k])
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
