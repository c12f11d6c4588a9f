"""What making and placing new strands asks of any texture, be it fitted to examples or asked for by numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.grooming.lengths import STIFF_TURNS, TWISTED_TURNS, Axis
from detangled.settling import Settling
from detangled.shape import Shape

CELL_MULTIPLE = 16  # of a grid, as networks take it; strands of nearly one length share a grid, and so a batch


@dataclass(frozen=True, kw_only=True)
class Texture:
    """What new strands are like, in canonical space.

    cell_width, turn, median_arc: arc lengths [cm] of a cell, of a turn, and of the median strand that is drawn.
    arc_per_axis: arc length per length along the axis, in the median.
    radius, wavelength: medians by winding [cm]; the wavelength of straight hair is NaN.
    both_hands: whether every other new strand, at random, is mirrored.
    stiff: whether axes hardly bend, as where it was fitted to strands without twists; those of short strands are then
    taken to be straight, as a few turns do not tell, and strands whose axes wander are drawn anew.
    waves: whether the strands are waves too weak for a centreline, whose axis is the mean over a turn.
    shape: how radius and wavelength run from root to tip, where they are asked to; a strand is given it once it is
    drawn. All else is said of even strands.
    fewest_cells: of the grid of any strand.
    settling: how each strand is resized until it reads as asked; None where strands are left as they are drawn.
    """

    cell_width: float
    turn: float
    median_arc: float
    arc_per_axis: float
    radius: float
    wavelength: float
    both_hands: bool = False
    stiff: bool = True
    waves: bool = False
    shape: Shape | None = None
    fewest_cells: int = CELL_MULTIPLE
    settling: Settling | None = None

    def grid_cells(self, arcs: NDArray[np.float64]) -> NDArray[np.int64]:
        """Cells (S,) on which strands of these arc lengths [cm] keep cells about as wide as the texture's."""
        blocks = np.round(arcs / (self.cell_width * CELL_MULTIPLE)).astype(np.int64)
        return np.maximum(CELL_MULTIPLE * blocks, self.fewest_cells)

    @property
    def finest_turn(self) -> float:
        """The arc length [cm] of the shortest turn of new strands."""
        return self.turn if self.shape is None else self.turn * self.shape.finest

    @property
    def axis(self) -> Axis:
        """How the axes of new strands are found."""
        return Axis(STIFF_TURNS if self.stiff else TWISTED_TURNS, self.turn if self.waves else 0.0)

    @property
    def shortest_drawn(self) -> float:
        """The arc length [cm] of the shortest strands that are drawn; shorter ones are cut out of these. 0 for any."""
        return 0.0
