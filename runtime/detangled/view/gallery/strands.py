"""Single strands in a figure: beside each other, in flat colours on white, at a scale that is told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageChops, ImageDraw

from detangled.groom import Groom
from detangled.view.camera import Camera, view_rotation
from detangled.view.curves import drawable
from detangled.view.gallery.sheet import Colour
from detangled.view.lighting import light_grid
from detangled.view.rasteriser import draw
from detangled.view.shading import Look

GAP = 0.6  # [cm] between strands, at least
APART = 1.5  # [cm] between their middles, at least
TURNS = np.linspace(0.0, np.pi, 36, endpoint=False)  # about the vertical, that a strand is tried at
WHITE = (1.0, 1.0, 1.0)
OVERSAMPLED = 4  # lines are drawn so many times larger

# Linear reflectance of strands, as the paper colours them: what was there, and what was made of it.
BEFORE = (0.035, 0.24, 0.085)
AFTER = (0.40, 0.055, 0.035)
PLAIN = (0.028, 0.031, 0.04)
GUIDE: Colour = (38, 92, 214)


@dataclass(frozen=True)
class Box:
    """What a panel shows, [cm] to the right and up."""

    left: float
    right: float
    bottom: float
    top: float

    @property
    def width(self) -> float:
        return self.right - self.left

    @property
    def height(self) -> float:
        return self.top - self.bottom

    def grown(self, margin: float) -> Box:
        return Box(self.left - margin, self.right + margin, self.bottom - margin, self.top + margin)


def standing_beside(points: ArrayLike, offsets: ArrayLike, room: float, apart: float = APART) -> Groom:
    """Strands (P, 3) [cm] in a row that do not cross, roots at one height, z up, the row's middle at 0.

    Each is turned about the vertical to be as wide as ``room`` [cm] has place for. Middles are ``apart`` or more.
    """
    points, offsets = np.asarray(points, dtype=np.float64), np.asarray(offsets, dtype=np.int64)
    placed = np.array(points)
    middle, edge = -apart, -np.inf
    for a, b in pairwise(offsets):
        own = placed[a:b] - points[a]
        across = own[:, :1] * np.cos(TURNS) - own[:, 1:2] * np.sin(TURNS)
        width = np.ptp(across, axis=0)
        turn = TURNS[np.argmax(np.where(width <= room, width, -width))]
        x = own[:, 0] * np.cos(turn) - own[:, 1] * np.sin(turn)
        y = own[:, 0] * np.sin(turn) + own[:, 1] * np.cos(turn)
        half = 0.5 * np.ptp(x)
        middle = max(middle + apart, edge + GAP + half)
        edge = middle + half
        placed[a:b] = np.stack([x - x.min() - half + middle, y - 0.5 * (y.min() + y.max()), own[:, 2]], axis=1)
    placed[:, 0] -= 0.5 * (placed[:, 0].min() + placed[:, 0].max())
    return Groom(placed, offsets, up="z")


def box_around(grooms: Sequence[Groom]) -> Box:
    """The box around grooms whose z-axis points up, seen from the front."""
    points = np.concatenate([groom.points for groom in grooms])
    return Box(
        float(points[:, 0].min()), float(points[:, 0].max()), float(points[:, 2].min()), float(points[:, 2].max())
    )


def strand_panel(
    layers: Sequence[tuple[Groom, tuple[float, float, float]]], box: Box, scale: float, stroke: float
) -> Image.Image:
    """Grooms with z up, each in its colour (linear RGB), seen from the front without perspective.

    scale: [px/cm]. stroke: width of a strand [px]. Where layers overlap the darker one is seen.
    """
    camera = camera_of(box, scale)
    width = stroke / scale
    panel = Image.new("RGB", (camera.width, camera.height), "white")
    for groom, colour in layers:
        curves = drawable(groom, view_rotation("front", "z"))
        light = light_grid(curves, width, max(box.width, box.height))
        look = Look(hair=colour, variation=0.0, sky_top=WHITE, sky_bottom=WHITE)
        panel = ImageChops.darker(panel, Image.fromarray(draw(curves, camera, light, width, look)))
    return panel


def with_line(
    panel: Image.Image,
    line: NDArray[np.float64],
    box: Box,
    scale: float,
    colour: Colour,
    stroke: float,
    dash: float = 0.0,
) -> Image.Image:
    """The panel with a line through points (n, 3) [cm] over it, ``stroke`` [px] wide, of dashes so long [px]."""
    large = panel.resize((panel.width * OVERSAMPLED, panel.height * OVERSAMPLED), Image.Resampling.NEAREST)
    pen = ImageDraw.Draw(large)
    places = OVERSAMPLED * camera_of(box, scale).project(line[:, [0, 2, 1]] * [1.0, 1.0, -1.0])
    wide = max(1, round(OVERSAMPLED * stroke))
    for part in _dashes(places, OVERSAMPLED * dash):
        pen.line([(float(x), float(y)) for x, y in part], fill=colour, width=wide, joint="curve")
    return large.resize(panel.size, Image.Resampling.BOX)


def with_dots(
    panel: Image.Image, points: NDArray[np.float64], box: Box, scale: float, colour: Colour, size: float
) -> Image.Image:
    """The panel with a dot, ``size`` [px] across, at each of the points (n, 3) [cm]."""
    large = panel.resize((panel.width * OVERSAMPLED, panel.height * OVERSAMPLED), Image.Resampling.NEAREST)
    pen = ImageDraw.Draw(large)
    half = 0.5 * OVERSAMPLED * size
    for x, y in OVERSAMPLED * camera_of(box, scale).project(points[:, [0, 2, 1]] * [1.0, 1.0, -1.0]):
        pen.ellipse((x - half, y - half, x + half, y + half), fill=colour)
    return large.resize(panel.size, Image.Resampling.BOX)


def camera_of(box: Box, scale: float) -> Camera:
    """The camera that sees a box [cm], with so many pixels a cm."""
    width, height = max(1, round(box.width * scale)), max(1, round(box.height * scale))
    centre = (0.5 * (box.left + box.right), 0.5 * (box.bottom + box.top), 0.0)
    return Camera(width, height, scale, 0.0, centre, (0.5 * width, 0.5 * height))


def _dashes(places: NDArray[np.float64], dash: float) -> list[NDArray[np.float64]]:
    if dash <= 0.0:
        return [places]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    starts = np.arange(0.0, along[-1], 2.0 * dash)
    at = np.clip(starts[:, None] + np.linspace(0.0, dash, 8), 0.0, along[-1])
    return [np.stack([np.interp(row, along, c) for c in places.T], axis=1) for row in at]
