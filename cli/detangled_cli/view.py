"""detangled view: a page that shows a groom, or one before and after, in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from detangled_cli.console import (
    announce_first_run,
    check_apart,
    file_names,
    input_argument,
    note,
    progress_bar,
    quiet_option,
    threads_option,
    unit_option,
    warn,
)
from detangled_cli.heads import check_head_options, head_of, head_options

if TYPE_CHECKING:
    from detangled.groom import Groom
    from detangled.view.page import Shown


@click.command()
@input_argument
@click.argument("target", metavar="[PAGE.html]", required=False, type=click.Path(path_type=Path))
@click.option(
    "--after",
    metavar="OUT",
    type=click.Path(path_type=Path),
    help="A second groom, seen alike: a divider wipes between IN and it.",
)
@head_options("it is shown under the hair.")
@click.option(
    "--no-labels",
    is_flag=True,
    help="Do not read the strands' texture, which takes most of the time; none can be coloured by it then.",
)
@click.option("--open", "opened", is_flag=True, help="Open the page in the browser.")
@unit_option
@threads_option
@quiet_option
def command(
    source: Path,
    target: Path | None,
    after: Path | None,
    head_source: Path | None,
    head_unit: str | None,
    head_group: str | None,
    no_labels: bool,
    opened: bool,
    unit: str | None,
    threads: int | None,
) -> None:
    """Show a groom in a browser, in one page.

    The page needs no network and can be sent to others. In it the hair is turned and zoomed, strands are coloured by
    radius, wavelength, twist or type, and what hair it is stands beside. Without PAGE.html it is written into the
    current folder, named after the last groom.

    \b
    Example:
      detangled view groom.abc
      detangled view before.abc --after coily.abc comparison.html --open
      detangled view dense.abc --head head.obj --no-labels
    """
    check_head_options(head_source, head_unit, head_group)
    sources = [source] if after is None else [source, after]
    target = target or Path(f"{sources[-1].stem}.html")

    check_apart(target, head_source, *sources)

    from detangled.formats import read
    from detangled.kernels import set_threads
    from detangled.view import page

    page.check_target(target)
    set_threads(threads)
    grooms = []
    for path in sources:
        grooms.append(read(path, unit=unit))
        for sentence in grooms[-1].notes:
            warn(f"{path}: {sentence}")
    mesh = head_of(grooms[0], head_source, head_unit, head_group)
    shown = [_shown(groom, name, no_labels) for groom, name in zip(grooms, file_names(sources), strict=True)]
    made = page.page(shown, mesh, threads=threads)
    for sentence in made.notes:
        warn(sentence)
    page.save(made, target)
    note(f"{target}: {len(made.text) / 1e6:.1f} MB, strands {made.strand_width:.3g} cm wide; open it in a browser")
    if opened:
        click.launch(target.resolve().as_uri())


def _shown(groom: Groom, name: str, no_labels: bool) -> Shown:
    from detangled.view.page import Shown

    if no_labels:
        return Shown(groom, name)
    from detangled.labeling import label
    from detangled_cli.label_summary import is_readable, summary, why_unread

    announce_first_run("detangled.labeling.points_per_turn")
    with progress_bar(f"labels of {name}", groom.strand_count) as bar:
        labels = label(groom, bar.update)
    facts: dict[str, Any] = summary(labels)
    if not is_readable(facts):
        warn(f"{name}: none of its strands can be labelled: {why_unread(facts)}")
        return Shown(groom, name)
    return Shown(groom, name, labels, facts)
