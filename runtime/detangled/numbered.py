"""A texture asked for by its numbers, as the pretrained network draws it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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

    def grid_cells(self, arcs: NDArray[np.float64]) -> NDArray[np.int64]:
        """Cells (S,) on which strands of these arc lengths [cm] have cells as wide as the texture's, or less.

        Of few sizes, a power of two or half as many again of the smallest: networks take full batches, which strands on
        other grids do not share.
        """
        wanted = np.maximum(arcs / (self.cell_width * self.fewest_cells), 1.0)
        octave = np.exp2(np.floor(np.log2(wanted)))
        above = wanted / octave
        return np.round(
            self.fewest_cells * octave * np.where(above > 1.5, 2.0, np.where(above > 1.0, 1.5, 1.0))
        ).astype(np.int64)
