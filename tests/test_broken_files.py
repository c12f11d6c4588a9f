"""Files that people break, and what they are told."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from detangled import formats
from detangled.errors import ReadError
from detangled.groom import Attribute, Groom, Scope
from detangled_cli.main import detangled

LINE = b"v 0 0 0\nv 1 1 1\nl 1 2\n"


def invoke(*arguments: str) -> Result:
    return CliRunner().invoke(detangled, list(arguments), prog_name="detangled")


def test_a_zip_of_other_files_is_no_groom(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("readme.txt", "hello")
    with pytest.raises(ReadError, match="needs 'cnt' and 'data'"):
        formats.read(tmp_path / "a.npz")


def test_a_negative_count_is_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", cnt=np.array([3, -1]), data=np.zeros((2, 3)))
    with pytest.raises(ReadError, match="gives strand 1 -1 points"):
        formats.read(tmp_path / "a.npz")


def test_byte_order_marks(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_bytes(b"\xef\xbb\xbf" + LINE)
    assert formats.read(tmp_path / "a.obj").point_counts.tolist() == [2]
    (tmp_path / "b.obj").write_bytes(LINE.decode().encode("utf-16"))
    with pytest.raises(ReadError, match="UTF-16"):
        formats.read(tmp_path / "b.obj")


@pytest.mark.parametrize("text", [b"v 1 2 3\nl 1\n", b"v 3 0 0\nv 3 0 0\nl 1 2\n", b"v nan 0 0\nv 1 1 1\nl 1 2\n"])
def test_a_groom_without_size_has_no_guessed_unit(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "a.obj").write_bytes(text)
    groom = formats.read(tmp_path / "a.obj")
    assert (groom.unit_cm, groom.unit_source) == (1.0, "default")
    assert groom.notes == ("taken as centimetres since it has no size to go by; --unit says otherwise",)
    facts = json.loads(invoke("info", str(tmp_path / "a.obj"), "--json").stdout)
    assert (facts["unusable_strands"], facts["length_cm"]) == (1, None)
    converted = invoke("convert", str(tmp_path / "a.obj"), str(tmp_path / "b.abc"))
    assert converted.exit_code == 0
    assert "1 of the strands cannot be used as hair" in converted.stderr


def test_points_too_far_to_measure(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_bytes(LINE + b"v 1e300 0 0\nl 1 3\n")
    result = invoke("info", str(tmp_path / "a.obj"), "--json")
    assert (result.exit_code, result.stderr) == (0, "")
    facts = json.loads(result.stdout)
    assert (facts["strands"], facts["unusable_strands"]) == (2, 1)


@pytest.mark.parametrize("suffix", [".abc", ".obj"])
def test_an_up_axis_that_a_file_cannot_say_is_said(tmp_path: Path, suffix: str) -> None:
    strands = [np.eye(3), np.eye(3)[:2]]
    assert formats.write(Groom.from_strands(strands), tmp_path / f"a{suffix}") == []
    (sentence,) = formats.write(Groom.from_strands(strands, up="z"), tmp_path / f"a{suffix}")
    assert sentence.startswith("z stays up")


@pytest.mark.parametrize("scope", [Scope.GROOM, Scope.STRAND])
def test_alembic_widths_are_written_for_each_point(tmp_path: Path, scope: Scope) -> None:
    widths = np.array([0.25], dtype=np.float32) if scope is Scope.GROOM else np.array([0.25, 0.5], dtype=np.float32)
    groom = Groom.from_strands([np.eye(3), np.eye(3)[:2]], attributes={"width": Attribute(widths, scope)})
    formats.write(groom, tmp_path / "a.abc")
    back = formats.read(tmp_path / "a.abc", "cm").attributes["width"]
    assert back.scope is Scope.POINT
    assert back.values.tolist() == ([0.25] * 5 if scope is Scope.GROOM else [0.25, 0.25, 0.25, 0.5, 0.5])
