"""A network of a dozen weights, exported without torch: the runtime's two models and their manifests, for tests.

It predicts, for each channel, a sum of four features, linear in its weights:

    clean = w0 alpha noisy + w1 + w2 (position - 1/2) + w3 alpha (mean of noisy over the cells given)

where alpha^2 = sigmoid(log_snr): with w0 = 1 alone, the best estimate of white noise of unit variance. What is asked
of it (1 + condition, where known) is added to all of it: a runtime that asks for nothing has to say so.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from onnx import TensorProto, numpy_helper

from detangled.diffusion.schedule import CosineSchedule
from detangled.diffusion.whitening import Whitening
from detangled.models import CONDITION_NAMES
from tiny_graph import OPSET, TinyGraph

CHANNELS, FEATURES = 3, 4
PARAMETERS = CHANNELS * FEATURES
CELLS = 64
BATCH = 4
ARCHITECTURE = {"features": FEATURES}
WHITENING = Whitening((0.7, 0.4), (0.1, 0.2, -0.3), (1.1, 1.2, 0.9))
# It starts far from any texture, so that there is something to learn; no two channels are alike.
WEIGHTS = np.array(
    [[0.5, 0.2, 0.3, 0.0625], [0.25, -0.3, 0.1, -0.125], [0.4, 0.1, -0.2, 0.03125]], dtype=np.float16
).ravel()
BETA1, BETA2, EPSILON = 0.9, 0.99, 1e-8
# A dozen weights learn in as many steps as a network's million do only if their steps are longer.
FASTER = 10.0

Floats = NDArray[np.floating[Any]]


def predicted(weights: Floats, noisy: Floats, log_snr: Floats, position: Floats) -> NDArray[np.float64]:
    """What the network predicts, (B, 3, L), by the formula above. weights: (12,); log_snr: (B,); position: (B, L)."""
    w = np.asarray(weights, dtype=np.float64).reshape(CHANNELS, FEATURES, 1)
    alpha = (1.0 / np.sqrt(1.0 + np.exp(-np.asarray(log_snr, dtype=np.float64))))[:, None, None]
    mean = noisy.mean(axis=2, keepdims=True)
    return w[:, 0] * alpha * noisy + w[:, 1] + w[:, 2] * (position[:, None] - 0.5) + w[:, 3] * alpha * mean


def export_tiny(folder: Path, architecture: dict[str, Any] | None = None, weights: Floats = WEIGHTS) -> Path:
    """Write denoiser.onnx, training_step.onnx and a manifest beside each into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    stored = weights.astype(np.float16)
    denoiser, step = _denoiser(stored), _training_step()
    about: dict[str, Any] = {
        "format": "detangled model",
        "version": 1,
        "architecture": architecture or ARCHITECTURE,
        "parameters": PARAMETERS,
        "whitening": asdict(WHITENING),
        "schedule": asdict(CosineSchedule()),
        "cells": CELLS,
        "opset": OPSET,
        "training": {"data": "none"},
    }
    offset = denoiser.index(stored.tobytes())
    kept = {"element": "float16", "offset": offset}
    for name, data, own in (
        ("denoiser", denoiser, {"kind": "denoiser", "weights": kept, "conditions": list(CONDITION_NAMES)}),
        ("training_step", step, {"kind": "training step", "batch": BATCH}),
    ):
        (folder / f"{name}.onnx").write_bytes(data)
        manifest = about | own | {"sha256": hashlib.sha256(data).hexdigest()}
        (folder / f"{name}.json").write_text(json.dumps(manifest, indent=2), encoding="utf-8")
    return folder


class _Graph(TinyGraph):
    """What both models have."""

    def features(self) -> str:
        """The features (B, 3, 4, L) of noisy, log_snr and position."""
        alpha = self.do("Unsqueeze", self.do("Sqrt", self.do("Sigmoid", "log_snr")), self.axes(1, 2))
        gated = self.do("Mul", alpha, "noisy")
        shape = self.do("Shape", "noisy")
        along = self.do("Unsqueeze", self.do("Sub", "position", self.constant(0.5)), self.axes(1))
        all_of_them = (
            gated,
            self.do("Expand", self.constant(1.0), shape),
            self.do("Expand", along, shape),
            self.do("Expand", self.do("ReduceMean", gated, self.axes(2)), shape),
        )
        return self.do("Concat", *(self.do("Unsqueeze", x, self.axes(2)) for x in all_of_them), axis=2)

    def prediction(self, weights: str, features: str) -> str:
        """Clean signals (B, 3, L) by weights (12,)."""
        w = self.do("Reshape", weights, self.constant((1, CHANNELS, FEATURES, 1), np.int64))
        return self.do("ReduceSum", self.do("Mul", w, features), self.axes(2), keepdims=0)


def _denoiser(weights: NDArray[np.float16]) -> bytes:
    g = _Graph()
    unasked = g.prediction(g.do("Cast", "weights", to=TensorProto.FLOAT), g.features())
    wished = g.do("Mul", g.do("Add", "condition", g.constant(1.0)), "known")
    added = g.do("ReduceSum", wished, g.axes(1), keepdims=1)
    g.do("Add", unasked, g.do("Unsqueeze", added, g.axes(2)), output="clean")
    signal = ["batch", CHANNELS, "cells"]
    inputs = {"noisy": signal, "log_snr": ["batch"], "position": ["batch", "cells"]}
    asked = ["batch", len(CONDITION_NAMES)]
    inputs |= {"condition": asked, "known": asked}
    return g.serialized("denoiser", inputs, {"clean": signal}, [numpy_helper.from_array(weights, "weights")])


def _training_step() -> bytes:
    """A step of Adam (Kingma and Ba 2015). Linear in the weights, the gradient is the error's mean over a feature."""
    g = _Graph()
    features = g.features()
    error = g.do("Sub", g.prediction("weights", features), "clean")
    each = g.do("ReduceMean", g.do("Mul", error, error), g.axes(1, 2), keepdims=0)
    g.do("ReduceMean", g.do("Mul", "weight", each), keepdims=0, output="loss")

    weighed = g.do("Mul", error, g.do("Unsqueeze", "weight", g.axes(1, 2)))
    products = g.do("Mul", g.do("Unsqueeze", weighed, g.axes(2)), features)
    total = g.do("ReduceSum", products, g.axes(0, 3), keepdims=0)
    flat = g.do("Reshape", total, g.constant((PARAMETERS,), np.int64))
    gradient = g.do("Mul", flat, g.constant(2.0 / (BATCH * CHANNELS * CELLS)))

    def moment(old: str, new: str, beta: float, output: str) -> tuple[str, str]:
        """The running mean, and the same freed of its start at zero."""
        kept, added = g.do("Mul", old, g.constant(beta)), g.do("Mul", new, g.constant(1.0 - beta))
        mean = g.do("Add", kept, added, output=output)
        return mean, g.do("Div", mean, g.do("Sub", g.constant(1.0), g.do("Pow", g.constant(beta), "step")))

    _, first = moment("first_moment", gradient, BETA1, "new_first_moment")
    _, second = moment("second_moment", g.do("Mul", gradient, gradient), BETA2, "new_second_moment")
    direction = g.do("Div", first, g.do("Add", g.do("Sqrt", second), g.constant(EPSILON)))
    rate = g.do("Mul", "learning_rate", g.constant(FASTER))
    g.do("Sub", "weights", g.do("Mul", rate, direction), output="new_weights")

    vector, signal = [PARAMETERS], [BATCH, CHANNELS, CELLS]
    inputs = {name: vector for name in ("weights", "first_moment", "second_moment")}
    inputs |= {"step": [], "learning_rate": [], "noisy": signal, "clean": signal}
    inputs |= {"log_snr": [BATCH], "position": [BATCH, CELLS], "weight": [BATCH]}
    outputs = {name: vector for name in ("new_weights", "new_first_moment", "new_second_moment")} | {"loss": []}
    return g.serialized("training step", inputs, outputs)
