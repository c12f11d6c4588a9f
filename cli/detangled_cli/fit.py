"""detangled fit: learn a texture from a few strands once, to use it often."""

from __future__ import annotations

from pathlib import Path

import click

from detangled_cli.console import announce_first_run, check_apart, quiet_option, threads_option, unit_option
from detangled_cli.targets import fitting_option


@click.command()
@click.argument("source", metavar="STRANDS", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUT.texture", type=click.Path(path_type=Path))
@fitting_option
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    metavar="N",
    help="Of finetune: the same seed, the same weights. Default: 0.",
)
@click.option(
    "--training-steps",
    type=click.IntRange(min=1),
    metavar="N",
    help="Of finetune: most steps of training. Default: 1100, fewer where strands held out gain nothing more; 600 "
    "from fewer than 6 strands.",
)
@unit_option
@threads_option
@quiet_option
def command(
    source: Path,
    target: Path,
    method: str | None,
    seed: int | None,
    training_steps: int | None,
    unit: str | None,
    threads: int | None,
) -> None:
    """Learn a texture from a few strands, one to some hundreds, and write it as a .texture file.

    \b
    Example:
      detangled fit strands.obj coily.texture
      detangled fit strands.obj coily.texture --method finetune
      detangled retexture groom.abc new.abc --target coily.texture
    """
    from detangled.errors import WriteError
    from detangled.fitted import FINETUNE, SUFFIX, save_texture
    from detangled.formats import check_folder
    from detangled.kernels import set_threads
    from detangled_cli.targets import fitted_texture

    if source.suffix == SUFFIX:
        raise click.UsageError(f"{source} is learned already: name the strands to learn from")
    if method != FINETUNE and (seed is not None or training_steps is not None):
        raise click.UsageError(f"--seed and --training-steps go with --method {FINETUNE}")
    check_apart(target, source)
    if target.suffix != SUFFIX:
        raise WriteError(f"{target}: a fitted texture is written as {SUFFIX}")
    check_folder(target)
    announce_first_run("detangled.geometry.winding.winding")
    set_threads(threads)
    save_texture(fitted_texture(source, unit, method, seed or 0, training_steps), target)
