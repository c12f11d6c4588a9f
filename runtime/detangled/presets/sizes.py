"""Sizes that do not fit together: objects, or widths and strands, that were written in different units."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.formats import objects
from detangled.groom import Groom

# Brows beside long hair differ tenfold; metres and centimetres a hundredfold.
OTHER_UNIT = 50.0
# A hair is 0.002 to 0.02 cm thick; artists draw locks and fibres of a few times that.
LEAST_WIDTH_CM, GREATEST_WIDTH_CM = 2e-4, 0.3


def mixed_units(groom: Groom) -> list[str]:
    """Sentences about objects, or widths, whose size says that they are in another unit than the rest."""
    said = []
    if len(groom.objects) > 1:
        owner = objects.owners(groom)
        sizes = [_diagonal(groom.select(owner == index).points) for index in range(len(groom.objects))]
        present = [(size, name) for size, name in zip(sizes, groom.objects, strict=True) if size > 0.0]
        if present and max(present)[0] > OTHER_UNIT * min(present)[0]:
            said.append(
                f"{max(present)[1]!r} spans {max(present)[0]:.3g} cm and {min(present)[1]!r} {min(present)[0]:.3g} cm: "
                "they seem to be in different units; bring them to one before"
            )
    width = groom.attributes.get("width", groom.attributes.get("groom_width"))
    if width is not None and width.values.dtype.kind == "f" and width.values.size:
        middle = float(np.median(width.values))
        if not LEAST_WIDTH_CM <= middle <= GREATEST_WIDTH_CM:
            said.append(
                f"the hairs are {middle:.3g} cm thick in the median, which no hair is: if widths are in another unit "
                "than the points, bring them to one before"
            )
    return said


def _diagonal(points: NDArray[np.float64]) -> float:
    finite = points[np.isfinite(points).all(axis=1)]
    return float(np.linalg.norm(finite.max(axis=0) - finite.min(axis=0))) if len(finite) else 0.0
