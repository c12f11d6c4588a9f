"""What a picture shows: where the hair is, without strays, and one camera for everything side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.groom import Groom
from detangled.view.camera import upright
from detangled.view.curves import Curves, drawable

POINTS_TO_PLACE_FROM = 20_000
PLACES_CM = 16.0  # apart, so that a few strands more or less do not change how the others are rounded
# A strand is a stray, and not framed, where it reaches this many times further from the middle than nine in ten do.
STRAY_REACH = 4.0
STRAY_RANK = 0.9
# Grooms are centred each in its own panel where all of them together span more than this times the largest of them.
APART = 1.5
# Of a head or body as much is framed as lies within this part of the hair's extent, and this far, of the hair.
HEAD_REACH, HEAD_REACH_CM = 0.6, 15.0


@dataclass(frozen=True)
class Box:
    """low, high: (3,) corners [cm], along right, up and front of an upright head.

    strays: (n,) indices of the strands that were left out.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    strays: NDArray[np.int64]

    @property
    def middle(self) -> NDArray[np.float64]:
        return 0.5 * (self.low + self.high)

    @property
    def extent(self) -> float:
        """The longest side [cm]."""
        return float(np.max(self.high - self.low))


def hair_box(groom: Groom) -> Box | None:
    """The box around a groom's strands that can be drawn, strays left out; None where none can be."""
    place = _somewhere(groom.points)
    axes = upright(groom.up)
    curves = drawable(groom, axes, place)
    if len(curves.ids) == 0:
        return None
    left_out = curves.ids[_far(curves)]
    points = framed_points(curves, left_out)
    move = axes @ place
    return Box(points.min(axis=0) + move, points.max(axis=0) + move, left_out)


def framed_points(curves: Curves, left_out: NDArray[np.int64]) -> NDArray[np.float32]:
    """Points of all strands but those of the indices ``left_out``, (n, 3)."""
    if len(left_out) == 0:
        return curves.points
    return curves.points[~np.repeat(np.isin(curves.ids, left_out), np.diff(curves.offsets))]


def pivots(boxes: Sequence[Box], axes: Sequence[NDArray[np.float64]]) -> tuple[list[NDArray[np.float64]], bool]:
    """What each groom is turned and framed about, (3,) each in the groom's own axes; whether grooms were moved to it.

    One place for all where they belong together, as before and after do; where they lie apart each one's middle.
    """
    low = np.min([box.low for box in boxes], axis=0)
    high = np.max([box.high for box in boxes], axis=0)
    apart = bool(np.max(high - low) > APART * max(box.extent for box in boxes))
    middles = [box.middle if apart else 0.5 * (low + high) for box in boxes]
    return [turn.T @ middle for turn, middle in zip(axes, middles, strict=True)], apart


def head_near(vertices: NDArray[np.floating], box: Box) -> NDArray[np.bool_]:
    """Which of a head's vertices (V, 3), in the box's axes, lie near enough to the hair to be framed, (V,)."""
    reach = min(HEAD_REACH * box.extent, HEAD_REACH_CM)
    return np.asarray(((vertices > box.low - reach) & (vertices < box.high + reach)).all(axis=1))


def _far(curves: Curves) -> NDArray[np.bool_]:
    """Strands that lie far from the rest, (S,)."""
    low = np.minimum.reduceat(curves.points, curves.offsets[:-1], axis=0).astype(np.float64)
    high = np.maximum.reduceat(curves.points, curves.offsets[:-1], axis=0).astype(np.float64)
    middle = np.median(0.5 * (low + high), axis=0)
    reach = np.max(np.maximum(high - middle, middle - low), axis=1)
    usual = np.quantile(reach, STRAY_RANK, method="lower")
    return np.asarray(reach > STRAY_REACH * usual)


def _somewhere(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """A place in the midst of the points, (3,), however many of them are broken."""
    sample = points[:: max(1, len(points) // POINTS_TO_PLACE_FROM)]
    sample = sample[np.isfinite(sample).all(axis=1)]
    return PLACES_CM * np.round(np.median(sample, axis=0) / PLACES_CM) if len(sample) else np.zeros(3)
