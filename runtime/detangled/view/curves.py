"""Strands as they are drawn: in camera axes, without what cannot be drawn, smooth between their points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.groom import Groom, offsets_of
from detangled.kernels import kernel
from detangled.usable import FARTHEST
from detangled.view.camera import Camera
from detangled.view.threads import spread

FLATNESS_PX = 0.15  # how far a drawn polyline may leave its curve [pixels of the picture]
MOST_PIECES = 24  # of one segment, however near the camera


@dataclass(frozen=True)
class Curves:
    """The strands of one groom that can be drawn.

    points: (P, 3) float32 in camera axes [cm]. offsets: (S + 1,), as in a Groom.
    ids: (S,) the strand's index in the groom, so that a strand keeps its tint where others are left out.
    low, high: (3,) the corners of the box around the points.
    """

    points: NDArray[np.float32]
    offsets: NDArray[np.int64]
    ids: NDArray[np.int64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def drawable(groom: Groom, rotation: NDArray[np.float64], origin: NDArray[np.float64] | None = None) -> Curves:
    """Turn a groom into camera axes, without points that are not finite or repeat the one before.

    origin: (3,) what becomes the origin of the camera axes, in the groom's own [cm]: near the hair, since what is
    far from it is left out, and float32 is coarse there. Strands of fewer than two points left are left out.
    """
    middle = np.zeros(3) if origin is None else np.ascontiguousarray(origin, dtype=np.float64)
    points = np.empty((len(groom.points), 3), dtype=np.float32)
    counts = np.empty(groom.strand_count, dtype=np.int64)
    box = np.array([[np.inf] * 3, [-np.inf] * 3])
    total = _turn(groom.points, groom.offsets, np.ascontiguousarray(rotation), middle, FARTHEST, points, counts, box)
    ids = np.flatnonzero(counts)
    offsets = offsets_of(counts[ids])
    return Curves(points[:total], offsets, ids.astype(np.int64), box[0], box[1])


def lens(camera: Camera, samples: int) -> NDArray[np.float64]:
    """A camera as kernels take it, its pixels in samples: scale, nearness, centre (3), principal (2)."""
    return np.array(
        [
            samples * camera.scale,
            camera.nearness,
            *camera.centre,
            samples * camera.principal[0],
            samples * camera.principal[1],
        ]
    )


def trace(curves: Curves, view: NDArray[np.float64], samples: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Polylines that cannot be told from each strand's centripetal Catmull-Rom curve in this view.

    Returns vertices (V, 3) in camera axes [cm] and the strand of each, (V,) int32.
    """
    strands = len(curves.ids)
    counts = np.empty(strands, dtype=np.int64)
    pieces = np.zeros(len(curves.points), dtype=np.uint8)
    spread(
        lambda a, b: _count(a, b, curves.points, curves.offsets, view, FLATNESS_PX * samples, pieces, counts), strands
    )
    starts = offsets_of(counts)
    vertices, owners = np.empty((starts[-1], 3), dtype=np.float32), np.empty(starts[-1], dtype=np.int32)
    spread(lambda a, b: _trace(a, b, curves.points, curves.offsets, pieces, starts, vertices, owners), strands)
    return vertices, owners


@kernel
def _turn(points, offsets, rotation, origin, farthest, turned, counts, box):  # type: ignore[no-untyped-def]
    """Write the points worth drawing, (P, 3), and how many each strand has: none or at least two."""
    row = 0
    for s in range(len(offsets) - 1):
        first = row
        for i in range(offsets[s], offsets[s + 1]):
            x, y, z = points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2]
            if not (abs(x) < farthest and abs(y) < farthest and abs(z) < farthest):  # true for NaN
                continue
            same = row > first
            for c in range(3):
                turned[row, c] = rotation[c, 0] * x + rotation[c, 1] * y + rotation[c, 2] * z
                same = same and turned[row, c] == turned[row - 1, c]
            if not same:
                row += 1
        if row - first < 2:
            row = first
        counts[s] = row - first
        for i in range(first, row):
            for c in range(3):
                value = float(turned[i, c])
                if value < box[0, c]:
                    box[0, c] = value
                if value > box[1, c]:
                    box[1, c] = value
    return row


@kernel
def _pieces(points, first, last, i, view, flatness):  # type: ignore[no-untyped-def]
    """Straight pieces to draw for the segment from point i to i + 1, by its ends' bend on the screen."""
    bend = 0.0
    for k in range(i, i + 2):
        if first < k < last - 1:
            depth = max(1.0 - view[1] * (points[k, 2] - view[4]), 1e-3)
            x = (points[k - 1, 0] - 2.0 * points[k, 0] + points[k + 1, 0]) / depth
            y = (points[k - 1, 1] - 2.0 * points[k, 1] + points[k + 1, 1]) / depth
            bend = max(bend, x * x + y * y)
    # A parabola's chord leaves it by an eighth of the second difference; n pieces divide that by n squared.
    return max(1, min(MOST_PIECES, int(np.ceil(np.sqrt(0.125 * view[0] * np.sqrt(bend) / flatness)))))


@kernel
def _knot_step(p, a, b):  # type: ignore[no-untyped-def]
    """Square root of the distance between two of the four points: what makes the curve centripetal."""
    return np.sqrt(np.sqrt((p[a, 0] - p[b, 0]) ** 2 + (p[a, 1] - p[b, 1]) ** 2 + (p[a, 2] - p[b, 2]) ** 2))


@kernel
def _count(begin, end, points, offsets, view, flatness, pieces, counts):  # type: ignore[no-untyped-def]
    """The straight pieces of each segment, (P,) by its first point, and the vertices of each strand, (S,)."""
    for s in range(begin, end):
        first, last = offsets[s], offsets[s + 1]
        counts[s] = 1
        for i in range(first, last - 1):
            pieces[i] = _pieces(points, first, last, i, view, flatness)
            counts[s] += pieces[i]


@kernel
def _trace(begin, end, points, offsets, pieces, starts, vertices, owners):  # type: ignore[no-untyped-def]
    """Write the vertices of each strand and whose they are."""
    p = np.empty((4, 3))
    for s in range(begin, end):
        first, last = offsets[s], offsets[s + 1]
        row = starts[s]
        owners[row : starts[s + 1]] = s
        for i in range(first, last - 1):
            for c in range(3):
                p[1, c], p[2, c] = points[i, c], points[i + 1, c]
                # Past its ends a strand goes on straight.
                p[0, c] = points[i - 1, c] if i > first else 2.0 * p[1, c] - p[2, c]
                p[3, c] = points[i + 2, c] if i + 2 < last else 2.0 * p[2, c] - p[1, c]
            d0, d1, d2 = _knot_step(p, 0, 1), _knot_step(p, 1, 2), _knot_step(p, 2, 3)
            for c in range(3):
                a, b = p[1, c], p[2, c] - p[1, c]
                # Cubic Hermite form; the tangents at both ends, times the step between them.
                m0 = d1 * ((a - p[0, c]) / d0 - (p[2, c] - p[0, c]) / (d0 + d1)) + b
                m1 = b - d1 * ((p[3, c] - a) / (d1 + d2) - (p[3, c] - p[2, c]) / d2)
                for k in range(pieces[i]):
                    t = k / pieces[i]
                    vertices[row + k, c] = a + t * (m0 + t * (3.0 * b - 2.0 * m0 - m1 + t * (m0 + m1 - 2.0 * b)))
            row += pieces[i]
        for c in range(3):
            vertices[row, c] = points[last - 1, c]
