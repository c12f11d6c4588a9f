"""Style guides of a groom: its strands' centrelines, and which strands can have one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.geometry.arc import arc_lengths
from detangled.geometry.canonical import phi
from detangled.geometry.centerline import centerlines
from detangled.geometry.inputs import compiled_input
from detangled.groom import Attribute, Groom, Scope
from detangled.kernels import parallel_kernel, prange
from detangled.usable import usable_strands


@dataclass(frozen=True)
class StyleGuides:
    """Style guides of the usable strands of a groom.

    groom: the usable strands, as they were. kept: (S,) indices of these in the whole groom.
    points: (P, 3) [cm], guides with as many points as the strands, by the groom's offsets.
    lengths: (S,) [cm], arc lengths of the guides.
    """

    groom: Groom
    kept: NDArray[np.int64]
    points: NDArray[np.float64]
    lengths: NDArray[np.float64]

    def canonical(self) -> NDArray[np.float64]:
        """The strands in canonical space, (P, 3) [cm]."""
        return to_canonical(self.groom.points, self.points, self.groom.offsets)

    def as_groom(self) -> Groom:
        """The guides as a groom of their own, with the strands' attributes."""
        return replace(self.groom, points=self.points)


def style_guides(groom: Groom) -> StyleGuides:
    """Extract the style guides of all usable strands."""
    kept = np.flatnonzero(usable_strands(groom))
    strands = groom if len(kept) == groom.strand_count else groom.select(kept)
    points, _ = centerlines(strands.points, strands.offsets)
    return StyleGuides(strands, kept, points, arc_lengths(points, strands.offsets))


def guides_groom(groom: Groom) -> Groom:
    """The groom with each usable strand replaced by its style guide; the others stay as they are."""
    guides = style_guides(groom)
    points = groom.points.copy()
    mask = np.zeros(groom.strand_count, dtype=np.bool_)
    mask[guides.kept] = True
    points[np.repeat(mask, groom.point_counts)] = guides.points
    return replace(groom, points=points)


def to_canonical(points: ArrayLike, guides: ArrayLike, offsets: ArrayLike) -> NDArray[np.float64]:
    """Strands (P, 3) in the canonical space of their guides (P, 3)."""
    arrays = compiled_input(points, np.float64), compiled_input(guides, np.float64)
    return _to_canonical(*arrays, compiled_input(offsets, np.int64))


@parallel_kernel
def _to_canonical(
    points: NDArray[np.float64], guides: NDArray[np.float64], offsets: NDArray[np.int64]
) -> NDArray[np.float64]:
    out = np.empty_like(points)
    for s in prange(offsets.shape[0] - 1):
        a = offsets[s]
        b = offsets[s + 1]
        if b > a:
            out[a:b] = phi(points[a:b], guides[a:b])
    return out


def resampled_attributes(groom: Groom, offsets: NDArray[np.int64]) -> tuple[dict[str, Attribute], list[str]]:
    """Attributes of a groom for strands with other point counts (``offsets``), and those that had to go.

    Values of points are read at the same share of the strand: fractions between neighbours, anything else from the
    nearest point. Velocities belong to the old points alone.
    """
    counts = np.diff(offsets)
    strand = np.repeat(np.arange(groom.strand_count), counts)
    old = groom.point_counts[strand]
    # Exact where the counts are equal: a strand that passed through keeps its values to the bit.
    at = (np.arange(offsets[-1]) - offsets[strand]) * (old - 1) / np.maximum(counts[strand] - 1, 1)
    kept, lost = dict(groom.attributes), []
    if "velocities" in kept and kept["velocities"].scope is Scope.POINT:
        del kept["velocities"]
        lost.append("attribute 'velocities' was not kept: it belongs to the strands' old points")
    return attributes_at(replace(groom, attributes=kept), offsets, at), lost


def attributes_at(groom: Groom, offsets: NDArray[np.int64], at: NDArray[np.float64]) -> dict[str, Attribute]:
    """Attributes of a groom for other points of its strands: by ``offsets`` (S + 1,), at places ``at`` (Q,).

    A place counts a strand's old points from 0: at 1.5 fractions are the mean of the second and the third point's,
    and anything else is the nearest one's.
    """
    kept: dict[str, Attribute] = {}
    strand = np.repeat(np.arange(groom.strand_count), np.diff(offsets))
    old = groom.point_counts[strand]
    whole = np.minimum(at.astype(np.int64), old - 1)
    part = at - whole
    below = groom.offsets[strand] + whole
    above = groom.offsets[strand] + np.minimum(whole + 1, old - 1)
    for name, attribute in groom.attributes.items():
        if attribute.scope is not Scope.POINT:
            kept[name] = attribute
        elif np.issubdtype(attribute.values.dtype, np.floating):
            weight = part.reshape((-1,) + (1,) * (attribute.values.ndim - 1))
            low, high = attribute.values[below], attribute.values[above]
            with np.errstate(invalid="ignore"):
                mixed = np.where(weight == 0.0, low, low * (1.0 - weight) + high * weight)
            kept[name] = Attribute(mixed.astype(attribute.values.dtype), Scope.POINT)
        else:
            kept[name] = Attribute(attribute.values[np.where(part < 0.5, below, above)], Scope.POINT)
    return kept
