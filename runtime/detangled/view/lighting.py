"""How much light reaches a place inside the hair: rays marched through a grid of hair density."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import kernel
from detangled.view.curves import Curves
from detangled.view.threads import spread

GRID_CELLS = 96**3  # shared out so that cells are cubes
PADDING = 2  # empty cells around the hair
# Marched from the strand itself, a ray would start in the strand's own density and shadow it.
MARCH_START = 0.01  # of the scene's extent: 0.3 cm on a head
MARCH_GROWTH = 1.12  # each step is longer than the one before: far hair matters less exactly
AMBIENT_REACH = 0.25  # of the extent: what lies further away does not close off the sky
# Hair passes on most of the light that meets it; a strand blocks only this part of its drawn width.
BLOCKING = 0.8

# Towards the lights, in camera axes: a high key from the left in front, a rim from the right behind.
KEY = np.array([-0.45, 0.68, 0.58]) / np.linalg.norm([-0.45, 0.68, 0.58])
RIM = np.array([0.62, 0.48, -0.62]) / np.linalg.norm([0.62, 0.48, -0.62])


def _dome() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Directions spread evenly over the sphere (a Fibonacci lattice), and the share of light from each."""
    n = 12
    height = 1.0 - 2.0 * (np.arange(n) + 0.5) / n
    turn = np.arange(n) * np.pi * (3.0 - np.sqrt(5.0))
    ring = np.sqrt(1.0 - height**2)
    directions = np.stack([ring * np.cos(turn), height, ring * np.sin(turn)], axis=1)
    weights = 0.35 + 0.65 * (0.5 + 0.5 * height) + 0.5 * np.maximum(directions[:, 2], 0.0)
    return directions, weights / weights.sum()


@dataclass(frozen=True)
class LightGrid:
    """Light in the hair at the centres of cubic cells.

    values: (nx, ny, nz, 3) float32: optical depth towards the key, towards the rim; open part of the sky.
    origin: (3,) [cm], the centre of the first cell, in camera axes; cell: its side [cm].
    """

    values: NDArray[np.float32]
    origin: NDArray[np.float64]
    cell: float


def light_grid(curves: Curves, width: float, extent: float) -> LightGrid:
    """Light among strands drawn ``width`` [cm] wide in a scene of size ``extent`` [cm]."""
    low = curves.low
    span = np.maximum(curves.high - low, 0.02 * extent)
    cell = float(np.cbrt(np.prod(span) / GRID_CELLS))
    cell = max(cell, float(span.max()) / 256.0)  # a flat swatch needs no thousand cells along its long side
    shape = np.ceil(span / cell).astype(np.int64) + 1 + 2 * PADDING
    origin = low - PADDING * cell
    density = np.zeros((int(shape[0]), int(shape[1]), int(shape[2])), dtype=np.float32)
    _deposit(curves.points, curves.offsets, origin, cell, density)
    blocking = BLOCKING * width / cell**3
    sky, weights = _dome()
    rays = np.concatenate([[KEY, RIM], sky])
    values = np.empty((*density.shape, 3), dtype=np.float32)
    start, reach = MARCH_START * extent / cell, AMBIENT_REACH * extent / cell
    given = (density, cell * blocking, rays, weights, start, reach, values)
    spread(lambda begin, end: _march(begin, end, *given), len(values))
    return LightGrid(values, origin, cell)


@kernel
def _deposit(points, offsets, origin, cell, density):  # type: ignore[no-untyped-def]
    """Add each segment's length [cm] to the eight cells around it; serial, so that the sums never differ."""
    for s in range(len(offsets) - 1):
        for i in range(offsets[s], offsets[s + 1] - 1):
            ax, ay, az = points[i, 0], points[i, 1], points[i, 2]
            dx, dy, dz = points[i + 1, 0] - ax, points[i + 1, 1] - ay, points[i + 1, 2] - az
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            steps = int(length / cell) + 1
            share = length / steps
            for k in range(steps):
                t = (k + 0.5) / steps
                x = (ax + t * dx - origin[0]) / cell
                y = (ay + t * dy - origin[1]) / cell
                z = (az + t * dz - origin[2]) / cell
                ix, iy, iz = int(x), int(y), int(z)
                fx, fy, fz = x - ix, y - iy, z - iz
                for a in range(2):
                    wx = share * (fx if a else 1.0 - fx)
                    for b in range(2):
                        wy = wx * (fy if b else 1.0 - fy)
                        density[ix + a, iy + b, iz] += wy * (1.0 - fz)
                        density[ix + a, iy + b, iz + 1] += wy * fz


@kernel
def _optical_depth(density, x, y, z, dx, dy, dz, start, reach):  # type: ignore[no-untyped-def]
    """Density summed along a ray, in cells, from ``start`` to ``reach`` cells away or the grid's end."""
    nx, ny, nz = density.shape
    total = 0.0
    step = 1.0
    t = start + 0.5
    while t < reach:
        px, py, pz = x + t * dx, y + t * dy, z + t * dz
        if not (0.0 <= px < nx - 1 and 0.0 <= py < ny - 1 and 0.0 <= pz < nz - 1):
            break
        ix, iy, iz = int(px), int(py), int(pz)
        fx, fy, fz = px - ix, py - iy, pz - iz
        here = 0.0
        for a in range(2):
            wx = fx if a else 1.0 - fx
            for b in range(2):
                wy = wx * (fy if b else 1.0 - fy)
                here += wy * ((1.0 - fz) * density[ix + a, iy + b, iz] + fz * density[ix + a, iy + b, iz + 1])
        total += step * here
        grown = step * MARCH_GROWTH
        t += 0.5 * (step + grown)
        step = grown
    return total


@kernel
def _march(begin, end, density, blocking, rays, weights, start, reach, values):  # type: ignore[no-untyped-def]
    """Fill ``values`` (nx, ny, nz, 3). rays: (2 + n, 3), towards the key, the rim and places in the sky."""
    nx, ny, nz = density.shape
    for i in range(begin, end):
        for j in range(ny):
            for k in range(nz):
                values[i, j, k, 0] = 0.0
                values[i, j, k, 1] = 0.0
                values[i, j, k, 2] = 1.0
                if i in (0, nx - 1) or j in (0, ny - 1) or k in (0, nz - 1):
                    continue
                near = 0.0
                for a in range(i - 1, i + 2):
                    for b in range(j - 1, j + 2):
                        near += density[a, b, k - 1] + density[a, b, k] + density[a, b, k + 1]
                if near == 0.0:
                    continue
                open_sky = 0.0
                for r in range(len(rays)):
                    limit = 1e9 if r < 2 else reach
                    tau = blocking * _optical_depth(density, i, j, k, rays[r, 0], rays[r, 1], rays[r, 2], start, limit)
                    if r < 2:
                        values[i, j, k, r] = tau
                    else:
                        open_sky += weights[r - 2] * np.exp(-tau)
                values[i, j, k, 2] = open_sky
