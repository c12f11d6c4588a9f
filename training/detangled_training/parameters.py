"""A network's parameters as one flat vector, and one step of training on it.

Both exported graphs take their weights as such a vector: fitting a network to a few strands without torch then means
passing three arrays in and three out, and a fitted network is one array in a file.

Tensors of two axes and more come first, in the network's order, then all vectors. Axes are stored reversed, inputs
before outputs, as a matrix product over (cells, channels) takes them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.func import functional_call

from detangled_training.layers import MATRICES
from detangled_training.unet import CONDITIONS, Architecture, UNet


@dataclass(frozen=True)
class Slot:
    """Where a parameter lies in the vector. shape: as stored, its axes in the reverse of the network's own."""

    name: str
    shape: tuple[int, ...]
    offset: int

    @property
    def size(self) -> int:
        return math.prod(self.shape)


@dataclass(frozen=True)
class Optimizer:
    """AdamW (Loshchilov and Hutter 2019) after clipping of the gradient's norm; the learning rate is given by step.

    Squares are forgotten faster than by default (0.999): a fit to a few strands lasts some hundred steps.
    """

    beta1: float = 0.9
    beta2: float = 0.99
    epsilon: float = 1e-8
    weight_decay: float = 0.01
    clip: float = 1.0


def layout(network: UNet) -> list[Slot]:
    """The slots of a network of CONVOLUTIONS, by offset."""
    named = sorted(network.named_parameters(), key=lambda pair: pair[1].dim() < 2)
    slots = []
    offset = 0
    for name, parameter in named:
        slots.append(Slot(name, tuple(reversed(parameter.shape)), offset))
        offset += slots[-1].size
    return slots


def flatten(network: UNet) -> Tensor:
    """The parameters of a network of CONVOLUTIONS as a vector, (P,) float32."""
    return flatten_tensors(dict(network.named_parameters()), layout(network))


def flatten_tensors(tensors: Mapping[str, Tensor], slots: Sequence[Slot]) -> Tensor:
    """A tensor for each parameter of a network of CONVOLUTIONS, as a vector (P,) float32."""
    with torch.no_grad():
        return torch.cat([_reversed(tensors[slot.name]).reshape(-1) for slot in slots]).float().cpu()


def restore(network: UNet, weights: Tensor) -> None:
    """Put a vector (P,) into a network of CONVOLUTIONS."""
    with torch.no_grad():
        for name, view in views(weights, layout(network)).items():
            network.get_parameter(name).copy_(view)


def views(weights: Tensor, slots: Sequence[Slot]) -> dict[str, Tensor]:
    """A vector's parts, as a network of CONVOLUTIONS takes them."""
    return {name: _reversed(part) for name, part in matrices(weights, slots).items()}


def matrices(weights: Tensor, slots: Sequence[Slot]) -> dict[str, Tensor]:
    """A vector's parts, as a network of MATRICES takes them."""
    parts = weights.split([slot.size for slot in slots])
    return {slot.name: part.view(slot.shape) for slot, part in zip(slots, parts, strict=True)}


class TrainingStep:
    """One step on the vector: ten tensors in, four out. Traceable, and the same numbers as torch's own optimiser."""

    def __init__(self, sizes: Architecture, optimizer: Optimizer) -> None:
        self.optimizer = optimizer
        self.slots = layout(UNet(sizes))
        self.network = UNet(sizes, MATRICES)

    def __call__(
        self,
        weights: Tensor,
        first_moment: Tensor,
        second_moment: Tensor,
        step: Tensor,
        learning_rate: Tensor,
        noisy: Tensor,
        clean: Tensor,
        log_snr: Tensor,
        position: Tensor,
        weight: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """New weights and moments (P,), and the loss before the step: the mean of ``weight`` times squared errors.

        step: (), from 1. learning_rate: (). noisy, clean: (B, 3, L). log_snr, weight: (B,). position: (B, L). No
        texture is asked for: the network learns the one it is shown.
        """
        # Large parameters each by itself, so that a pass over one stays in a core's cache; all vectors as one.
        large = [slot for slot in self.slots if len(slot.shape) > 1]
        small = self.slots[len(large) :]
        sizes = [slot.size for slot in large] + [sum(slot.size for slot in small)]
        parts = [part.detach().requires_grad_() for part in weights.split(sizes)]
        with torch.enable_grad():
            named = {slot.name: part.view(slot.shape) for slot, part in zip(large, parts, strict=False)}
            named.update(matrices(parts[-1], [Slot(s.name, s.shape, 0) for s in small]))
            nothing = torch.zeros(noisy.shape[0], CONDITIONS)
            predicted = functional_call(self.network, named, (noisy, log_snr, position, nothing, nothing))
            loss = (weight * ((predicted - clean) ** 2).mean((1, 2))).mean()
            gradients = torch.autograd.grad(loss, parts)
        moments = zip(first_moment.split(sizes), second_moment.split(sizes), strict=True)
        updated = self._updated(parts, gradients, moments, step.double(), learning_rate.double())
        return (*(torch.cat(column) for column in zip(*updated, strict=True)), loss.detach())

    def _updated(
        self,
        parts: Sequence[Tensor],
        gradients: Sequence[Tensor],
        moments: Iterable[tuple[Tensor, Tensor]],
        step: Tensor,
        learning_rate: Tensor,
    ) -> list[tuple[Tensor, Tensor, Tensor]]:
        # Whatever is a number for the whole step is gathered into one factor, for as few passes as can be.
        o = self.optimizer
        squares = [gradient * gradient for gradient in gradients]
        norm = torch.stack([square.sum() for square in squares]).sum().sqrt()
        shrink = torch.clamp_max(o.clip / (norm + 1e-6), 1.0)
        rise = torch.sqrt(1.0 - o.beta2**step)
        rate = (learning_rate * rise / (1.0 - o.beta1**step)).float()
        least = (o.epsilon * rise).float()
        keep = (1.0 - learning_rate * o.weight_decay).float()
        by_first, by_second = (1.0 - o.beta1) * shrink, (1.0 - o.beta2) * shrink * shrink
        made = []
        for part, gradient, square, (first, second) in zip(parts, gradients, squares, moments, strict=True):
            first = first * o.beta1 + gradient * by_first
            second = second * o.beta2 + square * by_second
            made.append((part.detach() * keep - first * rate / (second.sqrt() + least), first, second))
        return made


def torch_optimizer(network: UNet, optimizer: Optimizer, learning_rate: float) -> torch.optim.AdamW:
    """The same optimizer as torch's own."""
    betas = (optimizer.beta1, optimizer.beta2)
    return torch.optim.AdamW(
        network.parameters(), learning_rate, betas, optimizer.epsilon, weight_decay=optimizer.weight_decay
    )


def torch_step(
    network: UNet,
    optimizer: torch.optim.Optimizer,
    clip: float,
    noisy: Tensor,
    clean: Tensor,
    log_snr: Tensor,
    position: Tensor,
    weight: Tensor,
) -> float:
    """What ``TrainingStep`` does, by torch's own parts: changes the network, and returns the loss before."""
    nothing = torch.zeros(noisy.shape[0], CONDITIONS)
    optimizer.zero_grad()
    predicted = network(noisy, log_snr, position, nothing, nothing)
    loss = (weight * ((predicted - clean) ** 2).mean((1, 2))).mean()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(network.parameters(), clip)
    optimizer.step()
    return float(loss.detach())


def _reversed(tensor: Tensor) -> Tensor:
    return tensor.permute(*reversed(range(tensor.dim()))) if tensor.dim() > 1 else tensor
