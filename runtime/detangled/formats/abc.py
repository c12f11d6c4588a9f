"""Alembic (.abc), read through the official library's bindings (the package ``alembic3d``).

Every transform above the curves is applied, all curve objects of a file make one groom, and smooth curves
become polylines. Of several time samples the first is read. Alembic carries neither unit nor up axis.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from alembic3d import Abc, AbcGeom
from numpy.typing import NDArray

from detangled.errors import ReadError
from detangled.formats import abc_check, register
from detangled.formats.abc_values import BINDING_ERRORS, Value, read_property
from detangled.formats.abc_walk import matrix_of, transform_of, walk
from detangled.formats.abc_write import DEFAULT_UP, GROOM_PROPERTIES, write
from detangled.formats.curve_bases import SmoothCurves
from detangled.formats.frames import ONLY_FIRST
from detangled.formats.merge import Part, merged
from detangled.formats.transforms import to_world
from detangled.groom import Attribute, Groom, Scope

_BASES = {
    AbcGeom.BasisType.kBezierBasis: "bezier",
    AbcGeom.BasisType.kBsplineBasis: "bspline",
    AbcGeom.BasisType.kCatmullromBasis: "catmull-rom",
    AbcGeom.BasisType.kHermiteBasis: "hermite",
    AbcGeom.BasisType.kPowerBasis: "power",
}
CUBIC_ORDER = 4
# The schema's own parameters, by the names that attributes of a groom have.
_SCHEMA_PARAMETERS = {"width": "width", "uv": "uv", "N": "N", ".velocities": "velocities"}
_COMPOUNDS = (".arbGeomParams", ".userProperties")


@dataclass
class Scene:
    """What was met on the way through a file: curves, with the schemas of the transforms above each."""

    curves: list[tuple[Any, tuple[Any, ...]]] = field(default_factory=list)
    meshes: list[str] = field(default_factory=list)
    time_samples: int = 1
    properties: dict[str, Attribute] = field(default_factory=dict)


def read(path: Path) -> Groom:
    """Read all curves of an Alembic file, lengths as they stand in it.

    Raises ReadError where the file is no Alembic file, is damaged, or holds no curves.
    """
    abc_check.check(path)
    try:
        archive = Abc.IArchive(str(path))
        scene = collected(archive.getTop())
        if not scene.curves:
            beside = f", only the meshes {', '.join(scene.meshes)}" if scene.meshes else ""
            raise ReadError(f"{path}: holds no curves{beside}")
        parts = [_read_curves(path, curves, matrix_of(above)) for curves, above in scene.curves]
    except BINDING_ERRORS as error:
        raise ReadError(f"{path}: damaged, or not as Alembic lays it down: {_first_line(error)}") from error
    notes = []
    if scene.meshes:
        notes.append(f"skipped what is not curves: {', '.join(scene.meshes)}")
    if scene.time_samples > 1:
        notes.append(f"{scene.time_samples} time samples, {ONLY_FIRST}")
    groom = merged(parts, up=_up(scene), notes=tuple(notes))
    return replace(groom, attributes={**scene.properties, **groom.attributes})


def _up(scene: Scene) -> str:
    """What is up: y by custom, unless this program wrote the file for Unreal."""
    tool, about = (scene.properties.get(name) for name in ("groom_tool", "groom_properties"))
    if tool is None or about is None or not str(tool.values[0]).startswith("detangled "):
        return DEFAULT_UP
    return "z" if str(about.values[0]).endswith("z up") else DEFAULT_UP


def collected(top: Any) -> Scene:
    """Find the curves below an object."""
    scene = Scene()
    _find_properties(top.getProperties(), scene)
    for thing, above in walk(top):
        header = thing.getHeader()
        if AbcGeom.IXform.matches(header):
            schema = transform_of(thing)
            _find_properties(schema.getUserProperties(), scene)
            scene.time_samples = max(scene.time_samples, schema.getNumSamples())
        elif AbcGeom.ICurves.matches(header):
            curves = AbcGeom.ICurves(thing.getParent(), thing.getName())
            if curves.getSchema().getNumSamples():
                scene.time_samples = max(scene.time_samples, curves.getSchema().getNumSamples())
                scene.curves.append((curves, above))
        elif AbcGeom.IPolyMesh.matches(header) or AbcGeom.ISubD.matches(header):
            scene.meshes.append(thing.getName())
    return scene


def _find_properties(compound: Any, scene: Scene) -> None:
    """Take over properties of the whole groom from a node above the curves; the first found of a name stays."""
    if not compound.valid():
        return
    for i in range(compound.getNumProperties()):
        header = compound.getPropertyHeader(i)
        if header.getName() in GROOM_PROPERTIES and header.getName() not in scene.properties:
            value = read_property(compound, header)
            if value is not None and len(value.values) == 1:
                scene.properties[header.getName()] = Attribute(value.values, Scope.GROOM)


def _read_curves(path: Path, curves: Any, matrix: NDArray[np.float64]) -> Part:
    name = curves.getName()
    sample = curves.getSchema().getValue()
    counts, points = counts_and_points(path, name, sample)
    found, notes = _attributes(curves, len(counts), len(points))
    if sample.getWrap() == AbcGeom.CurvePeriodicity.kPeriodic:
        notes.append(f"the closed curves of {name!r} were read as open ones")
    points, found = to_world(points, found, matrix)
    if sample.getType() != AbcGeom.CurveType.kLinear:
        counts, points, found, more = evaluated(path, name, sample, counts, points, found)
        notes += more
    return Part(name, curves.getFullName(), points, counts, found, notes)


def counts_and_points(path: Path, name: str, sample: Any) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Points a strand (S,) and points (P, 3) of a sample. Raises ReadError where they do not fit each other."""
    points = np.array(np.asarray(sample.getPositions()), dtype=np.float64).reshape(-1, 3)
    counts = np.array(np.asarray(sample.getCurvesNumVertices()), dtype=np.int64).reshape(-1)
    if np.any(counts < 0) or int(counts.sum()) != len(points):
        negative = " and some below 0" if np.any(counts < 0) else ""
        raise ReadError(
            f"{path}: damaged: the curves {name!r} hold {len(points)} points, "
            f"and counts a strand that add up to {int(counts.sum())}{negative}"
        )
    return counts, points


def _attributes(curves: Any, strands: int, points: int) -> tuple[dict[str, Attribute], list[str]]:
    found: dict[str, Attribute] = {}
    notes: list[str] = []
    geometry = Abc.ICompoundProperty(curves.getProperties(), ".geom")
    for name, parent, header in _parameters(geometry):
        try:
            value = read_property(parent, header)
        except BINDING_ERRORS as error:
            notes.append(f"attribute {name!r} of {curves.getName()!r} was left out: {_first_line(error)}")
            continue
        if value is None:
            continue
        scope = _scope(value, strands, points)
        if scope is None:
            notes.append(
                f"attribute {name!r} of {curves.getName()!r} was left out: {len(value.values)} values "
                f"for {strands} strands of {points} points"
            )
        elif name in found:
            notes.append(f"a second attribute {name!r} of {curves.getName()!r} was left out")
        else:
            found[name] = Attribute(value.values, scope)
    return found, notes


def _parameters(geometry: Any) -> Iterator[tuple[str, Any, Any]]:
    """The schema's own parameters, the arbitrary ones, the user's: name, compound that holds it, header."""
    compounds = []
    for i in range(geometry.getNumProperties()):
        header = geometry.getPropertyHeader(i)
        if header.getName() in _SCHEMA_PARAMETERS:
            yield _SCHEMA_PARAMETERS[header.getName()], geometry, header
        elif header.getName() in _COMPOUNDS and header.isCompound():
            compounds.append(Abc.ICompoundProperty(geometry, header.getName()))
    for compound in compounds:
        for i in range(compound.getNumProperties()):
            header = compound.getPropertyHeader(i)
            yield header.getName(), compound, header


def _scope(value: Value, strands: int, points: int) -> Scope | None:
    """The scope by the count of values: what the file says counts only where the count leaves a choice.

    Blender writes one value a curve and no scope, which reads as constant.
    """
    counts = {Scope.POINT: points, Scope.STRAND: strands, Scope.GROOM: 1}
    fitting = [scope for scope, count in counts.items() if count == len(value.values)]
    if value.scope in fitting:
        return value.scope
    return fitting[0] if fitting else None


def evaluated(
    path: Path,
    name: str,
    sample: Any,
    counts: NDArray[np.int64],
    points: NDArray[np.float64],
    found: dict[str, Attribute],
) -> tuple[NDArray[np.int64], NDArray[np.float64], dict[str, Attribute], list[str]]:
    """Turn smooth curves, and the attributes on their control points, into polylines."""
    basis = _BASES.get(sample.getBasis())
    if basis is None:
        return (
            counts,
            points,
            found,
            [f"{name!r} are smooth curves of an unknown basis, read by their control points"],
        )
    orders = np.full(len(counts), CUBIC_ORDER, dtype=np.int64)
    if sample.getType() == AbcGeom.CurveType.kVariableOrder:
        given = np.array(np.asarray(sample.getOrders()), dtype=np.int64).reshape(-1)
        if len(given) != len(counts) or np.any(given < 1):
            raise ReadError(f"{path}: the curves {name!r} hold {len(given)} orders for {len(counts)} strands")
        orders = given
    weights = np.array(np.asarray(sample.getPositionWeights()), dtype=np.float64).reshape(-1)
    notes = []
    if len(weights) not in (0, len(points)):
        notes.append(f"the weights of {name!r} do not fit its points and were left out")
        weights = weights[:0]
    knots = np.array(np.asarray(sample.getKnots()), dtype=np.float64).reshape(-1)
    curves = SmoothCurves(counts, basis, orders, knots, weights)

    kept, carried = {}, {}
    for key, attribute in found.items():
        if attribute.scope is not Scope.POINT:
            kept[key] = attribute
        elif attribute.values.dtype.kind == "f":
            carried[key] = attribute
        else:
            notes.append(f"attribute {key!r} of {name!r} was left out: it has no values between control points")
    channels = [points, *(a.values.reshape(len(points), -1).astype(np.float64) for a in carried.values())]
    counts, values, more = curves.to_polylines(np.concatenate(channels, axis=1))
    begin = 3
    for (key, attribute), channel in zip(carried.items(), channels[1:], strict=True):
        own = values[:, begin : begin + channel.shape[1]].reshape(len(values), *attribute.values.shape[1:])
        kept[key] = Attribute(own.astype(attribute.values.dtype), Scope.POINT)
        begin += channel.shape[1]
    notes.append(f"{name!r} are {basis} curves: evaluated into polylines of {len(values)} points")
    return counts, values[:, :3], kept, notes + [f"{name!r}: {note}" for note in more]


def _first_line(error: BaseException) -> str:
    lines = [line for line in str(error).splitlines() if line and "EXCEPTION" not in line]
    return lines[-1] if lines else type(error).__name__


register((".abc",), read, write)
