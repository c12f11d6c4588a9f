"""The schedule and the solver: against the exact flow of Gaussian data, and against diffusers' own solver."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from detangled.diffusion.sampler import (
    SamplerStep,
    SolverCoefficients,
    coefficients_of_grid,
    sample,
    solve,
    solver_coefficients,
)
from detangled.diffusion.schedule import LAMBDA_MAX, LAMBDA_MIN, CosineSchedule
from detangled.errors import DetangledError

SCHEDULE = CosineSchedule()

# A mixture of three normal distributions, of unlike widths: its exact denoiser is far from linear.
MEANS = np.array([-1.2, 0.1, 1.5])
DEVIATIONS = np.array([0.15, 0.3, 0.1])
WEIGHTS = np.array([0.4, 0.4, 0.2])


def denoise_mixture(x: NDArray[np.float64], alpha: float, sigma: float) -> NDArray[np.float64]:
    """Mean of the clean value given the noisy one, for values drawn from the mixture."""
    variance = alpha**2 * DEVIATIONS**2 + sigma**2
    offset = x[..., None] - alpha * MEANS
    logits = np.log(WEIGHTS) - 0.5 * np.log(variance) - 0.5 * offset**2 / variance
    weights = np.exp(logits - logits.max(axis=-1, keepdims=True))
    weights /= weights.sum(axis=-1, keepdims=True)
    return (weights * (MEANS + alpha * DEVIATIONS**2 / variance * offset)).sum(axis=-1)


GAUSS_MEAN = 0.7
GAUSS_DEVIATION = 0.4


def denoise_gauss(x: NDArray[np.float64], alpha: float, sigma: float) -> NDArray[np.float64]:
    variance = GAUSS_DEVIATION**2
    return (alpha * variance * x + sigma**2 * GAUSS_MEAN) / (alpha**2 * variance + sigma**2)


def grid_of_lambdas(lambdas: NDArray[np.float64]) -> SolverCoefficients:
    return coefficients_of_grid(1.0 / np.sqrt(1.0 + np.exp(-2 * lambdas)), 1.0 / np.sqrt(1.0 + np.exp(2 * lambdas)))


def noise(*shape: int, seed: int = 7) -> NDArray[np.float64]:
    return np.random.default_rng(seed).standard_normal(shape)


# ---- schedule


def test_alpha_and_sigma_preserve_variance() -> None:
    t = np.linspace(0.0, 1.0, 1001)
    np.testing.assert_allclose(SCHEDULE.alpha(t) ** 2 + SCHEDULE.sigma(t) ** 2, 1.0, rtol=0, atol=1e-15)


def test_schedule_is_the_cosine_of_the_paper() -> None:
    t = np.linspace(0.01, 0.99, 99)
    f = np.cos((t + 0.008) / 1.008 * np.pi / 2) ** 2
    f_0 = math.cos(0.008 / 1.008 * math.pi / 2) ** 2
    np.testing.assert_allclose(SCHEDULE.alpha(t) ** 2, f / f_0, rtol=1e-13)


def test_lambda_falls_from_bound_to_bound() -> None:
    t = np.linspace(0.0, 1.0, 1001)
    lambdas = SCHEDULE.lambda_(t)
    assert np.isfinite(lambdas).all()
    assert lambdas[0] == pytest.approx(LAMBDA_MAX, abs=1e-9)
    assert lambdas[-1] == pytest.approx(LAMBDA_MIN, abs=1e-9)
    assert (np.diff(lambdas[1:-4]) < 0).all()


def test_log_snr_is_twice_lambda() -> None:
    t = np.linspace(0.1, 0.9, 9)
    snr = SCHEDULE.alpha(t) ** 2 / SCHEDULE.sigma(t) ** 2
    np.testing.assert_allclose(SCHEDULE.log_snr(t), np.log(snr), rtol=0, atol=1e-12)


def test_time_inverts_lambda() -> None:
    lambdas = np.linspace(LAMBDA_MIN, LAMBDA_MAX, 103)
    np.testing.assert_allclose(SCHEDULE.lambda_(SCHEDULE.time(lambdas)), lambdas, rtol=0, atol=1e-10)
    t = np.linspace(0.01, 0.99, 99)
    np.testing.assert_allclose(SCHEDULE.time(SCHEDULE.lambda_(t)), t, rtol=0, atol=1e-13)


@pytest.mark.parametrize("steps", [1, 2, 20, 5000])
def test_timesteps_descend_to_the_clean_signal(steps: int) -> None:
    times = SCHEDULE.timesteps(steps)
    assert times.shape == (steps + 1,)
    assert times[0] == pytest.approx(float(SCHEDULE.time(LAMBDA_MIN)))
    assert times[-1] == 0.0
    assert (np.diff(times) < 0).all()


def test_bad_schedules_and_grids_are_named() -> None:
    with pytest.raises(DetangledError, match="steps"):
        SCHEDULE.timesteps(0)
    with pytest.raises(DetangledError, match="lambda_min"):
        CosineSchedule(lambda_min=1.0, lambda_max=1.0)
    with pytest.raises(DetangledError, match="offset"):
        CosineSchedule(offset=0.0)
    with pytest.raises(DetangledError, match="rising"):
        coefficients_of_grid([0.5, 0.4], [math.sqrt(0.75), math.sqrt(0.84)])
    with pytest.raises(DetangledError, match="shape"):
        coefficients_of_grid([0.5], [0.5])
    with pytest.raises(DetangledError, match="denoise"):
        sample(lambda x, alpha, sigma: x[:1], noise(2, 3, 8), SCHEDULE)


# ---- solver


def test_solver_is_of_second_order() -> None:
    """Doubling the steps divides the distance from the exact flow of Gaussian data by four."""
    start = noise(4, 3, 16)

    def error(steps: int) -> float:
        lambdas = np.linspace(-5.0, 4.0, steps + 1)
        alpha, sigma = 1.0 / np.sqrt(1.0 + np.exp(-2 * lambdas)), 1.0 / np.sqrt(1.0 + np.exp(2 * lambdas))
        spread = np.sqrt(alpha**2 * GAUSS_DEVIATION**2 + sigma**2)
        exact = alpha[-1] * GAUSS_MEAN + spread[-1] / spread[0] * (start - alpha[0] * GAUSS_MEAN)
        return float(np.abs(solve(denoise_gauss, start, coefficients_of_grid(alpha, sigma)) - exact).max())

    errors = [error(steps) for steps in (40, 80, 160, 320)]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert errors[0] < 2e-2
    assert (np.abs(orders - 2.0) < 0.15).all(), (errors, orders)


@pytest.mark.parametrize("deviation", [0.1, 0.2, 0.5, 1.0, 2.0])
def test_twenty_steps_keep_the_spread_of_coarse_and_fine_detail(deviation: float) -> None:
    def denoise(x: NDArray[np.float64], alpha: float, sigma: float) -> NDArray[np.float64]:
        return alpha * deviation**2 / (alpha**2 * deviation**2 + sigma**2) * x

    ratio = sample(denoise, np.ones((1, 1, 1)), SCHEDULE)[0, 0, 0] / deviation
    # Well below what strands of one texture differ by; finer detail loses more.
    assert abs(ratio - 1.0) < 0.02


def test_last_step_lands_on_the_predicted_clean_signal() -> None:
    predictions: list[NDArray[np.float64]] = []

    def denoise(x: NDArray[np.float64], alpha: float, sigma: float) -> NDArray[np.float64]:
        predictions.append(denoise_mixture(x, alpha, sigma))
        return predictions[-1]

    for steps in (1, 2, 3, 20):
        predictions.clear()
        result = sample(denoise, noise(2, 3, 8), SCHEDULE, steps)
        assert len(predictions) == steps
        np.testing.assert_array_equal(result, predictions[-1])


def test_sample_is_the_loop_over_the_coefficients() -> None:
    """What a compiled kernel will do strand by strand."""
    start = noise(3, 3, 8)
    coefficients = solver_coefficients(SCHEDULE, 20)
    assert coefficients.c_x0_previous[0] == coefficients.c_x0_previous[-1] == 0.0
    assert coefficients.c_x[-1] == 0.0
    assert coefficients.c_x0[-1] == 1.0
    for strand in range(3):
        x, previous = start[strand], np.zeros((3, 8))
        for alpha, sigma, c_x, c_x0, c_previous in zip(*coefficients, strict=True):
            x0 = denoise_mixture(x, alpha, sigma)
            x = c_x * x + c_x0 * x0 + c_previous * previous
            previous = x0
        np.testing.assert_array_equal(sample(denoise_mixture, start, SCHEDULE, 20)[strand], x)


def test_a_constant_prediction_is_reached_whatever_the_step() -> None:
    """c_x alpha + c_x0 + c_x0_previous = alpha_next: a signal without noise stays on its own path."""
    for steps in (1, 2, 14, 15, 40):
        c = solver_coefficients(SCHEDULE, steps)
        following = np.append(c.alpha[1:], 1.0)
        np.testing.assert_allclose(c.c_x * c.alpha + c.c_x0 + c.c_x0_previous, following, rtol=0, atol=1e-13)


def test_few_steps_end_in_first_order() -> None:
    assert grid_of_lambdas(np.linspace(-5, 4, 15)).c_x0_previous[-1] == 0.0
    assert grid_of_lambdas(np.linspace(-5, 4, 16)).c_x0_previous[-1] != 0.0


def test_same_noise_same_bytes() -> None:
    start = noise(4, 3, 32)
    before = start.copy()
    first = sample(denoise_mixture, start, SCHEDULE)
    second = sample(denoise_mixture, start, SCHEDULE)
    assert first.tobytes() == second.tobytes()
    np.testing.assert_array_equal(start, before)


def test_a_strand_does_not_depend_on_its_batch() -> None:
    start = noise(37, 3, 33)
    together = sample(denoise_mixture, start, SCHEDULE)
    for strand in (0, 1, 17, 36):
        alone = sample(denoise_mixture, start[strand : strand + 1], SCHEDULE)
        assert alone.tobytes() == together[strand : strand + 1].tobytes()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_denoiser_may_answer_in_a_buffer_of_its_own(dtype: type[np.floating[Any]]) -> None:
    buffer = np.empty((2, 3, 8), dtype=dtype)

    def reusing(x: NDArray[np.float64], alpha: float, sigma: float) -> NDArray[Any]:
        buffer[...] = denoise_mixture(x, alpha, sigma)
        return buffer

    def fresh(x: NDArray[np.float64], alpha: float, sigma: float) -> NDArray[Any]:
        return denoise_mixture(x, alpha, sigma).astype(dtype)

    result = sample(reusing, noise(2, 3, 8), SCHEDULE)
    assert result.dtype == np.float64
    np.testing.assert_array_equal(result, sample(fresh, noise(2, 3, 8), SCHEDULE))


def test_guide_changes_the_prediction_at_every_step() -> None:
    start = noise(2, 3, 8)
    seen: list[SamplerStep] = []

    def guide(x0: NDArray[np.float64], step: SamplerStep) -> NDArray[np.float64]:
        seen.append(step)
        return x0 + 0.01 * (step.index + 1)

    def shifted(x: NDArray[np.float64], alpha: float, sigma: float) -> NDArray[np.float64]:
        index = int(np.flatnonzero(solver_coefficients(SCHEDULE, 20).alpha == alpha)[0])
        return denoise_mixture(x, alpha, sigma) + 0.01 * (index + 1)

    guided = sample(denoise_mixture, start, SCHEDULE, 20, guide=guide)
    np.testing.assert_array_equal(guided, sample(shifted, start, SCHEDULE, 20))
    assert [step.index for step in seen] == list(range(20))
    assert {step.steps for step in seen} == {20}
    for step, t in zip(seen, SCHEDULE.timesteps(20)[:-1], strict=True):
        assert step.log_snr == pytest.approx(float(SCHEDULE.log_snr(t)))


def test_progress_counts_to_the_end() -> None:
    told: list[tuple[int, int]] = []
    sample(denoise_mixture, noise(1, 1, 4), SCHEDULE, 3, progress=lambda done, steps: told.append((done, steps)))
    assert told == [(1, 3), (2, 3), (3, 3)]


# ---- diffusers


def reference_scheduler(**options: Any) -> Any:
    """diffusers' solver with its state in float64, which it otherwise rounds to float32 at every step."""
    torch = pytest.importorskip("torch")
    diffusers: Any = pytest.importorskip("diffusers")
    solver: Any = diffusers.DPMSolverMultistepScheduler

    class Float64Scheduler(solver):
        # `step` chooses the order and keeps the predictions; it hands the rounded state to these two.
        exact_sample: Any

        def dpm_solver_first_order_update(self, prediction: Any, *, sample: Any, noise: Any) -> Any:
            return super().dpm_solver_first_order_update(prediction, sample=self.exact_sample, noise=noise)

        def multistep_dpm_solver_second_order_update(self, predictions: Any, *, sample: Any, noise: Any) -> Any:
            return super().multistep_dpm_solver_second_order_update(predictions, sample=self.exact_sample, noise=noise)

        def step(self, prediction: Any, timestep: Any, sample: Any, **rest: Any) -> Any:
            self.exact_sample = sample
            return super().step(prediction, timestep, sample, **rest)

    scheduler = Float64Scheduler(
        beta_schedule="squaredcos_cap_v2",
        algorithm_type="dpmsolver++",
        solver_order=2,
        prediction_type="sample",
        **options,
    )
    scheduler.as_float64 = lambda values: torch.tensor(np.asarray(values), dtype=torch.float64)
    return scheduler


@pytest.mark.parametrize("steps", [1, 2, 8, 14, 15, 20, 50])
@pytest.mark.parametrize("grid", ["zero", "sigma_min", "ours"])
def test_equals_diffusers(steps: int, grid: str) -> None:
    final = "sigma_min" if grid == "sigma_min" else "zero"
    scheduler = reference_scheduler(lambda_min_clipped=-5.1, final_sigmas_type=final)
    scheduler.set_timesteps(steps)
    scheduler.set_begin_index(0)
    if grid == "ours":
        times = SCHEDULE.timesteps(steps)[:-1]
        scheduler.sigmas = np.append(SCHEDULE.sigma(times) / SCHEDULE.alpha(times), 0.0)
    ratio = np.asarray(scheduler.sigmas, dtype=np.float64)
    scheduler.sigmas = scheduler.as_float64(ratio)
    alpha = 1.0 / np.sqrt(1.0 + ratio**2)
    sigma = ratio * alpha

    start = noise(4, 3, 32)
    x = scheduler.as_float64(start)
    for index, timestep in enumerate(scheduler.timesteps):
        x0 = denoise_mixture(x.numpy(), float(alpha[index]), float(sigma[index]))
        x = scheduler.step(scheduler.as_float64(x0), timestep, x, return_dict=False)[0]

    ours = solve(denoise_mixture, start, coefficients_of_grid(alpha, sigma))
    # Both sides compute the same formulas in float64, in another order.
    np.testing.assert_allclose(ours, x.numpy(), rtol=0, atol=1e-12)


def test_equals_diffusers_untouched_within_float32() -> None:
    torch = pytest.importorskip("torch")
    diffusers = pytest.importorskip("diffusers")
    scheduler = diffusers.DPMSolverMultistepScheduler(
        beta_schedule="squaredcos_cap_v2",
        algorithm_type="dpmsolver++",
        solver_order=2,
        prediction_type="sample",
        lambda_min_clipped=-5.1,
    )
    scheduler.set_timesteps(20)
    ratio = scheduler.sigmas.double().numpy()
    alpha = 1.0 / np.sqrt(1.0 + ratio**2)
    start = noise(4, 3, 32)
    x = torch.tensor(start)
    for index, timestep in enumerate(scheduler.timesteps):
        x0 = denoise_mixture(x.numpy(), float(alpha[index]), float(ratio[index] * alpha[index]))
        x = scheduler.step(torch.tensor(x0), timestep, x, return_dict=False)[0]
    ours = solve(denoise_mixture, start, coefficients_of_grid(alpha, ratio * alpha))
    # It keeps its state in float32 over 20 steps.
    np.testing.assert_allclose(ours, x.numpy(), rtol=0, atol=2e-5)


def test_our_schedule_is_the_one_of_diffusers_between_training_steps() -> None:
    """Its betas cap and its float32 aside, step i of 1000 stands at our t = (i + 1) / 1000."""
    scheduler = reference_scheduler()
    steps = np.arange(1, 990)
    expected = scheduler.lambda_t.double().numpy()[steps]
    np.testing.assert_allclose(SCHEDULE.lambda_((steps + 1) / 1000), expected, rtol=0, atol=2e-3)
