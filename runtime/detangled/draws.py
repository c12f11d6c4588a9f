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
from detangled.settling import BY_EXTENT, BY_LABELS, Settling, sizes_read
from detangled.texture import trust_in_winding

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
        """Radius and wavelength of hair of this prevalence of twists: by winding as far as that is to be trusted."""
        trust = trust_in_winding(twist)
        parts = [share * np.log(sizes) for share, sizes in ((trust, self.wound), (1.0 - trust, self.labelled)) if share]
        return np.exp(np.sum(parts, axis=0))


def numbers_drawn(texture: Texture) -> Numbers:
    """What strands drawn of a texture are like."""
    return _numbers(_drawn(texture))


def _drawn(texture: Texture, seed: int = SEED) -> Groom:
    return generate(texture, DRAWN, np.linspace(*LENGTHS, DRAWN), seed)


def _numbers(strands: Groom) -> Numbers:
    labels = label(strands)
    wound = [_middle(values) for values in winding(strands.points, strands.offsets)]
    labelled = [_middle(values) for values in (labels.radius, labels.wavelength)]
    return Numbers(np.array(wound), np.array(labelled), _middle(labels.twist, least=0.0))


def settled(texture: AnyTexture, radius: float, wavelength: float, twist: float) -> AnyTexture:
    """A texture whose strands are each resized until they read as hair of these numbers [cm], T_f, does.

    Where most of its strands cannot be read they are left as they are drawn.
    """
    by = BY_EXTENT if trust_in_winding(twist) > 0.5 else BY_LABELS
    for seed in range(SEED, SEED + ROUNDS):
        strands = _drawn(texture, seed)
        found = _numbers(strands)
        read = found.labelled
        if by == BY_EXTENT:
            read = np.array([_middle(values) for values in sizes_read(strands, by).T])
        wanted = read * np.array([radius, wavelength]) / found.sizes(twist)
        if not np.isfinite(wanted).all():
            break
        texture = replace(texture, settling=Settling(by, *wanted.tolist()))
    return texture


def trends(texture: Texture) -> NDArray[np.float64]:
    """How the logarithms of radius and wavelength change from root to tip of strands drawn of a texture, (2,).

    Hair that hangs is narrower and longer drawn near its root. 0 where that cannot be told.
    """
    strands = _drawn(texture)
    halves = [np.array_split(strands.strand(s), 2) for s in range(strands.strand_count)]
    upper, lower = (winding(part.points, part.offsets) for part in map(Groom.from_strands, zip(*halves, strict=True)))
    found = [2.0 * np.log(_middle(below) / _middle(above)) for above, below in zip(upper, lower, strict=True)]
    return np.nan_to_num(found)


def _middle(values: NDArray[np.float64], least: float = 1e-9) -> float:
    """The median of those that tell, NaN where these are fewer than half."""
    told = values[np.isfinite(values) & (values >= least)]
    return float(np.median(told)) if 2 * len(told) >= len(values) else float("nan")
