"""Centrelines: known guides come back, smooth strands are their own, and the optimiser finds SciPy's minimum."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.fft import dct, idct
from scipy.optimize import check_grad, minimize
from scipy.spatial import cKDTree

from detangled import formats
from detangled.geometry import centerline as module
from detangled.geometry.canonical import phi
from detangled.geometry.centerline import (
    BAND,
    FEWEST_TURNS,
    WEIGHT_ADJACENT,
    WEIGHT_CURVATURE,
    WEIGHT_DISPLACEMENT,
    centerlines,
    curl_turns,
    dct_centerline,
    optimise,
)
from geometry_curves import TYPES, bends, chords, helix, random_rotation, wound

SHAPES = [(0.0, False), (1.5, False), (1.5, True), (np.pi, False), (np.pi, True)]


def one_centerline(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return centerlines(points, [0, len(points)])


# The parts.


def test_the_rough_start_is_the_discrete_cosine_transforms() -> None:
    strand = np.random.default_rng(0).normal(size=(30, 3)).cumsum(axis=0)
    at, fine = chords(strand), 200_000
    even = np.linspace(0, at[-1], fine + 1)
    dense = np.stack([np.interp(even, at, column) for column in strand.T], axis=1)
    spectrum = dct(np.diff(dense, axis=0), axis=0)
    spectrum[5:] = 0.0
    low = strand[0] + np.concatenate([np.zeros((1, 3)), np.cumsum(idct(spectrum, axis=0), axis=0)])
    expected = np.stack([np.interp(at, even, column) for column in low.T], axis=1)
    found = dct_centerline(strand, 5)
    np.testing.assert_allclose(found, expected, atol=1e-3)
    np.testing.assert_allclose(found[[0, -1]], strand[[0, -1]], atol=1e-12)


@pytest.mark.parametrize("turns", [3, 8, 24])
def test_turns_are_counted(turns: int) -> None:
    strand = helix(0.5, 1.0, turns, 40)
    counted, curl = curl_turns(strand, np.linspace(strand[0], strand[-1], len(strand)))
    assert counted == pytest.approx(turns, rel=0.02)
    slope = 2 * np.pi * 0.5
    assert curl == pytest.approx(slope**2 / (slope**2 + 1), rel=0.02)


@pytest.mark.parametrize(("per_turn", "allowed"), [(12, 0.15), (24, 0.03), (48, 0.005)])
def test_an_extended_helix_goes_on_as_a_helix(per_turn: int, allowed: float) -> None:
    whole = helix(0.4, 1.0, 10, per_turn)
    extra = per_turn + 2
    extended = module._extend(whole[extra:-extra].copy(), extra)
    # The tangent at the end is a cubic's: the error falls with its third power.
    np.testing.assert_allclose(extended, whole, atol=allowed * 0.4)


def test_an_extended_line_goes_on_straight() -> None:
    line = np.linspace([0.0, 0, 0], [1.0, 2, -5], 65)
    step = line[1] - line[0]
    expected = line[0] + np.arange(-6, 71)[:, None] * step
    np.testing.assert_allclose(module._extend(line, 6), expected, atol=1e-12)


def test_the_banded_solver_solves() -> None:
    rng = np.random.default_rng(1)
    m = 40
    lower = np.tril(np.triu(rng.normal(size=(m, m)), -BAND)) + 4 * np.eye(m)
    matrix = lower @ lower.T
    right = rng.normal(size=(m, 2))
    band = np.zeros((m, BAND + 1))
    for k in range(BAND + 1):
        band[k:, k] = np.diag(matrix, -k)
    expected = np.linalg.solve(matrix, right)
    assert module._solve_band(band, right)
    np.testing.assert_allclose(right, expected, rtol=1e-8, atol=1e-12)
    band[:] = 0.0
    band[:, 0] = -1.0
    assert not module._solve_band(band, right)


# The optimiser.


def objective_twin(flat: np.ndarray, strand: np.ndarray, unit: float) -> tuple[float, np.ndarray]:
    """What ``optimise`` minimises, and its gradient."""
    axis = flat.reshape(-1, 2)
    offset = axis - strand[:, :2]
    r = np.linalg.norm(offset, axis=1)
    spread, steps, second = r - r.mean(), np.diff(r) * unit, np.diff(axis, 2, axis=0) * unit**2
    value = 0.5 * (
        (spread**2).sum()
        + WEIGHT_ADJACENT * (steps**2).sum()
        + WEIGHT_DISPLACEMENT * (axis**2).sum()
        + WEIGHT_CURVATURE * (second**2).sum()
    )
    by_r = spread.copy()
    by_r[1:] += WEIGHT_ADJACENT * steps * unit
    by_r[:-1] -= WEIGHT_ADJACENT * steps * unit
    # Where the axis touches the strand, any direction is as good: the minimum is elsewhere.
    gradient = by_r[:, None] * offset / np.maximum(r, 1e-12)[:, None] + WEIGHT_DISPLACEMENT * axis
    bend = WEIGHT_CURVATURE * second * unit**2
    gradient[2:] += bend
    gradient[1:-1] -= 2 * bend
    gradient[:-2] += bend
    return value, gradient.ravel()


def canonical_strand(name: str, bend: float, noise: float, seed: int) -> tuple[np.ndarray, float]:
    """A strand in the canonical space of its rough start, as the optimiser meets it, and its unit."""
    radius, wavelength, length = TYPES[name]
    strand, _, turns = wound(radius, wavelength, length, 121, bend, s_shaped=True, phase=seed)
    strand += np.random.default_rng(seed).normal(scale=noise * radius, size=strand.shape)
    return phi(strand, dct_centerline(strand, 5)), 120 / (2 * np.pi * turns)


STRANDS = [("III", 1.0, 0.0, 1), ("V", 2.0, 0.02, 2), ("VI", 3.0, 0.05, 3), ("VIII", 1.0, 0.05, 4)]


@pytest.mark.parametrize("which", STRANDS, ids=str)
def test_the_objectives_gradient(which: tuple[str, float, float, int]) -> None:
    strand, unit = canonical_strand(*which)
    axis = np.random.default_rng(0).normal(scale=0.05, size=2 * len(strand))
    gradient = objective_twin(axis, strand, unit)[1]
    error = check_grad(
        lambda x: objective_twin(x, strand, unit)[0], lambda x: objective_twin(x, strand, unit)[1], axis, epsilon=1e-7
    )
    assert error < 1e-4 * np.linalg.norm(gradient)
    # The kernel's own equations point down the same gradient.
    pairs = axis.reshape(-1, 2)
    n = len(strand)
    r, u, band, right = np.empty(n), np.empty((n, 2)), np.empty((2 * n, BAND + 1)), np.empty((2 * n, 2))
    mean = module._distances(pairs, strand, r)
    assert module.objective(pairs, r, mean, unit, WEIGHT_CURVATURE) == pytest.approx(
        objective_twin(axis, strand, unit)[0], rel=1e-9
    )
    module._directions(pairs, strand, r, mean, u)
    module._normal_equations(pairs, r, mean, u, unit, WEIGHT_CURVATURE, 0.0, band, right)
    np.testing.assert_allclose(-right[:, 0], gradient, atol=1e-9 * np.abs(gradient).max())


@pytest.mark.parametrize("which", STRANDS, ids=str)
def test_the_optimiser_finds_the_minimum_of_lbfgs(which: tuple[str, float, float, int]) -> None:
    strand, unit = canonical_strand(*which)
    axis = optimise(strand, unit)
    found = objective_twin(axis.ravel(), strand, unit)[0]
    # From the same start, and from where the optimiser stopped: nothing better there either.
    for start in (np.zeros(2 * len(strand)), axis.ravel()):
        reference = minimize(
            objective_twin,
            start,
            args=(strand, unit),
            jac=True,
            method="L-BFGS-B",
            # Converged far below the one per cent asked for.
            options={"maxiter": 3000, "maxfun": 3000, "ftol": 1e-8, "gtol": 1e-6},
        )
        assert found <= 1.01 * reference.fun


@pytest.mark.parametrize("strand", [np.zeros((70, 3)), np.linspace([0.0, 0, 0], [0, 0, -9], 70)], ids=["point", "axis"])
def test_the_optimiser_leaves_a_strand_on_its_axis(strand: np.ndarray) -> None:
    assert np.abs(optimise(strand, 2.0)).max() < 1e-12


def test_the_optimiser_ends_on_noise() -> None:
    rng = np.random.default_rng(2)
    strands = [rng.normal(size=(80, 3)) * [1, 1, 10] for _ in range(300)]
    for strand in strands:
        assert np.isfinite(optimise(strand, 2.0)).all()


# Guides.


@pytest.mark.parametrize("per_turn", [12, 5])
@pytest.mark.parametrize("name", TYPES)
def test_a_helix_wound_on_a_known_guide_gives_it_back(name: str, per_turn: int) -> None:
    radius, wavelength, length = TYPES[name]
    for bend, s_shaped in SHAPES:
        for phase, hand in ((0.0, 1), (1.0, -1), (2.5, 1)):
            turns = length / np.hypot(2 * np.pi * radius, wavelength)
            points = round(turns * per_turn) + 1
            strand, _, turns = wound(radius, wavelength, length, points, bend, s_shaped, phase, hand)
            u = np.linspace(0.0, 1.0, 4001)
            true, _ = bends(turns * wavelength, np.where(s_shaped & (u > 0.5), -bend, bend))
            guide, rough = one_centerline(strand)
            # How far points of the guide are from the true line, wherever along it.
            off, off_rough = (np.median(cKDTree(true).query(g)[0]) / radius for g in (guide, rough))
            said = f"type {name}, bend {bend:.2f}, S {s_shaped}, {per_turn} points a turn: {off:.3f} R"
            said += f" (DCT {off_rough:.3f} R)"
            print(said)
            assert off < 0.15, said


def test_the_optimised_guide_is_nearer_than_the_rough_one() -> None:
    # With the rough start alone the test above would pass for tight curls on gentle arcs.
    radius, wavelength, length = TYPES["III"]
    strand, _, _ = wound(radius, wavelength, length, 60, 1.5)
    true, _ = bends(wavelength * length / np.hypot(2 * np.pi * radius, wavelength), np.full(4001, 1.5))
    guide, rough = one_centerline(strand)
    tree = cKDTree(true)
    assert np.median(tree.query(guide)[0]) < 0.5 * np.median(tree.query(rough)[0])


@pytest.mark.parametrize("bend", [0.0, 0.5, 1.5, np.pi])
@pytest.mark.parametrize("s_shaped", [False, True])
@pytest.mark.parametrize("points", [8, 30, 200])
def test_a_smooth_strand_is_its_own_guide(bend: float, s_shaped: bool, points: int) -> None:
    u = np.linspace(0.0, 1.0, 4001)
    strand, _ = bends(30.0, np.where(s_shaped & (u > 0.5), -bend, bend))
    strand = strand[np.linspace(0, 4000, points).round().astype(int)]
    guide, _ = one_centerline(strand)
    assert np.linalg.norm(guide - strand, axis=1).max() < 0.01 * 30.0


def test_real_smooth_strands_are_their_own_guides(grooms: Callable[[str], Path]) -> None:
    groom = formats.read(grooms("eve.abc"))
    guides, _ = centerlines(groom.points, groom.offsets)
    off = np.linalg.norm(guides - groom.points, axis=1)
    worst = np.maximum.reduceat(off, groom.offsets[:-1]) / groom.polyline_lengths()
    assert (worst < 0.01).mean() > 0.998
    assert worst.max() < 0.05


def test_real_curls_wind_around_their_guides(grooms: Callable[[str], Path]) -> None:
    groom = formats.read(grooms("coily_swatch.obj"))
    guides, rough = centerlines(groom.points, groom.offsets)
    spreads = []
    for start, end in zip(groom.offsets[:-1], groom.offsets[1:], strict=True):
        strand = groom.points[start:end].astype(np.float64)
        row = []
        for guide in (guides[start:end], rough[start:end]):
            canonical = phi(strand, np.ascontiguousarray(guide))
            r = np.hypot(canonical[:, 0], canonical[:, 1])
            row.append(r.std() / r.mean())
        spreads.append(row)
    optimised, started = np.median(spreads, axis=0)
    assert optimised < 0.7 * started


def test_without_a_style_the_axis_of_a_long_strand_bends_as_that_of_a_short_one() -> None:
    turns, radius, period = 150.0, 0.25, 20.0
    strand = helix(radius, 0.6, turns, 24)
    wander = 0.8 * np.sin(2 * np.pi * strand[:, 2] / (period * 0.6))
    axis = np.stack([wander, np.zeros(len(strand)), strand[:, 2]], axis=1)
    strand = strand + wander[:, None] * [1.0, 0.0, 0.0]
    inner = slice(len(strand) // 10, -len(strand) // 10)
    off = [
        np.median(np.linalg.norm(centerlines(strand, [0, len(strand)], turns)[0] - axis, axis=1)[inner])
        for turns in (24.0, 0.0)
    ]
    assert off[0] < 0.3 * radius
    assert off[1] > 1.5 * radius


# Invariances, and whatever a groom may hold.


def test_guides_move_and_grow_with_their_strands() -> None:
    strand, _, _ = wound(0.42, 1.25, 18.0, 80, bend=2.0, s_shaped=True)
    guide, _ = one_centerline(strand)
    turn = random_rotation(np.random.default_rng(0))
    shift = np.array([1e5, -1e5, 1e5])
    moved, _ = one_centerline(strand @ turn.T + shift)
    np.testing.assert_allclose((moved - shift) @ turn, guide, atol=1e-6)
    for scale in (0.01, 100.0):
        scaled, _ = one_centerline(strand * scale)
        np.testing.assert_allclose(scaled / scale, guide, atol=1e-9)


def test_doubled_points_change_nothing() -> None:
    strand, _, _ = wound(0.42, 1.25, 18.0, 80, bend=2.0)
    guide, rough = one_centerline(strand)
    twice, twice_rough = one_centerline(np.repeat(strand, 2, axis=0))
    np.testing.assert_allclose(twice, np.repeat(guide, 2, axis=0), atol=1e-9)
    np.testing.assert_allclose(twice_rough, np.repeat(rough, 2, axis=0), atol=1e-9)


@pytest.mark.parametrize("n", [0, 1, 2, 3, 4, 30])
def test_degenerate_strands_have_finite_guides(n: int) -> None:
    rng = np.random.default_rng(n)
    line = np.linspace([0.0, 0, 0], [1.0, 2, 3], n)
    zigzag = np.where(np.arange(n)[:, None] % 2, [1.0, 2, 3], [0.0, 0, 0])
    for strand in (np.ones((n, 3)), rng.normal(size=(n, 3)), line, zigzag, rng.normal(size=(n, 3)) * 1e-7 + 1e5):
        for guide in one_centerline(strand):
            assert guide.shape == strand.shape
            assert np.isfinite(guide).all()


def test_strands_that_are_not_numbers_are_passed_through() -> None:
    good = helix(0.5, 1.0, 2 * FEWEST_TURNS, 12)
    bad, worse = good.copy(), good.copy()
    bad[3, 1] = np.nan
    worse[3, 1] = np.inf
    n = len(good)
    points = np.concatenate([bad, good, worse])
    guides, _ = centerlines(points, np.arange(4) * n)
    np.testing.assert_array_equal(guides[:n], bad)
    np.testing.assert_array_equal(guides[2 * n :], worse)
    np.testing.assert_allclose(guides[n : 2 * n], one_centerline(good)[0])


def test_any_kind_of_array_will_do() -> None:
    strand, _, _ = wound(0.42, 1.25, 18.0, 80)
    guide, _ = one_centerline(strand)
    frozen = strand.copy()
    frozen.flags.writeable = False
    kept = frozen.copy()
    for given in (frozen, np.asfortranarray(strand), strand.tolist(), np.repeat(strand, 2, axis=0)[::2]):
        np.testing.assert_array_equal(one_centerline(given)[0], guide)
    np.testing.assert_array_equal(frozen, kept)
    np.testing.assert_allclose(one_centerline(strand.astype(np.float32))[0], guide, atol=1e-4)
