"""What lies in an Alembic file, as it lies there: nodes, their properties, types, scopes and values."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from alembic3d import Abc, AbcGeom
from numpy.typing import NDArray

from detangled.errors import ReadError
from detangled.formats.abc_values import BINDING_ERRORS, array_values, read_property
from detangled.formats.abc_walk import matrix_of, transform_of, walk

SCALAR, ARRAY, COMPOUND = "scalar", "array", "compound"


@dataclass(frozen=True)
class Property:
    """One property of a node.

    kind: ``SCALAR``, ``ARRAY`` or ``COMPOUND`` (of values and indices). pod: the type of a value, as Alembic calls it
    (``int32_t``), and extent how many of them make an element. scope: ``con``, ``uni``, ``var``, ``vtx`` or ``fvr``.
    values: (n, ...), None where they cannot be read.
    """

    name: str
    kind: str
    pod: str
    extent: int
    scope: str
    values: NDArray[Any] | None


@dataclass(frozen=True)
class Curves:
    """A curves node: its path, points a strand (S,), number of points, properties by where they are, samples.

    schema: its own (``width``, ``uv``); arbitrary, user: in ``.arbGeomParams`` and ``.userProperties``. scale: by which
    the nodes above make it larger.
    """

    path: str
    counts: NDArray[np.int64]
    points: int
    schema: tuple[Property, ...]
    arbitrary: tuple[Property, ...]
    user: tuple[Property, ...]
    samples: int
    scale: float


@dataclass
class Archive:
    """Nodes of a file in their order.

    top: the properties of the archive's own top. above: of each transform with properties, its path and these.
    """

    top: tuple[Property, ...] = ()
    above: list[tuple[str, tuple[Property, ...]]] = field(default_factory=list)
    curves: list[Curves] = field(default_factory=list)
    meshes: list[str] = field(default_factory=list)


def contents(path: Path) -> Archive:
    """Look through a sound Alembic file. Raises ReadError where the library cannot follow it."""
    try:
        archive = Abc.IArchive(str(path))
        found = Archive(top=_properties(archive.getTop().getProperties()))
        for thing, above in walk(archive.getTop()):
            _look_at(thing, above, found)
    except BINDING_ERRORS as error:
        raise ReadError(f"{path}: damaged, or not as Alembic lays it down: {error}") from error
    return found


def _look_at(thing: Any, above: tuple[Any, ...], found: Archive) -> None:
    header = thing.getHeader()
    if AbcGeom.IXform.matches(header):
        schema = transform_of(thing)
        own = (*_properties(schema.getUserProperties()), *_properties(schema.getArbGeomParams()))
        if own:
            found.above.append((thing.getFullName(), own))
    elif AbcGeom.ICurves.matches(header):
        schema = AbcGeom.ICurves(thing.getParent(), thing.getName()).getSchema()
        if schema.getNumSamples():
            scale = abs(float(np.linalg.det(matrix_of(above)[:3, :3]))) ** (1 / 3)
            found.curves.append(_curves(thing, schema, scale))
    elif AbcGeom.IPolyMesh.matches(header) or AbcGeom.ISubD.matches(header):
        found.meshes.append(thing.getFullName())


def _curves(thing: Any, schema: Any, scale: float) -> Curves:
    sample = schema.getValue()
    counts = np.array(np.asarray(sample.getCurvesNumVertices()), dtype=np.int64).reshape(-1)
    geometry = Abc.ICompoundProperty(thing.getProperties(), ".geom")
    return Curves(
        thing.getFullName(),
        counts,
        len(sample.getPositions()),
        tuple(p for p in _properties(geometry) if p.name in ("width", "uv", "N")),
        _properties(schema.getArbGeomParams()),
        _properties(schema.getUserProperties()),
        schema.getNumSamples(),
        scale,
    )


def _properties(parent: Any) -> tuple[Property, ...]:
    if not parent.valid():
        return ()
    return tuple(
        _property(parent, parent.getPropertyHeader(i))
        for i in range(parent.getNumProperties())
        # Names with a dot are the schemas' own.
        if not parent.getPropertyHeader(i).getName().startswith(".")
    )


def _property(parent: Any, header: Any) -> Property:
    # Alembic takes a parameter that says no scope, as Blender writes them, for a constant one.
    scope = header.getMetaData().get("geoScope") or "con"
    name = header.getName()
    try:
        if header.isArray():
            # As many elements as an importer sees, whatever the parameter says of how many belong together.
            values = array_values(parent, name)
        else:
            value = read_property(parent, header)
            values = None if value is None else value.values
    except BINDING_ERRORS:
        values = None
    if header.isCompound():
        return Property(name, COMPOUND, "", 1, scope, values)
    data_type = header.getDataType()
    pod = str(data_type).split("[")[0]
    return Property(name, SCALAR if header.isScalar() else ARRAY, pod, data_type.getExtent(), scope, values)
