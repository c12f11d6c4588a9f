"""detangled gallery: the paper's figures, made by this program on its own models."""

from __future__ import annotations

import time
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import click

from detangled_cli.console import announce_first_run, note, progress_bar, quiet_option, threads_option, warn

if TYPE_CHECKING:
    from detangled.view.gallery.figure import Figure, Style

_ROOM = "detangled.view.gallery"
# Where each figure is found. Those of strands that hang stand on the training package, but for torch.
FIGURES = {
    "twists": ("detangled_training.hanging_figures", "TWIST_CHART"),
    "hanging": ("detangled_training.hanging_figures", "HANGING"),
    "guides": (f"{_ROOM}.guide_figure", "FIGURE"),
    "signals": (f"{_ROOM}.signal_figure", "FIGURE"),
    "sweeps": (f"{_ROOM}.sweep_figure", "FIGURE"),
    "few": (f"{_ROOM}.few_figure", "FIGURE"),
    "lengths": (f"{_ROOM}.length_figure", "FIGURE"),
    "density": (f"{_ROOM}.density_figure", "FIGURE"),
    "grid": (f"{_ROOM}.grid_figure", "FIGURE"),
}
STYLES = 4


class FigureName(click.ParamType):
    """The name of a figure."""

    name = "figure"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if value not in FIGURES:
            near = get_close_matches(value, FIGURES, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            self.fail(f"there is no figure {value!r}{hint}. They are: {', '.join(FIGURES)}", param, ctx)
        return value


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--only", multiple=True, type=FigureName(), metavar="NAME", help=f"One figure: {', '.join(FIGURES)}.")
@click.option(
    "--grooms",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="PATH",
    help="Grooms to take styles from: a file, or a folder of them; may be repeated. Default: four made in code.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="The same seed, the same hair.")
@click.option(
    "--strands",
    type=click.IntRange(min=8),
    default=128,
    show_default=True,
    metavar="N",
    help="Of each style at most.",
)
@click.option(
    "--sample",
    type=click.IntRange(min=1),
    default=16,
    show_default=True,
    metavar="N",
    help="Strands of a texture that are read.",
)
@click.option(
    "--training",
    type=click.IntRange(min=1),
    default=300,
    show_default=True,
    metavar="N",
    help="Steps that a network is trained on two strands.",
)
@click.option(
    "--width",
    type=click.IntRange(400, 8000),
    default=2000,
    show_default=True,
    metavar="PX",
    help="Of every figure.",
)
@threads_option
@quiet_option
def command(
    folder: Path,
    only: tuple[str, ...],
    grooms: tuple[Path, ...],
    seed: int,
    strands: int,
    sample: int,
    training: int,
    width: int,
    threads: int | None,
) -> None:
    """Make the paper's figures by this program on its own models, and a page of them.

    Writes a PNG for each figure and index.html, which shows all that lie in DIR.

    \b
    Example:
      detangled gallery out/gallery
      detangled gallery out/gallery --only sweeps --only twists
      detangled gallery out/gallery --only grid --grooms grooms/eve.abc --grooms grooms/bob.abc
    """
    from detangled import __version__
    from detangled.errors import WriteError
    from detangled.formats import check_folder
    from detangled.kernels import set_threads
    from detangled.view.gallery.figure import Setting
    from detangled.view.gallery.index import save_figure, write_index

    began = time.perf_counter()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError(f"{folder}: the folder cannot be made: {error.strerror or error}") from error
    check_folder(folder / "index.html")
    chosen = [name for name in FIGURES if name in only] if only else list(FIGURES)
    styles = _styles(grooms, strands, seed)
    figures = {name: _figure(name) for name in chosen}
    announce_first_run(
        "detangled_training.resting.hang_all"
        if {"twists", "hanging"} & set(figures)
        else "detangled.grooming.placing.resample"
    )
    set_threads(threads)
    with progress_bar("figures", sum(figure.steps for figure in figures.values())) as bar:
        for name, figure in figures.items():
            bar.set_postfix_str(name)
            told = [0]

            def step(done: int, told: list[int] = told) -> None:
                told[0] += done
                bar.update(done)

            setting = Setting(width, seed, strands, sample, training, lambda: styles, step)
            drawn = figure.draw(setting)
            save_figure(figure, drawn, folder / f"{name}.png")
            bar.update(figure.steps - told[0])
            for sentence in drawn.said:
                note(f"{name}: {sentence}")
    shown = write_index(folder, list(FIGURES), __version__)
    seconds = time.perf_counter() - began
    note(f"{folder / 'index.html'}: {len(shown)} figures, {len(figures)} of them made in {seconds:.0f} s")


def _figure(name: str) -> Figure:
    module, attribute = FIGURES[name]
    figure: Figure = getattr(import_module(module), attribute)
    return figure


def _styles(paths: tuple[Path, ...], strands: int, seed: int) -> tuple[Style, ...]:
    """Four styles: those of the files, and of what is missing made ones."""
    from detangled.view.gallery.styles import made_styles

    made = made_styles(strands, seed)
    if not paths:
        return made
    from detangled.view.gallery.groom_files import styles_from

    found, said = styles_from(paths, STYLES)
    for sentence in said:
        warn(sentence)
    return (*found, *made[len(found) :])[:STYLES]
