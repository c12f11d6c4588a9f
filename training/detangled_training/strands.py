"""Procedural strands: helices whose radius and wavelength may vary, with sudden twists.

Paper section "Procedural Modeling". A strand is stepped along its arc, so that its arc length is exact, and its angle
is the integral of 2 pi / wavelength, so that where the wavelength varies the local one is what was asked. Then each
twist turns everything downstream rigidly about the segment before it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detangled.errors import TextureError
from detangled.groom import Groom, offsets_of
from detangled.kernels import kernel, parallel_kernel, prange
from detangled.texture import HAIR_TYPES, TWISTS_PER_CM, WAVELENGTH_LIMITS, Profile, arc_of_a_turn

POINTS_PER_TURN = 32
LONGEST_STEP = 0.1  # [cm] between points, so that a twist has its place in straight hair too
FEWEST_SEGMENTS = 64

# How radius and wavelength run from root to tip: how often each kind occurs, and how much it varies.
KINDS = ("constant", "linear", "smooth")
KIND_SHARES = (0.4, 0.3, 0.3)
LINEAR_DEVIATION = 0.2  # of the logarithm of tip over root
MOST_LINEAR = 0.6
SMOOTH_DEVIATION = 0.12  # of the logarithm, in each of so many half-waves; above 0.3 a short strand may not exist
SMOOTH_WAVES = 3
KNOTS = 9  # of a profile: four between the zeros of the shortest half-wave
SHARES = 64  # of a strand's arc that its characteristic radius and wavelength are means of
UNTYPED = -1  # type of a strand that is of none: asked by its numbers, or drawn by independent ones

# Independent numbers, even in their logarithms: the radius, the slope of the helix (wavelength by circumference), and
# the arc; the twist prevalence is even.
UNTYPED_RADII = (0.08, 1.5)  # [cm]
UNTYPED_SLOPES = (0.08, 3.0)
UNTYPED_LENGTHS = (4.0, 50.0)  # [cm]
UNTYPED_TURNS = (3.0, 60.0)  # that an arc has at least and at most

_WHERE = 1  # tells the stream that places the twists from the one that the strand's numbers are drawn from


@dataclass(frozen=True)
class Recipes:
    """What defines strands, but for where their twists lie; an array each, S strands.

    number: (S,) names them: with a seed it decides the twists. kind: (S,) int8, index into HAIR_TYPES, or UNTYPED.
    radius, wavelength: (S, K) [cm] at K even shares of the arc, a smooth curve through them. twist: (S,) T_f.
    length: (S,) [cm] of arc. hand: (S,) int8, +1 right-handed (tau > 0), -1 left-handed.
    phase: (S,) [rad], where on the circle the strand begins.
    """

    number: NDArray[np.int64]
    kind: NDArray[np.int8]
    radius: NDArray[np.float64]
    wavelength: NDArray[np.float64]
    twist: NDArray[np.float64]
    length: NDArray[np.float64]
    hand: NDArray[np.int8]
    phase: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.number)

    def select(self, chosen: NDArray[np.int64]) -> Recipes:
        """Those of some strands."""
        return Recipes(**{field.name: getattr(self, field.name)[chosen] for field in fields(self)})

    @classmethod
    def asked(
        cls,
        radius: ArrayLike | Profile,
        wavelength: ArrayLike | Profile,
        twist: ArrayLike,
        length: ArrayLike,
        hand: ArrayLike = 1,
        phase: ArrayLike = 0.0,
        first: int = 0,
    ) -> Recipes:
        """Recipes by their numbers, arrays broadcast to (S,); a Profile along the strand counts for all of them.

        Raises TextureError where one is not finite, or not more than zero where it must be.
        """
        shares = np.linspace(0.0, 1.0, KNOTS)
        profiles = [
            value(shares)[None] if isinstance(value, Profile) else np.atleast_1d(np.asarray(value, float))[:, None]
            for value in (radius, wavelength)
        ]
        columns = [np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in (twist, length, hand, phase)]
        count = np.broadcast_shapes(*(p[:, 0].shape for p in profiles), *(c.shape for c in columns))[0]
        radii, wavelengths = (np.array(np.broadcast_to(p, (count, KNOTS))) for p in profiles)
        twists, lengths, hands, phases = (np.array(np.broadcast_to(c, (count,))) for c in columns)
        for name, values in (("radius", radii), ("wavelength", wavelengths), ("length", lengths)):
            if not (np.isfinite(values).all() and (values > 0.0).all()):
                raise TextureError(f"the {name} of a strand must be more than zero, and finite")
        if not ((twists >= 0.0) & (twists <= 1.0)).all():
            raise TextureError("the twist prevalence of a strand must be from 0 to 1")
        return cls(
            number=np.arange(first, first + count),
            kind=np.full(count, UNTYPED, dtype=np.int8),
            radius=radii,
            wavelength=wavelengths,
            twist=twists,
            length=lengths,
            hand=np.where(hands < 0.0, -1, 1).astype(np.int8),
            phase=phases,
        )


@dataclass(frozen=True)
class Strands:
    """Procedural strands: points (P, 3) [cm] about the negative z-axis, strand s from offsets[s] to offsets[s + 1].

    Labels, (S,) each: kind as in Recipes; radius and wavelength [cm], the mean radius and the axis' length per turn
    before twisting, between the margins; twist (T_f); length [cm] of arc; hand; twists, how many there are.
    ``body`` (S, 2): the rows of points between the margins, first and one past the last; all of them without margins.
    """

    points: NDArray[np.float64]
    offsets: NDArray[np.int64]
    kind: NDArray[np.int8]
    radius: NDArray[np.float64]
    wavelength: NDArray[np.float64]
    twist: NDArray[np.float64]
    length: NDArray[np.float64]
    hand: NDArray[np.int8]
    twists: NDArray[np.int64]
    body: NDArray[np.int64]

    def as_groom(self) -> Groom:
        """The strands as a groom whose z-axis points up."""
        return Groom(self.points, self.offsets, up="z")


def draw_recipes(
    count: int, seed: int, first: int = 0, kinds: ArrayLike | None = None, untyped: float = 0.0
) -> Recipes:
    """Recipes of strands ``first`` to ``first + count``, of the eight types: each from its own stream [seed, number].

    kinds: (count,) indices into HAIR_TYPES, or UNTYPED; None draws them, all types alike, but for a share ``untyped``
    of strands whose radius, slope, twist prevalence and length are drawn without regard to each other.
    """
    waves = 2 * SMOOTH_WAVES
    uniform = np.empty((count, 11))
    normal = np.empty((count, 2 + waves))
    for row in range(count):
        rng = np.random.default_rng([seed, first + row])
        uniform[row] = rng.random(uniform.shape[1])
        normal[row] = rng.standard_normal(normal.shape[1])
    if kinds is None:
        kind = (uniform[:, 0] * len(HAIR_TYPES)).astype(np.int8)
        kind[uniform[:, 9] < untyped] = UNTYPED
    else:
        kind = np.array(np.broadcast_to(np.asarray(kinds, dtype=np.int8), (count,)))
    drawn = np.empty((count, 4))
    for index, hair in enumerate(HAIR_TYPES):
        drawn[kind == index] = hair.at(uniform[kind == index, 1:5])
    drawn[kind == UNTYPED] = _independent(uniform[kind == UNTYPED, 1:5])
    radius, wavelength, twist, length = drawn.T
    # A radius varies over turns, not within one; and could not fast enough within a strand that is shorter than one.
    room = np.minimum(1.0, length / arc_of_a_turn(radius, wavelength))
    return Recipes(
        number=np.arange(first, first + count),
        kind=kind,
        radius=radius[:, None] * _profiles(uniform[:, 5], normal[:, 0], normal[:, 2 : 2 + SMOOTH_WAVES], room),
        wavelength=wavelength[:, None] * _profiles(uniform[:, 6], normal[:, 1], normal[:, 2 + SMOOTH_WAVES :], room),
        twist=twist,
        length=length,
        hand=np.where(uniform[:, 7] < 0.5, -1, 1).astype(np.int8),
        phase=2.0 * np.pi * uniform[:, 8],
    )


def _independent(shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Radius, wavelength, twist, length (S, 4) of quantiles (S, 4)."""
    radius, slope, length = (
        np.exp(np.interp(shares[:, column], (0.0, 1.0), np.log(limits)))
        for column, limits in ((0, UNTYPED_RADII), (1, UNTYPED_SLOPES), (3, UNTYPED_LENGTHS))
    )
    wavelength = np.clip(2.0 * np.pi * radius * slope, *WAVELENGTH_LIMITS)
    turn = arc_of_a_turn(radius, wavelength)
    return np.stack([radius, wavelength, shares[:, 2], np.clip(length / turn, *UNTYPED_TURNS) * turn], axis=1)


def _profiles(
    choice: NDArray[np.float64], slope: NDArray[np.float64], waves: NDArray[np.float64], room: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Factors (S, KNOTS) of geometric mean one along strands, of the kind that ``choice`` (S,) in [0, 1) picks."""
    kind = np.searchsorted(np.cumsum(KIND_SHARES)[:-1], choice, side="right")[:, None]
    t = np.linspace(0.0, 1.0, KNOTS)
    linear = np.clip(LINEAR_DEVIATION * slope, -MOST_LINEAR, MOST_LINEAR)[:, None] * (t - 0.5)
    smooth = SMOOTH_DEVIATION * waves.clip(-2.0, 2.0) @ np.cos(np.pi * np.arange(1, SMOOTH_WAVES + 1)[:, None] * t)
    logarithm = np.where(kind == 0, 0.0, np.where(kind == 1, linear, smooth)) * room[:, None]
    return np.exp(logarithm - logarithm.mean(axis=1, keepdims=True))


def make_strands(recipes: Recipes, seed: int, margin: ArrayLike = 0.0) -> Strands:
    """Strands of recipes. The same seed and number give the same strand, whatever comes with it.

    margin: (S,) [cm] of more strand before and after each, its radius and wavelength those of the end.
    """
    count = len(recipes)
    turn = arc_of_a_turn(recipes.radius, recipes.wavelength).min(axis=1)
    finest = np.minimum(turn / POINTS_PER_TURN, LONGEST_STEP)
    segments = np.maximum(np.ceil(recipes.length / finest), FEWEST_SEGMENTS).astype(np.int64)
    step = recipes.length / segments
    before = np.ceil(np.broadcast_to(np.asarray(margin, dtype=np.float64), (count,)) / step).astype(np.int64)
    offsets = offsets_of(segments + 1 + 2 * before)

    twists = np.round(TWISTS_PER_CM * recipes.twist * recipes.length).astype(np.int64)
    twists = np.minimum(twists, segments - 1)
    outer = np.minimum(np.round(TWISTS_PER_CM * recipes.twist * before * step).astype(np.int64), before)
    twist_offsets = offsets_of(twists + 2 * outer)
    at = np.empty(twist_offsets[-1], dtype=np.int64)
    angle = np.empty(twist_offsets[-1])
    for s, (a, b) in enumerate(pairwise(twist_offsets)):
        if b == a:
            continue
        rng = np.random.default_rng([seed, int(recipes.number[s]), _WHERE])
        at[a:b] = _twist_points(rng, int(segments[s]), int(before[s]), int(twists[s]), int(outer[s]))
        angle[a:b] = rng.uniform(-np.pi, np.pi, b - a)

    points = np.empty((offsets[-1], 3))
    radius, wavelength = np.empty(count), np.empty(count)
    _make(
        recipes.radius,
        recipes.wavelength,
        step,
        segments,
        before,
        recipes.hand,
        recipes.phase,
        at,
        angle,
        twist_offsets,
        offsets,
        points,
        radius,
        wavelength,
    )
    return Strands(
        points=points,
        offsets=offsets,
        kind=recipes.kind,
        radius=radius,
        wavelength=wavelength,
        twist=recipes.twist,
        length=recipes.length,
        hand=recipes.hand,
        twists=twists,
        body=np.stack([offsets[:-1] + before, offsets[1:] - before], axis=1),
    )


def procedural_strands(count: int, seed: int, first: int = 0, kinds: ArrayLike | None = None) -> Strands:
    """Strands ``first`` to ``first + count`` of a seed, of the eight types (``draw_recipes``)."""
    return make_strands(draw_recipes(count, seed, first, kinds), seed)


def characteristic(
    recipes: Recipes, begin: NDArray[np.float64], end: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Radius and wavelength (S,) [cm] that characterise strands, untwisted, from ``begin`` to ``end`` (S,) of the arc.

    The mean radius, and the axis' length per turn.
    """
    radius, wavelength = (_along_all(knots, begin, end) for knots in (recipes.radius, recipes.wavelength))
    return helix_means(radius, wavelength)


def helix_means(
    radius: NDArray[np.float64], wavelength: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The mean radius (S,) of local ones (S, N) at even steps of arc, and the axis' length per turn (S,), [cm]."""
    fall = wavelength / arc_of_a_turn(radius, wavelength)
    return radius.mean(axis=1), fall.sum(axis=1) / (fall / wavelength).sum(axis=1)


def _twist_points(rng: np.random.Generator, segments: int, before: int, twists: int, outer: int) -> NDArray[np.int64]:
    """Increasing indices of the points that twist: ``twists`` inside the body, ``outer`` in each margin."""
    parts = [before + 1 + rng.choice(segments - 1, twists, replace=False)]
    for start in (1, before + segments):
        parts.append(start + rng.choice(before, outer, replace=False))
    return np.sort(np.concatenate(parts))


@kernel
def _along(knots: NDArray[np.float64], share: float) -> tuple[float, float]:
    """Value and slope, per unit of ``share`` in [0, 1], of the smooth (Catmull-Rom) curve through even knots (K,)."""
    last = knots.shape[0] - 1
    at = min(max(share, 0.0), 1.0) * last
    i = min(int(at), last - 1)
    u = at - i
    low = knots[i]
    high = knots[i + 1]
    left = 0.5 * (high - knots[i - 1]) if i > 0 else high - low
    right = 0.5 * (knots[i + 2] - low) if i < last - 1 else high - low
    value = low + u * (left + u * (3.0 * (high - low) - 2.0 * left - right + u * (left + right - 2.0 * (high - low))))
    slope = left + u * (2.0 * (3.0 * (high - low) - 2.0 * left - right) + 3.0 * u * (left + right - 2.0 * (high - low)))
    return value, slope * last


@parallel_kernel
def _along_all(knots: NDArray[np.float64], begin: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values (S, SHARES) of curves through knots (S, K), in the middles of even steps from begin to end (S,)."""
    out = np.empty((knots.shape[0], SHARES))
    for s in prange(knots.shape[0]):
        for i in range(SHARES):
            out[s, i] = _along(knots[s], begin[s] + (end[s] - begin[s]) * (i + 0.5) / SHARES)[0]
    return out


@kernel
def _helix(
    radius: NDArray[np.float64],
    wavelength: NDArray[np.float64],
    step: float,
    segments: int,
    before: int,
    hand: int,
    phase: float,
    out: NDArray[np.float64],
) -> tuple[float, float]:
    """Fill ``out`` (n, 3) with an untwisted strand; return its mean radius and wavelength between the margins.

    Each step of arc ds goes down by dz, where ds^2 = dr^2 + (2 pi r dz / wavelength)^2 + dz^2.
    """
    length = step * segments
    angle = phase
    z = 0.0
    mean = 0.0
    depth = 0.0
    turned = 0.0
    for i in range(out.shape[0]):
        r, _ = _along(radius, (i - before) / segments)
        out[i, 0] = r * np.cos(angle)
        out[i, 1] = -hand * r * np.sin(angle)
        out[i, 2] = z
        share = (i + 0.5 - before) / segments
        r, slope = _along(radius, share)
        wave, _ = _along(wavelength, share)
        inside = 0.0 < share < 1.0
        widening = slope / length if inside else 0.0
        per_z = 2.0 * np.pi / wave
        fall = step * np.sqrt(max(1.0 - widening * widening, 0.0) / (1.0 + (r * per_z) ** 2))
        angle += per_z * fall
        z -= fall
        if inside:
            mean += r
            depth += fall
            turned += per_z * fall
    return mean / segments, 2.0 * np.pi * depth / turned


@kernel
def _turn(rotation: NDArray[np.float64], x: float, y: float, z: float, angle: float) -> NDArray[np.float64]:
    """``rotation`` (3, 3) after a turn by ``angle`` about the direction (x, y, z), of any length above zero."""
    size = np.sqrt(x * x + y * y + z * z)
    x /= size
    y /= size
    z /= size
    c = np.cos(angle)
    s = np.sin(angle)
    d = 1.0 - c
    turn = np.array(
        [
            [c + d * x * x, d * x * y - s * z, d * x * z + s * y],
            [d * x * y + s * z, c + d * y * y, d * y * z - s * x],
            [d * x * z - s * y, d * y * z + s * x, c + d * z * z],
        ]
    )
    out = np.zeros((3, 3))
    for a in range(3):
        for b in range(3):
            for k in range(3):
                out[a, b] += rotation[a, k] * turn[k, b]
    return out


@kernel
def _twist(strand: NDArray[np.float64], at: NDArray[np.int64], angle: NDArray[np.float64]) -> None:
    """Twist a strand (n, 3) in place at points ``at`` (W,), increasing: all beyond turns about the segment before."""
    rotation = np.eye(3)
    before = strand[0].copy()
    here = strand[0].copy()
    segment = np.zeros(3)
    w = 0
    for i in range(1, strand.shape[0]):
        while w < at.shape[0] and at[w] == i - 1:
            rotation = _turn(rotation, segment[0], segment[1], segment[2], angle[w])
            w += 1
        for c in range(3):
            segment[c] = strand[i, c] - before[c]
            before[c] = strand[i, c]
        for a in range(3):
            here[a] += rotation[a, 0] * segment[0] + rotation[a, 1] * segment[1] + rotation[a, 2] * segment[2]
            strand[i, a] = here[a]


@parallel_kernel
def _make(
    radius: NDArray[np.float64],  # (S, K)
    wavelength: NDArray[np.float64],  # (S, K)
    step: NDArray[np.float64],
    segments: NDArray[np.int64],
    before: NDArray[np.int64],
    hand: NDArray[np.int8],
    phase: NDArray[np.float64],
    at: NDArray[np.int64],
    angle: NDArray[np.float64],
    twist_offsets: NDArray[np.int64],
    offsets: NDArray[np.int64],
    points: NDArray[np.float64],
    mean_radius: NDArray[np.float64],
    mean_wavelength: NDArray[np.float64],
) -> None:
    for s in prange(offsets.shape[0] - 1):
        strand = points[offsets[s] : offsets[s + 1]]
        mean_radius[s], mean_wavelength[s] = _helix(
            radius[s], wavelength[s], step[s], segments[s], before[s], hand[s], phase[s], strand
        )
        a = twist_offsets[s]
        b = twist_offsets[s + 1]
        _twist(strand, at[a:b], angle[a:b])


def twist_prevalence(twists: NDArray[np.int64], length: NDArray[np.float64]) -> NDArray[np.float64]:
    """T_f (S,) of strands by the twists that they have, not those asked for, and their arc lengths [cm]."""
    return np.clip(twists / (TWISTS_PER_CM * length), 0.0, 1.0)
