"""Exported models as files: a traced graph to ONNX bytes, written with its manifest once it agrees with torch."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from detangled.errors import ModelError, WriteError
from detangled_training.onnx_translation import Translator

OPSET = 20
IR_VERSION = 10  # of opset 20's time: onnxruntime 1.20 reads it
TOLERANCE = 1e-5  # between torch and onnxruntime
LARGE = 1024  # numbers of a constant that are worth storing narrowly


@dataclass(frozen=True)
class Exported:
    """A model that was written, with its manifest, and the largest difference between onnxruntime and torch on it."""

    path: Path
    difference: float

    @property
    def manifest(self) -> Path:
        return self.path.with_suffix(".json")


def serialized(
    name: str,
    translator: Translator,
    inputs: dict[str, Any],
    outputs: dict[str, Any],
    initializers: list[onnx.TensorProto],
) -> bytes:
    def described(shapes: dict[str, Any]) -> list[onnx.ValueInfoProto]:
        return [helper.make_tensor_value_info(key, TensorProto.FLOAT, shape) for key, shape in shapes.items()]

    nodes = list(translator.nodes)
    initializers = list(initializers)
    for tensor in translator.constants.values():
        narrow = _narrowed(tensor)
        initializers.append(narrow)
        if narrow is not tensor:
            nodes.insert(0, helper.make_node("Cast", [narrow.name], [tensor.name], to=TensorProto.FLOAT))
    graph = helper.make_graph(nodes, name, described(inputs), described(outputs), initializers)
    opset = [helper.make_opsetid("", OPSET)]
    model = helper.make_model(graph, opset_imports=opset, ir_version=IR_VERSION, producer_name="detangled")
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString(deterministic=True))


def _narrowed(tensor: onnx.TensorProto) -> onnx.TensorProto:
    """A large constant in float16, where that keeps all its numbers: half the bytes."""
    array = numpy_helper.to_array(tensor)
    if array.dtype != np.float32 or array.size < LARGE:
        return tensor
    with np.errstate(over="ignore"):
        narrow = array.astype(np.float16)
    if not np.array_equal(narrow.astype(np.float32), array):
        return tensor
    return numpy_helper.from_array(narrow, f"{tensor.name}.narrow")


def write_model(path: Path, data: bytes, manifest: dict[str, Any], check: Callable[[Path], float]) -> Exported:
    """Write a model and its manifest, each of them whole.

    Stopped between the two, it leaves a model that is not its manifest's: whoever reads them refuses them for that.
    """
    manifest = {**manifest, "sha256": hashlib.sha256(data).hexdigest()}
    text = json.dumps(manifest, indent=2) + "\n"
    new = [
        (path.with_name(f".{path.name}.new"), path),
        (path.with_name(f".{path.stem}.json.new"), path.with_suffix(".json")),
    ]
    try:
        new[0][0].write_bytes(data)
        difference = check(new[0][0])
        new[1][0].write_text(text, encoding="utf-8")
        for made, place in new:
            os.replace(made, place)
    except OSError as error:
        raise WriteError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        for made, _ in new:
            made.unlink(missing_ok=True)
    return Exported(path, difference)


def difference(name: str, found: NDArray[Any], wanted: NDArray[Any], tolerance: float = TOLERANCE) -> float:
    """The largest difference. Raises ModelError where it is more than the tolerance."""
    largest = float(np.max(np.abs(found - wanted)))
    if not largest <= tolerance:
        raise ModelError(f"{name} by onnxruntime and by torch differ by {largest:.2g}, more than {tolerance:.0e}")
    return largest


def session(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
