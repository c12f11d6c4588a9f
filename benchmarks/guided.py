"""Guided generation: where its time goes, beside torch, and its memory.

python benchmarks/guided.py [--strands 1000] [--beside 128] [--many 4000]

Strands of type VI, 24 cm each on 256 cells, are drawn in 20 steps by ``--method both``: the network is told the numbers
and guided to them. Printed are the total time, the shares of the denoiser and of the labelers, strands a second by how
many are drawn at once, and the same sampler and guidance with both networks run by torch (``--beside`` strands, taking
turns; bound: at most its time). The labelers that torch runs have random weights, which takes the same time. Then
processes of their own generate 1,000 and ``--many`` strands in two steps, and their peak memory is printed less that of
the strands themselves. Exits 1 where a bound fails.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from detangled import engines
from detangled.diffusion.guidance import LEAST_SIZE, Derivatives
from detangled.from_network import network_texture
from detangled.generation import generate
from detangled.kernels import set_threads
from detangled.models import DENOISER, load_model
from detangled.numbered import BOTH
from detangled.synthesis import synthesise
from detangled.texture import hair_type
from detangled_training.checkpoint import architecture_of
from detangled_training.labeler import Labeler
from detangled_training.parameters import restore
from detangled_training.unet import UNet

LENGTH = 24.0  # [cm]
AT_ONCE = (1, 8, 64, 256)
TORCH_BATCH = 32
LARGEST_RATIO = 1.0
FEW, FEW_STEPS = 1000, 2
MOST_GROWTH = 0.3  # [GB] of memory, whatever the number of strands


class TorchDenoiser:
    """``NetworkDenoiser`` by torch, for strands of one window."""

    def __init__(self, *_: Any, **__: Any) -> None:
        model = load_model(DENOISER)
        self._network = UNet(architecture_of(model.architecture))
        restore(self._network, torch.from_numpy(model.weights.astype(np.float32)))
        self._network.eval()

    def __call__(
        self, noisy: NDArray[np.float64], alpha: float, sigma: float, condition: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        count, _, cells = noisy.shape
        arrays = (
            noisy,
            np.full(count, 2.0 * np.log(alpha / sigma)),
            np.tile((np.arange(cells) + 0.5) / cells, (count, 1)),
            np.nan_to_num(condition),
            np.isfinite(condition),
        )
        tensors = [torch.from_numpy(np.asarray(array, dtype=np.float32)).split(TORCH_BATCH) for array in arrays]
        with torch.no_grad():
            return torch.cat([self._network(*part) for part in zip(*tensors, strict=True)]).double().numpy()


class TorchLabels:
    """``LabelNetwork`` by torch."""

    def __init__(self, *_: Any, **__: Any) -> None:
        torch.manual_seed(1)
        self.labeler = Labeler().eval()

    def __call__(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        with torch.no_grad():
            parts = torch.from_numpy(values.astype(np.float32)).split(TORCH_BATCH)
            return torch.cat([self.told(part) for part in parts]).double().numpy()

    def told(self, signals: torch.Tensor) -> torch.Tensor:
        found = self.labeler(signals)
        return torch.stack([found.radius, found.wavelength, found.twist], dim=1)


def torch_derivatives(labels: TorchLabels) -> Derivatives:
    """``by_gradients`` by torch: one pass forward, and one back for each label."""

    def derivatives(values: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.float64]:
        found = []
        for first in range(0, len(values), TORCH_BATCH):
            part = slice(first, first + TORCH_BATCH)
            signals = torch.from_numpy(values[part].astype(np.float32)).requires_grad_()
            told = labels.told(signals)
            rows = []
            for k in range(told.shape[1]):
                (gradient,) = torch.autograd.grad(told[:, k].sum(), signals, retain_graph=True)
                rows.append((gradient.double().numpy()[:, None, :, :2] * directions[part]).sum(axis=(2, 3)))
            sizes = told.detach().double().numpy()
            columns = np.stack(rows, axis=1)
            columns[:, :2] /= np.maximum(sizes[:, :2], LEAST_SIZE)[:, :, None]
            found.append(columns)
        return np.concatenate(found)

    return derivatives


class Timed:
    """A callable that adds up how long it ran."""

    def __init__(self, run: Callable[..., Any], into: list[float]) -> None:
        self._run, self._into = run, into

    def __call__(self, *arguments: Any) -> Any:
        began = time.perf_counter()
        try:
            return self._run(*arguments)
        finally:
            self._into.append(time.perf_counter() - began)


def drawn(count: int, seed: int = 0) -> float:
    """Seconds to draw so many guided strands' signals."""
    hair = hair_type("VI").parameters()
    texture = network_texture(hair.radius, hair.wavelength, hair.twist, BOTH, as_drawn=True)
    began = time.perf_counter()
    synthesise(texture, np.full(count, LENGTH), np.arange(count), seed)
    return time.perf_counter() - began


def timed(count: int) -> tuple[float, float, float]:
    """Seconds in all, in the denoiser, and in the labelers."""
    spent: dict[str, list[float]] = {"denoiser": [], "labelers": []}

    def watched(name: str) -> Callable[..., Timed]:
        made = getattr(engines, name)
        into = spent["denoiser" if name == "NetworkDenoiser" else "labelers"]
        return lambda *given, **named: Timed(made(*given, **named), into)

    with replaced(**{name: watched(name) for name in ("NetworkDenoiser", "LabelNetwork", "LabelGradient")}):
        total = drawn(count)
    return total, sum(spent["denoiser"]), sum(spent["labelers"])


def by_torch(count: int) -> float:
    """Seconds to draw so many guided strands with torch's networks."""
    with replaced(
        NetworkDenoiser=TorchDenoiser,
        LabelNetwork=TorchLabels,
        LabelGradient=TorchLabels,
        by_gradients=torch_derivatives,
    ):
        return drawn(count)


@contextmanager
def replaced(**others: Any) -> Iterator[None]:
    """The engine made of other parts."""
    own = {name: getattr(engines, name) for name in others}
    try:
        for name, other in others.items():
            setattr(engines, name, other)
        yield
    finally:
        for name, part in own.items():
            setattr(engines, name, part)


def peak_memory(count: int) -> float:
    """GB of a process of its own that generates so many strands, less what the strands take."""
    command = [sys.executable, __file__, "--generate", str(count)]
    peak, points = map(float, subprocess.run(command, check=True, capture_output=True, text=True).stdout.split())
    return peak - 24.0 * points / 1e9 * 2.0  # a list of strands, and the groom that is made of them


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strands", type=int, default=1000)
    parser.add_argument("--beside", type=int, default=128)
    parser.add_argument("--many", type=int, default=4000)
    parser.add_argument("--generate", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.generate:
        hair = hair_type("VI").parameters()
        texture = network_texture(hair.radius, hair.wavelength, hair.twist, BOTH, as_drawn=True)
        groom = generate(texture, options.generate, LENGTH, steps=FEW_STEPS)
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9, len(groom.points))
        return 0
    threads = min(2, os.cpu_count() or 1)
    set_threads(threads)
    torch.set_num_threads(threads)
    drawn(8)  # compiles, or loads what was compiled
    total, denoiser, labelers = timed(options.strands)
    print(
        f"{options.strands} strands guided, 20 steps, 256 cells: {total:.0f} s on {threads} threads, "
        f"{options.strands / total:.1f} strands a second; denoiser {denoiser / total:.0%}, "
        f"labelers {labelers / total:.0%}"
    )
    rates = ", ".join(f"{count}: {count / drawn(count):.1f}" for count in AT_ONCE)
    print(f"strands a second by how many are drawn at once, loading the models included: {rates}")
    turns = [(drawn(options.beside), by_torch(options.beside)) for _ in range(2)]
    ours, theirs = (min(column) for column in zip(*turns, strict=True))
    ratio = ours / theirs
    print(f"{options.beside} strands: {ours:.1f} s, by torch {theirs:.1f} s: ratio {ratio:.2f} (bound {LARGEST_RATIO})")
    memory = [peak_memory(count) for count in (FEW, options.many)]
    grown = memory[1] - memory[0]
    print(
        f"peak memory beside the strands: {FEW} strands {memory[0]:.2f} GB, {options.many} strands {memory[1]:.2f} GB "
        f"(bound: {MOST_GROWTH} GB more)"
    )
    return int(ratio > LARGEST_RATIO or grown > MOST_GROWTH)


if __name__ == "__main__":
    sys.exit(main())
