"""What draws signals of new strands: the closed-form denoiser or a network, in the multistep solver.

Paper section "Inference": at each step the predicted clean signal is given its length, which is linear in v, and a
straight axis; where numbers are asked for it is guided to them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from detangled.base_texture import Texture
from detangled.diffusion.calibration import calibrated, for_length
from detangled.diffusion.denoiser import NetworkDenoiser
from detangled.diffusion.guidance import Guidance, by_differences, by_gradients
from detangled.diffusion.patches import denoise_strands, plan_stretches
from detangled.diffusion.sampler import Denoiser, Guide, SamplerStep, sample
from detangled.diffusion.schedule import CosineSchedule
from detangled.diffusion.steering import DRAWN, DRAWN_YET, steer_strands, with_arcs
from detangled.diffusion.whitening import Whitening
from detangled.errors import ModelError
from detangled.fitted import FINETUNE, FittedTexture
from detangled.kernels import thread_count
from detangled.labeling import LabelGradient, LabelNetwork
from detangled.models import DENOISER, LABELER_GRADIENT, load_labeler, load_model
from detangled.numbered import CONDITIONED, GUIDED, NumberedTexture

OFFERED = 12  # examples offered to each stretch of a strand
WIDEST_SHARE = 0.8  # of a stretch: the half-width of its widest patches
# The axis of a signal that is mostly noise means nothing.
STEER_BELOW = 1.0  # sigma / alpha
FEWEST_TURNS_TO_STEER = 12.0
# Sizes are guided from the first step on where the network is not told them, else once they show; twists, which are
# sudden, show late. All sigma / alpha.
GUIDE_SIZES_BELOW, GUIDE_TWIST_BELOW = 1.0, 0.5
HUNG = 1.0  # the network is asked for hair as it hangs


Guided = Callable[[NDArray[np.float64], SamplerStep], NDArray[np.float64]]


class Engine(Protocol):
    """Draws strands of one texture."""

    def draw(
        self, cells: int, arcs: NDArray[np.float64], generators: list[np.random.Generator], steps: int
    ) -> NDArray[np.float64]:
        """Signals (B, cells, 3) of strands of arc lengths (B,) [cm], each of its own stream of random numbers."""
        ...


def engine_of(texture: Texture) -> Engine:
    """The engine that draws a texture. Raises ModelError where the model that it takes is missing or another."""
    if isinstance(texture, NumberedTexture):
        return NumberedEngine(texture)
    if not isinstance(texture, FittedTexture):
        raise TypeError(f"nothing draws a {type(texture).__name__}")
    return NetworkEngine(texture) if texture.method == FINETUNE else PatchEngine(texture)


class PatchEngine:
    """The closed-form denoiser, by patches of the examples."""

    def __init__(self, texture: FittedTexture) -> None:
        self._texture = texture

    def draw(
        self, cells: int, arcs: NDArray[np.float64], generators: list[np.random.Generator], steps: int
    ) -> NDArray[np.float64]:
        noise = _noise(generators, cells)
        whitening = self._texture.whitening
        guide = _guide(self._texture, whitening, cells, arcs)
        channels = sample(self._denoiser(cells, generators), noise, CosineSchedule(), steps, guide)
        return with_arcs(whitening.restore(channels), arcs)

    def _denoiser(self, cells: int, generators: list[np.random.Generator]) -> Denoiser:
        """The denoiser for a batch of strands, each with examples of its own."""
        texture = self._texture
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


class NetworkEngine:
    """The network that was trained on a texture's examples; what it draws is calibrated to them.

    Strands much shorter than those it was shown are to be cut out of longer ones: it knows no others.
    """

    def __init__(self, texture: FittedTexture) -> None:
        model = load_model(DENOISER)
        if model.architecture != texture.architecture or model.parameters != len(texture.weights):
            raise ModelError(f"the texture was fitted with another network than {model.path}: fit it again")
        self._network = NetworkDenoiser(model, texture.weights, thread_count())
        self._texture = texture
        self._shown = int(texture.grid_cells(np.array([texture.median_arc]))[0])

    def draw(
        self, cells: int, arcs: NDArray[np.float64], generators: list[np.random.Generator], steps: int
    ) -> NDArray[np.float64]:
        channels = self.sampled(_noise(generators, cells), arcs, steps)
        return self.finished(calibrated(channels, for_length(self._texture.calibration, cells / self._shown)), arcs)

    def sampled(self, noise: NDArray[np.float64], arcs: NDArray[np.float64], steps: int) -> NDArray[np.float64]:
        """Whitened channels (B, 3, L) of strands, not yet calibrated, of as much noise."""
        guide = _guide(self._texture, self._texture.whitening, noise.shape[2], arcs)
        # A network of senseless weights predicts whatever it may: that is told of below, once.
        with np.errstate(all="ignore"):
            channels = sample(self._network, noise, CosineSchedule(), steps, guide)
        if not np.isfinite(channels).all():
            raise ModelError("the texture's network predicts no finite strands, its weights are damaged: fit it again")
        return channels

    def finished(self, channels: NDArray[np.float64], arcs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signals of whitened channels (B, 3, L): of the arc lengths asked for, their axes straight again."""
        values = with_arcs(self._texture.whitening.restore(channels), arcs)
        steered = _steered(self._texture, channels.shape[2])
        return steer_strands(values, self._texture.turn, DRAWN) if steered else values


class NumberedEngine:
    """The pretrained network, told the numbers of a texture, guided to them, or both."""

    def __init__(self, texture: NumberedTexture) -> None:
        self._texture = texture
        self._model = load_model(DENOISER)
        self._network = NetworkDenoiser(self._model, threads=thread_count())
        self._guidance = None if texture.method == CONDITIONED else _guidance(texture)

    def draw(
        self, cells: int, arcs: NDArray[np.float64], generators: list[np.random.Generator], steps: int
    ) -> NDArray[np.float64]:
        texture, whitening = self._texture, self._model.whitening
        told = np.log(texture.asked_radius), np.log(texture.asked_wavelength), texture.asked_twist
        every = np.ones(len(arcs))
        condition = np.stack([*(number * every for number in told), np.log(arcs), HUNG * every], axis=1)
        if texture.method == GUIDED:
            condition[:, :3] = np.nan  # length and hanging are none of the texture's numbers

        def denoise(noisy: NDArray[np.float64], alpha: float, sigma: float) -> NDArray[np.float64]:
            return self._network(noisy, alpha, sigma, condition)

        guide = _guide(texture, whitening, cells, arcs, self._guided())
        with np.errstate(all="ignore"):
            channels = sample(denoise, _noise(generators, cells), CosineSchedule(), steps, guide)
            values = with_arcs(whitening.restore(channels), arcs)
        if not np.isfinite(values).all():
            raise ModelError(f"{self._model.path}: predicts no finite strands: export the model anew")
        return values

    def _guided(self) -> Guided | None:
        """Guidance of one batch to the texture's numbers, from the steps on where each shows."""
        if self._guidance is None:
            return None
        move = self._guidance.begin()

        def guided(values: NDArray[np.float64], step: SamplerStep) -> NDArray[np.float64]:
            counted = _counted(self._texture.method, step)
            return move(values, counted) if counted.any() else values

        return guided


def _guidance(texture: NumberedTexture) -> Guidance:
    """Guidance to the numbers that are asked for."""
    labeler = LabelNetwork(load_labeler(), thread_count())
    if texture.finite_differences:
        derivatives = by_differences(labeler)
    else:
        derivatives = by_gradients(LabelGradient(load_labeler(LABELER_GRADIENT), thread_count()))
    wanted = np.array([np.log(texture.asked_radius), np.log(texture.asked_wavelength), texture.asked_twist])
    return Guidance(wanted, texture.turn, labeler, derivatives)


def _counted(method: str, step: SamplerStep) -> NDArray[np.bool_]:
    """Which of radius, wavelength and twist are guided at a step, (3,)."""
    noise = step.sigma / step.alpha
    sizes = method == GUIDED or noise < GUIDE_SIZES_BELOW
    return np.array([sizes, sizes, noise < GUIDE_TWIST_BELOW])


def _noise(generators: list[np.random.Generator], cells: int) -> NDArray[np.float64]:
    return np.stack([rng.standard_normal((3, cells)) for rng in generators])


def _guide(
    texture: Texture, whitening: Whitening, cells: int, arcs: NDArray[np.float64], guided: Guided | None = None
) -> Guide:
    """What every predicted clean signal is given: the arc length asked for, what guides it, and a straight axis."""
    steered = _steered(texture, cells)

    def guide(channels: NDArray[np.float64], step: SamplerStep) -> NDArray[np.float64]:
        values = with_arcs(whitening.restore(channels), arcs)
        if guided is not None:
            values = guided(values, step)
        if steered and step.sigma < STEER_BELOW * step.alpha:
            values = steer_strands(values, texture.turn, DRAWN_YET)
        return whitening.whiten(values)

    return guide


def _steered(texture: Texture, cells: int) -> bool:
    """Whether strands on a grid are long enough to be steered.

    By the grid, not the arc lengths of a batch: a strand must not depend on its neighbours. Of how many turns a strand
    is on the smallest grid, that does not tell.
    """
    return cells * texture.cell_width > FEWEST_TURNS_TO_STEER * texture.turn and cells > texture.fewest_cells
