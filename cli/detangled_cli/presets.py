"""The option --preset, for verbs that make grooms ready for an engine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])

# As in detangled.presets, which is loaded when one is used.
NAMES = ("unreal", "unity", "blender")


def preset_option(required: bool = False) -> Callable[[Command], Command]:
    """--preset, as ``preset``: a name or None."""
    return click.option(
        "--preset",
        type=click.Choice(NAMES),
        required=required,
        help="The engine: its unit and axes, its limits, the attributes that its importer reads.",
    )
