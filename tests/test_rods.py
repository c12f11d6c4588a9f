"""Stable Cosserat rods settle where the minimum is, carry the weight, and tell when they have not settled."""

from __future__ import annotations

from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from detangled.errors import TextureError
from detangled.groom import offsets_of
from detangled.kernels import set_threads
from detangled_training.hanging import GRAVITY, hang
from detangled_training.material import Fibres, point_masses
from detangled_training.rods import Settled, _best_frame, simulate
from geometry_curves import helix

COUNT = 8
SAME = 0.01  # of the length


def soft(count: int) -> Fibres:
    return Fibres(*(np.full(count, value) for value in (70.0, 1.0, 0.5, 0.3, 0.15)))


def times(a: tuple, b: tuple) -> np.ndarray:
    """Quaternion product, the scalar first, by SciPy."""
    sizes = [np.linalg.norm(q) for q in (a, b)]
    both = [Rotation.from_quat(np.array(q) / size, scalar_first=True) for q, size in zip((a, b), sizes, strict=True)]
    made = (both[0] * both[1]).as_quat(scalar_first=True) * sizes[0] * sizes[1]
    sign = np.sign(made[0] * (a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]))
    return made * (sign or 1.0)


@pytest.fixture(scope="module")
def strands() -> tuple[np.ndarray, np.ndarray]:
    """Short random curls with kinks, anywhere about the horizontal and below."""
    rng = np.random.default_rng(6)
    made = []
    for _ in range(COUNT):
        curl = helix(rng.uniform(0.2, 0.6), rng.uniform(0.8, 2.0), rng.uniform(1.5, 3.0), 16)
        kink = rng.integers(8, len(curl) - 4)
        turn = Rotation.from_rotvec(rng.normal(size=3) * 0.3)
        curl[kink:] = turn.apply(curl[kink:] - curl[kink]) + curl[kink]
        made.append(Rotation.from_euler("xz", rng.uniform(-1.5, 1.5, 2)).apply(curl))
    return np.concatenate(made), offsets_of([len(m) for m in made])


@pytest.fixture(scope="module")
def settled(strands: tuple[np.ndarray, np.ndarray]) -> Settled:
    return simulate(*strands, soft(COUNT))


def lengths(points: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.array([steps[a : b - 1].sum() for a, b in pairwise(offsets)])


def furthest(one: np.ndarray, other: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    return np.maximum.reduceat(np.linalg.norm(one - other, axis=1), offsets[:-1])


def test_rods_settle_where_the_energy_is_least(strands: tuple[np.ndarray, np.ndarray], settled: Settled) -> None:
    points, offsets = strands
    found = hang(points, offsets, soft(COUNT))
    assert found.converged.all()
    assert settled.settled.all()
    size = lengths(points, offsets)
    assert (furthest(settled.points, found.points, offsets) < SAME * size).all()
    assert (furthest(found.points, points, offsets) > 10 * SAME * size).sum() >= COUNT / 2  # they did move


def test_a_pulled_start_settles_too(strands: tuple[np.ndarray, np.ndarray]) -> None:
    points, offsets = strands
    pulled = simulate(points, offsets, soft(COUNT), stretched=True)
    found = hang(points, offsets, soft(COUNT), stretched=True)
    assert pulled.settled.all()
    apart = furthest(pulled.points, found.points, offsets) / lengths(points, offsets)
    assert (apart < SAME).mean() >= 7 / 8  # of two rests each may come to its own


def test_the_root_carries_the_weight(strands: tuple[np.ndarray, np.ndarray], settled: Settled) -> None:
    points, offsets = strands
    masses = point_masses(points, offsets, soft(COUNT))
    for s in range(COUNT):
        weight = masses[offsets[s] + 1 : offsets[s + 1]].sum() * np.array(GRAVITY)
        np.testing.assert_allclose(settled.force[s], weight, atol=0.02 * -weight[2])


def test_a_strand_without_weight_does_not_move(strands: tuple[np.ndarray, np.ndarray]) -> None:
    points, offsets = strands
    still = simulate(points, offsets, soft(COUNT), seconds=0.5, gravity=(0.0, 0.0, 0.0))
    assert still.settled.all()
    np.testing.assert_allclose(still.points, points, atol=1e-9)
    np.testing.assert_allclose(still.force, 0.0, atol=1e-6)


def test_a_frame_is_put_where_its_energy_is_least() -> None:
    rng = np.random.default_rng(1)
    e1 = (0.0, 1.0, 0.0, 0.0)
    for scale in (0.01, 0.3, 1.0, 3.0, 100.0):
        for _ in range(20):
            v = (0.0, *(scale * rng.normal(size=3)))
            b = tuple(rng.normal(size=4))

            def energy(q: np.ndarray, v: tuple = v, b: tuple = b) -> float:
                return -q @ times(times(v, tuple(q)), e1) / 2 - q @ np.array(b)

            q = np.array(_best_frame(v, b))
            assert np.linalg.norm(q) == pytest.approx(1.0)
            force = times(times(v, tuple(q)), e1) + np.array(b)
            np.testing.assert_allclose(force - (force @ q) * q, 0.0, atol=1e-6 * (1 + scale))
            others = rng.normal(size=(50, 4))
            others = np.concatenate([others, q + 0.1 * others, [b]])
            others /= np.linalg.norm(others, axis=1)[:, None]
            assert energy(q) <= min(energy(other) for other in others) + 1e-9


def test_the_same_bytes_for_one_thread_and_two(strands: tuple[np.ndarray, np.ndarray]) -> None:
    both = simulate(*strands, soft(COUNT), seconds=0.05)
    set_threads(1)
    try:
        alone = simulate(*strands, soft(COUNT), seconds=0.05)
    finally:
        set_threads(64)
    for field in fields(alone):
        assert getattr(alone, field.name).tobytes() == getattr(both, field.name).tobytes(), field.name
    assert not alone.settled.any()  # and too short a time is told


def test_strands_that_are_lost_or_short_are_told() -> None:
    counts = [0, 1, 2, 3, 30, 30]
    points = np.concatenate([np.linspace(0.0, 1.0, n)[:, None] * np.array([1.0, 0.2, 0.0]) for n in counts])
    points[40] = np.nan
    found = simulate(points, offsets_of(counts), soft(6), seconds=5.0)
    np.testing.assert_array_equal(found.settled, [True, True, True, True, True, False])
    assert np.isnan(found.points[36:]).all()
    assert np.isfinite(found.points[:36]).all()


@pytest.mark.parametrize(
    "wrong",
    [{"step": 0.0}, {"sweeps": 0}, {"drag": 1e9}, {"seconds": np.inf}, {"stretch": 0.0}, {"gravity": (0.0, 1.0)}],
)
def test_numbers_that_make_no_simulation_are_refused(wrong: dict) -> None:
    with pytest.raises(TextureError):
        simulate(np.eye(3), [0, 3], soft(1), **wrong)


def test_rods_take_one_stiffness_alone() -> None:
    with pytest.raises(TextureError, match="isotropic"):
        simulate(np.eye(3), [0, 3], Fibres.usual(1))
    assert simulate(np.eye(3), [0, 3], Fibres.usual(1).isotropic(), seconds=0.001).points.shape == (3, 3)


@pytest.mark.slow
def test_a_rod_of_pyelastica_hangs_alike() -> None:
    """A level rod, explicit and with shear, by the library of Gazzola et al. 2018; heavy, so that it soon is still."""
    elastica = pytest.importorskip("elastica")
    length, elements, strength = 0.5, 16, 7400.0
    material = Fibres(*(np.array([value]) for value in (180.0, 1.0, 0.0, 2e-3, 1e-3)))
    radius = material.semi_axes()[0][0]
    density = float(material.wet_mass(0.5)[0] / material.area()[0])

    class Scene(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping):
        pass

    scene = Scene()
    rod = elastica.CosseratRod.straight_rod(
        elements,
        np.zeros(3),
        np.array([1.0, 0.0, 0.0]),
        np.array([0.0, 0.0, 1.0]),
        length,
        radius,
        density,
        youngs_modulus=2e7,
        shear_modulus=1e7,
    )
    step = 2.5e-6
    scene.append(rod)
    scene.constrain(rod).using(elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    scene.add_forcing_to(rod).using(elastica.GravityForces, acc_gravity=np.array([0.0, 0.0, -strength]))
    scene.dampen(rod).using(elastica.AnalyticalLinearDamper, uniform_damping_constant=250.0, time_step=step)
    scene.finalize()
    elastica.integrate(elastica.PositionVerlet(), scene, final_time=0.075, n_steps=30_000, progress_bar=False)
    expected = rod.position_collection.T
    assert np.abs(rod.velocity_collection).max() < 0.1
    points = np.linspace(0.0, length, elements + 1)[:, None] * np.array([1.0, 0.0, 0.0])
    gravity = (0.0, 0.0, -strength)
    assert expected[-1, 2] < -0.2 * length
    direct = hang(points, [0, len(points)], material, gravity=gravity)
    assert np.linalg.norm(direct.points - expected, axis=1).max() < SAME * length
    stepped = simulate(points, [0, len(points)], material, gravity=gravity, step=1e-5)
    assert stepped.settled[0]
    assert np.linalg.norm(stepped.points - expected, axis=1).max() < SAME * length
