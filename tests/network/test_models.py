"""Models and their manifests: whole ones are taken, any others refused in one sentence."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the tiny models are written by onnx")

from commands import COILY, FIELDS_OF, FILES, Command, assert_refused
from tiny_models import (
    ARCHITECTURE,
    CELLS,
    PARAMETERS,
    WEIGHTS,
    WHITENING,
    export_tiny,
)
from tiny_models import BATCH as STEP_BATCH

from detangled.diffusion.schedule import CosineSchedule
from detangled.errors import ModelError
from detangled.fitted import FINETUNE
from detangled.models import (
    DENOISER,
    FOLDER_VARIABLE,
    TRAINING_STEP,
    Model,
    load_model,
    same_network,
)


def rewrite(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change a manifest in place."""
    manifest = json.loads(path.read_text(encoding="utf-8"))
    change(manifest)
    path.write_text(json.dumps(manifest), encoding="utf-8")


def test_whole_models_are_accepted(denoiser: Model, step: Model) -> None:
    np.testing.assert_array_equal(denoiser.weights, WEIGHTS)
    assert denoiser.weights.dtype == np.float16
    assert (denoiser.kind, step.kind, step.batch) == (DENOISER, TRAINING_STEP, STEP_BATCH)
    for model in (denoiser, step):
        assert (model.parameters, model.cells, model.architecture) == (PARAMETERS, CELLS, ARCHITECTURE)
        assert (model.whitening, model.schedule) == (WHITENING, CosineSchedule())
    assert same_network(denoiser, step)


def test_a_model_that_was_written_but_for_its_manifest_is_refused(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    onnx_files = pytest.importorskip("detangled_training.onnx_files", reason="models are written by the training")
    path = own / f"{FILES[DENOISER]}.onnx"
    manifest = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    data = path.read_bytes()
    put = os.replace

    def stopped(made: Path, place: Path) -> None:
        if place.suffix == ".json":
            raise KeyboardInterrupt
        put(made, place)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", stopped)
        with pytest.raises(KeyboardInterrupt):
            onnx_files.write_model(path, data + b"more", manifest, lambda _: 0.0)
    with pytest.raises(
        ModelError, match=r"denoiser\.onnx: its bytes are not those its manifest was written for: .*export"
    ):
        load_model(DENOISER, own)
    onnx_files.write_model(path, data, manifest, lambda _: 0.0)
    assert load_model(DENOISER, own).data == data


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
        (DENOISER, {"conditions": ["log radius"]}),
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
