"""What is drawn for strands, and which are drawn anew: where hair does not twist, those whose axes wander."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from detangled.base_texture import Texture
from detangled.drawing import FAR_WANDER, ToDraw, draw_strands
from detangled.fitted import FINETUNE
from detangled.fitting import fit
from detangled.groom import Groom
from detangled.grooming.lengths import Length
from detangled.retexturing import strands_to_make

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
    what = ToDraw(arcs, arcs, np.array(names), cut=none > 0.0, straight=none > 0.0, dropped=none, spare=none)
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


def test_pieces_are_taken_from_where_an_axis_does_not_bend() -> None:
    count, piece = 40, 6.0 * TURN
    arcs, none = np.full(count, TURNS * TURN), np.zeros(count)
    what = ToDraw(
        arcs,
        none + piece,
        np.arange(count),
        cut=none == 0.0,
        straight=none > 0.0,
        dropped=none + TURN,
        spare=arcs - piece - 2.0 * TURN,
    )
    within = {}
    for stiff in (False, True):
        drawn = draw_strands(texture(stiff), what, 5, 1, None, OftenBent())
        often = drawn.values[:, 1].reshape(count, -1).max(axis=1) > 2.0
        assert 0.5 < np.mean(often) < 0.8  # bent strands are not drawn anew if a piece of them will do
        assert ((drawn.dropped >= TURN) & (drawn.dropped <= arcs - TURN - piece)).all()
        assert len(np.unique(drawn.dropped)) == count
        halfway = 0.5 * arcs
        within[stiff] = often & (drawn.dropped < halfway) & (halfway < drawn.dropped + piece)
        some = draw_strands(texture(stiff), what.select(np.array([3, 17])), 5, 1, None, OftenBent())
        np.testing.assert_array_equal(some.dropped, drawn.dropped[[3, 17]])
    assert within[False].any()
    assert not within[True].any()


def coil() -> NDArray[np.float64]:
    angle = np.linspace(0.0, 2.0 * np.pi * TURNS, 16 * TURNS)
    return np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), -WAVELENGTH * angle / (2.0 * np.pi)], axis=1)


def test_textures_fitted_to_coils_are_known_to_have_no_twists() -> None:
    assert fit(Groom.from_strands([coil(), 1.1 * coil()])).stiff


def test_a_network_is_asked_for_no_strands_shorter_than_those_it_was_shown() -> None:
    patches = fit(Groom.from_strands([coil()]))
    network = replace(patches, method=FINETUNE)
    goals = np.linspace(0.05, 1.5, 80) * patches.median_arc / patches.arc_per_axis
    what, by_patches = (strands_to_make(t, goals, Length.GUIDE, np.arange(80)) for t in (network, patches))
    assert what.arcs.min() == network.median_arc
    shorter = by_patches.arcs < network.median_arc
    np.testing.assert_array_equal(what.arcs[~shorter], by_patches.arcs[~shorter])
    # Cut from anywhere within, as far as there is room.
    assert what.cut[shorter].all()
    assert (what.dropped + what.spare + what.kept <= what.arcs * (1.0 + 1e-9))[shorter].all()
    np.testing.assert_array_equal(what.dropped, by_patches.dropped)
    assert (what.spare > 0.0)[shorter].any()
    assert not what.spare[~shorter].any()


def test_a_strand_drawn_anew_depends_on_no_others() -> None:
    whole = bent(True, list(range(30)))
    np.testing.assert_array_equal(bent(True, [7, 11, 23]), whole[[7, 11, 23]])
