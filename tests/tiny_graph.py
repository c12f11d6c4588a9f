"""ONNX graphs put together by hand, without torch, for the models that tests make themselves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET, IR_VERSION = 20, 10


class TinyGraph:
    """Nodes and constants, named as they come."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def do(self, operator: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        made = output or f"{operator}.{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [made], **attributes))
        return made

    def constant(self, value: Any, element: type = np.float32) -> str:
        name = f"constant.{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.array(value, dtype=element), name))
        return name

    def axes(self, *axes: int) -> str:
        return self.constant(axes, np.int64)

    def serialized(
        self,
        name: str,
        inputs: dict[str, list[Any]],
        outputs: dict[str, list[Any]],
        more: Sequence[onnx.TensorProto] = (),
    ) -> bytes:
        def described(shapes: dict[str, list[Any]]) -> list[onnx.ValueInfoProto]:
            return [helper.make_tensor_value_info(key, TensorProto.FLOAT, shape) for key, shape in shapes.items()]

        graph = helper.make_graph(self.nodes, name, described(inputs), described(outputs), [*more, *self.constants])
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
        onnx.checker.check_model(model)
        return bytes(model.SerializeToString(deterministic=True))
