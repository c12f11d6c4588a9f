"""A texture fitted to a few strands, and its file (.texture): what the strands are like, and for one of the two
engines the weights of the network that was trained on them.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detangled.archives import DAMAGE, read_arrays, write_arrays
from detangled.base_texture import Texture
from detangled.diffusion.patches import PatchSchedule
from detangled.diffusion.whitening import Whitening
from detangled.errors import ModelError, ReadError
from detangled.formats import replacing
from detangled.settling import Settling
from detangled.shape import Shape

SUFFIX = ".texture"
FORMAT = "detangled texture"
VERSION = 7
PATCHES, FINETUNE = "patches", "finetune"
METHODS = (PATCHES, FINETUNE)


@dataclass(frozen=True, kw_only=True)
class FittedTexture(Texture):
    """What a texture's strands are like: learned from examples.

    signals: (C, 3), kappa, tau [1/cm] and v [cm per t] of the examples, one after another.
    starts: (E + 1,), strand e is in rows starts[e] to starts[e + 1].
    method: the engine that draws new strands, PATCHES or FINETUNE. weights: (P,) float16, of the network that was
    trained on the strands, and architecture, its sizes; calibration: (2, 2, 2, 2, Q), how far what it draws is off
    (``diffusion.calibration``). None of them for PATCHES.
    """

    signals: NDArray[np.float64]
    starts: NDArray[np.int64]
    whitening: Whitening
    schedule: PatchSchedule = field(default_factory=PatchSchedule)
    method: str = PATCHES
    weights: NDArray[np.float16] = field(default_factory=lambda: np.empty(0, dtype=np.float16))
    architecture: dict[str, Any] = field(default_factory=dict)
    calibration: NDArray[np.float64] = field(default_factory=lambda: np.empty((2, 2, 2, 2, 0)))

    @property
    def strand_count(self) -> int:
        return len(self.starts) - 1

    @cached_property
    def channels(self) -> NDArray[np.float64]:
        """The signals whitened, (3, C): each strand by itself, since v is taken per cell."""
        return np.concatenate([self.whitening.whiten(self.signals[a:b]) for a, b in pairwise(self.starts)], axis=1)

    @property
    def shortest_drawn(self) -> float:
        """A network draws strands as long as those that it was shown."""
        return self.median_arc if self.method == FINETUNE else 0.0

    @property
    def cells(self) -> NDArray[np.int64]:
        """Cells of each strand, (E,)."""
        return np.diff(self.starts)


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
        "architecture": texture.architecture,
        "both_hands": texture.both_hands,
        "stiff": texture.stiff,
        "waves": texture.waves,
        "shape": texture.shape and asdict(texture.shape),
        "settling": texture.settling and asdict(texture.settling),
    }
    arrays = {
        "manifest": np.array([json.dumps(manifest, sort_keys=True)]),
        "signals": texture.signals,
        "starts": texture.starts,
        "weights": texture.weights,
        "calibration": texture.calibration,
    }
    with replacing(Path(path)) as temporary:
        write_arrays(temporary, arrays)


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
        method = manifest["method"]
        if manifest["version"] != VERSION or method not in METHODS:
            raise ModelError(
                f"{path}: a texture of version {manifest['version']}, method {method}; this detangled reads version "
                f"{VERSION}, methods {' and '.join(METHODS)}: fit it again"
            )
        whitening = Whitening(**{name: tuple(value) for name, value in manifest["whitening"].items()})
        values = arrays["signals"].astype(np.float64, casting="safe")
        starts = arrays["starts"].astype(np.int64, casting="safe")
        weights = arrays["weights"]
        levels = arrays["calibration"].astype(np.float64, casting="safe")
        _check_arrays(values, starts, weights, method)
        _check_calibration(levels, method)
        shape, settling = manifest["shape"], manifest["settling"]
        return FittedTexture(
            signals=values,
            starts=starts,
            whitening=whitening,
            schedule=PatchSchedule(**manifest["schedule"]),
            method=method,
            weights=weights,
            calibration=levels,
            both_hands=bool(manifest["both_hands"]),
            stiff=bool(manifest["stiff"]),
            waves=bool(manifest["waves"]),
            shape=None if shape is None else Shape(**shape),
            settling=None if settling is None else Settling(**settling),
            architecture=dict(manifest["architecture"]),
            cell_width=float(manifest["cell_width"]),
            turn=float(manifest["turn"]),
            median_arc=float(manifest["median_arc"]),
            arc_per_axis=float(manifest["arc_per_axis"]),
            radius=float(manifest["radius"]),
            wavelength=float(manifest["wavelength"]),
        )
    except (*DAMAGE, AttributeError, IndexError, OverflowError) as error:
        raise ModelError(f"{path}: not a texture made by detangled fit, or damaged ({type(error).__name__})") from error


def _check_arrays(values: NDArray[Any], starts: NDArray[Any], weights: NDArray[Any], method: str) -> None:
    """Raise ValueError where the arrays of a file are not those of a texture."""
    if values.ndim != 2 or values.shape[1] != 3 or not np.isfinite(values).all():
        raise ValueError("signals of another shape, or not finite")
    if starts.ndim != 1 or len(starts) < 2 or starts[0] != 0 or starts[-1] != len(values) or np.diff(starts).min() < 1:
        raise ValueError("strands that do not fit the signals")
    if weights.dtype != np.float16 or weights.ndim != 1 or not np.isfinite(weights).all():
        raise ValueError("weights of another kind, or not finite")
    if (len(weights) > 0) != (method == FINETUNE):
        raise ValueError("weights that do not go with the method")


def _check_calibration(levels: NDArray[np.float64], method: str) -> None:
    """Raise ValueError where it is not monotone maps."""
    if levels.ndim != 5 or levels.shape[:4] != (2, 2, 2, 2) or not np.isfinite(levels).all():
        raise ValueError("a calibration of another shape, or not finite")
    if (np.diff(levels, axis=4) < 0.0).any():
        raise ValueError("a calibration that is not monotone")
    if (levels.size > 0) != (method == FINETUNE):
        raise ValueError("a calibration that does not go with the method")
