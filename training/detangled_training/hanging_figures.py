"""Two figures of procedural strands hung wet: what twist prevalence looks like, and the eight types before and after.

Paper sections "Twist Prevalence" and "Simulation". What hangs has no contact: strands may go through themselves.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from detangled.errors import DetangledError
from detangled.groom import Groom
from detangled.texture import HAIR_TYPES, TextureParameters
from detangled.view.gallery.figure import Drawn, Figure, Setting
from detangled.view.gallery.sheet import FAINT, INK, beside, page, rule, scale_bar, stacked, words
from detangled.view.gallery.strands import (
    AFTER,
    BEFORE,
    PLAIN,
    Box,
    box_around,
    standing_beside,
    strand_panel,
    with_dots,
)
from detangled_training.hanging import Hung, hang
from detangled_training.material import Fibres
from detangled_training.strands import Recipes, Strands, make_strands
from detangled_training.variants import draw_fibres

# The words are ours, of what the paper's chart says of each.
TWISTS = {
    0.0: "Every turn is like the one before, as in a spring. Strands differ little from each other.",
    0.25: "Even turns, and rarely a break: a turn is missing, as if pulled out, and then all goes on as before.",
    0.5: "About half of the length winds evenly. Between are long pieces that follow no pattern.",
    0.75: "A few even turns can be made out. Most of the length bends this way and that.",
    1.0: "No two turns are alike. The strand curls differently everywhere, with some sharp kinks.",
}
# Tightly coiled: a turn takes 1.3 cm of arc, so that at 0.25 one comes in two turns, at 1 two in each. Twists are as
# many in a cm of any hair: in wide curls hardly a turn is without one at 0.25 already.
TWIST_TEXTURE = TextureParameters(0.2, 0.5)
TWIST_ARC = 26.0  # [cm], about 19 turns
IN_TWIST_PANEL = 4
TWIST_ROOM = 1.2

ARC = 15.0  # [cm] of every strand of the types
IN_PANEL = 2
ROOM = 3.2  # [cm] that a strand of the types may be wide, where it can be turned so
COLUMNS = 4
BETWEEN = 0.9  # [cm] between before and after


def strands_of(texture: TextureParameters, arc: float, count: int, seed: int, first: int = 0) -> Strands:
    """Strands alike but for their hands, where they begin on the circle, and their twists."""
    rng = np.random.default_rng([seed, first])
    hand, phase = np.where(rng.random(count) < 0.5, -1, 1), 2.0 * np.pi * rng.random(count)
    recipes = Recipes.asked(
        texture.radius, texture.wavelength, texture.twist, np.full(count, arc), hand, phase, first=first
    )
    return make_strands(recipes, seed)


def hung_wet(strands: Strands, fibres: Fibres, roll: NDArray[np.float64], name: str) -> Hung:
    """Strands hung wet. Raises DetangledError where one found no rest."""
    hung = hang(strands.points, strands.offsets, fibres, roll=roll)
    if not hung.converged.all():
        raise DetangledError(f"{name}: {np.count_nonzero(~hung.converged)} strands found no rest")
    return hung


def twisted_strands(seed: int) -> list[Groom]:
    """Strands of one texture at each of TWISTS, hung, standing beside each other."""
    grooms = []
    for twist in TWISTS:
        texture = TextureParameters(TWIST_TEXTURE.radius, TWIST_TEXTURE.wavelength, twist)
        strands = strands_of(texture, TWIST_ARC, IN_TWIST_PANEL, seed)
        hung = hung_wet(strands, Fibres.usual(IN_TWIST_PANEL), np.zeros(IN_TWIST_PANEL), f"twist {twist:g}")
        grooms.append(standing_beside(hung.points, hung.offsets, TWIST_ROOM))
    return grooms


def typed_strands(seed: int, count: int = IN_PANEL) -> list[tuple[Groom, Groom]]:
    """Strands of each type's mean numbers, as constructed and the same hung with fibres of their own."""
    pairs = []
    for index, kind in enumerate(HAIR_TYPES):
        strands = strands_of(kind.parameters(), ARC, count, seed, index * count)
        fibres, roll = draw_fibres(np.arange(index * count, (index + 1) * count), seed, 0)
        hung = hung_wet(strands, fibres, roll, f"type {kind.name}")
        made = standing_beside(strands.points, strands.offsets, ROOM)
        pairs.append((made, standing_beside(hung.points, hung.offsets, ROOM)))
    return pairs


def draw_twists(setting: Setting) -> Drawn:
    """The twist chart: a column for each prevalence, with its description below."""
    px = setting.px
    grooms = twisted_strands(setting.seed)
    setting.progress(1)
    around = box_around(grooms)
    half = max(abs(around.left), abs(around.right))
    box = Box(-half, half, around.bottom, around.top).grown(0.15)
    column, gap = px(284), px(30)
    scale = column / box.width
    blocks = []
    for (twist, text), groom in zip(TWISTS.items(), grooms, strict=True):
        panel = strand_panel([(groom, PLAIN)], box, scale, px(3))
        heading = words(f"{twist:g}", px(34), column)
        text_block = words(text, px(21), column, FAINT)
        blocks.append(stacked([panel, rule(column, px(1)), heading, text_block], px(10)))
        setting.progress(1)
    numbers = f"radius {10 * TWIST_TEXTURE.radius:g} mm, wavelength {10 * TWIST_TEXTURE.wavelength:g} mm"
    bar = scale_bar(2.0, scale, px(21), f"{numbers}, every strand {TWIST_ARC:g} cm of arc, hung wet")
    return Drawn(page(stacked([beside(blocks, gap), bar], px(34)), setting.width, px(30)))


def draw_hanging(setting: Setting) -> Drawn:
    """Each type before (green) and after (red) hanging, in two rows of four, all in one scale."""
    px = setting.px
    pairs = typed_strands(setting.seed)
    setting.progress(4)
    boxes = [[box_around([groom]) for groom in pair] for pair in pairs]
    widths = [sum(box.width for box in pair) + BETWEEN for pair in boxes]
    rows = [range(first, first + COLUMNS) for first in range(0, len(pairs), COLUMNS)]
    gap = px(54)
    room = 1600 - 2 * 40
    scale = min((px(room) - (COLUMNS - 1) * gap) / sum(widths[k] for k in row) for row in rows)
    blocks = []
    for row in rows:
        low = min(box.bottom for k in row for box in boxes[k])
        high = max(box.top for k in row for box in boxes[k])
        columns = []
        for k in row:
            panels = []
            for groom, own, colour in zip(pairs[k], boxes[k], (BEFORE, AFTER), strict=True):
                box = Box(own.left - 0.1, own.right + 0.1, low - 0.15, high + 0.2)
                panel = strand_panel([(groom, colour)], box, scale, px(3))
                panels.append(with_dots(panel, groom.points[groom.offsets[:-1]], box, scale, INK, px(9)))
            kind = HAIR_TYPES[k]
            both = beside(panels, round((BETWEEN - 0.4) * scale))
            columns.append(stacked([both, _type_words(kind.name, kind.walker, setting)], px(8)))
            setting.progress(1)
        free = px(room) - sum(column.width for column in columns)
        blocks.append(beside(columns, max(free // (COLUMNS - 1), px(10))))
    bar = scale_bar(
        5.0, scale, px(21), f"every strand {ARC:g} cm of arc; green as constructed, red hung wet by the dots"
    )
    said = []
    for name in ("IV", "VIII"):
        k = [kind.name for kind in HAIR_TYPES].index(name)
        grown = boxes[k][1].height / boxes[k][0].height
        said.append(f"type {name} hangs {grown:.2g} times as deep as it was made")
    text = "Here " + " and ".join(said) + "."
    return Drawn(page(stacked([*blocks, bar], px(36)), setting.width, px(30)), (text,))


def _type_words(name: str, walker: str, setting: Setting) -> Image.Image:
    return beside([words(name, setting.px(30)), words(walker, setting.px(22), colour=FAINT)], setting.px(12), "middle")


TWIST_CHART = Figure(
    title="Twist prevalence",
    caption="Strands of one texture at five twist prevalences, with what to look for. A value between two of these is "
    "fine.",
    paper="the chart of twist prevalence",
    short="",
    steps=1 + len(TWISTS),
    draw=draw_twists,
)
HANGING = Figure(
    title="Before and after hanging",
    caption="Strands of the eight types as they are constructed (green) and the same hung wet by their roots (red). "
    "Weight narrows and stretches the upper part most; twist angles are pulled straight, so that a turn seems to be "
    "missing; and where there are many, curvature, twist and weight make shapes that no turn explains.",
    paper="three strands before and after simulation",
    short="",
    steps=4 + len(HAIR_TYPES),
    draw=draw_hanging,
)
