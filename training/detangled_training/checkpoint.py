"""A denoiser in training, as a file: what is exported, and what it takes to go on."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from detangled.diffusion.schedule import CosineSchedule
from detangled.diffusion.whitening import Whitening
from detangled.errors import DetangledError, ModelError, WriteError
from detangled_training.parameters import restore
from detangled_training.unet import Architecture, UNet

CHECKPOINT = "checkpoint.pt"  # its name in a training's folder


@dataclass(frozen=True, eq=False)
class State:
    """How far a training got.

    history: of each evaluation the step, the mean loss since the last, the held-out loss. current: the weights
    themselves, (P,). optimizer: torch's own state of it. options: what the training was begun with, as plain values.
    """

    step: int
    seconds: float
    history: list[tuple[int, float, float]]
    current: Tensor
    optimizer: dict[str, Any]
    options: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A denoiser, and all that its use takes.

    weights: the moving average of a training's, (P,) float32. cells: of the signals it was trained on. training: how it
    came about, as a manifest tells it. state: None where it cannot be trained on.
    """

    architecture: Architecture
    weights: Tensor
    whitening: Whitening
    schedule: CosineSchedule
    cells: int
    training: dict[str, Any]
    state: State | None = None

    def network(self) -> UNet:
        """The network with these weights."""
        network = UNet(self.architecture)
        restore(network, self.weights)
        return network


def read_checkpoint(path: Path) -> Checkpoint:
    """Read what ``write_checkpoint`` wrote. Raises ModelError where it is missing, damaged or something else."""
    try:
        stored = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror or error})") from error
    except Exception as error:
        # What a damaged file ends in has no class in common: pickle's, zipfile's and torch's own, EOFError, KeyError.
        raise ModelError(f"{path}: not a checkpoint, or damaged") from error
    wanted = [field.name for field in fields(Checkpoint)]
    missing = [name for name in wanted if not isinstance(stored, dict) or name not in stored]
    if missing:
        raise ModelError(f"{path}: not a denoiser's checkpoint: it lacks {', '.join(missing)}")
    try:
        return _checked(stored)
    except (ValueError, TypeError, KeyError, AttributeError, DetangledError) as error:
        raise ModelError(f"{path}: not a denoiser's checkpoint, or damaged ({error})") from error


def write_checkpoint(checkpoint: Checkpoint, path: Path) -> None:
    """Write a checkpoint beside its place, then put it there. Raises WriteError."""
    state = checkpoint.state
    contents = {
        "architecture": asdict(checkpoint.architecture),
        "weights": checkpoint.weights,
        "whitening": asdict(checkpoint.whitening),
        "schedule": asdict(checkpoint.schedule),
        "cells": checkpoint.cells,
        "training": checkpoint.training,
        "state": None if state is None else {field.name: getattr(state, field.name) for field in fields(state)},
    }
    temporary = path.with_name(f".{path.name}.new")
    try:
        torch.save(contents, temporary)
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:  # the latter is torch's, of a full disk
        raise WriteError(f"{path}: cannot be written ({error})") from error
    finally:
        temporary.unlink(missing_ok=True)


def architecture_of(plain: Mapping[str, Any]) -> Architecture:
    """An architecture of what ``asdict`` made of one, be its channels a tuple or a list."""
    return Architecture(**{**plain, "channels": tuple(plain["channels"])})


def _checked(stored: Mapping[str, Any]) -> Checkpoint:
    architecture = architecture_of(stored["architecture"])
    made = Checkpoint(
        architecture=architecture,
        weights=stored["weights"],
        whitening=Whitening(**{name: tuple(value) for name, value in stored["whitening"].items()}),
        schedule=CosineSchedule(**stored["schedule"]),
        cells=int(stored["cells"]),
        training=dict(stored["training"]),
        state=None if stored["state"] is None else State(**stored["state"]),
    )
    if made.cells < 1 or made.cells % architecture.multiple:
        raise ValueError(f"{made.cells} cells, not a multiple of {architecture.multiple}")
    with torch.device("meta"):
        count = sum(parameter.numel() for parameter in UNet(architecture).parameters())
    for weights in [made.weights] if made.state is None else [made.weights, made.state.current]:
        if weights.shape != (count,):
            raise ValueError(f"weights of shape {tuple(weights.shape)}, not {count} of them")
    return made
