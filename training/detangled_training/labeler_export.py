"""Labelers as ONNX: one graph that tells labels, one that tells their gradient as well, a manifest beside each.

onnxruntime has no derivatives, so the second graph is traced with its own: labels (B, 3) and, for weights (B, 3), the
gradient of their weighted sum by the signals (B, CELLS, 3) of strands that lie as in canonical space, as those do that
are guided. Both take a batch of one size.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch._decomp import get_decompositions
from torch.fx.experimental.proxy_tensor import make_fx

from detangled.errors import ModelError
from detangled.labeling import CELLS, WORLD
from detangled.models import FILES, FORMAT, LABELER, LABELER_GRADIENT, VERSION
from detangled_training.labeler import Labeler, LabelerSizes
from detangled_training.labeler_training import read_labelers
from detangled_training.onnx_files import OPSET, Exported, difference, serialized, session, write_model
from detangled_training.onnx_translation import Translator
from detangled_training.provenance import make_folder

BATCH = 64  # signals at once: fewer would leave the loops over their cells idle
LABELS = 3  # radius, wavelength [cm], twist
CHECKED = 8  # batches
# Of a gradient, beside its largest: in float32 it is known no better, by torch either.
GRADIENT_TOLERANCE = 1e-3
_aten = torch.ops.aten
_DECOMPOSED = (
    _aten.native_layer_norm_backward,
    _aten.threshold_backward,
    _aten.sigmoid_backward,
    _aten.tanh_backward,
)


def export_labelers(checkpoint: Path, folder: Path, batch: int = BATCH) -> tuple[Exported, Exported]:
    """Write labeler.onnx, labeler_gradient.onnx and a .json beside each into a folder.

    Raises ModelError where onnxruntime and torch differ by more than 1e-5 in labels, or 1e-3 in gradients, and does
    not write that model then.
    """
    make_folder(folder)
    stored = read_labelers(checkpoint)
    network = labelers(stored)
    about: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "architecture": dataclasses.asdict(network.sizes),
        "parameters": sum(parameter.numel() for parameter in network.parameters()),
        "cells": CELLS,
        "batch": batch,
        "opset": OPSET,
        "training": stored["report"],
    }

    def check(path: Path) -> float:
        return _check(path, network, batch)

    data = labeler_graph(network, batch)
    first = write_model(folder / FILES[LABELER], data, about | {"kind": LABELER}, check)
    data = gradient_graph(network, batch)
    return first, write_model(folder / FILES[LABELER_GRADIENT], data, about | {"kind": LABELER_GRADIENT}, check)


def labelers(stored: dict[str, Any]) -> Labeler:
    """The network of a checkpoint, its weights those of float16, as they are shipped."""
    try:
        network = Labeler(LabelerSizes(**stored["options"]["sizes"]))
        network.load_state_dict(stored["network"])
    except (RuntimeError, TypeError, KeyError) as error:
        raise ModelError(f"a checkpoint of labelers of another version, or damaged ({error})") from error
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(parameter.half().float())
    network.requires_grad_(False)
    return network.eval()


def stacked(network: Labeler, signals: Tensor) -> Tensor:
    """Radius, wavelength and twist (B, 3)."""
    found = network(signals)
    return torch.stack([found.radius, found.wavelength, found.twist], dim=1)


def with_gradient(network: Labeler, signals: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Labels (B, 3), and the gradient of their sum by weights (B, 3)."""
    with torch.enable_grad():
        own = signals.detach().requires_grad_()
        labels = stacked(network, own)
        (gradient,) = torch.autograd.grad((labels * weights).sum(), own)
    return labels.detach(), gradient


def labeler_graph(network: Labeler, batch: int) -> bytes:
    """The labels alone."""
    signals = torch.from_numpy(with_world(batch))
    translator = _translated(lambda x: (stacked(network, x),), network, (signals,), ("signals",), ("labels",))
    return serialized("labeler", translator, {"signals": list(signals.shape)}, {"labels": [batch, LABELS]}, [])


def gradient_graph(network: Labeler, batch: int) -> bytes:
    """Labels and gradient."""
    given = torch.from_numpy(random_signals(batch)), torch.ones(batch, LABELS)
    translator = _translated(
        lambda x, w: with_gradient(network, x, w), network, given, ("signals", "weights"), ("labels", "gradient")
    )
    signal = [batch, CELLS, 3]
    inputs = {"signals": signal, "weights": [batch, LABELS]}
    return serialized("labeler gradient", translator, inputs, {"labels": [batch, LABELS], "gradient": signal}, [])


def random_signals(count: int, seed: int = 0) -> NDArray[np.float32]:
    """Signals of coils of all sizes (B, CELLS, 3), disturbed here and there, float32."""
    rng = np.random.default_rng(seed)
    rate = np.exp(rng.uniform(np.log(0.2), np.log(8.0), (count, 1, 1)))
    pitch = rng.uniform(-1.4, 1.4, (count, 1))
    values = np.empty((count, CELLS, 3))
    values[:, :, 0], values[:, :, 1] = np.cos(pitch), np.sin(pitch)
    values[:, :, :2] *= rate
    twisted = rng.uniform(size=(count, CELLS)) < rng.uniform(0.0, 0.15, (count, 1))
    values[:, :, 1] += np.where(twisted, rng.uniform(-3.0, 3.0, (count, CELLS)) * 4.0 * rate[:, :, 0], 0.0)
    values[:, :, 0] *= np.exp(0.2 * rng.standard_normal((count, CELLS)))
    values[:, :, 2] = rng.uniform(0.3, 1.0, (count, 1)) * CELLS * 0.4 / rate[:, :, 0]
    return values.astype(np.float32)


def with_world(count: int, seed: int = 0) -> NDArray[np.float32]:
    """Random signals (B, CELLS, 5) of strands that lie somewhat otherwise in the world."""
    signals = random_signals(count, seed)
    stretched = np.exp(0.3 * np.random.default_rng(seed + 1).standard_normal((count, CELLS, WORLD)))
    return np.concatenate([signals, signals[:, :, :WORLD] * stretched.astype(np.float32)], axis=2)


def _translated(
    function: Any, network: Labeler, given: tuple[Tensor, ...], inputs: tuple[str, ...], outputs: tuple[str, ...]
) -> Translator:
    network.twist.lstm.traceable = True
    try:
        table: Any = get_decompositions(_DECOMPOSED)
        traced = make_fx(function, decomposition_table=table)(*given)
    finally:
        network.twist.lstm.traceable = False
    translator = Translator(traced)
    translator.run(inputs, outputs)
    return translator


def _check(path: Path, network: Labeler, batch: int) -> float:
    running = session(path)
    channels = running.get_inputs()[0].shape[2]
    names = [value.name for value in running.get_inputs()]
    outputs = [value.name for value in running.get_outputs()]
    differences = []
    for k in range(CHECKED):
        signals = with_world(batch, seed=k + 1)[:, :, :channels]
        # Labels of one size, whatever the strand's, so that one tolerance suits all of them.
        with torch.no_grad():
            labels = stacked(network, torch.from_numpy(signals)).numpy()
        size = np.maximum(np.abs(labels), [1e-3, 1e-3, 1.0]).astype(np.float32)
        given = dict(zip(names, (signals, 1.0 / size), strict=False))
        found = dict(zip(outputs, running.run(None, given), strict=True))
        differences.append(difference("labels", found["labels"] / size, labels / size))
        if "gradient" in found:
            _, wanted = with_gradient(network, torch.from_numpy(signals), torch.from_numpy(1.0 / size))
            scale = np.abs(wanted.numpy()).max(axis=(1, 2), keepdims=True)
            differences.append(
                difference("gradient", found["gradient"] / scale, wanted.numpy() / scale, GRADIENT_TOLERANCE)
            )
    return max(differences)
