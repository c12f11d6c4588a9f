"""How long pictures take, beside the time to read every point of the groom once, and how much memory.

python benchmarks/render.py [--strands 50000] [--points 100] [--size 1024] [--repeats 3]

Straight, wavy and coily hair on half a ball, without a head and with one. Printed are the best of some runs in
seconds, and the peak memory of the process. Exits 1 where the picture without a head takes more than 5 s or 2 GB.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
import psutil

from detangled.groom import Groom
from detangled.head import Head
from detangled.view.picture import render

SECONDS_BOUND, MEMORY_BOUND_GB = 5.0, 2.0
RADIUS, LENGTH = 9.0, 25.0  # [cm] of the ball and the hair
CURLS = {"straight": (0.0, 0.0), "wavy": (0.5, 5.0), "coily": (0.5, 20.0)}  # radius [cm], turns


def hair(strands: int, points: int, curl: tuple[float, float]) -> Groom:
    rng = np.random.default_rng(1)
    out = rng.normal(size=(strands, 3))
    out[:, 1] = np.abs(out[:, 1])
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    t = np.linspace(0.0, 1.0, points)
    radius, turns = curl
    angle = 2.0 * np.pi * turns * t + rng.uniform(0.0, 2.0 * np.pi, (strands, 1))
    along = RADIUS * out[:, None] + 5.0 * np.sqrt(t)[:, None] * out[:, None] * [1.0, 0.0, 1.0]
    along[:, :, 0] += radius * np.cos(angle)
    along[:, :, 1] -= LENGTH * t * t
    along[:, :, 2] += radius * np.sin(angle)
    return Groom(along.reshape(-1, 3), np.arange(strands + 1, dtype=np.int64) * points)


def ball() -> Head:
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS)
    return Head(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strands", type=int, default=50_000)
    parser.add_argument("--points", type=int, default=100)
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args(arguments)

    size = (options.size, options.size)
    render([hair(20, 20, CURLS["wavy"])], (64, 64), head=ball())  # compiles, or loads what was compiled
    print(f"{options.strands} strands of {options.points} points, {options.size} x {options.size} pixels")
    slowest = 0.0
    for name, curl in CURLS.items():
        groom = hair(options.strands, options.points, curl)
        for head in (None, ball()):
            times, cpu, sums = [], [], []
            for _ in range(options.repeats):
                # One after the other in one process, so that both meet the same machine.
                start, used = time.perf_counter(), time.process_time()
                np.sqrt((groom.points**2).sum(axis=1)).sum()
                sums.append(time.perf_counter() - start)
                start, used = time.perf_counter(), time.process_time()
                render([groom], size, "34", head=head)
                times.append(time.perf_counter() - start)
                cpu.append(time.process_time() - used)
            if head is None:
                slowest = max(slowest, min(times))
            print(
                f"{name:8} {'with a head' if head else 'hair alone '} {min(times):6.2f} s ({min(cpu):5.2f} s of all "
                f"cores)   all points' norms {min(sums):5.3f} s   ratio {min(times) / min(sums):5.0f}",
                flush=True,
            )
    info = psutil.Process().memory_info()
    memory = getattr(info, "peak_wset", 0) / 1e9 or _peak_gb()
    good = slowest <= SECONDS_BOUND and memory <= MEMORY_BOUND_GB
    print(f"slowest without a head {slowest:.2f} s, memory {memory:.2f} GB: {'ok' if good else 'FAIL'}")
    return int(not good)


def _peak_gb() -> float:
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e9 if sys.platform == "darwin" else 1e6)


if __name__ == "__main__":
    sys.exit(main())
