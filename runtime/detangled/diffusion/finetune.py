"""The network trained on a few strands, without torch: paper, section "Strand Synthesis".

A step of training is a model of its own: weights, an optimiser's moments and a noisy batch go in, new weights and
moments come out. Batches are windows of the strands, from random places, whole where a strand is no longer than one;
mirrored where the strands curl both ways.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.diffusion.whitening import Whitening
from detangled.errors import TextureError
from detangled.models import Model

# Beyond two threads the sums of a step come out in another order, and so other weights.
MOST_THREADS = 2
MIRRORED_FROM = 0.1  # share of the strands that curl the rarer way
FEWEST_TO_HOLD_OUT = 6
HELD_OUT_SHARE = 6  # one strand in so many is held out, to see when it gains no more
EVALUATED_BATCHES = 8
LEAST_RATE = 0.02  # of the learning rate, at the end of its fall
FALL_SHARE = 0.4  # of the most steps
# A new strand may be longer than those shown: so often they pass for a part of one, at the least such a share of it.
PART_OF_LONGER = 0.5
LEAST_PART = 0.05

# (steps done, of at most how many, loss)
StepProgress = Callable[[int, int, float], object]


@dataclass(frozen=True)
class FineTuning:
    """How a network is trained on a few strands.

    most_steps: where it stops at the latest. few_steps: how many where there are too few strands to hold any out.
    learning_rate: its highest. In the last steps, a share FALL_SHARE of the most, it falls by a cosine: these come
    sooner after ``patience`` evaluations without a gain of ``least_gain``. average: decay of the weights' mean.
    """

    most_steps: int = 1100
    few_steps: int = 600
    learning_rate: float = 3e-4
    warm_up: int = 20
    evaluate_every: int = 100
    patience: int = 2
    least_gain: float = 0.005
    average: float = 0.99
    seed: int = 0


@dataclass(frozen=True)
class FineTuned:
    """Weights (P,) float16, the step they are of, and the curve: (step, mean loss since the last, held-out loss).

    The held-out loss is NaN where no strand was held out.
    """

    weights: NDArray[np.float16]
    step: int
    curve: list[tuple[int, float, float]]


def fine_tune(
    strands: list[NDArray[np.float64]],
    whitening: Whitening,
    step_model: Model,
    start: NDArray[np.float16],
    options: FineTuning | None = None,
    threads: int = 1,
    progress: StepProgress | None = None,
) -> FineTuned:
    """Train a network on the signals of strands, each (3, n) and whitened as told, from ``start`` (P,) on.

    No strand may have fewer cells than the network's window.

    The same seed gives the same weights, whatever the number of threads. Raises TextureError where the training
    diverges.
    """
    if min((strand.shape[1] for strand in strands), default=0) < step_model.cells:
        raise TextureError(f"each strand to learn from must have {step_model.cells} cells or more")
    options = options or FineTuning()
    shown, held_out = _split(strands, options.seed)
    mirror = whitening if curl_both_ways(strands, whitening) else None
    most = options.most_steps if held_out else options.few_steps
    trainer = _Trainer(step_model, start, options, min(threads, MOST_THREADS))
    fall = int(FALL_SHARE * most)
    draws = [
        draw_windows(held_out, step_model, np.random.default_rng([options.seed, 1, k]), mirror)
        for k in range(EVALUATED_BATCHES if held_out else 0)
    ]
    curve: list[tuple[int, float, float]] = []
    losses: list[float] = []
    best, best_loss, waited, gained, best_step = trainer.average.copy(), np.inf, 0, np.inf, 0
    step = 0
    while step < most:
        step += 1
        batch = draw_windows(shown, step_model, np.random.default_rng([options.seed, 0, step]), mirror)
        losses.append(trainer.train(batch, step, min(1.0, (most + 1 - step) / (fall + 1))))
        if progress is not None:
            progress(step, most, losses[-1])
        if step % options.evaluate_every and step != most:
            continue
        score = float(np.mean([trainer.evaluate(batch) for batch in draws])) if draws else float("nan")
        curve.append((step, float(np.mean(losses)), score))
        losses = []
        if not draws or score < best_loss:
            best, best_loss, best_step = trainer.average.copy(), score, step
        waited = 0 if score < gained * (1.0 - options.least_gain) else waited + 1
        gained = min(gained, score)
        if draws and waited >= options.patience:
            most = min(most, step + fall)
    with np.errstate(over="ignore"):
        weights = best.astype(np.float16)
    if best_step < min(most, 1) or not np.isfinite(weights).all():
        raise TextureError("the network's training on these strands diverged: try another seed, or fit them by patches")
    return FineTuned(weights, best_step, curve)


class _Trainer:
    """Weights in training, the optimiser's moments and the weights' running mean, all (P,) float32."""

    def __init__(self, model: Model, start: NDArray[np.float16], options: FineTuning, threads: int) -> None:
        self._session = model.session(threads)
        self._options = options
        self.weights = start.astype(np.float32)
        self.first_moment = np.zeros_like(self.weights)
        self.second_moment = np.zeros_like(self.weights)
        self.average = self.weights.copy()

    def train(self, batch: dict[str, NDArray[np.float32]], step: int, left: float) -> float:
        """One step, counted from 1; the loss before it. left: the share of the learning rate's fall that is to come."""
        rise = min(1.0, step / max(self._options.warm_up, 1))
        fall = 0.5 * (1.0 - np.cos(np.pi * left))
        rate = self._options.learning_rate * rise * (LEAST_RATE + (1.0 - LEAST_RATE) * fall)
        self.weights, self.first_moment, self.second_moment, loss = self._run(self.weights, batch, step, rate)
        # Early means would remember the start for long.
        keep = min(self._options.average, (1.0 + step) / (10.0 + step))
        self.average += np.float32(1.0 - keep) * (self.weights - self.average)
        return float(loss)

    def evaluate(self, batch: dict[str, NDArray[np.float32]]) -> float:
        """The loss of the mean weights."""
        return float(self._run(self.average, batch, 1, 0.0)[3])

    def _run(
        self, weights: NDArray[np.float32], batch: dict[str, NDArray[np.float32]], step: int, rate: float
    ) -> list[NDArray[np.float32]]:
        given = {
            "weights": weights,
            "first_moment": self.first_moment,
            "second_moment": self.second_moment,
            "step": np.array(step, dtype=np.float32),
            "learning_rate": np.array(rate, dtype=np.float32),
            **batch,
        }
        outputs = ["new_weights", "new_first_moment", "new_second_moment", "loss"]
        return list(self._session.run(outputs, given))


def draw_windows(
    strands: list[NDArray[np.float64]], model: Model, rng: np.random.Generator, mirror: Whitening | None
) -> dict[str, NDArray[np.float32]]:
    """A noisy batch of windows: noisy, clean (B, 3, L), log_snr (B,), position (B, L), weight (B,), all float32.

    A strand may pass for a part of a longer one, by the positions it is given.
    mirror: the whitening by which windows are mirrored at random; None where they are not.
    """
    size, cells = model.batch, model.cells
    lengths = np.array([strand.shape[1] for strand in strands])
    chosen = rng.choice(len(strands), size=size, p=lengths / lengths.sum())
    clean = np.empty((size, 3, cells))
    position = np.empty((size, cells))
    for k, index in enumerate(chosen):
        strand = strands[index]
        first = int(rng.integers(strand.shape[1] - cells + 1))
        clean[k] = strand[:, first : first + cells]
        position[k] = (first + np.arange(cells) + 0.5) / strand.shape[1]
    share = np.where(rng.uniform(size=size) < PART_OF_LONGER, LEAST_PART ** rng.uniform(size=size), 1.0)[:, None]
    position = rng.uniform(size=(size, 1)) * (1.0 - share) + share * position
    if mirror is not None:
        turned = rng.uniform(size=size) < 0.5
        clean[turned] = mirror.mirrored(clean[turned])
    # One time in each of as many equal parts: less noise in the loss.
    times = (rng.permutation(size) + rng.uniform(size=size)) / size
    alpha, sigma = model.schedule.alpha(times)[:, None, None], model.schedule.sigma(times)[:, None, None]
    arrays = {
        "noisy": alpha * clean + sigma * rng.standard_normal(clean.shape),
        "clean": clean,
        "log_snr": model.schedule.log_snr(times),
        "position": position,
        "weight": np.ones(size),
    }
    return {name: np.ascontiguousarray(array, dtype=np.float32) for name, array in arrays.items()}


def _split(
    strands: list[NDArray[np.float64]], seed: int
) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]]:
    """Strands to train on, and those held out."""
    if len(strands) < FEWEST_TO_HOLD_OUT:
        return strands, []
    order = np.random.default_rng([seed, 2]).permutation(len(strands))
    count = len(strands) // HELD_OUT_SHARE
    return [strands[i] for i in sorted(order[count:])], [strands[i] for i in sorted(order[:count])]


def curl_both_ways(strands: list[NDArray[np.float64]], whitening: Whitening) -> bool:
    """Whether strands of both hands are among these: the sign of the median torsion along a strand.

    A straight strand is of neither.
    """
    straight = -whitening.mean[1] / whitening.deviation[1]
    hands = np.sign([np.median(strand[1]) - straight for strand in strands])
    right, left = np.sum(hands > 0), np.sum(hands < 0)
    return bool(min(right, left) > 0 and min(right, left) >= MIRRORED_FROM * (right + left))
