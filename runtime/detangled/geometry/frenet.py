"""Frenet-Serret frames of a curve and the curve of a curvature-torsion-speed signal.

Paper sections "Differentiable Curves" (the robust frame) and "Strand Reconstruction" (Runge-Kutta integration).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import kernel

# A derivative this short [per cm, or per cm^2] has no direction of its own.
TINY = 1e-9
# Curvature below this share of the strand's root mean square, or below this absolute value [1/cm] (a bend with a
# radius of 100 m, under the rounding of float32 files), leaves the normal undefined.
PARALLEL_RELATIVE = 2e-3
PARALLEL_ABSOLUTE = 1e-4


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
    """Carry ``vector`` by the least rotation that turns the unit tangent ``t0`` to the unit tangent ``t1``."""
    axis = cross(t0, t1)
    cosine = dot(t0, t1)
    if cosine < -1.0 + 1e-12:
        # A fold straight back: half a turn about any perpendicular; the same one each time.
        axis = any_perpendicular(t0)
        along = 2.0 * dot(axis, vector)
        return along * axis[0] - vector[0], along * axis[1] - vector[1], along * axis[2] - vector[2]
    turned = cross(axis, vector)
    along = dot(axis, vector) / (1.0 + cosine)
    return (
        vector[0] * cosine + turned[0] + axis[0] * along,
        vector[1] * cosine + turned[1] + axis[1] * along,
        vector[2] * cosine + turned[2] + axis[2] * along,
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
def twist_angle(tangent: NDArray[np.float64], normal: NDArray[np.float64], i: int, j: int) -> float:
    """Angle about the tangent from normal i carried along to sample j to the normal there, in (-pi, pi]."""
    there = _row(tangent, j)
    carried = transport(_row(normal, i), _row(tangent, i), there)
    found = _row(normal, j)
    return np.arctan2(dot(cross(carried, found), there), dot(carried, found))


@kernel
def frames(
    first: NDArray[np.float64], second: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Unit tangents, unit normals (m, 3) and where the normal is the curve's own, from gamma' and gamma'' (m, 3).

    Between two stretches with normals of their own, the normal turns evenly from one to the other, as seen from
    the tangent carried along; before the first and after the last it is carried along unturned; on a curve with
    none, one arbitrary normal is carried along all of it.
    """
    m = first.shape[0]
    tangent = np.empty((m, 3))
    normal = np.zeros((m, 3))
    own = np.zeros(m, dtype=np.bool_)
    size = np.empty(m)
    mean_square = 0.0
    for i in range(m):
        velocity = _row(first, i)
        speed = np.sqrt(dot(velocity, velocity))
        for c in range(3):
            tangent[i, c] = first[i, c] / speed
        along = dot(_row(second, i), _row(tangent, i))
        for c in range(3):
            normal[i, c] = second[i, c] - along * tangent[i, c]
        across = _row(normal, i)
        size[i] = np.sqrt(dot(across, across)) / (speed * speed)
        mean_square += size[i] * size[i]
    least = max(PARALLEL_RELATIVE * np.sqrt(mean_square / m), PARALLEL_ABSOLUTE)
    last = -1
    for i in range(m):
        if size[i] < least:
            continue
        own[i] = True
        across = _row(normal, i)
        norm = np.sqrt(dot(across, across))
        for c in range(3):
            normal[i, c] /= norm
        if last < 0:
            for j in range(i - 1, -1, -1):
                normal[j] = transport(_row(normal, j + 1), _row(tangent, j + 1), _row(tangent, j))
        elif i > last + 1:
            _turn_evenly(tangent, normal, last, i)
        last = i
    if last < 0:
        normal[0] = any_perpendicular(_row(tangent, 0))
        last = 0
    for j in range(last + 1, m):
        normal[j] = transport(_row(normal, j - 1), _row(tangent, j - 1), _row(tangent, j))
    return tangent, normal, own


@kernel
def _turn_evenly(tangent: NDArray[np.float64], normal: NDArray[np.float64], first: int, last: int) -> None:
    """Fill the normals strictly between two samples, turning by equal angles about the tangent."""
    found = _row(normal, last)
    for j in range(first + 1, last + 1):
        normal[j] = transport(_row(normal, j - 1), _row(tangent, j - 1), _row(tangent, j))
    carried = _row(normal, last)
    angle = np.arctan2(dot(cross(carried, found), _row(tangent, last)), dot(carried, found))
    for j in range(first + 1, last):
        normal[j] = turn_about(_row(tangent, j), _row(normal, j), angle * (j - first) / (last - first))
    normal[last] = found


@kernel
def integrate(
    kappa: NDArray[np.float64], tau: NDArray[np.float64], speed: NDArray[np.float64], substeps: int
) -> NDArray[np.float64]:
    """Positions (L * substeps + 1, 3) [cm] of the curve with these cells (L,), from the origin.

    kappa, tau [1/cm] and speed [cm per unit of t, t from 0 to 1] are constant in each cell. Frame and position by
    fourth-order Runge-Kutta, the frame re-orthonormalised at each step; T, N, B start as -z, x, -y.
    """
    cells = kappa.shape[0]
    out = np.empty((cells * substeps + 1, 3))
    x = np.zeros(3)
    f = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # rows T, N, B
    out[0] = x
    k1 = np.empty((3, 3))
    k2 = np.empty((3, 3))
    k3 = np.empty((3, 3))
    k4 = np.empty((3, 3))
    g = np.empty((3, 3))
    row = 1
    for i in range(cells):
        h = speed[i] / cells / substeps
        k = kappa[i] * h
        w = tau[i] * h
        for _ in range(substeps):
            _slope(f, k, w, k1)
            g[:] = f + 0.5 * k1
            _slope(g, k, w, k2)
            # Tangents at the start, the middle (twice) and the end of the step weigh 1, 2, 2, 1.
            move = f[0] + 2.0 * g[0]
            g[:] = f + 0.5 * k2
            move += 2.0 * g[0]
            _slope(g, k, w, k3)
            g[:] = f + k3
            move += g[0]
            _slope(g, k, w, k4)
            f += (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0
            x += move * (h / 6.0)
            _orthonormalise(f)
            out[row] = x
            row += 1
    return out


@kernel
def _slope(f: NDArray[np.float64], k: float, w: float, out: NDArray[np.float64]) -> None:
    """The Frenet-Serret equations for the rows T, N, B of ``f``."""
    for c in range(3):
        out[0, c] = k * f[1, c]
        out[1, c] = -k * f[0, c] + w * f[2, c]
        out[2, c] = -w * f[1, c]


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
