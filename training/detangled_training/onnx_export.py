"""A denoiser as ONNX: one graph that predicts clean signals, one that is a step of training, a manifest beside each.

``denoiser.onnx`` takes any batch and any multiple of 16 cells. Its weights are one float16 vector of fixed place in the
file, so that a runtime without torch or onnx reads them, or runs the graph with others in their stead.
``training_step.onnx`` carries no weights: they go in and come out. Both are checked against torch as they are written.
"""

from __future__ import annotations

import copy
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from onnx import numpy_helper
from torch import Tensor
from torch.func import functional_call
from torch.fx.experimental.proxy_tensor import make_fx

from detangled.errors import ModelError
from detangled.models import CONDITION_NAMES, DENOISER, FORMAT, TRAINING_STEP, VERSION
from detangled_training.checkpoint import Checkpoint
from detangled_training.onnx_files import OPSET, Exported, difference, serialized, session, write_model
from detangled_training.onnx_translation import Translator
from detangled_training.parameters import (
    Optimizer,
    TrainingStep,
    flatten,
    flatten_tensors,
    layout,
    restore,
    torch_optimizer,
    torch_step,
    views,
)
from detangled_training.provenance import make_folder
from detangled_training.unet import CHANNELS, CONDITIONS, UNet

BATCH = 8  # samples of a training step
DENOISER_INPUTS = ("noisy", "log_snr", "position", "condition", "known")
STEP_INPUTS = (
    "weights", "first_moment", "second_moment", "step", "learning_rate", "noisy", "clean", "log_snr", "position",
    "weight",
)  # fmt: skip
STEP_OUTPUTS = ("new_weights", "new_first_moment", "new_second_moment", "loss")

Arrays = dict[str, NDArray[Any]]


def denoiser_graph(network: UNet, cells: int) -> bytes:
    """The denoiser with its weights as the float16 initializer ``weights``."""
    slots = layout(network)

    class Prediction(torch.nn.Module):
        def forward(self, weights: Tensor, *given: Tensor) -> tuple[Tensor]:
            return (functional_call(network, views(weights.float(), slots), given),)

    weights = flatten(network).half()
    if not bool(torch.isfinite(weights).all()):
        raise ModelError("the network has weights that are not finite in float16: it cannot be exported")
    batch, sixteenth = torch.export.Dim("batch"), torch.export.Dim("part") * network.sizes.multiple
    free = ({0: batch, 2: sixteenth}, {0: batch}, {0: batch, 1: sixteenth}, {0: batch}, {0: batch})
    example = tuple(torch.from_numpy(array) for array in random_inputs(2, cells).values())
    with torch.no_grad():
        exported = torch.export.export(
            Prediction(), (weights, *example), dynamic_shapes={"weights": None, "given": free}, strict=False
        )
    translator = Translator(exported.module(check_guards=False))
    translator.run(("weights", *DENOISER_INPUTS), ("clean",))
    signal = ["batch", CHANNELS, "cells"]
    asked = ["batch", CONDITIONS]
    shapes = dict(zip(DENOISER_INPUTS, (signal, ["batch"], ["batch", "cells"], asked, asked), strict=True))
    tensor = numpy_helper.from_array(weights.numpy(), "weights")
    return serialized("denoiser", translator, shapes, {"clean": signal}, [tensor])


def training_step_graph(network: UNet, optimizer: Optimizer, batch: int, cells: int) -> bytes:
    """A step of training a network of these sizes."""
    step = TrainingStep(network.sizes, optimizer)
    given = random_step(network, batch, cells)
    traced = make_fx(step)(*(torch.from_numpy(array) for array in given.values()))
    translator = Translator(traced)
    translator.run(STEP_INPUTS, STEP_OUTPUTS)
    shapes = {name: list(array.shape) for name, array in given.items()}
    outputs = dict(zip(STEP_OUTPUTS, (shapes["weights"],) * 3 + ([],), strict=True))
    return serialized("training step", translator, shapes, outputs, [])


def random_inputs(batch: int, cells: int, seed: int = 0) -> Arrays:
    """Inputs of the denoiser, as wild as they come: log-SNRs over the schedule's range, conditions known and not."""
    rng = np.random.default_rng(seed)
    arrays = (
        rng.standard_normal((batch, CHANNELS, cells)),
        rng.uniform(-10.2, 10.2, batch),
        np.sort(rng.uniform(0.0, 1.0, (batch, cells))),
        rng.standard_normal((batch, CONDITIONS)),
        rng.integers(0, 2, (batch, CONDITIONS)),
    )
    return {name: array.astype(np.float32) for name, array in zip(DENOISER_INPUTS, arrays, strict=True)}


def random_step(network: UNet, batch: int, cells: int, seed: int = 0) -> Arrays:
    """Inputs of a first step of training, at a learning rate of 1e-3."""
    rng = np.random.default_rng(seed)
    given = random_inputs(batch, cells, seed)
    weights = flatten(network).numpy()
    none = np.zeros_like(weights)
    clean = rng.standard_normal((batch, CHANNELS, cells)).astype(np.float32)
    weight = rng.uniform(0.5, 1.5, batch).astype(np.float32)
    one, rate = np.array(1.0, np.float32), np.array(1e-3, np.float32)
    arrays = (weights, none, none, one, rate, given["noisy"], clean, given["log_snr"], given["position"], weight)
    return dict(zip(STEP_INPUTS, arrays, strict=True))


def export(
    checkpoint: Checkpoint, folder: Path, batch: int = BATCH, optimizer: Optimizer | None = None
) -> tuple[Exported, Exported]:
    """Write denoiser.onnx, training_step.onnx and a .json beside each into a folder.

    batch: samples of a training step, each of as many cells as the network was trained on.
    Raises ModelError where onnxruntime and torch differ by more than 1e-5, and does not write that model then.
    """
    make_folder(folder)
    network, cells = checkpoint.network(), checkpoint.cells
    optimizer = optimizer or Optimizer()
    # What is shipped are weights of float16: the network that is checked has just those.
    weights = checkpoint.weights.half()
    restore(network, weights.float())
    about: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "architecture": dataclasses.asdict(network.sizes),
        "parameters": len(weights),
        "whitening": dataclasses.asdict(checkpoint.whitening),
        "schedule": dataclasses.asdict(checkpoint.schedule),
        "cells": cells,
        "opset": OPSET,
        "training": checkpoint.training,
    }

    data = denoiser_graph(network, cells)
    offset = data.index(weights.numpy().tobytes())
    own = {"conditions": list(CONDITION_NAMES), "weights": {"element": "float16", "offset": offset}}
    manifest = about | {"kind": DENOISER} | own
    denoiser = write_model(folder / "denoiser.onnx", data, manifest, lambda path: _check_denoiser(path, network))

    data = training_step_graph(network, optimizer, batch, cells)
    constants = {"batch": batch, "optimizer": {"name": "AdamW", **dataclasses.asdict(optimizer)}}
    manifest = about | {"kind": TRAINING_STEP} | constants

    def check(path: Path) -> float:
        return _check_training_step(path, network, optimizer, batch, cells)

    return denoiser, write_model(folder / "training_step.onnx", data, manifest, check)


def _check_denoiser(path: Path, network: UNet) -> float:
    running = session(path)
    least = network.sizes.multiple
    differences = []
    for batch, cells in ((1, least), (3, 4 * least), (2, 9 * least)):
        given = random_inputs(batch, cells, seed=cells)
        (found,) = running.run(None, given)
        with torch.no_grad():
            wanted = network(*(torch.from_numpy(array) for array in given.values())).numpy()
        differences.append(difference("clean", found, wanted))
    return max(differences)


def _check_training_step(path: Path, network: UNet, optimizer: Optimizer, batch: int, cells: int) -> float:
    # In the middle of a training: a first step divides each gradient by its own size, be it a rounding error.
    given = random_step(network, batch, cells, seed=1)
    rng = np.random.default_rng(2)
    count = len(given["weights"])
    given["first_moment"] = (1e-3 * rng.standard_normal(count)).astype(np.float32)
    given["second_moment"] = rng.uniform(1e-6, 1e-5, count).astype(np.float32)
    given["step"] = np.array(5.0, np.float32)
    found = dict(zip(STEP_OUTPUTS, session(path).run(None, given), strict=True))

    trained = copy.deepcopy(network)
    slots = layout(trained)
    own = torch_optimizer(trained, optimizer, float(given["learning_rate"]))
    first, second = (views(torch.from_numpy(given[name].copy()), slots) for name in STEP_INPUTS[1:3])
    for name, parameter in trained.named_parameters():
        own.state[parameter] = {"step": torch.tensor(4.0), "exp_avg": first[name], "exp_avg_sq": second[name]}
    loss = torch_step(trained, own, optimizer.clip, *(torch.from_numpy(given[name]) for name in STEP_INPUTS[5:]))
    differences = [
        difference("loss", found["loss"], np.array(loss)),
        difference("new_weights", found["new_weights"], flatten(trained).numpy()),
    ]
    for name, key in (("new_first_moment", "exp_avg"), ("new_second_moment", "exp_avg_sq")):
        wanted = {parameter: own.state[value][key] for parameter, value in trained.named_parameters()}
        differences.append(difference(name, found[name], flatten_tensors(wanted, slots).numpy()))
    return max(differences)
