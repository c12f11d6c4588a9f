"""Where a texture comes from: strands in a groom file, or a .texture made of some by detangled fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from detangled.errors import ModelError
from detangled_cli.console import Command, note, progress_bar, warn

if TYPE_CHECKING:
    from detangled.diffusion.finetune import FineTuning
    from detangled.fitted import FittedTexture
    from detangled.groom import Groom


METHODS = ("patches", "finetune")
DEFAULT_METHOD = "patches"


def method_option(command: Command) -> Command:
    """--method, as ``method``: a name or None."""
    return click.option(
        "--method",
        type=click.Choice(METHODS),
        help="How to learn from strands: patches at once, finetune trains a network on them for minutes. "
        f"[default: {DEFAULT_METHOD}]",
    )(command)


def fitted_texture(
    target: Path, unit: str | None, method: str | None, seed: int = 0, training_steps: int | None = None
) -> FittedTexture:
    """Load a .texture, or fit one to the strands of a groom file; say what it is like."""
    from detangled.fitted import SUFFIX, load_texture

    if target.suffix == SUFFIX:
        texture = load_texture(target)
        if method not in (None, texture.method):
            raise ModelError(
                f"{target}: fitted by {texture.method}, not {method}: leave --method out, or fit its strands again"
            )
    else:
        from detangled.formats import read
        from detangled.grooming.guides import usable_strands

        strands = read(target, unit=unit)
        for sentence in strands.notes:
            warn(f"{target}: {sentence}")
        unusable = strands.strand_count - int(usable_strands(strands).sum())
        if unusable:
            warn(f"{target}: {unusable} of {strands.strand_count} strands cannot be used and are left out")
        texture = _fit(strands, method or DEFAULT_METHOD, seed, training_steps)
    note(f"{target}: {describe(texture)}")
    return texture


def _fit(strands: Groom, method: str, seed: int, training_steps: int | None) -> FittedTexture:
    """Fit, with a bar that shows the loss where a network is trained."""
    from detangled.fitting import fit

    with progress_bar("training steps") as bar:

        def show(step: int, most: int, loss: float) -> None:
            bar.total = most
            bar.set_postfix_str(f"loss {loss:.3f}", refresh=False)
            bar.update(1)

        return fit(strands, method, _fine_tuning(seed, training_steps), show)


def _fine_tuning(seed: int, training_steps: int | None) -> FineTuning:
    from detangled.diffusion.finetune import FineTuning

    usual = FineTuning(seed=seed)
    if training_steps is None:
        return usual
    return replace(usual, most_steps=training_steps, few_steps=training_steps)


def describe(texture: FittedTexture) -> str:
    """One line on a texture: how many strands it was learned from, its radius and wavelength."""
    count = f"{texture.strand_count} strand{'s' if texture.strand_count != 1 else ''}"
    if texture.wavelength != texture.wavelength:
        return f"texture of {count}: straight"
    return f"texture of {count}: radius {texture.radius:.2g} cm, wavelength {texture.wavelength:.2g} cm"
