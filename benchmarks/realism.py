"""How like simulated hair generated strands are.

python benchmarks/realism.py --data DIR [--strands 128] [--draws 5] [--methods library conditioned guided both]
                             [--seed 0]

DIR: a data set of simulated strands, made by ``detangled train data --simulated``: that the network was trained on, or
any other. Two sets are drawn of those of its strands that are held out from any training. For each strand of the second
one is generated with its numbers and of its length: these stand in for the second set beside the first, and the second
itself is the floor. Printed are, in a space of what a strand is like (how its curvature, torsion and distance from the
axis are spread), 1-NNA (50 % where the two cannot be told apart; bounds 45 to 65 %), the mean distance of a real strand
from the nearest (MMD), the share of real strands that are nearest to some (COV), how far strands of the set are from
each other in the median, over that of real ones, and Wasserstein-1 distances of curvature, torsion's size and distance
from the axis, all strands' together, over those of the floor (bound 1.5 times). All are means of several draws of both
sets: in one, both distances are off by half by chance. With more strands in a set the floor falls, and what is unlike
shows more. Real and generated strands are measured alike, from points; numbers are taken by their word: nothing is
corrected, and strands are not settled, as ``generate`` would. Exits 1 where a method given by --judged fails a bound.
"""

from __future__ import annotations

import argparse
import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wasserstein_distance

from detangled.from_library import library_texture
from detangled.from_network import network_texture
from detangled.from_numbers import DEFAULT_METHOD, LIBRARY, METHODS
from detangled.generation import generate
from detangled.geometry.arc import arc_lengths
from detangled.geometry.centerline import centerlines
from detangled.geometry.signal import curve_counts, curves, signals
from detangled.groom import Groom, offsets_of
from detangled.grooming.guides import to_canonical
from detangled.grooming.placing import resample
from detangled.library import load_library
from detangled.models import LIBRARY as LIBRARY_MODEL
from detangled.models import verified
from detangled.texture import arc_of_a_turn
from detangled_training.dataset import TEST, read_dataset
from detangled_training.strands import twist_prevalence

NNA_BOUNDS = (0.45, 0.65)
W1_BOUND = 1.5  # of the floor's
FEWEST_TURNS, MOST_TURNS = 3.0, 16.0  # of strands that are compared: an axis can be found, and a signal holds all of it
POINTS_PER_TURN = 16
CELLS = 256
ENDS = 0.1  # of a strand at either end, where axes are known least well
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
NAMES = ("kappa", "|tau|", "r")


class Measured(NamedTuple):
    """Curvature, torsion's size [1/cm], and distance from the axis [cm] of strands, (S, 3, n)."""

    values: NDArray[np.float64]

    @property
    def features(self) -> NDArray[np.float64]:
        """What each strand is like, (S, F)."""
        logarithms = np.log(np.maximum(self.values, 1e-3))
        spread = np.quantile(logarithms, QUANTILES, axis=2).transpose(1, 2, 0).reshape(len(logarithms), -1)
        steps = np.log(np.abs(np.diff(self.values[:, :2], axis=2)).mean(axis=2) + 1e-6)
        return np.concatenate([spread, steps], axis=1)

    def select(self, chosen: NDArray[np.int64]) -> Measured:
        return Measured(self.values[chosen])


class Wanted(NamedTuple):
    """Numbers of real strands, (S,) each."""

    radius: NDArray[np.float64]
    wavelength: NDArray[np.float64]
    twist: NDArray[np.float64]
    length: NDArray[np.float64]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--strands", type=int, default=128, help="of each set")
    parser.add_argument("--draws", type=int, default=5, help="of both sets")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--judged", choices=METHODS, default=DEFAULT_METHOD)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    if options.judged not in options.methods:
        parser.error(f"--methods must name the one that is judged, {options.judged}")
    sets = [real_strands(options.data, options.strands, options.seed + draw) for draw in range(options.draws)]
    floor = np.mean([distances(first, second) for first, second, _ in sets], axis=0)
    print(
        f"{options.strands} strands a set, means of {options.draws} draws; real strands beside other real ones, and "
        "beside generated ones"
    )
    print(
        "method         1-NNA    MMD    COV  spread   W1: " + "  ".join(f"{name:>8}" for name in NAMES) + "   strands/s"
    )
    print(row("real", np.mean([compared(first, second) for first, second, _ in sets], axis=0), floor, floor))
    ok = True
    for method in options.methods:
        began = time.perf_counter()
        made = [generated(method, wanted, options.seed) for _, _, wanted in sets]
        rate = options.strands * options.draws / (time.perf_counter() - began)
        likeness = np.mean([compared(one[0], other) for one, other in zip(sets, made, strict=True)], axis=0)
        found = np.mean([distances(one[0], other) for one, other in zip(sets, made, strict=True)], axis=0)
        good = NNA_BOUNDS[0] <= likeness[0] <= NNA_BOUNDS[1] and bool((found <= W1_BOUND * floor).all())
        ok &= good or method != options.judged
        print(f"{row(method, likeness, found, floor)}   {rate:7.1f}   {'ok' if good else 'FAIL'}", flush=True)
    return int(not ok)


def row(method: str, likeness: NDArray[np.float64], found: NDArray[np.float64], floor: NDArray[np.float64]) -> str:
    nearest, mean, covered, spread = likeness
    ratios = "  ".join(f"{value:8.2f}" for value in found / floor)
    return f"{method:12} {nearest:7.1%} {mean:6.2f} {covered:6.1%} {spread:7.2f}       {ratios}"


def real_strands(folder: Path, count: int, seed: int) -> tuple[Measured, Measured, Wanted]:
    """Two sets of held-out strands, and the numbers of the second's."""
    data = read_dataset(folder, TEST)
    if data.origin["seed"] == verified(LIBRARY_MODEL, None)[0]["training"]["seed"]:
        raise SystemExit(f"{folder}: has the seed of the library, whose strands it holds: make it with another")
    labels = data.labels
    turns = labels["turns"]
    usable = ~labels["read"] & (turns >= FEWEST_TURNS) & (turns <= MOST_TURNS)
    rng = np.random.default_rng(seed)
    # One variant of a base strand.
    rows = rng.permutation(np.flatnonzero(usable))
    rows = rows[np.sort(np.unique(labels["base"][rows], return_index=True)[1])]
    if len(rows) < 2 * count:
        raise SystemExit(f"{folder}: has {len(rows)} strands to compare with, not {2 * count}: make more")
    rows = rows[: 2 * count]
    values = data.signals[rows].astype(np.float64).reshape(-1, 3)
    starts = CELLS * np.arange(len(rows) + 1)
    offsets = offsets_of(curve_counts(values, starts))
    turn = arc_of_a_turn(labels["radius"][rows], labels["wavelength"][rows])
    found = measured(curves(values, starts, offsets), offsets, turn)
    second = rows[count:]
    wanted = Wanted(
        labels["radius"][second],
        labels["wavelength"][second],
        twist_prevalence(labels["twists"], labels["length"])[second],
        values[:, 2].reshape(len(rows), CELLS).mean(axis=1)[count:],
    )
    return found.select(np.arange(count)), found.select(np.arange(count, 2 * count)), wanted


def generated(method: str, wanted: Wanted, seed: int) -> Measured:
    """A strand of each of these numbers, which are taken by their word."""
    library = load_library()
    strands = []
    for radius, wavelength, twist, length in zip(*wanted, strict=True):
        if method == LIBRARY:
            texture = library_texture(radius, wavelength, twist, library, as_drawn=True)
        else:
            texture = network_texture(radius, wavelength, twist, method, as_drawn=True)
        strands.append(generate(texture, 1, length, seed + len(strands)).points)
    groom = Groom.from_strands(strands)
    return measured(groom.points, groom.offsets, arc_of_a_turn(wanted.radius, wanted.wavelength))


def measured(points: NDArray[np.float64], offsets: NDArray[np.int64], turn: NDArray[np.float64]) -> Measured:
    """Strands as any groom's are measured: with even points, about the centreline that is found."""
    arcs = arc_lengths(points, offsets)
    fine = offsets_of(np.maximum(np.ceil(POINTS_PER_TURN * arcs / turn).astype(np.int64) + 1, 8))
    even = resample(points, offsets, fine)
    canonical = to_canonical(even, centerlines(even, fine)[0], fine)
    starts = CELLS * np.arange(len(offsets))
    kappa, tau, _ = signals(canonical, fine, starts).reshape(-1, CELLS, 3).transpose(2, 0, 1)
    distance = np.hypot(canonical[:, 0], canonical[:, 1])
    at = np.linspace(0.0, 1.0, CELLS)
    away = np.stack([np.interp(at, np.linspace(0.0, 1.0, b - a), distance[a:b]) for a, b in pairwise(fine)])
    end = round(ENDS * CELLS)
    return Measured(np.stack([kappa, np.abs(tau), away], axis=1)[:, :, end:-end])


def compared(real: Measured, other: Measured) -> tuple[float, float, float, float]:
    """1-NNA, MMD, COV and spread of a set beside a real one of as many strands."""
    features = real.features
    scale = features.std(axis=0)
    both = np.concatenate([features, other.features]) / scale
    away = np.linalg.norm(both[:, None] - both[None], axis=2) / np.sqrt(both.shape[1])
    np.fill_diagonal(away, np.inf)
    count = len(features)
    of_other = np.arange(2 * count) >= count
    nearest = float((of_other[away.argmin(axis=1)] == of_other).mean())
    across = away[:count, count:]
    pairs = np.triu_indices(count, 1)
    spread = float(np.median(away[count:, count:][pairs]) / np.median(away[:count, :count][pairs]))
    return nearest, float(across.min(axis=1).mean()), len(np.unique(across.argmin(axis=0))) / count, spread


def distances(real: Measured, other: Measured) -> NDArray[np.float64]:
    """Wasserstein-1 distances of all strands' values together, (3,)."""
    return np.array([wasserstein_distance(real.values[:, k].ravel(), other.values[:, k].ravel()) for k in range(3)])


if __name__ == "__main__":
    sys.exit(main())
