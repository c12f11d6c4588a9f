"""New strands on their guides and out of the head: coils are wider than what they replace.

Paper section "Treating Interpenetrations" turns strands about their roots. A coil around a guide that lies on the scalp
would have to be turned until its tip is centimetres off, so here it is first turned about its own axis, to start on
the side of the head, and then its guide is lifted off the head where the coil needs room, no further. The strand's
shape about its guide and its length along it stay exact; what is still inside then is pushed out point by point.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from detangled.geometry.spline import chord_lengths
from detangled.grooming.head_distance import HeadDistance, distance_and_gradient, distance_at
from detangled.grooming.interpenetration import ROOT
from detangled.grooming.placing import bend, dense_guide, seat
from detangled.kernels import kernel, parallel_kernel, prange

ANGLES = 12  # about a strand's own axis that are tried
START = 4.0  # turns of it, from the root, that the angle is judged by
ROUNDS = 10  # of lifting and looking again
BEYOND = 1.1  # of the need: a direction that is not quite that of the surface brings a little less
STEEPEST = 1.0  # of a lift's height over the way from the root
MOST_LIFT = 3.0  # [cm] more is another hairstyle
PUSHES = 6
PUSHED_SHARE = 0.25  # of a turn to either side that goes along with a point that is pushed


class Room(NamedTuple):
    """What strands need to be kept out of a head.

    head: distances. clearance: [cm] of the strands' centres from the surface. window: [cm] of the guide in which a
    strand goes round once; the lift of a guide changes no faster. turn: [cm] of hair in such a turn.
    """

    head: HeadDistance
    clearance: float
    window: float
    turn: float


class Lifted(NamedTuple):
    """Strands (P, 3) [cm], and how far each one's guide was lifted and its points were pushed at most, (S,) [cm]."""

    points: NDArray[np.float64]
    lifts: NDArray[np.float64]
    pushes: NDArray[np.float64]


def place_outside(
    canonical: NDArray[np.float64],
    offsets: NDArray[np.int64],
    guides: NDArray[np.float64],
    guide_offsets: NDArray[np.int64],
    roots: NDArray[np.float64],
    angles: NDArray[np.float64],
    room: Room,
) -> Lifted:
    """World-space strands (P, 3) [cm] as of ``placing.place``, kept out of a head."""
    return Lifted(*_place_outside(canonical, offsets, guides, guide_offsets, roots, angles, *room))


@parallel_kernel
def _place_outside(
    canonical: NDArray[np.float64],
    offsets: NDArray[np.int64],
    guides: NDArray[np.float64],
    guide_offsets: NDArray[np.int64],
    roots: NDArray[np.float64],
    angles: NDArray[np.float64],
    head: HeadDistance,
    clearance: float,
    window: float,
    turn: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    out = np.empty_like(canonical)
    lifts = np.zeros(offsets.shape[0] - 1)
    pushes = np.zeros(offsets.shape[0] - 1)
    for s in prange(offsets.shape[0] - 1):
        own = canonical[offsets[s] : offsets[s + 1]]
        dense, along = dense_guide(guides[guide_offsets[s] : guide_offsets[s + 1]])
        angle = _outward_angle(own, roots[s], angles[s], dense, along, head, clearance, START * window)
        seated = seat(own, roots[s], angle)
        world, lifts[s] = _lifted(seated, dense, along, head, clearance, window)
        pushes[s] = _push(world, head, clearance, PUSHED_SHARE * turn)
        out[offsets[s] : offsets[s + 1]] = world
    return out, lifts, pushes


@kernel
def _outward_angle(
    own: NDArray[np.float64],
    root: NDArray[np.float64],
    angle: float,
    dense: NDArray[np.float64],
    along: NDArray[np.float64],
    head: HeadDistance,
    clearance: float,
    start: float,
) -> float:
    """The angle about its axis, nearest to its own, at which a canonical strand's start is least inside the head."""
    first = own[0, 2]
    count = 0
    while count < own.shape[0] and first - own[count, 2] <= start:
        count += 1
    best, chosen = np.inf, angle
    for n in range(ANGLES):
        # Its own one, then further off to either side.
        side = 1 - 2 * (n % 2)
        tried = angle + side * ((n + 1) // 2) * (2.0 * np.pi / ANGLES)
        world = bend(seat(own, root, tried)[:count], dense, along)
        way = chord_lengths(world)
        need = 0.0
        for i in range(count):
            if way[i] > ROOT:
                d = distance_at(head, world[i, 0], world[i, 1], world[i, 2])
                need += max(clearance - d, 0.0)
        if need < best:
            best, chosen = need, tried
        if best == 0.0:
            break
    return chosen


@kernel
def _lifted(
    seated: NDArray[np.float64],
    dense: NDArray[np.float64],
    along: NDArray[np.float64],
    head: HeadDistance,
    clearance: float,
    window: float,
) -> tuple[NDArray[np.float64], float]:
    """A seated strand on its guide, lifted where it would enter the head, and the height of the lift [cm]."""
    world = bend(seated, dense, along)
    m = dense.shape[0]
    spacing = along[m - 1] / (m - 1)
    wide = max(1, min(int(window / spacing), m // 4))
    wanted = np.zeros((m, 3))
    at = along
    height = 0.0
    for _ in range(ROUNDS):
        needs, ways = _needs(world, seated, at, head, clearance)
        if needs.max() == 0.0:
            break
        rise = _smooth(_dilated(needs, wide), wide // 2 + 1)
        for c in range(3):
            ways[:, c] = _smooth(_smooth(ways[:, c].copy(), wide), wide)
        lifted = np.empty_like(dense)
        height = 0.0
        for k in range(m):
            size = np.sqrt(ways[k, 0] ** 2 + ways[k, 1] ** 2 + ways[k, 2] ** 2)
            if size > 0.0:
                for c in range(3):
                    wanted[k, c] += BEYOND * rise[k] * ways[k, c] / size
            high = np.sqrt(wanted[k, 0] ** 2 + wanted[k, 1] ** 2 + wanted[k, 2] ** 2)
            if high > MOST_LIFT:
                wanted[k] *= MOST_LIFT / high
                high = MOST_LIFT
            # The root stays, and from it the guide may rise so fast.
            reach = STEEPEST * along[k]
            share = reach / np.sqrt(reach * reach + high * high) if high > 0.0 else 1.0
            height = max(height, share * high)
            for c in range(3):
                lifted[k, c] = dense[k, c] + share * wanted[k, c]
        at = chord_lengths(lifted)
        world = bend(seated, lifted, at)
    return world, height


@kernel
def _needs(
    world: NDArray[np.float64],
    seated: NDArray[np.float64],
    along: NDArray[np.float64],
    head: HeadDistance,
    clearance: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How much room (m,) [cm] each sample of a guide lacks, and the ways out (m, 3), weighted by it.

    A point of the strand belongs to the sample that is as far ``along`` (m,) the guide as it is down its axis.
    """
    m = along.shape[0]
    needs = np.zeros(m)
    ways = np.zeros((m, 3))
    way = 0.0
    k = 0
    for i in range(world.shape[0]):
        if i > 0:
            way += np.sqrt(((world[i] - world[i - 1]) ** 2).sum())
        if way <= ROOT:
            continue
        d, gx, gy, gz = distance_and_gradient(head, world[i, 0], world[i, 1], world[i, 2])
        need = clearance - d
        if need <= 0.0:
            continue
        s = -seated[i, 2]
        while k < m - 1 and along[k + 1] < s:
            k += 1
        while k > 0 and along[k] > s:
            k -= 1
        needs[k] = max(needs[k], need)
        ways[k, 0] += need * gx
        ways[k, 1] += need * gy
        ways[k, 2] += need * gz
    return needs, ways


@kernel
def _dilated(needs: NDArray[np.float64], wide: int) -> NDArray[np.float64]:
    """The largest of the needs (m,) within so many samples."""
    m = needs.shape[0]
    out = np.zeros(m)
    for k in range(m):
        if needs[k] > 0.0:
            for j in range(max(k - wide, 0), min(k + wide + 1, m)):
                out[j] = max(out[j], needs[k])
    return out


@kernel
def _smooth(rise: NDArray[np.float64], wide: int) -> NDArray[np.float64]:
    """Means (m,) over so many samples to either side; those beyond the ends are like the ends."""
    m = rise.shape[0]
    total = np.zeros(m + 1)
    for k in range(m):
        total[k + 1] = total[k] + rise[k]
    out = np.empty(m)
    for k in range(m):
        low, high = k - wide, k + wide + 1
        inner = total[min(high, m)] - total[max(low, 0)]
        out[k] = (inner + max(-low, 0) * rise[0] + max(high - m, 0) * rise[m - 1]) / (2 * wide + 1)
    return out


@kernel
def _push(
    world: NDArray[np.float64],
    head: HeadDistance,
    clearance: float,
    reach: float,
) -> float:
    """Push points (n, 3) that are still inside out, their neighbours within ``reach`` [cm] along. Changes ``world``.

    Returns by how much at most [cm].
    """
    n = world.shape[0]
    before = world.copy()
    for _ in range(PUSHES):
        way = chord_lengths(world)
        moves = np.zeros((n, 3))
        weights = np.zeros(n)
        done = True
        for i in range(n):
            if way[i] <= ROOT:
                continue
            d, gx, gy, gz = distance_and_gradient(head, world[i, 0], world[i, 1], world[i, 2])
            size = np.sqrt(gx * gx + gy * gy + gz * gz)
            need = clearance - d
            if need <= 0.0 or size == 0.0:
                continue
            done = False
            for side in (-1, 1):
                j = i if side < 0 else i + 1
                while 0 <= j < n and abs(way[j] - way[i]) < reach:
                    # The largest push that a neighbour asks for, falling off evenly with the way there.
                    part = need * (1.0 - abs(way[j] - way[i]) / reach) * min(1.0, way[j] / ROOT)
                    if part > weights[j]:
                        weights[j] = part
                        moves[j, 0], moves[j, 1], moves[j, 2] = part * gx / size, part * gy / size, part * gz / size
                    j += side
        if done:
            break
        world += moves
    return np.sqrt(((world - before) ** 2).sum(axis=1).max())
