"""Where a texture comes from: strands in a groom file, or a .texture made of some by detangled fit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from detangled_cli.console import note, warn

if TYPE_CHECKING:
    from detangled.fitted import FittedTexture


def fitted_texture(target: Path, unit: str | None) -> FittedTexture:
    """Load a .texture, or fit one to the strands of a groom file; say what it is like."""
    from detangled.fitted import SUFFIX, fit_patches, load_texture

    if target.suffix == SUFFIX:
        texture = load_texture(target)
    else:
        from detangled.formats import read
        from detangled.grooming.guides import usable_strands

        strands = read(target, unit=unit)
        for sentence in strands.notes:
            warn(f"{target}: {sentence}")
        unusable = strands.strand_count - int(usable_strands(strands).sum())
        if unusable:
            warn(f"{target}: {unusable} of {strands.strand_count} strands cannot be used and are left out")
        texture = fit_patches(strands)
    note(f"{target}: {describe(texture)}")
    return texture


def describe(texture: FittedTexture) -> str:
    """One line on a texture: how many strands it was learned from, its radius and wavelength."""
    count = f"{texture.strand_count} strand{'s' if texture.strand_count != 1 else ''}"
    if texture.wavelength != texture.wavelength:
        return f"texture of {count}: straight"
    return f"texture of {count}: radius {texture.radius:.2g} cm, wavelength {texture.wavelength:.2g} cm"
