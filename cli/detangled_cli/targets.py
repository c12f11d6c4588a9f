"""Where a texture comes from: strands in a groom file, a .texture made of some by detangled fit, or numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from detangled.errors import ModelError
from detangled_cli.console import Command, note, progress_bar, warn
from detangled_cli.option_values import HAIR_TYPE, PROFILE, SHARE, THICKNESS, UNIT, wrong_usage

if TYPE_CHECKING:
    from detangled.base_texture import Texture
    from detangled.diffusion.finetune import FineTuning
    from detangled.fitted import FittedTexture
    from detangled.from_numbers import Asked
    from detangled.groom import Attribute, Groom
    from detangled.texture import HairType, Profile

FITTING = ("patches", "finetune")  # of either the first is the default
ASKING = ("library", "conditioned", "guided", "both")


_HOW_TO_FIT = (
    "How to learn from strands: patches at once, finetune trains a network on them for minutes. "
    f"[default: {FITTING[0]}]"
)


def fitting_option(command: Command) -> Command:
    """--method of learning from strands, as ``method``: a name or None."""
    return click.option("--method", type=click.Choice(FITTING), help=_HOW_TO_FIT)(command)


def texture_options(command: Command) -> Command:
    """What a verb takes to be told a texture, as ``texture_source``, ``method`` and so on: see ``wanted``."""
    for option in reversed(
        (
            click.option(
                "--target",
                "texture_source",
                metavar="STRANDS|FITTED",
                type=click.Path(path_type=Path),
                help="Strands of the new texture (.abc, .obj, .npz), or a .texture made by detangled fit.",
            ),
            click.option(
                "--type", "hair", type=HAIR_TYPE, metavar="T", help="Hair type: 1A to 4C, I to VIII, straw, marker."
            ),
            click.option(
                "--radius", type=PROFILE, metavar="R", help="Of the curls: 4mm; 6mm:2mm runs from root to tip."
            ),
            click.option(
                "--wavelength", type=PROFILE, metavar="W", help="From a curl to the next: 9mm; also from root to tip."
            ),
            click.option(
                "--twist", type=SHARE, metavar="T_f", help="Prevalence of sudden twists, 0 to 1: see label --explain."
            ),
            click.option(
                "--thickness",
                type=THICKNESS,
                metavar="D",
                help="Of the fibre, 70um: written as width. It changes no shape.",
            ),
            click.option(
                "--porosity", type=SHARE, metavar="P", help="0 to 1: written as an attribute. It changes no shape."
            ),
            click.option(
                "--method",
                type=click.Choice([*FITTING, *ASKING]),
                help=f"{_HOW_TO_FIT} Of a type or numbers: library learns from strands like it; conditioned tells a "
                f"network the numbers, guided guides it to them, both does both. [default: {ASKING[0]}]",
            ),
            click.option("--finite-differences", is_flag=True, help="Guide without the labelers' exported gradients."),
            click.option(
                "--target-unit",
                type=UNIT,
                metavar="U",
                help="Unit of the target strands, where it is not what it seems.",
            ),
        )
    ):
        command = option(command)
    return command


@dataclass(frozen=True)
class Wanted:
    """A texture as ``texture_options`` ask for it: a file, of strands or of what was learned from some, or numbers."""

    what: Path | Asked
    method: str | None
    finite_differences: bool = False
    target_unit: str | None = None

    @property
    def source(self) -> Path | None:
        """The file that it is learned from, if there is one."""
        return self.what if isinstance(self.what, Path) else None

    def texture(self, seed: int) -> Texture:
        """Learn it or look it up."""
        if isinstance(self.what, Path):
            return fitted_texture(self.what, self.target_unit, self.method, seed, unit_option="--target-unit")
        from detangled.from_numbers import asked_texture

        note(f"texture: {self.what}")
        return asked_texture(self.what, self.method or ASKING[0], finite_differences=self.finite_differences)


def wanted(
    texture_source: Path | None,
    hair: HairType | None,
    radius: Profile | None,
    wavelength: Profile | None,
    twist: float | None,
    method: str | None,
    finite_differences: bool,
    target_unit: str | None,
) -> Wanted:
    """What ``texture_options`` ask for: by examples, or by a type and numbers. Raises UsageError where it is nothing
    that there is.
    """
    numbers = {"--type": hair, "--radius": radius, "--wavelength": wavelength, "--twist": twist}
    given = [name for name, value in numbers.items() if value is not None]
    if texture_source is not None:
        if given:
            raise click.UsageError(f"--target tells the texture already: leave {' and '.join(given)} out, or --target")
        if method in ASKING or finite_differences:
            raise click.UsageError(f"--method {', '.join(ASKING)} and --finite-differences go with a type or numbers")
        from detangled.fitted import SUFFIX

        if texture_source.suffix == SUFFIX and target_unit is not None:
            raise click.UsageError(f"--target-unit goes with strands, not with a {SUFFIX}")
        return Wanted(texture_source, method, target_unit=target_unit)
    if not given:
        raise click.UsageError(f"which texture? Give --target, or one or more of {', '.join(numbers)}")
    if method in FITTING or target_unit is not None:
        raise click.UsageError(f"--method {' and '.join(FITTING)} and --target-unit go with --target")
    if finite_differences and method not in ("guided", "both"):
        raise click.UsageError("--finite-differences goes with --method guided or both")
    from detangled.from_numbers import asked

    with wrong_usage():
        return Wanted(asked(hair, radius, wavelength, twist), method, finite_differences)


def fibre_attributes(thickness: float | None, porosity: float | None) -> dict[str, Attribute]:
    """What a groom is told of its fibres: their thickness as ``width`` [cm], and their porosity."""
    import numpy as np

    from detangled.groom import Attribute, Scope

    told = {"width": thickness, "porosity": porosity}
    return {
        name: Attribute(np.array([value], dtype=np.float32), Scope.GROOM)
        for name, value in told.items()
        if value is not None
    }


def fitted_texture(
    target: Path,
    unit: str | None,
    method: str | None,
    seed: int = 0,
    training_steps: int | None = None,
    unit_option: str = "--unit",
) -> FittedTexture:
    """Load a .texture, or fit one to the strands of a groom file; say what it is like.

    unit_option: the option that says the file's unit.
    """
    from detangled.fitted import SUFFIX, load_texture

    if target.suffix == SUFFIX:
        texture = load_texture(target)
        if method not in (None, texture.method):
            raise ModelError(
                f"{target}: fitted by {texture.method}, not {method}: leave --method out, or fit its strands again"
            )
    else:
        from detangled.formats import read
        from detangled.usable import check_usable, usable_strands

        strands = read(target, unit=unit)
        for sentence in strands.notes:
            warn(f"{target}: {sentence.replace('--unit', unit_option)}")
        check_usable(strands, target)
        unusable = strands.strand_count - int(usable_strands(strands).sum())
        if unusable:
            warn(f"{target}: {unusable} of {strands.strand_count} strands cannot be used and are left out")
        texture = _fit(strands, method or FITTING[0], seed, training_steps)
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
