"""detangled guides: the style guides of a groom, alone."""

from __future__ import annotations

from pathlib import Path

import click

from detangled_cli.console import (
    announce_first_run,
    input_argument,
    output_argument,
    quiet_option,
    threads_option,
    unit_option,
    warn,
)


@click.command()
@input_argument
@output_argument
@unit_option
@threads_option
@quiet_option
def command(source: Path, target: Path, unit: str | None, threads: int | None) -> None:
    """Write the style guides of a groom: its strands' centrelines, without their texture.

    \b
    Example:
      detangled guides curly.abc guides.abc
    """
    from detangled.formats import check_writable, read, write
    from detangled.grooming.guides import guides_groom
    from detangled.kernels import set_threads
    from detangled.usable import check_usable, usable_strands

    check_writable(target)
    groom = read(source, unit=unit)
    for sentence in groom.notes:
        warn(f"{source}: {sentence}")
    check_usable(groom, source)
    announce_first_run("detangled.geometry.centerline._centerlines")
    set_threads(threads)
    unusable = groom.strand_count - int(usable_strands(groom).sum())
    if unusable:
        warn(f"{source}: {unusable} of {groom.strand_count} strands cannot be used and pass through unchanged")
    for sentence in write(guides_groom(groom), target):
        warn(f"{target}: {sentence}")
