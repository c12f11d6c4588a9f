"""detangled convert: a groom in another file format or unit, or made ready for an engine."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from detangled_cli.console import (
    UNIT_HELP,
    announce_first_run,
    input_argument,
    note,
    output_argument,
    quiet_option,
    unit_option,
    warn,
)
from detangled_cli.option_values import UNIT
from detangled_cli.presets import check_preset, needs_kernels, preset_option, written

AXIS = click.Choice(["x", "y", "z"])


@click.command()
@input_argument
@output_argument
@preset_option()
@unit_option
@click.option("--out-unit", type=UNIT, metavar="U", help=f"Unit of OUT: {UNIT_HELP}. Default: that of IN.")
@click.option("--up", type=AXIS, help="Turn the groom until this axis points up. Default: as in IN.")
@click.option("--in-up", type=AXIS, help="The axis that points up in IN, where the file does not say or is wrong.")
@quiet_option
def command(
    source: Path,
    target: Path,
    preset: str | None,
    unit: str | None,
    out_unit: str | None,
    up: str | None,
    in_up: str | None,
) -> None:
    """Convert a groom: format, unit, up axis, engine.

    The suffix of OUT chooses its format. What that format cannot hold is listed on stderr, and so is what a preset
    changes.

    \b
    Example:
      detangled convert groom.abc groom.usda
      detangled convert groom.abc groom_cm.abc --out-unit cm --up z
      detangled convert groom.abc unreal.abc --preset unreal
    """
    from detangled.axes import turned, turned_vectors
    from detangled.formats import check_writable
    from detangled.formats.frames import holds_frames, read_frames
    from detangled.units import cm_per_unit, unit_name
    from detangled.usable import usable_strands
    from detangled_cli.info import UNUSABLE

    if preset is not None and (out_unit is not None or up is not None):
        raise click.UsageError(f"--preset {preset} decides unit and up axis of OUT: leave out --out-unit and --up")
    check_writable(target)
    check_preset(preset, target)
    frames = read_frames(source, unit=unit)
    if in_up is not None:
        frames = replace(frames, groom=replace(frames.groom, up=in_up))
    if up is not None:
        was, axis = frames.groom.up, up
        frames = frames.mapped(turned(frames.groom, up), lambda _, points: turned_vectors(points, was, axis))
    groom = frames.groom
    for sentence in groom.notes:
        warn(f"{source}: {sentence}")
    if out_unit is not None:
        groom = replace(groom, unit_cm=cm_per_unit(out_unit), unit_source="given")
        frames = replace(frames, groom=groom)
    if preset is not None:
        from detangled.presets import prepared_frames

        if needs_kernels(groom, preset):
            announce_first_run("detangled.grooming.fewer_points._points_at")
        frames, sentences = prepared_frames(frames, preset, target.suffix.lower())
        groom = frames.groom
        for sentence in sentences:
            note(f"{target}: {sentence}")
    for sentence in written(frames, target):
        warn(f"{target}: {sentence}")
    unusable = int((~usable_strands(groom)).sum())
    if unusable:
        warn(f"{target}: {unusable:,} of the strands cannot be used as hair ({UNUSABLE})")
    strands = f"{groom.strand_count:,} strand{'' if groom.strand_count == 1 else 's'}"
    points = f"{len(groom.points):,} point{'' if len(groom.points) == 1 else 's'}"
    moving = f", {len(frames)} frames" if len(frames) > 1 and holds_frames(target) else ""
    note(f"{target}: {strands}, {points}{moving}, in {unit_name(groom.unit_cm)}, {groom.up} up")
