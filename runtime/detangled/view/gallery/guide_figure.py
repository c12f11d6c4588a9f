"""How a strand's style guide is found, in four panels: paper section "Canonical Space & Style Guides"."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from detangled.from_numbers import asked, asked_texture
from detangled.geometry.centerline import centerlines
from detangled.groom import Groom
from detangled.grooming.guides import to_canonical
from detangled.retexturing import Options, retexture
from detangled.texture import Profile
from detangled.view.gallery.figure import Drawn, Figure, Setting
from detangled.view.gallery.sheet import FAINT, beside, padded, page, scale_bar, stacked, words
from detangled.view.gallery.strands import (
    AFTER,
    BEFORE,
    GUIDE,
    PLAIN,
    Box,
    box_around,
    strand_panel,
    with_line,
)

RADIUS, WAVELENGTH, TWIST = 0.5, 1.5, 0.06  # [cm], a coil whose axis the lowest frequencies miss, and can be seen to
LENGTH = 15.0  # [cm] along the guide
POINTS = 400


def bent() -> Groom:
    """A guide that leaves the scalp to the side, and falls in an S; z up."""
    t = np.linspace(0.0, 1.0, POINTS)
    angle = 0.85 * np.cos(1.3 * np.pi * t)  # from the vertical
    step = np.stack([np.sin(angle), 0.25 * np.sin(np.pi * t), -np.cos(angle)], axis=1) * LENGTH / POINTS
    return Groom(np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)[:-1]]), np.array([0, POINTS]), up="z")


def unevenness(canonical: NDArray[np.float64]) -> float:
    """How much a canonical strand's (n, 3) distance from its axis varies, as a share of its mean."""
    away = np.hypot(canonical[:, 0], canonical[:, 1])
    return float(away.std() / away.mean())


def draw(setting: Setting) -> Drawn:
    """World and rough centreline; straightened by it; straightened by the optimised one; world and style guide."""
    px = setting.px
    texture = asked_texture(asked(None, Profile((RADIUS,)), Profile((WAVELENGTH,)), TWIST))
    strand = retexture(bent(), texture, Options(seed=setting.seed)).groom
    setting.progress(1)
    guide, rough = centerlines(strand.points, strand.offsets)
    by_rough = Groom(to_canonical(strand.points, rough, strand.offsets), strand.offsets, up="z")
    by_guide = Groom(to_canonical(strand.points, guide, strand.offsets), strand.offsets, up="z")
    setting.progress(1)

    world = box_around([strand]).grown(0.3)
    straight = box_around([by_rough, by_guide])
    half = max(abs(straight.left), abs(straight.right)) + 0.3
    straight = Box(-half, half, straight.bottom - 0.3, straight.top + 0.3)
    column = px(356)
    scale = min(column / world.width, px(640) / straight.height)
    stroke, line = px(3.4), px(4)
    axis = np.array([[0.0, 0.0, straight.top], [0.0, 0.0, straight.bottom]])

    def world_panel(of: NDArray[np.float64]) -> Image.Image:
        return with_line(strand_panel([(strand, PLAIN)], world, scale, stroke), of, world, scale, GUIDE, line)

    def straight_panel(groom: Groom, colour: tuple[float, float, float]) -> Image.Image:
        panel = strand_panel([(groom, colour)], straight, scale, stroke)
        return with_line(panel, axis, straight, scale, GUIDE, px(2), px(9))

    uneven = [100.0 * unevenness(groom.points) for groom in (by_rough, by_guide)]
    panels = [
        (world_panel(rough), "a", "The strand, and the rough centreline of its lowest frequencies"),
        (straight_panel(by_rough, AFTER), "b", f"Straightened by it: distance to the axis varies by {uneven[0]:.0f} %"),
        (straight_panel(by_guide, BEFORE), "c", f"Straightened by the optimised centreline: by {uneven[1]:.0f} %"),
        (world_panel(guide), "d", "The optimised centreline in the world: the style guide"),
    ]
    height = max(panel.height for panel, _, _ in panels)
    blocks = []
    for panel, name, text in panels:
        described = stacked([words(f"({name})", px(24)), words(text, px(21), column, FAINT)], px(4))
        blocks.append(stacked([padded(panel, (0, height), upright="start"), described], px(16)))
        setting.progress(1)
    bar = scale_bar(2.0, scale, px(21))
    image = page(stacked([beside(blocks, px(24)), bar], px(20)), setting.width, px(30))
    return Drawn(
        image, (f"Beside its mean, the distance to the axis varies by {uneven[0]:.0f} % and {uneven[1]:.0f} %.",)
    )


FIGURE = Figure(
    title="Style guide extraction",
    caption="(a) A strand, and the centreline (blue) that the lowest frequencies of its segments give. (b) "
    "Straightened by it, the strand swings slowly about the axis. (c) The optimised centreline takes these swings "
    "away, and with them the style from the texture. (d) Mapped back to the world it is the style guide (blue).",
    paper="style guide extraction",
    short="The strand is one made by this program on a bent guide, not an artist's.",
    steps=6,
    draw=draw,
)
