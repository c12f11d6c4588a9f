"""The two engines on a few strands: patches, and the network trained on them.

python benchmarks/engines.py [--steps 100,300] [--strands 12] [--picture OUT.png]

Twelve strands of coily_swatch.obj are fitted by both engines, and two of them as in the paper's figure of small
inputs. New strands are drawn as long as the targets and measured about the axes found in them, as targets are: radius
and wavelength by winding, Wasserstein-1 of curvature and torsion to the strands of the swatch that were not shown (over
the distance of the shown ones to those), and how near the nearest target is, over how near targets are to each other.
Then how a fit grows with its steps, and the training loss of the default. Kernels are compiled before. --picture draws
targets and new strands beside each other. The swatch is looked for in DETANGLED_GROOMS, else in shared/grooms beside
the repository.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
from pathlib import Path

import numpy as np

import detangled
import measures
from detangled import Groom
from detangled.diffusion.finetune import FineTuning
from detangled.diffusion.whitening import Whitening
from detangled.fitted import FINETUNE, METHODS, FittedTexture
from detangled.generation import generate
from detangled.geometry.winding import winding
from detangled.grooming.guides import style_guides

GROOMS = Path(os.environ.get("DETANGLED_GROOMS", Path(__file__).resolve().parents[2] / "shared" / "grooms"))
SHOWN, FEW = 12, 2
NEW = 48
SEED = 0
SECONDS_BOUND, MEGABYTES_BOUND = 480.0, 3072.0
IN_PICTURE = 6
APART = 3.0  # [cm] between strands of a picture
HEADER = f"{'':34}{'seconds':>9}{'radius':>9}{'wavelength':>12}{'W1 kappa':>10}{'W1 |tau|':>10}{'nearest':>9}"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", default="100,300", help="of fits to be compared")
    parser.add_argument("--strands", type=int, default=SHOWN)
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args(arguments)
    swatch = detangled.read(GROOMS / "coily_swatch.obj")
    order = np.random.default_rng(SEED).permutation(swatch.strand_count)
    rest = swatch.select(np.sort(order[options.strands :]))
    detangled.fit(swatch.select([0, 1, 2]))  # compiles, or loads what was compiled

    print(HEADER)
    ok = True
    columns = []
    for count in (options.strands, FEW):
        targets = swatch.select(np.sort(order[:count]))
        scale = Scale(targets, rest)
        scale.report(f"{count} targets themselves", 0.0, measures.own_axis(scale.targets), None)
        made = [standing(targets, "targets")]
        for method in METHODS:
            curve: list[tuple[int, float]] = []
            began = time.perf_counter()
            texture = detangled.fit(
                targets, method, progress=lambda step, most, loss, to=curve: to.append((step, loss))
            )
            seconds = time.perf_counter() - began
            canonical = drawn(texture)
            scale.report(f"{count} targets, {method}", seconds, canonical, texture)
            made.append(standing(Groom(canonical.points, canonical.offsets), method))
            if method == FINETUNE:
                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (
                    2**20 if sys.platform == "darwin" else 2**10
                )
                within = seconds <= SECONDS_BOUND and peak <= MEGABYTES_BOUND
                ok &= within
                losses = ", ".join(f"{step}: {mean(curve, step):.3f}" for step in range(100, len(curve) + 1, 100))
                print(f"    {len(curve)} steps, peak of the process {peak:.0f} MB {'ok' if within else 'FAIL'}")
                print(f"    loss by step, means of 100: {losses}")
        columns.append(made)
    targets = swatch.select(np.sort(order[: options.strands]))
    scale = Scale(targets, rest)
    for steps in (int(part) for part in options.steps.split(",")):
        began = time.perf_counter()
        texture = detangled.fit(targets, FINETUNE, FineTuning(most_steps=steps, evaluate_every=max(steps, 1)))
        scale.report(f"{options.strands} targets, {steps} steps", time.perf_counter() - began, drawn(texture), texture)
    if options.picture:
        draw(columns, options.picture)
    return int(not ok)


def mean(curve: list[tuple[int, float]], step: int) -> float:
    return float(np.mean([loss for at, loss in curve if step - 100 < at <= step]))


class Scale:
    """What new strands are measured against: the strands shown and those that were not."""

    def __init__(self, targets: Groom, rest: Groom) -> None:
        texture = detangled.fit(targets)
        self.cell_width = texture.cell_width
        step = texture.turn / 16.0
        self.targets, others = measures.refined(targets, step), measures.refined(rest, step)
        self.shown = measures.strand_signals(measures.own_axis(self.targets), self.cell_width)
        self.rest = measures.strand_signals(measures.own_axis(others), self.cell_width)
        self.floor = measures.wasserstein(self.shown, self.rest)
        self.whitening = Whitening.of(self.shown)

    def report(self, name: str, seconds: float, canonical: measures.Canonical, texture: FittedTexture | None) -> None:
        radius, wavelength = (float(np.nanmedian(v)) for v in winding(canonical.points, canonical.offsets))
        found = measures.strand_signals(canonical, self.cell_width)
        away = [value / floor for value, floor in zip(measures.wasserstein(found, self.rest), self.floor, strict=True)]
        length = min(len(signal) for signal in self.shown + found)
        targets = measures.windows(self.shown, self.whitening, length)
        between = measures.nearest(targets, targets, True).min()
        new = measures.windows(found, self.whitening, length)
        near = measures.nearest(new, targets, texture is None).min() / between
        print(
            f"{name:34}{seconds:9.1f}{radius:9.3f}{wavelength:12.3f}{away[0]:10.2f}{away[1]:10.2f}{near:9.2f}",
            flush=True,
        )


def drawn(texture: FittedTexture) -> measures.Canonical:
    """New strands of a texture, each as long as one of those it was fitted to, in canonical space."""
    arcs = np.array(
        [texture.signals[a:b, 2].mean() for a, b in zip(texture.starts[:-1], texture.starts[1:], strict=True)]
    )
    return measures.own_axis(generate(texture, NEW, np.resize(arcs, NEW), SEED))


def standing(groom: Groom, name: str) -> tuple[Groom, str]:
    """Some strands in canonical space, hung beside each other."""
    canonical = style_guides(groom.select(np.arange(min(IN_PICTURE, groom.strand_count))))
    points, offsets = canonical.canonical(), canonical.groom.offsets
    shift = np.repeat(np.arange(len(offsets) - 1) * APART, np.diff(offsets))
    return Groom(points + shift[:, None] * [1.0, 0.0, 0.0], offsets, up="z"), name


def draw(rows: list[list[tuple[Groom, str]]], path: Path) -> None:
    from PIL import Image

    from detangled.view.picture import render

    pictures = [
        render([groom for groom, _ in row], (560, 480), "front", [name for _, name in row], perspective=False).image()
        for row in rows
    ]
    sheet = Image.new("RGB", (pictures[0].width, sum(picture.height for picture in pictures)))
    for k, picture in enumerate(pictures):
        sheet.paste(picture, (0, k * picture.height))
    sheet.save(path)
    print(f"{path}: targets and new strands, from {rows[0][0][0].strand_count} and {rows[1][0][0].strand_count} shown")


if __name__ == "__main__":
    sys.exit(main())
