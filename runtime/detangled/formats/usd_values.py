"""Values of USD attributes to NumPy arrays and back, and USD's own complaints kept off the terminal."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Tf, UsdGeom, UsdUtils, Vt

from detangled.groom import Scope

# What the bindings raise, for damaged files and for values that they cannot turn.
BINDING_ERRORS = (Tf.ErrorException, RuntimeError, TypeError, ValueError, OverflowError, MemoryError)

_ORIGIN = re.compile(r"(Error|Warning|Runtime Error|Coding Error) in '[^']*' at line \d+ in file \S+ : ")
LONGEST_SAID = 300
_TEXTS = (str, Sdf.AssetPath)
_QUATERNIONS = (Gf.Quath, Gf.Quatf, Gf.Quatd)
_COLOUR_WORDS = ("color", "colour", "rgb", "Cd", "Cs")
_NAMES = {"b1": "Bool", "u1": "UChar", "i4": "Int", "u4": "UInt", "i8": "Int64", "u8": "UInt64"} | {
    "f2": "Half",
    "f4": "Float",
    "f8": "Double",
}
_VECTORS = {"i4": "Int", "f2": "Half", "f4": "Float", "f8": "Double"}
INTERPOLATIONS = {
    Scope.GROOM: UsdGeom.Tokens.constant,
    Scope.STRAND: UsdGeom.Tokens.uniform,
    Scope.POINT: UsdGeom.Tokens.vertex,
}


@contextmanager
def complaints() -> Iterator[list[str]]:
    """What USD warns of meanwhile, as a list that is filled at the end, instead of lines on stderr."""
    delegate = UsdUtils.CoalescingDiagnosticDelegate()
    said: list[str] = []
    try:
        yield said
    finally:
        said += [entry.commentary for entry in delegate.TakeUncoalescedDiagnostics()]


def one_line(text: str) -> str:
    """What USD says, without where in its own sources it says it."""
    plain = " ".join(_ORIGIN.sub("", " ".join(text.split())).split())
    return plain if len(plain) <= LONGEST_SAID else plain[:LONGEST_SAID] + " ..."


def to_array(value: Any) -> NDArray[Any] | None:
    """The values of an array, (n, ...), or of a single one, (1, ...); None where they are neither numbers nor texts.

    Quaternions come as real part, i, j, k.
    """
    if isinstance(value, str | Sdf.AssetPath | bool | int | float | Gf.Quath | Gf.Quatf | Gf.Quatd):
        value = [value]
    elif type(value).__module__.startswith("pxr.Gf"):
        return np.array(value)[None]
    if len(value) and isinstance(value[0], _TEXTS):
        return np.array([v.path if isinstance(v, Sdf.AssetPath) else v for v in value], dtype=np.str_)
    if len(value) and isinstance(value[0], _QUATERNIONS):
        return np.array([[v.GetReal(), *v.GetImaginary()] for v in value])
    values = np.array(value)
    return values if values.dtype.kind in "biufU" and values.ndim else None


def stored(name: str, values: NDArray[Any]) -> tuple[Any, Any, int] | None:
    """How USD holds values (n, ...): their type name, their array, and numbers an element; None where it cannot.

    Small integers widen; values of more numbers than USD has a type for are laid flat.
    """
    plain = _storable(values)
    if plain is None:
        return None
    plain = bare(plain)
    size = int(np.prod(plain.shape[1:], dtype=int))
    if size == 0:
        return None
    if plain.dtype.kind == "U":
        return Sdf.ValueTypeNames.StringArray, Vt.StringArray(plain.ravel().tolist()), size
    code = f"{plain.dtype.kind}{plain.dtype.itemsize}"
    if plain.shape[1:] == (4, 4) and code == "f8":
        return Sdf.ValueTypeNames.Matrix4dArray, Vt.Matrix4dArray.FromNumpy(plain), 1
    if plain.ndim == 2 and 2 <= size <= 4 and code in _VECTORS:
        short = {"i4": "i", "f2": "h", "f4": "f", "f8": "d"}[code]
        array = getattr(Vt, f"Vec{size}{short}Array").FromNumpy(plain)
        return getattr(Sdf.ValueTypeNames, f"{_role(name, code, size)}Array"), array, 1
    flat = plain.ravel()
    return (
        getattr(Sdf.ValueTypeNames, f"{_NAMES[code]}Array"),
        getattr(Vt, f"{_NAMES[code]}Array").FromNumpy(flat),
        size,
    )


def bare(values: NDArray[Any]) -> NDArray[Any]:
    """The values in the machine's own byte order, one after another and in step with its words, as USD takes them."""
    return np.require(values, dtype=values.dtype.newbyteorder("="), requirements=["C", "A"])


def _role(name: str, code: str, size: int) -> str:
    """The name of a vector's type, which says what it is for: a colour, a texture coordinate, a normal or none."""
    suffix = {"f2": "h", "f4": "f", "f8": "d"}.get(code, "")
    if suffix and size in (3, 4) and any(word in name or word in name.lower() for word in _COLOUR_WORDS):
        return f"Color{size}{suffix}"
    if suffix and size == 2 and name.lower() in ("uv", "st"):
        return f"TexCoord2{suffix}"
    if suffix and size == 3 and name in ("N", "normals"):
        return f"Normal3{suffix}"
    return f"{_VECTORS[code]}{size}"


def _storable(values: NDArray[Any]) -> NDArray[Any] | None:
    kind, size = values.dtype.kind, values.dtype.itemsize
    if kind == "b" or values.dtype in (np.uint8, np.int32, np.uint32, np.int64, np.uint64):
        return values
    if kind in "iu" and size <= 2:
        return values.astype(np.int32)
    if kind == "f":
        return values if size <= 8 else values.astype(np.float64)
    if kind == "S":
        return np.char.decode(values, "utf-8", "replace")
    return values if kind == "U" else None
