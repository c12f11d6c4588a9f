"""Texture parameters of strands: paper, section "Labeling Texture Parameters".

Strands are straightened into canonical space, and kappa, tau and v of their lower sections are read by the exported
labelers. Beyond the paper they also read kappa and tau of the strand as it lies in the world: where twists make the
axis turn within a curl, straightening stretches that curl, and the strand itself tells better how wide it is.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from detangled.errors import ModelError
from detangled.geometry.arc import arc_lengths
from detangled.geometry.centerline import centerlines
from detangled.geometry.signal import signals
from detangled.geometry.winding import winding
from detangled.groom import Groom, offsets_of
from detangled.grooming.guides import to_canonical, usable_strands
from detangled.grooming.placing import resample
from detangled.kernels import parallel_kernel, prange, thread_count
from detangled.models import ExportedModel, load_labeler
from detangled.texture import HAIR_TYPES

LOWER_PART = 2.0 / 3.0  # of a signal: the lower section, by which people name the hair
CELLS = 256  # of the signals that are read
WORLD = 2  # channels beyond those of canonical space: kappa and tau of the strand as it lies in the world
CELLS_PER_TURN = 16.0  # at least: of a strand of many turns the lowest are read
CHUNK = 256  # strands measured at once: some tens of megabytes, of noisy ones some hundreds
MOST_CELLS = 8192  # of a whole strand
POINTS_PER_TURN = 16  # of strands that are measured: centrelines, and so torsion, depend on it
FEWEST_POINTS_PER_TURN = 3.0
MOST_POINTS = 20_000  # of a strand: what seems to need more is noise, not turns
STRAIGHT_RADIUS = 0.01  # [cm] about a hair's width: nobody sees such a curl


class Reading(IntEnum):
    """How a strand was read. READ: curls or waves. STRAIGHT: no curl to be found. The rest could not be read."""

    READ = 0
    STRAIGHT = 1
    UNUSABLE = 2  # a coordinate that is not finite, fewer than two distinct points, or longer than 20 m
    COARSE = 3  # too few points a turn to tell its curl


@dataclass(frozen=True)
class Labels:
    """What each strand (S,) of a groom is like.

    radius, wavelength [cm], twist (T_f): characteristic values of the lower section. NaN where the strand could not
    be read; a straight strand has radius 0, wavelength NaN and twist 0.
    length: [cm] of arc, NaN for an unusable strand. kind: int8, index of the nearest of HAIR_TYPES, -1 where the
    strand could not be read. reading: int8, a Reading.
    """

    radius: NDArray[np.float64]
    wavelength: NDArray[np.float64]
    twist: NDArray[np.float64]
    length: NDArray[np.float64]
    kind: NDArray[np.int8]
    reading: NDArray[np.int8]


def label(groom: Groom, progress: Callable[[int], object] | None = None, model: ExportedModel | None = None) -> Labels:
    """Read the texture of every strand of a groom. progress: told how many strands were finished.

    model: the labelers, those that come with detangled where None. Raises ModelError where they are missing or damaged.
    """
    model = model or load_labeler()
    kept = np.flatnonzero(usable_strands(groom))
    count = groom.strand_count
    radius, wavelength, twist, length = (np.full(count, np.nan) for _ in range(4))
    reading = np.full(count, Reading.UNUSABLE, dtype=np.int8)
    if progress is not None:
        progress(count - len(kept))
    network = LabelNetwork(model, thread_count())
    for first in range(0, len(kept), CHUNK):
        rows = kept[first : first + CHUNK]
        strands = groom.select(rows)
        lower = lower_signals(strands.points, strands.offsets)
        reading[rows], length[rows] = lower.reading, lower.length
        read = lower.reading == Reading.READ
        radius[rows[read]], wavelength[rows[read]], twist[rows[read]] = network(lower.values[read]).T
        straight = rows[lower.reading == Reading.STRAIGHT]
        radius[straight] = twist[straight] = 0.0
        if progress is not None:
            progress(len(rows))
    kind = np.full(count, -1, dtype=np.int8)
    kind[reading == Reading.STRAIGHT] = 0
    read = reading == Reading.READ
    kind[read] = nearest_types(radius[read], wavelength[read], twist[read])
    return Labels(radius, wavelength, twist, length, kind, reading)


class LabelNetwork:
    """Tells radius, wavelength [cm] and twist (T_f), (B, 3), of signals (B, CELLS, 3 or 5).

    Signals are kappa, tau [1/cm] and v [cm per t] in canonical space, and kappa and tau in the world. Without the
    latter a strand lies as it does in canonical space. What is told of a signal depends neither on the others nor on
    the number of threads.
    """

    def __init__(self, model: ExportedModel, threads: int = 1) -> None:
        _check_cells(model)
        self._session = model.session(1)
        self._channels = int(self._session.get_inputs()[0].shape[2])
        self._batch = model.batch
        self._threads = threads

    def __call__(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        if values.shape[2] < self._channels:
            values = np.concatenate([values, values[:, :, :WORLD]], axis=2)
        values = values[:, :, : self._channels]
        firsts = range(0, len(values), self._batch)
        with ThreadPoolExecutor(self._threads) as pool:
            found = list(pool.map(lambda a: self._run(values[a : a + self._batch]), firsts))
        return np.concatenate([np.empty((0, 3)), *found])

    def _run(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        (labels,) = self._session.run(None, {"signals": padded(values, self._batch)})
        return np.asarray(labels[: len(values)], dtype=np.float64)


class LabelGradient:
    """Labels (B, 3) of signals (B, CELLS, 3), and the gradient (B, CELLS, 3) of their sum by weights (B, 3).

    Strands lie as they do in canonical space. The gradient is by kappa, tau and v, so that whatever is made of labels
    can be moved downhill: its own derivatives by the labels are the weights.
    """

    def __init__(self, model: ExportedModel, threads: int = 1) -> None:
        _check_cells(model)
        self._session = model.session(1)
        self._batch = model.batch
        self._threads = threads

    def __call__(
        self, values: NDArray[np.float64], weights: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        firsts = range(0, len(values), self._batch)
        size = self._batch
        with ThreadPoolExecutor(self._threads) as pool:
            found = list(pool.map(lambda a: self._run(values[a : a + size], weights[a : a + size]), firsts))
        labels, gradients = ([part[k] for part in found] for k in (0, 1))
        return np.concatenate([np.empty((0, 3)), *labels]), np.concatenate([np.empty((0, CELLS, 3)), *gradients])

    def _run(
        self, values: NDArray[np.float64], weights: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        given = {"signals": padded(values, self._batch), "weights": padded(weights, self._batch)}
        labels, gradient = self._session.run(None, given)
        return labels[: len(values)].astype(np.float64), gradient[: len(values)].astype(np.float64)


def _check_cells(model: ExportedModel) -> None:
    if model.cells != CELLS:
        raise ModelError(
            f"{model.path}: reads signals of {model.cells} cells, not of {CELLS}: export the labelers anew"
        )


def padded(values: NDArray[np.float64], size: int) -> NDArray[np.float32]:
    """Values (B, ...) as float32, the first repeated up to ``size`` of them."""
    rows = np.zeros(size, dtype=np.int64)
    rows[: len(values)] = np.arange(len(values))
    return values[rows].astype(np.float32)


@dataclass(frozen=True)
class LowerSignals:
    """Signals of the lower sections of strands, (S, CELLS, 5), as ``LabelNetwork`` reads them; NaN if not READ.

    reading: (S,) int8, a Reading. length: (S,) [cm] of arc of the whole strand. part: (S,), the section's share of it.
    """

    values: NDArray[np.float64]
    reading: NDArray[np.int8]
    length: NDArray[np.float64]
    part: NDArray[np.float64]


def lower_signals(points: NDArray[np.float64], offsets: NDArray[np.int64]) -> LowerSignals:
    """Signals of strands (P, 3) [cm] by offsets (S + 1,), straightened; all must be usable (``usable_strands``)."""
    length = arc_lengths(points, offsets)
    turn = _turns(_straightened(points, offsets)[0], offsets, length)
    coarse = points_per_turn(points, offsets) < FEWEST_POINTS_PER_TURN
    needed = np.ceil(POINTS_PER_TURN * length / turn).astype(np.int64) + 1
    fine = offsets_of(np.maximum(np.minimum(needed, MOST_POINTS), np.diff(offsets)))
    world = resample(points, offsets, fine)
    canonical, curled = _straightened(world, fine)
    turn = _turns(canonical, fine, length)
    grids = np.clip(np.ceil(CELLS_PER_TURN * length / turn).astype(np.int64), CELLS, MOST_CELLS)
    starts = offsets_of(grids)
    cells = starts[1:, None] - CELLS + np.arange(CELLS)
    values = np.concatenate([signals(canonical, fine, starts)[cells], signals(world, fine, starts)[cells, :WORLD]], 2)
    part = CELLS / grids
    values[:, :, 2] *= part[:, None]  # v is per t of the whole strand: per t of the section it is less
    reading = np.where(curled, np.where(coarse, Reading.COARSE, Reading.READ), Reading.STRAIGHT).astype(np.int8)
    values[reading != Reading.READ] = np.nan
    return LowerSignals(values, reading, length, part)


def _straightened(
    points: NDArray[np.float64], offsets: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Strands in canonical space, and which of them wind about their axis."""
    guides, _ = centerlines(points, offsets)
    canonical = to_canonical(points, guides, offsets)
    return canonical, winding(canonical, offsets)[0] >= STRAIGHT_RADIUS


@parallel_kernel
def points_per_turn(points: NDArray[np.float64], offsets: NDArray[np.int64]) -> NDArray[np.float64]:
    """Points of each strand (S,) in one turn of its polyline's own frame, at its median segment; infinite if straight.

    From a segment to the next the frame bends, and turns about the segment: half a turn where the strand zigzags.
    """
    out = np.full(offsets.shape[0] - 1, np.inf)
    for s in prange(offsets.shape[0] - 1):
        strand = points[offsets[s] : offsets[s + 1]]
        n = strand.shape[0]
        if n < 4:
            continue
        bend = np.zeros(n - 2)
        normal = np.zeros((n - 2, 3))
        for i in range(n - 2):
            a = strand[i + 1] - strand[i]
            b = strand[i + 2] - strand[i + 1]
            normal[i, 0] = a[1] * b[2] - a[2] * b[1]
            normal[i, 1] = a[2] * b[0] - a[0] * b[2]
            normal[i, 2] = a[0] * b[1] - a[1] * b[0]
            bend[i] = np.arctan2(np.sqrt((normal[i] ** 2).sum()), (a * b).sum())
        angle = np.zeros(n - 3)
        for i in range(n - 3):
            size = np.sqrt((normal[i] ** 2).sum() * (normal[i + 1] ** 2).sum())
            if size > 0.0:
                twist = np.arccos(min(max((normal[i] * normal[i + 1]).sum() / size, -1.0), 1.0))
                angle[i] = np.hypot(0.5 * (bend[i] + bend[i + 1]), twist)
        middle = np.median(angle)
        if middle > 0.0:
            out[s] = 2.0 * np.pi / middle
    return out


def _turns(points: NDArray[np.float64], offsets: NDArray[np.int64], length: NDArray[np.float64]) -> NDArray[np.float64]:
    """Arc length [cm] in which each strand's (S,) frame turns once, in its median cell; at most the strand's own."""
    values = signals(points, offsets, np.arange(len(offsets), dtype=np.int64) * CELLS).reshape(-1, CELLS, 3)
    rate = np.median(np.hypot(values[:, :, 0], values[:, :, 1]), axis=1)
    return np.minimum(2.0 * np.pi / np.maximum(rate, 1e-9), length)


def nearest_types(
    radius: NDArray[np.float64], wavelength: NDArray[np.float64], twist: NDArray[np.float64]
) -> NDArray[np.int8]:
    """The index of the hair type that each texture (S,) is nearest to, in the types' own deviations."""
    away = np.zeros((len(radius), len(HAIR_TYPES)))
    for k, hair in enumerate(HAIR_TYPES):
        for values, spread in ((radius, hair.radius), (wavelength, hair.wavelength), (twist, hair.twist)):
            away[:, k] += ((values - spread.mean) / spread.deviation) ** 2 + 2.0 * np.log(spread.deviation)
    return away.argmin(axis=1).astype(np.int8)
