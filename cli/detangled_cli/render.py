"""detangled render: a picture of one groom, of several side by side, or of a whole turn around them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import click

from detangled_cli.console import (
    announce_first_run,
    check_apart,
    file_names,
    note,
    progress_bar,
    quiet_option,
    threads_option,
    unit_option,
    warn,
)
from detangled_cli.heads import check_head_options, head_of, head_options
from detangled_cli.option_values import COLOUR, FiniteRange

if TYPE_CHECKING:
    from detangled.groom import Groom
    from detangled.view.colours import Colour
    from detangled.view.picture import Picture, Style

VIEWS = ("front", "side", "back", "top", "34")
COLOUR_BY = ("radius", "wavelength", "twist", "guide", "none")
LARGEST_PANEL_PX = 8192
MOST_PIXELS = 4 * LARGEST_PANEL_PX**2
MOST_FRAMES = 720
SAMPLES = 64  # paths of a pixel
WRONG_USAGE = 2


class ExtraMissing(click.ClickException):
    """What path tracing stands on is not installed."""

    exit_code = WRONG_USAGE


@click.command()
@click.argument("paths", metavar="IN [IN2 ...] OUT.png", nargs=-1, required=True, type=click.Path(path_type=Path))
@head_options("it is drawn under the hair.")
@click.option(
    "--view",
    type=click.Choice(VIEWS),
    default="34",
    show_default=True,
    help="From where to look; 34 is a three-quarter view.",
)
@click.option(
    "--zoom",
    type=FiniteRange(0.1, 100.0),
    default=1.0,
    metavar="F",
    help="Enlarge the middle of the picture this many times.",
)
@click.option(
    "--size",
    type=click.IntRange(64, LARGEST_PANEL_PX),
    default=1024,
    show_default=True,
    metavar="N",
    help="Width and height of each groom's panel in pixels.",
)
@click.option(
    "--colour",
    "--color",
    type=COLOUR,
    metavar="C",
    help="Hair colour: black, darkbrown, brown, lightbrown, auburn, red, blond, platinum, grey, white, #rrggbb, or "
    "amounts of eumelanin/pheomelanin such as 1.3 or 0.3/0.8.",
)
@click.option(
    "--colour-by",
    "--color-by",
    type=click.Choice(COLOUR_BY),
    default="none",
    help="Colour each strand by what detangled label reads, or by its guide, with a legend.",
)
@click.option(
    "--caption",
    "captions",
    multiple=True,
    metavar="TEXT",
    help="What to write under a groom; once for each. Default: file names, where there are several.",
)
@click.option(
    "--turntable",
    "frames",
    type=click.IntRange(2, MOST_FRAMES),
    metavar="N",
    help="A whole turn of N frames: OUT.gif, .webp or .apng, or OUT.png for numbered pictures.",
)
@click.option(
    "--quality",
    type=click.Choice(["fast", "path"]),
    default="fast",
    show_default=True,
    help="path: path tracing, minutes a picture (needs the extra: detangled[beauty]).",
)
@click.option(
    "--samples",
    type=click.IntRange(1, 65536),
    metavar="N",
    help=f"Paths traced for each pixel with --quality path. Default: {SAMPLES}.",
)
@unit_option
@threads_option
@quiet_option
def command(
    paths: tuple[Path, ...],
    head_source: Path | None,
    head_unit: str | None,
    head_group: str | None,
    view: str,
    zoom: float,
    size: int,
    colour: Colour | None,
    colour_by: str,
    captions: tuple[str, ...],
    frames: int | None,
    quality: str,
    samples: int | None,
    unit: str | None,
    threads: int | None,
) -> None:
    """Draw a groom as a picture, .png or .jpg.

    Several grooms are drawn side by side, with one camera, one light and one width of strand, so that
    they can be compared.

    \b
    Example:
      detangled render groom.abc groom.png
      detangled render before.abc after.abc comparison.png --view back --size 768
      detangled render groom.abc groom.png --head head.obj --colour auburn
      detangled render groom.abc radius.png --colour-by radius
      detangled render groom.abc turn.webp --turntable 48 --size 512
    """
    if len(paths) < 2:
        raise click.UsageError("name a groom and the picture to write: detangled render IN OUT.png")
    *sources, target = paths
    words = list(captions) or (file_names(sources) if len(sources) > 1 else [])
    if captions and len(captions) != len(sources):
        raise click.UsageError(f"{len(sources)} grooms need as many --caption, not {len(captions)}")
    if colour is not None and colour_by != "none":
        raise click.UsageError("--colour and --colour-by do not go together: name one")
    if samples is not None and quality != "path":
        raise click.UsageError("--samples goes with --quality path")
    samples = samples or SAMPLES
    if len(sources) * size**2 > MOST_PIXELS:
        most = int((MOST_PIXELS / len(sources)) ** 0.5)
        raise click.UsageError(f"{len(sources)} panels of {size} pixels are too many: give --size {most} or less")
    check_head_options(head_source, head_unit, head_group)
    check_apart(target, head_source, *sources)

    from detangled.formats import read
    from detangled.kernels import set_threads
    from detangled.view import animation, picture

    if frames is None:
        picture.check_target(target)
    else:
        animation.check_movie_target(target)
    if quality == "path":
        _need_mitsuba()
    grooms = []
    for source in sources:
        grooms.append(read(source, unit=unit))
        for sentence in grooms[-1].notes:
            warn(f"{source}: {sentence}")
    set_threads(threads)
    mesh = head_of(grooms[0], head_source, head_unit, head_group)
    style = picture.Style(zoom=zoom, quality=quality, samples=samples)
    style = _coloured(style, grooms, colour, colour_by)
    announce_first_run("detangled.view.rasteriser._colour")
    names = [str(source) for source in sources]
    if frames is None:
        with progress_bar("samples", samples * len(grooms)) if quality == "path" else nullcontext() as bar:
            drawn = picture.render(
                grooms, (size, size), view, words, names=names, head=mesh, head_name=str(head_source),
                style=style if bar is None else replace(style, progress=bar.update),
            )  # fmt: skip
        picture.save(drawn, target)
        _tell(drawn, str(target))
        return
    turn = picture.turntable(
        grooms, frames, (size, size), view, words, names=names, head=mesh, head_name=str(head_source), style=style
    )
    first = next(turn)
    with progress_bar("frames", frames) as bar:
        written = animation.save_movie(_counted(chain([first], turn), bar.update), target, frames)
    _tell(first, str(target) if len(written) == 1 else f"{written[0]} to {written[-1].name}")


def _need_mitsuba() -> None:
    from detangled.view import path_tracing

    try:
        path_tracing.load()
    except ModuleNotFoundError as error:
        raise ExtraMissing(str(error)) from error


def _coloured(style: Style, grooms: list[Groom], colour: Colour | None, by: str) -> Style:
    if colour is not None:
        return replace(style, look=replace(style.look, hair=colour))
    if by == "none":
        return style
    from detangled.view.colouring import strand_colours

    with progress_bar("strands read", sum(groom.strand_count for groom in grooms)) as bar:
        colours, legend = strand_colours(grooms, by, bar.update)
    return replace(style, colours=colours, legend=legend)


def _counted(pictures: Iterable[Picture], done: Callable[[int], object]) -> Iterator[Picture]:
    for picture in pictures:
        done(1)
        yield picture


def _tell(drawn: Picture, target: str) -> None:
    for sentence in drawn.notes:
        warn(sentence)
    note(f"{target}: strands drawn {drawn.strand_width:.3g} cm wide")
