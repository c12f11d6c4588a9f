"""Stable Cosserat rods: strands stepped through time until they hang still.

Paper section "Simulation", after Hsu, Wang, Wu and Yuksel, "Stable Cosserat Rods", 2025. A strand has positions, and a
frame for each segment as in ``hanging``; the energies are, r being the rotation between neighbouring frames at rest,

    stretch and shear of a segment  K |(x' - x) / l - d(q)|^2 / 2,     K = k_s l,
    bend and twist of a joint       k |conj(q) q' - s r|^2 / 2,        k = 4 E I / mean length, s the sign that is near.

Each step sweeps over the strand from the root to the tip: first its points, then its frames, each put where the energy
is least while its neighbours stay. For a frame that is exact: lambda q - v q e1 = b, lambda the largest root of a
quartic.

A step starts its sweeps where the velocity alone takes the points. The authors add a share of the weight's fall, by the
last acceleration; a few sweeps do not undo it, so that hair, stiff as it is, trembled and came to hang up to a fifth of
its length off the minimum.

One k for bend and twist makes G J = E I, so fibres must be ``isotropic``; ``hang`` takes any, and is faster by far.
This is its check, and what contact would be added to. Units are cm, g, s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.errors import TextureError
from detangled.geometry.inputs import compiled_input
from detangled.kernels import kernel, parallel_kernel, prange
from detangled_training.frames import carried, checked, conjugate, posed, product, row, tangent_of, unit
from detangled_training.hanging import GRAVITY
from detangled_training.material import Fibres, point_masses

# Hair stretches so little that sweeps would take for ever to carry a pull along it: its stretch is softened to so many
# times the stiffness that bending has over a segment. Far above 3 a strand looks still long before it hangs.
STRETCH_OVER_BEND = 0.3
MOST_STRAIN = 0.005  # that the weight may cause at the root, whatever the ratio

STILL = 1e-3  # of the length: motion still to come, as it is estimated, of a strand that has settled
WINDOW = 0.1  # [s] between the looks that tell how the motion dies away
QUIET_LOOKS = 3  # in a row, so that a swing's turning point is no rest
DRAG = 5.0  # [1/s]; the slowest swing of a strand of 20 cm has 7 rad/s, and sweeps that are few add to it
NEWTON_STEPS = 8


@dataclass(frozen=True)
class Settled:
    """Strands after a simulation.

    points: (P, 3) [cm], offsets: (S + 1,), frames: (P, 4) as in ``frames.Pose``. Strands that were lost have NaN.
    settled: (S,) whether the motion had died away. seconds: (S,) simulated. residual: (S,) [cm] the motion still to
    come, estimated from how it died away. force: (S, 3) [dyn] that the first segment carries, of its stretching.
    """

    points: NDArray[np.float64]
    offsets: NDArray[np.int64]
    frames: NDArray[np.float64]
    settled: NDArray[np.bool_]
    seconds: NDArray[np.float64]
    residual: NDArray[np.float64]
    force: NDArray[np.float64]


def simulate(
    points: ArrayLike,
    offsets: ArrayLike,
    fibres: Fibres,
    seconds: float = 20.0,
    step: float = 1e-4,
    sweeps: int = 2,
    stretched: bool = False,
    wet: bool = True,
    gravity: ArrayLike = GRAVITY,
    drag: float = DRAG,
    stretch: float = STRETCH_OVER_BEND,
) -> Settled:
    """Let strands, held by their roots and first segments, fall from rest until they hang still.

    points: (P, 3) [cm], the shape free of stress, root first; offsets: (S + 1,). fibres: S of them, ``isotropic``.
    seconds: simulated at most. step [s], sweeps a step. stretched: start pulled straight. wet, gravity: as in ``hang``.
    drag [1/s]: of the velocity. stretch: stiffness of stretching over that of bending a segment.

    Raises TextureError for arrays or numbers that do not fit. A strand that is not finite, has points that coincide, or
    is still moving is told by ``settled``.
    """
    points, offsets = checked(points, offsets, len(fibres))
    weight = np.asarray(gravity, dtype=np.float64)
    if weight.shape != (3,) or not np.isfinite(weight).all():
        raise TextureError("gravity must be three finite numbers")
    if not (0.0 < step <= seconds < np.inf) or sweeps < 1 or not (0.0 <= drag * step < 1.0) or not stretch > 0.0:
        raise TextureError("a simulation takes steps of more than zero seconds, sweeps, and a drag below 1 / step")
    weak, strong = fibres.bending()
    if not (np.isclose(weak, strong, rtol=1e-6) & np.isclose(weak, fibres.torsion(), rtol=1e-6)).all():
        raise TextureError("these rods bend and twist with one stiffness: give them Fibres.isotropic")
    frames = compiled_input(posed(points, offsets).frames, np.float64)
    count = len(fibres)
    out, out_frames = np.full(points.shape, np.nan), np.full(frames.shape, np.nan)
    settled = np.zeros(count, dtype=np.bool_)
    lasted = np.zeros(count)
    residual = np.full(count, np.nan)
    force = np.full((count, 3), np.nan)
    _simulate_all(
        points,
        offsets,
        frames,
        weak,
        fibres.axial(),
        point_masses(points, offsets, fibres, wet),
        weight,
        float(seconds),
        float(step),
        int(sweeps),
        float(drag),
        float(stretch),
        stretched,
        out,
        out_frames,
        settled,
        lasted,
        residual,
        force,
    )
    return Settled(out, offsets, out_frames, settled, lasted, residual, force)


@kernel
def _best_frame(v: tuple, b: tuple) -> tuple:
    """The unit q of least energy -<q, v q e1> / 2 - <b, q>, for a pure quaternion v, as lambda q - v q e1 = b."""
    e1 = (0.0, 1.0, 0.0, 0.0)
    turned = product(product(v, b), e1)
    v2 = v[1] * v[1] + v[2] * v[2] + v[3] * v[3]
    b2 = b[0] * b[0] + b[1] * b[1] + b[2] * b[2] + b[3] * b[3]
    cross = turned[0] * b[0] + turned[1] * b[1] + turned[2] * b[2] + turned[3] * b[3]
    # The quartic rises and is convex above its largest root, so Newton comes down to it from this bound.
    root = np.sqrt(v2) + np.sqrt(b2)
    for _ in range(NEWTON_STEPS):
        apart = root * root - v2
        value = apart * apart - b2 * (root * root + v2) - 2.0 * root * cross
        slope = 4.0 * root * apart - 2.0 * b2 * root - 2.0 * cross
        if not slope > 0.0:
            break
        change = value / slope
        root -= change
        if abs(change) < 1e-15 * root:
            break
    return unit(
        (
            turned[0] + root * b[0],
            turned[1] + root * b[1],
            turned[2] + root * b[2],
            turned[3] + root * b[3],
        )
    )


@kernel
def _near(k: float, a: tuple, q: NDArray[np.float64], j: int) -> tuple:
    """k times a, of the sign that is near to frame j."""
    if a[0] * q[j, 0] + a[1] * q[j, 1] + a[2] * q[j, 2] + a[3] * q[j, 3] < 0.0:
        k = -k
    return (k * a[0], k * a[1], k * a[2], k * a[3])


@kernel
def _move_point(
    x: NDArray[np.float64],
    aim: NDArray[np.float64],  # (n, 3) where inertia and weight alone would take the points
    q: NDArray[np.float64],
    pull: float,  # k_s
    lengths: NDArray[np.float64],
    inertia: NDArray[np.float64],  # (n,) mass / step^2
    i: int,
) -> None:
    m = q.shape[0]
    before = tangent_of(row(q, i - 1))
    stiff = pull / lengths[i - 1]
    if i < m:
        after = tangent_of(row(q, i))
        next_stiff = pull / lengths[i]
        total = inertia[i] + stiff + next_stiff
        for c in range(3):
            to = stiff * x[i - 1, c] + next_stiff * x[i + 1, c] + pull * (before[c] - after[c])
            x[i, c] = (inertia[i] * aim[i, c] + to) / total
    else:
        for c in range(3):
            x[i, c] = (inertia[i] * aim[i, c] + stiff * x[i - 1, c] + pull * before[c]) / (inertia[i] + stiff)


@kernel
def _turn_frame(
    x: NDArray[np.float64],
    q: NDArray[np.float64],
    rest: NDArray[np.float64],
    bend: NDArray[np.float64],
    pull: float,
    j: int,
) -> None:
    two = -2.0 * pull  # K / l is k_s
    v = (0.0, two * (x[j + 1, 0] - x[j, 0]), two * (x[j + 1, 1] - x[j, 1]), two * (x[j + 1, 2] - x[j, 2]))
    b = _near(bend[j - 1], product(row(q, j - 1), row(rest, j - 1)), q, j)
    if j + 1 < q.shape[0]:
        e = _near(bend[j], product(row(q, j + 1), conjugate(row(rest, j))), q, j)
        b = (b[0] + e[0], b[1] + e[1], b[2] + e[2], b[3] + e[3])
    best = _best_frame(v, b)
    for c in range(4):
        q[j, c] = best[c]


@kernel
def _settle(
    x: NDArray[np.float64],  # (n, 3), moved in place
    q: NDArray[np.float64],  # (m, 4), turned in place
    masses: NDArray[np.float64],
    bending: float,
    axial: float,
    gravity: NDArray[np.float64],
    seconds: float,
    step: float,
    sweeps: int,
    drag: float,
    stretch: float,
    stretched: bool,
    force: NDArray[np.float64],
) -> tuple:
    """Whether it came to rest, simulated seconds, and the motion still to come [cm]."""
    n = x.shape[0]
    m = n - 1
    lengths = np.empty(m)
    for j in range(m):
        lengths[j] = np.sqrt(((x[j + 1] - x[j]) ** 2).sum())
    total = lengths.sum()
    rest = np.empty((m - 1, 4))
    bend = np.empty(m - 1)
    for j in range(m - 1):
        r = product(conjugate(row(q, j)), row(q, j + 1))
        for c in range(4):
            rest[j, c] = r[c]
        bend[j] = 8.0 * bending / (lengths[j] + lengths[j + 1])
    strength = np.sqrt((gravity * gravity).sum())
    softened = max(stretch * 4.0 * bending / (total / m) ** 2, masses.sum() * strength / MOST_STRAIN)
    pull = min(softened, axial)
    if stretched and strength > 0.0:
        down = (gravity[0] / strength, gravity[1] / strength, gravity[2] / strength)
        frame = carried(row(q, 0), tangent_of(row(q, 0)), down)
        for j in range(1, m):
            for c in range(4):
                q[j, c] = frame[c]
            for c in range(3):
                x[j + 1, c] = x[j, c] + lengths[j] * down[c]
    inertia = masses / step**2
    velocity = np.zeros((n, 3))
    aim = np.empty((n, 3))
    old = x.copy()
    look = x.copy()
    steps = int(np.ceil(seconds / step))
    window = max(1, int(np.round(WINDOW / step)))
    earlier = np.inf
    quiet = 0
    left = np.inf
    done = 0
    while done < steps and quiet < QUIET_LOOKS:
        done += 1
        old[:] = x
        for i in range(1, n):
            for c in range(3):
                x[i, c] += step * velocity[i, c]
                aim[i, c] = x[i, c] + step**2 * gravity[c]
        for _ in range(sweeps):
            for i in range(1, n):
                _move_point(x, aim, q, pull, lengths, inertia, i)
            for j in range(1, m):
                _turn_frame(x, q, rest, bend, pull, j)
        for i in range(1, n):
            for c in range(3):
                velocity[i, c] = (x[i, c] - old[i, c]) / step * (1.0 - drag * step)
        if done % window == 0:
            moved = 0.0
            for i in range(n):
                moved = max(moved, ((x[i] - look[i]) ** 2).sum())
            moved = np.sqrt(moved)
            look[:] = x
            if not np.isfinite(moved):
                break
            # A motion that dies away by a factor a window has the rest of a geometric series to go.
            fading = min(moved / earlier, 0.999) if earlier > 0.0 else 0.0
            left = moved / (1.0 - fading)
            earlier = moved
            quiet = quiet + 1 if left < STILL * total else 0
    d = tangent_of(row(q, 0))
    for c in range(3):
        force[c] = pull * ((x[1, c] - x[0, c]) / lengths[0] - d[c])
    return quiet >= QUIET_LOOKS, done * step, left


@parallel_kernel
def _simulate_all(
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    frames: NDArray[np.float64],
    bending: NDArray[np.float64],
    axial: NDArray[np.float64],
    masses: NDArray[np.float64],
    gravity: NDArray[np.float64],
    seconds: float,
    step: float,
    sweeps: int,
    drag: float,
    stretch: float,
    stretched: bool,
    out: NDArray[np.float64],
    out_frames: NDArray[np.float64],
    settled: NDArray[np.bool_],
    lasted: NDArray[np.float64],
    residual: NDArray[np.float64],
    force: NDArray[np.float64],
) -> None:
    for s in prange(offsets.shape[0] - 1):
        a = offsets[s]
        b = offsets[s + 1]
        if not (np.isfinite(points[a:b]).all() and np.isfinite(frames[a:b]).all()):
            continue
        if b - a < 3:
            out[a:b] = points[a:b]
            out_frames[a:b] = frames[a:b]
            settled[s] = True
            residual[s] = 0.0
            continue
        x = points[a:b].copy()
        q = frames[a : b - 1].copy()
        settled[s], lasted[s], residual[s] = _settle(
            x,
            q,
            masses[a:b],
            bending[s],
            axial[s],
            gravity,
            seconds,
            step,
            sweeps,
            drag,
            stretch,
            stretched,
            force[s],
        )
        if np.isfinite(x).all():
            out[a:b] = x
            out_frames[a : b - 1] = q
            out_frames[b - 1] = q[b - a - 2]
