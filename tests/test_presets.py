"""Grooms made ready for engines: each attribute of Unreal's schema read back with the Alembic library itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from alembic3d import Abc, AbcGeom
from numpy.typing import NDArray

from detangled import formats
from detangled.errors import DetangledError
from detangled.groom import Attribute, Groom, Scope
from detangled.presets import preset, unreal
from detangled.presets.closest_guides import closest_guides
from detangled.presets.root_uv import spherical
from test_fewer_points import helix

CON, UNI, VTX = (
    AbcGeom.GeometryScope.kConstantScope,
    AbcGeom.GeometryScope.kUniformScope,
    AbcGeom.GeometryScope.kVertexScope,
)


def hanging(count: int = 12, points: int = 9, **fields: Any) -> Groom:
    rng = np.random.default_rng(2)
    roots = rng.normal(size=(count, 3)) * [5.0, 5.0, 5.0]
    down = np.stack([np.zeros(points), -np.linspace(0.0, 20.0, points), np.zeros(points)], axis=1)
    strands = [root + down + 0.1 * np.cumsum(rng.normal(size=(points, 3)), axis=0) for root in roots]
    return Groom.from_strands(strands, **{"unit_cm": 100.0, **fields})


def strand_values(values: Any) -> Attribute:
    return Attribute(np.asarray(values), Scope.STRAND)


def z_up(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)


def said(groom: Groom, name: str = "unreal", **options: Any) -> str:
    return "\n".join(preset(groom, name, **options).sentences)


class Written:
    """An archive of one curves object below one transform, opened with the library."""

    def __init__(self, path: Path) -> None:
        self.archive = Abc.IArchive(str(path))
        self.top = self.archive.getTop()
        assert self.top.getNumChildren() == 1
        node = self.top.getChild(0)
        self.transform = AbcGeom.IXform(self.top, node.getName())
        self.curves = AbcGeom.ICurves(self.transform, node.getChild(0).getName()).getSchema()
        self.arbitrary = self.curves.getArbGeomParams()
        # Asked for its properties, a compound that is not there would crash.
        count = self.arbitrary.getNumProperties() if self.arbitrary.valid() else 0
        self.names = {self.arbitrary.getPropertyHeader(i).getName() for i in range(count)}

    def parameter(self, kind: str, name: str) -> tuple[Any, NDArray[Any]]:
        """Scope and values of a parameter opened as of one type: the library refuses another."""
        opened = getattr(AbcGeom, f"I{kind}GeomParam")(self.arbitrary, name)
        # Unreal looks at plain arrays alone, not at values with indices.
        assert opened.getHeader().isArray(), name
        return opened.getScope(), np.asarray(opened.getExpandedValue().getVals())


def rich(count: int = 12) -> Groom:
    groom = hanging(count)
    rng = np.random.default_rng(3)
    return replace(
        groom,
        attributes={
            "width": Attribute(rng.uniform(0.004, 0.01, len(groom.points)), Scope.POINT),
            "groom_guide": strand_values(np.arange(count) % 3 == 0),
            "groom_group_id": strand_values((np.arange(count) % 2).astype(np.int16)),
            "groom_id": strand_values(100 + np.arange(count)),
            "uv": strand_values(rng.random((count, 2)).astype(np.float32)),
            "Cd": Attribute(rng.random((len(groom.points), 3)).astype(np.float32), Scope.POINT),
        },
    )


def test_every_attribute_of_unreals_schema(tmp_path: Path) -> None:
    groom = rich()
    ready = preset(groom, "unreal").groom
    assert formats.write(ready, tmp_path / "a.abc") == []
    file = Written(tmp_path / "a.abc")

    for compound in (file.transform.getSchema().getUserProperties(), file.top.getProperties()):
        for name, value in (("groom_version_major", 1), ("groom_version_minor", 5)):
            number = Abc.IInt16Property(compound, name)
            assert number.getHeader().isScalar()
            assert str(number.getHeader().getDataType()) == "int16_t"
            assert number.getValue() == value
        assert Abc.IStringProperty(compound, "groom_tool").getValue().startswith("detangled ")
        assert Abc.IStringProperty(compound, "groom_properties").getValue()

    sample = file.curves.getValue()
    assert sample.getType() == AbcGeom.CurveType.kLinear
    assert list(sample.getCurvesNumVertices()) == groom.point_counts.tolist()
    np.testing.assert_allclose(np.asarray(sample.getPositions()), z_up(groom.points), rtol=0, atol=1e-5)
    widths = file.curves.getWidthsParam()
    assert widths.getScope() == VTX
    np.testing.assert_allclose(np.asarray(widths.getExpandedValue().getVals()), groom.attributes["width"].values, 1e-6)

    scope, width = file.parameter("Float", "groom_width")
    assert scope == VTX
    np.testing.assert_allclose(width, groom.attributes["width"].values, rtol=1e-6)
    scope, guide = file.parameter("Int32", "groom_guide")
    assert (scope, guide.tolist()) == (UNI, [1, 0, 0] * 4)
    scope, group = file.parameter("Int32", "groom_group_id")
    assert (scope, group.tolist()) == (UNI, [0, 1] * 6)
    names = AbcGeom.IStringGeomParam(file.arbitrary, "groom_group_name")
    assert list(names.getExpandedValue().getVals()) == ["group_0", "group_1"] * 6
    scope, ids = file.parameter("Int32", "groom_id")
    assert (scope, ids.tolist()) == (UNI, list(range(100, 112)))
    scope, uv = file.parameter("V2f", "groom_root_uv")
    assert scope == UNI
    np.testing.assert_array_equal(uv, groom.attributes["uv"].values)
    scope, colour = file.parameter("V3f", "groom_color")
    assert scope == VTX
    assert len(colour) == len(groom.points)
    scope, closest = file.parameter("V3i", "groom_closest_guides")
    assert scope == UNI
    scope, weights = file.parameter("V3f", "groom_guide_weights")
    assert scope == UNI
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-6)
    for strand in range(12):
        used = closest[strand][weights[strand] > 0]
        # Guides of the strand's own group, the nearest first.
        assert set(used) <= {100 + k for k in range(12) if k % 3 == 0 and k % 2 == strand % 2}
        roots = groom.points[groom.offsets[:-1]]
        distances = np.linalg.norm(roots[closest[strand] - 100] - roots[strand], axis=1)
        assert (np.diff(distances[: len(used)]) >= 0).all()


def test_a_file_for_unreal_comes_back_with_its_axes_and_properties(tmp_path: Path) -> None:
    groom = hanging()
    ready = preset(groom, "unreal")
    formats.write(ready.groom, tmp_path / "a.abc")
    back = formats.read(tmp_path / "a.abc", unit="cm")
    assert back.up == "z"
    np.testing.assert_allclose(back.points, z_up(groom.points), atol=1e-5)
    assert back.attributes["groom_version_major"].values.tolist() == [1]
    assert back.attributes["groom_version_major"].values.dtype == np.int16
    again = preset(back, "unreal")
    np.testing.assert_array_equal(again.groom.points, back.points)
    for name, attribute in ready.groom.attributes.items():
        # A width of all hair is written a point, since Blender overlooks it else.
        kept = again.groom.attributes[name].values
        np.testing.assert_array_equal(kept, np.broadcast_to(attribute.values, kept.shape))


def test_what_is_made_up_is_said() -> None:
    told = said(hanging())
    assert "spherical projection" in told
    assert "thickness of 0.07 mm" in told
    assert "z is up instead of y" in told
    assert "cm instead of m" in told
    ready = preset(hanging(), "unreal").groom
    assert "groom_guide" not in ready.attributes
    assert "groom_color" not in ready.attributes
    np.testing.assert_array_equal(ready.attributes["groom_root_uv"].values, spherical(ready))


def test_a_head_gives_root_uvs() -> None:
    uv = np.random.default_rng(1).random((12, 2))
    ready = preset(hanging(), "unreal", root_uv=uv)
    np.testing.assert_allclose(ready.groom.attributes["groom_root_uv"].values, uv, rtol=1e-6)
    assert "spherical" not in "".join(ready.sentences)
    with pytest.raises(DetangledError, match="shape"):
        preset(hanging(), "unreal", root_uv=uv[:3])


@pytest.mark.parametrize(
    ("name", "attribute", "words"),
    [
        ("groom_root_uv", strand_values(np.full((12, 2), np.nan)), "'groom_root_uv' was not used"),
        ("groom_root_uv", strand_values(np.zeros(12)), "'groom_root_uv' was not used"),
        ("groom_id", strand_values(np.zeros(12, dtype=np.int32)), "'groom_id' was made anew"),
        ("groom_id", strand_values(np.arange(12.0) + 0.5), "'groom_id' was made anew"),
        ("groom_group_id", strand_values(-np.arange(12)), "'groom_group_id' was made anew"),
        ("groom_group_id", strand_values(np.array(["a"] * 12)), "'groom_group_id' was made anew"),
        ("groom_guide", strand_values(np.full(12, 3)), "'groom_guide' was made anew"),
        ("groom_guide", strand_values(np.zeros(12)), "Unreal will choose guides itself"),
        ("groom_guide", strand_values(np.ones(12)), "which Unreal does not draw"),
        ("Cd", strand_values(np.zeros(12)), "'Cd' was not used as a colour"),
        ("width", strand_values(np.full(12, 7.0)), "7 cm thick"),
    ],
)
def test_attributes_of_the_wrong_kind_are_replaced_and_said(name: str, attribute: Attribute, words: str) -> None:
    ready = preset(replace(hanging(), attributes={name: attribute}), "unreal")
    assert words in "\n".join(ready.sentences)
    made = ready.groom.attributes
    assert made["groom_id"].values.dtype == made["groom_group_id"].values.dtype == np.int32
    assert made["groom_root_uv"].values.shape == (12, 2)
    assert np.isfinite(made["groom_root_uv"].values).all()
    assert ("groom_guide" in made) == ("groom_closest_guides" in made)


def test_attributes_of_the_wrong_length_are_refused_at_once() -> None:
    with pytest.raises(DetangledError, match="'groom_id' has 11 values"):
        replace(hanging(), attributes={"groom_id": strand_values(np.arange(11))})


def test_closest_guides_that_fit_are_kept_and_others_found_anew() -> None:
    groom = rich()
    own = preset(groom, "unreal").groom.attributes
    names = ("groom_closest_guides", "groom_guide_weights")
    swapped = {name: strand_values(own[name].values[:, ::-1].copy()) for name in names}
    kept = preset(replace(groom, attributes={**groom.attributes, **swapped}), "unreal").groom.attributes
    np.testing.assert_array_equal(kept[names[0]].values, swapped[names[0]].values)
    wrong = strand_values(np.full((12, 3), 999))
    again = preset(replace(groom, attributes={**groom.attributes, **swapped, names[0]: wrong}), "unreal")
    np.testing.assert_array_equal(again.groom.attributes[names[0]].values, own[names[0]].values)


def test_groups_without_guides_are_refused() -> None:
    attributes = {"groom_guide": strand_values([1] + [0] * 11), "groom_group_id": strand_values([0] * 6 + [1] * 6)}
    with pytest.raises(DetangledError, match="groups without guides"):
        preset(replace(hanging(), attributes=attributes), "unreal")


def test_weights_fall_with_distance_and_a_guide_follows_itself() -> None:
    groom = Groom.from_strands([[[x, 0, 0], [x, -1, 0]] for x in (0.0, 1.0, 4.0, 10.0)])
    guide = np.array([True, False, True, True])
    closest, weights = closest_guides(groom, guide, np.zeros(4, dtype=np.int64), np.arange(4, dtype=np.int32))
    assert closest[1].tolist() == [0, 2, 3]
    np.testing.assert_allclose(weights[1], np.array([1.0, 1 / 3, 1 / 9]) / (1 + 1 / 3 + 1 / 9), rtol=1e-6)
    np.testing.assert_allclose(weights[[0, 2, 3], 0], 1.0, atol=1e-6)
    assert closest[[0, 2, 3], 0].tolist() == [0, 2, 3]


# ---- limits


def test_points_are_capped_and_the_deviation_said() -> None:
    groom = Groom.from_strands([helix(12.0, 800), helix(80.0, 2000), helix(1.0, 30)], unit_cm=1.0, up="z")
    ready = preset(groom, "unreal")
    assert ready.groom.point_counts.tolist() == [255, 255, 30]
    told = "\n".join(ready.sentences)
    assert "2 strands of more than 255 points, up to 2,000" in told
    assert "1 strands have as few as 3" in told
    assert "--length strand" in told
    assert preset(groom, "unity").groom.point_counts.tolist() == [128, 128, 30]
    np.testing.assert_allclose(ready.points(groom.points), ready.groom.points, atol=1e-12)
    np.testing.assert_allclose(ready.points(groom.points + 5.0), ready.groom.points + 5.0, atol=1e-9)


def test_groups_beyond_the_limits_are_split() -> None:
    groom = preset(hanging(11, 4), "unreal").groom
    split, told = unreal.split_groups(groom, 4, 1000)
    assert split.attributes["groom_group_id"].values.tolist() == [0] * 4 + [1] * 4 + [2] * 3
    assert split.attributes["groom_group_name"].values[[0, 4, 8]].tolist() == ["hair", "hair_2", "hair_3"]
    assert told == ["group 0 was split into 3: Unreal takes 4 strands and 1,000 points a group"]
    split, _ = unreal.split_groups(groom, 1000, 9)
    assert np.bincount(split.attributes["groom_group_id"].values).tolist() == [2, 2, 2, 2, 2, 1]
    assert unreal.split_groups(groom, 11, 44) == (groom, [])
    with pytest.raises(DetangledError, match="has guides"):
        unreal.split_groups(preset(rich(), "unreal").groom, 4, 1000)


def test_unity_takes_no_more_strands_than_it_takes() -> None:
    points = np.tile([[0.0, 0, 0], [0, -1, 0]], (64_001, 1))
    with pytest.raises(DetangledError, match="64,001 strands, Unity takes 64,000"):
        preset(Groom(points, np.arange(0, len(points) + 1, 2)), "unity")


@pytest.mark.parametrize("name", ["unreal", "unity", "blender"])
def test_bad_strands_are_dropped_and_counted(name: str) -> None:
    line = np.array([[0.0, 0, 0], [0, -1, 0], [0, -2, 0]])
    groom = Groom.from_strands([line, line[:1], np.zeros((0, 3)), line * np.nan, line[[0, 0]], line + 1.0])
    groom = replace(groom, attributes={"groom_id": strand_values(np.arange(6))})
    ready = preset(groom, name)
    assert ready.groom.strand_count == 2
    assert ready.kept.tolist() == [0, 5]
    assert "4 strands without two distinct finite points were dropped" in "\n".join(ready.sentences)
    np.testing.assert_allclose(ready.points(groom.points), ready.groom.points)
    assert preset(groom.select([5]), name).groom.strand_count == 1
    for none in (groom.select([1, 2]), groom.select(np.zeros(0, dtype=int))):
        with pytest.raises(DetangledError, match="can use none of the"):
            preset(none, name)


def test_objects_in_different_units_are_said() -> None:
    line = np.array([[0.0, 0, 0], [3, -20, 2]])
    owner = strand_values(np.array([0, 1], dtype=np.int32))
    groom = Groom.from_strands([line, 0.01 * line], objects=("hair", "brows"), attributes={"object": owner})
    assert "'hair' spans 20.3 cm and 'brows' 0.203 cm" in said(groom)
    assert "different units" not in said(replace(groom, points=np.concatenate([line, 0.2 * line])))


# ---- axes and units


def test_unity_and_blender_get_metres_and_y_up(tmp_path: Path) -> None:
    groom = preset(hanging(), "unreal").groom
    for name in ("unity", "blender"):
        ready = preset(groom, name).groom
        assert (ready.up, ready.unit_cm) == ("y", 100.0)
        np.testing.assert_allclose(ready.points, hanging().points, atol=1e-12)
        formats.write(ready, tmp_path / f"{name}.abc")
        file = Written(tmp_path / f"{name}.abc")
        sample = file.curves.getValue()
        stored = np.array(sample.getPositions())
        np.testing.assert_allclose(stored, hanging().points / 100.0, atol=1e-6)
    assert preset(groom, "blender").groom.attributes.keys() == {"width"}
    assert "groom_id" in preset(groom, "blender", suffix=".usd").groom.attributes
    assert preset(groom, "blender", suffix=".usd").groom.up == "z"


def test_normals_turn_with_the_points() -> None:
    normals = strand_values(np.tile(np.array([0.0, 1.0, 0.0], dtype=np.float32), (12, 1)))
    ready = preset(replace(hanging(), attributes={"N": normals}), "unreal").groom
    assert ready.attributes["N"].values.tolist() == [[0.0, 0.0, 1.0]] * 12


def test_an_unknown_engine_and_a_suffix_it_does_not_import() -> None:
    with pytest.raises(DetangledError, match="unknown preset 'godot'"):
        preset(hanging(), "godot")
    assert "Unreal imports .abc, not .obj" in said(hanging(), suffix=".obj")


def test_a_real_groom(grooms: Callable[[str], Path], tmp_path: Path) -> None:
    groom = formats.read(grooms("eve.abc"), unit="m")
    ready = preset(groom, "unreal").groom
    assert formats.write(ready, tmp_path / "eve.abc") == []
    file = Written(tmp_path / "eve.abc")
    needed = {"groom_width", "groom_group_id", "groom_group_name", "groom_id", "groom_root_uv"}
    assert needed <= file.names
    sample = file.curves.getValue()
    positions = np.array(sample.getPositions())
    # The head is up: z runs to about 1.8 m above the ground, where y did.
    np.testing.assert_allclose(positions, z_up(groom.points), atol=2e-5)
