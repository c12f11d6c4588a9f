"""Colours of hair, what colours of strands mean, and both qualities by command."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from detangled import formats
from detangled.errors import DetangledError, ReadError, WriteError
from detangled.groom import Attribute, Groom, Scope
from detangled.labeling import Labels
from detangled.view import colouring
from detangled.view.colouring import BRIGHTNESS, UNREAD, distinct, strand_colours, viridis
from detangled.view.colours import (
    EUMELANIN,
    MELANIN,
    PHEOMELANIN,
    PLAIN,
    SURFACE,
    absorption_of,
    by_melanin,
    hair_colour,
)
from detangled.view.picture import Style, render
from detangled.view.shading import Look
from detangled_cli import render as render_verb
from detangled_cli.main import detangled as program


def tuft(strands: int = 30, seed: int = 0, **fields: object) -> Groom:
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(strands, 10, 3)) * 0.2 + [0.0, -0.6, 0.0]
    return Groom.from_strands(rng.uniform(-3, 3, (strands, 1, 3)) + np.cumsum(steps, axis=1), **fields)


# --- colours of hair ---


def test_pigments_absorb_what_was_published() -> None:
    """Chiang et al. (2016), equation 9, written out for a roughness of 0.3, undoes what the amounts do."""
    spread = 5.969 - 0.0645 + 0.22788 - 0.28971 + 0.0451494 + 0.00059535
    for eumelanin, pheomelanin in ((1.3, 0.0), (0.3, 0.4), (0.0, 2.0)):
        absorbed = eumelanin * np.array([0.419, 0.697, 1.37]) + pheomelanin * np.array([0.187, 0.4, 1.05])
        colour = np.array(by_melanin(eumelanin, pheomelanin))
        np.testing.assert_allclose(colour - SURFACE, 2.0 * np.exp(-spread * np.sqrt(absorbed)), rtol=1e-6)
        np.testing.assert_allclose(absorption_of(colour), absorbed, rtol=1e-3)


def test_more_pigment_is_darker_and_pheomelanin_redder() -> None:
    shades = np.array([by_melanin(amount) for amount in (0.15, 0.3, 0.6, 1.3, 3.0, 8.0)])
    assert (np.diff(shades, axis=0) < 0).all()
    dark, red = by_melanin(0.6), by_melanin(0.1, 1.0)
    assert red[0] / red[1] > dark[0] / dark[1]
    assert EUMELANIN[2] / EUMELANIN[0] < PHEOMELANIN[2] / PHEOMELANIN[0]


def test_colours_are_read_as_people_write_them() -> None:
    assert hair_colour("Dark brown") == hair_colour("dark-brown") == by_melanin(*MELANIN["darkbrown"])
    assert hair_colour("blonde") == hair_colour("blond")
    assert hair_colour("gray") == PLAIN["grey"]
    assert hair_colour("1.3") == by_melanin(1.3)
    assert hair_colour("0.3/0.8") == by_melanin(0.3, 0.8)
    assert hair_colour("#ff0000") == (1.0, 0.0, 0.0)
    assert hair_colour("#808080")[0] == pytest.approx(0.2159, abs=1e-4)


@pytest.mark.parametrize("text", ["", "purple", "#12345", "#gggggg", "-1", "11", "nan", "1/2/3", "1/", "inf"])
def test_what_is_no_colour_is_refused_with_those_that_are(text: str) -> None:
    with pytest.raises(DetangledError, match=r"is not a hair colour: use one of black, .*eumelanin"):
        hair_colour(text)


def test_the_render_is_of_the_colour_asked_for() -> None:
    means = {}
    for name in ("black", "brown", "blond"):
        pixels = render([tuft(300)], (72, 72), style=Style(look=Look(hair=hair_colour(name)))).pixels.astype(float)
        hair = np.abs(pixels - pixels[:, :1]).max(axis=2) > 6
        means[name] = pixels[hair].mean(axis=0)
    assert means["black"].mean() < means["brown"].mean() < means["blond"].mean()
    assert means["blond"][0] > 1.2 * means["blond"][2]


# --- colours that mean something ---


def labelled(monkeypatch: pytest.MonkeyPatch, radius: list[list[float]]) -> list[Groom]:
    """Grooms whose strands read as told."""
    grooms = [tuft(len(values)) for values in radius]
    told = {id(groom): np.array(values) for groom, values in zip(grooms, radius, strict=True)}

    def label(groom: Groom, progress: Callable[[int], object] | None = None) -> Labels:
        values = told[id(groom)]
        nothing = np.zeros(len(values), dtype=np.int8)
        return Labels(values, 2.0 * values, values, values, nothing, nothing)

    monkeypatch.setattr(colouring, "label", label)
    return grooms


def test_strands_are_coloured_on_one_scale_for_all_grooms(monkeypatch: pytest.MonkeyPatch) -> None:
    grooms = labelled(monkeypatch, [[0.2, 0.4, np.nan, 0.0], [0.4, 0.8]])
    (first, second), legend = strand_colours(grooms, "radius")
    np.testing.assert_array_equal(first[1], second[0])
    np.testing.assert_array_equal(first[2:], [UNREAD, UNREAD])
    np.testing.assert_allclose(first[0], BRIGHTNESS * viridis()[0], atol=0.02)
    np.testing.assert_allclose(second[1], BRIGHTNESS * viridis()[-1], atol=0.05)
    np.testing.assert_allclose(first[1], BRIGHTNESS * viridis()[4], atol=0.03)  # 0.4: the ratio's middle
    assert legend.title.startswith("radius [cm]")
    assert float(legend.ticks[2][1]) == pytest.approx(0.4, abs=0.011)


def test_a_twist_has_a_scale_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    grooms = labelled(monkeypatch, [[0.0, 0.5, 1.0]])
    (colours,), legend = strand_colours(grooms, "twist")
    np.testing.assert_allclose(colours, BRIGHTNESS * viridis()[[0, 4, 8]], atol=1e-12)
    assert legend.ticks[0] == (0.0, "0")
    assert legend.ticks[-1] == (1.0, "1")


def test_equal_strands_are_not_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    grooms = labelled(monkeypatch, [[0.5, 0.5001, 0.4999]])
    (colours,), _ = strand_colours(grooms, "wavelength")
    assert np.ptp(colours, axis=0).max() < 0.01
    nothing = labelled(monkeypatch, [[np.nan, 0.0]])
    assert (strand_colours(nothing, "radius")[0][0] == UNREAD).all()


def test_guides_have_a_colour_each() -> None:
    closest = np.array([[3, 1, 2], [3, 2, 1], [7, 3, 1]], dtype=np.int32)
    own = tuft(3, attributes={"groom_closest_guides": Attribute(closest, Scope.STRAND)})
    parts = tuft(3, attributes={"object": Attribute(np.array([0, 0, 1]), Scope.STRAND)})
    for groom, what in ((own, "guide"), (parts, "object")):
        (colours,), legend = strand_colours([groom], "guide")
        assert legend.title == f"a colour for each {what}"
        np.testing.assert_array_equal(colours[0], colours[1])
        assert np.abs(colours[0] - colours[2]).max() > 0.05
    assert strand_colours([tuft(3)], "guide")[1].title == "a colour for each strand"
    many = distinct(np.arange(1000))
    assert ((many >= 0.0) & (many <= 1.0)).all()
    assert np.abs(np.diff(many, axis=0)).max(axis=1).min() > 0.03


def test_the_legend_is_below_the_panels_and_the_panels_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    grooms = labelled(monkeypatch, [[0.2, 0.4], [0.4, 0.8]])
    colours, legend = strand_colours(grooms, "radius")
    plain = render(grooms, (200, 160), style=Style(colours=colours)).pixels
    whole = render(grooms, (200, 160), style=Style(colours=colours, legend=legend)).pixels
    np.testing.assert_array_equal(whole[:160], plain)
    strip = whole[160:].astype(int)
    assert np.ptp(strip, axis=2).max() > 100, "the bar has colours"
    assert (strip[0] == strip[0, 0]).all()


# --- path tracing ---


def test_paths_and_ribbons_show_the_same_hair(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mitsuba")
    groom = tuft(60)
    seen, means = [], []
    for style in (
        Style(),
        Style(quality="path", samples=8),
        Style(Look(hair=(0.4, 0.3, 0.2)), quality="path", samples=8),
    ):
        picture = render([groom], (64, 64), captions=["a"], style=style)
        pixels = picture.pixels[:56].astype(int)
        seen.append(np.abs(pixels - pixels[:, :1]).max(axis=2) > 24)
        means.append(pixels[seen[0]].mean())
    assert (seen[0] & seen[1]).sum() > 0.75 * (seen[0] | seen[1]).sum()
    assert means[2] > means[1] + 10


def test_curves_begin_and_end_where_hair_does(tmp_path: Path) -> None:
    """Uniform cubic B-splines with an end point mirrored beyond it pass through that end."""
    from detangled.view.path_tracing import _write

    strand = np.array([[0.0, 0, 0], [1, 2, 0], [3, 2, 1]])
    path = tmp_path / "a.txt"
    _write(np.concatenate([strand, strand + 9]), np.array([0, 0, 0, 4, 4, 4], dtype=np.int32), 0.5, path)
    one, two = (
        np.array([line.split() for line in part.split("\n")], dtype=float)
        for part in path.read_text().strip().split("\n\n")
    )
    assert len(one) == len(two) == 5
    np.testing.assert_allclose((one[0] + 4 * one[1] + one[2])[:3] / 6, strand[0], atol=1e-12)
    np.testing.assert_allclose((two[-3] + 4 * two[-2] + two[-1])[:3] / 6, strand[-1] + 9, atol=1e-12)
    assert (one[:, 3] == 0.5).all()


def test_without_mitsuba_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    result = _command(monkeypatch, "a.abc", str(tmp_path / "o.png"), "--quality", "path")
    assert result.exit_code == 2
    assert "pip install 'detangled[beauty]'" in result.output
    assert result.output.count("\n") == 1


# --- the command ---


def _command(monkeypatch: pytest.MonkeyPatch, *arguments: str):  # type: ignore[no-untyped-def]
    monkeypatch.setattr(formats, "read", lambda path, unit=None: tuft(seed=len(str(path))))
    return CliRunner().invoke(program, ["render", *arguments])


def test_everything_together_by_command(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    still, turn = tmp_path / "a.png", tmp_path / "a.gif"
    both = ("a.abc", "bb.abc")
    words = ("--caption", "before", "--caption", "after")
    result = _command(monkeypatch, *both, str(still), "--size", "64", "--colour-by", "guide", "--view", "top", *words)
    assert result.exit_code == 0, result.output
    assert Image.open(still).height > 64
    result = _command(monkeypatch, "a.abc", str(turn), "--size", "64", "--turntable", "3", "--color", "red", "-q")
    assert result.exit_code == 0, result.output
    assert Image.open(turn).n_frames == 3
    assert result.output == ""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--caption", "one", "--caption", "two"], "1 grooms need as many --caption"),
        (["--colour", "purple"], "--colour: 'purple' is not a hair colour"),
        (["--colour", "red", "--colour-by", "guide"], "do not go together"),
        (["--head-unit", "m"], "go with --head"),
        (["--turntable", "1"], "2<=x<=720"),
    ],
)
def test_wrong_options_are_wrong_usage(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, arguments: list[str], words: str
) -> None:
    result = _command(monkeypatch, "a.abc", str(tmp_path / "o.png"), *arguments)
    assert result.exit_code == 2
    assert words in result.output
    assert not list(tmp_path.iterdir())


def test_a_turn_into_a_still_picture_needs_a_number_of_frames(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    result = _command(monkeypatch, "a.abc", str(tmp_path / "o.gif"))
    assert result.exit_code == WriteError.exit_code
    assert "--turntable" in result.output


def test_a_head_of_another_unit_is_said_by_command(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("detangled.formats.meshes")
    # A box about the roots, which lie within a centimetre of it.
    corners = "".join(f"v {x} {y} {z}\n" for x in (-3, 3) for y in (-3, 3) for z in (-3, 3))
    sides = "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
    (tmp_path / "head.obj").write_text(corners + sides)
    given = ["a.abc", str(tmp_path / "o.png"), "--size", "64", "--head", str(tmp_path / "head.obj"), "--head-unit"]
    assert _command(monkeypatch, *given, "cm").exit_code == 0
    (tmp_path / "o.png").unlink()
    result = _command(monkeypatch, *given, "mm")
    assert result.exit_code == ReadError.exit_code
    assert "head.obj: the head is 10 times too small" in result.output
    assert "--head-unit cm" in result.output
    assert not (tmp_path / "o.png").exists()


def test_choices_of_the_command_are_those_of_the_library() -> None:
    from detangled.view.camera import VIEWS
    from detangled.view.picture import QUALITIES

    assert tuple(VIEWS) == render_verb.VIEWS
    assert colouring.CHOICES == render_verb.COLOUR_BY
    quality = next(option for option in render_verb.command.params if option.name == "quality")
    assert tuple(quality.type.choices) == QUALITIES
    text = next(option.help for option in render_verb.command.params if option.name == "colour")
    assert all(name in text for name in [*MELANIN, *PLAIN])
