"""The signed distance from a head: against spheres and boxes, open and broken meshes, and exact distances."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from detangled.errors import DetangledError
from detangled.formats.meshes import read_head
from detangled.geometry.triangles import distance2_to_triangle
from detangled.grooming.head_distance import HeadDistance, exact_distances, head_distance
from detangled.grooming.head_inside import winding_numbers, winding_tree
from detangled.head import Head
from detangled.kernels import set_threads
from heads import RADIUS, head_of, sphere

STEP = 0.3
FACET = 0.025  # [cm] by which a sphere's facets are inside of it


@pytest.fixture(scope="module")
def ball() -> HeadDistance:
    return head_distance(sphere(), finest=STEP)


def around(count: int = 20_000, reach: float = 1.1 * RADIUS) -> np.ndarray:
    return np.random.default_rng(1).uniform(-reach, reach, (count, 3))


def test_a_sphere(ball: HeadDistance) -> None:
    points = around()
    distance, gradient = ball.with_gradient(points)
    radius = np.linalg.norm(points, axis=1)
    # Trilinear between nodes: off by an eighth of the step's square over the radius, and at the very middle by a step;
    # away from the surface, by what is between the nearest triangle and that of the nearest node beside the surface.
    outer = radius > 2.0
    near = np.abs(radius - RADIUS) < STEP
    np.testing.assert_allclose(distance[near], radius[near] - RADIUS, atol=FACET + STEP**2 / 8.0)
    np.testing.assert_allclose(distance[outer], radius[outer] - RADIUS, atol=0.06)
    np.testing.assert_allclose(distance, radius - RADIUS, atol=STEP)
    np.testing.assert_array_equal(distance, ball.at(points))
    outward = np.einsum("pc,pc->p", gradient, points) / radius
    assert np.all(outward[near] > 0.95)
    assert np.quantile(outward[outer], 0.001) > 0.9


def test_beyond_the_grid_it_is_outside(ball: HeadDistance) -> None:
    points = np.array([[30.0, 0, 0], [0, -25.0, 0], [-20.0, 20.0, 20.0]])
    distance, gradient = ball.with_gradient(points)
    np.testing.assert_allclose(distance, np.linalg.norm(points, axis=1) - RADIUS, rtol=0.25)
    assert np.all(distance > 0.0)
    assert np.all(np.einsum("pc,pc->p", gradient, points) > 0.0)


def test_the_gradient_is_that_of_the_distances(ball: HeadDistance) -> None:
    points = around(200, 7.0)
    _, gradient = ball.with_gradient(points)
    tiny = 1e-6
    for axis in range(3):
        step = tiny * np.eye(3)[axis]
        slope = (ball.at(points + step) - ball.at(points - step)) / (2 * tiny)
        np.testing.assert_allclose(gradient[:, axis], slope, atol=1e-4)


def test_a_box() -> None:
    half = np.array([6.0, 8.0, 5.0])
    field = head_distance(head_of(trimesh.creation.box(2 * half)), finest=STEP)
    points = around(20_000, 8.5)
    over = np.abs(points) - half
    expected = np.linalg.norm(np.maximum(over, 0.0), axis=1) + np.minimum(over.max(axis=1), 0.0)
    # Its edges, inside and out, are rounded over about half a step; further out they are seen a little too late.
    near = np.abs(expected) < STEP
    np.testing.assert_allclose(field.at(points)[near], expected[near], atol=0.5 * STEP)
    np.testing.assert_allclose(field.at(points), expected, atol=0.5 * STEP, rtol=0.1)
    assert np.abs(field.at(points) - expected).mean() < 0.015


def test_an_open_hemisphere_is_closed_by_its_rim() -> None:
    whole = sphere()
    upper = whole.faces[whole.vertices[whole.faces][:, :, 1].min(axis=1) >= 0.0]
    field = head_distance(Head(whole.vertices, upper), finest=STEP)
    points = around()
    height, radius = points[:, 1], np.linalg.norm(points, axis=1)
    distance = field.at(points)
    # Near the opening the winding number decides, which is a half on the plane of the rim.
    away = np.abs(height) > 1.0
    near = np.abs(radius - RADIUS) < 2 * STEP
    within = (radius < RADIUS) & (height > 0.0)
    assert np.all((distance < 0)[away & ~near] == within[away & ~near])
    dome = away & (height > 1.0)
    np.testing.assert_allclose(distance[dome & (radius > 4.0)], (radius - RADIUS)[dome & (radius > 4.0)], atol=0.06)


def test_a_mesh_that_is_no_manifold() -> None:
    whole = sphere()
    # Every fifth face twice, a wall through the middle, and faces of no area.
    wall = len(whole.vertices) + np.array([[0, 1, 2]])
    vertices = np.concatenate([whole.vertices, [[0, -8, 0], [0, 8, 0], [0, 0, 8]]])
    faces = np.concatenate([whole.faces, wall, wall[:, ::-1], [[0, 0, 1], [2, 2, 2]]])
    field = head_distance(Head(vertices, faces), finest=STEP)
    points = around()
    radius = np.linalg.norm(points, axis=1)
    outside = radius > RADIUS + FACET + STEP**2
    np.testing.assert_allclose(field.at(points)[outside], (radius - RADIUS)[outside], atol=0.06)
    deep = (radius < RADIUS - 2 * STEP) & (np.abs(points[:, 0]) > 2 * STEP)
    assert np.all(field.at(points)[deep] < 0.0)


def test_winding_numbers_are_those_of_all_triangles() -> None:
    head = sphere()
    tree = winding_tree(head)
    points = around(300)
    corners = head.vertices[head.faces]
    a, b, c = (corners[None, :, k] - points[:, None] for k in range(3))
    sizes = [np.linalg.norm(v, axis=2) for v in (a, b, c)]
    below = np.prod(sizes, axis=0) + sum(
        np.einsum("pfc,pfc->pf", u, v) * size for u, v, size in ((a, b, sizes[2]), (b, c, sizes[0]), (c, a, sizes[1]))
    )
    angle = 2.0 * np.arctan2(np.einsum("pfc,pfc->pf", a, np.cross(b, c)), below)
    np.testing.assert_allclose(winding_numbers(tree, points), angle.sum(axis=1) / (4 * np.pi), atol=0.02)


def test_few_triangles_and_none() -> None:
    one = Head(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    field = head_distance(one)
    assert field.at(np.array([[0.2, 0.2, 0.7]]))[0] == pytest.approx(0.7, abs=0.02)
    with pytest.raises(DetangledError, match="no faces"):
        head_distance(Head(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int64)))
    empty = ~np.isfinite(field.values)
    assert not empty.any()


def test_only_what_is_asked_for_is_covered(ball: HeadDistance) -> None:
    points = np.array([[1.0, 7.0, 1.0], [4.0, 10.0, 4.0]])
    part = head_distance(sphere(), points, finest=STEP)
    assert part.values.size < 0.1 * ball.values.size
    assert part.step == ball.step
    near = np.random.default_rng(2).uniform([1, 7, 1], [4, 10, 4], (1000, 3))
    np.testing.assert_allclose(part.at(near), np.linalg.norm(near, axis=1) - RADIUS, atol=FACET + STEP**2 / 8.0)
    # Hair beside the head altogether.
    beside = head_distance(sphere(), np.array([[50.0, 50, 50], [51, 51, 51]]), finest=STEP)
    assert np.all(beside.at(np.array([[50.5, 50.5, 50.5]])) > 10.0)


def test_the_threads_decide_nothing() -> None:
    several = head_distance(sphere(3), finest=0.5)
    try:
        set_threads(1)
        one = head_distance(sphere(3), finest=0.5)
    finally:
        set_threads(64)
    np.testing.assert_array_equal(one.values, several.values)


def test_a_real_head(grooms: Callable[[str], Path]) -> None:
    head = read_head(grooms("heads/vitruvian_head.obj"))
    crown = head.vertices[:, 1].max() - 6.0
    middle = head.vertices[head.faces].mean(axis=1)
    skin = middle[middle[:, 1] > crown][::3]
    field = head_distance(head, skin)
    points = skin + np.random.default_rng(3).normal(scale=0.3, size=skin.shape)
    error = np.abs(field.at(points) - exact_distances(winding_tree(head), points))
    assert error.mean() < 2e-3
    assert error.max() < 0.03


def test_a_triangle_without_area_is_as_far_as_its_longest_side() -> None:
    rng = np.random.default_rng(6)
    for _ in range(2000):
        a, b, point = rng.normal(size=(3, 3))
        corners = rng.permutation([a, b, a + rng.random() * (b - a)])
        along = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        exact = np.linalg.norm(a + along * (b - a) - point)
        assert np.sqrt(distance2_to_triangle(*point, corners.ravel())) == pytest.approx(exact, abs=1e-9)
