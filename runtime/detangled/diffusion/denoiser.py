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
LENGTH = CONDITION_NAMES.index("log length")
LEAST_OVERLAP = 0.25  # of neighbouring windows: four turns of the grid that fitting uses


class NetworkDenoiser:
    """Predicts clean signals (B, 3, L) of noisy ones; L must be a multiple of 16.

    weights: (P,) float16, the model's own where None. threads: batches worked on at once.
    """

    def __init__(self, model: Model, weights: NDArray[np.float16] | None = None, threads: int = 1) -> None:
        self._session = model.session(1, weights)
        self._window = model.cells
        self._threads = threads

    def __call__(
        self, noisy: NDArray[np.float64], alpha: float, sigma: float, condition: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """condition: (B, C), what is asked of each strand, by CONDITION_NAMES; NaN, or None, where nothing is."""
        strands, _, cells = noisy.shape
        pieces, starts = windows(noisy, self._window)
        size = pieces.shape[2]
        position = np.tile((starts[:, None] + np.arange(size) + 0.5) / cells, (strands, 1))
        asked = np.full((strands, len(CONDITION_NAMES)), np.nan) if condition is None else condition.copy()
        asked[:, LENGTH] += np.log(size / cells)  # a window is told its own length
        asked = np.repeat(asked, len(starts), axis=0)
        log_snr = 2.0 * np.log(alpha / sigma)
        rows = [slice(first, first + BATCH) for first in range(0, len(pieces), BATCH)]
        with ThreadPoolExecutor(self._threads) as pool:
            found = list(pool.map(lambda part: self._run(pieces[part], position[part], asked[part], log_snr), rows))
        return blended(np.concatenate(found).astype(np.float64), starts, strands, cells)

    def _run(
        self, noisy: NDArray[np.float64], position: NDArray[np.float64], asked: NDArray[np.float64], log_snr: float
    ) -> NDArray[np.float32]:
        count = len(noisy)
        padding = BATCH - count
        # Beyond float32 there is nothing to predict; whoever asked finds no finite answer.
        with np.errstate(over="ignore"):
            narrow = np.pad(noisy, ((0, padding), (0, 0), (0, 0))).astype(np.float32)
        given = {
            "noisy": narrow,
            "log_snr": np.full(BATCH, log_snr, dtype=np.float32),
            "position": np.pad(position, ((0, padding), (0, 0))).astype(np.float32),
            "condition": np.pad(np.nan_to_num(asked), ((0, padding), (0, 0))).astype(np.float32),
            "known": np.pad(np.isfinite(asked), ((0, padding), (0, 0))).astype(np.float32),
        }
        (clean,) = self._session.run(None, given)
        return np.asarray(clean[:count])


def windows(channels: NDArray[np.float64], size: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Windows (B * W, C, size) of signals (B, C, L), those of a strand one after another, and their first cells (W,).

    One window, of all L cells, where they are no more than ``size``.
    """
    _, count, cells = channels.shape
    size = min(cells, size)
    starts = window_starts(cells, size)
    pieces = np.stack([channels[:, :, a : a + size] for a in starts], axis=1)
    return pieces.reshape(-1, count, size), starts


def blended(pieces: NDArray[np.float64], starts: NDArray[np.int64], strands: int, cells: int) -> NDArray[np.float64]:
    """Signals (B, C, L) of windows (B * W, C, size) that ``windows`` tells of: their means where they overlap."""
    _, count, size = pieces.shape
    pieces = pieces.reshape(strands, len(starts), count, size)
    if len(starts) == 1:
        return pieces[:, 0]
    share = blend_weights(size)
    total = np.zeros(cells)
    out = np.zeros((strands, count, cells))
    for k, a in enumerate(starts):
        out[:, :, a : a + size] += share * pieces[:, k]
        total[a : a + size] += share
    return out / total


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
