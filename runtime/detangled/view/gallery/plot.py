"""A curve over an axis, drawn with Pillow: what a signal plot needs and no more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from detangled.view.gallery.sheet import FAINT, INK, PAPER, RULE, Colour, beside, stacked, words
from detangled.view.gallery.strands import OVERSAMPLED

SHADED = (243, 245, 250)


@dataclass(frozen=True)
class Curve:
    """x (n,) and y (n,), its colour, and the width of its line [px]."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    colour: Colour
    stroke: float


@dataclass(frozen=True)
class Axes:
    """Limits and ticks of a plot. level: a value that is marked by a dashed line. shaded: a part of x, marked."""

    x: tuple[float, float]
    y: tuple[float, float]
    x_ticks: tuple[float, ...] = ()
    y_ticks: tuple[float, ...] = ()
    level: float | None = None
    shaded: tuple[float, float] | None = None


def plot(curves: list[Curve], axes: Axes, size: tuple[int, int]) -> Image.Image:
    """Curves in a frame of ``size`` (width, height), with fine lines at the ticks of y, and no letters."""
    width, height = (OVERSAMPLED * side for side in size)
    image = Image.new("RGB", (width, height), PAPER)
    pen = ImageDraw.Draw(image)
    fine = OVERSAMPLED

    def across(x: NDArray[np.float64] | float) -> NDArray[np.float64]:
        return np.asarray((np.asarray(x) - axes.x[0]) / (axes.x[1] - axes.x[0]) * (width - 1))

    def down(y: NDArray[np.float64] | float) -> NDArray[np.float64]:
        return np.asarray((1.0 - (np.asarray(y) - axes.y[0]) / (axes.y[1] - axes.y[0])) * (height - 1))

    if axes.shaded is not None:
        left, right = (float(across(x)) for x in axes.shaded)
        pen.rectangle((left, 0, right, height), fill=SHADED)
    for tick in axes.y_ticks:
        y = float(down(tick))
        pen.line((0, y, width, y), fill=RULE, width=fine)
    for curve in curves:
        places = np.stack([across(curve.x), down(curve.y)], axis=1)
        pen.line(
            [(float(x), float(y)) for x, y in places],
            fill=curve.colour,
            width=max(1, round(OVERSAMPLED * curve.stroke)),
            joint="curve",
        )
    if axes.level is not None:
        y, dash = float(down(axes.level)), 9 * fine
        for x in range(0, width, 2 * dash):
            pen.line((x, y, x + dash, y), fill=INK, width=2 * fine)
    pen.line((0, 0, 0, height), fill=INK, width=2 * fine)
    pen.line((0, height - fine, width, height - fine), fill=INK, width=2 * fine)
    return image.resize(size, Image.Resampling.BOX)


def lettered(image: Image.Image, axes: Axes, title: str, letter: int, left: int, x_title: str = "") -> Image.Image:
    """A plot with its y ticks and title in ``left`` [px] before it, and, where ``x_title`` is given, x ticks below."""
    margin = Image.new("RGB", (left, image.height), PAPER)
    pen = ImageDraw.Draw(margin)
    for tick in axes.y_ticks:
        share = 1.0 - (tick - axes.y[0]) / (axes.y[1] - axes.y[0])
        label = words(f"{tick:g}", letter, colour=FAINT)
        y = round(share * (image.height - 1) - label.height / 2)
        if -letter // 4 <= y <= image.height - label.height + letter // 4:  # where it has room
            margin.paste(label, (left - label.width - letter // 2, y))
        pen.line((left - letter // 4, share * (image.height - 1), left, share * (image.height - 1)), fill=INK)
    name = words(title, letter).rotate(90, expand=True)
    margin.paste(name, (0, (image.height - name.height) // 2))
    whole = beside([margin, image])
    if not x_title:
        return whole
    ticks = Image.new("RGB", (whole.width, round(1.7 * letter)), PAPER)
    pen = ImageDraw.Draw(ticks)
    for tick in axes.x_ticks:
        x = left + (tick - axes.x[0]) / (axes.x[1] - axes.x[0]) * (image.width - 1)
        pen.line((x, 0, x, letter // 4), fill=INK, width=2)
        label = words(f"{tick:g}", letter, colour=FAINT)
        ticks.paste(label, (round(min(x - label.width / 2, whole.width - label.width)), letter // 3))
    below = words(x_title, letter, image.width)
    return stacked([whole, ticks, below], 0, "end")


def even_ticks(low: float, high: float, about: int = 4) -> tuple[float, ...]:
    """Round numbers from low to high, some ``about`` of them."""
    raw = (high - low) / max(about, 1)
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((1.0, 2.0, 5.0, 10.0), key=lambda s: abs(np.log(s * power / raw)))
    return tuple(float(round(k * step, 10)) for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1))
