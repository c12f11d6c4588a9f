"""Strands drawn of a texture to see how far off its numbers they are, before any are made for good."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from detangled.base_texture import Texture
from detangled.generation import generate
from detangled.geometry.winding import winding
from detangled.groom import Groom
from detangled.labeling import label
from detangled.settling import BY_EXTENT, BY_LABELS, Settling, read
from detangled.texture import FEW_TWISTS

DRAWN, LENGTHS = 48, (8.0, 40.0)  # how many, and how long they are [cm]
SEED, ROUNDS = 1 << 30, 2

AnyTexture = TypeVar("AnyTexture", bound=Texture)


class Numbers(NamedTuple):
    """Medians of drawn strands: radius and wavelength [cm] by winding and by the labelers, (2,) each, and T_f.

    NaN where fewer than half of the strands tell.
    """

    wound: NDArray[np.float64]
    labelled: NDArray[np.float64]
    twist: float

    def sizes(self, twist: float) -> NDArray[np.float64]:
        """Radius and wavelength of hair of this prevalence of twists."""
        return self.wound if twist <= FEW_TWISTS else self.labelled


def some_drawn(texture: Texture, seed: int = SEED) -> Groom:
    """Strands of a texture, of all lengths."""
    return generate(texture, DRAWN, np.linspace(*LENGTHS, DRAWN), seed)


def numbers_of(strands: Groom) -> Numbers:
    """What strands drawn of a texture are like."""
    labels = label(strands)
    labelled = [_middle(values) for values in (labels.radius, labels.wavelength)]
    return Numbers(_wound(strands), np.array(labelled), _middle(labels.twist, least=0.0))


def _wound(strands: Groom) -> NDArray[np.float64]:
    """Median radius and wavelength [cm] by winding, (2,)."""
    return np.array([_middle(values) for values in winding(strands.points, strands.offsets)])


def settled(
    texture: AnyTexture, radius: float, wavelength: float, twist: float, drawn: Groom | None = None
) -> AnyTexture:
    """A texture whose strands are each resized until they read as hair of these numbers [cm], T_f, does.

    drawn: strands much like its own, which spare to draw some at first. Where most of its strands cannot be read they
    are left as they are.
    """
    if twist > FEW_TWISTS:
        return replace(texture, settling=Settling(BY_LABELS, radius, wavelength, twist))
    for seed in range(SEED, SEED + ROUNDS):
        strands, drawn = some_drawn(texture, seed) if drawn is None else drawn, None
        extents = np.array([_middle(values) for values in read(strands, BY_EXTENT)[0].T])
        # What a strand extends is a little more than winding says.
        wanted = extents * np.array([radius, wavelength]) / _wound(strands)
        if not np.isfinite(wanted).all():
            break
        texture = replace(texture, settling=Settling(BY_EXTENT, *wanted.tolist()))
    return texture


def trends(texture: Texture) -> NDArray[np.float64]:
    """How the logarithms of radius and wavelength change from root to tip of strands drawn of a texture, (2,).

    Hair that hangs is narrower and longer drawn near its root. 0 where that cannot be told.
    """
    strands = some_drawn(texture)
    halves = [np.array_split(strands.strand(s), 2) for s in range(strands.strand_count)]
    upper, lower = (winding(part.points, part.offsets) for part in map(Groom.from_strands, zip(*halves, strict=True)))
    found = [2.0 * np.log(_middle(below) / _middle(above)) for above, below in zip(upper, lower, strict=True)]
    return np.nan_to_num(found)


def _middle(values: NDArray[np.float64], least: float = 1e-9) -> float:
    """The median of those that tell, NaN where these are fewer than half."""
    told = values[np.isfinite(values) & (values >= least)]
    return float(np.median(told)) if 2 * len(told) >= len(values) else float("nan")
