"""Heads in pictures: what hides what, and where hair's shadow falls."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from detangled import formats
from detangled.errors import ReadError
from detangled.groom import Groom
from detangled.head import Head
from detangled.view.camera import frame, view_rotation
from detangled.view.curves import drawable
from detangled.view.lighting import KEY, light_at, light_grid
from detangled.view.picture import Style, render
from detangled.view.rasteriser import background, draw
from detangled.view.shading import Look
from detangled.view.surface import drawable_surface

RED_HAIR = Look(hair=(0.5, 0.0, 0.0), variation=0.0)


def sheet(corners: list[list[float]], parts: int = 8) -> Head:
    """A flat quadrilateral of four corners, counter-clockwise from outside, cut into triangles."""
    a, b, c, d = np.asarray(corners, dtype=float)
    s = np.linspace(0.0, 1.0, parts + 1)
    u, v = (side[..., None] for side in np.meshgrid(s, s))
    vertices = ((1 - u) * (1 - v) * a + u * (1 - v) * b + u * v * c + (1 - u) * v * d).reshape(-1, 3)
    first = (np.arange(parts)[:, None] * (parts + 1) + np.arange(parts)).reshape(-1)
    right, up = first + 1, first + parts + 1
    faces = np.concatenate([np.stack([first, right, up + 1], 1), np.stack([first, up + 1, up], 1)])
    return Head(vertices, faces)


def wall(size: float = 5.0, z: float = 0.0) -> Head:
    return sheet([[-size, -size, z], [size, -size, z], [size, size, z], [-size, size, z]])


def ball(radius: float = 9.0, middle: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Head:
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    return Head(np.asarray(mesh.vertices) + middle, np.asarray(mesh.faces))


def hairy(strands: int = 300, radius: float = 9.0, length: float = 6.0) -> Groom:
    """Straight hair on the upper half of a ball."""
    out = np.random.default_rng(3).normal(size=(strands, 3))
    out[:, 1] = np.abs(out[:, 1])
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    return Groom.from_strands(out[:, None] * np.linspace(radius, radius + length, 9)[:, None])


@pytest.mark.parametrize("perspective", [True, False])
def test_a_strand_through_a_slanted_sheet_is_seen_where_it_is_in_front(perspective: bool) -> None:
    strand = Groom.from_strands([np.stack([np.linspace(-4, 4, 9), np.zeros(9), np.zeros(9)], axis=1)])
    slanted = sheet([[-5, -5, -5], [5, -5, 5], [5, 5, 5], [-5, 5, -5]], parts=1)  # z = x: nearer on the right
    curves = drawable(strand, np.eye(3))
    surface = drawable_surface(slanted, np.eye(3), np.zeros(3))
    camera = frame([surface.vertices], (200, 200), perspective=perspective)
    width = 0.2
    grid = light_grid(curves, width, 10.0, (np.full(3, -5.0), np.full(3, 5.0)), surface)
    row = draw(curves, camera, grid, width, RED_HAIR, surface=surface).astype(int)
    x, y = camera.project(np.array([[0.0, 0.0, 0.0]]))[0]
    red = row[round(y), :, 0] > 2 * row[round(y), :, 1]
    ends = camera.project(np.array([[-4.0, 0.0, 0.0]]))[0]
    # A round strand of radius 0.1 leaves the sheet over as much of its length, beyond its middle.
    assert np.flatnonzero(red).min() == pytest.approx(ends[0], abs=2.5)
    assert np.flatnonzero(red).max() == pytest.approx(x, abs=1.5 + 0.15 * camera.scale)


def test_a_sheet_covers_its_share_of_each_pixel() -> None:
    curves = drawable(Groom.from_strands([[[0.0, 0.0, -3.0], [0.0, 0.1, -3.0]]]), np.eye(3))
    look = Look(skin=(0.0, 0.0, 0.0))
    camera = frame([np.array([[-6.0, -6.0, 0.0], [6.0, 6.0, 0.0]])], (120, 120), perspective=False)
    surface = drawable_surface(wall(5.0), np.eye(3), np.zeros(3))
    grid = light_grid(curves, 0.05, 12.0)
    # The sheen alone would not be black.
    pixels = draw(curves, camera, grid, 0.05, look, surface=surface)[:, :, 1] / 255.0
    behind = background(camera, look)[:, :, 1]
    linear = np.where(pixels > 0.04045, ((pixels + 0.055) / 1.055) ** 2.4, pixels / 12.92)
    covered = linear < 0.5 * behind
    low, high = camera.project(np.array([[-5.0, 5.0, 0.0], [5.0, -5.0, 0.0]]))
    assert np.flatnonzero(covered.any(axis=0)).min() == pytest.approx(low[0], abs=1.0)
    assert np.flatnonzero(covered.any(axis=0)).max() + 1 == pytest.approx(high[0], abs=1.0)
    assert covered.sum() == pytest.approx((high[0] - low[0]) * (high[1] - low[1]), rel=0.02)


def test_hair_casts_shadow_on_the_head_away_from_the_key_light() -> None:
    """A dense tuft before a wall: the wall is dark where the line from it to the key meets the tuft."""
    rng = np.random.default_rng(0)
    places = rng.uniform(-1.0, 1.0, (3000, 2))
    tuft = [[[x, y - 1.0, 2.0], [x, y + 1.0, 2.0]] for x, y in places]
    tuft += [[[x, y, 1.5], [x, y, 2.5]] for x, y in places]
    curves = drawable(Groom.from_strands(tuft), np.eye(3))
    surface = drawable_surface(wall(8.0), np.eye(3), np.zeros(3))
    grid = light_grid(curves, 0.05, 16.0, (np.array([-8.0, -8.0, 0.0]), np.array([8.0, 8.0, 2.5])), surface)

    def depth_at(x: float, y: float) -> float:
        reach = np.empty(3)
        light_at(grid.values, *((np.array([x, y, 0.3]) - grid.origin) / grid.cell), reach)
        return float(reach[0])

    fall = -(2.0 - 0.3) / KEY[2] * KEY[:2]  # from the tuft's middle down the key's ray
    assert depth_at(*fall) > 2.0
    assert depth_at(*(-fall)) < 0.1
    assert depth_at(fall[0], fall[1] - 4.0) < 0.1


def test_a_head_shades_what_is_behind_it_and_not_itself_where_it_is_lit() -> None:
    groom, head = hairy(), ball()
    curves = drawable(groom, np.eye(3))
    surface = drawable_surface(head, np.eye(3), np.zeros(3))
    grid = light_grid(curves, 0.001, 30.0, (np.full(3, -15.0), np.full(3, 15.0)), surface)
    reach = np.empty(3)

    def depth_at(place: np.ndarray) -> float:
        light_at(grid.values, *((place - grid.origin) / grid.cell), reach)
        return float(reach[0])

    assert depth_at(-10.5 * KEY) > 3.0
    for direction in np.random.default_rng(1).normal(size=(40, 3)):
        direction = direction / np.linalg.norm(direction)
        if direction @ KEY > 0.5:
            assert depth_at((9.0 + grid.cell) * direction) < 0.2


def test_the_head_is_framed_and_hides_the_hair_behind_it() -> None:
    groom, head = hairy(), ball()
    with_head, without = (render([groom], (96, 96), head=h, style=Style(look=RED_HAIR)) for h in (head, None))
    bottom = with_head.camera.project(np.array([[0.0, -9.0, 0.0]]))[0, 1]
    assert bottom <= 96 * 0.95
    below = with_head.camera.project(np.array([[0.0, -4.0, 9.0]]))[0].round().astype(int)
    pixel = with_head.pixels[below[1], below[0]].astype(int)
    assert abs(pixel[0] - pixel[1]) < 40, "skin, not hair"
    assert without.camera.centre[1] > with_head.camera.centre[1] + 2.0


def test_the_nearer_face_is_seen_whichever_comes_first() -> None:
    groom, head = hairy(30), ball()
    front_first = np.argsort(-head.vertices[head.faces].mean(axis=1)[:, 2])
    one, other = (
        render([groom], (64, 64), head=Head(head.vertices, head.faces[order])).pixels.astype(int)
        for order in (front_first, front_first[::-1])
    )
    assert np.abs(one - other).max() <= 2


@pytest.mark.parametrize(
    ("scale", "move", "words"),
    [
        (0.01, 0.0, "100 times too small"),
        (10.0, 0.0, "10 times too large"),
        (1.0, 90.0, "the groom does not grow on this head"),
    ],
)
def test_a_head_that_cannot_be_the_hairs_is_refused(scale: float, move: float, words: str) -> None:
    head = ball(9.0 * scale, (0.0, 0.0, move))
    with pytest.raises(ReadError, match=f"head.obj: .*{words}"):
        render([hairy()], (64, 64), head=head, head_name="head.obj")


def test_one_strand_on_a_whole_body_is_no_misfit() -> None:
    body = ball(90.0, (0.0, -90.0, 0.0))
    picture = render([Groom.from_strands([[[0.0, 0.0, 0.0], [0.0, 5.0, 0.0]]])], (64, 64), head=body)
    assert picture.camera.scale > 64 / 60, "as much of the body as lies near the hair"


def test_a_head_with_a_hole_in_its_numbers_is_drawn_without_those_faces() -> None:
    head = wall()
    vertices = head.vertices.copy()
    vertices[0] = np.nan
    surface = drawable_surface(Head(vertices, head.faces), np.eye(3), np.zeros(3))
    assert len(surface.faces) == len(head.faces) - 2
    assert np.isfinite(surface.vertices).all()
    np.testing.assert_allclose(surface.normals[surface.faces.max()], [0.0, 0.0, 1.0], atol=1e-6)


@pytest.mark.parametrize("name", ["eve.abc", "bob.abc"])
def test_the_front_of_a_real_groom_shows_the_face(grooms: Callable[[str], Path], name: str) -> None:
    import trimesh

    mesh = trimesh.load(grooms("heads/vitruvian_head.obj"), force="mesh", process=False)
    head = Head(100.0 * np.asarray(mesh.vertices), np.asarray(mesh.faces))
    groom = formats.read(grooms(name), unit="m")
    turned = head.vertices @ view_rotation("front", groom.up).T
    nose = turned[:, 2].argmax()
    seen = {}
    for view in ("front", "back"):
        picture = render([groom], (96, 96), view, head=head, style=Style(look=Look(hair=(0.0, 0.0, 0.0))))
        x, y = picture.camera.project(head.vertices[[nose]] @ view_rotation(view, groom.up).T)[0].astype(int)
        seen[view] = picture.pixels[y - 2 : y + 3, x - 2 : x + 3].mean()
    assert seen["front"] > 90
    assert seen["back"] < 0.8 * seen["front"]
