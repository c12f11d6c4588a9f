"""Guidance: signals are moved to where labelers read what is asked, by gradients or by finite differences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("onnx", reason="the tiny labelers are written by onnx")

from detangled.diffusion.guidance import (
    LABELS,
    MODES,
    MOST,
    SURE,
    Guidance,
    by_differences,
    by_gradients,
    damped_step,
    logarithmic,
    modes,
)
from detangled.geometry.signal import signals
from detangled.labeling import CELLS, LabelGradient, LabelNetwork
from detangled.library import load_library
from detangled.models import LABELER, LABELER_GRADIENT, load_labeler
from detangled.texture import arc_of_a_turn
from tiny_labeler import write_tiny

ALL = np.ones(LABELS, dtype=np.bool_)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny(tmp_path_factory.mktemp("labelers"))


@pytest.fixture(scope="module")
def labeler(tiny: Path) -> LabelNetwork:
    return LabelNetwork(load_labeler(LABELER, tiny))


@pytest.fixture(scope="module")
def gradient(tiny: Path) -> LabelGradient:
    return LabelGradient(load_labeler(LABELER_GRADIENT, tiny))


def coils(count: int, cells: int = CELLS, seed: int = 0) -> NDArray[np.float64]:
    """Signals of bumpy coils."""
    rng = np.random.default_rng(seed)
    values = np.empty((count, cells, 3))
    values[:, :, 0] = rng.uniform(1.0, 3.0, (count, 1)) * (1.0 + 0.2 * rng.standard_normal((count, cells)))
    values[:, :, 1] = rng.uniform(0.5, 2.0, (count, 1)) * (1.0 + 0.2 * rng.standard_normal((count, cells)))
    values[:, :, 2] = 12.0
    return values


def of(wanted: tuple[float, float, float], labeler: LabelNetwork, gradient: LabelGradient | None) -> Guidance:
    derivatives = by_differences(labeler) if gradient is None else by_gradients(gradient)
    return Guidance(np.array([*np.log(wanted[:2]), wanted[2]]), 2.0, labeler, derivatives)


@pytest.mark.parametrize("by", ["gradients", "differences"])
def test_signals_are_moved_until_they_read_as_wanted(labeler: LabelNetwork, gradient: LabelGradient, by: str) -> None:
    guided = of((0.4, 1.5, np.nan), labeler, gradient if by == "gradients" else None).begin()
    values = coils(5)
    far = np.abs(logarithmic(labeler(values))[:, :2] - np.log([0.4, 1.5])).max()
    assert far > 0.2
    for _ in range(10):
        values = guided(values, ALL)
    found = labeler(values)
    np.testing.assert_allclose(found[:, 0], 0.4, rtol=0.02)
    np.testing.assert_allclose(found[:, 1], 1.5, rtol=0.02)
    assert (values[:, :, 0] >= 0.0).all()
    np.testing.assert_array_equal(values[:, :, 2], 12.0)


def test_what_is_not_wanted_or_not_counted_is_left(labeler: LabelNetwork, gradient: LabelGradient) -> None:
    values = coils(3)
    nothing = of((np.nan, np.nan, np.nan), labeler, gradient).begin()
    np.testing.assert_array_equal(nothing(values, ALL), values)
    everything = of((0.4, 1.5, 0.5), labeler, gradient).begin()
    np.testing.assert_array_equal(everything(values, ~ALL), values)
    # The radius alone: of what reads as far off, it is what gets nearer.
    radius = of((0.4, np.nan, np.nan), labeler, gradient).begin()
    moved = radius(values, ALL)
    before, after = np.abs(np.log(labeler(values)[:, 0] / 0.4)), np.abs(np.log(labeler(moved)[:, 0] / 0.4))
    assert (after < 0.7 * before).all()


def test_a_strand_is_guided_by_itself(labeler: LabelNetwork, gradient: LabelGradient) -> None:
    values = coils(7)
    guidance = of((0.5, 2.0, 0.4), labeler, gradient)
    together, alone = guidance.begin(), [guidance.begin() for _ in values]
    all_of_them, each = values, [values[k : k + 1] for k in range(len(values))]
    for _ in range(3):
        all_of_them = together(all_of_them, ALL)
        each = [one(part, ALL) for one, part in zip(alone, each, strict=True)]
    np.testing.assert_array_equal(all_of_them, np.concatenate(each))


def test_long_strands_are_read_in_windows_that_are_blended(labeler: LabelNetwork, gradient: LabelGradient) -> None:
    long = coils(1, 3 * CELLS)
    long[:, :, 2] = 36.0
    # Wide in the upper half, narrow in the lower: each is moved its own way.
    long[:, : 3 * CELLS // 2, 0] *= 2.0
    guided = of((0.4, 1.5, np.nan), labeler, gradient).begin()
    moved = long
    for _ in range(12):
        moved = guided(moved, ALL)
    assert moved.shape == long.shape
    for first in (0, 2 * CELLS):
        window = moved[:, first : first + CELLS] * [1.0, 1.0, 1.0 / 3.0]
        np.testing.assert_allclose(labeler(window)[:, :2], [[0.4, 1.5]], rtol=0.1)


def test_modes_are_all_of_a_channel_and_what_departs_from_its_mean_over_a_turn() -> None:
    values = coils(2)
    values[0, :, :2] = (3.0, 1.0)
    turns = modes(values, 2.0)
    assert turns.shape == (2, MODES, CELLS, 2)
    for channel in range(2):
        np.testing.assert_array_equal(turns[:, channel, :, channel], values[:, :, channel])
        np.testing.assert_array_equal(turns[:, channel, :, 1 - channel], 0.0)
        np.testing.assert_allclose(turns[0, 2 + channel], 0.0, atol=1e-12)
    # A turn of 2 cm is 2/12 of the cells: a bump far from a cell does not count there.
    half = round(CELLS / 12)
    wanted = values[1, 100, 0] - values[1, 100 - half : 101 + half, 0].mean()
    assert turns[1, 2, 100, 0] == pytest.approx(wanted)


def test_a_step_makes_up_for_what_is_missing_but_goes_no_further_than_it_may() -> None:
    derivatives = np.array([[[-0.1, -0.9, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.1], [0.0, 0.2, 0.0, 0.3]]])
    missing = np.array([[0.05, -0.03, 0.0]])
    step = damped_step(derivatives, missing, np.full(3, 1e-6))
    np.testing.assert_allclose(derivatives[0] @ step[0], missing[0], atol=1e-6)
    assert np.abs(damped_step(derivatives, 100.0 * missing, SURE)).max() == MOST
    unsure = damped_step(derivatives, missing, np.full(3, 10.0))
    assert np.abs(unsure).max() < 0.01


def test_the_shipped_labelers_gradients_point_where_finite_differences_do() -> None:
    library = load_library()
    some = np.linspace(0, len(library.radius) - 1, 24).astype(np.int64)
    points, offsets = library.select(some)
    values = signals(points, offsets, CELLS * np.arange(len(some) + 1)).reshape(-1, CELLS, 3)
    directions = modes(values, float(np.median(arc_of_a_turn(library.radius[some], library.wavelength[some]))))
    exact = by_gradients(LabelGradient(load_labeler(LABELER_GRADIENT), 2))(values, directions)
    near = by_differences(LabelNetwork(load_labeler(), 2))(values, directions)
    cosine = (exact * near).sum(axis=2) / np.linalg.norm(exact, axis=2) / np.linalg.norm(near, axis=2)
    assert (np.median(cosine, axis=0) > 0.99).all()
    assert (np.quantile(cosine, 0.1, axis=0) > 0.9).all()
