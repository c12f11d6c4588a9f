"""Fewer points a strand: as many as an engine takes, where the strand bends."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from detangled.groom import Attribute, Groom, Scope, offsets_of
from detangled.grooming.fewer_points import fewer_points, points_at
from detangled.grooming.guides import attributes_at


def helix(turns: float, count: int, radius: float = 0.5, rise: float = 1.0) -> NDArray[np.float64]:
    angle = np.linspace(0.0, 2.0 * np.pi * turns, count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), -rise * angle / (2.0 * np.pi)], axis=1)


def straight_then_curly(count: int) -> NDArray[np.float64]:
    z = np.linspace(0.0, 30.0, count)
    radius = 0.4 * np.clip((z - 15.0) / 3.0, 0.0, 1.0)
    return np.stack([radius * np.cos(8.0 * z), radius * np.sin(8.0 * z), -z], axis=1)


def gap_to_polyline(points: NDArray[np.float64], line: NDArray[np.float64]) -> float:
    """How far points lie from a polyline at most: each from all of its segments."""
    worst = 0.0
    for point in points:
        along = np.diff(line, axis=0)
        share = np.clip(((point - line[:-1]) * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
        worst = max(worst, np.linalg.norm(line[:-1] + share[:, None] * along - point, axis=1).min())
    return worst


def test_a_helix_keeps_even_points_and_the_deviation_of_its_chords() -> None:
    strand = helix(10.0, 4001)
    fewer = fewer_points(strand, [0, len(strand)], 161)
    points = points_at(strand, [0, len(strand)], fewer)
    assert fewer.turns[0] == pytest.approx(10.0 * 2.0 * np.pi * 0.5 / np.hypot(np.pi, 1.0), rel=1e-3)
    # 16 chords a turn of radius 0.5 miss it by 0.5 (1 - cos(pi / 16)).
    assert fewer.deviation[0] == pytest.approx(0.5 * (1.0 - np.cos(np.pi / 16.0)), rel=0.1)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert np.ptp(steps) < 0.1 * steps.mean()
    assert np.array_equal(points[[0, -1]], strand[[0, -1]])


def test_points_go_where_a_strand_bends() -> None:
    strand = straight_then_curly(2000)
    fewer = fewer_points(strand, [0, 2000], 255)
    points = points_at(strand, [0, 2000], fewer)
    assert (points[:, 2] > -14.0).sum() < 0.15 * 255
    assert fewer.deviation[0] == pytest.approx(gap_to_polyline(strand, points), rel=0.02)
    even = strand[np.linspace(0, 1999, 255).round().astype(int)]
    assert fewer.deviation[0] < 0.6 * gap_to_polyline(strand, even)


def test_short_strands_keep_their_points_to_the_bit() -> None:
    rng = np.random.default_rng(1)
    counts = [1, 40, 0, 41, 39]
    points = rng.normal(size=(sum(counts), 3))
    offsets = offsets_of(counts)
    fewer = fewer_points(points, offsets, 40)
    assert np.diff(fewer.offsets).tolist() == [1, 40, 0, 40, 39]
    new = points_at(points, offsets, fewer)
    assert np.array_equal(new[:41], points[:41])
    assert np.array_equal(new[-39:], points[-39:])
    assert fewer.deviation[[0, 1, 2, 4]].tolist() == [0.0] * 4


@pytest.mark.parametrize("seed", range(4))
def test_places_rise_and_the_ends_stay_on_any_strand(seed: int) -> None:
    rng = np.random.default_rng(seed)
    strand = np.cumsum(rng.normal(size=(300, 3)) * rng.gamma(0.3, 1.0, (300, 1)), axis=0)
    # Doubled points, as exporters leave them at the ends of locks.
    strand = np.concatenate([strand[:1], strand[:1], np.repeat(strand, rng.integers(1, 3, 300), axis=0), strand[-1:]])
    offsets = [0, len(strand)]
    fewer = fewer_points(strand, offsets, 100)
    assert (np.diff(fewer.at) > 0.0).all()
    assert (fewer.at[0], fewer.at[-1]) == (0.0, len(strand) - 1.0)
    points = points_at(strand, offsets, fewer)
    assert np.array_equal(points[[0, -1]], strand[[0, -1]])
    assert fewer.deviation[0] <= gap_to_polyline(strand, points[[0, -1]]) + 1e-9


def test_strands_that_are_no_curves_pass() -> None:
    strands = np.concatenate([np.zeros((50, 3)), np.full((50, 3), np.nan)])
    fewer = fewer_points(strands, [0, 50, 100], 20)
    points = points_at(strands, [0, 50, 100], fewer)
    assert points.shape == (40, 3)
    assert np.array_equal(points[:20], np.zeros((20, 3)))


def test_attributes_follow_the_points() -> None:
    strand = straight_then_curly(1000)
    along = np.arange(1000.0)
    attributes = {"at": Attribute(along, Scope.POINT), "id": Attribute(np.array([7]), Scope.STRAND)}
    groom = Groom(strand, [0, 1000], attributes)
    fewer = fewer_points(strand, groom.offsets, 90)
    kept = attributes_at(groom, fewer.offsets, fewer.at)
    np.testing.assert_allclose(kept["at"].values, fewer.at, atol=1e-9)
    assert kept["id"].values.tolist() == [7]
