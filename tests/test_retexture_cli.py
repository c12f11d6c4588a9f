"""The main job from end to end, in processes of its own: a few strands become a groom's texture."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from detangled.archives import read_arrays, write_arrays
from detangled.errors import ModelError
from detangled.fitted import load_texture
from detangled.formats import read, write
from detangled.geometry.arc import arc_lengths
from detangled.geometry.spline import chord_lengths, spline_slopes
from detangled.groom import Attribute, Groom, Scope
from detangled.grooming.guides import style_guides

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
COILY = EXAMPLES / "coily_strands.obj"
BOB_STRANDS = [3, 40, 77, 114, 151, 188, 225]
LENGTH_ACCURACY = 1e-3

Run = subprocess.CompletedProcess[str]


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "detangled_cli.main", *map(str, arguments)]


def run(*arguments: object, timeout: float = 240.0) -> Run:
    return subprocess.run(command(*arguments), capture_output=True, text=True, timeout=timeout, check=False)


def retexture(source: object, target: object, *options: object, texture: object = COILY) -> Run:
    return run("retexture", source, target, "--target", texture, *options)


def assert_done(done: Run) -> None:
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr


def assert_refused(done: Run, code: int, *words: str) -> None:
    """One line on stderr that says what was wrong."""
    assert done.returncode == code, done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("detangled: error: ")]
    assert len(errors) == 1, done.stderr
    for word in words:
        assert word in errors[0]
    assert "Traceback" not in done.stderr


def stored(groom: Groom) -> NDArray[np.float32]:
    """Points as the file holds them."""
    return (groom.points / groom.unit_cm).astype(np.float32)


def roots(groom: Groom) -> NDArray[np.uint32]:
    return np.ascontiguousarray(stored(groom)[groom.offsets[:-1]]).view(np.uint32)


def files_in(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seven strands of the bob, in metres, with its attributes."""
    path = tmp_path_factory.mktemp("few") / "few.abc"
    write(read(EXAMPLES / "bob.abc", unit="m").select(BOB_STRANDS), path)
    return path


@pytest.fixture(scope="module")
def many(few: Path) -> Path:
    """Enough of the bob's strands to meet the rare ones."""
    path = few.with_name("many.abc")
    write(read(EXAMPLES / "bob.abc", unit="m").select(np.arange(0, 252, 6)), path)
    return path


@pytest.fixture(scope="module")
def coily(few: Path) -> Path:
    """The main job's result on these."""
    path = few.with_name("coily.abc")
    done = retexture(few, path)
    assert_done(done)
    assert "7 strands" in done.stderr
    return path


@pytest.fixture(scope="module")
def texture(few: Path) -> Path:
    path = few.with_name("coily.texture")
    assert_done(run("fit", COILY, path))
    return path


# ---- what stays and what changes


def test_strands_roots_and_attributes_stay(few: Path, coily: Path) -> None:
    old, new = read(few), read(coily)
    assert (new.strand_count, new.unit_cm, new.up, new.objects) == (old.strand_count, old.unit_cm, old.up, old.objects)
    np.testing.assert_array_equal(roots(new), roots(old))
    assert new.attributes.keys() == old.attributes.keys() == {"uv", "width", "groom_id", "groom_group_id"}
    for name in ("uv", "groom_id", "groom_group_id"):
        assert new.attributes[name].scope is Scope.STRAND
        np.testing.assert_array_equal(new.attributes[name].values, old.attributes[name].values)
    assert new.attributes["groom_id"].values.tolist() == BOB_STRANDS
    # The old widths fall evenly from root to tip, and so do the new ones, over more points.
    assert new.attributes["width"].scope is Scope.POINT
    for s in range(new.strand_count):
        points = slice(new.offsets[s], new.offsets[s + 1])
        old_width = old.attributes["width"].values[old.offsets[s] : old.offsets[s + 1]]
        share = np.linspace(0, 1, new.point_counts[s])
        expected = np.interp(share, np.linspace(0, 1, len(old_width)), old_width)
        np.testing.assert_allclose(new.attributes["width"].values[points], expected, rtol=1e-6)


def test_each_strand_is_coily_and_a_new_one(coily: Path) -> None:
    new = read(coily)
    assert np.all(new.point_counts > 100)
    assert np.isfinite(new.points).all()
    target = read(COILY, unit="cm")
    # Coils make several centimetres of hair of one of the guide, as they do in the target.
    for groom, least in ((new, 1.5), (target, 1.5)):
        ends = groom.points[groom.offsets[1:] - 1] - groom.points[groom.offsets[:-1]]
        assert np.median(groom.polyline_lengths() / np.linalg.norm(ends, axis=1)) > least
    segments = [np.linalg.norm(np.diff(new.strand(s), axis=0), axis=1)[:100] for s in range(new.strand_count)]
    for a in range(len(segments)):
        for b in range(a):
            assert not np.allclose(segments[a], segments[b], rtol=1e-3)


def test_tips_come_level_with_the_ends_of_their_guides(many: Path, tmp_path: Path) -> None:
    assert_done(retexture(many, tmp_path / "out.abc"))
    old, new = read(many), read(tmp_path / "out.abc")
    guides = style_guides(old)
    for s in range(old.strand_count):
        guide = np.ascontiguousarray(guides.points[old.offsets[s] : old.offsets[s + 1]])
        end = spline_slopes(chord_lengths(guide), guide)[-1]
        beyond = (new.strand(s)[-1] - guide[-1]) @ end / np.linalg.norm(end)
        assert abs(beyond) < LENGTH_ACCURACY * guides.lengths[s]


def straight_groom(lengths: list[float]) -> Groom:
    """Straight strands along -y, side by side [cm]: each is its own guide."""
    return Groom.from_strands(
        [[[k, 10.0 - length * t, 0.5 * k] for t in np.linspace(0, 1, 5)] for k, length in enumerate(lengths)],
        unit_source="file",
    )


def test_lengths_on_straight_guides_are_exact(tmp_path: Path) -> None:
    lengths = [2.0, 6.0, 11.0, 25.0, 50.0]
    write(straight_groom(lengths), tmp_path / "in.npz")
    assert_done(retexture(tmp_path / "in.npz", tmp_path / "out.npz"))
    new = read(tmp_path / "out.npz")
    tips = new.points[new.offsets[1:] - 1, 1]
    np.testing.assert_allclose(10.0 - tips, lengths, rtol=LENGTH_ACCURACY)


def test_strands_can_keep_their_own_lengths(many: Path, tmp_path: Path) -> None:
    assert_done(retexture(many, tmp_path / "out.abc", "--length", "strand"))
    old, new = read(many), read(tmp_path / "out.abc")
    np.testing.assert_array_equal(roots(new), roots(old))
    reach = [np.linalg.norm(g.points[g.offsets[1:] - 1] - g.points[g.offsets[:-1]], axis=1) for g in (old, new)]
    assert np.all(reach[1] < 0.8 * reach[0])
    before, after = (arc_lengths(g.points, g.offsets) for g in (old, new))
    np.testing.assert_allclose(after, before, rtol=LENGTH_ACCURACY)


def test_fewer_points_are_warned_about(few: Path, tmp_path: Path) -> None:
    done = retexture(few, tmp_path / "out.abc", "--max-points", 64)
    assert_done(done)
    assert "warning" in done.stderr
    assert "more than 64 points" in done.stderr
    assert "--max-points" in done.stderr
    assert read(tmp_path / "out.abc").point_counts.max() == 64
    quiet = retexture(few, tmp_path / "out.abc", "--max-points", 64, "--quiet")
    assert (quiet.returncode, quiet.stderr) == (0, "")


# ---- the same bytes


def test_the_seed_decides_and_the_threads_do_not(few: Path, coily: Path, tmp_path: Path) -> None:
    for threads in (1, 2):
        assert_done(retexture(few, tmp_path / f"{threads}.abc", "--threads", threads, "--seed", 0))
        assert (tmp_path / f"{threads}.abc").read_bytes() == coily.read_bytes()
    assert_done(retexture(few, tmp_path / "other.abc", "--seed", 1))
    other, first = read(tmp_path / "other.abc"), read(coily)
    np.testing.assert_array_equal(roots(other), roots(first))
    for s in range(first.strand_count):
        # Distances within a strand, which differ for other hair and not for the same hair turned about its axis.
        near, far = (np.linalg.norm(g.strand(s)[8:100] - g.strand(s)[:92], axis=1) for g in (first, other))
        assert np.abs(far / near - 1.0).mean() > 0.05


def test_a_fitted_texture_is_as_good_as_its_strands(few: Path, coily: Path, texture: Path, tmp_path: Path) -> None:
    assert_done(retexture(few, tmp_path / "out.abc", texture=texture))
    assert (tmp_path / "out.abc").read_bytes() == coily.read_bytes()
    again = tmp_path / "again.texture"
    assert_done(run("fit", COILY, again))
    assert again.read_bytes() == texture.read_bytes()


@pytest.mark.parametrize("suffix", [".obj", ".npz"])
def test_other_formats_say_the_same(few: Path, coily: Path, tmp_path: Path, suffix: str) -> None:
    groom = read(few)
    lost = write(groom, tmp_path / f"in{suffix}")
    assert_done(retexture(tmp_path / f"in{suffix}", tmp_path / f"out{suffix}", "--unit", "m"))
    new, expected = read(tmp_path / f"out{suffix}", unit="m"), read(coily)
    np.testing.assert_array_equal(new.offsets, expected.offsets)
    # Text rounds once more than the other two.
    tolerance = 1e-7 if suffix == ".obj" else 0.0
    np.testing.assert_allclose(stored(new), stored(expected), rtol=0, atol=tolerance)
    assert bool(lost) == (suffix == ".obj")
    # Strands to learn from are read in any format too.
    write(read(COILY, unit="cm"), tmp_path / f"target{suffix}")
    done = retexture(few, tmp_path / "out.abc", "--target-unit", "cm", texture=tmp_path / f"target{suffix}")
    assert_done(done)
    assert "texture of 6 strands" in done.stderr


def test_one_file_may_be_input_and_output(few: Path, coily: Path, tmp_path: Path) -> None:
    same = tmp_path / "same.abc"
    same.write_bytes(few.read_bytes())
    assert_done(retexture(same, same))
    assert same.read_bytes() == coily.read_bytes()
    assert files_in(tmp_path) == {"same.abc"}


def test_one_target_strand_is_enough(few: Path, tmp_path: Path) -> None:
    write(read(COILY, unit="cm").select([2]), tmp_path / "one.obj")
    done = retexture(few, tmp_path / "out.abc", texture=tmp_path / "one.obj")
    assert_done(done)
    assert "texture of 1 strand:" in done.stderr
    new = read(tmp_path / "out.abc")
    np.testing.assert_array_equal(roots(new), roots(read(few)))
    assert np.isfinite(new.points).all()


# ---- refusals


def test_wrong_usage(few: Path, tmp_path: Path) -> None:
    assert_refused(retexture(few, tmp_path / "o.abc", "--method", "magic"), 2, "--method", "magic")
    assert_refused(run("retexture", few, tmp_path / "o.abc"), 2, "--target")
    assert files_in(tmp_path) == set()


def test_a_missing_output_folder_is_found_before_any_work(few: Path, tmp_path: Path) -> None:
    done = retexture(few, tmp_path / "no" / "o.abc")
    assert_refused(done, 5, "does not exist")
    assert "texture of" not in done.stderr
    assert files_in(tmp_path) == set()


def test_missing_and_unusable_inputs(few: Path, tmp_path: Path) -> None:
    out = tmp_path / "o.abc"
    assert_refused(retexture(tmp_path / "none.abc", out), 3, "none.abc", "no such file")
    assert_refused(retexture(few, out, texture=tmp_path / "none.obj"), 3, "none.obj", "no such file")
    assert_refused(retexture(few, out, texture=tmp_path / "none.texture"), 3, "none.texture", "no such file")
    useless = tmp_path / "useless.obj"
    useless.write_text("v 1 1 1\nv 1 1 1\nl 1 2\nl 1\n")
    assert_refused(retexture(few, out, texture=useless), 3, "useless.obj: none of the 2 strands")
    assert_refused(retexture(useless, out), 3, "useless.obj: none of the 2 strands")
    assert not out.exists()


def test_a_damaged_texture_is_refused(few: Path, texture: Path, tmp_path: Path) -> None:
    whole = texture.read_bytes()
    bad = tmp_path / "bad.texture"
    bad.write_bytes(whole[:5000] + bytes([whole[5000] ^ 1]) + whole[5001:])
    assert_refused(retexture(few, tmp_path / "o.abc", texture=bad), 4, "bad.texture", "damaged")
    # Anywhere at all: it is found, or it was in what nobody reads, as a date.
    expected = load_texture(texture)
    found = 0
    for at in range(0, len(whole), len(whole) // 150):
        bad.write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
        try:
            loaded = load_texture(bad)
        except ModelError:
            found += 1
        else:
            np.testing.assert_array_equal(loaded.signals, expected.signals)
            assert loaded.whitening == expected.whitening
    assert found > 140
    for kept in (0, 10, len(whole) // 2, len(whole) - 10):
        bad.write_bytes(whole[:kept])
        with pytest.raises(ModelError, match=r"bad\.texture"):
            load_texture(bad)


@pytest.mark.parametrize("change", [{"version": 1}, {"method": "finetune"}])
def test_a_texture_of_another_kind_is_refused(
    few: Path, texture: Path, tmp_path: Path, change: dict[str, object]
) -> None:
    arrays = read_arrays(texture)
    manifest = json.loads(str(arrays["manifest"][0])) | change
    write_arrays(tmp_path / "other.texture", arrays | {"manifest": np.array([json.dumps(manifest)])})
    assert_refused(retexture(few, tmp_path / "o.abc", texture=tmp_path / "other.texture"), 4, "other.texture")


# ---- strands that nobody wants


def odd_groom() -> tuple[Groom, list[int]]:
    """Strands of many kinds, in metres, and which of them cannot be used."""
    line = np.stack([np.zeros(9), np.linspace(0, -0.2, 9), np.zeros(9)], axis=1)
    aside = np.array([0.01, 0, 0])
    nan, infinite = line.copy(), line.copy()
    nan[4, 1] = np.nan
    infinite[8, 2] = np.inf
    strands = [
        line,
        nan,
        np.zeros((0, 3)),
        np.array([[0.01, 0.02, 0.03]]),
        np.tile([0.1, 0.2, 0.3], (6, 1)),
        infinite,
        np.repeat(line, 3, axis=0) + aside,  # doubled points
        np.concatenate([line, line[-2::-1]]) + 2 * aside,  # folds back on itself
        line[[0, -1]] + 3 * aside,  # two points
        line[[0, -1, 0, -1]] + 4 * aside,  # there and back again
        line + 5 * aside,
        np.zeros((0, 3)),
    ]
    count = len(strands)
    ids = Attribute(np.arange(100, 100 + count, dtype=np.int32), Scope.STRAND)
    widths = Attribute(np.linspace(1e-2, 2e-2, sum(map(len, strands))).astype(np.float32), Scope.POINT)
    groom = Groom.from_strands([100.0 * s for s in strands], attributes={"groom_id": ids, "width": widths})
    return replace(groom, unit_cm=100.0, unit_source="file"), [1, 2, 3, 4, 5, 11]


@pytest.mark.parametrize("length", ["guide", "strand"])
@pytest.mark.parametrize("suffix", [".npz", ".abc"])
def test_bad_strands_pass_through_unchanged(tmp_path: Path, length: str, suffix: str) -> None:
    groom, bad = odd_groom()
    write(groom, tmp_path / f"in{suffix}")
    done = retexture(tmp_path / f"in{suffix}", tmp_path / f"out{suffix}", "--unit", "m", "--length", length)
    assert_done(done)
    assert "6 strands cannot be used" in done.stderr
    assert "1, 2, 3, 4, 5, ..." in done.stderr
    old, new = (read(tmp_path / f"{name}{suffix}", unit="m") for name in ("in", "out"))
    assert new.strand_count == old.strand_count == 12
    np.testing.assert_array_equal(new.attributes["groom_id"].values, np.arange(100, 112))
    assert len(new.attributes["width"].values) == len(new.points)
    for s in range(12):
        before, after = (stored(g)[g.offsets[s] : g.offsets[s + 1]] for g in (old, new))
        if s in bad:
            np.testing.assert_array_equal(after.view(np.uint32), before.view(np.uint32))
        else:
            np.testing.assert_array_equal(after[0].view(np.uint32), before[0].view(np.uint32))
            assert len(after) > len(before)
            assert np.isfinite(after).all()
            assert np.linalg.norm(after, axis=1).max() < 1.0


def test_a_strand_of_many_points_is_retextured(tmp_path: Path) -> None:
    t = np.linspace(0, 1, 100_000)
    angle = 2 * np.pi * 40 * t
    helix = np.stack([np.cos(angle), -40.0 * t, np.sin(angle)], axis=1)
    groom = Groom.from_strands([helix, helix[::10_000] + np.array([5.0, 0, 0])], unit_source="file")
    write(groom, tmp_path / "in.npz")
    done = retexture(tmp_path / "in.npz", tmp_path / "out.npz")
    assert_done(done)
    new = read(tmp_path / "out.npz")
    assert new.point_counts[0] >= 100_000
    np.testing.assert_array_equal(roots(new), roots(groom))


# ---- interrupted


@pytest.fixture
def started() -> object:
    """Start a verb, to be interrupted; what is left running at the end of the test is ended."""
    running: list[subprocess.Popen[str]] = []

    def start(*arguments: object) -> subprocess.Popen[str]:
        process = subprocess.Popen(command(*arguments), stderr=subprocess.PIPE, text=True)
        running.append(process)
        return process

    yield start
    for process in running:
        process.kill()
        process.communicate()


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_interrupted_it_leaves_the_old_file_whole(
    started: Callable[..., subprocess.Popen[str]], coily: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.abc"
    out.write_bytes(coily.read_bytes())
    # Many steps, so that it is still at work when it is told.
    process = started("retexture", EXAMPLES / "bob.abc", out, "--target", COILY, "--steps", 200)
    assert process.stderr is not None
    for line in process.stderr:
        if "texture of" in line:
            break
    time.sleep(2.0)
    assert process.poll() is None
    os.kill(process.pid, signal.SIGINT)
    _, stderr = process.communicate(timeout=30.0)
    assert process.returncode == 130
    assert "interrupted; nothing was written" in stderr
    assert "Traceback" not in stderr
    assert out.read_bytes() == coily.read_bytes()
    assert files_in(tmp_path) == {"out.abc"}
