"""Pages: what they carry decodes to the strands they were made of, and they need nothing from anywhere else."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import zlib
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from detangled.errors import DetangledError, ReadError, WriteError
from detangled.formats import read, write
from detangled.groom import Attribute, Groom, Scope
from detangled.head import Head
from detangled.labeling import Labels
from detangled.view import page as page_module
from detangled.view.page import Shown, page, save
from detangled.view.page_points import STEPS, byte_planes, gridded, packed
from detangled.view.page_thinning import thinned
from detangled_cli.main import detangled

VIEW = Path(page_module.__file__).parent


def tuft(strands: int = 40, seed: int = 0, offset: float = 0.0, up: str = "y") -> Groom:
    """Coils of different numbers of points, hanging along -y."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(strands):
        t = np.linspace(0.0, 1.0, rng.integers(2, 60))[:, None]
        turn, radius = 2 * np.pi * rng.uniform(1, 4) * t, rng.uniform(0.2, 0.8)
        made.append(np.hstack([radius * np.cos(turn), -8 * t, radius * np.sin(turn)]) + rng.uniform(-4, 4, 3) + offset)
    return Groom.from_strands(made, up=up)


class Elements(HTMLParser):
    """Texts of a page's elements by their ids, and every attribute's value."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.texts: dict[str, str] = {}
        self.values: list[tuple[str, str, str]] = []
        self._open: str | None = None
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.values += [(tag, name, value or "") for name, value in attrs]
        self._open = dict(attrs).get("id") or tag

    def handle_endtag(self, tag: str) -> None:
        self._open = None

    def handle_data(self, data: str) -> None:
        if self._open:
            self.texts[self._open] = self.texts.get(self._open, "") + data


class Decoded:
    """What a page's script reads from it, read in Python."""

    def __init__(self, text: str) -> None:
        self.elements = Elements(text)
        self.about: dict[str, Any] = json.loads(self.elements.texts["page"])

    def array(self, name: str, dtype: str) -> np.ndarray:
        return np.frombuffer(zlib.decompress(base64.b64decode(self.elements.texts[name])), dtype)

    def places(self, names: list[str], offsets: np.ndarray) -> np.ndarray:
        planes = [self.array(name, "u1").astype(np.int64) for name in names]
        steps = np.stack([(planes[2 * c] << 8) + planes[2 * c + 1] for c in range(3)], axis=1)
        out = np.empty_like(steps)
        for a, b in pairwise(offsets):
            out[a:b] = np.cumsum(steps[a:b], axis=0) & 0xFFFF
        return out

    def strands(self, hair: dict[str, Any]) -> dict[int, np.ndarray]:
        """Points of each strand [cm] by its index in the groom."""
        offsets = np.concatenate([[0], np.cumsum(self.array(hair["counts"], "<u4"))]).astype(np.int64)
        points = np.array(hair["origin"]) + hair["step"] * self.places(hair["points"], offsets)
        ids = self.array(hair["ids"], "<u4")
        return {int(k): points[a:b] for k, a, b in zip(ids, offsets[:-1], offsets[1:], strict=True)}


# --- packing ---


@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_points_decode_within_half_a_step(offset: float) -> None:
    groom = tuft(offset=offset)
    grid = gridded(groom.points, groom.offsets)
    assert grid.step == pytest.approx((groom.points.max(axis=0) - groom.points.min(axis=0)).max() / STEPS)
    np.testing.assert_array_equal(grid.offsets, groom.offsets)
    assert np.abs(grid.points() - groom.points).max() <= 0.5 * grid.step * (1 + 1e-6)
    decoded = Decoded(page([Shown(groom, "tuft")]).text)
    (hair,) = decoded.about["hairs"]
    strands = decoded.strands(hair)
    assert sorted(strands) == list(range(groom.strand_count))
    for index, points in strands.items():
        np.testing.assert_allclose(points, groom.strand(index), rtol=0, atol=0.5 * hair["step"] * (1 + 1e-6))


def test_differences_wrap_around() -> None:
    places = np.array([[0, 65535, 3], [65535, 0, 4], [1, 65535, 3], [65534, 1, 70]], dtype=np.uint16)
    texts = packed(byte_planes(places, np.array([0, 3, 4])))
    document = "".join(f'<script id="s{number}">{text}</script>' for number, text in enumerate(texts))
    decoded = Decoded(f'{document}<script id="page">{{}}</script>')
    read_back = decoded.places([f"s{number}" for number in range(6)], np.array([0, 3, 4]))
    np.testing.assert_array_equal(read_back, places)


def test_arrays_are_packed_lowest_byte_first() -> None:
    (text,) = packed([np.array([1, 258], dtype=">u4")])
    assert zlib.decompress(base64.b64decode(text)) == bytes([1, 0, 0, 0, 2, 1, 0, 0])


def test_what_cannot_be_drawn_is_left_out_and_counted() -> None:
    good = [[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 1, 0]]
    strands = [
        [[5.0, 5, 5]],
        good,
        [[3.0, 3, 3], [3, 3, 3]],
        [],
        [[np.nan, 0, 0], [1, 1, 1], [2, 2, 2]],
        [[1e30, 0, 0]],
    ]
    groom = Groom.from_strands([np.reshape(strand, (-1, 3)) for strand in strands])
    made = page([Shown(groom, "odd.abc")])
    decoded = Decoded(made.text)
    assert sorted(decoded.strands(decoded.about["hairs"][0])) == [1, 4]
    assert len(decoded.strands(decoded.about["hairs"][0])[1]) == 3
    assert made.notes == ("odd.abc: 4 strands are left out: not finite, without length, or too large",)


def test_a_stray_strand_makes_points_coarse_and_that_is_said() -> None:
    groom = Groom.from_strands([[[0, 0, 0], [1, 0, 0]], [[9e4, 0, 0], [9e4, 1, 0]]])
    (note,) = page([Shown(groom, "stray")]).notes
    assert "90,001 cm apart" in note or "90,000 cm apart" in note


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_up_is_up_on_the_page(up: str) -> None:
    axis = "xyz".index(up)
    strand = np.zeros((5, 3))
    strand[:, axis] = np.arange(5)
    decoded = Decoded(page([Shown(Groom.from_strands([strand], up=up), "one")]).text)
    points = decoded.strands(decoded.about["hairs"][0])[0]
    np.testing.assert_allclose(points, np.arange(5)[:, None] * [0, 1, 0], atol=1e-4)


def test_the_same_grooms_give_the_same_bytes_in_another_order_than_theirs() -> None:
    shown = [Shown(tuft(), "a"), Shown(tuft(seed=1), "b")]
    first = page(shown)
    assert first == page(shown, threads=1)
    decoded = Decoded(first.text)
    orders = [decoded.array(hair["ids"], "<u4") for hair in decoded.about["hairs"]]
    assert not np.array_equal(orders[0], np.arange(40))
    np.testing.assert_array_equal(orders[0], orders[1])


def test_before_and_after_may_differ_in_number_and_are_seen_alike() -> None:
    before, after = tuft(30), tuft(77, seed=2, offset=3.0)
    made = page([Shown(before, "before"), Shown(after, "after")])
    decoded = Decoded(made.text)
    assert [len(decoded.strands(hair)) for hair in decoded.about["hairs"]] == [30, 77]
    both = np.concatenate([before.points, after.points])
    np.testing.assert_allclose(decoded.about["low"], both.min(axis=0))
    np.testing.assert_allclose(decoded.about["high"], both.max(axis=0))
    assert made.strand_width == page([Shown(after, "after"), Shown(before, "before")]).strand_width


@pytest.mark.parametrize(
    ("after", "said"),
    [
        (lambda groom: groom.points * 0.5, None),
        (lambda groom: groom.points * 100.0, "after is 100 times as large as before: --unit says"),
        (lambda groom: groom.points + 200.0, "after lies 346 cm away from before"),
    ],
)
def test_grooms_that_do_not_go_together_are_told_of(after: Callable[[Groom], np.ndarray], said: str | None) -> None:
    groom = tuft()
    notes = page([Shown(groom, "before"), Shown(replace(groom, points=after(groom)), "after")]).notes
    assert (notes == ()) if said is None else any(said in note for note in notes)


# --- what goes with the hair ---


def some_labels(count: int, seed: int = 5) -> Labels:
    rng = np.random.default_rng(seed)
    radius, wavelength, twist = rng.uniform(0.1, 1, (3, count))
    reading, kind = np.zeros(count, np.int8), rng.integers(0, 8, count).astype(np.int8)
    radius[3], wavelength[3], twist[3], kind[3], reading[3] = np.nan, np.nan, np.nan, -1, 3
    return Labels(radius, wavelength, twist, np.ones(count), kind, reading)


def test_labels_go_with_their_strands() -> None:
    groom, labels = tuft(), some_labels(40)
    decoded = Decoded(page([Shown(groom, "tuft", labels, {"called": "coily"})]).text)
    (hair,) = decoded.about["hairs"]
    ids = decoded.array(hair["ids"], "<u4")
    np.testing.assert_array_equal(decoded.array(hair["labels"]["type"], "u1").astype(np.int8), labels.kind[ids])
    for name in ("radius", "wavelength", "twist"):
        about = hair["labels"][name]
        places = decoded.array(about["values"], "<u2")
        values = np.where(places == 0xFFFF, np.nan, places * about["step"])
        np.testing.assert_allclose(values, getattr(labels, name)[ids], atol=1e-5)
    assert hair["facts"] == {"called": "coily"}


def test_a_head_keeps_its_faces() -> None:
    vertices = np.array([[0.0, 0, 0], [0, 0, 0], [10, 0, 0], [0, 12, 0], [0, 0, 5]])
    faces = np.array([[1, 2, 3], [1, 4, 2], [0, 3, 4]])
    decoded = Decoded(page([Shown(tuft(), "tuft")], Head(vertices, faces)).text)
    head = decoded.about["head"]
    np.testing.assert_array_equal(decoded.array(head["faces"], "<u4").reshape(-1, 3), faces)
    places = decoded.places(head["vertices"], np.array([0, 5]))
    np.testing.assert_allclose(np.array(head["origin"]) + head["step"] * places, vertices, atol=head["step"])
    assert decoded.about["high"][1] == 12.0


def test_a_head_that_is_not_finite_is_refused() -> None:
    with pytest.raises(ReadError, match="not finite"):
        page([Shown(tuft(), "tuft")], Head(np.array([[np.nan, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])))


# --- too much of it ---


def test_many_points_become_fewer_and_that_is_said() -> None:
    t = np.linspace(0, 1, 400)[:, None]
    strand = np.hstack([np.cos(60 * t), -20 * t, np.sin(60 * t)])  # 9.5 turns of 42 points
    groom = Groom.from_strands([strand + np.array([k, 0, 0]) for k in range(20)])
    fewer, rows, notes = thinned(groom, 4000)
    assert len(fewer.points) <= 4000
    np.testing.assert_array_equal(rows, np.arange(20))
    assert len(notes) == 1
    assert "one in 2.0" in notes[0]
    for old, new in zip(groom.offsets, fewer.offsets, strict=True):
        np.testing.assert_array_equal(groom.points[old - 1], fewer.points[new - 1])
    np.testing.assert_allclose(fewer.polyline_lengths(), groom.polyline_lengths(), rtol=0.02)


def test_where_curls_would_suffer_strands_are_left_out_instead() -> None:
    t = np.linspace(0, 1, 100)[:, None]
    strand = np.hstack([np.cos(60 * t), -20 * t, np.sin(60 * t)])  # 9.5 turns of 10 points
    broken = np.full((3, 3), np.nan)
    groom = Groom.from_strands([broken, *(strand + np.array([k, 0, 0]) for k in range(20))])
    made = page([Shown(groom, "many")], most_points=1000)
    decoded = Decoded(made.text)
    strands = decoded.strands(decoded.about["hairs"][0])
    assert sum(map(len, strands.values())) <= 1000
    assert min(map(len, strands.values())) >= 75
    for index, points in strands.items():
        np.testing.assert_allclose(points[[0, -1]], groom.strand(index)[[0, -1]], atol=1e-3)
    assert len(made.notes) == 3
    assert "1 strand is left out" in made.notes[2]


# --- the page as a file ---


def test_the_page_needs_nothing_from_anywhere() -> None:
    text = page([Shown(tuft(), "tuft")], Head(np.eye(3), np.array([[0, 1, 2]]))).text
    elements = Elements(text)
    assert not [value for value in elements.values if value[1] in ("src", "href") and not value[2].startswith("data:")]
    (policy,) = [value for _, name, value in elements.values if name == "content" and "default-src" in value]
    assert "default-src 'none'" in policy
    # The name of a language, which is never looked up, is all that is written like an address.
    addresses = set(re.findall(r"\w+://[^\s\"'`)]+", text)) - {"http://www.w3.org/1999/xhtml"}
    assert not addresses
    assert not re.search(r"@import|url\(", text)
    assert "Permission is hereby granted, free of charge" in text  # three's licence asks for its notice


def test_names_cannot_break_out_of_the_page() -> None:
    name = "</script><script>alert(1)</script><!--&\"'.abc"
    text = page([Shown(tuft(), name)]).text
    decoded = Decoded(text)
    assert decoded.about["hairs"][0]["name"] == decoded.about["title"] == name
    assert "<script>alert" not in text
    assert decoded.elements.texts["title"].startswith("</script>")


def test_the_template_is_built_from_the_sources_beside_it() -> None:
    """`npm ci && npm run build` in view/web after a change there."""
    web = VIEW / "web"
    names = [
        "build.mjs",
        "package-lock.json",
        "package.json",
        *sorted(f"src/{p.name}" for p in (web / "src").iterdir()),
    ]
    digest = hashlib.sha256()
    for name in names:
        digest.update(f"{name}\n".encode() + (web / name).read_bytes())
    assert f'content="{digest.hexdigest()}"' in (VIEW / "page_template.html").read_text(encoding="utf-8")


def test_an_interrupted_page_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "page.html"
    target.write_text("old")

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", fail)
    with pytest.raises(WriteError, match="No space left"):
        save(page([Shown(tuft(2), "tuft")]), target)
    monkeypatch.undo()
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


# --- bad input ---


def test_one_strand_is_enough_and_none_is_not() -> None:
    decoded = Decoded(page([Shown(tuft(1), "one")]).text)
    assert len(decoded.strands(decoded.about["hairs"][0])) == 1
    for empty in (
        Groom.from_strands([]),
        Groom.from_strands([[[1.0, 2, 3]]]),
        Groom.from_strands([np.full((4, 3), np.nan)]),
        Groom.from_strands([[[0.0, 0, 0], [1e30, 0, 0]]]),
    ):
        with pytest.raises(ReadError, match=r"bald\.abc has no strand of two .* within 10 km"):
            page([Shown(empty, "bald.abc")])


def test_a_page_shows_one_groom_or_two() -> None:
    with pytest.raises(DetangledError, match="not 3"):
        page([Shown(tuft(2), "a")] * 3)


# --- the command ---


def run(*words: object) -> Any:
    return CliRunner().invoke(detangled, ["view", *map(str, words)])


@pytest.fixture
def tuft_file(tmp_path: Path) -> Path:
    path = tmp_path / "tuft.npz"
    write(replace(tuft(12), unit_source="given"), path)
    return path


def test_the_command_writes_a_page_into_this_folder(
    tuft_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    done = run(tuft_file, "--no-labels", "--unit", "cm")
    assert done.exit_code == 0, done.output
    assert done.stdout == ""
    assert "tuft.html: 0." in done.stderr
    assert "cm wide" in done.stderr
    decoded = Decoded((tmp_path / "here" / "tuft.html").read_text(encoding="utf-8"))
    assert decoded.about["hairs"][0]["facts"] is None


def test_the_command_labels_both_grooms(tuft_file: Path, tmp_path: Path) -> None:
    target = tmp_path / "page.html"
    done = run(tuft_file, target, "--after", tuft_file, "--unit", "cm", "-q")
    assert (done.exit_code, done.output) == (0, "")
    decoded = Decoded(target.read_text(encoding="utf-8"))
    for hair in decoded.about["hairs"]:
        assert hair["name"].endswith("/tuft.npz")
        assert hair["facts"]["strands"] == 12
        assert hair["labels"]["type"]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("tuft.npz", "page.png"), 5, "must end in .html"),
        (("tuft.npz", "nowhere/page.html"), 5, "does not exist"),
        (("missing.abc", "page.html"), 3, "no such file"),
        (("tuft.npz", "page.html", "--after", "missing.abc"), 3, "no such file"),
        (("tuft.npz", "page.html", "--head", "missing.obj"), 3, "no such file"),
        (("tuft.npz", "page.html", "--head-unit", "cm"), 2, "go with --head"),
        ((), 2, "Missing argument 'IN'"),
    ],
)
def test_bad_words_are_refused_in_a_line(
    words: tuple[str, ...], code: int, said: str, tuft_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tuft_file.parent)
    Path("tuft.html").write_text("something")
    done = run(*words)
    assert done.exit_code == code, done.output
    assert said in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not Path("page.html").exists()
    assert Path("tuft.html").read_text() == "something"


def test_a_head_of_another_unit_is_said_by_command(tuft_file: Path, tmp_path: Path) -> None:
    target, head = tmp_path / "page.html", tmp_path / "head.obj"
    head.write_text("v 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    given = (tuft_file, target, "--unit", "cm", "--no-labels", "--head", head, "--head-unit")
    assert run(*given, "cm").exit_code == 0
    target.unlink()
    done = run(*given, "mm")
    assert done.exit_code == ReadError.exit_code
    assert "head.obj: the groom does not grow on this head" in done.stderr
    assert "--head-unit and --unit say their units" in done.stderr
    assert not target.exists()


def test_the_command_takes_a_head_along(grooms: Callable[[str], Path], tmp_path: Path) -> None:
    target = tmp_path / "page.html"
    head = grooms("heads/vitruvian_head.obj")
    done = run(grooms("bob.abc"), target, "--head", head, "--no-labels", "--unit", "m", "-q")
    assert (done.exit_code, done.output) == (0, "")
    decoded = Decoded(target.read_text(encoding="utf-8"))
    about = decoded.about["head"]
    assert about["count"] > 17_000
    assert len(decoded.array(about["faces"], "<u4")) > 3 * 34_000
    (hair,) = decoded.about["hairs"]
    assert np.all(np.array(about["low"]) < hair["high"])
    assert np.all(np.array(about["high"]) > hair["low"])


def test_real_hair_is_shown_whole(grooms: Callable[[str], Path], tmp_path: Path) -> None:
    groom = read(grooms("coily_swatch.obj"), unit="cm")
    groom = replace(groom, attributes={"a": Attribute(np.arange(98), Scope.STRAND)})
    decoded = Decoded(page([Shown(groom, "swatch")]).text)
    (hair,) = decoded.about["hairs"]
    strands = decoded.strands(hair)
    assert len(strands) == 98
    for index, points in strands.items():
        np.testing.assert_allclose(points, groom.strand(index), atol=hair["step"])
