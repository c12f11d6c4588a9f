"""Four small hairstyles made in code, for galleries without grooms: long, bob, swept and short.

Each strand leaves the scalp along its normal and is led on, step by step, by where hair is combed to, by its weight,
and by the head, which it may not enter. Lengths in cm, y up, the head looks along +z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.groom import Groom
from detangled.head import Head
from detangled.view.gallery.figure import Style

Array = NDArray[np.float64]

# A head as an ellipsoid around the origin: 15 cm wide, 23 cm high, 19 cm deep.
HEAD = np.array([7.5, 11.5, 9.5])
STEP = 0.25  # [cm]
POINTS = 24  # of a strand
SCALP_SHARE = 0.42  # of the ellipsoid
JITTER = 0.02
# The hairline by how far a place faces front: at the nape, behind and before the ears, and over the forehead.
FACING, HAIRLINE = (-1.0, -0.2, 0.35, 1.0), (-0.3, -0.12, 0.2, 0.6)
RINGS, SIDES = 48, 64  # of the head's mesh


@dataclass(frozen=True)
class Cut:
    """How hair is cut and combed.

    length: [cm] of the longest. cut: height [cm] that no hair hangs below. parting: x [cm] from which it falls to
    either side; None for none. back, down: how strongly it is combed back, and how heavy it is. inward: how much it
    draws together below the ears. layer: [cm] that hair of the crown lies over the head. messy: deviation of the
    directions it grows and goes in.
    """

    name: str
    length: float
    cut: float
    parting: float | None
    back: float
    down: float
    inward: float
    layer: float
    messy: float = 0.06


CUTS = (
    Cut("long", 36.0, -21.0, 0.0, 0.15, 1.0, 0.16, 1.4, 0.08),
    Cut("bob", 24.0, -9.5, 2.2, 0.0, 1.0, 0.45, 1.7),
    Cut("swept", 17.0, -13.0, None, 2.2, 0.5, 0.5, 1.8, 0.08),
    Cut("short", 5.0, -13.0, None, -0.45, 0.8, 0.5, 0.7, 0.16),
)


def made_styles(strands: int, seed: int = 0) -> tuple[Style, ...]:
    """Four styles of about so many strands each, on one head."""
    head = head_mesh()
    return tuple(Style(cut.name, grown(cut, strands, [seed, number]), head) for number, cut in enumerate(CUTS))


def grown(cut: Cut, strands: int, seed: list[int]) -> Groom:
    """A groom of about so many strands, cut and combed."""
    rng = np.random.default_rng(seed)
    roots = scalp(strands, rng)
    count = len(roots)
    place = roots * HEAD
    direction = _unit(_unit(roots / HEAD) + rng.normal(0.0, cut.messy, (count, 3)))
    side = np.zeros(count) if cut.parting is None else np.where(place[:, 0] > cut.parting, 1.0, -1.0)
    # What grows higher lies above what grows lower; each lies a little apart from its neighbours.
    layer = 0.3 + cut.layer * np.maximum(roots[:, 1], 0.0) + rng.uniform(0.0, 0.5, count)
    longest = cut.length * rng.normal(1.0, 0.05, count)
    drift = rng.normal(0.0, cut.messy, (count, 3))
    lowest = cut.cut + rng.normal(0.0, 0.5, count)
    path = [place]
    arc = np.zeros(count)
    growing = np.ones(count, dtype=np.bool_)
    for _ in range(int(1.3 * cut.length / STEP)):
        # Leaves the scalp first, and gives way to the comb and to its weight within a centimetre or two.
        follow = 0.34 * np.minimum(arc / min(2.0, 0.2 * cut.length) + 0.1, 1.0)[:, None]
        direction = _unit(direction + follow * (_combed(place, side, cut) + drift))
        new = _outside(place + STEP * direction, np.minimum(layer, 0.2 + 0.6 * arc))
        direction = _unit(new - place)
        growing &= (arc < longest) & (new[:, 1] > lowest)
        place = np.where(growing[:, None], new, place)
        arc = arc + STEP * growing
        path.append(place)
    paths = np.stack(path, axis=1)  # (S, steps, 3)
    return Groom.from_strands([_even(one) for one in paths if np.ptp(one, axis=0).max() > 2.0 * STEP], up="y")


def scalp(strands: int, rng: np.random.Generator) -> Array:
    """About so many evenly spread roots as points of the unit sphere that HEAD stretches, (S, 3)."""
    lattice = max(int(strands / SCALP_SHARE), 8)
    index = np.arange(lattice) + 0.5
    height = 1.0 - 2.0 * index / lattice
    turn = np.pi * (1.0 + np.sqrt(5.0)) * index
    flat = np.sqrt(1.0 - height**2)
    places = np.stack([flat * np.sin(turn), height, flat * np.cos(turn)], axis=1)
    places = _unit(places + rng.normal(0.0, JITTER, places.shape))
    facing = np.cos(np.arctan2(places[:, 0], places[:, 2]))
    return np.asarray(places[places[:, 1] > np.interp(facing, FACING, HAIRLINE)])


def head_mesh() -> Head:
    """The ellipsoid as triangles."""
    polar = np.linspace(0.0, np.pi, RINGS + 1)
    around = np.linspace(0.0, 2.0 * np.pi, SIDES, endpoint=False)
    ring = np.stack(
        [
            np.sin(polar)[:, None] * np.sin(around),
            np.repeat(np.cos(polar)[:, None], SIDES, axis=1),
            np.sin(polar)[:, None] * np.cos(around),
        ],
        axis=2,
    )
    a = np.arange(RINGS)[:, None] * SIDES + np.arange(SIDES)
    b = np.arange(RINGS)[:, None] * SIDES + (np.arange(SIDES) + 1) % SIDES
    lower = [np.stack([a, a + SIDES, b], axis=2), np.stack([b, a + SIDES, b + SIDES], axis=2)]
    faces = np.concatenate([part.reshape(-1, 3) for part in lower])
    return Head(ring.reshape(-1, 3) * HEAD, faces)


def _combed(place: Array, side: Array, cut: Cut) -> Array:
    """The directions (S, 3) that hair at these places is drawn in."""
    x, y, z = (place / HEAD).T
    front = _smooth((z + 0.2) / 0.8) * _smooth((1.3 - np.abs(x)) / 0.5) * _smooth((y + 0.4) / 0.6)
    top = _smooth((y - 0.1) / 0.6)
    lead = np.zeros_like(place)
    lead[:, 0] = side * (0.9 * top + 0.9 * front)
    lead[:, 1] = -cut.down
    # Beyond the back of the head it falls.
    lead[:, 2] = -cut.back * np.maximum(front, top) * _smooth((z + 1.0) / 0.7) - 0.5 * front * np.abs(side)
    low = cut.inward * _smooth((-0.2 - y) / 0.7)[:, None]
    lead[:, [0, 2]] -= low * _unit(place[:, [0, 2]] + 1e-9)
    return _unit(lead + 1e-9)


def _outside(place: Array, least: Array) -> Array:
    """Places moved out of the head until they lie ``least`` (S,) [cm] from it."""
    level = np.linalg.norm(place / HEAD, axis=1)
    slope = place / HEAD**2
    size = np.linalg.norm(slope, axis=1)
    # First-order distance to the ellipsoid: exact enough within a few cm of it. Below the chin there is no head.
    away = (level - 1.0) * level / size
    missing = np.maximum(least - away, 0.0) * _smooth((place[:, 1] / HEAD[1] + 1.0) / 0.4)
    return np.asarray(place + (missing / size)[:, None] * slope)


def _even(path: Array) -> Array:
    """POINTS points at equal arc lengths along a polyline (n, 3)."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0.0, arc[-1], POINTS)
    return np.stack([np.interp(at, arc, c) for c in path.T], axis=1)


def _smooth(t: Array) -> Array:
    t = np.clip(t, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))
