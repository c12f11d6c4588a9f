"""detangled hairs: render hairs of guide strands."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

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
from detangled_cli.option_values import LENGTH, SHARE, SHARES, THICKNESS, wrong_usage

if TYPE_CHECKING:
    from detangled.texture import Profile


@click.command()
@input_argument
@output_argument
@click.option("--count", type=click.IntRange(min=1), default=100_000, show_default=True, metavar="N", help="Hairs.")
@head_options("hairs grow on it.")
@click.option(
    "--wisp-radius",
    type=LENGTH,
    metavar="R",
    help="How far from its guide a wisp's hairs are. Default: half of what the guide has room for, or of its coil.",
)
@click.option(
    "--clump",
    type=SHARE,
    default=0.5,
    show_default=True,
    help="0: wisps as wide as their radius; 1: all hairs on their guide.",
)
@click.option(
    "--clump-profile",
    type=SHARES,
    default="0:1",
    show_default=True,
    metavar="A:B[:C]",
    help="How much of --clump there is from root to tip; 1:0 is tight at the root.",
)
@click.option(
    "--sub-clumps",
    type=click.IntRange(0, 64),
    default=4,
    show_default=True,
    metavar="N",
    help="Tufts in a wisp, and in each tuft again; 0 for none.",
)
@click.option("--flyaways", type=SHARE, default=0.02, show_default=True, help="Share of hairs that leave their wisp.")
@click.option("--variation", type=SHARE, default=0.3, show_default=True, help="How unlike a wisp's hairs are.")
@click.option(
    "--points",
    type=click.IntRange(min=2),
    metavar="N",
    help="Points of a hair, within 24 million in all. Default: as its guide has.",
)
@click.option("--width", type=THICKNESS, default="0.08mm", show_default=True, metavar="W", help="Of a hair.")
@click.option("--with-guides", is_flag=True, help="Write the guide strands too, first, and flagged.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="The same seed, the same hair.")
@unit_option
@threads_option
@quiet_option
def command(
    source: Path,
    target: Path,
    count: int,
    head_source: Path | None,
    head_unit: str | None,
    head_group: str | None,
    wisp_radius: float | None,
    clump: float,
    clump_profile: Profile,
    sub_clumps: int,
    flyaways: float,
    variation: float,
    points: int | None,
    width: float,
    with_guides: bool,
    seed: int,
    unit: str | None,
    threads: int | None,
) -> None:
    """Make render hairs of a groom of guide strands, such as retexture writes.

    Each hair has the texture of its wisp's guide strand on a smooth axis of its own, so coils stay coils.

    \b
    Example:
      detangled hairs coily.abc hair.abc --count 100000
      detangled hairs coily.abc hair.abc --head head.obj --clump 0.8 --flyaways 0.05 --with-guides
    """
    from detangled.formats import check_writable, read, write
    from detangled.grooming.render_hairs import HairOptions, render_hairs
    from detangled.kernels import set_threads
    from detangled.usable import check_usable

    began = time.perf_counter()
    check_head_options(head_source, head_unit, head_group)
    check_apart(target, head_source)
    check_writable(target)
    with wrong_usage():
        options = HairOptions(
            count=count,
            wisp_radius=wisp_radius,
            clump=clump,
            clump_profile=clump_profile,
            sub_clumps=sub_clumps,
            flyaways=flyaways,
            variation=variation,
            points=points,
            width=width,
            seed=seed,
            with_guides=with_guides,
        )
    groom = read(source, unit=unit)
    for sentence in groom.notes:
        warn(f"{source}: {sentence}")
    check_usable(groom, source)
    set_threads(threads)
    mesh = head_of(groom, head_source, head_unit, head_group)
    announce_first_run("detangled.grooming.hair_laying.laid")
    with progress_bar("hairs", count) as bar:
        result = render_hairs(groom, options, mesh, bar.update)
    for sentence in [*result.notes, *result.lost]:
        warn(f"{source}: {sentence}")
    for sentence in write(result.groom, target):
        warn(f"{target}: {sentence}")
    note(
        f"{target}: {count} hairs, {len(result.groom.points)} points, "
        f"wisps of {10 * result.wisp_radius:.2g} mm radius, in {time.perf_counter() - began:.1f} s"
    )
