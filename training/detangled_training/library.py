"""A library of strands whose numbers are known: what a texture that is asked for by its numbers is drawn from.

Strands hang wet, as those that networks are trained on; hair that its weight pulls straight, or whose rest was not
found, is as constructed. They are kept whole, in canonical space, with as many points a turn as new strands have.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detangled.archives import write_arrays
from detangled.errors import TextureError
from detangled.fitting import POINTS_PER_TURN
from detangled.formats import replacing
from detangled.geometry.arc import arc_lengths
from detangled.geometry.centerline import centerlines
from detangled.geometry.waves import is_weak, wave_axes
from detangled.geometry.winding import winding
from detangled.groom import Groom, offsets_of
from detangled.grooming.placing import resample
from detangled.models import FILES, FORMAT, LIBRARY, VERSION
from detangled.texture import LENGTH_LIMITS, arc_of_a_turn
from detangled_training.provenance import commit, make_folder
from detangled_training.signals import straightened
from detangled_training.strands import Recipes, Strands, draw_recipes, make_strands
from detangled_training.variants import hung_strands, means_between

CHUNK = 200  # strands made at once: some tens of megabytes
UNTYPED = 0.5  # share of strands of no type
# More turns say no more of a texture; of fewer an axis is not to be had.
TURNS = (8.0, 14.0)
MOST_OFF = 1.6  # twists wind too: a strand of many has up to this times the radius and wavelength of its twin
MARGIN_TURNS = 2.0  # of more hair at either end, where axes are known least well

Columns = dict[str, NDArray[Any]]


def write_library(
    folder: Path, count: int, seed: int, progress: Callable[[int], object] | None = None
) -> tuple[Path, int]:
    """Write library.npz and its manifest into a folder; return its path, and how many strands it has.

    Raises WriteError, and what ``make_library`` raises.
    """
    make_folder(folder)
    columns = make_library(count, seed, progress)
    path = folder / FILES[LIBRARY]
    strands = len(columns["radius"])
    with replacing(path) as beside:
        write_arrays(beside, columns)
        digest = hashlib.sha256(beside.read_bytes()).hexdigest()
    manifest = {
        "format": FORMAT,
        "version": VERSION,
        "kind": LIBRARY,
        "sha256": digest,
        "strands": strands,
        "training": {"commit": commit(), "count": count, "seed": seed, "untyped": UNTYPED, "turns": TURNS},
    }
    with replacing(path.with_suffix(".json")) as beside:
        beside.write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
    return path, strands


def make_library(count: int, seed: int, progress: Callable[[int], object] | None = None) -> Columns:
    """Canonical strands as arrays: points (P, 3) float32 [cm], offsets (S + 1,), and their numbers, (S,) each.

    radius, wavelength [cm]: means over the strand, without twists. twists: how many there are. Of ``count`` base
    strands those are left out whose axis is not found. progress: told how many were finished.
    """
    if count < 1:
        raise TextureError(f"a library needs strands, not {count}")
    parts: list[Columns] = []
    for first in range(0, count, CHUNK):
        size = min(CHUNK, count - first)
        parts.extend(_canonical(*made) for made in _made(_recipes(size, seed, first), seed))
        if progress is not None:
            progress(size)
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    if len(columns["number"]) == 0:
        raise TextureError(f"of {count} strands none has an axis: make more")
    # By their numbers, however many were made at once.
    order = np.argsort(columns.pop("number"))
    strands = Groom(columns.pop("points"), offsets_of(columns.pop("counts"))).select(order)
    sorted_columns = {name: values[order] for name, values in columns.items()}
    return {"points": strands.points.astype(np.float32), "offsets": strands.offsets, **sorted_columns}


def _recipes(count: int, seed: int, first: int) -> Recipes:
    recipes = draw_recipes(count, seed, first, untyped=UNTYPED)
    turn = arc_of_a_turn(recipes.radius.mean(axis=1), recipes.wavelength.mean(axis=1))
    return replace(recipes, length=np.minimum(np.clip(recipes.length / turn, *TURNS) * turn, LENGTH_LIMITS[1]))


def _made(
    recipes: Recipes, seed: int
) -> Iterator[tuple[Strands, NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]]:
    """Strands, and number, radius and wavelength (S,) of each."""
    hung: list[int] = []
    margin = MARGIN_TURNS * arc_of_a_turn(recipes.radius.mean(axis=1), recipes.wavelength.mean(axis=1))
    for hanging in hung_strands(recipes, seed, 0, (False,), margin):
        count = len(hanging.recipes)
        means = means_between(hanging.radius, hanging.wavelength, np.zeros(count), np.ones(count))
        yield hanging.strands, hanging.recipes.number, *means
        hung.extend(hanging.recipes.number.tolist())
    straight = np.flatnonzero(~np.isin(recipes.number, hung))
    if len(straight):
        left = recipes.select(straight)
        strands = make_strands(left, seed, margin[straight])
        yield strands, left.number, strands.radius, strands.wavelength


def _canonical(
    strands: Strands, number: NDArray[np.int64], radius: NDArray[np.float64], wavelength: NDArray[np.float64]
) -> Columns:
    """Those of the strands that wind about as their numbers say: whose axis is found.

    Of weak waves it is the mean over a turn, as it is of strands drawn of them.
    """
    guides, _ = centerlines(strands.points, strands.offsets)
    weak = np.repeat(is_weak(radius, wavelength), np.diff(strands.offsets))
    waves = wave_axes(strands.points, strands.offsets, arc_of_a_turn(radius, wavelength))
    canonical = straightened(strands, np.where(weak[:, None], waves, guides))
    wound = winding(canonical.points, canonical.offsets)
    ratios = wound[0] / radius, wound[1] / wavelength
    kept = np.flatnonzero(canonical.found & np.all([(r > 1.0 / MOST_OFF) & (r < MOST_OFF) for r in ratios], axis=0))
    found = Groom(canonical.points, canonical.offsets).select(kept)
    radius, wavelength = radius[kept], wavelength[kept]
    turns = arc_lengths(found.points, found.offsets) / arc_of_a_turn(radius, wavelength)
    counts = np.ceil(POINTS_PER_TURN * turns).astype(np.int64) + 1
    return {
        "number": number[kept],
        "counts": counts,
        "points": resample(found.points, found.offsets, offsets_of(counts)),
        "radius": radius.astype(np.float32),
        "wavelength": wavelength.astype(np.float32),
        "twists": strands.twists[kept].astype(np.int32),
    }
