"""Alembic (.abc), written through the official library's bindings: linear curves and their attributes.

The same groom gives the same bytes: the archive is made without the metadata that hold a date.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import imath
import numpy as np
from alembic3d import Abc, AbcGeom
from alembic3d.AbcCoreAbstract import AcyclicFlag, TimeSampling, TimeSamplingType, TimeVector
from numpy.typing import NDArray

from detangled.errors import ReadError, WriteError
from detangled.formats import abc_check, objects
from detangled.formats.abc_values import BINDING_ERRORS, GEOMETRY_SCOPES, filled, write_parameter
from detangled.groom import Attribute, Groom, Scope

DEFAULT_UP = "y"
EVEN = 1e-6  # times whose steps differ by no more than this share are a rate
# Properties of a whole groom, which Unreal looks for on its topmost node and takes as single values.
GROOM_PROPERTIES = ("groom_version_major", "groom_version_minor", "groom_tool", "groom_properties")


def write(groom: Groom, path: Path) -> list[str]:
    """Write a groom whose lengths are in the file's unit: a transform and curves for each of its objects.

    Raises WriteError where the library fails or the file is not whole afterwards.
    """
    return _checked(groom, path, None, iter(()))


def write_frames(
    groom: Groom, times: NDArray[np.float64], points: Iterable[NDArray[np.float64]], path: Path
) -> list[str]:
    """Write a groom that moves: its points (P, 3) at each of the times (F,) [s], one frame after another.

    Raises WriteError as ``write`` does.
    """
    lost = []
    if "velocities" in groom.attributes:
        attributes = {name: a for name, a in groom.attributes.items() if name != "velocities"}
        groom = replace(groom, attributes=attributes)
        lost.append("attribute 'velocities' was not kept: it belongs to the first frame alone")
    frames = iter(points)
    first = next(frames, groom.points)
    return lost + _checked(replace(groom, points=first), path, times, frames)


def _checked(
    groom: Groom, path: Path, times: NDArray[np.float64] | None, later: Iterator[NDArray[np.float64]]
) -> list[str]:
    try:
        lost = _write(groom, path, times, later)
    except BINDING_ERRORS as error:
        raise WriteError(f"{path}: Alembic could not write it: {error}") from error
    try:
        # A full disk does not stop the library, so see what is there.
        abc_check.check(path, frames=times is not None)
    except (ReadError, ValueError) as error:
        raise WriteError(f"{path}: could not be written whole; is the disk full?") from error
    return lost


def _write(
    groom: Groom, path: Path, times: NDArray[np.float64] | None, later: Iterator[NDArray[np.float64]]
) -> list[str]:
    owner = objects.owners(groom)
    lost = ["strands were put in the order of their objects"] if np.any(np.diff(owner) < 0) else []
    # Unreal, which its version is for, takes what is up from its own settings.
    if groom.up != DEFAULT_UP and "groom_version_major" not in groom.attributes:
        lost.append(f"{groom.up} stays up, but an Alembic file cannot say so: most programs will take {DEFAULT_UP}")
    archive = Abc.OArchive(str(path))
    sampling = [] if times is None else [Abc.Argument(archive.addTimeSampling(_time_sampling(times)))]
    names = _node_names(groom.objects)
    several = len(names) > 1
    whole = _groom_properties(groom)
    others = {name: a for name, a in objects.other_attributes(groom).items() if name not in whole}
    _write_properties(archive.getTop().getProperties(), whole)
    moving = []
    for index, name in enumerate(names):
        strands = np.flatnonzero(owner == index)
        part = groom.select(strands) if several else groom
        transform = AbcGeom.OXform(archive.getTop(), name)
        if index == 0 and whole:
            _write_properties(transform.getSchema().getUserProperties(), whole)
        schema = AbcGeom.OCurves(transform, name, *sampling).getSchema()
        lost += _write_curves(part, others, schema)
        moving.append((schema, part, np.repeat(owner == index, groom.point_counts) if several else slice(None)))
    for frame in later:
        for schema, part, rows in moving:
            schema.set(_sample(frame[rows], part.point_counts))
    # One sentence about an attribute, however many objects have it.
    return list(dict.fromkeys(lost))


def _time_sampling(times: NDArray[np.float64]) -> Any:
    """Times (F,) [s] as Alembic says them: a rate where they are even, else each by itself."""
    steps = np.diff(times)
    if len(steps) and np.ptp(steps) <= EVEN * steps.mean():
        return TimeSampling(float(times[-1] - times[0]) / len(steps), float(times[0]))
    listed = TimeVector()
    for time in times:
        listed.append(float(time))
    return TimeSampling(TimeSamplingType(AcyclicFlag.kAcyclic), listed)


def _groom_properties(groom: Groom) -> dict[str, int | str]:
    """What there is of GROOM_PROPERTIES, if it is a text or a small whole number."""
    found: dict[str, int | str] = {}
    for name in GROOM_PROPERTIES:
        attribute = groom.attributes.get(name)
        if attribute is None or attribute.scope is not Scope.GROOM or attribute.values.shape != (1,):
            continue
        value = attribute.values[0].item()
        if isinstance(value, str) or (isinstance(value, int) and abs(value) < 2**15):
            found[name] = value
    return found


def _write_properties(parent: Any, values: dict[str, int | str]) -> None:
    for name, value in values.items():
        kind = Abc.OStringProperty if isinstance(value, str) else Abc.OInt16Property
        kind(parent, name).setValue(value)


def _write_curves(groom: Groom, named: dict[str, Attribute], schema: Any) -> list[str]:
    sample = _sample(groom.points, groom.point_counts)
    others = {}
    for name in named:
        attribute = groom.attributes[name]
        if not _set_schema_parameter(sample, name, _spread_widths(groom, attribute) if name == "width" else attribute):
            others[name] = attribute
    schema.set(sample)
    lost = []
    if others:
        parent = schema.getArbGeomParams()
        for name, attribute in others.items():
            lost += write_parameter(parent, name, attribute.values, attribute.scope)
    return lost


def _sample(points: NDArray[np.float64], counts: NDArray[np.int64]) -> Any:
    """Linear curves of points (P, 3), so many a strand (S,)."""
    sample = AbcGeom.OCurvesSchemaSample(
        filled(imath.V3fArray, points),
        filled(imath.IntArray, counts),
        AbcGeom.CurveType.kLinear,
        AbcGeom.CurvePeriodicity.kNonPeriodic,
    )
    sample.setBasis(AbcGeom.BasisType.kNoBasis)
    return sample


def _set_schema_parameter(sample: Any, name: str, attribute: Attribute) -> bool:
    """Put widths, UVs, normals and velocities where the curves' schema has a place for them."""
    values = attribute.values
    if values.dtype.kind != "f":
        return False
    scope = GEOMETRY_SCOPES[attribute.scope]
    if name == "width" and values.ndim == 1:
        sample.setWidths(AbcGeom.OFloatGeomParamSample(filled(imath.FloatArray, values), scope))
    elif name == "uv" and values.shape[1:] == (2,) and values.dtype == np.float32:
        sample.setUVs(AbcGeom.OV2fGeomParamSample(filled(imath.V2fArray, values), scope))
    elif name == "N" and values.shape[1:] == (3,) and values.dtype == np.float32:
        sample.setNormals(AbcGeom.ON3fGeomParamSample(filled(imath.V3fArray, values), scope))
    elif name == "velocities" and values.shape[1:] == (3,) and attribute.scope is Scope.POINT:
        sample.setVelocities(filled(imath.V3fArray, values))
    else:
        return False
    return True


def _spread_widths(groom: Groom, attribute: Attribute) -> Attribute:
    """Widths a point: Blender takes fewer as if they were, and overlooks a single one (seen in 4.5)."""
    if attribute.scope is Scope.STRAND:
        return Attribute(np.repeat(attribute.values, groom.point_counts, axis=0), Scope.POINT)
    if attribute.scope is Scope.GROOM:
        return Attribute(np.repeat(attribute.values, len(groom.points), axis=0), Scope.POINT)
    return attribute


def _node_names(names: tuple[str, ...]) -> list[str]:
    """Names that can stand in an archive: without slashes, none empty, none twice."""
    taken: list[str] = []
    for name in names:
        plain = name.replace("/", "_").strip() or "hair"
        number = 1
        unique = plain
        while unique in taken:
            number += 1
            unique = f"{plain}_{number}"
        taken.append(unique)
    return taken
