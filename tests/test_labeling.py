"""Reading of strands: kappa, tau and v of lower sections, and labels by a tiny labeler."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

onnx = pytest.importorskip("onnx", reason="the tiny labeler is written by onnx")

from detangled.errors import ModelError  # noqa: E402
from detangled.formats import read, write  # noqa: E402
from detangled.groom import Groom  # noqa: E402
from detangled.kernels import set_threads, thread_count  # noqa: E402
from detangled.labeling import (  # noqa: E402
    CELLS,
    CELLS_PER_TURN,
    LOWER_PART,
    Labels,
    LowerSignals,
    Reading,
    label,
    lower_signals,
    nearest_types,
)
from detangled.models import FILES, FOLDER_VARIABLE, LABELER, load_labeler  # noqa: E402
from detangled.texture import HAIR_TYPES, HairType, arc_of_a_turn  # noqa: E402
from geometry_curves import helix, random_rotation  # noqa: E402
from tiny_labeler import write_tiny  # noqa: E402

# How far R and wavelength may be off where eight points a turn or more are given, worst for waves of few points.
ACCURACY = 0.03
FLOAT32 = 1e-5

Floats = NDArray[np.float64]
WOUND = HAIR_TYPES[1:]  # six turns of type I are its own axis: such hair is straight


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny(tmp_path_factory.mktemp("models"))


@pytest.fixture(autouse=True)
def installed(models: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The tiny labeler in place of the real one, and as many threads afterwards as before."""
    threads = thread_count()
    monkeypatch.setenv(FOLDER_VARIABLE, str(models))
    yield
    set_threads(threads)


# ---- strands


def coil(kind: HairType, per_turn: float = 16.0, hand: int = 1, turns: float = 0.0) -> Floats:
    """A helix of a type's means, of six turns or as many as its hair has, up to twenty."""
    radius, wavelength = kind.radius.mean, kind.wavelength.mean
    natural = np.clip(kind.length.mean / arc_of_a_turn(radius, wavelength), 6.0, 20.0)
    return helix(radius, wavelength, turns or float(natural), per_turn, hand)


def moved(points: Floats, seed: int = 0) -> Floats:
    """A strand somewhere on a head, turned any way."""
    rng = np.random.default_rng(seed)
    return points @ random_rotation(rng).T + rng.uniform(-30.0, 180.0, 3)


def groom_of(*strands: Floats) -> Groom:
    return Groom.from_strands(strands)


def lower(*strands: Floats) -> LowerSignals:
    groom = groom_of(*strands)
    return lower_signals(groom.points, groom.offsets)


def read_off(values: Floats) -> tuple[Floats, Floats]:
    """Radius and wavelength (S,) by the helix equations of the lower part's means."""
    kappa, tau = np.moveaxis(values[:, CELLS - round(LOWER_PART * CELLS) :, :2].mean(axis=1), 1, 0)
    return kappa / (kappa**2 + tau**2), 2.0 * np.pi * np.abs(tau) / (kappa**2 + tau**2)


STRAIGHT = np.linspace([0.0, 0.0, 0.0], [1.0, 2.0, -20.0], 40)
BROKEN = np.full((5, 3), np.nan)
POINT = np.ones((1, 3))
COARSE = coil(HAIR_TYPES[5], per_turn=2.2, turns=12.0)


# ---- signals of lower sections


@pytest.mark.parametrize("per_turn", [8, 16, 64])
def test_a_helix_gives_its_radius_and_wavelength_back(per_turn: int) -> None:
    coils = [moved(coil(kind, per_turn, hand), seed=k) for k, kind in enumerate(WOUND) for hand in (1, -1)]
    found = lower(*coils)
    assert found.reading.tolist() == [Reading.READ] * len(coils)
    radius, wavelength = read_off(found.values)
    np.testing.assert_allclose(radius, np.repeat([kind.radius.mean for kind in WOUND], 2), rtol=ACCURACY)
    np.testing.assert_allclose(wavelength, np.repeat([kind.wavelength.mean for kind in WOUND], 2), rtol=ACCURACY)
    # Moving a strand keeps its hand.
    assert np.sign(found.values[:, :, 1].mean(axis=1)).tolist() == [1.0, -1.0] * len(WOUND)


def test_lengths_are_of_the_whole_strand_and_speeds_of_the_part_that_is_read() -> None:
    coils = [moved(coil(kind), seed=k) for k, kind in enumerate(WOUND)]
    found = lower(*coils)
    turns = [(len(points) - 1) / 16.0 for points in coils]
    wanted = [t * arc_of_a_turn(kind.radius.mean, kind.wavelength.mean) for t, kind in zip(turns, WOUND, strict=True)]
    np.testing.assert_allclose(found.length, wanted, rtol=0.005)
    np.testing.assert_array_equal(found.part, 1.0)
    np.testing.assert_allclose(found.values[:, :, 2].mean(axis=1), found.length, rtol=0.005)


def test_of_many_turns_the_lowest_are_read() -> None:
    """A strand of two halves, the lower one of another type, that has more turns than the cells can hold."""
    tight, wide = (0.18, 0.42), (0.28, 0.75)
    lower_half = helix(*wide, 20.0, 16.0)
    upper = helix(*tight, 30.0, 16.0)
    strand = np.concatenate([upper[:-1], lower_half - lower_half[0] + upper[-1]])
    found = lower(moved(strand))
    assert found.reading.tolist() == [Reading.READ]
    turns = 50.0
    assert found.part[0] == pytest.approx(CELLS / (CELLS_PER_TURN * turns), rel=0.3)
    radius, wavelength = read_off(found.values)
    assert radius[0] == pytest.approx(wide[0], rel=ACCURACY)
    assert wavelength[0] == pytest.approx(wide[1], rel=ACCURACY)
    covered = found.values[0, :, 2].mean()
    assert covered == pytest.approx(found.part[0] * found.length[0], rel=0.1)


def test_a_wave_of_too_few_turns_and_a_straight_strand_are_straight() -> None:
    bow = np.stack([np.zeros(60), 0.02 * np.linspace(0, 20, 60) ** 2, -np.linspace(0, 20, 60)], axis=1)
    found = lower(moved(STRAIGHT), STRAIGHT[[0, -1]], moved(coil(HAIR_TYPES[0], turns=2.0)), moved(bow))
    assert found.reading.tolist() == [Reading.STRAIGHT] * 4
    assert np.isnan(found.values).all()
    assert found.length[0] == pytest.approx(np.linalg.norm(STRAIGHT[-1] - STRAIGHT[0]), rel=1e-6)


def test_the_lowest_type_winds_where_there_is_enough_of_it() -> None:
    kind = HAIR_TYPES[0]
    found = lower(moved(coil(kind, turns=40.0)))
    assert found.reading.tolist() == [Reading.READ]
    radius, wavelength = read_off(found.values)
    assert radius[0] == pytest.approx(kind.radius.mean, rel=0.05)
    assert wavelength[0] == pytest.approx(kind.wavelength.mean, rel=0.05)


@pytest.mark.parametrize("kind", HAIR_TYPES[2:], ids=lambda kind: kind.name)
def test_little_more_than_two_points_a_turn_are_coarse_and_eight_are_not(kind: HairType) -> None:
    found = lower(*(moved(coil(kind, per_turn, turns=12.0)) for per_turn in (2.2, 2.5, 8)))
    assert found.reading.tolist() == [Reading.COARSE, Reading.COARSE, Reading.READ]
    assert np.isnan(found.values[:2]).all()
    assert np.isfinite(found.values[2]).all()


@pytest.mark.parametrize("kind", HAIR_TYPES[2:], ids=lambda kind: kind.name)
def test_two_points_a_turn_are_coarse(kind: HairType) -> None:
    """They are a zigzag in a plane, which says nothing of the coil."""
    assert lower(moved(coil(kind, 2.0, turns=12.0))).reading.tolist() == [Reading.COARSE]


def test_points_along_the_strand_may_lie_anyhow() -> None:
    """Unevenly, and twice in one place: what is read is the curve."""
    fine = coil(HAIR_TYPES[5], per_turn=64.0)
    rng = np.random.default_rng(2)
    some = np.sort(rng.choice(len(fine), len(fine) // 3, replace=False))
    some[0], some[-1] = 0, len(fine) - 1
    uneven = fine[np.sort(np.concatenate([some, some[5:9]]))]
    (plain, other) = (read_off(lower(points).values) for points in (fine, uneven))
    for k in range(2):
        np.testing.assert_allclose(other[k], plain[k], rtol=ACCURACY)


def test_a_strand_is_read_as_it_is_alone() -> None:
    strands = [moved(coil(kind), seed=k) for k, kind in enumerate(WOUND)]
    strands[2:2] = [STRAIGHT, COARSE]
    together = lower(*strands)
    for threads in (1, 2):
        set_threads(threads)
        for order in (list(range(len(strands))), list(range(len(strands)))[::-1]):
            found = lower(*(strands[k] for k in order))
            for field in fields(LowerSignals):
                np.testing.assert_array_equal(getattr(found, field.name), getattr(together, field.name)[order])
    for k, strand in enumerate(strands):
        alone = lower(strand)
        np.testing.assert_array_equal(alone.values[0], together.values[k])
        assert alone.reading[0] == together.reading[k]


def test_no_strands_at_all() -> None:
    found = lower_signals(np.empty((0, 3)), np.array([0]))
    assert found.values.shape == (0, CELLS, 5)
    assert [len(getattr(found, name)) for name in ("reading", "length", "part")] == [0, 0, 0]


# ---- labels of a groom


def test_types_are_read_from_a_groom() -> None:
    """By the mean over all of the signal; ends, where a centreline is known least, cost some percent more."""
    coils = [moved(coil(kind, turns=12.0), seed=k) for k, kind in enumerate(WOUND)]
    found = label(groom_of(*coils))
    assert found.reading.tolist() == [Reading.READ] * len(coils)
    np.testing.assert_allclose(found.radius, [kind.radius.mean for kind in WOUND], rtol=2.0 * ACCURACY)
    np.testing.assert_allclose(found.wavelength, [kind.wavelength.mean for kind in WOUND], rtol=2.0 * ACCURACY)
    assert (found.twist > 0.5).all()
    np.testing.assert_array_equal(found.kind, nearest_types(found.radius, found.wavelength, found.twist))


@pytest.mark.parametrize(("unit", "cm"), [("mm", 0.1), ("cm", 1.0), ("m", 100.0)])
def test_a_file_in_any_unit_has_the_same_labels(tmp_path: Path, unit: str, cm: float) -> None:
    coils = [coil(HAIR_TYPES[k], turns=8.0) for k in (2, 5, 7)]
    path = tmp_path / "hair.npz"
    write(Groom.from_strands(coils, unit_cm=1.0), tmp_path / "cm.npz")
    write(Groom.from_strands(coils, unit_cm=cm), path)
    groom = read(path, unit=unit)
    assert groom.unit_cm == pytest.approx(cm)
    found, wanted = label(groom), label(groom_of(*coils))
    np.testing.assert_allclose(found.radius, wanted.radius, rtol=1e-3)
    np.testing.assert_allclose(found.wavelength, wanted.wavelength, rtol=1e-3)
    np.testing.assert_allclose(found.length, wanted.length, rtol=1e-5)
    assert found.kind.tolist() == wanted.kind.tolist()


def test_every_strand_keeps_its_place_among_others_that_cannot_be_read() -> None:
    curl = moved(coil(HAIR_TYPES[5]))
    far = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 3000.0]])
    strands = [BROKEN, curl, POINT, STRAIGHT, COARSE, np.empty((0, 3)), curl, np.ones((4, 3)), far]
    told_of: list[int] = []
    found = label(groom_of(*strands), told_of.append)
    unusable = Reading.UNUSABLE
    assert found.reading.tolist() == [
        *(unusable, Reading.READ, unusable, Reading.STRAIGHT, Reading.COARSE),
        *(unusable, Reading.READ, unusable, unusable),
    ]
    assert sum(told_of) == len(strands)
    alone = label(groom_of(curl))
    for name in ("radius", "wavelength", "twist"):
        values = getattr(found, name)
        assert values.shape == (len(strands),)
        assert values[1] == values[6] == getattr(alone, name)[0]
        assert np.isnan(values[[0, 2, 4, 5, 7, 8]]).all()
    assert (found.radius[3], found.twist[3], found.kind[3]) == (0.0, 0.0, 0)
    assert np.isnan(found.wavelength[3])
    assert found.kind.tolist() == [-1, alone.kind[0], -1, 0, -1, -1, alone.kind[0], -1, -1]
    assert np.isnan(found.length[[0, 2, 5, 7, 8]]).all()
    assert np.isfinite(found.length[[1, 3, 4, 6]]).all()


def assert_same_labels(one: Labels, other: Labels, order: Any = slice(None)) -> None:
    for field in fields(Labels):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name)[order], field.name)


def test_labels_depend_neither_on_the_other_strands_nor_on_threads_nor_on_parts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kinds = [HAIR_TYPES[k] for k in (1, 2, 4, 6, 7)]
    strands = [moved(coil(kind, hand=hand), seed=k) for k, kind in enumerate(kinds) for hand in (1, -1)]
    strands[3:3] = [STRAIGHT, BROKEN]
    together = label(groom_of(*strands))
    for threads in (1, 2):
        set_threads(threads)
        assert_same_labels(label(groom_of(*strands)), together)
    order = np.random.default_rng(3).permutation(len(strands))
    assert_same_labels(label(groom_of(*(strands[k] for k in order))), together, order)
    monkeypatch.setattr("detangled.labeling.CHUNK", 3)
    assert_same_labels(label(groom_of(*strands)), together)
    for k in (0, 6, 11):
        assert_same_labels(label(groom_of(strands[k])), together, slice(k, k + 1))


def test_a_groom_without_strands_and_one_without_any_that_can_be_read() -> None:
    found = label(groom_of())
    assert [len(getattr(found, field.name)) for field in fields(Labels)] == [0] * 6
    none = label(groom_of(BROKEN, POINT))
    assert none.reading.tolist() == [Reading.UNUSABLE] * 2
    assert none.kind.tolist() == [-1, -1]


def test_a_missing_model_is_said_with_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    with pytest.raises(ModelError) as refused:
        label(groom_of(STRAIGHT))
    said = str(refused.value)
    for words in (str(tmp_path), "labeler.json", "install detangled again", "export the model anew"):
        assert words in said
    assert "\n" not in said


def test_a_damaged_model_is_refused(tmp_path: Path) -> None:
    folder = write_tiny(tmp_path)
    path = folder / FILES[LABELER]
    data = path.read_bytes()
    path.write_bytes(data[:100] + bytes([data[100] ^ 1]) + data[101:])
    with pytest.raises(ModelError, match="its bytes are not those"):
        load_labeler(LABELER, folder)
    (folder / "labeler.json").write_text("{", encoding="utf-8")
    with pytest.raises(ModelError, match="manifest"):
        load_labeler(LABELER, folder)


@pytest.mark.parametrize("batch", [0, None, "many"])
def test_a_batch_that_is_none_is_damage(tmp_path: Path, batch: object) -> None:
    folder = write_tiny(tmp_path)
    path = folder / "labeler.json"
    path.write_text(json.dumps(json.loads(path.read_text(encoding="utf-8")) | {"batch": batch}), encoding="utf-8")
    with pytest.raises(ModelError, match="damaged"):
        load_labeler(LABELER, folder)
