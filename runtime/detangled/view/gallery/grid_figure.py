"""Four styles by four textures: paper section "Results"."""

from __future__ import annotations

import numpy as np
from PIL import Image

from detangled.base_texture import Texture
from detangled.from_numbers import asked, asked_texture
from detangled.generation import generate
from detangled.retexturing import Options, retexture
from detangled.texture import hair_type
from detangled.view.gallery.figure import Drawn, Figure, Setting
from detangled.view.gallery.groom_panels import groom_panels, thinned
from detangled.view.gallery.sheet import FAINT, PAPER, beside, padded, page, scale_bar, stacked, words
from detangled.view.gallery.strands import AFTER, Box, box_around, standing_beside, strand_panel

TYPES = ("II", "IV", "VI", "VIII")
CELL = (286, 300)  # [px] of a figure 1600 px wide
STRANDS, LENGTH = 3, 15.0  # of a texture's own panel, [cm] of arc
DEPTH = 8.0  # [cm] of them that is shown
ROOM = 2.4  # [cm]


def draw(setting: Setting) -> Drawn:
    """Textures along the top, styles down the left, and each on each."""
    px = setting.px
    cell = (px(CELL[0]), px(CELL[1]))
    textures = [asked_texture(asked(hair_type(name))) for name in TYPES]
    tops = _texture_panels(textures, setting)
    setting.progress(len(TYPES))
    left = px(46)
    corner = Image.new("RGB", (left + cell[0], 1), PAPER)
    rows = [beside([corner, *tops], px(10), "end")]
    passed = points = 0
    for style in setting.styles()[:4]:
        groom = thinned(style, setting.strands)
        grooms = [groom]
        for texture in textures:
            result = retexture(groom, texture, Options(seed=setting.seed))
            grooms.append(result.groom)
            passed += len(result.passed_through)
            points += len(result.groom.points)
            setting.progress(1)
        panels = groom_panels(grooms, cell, style.head)
        name = padded(words(style.name, px(26)).rotate(90, expand=True), (left, panels[0].height))
        rows.append(beside([name, *panels], px(10)))
    image = page(stacked(rows, px(26)), setting.width, px(30))
    said = [f"At most {setting.strands} strands a style, {points / 1e6:.1f} million points in all."]
    if passed:
        said.append(f"{passed} strands could not be used and passed through.")
    return Drawn(image, tuple(said))


def _texture_panels(textures: list[Texture], setting: Setting) -> list[Image.Image]:
    """Strands of each texture and its name, in one scale, as wide as a cell."""
    px = setting.px
    stood = []
    for texture in textures:
        strands = generate(texture, STRANDS, LENGTH, setting.seed)
        upper = []
        for k in range(STRANDS):
            points = strands.strand(k) - strands.strand(k)[0]
            below = np.flatnonzero(points[:, 2] < -DEPTH)
            upper.append(points[: max(below[0] if len(below) else len(points), 2)])
        lengths = np.cumsum([0, *(len(one) for one in upper)])
        stood.append(standing_beside(np.concatenate(upper), lengths, ROOM, 1.0))
    half = 0.5 * max(box_around([groom]).width for groom in stood) + 0.3
    box = Box(-half, half, -DEPTH, 0.5)
    scale = px(CELL[0]) / box.width
    panels = []
    for name, groom in zip(TYPES, stood, strict=True):
        kind = hair_type(name)
        text = beside([words(name, px(30)), words(kind.walker, px(22), colour=FAINT)], px(12), "middle")
        panels.append(stacked([text, strand_panel([(groom, AFTER)], box, scale, px(2.6))], px(10)))
    bar = scale_bar(2.0, scale, px(18))
    last = panels[0]
    last.paste(bar, (0, last.height - bar.height))
    return panels


FIGURE = Figure(
    title="Four styles, four textures",
    caption="Each style (left) with each texture (above): the style's guides stay, and the strands on them are new. "
    "Grooms of a row are seen by one camera.",
    paper="the grid of styles and textures",
    short="These are guide strands alone, as in the paper's first grid; its second adds render hairs in Houdini.",
    steps=len(TYPES) * 5,
    draw=draw,
)
