"""The whole job, from one file to another: seconds by stage, milliseconds a strand, and the memory it takes.

python benchmarks/pipeline.py [--quick] [--grooms FOLDER]

eve.abc (1,077 strands) with coily_swatch.obj, then combover.abc at an eighth, a half and all of its 30,534 strands.
Each run has a process of its own, after one that compiles the kernels. --quick takes a tenth of all strands. The
grooms are not part of the project: their folder is --grooms or DETANGLED_GROOMS.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numba
import numpy as np

import detangled
from detangled import retexturing
from detangled.grooming import lengths

TARGET = "coily_swatch.obj"
TARGET_UNIT = "cm"
CASES = (("eve.abc", 1), ("combover.abc", 8), ("combover.abc", 2), ("combover.abc", 1))
QUICK = 10
EVE_SECONDS = 180.0
EVE_GIGABYTES = 4.0
# Where each of the functions that the pipeline calls spends a stage of its own. Guides have a centreline stage too.
STAGES = (
    (retexturing, "style_guides", "guides of the groom"),
    (retexturing, "synthesise", "denoising"),
    (lengths, "curves", "signal to strand"),
    (lengths, "centerlines", "new centrelines"),
    (lengths, "to_canonical", "to canonical space"),
    (lengths, "place", "placing"),
    (retexturing, "resample", "resampling"),
    (retexturing, "resampled_attributes", "attributes"),
)


@dataclass(frozen=True)
class Measured:
    """seconds by stage, in the order they took; total [s]; peak resident memory [bytes] of the process."""

    strands: int
    points: int
    stages: dict[str, float]
    total: float
    before: int
    peak: int


def peak_memory() -> int:
    """Most memory [bytes] that this process had resident; 0 where the system does not say."""
    if sys.platform == "win32":
        return 0
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def timed(function: Callable[..., Any], stage: str, seconds: dict[str, float]) -> Callable[..., Any]:
    """The function, its time added to a stage."""

    def call(*arguments: Any, **named: Any) -> Any:
        began = time.perf_counter()
        try:
            return function(*arguments, **named)
        finally:
            seconds[stage] += time.perf_counter() - began

    return call


def job(groom: Path, target: Path, every: int) -> Measured:
    """Retexture every so many strands of a groom; runs in a process of its own, whose memory is measured."""
    seconds: dict[str, float] = defaultdict(float)
    for module, name, stage in STAGES:
        setattr(module, name, timed(getattr(module, name), stage, seconds))
    with tempfile.TemporaryDirectory() as folder:
        chosen = Path(folder, "in.abc")
        whole = detangled.read(groom, unit="m")
        detangled.write(whole.select(np.arange(0, whole.strand_count, every)), chosen)
        del whole
        before = peak_memory()
        began = time.perf_counter()
        old = timed(detangled.read, "reading", seconds)(chosen, unit="m")
        texture = timed(detangled.fit, "fitting", seconds)(detangled.read(target, unit=TARGET_UNIT))
        result = detangled.retexture(old, texture)
        timed(detangled.write, "writing", seconds)(result.groom, Path(folder, "out.abc"))
        total = time.perf_counter() - began
    seconds["else"] = total - sum(seconds.values())
    stages = dict(sorted(seconds.items(), key=lambda item: -item[1]))
    return Measured(result.strands, len(result.groom.points), stages, total, before, peak_memory())


def measured(groom: Path, target: Path, every: int) -> Measured:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(job, groom, target, every).result()


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    beside = Path(__file__).resolve().parents[2] / "shared" / "grooms"
    parser.add_argument("--grooms", type=Path, default=Path(os.environ.get("DETANGLED_GROOMS", beside)))
    options = parser.parse_args(arguments)
    missing = [name for name in (TARGET, *{name for name, _ in CASES}) if not (options.grooms / name).is_file()]
    if missing:
        print(f"skipped: {', '.join(missing)} not in {options.grooms}; say where with --grooms or DETANGLED_GROOMS")
        return

    target = options.grooms / TARGET
    share = QUICK if options.quick else 1
    measured(options.grooms / "eve.abc", target, 200)  # compiles
    print(f"{numba.get_num_threads()} threads" + (f", a strand in {share}" if share > 1 else ""))
    for name, part in CASES:
        got = measured(options.grooms / name, target, part * share)
        print(
            f"{name}: {got.strands} strands, {got.points} points: {got.total:.1f} s, "
            f"{1e3 * got.total / got.strands:.1f} ms a strand, peak {got.peak / 1e9:.2f} GB "
            f"({got.before / 1e9:.2f} GB before the work)",
            flush=True,
        )
        for stage, seconds in got.stages.items():
            print(f"    {stage:20} {seconds:7.2f} s  {100 * seconds / got.total:5.1f} %")
        if name == "eve.abc" and share == 1:
            print(f"    bounds: {EVE_SECONDS:.0f} s, {EVE_GIGABYTES:.0f} GB")


if __name__ == "__main__":
    main()
