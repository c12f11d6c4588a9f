"""How much light reaches a place in the hair or on the head: rays marched through a grid of their density."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from detangled.kernels import kernel
from detangled.view.curves import Curves
from detangled.view.threads import spread

if TYPE_CHECKING:
    from detangled.view.surface import Surface

GRID_CELLS = 96**3  # shared out so that cells are cubes
DENSITY_PARTS = 8
PADDING = 2  # empty cells around the hair
# Marched from the strand itself, a ray would start in the strand's own density and shadow it.
MARCH_START = 0.01  # of the scene's extent: 0.3 cm on a head
MARCH_GROWTH = 1.12  # each step is longer than the one before: far hair matters less exactly
LONGEST_STEP = 4.0  # cells
LONGEST_STEP_WITH_HEAD = 1.4  # or a ray would step over what is thin of it
AMBIENT_REACH = 0.25  # of the extent: what lies further away does not close off the sky
# Hair passes on most of the light that meets it; a strand blocks only this part of its drawn width.
BLOCKING = 0.8
HEAD_DEPTH = 5.0  # optical depth of a head's surface: next to nothing comes through
HEAD_INSIDE = 1.2  # cells
MOST_PARTS = 200  # that a triangle's side is cut into

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


def light_grid(
    curves: Curves,
    width: float,
    extent: float,
    region: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
    surface: Surface | None = None,
) -> LightGrid:
    """Light among strands drawn ``width`` [cm] wide, and on a head, in a scene of size ``extent`` [cm].

    region: two corners of the box that is worth knowing, (3,) each in camera axes; the strands' own where None.
    """
    low, high = (curves.low, curves.high) if region is None else region
    span = np.maximum(high - low, 0.02 * extent)
    cell = float(np.cbrt(np.prod(span) / GRID_CELLS))
    cell = max(cell, float(span.max()) / 256.0)  # a flat swatch needs no thousand cells along its long side
    shape = np.ceil(span / cell).astype(np.int64) + 1 + 2 * PADDING
    origin = low - PADDING * cell
    density = _density(curves, origin, cell, (int(shape[0]), int(shape[1]), int(shape[2])))
    blocking = BLOCKING * width / cell**3
    sky, weights = _dome()
    asked, longest = maximum_filter(density > 0.0, size=3), LONGEST_STEP
    if surface is not None:
        depth = HEAD_DEPTH / blocking
        shell = np.zeros_like(density)
        _deposit_head(surface.vertices, surface.normals, surface.faces, origin, cell, depth, shell)
        # On a head light is looked up a cell outside of it, further from the cells that hold it than hair is.
        asked |= maximum_filter(shell > 0.0, size=9)
        density += _solid(shell, depth)
        longest = LONGEST_STEP_WITH_HEAD
    values = np.empty((*density.shape, 3), dtype=np.float32)
    start, diagonal = MARCH_START * extent / cell, float(np.linalg.norm(density.shape))
    marches = [_steps(ray, start, diagonal, longest) for ray in (KEY, RIM)]
    marches += [_steps(ray, start, min(AMBIENT_REACH * extent / cell, diagonal), longest) for ray in sky]
    cells, shares = (np.concatenate(parts) for parts in zip(*marches, strict=True))
    ends = np.cumsum([len(march[0]) for march in marches])
    given = (density, cell * blocking, cells, shares, ends, weights, asked, values)
    spread(lambda begin, end: _march(begin, end, *given), len(values))
    return LightGrid(values, origin, cell)


def _density(
    curves: Curves, origin: NDArray[np.float64], cell: float, shape: tuple[int, int, int]
) -> NDArray[np.float32]:
    """Length of hair [cm] in each cell, summed by parts that are always the same, so that threads change no sum."""
    strands = len(curves.ids)
    parts = np.zeros((min(DENSITY_PARTS, strands), *shape), dtype=np.float32)
    edges = [strands * k // len(parts) for k in range(len(parts) + 1)]

    def deposit(begin: int, end: int) -> None:
        for k in range(begin, end):
            _deposit(curves.points, curves.offsets[edges[k] : edges[k + 1] + 1], origin, cell, parts[k])

    spread(deposit, len(parts))
    return np.asarray(parts.sum(axis=0))


def _solid(shell: NDArray[np.float32], inside: float) -> NDArray[np.float32]:
    """Fill a shell with density ``inside``, since rays step over what is thin and far.

    A cell is inside where the shell is met from it in five of six directions: heads are open at the neck.
    """
    wall = shell > 0.0
    met = np.zeros(shell.shape, dtype=np.int8)
    for axis in range(3):
        met += np.logical_or.accumulate(wall, axis=axis)
        met += np.flip(np.logical_or.accumulate(np.flip(wall, axis), axis=axis), axis)
    return np.where(met >= 5, np.maximum(shell, np.float32(inside)), shell)


@kernel
def _deposit(points, offsets, origin, cell, density):  # type: ignore[no-untyped-def]
    """Add each segment's length [cm] to the eight cells around it."""
    nx, ny, nz = density.shape
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
                if not (0.0 <= x < nx - 1 and 0.0 <= y < ny - 1 and 0.0 <= z < nz - 1):
                    continue
                ix, iy, iz = int(x), int(y), int(z)
                fx, fy, fz = x - ix, y - iy, z - iz
                for a in range(2):
                    wx = share * (fx if a else 1.0 - fx)
                    for b in range(2):
                        wy = wx * (fy if b else 1.0 - fy)
                        density[ix + a, iy + b, iz] += wy * (1.0 - fz)
                        density[ix + a, iy + b, iz + 1] += wy * fz


@kernel
def _deposit_head(vertices, normals, faces, origin, cell, depth, density):  # type: ignore[no-untyped-def]
    """Make a head a shell in the grid, of optical depth ``depth`` in what hair's density is counted in.

    It lies a little inside the head's surface, or it would shadow itself and the roots of hair.
    """
    nx, ny, nz = density.shape
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = (vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2])
        vx, vy, vz = (vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2])
        area = 0.5 * np.sqrt((uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2) / cell**2
        # So many small triangles along each side that none is larger than a quarter of a cell's side.
        parts = min(int(2.0 * np.sqrt(area)) + 1, MOST_PARTS)
        share = depth * area / (parts * parts)
        for i in range(parts):
            for j in range(2 * (parts - i) - 1):
                # The middle of a small triangle: those that stand, and between them those that hang.
                p = (i + (1.0 if j % 2 == 0 else 2.0) / 3.0) / parts
                q = (j // 2 + (1.0 if j % 2 == 0 else 2.0) / 3.0) / parts
                o = 1.0 - p - q
                x = o * vertices[a, 0] + p * vertices[b, 0] + q * vertices[c, 0]
                y = o * vertices[a, 1] + p * vertices[b, 1] + q * vertices[c, 1]
                z = o * vertices[a, 2] + p * vertices[b, 2] + q * vertices[c, 2]
                x = (x - origin[0]) / cell - HEAD_INSIDE * normals[a, 0]
                y = (y - origin[1]) / cell - HEAD_INSIDE * normals[a, 1]
                z = (z - origin[2]) / cell - HEAD_INSIDE * normals[a, 2]
                if 0.0 <= x < nx - 1 and 0.0 <= y < ny - 1 and 0.0 <= z < nz - 1:
                    density[int(x + 0.5), int(y + 0.5), int(z + 0.5)] += share


@kernel
def light_at(values, x, y, z, out):  # type: ignore[no-untyped-def]
    """Trilinear lookup in a LightGrid's values, in cells; places outside take the grid's edge."""
    nx, ny, nz, _ = values.shape
    x, y, z = min(max(x, 0.0), nx - 1.001), min(max(y, 0.0), ny - 1.001), min(max(z, 0.0), nz - 1.001)
    ix, iy, iz = int(x), int(y), int(z)
    fx, fy, fz = x - ix, y - iy, z - iz
    for c in range(3):
        out[c] = 0.0
    for a in range(2):
        wx = fx if a else 1.0 - fx
        for b in range(2):
            wy = wx * (fy if b else 1.0 - fy)
            for c in range(3):
                near, far = values[ix + a, iy + b, iz, c], values[ix + a, iy + b, iz + 1, c]
                out[c] += wy * ((1.0 - fz) * near + fz * far)


def _steps(
    ray: NDArray[np.float64], start: float, reach: float, longest: float
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Where a march along a ray reads the density, and how much each place counts: alike from every cell.

    start, reach, longest: [cells] where it begins and ends, and its longest step. Returns cells (n, 3), counted from
    the one that the ray leaves, and weights (n, 2, 2, 2) of each and its neighbours: its trilinear share of a step.
    """
    places, lengths = [], []
    step, t = 1.0, start + 0.5
    while t < reach:
        places.append(t)
        lengths.append(step)
        grown = min(step * MARCH_GROWTH, longest)
        t += 0.5 * (step + grown)
        step = grown
    at = np.array(places)[:, None] * ray
    cells = np.floor(at)
    x, y, z = (np.stack([1.0 - share, share], axis=1) for share in (at - cells).T)
    weights = np.einsum("n,na,nb,nc->nabc", np.array(lengths), x, y, z)
    return cells.astype(np.int64), weights.astype(np.float32)


@kernel
def _march(begin, end, density, blocking, cells, weights, ends, sky, asked, values):  # type: ignore[no-untyped-def]
    """Fill ``values`` (nx, ny, nz, 3) where ``asked``, and with full light elsewhere.

    cells, weights: the steps of all rays (``_steps``), whose ends among them are ``ends``: towards the key, the rim and
    places in the sky, which give the parts ``sky`` of its light.
    """
    nx, ny, nz = density.shape
    depth = np.empty(nz, dtype=np.float32)
    open_sky = np.empty(nz, dtype=np.float32)
    for i in range(begin, end):
        for j in range(ny):
            values[i, j, :, :2] = 0.0
            values[i, j, :, 2] = 1.0
            first, last = nz, 0
            for k in range(nz):
                if asked[i, j, k]:
                    first, last = min(first, k), k + 1
            open_sky[:] = 0.0
            for r in range(len(ends) if first < last else 0):
                depth[:] = 0.0
                for n in range(ends[r - 1] if r > 0 else 0, ends[r]):
                    x, y, z = i + cells[n, 0], j + cells[n, 1], cells[n, 2]
                    if not (0 <= x < nx - 1 and 0 <= y < ny - 1):
                        break
                    low, high = max(first, -z), min(last, nz - 1 - z)
                    if low >= high:
                        break
                    w = weights[n]
                    # Whole rows at once, which compiles to vector instructions.
                    a, b = density[x, y, low + z : high + z + 1], density[x, y + 1, low + z : high + z + 1]
                    c, d = density[x + 1, y, low + z : high + z + 1], density[x + 1, y + 1, low + z : high + z + 1]
                    row = depth[low:high]
                    for k in range(len(row)):
                        row[k] += (w[0, 0, 0] * a[k] + w[0, 0, 1] * a[k + 1]) + (
                            w[0, 1, 0] * b[k] + w[0, 1, 1] * b[k + 1]
                        )
                        row[k] += (w[1, 0, 0] * c[k] + w[1, 0, 1] * c[k + 1]) + (
                            w[1, 1, 0] * d[k] + w[1, 1, 1] * d[k + 1]
                        )
                for k in range(first, last):
                    if not asked[i, j, k]:
                        continue
                    if r < 2:
                        values[i, j, k, r] = blocking * depth[k]
                    else:
                        open_sky[k] += sky[r - 2] * np.exp(-blocking * depth[k])
                        values[i, j, k, 2] = open_sky[k]
