"""The LSTM's two operations (``recurrence``) as ONNX loops over the steps of a sequence."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import onnx
from onnx import TensorProto, helper

if TYPE_CHECKING:
    from detangled_training.onnx_translation import Translator


def lstm_loop(translator: Translator, made: str, given: list[str], outputs: list[str], none: str) -> None:
    """``recurrence.lstm`` as a loop over its steps."""
    gates, weight = given
    body = [
        _node("MatMul", ["h", weight], "by_hidden"),
        _node("Add", ["by_hidden", "gates"], "total"),
        _split("total", ["a", "b", "c", "d"]),
        *(_node("Sigmoid", [x], f"{x}.open") for x in "abc"),
        _node("Tanh", ["d"], "d.open"),
        _node("Mul", ["b.open", "cell"], "kept"),
        _node("Mul", ["a.open", "d.open"], "new"),
        _node("Add", ["kept", "new"], "next_cell"),
        _node("Tanh", ["next_cell"], "curved"),
        _node("Mul", ["c.open", "curved"], "next_h"),
        _node("Concat", ["a.open", "b.open", "c.open", "d.open"], "opened", axis=1),
        *(_node("Identity", [x], f"{x}.out") for x in ("next_h", "next_cell")),
    ]
    states, steps = ["h", "cell"], ["gates"]
    _loop(
        translator,
        made,
        body,
        states,
        steps,
        ["next_h", "next_cell", "next_h.out", "next_cell.out", "opened"],
        [none, none, gates],
        [f"{made}.last_h", f"{made}.last_cell", *outputs],
        [0],
    )


def lstm_backward_loop(translator: Translator, made: str, given: list[str], outputs: list[str], none: str) -> None:
    """``recurrence.lstm_backward`` as a loop from the last step to the first."""
    gradient, cells, opened, weight = given
    # The cell before each step.
    starts, ends = translator.integers([0]), translator.integers([-1])
    translator.emit("Slice", [cells, starts, ends], f"{made}.all_but_last")
    translator.emit("Unsqueeze", [none, translator.integers([0])], f"{made}.none")
    translator.emit("Concat", [f"{made}.none", f"{made}.all_but_last"], f"{made}.before", axis=0)
    one = translator.constant(np.array(1.0, np.float32))
    turned = f"{made}.weight"
    translator.emit("Transpose", [weight], turned, perm=[1, 0])

    def curve(x: str, made: str) -> list[onnx.NodeProto]:
        """x (1 - x), the slope of a sigmoid."""
        return [_node("Sub", [one, x], f"{made}.rest"), _node("Mul", [x, f"{made}.rest"], made)]

    body = [
        _split("opened", ["a", "b", "c", "d"]),
        _node("Add", ["by_h", "gradient"], "by_hidden"),
        _node("Tanh", ["cell"], "curved"),
        _node("Mul", ["by_hidden", "c"], "by_curved"),
        _node("Mul", ["curved", "curved"], "curved_square"),
        _node("Sub", [one, "curved_square"], "curved_slope"),
        _node("Mul", ["by_curved", "curved_slope"], "by_cell_now"),
        _node("Add", ["by_c", "by_cell_now"], "by_cell"),
        *curve("a", "a.slope"), *curve("b", "b.slope"), *curve("c", "c.slope"),
        _node("Mul", ["d", "d"], "d_square"), _node("Sub", [one, "d_square"], "d.slope"),
        _node("Mul", ["by_cell", "d"], "by_a.now"), _node("Mul", ["by_a.now", "a.slope"], "by_a"),
        _node("Mul", ["by_cell", "before"], "by_b.now"), _node("Mul", ["by_b.now", "b.slope"], "by_b"),
        _node("Mul", ["by_hidden", "curved"], "by_c.now"), _node("Mul", ["by_c.now", "c.slope"], "by_output"),
        _node("Mul", ["by_cell", "a"], "by_d.now"), _node("Mul", ["by_d.now", "d.slope"], "by_d"),
        _node("Concat", ["by_a", "by_b", "by_output", "by_d"], "by_gates", axis=1),
        _node("MatMul", ["by_gates", turned], "next_h"),
        _node("Mul", ["by_cell", "b"], "next_c"),
    ]  # fmt: skip
    states, steps = ["by_h", "by_c"], ["gradient", "cell", "before", "opened"]
    _loop(
        translator,
        made,
        body,
        states,
        steps,
        ["next_h", "next_c", "by_gates"],
        [none, none, gradient, cells, f"{made}.before", opened],
        [f"{made}.last_h", f"{made}.last_c", *outputs],
        [1],
    )


def _loop(
    translator: Translator,
    made: str,
    body: list[onnx.NodeProto],
    states: list[str],
    steps: list[str],
    results: list[str],
    given: list[str],
    outputs: list[str],
    direction: list[int],
) -> None:
    """A loop over the first axis of what is given, whose names inside are all its own."""
    own = {*states, *steps, *(name for node in body for name in node.output)}
    for node in body:
        for names in (node.input, node.output):
            names[:] = [f"{made}.{name}" if name in own else name for name in names]
    inside = [helper.make_tensor_value_info(f"{made}.{x}", TensorProto.FLOAT, None) for x in (*states, *steps)]
    told = [helper.make_tensor_value_info(f"{made}.{x}", TensorProto.FLOAT, None) for x in results]
    graph = helper.make_graph(body, f"{made}.step", inside, told)
    translator.nodes.append(
        helper.make_node(
            "Scan",
            given,
            outputs,
            name=made,
            body=graph,
            num_scan_inputs=len(steps),
            scan_input_directions=direction * len(steps),
            scan_output_directions=direction * (len(results) - len(states)),
        )
    )


def _node(operator_name: str, inputs: list[str], output: str, **attributes: Any) -> onnx.NodeProto:
    return helper.make_node(operator_name, inputs, [output], **attributes)


def _split(given: str, parts: list[str]) -> onnx.NodeProto:
    """Even parts of the last axis."""
    return helper.make_node("Split", [given], parts, axis=1, num_outputs=len(parts))
