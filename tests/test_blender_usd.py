"""Blender as a second opinion: what it makes of our USD files, and what we make of its own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from detangled import formats
from test_blender import COUNTS, SAME, counts_of, ragged, values_of, world_points

bpy: Any = pytest.importorskip("bpy", reason="needs Blender as a module: pip install 'detangled[blender]'")


@pytest.fixture(autouse=True)
def _empty_scene() -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)


def import_usd(path: Path) -> list[Any]:
    assert bpy.ops.wm.usd_import(filepath=str(path)) == {"FINISHED"}
    bpy.context.view_layer.update()
    return sorted((thing for thing in bpy.data.objects if thing.type == "CURVES"), key=lambda thing: thing.name)


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
@pytest.mark.parametrize("unit_cm", [1.0, 100.0])
def test_blender_reads_what_we_write(tmp_path: Path, suffix: str, unit_cm: float) -> None:
    groom = ragged(unit_cm=unit_cm, up="z", objects=("fringe",))
    assert formats.write(groom, tmp_path / f"a{suffix}") == []
    (thing,) = import_usd(tmp_path / f"a{suffix}")
    assert thing.name == "fringe"
    assert counts_of(thing.data) == list(COUNTS)
    np.testing.assert_allclose(world_points(thing), groom.points / 100.0, rtol=0, atol=SAME)
    widths = groom.attributes["width"].values / unit_cm
    np.testing.assert_allclose(2.0 * values_of(thing.data, "radius", "value"), widths, rtol=1e-6)


def test_blender_turns_what_is_y_up(tmp_path: Path) -> None:
    groom = ragged(unit_cm=100.0, up="y")
    formats.write(groom, tmp_path / "a.usdc")
    (thing,) = import_usd(tmp_path / "a.usdc")
    x, y, z = groom.points.T / 100.0
    np.testing.assert_allclose(world_points(thing), np.stack([x, -z, y], axis=1), rtol=0, atol=SAME)


def test_we_read_blenders_curves(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    positions = rng.uniform(-0.15, 0.15, (sum(COUNTS), 3)).astype(np.float32)
    curves = bpy.data.hair_curves.new("strands")
    curves.add_curves(list(COUNTS))
    curves.attributes["position"].data.foreach_set("vector", positions.ravel())
    thing = bpy.data.objects.new("head", curves)
    bpy.context.collection.objects.link(thing)
    thing.location = (0.02, -0.01, 0.03)
    thing.scale = (2.0, 2.0, 2.0)
    bpy.context.view_layer.update()
    assert bpy.ops.wm.usd_export(filepath=str(tmp_path / "a.usdc")) == {"FINISHED"}
    groom = formats.read(tmp_path / "a.usdc")
    assert (groom.unit_cm, groom.unit_source, groom.up) == (100.0, "file", "z")
    # Blender puts curves of a kind together, which is another order of strands here or none.
    assert sorted(groom.point_counts.tolist()) == sorted(COUNTS)
    world = 2.0 * positions.astype(np.float64) + [0.02, -0.01, 0.03]
    found = np.sort(groom.points / 100.0, axis=0)
    np.testing.assert_allclose(found, np.sort(world, axis=0), rtol=0, atol=SAME)


def test_a_real_groom_written_back_is_the_same_in_blender(grooms: Callable[[str], Path], tmp_path: Path) -> None:
    (before,) = import_usd(grooms("eve.usdc"))
    counts, points = counts_of(before.data), world_points(before)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    formats.write(formats.read(grooms("eve.usdc")), tmp_path / "eve.usdc")
    (after,) = import_usd(tmp_path / "eve.usdc")
    assert counts_of(after.data) == counts
    np.testing.assert_allclose(world_points(after), points, rtol=0, atol=SAME)
