"""Laying out a figure: blocks of pictures and words, beside each other and below each other, on white paper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from PIL import Image, ImageDraw, ImageFont

PAPER = (255, 255, 255)
INK = (34, 34, 38)
FAINT = (112, 112, 118)
RULE = (214, 214, 218)
LEADING = 1.34  # lines apart, in letters

Align = Literal["start", "middle", "end"]
Colour = tuple[int, int, int]


def words(
    text: str,
    size: int,
    width: int | None = None,
    colour: Colour = INK,
    align: Align = "middle",
) -> Image.Image:
    """Lines of letters ``size`` [px] high, wrapped at ``width`` and as wide; as wide as they are where it is None."""
    font = ImageFont.load_default(size=size)
    lines = _wrapped(text, font, width)
    needed = max(font.getlength(line) for line in lines)
    block = Image.new("RGB", (width or round(needed) + 2, round(LEADING * size * len(lines))), PAPER)
    pen = ImageDraw.Draw(block)
    anchor, x = {"start": ("lm", 0.0), "middle": ("mm", block.width / 2), "end": ("rm", block.width - 1.0)}[align]
    for number, line in enumerate(lines):
        y = (number + 0.5) * LEADING * size
        pen.text((x, y), line, fill=colour, font=font, anchor=anchor)
    return block


def _wrapped(text: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, width: int | None) -> list[str]:
    lines: list[str] = []
    for part in text.split("\n"):
        line = ""
        for word in part.split(" "):
            longer = f"{line} {word}" if line else word
            if width is not None and line and font.getlength(longer) > width:
                lines.append(line)
                line = word
            else:
                line = longer
        lines.append(line)
    return lines


def beside(blocks: Sequence[Image.Image], gap: int = 0, align: Align = "start") -> Image.Image:
    """Blocks from left to right, their tops, middles or feet aligned."""
    height = max(block.height for block in blocks)
    joined = Image.new("RGB", (sum(block.width + gap for block in blocks) - gap, height), PAPER)
    left = 0
    for block in blocks:
        joined.paste(block, (left, _shift(align, height - block.height)))
        left += block.width + gap
    return joined


def stacked(blocks: Sequence[Image.Image], gap: int = 0, align: Align = "middle") -> Image.Image:
    """Blocks from top to bottom, their left sides, middles or right sides aligned."""
    width = max(block.width for block in blocks)
    joined = Image.new("RGB", (width, sum(block.height + gap for block in blocks) - gap), PAPER)
    top = 0
    for block in blocks:
        joined.paste(block, (_shift(align, width - block.width), top))
        top += block.height + gap
    return joined


def padded(
    block: Image.Image, size: tuple[int, int], align: Align = "middle", upright: Align = "middle"
) -> Image.Image:
    """The block on paper of ``size`` (width, height), or of its own where that is larger."""
    width, height = max(size[0], block.width), max(size[1], block.height)
    paper = Image.new("RGB", (width, height), PAPER)
    paper.paste(block, (_shift(align, width - block.width), _shift(upright, height - block.height)))
    return paper


def page(block: Image.Image, width: int, margin: int) -> Image.Image:
    """A finished figure: the block in the middle of paper ``width`` wide."""
    return padded(block, (width, block.height + 2 * margin))


def rule(width: int, thickness: int) -> Image.Image:
    """A fine line across."""
    return Image.new("RGB", (width, thickness), RULE)


def scale_bar(cm: float, scale: float, size: int, note: str = "") -> Image.Image:
    """A bar of ``cm`` at ``scale`` [px/cm], its length beside it, and a note."""
    length = round(cm * scale)
    thick = max(2, size // 8)
    bar = Image.new("RGB", (length, size), PAPER)
    middle = size // 2
    pen = ImageDraw.Draw(bar)
    pen.rectangle((0, middle - thick // 2, length - 1, middle - thick // 2 + thick - 1), fill=INK)
    for end in (0, length - thick):
        pen.rectangle((end, middle - size // 3, end + thick - 1, middle + size // 3), fill=INK)
    text = f"{cm:g} cm" + (f"    {note}" if note else "")
    return beside([bar, words(text, size, colour=FAINT)], size // 2, "middle")


def _shift(align: Align, free: int) -> int:
    return {"start": 0, "middle": free // 2, "end": free}[align]
