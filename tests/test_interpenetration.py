"""Hair in a head: counted, guides turned out by the least turn, new strands lifted off, and heads that do not fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from detangled.errors import ReadError
from detangled.formats import read
from detangled.formats.meshes import read_head
from detangled.geometry.arc import arc_lengths
from detangled.groom import Groom, offsets_of
from detangled.grooming.head_distance import HeadDistance, head_distance
from detangled.grooming.head_fit import fitted_to
from detangled.grooming.interpenetration import entering, inside, turned_out
from detangled.grooming.lifting import Room, place_outside
from detangled.grooming.placing import place
from detangled.kernels import set_threads
from heads import RADIUS, hair_on, scalp, scalp_hair, sphere

CLEARANCE = 0.02


@pytest.fixture(scope="module")
def ball() -> HeadDistance:
    return head_distance(sphere(), finest=0.25)


def sunk(angles: np.ndarray, length: float = 6.0) -> Groom:
    """Straight strands from the top of the sphere, so much below its tangent plane [rad]."""
    t = np.linspace(0.0, length, 9)[:, None]
    root = np.array([0.0, RADIUS, 0.0])
    return Groom.from_strands([root + t * np.array([np.cos(a), -np.sin(a), 0.0]) for a in angles])


def test_points_are_counted_but_for_the_root(ball: HeadDistance) -> None:
    down = np.array([[0, 9.2, 0], [0, 9.0, 0], [0, 8.95, 0], [0, 8.5, 0], [0, 7.0, 0]])
    groom = Groom.from_strands([down, down + np.array([0, 3, 0]), down[:1], np.zeros((0, 3))])
    found = inside(groom.points, groom.offsets, ball)
    assert found.points.tolist() == [2, 0, 0, 0]  # 7 and 20 mm from the root, not 2 mm
    assert found.counted.tolist() == [2, 2, 0, 0]
    assert found.depths[0] == pytest.approx(2.0, abs=0.03)
    assert found.depths[1] < 0.0
    assert entering(groom.points, groom.offsets, ball).tolist() == [True, False, False, False]


def test_what_enters_between_its_points_enters(ball: HeadDistance) -> None:
    across = np.array([[-12.0, 3, 0], [12.0, 3, 0]])
    above = across + np.array([0, 8, 0])
    groom = Groom.from_strands([across, above])
    assert inside(groom.points, groom.offsets, ball).points.sum() == 0
    assert entering(groom.points, groom.offsets, ball).tolist() == [True, False]


def test_the_least_turn_brings_a_straight_guide_out(ball: HeadDistance) -> None:
    angles = np.array([-0.2, 0.06, 0.12, 0.2, 0.3])
    groom = sunk(angles)
    turned = turned_out(groom.points, groom.offsets, ball)
    assert not turned.stuck.any()
    assert turned.angles[0] == 0.0
    # A chord of the sphere that begins at the root is over within 3 to 4.5 mm where it is this little below the plane.
    spare = np.arcsin(np.array([0.3, 0.5]) / (2 * RADIUS))
    assert np.all(turned.angles[1:] >= angles[1:] - spare[1] - 0.015)
    assert np.all(turned.angles[1:] <= angles[1:] - spare[0] + 0.015)
    assert not entering(turned.points, groom.offsets, ball, 1e-6).any()
    np.testing.assert_array_equal(turned.points[groom.offsets[:-1]], groom.points[groom.offsets[:-1]])
    np.testing.assert_array_equal(turned.points[:9], groom.points[:9])
    for s in range(groom.strand_count):
        rows = slice(groom.offsets[s], groom.offsets[s + 1])
        old, new = groom.points[rows], turned.points[rows]
        np.testing.assert_allclose(np.linalg.norm(new - new[0], axis=1), np.linalg.norm(old - old[0], axis=1))
        turn = np.arccos(np.clip((old[-1] - old[0]) @ (new[-1] - new[0]) / 36.0, -1.0, 1.0))
        assert turn == pytest.approx(turned.angles[s], abs=1e-6)


def test_what_no_small_turn_brings_out_stays(ball: HeadDistance) -> None:
    groom = sunk(np.array([0.6, 1.5]))
    turned = turned_out(groom.points, groom.offsets, ball)
    assert turned.stuck.all()
    np.testing.assert_array_equal(turned.points, groom.points)


def test_a_guide_is_turned_alike_in_any_company_and_by_any_threads(ball: HeadDistance) -> None:
    groom = sunk(np.linspace(-0.1, 0.34, 40))
    whole = turned_out(groom.points, groom.offsets, ball)
    part = groom.select(np.arange(7, 40, 3))
    alone = turned_out(part.points, part.offsets, ball)
    np.testing.assert_array_equal(alone.angles, whole.angles[7:40:3])
    try:
        set_threads(1)
        single = turned_out(groom.points, groom.offsets, ball)
    finally:
        set_threads(64)
    np.testing.assert_array_equal(single.points, whole.points)


def coils(lengths: np.ndarray, radius: float, wavelength: float) -> tuple[np.ndarray, np.ndarray]:
    """Helices about -z, each longer than its axis is to be, of two hands and many phases."""
    made = []
    for k, length in enumerate(lengths):
        z = np.linspace(0.0, length, int(24 * length / wavelength))
        phase = 2 * np.pi * z / wavelength + k
        made.append(np.stack([radius * np.cos(phase), (-1) ** k * radius * np.sin(phase), -z], axis=1))
    return np.concatenate(made), offsets_of([len(m) for m in made])


def over_the_crown(count: int = 12, above: float = 0.05) -> Groom:
    """Guides that lie close to the sphere, from its top to its side and down."""
    bent = np.linspace(0.0, 0.5 * np.pi, 20)
    arc = (RADIUS + above) * np.stack([np.sin(bent), np.cos(bent), 0 * bent], axis=1)
    arc = np.concatenate([arc, arc[-1] + np.linspace(1, 8, 6)[:, None] * [0.0, -1.0, 0.0]])
    turns = [np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]) for a in range(count)]
    return Groom.from_strands([arc @ turn.T for turn in turns])


def placed(ball: HeadDistance, guides: Groom, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    wavelength = 3.0 * radius
    canonical, offsets = coils(arc_lengths(guides.points, guides.offsets), radius, wavelength)
    count = guides.strand_count
    seats = guides.points, guides.offsets, np.zeros((count, 3)), np.linspace(-3, 3, count)
    turn = 2 * np.pi * np.hypot(radius, wavelength / (2 * np.pi))
    room = Room(ball, CLEARANCE, wavelength, float(turn))
    free = place(canonical, offsets, *seats)
    return free, place_outside(canonical, offsets, *seats, room).points, offsets, canonical


@pytest.mark.parametrize("radius", [0.15, 0.3, 0.6])
def test_coils_are_lifted_off_the_head(ball: HeadDistance, radius: float) -> None:
    guides = over_the_crown()
    free, kept, offsets, _ = placed(ball, guides, radius)
    before, after = inside(free, offsets, ball), inside(kept, offsets, ball)
    assert before.points.sum() > 0.1 * before.counted.sum()
    assert after.points.sum() == 0
    np.testing.assert_array_equal(kept[offsets[:-1]], guides.points[guides.offsets[:-1]])
    # Still the coils that they were: as long, as curved, and no further from the head than they are wide.
    np.testing.assert_allclose(arc_lengths(kept, offsets), arc_lengths(free, offsets), rtol=0.02)
    segments = [np.linalg.norm(np.diff(points, axis=0), axis=1) for points in (free, kept)]
    inner = np.ones(len(segments[0]), dtype=bool)
    inner[offsets[1:-1] - 1] = False
    ratio = (segments[1] / segments[0])[inner]
    assert np.quantile(np.abs(ratio - 1.0), 0.95) < 0.12
    assert np.median(np.abs(ratio - 1.0)) < 0.03
    height = np.linalg.norm(kept, axis=1) - RADIUS
    over = np.concatenate([np.arange(offsets[s], offsets[s] + (offsets[s + 1] - offsets[s]) // 2) for s in range(12)])
    assert height[over].max() < 3.5 * radius + 0.2


def test_what_does_not_enter_is_not_moved(ball: HeadDistance) -> None:
    guides = over_the_crown(above=2.0)
    free, kept, _, _ = placed(ball, guides, 0.3)
    np.testing.assert_array_equal(kept, free)


def test_guides_through_the_head_do_no_harm(ball: HeadDistance) -> None:
    line = np.linspace([0.0, 9.0, 0.0], [0.3, -12.0, 0.2], 30)
    deep = np.linspace([0.0, 2.0, 0.0], [0.1, -1.0, 0.2], 8)
    free, kept, offsets, _ = placed(ball, Groom.from_strands([line, deep]), 0.3)
    assert np.isfinite(kept).all()
    np.testing.assert_array_equal(kept[offsets[:-1]], [line[0], deep[0]])
    assert np.linalg.norm(kept - free, axis=1).max() < 12.0


# ---- heads that fit, and others


def test_a_head_of_another_unit_is_told() -> None:
    head = sphere(3)
    groom = scalp_hair(head)
    assert fitted_to(head, groom) is head
    for factor, unit in ((0.01, "m"), (10.0, "mm"), (1 / 2.54, "in")):
        small = replace(head, vertices=head.vertices * factor)
        with pytest.raises(ReadError, match=rf"too (small|large) for the groom.*--head-unit {unit}\b"):
            fitted_to(small, groom)
    with pytest.raises(ReadError, match="does not grow on this head"):
        fitted_to(replace(head, vertices=head.vertices + np.array([40.0, 0, 0])), groom)
    lifted = fitted_to(replace(head, vertices=head.vertices * (7.5 / RADIUS)), groom)
    assert "off its surface, by up to 1.5 cm" in lifted.notes[-1]


def test_a_head_with_another_axis_up_is_turned() -> None:
    head = sphere(3)
    high = replace(head, vertices=head.vertices * [1.0, 1.2, 1.0] + [0, 160.0, 5.0])
    groom = scalp_hair(high)
    lying = replace(groom, points=groom.points[:, [0, 2, 1]] * [1, -1, 1], up="z")
    turned = fitted_to(high, lying)
    assert "turned from y up to z up" in turned.notes[-1]
    assert turned.vertices[:, 2].min() > 140.0
    back = fitted_to(turned, groom)
    np.testing.assert_allclose(back.vertices, high.vertices, atol=1e-12)


# ---- real ones


@pytest.mark.parametrize("name", ["makehuman_base", "ict_head"])
def test_hair_on_other_heads(grooms: Callable[[str], Path], name: str) -> None:
    head = read_head(grooms(f"heads/{name}.obj"))
    groom = scalp_hair(head)
    assert fitted_to(head, groom) is head
    field = head_distance(head, groom.points, finest=0.2)
    assert not entering(groom.points, groom.offsets, field).any()
    # Pressed through the scalp by 12 degrees, and turned out of it again.
    roots, normals = scalp(head)
    across = np.cross(normals, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across, axis=1)[:, None]
    pressed = hair_on(roots, 0.98 * across - 0.2 * normals)
    assert entering(pressed.points, pressed.offsets, field).sum() > 20
    turned = turned_out(pressed.points, pressed.offsets, field, CLEARANCE)
    assert turned.stuck.sum() <= 4
    free = ~turned.stuck
    assert not entering(turned.points, pressed.offsets, field)[free].any()


def test_guides_of_real_grooms_leave_the_head(grooms: Callable[[str], Path]) -> None:
    head = read_head(grooms("heads/vitruvian_head.obj"))
    bob = read(grooms("bob.abc"), unit="m")
    field = head_distance(head, bob.points, finest=0.2)
    before = inside(bob.points, bob.offsets, field)
    assert 0.02 < before.points.sum() / before.counted.sum() < 0.06
    turned = turned_out(bob.points, bob.offsets, field, CLEARANCE)
    assert turned.stuck.sum() <= 2
    assert inside(turned.points, bob.offsets, field).points[~turned.stuck].sum() == 0
    assert np.count_nonzero(turned.angles) < 120
