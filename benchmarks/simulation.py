"""How fast strands are hung, how surely, and whether simulating them comes to the same rest.

First the direct solver on random strands of the eight types: strands a second, iterations, and how many converged, with
all their points and with fewer a turn, whose tips are compared. Then Stable Cosserat rods on some more random strands,
stepped until they hang still, against the direct solver: the furthest that a point is apart, over the strand's length.

Some strands have several rests, and which of them is come to depends on the way. So the direct solver starts at rest,
pulled straight, and where the rods ended; a strand's distance is to the nearest of the three rests, and those that are
not at the first are listed.

Exits 1 where fewer than 99.9 % converge, or where a strand simulated is more than 1 % of its length from all three.
"""

from __future__ import annotations

import argparse
import sys
import time
from itertools import pairwise

import numba
import numpy as np
from numpy.typing import NDArray

from detangled.groom import offsets_of
from detangled.texture import HAIR_TYPES, SHARE_LIMITS
from detangled_training.hanging import differ, hang
from detangled_training.material import DRY_YOUNGS, WET_SHEAR, WET_YOUNGS, Fibres
from detangled_training.rods import simulate
from detangled_training.strands import FEWEST_SEGMENTS, POINTS_PER_TURN, procedural_strands

SEED = 2
CONVERGED = 0.999
SAME = 0.01  # of the length
SOFTEST = 0.8  # [GPa]


def fibres_of(count: int, rng: np.random.Generator) -> Fibres:
    """Random fibres: half with the usual moduli of wet hair, half from softer than wet to as stiff as dry."""
    youngs = np.where(rng.random(count) < 0.5, WET_YOUNGS, rng.uniform(SOFTEST, DRY_YOUNGS, count))
    return Fibres(
        rng.uniform(40.0, 110.0, count),
        rng.uniform(0.55, 1.0, count),
        rng.uniform(*SHARE_LIMITS, count),
        youngs,
        np.full(count, WET_SHEAR),
    )


def thinned(points: NDArray, offsets: NDArray, per_turn: int) -> tuple[NDArray, NDArray]:
    """Strands with fewer points, so that there are about ``per_turn`` a turn; the ends stay."""
    kept = []
    for a, b in pairwise(offsets):
        count = max(FEWEST_SEGMENTS // 2, (b - a - 1) * per_turn // POINTS_PER_TURN) + 1
        kept.append(a + np.unique(np.linspace(0, b - a - 1, count).round().astype(int)))
    return points[np.concatenate(kept)], offsets_of([len(k) for k in kept])


def furthest(one: NDArray, other: NDArray, offsets: NDArray) -> NDArray:
    """How far apart the points of each strand (S,) are at most [cm]."""
    return np.maximum.reduceat(np.linalg.norm(one - other, axis=1), offsets[:-1])


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strands", type=int, default=2000, help="that are hung directly")
    parser.add_argument("--rods", type=int, default=100, help="random strands that are simulated too")
    parser.add_argument("--points-per-turn", type=int, default=16, help="of the strands that are simulated")
    parser.add_argument("--seconds", type=float, default=100.0, help="simulated at most")
    options = parser.parse_args(arguments)

    rng = np.random.default_rng(SEED)
    threads = numba.get_num_threads()
    warm = procedural_strands(2, SEED)
    hang(warm.points, warm.offsets, Fibres.usual(2))
    simulate(warm.points, warm.offsets, Fibres.usual(2).isotropic(), seconds=1e-3)

    strands = procedural_strands(options.strands, SEED, kinds=np.arange(options.strands) % len(HAIR_TYPES))
    fibres = fibres_of(options.strands, rng)
    print(f"{options.strands} strands of the eight types, hung directly on {threads} threads")
    failed = False
    finest = None
    for per_turn in (POINTS_PER_TURN, POINTS_PER_TURN // 2):
        points, offsets = thinned(strands.points, strands.offsets, per_turn)
        start = time.perf_counter()
        found = hang(points, offsets, fibres)
        seconds = time.perf_counter() - start
        start = time.perf_counter()
        pulled = hang(points, offsets, fibres, stretched=True)
        pulled_seconds = time.perf_counter() - start
        print(f"{per_turn} points a turn, {np.median(np.diff(offsets)):.0f} points in the median")
        for name, hung, lasted in (("from rest", found, seconds), ("pulled", pulled, pulled_seconds)):
            share = 100 * hung.converged.mean()
            failed |= share < 100 * CONVERGED
            each = 1e3 * threads * lasted / options.strands
            steps = np.percentile(hung.iterations, [50, 99, 100]).astype(int)
            print(
                f"  {name:9} {options.strands / lasted:6.0f} strands/s, {each:4.1f} ms of a core each, converged "
                f"{share:.2f} %; iterations: median {steps[0]}, 99 % {steps[1]}, most {steps[2]}"
            )
        print(f"  two rests in {100 * differ(found.points, pulled.points, offsets).mean():.1f} %")
        tips = found.points[offsets[1:] - 1]
        if finest is None:
            finest = tips
        else:
            apart = 100 * np.linalg.norm(tips - finest, axis=1) / strands.length
            median, most = np.percentile(apart, [50, 99])
            print(f"  tips from those of all points: median {median:.2f} % of the length, 99 % {most:.2f} %")

    if options.rods == 0:
        sys.exit(int(failed))
    strands = procedural_strands(options.rods, SEED + 1)
    points, offsets = thinned(strands.points, strands.offsets, options.points_per_turn)
    fibres = fibres_of(options.rods, rng).isotropic()
    start = time.perf_counter()
    direct = hang(points, offsets, fibres)
    quick = time.perf_counter() - start
    start = time.perf_counter()
    stepped = simulate(points, offsets, fibres, seconds=options.seconds)
    slow = time.perf_counter() - start
    rests = [
        direct,
        hang(points, offsets, fibres, stretched=True),
        hang(points, offsets, fibres, start=stepped.frames),
    ]
    distances = np.array([furthest(stepped.points, rest.points, offsets) for rest in rests]) / strands.length
    distances[[~rest.converged for rest in rests]] = np.inf
    apart = distances.min(axis=0)
    moved = furthest(direct.points, points, offsets) / strands.length
    beyond = ~(apart <= SAME)  # not what it says of itself: a strand may tremble at its rest
    failed |= bool(beyond.any())
    print(f"{options.rods} random strands simulated, {options.points_per_turn} points a turn, on {threads} threads")
    print(f"  settled {stepped.settled.sum()}, in {np.median(stepped.seconds):.1f} s simulated in the median")
    print(f"  moved to hang: median {100 * np.median(moved):.1f} % of the length")
    print(f"  from a direct rest: median {100 * np.median(apart):.2f} %, worst {100 * apart.max():.2f} % of the length")
    first, second = (int((distances[: k + 1].min(axis=0) <= SAME).sum()) for k in (0, 1))
    print(f"  within 1 %: {first} at the one come to from rest, {second - first} more of the one from pulled straight")
    for s in np.flatnonzero(beyond | (distances[0] > SAME) | ~stepped.settled):
        each = ", ".join(f"{100 * d:.2f} %" for d in distances[:, s])
        state = "settled" if stepped.settled[s] else "still moving"
        print(f"  strand {s}, type {HAIR_TYPES[strands.kind[s]].name}, {strands.length[s]:.1f} cm, {state}: {each}")
    print(
        f"  {1e3 * slow / options.rods:.0f} ms a strand simulated, {1e3 * quick / options.rods:.1f} ms direct: ", end=""
    )
    print(f"{slow / quick:.0f} times faster")
    sys.exit(int(failed))


if __name__ == "__main__":
    main()
