"""Training of the labelers from data sets on disk, at a tiny setting: to its end, and stopped and gone on with."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from detangled.errors import ModelError, ReadError, WriteError  # noqa: E402
from detangled.texture import HAIR_TYPES, TWISTS_PER_CM  # noqa: E402
from detangled_training.dataset import TEST, TRAIN, VALIDATION, read_dataset, write_dataset  # noqa: E402
from detangled_training.labeler import Labeler, LabelerSizes  # noqa: E402
from detangled_training.labeler_training import (  # noqa: E402
    CHECKPOINT,
    STAGES,
    Examples,
    LabelerOptions,
    LabelerTraining,
    logarithms,
    read_labelers,
    score,
    told,
)
from detangled_training.strands import UNTYPED  # noqa: E402
from detangled_training.variants import VariantOptions  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")

TINY = LabelerSizes(lstm_width=4, encoder_width=8, layers=1, heads=2, feed_forward=8)
OPTIONS = LabelerOptions(steps=(4, 4, 2, 2), batch=8, warm_up=2, evaluate_every=2, save_every=1, sizes=TINY)
STEPS = sum(OPTIONS.steps)
STRANDS = 60  # three for tests, three for validation

Folders = tuple[Path, Path]


class StoppedError(Exception):
    """What a test stops a training by."""


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> Folders:
    """Data sets of strands as constructed and of hung ones."""
    folder: Path = tmp_path_factory.mktemp("data")
    for hung in (0, 1):
        write_dataset(folder / str(hung), STRANDS, hung, VariantOptions(hung=hung), workers=1)
    return folder / "0", folder / "1"


def training(folder: Path, data: Folders, options: LabelerOptions = OPTIONS, **more: Any) -> LabelerTraining:
    return LabelerTraining(options, folder, *data, **more)


@pytest.fixture(scope="module")
def whole(data: Folders, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a training that went to its end in one go."""
    folder: Path = tmp_path_factory.mktemp("whole")
    told_of: list[tuple[int, float]] = []
    training(folder, data).run(lambda step, loss: told_of.append((step, loss)))
    assert [step for step, _ in told_of] == list(range(1, STEPS + 1))
    assert all(math.isfinite(loss) and loss >= 0.0 for _, loss in told_of)
    return folder


def weights_of(folder: Path) -> dict[str, Any]:
    network: dict[str, Any] = read_labelers(folder / CHECKPOINT)["network"]
    return network


def assert_same(one: dict[str, Any], other: dict[str, Any]) -> None:
    assert list(one) == list(other)
    for name in one:
        assert torch.equal(one[name], other[name]), name


# ---- to the end


def test_a_training_ends_with_a_checkpoint_of_finite_weights(whole: Path, data: Folders) -> None:
    assert CHECKPOINT in {path.name for path in whole.iterdir()}
    assert not [path for path in whole.iterdir() if path.name.startswith(".")]
    stored = read_labelers(whole / CHECKPOINT)
    assert (stored["stage"], stored["step"]) == (len(STAGES), 0)
    assert stored["optimizer"] is None
    assert stored["seconds"] > 0.0
    assert all(torch.isfinite(x).all() for x in stored["network"].values())
    began = LabelerTraining(OPTIONS, whole.parent / "other", *data).network.state_dict()
    assert all(not torch.equal(x, began[name]) for name, x in stored["network"].items() if "weight" in name)


def test_the_history_has_every_evaluation(whole: Path) -> None:
    history = read_labelers(whole / CHECKPOINT)["history"]
    assert [(stage, step) for stage, step, _, _ in history] == [(0, 2), (0, 4), (1, 2), (1, 4), (2, 2), (3, 2)]
    assert all(math.isfinite(x) and x >= 0.0 for _, _, loss, error in history for x in (loss, error))


def test_each_stage_trains_its_own_network(data: Folders, tmp_path: Path) -> None:
    run = training(tmp_path, data)
    before = {name: x.clone() for name, x in run.network.state_dict().items()}
    changed: list[set[str]] = []

    def look(step: int, loss: float) -> None:
        after = {name: x.clone() for name, x in run.network.state_dict().items()}
        changed.append({name.split(".")[0] for name in after if not torch.equal(after[name], before[name])})
        before.update(after)

    run.run(look)
    # The last step of a stage has next to no learning rate; all others move weights.
    wanted = [STAGES[stage][0] for stage, steps in enumerate(OPTIONS.steps) for _ in range(steps)]
    assert changed == [{name} for name in wanted]


def test_a_finished_training_has_nothing_left_to_do(whole: Path, data: Folders, tmp_path: Path) -> None:
    (tmp_path / CHECKPOINT).write_bytes((whole / CHECKPOINT).read_bytes())
    said: list[str] = []
    again = training(tmp_path, data, note=said.append)
    assert again.steps_done == STEPS
    assert any(f"step {STEPS}" in line for line in said)
    again.run(lambda step, loss: pytest.fail("a step too many"))
    assert_same(dict(again.network.state_dict()), weights_of(whole))


def test_training_lowers_the_loss(data: Folders, tmp_path: Path) -> None:
    """On forty steps of either network the error on what was held out falls, or the loss does."""
    options = replace(
        OPTIONS, steps=(40, 40, 0, 0), batch=16, evaluate_every=20, save_every=1000,
        learning_rates={"twist": 5e-3, "helix": 5e-3},
    )  # fmt: skip
    losses: list[float] = []
    training(tmp_path, data, options).run(lambda step, loss: losses.append(loss))
    assert len(losses) == 80
    assert np.mean(losses[30:40]) < 0.9 * np.mean(losses[:5])


# ---- gone on with


@pytest.mark.parametrize("after", [1, 3, 4, 5, 9, 10, 11])
def test_a_stopped_training_gone_on_with_ends_in_the_same_weights(
    after: int, whole: Path, data: Folders, tmp_path: Path
) -> None:
    def stop(step: int, loss: float) -> None:
        if step == after:
            raise StoppedError

    with pytest.raises(StoppedError):
        training(tmp_path, data).run(stop)
    again = training(tmp_path, data)
    assert again.steps_done == after
    steps: list[int] = []
    again.run(lambda step, loss: steps.append(step))
    assert steps == list(range(after + 1, STEPS + 1))
    assert_same(weights_of(tmp_path), weights_of(whole))
    wanted = read_labelers(whole / CHECKPOINT)["history"]
    found = read_labelers(tmp_path / CHECKPOINT)["history"]
    # Losses are means since the last evaluation or the start of this run; all else is as it was.
    assert [(a, b, d) for a, b, _, d in found] == [(a, b, d) for a, b, _, d in wanted]


def test_a_training_stopped_between_checkpoints_goes_on_from_the_last(
    whole: Path, data: Folders, tmp_path: Path
) -> None:
    options = replace(OPTIONS, save_every=3)

    def stop(step: int, loss: float) -> None:
        if step == 6:
            raise StoppedError

    with pytest.raises(StoppedError):
        training(tmp_path, data, options).run(stop)
    again = training(tmp_path, data, options)
    # Saved at the third step of the first stage and at its end, but not at the second step of the second stage.
    assert again.steps_done == 4
    again.run()
    # Stages are shorter than that many steps, or not a multiple: the end is saved all the same.
    assert read_labelers(tmp_path / CHECKPOINT)["stage"] == len(STAGES)
    assert_same(weights_of(tmp_path), weights_of(whole))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"seed": 1}, "another seed"),
        ({"batch": 4}, "another batch"),
        ({"steps": (4, 4, 2, 3)}, "another steps"),
        ({"learning_rates": {"twist": 1e-3, "helix": 1e-3}}, "another learning rates"),
        ({"sizes": replace(TINY, lstm_width=5), "weight_decay": 0.1}, "another weight decay, sizes"),
    ],
)
def test_other_options_than_it_was_begun_with_are_refused(
    change: dict[str, Any], said: str, whole: Path, data: Folders
) -> None:
    before = (whole / CHECKPOINT).read_bytes()
    with pytest.raises(ModelError, match=f"{said}.*another folder"):
        training(whole, data, replace(OPTIONS, **change))
    assert (whole / CHECKPOINT).read_bytes() == before


@pytest.mark.parametrize("how", ["empty", "cut", "text", "another thing", "a list"])
def test_a_damaged_checkpoint_is_refused(how: str, whole: Path, data: Folders, tmp_path: Path) -> None:
    path = tmp_path / CHECKPOINT
    bytes_ = (whole / CHECKPOINT).read_bytes()
    if how in ("another thing", "a list"):
        torch.save({"weights": torch.ones(3)} if how == "another thing" else [1], path)
    else:
        path.write_bytes({"empty": b"", "cut": bytes_[: len(bytes_) // 2], "text": b"no checkpoint"}[how])
    before = path.read_bytes()
    with pytest.raises(ModelError, match=r"labelers\.pt: not a checkpoint") as refused:
        training(tmp_path, data)
    assert "\n" not in str(refused.value)
    assert path.read_bytes() == before


def test_a_checkpoint_that_lacks_something_is_refused(whole: Path, data: Folders, tmp_path: Path) -> None:
    stored = read_labelers(whole / CHECKPOINT)
    for name in ("options", "network", "history", "report"):
        torch.save({key: value for key, value in stored.items() if key != name}, tmp_path / CHECKPOINT)
        with pytest.raises(ModelError):
            training(tmp_path, data)


def test_a_folder_that_cannot_be_one_is_said_before_the_work(data: Folders, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match="cannot be made a folder"):
        training(tmp_path / "file", data)


def test_data_that_are_not_there_are_said(data: Folders, tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="holds no data set"):
        training(tmp_path / "out", (tmp_path / "nowhere", data[1])).run()


# ---- examples and scores


def test_examples_are_the_data_sets_with_the_twists_that_strands_have(data: Folders) -> None:
    for folder in data:
        parts = [Examples.of(read_dataset(folder, split)) for split in (TRAIN, VALIDATION, TEST)]
        assert all(len(part) > 0 for part in parts)
        stored = read_dataset(folder, TRAIN)
        examples = parts[0]
        np.testing.assert_array_equal(examples.signals[:, :, :3], stored.signals)
        np.testing.assert_array_equal(examples.signals[:, :, 3:], stored.labels["world"])
        np.testing.assert_allclose(examples.radius, stored.labels["radius"], rtol=1e-6)
        assert ((examples.twist >= 0.0) & (examples.twist <= 1.0)).all()
        # Half a twist over the strand is all that rounding to whole ones leaves.
        off = np.abs(examples.twist - stored.labels["twist"]) * TWISTS_PER_CM * stored.labels["length"]
        assert off.max() < 0.51
        x, radius, wavelength, twist = examples.batch(np.array([2, 0, 2]), torch.device("cpu"))
        np.testing.assert_array_equal(x.numpy(), examples.signals[[2, 0, 2]])
        for found, wanted in ((radius, examples.radius), (wavelength, examples.wavelength), (twist, examples.twist)):
            np.testing.assert_array_equal(found.numpy(), wanted[[2, 0, 2]])


@pytest.mark.parametrize("simulated", [False, True])
def test_labels_to_learn_from_have_logarithms(data: Folders, simulated: bool) -> None:
    examples = Examples.of(read_dataset(data[simulated]))
    one = torch.ones(len(examples))
    for errors in logarithms(one, one, torch.from_numpy(examples.radius), torch.from_numpy(examples.wavelength)):
        assert torch.isfinite(errors).all()


def test_errors_are_logarithms_of_ratios_but_for_radii_nobody_can_see() -> None:
    found = torch.tensor([2.0, 1.0, 0.0])
    wanted = torch.tensor([1.0, 1.0, 1e-4])
    by_radius, by_wavelength = logarithms(found, found + 1.0, wanted, wanted + 1.0)
    assert float(by_radius[0]) == pytest.approx(math.log(2.02 / 1.02))
    assert float(by_radius[1]) == 0.0
    assert abs(float(by_radius[2])) < 0.01
    assert float(by_wavelength[0]) == pytest.approx(math.log(1.5))


def examples_of_all_types(each: int) -> Examples:
    rng = np.random.default_rng(0)
    kind = np.repeat(np.arange(len(HAIR_TYPES)), each).astype(np.int8)
    values = rng.uniform(0.5, 2.0, (len(kind), 256, 3)).astype(np.float32)
    radius, wavelength, twist = (rng.uniform(0.2, 0.8, len(kind)).astype(np.float32) for _ in range(3))
    return Examples(values, radius, wavelength, twist, kind, np.zeros(len(kind), dtype=np.bool_))


def test_strands_as_read_are_scored_apart() -> None:
    examples = examples_of_all_types(2)
    examples.read[::2] = True
    torch.manual_seed(0)
    found = score(Labeler(TINY), examples)
    assert list(found) == ["all", *(kind.name for kind in HAIR_TYPES), "as read"]
    assert [row["count"] for row in found.values()] == [8, *[1] * 8, 8]


def test_scores_are_errors_by_type_and_over_all() -> None:
    torch.manual_seed(0)
    network, examples = Labeler(TINY), examples_of_all_types(5)
    found = score(network, examples)
    assert list(found) == ["all", *(kind.name for kind in HAIR_TYPES)]
    assert found["all"]["count"] == 40
    radius, wavelength, twist = told(network, examples.signals)
    for k, kind in enumerate(HAIR_TYPES):
        rows = slice(5 * k, 5 * k + 5)
        by_radius = np.abs(radius[rows] / examples.radius[rows] - 1.0)
        by_wavelength = np.abs(wavelength[rows] / examples.wavelength[rows] - 1.0)
        scores = found[kind.name]
        assert scores["count"] == 5
        assert scores["radius_median"] == pytest.approx(np.sort(by_radius)[2], rel=1e-5)
        assert scores["wavelength_median"] == pytest.approx(np.sort(by_wavelength)[2], rel=1e-5)
        assert scores["radius_median"] <= scores["radius_90"] <= by_radius.max()
        assert scores["twist_mean"] == pytest.approx(np.abs(twist[rows] - examples.twist[rows]).mean(), rel=1e-5)


def test_a_type_of_which_there_is_none_has_no_scores() -> None:
    examples = examples_of_all_types(1)
    some = Examples(**{name: getattr(examples, name)[2:4] for name in Examples.__dataclass_fields__})
    torch.manual_seed(0)
    assert list(score(Labeler(TINY), some)) == ["all", "III", "IV"]


def test_strands_of_no_type_are_scored_apart() -> None:
    examples = examples_of_all_types(2)
    examples.kind[:3] = UNTYPED
    torch.manual_seed(0)
    found = score(Labeler(TINY), examples)
    assert found["of no type"]["count"] == 3
    assert found["all"]["count"] == 13 == sum(found[kind.name]["count"] for kind in HAIR_TYPES[1:])


def test_a_training_scores_every_type_that_is_held_out(whole: Path, data: Folders) -> None:
    scores = training(whole, data).scores
    assert read_labelers(whole / CHECKPOINT)["report"]["scores"] == scores
    in_canonical = [f"{name}, in canonical space" for name in ("procedural", "simulated")]
    assert set(scores) == {"procedural", "simulated", *in_canonical}
    for folder, found in zip(np.repeat(data, 2), scores.values(), strict=True):
        labels = read_dataset(folder, TEST).labels
        plain = labels["kind"][~labels["read"]]
        types = {HAIR_TYPES[k].name for k in np.unique(plain)}
        assert set(found) - {"all", "as read"} == types
        assert found["all"]["count"] == len(plain) == sum(found[name]["count"] for name in types)
        assert found.get("as read", {"count": 0})["count"] == labels["read"].sum()
        assert all(math.isfinite(x) for row in found.values() for x in row.values())


def test_what_is_told_does_not_drop_out_and_does_not_depend_on_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    torch.manual_seed(0)
    network, examples = Labeler(TINY).train(), examples_of_all_types(3)
    one, other = told(network, examples.signals), told(network, examples.signals)
    monkeypatch.setattr("detangled_training.labeler_training.EVALUATED", 5)
    parts = told(network, examples.signals)
    for a, b, c in zip(one, other, parts, strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_allclose(a, c, rtol=1e-5)
