"""The wheel as people get it: in an environment of its own without torch, used from another folder."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from detangled import __version__
from detangled.formats import read

PROJECT = Path(__file__).resolve().parents[1]
INPUTS = ("bob.abc", "coily_strands.obj")
# What pip says where it reaches no index; anything else is a failure of ours.
NO_NETWORK = (
    "Failed to establish a new connection",
    "Temporary failure in name resolution",
    "Name or service not known",
    "getaddrinfo failed",
    "Network is unreachable",
    "ConnectTimeoutError",
    "ReadTimeoutError",
    "NewConnectionError",
    "NameResolutionError",
    "ProxyError",
)

Run = subprocess.CompletedProcess[str]


def run(*command: object, cwd: Path, **environment: str) -> Run:
    # What helps this environment find modules must not help the other.
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    return subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env=inherited | environment,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    pip = (sys.executable, "-m", "pip", "wheel", PROJECT, "--no-deps", "--no-build-isolation", "--wheel-dir", folder)
    built = run(*pip, cwd=folder)
    assert built.returncode == 0, built.stderr
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def programs(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of programs of a new environment into which the wheel is installed, with what it asks for."""
    folder = tmp_path_factory.mktemp("environment")
    made = run(sys.executable, "-m", "venv", folder / "venv", cwd=folder)
    assert made.returncode == 0, made.stderr
    there = folder / "venv" / ("Scripts" if sys.platform == "win32" else "bin")
    installed = run(there / "python", "-m", "pip", "install", "--quiet", wheel, cwd=folder, PIP_RETRIES="1")
    if installed.returncode != 0 and any(sign in installed.stderr for sign in NO_NETWORK):
        pytest.skip("pip reaches no package index from here")
    assert installed.returncode == 0, installed.stderr
    return there


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A cache of its own: numba would not use what was compiled for other paths, and nothing should stay behind."""
    return str(tmp_path_factory.mktemp("cache"))


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    for name in INPUTS:
        shutil.copy(PROJECT / "examples" / name, tmp_path)
    return tmp_path


def test_torch_is_not_there_and_not_missed(programs: Path, elsewhere: Path) -> None:
    said = run(programs / "detangled", "--version", cwd=elsewhere)
    assert (said.returncode, said.stdout) == (0, f"detangled {__version__}\n"), said.stderr
    loaded = run(
        programs / "python",
        "-c",
        "import detangled, importlib.util, sys; assert 'torch' not in sys.modules; "
        "assert importlib.util.find_spec('torch') is None; "
        "[getattr(detangled, name) for name in detangled.__all__]; print(detangled.__file__)",
        cwd=elsewhere,
    )
    assert loaded.returncode == 0, loaded.stderr
    # The one that was installed, not the one in this folder.
    assert Path(loaded.stdout.strip()).is_relative_to(programs.parent)


def test_it_does_the_main_job(programs: Path, elsewhere: Path, cache: str) -> None:
    bob, coily = INPUTS
    words = ("retexture", bob, "out.abc", "--target", coily, "--steps", 6)
    done = run(programs / "detangled", *words, cwd=elsewhere, NUMBA_CACHE_DIR=cache)
    assert done.returncode == 0, done.stderr
    assert "compiling kernels" in done.stderr
    old, new = (read(elsewhere / name, unit="m") for name in (bob, "out.abc"))
    assert new.strand_count == old.strand_count == 252
    np.testing.assert_array_equal(new.points[new.offsets[:-1]], old.points[old.offsets[:-1]])
    np.testing.assert_array_equal(new.attributes["groom_id"].values, old.attributes["groom_id"].values)
    assert np.isfinite(new.points).all()
    assert np.median(new.polyline_lengths() / old.polyline_lengths()) > 1.5


def test_the_network_learns_and_draws_without_torch(programs: Path, elsewhere: Path, cache: str) -> None:
    _, coily = INPUTS
    detangled = programs / "detangled"
    words = ("fit", coily, "coily.texture", "--method", "finetune", "--training-steps", 3)
    fitted = run(detangled, *words, cwd=elsewhere, NUMBA_CACHE_DIR=cache)
    assert fitted.returncode == 0, fitted.stderr
    words = ("retexture", coily, "out.obj", "--target", "coily.texture", "--steps", 4)
    done = run(detangled, *words, cwd=elsewhere, NUMBA_CACHE_DIR=cache)
    assert done.returncode == 0, done.stderr
    old, new = (read(elsewhere / name, unit="cm") for name in (coily, "out.obj"))
    assert new.strand_count == old.strand_count
    assert np.isfinite(new.points).all()


def test_strands_are_read_without_torch(programs: Path, elsewhere: Path, cache: str) -> None:
    _, coily = INPUTS
    done = run(programs / "detangled", "label", coily, "--json", cwd=elsewhere, NUMBA_CACHE_DIR=cache)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["readings"]["read"] == facts["strands"]
    assert 0.3 < facts["radius_cm"]["median"] < 0.8
