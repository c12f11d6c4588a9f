"""Training of the denoiser: paper, section Training.

Variance-preserving diffusion under the cosine schedule (Nichol and Dhariwal 2021); the network predicts the clean
whitened signal, with AdamW (Loshchilov and Hutter 2019), a learning rate that rises and then falls as a cosine,
clipped gradients, and bfloat16 on a GPU. What is exported is the moving average of the weights.

What a step sees is drawn from its own number: the weights of a training that was stopped go on as if it had not
been, and several processes (torchrun) share the very batches that one would see.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from detangled.diffusion.schedule import CosineSchedule
from detangled.diffusion.whitening import Whitening
from detangled.errors import ModelError, ReadError
from detangled.models import DENOISER, Model, load_model
from detangled_training.checkpoint import (
    CHECKPOINT,
    Checkpoint,
    State,
    architecture_of,
    read_checkpoint,
    write_checkpoint,
)
from detangled_training.dataset import TRAIN, VALIDATION, Dataset, read_dataset
from detangled_training.parameters import Optimizer, flatten, flatten_tensors, layout, restore, torch_optimizer
from detangled_training.processes import Processes
from detangled_training.provenance import commit, make_folder
from detangled_training.signals import pooled_whitening
from detangled_training.strands import twist_prevalence
from detangled_training.unet import CONDITIONS, Architecture, UNet

WHITENED_BY = 4000  # signals that the whitening is taken from
HELD_OUT = 512
COLUMNS = ("radius", "wavelength", "twists", "length", "position", "hand", "variant", "read")
HELD_OUT_SEED = 1
EVALUATED_AT = 8  # noise levels, evenly spaced in time
LEAST_RATE = 0.01  # of the learning rate, at the end
# For one sample in so many nothing is asked for, and each number of the others is left out as often.
UNASKED = 0.1
# A third of all signals are whitened by themselves, and nothing is asked of them: what a fit to a few strands starts
# from. Strands of a texture curl either way, but the mean of both hands has no torsion: other signals are of one hand.
BY_ITSELF = 1 / 3
# Half of all signals are shown as a part of a longer strand: the networks' ramp then covers less than root to tip.
PART_OF_LONGER = 0.5
LEAST_PART = 0.05


@dataclass(frozen=True)
class TrainingOptions:
    """How a denoiser is trained. average: decay of the weights' mean."""

    steps: int = 20_000
    batch: int = 32
    learning_rate: float = 4e-4
    warm_up: int = 200
    average: float = 0.999
    seed: int = 0
    evaluate_every: int = 500
    save_every: int = 250
    architecture: Architecture = field(default_factory=Architecture)
    optimizer: Optimizer = field(default_factory=lambda: Optimizer(beta2=0.999))

    @property
    def plain(self) -> dict[str, Any]:
        """The options as plain values that a checkpoint and a manifest can hold."""
        plain = asdict(self)
        plain["architecture"]["channels"] = list(plain["architecture"]["channels"])
        return plain


@dataclass(frozen=True)
class Samples:
    """Signals (S, L, 3) of strands to train on, kappa, tau [1/cm] and v [cm per t], all float32.

    All wind to the right. asked: (S, CONDITIONS), what one may ask for. position: (S, 2), the part of its strand that
    each covers.
    """

    signals: NDArray[np.float32]
    asked: NDArray[np.float32]
    position: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.signals)

    @property
    def cells(self) -> int:
        return self.signals.shape[1]

    @classmethod
    def of(cls, data: Sequence[Dataset]) -> Samples:
        """Those of data sets, but for strands as files hold them. Raises ReadError where their cells differ."""
        if len({one.signals.shape[1] for one in data}) != 1:
            raise ReadError("the data sets' signals are of different cells: make them alike")
        parts = []
        for one in data:
            labels = one.labels
            lengths = one.signals[:, :, 2].mean(axis=1)
            twist = twist_prevalence(labels["twists"], labels["length"])
            sizes = [np.log(labels["radius"]), np.log(labels["wavelength"]), twist, np.log(lengths)]
            asked = np.stack([*sizes, labels["variant"] >= 0], axis=1)
            kept = ~labels["read"]
            right = one.signals[kept]
            right[:, :, 1] *= labels["hand"][kept, None]
            others = (array[kept].astype(np.float32, copy=False) for array in (asked, labels["position"]))
            parts.append([right, *others])
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def select(self, chosen: NDArray[np.int64]) -> Samples:
        """Some of them."""
        return Samples(self.signals[chosen], self.asked[chosen], self.position[chosen])

    def whitening(self) -> Whitening:
        """What suits them all."""
        some = np.linspace(0, len(self) - 1, min(len(self), WHITENED_BY)).astype(np.int64)
        return pooled_whitening(self.signals[some])


@dataclass(frozen=True)
class Data:
    """What a network is trained on, what it is tried on, and how both are whitened."""

    samples: Samples
    held_out: Samples
    whitening: Whitening


@dataclass(frozen=True)
class Batch:
    """What one step is given, all float32: see ``UNet.forward``; clean: (B, 3, L)."""

    noisy: Tensor
    clean: Tensor
    log_snr: Tensor
    position: Tensor
    asked: Tensor
    known: Tensor


def begun(checkpoint: Checkpoint, path: Path) -> tuple[State, TrainingOptions]:
    """How far a checkpoint's training got, and with which options. Raises ModelError where there is none to go on."""
    if checkpoint.state is None:
        raise ModelError(f"{path}: holds a network, but no training to go on with")
    plain = checkpoint.state.options
    try:
        architecture, optimizer = architecture_of(plain["architecture"]), Optimizer(**plain["optimizer"])
        options = TrainingOptions(**{**plain, "architecture": architecture, "optimizer": optimizer})
    except (ValueError, TypeError, KeyError) as error:
        raise ModelError(f"{path}: its training is of another version, or damaged ({error})") from error
    return checkpoint.state, options


def draw_batch(
    samples: Samples, whitening: Whitening, schedule: CosineSchedule, options: TrainingOptions, step: int
) -> Batch:
    """The whole batch of a step, drawn from the seed and the step's number."""
    rng = np.random.default_rng([options.seed, step])
    size = options.batch
    chosen = rng.integers(len(samples), size=size)
    by_itself = rng.uniform(size=size) < BY_ITSELF
    values = samples.signals[chosen].astype(np.float64)
    values[by_itself & (rng.uniform(size=size) < 0.5), :, 1] *= -1.0
    clean = whitening.whiten(values)
    for k in np.flatnonzero(by_itself):
        clean[k] = Whitening.of([values[k]]).whiten(values[k])
    # One time in each of as many equal parts: less noise in the loss.
    times = (rng.permutation(size) + rng.uniform(size=size)) / size
    known = (rng.uniform(size=(size, CONDITIONS)) >= UNASKED) & (rng.uniform(size=(size, 1)) >= UNASKED)
    known &= ~by_itself[:, None]
    ramp = samples.position[chosen].astype(np.float64)
    share = np.where(rng.uniform(size=size) < PART_OF_LONGER, LEAST_PART ** rng.uniform(size=size), 1.0)
    begin = rng.uniform(size=size) * (1.0 - share)
    ramp = begin[:, None] + share[:, None] * ramp
    noise = rng.standard_normal(clean.shape)
    return _noisy(clean, noise, times, ramp, samples.asked[chosen], known, schedule)


def _noisy(
    clean: NDArray[np.float64],
    noise: NDArray[np.float64],
    times: NDArray[np.float64],
    ramp: NDArray[np.float64],
    asked: NDArray[np.float32],
    known: NDArray[np.bool_],
    schedule: CosineSchedule,
) -> Batch:
    alpha, sigma = (part[:, None, None] for part in (schedule.alpha(times), schedule.sigma(times)))
    at = (np.arange(clean.shape[2]) + 0.5) / clean.shape[2]
    position = ramp[:, :1] + (ramp[:, 1:] - ramp[:, :1]) * at
    arrays = (alpha * clean + sigma * noise, clean, schedule.log_snr(times), position, asked, known)
    return Batch(*(torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32)) for array in arrays))


class Training:
    """A denoiser in training: its weights, their average, the optimiser's state, and how it went so far.

    Where its folder holds a checkpoint it goes on from there. data: folders of data sets. start: a folder of exported
    models, whose denoiser a new training begins with. Raises ModelError where the checkpoint was begun with other
    options or another model, or the model is of other sizes, WriteError where the folder cannot be written to.
    """

    def __init__(
        self,
        options: TrainingOptions,
        folder: Path,
        data: Sequence[Path],
        start: Path | None = None,
        note: Callable[[str], object] = lambda text: None,
    ) -> None:
        self.options, self.folder, self.folders = options, folder, tuple(data)
        self.processes = Processes(options.batch)
        self.device = self.processes.device
        self.note = note if self.processes.rank == 0 else lambda text: None
        model = None if start is None else load_model(DENOISER, start)
        make_folder(folder)
        torch.manual_seed(options.seed)
        self.network = UNet(options.architecture).to(self.device)
        self.optimizer = torch_optimizer(self.network, options.optimizer, options.learning_rate)
        self.schedule = CosineSchedule()
        self.average = {name: value.detach().clone() for name, value in self.network.named_parameters()}
        self.step = 0
        self.seconds = 0.0
        self.history: list[tuple[int, float, float]] = []  # step, mean loss since the last, held-out loss
        self.whitening: Whitening | None = None  # that of the data, where the training does not go on from another
        self.origin: dict[str, Any] = {}
        if self.path.exists():
            self._resume(model)
        elif model is not None:
            self._begin_with(model)

    @property
    def path(self) -> Path:
        return self.folder / CHECKPOINT

    def prepare(self) -> Data:
        """Read the data. Raises what ``read_dataset`` raises, and ModelError where a training was begun with others."""
        train, held_out = (
            [read_dataset(folder, split, COLUMNS) for folder in self.folders] for split in (TRAIN, VALIDATION)
        )
        origins = [one.origin for one in train]
        before = self.origin.get("data", origins)
        if [one["sha256"] for one in before] != [one["sha256"] for one in origins]:
            raise ModelError(f"{self.path}: begun with other strands: give the same data sets, or another folder")
        self.origin["data"] = origins
        samples, tried = Samples.of(train), Samples.of(held_out)
        if len(samples) == 0 or len(tried) == 0:
            raise ReadError("too few strands: none of them is for training, or none is held out")
        some = np.linspace(0, len(tried) - 1, min(len(tried), HELD_OUT)).astype(np.int64)
        return Data(samples, tried.select(some), self.whitening or samples.whitening())

    def run(self, data: Data | None = None, progress: Callable[[int, float], object] | None = None) -> None:
        """Train up to the last step, saving and evaluating on the way. progress: told each step done and its loss."""
        data = data or self.prepare()
        options = self.options
        losses = []
        began = time.monotonic()
        while self.step < options.steps:
            loss = self._train(draw_batch(data.samples, data.whitening, self.schedule, options, self.step))
            losses.append(loss)
            self.step += 1
            last = self.step == options.steps
            if self.step % options.evaluate_every == 0 or last:
                score = self.evaluate(data)
                self.history.append((self.step, float(np.mean(losses)), score))
                self.note(f"step {self.step}: loss {np.mean(losses):.4f}, held out {score:.4f}")
                losses = []
            if self.step % options.save_every == 0 or last:
                self.seconds += time.monotonic() - began
                began = time.monotonic()
                self.save(data)
            if progress is not None:
                progress(self.step, loss)

    def close(self) -> None:
        """Part from the other processes, where there are any."""
        self.processes.close()

    def _rate(self) -> float:
        """The learning rate of the step at hand."""
        options = self.options
        rise = min(1.0, (self.step + 1) / max(options.warm_up, 1))
        fall = 0.5 * (1.0 + math.cos(math.pi * self.step / options.steps))
        return options.learning_rate * rise * (LEAST_RATE + (1.0 - LEAST_RATE) * fall)

    def _train(self, batch: Batch) -> float:
        names = ("noisy", "log_snr", "position", "asked", "known")
        given = [getattr(batch, name)[self.processes.part].to(self.device) for name in names]
        self.network.train()
        for group in self.optimizer.param_groups:
            group["lr"] = self._rate()
        self.optimizer.zero_grad(set_to_none=True)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.processes.on_gpu):
            predicted = self.network(*given)
        loss = ((predicted.float() - batch.clean[self.processes.part].to(self.device)) ** 2).mean()
        loss.backward()
        self.processes.average(self.network.parameters(), loss)
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.options.optimizer.clip)
        self.optimizer.step()
        # Early averages would remember the start for long.
        decay = min(self.options.average, (1.0 + self.step) / (10.0 + self.step))
        with torch.no_grad():
            for name, value in self.network.named_parameters():
                self.average[name].lerp_(value, 1.0 - decay)
        return float(loss.detach())

    def evaluate(self, data: Data) -> float:
        """The averaged network's loss on what was held out, asked for, at always the same noise levels and noise."""
        samples = data.held_out
        network = UNet(self.options.architecture).to(self.device)
        network.load_state_dict({**network.state_dict(), **self.average})
        network.eval()
        clean = data.whitening.whiten(samples.signals.astype(np.float64))
        total = 0.0
        for level in range(EVALUATED_AT):
            rng = np.random.default_rng([HELD_OUT_SEED, level])
            count = len(samples)
            noise = rng.standard_normal(clean.shape)
            times = np.full(count, (level + 0.5) / EVALUATED_AT)
            known = np.ones((count, CONDITIONS), dtype=bool)
            position = samples.position.astype(np.float64)
            everything = _noisy(clean, noise, times, position, samples.asked, known, self.schedule)
            for first in range(0, count, 128):
                part = slice(first, first + 128)
                given = (everything.noisy, everything.log_snr, everything.position, everything.asked, everything.known)
                with torch.no_grad():
                    predicted = network(*(tensor[part].to(self.device) for tensor in given)).cpu()
                total += float(((predicted - everything.clean[part]) ** 2).sum())
        return total / (EVALUATED_AT * clean.size)

    def save(self, data: Data) -> None:
        """Write the checkpoint."""
        if self.processes.rank:
            return
        state = State(
            step=self.step,
            seconds=self.seconds,
            history=self.history,
            current=flatten(self.network),
            optimizer=self.optimizer.state_dict(),
            options=self.options.plain,
        )
        checkpoint = Checkpoint(
            architecture=self.options.architecture,
            weights=flatten_tensors(self.average, layout(self.network)),
            whitening=data.whitening,
            schedule=self.schedule,
            cells=data.samples.cells,
            training=self.report(),
            state=state,
        )
        write_checkpoint(checkpoint, self.path)

    def report(self) -> dict[str, Any]:
        """What a manifest says of a training: data, seeds, steps, scores, time and place."""
        return {
            "commit": commit(),
            **self.origin,
            **{k: v for k, v in self.options.plain.items() if k not in ("architecture", "optimizer")},
            "steps_done": self.step,
            "seconds": round(self.seconds),
            "device": self.processes.device_name,
            "processes": self.processes.world,
            "held_out_signals": HELD_OUT,
            "history": [[step, round(loss, 5), round(score, 5)] for step, loss, score in self.history],
        }

    def _resume(self, model: Model | None) -> None:
        """Go on from the checkpoint, which was begun with this model, where one is given."""
        stored = read_checkpoint(self.path)
        state, options = begun(stored, self.path)
        mine, theirs = self.options.plain, options.plain
        differing = [name for name in mine if mine[name] != theirs[name]]
        if differing:
            names = ", ".join(name.replace("_", " ") for name in differing)
            raise ModelError(f"{self.path}: begun with another {names}: give the same, or another folder")
        begun_with = stored.training.get("start", {}).get("sha256")
        if model is not None and begun_with != hashlib.sha256(model.data).hexdigest():
            raise ModelError(f"{self.path}: not begun with {model.path}: leave --start out, or name another folder")
        restore(self.network, state.current)
        averaged = stored.network().named_parameters()
        self.average = {name: value.detach().clone().to(self.device) for name, value in averaged}
        self.optimizer.load_state_dict(state.optimizer)
        self.step, self.seconds, self.history = state.step, state.seconds, list(state.history)
        self.whitening = stored.whitening
        self.origin = {name: stored.training[name] for name in ("data", "start") if name in stored.training}
        self.note(f"{self.path}: going on from step {self.step}")

    def _begin_with(self, model: Model) -> None:
        """Begin with a model's weights, in data whitened as its own were."""
        if model.architecture != self.options.plain["architecture"]:
            raise ModelError(f"{model.path}: a network of other sizes: {model.architecture}")
        restore(self.network, torch.from_numpy(model.weights.astype(np.float32)))
        self.average = {name: value.detach().clone() for name, value in self.network.named_parameters()}
        self.whitening = model.whitening
        self.origin = {"start": {"sha256": hashlib.sha256(model.data).hexdigest(), "training": model.training}}
