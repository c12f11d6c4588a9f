"""The U-Net, its two kinds of layers, and both exported graphs: all against torch, on a tiny architecture."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")

from detangled.diffusion.schedule import CosineSchedule  # noqa: E402
from detangled.diffusion.whitening import Whitening  # noqa: E402
from detangled.errors import ModelError  # noqa: E402
from detangled_training import onnx_export, onnx_translation  # noqa: E402
from detangled_training.checkpoint import Checkpoint, read_checkpoint, write_checkpoint  # noqa: E402
from detangled_training.layers import MATRICES  # noqa: E402
from detangled_training.onnx_export import STEP_INPUTS, export, random_inputs, random_step  # noqa: E402
from detangled_training.parameters import (  # noqa: E402
    Optimizer,
    flatten,
    layout,
    restore,
    torch_optimizer,
    torch_step,
)
from detangled_training.unet import Architecture, UNet  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")

TINY = Architecture(channels=(8, 16), attention=1, embedding=16, groups=4, heads=2)
WHITENING = Whitening((0.7, 0.4), (0.1, 0.2, -0.3), (1.1, 1.2, 0.9))
SCHEDULE = CosineSchedule()
OPTIMIZER = Optimizer(weight_decay=0.02)
CELLS = 32
BATCH = 4
TRAINING = {"commit": "abc", "seeds": [1, 2], "data": "random", "steps": 0, "scores": {"radius": 0.03}}


def tiny_network(seed: int = 0) -> UNet:
    """A network none of whose parameters is zero, as a trained one."""
    torch.manual_seed(seed)
    network = UNet(TINY)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.2 * torch.randn_like(parameter)
    return network


def checkpoint(network: UNet) -> Checkpoint:
    return Checkpoint(network.sizes, flatten(network), WHITENING, SCHEDULE, CELLS, TRAINING)


def tensors(arrays: dict[str, Any]) -> list[Any]:
    return [torch.from_numpy(array) for array in arrays.values()]


def denoised(network: UNet, given: dict[str, Any]) -> Any:
    with torch.no_grad():
        return network(*tensors(given)).numpy()


def session(model: Path | bytes) -> Any:
    return onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("models")
    export(checkpoint(tiny_network()), folder, BATCH, OPTIMIZER)
    return folder


@pytest.fixture(scope="module")
def rounded() -> UNet:
    """The network that is shipped: its weights are those of float16."""
    network = tiny_network()
    restore(network, flatten(network).half().float())
    return network


# ---- the network


def test_the_paper_sized_network_has_its_parameters_and_shapes() -> None:
    network = UNet()
    assert 5.6e6 < sum(parameter.numel() for parameter in network.parameters()) < 5.8e6
    assert network.sizes.multiple == 16
    assert denoised(network, random_inputs(2, 48)).shape == (2, 3, 48)


def test_an_untrained_network_predicts_the_mean_signal() -> None:
    assert not denoised(UNet(TINY), random_inputs(2, 16)).any()


@pytest.mark.parametrize(
    "sizes",
    [
        {"channels": ()},
        {"channels": (8, 0)},
        {"attention": 4},
        {"groups": 7},
        {"heads": 3},
        {"embedding": 5},
    ],
)
def test_sizes_that_do_not_fit_are_refused(sizes: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"sizes|attention|multiples|even"):
        Architecture(**sizes)


def test_matrix_products_say_what_convolutions_say_and_so_do_their_gradients() -> None:
    network, products = tiny_network(), UNet(TINY, MATRICES)
    with torch.no_grad():
        for name, parameter in network.named_parameters():
            products.get_parameter(name).copy_(parameter.permute(*reversed(range(parameter.dim()))))
    given = tensors(random_inputs(3, CELLS))
    wanted, found = network(*given), products(*given)
    torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-5)
    with torch.no_grad():
        torch.testing.assert_close(products(*given), wanted, rtol=1e-5, atol=1e-5)

    direction = torch.randn_like(wanted)
    (wanted * direction).sum().backward()
    (found * direction).sum().backward()
    for name, parameter in network.named_parameters():
        gradient = products.get_parameter(name).grad
        assert parameter.grad is not None
        assert gradient is not None
        back = gradient.permute(*reversed(range(gradient.dim())))
        torch.testing.assert_close(back, parameter.grad, rtol=1e-3, atol=1e-4, msg=name)


def test_a_condition_that_is_not_known_is_ignored_and_one_that_is_is_not() -> None:
    network = tiny_network()
    given = random_inputs(2, 16)
    other = given | {"condition": given["condition"] + 1.0}
    nothing, all_known = np.zeros_like(given["known"]), np.ones_like(given["known"])
    np.testing.assert_array_equal(
        denoised(network, given | {"known": nothing}), denoised(network, other | {"known": nothing})
    )
    changed = denoised(network, other | {"known": all_known}) - denoised(network, given | {"known": all_known})
    assert np.abs(changed).max() > 1e-3


@pytest.mark.parametrize("name", ["noisy", "log_snr", "position", "known"])
def test_every_input_counts(name: str) -> None:
    network = tiny_network()
    given = random_inputs(2, 16)
    changed = given | {name: 0.5 - 0.5 * given[name]}
    assert np.abs(denoised(network, changed) - denoised(network, given)).max() > 1e-3


def test_the_vector_holds_every_parameter_once_and_gives_it_back(tmp_path: Path) -> None:
    network = tiny_network()
    slots = layout(network)
    assert [slot.offset for slot in slots] == list(np.cumsum([0] + [slot.size for slot in slots[:-1]]))
    assert {slot.name for slot in slots} == {name for name, _ in network.named_parameters()}
    write_checkpoint(checkpoint(network), tmp_path / "checkpoint.pt")
    stored = read_checkpoint(tmp_path / "checkpoint.pt")
    assert (stored.architecture, stored.whitening, stored.schedule) == (TINY, WHITENING, SCHEDULE)
    assert (stored.cells, stored.training, stored.state) == (CELLS, TRAINING, None)
    again = stored.network()
    for name, parameter in network.named_parameters():
        assert torch.equal(again.get_parameter(name), parameter), name


# ---- the exported denoiser


@pytest.mark.parametrize(("batch", "cells"), [(1, 4), (1, 32), (3, 16), (5, 60), (2, 128)])
def test_the_exported_denoiser_equals_torch(exported: Path, rounded: UNet, batch: int, cells: int) -> None:
    denoiser = session(exported / "denoiser.onnx")
    for seed in range(3):
        given = random_inputs(batch, cells, seed)
        (found,) = denoiser.run(None, given)
        np.testing.assert_allclose(found, denoised(rounded, given), rtol=0, atol=1e-5)


def test_other_weights_are_put_in_by_their_place_in_the_file(exported: Path) -> None:
    manifest = json.loads((exported / "denoiser.json").read_text(encoding="utf-8"))
    count, offset = manifest["parameters"], manifest["weights"]["offset"]
    data = (exported / "denoiser.onnx").read_bytes()
    own = np.frombuffer(data, "<f2", count, offset)
    np.testing.assert_array_equal(own, flatten(tiny_network()).half().numpy())

    other = tiny_network(seed=1)
    restore(other, flatten(other).half().float())
    put = flatten(other).numpy().astype("<f2").tobytes()
    given = random_inputs(2, 16)
    (found,) = session(data[:offset] + put + data[offset + len(put) :]).run(None, given)
    np.testing.assert_allclose(found, denoised(other, given), rtol=0, atol=1e-5)


# ---- the exported training step


def test_ten_exported_steps_equal_ten_of_torch(exported: Path, rounded: UNet) -> None:
    step = session(exported / "training_step.onnx")
    network = UNet(TINY)
    restore(network, flatten(rounded))
    rate = 4e-4
    own = torch_optimizer(network, OPTIMIZER, rate)
    given = random_step(network, BATCH, CELLS)
    for k in range(10):
        samples = random_step(network, BATCH, CELLS, seed=k)
        given.update((name, samples[name]) for name in STEP_INPUTS[5:])
        given.update(step=np.array(k + 1, np.float32), learning_rate=np.array(rate, np.float32))
        loss = torch_step(network, own, OPTIMIZER.clip, *(torch.from_numpy(given[name]) for name in STEP_INPUTS[5:]))
        *new, found = step.run(None, given)
        given.update(zip(STEP_INPUTS[:3], new, strict=True))
        assert float(found) == pytest.approx(loss, abs=1e-5)
        np.testing.assert_allclose(given["weights"], flatten(network).numpy(), rtol=0, atol=1e-4)


def test_exported_steps_fit_what_they_are_shown(exported: Path) -> None:
    step = session(exported / "training_step.onnx")
    given = random_step(UNet(TINY), BATCH, CELLS)
    given["learning_rate"] = np.array(1e-2, np.float32)
    losses = []
    for k in range(60):
        given["step"] = np.array(k + 1, np.float32)
        *new, loss = step.run(None, given)
        given.update(zip(STEP_INPUTS[:3], new, strict=True))
        losses.append(float(loss))
    assert losses[-1] < 0.5 * losses[0]


# ---- what lies beside them


def test_manifests_say_what_a_runtime_needs(exported: Path) -> None:
    network = tiny_network()
    for name, kind in (("denoiser", "denoiser"), ("training_step", "training step")):
        manifest = json.loads((exported / f"{name}.json").read_text(encoding="utf-8"))
        assert (manifest["format"], manifest["version"], manifest["kind"]) == ("detangled model", 1, kind)
        assert manifest["sha256"] == hashlib.sha256((exported / f"{name}.onnx").read_bytes()).hexdigest()
        assert manifest["parameters"] == sum(parameter.numel() for parameter in network.parameters())
        sizes = manifest["architecture"]
        assert Architecture(**{**sizes, "channels": tuple(sizes["channels"])}) == TINY
        assert Whitening(**{key: tuple(values) for key, values in manifest["whitening"].items()}) == WHITENING
        assert CosineSchedule(**manifest["schedule"]) == SCHEDULE
        assert (manifest["cells"], manifest["opset"], manifest["training"]) == (CELLS, onnx_export.OPSET, TRAINING)
    optimizer = dict(manifest["optimizer"])
    assert optimizer.pop("name") == "AdamW"
    assert Optimizer(**optimizer) == OPTIMIZER
    assert manifest["batch"] == BATCH
    assert {path.suffix for path in exported.iterdir()} == {".onnx", ".json"}


def test_the_training_step_carries_no_weights(exported: Path) -> None:
    given = {value.name: value.shape for value in session(exported / "training_step.onnx").get_inputs()}
    assert given["weights"] == [sum(parameter.numel() for parameter in tiny_network().parameters())]
    assert given["noisy"] == [BATCH, 3, CELLS]


def test_the_same_network_gives_the_same_bytes(exported: Path, rounded: UNet) -> None:
    assert onnx_export.denoiser_graph(rounded, CELLS) == (exported / "denoiser.onnx").read_bytes()


def test_an_export_that_is_off_is_refused_by_its_difference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(onnx_translation.PLAIN, "sin", "Cos")
    with pytest.raises(ModelError, match=r"clean by onnxruntime and by torch differ by \d"):
        export(checkpoint(tiny_network()), tmp_path, BATCH)
    assert not list(tmp_path.iterdir())


def test_weights_too_large_for_float16_are_refused(tmp_path: Path) -> None:
    network = tiny_network()
    with torch.no_grad():
        network.head.bias.fill_(1e6)
    with pytest.raises(ModelError, match="float16"):
        export(checkpoint(network), tmp_path)
