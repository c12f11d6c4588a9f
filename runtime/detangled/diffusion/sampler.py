"""From noise to a signal by multistep DPM-Solver++ (Lu et al. 2022): paper, section Inference.

Second order, in the prediction of the clean signal: at each step

    x_next = c_x x + c_x0 x0 + c_x0_previous x0_previous

where x0 is what the denoiser predicts at x, and x0_previous what it predicted a step earlier. Coefficients
depend on the schedule alone: a compiled kernel can run the same solver over one strand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.diffusion.schedule import CosineSchedule
from detangled.errors import DetangledError

DEFAULT_STEPS = 20

# With few steps the last one is long, too long to extrapolate over; the bound is that of the authors' code.
FEW_STEPS = 15


class SolverCoefficients(NamedTuple):
    """The solver's steps in numbers, each (steps,) float64; numba takes it as it is.

    alpha, sigma: where the denoiser is called.
    c_x, c_x0, c_x0_previous: the update's factors; the last is 0 in steps of first order.
    """

    alpha: NDArray[np.float64]
    sigma: NDArray[np.float64]
    c_x: NDArray[np.float64]
    c_x0: NDArray[np.float64]
    c_x0_previous: NDArray[np.float64]


@dataclass(frozen=True)
class SamplerStep:
    """Where the solver stands when it asks for guidance: step ``index`` of ``steps``, counted from 0."""

    index: int
    steps: int
    alpha: float
    sigma: float

    @property
    def log_snr(self) -> float:
        return 2.0 * float(np.log(self.alpha / self.sigma))


# (noisy signals (B, C, L) float64, alpha, sigma) -> predicted clean signals (B, C, L)
Denoiser: TypeAlias = Callable[[NDArray[np.float64], float, float], NDArray[Any]]
# (predicted clean signals (B, C, L), step) -> the prediction to go on with
Guide: TypeAlias = Callable[[NDArray[np.float64], SamplerStep], NDArray[Any]]
# (steps done, steps in all)
Progress: TypeAlias = Callable[[int, int], None]


def solver_coefficients(schedule: CosineSchedule, steps: int = DEFAULT_STEPS) -> SolverCoefficients:
    """Coefficients of a sample of so many steps, the last of which lands on the predicted clean signal."""
    times = schedule.timesteps(steps)[:-1]
    return coefficients_of_grid(
        np.append(schedule.alpha(times), 1.0),
        np.append(schedule.sigma(times), 0.0),
    )


def coefficients_of_grid(alpha: ArrayLike, sigma: ArrayLike) -> SolverCoefficients:
    """Coefficients of the steps between explicit points, alpha and sigma each (steps + 1,), noisiest first.

    A last sigma of 0 makes the last step the predicted clean signal itself. Of first order are the first
    step, and the last where it ends at sigma 0 or there are fewer than 15 steps; the others are of second.
    Raises DetangledError where alpha / sigma does not rise from each point to the next.
    """
    alphas = np.asarray(alpha, dtype=np.float64)
    sigmas = np.asarray(sigma, dtype=np.float64)
    if alphas.ndim != 1 or alphas.shape != sigmas.shape or len(alphas) < 2:
        raise DetangledError(
            f"alpha and sigma must be of one shape (steps + 1,), not {alphas.shape} and {sigmas.shape}"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        h = np.diff(np.log(alphas) - np.log(sigmas))
    if not np.all(h > 0.0) or not np.all(np.isfinite(h[:-1])):
        raise DetangledError("alpha and sigma must be positive (sigma may be 0 at the last point) with a rising ratio")

    steps = len(h)
    c_x = sigmas[1:] / sigmas[:-1]
    gain = -alphas[1:] * np.expm1(-h)
    half_slope = np.zeros(steps)
    last = steps - 1 if sigmas[-1] == 0.0 or steps < FEW_STEPS else steps
    second = slice(1, last)
    half_slope[second] = 0.5 * h[second] / h[: max(last - 1, 0)]
    return SolverCoefficients(
        alpha=alphas[:-1],
        sigma=sigmas[:-1],
        c_x=c_x,
        c_x0=gain * (1.0 + half_slope),
        c_x0_previous=-gain * half_slope,
    )


def sample(
    denoise: Denoiser,
    noise: ArrayLike,
    schedule: CosineSchedule,
    steps: int = DEFAULT_STEPS,
    guide: Guide | None = None,
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """Make clean signals of noise, (B, C, L) float64.

    noise: (B, C, L), standard normal: all the randomness there is, so a strand's own seed fixes its sample.
    guide: changes the predicted clean signals at every step, before the solver uses them.
    progress: told after every step how many are done, of how many.
    """
    return solve(denoise, noise, solver_coefficients(schedule, steps), guide, progress)


def solve(
    denoise: Denoiser,
    noise: ArrayLike,
    coefficients: SolverCoefficients,
    guide: Guide | None = None,
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """``sample`` over given steps. Every operation is elementwise: a strand does not depend on its batch."""
    x = np.array(noise, dtype=np.float64)
    x0_previous = np.zeros_like(x)
    steps = len(coefficients.alpha)
    for index, (alpha, sigma, c_x, c_x0, c_x0_previous) in enumerate(
        zip(*(column.tolist() for column in coefficients), strict=True)
    ):
        x0 = _checked("denoise", denoise(x, alpha, sigma), x.shape)
        if guide is not None:
            x0 = _checked("guide", guide(x0, SamplerStep(index, steps, alpha, sigma)), x.shape)
        x = c_x * x + c_x0 * x0 + c_x0_previous * x0_previous
        x0_previous = x0
        if progress is not None:
            progress(index + 1, steps)
    return x


def _checked(name: str, signals: NDArray[Any], shape: tuple[int, ...]) -> NDArray[np.float64]:
    # A copy, since a denoiser may answer in a buffer of its own and overwrite it at the next step.
    array = np.array(signals, dtype=np.float64)
    if array.shape != shape:
        raise DetangledError(f"{name} answered with the shape {array.shape}, for signals of {shape}")
    return array
