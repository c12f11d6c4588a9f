"""One number of a texture rising from left to right, the others as they are: the paper's supervision figure."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from PIL import Image

from detangled.from_numbers import DEFAULT_METHOD, asked, asked_texture
from detangled.generation import generate
from detangled.groom import Groom
from detangled.labeling import label
from detangled.models import ExportedModel
from detangled.texture import Profile, hair_type
from detangled.view.gallery.figure import Drawn, Figure, Setting
from detangled.view.gallery.sheet import FAINT, beside, padded, page, scale_bar, stacked, words
from detangled.view.gallery.strands import PLAIN, Box, box_around, standing_beside, strand_panel

SWEPT: dict[str, tuple[float, ...]] = {
    "radius": (0.2, 0.3, 0.42, 0.6, 0.8),
    "wavelength": (0.6, 0.9, 1.25, 1.8, 2.6),
    "twist": (0.0, 0.15, 0.3, 0.45, 0.6),
}
TYPE = "VI"  # of what is not swept
LENGTH = 24.0  # [cm] of arc
SHOWN = 3  # strands of a panel
DEPTH = 9.0  # [cm] of them that is shown
ROOM = 2.0  # [cm]


@dataclass(frozen=True)
class Step:
    """Strands that a value was asked for, and the medians of radius, wavelength [cm] and twist read in them."""

    name: str
    value: float
    strands: Groom
    read: dict[str, float]

    @property
    def swept(self) -> float:
        """What was read of the number that is swept."""
        return self.read[self.name]


def sweep_step(
    name: str,
    value: float,
    count: int,
    seed: int = 0,
    method: str = DEFAULT_METHOD,
    labelers: ExportedModel | None = None,
) -> Step:
    """``count`` strands of TYPE but for one number, and what labelers, ours where None, read in them."""
    usual = asked(hair_type(TYPE))
    numbers = {"radius": usual.radius, "wavelength": usual.wavelength, "twist": usual.twist}
    numbers[name] = value if name == "twist" else Profile((value,))
    strands = generate(asked_texture(asked(**numbers), method), count, LENGTH, seed)  # type: ignore[arg-type]
    found = label(strands, model=labelers)
    columns = zip(SWEPT, (found.radius, found.wavelength, found.twist), strict=True)
    return Step(name, value, strands, {one: float(np.nanmedian(column)) for one, column in columns})


def draw(setting: Setting) -> Drawn:
    """A row for each number, a panel for each value, all in one scale."""
    px = setting.px
    rows = []
    for name, values in SWEPT.items():
        row = []
        for value in values:
            row.append(sweep_step(name, value, max(setting.sample, SHOWN), setting.seed))
            setting.progress(1)
        rows.append(row)
    shown = [[_shown(step.strands) for step in row] for row in rows]
    half = 0.5 * max(box_around([groom]).width for row in shown for groom in row) + 0.15
    box = Box(-half, half, -DEPTH, 0.6)
    column = px(272)
    scale = column / box.width
    blocks = []
    for steps, grooms in zip(rows, shown, strict=True):
        panels = [_panel(step, groom, box, scale, setting) for step, groom in zip(steps, grooms, strict=True)]
        heading = words(steps[0].name, px(26)).rotate(90, expand=True)
        blocks.append(beside([padded(heading, (px(44), panels[0].height)), *panels], px(26)))
    bar = scale_bar(
        2.0, scale, px(21), f"the upper part of strands {LENGTH:g} cm long; read: medians of {setting.sample}"
    )
    image = page(stacked([*blocks, bar], px(34)), setting.width, px(30))
    return Drawn(image, tuple(_said(row) for row in rows))


def _panel(step: Step, groom: Groom, box: Box, scale: float, setting: Setting) -> Image.Image:
    unit = "" if step.name == "twist" else " cm"
    panel = strand_panel([(groom, PLAIN)], box, scale, setting.px(3))
    value = words(f"{step.value:g}{unit}", setting.px(26), panel.width)
    read = words(f"read {step.swept:.2f}{unit}", setting.px(21), panel.width, FAINT)
    return stacked([panel, value, read], setting.px(4))


def _shown(strands: Groom) -> Groom:
    """Some strands beside each other, without what hangs below the panel."""
    some = strands.select(np.arange(min(SHOWN, strands.strand_count)))
    upper = []
    for k in range(some.strand_count):
        points = some.strand(k) - some.strand(k)[0]
        below = np.flatnonzero(points[:, 2] < -DEPTH)
        upper.append(points[: below[0] if len(below) else len(points)])
    cut = Groom.from_strands(upper, up="z")
    return standing_beside(cut.points, cut.offsets, ROOM)


def _said(row: list[Step]) -> str:
    rises = all(b.swept > a.swept for a, b in pairwise(row))
    away = max(abs(step.swept - step.value) for step in row)
    unit = "" if row[0].name == "twist" else " cm"
    return (
        f"The {row[0].name} that is read {'rises' if rises else 'does not rise'}, at most {away:.2g}{unit} from asked."
    )


FIGURE = Figure(
    title="Texture from numbers",
    caption=f"From type {TYPE}, radius, wavelength and twist prevalence each rise from left to right, the other two "
    "held. Below each panel: what was asked for, and what the labelers read.",
    paper="the efficacy of guidance",
    short="Strands are drawn by the default method, the library, and not by the pretrained network under guidance; and "
    "they are settled to radius and wavelength by the very labelers that read them here "
    "(benchmarks/sweeps.py has others read them). Twist rises to 0.6 only: beyond, the library has no strands of "
    f"type {TYPE}'s slope, and asked for more it gives steeper coils that twist no oftener.",
    steps=sum(len(values) for values in SWEPT.values()),
    draw=draw,
)
