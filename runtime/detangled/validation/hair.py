"""What engines that read plain curves would drop or misread: strands, points, size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from detangled.groom import Groom
from detangled.presets import Engine
from detangled.presets.sizes import mixed_units
from detangled.units import cm_per_unit, unit_name
from detangled.usable import usable_strands
from detangled.validation import Finding

if TYPE_CHECKING:
    from detangled.validation.archive import Archive

_AXES = "xyz"
# Hair falls along one axis where its tips lie so many times further along it than along the others.
CLEARLY = 2.0


def findings(groom: Groom, engine: Engine) -> list[Finding]:
    """Findings about the strands of a groom, lengths in cm."""
    found = []
    counts = groom.point_counts
    unusable = int(np.count_nonzero(~usable_strands(groom)))
    if unusable:
        some = ", ".join(map(str, np.flatnonzero(~usable_strands(groom))[:5]))
        consequence = "the whole set is thrown away for one" if engine.title == "Unity" else "they are dropped"
        found.append(
            Finding(True, "", f"{unusable} strands without two distinct finite points ({some}): {consequence}")
        )
    if engine.most_points is not None and counts.max() > engine.most_points:
        over = int(np.count_nonzero(counts > engine.most_points))
        found.append(
            Finding(
                True,
                "",
                f"{over} strands of more than {engine.most_points} points, up to {counts.max():,}: the rest of each is "
                "cut off",
            )
        )
    if not engine.groups and engine.most_strands is not None and groom.strand_count > engine.most_strands:
        found.append(Finding(True, "", f"{groom.strand_count:,} strands, {engine.most_strands:,} are taken"))
    if groom.unit_source != "file" and groom.unit_cm != cm_per_unit(engine.unit):
        reason = "as given" if groom.unit_source == "given" else "by its size"
        found.append(
            Finding(True, "", f"in {unit_name(groom.unit_cm)} {reason}: {engine.title} takes it for {engine.unit}")
        )
    found += [Finding(True, "", sentence) for sentence in mixed_units(groom)]
    found += _fall(groom, engine)
    return found


def left_out_by_blender(archive: Archive) -> list[Finding]:
    """Attributes that Blender's Alembic import (seen in 4.5) leaves behind: all but points and widths."""
    found = []
    for curves in archive.curves:
        names = [p.name for p in (*curves.schema, *curves.arbitrary, *curves.user) if p.name != "width"]
        if names:
            found.append(
                Finding(
                    True,
                    curves.path,
                    f"Blender keeps only points and widths of an .abc, not {', '.join(names)}: write .usd to keep them",
                )
            )
    return found


def _fall(groom: Groom, engine: Engine) -> list[Finding]:
    """Hair that falls along another axis than the engine's: a file cannot say what is up, and hair may stand."""
    usable = usable_strands(groom)
    if engine.up is None or not usable.any():
        return []
    ends = groom.points[groom.offsets[1:][usable] - 1] - groom.points[groom.offsets[:-1][usable]]
    fall = ends.mean(axis=0)
    axis = int(np.argmax(np.abs(fall)))
    others = np.delete(np.abs(fall), axis).max()
    if _AXES[axis] == engine.up or fall[axis] >= 0.0 or -fall[axis] < CLEARLY * others:
        return []
    text = f"hair falls along -{_AXES[axis]}, {engine.title} takes {engine.up} for up: it may come to lie on its face"
    return [Finding(False, "", text)]
