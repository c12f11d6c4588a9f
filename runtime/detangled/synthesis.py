"""A texture and arc lengths in, signals of new strands out: paper, section "Strand Synthesis".

Strands are made in batches of one grid, each from a stream of random numbers of its own.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from detangled.base_texture import Texture
from detangled.diffusion.sampler import DEFAULT_STEPS
from detangled.diffusion.steering import with_arcs
from detangled.engines import Engine, engine_of
from detangled.groom import offsets_of

BATCH = 128  # strands denoised at once: some megabytes
_HAND = 2  # tells what chooses a hand from the stream that noise is drawn from


def synthesise(
    texture: Texture,
    arcs: NDArray[np.float64],
    names: NDArray[np.int64],
    seed: int = 0,
    steps: int = DEFAULT_STEPS,
    progress: Callable[[int], object] | None = None,
    engine: Engine | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Signals (C, 3) of new strands of a texture, one after another, and where each starts, (S + 1,).

    arcs: (S,), arc lengths [cm]; the mean of each strand's v equals its own. names: (S,), numbers that tell strands
    apart: a strand depends on the seed, its own name and its number of cells, and not on the others.
    progress: told how many strands were finished. engine: what draws them, ``engine_of`` the texture where None; to
    make one anew loads networks.
    """
    engine = engine or engine_of(texture)
    cells = texture.grid_cells(arcs)
    starts = offsets_of(cells)
    out = np.empty((starts[-1], 3))
    for size in np.unique(cells):
        members = np.flatnonzero(cells == size)
        for first in range(0, len(members), BATCH):
            batch = members[first : first + BATCH]
            rows = starts[batch][:, None] + np.arange(size)
            generators = [np.random.default_rng([seed, int(name)]) for name in names[batch]]
            made = engine.draw(int(size), arcs[batch], generators, steps)
            if texture.both_hands:
                hands = [np.random.default_rng([seed, int(name), _HAND]).choice([-1.0, 1.0]) for name in names[batch]]
                made[:, :, 1] *= np.array(hands)[:, None]
            out[rows] = with_arcs(made, arcs[batch])
            if progress is not None:
                progress(len(batch))
    return out, starts
