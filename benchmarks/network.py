"""The network in onnxruntime beside torch: one step of sampling, one step of training.

python benchmarks/network.py [--strands 256] [--cells 256] [--rounds 8] [--threads 2]

The paper-sized network with random weights is exported first, which checks that both say the same. Sampling calls the
denoiser once for all strands: onnxruntime in batches of 8, each in a thread of its own, torch in whatever batch is its
fastest. A step of training is the forward and backward pass over 8 strands, clipping and AdamW: torch's is written as
one would, by convolutions, ``clip_grad_norm_`` and ``torch.optim.AdamW``. The two take turns; the fastest round counts.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import psutil
import torch
from numpy.typing import NDArray

from detangled.diffusion.schedule import CosineSchedule
from detangled.diffusion.whitening import Whitening
from detangled_training.checkpoint import Checkpoint
from detangled_training.onnx_export import STEP_INPUTS, export, random_inputs, random_step
from detangled_training.parameters import Optimizer, flatten, torch_optimizer, torch_step
from detangled_training.unet import UNet

SEED = 1
BATCH = 8
TORCH_BATCHES = (16, 32, 64, 256)
LARGEST_SAMPLING_RATIO = 1.0
LARGEST_TRAINING_RATIO = 1.2


def random_network() -> UNet:
    """A network of the paper's size, none of whose parameters is zero."""
    torch.manual_seed(SEED)
    network = UNet()
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.02 * torch.randn_like(parameter)
    return network


def fastest(contestants: dict[str, Callable[[], Any]], rounds: int) -> dict[str, float]:
    """Seconds of each one's fastest round; they take turns, so that what else the machine does strikes all alike."""
    seconds = dict.fromkeys(contestants, np.inf)
    for _ in range(rounds + 1):
        for name, run in contestants.items():
            began = time.perf_counter()
            run()
            seconds[name] = min(seconds[name], time.perf_counter() - began)
    return seconds


def session(path: Path, threads: int) -> tuple[onnxruntime.InferenceSession, float]:
    """A session, and the seconds it took to load."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    began = time.perf_counter()
    made = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    return made, time.perf_counter() - began


def time_sampling(folder: Path, network: UNet, strands: int, cells: int, rounds: int, threads: int) -> float:
    """Print and return the ratio of onnxruntime's time to torch's."""
    denoiser, load = session(folder / "denoiser.onnx", 1)
    given = random_inputs(strands, cells, SEED)
    tensors = [torch.from_numpy(array) for array in given.values()]

    def denoise(first: int) -> NDArray[Any]:
        return np.asarray(denoiser.run(None, {k: array[first : first + BATCH] for k, array in given.items()})[0])

    def by_torch(batch: int) -> Callable[[], Any]:
        def run() -> torch.Tensor:
            with torch.no_grad():
                return torch.cat([network(*parts) for parts in zip(*(t.split(batch) for t in tensors), strict=True)])

        return run

    with ThreadPoolExecutor(threads) as pool:

        def by_onnxruntime() -> NDArray[Any]:
            return np.concatenate(list(pool.map(denoise, range(0, strands, BATCH))))

        contestants = {"onnxruntime": by_onnxruntime, **{f"torch, batch {n}": by_torch(n) for n in TORCH_BATCHES}}
        seconds = fastest(contestants, rounds)
    ours = seconds.pop("onnxruntime")
    name = min(seconds, key=seconds.__getitem__)
    print(
        f"sampling step, {strands} strands of {cells} cells   onnxruntime {1e3 * ours / strands:.2f} ms a strand   "
        f"{name} {1e3 * seconds[name] / strands:.2f} ms   ratio {ours / seconds[name]:.2f}   loaded in {load:.2f} s"
    )
    return ours / seconds[name]


def time_training(folder: Path, network: UNet, cells: int, rounds: int, threads: int) -> float:
    """Print and return the ratio of onnxruntime's time to torch's."""
    before = psutil.Process().memory_info().rss
    step, load = session(folder / "training_step.onnx", threads)
    given = random_step(network, BATCH, cells, SEED)
    samples = [torch.from_numpy(given[name]) for name in STEP_INPUTS[5:]]
    own = torch_optimizer(network, Optimizer(), float(given["learning_rate"]))
    step.run(None, given)
    memory = psutil.Process().memory_info().rss - before
    contestants: dict[str, Callable[[], Any]] = {
        "onnxruntime": lambda: step.run(None, given),
        "torch": lambda: torch_step(network, own, Optimizer().clip, *samples),
    }
    seconds = fastest(contestants, rounds)
    ratio = seconds["onnxruntime"] / seconds["torch"]
    print(
        f"training step, {BATCH} strands of {cells} cells   onnxruntime {1e3 * seconds['onnxruntime']:.0f} ms   "
        f"torch {1e3 * seconds['torch']:.0f} ms   ratio {ratio:.2f}   loaded in {load:.2f} s, {memory / 1e9:.2f} GB"
    )
    return ratio


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strands", type=int, default=256)
    parser.add_argument("--cells", type=int, default=256)
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--threads", type=int, default=min(2, os.cpu_count() or 1))
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)

    network = random_network()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        whitening = Whitening((1.0, 1.0), (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
        began = time.perf_counter()
        export(
            Checkpoint(network.sizes, flatten(network), whitening, CosineSchedule(), options.cells, {}), folder, BATCH
        )
        sizes = ", ".join(f"{path.name} {path.stat().st_size / 1e6:.2f} MB" for path in sorted(folder.glob("*.onnx")))
        parameters = json.loads((folder / "denoiser.json").read_text(encoding="utf-8"))["parameters"]
        print(
            f"{parameters:,} parameters; {sizes}; exported and checked in {time.perf_counter() - began:.0f} s; "
            f"{options.threads} threads"
        )
        sampling = time_sampling(folder, network, options.strands, options.cells, options.rounds, options.threads)
        training = time_training(folder, network, options.cells, options.rounds, options.threads)
    print(f"sampling ratio {sampling:.2f} (bound: at most {LARGEST_SAMPLING_RATIO:.1f})")
    print(f"training ratio {training:.2f} (bound: at most {LARGEST_TRAINING_RATIO:.1f})")
    return int(sampling > LARGEST_SAMPLING_RATIO or training > LARGEST_TRAINING_RATIO)


if __name__ == "__main__":
    sys.exit(main())
