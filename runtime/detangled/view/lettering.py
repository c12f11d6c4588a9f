"""Words and keys beside what is drawn: captions under panels, and what colours mean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from detangled.view.rasteriser import encoded

CAPTION = (58, 58, 62)
SMALLEST_FONT_PX = 13
LINES_IN_PICTURE = 34  # a line's height is the panel's over this


@dataclass(frozen=True)
class Legend:
    """What colours mean.

    title: what is coloured. colours: (n, 3) linear RGB from low to high; none where a title says all.
    ticks: places along the bar, 0 to 1, and what to write there.
    """

    title: str
    colours: NDArray[np.float64] | None = None
    ticks: tuple[tuple[float, str], ...] = ()


def font_size(size: tuple[int, int]) -> int:
    """Height of a letter [pixels] in a panel of ``size`` (width, height)."""
    return max(SMALLEST_FONT_PX, round(min(size) / LINES_IN_PICTURE))


def caption(image: Image.Image, text: str, left: int, size: tuple[int, int]) -> None:
    """Write one line at the foot of the panel that begins at ``left``, shortened where it is too long."""
    letters = font_size(size)
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(size=letters)
    room = size[0] - 2 * letters
    # A letter takes a pixel at least: what is longer need not be measured.
    shown = text if len(text) <= room else text[:room] + "…"
    while len(shown) > 1 and pen.textlength(shown, font=font) > room:
        shown = shown[:-2].rstrip() + "…"
    pen.text((left + size[0] / 2, size[1] - 1.1 * letters), shown, fill=CAPTION, font=font, anchor="mm")


def with_legend(image: Image.Image, legend: Legend, size: tuple[int, int]) -> Image.Image:
    """The image with a strip below it that says what its colours mean; ``size`` is that of one panel."""
    letters = font_size(size)
    small = max(SMALLEST_FONT_PX - 2, round(0.85 * letters))
    ground = image.getpixel((0, image.height - 1))
    whole = Image.new("RGB", (image.width, image.height + round(4.2 * letters)), ground)
    whole.paste(image, (0, 0))
    pen = ImageDraw.Draw(whole)
    top, middle = image.height + 0.5 * letters, image.width / 2
    font = ImageFont.load_default(size=letters)
    if legend.colours is None:
        pen.text((middle, top + 1.2 * letters), legend.title, fill=CAPTION, font=font, anchor="mm")
        return whole
    width = round(min(0.6 * image.width, 0.75 * size[0]))
    left, height = round(middle - width / 2), round(0.9 * letters)
    places = np.linspace(0.0, 1.0, width)
    knots = np.linspace(0.0, 1.0, len(legend.colours))
    row = np.stack([np.interp(places, knots, legend.colours[:, c]) for c in range(3)], axis=1)
    bar = np.repeat(encoded(row)[None], height, axis=0)
    pen.text((middle, top + 0.5 * letters), legend.title, fill=CAPTION, font=font, anchor="mm")
    y = round(top + 1.25 * letters)
    whole.paste(Image.fromarray(bar), (left, y))
    font = ImageFont.load_default(size=small)
    for place, words in legend.ticks:
        x = left + place * (width - 1)
        pen.line([(x, y + height), (x, y + height + 0.25 * letters)], fill=CAPTION)
        pen.text((x, y + height + 0.4 * letters), words, fill=CAPTION, font=font, anchor="mt")
    return whole
