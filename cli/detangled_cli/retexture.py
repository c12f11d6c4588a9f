"""detangled retexture: give a groom another texture."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from detangled_cli.console import (
    UNIT,
    UNIT_NAMES,
    announce_first_run,
    input_argument,
    note,
    output_argument,
    progress_bar,
    quiet_option,
    threads_option,
    unit_option,
    warn,
)
from detangled_cli.presets import with_texture, written
from detangled_cli.targets import fibre_attributes, texture_options, wanted_texture

if TYPE_CHECKING:
    from detangled.groom import Groom
    from detangled.head import Head


def _density(context: click.Context, option: click.Parameter, value: str | None) -> str | float | None:
    if value in (None, "auto", "keep"):
        return value
    try:
        factor = float(str(value))
    except ValueError:
        factor = float("nan")
    if not 0.0 < factor < float("inf"):
        raise click.BadParameter(f"{value!r} is not auto, keep or a number above zero, such as 2.5")
    return factor


@click.command()
@input_argument
@output_argument
@texture_options
@click.option(
    "--length",
    type=click.Choice(["guide", "strand"]),
    default="guide",
    show_default=True,
    help="What stays: guide keeps the hairstyle's outline; strand keeps each hair's own length, so coils shrink it.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="The same seed, the same hair.")
@click.option("--steps", type=click.IntRange(2, 200), default=20, show_default=True, help="Steps of the sampler.")
@click.option(
    "--max-points",
    type=click.IntRange(min=2),
    metavar="N",
    help="Most points a strand may have. Default: as many as the texture needs, 16 a turn.",
)
@click.option(
    "--head",
    "head_source",
    metavar="MESH",
    type=click.Path(path_type=Path),
    help="What the groom grows on (.obj, .ply, .stl, .glb, .abc): hair is kept out of it.",
)
@click.option("--head-unit", type=UNIT, metavar="U", help=f"Unit of the head: {UNIT_NAMES}.")
@click.option(
    "--head-group",
    metavar="G",
    help="Groups, objects or materials of the mesh that are skin, with commas between them. Default: body, or what is "
    "named as face, head or scalp, else all.",
)
@click.option(
    "--on-penetration",
    type=click.Choice(["rotate", "delete", "keep"]),
    default="rotate",
    show_default=True,
    help="Hair in the head: rotate turns and lifts it out, delete also deletes what stays in, keep leaves it.",
)
@click.option(
    "--density",
    metavar="auto|keep|FACTOR",
    callback=_density,
    help="How many style guides: auto as the texture's radius needs, keep as there are, or so many times as many. "
    "Default: auto with --head, else keep.",
)
@unit_option
@threads_option
@quiet_option
def command(
    source: Path,
    target: Path,
    length: str,
    seed: int,
    steps: int,
    max_points: int | None,
    head_source: Path | None,
    head_unit: str | None,
    head_group: str | None,
    on_penetration: str,
    density: str | float | None,
    unit: str | None,
    threads: int | None,
    thickness: str | None,
    porosity: float | None,
    **wanted: Any,
) -> None:
    """Give a groom another texture, on its own style: one new strand for each of its strands.

    The texture is learned from target strands, or told by a hair type or by numbers; the groom keeps its style, its
    strands' number, order, roots and attributes. A groom that moves keeps its frames, and its curls their places.

    \b
    Example:
      detangled retexture in.abc out.abc --target strands.obj
      detangled retexture in.abc out.abc --type 4B
      detangled retexture in.abc out.abc --radius 6mm:2mm --wavelength 8mm --twist 0.3
      detangled retexture in.abc out.abc --target coily.texture --length strand --seed 7
      detangled retexture in.abc out.abc --type 4B --head head.obj
    """
    from detangled.formats import check_writable
    from detangled.formats.frames import read_frames
    from detangled.grooming.interpenetration import OnPenetration
    from detangled.grooming.lengths import Length
    from detangled.kernels import set_threads
    from detangled.retexturing import Options, retexture

    began = time.perf_counter()
    check_writable(target)
    fibre = fibre_attributes(thickness, porosity)
    frames = read_frames(source, unit=unit)
    groom = frames.groom
    for sentence in groom.notes:
        warn(f"{source}: {sentence}")
    head = None if head_source is None else _head_of(groom, head_source, head_unit, head_group)
    groom = replace(groom, attributes={**groom.attributes, **fibre})
    announce_first_run("placing.resample")
    set_threads(threads)
    texture = wanted_texture(**wanted, seed=seed)
    with progress_bar("strands", groom.strand_count) as bar:
        options = Options(
            Length(length), seed, steps, max_points, head, OnPenetration(on_penetration), _factor(density, head)
        )
        result = retexture(groom, texture, options, bar.update)
    styled = with_texture(frames, result.groom, target)
    for sentence in [*result.lost, *result.warnings, *written(styled, target)]:
        warn(f"{target}: {sentence}")
    if len(result.passed_through):
        some = ", ".join(str(index) for index in result.passed_through[:5])
        warn(
            f"{source}: {len(result.passed_through)} strands cannot be used and pass through "
            f"unchanged: {some}{', ...' if len(result.passed_through) > 5 else ''}"
        )
    for sentence in result.notes:
        note(f"{target}: {sentence}")
    if result.penetration is not None:
        note(f"{target}: {result.penetration}")
        for sentence in result.penetration.warnings():
            warn(f"{target}: {sentence}")
    note(
        f"{target}: {result.strands} strands, {len(result.groom.points)} points, in {time.perf_counter() - began:.1f} s"
    )


def _factor(density: str | float | None, head: Head | None) -> float | None:
    """Of the density of style guides; None for as the texture needs."""
    if isinstance(density, float):
        return density
    return None if density == "auto" or (density is None and head is not None) else 1.0


def _head_of(groom: Groom, source: Path, unit: str | None, group: str | None) -> Head:
    """The head that a groom grows on, in the groom's frame. Raises ReadError where they do not fit."""
    from detangled.errors import ReadError
    from detangled.formats.meshes import read_head
    from detangled.grooming.head_fit import fitted_to

    announce_first_run("placing.resample")
    try:
        head = fitted_to(read_head(source, unit=unit, group=group), groom)
    except ReadError as error:
        told = str(error)
        raise ReadError(told if told.startswith(str(source)) else f"{source}: {told}") from error
    for sentence in head.notes:
        warn(f"{source}: {sentence}")
    return head
