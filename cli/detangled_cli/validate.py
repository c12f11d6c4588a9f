"""detangled validate: what an engine would drop or misread of a groom file."""

from __future__ import annotations

import json
from pathlib import Path

import click

from detangled_cli.console import input_argument, quiet_option, unit_option
from detangled_cli.presets import preset_option

LOSES = 3


@click.command()
@input_argument
@preset_option(required=True)
@click.option("--json", "as_json", is_flag=True, help="Write JSON.")
@unit_option
@quiet_option
@click.pass_context
def command(ctx: click.Context, source: Path, preset: str, as_json: bool, unit: str | None) -> None:
    """Say what an engine would lose of a groom file.

    One line for each thing that its importer would drop or misread. Exits with 3 where anything is lost, with 0 where
    there is nothing or only notes. The file is looked at as it lies on the disk, and left as it is.

    \b
    Example:
      detangled validate groom.abc --preset unreal
      detangled validate groom.abc --preset unity --json
    """
    from detangled.presets import ENGINES
    from detangled.validation import validate

    found = validate(source, preset, unit)
    if as_json:
        listed = [{"loses": f.loses, "where": f.where, "text": f.text} for f in found]
        facts = {"file": str(source), "preset": preset, "sound": not any(f.loses for f in found), "findings": listed}
        click.echo(json.dumps(facts, indent=2, allow_nan=False))
    else:
        for finding in found:
            click.echo(f"{'lost' if finding.loses else 'note'}: {finding}")
        if not any(f.loses for f in found):
            click.echo(f"{source}: {ENGINES[preset].title} loses nothing of it")
    if any(f.loses for f in found):
        ctx.exit(LOSES)
