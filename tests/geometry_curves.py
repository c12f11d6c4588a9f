"""Curves with known geometry, for the tests of strand geometry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Means of the eight types' radius, wavelength and arc length [cm], for those that curl.
TYPES = {
    "III": (0.75, 6.0, 28.0),
    "IV": (0.95, 3.8, 25.0),
    "V": (0.65, 2.2, 22.0),
    "VI": (0.42, 1.25, 18.0),
    "VII": (0.28, 0.75, 14.0),
    "VIII": (0.18, 0.42, 12.0),
}


def helix(radius: float, wavelength: float, turns: float, per_turn: float, hand: int = 1) -> NDArray[np.float64]:
    """Points (n, 3) of a helix down the z-axis; hand +1 is right-handed (tau > 0)."""
    angle = np.arange(round(turns * per_turn) + 1) * (2 * np.pi / per_turn)
    z = -angle * wavelength / (2 * np.pi)
    # Going down, a right-handed helix turns clockwise as seen from above.
    return np.stack([radius * np.cos(angle), -hand * radius * np.sin(angle), z], axis=1)


def bends(length: float, curvature: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A planar curve (n, 3) of a length, and its tangents, bending by ``curvature`` (n,) radians a length."""
    u = np.linspace(0.0, 1.0, curvature.shape[0])
    angle = np.concatenate([[0.0], np.cumsum((curvature[1:] + curvature[:-1]) / 2 * np.diff(u))])
    tangent = np.stack([np.sin(angle), np.zeros_like(angle), -np.cos(angle)], axis=1)
    steps = (tangent[1:] + tangent[:-1]) / 2 * np.diff(u)[:, None] * length
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]), tangent


def wound(
    radius: float,
    wavelength: float,
    length: float,
    points: int,
    bend: float = 1.0,
    s_shaped: bool = False,
    phase: float = 0.0,
    hand: int = 1,
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """A helix of an arc length wound on an arc or an S-curve, its guide (both (n, 3)), and its number of turns."""
    turns = length / np.hypot(2 * np.pi * radius, wavelength)
    u = np.linspace(0.0, 1.0, 4001)
    guide, tangent = bends(turns * wavelength, np.where(s_shaped & (u > 0.5), -bend, bend))
    # In a plane, the normal carried along stays the plane's.
    across = np.array([0.0, 1.0, 0.0])
    angle = (phase - hand * 2 * np.pi * turns * u)[:, None]
    strand = guide + radius * (np.cos(angle) * np.cross(across, tangent) + np.sin(angle) * across)
    at = chords(strand)
    return *(resampled(at, curve, points) for curve in (strand, guide)), turns


def chords(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cumulated polyline length at each point."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def resampled(at: NDArray[np.float64], values: NDArray[np.float64], points: int) -> NDArray[np.float64]:
    """Values (points, C) at even steps of the increasing parameter ``at``."""
    even = np.linspace(0.0, at[-1], points)
    return np.stack([np.interp(even, at, column) for column in values.T], axis=1)


def random_rotation(rng: np.random.Generator) -> NDArray[np.float64]:
    """A rotation (3, 3), any one as likely as another."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def aligned(points: NDArray[np.float64], onto: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points (n, 3) moved rigidly as near as can be to others (n, 3) (Kabsch)."""
    centre, goal = points.mean(axis=0), onto.mean(axis=0)
    u, _, vt = np.linalg.svd((points - centre).T @ (onto - goal))
    u[:, 2] *= np.sign(np.linalg.det(u @ vt))
    return (points - centre) @ (u @ vt) + goal


def one_signal(points: NDArray[np.float64], cells: int = 256) -> NDArray[np.float64]:
    """kappa, tau, v (cells, 3) of one strand."""
    from detangled.geometry.signal import signals

    return signals(points, [0, len(points)], [0, cells])
