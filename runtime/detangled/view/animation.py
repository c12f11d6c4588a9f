"""Pictures in a row, as one animated file or as numbered ones."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from PIL import Image, features

from detangled.errors import WriteError
from detangled.formats import check_folder, replacing
from detangled.view.picture import SUFFIXES as STILL
from detangled.view.picture import Picture, save

MOVING = {".gif": "GIF", ".webp": "WEBP", ".apng": "PNG"}
SECONDS = 6.0  # of a turn
SHORTEST_MS = 20  # browsers slow down what is shorter
MOST_BYTES = 2_000_000_000  # of all frames together: Pillow holds them until a file that moves is written


def check_movie_target(path: str | os.PathLike[str]) -> None:
    """Raise WriteError where ``save_movie`` would refuse ``path``, so that nobody draws for nothing."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in MOVING and suffix not in STILL:
        raise WriteError(
            f"{path}: a turntable's name must end in {', '.join(MOVING)}, "
            f"or for numbered frames in {' or '.join(STILL)}"
        )
    if suffix == ".webp" and not features.check("webp"):
        raise WriteError(f"{path}: this Pillow was built without WebP; write a .gif or .apng")
    check_folder(path)


def save_movie(pictures: Iterable[Picture], path: str | os.PathLike[str], frames: int) -> list[Path]:
    """Write the frames of a turn, and return the files: one that plays in a loop, or one for each frame.

    ``out.png`` becomes ``out_0001.png`` and so on. Frames are drawn as they are written.
    Raises WriteError as ``check_movie_target`` does, where frames that move would take more than MOST_BYTES of memory,
    before the second one is drawn, or where the disk refuses.
    """
    path = Path(path)
    check_movie_target(path)
    suffix = path.suffix.lower()
    if suffix in STILL:
        written = []
        for number, picture in enumerate(pictures, start=1):
            written.append(path.with_name(f"{path.stem}_{number:0{max(4, len(str(frames)))}}{path.suffix}"))
            save(picture, written[-1])
        return written
    images = _images(pictures, palette=suffix == ".gif")
    options: dict[str, object] = {"duration": max(SHORTEST_MS, round(1000 * SECONDS / frames)), "loop": 0}
    if suffix == ".webp":
        options |= {"quality": 88, "method": 4}
    with replacing(path) as beside:
        first = next(images)
        taken = 3 * first.width * first.height * frames
        if taken > MOST_BYTES:
            raise WriteError(
                f"{path}: {frames} frames of {first.width} x {first.height} pixels would take {taken / 1e9:.1f} GB of "
                f"memory, of at most {MOST_BYTES / 1e9:g}: draw fewer or smaller ones, or numbered .png files"
            )
        # Pillow goes over the frames of a PNG twice.
        rest = list(images) if suffix == ".apng" else images
        first.save(beside, format=MOVING[suffix], save_all=True, append_images=rest, **options)
    return [path]


def _images(pictures: Iterable[Picture], palette: bool) -> Iterator[Image.Image]:
    """Images, for a GIF in the colours of the first one: a palette of each frame's own would flicker."""
    common: Image.Image | None = None
    for picture in pictures:
        image = picture.image()
        if palette:
            common = common or image.quantize(colors=255, method=Image.Quantize.MEDIANCUT)
            image = image.quantize(palette=common, dither=Image.Dither.FLOYDSTEINBERG)
        yield image
