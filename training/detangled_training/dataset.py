"""Data sets on disk: signals of base strands and of their variants, in shards beside a manifest.

A shard is made of its strands' numbers, a seed and options alone, so that it holds the same bytes whichever process
made it, and when. It is written whole or not at all, and counts once the manifest tells its SHA-256: a run that was
stopped is gone on with by the same call, and more strands of the same seed and options by one with a larger count.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.archives import DAMAGE, read_arrays, write_arrays
from detangled.errors import DetangledError, ReadError, WriteError
from detangled.formats import replacing
from detangled.kernels import set_threads, thread_count
from detangled_training.provenance import commit, make_folder
from detangled_training.variants import VariantOptions, make_variants

Labels = dict[str, NDArray[Any]]
Make = Callable[[int, int, int, VariantOptions], tuple[NDArray[np.float32], Labels]]

SHARD = 1_000  # base strands: some megabytes, and what is lost at most when a run is stopped
MANIFEST = "manifest.json"
FORMAT = "detangled data set"
VERSION = 1
SIGNALS, BASE = "signals", "base"  # arrays that every shard holds

TRAIN, VALIDATION, TEST = 0, 1, 2
SPLIT_NAMES = ("training", "validation", "test")
# Of so many base strands one is for tests, and one for validation.
SPLIT_EVERY = 20

_AGAIN = "make the data set again, by the call that it was made by: what is whole is kept"


@dataclass(frozen=True)
class Shard:
    """A shard that is whole: how many base strands it was made of, how many signals it holds, and its file's digest."""

    strands: int
    signals: int
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """What a data set is, and how far it got.

    count: base strands, of numbers from 0. options: of the variants, as plain values. columns: names of the labels,
    none before there is a shard. commits: of the code that it was made by, in order. shards: those that are whole, by
    their file's name.
    """

    count: int
    seed: int
    options: dict[str, Any]
    shard_strands: int = SHARD
    columns: tuple[str, ...] = ()
    commits: tuple[str, ...] = ()
    shards: Mapping[str, Shard] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """Names of all shards' files, there or not."""
        return [f"shard-{number:05d}.npz" for number in range(-(-self.count // self.shard_strands))]

    @property
    def finished(self) -> bool:
        return all(name in self.shards for name in self.names)

    @property
    def signals(self) -> int:
        """How many signals the whole shards hold."""
        return sum(shard.signals for shard in self.shards.values())

    @property
    def how_far(self) -> str:
        return f"{len(self.shards):,} of {len(self.names):,} shards are whole"

    def part(self, number: int) -> tuple[int, int]:
        """The first base strand of a shard, and how many it has."""
        first = number * self.shard_strands
        return first, min(self.shard_strands, self.count - first)


@dataclass(frozen=True)
class Written:
    """What ``write_dataset`` ended with: the manifest, and how many shards were made now."""

    manifest: Manifest
    made: int


@dataclass(frozen=True, eq=False)
class Dataset:
    """Signals (V, L, 3) float32 in order of base strand, and labels, a column (V, ...) each.

    origin: where they come from, as plain values for a manifest or a checkpoint.
    """

    signals: NDArray[np.float32]
    labels: Labels
    origin: dict[str, Any]


def split_of(base: ArrayLike) -> NDArray[np.int8]:
    """Which split each base strand, and so every variant of it, belongs to: TRAIN, VALIDATION or TEST, (V,).

    Of every 20 numbers in a row the first is for tests, the second for validation, whatever the seed; types are drawn
    without regard to numbers, so that all splits hold all of them.
    """
    place = np.asarray(base, dtype=np.int64) % SPLIT_EVERY
    return np.select([place == 0, place == 1], [TEST, VALIDATION], TRAIN).astype(np.int8)


def write_dataset(
    folder: Path,
    count: int,
    seed: int,
    options: VariantOptions,
    workers: int | None = None,
    progress: Callable[[int], object] | None = None,
    make: Make = make_variants,
) -> Written:
    """Write the signals of base strands 0 to ``count`` and their variants, or go on with what a folder holds of them.

    Shards that are whole are kept, others made anew; the same bytes come of any number of workers.

    workers: processes that share the threads in use; None: one for each of these.
    progress: told how many base strands are done, those that were there already first.
    make: what makes the signals and labels of some strands; importable by name, for it runs in other processes.
    Raises WriteError where the folder cannot be written to, holds another data set, or gets full: what is whole stays.
    """
    if count < 1 or seed < 0 or (workers is not None and workers < 1):
        raise DetangledError(f"a data set needs strands, workers and a seed, not {count}, {workers} and {seed}")
    tell = progress or (lambda strands: None)
    manifest, missing = _begin(folder, Manifest(count, seed, _plain(options)))
    tell(sum(shard.strands for shard in manifest.shards.values()))
    if not missing:
        return Written(manifest, 0)
    manifest = replace(manifest, commits=tuple(dict.fromkeys((*manifest.commits, commit()))))
    _write_manifest(folder, manifest)
    jobs = [(number, *manifest.part(number)) for number in missing]
    try:
        with closing(_made(jobs, seed, options, workers or thread_count(), make)) as made:
            for number, signals, labels in made:
                manifest = _put(folder, manifest, number, signals, labels)
                tell(manifest.part(number)[1])
    except BrokenProcessPool as error:
        raise WriteError(
            f"{folder}: a process making shards was ended, as happens where memory is short: {manifest.how_far}; "
            "the same again goes on from there, with fewer workers in less memory"
        ) from error
    return Written(manifest, len(missing))


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a data set, finished or not. Raises ReadError."""
    path = folder / MANIFEST
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ReadError(f"{folder}: holds no data set: there is no {MANIFEST}") from None
    except OSError as error:
        raise ReadError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise ReadError(f"{path}: not a data set's manifest, or damaged: {error}") from error
    if not isinstance(stored, dict) or stored.get("format") != FORMAT:
        raise ReadError(f"{path}: not a data set's manifest")
    if stored.get("version") != VERSION:
        raise ReadError(f"{path}: of version {stored.get('version')}, not {VERSION}: make the data set again")
    try:
        return Manifest(
            count=int(stored["count"]),
            seed=int(stored["seed"]),
            options=dict(stored["options"]),
            shard_strands=int(stored["shard_strands"]),
            columns=tuple(stored["columns"]),
            commits=tuple(stored["commits"]),
            shards={name: Shard(**shard) for name, shard in stored["shards"].items()},
        )
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ReadError(f"{path}: not a data set's manifest, or damaged ({error})") from error


def read_dataset(folder: Path, split: int | None = None, columns: Sequence[str] | None = None) -> Dataset:
    """Read a data set, or one split of it.

    split: TRAIN, VALIDATION or TEST; None: all. columns: names of the labels wanted; None: all.
    Raises ReadError where the data set is missing, unfinished or damaged, or lacks a column.
    """
    manifest = read_manifest(folder)
    if not manifest.finished:
        raise ReadError(f"{folder}: {manifest.how_far}: finish it by the call that began it")
    wanted = manifest.columns if columns is None else tuple(columns)
    lacking = [name for name in wanted if name not in manifest.columns]
    if lacking:
        raise ReadError(f"{folder}: has no {', '.join(lacking)}; its columns are {', '.join(manifest.columns)}")
    cells = manifest.options["cells"]
    # What is not filled of it takes no memory, where a copy at the end would take as much again.
    signals = np.empty((manifest.signals, cells, 3), dtype=np.float32)
    parts: list[Labels] = []
    end = 0
    for name in manifest.names:
        arrays = _read_shard(folder / name, manifest.shards[name])
        lacking = [column for column in (SIGNALS, BASE, *wanted) if column not in arrays]
        if lacking:
            raise ReadError(f"{folder / name}: has no {', '.join(lacking)}: {_AGAIN}")
        chosen = slice(None) if split is None else split_of(arrays[BASE]) == split
        rows = arrays[SIGNALS][chosen]
        signals[end : end + len(rows)] = rows
        end += len(rows)
        parts.append({column: arrays[column][chosen] for column in wanted})
    labels = {column: np.concatenate([part[column] for part in parts]) for column in wanted}
    return Dataset(signals[:end], labels, _origin(folder, manifest, split))


def _begin(folder: Path, asked: Manifest) -> tuple[Manifest, list[int]]:
    """The manifest to go on from, and the numbers of the shards that are missing. Raises WriteError, ReadError."""
    make_folder(folder)
    if not (folder / MANIFEST).exists():
        if any(folder.glob("shard-*.npz")):
            raise WriteError(f"{folder}: holds shards but no {MANIFEST}: name another folder")
        return asked, list(range(len(asked.names)))
    stored = read_manifest(folder)
    _check_same(folder, stored, asked)
    for left in (*folder.glob(".shard-*.npz"), *folder.glob(f".{Path(MANIFEST).stem}.*.json")):
        left.unlink(missing_ok=True)  # half written when a run was killed
    shards = {}
    missing = []
    for number, name in enumerate(asked.names):
        shard = stored.shards.get(name)
        # The last shard may have been a shorter one.
        if shard and shard.strands == asked.part(number)[1] and _digest_or_none(folder / name) == shard.sha256:
            shards[name] = shard
        else:
            missing.append(number)
    return replace(stored, count=asked.count, shards=shards), missing


def _plain(options: VariantOptions) -> dict[str, Any]:
    """Options as a manifest gives them back."""
    plain: dict[str, Any] = json.loads(json.dumps(asdict(options)))
    return plain


def _check_same(folder: Path, stored: Manifest, asked: Manifest) -> None:
    """Raise WriteError where a folder's data set is not one that the one asked for goes on with."""
    mine = {"seed": asked.seed, "strands a shard": asked.shard_strands, **asked.options}
    theirs = {"seed": stored.seed, "strands a shard": stored.shard_strands, **stored.options}
    differing = [name for name in {**mine, **theirs} if mine.get(name) != theirs.get(name)]
    if differing:
        said = ", ".join(f"{name.replace('_', ' ')} {theirs.get(name)}, not {mine.get(name)}" for name in differing)
        raise WriteError(f"{folder}: holds another data set ({said}): name another folder")
    if stored.count > asked.count:
        raise WriteError(
            f"{folder}: holds a data set of {stored.count:,} strands, more than {asked.count:,}: name another folder"
        )


def _made(
    jobs: Sequence[tuple[int, int, int]], seed: int, options: VariantOptions, workers: int, make: Make
) -> Generator[tuple[int, NDArray[np.float32], Labels], None, None]:
    """Shards of jobs (number, first, strands) as they get done, in any order. To be closed: it ends the processes."""
    workers = min(workers, len(jobs))
    if workers == 1:
        for number, first, strands in jobs:
            yield number, *make(first, strands, seed, options)
        return
    others = set(multiprocessing.active_children())
    # Not threads: kernels that run on several threads cannot be called from several, with numba's own scheduler. Not
    # forked: a child of a process that has threads may wait for ever.
    context = multiprocessing.get_context("spawn")
    share = max(1, thread_count() // workers)
    with ProcessPoolExecutor(workers, context, _begin_worker, (share,)) as pool:
        try:
            with _interrupts_held():
                futures = {pool.submit(make, first, strands, seed, options): number for number, first, strands in jobs}
            for future in as_completed(tuple(futures)):
                yield futures.pop(future), *future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in set(multiprocessing.active_children()) - others:
                child.terminate()
            raise


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Keep Ctrl-C for later: processes started in here never hear it, even while they are still being set up."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_worker(threads: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()
    set_threads(threads)


def _end_with_parent() -> None:
    """End this process when the one that started it is killed, and so could not end it."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _put(folder: Path, manifest: Manifest, number: int, signals: NDArray[np.float32], labels: Labels) -> Manifest:
    """Write a shard, then the manifest that tells of it. Raises WriteError."""
    cells = manifest.options["cells"]
    if signals.dtype != np.float32 or signals.shape[1:] != (cells, 3) or BASE not in labels:
        raise ValueError(f"signals {signals.shape} of {signals.dtype} or labels {', '.join(labels)} are not a shard's")
    uneven = [name for name, column in labels.items() if len(column) != len(signals)]
    if uneven:
        raise ValueError(f"not one value a signal: {', '.join(uneven)}")
    columns = tuple(labels)
    if manifest.columns and manifest.columns != columns:
        raise WriteError(
            f"{folder}: was begun with columns {', '.join(manifest.columns)}, and this version makes "
            f"{', '.join(columns)}: name another folder"
        )
    name = manifest.names[number]
    try:
        with replacing(folder / name) as beside:
            write_arrays(beside, {SIGNALS: signals, **labels})
            digest = _digest(beside)
        shard = Shard(manifest.part(number)[1], len(signals), digest)
        longer = replace(manifest, columns=columns, shards={**manifest.shards, name: shard})
        _write_manifest(folder, longer)
    except WriteError as error:
        raise WriteError(f"{error}; {manifest.how_far}: the same again goes on from there") from error
    return longer


def _write_manifest(folder: Path, manifest: Manifest) -> None:
    contents = {"format": FORMAT, "version": VERSION, **asdict(manifest)}
    contents["shards"] = {name: asdict(shard) for name, shard in sorted(manifest.shards.items())}
    with replacing(folder / MANIFEST) as beside:
        beside.write_text(json.dumps(contents, indent=1) + "\n", encoding="utf-8")


def _read_shard(path: Path, shard: Shard) -> Labels:
    """All arrays of a shard. Raises ReadError where it is not the one that the manifest tells of."""
    try:
        if _digest(path) != shard.sha256:
            raise ReadError(f"{path}: damaged (its SHA-256 is not the manifest's): {_AGAIN}")
        return read_arrays(path)
    except FileNotFoundError:
        raise ReadError(f"{path}: missing: {_AGAIN}") from None
    except DAMAGE as error:
        raise ReadError(f"{path}: cannot be read ({error}): {_AGAIN}") from error


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def _digest_or_none(path: Path) -> str | None:
    try:
        return _digest(path)
    except OSError:
        return None


def _origin(folder: Path, manifest: Manifest, split: int | None) -> dict[str, Any]:
    together = "".join(manifest.shards[name].sha256 for name in manifest.names)
    return {
        "folder": folder.name,
        "count": manifest.count,
        "seed": manifest.seed,
        "options": manifest.options,
        "split": "all" if split is None else SPLIT_NAMES[split],
        "commits": list(manifest.commits),
        "sha256": hashlib.sha256(together.encode()).hexdigest(),
    }
