"""Radius and wavelength of canonical strands by counting how they wind about the axis.

In canonical space r = sqrt(x^2 + y^2) and the angle phi = atan2(y, x): the radius is the mean of r, values beyond
three standard deviations left out (paper section "Style guide resampling"); the wavelength is the axis' length per
2 pi of winding, of either hand.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import kernel, parallel_kernel, prange

STRAIGHT_RADIUS = 1e-3  # [cm] a tenth of a hair's width: what is nearer to the axis does not wind
OUTLIER_DEVIATIONS = 3.0


@kernel
def mean_without_outliers(values: NDArray[np.float64]) -> float:
    """The mean of values (N,), those beyond three standard deviations left out; 0 for none."""
    if values.shape[0] == 0:
        return 0.0
    mean = values.mean()
    deviation = values.std()
    total = 0.0
    count = 0
    for i in range(values.shape[0]):
        if abs(values[i] - mean) <= OUTLIER_DEVIATIONS * deviation + 1e-12:
            total += values[i]
            count += 1
    return total / max(count, 1)


@parallel_kernel
def winding(points: NDArray[np.float64], offsets: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Radius and wavelength (S,) [cm] of canonical strands; the wavelength of one that does not wind is NaN.

    Needs more than two points a turn, since the angle between neighbours is taken as less than half a turn.
    """
    strands = offsets.shape[0] - 1
    radius = np.zeros(strands)
    wavelength = np.full(strands, np.nan)
    for s in prange(strands):
        strand = points[offsets[s] : offsets[s + 1]]
        n = strand.shape[0]
        if n < 3:
            continue
        radius[s] = mean_without_outliers(np.sqrt(strand[:, 0] ** 2 + strand[:, 1] ** 2))
        if radius[s] < STRAIGHT_RADIUS:
            continue
        total = 0.0
        for i in range(1, n):
            side = strand[i - 1, 0] * strand[i, 1] - strand[i - 1, 1] * strand[i, 0]
            along = strand[i - 1, 0] * strand[i, 0] + strand[i - 1, 1] * strand[i, 1]
            total += abs(np.arctan2(side, along))
        if total > 0.0:
            wavelength[s] = 2.0 * np.pi * abs(strand[n - 1, 2] - strand[0, 2]) / total
    return radius, wavelength
