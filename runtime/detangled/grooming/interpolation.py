"""Style guides between style guides: directions and lengths of three neighbours, in frames carried along the scalp.

Paper section "Style guide resampling": new style guides are interpolated from the original ones, but not where
neighbours diverge. What is mixed are the directions of segments, each turned with the scalp from its own root to the
new one by the least rotation of one normal into the other (parallel transport), and the lengths: positions, mixed,
would shorten a strand wherever its neighbours point apart, and cut through the head.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from detangled.geometry.arc import resample_strand
from detangled.geometry.spline import chord_lengths, distinct_points
from detangled.groom import Attribute, Groom, Scope, offsets_of
from detangled.grooming.scalp import Scalp
from detangled.kernels import kernel, parallel_kernel, prange

# Neighbours diverge where the ways they have gone, over a share of their lengths, are more degrees apart than this. Of
# the neighbours in two long grooms 9 in 10 stay within 24, 21, 15 and 9 degrees; across a parting there are 100 at
# first, and 30 in all where one falls before a shoulder, the other behind it.
DIVERGING_DEGREES = {0.125: 40.0, 0.25: 35.0, 0.5: 22.0, 1.0: 18.0}
# But what never gets so many times further apart than the roots are does not part: stubble may point anywhere.
TOGETHER = 2.0
_STEPS = 16  # of a guide, to compare it by
IDS = ("groom_id", "id")
NEAREST_UV = 0.5  # texture coordinates of neighbours further apart than this lie across a seam or on two tiles


@kernel
def _carry(out: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64], v: NDArray[np.float64]) -> None:
    """Fill ``out`` (3,) with a vector v turned by the least rotation that takes unit vector a to b."""
    cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    x = a[1] * b[2] - a[2] * b[1]
    y = a[2] * b[0] - a[0] * b[2]
    z = a[0] * b[1] - a[1] * b[0]
    along = (x * v[0] + y * v[1] + z * v[2]) / max(1.0 + cosine, 1e-9)
    out[0] = cosine * v[0] + y * v[2] - z * v[1] + along * x
    out[1] = cosine * v[1] + z * v[0] - x * v[2] + along * y
    out[2] = cosine * v[2] + x * v[1] - y * v[0] + along * z


@kernel
def mean_normal(normals: NDArray[np.float64], weights: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
    """Normals (k, 3) turned to one side, and their weighted mean (3,), of unit length."""
    turned = normals.copy()
    mean = np.zeros(3)
    for k in range(normals.shape[0]):
        if (normals[k] * normals[0]).sum() < 0.0:
            turned[k] = -normals[k]
        mean += weights[k] * turned[k]
    size = np.sqrt((mean * mean).sum())
    return turned, mean / size if size > 1e-9 else turned[0].copy()


@kernel
def add_carried(
    directions: NDArray[np.float64], strand: NDArray[np.float64], weight: float, a: NDArray, b: NDArray
) -> None:
    """Add to ``directions`` (n - 1, 3) those of a strand's segments (n, 3), turned as unit vector a is into b."""
    step = np.empty(3)
    carried = np.empty(3)
    for i in range(strand.shape[0] - 1):
        size = 0.0
        for c in range(3):
            step[c] = strand[i + 1, c] - strand[i, c]
            size += step[c] * step[c]
        _carry(carried, a, b, step)
        share = weight / max(np.sqrt(size), 1e-300)
        for c in range(3):
            directions[i, c] += share * carried[c]


@kernel
def _between(
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    normals: NDArray[np.float64],
    parents: NDArray[np.int64],
    weights: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Fill ``out`` (n, 3), whose first point is set, with the guide between its parents."""
    n = out.shape[0]
    around = np.empty((parents.shape[0], 3))
    for k in range(parents.shape[0]):
        around[k] = normals[parents[k]]
    turned, normal = mean_normal(around, weights)
    directions = np.zeros((n - 1, 3))
    length = 0.0
    for k in range(parents.shape[0]):
        if weights[k] > 0.0:
            even = resample_strand(distinct_points(points[offsets[parents[k]] : offsets[parents[k] + 1]]), n)
            length += weights[k] * chord_lengths(even)[n - 1]
            add_carried(directions, even, weights[k], turned[k], normal)
    for i in range(n - 1):
        size = max(np.sqrt((directions[i] ** 2).sum()), 1e-9)
        for c in range(3):
            out[i + 1, c] = out[i, c] + directions[i, c] / size * length / (n - 1)


@parallel_kernel
def _interpolated(
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    normals: NDArray[np.float64],
    parents: NDArray[np.int64],
    weights: NDArray[np.float64],
    roots: NDArray[np.float64],
    new_offsets: NDArray[np.int64],
) -> NDArray[np.float64]:
    out = np.empty((new_offsets[-1], 3))
    for s in prange(roots.shape[0]):
        strand = out[new_offsets[s] : new_offsets[s + 1]]
        strand[0] = roots[s]
        _between(points, offsets, normals, parents[s], weights[s], strand)
    return out


def interpolated(
    guides: Groom,
    scalp: Scalp,
    parents: NDArray[np.int64],
    weights: NDArray[np.float64],
    roots: NDArray[np.float64],
    counts: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Guides (Q, 3) [cm] that start at roots (N, 3), with ``counts`` (N,) points at even steps, root first.

    parents: (N, K), indices of guides, each of two distinct points at least; weights: (N, K), summing to 1 a row.
    """
    return _interpolated(
        guides.points, guides.offsets, scalp.normals, parents, weights, roots, offsets_of(np.maximum(counts, 2))
    )


@parallel_kernel
def _even(points: NDArray[np.float64], offsets: NDArray[np.int64]) -> NDArray[np.float64]:
    out = np.empty((offsets.shape[0] - 1, _STEPS + 1, 3))
    for s in prange(offsets.shape[0] - 1):
        out[s] = resample_strand(distinct_points(points[offsets[s] : offsets[s + 1]]), _STEPS + 1)
    return out


def diverging(guides: Groom, scalp: Scalp) -> NDArray[np.bool_]:
    """Triangles (T,) of the scalp whose guides part: between them no guide can be interpolated.

    guides: one for each of the scalp's roots, of two distinct points at least.
    """
    even = _even(guides.points, guides.offsets)
    found = np.zeros(len(scalp.triangles), dtype=np.bool_)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        one, other = scalp.triangles[:, a], scalp.triangles[:, b]
        apart = np.linalg.norm(even[one] - even[other], axis=2)
        roots = np.linalg.norm(scalp.roots[one] - scalp.roots[other], axis=1)
        parts = np.zeros(len(one), dtype=np.bool_)
        for share, degrees in DIVERGING_DEGREES.items():
            at = round(share * _STEPS)
            ways = [_unit(even[side, at] - even[side, 0]) for side in (one, other)]
            parts |= (ways[0] * ways[1]).sum(axis=1) < np.cos(np.radians(degrees))
        found |= parts & (apart.max(axis=1) > TOGETHER * np.maximum(roots, apart[:, 0]))
    return found


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)


def mixed_attributes(
    groom: Groom, parents: NDArray[np.int64], weights: NDArray[np.float64], offsets: NDArray[np.int64]
) -> tuple[dict[str, Attribute], list[str]]:
    """Attributes of new strands (N,) between strands of a groom, and sentences on those they cannot have.

    parents, weights: (N, K). offsets: (N + 1,), of the new strands' points. Fractions are mixed; whatever else, groups
    and names among them, is the nearest parent's; ids are fresh, from the greatest on.
    """
    kept: dict[str, Attribute] = {}
    lost: list[str] = []
    nearest = parents[np.arange(len(parents)), weights.argmax(axis=1)]
    counts = np.diff(offsets)
    strand = np.repeat(np.arange(len(parents)), counts)
    share = (np.arange(offsets[-1]) - offsets[strand]) / np.maximum(counts[strand] - 1, 1)
    for name, attribute in groom.attributes.items():
        values = attribute.values
        fraction = np.issubdtype(values.dtype, np.floating)
        if attribute.scope is Scope.GROOM:
            kept[name] = attribute
        elif name == "velocities":
            lost.append(f"attribute {name!r} was not kept: nothing says how new strands move")
        elif attribute.scope is Scope.POINT:
            mix = (parents.T, weights.T) if fraction else (nearest[None], np.ones((1, len(nearest))))
            total: NDArray = np.zeros((offsets[-1], *values.shape[1:]))
            for side, weight in zip(*mix, strict=True):
                found = _along(groom, values, side[strand], share, fraction)
                total = total + found * _column(weight[strand], values) if fraction else found
            kept[name] = Attribute(total.astype(values.dtype), Scope.POINT)
        elif name in IDS and values.ndim == 1 and values.dtype.kind in "iu":
            first = int(values.max(initial=-1)) + 1
            fresh = np.arange(first, first + len(parents))
            fits = first + len(parents) - 1 <= np.iinfo(values.dtype).max
            kept[name] = Attribute(fresh.astype(values.dtype if fits else np.int32), Scope.STRAND)
        elif fraction:
            mixed = sum(values[parents[:, k]] * _column(weights[:, k], values) for k in range(parents.shape[1]))
            if "uv" in name.lower():
                spread = np.ptp(values[parents].reshape(len(parents), parents.shape[1], -1), axis=1).max(axis=1)
                mixed = np.where(_column(spread > NEAREST_UV, values), values[nearest], mixed)
            kept[name] = Attribute(np.asarray(mixed).astype(values.dtype), Scope.STRAND)
        else:
            kept[name] = Attribute(values[nearest], Scope.STRAND)
    return kept, lost


def _column(weights: NDArray, values: NDArray) -> NDArray:
    """One weight a row, shaped to go with values of any number of components."""
    return weights.reshape((-1,) + (1,) * (values.ndim - 1))


def _along(
    groom: Groom, values: NDArray, strands: NDArray[np.int64], share: NDArray[np.float64], fraction: bool
) -> NDArray:
    """Values of points at shares (Q,) of strands (Q,): between two points, or of the nearer one."""
    counts = groom.point_counts[strands]
    at = share * (counts - 1)
    whole = np.minimum(at.astype(np.int64), counts - 1)
    below = groom.offsets[strands] + whole
    above = groom.offsets[strands] + np.minimum(whole + 1, counts - 1)
    if not fraction:
        return values[np.where(at - whole < 0.5, below, above)]
    part = _column(at - whole, values)
    return values[below] * (1.0 - part) + values[above] * part


def joined(groom: Groom, points: NDArray[np.float64], counts: NDArray[np.int64], new: dict[str, Attribute]) -> Groom:
    """A groom followed by new strands of ``counts`` (N,) points (Q, 3), by the names of their attributes."""
    attributes = {
        name: a if a.scope is Scope.GROOM else Attribute(np.concatenate([a.values, new[name].values]), a.scope)
        for name, a in groom.attributes.items()
        if name in new
    }
    return replace(
        groom,
        points=np.concatenate([groom.points, points]),
        offsets=offsets_of(np.concatenate([groom.point_counts, counts])),
        attributes=attributes,
    )
