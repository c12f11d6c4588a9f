"""Cubic and other smooth curves into polylines: hair tools store control points, which are not on the curve.

B-splines by de Boor's recurrence, with or without knots, of any order and with weights; the other bases by
their matrices. The bases are those of RenderMan's RiCurves, which Alembic takes over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Points on each span of a smooth curve. A span of hair turns by well under a right angle; four pieces of it
# keep the curve within 1 % of the turn's radius.
SAMPLES_PER_SPAN = 4
# Numbers worked on at once: bounds memory for large grooms.
CHUNK_NUMBERS = 1 << 22
CUBIC_ORDER = 4

Array = NDArray[np.float64]

# Powers of t (1, t, t^2, t^3) to weights of four control points, and how far one span is from the next.
_MATRICES: dict[str, tuple[Array, int]] = {
    "bezier": (np.array([[1, 0, 0, 0], [-3, 3, 0, 0], [3, -6, 3, 0], [-1, 3, -3, 1]], dtype=np.float64), 3),
    "catmull-rom": (
        np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]], dtype=np.float64) / 2,
        1,
    ),
    # Point, tangent, point, tangent.
    "hermite": (np.array([[1, 0, 0, 0], [0, 1, 0, 0], [-3, -2, 3, -1], [2, 1, -2, 1]], dtype=np.float64), 2),
    # RenderMan counts its powers down: the cube's coefficient comes first.
    "power": (np.eye(4)[::-1].copy(), 4),
}
BASES = ("bspline", *_MATRICES)


@dataclass(frozen=True)
class SmoothCurves:
    """Control points of curves, as a file gives them.

    counts: (S,) control points of each curve.
    basis: one of ``BASES``.
    orders: (S,) degree + 1 of each curve.
    knots: all curves' knots, count + order of each curve, or (Maya's way) two fewer; empty for uniform ones.
    weights: (P,) or empty.
    """

    counts: NDArray[np.int64]
    basis: str
    orders: NDArray[np.int64]
    knots: Array
    weights: Array

    # Coordinates that are no numbers pass through, without a warning.
    @np.errstate(all="ignore")
    def to_polylines(self, channels: Array) -> tuple[NDArray[np.int64], Array, list[str]]:
        """Evaluate channels (P, K) of the control points, the first three their positions.

        Returns points of each polyline (S,), channels on them (Q, K), and sentences about what was assumed.
        Curves with too few control points for a span, or of order 2, stay as they are.
        """
        knots, notes = self._standard_knots()
        if len(self.weights):
            channels = np.column_stack([channels * self.weights[:, None], self.weights])
        begin = np.cumsum(self.counts) - self.counts
        knot_begin = np.cumsum(self.counts + self.orders) - (self.counts + self.orders)
        groups, member = np.unique(np.stack([self.counts, self.orders], axis=1), axis=0, return_inverse=True)
        pieces = []
        counts = self.counts.copy()
        for index, (count, order) in enumerate(groups.tolist()):
            curves = np.flatnonzero(member.ravel() == index)
            controls = channels[begin[curves, None] + np.arange(count)]  # (g, n, K)
            if order <= 2 or count < order:
                points = controls
            elif self.basis == "bspline":
                if len(knots):
                    own = knots[knot_begin[curves, None] + np.arange(count + order)]  # (g, n + order)
                else:
                    own = np.broadcast_to(np.arange(count + order, dtype=np.float64), (len(curves), count + order))
                points = _in_chunks(controls, own, order)
            elif order == CUBIC_ORDER:
                points = _by_matrix(controls, self.basis)
            else:
                notes.append(f"{len(curves)} curves of order {order} were read by their control points")
                points = controls
            counts[curves] = points.shape[1]
            pieces.append((curves, points))
        begin = np.cumsum(counts) - counts
        result = np.empty((int(counts.sum()), channels.shape[1]))
        for curves, points in pieces:
            result[begin[curves, None] + np.arange(points.shape[1])] = points
        if len(self.weights):
            result = result[:, :-1] / result[:, -1:]
        return counts, result, notes

    def _standard_knots(self) -> tuple[Array, list[str]]:
        """Knots with count + order a curve, or none where they are to be uniform."""
        if not len(self.knots) or self.basis != "bspline":
            return np.empty(0), []
        sizes = self.counts + self.orders
        knots = self.knots
        if len(knots) == int(sizes.sum()) - 2 * len(sizes):
            # Maya leaves out the first and the last knot, which no point of the curve depends on.
            own = np.repeat(np.arange(len(sizes)), sizes - 2)
            ends = np.cumsum(sizes - 2)
            padded = np.empty(int(sizes.sum()))
            padded[np.arange(len(knots)) + 2 * own + 1] = knots
            padded[np.cumsum(sizes) - sizes] = knots[ends - (sizes - 2)]
            padded[np.cumsum(sizes) - 1] = knots[ends - 1]
            knots = padded
        if len(knots) != int(sizes.sum()):
            return np.empty(0), ["its knots do not fit its curves: uniform ones were taken"]
        rising = np.diff(knots) >= 0
        rising[np.cumsum(sizes)[:-1] - 1] = True
        if not (rising.all() and np.isfinite(knots).all()):
            return np.empty(0), ["its knots do not rise: uniform ones were taken"]
        return knots, []


def _in_chunks(controls: Array, knots: Array, order: int) -> Array:
    curves, count, width = controls.shape
    spans = np.arange(order - 1, count)
    # A span between equal knots is empty; where it is so for every curve of the group it has no points.
    spans = spans[np.any(knots[:, spans + 1] > knots[:, spans], axis=0)]
    if len(spans) == 0:
        return controls
    numbers = len(spans) * (SAMPLES_PER_SPAN + 1) * order * width
    step = max(1, CHUNK_NUMBERS // numbers)
    parts = [_de_boor(controls[i : i + step], knots[i : i + step], order, spans) for i in range(0, curves, step)]
    return np.concatenate(parts)


def _de_boor(controls: Array, knots: Array, order: int, spans: NDArray[np.int64]) -> Array:
    """Points of B-splines, (g, n, K) to (g, len(spans) * SAMPLES_PER_SPAN + 1, K)."""
    degree = order - 1
    fractions = np.arange(SAMPLES_PER_SPAN + 1) / SAMPLES_PER_SPAN
    low, high = knots[:, spans, None], knots[:, spans + 1, None]
    at = low + fractions * (high - low)  # (g, spans, m)
    window = [controls[:, spans - degree + j, None, :] for j in range(order)]
    for r in range(1, order):
        for j in range(degree, r - 1, -1):
            left = knots[:, spans + j - degree, None]
            right = knots[:, spans + j + 1 - r, None]
            width = np.where(right > left, right - left, 1.0)
            alpha = ((at - left) / width)[..., None]
            window[j] = (1.0 - alpha) * window[j - 1] + alpha * window[j]
    return _chained(window[degree])


def _by_matrix(controls: Array, basis: str) -> Array:
    matrix, step = _MATRICES[basis]
    if basis == "catmull-rom" and not _ends_doubled(controls):
        # Hair starts at its first point: a mirrored neighbour beyond each end lets the curve reach both.
        first = 2 * controls[:, :1] - controls[:, 1:2]
        last = 2 * controls[:, -1:] - controls[:, -2:-1]
        controls = np.concatenate([first, controls, last], axis=1)
    fractions = np.arange(SAMPLES_PER_SPAN + 1) / SAMPLES_PER_SPAN
    weights = np.vander(fractions, 4, increasing=True) @ matrix  # (m, 4)
    windows = np.arange(0, controls.shape[1] - 3, step)[:, None] + np.arange(4)
    return _chained(np.einsum("ma,gsak->gsmk", weights, controls[:, windows]))


def _ends_doubled(controls: Array) -> bool:
    ends = controls[..., :3]
    return bool(np.all(ends[:, 0] == ends[:, 1]) and np.all(ends[:, -1] == ends[:, -2]))


def _chained(spans: Array) -> Array:
    """Join spans (g, s, m, K) whose last point is the next one's first."""
    curves, _, _, width = spans.shape
    return np.concatenate([spans[:, :, :-1].reshape(curves, -1, width), spans[:, -1, -1:]], axis=1)
