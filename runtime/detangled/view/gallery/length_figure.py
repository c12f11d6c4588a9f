"""Strands made longer: paper section "Adjusting Strand Length", and how it is done here where it is much."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detangled.asked import asked, asked_texture
from detangled.base_texture import Texture
from detangled.generation import generate
from detangled.geometry.arc import arc_lengths
from detangled.geometry.signal import signals
from detangled.groom import Groom, offsets_of
from detangled.grooming.guides import style_guides
from detangled.grooming.lengths import canonical_strands
from detangled.labeling import label
from detangled.texture import hair_type
from detangled.view.gallery.figure import Drawn, Figure, Setting
from detangled.view.gallery.sheet import FAINT, beside, page, scale_bar, stacked, words
from detangled.view.gallery.strands import AFTER, BEFORE, PLAIN, Box, box_around, standing_beside, strand_panel

TYPES = ("III", "V", "VI", "VIII")
LENGTH = 12.0  # [cm] of arc
TIMES = 2.0
ROOM = 3.0  # [cm]
ROW_GAP = 0.5  # [cm]


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
    count = groom.strand_count
    straight, dropped = np.zeros(count, dtype=np.bool_), np.zeros(count)
    points, offsets = canonical_strands(values, starts, straight, dropped, texture.wave_turn)
    return Groom(points, offsets, up="z")


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
        read = [_read(groom) for groom in (one.short, one.scaled, one.drawn)]
        setting.progress(1)
        text = "\n".join(f"{radius:.2f}, {wavelength:.2f} cm" for radius, wavelength in read)
        heading = words(f"type {one.name}", px(26), bold=True)
        blocks.append(stacked([beside(panels), heading, words(text, px(20), colour=FAINT)], px(8)))
        away = max(abs(b / a - 1.0) for other in read[1:] for a, b in zip(read[0], other, strict=True))
        said.append(f"{one.name} {100.0 * away:.0f} %")
    free = (px(1540) - sum(block.width for block in blocks)) // (len(blocks) - 1)
    note = f"green {LENGTH:g} cm of arc, red and dark {TIMES * LENGTH:g} cm; below, radius and wavelength read, in that order"
    bar = scale_bar(5.0, scale, px(21), note)
    image = page(stacked([beside(blocks, min(free, 2 * gap)), bar], px(26)), setting.width, px(30))
    return Drawn(image, (f"Radius and wavelength that are read change by up to: {', '.join(said)}.",))


def _read(groom: Groom) -> tuple[float, float]:
    found = label(groom)
    return float(np.nanmedian(found.radius)), float(np.nanmedian(found.wavelength))


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
