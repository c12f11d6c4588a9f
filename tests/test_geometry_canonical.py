"""Canonical space: against the paper's segment-by-segment rotations, and the identity with its inverse."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from detangled import formats
from detangled.geometry.canonical import guide_frames, phi, phi_inverse
from detangled.geometry.centerline import centerlines
from geometry_curves import chords, helix, random_rotation, wound

EXACT = 1e-9  # of a strand's length


def rotation_between(a: np.ndarray, b: np.ndarray) -> Rotation:
    """The least rotation from one direction to another."""
    axis = np.cross(a, b)
    sine, cosine = np.linalg.norm(axis), a @ b
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, cosine)) if sine > 0 else Rotation.identity()


def phi_by_articulation(strand: np.ndarray, guide: np.ndarray) -> np.ndarray:
    """The paper's text, word by word: rotate all that is outboard of each segment, root to tip."""
    origin = guide[0].copy()
    strand, guide = strand - origin, guide - origin
    for i in range(len(guide) - 1):
        segment = guide[i + 1] - guide[i]
        turn = rotation_between(segment / np.linalg.norm(segment), np.array([0.0, 0.0, -1.0]))
        pivot = guide[i].copy()
        guide[i + 1 :] = turn.apply(guide[i + 1 :] - pivot) + pivot
        strand[i:] = turn.apply(strand[i:] - pivot) + pivot
    return strand


@pytest.mark.parametrize("seed", range(5))
def test_phi_is_the_papers_articulation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    guide = rng.normal(size=(40, 3)).cumsum(axis=0)
    strand = guide + rng.normal(size=(40, 3))
    np.testing.assert_allclose(phi(strand, guide), phi_by_articulation(strand, guide), atol=1e-9 * chords(guide)[-1])


def test_phi_puts_a_guide_on_the_axis() -> None:
    guide = np.random.default_rng(1).normal(size=(60, 3)).cumsum(axis=0)
    on_axis = np.zeros_like(guide)
    on_axis[:, 2] = -chords(guide)
    np.testing.assert_allclose(phi(guide, guide), on_axis, atol=1e-12 * chords(guide)[-1])
    np.testing.assert_allclose(phi_inverse(on_axis, guide), guide, atol=1e-12 * chords(guide)[-1])


def test_guide_frames_are_rotations_that_turn_least() -> None:
    guide = np.random.default_rng(2).normal(size=(5000, 3)).cumsum(axis=0)
    frames = guide_frames(guide)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frames.shape), atol=1e-13)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-13)
    tangents = np.diff(guide, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    np.testing.assert_allclose(-frames[:-1, 2], tangents, atol=1e-13)
    # From one to the next by no more than the angle between the segments.
    turned = np.einsum("nij,nik->njk", frames[1:-1], frames[:-2])  # world rotation between neighbours
    angle = Rotation.from_matrix(turned).magnitude()
    between = np.arccos(np.clip(np.einsum("ni,ni->n", tangents[1:], tangents[:-1]), -1, 1))
    np.testing.assert_allclose(angle, between, atol=1e-6)


@pytest.mark.parametrize("miss", [0.0, 1e-15, 1e-11, 1e-9, 1e-7, 1e-6, 1e-5, 1e-3])
def test_frames_stay_rotations_where_a_guide_folds_back(miss: float) -> None:
    guide = np.array([[0, 0, 0], [1.0, 2.0, -3.0], [miss, -miss, 0.0], [0.0, 0.0, 1.0]])
    frames = guide_frames(guide)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frames.shape), atol=1e-12)
    if miss >= 1e-7:
        # Where the plane of the fold is known, the least turn is half a turn within it.
        normal = np.cross(guide[1], guide[2] - guide[1])
        normal /= np.linalg.norm(normal)
        assert frames[0] @ normal == pytest.approx(frames[1] @ normal, abs=1e-14 / miss)


def degenerate() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(3)
    walk = rng.normal(size=(30, 3)).cumsum(axis=0)
    line = np.linspace([0.0, 0, 0], [1.0, 2.0, 3.0], 20)
    up = np.linspace([0.0, 0, 0], [0.0, 0.0, 5.0], 20)
    return {
        "random": walk,
        "straight": line,
        "straight up": up,
        "fold back": np.concatenate([line, line[-2::-1]]),
        "doubled points": np.repeat(walk, 2, axis=0),
        "all points equal": np.ones((7, 3)),
        "two points": walk[:2],
        "three points": walk[:3],
        "one point": walk[:1],
        "far away": walk + 1e5,
        "doubled helix": np.repeat(helix(0.5, 1.0, 8, 9), 3, axis=0),
        "tiny": walk * 1e-6,
    }


@pytest.mark.parametrize("name", degenerate())
def test_the_inverse_undoes_phi_for_any_guide(name: str) -> None:
    rng = np.random.default_rng(4)
    strand = degenerate()[name]
    length = chords(strand)[-1]
    own, rough = centerlines(strand, [0, len(strand)])
    for guide in (own, rough, strand, strand + rng.normal(size=strand.shape) * length * 0.1):
        assert np.isfinite(guide).all()
        there = phi(strand, guide)
        assert np.isfinite(there).all()
        back = phi_inverse(there, guide)
        # Rounding of a position far away is one of the position, not of the length.
        assert np.abs(back - strand).max() <= EXACT * length + 1e-15 * np.abs(strand).max()


@pytest.mark.parametrize("name", ["coily_swatch.obj", "eve.abc"])
def test_the_inverse_undoes_phi_for_real_strands(name: str, grooms: Callable[[str], Path]) -> None:
    groom = formats.read(grooms(name))
    guides, _ = centerlines(groom.points, groom.offsets)
    for start, end in zip(groom.offsets[:-1], groom.offsets[1:], strict=True):
        strand = groom.points[start:end].astype(np.float64)
        back = phi_inverse(phi(strand, guides[start:end]), guides[start:end])
        assert np.abs(back - strand).max() <= EXACT * chords(strand)[-1]


def test_canonical_shape_does_not_depend_on_where_a_strand_is() -> None:
    strand, guide, _ = wound(0.5, 1.2, 20.0, 120, bend=2.0)
    rng = np.random.default_rng(5)
    turn = random_rotation(rng)
    shift = rng.normal(size=3) * 100
    here = phi(strand, guide)
    there = phi(strand @ turn.T + shift, guide @ turn.T + shift)
    np.testing.assert_allclose(there[:, 2], here[:, 2], atol=1e-10)
    # About the axis, the first rotation from -z decides.
    angle = np.angle((there[:, 0] + 1j * there[:, 1]) / (here[:, 0] + 1j * here[:, 1]))
    np.testing.assert_allclose(np.exp(1j * angle), np.exp(1j * angle[0]), atol=1e-9)
    np.testing.assert_allclose(np.hypot(*there[:, :2].T), 0.5, rtol=1e-2)
