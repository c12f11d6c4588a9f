"""The engine that trains a network, with models of a dozen weights: from the files to the command, without torch."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("onnx", reason="the tiny models are written by onnx")

from detangled.archives import read_arrays, write_arrays
from detangled.diffusion import finetune
from detangled.diffusion.denoiser import (
    BATCH,
    LEAST_OVERLAP,
    NetworkDenoiser,
    blend_weights,
    window_starts,
)
from detangled.diffusion.finetune import FineTuning, curl_both_ways, draw_windows, fine_tune
from detangled.diffusion.schedule import CosineSchedule
from detangled.errors import ModelError, TextureError
from detangled.fitted import FINETUNE, FittedTexture, load_texture, save_texture
from detangled.fitting import fit
from detangled.formats import read, write
from detangled.geometry.spline import chord_lengths, spline_slopes
from detangled.groom import Groom
from detangled.grooming.guides import style_guides
from detangled.kernels import set_threads, thread_count
from detangled.models import (
    DENOISER,
    FOLDER_VARIABLE,
    TRAINING_STEP,
    Model,
    load_model,
    same_network,
)
from detangled_cli.main import detangled
from tiny_models import (
    ARCHITECTURE,
    BETA1,
    BETA2,
    CELLS,
    EPSILON,
    FASTER,
    PARAMETERS,
    WEIGHTS,
    WHITENING,
    export_tiny,
    predicted,
)
from tiny_models import BATCH as STEP_BATCH

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SHIPPED = Path(__file__).resolve().parents[1] / "exported_models" / "detangled_models"
COILY = EXAMPLES / "coily_strands.obj"
BOB_STRANDS = [3, 77, 151, 225]
LENGTH_ACCURACY = 1e-3
FLOAT32 = 1e-5  # of sums of a few numbers about one
FILES = {DENOISER: "denoiser", TRAINING_STEP: "training_step"}
FIELDS = ("format", "version", "kind", "architecture", "parameters", "whitening", "schedule", "cells", "opset")
FIELDS_OF = {
    DENOISER: (*FIELDS, "sha256", "training", "weights"),
    TRAINING_STEP: (*FIELDS, "sha256", "training", "batch"),
}

Result = tuple[int, str]
Command = Callable[..., Result]
Floats = NDArray[np.float64]


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_tiny(tmp_path_factory.mktemp("models"))


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """Models of a test's own, to spoil."""
    return export_tiny(tmp_path / "own")


@pytest.fixture(scope="module")
def denoiser(models: Path) -> Model:
    return load_model(DENOISER, models)


@pytest.fixture(scope="module")
def step(models: Path) -> Model:
    return load_model(TRAINING_STEP, models)


@pytest.fixture(autouse=True)
def installed(models: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The tiny models in place of the real ones, and as many threads afterwards as before."""
    threads = thread_count()
    monkeypatch.setenv(FOLDER_VARIABLE, str(models))
    yield
    set_threads(threads)


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str]) -> Command:
    """Run a verb in this process: its exit code and what it said on stderr."""

    def run(*arguments: object) -> Result:
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            detangled.main(list(map(str, arguments)), prog_name="detangled")
        said = capsys.readouterr()
        assert said.out == ""
        return int(ended.value.code or 0), said.err

    return run


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some strands of the bob, in metres, with its attributes."""
    path = tmp_path_factory.mktemp("few") / "few.abc"
    write(read(EXAMPLES / "bob.abc", unit="m").select(BOB_STRANDS), path)
    return path


@pytest.fixture(scope="module")
def texture(models: Path) -> FittedTexture:
    """The coily example's, by the network."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(FOLDER_VARIABLE, str(models))
        return fit(read(COILY, unit="cm"), FINETUNE)


def assert_refused(result: Result, code: int, *words: str) -> None:
    """One line on stderr that says what was wrong, and nothing else but notes."""
    assert result[0] == code, result[1]
    errors = [line for line in result[1].splitlines() if line.startswith("detangled: error: ")]
    assert len(errors) == 1, result[1]
    assert "Traceback" not in result[1]
    assert warnings_in(result[1]) == []
    for word in words:
        assert word in errors[0]


def warnings_in(said: str) -> list[str]:
    """Warnings on stderr, but for those of units that were guessed."""
    return [line for line in said.splitlines() if "warning" in line.lower() and "--unit" not in line]


def rewrite(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change a manifest in place."""
    manifest = json.loads(path.read_text(encoding="utf-8"))
    change(manifest)
    path.write_text(json.dumps(manifest), encoding="utf-8")


# ---- the files


def test_whole_models_are_accepted(denoiser: Model, step: Model) -> None:
    np.testing.assert_array_equal(denoiser.weights, WEIGHTS)
    assert denoiser.weights.dtype == np.float16
    assert (denoiser.kind, step.kind, step.batch) == (DENOISER, TRAINING_STEP, STEP_BATCH)
    for model in (denoiser, step):
        assert (model.parameters, model.cells, model.architecture) == (PARAMETERS, CELLS, ARCHITECTURE)
        assert (model.whitening, model.schedule) == (WHITENING, CosineSchedule())
    assert same_network(denoiser, step)


@pytest.mark.parametrize("kind", [DENOISER, TRAINING_STEP])
@pytest.mark.parametrize("suffix", [".onnx", ".json"])
def test_a_missing_file_is_named(own: Path, kind: str, suffix: str) -> None:
    path = own / f"{FILES[kind]}{suffix}"
    path.unlink()
    assert_told(own, kind, path, "No such file")


def assert_told(folder: Path, kind: str, path: Path, *words: str) -> None:
    """A model is refused in one sentence that names the file and says what to do."""
    with pytest.raises(ModelError) as refusal:
        load_model(kind, folder)
    said = str(refusal.value)
    assert said.startswith(f"{path}: ")
    assert "\n" not in said
    for word in (*words, "install detangled again", "export the model anew"):
        assert word in said


@pytest.mark.parametrize("kind", [DENOISER, TRAINING_STEP])
def test_a_flipped_bit_is_found(own: Path, kind: str) -> None:
    path = own / f"{FILES[kind]}.onnx"
    data = path.read_bytes()
    for at in (0, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        assert_told(own, kind, path, "its bytes are not those")
    path.write_bytes(data[:-1])
    assert_told(own, kind, path, "its bytes are not those")


@pytest.mark.parametrize(("kind", "field"), [(kind, field) for kind, fields in FIELDS_OF.items() for field in fields])
def test_a_manifest_without_a_field_is_refused(own: Path, kind: str, field: str) -> None:
    path = own / f"{FILES[kind]}.json"
    rewrite(path, lambda manifest: manifest.pop(field))
    # A file without format or version is not known for a manifest of this version at all.
    words = {"format": "not a model's manifest", "version": "a model of version None"}
    assert_told(own, kind, path, words.get(field, f"lacks {field}"))


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "7", '"format"', "\udcff", "{}", '{"format": "other"}'])
def test_what_is_no_manifest_is_refused(own: Path, text: str) -> None:
    path = own / "denoiser.json"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    assert_told(own, DENOISER, path, "not a model's manifest")


@pytest.mark.parametrize("version", [0, 2, "1", None])
def test_other_versions_are_refused(own: Path, version: object) -> None:
    path = own / "training_step.json"
    rewrite(path, lambda manifest: manifest.update(version=version))
    assert_told(own, TRAINING_STEP, path, f"version {version}", "reads version 1")


def test_one_kind_is_not_taken_for_the_other(own: Path) -> None:
    for suffix in (".onnx", ".json"):
        (own / f"denoiser{suffix}").write_bytes((own / f"training_step{suffix}").read_bytes())
    assert_told(own, DENOISER, own / "denoiser.json", "a training step, not a denoiser")


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        (DENOISER, {"parameters": 0}),
        (DENOISER, {"parameters": "many"}),
        (DENOISER, {"parameters": PARAMETERS * 1000}),
        (DENOISER, {"parameters": float("inf")}),
        (DENOISER, {"cells": -64}),
        (DENOISER, {"weights": {}}),
        (DENOISER, {"weights": {"offset": -1}}),
        (DENOISER, {"weights": None}),
        (DENOISER, {"architecture": 3}),
        (DENOISER, {"whitening": {"scale": [1.0, 1.0]}}),
        (DENOISER, {"whitening": None}),
        (DENOISER, {"schedule": {"offset": -1.0}}),
        (DENOISER, {"schedule": {"speed": 1.0}}),
        (DENOISER, {"schedule": {"lambda_min": float("nan")}}),
        (TRAINING_STEP, {"batch": 0}),
        (TRAINING_STEP, {"batch": None}),
    ],
)
def test_senseless_fields_are_damage(own: Path, kind: str, change: dict[str, Any]) -> None:
    path = own / f"{FILES[kind]}.json"
    rewrite(path, lambda manifest: manifest.update(change))
    assert_told(own, kind, path, "damaged")


def other_network(folder: Path) -> Path:
    """A training step that belongs to another network."""
    other = export_tiny(folder.with_name("other"), {"features": 5})
    for suffix in (".onnx", ".json"):
        (folder / f"training_step{suffix}").write_bytes((other / f"training_step{suffix}").read_bytes())
    return folder


@pytest.mark.parametrize("field", ["architecture", "parameters", "whitening", "schedule", "cells"])
def test_networks_that_differ_in_anything_are_not_the_same(denoiser: Model, step: Model, field: str) -> None:
    other: dict[str, Any] = {
        "architecture": {"features": 5},
        "parameters": PARAMETERS + 1,
        "whitening": replace(WHITENING, mean=(0.0, 0.0, 0.0)),
        "schedule": CosineSchedule(offset=0.01),
        "cells": 2 * CELLS,
    }
    assert not same_network(denoiser, replace(step, **{field: other[field]}))


@pytest.mark.parametrize("fault", ["missing", "damaged", "of another version", "of different networks"])
def test_the_command_refuses_models_that_will_not_do(
    own: Path, tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    path, words = own / "denoiser.onnx", [str(own / "denoiser.onnx"), "install detangled again"]
    if fault == "missing":
        path.unlink()
    elif fault == "damaged":
        path.write_bytes(path.read_bytes() + b"\0")
    elif fault == "of another version":
        rewrite(own / "denoiser.json", lambda manifest: manifest.update(version=9))
        words = [str(own / "denoiser.json"), "version 9", "install detangled again"]
    else:
        other_network(own)
        words = [str(path), str(own / "training_step.onnx"), "different networks", "export both anew"]
    monkeypatch.setenv(FOLDER_VARIABLE, str(own))
    out = tmp_path / "out.texture"
    assert_refused(command("fit", COILY, out, "--method", FINETUNE), 4, *words)
    assert not out.exists()
    # What needs no network does not ask for one.
    assert command("fit", COILY, out)[0] == 0


# ---- predictions


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


# ---- training


def smooth(count: int, cells: int = 200, hand: float = 1.0, seed: int = 0) -> list[Floats]:
    """Whitened signals, smooth and alike, whose torsion lies well on one side of 0."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 1, cells)
    straight = -WHITENING.mean[1] / WHITENING.deviation[1]
    strands = []
    for _ in range(count):
        waves = [np.sin(2 * np.pi * (6 * t + rng.uniform())) + 0.3 * rng.standard_normal() for _ in range(3)]
        strands.append(np.stack([0.5 + 0.4 * waves[0], straight + hand * (1.5 + 0.3 * waves[1]), t - 0.2 * waves[2]]))
    return strands


def loss_of(weights: NDArray[Any], strands: list[Floats], step: Model) -> float:
    """The mean loss on many fresh batches."""
    losses = []
    for seed in range(200):
        b = draw_windows(strands, step, np.random.default_rng([99, seed]), None)
        error = predicted(weights, b["noisy"], b["log_snr"], b["position"]) - b["clean"]
        losses.append(np.mean(error**2))
    return float(np.mean(losses))


def best_possible(strands: list[Floats], step: Model) -> Floats:
    """The weights (12,) of the least loss, in closed form: the network is linear in them."""
    best = np.empty((3, 4))
    batches = [draw_windows(strands, step, np.random.default_rng([98, seed]), None) for seed in range(200)]
    for channel in range(3):
        unit = np.zeros((4, 3, 4))
        unit[np.arange(4), channel, np.arange(4)] = 1.0
        columns = [
            np.concatenate([predicted(u, b["noisy"], b["log_snr"], b["position"])[:, channel].ravel() for b in batches])
            for u in unit
        ]
        wanted = np.concatenate([b["clean"][:, channel].ravel() for b in batches])
        best[channel] = np.linalg.lstsq(np.stack(columns, axis=1), wanted, rcond=None)[0]
    return best.ravel()


QUICK = FineTuning(most_steps=1000, few_steps=400, learning_rate=3e-3, evaluate_every=20)


@pytest.mark.parametrize("count", [1, 3, 12])
def test_training_comes_near_the_least_loss_there_is(step: Model, count: int) -> None:
    strands = smooth(count)
    tuned = fine_tune(strands, WHITENING, step, WEIGHTS, QUICK)
    assert (tuned.weights.dtype, tuned.weights.shape) == (np.float16, (PARAMETERS,))
    before, after = (loss_of(weights, strands, step) for weights in (WEIGHTS, tuned.weights))
    least = loss_of(best_possible(strands, step), strands, step)
    assert least <= after < least + 0.1 * (before - least)
    assert tuned.curve[-1][1] < 0.7 * tuned.curve[0][1]


def test_steps_are_those_of_adam_with_a_warm_up_and_a_running_mean(step: Model) -> None:
    strands = smooth(2)
    options = FineTuning(few_steps=12, learning_rate=3e-3, warm_up=8)
    weights = WEIGHTS.astype(np.float64)
    mean, first, second = weights.copy(), np.zeros(PARAMETERS), np.zeros(PARAMETERS)
    for k in range(1, 13):
        b = draw_windows(strands, step, np.random.default_rng([0, 0, k]), None)
        error = predicted(weights, b["noisy"], b["log_snr"], b["position"]) - b["clean"]
        # Linear in the weights: what each adds is the prediction of it alone.
        each = [predicted(unit, b["noisy"], b["log_snr"], b["position"]) for unit in np.eye(PARAMETERS)]
        gradient = np.array([2.0 * np.mean(error * part) for part in each])
        first = BETA1 * first + (1.0 - BETA1) * gradient
        second = BETA2 * second + (1.0 - BETA2) * gradient**2
        direction = first / (1.0 - BETA1**k) / (np.sqrt(second / (1.0 - BETA2**k)) + EPSILON)
        weights -= FASTER * 3e-3 * min(1.0, k / 8) * direction
        keep = min(options.average, (1.0 + k) / (10.0 + k))
        mean = keep * mean + (1.0 - keep) * weights
    tuned = fine_tune(strands, WHITENING, step, WEIGHTS, options)
    np.testing.assert_allclose(tuned.weights, mean, rtol=0, atol=5e-4)  # float16 rounds numbers below one by as much


@pytest.mark.parametrize("count", [2, 8])
def test_the_seed_decides_the_weights_and_the_threads_do_not(step: Model, count: int) -> None:
    strands = smooth(count)
    options = replace(QUICK, most_steps=60, few_steps=60)
    first, *others = [fine_tune(strands, WHITENING, step, WEIGHTS, options, threads) for threads in (1, 1, 2, 5)]
    for other in others:
        assert other.weights.tobytes() == first.weights.tobytes()
        np.testing.assert_array_equal(other.curve, first.curve)
    changed = fine_tune(strands, WHITENING, step, WEIGHTS, replace(options, seed=1))
    assert changed.weights.tobytes() != first.weights.tobytes()


def test_it_stops_when_it_no_longer_gains_and_keeps_the_best(step: Model) -> None:
    strands = smooth(12)
    told: list[tuple[int, int, float]] = []
    tuned = fine_tune(strands, WHITENING, step, WEIGHTS, QUICK, progress=lambda *at: told.append(at))
    steps, _, scores = np.array(tuned.curve).T
    best = int(np.flatnonzero(steps == tuned.step)[0])
    assert steps[-1] < QUICK.most_steps
    assert len(scores) == best + 1 + QUICK.patience
    assert np.all(scores[:best] > scores[best])
    assert np.all(scores[best + 1 :] >= scores[best] * (1.0 - QUICK.least_gain))
    # It says each step, of how many at most.
    assert [at[:2] for at in told] == [(k, QUICK.most_steps) for k in range(1, int(steps[-1]) + 1)]
    # The weights are those of the best step, not of the last.
    until = fine_tune(strands, WHITENING, step, WEIGHTS, replace(QUICK, most_steps=tuned.step))
    assert until.weights.tobytes() == tuned.weights.tobytes()


def test_held_out_strands_are_not_learned_from(step: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    # Each strand has a level of its own, which tells it apart.
    strands = [np.full((3, 100), float(k)) for k in range(12)]
    levels: dict[bool, set[float]] = {True: set(), False: set()}
    drawn = finetune.draw_windows

    def watched(shown: list[Floats], *rest: Any) -> dict[str, NDArray[np.float32]]:
        batch = drawn(shown, *rest)
        levels[len(shown) > 2].update(np.unique(batch["clean"]).tolist())
        return batch

    monkeypatch.setattr(finetune, "draw_windows", watched)
    tuned = fine_tune(strands, WHITENING, step, WEIGHTS, replace(QUICK, most_steps=100))
    assert len(levels[False]) == 2
    assert len(levels[True]) == 10
    assert not levels[True] & levels[False]
    assert np.isfinite(tuned.curve).all()


def test_few_strands_are_all_learned_from(step: Model) -> None:
    tuned = fine_tune(smooth(5), WHITENING, step, WEIGHTS, replace(QUICK, few_steps=50))
    assert tuned.step == 50
    assert [at for at, _, _ in tuned.curve] == [20, 40, 50]
    assert np.isnan([score for _, _, score in tuned.curve]).all()


@pytest.mark.parametrize("count", [1, 8])
@pytest.mark.parametrize("rate", [1e7, 1e30])
def test_a_training_that_diverges_is_told_of(step: Model, count: int, rate: float) -> None:
    options = FineTuning(most_steps=60, few_steps=60, learning_rate=rate, evaluate_every=20)
    with pytest.raises(TextureError, match="diverged: try another seed"):
        fine_tune(smooth(count), WHITENING, step, WEIGHTS, options)


def test_nothing_is_learned_from_nothing(step: Model) -> None:
    with pytest.raises(TextureError, match="cells or more"):
        fine_tune([], WHITENING, step, WEIGHTS)


STRAIGHT = -WHITENING.mean[1] / WHITENING.deviation[1]


def flat() -> Floats:
    """The signals of a straight strand, whitened: its torsion is 0."""
    out = np.zeros((3, CELLS))
    out[1] = STRAIGHT
    return out


@pytest.mark.parametrize(
    ("right", "left", "straight", "expected"),
    [
        (4, 0, 0, False),
        (0, 4, 0, False),
        (1, 1, 0, True),
        (9, 1, 0, True),
        (19, 1, 0, False),
        (1, 19, 0, False),
        # A straight strand is of neither hand, and takes nothing from the others.
        (1, 0, 1, False),
        (0, 1, 1, False),
        (0, 0, 3, False),
        (1, 1, 30, True),
    ],
)
def test_both_hands_are_told_from_one(right: int, left: int, straight: int, expected: bool) -> None:
    strands = [*smooth(right), *smooth(left, hand=-1.0), *[flat()] * straight]
    assert curl_both_ways(strands, WHITENING) is expected


@pytest.mark.parametrize("hands", [(1.0,), (-1.0,), (1.0, -1.0)])
def test_strands_are_mirrored_only_where_both_hands_are_shown(
    step: Model, monkeypatch: pytest.MonkeyPatch, hands: tuple[float, ...]
) -> None:
    seen: set[float] = set()
    drawn = finetune.draw_windows

    def watched(*arguments: Any) -> dict[str, NDArray[np.float32]]:
        batch = drawn(*arguments)
        seen.update(np.sign(np.median(batch["clean"][:, 1], axis=1) - STRAIGHT).tolist())
        return batch

    monkeypatch.setattr(finetune, "draw_windows", watched)
    strands = [strand for hand in hands for strand in smooth(8, hand=hand)]
    fine_tune(strands, WHITENING, step, WEIGHTS, replace(QUICK, most_steps=20))
    assert seen == set(hands)


def numbered(cells: int) -> Floats:
    """A strand whose cells say where they are."""
    return np.arange(cells) + 1000.0 * np.arange(3)[:, None]


def test_windows_come_from_everywhere_and_know_their_place(step: Model) -> None:
    cells = CELLS + 5
    places = set()
    for seed in range(60):
        batch = draw_windows([numbered(cells)], step, np.random.default_rng(seed), None)
        for clean, position in zip(batch["clean"], batch["position"], strict=True):
            first = int(clean[0, 0])
            np.testing.assert_array_equal(clean, numbered(cells)[:, first : first + CELLS])
            np.testing.assert_allclose(position, (first + np.arange(CELLS) + 0.5) / cells, rtol=1e-6)
            places.add(first)
    assert places == set(range(6))


def test_strands_no_longer_than_a_window_are_shown_whole(step: Model) -> None:
    batch = draw_windows([numbered(CELLS)], step, np.random.default_rng(0), None)
    for k in range(STEP_BATCH):
        np.testing.assert_array_equal(batch["clean"][k], numbered(CELLS))
        np.testing.assert_allclose(batch["position"][k], (np.arange(CELLS) + 0.5) / CELLS, rtol=1e-6)


def test_strands_shorter_than_a_window_are_refused(step: Model) -> None:
    with pytest.raises(TextureError, match=f"{CELLS} cells or more"):
        fine_tune([numbered(CELLS), numbered(CELLS - 1)], WHITENING, step, np.zeros(1, np.float16))


def test_longer_strands_are_shown_more_often(step: Model) -> None:
    strands = [np.zeros((3, CELLS)), np.ones((3, 3 * CELLS))]
    shown = [draw_windows(strands, step, np.random.default_rng(seed), None)["clean"][:, 0, 0] for seed in range(500)]
    assert abs(float(np.mean(shown)) - 0.75) < 0.04  # four deviations of 2,000 draws


def test_noise_is_as_its_log_snr_says(step: Model) -> None:
    strand = smooth(1)[0]
    noises = []
    for seed in range(50):
        batch = draw_windows([strand], step, np.random.default_rng(seed), None)
        assert {array.dtype for array in batch.values()} == {np.dtype(np.float32)}
        np.testing.assert_array_equal(batch["weight"], np.ones(STEP_BATCH))
        half = batch["log_snr"].astype(np.float64) / 2.0
        # One sample in each quarter of the time of the diffusion.
        assert sorted((STEP_BATCH * step.schedule.time(half)).astype(int)) == list(range(STEP_BATCH))
        alpha, sigma = (1.0 / np.sqrt(1.0 + np.exp(s * 2.0 * half))[:, None, None] for s in (-1.0, 1.0))
        noises.append((batch["noisy"] - alpha * batch["clean"]) / sigma)
    noise = np.concatenate(noises)
    assert abs(noise.mean()) < 0.02
    assert abs(noise.std() - 1.0) < 0.02


def test_mirrored_windows_are_those_of_the_mirrored_strand(step: Model) -> None:
    strand = smooth(1, CELLS)[0]
    either = [strand, WHITENING.mirrored(strand)]
    counts = [0, 0]
    for seed in range(50):
        for clean in draw_windows([strand], step, np.random.default_rng(seed), WHITENING)["clean"]:
            differences = [np.abs(clean - wanted).max() for wanted in either]
            assert min(differences) < FLOAT32
            counts[int(np.argmin(differences))] += 1
    assert min(counts) > 60  # of 200


# ---- .texture files


def test_a_trained_texture_is_saved_and_loaded(texture: FittedTexture, tmp_path: Path) -> None:
    assert (texture.method, texture.architecture) == (FINETUNE, ARCHITECTURE)
    assert texture.weights.tobytes() != WEIGHTS.tobytes()
    save_texture(texture, tmp_path / "one.texture")
    loaded = load_texture(tmp_path / "one.texture")
    for name in ("signals", "starts", "weights"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(texture, name))
    assert loaded.weights.dtype == np.float16
    for name in ("method", "architecture", "whitening", "schedule", "cell_width", "turn", "median_arc", "radius"):
        assert getattr(loaded, name) == getattr(texture, name)
    save_texture(loaded, tmp_path / "two.texture")
    assert (tmp_path / "two.texture").read_bytes() == (tmp_path / "one.texture").read_bytes()
    with np.load(tmp_path / "one.texture", allow_pickle=False) as archive:
        assert not any(archive[name].dtype.hasobject for name in archive.files)


def test_fitting_twice_writes_the_same_bytes(tmp_path: Path, command: Command) -> None:
    written = []
    for name, options in {"a": (), "b": ("--threads", 1), "c": ("--threads", 2), "d": ("--seed", 1)}.items():
        path = tmp_path / f"{name}.texture"
        code, said = command("fit", COILY, path, "--method", FINETUNE, *options)
        assert code == 0, said
        written.append(path.read_bytes())
    assert written[0] == written[1] == written[2] != written[3]


def changed(texture: FittedTexture, path: Path, **arrays: NDArray[Any]) -> Path:
    """A texture's file with other arrays."""
    save_texture(texture, path)
    write_arrays(path, read_arrays(path) | arrays)
    return path


@pytest.mark.parametrize(
    "weights",
    [
        np.where(np.arange(PARAMETERS) == 5, np.nan, WEIGHTS).astype(np.float16),
        np.where(np.arange(PARAMETERS) == 5, np.inf, WEIGHTS).astype(np.float16),
        WEIGHTS.astype(np.float32),
        WEIGHTS.reshape(3, 4),
        WEIGHTS[:0],
    ],
)
def test_damaged_weights_are_refused(
    texture: FittedTexture, few: Path, tmp_path: Path, command: Command, weights: NDArray[Any]
) -> None:
    bad = changed(texture, tmp_path / "bad.texture", weights=weights)
    assert_refused(command("retexture", few, tmp_path / "o.abc", "--target", bad), 4, str(bad), "damaged")
    assert not (tmp_path / "o.abc").exists()


@pytest.mark.parametrize("size", [5.0, 100.0, 60000.0, -60000.0])
def test_senseless_weights_make_no_file(
    texture: FittedTexture, few: Path, tmp_path: Path, command: Command, size: float
) -> None:
    bad = changed(texture, tmp_path / "bad.texture", weights=np.full(PARAMETERS, size, np.float16))
    refused = command("retexture", few, tmp_path / "o.abc", "--target", bad)
    assert_refused(refused, 4, "no finite strands", "fit it again")
    assert not (tmp_path / "o.abc").exists()


def test_weights_do_not_go_with_patches(tmp_path: Path, texture: FittedTexture) -> None:
    plain = fit(read(COILY, unit="cm"))
    assert len(plain.weights) == 0
    bad = changed(plain, tmp_path / "bad.texture", weights=texture.weights)
    with pytest.raises(ModelError, match=r"bad\.texture: .*damaged"):
        load_texture(bad)


def test_a_texture_keeps_its_method(texture: FittedTexture, few: Path, tmp_path: Path, command: Command) -> None:
    save_texture(texture, tmp_path / "finetune.texture")
    save_texture(fit(read(COILY, unit="cm")), tmp_path / "patches.texture")
    out = tmp_path / "o.abc"
    for own, other in (("finetune", "patches"), ("patches", "finetune")):
        words = ("retexture", few, out, "--target", tmp_path / f"{own}.texture", "--method")
        said = (f"{own}.texture", f"fitted by {own}, not {other}", "leave --method out")
        assert_refused(command(*words, other), 4, *said)
        assert not out.exists()
        assert command(*words, own, "--steps", 2)[0] == 0
        out.unlink()


@pytest.mark.parametrize("difference", ["sizes", "weights", "missing"])
def test_a_texture_of_another_network_is_refused(
    texture: FittedTexture, few: Path, tmp_path: Path, command: Command, difference: str, models: Path
) -> None:
    words = ["fitted with another network", str(models / "denoiser.onnx"), "fit it again"]
    if difference == "sizes":
        texture = replace(texture, architecture={"features": 5})
    elif difference == "weights":
        texture = replace(texture, weights=np.tile(texture.weights, 2))
    else:
        os.environ[FOLDER_VARIABLE] = str(tmp_path / "nowhere")
        words = [str(tmp_path / "nowhere" / "denoiser.json"), "install detangled again"]
    save_texture(texture, tmp_path / "other.texture")
    refused = command("retexture", few, tmp_path / "o.abc", "--target", tmp_path / "other.texture")
    assert_refused(refused, 4, *words)
    assert not (tmp_path / "o.abc").exists()


# ---- the whole command


def roots(groom: Groom) -> NDArray[np.float32]:
    return (groom.points / groom.unit_cm).astype(np.float32)[groom.offsets[:-1]]


def test_a_groom_gets_the_texture_of_a_trained_network(few: Path, tmp_path: Path, command: Command) -> None:
    words = ("--target", COILY, "--method", FINETUNE)
    for name, options in {"1": ("--threads", 1), "2": ("--threads", 2), "other": ("--seed", 1)}.items():
        code, said = command("retexture", few, tmp_path / f"{name}.abc", *words, *options)
        assert code == 0, said
        assert "texture of 6 strands" in said
    assert (tmp_path / "1.abc").read_bytes() == (tmp_path / "2.abc").read_bytes()
    old, new, other = read(few), read(tmp_path / "1.abc"), read(tmp_path / "other.abc")
    assert (new.strand_count, new.unit_cm, new.up, new.objects) == (old.strand_count, old.unit_cm, old.up, old.objects)
    np.testing.assert_array_equal(roots(new), roots(old))
    assert new.attributes.keys() == old.attributes.keys() == {"uv", "width", "groom_id", "groom_group_id"}
    for name in ("uv", "groom_id", "groom_group_id"):
        np.testing.assert_array_equal(new.attributes[name].values, old.attributes[name].values)
    assert len(new.attributes["width"].values) == len(new.points)
    guides = style_guides(old)
    for s in range(old.strand_count):
        guide = np.ascontiguousarray(guides.points[old.offsets[s] : old.offsets[s + 1]])
        end = spline_slopes(chord_lengths(guide), guide)[-1]
        beyond = (new.strand(s)[-1] - guide[-1]) @ end / np.linalg.norm(end)
        assert abs(beyond) < LENGTH_ACCURACY * guides.lengths[s]
        # Other hair, not the same hair turned about its axis: distances within a strand differ.
        near, far = (np.linalg.norm(g.strand(s)[8:60] - g.strand(s)[:52], axis=1) for g in (new, other))
        assert np.abs(far / near - 1.0).mean() > 0.05


def test_strands_are_the_networks_and_depend_on_its_weights(
    texture: FittedTexture, few: Path, tmp_path: Path, command: Command
) -> None:
    grooms = []
    for k, one in enumerate([texture, replace(texture, weights=WEIGHTS), fit(read(COILY, unit="cm"))]):
        save_texture(one, tmp_path / f"{k}.texture")
        assert command("retexture", few, tmp_path / f"{k}.npz", "--target", tmp_path / f"{k}.texture")[0] == 0
        grooms.append((tmp_path / f"{k}.npz").read_bytes())
    assert len(set(grooms)) == 3


def straight(length: float = 30.0, points: int = 20, at: float = 0.0) -> Floats:
    """A straight strand [cm]."""
    return np.stack([np.full(points, at), -np.linspace(0, length, points), np.zeros(points)], axis=1)


def coil(radius: float = 0.3, pitch: float = 0.4, turns: int = 20, at: float = 5.0) -> Floats:
    """A helix [cm]."""
    angle = np.linspace(0, 2 * np.pi * turns, 20 * turns + 1)
    return np.stack([at + radius * np.cos(angle), -pitch * angle / (2 * np.pi), radius * np.sin(angle)], axis=1)


TARGETS = {
    "a coil": [coil()],
    "a straight strand": [straight()],
    "two points": [straight(points=2)],
    "two coils": [coil(), coil(0.25, at=8.0)],
    "a straight strand and a coil": [straight(), coil()],
    "a coil, two points and a short hair": [coil(), straight(points=2), straight(0.4, 3, 9.0)],
}


@pytest.mark.parametrize("method", ["patches", "finetune"])
@pytest.mark.parametrize("name", list(TARGETS))
def test_one_two_and_wildly_different_targets(
    few: Path, tmp_path: Path, command: Command, name: str, method: str
) -> None:
    write(Groom.from_strands(TARGETS[name], unit_source="file"), tmp_path / "target.npz")
    words = ("retexture", few, tmp_path / "o.abc", "--target", tmp_path / "target.npz", "--method", method)
    code, said = command(*words)
    assert code == 0, said
    assert f"texture of {len(TARGETS[name])} strand" in said
    assert warnings_in(said) == []
    old, new = read(few), read(tmp_path / "o.abc")
    np.testing.assert_array_equal(roots(new), roots(old))
    assert np.isfinite(new.points).all()
    # No strand flies off.
    reach = np.linalg.norm(new.points[new.offsets[1:] - 1] - new.points[new.offsets[:-1]], axis=1)
    assert np.all(reach < 1.5 * old.polyline_lengths())


NO_TORCH = """
import sys

class Nothing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "onnx"):
            raise ImportError(f"{name} is not for the runtime")

sys.meta_path.insert(0, Nothing())
from detangled_cli.main import detangled

fitted, made = sys.argv[3], sys.argv[4]
words = [["fit", sys.argv[1], fitted, "--method", "finetune"], ["retexture", sys.argv[2], made, "--target", fitted]]
codes = [detangled.main(line, standalone_mode=False) or 0 for line in words]
sys.exit(10 * max(codes) + 5 * ("torch" in sys.modules or "onnx" in sys.modules))
"""


def test_all_of_it_runs_where_torch_cannot_be_imported(
    few: Path, models: Path, tmp_path: Path, texture: FittedTexture
) -> None:
    made = tmp_path / "o.abc"
    done = subprocess.run(
        [sys.executable, "-c", NO_TORCH, str(COILY), str(few), str(tmp_path / "a.texture"), str(made)],
        env={**os.environ, FOLDER_VARIABLE: str(models)},
        capture_output=True,
        text=True,
        timeout=240.0,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal(load_texture(tmp_path / "a.texture").weights, texture.weights)
    np.testing.assert_array_equal(roots(read(made)), roots(read(few)))


def test_the_shipped_network_is_fitted_and_drawn_alike_whatever_the_threads() -> None:
    denoiser, step = load_model(DENOISER, SHIPPED), load_model(TRAINING_STEP, SHIPPED)
    assert same_network(denoiser, step)
    rng = np.random.default_rng(4)
    strands = [rng.standard_normal((3, denoiser.cells + 40)) for _ in range(2)]
    options = FineTuning(few_steps=3)
    one, two = (fine_tune(strands, denoiser.whitening, step, denoiser.weights, options, n) for n in (1, 2))
    assert one.weights.tobytes() == two.weights.tobytes()
    assert one.weights.tobytes() != denoiser.weights.tobytes()
    noisy = rng.standard_normal((9, 3, 2 * denoiser.cells))
    together = NetworkDenoiser(denoiser, one.weights, 2)(noisy, 0.6, 0.8)
    alone = NetworkDenoiser(denoiser, one.weights, 1)(noisy[8:], 0.6, 0.8)
    assert together[8:].tobytes() == alone.tobytes()
