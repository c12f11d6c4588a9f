"""Radius and wavelength that vary from root to tip: strands drawn with even ones are widened and stretched.

In canonical space this is exact: what a strand is wide and steep is its distance from the axis and its fall along it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import parallel_kernel, prange
from detangled.texture import arc_of_a_turn


@dataclass(frozen=True)
class Shape:
    """Radius and wavelength [cm] at even steps from root to tip, K of each, in the middles of the steps.

    drawn_radius, drawn_wavelength: of the even strands. Raises ValueError where one is not finite, or not positive.
    """

    radius: Sequence[float]
    wavelength: Sequence[float]
    drawn_radius: float
    drawn_wavelength: float

    def __post_init__(self) -> None:
        every = np.array([*self.radius, *self.wavelength, self.drawn_radius, self.drawn_wavelength])
        if len(self.radius) != len(self.wavelength) or not (np.isfinite(every).all() and (every > 0.0).all()):
            raise ValueError("radii and wavelengths must be as many, finite, and more than zero")

    @property
    def finest(self) -> float:
        """The arc of the shortest turn, beside that of an even one."""
        return float(arc_of_a_turn(self.radius, self.wavelength).min() / self._drawn_turn)

    @property
    def drawn_arc(self) -> float:
        """The arc that an even strand has, beside that of the shaped one."""
        return float((self._drawn_turn / arc_of_a_turn(self.radius, self.wavelength)).mean())

    @property
    def drawn_depth(self) -> float:
        """How far an even strand goes along its axis, beside the shaped one."""
        return float((self.drawn_wavelength / np.asarray(self.wavelength)).mean())

    @property
    def _drawn_turn(self) -> float:
        return float(arc_of_a_turn(self.drawn_radius, self.drawn_wavelength))

    def given_to(
        self, points: NDArray[np.float64], offsets: NDArray[np.int64], goals: NDArray[np.float64], by_depth: bool
    ) -> NDArray[np.float64]:
        """Canonical strands (P, 3), by offsets (S + 1,), shaped: each from its root to where it will be cut.

        goals: (S,) [cm], lengths there, of arc, or along the axis where ``by_depth``.
        """
        wider = np.asarray(self.radius) / self.drawn_radius
        longer = np.asarray(self.wavelength) / self.drawn_wavelength
        return _shaped(points, offsets, goals, by_depth, wider, longer)


@parallel_kernel
def _shaped(
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    goals: NDArray[np.float64],
    by_depth: bool,
    wider: NDArray[np.float64],
    longer: NDArray[np.float64],
) -> NDArray[np.float64]:
    out = np.empty(points.shape)
    middles = (np.arange(wider.shape[0]) + 0.5) / wider.shape[0]
    for s in prange(offsets.shape[0] - 1):
        done = 0.0
        root = offsets[s]
        for i in range(root, offsets[s + 1]):
            # Where a point comes to lie depends on its factors, which hardly change from one point to the next.
            share = min(max(done / goals[s], 0.0), 1.0)
            across = np.interp(share, middles, wider)
            out[i, 0] = points[i, 0] * across
            out[i, 1] = points[i, 1] * across
            if i == root:
                out[i, 2] = points[i, 2]
                continue
            out[i, 2] = out[i - 1, 2] + (points[i, 2] - points[i - 1, 2]) * np.interp(share, middles, longer)
            if by_depth:
                done = out[root, 2] - out[i, 2]
            else:
                done += np.sqrt(((out[i] - out[i - 1]) ** 2).sum())
    return out
