"""What retexture says of its work beside the groom: a report as JSON, and a picture before and after."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from detangled import __version__

if TYPE_CHECKING:
    from detangled.base_texture import Texture
    from detangled.groom import Groom
    from detangled.head import Head
    from detangled.retexturing import Options, Result

PREVIEW_SIZE = (1024, 1024)  # [px] of either panel


class Stages:
    """Seconds of each stage of a run, as it is left."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = round(self.seconds.get(name, 0.0) + time.perf_counter() - began, 3)

    @property
    def total(self) -> float:
        """Of all stages."""
        return sum(self.seconds.values())


def report(
    source: Path,
    target: Path,
    before: Groom,
    texture: Texture,
    options: Options,
    result: Result,
    warnings: list[str],
    stages: Stages,
) -> dict[str, Any]:
    """Guides, lengths [cm], labels before and after, penetrations, warnings, seconds, seed, models and versions."""
    from detangled.geometry.arc import arc_lengths
    from detangled.grooming.guides import style_guides
    from detangled.labeling import label
    from detangled_cli.label_summary import summary

    after = result.groom
    with stages.stage("report"):
        labels = {name: summary(label(groom)) for name, groom in (("before", before), ("after", after))}
        guides = {name: style_guides(groom) for name, groom in (("before", before), ("after", after))}
    return {
        "version": __version__,
        "in": str(source),
        "out": str(target),
        "seed": options.seed,
        "steps": options.steps,
        "length": options.length.value,
        "texture": {
            "radius_cm": texture.radius,
            "wavelength_cm": None if np.isnan(texture.wavelength) else texture.wavelength,
            "method": getattr(texture, "method", None),
        },
        "strands": {
            "before": before.strand_count,
            "retextured": result.strands,
            "after": after.strand_count,
            "passed_through": result.passed_through.tolist(),
        },
        "points": {"before": len(before.points), "after": len(after.points)},
        "guides": {name: len(found.kept) for name, found in guides.items()},
        "guide_length_cm": {name: _spread(found.lengths) for name, found in guides.items()},
        "arc_length_cm": {
            name: _spread(arc_lengths(found.groom.points, found.groom.offsets)) for name, found in guides.items()
        },
        "labels": labels,
        "penetration": None if result.penetration is None else _plain(asdict(result.penetration)),
        "done": result.notes,
        "warnings": warnings,
        "seconds": {**stages.seconds, "total": round(stages.total, 3)},
        "models": _models(),
    }


def write_report(facts: dict[str, Any], path: Path) -> None:
    """Write a report as JSON. Raises WriteError where it cannot be written."""
    from detangled.formats import replacing

    with replacing(path) as beside:
        beside.write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")


def write_preview(before: Groom, after: Groom, names: tuple[str, str], head: Head | None, path: Path) -> None:
    """Draw a groom before and after, framed alike. Raises WriteError where the picture cannot be written."""
    from detangled.view.picture import render, save

    save(render([before, after], PREVIEW_SIZE, captions=names, head=head), path)


def _spread(values: Any) -> dict[str, float] | None:
    if len(values) == 0:
        return None
    return {"least": float(values.min()), "median": float(np.median(values)), "most": float(values.max())}


def _plain(facts: dict[str, Any]) -> dict[str, Any]:
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in facts.items()}


def _models() -> dict[str, Any]:
    """The models that are installed: each file's checksum, and what its manifest says of its training."""
    from detangled.models import FILES, models_folder

    found = {}
    for kind, name in FILES.items():
        manifest = (models_folder() / name).with_suffix(".json")
        if manifest.is_file():
            said = json.loads(manifest.read_text(encoding="utf-8"))
            found[kind] = {"file": name, "version": said.get("version"), "sha256": said.get("sha256")}
    return found
