"""The command `detangled`: its verbs, loaded when called, and every error as one line and an exit code."""

from __future__ import annotations

import os
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from difflib import get_close_matches
from importlib import import_module
from typing import Any, NamedTuple, NoReturn

import click

from detangled import __version__
from detangled.errors import DetangledError
from detangled_cli.console import warn

TRACEBACK_VARIABLE = "DETANGLED_TRACEBACK"

BUG = 1
# 128 + SIGINT and 128 + SIGPIPE: what a shell reports of a program that these signals end.
INTERRUPTED = 130
PIPE_CLOSED = 141


class Verb(NamedTuple):
    """Where a verb's command is found, and its line in the list of verbs, which so needs no import."""

    module: str
    attribute: str
    short_help: str


VERBS = {
    "retexture": Verb("detangled_cli.retexture", "command", "Give a groom another hair texture."),
    "generate": Verb("detangled_cli.generate", "command", "Make loose strands of a texture."),
    "fit": Verb("detangled_cli.fit", "command", "Learn a texture from a few strands, to use it often."),
    "render": Verb("detangled_cli.render", "command", "Draw a groom as a picture."),
    "view": Verb("detangled_cli.view", "command", "Show a groom in a browser, in one page."),
    "guides": Verb("detangled_cli.guides", "command", "Write a groom's style guides: strands without curl."),
    "hairs": Verb("detangled_cli.hairs", "command", "Make render hairs of guide strands."),
    "convert": Verb("detangled_cli.convert", "command", "Convert a groom: format, unit, up axis, engine."),
    "validate": Verb("detangled_cli.validate", "command", "Say what an engine would lose of a groom file."),
    "label": Verb("detangled_cli.label", "command", "Read the texture of hair: radius, wavelength, twist, type."),
    "gallery": Verb("detangled_cli.gallery", "command", "Make the paper's figures on this program's own models."),
    "info": Verb("detangled_cli.info", "command", "Describe a groom: strands, lengths, unit, attributes."),
    "train": Verb("detangled_cli.train", "command", "Train and export models (needs the extra: detangled[train])."),
}

EPILOG = """\b
Example:
  detangled retexture groom.abc coily.abc --target strands.abc

\b
Exit codes: 0 done, 1 a bug, 2 wrong usage, 3 an input that cannot be read or used,
4 a model that is missing, damaged or of another version, 5 an output that could not
be written, 130 interrupted.
"""


class LazyGroup(click.Group):
    """A group that imports a verb's module when the verb is called, and turns errors into exit codes."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        verb = VERBS.get(cmd_name)
        if verb is None:
            return None
        command = getattr(import_module(verb.module), verb.attribute)
        if not isinstance(command, click.Command):
            raise TypeError(f"{verb.module}.{verb.attribute} is not a click command")
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in VERBS and not args[0].startswith("-"):
            near = get_close_matches(args[0], VERBS)
            hint = f" Did you mean {' or '.join(repr(name) for name in near)}?" if near else ""
            raise click.UsageError(f"No such command {args[0]!r}.{hint}", ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, verb.short_help) for name, verb in VERBS.items()])

    def invoke(self, ctx: click.Context) -> None:
        try:
            with warnings.catch_warnings():
                warnings.showwarning = _show_warning
                super().invoke(ctx)
            sys.stdout.flush()
        except (click.exceptions.Exit, click.Abort, click.ClickException):
            raise
        except Exception as error:
            # Not in `main`: click would take an EOFError for Ctrl-D, and a closed pipe for a failure.
            ctx.exit(_report(error))

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        def call() -> Any:
            return super(LazyGroup, self).main(args, prog_name, complete_var, standalone_mode=False, **extra)

        return _exit_with(call) if standalone_mode else call()


@click.group(
    cls=LazyGroup,
    invoke_without_command=True,
    subcommand_metavar="COMMAND [ARGS]...",
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog=EPILOG,
)
@click.version_option(__version__, message="detangled %(version)s")
@click.pass_context
def detangled(ctx: click.Context) -> None:
    """Measure, edit and generate strand-based hair, on a CPU.

    Every command explains itself: detangled COMMAND --help
    """
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help(), err=True)
        ctx.exit(click.UsageError.exit_code)


def main() -> None:
    """Run the command line and leave the process with its exit code."""
    detangled.main(prog_name="detangled")


def _exit_with(call: Callable[[], Any]) -> NoReturn:
    try:
        result = call()
    except (click.Abort, click.ClickException, KeyboardInterrupt) as error:
        sys.exit(_report(error))
    sys.exit(result if isinstance(result, int) else 0)


def _report(error: BaseException) -> int:
    """Say in one line on stderr what went wrong, and return the exit code for it."""
    if isinstance(error, BrokenPipeError):
        _silence_stdout()
        return PIPE_CLOSED
    if os.environ.get(TRACEBACK_VARIABLE, "0") not in ("", "0"):
        traceback.print_exception(error)
    if isinstance(error, KeyboardInterrupt | click.Abort):
        click.echo("detangled: interrupted; nothing was written", err=True)
        return INTERRUPTED
    code, text = _code_and_text(error)
    click.echo(f"detangled: error: {' '.join(text.split())}", err=True)
    return code


def _code_and_text(error: BaseException) -> tuple[int, str]:
    if isinstance(error, DetangledError):
        return error.exit_code, str(error)
    if isinstance(error, click.UsageError) and error.ctx is not None:
        return error.exit_code, f"{error.format_message()} (see '{error.ctx.command_path} --help')"
    if isinstance(error, click.ClickException):
        return error.exit_code, error.format_message()
    said = f": {error}" if str(error) else ""
    return BUG, f"{type(error).__name__}{said}; set {TRACEBACK_VARIABLE}=1 to see where"


def _silence_stdout() -> None:
    # What is still in the buffer would fail again when the interpreter flushes it at its end.
    with suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    warn(str(message))


if __name__ == "__main__":
    main()
