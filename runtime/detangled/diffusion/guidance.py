"""Guidance: what the network predicts is moved until the labelers read in it what is asked for.

Paper, section "Texture Editing": at each step of the sampler the predicted clean signal is labelled, and moved against
the gradient of how far its labels are off. Here it is moved along a few modes that leave a strand hair: all of its
curvature more or less, all of its torsion, and how far each departs from its mean over a turn, which is what twists do.
A step is one of Gauss and Newton, damped by how sure a label is (Levenberg 1944, "A Method for the Solution of Certain
Non-Linear Problems in Least Squares"): it goes as far as it should, where a free gradient finds what fools a labeler.
The labels' derivatives come from the labelers' exported gradients, or from finite differences along the same modes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.diffusion.denoiser import blended, windows
from detangled.errors import ModelError
from detangled.labeling import CELLS, LabelGradient, LabelNetwork

LABELS, MODES = 3, 4
# Deviations of the modes' factors among strands of one texture, and the most that a factor is in one step.
SPREAD = np.array([1.0, 1.0, 0.5, 0.5])
MOST = 0.3
# How far off a label may as well be: logarithms of radius and wavelength, and T_f.
SURE = np.array([0.01, 0.01, 0.03])
LEAST_SIZE = 1e-3  # [cm] of radius and wavelength, where they are read
DIFFERENCE = 0.02  # of a mode's factor
CHUNK = 256  # windows that are read at once: some tens of megabytes

REFRESHED = 4  # calls after which derivatives are taken anew: they hardly change from step to step

# (signals (N, CELLS, 3), modes (N, MODES, CELLS, 2)) -> derivatives (N, 3, MODES) of the labels by the modes' factors.
Derivatives = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class Guidance:
    """Moves signals to where they are read as wanted.

    wanted: (3,), logarithms of radius and wavelength [cm], and T_f; NaN where anything will do. turn: arc length [cm]
    of a turn. derivatives: of the labels that ``labeler`` tells, of radius and wavelength the logarithms'.
    """

    wanted: NDArray[np.float64]
    turn: float
    labeler: LabelNetwork
    derivatives: Derivatives

    def begin(self) -> GuidedBatch:
        """Guidance of one batch of strands through the steps of the sampler."""
        return GuidedBatch(self)


class GuidedBatch:
    """A batch of strands on its way."""

    def __init__(self, guidance: Guidance) -> None:
        self._guidance = guidance
        self._derivatives = np.empty((0, LABELS, MODES))
        self._calls = 0

    def __call__(self, values: NDArray[np.float64], counted: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Signals (B, L, 3) of kappa, tau, v, moved; ``counted``: (3,), which labels are guided.

        L must be CELLS or more: longer ones are read in windows. Raises ModelError where labels are not finite.
        """
        strands, cells, _ = values.shape
        channels, starts = windows(values.transpose(0, 2, 1), CELLS)
        pieces = channels.transpose(0, 2, 1).copy()
        pieces[:, :, 2] *= CELLS / cells
        if self._calls % REFRESHED == 0:
            self._derivatives = np.empty((len(pieces), LABELS, MODES))
        moved = np.empty((len(pieces), 2, CELLS))
        for first in range(0, len(pieces), CHUNK):
            part = slice(first, first + CHUNK)
            moved[part] = self._moved(pieces[part], part, counted & np.isfinite(self._guidance.wanted))
        self._calls += 1
        out = values.copy()
        out[:, :, :2] += blended(moved, starts, strands, cells).transpose(0, 2, 1)
        out[:, :, 0] = np.maximum(out[:, :, 0], 0.0)
        return out

    def _moved(self, pieces: NDArray[np.float64], part: slice, counted: NDArray[np.bool_]) -> NDArray[np.float64]:
        """By how much kappa and tau (N, 2, CELLS) of some windows (N, CELLS, 3) are moved."""
        guidance = self._guidance
        directions = modes(pieces, guidance.turn)
        if self._calls % REFRESHED == 0:
            self._derivatives[part] = guidance.derivatives(pieces, directions)
        labels = logarithmic(guidance.labeler(pieces))
        if not (np.isfinite(labels).all() and np.isfinite(self._derivatives[part]).all()):
            raise ModelError(
                "the labelers read numbers that are not finite: install detangled again, or export them anew"
            )
        missing = np.where(counted, guidance.wanted - labels, 0.0)
        derivatives = np.where(counted[:, None], self._derivatives[part], 0.0)
        factors = damped_step(derivatives, missing)
        return (factors[:, :, None, None] * directions).sum(axis=1).transpose(0, 2, 1)


def damped_step(
    derivatives: NDArray[np.float64], missing: NDArray[np.float64], sure: NDArray[np.float64] = SURE
) -> NDArray[np.float64]:
    """Factors (N, MODES) that make up for what labels (N, 3) miss, by their derivatives (N, 3, MODES).

    sure: (3,), deviations that labels may have all the same.
    """
    spread = derivatives * SPREAD**2
    between = (spread[:, :, None, :] * derivatives[:, None, :, :]).sum(axis=3) + np.diag(sure**2)
    solved = np.linalg.solve(between, missing[:, :, None])[:, :, 0]
    return np.clip((spread * solved[:, :, None]).sum(axis=1), -MOST, MOST)


def modes(values: NDArray[np.float64], turn: float) -> NDArray[np.float64]:
    """Directions (N, MODES, L, 2) in kappa and tau that signals (N, L, 3) are moved along; ``turn`` in cm of arc."""
    count, cells, _ = values.shape
    half = np.maximum(np.round(0.5 * turn * cells / values[:, :, 2].mean(axis=1)), 1.0).astype(np.int64)
    out = np.zeros((count, MODES, cells, 2))
    for channel in range(2):
        signal = values[:, :, channel]
        out[:, channel, :, channel] = signal
        out[:, 2 + channel, :, channel] = signal - _running_means(signal, half)
    return out


def _running_means(signal: NDArray[np.float64], half: NDArray[np.int64]) -> NDArray[np.float64]:
    """Means (N, L) over ``half`` (N,) cells to either side, as far as there are any."""
    cells = signal.shape[1]
    total = np.concatenate([np.zeros((len(signal), 1)), np.cumsum(signal, axis=1)], axis=1)
    at = np.arange(cells)
    low, high = np.maximum(at - half[:, None], 0), np.minimum(at + half[:, None] + 1, cells)
    return (np.take_along_axis(total, high, 1) - np.take_along_axis(total, low, 1)) / (high - low)


def by_gradients(gradient: LabelGradient) -> Derivatives:
    """Derivatives by the labelers' exported gradients."""

    def derivatives(values: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.float64]:
        rows = []
        for one in np.eye(LABELS):
            labels, by_signal = gradient(values, np.tile(one, (len(values), 1)))
            rows.append((by_signal[:, None, :, :2] * directions).sum(axis=(2, 3)))
        out = np.stack(rows, axis=1)
        out[:, :2] /= np.maximum(labels[:, :2], LEAST_SIZE)[:, :, None]
        return out

    return derivatives


def by_differences(labeler: LabelNetwork) -> Derivatives:
    """Derivatives by finite differences."""

    def derivatives(values: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.float64]:
        labels = logarithmic(labeler(values))
        columns = []
        for mode in range(MODES):
            moved = values.copy()
            moved[:, :, :2] += DIFFERENCE * directions[:, mode]
            columns.append((logarithmic(labeler(moved)) - labels) / DIFFERENCE)
        return np.stack(columns, axis=2)

    return derivatives


def logarithmic(labels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Labels (N, 3), radius, wavelength [cm] and T_f, of the first two the logarithms."""
    out = labels.copy()
    out[:, :2] = np.log(np.maximum(labels[:, :2], LEAST_SIZE))
    return out
