"""More or fewer style guides: the scalp, blue noise, guides between guides, partings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial import Delaunay, cKDTree
from scipy.spatial.transform import Rotation

from detangled.errors import DetangledError
from detangled.formats import read
from detangled.formats.meshes import read_head
from detangled.geometry.winding import mean_without_outliers
from detangled.groom import Attribute, Groom, Scope
from detangled.grooming.blue_noise import spread_out
from detangled.grooming.density import density_change
from detangled.grooming.density_resampling import Resampled, resampled
from detangled.grooming.guides import style_guides
from detangled.grooming.head_fit import fitted_to
from detangled.grooming.interpolation import diverging, interpolated
from detangled.grooming.scalp import HEXAGONAL, scalp_of
from detangled.grooming.scalp_mesh import places_on
from detangled.head import Head

Points = NDArray[np.float64]


def on_plane(count: int, size: float = 10.0, seed: int = 0) -> Points:
    return np.random.default_rng(seed).random((count, 3)) * [size, size, 0.0]


def on_sphere(count: int, radius: float = 9.0, seed: int = 0) -> Points:
    """Roots over the upper half of a head."""
    points = np.random.default_rng(seed).normal(size=(4 * count, 3))
    points = points[points[:, 1] > 0.0][:count]
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True)


def combed(roots: Points, directions: Points, length: float = 10.0, points: int = 12) -> Groom:
    along = np.linspace(0.0, length, points)
    return Groom.from_strands([r + along[:, None] * d for r, d in zip(roots, directions, strict=True)])


def straight(count: int = 400, seed: int = 0, length: float = 10.0) -> Groom:
    roots = on_plane(count, seed=seed)
    return combed(roots, np.tile([0.0, 0.0, -1.0], (count, 1)), length)


def denser(groom: Groom, factor: float, head: Head | None = None, seed: int = 0) -> Resampled:
    return resampled(groom, style_guides(groom), factor, head, seed)


def roots_of(groom: Groom) -> Points:
    return groom.points[groom.offsets[:-1]]


def spacing(points: Points) -> Points:
    return cKDTree(points).query(points, k=2)[0][:, 1]


# ---- the scalp


def test_triangles_in_a_plane_are_those_of_the_delaunay_triangulation() -> None:
    points = on_plane(300)
    scalp = scalp_of(points)
    reference = {tuple(sorted(t)) for t in Delaunay(points[:, :2]).simplices.tolist()}
    found = {tuple(t) for t in scalp.triangles.tolist()}
    assert found <= reference
    assert len(found) > 0.93 * len(reference)  # without long ones along the rim
    assert scalp.mass.sum() == pytest.approx(300.0)


def test_a_scalp_closes_over_a_sphere_and_leaves_a_bald_patch_open() -> None:
    points = on_sphere(2500)
    full = 2.0 * np.pi * 81.0
    assert scalp_of(points).areas.sum() == pytest.approx(full, rel=0.06)
    bald = points[np.linalg.norm(points - [0.0, 9.0, 0.0], axis=1) > 4.0]
    patch = np.pi * 4.0**2
    assert full - scalp_of(bald).areas.sum() == pytest.approx(patch, abs=0.06 * full)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_two_roots_span_no_scalp(count: int) -> None:
    assert len(scalp_of(on_plane(count)).triangles) == 0


def test_roots_in_a_line_or_at_one_place_span_no_scalp() -> None:
    line = np.linspace(0.0, 5.0, 30)[:, None] * [1.0, 2.0, 3.0]
    assert scalp_of(line).areas.sum() < 1e-6
    assert len(scalp_of(np.ones((40, 3))).triangles) == 0
    assert np.isfinite(scalp_of(line).packing_radius()).all()


def test_a_root_has_half_the_distance_to_its_neighbours_to_itself() -> None:
    rows, columns = np.meshgrid(np.arange(30), np.arange(30), indexing="ij")
    hexagons = np.stack([columns + 0.5 * (rows % 2), rows * np.sqrt(3.0) / 2.0, 0.0 * rows], axis=-1).reshape(-1, 3)
    radius = scalp_of(0.8 * hexagons).packing_radius()
    inner = (hexagons[:, 0] > 3) & (hexagons[:, 0] < 26) & (hexagons[:, 1] > 3) & (hexagons[:, 1] < 22)
    np.testing.assert_allclose(radius[inner], 0.4, rtol=1e-6)


def test_places_on_a_mesh_are_the_nearest_of_all_its_faces() -> None:
    rng = np.random.default_rng(4)
    vertices = rng.normal(size=(60, 3)) * 3.0
    faces = rng.integers(0, 60, size=(80, 3))
    # Some without an area, by chance, and one far larger than all others.
    head = Head(
        np.concatenate([vertices, [[0.0, -900.0, 0], [900.0, 900.0, 0], [-900.0, 900.0, 1.0]]]),
        np.concatenate([faces, [[60, 61, 62]]]),
        rng.random((81, 3, 2)),
    )
    points = rng.normal(size=(200, 3)) * 4.0
    places = places_on(points, head)
    every = [trimesh.triangles.closest_point(head.vertices[head.faces], np.tile(p, (81, 1))) for p in points]
    least = np.linalg.norm(np.stack(every) - points[:, None], axis=2).min(axis=1)
    np.testing.assert_allclose(np.linalg.norm(points - places.positions, axis=1), least, rtol=1e-6)
    again = np.einsum("nk,nkc->nc", places.weights, head.vertices[head.faces[places.faces]])
    np.testing.assert_allclose(again, places.positions, atol=1e-6)
    assert places.uv(head).shape == (200, 2)


# ---- blue noise


def test_points_that_are_kept_lie_further_apart_than_by_chance() -> None:
    points = on_plane(5000)
    radius = np.sqrt(HEXAGONAL * 100.0 / (1000 * np.pi))
    kept = spread_out(points, np.full(5000, radius), 1000)
    assert len(kept) == 1000
    assert spacing(points[kept]).min() > 0.55 * 2.0 * radius
    assert spacing(points[:1000]).min() < 0.1 * 2.0 * radius


def test_fixed_points_keep_others_away() -> None:
    points = on_plane(3000)
    fixed = np.arange(3000) < 40
    radii = np.full(3000, np.sqrt(HEXAGONAL * 100.0 / (440 * np.pi)))
    kept = spread_out(points, radii, 400, fixed)
    assert not fixed[kept].any()
    assert cKDTree(points[:40]).query(points[kept])[0].min() > 0.45 * 2.0 * radii[0]
    assert len(spread_out(points, radii, 0)) == 0
    assert len(spread_out(points, radii, 10**6)) == 3000


# ---- guides between guides


def test_a_guide_between_parallel_guides_is_parallel_and_as_long_as_they_are_in_the_mean() -> None:
    roots = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    groom = Groom.from_strands(
        [r + np.linspace(0, k, 9)[:, None] * [0.6, 0, -0.8] for r, k in zip(roots, (8, 9, 12), strict=True)]
    )
    scalp = scalp_of(roots)
    weights = np.array([[0.5, 0.3, 0.2]])
    made = interpolated(groom, scalp, np.array([[0, 1, 2]]), weights, weights @ roots, np.array([9]))
    length = 0.5 * 8 + 0.3 * 9 + 0.2 * 12
    np.testing.assert_allclose(made, weights @ roots + np.linspace(0, length, 9)[:, None] * [0.6, 0, -0.8], atol=1e-9)


def test_guides_on_a_sphere_are_carried_along_it() -> None:
    """Hair that stands on end stands on end in between, and what is curled over curls over."""
    roots = on_sphere(600)
    out = roots / 9.0
    side = np.cross([0.0, 1.0, 0.0], out)
    bend = np.linspace(0.0, 0.8, 15)[None, :, None]
    strands = roots[:, None] + 5.0 * (np.sin(bend) * out[:, None] + (1.0 - np.cos(bend)) * side[:, None])
    groom = Groom.from_strands(strands)
    result = denser(groom, 3.0)
    new = result.groom.select(result.original < 0)
    points = new.points.reshape(-1, 15, 3)
    up = points[:, 0] / np.linalg.norm(points[:, 0], axis=1, keepdims=True)
    first = points[:, 1] - points[:, 0]
    assert np.degrees(np.arccos((first * up).sum(axis=1) / np.linalg.norm(first, axis=1))).max() < 8.0
    wanted = np.cross([0.0, 1.0, 0.0], up)
    tips = points[:, 0] + 5.0 * (np.sin(0.8) * up + (1.0 - np.cos(0.8)) * wanted)
    assert np.linalg.norm(points[:, -1] - tips, axis=1).max() < 0.5
    np.testing.assert_allclose(np.linalg.norm(points[:, 0], axis=1), 9.0, atol=0.12)


def test_directions_turn_with_the_scalp() -> None:
    """One guide, carried from the middle to three places far around a sphere, is itself again when carried back."""
    angles = 2.0 * np.pi * np.arange(3) / 3.0
    tilt = np.radians(50.0)
    normals = np.stack([np.sin(tilt) * np.cos(angles), np.sin(tilt) * np.sin(angles), np.full(3, np.cos(tilt))], axis=1)
    middle = np.array([0.6, 0.0, 0.8])
    turns = [Rotation.from_rotvec(tilt * np.array([-np.sin(a), np.cos(a), 0.0])) for a in angles]
    groom = combed(9.0 * normals, np.stack([turn.apply(middle) for turn in turns]))
    scalp = replace(scalp_of(9.0 * normals), normals=normals * [[1.0], [-1.0], [1.0]])
    weights = np.full((1, 3), 1 / 3)
    made = interpolated(groom, scalp, np.array([[0, 1, 2]]), weights, np.zeros((1, 3)), np.array([12]))
    np.testing.assert_allclose(made[-1], 10.0 * middle, atol=1e-9)


def test_mixed_guides_do_not_get_shorter_where_neighbours_point_apart() -> None:
    roots = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    groom = combed(roots, np.array([[0.5, 0, -0.87], [-0.5, 0, -0.87], [0, 0.5, -0.87]]))
    weights = np.full((1, 3), 1 / 3)
    made = interpolated(groom, scalp_of(roots), np.array([[0, 1, 2]]), weights, weights @ roots, np.array([12]))
    assert np.linalg.norm(np.diff(made, axis=0), axis=1).sum() == pytest.approx(
        groom.polyline_lengths().mean(), rel=1e-6
    )


def parted(count: int = 500) -> Groom:
    """Hair combed away from x = 0 on either side, at once: to the sides, and down."""
    roots = on_plane(count)
    side = np.sign(roots[:, :1] - 5.0)
    return combed(roots, 0.8 * side * [1.0, 0, 0] + [0.0, 0, -0.6])


def test_no_guide_grows_in_a_parting() -> None:
    groom = parted()
    result = denser(groom, 5.0)
    old, new = roots_of(groom), roots_of(result.groom.select(result.original < 0))
    triangles = Delaunay(old[:, :2])
    corners = old[triangles.simplices][:, :, 0] > 5.0
    across = corners.any(axis=1) & ~corners.all(axis=1)
    assert not across[triangles.find_simplex(new[:, :2])].any()
    assert 0.0 < result.refused < 0.2
    # Elsewhere as many as asked for.
    assert result.factor == pytest.approx(1.0 + 4.0 * (1.0 - result.refused), rel=0.01)


def test_stubble_and_even_hair_do_not_part() -> None:
    even = straight()
    assert not diverging(even, scalp_of(roots_of(even))).any()
    rng = np.random.default_rng(1)
    stubble = combed(on_plane(200), rng.normal(size=(200, 3)), length=0.1)
    assert diverging(stubble, scalp_of(roots_of(stubble))).mean() < 0.1


# ---- the whole


@pytest.mark.parametrize("factor", [0.25, 0.8, 1.0, 1.7, 6.0])
def test_density_changes_by_the_factor_and_roots_are_blue_noise(factor: float) -> None:
    groom = straight()
    result = denser(groom, factor)
    assert result.groom.strand_count == pytest.approx(400 * factor, abs=1)
    assert len(result.original) == result.groom.strand_count == len(result.guides.kept)
    kept = result.original[result.original >= 0]
    assert (np.diff(kept) > 0).all()
    np.testing.assert_array_equal(result.groom.select(result.original >= 0).points, groom.select(kept).points)
    if factor > 1.0:
        new = roots_of(result.groom.select(result.original < 0))
        lattice = np.sqrt(2.0 / np.sqrt(3.0) * 100.0 / (400 * factor))
        assert np.median(spacing(new)) > 0.6 * lattice
        np.testing.assert_allclose(result.guides.lengths, 10.0, rtol=1e-6)
    else:
        assert spacing(roots_of(result.groom)).min() >= spacing(roots_of(groom)).min()


def test_dense_places_stay_denser() -> None:
    dense, sparse = on_plane(900, 5.0), on_plane(225, 5.0, seed=1) + np.array([5.0, 0.0, 0.0])
    roots = np.concatenate([dense, sparse])
    groom = combed(roots, np.tile([0.0, 0.0, -1.0], (len(roots), 1)))
    for factor in (0.3, 3.0):
        x = roots_of(denser(groom, factor).groom)[:, 0]
        assert np.count_nonzero(x < 4.5) / np.count_nonzero(x > 5.5) == pytest.approx(4.0, rel=0.12)


def test_the_same_seed_gives_the_same_guides_and_another_others() -> None:
    groom = straight(150)
    one, again, other = denser(groom, 3.0), denser(groom, 3.0), denser(groom, 3.0, seed=1)
    assert one.groom.points.tobytes() == again.groom.points.tobytes()
    assert one.groom.points.tobytes() != other.groom.points.tobytes()


def test_attributes_of_new_guides_are_mixed_or_the_nearest_and_ids_are_fresh() -> None:
    groom = straight(200)
    roots = roots_of(groom)
    groom = replace(
        groom,
        attributes={
            "groom_id": Attribute(np.arange(100, 300, dtype=np.int32), Scope.STRAND),
            "group": Attribute((roots[:, 0] > 5.0).astype(np.int32), Scope.STRAND),
            "name": Attribute(np.where(roots[:, 0] > 5.0, "right", "left"), Scope.STRAND),
            "uv": Attribute((roots[:, :2] / 10.0).astype(np.float32), Scope.STRAND),
            "width": Attribute(np.tile(np.linspace(0.02, 0.0, 12), 200), Scope.POINT),
            "unit": Attribute(np.array([3]), Scope.GROOM),
            "velocities": Attribute(np.zeros((2400, 3)), Scope.POINT),
        },
    )
    result = denser(groom, 3.0)
    new = result.groom.select(result.original < 0)
    x = roots_of(new)
    values = {name: a.values for name, a in new.attributes.items()}
    ids = result.groom.attributes["groom_id"].values
    assert len(np.unique(ids)) == len(ids)
    assert ids.dtype == np.int32
    narrow = replace(groom, attributes={"groom_id": Attribute(np.arange(-73, 127, dtype=np.int8), Scope.STRAND)})
    ids = denser(narrow, 3.0).groom.attributes["groom_id"].values
    assert ids[:200].tolist() == list(range(-73, 127))
    assert ids[200:].min() == 127
    np.testing.assert_allclose(values["uv"], x[:, :2] / 10.0, atol=1e-6)
    assert set(np.unique(values["group"])) <= {0, 1}
    assert (values["name"][x[:, 0] > 6.5] == "right").all()
    np.testing.assert_allclose(values["width"], np.tile(np.linspace(0.02, 0.0, 12), new.strand_count), atol=1e-12)
    assert values["unit"].tolist() == [3]
    assert "velocities" not in values
    assert "velocities" in result.lost[0]


def test_texture_coordinates_across_a_seam_are_not_mixed() -> None:
    groom = straight(200)
    u = (roots_of(groom)[:, 0] / 5.0) % 1.0
    groom = replace(groom, attributes={"root_uv": Attribute(np.stack([u, u], axis=1), Scope.STRAND)})
    new = denser(groom, 4.0)
    new_groom = new.groom.select(new.original < 0)
    # The nearest neighbour's on either side: within some spacings, where a mixed one could be anywhere.
    away = np.abs(new_groom.attributes["root_uv"].values[:, 0] - (roots_of(new_groom)[:, 0] / 5.0) % 1.0)
    assert np.median(np.minimum(away, 1.0 - away)) < 1e-6
    assert np.quantile(np.minimum(away, 1.0 - away), 0.99) < 0.3


def test_strands_that_cannot_be_used_stay() -> None:
    good = straight(60)
    groom = Groom.from_strands([[[1.0, 1, 0]], *[good.strand(i) for i in range(60)], np.full((3, 3), np.nan)])
    for factor in (0.5, 2.0):
        result = denser(groom, factor)
        assert {0, 61} <= set(result.original.tolist())
        assert len(result.guides.kept) == pytest.approx(60 * factor, abs=1)
        np.testing.assert_array_equal(result.groom.select(result.guides.kept).points, result.guides.groom.points)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_strands_to_span_a_scalp_stay_and_it_is_said(count: int) -> None:
    result = denser(straight(count), 3.0)
    assert result.groom.strand_count == count
    if count:
        assert "no guide was added" in result.notes[0]
        assert denser(straight(count), 0.1).groom.strand_count == 1


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf, 1e9])
def test_a_factor_that_is_none_is_refused(factor: float) -> None:
    with pytest.raises(DetangledError):
        denser(straight(20), factor)


# ---- heads


def plane_head(height: float = 0.0, scale: float = 1.0) -> Head:
    """A square under ``straight``, on two tiles of texture coordinates."""
    corners = np.array([[-1.0, -1, 0], [5, -1, 0], [5, 11, 0], [-1, 11, 0], [11, -1, 0], [11, 11, 0]]) * scale
    faces = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])
    uv = np.where(np.array([True, True, False, False])[:, None, None], 0.0, [1.0, 0.0]) + np.abs(
        corners[faces][:, :, :2] - [[5.0, 0.0]]
    ) / (20.0 * scale)
    return Head(corners + np.array([0.0, 0.0, height]), faces, uv)


def test_new_roots_lie_on_the_head_and_take_its_texture_coordinates_over_its_tiles() -> None:
    head = plane_head(0.1)
    groom = straight(200)
    uv = places_on(roots_of(groom), head).uv(head)
    assert uv is not None
    groom = replace(groom, attributes={"groom_root_uv": Attribute(uv.astype(np.float32), Scope.STRAND)})
    result = denser(groom, 4.0, head)
    new = result.groom.select(result.original < 0)
    np.testing.assert_allclose(roots_of(new)[:, 2], 0.1, atol=1e-9)
    expected = places_on(roots_of(new), head).uv(head)
    np.testing.assert_allclose(new.attributes["groom_root_uv"].values, expected, atol=1e-6)


def test_a_head_elsewhere_or_without_faces_is_refused() -> None:
    groom = straight(50)
    with pytest.raises(DetangledError, match="roots are 50 cm from the head"):
        denser(groom, 2.0, plane_head(50.0))
    with pytest.raises(DetangledError, match="no faces"):
        denser(groom, 2.0, Head(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int64)))
    near = plane_head(1.2)
    assert denser(groom, 2.0, near).notes == ()
    assert "50 of 50 roots that were looked at lie off its surface, by up to 1.2 cm" in fitted_to(near, groom).notes[-1]


def test_a_head_in_metres_is_called_so() -> None:
    roots = on_sphere(100)
    groom = combed(roots, roots / 9.0)
    vertices = np.concatenate([on_sphere(300, 0.09, seed=2)])
    faces = np.arange(300).reshape(-1, 3)
    with pytest.raises(DetangledError, match="times too small"):
        denser(groom, 2.0, Head(vertices, faces))


# ---- how much


def coils(radius: float, count: int = 60) -> Groom:
    angle = np.linspace(0.0, 2.0 * np.pi * 12.0, 260)
    coil = np.stack([radius * np.cos(angle), radius * np.sin(angle), -0.12 * angle], axis=1)
    return Groom.from_strands([root + coil for root in on_plane(count)])


@pytest.mark.parametrize("radius", [0.3, 0.8])
def test_density_follows_the_square_of_the_radii(radius: float) -> None:
    change = density_change(style_guides(coils(radius)), 0.4)
    assert change.input_radius == pytest.approx(radius, rel=0.02)
    assert change.factor == pytest.approx((radius / 0.4) ** 2, rel=0.05)
    assert change.straight == 0.0


def test_straight_hair_is_as_wide_as_its_place() -> None:
    change = density_change(style_guides(straight(400)), 0.1)
    assert change.straight == 1.0
    assert change.input_radius == pytest.approx(np.sqrt(HEXAGONAL * 100.0 / 400 / np.pi), rel=0.1)
    assert change.factor == pytest.approx((change.input_radius / 0.1) ** 2)


def test_absurd_changes_are_bounded_and_straight_targets_need_none() -> None:
    guides = style_guides(straight(30))
    assert density_change(guides, 0.0).factor == 1.0
    tight = density_change(guides, 0.02)
    assert tight.factor == 32.0
    assert "give a factor" in tight.notes[0]
    alone = density_change(style_guides(straight(1)), 0.2)
    assert alone.factor == 1.0
    assert alone.notes


def test_values_beyond_three_deviations_are_left_out_of_a_mean() -> None:
    values = np.concatenate([np.full(50, 1.0), np.full(50, 2.0), [90.0]])
    assert mean_without_outliers(values) == pytest.approx(1.5)
    assert mean_without_outliers(values[:0]) == 0.0


# ---- real grooms


def test_eve_gets_as_many_guides_as_the_radii_ask_for(grooms: Callable[[str], Path]) -> None:
    groom = read(grooms("eve.abc"), unit="m")
    guides = style_guides(groom)
    change = density_change(guides, 0.2245)
    result = resampled(groom, guides, change.factor)
    assert 3.5 < change.factor < 5.0
    assert result.factor == pytest.approx(change.factor, rel=0.1)
    lengths = result.groom.polyline_lengths()
    assert lengths[result.original < 0].max() <= 1.01 * groom.polyline_lengths().max()


@pytest.mark.parametrize("on_head", [False, True])
def test_the_parting_of_bob_is_kept(grooms: Callable[[str], Path], on_head: bool) -> None:
    groom = read(grooms("bob.abc"), unit="m")
    result = denser(groom, 6.0, read_head(grooms("heads/vitruvian_head.obj")) if on_head else None)
    old, new = roots_of(groom), roots_of(result.groom.select(result.original < 0))
    # Seen from above: triangles of roots on top of the head that point to both sides are the parting.
    first = np.stack([groom.strand(i)[3] - groom.strand(i)[0] for i in range(groom.strand_count)])
    top = old[:, 1] > 169.0
    away = np.sign(first[top, 0]) * (np.abs(first[top, 0]) > 0.5 * np.linalg.norm(first[top], axis=1))
    triangles = Delaunay(old[top][:, [0, 2]])
    here = triangles.find_simplex(new[:, [0, 2]])
    here, new = here[(here >= 0) & (new[:, 1] > 169.0)], new[(here >= 0) & (new[:, 1] > 169.0)]
    place = triangles.transform[here]
    weights = np.einsum("nij,nj->ni", place[:, :2], new[:, [0, 2]] - place[:, 2])
    weights = np.concatenate([weights, 1.0 - weights.sum(axis=1, keepdims=True)], axis=1)
    sides = away[triangles.simplices[here]]
    left, right = (np.where(sign * sides > 0, weights, 0.0).sum(axis=1) for sign in (-1.0, 1.0))
    assert len(new) > 50
    # A root on the very line between two of one side is not within.
    assert not ((left > 0.1) & (right > 0.1)).any()


@pytest.mark.parametrize("name", ["combover.abc", "coily_swatch.obj"])
def test_other_real_grooms_get_denser_and_sparser(grooms: Callable[[str], Path], name: str) -> None:
    groom = read(grooms(name), unit="cm" if name.endswith("obj") else "m")
    if groom.strand_count > 5000:
        groom = groom.select(np.arange(0, groom.strand_count, 10))
    for factor in (0.3, 2.0):
        result = denser(groom, factor)
        assert result.factor == pytest.approx(1.0 + (factor - 1.0) * (1.0 - result.refused), rel=0.02)
        assert np.isfinite(result.groom.points).all()
