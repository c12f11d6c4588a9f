"""Pictures of grooms: several side by side, seen alike, with captions."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from detangled.errors import DetangledError, ReadError, WriteError
from detangled.groom import Groom
from detangled.view.camera import Camera, frame, view_rotation
from detangled.view.curves import Curves, drawable
from detangled.view.lighting import light_grid
from detangled.view.rasteriser import NARROWEST_PX, draw
from detangled.view.shading import Look

# A head of 5,000 strands looks full at this width; at a hair's true 0.008 cm it would look transparent.
WIDTH_CM = 0.02
WIDTH_STRANDS = 5000
WIDTH_EXTENT_CM = 30.0
FEWEST_STRANDS = 200  # below this strands get no wider: a lone strand is not a rope

SEPARATOR_PX = 2
SEPARATOR = (168, 168, 171)
CAPTION = (58, 58, 62)
SUFFIXES = {".png": "PNG", ".jpg": "JPEG"}


@dataclass(frozen=True)
class Picture:
    """pixels: (height, width, 3) uint8 sRGB. strand_width: as drawn [cm]. camera: the one of every panel."""

    pixels: NDArray[np.uint8]
    strand_width: float
    camera: Camera

    def image(self) -> Image.Image:
        return Image.fromarray(self.pixels)


def render(
    grooms: Sequence[Groom],
    size: tuple[int, int] = (768, 768),
    view: str = "front",
    captions: Sequence[str] = (),
    *,
    names: Sequence[str] = (),
    perspective: bool = True,
    look: Look | None = None,
) -> Picture:
    """Draw grooms side by side with one camera, one light and one width of strand.

    size: (width, height) of each groom's panel in pixels. captions: none, or one for each groom.
    names: what error messages call the grooms, a file each for instance.
    view: ``"front"``, ``"side"``, ``"back"``, ``"top"`` or ``"34"``; up is each groom's own ``up`` axis.
    Points that are not finite and strands of fewer than two points are left out.
    Raises ReadError where a groom has no strand that can be drawn, DetangledError for wrong arguments.
    """
    if not grooms:
        raise DetangledError("there is no groom to draw")
    if captions and len(captions) != len(grooms):
        raise DetangledError(f"{len(grooms)} grooms need {len(grooms)} captions or none, not {len(captions)}")
    look = look or Look()
    panels = [drawable(groom, view_rotation(view, groom.up)) for groom in grooms]
    for number, curves in enumerate(panels, start=1):
        if len(curves.ids) == 0:
            name = names[number - 1] if names else f"groom {number}"
            raise ReadError(f"{name} has no strand of two distinct finite points, so there is nothing to draw")

    font_size = max(13, round(min(size) / 34))
    foot = 2 * font_size if any(captions) else 0
    camera = frame([curves.points for curves in panels], size, perspective=perspective, foot=foot)
    extent = _extent(panels)
    most = max(len(curves.ids) for curves in panels)
    width = max(natural_width(most, extent), NARROWEST_PX / camera.scale)

    full_width = len(panels) * size[0] + (len(panels) - 1) * SEPARATOR_PX
    image = Image.new("RGB", (full_width, size[1]), SEPARATOR)
    pen = ImageDraw.Draw(image)
    for number, curves in enumerate(panels):
        left = number * (size[0] + SEPARATOR_PX)
        # By the groom's own width, so that neither the picture's size nor other grooms change its shadows.
        light = light_grid(curves, natural_width(len(curves.ids), extent), extent)
        pixels = draw(curves, camera, light, width, look)
        image.paste(Image.fromarray(pixels), (left, 0))
        if captions:
            _caption(pen, captions[number], left, size, font_size)
    return Picture(np.asarray(image).copy(), width, camera)


def natural_width(strands: int, extent: float) -> float:
    """Width at which so many strands look full in a scene of size ``extent`` [cm]."""
    count = max(strands, FEWEST_STRANDS)
    return float(WIDTH_CM * np.sqrt(WIDTH_STRANDS / count) * extent / WIDTH_EXTENT_CM)


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
    beside = None
    try:
        handle, beside = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            image.save(file, format=form, **({"quality": 94} if form == "JPEG" else {}))
        _give_usual_mode(beside)
        os.replace(beside, path)
    except OSError as error:
        raise WriteError(f"{path}: could not be written ({error.strerror or error})") from error
    finally:
        if beside is not None and os.path.exists(beside):
            os.unlink(beside)


def check_target(path: str | os.PathLike[str]) -> None:
    """Raise WriteError where ``save`` would refuse ``path``, so that nobody draws for nothing."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise WriteError(f"{path}: a picture's name must end in {' or '.join(SUFFIXES)}")
    if not path.parent.is_dir():
        raise WriteError(f"{path}: the folder {path.parent} does not exist; make it first")


def _give_usual_mode(path: str) -> None:
    """A temporary file is private; a picture is as readable as any file its owner makes."""
    mask = os.umask(0)
    os.umask(mask)
    os.chmod(path, 0o666 & ~mask)


def _extent(panels: Sequence[Curves]) -> float:
    """Longest side of the box around everything, in camera axes [cm]."""
    low = np.min([curves.low for curves in panels], axis=0)
    high = np.max([curves.high for curves in panels], axis=0)
    return max(float(np.max(high - low)), 1e-3)


def _caption(pen: ImageDraw.ImageDraw, text: str, left: int, size: tuple[int, int], font_size: int) -> None:
    """Write one line at the foot of a panel, shortened with an ellipsis where it is too long."""
    font = ImageFont.load_default(size=font_size)
    room = size[0] - 2 * font_size
    shown = text
    while len(shown) > 1 and pen.textlength(shown, font=font) > room:
        shown = shown[:-2].rstrip() + "…"
    pen.text((left + size[0] / 2, size[1] - 1.1 * font_size), shown, fill=CAPTION, font=font, anchor="mm")
