"""Strands whose axes wander are drawn anew, where their texture is one of strands that do not twist."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from detangled.base_texture import Texture
from detangled.drawing import FAR_WANDER, ToDraw, draw_strands

RADIUS, WAVELENGTH, TURNS = 0.5, 0.6, 24
TURN = float(np.hypot(2.0 * np.pi * RADIUS, WAVELENGTH))
TURNED = 1.5  # [rad] about the tangent, halfway down: it tilts the axis by about as much


class OftenBent:
    """Draws helices, of which two in three are turned halfway down, each as its own random numbers say."""

    def draw(
        self, cells: int, arcs: NDArray[np.float64], generators: list[np.random.Generator], steps: int
    ) -> NDArray[np.float64]:
        squared = (TURN / (2.0 * np.pi)) ** 2
        helix = [RADIUS / squared, WAVELENGTH / (2.0 * np.pi) / squared, TURNS * TURN]
        values = np.tile(helix, (len(arcs), cells, 1))
        for strand, rng in enumerate(generators):
            if rng.random() < 2.0 / 3.0:
                values[strand, cells // 2, 1] += TURNED * cells / arcs[strand]
        return values


def texture(stiff: bool) -> Texture:
    return Texture(
        cell_width=TURN / 16,
        turn=TURN,
        median_arc=TURNS * TURN,
        arc_per_axis=TURN / WAVELENGTH,
        radius=RADIUS,
        wavelength=WAVELENGTH,
        stiff=stiff,
    )


def bent(stiff: bool, names: list[int]) -> NDArray[np.bool_]:
    count = len(names)
    arcs, none = np.full(count, TURNS * TURN), np.zeros(count)
    what = ToDraw(arcs, arcs, np.array(names), cut=none > 0.0, straight=none > 0.0, dropped=none)
    drawn = draw_strands(texture(stiff), what, 5, 1, None, OftenBent())
    found = drawn.values[:, 1].reshape(count, -1).max(axis=1) > 2.0
    if stiff:
        np.testing.assert_array_equal(drawn.off > 1.0, found)
    return np.asarray(found)


def test_strands_whose_axes_wander_are_drawn_anew() -> None:
    assert 1.0 / np.cos(0.5 * TURNED) - 1.0 > FAR_WANDER
    once, anew = bent(False, list(range(60))), bent(True, list(range(60)))
    # Of two in three that are bent at each of five times.
    assert np.mean(once) == pytest.approx(2.0 / 3.0, abs=0.15)
    assert np.mean(anew) == pytest.approx((2.0 / 3.0) ** 5, abs=0.1)
    assert not (anew & ~once).any()


def test_a_strand_drawn_anew_depends_on_no_others() -> None:
    whole = bent(True, list(range(30)))
    np.testing.assert_array_equal(bent(True, [7, 11, 23]), whole[[7, 11, 23]])
