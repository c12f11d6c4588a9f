"""A labeler so small that its labels have a formula, written as ONNX without torch.

It tells what the helix equations say of the means of kappa and tau over a signal, and as twist a sigmoid of the mean
speed.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from detangled.labeling import CELLS
from detangled.models import FILES, LABELER, LABELER_GRADIENT
from tiny_graph import OPSET, TinyGraph

BATCH = 4
LEAST = 1e-6  # [1/cm^2] of kappa^2 + tau^2
SLOPE = 0.25  # of the twist by the mean speed

Floats = NDArray[np.float64]


def told(values: Floats) -> Floats:
    """What the tiny labeler says of signals (B, CELLS, 3), (B, 3), by its formula."""
    kappa, tau, v = np.asarray(values, dtype=np.float64).mean(axis=1).T
    total = kappa**2 + tau**2 + LEAST
    twist = 1.0 / (1.0 + np.exp(-SLOPE * v))
    return np.stack([kappa / total, 2.0 * np.pi * np.abs(tau) / total, twist], axis=1)


def slopes(values: Floats, weights: Floats) -> Floats:
    """The gradient (B, CELLS, 3) of those labels' sum by weights (B, 3)."""
    kappa, tau, v = np.asarray(values, dtype=np.float64).mean(axis=1).T
    total = kappa**2 + tau**2 + LEAST
    twist = 1.0 / (1.0 + np.exp(-SLOPE * v))
    a, b, c = np.asarray(weights).T
    sign = np.sign(tau)
    by_kappa = a * (1.0 / total - 2.0 * kappa**2 / total**2) - b * 4.0 * np.pi * np.abs(tau) * kappa / total**2
    by_tau = -a * 2.0 * kappa * tau / total**2 + b * sign * (2.0 * np.pi / total - 4.0 * np.pi * tau**2 / total**2)
    by_v = c * SLOPE * twist * (1.0 - twist)
    each = np.stack([by_kappa, by_tau, by_v], axis=1) / CELLS
    return np.repeat(each[:, None], CELLS, axis=1)


class Graph(TinyGraph):
    """What both models have."""

    def column(self, of: str, k: int) -> str:
        return self.do("Gather", of, self.constant([k], np.int64), axis=1)

    def labels(self) -> tuple[str, str, str, str, str]:
        """kappa, tau, their total, the labels (B, 3) and the twist, (B, 1) each."""
        mean = self.do("ReduceMean", "signals", self.constant([1], np.int64), keepdims=0)
        kappa, tau, v = (self.column(mean, k) for k in range(3))
        squares = self.do("Add", self.do("Mul", kappa, kappa), self.do("Mul", tau, tau))
        total = self.do("Add", squares, self.constant(LEAST))
        radius = self.do("Div", kappa, total)
        turn = self.do("Mul", self.do("Abs", tau), self.constant(2.0 * np.pi))
        twist = self.do("Sigmoid", self.do("Mul", v, self.constant(SLOPE)))
        self.do("Concat", radius, self.do("Div", turn, total), twist, axis=1, output="labels")
        return kappa, tau, total, "labels", twist

    def gradient(self, kappa: str, tau: str, total: str, twist: str) -> None:
        a, b, c = (self.column("weights", k) for k in range(3))

        def times(*factors: str) -> str:
            made = factors[0]
            for factor in factors[1:]:
                made = self.do("Mul", made, factor)
            return made

        two, turn = self.constant(2.0), self.constant(2.0 * np.pi)
        one_over = self.do("Reciprocal", total)
        square = times(one_over, one_over)
        size, sign = self.do("Abs", tau), self.do("Sign", tau)
        by_kappa = self.do(
            "Sub",
            times(a, self.do("Sub", one_over, times(two, kappa, kappa, square))),
            times(b, two, turn, size, kappa, square),
        )
        by_tau = self.do(
            "Sub",
            times(b, sign, turn, self.do("Sub", one_over, times(two, tau, tau, square))),
            times(a, two, kappa, tau, square),
        )
        rest = self.do("Sub", self.constant(1.0), twist)
        by_v = times(c, self.constant(SLOPE), twist, rest)
        each = self.do("Div", self.do("Concat", by_kappa, by_tau, by_v, axis=1), self.constant(float(CELLS)))
        wide = self.do("Unsqueeze", each, self.constant([1], np.int64))
        self.do("Expand", wide, self.constant([BATCH, CELLS, 3], np.int64), output="gradient")


def write_tiny(folder: Path) -> Path:
    """Write both tiny models, and a manifest beside each, into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    signal, row = [BATCH, CELLS, 3], [BATCH, 3]
    plain, steep = Graph(), Graph()
    plain.labels()
    kappa, tau, total, _, twist = steep.labels()
    steep.gradient(kappa, tau, total, twist)
    models = {
        LABELER: plain.serialized("labeler", {"signals": signal}, {"labels": row}),
        LABELER_GRADIENT: steep.serialized(
            "labeler gradient", {"signals": signal, "weights": row}, {"labels": row, "gradient": signal}
        ),
    }
    for kind, data in models.items():
        path = folder / FILES[kind]
        path.write_bytes(data)
        manifest = {
            "format": "detangled model",
            "version": 1,
            "kind": kind,
            "architecture": {"tiny": 1},
            "parameters": 1,
            "cells": CELLS,
            "batch": BATCH,
            "opset": OPSET,
            "sha256": hashlib.sha256(data).hexdigest(),
            "training": {"data": "none"},
        }
        path.with_suffix(".json").write_text(json.dumps(manifest), encoding="utf-8")
    return folder
