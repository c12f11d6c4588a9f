"""detangled generate: loose strands of a texture."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from detangled_cli.console import (
    announce_first_run,
    check_apart,
    note,
    output_argument,
    progress_bar,
    quiet_option,
    threads_option,
    warn,
)
from detangled_cli.option_values import LENGTH, wrong_usage
from detangled_cli.targets import fibre_attributes, texture_options, wanted


@click.command()
@output_argument
@texture_options
@click.option("--count", type=click.IntRange(min=1), default=64, show_default=True, metavar="N", help="Strands.")
@click.option(
    "--length",
    type=LENGTH,
    default="20cm",
    show_default=True,
    metavar="L",
    help="Of each strand, along its curls.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="The same seed, the same hair.")
@click.option("--steps", type=click.IntRange(2, 200), default=20, show_default=True, help="Steps of the sampler.")
@threads_option
@quiet_option
def command(
    target: Path,
    count: int,
    length: float,
    seed: int,
    steps: int,
    threads: int | None,
    thickness: float | None,
    porosity: float | None,
    **texture_asked: Any,
) -> None:
    """Make loose strands of a texture, side by side, each about a straight axis that points down.

    \b
    Example:
      detangled generate coils.abc --type 4B --count 64 --length 20cm
      detangled generate waves.obj --radius 8mm --wavelength 4cm --twist 0.1
    """
    from detangled.formats import check_writable, write
    from detangled.generation import check_asked, generate, side_by_side
    from detangled.kernels import set_threads

    began = time.perf_counter()
    with wrong_usage():
        check_asked(count, length)
    asked_for = wanted(**texture_asked)
    check_apart(target, asked_for.source)
    check_writable(target)
    announce_first_run("detangled.grooming.placing.resample")
    set_threads(threads)
    texture = asked_for.texture(seed)
    with progress_bar("strands", count) as bar:
        groom = side_by_side(generate(texture, count, length, seed, steps, bar.update))
    groom = replace(groom, attributes=fibre_attributes(thickness, porosity))
    for sentence in write(groom, target):
        warn(f"{target}: {sentence}")
    note(f"{target}: {count} strands, {len(groom.points)} points, in {time.perf_counter() - began:.1f} s")
