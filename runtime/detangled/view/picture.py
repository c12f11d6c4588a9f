"""Pictures of grooms: several side by side, seen alike, with captions."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from detangled.errors import DetangledError, WriteError
from detangled.formats import check_folder, replacing
from detangled.groom import Groom
from detangled.head import Head
from detangled.view.camera import Camera, upright, view_turn
from detangled.view.curves import Curves
from detangled.view.lettering import CAPTION as CAPTION
from detangled.view.lettering import Legend, caption, font_size, with_legend
from detangled.view.lighting import light_grid
from detangled.view.rasteriser import NARROWEST_PX, draw
from detangled.view.shading import Look
from detangled.view.stage import Stage, natural_width, set_up
from detangled.view.surface import Surface

SEPARATOR_PX = 2
SEPARATOR = (168, 168, 171)
SUFFIXES = {".png": "PNG", ".jpg": "JPEG"}
QUALITIES = ("fast", "path")
SIDES_FRAMED = 12  # of a turntable


@dataclass(frozen=True)
class Picture:
    """pixels: (height, width, 3) uint8 sRGB. strand_width: as drawn [cm]. camera: the one of every panel.

    notes: what the viewer should know, a sentence each.
    """

    pixels: NDArray[np.uint8]
    strand_width: float
    camera: Camera
    notes: tuple[str, ...] = ()

    def image(self) -> Image.Image:
        return Image.fromarray(self.pixels)


@dataclass(frozen=True)
class Style:
    """How grooms are drawn.

    colours: linear RGB of every strand, (S, 3) for each groom, in place of the look's; legend: what they mean.
    zoom: how many times the middle is enlarged. quality: ``"fast"``, or ``"path"`` for path tracing with so many
    ``samples`` a pixel, which needs mitsuba; progress: told of finished ones.
    """

    look: Look = field(default_factory=Look)
    perspective: bool = True
    colours: Sequence[NDArray[np.floating]] | None = None
    legend: Legend | None = None
    zoom: float = 1.0
    quality: str = "fast"
    samples: int = 64
    progress: Callable[[int], object] | None = None


def render(
    grooms: Sequence[Groom],
    size: tuple[int, int] = (768, 768),
    view: str = "front",
    captions: Sequence[str] = (),
    *,
    names: Sequence[str] = (),
    perspective: bool = True,
    look: Look | None = None,
    head: Head | None = None,
    head_name: str = "the head",
    style: Style | None = None,
) -> Picture:
    """Draw grooms side by side with one camera, one light and one width of strand.

    size: (width, height) of each groom's panel in pixels. captions: none, or one for each groom.
    names: what error messages call the grooms, a file each for instance.
    view: ``"front"``, ``"side"``, ``"back"``, ``"top"`` or ``"34"``; up is each groom's own ``up`` axis.
    head: drawn under the grooms that it fits, in their frame; ``head_name`` is what messages call it.
    style: all else; ``perspective`` and ``look`` stand in for it where it is None.
    Points that are not finite and strands of fewer than two points are left out.
    Raises ReadError where a groom has no strand that can be drawn, DetangledError for wrong arguments.
    """
    style = style or Style(look or Look(), perspective)
    _check(grooms, captions)
    turn = view_turn(view)
    stage = set_up(grooms, names, head, head_name)
    camera = _camera(stage, [turn], size, captions, style)
    return _draw(stage, turn, camera, size, captions, style)


def turntable(
    grooms: Sequence[Groom],
    frames: int,
    size: tuple[int, int] = (768, 768),
    view: str = "front",
    captions: Sequence[str] = (),
    *,
    names: Sequence[str] = (),
    head: Head | None = None,
    head_name: str = "the head",
    style: Style | None = None,
) -> Iterator[Picture]:
    """The pictures of one turn about the vertical axis, from ``view`` on, under lights that stand still.

    All have one camera. The rest as for ``render``.
    """
    style = style or Style()
    _check(grooms, captions)
    stage = set_up(grooms, names, head, head_name)
    turns = [view_turn(view, 360.0 * k / frames) for k in range(frames)]
    camera = _camera(stage, turns[:: max(1, frames // SIDES_FRAMED)], size, captions, style)
    for turn in turns:
        yield _draw(stage, turn, camera, size, captions, style)


def save(image: Picture | Image.Image | NDArray[np.uint8], path: str | os.PathLike[str]) -> None:
    """Write a picture as .png or .jpg, beside its target first: an old file stays whole if this fails.

    Raises WriteError for another suffix, a folder that does not exist, or a disk that refuses.
    """
    path = Path(path)
    check_target(path)
    form = SUFFIXES[path.suffix.lower()]
    if isinstance(image, Picture):
        image = image.image()
    elif isinstance(image, np.ndarray):
        image = Image.fromarray(image)
    with replacing(path) as beside:
        image.save(beside, format=form, **({"quality": 94} if form == "JPEG" else {}))


def check_target(path: str | os.PathLike[str]) -> None:
    """Raise WriteError where ``save`` would refuse ``path``, so that nobody draws for nothing."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        moving = path.suffix.lower() in (".gif", ".webp", ".apng")
        hint = "; what moves is drawn with --turntable" if moving else ""
        raise WriteError(f"{path}: a picture's name must end in {' or '.join(SUFFIXES)}{hint}")
    check_folder(path)


def _check(grooms: Sequence[Groom], captions: Sequence[str]) -> None:
    if captions and len(captions) != len(grooms):
        raise DetangledError(f"{len(grooms)} grooms need {len(grooms)} captions or none, not {len(captions)}")


def _camera(
    stage: Stage, turns: Sequence[NDArray[np.float64]], size: tuple[int, int], captions: Sequence[str], style: Style
) -> Camera:
    foot = 2 * font_size(size) if any(captions) else 0
    camera = stage.camera(turns, size, perspective=style.perspective, foot=foot)
    return replace(camera, scale=style.zoom * camera.scale)


def _draw(
    stage: Stage,
    turn: NDArray[np.float64],
    camera: Camera,
    size: tuple[int, int],
    captions: Sequence[str],
    style: Style,
) -> Picture:
    """Every panel, seen by one camera about the stage's pivots."""
    panels, surfaces = stage.curves(turn), stage.surfaces(turn)
    most = max(len(curves.ids) for curves in panels)
    width = max(natural_width(most, stage.extent), NARROWEST_PX / camera.scale)
    image = Image.new("RGB", (len(panels) * size[0] + (len(panels) - 1) * SEPARATOR_PX, size[1]), SEPARATOR)
    for number, (curves, surface) in enumerate(zip(panels, surfaces, strict=True)):
        left = number * (size[0] + SEPARATOR_PX)
        pixels = _panel(stage, number, curves, surface, turn, camera, width, style)
        image.paste(Image.fromarray(pixels), (left, 0))
        if captions:
            caption(image, captions[number], left, size)
    if style.legend is not None:
        image = with_legend(image, style.legend, size)
    # As the first groom's own coordinates have it, turned.
    place = np.asarray(camera.centre) + turn @ upright(stage.grooms[0].up) @ stage.pivots[0]
    centre = (float(place[0]), float(place[1]), float(place[2]))
    return Picture(np.asarray(image).copy(), width, replace(camera, centre=centre), stage.notes)


def _panel(
    stage: Stage,
    number: int,
    curves: Curves,
    surface: Surface | None,
    turn: NDArray[np.float64],
    camera: Camera,
    width: float,
    style: Style,
) -> NDArray[np.uint8]:
    colours = None if style.colours is None else np.asarray(style.colours[number])
    if style.quality == "path":
        from detangled.view.path_tracing import trace_paths

        given = (curves, camera, width, style.look, style.samples)
        return trace_paths(*given, colours=colours, surface=surface, progress=style.progress)
    # By the groom's own width, so that neither the picture's size nor other grooms change its shadows.
    own = natural_width(len(curves.ids), stage.extent)
    light = light_grid(curves, own, stage.extent, stage.region(number, curves, turn), surface)
    return draw(curves, camera, light, width, style.look, colours=colours, surface=surface)
