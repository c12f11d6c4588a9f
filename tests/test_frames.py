"""Grooms that move, in Alembic files: read and written a frame at a time."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import imath
import numpy as np
import pytest
from alembic3d import Abc, AbcGeom
from click.testing import CliRunner
from numpy.typing import NDArray

from detangled import formats
from detangled.errors import ReadError, WriteError
from detangled.formats.frames import Frames, read_frames, write_frames
from detangled.groom import Attribute, Groom, Scope
from detangled_cli.main import detangled
from test_formats_abc import BSPLINE, CUBIC, curves_sample

SAME = 1e-5  # float32 of some tens of centimetres


def moving(frames: int = 5, strands: int = 7) -> tuple[Groom, list[NDArray[np.float64]]]:
    rng = np.random.default_rng(4)
    groom = Groom.from_strands(
        [np.cumsum(rng.normal(size=(n, 3)), axis=0) for n in rng.integers(2, 9, strands)],
        attributes={"groom_id": Attribute(np.arange(strands, dtype=np.int32), Scope.STRAND)},
        unit_cm=100.0,
    )
    return groom, [groom.points + 0.3 * f + 0.05 * rng.normal(size=groom.points.shape) for f in range(frames)]


@pytest.mark.parametrize("times", [np.arange(5) / 24.0, 1.0 + np.arange(5) / 30.0, np.array([0.0, 0.1, 0.4, 0.5, 2.0])])
def test_frames_and_times_come_back(tmp_path: Path, times: NDArray[np.float64]) -> None:
    groom, points = moving()
    assert write_frames(groom, times, points, tmp_path / "a.abc") == []
    frames = read_frames(tmp_path / "a.abc", unit="m")
    assert len(frames) == 5
    np.testing.assert_allclose(frames.times, times, atol=1e-12)
    assert not any("time samples" in note for note in frames.groom.notes)
    assert frames.groom.attributes["groom_id"].values.tolist() == list(range(7))
    for index in (4, 0, 2, 1, 3):
        np.testing.assert_allclose(frames.points(index), points[index], atol=SAME)
    np.testing.assert_array_equal(frames.points(0), frames.groom.points)
    first = formats.read(tmp_path / "a.abc", unit="m")
    np.testing.assert_array_equal(first.points, frames.groom.points)
    assert "5 time samples, only the first is kept" in first.notes


@pytest.mark.parametrize("pattern", ["AABBA", "AAAAA", "ABBBB", "AAAAB", "ABABA"])
def test_frames_that_repeat(tmp_path: Path, pattern: str) -> None:
    # The library stores samples that equal the one before in ways of their own; the check must know them all.
    groom, points = moving()
    order = [points["AB".index(letter)] for letter in pattern]
    write_frames(groom, np.arange(5.0), order, tmp_path / "a.abc")
    for frame, expected in zip(read_frames(tmp_path / "a.abc", unit="m"), order, strict=True):
        np.testing.assert_allclose(frame, expected, atol=SAME)


def test_several_objects_move_together(tmp_path: Path) -> None:
    groom, points = moving()
    owner = Attribute(np.array([0, 1, 0, 1, 1, 0, 0], dtype=np.int32), Scope.STRAND)
    groom = Groom(groom.points, groom.offsets, {"object": owner}, objects=("hair", "brows"))
    write_frames(groom, np.arange(5.0), points, tmp_path / "a.abc")
    frames = read_frames(tmp_path / "a.abc", unit="cm")
    order = np.argsort(owner.values, kind="stable")
    expected = Groom(points[3], groom.offsets).select(order).points
    np.testing.assert_allclose(frames.points(3), expected, atol=SAME)


def test_transforms_that_move_are_followed(tmp_path: Path) -> None:
    def build() -> None:
        archive = Abc.OArchive(str(tmp_path / "a.abc"))
        transform = AbcGeom.OXform(archive.getTop(), "head")
        for turn in range(4):
            sample = AbcGeom.XformSample()
            sample.setTranslation(imath.V3d(0.0, float(turn), 0.0))
            transform.getSchema().set(sample)
        AbcGeom.OCurves(transform, "hair").getSchema().set(curves_sample(np.eye(3), [3]))

    build()
    frames = read_frames(tmp_path / "a.abc", unit="cm")
    assert len(frames) == 4
    for index, frame in enumerate(frames):
        np.testing.assert_allclose(frame, np.eye(3) + np.array([0, index, 0]))


def test_smooth_curves_are_evaluated_in_every_frame(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    controls = rng.normal(size=(3, 8, 3)).astype(np.float32)

    def build() -> None:
        archive = Abc.OArchive(str(tmp_path / "a.abc"))
        schema = AbcGeom.OCurves(archive.getTop(), "hair").getSchema()
        for frame in controls:
            schema.set(curves_sample(frame, [8], kind=CUBIC, basis=BSPLINE))

    build()
    frames = read_frames(tmp_path / "a.abc", unit="cm")
    for index, frame in enumerate(frames):
        one = tmp_path / f"{index}.abc"

        def alone(one: Path = one, index: int = index) -> None:
            archive = Abc.OArchive(str(one))
            schema = AbcGeom.OCurves(archive.getTop(), "hair").getSchema()
            schema.set(curves_sample(controls[index], [8], kind=CUBIC, basis=BSPLINE))

        alone()
        np.testing.assert_array_equal(frame, formats.read(one, unit="cm").points)


@pytest.mark.parametrize(
    ("counts", "words"),
    [([2, 2, 2], "frame 1 .* has 3 strands, the first frame 2"), ([2, 4], "has 2 points on strand 0, .* frame 3")],
)
def test_strands_that_change_are_refused(tmp_path: Path, counts: list[int], words: str) -> None:
    def build() -> None:
        archive = Abc.OArchive(str(tmp_path / "a.abc"))
        schema = AbcGeom.OCurves(archive.getTop(), "hair").getSchema()
        schema.set(curves_sample(np.zeros((6, 3)), [3, 3]))
        schema.set(curves_sample(np.zeros((6, 3)), counts))

    build()
    frames = read_frames(tmp_path / "a.abc", unit="cm")
    with pytest.raises(ReadError, match=words):
        frames.points(1)


def test_what_stands_still_has_one_frame(tmp_path: Path) -> None:
    groom, _ = moving()
    for name in ("a.abc", "a.obj", "a.npz"):
        formats.write(groom, tmp_path / name)
        frames = read_frames(tmp_path / name, unit="m")
        assert len(frames) == 1
        np.testing.assert_allclose(next(iter(frames)), groom.points, atol=SAME)


def test_damage_in_a_later_frame_is_found_before_the_library_sees_it(tmp_path: Path) -> None:
    groom, points = moving(strands=40)
    write_frames(groom, np.arange(5.0), points, tmp_path / "a.abc")
    content = (tmp_path / "a.abc").read_bytes()
    stored = (points[3] / 100.0).astype(np.float32).tobytes()
    at = content.index(stored)
    # Eight bytes of size and sixteen of a key stand before it.
    broken = content[: at - 24] + (2**40).to_bytes(8, "little") + content[at - 16 :]
    (tmp_path / "a.abc").write_bytes(broken)
    formats.read(tmp_path / "a.abc", unit="m")
    with pytest.raises(ReadError, match="damaged"):
        read_frames(tmp_path / "a.abc", unit="m")


def test_frames_that_do_not_fit_are_refused_and_nothing_is_left(tmp_path: Path) -> None:
    groom, points = moving()
    for times, frames, words in (
        ([0.0, 1.0], points, "more frames than the 2 times"),
        (np.arange(9.0), points, "5 frames for 9 times"),
        ([0.0, 1.0], [points[0], points[1][:-1]], "frame 1 has points"),
        ([1.0, 1.0], points[:2], "increase"),
        ([], [], "increase"),
    ):
        with pytest.raises(WriteError, match=words):
            write_frames(groom, times, frames, tmp_path / "a.abc")
    with pytest.raises(WriteError, match="hold no frames"):
        write_frames(groom, [0.0], points[:1], tmp_path / "a.obj")
    assert list(tmp_path.iterdir()) == []


def test_memory_does_not_grow_with_frames(tmp_path: Path) -> None:
    strands, points = 400, 50
    line = np.linspace([0.0, 0, 0], [0, -20, 0], points)
    groom = Groom.from_strands([line + np.array([k, 0.0, 0.0]) for k in range(strands)])
    size = groom.points.nbytes

    def sway(frames: int) -> Iterator[NDArray[np.float64]]:
        return (groom.points + 0.1 * frame for frame in range(frames))

    def peak(frames: int) -> float:
        path = tmp_path / f"{frames}.abc"
        tracemalloc.start()
        write_frames(groom, np.arange(frames) / 24.0, sway(frames), path)
        total = sum(float(frame.sum()) for frame in read_frames(path, unit="cm"))
        assert np.isfinite(total)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most / size

    assert peak(40) < peak(4) + 2.0


def test_velocities_of_the_first_frame_are_not_said_of_others(tmp_path: Path) -> None:
    groom, points = moving()
    velocities = Attribute(np.zeros(groom.points.shape, dtype=np.float32), Scope.POINT)
    groom = Groom(groom.points, groom.offsets, {"velocities": velocities})
    (said,) = write_frames(groom, np.arange(5.0), points, tmp_path / "a.abc")
    assert "'velocities' was not kept" in said


def test_convert_keeps_frames(tmp_path: Path) -> None:
    groom, points = moving()
    write_frames(groom, np.arange(5) / 24.0, points, tmp_path / "a.abc")

    def run(*arguments: Any) -> Any:
        done = CliRunner().invoke(detangled, ["convert", *map(str, arguments), "--unit", "m"])
        assert done.exit_code == 0, done.stderr
        return done.stderr

    assert "5 frames, in cm" in run(tmp_path / "a.abc", tmp_path / "b.abc", "--preset", "unreal")
    back = read_frames(tmp_path / "b.abc", unit="cm")
    np.testing.assert_allclose(back.times, np.arange(5) / 24.0, atol=1e-12)
    turned = np.stack([points[3][:, 0], -points[3][:, 2], points[3][:, 1]], axis=1)
    np.testing.assert_allclose(back.points(3), turned, atol=SAME)
    run(tmp_path / "a.abc", tmp_path / "c.abc", "--out-unit", "mm")
    np.testing.assert_allclose(read_frames(tmp_path / "c.abc", unit="mm").points(4), points[4], atol=SAME)
    assert "5 frames, only the first is kept" in run(tmp_path / "a.abc", tmp_path / "c.obj")


def test_frames_are_asked_for_one_by_one() -> None:
    groom, points = moving()
    asked: list[int] = []

    def give(index: int) -> NDArray[np.float64]:
        asked.append(index)
        return points[index]

    frames = Frames(groom, np.arange(5.0), give).mapped(groom, lambda index, now: now + index)
    assert asked == []
    np.testing.assert_array_equal(frames.points(2), points[2] + 2)
    assert asked == [2]
