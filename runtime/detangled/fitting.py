"""Fitting a texture to a few strands.

They are mapped to canonical space and their signals measured, on a grid whose cells have one physical width; that is
all that the patch denoiser needs. The other engine trains the network on these signals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from detangled.diffusion.calibration import LONGER, calibration
from detangled.diffusion.finetune import FineTuning, StepProgress, curl_both_ways, fine_tune
from detangled.diffusion.sampler import DEFAULT_STEPS
from detangled.diffusion.whitening import Whitening
from detangled.drawing import off_by_wander
from detangled.engines import NetworkEngine
from detangled.errors import ModelError, TextureError
from detangled.fitted import FINETUNE, METHODS, PATCHES, FittedTexture
from detangled.geometry.arc import arc_lengths
from detangled.geometry.signal import signals
from detangled.geometry.winding import winding
from detangled.groom import Groom, offsets_of
from detangled.grooming.guides import style_guides
from detangled.grooming.lengths import Straightened, straightened
from detangled.grooming.placing import resample
from detangled.kernels import thread_count
from detangled.models import DENOISER, TRAINING_STEP, load_model, same_network
from detangled.usable import WHY_UNUSABLE, usable_strands

POINTS_PER_TURN = 16  # of a new strand, and of targets before they are measured
COARSE_CELLS = 512  # of a strand whose turns are only to be counted
# Pairs of strands so many times as long as the targets that are drawn to see how far they are off.
CALIBRATED_BY = (1.0, 48), (LONGER, 20)
CALIBRATION_SEED = 1 << 31
# Of strands that do not twist nine tenths of torsion is at most this share of median curvature beyond its median.
MOST_UNTWISTED = 0.5
MOST_STRANDS = 400  # beyond this many, evenly chosen ones say as much


@dataclass(frozen=True)
class Grid:
    """How finely signals are measured. most_cells, fewest_cells: of a strand of median length; shortest: of any."""

    cells_per_turn: float
    most_cells: int
    fewest_cells: int
    shortest: int


PATCH_GRID = Grid(22.0, 512, 64, 8)  # narrow cells cost little there, and keep curvature's spread
NETWORK_CELLS_PER_TURN, NETWORK_MOST_CELLS = 16.0, 512  # a window of 256 cells then holds 16 turns of coily hair


def fit(
    groom: Groom,
    method: str = PATCHES,
    fine_tuning: FineTuning | None = None,
    progress: StepProgress | None = None,
) -> FittedTexture:
    """Fit a texture to the strands of a groom, from one to some hundreds, of any point counts.

    method: PATCHES, which is done at once, or FINETUNE, which trains a network for minutes; ``fine_tuning`` says how,
    and ``progress`` is told of each step. Raises TextureError where no strand can be used, and ModelError where the
    network is missing or damaged.
    """
    if method == PATCHES:
        return measured(groom, PATCH_GRID)
    if method != FINETUNE:
        raise TextureError(f"there is no method {method!r}: it is one of {', '.join(METHODS)}")
    denoiser, step = load_model(DENOISER), load_model(TRAINING_STEP)
    if not same_network(denoiser, step):
        raise ModelError(f"{denoiser.path} and {step.path} are of different networks: export both anew")
    # At least as many cells as the network looks at. The whitening is the strands' own: in that of all hair, what tells
    # one strand of a texture from another would be too small for the network to learn.
    grid = Grid(NETWORK_CELLS_PER_TURN, max(NETWORK_MOST_CELLS, denoiser.cells), denoiser.cells, denoiser.cells)
    texture = measured(groom, grid)
    strands = [texture.whitening.whiten(texture.signals[a:b]) for a, b in pairwise(texture.starts)]
    tuned = fine_tune(strands, texture.whitening, step, denoiser.weights, fine_tuning, thread_count(), progress)
    texture = replace(texture, method=FINETUNE, weights=tuned.weights, architecture=denoiser.architecture)
    return replace(texture, calibration=_calibration(texture))


def _calibration(texture: FittedTexture) -> NDArray[np.float64]:
    """How far the strands that a network draws are off, as long as the targets and longer, (2, 2, 2, 2, Q)."""
    wanted = [texture.channels[:, a:b] for a, b in pairwise(texture.starts)]
    whitening, engine = texture.whitening, NetworkEngine(texture)
    # The network saw both hands alike.
    mirrored = whitening.mirrored if curl_both_ways(wanted, whitening) else None
    levels = []
    for times, pairs in CALIBRATED_BY:
        cells = int(texture.grid_cells(np.array([times * texture.median_arc]))[0])
        arcs = np.full(2 * pairs, times * texture.median_arc)
        # Of opposite noise come opposite chances: fewer strands tell as much.
        noise = np.random.default_rng(CALIBRATION_SEED).standard_normal((pairs, 3, cells))
        drawn = engine.sampled(np.concatenate([noise, -noise]), arcs, DEFAULT_STEPS)
        drawn = drawn[_let_pass(texture, engine.finished(drawn, arcs))]

        def as_made(channels: NDArray[np.float64], arcs: NDArray[np.float64] = arcs) -> NDArray[np.float64]:
            return whitening.whiten(_as_made(engine.finished(channels, arcs[: len(channels)]), texture))

        levels.append(calibration(drawn, wanted, as_made, mirrored))
    return np.stack(levels)


def _let_pass(texture: FittedTexture, values: NDArray[np.float64]) -> NDArray[np.int64]:
    """Which of the strands of signals (B, L, 3) would not be drawn anew; the straighter half at least."""
    off = off_by_wander(texture, _straightened(texture, values))
    return np.flatnonzero(~(off > max(1.0, float(np.median(off)))))


def _as_made(values: NDArray[np.float64], texture: FittedTexture) -> NDArray[np.float64]:
    """Signals (B, L, 3) of strands made of such signals, measured as targets are: straight, of POINTS_PER_TURN."""
    made = _straightened(texture, values)
    counts = np.ceil(POINTS_PER_TURN * values[:, :, 2].mean(axis=1) / texture.turn).astype(np.int64) + 1
    points = resample(made.points, made.offsets, offsets_of(counts))
    starts = np.arange(len(values) + 1) * values.shape[1]
    return signals(points, offsets_of(counts), starts).reshape(values.shape)


def _straightened(texture: FittedTexture, values: NDArray[np.float64]) -> Straightened:
    """Strands of signals (B, L, 3) as they are made, of their whole lengths."""
    count, cells, _ = values.shape
    return straightened(
        values.reshape(-1, 3), np.arange(count + 1) * cells, np.zeros(count, dtype=np.bool_), texture.axis
    )


def measured(groom: Groom, grid: Grid) -> FittedTexture:
    """What the strands of a groom are like, on such a grid: all there is to a texture by patches."""
    kept = np.flatnonzero(usable_strands(groom))
    if len(kept) == 0:
        raise TextureError(f"none of the {groom.strand_count} target strands can be used: {WHY_UNUSABLE}")
    if len(kept) > MOST_STRANDS:
        kept = kept[np.linspace(0, len(kept) - 1, MOST_STRANDS).round().astype(np.int64)]
    sparse = style_guides(groom.select(kept))
    turn = _arc_of_a_turn(sparse.canonical(), sparse.groom.offsets)
    # Centrelines, and so torsion, depend on how many points a turn has: as many as new strands are written with.
    guides = style_guides(_with_points_per_turn(sparse.groom, turn))
    return measured_canonical(guides.canonical(), guides.groom.offsets, guides.lengths, grid)


def measured_canonical(
    canonical: NDArray[np.float64], offsets: NDArray[np.int64], lengths: NDArray[np.float64], grid: Grid
) -> FittedTexture:
    """What strands in canonical space are like: points (P, 3) by offsets (S + 1,), and the lengths (S,) of their axes.

    They must have POINTS_PER_TURN points a turn.
    """
    arcs = arc_lengths(canonical, offsets)
    radius, wavelength = winding(canonical, offsets)
    median_arc = float(np.median(arcs))
    turn = _arc_of_a_turn(canonical, offsets)
    cell_width = float(
        np.clip(turn / grid.cells_per_turn, median_arc / grid.most_cells, median_arc / grid.fewest_cells)
    )
    cells = np.maximum(np.round(arcs / cell_width).astype(np.int64), grid.shortest)
    starts = offsets_of(cells)
    values = signals(canonical, offsets, starts)
    return FittedTexture(
        signals=values,
        starts=starts,
        whitening=Whitening.of([values[a:b] for a, b in pairwise(starts)]),
        cell_width=cell_width,
        turn=turn,
        median_arc=median_arc,
        arc_per_axis=float(np.median(arcs / np.maximum(lengths, 1e-12))),
        radius=float(np.median(radius)),
        wavelength=float(np.nanmedian(wavelength)) if np.isfinite(wavelength).any() else float("nan"),
        stiff=_untwisted(values),
    )


def _untwisted(values: NDArray[np.float64]) -> bool:
    """Whether strands of signals (C, 3) have hardly any twists, which would turn their axes."""
    usual, high = np.quantile(np.abs(values[:, 1]), [0.5, 0.9])
    return bool(high - usual <= MOST_UNTWISTED * np.median(values[:, 0]))


def _arc_of_a_turn(points: NDArray[np.float64], offsets: NDArray[np.int64]) -> float:
    """Arc length [cm] in which the frame of a helix with the median curvature and torsion turns once.

    At most the median strand's.
    """
    values = signals(points, offsets, np.arange(len(offsets), dtype=np.int64) * COARSE_CELLS)
    rate = float(np.median(np.hypot(values[:, 0], values[:, 1])))
    return min(2.0 * np.pi / max(rate, 1e-9), float(np.median(arc_lengths(points, offsets))))


def _with_points_per_turn(groom: Groom, turn: float) -> Groom:
    """The strands with at least POINTS_PER_TURN points in each arc length ``turn`` [cm], without attributes."""
    needed = np.ceil(POINTS_PER_TURN * arc_lengths(groom.points, groom.offsets) / turn).astype(np.int64) + 1
    offsets = offsets_of(np.maximum(needed, groom.point_counts))
    return replace(groom, points=resample(groom.points, groom.offsets, offsets), offsets=offsets, attributes={})
