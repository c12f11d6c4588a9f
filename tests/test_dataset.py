"""Data sets on disk: the same bytes however they came about, and nothing half taken for whole.

Variants are faked: what is tried here is how they are kept.
"""

from __future__ import annotations

import errno
import hashlib
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from detangled.errors import DetangledError, ReadError, WriteError
from detangled_training import dataset
from detangled_training.dataset import (
    MANIFEST,
    SHARD,
    TEST,
    TRAIN,
    VALIDATION,
    Make,
    read_dataset,
    read_manifest,
    split_of,
)
from detangled_training.variants import VariantOptions
from faked_data import COUNT, OPTIONS, SEED, bytes_of, make, make_and_die, stopping, write, wrongly


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set made in one go; not to be changed."""
    folder: Path = tmp_path_factory.mktemp("whole") / "new" / "set"
    write(folder)
    return folder


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    """That data set, to be changed."""
    folder = tmp_path / "set"
    folder.mkdir()
    for name, data in bytes_of(whole).items():
        (folder / name).write_bytes(data)
    return folder


# ---- the same bytes, however they came about


def test_the_same_bytes_of_one_process_and_of_two(whole: Path, tmp_path: Path) -> None:
    told: list[int] = []
    written = write(tmp_path / "two", workers=2, progress=told.append)
    assert (written.made, written.manifest.finished) == (3, True)
    assert sorted(told) == [0, 300, SHARD, SHARD]
    assert bytes_of(tmp_path / "two") == bytes_of(whole)
    assert sorted(bytes_of(whole)) == [MANIFEST, "shard-00000.npz", "shard-00001.npz", "shard-00002.npz"]


@pytest.mark.parametrize("after", [0, 1, 2])
def test_the_same_bytes_of_one_run_and_of_a_stopped_one_gone_on_with(after: int, whole: Path, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path, make=stopping(after, KeyboardInterrupt()))
    begun = read_manifest(tmp_path)
    assert len(begun.shards) == after
    assert sorted(bytes_of(tmp_path)) == sorted([MANIFEST, *begun.shards])
    with pytest.raises(ReadError, match=f"{after} of 3 shards are whole"):
        read_dataset(tmp_path)

    told: list[int] = []
    assert write(tmp_path, progress=told.append).made == 3 - after
    assert told == [after * SHARD, *[SHARD, SHARD, 300][after:]]
    assert bytes_of(tmp_path) == bytes_of(whole)


def test_another_seed_makes_other_bytes(whole: Path, tmp_path: Path) -> None:
    write(tmp_path, SHARD, seed=SEED + 1)
    assert (tmp_path / "shard-00000.npz").read_bytes() != (whole / "shard-00000.npz").read_bytes()


def test_more_strands_keep_the_whole_shards_and_make_the_short_one_anew(tmp_path: Path, whole: Path) -> None:
    write(tmp_path, SHARD + 10)
    untouched = (tmp_path / "shard-00000.npz").stat().st_mtime_ns
    assert write(tmp_path).made == 2
    assert (tmp_path / "shard-00000.npz").stat().st_mtime_ns == untouched
    assert bytes_of(tmp_path) == bytes_of(whole)


def test_a_finished_data_set_is_left_alone(copy: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in copy.iterdir()}
    written = write(copy, make=stopping(0, AssertionError()))
    assert (written.made, written.manifest.finished) == (0, True)
    assert {path: path.stat().st_mtime_ns for path in copy.iterdir()} == before


def test_the_manifest_tells_what_is_there(whole: Path) -> None:
    stored = json.loads((whole / MANIFEST).read_text())
    assert (stored["count"], stored["seed"], stored["shard_strands"]) == (COUNT, SEED, SHARD)
    assert stored["options"] == {"hung": 2, "read_share": 0.5, "cells": 4, "untyped": 0.0}
    assert stored["columns"] == ["base", "variant", "radius", "position"]
    assert len(stored["commits"]) == 1
    assert [shard["strands"] for shard in stored["shards"].values()] == [SHARD, SHARD, 300]
    for name, shard in stored["shards"].items():
        assert shard["sha256"] == hashlib.sha256((whole / name).read_bytes()).hexdigest()


# ---- what is not whole


def spoil(path: Path, how: str) -> None:
    data = path.read_bytes()
    if how == "missing":
        path.unlink()
    elif how == "a folder":
        path.unlink()
        path.mkdir()
    else:
        middle = len(data) // 2
        flipped = data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]
        path.write_bytes({"empty": b"", "cut": data[:middle], "flipped": flipped}[how])


@pytest.mark.parametrize("how", ["missing", "empty", "cut", "flipped"])
def test_a_spoiled_shard_is_refused_and_made_again(how: str, copy: Path, whole: Path) -> None:
    spoil(copy / "shard-00001.npz", how)
    with pytest.raises(ReadError, match=r"shard-00001\.npz: (missing|damaged).*again") as refused:
        read_dataset(copy)
    assert "\n" not in str(refused.value)
    assert write(copy).made == 1
    assert bytes_of(copy) == bytes_of(whole)


@pytest.mark.parametrize(
    "how", ["missing", "a folder", "empty", "cut", "of another thing", "of another version", "bare"]
)
def test_a_spoiled_manifest_is_one_line_and_nothing_is_written_over(how: str, copy: Path) -> None:
    path = copy / MANIFEST
    stored = json.loads(path.read_text())
    if how == "of another thing":
        path.write_text('{"name": "a page", "icons": []}')
    elif how == "of another version":
        path.write_text(json.dumps({**stored, "version": 2}))
    elif how == "bare":
        path.write_text(json.dumps({"format": stored["format"], "version": 1, "count": 3}))
    else:
        spoil(path, how)
    before = {name: (copy / name).read_bytes() for name in stored["shards"]}
    for call in (read_dataset, write):
        with pytest.raises(DetangledError, match=re.escape(str(copy))) as refused:
            call(copy)
        assert isinstance(refused.value, ReadError | WriteError)
        assert "\n" not in str(refused.value)
    assert {name: (copy / name).read_bytes() for name in stored["shards"]} == before


def test_what_a_killed_run_left_half_written_is_never_taken_and_goes(tmp_path: Path, whole: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path, make=stopping(1, KeyboardInterrupt()))
    half = (whole / "shard-00001.npz").read_bytes()[:1000]
    (tmp_path / ".shard-00001.0123abcd.npz").write_bytes(half)
    (tmp_path / ".manifest.0123abcd.json").write_text('{"format"')
    # Renamed, but the manifest does not tell of it yet.
    (tmp_path / "shard-00002.npz").write_bytes(half)
    assert write(tmp_path).made == 2
    assert bytes_of(tmp_path) == bytes_of(whole)


@pytest.mark.parametrize(
    ("count", "changed", "said"),
    [
        (COUNT, {"seed": SEED + 1}, "seed 3, not 4"),
        (COUNT, {"options": VariantOptions(hung=1, cells=4)}, "hung 2, not 1"),
        (
            COUNT,
            {"options": VariantOptions(hung=2, cells=8, read_share=0.25)},
            "read share 0.5, not 0.25, cells 4, not 8",
        ),
        (COUNT - 1, {}, "2,300 strands, more than 2,299"),
    ],
)
def test_another_data_set_is_refused(count: int, changed: dict[str, Any], said: str, copy: Path, whole: Path) -> None:
    with pytest.raises(WriteError, match=f"{re.escape(said)}.*another folder"):
        write(copy, count, **changed)
    assert bytes_of(copy) == bytes_of(whole)


def test_other_columns_than_it_was_begun_with_are_refused(copy: Path, whole: Path) -> None:
    spoil(copy / "shard-00002.npz", "missing")
    with pytest.raises(WriteError, match=r"position, and this version makes base, .*, length: name another folder$"):
        write(copy, make=wrongly(length=np.zeros(len(make(2 * SHARD, 300, SEED, OPTIONS)[0]))))
    assert write(copy).made == 1
    assert bytes_of(copy) == bytes_of(whole)


@pytest.mark.parametrize("wrong", [wrongly(np.float64), wrongly(lambda values: values[1:]), wrongly(base=np.zeros(5))])
def test_what_is_no_shard_is_not_written(wrong: Make, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"shard's|one value a signal"):
        write(tmp_path, make=wrong)
    assert [path.name for path in tmp_path.iterdir()] == [MANIFEST]


@pytest.mark.parametrize("full", ["shard-00001", "manifest"])
def test_a_full_disk_leaves_what_is_whole(
    full: str, tmp_path: Path, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real_arrays, real_text, manifests = dataset.write_arrays, Path.write_text, []

    def write_arrays(path: Path, arrays: Any) -> None:
        if full in path.name:
            path.write_bytes(b"PK half of it")
            raise OSError(errno.ENOSPC, "No space left on device")
        real_arrays(path, arrays)

    def write_text(path: Path, *text: Any, **how: Any) -> int:
        manifests.append(path)
        if full in path.name and len(manifests) == 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real_text(path, *text, **how)

    with monkeypatch.context() as patch:
        patch.setattr(dataset, "write_arrays", write_arrays)
        patch.setattr(Path, "write_text", write_text)
        with pytest.raises(WriteError, match="No space left on device; 1 of 3 shards are whole: the same again"):
            write(tmp_path)
    assert list(read_manifest(tmp_path).shards) == ["shard-00000.npz"]
    assert not list(tmp_path.glob(".*"))
    assert write(tmp_path).made == 2
    assert bytes_of(tmp_path) == bytes_of(whole)


def test_a_process_that_is_killed_ends_it_in_one_line(tmp_path: Path, whole: Path) -> None:
    with pytest.raises(WriteError, match=r"process making shards was ended.* \d of 3 shards are whole.*fewer workers"):
        write(tmp_path, workers=2, make=make_and_die)
    write(tmp_path)
    assert bytes_of(tmp_path) == bytes_of(whole)


# ---- reading, and the split


def test_what_is_read_is_what_was_made(whole: Path) -> None:
    read = read_dataset(whole)
    signals, labels = make(0, COUNT, SEED, OPTIONS)
    assert read.signals.dtype == np.float32
    np.testing.assert_array_equal(read.signals, signals)
    assert list(read.labels) == list(labels)
    for name, column in labels.items():
        assert read.labels[name].dtype == column.dtype
        np.testing.assert_array_equal(read.labels[name], column)
    assert (read.origin["count"], read.origin["seed"], read.origin["split"]) == (COUNT, SEED, "all")
    json.dumps(read.origin)


@pytest.mark.parametrize("split", [TRAIN, VALIDATION, TEST])
def test_a_split_is_its_own_strands(split: int, whole: Path) -> None:
    everything, part = read_dataset(whole), read_dataset(whole, split, ["variant", "base"])
    chosen = split_of(everything.labels["base"]) == split
    np.testing.assert_array_equal(part.signals, everything.signals[chosen])
    assert list(part.labels) == ["variant", "base"]
    np.testing.assert_array_equal(part.labels["base"], everything.labels["base"][chosen])


def test_all_variants_of_a_strand_are_in_one_split(whole: Path) -> None:
    splits = [set(read_dataset(whole, split).labels["base"]) for split in (TRAIN, VALIDATION, TEST)]
    assert set.union(*splits) == set(range(COUNT))
    assert sum(len(split) for split in splits) == COUNT
    shares = [len(split) / COUNT for split in splits]
    np.testing.assert_allclose(shares, [0.9, 0.05, 0.05], atol=0.001)


def test_the_rule_of_the_split_stays() -> None:
    """Numbers written down here: another rule would train on what older networks are tested on."""
    assert split_of([0, 1, 2, 19, 20, 21, 40, 39_999, 50_001]).tolist() == [2, 1, 0, 0, 2, 1, 2, 0, 1]


def test_a_column_that_is_not_there(whole: Path) -> None:
    with pytest.raises(ReadError, match=r"has no thickness; its columns are base, variant, radius, position$"):
        read_dataset(whole, columns=["radius", "thickness"])


def test_no_data_set_at_all(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(ReadError, match=f"{re.escape(str(folder))}: holds no data set"):
            read_dataset(folder)
