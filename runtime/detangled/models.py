"""Exported models: ONNX files, and a library of strands, each with a JSON manifest that says what it is and what it
takes to use it.

A model is used only where its manifest is whole, of this version, and its bytes are those the manifest was written
for. Models come with detangled; the environment variable DETANGLED_MODELS names another folder.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from detangled.diffusion.schedule import CosineSchedule
from detangled.diffusion.whitening import Whitening
from detangled.errors import DetangledError, ModelError

if TYPE_CHECKING:
    import onnxruntime

FORMAT = "detangled model"
VERSION = 1
FOLDER_VARIABLE = "DETANGLED_MODELS"

DENOISER = "denoiser"
TRAINING_STEP = "training step"
LABELER = "labeler"
LABELER_GRADIENT = "labeler gradient"
LIBRARY = "library"

# What may be asked of a denoiser: logarithms of cm (the length is the arc of what it is shown), T_f, and whether hair
# is as it hangs (1) or as it would be without weight (0).
CONDITION_NAMES = ("log radius", "log wavelength", "twist", "log length", "hung")
FILES = {
    DENOISER: "denoiser.onnx",
    TRAINING_STEP: "training_step.onnx",
    LABELER: "labeler.onnx",
    LABELER_GRADIENT: "labeler_gradient.onnx",
    LIBRARY: "library.npz",
}
_FIELDS = ("format", "version", "kind", "sha256", "training")
_NETWORK_FIELDS = ("architecture", "parameters", "cells", "opset")
_OWN_FIELDS: dict[str, tuple[str, ...]] = {
    DENOISER: (*_NETWORK_FIELDS, "whitening", "schedule", "conditions", "weights"),
    TRAINING_STEP: (*_NETWORK_FIELDS, "whitening", "schedule", "batch"),
    LABELER: (*_NETWORK_FIELDS, "batch"),
    LABELER_GRADIENT: (*_NETWORK_FIELDS, "batch"),
    LIBRARY: (),
}


@dataclass(frozen=True)
class ExportedModel:
    """A verified model: its bytes, and what its manifest says.

    parameters: how many weights. cells: of the signals that it was trained on. batch: samples that it takes at once, 0
    where these are as many as one likes. training: how the model came about, as its exporter tells it.
    """

    path: Path
    kind: str
    data: bytes
    architecture: dict[str, Any]
    parameters: int
    cells: int
    batch: int
    training: dict[str, Any]

    def session(self, threads: int = 1) -> onnxruntime.InferenceSession:
        """A session on so many threads."""
        return self._session(self.data, threads)

    def _session(self, data: bytes, threads: int) -> onnxruntime.InferenceSession:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.log_severity_level = 3
        try:
            return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        except Exception as error:
            # onnxruntime's errors have no class of their own in common.
            raise ModelError(f"{self.path}: onnxruntime {onnxruntime.__version__} cannot run it: {error}") from error


@dataclass(frozen=True)
class Model(ExportedModel):
    """A denoiser, or a step of its training.

    weights_at: where in the bytes the float16 weights start, -1 where there are none.
    """

    whitening: Whitening
    schedule: CosineSchedule
    weights_at: int

    @property
    def weights(self) -> NDArray[np.float16]:
        """The weights in the file, (parameters,)."""
        return np.frombuffer(self.data, "<f2", self.parameters, self.weights_at)

    def session(self, threads: int = 1, weights: NDArray[np.float16] | None = None) -> onnxruntime.InferenceSession:
        """A session on so many threads, with other weights (parameters,) where they are given.

        They are put in place of the file's own, since onnxruntime folds those of a file into its plan before it
        looks at any that it is handed.
        """
        data = self.data
        if weights is not None:
            if weights.dtype != np.float16 or weights.shape != (self.parameters,):
                raise ModelError(f"{self.path}: {weights.shape} {weights.dtype} weights, not {self.parameters} float16")
            end = self.weights_at + 2 * self.parameters
            data = data[: self.weights_at] + weights.astype("<f2").tobytes() + data[end:]
        return self._session(data, threads)


def models_folder() -> Path:
    """Where models are looked for."""
    named = os.environ.get(FOLDER_VARIABLE)
    return Path(named) if named else Path(str(resources.files("detangled_models")))


def load_model(kind: str, folder: Path | None = None) -> Model:
    """Read and verify a model, DENOISER or TRAINING_STEP. Raises ModelError where it is missing, damaged or other."""
    manifest, path, data = verified(kind, folder)
    with blaming(path):
        model = Model(
            **_common(manifest, path, kind, data, kind == TRAINING_STEP),
            whitening=Whitening(**{name: tuple(value) for name, value in manifest["whitening"].items()}),
            schedule=CosineSchedule(**manifest["schedule"]),
            weights_at=int(manifest["weights"]["offset"]) if kind == DENOISER else -1,
        )
        if kind == DENOISER and tuple(manifest["conditions"]) != CONDITION_NAMES:
            raise ValueError(f"a denoiser of other conditions: {manifest['conditions']}")
        if kind == DENOISER and not 0 <= model.weights_at <= len(data) - 2 * model.parameters:
            raise ValueError("weights that are not in the file")
    return model


def load_labeler(kind: str = LABELER, folder: Path | None = None) -> ExportedModel:
    """Read and verify LABELER or LABELER_GRADIENT. Raises ModelError where it is missing, damaged or other."""
    manifest, path, data = verified(kind, folder)
    with blaming(path):
        return ExportedModel(**_common(manifest, path, kind, data, True))


def verified(kind: str, folder: Path | None) -> tuple[dict[str, Any], Path, bytes]:
    """A model's manifest, its path, and its bytes, which are those that the manifest was written for.

    Raises ModelError where it is missing, damaged or other.
    """
    path = (folder or models_folder()) / FILES[kind]
    manifest = _manifest(path.with_suffix(".json"), kind)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror}): {_remedy(path)}") from error
    if hashlib.sha256(data).hexdigest() != manifest["sha256"]:
        raise ModelError(f"{path}: its bytes are not those its manifest was written for: {_remedy(path)}")
    return manifest, path, data


def _common(manifest: dict[str, Any], path: Path, kind: str, data: bytes, batched: bool) -> dict[str, Any]:
    """What every model has. Raises ValueError and the like where the manifest is damaged."""
    parameters, cells = int(manifest["parameters"]), int(manifest["cells"])
    batch = int(manifest["batch"]) if batched else 0
    if min(parameters, cells) < 1:
        raise ValueError("a network without weights or cells")
    if batched and batch < 1:
        raise ValueError("a batch without samples")
    return {
        "path": path,
        "kind": kind,
        "data": data,
        "architecture": dict(manifest["architecture"]),
        "parameters": parameters,
        "cells": cells,
        "batch": batch,
        "training": dict(manifest["training"]),
    }


@contextmanager
def blaming(path: Path) -> Iterator[None]:
    """Whatever is wrong with a manifest's values, said in one way."""
    try:
        yield
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, DetangledError) as error:
        raise ModelError(f"{path.with_suffix('.json')}: damaged ({error}): {_remedy(path)}") from error


def _remedy(path: Path) -> str:
    """What to do about a model or manifest that cannot be used."""
    if path.stem == Path(FILES[LIBRARY]).stem:
        return "install detangled again, or make the library anew (detangled train library)"
    return "install detangled again, or export the model anew (detangled train export)"


def _manifest(path: Path, kind: str) -> dict[str, Any]:
    """A manifest with all its fields."""
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror}): {_remedy(path)}") from error
    except ValueError as error:
        raise ModelError(f"{path}: not a model's manifest, or damaged: {_remedy(path)}") from error
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise ModelError(f"{path}: not a model's manifest: {_remedy(path)}")
    if manifest.get("version") != VERSION:
        raise ModelError(
            f"{path}: a model of version {manifest.get('version')}; this detangled reads version {VERSION}: "
            f"{_remedy(path)}"
        )
    if manifest.get("kind", kind) != kind:
        raise ModelError(f"{path}: a {manifest['kind']}, not a {kind}: {_remedy(path)}")
    missing = [name for name in (*_FIELDS, *_OWN_FIELDS[kind]) if name not in manifest]
    if missing:
        raise ModelError(f"{path}: the manifest lacks {', '.join(missing)}: {_remedy(path)}")
    return manifest


def same_network(one: Model, other: Model) -> bool:
    """Whether two models are of one network, in data that are whitened alike."""
    names = ("architecture", "parameters", "whitening", "schedule", "cells")
    return all(getattr(one, name) == getattr(other, name) for name in names)
