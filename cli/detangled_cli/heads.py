"""The options --head, --head-unit and --head-group, and the head that they name in the frame of a groom."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from detangled_cli.console import UNIT_HELP, Command, announce_first_run, warn
from detangled_cli.option_values import UNIT

if TYPE_CHECKING:
    from collections.abc import Callable

    from detangled.groom import Groom
    from detangled.head import Head


def head_options(purpose: str) -> Callable[[Command], Command]:
    """What names a head, as ``head_source``, ``head_unit`` and ``head_group``; purpose: what it is there for."""

    def with_options(command: Command) -> Command:
        for option in (
            click.option(
                "--head-group",
                metavar="G",
                help="Groups, objects or materials of MESH that are skin, with commas between them. Default: body, or "
                "what is named as face, head or scalp, else all.",
            ),
            click.option("--head-unit", type=UNIT, metavar="U", help=f"Unit of MESH: {UNIT_HELP}."),
            click.option(
                "--head",
                "head_source",
                metavar="MESH",
                type=click.Path(path_type=Path),
                help=f"What the groom grows on (.obj, .ply, .stl, .glb, .abc): {purpose}",
            ),
        ):
            command = option(command)
        return command

    return with_options


def check_head_options(source: Path | None, unit: str | None, group: str | None) -> None:
    """Raise UsageError where something is said of a head that is not named."""
    if source is None and (unit is not None or group is not None):
        raise click.UsageError("--head-unit and --head-group go with --head")


def head_of(groom: Groom, source: Path | None, unit: str | None, group: str | None) -> Head | None:
    """The head that a groom grows on, in the groom's frame; None where none is named.

    Raises ReadError where it cannot be read, or does not fit the groom.
    """
    check_head_options(source, unit, group)
    if source is None:
        return None
    from detangled.errors import ReadError
    from detangled.formats.meshes import read_head
    from detangled.grooming.head_fit import fitted_to

    announce_first_run("detangled.grooming.placing.resample")
    try:
        head = fitted_to(read_head(source, unit=unit, group=group), groom)
    except ReadError as error:
        told = str(error)
        raise ReadError(told if told.startswith(str(source)) else f"{source}: {told}") from error
    for sentence in head.notes:
        warn(f"{source}: {sentence}")
    return head
