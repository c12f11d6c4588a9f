"""Calibration: what a network draws spreads as the strands do that it was fitted to."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the tiny models are written by onnx")

from commands import Floats

from detangled.archives import read_arrays, write_arrays
from detangled.diffusion.calibration import END_SHARE, LONGER, calibrated, calibration, for_length
from detangled.errors import ModelError
from detangled.fitted import FittedTexture, load_texture, save_texture
from detangled.synthesis import synthesise


def drawn(count: int, cells: int, seed: int) -> list[Floats]:
    """Channels (3, n) that are normal, and wider at the root."""
    rng = np.random.default_rng(seed)
    strands = []
    for _ in range(count):
        strand = rng.standard_normal((3, cells))
        strand[:, : cells // 10] *= 2.0
        strands.append(strand)
    return strands


def test_values_take_the_rank_of_those_wanted() -> None:
    given, other = drawn(40, 300, 0), drawn(40, 300, 1)
    wanted = [0.5 + 2.0 * strand for strand in other]
    made = calibrated(np.stack(given), calibration(np.stack(given), wanted))
    aims = np.stack(wanted)
    ends = (np.arange(300) < 300 * END_SHARE) | (np.arange(300) >= 300 * (1.0 - END_SHARE))
    for cells in (ends, ~ends):
        for channel in (0, 1):
            ranks = (5, 25, 50, 75, 95)
            found, aim = (np.percentile(x[:, channel, cells], ranks) for x in (made, aims))
            np.testing.assert_allclose(found, aim, rtol=0.05, atol=0.1)
            order = np.argsort(np.stack(given)[:, channel, cells].ravel())
            assert np.all(np.diff(made[:, channel, cells].ravel()[order]) >= 0.0)
    np.testing.assert_array_equal(made[:, 2], np.stack(given)[:, 2])  # lengths are given exactly, elsewhere


def test_what_is_right_stays() -> None:
    strands = drawn(5, 200, 0)
    found = calibrated(np.stack(strands), calibration(np.stack(strands), strands))
    np.testing.assert_allclose(found, np.stack(strands), rtol=0, atol=1e-12)


def test_beyond_the_outermost_rank_values_are_shifted() -> None:
    strands = drawn(5, 200, 0)
    values = calibration(np.stack(strands), [strand + 3.0 for strand in strands])
    far = np.full((1, 3, 200), 1e3)
    np.testing.assert_allclose(calibrated(far, values)[:, :2], 1e3 + 3.0)


def test_what_strands_lose_when_they_are_made_is_given_beforehand() -> None:
    given, wanted = drawn(20, 300, 0), drawn(20, 300, 1)

    def narrowed(channels: Floats) -> Floats:
        return 0.9 * channels

    def off(levels: Floats) -> Floats:
        made, aim = narrowed(calibrated(np.stack(given), levels)), np.stack(wanted)
        return np.array([made[:, c].std() / aim[:, c].std() - 1.0 for c in (0, 1)])

    before, after = off(calibration(np.stack(given), wanted)), off(calibration(np.stack(given), wanted, narrowed))
    np.testing.assert_allclose(before, -0.1, atol=0.02)
    assert (np.abs(after) < 0.5 * np.abs(before)).all()


def test_strands_are_calibrated_as_those_nearest_in_length() -> None:
    levels = np.stack([np.zeros((2, 2, 2, 5)), np.ones((2, 2, 2, 5))])
    for times, share in ((0.5, 0.0), (1.0, 0.0), (LONGER**0.5, 0.5), (LONGER, 1.0), (3.0 * LONGER, 1.0)):
        np.testing.assert_allclose(for_length(levels, times), share)


def identity(texture: FittedTexture) -> Floats:
    levels = texture.calibration.copy()
    levels[..., 1, :] = levels[..., 0, :]
    return levels


def test_a_fitted_network_draws_what_it_was_shown(texture: FittedTexture) -> None:
    """The tiny network predicts next to nothing; its curvature is right all the same."""
    arcs = np.resize([texture.signals[a:b, 2].mean() for a, b in pairwise(texture.starts)], 40)
    errors = []
    for one in (texture, replace(texture, calibration=identity(texture))):
        values, _ = synthesise(one, arcs, np.arange(40), seed=5)
        found, aim = (np.percentile(x[:, 0], (10, 50, 90)) for x in (values, texture.signals))
        errors.append(np.abs(found / aim - 1.0).max())
    assert errors[0] < min(0.08, 0.5 * errors[1])


@pytest.mark.parametrize("wrong", ["shape", "order", "value"])
def test_a_damaged_calibration_is_refused(texture: FittedTexture, tmp_path: Path, wrong: str) -> None:
    path = tmp_path / "one.texture"
    save_texture(texture, path)
    arrays = read_arrays(path)
    levels = arrays["calibration"].copy()
    if wrong == "shape":
        levels = levels[0]
    elif wrong == "order":
        levels[0, 0, 0, 0] = levels[0, 0, 0, 0, ::-1]
    else:
        levels[0, 0, 0, 0, 3] = np.nan
    write_arrays(path, {**arrays, "calibration": levels})
    with pytest.raises(ModelError, match="damaged"):
        load_texture(path)
