"""What engines would drop or misread, in files made with the Alembic library as other programs make them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import imath
import numpy as np
import pytest
from alembic3d import Abc, AbcGeom
from click.testing import CliRunner

from detangled import formats
from detangled.formats.abc_values import filled
from detangled.formats.frames import write_frames
from detangled.groom import Attribute, Groom, Scope
from detangled.presets import preset
from detangled.validation import validate
from detangled.validation.archive import contents
from detangled_cli.main import detangled
from test_formats_abc import curves_sample, transform
from test_presets import CON, UNI, VTX, hanging, rich

STRANDS, POINTS = 4, 3


def lost(path: Path, engine: str = "unreal", **options: Any) -> str:
    return "\n".join(str(f) for f in validate(path, engine, **options) if f.loses)


def noted(path: Path, engine: str = "unreal") -> str:
    return "\n".join(str(f) for f in validate(path, engine) if not f.loses)


Build = Callable[..., Path]


@pytest.fixture
def build(tmp_path: Path) -> Build:
    """Write 4 curves of 3 points that Unreal takes as they are, but for what ``change`` does to them.

    It is called with the schema of the curves and their transform.
    """

    def write(change: Callable[[Any, Any], object] | None = None, versions: bool = True, widths: Any = None) -> Path:
        path = tmp_path / "a.abc"

        def nodes() -> None:
            archive = Abc.OArchive(str(path))
            transform = AbcGeom.OXform(archive.getTop(), "groom")
            if versions:
                user = transform.getSchema().getUserProperties()
                Abc.OInt16Property(user, "groom_version_major").setValue(1)
                Abc.OInt16Property(user, "groom_version_minor").setValue(5)
            schema = AbcGeom.OCurves(transform, "hair").getSchema()
            roots = np.repeat(np.arange(STRANDS) * [[8.0], [0], [0]], POINTS, axis=1).T
            down = np.tile([[0.0, 0, 0], [0, 0, -10], [1, 0, -20]], (STRANDS, 1))
            sample = AbcGeom.OCurvesSchemaSample(
                filled(imath.V3fArray, roots + down),
                filled(imath.IntArray, np.full(STRANDS, POINTS)),
                AbcGeom.CurveType.kLinear,
            )
            values, scope = widths or (np.full(STRANDS * POINTS, 0.008), VTX)
            if len(values):
                sample.setWidths(AbcGeom.OFloatGeomParamSample(filled(imath.FloatArray, values), scope))
            schema.set(sample)
            if change is not None:
                change(schema, transform)

        nodes()
        return path

    return write


def parameter(kind: str, name: str, values: Any, scope: Any = UNI, extent: int = 1, user: bool = False) -> Any:
    """A change that gives the curves an attribute."""
    arrays = {
        "Int32": imath.IntArray,
        "Int16": imath.ShortArray,
        "Float": imath.FloatArray,
        "Double": imath.DoubleArray,
        "V2f": imath.V2fArray,
        "V3f": imath.V3fArray,
        "V3i": imath.V3iArray,
        "Half": imath.FloatArray,
    }

    def change(schema: Any, _: Any) -> None:
        parent = schema.getUserProperties() if user else schema.getArbGeomParams()
        made = getattr(AbcGeom, f"O{kind}GeomParam")(parent, name, False, scope, extent)
        array = filled(arrays[kind], np.asarray(values))
        if kind == "Int16":
            # Such an array gives out no memory.
            for index, value in enumerate(values):
                array[index] = value
        made.set(getattr(AbcGeom, f"O{kind}GeomParamSample")(array, scope))

    return change


def test_a_sound_file_loses_nothing(build: Build) -> None:
    path = build()
    assert lost(path) == ""
    assert "no groom_root_uv" in noted(path)


@pytest.mark.parametrize("engine", ["unreal", "unity", "blender"])
@pytest.mark.parametrize("make", [hanging, rich])
def test_what_a_preset_writes_loses_nothing(tmp_path: Path, engine: str, make: Callable[[], Groom]) -> None:
    formats.write(preset(make(), engine).groom, tmp_path / "a.abc")
    assert lost(tmp_path / "a.abc", engine) == ""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (parameter("V2f", "groom_root_uv", np.zeros((4, 2))), ""),
        (parameter("V2f", "groom_root_uv", np.zeros((4, 2)), CON), ""),
        (parameter("Int16", "groom_guide", [1, 0, 0, 1]), ""),
        (parameter("Int32", "groom_group_id", [2], CON), ""),
        (parameter("Float", "groom_width", np.ones(12), VTX), ""),
        (parameter("V2f", "groom_root_uv", np.zeros((12, 2)), VTX), "one value for a point where one for a strand"),
        (parameter("V2f", "groom_root_uv", np.zeros((3, 2))), "3 values of scope uni for 4 strands"),
        (parameter("V3f", "groom_root_uv", np.zeros((4, 3))), "float32_t[3], float64_t[2] is needed"),
        (parameter("V2f", "groom_root_uv", np.full((4, 2), np.inf)), "not finite"),
        (parameter("V2f", "groom_root_uv", np.zeros((4, 2)), user=True), "among the user properties"),
        (parameter("Float", "groom_id", np.arange(4)), "float32_t, int32_t is needed"),
        (parameter("Int32", "groom_id", np.arange(8), extent=2), "8 values"),
        (parameter("Half", "groom_width", np.ones(4)), "float16_t, which is not looked at"),
        (parameter("Int32", "groom_group_id", [0, 1, -1, 0]), "groom_group_id below 0"),
        (parameter("Int32", "groom_guide", [0, 0, 0, 0]), "no strand is a guide"),
        (parameter("Int32", "groom_guide", [1, 1, 1, 1]), "every strand is a guide"),
        (parameter("V3i", "groom_closest_guides", np.zeros((4, 3))), "no strand is flagged"),
        (parameter("Int32", "groom_version_major", [1], CON), "not among the user properties of the topmost node"),
    ],
)
def test_attributes_are_read_as_unreal_reads_them(build: Build, change: Any, words: str) -> None:
    said = lost(build(change))
    assert (words in said) if words else (said == "")


def test_values_with_indices_are_not_looked_at(build: Build) -> None:
    def change(schema: Any, _: Any) -> None:
        made = AbcGeom.OV2fGeomParam(schema.getArbGeomParams(), "groom_root_uv", True, UNI, 1)
        index = imath.UnsignedIntArray(filled(imath.DoubleArray, [0, 1, 1, 0]))
        made.set(AbcGeom.OV2fGeomParamSample(filled(imath.V2fArray, np.eye(2)), index, UNI))

    assert "values with indices" in lost(build(change))


def test_single_properties_and_unknown_names(build: Build) -> None:
    def change(schema: Any, _: Any) -> None:
        Abc.OInt32Property(schema.getArbGeomParams(), "groom_group_id").setValue(3)
        parameter("Float", "groom_shine", np.ones(4))(schema, None)
        parameter("Float", "frizz", np.ones(4))(schema, None)

    path = build(change)
    assert "groom_group_id: a single property" in lost(path)
    assert "groom_shine: not in Unreal's schema" in noted(path)
    assert "does not look at frizz" in noted(path)


def test_versions_must_stand_where_they_are_looked_for(build: Build) -> None:
    assert "groom_version_major and groom_version_minor are missing" in lost(build(versions=False))

    def others_first(_: Any, transform: Any) -> None:
        Abc.OStringProperty(transform.getSchema().getUserProperties(), "author").setValue("me")

    assert "/groom: groom_version_major is missing, 1 is needed" in lost(build(others_first, versions=False))

    def on_curves(schema: Any, _: Any) -> None:
        Abc.OInt32Property(schema.getUserProperties(), "groom_version_major").setValue(1)
        Abc.OInt16Property(schema.getUserProperties(), "groom_version_minor").setValue(4)

    said = lost(build(on_curves, versions=False))
    assert "groom_version_minor is 4 (int16_t), 5 is needed" in said
    assert "major" not in said


@pytest.mark.parametrize(
    ("values", "scope", "words"),
    [
        (np.full(4, 0.008), UNI, ""),
        (np.full(1, 0.008), CON, ""),
        (np.full(12, 0.008), CON, ""),
        (np.linspace(0.005, 0.01, 12), CON, "12 widths of constant scope: all hair gets the first"),
        (np.full(12, 0.008), AbcGeom.GeometryScope.kVaryingScope, "widths of scope var that do not fit"),
        (np.full(3, 0.008), UNI, "widths of scope uni that do not fit"),
        (np.zeros(0), CON, "no widths: every hair becomes 1 cm thick"),
        (np.full(12, 8.0), VTX, "8 cm thick"),
    ],
)
def test_widths(build: Build, values: Any, scope: Any, words: str) -> None:
    said = lost(build(widths=(values, scope)))
    assert (words in said) if words else (said == "")


def test_transforms_do_not_scale_widths(build: Build) -> None:
    def change(_: Any, transform: Any) -> None:
        sample = AbcGeom.XformSample()
        sample.setScale(imath.V3d(1.2, 1.2, 1.2))
        transform.getSchema().set(sample)

    assert "widths are not scaled with the nodes above, which make the hair 1.2 times larger" in lost(build(change))


def test_a_transform_that_begins_anew_is_not_scaled_with_those_above_it(tmp_path: Path) -> None:
    def nodes() -> None:
        archive = Abc.OArchive(str(tmp_path / "a.abc"))
        above = transform(archive.getTop(), "outer", np.diag([5.0, 5.0, 5.0, 1.0]))
        below = transform(above, "alone", np.diag([2.0, 2.0, 2.0, 1.0]), inherits=False)
        for parent, name in ((above, "one"), (below, "two")):
            AbcGeom.OCurves(parent, name).getSchema().set(curves_sample(np.eye(3, dtype=np.float32), [3]))

    nodes()
    scales = {curves.path.rpartition("/")[2]: curves.scale for curves in contents(tmp_path / "a.abc").curves}
    assert scales == pytest.approx({"one": 5.0, "two": 2.0})


def test_a_mesh_beside_the_hair(build: Build) -> None:
    def change(_: Any, transform: Any) -> None:
        triangle = AbcGeom.OPolyMeshSchemaSample(
            filled(imath.V3fArray, np.eye(3)), filled(imath.IntArray, [0, 1, 2]), filled(imath.IntArray, [3])
        )
        AbcGeom.OPolyMesh(transform, "head").getSchema().set(triangle)

    assert "/groom/head: a mesh: Unreal rejects" in lost(build(change))
    assert "mesh" not in lost(build(change), "unity")


def test_closest_guides_that_are_none(tmp_path: Path) -> None:
    groom = preset(rich(), "unreal").groom

    def written(**changed: Any) -> str:
        attributes = {**groom.attributes, **{k: Attribute(v, Scope.STRAND) for k, v in changed.items()}}
        formats.write(Groom(groom.points, groom.offsets, attributes, up="z"), tmp_path / "a.abc")
        return lost(tmp_path / "a.abc")

    assert written() == ""
    closest = groom.attributes["groom_closest_guides"].values
    assert "24 of the closest guides are no guides' ids" in written(groom_closest_guides=closest * 0 + 5)
    assert "several strands have one id" in written(groom_id=np.zeros(12, dtype=np.int32))
    assert "without sound groom_guide_weights" in written(groom_guide_weights=np.zeros(12))
    assert "are rounded" in written(groom_id=groom.attributes["groom_id"].values + 2**24)


def test_limits_units_and_bad_strands(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    long = np.cumsum(rng.normal(size=(300, 3)), axis=0)
    groom = Groom.from_strands([long, long[:1], long[:200], long[:5] * np.nan], up="z")
    formats.write(groom, tmp_path / "a.abc")
    assert "1 strands of more than 255 points, up to 300" in lost(tmp_path / "a.abc")
    assert "2 strands without two distinct finite points (1, 3): they are dropped" in lost(tmp_path / "a.abc")
    assert "2 strands of more than 128 points" in lost(tmp_path / "a.abc", "unity")
    assert "the whole set is thrown away for one" in lost(tmp_path / "a.abc", "unity")
    assert "in cm by its size: Unity takes it for m" in lost(tmp_path / "a.abc", "unity")
    assert "in m as given: Unreal takes it for cm" in lost(tmp_path / "a.abc", unit="m")
    formats.write(groom.select([0]), tmp_path / "a.obj")
    assert "Unreal imports .abc" in lost(tmp_path / "a.obj")


def test_frames_and_a_wrong_axis_are_noted(tmp_path: Path) -> None:
    groom = hanging(unit_cm=1.0)
    write_frames(groom, [0.0, 0.1], [groom.points, groom.points], tmp_path / "a.abc")
    assert "2 time samples: import them as a groom cache" in noted(tmp_path / "a.abc")
    assert "hair falls along -y, Unreal takes z for up" in noted(tmp_path / "a.abc")
    assert "falls" not in noted(tmp_path / "a.abc", "unity")


def test_the_command(build: Build, tmp_path: Path) -> None:
    def run(*arguments: object) -> Any:
        return CliRunner().invoke(detangled, ["validate", *map(str, arguments)])

    good = run(build(), "--preset", "unreal")
    assert good.exit_code == 0
    assert good.stdout.splitlines()[-1].endswith("Unreal loses nothing of it")
    path = build(versions=False)
    bad = run(path, "--preset", "unreal")
    assert bad.exit_code == 3
    assert bad.stdout.splitlines()[0].startswith("lost: ")
    listed = json.loads(run(path, "--preset", "unreal", "--json").stdout)
    assert (listed["sound"], listed["findings"][0]["loses"]) == (False, True)
    assert run(path).exit_code == 2
    assert run(tmp_path / "none.abc", "--preset", "unity").exit_code == 3


def test_real_files_and_what_convert_makes_of_them(grooms: Callable[[str], Path], tmp_path: Path) -> None:
    source = grooms("bob.abc")
    assert "in m by its size" in lost(source)
    # Blender gives widths no scope: they are taken for constant ones, not for none.
    assert "do not fit" not in lost(source)
    run = CliRunner().invoke(detangled, ["convert", str(source), str(tmp_path / "b.abc"), "--preset", "unreal"])
    assert run.exit_code == 0
    assert "spherical projection" in run.stderr
    assert lost(tmp_path / "b.abc") == ""
