"""The network trained on a few strands, without torch."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("onnx", reason="the tiny models are written by onnx")

from commands import FLOAT32, SHIPPED, Floats
from tiny_models import BATCH as STEP_BATCH
from tiny_models import (
    BETA1,
    BETA2,
    CELLS,
    EPSILON,
    FASTER,
    PARAMETERS,
    WEIGHTS,
    WHITENING,
    predicted,
)

from detangled.diffusion import finetune
from detangled.diffusion.denoiser import (
    NetworkDenoiser,
)
from detangled.diffusion.finetune import FineTuning, curl_both_ways, draw_windows, fine_tune
from detangled.errors import TextureError
from detangled.models import (
    DENOISER,
    TRAINING_STEP,
    Model,
    load_model,
    same_network,
)


def smooth(count: int, cells: int = 200, hand: float = 1.0, seed: int = 0) -> list[Floats]:
    """Whitened signals, smooth and alike, whose torsion lies well on one side of 0."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 1, cells)
    straight = -WHITENING.mean[1] / WHITENING.deviation[1]
    strands = []
    for _ in range(count):
        waves = [np.sin(2 * np.pi * (6 * t + rng.uniform())) + 0.3 * rng.standard_normal() for _ in range(3)]
        strands.append(np.stack([0.5 + 0.4 * waves[0], straight + hand * (1.5 + 0.3 * waves[1]), t - 0.2 * waves[2]]))
    return strands


def loss_of(weights: NDArray[Any], strands: list[Floats], step: Model) -> float:
    """The mean loss on many fresh batches."""
    losses = []
    for seed in range(200):
        b = draw_windows(strands, step, np.random.default_rng([99, seed]), None)
        error = predicted(weights, b["noisy"], b["log_snr"], b["position"]) - b["clean"]
        losses.append(np.mean(error**2))
    return float(np.mean(losses))


def best_possible(strands: list[Floats], step: Model) -> Floats:
    """The weights (12,) of the least loss, in closed form: the network is linear in them."""
    best = np.empty((3, 4))
    batches = [draw_windows(strands, step, np.random.default_rng([98, seed]), None) for seed in range(200)]
    for channel in range(3):
        unit = np.zeros((4, 3, 4))
        unit[np.arange(4), channel, np.arange(4)] = 1.0
        columns = [
            np.concatenate([predicted(u, b["noisy"], b["log_snr"], b["position"])[:, channel].ravel() for b in batches])
            for u in unit
        ]
        wanted = np.concatenate([b["clean"][:, channel].ravel() for b in batches])
        best[channel] = np.linalg.lstsq(np.stack(columns, axis=1), wanted, rcond=None)[0]
    return best.ravel()


QUICK = FineTuning(most_steps=1000, few_steps=400, learning_rate=3e-3, evaluate_every=20)


@pytest.mark.parametrize("count", [1, 3, 12])
def test_training_comes_near_the_least_loss_there_is(step: Model, count: int) -> None:
    strands = smooth(count)
    tuned = fine_tune(strands, WHITENING, step, WEIGHTS, QUICK)
    assert (tuned.weights.dtype, tuned.weights.shape) == (np.float16, (PARAMETERS,))
    before, after = (loss_of(weights, strands, step) for weights in (WEIGHTS, tuned.weights))
    least = loss_of(best_possible(strands, step), strands, step)
    assert least <= after < least + 0.1 * (before - least)
    assert tuned.curve[-1][1] < 0.7 * tuned.curve[0][1]


def test_steps_are_those_of_adam_with_a_rate_that_rises_and_falls_and_a_running_mean(step: Model) -> None:
    strands = smooth(2)
    options = FineTuning(few_steps=12, learning_rate=3e-3, warm_up=8)
    weights = WEIGHTS.astype(np.float64)
    mean, first, second = weights.copy(), np.zeros(PARAMETERS), np.zeros(PARAMETERS)
    for k in range(1, 13):
        b = draw_windows(strands, step, np.random.default_rng([0, 0, k]), None)
        error = predicted(weights, b["noisy"], b["log_snr"], b["position"]) - b["clean"]
        # Linear in the weights: what each adds is the prediction of it alone.
        each = [predicted(unit, b["noisy"], b["log_snr"], b["position"]) for unit in np.eye(PARAMETERS)]
        gradient = np.array([2.0 * np.mean(error * part) for part in each])
        first = BETA1 * first + (1.0 - BETA1) * gradient
        second = BETA2 * second + (1.0 - BETA2) * gradient**2
        direction = first / (1.0 - BETA1**k) / (np.sqrt(second / (1.0 - BETA2**k)) + EPSILON)
        fall = 0.02 + 0.98 * 0.5 * (1.0 - np.cos(np.pi * min(1.0, (13 - k) / 5)))  # in the last 4 of 12
        weights -= FASTER * 3e-3 * min(1.0, k / 8) * fall * direction
        keep = min(options.average, (1.0 + k) / (10.0 + k))
        mean = keep * mean + (1.0 - keep) * weights
    tuned = fine_tune(strands, WHITENING, step, WEIGHTS, options)
    np.testing.assert_allclose(tuned.weights, mean, rtol=0, atol=5e-4)  # float16 rounds numbers below one by as much


@pytest.mark.parametrize("count", [2, 8])
def test_the_seed_decides_the_weights_and_the_threads_do_not(step: Model, count: int) -> None:
    strands = smooth(count)
    options = replace(QUICK, most_steps=60, few_steps=60)
    first, *others = [fine_tune(strands, WHITENING, step, WEIGHTS, options, threads) for threads in (1, 1, 2, 5)]
    for other in others:
        assert other.weights.tobytes() == first.weights.tobytes()
        np.testing.assert_array_equal(other.curve, first.curve)
    changed = fine_tune(strands, WHITENING, step, WEIGHTS, replace(options, seed=1))
    assert changed.weights.tobytes() != first.weights.tobytes()


def test_the_rate_falls_once_it_gains_no_more_and_the_best_is_kept(
    step: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    strands = smooth(12)
    evaluated: list[bytes] = []
    evaluate = finetune._Trainer.evaluate

    def watched(trainer: Any, batch: Any) -> float:
        evaluated.append(trainer.average.astype(np.float16).tobytes())
        late = len(evaluated) > 12 * finetune.EVALUATED_BATCHES
        return evaluate(trainer, batch) + 0.1 * late  # as where it learns its strands by heart

    monkeypatch.setattr(finetune._Trainer, "evaluate", watched)
    left: list[float] = []
    train = finetune._Trainer.train
    monkeypatch.setattr(finetune._Trainer, "train", lambda *given: left.append(given[3]) or train(*given))
    told: list[tuple[int, int, float]] = []
    tuned = fine_tune(strands, WHITENING, step, WEIGHTS, QUICK, progress=lambda *at: told.append(at))
    steps, _, scores = np.array(tuned.curve).T
    best = int(np.flatnonzero(steps == tuned.step)[0])
    assert best == np.argmin(scores)
    end = int(steps[-1])
    assert end < QUICK.most_steps
    # The fall began where two evaluations had gained hardly anything on those before them, and no sooner.
    since = end - int(finetune.FALL_SHARE * QUICK.most_steps)
    before = int(np.flatnonzero(steps == since)[0]) - QUICK.patience
    gained = scores[1:] < np.minimum.accumulate(scores)[:-1] * (1.0 - QUICK.least_gain)
    assert not gained[before : before + QUICK.patience].any()
    assert all(gained[k : k + QUICK.patience].any() for k in range(before))
    np.testing.assert_array_equal(left[:since], 1.0)
    np.testing.assert_allclose(left[since:], np.arange(end - since, 0, -1) / (end - since + 1))
    # It says each step, of how many at most.
    assert [at[:2] for at in told] == [(k, QUICK.most_steps if k <= since else end) for k in range(1, end + 1)]
    # The weights are those of the best step, not of the last.
    assert tuned.weights.tobytes() == evaluated[best * finetune.EVALUATED_BATCHES]
    assert tuned.weights.tobytes() != evaluated[-1]


def test_held_out_strands_are_not_learned_from(step: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    # Each strand has a level of its own, which tells it apart.
    strands = [np.full((3, 100), float(k)) for k in range(12)]
    levels: dict[bool, set[float]] = {True: set(), False: set()}
    drawn = finetune.draw_windows

    def watched(shown: list[Floats], *rest: Any) -> dict[str, NDArray[np.float32]]:
        batch = drawn(shown, *rest)
        levels[len(shown) > 2].update(np.unique(batch["clean"]).tolist())
        return batch

    monkeypatch.setattr(finetune, "draw_windows", watched)
    tuned = fine_tune(strands, WHITENING, step, WEIGHTS, replace(QUICK, most_steps=100))
    assert len(levels[False]) == 2
    assert len(levels[True]) == 10
    assert not levels[True] & levels[False]
    assert np.isfinite(tuned.curve).all()


def test_few_strands_are_all_learned_from(step: Model) -> None:
    tuned = fine_tune(smooth(5), WHITENING, step, WEIGHTS, replace(QUICK, few_steps=50))
    assert tuned.step == 50
    assert [at for at, _, _ in tuned.curve] == [20, 40, 50]
    assert np.isnan([score for _, _, score in tuned.curve]).all()


@pytest.mark.parametrize("count", [1, 8])
@pytest.mark.parametrize("rate", [1e7, 1e30])
def test_a_training_that_diverges_is_told_of(step: Model, count: int, rate: float) -> None:
    options = FineTuning(most_steps=60, few_steps=60, learning_rate=rate, evaluate_every=20)
    with pytest.raises(TextureError, match="diverged: try another seed"):
        fine_tune(smooth(count), WHITENING, step, WEIGHTS, options)


def test_nothing_is_learned_from_nothing(step: Model) -> None:
    with pytest.raises(TextureError, match="cells or more"):
        fine_tune([], WHITENING, step, WEIGHTS)


STRAIGHT = -WHITENING.mean[1] / WHITENING.deviation[1]


def flat() -> Floats:
    """The signals of a straight strand, whitened: its torsion is 0."""
    out = np.zeros((3, CELLS))
    out[1] = STRAIGHT
    return out


@pytest.mark.parametrize(
    ("right", "left", "straight", "expected"),
    [
        (4, 0, 0, False),
        (0, 4, 0, False),
        (1, 1, 0, True),
        (9, 1, 0, True),
        (19, 1, 0, False),
        (1, 19, 0, False),
        # A straight strand is of neither hand, and takes nothing from the others.
        (1, 0, 1, False),
        (0, 1, 1, False),
        (0, 0, 3, False),
        (1, 1, 30, True),
    ],
)
def test_both_hands_are_told_from_one(right: int, left: int, straight: int, expected: bool) -> None:
    strands = [*smooth(right), *smooth(left, hand=-1.0), *[flat()] * straight]
    assert curl_both_ways(strands, WHITENING) is expected


@pytest.mark.parametrize("hands", [(1.0,), (-1.0,), (1.0, -1.0)])
def test_strands_are_mirrored_only_where_both_hands_are_shown(
    step: Model, monkeypatch: pytest.MonkeyPatch, hands: tuple[float, ...]
) -> None:
    seen: set[float] = set()
    drawn = finetune.draw_windows

    def watched(*arguments: Any) -> dict[str, NDArray[np.float32]]:
        batch = drawn(*arguments)
        seen.update(np.sign(np.median(batch["clean"][:, 1], axis=1) - STRAIGHT).tolist())
        return batch

    monkeypatch.setattr(finetune, "draw_windows", watched)
    strands = [strand for hand in hands for strand in smooth(8, hand=hand)]
    fine_tune(strands, WHITENING, step, WEIGHTS, replace(QUICK, most_steps=20))
    assert seen == set(hands)


def numbered(cells: int) -> Floats:
    """A strand whose cells say where they are."""
    return np.arange(cells) + 1000.0 * np.arange(3)[:, None]


def test_windows_come_from_everywhere_and_know_their_place(step: Model) -> None:
    cells = CELLS + 5
    places = set()
    shares = []
    for seed in range(60):
        batch = draw_windows([numbered(cells)], step, np.random.default_rng(seed), None)
        for clean, position in zip(batch["clean"], batch["position"], strict=True):
            first = int(clean[0, 0])
            np.testing.assert_array_equal(clean, numbered(cells)[:, first : first + CELLS])
            # Its place in the strand, or in a longer one of which the strand is a part.
            own = (first + np.arange(CELLS) + 0.5) / cells
            share = (position[-1] - position[0]) / (own[-1] - own[0])
            begin = position[0] - share * own[0]
            np.testing.assert_allclose(position, begin + share * own, rtol=0, atol=1e-5)
            assert begin > -1e-5
            assert begin + share < 1.0 + 1e-5
            shares.append(share)
            places.add(first)
    assert places == set(range(6))
    assert finetune.LEAST_PART - 1e-4 < min(shares) < 0.1
    assert np.mean(np.array(shares) > 1.0 - 1e-4) == pytest.approx(1.0 - finetune.PART_OF_LONGER, abs=0.1)


def test_strands_no_longer_than_a_window_are_shown_whole(step: Model) -> None:
    batch = draw_windows([numbered(CELLS)], step, np.random.default_rng(0), None)
    for k in range(STEP_BATCH):
        np.testing.assert_array_equal(batch["clean"][k], numbered(CELLS))


def test_strands_shorter_than_a_window_are_refused(step: Model) -> None:
    with pytest.raises(TextureError, match=f"{CELLS} cells or more"):
        fine_tune([numbered(CELLS), numbered(CELLS - 1)], WHITENING, step, np.zeros(1, np.float16))


def test_longer_strands_are_shown_more_often(step: Model) -> None:
    strands = [np.zeros((3, CELLS)), np.ones((3, 3 * CELLS))]
    shown = [draw_windows(strands, step, np.random.default_rng(seed), None)["clean"][:, 0, 0] for seed in range(500)]
    assert abs(float(np.mean(shown)) - 0.75) < 0.04  # four deviations of 2,000 draws


def test_noise_is_as_its_log_snr_says(step: Model) -> None:
    strand = smooth(1)[0]
    noises = []
    for seed in range(50):
        batch = draw_windows([strand], step, np.random.default_rng(seed), None)
        assert {array.dtype for array in batch.values()} == {np.dtype(np.float32)}
        np.testing.assert_array_equal(batch["weight"], np.ones(STEP_BATCH))
        half = batch["log_snr"].astype(np.float64) / 2.0
        # One sample in each quarter of the time of the diffusion.
        assert sorted((STEP_BATCH * step.schedule.time(half)).astype(int)) == list(range(STEP_BATCH))
        alpha, sigma = (1.0 / np.sqrt(1.0 + np.exp(s * 2.0 * half))[:, None, None] for s in (-1.0, 1.0))
        noises.append((batch["noisy"] - alpha * batch["clean"]) / sigma)
    noise = np.concatenate(noises)
    assert abs(noise.mean()) < 0.02
    assert abs(noise.std() - 1.0) < 0.02


def test_mirrored_windows_are_those_of_the_mirrored_strand(step: Model) -> None:
    strand = smooth(1, CELLS)[0]
    either = [strand, WHITENING.mirrored(strand)]
    counts = [0, 0]
    for seed in range(50):
        for clean in draw_windows([strand], step, np.random.default_rng(seed), WHITENING)["clean"]:
            differences = [np.abs(clean - wanted).max() for wanted in either]
            assert min(differences) < FLOAT32
            counts[int(np.argmin(differences))] += 1
    assert min(counts) > 60  # of 200


def test_the_shipped_network_is_fitted_and_drawn_alike_whatever_the_threads() -> None:
    denoiser, step = load_model(DENOISER, SHIPPED), load_model(TRAINING_STEP, SHIPPED)
    assert same_network(denoiser, step)
    rng = np.random.default_rng(4)
    strands = [rng.standard_normal((3, denoiser.cells + 40)) for _ in range(2)]
    options = FineTuning(few_steps=3)
    one, two = (fine_tune(strands, denoiser.whitening, step, denoiser.weights, options, n) for n in (1, 2))
    assert one.weights.tobytes() == two.weights.tobytes()
    assert one.weights.tobytes() != denoiser.weights.tobytes()
    noisy = rng.standard_normal((9, 3, 2 * denoiser.cells))
    together = NetworkDenoiser(denoiser, one.weights, 2)(noisy, 0.6, 0.8)
    alone = NetworkDenoiser(denoiser, one.weights, 1)(noisy[8:], 0.6, 0.8)
    assert together[8:].tobytes() == alone.tobytes()
