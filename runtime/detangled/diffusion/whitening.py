"""Whitening of signals: curvature and torsion have heavy tails, so they are compressed before they are scaled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# A channel that hardly varies is not blown up to unit variance: these are differences that nobody sees.
LEAST_SCALE = 1e-3  # [1/cm]
LEAST_DEVIATION = 0.05


@dataclass(frozen=True)
class Whitening:
    """Signals (..., L, 3) of kappa, tau [1/cm], v [cm per t] to channels (..., 3, L) of zero mean and unit variance.

    kappa and tau are compressed as asinh(x / scale); of v the logarithm of a cell's arc length [cm] is taken, so
    that it means the same on a grid of any number of cells. scale: (2,); mean, deviation: (3,).
    """

    scale: tuple[float, ...]
    mean: tuple[float, ...]
    deviation: tuple[float, ...]

    def __post_init__(self) -> None:
        if (len(self.scale), len(self.mean), len(self.deviation)) != (2, 3, 3):
            raise ValueError("whitening takes 2 scales, 3 means and 3 deviations")
        if not all(value > 0.0 for value in (*self.scale, *self.deviation)):
            raise ValueError("scales and deviations must be positive")

    @classmethod
    def of(cls, signals: list[NDArray[np.float64]]) -> Whitening:
        """The whitening that suits these signals, each (L, 3)."""
        pooled = np.concatenate(signals)
        scale = np.maximum(np.median(np.abs(pooled[:, :2]), axis=0), LEAST_SCALE)
        channels = np.concatenate([_compressed(s, scale) for s in signals])
        deviation = np.maximum(channels.std(axis=0), LEAST_DEVIATION)
        return cls(_floats(scale), _floats(channels.mean(axis=0)), _floats(deviation))

    def whiten(self, signals: NDArray[np.float64]) -> NDArray[np.float64]:
        """Channels (..., 3, L) of signals (..., L, 3)."""
        channels = (_compressed(signals, np.array(self.scale)) - self.mean) / self.deviation
        return np.ascontiguousarray(np.swapaxes(channels, -1, -2))

    def mirrored(self, channels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Channels (..., 3, L) of the mirrored strands, whose torsion has the other sign."""
        out = channels.copy()
        out[..., 1, :] = -channels[..., 1, :] - 2.0 * self.mean[1] / self.deviation[1]
        return out

    def restore(self, channels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signals (..., L, 3) of channels (..., 3, L); curvature is never negative."""
        signals = np.swapaxes(channels, -1, -2) * self.deviation + self.mean
        signals[..., :2] = np.sinh(signals[..., :2]) * self.scale
        signals[..., 0] = np.maximum(signals[..., 0], 0.0)
        signals[..., 2] = np.exp(signals[..., 2]) * signals.shape[-2]
        return np.ascontiguousarray(signals)


def _compressed(signals: NDArray[np.float64], scale: NDArray[np.float64]) -> NDArray[np.float64]:
    out = np.empty_like(signals)
    out[..., :2] = np.arcsinh(signals[..., :2] / scale)
    out[..., 2] = np.log(np.maximum(signals[..., 2], 1e-300) / signals.shape[-2])
    return out


def _floats(values: NDArray[np.float64]) -> tuple[float, ...]:
    return tuple(float(v) for v in values)
