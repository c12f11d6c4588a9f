"""A whole groom as hair of type 4B on its head: how dense it gets, and how much of it is in the head.

python benchmarks/on_head.py [FOLDER] [--every 1] [--seed 0]

eve.abc (every so many of its strands) is retextured by the command, with vitruvian_head.obj, and written to FOLDER (or
a temporary one). Printed are how many times as many style guides there are as before, beside the squared ratio of
radii, and how many points of the file written are inside the head, the first 3 mm at roots apart: by winding numbers
of its triangles and by exact distances, not by the grid that hair is kept out with. With a FOLDER, pictures from the
front, the side and above lie there too. The files are looked for in DETANGLED_GROOMS, else in shared/grooms beside the
repository. Exits 1 where a bound fails.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import detangled
from detangled import Groom
from detangled.formats.meshes import read_head
from detangled.from_numbers import asked, asked_texture
from detangled.grooming.density import density_change
from detangled.grooming.guides import style_guides
from detangled.grooming.head_distance import exact_distances
from detangled.grooming.head_inside import INSIDE, WindingTree, winding_numbers, winding_tree
from detangled.grooming.interpenetration import ROOT
from detangled.head import Head
from detangled.texture import hair_type
from detangled.view.picture import render, save

GROOMS = Path(os.environ.get("DETANGLED_GROOMS", Path(__file__).resolve().parents[2] / "shared" / "grooms"))
HEAD = "heads/vitruvian_head.obj"
TYPE = "4B"
DENSITY_BOUND = 0.1  # of the squared ratio
INSIDE_BOUND = 1e-3  # of the points
DEEPER_BOUND = 0.05  # [cm] than the deepest of the input
VIEWS = ("front", "side", "top")
PICTURE = (900, 900)  # [px] of either panel


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    if missing := [name for name in ("eve.abc", HEAD) if not (GROOMS / name).is_file()]:
        print(f"skipped: {', '.join(missing)} not in {GROOMS}; say where with DETANGLED_GROOMS")
        return 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        source, target = folder / "eve.abc", folder / f"eve_{TYPE}.abc"
        whole = detangled.read(GROOMS / "eve.abc", unit="m")
        detangled.write(whole.select(np.arange(0, whole.strand_count, options.every)), source)
        began = time.perf_counter()
        given = [source, target, "--type", TYPE, "--unit", "m", "--head", GROOMS / HEAD, "--head-unit", "m"]
        verb = [sys.executable, "-m", "detangled_cli.main", "retexture"]
        subprocess.run([*verb, *map(str, given), "--seed", str(options.seed)], check=True)
        print(f"retextured and written in {time.perf_counter() - began:.0f} s")
        old, new = detangled.read(source, unit="m"), detangled.read(target, unit="m")
        head = read_head(GROOMS / HEAD, unit="m")
        ok = judge(old, new, head)
        if options.folder:
            for view in VIEWS:
                names = (source.name, target.name)
                save(render([old, new], PICTURE, view, captions=names, head=head), folder / f"eve_{TYPE}_{view}.png")
    print("ok" if ok else "FAIL")
    return int(not ok)


def judge(old: Groom, new: Groom, head: Head) -> bool:
    """Print how dense a new groom is, and what of it is in the head, beside the old one."""
    asked_for = density_change(style_guides(old), asked_texture(asked(hair_type(TYPE))).radius)
    rise = new.strand_count / old.strand_count
    off = rise / asked_for.factor - 1.0
    print(f"{old.strand_count} style guides to {new.strand_count}: {rise:.2f} times, {off:+.1%} of what is asked for:")
    print(f"  radius {asked_for.input_radius:.3f} cm to {asked_for.target_radius:.3f} cm, {asked_for.factor:.2f} times")
    tree = winding_tree(head)
    before, after = depths(old, tree), depths(new, tree)
    for name, found in (("before", before), ("after", after)):
        share = np.count_nonzero(found > 0.0) / len(found)
        print(
            f"inside {name}: {np.count_nonzero(found > 0.0)} of {len(found)} points ({share:.5%}), "
            f"deeper than {DEEPER_BOUND} cm {np.count_nonzero(found > DEEPER_BOUND)}, deepest {found.max():.2f} cm"
        )
    return (
        abs(off) <= DENSITY_BOUND
        and np.count_nonzero(after > 0.0) < INSIDE_BOUND * len(after)
        and after.max() <= before.max() + DEEPER_BOUND
    )


def depths(groom: Groom, tree: WindingTree) -> NDArray[np.float64]:
    """How deep [cm] each point (P,) is in a head, 0 where it is outside; without the first 3 mm of each strand."""
    sizes = np.linalg.norm(np.diff(groom.points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(sizes)])
    along -= np.repeat(along[groom.offsets[:-1]], groom.point_counts)
    points = groom.points[along > ROOT]
    found = np.zeros(len(points))
    inside = winding_numbers(tree, points) > INSIDE
    found[inside] = np.abs(exact_distances(tree, points[inside]))
    return found


if __name__ == "__main__":
    sys.exit(main())
