"""What retexture does beside texturing: more or fewer style guides, engines, a picture and a report."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner, Result
from numpy.typing import NDArray
from PIL import Image

from detangled import retexturing
from detangled.base_texture import Texture
from detangled.engines import Engine
from detangled.errors import DetangledError
from detangled.fitting import fit
from detangled.formats import read, write
from detangled.groom import Attribute, Groom, Scope
from detangled.grooming import guide_density, keeping_out
from detangled.grooming.density import density_change
from detangled.grooming.guides import style_guides
from detangled.grooming.interpenetration import OnPenetration
from detangled.models import models_folder
from detangled.retexturing import Options, retexture
from detangled.retexturing import Result as Retextured
from detangled_cli.main import detangled
from heads import RADIUS, sphere

COILY = Path(__file__).resolve().parents[1] / "examples" / "coily_strands.obj"


def cap(count: int = 40) -> NDArray[np.float64]:
    """Roots over the top of a head, evenly (Vogel's spiral)."""
    share = (np.arange(count) + 0.5) / count
    down, around = 0.9 * np.sqrt(share), np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    return RADIUS * np.stack([np.sin(down) * np.cos(around), np.cos(down), np.sin(down) * np.sin(around)], axis=1)


@pytest.fixture(scope="module")
def hair() -> Groom:
    """Straight hair that stands out from a head, each strand with a number."""
    along = np.linspace(0.0, 5.0, 8)[:, None]
    strands = [root + along * root / RADIUS for root in cap()]
    ids = Attribute(np.arange(len(strands), dtype=np.int32), Scope.STRAND)
    return Groom.from_strands(strands, attributes={"groom_id": ids}, unit_source="file")


def retextured(hair: Groom, density: float | None, seed: int = 0) -> Retextured:
    texture = fit(read(COILY, unit="cm"))
    return retexture(hair, texture, Options(seed=seed, head=sphere(3), density=density, max_points=60))


def test_twice_the_density_is_about_twice_the_strands_which_grow_on_the_head(hair: Groom) -> None:
    made = retextured(hair, 2.0)
    count = made.groom.strand_count
    assert 1.7 * hair.strand_count < count < 2.2 * hair.strand_count
    assert made.strands == count
    roots = made.groom.points[made.groom.offsets[:-1]]
    np.testing.assert_array_equal(roots[: hair.strand_count], hair.points[hair.offsets[:-1]])
    np.testing.assert_allclose(np.linalg.norm(roots, axis=1), RADIUS, atol=0.1)
    ids = made.groom.attributes["groom_id"].values
    assert ids[: hair.strand_count].tolist() == list(range(hair.strand_count))
    assert len(np.unique(ids)) == count
    assert "style guides: 40 to" in made.notes[0]
    assert made.penetration is not None
    assert made.penetration.after <= 0.001 * made.penetration.of_after


def test_strands_that_were_there_are_the_same_hair_beside_new_ones(hair: Groom) -> None:
    kept, more = retextured(hair, 1.0).groom, retextured(hair, 1.5).groom
    for strand in (0, 7, 39):
        np.testing.assert_array_equal(kept.strand(strand), more.strand(strand))


def test_half_the_density_keeps_half_of_the_strands(hair: Groom) -> None:
    made = retextured(hair, 0.5)
    ids = made.groom.attributes["groom_id"].values
    assert len(ids) == 20
    roots = made.groom.points[made.groom.offsets[:-1]]
    np.testing.assert_array_equal(roots, hair.points[hair.offsets[:-1]][ids])


def test_the_texture_decides_how_many_there_are(hair: Groom) -> None:
    texture = fit(read(COILY, unit="cm"))
    change = density_change(style_guides(hair), texture.radius)
    made = retextured(hair, None)
    assert change.factor > 1.5
    assert made.groom.strand_count == pytest.approx(change.factor * hair.strand_count, rel=0.1)


def test_hair_that_has_to_be_turned_out_of_the_head_is_as_dense_as_other_hair(hair: Groom) -> None:
    """Straight hair that dips into the head: turned, it is no curlier than it was."""
    sunk = []
    for root in cap():
        side = np.cross(root, [0.3, 0.0, 1.0])
        along = np.linspace(0.0, 5.0, 8)[:, None]
        sunk.append(root + along * (side / np.linalg.norm(side) - 0.25 * root / RADIUS))
    counts = [retextured(groom, None).groom.strand_count for groom in (hair, Groom.from_strands(sunk))]
    assert counts[1] > 0.8 * counts[0]


def test_a_damaged_strand_is_told_by_its_number_where_others_are_deleted(
    hair: Groom, monkeypatch: pytest.MonkeyPatch
) -> None:
    far = np.array([[0.0, RADIUS, 0.0], [0.0, 1e10, 0.0]])
    ids = {"groom_id": Attribute(np.arange(4, dtype=np.int32), Scope.STRAND)}
    groom = Groom.from_strands([hair.strand(0), hair.strand(1), far, hair.strand(2)], attributes=ids)
    asked = []

    def first_enters(points: NDArray[np.float64], offsets: NDArray[np.int64], *_: object) -> NDArray[np.bool_]:
        asked.append(len(offsets) - 1)
        return np.arange(len(offsets) - 1) == 0

    monkeypatch.setattr(keeping_out, "entering", first_enters)
    options = Options(head=sphere(3), on_penetration=OnPenetration.DELETE, max_points=60)
    made = retexture(groom, fit(read(COILY, unit="cm")), options)
    assert asked[-1] == 3  # never of a strand that is kilometres long
    names = made.groom.attributes["groom_id"].values.tolist()
    assert 0 not in names
    (passed,) = made.passed_through.tolist()
    assert names[passed] == 2
    assert made.strands == len(names) - 1
    np.testing.assert_array_equal(made.groom.strand(passed), far)


def test_strands_do_not_depend_on_how_many_are_made_at_once_and_one_engine_makes_all(
    hair: Groom, monkeypatch: pytest.MonkeyPatch
) -> None:
    texture = fit(read(COILY, unit="cm"))
    whole = retexture(hair, texture)
    engines = []

    def engine_of(texture: Texture) -> Engine:
        engines.append(whole_engine_of(texture))
        return engines[-1]

    whole_engine_of = retexturing.engine_of
    monkeypatch.setattr(retexturing, "CHUNK", 16)
    monkeypatch.setattr(retexturing, "engine_of", engine_of)
    np.testing.assert_array_equal(retexture(hair, texture).groom.points, whole.groom.points)
    assert len(engines) == 1


# ---- the command


@pytest.fixture
def files(hair: Groom, tmp_path: Path) -> tuple[Path, Path]:
    write(replace(hair, unit_cm=100.0), tmp_path / "hair.abc")
    mesh = sphere(3)
    trimesh.Trimesh(mesh.vertices / 100.0, mesh.faces, process=False).export(tmp_path / "head.obj")
    return tmp_path / "hair.abc", tmp_path / "head.obj"


def run(hair: Path, *options: object) -> Result:
    given = ["retexture", hair, hair.with_name("out.abc"), "--target", COILY, "--unit", "m", "--max-points", 60]
    return CliRunner().invoke(detangled, [str(a) for a in [*given, *options]])


def test_with_a_head_the_texture_decides_and_without_one_all_stay(files: tuple[Path, Path]) -> None:
    hair, head = files
    counts = []
    for options in ((), ("--head", head, "--head-unit", "m"), ("--density", "auto"), ("--density", 0.5)):
        done = run(hair, *options)
        assert done.exit_code == 0, done.stderr
        counts.append(read(hair.with_name("out.abc"), unit="m").strand_count)
    assert counts[0] == 40
    assert counts[1] > 60
    assert counts[2] > 60
    assert counts[3] == 20


@pytest.mark.parametrize("density", ["none", "0", "-2", "nan", "inf"])
def test_a_density_that_is_none_is_refused(files: tuple[Path, Path], density: str) -> None:
    done = run(files[0], "--density", density)
    assert done.exit_code == 2
    assert "auto, keep or a number above zero" in done.stderr
    assert not files[0].with_name("out.abc").exists()


def test_more_strands_than_are_made_are_refused_before_any_work(files: tuple[Path, Path]) -> None:
    done = run(files[0], "--density", "1e9")
    assert done.exit_code == 3
    (line,) = done.stderr.splitlines()
    assert "at most 4,000,000 are made" in line
    assert not files[0].with_name("out.abc").exists()


def test_more_points_than_are_made_are_refused_before_any_are(
    hair: Groom, files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(guide_density, "resampled", None)
        done = run(files[0], "--density", "90000", "--max-points", "1000000")
    assert done.exit_code == 3
    *_, line = done.stderr.splitlines()
    words = r"3,600,000 strands would have \S+ points: at most 250,000,000 are made; lower --density or --max-points"
    assert re.search(words, line)
    coily = fit(read(COILY, unit="cm"))
    made = retexture(hair, coily).groom
    monkeypatch.setattr("detangled.grooming.density.MOST_POINTS", int(0.79 * len(made.points)))
    for factor in (1.0, None):
        with pytest.raises(DetangledError, match="lower --density or --max-points"):
            retexture(hair, coily, Options(density=factor))
    monkeypatch.setattr("detangled.grooming.density.MOST_POINTS", int(1.2 * len(made.points)))
    assert len(retexture(hair, coily).groom.points) == len(made.points)


def test_a_target_in_far_too_small_a_unit_is_refused_at_once(files: tuple[Path, Path]) -> None:
    done = run(files[0], "--target-unit", ".001mm")
    assert done.exit_code == 3
    *_, line = done.stderr.splitlines()
    assert "hair of 5 cm would have" in line
    assert "at most 10,000 are made: say the unit of the texture's strands (--target-unit" in line
    assert not files[0].with_name("out.abc").exists()


def test_a_preset_makes_a_file_that_its_engine_takes(files: tuple[Path, Path]) -> None:
    done = run(files[0], "--preset", "unreal")
    assert done.exit_code == 0, done.stderr
    out = files[0].with_name("out.abc")
    checked = CliRunner().invoke(detangled, ["validate", str(out), "--preset", "unreal"])
    assert checked.exit_code == 0, checked.output


def test_a_report_and_a_picture_say_what_was_done(files: tuple[Path, Path], tmp_path: Path) -> None:
    hair, head = files
    report, preview = tmp_path / "report.json", tmp_path / "preview.png"
    more = ("--head", head, "--head-unit", "m", "--density", "keep", "--seed", 3)
    done = run(hair, "--report", report, "--preview", preview, *more)
    assert done.exit_code == 0, done.stderr
    facts = json.loads(report.read_text())
    out = read(hair.with_name("out.abc"), unit="m")
    assert facts["seed"] == 3
    assert facts["strands"] == {"before": 40, "retextured": 40, "after": 40, "passed_through": []}
    assert facts["points"] == {"before": 320, "after": len(out.points)}
    assert facts["guides"] == {"before": 40, "after": 40}
    assert facts["labels"]["before"]["readings"]["straight"] == 40
    assert facts["labels"]["after"]["readings"]["read"] == 40
    assert facts["arc_length_cm"]["after"]["median"] > 1.5 * facts["arc_length_cm"]["before"]["median"]
    assert facts["penetration"]["of_before"] > 0
    assert set(facts["seconds"]) >= {"read", "texture", "strands", "write", "total"}
    manifest = json.loads((models_folder() / "labeler.json").read_text())
    assert facts["models"]["labeler"]["sha256"] == manifest["sha256"]
    assert Image.open(preview).size[0] > 2000


@pytest.mark.parametrize("name", ["hair.abc", "out.abc", "head.obj"])
def test_a_report_replaces_no_groom_and_no_head(files: tuple[Path, Path], name: str) -> None:
    hair, head = files
    done = run(hair, "--head", head, "--head-unit", "m", "--report", hair.with_name(name))
    assert done.exit_code == 2
    assert "name another file" in done.stderr
    assert not hair.with_name("out.abc").exists()


@pytest.mark.parametrize(
    ("option", "name"), [("--preview", "no/such.png"), ("--preview", "picture.txt"), ("--report", "no/r.json")]
)
def test_what_cannot_be_written_is_told_before_any_work(files: tuple[Path, Path], option: str, name: str) -> None:
    done = run(files[0], option, files[0].parent / name)
    assert done.exit_code == 5, done.stderr
    assert not files[0].with_name("out.abc").exists()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("--on-penetration", "delete"), "--on-penetration goes with --head"),
        (("--head-unit", "m"), "go with --head"),
    ],
)
def test_what_goes_with_a_head_is_refused_without_one(
    files: tuple[Path, Path], given: tuple[str, ...], words: str
) -> None:
    done = run(files[0], *given)
    assert done.exit_code == 2
    assert words in done.stderr


def test_a_file_that_the_engine_does_not_import_is_refused_at_once(files: tuple[Path, Path]) -> None:
    hair = files[0]
    for verb in (["convert"], ["retexture", "--type", "4B"]):
        given = [verb[0], hair, hair.with_name("o.obj"), *verb[1:], "--preset", "unity"]
        done = CliRunner().invoke(detangled, [str(a) for a in given])
        assert done.exit_code == 2
        assert "Unity imports .abc, not" in done.stderr
