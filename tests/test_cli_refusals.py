"""What the command line refuses before it reads a file: files that would be lost, and values that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from detangled import fitting, from_numbers
from detangled.formats import write
from detangled.groom import Groom
from detangled_cli.main import detangled

FILES = ("in.abc", "strands.obj", "head.obj", "old.texture")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Files that nothing could read, and links to them under the suffixes of other outputs."""
    for name in FILES:
        (tmp_path / name).write_text(name)
    for name in ("in.png", "in.csv", "in.html", "in.texture"):
        (tmp_path / name).symlink_to(tmp_path / "in.abc")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    "line",
    [
        "retexture in.abc strands.obj --target strands.obj",
        "retexture in.abc ./head.obj --type 4A --head head.obj",
        "retexture in.abc out.abc --target in.png --preview in.png",
        "retexture in.abc out.abc --type 4A --preview in.png",
        "retexture in.abc out.abc --target strands.obj --report strands.obj",
        "retexture in.abc out.abc --type 4A --report out.abc",
        "retexture in.abc out.abc --type 4A --preview same.png --report ../{folder}/same.png",
        "generate strands.obj --target strands.obj",
        "hairs in.abc head.obj --head head.obj",
        "fit in.abc in.texture",
        "view in.abc in.html",
        "view strands.obj --after in.abc in.html",
        "render strands.obj in.abc in.png",
        "render strands.obj in.png --head in.abc",
        "label in.abc --per-strand in.csv",
    ],
)
def test_no_output_replaces_an_input_or_another_output(folder: Path, line: str) -> None:
    done = CliRunner().invoke(detangled, line.format(folder=folder.name).split())
    assert done.exit_code == 2, done.stderr
    assert "is an input or another output already: name another file" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert all((folder / name).read_text() == name for name in FILES)


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("convert none.abc {long}.npz", 5),
        ("generate {long}.npz --type 4A", 5),
        ("label {long}.npz --per-strand out.csv", 3),
        ("label loop.npz --per-strand out.csv", 3),
        ("render loop.npz out.png", 3),
        ("view in.abc {long}.html --no-labels", 5),
        ("retexture {long}.npz out.npz --type 4A --report loop.npz", 3),
    ],
)
def test_names_too_long_for_a_file_and_links_to_themselves_are_told_in_a_line(
    folder: Path, line: str, code: int
) -> None:
    (folder / "loop.npz").symlink_to("loop.npz")
    done = CliRunner().invoke(detangled, line.format(long="x" * 300).split())
    assert done.exit_code == code, done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    "line",
    [
        "guides points.npz out.npz",
        "hairs points.npz out.npz",
        "fit points.npz out.texture",
        "generate out.npz --target points.npz",
        "retexture points.npz out.npz --target points.npz",
        "retexture points.npz out.npz --type 4A",
    ],
)
def test_a_groom_without_a_strand_to_use_is_refused_by_name_before_any_work(
    folder: Path, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    def worked(*_: object, **__: object) -> None:
        raise AssertionError("a texture was made for a groom that cannot be used")

    monkeypatch.setattr(from_numbers, "asked_texture", worked)
    monkeypatch.setattr(fitting, "fit", worked)
    write(Groom.from_strands([np.zeros((1, 3)), np.full((3, 3), np.nan)]), folder / "points.npz")
    done = CliRunner().invoke(detangled, [*line.split(), "--quiet"])
    assert done.exit_code == 3, done.stderr
    assert "points.npz: none of the 2 strands can be used: each has fewer than two distinct points" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not list(folder.glob("out.*"))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("label --explain 9Z", "unknown hair type '9Z'"),
        ("info none.abc --unit parsec", "--unit: unknown unit 'parsec'"),
        ("convert none.abc out.abc --out-unit 0mm", "--out-unit: unknown unit '0mm'"),
        ("convert none.abc out.abc --out-unit .0000000000001mm", "--out-unit: unknown unit"),
        ("info none.abc --unit 1000000000000m", "--unit: unknown unit"),
        ("retexture none.abc out.abc --type 4A --density some", "auto, keep or a number above zero"),
        ("generate out.abc --type 4A --count some", "--count"),
        ("generate out.abc --type 4A --length 21m", "a strand is made 0.1 to 2000 cm long"),
        ("generate out.abc --type 4A --count 99999999999999", "ask for 1 to 4,000,000"),
        ("hairs none.abc out.abc --count 99999999999999", "ask for 1 to 4,000,000"),
        ("hairs none.abc out.abc --wisp-radius 1e300", "less than 20 m"),
        ("render a.abc b.abc c.abc d.abc e.abc out.png --size 8192", "give --size 7327 or less"),
        ("hairs none.abc out.abc --variation nan", "'--variation': 'nan' is no finite number"),
        ("render none.abc out.png --colour purple", "--colour: 'purple' is not a hair colour"),
        ("render none.abc out.png --color 1/2/3", "--colour: '1/2/3' is not a hair colour"),
        ("render none.abc out.png --zoom nan", "'--zoom': 'nan' is no finite number"),
        ("train denoiser out --data none --learning-rate inf", "'--learning-rate': 'inf' is no finite number"),
        ("train data --out out --count 5 --untyped nan", "'--untyped': 'nan' is no finite number"),
        ("generate out.abc --target old.texture --target-unit mm", "--target-unit goes with strands"),
        ("fit none.obj out.texture --seed 3", "--seed and --training-steps go with --method finetune"),
        ("fit none.obj out.texture --method patches --training-steps 9", "go with --method finetune"),
        ("fit old.texture out.texture", "old.texture is learned already"),
        ("render none.abc out.png --samples 9", "--samples goes with --quality path"),
    ],
)
def test_a_value_that_is_none_is_wrong_usage_before_anything_is_read(folder: Path, line: str, words: str) -> None:
    done = CliRunner().invoke(detangled, line.split())
    assert done.exit_code == 2, done.stderr
    assert words in done.stderr
    assert len(done.stderr.splitlines()) == 1
