"""One number of a texture rising from left to right, the others as they are: the paper's supervision figure.

python benchmarks/sweeps.py [OUT.png] [--method library] [--strands 24] [--seed 0]

From type VI, radius, wavelength and twist prevalence are each swept over what hair has. Printed is what the labelers in
benchmarks/judge, which had no part in the making, read in the strands, in the median, of each of the three numbers; the
number that is swept must rise with what is asked. The picture has a row for each. Exits 1 where a swept number does not
rise.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from detangled.from_numbers import DEFAULT_METHOD, METHODS
from detangled.generation import side_by_side
from detangled.groom import Groom
from detangled.models import LABELER, load_labeler
from detangled.view.gallery.sweep_figure import SWEPT, sweep_step
from detangled.view.picture import render, save
from measures import JUDGE

SHOWN = 4  # strands of a panel
SIZE = (360, 440)  # [px] of a panel
COLOURS = 192


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture", nargs="?", type=Path)
    parser.add_argument("--method", choices=METHODS, default=DEFAULT_METHOD)
    parser.add_argument("--strands", type=int, default=24, help="that are read, of each texture")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    judge = load_labeler(LABELER, JUDGE)
    rows = []
    ok = True
    for name, values in SWEPT.items():
        panels = []
        read = []
        for value in values:
            step = sweep_step(name, value, options.strands, options.seed, options.method, judge)
            read.append(step.swept)
            print(f"{name} {value:4.2f}: read " + ", ".join(f"{one} {x:.2f}" for one, x in step.read.items()))
            panels.append(middle(side_by_side(step.strands.select(np.arange(min(SHOWN, options.strands))))))
        rises = bool((np.diff(read) > 0.0).all())
        print(f"{name} {'rises' if rises else 'does not rise: FAIL'}", flush=True)
        ok &= rises
        captions = [f"{name} {value:g}" + (" cm" if name != "twist" else "") for value in values]
        rows.append(render(panels, SIZE, captions=captions).pixels)
    if options.picture:
        picture = np.concatenate(rows)
        save(Image.fromarray(picture).quantize(COLOURS, dither=Image.Dither.NONE), options.picture)
    return int(not ok)


def middle(groom: Groom) -> Groom:
    """Strands in the middle of their panel."""
    left, right = groom.points[:, 0].min(), groom.points[:, 0].max()
    return replace(groom, points=groom.points - [0.5 * (left + right), 0.0, 0.0])


if __name__ == "__main__":
    sys.exit(main())
