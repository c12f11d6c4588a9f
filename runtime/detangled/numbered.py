"""A texture asked for by its numbers, as the pretrained network draws it."""

from __future__ import annotations

from dataclasses import dataclass

from detangled.base_texture import Texture

CONDITIONED, GUIDED, BOTH = "conditioned", "guided", "both"
METHODS = (CONDITIONED, GUIDED, BOTH)


@dataclass(frozen=True, kw_only=True)
class NumberedTexture(Texture):
    """What new strands are like: numbers that the network is told, that its strands are guided to, or both.

    method: CONDITIONED, GUIDED or BOTH. asked_radius, asked_wavelength [cm], asked_twist (T_f): what is said to the
    network and to guidance, so that strands come out with the texture's own.
    finite_differences: whether guidance does without the labelers' exported gradients.
    """

    method: str
    asked_radius: float
    asked_wavelength: float
    asked_twist: float
    finite_differences: bool = False
