"""How long render hairs take and how much memory, beside the mean of three guide strands a hair, as NumPy has it.

python benchmarks/hairs.py [--hairs 100000] [--guides 2000] [--points 64]
"""

from __future__ import annotations

import argparse
import resource
import sys
import time

import numpy as np

from density import scalp_groom
from detangled.groom import Groom
from detangled.grooming.guides import style_guides
from detangled.grooming.render_hairs import HairOptions, render_hairs

BOUND_S, BOUND_GB = 60.0, 6.0
TURNS, COIL_CM = 9, 0.3


def coily(guides: int, points: int) -> Groom:
    """Guides of a scalp with a coil on each."""
    groom = scalp_groom(guides, points)
    angle = np.linspace(0.0, 2.0 * np.pi * TURNS, points)
    coil = COIL_CM * np.stack([np.cos(angle) - 1.0, np.sin(angle), np.zeros(points)], axis=1)
    return Groom(groom.points + np.tile(coil, (guides, 1)), groom.offsets)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hairs", type=int, default=100_000)
    parser.add_argument("--guides", type=int, default=2000)
    parser.add_argument("--points", type=int, default=64)
    options = parser.parse_args(arguments)
    render_hairs(coily(40, options.points), HairOptions(count=80))  # compiles the kernels
    groom = coily(options.guides, options.points)
    start = time.perf_counter()
    style_guides(groom)
    axes_s = time.perf_counter() - start
    start = time.perf_counter()
    result = render_hairs(groom, HairOptions(count=options.hairs, points=options.points))
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6

    start = time.perf_counter()
    names = np.random.default_rng(1).integers(options.guides, size=(options.hairs, 3))
    strands = groom.points.reshape(options.guides, options.points, 3)
    mean = sum(strands[names[:, k]] / 3.0 for k in range(3))
    plain_s = time.perf_counter() - start
    print(f"{options.hairs} hairs of {options.points} points from {options.guides} coily guides, {len(mean)} by NumPy")
    print(f"{seconds:.1f} s (bound {BOUND_S:g} s), of them {axes_s:.1f} s for the guides' centrelines", end="   ")
    print(f"NumPy's mean {plain_s:.2f} s   ratio {seconds / plain_s:.1f}   peak {peak:.2f} GB (bound {BOUND_GB:g} GB)")
    inside = float((result.away <= result.wisp_radius * (1.0 + 1e-9)).mean())
    print(f"within the wisps' radius: {100 * inside:.2f} % of the hairs, asked for {100 * 0.98:.2f} %")
    return int(seconds > BOUND_S or peak > BOUND_GB)


if __name__ == "__main__":
    sys.exit(main())
