"""detangled train: make data sets, train networks with torch, and export them as the models that run without."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from detangled.errors import WriteError
from detangled_cli.console import announce_first_run, hush, note, progress_bar, quiet_option, threads_option
from detangled_cli.option_values import SHARE, FiniteRange

if TYPE_CHECKING:
    from detangled_training.denoiser_training import Training, TrainingOptions

INTERRUPTED = 130
WRONG_USAGE = 2
NUMBER = click.IntRange(min=1)
VARIANTS = 2  # of a simulated strand
UNTYPED = 0.2  # share of strands of none of the hair types


class ExtraMissing(click.ClickException):
    """What training stands on is not installed."""

    exit_code = WRONG_USAGE


class Stopped(click.ClickException):
    """A training was interrupted that can be gone on with."""

    exit_code = INTERRUPTED


@click.group(invoke_without_command=True, subcommand_metavar="COMMAND [ARGS]...")
@click.pass_context
def command(ctx: click.Context) -> None:
    """Train and export models (needs the extra: detangled[train]).

    \b
    Example:
      pip install 'detangled[train]'
      detangled train data --out strands --count 50000
      detangled train data --out hung --count 4000 --simulated
      detangled train labelers training --data strands --simulated-data hung
      detangled train denoiser training --data hung
      detangled train export training/checkpoint.pt models
      detangled train library models
    """
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help(), err=True)
        ctx.exit(WRONG_USAGE)


@command.command()
@click.argument("folder", metavar="OUT_FOLDER", type=click.Path(path_type=Path))
@click.option(
    "--data",
    "folders",
    required=True,
    multiple=True,
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Strands to train on, made by train data; may be given several times.",
)
@click.option(
    "--start", metavar="MODELS", type=click.Path(path_type=Path), help="Begin with the denoiser.onnx of this folder."
)
@click.option("--steps", type=NUMBER, metavar="N", help="Steps of training. Default: 20000.")
@click.option("--batch", type=NUMBER, metavar="N", help="Strands of a step, shared by all processes. Default: 32.")
@click.option(
    "--learning-rate",
    type=FiniteRange(min=0.0, min_open=True),
    metavar="X",
    help="The highest: it rises at first, then falls. Default: 0.0004.",
)
@click.option("--seed", type=click.IntRange(min=0), metavar="N", help="Of the training. Default: 0.")
@click.option("--resume", is_flag=True, help="Go on with the training in OUT_FOLDER, if there is one, by its options.")
@threads_option
@quiet_option
def denoiser(
    folder: Path,
    folders: tuple[Path, ...],
    start: Path | None,
    steps: int | None,
    batch: int | None,
    learning_rate: float | None,
    seed: int | None,
    resume: bool,
    threads: int | None,
) -> None:
    """Train the denoiser.

    OUT_FOLDER/checkpoint.pt is written again and again on the way: --resume goes on from there. A GPU is used where
    there is one; with several, start it by torchrun.

    \b
    Example:
      detangled train data --out hung --count 50000 --simulated
      detangled train denoiser training --data hung
      detangled train denoiser training --data hung --resume
      torchrun --nproc-per-node 2 -m detangled_cli.main train denoiser training --data hung
    """
    _use(threads)
    from detangled_training.denoiser_training import Training

    if os.environ.get("RANK", "0") != "0":
        hush()
    asked = {"steps": steps, "batch": batch, "learning_rate": learning_rate, "seed": seed}
    given: dict[str, Any] = {name: value for name, value in asked.items() if value is not None}
    training = Training(replace(_options(folder, resume), **given), folder, folders, start, note)
    try:
        _train(training)
    except KeyboardInterrupt:
        if not training.path.exists():
            raise
        raise Stopped(f"interrupted; --resume goes on from what {training.path} holds") from None
    finally:
        training.close()


@command.command()
@click.argument("folder", metavar="OUT_FOLDER", type=click.Path(path_type=Path))
@click.option("--data", required=True, metavar="DIR", type=click.Path(path_type=Path), help="Unsimulated strands.")
@click.option("--simulated-data", required=True, metavar="DIR", type=click.Path(path_type=Path), help="Simulated ones.")
@click.option(
    "--steps",
    metavar="A,B,C,D",
    callback=lambda ctx, parameter, text: _stages(text),
    help="Of twist and helix, unsimulated, then simulated. Default: 2500,8000,700,1000.",
)
@click.option("--batch", type=NUMBER, metavar="N", help="Strands of a step, shared by all processes. Default: 64.")
@click.option("--seed", type=click.IntRange(min=0), metavar="N", help="Of the training. Default: 0.")
@threads_option
@quiet_option
def labelers(
    folder: Path,
    data: Path,
    simulated_data: Path,
    steps: tuple[int, ...] | None,
    batch: int | None,
    seed: int | None,
    threads: int | None,
) -> None:
    """Train the labelers: what tells a strand's radius, wavelength and twist prevalence.

    OUT_FOLDER/labelers.pt is written again and again on the way: the same command goes on from there. A GPU is used
    where there is one; with several, start it by torchrun.

    \b
    Example:
      detangled train data --out strands --count 50000 --seed 1
      detangled train data --out hung --count 4000 --simulated --seed 2
      detangled train labelers training --data strands --simulated-data hung
      detangled train export training/labelers.pt models
    """
    _use(threads)
    from detangled_training.labeler_training import LabelerOptions, LabelerTraining

    if os.environ.get("RANK", "0") != "0":
        hush()
    asked = {"steps": steps, "batch": batch, "seed": seed}
    options = LabelerOptions(**{name: value for name, value in asked.items() if value is not None})  # type: ignore[arg-type]
    training = LabelerTraining(options, folder, data, simulated_data, note)
    try:
        with progress_bar("training steps", sum(options.steps)) as bar:
            bar.initial = bar.n = training.steps_done

            def show(step: int, loss: float) -> None:
                bar.set_postfix_str(f"loss {loss:.3f}", refresh=False)
                bar.update(step - bar.n)

            training.run(show)
    except KeyboardInterrupt:
        if not training.path.exists():
            raise
        raise Stopped(f"interrupted; the same command goes on from what {training.path} holds") from None
    finally:
        training.close()
    note(f"{training.path}: trained in {training.seconds:.0f} s")


@command.command()
@click.argument("source", metavar="CHECKPOINT", type=click.Path(path_type=Path))
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@threads_option
@quiet_option
def export(source: Path, folder: Path, threads: int | None) -> None:
    """Write trained networks as models that run without torch.

    Of a denoiser's checkpoint these are denoiser.onnx and training_step.onnx in DIR, of labelers' labeler.onnx and
    labeler_gradient.onnx, and a .json beside each. All are run beside torch, and not written where they differ from it.
    The environment variable DETANGLED_MODELS names a folder of models to use.

    \b
    Example:
      detangled train export training/checkpoint.pt models
    """
    _use(threads)
    from detangled_training.checkpoint import read_checkpoint
    from detangled_training.labeler_export import export_labelers
    from detangled_training.labeler_training import is_labelers
    from detangled_training.onnx_export import export as export_denoiser

    if is_labelers(source):
        note(f"{source}: exporting takes a while")
        models = export_labelers(source, folder)
    else:
        checkpoint = read_checkpoint(source)
        note(f"{source}: {len(checkpoint.weights):,} parameters; exporting takes a while")
        models = export_denoiser(checkpoint, folder)
    for model in models:
        note(f"{model.path}: {_size(model.path)}; onnxruntime and torch differ by {model.difference:.1g} at most")
        note(f"{model.manifest}: {_size(model.manifest)}")


@command.command()
@click.option(
    "--out",
    "folder",
    required=True,
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Folder of the data set. One that was begun by the same options is gone on with.",
)
@click.option("--count", type=NUMBER, required=True, metavar="N", help="Base strands, of all hair types alike.")
@click.option(
    "--untyped",
    type=SHARE,
    default=UNTYPED,
    metavar="SHARE",
    help=f"Share of strands of no type, their numbers drawn without regard to each other. Default: {UNTYPED}.",
)
@click.option("--simulated", is_flag=True, help="Hang each strand wet, by simulation, with drawn fibres.")
@click.option("--variants", type=NUMBER, metavar="K", help="Times each strand is hung, if simulated. Default: 2.")
@click.option("--seed", type=click.IntRange(min=0), default=0, metavar="N", help="Of the strands. Default: 0.")
@click.option("--workers", type=NUMBER, metavar="N", help="Processes to share the cores. Default: one for each core.")
@quiet_option
def data(
    folder: Path, count: int, untyped: float, simulated: bool, variants: int | None, seed: int, workers: int | None
) -> None:
    """Write a data set of strands to train on.

    Stopped, it goes on when the same command is given again; with a larger --count it is extended. The same options
    give the same bytes, whatever the number of workers.

    \b
    Example:
      detangled train data --out strands --count 50000 --simulated
    """
    if variants is not None and not simulated:
        raise click.UsageError("--variants is how often each strand is hung: it goes with --simulated")
    from detangled_training import dataset
    from detangled_training.variants import VariantOptions

    options = VariantOptions(hung=(variants or VARIANTS) if simulated else 0, untyped=untyped)
    announce_first_run("detangled_training.resting.hang_all" if simulated else "detangled.geometry.winding.winding")
    began = time.monotonic()
    try:
        with progress_bar("strands", count) as bar:
            written = dataset.write_dataset(folder, count, seed, options, workers, bar.update)
    except KeyboardInterrupt:
        if not (folder / dataset.MANIFEST).exists():
            raise
        how_far = dataset.read_manifest(folder).how_far
        raise Stopped(f"interrupted; {folder}: {how_far}: the same command goes on from there") from None
    manifest = written.manifest
    size = _said(sum((folder / name).stat().st_size for name in manifest.shards))
    holds = f"{folder}: {count:,} strands, {manifest.signals:,} signals, {size}"
    if written.made:
        note(f"{holds}; {written.made} of {len(manifest.shards)} shards made in {time.monotonic() - began:.0f} s")
    else:
        note(f"{holds}: finished already")


@command.command()
@click.argument("folder", metavar="OUT_FOLDER", type=click.Path(path_type=Path))
@click.option("--count", type=NUMBER, default=3000, show_default=True, metavar="N", help="Base strands.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, metavar="N", help="Of the strands.")
@threads_option
@quiet_option
def library(folder: Path, count: int, seed: int, threads: int | None) -> None:
    """Make the library of strands that textures asked for by numbers are drawn from: library.npz and a .json.

    The environment variable DETANGLED_MODELS names a folder of models to use.

    \b
    Example:
      detangled train library models
    """
    from detangled.kernels import set_threads
    from detangled_training.library import write_library

    announce_first_run("detangled_training.resting.hang_all")
    set_threads(threads)
    with progress_bar("strands", count) as bar:
        path, strands = write_library(folder, count, seed, bar.update)
    note(f"{path}: {strands:,} strands, {_size(path)}")


def _use(threads: int | None) -> None:
    """Load what training stands on, and have it use so many threads."""
    from detangled.kernels import set_threads
    from detangled_training import extra

    try:
        extra.load(threads)
    except ModuleNotFoundError as error:
        if error.name not in ("onnx", "torch"):
            raise
        raise ExtraMissing("training needs torch and onnx: pip install 'detangled[train]'") from error
    set_threads(threads)


def _options(folder: Path, resume: bool) -> TrainingOptions:
    """Those of the training in a folder where it is gone on with, else those of a new one."""
    from detangled_training.checkpoint import CHECKPOINT, read_checkpoint
    from detangled_training.denoiser_training import TrainingOptions, begun

    path = folder / CHECKPOINT
    if not path.exists():
        if resume:
            note(f"{path}: not there yet: a new training")
        return TrainingOptions()
    if not resume:
        raise WriteError(f"{path}: a training is there already: go on with it by --resume, or name another folder")
    return begun(read_checkpoint(path), path)[1]


def _stages(text: str | None) -> tuple[int, ...] | None:
    if text is None:
        return None
    parts = text.split(",")
    if len(parts) != 4 or not all(part.strip().isdecimal() and int(part) > 0 for part in parts):
        raise click.BadParameter(f"{text!r}: four numbers of steps, such as 2500,2500,700,700")
    return tuple(int(part) for part in parts)


def _train(training: Training) -> None:
    steps = training.options.steps
    if training.step >= steps:
        note(f"{training.path}: trained to its last step already")
        return
    data = training.prepare()
    with progress_bar("training steps", steps) as bar:
        bar.initial = bar.n = training.step

        def show(step: int, loss: float) -> None:
            bar.set_postfix_str(f"loss {loss:.3f}", refresh=False)
            bar.update(step - bar.n)

        training.run(data, show)
    note(f"{training.path}: trained by {steps:,} steps in {training.seconds:.0f} s")


def _size(path: Path) -> str:
    return _said(path.stat().st_size)


def _said(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.1f} kB"
