"""Guidance that keeps a generated strand's axis straight, as its examples' are.

A signal of curvature and torsion says nothing of the axis' direction: small errors turn it a little at each twist,
and the turns add up along the strand. In canonical space the axis is straight by definition, so the prediction is
steered: while its frame is integrated, the axis, a low-pass of the tangent, is turned back at a gentle rate, and the
part of that rotation that bending and torsion can make (about B and about T) is added to them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import kernel, parallel_kernel, prange

AXIS_TURNS = 0.75  # deviation of the Gaussian that makes the axis of the tangents, in turns
RETURN_TURNS = 1.5  # length over which a deviation of the axis falls to 1/e, in turns


@kernel
def _advance(frame: NDArray[np.float64], bend: float, twist: float) -> None:
    """Turn the frame (rows T, N, B) by the Darboux vector (twist, 0, bend) of a step [rad], exactly."""
    angle2 = bend * bend + twist * twist
    angle = np.sqrt(angle2)
    if angle < 1e-12:
        return
    s = np.sin(angle) / angle
    c = (1.0 - np.cos(angle)) / angle2
    for k in range(3):
        t = frame[0, k]
        n = frame[1, k]
        b = frame[2, k]
        # Rodrigues' formula: omega = twist T + bend B, so omega x (T, N, B) = (bend N, twist B - bend T, -twist N).
        frame[0, k] = t + s * bend * n + c * bend * (twist * b - bend * t)
        frame[1, k] = n + s * (twist * b - bend * t) - c * angle2 * n
        frame[2, k] = b - s * twist * n - c * twist * (twist * b - bend * t)


@kernel
def steer_strand(kappa: NDArray[np.float64], tau: NDArray[np.float64], step: float, turn: float) -> None:
    """Straighten the axis of one strand by changing ``kappa`` and ``tau`` (L,) [1/cm] in place.

    step: arc length of a cell [cm]. turn: arc length of a turn [cm].
    """
    cells = kappa.shape[0]
    frames = np.empty((cells, 3, 3))
    frame = np.eye(3)
    for i in range(cells):
        _advance(frame, 0.5 * kappa[i] * step, 0.5 * tau[i] * step)
        frames[i] = frame
        _advance(frame, 0.5 * kappa[i] * step, 0.5 * tau[i] * step)
    reach = int(np.ceil(2.5 * AXIS_TURNS * turn / step))
    falloff = 0.5 * (step / (AXIS_TURNS * turn)) ** 2
    weights = np.exp(-falloff * np.arange(reach + 1.0) ** 2)
    axis = np.empty((cells, 3))
    for i in range(cells):
        for k in range(3):
            total = 0.0
            for j in range(max(0, i - reach), min(cells, i + reach + 1)):
                total += weights[abs(i - j)] * frames[j, 0, k]
            axis[i, k] = total
        axis[i] /= np.sqrt((axis[i] * axis[i]).sum()) + 1e-12
    goal = axis[0].copy()
    frame = np.eye(3)
    local = np.empty(3)
    here = np.empty(3)
    rate = step / (RETURN_TURNS * turn)
    for i in range(cells):
        # The axis as it lies relative to the frame does not change with what was steered before.
        for k in range(3):
            local[k] = (frames[i, k] * axis[i]).sum()
        for k in range(3):
            here[k] = local[0] * frame[0, k] + local[1] * frame[1, k] + local[2] * frame[2, k]
        about = np.cross(here, goal)
        bend = rate * (about * frame[2]).sum()
        twist = rate * (about * frame[0]).sum()
        kappa[i] = max(kappa[i] + bend / step, 0.0)
        tau[i] += twist / step
        _advance(frame, kappa[i] * step, tau[i] * step)


@parallel_kernel
def steer_strands(signals: NDArray[np.float64], turn: float) -> None:
    """Straighten the axes of signals (B, L, 3) of kappa, tau, v in place; ``turn``: arc length of a turn [cm]."""
    cells = signals.shape[1]
    for b in prange(signals.shape[0]):
        kappa = signals[b, :, 0].copy()
        tau = signals[b, :, 1].copy()
        steer_strand(kappa, tau, signals[b, :, 2].mean() / cells, turn)
        signals[b, :, 0] = kappa
        signals[b, :, 1] = tau
