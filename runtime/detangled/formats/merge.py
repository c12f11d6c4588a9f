"""Several curve objects of one file made into one groom."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detangled.formats import objects
from detangled.groom import Attribute, Groom, Scope, offsets_of

_FINENESS = (Scope.GROOM, Scope.STRAND, Scope.POINT)


@dataclass(frozen=True)
class Part:
    """One object's strands: its name, its path in the file, points (P, 3), counts (S,), attributes, notes."""

    name: str
    path: str
    points: NDArray[np.float64]
    counts: NDArray[np.int64]
    attributes: dict[str, Attribute] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def merged(parts: list[Part], up: str, notes: tuple[str, ...] = ()) -> Groom:
    """One groom of all parts, in their order.

    An attribute takes the finest scope that it has in any of them; a part that lacks it gets zeros or empty
    texts. Objects of the same name are told apart by their paths.
    """
    names = tuple(part.name for part in parts)
    if len(set(names)) < len(names):
        names = tuple(part.path.lstrip("/") for part in parts)
    said = [*notes, *(note for part in parts for note in part.notes)]
    attributes = {}
    for name in dict.fromkeys(name for part in parts for name in part.attributes):
        if len(parts) > 1 and name == objects.ATTRIBUTE:
            said.append(f"attribute {name!r} was left out: that name says which object holds a strand")
            continue
        attribute, note = _merged_attribute(name, parts)
        if attribute is not None:
            attributes[name] = attribute
        if note:
            said.append(note)
    counts = np.concatenate([part.counts for part in parts])
    groom = Groom(
        parts[0].points if len(parts) == 1 else np.concatenate([part.points for part in parts]),
        offsets_of(counts),
        attributes=attributes,
        up=up,
        objects=names,
        notes=tuple(said),
    )
    return objects.with_owners(groom, np.repeat(np.arange(len(parts)), [len(part.counts) for part in parts]))


def _merged_attribute(name: str, parts: list[Part]) -> tuple[Attribute | None, str]:
    held = [part.attributes.get(name) for part in parts]
    own = [a for a in held if a is not None]
    first = own[0]
    if len(parts) == 1:
        return first, ""
    if len({a.values.shape[1:] for a in own}) > 1 or len({a.values.dtype.kind == "U" for a in own}) > 1:
        return None, f"attribute {name!r} was left out: it differs in kind between the objects"
    if len(own) == len(parts) and all(a.scope is Scope.GROOM and np.array_equal(a.values, first.values) for a in own):
        return first, ""
    scope = max(Scope.STRAND, *(a.scope for a in own), key=_FINENESS.index)
    dtype = np.result_type(*(a.values.dtype for a in own))
    pieces = [_spread(part, a, scope, dtype, first.values.shape[1:]) for part, a in zip(parts, held, strict=True)]
    lacking = [part.name for part, a in zip(parts, held, strict=True) if a is None]
    note = f"attribute {name!r} is zero or empty in {', '.join(lacking)}, which lacks it" if lacking else ""
    return Attribute(np.concatenate(pieces), scope), note


def _spread(
    part: Part, attribute: Attribute | None, scope: Scope, dtype: np.dtype, shape: tuple[int, ...]
) -> NDArray[Any]:
    """One part's values at a scope at least as fine as its own."""
    count = len(part.points) if scope is Scope.POINT else len(part.counts)
    if attribute is None:
        return np.zeros((count, *shape), dtype=dtype)
    values = attribute.values.astype(dtype)
    if attribute.scope is Scope.GROOM:
        return np.repeat(values, count, axis=0)
    if attribute.scope is Scope.STRAND and scope is Scope.POINT:
        return np.repeat(values, part.counts, axis=0)
    return values
