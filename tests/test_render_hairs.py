"""Render hairs: coils stay coils, hairs stay in their wisps, and the command says what it cannot do."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

from detangled.errors import DetangledError, ReadError
from detangled.formats import read, write
from detangled.geometry.winding import winding
from detangled.groom import Attribute, Groom, Scope
from detangled.grooming.guides import style_guides
from detangled.grooming.render_hairs import HairOptions, RenderHairs, render_hairs
from detangled.grooming.wisps import wisps_of
from detangled.head import Head
from detangled.texture import Profile
from detangled_cli.main import detangled

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
Points = NDArray[np.float64]
LENGTH = 12.0


def lattice(count: int = 5, spacing: float = 1.0) -> Points:
    """Roots at even places of a plane, a little off them: a square has two Delaunay triangulations."""
    x, y = np.meshgrid(np.arange(count), np.arange(count), indexing="ij")
    roots = spacing * np.stack([x, y, 0.0 * x], axis=-1).reshape(-1, 3).astype(np.float64)
    return roots + np.random.default_rng(0).uniform(-0.05, 0.05, roots.shape) * [spacing, spacing, 0.0]


def straight(count: int = 5, spacing: float = 1.0, points: int = 20) -> Groom:
    down = np.linspace(0.0, -LENGTH, points)[:, None] * [0.0, 0.0, 1.0]
    return Groom.from_strands([root + down for root in lattice(count, spacing)])


def coily(radius: float = 0.4, wavelength: float = 1.2, count: int = 4, spacing: float = 1.2) -> Groom:
    """Coils out of step with each other; each starts at its root."""
    turns = LENGTH / wavelength
    angle = np.linspace(0.0, 2.0 * np.pi * turns, int(20 * turns))
    strands = []
    for k, root in enumerate(lattice(count, spacing)):
        coil = np.stack([np.cos(angle + 2.4 * k), np.sin(angle + 2.4 * k)], axis=1) * radius
        down = -angle[:, None] * wavelength / (2.0 * np.pi)
        strands.append(root + np.concatenate([coil - coil[0], down], axis=1))
    return Groom.from_strands(strands)


def hairs_of(result: RenderHairs) -> Groom:
    flag = result.groom.attributes["groom_guide"].values
    return result.groom.select(flag == 0)


def distance_to_guide(result: RenderHairs, groom: Groom) -> Points:
    """How far points (N, n) of hairs are from the straight, vertical guides of their wisps."""
    hairs = hairs_of(result)
    points = hairs.points.reshape(hairs.strand_count, -1, 3)
    roots = groom.points[groom.offsets[:-1]][result.wisp]
    return np.linalg.norm((points - roots[:, None])[:, :, :2], axis=2)


# ---- texture


@pytest.mark.parametrize("variation", [0.0, 0.3])
def test_coils_out_of_step_are_not_averaged_away(variation: float) -> None:
    groom = coily()
    result = render_hairs(groom, HairOptions(count=200, variation=variation, flyaways=0.0))
    guides = style_guides(hairs_of(result))
    radius, wavelength = winding(guides.canonical(), guides.groom.offsets)
    assert np.median(radius) == pytest.approx(0.4, rel=0.05)
    assert np.median(wavelength) == pytest.approx(1.2, rel=0.05)
    assert radius.min() > 0.25
    # Which the mean of three neighbours would be.
    strands = groom.points.reshape(16, -1, 3)[:, :, :2]
    mean = (strands[0] + strands[1] + strands[4]) / 3.0
    assert np.linalg.norm(mean - mean.mean(axis=0), axis=1).mean() < 0.25


def test_hairs_all_on_their_guide_are_the_guide_strands_texture() -> None:
    groom = coily()
    result = render_hairs(
        groom, HairOptions(count=64, clump=1.0, clump_profile=Profile((1.0, 1.0)), variation=0.0, flyaways=0.0)
    )
    hairs = hairs_of(result)
    guide = groom.points.reshape(16, -1, 3)[result.wisp]
    lower = slice(guide.shape[1] // 2, None)
    found = hairs.points.reshape(64, -1, 3)
    assert np.abs(found - guide)[:, lower].max() < 0.08


def test_hairs_start_at_roots_of_their_own_and_end_where_their_guides_do() -> None:
    groom = coily()
    result = render_hairs(groom, HairOptions(count=300))
    hairs = hairs_of(result)
    roots = hairs.points[hairs.offsets[:-1]]
    assert len(np.unique(roots, axis=0)) == 300
    np.testing.assert_allclose(roots[:, 2], 0.0, atol=1e-9)
    assert roots[:, :2].min() > -0.2
    assert roots[:, :2].max() < 3.8
    tips = hairs.points[hairs.offsets[1:] - 1]
    assert tips[:, 2].min() > -1.2 * LENGTH
    assert tips[:, 2].max() < -0.8 * LENGTH


def test_hairs_of_coily_strands_are_of_their_type() -> None:
    from detangled.labeling import label

    groom = read(EXAMPLES / "coily_strands.obj", unit="cm")
    groom = groom.select(np.arange(min(groom.strand_count, 8)))
    result = render_hairs(groom, HairOptions(count=24))
    guides, hairs = label(groom), label(hairs_of(result))
    assert (hairs.kind >= 0).all()
    assert np.abs(hairs.kind - guides.kind[result.wisp]).max() <= 1
    assert np.median(hairs.radius) == pytest.approx(np.median(guides.radius), rel=0.1)


# ---- wisps


@pytest.mark.parametrize("clump", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("flyaways", [0.0, 0.1, 0.25])
def test_as_many_hairs_are_within_their_wisp_as_are_asked_for(clump: float, flyaways: float) -> None:
    groom = straight()
    result = render_hairs(groom, HairOptions(count=400, clump=clump, flyaways=flyaways, wisp_radius=0.2, points=24))
    lower = distance_to_guide(result, groom)[:, 12:]
    within = lower.max(axis=1) <= 0.2 * (1.0 + 1e-3)
    assert np.count_nonzero(~within) == round(400 * flyaways)
    np.testing.assert_array_equal(within, result.away <= 0.2 * (1.0 + 1e-9))


@pytest.mark.parametrize(("profile", "tight_at_tip"), [((0.0, 1.0), True), ((1.0, 0.0), False)])
def test_a_wisp_is_tight_where_its_profile_says(profile: tuple[float, ...], tight_at_tip: bool) -> None:
    groom = straight()
    options = HairOptions(
        count=400, clump=0.9, clump_profile=Profile(profile), flyaways=0.0, wisp_radius=0.3, points=41, variation=0.0
    )
    away = distance_to_guide(render_hairs(groom, options), groom).max(axis=0)
    assert away[-1] == pytest.approx(0.03 if tight_at_tip else 0.3, rel=0.05)
    assert away[20] == pytest.approx(0.3 * (1.0 - 0.45), rel=0.05)


def test_sub_clumps_draw_hairs_to_each_other() -> None:
    groom = straight(3, 2.0)
    tips = []
    for tufts in (0, 4):
        options = HairOptions(count=360, sub_clumps=tufts, clump=0.0, flyaways=0.0, variation=0.0, points=16)
        result = render_hairs(groom, replace(options, clump=0.4))
        points = hairs_of(result).points.reshape(360, 16, 3)[:, -1, :2]
        near = np.linalg.norm(points[:, None] - points[None], axis=2) + 1e9 * np.eye(360)
        tips.append(np.median(near.min(axis=1)))
    assert tips[1] < 0.6 * tips[0]


def test_tufts_are_led_by_a_hair_of_the_same_wisp_and_flyaways_by_none() -> None:
    rng = np.random.default_rng(3)
    guide = rng.integers(0, 5, 300)
    middles = lattice(3)[:5]
    roots = middles[guide] + rng.normal(size=(300, 3)) * 0.2
    wisps = wisps_of(guide, roots, middles, 4, 0.1, rng)
    assert (guide[wisps.leaders[:, 0]] == guide).all()
    assert (wisps.leaders[wisps.leaders[:, 1], 0] == wisps.leaders[:, 0]).all()
    assert wisps.flyaway.sum() == 30
    away = np.flatnonzero(wisps.flyaway)
    np.testing.assert_array_equal(wisps.leaders[away], np.stack([away, away], axis=1))
    held = ~wisps.flyaway
    assert len(np.unique(wisps.leaders[held, 0])) == 5 * 4
    assert wisps.rank.max() == 1.0


def test_a_parting_is_not_grown_over() -> None:
    roots = lattice(8)
    side = np.sign(roots[:, :1] - 3.5)
    along = np.linspace(0.0, 8.0, 16)[:, None]
    groom = Groom.from_strands(
        [r + along * (0.9 * s * [1.0, 0, 0] + [0, 0, -0.44]) for r, s in zip(roots, side, strict=True)]
    )
    result = render_hairs(groom, HairOptions(count=2000, flyaways=0.0))
    hairs = hairs_of(result)
    x = hairs.points[hairs.offsets[:-1], 0]
    tips = hairs.points[hairs.offsets[1:] - 1, 0]
    assert ((tips > 3.5) == (x > 3.5)).all()
    assert np.count_nonzero(np.abs(x - 3.5) < 0.12) == 0


# ---- the whole


def test_the_same_seed_gives_the_same_hairs_whatever_the_threads() -> None:
    from detangled.kernels import set_threads, thread_count

    groom, options, threads = coily(), HairOptions(count=100), thread_count()
    one = render_hairs(groom, options).groom.points.tobytes()
    try:
        set_threads(1)
        assert render_hairs(groom, options).groom.points.tobytes() == one
    finally:
        set_threads(threads)
    assert render_hairs(groom, replace(options, seed=1)).groom.points.tobytes() != one


def test_guides_come_first_and_hairs_name_theirs() -> None:
    groom = straight(3)
    groom = replace(
        groom,
        attributes={
            "groom_id": Attribute(np.arange(70, 79, dtype=np.int64), Scope.STRAND),
            "groom_group_id": Attribute(np.arange(9, dtype=np.int32) % 2, Scope.STRAND),
            "width": Attribute(np.full(len(groom.points), 0.05), Scope.POINT),
            "velocities": Attribute(np.zeros((len(groom.points), 3)), Scope.POINT),
        },
    )
    result = render_hairs(groom, HairOptions(count=40, with_guides=True, width=0.007, points=10))
    values = {name: a.values for name, a in result.groom.attributes.items()}
    assert result.groom.strand_count == 49
    np.testing.assert_array_equal(result.groom.select(np.arange(9)).points, groom.points)
    assert values["groom_guide"].tolist() == [1] * 9 + [0] * 40
    assert values["groom_id"].tolist() == list(range(70, 119))
    assert values["groom_closest_guides"].shape == values["groom_guide_weights"].shape == (49, 3)
    assert values["groom_closest_guides"].dtype == np.int32
    assert set(values["groom_closest_guides"].ravel()) <= set(range(70, 79))
    np.testing.assert_allclose(values["groom_guide_weights"].sum(axis=1), 1.0, atol=1e-6)
    assert (np.diff(values["groom_guide_weights"], axis=1) <= 1e-7).all()
    np.testing.assert_array_equal(values["groom_closest_guides"][9:, 0], 70 + result.wisp)
    np.testing.assert_array_equal(values["groom_group_id"][9:], result.wisp % 2)
    assert (values["width"][len(groom.points) :] == 0.007).all()
    assert "velocities" in result.lost[0]
    again = render_hairs(result.groom, HairOptions(count=40, points=10))
    assert "flagged as guides" in again.notes[0]
    assert again.groom.strand_count == 40


def test_hairs_grow_on_the_head() -> None:
    square = np.array([[-1.0, -1, 0.05], [6, -1, 0.05], [6, 6, 0.05], [-1, 6, 0.05]])
    head = Head(square, np.array([[0, 1, 2], [0, 2, 3]]))
    hairs = hairs_of(render_hairs(straight(), HairOptions(count=60), head))
    np.testing.assert_allclose(hairs.points[hairs.offsets[:-1], 2], 0.05, atol=1e-9)
    with pytest.raises(DetangledError, match="does not grow on this head"):
        render_hairs(straight(), HairOptions(count=60), Head(square + 30.0, head.faces))


@pytest.mark.parametrize("count", [1, 2])
def test_guides_too_few_to_span_a_scalp_have_hairs_around_them(count: int) -> None:
    groom = coily().select(np.arange(count))
    result = render_hairs(groom, HairOptions(count=50, flyaways=0.0))
    assert np.isfinite(result.groom.points).all()
    assert result.groom.strand_count == 50
    assert result.away.max() <= result.wisp_radius * (1.0 + 1e-9)


def test_strands_of_no_use_have_no_hairs() -> None:
    good = straight(3)
    groom = Groom.from_strands([np.full((3, 3), np.nan), *[good.strand(k) for k in range(9)], [[0.0, 0, 0]]])
    result = render_hairs(groom, HairOptions(count=30))
    assert "2 strands cannot be guides" in result.notes[0]
    assert result.wisp.min() >= 1
    with pytest.raises(ReadError, match="none of the 1 strands"):
        render_hairs(groom.select([0]), HairOptions(count=30))
    with pytest.raises(ReadError):
        render_hairs(Groom.from_strands([]), HairOptions(count=30))


def test_too_few_points_a_turn_are_said() -> None:
    assert "points a turn" in render_hairs(coily(), HairOptions(count=20, points=30)).notes[0]
    assert render_hairs(coily(), HairOptions(count=20)).notes == ()


@pytest.mark.parametrize(
    "wrong",
    [
        {"count": 0},
        {"clump": 1.2},
        {"flyaways": -0.1},
        {"variation": np.nan},
        {"clump_profile": Profile((0.0, 2.0))},
        {"points": 1},
        {"points": 241},  # of 100,000 hairs: beyond 24 million
        {"wisp_radius": 0.0},
        {"width": -1.0},
        {"sub_clumps": -1},
    ],
)
def test_options_out_of_range_are_refused(wrong: dict) -> None:
    with pytest.raises(DetangledError):
        HairOptions(**wrong)


# ---- the command


def test_the_command_makes_hairs(tmp_path: Path) -> None:
    source, target = tmp_path / "guides.abc", tmp_path / "hairs.abc"
    write(coily(), source)
    arguments = ["hairs", source, target, "--unit", "cm", "--count", "80", "--wisp-radius", "1.5mm", "--with-guides"]
    done = subprocess.run(
        [sys.executable, "-m", "detangled_cli.main", *map(str, arguments)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    assert "80 hairs" in done.stderr
    assert "1.5 mm radius" in done.stderr
    made = read(target, unit="cm")
    assert made.strand_count == 96
    assert {"width", "groom_id", "groom_guide", "groom_closest_guides", "groom_guide_weights"} <= set(made.attributes)
    np.testing.assert_allclose(made.points[made.offsets[:16]], coily().points[coily().offsets[:-1]], atol=1e-5)


@pytest.mark.parametrize(
    ("options", "code", "word"),
    [
        (["--count", "3"], 3, "ask for 16 or more"),
        (["--clump-profile", "tight"], 2, "--clump-profile"),
        (["--clump-profile", "0:3"], 2, "from 0 to 1"),
        (["--wisp-radius", "wide"], 2, "--wisp-radius"),
        (["--width", "3mm"], 2, "a thickness of 3000 um"),
        (["--clump", "nan"], 2, "no finite number"),
        (["--flyaways", "2"], 2, "flyaways"),
        (["--count", "1000000", "--points", "25"], 2, "give fewer points, 24 here, or fewer hairs"),
    ],
)
def test_the_command_refuses_in_one_line(tmp_path: Path, options: list[str], code: int, word: str) -> None:
    source, target = tmp_path / "guides.abc", tmp_path / "hairs.abc"
    write(coily(), source)
    done = CliRunner().invoke(detangled, ["hairs", str(source), str(target), "--unit", "cm", *options])
    assert done.exit_code == code, done.output
    assert word in done.output
    assert not target.exists()
