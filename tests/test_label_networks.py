"""The labelers as they are run: any number of signals, on any number of threads, and their gradients."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the tiny labeler is written by onnx")

from detangled.labeling import CELLS, LabelGradient, LabelNetwork, padded
from detangled.models import LABELER, LABELER_GRADIENT, load_labeler
from tiny_labeler import BATCH, Floats, slopes, told, write_tiny

FLOAT32 = 1e-5


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny(tmp_path_factory.mktemp("models"))


def some_values(count: int, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    values = rng.uniform(0.3, 3.0, (count, CELLS, 3))
    values[:, :, 1] *= np.where(rng.uniform(size=(count, 1)) < 0.5, -1.0, 1.0)
    return values


@pytest.mark.parametrize("count", [0, 1, BATCH - 1, BATCH, 2 * BATCH + 3])
def test_the_network_takes_any_number_of_signals(models: Path, count: int) -> None:
    values = some_values(count)
    for threads in (1, 3):
        found = LabelNetwork(load_labeler(LABELER, models), threads)(values)
        assert (found.shape, found.dtype) == ((count, 3), np.float64)
        np.testing.assert_allclose(found, told(values), rtol=FLOAT32)


@pytest.mark.parametrize("count", [0, 1, BATCH, 2 * BATCH + 3])
def test_labels_and_their_gradient(models: Path, count: int) -> None:
    values = some_values(count, seed=1)
    weights = np.random.default_rng(2).standard_normal((count, 3))
    for threads in (1, 3):
        labels, gradient = LabelGradient(load_labeler(LABELER_GRADIENT, models), threads)(values, weights)
        assert (labels.dtype, gradient.dtype) == (np.float64, np.float64)
        assert gradient.shape == (count, CELLS, 3)
        np.testing.assert_allclose(labels, told(values), rtol=FLOAT32)
        np.testing.assert_allclose(gradient, slopes(values, weights), rtol=1e-4, atol=1e-8)


def test_a_signal_is_told_the_same_whatever_comes_with_it(models: Path) -> None:
    network = LabelNetwork(load_labeler(LABELER, models), 2)
    values = some_values(2 * BATCH + 1)
    together = network(values)
    np.testing.assert_array_equal(np.concatenate([network(values[k : k + 1]) for k in range(len(values))]), together)
    order = np.random.default_rng(1).permutation(len(values))
    np.testing.assert_array_equal(network(values[order]), together[order])


def test_labelers_that_know_canonical_space_alone_are_not_told_of_the_world(models: Path) -> None:
    values = some_values(BATCH)
    both = np.concatenate([values, some_values(BATCH, seed=3)[:, :, :2]], axis=2)
    np.testing.assert_array_equal(
        LabelNetwork(load_labeler(LABELER, models))(both), LabelNetwork(load_labeler(LABELER, models))(values)
    )


def test_padding_repeats_what_is_there() -> None:
    values = some_values(3)
    made = padded(values, 5)
    assert (made.shape, made.dtype) == ((5, CELLS, 3), np.float32)
    np.testing.assert_array_equal(made[:3], values.astype(np.float32))
    np.testing.assert_array_equal(made[3:], np.repeat(made[:1], 2, axis=0))
