"""Calibration of what a network draws: curvature and torsion spread as they do in the strands it was fitted to.

A network trained for minutes predicts means a little too narrow, and draws curvatures a few percent off. How often each
value occurs is known of the strands themselves, so each value drawn is replaced by the one of equal rank among theirs:
a monotone map of each channel, the identity where the network is right. Strands' ends are compared with ends: an axis
is known least well there, which shows as sudden bends.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

END_SHARE = 0.1  # of a strand, at either end
# Ranks that are compared: even ones, and closer towards the tails, where a few cells bend the most.
_TAIL = (0.001, 0.002, 0.004, 0.007, 0.012)
RANKS = np.array([*_TAIL, *np.linspace(0.02, 0.98, 49), *(1.0 - rank for rank in reversed(_TAIL))])


def calibration(drawn: list[NDArray[np.float64]], wanted: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Values of equal rank, (2, 2, 2, Q), of the whitened channels (3, n) of strands: drawn ones and those wanted.

    Axes: the middle and the ends of strands; kappa and tau; as drawn and as wanted; ranks.
    """
    return np.stack(
        [np.stack([_quantiles(strands, at_ends) for strands in (drawn, wanted)], axis=1) for at_ends in (False, True)]
    )


def calibrated(channels: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Whitened channels (B, 3, L) with kappa and tau as wanted. Beyond the outermost ranks the map is a shift."""
    out = channels.copy()
    ends = _at_ends(channels.shape[2])
    for cells, maps in ((~ends, values[0]), (ends, values[1])):
        for channel, (drawn, wanted) in enumerate(maps):
            given = channels[:, channel, cells]
            inside = np.clip(given, drawn[0], drawn[-1])
            out[:, channel, cells] = np.interp(inside, drawn, wanted) + (given - inside)
    return out


def _quantiles(strands: list[NDArray[np.float64]], at_ends: bool) -> NDArray[np.float64]:
    """Of kappa and tau, (2, Q)."""
    pooled = np.concatenate([strand[:2, _at_ends(strand.shape[1]) == at_ends] for strand in strands], axis=1)
    return np.quantile(pooled, RANKS, axis=1).T


def _at_ends(cells: int) -> NDArray[np.bool_]:
    """Which cells (L,) of a strand are at its ends."""
    at = (np.arange(cells) + 0.5) / cells
    return (at < END_SHARE) | (at > 1.0 - END_SHARE)
