"""The tiny models in place of the real ones, and what tests do with them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from commands import BOB_STRANDS, COILY, EXAMPLES, Command, Result

from detangled.fitted import FINETUNE, FittedTexture
from detangled.fitting import fit
from detangled.formats import read, write
from detangled.kernels import set_threads, thread_count
from detangled.models import (
    DENOISER,
    FOLDER_VARIABLE,
    TRAINING_STEP,
    Model,
    load_model,
)
from detangled_cli.main import detangled


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _tiny(tmp_path_factory.mktemp("models"))


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """Models of a test's own, to spoil."""
    return _tiny(tmp_path / "own")


def _tiny(folder: Path) -> Path:
    pytest.importorskip("onnx", reason="the tiny models are written by onnx")
    from tiny_models import export_tiny

    return export_tiny(folder)


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
