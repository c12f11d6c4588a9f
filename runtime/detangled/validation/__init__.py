"""What an engine's importer would drop or misread of a file, found in the file itself.

An Alembic file's properties are looked at one by one as they lie in it, since that is where an importer's reading and
ours part: in types, scopes and containers. Other files are judged by what our own reader finds.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from detangled.errors import ReadError
from detangled.presets import ENGINES


@dataclass(frozen=True)
class Finding:
    """One thing that an importer would not take as it was meant.

    loses: whether hair, or something it has, is dropped or misread; else it is only good to know. where: the node or
    attribute, empty for the whole file.
    """

    loses: bool
    where: str
    text: str

    def __str__(self) -> str:
        return f"{self.where}: {self.text}" if self.where else self.text


def validate(path: str | os.PathLike[str], name: str, unit: str | None = None) -> list[Finding]:
    """What the engine called ``name`` (``detangled.presets.ENGINES``) would drop or misread of the file at ``path``.

    unit: name of the file's unit, where it says none and its size misleads. The findings that lose something come
    first. Raises ReadError where the file is missing or damaged.
    """
    from detangled.formats import read

    path = Path(path)
    if name not in ENGINES:
        raise ReadError(f"unknown preset {name!r}: use one of {', '.join(ENGINES)}")
    engine = ENGINES[name]
    # What is damaged is said as it is for every other verb, before anything else looks at the file.
    groom = read(path, unit=unit)
    found = []
    if path.suffix.lower() not in engine.suffixes:
        found.append(
            Finding(True, "", f"{engine.title} imports {', '.join(engine.suffixes)}: detangled convert writes one")
        )
    from detangled.validation import hair, unreal

    found += hair.findings(groom, engine)
    if path.suffix.lower() == ".abc":
        from detangled.validation.archive import contents

        archive = contents(path)
        if name == "unreal":
            found += unreal.findings(archive)
        elif name == "blender":
            found += hair.left_out_by_blender(archive)
    return sorted(found, key=lambda finding: not finding.loses)
