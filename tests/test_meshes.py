"""Heads in mesh files: groups, units, texture coordinates, faces that look outwards; and what cannot be used."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import imath
import numpy as np
import pytest
import trimesh
from alembic3d import Abc, AbcGeom
from numpy.typing import NDArray

from detangled.errors import ReadError
from detangled.formats.abc_values import filled
from detangled.formats.meshes import read_head
from detangled.head import Head

# A box of 20 x 26 x 22 as quads, counter-clockwise from outside.
BOX_POINTS = np.array([[x, y, z] for x in (0, 20) for y in (0, 26) for z in (0, 22)], dtype=float)
BOX_QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
BOX_VOLUME = 20.0 * 26.0 * 22.0


def volume(head: Head) -> float:
    a, b, c = (head.vertices[head.faces[:, k]] for k in range(3))
    return float(np.einsum("fc,fc->", a, np.cross(b, c)) / 6.0)


def obj_text(points: NDArray[np.float64], quads: NDArray[np.int64], head: str = "") -> str:
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
    return head + "\n".join(lines + ["f " + " ".join(str(k + 1) for k in quad) for quad in quads]) + "\n"


@pytest.fixture
def box(tmp_path: Path) -> Path:
    path = tmp_path / "box.obj"
    path.write_text(obj_text(BOX_POINTS, BOX_QUADS))
    return path


def test_polygons_become_triangles_that_look_outwards(box: Path) -> None:
    head = read_head(box, unit="cm")
    assert head.faces.shape == (12, 3)
    assert volume(head) == pytest.approx(BOX_VOLUME)
    assert head.notes == ()
    inward = box.with_name("inward.obj")
    inward.write_text(obj_text(BOX_POINTS, BOX_QUADS[:, ::-1]))
    turned = read_head(inward, unit="cm")
    assert volume(turned) == pytest.approx(BOX_VOLUME)
    assert turned.notes == ("its faces looked inwards: turned over",)


def test_faces_that_look_to_different_sides_are_made_to_agree(box: Path) -> None:
    quads = BOX_QUADS.copy()
    quads[[1, 4]] = quads[[1, 4], ::-1]
    box.write_text(obj_text(BOX_POINTS, quads))
    head = read_head(box, unit="cm")
    assert volume(head) == pytest.approx(BOX_VOLUME)
    assert any("another way than their neighbours" in note for note in head.notes)


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".glb"])
def test_other_formats_say_the_same(tmp_path: Path, suffix: str) -> None:
    mesh = trimesh.creation.box((20.0, 26.0, 22.0))
    mesh.export(tmp_path / f"box{suffix}")
    head = read_head(tmp_path / f"box{suffix}", unit="cm")
    assert volume(head) == pytest.approx(BOX_VOLUME)
    assert len(head.vertices) == 8


def test_a_glb_is_in_metres_and_its_nodes_are_placed(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for name, x in (("head", 0.0), ("hat", 0.5)):
        place = trimesh.transformations.translation_matrix([x, 0.0, 0.0])
        scene.add_geometry(trimesh.creation.box((0.2, 0.2, 0.2)), node_name=name, geom_name=name, transform=place)
    scene.export(tmp_path / "two.glb")
    both = read_head(tmp_path / "two.glb")
    assert both.unit_cm == 100.0
    np.testing.assert_allclose([both.vertices[:, 0].min(), both.vertices[:, 0].max()], [-10.0, 60.0], atol=1e-4)
    hat = read_head(tmp_path / "two.glb", group="hat")
    np.testing.assert_allclose([hat.vertices[:, 0].min(), hat.vertices[:, 0].max()], [40.0, 60.0], atol=1e-4)
    with pytest.raises(ReadError, match=r"no mesh wig: it has .*hat"):
        read_head(tmp_path / "two.glb", group="wig")
    assert len(read_head(tmp_path / "two.glb", group="hat, head").faces) == 24
    with pytest.raises(ReadError, match=r"no mesh ears, wig: it has .*hat"):
        read_head(tmp_path / "two.glb", group="hat,wig,ears")
    with pytest.raises(ReadError, match=r"no mesh ' ,': it has .*hat"):
        read_head(tmp_path / "two.glb", group=" ,")


def test_an_alembic_mesh_below_a_transform(tmp_path: Path) -> None:
    archive = Abc.OArchive(str(tmp_path / "head.abc"))
    place = AbcGeom.OXform(archive.getTop(), "place")
    sample = AbcGeom.XformSample()
    sample.setMatrix(imath.M44d(2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 5, 0, 0, 1))
    place.getSchema().set(sample)
    mesh = AbcGeom.OPolyMesh(place, "head")
    corners = BOX_QUADS[:, ::-1].ravel()  # Alembic's are clockwise
    uv = np.arange(2 * len(corners)).reshape(-1, 2) / 10.0
    mesh.getSchema().set(
        AbcGeom.OPolyMeshSchemaSample(
            filled(imath.V3fArray, BOX_POINTS),
            filled(imath.IntArray, corners),
            filled(imath.IntArray, np.full(6, 4)),
            AbcGeom.OV2fGeomParamSample(filled(imath.V2fArray, uv), AbcGeom.GeometryScope.kFacevaryingScope),
        )
    )
    del mesh, place, archive
    head = read_head(tmp_path / "head.abc", unit="cm")
    assert volume(head) == pytest.approx(8.0 * BOX_VOLUME)
    assert head.notes == ()
    assert head.vertices[:, 0].min() == 5.0
    # Each triangle's corners keep what the file gives them.
    given = {(tuple(2.0 * BOX_POINTS[c] + [5, 0, 0]), tuple(np.float32(t))) for c, t in zip(corners, uv, strict=True)}
    assert head.uv is not None
    for face, own in zip(head.faces, head.uv, strict=True):
        for vertex, texture in zip(face, own, strict=True):
            assert (tuple(head.vertices[vertex]), tuple(np.float32(texture))) in given


def test_groups_are_chosen(box: Path) -> None:
    far = BOX_POINTS + np.array([100.0, 0, 0])
    text = obj_text(BOX_POINTS, BOX_QUADS, "g body\n") + "g helper-hat joint\n" + obj_text(far, BOX_QUADS + 8)
    box.write_text(text)
    body = read_head(box, unit="cm")
    assert body.vertices[:, 0].max() == 20.0
    assert "took the faces of body, not of helper-hat, joint" in body.notes[0]
    assert read_head(box, unit="cm", group="joint").vertices[:, 0].min() == 100.0
    assert len(read_head(box, unit="cm", group="body, joint").faces) == 24
    with pytest.raises(ReadError, match="no group ears: it has body, helper-hat, joint"):
        read_head(box, group="ears")
    box.write_text("\n".join(f"  {line}" for line in text.splitlines()))
    assert read_head(box, unit="cm").vertices[:, 0].max() == 20.0


@pytest.mark.parametrize("content", [obj_text(BOX_POINTS, BOX_QUADS), "v 0 0 0\nf 1 2 3\n"])
def test_trimesh_tells_its_log_again_after_a_head_is_read(box: Path, content: str) -> None:
    box.write_text(content)
    log = logging.getLogger("trimesh")
    before = log.level
    log.setLevel(logging.INFO)
    try:
        read_head(box)
    except ReadError:
        assert len(content) < 20
    finally:
        after = log.level
        log.setLevel(before)
    assert after == logging.INFO


def test_tiles_beyond_the_first_are_kept(box: Path) -> None:
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in BOX_POINTS)
    text += "".join(f"vt {u} {v}\n" for u in (0.25, 1.75) for v in (0.5, 2.5))
    text += "".join("f " + " ".join(f"{p + 1}/{k + 1}" for k, p in enumerate(q)) + "\n" for q in BOX_QUADS)
    box.write_text(text)
    head = read_head(box, unit="cm")
    assert len(head.vertices) == 8  # corners of several texture coordinates are one vertex
    assert head.uv is not None
    assert {tuple(corner) for corner in head.uv.reshape(-1, 2)} == {(0.25, 0.5), (0.25, 2.5), (1.75, 0.5), (1.75, 2.5)}


@pytest.mark.parametrize(("scale", "unit_cm"), [(0.01, 100.0), (0.1, 10.0), (1.0, 1.0), (10.0, 0.1), (0.065, 100.0)])
def test_the_unit_is_guessed_from_the_size(box: Path, scale: float, unit_cm: float) -> None:
    box.write_text(obj_text(scale * BOX_POINTS, BOX_QUADS))
    head = read_head(box)
    assert head.unit_cm == unit_cm
    assert "--head-unit" in head.notes[0]
    np.testing.assert_allclose(np.ptp(head.vertices, axis=0), scale * unit_cm * np.array([20, 26, 22]), rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.obj", b"", "empty"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\nl 1 2\n", "no faces"),
        ("lost.obj", b"v 0 0 0\nf 1 2 3\n", "damaged"),
        ("flat.obj", b"v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\nf 1 1 3\n", "no faces"),
        ("rubbish.ply", b"rubbish" * 20, "damaged"),
        ("rubbish.glb", b"rubbish" * 20, "damaged"),
        ("rubbish.abc", b"rubbish" * 20, "Alembic"),
        ("head.fbx", b"x", "not known as heads"),
    ],
)
def test_what_cannot_be_used_is_refused(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ReadError, match=words) as caught:
        read_head(tmp_path / name)
    assert name in str(caught.value)


def test_missing_files_are_refused(tmp_path: Path) -> None:
    for name in ("none.obj", "none.abc"):
        with pytest.raises(ReadError, match="no such file"):
            read_head(tmp_path / name)
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(ReadError, match="folder"):
        read_head(tmp_path / "folder.obj")


# ---- real ones


def test_makehuman(grooms: Callable[[str], Path]) -> None:
    head = read_head(grooms("heads/makehuman_base.obj"))
    assert head.unit_cm == 10.0
    assert len(head.faces) == 26756  # 13,378 quads of the group `body` alone
    assert np.ptp(head.vertices[:, 1]) == pytest.approx(166.6, abs=0.1)
    assert head.uv is not None
    assert head.uv.max() <= 1.0
    assert volume(head) > 5e4


def test_ict(grooms: Callable[[str], Path]) -> None:
    head = read_head(grooms("heads/ict_head.obj"))
    assert head.unit_cm == 1.0
    assert head.uv is not None
    tiles, counts = np.unique(np.floor(head.uv.mean(axis=1)), axis=0, return_counts=True)
    assert tiles.tolist() == [[0.0, 0.0], [1.0, 0.0]]
    assert counts.min() > 9000
    assert "M_Teeth" in head.notes[0]
    assert len(read_head(grooms("heads/ict_head.obj"), group="M_BackHead").faces) == 9608


def test_vitruvian(grooms: Callable[[str], Path]) -> None:
    head = read_head(grooms("heads/vitruvian_head.obj"))
    assert head.unit_cm == 100.0
    assert head.uv is None
    assert np.ptp(head.vertices[:, 1]) == pytest.approx(29.6, abs=0.1)
