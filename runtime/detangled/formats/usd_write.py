"""USD (.usd, .usdc, .usda): linear BasisCurves, one prim for each object, and their attributes as primvars."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, Vt

from detangled.errors import WriteError
from detangled.formats import objects
from detangled.formats.blocks import as_float32
from detangled.formats.usd_values import BINDING_ERRORS, INTERPOLATIONS, bare, complaints, one_line, stored
from detangled.groom import Attribute, Groom, Scope

ROOT = "groom"
CM_PER_METRE = 100.0
DEFAULT_UP = "y"
UP_AXES = ("y", "z")
# Where a name stands that USD cannot take: in the custom data of the prim or primvar.
NAME_KEY = "detangled:name"


def write(groom: Groom, path: Path) -> list[str]:
    """Write a groom whose lengths are in the file's unit. Raises WriteError where the library fails.

    The text form for .usda, else the binary one. The root is an Xform ``groom``, the default prim.
    """
    lost: list[str] = []
    try:
        with complaints() as said:
            layer = Sdf.Layer.CreateAnonymous(f".{'usda' if path.suffix.lower() == '.usda' else 'usdc'}")
            _fill(Usd.Stage.Open(layer), groom, lost)
            whole = layer.Export(str(path))
    except BINDING_ERRORS as error:
        raise WriteError(f"{path}: USD could not write it: {one_line(str(error))}") from error
    if not whole or path.stat().st_size == 0:
        raise WriteError(f"{path}: USD could not write it{': ' if said else ''}{one_line('; '.join(said))}")
    # One sentence about an attribute, however many objects have it.
    return list(dict.fromkeys(lost))


def _fill(stage: Any, groom: Groom, lost: list[str]) -> None:
    UsdGeom.SetStageMetersPerUnit(stage, groom.unit_cm / CM_PER_METRE)
    UsdGeom.SetStageUpAxis(stage, (groom.up if groom.up in UP_AXES else DEFAULT_UP).upper())
    if groom.up not in UP_AXES:
        lost.append(f"{groom.up} stays up, but USD knows y and z alone: it will be taken as {DEFAULT_UP}")
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, f"/{ROOT}").GetPrim())
    owner = objects.owners(groom)
    if np.any(np.diff(owner) < 0):
        lost.append("strands were put in the order of their objects")
    taken: set[str] = set()
    for index, name in enumerate(groom.objects):
        part = groom.select(np.flatnonzero(owner == index)) if len(groom.objects) > 1 else groom
        valid = _unique(Tf.MakeValidIdentifier(name), taken)
        curves = UsdGeom.BasisCurves.Define(stage, f"/{ROOT}/{valid}")
        if valid != name:
            curves.GetPrim().SetCustomDataByKey(NAME_KEY, name)
        _fill_curves(curves, part, lost)


def _fill_curves(curves: Any, groom: Groom, lost: list[str]) -> None:
    points = as_float32(groom.points)
    curves.CreateTypeAttr(UsdGeom.Tokens.linear)
    curves.CreateWrapAttr(UsdGeom.Tokens.nonperiodic)
    curves.CreateCurveVertexCountsAttr(Vt.IntArray.FromNumpy(groom.point_counts.astype(np.int32)))
    curves.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    finite = points if np.isfinite(points).all() else points[np.isfinite(points).all(axis=1)]
    if len(finite):
        # Column by column, since NumPy is many times slower along rows of three.
        box = np.array([[end(finite[:, axis]) for axis in range(3)] for end in (np.min, np.max)], dtype=np.float32)
        curves.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(box))
    taken: set[str] = set()
    for name, attribute in objects.other_attributes(groom).items():
        if not _fill_schema(curves, name, attribute):
            _fill_primvar(UsdGeom.PrimvarsAPI(curves), name, attribute, taken, lost)


def _fill_schema(curves: Any, name: str, attribute: Attribute) -> bool:
    """Put widths, normals and velocities where the schema has a place for them; whether it has."""
    values = attribute.values
    if values.dtype.kind != "f" or values.dtype.itemsize > 8:
        return False
    if name == "width" and values.ndim == 1:
        curves.CreateWidthsAttr(Vt.FloatArray.FromNumpy(as_float32(values)))
        curves.SetWidthsInterpolation(INTERPOLATIONS[attribute.scope])
    elif name == "N" and values.shape[1:] == (3,) and values.dtype == np.float32:
        curves.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(bare(values)))
        curves.SetNormalsInterpolation(INTERPOLATIONS[attribute.scope])
    elif name == "velocities" and values.shape[1:] == (3,) and attribute.scope is Scope.POINT:
        curves.CreateVelocitiesAttr(Vt.Vec3fArray.FromNumpy(as_float32(values)))
    else:
        return False
    return True


def _fill_primvar(primvars: Any, name: str, attribute: Attribute, taken: set[str], lost: list[str]) -> None:
    held = stored(name, attribute.values)
    if held is None:
        lost.append(f"attribute {name!r} was not kept: USD has no place for {attribute.values.dtype} values")
        return
    if attribute.values.ndim > 2 and held[2] > 1:
        lost.append(f"attribute {name!r}: the shape {attribute.values.shape[1:]} of its values was laid flat")
    type_name, array, size = held
    valid = _unique(_primvar_name(name), taken)
    primvar = primvars.CreatePrimvar(valid, type_name, INTERPOLATIONS[attribute.scope], size if size > 1 else -1)
    primvar.Set(array)
    if valid != name:
        primvar.GetAttr().SetCustomDataByKey(NAME_KEY, name)


def _primvar_name(name: str) -> str:
    """A name as USD takes it for a primvar, which unlike a prim may stand in a namespace."""
    valid = ":".join(Tf.MakeValidIdentifier(part) for part in name.split(":"))
    # Primvars that end so hold indices of another.
    if valid == "indices" or valid.endswith(":indices"):
        valid += "_"
    return valid


def _unique(valid: str, taken: set[str]) -> str:
    """The name, or with a number where another has it."""
    unique, number = valid, 1
    while unique in taken:
        number += 1
        unique = f"{valid}_{number}"
    taken.add(unique)
    return unique
