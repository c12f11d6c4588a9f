"""Fixtures shared by the tests."""

from __future__ import annotations

import os
from collections.abc import Callable
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
