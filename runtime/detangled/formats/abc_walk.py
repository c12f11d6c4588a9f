"""The way through the objects of an Alembic file, and the transforms above each."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from alembic3d import AbcGeom
from numpy.typing import NDArray


def walk(top: Any) -> Iterator[tuple[Any, tuple[Any, ...]]]:
    """An object and all below it, in the file's order, each with the schemas of the transforms above it.

    A transform counts as above itself; one without samples does not count.
    """
    waiting: list[tuple[Any, tuple[Any, ...]]] = [(top, ())]
    while waiting:
        thing, above = waiting.pop()
        if AbcGeom.IXform.matches(thing.getHeader()):
            schema = transform_of(thing)
            above = (*above, schema) if schema.getNumSamples() else above
        yield thing, above
        # Backwards, since the last one in is the first one out.
        waiting.extend((thing.getChild(i), above) for i in reversed(range(thing.getNumChildren())))


def transform_of(thing: Any) -> Any:
    """The schema of a transform."""
    return AbcGeom.IXform(thing.getParent(), thing.getName()).getSchema()


def matrix_of(above: tuple[Any, ...], selector: Any = None) -> NDArray[np.float64]:
    """The matrix (4, 4) that takes what is below some transforms to the world (row vectors), at a time or first."""
    matrix = np.eye(4)
    for schema in above:
        sample = schema.getValue() if selector is None else schema.getValue(selector)
        own = np.array([[entry for entry in row] for row in sample.getMatrix()], dtype=np.float64)
        matrix = own @ matrix if sample.getInheritsXforms() else own
    return matrix
