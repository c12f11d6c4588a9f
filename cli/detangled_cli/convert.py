"""detangled convert: a groom in another file format or unit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from detangled_cli.console import (
    UNIT,
    UNIT_NAMES,
    input_argument,
    note,
    output_argument,
    quiet_option,
    unit_option,
    warn,
)

AXIS = click.Choice(["x", "y", "z"])


@click.command()
@input_argument
@output_argument
@unit_option
@click.option("--out-unit", type=UNIT, metavar="U", help=f"Unit of OUT: {UNIT_NAMES}. Default: that of IN.")
@click.option("--up", type=AXIS, help="Turn the groom until this axis points up. Default: as in IN.")
@click.option("--in-up", type=AXIS, help="The axis that points up in IN, where the file does not say or is wrong.")
@quiet_option
def command(
    source: Path, target: Path, unit: str | None, out_unit: str | None, up: str | None, in_up: str | None
) -> None:
    """Convert a groom to another file format, unit or up axis.

    The suffix of OUT chooses its format. What that format cannot hold is listed on stderr.

    \b
    Example:
      detangled convert groom.abc groom.usda
      detangled convert groom.abc unreal.abc --out-unit cm --up z
    """
    from detangled.formats import read, write
    from detangled.units import cm_per_unit, unit_name
    from detangled_cli.info import UNUSABLE, usable_strands

    groom = read(source, unit=unit, up=up, file_up=in_up)
    for sentence in groom.notes:
        warn(f"{source}: {sentence}")
    if out_unit is not None:
        groom = replace(groom, unit_cm=cm_per_unit(out_unit), unit_source="given")
    for sentence in write(groom, target):
        warn(f"{target}: {sentence}")
    unusable = int((~usable_strands(groom)).sum())
    if unusable:
        warn(f"{target}: {unusable:,} of the strands cannot be used as hair ({UNUSABLE})")
    strands = f"{groom.strand_count:,} strand{'' if groom.strand_count == 1 else 's'}"
    points = f"{len(groom.points):,} point{'' if len(groom.points) == 1 else 's'}"
    note(f"{target}: {strands}, {points}, in {unit_name(groom.unit_cm)}, {groom.up} up")
