"""Grooms in files: one module a format, loaded when such a file is first touched."""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np

from detangled.axes import AXES, MEASURED, role_of, turned
from detangled.errors import DetangledError, ReadError, WriteError
from detangled.groom import Attribute, Groom
from detangled.units import cm_per_unit, guess_unit

# A reader gives lengths as they stand in the file, and sets ``unit_cm`` with ``unit_source="file"`` where the
# file says its unit. A writer gets lengths as they are to stand in the file, and says what it could not keep.
Reader = Callable[[Path], Groom]
Writer = Callable[[Groom, Path], list[str]]

_MODULES = {
    ".abc": "detangled.formats.abc",
    ".data": "detangled.formats.data",
    ".hair": "detangled.formats.hair",
    ".npz": "detangled.formats.npz",
    ".obj": "detangled.formats.obj",
    ".ply": "detangled.formats.ply",
    ".tfx": "detangled.formats.tfx",
    ".usd": "detangled.formats.usd",
    ".usda": "detangled.formats.usd",
    ".usdc": "detangled.formats.usd",
}
_NAMES = {
    ".abc": "Alembic",
    ".data": "USC-HairSalon strands",
    ".hair": "Cem Yuksel's hair",
    ".npz": "NumPy archive",
    ".obj": "Wavefront OBJ",
    ".ply": "PLY strands",
    ".tfx": "TressFX",
    ".usd": "USD",
    ".usda": "USD, text",
    ".usdc": "USD, binary",
}
# What a format needs beyond the plain install: the module, and the extra that brings it.
_EXTRAS = {"pxr": "usd"}
_UNIT_WORDS = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}
_registered: dict[str, tuple[Reader | None, Writer | None]] = {}


def register(suffixes: Iterable[str], reader: Reader | None, writer: Writer | None) -> None:
    """Make ``read`` and ``write`` use these functions for file names that end in one of ``suffixes``."""
    for suffix in suffixes:
        _registered[suffix.lower()] = (reader, writer)


def suffixes() -> list[str]:
    """Suffixes that can be read or written, sorted."""
    return sorted({*_MODULES, *_registered})


def format_name(path: str | os.PathLike[str]) -> str:
    """What files of this suffix are called, as people know them; the suffix itself where it has no name here."""
    suffix = Path(path).suffix.lower()
    return _NAMES.get(suffix, suffix)


def read(
    path: str | os.PathLike[str], unit: str | None = None, up: str | None = None, file_up: str | None = None
) -> Groom:
    """Read a groom, with lengths in cm.

    path: a file whose suffix is one of ``suffixes()``.
    unit: name of the file's unit (``detangled.units.CM_PER_UNIT``); by default what the file says, else the
        unit in which it would be nearest to the size of a head of hair, with a note.
    up: the axis to have up, ``"x"``, ``"y"`` or ``"z"``: points and directions are turned until it is
        (``detangled.axes.turned``); by default they stay as they are in the file, and ``Groom.up`` says how that is.
    file_up: the axis that points up in the file; by default what the file says, else what its format is used with.
    Raises ReadError where the file is missing, not what its suffix says, damaged, or holds no strands.
    """
    path = Path(path)
    for axis in (up, file_up):
        if axis not in (None, *AXES):
            raise ReadError(f"{axis!r} is no axis that could point up: use x, y or z")
    reader = _functions(path, ReadError)[0]
    if reader is None:
        raise ReadError(f"{path}: files ending in {path.suffix} can be written, not read")
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise ReadError(f"{path}: a folder, not a file")
        if status.st_size == 0 and stat.S_ISREG(status.st_mode):
            raise ReadError(f"{path}: the file is empty (0 bytes)")
        groom = reader(path)
    except FileNotFoundError:
        raise ReadError(f"{path}: no such file") from None
    except OSError as error:
        raise ReadError(f"{path}: cannot be read: {error.strerror or error}") from error
    except MemoryError as error:
        raise ReadError(f"{path}: asks for more memory than there is") from error
    if groom.strand_count == 0:
        raise ReadError(f"{path}: holds no strands")
    if file_up is not None:
        groom = replace(groom, up=file_up)
    groom = _in_cm(groom, unit)
    return groom if up is None else turned(groom, up)


def write(groom: Groom, path: str | os.PathLike[str]) -> list[str]:
    """Write a groom in its own unit (``groom.unit_cm``), and return sentences that say what was not kept.

    The file is whole or as it was before: it is written beside its target and renamed.
    Raises WriteError where the suffix is not known or the file cannot be written.
    """
    path = Path(path)
    writer = _functions(path, WriteError)[1]
    if writer is None:
        raise WriteError(f"{path}: files ending in {path.suffix} can be read, not written")
    with replacing(path) as beside:
        return writer(in_file_units(groom), beside)


def in_file_units(groom: Groom) -> Groom:
    """The groom with lengths as they are to stand in a file of its unit."""
    return _scaled(groom, lambda lengths: lengths / groom.unit_cm) if groom.unit_cm != 1.0 else groom


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise the WriteError that ``write`` would end in for a wrong suffix or folder, before hours of work."""
    path = Path(path)
    if _functions(path, WriteError)[1] is None:
        raise WriteError(f"{path}: files ending in {path.suffix} can be read, not written")
    check_folder(path)


def check_folder(path: Path) -> None:
    """Raise the WriteError that writing a file to a missing or protected folder would end in."""
    target = _target_of(path)
    if not os.access(target.parent, os.W_OK):
        raise WriteError(f"{path}: the folder {target.parent} cannot be written to")


def _target_of(path: Path) -> Path:
    """What a link points to is replaced, not the link. Raises WriteError where there is no folder for it."""
    target = Path(os.path.realpath(path))
    # Names that are too long for any file are none here, where pathlib raises.
    if os.path.isdir(target):
        raise WriteError(f"{path}: a folder, not a file")
    if not os.path.isdir(target.parent):
        raise WriteError(f"{path}: the folder {target.parent} does not exist")
    try:
        target.lstat()
    except FileNotFoundError:
        pass
    except OSError as error:
        raise WriteError(f"{path}: cannot be written: {error.strerror or error}") from error
    return target


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a new file beside ``path`` that takes its place at the end, or vanishes where anything goes wrong.

    Raises WriteError where the folder is missing or cannot be written to. A WriteError from within that speaks of the
    new file speaks of ``path`` instead.
    """
    target = _target_of(path)
    beside = target.parent / f".{target.stem}.{secrets.token_hex(4)}{target.suffix}"
    try:
        try:
            os.close(os.open(beside, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
            if target.exists():
                beside.chmod(stat.S_IMODE(target.stat().st_mode) | stat.S_IWUSR)
            yield beside
            os.replace(beside, target)
        except OSError as error:
            raise WriteError(f"{path}: cannot be written: {error.strerror or error}") from error
        except WriteError as error:
            said = str(error).replace(str(beside), str(path)).replace(beside.name, path.name)
            if said == str(error):
                raise
            raise WriteError(said) from error
    except BaseException:
        # Interrupts too: nothing half written stays behind.
        with suppress(OSError):
            beside.unlink()
        raise


def _functions(path: Path, error: type[DetangledError]) -> tuple[Reader | None, Writer | None]:
    suffix = path.suffix.lower()
    if suffix not in _registered and suffix in _MODULES:
        try:
            import_module(_MODULES[suffix])
        except ModuleNotFoundError as missing:
            extra = _EXTRAS.get((missing.name or "").partition(".")[0])
            if extra is None:
                raise
            raise error(
                f"{path}: {suffix} files need a library that is not installed: pip install 'detangled[{extra}]'"
            ) from missing
    if suffix not in _registered:
        said = f"files ending in {path.suffix}" if suffix else "files without a suffix"
        raise error(f"{path}: {said} are not known; these are: {', '.join(suffixes())}")
    return _registered[suffix]


def _in_cm(groom: Groom, unit: str | None) -> Groom:
    if unit is not None:
        groom = replace(groom, unit_cm=cm_per_unit(unit), unit_source="given")
    elif groom.unit_source != "file":
        # Squares of what a file can hold may be beyond what a float can.
        with np.errstate(over="ignore"):
            guess = guess_unit(groom.points)
        sized = guess != "cm" or _has_size(groom.points)
        reason = "from its size" if sized else "since it has no size to go by"
        note = f"taken as {_UNIT_WORDS[guess]} {reason}; --unit says otherwise"
        source = "size" if sized else "default"
        groom = replace(groom, unit_cm=cm_per_unit(guess), unit_source=source, notes=(*groom.notes, note))
    unit_cm = groom.unit_cm
    return _scaled(groom, lambda lengths: lengths * unit_cm) if unit_cm != 1.0 else groom


def _has_size(points: np.ndarray) -> bool:
    """Whether two finite points differ."""
    finite = points[np.isfinite(points).all(axis=1)]
    return len(finite) > 0 and bool(np.any(finite != finite[0]))


def _scaled(groom: Groom, scale: Callable[[np.ndarray], np.ndarray]) -> Groom:
    # In float64 a product and a quotient by the same unit give float32 values back to the bit.
    attributes = {
        name: Attribute(scale(a.values.astype(np.float64)), a.scope) if role_of(name, a) in MEASURED else a
        for name, a in groom.attributes.items()
    }
    return replace(groom, points=scale(groom.points), attributes=attributes)
