"""How closely strands are rebuilt from their kappa-tau-v signals, for several ways to smooth and to differentiate.

python benchmarks/fidelity.py STRANDS [--cells 256] [--unit cm]

Each strand is measured, rebuilt, and laid rigidly as near as can be on the spline through its points. Printed is the
worst distance along a strand over its curl radius: the median and the ninetieth percentile over strands. Smoothing
is bounded by the width of a cell (as detangled does), unbounded (the paper's rule alone), or off. kappa and tau come
from the angles between neighbouring tangents and normals (as detangled does), or as <T', N> and <N', B> from gamma''
and gamma'''. The arc length of cells is the same throughout.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from detangled import formats
from detangled.geometry.canonical import phi
from detangled.geometry.centerline import centerlines
from detangled.geometry.frenet import frames, lift_tiny
from detangled.geometry.signal import MOST_BLUR_CELLS, cell_means, cumulated, curve_of, dense_count, derivatives
from detangled.geometry.smoothing import smooth_channels
from detangled.geometry.spline import chord_lengths, distinct_points, spline_sample, spline_slopes, uniform_slopes


def cumulated_from_derivatives(
    first: NDArray[np.float64], second: NDArray[np.float64], step: float, per_segment: float, most_blur: float
) -> NDArray[np.float64]:
    """As ``cumulated``, with kappa and tau from the smoothed gamma'' and gamma''' of the paper's formulas."""
    third = uniform_slopes(second, step)
    lift_tiny(third)
    smooth_channels(third, step, most_blur)
    tangent, normal, own = frames(first, second, step, per_segment, 0.0)
    binormal = np.cross(tangent, normal)
    speed = np.linalg.norm(first, axis=1)
    across = np.einsum("ij,ij->i", second, normal)
    kappa = np.maximum(across, 0.0) / speed**2
    # <N', B> of N = the part of gamma'' across T, over its length.
    tau = np.einsum("ij,ij->i", third, binormal) / np.where(own, across, np.inf) / speed
    rates = np.stack([kappa * speed, tau * speed, speed], axis=1)
    return np.concatenate([np.zeros((1, 3)), np.cumsum((rates[1:] + rates[:-1]) / 2 * step, axis=0)])


def aligned(points: NDArray[np.float64], onto: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points (n, 3) moved rigidly as near as can be to others (n, 3) (Kabsch)."""
    centre, goal = points.mean(axis=0), onto.mean(axis=0)
    u, _, vt = np.linalg.svd((points - centre).T @ (onto - goal))
    u[:, 2] *= np.sign(np.linalg.det(u @ vt))
    return (points - centre) @ (u @ vt) + goal


def drift(points: NDArray[np.float64], cells: int, blur_cells: float, by_angles: bool) -> float:
    """Worst distance [cm] between the spline through a strand (n, 3) and the curve rebuilt from its signal."""
    samples = dense_count(points.shape[0], cells)
    most_blur = blur_cells * samples / cells
    per_segment = samples / (points.shape[0] - 1)
    first, second, step = derivatives(points, samples, most_blur)
    if by_angles:
        total = cumulated(first, second, step, per_segment, 0.0)
    else:
        total = cumulated_from_derivatives(first, second, step, per_segment, most_blur)
    signal = np.empty((cells, 3))
    cell_means(total, signal)
    rebuilt = curve_of(signal)
    t = chord_lengths(points)
    strand = spline_sample(t, points, spline_slopes(t, points), np.linspace(0.0, t[-1], rebuilt.shape[0]))
    return float(np.linalg.norm(aligned(rebuilt, strand) - strand, axis=1).max())


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("strands", help="a groom of curly strands")
    parser.add_argument("--cells", type=int, default=256)
    parser.add_argument("--unit")
    options = parser.parse_args(arguments)

    groom = formats.read(options.strands, options.unit)
    guides, _ = centerlines(groom.points, groom.offsets)
    strands, radii = [], []
    for start, end in zip(groom.offsets[:-1], groom.offsets[1:], strict=True):
        strand = distinct_points(np.asarray(groom.points[start:end], dtype=np.float64))
        canonical = phi(np.asarray(groom.points[start:end], dtype=np.float64), guides[start:end])
        radius = float(np.median(np.hypot(canonical[:, 0], canonical[:, 1])))
        if len(strand) >= 2 and radius > 0.0:
            strands.append(strand)
            radii.append(radius)
    print(f"{len(strands)} strands that curl, radius {np.median(radii):.3g} cm, {options.cells} cells")
    print("worst drift / radius      angles: median   p90   derivatives: median   p90")
    for name, blur in (("bounded", MOST_BLUR_CELLS), ("unbounded", np.inf), ("off", 0.0)):
        row = []
        for by_angles in (True, False):
            drifts = [drift(s, options.cells, blur, by_angles) for s in strands]
            row.append(np.percentile(np.array(drifts) / radii, [50, 90]))
        (angles, angles_90), (derived, derived_90) = row
        print(f"smoothing {name:9} {angles:21.2f} {angles_90:5.2f} {derived:21.2f} {derived_90:5.2f}")


if __name__ == "__main__":
    main()
