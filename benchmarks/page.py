"""How long a page takes to write, and how large it is, beside numpy.savez_compressed of the same points as float32.

python benchmarks/page.py [--strands 50000] [--points 100]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from detangled import Groom
from detangled.view.page import Shown, page, save

SEED = 1
LIMIT_S = 5.0


def timed(action: Callable[[], object]) -> tuple[float, float]:
    """Seconds that went by, and seconds of work: on a busy machine the former say little."""
    start, work = time.perf_counter(), time.process_time()
    action()
    return time.perf_counter() - start, time.process_time() - work


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strands", type=int, default=50_000)
    parser.add_argument("--points", type=int, default=100)
    options = parser.parse_args(arguments)

    rng = np.random.default_rng(SEED)
    roots = rng.normal(size=(options.strands, 1, 3))
    roots *= 9.0 / np.linalg.norm(roots, axis=2, keepdims=True)
    radius, turns, start = rng.uniform([0.2, 4, 0], [0.5, 12, 6.3], (options.strands, 3)).T[:, :, None]
    t = np.linspace(0.0, 1.0, options.points)
    coils = np.stack(
        [radius * np.cos(turns * 6.283 * t + start), -20.0 * t + 0 * start, radius * np.sin(turns * 6.283 * t + start)],
        axis=2,
    )
    points = (roots + coils).reshape(-1, 3)
    groom = Groom(points, np.arange(options.strands + 1) * options.points)

    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = Path(folder, "page.html"), Path(folder, "points.npz")
        whole, work = timed(lambda: save(page([Shown(groom, "coils")]), ours))
        other, other_work = timed(lambda: np.savez_compressed(theirs, points=points.astype(np.float32)))
        sizes = [path.stat().st_size / 1e6 for path in (ours, theirs)]
        print(f"{options.strands:,} strands of {options.points} points")
        print(f"page                     {whole:6.2f} s ({work:.2f} s of work), {sizes[0]:6.1f} MB")
        print(f"numpy.savez_compressed   {other:6.2f} s ({other_work:.2f} s of work), {sizes[1]:6.1f} MB")
        print(f"ratio                    {whole / other:6.2f}, {sizes[0] / sizes[1]:6.2f}")
        if work > LIMIT_S:
            raise SystemExit(f"a page of {options.strands:,} strands is to take {LIMIT_S:.0f} s")


if __name__ == "__main__":
    main()
