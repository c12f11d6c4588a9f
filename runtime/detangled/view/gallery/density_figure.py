"""A groom given tighter curls with its guides as dense as they were, and denser: paper, "Style guide resampling"."""

from __future__ import annotations

from dataclasses import replace

from PIL import Image

from detangled.from_numbers import asked, asked_texture
from detangled.groom import Groom
from detangled.grooming.density import density_change
from detangled.grooming.density_resampling import resampled
from detangled.grooming.guides import guides_groom, style_guides
from detangled.retexturing import Options, retexture
from detangled.texture import hair_type
from detangled.view.gallery.figure import Drawn, Figure, Setting
from detangled.view.gallery.groom_panels import groom_panels, thinned
from detangled.view.gallery.sheet import FAINT, PAPER, beside, page, stacked, words

WIDE, TIGHT = "IV", "VI"  # of the groom as it comes, and as it is made
SPARSE = 0.75  # of a style's strands: each then stands for a curl
CELL = (480, 500)  # [px] of a figure 1600 px wide


def denser(groom: Groom, radius: float, seed: int) -> tuple[Groom, float, float]:
    """The groom with as many guides as a texture of this radius [cm] needs.

    And how many times as many that should be, and the share of the scalp where none is added, as neighbours diverge.
    """
    guides = style_guides(groom)
    change = density_change(guides, radius)
    made = resampled(groom, guides, change.factor, seed=seed)
    return made.groom, change.factor, made.refused


def draw(setting: Setting) -> Drawn:
    """Below: a groom of wide curls, its guides, tight curls on them. Above: denser guides, tight curls on those."""
    px = setting.px
    cell = (px(CELL[0]), px(CELL[1]))
    style = setting.styles()[1]
    plain = thinned(style, max(round(SPARSE * setting.strands), 8))
    wide = retexture(plain, asked_texture(asked(hair_type(WIDE))), Options(seed=setting.seed)).groom
    setting.progress(1)
    texture = asked_texture(asked(hair_type(TIGHT)))
    # Another seed: the same numbers would lead two textures along like paths.
    options = Options(seed=setting.seed + 1)
    kept = retexture(wide, texture, options).groom
    setting.progress(1)
    more, factor, refused = denser(wide, texture.radius, setting.seed)
    setting.progress(1)
    dense = retexture(replace(more, attributes={}), texture, options).groom
    setting.progress(1)
    grooms = [wide, guides_groom(wide), kept, guides_groom(more), dense]
    panels = groom_panels(grooms, cell, style.head)
    names = (
        f"the groom, of wide curls: {wide.strand_count} strands",
        "its style guides",
        "tight curls on them",
        f"{more.strand_count} guides, {more.strand_count / wide.strand_count:.1f} times as many",
        "tight curls on these",
    )
    blocks = [
        stacked([panel, words(name, px(22), cell[0], FAINT)], px(6)) for panel, name in zip(panels, names, strict=True)
    ]
    blank = Image.new("RGB", (cell[0], 1), PAPER)
    upper = beside([blank, blocks[3], blocks[4]], px(20))
    lower = beside(blocks[:3], px(20))
    said = f"From {wide.strand_count} to {more.strand_count} guides; by the radii {factor:.1f} times as many"
    if refused > 0.0:
        said += f", but over {100.0 * refused:.0f} % of the scalp neighbours diverge too much"
    image = page(stacked([upper, lower], px(30)), setting.width, px(30))
    return Drawn(image, (f"{said}.",))


FIGURE = Figure(
    title="Density kept and resampled",
    caption="A groom of wide curls, one guide a curl (below, left), its style guides (middle), and tight curls on "
    "them, which leave gaps (right). Above: as many guides as the new radius needs, and the same tight curls on those.",
    paper="style guide resampling",
    short="",
    steps=4,
    draw=draw,
)
