"""The two pictures of docs/find-your-hair.md: the eight types, and what twist prevalence looks like.

python benchmarks/strand_sheets.py [--types OUT.png] [--twists OUT.png] [--seed 0]

--types draws strands of each type's mean radius, wavelength and twist prevalence, all of one length of arc: as they are
constructed, and the same hung wet, with fibres of their own. --twists draws one texture at five twist prevalences, hung
wet with fibres alike. A strand is turned about the vertical to fill its place, or fit into it; a picture has one scale.
What hangs has no contact: strands may go through themselves. Prints how deep strands hang.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from detangled import Groom
from detangled.texture import HAIR_TYPES
from detangled.view.picture import CAPTION, SEPARATOR, SEPARATOR_PX, render, save
from detangled.view.shading import Look
from detangled_training.hanging_figures import (
    ARC,
    TWIST_ARC,
    TWIST_TEXTURE,
    TWISTS,
    twisted_strands,
    typed_strands,
)

IN_PANEL = 3
COLUMNS = 4
TYPES_SIZE = (440, 700)  # [px] of a panel before its free rows are cut off
TWISTS_SIZE = (400, 640)

PAPER = (0.74, 0.745, 0.755)  # even, for panels are cut and joined
ROW_MARGIN = 0.5  # [cm] above and below the strands of a row
FONT_PX = 24
STRIP_PX = 48
COLOURS = 192  # of the files: hair and paper need no more


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--types", type=Path, metavar="OUT.png")
    parser.add_argument("--twists", type=Path, metavar="OUT.png")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    if not (options.types or options.twists):
        parser.error("there is nothing to draw: give --types, --twists or both")
    for draw, path in ((types_sheet, options.types), (twist_chart, options.twists)):
        if path:
            save(draw(options.seed).quantize(COLOURS, dither=Image.Dither.NONE), path)
            print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")
    return 0


def types_sheet(seed: int) -> Image.Image:
    """Four types beside each other: as constructed, below it hung, and below that the next four."""
    pairs = typed_strands(seed, IN_PANEL)
    for kind, (_, hung) in zip(HAIR_TYPES, pairs, strict=True):
        tell(f"type {kind.name}", hung)
    names = [f"{kind.name} ({kind.walker})" for kind in HAIR_TYPES]
    rows = []
    for first in range(0, len(HAIR_TYPES), COLUMNS):
        own = slice(first, first + COLUMNS)
        for which, state in enumerate(("as constructed", "hung wet")):
            rows.append(([pair[which] for pair in pairs[own]], [f"{name}, {state}" for name in names[own]]))
    note = f"every strand {ARC:g} cm of arc, all in one scale"
    return sheet(rows, TYPES_SIZE, note, bar=5.0)


def twist_chart(seed: int) -> Image.Image:
    """One texture at five twist prevalences, hung."""
    row = twisted_strands(seed)
    names = [f"T_f {twist:g}" for twist in TWISTS]
    for name, hung in zip(names, row, strict=True):
        tell(name, hung)
    note = (
        f"radius {10 * TWIST_TEXTURE.radius:g} mm, wavelength {10 * TWIST_TEXTURE.wavelength:g} mm, "
        f"every strand {TWIST_ARC:g} cm of arc, hung wet"
    )
    return sheet([(row, names)], TWISTS_SIZE, note, bar=2.0)


def tell(name: str, hung: Groom) -> None:
    """Say how deep strands hang."""
    deep = -np.minimum.reduceat(hung.points[:, 2], hung.offsets[:-1])
    print(f"{name:12}{'hangs to [cm]':>16}{''.join(f'{depth:7.1f}' for depth in deep)}", flush=True)


def sheet(rows: Sequence[tuple[list[Groom], list[str]]], size: tuple[int, int], note: str, bar: float) -> Image.Image:
    """Rows of grooms with their names below, in one scale, that a bar [cm] and a note at the foot tell."""
    picture = render(
        [groom for grooms, _ in rows for groom in grooms],
        size,
        perspective=False,
        look=Look(sky_top=PAPER, sky_bottom=PAPER),
    )
    drawn, camera = picture.image(), picture.camera
    paper = drawn.getpixel((0, 0))
    font = ImageFont.load_default(size=FONT_PX)
    step = size[0] + SEPARATOR_PX
    parts, done = [], 0
    for grooms, names in rows:
        left, right = done * step, (done + len(grooms)) * step - SEPARATOR_PX
        done += len(grooms)
        z = np.concatenate([groom.points[:, 2] for groom in grooms])
        ends = np.array([[0.0, z.max() + ROW_MARGIN, 0.0], [0.0, z.min() - ROW_MARGIN, 0.0]])
        top, bottom = np.round(camera.project(ends)[:, 1]).astype(int).clip(0, size[1])
        part = Image.new("RGB", (right - left, bottom - top + STRIP_PX), paper)
        part.paste(drawn.crop((left, top, right, bottom)), (0, 0))
        pen = ImageDraw.Draw(part)
        for k, name in enumerate(names):
            pen.text(((k + 0.5) * step, part.height - 0.5 * STRIP_PX), name, fill=CAPTION, font=font, anchor="mm")
            if k:
                pen.rectangle((k * step - SEPARATOR_PX, 0, k * step - 1, part.height), fill=SEPARATOR)
        parts.append(part)

    foot = Image.new("RGB", (parts[0].width, STRIP_PX), paper)
    pen = ImageDraw.Draw(foot)
    middle, length = STRIP_PX // 2, round(bar * camera.scale)
    text = f"{bar:g} cm;  {note}"
    begin = 0.5 * (foot.width - length - FONT_PX - pen.textlength(text, font=font))
    pen.rectangle((begin, middle - 2, begin + length, middle + 1), fill=CAPTION)
    pen.text((begin + length + FONT_PX, middle), text, fill=CAPTION, font=font, anchor="lm")
    parts.append(foot)

    joined = Image.new("RGB", (foot.width, sum(part.height + SEPARATOR_PX for part in parts) - SEPARATOR_PX), SEPARATOR)
    below = 0
    for part in parts:
        joined.paste(part, (0, below))
        below += part.height + SEPARATOR_PX
    print(f"{camera.scale:.1f} pixels per cm, strands {picture.strand_width:.3f} cm wide")
    return joined


if __name__ == "__main__":
    sys.exit(main())
