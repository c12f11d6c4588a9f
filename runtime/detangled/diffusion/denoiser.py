"""The network that predicts the clean signal, run by onnxruntime: the paper's engine.

The network was trained on signals of some hundred cells. A longer strand is shown to it in windows of as many cells
that overlap, each told which part of the strand it is; predictions are blended where windows overlap, at every step
(Bar-Tal et al. 2023, "MultiDiffusion"), so that the strand is one.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from detangled.models import CONDITION_NAMES, Model

# One size of batch for all calls, each on one thread: what a strand becomes depends on neither.
BATCH = 8
LEAST_OVERLAP = 0.25  # of neighbouring windows: four turns of the grid that fitting uses


class NetworkDenoiser:
    """Predicts clean signals (B, 3, L) of noisy ones; L must be a multiple of 16.

    weights: (P,) float16, the model's own where None. threads: batches worked on at once.
    """

    def __init__(self, model: Model, weights: NDArray[np.float16] | None = None, threads: int = 1) -> None:
        self._session = model.session(1, weights)
        self._window = model.cells
        self._threads = threads

    def __call__(self, noisy: NDArray[np.float64], alpha: float, sigma: float) -> NDArray[np.float64]:
        strands, channels, cells = noisy.shape
        size = min(cells, self._window)
        starts = window_starts(cells, size)
        at = (starts[:, None] + np.arange(size) + 0.5) / cells
        pieces = np.stack([noisy[:, :, a : a + size] for a in starts], axis=1).reshape(-1, channels, size)
        position = np.tile(at, (strands, 1))
        log_snr = 2.0 * np.log(alpha / sigma)
        first = range(0, len(pieces), BATCH)
        with ThreadPoolExecutor(self._threads) as pool:
            found = list(pool.map(lambda a: self._run(pieces[a : a + BATCH], position[a : a + BATCH], log_snr), first))
        predicted = np.concatenate(found).reshape(strands, len(starts), channels, size)
        if len(starts) == 1:
            return predicted[:, 0].astype(np.float64)
        share = blend_weights(size)
        total = np.zeros(cells)
        out = np.zeros(noisy.shape)
        for k, a in enumerate(starts):
            out[:, :, a : a + size] += share * predicted[:, k]
            total[a : a + size] += share
        return out / total

    def _run(self, noisy: NDArray[np.float64], position: NDArray[np.float64], log_snr: float) -> NDArray[np.float32]:
        count = len(noisy)
        padding = BATCH - count
        # Beyond float32 there is nothing to predict; whoever asked finds no finite answer.
        with np.errstate(over="ignore"):
            narrow = np.pad(noisy, ((0, padding), (0, 0), (0, 0))).astype(np.float32)
        given = {
            "noisy": narrow,
            "log_snr": np.full(BATCH, log_snr, dtype=np.float32),
            "position": np.pad(position, ((0, padding), (0, 0))).astype(np.float32),
            "condition": np.zeros((BATCH, len(CONDITION_NAMES)), dtype=np.float32),
            "known": np.zeros((BATCH, len(CONDITION_NAMES)), dtype=np.float32),
        }
        (clean,) = self._session.run(None, given)
        return np.asarray(clean[:count])


def window_starts(cells: int, size: int) -> NDArray[np.int64]:
    """First cells (W,) of windows of ``size`` cells that cover a strand, overlapping by LEAST_OVERLAP or more."""
    if cells <= size:
        return np.zeros(1, dtype=np.int64)
    count = 1 + int(np.ceil((cells - size) / ((1.0 - LEAST_OVERLAP) * size)))
    return np.round(np.linspace(0, cells - size, count)).astype(np.int64)


def blend_weights(size: int) -> NDArray[np.float64]:
    """How much a prediction counts at each cell of its window, (size,): less towards the window's ends."""
    inside = np.minimum(np.arange(size) + 0.5, size - 0.5 - np.arange(size))
    return np.minimum(inside / (LEAST_OVERLAP * size), 1.0)
