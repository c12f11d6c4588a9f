"""The gallery: how figures are laid out, what they measure, and the verb that makes them."""

from __future__ import annotations

import subprocess
import sys
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from PIL import Image

from detangled.base_texture import Texture
from detangled.formats import write
from detangled.geometry.signal import signals
from detangled.groom import Groom
from detangled.view.gallery import groom_files, length_figure, styles
from detangled.view.gallery.figure import Drawn, Figure
from detangled.view.gallery.groom_panels import trimmed
from detangled.view.gallery.guide_figure import unevenness
from detangled.view.gallery.index import save_figure, write_index
from detangled.view.gallery.plot import Axes, Curve, even_ticks, plot
from detangled.view.gallery.sheet import PAPER, beside, scale_bar, stacked, words
from detangled.view.gallery.strands import PLAIN, Box, box_around, camera_of, standing_beside, strand_panel, with_line
from detangled_cli.gallery import FIGURES
from detangled_cli.main import detangled


def helix(radius: float = 0.5, wavelength: float = 1.0, turns: float = 6.0) -> np.ndarray:
    t = np.linspace(0.0, turns, int(24 * turns))
    return np.stack([radius * np.cos(2 * np.pi * t), radius * np.sin(2 * np.pi * t), -wavelength * t], axis=1)


def inked(image: Image.Image) -> np.ndarray:
    """Where something is drawn on the paper, (height, width) bool."""
    return np.asarray(image.convert("L")) < 200


def verb(*arguments: object) -> Result:
    return CliRunner().invoke(detangled, ["gallery", *map(str, arguments)])


# --- laying out ---


def test_blocks_keep_their_pixels_and_their_place() -> None:
    red, blue = Image.new("RGB", (10, 20), "red"), Image.new("RGB", (30, 8), "blue")
    row, column = beside([red, blue], 5), stacked([red, blue], 5)
    assert (row.size, column.size) == ((45, 20), (30, 33))
    assert row.getpixel((9, 19)) == (255, 0, 0)
    assert row.getpixel((12, 0)) == PAPER
    assert row.getpixel((15, 0)) == (0, 0, 255)
    assert row.getpixel((15, 8)) == PAPER
    assert column.getpixel((10, 0)) == (255, 0, 0)
    assert column.getpixel((9, 0)) == PAPER
    assert column.getpixel((0, 25)) == (0, 0, 255)


def test_words_wrap_at_their_width_and_lose_none() -> None:
    text = "a strand that hangs"
    block = words(text, 20, 90)
    assert block.width == 90
    assert block.height > words(text, 20).height
    assert not inked(block)[:, [0, -1]].any()
    assert inked(block).sum() == pytest.approx(inked(words(text, 20)).sum(), rel=0.1)


def test_a_scale_bar_is_as_long_as_it_says() -> None:
    bar = scale_bar(2.0, 50.0, 20)
    longest = inked(bar)[:, :100].sum(axis=1).max()
    assert longest == 100
    assert not inked(bar)[:, 100:108].any()


# --- strands ---


def test_strands_stand_apart_with_their_roots_at_one_height() -> None:
    strands = [helix(0.3) + np.array([5.0, 1.0, 2.0]), helix(0.8) - [0.0, 0.0, 3.0], helix(0.1)]
    groom = Groom.from_strands(strands, up="z")
    stood = standing_beside(groom.points, groom.offsets, 1.0)
    spans = [(s[:, 0].min(), s[:, 0].max()) for s in map(stood.strand, range(3))]
    assert all(left[1] < right[0] for left, right in pairwise(spans))
    assert [stood.strand(k)[0, 2] for k in range(3)] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    assert stood.polyline_lengths() == pytest.approx(groom.polyline_lengths())
    assert spans[0][0] == pytest.approx(-spans[2][1])


def test_a_panel_shows_a_strand_at_its_scale() -> None:
    groom = Groom.from_strands([np.stack([np.full(9, 1.0), np.zeros(9), np.linspace(0, -4, 9)], axis=1)], up="z")
    box = Box(-1.0, 3.0, -5.0, 1.0)
    seen = inked(strand_panel([(groom, PLAIN)], box, 20.0, 4.0))
    assert seen.shape == (120, 80)
    rows, columns = np.nonzero(seen)
    assert columns.mean() + 0.5 == pytest.approx(40.0, abs=0.5)
    assert (rows.min(), rows.max()) == (pytest.approx(20, abs=2), pytest.approx(100, abs=2))
    assert seen[60].sum() == pytest.approx(4, abs=1)


def test_layers_lie_over_each_other_in_their_colours() -> None:
    left, right = (Groom.from_strands([[[x, 0, 0], [x, 0, -2]]], up="z") for x in (-1.0, 1.0))
    box = Box(-2.0, 2.0, -2.0, 0.0)
    panel = np.asarray(strand_panel([(left, (0.5, 0.0, 0.0)), (right, (0.0, 0.0, 0.5))], box, 20.0, 6.0)).astype(int)
    assert panel[20, 20, 0] > panel[20, 20, 2] + 60
    assert panel[20, 60, 2] > panel[20, 60, 0] + 60


def test_a_line_goes_through_its_points() -> None:
    box = Box(0.0, 4.0, -4.0, 0.0)
    white = Image.new("RGB", (80, 80), "white")
    line = np.array([[1.0, 0.0, -1.0], [3.0, 0.0, -3.0]])
    drawn = with_line(white, line, box, 20.0, (0, 0, 0), 3.0)
    at = camera_of(box, 20.0).project(np.array([[2.0, -2.0, 0.0]]))[0]
    assert inked(drawn)[int(at[1]), int(at[0])]
    assert not inked(drawn)[10, 60]
    dashed = with_line(white, line, box, 20.0, (0, 0, 0), 3.0, 5.0)
    assert 0.3 < inked(dashed).sum() / inked(drawn).sum() < 0.8


# --- plots ---


def test_a_plot_puts_values_where_its_axes_say() -> None:
    x = np.linspace(0.0, 10.0, 50)
    axes = Axes((0.0, 10.0), (-1.0, 3.0))
    image = np.asarray(plot([Curve(x, np.full(50, 2.0), (255, 0, 0), 2.0)], axes, (200, 100))).astype(int)
    red = (image[:, 100, 0] > 200) & (image[:, 100, 1] < 120)
    assert np.flatnonzero(red).mean() == pytest.approx(25, abs=1.5)


@pytest.mark.parametrize(("low", "high"), [(0.0, 26.0), (-10.7, 10.7), (0.0, 0.03), (-5.0, 3.1e4)])
def test_ticks_are_round_and_inside(low: float, high: float) -> None:
    ticks = even_ticks(low, high)
    assert 2 <= len(ticks) <= 9
    assert low <= ticks[0]
    assert ticks[-1] <= high
    step = ticks[1] - ticks[0]
    assert np.allclose(np.diff(ticks), step)
    assert f"{step:.0e}"[0] in "125"


# --- what figures measure ---


def test_unevenness_is_none_for_a_coil_about_its_axis() -> None:
    assert unevenness(helix()) == pytest.approx(0.0, abs=1e-9)
    assert unevenness(helix() + np.array([0.3, 0.0, 0.0])) > 0.2


def test_a_faster_strand_is_longer_by_as_much_and_bends_as_before() -> None:
    texture = Texture(cell_width=0.08, turn=2.9, median_arc=20.0, arc_per_axis=2.3, radius=0.42, wavelength=1.25)
    groom = Groom.from_strands([helix(0.42, 1.25, 7.0)], up="z")
    longer = length_figure.faster(groom, texture, 2.0)
    assert longer.polyline_lengths()[0] == pytest.approx(2.0 * groom.polyline_lengths()[0], rel=0.01)
    kappa = [float(np.median(signals(g.points, g.offsets, np.array([0, 256]))[:, 0])) for g in (groom, longer)]
    assert kappa[1] == pytest.approx(kappa[0], rel=0.02)


def test_made_styles_stay_off_the_head_and_differ() -> None:
    made = styles.made_styles(60, seed=3)
    assert [style.name for style in made] == ["long", "bob", "swept", "short"]
    for style in made:
        groom = style.groom
        assert 40 < groom.strand_count < 90
        assert np.isfinite(groom.points).all()
        level = np.linalg.norm(groom.points / styles.HEAD, axis=1)
        upper = groom.points[:, 1] > -0.4 * styles.HEAD[1]
        assert level[upper].min() > 0.99
        roots = np.linalg.norm(groom.points[groom.offsets[:-1]] / styles.HEAD, axis=1)
        assert roots == pytest.approx(np.ones(len(roots)))
    lengths = [style.groom.polyline_lengths().mean() for style in made]
    assert lengths[0] > 1.3 * lengths[1]
    assert lengths[2] > 2.5 * lengths[3]
    again = styles.made_styles(60, seed=3)
    assert all((a.groom.points == b.groom.points).all() for a, b in zip(made, again, strict=True))


def test_the_head_is_closed_and_faces_outwards() -> None:
    head = styles.head_mesh()
    a, b, c = (head.vertices[head.faces[:, k]] for k in range(3))
    volume = float(np.einsum("nk,nk->n", np.cross(a, b), c).sum() / 6.0)
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * np.prod(styles.HEAD), rel=0.01)


# --- the page ---


class Sources(HTMLParser):
    """The addresses a page asks for, and its words."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.asked: list[str] = []
        self.words = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.asked += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        self.words += data


def test_a_page_shows_the_figures_of_its_folder_with_their_captions(tmp_path: Path) -> None:
    figure = Figure("Title & <more>", "What it shows: 1 < 2.", "a figure", "Not all.", 1, lambda _: drawn)
    drawn = Drawn(Image.new("RGB", (40, 30), "white"), ("Measured 0.25 cm.",))
    save_figure(figure, drawn, tmp_path / "guides.png")
    (tmp_path / "few.png").write_bytes(b"no picture")
    Image.new("RGB", (5, 5)).save(tmp_path / "grid.png")
    assert write_index(tmp_path, list(FIGURES), "1.0") == ["guides"]
    page = Sources((tmp_path / "index.html").read_text(encoding="utf-8"))
    assert all(part in page.words for part in ("Title & <more>", "1 < 2", "Measured 0.25 cm.", "Not all."))
    assert [s for s in page.asked if s.endswith(".png")] == ["guides.png"] * 2
    assert all(not s.startswith(("http", "//")) for s in page.asked)


# --- styles from files ---


def test_a_folder_gives_its_grooms_once_each_and_passes_over_what_is_none(tmp_path: Path) -> None:
    big = Groom.from_strands([helix() + np.array([k, 0.0, 0.0]) for k in range(120)])
    for name in ("b.npz", "a.obj", "b.obj"):
        write(big, tmp_path / name)
    (tmp_path / "c.abc").write_bytes(b"nothing")
    (tmp_path / "deeper").mkdir()
    write(big.select([0, 1]), tmp_path / "deeper" / "swatch.npz")
    found, said = groom_files.styles_from([tmp_path], 4)
    assert [style.name for style in found] == ["a", "b"]
    assert any("c.abc" in sentence for sentence in said)


# --- the command ---


def test_the_verb_makes_a_figure_and_its_page(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "gallery"
    result = verb(folder, "--only", "guides", "--width", 400, "--strands", 8)
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in folder.iterdir()) == ["guides.png", "index.html"]
    with Image.open(folder / "guides.png") as image:
        assert image.width == 400
        assert inked(image.convert("RGB")).sum() > 500
    assert "guides: Beside its mean" in result.stderr
    assert "1 figures, 1 of them made" in result.stderr
    before = (folder / "guides.png").read_bytes()
    assert verb(folder, "--only", "guides", "--width", 400, "--strands", 8, "--quiet").stderr == ""
    assert (folder / "guides.png").read_bytes() == before


def test_wrong_arguments_are_told(tmp_path: Path) -> None:
    result = verb(tmp_path, "--only", "guide")
    assert result.exit_code == 2
    assert "did you mean guides?" in result.stderr
    (tmp_path / "file").write_text("")
    result = verb(tmp_path / "file", "--only", "guides")
    assert result.exit_code == 5
    assert "cannot be made" in result.stderr
    result = verb(tmp_path / "g", "--only", "grid", "--grooms", tmp_path / "missing.abc")
    assert result.exit_code == 3
    assert "missing.abc: no such file" in result.stderr
    (tmp_path / "empty").mkdir()
    result = verb(tmp_path / "g", "--only", "grid", "--grooms", tmp_path / "empty")
    assert result.exit_code == 3
    assert "no groom of" in result.stderr


WITHOUT_TORCH = """
import sys
from importlib import import_module

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("torch", "onnx"):
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Absent())
from detangled_cli.gallery import FIGURES
from detangled_cli.main import detangled

assert all(getattr(import_module(module), name).steps > 1 for module, name in FIGURES.values())
detangled.main(["gallery", sys.argv[1], "--only", "hanging", "--width", "400"])
"""


def test_figures_need_no_torch(tmp_path: Path) -> None:
    command = (sys.executable, "-c", WITHOUT_TORCH, tmp_path)
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "hanging.png").exists()
    assert "type IV hangs" in done.stderr


def test_the_box_around_grooms_holds_them() -> None:
    groom = Groom.from_strands([helix(0.5)], up="z")
    box = box_around([groom])
    assert (box.left, box.right, box.top) == (pytest.approx(-0.5, abs=0.02), pytest.approx(0.5), 0.0)
    assert box.grown(1.0).width == pytest.approx(box.width + 2.0)


def test_panels_are_trimmed_alike() -> None:
    panels = [Image.new("RGB", (10, 20), "white") for _ in range(2)]
    panels[0].putpixel((3, 5), (0, 0, 0))
    panels[1].putpixel((7, 12), (0, 0, 0))
    cut = trimmed(panels)
    assert [panel.size for panel in cut] == [(10, 8)] * 2
    assert cut[0].getpixel((3, 0)) == cut[1].getpixel((7, 7)) == (0, 0, 0)
    assert trimmed([Image.new("RGB", (4, 4), "white")])[0].size == (4, 4)
