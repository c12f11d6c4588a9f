"""Whole grooms in a figure: a row of them seen alike, each as a block of its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image

from detangled.groom import Groom
from detangled.head import Head
from detangled.view.gallery.figure import Style
from detangled.view.gallery.strands import WHITE
from detangled.view.picture import SEPARATOR_PX, render
from detangled.view.shading import Look

NEARLY_WHITE = 250
ON_WHITE = Look(sky_top=WHITE, sky_bottom=WHITE)


def groom_panels(
    grooms: Sequence[Groom], size: tuple[int, int], head: Head | None = None, view: str = "34"
) -> list[Image.Image]:
    """Pictures of ``size`` (width, height) of grooms, with one camera, light and width of strand, on white.

    head: what they grow on, drawn where there is one.
    """
    drawn = render(grooms, size, view, look=ON_WHITE, head=head).image()
    step = size[0] + SEPARATOR_PX
    return trimmed([drawn.crop((k * step, 0, k * step + size[0], size[1])) for k in range(len(grooms))])


def trimmed(panels: Sequence[Image.Image]) -> list[Image.Image]:
    """Panels of one size without the rows above and below that are paper in all of them."""
    darkest = np.min([np.asarray(panel.convert("L")) for panel in panels], axis=0)
    rows = np.flatnonzero((darkest < NEARLY_WHITE).any(axis=1))
    if len(rows) == 0:
        return list(panels)
    return [panel.crop((0, int(rows[0]), panel.width, int(rows[-1]) + 1)) for panel in panels]


def thinned(style: Style, strands: int) -> Groom:
    """The style with at most so many strands, taken evenly, without attributes."""
    groom = style.groom
    if groom.strand_count > strands:
        groom = groom.select(np.linspace(0, groom.strand_count - 1, strands).round().astype(np.int64))
    return Groom(groom.points, groom.offsets, up=groom.up)
