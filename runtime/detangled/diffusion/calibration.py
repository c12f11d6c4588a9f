"""Calibration of what a network draws: curvature and torsion spread as they do in the strands it was fitted to.

A network trained for minutes predicts means a little too narrow, and draws curvatures a few percent off. How often each
value occurs is known of the strands themselves, so each value drawn is replaced by the one of equal rank among theirs:
a monotone map of each channel, the identity where the network is right. Strands' ends are compared with ends: an axis
is known least well there, which shows as sudden bends. Longer strands than those it was fitted to come out otherwise,
and are compared by themselves. A strand made of what was drawn is smoother and straighter: most of what that changes is
given beforehand.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

END_SHARE = 0.1  # of a strand, at either end
# Ranks that are compared: even ones, and closer towards the tails, where a few cells bend the most.
_TAIL = (0.001, 0.002, 0.004, 0.007, 0.012)
RANKS = np.array([*_TAIL, *np.linspace(0.02, 0.98, 49), *(1.0 - rank for rank in reversed(_TAIL))])

# Making strands changes the outermost values by far, by chance: they are given what those within these ranks are.
_INNER = np.searchsorted(RANKS, [0.02, 0.99])
ROUNDS, GIVEN = 3, 0.3  # so often such a share of what is missing is given; all of it would be too much for torsion
LONGER = 4.0  # times as long as the strands it was fitted to: strands are compared at this length too

Channels = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def calibration(
    drawn: NDArray[np.float64],
    wanted: list[NDArray[np.float64]],
    as_made: Channels | None = None,
    mirrored: Channels | None = None,
) -> NDArray[np.float64]:
    """Values of equal rank, (2, 2, 2, Q), of whitened channels: of strands drawn, (B, 3, L), and those wanted, (3, n).

    Axes: the middle and the ends of strands; kappa and tau; as drawn and as wanted; ranks. as_made: what becomes of
    calibrated channels once strands are made of them; None for nothing. mirrored: where both hands are to count alike.
    """
    raw, aim = _quantiles(list(drawn), mirrored), _quantiles(wanted, mirrored)
    levels = np.stack([raw, aim], axis=2)
    if as_made is None:
        return levels
    for _ in range(ROUNDS):
        found = _quantiles(list(as_made(calibrated(drawn, levels))), mirrored)
        missing = (aim - found)[..., np.clip(np.arange(len(RANKS)), *_INNER)]
        levels[:, :, 1] = np.apply_along_axis(_rising, -1, levels[:, :, 1] + GIVEN * missing)
    return levels


def for_length(levels: NDArray[np.float64], times: float) -> NDArray[np.float64]:
    """The calibration (2, 2, 2, Q) of strands so many times as long as those the network was fitted to.

    levels: (2, 2, 2, 2, Q), of strands as long as those, and of ones LONGER times as long.
    """
    share = np.clip(np.log(times) / np.log(LONGER), 0.0, 1.0)
    return (1.0 - share) * levels[0] + share * levels[1]


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


def _quantiles(strands: list[NDArray[np.float64]], mirrored: Channels | None) -> NDArray[np.float64]:
    """Of kappa and tau in the middle and at the ends of strands (3, n), (2, 2, Q)."""
    if mirrored is not None:
        strands = [*strands, *(mirrored(strand) for strand in strands)]
    return np.stack(
        [
            np.quantile(
                np.concatenate([strand[:2, _at_ends(strand.shape[1]) == at_ends] for strand in strands], axis=1),
                RANKS,
                axis=1,
            ).T
            for at_ends in (False, True)
        ]
    )


def _rising(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(isotonic_regression(values).x)


def _at_ends(cells: int) -> NDArray[np.bool_]:
    """Which cells (L,) of a strand are at its ends."""
    at = (np.arange(cells) + 0.5) / cells
    return (at < END_SHARE) | (at > 1.0 - END_SHARE)
