"""What a step of the denoiser's training is given: samples of data sets, batches of them, and a process's part."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from detangled.diffusion.schedule import CosineSchedule  # noqa: E402
from detangled.diffusion.whitening import Whitening  # noqa: E402
from detangled.errors import ReadError  # noqa: E402
from detangled_training import processes  # noqa: E402
from detangled_training.dataset import read_dataset, write_dataset  # noqa: E402
from detangled_training.denoiser_training import BY_ITSELF, Samples, Training, draw_batch  # noqa: E402
from detangled_training.variants import VariantOptions  # noqa: E402
from tiny_training import STEPS, tiny_options, write_strands  # noqa: E402


@pytest.fixture(scope="module")
def strands(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_strands(tmp_path_factory.mktemp("strands"))


def test_processes_share_one_batch_at_one_rate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, strands: Path) -> None:
    """What each of two processes is given makes up what a single one is given, at the same learning rates."""
    for name in ("init_process_group", "all_reduce"):
        monkeypatch.setattr(processes.distributed, name, lambda *_: None)
    samples = Training(tiny_options(), tmp_path, [strands]).prepare().samples
    whitening = samples.whitening()

    def steps_of(rank: int, world: int) -> tuple[list[Any], list[float]]:
        monkeypatch.setenv("RANK", str(rank))
        monkeypatch.setenv("WORLD_SIZE", str(world))
        training = Training(tiny_options(), tmp_path, [strands])
        given: list[Any] = []
        rates = []
        training.network.register_forward_pre_hook(lambda _, inputs: given.append(inputs))
        for training.step in range(STEPS):
            training._train(draw_batch(samples, whitening, training.schedule, training.options, training.step))
            rates.append(training.optimizer.param_groups[0]["lr"])
        return given, rates

    alone, rates = steps_of(0, 1)
    (first, first_rates), (second, second_rates) = steps_of(0, 2), steps_of(1, 2)
    assert first_rates == second_rates == rates
    assert rates[0] < rates[1] > rates[-1]
    for whole, *halves in zip(alone, first, second, strict=True):
        for tensor, *parts in zip(whole, *halves, strict=True):
            assert torch.equal(tensor, torch.cat(parts))
    # No step sees what another saw.
    assert not torch.equal(alone[0][0], alone[1][0])


def test_samples_are_what_the_data_sets_hold_but_for_strands_as_read(strands: Path, tmp_path: Path) -> None:
    write_dataset(tmp_path, 45, 5, VariantOptions(cells=256, read_share=0.5), workers=1)
    data = read_dataset(tmp_path)
    samples = Samples.of([data])
    kept = ~data.labels["read"]
    assert 0 < kept.sum() < len(kept)
    # All of one hand.
    right = (
        data.signals[kept] * np.stack([np.ones(kept.sum()), data.labels["hand"][kept], np.ones(kept.sum())], 1)[:, None]
    )
    np.testing.assert_array_equal(samples.signals, right)
    assert 0.2 < (data.labels["hand"][kept] > 0).mean() < 0.8
    assert (np.median(samples.signals[:, :, 1], axis=1) > 0.0).mean() > 0.9
    np.testing.assert_allclose(np.exp(samples.asked[:, 0]), data.labels["radius"][kept], rtol=1e-6)
    np.testing.assert_allclose(np.exp(samples.asked[:, 1]), data.labels["wavelength"][kept], rtol=1e-6)
    np.testing.assert_allclose(np.exp(samples.asked[:, 3]), samples.signals[:, :, 2].mean(axis=1), rtol=1e-5)
    assert ((samples.asked[:, 2] >= 0.0) & (samples.asked[:, 2] <= 1.0)).all()
    assert not samples.asked[:, 4].any()
    hung = replace(data, labels={**data.labels, "variant": np.arange(len(kept)) % 3 - 1})
    np.testing.assert_array_equal(Samples.of([hung]).asked[:, 4], (hung.labels["variant"] >= 0)[kept])
    assert len(Samples.of([data, data])) == 2 * len(samples)
    with pytest.raises(ReadError, match="different cells"):
        Samples.of([data, read_dataset(strands)])


def test_a_batch_is_of_whitened_signals_of_one_hand_and_of_some_by_themselves_of_either(strands: Path) -> None:
    samples = Samples.of([read_dataset(strands)])
    options, whitening = tiny_options(batch=512), samples.whitening()
    batch = draw_batch(samples, whitening, CosineSchedule(), options, 3)
    clean = batch.clean.numpy().astype(np.float64)
    values = samples.signals.astype(np.float64)
    away = np.abs(clean[:, None] - whitening.whiten(values)[None]).max(axis=(2, 3))
    found = away.min(axis=1) < 1e-5
    assert abs(found.mean() - (1.0 - BY_ITSELF)) < 0.1
    # The others have the mean and deviation that whitening gives a strand by itself, and nothing is asked of them.
    alone = np.stack([Whitening.of([one]).whiten(one) for one in values])
    curvature = np.abs(clean[~found][:, None, 0] - alone[None, :, 0]).max(axis=2).argmin(axis=1)
    hands = np.sign((clean[~found][:, 1] * alone[curvature, 1]).mean(axis=1))
    assert 0.3 < (hands > 0).mean() < 0.7
    np.testing.assert_allclose(clean[~found].mean(axis=2), 0.0, atol=1e-5)
    known = batch.known.numpy()
    assert not known[~found].any()
    assert 0.7 < known[found].mean() < 0.9
    alpha = np.sqrt(1.0 / (1.0 + np.exp(-batch.log_snr.numpy().astype(np.float64))))[:, None, None]
    noise = (batch.noisy.numpy() - alpha * clean) / np.sqrt(1.0 - alpha**2)
    assert abs(float(noise.std()) - 1.0) < 0.02
