"""Every format: what is written comes back, what cannot be read says why, a failure leaves the old file."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from detangled import formats
from detangled.errors import ReadError, WriteError
from detangled.groom import Attribute, Groom, Scope

SUFFIXES = tuple(formats.suffixes())
# TressFX knows one count of points for all strands.
RAGGED = tuple(suffix for suffix in SUFFIXES if suffix != ".tfx")
WITH_ATTRIBUTES = (".abc", ".npz", ".usda", ".usdc")
WITH_OBJECTS = (*WITH_ATTRIBUTES, ".obj", ".ply")
INTEGERS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
DTYPES = ("bool", *INTEGERS, "float16", "float32", "float64")
# What a format makes of a dtype: USD has no small integers, Alembic's bindings no 64-bit ones either.
USD_DTYPES = {"int8": "int32", "int16": "int32", "uint16": "int32"}
ABC_DTYPES = {**USD_DTYPES, "int64": "int32", "uint64": "int32"}
DTYPES_OF = {".abc": ABC_DTYPES, ".usda": USD_DTYPES, ".usdc": USD_DTYPES, ".npz": {}}


def strands(rng, counts=(5, 2, 9, 1, 4), unit_cm=1.0):
    """Random strands whose coordinates in the unit are float32, as they are in files."""
    points = rng.normal(size=(sum(counts), 3)).astype(np.float32).astype(np.float64)
    return Groom(points * unit_cm, np.concatenate([[0], np.cumsum(counts)]), unit_cm=unit_cm)


def all_attributes(groom, rng):
    """An attribute of every scope, dtype and width."""
    attributes = {}
    for scope, count in (
        (Scope.GROOM, 1),
        (Scope.STRAND, groom.strand_count),
        (Scope.POINT, len(groom.points)),
    ):
        numbers = rng.normal(size=(count, 3)) * 50
        for dtype in DTYPES:
            values = np.abs(numbers[:, 0]) if dtype[0] == "u" else numbers[:, 0]
            attributes[f"{scope.value}_{dtype}"] = Attribute(values.astype(dtype), scope)
        for width in (2, 3, 4, 6):
            values = rng.normal(size=(count, width)) * 50
            for dtype in ("int32", "uint8", "float32", "float64", "bool"):
                attributes[f"{scope.value}_{dtype}_{width}"] = Attribute(np.abs(values).astype(dtype), scope)
        attributes[f"{scope.value}_color"] = Attribute(rng.random((count, 3)).astype(np.float32), scope)
        texts = np.array([f"s{i} é" if i % 2 else "" for i in range(count)])
        attributes[f"{scope.value}_text"] = Attribute(texts, scope)
    attributes["uint32_large"] = Attribute(np.full(groom.strand_count, 2**32 - 1, dtype=np.uint32), Scope.STRAND)
    attributes["width"] = Attribute(rng.random(len(groom.points)).astype(np.float32) * groom.unit_cm, Scope.POINT)
    attributes["uv"] = Attribute(rng.random((groom.strand_count, 2)).astype(np.float32), Scope.STRAND)
    attributes["N"] = Attribute(rng.random((groom.strand_count, 3)).astype(np.float32), Scope.STRAND)
    attributes["velocities"] = Attribute(rng.random((len(groom.points), 3)).astype(np.float32), Scope.POINT)
    return attributes


def check_round_trip(groom, path, unit=None):
    """Write, read, and compare: points to the float32 bit, counts, objects, up. Returns (read, sentences)."""
    lost = formats.write(groom, path)
    back = formats.read(path, unit)
    in_unit = (groom.points / groom.unit_cm).astype(np.float32)
    np.testing.assert_array_equal((back.points / back.unit_cm).astype(np.float32), in_unit)
    np.testing.assert_array_equal(back.offsets, groom.offsets)
    assert back.unit_cm == groom.unit_cm
    assert back.objects == groom.objects
    return back, lost


@pytest.mark.parametrize("suffix", RAGGED)
@pytest.mark.parametrize("unit", ["mm", "cm", "m", "in"])
def test_points_survive_to_the_bit(tmp_path, suffix, unit):
    unit_cm = {"mm": 0.1, "cm": 1.0, "m": 100.0, "in": 2.54}[unit]
    groom = strands(np.random.default_rng(1), unit_cm=unit_cm)
    back, lost = check_round_trip(groom, tmp_path / f"a{suffix}", unit)
    assert lost == []
    assert back.unit_source == "given"
    again = tmp_path / f"b{suffix}"
    formats.write(back, again)
    assert again.read_bytes() == (tmp_path / f"a{suffix}").read_bytes()


@pytest.mark.parametrize("suffix", WITH_ATTRIBUTES)
def test_attributes_of_every_kind_come_back(tmp_path, suffix):
    rng = np.random.default_rng(2)
    groom = strands(rng, unit_cm=100.0)
    groom = replace(groom, attributes=all_attributes(groom, rng))
    back, lost = check_round_trip(groom, tmp_path / f"a{suffix}", "m")
    assert lost == []
    assert set(back.attributes) == set(groom.attributes)
    for name, attribute in groom.attributes.items():
        found = back.attributes[name]
        assert found.scope is attribute.scope, name
        if name in ("width", "velocities"):
            np.testing.assert_allclose(found.values, attribute.values, rtol=1e-7)
            continue
        dtype = attribute.values.dtype
        expected = np.dtype(DTYPES_OF[suffix].get(dtype.name, dtype.name)) if dtype.kind in "iu" else dtype
        assert found.values.dtype.kind == expected.kind, name
        if expected.kind != "U":
            assert found.values.dtype == expected, name
        np.testing.assert_array_equal(found.values, attribute.values, err_msg=name)


def test_widths_are_lengths(tmp_path):
    groom = strands(np.random.default_rng(3), unit_cm=100.0)
    groom = replace(groom, attributes={"width": Attribute(np.full(groom.strand_count, 0.008), Scope.STRAND)})
    for suffix in WITH_ATTRIBUTES:
        formats.write(groom, tmp_path / f"a{suffix}")
        in_metres = formats.read(tmp_path / f"a{suffix}", "m")
        in_centimetres = formats.read(tmp_path / f"a{suffix}", "cm")
        np.testing.assert_allclose(in_metres.attributes["width"].values, 0.008, rtol=1e-6)
        np.testing.assert_allclose(in_centimetres.attributes["width"].values, 0.00008, rtol=1e-6)


@pytest.mark.parametrize("suffix", RAGGED)
def test_coordinates_that_are_no_numbers_are_read(tmp_path, suffix):
    groom = strands(np.random.default_rng(4))
    points = groom.points.copy()
    points[1, 2], points[4] = np.nan, np.inf
    check_round_trip(replace(groom, points=points), tmp_path / f"a{suffix}", "cm")


@pytest.mark.parametrize("suffix", [*WITH_ATTRIBUTES, ".data"])
def test_strands_without_points_come_back(tmp_path, suffix):
    check_round_trip(strands(np.random.default_rng(5), (0, 3, 0, 1, 0)), tmp_path / f"a{suffix}", "cm")


def test_obj_says_that_it_leaves_out_strands_without_points(tmp_path):
    lost = formats.write(strands(np.random.default_rng(5), (0, 3, 0, 1)), tmp_path / "a.obj")
    assert lost == ["2 strands without points were left out"]
    assert formats.read(tmp_path / "a.obj", "cm").point_counts.tolist() == [3, 1]


@pytest.mark.parametrize("suffix", WITH_OBJECTS)
def test_objects_come_back(tmp_path, suffix):
    groom = replace(strands(np.random.default_rng(6)), objects=("front", "back"))
    owner = Attribute(np.array([0, 0, 1, 1, 1], dtype=np.int32), Scope.STRAND)
    back, lost = check_round_trip(replace(groom, attributes={"object": owner}), tmp_path / f"a{suffix}", "cm")
    assert lost == []
    np.testing.assert_array_equal(back.attributes["object"].values, owner.values)


@pytest.mark.parametrize("suffix", [".abc", ".obj", ".usdc"])
def test_interleaved_objects_are_put_in_order_and_say_so(tmp_path, suffix):
    groom = replace(strands(np.random.default_rng(6)), objects=("front", "back"))
    owner = Attribute(np.array([1, 0, 1, 0, 1], dtype=np.int32), Scope.STRAND)
    lost = formats.write(replace(groom, attributes={"object": owner}), tmp_path / f"a{suffix}")
    assert lost == ["strands were put in the order of their objects"]
    back = formats.read(tmp_path / f"a{suffix}", "cm")
    assert back.attributes["object"].values.tolist() == [0, 0, 1, 1, 1]
    np.testing.assert_allclose(back.points, groom.select([1, 3, 0, 2, 4]).points, rtol=1e-7)


def test_the_same_groom_gives_the_same_bytes(tmp_path):
    rng = np.random.default_rng(7)
    groom = strands(rng)
    groom = replace(groom, attributes=all_attributes(groom, rng))
    for suffix in SUFFIXES:
        formats.write(groom, tmp_path / f"one{suffix}")
    # Longer than the two seconds to which zip archives round their times.
    time.sleep(2.1)
    for suffix in SUFFIXES:
        formats.write(groom, tmp_path / f"other{suffix}")
        assert (tmp_path / f"one{suffix}").read_bytes() == (tmp_path / f"other{suffix}").read_bytes(), suffix


def test_npz_keeps_unit_and_up(tmp_path):
    groom = replace(strands(np.random.default_rng(8), unit_cm=2.54), up="x")
    back, _ = check_round_trip(groom, tmp_path / "a.npz")
    assert (back.up, back.unit_source, back.notes) == ("x", "file", ())


def test_npz_plain_grid(tmp_path):
    grid = np.random.default_rng(9).random((4, 7, 3)).astype(np.float32)
    np.savez(tmp_path / "a.npz", hair=grid)
    groom = formats.read(tmp_path / "a.npz", "cm")
    np.testing.assert_array_equal(groom.points.reshape(4, 7, 3), grid)
    assert groom.up == "z"


def test_obj_traps(tmp_path):
    text = (
        b"# 9 9 9\r\nv 0 0 0\r\n  v 1 0 0 0.5 # a comment\r\nv 2 0 0\r\n\r\n"
        b"o left\r\nl 3/1 1/2 \\\r\n 2/9\r\n"
        b"v 3 0 0\r\nvn 0 0 1\r\nvt 0 0\r\no right side\r\nl -1 -4\r\nf 1 2 3\r\nl 5\r\nv 4 1e1 -.5\r\n"
    )
    (tmp_path / "a.obj").write_bytes(text)
    groom = formats.read(tmp_path / "a.obj", "cm")
    assert groom.point_counts.tolist() == [3, 2, 1]
    assert groom.points.tolist() == [[2, 0, 0], [0, 0, 0], [1, 0, 0], [3, 0, 0], [0, 0, 0], [4, 10, -0.5]]
    assert groom.objects == ("left", "right side")
    assert groom.attributes["object"].values.tolist() == [0, 1, 1]
    assert groom.notes == ("skipped 1 face",)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("v 0 0 0\nv 1 1 1\n", "no line elements"),
        ("v 0 0 0\n# c\nv 1 x 1\nl 1 2\n", "line 3: 'x' is not a number"),
        ("v 0 0 0\nv 0 \\\n1 1\nv 1 0\nl 1 2\n", "line 4: a vertex needs three"),
        ("v 0 0 0\nv 1 1 1\nl 1 3\n", "line 3: there is no vertex 3"),
        ("v 0 0 0\nv 1 1 1\nl 0 1\n", "line 3: there is no vertex 0"),
        ("v 0 0 0\nl 1 -2\nv 1 1 1\n", "line 2: there is no vertex -2"),
        ("v 0 0 0\nl 1 b/2\nv 1 1 1\n", "line 2: 'b/2' is not a number"),
        ("v 0 0 0\nl 1 1.5\nv 1 1 1\n", "line 2: '1.5' is not a number"),
    ],
)
def test_obj_says_which_line_is_wrong(tmp_path, text, said):
    (tmp_path / "a.obj").write_text(text)
    with pytest.raises(ReadError, match=said):
        formats.read(tmp_path / "a.obj")


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"cnt": np.array([2])}, "no array 'data'"),
        ({"data": np.zeros((2, 3))}, "no array 'cnt'"),
        ({"cnt": np.array([2, 2]), "data": np.zeros((3, 3))}, "adds up to 4 points, 'data' holds 3"),
        ({"cnt": np.array([4, -1]), "data": np.zeros((3, 3))}, "adds up"),
        ({"cnt": np.array([1.5]), "data": np.zeros((3, 3))}, "whole numbers"),
        ({"cnt": np.array([3]), "data": np.zeros((3, 2))}, r"shape \(P, 3\)"),
        ({"cnt": np.array([1]), "data": np.array([["a", "b", "c"]])}, "numbers of shape"),
        ({"cnt": np.array([1]), "data": np.array([[1, 2, None]])}, "cannot be read"),
        ({"hair": np.zeros((2, 3))}, "needs 'cnt' and 'data'"),
        ({"a": np.zeros((2, 2, 3)), "b": np.zeros((2, 2, 3))}, "one array of shape"),
        ({"cnt": np.array([1]), "data": np.zeros((1, 3)), "attr:strand:x": np.zeros(2)}, "'x' has 2 values"),
        ({"cnt": np.array([0], int)[:0], "data": np.zeros((0, 3))}, "no strands"),
    ],
)
def test_npz_says_what_is_wrong(tmp_path, arrays, said):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(ReadError, match=said):
        formats.read(tmp_path / "a.npz")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("content", [b"", b"hello\n", b"PK\x03\x04 not really", bytes(range(256)) * 40])
def test_junk_is_refused_by_name(tmp_path, suffix, content):
    path = tmp_path / f"junk{suffix}"
    path.write_bytes(content)
    with pytest.raises(ReadError, match="junk"):
        formats.read(path)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_is_not_there_is_refused(tmp_path, suffix):
    with pytest.raises(ReadError, match="no such file"):
        formats.read(tmp_path / f"absent{suffix}")
    (tmp_path / f"folder{suffix}").mkdir()
    with pytest.raises(ReadError, match="a folder"):
        formats.read(tmp_path / f"folder{suffix}")
    groom = strands(np.random.default_rng(10))
    with pytest.raises(WriteError, match="a folder"):
        formats.write(groom, tmp_path / f"folder{suffix}")
    with pytest.raises(WriteError, match="does not exist"):
        formats.write(groom, tmp_path / "nowhere" / f"a{suffix}")
    assert [p.name for p in tmp_path.iterdir()] == [f"folder{suffix}"]


def test_unknown_suffixes_and_units_are_refused(tmp_path):
    with pytest.raises(ReadError, match=r"\.abc, .*\.npz.*\.obj"):
        formats.read(tmp_path / "a.fbx")
    with pytest.raises(WriteError, match="without a suffix are not known"):
        formats.write(strands(np.random.default_rng(11)), tmp_path / "a")
    formats.write(strands(np.random.default_rng(11)), tmp_path / "A.NPZ")
    with pytest.raises(ReadError, match="unknown unit 'furlong'"):
        formats.read(tmp_path / "A.NPZ", "furlong")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("error", [RuntimeError("no"), OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failing_write_leaves_the_old_file_whole(tmp_path, monkeypatch, suffix, error):
    groom = strands(np.random.default_rng(12))
    path = tmp_path / f"a{suffix}"
    formats.write(groom, path)
    before = path.read_bytes()
    reader, writer = formats._registered[suffix]

    def fails(groom, beside):
        writer(groom, beside)
        raise error

    monkeypatch.setitem(formats._registered, suffix, (reader, fails))
    with pytest.raises(WriteError if isinstance(error, OSError) else type(error)):
        formats.write(replace(groom, points=groom.points + 1), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_writing_over_a_file_keeps_its_mode_and_links(tmp_path):
    groom = strands(np.random.default_rng(13))
    path = tmp_path / "a.npz"
    formats.write(groom, path)
    path.chmod(0o640)
    (tmp_path / "link.npz").symlink_to(path)
    formats.write(replace(groom, points=groom.points + 1), tmp_path / "link.npz")
    assert (tmp_path / "link.npz").is_symlink()
    assert path.stat().st_mode & 0o777 == 0o640
    np.testing.assert_allclose(formats.read(path).points, groom.points + 1, rtol=1e-6)


def test_a_writer_that_fails_names_the_file_asked_for(tmp_path, monkeypatch):
    def fails(groom, beside):
        raise WriteError(f"{beside}: full; {beside.name} is gone")

    monkeypatch.setitem(formats._registered, ".npz", (None, fails))
    monkeypatch.chdir(tmp_path)
    for path in ("a.npz", str(tmp_path / "a.npz")):
        with pytest.raises(WriteError) as caught:
            formats.write(strands(np.random.default_rng(16)), path)
        assert str(caught.value) == f"{path}: full; a.npz is gone"


def test_registered_formats_are_used(tmp_path, monkeypatch):
    monkeypatch.setattr(formats, "_registered", dict(formats._registered))
    groom = strands(np.random.default_rng(14))
    formats.register([".Strand"], lambda path: groom, None)
    (tmp_path / "a.strand").write_bytes(b"x")
    assert formats.read(tmp_path / "a.strand", "cm").strand_count == groom.strand_count
    with pytest.raises(WriteError, match="can be read, not written"):
        formats.write(groom, tmp_path / "a.strand")


def test_no_format_is_loaded_before_it_is_needed():
    code = "import sys, detangled.formats; print(*{'alembic3d', 'imath', 'scipy', 'numba', 'pxr'} & {*sys.modules})"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "\n"


def test_real_swatch(grooms):
    groom = formats.read(grooms("coily_swatch.obj"))
    assert groom.strand_count == 98
    assert (groom.point_counts.min(), groom.point_counts.max()) == (93, 123)
    assert (groom.unit_cm, groom.unit_source) == (1.0, "size")
    assert groom.notes == ("taken as centimetres from its size; --unit says otherwise",)


def test_the_sample_archives_are_in_metres(grooms):
    groom = formats.read(grooms("bob.npz"))
    assert (groom.strand_count, groom.unit_cm, groom.up) == (248, 100.0, "z")
    assert np.ptp(groom.points, axis=0).max() == pytest.approx(25.9, abs=0.5)
