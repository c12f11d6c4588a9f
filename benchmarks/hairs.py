"""How long render hairs take and how much memory, beside the mean of three guide strands a hair, as NumPy has it.

python benchmarks/hairs.py [--hairs 100000] [--guides 2000] [--points 64] [--every 6] [--labelled 400]

Then every so many strands of examples/bob.abc become hair of type 4B, and so many render hairs of them are labelled:
how many are within one type of the strand that leads their wisp. Exits 1 where a bound fails.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from pathlib import Path

import numpy as np

import detangled
from density import scalp_groom
from detangled.from_numbers import asked, asked_texture
from detangled.groom import Groom
from detangled.grooming.guides import style_guides
from detangled.grooming.render_hairs import HairOptions, RenderHairs, render_hairs
from detangled.texture import hair_type

BOUND_S, BOUND_GB = 60.0, 6.0
TURNS, COIL_CM = 9, 0.3
BOB = Path(__file__).resolve().parents[1] / "examples" / "bob.abc"
TYPE = "4B"
ALIKE_BOUND = 0.95  # of the hairs, within one type of their guides


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
    parser.add_argument("--every", type=int, default=6)
    parser.add_argument("--labelled", type=int, default=400)
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
    ok = seconds <= BOUND_S and peak <= BOUND_GB and kept_in_wisps(result)
    return int(not (labelled_alike(options.every, options.labelled) and ok))


def kept_in_wisps(result: RenderHairs) -> bool:
    """Print how many hairs are within the wisps' radius, beside how many are asked for, to half a hair."""
    count, wanted = len(result.away), 1.0 - HairOptions.flyaways
    inside = np.count_nonzero(result.away <= result.wisp_radius * (1.0 + 1e-9))
    print(f"within the wisps' radius: {inside / count:.2%} of the hairs, asked for {wanted:.2%}")
    return abs(inside - wanted * count) <= 0.5


def labelled_alike(every: int, count: int) -> bool:
    """Print how render hairs of a type are labelled beside their guides."""
    bob = detangled.read(BOB, unit="m")
    bob = bob.select(np.arange(0, bob.strand_count, every))
    groom = detangled.retexture(bob, asked_texture(asked(hair_type(TYPE)))).groom
    result = render_hairs(groom, HairOptions(count=count))
    guides, hairs = detangled.label(groom), detangled.label(result.groom)
    leaders = guides.kind[result.wisp]
    read = (hairs.kind >= 0) & (leaders >= 0)
    apart = np.abs(hairs.kind - leaders)
    alike = np.count_nonzero(read & (apart <= 1)) / count
    sizes = [np.nanmedian(size) for found in (guides, hairs) for size in (found.radius, found.wavelength)]
    print(f"{count} hairs of {groom.strand_count} strands of type {TYPE}: {np.count_nonzero(read)} labelled;", end=" ")
    print(f"of all, {np.count_nonzero(read & (apart == 0)) / count:.1%} as their guides,", end=" ")
    print(f"{alike:.1%} within one type (bound {ALIKE_BOUND:.0%})")
    print("  median radius and wavelength [cm]: guides {:.3f}, {:.3f}; hairs {:.3f}, {:.3f}".format(*sizes))
    return kept_in_wisps(result) and alike >= ALIKE_BOUND


if __name__ == "__main__":
    sys.exit(main())
