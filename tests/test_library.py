"""Making the library: strands that wind as their numbers say, whole, on their axes, and the same for the same seed."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

from detangled.errors import TextureError
from detangled.geometry.arc import arc_lengths
from detangled.geometry.winding import winding
from detangled.library import load_library
from detangled.texture import arc_of_a_turn
from detangled_cli.main import detangled as command
from detangled_training import library
from detangled_training.library import TURNS, make_library

COUNT = 40


@pytest.fixture(scope="module")
def made() -> dict[str, NDArray]:
    return make_library(COUNT, 3)


def test_strands_are_whole_in_canonical_space(made: dict[str, NDArray]) -> None:
    points, offsets = made["points"].astype(np.float64), made["offsets"]
    assert 0.7 * COUNT <= len(offsets) - 1 <= COUNT
    assert np.isfinite(points).all()
    turns = arc_lengths(points, offsets) / arc_of_a_turn(made["radius"], made["wavelength"])
    # A hung coil is steeper and narrower, so has a few more or fewer turns.
    assert turns.min() > 0.4 * TURNS[0]
    assert turns.max() < 1.5 * TURNS[1]
    assert (np.diff(offsets) - 1 >= 15.9 * turns).all()
    for s, (a, b) in enumerate(pairwise(offsets)):
        centre = points[a:b, :2].mean(axis=0)
        assert np.linalg.norm(centre) < 0.9 * made["radius"][s]
        assert points[b - 1, 2] < points[a, 2]


def test_strands_without_twists_wind_as_their_numbers_say(monkeypatch: pytest.MonkeyPatch) -> None:
    real = library.draw_recipes

    def untwisted(*given: Any, **more: Any) -> Any:
        recipes = real(*given, **more)
        return replace(recipes, twist=np.zeros(len(recipes)))

    monkeypatch.setattr(library, "draw_recipes", untwisted)
    plain = make_library(COUNT, 3)
    radius, wavelength = winding(plain["points"].astype(np.float64), plain["offsets"])
    assert (plain["twists"] == 0).all()
    for found, told in ((radius, plain["radius"]), (wavelength, plain["wavelength"])):
        off = np.abs(found / told - 1.0)
        assert np.median(off) < 0.02
        assert np.percentile(off, 90) < 0.35


def test_the_same_seed_makes_the_same_library_and_another_another(made: dict[str, NDArray]) -> None:
    again, other = make_library(COUNT, 3), make_library(COUNT, 4)
    for name, values in made.items():
        np.testing.assert_array_equal(again[name], values)
    assert len(other["points"]) != len(made["points"])


def test_how_many_are_made_at_once_changes_no_strand(made: dict[str, NDArray], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "CHUNK", 15)
    done: list[int] = []
    parts = make_library(COUNT, 3, done.append)
    assert done == [15, 15, 10]
    for name, values in made.items():
        np.testing.assert_array_equal(parts[name], values)


def test_no_strands_are_refused() -> None:
    with pytest.raises(TextureError, match="needs strands, not 0"):
        make_library(0, 0)


def test_strands_none_of_which_has_an_axis_are_no_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "MOST_OFF", 1.0)
    with pytest.raises(TextureError, match="of 3 strands none has an axis"):
        make_library(3, 0)


def test_the_command_writes_what_the_runtime_reads(tmp_path: Path) -> None:
    done = CliRunner().invoke(command, ["train", "library", str(tmp_path / "models"), "--count", "12", "--seed", "3"])
    assert done.exit_code == 0, done.stderr
    found = load_library(tmp_path / "models")
    first = make_library(12, 3)
    np.testing.assert_array_equal(found.points, first["points"])
    manifest = json.loads((tmp_path / "models" / "library.json").read_text())
    assert manifest["strands"] == len(found.radius)
    assert (manifest["training"]["count"], manifest["training"]["seed"]) == (12, 3)
    assert f"{len(found.radius)} strands" in done.stderr
