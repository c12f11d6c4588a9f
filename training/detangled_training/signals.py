"""Strands as signals for training: straightened into canonical space, then kappa, tau and v on a grid.

Paper section "Data Generation and Curation". Twists tilt a strand's axis at random; its centreline takes that away.
A centreline needs turns to be found, so every strand is made with more hair before its root and beyond its tip, is
straightened whole, and is cut: then a wave of a single turn is texture too, as it was asked, and the ends of the axis,
known least well, are gone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.diffusion.whitening import Whitening
from detangled.geometry.centerline import LEAST_CURL, centerlines
from detangled.geometry.signal import signals
from detangled.geometry.winding import STRAIGHT_RADIUS, winding
from detangled.groom import offsets_of
from detangled.grooming.guides import to_canonical
from detangled.labeling import LOWER_PART
from detangled.texture import arc_of_a_turn
from detangled_training.strands import Recipes, Strands

# Turns that a strand is straightened with, and how many of them at least lie beyond each end.
FEWEST_TURNS = 8.0
DROPPED_TURNS = 1.5
# Weak waves show to the centreline over many turns only; a strand that needs more than so many is straight already,
# and a twist tilts it by less than 7 degrees.
MOST_TURNS = 24.0
CURL_MARGIN = 1.2  # on what the centreline asks for


@dataclass(frozen=True)
class Straightened:
    """Strands in canonical space: points (P, 3) [cm], offsets (S + 1,), and for which of them an axis was found."""

    points: NDArray[np.float64]
    offsets: NDArray[np.int64]
    found: NDArray[np.bool_]


def pooled_whitening(values: NDArray[np.floating]) -> Whitening:
    """The whitening that suits all cells of signals (S, L, 3) together; some thousands of signals say enough."""
    return Whitening.of(list(values.astype(np.float64)))


def margins(recipes: Recipes) -> NDArray[np.float64]:
    """How much more hair [cm] each strand (S,) needs at either end to be straightened; 0 where it is straight."""
    radius, wavelength = recipes.radius.mean(axis=1), recipes.wavelength.mean(axis=1)
    turn = arc_of_a_turn(radius, wavelength)
    # What the centreline asks of a curl: its slope, squared, times its turns squared.
    least = CURL_MARGIN * np.sqrt(LEAST_CURL) * turn / (2.0 * np.pi * radius)
    turns = recipes.length / turn
    missing = 0.5 * (np.maximum(least, FEWEST_TURNS) - turns)
    return np.where(least > MOST_TURNS, 0.0, np.maximum(missing, DROPPED_TURNS) * turn)


def straightened(strands: Strands, guides: NDArray[np.float64] | None = None) -> Straightened:
    """The bodies of strands in canonical space, cut from the whole; where no axis is found they stay as they are.

    guides: (P, 3), their axes where they are known.
    """
    if guides is None:
        guides, _ = centerlines(strands.points, strands.offsets)
    canonical = to_canonical(strands.points, guides, strands.offsets)
    # A strand without curl is its own centreline, and would lie on the axis.
    found = winding(canonical, strands.offsets)[0] >= STRAIGHT_RADIUS
    counts = np.diff(strands.body, axis=1)[:, 0]
    offsets = offsets_of(counts)
    rows = np.arange(offsets[-1]) + np.repeat(strands.body[:, 0] - offsets[:-1], counts)
    points = np.where(np.repeat(found, counts)[:, None], canonical[rows], strands.points[rows])
    return Straightened(points, offsets, found)


def on_grids(
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    turns: NDArray[np.float64],
    cells_per_turn: float,
    share: NDArray[np.float64],
    out: NDArray[np.float32],
) -> NDArray[np.float64]:
    """Fill ``out`` (S, L, C) with C channels of signals; return the part [t0, t1] (S, 2) of its strand each covers.

    Strands are points (P, 3) [cm] by offsets (S + 1,). A strand of more turns (S,) than L cells can hold is put on a
    finer grid; ``share`` (S,) in [0, 1) says which stretch of it is taken.
    """
    cells = out.shape[1]
    grids = np.maximum(cells, np.ceil(turns * cells_per_turn).astype(np.int64))
    starts = offsets_of(grids)
    values = signals(points, offsets, starts)
    begin = np.minimum((share * (grids - cells + 1)).astype(np.int64), grids - cells)
    # v is per t of the whole strand: per t of the stretch it is less.
    values[:, 2] *= np.repeat(cells / grids, grids)
    out[:] = values[(starts[:-1] + begin)[:, None] + np.arange(cells), : out.shape[2]]
    return np.stack([begin / grids, (begin + cells) / grids], axis=1)


def lower_begin(position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where the lower part (S,) of signals begins that cover the parts [t0, t1] (S, 2) of their strands."""
    return position[:, 1] - LOWER_PART * (position[:, 1] - position[:, 0])
