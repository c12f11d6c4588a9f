"""Framing and turning: strays, far places, grooms apart, and a whole turn with one camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from detangled.errors import WriteError
from detangled.groom import Groom
from detangled.view import animation
from detangled.view.animation import check_movie_target, save_movie
from detangled.view.camera import view_turn
from detangled.view.picture import SEPARATOR_PX, Style, render, turntable
from detangled.view.stage import set_up

SIZE = (72, 72)


def tuft(strands: int = 40, seed: int = 0, move: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Groom:
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(strands, 12, 3)) * 0.3 + [0.0, -0.6, 0.0]
    return Groom.from_strands(rng.uniform(-4, 4, (strands, 1, 3)) + np.cumsum(steps, axis=1) + move)


def strands_of(groom: Groom) -> list[np.ndarray]:
    return [groom.strand(s) for s in range(groom.strand_count)]


@pytest.mark.parametrize("strays", [1, 2])
def test_strays_do_not_change_the_frame_and_are_told(strays: int) -> None:
    groom = tuft()
    far = [[[5000.0 * k, 0, 0], [5000.0 * k, 1, 0]] for k in range(1, strays + 1)]
    plain, stray = render([groom], SIZE), render([Groom.from_strands([*strands_of(groom), *far])], SIZE)
    np.testing.assert_array_equal(stray.pixels, plain.pixels)
    assert not plain.notes
    assert f"{strays} strands reach far beyond" in stray.notes[0]


def test_a_stray_that_comes_back_is_drawn_where_it_is_in_the_picture() -> None:
    groom = tuft()
    through = [[-4000.0, 0.0, 8.0], [4000.0, 0.0, 8.0]]
    plain, stray = render([groom], SIZE), render([Groom.from_strands([*strands_of(groom), through])], SIZE)
    assert stray.camera == plain.camera
    assert (stray.pixels != plain.pixels).any(axis=(0, 2)).all(), "from side to side"


def test_long_hair_among_short_is_no_stray() -> None:
    groom = tuft()
    long = [[[0.0, 0.0, 0.0], [0.0, -20.0, 0.0]]] * 2
    stage = set_up([Groom.from_strands([*strands_of(groom), *long])])
    assert not stage.notes
    assert stage.boxes[0].low[1] == pytest.approx(-20.0)


@pytest.mark.parametrize("far", [(1e5, 0.0, 0.0), (-3e8, 2e8, 1e7)])
def test_far_from_the_origin_a_groom_looks_the_same(far: tuple[float, float, float]) -> None:
    near, away = render([tuft()], SIZE, "34"), render([tuft(move=far)], SIZE, "34")
    assert np.abs(near.pixels.astype(int) - away.pixels).mean() < 0.2
    assert away.strand_width == pytest.approx(near.strand_width, rel=1e-6)


def test_before_and_after_are_not_moved_against_each_other() -> None:
    before, after = tuft(), tuft(seed=5, move=(2.0, 0.0, 0.0))
    stage = set_up([before, after])
    np.testing.assert_array_equal(stage.pivots[0], stage.pivots[1])
    assert not stage.notes


def test_grooms_that_lie_apart_are_centred_each_at_one_scale() -> None:
    picture = render([tuft(), tuft(move=(150.0, 40.0, 0.0))], SIZE)
    left, right = picture.pixels[:, : SIZE[0]], picture.pixels[:, SIZE[0] + SEPARATOR_PX :]
    assert np.abs(left.astype(int) - right).mean() < 0.2
    assert "far apart" in picture.notes[0]


def test_zoom_enlarges_the_middle() -> None:
    usual, near = render([tuft()], SIZE), render([tuft()], SIZE, style=Style(zoom=3.0))
    assert near.camera.scale == pytest.approx(3.0 * usual.camera.scale)
    assert near.camera.centre == usual.camera.centre


# --- a whole turn ---


def test_a_turn_passes_the_views_and_keeps_its_camera() -> None:
    for view, degrees in (("side", 90.0), ("back", 180.0)):
        np.testing.assert_allclose(view_turn("front", degrees), view_turn(view), atol=1e-12)
    groom = tuft()
    frames = list(turntable([groom], 4, SIZE, "front"))
    stage = set_up([groom])
    assert len({(frame.camera.scale, frame.camera.nearness, frame.strand_width) for frame in frames}) == 1
    for k, frame in enumerate(frames):
        turn = view_turn("front", 90.0 * k)
        pivot = frame.camera.project((turn @ stage.pivots[0])[None])[0]
        assert pivot == pytest.approx(frames[0].camera.project(stage.pivots[0][None])[0], abs=1e-6), "the axis stands"
        pixels = frame.camera.project(groom.points @ turn.T)
        assert pixels.min() >= 0
        assert pixels.max() <= SIZE[0]
    assert (frames[0].pixels != frames[1].pixels).any()


@pytest.mark.parametrize("name", ["turn.gif", "turn.webp", "turn.apng"])
def test_a_turn_is_one_file_that_plays_in_a_loop(tmp_path: Path, name: str) -> None:
    frames = list(turntable([tuft()], 5, SIZE))
    assert save_movie(iter(frames), tmp_path / name, 5) == [tmp_path / name]
    with Image.open(tmp_path / name) as movie:
        assert movie.n_frames == 5
        assert movie.info["loop"] == 0
        for k in (0, 3):
            movie.seek(k)
            shown = np.asarray(movie.convert("RGB")).astype(int)
            assert np.abs(shown - frames[k].pixels).mean() < 6
            assert movie.info["duration"] == pytest.approx(1200, abs=1)


def test_a_turn_is_numbered_pictures(tmp_path: Path) -> None:
    frames = list(turntable([tuft()], 3, SIZE))
    written = save_movie(iter(frames), tmp_path / "turn.png", 3)
    assert [path.name for path in written] == ["turn_0001.png", "turn_0002.png", "turn_0003.png"]
    assert sorted(tmp_path.iterdir()) == written
    for path, frame in zip(written, frames, strict=True):
        np.testing.assert_array_equal(np.asarray(Image.open(path)), frame.pixels)


def test_a_turn_that_fails_leaves_the_old_file(tmp_path: Path) -> None:
    (tmp_path / "turn.gif").write_bytes(b"old")

    def failing():  # type: ignore[no-untyped-def]
        yield from turntable([tuft()], 2, SIZE)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save_movie(failing(), tmp_path / "turn.gif", 3)
    assert (tmp_path / "turn.gif").read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["turn.gif"]


@pytest.mark.parametrize("suffix", [".gif", ".webp", ".apng"])
def test_a_turn_that_takes_too_much_memory_is_refused_after_a_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    monkeypatch.setattr(animation, "MOST_BYTES", 3 * SIZE[0] * SIZE[1] * 4)
    assert save_movie(turntable([tuft()], 4, SIZE), tmp_path / f"four{suffix}", 4)
    turn = turntable([tuft()], 5, SIZE)
    with pytest.raises(WriteError, match=r"5 frames of 72 x 72 pixels .* numbered \.png files"):
        save_movie(turn, tmp_path / f"five{suffix}", 5)
    assert len(list(turn)) == 4, "no further frame was drawn"
    assert [path.name for path in tmp_path.iterdir()] == [f"four{suffix}"]
    assert len(save_movie(turntable([tuft()], 5, SIZE), tmp_path / "five.png", 5)) == 5


def test_turns_that_cannot_be_written_are_refused_before_they_are_drawn(tmp_path: Path) -> None:
    with pytest.raises(WriteError, match=r"\.gif, \.webp, \.apng, or for numbered frames in \.png"):
        check_movie_target(tmp_path / "turn.mp4")
    with pytest.raises(WriteError, match="does not exist"):
        check_movie_target(tmp_path / "nowhere" / "turn.gif")
