"""Which curve object of a file holds a strand: ``Groom.objects`` and the strand attribute ``object``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.groom import Attribute, Groom, Scope

ATTRIBUTE = "object"


def with_owners(groom: Groom, owners: ArrayLike) -> Groom:
    """The groom with its strands assigned to its objects by index, (S,); as it is if there is but one."""
    if len(groom.objects) < 2:
        return groom
    owner = Attribute(np.asarray(owners, dtype=np.int32), Scope.STRAND)
    return replace(groom, attributes={**groom.attributes, ATTRIBUTE: owner})


def owners(groom: Groom) -> NDArray[np.int64]:
    """Index into ``groom.objects`` of each strand, (S,); strands that name no object belong to the first."""
    attribute = groom.attributes.get(ATTRIBUTE)
    if len(groom.objects) < 2 or attribute is None or attribute.scope is not Scope.STRAND:
        return np.zeros(groom.strand_count, dtype=np.int64)
    index = attribute.values.astype(np.int64)
    return np.where((index >= 0) & (index < len(groom.objects)), index, 0)


def other_attributes(groom: Groom) -> dict[str, Attribute]:
    """The attributes without the one that says which object holds a strand."""
    if len(groom.objects) < 2:
        return dict(groom.attributes)
    return {name: a for name, a in groom.attributes.items() if name != ATTRIBUTE}


def lost_names(groom: Groom) -> list[str]:
    """What to say where a format has no place for the objects of a groom: a sentence, or none for one object."""
    if len(groom.objects) < 2:
        return []
    return [f"which of the objects {', '.join(groom.objects)} holds a strand was not kept"]
