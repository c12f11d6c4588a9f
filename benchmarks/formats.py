"""How long every format takes to write and read, beside numpy.save and numpy.load of the same arrays.

python benchmarks/formats.py [--strands 100000] [--points 100] [--repeats 2] [--only .abc .usdc]

TressFX takes strands of 4 to 64 points only; it is given the same number of points in strands of 50. The two text
formats, which are tens of times slower, are given a tenth of the strands, and NumPy beside them too.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from detangled import formats
from detangled.groom import Groom

SEED = 1
TEXTS = (".obj", ".usda")
# Megabytes in what getrusage counts in on Linux, kilobytes.
MB = 1e-3


def best_seconds(action: Callable[[], object], repeats: int) -> float:
    """The shortest of several runs: the one that other work on the machine disturbed least."""
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def measured(suffix: str, groom: Groom, folder: Path, repeats: int) -> str:
    """One format's row: seconds to write and read, and their ratios to NumPy's, taken in the same run."""
    points, counts = groom.points.astype(np.float32), groom.point_counts.astype(np.int32)
    data, cnt, path = folder / "points.npy", folder / "counts.npy", folder / f"hair{suffix}"

    def save() -> None:
        np.save(data, points)
        np.save(cnt, counts)

    def load() -> None:
        np.load(data)
        np.load(cnt)

    # A first strand, so that no import or compilation is timed.
    small = groom.select([0])
    formats.write(small, path)
    formats.read(path, "cm")
    plain = best_seconds(save, repeats), best_seconds(load, repeats)
    write, read = (
        best_seconds(lambda: formats.write(groom, path), repeats),
        best_seconds(lambda: formats.read(path, "cm"), repeats),
    )
    size = path.stat().st_size / 1e6
    path.unlink()
    return (
        f"{suffix:5}  {len(points):10,} points   write {write:7.2f} s, {write / plain[0]:7.1f} x NumPy   "
        f"read {read:7.2f} s, {read / plain[1]:7.1f} x NumPy   {size:7.1f} MB"
    )


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strands", type=int, default=100_000)
    parser.add_argument("--points", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--only", nargs="*", default=formats.suffixes(), metavar="SUFFIX")
    options = parser.parse_args(arguments)

    steps = np.random.default_rng(SEED).normal(scale=0.1, size=(options.strands, options.points, 3))
    points = np.cumsum(steps, axis=1).reshape(-1, 3).astype(np.float32)
    del steps
    groom = Groom(points, np.arange(options.strands + 1) * options.points)
    print(f"{options.strands:,} strands of {options.points} points, best of {options.repeats}")
    with tempfile.TemporaryDirectory() as folder:
        for suffix in options.only:
            given = groom
            if suffix == ".tfx" and options.points == 100:
                given = Groom(points, np.arange(2 * options.strands + 1) * 50)
            if suffix in TEXTS:
                given = groom.select(np.arange(max(1, options.strands // 10)))
            print(measured(suffix, given, Path(folder), options.repeats), flush=True)
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * MB:,.0f} MB")


if __name__ == "__main__":
    main()
