"""Values of Alembic properties to NumPy arrays and back, whole arrays wherever the bindings allow it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import imath
import numpy as np
from alembic3d import Abc, AbcGeom, Util
from numpy.typing import NDArray

from detangled.groom import Scope

# What the bindings raise, beside RuntimeError for C++ exceptions: wrong types, texts that are not UTF-8, odd
# sizes.
BINDING_ERRORS = (RuntimeError, TypeError, ValueError, IndexError, OverflowError, AttributeError, MemoryError)

_DTYPES: dict[Any, Any] = {
    Util.POD.kBooleanPOD: np.bool_,
    Util.POD.kInt8POD: np.int8,
    Util.POD.kUint8POD: np.uint8,
    Util.POD.kInt16POD: np.int16,
    Util.POD.kUint16POD: np.uint16,
    Util.POD.kInt32POD: np.int32,
    Util.POD.kUint32POD: np.uint32,
    Util.POD.kInt64POD: np.int64,
    Util.POD.kUint64POD: np.uint64,
    Util.POD.kFloat16POD: np.float16,
    Util.POD.kFloat32POD: np.float32,
    Util.POD.kFloat64POD: np.float64,
    Util.POD.kStringPOD: np.str_,
    Util.POD.kWstringPOD: np.str_,
}
_SCOPES = {
    "con": Scope.GROOM,
    "uni": Scope.STRAND,
    "var": Scope.POINT,
    "vtx": Scope.POINT,
    "fvr": Scope.POINT,
}
GEOMETRY_SCOPES = {
    Scope.GROOM: AbcGeom.GeometryScope.kConstantScope,
    Scope.STRAND: AbcGeom.GeometryScope.kUniformScope,
    Scope.POINT: AbcGeom.GeometryScope.kVertexScope,
}
# Names by which an attribute of three or four floats is a colour rather than a vector.
_COLOUR_WORDS = ("color", "colour", "rgb")
_COLOUR_NAMES = ("Cd", "Cs")


@dataclass(frozen=True)
class Value:
    """An attribute's values (n, ...) and the scope that the file gives it, None where it gives none."""

    values: NDArray[Any]
    scope: Scope | None


def read_property(parent: Any, header: Any) -> Value | None:
    """Read the first sample of a scalar, array or geometry parameter; None where it has no sample.

    Raises one of BINDING_ERRORS for what cannot be read.
    """
    name = header.getName()
    metadata = header.getMetaData()
    scope = _SCOPES.get(metadata.get("geoScope"))
    if header.isCompound():
        values = _indexed(Abc.ICompoundProperty(parent, name))
    elif header.isScalar():
        values = _scalar(Abc.IScalarProperty(parent, name))
        scope = Scope.GROOM
    else:
        values = array_values(parent, name)
    if values is None:
        return None
    extent = int(metadata.get("arrayExtent") or 1)
    if extent > 1:
        values = values.reshape(-1, extent, *values.shape[1:])
    return Value(values, scope)


def array_values(parent: Any, name: str) -> NDArray[Any] | None:
    """Copy the first sample of an array property, (n,) or (n, extent); None where it has none."""
    array = Abc.IArrayProperty(parent, name)
    if array.getNumSamples() == 0:
        return None
    data_type = array.getHeader().getDataType()
    extent, dtype = data_type.getExtent(), _DTYPES[data_type.getPod()]
    if data_type.getPod() == Util.POD.kFloat32POD and extent == 3:
        # Colours come without a buffer, hence value by value: take every triple as a vector.
        array = Abc.IV3fArrayProperty(parent, name, Abc.Argument(Abc.SchemaInterpMatching.kNoMatching))
    sample = array.samples[0]
    shape = (len(sample),) if extent == 1 else (len(sample), extent)
    if len(sample) == 0:
        return np.empty(shape, dtype=dtype)
    if isinstance(sample, imath.C4fArray | imath.C4cArray):
        return np.stack([np.asarray(part) for part in (sample.r, sample.g, sample.b, sample.a)], axis=1)
    if isinstance(sample, imath.C3cArray):
        return np.stack([np.asarray(part) for part in (sample.r, sample.g, sample.b)], axis=1)
    values = np.asarray(sample)
    if values.dtype == object:
        raise TypeError(f"values of type {data_type} cannot be read")
    # A copy: the bindings' memory goes with the archive.
    return np.array(values.reshape(shape), dtype=None if dtype is np.str_ else dtype)


def write_parameter(parent: Any, name: str, values: NDArray[Any], scope: Scope) -> list[str]:
    """Write values (n, ...) as a geometry parameter; return a sentence where a part of them was not kept."""
    changed = []
    if values.ndim > 2:
        changed.append(f"attribute {name!r}: the shape {values.shape[1:]} of its values was laid flat")
        values = values.reshape(len(values), -1)
    plain = _storable(values)
    if plain is None:
        return [f"attribute {name!r} was not kept: Alembic has no place for {values.dtype} values"]
    if plain.ndim == 2 and plain.shape[1] == 0:
        return [f"attribute {name!r} was not kept: it has no values"]
    kind, array, extent = _to_imath(name, plain)
    geometry_scope = GEOMETRY_SCOPES[scope]
    parameter = getattr(AbcGeom, f"O{kind}GeomParam")(parent, name, False, geometry_scope, extent)
    parameter.set(getattr(AbcGeom, f"O{kind}GeomParamSample")(array, geometry_scope))
    return changed


def filled(array_type: Any, values: NDArray[Any]) -> Any:
    """An imath array of a type that gives out its memory, with these values cast to its own."""
    array = array_type(len(values))
    if len(values):
        # Numbers too large for float32 become infinite.
        with np.errstate(over="ignore"):
            np.asarray(array)[...] = values
    return array


def _indexed(compound: Any) -> NDArray[Any] | None:
    values, indices = array_values(compound, ".vals"), array_values(compound, ".indices")
    if values is None or indices is None:
        return None
    if len(indices) and int(indices.max()) >= len(values):
        raise ValueError("its indices lead beyond its values")
    return values[indices.astype(np.int64)]


def _scalar(scalar: Any) -> NDArray[Any] | None:
    if scalar.getNumSamples() == 0:
        return None
    data_type = scalar.getHeader().getDataType()
    values = np.asarray(scalar.getValue())
    if values.dtype == object:
        raise TypeError(f"a value of type {data_type} cannot be read")
    dtype = _DTYPES[data_type.getPod()]
    extent = data_type.getExtent()
    return np.array(values.reshape((1,) if extent == 1 else (1, extent)), dtype=None if dtype is np.str_ else dtype)


def _storable(values: NDArray[Any]) -> NDArray[Any] | None:
    """The values in a type that the bindings can write, or None; small integers widen, large must fit."""
    kind, size = values.dtype.kind, values.dtype.itemsize
    if kind == "b" or values.dtype in (np.uint8, np.int32, np.float16, np.float32, np.float64):
        return values
    if kind in "iu" and size <= 2:
        return values.astype(np.int32)
    if kind in "iu":
        low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
        if low >= np.iinfo(np.int32).min and high <= np.iinfo(np.int32).max and values.dtype != np.uint32:
            return values.astype(np.int32)
        return values.astype(np.uint32) if low >= 0 and high <= np.iinfo(np.uint32).max else None
    if kind == "f":
        return values.astype(np.float64)
    if kind == "S":
        return np.char.decode(values, "utf-8", "replace")
    return values if kind == "U" else None


def _to_imath(name: str, values: NDArray[Any]) -> tuple[str, Any, int]:
    """The parameter's kind, its imath array, and values an element (array extent)."""
    width = 1 if values.ndim == 1 else values.shape[1]
    vectors = {(np.float32, 2): "V2f", (np.float64, 2): "V2d", (np.int32, 2): "V2i"} | {
        (np.float32, 3): "V3f",
        (np.float64, 3): "V3d",
        (np.int32, 3): "V3i",
    }
    vector = vectors.get((values.dtype.type, width))
    if vector == "V3f" and (name in _COLOUR_NAMES or any(word in name.lower() for word in _COLOUR_WORDS)):
        return "C3f", imath.C3fArray(filled(imath.V3fArray, values)), 1
    if vector is not None:
        return vector, filled(getattr(imath, f"{vector}Array"), values), 1
    flat = np.ascontiguousarray(values).ravel()
    if flat.dtype == np.bool_:
        bools = imath.BoolArray(False, len(flat))
        if len(flat):
            bools[filled(imath.IntArray, flat)] = True
        return "Boolean", bools, width
    if flat.dtype == np.uint32:
        return "UInt32", imath.UnsignedIntArray(filled(imath.DoubleArray, flat)), width
    if flat.dtype.kind == "U":
        texts = imath.StringArray(len(flat))
        # The bindings take texts one by one only.
        for index, text in enumerate(flat.tolist()):
            texts[index] = text
        return "String", texts, width
    kind, array_type = {
        "u1": ("Uchar", imath.UnsignedCharArray),
        "i4": ("Int32", imath.IntArray),
        "f2": ("Half", imath.FloatArray),
        "f4": ("Float", imath.FloatArray),
        "f8": ("Double", imath.DoubleArray),
    }[f"{flat.dtype.kind}{flat.dtype.itemsize}"]
    return kind, filled(array_type, flat), width
