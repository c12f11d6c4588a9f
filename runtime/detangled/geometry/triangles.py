"""Triangles of a mesh: the nearest point of one, and the solid angle under which it is seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import inlined_kernel, kernel

# Of a triangle flatter than this (squared sine of a corner's angle) the plane is lost in rounding: it is its sides.
FLAT = 1e-12


@inlined_kernel
def nearest_on_triangle(x: float, y: float, z: float, corners: NDArray[np.float64]) -> tuple[float, float, float]:
    """Squared distance of a point from a triangle, and the weights of its second and third corner in the nearest place.

    corners: (9,), one after another; of no area they may be too. By the region of the plane that the point lies over
    (Ericson 2005, "Real-Time Collision Detection", 5.1.5).
    """
    ax, ay, az = corners[0], corners[1], corners[2]
    ux, uy, uz = corners[3] - ax, corners[4] - ay, corners[5] - az
    vx, vy, vz = corners[6] - ax, corners[7] - ay, corners[8] - az
    px, py, pz = x - ax, y - ay, z - az
    uu = ux * ux + uy * uy + uz * uz
    uv = ux * vx + uy * vy + uz * vz
    vv = vx * vx + vy * vy + vz * vz
    pu = px * ux + py * uy + pz * uz
    pv = px * vx + py * vy + pz * vz
    area = uu * vv - uv * uv
    s = vv * pu - uv * pv
    t = uu * pv - uv * pu
    if s >= 0.0 and t >= 0.0 and s + t <= area and area > FLAT * uu * vv:
        s /= area
        t /= area
        dx, dy, dz = px - s * ux - t * vx, py - s * uy - t * vy, pz - s * uz - t * vz
        return dx * dx + dy * dy + dz * dz, s, t
    # Outside of all three edges the nearest point is on one of them.
    s = min(max(pu / uu, 0.0), 1.0) if uu > 0.0 else 0.0
    dx, dy, dz = px - s * ux, py - s * uy, pz - s * uz
    on_u = dx * dx + dy * dy + dz * dz
    t = min(max(pv / vv, 0.0), 1.0) if vv > 0.0 else 0.0
    dx, dy, dz = px - t * vx, py - t * vy, pz - t * vz
    on_v = dx * dx + dy * dy + dz * dz
    wx, wy, wz = vx - ux, vy - uy, vz - uz
    ww = wx * wx + wy * wy + wz * wz
    qx, qy, qz = px - ux, py - uy, pz - uz
    r = min(max((qx * wx + qy * wy + qz * wz) / ww, 0.0), 1.0) if ww > 0.0 else 0.0
    dx, dy, dz = qx - r * wx, qy - r * wy, qz - r * wz
    best = min(min(on_u, on_v), dx * dx + dy * dy + dz * dz)
    if best == on_u:
        return best, s, 0.0
    if best == on_v:
        return best, 0.0, t
    return best, 1.0 - r, r


@kernel
def distance2_to_triangle(x: float, y: float, z: float, corners: NDArray[np.float64]) -> float:
    """Squared distance of a point from a triangle (9,)."""
    return nearest_on_triangle(x, y, z, corners)[0]


@kernel
def solid_angle(x: float, y: float, z: float, corners: NDArray[np.float64]) -> float:
    """Solid angle [sr] of a triangle (9,) seen from a point, positive from behind (inside of what it bounds).

    Van Oosterom and Strackee (1983), "The solid angle of a plane triangle".
    """
    ax, ay, az = corners[0] - x, corners[1] - y, corners[2] - z
    bx, by, bz = corners[3] - x, corners[4] - y, corners[5] - z
    cx, cy, cz = corners[6] - x, corners[7] - y, corners[8] - z
    a = np.sqrt(ax * ax + ay * ay + az * az)
    b = np.sqrt(bx * bx + by * by + bz * bz)
    c = np.sqrt(cx * cx + cy * cy + cz * cz)
    volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    ab = ax * bx + ay * by + az * bz
    bc = bx * cx + by * cy + bz * cz
    ca = cx * ax + cy * ay + cz * az
    return 2.0 * np.arctan2(volume, a * b * c + ab * c + bc * a + ca * b)
