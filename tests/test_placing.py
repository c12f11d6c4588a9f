"""What happens to strands between canonical space and the head, without the command line."""

from __future__ import annotations

import numpy as np
import pytest

from detangled import Groom, Scope
from detangled.geometry.arc import arc_positions
from detangled.geometry.signal import finer_cells
from detangled.groom import Attribute
from detangled.grooming.guides import resampled_attributes, style_guides
from detangled.grooming.placing import bend_onto, cut, seat, unbend_roots
from detangled.usable import usable_strands


def coil(turns: float, points: int, radius: float = 0.5, wavelength: float = 0.6) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi * turns, points)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), -wavelength * angle / (2.0 * np.pi)], axis=1)


def test_arc_positions_are_a_strands_own_whatever_stands_before_it() -> None:
    strands = [1e4 * coil(9.0, 400), coil(3.3, 41), np.full((5, 3), np.nan), coil(7.0, 90)]
    groom = Groom.from_strands(strands)
    together = arc_positions(groom.points, groom.offsets)
    for index in (0, 1, 3):
        alone = arc_positions(strands[index], np.array([0, len(strands[index])]))
        assert np.array_equal(together[groom.offsets[index] : groom.offsets[index + 1]], alone)
    helix = 3.3 * np.hypot(2.0 * np.pi * 0.5, 0.6)
    assert abs(together[groom.offsets[2] - 1] / helix - 1.0) < 1e-3


def test_a_cut_strand_ends_where_it_should_and_others_stay_whole() -> None:
    groom = Groom.from_strands([coil(5.0, 61), coil(2.0, 25)])
    measure = -groom.points[:, 2]
    points, offsets = cut(groom.points, groom.offsets, measure, np.array([1.7, np.inf]))
    assert abs(points[offsets[1] - 1, 2] + 1.7) < 1e-6
    assert offsets[1] < 61
    assert np.array_equal(points[offsets[1] :], groom.strand(1))


def test_strands_out_of_any_hairs_range_are_not_used() -> None:
    far = np.array([[0.0, 0, 0], [1e38, 0, 0]])
    groom = Groom.from_strands([coil(3.0, 40), far, np.zeros((3, 3)), [[0.0, 0, 0], [0, 0, np.inf]], np.zeros((0, 3))])
    assert usable_strands(groom).tolist() == [True, False, False, False, False]


def test_attributes_keep_their_bits_where_point_counts_stay() -> None:
    rng = np.random.default_rng(3)
    counts = [7, 218, 33]
    groom = Groom.from_strands([rng.normal(size=(n, 3)) for n in counts])
    width = rng.normal(size=sum(counts))
    width[5] = np.inf
    groom = Groom(groom.points, groom.offsets, {"width": Attribute(width, Scope.POINT)})
    kept, lost = resampled_attributes(groom, groom.offsets)
    assert not lost
    assert np.array_equal(kept["width"].values, width)
    shorter = np.array([0, 4, 4 + 218, 4 + 218 + 17])
    ends = resampled_attributes(groom, shorter)[0]["width"].values
    assert ends[0] == width[0]
    assert ends[shorter[1:] - 1].tolist() == width[groom.offsets[1:] - 1].tolist()


def curvatures(points: np.ndarray) -> np.ndarray:
    steps = np.diff(points, axis=0)
    sizes = np.linalg.norm(steps, axis=1)
    bend = np.linalg.norm(np.cross(steps[1:], steps[:-1]), axis=1) / (sizes[1:] * sizes[:-1])
    return np.asarray(np.arcsin(bend) / sizes[1:])


@pytest.mark.parametrize(("radius", "wavelength"), [(0.5, 0.6), (0.95, 3.8), (0.45, 9.0)])
def test_a_strand_of_few_turns_goes_over_to_its_guide_soon_but_without_a_kink(radius: float, wavelength: float) -> None:
    strand = coil(3.0, 400, radius, wavelength)
    seated = seat(strand, np.zeros(3), 0.7)
    assert np.array_equal(seated[0], np.zeros(3))
    # A circle through the axis lies 4 / pi radii from it in the mean.
    assert 0.9 < np.hypot(seated[:, 0], seated[:, 1]).mean() / radius < 1.08
    assert curvatures(seated).max() < 1.3 * np.median(curvatures(strand))


@pytest.mark.parametrize("radius", [0.4, 1.0, 3.0])
def test_a_strand_keeps_its_frame_to_the_end_of_a_tightly_bent_guide(radius: float) -> None:
    angle = np.linspace(0.0, 1.5, 12)
    guide = radius * np.stack([np.sin(angle), np.zeros(12), np.cos(angle) - 1.0], axis=1)
    length = 1.5 * radius
    canonical = np.array([[0.0, 0.0, 0.0], [0.5, 0.3, -0.5 * length], [0.5, 0.3, -length]])
    tip = bend_onto(canonical, guide)[-1]
    tangent = np.array([np.cos(1.5), 0.0, -np.sin(1.5)])
    # Across the guide's end, by the smooth curve through 12 points.
    assert abs((tip - guide[-1]) @ tangent) < 1e-3 * length
    assert np.linalg.norm(tip - guide[-1]) == pytest.approx(np.hypot(0.5, 0.3), abs=1e-3)


def test_a_straightened_coil_leaves_its_root_without_a_kink() -> None:
    bent = np.linspace(0.0, 3.0, 60)
    arc = 3.0 * np.stack([np.sin(bent), np.zeros(60), np.cos(bent) - 1.0], axis=1)
    usable = style_guides(Groom.from_strands([bend_onto(coil(20.0, 90) @ turned(a).T, arc) for a in (0.0, 2.0, 4.0)]))
    old_roots, offsets = usable.groom.points[usable.groom.offsets[:-1]], usable.groom.offsets
    roots = unbend_roots(old_roots, usable.points, offsets)
    assert (np.hypot(roots[:, 0], roots[:, 1]) > 0.25).all()  # half a radius from the guide, of 4.5 points a turn
    straight = np.linspace(0.0, 1.0, 120)[:, None] * [0.0, 0.0, -10.0]
    for strand, root in enumerate(roots):
        guide = usable.points[offsets[strand] : offsets[strand + 1]]
        made = bend_onto(seat(straight, root, 0.0), guide)
        np.testing.assert_allclose(made[0], old_roots[strand], atol=2e-9)
        made[0] = old_roots[strand]
        # The arc's .33/cm, and what the strand takes to lie down.
        assert curvatures(made)[:5].max() < 0.4


def turned(angle: float) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def test_finer_cells_keep_each_cells_angle_and_make_no_negative_curvature() -> None:
    rng = np.random.default_rng(5)
    signal = np.stack([rng.gamma(0.5, 2.0, 64), 3.0 * rng.normal(size=64), rng.uniform(8.0, 12.0, 64)], axis=1)
    signal[20, 0] = 0.0
    fine = finer_cells(signal, 4)
    np.testing.assert_allclose(fine.reshape(64, 4, 3).mean(axis=1), signal, atol=1e-9)
    assert fine[:, 0].min() >= 0.0
    helix = np.tile([1.8, 0.3, 20.0], (40, 1))
    np.testing.assert_allclose(finer_cells(helix, 3), np.tile([1.8, 0.3, 20.0], (120, 1)), rtol=1e-9)


def test_finer_cells_follow_a_smooth_signal() -> None:
    edges = np.linspace(0.0, 1.0, 65)
    fine_edges = np.linspace(0.0, 1.0, 257)

    def means(at: np.ndarray) -> np.ndarray:
        return 2.0 + np.diff(-np.cos(20.0 * at) / 20.0) / np.diff(at)

    signal = np.stack([means(edges), -means(edges), np.ones(64)], axis=1)
    found = finer_cells(signal, 4)[:, 0]
    inner = slice(16, -16)
    constant = np.abs(np.repeat(signal[:, 0], 4) - means(fine_edges))[inner].max()
    assert np.abs(found - means(fine_edges))[inner].max() < 0.01 * constant
