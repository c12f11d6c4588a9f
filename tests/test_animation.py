"""A texture carried through a groom's frames: it stays what it was, where it was on its strand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from detangled import formats
from detangled.animation import carried_frames, carrier
from detangled.errors import ReadError
from detangled.formats.frames import Frames, read_frames, write_frames
from detangled.geometry.arc import arc_lengths
from detangled.groom import Groom, offsets_of
from detangled.grooming.following import followed_guides, root_rotations, windows
from detangled.grooming.guides import style_guides
from detangled.grooming.placing import place
from detangled_cli.main import detangled

Points = NDArray[np.float64]
COILY = Path(__file__).resolve().parents[1] / "examples" / "coily_strands.obj"
LENGTH = 20.0
FRAMES = 24
MOVE = np.array([3.0, -2.0, 7.0])


def lines(count: int = 9, points: int = 15) -> Groom:
    """Straight hair hanging down -y, its roots on a bowl."""
    rng = np.random.default_rng(3)
    roots = rng.uniform(-6.0, 6.0, (count, 3)) * [1.0, 0.3, 1.0]
    return Groom.from_strands([root - np.linspace(0.0, LENGTH, points)[:, None] * [0, 1, 0] for root in roots])


def coils_on(groom: Groom, radius: float = 0.4, wavelength: float = 0.9, seed: int = 5) -> Groom:
    """Coils about each strand of a groom, 16 points a turn, some turning back: they start on its roots."""
    rng = np.random.default_rng(seed)
    lengths = arc_lengths(groom.points, groom.offsets)
    strands = []
    for length in lengths:
        z = np.linspace(0.0, length, int(16 * length / wavelength))
        hand = np.where(np.abs(z - rng.uniform(0.3, 0.7) * length) < 0.1 * length, -1.0, 1.0)
        phase = rng.uniform(0.0, 6.0) + np.cumsum(hand) * 2.0 * np.pi * (z[1] - z[0]) / wavelength
        across = radius * np.clip(z / (2.0 * radius), 0.0, 1.0)
        strands.append(np.stack([across * np.cos(phase), across * np.sin(phase), -z], axis=1))
    offsets = offsets_of([len(s) for s in strands])
    none = np.zeros((len(strands), 3))
    points = place(np.concatenate(strands), offsets, groom.points, groom.offsets, none, none[:, 0])
    return Groom(points, offsets)


def bent(groom: Groom, angle: float, axis: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Points:
    """Strands that bend evenly from root to tip, by an angle [rad] in all, and keep their lengths."""
    out = groom.points.copy()
    for a, b in zip(groom.offsets[:-1], groom.offsets[1:], strict=True):
        steps = np.diff(groom.points[a:b], axis=0)
        sizes = np.linalg.norm(steps, axis=1)
        share = (np.cumsum(sizes) - 0.5 * sizes) / sizes.sum()
        turned = Rotation.from_rotvec(angle * share[:, None] * np.asarray(axis)).apply(steps)
        out[a + 1 : b] = out[a] + np.cumsum(turned, axis=0)
    return out


def curvature_and_torsion(points: Points) -> tuple[Points, Points]:
    """Of a polyline of even steps, at its points, by the angles between neighbouring steps and their planes."""
    steps = np.diff(points, axis=0)
    sizes = np.linalg.norm(steps, axis=1)
    tangents = steps / sizes[:, None]
    across = np.cross(tangents[:-1], tangents[1:])
    sine = np.linalg.norm(across, axis=1)
    kappa = np.arctan2(sine, (tangents[:-1] * tangents[1:]).sum(axis=1)) / (0.5 * (sizes[1:] + sizes[:-1]))
    normals = across / sine[:, None]
    turn = (np.cross(normals[:-1], normals[1:]) * tangents[1:-1]).sum(axis=1)
    return kappa, np.arctan2(turn, (normals[:-1] * normals[1:]).sum(axis=1)) / sizes[1:-1]


def test_the_first_frame_is_the_styled_groom() -> None:
    groom = lines()
    styled = coils_on(groom)
    np.testing.assert_allclose(carrier(groom, styled).points(groom.points), styled.points, atol=1e-9)


@pytest.mark.parametrize("angle", [0.1, 1.5, 3.1])
def test_a_head_that_turns_and_moves_takes_its_curls_along(angle: float) -> None:
    groom = lines()
    styled = coils_on(groom)
    # About the hair's own direction too, which the strands alone could not tell.
    for axis in ([0.0, 1.0, 0.0], [0.48, 0.6, 0.64]):
        turn = Rotation.from_rotvec(angle * np.array(axis))
        now = turn.apply(groom.points.copy()) + MOVE
        expected = turn.apply(styled.points.copy()) + MOVE
        np.testing.assert_allclose(carrier(groom, styled).points(now), expected, atol=1e-6)


def test_curls_keep_their_place_on_a_strand_that_bends() -> None:
    groom = lines()
    styled = coils_on(groom)
    carry = carrier(groom, styled)
    first = np.repeat(styled.points[styled.offsets[:-1]], styled.point_counts, axis=0)
    for angle in (0.05, 0.5, 1.2):
        out = carry.points(bent(groom, angle))
        # What lies across the plane of the bend stays there, to the share by which the size is corrected.
        assert np.abs((out - first)[:, 2] - (styled.points - first)[:, 2]).max() < 2e-3
        # And the distance from the guide, which is an arc now.
        for s in range(groom.strand_count):
            local = out[styled.offsets[s] : styled.offsets[s + 1]] - groom.strand(s)[0]
            around = local - [LENGTH / angle, 0.0, 0.0]
            away = np.hypot(np.hypot(around[:, 0], around[:, 1]) - LENGTH / angle, local[:, 2])
            rest = styled.strand(s) - groom.strand(s)[0]
            np.testing.assert_allclose(away, np.hypot(rest[:, 0], rest[:, 2]), atol=0.01)


def test_texture_and_lengths_stay_from_frame_to_frame(grooms: Callable[[str], Path]) -> None:
    groom = formats.read(grooms("eve.abc"), unit="m").select(np.arange(0, 1077, 40))
    styled = coils_on(groom, radius=0.5, wavelength=0.6)
    positions = [bent(groom, 0.8 * frame / (FRAMES - 1)) for frame in range(FRAMES)]
    frames = carried_frames(Frames(groom, np.arange(FRAMES) / 24.0, positions.__getitem__), styled)
    assert len(frames) == FRAMES
    lengths, arcs = styled.polyline_lengths(), arc_lengths(styled.points, styled.offsets)
    strands = list(zip(styled.offsets[:-1], styled.offsets[1:], strict=True))
    before = [curvature_and_torsion(styled.points[a:b]) for a, b in strands]
    for index, points in enumerate(frames):
        np.testing.assert_allclose(Groom(points, styled.offsets).polyline_lengths(), lengths, rtol=1e-9)
        now_arcs = arc_lengths(points, styled.offsets)
        np.testing.assert_allclose(now_arcs, arcs, rtol=1e-6)
        roots = points[styled.offsets[:-1]]
        np.testing.assert_allclose(roots, positions[index][groom.offsets[:-1]], atol=1e-9)
        now = [curvature_and_torsion(points[a:b]) for a, b in strands]
        for (kappa, tau), (old_kappa, old_tau) in zip(now, before, strict=True):
            assert kappa.mean() == pytest.approx(old_kappa.mean(), rel=2e-3)
            assert np.abs(tau).mean() == pytest.approx(np.abs(old_tau).mean(), rel=5e-3)
            # Not in the mean alone: 99 of 100 points of every strand.
            assert np.quantile(np.abs(kappa - old_kappa), 0.99) < 0.02 * np.median(old_kappa)
            assert np.quantile(np.abs(tau - old_tau), 0.99) < 0.02 * np.median(np.abs(old_tau))
        arcs, before = now_arcs, now


def test_guides_of_curly_hair_follow_its_middle() -> None:
    straight = lines(points=40)
    curly = coils_on(straight, radius=0.5, wavelength=1.2)
    guides = style_guides(curly)
    reaches = windows(curly.points, guides.points, curly.offsets)
    # The curls are carried by this very module; what is asked is whether their middle is found again.
    now_axis = bent(straight, 0.6)
    now = carrier(straight, curly).points(now_axis)
    first = curly.offsets[:-1]
    rotations = root_rotations(curly.points[first], now[first])
    found = followed_guides(curly.points, guides.points, curly.offsets, reaches, rotations, now)
    for s in range(curly.strand_count):
        a, b = curly.offsets[s : s + 2]
        axis = now_axis[straight.offsets[s] : straight.offsets[s + 1]]
        rest_off = np.linalg.norm((guides.points[a:b] - straight.strand(s)[0])[:, [0, 2]], axis=1)
        fine = np.stack([np.interp(np.linspace(0, 39, 4000), np.arange(40), axis[:, c]) for c in range(3)], axis=1)
        off = np.linalg.norm(found[a:b, None] - fine[None, ::4], axis=2).min(axis=1)
        # As near as it was found in the first frame, but for the tip, where there is less of a curl to go by.
        assert off[:-3].max() < rest_off.max() + 0.05
        assert off.max() < 0.25
        bends = np.linalg.norm(np.diff(found[a:b], n=2, axis=0), axis=1)
        assert bends.max() < np.linalg.norm(np.diff(guides.points[a:b], n=2, axis=0), axis=1).max() + 0.02


def test_roots_tell_a_rotation_where_they_can() -> None:
    rng = np.random.default_rng(8)
    rest = rng.normal(size=(30, 3))
    turn = Rotation.from_rotvec([0.3, -2.0, 0.4])
    np.testing.assert_allclose(root_rotations(rest, turn.apply(rest) + 4.0), np.tile(turn.as_matrix(), (30, 1, 1)))
    flat = rest * [1.0, 0.0, 1.0]
    np.testing.assert_allclose(root_rotations(flat, turn.apply(flat)), np.tile(turn.as_matrix(), (30, 1, 1)))
    for few in (rest[:1], rest[:2], np.arange(5.0)[:, None] * [1.0, 2.0, 3.0]):
        np.testing.assert_array_equal(root_rotations(few, turn.apply(few)), np.tile(np.eye(3), (len(few), 1, 1)))


def test_hair_is_not_stretched_with_a_strand_that_is() -> None:
    groom = lines()
    styled = coils_on(groom)
    roots = np.repeat(groom.points[groom.offsets[:-1]], groom.point_counts, axis=0)
    for factor in (0.8, 1.3):
        out = carrier(groom, styled).points(roots + factor * (groom.points - roots))
        np.testing.assert_allclose(out, styled.points, atol=2e-3)


def test_one_strand_alone() -> None:
    groom = lines(1)
    styled = coils_on(groom)
    out = carrier(groom, styled).points(bent(groom, 0.7))
    np.testing.assert_allclose(Groom(out, styled.offsets).polyline_lengths(), styled.polyline_lengths())


def test_strands_that_were_passed_through_move_as_they_did() -> None:
    groom = lines(4)
    odd = np.array([[1.0, 2, 3], [np.nan, 0, 0], [4, 5, 6]])
    rest = Groom.from_strands([groom.strand(0), odd, groom.strand(1), odd[:1], groom.strand(2)])
    coils = coils_on(groom)
    styled = Groom.from_strands([coils.strand(0), odd, coils.strand(1), odd[:1], coils.strand(2)])
    now = rest.points + MOVE
    out = carrier(rest, styled).points(now)
    np.testing.assert_allclose(out, styled.points + MOVE, atol=1e-9)


def test_a_strand_that_cannot_be_followed_stays_where_it_is_beside_new_ones() -> None:
    groom = lines(3)
    point = np.array([[7.0, 0.0, 0.0]])
    rest = Groom.from_strands([groom.strand(0), point, groom.strand(1)])
    styled = Groom.from_strands([*(coils_on(groom).strand(k) for k in (0, 1)), point, coils_on(groom).strand(2)])
    out = Groom(carrier(rest, styled).points(rest.points + MOVE), styled.offsets)
    np.testing.assert_allclose(out.strand(2), point)
    np.testing.assert_allclose(out.strand(0), styled.strand(0) + MOVE, atol=1e-9)


def test_new_strands_go_with_the_nearest_old_ones() -> None:
    groom = lines(6)
    dense = Groom.from_strands([groom.strand(k // 3) + 0.05 * (k % 3) for k in range(18)])
    styled = coils_on(dense)
    turn = Rotation.from_rotvec([0.2, 0.5, 0.1])
    carry = carrier(groom, styled)
    assert carry.drivers.tolist() == [k // 3 for k in range(18)]
    np.testing.assert_allclose(
        carry.points(turn.apply(groom.points.copy())), turn.apply(styled.points.copy()), atol=1e-6
    )


def test_frames_that_cannot_be_followed_are_named() -> None:
    groom = lines(3)
    styled = coils_on(groom)
    spoilt = groom.points.copy()
    spoilt[groom.offsets[1] + 2] = np.nan
    shrunk = groom.points.copy()
    shrunk[groom.offsets[2] :] = 1.0
    positions = [groom.points, spoilt, shrunk]
    frames = carried_frames(Frames(groom, np.array([0.0, 0.5, 1.0]), positions.__getitem__), styled)
    frames.points(0)
    with pytest.raises(ReadError, match=r"frame 1 \(0.5 s\): strand 1 cannot be followed"):
        frames.points(1)
    with pytest.raises(ReadError, match=r"frame 2 \(1 s\): strand 2"):
        frames.points(2)
    with pytest.raises(ReadError, match="none of the 3 strands"):
        carrier(replace(groom, points=np.zeros_like(groom.points)), styled)


def test_the_command_keeps_frames(tmp_path: Path) -> None:
    groom = lines(3)
    positions = [bent(groom, 0.2 * frame) for frame in range(3)]
    times = np.array([0.5, 0.6, 0.7])
    write_frames(replace(groom, unit_cm=100.0), times, positions, tmp_path / "in.abc")

    def retexture(out: str) -> str:
        arguments = [tmp_path / "in.abc", tmp_path / out, "--target", COILY, "--length", "strand", "--max-points", 200]
        done = CliRunner().invoke(detangled, ["retexture", *map(str, arguments), "--unit", "m", "--steps", "8"])
        assert done.exit_code == 0, done.stderr
        return done.stderr

    retexture("out.abc")
    frames = read_frames(tmp_path / "out.abc", unit="m")
    np.testing.assert_allclose(frames.times, times)
    lengths = frames.groom.polyline_lengths()
    for points, position in zip(frames, positions, strict=True):
        np.testing.assert_allclose(points[frames.groom.offsets[:-1]], position[groom.offsets[:-1]], atol=1e-5)
        np.testing.assert_allclose(replace(frames.groom, points=points).polyline_lengths(), lengths, rtol=1e-4)
    assert np.abs(frames.points(2) - frames.points(0)).max() > 0.3
    assert "3 frames, only the first is kept" in retexture("out.obj")
