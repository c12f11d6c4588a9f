"""A texture and arc lengths in, signals of new strands out.

Paper sections "Inference" and "Strand Synthesis": noise is denoised by the texture's own denoiser in the multistep
solver; at each step the predicted clean signal is given its length, which is linear in v, and a straight axis. What a
network draws is calibrated to the strands that it was fitted to; its short strands are pieces of longer ones.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext

import numpy as np
from numpy.typing import NDArray

from detangled.diffusion.calibration import calibrated
from detangled.diffusion.denoiser import NetworkDenoiser
from detangled.diffusion.patches import denoise_strands, plan_stretches
from detangled.diffusion.sampler import DEFAULT_STEPS, Denoiser, Guide, SamplerStep, sample
from detangled.diffusion.schedule import CosineSchedule
from detangled.diffusion.steering import steer_strands
from detangled.errors import ModelError
from detangled.fitted import FINETUNE, FittedTexture
from detangled.groom import offsets_of
from detangled.kernels import thread_count
from detangled.models import DENOISER, load_model

BATCH = 128  # strands denoised at once: some megabytes
CELL_MULTIPLE = 16  # strands of nearly one length share a grid, and so a batch
OFFERED = 12  # examples offered to each stretch of a strand
WIDEST_SHARE = 0.8  # of a stretch: the half-width of its widest patches
# The axis of a signal that is mostly noise means nothing.
STEER_BELOW = 1.0  # sigma / alpha
FEWEST_TURNS_TO_STEER = 12.0
_PIECE, _HAND = 1, 2  # tell what chooses a piece, and what a hand, from the stream that noise is drawn from


def grid_cells(texture: FittedTexture, arcs: NDArray[np.float64]) -> NDArray[np.int64]:
    """Cells (S,) on which strands of these arc lengths [cm] keep cells about as wide as the texture's."""
    blocks = np.round(arcs / (texture.cell_width * CELL_MULTIPLE))
    return CELL_MULTIPLE * np.maximum(blocks, 1).astype(np.int64)


def synthesise(
    texture: FittedTexture,
    arcs: NDArray[np.float64],
    names: NDArray[np.int64],
    seed: int = 0,
    steps: int = DEFAULT_STEPS,
    progress: Callable[[int], object] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Signals (C, 3) of new strands of a texture, one after another, and where each starts, (S + 1,).

    arcs: (S,), arc lengths [cm]; the mean of each strand's v equals its own. names: (S,), numbers that tell strands
    apart: a strand depends on the seed, its own name and its number of cells, and not on the others.
    progress: told how many strands were finished.
    """
    network = _network(texture)
    shown = int(grid_cells(texture, np.array([texture.median_arc]))[0])
    cells = grid_cells(texture, arcs)
    starts = offsets_of(cells)
    out = np.empty((starts[-1], 3))
    for size in np.unique(cells):
        members = np.flatnonzero(cells == size)
        # To the network short hair is a piece, from anywhere, of a strand as long as those it was shown.
        drawn = max(int(size), shown if network else 0)
        for first in range(0, len(members), BATCH):
            batch = members[first : first + BATCH]
            rows = starts[batch][:, None] + np.arange(size)
            made = _sample_batch(texture, network, drawn, arcs[batch] * (drawn / size), names[batch], seed, steps)
            begin = [
                np.random.default_rng([seed, int(name), _PIECE]).integers(drawn - size + 1) for name in names[batch]
            ]
            made = made[np.arange(len(batch))[:, None], np.array(begin)[:, None] + np.arange(size)]
            if texture.both_hands:
                hands = [np.random.default_rng([seed, int(name), _HAND]).choice([-1.0, 1.0]) for name in names[batch]]
                made[:, :, 1] *= np.array(hands)[:, None]
            out[rows] = with_arcs(made, arcs[batch])
            if progress is not None:
                progress(len(batch))
    return out, starts


def with_arcs(values: NDArray[np.float64], arcs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Signals (B, L, 3) of strands of these arc lengths (B,) [cm]: v is scaled, which leaves kappa and tau alone."""
    out = values.copy()
    out[:, :, 2] *= (arcs / values[:, :, 2].mean(axis=1))[:, None]
    return out


def _network(texture: FittedTexture) -> NetworkDenoiser | None:
    """The network trained on the texture's strands; None where it is drawn by patches."""
    if texture.method != FINETUNE:
        return None
    model = load_model(DENOISER)
    if model.architecture != texture.architecture or model.parameters != len(texture.weights):
        raise ModelError(f"the texture was fitted with another network than {model.path}: fit it again")
    return NetworkDenoiser(model, texture.weights, thread_count())


def _sample_batch(
    texture: FittedTexture,
    network: NetworkDenoiser | None,
    cells: int,
    arcs: NDArray[np.float64],
    names: NDArray[np.int64],
    seed: int,
    steps: int,
) -> NDArray[np.float64]:
    """Signals (B, cells, 3) of strands on one grid."""
    generators = [np.random.default_rng([seed, int(name)]) for name in names]
    noise = np.stack([rng.standard_normal((3, cells)) for rng in generators])
    denoise: Denoiser = network or _patch_denoiser(texture, cells, generators)
    # A network of senseless weights predicts whatever it may: that is told of below, once.
    with nullcontext() if network is None else np.errstate(all="ignore"):
        channels = sample(denoise, noise, CosineSchedule(), steps, _guide(texture, cells, arcs))
        if texture.calibration.size:
            channels = calibrated(channels, texture.calibration)
        values = with_arcs(texture.whitening.restore(channels), arcs)
    if network is not None and not np.isfinite(values).all():
        raise ModelError("the texture's network predicts no finite strands, its weights are damaged: fit it again")
    return values


def _patch_denoiser(texture: FittedTexture, cells: int, generators: list[np.random.Generator]) -> Denoiser:
    """The closed-form denoiser for a batch of strands, each with examples of its own."""
    lengths = texture.cells
    stretches = int(np.ceil(2.0 * cells / np.median(lengths)))
    bounds = np.round(np.linspace(0, cells, stretches + 1)).astype(np.int64)
    plans = [plan_stretches(rng, lengths, cells, bounds, min(OFFERED, max(len(lengths), 4))) for rng in generators]
    chosen = np.stack([plan[0] for plan in plans])
    diagonals = np.stack([plan[1] for plan in plans])
    examples = texture.channels
    widest = max(1, int(WIDEST_SHARE * cells / stretches))
    schedule = texture.schedule

    def denoise(noisy: NDArray[np.float64], alpha: float, sigma: float) -> NDArray[np.float64]:
        half_width = min(schedule.half_width(alpha, sigma), widest)
        return denoise_strands(
            noisy, alpha, sigma, examples, texture.starts, bounds, chosen, diagonals, half_width, schedule.window
        )

    return denoise


def _guide(texture: FittedTexture, cells: int, arcs: NDArray[np.float64]) -> Guide:
    """What every predicted clean signal is given: the arc length asked for, in closed form, and a straight axis."""
    whitening = texture.whitening
    # By the grid, not the arc lengths of this batch: a strand must not depend on its neighbours.
    steered = cells * texture.cell_width > FEWEST_TURNS_TO_STEER * texture.turn

    def guide(channels: NDArray[np.float64], step: SamplerStep) -> NDArray[np.float64]:
        values = with_arcs(whitening.restore(channels), arcs)
        if steered and step.sigma < STEER_BELOW * step.alpha:
            values = steer_strands(values, texture.turn)
        return whitening.whiten(values)

    return guide
