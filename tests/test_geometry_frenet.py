"""Frames, signals and the curves rebuilt from them: analytic curves first, then whatever a groom may hold."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from detangled import formats
from detangled.geometry.canonical import phi
from detangled.geometry.centerline import centerlines
from detangled.geometry.frenet import TINY, frames, integrate, lift_tiny, transport
from detangled.geometry.signal import (
    MOST_TURN,
    cell_means,
    cumulated,
    curve_of,
    dense_count,
    derivatives,
    signals,
    substeps_for,
)
from geometry_curves import TYPES, aligned, chords, helix, one_signal, random_rotation, resampled, wound


def summed(signal: np.ndarray) -> np.ndarray:
    """Angle of bending, angle of torsion and arc length (L + 1, 3) from the root to each end of a cell."""
    steps = signal * signal[:, 2:] / len(signal)
    steps[:, 2] = signal[:, 2] / len(signal)
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


# Frames: the paper's three special cases.


def test_tiny_derivatives_are_lifted_in_the_coordinate_that_varies_least() -> None:
    derivative = np.array([[1.0, 0.1, 0.5], [0.0, 0.0, 0.0], [-1.0, 0.1, -0.4], [0.0, 0.3 * TINY, 0.0]])
    lift_tiny(derivative)
    np.testing.assert_array_equal(derivative[[0, 2]], [[1.0, 0.1, 0.5], [-1.0, 0.1, -0.4]])
    np.testing.assert_array_equal(derivative[1], [0.0, TINY, 0.0])
    assert np.linalg.norm(derivative[3]) >= TINY


def test_an_undefined_stretch_turns_evenly_between_the_normals_beside_it() -> None:
    m, first_end, second_start, angle = 120, 40, 80, 1.9
    tangent = np.tile([0.0, 0.0, -2.0], (m, 1))
    second = np.tile([0.0, 0.0, 3.0], (m, 1))  # parallel to the tangent
    second[20:first_end] += [1.0, 0.0, 0.0]
    # About the tangent -z, positive angles go from x towards -y.
    second[second_start:100] += [np.cos(angle), -np.sin(angle), 0.0]
    _, normal, own = frames(tangent, second, 0.01, 1.0, 0.0)
    np.testing.assert_array_equal(np.flatnonzero(own), [*range(20, first_end), *range(second_start, 100)])
    found = np.unwrap(np.arctan2(-normal[:, 1], normal[:, 0]))
    share = np.clip((np.arange(m) - (first_end - 1)) / (second_start - first_end + 1), 0, 1)
    np.testing.assert_allclose(found, angle * share, atol=1e-12)


def test_a_curve_without_normals_gets_one_carried_along() -> None:
    straight = np.tile([0.3, -0.2, 0.5], (50, 1))
    tangent, normal, own = frames(straight, np.zeros((50, 3)), 0.1, 8.0, 1e-4)
    assert not own.any()
    np.testing.assert_allclose(normal, np.tile(normal[0], (50, 1)), atol=1e-15)
    np.testing.assert_allclose(np.einsum("ij,ij->i", tangent, normal), 0.0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0)


def test_frames_bear_no_speed_at_all() -> None:
    first = np.tile([0.0, 0.0, -1.0], (9, 1))
    first[[0, 4]] = 0.0
    tangent, normal, _ = frames(first, np.zeros((9, 3)), 0.1, 8.0, 0.0)
    assert np.isfinite(tangent).all()
    assert np.isfinite(normal).all()


def test_ringing_beside_a_straight_stretch_has_no_normals_but_a_dip_has() -> None:
    m, per_segment = 400, 8
    first = np.tile([0.0, 0.0, -1.0], (m, 1))
    segments = np.arange(m) / per_segment
    second = np.zeros((m, 3))
    second[:100, 0] = 1.0
    ringing = np.flatnonzero((segments >= 12.5) & (segments < 20))
    second[ringing, 0] = (-0.268) ** (segments[ringing] - 12.5).round() * 0.13
    second[300:, 0] = 1.0
    _, _, own = frames(first, second, 0.01, per_segment, 0.0)
    assert own[:100].all()
    assert own[300:].all()
    assert not own[100:300].any()
    second[100:300] = [0.02, 0.02, 0.0]
    _, _, own = frames(first, second, 0.01, per_segment, 0.0)
    assert own.all()


@pytest.mark.parametrize("seed", range(3))
def test_transport_is_the_least_rotation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, vector = rng.normal(size=(3, 3))
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    axis = np.cross(a, b)
    skew = np.cross(axis, np.eye(3)).T
    turn = np.eye(3) + skew + skew @ skew / (1 + a @ b)
    np.testing.assert_allclose(turn @ a, b, atol=1e-12)
    np.testing.assert_allclose(transport(tuple(vector), tuple(a), tuple(b)), turn @ vector, atol=1e-12)


# Integration.


def integrate_twin(signal: np.ndarray, substeps: int) -> np.ndarray:
    """Runge-Kutta of frame and position, stage by stage, with Gram-Schmidt after each step."""
    frame = np.array([[0.0, 0, -1], [1, 0, 0], [0, -1, 0]])
    out = [np.zeros(3)]
    for kappa, tau, v in signal:
        h = 1.0 / len(signal) / substeps
        rate = v * np.array([[0, kappa, 0], [-kappa, 0, tau], [0, -tau, 0]])
        for _ in range(substeps):
            k1 = rate @ frame
            k2 = rate @ (frame + h / 2 * k1)
            k3 = rate @ (frame + h / 2 * k2)
            k4 = rate @ (frame + h * k3)
            tangents = frame[0] + 2 * (frame + h / 2 * k1)[0] + 2 * (frame + h / 2 * k2)[0] + (frame + h * k3)[0]
            out.append(out[-1] + v * h / 6 * tangents)
            frame = frame + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            frame[0] /= np.linalg.norm(frame[0])
            frame[1] -= frame[0] * (frame[0] @ frame[1])
            frame[1] /= np.linalg.norm(frame[1])
            frame[2] = np.cross(frame[0], frame[1])
    return np.array(out)


def integrate_exactly(signal: np.ndarray) -> np.ndarray:
    """Positions at the ends of cells, by the exponential of each cell's rigid motion."""
    state = np.zeros((4, 3))
    state[:3] = [[0.0, 0, -1], [1, 0, 0], [0, -1, 0]]
    out = [state[3]]
    for kappa, tau, v in signal:
        rate = np.zeros((4, 4))
        rate[:3, :3] = [[0, kappa, 0], [-kappa, 0, tau], [0, -tau, 0]]
        rate[3, 0] = 1.0
        state = expm(rate * (v / len(signal))) @ state
        out.append(state[3])
    return np.array(out)


def random_signal(seed: int, cells: int = 256, length: float = 20.0, hand: int = 1) -> np.ndarray:
    """Smooth random kappa > 0, tau of one hand, and a constant v."""
    rng = np.random.default_rng(seed)
    t = (np.arange(cells) + 0.5) / cells

    def wave(mean: float, size: float) -> np.ndarray:
        return mean + size * sum(rng.normal() * np.cos(np.pi * k * t) for k in range(1, 7)) / 6**0.5

    return np.stack([np.maximum(wave(2.0, 0.4), 0.3), hand * wave(1.5, 0.5), np.full(cells, length)], axis=1)


def test_integration_is_textbook_runge_kutta() -> None:
    signal = random_signal(1, cells=40)
    signal[:, 2] *= np.linspace(0.5, 1.5, 40)
    np.testing.assert_allclose(integrate(signal, 3), integrate_twin(signal, 3), atol=1e-11)


@pytest.mark.parametrize("hand", [-1, 1])
def test_integration_converges_to_the_exponential(hand: int) -> None:
    signal = random_signal(2, cells=64, hand=hand)
    exact = integrate_exactly(signal)
    errors = [np.abs(integrate(signal, n)[::n] - exact).max() for n in (4, 8, 16)]
    assert errors[1] < errors[0] / 12
    assert errors[2] < errors[1] / 12
    substeps = substeps_for(signal)
    assert np.abs(curve_of(signal)[::substeps] - exact).max() < 1e-3 * 20.0


def test_substeps_follow_the_sharpest_turn() -> None:
    signal = np.tile([0.1, 0.0, 10.0], (100, 1))
    assert substeps_for(signal) == 2
    signal[40, 1] = 30.0  # 3 rad in one cell
    assert substeps_for(signal) == int(np.ceil(np.hypot(0.1, 30.0) * 0.1 / MOST_TURN))
    signal[40, 1] = 1e300
    assert substeps_for(signal) == 64
    assert np.isfinite(curve_of(np.zeros((16, 3)))).all()


# Strand to signal.


@pytest.mark.parametrize("per_turn", [4.4, 5, 6, 8, 12, 24, 100])
@pytest.mark.parametrize("hand", [-1, 1])
def test_a_helix_gives_its_curvature_torsion_and_speed(per_turn: float, hand: int) -> None:
    allowed = 0.01 if per_turn >= 6 else 0.02
    shapes = [(0.1, 0.05), (0.55, 0.52), (2.0, 1.0)] + [shape[:2] for shape in TYPES.values()]
    for radius, wavelength in shapes:
        strand = helix(radius, wavelength, 24, per_turn, hand)
        pitch = wavelength / (2 * np.pi)
        squared = radius**2 + pitch**2
        turns = (len(strand) - 1) / per_turn
        expected = [radius / squared, hand * pitch / squared, 2 * np.pi * turns * squared**0.5]
        np.testing.assert_allclose(one_signal(strand).mean(axis=0), expected, rtol=allowed)


def test_the_signal_is_the_papers_formulas_on_a_smooth_curve() -> None:
    n = 400
    t = np.linspace(0.0, 3.0, n)
    curve = np.stack([np.cos(2 * t), np.sin(2 * t) + 0.3 * t, 0.5 * t**2], axis=1) * 3
    one = np.stack([-2 * np.sin(2 * t), 2 * np.cos(2 * t) + 0.3, t], axis=1) * 3
    two = np.stack([-4 * np.cos(2 * t), -4 * np.sin(2 * t), np.ones(n)], axis=1) * 3
    three = np.stack([8 * np.sin(2 * t), -8 * np.cos(2 * t), np.zeros(n)], axis=1) * 3
    speed = np.linalg.norm(one, axis=1)
    cross = np.cross(one, two)
    binormal = cross / np.linalg.norm(cross, axis=1)[:, None]
    kappa = np.linalg.norm(cross, axis=1) / speed**3
    # <N', B> / |gamma'|, where <N', B> is <gamma''', B> over the part of gamma'' across T.
    across = np.linalg.norm(cross, axis=1) / speed
    tau = np.einsum("ij,ij->i", three, binormal) / across / speed
    signal = one_signal(curve, 64)
    at = (np.arange(64) + 0.5) / 64 * chords(curve)[-1]
    inner = slice(2, -2)
    for column, expected in ((0, kappa), (1, tau)):
        there = np.interp(at, chords(curve), expected)
        np.testing.assert_allclose(signal[inner, column], there[inner], rtol=5e-3, atol=5e-3 * np.abs(there).max())
    np.testing.assert_allclose(signal[:, 2].mean(), np.trapezoid(speed, t), rtol=1e-4)


@pytest.mark.parametrize("points", [60, 200])
@pytest.mark.parametrize("angle", [-3.0, -1.5, -0.3, 0.3, 1.0, 2.0, 3.0])
def test_a_lone_twist_at_zero_curvature_keeps_its_angle(points: int, angle: float) -> None:
    radius, bend, third = 2.0, 1.2, points // 3
    u = np.linspace(0.0, bend, third)[:, None]
    arc = radius * ((1 - np.cos(u)) * [1, 0, 0] - np.sin(u) * [0, 0, 1])
    tangent = np.array([np.sin(bend), 0, -np.cos(bend)])
    normal = np.array([np.cos(bend), 0, np.sin(bend)])
    straight = arc[-1] + np.arange(1, third + 1)[:, None] * (radius * bend / (third - 1)) * tangent
    turned = np.cos(angle) * normal + np.sin(angle) * np.cross(tangent, normal)
    other = straight[-1] + radius * (np.sin(u[1:]) * tangent + (1 - np.cos(u[1:])) * turned)
    strand = np.concatenate([arc, straight, other])
    strand = strand @ random_rotation(np.random.default_rng(points)).T
    signal = one_signal(strand)
    twist = summed(signal)[:, 1]
    # The spline rings where the bends begin and end, in their own planes: the sum stays.
    assert twist[-1] == pytest.approx(angle, abs=1e-3)
    np.testing.assert_allclose(twist[:60], 0.0, atol=1e-3)
    np.testing.assert_allclose(twist[-60:], angle, atol=1e-3)
    rebuilt = curve_of(signal)
    along = resampled(chords(strand), strand, len(rebuilt))
    assert np.abs(aligned(rebuilt, along) - along).max() < 0.01 * chords(strand)[-1]


@pytest.mark.parametrize("points", [2, 3, 4, 20, 200])
@pytest.mark.parametrize("stored", [np.float64, np.float32])
@pytest.mark.parametrize("where", [0.0, 170.0])
def test_a_straight_strand_has_no_curvature_and_no_torsion(points: int, stored: type, where: float) -> None:
    direction = random_rotation(np.random.default_rng(points))[0]
    strand = np.linspace(0.0, 20.0, points)[:, None] * direction + where * np.array([0.1, 0.3, 0.9])
    strand = strand.astype(stored).astype(np.float64)
    signal = one_signal(strand)
    # float32 at 170 cm rounds to 8e-6 cm: over steps of 0.1 cm that is a curvature of some 4e-3.
    assert np.abs(signal[:, 0]).max() < (1e-2 if stored is np.float32 else 1e-6)
    assert np.abs(signal[:, 1]).max() < 1e-9
    np.testing.assert_allclose(signal[:, 2], 20.0, rtol=1e-4)
    rebuilt = curve_of(signal)
    along = np.linspace(strand[0], strand[-1], len(rebuilt))
    assert np.abs(aligned(rebuilt, along) - along).max() < 1e-3


# Strand to signal and back.


@pytest.mark.parametrize("hand", [-1, 1])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("length", [20.0, 100.0])
def test_a_smooth_signal_survives_its_strand(length: float, seed: int, hand: int) -> None:
    signal = random_signal(seed, length=length, hand=hand)
    found = one_signal(curve_of(signal))
    means = np.abs(signal).mean(axis=0)
    # At the ends the spline guesses its slope from four points: 3 % there. Inside, what remains is the polyline's
    # chords against its arc, 1/24 of the squared angle of a step: 0.2 % at most.
    assert (np.abs(found - signal) < 0.05 * means).all()
    assert (np.abs(found - signal)[4:-4] < 0.003 * means).all()
    np.testing.assert_allclose(found[:, 2].mean(), length, rtol=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_a_varying_speed_is_kept_as_arc_length(seed: int) -> None:
    # A strand does not know its parameter: what comes back is the signal over the arc length.
    signal = random_signal(seed)
    signal[:, 2] *= np.exp(0.5 * np.sin(np.linspace(0, 9, 256)))
    there, found = summed(signal), summed(one_signal(curve_of(signal)))
    for column in (0, 1):
        expected = np.interp(found[:, 2], there[:, 2], there[:, column])
        np.testing.assert_allclose(found[:, column], expected, atol=0.02)
    assert found[-1, 2] == pytest.approx(there[-1, 2], rel=1e-3)


@pytest.mark.parametrize("seed", range(6))
def test_kinks_of_one_cell_keep_their_angles(seed: int) -> None:
    rng = np.random.default_rng(seed)
    signal = random_signal(seed)
    width = signal[0, 2] / len(signal)
    at = rng.choice(np.arange(10, 246), 6, replace=False)
    signal[at[:3], 1] += rng.choice([-1, 1], 3) * rng.uniform(0.5, 2.5, 3) / width
    signal[at[3:], 0] += rng.uniform(0.3, 1.5, 3) / width
    curve = curve_of(signal)
    again = one_signal(curve)
    there, found = summed(signal), summed(again)
    # The spline rounds a kink off within a cell or two, so sums agree but for a fraction of a kink beside it, and
    # leave no trace of it three cells on.
    away = np.abs(np.arange(257)[:, None] - at - 0.5).min(axis=1) > 3
    np.testing.assert_allclose(found[away, :2], there[away, :2], atol=0.1)
    rebuilt = curve_of(again)
    along = resampled(np.arange(len(curve)), curve, len(rebuilt))
    assert np.linalg.norm(aligned(rebuilt, along) - along, axis=1).max() < 0.5 * 0.32  # of the curls' radius


def test_real_curls_are_rebuilt_within_their_radius(grooms: Callable[[str], Path]) -> None:
    groom = formats.read(grooms("coily_swatch.obj"))
    guides, _ = centerlines(groom.points, groom.offsets)
    drifts = []
    for start, end in zip(groom.offsets[:-1], groom.offsets[1:], strict=True):
        strand = groom.points[start:end].astype(np.float64)
        radius = np.median(np.hypot(*phi(strand, guides[start:end])[:, :2].T))
        rebuilt = curve_of(one_signal(strand))
        at = np.arange(len(rebuilt))
        knots = chords(strand) / chords(strand)[-1] * (len(rebuilt) - 1)
        on_curve = np.stack([np.interp(knots, at, column) for column in rebuilt.T], axis=1)
        drifts.append(np.linalg.norm(aligned(on_curve, strand) - strand, axis=1).max() / radius)
    assert np.median(drifts) < 0.6


# Invariances.


def test_signals_do_not_depend_on_place_and_scale_with_size() -> None:
    strand, _, _ = wound(0.42, 1.25, 18.0, 80, bend=1.5, s_shaped=True)
    signal = one_signal(strand)
    means = np.abs(signal).mean(axis=0)
    moved = one_signal(strand + np.array([1e5, -1e5, 1e5]))
    assert np.abs(moved - signal).max() < 1e-4
    mirrored = one_signal(strand * [1, 1, -1])
    np.testing.assert_allclose(mirrored, signal * [1, -1, 1], atol=1e-6)
    # The smoothing finds its edges channel by channel, and weighs them against lengths in cm: turned or resized, it
    # may find others, and move what lies within a cell.
    turned = one_signal(strand @ random_rotation(np.random.default_rng(0)).T)
    assert (np.abs(summed(turned) - summed(signal))[:, :2] < 0.1).all()
    assert (np.abs(turned - signal).mean(axis=0) < 0.01 * means).all()
    for scale in (0.01, 100.0):
        scaled = one_signal(strand * scale) * [scale, scale, 1 / scale]
        assert (np.abs(scaled - signal).mean(axis=0) < 0.01 * means).all()


def test_unsmoothed_signals_do_not_depend_on_direction_at_all() -> None:
    strand, _, _ = wound(0.42, 1.25, 18.0, 80, bend=1.5)
    found = []
    for turn in (np.eye(3), random_rotation(np.random.default_rng(1))):
        samples = dense_count(len(strand), 256)
        first, second, step = derivatives(np.ascontiguousarray(strand @ turn.T), samples, 0.0)
        signal = np.empty((256, 3))
        cell_means(cumulated(first, second, step, samples / (len(strand) - 1), 0.0), signal)
        found.append(signal)
    np.testing.assert_allclose(found[0], found[1], atol=1e-7)


# Whatever a groom may hold.


def degenerate() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(3)
    walk = rng.normal(size=(30, 3)).cumsum(axis=0)
    line = np.linspace([0.0, 0, 0], [1.0, 2.0, 3.0], 20)
    return {
        "all points equal": np.ones((7, 3)),
        "one point": np.ones((1, 3)),
        "no points": np.ones((0, 3)),
        "doubled points": np.repeat(walk, 2, axis=0),
        "nearly doubled points": np.repeat(walk, 2, axis=0) + rng.normal(size=(60, 3)) * 1e-6,
        "two points": walk[:2],
        "three points": walk[:3],
        "four points": walk[:4],
        "fold back": np.concatenate([line, line[-2::-1]]),
        "fold back on the axis": np.concatenate([line, line[-2::-1]]) * [0, 0, 1],
        "zigzag": np.tile(line[[0, 5]], (20, 1)),
        "far away": walk + 1e5,
        "tiny": walk * 1e-7,
        "huge": walk * 1e7,
    }


@pytest.mark.parametrize("name", degenerate())
@pytest.mark.parametrize("cells", [16, 256])
def test_degenerate_strands_give_finite_signals_and_curves(name: str, cells: int) -> None:
    strand = degenerate()[name]
    signal = one_signal(strand, cells)
    assert np.isfinite(signal).all()
    assert np.isfinite(curve_of(signal)).all()
    if chords(strand)[-1] > 0 if len(strand) else False:
        # A spline is longer than its polyline: at sharp corners much, never shorter by more than its rounding off.
        assert 0.8 * chords(strand)[-1] < signal[:, 2].mean() < 2.0 * chords(strand)[-1]
    else:
        assert not signal.any()


def test_strands_that_are_not_numbers_give_zeros_and_leave_the_others_alone() -> None:
    good = helix(0.5, 1.0, 5, 8)
    bad = good.copy()
    bad[3, 1] = np.nan
    worse = good.copy()
    worse[3, 1] = np.inf
    points = np.concatenate([bad, good, worse])
    n = len(good)
    found = signals(points.astype(np.float32), [0, n, 2 * n, 3 * n], [0, 32, 64, 96])
    assert not found[:32].any()
    assert not found[64:].any()
    np.testing.assert_allclose(found[32:64], one_signal(good, 32), rtol=1e-3, atol=1e-3)


@pytest.mark.slow
def test_a_hundred_thousand_points_are_read() -> None:
    rng = np.random.default_rng(0)
    strand = helix(0.5, 1.0, 30, 100_000 / 30) + rng.normal(scale=1e-5, size=(100_001, 3))
    one_signal(strand[:100])
    signal = one_signal(strand)
    guides, _ = centerlines(strand, [0, len(strand)])
    assert np.isfinite(signal).all()
    assert np.isfinite(guides).all()
