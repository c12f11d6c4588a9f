"""A bidirectional LSTM (Hochreiter and Schmidhuber 1997), and its recurrence as two operations of ours.

Torch's own LSTM trains. Traced, it would come apart into thousands of operations; so a graph that runs without torch is
traced from the same parameters by ``lstm`` and ``lstm_backward``, which become a loop each (``onnx_translation``).
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn


class BidirectionalLSTM(nn.Module):
    """Hidden states (B, N, 2 H) of sequences (B, N, C), read from both ends. ``traceable``: by operations of ours."""

    def __init__(self, given: int, width: int) -> None:
        super().__init__()
        self.lstm = nn.LSTM(given, width, batch_first=True, bidirectional=True)
        self.traceable = False

    def forward(self, x: Tensor) -> Tensor:
        if not self.traceable:
            return self.lstm(x)[0]
        steps = x.transpose(0, 1)
        onward = self._read(steps, "")
        backward = self._read(steps.flip(0), "_reverse")
        return torch.cat([onward, backward.flip(0)], dim=2).transpose(0, 1).contiguous()

    def _read(self, steps: Tensor, suffix: str) -> Tensor:
        """Hidden states (N, B, H) of steps (N, B, C)."""
        weights = {name: getattr(self.lstm, f"{name}_l0{suffix}") for name in ("weight_ih", "weight_hh")}
        bias = getattr(self.lstm, f"bias_ih_l0{suffix}") + getattr(self.lstm, f"bias_hh_l0{suffix}")
        rows = steps.reshape(-1, steps.shape[2])
        gates = torch.addmm(_gates_in_order(bias), rows, _gates_in_order(weights["weight_ih"]).t())
        return lstm(gates.view(*steps.shape[:2], -1), _gates_in_order(weights["weight_hh"]).t().contiguous())[0]


def _gates_in_order(x: Tensor) -> Tensor:
    """Torch's rows, of the input, forget, cell and output gates (4 H, ...), with the cell's last."""
    given, forget, cell, output = x.chunk(4)
    return torch.cat([given, forget, output, cell])


@torch.library.custom_op("detangled::lstm", mutates_args=())
def lstm(gates: Tensor, weight: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Hidden states, cells (N, B, H) and open gates (N, B, 4 H) of what comes into the gates (N, B, 4 H).

    weight: (H, 4 H), from the hidden state before. Gates: input, forget, output, cell.
    """
    steps, batch, width = gates.shape[0], gates.shape[1], weight.shape[0]
    hidden, cells = gates.new_empty(steps, batch, width), gates.new_empty(steps, batch, width)
    opened = torch.empty_like(gates)
    h, c = gates.new_zeros(batch, width), gates.new_zeros(batch, width)
    for k in range(steps):
        total = torch.addmm(gates[k], h, weight)
        share, new = torch.sigmoid(total[:, : 3 * width]), torch.tanh(total[:, 3 * width :])
        given, forget, output = share.split(width, 1)
        c = forget * c + given * new
        h = output * torch.tanh(c)
        hidden[k], cells[k], opened[k] = h, c, torch.cat([share, new], 1)
    return hidden, cells, opened


@torch.library.custom_op("detangled::lstm_backward", mutates_args=())
def lstm_backward(gradient: Tensor, cells: Tensor, opened: Tensor, weight: Tensor) -> Tensor:
    """The gradient by what comes into the gates (N, B, 4 H), of one by the hidden states (N, B, H)."""
    steps, batch, width = gradient.shape
    out = torch.empty_like(opened)
    by_h, by_c = gradient.new_zeros(batch, width), gradient.new_zeros(batch, width)
    for k in range(steps - 1, -1, -1):
        given, forget, output, new = opened[k].split(width, 1)
        before = cells[k - 1] if k else torch.zeros_like(by_c)
        curved = torch.tanh(cells[k])
        by_h = by_h + gradient[k]
        by_c = by_c + by_h * output * (1.0 - curved * curved)
        by_share = torch.cat([by_c * new, by_c * before, by_h * curved], 1)
        share = opened[k, :, : 3 * width]
        out[k] = torch.cat([by_share * share * (1.0 - share), by_c * given * (1.0 - new * new)], 1)
        by_h, by_c = out[k] @ weight.t(), by_c * forget
    return out


@lstm.register_fake
def _(gates: Tensor, weight: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    states = gates.new_empty(*gates.shape[:2], weight.shape[0])
    return states, torch.empty_like(states), torch.empty_like(gates)


@lstm_backward.register_fake
def _(gradient: Tensor, cells: Tensor, opened: Tensor, weight: Tensor) -> Tensor:
    return torch.empty_like(opened)


def _setup(ctx: Any, inputs: tuple[Tensor, Tensor], output: tuple[Tensor, Tensor, Tensor]) -> None:
    ctx.save_for_backward(*output, inputs[1])


def _backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor | None]:
    hidden, cells, opened, weight = ctx.saved_tensors
    by_gates = lstm_backward(gradients[0], cells, opened, weight)
    by_weight = None
    if ctx.needs_input_grad[1]:
        by_weight = torch.matmul(hidden[:-1].flatten(0, 1).t(), by_gates[1:].flatten(0, 1))
    return by_gates, by_weight


lstm.register_autograd(_backward, setup_context=_setup)
