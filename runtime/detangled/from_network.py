"""A texture of given numbers by the pretrained network: told them, guided to them, or both.

What is said to it is corrected until strands that it draws are read as asked: strands hang, and a network is a little
off.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from detangled.draws import numbers_of, settled, some_drawn
from detangled.geometry.waves import is_weak
from detangled.groom import Groom
from detangled.labeling import CELLS, CELLS_PER_TURN
from detangled.numbered import NumberedTexture
from detangled.retexturing import FEWEST_TURNS
from detangled.texture import RADIUS_LIMITS, SHARE_LIMITS, WAVELENGTH_LIMITS, arc_of_a_turn

LONGEST_WINDOW = 30.0  # [cm] of arc that the network is shown at once: the strands it knows are hardly longer
MOST_CORRECTED = 1.5


def network_texture(
    radius: float,
    wavelength: float,
    twist: float,
    method: str,
    finite_differences: bool = False,
    as_drawn: bool = False,
) -> NumberedTexture:
    """The texture of these numbers [cm], T_f.

    as_drawn: neither is what is asked corrected, nor are strands settled. Raises ModelError where a model is missing or
    damaged.
    """
    turn = float(arc_of_a_turn(radius, wavelength))
    texture = NumberedTexture(
        method=method,
        asked_radius=radius,
        asked_wavelength=wavelength,
        asked_twist=twist,
        finite_differences=finite_differences,
        cell_width=min(turn / CELLS_PER_TURN, LONGEST_WINDOW / CELLS),
        turn=turn,
        median_arc=FEWEST_TURNS * turn,
        arc_per_axis=turn / wavelength,
        radius=radius,
        wavelength=wavelength,
        both_hands=True,
        stiff=False,
        waves=bool(is_weak(radius, wavelength)),
        fewest_cells=CELLS,
    )
    if as_drawn:
        return texture
    drawn = some_drawn(texture)
    return settled(_corrected(texture, drawn, (radius, wavelength, twist)), radius, wavelength, twist, drawn)


def _corrected(texture: NumberedTexture, drawn: Groom, wanted: tuple[float, float, float]) -> NumberedTexture:
    """A texture that asks for more of what is too small in strands drawn of it."""
    found = numbers_of(drawn)
    sizes = np.clip(np.array(wanted[:2]) / found.sizes(wanted[2]), 1.0 / MOST_CORRECTED, MOST_CORRECTED)
    radius, wavelength = np.where(np.isfinite(sizes), sizes, 1.0) * (texture.asked_radius, texture.asked_wavelength)
    missing = wanted[2] - found.twist if np.isfinite(found.twist) else 0.0
    return replace(
        texture,
        asked_radius=float(np.clip(radius, *RADIUS_LIMITS)),
        asked_wavelength=float(np.clip(wavelength, *WAVELENGTH_LIMITS)),
        asked_twist=float(np.clip(texture.asked_twist + missing, *SHARE_LIMITS)),
    )
