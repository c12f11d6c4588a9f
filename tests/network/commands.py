"""Commands run by tests of the network: what they are given, and what is asked of what they say."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from detangled.models import (
    DENOISER,
    TRAINING_STEP,
)

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SHIPPED = Path(__file__).resolve().parents[2] / "exported_models" / "detangled_models"
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
