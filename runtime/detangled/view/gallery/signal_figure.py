"""What strands are held as, and what the labelers read in it: paper section "Labeling Texture Parameters"."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.from_numbers import asked, asked_texture
from detangled.generation import generate
from detangled.geometry.arc import arc_lengths
from detangled.geometry.signal import signals
from detangled.groom import Groom
from detangled.grooming.guides import style_guides
from detangled.labeling import LOWER_PART, label, lower_signals
from detangled.texture import Profile
from detangled.view.gallery.figure import Drawn, Figure, Setting
from detangled.view.gallery.plot import Axes, Curve, even_ticks, lettered, plot
from detangled.view.gallery.sheet import FAINT, Colour, beside, page, scale_bar, stacked, words
from detangled.view.gallery.strands import PLAIN, Box, box_around, strand_panel

RADIUS, WAVELENGTH = 0.4, 1.2  # [cm]
TWISTS = (0.0, 0.45)
LENGTH = 26.0  # [cm] of arc
CELLS = 512
HIGHEST = 99.3  # percentile of curvature and of the size of torsion that plots reach to: twists are narrow spikes
BLUE: Colour = (38, 92, 214)
ORANGE: Colour = (214, 94, 20)
GREY: Colour = (70, 70, 78)


@dataclass(frozen=True)
class Measured:
    """A strand in canonical space, kappa, tau [1/cm] and v [cm], (CELLS, 3), and what was read in it.

    named: share of the arc from which on it is read.
    """

    strand: Groom
    values: NDArray[np.float64]
    length: float
    radius: float
    wavelength: float
    twist: float
    named: float


def measured(asked_twist: float, sample: int, seed: int) -> Measured:
    """Of so many new strands of this twist prevalence, the one in the middle by what is read of it."""
    texture = asked_texture(asked(None, Profile((RADIUS,)), Profile((WAVELENGTH,)), asked_twist))
    strands = generate(texture, sample, LENGTH, seed)
    found = label(strands)
    middle = int(np.argsort(found.twist, kind="stable")[sample // 2])
    groom = strands.select([middle])
    strand = Groom(style_guides(groom).canonical(), groom.offsets, up="z")
    values = signals(strand.points, strand.offsets, np.array([0, CELLS]))
    part = lower_signals(groom.points, groom.offsets).part[0]
    length = float(arc_lengths(strand.points, strand.offsets)[0])
    radius, wavelength, twist = (float(column[middle]) for column in (found.radius, found.wavelength, found.twist))
    return Measured(strand, values, length, radius, wavelength, twist, named=1.0 - LOWER_PART * float(part))


def draw(setting: Setting) -> Drawn:
    """A column for each strand: on its side, its three signals below, and its labels."""
    px = setting.px
    found = []
    for twist in TWISTS:
        found.append(measured(twist, setting.sample, setting.seed))
        setting.progress(1)
    letter, left = px(21), px(92)
    width = px(640)
    lying = [_lying(one.strand) for one in found]
    boxes = [box_around([groom]) for groom in lying]
    scale = width / (max(box.width for box in boxes) + 0.2)
    half = max(max(abs(box.bottom), abs(box.top)) for box in boxes) + 0.1
    every = np.concatenate([one.values for one in found])
    kappa = 1.06 * float(np.percentile(every[:, 0], HIGHEST))
    tau = 1.06 * float(np.percentile(np.abs(every[:, 1]), HIGHEST))
    speed = 1.25 * float(every[:, 2].max())
    limits = ((-0.07 * kappa, kappa), (-tau, tau), (-0.14 * speed, speed))
    names = ("curvature [1/cm]", "torsion [1/cm]", "speed [cm]")
    heights = (px(230), px(260), px(110))
    columns = []
    for number, (one, groom, twist) in enumerate(zip(found, lying, TWISTS, strict=True)):
        own = boxes[number]
        box = Box(own.left - 0.1, own.left - 0.1 + width / scale, -half, half)
        strand = strand_panel([(groom, PLAIN)], box, scale, px(3))
        helix = _helix(one)
        rows = []
        x = (np.arange(CELLS) + 0.5) / CELLS * one.length
        for k, colour in enumerate((BLUE, ORANGE, GREY)):
            axes = Axes(
                x=(0.0, one.length),
                y=limits[k],
                x_ticks=even_ticks(0.0, one.length, 6),
                y_ticks=even_ticks(*limits[k], 4 if k < 2 else 2),
                level=helix[k],
                shaded=(one.named * one.length, one.length),
            )
            image = plot([Curve(x, one.values[:, k], colour, px(2))], axes, (width, heights[k]))
            last = "arc length from the root [cm]" if k == 2 else ""
            rows.append(lettered(image, axes, names[k] if number == 0 else "", letter, left, last))
        heading = words(f"Asked for a twist prevalence of {twist:g}", px(26), width)
        read = words(
            f"read: radius {one.radius:.2f} cm, wavelength {one.wavelength:.2f} cm, twist {one.twist:.2f}",
            letter,
            width,
            FAINT,
        )
        columns.append(stacked([heading, read, strand, *rows], px(16), "end"))
        setting.progress(1)
    bar = scale_bar(2.0, scale, letter, "of the strands, which lie root to the left")
    image = page(stacked([beside(columns, px(30)), bar], px(26)), setting.width, px(30))
    read_all = "; ".join(f"{one.radius:.2f} cm, {one.wavelength:.2f} cm and {one.twist:.2f}" for one in found)
    return Drawn(
        image, (f"Asked for were radius {RADIUS:g} cm and wavelength {WAVELENGTH:g} cm; read were {read_all}.",)
    )


def _lying(strand: Groom) -> Groom:
    """A canonical strand on its side, its root to the left."""
    return Groom(strand.points[:, [2, 1, 0]] * [-1.0, 1.0, 1.0], strand.offsets, up="z")


def _helix(one: Measured) -> tuple[float, float, None]:
    """Curvature and torsion [1/cm] of the helix of the radius and wavelength that were read, wound as the strand is."""
    rise = one.wavelength / (2.0 * np.pi)
    square = one.radius**2 + rise**2
    hand = np.sign(np.median(one.values[:, 1]))
    return one.radius / square, float(hand * rise / square), None


FIGURE = Figure(
    title="Curvature, torsion and speed",
    caption="Two strands asked for with one radius and wavelength, without twists and with many; of a sample, the "
    "middle ones by the twist that is read. Each lies on its side, above the three signals that it is held as. Twists "
    "are spikes of torsion, and curvature falls where turns go missing. Dashed: curvature and torsion of the helix "
    "that the labelers read in the lower section (shaded). Spikes are cut off at the axes' ends.",
    paper="inferring texture parameters",
    short="The paper's is a flowchart of how the labelers are trained; this shows what they are given, and what they "
    "say.",
    steps=2 * len(TWISTS),
    draw=draw,
)
