"""Guidance in closed form: a generated strand's arc length, and its axis, straight as its examples' are.

A signal of curvature and torsion says nothing of the axis' direction: small errors turn it a little at each twist,
and the turns add up along the strand. In canonical space the axis is straight by definition, so the prediction is
steered: while its frame is integrated, the axis, a low-pass of the tangent, is turned back, and the part of that
rotation that bending and torsion can make (about B and about T) is added to them, most of it where the torsion is
large already: a change at a twist changes the texture least.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import kernel, parallel_kernel, prange

# Found on strands four times as long as their examples (benchmarks/retexture.py prints wander and distances).
AXIS_TURNS = 0.5  # deviation of the Gaussian that makes the axis of the tangents, in turns
MOST_TURNED = 0.7  # share of the tilt that one cell may take away


class Steering(NamedTuple):
    """How strongly strands are steered.

    return_turns: length over which a tilt of the axis falls to 1/e, in turns. free_tilt: sine of the tilt that is left
    alone. at_twists: how much more of it is taken where the torsion is large.
    """

    return_turns: float
    free_tilt: float
    at_twists: float


# Real strands tilt as much as is left alone. What is predicted while strands are drawn is predicted anew, and grows
# smooth; once they are drawn only the most is taken, all along the strand: that leaves torsion as it is.
DRAWN_YET, DRAWN = Steering(0.8, 0.2, 1.0), Steering(1.6, 0.3, 0.0)


@kernel
def _advance(frame: NDArray[np.float64], bend: float, twist: float) -> None:
    """Turn the frame (rows T, N, B) by the Darboux vector twist T + bend B [rad], exactly (Rodrigues' formula)."""
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
        # The rates of T, N, B are bend N, twist B - bend T and -twist N.
        rate = twist * b - bend * t
        frame[0, k] = t + s * bend * n + c * bend * rate
        frame[1, k] = n + s * rate - c * angle2 * n
        frame[2, k] = b - s * twist * n - c * twist * rate


@kernel
def steer_strand(
    kappa: NDArray[np.float64], tau: NDArray[np.float64], step: float, turn: float, steering: Steering
) -> None:
    """Straighten the axis of one strand by changing ``kappa`` and ``tau`` (L,) [1/cm] in place.

    step: arc length of a cell [cm]. turn: arc length of a turn [cm]. The axis is not known near the
    ends, where it is taken to go straight on.
    """
    cells = kappa.shape[0]
    frames = np.empty((cells, 3, 3))
    frame = np.eye(3)
    for i in range(cells):
        _advance(frame, 0.5 * kappa[i] * step, 0.5 * tau[i] * step)
        frames[i] = frame
        _advance(frame, 0.5 * kappa[i] * step, 0.5 * tau[i] * step)
    reach = int(np.ceil(2.5 * AXIS_TURNS * turn / step))
    inner = min(reach, (cells - 1) // 2)
    weights = np.exp(-0.5 * (np.arange(reach + 1.0) * step / (AXIS_TURNS * turn)) ** 2)
    typical = np.median(np.abs(tau)) + 1e-9
    slack = 1.0 + steering.at_twists * (tau / typical) ** 2
    axis = np.empty((cells, 3))
    share = np.empty(cells)  # how much of its surroundings' steering a cell takes on
    for i in range(cells):
        around = 0.0
        total = 0.0
        ax = 0.0
        ay = 0.0
        az = 0.0
        for j in range(max(0, i - reach), min(cells, i + reach + 1)):
            weight = weights[abs(i - j)]
            total += weight
            around += weight * slack[j]
            ax += weight * frames[j, 0, 0]
            ay += weight * frames[j, 0, 1]
            az += weight * frames[j, 0, 2]
        size = np.sqrt(ax * ax + ay * ay + az * az) + 1e-12
        axis[i, 0] = ax / size
        axis[i, 1] = ay / size
        axis[i, 2] = az / size
        share[i] = slack[i] * total / around
    for i in range(inner):
        axis[i] = axis[inner]
        axis[cells - 1 - i] = axis[cells - 1 - inner]
    goal = axis[inner].copy()
    frame = np.eye(3)
    local = np.empty(3)
    here = np.empty(3)
    rate = step / (steering.return_turns * turn)
    for i in range(cells):
        # How the axis lies to the frame does not change with what was steered before.
        for k in range(3):
            local[k] = frames[i, k, 0] * axis[i, 0] + frames[i, k, 1] * axis[i, 1] + frames[i, k, 2] * axis[i, 2]
        for k in range(3):
            here[k] = local[0] * frame[0, k] + local[1] * frame[1, k] + local[2] * frame[2, k]
        ax = here[1] * goal[2] - here[2] * goal[1]
        ay = here[2] * goal[0] - here[0] * goal[2]
        az = here[0] * goal[1] - here[1] * goal[0]
        tilt = np.sqrt(ax * ax + ay * ay + az * az)
        if tilt > steering.free_tilt:
            part = min(rate * share[i], MOST_TURNED) * (1.0 - steering.free_tilt / tilt) / step
            bend = kappa[i] + part * (ax * frame[2, 0] + ay * frame[2, 1] + az * frame[2, 2])
            kappa[i] = max(bend, 0.0)
            tau[i] += part * (ax * frame[0, 0] + ay * frame[0, 1] + az * frame[0, 2])
        _advance(frame, kappa[i] * step, tau[i] * step)


@parallel_kernel
def steer_strands(signals: NDArray[np.float64], turn: float, steering: Steering) -> NDArray[np.float64]:
    """Signals (B, L, 3) of kappa, tau, v with straighter axes; ``turn``: arc length of a turn [cm]."""
    out = signals.copy()
    cells = signals.shape[1]
    for b in prange(signals.shape[0]):
        kappa = signals[b, :, 0].copy()
        tau = signals[b, :, 1].copy()
        steer_strand(kappa, tau, signals[b, :, 2].mean() / cells, turn, steering)
        out[b, :, 0] = kappa
        out[b, :, 1] = tau
    return out


def with_arcs(values: NDArray[np.float64], arcs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Signals (B, L, 3) of strands of these arc lengths (B,) [cm]: v is scaled, which leaves kappa and tau alone."""
    out = values.copy()
    out[:, :, 2] *= (arcs / values[:, :, 2].mean(axis=1))[:, None]
    return out
