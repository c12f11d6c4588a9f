"""detangled retexture: give a groom another texture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from detangled_cli.console import (
    announce_first_run,
    check_apart,
    input_argument,
    note,
    output_argument,
    progress_bar,
    quiet_option,
    threads_option,
    unit_option,
    warn,
)
from detangled_cli.heads import check_head_options, head_of, head_options
from detangled_cli.presets import check_preset, preset_option, with_texture, written
from detangled_cli.retexture_report import Stages, report, write_preview, write_report
from detangled_cli.targets import fibre_attributes, texture_options, wanted

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from detangled.groom import Groom
    from detangled.head import Head


def _density(context: click.Context, option: click.Parameter, value: str | None) -> str | float | None:
    if value in (None, "auto", "keep"):
        return value
    try:
        factor = float(str(value))
    except ValueError:
        factor = float("nan")
    if not 0.0 < factor < float("inf"):
        raise click.BadParameter(f"{value!r} is not auto, keep or a number above zero, such as 2.5")
    return factor


@click.command()
@input_argument
@output_argument
@texture_options
@click.option(
    "--length",
    type=click.Choice(["guide", "strand"]),
    default="guide",
    show_default=True,
    help="What stays: guide keeps the hairstyle's outline; strand keeps each hair's own length, so coils shrink it.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="The same seed, the same hair.")
@click.option("--steps", type=click.IntRange(2, 200), default=20, show_default=True, help="Steps of the sampler.")
@click.option(
    "--max-points",
    type=click.IntRange(min=2),
    metavar="N",
    help="Most points a strand may have. Default: as many as the texture needs, 16 a turn.",
)
@head_options("hair is kept out of it.")
@click.option(
    "--on-penetration",
    type=click.Choice(["rotate", "delete", "keep"]),
    help="Hair in the head: rotate turns and lifts it out, delete also deletes what stays in, keep leaves it. "
    "[default: rotate]",
)
@click.option(
    "--density",
    metavar="auto|keep|FACTOR",
    callback=_density,
    help="How many style guides: auto as the texture's radius needs, keep as there are, or so many times as many. "
    "Default: auto with --head, else keep.",
)
@preset_option()
@click.option("--preview", metavar="PNG", type=click.Path(path_type=Path), help="Draw the groom before and after.")
@click.option(
    "--report",
    "report_target",
    metavar="JSON",
    type=click.Path(path_type=Path),
    help="Write guides, lengths, labels before and after, penetrations, warnings, times, seed and models.",
)
@unit_option
@threads_option
@quiet_option
def command(
    source: Path,
    target: Path,
    length: str,
    seed: int,
    steps: int,
    max_points: int | None,
    head_source: Path | None,
    head_unit: str | None,
    head_group: str | None,
    on_penetration: str | None,
    density: str | float | None,
    preset: str | None,
    preview: Path | None,
    report_target: Path | None,
    unit: str | None,
    threads: int | None,
    thickness: float | None,
    porosity: float | None,
    **texture_asked: Any,
) -> None:
    """Give a groom another texture, on its own style: one new strand for each of its style guides.

    The texture is learned from target strands, or told by a hair type or by numbers; the groom keeps its style, its
    strands' order, roots and attributes, and their number unless --head or --density says otherwise. A groom that moves
    keeps its frames, and its curls their places.

    \b
    Example:
      detangled retexture in.abc out.abc --target strands.obj
      detangled retexture in.abc out.abc --type 4B
      detangled retexture in.abc out.abc --radius 6mm:2mm --wavelength 8mm --twist 0.3
      detangled retexture in.abc out.abc --target coily.texture --length strand --seed 7
      detangled retexture in.abc out.abc --type 4B --head head.obj
    """
    from detangled.formats import check_folder, check_writable
    from detangled.formats.frames import read_frames
    from detangled.grooming.density import checked_factor
    from detangled.grooming.interpenetration import OnPenetration
    from detangled.grooming.lengths import Length
    from detangled.kernels import set_threads
    from detangled.presets import prepared_frames
    from detangled.retexturing import Options, retexture
    from detangled.usable import check_usable
    from detangled.view.picture import check_target

    set_threads(threads)
    stages = Stages()
    asked_for = wanted(**texture_asked)
    check_head_options(head_source, head_unit, head_group)
    if head_source is None and on_penetration is not None:
        raise click.UsageError("--on-penetration goes with --head")
    check_apart(target, head_source, asked_for.source)
    check_apart(preview, source, target, head_source, asked_for.source)
    check_apart(report_target, source, target, head_source, asked_for.source, preview)
    check_preset(preset, target)
    check_writable(target)
    if preview is not None:
        check_target(preview)
    if report_target is not None:
        check_folder(report_target)
    with stages.stage("read"):
        frames = read_frames(source, unit=unit)
        groom = frames.groom
        for sentence in groom.notes:
            warn(f"{source}: {sentence}")
        check_usable(groom, source)
        if isinstance(density, float):
            checked_factor(density, groom.strand_count)
        head = head_of(groom, head_source, head_unit, head_group)
    groom = replace(groom, attributes={**groom.attributes, **fibre_attributes(thickness, porosity)})
    announce_first_run("detangled.grooming.placing.resample")
    with stages.stage("texture"):
        texture = asked_for.texture(seed)
    options = Options(
        Length(length), seed, steps, max_points, head, OnPenetration(on_penetration or "rotate"), _factor(density, head)
    )
    with progress_bar("strands", groom.strand_count) as bar, stages.stage("strands"):
        result = retexture(groom, texture, options, bar.update)
    styled = with_texture(frames, result.groom, target)
    if preset is not None:
        styled, changed = prepared_frames(styled, preset, target.suffix.lower(), _root_uv(styled.groom, head))
        for sentence in changed:
            note(f"{target}: {sentence}")
    with stages.stage("write"):
        warnings = [*result.lost, *result.warnings, *written(styled, target)]
    if len(result.passed_through):
        some = ", ".join(str(index) for index in result.passed_through[:5])
        warnings.append(
            f"{len(result.passed_through)} strands cannot be used and pass through unchanged: {some}"
            f"{', ...' if len(result.passed_through) > 5 else ''}"
        )
    if result.penetration is not None:
        warnings += result.penetration.warnings()
    for sentence in warnings:
        warn(f"{target}: {sentence}")
    for sentence in [*result.notes, *([] if result.penetration is None else [str(result.penetration)])]:
        note(f"{target}: {sentence}")
    if preview is not None:
        with stages.stage("preview"):
            write_preview(groom, result.groom, (source.name, target.name), head, preview)
    if report_target is not None:
        write_report(report(source, target, groom, texture, options, result, warnings, stages), report_target)
    note(f"{target}: {result.strands} strands, {len(result.groom.points)} points, in {stages.total:.1f} s")


def _root_uv(groom: Groom, head: Head | None) -> NDArray[np.float64] | None:
    """Texture coordinates (S, 2) of roots on their head; None where they have their own, or the head has none."""
    if head is None or head.uv is None or "groom_root_uv" in groom.attributes or not groom.point_counts.all():
        return None
    from detangled.grooming.scalp_mesh import places_on

    return places_on(groom.points[groom.offsets[:-1]], head).uv(head)


def _factor(density: str | float | None, head: Head | None) -> float | None:
    """Of the density of style guides; None for as the texture needs."""
    if isinstance(density, float):
        return density
    return None if density == "auto" or (density is None and head is not None) else 1.0
