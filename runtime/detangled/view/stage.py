"""What is put before the camera: grooms and a head, each where it belongs, and how large they are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.errors import DetangledError, ReadError
from detangled.groom import Groom
from detangled.grooming.head_fit import misfit
from detangled.head import Head
from detangled.usable import WHY_UNDRAWN
from detangled.view.camera import Camera, frame, upright
from detangled.view.curves import Curves, drawable
from detangled.view.framing import Box, framed_points, hair_box, head_near, pivots
from detangled.view.surface import Surface, drawable_surface

# A head of 5,000 strands looks full at this width; at a hair's true 0.008 cm it would look transparent.
WIDTH_CM = 0.02
WIDTH_STRANDS = 5000
WIDTH_EXTENT_CM = 30.0
FEWEST_STRANDS = 200  # below this strands get no wider: a lone strand is not a rope
POINTS_FRAMED = 20_000  # of a groom, where it is framed from many sides


@dataclass(frozen=True)
class Stage:
    """Grooms to be drawn side by side, each turned about its pivot, which lies at the origin of the camera axes.

    pivots: (3,) each in the groom's own axes [cm]. heads: the head under each groom, or None.
    extent: [cm] longest side of the box around all. notes: what the viewer should know, a sentence each.
    """

    grooms: tuple[Groom, ...]
    boxes: tuple[Box, ...]
    pivots: tuple[NDArray[np.float64], ...]
    heads: tuple[Head | None, ...]
    extent: float
    notes: tuple[str, ...]

    def curves(self, turn: NDArray[np.float64]) -> list[Curves]:
        """Strands in camera axes, seen by a camera turned so (``view_turn``)."""
        return [drawable(g, turn @ upright(g.up), pivot) for g, pivot in zip(self.grooms, self.pivots, strict=True)]

    def surfaces(self, turn: NDArray[np.float64]) -> list[Surface | None]:
        """The head under each groom, in the same axes."""
        return [
            None if head is None else drawable_surface(head, turn @ upright(groom.up), pivot)
            for groom, pivot, head in zip(self.grooms, self.pivots, self.heads, strict=True)
        ]

    def framed(self, curves: Sequence[Curves], turn: NDArray[np.float64]) -> list[NDArray[np.floating]]:
        """Points to be in the picture, (n, 3) each in camera axes: the hair without strays, and the head near it."""
        hair = [framed_points(c, box.strays) for c, box in zip(curves, self.boxes, strict=True)]
        return [*hair, *self._head_points(turn)]

    def region(
        self, number: int, curves: Curves, turn: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Corners of the box around one groom and the head near it, (3,) each in camera axes."""
        hair: NDArray[np.floating] = framed_points(curves, self.boxes[number].strays)
        clouds = [hair, *self._head_points(turn, number)]
        return (
            np.min([cloud.min(axis=0) for cloud in clouds], axis=0).astype(np.float64),
            np.max([cloud.max(axis=0) for cloud in clouds], axis=0).astype(np.float64),
        )

    def camera(
        self,
        turns: Sequence[NDArray[np.float64]],
        size: tuple[int, int],
        *,
        perspective: bool = True,
        foot: int = 0,
    ) -> Camera:
        """One camera that shows everything however the stage is turned."""
        clouds: list[NDArray[np.floating]] = []
        for turn in turns:
            for cloud in self.framed(self.curves(turn), turn):
                clouds.append(cloud if len(turns) == 1 else cloud[:: max(1, len(cloud) // POINTS_FRAMED)])
        return frame(clouds, size, perspective=perspective, foot=foot)

    def _head_points(self, turn: NDArray[np.float64], number: int | None = None) -> list[NDArray[np.float64]]:
        """Points of a head's triangles near the hair, (n, 3) in camera axes, for one groom or for all."""
        found = []
        for k, (groom, head) in enumerate(zip(self.grooms, self.heads, strict=True)):
            if head is None or number not in (None, k):
                continue
            axes = upright(groom.up)
            vertices = head.vertices[np.unique(head.faces)]
            vertices = vertices[np.isfinite(vertices).all(axis=1)] @ axes.T
            near = vertices[head_near(vertices, self.boxes[k])]
            if len(near):
                found.append((near - axes @ self.pivots[k]) @ turn.T)
        return found


def set_up(
    grooms: Sequence[Groom], names: Sequence[str] = (), head: Head | None = None, head_name: str = "the head"
) -> Stage:
    """Put grooms side by side and a head under those that it fits.

    Raises ReadError where a groom has no strand that can be drawn, or the head fits none of them; DetangledError where
    there is no groom.
    """
    if not grooms:
        raise DetangledError("there is no groom to draw")
    boxes, notes = [], []
    for number, groom in enumerate(grooms, start=1):
        name = names[number - 1] if names else f"groom {number}"
        box = hair_box(groom)
        if box is None:
            raise ReadError(f"{name} has {WHY_UNDRAWN}, so there is nothing to draw")
        if len(box.strays):
            notes.append(
                f"{name}: {len(box.strays)} strands reach far beyond the others; the picture is framed without them"
            )
        boxes.append(box)
    axes = [upright(groom.up) for groom in grooms]
    places, apart = pivots(boxes, axes)
    if apart:
        notes.append("the grooms lie far apart: each is drawn in the middle of its panel, all at one scale")
        extent = max(box.extent for box in boxes)
    else:
        extent = float(np.max(np.max([b.high for b in boxes], axis=0) - np.min([b.low for b in boxes], axis=0)))
    heads: list[Head | None] = [None] * len(grooms)
    if head is not None:
        misfits = [misfit(head, groom) for groom in grooms]
        if all(misfits):
            raise ReadError(f"{head_name}: {misfits[0]}")
        heads = [None if why else head for why in misfits]
        for number, why in enumerate(misfits, start=1):
            if why:
                name = names[number - 1] if names else f"groom {number}"
                notes.append(f"{name} is drawn without the head: {head_name}: {why}")
    return Stage(tuple(grooms), tuple(boxes), tuple(places), tuple(heads), max(extent, 1e-3), tuple(notes))


def natural_width(strands: int, extent: float) -> float:
    """Width at which so many strands look full in a scene of size ``extent`` [cm]."""
    count = max(strands, FEWEST_STRANDS)
    return float(WIDTH_CM * np.sqrt(WIDTH_STRANDS / count) * extent / WIDTH_EXTENT_CM)
