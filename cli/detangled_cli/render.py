"""detangled render: a picture of one groom, or of several side by side."""

from __future__ import annotations

from pathlib import Path

import click

from detangled_cli.console import (
    announce_first_run,
    note,
    quiet_option,
    threads_option,
    unit_option,
    warn,
)

VIEWS = ("front", "side", "back", "top", "34")
LARGEST_PANEL_PX = 8192


@click.command()
@click.argument("paths", metavar="IN [IN2 ...] OUT.png", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--view",
    type=click.Choice(VIEWS),
    default="34",
    show_default=True,
    help="From where to look; 34 is a three-quarter view.",
)
@click.option(
    "--size",
    type=click.IntRange(64, LARGEST_PANEL_PX),
    default=1024,
    show_default=True,
    metavar="N",
    help="Width and height of each groom's panel in pixels.",
)
@unit_option
@threads_option
@quiet_option
def command(paths: tuple[Path, ...], view: str, size: int, unit: str | None, threads: int | None) -> None:
    """Draw a groom as a picture, .png or .jpg.

    Several grooms are drawn side by side, with one camera, one light and one width of strand, so that
    they can be compared.

    \b
    Example:
      detangled render groom.abc groom.png
      detangled render before.abc after.abc comparison.png --view back --size 768
    """
    if len(paths) < 2:
        raise click.UsageError("name a groom and the picture to write: detangled render IN OUT.png")
    *sources, target = paths

    from detangled.formats import read
    from detangled.kernels import set_threads
    from detangled.view import picture

    picture.check_target(target)
    grooms = []
    for source in sources:
        grooms.append(read(source, unit=unit))
        for sentence in grooms[-1].notes:
            warn(f"{source}: {sentence}")
    announce_first_run("rasteriser.")
    set_threads(threads)
    drawn = picture.render(grooms, (size, size), view, _captions(sources), names=[str(source) for source in sources])
    picture.save(drawn, target)
    note(f"{target}: strands drawn {drawn.strand_width:.3g} cm wide")


def _captions(sources: list[Path]) -> list[str]:
    """What to write under grooms: each file's name, and its folder where names are equal. Nothing for one."""
    if len(sources) == 1:
        return []
    names = [source.name for source in sources]
    return [
        source.name if names.count(source.name) == 1 else f"{source.parent.name}/{source.name}" for source in sources
    ]
