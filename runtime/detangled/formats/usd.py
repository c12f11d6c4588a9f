"""USD (.usd, .usdc, .usda): every BasisCurves prim of a stage, read through usd-core (the package ``pxr``).

The transforms above the curves are applied, smooth curves become polylines, and primvars become attributes. The
file's own words are taken for unit (``metersPerUnit``) and up axis (``upAxis``). Of several time samples the first is
read. A Catmull-Rom curve runs through its points, as Blender writes hair: they are kept as they are, since whatever
is done to strands here draws a curve through their points again.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom

from detangled.errors import ReadError
from detangled.formats import register, usd_check
from detangled.formats.curve_bases import CUBIC_ORDER, SAMPLES_PER_SPAN, SmoothCurves
from detangled.formats.merge import Part, merged
from detangled.formats.transforms import to_world
from detangled.formats.usd_values import BINDING_ERRORS, complaints, one_line, to_array
from detangled.formats.usd_write import CM_PER_METRE, NAME_KEY, write
from detangled.groom import Attribute, Groom, Scope

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

MAGICS = (b"PXR-USDC", b"#usda", b"#sdf")
_SCOPES = {
    UsdGeom.Tokens.constant: Scope.GROOM,
    UsdGeom.Tokens.uniform: Scope.STRAND,
    UsdGeom.Tokens.varying: Scope.POINT,
    UsdGeom.Tokens.vertex: Scope.POINT,
    UsdGeom.Tokens.faceVarying: Scope.POINT,
}
_VARYING = (UsdGeom.Tokens.varying, UsdGeom.Tokens.faceVarying)
# A length in the file is rounded where metres per unit are: 0.0254 m are 2.54 cm.
DIGITS = 12
# A film set holds thousands of other things.
MOST_NAMED = 5


def read(path: Path) -> Groom:
    """Read all curves of a USD file, lengths as they stand in it.

    Raises ReadError where the file is no USD file, is damaged, or holds no curves.
    """
    with open(path, "rb") as file:
        begin = file.read(8)
    if not begin.startswith(MAGICS):
        raise ReadError(f"{path}: no USD file: it begins with neither 'PXR-USDC' nor '#usda'")
    usd_check.check(path)
    try:
        with complaints() as said:
            stage = _stage(path)
            groom = None if stage is None else _read_stage(path, stage)
    except BINDING_ERRORS as error:
        raise ReadError(f"{path}: damaged, or not as USD lays it down: {one_line(str(error))}") from error
    if groom is None:
        raise ReadError(f"{path}: damaged, or not as USD lays it down: {one_line('; '.join(said)) or 'it is empty'}")
    return replace(groom, notes=(*groom.notes, *(f"USD says: {one_line(text)}" for text in dict.fromkeys(said))))


def _stage(path: Path) -> Any:
    # Not by its path, which USD would answer from memory even where the file has changed since.
    layer = Sdf.Layer.OpenAsAnonymous(str(path))
    if layer is None:
        return None
    _check_children(path, layer)
    # Paths of files beside it are relative to its own: then only its path will do.
    return Usd.Stage.Open(str(path) if layer.GetCompositionAssetDependencies() else layer)


def _check_children(path: Path, layer: Any) -> None:
    """Raise ReadError where a layer names children that it does not hold, on which USD would end the process."""
    waiting = [Sdf.Path.absoluteRootPath]
    while waiting:
        at = waiting.pop()
        spec = layer.GetPrimAtPath(at) if at != Sdf.Path.absoluteRootPath else layer.pseudoRoot
        for kind, below in (("primChildren", at.AppendChild), ("properties", at.AppendProperty)):
            for name in spec.GetInfo(kind):
                child = below(name) if Sdf.Path.IsValidNamespacedIdentifier(name) else None
                if child is None or not layer.GetObjectAtPath(child):
                    raise ReadError(f"{path}: damaged: {at} names {name!r}, which the file does not hold")
                if kind == "primChildren":
                    waiting.append(child)


def _read_stage(path: Path, stage: Any) -> Groom:
    transforms = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
    parts, others = [], []
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdGeom.BasisCurves):
            matrix = np.array(transforms.GetLocalToWorldTransform(prim), dtype=np.float64)
            parts.append(_read_curves(path, UsdGeom.BasisCurves(prim), matrix))
        elif prim.IsA(UsdGeom.Gprim):
            others.append(prim.GetName())
    if not parts:
        raise ReadError(f"{path}: holds no BasisCurves{', only ' if others else ''}{', '.join(others[:MOST_NAMED])}")
    more = f" and {len(others) - MOST_NAMED} more" if len(others) > MOST_NAMED else ""
    notes = [f"skipped what is not curves: {', '.join(others[:MOST_NAMED])}{more}"] if others else []
    up = UsdGeom.GetStageUpAxis(stage).lower()
    groom = merged(parts, up=up, notes=tuple(notes))
    metres = UsdGeom.GetStageMetersPerUnit(stage)
    if not UsdGeom.StageHasAuthoredMetersPerUnit(stage):
        return groom
    if not 0.0 < metres < np.inf:
        raise ReadError(f"{path}: its unit (metersPerUnit) is {metres:g} m")
    return replace(groom, unit_cm=float(f"{metres * CM_PER_METRE:.{DIGITS}g}"), unit_source="file")


def _read_curves(path: Path, curves: Any, matrix: Array) -> Part:
    prim = curves.GetPrim()
    told = prim.GetCustomDataByKey(NAME_KEY)
    name = prim.GetName() if told is None else str(told)
    notes = []
    samples = max(curves.GetPointsAttr().GetNumTimeSamples(), 0)
    if samples > 1:
        notes.append(f"{name!r} has {samples} time samples, only the first is kept")
    points = _numbers(curves.GetPointsAttr(), np.float64).reshape(-1, 3)
    counts = _numbers(curves.GetCurveVertexCountsAttr(), np.int64).reshape(-1)
    if np.any(counts < 0) or int(counts.sum()) != len(points):
        below = " and some below 0" if np.any(counts < 0) else ""
        raise ReadError(
            f"{path}: damaged: the curves {name!r} hold {len(points)} points, "
            f"and counts a strand that add up to {int(counts.sum())}{below}"
        )
    wrap = curves.GetWrapAttr().Get() or UsdGeom.Tokens.nonperiodic
    if wrap == UsdGeom.Tokens.periodic:
        notes.append(f"the closed curves of {name!r} were read as open ones")
    linear = curves.GetTypeAttr().Get() == UsdGeom.Tokens.linear
    basis = UsdGeom.Tokens.linear if linear else curves.GetBasisAttr().Get()
    spans = counts - 1 if linear else _spans(counts, basis, wrap)
    found, varying = _attributes(curves, name, counts, spans + 1, notes)
    points, moved = to_world(points, {**found, **varying}, matrix)
    found, varying = {key: moved[key] for key in found}, {key: moved[key] for key in varying}
    if not linear:
        counts, points, found, varying = _smooth(name, basis, wrap, counts, points, found, varying, notes)
    return Part(name, str(prim.GetPath()), points, counts, {**found, **varying}, notes)


def _numbers(attribute: Any, dtype: type) -> NDArray[Any]:
    value = attribute.Get(Usd.TimeCode.EarliestTime()) if attribute.HasValue() else None
    return np.empty(0, dtype=dtype) if value is None else np.array(value, dtype=dtype)


def _attributes(
    curves: Any, name: str, counts: Counts, varying_counts: Counts, notes: list[str]
) -> tuple[dict[str, Attribute], dict[str, Attribute]]:
    """Attributes by name: those at control points, strands or the whole, and those at the ends of spans."""
    found: dict[str, Attribute] = {}
    varying: dict[str, Attribute] = {}
    for key, interpolation, values in _values(curves, name, notes):
        sizes = {Scope.GROOM: 1, Scope.STRAND: len(counts), Scope.POINT: int(counts.sum())}
        scope = _SCOPES.get(interpolation, Scope.GROOM)
        at_ends = interpolation in _VARYING and len(values) == int(varying_counts.sum())
        if key in found or key in varying:
            notes.append(f"a second attribute {key!r} of {name!r} was left out")
        elif at_ends and not np.array_equal(varying_counts, counts):
            varying[key] = Attribute(values, Scope.POINT)
        elif len(values) == sizes[scope]:
            found[key] = Attribute(values, scope)
        else:
            fitting = [scope for scope in (Scope.POINT, Scope.STRAND, Scope.GROOM) if sizes[scope] == len(values)]
            if fitting:
                # By their count, as others read them who write no interpolation.
                found[key] = Attribute(values, fitting[0])
            else:
                notes.append(
                    f"attribute {key!r} of {name!r} was left out: {len(values)} values "
                    f"for {len(counts)} strands of {int(counts.sum())} points"
                )
    return found, varying


def _values(curves: Any, name: str, notes: list[str]) -> Any:
    """Name, interpolation and values (n, ...) of the schema's own attributes and of all primvars."""
    primvars = {p.GetPrimvarName(): p for p in UsdGeom.PrimvarsAPI(curves).FindPrimvarsWithInheritance()}
    schema = (
        ("width", curves.GetWidthsAttr(), curves.GetWidthsInterpolation(), "widths"),
        ("N", curves.GetNormalsAttr(), curves.GetNormalsInterpolation(), "normals"),
        ("velocities", curves.GetVelocitiesAttr(), UsdGeom.Tokens.vertex, ""),
    )
    for key, attribute, interpolation, as_primvar in schema:
        # A primvar of the same name takes precedence (UsdGeomPointBased).
        primvar = primvars.pop(as_primvar, None)
        if primvar is not None and primvar.HasValue():
            yield from _primvar(key, primvar, name, notes)
        elif attribute.HasAuthoredValue():
            values = to_array(attribute.Get(Usd.TimeCode.EarliestTime()))
            if values is not None:
                yield key, interpolation, values
    for key, primvar in primvars.items():
        if primvar.HasAuthoredValue():
            told = primvar.GetAttr().GetCustomDataByKey(NAME_KEY)
            yield from _primvar(key if told is None else str(told), primvar, name, notes)


def _primvar(key: str, primvar: Any, name: str, notes: list[str]) -> Any:
    value = primvar.ComputeFlattened(Usd.TimeCode.EarliestTime())
    values = None if value is None else to_array(value)
    if values is None:
        notes.append(f"attribute {key!r} of {name!r} was left out: it is of the type {primvar.GetTypeName()}")
        return
    size = primvar.GetElementSize()
    if size > 1 and len(values) % size == 0:
        values = values.reshape(-1, size, *values.shape[1:])
    yield key, primvar.GetInterpolation(), values


def _spans(counts: Counts, basis: str, wrap: str) -> Counts:
    """How many pieces each smooth curve has (UsdGeomBasisCurves), (S,); curves too short for one have one."""
    if basis == UsdGeom.Tokens.bezier:
        return np.maximum((counts - 1) // 3, 1)
    return np.maximum(counts - 1 if wrap == UsdGeom.Tokens.pinned else counts - 3, 1)


def _smooth(
    name: str,
    basis: str,
    wrap: str,
    counts: Counts,
    points: Array,
    found: dict[str, Attribute],
    varying: dict[str, Attribute],
    notes: list[str],
) -> tuple[Counts, Array, dict[str, Attribute], dict[str, Attribute]]:
    """Turn smooth curves, and the attributes on them, into polylines."""
    kept = {key: a for key, a in found.items() if a.scope is not Scope.POINT}
    on_points = {key: a for key, a in found.items() if a.scope is Scope.POINT}
    if basis == UsdGeom.Tokens.catmullRom:
        notes.append(f"{name!r} are Catmull-Rom curves: read by the points they run through")
        if wrap == UsdGeom.Tokens.pinned:
            return counts, points, found, varying
        # The first and the last point only set the direction there; curves of fewer than four have no piece.
        first = np.cumsum(counts) - counts
        inner = np.ones(len(points), dtype=bool)
        long = counts >= CUBIC_ORDER
        inner[first[long]] = False
        inner[(first + counts - 1)[long]] = False
        within = {key: Attribute(a.values[inner], a.scope) for key, a in on_points.items()}
        ends = _spans(counts, basis, wrap) + 1
        counts = np.where(long, counts - 2, counts)
        if not np.array_equal(ends, counts):
            notes += [
                f"attribute {key!r} of {name!r} was left out: its values do not fit curves of fewer than four points"
                for key in varying
            ]
            varying = {}
        return counts, points[inner], kept | within, varying
    floats = {key: a for key, a in on_points.items() if a.values.dtype.kind == "f"}
    notes += [
        f"attribute {key!r} of {name!r} was left out: it has no values between control points"
        for key in on_points.keys() - floats.keys()
    ]
    channels = [points, *(a.values.reshape(len(points), -1).astype(np.float64) for a in floats.values())]
    table = np.concatenate(channels, axis=1)
    ends = counts
    if basis == UsdGeom.Tokens.bspline and wrap == UsdGeom.Tokens.pinned:
        ends, table = _with_phantoms(counts, table)
    orders = np.full(len(counts), CUBIC_ORDER, dtype=np.int64)
    made, values, _ = SmoothCurves(ends, str(basis), orders, np.empty(0), np.empty(0)).to_polylines(table)
    begin = 3
    for (key, attribute), channel in zip(floats.items(), channels[1:], strict=True):
        own = values[:, begin : begin + channel.shape[1]].reshape(len(values), *attribute.values.shape[1:])
        kept[key] = Attribute(own.astype(attribute.values.dtype), Scope.POINT)
        begin += channel.shape[1]
    spread = _between_ends(_spans(counts, basis, wrap) + 1, made, varying, name, notes)
    notes.append(f"{name!r} are {basis} curves: evaluated into polylines of {len(values)} points")
    return made, values[:, :3], kept, spread


def _with_phantoms(counts: Counts, table: Array) -> tuple[Counts, Array]:
    """Pinned curves with the mirrored neighbour beyond each end that lets them begin and end at their points."""
    long = counts >= 2
    first = np.cumsum(counts) - counts
    last = first + counts - 1
    made = np.where(long, counts + 2, counts)
    begin = np.cumsum(made) - made
    result = np.empty((int(made.sum()), table.shape[1]))
    row = np.arange(len(table)) + np.repeat(begin + long - first, counts)
    result[row] = table
    with np.errstate(all="ignore"):
        result[begin[long]] = 2 * table[first[long]] - table[first[long] + 1]
        result[(begin + made - 1)[long]] = 2 * table[last[long]] - table[last[long] - 1]
    return made, result


def _between_ends(
    ends: Counts, made: Counts, varying: dict[str, Attribute], name: str, notes: list[str]
) -> dict[str, Attribute]:
    """Values at the ends of spans, spread linearly over the points of evaluated curves."""
    spread: dict[str, Attribute] = {}
    fits = np.array_equal(made, (ends - 1) * SAMPLES_PER_SPAN + 1)
    for key, attribute in varying.items():
        values = attribute.values
        if values.dtype.kind != "f" or not fits:
            notes.append(f"attribute {key!r} of {name!r} was left out: it has no values between the ends of spans")
            continue
        begin = np.cumsum(made) - made
        step = np.arange(int(made.sum())) - np.repeat(begin, made)
        low = step // SAMPLES_PER_SPAN + np.repeat(np.cumsum(ends) - ends, made)
        weight = (step % SAMPLES_PER_SPAN / SAMPLES_PER_SPAN).reshape(-1, *[1] * (values.ndim - 1))
        high = np.minimum(low + 1, len(values) - 1)
        mixed = np.where(weight == 0.0, values[low], (1.0 - weight) * values[low] + weight * values[high])
        spread[key] = Attribute(mixed.astype(values.dtype), Scope.POINT)
    return spread


register((".usd", ".usda", ".usdc"), read, write)
