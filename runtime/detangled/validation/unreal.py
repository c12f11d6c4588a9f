"""What Unreal's groom importer would drop or misread of an Alembic file.

Epic Games, "Alembic for Grooms Specification" (schema 1.5), and how the importer goes about it: properties of the
whole groom it takes from the first node that has user properties, all others from the curves' ``.arbGeomParams``,
where only plain arrays of a few types are looked at; a wrong scope sends an attribute where nobody asks for it.
"""

from __future__ import annotations

import numpy as np

from detangled.formats.abc_write import GROOM_PROPERTIES
from detangled.presets import ENGINES, UNREAL
from detangled.presets.unreal import MAJOR, MINOR, MOST_ID
from detangled.validation import Finding
from detangled.validation.archive import ARRAY, COMPOUND, SCALAR, Archive, Curves, Property

PREFIX = "groom_"
SAME_SCALE = 0.01
# Types that are looked at, and how many of them may make an element.
_READ = {
    "string": (1,),
    "bool_t": (1,),
    "int8_t": (1,),
    "int16_t": (1,),
    "int32_t": (1, 3),
    "float32_t": (1, 2, 3),
    "float64_t": (1, 2, 3),
}
_WHOLE = ("int8_t", "int16_t", "int32_t")
_FLOAT = ("float32_t", "float64_t")
_STRAND, _ANY = ("con", "uni"), ("con", "uni", "vtx")
# Of each attribute: types, values an element, scopes.
_SCHEMA: dict[str, tuple[tuple[str, ...], int, tuple[str, ...]]] = {
    "groom_width": (_FLOAT, 1, _ANY),
    "groom_guide": (_WHOLE, 1, _STRAND),
    "groom_group_id": (_WHOLE, 1, _STRAND),
    "groom_group_name": (("string",), 1, _STRAND),
    "groom_group_cards_id": (("string",), 1, _STRAND),
    "groom_root_uv": (_FLOAT, 2, ("uni",)),
    "groom_id": (_WHOLE, 1, ("uni",)),
    "groom_clumpid": (_WHOLE, 1, _STRAND),
    "groom_color": (_FLOAT, 3, _ANY),
    "groom_roughness": (_FLOAT, 1, _ANY),
    "groom_ao": (_FLOAT, 1, _ANY),
    "groom_closest_guides": (("int32_t",), 3, ("uni",)),
    "groom_guide_weights": (_FLOAT, 3, ("uni",)),
}


def findings(archive: Archive) -> list[Finding]:
    """Findings about the nodes and properties of an archive."""
    found = _versions(archive)
    if archive.meshes:
        found.append(Finding(True, ", ".join(archive.meshes), "a mesh: Unreal rejects a groom file that holds one"))
    for curves in archive.curves:
        found += _attributes(curves)
        found += _widths(curves)
        if curves.samples > 1:
            found.append(Finding(False, curves.path, f"{curves.samples} time samples: import them as a groom cache"))
    found += _groups(archive)
    found += _guides(archive)
    return found


def _versions(archive: Archive) -> list[Finding]:
    for path, properties in [*archive.above, *((c.path, c.user) for c in archive.curves if c.user)]:
        by_name = {p.name: p for p in properties}
        wrong = [
            f"{name} is {_told(by_name[name]) if name in by_name else 'missing'}, {value} is needed"
            for name, value in (("groom_version_major", MAJOR), ("groom_version_minor", MINOR))
            if name not in by_name or not _is_number(by_name[name], value)
        ]
        # The importer stops at the first node that has any.
        return [Finding(True, path, "; ".join(wrong))] if wrong else []
    if any(p.name in GROOM_PROPERTIES for p in archive.top):
        return [Finding(True, "/", "groom_version_major stands on the archive's top, where it is not looked for")]
    return [Finding(True, "", "groom_version_major and groom_version_minor are missing")]


def _is_number(given: Property, value: int) -> bool:
    values = given.values
    return given.pod in ("int16_t", "int32_t") and values is not None and values.size == 1 and values.flat[0] == value


def _told(given: Property) -> str:
    if given.values is None or given.values.size != 1:
        return f"{given.kind} of {given.pod}"
    return f"{given.values.flat[0]} ({given.pod})"


def _attributes(curves: Curves) -> list[Finding]:
    found = []
    for given in curves.user:
        if given.name.startswith(PREFIX) and given.name not in GROOM_PROPERTIES:
            found.append(_lost(curves, given, "among the user properties, where only those of the whole groom count"))
    for given in curves.arbitrary:
        if given.name in GROOM_PROPERTIES:
            found.append(_lost(curves, given, "on the curves, not among the user properties of the topmost node"))
        elif given.name.startswith(PREFIX):
            text = _misread(curves, given)
            if text:
                found.append(_lost(curves, given, text))
            elif given.name not in _SCHEMA:
                found.append(
                    Finding(False, f"{curves.path} {given.name}", "not in Unreal's schema: kept by name alone")
                )
    ignored = [p.name for p in (*curves.schema, *curves.arbitrary) if not p.name.startswith(PREFIX)]
    ignored = [name for name in ignored if name != "width"]
    if ignored:
        found.append(Finding(False, curves.path, f"Unreal does not look at {', '.join(ignored)}"))
    if not any(p.name == "groom_root_uv" for p in curves.arbitrary):
        found.append(Finding(False, curves.path, "no groom_root_uv: made by spherical projection"))
    return found


def _lost(curves: Curves, given: Property, text: str) -> Finding:
    return Finding(True, f"{curves.path} {given.name}", text)


def _misread(curves: Curves, given: Property) -> str:
    """What is wrong with a ``groom_`` attribute of curves; nothing where it is read as it is meant."""
    if given.kind == COMPOUND:
        return "values with indices, which are not looked at: write plain values"
    if given.kind == SCALAR:
        return "a single property, which is only looked at on the topmost node"
    if given.extent not in _READ.get(given.pod, ()):
        return f"{_type(given)}, which is not looked at"
    types, extent, scopes = _SCHEMA.get(given.name, ((given.pod,), given.extent, _ANY))
    if given.pod not in types or given.extent != extent:
        wanted = f"{types[-1]}[{extent}]" if extent > 1 else types[-1]
        return f"{_type(given)}, {wanted} is needed"
    if given.values is None:
        return "its values cannot be read"
    count = len(given.values)
    size = {"con": 1, "uni": len(curves.counts), "vtx": curves.points}
    scope = given.scope
    if scope == "con" and count == size["uni"]:
        # The importer sees through this one.
        scope = "uni"
    if scope not in size:
        scope = next((name for name in ("uni", "vtx") if count == size[name]), "")
    if count != size.get(scope):
        return f"{count} values of scope {given.scope} for {size['uni']} strands of {size['vtx']} points"
    if scope not in scopes and not (scope == "con" and size["uni"] == 1):
        words = {"con": "all curves", "uni": "a strand", "vtx": "a point"}
        return f"one value for {words[scope]} where one for {words[scopes[-1]]} is needed"
    if given.values.dtype.kind == "f" and not np.isfinite(given.values).all():
        return "it holds values that are not finite"
    return ""


def _type(given: Property) -> str:
    return f"{given.pod}[{given.extent}]" if given.extent > 1 else given.pod


def _widths(curves: Curves) -> list[Finding]:
    own = next((p for p in curves.arbitrary if p.name == "groom_width"), None)
    if own is not None and not _misread(curves, own):
        return []
    width = next((p for p in curves.schema if p.name == "width"), None)
    if width is None:
        return [Finding(True, curves.path, "no widths: every hair becomes 1 cm thick")]
    values, size = width.values, {"con": 1, "uni": len(curves.counts), "vtx": curves.points}
    if width.kind != ARRAY or values is None or len(values) < size.get(width.scope, len(values) + 1):
        return [Finding(True, curves.path, f"widths of scope {width.scope} that do not fit: hair becomes 1 cm thick")]
    found = []
    if width.scope == "con" and (values != values[0]).any():
        found.append(Finding(True, curves.path, f"{len(values)} widths of constant scope: all hair gets the first"))
    if abs(curves.scale - 1.0) > SAME_SCALE:
        text = f"widths are not scaled with the nodes above, which make the hair {curves.scale:.3g} times larger"
        found.append(Finding(True, curves.path, text))
    return found


def _groups(archive: Archive) -> list[Finding]:
    engine = ENGINES[UNREAL]
    strands: dict[int, int] = {}
    points: dict[int, int] = {}
    for curves in archive.curves:
        ids = _per_strand(curves, "groom_group_id")
        groups = np.zeros(len(curves.counts), dtype=np.int64) if ids is None else ids.astype(np.int64)
        if len(groups) and groups.min() < 0:
            return [Finding(True, curves.path, "groom_group_id below 0")]
        for group in np.unique(groups):
            own = curves.counts[groups == group]
            strands[int(group)] = strands.get(int(group), 0) + len(own)
            points[int(group)] = points.get(int(group), 0) + int(own.sum())
    found = []
    for group in sorted(strands):
        for count, most, what in (
            (strands[group], engine.most_strands, "strands"),
            (points[group], engine.most_group_points, "points"),
        ):
            if most is not None and count > most:
                found.append(
                    Finding(True, "", f"group {group} has {count:,} {what}: those beyond {most:,} are cut off")
                )
    return found


def _guides(archive: Archive) -> list[Finding]:
    flags = [_per_strand(curves, "groom_guide") for curves in archive.curves]
    ids = [_per_strand(curves, "groom_id") for curves in archive.curves]
    closest = [_per_strand(curves, "groom_closest_guides", 3) for curves in archive.curves]
    present = [f for f in flags if f is not None]
    found = []
    if present and not any((f != 0).any() for f in present):
        found.append(Finding(True, "groom_guide", "no strand is a guide: leave the attribute out, and guides are made"))
    elif len(present) == len(flags) and present and all((f != 0).all() for f in present):
        found.append(Finding(True, "groom_guide", "every strand is a guide, and guides are not drawn"))
    if all(c is None for c in closest):
        return found
    if not present:
        found.append(Finding(True, "groom_closest_guides", "no strand is flagged as a guide (groom_guide)"))
        return found
    if any(i is None for i in ids):
        found.append(Finding(True, "groom_closest_guides", "needs a groom_id a strand, which tells what it names"))
        return found
    known = np.concatenate([i for i in ids if i is not None])
    guide = np.concatenate(
        [np.zeros(len(c.counts)) if f is None else f for c, f in zip(archive.curves, flags, strict=True)]
    )
    if len(np.unique(known)) < len(known):
        found.append(Finding(True, "groom_id", "several strands have one id: closest guides name the wrong ones"))
    if len(known) and known.max() >= MOST_ID:
        found.append(Finding(True, "groom_id", f"ids from {MOST_ID:,} on are rounded where closest guides name them"))
    for curves, names in zip(archive.curves, closest, strict=True):
        weights = _per_strand(curves, "groom_guide_weights", 3)
        if names is None:
            continue
        if weights is None:
            found.append(Finding(True, curves.path, "groom_closest_guides without sound groom_guide_weights"))
            continue
        strangers = ~np.isin(names[weights > 0], known[guide != 0])
        if strangers.any():
            text = f"{np.count_nonzero(strangers)} of the closest guides are no guides' ids"
            found.append(Finding(True, f"{curves.path} groom_closest_guides", text))
    return found


def _per_strand(curves: Curves, name: str, extent: int = 1) -> np.ndarray | None:
    """Sound values a strand, (S,) or (S, extent), of an attribute; None where it is absent or misread."""
    given = next((p for p in curves.arbitrary if p.name == name), None)
    if given is None or given.values is None or given.extent != extent or _misread(curves, given):
        return None
    values = given.values
    return np.repeat(values, len(curves.counts), axis=0) if len(values) == 1 else values
