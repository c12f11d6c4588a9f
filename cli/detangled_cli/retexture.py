"""detangled retexture: give a groom another texture."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from detangled_cli.console import (
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
    """
    from detangled.formats import check_writable
    from detangled.formats.frames import read_frames
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
    groom = replace(groom, attributes={**groom.attributes, **fibre})
    announce_first_run("placing.resample")
    set_threads(threads)
    texture = wanted_texture(**wanted, seed=seed)
    with progress_bar("strands", groom.strand_count) as bar:
        result = retexture(groom, texture, Options(Length(length), seed, steps, max_points), bar.update)
    styled = with_texture(frames, result.groom, target)
    for sentence in [*result.lost, *result.warnings, *written(styled, target)]:
        warn(f"{target}: {sentence}")
    if len(result.passed_through):
        some = ", ".join(str(index) for index in result.passed_through[:5])
        warn(
            f"{source}: {len(result.passed_through)} strands cannot be used and pass through "
            f"unchanged: {some}{', ...' if len(result.passed_through) > 5 else ''}"
        )
    note(
        f"{target}: {result.strands} strands, {len(result.groom.points)} points, in {time.perf_counter() - began:.1f} s"
    )
