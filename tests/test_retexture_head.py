"""retexture with a head: what is said, what is done, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner, Result

from detangled.errors import ReadError
from detangled.fitting import fit
from detangled.formats import read, write
from detangled.geometry.arc import arc_lengths
from detangled.groom import Attribute, Groom, Scope
from detangled.grooming.guides import style_guides
from detangled.grooming.interpenetration import OnPenetration
from detangled.head import Head
from detangled.retexturing import Length, Options, retexture
from detangled_cli.main import detangled
from heads import RADIUS, head_of, sphere

COILY = Path(__file__).resolve().parents[1] / "examples" / "coily_strands.obj"
COUNT = 5


@pytest.fixture(scope="module")
def hair() -> Groom:
    """Strands along the sphere from its top, the first sunk into it by a little, each with a number."""
    bent = np.linspace(0.0, 0.5 * np.pi, 16)
    strands = []
    for k in range(COUNT):
        radius = RADIUS + 0.1 - (0.05 * 16 * (bent > 0.1) / 16 * 4 if k == 0 else 0.0)
        side = np.stack([np.sin(bent), np.cos(bent), 0.0 * bent], axis=1) * np.reshape(radius * np.ones(16), (16, 1))
        turn = 2 * np.pi * k / COUNT
        about = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
        strands.append(side @ np.array(about).T)
    ids = Attribute(np.arange(10, 10 + COUNT, dtype=np.int32), Scope.STRAND)
    return Groom.from_strands(strands, attributes={"groom_id": ids}, unit_source="file")


@pytest.fixture(scope="module")
def texture() -> object:
    return fit(read(COILY, unit="cm"))


@pytest.mark.parametrize("length", [Length.GUIDE, Length.STRAND])
def test_coils_are_kept_out(hair: Groom, texture: object, length: Length) -> None:
    head = sphere()
    made = {
        wish: retexture(hair, texture, Options(length=length, head=head, on_penetration=wish))  # type: ignore[arg-type]
        for wish in OnPenetration
    }
    kept, out, left = (made[wish] for wish in (OnPenetration.KEEP, OnPenetration.ROTATE, OnPenetration.DELETE))
    assert kept.penetration is not None
    assert out.penetration is not None
    assert left.penetration is not None
    assert kept.penetration.before > 0
    assert kept.penetration.after > 0.05 * kept.penetration.of_after
    assert out.penetration.after <= 0.001 * out.penetration.of_after
    assert left.penetration.after == 0
    assert left.groom.strand_count == COUNT - left.penetration.deleted
    assert out.groom.attributes["groom_id"].values.tolist() == list(range(10, 10 + COUNT))
    np.testing.assert_array_equal(out.groom.points[out.groom.offsets[:-1]], hair.points[hair.offsets[:-1]])
    without = retexture(hair, texture, Options(length=length))  # type: ignore[arg-type]
    np.testing.assert_array_equal(kept.groom.points, without.groom.points)
    assert without.penetration is None
    if length is Length.STRAND:
        reach = arc_lengths(out.groom.points, out.groom.offsets) / arc_lengths(hair.points, hair.offsets)
        np.testing.assert_allclose(reach, 1.0, atol=1e-3)
    else:
        # As long along their axes as the guides are, which were turned or lifted: by finding their axes again.
        again, old = style_guides(out.groom).lengths, style_guides(hair).lengths
        np.testing.assert_allclose(again, old, rtol=0.12)


def test_the_seed_decides_with_a_head_too(hair: Groom, texture: object) -> None:
    options = Options(head=sphere(3), seed=3)
    first, second = (retexture(hair, texture, options).groom.points for _ in range(2))  # type: ignore[arg-type]
    np.testing.assert_array_equal(first, second)
    alone = retexture(hair.select([0, 1]), texture, options).groom  # type: ignore[arg-type]
    assert np.isfinite(alone.points).all()


# ---- the command


@pytest.fixture
def files(hair: Groom, tmp_path: Path) -> tuple[Path, Path]:
    write(replace(hair, unit_cm=100.0), tmp_path / "hair.abc")
    trimesh.Trimesh(sphere(3).vertices / 100.0, sphere(3).faces, process=False).export(tmp_path / "head.obj")
    return tmp_path / "hair.abc", tmp_path / "head.obj"


def run(hair: Path, head: Path, *options: object) -> Result:
    out = hair.with_name("out.abc")
    arguments = ["retexture", hair, out, "--target", COILY, "--unit", "m", "--head", head, *options]
    return CliRunner().invoke(detangled, [str(a) for a in arguments])


def test_the_summary_tells_how_much_was_inside(files: tuple[Path, Path]) -> None:
    done = run(*files, "--head-unit", "m", "--density", "keep")
    assert done.exit_code == 0, done.stderr
    assert "inside the head: " in done.stderr
    assert "points before, " in done.stderr
    assert read(files[0].with_name("out.abc"), unit="m").strand_count == COUNT


def test_other_heads_are_refused_before_any_work(files: tuple[Path, Path]) -> None:
    hair, head = files
    for options, words in (
        (["--head-unit", "cm"], ["100 times too small", "--head-unit m"]),
        (["--head-unit", "dm"], ["10 times too small", "--head-unit m"]),
        (["--head-group", "ears"], ["no group ears"]),
    ):
        done = run(hair, head, *options)
        assert done.exit_code == 3, done.stderr
        assert all(word in done.stderr for word in [*words, "head.obj"]), done.stderr
        assert not hair.with_name("out.abc").exists()
    flat = head.with_name("flat.obj")
    flat.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    assert "no faces" in run(hair, flat).stderr
    assert run(hair, head.with_name("none.obj")).exit_code == 3
    assert run(hair, head, "--on-penetration", "magic").exit_code == 2
    far = head.with_name("far.obj")
    moved = head_of(trimesh.load(head, process=False))
    trimesh.Trimesh(moved.vertices + 0.5, moved.faces, process=False).export(far)
    done = run(hair, far, "--head-unit", "m")
    assert done.exit_code == 3
    assert "does not grow on this head" in done.stderr


def test_a_head_without_faces_is_refused_from_python_too(hair: Groom, texture: object) -> None:
    empty = Head(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int64))
    with pytest.raises(ReadError, match="no faces"):
        retexture(hair, texture, Options(head=empty))  # type: ignore[arg-type]


@pytest.mark.parametrize("verb", ["retexture", "hairs"])
@pytest.mark.parametrize(("count", "code"), [(0, 3), (1, 0), (2, 0)])
def test_a_head_under_so_few_strands_that_they_span_no_scalp(
    hair: Groom, files: tuple[Path, Path], verb: str, count: int, code: int
) -> None:
    few, head = files[0].with_name("few.abc"), files[1]
    write(hair.select(np.arange(1, 1 + count)), few)
    out = few.with_name("out.abc")
    own = {"retexture": ["--target", COILY], "hairs": ["--count", 10]}[verb]
    arguments = [verb, few, out, *own, "--unit", "cm", "--head", head, "--head-unit", "m"]
    done = CliRunner().invoke(detangled, [str(a) for a in arguments])
    assert done.exit_code == code, done.stderr
    if count == 0:
        assert "holds no strands" in done.stderr
        assert not out.exists()
    else:
        made = read(out, unit="cm")
        assert made.strand_count == (count if verb == "retexture" else 10)
        assert np.isfinite(made.points).all()
    if count and verb == "retexture":
        assert "neither curl nor neighbours to tell its density by; it is kept" in done.stderr


def test_a_head_that_is_no_manifold_is_used_and_that_is_said(files: tuple[Path, Path]) -> None:
    hair, head = files
    mesh = trimesh.load(head, process=False)
    inner = len(mesh.vertices)
    wall = [[*mesh.faces[0][:2], inner]]
    odd = trimesh.Trimesh(
        np.concatenate([mesh.vertices, [[0.0, 0.0, 0.0]]]), np.concatenate([mesh.faces, wall]), process=False
    )
    odd.export(head)
    done = run(hair, head, "--head-unit", "m", "--density", "keep")
    assert done.exit_code == 0, done.stderr
    assert "1 edges have more than two faces: what is inside is told by winding numbers" in done.stderr
    made = read(hair.with_name("out.abc"), unit="m")
    assert np.linalg.norm(made.points, axis=1).min() > 0.99 * RADIUS
