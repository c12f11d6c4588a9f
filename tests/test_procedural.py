"""Procedural strands and their signals: as long, wound and twisted as they were asked, and always the same."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from detangled.errors import TextureError
from detangled.geometry.arc import arc_lengths
from detangled.geometry.winding import winding
from detangled.kernels import set_threads
from detangled.texture import HAIR_TYPES, LENGTH_LIMITS, Profile, arc_of_a_turn
from detangled_training.signals import margins, pooled_whitening, straightened
from detangled_training.strands import (
    LONGEST_STEP,
    POINTS_PER_TURN,
    UNTYPED,
    UNTYPED_RADII,
    UNTYPED_SLOPES,
    UNTYPED_TURNS,
    Recipes,
    Strands,
    _twist,
    draw_recipes,
    make_strands,
    procedural_strands,
)
from detangled_training.variants import VariantOptions, make_variants
from geometry_curves import helix

COUNT = 300
CURLY = [(k.radius.mean, k.wavelength.mean, k.length.mean) for k in HAIR_TYPES[2:]]


def steps(points: np.ndarray) -> np.ndarray:
    return np.diff(points, axis=0)


def one(strands: Strands, s: int) -> np.ndarray:
    return strands.points[strands.offsets[s] : strands.offsets[s + 1]]


def equal(a: object, b: object) -> None:
    """Every array of two dataclasses is the same to the bit."""
    for field in fields(a):  # type: ignore[arg-type]
        assert getattr(a, field.name).tobytes() == getattr(b, field.name).tobytes(), field.name


@pytest.fixture(scope="module")
def strands() -> Strands:
    return procedural_strands(COUNT, seed=3)


# Strands.


@pytest.mark.parametrize(("radius", "wavelength", "length"), CURLY)
@pytest.mark.parametrize("hand", [1, -1])
def test_a_strand_without_twists_is_the_helix(radius: float, wavelength: float, length: float, hand: int) -> None:
    strand = one(make_strands(Recipes.asked(radius, wavelength, 0.0, length, hand), seed=0), 0)
    turns = length / arc_of_a_turn(radius, wavelength)
    per_turn = (len(strand) - 1) / turns
    assert per_turn >= POINTS_PER_TURN
    angle = np.arange(len(strand)) * (2 * np.pi / per_turn)
    expected = np.stack(
        [radius * np.cos(angle), -hand * radius * np.sin(angle), -angle * wavelength / (2 * np.pi)], axis=1
    )
    np.testing.assert_allclose(strand, expected, atol=1e-9)
    np.testing.assert_allclose(strand[:9], helix(radius, wavelength, 8 / per_turn, per_turn, hand), atol=1e-9)


def test_strands_are_as_long_as_asked_and_finely_sampled(strands: Strands) -> None:
    np.testing.assert_allclose(arc_lengths(strands.points, strands.offsets), strands.length, rtol=2e-3)
    np.testing.assert_allclose(strands.as_groom().polyline_lengths(), strands.length, rtol=6e-3)
    for s in range(COUNT):
        assert np.linalg.norm(steps(one(strands, s)), axis=1).max() <= LONGEST_STEP * 1.0001
    np.testing.assert_array_equal(strands.body, np.stack([strands.offsets[:-1], strands.offsets[1:]], axis=1))


def test_twists_are_as_many_as_asked_and_turn_the_rest_rigidly(strands: Strands) -> None:
    np.testing.assert_array_equal(strands.twists, np.round(1.5 * strands.twist * strands.length))
    recipes = draw_recipes(COUNT, seed=3)
    plain = make_strands(replace(recipes, twist=np.zeros(COUNT)), seed=3)
    assert plain.twists.sum() == 0
    np.testing.assert_array_equal(plain.offsets, strands.offsets)
    for s in range(COUNT):
        before, after = steps(one(plain, s)), steps(one(strands, s))
        size = np.linalg.norm(before, axis=1)
        np.testing.assert_allclose(np.linalg.norm(after, axis=1), size, rtol=1e-9)
        # A turn about the segment before a point keeps the bend there; so all bends are kept.
        np.testing.assert_allclose(
            np.einsum("ij,ij->i", after[1:], after[:-1]), np.einsum("ij,ij->i", before[1:], before[:-1]), atol=1e-12
        )
        # Between twists all is rigid: triple products change at no more than two places for each.
        volume = [np.einsum("ij,ij->i", np.cross(e[:-2], e[1:-1]), e[2:]) for e in (before, after)]
        changed = np.abs(volume[1] - volume[0]) > 1e-9 * np.prod(np.stack([size[:-2], size[1:-1], size[2:]]), axis=0)
        assert changed.sum() <= strands.twists[s]
        if strands.twists[s] == 0:
            np.testing.assert_allclose(one(strands, s), one(plain, s), atol=1e-9)
        elif strands.kind[s] > 3:
            assert changed.sum() >= strands.twists[s] - 1  # one at the first point inside has no segment before to tell


def test_twisting_is_rotating_all_beyond_a_point_about_the_segment_before() -> None:
    rng = np.random.default_rng(2)
    strand = rng.normal(size=(30, 3)).cumsum(axis=0)
    at, angle = np.array([1, 2, 9, 28]), rng.uniform(-np.pi, np.pi, 4)
    expected = strand.copy()
    for i, turn in zip(at, angle, strict=True):
        tangent = (expected[i] - expected[i - 1]) / np.linalg.norm(expected[i] - expected[i - 1])
        expected[i:] = Rotation.from_rotvec(turn * tangent).apply(expected[i:] - expected[i]) + expected[i]
    _twist(strand, at, angle)
    np.testing.assert_allclose(strand, expected, atol=1e-10)


def test_twist_angles_are_even_over_the_circle() -> None:
    recipes = Recipes.asked(0.5, 1.0, 1.0, np.full(20, 60.0))
    made, plain = make_strands(recipes, 4), make_strands(replace(recipes, twist=np.zeros(20)), 4)
    angles, places = [], []
    for s in range(20):
        dihedral = []
        for strands in (made, plain):
            e = steps(one(strands, s))
            normal = np.cross(e[:-1], e[1:])
            sine = np.einsum("ij,ij->i", np.cross(normal[:-1], normal[1:]), e[1:-1]) / np.linalg.norm(e[1:-1], axis=1)
            dihedral.append(np.arctan2(sine, np.einsum("ij,ij->i", normal[:-1], normal[1:])))
        turned = np.angle(np.exp(1j * (dihedral[0] - dihedral[1])))
        hit = np.abs(turned) > 1e-6
        angles.append(turned[hit])
        places.append(np.flatnonzero(hit) / len(hit))
    for values, low, high in ((np.concatenate(angles), -np.pi, np.pi), (np.concatenate(places), 0.0, 1.0)):
        assert len(values) >= 20 * 88
        shares = np.sort((values - low) / (high - low))
        assert np.abs(shares - np.linspace(0.0, 1.0, len(shares))).max() < 1.63 / np.sqrt(len(shares))  # 1 % level


def test_profiles_along_the_strand_are_followed() -> None:
    recipes = Recipes.asked(Profile((0.6, 0.3)), Profile((1.0, 2.0)), 0.0, 40.0)
    made = make_strands(recipes, 0)
    strand = one(made, 0)
    share = np.linspace(0.0, 1.0, len(strand))
    radius = np.hypot(strand[:, 0], strand[:, 1])
    np.testing.assert_allclose(radius, 0.6 - 0.3 * share, atol=1e-9)
    angle = np.unwrap(np.arctan2(-strand[:, 1], strand[:, 0]))
    local = -2 * np.pi * np.gradient(strand[:, 2]) / np.gradient(angle)
    np.testing.assert_allclose(local[5:-5], (1.0 + share)[5:-5], rtol=2e-3)
    assert made.radius[0] == pytest.approx(0.45, rel=1e-3)
    _, wound = winding(made.points, made.offsets)
    assert made.wavelength[0] == pytest.approx(wound[0], rel=1e-3)
    np.testing.assert_allclose(arc_lengths(made.points, made.offsets), 40.0, rtol=1e-3)


def test_margins_surround_the_body() -> None:
    recipes = Recipes.asked(0.4, 1.2, np.array([0.0, 0.5]), 15.0)
    plain, made = make_strands(recipes, 1), make_strands(recipes, 1, margin=4.0)
    bodies = [made.points[a:b] for a, b in made.body]
    assert [len(b) for b in bodies] == list(np.diff(plain.offsets))
    body = bodies[0]
    np.testing.assert_allclose(np.linalg.norm(steps(body), axis=1), np.linalg.norm(steps(one(plain, 0)), axis=1))
    arcs = arc_lengths(made.points, made.offsets)
    assert (arcs >= 22.95).all()
    assert (arcs <= 23.0 + 2 * LONGEST_STEP).all()  # whole steps
    np.testing.assert_array_equal(made.twists, plain.twists)


def test_drawn_strands_are_of_all_types_both_hands_and_all_kinds(strands: Strands) -> None:
    assert np.bincount(strands.kind, minlength=8).min() > COUNT / 16
    assert 0.4 < np.mean(strands.hand > 0) < 0.6
    recipes = draw_recipes(COUNT, seed=3)
    spread = np.ptp(np.log(recipes.radius), axis=1)
    straight = np.abs(np.diff(np.log(recipes.radius), 2, axis=1)).max(axis=1) < 1e-9
    shares = [np.mean(spread < 1e-9), np.mean(straight & (spread > 1e-9)), np.mean(~straight)]
    np.testing.assert_allclose(shares, [0.4, 0.3, 0.3], atol=0.1)
    # Radius and wavelength are told of the strand as it is: the profiles hardly move them.
    np.testing.assert_allclose(strands.radius, np.exp(np.log(recipes.radius).mean(axis=1)), rtol=0.06)
    assert (procedural_strands(5, 0, kinds=[0, 3, 3, 7, 1]).kind == [0, 3, 3, 7, 1]).all()


def test_a_strand_depends_on_its_seed_and_number_alone(strands: Strands) -> None:
    part = procedural_strands(40, seed=3, first=100)
    for s in range(40):
        assert one(part, s).tobytes() == one(strands, 100 + s).tobytes()
    set_threads(1)
    try:
        equal(procedural_strands(COUNT, seed=3), strands)
    finally:
        set_threads(64)
    assert one(procedural_strands(1, seed=4), 0).shape != one(strands, 0).shape


@pytest.mark.parametrize(
    "numbers", [(0.0, 1.0, 0.0, 5.0), (0.5, -1.0, 0.0, 5.0), (0.5, 1.0, 1.5, 5.0), (0.5, 1.0, 0.0, np.inf)]
)
def test_recipes_that_are_no_strands_are_refused(numbers: tuple[float, ...]) -> None:
    with pytest.raises(TextureError):
        Recipes.asked(*numbers)


# In canonical space.


@pytest.mark.parametrize("length", [None, 6.0])
@pytest.mark.parametrize("hand", [1, -1])
def test_a_helix_measures_back(length: float | None, hand: int) -> None:
    radius, wavelength, lengths = np.array(CURLY).T
    recipes = Recipes.asked(radius, wavelength, 0.0, length or lengths, hand)
    canonical = straightened(make_strands(recipes, 0, margins(recipes)))
    assert canonical.found.all()
    measured = winding(canonical.points, canonical.offsets)
    np.testing.assert_allclose(measured[0], radius, rtol=0.01)
    np.testing.assert_allclose(measured[1], wavelength, rtol=0.01)
    np.testing.assert_allclose(arc_lengths(canonical.points, canonical.offsets), length or lengths, rtol=0.005)


def test_a_nearly_straight_strand_keeps_its_wave() -> None:
    recipes = Recipes.asked(np.array([0.2, 0.05, 0.45]), np.array([20.0, 40.0, 9.0]), 0.0, 30.0)
    canonical = straightened(make_strands(recipes, 0, margins(recipes)))
    np.testing.assert_array_equal(canonical.found, [False, False, True])
    arc = arc_lengths(canonical.points, canonical.offsets)
    np.testing.assert_allclose(arc, 30.0, rtol=1e-3)
    np.testing.assert_allclose(winding(canonical.points, canonical.offsets)[0], [0.2, 0.05, 0.45], rtol=0.01)


def test_a_share_of_strands_is_of_no_type_and_drawn_by_independent_numbers() -> None:
    typed, drawn = draw_recipes(2000, seed=4), draw_recipes(2000, seed=4, untyped=0.25)
    free = drawn.kind == UNTYPED
    assert 0.2 < free.mean() < 0.3
    for name in ("kind", "radius", "wavelength", "twist", "length"):
        np.testing.assert_array_equal(getattr(drawn, name)[~free], getattr(typed, name)[~free])
    some = draw_recipes(2000, seed=4, untyped=1.0)
    assert (some.kind == UNTYPED).all()
    radius, wavelength = (np.exp(np.log(knots).mean(axis=1)) for knots in (some.radius, some.wavelength))
    turn = arc_of_a_turn(radius, wavelength)
    slope = wavelength / (2.0 * np.pi * radius)
    turns = some.length / turn
    assert turns.min() >= 0.99 * UNTYPED_TURNS[0]
    assert turns.max() <= 1.01 * UNTYPED_TURNS[1]
    assert some.length.max() < LENGTH_LIMITS[1]
    for values, (least, most) in ((radius, UNTYPED_RADII), (slope[wavelength > 0.151], UNTYPED_SLOPES)):
        assert values.min() >= 0.99 * least
        assert values.max() <= 1.01 * most
        assert np.median(values) == pytest.approx(np.sqrt(least * most), rel=0.25)
    for a, b in ((radius, slope), (radius, some.twist), (slope, some.twist), (some.twist, some.length)):
        assert abs(np.corrcoef(np.log(a), np.log(b))[0, 1]) < 0.1
    # Wider than the types: flat coils of any size are among them.
    flat = [
        float(((one.wavelength[:, 0] < one.radius[:, 0]) & (one.radius[:, 0] > 0.4)).mean()) for one in (some, typed)
    ]
    assert flat[0] > 4.0 * flat[1]


def test_straightening_makes_twisted_strands_straighter() -> None:
    recipes = draw_recipes(64, seed=1, kinds=5)
    made = make_strands(recipes, 1, margins(recipes))
    canonical = straightened(made)
    ends = [canonical.offsets[:-1], canonical.offsets[1:] - 1]
    chords = np.linalg.norm(canonical.points[ends[1]] - canonical.points[ends[0]], axis=1)
    before = np.linalg.norm(made.points[made.body[:, 1] - 1] - made.points[made.body[:, 0]], axis=1)
    axes = made.length * made.wavelength / arc_of_a_turn(made.radius, made.wavelength)
    assert np.median(chords / axes) > np.median(before / axes) + 0.1
    assert np.median(chords / axes) > 0.8


# Signals.


def procedural_signals(count: int, cells: int = 256, first: int = 0) -> tuple:
    return make_variants(first, count, 5, VariantOptions(read_share=0.0, cells=cells))


@pytest.fixture(scope="module")
def made() -> tuple:
    return procedural_signals(COUNT)


def test_signals_are_finite_and_hold_the_length(made: tuple) -> None:
    values, labels = made
    assert values.shape == (COUNT, 256, 3)
    assert values.dtype == np.float32
    assert np.isfinite(values).all()
    assert (values[:, :, 2] > 0.0).all()
    assert (values[:, :, 0].min(axis=1) > -0.5).all()
    covered = np.diff(labels["position"], axis=1)[:, 0]
    assert np.median(np.abs(values[:, :, 2].mean(axis=1) / covered / labels["length"] - 1.0)) < 0.03


def test_signals_of_helices_are_their_curvature_and_torsion(made: tuple) -> None:
    values, labels = made
    kinds = (labels["twists"] == 0) & (labels["turns"] > 1.0)
    assert kinds.sum() >= 8
    c = labels["wavelength"] / (2 * np.pi)
    below = labels["radius"] ** 2 + c**2
    kappa, tau = np.median(values[:, :, 0], axis=1), np.median(values[:, :, 1], axis=1)
    assert np.median(np.abs(kappa * below / labels["radius"] - 1.0)[kinds]) < 0.03
    assert np.median(np.abs(tau * below / c * labels["hand"] - 1.0)[kinds]) < 0.03
    assert (np.sign(tau) == labels["hand"])[kinds].mean() > 0.98


def test_dense_strands_are_cropped_and_stay_resolved() -> None:
    values, labels = procedural_signals(COUNT, cells=64)
    t0, t1 = labels["position"].T
    assert ((t0 >= 0.0) & (t1 <= 1.0) & (t1 > t0)).all()
    cropped = t1 - t0 < 1.0
    assert 0.05 < cropped.mean() < 0.6
    assert (labels["turns"][~cropped] * 16.0 <= 64.0).all()
    assert (labels["turns"] * 16.0 * (t1 - t0) <= 64.0 * 1.0001).all()
    assert len(np.unique(t0[cropped])) > 10
    # A crop is these cells of the same strand on the finer grid.
    s = np.flatnonzero(cropped)[0]
    cells = round(64 / (t1 - t0)[s])
    whole, _ = procedural_signals(1, cells=cells, first=int(s))
    begin = round(t0[s] * cells)
    np.testing.assert_allclose(values[s, :, :2], whole[0, begin : begin + 64, :2], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(values[s, :, 2], whole[0, begin : begin + 64, 2] * 64 / cells, rtol=1e-5)


def test_signals_depend_on_seed_and_number_alone(made: tuple) -> None:
    values, labels = procedural_signals(20, first=270)
    assert values.tobytes() == made[0][270:290].tobytes()
    for name, column in labels.items():
        assert column.tobytes() == made[1][name][270:290].tobytes(), name
    assert (labels["kind"] != UNTYPED).all()


def test_whitening_is_pooled(made: tuple) -> None:
    whitening = pooled_whitening(made[0])
    channels = whitening.whiten(made[0].astype(np.float64))
    np.testing.assert_allclose(channels.mean(axis=(0, 2)), 0.0, atol=1e-6)
    np.testing.assert_allclose(channels.std(axis=(0, 2)), 1.0, rtol=1e-6)
