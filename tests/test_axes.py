"""Up axes: what a turn does to points and directions, and that the sample grooms' twins are one groom."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from detangled import formats
from detangled.axes import AXES, ROLES, Role, turn_between, turned
from detangled.errors import DetangledError, ReadError
from detangled.formats.transforms import to_world
from detangled.groom import Attribute, Groom, Scope
from detangled_cli.main import detangled

AXIS = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}


def groom_of(rng: np.random.Generator, up: str) -> Groom:
    vectors = rng.normal(size=(7, 3))
    return Groom(
        rng.normal(size=(7, 3)),
        np.array([0, 4, 7]),
        attributes={
            "N": Attribute(vectors, Scope.POINT),
            "velocities": Attribute(vectors, Scope.POINT),
            "groom_color": Attribute(vectors, Scope.POINT),
            "uv": Attribute(vectors[:2, :2], Scope.STRAND),
        },
        up=up,
    )


@pytest.mark.parametrize(("up", "wanted"), list(product(AXES, AXES)))
def test_a_turn_is_a_rotation_of_one_axis_into_the_other(up: str, wanted: str) -> None:
    rotation = turn_between(up, wanted)
    np.testing.assert_array_equal(rotation @ rotation.T, np.eye(3))
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_array_equal(rotation @ AXIS[up], AXIS[wanted])


@pytest.mark.parametrize(("up", "wanted"), list(product(AXES, AXES)))
def test_points_and_directions_turn_and_turn_back(up: str, wanted: str) -> None:
    groom = groom_of(np.random.default_rng(1), up)
    other = turned(groom, wanted)
    rotation = turn_between(up, wanted)
    assert other.up == wanted
    np.testing.assert_array_equal(other.points, groom.points @ rotation.T)
    for name in ("N", "velocities"):
        np.testing.assert_array_equal(other.attributes[name].values, groom.attributes[name].values @ rotation.T)
    for name in ("groom_color", "uv"):
        np.testing.assert_array_equal(other.attributes[name].values, groom.attributes[name].values)
    back = turned(other, up)
    np.testing.assert_array_equal(back.points, groom.points)


def test_what_is_not_finite_stays_where_it_is() -> None:
    groom = Groom(np.array([[1.0, np.nan, np.inf], [0, 1, 2]]), np.array([0, 2]), up="z")
    np.testing.assert_array_equal(turned(groom, "y").points, [[1, np.inf, np.nan], [0, 2, -1]])


def test_axes_that_are_none_are_refused(tmp_path: Path) -> None:
    groom = groom_of(np.random.default_rng(2), "y")
    with pytest.raises(DetangledError, match="'up' is no axis"):
        turned(groom, "up")
    formats.write(groom, tmp_path / "a.npz")
    with pytest.raises(ReadError, match="'Y' is no axis"):
        formats.read(tmp_path / "a.npz", up="Y")


def in_space(rng: np.random.Generator) -> dict[str, Attribute]:
    """An attribute of every name that says what it is in space, and some that only look like one."""
    attributes = {
        name: Attribute(rng.normal(size=7 if role is Role.LENGTH else (7, 3)), Scope.POINT)
        for name, role in ROLES.items()
    }
    attributes["v"] = Attribute(rng.normal(size=7), Scope.POINT)
    return {**attributes, "groom_color": Attribute(rng.random((7, 3)), Scope.POINT)}


def test_the_unit_scales_lengths_motions_and_places_alone(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    groom = Groom(rng.normal(size=(7, 3)), np.array([0, 4, 7]), attributes=in_space(rng), unit_cm=1.0)
    formats.write(groom, tmp_path / "a.npz")
    in_metres = formats.read(tmp_path / "a.npz", "m")
    scaled = {name for name, role in ROLES.items() if role in (Role.LENGTH, Role.MOTION, Role.PLACE)} - {"v"}
    assert {"width", "velocity", "rest", "Pref"} <= scaled
    for name, attribute in groom.attributes.items():
        factor = 100.0 if name in scaled else 1.0
        np.testing.assert_array_equal(in_metres.attributes[name].values, attribute.values * factor, err_msg=name)
    formats.write(in_metres, tmp_path / "b.npz")
    back = formats.read(tmp_path / "b.npz", "cm")
    for name, attribute in groom.attributes.items():
        np.testing.assert_allclose(back.attributes[name].values, attribute.values, rtol=1e-15, err_msg=name)


def test_a_transform_takes_places_with_the_points_and_lengths_with_its_scale() -> None:
    rng = np.random.default_rng(6)
    points, found = rng.normal(size=(7, 3)), in_space(rng)
    found |= {name: Attribute(points, Scope.POINT) for name, role in ROLES.items() if role is Role.PLACE}
    matrix = np.eye(4)
    matrix[:3, :3] = 2.0 * turn_between("z", "y").T
    matrix[3, :3] = [1.0, 2.0, 3.0]
    moved, after = to_world(points, found, matrix)
    np.testing.assert_allclose(moved, 2.0 * points @ turn_between("z", "y").T + [1.0, 2.0, 3.0])
    expected = {
        Role.LENGTH: lambda values: 2.0 * values,
        Role.NORMAL: lambda values: values @ matrix[:3, :3] / 2.0,
        Role.DIRECTION: lambda values: values @ matrix[:3, :3],
        Role.MOTION: lambda values: values @ matrix[:3, :3],
        Role.PLACE: lambda values: moved,
    }
    for name, role in ROLES.items():
        if name != "v":
            values = expected[role](found[name].values)
            np.testing.assert_allclose(after[name].values, values, atol=1e-12, err_msg=name)
    for name in ("v", "groom_color"):
        np.testing.assert_array_equal(after[name].values, found[name].values)


def test_whole_numbers_that_grow_become_fractions() -> None:
    width = Attribute(np.array([1, 3]), Scope.STRAND)
    _, after = to_world(np.zeros((4, 3)), {"width": width}, np.diag([1.5, 1.5, 1.5, 1.0]))
    np.testing.assert_allclose(after["width"].values, [1.5, 4.5])


@pytest.mark.parametrize("name", ["eve", "bob", "combover"])
@pytest.mark.parametrize("up", ["y", "z"])
def test_twins_are_the_same_strands_in_the_same_frame_and_unit(
    grooms: Callable[[str], Path], name: str, up: str
) -> None:
    suffixes = [".abc", ".npz"] if name == "combover" else [".abc", ".npz", ".usdc"]
    first, *others = [formats.read(grooms(name + suffix), up=up) for suffix in suffixes]
    for other in others:
        np.testing.assert_array_equal(other.points, first.points)
        np.testing.assert_array_equal(other.offsets, first.offsets)
        assert (other.up, other.unit_cm) == (first.up, first.unit_cm) == (up, 100.0)


def test_convert_turns_a_groom(tmp_path: Path) -> None:
    groom = groom_of(np.random.default_rng(3), "z")
    formats.write(groom, tmp_path / "a.npz")
    words = ["convert", str(tmp_path / "a.npz"), str(tmp_path / "b.usda"), "--up", "y"]
    result = CliRunner().invoke(detangled, words, prog_name="detangled")
    assert result.exit_code == 0, result.output
    assert "y up" in result.stderr
    found = formats.read(tmp_path / "b.usda")
    assert found.up == "y"
    np.testing.assert_allclose(found.points, turned(groom, "y").points, rtol=1e-6)


def test_a_file_that_does_not_say_its_axis_can_be_told_it(tmp_path: Path) -> None:
    groom = groom_of(np.random.default_rng(4), "z")
    formats.write(groom, tmp_path / "a.obj")
    found = formats.read(tmp_path / "a.obj", "cm", up="y", file_up="z")
    np.testing.assert_allclose(found.points, turned(groom, "y").points, rtol=1e-6)
    words = ["convert", str(tmp_path / "a.obj"), str(tmp_path / "b.obj"), "--unit", "cm", "--in-up", "z", "--up", "y"]
    assert CliRunner().invoke(detangled, words, prog_name="detangled").exit_code == 0
    np.testing.assert_allclose(formats.read(tmp_path / "b.obj", "cm").points, found.points, rtol=1e-6)
