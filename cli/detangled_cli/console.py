"""What every verb says and asks alike: notes, warnings and progress on stderr, and the options they share."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from detangled_cli.option_values import UNIT

# A bar for what is over at once would only flicker.
BAR_DELAY_S = 1.0

_QUIET = "detangled.quiet"
_ANNOUNCED = "detangled.first_run_announced"

if TYPE_CHECKING:
    from tqdm import tqdm

Command = TypeVar("Command", bound=Callable[..., Any])


def is_quiet() -> bool:
    """Whether the running verb was given --quiet."""
    return bool(_shared().get(_QUIET, False))


def hush() -> None:
    """Be quiet from now on, as with --quiet: one of several processes that would say the same."""
    _shared()[_QUIET] = True


def note(text: str) -> None:
    """Say something on stderr, in one line, unless --quiet."""
    _say(text)


def warn(text: str) -> None:
    """Warn on stderr, in one line, unless --quiet."""
    _say(f"detangled: warning: {text}")


@contextmanager
def progress_bar(label: str, total: int | None = None) -> Iterator[tqdm[Any]]:
    """A bar on stderr that appears after a second, if stderr is a terminal and without --quiet.

    Its ``update`` takes the number of items done since the last call.
    """
    from tqdm import tqdm

    hidden = is_quiet() or not sys.stderr.isatty()
    with tqdm(
        total=total,
        desc=label,
        file=sys.stderr,
        delay=BAR_DELAY_S,
        leave=False,
        dynamic_ncols=True,
        disable=hidden,
    ) as bar:
        yield bar


def announce_first_run(last_kernel: str) -> None:
    """Say once, before kernels are used, that they are about to be compiled, if they are.

    last_kernel: ``package.module.function`` of a kernel that the verb compiles last.
    """
    shared = _shared()
    if shared.get(_ANNOUNCED):
        return
    shared[_ANNOUNCED] = True
    from detangled.kernels import is_first_run

    if is_first_run(last_kernel):
        note("compiling kernels: this first run takes about a minute longer, later ones do not")


UNIT_NAMES = "mm, cm, dm, m or in"
UNIT_HELP = f"{UNIT_NAMES}, or so many of one, as 2.5mm"


def input_argument(command: Command) -> Command:
    """The argument IN, a path, as ``source``."""
    # Whether it exists is for the reader to find: that is exit code 3, not wrong usage.
    return click.argument("source", metavar="IN", type=click.Path(path_type=Path))(command)


def output_argument(command: Command) -> Command:
    """The argument OUT, a path, as ``target``."""
    return click.argument("target", metavar="OUT", type=click.Path(path_type=Path))(command)


def check_apart(path: Path | None, *others: Path | None) -> None:
    """Raise UsageError where a file to write is one of some others: inputs that would be lost, or other outputs."""
    for other in others:
        if path is None or other is None:
            continue
        one_file = os.path.exists(path) and os.path.exists(other) and os.path.samefile(path, other)
        if one_file or os.path.realpath(path) == os.path.realpath(other):
            raise click.UsageError(f"{path} is an input or another output already: name another file")


def quiet_option(command: Command) -> Command:
    """--quiet, for everything here; the verb itself does not receive it."""
    return click.option(
        "--quiet",
        "-q",
        is_flag=True,
        # Before the others, whose own checks may have something to say.
        is_eager=True,
        expose_value=False,
        callback=_set_quiet,
        help="No notes, warnings or progress on stderr; errors only.",
    )(command)


def threads_option(command: Command) -> Command:
    """--threads, as ``threads``: a number or None."""
    return click.option(
        "--threads",
        type=click.IntRange(min=1),
        metavar="N",
        help="Threads to use. Default: all cores.",
    )(command)


def unit_option(command: Command) -> Command:
    """--unit, as ``unit``: a name or None."""
    return click.option(
        "--unit",
        type=UNIT,
        metavar="U",
        help=f"Unit of IN: {UNIT_HELP}. Default: what the file says, else a guess from its size.",
    )(command)


def file_names(paths: list[Path]) -> list[str]:
    """What to call some files: each one's name, and its folder too where names are equal."""
    names = [path.name for path in paths]
    return [path.name if names.count(path.name) == 1 else f"{path.parent.name}/{path.name}" for path in paths]


def _set_quiet(ctx: click.Context, _: click.Parameter, value: bool) -> None:
    ctx.meta[_QUIET] = value


def _shared() -> dict[str, Any]:
    """What one call of the command line keeps for all its parts; nothing is kept outside of one."""
    ctx = click.get_current_context(silent=True)
    return {} if ctx is None else ctx.meta


def _say(text: str) -> None:
    if is_quiet():
        return
    line = " ".join(text.split())
    if "tqdm" in sys.modules:
        from tqdm import tqdm

        # Above a bar that may be showing, rather than through it.
        tqdm.write(line, file=sys.stderr)
    else:
        click.echo(line, err=True)
