"""How a strand hangs at rest: its shape of least energy, found directly by Newton's method.

Paper section "Simulation"; the paper steps Stable Cosserat Rods (Hsu, Wang, Wu, Yuksel 2025) through time to a steady
state (``rods``). With one clamped end and no contact the tension in a strand that does not stretch is known, the weight
of all below; so its rest is the minimum, over the orientations of the segments alone, of

    sum over segments of -l N . d(q)   +   sum over joints of sum_i k_i v_i^2 / (1 + u0),

as in the heavy elastica and in discrete rods (Bergou et al. 2008). u = (u0, v) is the rotation from rest to what it is,
seen from the frame half-way between the two segments; k = 4 (G J, E I, E I') / mean length. For equal k a joint's
energy is that of Stable Cosserat Rods, k |conj(q) q' - r|^2 / 2. Segments are wholes: no stretch, no shear.

Units are cm, g, s. A frame is a unit quaternion (w, x, y, z) that takes x to the tangent, y to the section's major axis
and z to its minor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.errors import TextureError
from detangled.geometry.inputs import compiled_input
from detangled_training.frames import Pose, checked, posed
from detangled_training.material import Fibres, point_masses
from detangled_training.resting import MOST_ITERATIONS, hang_all

GRAVITY = (0.0, 0.0, -981.0)  # [cm/s^2]
SAME_REST = 0.1  # [cm] two shapes whose points are nowhere further apart are one


@dataclass(frozen=True)
class Hung:
    """Strands at rest under their weight.

    points: (P, 3) [cm], offsets: (S + 1,), frames: (P, 4) as in Pose. Strands that could not be hung have NaN.
    converged: (S,) whether a minimum was reached: the Hessian positive and the Newton step next to nothing.
    iterations: (S,). residual: (S,) [cm] how far the last Newton step would have moved a point.
    moment: (S, 3) [dyn cm] that the first joint bears, from how it is bent and twisted; at rest that of the weight
    beyond. energy: (S,) [erg], zero where the strand is at rest and straight down.
    energies: (S, K) at each iteration, NaN after the last; K = 0 unless they were asked for.
    """

    points: NDArray[np.float64]
    offsets: NDArray[np.int64]
    frames: NDArray[np.float64]
    converged: NDArray[np.bool_]
    iterations: NDArray[np.int64]
    residual: NDArray[np.float64]
    moment: NDArray[np.float64]
    energy: NDArray[np.float64]
    energies: NDArray[np.float64]


def hang(
    points: ArrayLike,
    offsets: ArrayLike,
    fibres: Fibres,
    wet: bool = True,
    gravity: ArrayLike = GRAVITY,
    stretched: bool = False,
    frames: ArrayLike | None = None,
    roll: ArrayLike = 0.0,
    start: ArrayLike | None = None,
    record: bool = False,
) -> Hung:
    """Hang strands by their roots, whose first segments are held as they are.

    points: (P, 3) [cm], the shape free of stress, root first; offsets: (S + 1,). fibres: S of them.
    wet: whether the mass counts water. gravity: (3,) [cm/s^2]. stretched: start pulled straight instead of at rest.
    frames: (P, 4) of the shape free of stress; None carries them along without twist (``posed`` with ``roll``).
    start: (P, 4) frames to begin from; None begins at rest, or pulled straight. Of several rests the one that is come
    to depends on it. record: keep the energies of all iterations.

    Raises TextureError for arrays that do not fit. A strand that is not finite, has points that coincide, or does not
    converge is told by ``converged``; strands of one segment or less are at rest.
    """
    points, offsets = checked(points, offsets, len(fibres))
    weight = np.asarray(gravity, dtype=np.float64)
    if weight.shape != (3,) or not np.isfinite(weight).all():
        raise TextureError("gravity must be three finite numbers")
    if frames is None:
        frames = posed(points, offsets, roll).frames
    frames = compiled_input(frames, np.float64)
    start = frames if start is None else compiled_input(start, np.float64)
    if not frames.shape == start.shape == (len(points), 4):
        raise TextureError(f"frames must have the shape {(len(points), 4)}, not {frames.shape} and {start.shape}")
    weak, strong = fibres.bending()
    stiffness = np.stack([fibres.torsion(), weak, strong], axis=1)
    count = len(fibres)
    out = np.full(points.shape, np.nan)
    out_frames = np.full(frames.shape, np.nan)
    converged = np.zeros(count, dtype=np.bool_)
    iterations = np.zeros(count, dtype=np.int64)
    residual = np.full(count, np.nan)
    moment = np.full((count, 3), np.nan)
    energy = np.full(count, np.nan)
    energies = np.full((count, MOST_ITERATIONS + 1 if record else 0), np.nan)
    hang_all(
        points,
        offsets,
        frames,
        start,
        stiffness,
        point_masses(points, offsets, fibres, wet),
        weight,
        stretched,
        out,
        out_frames,
        converged,
        iterations,
        residual,
        moment,
        energy,
        energies,
    )
    return Hung(out, offsets, out_frames, converged, iterations, residual, moment, energy, energies)


def dry(hung: Hung) -> Pose:
    """What hung strands are once dried: the shape they hang in is free of stress from then on.

    Hanging it again takes ``wet=False`` and its frames, and ``Fibres.dried`` for the stiffness.
    """
    return Pose(hung.points, hung.offsets, hung.frames)


def differ(one: ArrayLike, other: ArrayLike, offsets: ArrayLike, tolerance: float = SAME_REST) -> NDArray[np.bool_]:
    """Which strands (S,) have a point further than ``tolerance`` [cm] from its like, or are not finite in one alone."""
    apart = np.linalg.norm(np.asarray(one, dtype=np.float64) - np.asarray(other, dtype=np.float64), axis=1)
    # NaN in both is no difference, NaN in one is.
    lost = np.isnan(np.asarray(one)).any(axis=1) != np.isnan(np.asarray(other)).any(axis=1)
    far = (apart > tolerance) | lost
    counts = np.concatenate([[0], np.cumsum(far)])
    at = np.asarray(offsets, dtype=np.int64)
    return counts[at[1:]] > counts[at[:-1]]
