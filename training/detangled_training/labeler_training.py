"""Training of the labelers: paper, section "Inferencing texture parameters", "Training".

In the paper's order: the twist network on unsimulated strands, the helix network on the same, then each again on
simulated ones. Where strands were simulated, half of each batch is; the other half keeps what was learned before.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from detangled.errors import ModelError, ReadError, WriteError
from detangled.texture import HAIR_TYPES
from detangled_training.dataset import SPLIT_NAMES, TEST, TRAIN, VALIDATION, Dataset, read_dataset
from detangled_training.labeler import Labeler, LabelerSizes, in_canonical_space
from detangled_training.processes import Processes
from detangled_training.provenance import commit, make_folder
from detangled_training.strands import UNTYPED, twist_prevalence

CHECKPOINT = "labelers.pt"
NAMES = {False: "procedural", True: "simulated"}  # of data sets
STAGES = (("twist", False), ("helix", False), ("twist", True), ("helix", True))  # network, on simulated strands
STORED = ("options", "network", "optimizer", "stage", "step", "seconds", "history", "report")
COLUMNS = ("base", "kind", "radius", "wavelength", "twists", "length", "read", "world")
LEAST_RATE = 0.01  # of the learning rate, at the end of each stage
SECOND_RATE = 0.5  # of the learning rate, where a network is trained again
CLIP = 1.0
LAID = 0.5  # of strands are shown as if they lay in the world as they do in canonical space
TWIST_KNEE, LOGARITHM_KNEE = 0.05, 0.1  # errors beyond count no longer by their square
# Errors of radii count in parts of them, but below so many cm nobody can tell.
LEAST_RADIUS = 0.02
EVALUATED = 256  # signals at once
MOST_EVALUATED = 2048


@dataclass(frozen=True)
class LabelerOptions:
    """How labelers are trained. steps: of each stage, in the order of STAGES. learning_rates: of either network."""

    steps: tuple[int, ...] = (2500, 8000, 700, 1000)
    batch: int = 64
    learning_rates: dict[str, float] = field(default_factory=lambda: {"twist": 1e-3, "helix": 5e-4})
    warm_up: int = 100
    weight_decay: float = 0.01
    seed: int = 0
    evaluate_every: int = 250
    save_every: int = 100
    sizes: LabelerSizes = field(default_factory=LabelerSizes)


@dataclass(frozen=True)
class Examples:
    """Signals (V, CELLS, 5) and what is to be told of them, (V,) each: radius, wavelength [cm], twist, kind, read."""

    signals: NDArray[np.float32]
    radius: NDArray[np.float32]
    wavelength: NDArray[np.float32]
    twist: NDArray[np.float32]
    kind: NDArray[np.int8]
    read: NDArray[np.bool_]

    @classmethod
    def of(cls, data: Dataset) -> Examples:
        labels = data.labels
        twist = twist_prevalence(labels["twists"], labels["length"])
        radius, wavelength = (labels[name].astype(np.float32) for name in ("radius", "wavelength"))
        return cls(
            np.concatenate([data.signals, labels["world"]], axis=2),
            radius,
            wavelength,
            twist.astype(np.float32),
            labels["kind"],
            labels["read"],
        )

    def __len__(self) -> int:
        return len(self.signals)

    def batch(self, chosen: NDArray[np.int64], device: torch.device) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Signals, radius, wavelength and twist of some."""
        arrays = (self.signals, self.radius, self.wavelength, self.twist)
        made = [torch.from_numpy(array[chosen]).to(device) for array in arrays]
        return made[0], made[1], made[2], made[3]


class LabelerTraining:
    """Labelers in training, gone on with where their folder holds a checkpoint.

    procedural, simulated: folders of data sets. Raises ModelError where the checkpoint was begun with other options,
    WriteError where the folder cannot be written to, and what ``read_dataset`` raises.
    """

    def __init__(
        self,
        options: LabelerOptions,
        folder: Path,
        procedural: Path,
        simulated: Path,
        note: Callable[[str], object] = lambda text: None,
    ) -> None:
        self.options, self.folder = options, folder
        self.processes = Processes(options.batch)
        self.note = note if self.processes.rank == 0 else lambda text: None
        make_folder(folder)
        self.folders = {False: procedural, True: simulated}
        torch.manual_seed(options.seed)
        self.network = Labeler(options.sizes).to(self.processes.device)
        self.stage, self.step, self.seconds = 0, 0, 0.0
        self.history: list[tuple[int, int, float, float]] = []  # stage, step, mean loss since the last, held-out error
        self._optimizer_state: dict[str, Any] | None = None
        self.data: dict[bool, dict[str, Any]] = {}
        self.scores: dict[str, Any] = {}  # on the strands held out for tests, once the training is done
        self._resume()

    @property
    def path(self) -> Path:
        return self.folder / CHECKPOINT

    @property
    def steps_done(self) -> int:
        return sum(self.options.steps[: self.stage]) + self.step

    def run(self, progress: Callable[[int, float], object] | None = None) -> None:
        """Train to the end, saving on the way. progress: told how many steps are done, of all stages, and the loss."""
        train: dict[bool, Examples] = {}
        held_out: dict[bool, Examples] = {}
        began = time.monotonic()
        for stage in range(self.stage, len(STAGES)):
            name, on_simulated = STAGES[stage]
            for simulated in {False, on_simulated} - set(train):
                train[simulated], held_out[simulated] = (self._read(simulated, split) for split in (TRAIN, VALIDATION))
            part: nn.Module = getattr(self.network, name)
            rate = self.options.learning_rates[name] * (SECOND_RATE if on_simulated else 1.0)
            optimizer = torch.optim.AdamW(part.parameters(), rate, weight_decay=self.options.weight_decay)
            if self._optimizer_state is not None:
                optimizer.load_state_dict(self._optimizer_state)
                self._optimizer_state = None
            losses = []
            while self.step < self.options.steps[stage]:
                sources = [train[False], train[True]] if on_simulated else [train[False]]
                loss = self._train(stage, part, optimizer, rate, sources)
                losses.append(loss)
                self.step += 1
                last = self.step == self.options.steps[stage]
                if self.step % self.options.evaluate_every == 0 or last:
                    error = self._evaluate(name, held_out[on_simulated])
                    self.history.append((stage, self.step, float(np.mean(losses)), error))
                    self.note(f"{name}, step {self.step}: loss {np.mean(losses):.4f}, held out {error:.4f}")
                    losses = []
                if last:
                    self.stage, self.step = stage + 1, 0
                if self.step % self.options.save_every == 0:
                    self.seconds += time.monotonic() - began
                    began = time.monotonic()
                    self.save(None if last else optimizer.state_dict())
                if progress is not None:
                    progress(self.steps_done, loss)
                if last:
                    break

        if not self.scores:
            for simulated, name in NAMES.items():
                examples = self._read(simulated, TEST)
                self.scores[name] = score(self.network, examples)
                laid = replace(examples, signals=examples.signals[:, :, :3])
                self.scores[f"{name}, in canonical space"] = score(self.network, laid)
            self.save(None)

    def report(self) -> dict[str, Any]:
        """What a manifest says of a training: data, seeds, steps, scores, time and place."""
        return {
            "commit": commit(),
            **{name: value for name, value in _plain(self.options).items() if name != "sizes"},
            "data": {NAMES[simulated]: origin for simulated, origin in self.data.items()},
            "steps_done": self.steps_done,
            "seconds": round(self.seconds),
            "device": self.processes.device_name,
            "processes": self.processes.world,
            "history": [[stage, step, round(loss, 5), round(error, 5)] for stage, step, loss, error in self.history],
            "scores": self.scores,
        }

    def close(self) -> None:
        self.processes.close()

    def _read(self, simulated: bool, split: int) -> Examples:
        data = read_dataset(self.folders[simulated], split, COLUMNS)
        if len(data.signals) == 0:
            raise ReadError(f"{self.folders[simulated]}: too few strands: none of them is for {SPLIT_NAMES[split]}")
        if (data.origin["options"]["hung"] > 0) != simulated:
            raise ReadError(f"{self.folders[simulated]}: holds strands that are not {NAMES[simulated]}")
        if split == TRAIN:
            before = self.data.get(simulated, data.origin)
            if before["sha256"] != data.origin["sha256"]:
                raise ModelError(f"{self.path}: begun with other strands than those in {self.folders[simulated]}")
            self.data[simulated] = data.origin
        return Examples.of(data)

    def _train(
        self, stage: int, part: nn.Module, optimizer: torch.optim.Optimizer, rate: float, sources: list[Examples]
    ) -> float:
        options, processes = self.options, self.processes
        rng = np.random.default_rng([options.seed, stage, self.step])
        sizes = [len(piece) for piece in np.array_split(np.arange(options.batch), len(sources))]
        drawn = [
            source.batch(rng.integers(len(source), size=size), processes.device)
            for source, size in zip(sources, sizes, strict=True)
        ]
        signals, radius, wavelength, twist = (
            torch.cat(parts)[self.processes.part] for parts in zip(*drawn, strict=True)
        )
        # Mirrored strands are as likely. Turning one about its axis changes none of its signals.
        mirrored, laid = (
            torch.from_numpy(rng.uniform(size=options.batch) < share)[self.processes.part, None, None].to(
                signals.device
            )
            for share in (0.5, LAID)
        )
        turned_over = torch.tensor([1.0, -1.0, 1.0, 1.0, -1.0], device=signals.device)
        signals = torch.where(mirrored, signals * turned_over, signals)
        signals = torch.where(laid, in_canonical_space(signals), signals)
        rise = min(1.0, (self.step + 1) / max(options.warm_up, 1))
        fall = 0.5 * (1.0 + math.cos(math.pi * self.step / options.steps[stage]))
        for group in optimizer.param_groups:
            group["lr"] = rate * rise * (LEAST_RATE + (1.0 - LEAST_RATE) * fall)
        torch.manual_seed(int(rng.integers(1 << 62)) + processes.rank)  # of what drops out
        self.network.train()
        optimizer.zero_grad(set_to_none=True)
        with torch.autocast(processes.device.type, torch.bfloat16, enabled=processes.on_gpu):
            loss = self._loss(STAGES[stage][0], signals, radius, wavelength, twist)
        loss.backward()
        processes.average(part.parameters(), loss)
        torch.nn.utils.clip_grad_norm_(part.parameters(), CLIP)
        optimizer.step()
        return float(loss.detach())

    def _loss(self, name: str, signals: Tensor, radius: Tensor, wavelength: Tensor, twist: Tensor) -> Tensor:
        if name == "twist":
            return functional.smooth_l1_loss(self.network.twist(signals), twist, beta=TWIST_KNEE)
        with torch.no_grad():
            self.network.twist.eval()
            told = self.network.twist(signals)
        found = self.network.knowing(signals, told)
        errors = torch.stack(logarithms(found.radius, found.wavelength, radius, wavelength))
        return functional.smooth_l1_loss(errors, torch.zeros_like(errors), beta=LOGARITHM_KNEE)

    def _evaluate(self, name: str, examples: Examples) -> float:
        """The mean error on what was held out: of T_f, or of the logarithms of radius and wavelength."""
        some = np.linspace(0, len(examples) - 1, min(len(examples), MOST_EVALUATED)).astype(np.int64)
        radius, wavelength, twist = told(self.network, examples.signals[some])
        if name == "twist":
            return float(np.abs(twist - examples.twist[some]).mean())
        wanted = (torch.from_numpy(x[some]) for x in (examples.radius, examples.wavelength))
        errors = logarithms(torch.from_numpy(radius), torch.from_numpy(wavelength), *wanted)
        return float(torch.stack(errors).abs().mean())

    def save(self, optimizer: dict[str, Any] | None) -> None:
        """Write the checkpoint, beside its place first. Raises WriteError."""
        if self.processes.rank:
            return
        contents = {
            "options": _plain(self.options), "network": self.network.state_dict(), "optimizer": optimizer,
            "stage": self.stage, "step": self.step, "seconds": self.seconds, "history": self.history,
            "report": self.report(),
        }  # fmt: skip
        temporary = self.path.with_name(f".{self.path.name}.new")
        try:
            torch.save(contents, temporary)
            os.replace(temporary, self.path)
        except (OSError, RuntimeError) as error:  # the latter is torch's, of a full disk
            raise WriteError(f"{self.path}: cannot be written ({error})") from error
        finally:
            temporary.unlink(missing_ok=True)

    def _resume(self) -> None:
        if not self.path.exists():
            return
        stored = read_labelers(self.path)
        mine = _plain(self.options)
        differing = [name for name in mine if mine[name] != stored["options"].get(name)]
        if differing:
            names = ", ".join(name.replace("_", " ") for name in differing)
            raise ModelError(f"{self.path}: begun with another {names}: give the same, or another folder")
        self.network.load_state_dict(stored["network"])
        self._optimizer_state = stored["optimizer"]
        self.stage, self.step = stored["stage"], stored["step"]
        self.seconds, self.history = stored["seconds"], list(stored["history"])
        self.scores = stored["report"]["scores"]
        self.data = {simulated: stored["report"]["data"][name] for simulated, name in NAMES.items()
                     if name in stored["report"]["data"]}  # fmt: skip
        self.note(f"{self.path}: going on from step {self.steps_done}")


def logarithms(radius: Tensor, wavelength: Tensor, wanted: Tensor, wanted_wavelength: Tensor) -> tuple[Tensor, Tensor]:
    """How far radius and wavelength (B,) are off, as logarithms of their ratios to what is wanted."""
    by_radius = torch.log((radius + LEAST_RADIUS) / (wanted + LEAST_RADIUS))
    return by_radius, torch.log(wavelength / wanted_wavelength)


def told(network: Labeler, signals: NDArray[np.float32]) -> tuple[NDArray, NDArray, NDArray]:
    """Radius, wavelength and twist (V,) that a network tells of signals (V, CELLS, 3 or 5)."""
    network.eval()
    device = next(network.parameters()).device
    parts = []
    with torch.no_grad():
        for first in range(0, len(signals), EVALUATED):
            found = network(torch.from_numpy(signals[first : first + EVALUATED]).to(device))
            parts.append(torch.stack([found.radius, found.wavelength, found.twist]).cpu().numpy())
    radius, wavelength, twist = np.concatenate(parts, axis=1)
    return radius, wavelength, twist


def score(network: Labeler, examples: Examples) -> dict[str, dict[str, float]]:
    """Errors by type and over all: of radius and wavelength in parts of them, median and 90 %; of T_f, the mean.

    Those of strands as read from a file, and of strands of no type, are counted apart.
    """
    radius, wavelength, twist = told(network, examples.signals)
    typed = ~examples.read & (examples.kind != UNTYPED)
    rows = {"all": typed, "of no type": ~examples.read & ~typed}
    rows |= {kind.name: ~examples.read & (examples.kind == k) for k, kind in enumerate(HAIR_TYPES)}
    rows["as read"] = examples.read
    scores = {}
    for name, chosen in rows.items():
        if not chosen.any():
            continue
        by_radius, by_wavelength = (
            np.abs(found[chosen] / wanted[chosen] - 1.0)
            for found, wanted in ((radius, examples.radius), (wavelength, examples.wavelength))
        )
        scores[name] = {
            "count": int(chosen.sum()),
            "radius_median": float(np.median(by_radius)),
            "radius_90": float(np.percentile(by_radius, 90)),
            "wavelength_median": float(np.median(by_wavelength)),
            "wavelength_90": float(np.percentile(by_wavelength, 90)),
            "twist_mean": float(np.abs(twist[chosen] - examples.twist[chosen]).mean()),
        }
    return scores


def read_labelers(path: Path) -> dict[str, Any]:
    """What a checkpoint of labelers holds. Raises ModelError where it is missing, damaged or something else."""
    try:
        stored = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror or error})") from error
    except Exception as error:
        # What a damaged file ends in has no class in common: pickle's, zipfile's and torch's own, EOFError, KeyError.
        raise ModelError(f"{path}: not a checkpoint, or damaged") from error
    lacking = [name for name in STORED if not isinstance(stored, dict) or name not in stored]
    if lacking:
        raise ModelError(f"{path}: not a checkpoint of labelers: it lacks {', '.join(lacking)}")
    return stored


def is_labelers(path: Path) -> bool:
    """Whether a file is a checkpoint of labelers; not where it cannot be read."""
    try:
        read_labelers(path)
    except ModelError:
        return False
    return True


def _plain(options: LabelerOptions) -> dict[str, Any]:
    return {**asdict(options), "steps": list(options.steps)}
