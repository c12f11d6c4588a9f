"""How long it takes to make style guides denser, beside SciPy's interpolation of the same guides at random places.

python benchmarks/density.py [--guides 10000] [--factor 4] [--points 32] [--repeats 3]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from detangled.groom import Groom
from detangled.grooming.density_resampling import resampled
from detangled.grooming.guides import style_guides

SEED = 1
BOUND_S = 10.0
RADIUS_CM, LENGTH_CM = 9.0, 30.0


def scalp_groom(guides: int, points: int) -> Groom:
    """Guides all over the upper half of a sphere, which curl over on their way down."""
    rng = np.random.default_rng(SEED)
    roots = rng.normal(size=(4 * guides, 3))
    roots = roots[roots[:, 2] > 0.0][:guides]
    out = roots / np.linalg.norm(roots, axis=1, keepdims=True)
    along = np.linspace(0.0, 1.0, points)[None, :, None]
    fall = np.minimum(along * LENGTH_CM, 3.0) * out[:, None] - LENGTH_CM * along**2 * np.array([0.0, 0.0, 1.0])
    return Groom.from_strands(RADIUS_CM * out[:, None] + fall)


def best_seconds(action: Callable[[], object], repeats: int) -> float:
    """The shortest of several runs: the one that other work on the machine disturbed least."""
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--guides", type=int, default=10_000)
    parser.add_argument("--factor", type=float, default=4.0)
    parser.add_argument("--points", type=int, default=32)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args(arguments)
    groom = scalp_groom(options.guides, options.points)
    guides = style_guides(groom)
    count = round((options.factor - 1.0) * options.guides)

    def plain() -> None:
        """No blue noise, no frames, no parting kept: what can be had from SciPy in three lines."""
        roots = groom.points[groom.offsets[:-1]]
        strands = groom.points.reshape(options.guides, -1)
        places = np.random.default_rng(SEED).normal(size=(count, 2)) * RADIUS_CM / 3.0
        LinearNDInterpolator(roots[:, :2], strands)(places)

    def ours() -> None:
        resampled(groom, guides, options.factor)

    small = scalp_groom(50, options.points)
    resampled(small, style_guides(small), 2.0)  # compiles the kernels
    result = resampled(groom, guides, options.factor)
    scipy_s, seconds = best_seconds(plain, options.repeats), best_seconds(ours, options.repeats)
    print(f"{options.guides} guides of {options.points} points, best of {options.repeats}")
    print(f"to {result.groom.strand_count}: {seconds:.2f} s (bound {BOUND_S:g} s)   SciPy {scipy_s:.2f} s", end="   ")
    print(f"ratio {seconds / scipy_s:.2f}   where guides part: {100 * result.refused:.1f} % of the scalp")
    return int(seconds > BOUND_S)


if __name__ == "__main__":
    sys.exit(main())
