"""Makes the example files beside it: a bob, and a few coily and wavy strands to take a texture from.

    python examples/make_examples.py [FOLDER]

Everything is procedural and seeded, so the same code gives the same files. Lengths here are in cm, y is up and
a head looks along +z. The strands are the paper's helices with twists (section "Procedural Modeling"); in place
of its simulation a strand is turned, stretch by stretch, until its axis hangs down.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from detangled.formats import write
from detangled.groom import Attribute, Groom, Scope

Array = NDArray[np.float64]
DOWN = np.array([0.0, -1.0, 0.0])
SEED = 7

# A head as an ellipsoid around the origin: 15 cm wide, 23 cm high, 19 cm deep.
HEAD = np.array([7.5, 11.5, 9.5])
LATTICE = 575  # points spread evenly over the ellipsoid; the scalp is a bit less than half of it
PARTING_X = 1.6
BOB_POINTS = 16
BOB_STEP = 0.1
BOB_CUT_Y = -11.5
BOB_LENGTHS = (12.5, 23.0)
ROOT_WIDTH, TIP_WIDTH = 0.008, 0.004

POINTS_A_TURN = 12
FINE = 8  # a strand is made with so many times the points that are written
TWISTS_PER_CM = 1.5  # at T_f = 1: the paper's most
MOST_WANDER = 1.06  # arc over chord of the axis: real hanging strands stay below about 1.08


# --- strands to take a texture from


@dataclass(frozen=True)
class Curl:
    """Root and tip values of radius and wavelength [cm], T_f in [0, 1], length of the axis [cm], all before jitter."""

    radius: tuple[float, float]
    wavelength: tuple[float, float]
    twist: float
    length: float


COILY = Curl(radius=(0.33, 0.37), wavelength=(0.95, 0.65), twist=0.3, length=14.0)
WAVY = Curl(radius=(0.65, 0.8), wavelength=(6.5, 5.0), twist=0.08, length=21.0)


def curly_strands(curl: Curl, count: int, rng: np.random.Generator) -> list[Array]:
    """``count`` strands side by side, each kept only if its axis hangs straight enough."""
    spacing = 5.0 * max(curl.radius)
    strands: list[Array] = []
    while len(strands) < count:
        strand = curly_strand(curl, rng)
        if wander(strand) < MOST_WANDER:
            strands.append(strand + np.array([spacing * len(strands), 0.0, 0.0]))
    return strands


def curly_strand(curl: Curl, rng: np.random.Generator) -> Array:
    """One strand of ``curl``, root at the origin, tip below it, about ``POINTS_A_TURN`` points a turn; (n, 3)."""
    radius, wavelength, length = rng.normal(1.0, 0.06, 3) * [1.0, 1.0, curl.length]
    handedness = rng.choice([-1.0, 1.0])
    # An angle for every fine step; the axis advances by a wavelength each turn. Twists can shorten it, so it
    # is made too long and cut.
    step = 2.0 * np.pi / (POINTS_A_TURN * FINE)
    angle, depth = [rng.uniform(0.0, 2.0 * np.pi)], [0.0]
    while depth[-1] < 1.25 * curl.length:
        here = wavelength * _between(curl.wavelength, depth[-1] / curl.length)
        angle.append(angle[-1] + handedness * step)
        depth.append(depth[-1] + here * step / (2.0 * np.pi))
    phi, y = np.array(angle), np.array(depth)
    r = radius * _between(curl.radius, y / curl.length)
    helix = np.stack([r * np.cos(phi), -y, r * np.sin(phi)], axis=1)

    segments = twisted(np.diff(helix, axis=0), curl.twist, rng)
    hanging = _chain(hung(segments, turn=POINTS_A_TURN * FINE))
    end = int(np.argmax(hanging[:, 1] < -length)) or len(hanging)
    return resampled(hanging[:end], end // FINE + 1)


def twisted(segments: Array, twist: float, rng: np.random.Generator) -> Array:
    """At random points, turn all that is downstream about the segment before it by an angle in (-pi, pi)."""
    arc = np.linalg.norm(segments, axis=1).sum()
    count = round(TWISTS_PER_CM * twist * arc)
    places = np.sort(rng.choice(np.arange(1, len(segments)), count, replace=False))
    out = segments.copy()
    for place, angle in zip(places, rng.uniform(-np.pi, np.pi, count), strict=True):
        out[place:] = out[place:] @ _rotation(out[place - 1], angle).T
    return out


def hung(segments: Array, turn: int) -> Array:
    """Turn each segment, and all below it, so that the mean direction over the turns around it points down."""
    window = np.hanning(3 * turn)
    room = len(window) // 2
    padded = np.pad(segments, ((room, room), (0, 0)), mode="reflect")
    mean = np.stack([np.convolve(c, window, mode="same")[room : room + len(segments)] for c in padded.T], axis=1)
    turned, out = np.eye(3), np.empty_like(segments)
    for i, direction in enumerate(mean):
        turned = _alignment(turned @ direction, DOWN) @ turned
        out[i] = turned @ segments[i]
    return out


def wander(strand: Array) -> float:
    """Arc over chord of a strand's axis, the mean over a turn taken twice."""
    box = np.ones(POINTS_A_TURN) / POINTS_A_TURN
    window = np.convolve(box, box)
    axis = np.stack([np.convolve(c, window, mode="valid") for c in strand.T], axis=1)
    return float(np.linalg.norm(np.diff(axis, axis=0), axis=1).sum() / np.linalg.norm(axis[-1] - axis[0]))


# --- the bob


def bob(rng: np.random.Generator) -> Groom:
    """About 250 guides on the ellipsoid's scalp, parted on the side, with root UVs, widths, ids and groups."""
    normals = scalp(rng)
    strands = [bob_strand(normal, rng) for normal in normals]
    count = len(strands)
    taper = np.linspace(ROOT_WIDTH, TIP_WIDTH, BOB_POINTS)
    left, behind = normals[:, 0] * HEAD[0] > PARTING_X, normals[:, 2] < -0.35
    # The scalp seen from above and spread out, so that no seam runs through it.
    from_crown = np.arccos(np.clip(normals[:, 1], -1.0, 1.0)) / np.pi
    around = normals[:, [0, 2]] / np.maximum(np.linalg.norm(normals[:, [0, 2]], axis=1, keepdims=True), 1e-9)
    uv = 0.5 + 0.75 * from_crown[:, None] * around
    attributes = {
        "width": Attribute(np.tile(taper, count).astype(np.float32), Scope.POINT),
        "uv": Attribute(uv.astype(np.float32), Scope.STRAND),
        "groom_id": Attribute(np.arange(count, dtype=np.int32), Scope.STRAND),
        "groom_group_id": Attribute(np.where(behind, 2, left).astype(np.int32), Scope.STRAND),
    }
    # In metres, as Blender would write it.
    return Groom.from_strands(strands, attributes=attributes, unit_cm=100.0, unit_source="given", objects=("bob",))


def scalp(rng: np.random.Generator) -> Array:
    """Evenly spread places of roots as points of the unit sphere that HEAD stretches, (n, 3)."""
    index = np.arange(LATTICE) + 0.5
    height = 1.0 - 2.0 * index / LATTICE
    turn = np.pi * (1.0 + np.sqrt(5.0)) * index
    flat = np.sqrt(1.0 - height**2)
    places = np.stack([flat * np.sin(turn), height, flat * np.cos(turn)], axis=1)
    places = places + rng.normal(0.0, 0.018, places.shape)
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    # From the nape over the ears to the top of the forehead the hairline rises.
    facing = np.cos(np.arctan2(places[:, 0], places[:, 2]))
    hairline = np.interp(facing, [-1.0, -0.2, 0.35, 1.0], [-0.24, -0.08, 0.22, 0.62])
    return np.asarray(places[places[:, 1] > hairline])


def bob_strand(place: Array, rng: np.random.Generator) -> Array:
    """A guide that leaves the scalp along its normal, then falls around the head; (BOB_POINTS, 3)."""
    side = 1.0 if place[0] * HEAD[0] > PARTING_X else -1.0
    point = place * HEAD
    direction = _unit(place / HEAD)
    # What grows higher lies above what grows lower.
    layer = 0.35 + 1.25 * max(place[1], 0.0) + rng.uniform(0.0, 0.3)
    cut = BOB_CUT_Y + 1.5 * place[1] + rng.normal(0.0, 0.35)
    path = [point]
    travelled = 0.0
    while travelled < BOB_LENGTHS[1] and (travelled < BOB_LENGTHS[0] or point[1] > cut):
        # Leaves the scalp first, and gives way to the comb and to its weight within 2 cm.
        follow = 0.16 * min(1.0, travelled / 2.0)
        direction = _unit(direction + follow * _combed(point, side))
        direction = _lifted(point, direction, min(layer, 0.25 + 0.6 * travelled))
        point = point + BOB_STEP * direction
        travelled += BOB_STEP
        path.append(point)
    waved = _waved(np.array(path), place, rng)
    return resampled(waved, BOB_POINTS)


def _combed(point: Array, side: float) -> Array:
    """The direction in which hair is drawn at a point: down, and out of the face."""
    x, y, z = point / HEAD
    front = _smooth((z - 0.1) / 0.6) * _smooth((1.4 - abs(x)) / 0.5)
    top = _smooth((y - 0.15) / 0.6)
    inward = _smooth((-0.35 - y) / 0.6)
    radial = _unit(np.array([x, 0.0, z]) + 1e-9)
    return _unit(DOWN + np.array([side * (1.1 * top + 1.2 * front), 0.0, -0.6 * front]) - 0.28 * inward * radial)


def _lifted(point: Array, direction: Array, layer: float) -> Array:
    """The direction, turned so that hair settles at about ``layer`` [cm] from the head, and never nearer."""
    outward = _unit(point / HEAD**2)
    # First-order distance to the ellipsoid: exact enough within a few cm of it.
    level = np.linalg.norm(point / HEAD)
    distance = (level - 1.0) * level / np.linalg.norm(point / HEAD**2)
    least = np.clip(1.2 * (layer - distance), -0.5, 0.5)
    # Above the ears hair also lies on what is below it; further down it hangs free.
    most = least + 0.1 + _smooth((0.5 - point[1] / HEAD[1]) / 0.7)
    away = float(direction @ outward)
    return _unit(direction + (np.clip(away, least, most) - away) * outward)


def _waved(path: Array, place: Array, rng: np.random.Generator) -> Array:
    """Add a gentle wave that neighbours share, across the strand and along the head, growing towards the tip."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    outward = path / HEAD**2
    across = np.cross(tangent, outward / np.linalg.norm(outward, axis=1, keepdims=True))
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 0.2)
    lift = np.cross(across, tangent)
    s = BOB_STEP * np.arange(len(path))
    wavelength = 6.5 + rng.normal(0.0, 0.2)
    phase = 1.5 * np.sin(2.3 * place[0] + 1.0) + 1.5 * np.sin(2.0 * place[2]) + rng.normal(0.0, 0.35)
    # Counted by height, so that the waves of neighbours lie side by side whatever their lengths.
    turn = -2.0 * np.pi * path[:, 1] / wavelength + phase
    size = (0.4 + rng.normal(0.0, 0.05)) * np.array([_smooth((x - 2.0) / 7.0) for x in s])
    sideways, outwards = size * np.sin(turn), 0.3 * size * (1.0 + np.cos(turn))
    # Never inwards, where the head is.
    return np.asarray(path + sideways[:, None] * across + outwards[:, None] * lift)


# --- both


def resampled(path: Array, count: int) -> Array:
    """``count`` points at equal arc lengths along a polyline."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0.0, arc[-1], count)
    return np.stack([np.interp(at, arc, c) for c in path.T], axis=1)


def _between(ends: tuple[float, float], t: float | Array) -> float | Array:
    return ends[0] + (ends[1] - ends[0]) * t


def _smooth(t: float) -> float:
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


def _chain(segments: Array) -> Array:
    return np.concatenate([np.zeros((1, 3)), np.cumsum(segments, axis=0)])


def _rotation(axis: Array, angle: float) -> Array:
    """The matrix that turns by ``angle`` about ``axis``."""
    x, y, z = _unit(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


def _alignment(source: Array, target: Array) -> Array:
    """The least rotation that turns one direction into another."""
    source, target = _unit(source), _unit(target)
    axis = np.cross(source, target)
    sine = np.linalg.norm(axis)
    if sine < 1e-12:
        return np.eye(3)
    return _rotation(axis, float(np.arctan2(sine, source @ target)))


def main(folder: Path) -> None:
    """Write bob.abc, coily_strands.obj and wavy_strands.obj into ``folder``."""
    rng = np.random.default_rng(SEED)
    folder.mkdir(parents=True, exist_ok=True)
    write(bob(rng), folder / "bob.abc")
    write(Groom.from_strands(curly_strands(COILY, 6, rng), objects=("coily",)), folder / "coily_strands.obj")
    write(Groom.from_strands(curly_strands(WAVY, 4, rng), objects=("wavy",)), folder / "wavy_strands.obj")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
