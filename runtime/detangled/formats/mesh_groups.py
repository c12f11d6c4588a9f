"""Groups of faces in Wavefront OBJ: a file holds more than skin, and hair grows on skin alone.

A face belongs to the object (``o``), the groups (``g``) and the material (``usemtl``) that were named last above it.
"""

from __future__ import annotations

import re

from detangled.errors import ReadError

_NAMING = {b"o", b"g", b"usemtl"}
# A whole-body base mesh calls its skin so; what else it holds are hulls and joints for other programs.
_WHOLE = "body"
# Otherwise, parts of skin by words in their names: teeth, eyes and lashes are none.
_SKIN = {"body", "head", "face", "skin", "scalp", "neck", "ear", "ears"}
LISTED = 12  # names in a sentence


def faces_of_group(text: bytes, group: str | None, path: str) -> tuple[bytes, str]:
    """The text of an OBJ file with the faces of some groups alone, and a sentence on what was left out, or "".

    group: names, with commas between them; None for those of skin, where names tell, else for all.
    Raises ReadError where a group is not in the file, with those that are.
    """
    lines = text.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines()
    within: dict[bytes, tuple[str, ...]] = {}
    kept: list[bytes] = []
    faces: list[tuple[str, ...]] = []
    found: dict[str, None] = {}
    names: tuple[str, ...] = ()
    for line in map(bytes.lstrip, lines):
        word = line.split(None, 1)[0] if line else b""
        if word in _NAMING:
            within[word] = tuple(name.decode("utf-8", "replace") for name in line.split()[1:])
            names = tuple(name for several in within.values() for name in several)
        elif word == b"f":
            faces.append(names)
            found.update(dict.fromkeys(names))
            kept.append(line)
        elif word in (b"v", b"vt"):
            kept.append(line)
    chosen = _chosen(list(found), group, path)
    if chosen is None:
        return b"\n".join(kept) + b"\n", ""
    owner = iter(faces)
    kept = [line for line in kept if line[:1] != b"f" or not chosen.isdisjoint(next(owner))]
    others = [name for name in found if name not in chosen]
    said = f"took the faces of {few(sorted(chosen))}" + (f", not of {few(others)}" if others else "")
    return b"\n".join(kept) + b"\n", said if group is None and others else ""


def _chosen(found: list[str], group: str | None, path: str) -> set[str] | None:
    if group is not None:
        wanted = {name.strip() for name in group.split(",") if name.strip()}
        missing = sorted(wanted - set(found))
        if missing or not wanted:
            raise ReadError(f"{path}: has no group {few(missing) or repr(group)}: it has {few(found) or 'none'}")
        return wanted
    whole = {name for name in found if name.lower() == _WHOLE}
    return whole or {name for name in found if _SKIN & _words(name)} or None


def _words(name: str) -> set[str]:
    """Words in a name, M_BackHead as m, back, head."""
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}


def few(names: list[str]) -> str:
    """Names in a sentence, the first of them where there are many."""
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(names[:LISTED]) + more
