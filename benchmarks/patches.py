"""Milliseconds that the patch denoiser takes for a strand, beside the naive loop over patches.

python benchmarks/patches.py [--cells 256] [--steps 20] [--strands 32] [--naive-strands 4]

Both are compiled by numba, run on all threads over strands, and denoise the same noisy signals at the noise levels of
the sampler's steps, with half-widths falling from 100 to 6 cells. A strand is made in two stretches, each offered at
most 12 of the targets, as in ``detangled retexture``; the last row offers all 100. The naive loop is timed on fewer
strands, at all steps.
"""

from __future__ import annotations

import argparse
import time

import numba
import numpy as np
from numpy.typing import NDArray

from detangled.diffusion.patches import PatchSchedule, denoise_strands, plan_stretches
from detangled.diffusion.sampler import DEFAULT_STEPS, solver_coefficients
from detangled.diffusion.schedule import CosineSchedule
from detangled.engines import OFFERED, WIDEST_SHARE
from detangled.groom import offsets_of
from detangled.kernels import parallel_kernel, prange

SEED = 1
STRETCHES = 2
CASES = ((5, 5), (12, OFFERED), (100, OFFERED), (100, 100))  # targets, and how many of them a stretch is offered
LEAST_RATIO = 10.0
LARGEST_DIFFERENCE = 1e-5

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@parallel_kernel
def naive(
    noisy: Floats,
    alpha: float,
    sigma: float,
    examples: Floats,
    starts: Ints,
    bounds: Ints,
    chosen: Ints,
    diagonals: Ints,
    half_width: int,
    window: int,
) -> Floats:
    """What ``denoise_strands`` computes, from its definition: every patch against every patch."""
    out = np.empty_like(noisy)
    precision = 0.5 * (alpha / sigma) ** 2
    cells = noisy.shape[2]
    count = chosen.shape[2]
    span = 2 * window + 1
    for b in prange(noisy.shape[0]):
        x = noisy[b] / alpha
        scores = np.empty((count, span))
        for p in range(bounds.shape[0] - 1):
            for i in range(bounds[p], bounds[p + 1]):
                largest = -np.inf
                for e in range(count):
                    begin = starts[chosen[b, p, e]]
                    length = starts[chosen[b, p, e] + 1] - begin
                    for k in range(span):
                        scores[e, k] = -np.inf
                        j = i + diagonals[b, p, e] - window + k
                        if j < 0 or j >= length:
                            continue
                        before = min(half_width, i, j)
                        after = min(half_width, cells - 1 - i, length - 1 - j)
                        total = 0.0
                        for d in range(-before, after + 1):
                            for c in range(3):
                                gap = x[c, i + d] - examples[c, begin + j + d]
                                total += gap * gap
                        scores[e, k] = -total * precision * (2 * half_width + 1) / (before + after + 1)
                        largest = max(largest, scores[e, k])
                total = 0.0
                mean = np.zeros(3)
                for e in range(count):
                    begin = starts[chosen[b, p, e]]
                    for k in range(span):
                        weight = np.exp(scores[e, k] - largest)
                        if weight > 0.0:
                            total += weight
                            for c in range(3):
                                mean[c] += weight * examples[c, begin + i + diagonals[b, p, e] - window + k]
                out[b, :, i] = mean / total
    return out


def random_targets(rng: np.random.Generator, count: int, cells: int) -> tuple[Floats, Ints]:
    """Smooth channels of unit variance, (3, C), and where each target starts; their lengths differ by a tenth."""
    lengths = rng.integers(round(0.9 * cells), round(1.1 * cells), count)
    phase = rng.uniform(0, 2 * np.pi, (count, 3, 4))
    rate = rng.uniform(0.05, 0.6, (count, 3, 4))
    channels = [
        np.cos(phase[e, :, :, None] + rate[e, :, :, None] * np.arange(n)).sum(axis=1) / 2**0.5
        for e, n in enumerate(lengths)
    ]
    return np.concatenate(channels, axis=1), offsets_of(lengths)


def compare(
    targets: int, offered: int, cells: int, steps: int, strands: int, naive_strands: int
) -> tuple[float, float, float]:
    """Seconds a strand of the kernel and of the naive loop, over all steps, and their largest difference."""
    rng = np.random.default_rng(SEED)
    examples, starts = random_targets(rng, targets, cells)
    bounds = np.linspace(0, cells, STRETCHES + 1).round().astype(np.int64)
    plans = [plan_stretches(rng, np.diff(starts), cells, bounds, offered) for _ in range(strands)]
    chosen, diagonals = (np.stack([plan[k] for plan in plans]) for k in (0, 1))
    clean = np.stack([examples[:, :cells] for _ in range(strands)])
    noise = rng.standard_normal(clean.shape)
    schedule = PatchSchedule(widest=100, narrowest=6)
    widest = int(WIDEST_SHARE * cells / STRETCHES)
    coefficients = solver_coefficients(CosineSchedule(), steps)
    seconds = np.zeros(2)
    largest = 0.0
    for alpha, sigma in zip(coefficients.alpha, coefficients.sigma, strict=True):
        noisy = alpha * clean + sigma * noise
        half_width = min(schedule.half_width(alpha, sigma), widest)
        found = []
        for which, (function, number) in enumerate(((denoise_strands, strands), (naive, naive_strands))):
            given = (examples, starts, bounds, chosen[:number], diagonals[:number], half_width, schedule.window)
            began = time.perf_counter()
            found.append(function(noisy[:number], alpha, sigma, *given))
            seconds[which] += (time.perf_counter() - began) / number
        largest = max(largest, float(np.abs(found[0][:naive_strands] - found[1]).max()))
    return float(seconds[0]), float(seconds[1]), largest


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=256)
    parser.add_argument("--steps", type=int, default=DEFAULT_STEPS)
    parser.add_argument("--strands", type=int, default=32)
    parser.add_argument("--naive-strands", type=int, default=4)
    options = parser.parse_args(arguments)

    compare(5, 5, 64, 2, 2, 2)  # compiles both
    print(
        f"{options.cells} cells, {options.steps} steps, half-widths 100 to 6, {numba.get_num_threads()} threads; "
        f"{options.strands} strands, the naive loop on {options.naive_strands}"
    )
    worst_ratio, worst_difference = np.inf, 0.0
    for targets, offered in CASES:
        ours, theirs, difference = compare(
            targets, offered, options.cells, options.steps, options.strands, options.naive_strands
        )
        worst_ratio, worst_difference = min(worst_ratio, theirs / ours), max(worst_difference, difference)
        print(
            f"{targets:3} targets, {offered:3} offered   {1e3 * ours:7.1f} ms a strand   naive {1e3 * theirs:8.1f} ms"
            f"   ratio {theirs / ours:5.1f}   largest difference {difference:.1e}"
        )
    print(f"least ratio {worst_ratio:.1f} (bound: at least {LEAST_RATIO:.0f})")
    print(f"largest difference {worst_difference:.1e} (bound: at most {LARGEST_DIFFERENCE:.0e})")


if __name__ == "__main__":
    main()
