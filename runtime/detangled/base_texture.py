"""What making and placing new strands asks of any texture, be it fitted to examples or asked for by numbers."""

from __future__ import annotations

from dataclasses import dataclass

from detangled.shape import Shape


@dataclass(frozen=True, kw_only=True)
class Texture:
    """What new strands are like, in canonical space.

    cell_width, turn, median_arc: arc lengths [cm] of a cell, of a turn, and of the median strand that is drawn.
    arc_per_axis: arc length per length along the axis, in the median.
    radius, wavelength: medians by winding [cm]; the wavelength of straight hair is NaN.
    both_hands: whether every other new strand, at random, is mirrored.
    stiff: whether the axes of short strands are taken to be straight, as a few turns do not tell; not where twists bend
    them. waves: whether the strands are waves too weak for a centreline, whose axis is the mean over a turn.
    shape: how radius and wavelength run from root to tip, where they are asked to; a strand is given it once it is
    drawn. All else is said of even strands.
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

    @property
    def finest_turn(self) -> float:
        """The arc length [cm] of the shortest turn of new strands."""
        return self.turn if self.shape is None else self.turn * self.shape.finest

    @property
    def wave_turn(self) -> float:
        """The arc length [cm] of a turn where the strands are weak waves, else 0."""
        return self.turn if self.waves else 0.0
