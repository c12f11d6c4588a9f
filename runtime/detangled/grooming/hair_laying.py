"""Render hairs laid out: their own smooth axes, gathered into wisps, with their wisps' texture on them.

What is interpolated between guides is style, as smooth as it is; texture never is, since a mean of two coils out of
step is no coil. A hair has the canonical-space points of its wisp's guide strand on an axis of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.geometry.canonical import guide_frames
from detangled.geometry.frenet import any_perpendicular, cross, dot, transport
from detangled.grooming.interpolation import add_carried, mean_normal
from detangled.kernels import kernel, parallel_kernel, prange

# A hair goes from its root to its place in the wisp over so many times their distance, but by the middle of its length.
GATHERING = 4.0
LATEST = 0.5
# A hair may be so much shorter or longer than its guide by stretching the texture, which so keeps its wavelength
# nearly; beyond, a shorter one ends within the texture, a longer one where the texture does.
MOST_STRETCH = 1.15
RANDOMS = 9  # numbers that a hair draws
FLYAWAY_REACH = 0.6  # beyond the wisp's radius, in radii, in the mean; at the tip
FLYAWAY_LEAST = 0.1
WANDER = 0.6  # of the wisp's radius: what a hair strays about its place, at a variation of 1
PHASE = 0.6  # [rad], standard deviation at a variation of 1
DRIFT = 1.0  # [rad] from root to tip
SCALE = 0.2  # logarithm of the texture's width
SHORTER = 0.12  # of the length, at a variation of 1: tips do not end together


@parallel_kernel
def axes_between(
    even: NDArray[np.float64],
    lengths: NDArray[np.float64],
    lifts: NDArray[np.float64],
    normals: NDArray[np.float64],
    parents: NDArray[np.int64],
    weights: NDArray[np.float64],
    roots: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Axes (N, m, 3) [cm] of hairs between their parents (N, k), at even steps.

    even: (G, m, 3), guides at even steps, of lengths (G,). lifts: (G, 3), from the roots of the guides' strands to the
    guides' own. normals: (G, 3) of the scalp. roots: (N, 3), of the hairs.
    """
    count, many = parents.shape
    m = even.shape[1]
    out = np.empty((count, m, 3))
    for h in prange(count):
        around = np.empty((many, 3))
        for k in range(many):
            around[k] = normals[parents[h, k]]
        turned, normal = mean_normal(around, weights[h])
        directions = np.zeros((m - 1, 3))
        lift = np.zeros((1, 3))
        length = 0.0
        for k in range(many):
            if weights[h, k] > 0.0:
                parent = parents[h, k]
                length += weights[h, k] * lengths[parent]
                add_carried(directions, even[parent], weights[h, k], turned[k], normal)
                ends = np.zeros((2, 3))
                ends[1] = lifts[parent]
                size = np.sqrt((lifts[parent] ** 2).sum())
                add_carried(lift, ends, weights[h, k] * size, turned[k], normal)
        for c in range(3):
            out[h, 0, c] = roots[h, c] + lift[0, c]
        for i in range(m - 1):
            size = max(np.sqrt((directions[i] ** 2).sum()), 1e-9)
            for c in range(3):
                out[h, i + 1, c] = out[h, i, c] + directions[i, c] / size * length / (m - 1)
    return out


@kernel
def _smooth(u: float) -> float:
    """From 0 to 1, level at both ends."""
    u = min(max(u, 0.0), 1.0)
    return u * u * (3.0 - 2.0 * u)


@kernel
def _offset(
    out: NDArray[np.float64],
    axis: NDArray[np.float64],
    guide: NDArray[np.float64],
    length: float,
    rank: float,
    flyaway: bool,
    random: NDArray[np.float64],
    radius: float,
    tight: NDArray[np.float64],
    variation: float,
) -> float:
    """Fill ``out`` (m, 3) with where a hair's axis lies beside its guide's, both (m, 3).

    tight: (m,), from 0 to 1, how much narrower than its radius the wisp is there. Returns from which share of the guide
    on the hair is in its wisp.
    """
    m = axis.shape[0]
    apart = 0.0
    for c in range(3):
        apart += (axis[0, c] - guide[0, c]) ** 2
    reach = min(GATHERING * np.sqrt(apart) / max(length, 1e-12), LATEST)
    stray = WANDER * variation * (2.0 if flyaway else rank) * radius
    for i in range(m):
        t = i / (m - 1)
        gathered = _smooth(t / reach) if reach > 0.0 else 1.0
        slow = 2.0 * np.pi * (0.5 + random[0]) * t + 2.0 * np.pi * random[1]
        fast = 2.0 * np.pi * (1.5 + 2.0 * random[2]) * t + 2.0 * np.pi * random[3]
        size = 0.0
        for c in range(3):
            beside = axis[i, c] - guide[i, c]
            phase = 2.1 * c
            beside += stray * gathered * (0.7 * np.sin(slow + phase) + 0.3 * np.sin(fast + phase))
            out[i, c] = beside
            size += beside * beside
        size = np.sqrt(size)
        if flyaway:
            wanted = max(size, radius * (1.0 + FLYAWAY_LEAST - FLYAWAY_REACH * np.log(max(1.0 - random[4], 1e-6)) * t))
        else:
            wanted = min(size, rank * radius * (1.0 - tight[i]))
        if size < 1e-9:
            # In the middle of the wisp no side is nearer than another.
            out[i, 0] += 1e-9
            size = 1e-9
        wanted = size + gathered * (wanted - size)
        for c in range(3):
            out[i, c] *= wanted / size
    return reach


@kernel
def _frames(axis: NDArray[np.float64], first: NDArray[np.float64], x0: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors x (m, 3) across an axis (m, 3), carried along it from x0, which stands on the unit vector ``first``."""
    m = axis.shape[0]
    out = np.empty((m, 3))
    x = (x0[0], x0[1], x0[2])
    down = (first[0], first[1], first[2])
    for i in range(m):
        a = max(i - 1, 0)
        b = min(i + 1, m - 1)
        step = (axis[b, 0] - axis[a, 0], axis[b, 1] - axis[a, 1], axis[b, 2] - axis[a, 2])
        size = np.sqrt(dot(step, step))
        if size > 1e-12:
            tangent = (step[0] / size, step[1] / size, step[2] / size)
            x = transport(x, down, tangent)
            down = tangent
            along = dot(x, down)
            x = (x[0] - along * down[0], x[1] - along * down[1], x[2] - along * down[2])
            size = np.sqrt(dot(x, x))
            x = (x[0] / size, x[1] / size, x[2] / size) if size > 1e-9 else any_perpendicular(down)
        out[i, 0] = x[0]
        out[i, 1] = x[1]
        out[i, 2] = x[2]
    return out


@kernel
def _lay(
    out: NDArray[np.float64],
    root: NDArray[np.float64],
    axis: NDArray[np.float64],
    across: NDArray[np.float64],
    texture: NDArray[np.float64],
    guide_length: float,
    random: NDArray[np.float64],
    variation: float,
) -> None:
    """Fill ``out`` (n, 3) with a hair: its wisp's texture (n, 3), in canonical space, on its axis (m, 3)."""
    m = axis.shape[0]
    n = out.shape[0]
    own = 0.0
    for i in range(m - 1):
        step = 0.0
        for c in range(3):
            step += (axis[i + 1, c] - axis[i, c]) ** 2
        own += np.sqrt(step)
    ratio = own / max(guide_length, 1e-12)
    stretch = min(max(ratio, 1.0 / MOST_STRETCH), MOST_STRETCH)
    share = min(ratio / stretch, 1.0) * (1.0 - SHORTER * variation * random[5])
    wider = np.exp(SCALE * variation * random[6])
    turn = PHASE * variation * random[7]
    drift = DRIFT * variation * random[8]
    # The end of the hair within the texture: where its axis has gone that share of the way.
    last = n - 1.0
    for i in range(1, n):
        if -texture[i, 2] >= share * guide_length:
            rise = texture[i - 1, 2] - texture[i, 2]
            last = i - 1 + ((share * guide_length + texture[i - 1, 2]) / rise if rise > 0.0 else 1.0)
            break
    last = max(last, min(1.0, n - 1.0))
    for i in range(n):
        at = last * i / (n - 1)
        k = min(int(at), n - 2)
        part = at - k
        u = texture[k, 0] + part * (texture[k + 1, 0] - texture[k, 0])
        v = texture[k, 1] + part * (texture[k + 1, 1] - texture[k, 1])
        z = -(texture[k, 2] + part * (texture[k + 1, 2] - texture[k, 2]))
        s = z * stretch / own * (m - 1) if own > 0.0 else 0.0
        angle = turn + drift * i / (n - 1)
        cosine = np.cos(angle) * wider
        sine = np.sin(angle) * wider
        u, v = cosine * u - sine * v, sine * u + cosine * v
        j = min(max(int(np.floor(s)), 0), m - 2)
        f = s - j
        inside = min(max(f, 0.0), 1.0)
        before = max(j - 1, 0)
        after = min(j + 2, m - 1)
        x = (0.0, 0.0, 0.0)
        tangent = (0.0, 0.0, 0.0)
        x = (
            across[j, 0] + inside * (across[j + 1, 0] - across[j, 0]),
            across[j, 1] + inside * (across[j + 1, 1] - across[j, 1]),
            across[j, 2] + inside * (across[j + 1, 2] - across[j, 2]),
        )
        place = np.empty(3)
        slope = np.empty(3)
        for c in range(3):
            a = 0.5 * (axis[j + 1, c] - axis[before, c]) if before < j else axis[j + 1, c] - axis[j, c]
            b = 0.5 * (axis[after, c] - axis[j, c]) if after > j + 1 else axis[j + 1, c] - axis[j, c]
            rise = axis[j + 1, c] - axis[j, c]
            g = inside
            place[c] = axis[j, c] + g * a + g * g * (3.0 * rise - 2.0 * a - b) + g * g * g * (a + b - 2.0 * rise)
            slope[c] = a + 2.0 * g * (3.0 * rise - 2.0 * a - b) + 3.0 * g * g * (a + b - 2.0 * rise)
            # Straight on beyond the ends.
            place[c] += (f - inside) * slope[c]
        size = max(np.sqrt(slope[0] ** 2 + slope[1] ** 2 + slope[2] ** 2), 1e-300)
        tangent = (slope[0] / size, slope[1] / size, slope[2] / size)
        along = dot(x, tangent)
        x = (x[0] - along * tangent[0], x[1] - along * tangent[1], x[2] - along * tangent[2])
        size = max(np.sqrt(dot(x, x)), 1e-300)
        x = (x[0] / size, x[1] / size, x[2] / size)
        y = cross(x, tangent)
        for c in range(3):
            out[i, c] = place[c] + u * x[c] + v * y[c]
    # What the turn, the width and the frame moved the root by is given back, and less and less of it down the hair.
    shift = root - out[0]
    size = np.sqrt((shift * shift).sum())
    away = max(GATHERING * size, 1e-12)
    gone = 0.0
    for i in range(n):
        if i > 0:
            step = 0.0
            for c in range(3):
                step += (out[i, c] - root[c]) ** 2
            gone = max(gone, np.sqrt(step))
        left = 1.0 - _smooth(gone / away)
        if left <= 0.0:
            break
        for c in range(3):
            out[i, c] += left * shift[c]
    out[0] = root


@parallel_kernel
def laid(
    axes: NDArray[np.float64],
    even: NDArray[np.float64],
    lengths: NDArray[np.float64],
    textures: NDArray[np.float64],
    texture_offsets: NDArray[np.int64],
    guide: NDArray[np.int64],
    rank: NDArray[np.float64],
    flyaway: NDArray[np.bool_],
    leaders: NDArray[np.int64],
    roots: NDArray[np.float64],
    random: NDArray[np.float64],
    radius: float,
    clump: NDArray[np.float64],
    tuft: NDArray[np.float64],
    variation: float,
    first: int,
    offsets: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Hairs ``first`` on, as many as ``offsets`` (n + 1,) has, (Q, 3) [cm], and their axes' distances from the guides'.

    axes: (N, m, 3), of all hairs. even, lengths: (G, m, 3), (G,), of the guides. textures: (C, 3), canonical points
    of the guides' strands, by texture_offsets (G + 1,), as many as their hairs have. guide, rank, flyaway, leaders:
    see Wisps. random: (N, RANDOMS). clump: (m,), how much narrower than its radius a wisp is along it; tuft: (m,),
    how much its tufts are gathered. The distances (n,) [cm] are the greatest from where a hair is in its wisp on.
    """
    m = even.shape[1]
    out = np.empty((offsets[-1], 3))
    away = np.zeros(offsets.shape[0] - 1)
    for k in prange(offsets.shape[0] - 1):
        h = first + k
        g = guide[h]
        beside = np.empty((m, 3))
        # Flyaways vary more; what is in the middle of a wisp follows its guide.
        own = variation * (2.0 if flyaway[h] else 0.25 + 0.75 * rank[h])
        joined = _offset(beside, axes[h], even[g], lengths[g], rank[h], flyaway[h], random[h], radius, clump, variation)
        if leaders[h, 0] != h or leaders[h, 1] != h:
            near = np.empty((m, 3))
            far = np.empty((m, 3))
            # What leads a hair may join the wisp after it, and takes it along.
            for one, led in ((leaders[h, 1], near), (leaders[h, 0], far)):
                late = _offset(
                    led, axes[one], even[g], lengths[g], rank[one], flyaway[one], random[one], radius, clump, variation
                )
                joined = max(joined, late)
            for i in range(m):
                for c in range(3):
                    inner = beside[i, c] + tuft[i] * (near[i, c] - beside[i, c])
                    beside[i, c] = inner + 0.5 * tuft[i] * (far[i, c] - inner)
        axis = even[g] + beside
        for i in range(m):
            if i >= joined * (m - 1):
                away[k] = max(away[k], np.sqrt((beside[i] ** 2).sum()))
        frame = guide_frames(even[g])
        across = _frames(axis, -frame[0, 2], frame[0, 0])
        texture = textures[texture_offsets[g] : texture_offsets[g + 1]]
        _lay(out[offsets[k] : offsets[k + 1]], roots[h], axis, across, texture, lengths[g], random[h], own)
    return out, away
