"""Fixtures shared by the tests."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

GROOMS = Path(os.environ.get("DETANGLED_GROOMS", Path(__file__).resolve().parents[2] / "shared" / "grooms"))


@pytest.fixture(scope="session")
def grooms() -> Callable[[str], Path]:
    """The path of a real groom by its file name; the test is skipped where it is not at hand."""

    def find(name: str) -> Path:
        path = GROOMS / name
        if not path.is_file():
            pytest.skip(f"needs {name} of the sample grooms: set DETANGLED_GROOMS to their folder")
        return path

    return find


@pytest.fixture(scope="module")
def one_torch_thread() -> Iterator[None]:
    """On a busy machine several wait for each other, hundreds of times longer than they work on what is tiny."""
    torch = pytest.importorskip("torch")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
