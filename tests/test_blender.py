"""Blender as a second opinion: what it makes of our .abc files, and what we make of its own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from detangled import formats
from detangled.groom import Attribute, Groom, Scope

bpy: Any = pytest.importorskip("bpy", reason="needs Blender as a module: pip install 'detangled[blender]'")

COUNTS = (2, 5, 9, 3)
POLY = 1  # of Blender's curve types
# Coordinates near 1 m in float32.
SAME = 2e-7


@pytest.fixture(autouse=True)
def _empty_scene() -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)


def import_abc(path: Path, **options: Any) -> list[Any]:
    assert bpy.ops.wm.alembic_import(filepath=str(path), as_background_job=False, **options) == {"FINISHED"}
    bpy.context.view_layer.update()
    return sorted((thing for thing in bpy.data.objects if thing.type == "CURVES"), key=lambda thing: thing.name)


def export_abc(path: Path, **options: Any) -> None:
    bpy.context.view_layer.update()
    options = {"start": 1, "end": 1, "as_background_job": False, **options}
    assert bpy.ops.wm.alembic_export(filepath=str(path), **options) == {"FINISHED"}


def values_of(curves: Any, name: str, field: str, width: int = 1) -> NDArray[np.float32]:
    data = curves.attributes[name].data
    values = np.empty(
        len(data) * width, dtype=np.int8 if data[0].bl_rna.identifier.startswith("ByteInt") else np.float32
    )
    data.foreach_get(field, values)
    return values.reshape(-1, width) if width > 1 else values


def counts_of(curves: Any) -> list[int]:
    return [curve.points_length for curve in curves.curves]


def world_points(thing: Any) -> NDArray[np.float64]:
    """Positions in Blender's world, z up."""
    points = values_of(thing.data, "position", "vector", 3).astype(np.float64)
    matrix = np.array(thing.matrix_world)
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3])


def z_up(points: NDArray[np.floating]) -> NDArray[np.float64]:
    """What lies at (x, y, z) with y up lies at (x, -z, y) with z up."""
    return np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1).astype(np.float64)


def ragged(width_scope: Scope = Scope.POINT, **fields: Any) -> Groom:
    rng = np.random.default_rng(5)
    strands = [np.cumsum(rng.normal(0.0, 0.5, (count, 3)), axis=0) for count in COUNTS]
    size = {Scope.GROOM: 1, Scope.STRAND: len(COUNTS), Scope.POINT: sum(COUNTS)}[width_scope]
    attributes = {
        "width": Attribute(rng.uniform(0.004, 0.01, size).astype(np.float32), width_scope),
        "uv": Attribute(rng.uniform(0.0, 1.0, (len(COUNTS), 2)).astype(np.float32), Scope.STRAND),
        "groom_id": Attribute(np.arange(len(COUNTS), dtype=np.int32), Scope.STRAND),
        **fields.pop("attributes", {}),
    }
    return Groom.from_strands(strands, attributes=attributes, **{"unit_cm": 100.0, **fields})


# ---- ours, read by Blender


@pytest.mark.parametrize("width_scope", Scope)
def test_blender_reads_what_we_write(tmp_path: Path, width_scope: Scope) -> None:
    groom = ragged(width_scope, objects=("fringe",))
    assert formats.write(groom, tmp_path / "a.abc") == []
    (thing,) = import_abc(tmp_path / "a.abc")
    assert thing.name == "fringe"
    assert counts_of(thing.data) == list(COUNTS)
    np.testing.assert_allclose(world_points(thing), z_up(groom.points / 100.0), rtol=0, atol=SAME)
    # Straight from point to point: what was sampled finely is not smoothed again.
    assert values_of(thing.data, "curve_type", "value").tolist() == [POLY] * len(COUNTS)
    widths = groom.attributes["width"].values / 100.0
    expected = {
        Scope.GROOM: lambda: np.repeat(widths, sum(COUNTS)),
        Scope.STRAND: lambda: np.repeat(widths, COUNTS),
        Scope.POINT: lambda: widths,
    }[width_scope]()
    np.testing.assert_allclose(2.0 * values_of(thing.data, "radius", "value"), expected, rtol=1e-6)


def test_centimetres_need_a_scale_in_blender(tmp_path: Path) -> None:
    groom = ragged(unit_cm=1.0)
    formats.write(groom, tmp_path / "a.abc")
    (thing,) = import_abc(tmp_path / "a.abc", scale=0.01)
    np.testing.assert_allclose(world_points(thing), z_up(groom.points / 100.0), rtol=0, atol=SAME)


def test_blender_reads_every_object(tmp_path: Path) -> None:
    owner = Attribute(np.array([0, 1, 1, 0], dtype=np.int32), Scope.STRAND)
    groom = ragged(objects=("brows", "hair"), attributes={"object": owner})
    formats.write(groom, tmp_path / "a.abc")
    brows, hair = import_abc(tmp_path / "a.abc")
    assert (brows.name, hair.name) == ("brows", "hair")
    for thing, strands in ((brows, [0, 3]), (hair, [1, 2])):
        own = groom.select(strands)
        assert counts_of(thing.data) == own.point_counts.tolist()
        np.testing.assert_allclose(world_points(thing), z_up(own.points / 100.0), rtol=0, atol=SAME)


def test_a_real_groom_written_back_is_the_same_in_blender(grooms: Callable[[str], Path], tmp_path: Path) -> None:
    source = grooms("eve.abc")
    (before,) = import_abc(source)
    counts, points = counts_of(before.data), world_points(before)
    radii, name = values_of(before.data, "radius", "value"), before.name
    bpy.ops.wm.read_factory_settings(use_empty=True)
    groom = formats.read(source)
    formats.write(groom, tmp_path / "eve.abc")
    (after,) = import_abc(tmp_path / "eve.abc")
    assert after.name == name
    assert counts_of(after.data) == counts == groom.point_counts.tolist()
    np.testing.assert_allclose(world_points(after), points, rtol=0, atol=SAME)
    np.testing.assert_allclose(world_points(after), z_up(groom.points / 100.0), rtol=0, atol=SAME)
    np.testing.assert_allclose(values_of(after.data, "radius", "value"), radii, rtol=1e-6)


# ---- Blender's, read by us


def test_we_read_blenders_curves(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    positions = rng.uniform(-0.15, 0.15, (sum(COUNTS), 3)).astype(np.float32)
    radii = rng.uniform(2e-5, 5e-5, sum(COUNTS)).astype(np.float32)
    curves = bpy.data.hair_curves.new("strands")
    curves.add_curves(list(COUNTS))
    curves.attributes["position"].data.foreach_set("vector", positions.ravel())
    if "radius" not in curves.attributes:
        curves.attributes.new("radius", "FLOAT", "POINT")
    curves.attributes["radius"].data.foreach_set("value", radii)
    thing = bpy.data.objects.new("head", curves)
    bpy.context.collection.objects.link(thing)
    thing.location = (0.02, -0.01, 0.03)
    thing.scale = (2.0, 2.0, 2.0)
    export_abc(tmp_path / "a.abc")

    groom = formats.read(tmp_path / "a.abc")
    assert (groom.unit_cm, groom.unit_source, groom.up) == (100.0, "size", "y")
    assert groom.point_counts.tolist() == list(COUNTS)
    world = 2.0 * positions.astype(np.float64) + [0.02, -0.01, 0.03]
    np.testing.assert_allclose(z_up(groom.points / 100.0), world, rtol=0, atol=SAME)
    # A width is twice a radius, and the object's scale is 2.
    np.testing.assert_allclose(groom.attributes["width"].values, 100.0 * 2.0 * 2.0 * radii, rtol=1e-5)


def test_we_read_uvs_of_blenders_particle_hair(tmp_path: Path) -> None:
    """On a plane from -10 to 10 cm a root's UV is its place: that tells a wrong order or scope at once."""
    bpy.ops.mesh.primitive_plane_add(size=0.2)
    plane = bpy.context.object
    bpy.ops.object.particle_system_add()
    settings = plane.particle_systems[0].settings
    settings.type = "HAIR"
    settings.count = 25
    settings.hair_length = 0.15
    export_abc(tmp_path / "a.abc", export_hair=True, export_particles=False)

    groom = formats.read(tmp_path / "a.abc")
    assert groom.strand_count == 25
    assert groom.unit_cm == 100.0
    assert any("skipped what is not curves" in note for note in groom.notes)
    uv = groom.attributes["uv"]
    assert (uv.scope, uv.values.shape) == (Scope.STRAND, (25, 2))
    roots = z_up(groom.points[groom.offsets[:-1]])
    np.testing.assert_allclose(roots[:, 2], 0.0, atol=1e-4)
    np.testing.assert_allclose(uv.values, roots[:, :2] / 20.0 + 0.5, atol=1e-5)
    normals = groom.attributes["N"]
    assert (normals.scope, normals.values.shape) == (Scope.STRAND, (25, 3))

    # And on to a file of ours without loss.
    assert formats.write(groom, tmp_path / "b.abc") == []
    back = formats.read(tmp_path / "b.abc")
    assert back.attributes["uv"].scope is Scope.STRAND
    np.testing.assert_array_equal(back.attributes["uv"].values, uv.values)
