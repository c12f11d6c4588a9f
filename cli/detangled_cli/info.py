"""detangled info: what a groom holds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from detangled_cli.console import input_argument, quiet_option, unit_option

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from detangled.groom import Groom

UNIT_SOURCES = {
    "given": "as given",
    "file": "from the file",
    "size": "guessed from its size",
    "default": "assumed",
}

UNUSABLE = "not finite, fewer than two distinct points, or longer than 20 m"
LARGEST_CM = 1e100  # of what can be measured
# From here on digits behind the point say nothing, and those before it fill the line.
LARGE = 1e7


@click.command()
@input_argument
@click.option("--json", "as_json", is_flag=True, help="Write JSON, lengths in cm.")
@unit_option
@quiet_option
def command(source: Path, as_json: bool, unit: str | None) -> None:
    """Describe a groom: strands, lengths, unit, attributes.

    Lengths are those of the polylines, in cm. Strands that hold a value that is not finite, or fewer than two
    distinct points, are left out of the lengths and the box; they and those longer than 20 m are counted as unusable.

    \b
    Example:
      detangled info groom.abc
      detangled info groom.usdc --json
    """
    from detangled.formats import format_name, read

    groom = read(source, unit=unit)
    facts = {"file": str(source), "format": format_name(source), **describe(groom)}
    click.echo(json.dumps(facts, indent=2, allow_nan=False) if as_json else as_text(facts))


def describe(groom: Groom) -> dict[str, Any]:
    """What a groom holds, as JSON takes it; lengths in cm, None where there is nothing to measure."""
    import numpy as np

    from detangled.units import unit_name
    from detangled.usable import extents, usable_strands

    extent = extents(groom)
    # Measured apart from the others, since one value that is not finite spoils the sums over all of them; so would
    # one whose square is not.
    sound = groom.select((extent > 0.0) & (extent < LARGEST_CM))
    box = [sound.points.min(axis=0).tolist(), sound.points.max(axis=0).tolist()] if len(sound.points) else None
    return {
        "strands": groom.strand_count,
        "unusable_strands": int(np.count_nonzero(~usable_strands(groom))),
        "points": len(groom.points),
        "points_per_strand": _spread(groom.point_counts),
        "length_cm": _spread(sound.polyline_lengths()),
        "box_cm": None if box is None else {"min": box[0], "max": box[1]},
        "unit": unit_name(groom.unit_cm),
        "unit_cm": groom.unit_cm,
        "unit_source": groom.unit_source,
        "up": groom.up,
        "objects": list(groom.objects),
        "attributes": {
            name: {
                "scope": attribute.scope.value,
                "dtype": str(attribute.values.dtype),
                "shape": list(attribute.values.shape),
            }
            for name, attribute in groom.attributes.items()
        },
        "notes": list(groom.notes),
    }


def as_text(facts: dict[str, Any]) -> str:
    """The facts of ``describe``, and the file, for a person."""
    rows = [
        ("strands", f"{facts['strands']:,}"),
        ("points", f"{facts['points']:,}{_range(facts['points_per_strand'], ',.0f', '', ', a strand ')}"),
        ("length", _range(facts["length_cm"], ".2f", " cm") or "none to measure"),
        ("box", _box(facts["box_cm"])),
        ("unit", f"{facts['unit']}, {UNIT_SOURCES.get(facts['unit_source'], facts['unit_source'])}"),
        ("up", facts["up"]),
        ("objects", ", ".join(facts["objects"]) or "none"),
    ]
    if facts["unusable_strands"]:
        rows.insert(1, ("unusable", f"{facts['unusable_strands']:,} ({UNUSABLE})"))
    if "format" in facts:
        rows.insert(0, ("format", facts["format"]))
    lines = [facts["file"], *(f"  {name:<10}  {text}" for name, text in rows)]
    lines.append(f"  {'attributes':<10}  {'' if facts['attributes'] else 'none'}".rstrip())
    width = max(map(len, facts["attributes"]), default=0)
    for name, about in facts["attributes"].items():
        lines.append(f"    {name:<{width}}  {about['scope']:<6}  {about['dtype']} {tuple(about['shape'])}")
    if facts["notes"]:
        lines += ["  notes", *(f"    {sentence}" for sentence in facts["notes"])]
    return "\n".join(lines)


def _spread(values: NDArray[Any]) -> dict[str, float] | None:
    import numpy as np

    if not len(values):
        return None
    return {"min": values.min().item(), "median": float(np.median(values)), "max": values.max().item()}


def _range(spread: dict[str, float] | None, number: str, unit: str, lead: str = "") -> str:
    if spread is None:
        return ""
    low, middle, high = (_number(spread[name], number) for name in ("min", "median", "max"))
    return f"{lead}{low} to {high}{unit}, median {middle}{unit}"


def _number(value: float, form: str) -> str:
    return format(value, form if abs(value) < LARGE else ".3g")


def _box(box: dict[str, list[float]] | None) -> str:
    if box is None:
        return "none"
    low, high = (" ".join(_number(value, ".2f") for value in box[end]) for end in ("min", "max"))
    size = " x ".join(_number(b - a, ".2f") for a, b in zip(box["min"], box["max"], strict=True))
    return f"{size} cm, from ({low}) to ({high})"
