"""Style guides that follow their strands from frame to frame, and rotations that follow roots and strands.

A guide found anew in each frame would jitter, since where a curl's middle lies is an estimate; so the first frame's is
carried along: each of its points goes with its own point of the strand, turned as the strand around it turned.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from detangled.kernels import kernel, parallel_kernel, prange

# The strand around a point: so many times the circumference that its distance from the guide makes, and no less than
# so many points either way. A whole turn, so that what is seen to turn is the curl's axis and not the curl.
WINDOW_TURNS = 0.75
LEAST_WINDOW = 2
# A root's surroundings: it and its nearest others. Beyond a line of roots nothing can be told about a rotation.
NEIGHBOURS = 8
FLAT = 1e-6
# Rotations are found by turning further and further, at most so far [rad] at once: Mueller, Bender, Chentanez and
# Macklin (2016), "A robust method to extract the rotational part of deformations".
MOST_TURNS = 60
MOST_TURN = 0.5
LEAST_TURN = 1e-10


def root_rotations(rest: NDArray[np.float64], now: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations (S, 3, 3) of the surroundings of each root, from where roots rested (S, 3) to where they are (S, 3).

    Rows are turned by ``row @ rotation.T``. Where all lie on a line, or there are fewer than three, there is none.
    """
    count = min(NEIGHBOURS, len(rest) - 1)
    rotations = np.tile(np.eye(3), (len(rest), 1, 1))
    if count < 2:
        return rotations
    _, near = cKDTree(rest).query(rest, k=np.arange(2, count + 2))
    before, after = rest[near] - rest[:, None], now[near] - now[:, None]
    left, sizes, right = np.linalg.svd(np.einsum("ski,skj->sij", after, before))
    # The nearest rotation; where it is a reflection, the direction that is known least is turned over.
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
    told = sizes[:, 1] > FLAT * np.maximum(sizes[:, 0], 1e-300)
    rotations[told] = (left @ right)[told]
    return rotations


def windows(points: NDArray[np.float64], guides: NDArray[np.float64], offsets: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many points either way (S,) are a point's surroundings on strands (P, 3) around their guides (P, 3)."""
    counts = np.maximum(np.diff(offsets), 1)
    away = np.sqrt(np.add.reduceat(((points - guides) ** 2).sum(axis=1), offsets[:-1]) / counts)
    steps = np.linalg.norm(np.diff(points, axis=0, append=points[-1:]), axis=1)
    steps[offsets[1:] - 1] = 0.0
    step = np.add.reduceat(steps, offsets[:-1]) / np.maximum(counts - 1, 1)
    reach = WINDOW_TURNS * 2.0 * np.pi * away / np.maximum(step, 1e-300)
    return np.clip(np.ceil(reach), LEAST_WINDOW, counts).astype(np.int64)


@kernel
def _turned_on(rotation: NDArray[np.float64], about: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """The rotation (3, 3) followed by another about a unit axis (3,)."""
    cosine = np.cos(angle)
    sine = np.sin(angle)
    out = np.empty((3, 3))
    for c in range(3):
        along = 0.0
        for k in range(3):
            along += about[k] * rotation[k, c]
        for k in range(3):
            a = (k + 1) % 3
            b = (k + 2) % 3
            swept = about[a] * rotation[b, c] - about[b] * rotation[a, c]
            out[k, c] = cosine * rotation[k, c] + sine * swept + (1.0 - cosine) * along * about[k]
    return out


@kernel
def _rotation_near(moment: NDArray[np.float64], rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation (3, 3) that fits a moment (3, 3) best, reached from another: what the moment leaves open stays."""
    omega = np.empty(3)
    for _ in range(MOST_TURNS):
        along = 0.0
        omega[:] = 0.0
        for c in range(3):
            for k in range(3):
                a = (k + 1) % 3
                b = (k + 2) % 3
                along += rotation[k, c] * moment[k, c]
                omega[k] += rotation[a, c] * moment[b, c] - rotation[b, c] * moment[a, c]
        size = np.sqrt(omega[0] ** 2 + omega[1] ** 2 + omega[2] ** 2)
        if not size > 0.0:
            break
        angle = np.arctan2(size, along)
        if not angle > LEAST_TURN:
            break
        rotation = _turned_on(rotation, omega / size, min(angle, MOST_TURN))
    return rotation


@parallel_kernel
def followed_guides(
    points: NDArray[np.float64],
    guides: NDArray[np.float64],
    offsets: NDArray[np.int64],
    reaches: NDArray[np.int64],
    rotations: NDArray[np.float64],
    now: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Guides (P, 3) [cm] of strands that moved from ``points`` (P, 3) to ``now`` (P, 3), from those they had there.

    reaches: (S,), points either way that are a point's surroundings. rotations: (S, 3, 3), of the roots, which decide
    what a straight strand leaves open: how far it turned about itself.
    """
    out = np.empty_like(guides)
    for s in prange(offsets.shape[0] - 1):
        first = offsets[s]
        last = offsets[s + 1]
        rotation = rotations[s].copy()
        moment = np.empty((3, 3))
        for i in range(first, last):
            low = max(first, i - reaches[s])
            high = min(last, i + reaches[s] + 1)
            before = np.zeros(3)
            after = np.zeros(3)
            for j in range(low, high):
                for c in range(3):
                    before[c] += points[j, c] / (high - low)
                    after[c] += now[j, c] / (high - low)
            moment[:] = 0.0
            for j in range(low, high):
                for a in range(3):
                    for b in range(3):
                        moment[a, b] += (now[j, a] - after[a]) * (points[j, b] - before[b])
            rotation = _rotation_near(moment, rotation)
            for a in range(3):
                out[i, a] = now[i, a]
                for b in range(3):
                    out[i, a] += rotation[a, b] * (guides[i, b] - points[i, b])
    return out
