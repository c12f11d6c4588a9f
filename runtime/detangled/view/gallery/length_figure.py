"""Strands made longer: paper section "Adjusting Strand Length", and how it is done here where it is much."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detangled.base_texture import Texture
from detangled.from_numbers import asked, asked_texture
from detangled.generation import generate
from detangled.geometry.arc import arc_lengths
from detangled.geometry.signal import signals
from detangled.groom import Groom, offsets_of
from detangled.grooming.guides import style_guides
from detangled.grooming.lengths import straightened
from detangled.texture import hair_type
from detangled.view.gallery.figure import Drawn, Figure, Setting
from detangled.view.gallery.sheet import FAINT, beside, page, scale_bar, stacked, words
from detangled.view.gallery.strands import AFTER, BEFORE, PLAIN, Box, box_around, standing_beside, strand_panel

TYPES = ("IV", "V", "VI", "VIII")
LENGTH = 15.0  # [cm] of arc
TIMES = 2.0
ROOM = 3.0  # [cm]
ROW_GAP = 0.5  # [cm]
CELLS = 512


@dataclass(frozen=True)
class Lengthened:
    """Strands of a texture: as they are, the same by TIMES with their speed scaled, and new ones drawn as long."""

    name: str
    short: Groom
    scaled: Groom
    drawn: Groom


def faster(groom: Groom, texture: Texture, times: float) -> Groom:
    """The strands with their speed signal multiplied, straightened again: curvature and torsion stay as they are."""
    canonical = style_guides(groom).canonical()
    starts = offsets_of(texture.grid_cells(arc_lengths(canonical, groom.offsets)))
    values = signals(canonical, groom.offsets, starts)
    values[:, 2] *= times
    made = straightened(values, starts, np.zeros(groom.strand_count, dtype=np.bool_), texture.axis)
    return Groom(made.points, made.offsets, up="z")


def lengthened(name: str, count: int, seed: int) -> Lengthened:
    """Strands of a hair type at LENGTH, and TIMES as long in both ways."""
    texture = asked_texture(asked(hair_type(name)))
    short = generate(texture, count, LENGTH, seed)
    return Lengthened(name, short, faster(short, texture, TIMES), generate(texture, count, TIMES * LENGTH, seed))


def draw(setting: Setting) -> Drawn:
    """For each texture a strand (green), the same at twice its speed (red), and a new one as long (dark)."""
    px = setting.px
    every = []
    for name in TYPES:
        every.append(lengthened(name, max(setting.sample, 1), setting.seed))
        setting.progress(1)
    stood = [
        [
            standing_beside(groom.select([0]).points, groom.select([0]).offsets, ROOM)
            for groom in (one.short, one.scaled, one.drawn)
        ]
        for one in every
    ]
    boxes = [[box_around([groom]) for groom in row] for row in stood]
    low = min(box.bottom for row in boxes for box in row) - 0.2
    high = max(box.top for row in boxes for box in row) + 0.2
    gap = px(70)
    whole = sum(box.width + ROW_GAP for row in boxes for box in row)
    scale = min((px(1500) - (len(TYPES) - 1) * gap) / whole, px(1100) / (high - low))
    blocks = []
    said = []
    for one, grooms, row in zip(every, stood, boxes, strict=True):
        panels = [
            strand_panel(
                [(groom, colour)], Box(own.left - ROW_GAP / 2, own.right + ROW_GAP / 2, low, high), scale, px(3)
            )
            for groom, own, colour in zip(grooms, row, (BEFORE, AFTER, PLAIN), strict=True)
        ]
        found = [bending(groom) for groom in (one.short, one.scaled, one.drawn)]
        setting.progress(1)
        text = "\n".join(f"{kappa:.2f}, {tau:.2f}" for kappa, tau in found)
        heading = words(f"type {one.name}", px(26))
        blocks.append(stacked([beside(panels), heading, words(text, px(20), colour=FAINT)], px(8)))
        scaled, drawn = (max(abs(b / a - 1.0) for a, b in zip(found[0], other, strict=True)) for other in found[1:])
        said.append(f"{one.name} {100.0 * scaled:.0f} % and {100.0 * drawn:.0f} %")
    free = (px(1540) - sum(block.width for block in blocks)) // (len(blocks) - 1)
    note = (
        f"green {LENGTH:g} cm of arc, red and dark {TIMES * LENGTH:g} cm; "
        "below, in that order, median curvature and torsion [1/cm]"
    )
    bar = scale_bar(5.0, scale, px(21), note)
    image = page(stacked([beside(blocks, min(free, 2 * gap)), bar], px(26)), setting.width, px(30))
    return Drawn(image, (f"Median curvature and torsion change by up to (scaled, drawn): {'; '.join(said)}.",))


def bending(groom: Groom) -> tuple[float, float]:
    """Median curvature and size of torsion [1/cm] of strands, their ends left out."""
    count = groom.strand_count
    starts = np.arange(count + 1, dtype=np.int64) * CELLS
    canonical = style_guides(groom).canonical()
    inner = signals(canonical, groom.offsets, starts).reshape(count, CELLS, 3)[:, CELLS // 12 : -CELLS // 12]
    return float(np.median(inner[:, :, 0])), float(np.median(np.abs(inner[:, :, 1])))


FIGURE = Figure(
    title="Lengthened strands",
    caption="Strands of four textures (green); the same ones twice as long, their speed multiplied by two (red), as in "
    "the paper; and new ones drawn twice as long (dark), as this program does it. Curvature and torsion per centimetre "
    "stay with either; but speed alone stretches twists and the wander of the axis too.",
    paper="strands beside their elongated versions",
    short="",
    steps=2 * len(TYPES),
    draw=draw,
)
