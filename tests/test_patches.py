"""Making signals of examples: the patch denoiser, whitening, stretches, steering, and what synthesis promises."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from detangled.diffusion.patches import PatchSchedule, denoise_strands, plan_stretches
from detangled.diffusion.steering import DRAWN, DRAWN_YET, Steering, steer_strands
from detangled.diffusion.whitening import Whitening
from detangled.fitted import FittedTexture
from detangled.fitting import fit
from detangled.formats import read
from detangled.geometry.signal import curve_counts, curves, signals
from detangled.synthesis import synthesise

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def naive_denoise(
    noisy: NDArray[np.float64],
    alpha: float,
    sigma: float,
    examples: list[NDArray[np.float64]],
    bounds: NDArray[np.int64],
    chosen: NDArray[np.int64],
    diagonals: NDArray[np.int64],
    half_width: int,
    window: int,
) -> NDArray[np.float64]:
    """The prediction for one strand (3, L), one patch after another: the definition, written out."""
    x = noisy / alpha
    cells = x.shape[1]
    out = np.empty_like(x)
    for begin, end, names, places in zip(bounds[:-1], bounds[1:], chosen, diagonals, strict=True):
        for i in range(begin, end):
            scores, centres = [], []
            for name, place in zip(names, places, strict=True):
                y = examples[name]
                for j in range(i + place - window, i + place + window + 1):
                    if not 0 <= j < y.shape[1]:
                        continue
                    # A patch cut short by an end of the strand or of the example counts by its mean.
                    before = min(half_width, i, j)
                    after = min(half_width, cells - 1 - i, y.shape[1] - 1 - j)
                    patch = x[:, i - before : i + after + 1] - y[:, j - before : j + after + 1]
                    distance2 = (2 * half_width + 1) * (patch**2).sum() / patch.shape[1]
                    scores.append(-distance2 * alpha**2 / (2 * sigma**2))
                    centres.append(y[:, j])
            weights = np.exp(np.array(scores) - max(scores))
            out[:, i] = weights @ np.array(centres) / weights.sum()
    return out


@pytest.mark.parametrize("half_width", [2, 9, 30])
@pytest.mark.parametrize(("alpha", "sigma"), [(0.05, 0.998), (0.7, 0.7), (0.995, 0.1)])
def test_the_denoiser_is_the_naive_loop_over_patches(half_width: int, alpha: float, sigma: float) -> None:
    rng = np.random.default_rng(half_width)
    # Some shorter, some longer than the strand; patches are cut by either's ends.
    lengths = np.array([48, 64, 40, 90, 64])
    examples = [np.cumsum(rng.standard_normal((3, n)), axis=1) / 4 for n in lengths]
    starts = np.concatenate([[0], np.cumsum(lengths)])
    bounds = np.array([0, 30, 64])
    plans = [plan_stretches(rng, lengths, 64, bounds, 4) for _ in range(2)]
    chosen, diagonals = (np.stack([plan[k] for plan in plans]) for k in (0, 1))
    clean = np.stack([examples[1], examples[4]])
    noisy = alpha * clean + sigma * rng.standard_normal(clean.shape)
    found = denoise_strands(
        noisy, alpha, sigma, np.concatenate(examples, axis=1), starts, bounds, chosen, diagonals, half_width, 7
    )
    for b in range(2):
        expected = naive_denoise(noisy[b], alpha, sigma, examples, bounds, chosen[b], diagonals[b], half_width, 7)
        np.testing.assert_allclose(found[b], expected, rtol=0, atol=1e-9)


def test_without_noise_an_example_is_its_own_prediction() -> None:
    rng = np.random.default_rng(0)
    examples = [rng.standard_normal((3, 64)) for _ in range(3)]
    places = np.zeros((1, 1, 3), dtype=np.int64)
    found = denoise_strands(
        0.999 * examples[2][None],
        0.999,
        0.045,
        np.concatenate(examples, axis=1),
        np.array([0, 64, 128, 192]),
        np.array([0, 64]),
        np.array([[[0, 1, 2]]]),
        places,
        6,
        10,
    )
    np.testing.assert_allclose(found[0], examples[2], atol=1e-9)


def test_half_widths_run_from_the_widest_to_the_narrowest() -> None:
    schedule = PatchSchedule(widest=100, narrowest=6, high=4.0, low=0.1)
    assert schedule.half_width(0.01, 1.0) == schedule.half_width(0.2, 0.8) == 100
    assert schedule.half_width(1.0, 0.1) == schedule.half_width(1.0, 0.0) == 6
    widths = [schedule.half_width(1.0, sigma) for sigma in np.geomspace(0.1, 4.0, 30)]
    assert widths == sorted(widths)
    # Halfway in the logarithm of the noise is halfway in that of the width.
    assert schedule.half_width(1.0, (0.1 * 4.0) ** 0.5) == round((100 * 6) ** 0.5)


# ---- whitening


def random_signals(rng: np.random.Generator, counts: list[int]) -> list[NDArray[np.float64]]:
    return [
        np.stack(
            [
                np.abs(rng.standard_cauchy(n)),
                rng.standard_cauchy(n),
                n * rng.uniform(0.05, 0.2, n),
            ],
            axis=1,
        )
        for n in counts
    ]


def test_whitening_there_and_back() -> None:
    known = random_signals(np.random.default_rng(1), [64, 100, 80])
    whitening = Whitening.of(known)
    channels = np.concatenate([whitening.whiten(signal) for signal in known], axis=1)
    np.testing.assert_allclose(channels.mean(axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(channels.std(axis=1), 1.0, rtol=1e-12)
    for signal in known:
        np.testing.assert_allclose(whitening.restore(whitening.whiten(signal)), signal, rtol=1e-9, atol=1e-9)
    batch = np.stack([known[0], known[0][::-1]])
    assert whitening.whiten(batch).shape == (2, 3, 64)
    np.testing.assert_allclose(whitening.restore(whitening.whiten(batch)), batch, rtol=1e-9, atol=1e-9)


def test_whitening_means_the_same_on_any_grid() -> None:
    """Cells of the same width, curvature and torsion have the same channels, however many there are."""
    whitening = Whitening.of(random_signals(np.random.default_rng(2), [64, 64]))
    cell = np.array([3.0, -2.0, 0.1])
    few, many = (whitening.whiten(np.tile(cell * [1, 1, n], (n, 1)))[:, 0] for n in (32, 512))
    np.testing.assert_allclose(few, many, rtol=1e-12)


def test_whitening_of_straight_strands_stays_finite() -> None:
    straight = np.tile([0.0, 0.0, 12.0], (64, 1))
    whitening = Whitening.of([straight])
    channels = whitening.whiten(straight)
    np.testing.assert_array_equal(np.isfinite(channels), True)
    np.testing.assert_allclose(whitening.restore(channels), straight, atol=1e-12)
    # A channel that does not vary is not blown up.
    assert whitening.whiten(straight + np.array([0.0, 1e-5, 0.0]))[1].max() < 1.0
    # Noise may ask for negative curvature: there is none.
    assert whitening.restore(np.full((3, 64), -3.0))[:, 0].min() >= 0.0


# ---- stretches


def test_neighbouring_stretches_share_no_example() -> None:
    rng = np.random.default_rng(3)
    bounds = np.linspace(0, 512, 5).astype(np.int64)
    for _ in range(20):
        chosen, _ = plan_stretches(rng, np.full(48, 256), 512, bounds, 12)
        assert sorted(chosen.ravel()) == list(range(48))


@pytest.mark.parametrize("cells", [64, 256, 512, 1024])
@pytest.mark.parametrize("count", [1, 5, 60])
def test_diagonals_keep_stretches_inside_their_examples(cells: int, count: int) -> None:
    rng = np.random.default_rng(4)
    lengths = rng.integers(200, 300, count)
    stretches = max(2, int(np.ceil(2 * cells / np.median(lengths))))
    bounds = np.round(np.linspace(0, cells, stretches + 1)).astype(np.int64)
    for _ in range(20):
        chosen, diagonals = plan_stretches(rng, lengths, cells, bounds, 12)
        assert chosen.shape == diagonals.shape == (stretches, 12)
        assert np.all(bounds[:-1, None] + diagonals >= 0)
        assert np.all(bounds[1:, None] + diagonals <= lengths[chosen])


def test_few_examples_are_offered_at_several_places() -> None:
    chosen, diagonals = plan_stretches(np.random.default_rng(5), np.array([256]), 256, np.array([0, 128, 256]), 4)
    assert not chosen.any()
    assert all(len(set(row)) > 1 for row in diagonals.tolist())


def test_examples_shorter_than_a_stretch_leave_no_holes() -> None:
    """Where all that is offered ends before the stretch does, there must still be numbers."""
    rng = np.random.default_rng(6)
    lengths = np.array([16, 16])
    found = denoise_strands(
        rng.standard_normal((1, 3, 256)),
        0.7,
        0.7,
        rng.standard_normal((3, 32)),
        np.array([0, 16, 32]),
        np.array([0, 128, 256]),
        *(plan[None] for plan in plan_stretches(rng, lengths, 256, np.array([0, 128, 256]), 4)),
        half_width=9,
        window=7,
    )
    np.testing.assert_array_equal(np.isfinite(found), True)


# ---- steering


def helix_about(axis: NDArray[np.float64], radius: float, turns: float) -> NDArray[np.float64]:
    """A helix (n, 3) wound about an axis (n, 3) in the plane of x and z."""
    tangent = np.gradient(axis, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    side = np.array([0.0, 1.0, 0.0])
    other = np.cross(tangent, side)
    angle = np.linspace(0, 2 * np.pi * turns, len(axis))
    return axis + radius * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other)


def axis_wander(signal: NDArray[np.float64], turns: float) -> float:
    """Arc over chord of the mean of the rebuilt strand over each turn, which is its axis."""
    starts = np.array([0, len(signal)])
    offsets = np.concatenate([[0], np.cumsum(curve_counts(signal, starts))])
    curve = curves(signal, starts, offsets)
    width = round(len(curve) / turns)
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(curve, axis=0)])
    axis = (total[width:] - total[:-width]) / width
    # Over whole turns, or what is left of the curl would count as wander.
    axis = axis[::width]
    return float(np.linalg.norm(np.diff(axis, axis=0), axis=1).sum() / np.linalg.norm(axis[-1] - axis[0]))


@pytest.fixture(scope="module")
def wandering() -> dict[str, NDArray[np.float64]]:
    """Signals of a helix of 20 turns about a straight line and about an S-curve, one centimetre a turn."""
    t = np.linspace(0, 1, 481)
    down = -20.0 * t
    nought = np.zeros_like(t)
    axes = {
        "straight": np.stack([nought, nought, down], axis=1),
        "curved": np.stack([4.0 * np.sin(2 * np.pi * t), nought, down], axis=1),
    }
    return {
        name: signals(helix_about(axis, 0.4, 20.0), np.array([0, len(t)]), np.array([0, 320]))
        for name, axis in axes.items()
    }


def turn_of(signal: NDArray[np.float64]) -> float:
    return 2 * np.pi / float(np.median(np.hypot(signal[:, 0], signal[:, 1])))


@pytest.mark.parametrize(("steering", "left"), [(DRAWN_YET, 0.5), (DRAWN, 0.9)])
def test_steering_straightens_a_wandering_axis(
    wandering: dict[str, NDArray[np.float64]], steering: Steering, left: float
) -> None:
    signal = wandering["curved"]
    (steered,) = steer_strands(signal[None], turn_of(signal), steering)
    before, after = axis_wander(signal, 20.0), axis_wander(steered, 20.0)
    assert before > 1.25
    assert after < 1.0 + left * (before - 1.0)
    assert steered[:, 0].min() >= 0.0
    np.testing.assert_array_equal(steered[:, 2], signal[:, 2])
    # It turns the axis, not the curl: the middle of the strand's curvature stays what it was.
    assert np.median(steered[:, 0]) == pytest.approx(np.median(signal[:, 0]), rel=0.05)


@pytest.mark.parametrize("steering", [DRAWN_YET, DRAWN])
def test_steering_leaves_a_straight_axis_nearly_alone(
    wandering: dict[str, NDArray[np.float64]], steering: Steering
) -> None:
    signal = wandering["straight"]
    (steered,) = steer_strands(signal[None], turn_of(signal), steering)
    assert axis_wander(signal, 20.0) < 1.01
    # The first and last cells have the end conditions of the spline, not the helix'.
    inner = slice(16, -16)
    size = np.median(signal, axis=0)
    assert np.abs(steered - signal)[inner].max(axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=0.01 * abs(size[:2]).max())


# ---- synthesis


@pytest.fixture(scope="module")
def texture() -> FittedTexture:
    return fit(read(EXAMPLES / "coily_strands.obj", unit="cm"))


def test_a_strand_does_not_depend_on_the_others(texture: FittedTexture) -> None:
    arcs = np.array([30.0, 12.0, 29.0, 31.0, 70.0])
    names = np.array([4, 9, 2, 0, 7])
    values, starts = synthesise(texture, arcs, names, seed=3, steps=6)
    for k in range(len(arcs)):
        alone, _ = synthesise(texture, arcs[k : k + 1], names[k : k + 1], seed=3, steps=6)
        np.testing.assert_array_equal(values[starts[k] : starts[k + 1]], alone)


def test_arcs_are_exact_and_cells_keep_their_width(texture: FittedTexture) -> None:
    arcs = np.array([2.0, 12.0, 30.0, 33.3, 100.0])
    values, starts = synthesise(texture, arcs, np.arange(5), seed=1, steps=4)
    made = np.array([values[a:b, 2].mean() for a, b in pairwise(starts)])
    np.testing.assert_allclose(made, arcs, rtol=1e-12)
    cells = np.diff(starts)
    np.testing.assert_array_equal(cells, texture.grid_cells(arcs))
    assert np.all(cells % 16 == 0)
    np.testing.assert_allclose((arcs / cells)[1:] / texture.cell_width, 1.0, atol=0.1)


def test_seeds_and_names_tell_strands_apart(texture: FittedTexture) -> None:
    arcs = np.full(2, 30.0)
    one, _ = synthesise(texture, arcs, np.array([0, 1]), seed=0, steps=4)
    again, _ = synthesise(texture, arcs, np.array([0, 1]), seed=0, steps=4)
    other, _ = synthesise(texture, arcs, np.array([0, 1]), seed=1, steps=4)
    np.testing.assert_array_equal(one, again)
    half = len(one) // 2
    assert not np.allclose(one[:half], one[half:])
    assert not np.allclose(one, other)
