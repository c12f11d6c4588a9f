"""Groom: strands as flat points and offsets, with attributes by scope. Never mutated: every change is a copy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.errors import DetangledError


class Scope(str, Enum):
    """What one value of an attribute belongs to."""

    GROOM = "groom"
    STRAND = "strand"
    POINT = "point"


@dataclass(frozen=True)
class Attribute:
    """Values of one attribute: ``(n, ...)`` with n = 1, strands or points by scope; any dtype."""

    values: NDArray[Any]
    scope: Scope

    def __post_init__(self) -> None:
        values = np.asarray(self.values)
        if values.ndim == 0:
            values = values[None]
        object.__setattr__(self, "values", _frozen(values))
        object.__setattr__(self, "scope", Scope(self.scope))


def offsets_of(counts: ArrayLike) -> NDArray[np.int64]:
    """Where each of some parts begins and the last ends, (S + 1,), from how long they are (S,)."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


@dataclass(frozen=True)
class Groom:
    """Strands of hair.

    points: (P, 3) float64, positions [cm], all strands root first, one after another.
    offsets: (S + 1,) int64, strand s is ``points[offsets[s]:offsets[s + 1]]``; strands of 0 points can occur.
    attributes: by name; lengths among them (``width``, the diameter) are in cm too.
    unit_cm: centimetres in one unit of the file it came from or goes to.
    unit_source: ``"given"``, ``"file"``, ``"size"`` (guessed from the size) or ``"default"``.
    up: the axis that points up, ``"x"``, ``"y"`` or ``"z"``; coordinates are kept as they were.
    objects: names of the curve objects; strand attribute ``object`` (int) says which one holds a strand where
        there are several, in their order.
    notes: what the reader could not keep or had to assume, one sentence each.
    """

    points: NDArray[np.float64]
    offsets: NDArray[np.int64]
    attributes: Mapping[str, Attribute] = field(default_factory=dict)
    unit_cm: float = 1.0
    unit_source: str = "default"
    up: str = "y"
    objects: tuple[str, ...] = ("hair",)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        points = np.ascontiguousarray(self.points, dtype=np.float64)
        offsets = np.ascontiguousarray(self.offsets, dtype=np.int64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise DetangledError(f"points must have the shape (P, 3), not {points.shape}")
        if offsets.ndim != 1 or len(offsets) == 0 or offsets[0] != 0 or offsets[-1] != len(points):
            raise DetangledError(f"offsets must run from 0 to the number of points, {len(points)}")
        if np.any(np.diff(offsets) < 0):
            raise DetangledError("offsets must not decrease")
        expected = {Scope.GROOM: 1, Scope.STRAND: len(offsets) - 1, Scope.POINT: len(points)}
        for name, attribute in self.attributes.items():
            if len(attribute.values) != expected[attribute.scope]:
                raise DetangledError(
                    f"attribute {name!r} has {len(attribute.values)} values, "
                    f"a {attribute.scope.value} attribute of this groom {expected[attribute.scope]}"
                )
        object.__setattr__(self, "points", _frozen(points))
        object.__setattr__(self, "offsets", _frozen(offsets))
        object.__setattr__(self, "attributes", dict(self.attributes))

    @classmethod
    def from_strands(cls, strands: Iterable[ArrayLike], **fields: Any) -> Groom:
        """Make a groom of separate (n, 3) arrays of points [cm]."""
        arrays = [np.asarray(strand, dtype=np.float64).reshape(-1, 3) for strand in strands]
        offsets = offsets_of([len(a) for a in arrays])
        points = np.concatenate(arrays) if arrays else np.zeros((0, 3))
        return cls(points, offsets.astype(np.int64), **fields)

    @property
    def strand_count(self) -> int:
        return len(self.offsets) - 1

    @property
    def point_counts(self) -> NDArray[np.int64]:
        """Points of each strand, (S,)."""
        return np.diff(self.offsets)

    def strand(self, index: int) -> NDArray[np.float64]:
        """Points of one strand, (n, 3) [cm], a read-only view."""
        return self.points[self.offsets[index] : self.offsets[index + 1]]

    def polyline_lengths(self) -> NDArray[np.float64]:
        """Sum of each strand's segment lengths, (S,) [cm]; 0 for strands of fewer than two points."""
        steps = np.zeros(len(self.points))
        steps[1:] = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        # The step that leads from one strand to the next belongs to neither.
        steps[self.offsets[:-1][self.point_counts > 0]] = 0.0
        strand = np.repeat(np.arange(self.strand_count), self.point_counts)
        return np.bincount(strand, weights=steps, minlength=self.strand_count).astype(np.float64, copy=False)

    def select(self, strands: ArrayLike) -> Groom:
        """The groom of these strands (indices or a boolean mask), with their attributes."""
        chosen = np.arange(self.strand_count)[np.asarray(strands)]
        counts = self.point_counts[chosen]
        offsets = offsets_of(counts)
        rows = np.arange(offsets[-1]) - np.repeat(offsets[:-1] - self.offsets[chosen], counts)
        attributes = {
            name: Attribute(a.values[{Scope.STRAND: chosen, Scope.POINT: rows}[a.scope]], a.scope)
            if a.scope is not Scope.GROOM
            else a
            for name, a in self.attributes.items()
        }
        return replace(self, points=self.points[rows], offsets=offsets, attributes=attributes)


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    """A read-only view, so that the caller's own array stays writable."""
    view = array.view()
    view.flags.writeable = False
    return view
