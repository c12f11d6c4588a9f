"""detangled label: what it says of labels, in a page, as JSON and as CSV, and how it fails. The labels are made up."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from detangled import labeling
from detangled.errors import ModelError, TextureError, WriteError
from detangled.formats import write
from detangled.groom import Groom
from detangled.labeling import Labels, Reading, nearest_types
from detangled.texture import HAIR_TYPES, THINGS, hair_type
from detangled_cli.label import COLUMNS, LOOKS, TWIST_WORDS, explanation, explanation_of, write_table
from detangled_cli.label_summary import (
    DIAMETERS,
    GROUPS,
    NOISE,
    TWISTED,
    UNREAD,
    called,
    compared,
    is_readable,
    percent,
    summary,
    why_unread,
)
from detangled_cli.main import VERBS, detangled

NAN = float("nan")
SIX = 5  # the index of type VI


def labels_of(*strands: tuple[float, float, float, float, int, Reading]) -> Labels:
    """Labels of strands of these radii, wavelengths, twists, lengths, kinds and readings."""
    columns = list(zip(*strands, strict=True)) or [()] * 6
    numbers = [np.array(column, dtype=np.float64) for column in columns[:4]]
    return Labels(*numbers, *(np.array(column, dtype=np.int8) for column in columns[4:]))


def of_type(kind: int, count: int = 1, reading: Reading = Reading.READ) -> list[tuple[Any, ...]]:
    hair = HAIR_TYPES[kind]
    return [(hair.radius.mean, hair.wavelength.mean, hair.twist.mean, 20.0, kind, reading)] * count


STRAIGHT = (0.0, NAN, 0.0, 30.0, 0, Reading.STRAIGHT)
COARSE = (NAN, NAN, NAN, 25.0, -1, Reading.COARSE)
UNUSABLE = (NAN, NAN, NAN, NAN, -1, Reading.UNUSABLE)

# Eight strands: five of VI with radii 0.3 to 0.5, one straight, one too coarse, one unusable.
MIXED = labels_of(
    *((0.3 + 0.05 * k, 1.0 + 0.1 * k, 0.3 + 0.02 * k, 10.0 + k, SIX, Reading.READ) for k in range(5)),
    STRAIGHT,
    COARSE,
    UNUSABLE,
)


@pytest.fixture
def groom(tmp_path: Path) -> Path:
    """A groom of eight strands, 20 cm long."""
    path = tmp_path / "groom.obj"
    z = np.linspace(0.0, -20.0, 5)
    write(Groom.from_strands([np.stack([np.full(5, k), np.zeros(5), z], axis=1) for k in range(8)]), path)
    return path


@pytest.fixture
def labelled(monkeypatch: pytest.MonkeyPatch) -> Callable[[Labels], list[int]]:
    """Make every groom have these labels; returns the strand counts of grooms that were labelled."""

    def install(labels: Labels) -> list[int]:
        asked: list[int] = []

        def label(groom: Groom, progress: Callable[[int], object] | None = None) -> Labels:
            asked.append(groom.strand_count)
            assert progress is not None
            progress(groom.strand_count)
            return labels

        monkeypatch.setattr(labeling, "label", label)
        return asked

    return install


def invoke(*arguments: object) -> Result:
    return CliRunner().invoke(detangled, ["label", *map(str, arguments)])


def assert_refused(result: Result, code: int, *words: str) -> None:
    """Nothing on stdout, and one line on stderr that says what was wrong."""
    assert result.exit_code == code, result.output
    assert result.stdout == ""
    errors = [line for line in result.stderr.splitlines() if line.startswith("detangled: error: ")]
    assert len(errors) == 1, result.stderr
    for word in words:
        assert word in errors[0]


# The summary.


def test_summary_measures_curls_over_strands_with_curls_alone() -> None:
    facts = summary(MIXED)
    assert facts["strands"] == 8
    assert facts["readings"] == {"read": 5, "straight": 1, "unusable": 1, "coarse": 1}
    assert facts["radius_cm"] == pytest.approx({"p10": 0.32, "median": 0.4, "p90": 0.48})
    assert facts["wavelength_cm"] == pytest.approx({"p10": 1.04, "median": 1.2, "p90": 1.36})
    assert facts["twist"] == pytest.approx({"p10": 0.308, "median": 0.34, "p90": 0.372})


def test_lengths_are_those_of_all_that_have_one() -> None:
    expected = np.quantile([10, 11, 12, 13, 14, 30, 25], [0.1, 0.5, 0.9])
    assert list(summary(MIXED)["length_cm"].values()) == pytest.approx(list(expected))


def test_shares_of_types_are_of_strands_that_could_be_read() -> None:
    types = summary(MIXED)["types"]
    assert list(types) == [hair.name for hair in HAIR_TYPES]
    assert types["VI"] == {"walker": "3C to 4A", "strands": 5, "share": pytest.approx(5 / 6)}
    assert types["I"]["share"] == pytest.approx(1 / 6)
    assert sum(about["share"] for about in types.values()) == pytest.approx(1.0)


@pytest.mark.parametrize("strands", [[], [UNUSABLE, UNUSABLE, COARSE]])
def test_where_nothing_could_be_read_there_are_no_numbers(strands: list[Any]) -> None:
    facts = summary(labels_of(*strands))
    assert not is_readable(facts)
    assert facts["radius_cm"] is facts["wavelength_cm"] is facts["twist"] is facts["called"] is None
    assert {about["share"] for about in facts["types"].values()} == {None}
    json.dumps(facts, allow_nan=False)


def test_straight_strands_are_read() -> None:
    facts = summary(labels_of(STRAIGHT, STRAIGHT))
    assert is_readable(facts)
    assert facts["wavelength_cm"] is None
    assert facts["called"] == "straight: all I (1A to 1C)"


def test_every_reading_that_is_none_has_its_reason() -> None:
    assert set(UNREAD) == set(Reading) - {Reading.READ, Reading.STRAIGHT}
    assert why_unread(summary(labels_of(COARSE, COARSE, STRAIGHT))) == f"2 {UNREAD[Reading.COARSE]}"


def test_types_are_called_a_project_estimate_and_twisted_hair_gets_a_warning() -> None:
    assert summary(labels_of(*of_type(SIX)))["caveats"] == [NOISE]
    assert summary(labels_of(*of_type(7)))["caveats"] == [NOISE, TWISTED]


# What hair is called.


def test_each_type_is_called_by_its_group_and_nothing_else() -> None:
    assert sorted(k for types in GROUPS.values() for k in types) == list(range(len(HAIR_TYPES)))
    for word, types in GROUPS.items():
        for kind in types:
            line = called(labels_of(*of_type(kind, 3)))
            assert line is not None
            assert line.startswith(f"{word}: all {HAIR_TYPES[kind].name} ({HAIR_TYPES[kind].walker})")


@pytest.mark.parametrize(
    ("strands", "line"),
    [
        ([*of_type(5, 6), *of_type(6, 4)], "coily: mostly VI (3C to 4A), curls about as wide as a drinking straw"),
        # No type of the group has half of the strands, though the group has most.
        (
            [*of_type(3, 3), *of_type(4, 4), *of_type(7, 3)],
            "curly: IV to V, most often V (3B), curls about as wide as a marker",
        ),
        ([*of_type(5, 9), *of_type(6, 1), *of_type(0, 10)], "straight: mostly I (1A to 1C)"),
        (
            [*of_type(5, 48), *of_type(6, 3), *of_type(0, 49)],
            "coily: most often VI (3C to 4A), curls about as wide as a drinking straw",
        ),
        ([*of_type(2, 8), STRAIGHT, STRAIGHT], "wavy: mostly III (2B to 2C), a wave every 6.00 cm"),
        (
            [*of_type(2, 4), STRAIGHT, *of_type(3, 2), *of_type(5, 3)],
            "mixed: 10 % straight, 40 % wavy, 20 % curly and 30 % coily",
        ),
        # Read as straight, though nearest to another type: no curl to tell the width of.
        ([(0.0, NAN, 0.0, 9.0, SIX, Reading.STRAIGHT)], "coily: all VI (3C to 4A)"),
    ],
)
def test_what_hair_is_called(strands: list[Any], line: str) -> None:
    assert called(labels_of(*strands)) == line


def test_the_width_said_is_that_of_the_hair_named() -> None:
    """Not that of all strands, nor of those without a curl."""
    coily = [*of_type(6, 3), *of_type(7, 3)]
    for others in ([], of_type(3, 4), [(0.0, NAN, 0.0, 9.0, SIX, Reading.STRAIGHT)] * 4):
        assert str(called(labels_of(*coily, *others))).endswith("about as wide as a coffee stirrer")


def test_curls_are_compared_by_their_diameter() -> None:
    for name, (low, high) in DIAMETERS.items():
        for diameter in (low, 0.5 * (low + high), high):
            assert compared(diameter) == f"about as wide as {name}"
    assert compared(0.0) == compared(0.2) == "narrower than a coffee stirrer"
    assert compared(1.0) == "wider than a drinking straw and narrower than a marker"
    assert compared(1.85) == "about as wide as a stick of sidewalk chalk"
    assert compared(4.0) == "wider than a stick of sidewalk chalk"


@pytest.mark.parametrize(
    ("share", "text"), [(0.0, "0 %"), (0.001, "<1 %"), (0.306, "31 %"), (0.999, ">99 %"), (1.0, "100 %")]
)
def test_some_is_never_shown_as_none(share: float, text: str) -> None:
    assert percent(share) == text


# CSV.


def test_table_has_a_row_for_each_strand_and_no_nan(tmp_path: Path) -> None:
    path = tmp_path / "strands.csv"
    write_table(MIXED, path)
    assert path.read_bytes().count(b"\r") == 0
    rows = list(csv.DictReader(path.open(encoding="utf-8")))
    assert tuple(rows[0]) == COLUMNS
    assert list(rows[1].values()) == ["1", "0.35", "1.1", "0.32", "11", "VI", "3C to 4A", "read"]
    assert list(rows[5].values()) == ["5", "0", "", "0", "30", "I", "1A to 1C", "straight"]
    assert list(rows[6].values()) == ["6", "", "", "", "25", "", "", "coarse"]
    assert list(rows[7].values()) == ["7", "", "", "", "", "", "", "unusable"]
    assert len(rows) == 8


def test_table_is_whole_or_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "strands.csv"
    path.write_text("mine")

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(WriteError, match="No space"):
        write_table(MIXED, path)
    assert path.read_text() == "mine"
    assert [file.name for file in tmp_path.iterdir()] == ["strands.csv"]


# The command.


def test_page_for_a_person(groom: Path, labelled: Any) -> None:
    asked = labelled(MIXED)
    result = invoke(groom, "--unit", "cm", "--quiet")
    assert (result.exit_code, result.stderr, asked) == (0, "", [8])
    lines = [" ".join(line.split()) for line in result.stdout.splitlines()]
    assert lines[0] == str(groom)
    for line in (
        "unit cm, as given",
        "strands 8",
        "curls, waves 5 (62 %)",
        "straight 1 (12 %)",
        "not read 2 (25 %)",
        f"1 {UNREAD[Reading.UNUSABLE]}",
        f"1 {UNREAD[Reading.COARSE]}",
        "radius 0.40 0.32 to 0.48 cm",
        "wavelength 1.20 1.04 to 1.36 cm",
        "twist 0.34 0.31 to 0.37",
        "VI 3C to 4A 83 %",
        "I 1A to 1C 17 %",
        "coily: mostly VI (3C to 4A), curls about as wide as a drinking straw",
        f"({NOISE})",
    ):
        assert line in lines


def test_json_for_programs(groom: Path, labelled: Any) -> None:
    labelled(labels_of(STRAIGHT, UNUSABLE))

    def no_nan(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    result = invoke(groom, "--json", "--quiet")
    facts = json.loads(result.stdout, parse_constant=no_nan)
    assert (result.exit_code, result.stderr) == (0, "")
    assert list(facts) == [
        *("file", "unit", "unit_source", "strands", "readings", "radius_cm", "wavelength_cm", "twist", "length_cm"),
        *("types", "called", "caveats", "notes"),
    ]
    assert facts["file"] == str(groom)
    assert facts["wavelength_cm"] is None
    assert facts["length_cm"] == {"p10": 30.0, "median": 30.0, "p90": 30.0}


def test_a_unit_that_was_guessed_is_said(groom: Path, labelled: Any) -> None:
    labelled(MIXED)
    result = invoke(groom)
    assert "--unit says otherwise" in result.stderr
    assert "cm, guessed from its size" in result.stdout
    assert any("--unit" in note for note in json.loads(invoke(groom, "--json").stdout)["notes"])


def test_per_strand_goes_beside_the_summary(groom: Path, labelled: Any, tmp_path: Path) -> None:
    labelled(MIXED)
    table = tmp_path / "strands.csv"
    result = invoke(groom, "--per-strand", table, "--quiet")
    assert (result.exit_code, result.stderr) == (0, "")
    assert "coily" in result.stdout
    assert len(table.read_text().splitlines()) == 9


def test_no_strand_that_can_be_read_is_an_unusable_input(groom: Path, labelled: Any, tmp_path: Path) -> None:
    labelled(labels_of(UNUSABLE, *[COARSE] * 7))
    table = tmp_path / "strands.csv"
    result = invoke(groom, "--per-strand", table, "--json", "--quiet")
    assert_refused(result, 3, str(groom), "none of its 8 strands", "1 not finite", "7 too few points a turn")
    assert not table.exists()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("missing/strands.csv", ["does not exist"]),
        ("folder.csv", ["a folder"]),
        ("other.obj", [".csv"]),
    ],
)
def test_a_table_that_cannot_be_written_is_refused_before_the_work(
    groom: Path, labelled: Any, tmp_path: Path, name: str, words: list[str]
) -> None:
    asked = labelled(MIXED)
    (tmp_path / "folder.csv").mkdir()
    before = groom.read_bytes()
    assert_refused(invoke(groom, "--per-strand", tmp_path / name), 5, name, *words)
    assert asked == []
    assert groom.read_bytes() == before


def test_a_missing_model_has_its_exit_code(groom: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def label(*_: Any) -> None:
        raise ModelError("labeler.onnx: no such file")

    monkeypatch.setattr(labeling, "label", label)
    assert_refused(invoke(groom, "--quiet"), 4, "labeler.onnx")


def test_a_missing_file_is_an_unreadable_input(tmp_path: Path) -> None:
    assert_refused(invoke(tmp_path / "none.abc"), 3, "none.abc: no such file")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["Missing argument 'IN'", "--explain", "detangled label --help"]),
        (["--json"], ["Missing argument 'IN'"]),
        (["--explain", "--json"], ["--explain"]),
        (["--explain", "4A", "--per-strand", "strands.csv"], ["--explain"]),
        (["groom.abc", "other.abc"], ["other.abc"]),
        (["groom.abc", "--threads", "0"], ["--threads"]),
    ],
)
def test_wrong_usage(arguments: list[str], words: list[str]) -> None:
    assert_refused(invoke(*arguments), 2, *words)


def test_the_list_says_what_the_verb_says() -> None:
    assert VERBS["label"].short_help in invoke("--help").stdout


# Finding one's own hair.


def test_explanation_names_every_type_with_its_numbers() -> None:
    result = invoke("--explain")
    assert (result.exit_code, result.stdout) == (0, explanation() + "\n")
    lines = [" ".join(line.split()) for line in result.stdout.splitlines()]
    for hair, looks in zip(HAIR_TYPES, LOOKS, strict=True):
        row = next(line for line in lines if line.startswith(f"{hair.name} {hair.walker} "))
        assert f" {10 * hair.radius.mean:g} mm {hair.radius.mean:g} cm " in row
        assert f" {10 * hair.wavelength.mean:g} mm {hair.wavelength.mean:g} cm " in row
        assert row.endswith(f" {hair.twist.mean:.2f} {looks}")
    assert list(TWIST_WORDS) == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert all(f"{twist:g} {words}" in lines for twist, words in TWIST_WORDS.items())
    for word in ("own estimate", "x1.5", "kappa 0.42", "noise"):
        assert word in result.stdout


def test_explanation_fits_a_terminal() -> None:
    texts = [explanation(), *(explanation_of(hair.name) for hair in HAIR_TYPES)]
    assert max(len(line) for text in texts for line in text.splitlines()) <= 120
    assert all(text.isascii() for text in texts)


def test_the_page_has_the_numbers_of_the_types() -> None:
    page = (Path(__file__).resolve().parents[1] / "docs" / "find-your-hair.md").read_text(encoding="utf-8")
    for kind, hair in enumerate(HAIR_TYPES):
        word = next(word for word, types in GROUPS.items() if kind in types)
        sizes = f"{10 * hair.radius.mean:g} mm | {10 * hair.wavelength.mean:g} mm | {hair.twist.mean:.2f}"
        assert f"| {hair.name} | {hair.walker} | {word} | {sizes} |\n" in page


@pytest.mark.parametrize(("thing", "letters"), THINGS.items())
def test_things_are_those_that_types_are_asked_for_by(thing: str, letters: str) -> None:
    kind = next(k for k, hair in enumerate(HAIR_TYPES) if hair.name == hair_type(thing).name)
    assert thing in LOOKS[kind], letters
    # In millimetres, as the diameters that measured curls are compared with.
    low, high = next(sizes for name, sizes in DIAMETERS.items() if name.endswith(thing))
    assert f"{10 * low:g} to {10 * high:g} mm" in LOOKS[kind]


@pytest.mark.parametrize(
    ("name", "heading", "beside"),
    [
        ("4A", "VII (4A to 4B), coily", "VI (3C to 4A) and VIII (4B to 4C)"),
        ("straw", "VI (3C to 4A), coily", "V (3B) and VII (4A to 4B)"),
        ("type I", "I (1A to 1C), straight", "II (2A)"),
        ("4b", "VII-VIII (4B), coily", "VII (4A to 4B) and VIII (4B to 4C)"),
    ],
)
def test_one_type_explained(name: str, heading: str, beside: str) -> None:
    lines = invoke("--explain", name).stdout.splitlines()
    assert lines[0] == heading
    assert any(line.split() == ["beside", "it", *beside.split()] for line in lines)
    assert "noise" in lines[-1]


def test_the_range_of_a_type_holds_four_strands_of_five() -> None:
    drawn = hair_type("VI").sample(np.random.default_rng(1), 20_000)
    low, high = 10.0 * np.quantile(drawn[:, 0], [0.1, 0.9])
    said = next(line for line in explanation_of("VI").splitlines() if line.startswith("  radius"))
    assert said.endswith(f"{low:.1f} to {high:.1f} mm")


@pytest.mark.parametrize("name", ["5Z", "4", "groom.abc"])
def test_a_type_that_there_is_not(name: str) -> None:
    with pytest.raises(TextureError):
        explanation_of(name)
    assert_refused(invoke("--explain", name), 2, name)


def test_made_up_labels_are_of_the_types_they_say() -> None:
    """Else these tests would be of hair that there is not."""
    values = np.array([(h.radius.mean, h.wavelength.mean, h.twist.mean) for h in HAIR_TYPES])
    assert nearest_types(*values.T).tolist() == list(range(len(HAIR_TYPES)))
