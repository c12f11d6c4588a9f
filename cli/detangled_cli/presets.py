"""The option --preset, and grooms that move written out: for verbs that make grooms ready for an engine."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from detangled_cli.console import progress_bar

if TYPE_CHECKING:
    from detangled.formats.frames import Frames
    from detangled.groom import Groom

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


def check_preset(preset: str | None, target: Path) -> None:
    """Raise UsageError where an engine does not import files of this suffix."""
    if preset is None:
        return
    from detangled.presets import ENGINES

    engine = ENGINES[preset]
    if target.suffix.lower() not in engine.suffixes:
        raise click.UsageError(f"{engine.title} imports {', '.join(engine.suffixes)}, not {target}")


def needs_kernels(groom: Groom, preset: str) -> bool:
    """Whether a preset will have strands to take points from."""
    from detangled.presets import ENGINES

    most = ENGINES[preset].most_points
    return most is not None and bool((groom.point_counts > most).any())


def with_texture(frames: Frames, styled: Groom, target: Path) -> Frames:
    """The frames that OUT is to hold: those of IN with the texture of its first one, that first one alone elsewhere."""
    from detangled.formats.frames import holds_frames, still

    if len(frames) < 2:
        return still(styled)
    if not holds_frames(target):
        # Nothing else of these frames will be asked for; how many there are is told.
        return frames.mapped(styled, lambda _, points: points)
    from detangled.animation import carried_frames

    return carried_frames(frames, styled)


def written(frames: Frames, target: Path) -> list[str]:
    """Write a groom with all its frames, or the first where the format holds no more; say what was not kept."""
    from detangled.formats import write
    from detangled.formats.frames import holds_frames, write_frames

    if len(frames) < 2:
        return write(frames.groom, target)
    if not holds_frames(target):
        lost = f"{len(frames)} frames, only the first is kept: {target.suffix} files hold no more, .abc does"
        return [lost, *write(frames.groom, target)]
    with progress_bar("frames", len(frames)) as bar:

        def told() -> Any:
            for points in frames:
                yield points
                bar.update()

        return write_frames(frames.groom, frames.times, told(), target)
