"""detangled train data: what it says, refuses and leaves behind; variants are faked."""

from __future__ import annotations

import functools
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
from click.testing import CliRunner, Result

from detangled_cli import main as shell
from detangled_training import dataset
from detangled_training.dataset import (
    MANIFEST,
    read_dataset,
    read_manifest,
    write_dataset,
)
from faked_data import COUNT, SEED, make, stopping, write


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A data set made in one go."""
    write(tmp_path / "set")
    return tmp_path / "set"


@pytest.fixture
def faked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dataset, "write_dataset", functools.partial(write_dataset, make=make))


def data(*arguments: object) -> Result:
    return CliRunner().invoke(shell.detangled, ["train", "data", *(str(argument) for argument in arguments)])


def error_line(result: Result) -> str:
    (line,) = result.stderr.splitlines()
    assert result.stdout == ""
    assert line.startswith("detangled: ")
    return line


@pytest.mark.usefixtures("faked")
def test_the_command_writes_what_it_was_asked_for(tmp_path: Path) -> None:
    result = data("--out", tmp_path, "--count", 30, "--simulated", "--variants", 3, "--seed", 5, "--workers", 1)
    assert (result.exit_code, result.stdout) == (0, "")
    manifest = read_manifest(tmp_path)
    assert (manifest.count, manifest.seed, manifest.options["hung"], manifest.finished) == (30, 5, 3, True)
    assert re.search(
        rf"{re.escape(str(tmp_path))}: 30 strands, {manifest.signals} signals, [\d.]+ [kM]B", result.stderr
    )

    again = data("--out", tmp_path, "--count", 30, "--simulated", "--variants", 3, "--seed", 5)
    assert again.exit_code == 0
    assert "finished already" in again.stderr


@pytest.mark.usefixtures("faked")
@pytest.mark.parametrize(("words", "hung"), [((), 0), (("--simulated",), 2)])
def test_strands_are_simulated_where_that_is_asked(words: tuple[str, ...], hung: int, tmp_path: Path) -> None:
    assert data("--out", tmp_path, "--count", 3, "--quiet", *words).output == ""
    assert (read_manifest(tmp_path).options["hung"], read_manifest(tmp_path).seed) == (hung, 0)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--count", 3), "--out"),
        (("--out", "set"), "--count"),
        (("--out", "set", "--count", 0), "--count"),
        (("--out", "set", "--count", 3, "--seed", -1), "--seed"),
        (("--out", "set", "--count", 3, "--workers", 0), "--workers"),
        (("--out", "set", "--count", 3, "--variants", 3), "--simulated"),
        (("--out", "set", "--count", 3, "more"), "more"),
    ],
)
def test_wrong_usage(words: tuple[object, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = data(*words)
    assert (result.exit_code, result.stdout) == (2, "")
    assert said in error_line(result)
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("faked")
def test_a_folder_that_cannot_be_one(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "set"):
        result = data("--out", folder, "--count", 3)
        assert result.exit_code == 5
        assert "cannot be made a folder" in error_line(result)


@pytest.mark.usefixtures("faked")
def test_a_folder_that_cannot_be_written_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Nothing is protected from root, who may run this.
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK or Path(path) != tmp_path)
    result = data("--out", tmp_path, "--count", 3)
    assert result.exit_code == 5
    assert "cannot be written to" in error_line(result)


@pytest.mark.usefixtures("faked")
def test_another_data_set_is_refused_by_the_command(copy: Path) -> None:
    result = data("--out", copy, "--count", COUNT, "--seed", SEED)
    assert result.exit_code == 5
    assert "holds another data set (hung 2, not 0, cells 4, not 256, untyped 0.0, not 0.2)" in error_line(result)


def test_the_command_that_is_stopped_says_how_to_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ("--out", tmp_path, "--count", COUNT, "--workers", 1)
    stopped_write = functools.partial(write_dataset, make=stopping(1, KeyboardInterrupt()))
    monkeypatch.setattr(dataset, "write_dataset", stopped_write)
    result = data(*words)
    assert result.exit_code == 130
    assert "1 of 3 shards" in error_line(result)
    assert "the same command" in error_line(result)
    monkeypatch.setattr(dataset, "write_dataset", functools.partial(write_dataset, make=make))
    assert data(*words).exit_code == 0
    assert read_dataset(tmp_path).signals.shape == (COUNT, 256, 3)


STOPPED = """
import functools, sys
sys.path.insert(0, sys.argv.pop(1))
import faked_data
from detangled_cli.main import main
from detangled_training import dataset
dataset.write_dataset = functools.partial(dataset.write_dataset, make=faked_data.make_slowly)
if __name__ == "__main__":
    main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="a group of processes is interrupted as a terminal does it")
@pytest.mark.parametrize("how", ["interrupted", "killed"])
def test_no_process_outlives_the_command(how: str, tmp_path: Path) -> None:
    program, out = tmp_path / "program.py", tmp_path / "set"
    program.write_text(STOPPED)
    words = [program, Path(__file__).parent, "train", "data", "--out", out, "--count", COUNT, "--workers", 2]
    command = [sys.executable, *(str(word) for word in words)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as run:
        assert run.stderr is not None
        try:
            wait_for(lambda: (out / MANIFEST).exists() and len(read_manifest(out).shards) == 1)
            if how == "interrupted":
                os.killpg(run.pid, signal.SIGINT)
                assert run.wait(20.0) == 130
                said = run.stderr.read()
                assert "1 of 3 shards are whole" in said.splitlines()[-1]
                assert "Traceback" not in said
            else:
                run.kill()
                run.wait(20.0)
            wait_for(lambda: not alive(run.pid))
        finally:
            for process in alive(run.pid):
                process.kill()
    assert list(read_manifest(out).shards) == ["shard-00000.npz"]


def wait_for(happened: Callable[[], bool], seconds: float = 30.0) -> None:
    until = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < until
        time.sleep(0.02)


def alive(group: int) -> list[psutil.Process]:
    """The processes of a group that are not over."""
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.NoSuchProcess, ProcessLookupError):
            if os.getpgid(process.pid) == group and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found
