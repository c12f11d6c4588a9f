"""Hair that hangs: the heavy elastica, springs, balance of moments, and what is never silent."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

from detangled.errors import TextureError
from detangled.groom import offsets_of
from detangled.kernels import set_threads
from detangled_training.frames import posed
from detangled_training.hanging import GRAVITY, Hung, differ, dry, hang
from detangled_training.material import EVEN_WATER, Fibres, point_masses, water
from detangled_training.resting import assemble, energy_of, turned
from detangled_training.strands import Strands, procedural_strands
from geometry_curves import helix

COUNT = 40
WEIGHT = -GRAVITY[2]
NONE = (0.0, 0.0, 0.0)


def fibre(thickness: float = 70.0, ratio: float = 1.0, porosity: float = 0.0, youngs: float = 1.5, shear: float = 0.2):
    return Fibres(*(np.array([value]) for value in (thickness, ratio, porosity, youngs, shear)))


def one(points: np.ndarray, fibres: Fibres, **options: object) -> Hung:
    return hang(points, [0, len(points)], fibres, **options)  # type: ignore[arg-type]


def bar(length: float, points: int, direction: tuple[float, float, float] = (1.0, 0.0, 0.0)) -> np.ndarray:
    return np.linspace(0.0, length, points)[:, None] * np.array(direction)


def drop(hung: Hung) -> float:
    """How far the tip hangs below the root [cm]."""
    return float(hung.points[0, 2] - hung.points[-1, 2])


def elastica(stiffness: float, weight: float, length: float) -> np.ndarray:
    """Tip (2,), along and down, of a heavy rod [dyn/cm] clamped level: E I theta'' = -w (L - s) cos theta."""
    s = np.linspace(0.0, length, 401)
    found = solve_bvp(
        lambda s, y: [y[1], -weight * (length - s) * np.cos(y[0]) / stiffness, np.cos(y[0]), np.sin(y[0])],
        lambda a, b: np.array([a[0], b[1], a[2], a[3]]),
        s,
        [np.full_like(s, 0.5), np.zeros_like(s), s, np.zeros_like(s)],
        tol=1e-6,
        max_nodes=100_000,
    )
    assert found.success
    return found.y[2:, -1]


@pytest.fixture(scope="module")
def strands() -> Strands:
    return procedural_strands(COUNT, seed=11, kinds=np.arange(COUNT) % 8)


@pytest.fixture(scope="module")
def fibres() -> Fibres:
    rng = np.random.default_rng(4)
    return Fibres(
        rng.uniform(40.0, 110.0, COUNT),
        rng.uniform(0.55, 1.0, COUNT),
        rng.random(COUNT),
        rng.uniform(0.8, 3.9, COUNT),
        np.full(COUNT, 0.2),
    )


@pytest.fixture(scope="module")
def hung(strands: Strands, fibres: Fibres) -> Hung:
    return hang(strands.points, strands.offsets, fibres, record=True)


# Against what is known.


@pytest.mark.parametrize("length", [3.0, 4.0, 5.0])
@pytest.mark.parametrize(("roll", "axis"), [(0.0, 0), (np.pi / 2, 1)])
def test_a_level_rod_sags_as_the_elastica_about_either_axis(length: float, roll: float, axis: int) -> None:
    material = fibre(ratio=0.6)
    weight = material.dry_mass()[0] * EVEN_WATER * WEIGHT
    found = one(bar(length, 401), material, roll=roll)
    expected = elastica(material.bending()[axis][0], weight, length)
    assert found.converged[0]
    assert expected[1] > 0.05 * length
    np.testing.assert_allclose([found.points[-1, 0], drop(found)], expected, atol=0.005 * length)
    np.testing.assert_allclose(found.points[:, 1], 0.0, atol=1e-9)


def test_a_section_bends_more_easily_about_its_major_axis() -> None:
    soft, hard = (one(bar(3.0, 101), fibre(ratio=0.6), roll=roll) for roll in (0.0, np.pi / 2))
    assert drop(soft) > 1.2 * drop(hard)
    a, b = fibre(ratio=0.6).semi_axes()
    assert 2e4 * np.sqrt(a * b) == pytest.approx(70.0)
    weak, strong = fibre(ratio=0.6).bending()
    assert weak / strong == pytest.approx(0.36)
    assert b / a == pytest.approx(0.6)


@pytest.mark.parametrize(("youngs", "shear"), [(1.5, 0.2), (1.5, 2.0), (0.6, 0.9)])
@pytest.mark.parametrize("wavelength", [0.8, 2.5])
def test_a_spring_stretches_by_its_rate(youngs: float, shear: float, wavelength: float) -> None:
    """Open-coiled springs (Wahl): a turn's arc gives R^2 (cos^2 / G J + sin^2 / E I) per length and force."""
    radius, turns, gravity = 0.4, 12, 2.0
    points = helix(radius, wavelength, turns, 48)
    material = fibre(youngs=youngs, shear=shear)
    arc = turns * np.hypot(2 * np.pi * radius, wavelength)
    sine = wavelength / np.hypot(2 * np.pi * radius, wavelength)
    give = radius**2 * ((1 - sine**2) / material.torsion()[0] + sine**2 / material.bending()[0][0])
    weight = material.dry_mass()[0] * EVEN_WATER * gravity
    found = one(points, material, gravity=(0.0, 0.0, -gravity))
    assert drop(found) - (points[0, 2] - points[-1, 2]) == pytest.approx(give * weight * arc**2 / 2, rel=0.03)


def test_a_flat_rod_that_would_buckle_sideways_is_not_at_rest_on_edge() -> None:
    on_edge = one(bar(12.0, 201), fibre(ratio=0.6), roll=np.pi / 2)
    assert not on_edge.converged[0]
    nudged = one(bar(12.0, 201), fibre(ratio=0.6), roll=np.pi / 2 - 0.01)
    assert nudged.converged[0]
    assert np.abs(nudged.points[:, 1]).max() > 0.1
    assert nudged.energy[0] < on_edge.energy[0]


def test_a_strand_without_weight_does_not_move(strands: Strands, fibres: Fibres) -> None:
    found = hang(strands.points, strands.offsets, fibres, gravity=NONE)
    assert found.converged.all()
    np.testing.assert_allclose(found.points, strands.points, atol=1e-9)
    assert found.energy.max() < 1e-12


def test_the_first_joint_bears_the_moment_of_the_weight_beyond(strands: Strands, fibres: Fibres, hung: Hung) -> None:
    masses = point_masses(strands.points, strands.offsets, fibres)
    for s in range(COUNT):
        a, b = strands.offsets[s : s + 2]
        arms = hung.points[a + 2 : b] - hung.points[a + 1]
        moment = np.cross(arms, masses[a + 2 : b, None] * np.array(GRAVITY)).sum(axis=0)
        scale = np.abs(np.linalg.norm(arms, axis=1) @ masses[a + 2 : b]) * WEIGHT
        np.testing.assert_allclose(hung.moment[s], moment, atol=1e-5 * scale)


def test_masses_are_those_of_the_water(strands: Strands, fibres: Fibres) -> None:
    masses = point_masses(strands.points, strands.offsets, fibres)
    per_strand = np.add.reduceat(masses, strands.offsets[:-1])
    lengths = strands.as_groom().polyline_lengths()
    np.testing.assert_allclose(per_strand, fibres.wet_mass(0.5) * lengths, rtol=1e-9)  # linear along the arc
    dry_masses = point_masses(strands.points, strands.offsets, fibres, wet=False)
    np.testing.assert_allclose(np.add.reduceat(dry_masses, strands.offsets[:-1]), fibres.dry_mass() * lengths)
    np.testing.assert_allclose(water([0.0, 0.0, 1.0, 1.0], [0.0, 1.0, 0.0, 1.0]), [1.3, 1.3, 1.2, 1.9])


# The energy and its derivatives.


def test_derivatives_are_those_of_the_energy() -> None:
    rng = np.random.default_rng(0)
    m = 6
    q, half = (Rotation.random(count, random_state=i).as_quat() for i, count in enumerate((m, m - 1)))
    q[1:] = 0.3 * q[1:] + q[0]  # bends that are large, but less than half a turn
    q /= np.linalg.norm(q, axis=1)[:, None]
    half = np.array([1.0, 0.0, 0.0, 0.0]) + 0.2 * half
    half /= np.linalg.norm(half, axis=1)[:, None]
    k, pull = rng.uniform(0.5, 4.0, (m - 1, 3)), rng.normal(size=(m, 3))
    slope, band = np.empty((m - 1, 3)), np.empty((3 * (m - 1), 6))
    assemble(q, half, k, pull, slope, band)

    def energy(step: np.ndarray) -> float:
        out = np.empty_like(q)
        turned(q, step.reshape(-1, 3), 1.0, out)
        return energy_of(out, half, k, pull)

    size = 3 * (m - 1)
    unit, h = np.eye(size), 1e-4
    first = [(energy(h * e) - energy(-h * e)) / (2 * h) for e in unit]
    np.testing.assert_allclose(slope.ravel(), first, atol=1e-6)
    second = np.array(
        [
            [
                sum(a * b * energy(h * (a * unit[i] + b * unit[j])) for a in (1, -1) for b in (1, -1)) / (4 * h * h)
                for j in range(size)
            ]
            for i in range(size)
        ]
    )
    dense = np.zeros((size, size))
    for i in range(size):
        for j in range(max(0, i - 5), i + 1):
            dense[i, j] = dense[j, i] = band[i, 5 + j - i]
    np.testing.assert_allclose(dense, second, atol=1e-5)


def test_with_one_stiffness_the_energy_is_that_of_stable_cosserat_rods() -> None:
    strand = procedural_strands(1, seed=2, kinds=4)
    material = fibre().isotropic()
    found = hang(strand.points, strand.offsets, material)
    lengths = np.linalg.norm(np.diff(strand.points, axis=0), axis=1)
    frames = [
        Rotation.from_quat(f[:-1], scalar_first=True)
        for f in (posed(strand.points, strand.offsets).frames, found.frames)
    ]
    bends = [(f[:-1].inv() * f[1:]).as_quat(canonical=True) for f in frames]
    near = np.sign((bends[0] * bends[1]).sum(axis=1))[:, None]
    k = 8 * material.bending()[0] / (lengths[1:] + lengths[:-1])
    bent = (k * ((bends[1] - near * bends[0]) ** 2).sum(axis=1)).sum() / 2
    masses = point_masses(strand.points, strand.offsets, material)
    lowest = strand.points[0, 2] - np.concatenate([[0.0], np.cumsum(lengths)])
    assert found.energy[0] == pytest.approx(bent + WEIGHT * masses @ (found.points[:, 2] - lowest), rel=1e-9)


def test_energy_falls_until_rest(strands: Strands, fibres: Fibres, hung: Hung) -> None:
    pulled = hang(strands.points, strands.offsets, fibres, stretched=True, record=True)
    for found in (hung, pulled):
        assert found.converged.all()
        assert (found.residual < 1e-5 * strands.length).all()
        assert np.nanmax(np.diff(found.energies, axis=1)) <= 0.0
        assert np.nanmin(found.energies, axis=1) == pytest.approx(found.energy)
        np.testing.assert_array_equal(np.isfinite(found.energies).sum(axis=1), found.iterations + 1)
    assert np.median(hung.iterations) < 20
    # Most strands have one rest, whichever way it is come to.
    assert differ(hung.points, pulled.points, strands.offsets).mean() < 0.2


def test_a_start_straight_down_is_straight_down(strands: Strands, fibres: Fibres) -> None:
    found = hang(strands.points, strands.offsets, fibres, gravity=(0.0, 0.0, -1e7))
    pulled = hang(strands.points, strands.offsets, fibres, gravity=(0.0, 0.0, -1e7), stretched=True)
    ends = strands.offsets[1:] - 1
    for hung in (found, pulled):
        falls = hung.points[strands.offsets[:-1], 2] - hung.points[ends, 2]
        assert (falls > 0.98 * strands.as_groom().polyline_lengths()).all()
    assert np.median(pulled.iterations) < np.median(found.iterations)


# What hair does.


def test_soft_thin_and_wet_hair_hangs_longer() -> None:
    strand = procedural_strands(1, seed=0, kinds=4).points
    usual = drop(one(strand, fibre()))
    assert usual > 1.02 * (strand[0, 2] - strand[-1, 2])
    assert drop(one(strand, fibre(youngs=0.8, shear=0.11))) > 1.01 * usual
    assert drop(one(strand, fibre(thickness=50.0))) > 1.01 * usual
    assert drop(one(strand, fibre(porosity=1.0))) > 1.01 * usual
    assert drop(one(strand, fibre(), wet=False)) < 0.99 * usual
    assert drop(one(strand, fibre(), gravity=(0.0, 0.0, -1.5 * WEIGHT))) > 1.01 * usual


def test_porous_hair_stretches_more_at_the_top_and_keeps_more_stretch_below() -> None:
    points = helix(0.4, 1.2, 8, 32)
    even, porous = one(points, fibre()), one(points, fibre(porosity=1.0))
    # As much weight in all as the porous strand has, but spread evenly.
    ratio = water(1.0, 0.5) / EVEN_WATER
    heavy = one(points, fibre(), gravity=(0.0, 0.0, -WEIGHT * float(ratio)))
    turns = [-np.diff(h.points[::32, 2]) for h in (even, porous, heavy)]
    assert (turns[1][:4] > 1.03 * turns[0][:4]).all()
    assert turns[1][0] == pytest.approx(turns[2][0], rel=0.01)
    assert (turns[1][4:] > 1.01 * turns[2][4:]).all()


def test_dried_hair_keeps_its_shape(strands: Strands, fibres: Fibres, hung: Hung) -> None:
    dried = dry(hung)
    again = hang(dried.points, dried.offsets, fibres.dried(), wet=False, gravity=NONE, frames=dried.frames)
    assert again.converged.all()
    np.testing.assert_allclose(again.points, hung.points, atol=1e-9)
    np.testing.assert_allclose(again.frames, hung.frames, atol=1e-12)
    # Hung again it is near to where it was, nearer than the wet hair was to its rest.
    weighed = hang(dried.points, dried.offsets, fibres.dried(), wet=False, frames=dried.frames)
    moved, before = (
        np.linalg.norm(a - b, axis=1) for a, b in ((weighed.points, hung.points), (hung.points, strands.points))
    )
    assert np.median(moved) < 0.5 * np.median(before)


def test_a_start_at_rest_stays_there(strands: Strands, fibres: Fibres, hung: Hung) -> None:
    again = hang(strands.points, strands.offsets, fibres, start=hung.frames)
    assert again.converged.all()
    assert again.iterations.max() <= 3
    np.testing.assert_allclose(again.points, hung.points, atol=1e-3)


def test_rest_turns_with_the_world(strands: Strands, fibres: Fibres, hung: Hung) -> None:
    turn = Rotation.random(random_state=1)
    frames = posed(strands.points, strands.offsets).frames
    turned = hang(
        turn.apply(strands.points),
        strands.offsets,
        fibres,
        gravity=turn.apply(GRAVITY),
        frames=(turn * Rotation.from_quat(frames, scalar_first=True)).as_quat(scalar_first=True),
    )
    kept = np.linalg.norm(turned.points - turn.apply(hung.points), axis=1) < 1e-3
    assert kept.mean() > 0.97  # a strand near to two rests may be tipped by rounding
    round_fibres = fibres.isotropic()
    rolled = [hang(strands.points, strands.offsets, round_fibres, roll=roll).points for roll in (0.0, 1.0)]
    assert (np.linalg.norm(rolled[1] - rolled[0], axis=1) < 1e-3).mean() > 0.97


def test_frames_follow_the_strand_without_twist(strands: Strands) -> None:
    frames = Rotation.from_quat(posed(strands.points, strands.offsets, 0.3).frames, scalar_first=True)
    for a, b in zip(strands.offsets[:-1], strands.offsets[1:], strict=True):
        steps = np.diff(strands.points[a:b], axis=0)
        directions = steps / np.linalg.norm(steps, axis=1)[:, None]
        np.testing.assert_allclose(frames[a : b - 1].apply([1.0, 0.0, 0.0]), directions, atol=1e-12)
        turns = (frames[a + 1 : b - 1] * frames[a : b - 2].inv()).as_rotvec()
        np.testing.assert_allclose(np.einsum("ij,ij->i", turns, directions[1:]), 0.0, atol=1e-9)
    rolled = posed(bar(1.0, 3), [0, 3], np.pi / 2).frames
    np.testing.assert_allclose(Rotation.from_quat(rolled[0], scalar_first=True).apply([0, 1, 0]), [0, 0, 1], atol=1e-12)


# What must not be silent, and what must not depend on luck.


def test_the_same_bytes_for_one_thread_and_two(strands: Strands, fibres: Fibres, hung: Hung) -> None:
    set_threads(1)
    try:
        alone = hang(strands.points, strands.offsets, fibres, record=True)
    finally:
        set_threads(64)
    for field in fields(alone):
        assert getattr(alone, field.name).tobytes() == getattr(hung, field.name).tobytes(), field.name


def test_strands_of_few_points_hang() -> None:
    counts = [0, 1, 2, 3, 4]
    points = np.concatenate([bar(0.5 * n, n) for n in counts])
    found = hang(points, offsets_of(counts), Fibres.usual(5))
    assert found.converged.all()
    np.testing.assert_array_equal(found.points[:5], points[:5])  # the third point of three is the first that may move
    assert found.points[5, 2] < -1e-3
    assert hang(np.zeros((0, 3)), [0], Fibres.usual(0)).points.shape == (0, 3)


def test_strands_that_cannot_be_hung_are_told_and_leave_the_others_alone() -> None:
    good = bar(3.0, 40)
    lost, doubled = good.copy(), good.copy()
    lost[7, 1] = np.nan
    doubled[8] = doubled[7]
    points = np.concatenate([good, lost, doubled, good])
    offsets = offsets_of([40] * 4)
    found = hang(points, offsets, Fibres.usual(4))
    np.testing.assert_array_equal(found.converged, [True, False, False, True])
    assert np.isnan(found.points[40:120]).all()
    np.testing.assert_array_equal(found.points[:40], found.points[120:])
    np.testing.assert_array_equal(found.points[:40], one(good, Fibres.usual(1)).points)


def test_shapes_differ_by_their_furthest_points() -> None:
    points = np.zeros((6, 3))
    other = points.copy()
    other[4, 1] = 0.11
    np.testing.assert_array_equal(differ(points, other, [0, 3, 6]), [False, True])
    np.testing.assert_array_equal(differ(points, other, [0, 3, 6], tolerance=0.2), [False, False])
    other[0] = np.nan
    np.testing.assert_array_equal(differ(points, other, [0, 3, 3, 6]), [True, False, True])
    np.testing.assert_array_equal(differ(other, other, [0, 3, 6]), [False, False])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("thickness", 19.0),
        ("thickness", np.nan),
        ("axis_ratio", 1.1),
        ("porosity", -0.1),
        ("youngs", 0.0),
        ("youngs", 1.5e3),
        ("shear", np.inf),
        ("shear", -1.0),
    ],
)
def test_fibres_that_are_no_hair_are_refused(name: str, value: float) -> None:
    with pytest.raises(TextureError, match=name.replace("_", " ")):
        replace(Fibres.usual(3), **{name: np.array([getattr(Fibres.usual(1), name)[0], value, value])})


def test_arrays_that_do_not_fit_are_refused() -> None:
    usual = Fibres.usual(2)
    points = bar(1.0, 10)
    with pytest.raises(TextureError, match="one value a strand"):
        replace(usual, thickness=np.full(3, 70.0))
    with pytest.raises(TextureError, match="fibres for"):
        hang(points, [0, 10], usual)
    with pytest.raises(TextureError, match="offsets"):
        hang(points, [0, 5, 9], usual)
    with pytest.raises(TextureError, match="decrease"):
        hang(points, [0, 11, 10], usual)
    with pytest.raises(TextureError, match="points"):
        hang(points[:, :2], [0, 5, 10], usual)
    with pytest.raises(TextureError, match="gravity"):
        hang(points, [0, 5, 10], usual, gravity=(0.0, np.nan, 1.0))
    with pytest.raises(TextureError, match="frames"):
        hang(points, [0, 5, 10], usual, frames=np.zeros((9, 4)))
