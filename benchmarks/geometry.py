"""How long strands take from world space to kappa-tau-v, beside the same steps written with NumPy and SciPy.

python benchmarks/geometry.py [--strands 10000] [--points 100] [--twin-strands 20] [--repeats 3]

Strands are helices of types III to VIII on arcs and S-curves. The steps are the same on both sides: rough
centreline, optimised centreline, canonical space, spline, smoothing, derivatives, frames, 256 cells. The twin takes
one strand at a time: CubicSpline for the splines, L-BFGS for the centreline, arrays for the rest; it is timed on
some of the same strands, evenly picked, and its time is scaled by their number. Its smoothing uses one width for the
Gaussian, so that torsion differs by some per cent at the ends and wherever an edge offends.
"""

from __future__ import annotations

import argparse
import os
import time

# On vectors as short as a strand, the threads of the twin's linear algebra only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import minimize

from detangled.geometry import centerline as c
from detangled.geometry.canonical import phi
from detangled.geometry.centerline import centerlines
from detangled.geometry.signal import MOST_BLUR_CELLS, dense_count, signals
from detangled.geometry.smoothing import OFFENCE_DEVIATIONS
from detangled.kernels import parallel_kernel, prange

SEED = 1
CELLS = 256
TYPES = [
    (0.75, 6.0, 28.0),
    (0.95, 3.8, 25.0),
    (0.65, 2.2, 22.0),
    (0.42, 1.25, 18.0),
    (0.28, 0.75, 14.0),
    (0.18, 0.42, 12.0),
]


def helix_on_a_bend(
    radius: float, wavelength: float, length: float, points: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """A strand (points, 3) of an arc length, wound on an arc or an S-curve of up to half a circle, anywhere."""
    turns = length / np.hypot(2 * np.pi * radius, wavelength)
    u = np.linspace(0.0, 1.0, 20 * points)
    bend = rng.uniform(0.0, np.pi) * np.where((u > 0.5) & (rng.random() < 0.5), -1.0, 1.0)
    angle = np.concatenate([[0.0], np.cumsum((bend[1:] + bend[:-1]) / 2 * np.diff(u))])
    tangent = np.stack([np.sin(angle), np.zeros_like(u), -np.cos(angle)], axis=1)
    normal = np.stack([np.cos(angle), np.zeros_like(u), np.sin(angle)], axis=1)
    guide = np.cumsum(tangent, axis=0) * (turns * wavelength / len(u))
    phase = rng.uniform(0.0, 2 * np.pi) + rng.choice([-1, 1]) * 2 * np.pi * turns * u
    strand = guide + radius * (np.cos(phase)[:, None] * normal + np.sin(phase)[:, None] * np.array([0.0, 1.0, 0.0]))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return strand[np.linspace(0, len(u) - 1, points).round().astype(int)] @ turn + rng.normal(scale=10.0, size=3)


@parallel_kernel
def phi_of_all(
    points: NDArray[np.float64], guides: NDArray[np.float64], offsets: NDArray[np.int64]
) -> NDArray[np.float64]:
    out = np.empty_like(points)
    for s in prange(offsets.shape[0] - 1):
        out[offsets[s] : offsets[s + 1]] = phi(points[offsets[s] : offsets[s + 1]], guides[offsets[s] : offsets[s + 1]])
    return out


def compiled(points: NDArray[np.float64], offsets: NDArray[np.int64]) -> NDArray[np.float64]:
    guides, _ = centerlines(points, offsets)
    return signals(phi_of_all(points, guides, offsets), offsets, np.arange(len(offsets)) * CELLS)


# The twin.


def chords(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def spline(t: NDArray[np.float64], values: NDArray[np.float64]) -> CubicSpline:
    ends = []
    for part, at in ((slice(0, 4), t[0]), (slice(-4, None), t[-1])):
        ends.append((1, np.polynomial.polynomial.polyfit(t[part] - at, values[part], 3)[1]))
    return CubicSpline(t, values, bc_type=tuple(ends))


def twin_frames(guide: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations (n, 3, 3) to canonical directions, segment by segment."""
    tangents = np.diff(guide, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    down = np.array([0.0, 0.0, -1.0])
    x = np.array([1.0, 0.0, 0.0])
    rotations = []
    for tangent in tangents:
        half = down + tangent
        x = x - 2 * half * (half @ x) / (half @ half) + 2 * tangent * (down @ x)
        down = tangent
        rotations.append(np.stack([x, np.cross(x, down), -down]))
    return np.array([*rotations, rotations[-1]])


def twin_phi(strand: NDArray[np.float64], guide: NDArray[np.float64]) -> NDArray[np.float64]:
    out = np.einsum("nij,nj->ni", twin_frames(guide), strand - guide)
    out[:, 2] -= chords(guide)
    return out


def twin_rough(dense: NDArray[np.float64], frequencies: int) -> NDArray[np.float64]:
    spectrum = dct(np.diff(dense, axis=0), axis=0)
    spectrum[frequencies:] = 0.0
    return dense[0] + np.concatenate([np.zeros((1, 3)), np.cumsum(idct(spectrum, axis=0), axis=0)])


def twin_objective(
    flat: NDArray[np.float64], strand: NDArray[np.float64], unit: float, stiffness: float
) -> tuple[float, NDArray]:
    axis = flat.reshape(-1, 2)
    offset = axis - strand[:, :2]
    r = np.linalg.norm(offset, axis=1)
    spread, steps, second = r - r.mean(), np.diff(r) * unit, np.diff(axis, 2, axis=0) * unit**2
    value = (spread**2).sum() + c.WEIGHT_ADJACENT * (steps**2).sum()
    value += c.WEIGHT_DISPLACEMENT * (axis**2).sum() + stiffness * (second**2).sum()
    by_r = spread.copy()
    by_r[1:] += c.WEIGHT_ADJACENT * steps * unit
    by_r[:-1] -= c.WEIGHT_ADJACENT * steps * unit
    gradient = by_r[:, None] * offset / (r[:, None] + 1e-30) + c.WEIGHT_DISPLACEMENT * axis
    bend = stiffness * second * unit**2
    gradient[2:] += bend
    gradient[1:-1] -= 2 * bend
    gradient[:-2] += bend
    return 0.5 * value, gradient.ravel()


def twin_centerline(points: NDArray[np.float64]) -> NDArray[np.float64]:
    t = chords(points)
    through = spline(t, points)
    grid = np.linspace(0.0, t[-1], 2 * (len(points) - 1) + 1)
    dense = through(grid)
    rough = twin_rough(dense, c.FEWEST_FREQUENCIES)
    turns, _ = c.curl_turns(dense, rough)
    m = max(c.FEWEST_SAMPLES, int(c.SAMPLES_PER_TURN * turns))
    grid = np.linspace(0.0, t[-1], m + 1)
    dense = through(grid)
    frequencies = round(turns / c.TURNS_PER_FREQUENCY)
    rough = twin_rough(dense, int(np.clip(frequencies, c.FEWEST_FREQUENCIES, c.MOST_FREQUENCIES)))
    extra = int(c.EXTENSION * m)
    extended = c._extend(twin_phi(dense, rough), extra)
    unit = m / (2 * np.pi * turns)
    stiffness = c.WEIGHT_CURVATURE * max(1.0, turns / c.SOFT_TURNS) ** c.STIFFENING
    found = minimize(
        twin_objective,
        np.zeros(2 * len(extended)),
        args=(extended, unit, stiffness),
        jac=True,
        method="L-BFGS-B",
        # As near to the minimum as the compiled optimiser stops: a gain below SMALL_GAIN over several steps.
        options={"maxiter": 20_000, "maxfun": 20_000, "ftol": c.SMALL_GAIN / 10},
    )
    axis = found.x.reshape(-1, 2)[extra : extra + m + 1]
    guide = rough + np.einsum("ni,nij->nj", axis, twin_frames(rough)[:, :2])
    return spline(grid, guide)(t)


def twin_smooth(values: NDArray[np.float64], step: float, most_blur: float) -> NDArray[np.float64]:
    spent = np.zeros(len(values))
    while True:
        edges = np.hypot(np.diff(values, axis=0), step)
        mean, deviation = edges.mean(axis=0), edges.std(axis=0)
        offends = (edges >= mean + np.maximum(OFFENCE_DEVIATIONS * deviation, 1e-6 * mean)).any(axis=1)
        near = np.convolve(offends, np.ones(5), "same") > 0
        near = np.concatenate([[False], near[:-1], [False]]) & (spent < 0.99 * most_blur**2)
        if not near.any():
            return values
        width = min(1.0, most_blur)
        values = np.where(near[:, None], gaussian_filter1d(values, width, axis=0, mode="nearest"), values)
        spent += near * width**2


def twin_signal(points: NDArray[np.float64]) -> NDArray[np.float64]:
    t = chords(points)
    samples = dense_count(len(points), CELLS)
    grid = np.linspace(0.0, t[-1], samples + 1)
    most_blur = MOST_BLUR_CELLS * samples / CELLS
    step = t[-1] / samples
    curve = twin_smooth(spline(t, points)(grid), step, most_blur)
    first = twin_smooth(spline(grid, curve)(grid, 1), step, most_blur)
    second = twin_smooth(spline(grid, first)(grid, 1), step, most_blur)
    speed = np.linalg.norm(first, axis=1)
    tangent = first / speed[:, None]
    normal = second - (second * tangent).sum(axis=1)[:, None] * tangent
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    here, there = tangent[:-1], tangent[1:]
    half = here + there
    carried = normal[:-1] - 2 * half * ((half * normal[:-1]).sum(axis=1) / (half**2).sum(axis=1))[:, None]
    bend = np.arctan2(np.linalg.norm(np.cross(here, there), axis=1), (here * there).sum(axis=1))
    twist = np.arctan2((np.cross(carried, normal[1:]) * there).sum(axis=1), (carried * normal[1:]).sum(axis=1))
    rates = np.stack([bend, twist, (speed[1:] + speed[:-1]) / 2 * step], axis=1)
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(rates, axis=0)])
    ends = np.linspace(0, samples, CELLS + 1)
    means = np.diff([np.interp(ends, np.arange(samples + 1), column) for column in total.T], axis=1)
    return np.stack([means[0] / means[2], means[1] / means[2], means[2] * CELLS], axis=1)


def twin(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return twin_signal(twin_phi(points, twin_centerline(points)))


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strands", type=int, default=10_000)
    parser.add_argument("--points", type=int, default=100)
    parser.add_argument("--twin-strands", type=int, default=30, help="strands that the twin is timed on")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args(arguments)

    rng = np.random.default_rng(SEED)
    strands = [helix_on_a_bend(*TYPES[i % len(TYPES)], options.points, rng) for i in range(options.strands)]
    points = np.concatenate(strands)
    offsets = np.arange(options.strands + 1) * options.points
    compiled(points[: 2 * options.points], offsets[:3])

    picked = np.unique(np.linspace(0, options.strands - 1, options.twin_strands).astype(int))
    twin(strands[picked[0]])
    start = time.perf_counter()
    slow = [twin(strands[i]) for i in picked]
    per_strand = (time.perf_counter() - start) / len(picked)

    seconds = []
    for _ in range(options.repeats):
        start = time.perf_counter()
        found = compiled(points, offsets)
        seconds.append(time.perf_counter() - start)
    best = min(seconds)

    scaled = per_strand * options.strands
    fast = found.reshape(options.strands, CELLS, 3)[picked]
    apart = np.median(np.abs(fast - slow).mean(axis=1) / np.abs(fast).mean(axis=1), axis=0)
    print(f"{options.strands} strands of {options.points} points to kappa, tau, v in {CELLS} cells")
    print(f"compiled  {best:9.2f} s on {numba.get_num_threads()} threads, best of {options.repeats}")
    print(f"SciPy     {scaled:9.2f} s, from {len(picked)} strands at {1e3 * per_strand:.1f} ms each")
    print(f"ratio     {scaled / best:9.1f}")
    print(f"median difference of kappa, tau, v: {apart[0]:.1e}, {apart[1]:.1e}, {apart[2]:.1e} of their mean size")


if __name__ == "__main__":
    main()
