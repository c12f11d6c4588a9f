"""Data sets of variants that are faked: signals that say which strand they are of."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detangled_training import dataset
from detangled_training.dataset import SHARD, Make, write_dataset
from detangled_training.variants import VariantOptions

OPTIONS = VariantOptions(hung=2, cells=4)
COUNT = 2 * SHARD + 300  # three shards, the last a short one
SEED = 3


def make(first: int, count: int, seed: int, options: VariantOptions) -> tuple[NDArray[np.float32], dict[str, Any]]:
    """Variants that say which they are; of every seventh strand one is missing."""
    numbers = np.arange(first, first + count)
    base = np.repeat(numbers, options.hung or 1)
    variant = np.tile(np.arange(options.hung or 1), count)
    there = (base % 7 != 0) | (variant != 1)
    base, variant = base[there], variant[there]
    cells = np.arange(options.cells * 3).reshape(options.cells, 3)
    signals = (base[:, None, None] + 0.25 * variant[:, None, None] + 1e-3 * cells + seed).astype(np.float32)
    position = np.stack([np.zeros(len(base)), base / 1e4], axis=1)
    return signals, {"base": base, "variant": variant.astype(np.int8), "radius": base * 0.5, "position": position}


def make_slowly(first: int, count: int, seed: int, options: VariantOptions) -> tuple[NDArray[np.float32], Any]:
    """The first shard is there at once, for others one waits longer than a test takes."""
    if first:
        time.sleep(600.0)
    return make(first, count, seed, options)


def make_and_die(first: int, count: int, seed: int, options: VariantOptions) -> tuple[NDArray[np.float32], Any]:
    """Like a process that is killed for its memory."""
    if first:
        os._exit(9)
    return make(first, count, seed, options)


def wrongly(signals: Any = None, **columns: Any) -> Make:
    """Makes what is no shard: other signals, or other columns."""

    def made(first: int, count: int, seed: int, options: VariantOptions) -> tuple[NDArray[np.float32], Any]:
        values, labels = make(first, count, seed, options)
        return (values if signals is None else signals(values)), {**labels, **columns}

    return made


def stopping(after: int, error: BaseException) -> Make:
    """``make`` that ends in an error in the midst of the shard after so many."""
    calls = []

    def made(first: int, count: int, seed: int, options: VariantOptions) -> tuple[NDArray[np.float32], Any]:
        calls.append(first)
        if len(calls) > after:
            raise error
        return make(first, count, seed, options)

    return made


def write(folder: Path, count: int = COUNT, **asked: Any) -> dataset.Written:
    return write_dataset(folder, count, **{"seed": SEED, "options": OPTIONS, "workers": 1, "make": make, **asked})


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}
