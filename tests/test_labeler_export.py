"""The labelers' exported graphs: against torch, and what is written beside them."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")


from detangled.errors import ModelError, WriteError  # noqa: E402
from detangled.labeling import CELLS  # noqa: E402
from detangled.models import LABELER, LABELER_GRADIENT, load_labeler  # noqa: E402
from detangled_training import labeler_export, onnx_files  # noqa: E402
from detangled_training.labeler import (  # noqa: E402
    Labeler,
    LabelerSizes,
)
from detangled_training.labeler_export import (  # noqa: E402
    export_labelers,
    gradient_graph,
    labeler_graph,
    labelers,
    random_signals,
    stacked,
    with_gradient,
    with_world,
)
from detangled_training.onnx_files import write_model  # noqa: E402
from tiny_labeler_network import TINY, tiny_labeler  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")

BATCH = 4
# Of a signal's largest: torch's own gradients of float32 and of float64 are as far apart, for weights that are taken
# anew three times.
GRADIENT = 1e-3
REPORT = {"commit": "abc", "scores": {"all": {"radius_median": 0.03}}}


def session(model: Path | bytes) -> Any:
    return onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a finished training leaves, as far as an export reads it."""
    path: Path = tmp_path_factory.mktemp("labelers") / "labelers.pt"
    sizes = {name: getattr(TINY, name) for name in TINY.__dataclass_fields__}
    torch.save(
        {
            "options": {"sizes": sizes},
            "network": tiny_labeler().state_dict(),
            "optimizer": None,
            "stage": 4,
            "step": 0,
            "seconds": 1.0,
            "history": [],
            "report": REPORT,
        },
        path,
    )
    return path


@pytest.fixture(scope="module")
def exported(checkpoint: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("models")
    export_labelers(checkpoint, folder, BATCH)
    return folder


@pytest.fixture(scope="module")
def rounded(checkpoint: Path) -> Labeler:
    """The network that is shipped: its weights are those of float16."""
    return labelers(torch.load(checkpoint, weights_only=True))


def relative(values: NDArray[Any], wanted: NDArray[Any]) -> float:
    """The largest difference beside each signal's own size."""
    size = np.abs(wanted).reshape(len(wanted), -1).max(axis=1)
    return float((np.abs(values - wanted).reshape(len(wanted), -1).max(axis=1) / size).max())


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_exported_labels_and_gradients_equal_torch(exported: Path, rounded: Labeler, seed: int) -> None:
    in_world = with_world(BATCH, seed)
    with torch.no_grad():
        wanted = stacked(rounded, torch.from_numpy(in_world))
    (labels,) = session(exported / "labeler.onnx").run(None, {"signals": in_world})
    np.testing.assert_allclose(labels, wanted.numpy(), rtol=1e-5, atol=1e-6)

    values = random_signals(BATCH, seed)
    weights = np.random.default_rng(seed).standard_normal((BATCH, 3)).astype(np.float32)
    wanted, gradient = with_gradient(rounded, torch.from_numpy(values), torch.from_numpy(weights))
    labels, found = session(exported / "labeler_gradient.onnx").run(None, {"signals": values, "weights": weights})
    np.testing.assert_allclose(labels, wanted.numpy(), rtol=1e-5, atol=1e-6)
    assert found.shape == values.shape
    assert relative(found, gradient.numpy()) < GRADIENT


def test_an_exported_gradient_says_how_the_exported_labels_change(exported: Path) -> None:
    """Differences of float32: along its own direction, where the sum changes most, and each signal by itself."""
    model = session(exported / "labeler_gradient.onnx")
    values = random_signals(BATCH, 22)
    labels, _ = model.run(None, {"signals": values, "weights": np.ones((BATCH, 3), np.float32)})
    weights = (1.0 / np.maximum(np.abs(labels), 1e-3)).astype(np.float32)
    _, gradient = model.run(None, {"signals": values, "weights": weights})
    gradient = gradient.astype(np.float64)
    slope = (gradient**2).sum(axis=(1, 2))

    def change(step: float) -> NDArray[np.float64]:
        """The central difference of each weighted sum over a step that should change it by so much."""
        sums = []
        for way in (0.5, -0.5):
            moved = values + (way * step * gradient / slope[:, None, None])
            (told, _) = model.run(None, {"signals": moved.astype(np.float32), "weights": weights})
            sums.append((told.astype(np.float64) * weights).sum(axis=1))
        return np.asarray(sums[0] - sums[1]) / step

    # Below, float32 rounds the sums; above, what was left out as disturbed begins to change.
    np.testing.assert_allclose(change(0.002), 1.0, rtol=2e-3)


# ---- what is written


def test_the_same_network_gives_the_same_bytes(exported: Path, rounded: Labeler) -> None:
    assert labeler_graph(rounded, BATCH) == (exported / "labeler.onnx").read_bytes()
    assert gradient_graph(rounded, BATCH) == (exported / "labeler_gradient.onnx").read_bytes()


def test_what_is_exported_has_weights_of_float16_and_the_training_goes_on_with_its_own(
    checkpoint: Path, rounded: Labeler
) -> None:
    for name, parameter in rounded.named_parameters():
        torch.testing.assert_close(parameter, tiny_labeler().get_parameter(name).half().float(), rtol=0, atol=0)
    stored = torch.load(checkpoint, weights_only=True)
    assert any(not torch.equal(x, x.half().float()) for x in stored["network"].values())
    assert not rounded.training
    assert not rounded.twist.lstm.traceable


def test_manifests_say_what_a_runtime_needs(exported: Path) -> None:
    parameters = sum(parameter.numel() for parameter in tiny_labeler().parameters())
    for name, kind in (("labeler", LABELER), ("labeler_gradient", LABELER_GRADIENT)):
        manifest = json.loads((exported / f"{name}.json").read_text(encoding="utf-8"))
        assert (manifest["format"], manifest["version"], manifest["kind"]) == ("detangled model", 1, kind)
        assert manifest["sha256"] == hashlib.sha256((exported / f"{name}.onnx").read_bytes()).hexdigest()
        assert (manifest["parameters"], manifest["cells"], manifest["batch"]) == (parameters, CELLS, BATCH)
        assert LabelerSizes(**manifest["architecture"]) == TINY
        assert (manifest["opset"], manifest["training"]) == (onnx_files.OPSET, REPORT)
        model = load_labeler(kind, exported)
        assert (model.kind, model.batch, model.cells, model.parameters) == (kind, BATCH, CELLS, parameters)
        assert model.training == REPORT
        assert model.data == (exported / f"{name}.onnx").read_bytes()
    names = ["labeler.json", "labeler.onnx", "labeler_gradient.json", "labeler_gradient.onnx"]
    assert sorted(path.name for path in exported.iterdir()) == names


@pytest.mark.parametrize("kind", [LABELER, LABELER_GRADIENT])
def test_a_flipped_bit_is_found(exported: Path, tmp_path: Path, kind: str) -> None:
    for path in exported.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    path = load_labeler(kind, tmp_path).path
    data = path.read_bytes()
    for at in (0, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        with pytest.raises(ModelError, match="its bytes are not those"):
            load_labeler(kind, tmp_path)


def test_one_kind_is_not_taken_for_the_other(exported: Path, tmp_path: Path) -> None:
    for suffix in (".onnx", ".json"):
        (tmp_path / f"labeler{suffix}").write_bytes((exported / f"labeler_gradient{suffix}").read_bytes())
    with pytest.raises(ModelError, match="a labeler gradient, not a labeler"):
        load_labeler(LABELER, tmp_path)


def test_an_export_that_is_off_is_refused_by_its_difference(
    checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = labeler_export.labeler_graph

    def off(network: Labeler, batch: int) -> bytes:
        """The graph of a network that is another by a little."""
        torch.manual_seed(0)
        other = Labeler(network.sizes).eval().requires_grad_(False)
        other.load_state_dict({name: x * (1.0 + 1e-3) for name, x in network.state_dict().items()})
        return whole(other, batch)

    monkeypatch.setattr(labeler_export, "labeler_graph", off)
    with pytest.raises(ModelError, match=r"labels by onnxruntime and by torch differ by \d"):
        export_labelers(checkpoint, tmp_path, BATCH)
    assert not list(tmp_path.iterdir())


def test_a_gradient_that_is_off_is_refused(checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def flipped(network: Labeler, x: Any, weights: Any) -> tuple[Any, Any]:
        labels, gradient = with_gradient(network, x, weights)
        return labels, -gradient

    whole = labeler_export.gradient_graph

    def off(network: Labeler, batch: int) -> bytes:
        with monkeypatch.context() as patch:
            patch.setattr(labeler_export, "with_gradient", flipped)
            return whole(network, batch)

    monkeypatch.setattr(labeler_export, "gradient_graph", off)
    with pytest.raises(ModelError, match=r"gradient by onnxruntime and by torch differ by \d"):
        export_labelers(checkpoint, tmp_path, BATCH)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["labeler.json", "labeler.onnx"]


@pytest.mark.parametrize(("error", "raised"), [(ModelError("off"), ModelError), (OSError(28, "full"), WriteError)])
def test_a_model_that_fails_its_check_is_not_written_and_the_old_one_stays(
    tmp_path: Path, error: Exception, raised: type[Exception]
) -> None:
    def refuse(path: Path) -> float:
        assert path.read_bytes() == b"new"
        raise error

    with pytest.raises(raised):
        write_model(tmp_path / "model.onnx", b"new", {"kind": "any"}, refuse)
    assert not list(tmp_path.iterdir())
    old = write_model(tmp_path / "model.onnx", b"old", {"kind": "any"}, lambda path: 0.5)
    assert (old.difference, old.manifest) == (0.5, tmp_path / "model.json")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert sorted(before) == ["model.json", "model.onnx"]
    with pytest.raises(raised):
        write_model(tmp_path / "model.onnx", b"new", {"kind": "any"}, refuse)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("change", ["sizes", "weights", "no options"])
def test_a_checkpoint_of_another_network_is_one_line(checkpoint: Path, tmp_path: Path, change: str) -> None:
    stored = torch.load(checkpoint, weights_only=True)
    if change == "sizes":
        stored["options"]["sizes"]["lstm_width"] = 5
    elif change == "weights":
        stored["network"].popitem()
    else:
        del stored["options"]
    path = tmp_path / "labelers.pt"
    torch.save(stored, path)
    with pytest.raises(ModelError, match=r"another version, or damaged|it lacks options"):
        export_labelers(path, tmp_path / "models", BATCH)
    assert not list((tmp_path / "models").iterdir())
