"""Where what is made here goes, and by which code it was made."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from detangled.errors import WriteError


def make_folder(folder: Path) -> None:
    """Make a folder where there is none, before hours of work that end in it. Raises WriteError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError(f"{folder}: cannot be made a folder ({error.strerror})") from error
    if not os.access(folder, os.W_OK):
        raise WriteError(f"{folder}: the folder cannot be written to")


def commit() -> str:
    """The commit this code is at, "" where it is not in a repository."""
    command = ["git", "rev-parse", "HEAD"]
    try:
        run = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
    except OSError:  # no git
        return ""
    return run.stdout.strip()
