"""detangled label: what texture the strands of a groom have, and how to find one's own hair."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from detangled_cli.console import (
    announce_first_run,
    check_apart,
    progress_bar,
    quiet_option,
    threads_option,
    unit_option,
    warn,
)
from detangled_cli.option_values import wrong_usage

if TYPE_CHECKING:
    from detangled.labeling import Labels
    from detangled.texture import Spread

CSV_SUFFIX = ".csv"
COLUMNS = ("strand", "radius_cm", "wavelength_cm", "twist", "length_cm", "type", "walker", "reading")

# Twist prevalence in words, after the paper's figure: five to go by, and anything between two of them.
TWIST_WORDS = {
    0.0: "every turn is like the one before, as in a spring; strands differ little from each other",
    0.25: "even turns, and rarely a break: a turn is missing as if pulled out, then all goes on as before",
    0.5: "about half of the length winds evenly; long pieces between follow no pattern",
    0.75: "a few even turns can be made out; most of the length bends this way and that",
    1.0: "no two turns are alike: the strand curls differently everywhere, with some sharp kinks",
}
# What to hold a strand of each type against. Which thing belongs to which type is said in detangled.texture.
LOOKS = (
    "a line with hardly a bend",
    "a long, loose wave",
    "a clear wave, a drawn-out S",
    "sidewalk chalk, 20 to 25 mm wide",
    "a marker, 12 to 16 mm wide",
    "a drinking straw, 6 to 8 mm wide",
    "a coffee stirrer, 3 to 5 mm wide, or wider",
    "a thin coffee stirrer, or narrower",
)
CAUTION = (
    "The types' numbers are this project's own estimate, right within about x1.5, and their ranges are",
    "wide on purpose. People put the same head into different types quite often (kappa 0.42, where 1 is",
    "always alike and 0 is chance): one type either way is noise. Hair varies over a head, too.",
)


@click.command()
@click.argument("source", metavar="[IN]", required=False, type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Write JSON, lengths in cm.")
@click.option(
    "--per-strand",
    "table",
    metavar="OUT.csv",
    type=click.Path(path_type=Path),
    help="Write what each strand is like as well, a row for each.",
)
@click.option(
    "--explain",
    is_flag=True,
    help="Say how to find one's own hair in the numbers. IN is left out then, or a type: 4A, VI, straw.",
)
@unit_option
@threads_option
@quiet_option
def command(
    source: Path | None, as_json: bool, table: Path | None, explain: bool, unit: str | None, threads: int | None
) -> None:
    """Read the texture of hair: radius, wavelength, twist, type.

    Values are those of each strand's lower section, where its texture shows. Lengths are in cm. At a twist
    prevalence of 0 a strand winds as evenly as a spring, at 1 it has no even curl.

    \b
    Example:
      detangled label groom.abc
      detangled label groom.abc --json --per-strand strands.csv
      detangled label --explain
      detangled label --explain 4A
    """
    if explain:
        if as_json or table is not None:
            raise click.UsageError("--explain measures nothing: leave --json and --per-strand out")
        with wrong_usage():
            click.echo(explanation() if source is None else explanation_of(str(source)))
        return
    if source is None:
        raise click.UsageError("Missing argument 'IN': a groom to measure; or --explain, to find hair by eye")
    if table is not None:
        check_apart(table, source)
        _check_table(table)

    from detangled.errors import ReadError
    from detangled.formats import read
    from detangled.kernels import set_threads
    from detangled.labeling import label
    from detangled.units import unit_name
    from detangled_cli.label_summary import as_text, is_readable, summary, why_unread

    groom = read(source, unit=unit)
    for sentence in groom.notes:
        warn(f"{source}: {sentence}")
    announce_first_run("detangled.labeling.points_per_turn")
    set_threads(threads)
    with progress_bar("strands", groom.strand_count) as bar:
        labels = label(groom, bar.update)
    facts = {
        "file": str(source),
        "unit": unit_name(groom.unit_cm),
        "unit_source": groom.unit_source,
        **summary(labels),
        "notes": list(groom.notes),
    }
    if not is_readable(facts):
        raise ReadError(f"{source}: none of its {groom.strand_count:,} strands can be read: {why_unread(facts)}")
    if table is not None:
        write_table(labels, table)
    click.echo(json.dumps(facts, indent=2, allow_nan=False) if as_json else as_text(facts))


def write_table(labels: Labels, path: Path) -> None:
    """Write a row for each strand as CSV, an empty cell where there is no value. Raises WriteError."""
    from detangled.formats import replacing
    from detangled.labeling import Reading
    from detangled.texture import HAIR_TYPES

    with replacing(path) as beside, beside.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        numbers = zip(labels.radius, labels.wavelength, labels.twist, labels.length, strict=True)
        for strand, (values, kind, reading) in enumerate(zip(numbers, labels.kind, labels.reading, strict=True)):
            names = (HAIR_TYPES[kind].name, HAIR_TYPES[kind].walker) if kind >= 0 else ("", "")
            cells = (f"{value:.6g}" if math.isfinite(value) else "" for value in values)
            writer.writerow([strand, *cells, *names, Reading(reading).name.lower()])


def explanation() -> str:
    """How to find hair by eye, with a ruler and things at hand: the types, and the twist prevalence."""
    from detangled.texture import HAIR_TYPES

    lines = [
        "How to find your hair in three numbers, by eye, with a ruler and things at hand.",
        "Look at the lower half of a few dry strands, where hair shows its curl best, and do not stretch them.",
        "",
        "  radius      half the width of the narrowest tube that a curl fits into",
        "  wavelength  from one curl to the next, along the way the strand goes",
        "  twist       how much of the strand leaves the even curl, from 0 to 1 (below)",
        "",
        f"  {'type':<6}{'Walker':<10}{'called':<10}{'radius':<10}{'':<9}{'wavelength':<19}{'twist':<7}compare with",
    ]
    for hair, looks in zip(HAIR_TYPES, LOOKS, strict=True):
        sizes = "".join(f"{text:<9}" for mean in (hair.radius.mean, hair.wavelength.mean) for text in _sizes(mean))
        lines.append(f"  {hair.name:<6}{hair.walker:<10}{_word(hair.name):<10}{sizes}  {hair.twist.mean:<7.2f}{looks}")
    lines += ["", "  Twist prevalence (a value between two of these is fine):"]
    lines += [f"  {twist:<6g}{words}" for twist, words in TWIST_WORDS.items()]
    lines += ["", *(f"  {line}" for line in CAUTION), "", "  More on one type: detangled label --explain 4A"]
    return "\n".join(lines)


def explanation_of(name: str) -> str:
    """What hair of one type is like, by any name that people have for it. Raises TextureError for other names."""
    from detangled.texture import HAIR_TYPES, hair_type

    hair = hair_type(name)
    parts = [_index(part) for part in hair.name.split("-")]
    twist = min(TWIST_WORDS, key=lambda value: abs(value - hair.twist.mean))
    # The middle of two types has those two beside it.
    beside = parts if len(parts) > 1 else [k for k in (parts[0] - 1, parts[0] + 1) if 0 <= k < len(HAIR_TYPES)]
    rows = [
        ("compare with", "; to ".join(LOOKS[part] for part in parts)),
        ("radius", _usual(hair.radius)),
        ("wavelength", _usual(hair.wavelength)),
        ("twist", f"{hair.twist.mean:.2f}; at {twist:g}, which is nearest:"),
        ("", TWIST_WORDS[twist]),
        ("beside it", " and ".join(f"{HAIR_TYPES[k].name} ({HAIR_TYPES[k].walker})" for k in beside)),
    ]
    heading = f"{hair.name} ({hair.walker}), {_word(HAIR_TYPES[parts[0]].name)}"
    lines = [heading, *(f"  {title:<14}{text}" for title, text in rows)]
    return "\n".join([*lines, "", *(f"  {line}" for line in CAUTION)])


def _check_table(table: Path) -> None:
    """Raise the WriteError that writing the table would end in, before the strands are read."""
    from detangled.errors import WriteError
    from detangled.formats import check_folder

    if table.suffix.lower() != CSV_SUFFIX:
        raise WriteError(f"{table}: a row for each strand is written as {CSV_SUFFIX}")
    check_folder(table)


def _index(name: str) -> int:
    from detangled.texture import HAIR_TYPES

    return [hair.name for hair in HAIR_TYPES].index(name)


def _word(name: str) -> str:
    from detangled_cli.label_summary import GROUPS

    return next(word for word, types in GROUPS.items() if _index(name) in types)


def _usual(spread: Spread) -> str:
    """The mean, and what four strands of five have."""
    low, high = (float(value) for value in spread.at([0.1, 0.9]))
    return f"{', '.join(_sizes(spread.mean))}; in four strands of five {_mm(low)} to {_mm(high)} mm"


def _sizes(centimetres: float) -> tuple[str, str]:
    return f"{10 * centimetres:.3g} mm", f"{centimetres:.3g} cm"


def _mm(centimetres: float) -> str:
    return f"{10 * centimetres:.1f}" if centimetres < 1.0 else f"{10 * centimetres:.0f}"
