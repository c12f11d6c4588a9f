"""The network's predictions: windows, batches, other weights."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("onnx", reason="the tiny models are written by onnx")

from commands import FLOAT32, Floats
from tiny_models import (
    CELLS,
    WEIGHTS,
    predicted,
)

from detangled.diffusion.denoiser import (
    BATCH,
    LEAST_OVERLAP,
    NetworkDenoiser,
    blend_weights,
    window_starts,
)
from detangled.errors import ModelError
from detangled.models import CONDITION_NAMES, Model


def signals_like(strands: int, cells: int, seed: int = 0) -> Floats:
    return np.random.default_rng(seed).standard_normal((strands, 3, cells))


ALPHA, SIGMA = 0.6, 0.8
LOG_SNR = 2.0 * np.log(ALPHA / SIGMA)


def formula(weights: NDArray[Any], noisy: Floats, first: int = 0, cells: int | None = None) -> Floats:
    """The network's prediction for a part of a strand of so many cells, which starts at ``first``."""
    at = (first + np.arange(noisy.shape[2]) + 0.5) / (cells or noisy.shape[2])
    return predicted(weights, noisy, np.full(len(noisy), LOG_SNR), np.tile(at, (len(noisy), 1)))


@pytest.mark.parametrize("cells", [16, 48, CELLS])
@pytest.mark.parametrize("strands", [1, BATCH, BATCH + 3])
def test_a_short_strand_is_shown_whole_with_nothing_asked(denoiser: Model, cells: int, strands: int) -> None:
    noisy = signals_like(strands, cells)
    found = NetworkDenoiser(denoiser)(noisy, ALPHA, SIGMA)
    assert (found.shape, found.dtype) == (noisy.shape, np.float64)
    np.testing.assert_allclose(found, formula(WEIGHTS, noisy), rtol=0, atol=FLOAT32)


@pytest.mark.parametrize("cells", [CELLS, 2 * CELLS])
def test_what_is_asked_of_a_strand_its_windows_are_told_with_their_own_length(denoiser: Model, cells: int) -> None:
    noisy = np.zeros((2, 3, cells))
    asked = np.array([[0.5, np.nan, 0.25, 1.0, np.nan], [np.nan, np.nan, np.nan, np.nan, 1.0]])
    told = asked + np.log(CELLS / cells) * (np.array(CONDITION_NAMES) == "log length")
    found = NetworkDenoiser(denoiser)(noisy, ALPHA, SIGMA, asked)
    added = found - NetworkDenoiser(denoiser)(noisy, ALPHA, SIGMA)
    wanted = np.nansum(told + 1.0, axis=1)[:, None, None] * np.ones(noisy.shape)
    np.testing.assert_allclose(added, wanted, rtol=0, atol=FLOAT32)


@pytest.mark.parametrize("cells", [CELLS, 3 * CELLS + 16])
def test_a_strand_depends_neither_on_its_batch_nor_on_threads(denoiser: Model, cells: int) -> None:
    noisy = signals_like(2 * BATCH + 3, cells)
    alone = [NetworkDenoiser(denoiser)(noisy[k : k + 1], ALPHA, SIGMA)[0] for k in range(len(noisy))]
    order = np.random.default_rng(1).permutation(len(noisy))
    for threads in (1, 2, 3):
        network = NetworkDenoiser(denoiser, threads=threads)
        np.testing.assert_array_equal(network(noisy, ALPHA, SIGMA), alone)
        np.testing.assert_array_equal(network(noisy[order], ALPHA, SIGMA), np.array(alone)[order])


@pytest.mark.parametrize("size", [16, CELLS, 256])
def test_windows_cover_a_strand_and_overlap(size: int) -> None:
    for cells in (*range(16, 6 * size, 16), 100 * size + 16):
        starts = window_starts(cells, min(size, cells))
        assert starts[0] == 0
        assert starts[-1] == max(cells - size, 0)
        if cells <= size:
            assert len(starts) == 1
            continue
        strides = np.diff(starts)
        assert strides.min() > 0
        assert strides.max() <= (1.0 - LEAST_OVERLAP) * size
        # One window fewer would not overlap enough.
        assert (len(starts) - 2) * (1.0 - LEAST_OVERLAP) * size < cells - size


@pytest.mark.parametrize("size", [16, CELLS, 256])
def test_every_cell_of_a_window_counts_and_its_ends_less(size: int) -> None:
    share = blend_weights(size)
    assert share.shape == (size,)
    assert share.min() > 0.0
    assert share.max() == share[size // 2] == 1.0
    np.testing.assert_array_equal(share, share[::-1])
    assert np.all(np.diff(share[: int(LEAST_OVERLAP * size)]) > 0.0)


@pytest.mark.parametrize("cells", [CELLS + 16, 3 * CELLS, 9 * CELLS + 48])
def test_windows_of_a_pointwise_network_make_the_strand_itself(denoiser: Model, cells: int) -> None:
    weights = WEIGHTS.reshape(3, 4).copy()
    weights[:, 3] = 0.0
    noisy = signals_like(BATCH - 1, cells)
    found = NetworkDenoiser(denoiser, weights.ravel())(noisy, ALPHA, SIGMA)
    # With each cell's place in the whole strand, not in its window.
    np.testing.assert_allclose(found, formula(weights, noisy), rtol=0, atol=FLOAT32)


def test_where_windows_differ_they_are_blended(denoiser: Model) -> None:
    # This network sees a window's mean, which no two windows share.
    cells = 4 * CELLS + 32
    noisy = signals_like(3, cells)
    total, weight = np.zeros(noisy.shape), np.zeros(cells)
    for first in window_starts(cells, CELLS):
        part = slice(first, first + CELLS)
        total[:, :, part] += blend_weights(CELLS) * formula(WEIGHTS, noisy[:, :, part], int(first), cells)
        weight[part] += blend_weights(CELLS)
    found = NetworkDenoiser(denoiser)(noisy, ALPHA, SIGMA)
    np.testing.assert_allclose(found, total / weight, rtol=0, atol=FLOAT32)
    assert np.abs(found - formula(WEIGHTS, noisy)).max() > 100 * FLOAT32


def test_other_weights_predict_otherwise(denoiser: Model) -> None:
    noisy = signals_like(2, CELLS)
    other = (WEIGHTS * np.float16(2.0)).astype(np.float16)
    found = NetworkDenoiser(denoiser, other)(noisy, ALPHA, SIGMA)
    np.testing.assert_allclose(found, 2.0 * formula(WEIGHTS, noisy), rtol=0, atol=2 * FLOAT32)
    # The model itself has kept its own.
    np.testing.assert_array_equal(denoiser.weights, WEIGHTS)


@pytest.mark.parametrize(
    "weights", [WEIGHTS[:-1], WEIGHTS.astype(np.float32), WEIGHTS.reshape(3, 4), np.empty(0, np.float16)]
)
def test_weights_of_another_kind_are_refused(denoiser: Model, weights: NDArray[Any]) -> None:
    with pytest.raises(ModelError, match=r"denoiser\.onnx: .*not 12 float16"):
        NetworkDenoiser(denoiser, weights)


def test_a_file_that_is_no_network_is_refused(denoiser: Model) -> None:
    with pytest.raises(ModelError, match=r"denoiser\.onnx: onnxruntime .* cannot run it"):
        replace(denoiser, data=b"no network").session()
