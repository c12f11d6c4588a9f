"""The example files: what their script makes now is what lies beside it, and they are what they claim to be."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray

from detangled.formats import read
from detangled.groom import Groom, Scope

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
NAMES = ("bob.abc", "coily_strands.obj", "wavy_strands.obj")
# Processors may round sines differently; nothing that can be seen may change.
SAME_CM = 1e-4
LARGEST_BYTES = 300_000


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_examples", EXAMPLES / "make_examples.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Where dataclasses look for the module of a class.
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def made(script: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("examples")
    script.main(folder)
    return folder


def strands_of(groom: Groom) -> list[NDArray[np.float64]]:
    return [groom.strand(index) for index in range(groom.strand_count)]


@pytest.mark.parametrize("name", NAMES)
def test_the_script_makes_what_is_here(made: Path, name: str) -> None:
    here, anew = read(EXAMPLES / name), read(made / name)
    np.testing.assert_array_equal(here.offsets, anew.offsets)
    np.testing.assert_allclose(here.points, anew.points, rtol=0, atol=SAME_CM)
    assert (here.unit_cm, here.up, here.objects) == (anew.unit_cm, anew.up, anew.objects)
    assert here.attributes.keys() == anew.attributes.keys()
    for key, attribute in here.attributes.items():
        assert attribute.scope is anew.attributes[key].scope
        np.testing.assert_allclose(attribute.values, anew.attributes[key].values, rtol=0, atol=1e-6)


def test_the_same_bytes_each_time(script: ModuleType, made: Path, tmp_path: Path) -> None:
    script.main(tmp_path)
    for name in NAMES:
        assert (tmp_path / name).read_bytes() == (made / name).read_bytes()


@pytest.mark.parametrize("name", NAMES)
def test_files_are_small(name: str) -> None:
    assert (EXAMPLES / name).stat().st_size < LARGEST_BYTES


def test_the_bob_is_one(script: ModuleType) -> None:
    groom = read(EXAMPLES / "bob.abc")
    assert (groom.unit_cm, groom.unit_source, groom.up) == (100.0, "size", "y")
    assert 230 <= groom.strand_count <= 270
    assert set(groom.point_counts.tolist()) == {16}
    lengths = groom.polyline_lengths()
    assert lengths.min() > 12.0
    assert lengths.max() < 24.0
    scopes = {name: attribute.scope for name, attribute in groom.attributes.items()}
    assert scopes == {
        "width": Scope.POINT,
        "uv": Scope.STRAND,
        "groom_id": Scope.STRAND,
        "groom_group_id": Scope.STRAND,
    }
    uv = groom.attributes["uv"].values
    assert uv.shape == (groom.strand_count, 2)
    assert uv.min() > 0.0
    assert uv.max() < 1.0
    assert len(np.unique(np.round(uv, 4), axis=0)) == groom.strand_count
    np.testing.assert_array_equal(groom.attributes["groom_id"].values, np.arange(groom.strand_count))
    assert set(groom.attributes["groom_group_id"].values.tolist()) == {0, 1, 2}
    width = groom.attributes["width"].values.reshape(groom.strand_count, -1)
    assert np.all(np.diff(width, axis=1) < 0)
    np.testing.assert_allclose(width[:, [0, -1]].T, [[0.008] * len(width), [0.004] * len(width)], rtol=1e-5)


def test_the_bob_grows_from_the_scalp_and_stays_out_of_the_head(script: ModuleType) -> None:
    groom = read(EXAMPLES / "bob.abc")
    unit = groom.points.reshape(groom.strand_count, -1, 3) / script.HEAD
    level = np.linalg.norm(unit, axis=2)
    np.testing.assert_allclose(level[:, 0], 1.0, atol=1e-5)
    assert level[:, 1:].min() > 1.0
    # Segments are chords: their middles are nearer to the head than their ends.
    assert np.linalg.norm(0.5 * (unit[:, :-1] + unit[:, 1:]), axis=2).min() > 1.0
    root, first = unit[:, 0], (unit[:, 1] - unit[:, 0]) * script.HEAD
    normal = root / script.HEAD
    assert np.all(np.einsum("sk,sk->s", first, normal) > 0)
    # No root below the forehead's hairline in front, and no hair before eyes, nose and mouth.
    assert root[root[:, 2] > 0.5, 1].min() > 0.3
    x, y, z = np.moveaxis(unit, 2, 0)
    assert not np.any((z > 0.5) & (np.abs(x) < 0.5) & (y < 0.3))


@pytest.mark.parametrize(("name", "count", "size"), [("coily_strands.obj", 6, 14.0), ("wavy_strands.obj", 4, 21.0)])
def test_strands_hang(script: ModuleType, name: str, count: int, size: float) -> None:
    groom = read(EXAMPLES / name)
    assert (groom.unit_cm, groom.unit_source, groom.strand_count) == (1.0, "size", count)
    for strand in strands_of(groom):
        assert script.wander(strand) < 1.08
        assert strand[0, 1] == 0.0
        assert -strand[:, 1].min() == pytest.approx(size, rel=0.2)
        # Evenly along the arc, so that chords differ by their curvature alone.
        steps = np.linalg.norm(np.diff(strand, axis=0), axis=1)
        assert steps.max() < 1.3 * steps.min()


def test_wander_of_known_shapes(script: ModuleType) -> None:
    """A straight helix does not wander; a helix around an arc does, by the ratio of arc to chord."""
    phi = np.arange(240) * 2 * np.pi / script.POINTS_A_TURN
    y = -0.8 * phi / (2 * np.pi)
    helix = np.stack([0.35 * np.cos(phi), y, 0.35 * np.sin(phi)], axis=1)
    assert script.wander(helix) == pytest.approx(1.0, abs=1e-6)
    bend = y / 8.0
    around = np.stack([(8.0 + helix[:, 0]) * np.cos(bend), (8.0 + helix[:, 0]) * np.sin(bend), helix[:, 2]], axis=1)
    angle = np.abs(bend[-1] - bend[0]) * (1 - 2 * 11 / 239)
    assert script.wander(around) == pytest.approx(angle / (2 * np.sin(angle / 2)), rel=0.02)


def test_twists_keep_lengths_and_directions(script: ModuleType) -> None:
    """A twist turns about the segment before it: the segment after keeps its angle to it and its length."""
    rng = np.random.default_rng(1)
    segments = rng.normal(size=(60, 3))
    twisted = script.twisted(segments, 0.3, rng)
    assert not np.allclose(twisted, segments)
    np.testing.assert_allclose(np.linalg.norm(twisted, axis=1), np.linalg.norm(segments, axis=1))
    before = np.einsum("ij,ij->i", segments[1:], segments[:-1])
    np.testing.assert_allclose(np.einsum("ij,ij->i", twisted[1:], twisted[:-1]), before, atol=1e-12)
