"""New strands from two alone, by both engines: the paper's figure of small inputs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from PIL import Image

from detangled.diffusion.finetune import FineTuning
from detangled.fitted import FINETUNE, PATCHES
from detangled.fitting import fit
from detangled.generation import generate
from detangled.geometry.arc import arc_lengths
from detangled.groom import Groom
from detangled.library import load_library
from detangled.texture import hair_type
from detangled.view.gallery.figure import Drawn, Figure, Setting
from detangled.view.gallery.sheet import FAINT, beside, page, scale_bar, stacked, words
from detangled.view.gallery.strands import AFTER, BEFORE, Box, box_around, standing_beside, strand_panel

TYPE = "VI"
SHOWN = 5  # new strands of each engine
ARCS = (22.0, 36.0)  # [cm] that the two strands may have
ROOM, APART = 2.6, 1.0  # [cm]


def two_strands() -> Groom:
    """The two of the library's strands, of hair hung wet, that are most like a type and of like length; z up."""
    library = load_library()
    kind = hair_type(TYPE).parameters()
    near = library.nearest(kind.radius, kind.wavelength, kind.twist)
    near = near[(library.arcs[near] > ARCS[0]) & (library.arcs[near] < ARCS[1])]
    order = near[np.argsort(library.arcs[near], kind="stable")]
    apart = np.diff(library.arcs[order])
    first = int(np.argmin(apart))
    points, offsets = library.select(np.sort(order[first : first + 2]))
    return Groom(points, offsets, up="z")


def draw(setting: Setting) -> Drawn:
    """The two strands in green, and new ones of either engine in red, all in one scale."""
    px = setting.px
    two = two_strands()
    length = float(arc_lengths(two.points, two.offsets).mean())
    setting.progress(1)
    parts = [(two, BEFORE, "the two strands", "that are learned from")]
    usual = FineTuning(seed=setting.seed)
    tuning = replace(usual, few_steps=setting.training)
    for method, told in ((PATCHES, 1), (FINETUNE, setting.training)):
        done = [0]

        def step(number: int, most: int, loss: float, done: list[int] = done) -> None:
            setting.progress((STEPS_TRAINING * number) // most - done[0])
            done[0] = (STEPS_TRAINING * number) // most

        texture = fit(two, method, tuning, step)
        setting.progress(STEPS_TRAINING - done[0] if method == FINETUNE else 1)
        name = f"new strands, by {method}"
        note = "" if method == PATCHES else f"the network, trained on the two for {told} steps"
        parts.append((generate(texture, SHOWN, length, setting.seed), AFTER, name, note or "at once"))
        setting.progress(1)
    stood = [standing_beside(groom.points, groom.offsets, ROOM, APART) for groom, _, _, _ in parts]
    boxes = [box_around([groom]) for groom in stood]
    low, high = min(box.bottom for box in boxes) - 0.2, max(box.top for box in boxes) + 0.2
    gap = px(64)
    scale = (px(1540) - 2 * gap) / sum(box.width + 0.4 for box in boxes)
    blocks: list[Image.Image] = []
    for groom, own, (_, colour, name, note) in zip(stood, boxes, parts, strict=True):
        box = Box(own.left - 0.2, own.right + 0.2, low, high)
        panel = strand_panel([(groom, colour)], box, scale, px(3))
        text = stacked([words(name, px(24)), words(note, px(21), colour=FAINT)], px(4))
        blocks.append(stacked([panel, text], px(14)))
    bar = scale_bar(2.0, scale, px(21), f"every new strand {length:.1f} cm of arc")
    return Drawn(page(stacked([beside(blocks, gap), bar], px(26)), setting.width, px(30)))


STEPS_TRAINING = 20  # steps of progress that training is told as
FIGURE = Figure(
    title="Learning from two strands",
    caption="New strands (red) from two alone (green), by either engine. By patches, features of the two, such as "
    "breaks of the coil, sections that jut out and hooks, come back in other places and other sizes.",
    paper="a diverse set from two input strands",
    short="Patches does what the paper's figure shows. The network tends to repeat one of the two from "
    "root to tip. The two are strands simulated by this program, not an "
    "artist's.",
    steps=1 + 2 + STEPS_TRAINING + 1,
    draw=draw,
)
