"""Formats of plain records (.hair, .data, .tfx, .ply): each by its published layout, and what is wrong with a file."""

from __future__ import annotations

import os
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from detangled import formats
from detangled.errors import ReadError, WriteError
from detangled.formats.even import evened
from detangled.groom import Attribute, Groom, Scope
from detangled_cli.main import detangled

POINTS = np.arange(15, dtype=np.float32).reshape(5, 3)
HAIR_HEADER = struct.Struct("<4sIIIIff3f88s")
TFX_3 = struct.Struct("<fIIII31I6I32I")
TFX_4 = struct.Struct("<f7I32I")


def hair(strands: int, points: int, flags: int, segments: int = 0, defaults: Any = (1.0, 0.0, 1.0, 1.0, 1.0)) -> bytes:
    return HAIR_HEADER.pack(b"HAIR", strands, points, flags, segments, *defaults, b"made by hand")


def tfx_3(strands: int, points: int, offsets: Any, follow: int = 0, both_ends: int = 0) -> bytes:
    return TFX_3.pack(3.0, strands, points, follow, both_ends, *[0] * 31, *offsets, *[0] * 32)


def tfx_4(strands: int, points: int, offsets: Any) -> bytes:
    return TFX_4.pack(4.0, strands, points, *offsets, *[0] * 32)


def ply(order: str, *elements: tuple[str, int, list[tuple[str, str]]], comments: str = "") -> bytes:
    lines = ["ply", f"format {order} 1.0", *([comments] if comments else [])]
    for name, count, properties in elements:
        lines += [f"element {name} {count}", *(f"property {kind} {field}" for kind, field in properties)]
    return "\n".join([*lines, "end_header", ""]).encode()


def read_bytes(folder: Path, suffix: str, content: bytes, unit: str | None = "cm") -> Groom:
    (folder / f"a{suffix}").write_bytes(content)
    return formats.read(folder / f"a{suffix}", unit)


# ---- .hair


def test_headers_are_as_long_as_published() -> None:
    assert (HAIR_HEADER.size, TFX_3.size, TFX_4.size) == (128, 296, 160)


def test_hair_with_every_array(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    thickness, transparency, colours = (rng.random(n).astype("<f4") for n in (5, 5, 15))
    content = hair(2, 5, 31) + struct.pack("<2H", 1, 2) + POINTS.tobytes()
    groom = read_bytes(
        tmp_path, ".hair", content + thickness.tobytes() + transparency.tobytes() + colours.tobytes(), "mm"
    )
    assert groom.point_counts.tolist() == [2, 3]
    np.testing.assert_allclose(groom.points, POINTS * 0.1)
    np.testing.assert_allclose(groom.attributes["width"].values, thickness * 0.1)
    np.testing.assert_array_equal(groom.attributes["transparency"].values, transparency)
    np.testing.assert_array_equal(groom.attributes["color"].values, colours.reshape(5, 3))
    assert {a.scope for a in groom.attributes.values()} == {Scope.POINT}
    assert groom.up == "z"


def test_hair_of_defaults(tmp_path: Path) -> None:
    content = hair(2, 4, 2, 1, (0.5, 0.25, 0.1, 0.2, 0.3)) + POINTS[:4].tobytes()
    groom = read_bytes(tmp_path, ".hair", content)
    assert groom.point_counts.tolist() == [2, 2]
    assert {name: (a.scope, a.values.ravel().tolist()) for name, a in groom.attributes.items()} == {
        "width": (Scope.GROOM, [0.5]),
        "transparency": (Scope.GROOM, [0.25]),
        "color": (Scope.GROOM, [np.float32(x) for x in (0.1, 0.2, 0.3)]),
    }
    assert not read_bytes(tmp_path, ".hair", hair(2, 4, 2, 1) + POINTS[:4].tobytes()).attributes


def test_hair_as_written_has_the_published_layout(tmp_path: Path) -> None:
    groom = Groom(
        POINTS,
        np.array([0, 2, 5]),
        attributes={
            "width": Attribute(np.array([0.25, 0.5]), Scope.STRAND),
            "transparency": Attribute(np.array([0.0]), Scope.GROOM),
            "color": Attribute(np.array([[0.5, 0.25, 0.125]]), Scope.GROOM),
            "age": Attribute(np.array([1, 2]), Scope.STRAND),
        },
    )
    lost = formats.write(groom, tmp_path / "a.hair")
    assert lost == ["attribute 'age' was not kept: .hair files have no place for it"]
    content = (tmp_path / "a.hair").read_bytes()
    magic, strands, points, flags, segments, _, _, *colour, _ = HAIR_HEADER.unpack_from(content)
    assert (magic, strands, points, flags, segments, colour) == (b"HAIR", 2, 5, 15, 0, [0.5, 0.25, 0.125])
    assert struct.unpack_from("<2H", content, 128) == (1, 2)
    np.testing.assert_array_equal(np.frombuffer(content, "<f4", 15, 132), POINTS.ravel())
    np.testing.assert_array_equal(np.frombuffer(content, "<f4", 5, 192), [0.25, 0.25, 0.5, 0.5, 0.5])
    np.testing.assert_array_equal(np.frombuffer(content, "<f4", 5, 212), np.zeros(5))
    assert len(content) == 232


def test_hair_has_no_place_for_strands_that_long(tmp_path: Path) -> None:
    groom = Groom(np.zeros((65_540, 3)), np.array([0, 3, 65_540]))
    with pytest.raises(WriteError, match="strand 1 has 65,537 points"):
        formats.write(groom, tmp_path / "a.hair")
    assert list(tmp_path.iterdir()) == []


# ---- .data


def test_data_as_published(tmp_path: Path) -> None:
    content = struct.pack("<ii", 3, 1) + POINTS[:1].tobytes() + struct.pack("<i", 0) + struct.pack("<i", 4)
    content += POINTS[1:].tobytes()
    groom = read_bytes(tmp_path, ".data", content)
    assert groom.point_counts.tolist() == [1, 0, 4]
    np.testing.assert_array_equal(groom.points, POINTS)
    assert (groom.up, groom.notes) == ("y", ())
    assert formats.write(groom, tmp_path / "b.data") == []
    assert (tmp_path / "b.data").read_bytes() == content
    assert read_bytes(tmp_path, ".data", content + b"more").notes == ("4 bytes behind the last strand were left out",)


# ---- .tfx


def test_tfx_3_with_every_array(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    points = rng.normal(size=(8, 3)).astype("<f4")
    arrays = [
        points,
        rng.random(2).astype("<f4"),
        rng.random((2, 2)).astype("<f4"),
        rng.random((8, 4)).astype("<f4"),
        np.array([0, 0], dtype="<u4"),
        rng.random((8, 2)).astype("<f4"),
    ]
    offsets = 296 + np.cumsum([0, *(array.nbytes for array in arrays[:-1])])
    content = tfx_3(2, 4, offsets.tolist(), follow=3, both_ends=1) + b"".join(array.tobytes() for array in arrays)
    groom = read_bytes(tmp_path, ".tfx", content)
    np.testing.assert_array_equal(groom.points, points * [1, 1, -1])
    assert groom.point_counts.tolist() == [4, 4]
    found = {name: (a.scope, a.values.tolist()) for name, a in groom.attributes.items()}
    assert found == {
        "follow_hairs": (Scope.GROOM, [3]),
        "both_ends_pinned": (Scope.GROOM, [True]),
        "width": (Scope.STRAND, arrays[1].tolist()),
        "uv": (Scope.STRAND, arrays[2].tolist()),
        "color": (Scope.POINT, arrays[3].tolist()),
        "guide": (Scope.STRAND, [0, 0]),
        "vertex_uv": (Scope.POINT, arrays[5].tolist()),
    }
    lost = formats.write(groom, tmp_path / "b.tfx")
    assert [sentence.split("'")[1] for sentence in lost] == ["follow_hairs", "guide"]
    again = formats.read(tmp_path / "b.tfx", "cm")
    np.testing.assert_array_equal(again.points, groom.points)
    assert again.attributes["inverse_mass"].values.tolist() == [0.0] * 8
    for name in ("width", "uv", "color", "vertex_uv"):
        np.testing.assert_array_equal(again.attributes[name].values, groom.attributes[name].values)


def test_tfx_4_as_written_has_the_published_layout(tmp_path: Path) -> None:
    points = np.random.default_rng(3).normal(size=(8, 3)).astype(np.float32)
    groom = Groom(points, np.array([0, 4, 8]), attributes={"uv": Attribute(np.full((2, 2), 0.5), Scope.STRAND)})
    assert formats.write(groom, tmp_path / "a.tfx") == []
    content = (tmp_path / "a.tfx").read_bytes()
    assert content[:160] == tfx_4(2, 4, [160, 288, 0, 0, 0])
    rows = np.frombuffer(content, "<f4", 32, 160).reshape(8, 4)
    np.testing.assert_array_equal(rows[:, :3], points)
    np.testing.assert_array_equal(rows[:, 3], [0, 0, 1, 1] * 2)
    np.testing.assert_array_equal(np.frombuffer(content, "<f4", 4, 288), [0.5] * 4)


def test_tfx_says_what_it_changes(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    groom = Groom.from_strands([rng.normal(size=(n, 3)) for n in (5, 0, 3, 1)])
    groom = Groom(
        groom.points, groom.offsets, attributes={"width": Attribute(np.arange(9.0), Scope.POINT)}, objects=("a", "b")
    )
    lost = formats.write(groom, tmp_path / "a.tfx")
    assert lost == [
        "1 strand without points left out",
        "3 strands got more points on their segments, 8 each: .tfx knows one count only",
        "which of the objects a, b holds a strand was not kept",
        "attribute 'width' is kept once a strand, by its mean",
    ]
    back = formats.read(tmp_path / "a.tfx", "cm")
    assert back.point_counts.tolist() == [8, 8, 8]
    wide = Groom(np.zeros((200, 3)), np.array([0, 100, 200]))
    assert formats.write(wide, tmp_path / "a.tfx") == [
        "strands of 100 points were written; TressFX's own programs take 4, 8, 16, 32, 64"
    ]


@pytest.mark.parametrize("count", [7, 8, 13, 64])
def test_evened_strands_keep_their_points_and_their_curve(count: int) -> None:
    rng = np.random.default_rng(5)
    strands = [rng.normal(size=(n, 3)) for n in (7, 2, 3, 1, 5)]
    groom = Groom.from_strands(strands)
    along = np.concatenate([np.arange(len(s), dtype=float) for s in strands])
    groom = Groom(
        groom.points,
        groom.offsets,
        attributes={
            "along": Attribute(along, Scope.POINT),
            "step": Attribute(along.astype(np.int32), Scope.POINT),
            "id": Attribute(np.arange(5), Scope.STRAND),
        },
    )
    even = evened(groom, count)
    assert even.point_counts.tolist() == [count] * 5
    for index, strand in enumerate(strands):
        rows = slice(index * count, (index + 1) * count)
        at = even.attributes["along"].values[rows]
        # Every point is where the polyline is at its number, and all numbers of the old points are there.
        assert set(range(len(strand))) <= set(at.tolist())
        assert np.all(np.diff(at) > 0) or len(strand) == 1
        expected = np.stack([np.interp(at, np.arange(len(strand)), strand[:, c]) for c in range(3)], axis=1)
        np.testing.assert_allclose(even.points[rows], expected, atol=1e-12)
        np.testing.assert_array_equal(even.attributes["step"].values[rows], np.floor(at))
    np.testing.assert_allclose(even.polyline_lengths(), groom.polyline_lengths(), rtol=1e-12)


# ---- .ply

VERTEX = [("float", "x"), ("float", "y"), ("float", "z")]
SEGMENTS = [("ushort", "nsegs")]


@pytest.mark.parametrize("order", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_ply_of_vertices_strands_and_edges(tmp_path: Path, order: str) -> None:
    fields = [*VERTEX, ("uchar", "red"), ("uchar", "green"), ("uchar", "blue"), ("float", "thickness")]
    content = ply(order, ("vertex", 5, fields), ("strand", 2, SEGMENTS), ("edge", 3, [("int", "vertex1")]))
    if order == "ascii":
        content += "".join(f"{x} {y} {z} {i} 7 255 0.5\n" for i, (x, y, z) in enumerate(POINTS)).encode()
        content += b"1\n2\n0\n2\n3\n"
    else:
        sign = "<" if order == "binary_little_endian" else ">"
        content += b"".join(struct.pack(f"{sign}3f3Bf", *p, i, 7, 255, 0.5) for i, p in enumerate(POINTS.tolist()))
        content += struct.pack(f"{sign}2H3i", 1, 2, 0, 2, 3)
    groom = read_bytes(tmp_path, ".ply", content)
    np.testing.assert_array_equal(groom.points, POINTS)
    assert groom.point_counts.tolist() == [2, 3]
    assert groom.attributes["color"].values.tolist() == [[i, 7, 255] for i in range(5)]
    assert groom.attributes["color"].values.dtype == np.uint8
    assert groom.attributes["width"].values.tolist() == [0.5] * 5
    assert (groom.up, groom.unit_source) == ("y", "given")


def test_ply_as_written_is_what_others_read(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    colours = Attribute(np.arange(15, dtype=np.uint8).reshape(5, 3), Scope.POINT)
    groom = Groom(POINTS, np.array([0, 2, 5]), attributes={"color": colours})
    assert formats.write(groom, tmp_path / "a.ply") == []
    header, _, body = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    lines = [line for line in header.decode().splitlines() if not line.startswith("comment")]
    assert lines == [
        *("ply", "format binary_little_endian 1.0", "element vertex 5"),
        *("property float x", "property float y", "property float z"),
        *("property uchar red", "property uchar green", "property uchar blue"),
        *("element strand 2", "property ushort nsegs"),
        *("element edge 3", "property int vertex1", "property int vertex2"),
    ]
    assert struct.unpack_from("<2H6i", body, 5 * 15) == (1, 2, 0, 1, 2, 3, 3, 4)
    cloud = trimesh.load(tmp_path / "a.ply")
    np.testing.assert_array_equal(cloud.vertices, POINTS)


@pytest.mark.parametrize("count", [100, 30])
def test_ply_clouds_of_strands_by_colour(tmp_path: Path, count: int) -> None:
    trimesh = pytest.importorskip("trimesh")
    rng = np.random.default_rng(6)
    points = rng.normal(size=(7 * count, 3)).astype(np.float32)
    # Two neighbours share a colour, as some do by chance.
    colours = rng.integers(0, 255, (7, 4), dtype=np.uint8)
    colours[3] = colours[2]
    trimesh.PointCloud(points, colors=np.repeat(colours, count, axis=0)).export(tmp_path / "a.ply")
    groom = formats.read(tmp_path / "a.ply", "cm")
    assert groom.point_counts.tolist() == [count] * 7
    np.testing.assert_allclose(groom.points, points, rtol=1e-6)
    assert groom.attributes["color"].scope is Scope.STRAND
    np.testing.assert_array_equal(groom.attributes["color"].values, colours)
    assert groom.notes == (f"taken as strands of {count} points, by their colours",)


def test_ply_clouds_without_colours_have_strands_of_a_hundred_points(tmp_path: Path) -> None:
    points = np.zeros((200, 3), dtype="<f4")
    groom = read_bytes(tmp_path, ".ply", ply("binary_little_endian", ("vertex", 200, VERTEX)) + points.tobytes(), None)
    assert groom.point_counts.tolist() == [100, 100]
    assert "taken as strands of 100 points, since the file does not say" in groom.notes
    content = ply("binary_little_endian", ("vertex", 150, VERTEX)) + points[:150].tobytes()
    with pytest.raises(ReadError, match="does not say where its strands begin"):
        read_bytes(tmp_path, ".ply", content)


# ---- what is wrong with a file

BROKEN = [
    (".hair", b"HAIR", "reach to byte 128, the file has 4"),
    (".hair", b"RIAH" + bytes(200), "does not begin with 'HAIR'"),
    (".hair", hair(2, 4, 1, 1) + bytes(100), "holds no points"),
    (".hair", hair(2, 5, 2, 1) + bytes(100), "5 points, its 2 strands of 4"),
    (".hair", hair(2**32 - 1, 2**32 - 1, 3), "reach to byte 8,589,934,718"),
    (".hair", hair(2**31, 2**32 - 1, 2, 2**32 - 1), "damaged"),
    (".hair", hair(1, 100, 2, 99) + bytes(99 * 12), "the file has 1,316"),
    (".hair", hair(2, 4, 6, 1) + bytes(48), "values of width reach"),
    (".data", b"\x01", "the number of strands"),
    (".data", struct.pack("<i", -1) + bytes(40), "-1 strands"),
    (".data", struct.pack("<i", 2**31 - 1) + bytes(40), "2,147,483,647 strands and has 44 bytes"),
    (".data", struct.pack("<ii", 2, -5) + bytes(40), "strand 0 tells of -5 points"),
    (".data", struct.pack("<ii", 2, 2**31 - 1) + bytes(40), "strand 0 tells of 2,147,483,647 points, and 40 bytes"),
    (".data", struct.pack("<iiii", 3, 0, 0, 2) + bytes(23), "strand 2 tells of 2 points, and 20 bytes are left"),
    (".data", struct.pack("<iiii", 3, 1, 0, 0) + bytes(4), "ends after 1"),
    (".tfx", b"\0\0", "the version"),
    (".tfx", struct.pack("<f", 5.0) + bytes(400), "first number is 5"),
    (".tfx", b"nan?" + bytes(400), "no TressFX file"),
    (".tfx", struct.pack("<f", 3.0) + bytes(100), "reach to byte 296"),
    (".tfx", tfx_4(2, 4, [0, 0, 0, 0, 0]) + bytes(200), "holds no points"),
    (".tfx", tfx_4(2**32 - 1, 2**32 - 1, [160, 0, 0, 0, 0]) + bytes(200), "its points reach"),
    (".tfx", tfx_4(2, 4, [160, 2**31, 0, 0, 0]) + bytes(200), "values of uv reach"),
    (".tfx", tfx_4(2, 0, [160, 0, 0, 0, 0]) + bytes(200), "without points"),
    (".tfx", tfx_4(0, 8, [160, 0, 0, 0, 0]) + bytes(200), "no strands"),
    (".ply", b"plx\n", "does not begin with 'ply'"),
    (".ply", b"ply\nformat ascii 1.0\n", "no end"),
    (".ply", b"ply\nend_header\n", "names no format"),
    (".ply", b"ply\nformat morse 1.0\nend_header\n", "line 2"),
    (".ply", b"ply\nformat ascii 1.0\nelement vertex many\nend_header\n", "line 3"),
    (".ply", ply("ascii", ("face", 0, [])), "no vertices"),
    (".ply", ply("ascii", ("vertex", 2, VERTEX), ("strand", 1, SEGMENTS)) + b"0 0 0 1 1 1", "cut short"),
    (".ply", ply("ascii", ("vertex", 2, VERTEX), ("strand", 1, SEGMENTS)) + b"0 0 0 1 1 x 1", "could not convert"),
    (".ply", ply("ascii", ("vertex", 10**12, VERTEX)) + b"0 0 0", "cut short"),
    (".ply", ply("binary_little_endian", ("vertex", 10**15, VERTEX)), "reaches to byte"),
    (".ply", ply("binary_little_endian", ("vertex", 2, VERTEX), ("strand", 1, SEGMENTS)) + bytes(25), "cut short"),
    (".ply", ply("ascii", ("vertex", 2, VERTEX), ("strand", 1, SEGMENTS)) + b"0 0 0 1 1 1 7", "its 1 strands 8"),
    (".ply", ply("ascii", ("vertex", 1, [*VERTEX, ("float", "x")])), "a second property 'x'"),
]


@pytest.mark.parametrize(("suffix", "content", "said"), BROKEN)
def test_what_is_wrong_is_said(tmp_path: Path, suffix: str, content: bytes, said: str) -> None:
    with pytest.raises(ReadError, match=said) as error:
        read_bytes(tmp_path, suffix, content)
    assert f"a{suffix}" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("suffix", [".hair", ".data", ".tfx", ".ply", ".npz"])
def test_every_truncation_is_refused_and_no_flipped_byte_does_worse(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(7)
    groom = Groom(rng.normal(size=(32, 3)), np.arange(5) * 8)
    groom = Groom(groom.points, groom.offsets, attributes={"width": Attribute(rng.random(32), Scope.POINT)})
    formats.write(groom, tmp_path / f"a{suffix}")
    whole = (tmp_path / f"a{suffix}").read_bytes()
    for length in range(0, len(whole), 7):
        with pytest.raises(ReadError):
            read_bytes(tmp_path, suffix, whole[:length])
    for _ in range(200):
        damaged = bytearray(whole)
        at = int(rng.integers(len(whole)))
        damaged[at : at + 4] = rng.bytes(len(damaged[at : at + 4]))
        with suppress(ReadError):
            read_bytes(tmp_path, suffix, bytes(damaged))


@pytest.mark.parametrize("suffix", formats.suffixes())
def test_odd_grooms_and_odd_places(tmp_path: Path, suffix: str) -> None:
    folder = tmp_path / "größe 毛 😀"
    folder.mkdir()
    dots = Groom(POINTS, np.arange(6))
    formats.write(dots, folder / f"ü{suffix}")
    assert formats.read(folder / f"ü{suffix}", "cm").point_counts.tolist() == [1] * 5
    holes = Groom(np.where(POINTS == 4, np.nan, POINTS), np.array([0, 5]))
    formats.write(holes, folder / f"ü{suffix}")
    np.testing.assert_array_equal(formats.read(folder / f"ü{suffix}", "cm").points, holes.points)
    nothing = Groom(np.zeros((0, 3)), np.zeros(1))
    formats.write(nothing, folder / f"0{suffix}")
    result = CliRunner().invoke(detangled, ["info", str(folder / f"0{suffix}")], prog_name="detangled")
    assert (result.exit_code, result.stderr.count("\n")) == (3, 1)


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="nothing is read-only for this user")
@pytest.mark.parametrize("suffix", formats.suffixes())
def test_a_folder_that_cannot_be_written_to(tmp_path: Path, suffix: str) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(WriteError, match="cannot be written"):
        formats.write(Groom(POINTS, np.array([0, 5])), tmp_path / f"a{suffix}")


@pytest.mark.parametrize("suffix", formats.suffixes())
def test_info_names_the_format(tmp_path: Path, suffix: str) -> None:
    formats.write(Groom(POINTS, np.array([0, 5])), tmp_path / f"a{suffix}")
    result = CliRunner().invoke(detangled, ["info", str(tmp_path / f"a{suffix}")], prog_name="detangled")
    assert result.exit_code == 0, result.output
    assert f"format      {formats.format_name(f'a{suffix}')}" in result.stdout


@pytest.mark.parametrize(("text", "cm"), [("2.5mm", 0.25), ("m", 100.0), ("10 cm", 10.0), (".5in", 1.27)])
def test_a_unit_may_be_so_many_of_one(tmp_path: Path, text: str, cm: float) -> None:
    groom = Groom(POINTS, np.array([0, 5]))
    formats.write(groom, tmp_path / "a.data")
    assert formats.read(tmp_path / "a.data", text).unit_cm == pytest.approx(cm)
    for wrong in ("", "0mm", "-1cm", "2.5", "1e999m", "mm2", ".m", "1..2mm"):
        with pytest.raises(ReadError, match="unknown unit"):
            formats.read(tmp_path / "a.data", wrong)


def test_no_strands_with_attributes_are_written_as_ply(tmp_path: Path) -> None:
    empty = Groom(np.zeros((0, 3)), np.zeros(1, dtype=np.int64), {"uv": Attribute(np.zeros((0, 2)), Scope.STRAND)})
    formats.write(empty, tmp_path / "empty.ply")
    assert (tmp_path / "empty.ply").stat().st_size > 0
