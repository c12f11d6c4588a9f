"""Pictures: where strands land, what hides what, and that the same groom always gives the same bytes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image, ImageDraw

from detangled.errors import DetangledError, ReadError, WriteError
from detangled.groom import Groom
from detangled.kernels import set_threads
from detangled.view import picture as picture_module
from detangled.view.camera import VIEWS, frame, view_rotation
from detangled.view.curves import drawable, lens, trace
from detangled.view.lettering import caption
from detangled.view.lighting import BLOCKING, KEY, light_grid
from detangled.view.picture import Picture, render, save
from detangled.view.rasteriser import BAND_ROWS, NARROWEST_PX, SAMPLES, TILE_REFRESH, background, draw
from detangled.view.shading import Look, tints
from detangled_cli import render as render_verb


def helix(radius: float = 1.0, wavelength: float = 1.5, turns: float = 6.0, per_turn: float = 4.4) -> np.ndarray:
    n = int(turns * per_turn) + 1
    t = np.arange(n) / per_turn
    return np.stack([radius * np.cos(2 * np.pi * t), -wavelength * t, radius * np.sin(2 * np.pi * t)], axis=1)  # (n, 3)


def tuft(strands: int = 60, seed: int = 0, up: str = "y") -> Groom:
    rng = np.random.default_rng(seed)
    made = [helix(rng.uniform(0.3, 0.8), 1.0, rng.uniform(2, 6)) + rng.uniform(-4, 4, 3) for _ in range(strands)]
    return Groom.from_strands(made, up=up)


def covered(pixels: np.ndarray) -> np.ndarray:
    """Where a picture differs from its background, which is the same along a row; (height, width) bool."""
    return np.abs(pixels.astype(int) - pixels[:, :1].astype(int)).max(axis=2) > 6


# --- where strands land ---


def test_a_vertical_strand_covers_the_columns_of_its_width() -> None:
    groom = Groom.from_strands(
        [[[0.0, y, 0.0] for y in np.linspace(-5, 5, 7)], [[-5, 0, 0], [-5, 0.1, 0]], [[5, 0, 0], [5, 0.1, 0]]]
    )
    curves = drawable(groom, view_rotation("front", "y"))
    camera = frame([curves.points], (200, 200), perspective=False)
    width = 0.4
    grid = light_grid(curves, width, 10.0)
    seen = covered(draw(curves, camera, grid, width, Look()))
    row = np.flatnonzero(seen[camera.height // 4])
    centre = camera.project(np.array([[0.0, 2.5, 0.0]]))[0, 0]
    assert row.min() == pytest.approx(centre - 0.5 * width * camera.scale, abs=1.0)
    assert row.max() + 1 == pytest.approx(centre + 0.5 * width * camera.scale, abs=1.0)
    column = np.flatnonzero(seen[:, 100])
    ends = camera.project(np.array([[0.0, 5.0, 0.0], [0.0, -5.0, 0.0]]))[:, 1]
    assert column.min() == pytest.approx(ends[0] - 0.5 * width * camera.scale, abs=1.0)
    assert column.max() + 1 == pytest.approx(ends[1] + 0.5 * width * camera.scale, abs=1.0)


def test_coverage_at_a_strands_edge_is_its_share_of_the_pixel() -> None:
    groom = Groom.from_strands([[[0.0, -5.0, 0.0], [0.0, 5.0, 0.0]]])
    curves = drawable(groom, view_rotation("front", "y"))
    camera = frame([curves.points], (120, 120), perspective=False)
    look = Look(hair=(0.0, 0.0, 0.0), variation=0.0)
    width = 5.0 / camera.scale  # pixels 57.5 to 62.5
    pixels = draw(curves, camera, light_grid(curves, width, 10.0), width, look)[60, :, 1] / 255.0
    linear = ((pixels + 0.055) / 1.055) ** 2.4
    behind = background(camera, look)[60, 0, 1]
    assert np.round((behind - linear[56:64]) / behind * SAMPLES) == pytest.approx([0, 1, 3, 3, 3, 3, 1, 0], abs=1.01)
    assert np.sum(1 - linear / behind) == pytest.approx(5.0, abs=0.7)


@pytest.mark.parametrize("nearer", [0, 1])
def test_the_nearer_strand_hides_the_farther(nearer: int) -> None:
    depths = (0.5, -0.5) if nearer == 0 else (-0.5, 0.5)
    across = [[-5.0, 0.0, depths[0]], [5.0, 0.0, depths[0]]]
    upright = [[0.0, -5.0, depths[1]], [0.0, 5.0, depths[1]]]
    curves = drawable(Groom.from_strands([across, upright]), view_rotation("front", "y"))
    camera = frame([curves.points], (100, 100))
    grid = light_grid(curves, 0.5, 10.0)
    both = draw(curves, camera, grid, 0.5, Look())
    alone = drawable(Groom.from_strands([across if nearer == 0 else upright]), view_rotation("front", "y"))
    if nearer == 1:
        alone = type(alone)(alone.points, alone.offsets, np.array([1]), alone.low, alone.high)
    np.testing.assert_array_equal(both[49:51, 49:51], draw(alone, camera, grid, 0.5, Look())[49:51, 49:51])


def test_hidden_segments_that_are_passed_over_change_nothing() -> None:
    """A wall of strands, drawn first or last, and behind it more than a band draws between updates."""
    n = 500
    y = np.linspace(-5, 5, n)
    places = np.linspace(-5, 5, 150)
    wall = [np.stack([np.full(n, x), y, np.full(n, 2.0)], axis=1) for x in places]
    behind = [np.stack([np.full(n, x), y, np.sin(7 * y) - 2.0], axis=1) for x in 0.9 * places]
    bands = 96 / BAND_ROWS
    assert 150 * n / bands > 2 * TILE_REFRESH
    front = drawable(Groom.from_strands([*wall, *behind]), view_rotation("front", "y"))
    back = drawable(Groom.from_strands([*behind, *wall]), view_rotation("front", "y"))
    back = type(back)(back.points, back.offsets, np.roll(front.ids, -150), back.low, back.high)
    camera = frame([front.points], (96, 96))
    grid = light_grid(front, 0.12, 10.0)
    np.testing.assert_array_equal(draw(front, camera, grid, 0.12, Look()), draw(back, camera, grid, 0.12, Look()))


@pytest.mark.parametrize("perspective", [True, False])
@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_every_point_is_framed_and_the_frame_is_tight(view: str, up: str, perspective: bool) -> None:
    points = np.random.default_rng(1).normal(size=(500, 3)) * [3.0, 5.0, 2.0] + [40.0, -7.0, 160.0]
    turned = points @ view_rotation(view, up).T
    camera = frame([turned[:200], turned[200:]], (320, 200), perspective=perspective, foot=20)
    pixels = camera.project(turned)
    margin = 0.06 * 200
    assert (pixels >= margin - 1e-6).all()
    assert (pixels <= np.array([320, 180]) - margin + 1e-6).all()
    gaps = [pixels[:, 0].min(), 320 - pixels[:, 0].max(), pixels[:, 1].min(), 180 - pixels[:, 1].max()]
    assert min(gaps) == pytest.approx(margin, abs=1e-6)


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_views_are_rotations_that_keep_up_up(up: str) -> None:
    axis = np.eye(3)["xyz".index(up)]
    for view in VIEWS:
        rotation = view_rotation(view, up)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        seen = rotation @ axis
        assert seen[0] == pytest.approx(0.0, abs=1e-12)
        assert seen[2 if view == "top" else 1] > 0.9


def test_a_groom_looks_the_same_with_y_up_and_with_z_up() -> None:
    groom = tuft(12)
    z_up = Groom(groom.points[:, [0, 2, 1]] * [1.0, -1.0, 1.0], groom.offsets, up="z")
    np.testing.assert_array_equal(render([groom], (64, 64), "34").pixels, render([z_up], (64, 64), "34").pixels)


# --- smooth strands ---


def test_a_coarse_helix_is_smooth_in_a_close_up() -> None:
    coarse = drawable(Groom.from_strands([helix()]), np.eye(3))
    camera = frame([coarse.points], (1024, 1024))
    vertices, _ = trace(coarse, lens(camera, SAMPLES), SAMPLES)
    steps = np.diff(camera.project(vertices), axis=0)
    angle = np.arctan2(steps[:, 1], steps[:, 0])
    turned = np.abs((np.diff(angle) + np.pi) % (2 * np.pi) - np.pi)
    raw = np.diff(camera.project(coarse.points), axis=0)
    assert len(vertices) > 5 * len(coarse.points)
    assert np.median(np.linalg.norm(steps, axis=1)) < 0.2 * np.median(np.linalg.norm(raw, axis=1))
    assert np.median(turned) < np.radians(12)
    # The curve passes through the points and between them keeps near the helix; chords cut in to 0.76 R.
    for point in coarse.points:
        assert np.linalg.norm(vertices - point, axis=1).min() < 1e-5
    inner = (vertices[:, 1] < -1.5) & (vertices[:, 1] > -7.5)
    assert np.hypot(vertices[inner, 0], vertices[inner, 2]).min() > 0.88


def test_uneven_points_give_no_loops() -> None:
    """Uniform Catmull-Rom curves overshoot here; centripetal ones do not."""
    points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.01, 0.02, 0.0], [1.0, 4.0, 0.0], [0.0, 4.1, 0.0]]
    curves = drawable(Groom.from_strands([points]), np.eye(3))
    vertices, _ = trace(curves, lens(frame([curves.points], (1024, 1024)), SAMPLES), SAMPLES)
    assert vertices[:, 0].max() < 1.3
    assert vertices[:, 1].min() > -0.1


# --- what cannot be drawn ---


def test_bad_points_and_short_strands_are_left_out() -> None:
    good = helix()
    holed = good.copy()
    holed[5] = np.nan
    holed[9, 1] = np.inf
    strands = [
        good,
        [],
        [[0, 0, 0]],
        [[np.nan] * 3, [1, 1, 1]],
        holed,
        [[2, 2, 2]] * 4,
        np.repeat(good[:3], 2, axis=0),
    ]
    curves = drawable(Groom.from_strands(strands), np.eye(3))
    assert curves.ids.tolist() == [0, 4, 6]
    assert np.diff(curves.offsets).tolist() == [len(good), len(good) - 2, 3]
    np.testing.assert_array_equal(curves.points[: len(good)], good.astype(np.float32))
    np.testing.assert_array_equal(curves.low, curves.points.min(axis=0))
    np.testing.assert_array_equal(curves.high, curves.points.max(axis=0))


def test_bad_strands_do_not_change_the_picture_of_the_rest() -> None:
    groom = tuft(10)
    strands = [groom.strand(s) for s in range(10)]
    bad = [[[np.nan] * 3, [np.inf] * 3], [], [[1e30, 0, 0], [0, 1e300, 0]]]
    pixels = render([groom], (64, 64)).pixels
    np.testing.assert_array_equal(render([Groom.from_strands([*strands, *bad])], (64, 64)).pixels, pixels)


@pytest.mark.parametrize(
    "strands", [[], [[[0, 0, 0]]], [[[np.nan] * 3] * 5], [[[1, 2, 3]] * 9], [[[0, 0, 0], [1e30, 0, 0]]]]
)
def test_nothing_to_draw_is_a_read_error(strands: list) -> None:
    with pytest.raises(ReadError, match=r"groom 2 has no strand of two .* within 10 km"):
        render([tuft(2), Groom.from_strands(strands)], (64, 64))


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(DetangledError, match="captions"):
        render([tuft(2)], (64, 64), captions=["a", "b"])
    with pytest.raises(DetangledError, match="unknown view 'below'"):
        render([tuft(2)], (64, 64), "below")
    with pytest.raises(DetangledError, match="too small"):
        render([tuft(2)], (2, 2))
    with pytest.raises(DetangledError, match="no groom"):
        render([])


# --- the same picture every time ---


def test_threads_do_not_change_a_byte() -> None:
    before = numba.get_num_threads()
    grooms = [tuft(80, seed=3)]
    try:
        set_threads(1)
        one = render(grooms, (150, 130), "34")
        set_threads(2)
        two = render(grooms, (150, 130), "34")
    finally:
        set_threads(before)
    np.testing.assert_array_equal(one.pixels, two.pixels)


def test_two_panels_of_one_groom_are_identical() -> None:
    groom = tuft(40)
    picture = render([groom, groom], (120, 100), captions=["as it is", "as it is"])
    assert picture.pixels.shape == (100, 2 * 120 + picture_module.SEPARATOR_PX, 3)
    np.testing.assert_array_equal(picture.pixels[:, :120], picture.pixels[:, -120:])
    assert covered(picture.pixels[:, :120])[-20:].any(), "the caption"


def test_a_caption_of_a_book_is_shortened_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    measured = []
    length = ImageDraw.ImageDraw.textlength

    def counted(pen: ImageDraw.ImageDraw, text: str, **more: Any) -> float:
        measured.append(len(text))
        return length(pen, text, **more)

    monkeypatch.setattr(ImageDraw.ImageDraw, "textlength", counted)
    image = Image.new("RGB", (200, 100))
    caption(image, "a b " * 100_000, 0, image.size)
    assert max(measured) <= image.width
    columns = np.flatnonzero(np.asarray(image).any(axis=(0, 2)))
    assert 0 < columns[0] < columns[-1] < image.width - 1


def test_panels_are_framed_alike() -> None:
    """Each groom lands where it would in a picture of both together: the small one stays small."""
    large, small = helix(2.0), helix(0.5) * 0.3
    picture = render([Groom.from_strands([large]), Groom.from_strands([small])], (150, 150))
    seen = covered(picture.pixels[:, -150:])
    expected = picture.camera.project(small)
    rows = np.flatnonzero(seen.any(axis=1))
    assert rows.min() == pytest.approx(expected[:, 1].min(), abs=3)
    assert rows.max() == pytest.approx(expected[:, 1].max(), abs=3)


def test_a_strand_keeps_its_tint_where_others_are_left_out() -> None:
    ids = np.arange(1000)
    all_of_them = tints(ids, Look())
    np.testing.assert_array_equal(tints(ids[ids % 7 == 3], Look()), all_of_them[ids % 7 == 3])
    spread = np.std(np.log(all_of_them[:, 1]))
    assert spread == pytest.approx(Look().variation, rel=0.1)


def test_drawn_width_follows_count_and_extent() -> None:
    assert picture_module.natural_width(5000, 30.0) == pytest.approx(0.02)
    assert picture_module.natural_width(20000, 30.0) == pytest.approx(0.01)
    assert picture_module.natural_width(5000, 15.0) == pytest.approx(0.01)
    assert picture_module.natural_width(1, 30.0) == picture_module.natural_width(200, 30.0)


def test_strands_are_never_too_thin_to_see() -> None:
    many = Groom.from_strands(np.tile(helix(per_turn=3), (300, 1, 1)))
    few = Groom.from_strands([helix()])
    picture = render([few, many], (64, 64))
    assert picture.strand_width * picture.camera.scale == pytest.approx(NARROWEST_PX)
    large = render([few], (512, 512))
    assert large.strand_width == pytest.approx(picture_module.natural_width(1, 9.0), rel=0.1)


# --- light ---


def test_light_fades_with_the_hair_in_its_way() -> None:
    """The grid's optical depth is blocking x length x width / area, a sum that can be done by hand."""
    x, z = np.random.default_rng(0).uniform(-2, 2, (2, 5000))
    strands = np.stack([np.stack([x, np.full(x.size, y), z], axis=1) for y in (-2.0, 2.0)], axis=1)
    curves = drawable(Groom.from_strands(strands), np.eye(3))
    width = 0.02
    grid = light_grid(curves, width, 4.0)
    # From the middle of the block to the key light the ray runs 2 / max |component| cm through even density.
    density = len(strands) / 4.0**2
    path = min(2.0 / abs(component) for component in KEY)
    expected = BLOCKING * width * density * path
    i, j, k = np.round((np.zeros(3) - grid.origin) / grid.cell).astype(int)
    middle = grid.values[i - 5 : i + 6, j - 5 : j + 6, k - 5 : k + 6].mean(axis=(0, 1, 2))
    assert middle[0] == pytest.approx(expected, rel=0.05)
    assert middle[2] < 0.5
    top = tuple(np.round((np.array([-1.9, 1.9, 1.9]) - grid.origin) / grid.cell).astype(int))
    assert grid.values[top][0] < 0.1 * expected


def test_the_picture_is_neither_flat_nor_clipped() -> None:
    pixels = render([tuft(400, seed=5)], (200, 200)).pixels
    hair = pixels[covered(pixels)].mean(axis=1)
    low, high = np.percentile(hair, [5, 95])
    assert low < 60
    assert 90 < high < 215


# --- files ---


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
def test_save_writes_what_was_drawn(tmp_path: Path, name: str) -> None:
    picture = render([tuft(5)], (64, 64))
    for image in (picture, picture.image(), picture.pixels):
        save(image, tmp_path / name)
        read_back = np.asarray(Image.open(tmp_path / name).convert("RGB")).astype(int)
        assert np.abs(read_back - picture.pixels).mean() < (1 if name == "a.png" else 6)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_save_refuses_and_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = Picture(np.zeros((4, 4, 3), dtype=np.uint8), 0.1, frame([np.zeros((1, 3))], (64, 64)))
    with pytest.raises(WriteError, match=r"\.png or \.jpg"):
        save(picture, tmp_path / "a.gif")
    with pytest.raises(WriteError, match="does not exist"):
        save(picture, tmp_path / "nowhere" / "a.png")
    (tmp_path / "a.png").write_bytes(b"old")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(picture_module.os, "replace", full)
    with pytest.raises(WriteError, match="No space left"):
        save(picture, tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


# --- the command ---


def _run(monkeypatch: pytest.MonkeyPatch, grooms: dict[str, Groom], *arguments: str):  # type: ignore[no-untyped-def]
    formats = pytest.importorskip("detangled.formats")
    monkeypatch.setattr(formats, "read", lambda path, unit=None: grooms[Path(path).name], raising=False)
    return CliRunner().invoke(render_verb.command, list(arguments))


def test_render_command_writes_a_picture_and_says_the_width(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    grooms = {"a.abc": tuft(4), "b.abc": tuft(6)}
    out = tmp_path / "out.png"
    result = _run(monkeypatch, grooms, "a.abc", "b.abc", str(out), "--size", "80", "--view", "front")
    assert result.exit_code == 0, result.output
    assert result.stdout == ""
    assert " cm wide" in result.stderr
    assert Image.open(out).size == (2 * 80 + picture_module.SEPARATOR_PX, 80)
    again = _run(monkeypatch, grooms, "a.abc", str(out), "--size", "80", "--quiet")
    assert again.exit_code == 0
    assert again.output == ""


def test_render_command_refuses_clearly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    grooms = {
        "a.abc": tuft(4),
        "empty.abc": Groom.from_strands([]),
        "bad.abc": Groom.from_strands([[[np.nan] * 3]]),
    }
    assert _run(monkeypatch, grooms, "a.abc").exit_code == 2
    for name in ("empty.abc", "bad.abc"):
        error = _run(monkeypatch, grooms, name, str(tmp_path / "o.png")).exception
        assert isinstance(error, ReadError)
        assert name in str(error)
    assert isinstance(_run(monkeypatch, grooms, "a.abc", str(tmp_path / "o.bmp")).exception, WriteError)
    assert not list(tmp_path.iterdir())


def test_help_shows_an_example_and_loads_nothing_heavy() -> None:
    result = CliRunner().invoke(render_verb.command, ["--help"])
    assert "detangled render groom.abc groom.png" in result.output
    code = "import sys, detangled_cli.render; sys.exit(any(m in sys.modules for m in ('numba', 'numpy', 'PIL')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
