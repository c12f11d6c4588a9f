"""Splines and smoothing against SciPy and plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BarycentricInterpolator, CubicSpline

from detangled.geometry.smoothing import OFFENCE_DEVIATIONS, RELATIVE_TOLERANCE, smooth_channels
from detangled.geometry.spline import (
    chord_lengths,
    distinct_points,
    spline_sample,
    spline_slopes,
    uniform_grid,
    uniform_slopes,
)
from geometry_curves import chords, helix


def end_slopes(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the polynomials through the first and the last four points, at the ends."""
    ends = []
    for part, at in ((slice(0, 4), t[0]), (slice(-4, None), t[-1])):
        # Complex steps differentiate a polynomial to rounding.
        step = 1e-30j
        polynomial = np.polynomial.polynomial.polyfit(t[part] - at, values[part], len(t[part]) - 1)
        ends.append(np.polynomial.polynomial.polyval(step, polynomial).imag / step.imag)
    return ends[0], ends[1]


def scipy_spline(t: np.ndarray, values: np.ndarray) -> CubicSpline:
    first, last = end_slopes(t, values)
    return CubicSpline(t, values, bc_type=((1, first), (1, last)))


def uneven(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.uniform(0.2, 1.0, n)), rng.normal(size=(n, 3))


@pytest.mark.parametrize("n", [2, 3, 4, 5, 9, 120])
def test_the_spline_is_scipys_with_the_same_ends(n: int) -> None:
    t, values = uneven(n, n)
    expected = scipy_spline(t, values)
    slopes = spline_slopes(t, values)
    at = np.sort(np.random.default_rng(0).uniform(t[0], t[-1], 1000))
    np.testing.assert_allclose(slopes, expected(t, 1), atol=1e-9)
    np.testing.assert_allclose(spline_sample(t, values, slopes, at), expected(at), atol=1e-9)


def test_the_spline_of_a_cubic_is_the_cubic() -> None:
    t, _ = uneven(9, 1)
    cubic = np.array([[0.3, -1.0, 0.2, 0.7]]) @ np.array([t**0, t, t**2, t**3])
    values = cubic.T
    at = np.linspace(t[0], t[-1], 500)
    expected = BarycentricInterpolator(t[:4], values[:4])(at)
    np.testing.assert_allclose(spline_sample(t, values, spline_slopes(t, values), at), expected, atol=1e-9)


def test_the_spline_goes_on_straight_beyond_its_ends() -> None:
    t, values = uneven(6, 2)
    slopes = spline_slopes(t, values)
    beyond = spline_sample(t, values, slopes, np.array([t[0] - 0.5, t[-1] + 0.25]))
    np.testing.assert_allclose(beyond, [values[0] - 0.5 * slopes[0], values[-1] + 0.25 * slopes[-1]], atol=1e-12)


@pytest.mark.parametrize("m", [4, 5, 300])
def test_uniform_slopes_are_scipys(m: int) -> None:
    values = np.random.default_rng(m).normal(size=(m, 3))
    t = np.arange(m) * 0.03
    # Slopes are of the order of 1 / 0.03.
    np.testing.assert_allclose(uniform_slopes(values, 0.03), scipy_spline(t, values)(t, 1), atol=1e-7)


def test_chord_lengths_and_grid() -> None:
    points = np.random.default_rng(3).normal(size=(50, 3))
    np.testing.assert_allclose(chord_lengths(points), chords(points), rtol=1e-13)
    np.testing.assert_allclose(uniform_grid(7.0, 21), np.linspace(0.0, 7.0, 22), rtol=1e-15)


def test_distinct_points_drops_doubled_ones_and_nothing_else() -> None:
    points = np.random.default_rng(4).normal(size=(20, 3))
    doubled = np.repeat(points, np.random.default_rng(5).integers(1, 4, 20), axis=0)
    np.testing.assert_array_equal(distinct_points(doubled), points)
    np.testing.assert_array_equal(distinct_points(points), points)
    assert distinct_points(np.ones((5, 3))).shape == (1, 3)
    assert distinct_points(np.empty((0, 3))).shape == (0, 3)
    assert distinct_points(np.array([[0.0, 0, 0], [np.nan, 0, 0]])).shape == (0, 3)
    assert distinct_points(np.array([[0.0, 0, 0], [np.inf, 0, 0]])).shape == (0, 3)


def spiky(m: int, seed: int) -> np.ndarray:
    """Random smooth channels with a few spikes and steps."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 1, m)[:, None]
    values = np.sin(2 * np.pi * (rng.uniform(1, 9, 3) * t + rng.uniform(size=3)))
    for _ in range(4):
        at, channel = rng.integers(5, m - 5), rng.integers(3)
        values[at, channel] += rng.normal(scale=2.0)
        values[at:, (channel + 1) % 3] += rng.normal(scale=2.0)
    return values


def offending(values: np.ndarray, step: float) -> int:
    """The paper's rule in NumPy: edges at least three standard deviations over the mean, channel by channel."""
    edges = np.hypot(np.diff(values, axis=0), step)
    mean = edges.mean(axis=0)
    return int((edges - mean >= np.maximum(OFFENCE_DEVIATIONS * edges.std(axis=0), RELATIVE_TOLERANCE * mean)).sum())


@pytest.mark.parametrize("seed", range(8))
def test_unbounded_smoothing_leaves_no_offending_edge(seed: int) -> None:
    values = spiky(400, seed)
    before = values.copy()
    step = 20.0 / 400
    assert offending(values, step) > 0
    left = smooth_channels(values, step, np.inf)
    assert left == 0
    assert offending(values, step) == 0
    np.testing.assert_array_equal(values[[0, -1]], before[[0, -1]])


@pytest.mark.parametrize("most_blur", [0.0, 0.5, 1.0, 2.0])
def test_bounded_smoothing_respects_its_bound(most_blur: float) -> None:
    # Of a unit impulse, the variance that blurs have given it is the sum of theirs.
    m = 401
    impulse = np.zeros((m, 1))
    impulse[200] = 1.0
    smooth_channels(impulse, 0.01, most_blur)
    shares = impulse[:, 0] / impulse.sum()
    variance = (shares * (np.arange(m) - 200.0) ** 2).sum()
    assert variance <= most_blur**2 * 1.01
    assert variance >= 0.5 * most_blur**2 if most_blur >= 1.0 else True
    if most_blur == 0.0:
        assert shares[200] == 1.0


def test_bounded_smoothing_touches_only_what_is_near_an_offence() -> None:
    t = np.linspace(0, 1, 500)[:, None]
    values = np.sin(2 * np.pi * 3 * t) * 0.1
    values[250:] += 1.0
    smoothed = values.copy()
    smooth_channels(smoothed, 1 / 500, 1.2)
    moved = np.flatnonzero(np.abs(smoothed - values).max(axis=1) > 0)
    assert 0 < len(moved) < 60
    assert abs(moved - 250).max() < 40


@pytest.mark.parametrize(
    "values",
    [helix(0.5, 1.0, 10, 40), np.linspace([0, 0, 0], [1.0, 2.0, -3.0], 400), np.zeros((400, 3))],
    ids=["helix", "straight", "point"],
)
def test_even_channels_are_left_alone(values: np.ndarray) -> None:
    smoothed = values.copy()
    assert smooth_channels(smoothed, 0.03, np.inf) == 0
    np.testing.assert_array_equal(smoothed, values)
