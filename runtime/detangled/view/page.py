"""Pages: one file that shows a groom, or one before and after, in a browser without a network.

The page is made of page_template.html, which is built from the sources in web/ (`npm ci && npm run build` there),
and of what the groom is: its points (page_points.py), its labels and their summary.
"""

from __future__ import annotations

import html
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from detangled import __version__
from detangled.errors import DetangledError, ReadError, WriteError
from detangled.formats import check_folder, replacing
from detangled.groom import Groom
from detangled.head import Head
from detangled.usable import WHY_UNDRAWN, usable_strands
from detangled.view.camera import view_rotation
from detangled.view.page_points import STEPS, Gridded, byte_planes, gridded, packed
from detangled.view.page_thinning import MOST_POINTS, thinned
from detangled.view.picture import natural_width

if TYPE_CHECKING:
    from detangled.labeling import Labels

SUFFIXES = (".html", ".htm")
SEED = 0  # of the order of strands
NO_VALUE = 0xFFFF
NO_TYPE = 0xFF
LABEL_STEPS = 65534
# A step of the grid that a page keeps points on; with longer ones curls look coarse.
COARSE_STEP_CM = 0.01
MOST_TIMES = 8.0  # that a groom is as large as another: coils shrink hair, hardly more than that


@dataclass(frozen=True)
class Shown:
    """A groom on a page.

    name: what the page calls it. labels: of its strands, which can be coloured by them then.
    facts: the labels' summary as JSON takes it (`detangled label --json`), shown beside the hair.
    """

    groom: Groom
    name: str
    labels: Labels | None = None
    facts: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Page:
    """text: the whole file. strand_width: as drawn at first [cm]. notes: what was left out, one sentence each."""

    text: str
    strand_width: float
    notes: tuple[str, ...]


def page(
    shown: Sequence[Shown],
    head: Head | None = None,
    *,
    most_points: int = MOST_POINTS,
    threads: int | None = None,
) -> Page:
    """Make the page of one groom, or of two, before and after, seen alike.

    head: drawn with them, in the axes of the first. most_points: of each groom; one of more is thinned out.
    threads: to pack with, all cores where None. The same grooms give the same text.
    Raises ReadError where a groom has no strand that can be drawn,
    DetangledError for another number of grooms.
    """
    if not 1 <= len(shown) <= 2:
        raise DetangledError(f"a page shows one groom or two, not {len(shown)}")
    streams: list[NDArray[Any]] = []
    hairs = [_hair(each, most_points, streams) for each in shown]
    boxes = [(hair["low"], hair["high"]) for hair in hairs]
    mesh = _mesh(head, shown[0].groom.up, streams) if head is not None and len(head.faces) else None
    if mesh is not None:
        boxes.append((mesh["low"], mesh["high"]))
    low, high = np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)
    extent = max(max(np.subtract(hair["high"], hair["low"])) for hair in hairs)
    width = natural_width(max(hair["drawn"] for hair in hairs), max(float(extent), 1e-3))
    about = {
        "version": __version__,
        "title": " and ".join(each.name for each in shown),
        "low": low.tolist(),
        "high": high.tolist(),
        "width": width,
        "hairs": hairs,
        "head": mesh,
    }
    notes = [f"{each.name}: {note}" for each, hair in zip(shown, hairs, strict=True) for note in hair["notes"]]
    if len(hairs) == 2:
        notes += _misfit(*hairs)
    return Page(_filled(about, packed(streams, threads)), width, tuple(notes))


def save(made: Page, path: str | os.PathLike[str]) -> None:
    """Write a page, whole or not at all. Raises WriteError as ``check_target`` does, or where the disk refuses."""
    path = Path(path)
    check_target(path)
    with replacing(path) as beside:
        beside.write_text(made.text, encoding="utf-8", newline="\n")


def check_target(path: str | os.PathLike[str]) -> None:
    """Raise WriteError where ``save`` would refuse ``path``, so that nobody labels strands for nothing."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise WriteError(f"{path}: a page's name must end in {' or '.join(SUFFIXES)}")
    check_folder(path)


def _hair(shown: Shown, most_points: int, streams: list[NDArray[Any]]) -> dict[str, Any]:
    """What the page is told of a groom; its arrays are added to ``streams``."""
    groom = shown.groom
    # Shuffled, so that the first strands are a fair part of all; alike before and after, where they are as many.
    order = np.random.default_rng(SEED).permutation(groom.strand_count)
    bare = replace(groom, attributes={}).select(order)
    turn = view_rotation("front", groom.up)
    if not np.array_equal(turn, np.eye(3)):
        bare = replace(bare, points=bare.points @ turn.T)
    thin, kept, notes = thinned(bare, most_points)
    grid = gridded(thin.points, thin.offsets)
    if len(grid.ids) == 0:
        raise ReadError(f"{shown.name} has {WHY_UNDRAWN}, so there is nothing to show")
    broken = thin.strand_count - len(grid.ids) if thin is bare else int(np.sum(~usable_strands(bare)))
    if broken:
        were = "strand is" if broken == 1 else "strands are"
        notes.append(f"{broken:,} {were} left out: not finite, without length, or too large")
    if grid.step > COARSE_STEP_CM:
        span = grid.step * STEPS
        notes.append(f"its strands lie up to {span:,.0f} cm apart, so points are shown to {grid.step:.2g} cm only")
    rows = order[kept[grid.ids]]
    return {
        "name": shown.name,
        "strands": groom.strand_count,
        "drawn": len(rows),
        "pointCount": len(groom.points),
        "notes": notes,
        "low": grid.origin.tolist(),
        "high": grid.high.tolist(),
        "origin": grid.origin.tolist(),
        "step": grid.step,
        "points": _added(streams, byte_planes(grid.places, grid.offsets)),
        **_streamed(streams, counts=np.diff(grid.offsets).astype(np.uint32), ids=rows.astype(np.uint32)),
        "labels": None if shown.labels is None else _labels(shown.labels, rows, streams),
        "facts": None if shown.facts is None else dict(shown.facts),
    }


def _misfit(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """What looks as if two grooms were not of one unit or place; nothing where they go together."""
    boxes = [np.array([hair["low"], hair["high"]]) for hair in (before, after)]
    sizes = [max(float(np.linalg.norm(box[1] - box[0])), 1e-6) for box in boxes]
    large, small = (after, before) if sizes[1] > sizes[0] else (before, after)
    times = max(sizes) / min(sizes)
    if times > MOST_TIMES:
        return [f"{large['name']} is {times:,.0f} times as large as {small['name']}: --unit says the unit of both"]
    apart = float(np.linalg.norm(boxes[0].mean(axis=0) - boxes[1].mean(axis=0)))
    if apart > sum(sizes):
        return [f"{after['name']} lies {apart:.0f} cm away from {before['name']}, so both look small"]
    return []


def _labels(labels: Labels, rows: NDArray[np.int64], streams: list[NDArray[Any]]) -> dict[str, Any]:
    kinds = labels.kind[rows]
    about: dict[str, Any] = _streamed(streams, type=np.where(kinds < 0, NO_TYPE, kinds).astype(np.uint8))
    for name in ("radius", "wavelength", "twist"):
        values = getattr(labels, name)[rows]
        known = np.isfinite(values)
        step = float(values[known].max(initial=0.0)) / LABEL_STEPS or 1.0
        places = np.full(len(values), NO_VALUE, dtype=np.uint16)
        places[known] = np.rint(values[known] / step)
        about[name] = {"step": step, **_streamed(streams, values=places)}
    return about


def _mesh(head: Head, up: str, streams: list[NDArray[Any]]) -> dict[str, Any]:
    points = head.vertices @ view_rotation("front", up).T
    if not np.isfinite(points).all():
        raise ReadError("the head has vertices that are not finite")
    whole = _whole(points)
    return {
        "low": whole.origin.tolist(),
        "high": whole.high.tolist(),
        "origin": whole.origin.tolist(),
        "step": whole.step,
        "count": len(points),
        "vertices": _added(streams, byte_planes(whole.places, whole.offsets)),
        **_streamed(streams, faces=head.faces.astype(np.uint32)),
    }


def _whole(points: NDArray[np.float64]) -> Gridded:
    """Points (P, 3) on a grid, every one of them: faces name them by their number."""
    low, high = points.min(axis=0), points.max(axis=0)
    step = float((high - low).max()) / STEPS or 1.0
    places = np.rint((points - low) / step).astype(np.uint16)
    return Gridded(places, np.array([0, len(points)]), np.zeros(1, np.int64), low, step, high)


def _streamed(streams: list[NDArray[Any]], **arrays: NDArray[Any]) -> dict[str, str]:
    """The names of the streams that these arrays become."""
    return dict(zip(arrays, _added(streams, list(arrays.values())), strict=True))


def _added(streams: list[NDArray[Any]], arrays: Sequence[NDArray[Any]]) -> list[str]:
    streams.extend(arrays)
    return [f"s{number}" for number in range(len(streams) - len(arrays), len(streams))]


def _filled(about: dict[str, Any], texts: Sequence[str]) -> str:
    template = files("detangled.view").joinpath("page_template.html").read_text(encoding="utf-8")
    # No name may end the element that holds it.
    facts = json.dumps(about, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    data = [f'<script type="application/json" id="page">{facts}</script>']
    data += [
        f'<script type="application/octet-stream" id="s{number}">{text}</script>' for number, text in enumerate(texts)
    ]
    before, after = template.split("<!--DATA-->")
    return before.replace("<!--TITLE-->", html.escape(about["title"])) + "\n".join(data) + after
