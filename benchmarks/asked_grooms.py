"""Textures asked for by a type or by numbers, on real grooms: what the files written are like.

python benchmarks/asked_grooms.py [FOLDER] [--method library] [--every eve=20,bob=4,combover=100] [--seed 0]

eve, bob and combover (every so many of their strands) each take type 4B, type 3A, and a radius that falls from 6 mm at
the root to 2 mm at the tip; each is written to FOLDER (or a temporary one) and read again. Printed are how far roots
moved, the worst length along the guide, the median distance of new guides from the input's in mean radii, and how far
the median radius and wavelength of strands of six turns or more are off those asked for: by winding about the guide
that they were put on, and about their own axis found anew, which follows curls of few turns a little; and by the
labelers of benchmarks/judge, which had no part in the making. Of the profile the radius of each third of a strand is
told by winding; winding finds wider coils where there are many twists. The grooms are looked for in DETANGLED_GROOMS,
else in shared/grooms beside the repository. Exits 1 where a bound fails.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

import detangled
import measures
from detangled import Groom, Options
from detangled.from_numbers import DEFAULT_METHOD, METHODS, Asked, asked, asked_texture
from detangled.geometry.winding import winding
from detangled.grooming.guides import style_guides
from detangled.models import LABELER, load_labeler
from detangled.texture import hair_type, parse_profile

GROOMS = Path(os.environ.get("DETANGLED_GROOMS", Path(__file__).resolve().parents[2] / "shared" / "grooms"))
EVERY = "eve=20,bob=4,combover=100"
WANTED = {
    "4B": asked(hair_type("4B")),
    "3A": asked(hair_type("3A")),
    "6mm-2mm": asked(radius=parse_profile("6mm:2mm", "radius")),
}
LENGTH_BOUND, GUIDE_BOUND, SIZE_BOUND = 1e-3, 1.0, 0.05
FEWEST_TURNS = 6.0
BY_WINDING = 0.2  # twist prevalence up to which winding judges


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--method", choices=METHODS, default=DEFAULT_METHOD)
    parser.add_argument("--every", default=EVERY, help=f"default: {EVERY}")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    every = {name: int(count) for name, count in (part.split("=") for part in options.every.split(","))}
    if missing := [name for name in every if not (GROOMS / f"{name}.abc").is_file()]:
        print(f"not in {GROOMS}: {', '.join(missing)}", file=sys.stderr)
        return 3
    textures = {name: asked_texture(what, options.method) for name, what in WANTED.items()}
    ok = True
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for source, step in every.items():
            whole = detangled.read(GROOMS / f"{source}.abc")
            groom = style_guides(whole.select(np.arange(0, whole.strand_count, step))).groom
            detangled.write(groom, folder / f"{source}.abc")
            for name, texture in textures.items():
                path = folder / f"{source}_{name}.abc"
                detangled.write(detangled.retexture(groom, texture, Options(seed=options.seed)).groom, path)
                new = detangled.read(path, unit="m")
                ok &= judge(f"{source} {name}", new, groom, WANTED[name])
    return int(not ok)


def judge(title: str, new: Groom, groom: Groom, what: Asked) -> bool:
    """Print what a new groom is like, beside what was asked for."""
    found = style_guides(groom)
    guides = found.as_groom()
    moved = np.linalg.norm(new.points[new.offsets[:-1]] - groom.points[groom.offsets[:-1]], axis=1).max()
    off = float(np.abs(measures.guide_length_errors(new, guides)).max())
    radius, wavelength = (float(np.exp(np.log(p.values).mean())) for p in (what.radius, what.wavelength))
    away = float(np.median(measures.distances(style_guides(new).as_groom(), guides)) / np.mean(what.radius.values))
    long = found.lengths >= FEWEST_TURNS * wavelength
    print(
        f"{title}: {new.strand_count} strands, roots moved {moved:.1g} cm, length off {off:.2%}, "
        f"guides off {away:.2f} radii; {np.count_nonzero(long)} of six turns or more"
    )
    ok = moved <= 1e-4 and off <= LENGTH_BOUND and away <= GUIDE_BOUND
    if long.any():
        some = new.select(long)
        own = measures.own_axis(some)
        labels = detangled.label(some, model=load_labeler(LABELER, measures.JUDGE))
        given = measures.given_axis(some, guides.select(np.flatnonzero(long)))
        told = {
            "winding about the guide": winding(given.points, given.offsets),
            "winding about the own axis": winding(own.points, own.offsets),
            "judge": (labels.radius, labels.wavelength),
        }
        for by, sizes in told.items():
            errors = [float(np.nanmedian(s)) / want - 1.0 for s, want in zip(sizes, (radius, wavelength), strict=True)]
            counts = what.radius.constant and by == ("winding about the guide" if what.twist <= BY_WINDING else "judge")
            if counts:
                ok &= max(map(abs, errors)) <= SIZE_BOUND
            print(f"  by {by}: radius {errors[0]:+.1%}, wavelength {errors[1]:+.1%}{' (judges)' if counts else ''}")
        print(f"  twist {np.nanmedian(labels.twist):.2f} of {what.twist:.2f}")
        if not what.radius.constant:
            thirds = [
                np.array_split(own.points[a:b], 3) for a, b in zip(own.offsets[:-1], own.offsets[1:], strict=True)
            ]
            radii = [
                float(np.median([np.hypot(part[k][:, 0], part[k][:, 1]).mean() for part in thirds])) for k in range(3)
            ]
            wanted = [float(what.radius(np.array([at]))[0]) for at in (1 / 6, 1 / 2, 5 / 6)]
            print(
                "  radius by thirds [cm]: "
                + ", ".join(f"{r:.2f} of {w:.2f}" for r, w in zip(radii, wanted, strict=True))
            )
            ok &= radii[0] > radii[1] > radii[2]
    print(f"  {'ok' if ok else 'FAIL'}", flush=True)
    return ok


if __name__ == "__main__":
    sys.exit(main())
