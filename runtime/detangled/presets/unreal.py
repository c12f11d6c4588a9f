"""Unreal's groom schema 1.5: the attributes that its importer reads, in the types and scopes that it reads.

Epic Games, "Alembic for Grooms Specification". Properties of the whole groom stand on its topmost node, everything
else on the curves; whatever does not begin with ``groom_`` is ignored but for the curves' own widths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detangled.errors import DetangledError
from detangled.formats import objects
from detangled.groom import Attribute, Groom, Scope
from detangled.presets.closest_guides import GUIDES_A_STRAND, closest_guides
from detangled.presets.root_uv import spherical

MAJOR, MINOR = 1, 5
# Unreal draws hair 1 cm thick where nothing says how thick it is: this is an ordinary one [cm].
USUAL_WIDTH_CM = 0.007
COLOURS = ("groom_color", "color", "Cd", "displayColor")
# Unreal keeps the ids of closest guides as float32, which tell whole numbers apart up to here.
MOST_ID = 2**24


def with_schema(groom: Groom, root_uv: NDArray[np.float64] | None = None) -> tuple[Groom, list[str]]:
    """The groom with every attribute of the schema, and sentences about what had to be made up.

    root_uv: (S, 2), for a groom that has none. Every strand must have points.
    """
    said: list[str] = []
    owner = objects.owners(groom).astype(np.int32)
    groups = _groups(groom, owner, said)
    ids = _ids(groom, said)
    made: dict[str, Attribute] = {
        "groom_version_major": Attribute(np.array([MAJOR], dtype=np.int16), Scope.GROOM),
        "groom_version_minor": Attribute(np.array([MINOR], dtype=np.int16), Scope.GROOM),
        "groom_tool": _tool(),
        "groom_properties": _text(groom, "groom_properties", "preset unreal, cm, z up"),
        "groom_group_id": Attribute(groups, Scope.STRAND),
        "groom_group_name": _group_names(groom, groups, owner),
        "groom_id": Attribute(ids, Scope.STRAND),
        "groom_root_uv": Attribute(_root_uv(groom, root_uv, said), Scope.STRAND),
        **_widths(groom, said),
        **_colour(groom, said),
    }
    guide = _guides(groom, said)
    if guide is not None:
        made["groom_guide"] = Attribute(guide.astype(np.int32), Scope.STRAND)
    kept = {name: a for name, a in groom.attributes.items() if name not in _RESERVED}
    carried = _carried_guides(groom, ids) if guide is not None else None
    if carried is not None:
        made |= carried
    elif guide is not None:
        closest, weights = closest_guides(groom, guide, groups.astype(np.int64), ids)
        made["groom_closest_guides"] = Attribute(closest, Scope.STRAND)
        made["groom_guide_weights"] = Attribute(weights, Scope.STRAND)
        lonely = int(np.count_nonzero(closest[:, 0] < 0))
        said.append("each strand's three closest guides were found by their roots")
        if lonely:
            raise DetangledError(
                f"{lonely} strands are in groups without guides, though others are flagged: Unreal would leave them "
                "out; flag some of theirs (groom_guide), or none at all"
            )
    elif {"groom_closest_guides", "groom_guide_weights"} & groom.attributes.keys():
        said.append("closest guides were left out, since no strand is flagged as a guide")
    return replace(groom, attributes={**kept, **made}), said


def split_groups(groom: Groom, most_strands: int, most_points: int) -> tuple[Groom, list[str]]:
    """The groom with groups of more strands or points than these split into several, and what to say of it."""
    groups = groom.attributes["groom_group_id"].values
    names = groom.attributes["groom_group_name"]
    labels = np.repeat(names.values, groom.strand_count) if names.scope is Scope.GROOM else names.values
    new, new_labels, said = groups.copy(), labels.astype(object), []
    following = int(groups.max()) + 1
    for group in np.unique(groups):
        members = np.flatnonzero(groups == group)
        part = _parts(groom.point_counts[members], most_strands, most_points)
        if part[-1] == 0:
            continue
        if "groom_guide" in groom.attributes:
            raise DetangledError(
                f"group {group} has {len(members):,} strands of {int(groom.point_counts[members].sum()):,} points, "
                f"Unreal takes {most_strands:,} of {most_points:,}; it has guides, which cannot be split with it: "
                "make several groups (groom_group_id)"
            )
        most = f"{most_strands:,} strands and {most_points:,} points"
        said.append(f"group {group} was split into {part[-1] + 1}: Unreal takes {most} a group")
        beyond = members[part > 0]
        new[beyond] = following + part[part > 0] - 1
        new_labels[beyond] = [f"{labels[i]}_{number + 1}" for i, number in zip(beyond, part[part > 0], strict=True)]
        following += int(part[-1])
    if not said:
        return groom, []
    attributes = {
        **groom.attributes,
        "groom_group_id": Attribute(new, Scope.STRAND),
        "groom_group_name": Attribute(new_labels.astype(np.str_), Scope.STRAND),
    }
    return replace(groom, attributes=attributes), said


_RESERVED = {"groom_guide", "groom_closest_guides", "groom_guide_weights", "groom_color"}


def _parts(counts: NDArray[np.int64], most_strands: int, most_points: int) -> NDArray[np.int64]:
    """Into which part (S,) each of some strands goes, so that none has too many strands or points."""
    part = np.zeros(len(counts), dtype=np.int64)
    begin, number = 0, 0
    summed = np.concatenate([[0], np.cumsum(counts)])
    while begin < len(counts):
        fitting = int(np.searchsorted(summed, summed[begin] + most_points, side="right")) - 1
        end = min(max(fitting, begin + 1), begin + most_strands)
        part[begin:end] = number
        begin, number = end, number + 1
    return part


def _tool() -> Attribute:
    from detangled import __version__

    return Attribute(np.array([f"detangled {__version__}"]), Scope.GROOM)


def _text(groom: Groom, name: str, otherwise: str) -> Attribute:
    own = groom.attributes.get(name)
    if own is not None and own.scope is Scope.GROOM and own.values.dtype.kind == "U" and own.values.shape == (1,):
        return own
    return Attribute(np.array([otherwise]), Scope.GROOM)


def _per_strand(groom: Groom, name: str) -> NDArray[Any] | None:
    """Values (S, ...) of an attribute a strand: those of its root where it has one a point; None if it is absent."""
    attribute = groom.attributes.get(name)
    if attribute is None:
        return None
    if attribute.scope is Scope.GROOM:
        return np.repeat(attribute.values, groom.strand_count, axis=0)
    return attribute.values[groom.offsets[:-1]] if attribute.scope is Scope.POINT else attribute.values


def _whole_numbers(groom: Groom, name: str, said: list[str], fits: Callable[[NDArray[Any]], bool]) -> Any:
    """Whole numbers (S,) of an attribute as int32, None where there are none of use, which is said."""
    values = _per_strand(groom, name)
    if values is None:
        return None
    if values.ndim > 1 and values.shape[1:] == (1,):
        values = values[:, 0]
    sound = values.ndim == 1 and values.dtype.kind in "biuf" and bool(np.isfinite(values).all())
    if sound and values.size and not (values.min() >= 0 and values.max() < 2**31 and (values == values.round()).all()):
        sound = False
    if not sound or not fits(values):
        said.append(f"attribute {name!r} was made anew: it does not hold what Unreal's schema says")
        return None
    return values.astype(np.int32)


def _groups(groom: Groom, owner: NDArray[np.int32], said: list[str]) -> NDArray[np.int32]:
    own = _whole_numbers(groom, "groom_group_id", said, lambda values: True)
    return owner if own is None else own


def _group_names(groom: Groom, groups: NDArray[np.int32], owner: NDArray[np.int32]) -> Attribute:
    own = groom.attributes.get("groom_group_name")
    if own is not None and own.values.dtype.kind == "U" and own.values.ndim == 1 and own.scope is not Scope.POINT:
        return own
    present, first = np.unique(groups, return_index=True)
    by_object = np.array_equal(groups, owner)
    names = [
        groom.objects[owner[strand]] if by_object else f"group_{number}"
        for number, strand in zip(present, first, strict=True)
    ]
    if len(present) == 1:
        return Attribute(np.array([groom.objects[0] if by_object else names[0]]), Scope.GROOM)
    return Attribute(np.array(names)[np.searchsorted(present, groups)], Scope.STRAND)


def _ids(groom: Groom, said: list[str]) -> NDArray[np.int32]:
    def told_apart(values: NDArray[Any]) -> bool:
        return len(np.unique(values)) == len(values) and bool((values < MOST_ID).all())

    own = _whole_numbers(groom, "groom_id", said, told_apart)
    return np.arange(groom.strand_count, dtype=np.int32) if own is None else own


def _root_uv(groom: Groom, given: NDArray[np.float64] | None, said: list[str]) -> NDArray[np.float32]:
    if given is not None and np.shape(given) != (groom.strand_count, 2):
        raise DetangledError(f"root UVs must have the shape ({groom.strand_count}, 2), not {np.shape(given)}")
    for name in ("groom_root_uv", "uv"):
        own = _per_strand(groom, name)
        if own is None:
            continue
        if own.ndim == 2 and own.shape[1] in (2, 3) and own.dtype.kind == "f" and np.isfinite(own).all():
            if groom.attributes[name].scope is Scope.GROOM and groom.strand_count > 1:
                said.append(f"attribute {name!r} was made anew: it is one value for all roots")
                continue
            return own[:, :2].astype(np.float32)
        said.append(f"attribute {name!r} was not used as root UVs: it does not hold two finite numbers a strand")
    if given is not None:
        return given.astype(np.float32)
    said.append("root UVs were made by spherical projection, as Unreal would: no texture of a head will fit them")
    return spherical(groom)


def _widths(groom: Groom, said: list[str]) -> dict[str, Attribute]:
    for name in ("width", "groom_width"):
        own = groom.attributes.get(name)
        if own is not None and own.values.ndim == 1 and own.values.dtype.kind == "f":
            width = Attribute(own.values.astype(np.float32), own.scope)
            return {"width": width, "groom_width": width}
    said.append(f"hair was given a thickness of {10.0 * USUAL_WIDTH_CM:g} mm, since Unreal would take 1 cm")
    width = Attribute(np.array([USUAL_WIDTH_CM], dtype=np.float32), Scope.GROOM)
    return {"width": width, "groom_width": width}


def _colour(groom: Groom, said: list[str]) -> dict[str, Attribute]:
    for name in COLOURS:
        own = groom.attributes.get(name)
        if own is None:
            continue
        if own.values.ndim == 2 and own.values.shape[1] in (3, 4) and own.values.dtype.kind == "f":
            values = own.values[:, :3].astype(np.float32)
            counts = groom.point_counts if own.scope is Scope.STRAND else len(groom.points)
            values = values if own.scope is Scope.POINT else np.repeat(values, counts, axis=0)
            return {"groom_color": Attribute(values, Scope.POINT)}
        said.append(f"attribute {name!r} was not used as a colour: it does not hold three fractions")
    return {}


def _guides(groom: Groom, said: list[str]) -> NDArray[np.bool_] | None:
    own = _whole_numbers(groom, "groom_guide", said, lambda values: bool((values <= 1).all()))
    if own is None:
        return None
    if not own.any():
        said.append("no strand is flagged as a guide, so Unreal will choose guides itself")
        return None
    if own.all():
        said.append("every strand is flagged as a guide, which Unreal does not draw: the flags were left out")
        return None
    return np.asarray(own == 1)


def _carried_guides(groom: Groom, ids: NDArray[np.int32]) -> dict[str, Attribute] | None:
    """The groom's own closest guides and weights, if they are sound: ids of its guides, weights of no less than 0."""
    closest, weights = (_per_strand(groom, name) for name in ("groom_closest_guides", "groom_guide_weights"))
    shape = (groom.strand_count, GUIDES_A_STRAND)
    if closest is None or weights is None or closest.shape != shape or weights.shape != shape:
        return None
    own_ids = _per_strand(groom, "groom_id")
    if own_ids is None or not np.array_equal(own_ids.reshape(len(own_ids), -1)[:, 0], ids):
        return None
    flags = _per_strand(groom, "groom_guide")
    guides = ids[np.asarray(flags).reshape(groom.strand_count) == 1]
    used = weights > 0
    if not (np.isfinite(weights).all() and (weights >= 0).all() and used.any(axis=1).all()):
        return None
    if not np.isin(closest[used], guides).all():
        return None
    return {
        "groom_closest_guides": Attribute(closest.astype(np.int32), Scope.STRAND),
        "groom_guide_weights": Attribute(weights.astype(np.float32), Scope.STRAND),
    }
