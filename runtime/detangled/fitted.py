"""A texture fitted to a few strands, and its file (.texture).

Fitting by patches is measuring: the strands are mapped to canonical space and their signals are kept, on a grid
whose cells have one physical width.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from detangled.archives import DAMAGE, read_arrays, write_arrays
from detangled.diffusion.patches import PatchSchedule
from detangled.diffusion.whitening import Whitening
from detangled.errors import ModelError, ReadError, TextureError
from detangled.formats import replacing
from detangled.geometry.arc import arc_lengths
from detangled.geometry.signal import signals
from detangled.geometry.winding import winding
from detangled.groom import Groom
from detangled.grooming.guides import style_guides, usable_strands
from detangled.grooming.placing import resample

SUFFIX = ".texture"
FORMAT = "detangled texture"
METHOD = "patches"
VERSION = 1
MOST_CELLS = 512  # of a strand of median length
CELLS_PER_TURN = 22.0  # five between neighbouring points of a strand with 4.4 a turn: means keep its curvature
POINTS_PER_TURN = 16  # of a new strand: with 12 the spread of its curvature is a percent narrower
FEWEST_CELLS = 64  # of a strand of median length
SHORTEST_CELLS = 8  # of any strand
MOST_STRANDS = 400  # beyond this many, evenly chosen ones say as much


@dataclass(frozen=True)
class FittedTexture:
    """What a texture's strands are like, in canonical space.

    signals: (C, 3), kappa, tau [1/cm] and v [cm per t] of the strands, one after another.
    starts: (E + 1,), strand e is in rows starts[e] to starts[e + 1].
    cell_width, turn, median_arc: arc lengths [cm] of a cell, of a turn, and of the median strand.
    arc_per_axis: arc length per length along the axis, in the median.
    radius, wavelength: medians by winding [cm]; the wavelength of straight hair is NaN.
    """

    signals: NDArray[np.float64]
    starts: NDArray[np.int64]
    whitening: Whitening
    cell_width: float
    turn: float
    median_arc: float
    arc_per_axis: float
    radius: float
    wavelength: float
    schedule: PatchSchedule = field(default_factory=PatchSchedule)
    method: str = METHOD

    @property
    def strand_count(self) -> int:
        return len(self.starts) - 1

    @cached_property
    def channels(self) -> NDArray[np.float64]:
        """The signals whitened, (3, C): each strand by itself, since v is taken per cell."""
        return np.concatenate([self.whitening.whiten(self.signals[a:b]) for a, b in pairwise(self.starts)], axis=1)

    @property
    def cells(self) -> NDArray[np.int64]:
        """Cells of each strand, (E,)."""
        return np.diff(self.starts)


def fit_patches(groom: Groom) -> FittedTexture:
    """Fit a texture to the strands of a groom, from one to some hundreds, of any point counts.

    Raises TextureError where none of them can be used.
    """
    kept = np.flatnonzero(usable_strands(groom))
    if len(kept) == 0:
        raise TextureError(
            f"none of the {groom.strand_count} target strands can be used: each has fewer than two distinct points, "
            "a coordinate that is not finite, or is longer than 20 m (is the unit right?)"
        )
    if len(kept) > MOST_STRANDS:
        kept = kept[np.linspace(0, len(kept) - 1, MOST_STRANDS).round().astype(np.int64)]
    sparse = style_guides(groom.select(kept))
    turn = _arc_of_a_turn(sparse.canonical(), sparse.groom.offsets)
    # Centrelines, and so torsion, depend on how many points a turn has: as many as new strands are written with.
    guides = style_guides(_with_points_per_turn(sparse.groom, turn))
    offsets = guides.groom.offsets
    canonical = guides.canonical()
    arcs = arc_lengths(canonical, offsets)
    radius, wavelength = winding(canonical, offsets)

    median_arc = float(np.median(arcs))
    turn = _arc_of_a_turn(canonical, offsets)
    cell_width = float(np.clip(turn / CELLS_PER_TURN, median_arc / MOST_CELLS, median_arc / FEWEST_CELLS))
    cells = np.maximum(np.round(arcs / cell_width).astype(np.int64), SHORTEST_CELLS)
    starts = np.concatenate([[0], np.cumsum(cells)])
    values = signals(canonical, offsets, starts)
    return FittedTexture(
        signals=values,
        starts=starts,
        whitening=Whitening.of([values[a:b] for a, b in pairwise(starts)]),
        cell_width=cell_width,
        turn=turn,
        median_arc=median_arc,
        arc_per_axis=float(np.median(arcs / np.maximum(guides.lengths, 1e-12))),
        radius=float(np.median(radius)),
        wavelength=float(np.nanmedian(wavelength)) if np.isfinite(wavelength).any() else float("nan"),
    )


def _arc_of_a_turn(points: NDArray[np.float64], offsets: NDArray[np.int64]) -> float:
    """Arc length [cm] in which the frame of a helix with the median curvature and torsion turns once.

    At most the median strand's.
    """
    values = signals(points, offsets, np.arange(len(offsets), dtype=np.int64) * MOST_CELLS)
    rate = float(np.median(np.hypot(values[:, 0], values[:, 1])))
    return min(2.0 * np.pi / max(rate, 1e-9), float(np.median(arc_lengths(points, offsets))))


def _with_points_per_turn(groom: Groom, turn: float) -> Groom:
    """The strands with at least POINTS_PER_TURN points in each arc length ``turn`` [cm], without attributes."""
    needed = np.ceil(POINTS_PER_TURN * arc_lengths(groom.points, groom.offsets) / turn).astype(np.int64) + 1
    offsets = np.concatenate([[0], np.cumsum(np.maximum(needed, groom.point_counts))])
    return replace(groom, points=resample(groom.points, groom.offsets, offsets), offsets=offsets, attributes={})


def save_texture(texture: FittedTexture, path: str | Path) -> None:
    """Write a .texture file. Raises WriteError."""
    manifest = {
        "format": FORMAT,
        "version": VERSION,
        "method": texture.method,
        "whitening": asdict(texture.whitening),
        "schedule": asdict(texture.schedule),
        "cell_width": texture.cell_width,
        "turn": texture.turn,
        "median_arc": texture.median_arc,
        "arc_per_axis": texture.arc_per_axis,
        "radius": texture.radius,
        "wavelength": texture.wavelength,
    }
    with replacing(Path(path)) as temporary:
        write_arrays(
            temporary,
            {
                "manifest": np.array([json.dumps(manifest, sort_keys=True)]),
                "signals": texture.signals,
                "starts": texture.starts,
            },
        )


def load_texture(path: str | Path) -> FittedTexture:
    """Read a .texture file. Raises ReadError where it is missing, ModelError where it is damaged or of another kind."""
    path = Path(path)
    if not path.is_file():
        raise ReadError(f"{path}: no such file")
    try:
        arrays = read_arrays(path)
        manifest = json.loads(str(arrays["manifest"][0]))
        if manifest["format"] != FORMAT:
            raise ValueError("another kind of file")
        if manifest["version"] != VERSION or manifest["method"] != METHOD:
            raise ModelError(
                f"{path}: a texture of version {manifest['version']}, method {manifest['method']}; this detangled "
                f"reads version {VERSION}, method {METHOD}: fit it again"
            )
        whitening = Whitening(**{name: tuple(value) for name, value in manifest["whitening"].items()})
        values = arrays["signals"].astype(np.float64, casting="safe")
        starts = arrays["starts"].astype(np.int64, casting="safe")
        _check_arrays(values, starts)
        return FittedTexture(
            signals=values,
            starts=starts,
            whitening=whitening,
            schedule=PatchSchedule(**manifest["schedule"]),
            method=METHOD,
            **{
                name: float(manifest[name])
                for name in ("cell_width", "turn", "median_arc", "arc_per_axis", "radius", "wavelength")
            },
        )
    except (*DAMAGE, AttributeError, IndexError, OverflowError) as error:
        raise ModelError(f"{path}: not a texture made by detangled fit, or damaged ({type(error).__name__})") from error


def _check_arrays(values: NDArray[np.float64], starts: NDArray[np.int64]) -> None:
    """Raise ValueError where the arrays of a file are not those of a texture."""
    if values.ndim != 2 or values.shape[1] != 3 or not np.isfinite(values).all():
        raise ValueError("signals of another shape, or not finite")
    if starts.ndim != 1 or len(starts) < 2 or starts[0] != 0 or starts[-1] != len(values) or np.diff(starts).min() < 1:
        raise ValueError("strands that do not fit the signals")


def _positive(value: float) -> float:
    if not 0.0 < float(value) < float("inf"):
        raise ValueError("a length that is not positive")
    return float(value)
