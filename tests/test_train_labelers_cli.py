"""The commands that retrain the labelers, from strands to models that read a groom; all at a tiny setting."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from detangled_cli import main as shell  # noqa: E402
from detangled_training import labeler_export, labeler_training  # noqa: E402
from detangled_training.labeler import LabelerSizes  # noqa: E402
from detangled_training.labeler_training import LabelerOptions  # noqa: E402

COILY = Path(__file__).resolve().parents[1] / "examples" / "coily_strands.obj"
TINY = LabelerSizes(lstm_width=4, encoder_width=8, layers=1, heads=2, feed_forward=8)
WORDS = ("--steps", "3,3,2,2", "--batch", 4)


def run(*words: object) -> Result:
    return CliRunner().invoke(shell.detangled, [str(word) for word in words])


def done(*words: object) -> Result:
    result = run(*words)
    assert result.exit_code == 0, result.stderr
    return result


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    done("train", "data", "--out", folder / "strands", "--count", 40, "--seed", 1, "--workers", 1)
    done("train", "data", "--out", folder / "hung", "--count", 40, "--simulated", "--variants", 1, "--workers", 1)
    return folder


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(labeler_training, "LabelerOptions", functools.partial(LabelerOptions, sizes=TINY, save_every=2))
    monkeypatch.setattr(labeler_export, "BATCH", 4)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 1)


def test_strands_are_made_labelers_trained_and_exported_and_a_groom_is_read(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = ("--data", data / "strands", "--simulated-data", data / "hung")
    done("train", "labelers", tmp_path / "run", *given, *WORDS)
    again = done("train", "labelers", tmp_path / "run", *given, *WORDS)
    assert "going on from step 10" in again.stderr
    done("train", "export", tmp_path / "run" / "labelers.pt", tmp_path / "models")
    manifest = json.loads((tmp_path / "models" / "labeler.json").read_text())
    training = manifest["training"]
    assert (training["steps"], training["steps_done"], training["seed"]) == ([3, 3, 2, 2], 10, 0)
    assert training["data"]["procedural"]["count"] == training["data"]["simulated"]["count"] == 40
    scores = training["scores"]["procedural"]
    assert scores["all"]["count"] == scores["of no type"]["count"] == 1
    monkeypatch.setenv("DETANGLED_MODELS", str(tmp_path / "models"))
    facts = json.loads(done("label", COILY, "--json").stdout)
    assert facts["readings"]["read"] == facts["strands"]


def test_a_training_is_not_gone_on_with_by_other_options(data: Path, tmp_path: Path) -> None:
    given = ("--data", data / "strands", "--simulated-data", data / "hung")
    done("train", "labelers", tmp_path / "run", *given, *WORDS)
    result = run("train", "labelers", tmp_path / "run", *given, "--steps", "3,3,2,3", "--batch", 4)
    assert result.exit_code == 4
    assert "begun with another steps" in result.stderr


@pytest.mark.parametrize("steps", ["3", "3,3,3", "3,3,3,0", "a,b,c,d"])
def test_steps_are_of_four_stages(data: Path, tmp_path: Path, steps: str) -> None:
    given = ("--data", data / "strands", "--simulated-data", data / "hung")
    result = run("train", "labelers", tmp_path / "run", *given, "--steps", steps)
    assert result.exit_code == 2
    assert "four numbers of steps" in result.stderr


def test_data_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    given = ("--data", tmp_path / "none", "--simulated-data", tmp_path / "none")
    result = run("train", "labelers", tmp_path / "run", *given, *WORDS)
    assert result.exit_code == 3
    assert str(tmp_path / "none") in result.stderr
    assert "Traceback" not in result.stderr
