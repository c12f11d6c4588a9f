"""New strands of a texture in canonical space, not on any groom: paper, section "Strand Synthesis"."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from detangled.base_texture import Texture
from detangled.diffusion.sampler import DEFAULT_STEPS
from detangled.drawing import draw_strands
from detangled.engines import engine_of
from detangled.errors import TextureError
from detangled.fitting import POINTS_PER_TURN
from detangled.geometry.arc import arc_lengths, arc_positions
from detangled.groom import Groom, offsets_of
from detangled.grooming.density import MOST_STRANDS, check_points
from detangled.grooming.lengths import Length, resized
from detangled.grooming.placing import cut, resample
from detangled.retexturing import drawn_arcs, points_to_make, strands_to_make, turns_about_axis
from detangled.settling import MOST_RESIZED

CHUNK = 512  # strands made at once
LENGTHS = (0.1, 2000.0)  # [cm]
SPARE = 1.02  # of the arc, to cut from
APART, LEAST_RADIUS = 4.0, 0.05  # radii between the axes of neighbours, each at least so many cm
IN_ROW = 16


def generate(
    texture: Texture,
    count: int,
    length: ArrayLike,
    seed: int = 0,
    steps: int = DEFAULT_STEPS,
    progress: Callable[[int], object] | None = None,
) -> Groom:
    """``count`` new strands of arc length ``length`` [cm], one for all or (count,), as a groom whose z-axis points up.

    All wind downwards about the z-axis (``side_by_side``). The same seed gives the same strands, and more of them those
    it gave before. progress: told how many strands were finished. Raises TextureError for no strands, lengths below
    0.1 cm or above 20 m, or more than ten thousand turns a strand; DetangledError for too many points in all.
    """
    given = np.asarray(length, dtype=np.float64)
    check_asked(count, given)
    if given.shape not in ((), (1,), (count,)):
        raise TextureError(f"generate at least one strand, with a length for each or one for all, not {given.shape}")
    lengths = np.array(np.broadcast_to(given, (count,)))
    check_points(count, points_to_make(texture, lengths, Length.STRAND), "--count or --length")
    spare = SPARE if texture.settling is None else SPARE * MOST_RESIZED
    wanted = strands_to_make(texture, lengths * spare, Length.STRAND, np.arange(count))
    wanted = replace(wanted, kept=drawn_arcs(texture, lengths, Length.STRAND))
    engine = engine_of(texture)
    strands: list[NDArray[np.float64]] = []
    for first in range(0, count, CHUNK):
        part = np.arange(first, min(first + CHUNK, count))
        drawn = draw_strands(texture, wanted.select(part), seed, steps, progress, engine)
        fine, offsets = resized(drawn.points, drawn.offsets, drawn.sizes), drawn.offsets
        if texture.shape is not None:
            fine = texture.shape.given_to(fine, offsets, lengths[part], False)
        fine, offsets = cut(fine, offsets, arc_positions(fine, offsets), lengths[part])
        counts = np.ceil(POINTS_PER_TURN * lengths[part] / texture.finest_turn).astype(np.int64) + 1
        sparse = offsets_of(np.maximum(counts, 2))
        points = resample(fine, offsets, sparse)
        # Points on a curve say a little less of its length than it has.
        scale = lengths[part] / arc_lengths(points, sparse)
        turned = Rotation.from_euler("z", turns_about_axis(seed, part)[:, None]).as_matrix() * scale[:, None, None]
        strands.extend(points[a:b] @ turn.T for (a, b), turn in zip(pairwise(sparse), turned, strict=True))
    return Groom.from_strands(strands, up="z")


def check_asked(count: int, lengths: ArrayLike) -> None:
    """Raise TextureError for a number of strands, or lengths [cm], that are not made."""
    if not 1 <= count <= MOST_STRANDS:
        raise TextureError(f"{count} strands cannot be made: ask for 1 to {MOST_STRANDS:,}")
    given = np.asarray(lengths, dtype=np.float64)
    if not ((given >= LENGTHS[0]) & (given <= LENGTHS[1])).all():
        raise TextureError(f"a strand is made {LENGTHS[0]:g} to {LENGTHS[1]:g} cm long")


def side_by_side(groom: Groom, in_row: int = IN_ROW) -> Groom:
    """Canonical strands beside each other, in rows of so many, their roots at one height.

    The y-axis is up: so most programs take files that do not say what is.
    """
    strands = [groom.strand(s)[:, [0, 2, 1]] * [1.0, 1.0, -1.0] for s in range(groom.strand_count)]
    spacing = APART * max(float(np.hypot(*groom.points[:, :2].T).mean()), LEAST_RADIUS)
    for number, points in enumerate(strands):
        points += [spacing * (number % in_row), -points[0, 1], -spacing * (number // in_row)]
    return Groom.from_strands(strands)
