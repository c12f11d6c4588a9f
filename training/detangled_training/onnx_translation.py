"""A traced torch function as ONNX nodes.

Written node by node from the ATen operations that torch traced, for those that our networks are made of. An inference
engine is fast on few and plain nodes, and the same network gives the same bytes.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, fx

from detangled.errors import ModelError
from detangled_training.onnx_loops import lstm_backward_loop, lstm_loop

SAME = ("clone", "detach", "lift_fresh_copy", "alias", "detach_", "contiguous")
RESHAPES = ("view", "_unsafe_view", "reshape", "unsqueeze", "squeeze")
LOOPS = ("lstm", "lstm_backward")
PLAIN = {
    "sigmoid": "Sigmoid", "sin": "Sin", "cos": "Cos", "sqrt": "Sqrt", "reciprocal": "Reciprocal", "matmul": "MatMul",
    "bmm": "MatMul", "mul": "Mul", "add": "Add", "sub": "Sub", "div": "Div", "pow": "Pow", "clamp_max": "Min",
    "clamp_min": "Max", "tanh": "Tanh", "exp": "Exp", "log": "Log", "asinh": "Asinh", "abs": "Abs", "neg": "Neg",
    "sgn": "Sign", "relu": "Relu", "lt": "Less", "le": "LessOrEqual", "ge": "GreaterOrEqual",
}  # fmt: skip
ELEMENTS = {
    torch.float16: TensorProto.FLOAT16,
    torch.float32: TensorProto.FLOAT,
    torch.float64: TensorProto.DOUBLE,
    torch.int64: TensorProto.INT64,
}


class Translator:
    """ONNX nodes of a graph of ATen operations; what depends on no input is computed here and kept as a constant."""

    def __init__(self, traced: fx.GraphModule) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: dict[tuple[str, tuple[int, ...], bytes], onnx.TensorProto] = {}
        self.names: dict[fx.Node, Any] = {}
        self.known: dict[fx.Node, Any] = {}
        self.traced = traced

    def run(self, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        """Translate; inputs are named in the order of the traced function's arguments."""
        graph = self.traced.graph
        self.names.update(zip(graph.find_nodes(op="placeholder"), inputs, strict=True))
        for node in graph.nodes:
            if node.op == "get_attr":
                self.known[node] = operator.attrgetter(str(node.target))(self.traced)
            elif node.op == "call_function":
                self._visit(node)
        (made,) = next(node for node in graph.nodes if node.op == "output").args
        for node, name in zip(made, outputs, strict=True):
            self.emit("Identity", [self._of(node)], name)
        self._drop_unused(outputs)

    def _visit(self, node: fx.Node) -> None:
        if node.target is operator.getitem and node.args[0] not in self.known:
            self.names[node] = self.names[node.args[0]][node.args[1]]  # type: ignore[index]
        elif "val" in node.meta and not isinstance(node.meta["val"], Tensor | tuple | list):
            return  # a number of cells or strands; shapes are taken from what was traced
        elif all(given in self.known for given in node.all_input_nodes):
            arguments = fx.node.map_arg((node.args, node.kwargs), lambda given: self.known[given])
            self.known[node] = node.target(*arguments[0], **arguments[1])  # type: ignore[operator]
        elif _operation(node) == "ones_like":
            self.known[node] = torch.ones(node.meta["val"].shape)
        else:
            self._translate(node, _operation(node), node.args)

    def _translate(self, node: fx.Node, name: str, a: Any) -> None:
        value = node.meta["val"]
        if name in SAME or (name == "slice" and value.shape == a[0].meta["val"].shape):
            self.names[node] = self._of(a[0])
            return
        made = self.names[node] = node.name
        if name in RESHAPES:
            self.emit("Reshape", [self._of(a[0]), self._shape(value, a[0].meta["val"])], made)
        elif name in PLAIN and not node.kwargs:
            element = a[0].meta["val"].dtype if value.dtype is torch.bool else value.dtype
            self.emit(PLAIN[name], [self._of(x, element) for x in a[:2]], made)
        elif name == "rsqrt":
            self.emit("Sqrt", [self._of(a[0])], f"{made}.root")
            self.emit("Reciprocal", [f"{made}.root"], made)
        elif name == "where":
            self.emit("Where", [self._of(x) for x in a], made)
        elif name == "flip":
            (axis,) = a[1]
            order = self.integers(range(value.shape[axis] - 1, -1, -1))
            self.emit("Gather", [self._of(a[0]), order], made, axis=axis)
        elif name in ("slice_backward", "select_backward"):
            self._widened(made, name, a, value)
        elif name == "native_layer_norm":
            self.names[node] = [made, f"{made}.mean", f"{made}.rate"]
            axis = value[0].dim() - len(a[1])
            outputs = self.names[node]
            given = [self._of(x) for x in a[2:4]]
            self.nodes.append(
                helper.make_node(
                    "LayerNormalization", [self._of(a[0]), *given], outputs, name=made, axis=axis, epsilon=a[4]
                )
            )
        elif name in LOOPS:
            names = [self._of(x) for x in a]
            outputs = [made] if name == "lstm_backward" else [f"{made}.{k}" for k in range(len(value))]
            self.names[node] = made if name == "lstm_backward" else outputs
            first = value if name == "lstm_backward" else value[0]
            width = first.shape[2] // (4 if name == "lstm_backward" else 1)
            none = self.constant(np.zeros((first.shape[1], width), np.float32))
            add = lstm_loop if name == "lstm" else lstm_backward_loop
            add(self, made, names, outputs, none)
        elif name == "rsub":
            self.emit("Sub", [self._of(x, value.dtype) for x in (a[1], a[0])], made)
        elif name in ("mm", "addmm", "linear"):
            self._product(made, name, a)
        elif name in ("t", "transpose", "permute"):
            self.emit("Transpose", [self._of(a[0])], made, perm=_order(name, a, value.dim()))
        elif name == "expand":
            self.emit("Expand", [self._of(a[0]), self.integers(value.shape)], made)
        elif name in ("sum", "mean"):
            axes = a[1] if len(a) > 1 else range(a[0].meta["val"].dim())
            reduction = {"sum": "ReduceSum", "mean": "ReduceMean"}[name]
            self.emit(reduction, [self._of(a[0]), self.integers(axes)], made, keepdims=int(len(a) > 2 and a[2]))
        elif name == "cat":
            self.emit("Concat", [self._of(x) for x in a[0]], made, axis=a[1] if len(a) > 1 else 0)
        elif name == "stack":
            axis = (a[1] if len(a) > 1 else 0) % value.dim()
            for k, x in enumerate(a[0]):
                self.emit("Unsqueeze", [self._of(x), self.integers([axis])], f"{made}.{k}")
            self.emit("Concat", [f"{made}.{k}" for k in range(len(a[0]))], made, axis=axis)
        elif name in ("split", "split_with_sizes", "chunk"):
            axis = a[2] if len(a) > 2 else 0
            parts = self.names[node] = [f"{made}.{k}" for k in range(len(value))]
            sizes = self.integers([part.shape[axis] for part in value])
            self.nodes.append(helper.make_node("Split", [self._of(a[0]), sizes], parts, name=made, axis=axis))
        elif name in ("slice", "slice_backward") and len(a) > (4 if name == "slice" else 5) and a[-1] != 1:
            raise ModelError(f"the network has a slice that cannot be exported: {node.format_node()}")
        elif name == "slice":
            bounds = [self.integers([number]) for number in (a[2], min(a[3], 2**62), a[1])]
            self.emit("Slice", [self._of(a[0]), *bounds], made)
        elif name == "select":
            self.emit("Gather", [self._of(a[0]), self.constant(np.array(a[2], np.int64))], made, axis=a[1])
        elif name == "index" and all(x is None for x in a[1][:-1]):
            self.emit("Gather", [self._of(a[0]), self._of(a[1][-1])], made, axis=len(a[1]) - 1)
        elif name == "constant_pad_nd":
            sides = np.zeros((value.dim(), 2), np.int64)
            sides[::-1][: len(a[1]) // 2] = np.reshape(a[1], (-1, 2))
            self.emit("Pad", [self._of(a[0]), self.integers(sides.T.ravel())], made)
        elif name in ("softmax", "_softmax"):
            self.emit("Softmax", [self._of(a[0])], made, axis=a[1])
        elif name == "_softmax_backward_data":
            gradient, soft, axis = self._of(a[0]), self._of(a[1]), self.integers([a[2]])
            self.emit("Mul", [gradient, soft], f"{made}.product")
            self.emit("ReduceSum", [f"{made}.product", axis], f"{made}.sum", keepdims=1)
            self.emit("Mul", [soft, f"{made}.sum"], f"{made}.mean")
            self.emit("Sub", [f"{made}.product", f"{made}.mean"], made)
        elif name == "silu":
            self.emit("Sigmoid", [self._of(a[0])], f"{made}.part")
            self.emit("Mul", [self._of(a[0]), f"{made}.part"], made)
        elif name == "conv2d":
            usual: list[Any] = [None, [1, 1], [0, 0]]  # bias, stride, padding: torch leaves them away
            *given, stride, padding = [*list(a), *usual[len(a) - 2 :]]
            names = [self._of(x) for x in given if x is not None]
            self.emit("Conv", names, made, strides=stride, pads=[*padding, *padding])
        elif name == "upsample_nearest2d":
            scales = self.constant(np.array([1.0, 1.0, *a[2]], np.float32))
            options = {"mode": "nearest", "nearest_mode": "floor", "coordinate_transformation_mode": "asymmetric"}
            self.emit("Resize", [self._of(a[0]), "", scales], made, **options)
        elif name == "group_norm":
            self._normalization(made, node, a)
        elif name in ("_to_copy", "to"):
            self.emit("Cast", [self._of(a[0])], made, to=ELEMENTS[value.dtype])
        else:
            raise ModelError(f"the network has an operation that cannot be exported: {node.format_node()}")

    def _widened(self, made: str, name: str, a: Any, value: Tensor) -> None:
        """What was taken of a larger tensor, in its place among zeros."""
        gradient, shape, axis, first = a[0], a[1], a[2] % value.dim(), a[3] % a[1][a[2]]
        taken = self._of(gradient)
        width = 1
        if name == "select_backward":
            taken = f"{made}.one"
            self.emit("Unsqueeze", [self._of(gradient), self.integers([axis])], taken)
        else:
            width = gradient.meta["val"].shape[axis]
        sides = np.zeros((2, value.dim()), np.int64)
        sides[0, axis], sides[1, axis] = first, shape[axis] - first - width
        self.emit("Pad", [taken, self.integers(sides.ravel())], made)

    def _product(self, made: str, name: str, a: Any) -> None:
        """A matrix product; a transposed factor is read as it lies."""
        given = (*a[1:], a[0]) if name == "addmm" else a
        turned = {"transA": 0, "transB": int(name == "linear")}
        names = [self._of(x) for x in given]
        for k, flag in enumerate(turned):
            if isinstance(given[k], fx.Node) and _operation(given[k]) == "t":
                names[k] = self._of(given[k].args[0])
                turned[flag] ^= 1
        self.emit("Gemm", names, made, **turned)

    def _normalization(self, made: str, node: fx.Node, a: Any) -> None:
        """Group normalisation as normalisation of instances: onnxruntime has a kernel of its own for that alone."""
        groups, (weight, bias) = a[1], (*a[2:4], None, None)[:2]
        one, zero = (self.constant(np.full(groups, number, np.float32)) for number in (1.0, 0.0))
        grouped, plain = f"{made}.grouped", f"{made}.plain"
        self.emit("Reshape", [self._of(a[0]), self.integers([0, groups, -1])], grouped)
        epsilon = a[4] if len(a) > 4 else 1e-5
        self.emit("InstanceNormalization", [grouped, one, zero], plain, epsilon=epsilon)
        channels = node.meta["val"].shape[1]
        back = made if weight is None else f"{made}.back"
        self.emit("Reshape", [plain, self.integers([0, channels, 1, -1])], back)
        if weight is not None:
            for k, parameter in enumerate((weight, bias)):
                self.emit("Reshape", [self._of(parameter), self.integers([channels, 1, 1])], f"{made}.{k}")
            self.emit("Mul", [back, f"{made}.0"], f"{made}.scaled")
            self.emit("Add", [f"{made}.scaled", f"{made}.1"], made)

    def _of(self, x: Any, element: torch.dtype = torch.float32) -> str:
        """The name of a value; a number becomes a constant of this type."""
        if not isinstance(x, fx.Node):
            return self.constant(torch.tensor(x, dtype=element).numpy())
        if x in self.known:
            return self.constant(self.known[x].detach().numpy())
        return str(self.names[x])

    def constant(self, array: NDArray[Any]) -> str:
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self.constants:
            self.constants[key] = numpy_helper.from_array(array, f"constant.{len(self.constants)}")
        return self.constants[key].name

    def integers(self, numbers: Any) -> str:
        return self.constant(np.array([int(number) for number in numbers], np.int64))

    def _shape(self, made: Tensor, given: Tensor) -> str:
        """A shape to reshape to. A free axis is 0, as in what is given, where it stays in place; else it is -1."""
        shape = []
        for k, size in enumerate(made.shape):
            if isinstance(size, int):
                shape.append(size)
            else:
                shape.append(0 if k < given.dim() and str(given.shape[k]) == str(size) else -1)
        return self.integers(shape)

    def emit(self, operator_name: str, inputs: list[str], output: str, **attributes: Any) -> None:
        self.nodes.append(helper.make_node(operator_name, inputs, [output], name=output, **attributes))

    def _drop_unused(self, outputs: Sequence[str]) -> None:
        needed = set(outputs)
        kept = []
        for node in reversed(self.nodes):
            if needed & set(node.output):
                kept.append(node)
                needed.update(node.input)
                for attribute in node.attribute:
                    needed.update(name for inner in attribute.g.node for name in inner.input)
        self.nodes = kept[::-1]
        self.constants = {key: tensor for key, tensor in self.constants.items() if tensor.name in needed}


def _operation(node: fx.Node) -> str:
    """The name of an ATen operation without its overload."""
    return str(node.target).removeprefix("aten.").removeprefix("detangled.").split(".")[0]


def _order(name: str, a: Any, axes: int) -> list[int]:
    if name == "permute":
        return [axis % axes for axis in a[1]]
    order = list(range(axes))
    first, second = (0, 1) if name == "t" else (a[1] % axes, a[2] % axes)
    order[first], order[second] = order[second], order[first]
    return order
