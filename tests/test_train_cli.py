"""detangled train: a training stopped and gone on with, what it refuses, and the models it ends in; all are tiny."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from detangled.errors import ModelError  # noqa: E402
from detangled.models import DENOISER, TRAINING_STEP, load_model  # noqa: E402
from detangled_cli import main as shell  # noqa: E402
from detangled_training import denoiser_training  # noqa: E402
from detangled_training.checkpoint import Checkpoint, read_checkpoint, write_checkpoint  # noqa: E402
from detangled_training.dataset import TRAIN, read_dataset, write_dataset  # noqa: E402
from detangled_training.denoiser_training import Training, TrainingOptions  # noqa: E402
from detangled_training.parameters import flatten  # noqa: E402
from detangled_training.unet import Architecture  # noqa: E402
from detangled_training.variants import VariantOptions  # noqa: E402
from tiny_training import SAVE_EVERY, STEPS, TINY, tiny_options, write_strands  # noqa: E402


@pytest.fixture(scope="module", autouse=True)
def tiny() -> Iterator[None]:
    """All trainings here are tiny unless told otherwise, those of the command line too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(denoiser_training, "TrainingOptions", tiny_options)
        patch.setattr(denoiser_training, "HELD_OUT", 8)
        threads = torch.get_num_threads()
        # On a busy machine several wait for each other, hundreds of times longer than they work.
        torch.set_num_threads(1)
        yield
        torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def strands(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_strands(tmp_path_factory.mktemp("strands"))


@pytest.fixture(scope="module")
def denoiser(strands: Path) -> Callable[..., Result]:
    """The command that trains on these."""
    return lambda folder, *words: train("denoiser", folder, "--data", strands, *words)


@pytest.fixture(scope="module")
def trained(denoiser: Callable[..., Result], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """A training that was not stopped: its checkpoint, and what the command said."""
    folder: Path = tmp_path_factory.mktemp("trained") / "new"
    return folder / "checkpoint.pt", denoiser(folder)


@pytest.fixture(scope="module")
def models(trained: tuple[Path, Result], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """The folder of that training's models, and what the command said."""
    folder: Path = tmp_path_factory.mktemp("models") / "new"
    return folder, train("export", trained[0], folder)


def train(*arguments: object) -> Result:
    return CliRunner().invoke(shell.detangled, ["train", *(str(argument) for argument in arguments)])


def error_line(result: Result) -> str:
    (line,) = result.stderr.splitlines()
    assert result.stdout == ""
    assert line.startswith("detangled: error: ")
    return line


def stop_after(monkeypatch: pytest.MonkeyPatch, steps: int) -> None:
    """Have Ctrl-C pressed in the midst of the next step."""
    real = Training._train

    def step(self: Training, batch: Any) -> float:
        if self.step == steps:
            raise KeyboardInterrupt
        return real(self, batch)

    monkeypatch.setattr(Training, "_train", step)


def assert_same_training(found: Checkpoint, wanted: Checkpoint) -> None:
    assert found.state is not None
    assert wanted.state is not None
    assert torch.equal(found.weights, wanted.weights)
    assert torch.equal(found.state.current, wanted.state.current)
    for key, moments in wanted.state.optimizer["state"].items():
        for name, value in moments.items():
            assert torch.equal(found.state.optimizer["state"][key][name], value), name
    assert (found.whitening, found.state.step) == (wanted.whitening, wanted.state.step)


# ---- help, and what is missing


def test_help_needs_no_torch() -> None:
    program = """
import sys
sys.modules.update(dict.fromkeys(("torch", "onnx", "numpy", "numba", "onnxruntime")))
from detangled_cli.main import detangled
for words in ([], ["denoiser"], ["export"]):
    detangled.main(["train", *words, "--help"], prog_name="detangled", standalone_mode=False)
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert (run.returncode, run.stderr) == (0, "")
    for name in ("", "denoiser ", "export "):
        assert f"\nUsage: detangled train {name}" in "\n" + run.stdout
    assert run.stdout.count("Example:\n") == 3
    assert "--nproc-per-node" in run.stdout


def test_help_tells_the_defaults() -> None:
    said = " ".join(train("denoiser", "--help").stdout.split())
    for name in ("steps", "batch", "learning_rate", "seed"):
        stated = re.search(rf"--{name.replace('_', '-')} \w [^-]*Default: ([\d.]+\d|\d)", said)
        assert stated, name
        assert float(stated[1]) == getattr(TrainingOptions(), name)


@pytest.mark.parametrize("missing", ["torch", "onnx"])
@pytest.mark.parametrize("words", [("denoiser", "out", "--data", "in"), ("export", "checkpoint.pt", "out")])
def test_without_the_extra_one_line_says_how_to_get_it(
    words: tuple[str, ...], missing: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, missing, None)
    result = train(*words)
    assert result.exit_code == 2
    assert error_line(result).endswith("training needs torch and onnx: pip install 'detangled[train]'")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "words",
    [(), ("denoisre",), ("denoiser",), ("denoiser", "out"), ("denoiser", "out", "--data", "in", "--batch", "0")],
)
def test_wrong_usage(words: tuple[str, ...]) -> None:
    result = train(*words)
    assert (result.exit_code, result.stdout) == (2, "")


# ---- training


def test_a_training_notes_and_records_its_evaluations(trained: tuple[Path, Result]) -> None:
    path, result = trained
    assert (result.exit_code, result.stdout) == (0, "")
    noted = [line for line in result.stderr.splitlines() if line.startswith("step ")]
    assert [line.split(":")[0] for line in noted] == ["step 3", "step 6"]
    checkpoint = read_checkpoint(path)
    assert checkpoint.state is not None
    assert [step for step, _, _ in checkpoint.state.history] == [3, 6]
    assert all(
        np.isfinite(score) and f"{score:.4f}" in noted[k] for k, (*_, score) in enumerate(checkpoint.state.history)
    )
    assert (checkpoint.architecture, checkpoint.cells, checkpoint.state.step) == (TINY, 16, STEPS)
    assert checkpoint.training["steps_done"] == STEPS
    assert {file.name for file in path.parent.iterdir()} == {"checkpoint.pt"}


def test_weights_are_the_mean_of_what_was_trained(trained: tuple[Path, Result], tmp_path: Path, strands: Path) -> None:
    checkpoint = read_checkpoint(trained[0])
    assert checkpoint.state is not None
    start = flatten(Training(tiny_options(), tmp_path, [strands]).network)
    moved, averaged = checkpoint.state.current - start, checkpoint.weights - start
    assert float(moved.norm()) > 0.0
    assert 0.2 < float(averaged.norm() / moved.norm()) < 1.0


@pytest.mark.parametrize("done", [3, 4])
def test_a_training_that_was_stopped_goes_on_bit_for_bit(
    done: int,
    trained: tuple[Path, Result],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    denoiser: Callable[..., Result],
) -> None:
    with monkeypatch.context() as patch:
        stop_after(patch, done)
        stopped = denoiser(tmp_path)
    assert stopped.exit_code == 130
    assert "--resume" in stopped.stderr.splitlines()[-1]
    saved = read_checkpoint(tmp_path / "checkpoint.pt")
    assert saved.state is not None
    assert saved.state.step == done // SAVE_EVERY * SAVE_EVERY

    result = denoiser(tmp_path, "--resume")
    assert result.exit_code == 0, result.stderr
    assert f"going on from step {saved.state.step}" in result.stderr
    assert_same_training(read_checkpoint(tmp_path / "checkpoint.pt"), read_checkpoint(trained[0]))


def test_stopped_before_anything_was_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, denoiser: Callable[..., Result]
) -> None:
    stop_after(monkeypatch, 1)
    result = denoiser(tmp_path, "--quiet")
    assert (result.exit_code, result.stderr.strip()) == (130, "detangled: interrupted; nothing was written")


def test_a_training_at_its_end_is_left_alone(trained: tuple[Path, Result], denoiser: Callable[..., Result]) -> None:
    before = trained[0].read_bytes()
    result = denoiser(trained[0].parent, "--resume")
    assert result.exit_code == 0
    assert "last step already" in result.stderr
    assert trained[0].read_bytes() == before


def test_options_are_passed_on_and_nothing_to_resume_is_a_new_training(
    tmp_path: Path, denoiser: Callable[..., Result]
) -> None:
    given = {"steps": 2, "batch": 2, "learning_rate": 0.001, "seed": 3}
    words = [word for name, value in given.items() for word in (f"--{name.replace('_', '-')}", value)]
    result = denoiser(tmp_path, "--resume", "--threads", torch.get_num_threads(), *words)
    assert result.exit_code == 0, result.stderr
    assert "a new training" in result.stderr
    state = read_checkpoint(tmp_path / "checkpoint.pt").state
    assert state is not None
    assert {name: state.options[name] for name in given} == given


def test_a_training_is_not_written_over(trained: tuple[Path, Result], denoiser: Callable[..., Result]) -> None:
    before = trained[0].read_bytes()
    result = denoiser(trained[0].parent)
    assert result.exit_code == 5
    assert "--resume" in error_line(result)
    assert trained[0].read_bytes() == before


@pytest.mark.parametrize(("option", "value"), [("seed", 1), ("steps", 7), ("learning-rate", 0.1)])
def test_another_option_than_it_was_begun_with_is_named(
    option: str, value: float, trained: tuple[Path, Result], denoiser: Callable[..., Result]
) -> None:
    result = denoiser(trained[0].parent, "--resume", f"--{option}", value)
    assert result.exit_code == 4
    assert f"begun with another {option.replace('-', ' ')}:" in error_line(result)


def test_a_folder_that_cannot_be_one(tmp_path: Path, denoiser: Callable[..., Result]) -> None:
    (tmp_path / "file").write_text("")
    result = denoiser(tmp_path / "file")
    assert result.exit_code == 5
    assert "cannot be made a folder" in error_line(result)


# ---- several processes


def test_a_batch_that_cannot_be_shared_evenly_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, denoiser: Callable[..., Result]
) -> None:
    monkeypatch.setenv("WORLD_SIZE", "3")
    result = denoiser(tmp_path)
    assert result.exit_code == 3
    assert "4 cannot be shared by 3 processes" in error_line(result)


def test_only_the_first_process_speaks_and_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, denoiser: Callable[..., Result]
) -> None:
    monkeypatch.setenv("RANK", "1")
    monkeypatch.setattr(Training, "_train", lambda *_: 0.0)
    result = denoiser(tmp_path)
    assert (result.exit_code, result.output) == (0, "")
    assert not list(tmp_path.iterdir())


# ---- checkpoints


def spoil(path: Path, how: str) -> None:
    data = path.read_bytes()
    stored = torch.load(path, weights_only=True)
    if how == "missing":
        path.unlink()
    elif how == "a folder":
        path.unlink()
        path.mkdir()
    elif how in ("empty", "cut", "text"):
        path.write_bytes({"empty": b"", "cut": data[: len(data) // 2], "text": b"weights: none\n"}[how])
    elif how == "another object":
        torch.save([1, 2, 3], path)
    elif how == "unsafe":
        torch.save({"weights": Path("x")}, path)
    else:
        {
            "without whitening": lambda: stored.pop("whitening"),
            "other weights": lambda: stored.update(weights=torch.zeros(3)),
            "weights of a list": lambda: stored.update(weights=[1.0]),
            "other sizes": lambda: stored["architecture"].update(groups=7),
            "other state": lambda: stored["state"].pop("step"),
            "odd cells": lambda: stored.update(cells=17),
        }[how]()
        torch.save(stored, path)


SPOILED = {
    "missing": "No such file",
    "a folder": "cannot be read",
    "empty": "damaged",
    "cut": "damaged",
    "text": "damaged",
    "another object": "lacks architecture",
    "unsafe": "damaged",
    "without whitening": "lacks whitening",
    "other weights": "weights of shape",
    "weights of a list": "damaged",
    "other sizes": "groups",
    "other state": "step",
    "odd cells": "17 cells",
}


@pytest.mark.parametrize("how", SPOILED)
def test_a_spoiled_checkpoint_is_one_line(
    how: str, trained: tuple[Path, Result], tmp_path: Path, strands: Path
) -> None:
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(trained[0].read_bytes())
    spoil(path, how)
    with pytest.raises(ModelError, match=re.escape(str(path))):
        read_checkpoint(path)
    commands = [("export", path, tmp_path / "models")]
    if how != "missing":
        commands.append(("denoiser", tmp_path, "--data", strands, "--resume"))
    for words in commands:
        result = train(*words)
        assert result.exit_code == 4
        assert SPOILED[how] in error_line(result)
    assert not (tmp_path / "models").exists()


def test_a_checkpoint_without_a_training_cannot_be_gone_on_with(
    trained: tuple[Path, Result], tmp_path: Path, denoiser: Callable[..., Result]
) -> None:
    whole = read_checkpoint(trained[0])
    bare = Checkpoint(whole.architecture, whole.weights, whole.whitening, whole.schedule, whole.cells, whole.training)
    write_checkpoint(bare, tmp_path / "checkpoint.pt")
    assert torch.equal(read_checkpoint(tmp_path / "checkpoint.pt").weights, whole.weights)
    result = denoiser(tmp_path, "--resume")
    assert result.exit_code == 4
    assert "no training to go on with" in error_line(result)


# ---- export


def test_exported_models_are_those_the_runtime_takes(trained: tuple[Path, Result], models: tuple[Path, Result]) -> None:
    checkpoint = read_checkpoint(trained[0])
    folder, _ = models
    denoiser, step = load_model(DENOISER, folder), load_model(TRAINING_STEP, folder)
    np.testing.assert_array_equal(denoiser.weights, checkpoint.weights.half().numpy())
    assert (denoiser.whitening, denoiser.schedule) == (checkpoint.whitening, checkpoint.schedule)
    assert (denoiser.cells, step.cells, step.batch) == (16, 16, 8)
    assert denoiser.training["steps_done"] == STEPS
    assert len(denoiser.training["history"]) == 2


def test_export_notes_files_sizes_and_differences(models: tuple[Path, Result]) -> None:
    folder, result = models
    assert (result.exit_code, result.stdout) == (0, "")
    names = {path.name for path in folder.iterdir()}
    assert names == {"denoiser.onnx", "denoiser.json", "training_step.onnx", "training_step.json"}
    lines = result.stderr.splitlines()[1:]
    assert {Path(line.split(":")[0]).name for line in lines} == names
    assert all(re.search(r": [\d.]+ [kM]B", line) for line in lines)
    differences = [float(line.split("differ by ")[1].split()[0]) for line in lines if "differ" in line]
    assert len(differences) == 2
    assert all(0.0 <= difference <= 1e-5 for difference in differences)


def test_export_into_what_is_no_folder(trained: tuple[Path, Result]) -> None:
    result = train("export", trained[0], trained[0], "--quiet")
    assert result.exit_code == 5
    assert "cannot be made a folder" in error_line(result)


# ---- data, and what a training begins with


def test_a_manifest_tells_the_data(trained: tuple[Path, Result], strands: Path) -> None:
    (told,) = read_checkpoint(trained[0]).training["data"]
    assert told == read_dataset(strands, TRAIN).origin


def test_other_strands_than_it_was_begun_with_are_refused(trained: tuple[Path, Result], tmp_path: Path) -> None:
    write_dataset(tmp_path / "others", 42, 1, VariantOptions(cells=16, read_share=0.0), workers=1)
    (tmp_path / "run").mkdir()
    stored = torch.load(trained[0], weights_only=True)
    stored["state"]["step"] = 4
    torch.save(stored, tmp_path / "run" / "checkpoint.pt")
    result = train("denoiser", tmp_path / "run", "--data", tmp_path / "others", "--resume")
    assert result.exit_code == 4
    assert "begun with other strands" in result.stderr.splitlines()[-1]


def test_data_that_is_not_there_is_told(tmp_path: Path) -> None:
    result = train("denoiser", tmp_path / "run", "--data", tmp_path / "nothing")
    assert result.exit_code == 3
    assert "holds no data set" in error_line(result)


def test_a_training_begins_with_an_exported_model(
    denoiser: Callable[..., Result], models: tuple[Path, Result], strands: Path, tmp_path: Path
) -> None:
    begun = Training(tiny_options(), tmp_path, [strands], models[0])
    np.testing.assert_array_equal(flatten(begun.network).half().numpy(), load_model(DENOISER, models[0]).weights)
    result = denoiser(tmp_path, "--start", models[0])
    assert result.exit_code == 0, result.stderr
    checkpoint = read_checkpoint(tmp_path / "checkpoint.pt")
    assert checkpoint.whitening == load_model(DENOISER, models[0]).whitening
    assert checkpoint.training["start"]["training"]["steps_done"] == STEPS
    assert len(checkpoint.training["start"]["sha256"]) == 64
    again = denoiser(tmp_path, "--start", models[0], "--resume")
    assert again.exit_code == 0, again.stderr


def test_a_training_goes_on_only_with_the_model_it_was_begun_with(
    denoiser: Callable[..., Result], trained: tuple[Path, Result], models: tuple[Path, Result]
) -> None:
    result = denoiser(trained[0].parent, "--start", models[0], "--resume")
    assert result.exit_code == 4
    assert "not begun with" in error_line(result)


def test_a_start_that_is_no_model_leaves_no_folder(denoiser: Callable[..., Result], tmp_path: Path) -> None:
    result = denoiser(tmp_path / "run", "--start", tmp_path)
    assert result.exit_code == 4
    assert not (tmp_path / "run").exists()


def test_a_model_of_other_sizes_is_no_start(models: tuple[Path, Result], strands: Path, tmp_path: Path) -> None:
    larger = Architecture(channels=(16, 16), attention=1, embedding=16, groups=4, heads=2)
    with pytest.raises(ModelError, match="a network of other sizes"):
        Training(tiny_options(architecture=larger), tmp_path, [strands], models[0])
