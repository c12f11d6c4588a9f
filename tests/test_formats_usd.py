"""USD: what we write, read by usd-core alone; what others may write, made by usd-core alone and read by us."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from detangled import formats
from detangled.errors import ReadError, WriteError
from detangled.formats.curve_bases import SAMPLES_PER_SPAN
from detangled.formats.usd_check import _unpacked
from detangled.groom import Attribute, Groom, Scope

pxr: Any = pytest.importorskip("pxr", reason="needs usd-core: pip install 'detangled[usd]'")
from pxr import Gf, Sdf, Usd, UsdGeom, Vt  # noqa: E402

SUFFIXES = (".usd", ".usda", ".usdc")
T = UsdGeom.Tokens
CURVES = '#usda 1.0\ndef BasisCurves "hair"\n{{\npoint3f[] points = [(0, 0, 0)]\nint[] curveVertexCounts = [{}]\n}}\n'


def stage_at(path: Path, metres: float | None = 0.01, up: str = "Y") -> Any:
    stage = Usd.Stage.CreateNew(str(path))
    if metres is not None:
        UsdGeom.SetStageMetersPerUnit(stage, metres)
    UsdGeom.SetStageUpAxis(stage, up)
    return stage


def curves_in(stage: Any, where: str, points: NDArray[Any], counts: list[int], **tokens: Any) -> Any:
    curves = UsdGeom.BasisCurves.Define(stage, where)
    curves.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.asarray(points, dtype=np.float32)))
    curves.CreateCurveVertexCountsAttr(counts)
    curves.CreateTypeAttr(tokens.get("type", T.linear))
    if "basis" in tokens:
        curves.CreateBasisAttr(tokens["basis"])
    if "wrap" in tokens:
        curves.CreateWrapAttr(tokens["wrap"])
    return curves


def smooth(path: Path, points: NDArray[Any], counts: list[int], basis: Any, wrap: Any) -> Groom:
    stage = stage_at(path)
    curves_in(stage, "/hair", points, counts, type=T.cubic, basis=basis, wrap=wrap)
    stage.Save()
    del stage
    return formats.read(path)


# ---- ours, read by usd-core


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("up", ["y", "z"])
def test_usd_core_reads_what_we_write(tmp_path: Path, suffix: str, up: str) -> None:
    rng = np.random.default_rng(1)
    strands = [rng.normal(size=(n, 3)) for n in (3, 5, 2, 1)]
    attributes = {
        "width": Attribute(rng.random(11).astype(np.float32), Scope.POINT),
        "N": Attribute(rng.random((4, 3)).astype(np.float32), Scope.STRAND),
        "uv": Attribute(rng.random((4, 2)).astype(np.float32), Scope.STRAND),
        "groom_color": Attribute(rng.random((11, 3)).astype(np.float32), Scope.POINT),
        "groom_id": Attribute(np.arange(4, dtype=np.int32), Scope.STRAND),
        "tool": Attribute(np.array(["comb"]), Scope.GROOM),
    }
    groom = Groom.from_strands(strands, attributes=attributes, unit_cm=2.54, up=up, objects=("fringe",))
    assert formats.write(groom, tmp_path / f"a{suffix}") == []

    stage = Usd.Stage.Open(str(tmp_path / f"a{suffix}"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == pytest.approx(0.0254)
    assert UsdGeom.GetStageUpAxis(stage) == up.upper()
    (prim,) = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.BasisCurves)]
    assert prim.GetName() == "fringe"
    assert prim.GetParent() == stage.GetDefaultPrim()
    curves = UsdGeom.BasisCurves(prim)
    assert (curves.GetTypeAttr().Get(), curves.GetWrapAttr().Get()) == (T.linear, T.nonperiodic)
    assert list(curves.GetCurveVertexCountsAttr().Get()) == [3, 5, 2, 1]
    np.testing.assert_array_equal(np.array(curves.GetPointsAttr().Get()), (groom.points / 2.54).astype(np.float32))
    np.testing.assert_allclose(np.array(curves.GetWidthsAttr().Get()), attributes["width"].values / 2.54, rtol=1e-6)
    assert curves.GetWidthsInterpolation() == T.vertex
    np.testing.assert_array_equal(np.array(curves.GetNormalsAttr().Get()), attributes["N"].values)
    assert curves.GetNormalsInterpolation() == T.uniform
    primvars = UsdGeom.PrimvarsAPI(prim)
    for name, interpolation, kind in (
        ("uv", T.uniform, "texCoord2f[]"),
        ("groom_color", T.vertex, "color3f[]"),
        ("groom_id", T.uniform, "int[]"),
        ("tool", T.constant, "string[]"),
    ):
        primvar = primvars.GetPrimvar(name)
        assert (primvar.GetInterpolation(), str(primvar.GetTypeName())) == (interpolation, kind)
        np.testing.assert_array_equal(np.array(primvar.Get()), attributes[name].values)
    extent = np.array(curves.GetExtentAttr().Get())
    np.testing.assert_array_equal(extent, np.array(UsdGeom.PointBased.ComputeExtent(curves.GetPointsAttr().Get())))


@pytest.mark.parametrize(
    ("scope", "interpolation"), [(Scope.GROOM, T.constant), (Scope.STRAND, T.uniform), (Scope.POINT, T.vertex)]
)
def test_scopes_are_interpolations(tmp_path: Path, scope: Scope, interpolation: str) -> None:
    count = {Scope.GROOM: 1, Scope.STRAND: 2, Scope.POINT: 6}[scope]
    attributes = {
        "width": Attribute(np.ones(count), scope),
        "N": Attribute(np.ones((count, 3), dtype=np.float32), scope),
    }
    formats.write(Groom.from_strands([np.eye(3)] * 2, attributes=attributes), tmp_path / "a.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    curves = UsdGeom.BasisCurves(stage.GetPrimAtPath("/groom/hair"))
    assert (curves.GetWidthsInterpolation(), curves.GetNormalsInterpolation()) == (interpolation, interpolation)
    assert {a.scope for a in formats.read(tmp_path / "a.usdc").attributes.values()} == {scope}


def test_names_that_usd_cannot_take_come_back(tmp_path: Path) -> None:
    names = ("UV Map", ".select", "größe", "1st", "a:b c", "x.y", "x y", "indices")
    attributes = {name: Attribute(np.array([float(i)]), Scope.GROOM) for i, name in enumerate(names)}
    objects = ("left/side", "left side", "", "eve:hair", "eve_hair")
    owner = Attribute(np.arange(len(objects), dtype=np.int32), Scope.STRAND)
    groom = Groom.from_strands([np.eye(3)] * len(objects), attributes={**attributes, "object": owner}, objects=objects)
    assert formats.write(groom, tmp_path / "a.usda") == []
    back = formats.read(tmp_path / "a.usda")
    assert back.objects == objects
    assert {name: float(back.attributes[name].values[0]) for name in names} == dict(
        zip(names, map(float, range(len(names))), strict=True)
    )


def test_what_usd_cannot_hold_is_said(tmp_path: Path) -> None:
    attributes = {
        "phase": Attribute(np.array([1j]), Scope.STRAND),
        "frame": Attribute(np.arange(27.0).reshape(3, 3, 3), Scope.POINT),
        "matrix": Attribute(np.arange(16.0).reshape(1, 4, 4), Scope.STRAND),
    }
    groom = Groom.from_strands([np.eye(3)], attributes=attributes, up="x")
    lost = formats.write(groom, tmp_path / "a.usdc")
    assert [sentence.split("'")[1] for sentence in lost[1:]] == ["phase", "frame"]
    assert lost[0].startswith("x stays up")
    back = formats.read(tmp_path / "a.usdc").attributes
    assert back["frame"].values.shape == (3, 9)
    np.testing.assert_array_equal(back["matrix"].values, attributes["matrix"].values)


# ---- others', read by us


@pytest.mark.parametrize(("metres", "unit_cm", "source"), [(1.0, 100.0, "file"), (0.0254, 2.54, "file")])
def test_unit_and_up_are_those_the_file_says(tmp_path: Path, metres: float, unit_cm: float, source: str) -> None:
    stage = stage_at(tmp_path / "a.usda", metres, "Z")
    curves_in(stage, "/hair", np.eye(3) * 0.2, [3])
    stage.Save()
    groom = formats.read(tmp_path / "a.usda")
    assert (groom.unit_cm, groom.unit_source, groom.up) == (unit_cm, source, "z")
    np.testing.assert_allclose(groom.points, np.eye(3) * np.float32(0.2) * unit_cm)
    assert formats.read(tmp_path / "a.usda", "mm").unit_cm == 0.1


def test_a_file_without_a_unit_is_guessed_from_its_size(tmp_path: Path) -> None:
    stage = stage_at(tmp_path / "a.usda", None)
    curves_in(stage, "/hair", np.eye(3) * 0.2, [3])
    stage.Save()
    groom = formats.read(tmp_path / "a.usda")
    assert (groom.unit_cm, groom.unit_source) == (100.0, "size")


def test_every_transform_above_is_applied(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    points = rng.normal(size=(5, 3)).astype(np.float32)
    stage = stage_at(tmp_path / "a.usdc")
    outer = UsdGeom.Xform.Define(stage, "/outer")
    outer.AddTranslateOp().Set(Gf.Vec3d(1, 2, 3))
    outer.AddScaleOp().Set(Gf.Vec3f(2, 2, 2))
    inner = UsdGeom.Xform.Define(stage, "/outer/inner")
    inner.AddRotateZOp().Set(90.0)
    curves = curves_in(stage, "/outer/inner/hair", points, [2, 3])
    curves.CreateWidthsAttr([0.5, 0.25])
    curves.SetWidthsInterpolation(T.uniform)
    curves.CreateNormalsAttr([Gf.Vec3f(1, 0, 0)])
    curves.SetNormalsInterpolation(T.constant)
    free = curves_in(stage, "/outer/free", points, [5])
    free.SetResetXformStack(True)
    UsdGeom.Mesh.Define(stage, "/outer/scalp")
    stage.Save()
    groom = formats.read(tmp_path / "a.usdc")
    x, y, z = points.astype(float).T
    np.testing.assert_allclose(groom.points[:5], 2 * np.stack([-y, x, z], axis=1) + [1, 2, 3], atol=1e-6)
    np.testing.assert_allclose(groom.points[5:], points, rtol=1e-7)
    assert groom.objects == ("hair", "free")
    np.testing.assert_allclose(groom.attributes["width"].values, [1.0, 0.5, 0.0])
    np.testing.assert_allclose(groom.attributes["N"].values, [[0, 1, 0], [0, 1, 0], [0, 0, 0]], atol=1e-6)
    assert "skipped what is not curves: scalp" in groom.notes


def test_primvars_of_every_interpolation(tmp_path: Path) -> None:
    stage = stage_at(tmp_path / "a.usda")
    above = UsdGeom.PrimvarsAPI(UsdGeom.Xform.Define(stage, "/top"))
    above.CreatePrimvar("inherited", Sdf.ValueTypeNames.Float, T.constant).Set(7.0)
    primvars = UsdGeom.PrimvarsAPI(curves_in(stage, "/top/hair", np.zeros((5, 3)), [2, 3]))
    names = Sdf.ValueTypeNames
    primvars.CreatePrimvar("one", names.String, T.constant).Set("comb")
    primvars.CreatePrimvar("strand", names.IntArray, T.uniform).Set([3, 4])
    primvars.CreatePrimvar("vary", names.FloatArray, T.varying).Set([1, 2, 3, 4, 5])
    primvars.CreatePrimvar("vertex", names.Vector3dArray, T.vertex).Set([Gf.Vec3d(i) for i in range(5)])
    primvars.CreatePrimvar("turn", names.QuatfArray, T.uniform).Set([Gf.Quatf(1, 2, 3, 4)] * 2)
    primvars.CreatePrimvar("weights", names.FloatArray, T.uniform, 2).Set([1, 2, 3, 4])
    primvars.CreatePrimvar("odd", names.IntArray, T.vertex).Set([1, 2, 3])
    indexed = primvars.CreatePrimvar("group", names.StringArray, T.uniform)
    indexed.Set(["front", "back"])
    indexed.SetIndices([1, 1])
    primvars.CreatePrimvar("widths", names.FloatArray, T.uniform).Set([0.1, 0.2])
    stage.Save()
    groom = formats.read(tmp_path / "a.usda", "cm")
    found = {name: (a.scope, a.values.tolist()) for name, a in groom.attributes.items()}
    widths = found.pop("width")
    assert widths[0] is Scope.STRAND
    np.testing.assert_allclose(widths[1], [0.1, 0.2], rtol=1e-6)
    assert found == {
        "inherited": (Scope.GROOM, [7.0]),
        "one": (Scope.GROOM, ["comb"]),
        "strand": (Scope.STRAND, [3, 4]),
        "vary": (Scope.POINT, [1, 2, 3, 4, 5]),
        "vertex": (Scope.POINT, [[i] * 3 for i in range(5)]),
        "turn": (Scope.STRAND, [[1, 2, 3, 4]] * 2),
        "weights": (Scope.STRAND, [[1, 2], [3, 4]]),
        "group": (Scope.STRAND, ["back", "back"]),
    }
    assert groom.notes == ("attribute 'odd' of 'hair' was left out: 3 values for 2 strands of 5 points",)


@pytest.mark.parametrize("wrap", [T.nonperiodic, T.pinned])
def test_bsplines_are_evaluated(tmp_path: Path, wrap: str) -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(12, 3)).astype(np.float32)
    groom = smooth(tmp_path / "a.usda", points, [5, 7], T.bspline, wrap)
    for strand, own in enumerate((points[:5].astype(float), points[5:].astype(float))):
        if wrap == T.pinned:
            own = np.concatenate([2 * own[:1] - own[1:2], own, 2 * own[-1:] - own[-2:-1]])
        spline = BSpline(np.arange(len(own) + 4.0), own, 3)
        at = np.linspace(3, len(own), (len(own) - 3) * SAMPLES_PER_SPAN + 1)
        np.testing.assert_allclose(groom.strand(strand), spline(at), atol=1e-6)
        if wrap == T.pinned:
            np.testing.assert_allclose(groom.strand(strand)[[0, -1]], own[[1, -2]], atol=1e-6)
    assert any("bspline curves: evaluated" in note for note in groom.notes)


def test_beziers_are_evaluated_with_what_lies_on_them(tmp_path: Path) -> None:
    t = np.arange(3.0)[:, None]
    on, slope = t**2 * [1, 0, 2] + t * [0, 1, 0], 2 * t * [1, 0, 2] + [0, 1, 0]
    controls = [on[0]]
    for i in range(2):
        controls += [on[i] + slope[i] / 3, on[i + 1] - slope[i + 1] / 3, on[i + 1]]
    stage = stage_at(tmp_path / "a.usda")
    curves = curves_in(stage, "/hair", np.array(controls), [7], type=T.cubic, basis=T.bezier)
    curves.CreateWidthsAttr([1.0, 3.0, 2.0])
    curves.SetWidthsInterpolation(T.varying)
    primvars = UsdGeom.PrimvarsAPI(curves)
    primvars.CreatePrimvar("along", Sdf.ValueTypeNames.FloatArray, T.vertex).Set(np.array(controls)[:, 1].tolist())
    primvars.CreatePrimvar("id", Sdf.ValueTypeNames.IntArray, T.vertex).Set(list(range(7)))
    stage.Save()
    groom = formats.read(tmp_path / "a.usda")
    at = np.linspace(0, 2, 2 * SAMPLES_PER_SPAN + 1)
    np.testing.assert_allclose(groom.points, at[:, None] ** 2 * [1, 0, 2] + at[:, None] * [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(groom.attributes["along"].values, at, atol=1e-6)
    np.testing.assert_allclose(groom.attributes["width"].values, np.interp(at, [0, 1, 2], [1, 3, 2]), atol=1e-6)
    assert "id" not in groom.attributes
    assert any("'id'" in note for note in groom.notes)


def test_catmull_rom_curves_are_their_points(tmp_path: Path) -> None:
    points = np.random.default_rng(4).normal(size=(9, 3)).astype(np.float32)
    pinned = smooth(tmp_path / "a.usda", points, [4, 5], T.catmullRom, T.pinned)
    np.testing.assert_array_equal(pinned.points, points)
    # Not pinned, the ends are no part of the curve.
    free = smooth(tmp_path / "b.usda", points, [4, 5], T.catmullRom, T.nonperiodic)
    np.testing.assert_array_equal(free.points, points[[1, 2, 5, 6, 7]])
    assert free.point_counts.tolist() == [2, 3]


@pytest.mark.parametrize("counts", [[4, 3, 2], [5, 1, 3]])
def test_values_that_do_not_fit_short_catmull_rom_curves_are_told_of(tmp_path: Path, counts: list[int]) -> None:
    stage = stage_at(tmp_path / "a.usda")
    curves = curves_in(stage, "/hair", np.eye(3).repeat(3, axis=0), counts, type=T.cubic, basis=T.catmullRom)
    ends = sum(max(count - 2, 2) for count in counts)
    for name in ("age", "wet"):
        primvar = UsdGeom.PrimvarsAPI(curves).CreatePrimvar(name, Sdf.ValueTypeNames.FloatArray, T.varying)
        primvar.Set([1.0] * ends)
    stage.Save()
    groom = formats.read(tmp_path / "a.usda")
    assert not groom.attributes
    for name in ("age", "wet"):
        said = f"attribute {name!r} of 'hair' was left out: its values do not fit curves of fewer than four points"
        assert said in groom.notes


def test_widths_at_the_ends_of_spans_grow_with_the_transform_above(tmp_path: Path) -> None:
    stage = stage_at(tmp_path / "a.usda")
    UsdGeom.Xform.Define(stage, "/big").AddScaleOp().Set(Gf.Vec3f(2, 2, 2))
    curves = curves_in(stage, "/big/hair", np.eye(4)[:, :3], [4], type=T.cubic, basis=T.bezier)
    curves.CreateWidthsAttr([1.0, 3.0])
    curves.SetWidthsInterpolation(T.varying)
    stage.Save()
    widths = formats.read(tmp_path / "a.usda").attributes["width"].values
    np.testing.assert_allclose(widths[[0, -1]], [2.0, 6.0], rtol=1e-6)


def test_time_samples_references_and_instances(tmp_path: Path) -> None:
    folder = tmp_path / "größe und mehr"
    folder.mkdir()
    stage = stage_at(folder / "part.usda")
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/part").GetPrim())
    curves = curves_in(stage, "/part/hair", np.zeros((2, 3)), [2])
    curves.GetPointsAttr().Clear()
    for frame in (3.0, 4.0):
        curves.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(np.full((2, 3), frame, dtype=np.float32)), frame)
    stage.Save()
    whole = stage_at(folder / "whole.usda")
    for x in range(2):
        instance = UsdGeom.Xform.Define(whole, f"/i{x}")
        instance.AddTranslateOp().Set(Gf.Vec3d(x, 0, 0))
        instance.GetPrim().GetReferences().AddReference("./part.usda")
        instance.GetPrim().SetInstanceable(True)
    whole.Save()
    del stage, whole
    groom = formats.read(folder / "whole.usda")
    assert groom.points[:, 0].tolist() == [3, 3, 4, 4]
    assert groom.objects == ("i0/hair", "i1/hair")
    assert sum("2 time samples" in note for note in groom.notes) == 2


def test_a_file_that_changes_is_read_anew_while_it_is_open_elsewhere(tmp_path: Path) -> None:
    groom = Groom.from_strands([np.eye(3)])
    formats.write(groom, tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    formats.write(Groom.from_strands([2 * np.eye(3)]), tmp_path / "a.usda")
    assert formats.read(tmp_path / "a.usda").points.max() == 2
    assert stage.GetDefaultPrim()


# ---- what is wrong


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("#usda 1.0\n", "holds no BasisCurves"),
        ('#usda 1.0\ndef Mesh "scalp" {}\n', "only scalp"),
        ('#usda 1.0\ndef BasisCurves "hair" {\n', "damaged"),
        (CURVES.format("2"), "add up"),
        (CURVES.format("2, -1"), "below 0"),
        ('#usda 1.0\ndef BasisCurves "hair" {}\n', "no strands"),
        ("#usda 9.0\n", "damaged"),
        ('#usda 1.0\n(metersPerUnit = 0)\ndef BasisCurves "hair" {}\n', "0 m"),
        ("PXR-USDC but no more", "damaged"),
        ("hello", "no USD file"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    (tmp_path / "a.usd").write_text(text)
    with pytest.raises(ReadError, match=said) as error:
        formats.read(tmp_path / "a.usd")
    assert "a.usd" in str(error.value)
    assert "\n" not in str(error.value)
    # USD itself would tell of it on stderr, past --quiet.
    assert capfd.readouterr().err == ""


# A damaged file may end the process from within the library: not ours.
DAMAGE = """
import sys
import numpy as np
from pathlib import Path
from detangled import formats
from detangled.errors import ReadError
path = Path(sys.argv[1])
whole = path.read_bytes()
cut = path.with_name("cut.usdc")
refused = 0
for length in [*range(8, len(whole), 41), len(whole) - 1]:
    cut.write_bytes(whole[:length])
    try:
        formats.read(cut, "cm")
    except ReadError as error:
        refused += 1
print(refused, len(range(8, len(whole), 41)) + 1)
rng = np.random.default_rng(1)
for trial in range(200):
    damaged = bytearray(whole)
    where = int(rng.integers(8, len(whole)))
    damaged[where : where + 1 + 7 * (trial % 2)] = rng.bytes(1 + 7 * (trial % 2))
    cut.write_bytes(damaged[: len(whole)])
    try:
        formats.read(cut, "cm")
    except ReadError as error:
        refused += 1
print("whole")
"""


def test_damaged_crates_are_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    points = rng.normal(size=(60, 3))
    attributes = {"width": Attribute(rng.random(60), Scope.POINT), "name": Attribute(np.array(["a b"]), Scope.GROOM)}
    formats.write(Groom(points, np.arange(0, 61, 20), attributes=attributes), tmp_path / "a.usdc")
    words = [sys.executable, "-c", DAMAGE, str(tmp_path / "a.usdc")]
    result = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, (result.returncode, result.stderr[-2000:])
    refused, total = map(int, result.stdout.split()[:2])
    assert refused == total
    assert "whole" in result.stdout


def test_a_list_that_leads_beyond_the_end_is_refused_before_memory_is_asked_for(tmp_path: Path) -> None:
    formats.write(Groom.from_strands([np.eye(3)]), tmp_path / "a.usdc")
    whole = (tmp_path / "a.usdc").read_bytes()
    # The root's one child: a list of one name.
    at = whole.index(struct.pack("<Q", 1), 88)
    (tmp_path / "b.usdc").write_bytes(whole[:at] + struct.pack("<Q", 1 << 40) + whole[at + 8 :])
    with pytest.raises(ReadError, match=f"the list at byte {at} reaches"):
        formats.read(tmp_path / "b.usdc")


def test_a_child_that_is_named_and_not_there_is_refused(tmp_path: Path) -> None:
    formats.write(Groom.from_strands([np.eye(3)]), tmp_path / "a.usdc")
    whole = (tmp_path / "a.usdc").read_bytes()
    at = whole.index(struct.pack("<Q", 1), 88) + 8
    named = struct.unpack_from("<I", whole, at)[0]
    (tmp_path / "b.usdc").write_bytes(whole[:at] + struct.pack("<I", named - 1) + whole[at + 4 :])
    # In a process of its own, since USD would end it.
    words = [sys.executable, "-m", "detangled_cli.main", "info", str(tmp_path / "b.usdc")]
    result = subprocess.run(words, capture_output=True, text=True, check=False)
    assert result.returncode == 3
    assert "which the file does not hold" in result.stderr


def test_lz4_blocks_are_unpacked() -> None:
    # Of the published format: literals, a repeat that runs into itself, a long run of literals and of repeats.
    assert _unpacked(b"\x31abc\x03\x00\x10d", 9) == b"abcabcabd"
    literals = bytes(range(200)) + bytes(range(100))
    block = b"\xff" + b"\xff\x1e" + literals + b"\x01\x00" + b"\xff\x00" + b"\x10!"
    assert _unpacked(block, 300 + 274 + 1) == literals + literals[-1:] * 274 + b"!"
    for wrong in (b"\x11a\x02\x00\x10b", b"\x11a\x00\x00\x10b", b"\x10a"):
        with pytest.raises(ValueError, match="LZ4"):
            _unpacked(wrong, 7)


def test_without_usd_core_one_sentence_says_how_to_get_it(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['pxr'] = None\n"
        "from detangled import formats\nfrom detangled.errors import *\n"
        "import numpy as np; from detangled.groom import Groom\n"
        "groom = Groom.from_strands([np.eye(3)])\n"
        "for call in (lambda: formats.read('a.usdc'), lambda: formats.write(groom, 'a.usd')):\n"
        "    try: call()\n    except DetangledError as e: print(type(e).__name__, e)\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=True)
    assert result.stdout.splitlines() == [
        "ReadError a.usdc: .usdc files need a library that is not installed: pip install 'detangled[usd]'",
        "WriteError a.usd: .usd files need a library that is not installed: pip install 'detangled[usd]'",
    ]


def test_a_failed_export_is_a_write_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from detangled.formats import usd_write

    class Full:
        @staticmethod
        def CreateAnonymous(tag: str) -> Any:  # noqa: N802
            raise RuntimeError("\n\tError in 'Save' at line 7 in file a.cpp : 'disk full'\n\tno more")

    monkeypatch.setattr(usd_write.Sdf, "Layer", Full)
    with pytest.raises(WriteError) as caught:
        formats.write(Groom.from_strands([np.eye(3)]), tmp_path / "a.usdc")
    assert str(caught.value) == f"{tmp_path / 'a.usdc'}: USD could not write it: 'disk full' no more"
    assert list(tmp_path.iterdir()) == []


def test_blenders_files_are_read_as_they_stand(grooms: Callable[[str], Path]) -> None:
    groom = formats.read(grooms("eve.usdc"))
    assert groom.notes == ("'eve' are Catmull-Rom curves: read by the points they run through",)
    np.testing.assert_allclose(groom.attributes["width"].values, 0.008, rtol=1e-5)
