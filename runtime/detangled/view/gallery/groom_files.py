"""Styles from people's own grooms: files, or folders of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from detangled.errors import ReadError
from detangled.formats import read, suffixes
from detangled.view.gallery.figure import Style

FEWEST_STRANDS = 100  # of a file found in a folder: fewer are a swatch, not a style


def styles_from(paths: Sequence[Path], most: int) -> tuple[list[Style], list[str]]:
    """At most so many styles of grooms, and sentences on what was assumed or passed over.

    A file is taken as it is. Of a folder those that can be read are taken, by their depth and name, one of a name.
    Raises ReadError where a file cannot be read, or nothing is found.
    """
    styles: list[Style] = []
    said: list[str] = []
    for path in paths:
        if not path.is_dir():
            groom = read(path)
            said.extend(f"{path}: {sentence}" for sentence in groom.notes)
            styles.append(Style(path.stem, groom))
            continue
        before = len(styles)
        for file in _files(path):
            if len(styles) >= most:
                break
            if file.stem in {style.name for style in styles}:
                continue
            try:
                groom = read(file)
            except ReadError as error:
                said.append(f"passed over: {error}")
                continue
            if groom.strand_count >= FEWEST_STRANDS:
                styles.append(Style(file.stem, groom))
        if len(styles) == before < most:
            raise ReadError(f"{path}: no groom of {FEWEST_STRANDS} strands or more in this folder")
    return styles[:most], said


def _files(folder: Path) -> list[Path]:
    known = suffixes()
    found = [path for path in folder.rglob("*") if path.suffix.lower() in known and path.is_file()]
    return sorted(found, key=lambda path: (len(path.parts), path.stem, known.index(path.suffix.lower())))
