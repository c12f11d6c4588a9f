"""What the U-Net is built of: layers of two kinds, with the same parameters.

``CONVOLUTIONS`` are torch's own, for training and for drawing strands; signals are (B, C, 1, L), since inference
engines are fastest on images. ``MATRICES`` do the same by matrix products over windows of (B, L, C), with gradients by
hand, for the graphs that run without torch: nothing in them is left that an inference engine lacks.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

WIDTH = 3  # cells that a convolution sees
NORM_EPSILON = 1e-5


class Convolution(nn.Module):
    """A convolution over (B, C, 1, L), padded with zeros; ``step`` "down" takes each second cell, "up" doubles them."""

    def __init__(self, given: int, made: int, width: int = WIDTH, step: str = "", bias: bool = True) -> None:
        super().__init__()
        self.width, self.step = width, step
        self.weight = nn.Parameter(self.stored(torch.empty(made, given, width)))
        self.bias = nn.Parameter(torch.zeros(made)) if bias else None
        nn.init.normal_(self.weight, std=1.0 / math.sqrt(given * width))

    def stored(self, weight: Tensor) -> Tensor:
        return weight

    def forward(self, x: Tensor) -> Tensor:
        if self.step == "up":
            x = functional.interpolate(x, scale_factor=(1.0, 2.0), mode="nearest")
        stride = (1, 2 if self.step == "down" else 1)
        return functional.conv2d(x, self.weight[:, :, None], self.bias, stride, (0, self.width // 2))


class Linear(nn.Module):
    """A linear map of the last axis."""

    def __init__(self, given: int, made: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(self.stored(torch.empty(made, given)))
        self.bias = nn.Parameter(torch.zeros(made))
        nn.init.normal_(self.weight, std=1.0 / math.sqrt(given))

    def stored(self, weight: Tensor) -> Tensor:
        return weight

    def forward(self, x: Tensor) -> Tensor:
        return functional.linear(x, self.weight, self.bias)


class Normalization(nn.Module):
    """Group normalisation, then a scale and a shift of each channel: its own, and those of a sample (B, C)."""

    def __init__(self, channels: int, groups: int) -> None:
        super().__init__()
        self.groups = groups
        self.weight = nn.Parameter(torch.ones(channels))
        self.bias = nn.Parameter(torch.zeros(channels))

    def forward(self, x: Tensor, scale: Tensor | None = None, shift: Tensor | None = None) -> Tensor:
        if scale is None or shift is None:
            return functional.group_norm(x, self.groups, self.weight, self.bias, NORM_EPSILON)
        x = functional.group_norm(x, self.groups, eps=NORM_EPSILON)
        return (
            x * (self.weight * (1.0 + scale))[:, :, None, None] + (self.bias * (1.0 + scale) + shift)[:, :, None, None]
        )


def attend(x: Tensor, heads: int) -> Tensor:
    """Self-attention of queries, keys and values (B, 3 C, 1, L): (B, C, 1, L)."""
    batch, channels, _, cells = x.shape
    width = channels // (3 * heads)
    query, key, value = x.view(batch, 3 * heads, width, cells).split(heads, 1)
    scores = torch.matmul((query * width**-0.5).transpose(2, 3), key)
    return torch.matmul(value, torch.softmax(scores, -1).transpose(2, 3)).reshape(batch, -1, 1, cells)


class _Convolve(torch.autograd.Function):
    """x (B, L, C) by weight (W, C, D): (B, L', D), as one matrix product over windows; so are both its gradients."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor | None, step: str) -> Tensor:
        windows = _windows(x, weight.shape[0], step)
        ctx.step, ctx.biased = step, bias is not None
        ctx.save_for_backward(windows, weight)
        return _product(windows, weight, bias)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        windows, weight = ctx.saved_tensors
        (gradient,) = gradients
        width, given, made = weight.shape
        rows = gradient.reshape(-1, made)
        by_weight = torch.mm(windows.reshape(-1, width * given).t(), rows).view(width, given, made)
        if width == 1:
            by_x = torch.mm(rows, weight[0].t()).view(*gradient.shape[:2], given)
        elif ctx.step == "down":
            # Cell 2 i was seen by window i alone, at its middle; cell 2 i + 1 by windows i and i + 1, at their ends.
            after = functional.pad(gradient, (0, 0, 0, 1))[:, 1:]
            even = torch.mm(rows, weight[1].t())
            odd = torch.mm(
                torch.cat([gradient, after], dim=2).view(-1, 2 * made), torch.cat([weight[2], weight[0]], dim=1).t()
            )
            by_x = torch.stack([even, odd], dim=1).view(gradient.shape[0], -1, given)
        else:
            seen = _windows(gradient, width, "").view(-1, width * made)
            row = torch.arange(given)[:, None] + given * torch.arange(width - 1, -1, -1)
            mirrored = weight.view(-1, made)[row].view(given, -1)  # its last tap first
            by_x = torch.mm(seen, mirrored.t()).view(*gradient.shape[:2], given)
            if ctx.step == "up":
                by_x = by_x.view(gradient.shape[0], -1, 2, given).sum(2)
        return by_x, by_weight, rows.sum(0) if ctx.biased else None, None


def _windows(x: Tensor, width: int, step: str) -> Tensor:
    """The cells each output cell sees, (B, L', W C), of x (B, L, C): zeros beyond the ends."""
    if width == 1:
        return x
    half = width // 2
    cells = x.shape[1]
    made = {"": cells, "down": cells // 2, "up": 2 * cells}[step]
    cell = torch.arange(made)[:, None] * (2 if step == "down" else 1) + torch.arange(width)
    if step == "up":
        cell = torch.div(cell + half, 2, rounding_mode="floor")
    return functional.pad(x, (0, 0, half, half))[:, cell].flatten(2)


def _product(windows: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    rows, matrix = windows.reshape(-1, windows.shape[2]), weight.reshape(-1, weight.shape[2])
    made = torch.mm(rows, matrix) if bias is None else torch.addmm(bias, rows, matrix)
    return made.view(windows.shape[0], -1, weight.shape[2])


class MatrixConvolution(Convolution):
    """The same over (B, L, C), its weight stored as (W, C, D)."""

    def stored(self, weight: Tensor) -> Tensor:
        return weight.permute(2, 1, 0).contiguous()

    def forward(self, x: Tensor) -> Tensor:
        if not torch.is_grad_enabled():
            return _product(_windows(x, self.width, self.step), self.weight, self.bias)
        return _Convolve.apply(x, self.weight, self.bias, self.step)


class MatrixLinear(Linear):
    """The same, its weight stored as (C, D)."""

    def stored(self, weight: Tensor) -> Tensor:
        return weight.t().contiguous()

    def forward(self, x: Tensor) -> Tensor:
        return torch.addmm(self.bias, x, self.weight)


class _Normalize(torch.autograd.Function):
    """x (B, L, C) to zero mean and unit variance in each group of channels, times scale (B, C), plus shift (B, C)."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, scale: Tensor, shift: Tensor, groups: int) -> Tensor:
        centred, deviation = _centred(x, groups)
        ctx.groups = groups
        ctx.save_for_backward(centred, deviation, scale)
        return centred * (scale / deviation)[:, None] + shift[:, None]

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        centred, deviation, scale = ctx.saved_tensors
        (gradient,) = gradients
        factor = scale / deviation
        by_shift = gradient.sum(1)
        by_factor = (gradient * centred).sum(1)
        cells = centred.shape[1]
        mean = _group_mean(factor * by_shift, ctx.groups) / cells
        slope = _group_mean(factor * by_factor, ctx.groups) / (cells * deviation * deviation)
        by_x = gradient * factor[:, None] - centred * slope[:, None] - mean[:, None]
        return by_x, by_factor / deviation, by_shift, None


def _group_mean(x: Tensor, groups: int) -> Tensor:
    """Means over each group's channels of x (B, C), at every channel."""
    width = x.shape[1] // groups
    member = (torch.arange(x.shape[1])[:, None] // width == torch.arange(groups)).float()
    return torch.mm(torch.mm(x, member / width), member.t())


def _centred(x: Tensor, groups: int) -> tuple[Tensor, Tensor]:
    """x (B, L, C) less its groups' means, and the deviation (B, C) of what is left."""
    centred = x - _group_mean(x.mean(1), groups)[:, None]
    return centred, torch.sqrt(_group_mean((centred * centred).mean(1), groups) + NORM_EPSILON)


class MatrixNormalization(Normalization):
    """The same over (B, L, C)."""

    def forward(self, x: Tensor, scale: Tensor | None = None, shift: Tensor | None = None) -> Tensor:
        if scale is not None and shift is not None:
            factor = self.weight * (1.0 + scale)
            term = self.bias * (1.0 + scale) + shift
        else:
            factor, term = self.weight.expand(x.shape[0], -1), self.bias.expand(x.shape[0], -1)
        if not torch.is_grad_enabled():
            centred, deviation = _centred(x, self.groups)
            return centred * (factor / deviation)[:, None] + term[:, None]
        return _Normalize.apply(x, factor, term, self.groups)


class _Swish(torch.autograd.Function):
    """x sigmoid(x), with no more passes over memory in its gradient than it needs."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        part = torch.sigmoid(x)
        made = x * part
        ctx.save_for_backward(part, made)
        return made

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        part, made = ctx.saved_tensors
        return gradients[0] * (part + made - made * part)


def matrix_swish(x: Tensor) -> Tensor:
    return _Swish.apply(x) if torch.is_grad_enabled() else x * torch.sigmoid(x)


def matrix_attend(x: Tensor, heads: int) -> Tensor:
    """Self-attention of queries, keys and values (B, L, 3 C): (B, L, C)."""
    batch, cells, channels = x.shape
    width = channels // (3 * heads)
    query, key, value = x.view(batch, cells, 3 * heads, width).transpose(1, 2).split(heads, 1)
    scores = torch.matmul(query * width**-0.5, key.transpose(2, 3))
    return torch.matmul(torch.softmax(scores, -1), value).transpose(1, 2).reshape(batch, cells, -1)


class Layers(NamedTuple):
    """What a network is built of: a kind of each layer, how signals (B, C, L) are arranged for it, and back."""

    convolution: Callable[..., Convolution]
    linear: Callable[[int, int], Linear]
    normalization: Callable[[int, int], Normalization]
    attend: Callable[[Tensor, int], Tensor]
    swish: Callable[[Tensor], Tensor]
    channel_axis: int
    arrange: Callable[[Tensor], Tensor]
    restore: Callable[[Tensor], Tensor]


CONVOLUTIONS = Layers(
    Convolution, Linear, Normalization, attend, functional.silu, 1, lambda x: x.unsqueeze(2), lambda x: x.squeeze(2)
)
MATRICES = Layers(
    MatrixConvolution,
    MatrixLinear,
    MatrixNormalization,
    matrix_attend,
    matrix_swish,
    2,
    lambda x: x.transpose(1, 2),
    lambda x: x.transpose(1, 2),
)
