"""Canonical strands on style guides: roots kept, lengths exact, enough points for every turn.

Paper sections "Canonical Space & Style Guides" (the inverse of phi, guides resampled so that segments match) and
"Adjusting Strand Length".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.geometry.arc import arc_length, resample_strand
from detangled.geometry.canonical import guide_frames
from detangled.geometry.spline import chord_lengths, distinct_points, spline_sample, spline_slopes
from detangled.groom import offsets_of
from detangled.kernels import kernel, parallel_kernel, prange

GUIDE_SAMPLES_PER_SEGMENT = 8
FEWEST_GUIDE_SAMPLES, MOST_GUIDE_SAMPLES = 1024, 4096
# A new strand starts at the old root, and goes over to its own place about the guide in so many of its turns along the
# axis, or in so many distances of an old root that lies further out; but within this share of the strand, where that is
# not sooner than in the least: it would be a kink.
BLEND_TURNS, LEAST_BLEND_TURNS = 0.9, 0.3
ROOT_RADII = 12.0
BLEND_SHARE = 0.5
UNBENT, MOST_UNBENT = 1e-9, 50  # [cm] how nearly a root is unbent, and rounds at most


@kernel
def dense_guide(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A guide finely sampled (m, 3) and the arc length at its samples (m,), from its smooth curve."""
    guide = distinct_points(points)
    segments = guide.shape[0] - 1
    m = min(max(GUIDE_SAMPLES_PER_SEGMENT * segments, FEWEST_GUIDE_SAMPLES), max(MOST_GUIDE_SAMPLES, segments))
    t = chord_lengths(guide)
    dense = spline_sample(t, guide, spline_slopes(t, guide), np.linspace(0.0, t[-1], m + 1))
    along = chord_lengths(dense)
    return dense, along * (arc_length(guide) / along[m])


@kernel
def bend_onto(canonical: NDArray[np.float64], guide: NDArray[np.float64]) -> NDArray[np.float64]:
    """World-space strand (n, 3) [cm] of a canonical one (n, 3), whose axis -z becomes the guide (g, 3).

    The guide is resampled where the strand's points are, so segments match one to one; beyond its ends it goes on
    straight. Its frames are those of phi, evenly turned between samples.
    """
    dense, along = dense_guide(guide)
    return bend(canonical, dense, along)


@kernel
def bend(canonical: NDArray[np.float64], dense: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[np.float64]:
    """Like ``bend_onto``, of a guide that is finely sampled (m, 3) already, with the arc length at its samples (m,)."""
    frames = guide_frames(dense)
    n = canonical.shape[0]
    out = np.empty((n, 3))
    place = np.empty((3, 3))
    k = 0
    for i in range(n):
        k = _place_at(-canonical[i, 2], dense, along, frames, k, place)
        for c in range(3):
            out[i, c] = place[0, c] + canonical[i, 0] * place[1, c] + canonical[i, 1] * place[2, c]
    return out


@kernel
def _place_at(
    s: float,
    dense: NDArray[np.float64],
    along: NDArray[np.float64],
    frames: NDArray[np.float64],
    k: int,
    place: NDArray[np.float64],
) -> int:
    """Fill ``place`` (3, 3): the guide's point at arc length ``s``, and where canonical x and y point there.

    k: the guide's sample to look from; the one that was found is returned.
    """
    m = dense.shape[0] - 1
    while k < m - 1 and s > along[k + 1]:
        k += 1
    while k > 0 and s < along[k]:
        k -= 1
    part = (s - along[k]) / (along[k + 1] - along[k])
    # A frame belongs to the middle of its segment; half a segment at either end is extrapolated.
    middle = min(max(k + part, 0.0), float(m)) - 0.5
    below = min(max(int(np.floor(middle)), 0), m - 2)
    ahead = below + 1
    inside = middle - below
    size = 0.0
    for c in range(3):
        place[0, c] = dense[k, c] + part * (dense[k + 1, c] - dense[k, c])
        place[1, c] = frames[below, 0, c] * (1.0 - inside) + frames[ahead, 0, c] * inside
        size += place[1, c] * place[1, c]
    place[1] /= np.sqrt(size)
    down = 0.0
    for c in range(3):
        place[2, c] = frames[below, 1, c] * (1.0 - inside) + frames[ahead, 1, c] * inside
        down += place[2, c] * place[1, c]
    size = 0.0
    for c in range(3):
        place[2, c] -= down * place[1, c]
        size += place[2, c] * place[2, c]
    place[2] /= np.sqrt(size)
    return k


@kernel
def unbend_root(root: NDArray[np.float64], guide: NDArray[np.float64]) -> NDArray[np.float64]:
    """What ``bend_onto`` takes to ``root`` (3,) [cm], a place beside the root of the guide (g, 3): (3,).

    Where the guide bends more sharply than about the root, which then has several such places, the nearest found.
    """
    dense, along = dense_guide(guide)
    frames = guide_frames(dense)
    canonical = np.zeros(3)
    place = np.empty((3, 3))
    missing = np.empty(3)
    nearest = np.zeros(3)
    least = np.inf
    k = 0
    for _ in range(MOST_UNBENT):
        k = _place_at(-canonical[2], dense, along, frames, k, place)
        for c in range(3):
            missing[c] = root[c] - place[0, c] - canonical[0] * place[1, c] - canonical[1] * place[2, c]
        away = np.sqrt((missing**2).sum())
        if away < least:
            least = away
            nearest[:] = canonical
        if away <= UNBENT:
            break
        canonical[0] += (missing * place[1]).sum()
        canonical[1] += (missing * place[2]).sum()
        canonical[2] += (missing * np.cross(place[1], place[2])).sum()
    return nearest


@parallel_kernel
def unbend_roots(
    roots: NDArray[np.float64], guides: NDArray[np.float64], offsets: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Where roots (S, 3) [cm] lie in the canonical space of their guides (G, 3), by offsets (S + 1,): (S, 3)."""
    out = np.empty_like(roots)
    for s in prange(len(roots)):
        out[s] = unbend_root(roots[s], guides[offsets[s] : offsets[s + 1]])
    return out


@kernel
def _blend(along: float, reach: float) -> float:
    """Share of the shift at the root that is left ``along`` the axis: 1 at the root and above it, 0 from ``reach``."""
    u = min(max(along / reach, 0.0), 1.0) if reach > 0.0 else 1.0
    return 1.0 - u * u * (3.0 - 2.0 * u)


@kernel
def _arc_of_a_turn(canonical: NDArray[np.float64]) -> float:
    """Arc length [cm] in which a canonical strand (n, 3) goes around once, by its distance from the axis; 0 on it."""
    away = 0.0
    across = 0.0
    arc = 0.0
    for i in range(canonical.shape[0] - 1):
        x, y, z = canonical[i + 1] - canonical[i]
        step = np.sqrt(x * x + y * y + z * z)
        away += step * np.hypot(canonical[i, 0], canonical[i, 1])
        across += np.hypot(x, y)
        arc += step
    return 2.0 * np.pi * away / across if across > 0.0 else 0.0


@kernel
def seat(canonical: NDArray[np.float64], root: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Turn a canonical strand (n, 3) about its axis and let it start at ``root`` (3,), in canonical space."""
    n = canonical.shape[0]
    cosine = np.cos(angle)
    sine = np.sin(angle)
    out = np.empty((n, 3))
    for i in range(n):
        out[i, 0] = cosine * canonical[i, 0] - sine * canonical[i, 1]
        out[i, 1] = sine * canonical[i, 0] + cosine * canonical[i, 1]
        out[i, 2] = canonical[i, 2] - canonical[0, 2]
    length = -out[n - 1, 2]
    turn = _arc_of_a_turn(canonical)
    gentle = max(BLEND_TURNS * turn, ROOT_RADII * np.hypot(root[0], root[1]))
    across = max(LEAST_BLEND_TURNS * turn, min(gentle, BLEND_SHARE * length))
    down = min(across, BLEND_SHARE * length)
    shift = root - out[0]
    for i in range(n):
        weight = _blend(-out[i, 2], across)
        out[i, 2] += _blend(-out[i, 2], down) * shift[2]
        for c in range(2):
            out[i, c] += weight * shift[c]
    out[0] = root
    return out


@parallel_kernel
def place(
    canonical: NDArray[np.float64],
    offsets: NDArray[np.int64],
    guides: NDArray[np.float64],
    guide_offsets: NDArray[np.int64],
    roots: NDArray[np.float64],
    angles: NDArray[np.float64],
) -> NDArray[np.float64]:
    """World-space strands (P, 3) [cm] of canonical ones (P, 3), each turned about its axis and set on its guide.

    guides: (G, 3), guide s in rows guide_offsets[s] to guide_offsets[s + 1]. roots: (S, 3), where each strand starts
    in the canonical space of its guide. angles: (S,) [rad].
    """
    out = np.empty_like(canonical)
    for s in prange(offsets.shape[0] - 1):
        a = offsets[s]
        b = offsets[s + 1]
        seated = seat(canonical[a:b], roots[s], angles[s])
        out[a:b] = bend_onto(seated, guides[guide_offsets[s] : guide_offsets[s + 1]])
    return out


@parallel_kernel
def resample(
    points: NDArray[np.float64], offsets: NDArray[np.int64], new_offsets: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Strands (P, 3) evenly resampled to other point counts, (Q, 3), both ends kept."""
    out = np.empty((new_offsets[-1], 3))
    for s in prange(offsets.shape[0] - 1):
        strand = distinct_points(points[offsets[s] : offsets[s + 1]])
        out[new_offsets[s] : new_offsets[s + 1]] = resample_strand(strand, new_offsets[s + 1] - new_offsets[s])
    return out


def cut(
    points: NDArray[np.float64], offsets: NDArray[np.int64], measure: NDArray[np.float64], ends: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Strands cut where ``measure`` (P,), 0 at their roots, first reaches ``ends`` (S,), and their offsets.

    A strand that never gets there, or whose end is infinite, stays whole.
    """
    strands = len(offsets) - 1
    strand = np.repeat(np.arange(strands), np.diff(offsets))
    beyond = np.flatnonzero(measure >= ends[strand])
    hit, where = np.unique(strand[beyond], return_index=True)
    last = offsets[1:] - 1
    last[hit] = np.maximum(beyond[where], offsets[hit] + 1)
    end = last[hit]
    low = measure[end - 1]
    rise = measure[end] - low
    part = np.clip((ends[hit] - low) / np.where(rise > 0.0, rise, 1.0), 1e-6, 1.0)
    new = points.copy()
    new[end] = points[end - 1] + part[:, None] * (points[end] - points[end - 1])
    rows = np.flatnonzero(np.arange(len(points)) <= last[strand])
    return new[rows], offsets_of(last - offsets[:-1] + 1)
