"""Every pair of formats, by one helper: from one into the other, what the other can hold comes along."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from detangled import formats
from detangled.groom import Attribute, Groom, Scope

KINDS = (".abc", ".data", ".hair", ".npz", ".obj", ".ply", ".tfx", ".usda", ".usdc")
COUNT = 8  # that TressFX takes
STRANDS = 5

# What each format holds of the groom below, and what it calls a width's scope.
EVERYTHING = {"width", "color", "uv", "inverse_mass", "groom_id", "curl", "label", "N"}
HELD = {
    ".abc": EVERYTHING,
    ".npz": EVERYTHING,
    ".usda": EVERYTHING,
    ".usdc": EVERYTHING,
    ".ply": EVERYTHING - {"label"},
    ".hair": {"width", "color"},
    ".tfx": {"width", "uv", "inverse_mass"},
    ".data": set(),
    ".obj": set(),
}
# TressFX colours have an alpha: one without comes back opaque.
WIDENED = {".tfx": {"color"}}
KEEPS_UNIT = {".npz", ".usda", ".usdc", ".ply", ".hair"}
KEEPS_UP = KEEPS_UNIT


def rich(rng: np.random.Generator) -> Groom:
    points = np.cumsum(rng.normal(scale=0.01, size=(STRANDS, COUNT, 3)), axis=1).reshape(-1, 3)
    total = STRANDS * COUNT
    attributes = {
        "width": Attribute(rng.random(STRANDS).astype(np.float32), Scope.STRAND),
        "color": Attribute(rng.random((total, 3)).astype(np.float32), Scope.POINT),
        "uv": Attribute(rng.random((STRANDS, 2)).astype(np.float32), Scope.STRAND),
        "inverse_mass": Attribute(rng.random(total).astype(np.float32), Scope.POINT),
        "groom_id": Attribute(np.arange(STRANDS, dtype=np.int32), Scope.STRAND),
        "curl": Attribute(rng.random(total), Scope.POINT),
        "label": Attribute(np.array([f"strand {i}" for i in range(STRANDS)]), Scope.STRAND),
        "N": Attribute(rng.random((STRANDS, 3)).astype(np.float32), Scope.STRAND),
    }
    return Groom(
        points.astype(np.float32).astype(np.float64) * 100.0,
        np.arange(STRANDS + 1) * COUNT,
        attributes=attributes,
        unit_cm=100.0,
        unit_source="file",
    )


def spread(groom: Groom, attribute: Attribute, scope: Scope) -> Any:
    """Values of an attribute at a scope that is at least as fine as its own."""
    if attribute.scope is scope:
        return attribute.values
    count = groom.strand_count if scope is Scope.STRAND else len(groom.points)
    return np.repeat(attribute.values, groom.point_counts if attribute.scope is Scope.STRAND else count, axis=0)


def check_pair(groom: Groom, folder: Path, first: str, second: str) -> None:
    """Write a groom in one format, and what is read of it in another: positions, attributes, what is said."""
    formats.write(groom, folder / f"a{first}")
    between = formats.read(folder / f"a{first}", "m")
    lost = formats.write(between, folder / f"b{second}")
    back = formats.read(folder / f"b{second}", "m")
    np.testing.assert_array_equal((back.points / 100.0).astype(np.float32), (groom.points / 100.0).astype(np.float32))
    np.testing.assert_array_equal(back.offsets, groom.offsets)
    given = set(between.attributes)
    for name, attribute in between.attributes.items():
        said = [sentence for sentence in lost if f"attribute {name!r} was not kept" in sentence]
        if name not in back.attributes:
            assert len(said) == 1, (name, lost)
            continue
        assert not said, (name, said)
        found = back.attributes[name]
        ranks = [Scope.GROOM, Scope.STRAND, Scope.POINT]
        scope = max(found.scope, attribute.scope, key=ranks.index)
        expected, values = spread(between, attribute, scope), spread(back, found, scope)
        if name == "width" or values.dtype.kind == "f":
            np.testing.assert_allclose(values[..., : np.shape(expected)[-1]], expected, rtol=2e-7, err_msg=name)
        else:
            np.testing.assert_array_equal(values, expected, err_msg=name)
    if first in (".npz", ".usdc"):
        assert given == EVERYTHING
        assert HELD[second] | WIDENED.get(second, set()) <= set(back.attributes), second
    assert set(back.attributes) - given <= {"inverse_mass"}


@pytest.mark.parametrize(("first", "second"), list(product(KINDS, KINDS)))
def test_every_pair(tmp_path: Path, first: str, second: str) -> None:
    check_pair(rich(np.random.default_rng(1)), tmp_path, first, second)


def test_the_list_above_is_whole() -> None:
    assert {*KINDS, ".usd"} == set(formats.suffixes())


@pytest.mark.parametrize("suffix", KINDS)
def test_unit_and_up_come_back_or_are_said_to_be_lost(tmp_path: Path, suffix: str) -> None:
    groom = rich(np.random.default_rng(2))
    groom = Groom(groom.points, groom.offsets, unit_cm=100.0, unit_source="file", up="z")
    lost = formats.write(groom, tmp_path / f"a{suffix}")
    back = formats.read(tmp_path / f"a{suffix}")
    assert (back.unit_cm == 100.0 and back.unit_source == "file") == (suffix in KEEPS_UNIT)
    assert (back.up == "z") == (suffix in KEEPS_UP)
    assert (not any(sentence.startswith("z stays up") for sentence in lost)) == (suffix in KEEPS_UP)


# TressFX takes strands of one count, as bob's are.
@pytest.mark.parametrize(("name", "suffix"), [("bob" if s == ".tfx" else "eve", s) for s in KINDS])
def test_a_real_groom_through_every_format(
    grooms: Callable[[str], Path], tmp_path: Path, name: str, suffix: str
) -> None:
    groom = formats.read(grooms(f"{name}.usdc"), up="y")
    formats.write(groom, tmp_path / f"a{suffix}")
    back = formats.read(tmp_path / f"a{suffix}", "m")
    # Texts are read as float64, and so are off by less than float32 can tell.
    in_metres = (groom.points / 100.0).astype(np.float32)
    np.testing.assert_array_equal((back.points / 100.0).astype(np.float32), in_metres)
    np.testing.assert_array_equal(back.offsets, groom.offsets)


# Name, strands, points, counts a strand, unit [cm], how the unit is known, up axis, objects.
FACTS = [
    ("eve.abc", 1077, 30439, (7, 32), 100.0, "size", "y", ("eve",)),
    ("eve.usdc", 1077, 30439, (7, 32), 100.0, "file", "z", ("eve",)),
    ("eve.npz", 1077, 30439, (7, 32), 100.0, "size", "z", ("hair",)),
    ("bob.abc", 248, 3968, (16, 16), 100.0, "size", "y", ("bob",)),
    ("bob.usdc", 248, 3968, (16, 16), 100.0, "file", "z", ("bob",)),
    ("bob.npz", 248, 3968, (16, 16), 100.0, "size", "z", ("hair",)),
    ("combover.abc", 30534, 244272, (8, 8), 100.0, "size", "y", ("combover",)),
    ("combover.npz", 30534, 244272, (8, 8), 100.0, "size", "z", ("hair",)),
    ("coily_swatch.obj", 98, 10589, (93, 123), 1.0, "size", "y", None),
    ("tressfx/side.tfx", 3066, 49056, (16, 16), None, "size", "y", ("hair",)),
    ("tressfx/back.tfx", 517, 8272, (16, 16), None, "size", "y", ("hair",)),
    ("tressfx/tail.tfx", 474, 7584, (16, 16), None, "size", "y", ("hair",)),
    ("tressfx/mohawk.tfx", 2228, 71296, (32, 32), 100.0, "size", "y", ("hair",)),
]


@pytest.mark.parametrize(("name", "strands", "points", "counts", "unit_cm", "source", "up", "objects"), FACTS)
def test_every_sample_is_what_its_readme_says(
    grooms: Callable[[str], Path],
    name: str,
    strands: int,
    points: int,
    counts: tuple[int, int],
    unit_cm: float | None,
    source: str,
    up: str,
    objects: tuple[str, ...] | None,
) -> None:
    groom = formats.read(grooms(name))
    assert (groom.strand_count, len(groom.points)) == (strands, points)
    assert (groom.point_counts.min(), groom.point_counts.max()) == counts
    assert (groom.unit_source, groom.up) == (source, up)
    # TressFX's unit, about 2.5 mm, is none that a guess could name.
    assert unit_cm is None or groom.unit_cm == unit_cm
    assert objects is None or groom.objects == objects


def test_tressfx_samples_in_their_own_unit_fit_a_head(grooms: Callable[[str], Path]) -> None:
    parts = [formats.read(grooms(f"tressfx/{name}.tfx"), "2.5mm") for name in ("side", "back", "tail")]
    points = np.concatenate([part.points for part in parts])
    assert 25.0 < np.ptp(points[:, 1]) < 40.0
    # Mirrored, the tail is in front of what it hangs from; turned back it is behind.
    assert parts[2].points[:, 2].mean() < parts[0].points[:, 2].mean()
    (both,) = parts[1].attributes.values()
    assert (both.scope, both.values.tolist()) == (Scope.GROOM, [True])


def test_the_mohawk_has_uvs_and_pinned_points(grooms: Callable[[str], Path]) -> None:
    groom = formats.read(grooms("tressfx/mohawk.tfx"))
    masses = groom.attributes["inverse_mass"].values.reshape(-1, 32)
    assert not np.any(masses[:, :2])
    assert np.all(masses[:, 2:] == 1)
    uv = groom.attributes["uv"]
    assert uv.scope is Scope.STRAND
    assert (uv.values.min() >= 0, uv.values.max() <= 1) == (True, True)
    # Version 4.0 is not mirrored: the neck, below, is behind the brow.
    low = groom.points[:, 1] < np.quantile(groom.points[:, 1], 0.2)
    assert groom.points[low, 2].mean() < groom.points[~low, 2].mean()
