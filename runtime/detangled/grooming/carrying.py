"""Strands bound to guides, and carried with them where the guides go."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.geometry.canonical import guide_frames
from detangled.geometry.frenet import transport
from detangled.grooming.placing import dense_guide
from detangled.kernels import kernel, parallel_kernel, prange

# A point's place on a guide is where the guide passes it square: found by going along from the place before, so many
# steps at most. Where a guide bends inside the curl there may be none, and any place near will do.
MOST_STEPS = 12
CLOSE = 1e-9


@kernel
def _place(at: float, m: int) -> tuple[int, float]:
    """The sample at or before a place from 0 to m, and how far it is to the next."""
    k = min(max(int(np.floor(at)), 0), m - 1)
    return k, at - k


@kernel
def _frame(frames: NDArray[np.float64], at: float, m: int, out: NDArray[np.float64]) -> None:
    """The frame (3, 3) of a finely sampled guide at a place from 0 to m, evenly turned between samples, in place.

    Rows are the world directions of canonical x, y and z.
    """
    # A frame belongs to the middle of its segment.
    middle = at - 0.5
    below = min(max(int(np.floor(middle)), 0), m - 2)
    inside = min(max(middle - below, 0.0), 1.0)
    for a in range(2):
        for c in range(3):
            out[a, c] = frames[below, a, c] * (1.0 - inside) + frames[below + 1, a, c] * inside
    size = np.sqrt(out[0, 0] ** 2 + out[0, 1] ** 2 + out[0, 2] ** 2)
    along = 0.0
    for c in range(3):
        out[0, c] /= size
        along += out[0, c] * out[1, c]
    size = 0.0
    for c in range(3):
        out[1, c] -= along * out[0, c]
        size += out[1, c] ** 2
    size = np.sqrt(size)
    for c in range(3):
        out[1, c] /= size
    for c in range(3):
        a = (c + 1) % 3
        b = (c + 2) % 3
        out[2, c] = out[0, a] * out[1, b] - out[0, b] * out[1, a]


@parallel_kernel
def bound(
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    drivers: NDArray[np.int64],
    guides: NDArray[np.float64],
    guide_offsets: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Each point's place along its guide, (Q,) [cm], and where it is in the guide's frame there, (Q, 3) [cm].

    points: strands (Q, 3) [cm]. drivers: (S,), the guide of each strand; one below 0 has none.
    """
    places = np.zeros(points.shape[0])
    local = np.zeros((points.shape[0], 3))
    for s in prange(offsets.shape[0] - 1):
        g = drivers[s]
        if g < 0:
            continue
        dense, along = dense_guide(guides[guide_offsets[g] : guide_offsets[g + 1]])
        frames = guide_frames(dense)
        m = dense.shape[0] - 1
        frame = np.empty((3, 3))
        away = np.empty(3)
        at = 0.0
        for i in range(offsets[s], offsets[s + 1]):
            for step in range(MOST_STEPS + 1):
                k, part = _place(at, m)
                _frame(frames, at, m, frame)
                ahead = 0.0
                for c in range(3):
                    away[c] = points[i, c] - dense[k, c] - part * (dense[k + 1, c] - dense[k, c])
                    ahead -= away[c] * frame[2, c]
                there = min(max(at + ahead / (along[k + 1] - along[k]), 0.0), float(m))
                if step == MOST_STEPS or abs(there - at) < CLOSE:
                    break
                at = there
            k, part = _place(at, m)
            places[i] = along[k] + part * (along[k + 1] - along[k])
            for a in range(3):
                for c in range(3):
                    local[i, a] += frame[a, c] * away[c]
    return places, local


@kernel
def _roll(old: NDArray[np.float64], new: NDArray[np.float64], rotation: NDArray[np.float64]) -> tuple[float, float]:
    """Cosine and sine of the angle by which a guide's first frame is to be turned about it.

    old, new: first frames (3, 3), rows the directions of x, y and z, of the guide where it rested and where it is.
    The old one goes with the root's rotation (3, 3), and on by the least turn to the new direction.
    """
    x = (0.0, 0.0, 0.0)
    down = (0.0, 0.0, 0.0)
    for c in range(3):
        x = (
            x[0] + rotation[0, c] * old[0, c],
            x[1] + rotation[1, c] * old[0, c],
            x[2] + rotation[2, c] * old[0, c],
        )
        down = (
            down[0] - rotation[0, c] * old[2, c],
            down[1] - rotation[1, c] * old[2, c],
            down[2] - rotation[2, c] * old[2, c],
        )
    x = transport(x, down, (-new[2, 0], -new[2, 1], -new[2, 2]))
    cosine = x[0] * new[0, 0] + x[1] * new[0, 1] + x[2] * new[0, 2]
    sine = x[0] * new[1, 0] + x[1] * new[1, 1] + x[2] * new[1, 2]
    size = np.sqrt(cosine * cosine + sine * sine)
    return cosine / size, sine / size


@parallel_kernel
def first_frames(guides: NDArray[np.float64], offsets: NDArray[np.int64]) -> NDArray[np.float64]:
    """Frames (S, 3, 3) of guides (G, 3) at their roots: rows are the world directions of canonical x, y and z."""
    out = np.empty((offsets.shape[0] - 1, 3, 3))
    for s in prange(offsets.shape[0] - 1):
        dense, _ = dense_guide(guides[offsets[s] : offsets[s + 1]])
        out[s] = guide_frames(dense[:2])[0]
    return out


@parallel_kernel
def carried(
    local: NDArray[np.float64],
    places: NDArray[np.float64],
    offsets: NDArray[np.int64],
    drivers: NDArray[np.int64],
    lengths: NDArray[np.float64],
    guides: NDArray[np.float64],
    guide_offsets: NDArray[np.int64],
    old_frames: NDArray[np.float64],
    rotations: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Strands (Q, 3) [cm] that were bound to guides, on these guides as they are now (G, 3).

    old_frames, rotations: (R, 3, 3), of the guides' roots where the strands were bound (``first_frames``), and how the
    roots turned since. lengths: (S,) [cm], of the strands' polylines, which they keep: what bending does to them, some
    ten-thousandths, is taken back by their size. Beyond a guide's end strands go on straight; without a guide are 0.
    """
    out = np.zeros((local.shape[0], 3))
    for s in prange(offsets.shape[0] - 1):
        g = drivers[s]
        if g < 0:
            continue
        dense, along = dense_guide(guides[guide_offsets[g] : guide_offsets[g + 1]])
        frames = guide_frames(dense)
        m = dense.shape[0] - 1
        cosine, sine = _roll(old_frames[g], frames[0], rotations[g])
        frame = np.empty((3, 3))
        k = 0
        length = 0.0
        for i in range(offsets[s], offsets[s + 1]):
            while k < m - 1 and places[i] > along[k + 1]:
                k += 1
            while k > 0 and places[i] < along[k]:
                k -= 1
            part = min((places[i] - along[k]) / (along[k + 1] - along[k]), 1.0)
            _frame(frames, k + part, m, frame)
            x = cosine * local[i, 0] - sine * local[i, 1]
            y = sine * local[i, 0] + cosine * local[i, 1]
            z = local[i, 2] - max(places[i] - along[m], 0.0)
            gap = 0.0
            for c in range(3):
                on = dense[k, c] + part * (dense[k + 1, c] - dense[k, c])
                out[i, c] = on + x * frame[0, c] + y * frame[1, c] + z * frame[2, c]
                if i > offsets[s]:
                    gap += (out[i, c] - out[i - 1, c]) ** 2
            length += np.sqrt(gap)
        root = offsets[s]
        for i in range(root + 1, offsets[s + 1]):
            for c in range(3):
                out[i, c] = out[root, c] + (out[i, c] - out[root, c]) * (lengths[s] / length if length > 0.0 else 1.0)
    return out
