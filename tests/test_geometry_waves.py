"""Axes of waves whose wavelength is known: those of helices, bent ones too, and of strands of hardly a turn."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from detangled.geometry.waves import END_TURNS, wave_axes
from detangled.texture import arc_of_a_turn

RADIUS, WAVELENGTH, POINTS_A_TURN = 0.45, 9.0, 64


def helix(turns: float) -> NDArray[np.float64]:
    angle = 2.0 * np.pi * np.arange(round(turns * POINTS_A_TURN) + 1) / POINTS_A_TURN
    return np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), -WAVELENGTH * angle / (2.0 * np.pi)], axis=1)


def axes(*strands: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    offsets = np.concatenate([[0], np.cumsum([len(strand) for strand in strands])])
    turn = float(arc_of_a_turn(RADIUS, WAVELENGTH))
    found = wave_axes(np.concatenate(strands), offsets, np.full(len(strands), turn))
    return np.split(found, offsets[1:-1])


@pytest.mark.parametrize("turns", [4.3, 6.0, 11.7])
def test_the_axis_of_a_helix_is_its_axis(turns: float) -> None:
    strand = helix(turns)
    (axis,) = axes(strand)
    np.testing.assert_allclose(np.hypot(axis[:, 0], axis[:, 1]), 0.0, atol=0.02 * RADIUS)
    np.testing.assert_allclose(axis[:, 2], strand[:, 2], atol=0.01 * WAVELENGTH)


def test_a_bent_axis_is_followed_where_it_is_known() -> None:
    strand = helix(10.0)
    bend = 0.002 * strand[:, 2] ** 2
    bent = strand + np.stack([bend, 0.0 * bend, 0.0 * bend], axis=1)
    (axis,) = axes(bent)
    known = slice(round(END_TURNS * POINTS_A_TURN), -round(END_TURNS * POINTS_A_TURN))
    assert np.abs(axis[known, 0] - bend[known]).max() < 0.12
    assert np.ptp(bend[known]) > 10.0


def test_where_it_is_not_known_the_axis_goes_straight_on() -> None:
    rng = np.random.default_rng(0)
    strand = helix(8.0) + 0.01 * np.cumsum(rng.standard_normal((8 * POINTS_A_TURN + 1, 3)), axis=0)
    (axis,) = axes(strand)
    steps = np.diff(axis, axis=0)
    for end in (slice(0, POINTS_A_TURN), slice(-POINTS_A_TURN, None)):
        np.testing.assert_allclose(steps[end] - steps[end][0], 0.0, atol=1e-9)


@pytest.mark.parametrize("turns", [0.3, 1.0, 2.9])
def test_of_hardly_a_turn_the_axis_is_the_chord(turns: float) -> None:
    strand = helix(turns)
    (axis,) = axes(strand)
    np.testing.assert_allclose(axis, np.linspace(strand[0], strand[-1], len(strand)), atol=1e-9)


def test_strands_do_not_depend_on_each_other() -> None:
    one, other = helix(5.0), helix(7.0)[:, [1, 2, 0]]
    together = axes(one, other)
    for found, alone in zip(together, (axes(one)[0], axes(other)[0]), strict=True):
        np.testing.assert_array_equal(found, alone)
