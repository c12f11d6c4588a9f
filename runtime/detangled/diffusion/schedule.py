"""How much of a noisy signal is signal, over the time of the diffusion: paper, section Training.

A noisy signal is ``x = alpha(t) x0 + sigma(t) noise``, where ``alpha^2 + sigma^2 = 1``: clean at t = 0, noise
at t = 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.errors import DetangledError

# Nichol and Dhariwal 2021, "Improved Denoising Diffusion Probabilistic Models", section 3.2.
COSINE_OFFSET = 0.008

# log(alpha / sigma) is infinite at both ends of a cosine schedule, but a solver's steps and a network's input
# must be finite. Lu et al. 2022 cut the noisy end at -5.1: the signal is below a hundredth of the noise
# there, so a sample may start from noise alone. At the mirrored cut the noise is below one of the signal.
LAMBDA_MIN = -5.1
LAMBDA_MAX = 5.1

# Where a sampler calls the denoiser for the last time: sigma is 0.018 there, and steps beyond it would be
# spent on noise too small to see.
LAMBDA_LAST = 4.0


@dataclass(frozen=True)
class CosineSchedule:
    """The variance-preserving cosine schedule of Nichol and Dhariwal (2021), continuous in t, without unit.

    offset: their s, which keeps the noise from growing too slowly near t = 0.
    lambda_min, lambda_max: bounds of ``lambda_``, which keep alpha and sigma off 0 at the ends of [0, 1].

    The methods take numbers or arrays and answer with float64 arrays of the same shape.
    """

    offset: float = COSINE_OFFSET
    lambda_min: float = LAMBDA_MIN
    lambda_max: float = LAMBDA_MAX

    def __post_init__(self) -> None:
        if not 0.0 < self.offset < np.inf:
            raise DetangledError(f"offset must be positive and finite, not {self.offset}")
        if not -np.inf < self.lambda_min < self.lambda_max < np.inf:
            raise DetangledError(
                f"lambda_min {self.lambda_min} must be below lambda_max {self.lambda_max}, both finite"
            )

    def alpha(self, t: ArrayLike) -> NDArray[np.float64]:
        """What is left of the clean signal at time t."""
        return self._alpha_sigma(t)[0]

    def sigma(self, t: ArrayLike) -> NDArray[np.float64]:
        """Standard deviation of the noise at time t."""
        return self._alpha_sigma(t)[1]

    def lambda_(self, t: ArrayLike) -> NDArray[np.float64]:
        """log(alpha / sigma), HALF the logarithm of the signal-to-noise ratio: the solver's own time."""
        alpha, sigma = self._alpha_sigma(t)
        return np.log(alpha / sigma)

    def log_snr(self, t: ArrayLike) -> NDArray[np.float64]:
        """log(alpha^2 / sigma^2), what the denoiser is told."""
        return 2.0 * self.lambda_(t)

    def time(self, lambda_: ArrayLike) -> NDArray[np.float64]:
        """The t at which ``lambda_(t)`` has this value, first brought within its bounds: its inverse."""
        bounded = np.clip(np.asarray(lambda_, dtype=np.float64), self.lambda_min, self.lambda_max)
        variance = 1.0 / (1.0 + np.exp(2.0 * bounded))
        start = self._start
        # From cos(angle) = alpha cos(start); by the sine as well, since the arc cosine is inexact near 1.
        sine = np.sqrt(np.sin(start) ** 2 + variance * np.cos(start) ** 2)
        angle = np.arctan2(sine, np.sqrt(1.0 - variance) * np.cos(start))
        return np.asarray((angle - start) / (np.pi / 2.0 - start))

    def timesteps(self, steps: int) -> NDArray[np.float64]:
        """Times at which a sample of so many steps stands, (steps + 1,), descending to 0.

        The denoiser is called at all but the last, the clean signal's. They are evenly spaced in lambda (Lu
        et al. 2022): evenly spaced in t, 20 steps leave detail whose deviation is 0.1 at 0.73 of its size;
        this way at 0.99.
        """
        if steps < 1:
            raise DetangledError(f"steps must be 1 or more, not {steps}")
        last = min(LAMBDA_LAST, self.lambda_max)
        return np.append(self.time(np.linspace(self.lambda_min, last, steps)), 0.0)

    @property
    def _start(self) -> float:
        return self.offset / (1.0 + self.offset) * np.pi / 2.0

    def _alpha_sigma(self, t: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        times = np.asarray(t, dtype=np.float64)
        bounded = np.clip(times, self.time(self.lambda_max), self.time(self.lambda_min))
        start = self._start
        angle = start + (np.pi / 2.0 - start) * bounded
        alpha = np.cos(angle) / np.cos(start)
        # sqrt(1 - alpha^2), by a product of sines: the difference would lose half its digits near t = 0.
        sigma = np.sqrt(np.sin(angle - start) * np.sin(angle + start)) / np.cos(start)
        return np.asarray(alpha), np.asarray(sigma)
