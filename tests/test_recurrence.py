"""The LSTM as operations of ours: against torch's own, in values and gradients, and as the loops of ONNX."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")

from torch.fx.experimental.proxy_tensor import make_fx  # noqa: E402

from detangled_training.onnx_files import serialized  # noqa: E402
from detangled_training.onnx_translation import Translator  # noqa: E402
from detangled_training.recurrence import BidirectionalLSTM, lstm, lstm_backward  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")


def both_lstms(given: int, width: int) -> tuple[BidirectionalLSTM, BidirectionalLSTM]:
    torch.manual_seed(1)
    own, ours = BidirectionalLSTM(given, width).double(), BidirectionalLSTM(given, width).double()
    ours.load_state_dict(own.state_dict())
    ours.traceable = True
    return own, ours


@pytest.mark.parametrize(("batch", "steps", "given", "width"), [(3, 7, 5, 4), (1, 1, 2, 3), (2, 40, 6, 1)])
def test_the_traceable_lstm_equals_torch_in_values_and_all_gradients(
    batch: int, steps: int, given: int, width: int
) -> None:
    own, ours = both_lstms(given, width)
    x = [torch.randn(batch, steps, given, dtype=torch.float64).requires_grad_()]
    x.append(x[0].detach().clone().requires_grad_())
    wanted, found = own(x[0]), ours(x[1])
    assert found.shape == (batch, steps, 2 * width)
    torch.testing.assert_close(found, wanted, rtol=0, atol=1e-12)
    direction = torch.randn_like(wanted)
    (wanted * direction).sum().backward()
    (found * direction).sum().backward()
    torch.testing.assert_close(x[1].grad, x[0].grad, rtol=0, atol=1e-11)
    theirs = dict(own.named_parameters())
    assert len(theirs) == 8
    for name, parameter in ours.named_parameters():
        assert parameter.grad is not None, name
        assert theirs[name].grad.abs().max() > 0.0 or steps == 1
        torch.testing.assert_close(parameter.grad, theirs[name].grad, rtol=0, atol=1e-11, msg=name)


def test_the_operations_gradients_are_central_differences() -> None:
    torch.manual_seed(2)
    gates = torch.randn(5, 2, 12, dtype=torch.float64, requires_grad=True)
    weight = torch.randn(3, 12, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda g, w: lstm(g, w)[0], (gates, weight))


def loop(function: Any, given: tuple[Any, ...], names: list[str], outputs: list[str]) -> Any:
    """A session of a traced function of some tensors."""
    translator = Translator(make_fx(function)(*given))
    translator.run(names, outputs)
    with torch.no_grad():
        made = function(*given)
    inputs = {name: list(x.shape) for name, x in zip(names, given, strict=True)}
    shapes = {name: list(x.shape) for name, x in zip(outputs, made, strict=True)}
    model = serialized("loop", translator, inputs, shapes, [])
    assert [node.op_type for node in onnx.load_from_string(model).graph.node].count("Scan") == 1
    return onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])


@pytest.mark.parametrize("steps", [1, 2, 9])
def test_the_loops_of_onnx_are_those_operations(steps: int) -> None:
    torch.manual_seed(3)
    batch, width = 3, 4
    gates, weight = torch.randn(steps, batch, 4 * width), torch.randn(width, 4 * width)
    names = ["hidden", "cells", "opened"]
    onward = loop(lambda g, w: lstm(g, w), (gates, weight), ["gates", "weight"], names)
    other = torch.randn_like(gates)
    wanted = [x.numpy() for x in lstm(other, weight)]
    for found, true in zip(onward.run(None, {"gates": other.numpy(), "weight": weight.numpy()}), wanted, strict=True):
        np.testing.assert_allclose(found, true, rtol=0, atol=1e-6)

    gradient, cells, opened = torch.randn(steps, batch, width), *map(torch.from_numpy, wanted[1:])
    given = (gradient, cells, opened, weight)
    names = ["gradient", "cells", "opened", "weight"]
    back = loop(lambda *x: (lstm_backward(*x),), given, names, ["by_gates"])
    (found,) = back.run(None, {name: x.numpy() for name, x in zip(names, given, strict=True)})
    np.testing.assert_allclose(found, lstm_backward(*given).numpy(), rtol=0, atol=1e-6)
