"""Frenet-Serret frames of a curve and the curve of a curvature-torsion-speed signal.

Paper sections "Differentiable Curves" (the robust frame) and "Strand Reconstruction" (Runge-Kutta integration).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import kernel

# A derivative this short (of unit speed, or per cm) has no direction of its own.
TINY = 1e-9
# Where the strand curves less than this share of its mean curvature, its normal is noise.
PARALLEL_RELATIVE = 2e-3
# A C2 cubic spline rings: past a sharp bend its curvature swings from side to side, and falls with each segment by
# 2 - sqrt(3) = 0.27 (more slowly where points are uneven). Curvature below that says nothing of the normal.
RINGING = 0.3
# Opposite unit tangents whose sum is shorter fold straight back: rounding alone would choose the plane.
FOLD = 1e-10


@kernel
def lift_tiny(derivative: NDArray[np.float64]) -> None:
    """Give samples (m, 3) shorter than TINY that length in the coordinate that varies least around them, in place."""
    m = derivative.shape[0]
    for i in range(m):
        norm2 = derivative[i, 0] ** 2 + derivative[i, 1] ** 2 + derivative[i, 2] ** 2
        if norm2 < TINY * TINY:
            low = max(0, i - 1)
            high = min(m - 1, i + 1)
            least = 0
            least_change = np.inf
            for c in range(3):
                change = abs(derivative[high, c] - derivative[low, c])
                if change < least_change:
                    least_change = change
                    least = c
            derivative[i, least] = TINY


@kernel
def _row(array: NDArray[np.float64], i: int) -> tuple[float, float, float]:
    return array[i, 0], array[i, 1], array[i, 2]


@kernel
def _set_row(array: NDArray[np.float64], i: int, vector: tuple[float, float, float]) -> None:
    array[i, 0], array[i, 1], array[i, 2] = vector


@kernel
def dot(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    """Inner product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    """Vector product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def any_perpendicular(t: tuple[float, float, float]) -> tuple[float, float, float]:
    """A unit vector perpendicular to the unit vector ``t``, the same one for the same t."""
    x, y, z = abs(t[0]), abs(t[1]), abs(t[2])
    if x <= y and x <= z:
        side = cross(t, (1.0, 0.0, 0.0))
    elif y <= z:
        side = cross(t, (0.0, 1.0, 0.0))
    else:
        side = cross(t, (0.0, 0.0, 1.0))
    size = np.sqrt(dot(side, side))
    return side[0] / size, side[1] / size, side[2] / size


@kernel
def transport(
    vector: tuple[float, float, float], t0: tuple[float, float, float], t1: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Carry ``vector`` by the least rotation that turns the unit tangent ``t0`` to the unit tangent ``t1``.

    Two reflections: across the plane between the two, then along t1. A fold straight back is half a turn about a
    perpendicular, the same one each time.
    """
    half = (t0[0] + t1[0], t0[1] + t1[1], t0[2] + t1[2])
    size2 = dot(half, half)
    if size2 < FOLD * FOLD:
        side = any_perpendicular(t0)
        along = 2.0 * dot(side, vector)
        return along * side[0] - vector[0], along * side[1] - vector[1], along * side[2] - vector[2]
    across = -2.0 * dot(half, vector) / size2
    onto = 2.0 * dot(t0, vector)
    return (
        vector[0] + across * half[0] + onto * t1[0],
        vector[1] + across * half[1] + onto * t1[1],
        vector[2] + across * half[2] + onto * t1[2],
    )


@kernel
def turn_about(
    t: tuple[float, float, float], vector: tuple[float, float, float], angle: float
) -> tuple[float, float, float]:
    """Turn ``vector``, perpendicular to the unit axis ``t``, by ``angle`` [rad] about it."""
    side = cross(t, vector)
    c = np.cos(angle)
    s = np.sin(angle)
    return c * vector[0] + s * side[0], c * vector[1] + s * side[1], c * vector[2] + s * side[2]


@kernel
def bend_angle(tangent: NDArray[np.float64], i: int) -> float:
    """Angle between the unit tangents i and i + 1, in [0, pi]."""
    here = _row(tangent, i)
    there = _row(tangent, i + 1)
    axis = cross(here, there)
    return np.arctan2(np.sqrt(dot(axis, axis)), dot(here, there))


@kernel
def twist_angle(tangent: NDArray[np.float64], normal: NDArray[np.float64], i: int) -> float:
    """Angle about the tangent from normal i, carried along to sample i + 1, to the normal there, in (-pi, pi]."""
    there = _row(tangent, i + 1)
    carried = transport(_row(normal, i), _row(tangent, i), there)
    found = _row(normal, i + 1)
    return np.arctan2(dot(cross(carried, found), there), dot(carried, found))


@kernel
def frames(
    first: NDArray[np.float64], second: NDArray[np.float64], step: float, per_segment: float, least_bend: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Unit tangents, unit normals (m, 3) and where the normal is the curve's own, from gamma' and gamma'' (m, 3).

    Samples are ``step`` [cm] apart, ``per_segment`` of them between two points of the strand. A normal is the
    curve's own where the curvature is at least PARALLEL_RELATIVE of the curve's mean, such that all of the curve
    would bend by ``least_bend`` [rad], and where it is not ringing beside a straight stretch.

    Between two stretches with normals of their own, the normal turns evenly from one to the other, as seen from the
    tangent carried along; before the first and after the last it is carried along unturned; on a curve with none,
    one arbitrary normal is carried along all of it.
    """
    m = first.shape[0]
    tangent = np.empty((m, 3))
    normal = np.empty((m, 3))
    curvature = np.empty(m)
    arc = 0.0
    bend = 0.0
    for i in range(m):
        velocity = _row(first, i)
        speed = np.sqrt(dot(velocity, velocity))
        if speed > 0.0:
            for c in range(3):
                tangent[i, c] = first[i, c] / speed
        elif i > 0:
            for c in range(3):
                tangent[i, c] = tangent[i - 1, c]
        else:
            tangent[i, 0], tangent[i, 1], tangent[i, 2] = 0.0, 0.0, -1.0
        along = dot(_row(second, i), _row(tangent, i))
        for c in range(3):
            normal[i, c] = second[i, c] - along * tangent[i, c]
        across = _row(normal, i)
        # No more than a turn right back between two samples.
        most = np.pi / step
        curvature[i] = min(np.sqrt(dot(across, across)) / speed, most) / speed if speed > 0.0 else 0.0
        arc += speed * step
        if i > 0:
            bend += bend_angle(tangent, i - 1)
    least = max(PARALLEL_RELATIVE * bend, least_bend) / arc
    own = _own_normals(curvature, least, per_segment)
    last = -1
    for i in range(m):
        if not own[i]:
            continue
        across = _row(normal, i)
        norm = np.sqrt(dot(across, across))
        for c in range(3):
            normal[i, c] /= norm
        if last < 0:
            for j in range(i - 1, -1, -1):
                _carry(tangent, normal, j + 1, j)
        elif i > last + 1:
            _turn_evenly(tangent, normal, last, i)
        last = i
    if last < 0:
        _set_row(normal, 0, any_perpendicular(_row(tangent, 0)))
        last = 0
    for j in range(last + 1, m):
        _carry(tangent, normal, j - 1, j)
    return tangent, normal, own


@kernel
def _own_normals(curvature: NDArray[np.float64], least: float, per_segment: float) -> NDArray[np.bool_]:
    """Where the curvature (m,) says where the normal is: at least ``least``, and no ringing (m,)."""
    m = curvature.shape[0]
    own = np.empty(m, dtype=np.bool_)
    fall = RINGING ** (1.0 / per_segment)
    root_side = 0.0
    for i in range(m):
        root_side *= fall
        own[i] = curvature[i] > 0.0 and curvature[i] >= max(least, root_side)
        root_side = max(root_side, curvature[i])
    tip_side = 0.0
    for i in range(m - 1, -1, -1):
        tip_side *= fall
        own[i] &= curvature[i] >= tip_side
        tip_side = max(tip_side, curvature[i])
    # Ringing runs out in a straight stretch. A dip between two bends has none: its normals are the curve's.
    i = 0
    while i < m:
        start = i
        straight = 0
        longest = 0
        while i < m and not own[i]:
            straight = straight + 1 if curvature[i] <= least else 0
            longest = max(longest, straight)
            i += 1
        if longest < per_segment:
            for j in range(start, i):
                own[j] = curvature[j] > 0.0 and curvature[j] >= least
        i += 1
    return own


@kernel
def _carry(tangent: NDArray[np.float64], normal: NDArray[np.float64], i: int, j: int) -> None:
    """Carry normal i along to sample j."""
    there = _row(tangent, j)
    carried = transport(_row(normal, i), _row(tangent, i), there)
    # Rounding adds up over thousands of samples.
    along = dot(carried, there)
    across = (carried[0] - along * there[0], carried[1] - along * there[1], carried[2] - along * there[2])
    size = np.sqrt(dot(across, across))
    for c in range(3):
        normal[j, c] = across[c] / size


@kernel
def _turn_evenly(tangent: NDArray[np.float64], normal: NDArray[np.float64], first: int, last: int) -> None:
    """Fill the normals strictly between two samples, turning by equal angles about the tangent."""
    found = _row(normal, last)
    for j in range(first + 1, last + 1):
        _carry(tangent, normal, j - 1, j)
    carried = _row(normal, last)
    angle = np.arctan2(dot(cross(carried, found), _row(tangent, last)), dot(carried, found))
    for j in range(first + 1, last):
        share = (j - first) / (last - first)
        _set_row(normal, j, turn_about(_row(tangent, j), _row(normal, j), share * angle))
    _set_row(normal, last, found)


@kernel
def integrate(signal: NDArray[np.float64], substeps: int) -> NDArray[np.float64]:
    """Positions (L * substeps + 1, 3) [cm] of the curve with these cells (L, 3), from the origin.

    kappa, tau [1/cm] and v [cm per unit of t, t from 0 to 1] are constant in each cell. Frame and position by
    fourth-order Runge-Kutta, the frame re-orthonormalised at each step; T, N, B start as -z, x, -y. Within a cell
    the equations are linear with constant coefficients, so that each Runge-Kutta step is the same matrix: the
    exponential's series to the fourth power.
    """
    cells = signal.shape[0]
    out = np.zeros((cells * substeps + 1, 3))
    f = np.zeros((3, 3))  # rows T, N, B
    f[0, 2] = -1.0
    f[1, 0] = 1.0
    f[2, 1] = -1.0
    turn = np.empty((3, 3))
    weight = np.empty(3)
    row = 0
    for i in range(cells):
        h = signal[i, 2] / cells / substeps
        _runge_kutta(signal[i, 0] * h, signal[i, 1] * h, turn, weight)
        for _ in range(substeps):
            for c in range(3):
                t, n, b = f[0, c], f[1, c], f[2, c]
                out[row + 1, c] = out[row, c] + h * (weight[0] * t + weight[1] * n + weight[2] * b)
                for k in range(3):
                    f[k, c] = turn[k, 0] * t + turn[k, 1] * n + turn[k, 2] * b
            _orthonormalise(f)
            row += 1
    return out


@kernel
def _runge_kutta(k: float, w: float, turn: NDArray[np.float64], weight: NDArray[np.float64]) -> None:
    """The matrix (3, 3) that carries the rows T, N, B over a step with angles k of bending and w of torsion [rad].

    weight (3,): the shares of T, N, B in the step's mean tangent, by the weights 1, 2, 2, 1 of the four stages.
    """
    # Powers of A = [[0, k, 0], [-k, 0, w], [0, -w, 0]]: A^3 = -(k^2 + w^2) A.
    q = k * k + w * w
    odd = 1.0 - q / 6.0
    even = 0.5 - q / 24.0
    turn[0, 0] = 1.0 - even * k * k
    turn[0, 1] = odd * k
    turn[0, 2] = even * k * w
    turn[1, 0] = -odd * k
    turn[1, 1] = 1.0 - even * q
    turn[1, 2] = odd * w
    turn[2, 0] = even * k * w
    turn[2, 1] = -odd * w
    turn[2, 2] = 1.0 - even * w * w
    weight[0] = 1.0 - k * k / 6.0
    weight[1] = k * (0.5 - q / 24.0)
    weight[2] = k * w / 6.0


@kernel
def _orthonormalise(f: NDArray[np.float64]) -> None:
    """Make the rows T, N, B orthonormal again, T first (Gram-Schmidt)."""
    t = f[0]
    n = f[1]
    norm = np.sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])
    for c in range(3):
        t[c] /= norm
    dot = t[0] * n[0] + t[1] * n[1] + t[2] * n[2]
    for c in range(3):
        n[c] -= dot * t[c]
    norm = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    for c in range(3):
        n[c] /= norm
    f[2, 0] = t[1] * n[2] - t[2] * n[1]
    f[2, 1] = t[2] * n[0] - t[0] * n[2]
    f[2, 2] = t[0] * n[1] - t[1] * n[0]
