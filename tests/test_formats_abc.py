"""The traps of Alembic files, each in a file made here, and real files of Blender's."""

from __future__ import annotations

from itertools import pairwise

import imath
import numpy as np
import pytest
from alembic3d import Abc, AbcGeom
from scipy.interpolate import BSpline

from detangled import formats
from detangled.errors import ReadError, WriteError
from detangled.formats import abc_check, abc_write
from detangled.formats.abc_values import filled
from detangled.formats.curve_bases import SAMPLES_PER_SPAN, SmoothCurves
from detangled.groom import Attribute, Groom, Scope
from test_formats import all_attributes, strands

LINEAR, CUBIC, VARIABLE = (
    AbcGeom.CurveType.kLinear,
    AbcGeom.CurveType.kCubic,
    AbcGeom.CurveType.kVariableOrder,
)
NO_BASIS, BSPLINE, BEZIER, CATMULL = (
    AbcGeom.BasisType.kNoBasis,
    AbcGeom.BasisType.kBsplineBasis,
    AbcGeom.BasisType.kBezierBasis,
    AbcGeom.BasisType.kCatmullromBasis,
)


def curves_sample(points, counts, kind=LINEAR, basis=NO_BASIS, knots=(), orders=()):
    sample = AbcGeom.OCurvesSchemaSample(
        filled(imath.V3fArray, np.asarray(points, dtype=np.float32)),
        filled(imath.IntArray, np.asarray(counts)),
        kind,
    )
    sample.setBasis(basis)
    if len(knots):
        sample.setKnots(filled(imath.FloatArray, np.asarray(knots, dtype=np.float32)))
    if len(orders):
        sample.setOrders(filled(imath.UnsignedCharArray, np.asarray(orders, dtype=np.uint8)))
    return sample


def transform(parent, name, matrix, inherits=True):
    sample = AbcGeom.XformSample()
    sample.setMatrix(imath.M44d(*np.asarray(matrix, dtype=float).ravel().tolist()))
    sample.setInheritsXforms(inherits)
    node = AbcGeom.OXform(parent, name)
    node.getSchema().set(sample)
    return node


def write_one(path, *arguments, **options):
    archive = Abc.OArchive(str(path))
    AbcGeom.OCurves(archive.getTop(), "hair").getSchema().set(curves_sample(*arguments, **options))


def matrix_of(rng):
    matrix = np.eye(4)
    matrix[:3, :3] = rng.normal(size=(3, 3))
    matrix[3, :3] = rng.normal(size=3)
    return matrix


def moved(points, matrix):
    return (np.column_stack([points, np.ones(len(points))]) @ matrix)[:, :3]


def test_every_transform_above_is_applied(tmp_path):
    rng = np.random.default_rng(1)
    points = rng.normal(size=(6, 3)).astype(np.float32)
    outer, inner, free = matrix_of(rng), matrix_of(rng), matrix_of(rng)

    def build():
        archive = Abc.OArchive(str(tmp_path / "a.abc"))
        top = transform(archive.getTop(), "outer", outer)
        nested = transform(top, "inner", inner)
        alone = transform(top, "alone", free, inherits=False)
        for parent, name in ((nested, "one"), (alone, "two"), (archive.getTop(), "three")):
            AbcGeom.OCurves(parent, name).getSchema().set(curves_sample(points, [3, 3]))

    build()
    groom = formats.read(tmp_path / "a.abc", "cm")
    assert groom.objects == ("one", "two", "three")
    assert groom.attributes["object"].values.tolist() == [0, 0, 1, 1, 2, 2]
    expected = np.concatenate([moved(points, inner @ outer), moved(points, free), points])
    np.testing.assert_allclose(groom.points, expected, rtol=1e-6, atol=1e-6)


def test_transforms_reach_widths_and_normals(tmp_path):
    turn = np.eye(4)
    turn[:3, :3] = 0.01 * np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])

    def build():
        archive = Abc.OArchive(str(tmp_path / "a.abc"))
        sample = curves_sample(np.eye(3), [3])
        scope = AbcGeom.GeometryScope.kVertexScope
        sample.setWidths(AbcGeom.OFloatGeomParamSample(filled(imath.FloatArray, np.ones(3)), scope))
        sample.setNormals(AbcGeom.ON3fGeomParamSample(filled(imath.V3fArray, np.eye(3)), scope))
        AbcGeom.OCurves(transform(archive.getTop(), "x", turn), "c").getSchema().set(sample)

    build()
    groom = formats.read(tmp_path / "a.abc", "cm")
    np.testing.assert_allclose(groom.attributes["width"].values, 0.01, rtol=1e-6)
    np.testing.assert_allclose(groom.attributes["N"].values, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-6)


def test_meshes_are_skipped_and_named(tmp_path):
    def build(name, curves):
        archive = Abc.OArchive(str(tmp_path / name))
        AbcGeom.OPolyMesh(archive.getTop(), "scalp").getSchema().set(
            AbcGeom.OPolyMeshSchemaSample(
                filled(imath.V3fArray, np.eye(3)),
                filled(imath.IntArray, [0, 1, 2]),
                filled(imath.IntArray, [3]),
            )
        )
        if curves:
            AbcGeom.OCurves(archive.getTop(), "hair").getSchema().set(curves_sample(np.eye(3), [3]))

    build("both.abc", True)
    assert "skipped what is not curves: scalp" in formats.read(tmp_path / "both.abc", "cm").notes
    build("mesh.abc", False)
    with pytest.raises(ReadError, match="holds no curves, only the meshes scalp"):
        formats.read(tmp_path / "mesh.abc")


def test_of_several_time_samples_the_first_is_read(tmp_path):
    def build():
        archive = Abc.OArchive(str(tmp_path / "a.abc"))
        schema = AbcGeom.OCurves(archive.getTop(), "hair").getSchema()
        for shift in range(5):
            schema.set(curves_sample(np.eye(3) + shift, [3]))

    build()
    groom = formats.read(tmp_path / "a.abc", "cm")
    np.testing.assert_array_equal(groom.points, np.eye(3))
    assert groom.notes == ("5 time samples, only the first is kept",)


def test_scope_comes_from_the_count(tmp_path):
    # As Blender writes them: no scope, one UV and one normal a curve.
    constant = AbcGeom.GeometryScope.kConstantScope

    def build():
        archive = Abc.OArchive(str(tmp_path / "a.abc"))
        sample = curves_sample(np.zeros((6, 3)), [4, 2])
        sample.setUVs(AbcGeom.OV2fGeomParamSample(filled(imath.V2fArray, [[0, 1], [2, 3]]), constant))
        sample.setNormals(AbcGeom.ON3fGeomParamSample(filled(imath.V3fArray, np.eye(3)[:2]), constant))
        sample.setWidths(AbcGeom.OFloatGeomParamSample(filled(imath.FloatArray, np.arange(6)), constant))
        schema = AbcGeom.OCurves(archive.getTop(), "hair").getSchema()
        schema.set(sample)
        odd = AbcGeom.OFloatGeomParam(schema.getArbGeomParams(), "odd", False, constant, 1)
        odd.set(AbcGeom.OFloatGeomParamSample(filled(imath.FloatArray, np.arange(5)), constant))

    build()
    groom = formats.read(tmp_path / "a.abc", "cm")
    assert {k: a.scope for k, a in groom.attributes.items()} == {
        "uv": Scope.STRAND,
        "N": Scope.STRAND,
        "width": Scope.POINT,
    }
    assert groom.attributes["uv"].values.tolist() == [[0, 1], [2, 3]]
    assert groom.notes == ("attribute 'odd' of 'hair' was left out: 5 values for 2 strands of 6 points",)


def test_indexed_parameters_are_expanded_and_user_properties_read(tmp_path):
    def build():
        archive = Abc.OArchive(str(tmp_path / "a.abc"))
        schema = AbcGeom.OCurves(archive.getTop(), "hair").getSchema()
        schema.set(curves_sample(np.zeros((6, 3)), [2, 2, 2]))
        uniform = AbcGeom.GeometryScope.kUniformScope
        index = imath.UnsignedIntArray(filled(imath.DoubleArray, [1, 0, 1]))
        texts = imath.StringArray(2)
        texts[0], texts[1] = "front", "back"
        names = AbcGeom.OStringGeomParam(schema.getArbGeomParams(), "group", True, uniform, 1)
        names.set(AbcGeom.OStringGeomParamSample(texts, index, uniform))
        user = schema.getUserProperties()
        Abc.OStringProperty(user, "tool").setValue("comb")
        Abc.OInt16Property(user, "version").setValue(5)
        Abc.OV3fProperty(user, "centre").setValue(imath.V3f(1, 2, 3))

    build()
    attributes = formats.read(tmp_path / "a.abc", "cm").attributes
    assert attributes["group"].values.tolist() == ["back", "front", "back"]
    assert attributes["group"].scope is Scope.STRAND
    assert attributes["tool"].values.tolist() == ["comb"]
    assert attributes["version"].values.tolist() == [5]
    assert attributes["version"].values.dtype == np.int16
    assert attributes["centre"].values.tolist() == [[1, 2, 3]]
    assert {attributes[n].scope for n in ("tool", "version", "centre")} == {Scope.GROOM}


def test_objects_that_differ_in_their_attributes(tmp_path):
    uniform, constant = AbcGeom.GeometryScope.kUniformScope, AbcGeom.GeometryScope.kConstantScope

    def build():
        archive = Abc.OArchive(str(tmp_path / "a.abc"))
        for name, widths, scope in (("a", [1.0, 2.0], uniform), ("b", [3.0], constant), ("c", None, None)):
            sample = curves_sample(np.zeros((4, 3)), [2, 2])
            if widths:
                sample.setWidths(AbcGeom.OFloatGeomParamSample(filled(imath.FloatArray, widths), scope))
            AbcGeom.OCurves(archive.getTop(), name).getSchema().set(sample)

    build()
    groom = formats.read(tmp_path / "a.abc", "cm")
    assert groom.attributes["width"].values.tolist() == [1, 2, 3, 3, 0, 0]
    assert groom.attributes["width"].scope is Scope.STRAND
    assert groom.notes == ("attribute 'width' is zero or empty in c, which lacks it",)


def test_the_finest_scope_wins_over_all_objects(tmp_path):
    uniform, vertex = AbcGeom.GeometryScope.kUniformScope, AbcGeom.GeometryScope.kVertexScope

    def build():
        archive = Abc.OArchive(str(tmp_path / "a.abc"))
        for name, widths, scope in (("a", [1, 2], uniform), ("b", [3, 4, 5, 6, 7], vertex)):
            sample = curves_sample(np.zeros((5, 3)), [2, 3])
            sample.setWidths(AbcGeom.OFloatGeomParamSample(filled(imath.FloatArray, widths), scope))
            AbcGeom.OCurves(archive.getTop(), name).getSchema().set(sample)

    build()
    groom = formats.read(tmp_path / "a.abc", "cm")
    assert groom.attributes["width"].values.tolist() == [1, 1, 2, 2, 2, 3, 4, 5, 6, 7]


def clamped(rng, count, order=4):
    inner = np.sort(rng.random(count - order))
    return np.concatenate([np.zeros(order), inner, np.ones(order)]).astype(np.float32)


@pytest.mark.parametrize("style", ["full", "maya"])
def test_splines_with_knots_are_evaluated(tmp_path, style):
    rng = np.random.default_rng(2)
    counts = [7, 9, 7, 4, 3]
    points = rng.normal(size=(sum(counts), 3)).astype(np.float32)
    own = [clamped(rng, n) if n >= 4 else np.arange(n + 4, dtype=np.float32) for n in counts]
    knots = np.concatenate([k if style == "full" else k[1:-1] for k in own])
    write_one(tmp_path / "a.abc", points, counts, kind=CUBIC, basis=BSPLINE, knots=knots)
    groom = formats.read(tmp_path / "a.abc", "cm")
    begin = 0
    for strand, (n, t) in enumerate(zip(counts, own, strict=True)):
        controls = points[begin : begin + n]
        begin += n
        if n < 4:
            expected = controls
        else:
            t = t.astype(float)
            breaks = t[3 : n + 1]
            at = np.concatenate([np.linspace(a, b, SAMPLES_PER_SPAN, False) for a, b in pairwise(breaks)])
            expected = BSpline(t, controls.astype(float), 3)(np.append(at, 1.0))
        np.testing.assert_allclose(groom.strand(strand), expected, atol=1e-6)
    assert any("bspline curves: evaluated" in note for note in groom.notes)


def test_orders_of_their_own(tmp_path):
    rng = np.random.default_rng(3)
    points = rng.normal(size=(12, 3)).astype(np.float32)
    knots = np.concatenate([clamped(rng, 6, 3), [0, 0, *range(1, 5), 5, 5]])
    write_one(tmp_path / "a.abc", points, [6, 6], kind=VARIABLE, basis=BSPLINE, knots=knots, orders=[3, 2])
    groom = formats.read(tmp_path / "a.abc", "cm")
    t = knots[:9].astype(float)
    quarter = t[2] + (t[3] - t[2]) / SAMPLES_PER_SPAN
    np.testing.assert_allclose(groom.strand(0)[1], BSpline(t, points[:6].astype(float), 2)(quarter), atol=1e-6)
    np.testing.assert_array_equal(groom.strand(1), points[6:])


def test_uniform_splines_and_the_attributes_on_them(tmp_path):
    rng = np.random.default_rng(4)
    points = rng.normal(size=(8, 3)).astype(np.float32)

    def build():
        archive = Abc.OArchive(str(tmp_path / "a.abc"))
        sample = curves_sample(points, [8], kind=CUBIC, basis=BSPLINE)
        scope = AbcGeom.GeometryScope.kVertexScope
        # A linear function of the position is one of the curve's points too.
        sample.setWidths(AbcGeom.OFloatGeomParamSample(filled(imath.FloatArray, points @ [1, 2, 3]), scope))
        schema = AbcGeom.OCurves(archive.getTop(), "hair").getSchema()
        schema.set(sample)
        ids = AbcGeom.OInt32GeomParam(schema.getArbGeomParams(), "id", False, scope, 1)
        ids.set(AbcGeom.OInt32GeomParamSample(filled(imath.IntArray, np.arange(8)), scope))

    build()
    groom = formats.read(tmp_path / "a.abc", "cm")
    at = 3 + np.arange(5 * SAMPLES_PER_SPAN + 1) / SAMPLES_PER_SPAN
    expected = BSpline(np.arange(12.0), points.astype(float), 3)(at)
    np.testing.assert_allclose(groom.points, expected, atol=1e-6)
    np.testing.assert_allclose(groom.attributes["width"].values, groom.points @ [1, 2, 3], atol=1e-5)
    assert "id" not in groom.attributes
    assert any("'id'" in note for note in groom.notes)


def test_a_circle_is_a_rational_spline():
    controls = np.array([[1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    curve = SmoothCurves(
        np.array([3]),
        "bspline",
        np.array([3]),
        np.array([0, 0, 0, 1, 1, 1.0]),
        np.array([1, np.sqrt(0.5), 1]),
    )
    _, points, notes = curve.to_polylines(controls)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, atol=1e-12)
    assert notes == []


def test_knots_that_do_not_fit_are_said():
    for knots in (np.arange(3.0), np.array([0, 1, 2, 1, 4, 5, 6, 7.0])):
        curve = SmoothCurves(np.array([4]), "bspline", np.array([4]), knots, np.empty(0))
        _, points, notes = curve.to_polylines(np.eye(4)[:, :3])
        assert len(notes) == 1
        uniform = BSpline(np.arange(8.0), np.eye(4)[:, :3], 3)(np.linspace(3, 4, SAMPLES_PER_SPAN + 1))
        np.testing.assert_allclose(points, uniform, atol=1e-12)


def cubic(t):
    return np.stack([t**3 - t, 2 * t**2, 1 - t], axis=-1)


def slope(t):
    return np.stack([3 * t**2 - 1, 4 * t, -np.ones_like(t)], axis=-1)


def test_bezier_and_hermite_spans_follow_a_cubic():
    ends = np.arange(4.0)
    p, m = cubic(ends), slope(ends)
    bezier = [p[0]]
    for i in range(3):
        bezier += [p[i] + m[i] / 3, p[i + 1] - m[i + 1] / 3, p[i + 1]]
    hermite = np.stack([p, m], axis=1).reshape(-1, 3)
    for basis, controls in (("bezier", np.array(bezier)), ("hermite", hermite)):
        counts = np.array([len(controls)])
        curve = SmoothCurves(counts, basis, np.array([4]), np.empty(0), np.empty(0))
        _, points, _ = curve.to_polylines(controls)
        np.testing.assert_allclose(points, cubic(np.linspace(0, 3, 3 * SAMPLES_PER_SPAN + 1)), atol=1e-12)


@pytest.mark.parametrize("doubled", [False, True])
def test_catmull_rom_goes_through_its_points(doubled):
    points = np.random.default_rng(5).normal(size=(6, 3))
    controls = np.concatenate([points[:1], points, points[-1:]]) if doubled else points
    curve = SmoothCurves(np.array([len(controls)]), "catmull-rom", np.array([4]), np.empty(0), np.empty(0))
    counts, found, _ = curve.to_polylines(controls)
    assert counts.tolist() == [5 * SAMPLES_PER_SPAN + 1]
    np.testing.assert_allclose(found[::SAMPLES_PER_SPAN], points, atol=1e-12)


@pytest.mark.parametrize("name", ["eve", "bob", "combover"])
def test_blenders_files_are_the_archives_turned(grooms, name):
    archive, alembic = formats.read(grooms(f"{name}.npz")), formats.read(grooms(f"{name}.abc"))
    x, y, z = archive.points.T
    np.testing.assert_array_equal(alembic.points, np.stack([x, z, -y], axis=1))
    np.testing.assert_array_equal(alembic.offsets, archive.offsets)
    assert alembic.objects == (name,)
    assert (alembic.unit_cm, alembic.unit_source, alembic.up) == (100.0, "size", "y")
    np.testing.assert_allclose(alembic.attributes["width"].values, 0.008, rtol=1e-5)


def test_real_file_survives_a_round_trip(grooms, tmp_path):
    groom = formats.read(grooms("eve.abc"))
    assert formats.write(groom, tmp_path / "a.abc") == []
    back = formats.read(tmp_path / "a.abc")
    np.testing.assert_array_equal(back.points, groom.points)
    np.testing.assert_array_equal(back.attributes["width"].values, groom.attributes["width"].values)


def test_what_alembic_cannot_hold_is_said(tmp_path):
    groom = Groom.from_strands(
        [np.eye(3)],
        attributes={
            "id": Attribute(np.array([2**40]), Scope.STRAND),
            "phase": Attribute(np.array([1j]), Scope.STRAND),
            "frame": Attribute(np.zeros((3, 3, 3)), Scope.POINT),
        },
    )
    lost = formats.write(groom, tmp_path / "a.abc")
    assert [sentence.split("'")[1] for sentence in lost] == ["id", "phase", "frame"]
    attributes = formats.read(tmp_path / "a.abc", "cm").attributes
    assert set(attributes) == {"frame"}
    assert attributes["frame"].values.shape == (3, 9)


@pytest.fixture
def rich(tmp_path):
    """Bytes of an archive with properties of many kinds."""
    rng = np.random.default_rng(6)
    groom = strands(rng)
    formats.write(Groom(groom.points, groom.offsets, all_attributes(groom, rng)), tmp_path / "rich.abc")
    return (tmp_path / "rich.abc").read_bytes()


def test_every_truncation_is_refused(rich, tmp_path):
    path = tmp_path / "cut.abc"
    for length in [1, 4, 5, 8, 15, 16, 17, *range(100, len(rich), 97), len(rich) - 1]:
        path.write_bytes(rich[:length])
        with pytest.raises(ReadError, match=r"cut\.abc"):
            formats.read(path)


def test_flipped_bytes_never_do_worse_than_an_error(rich, tmp_path):
    # Without the check in front of the library some of these end the process.
    rng = np.random.default_rng(7)
    path = tmp_path / "flipped.abc"
    refused = 0
    for trial in range(300):
        damaged = bytearray(rich)
        where = int(rng.integers(len(rich)))
        if trial % 2:
            damaged[where] ^= 1 << int(rng.integers(8))
        else:
            damaged[where : where + 8] = bytes(len(damaged[where : where + 8]))
        path.write_bytes(damaged)
        try:
            formats.read(path, "cm")
        except ReadError:
            refused += 1
    assert refused > 50


def test_sizes_beyond_the_end_are_refused(rich, tmp_path):
    path = tmp_path / "a.abc"
    root = int.from_bytes(rich[8:16], "little")
    entry = int.from_bytes(rich[root + 8 + 3 * 8 :][:8], "little")
    metadata = entry & ((1 << 63) - 1)
    for position, said in ((metadata, "the data at byte"), (root, "the group at byte")):
        damaged = bytearray(rich)
        damaged[position : position + 8] = (1 << 40).to_bytes(8, "little")
        path.write_bytes(damaged)
        with pytest.raises(ReadError, match=f"{said} {position}"):
            formats.read(path)


def test_old_and_unfinished_archives_are_told_apart(rich, tmp_path):
    path = tmp_path / "a.abc"
    for content, said in (
        (b"\x89HDF\r\n\x1a\n" + bytes(64), "HDF5"),
        (rich[:5] + b"\x00" + rich[6:], "did not finish"),
        (rich[:6] + b"\x00\x07" + rich[8:], "version 7"),
        (b"Hello, this is a text", "not an Alembic file"),
    ):
        path.write_bytes(content)
        with pytest.raises(ReadError, match=said):
            formats.read(path)
    path.write_bytes(rich)
    abc_check.check(path)


def test_a_full_disk_is_noticed(tmp_path, monkeypatch):
    def writes_half(groom, path, *frames):
        lost = written(groom, path, *frames)
        path.write_bytes(path.read_bytes()[:-200])
        return lost

    written = abc_write._write
    monkeypatch.setattr(abc_write, "_write", writes_half)
    with pytest.raises(WriteError, match="disk full"):
        formats.write(Groom.from_strands([np.eye(3)]), tmp_path / "a.abc")
    assert list(tmp_path.iterdir()) == []
