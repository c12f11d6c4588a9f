"""What happens to strands between canonical space and the head, without the command line."""

from __future__ import annotations

import numpy as np

from detangled import Groom, Scope
from detangled.geometry.arc import arc_positions
from detangled.groom import Attribute
from detangled.grooming.guides import resampled_attributes, usable_strands
from detangled.grooming.placing import cut


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
