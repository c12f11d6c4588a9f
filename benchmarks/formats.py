"""How long Alembic files take to write and read, beside numpy.save and numpy.load of the same arrays.

python benchmarks/formats.py [--strands 100000] [--points 100] [--repeats 3]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from detangled import formats
from detangled.groom import Groom

SEED = 1


def best_seconds(action: Callable[[], object], repeats: int) -> float:
    """The shortest of several runs: the one that other work on the machine disturbed least."""
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strands", type=int, default=100_000)
    parser.add_argument("--points", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args(arguments)

    steps = np.random.default_rng(SEED).normal(scale=0.1, size=(options.strands, options.points, 3))
    points = np.cumsum(steps, axis=1).reshape(-1, 3).astype(np.float32)
    offsets = np.arange(options.strands + 1, dtype=np.int64) * options.points
    groom = Groom(points, offsets)
    counts = groom.point_counts.astype(np.int32)
    del steps

    with tempfile.TemporaryDirectory() as folder:
        abc, data, cnt = Path(folder, "hair.abc"), Path(folder, "points.npy"), Path(folder, "counts.npy")

        def save() -> None:
            np.save(data, points)
            np.save(cnt, counts)

        def load() -> None:
            np.load(data)
            np.load(cnt)

        rows = [
            ("write", lambda: formats.write(groom, abc), save),
            ("read", lambda: formats.read(abc, "cm"), load),
        ]
        print(f"{options.strands} strands of {options.points} points, best of {options.repeats}")
        for what, through_alembic, through_numpy in rows:
            # One after the other in one process, so that both meet the same machine.
            plain, alembic = (
                best_seconds(through_numpy, options.repeats),
                best_seconds(through_alembic, options.repeats),
            )
            print(f"{what:5}  .abc {alembic:7.3f} s   .npy {plain:7.3f} s   ratio {alembic / plain:6.2f}")
        print(f"size   .abc {abc.stat().st_size / 1e6:6.1f} MB   .npy {data.stat().st_size / 1e6:6.1f} MB")


if __name__ == "__main__":
    main()
