"""What Alembic stores in an Ogawa container, checked before the Alembic library sees it.

The library trusts much of what it reads: a damaged file can make it follow a null pointer, write past a
buffer, or ask for all the memory there is, which no ``except`` catches. The layout is that of AbcCoreOgawa
(ReadUtil.cpp): an object is a group of its properties, its children and their headers; a compound property a
group of its members and their headers; a sample one piece of data, a 16-byte key before its bytes, and for
arrays a second with dimensions. Samples equal to the one before, at the beginning and the end, are stored once.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import NamedTuple

from detangled.formats.ogawa import Container, opened

ROOT_CHILDREN = 6
TOP_OBJECT, TIME_SAMPLINGS, INDEXED_METADATA = 2, 4, 5
HEADER_HASH_BYTES = 32
KEY_BYTES = 16
INLINE_METADATA = 0xFF
COMPOUND, SCALAR = 0, 1
# Bits of a property's header: which samples changed is told; none did.
CHANGES, CONSTANT = 0x200, 0x800

# Bytes of one value by type, in the library's order: bool, then 8 to 64 bits, then halves, floats, doubles.
POD_BYTES = (1, 1, 1, 2, 2, 4, 4, 8, 8, 2, 4, 8)
STRING, WSTRING = 12, 13
WSTRING_CHARACTER_BYTES = 4


class _Property(NamedTuple):
    name: str
    kind: int
    pod: int
    extent: int
    samples: int  # that are stored


def check(path: Path, frames: bool = False) -> None:
    """Raise ReadError where the library could not be trusted with the file at ``path``.

    frames: whether all samples are looked at, for those who read them, or only the first ones.
    """
    with opened(path) as container:
        top = container.children(container.root)
        if len(top) < ROOT_CHILDREN:
            raise container.damaged("its root is incomplete")
        for child in top[:TOP_OBJECT] + top[TOP_OBJECT + 1 : ROOT_CHILDREN]:
            container.data_size(child)
        metadata_count = _count_metadata(container.data(top[INDEXED_METADATA]))
        _check_objects(container, top[TOP_OBJECT], metadata_count, frames)


def _count_metadata(data: bytes) -> int:
    # The empty metadata are number 0 and not stored.
    count, position = 1, 0
    while position < len(data):
        position += 1 + data[position]
        count += 1
    return count


def _check_objects(container: Container, top: int, metadata_count: int, frames: bool) -> None:
    seen: set[int] = set()
    waiting = [top]
    while waiting:
        group = waiting.pop()
        children = container.children(group)
        if group and group in seen:
            raise container.damaged(f"two parents hold the object at byte {group}")
        seen.add(group)
        if not children:
            continue
        _check_compounds(container, children[0], metadata_count, frames)
        headers = _count_objects(container, container.data(children[-1]), metadata_count) if len(children) > 1 else 0
        if headers != max(0, len(children) - 2):
            raise container.damaged(f"{headers} objects are announced at byte {group}, {len(children) - 2} are there")
        waiting.extend(children[1:-1])


def _count_objects(container: Container, data: bytes, metadata_count: int) -> int:
    cursor = _Cursor(container, data[: max(0, len(data) - HEADER_HASH_BYTES)])
    count = 0
    while not cursor.done:
        cursor.text(cursor.number(4))
        index = cursor.number(1)
        if index == INLINE_METADATA:
            cursor.text(cursor.number(4), least=0)
        elif index >= metadata_count:
            raise container.damaged("an object's metadata are missing")
        count += 1
    return count


def _check_compounds(container: Container, top: int, metadata_count: int, frames: bool) -> None:
    seen: set[int] = set()
    waiting = [top]
    while waiting:
        group = waiting.pop()
        children = container.children(group)
        if group and group in seen:
            raise container.damaged(f"two parents hold the property at byte {group}")
        seen.add(group)
        if not children:
            continue
        properties = _properties(container, container.data(children[-1]), metadata_count)
        if len(properties) != len(children) - 1:
            raise container.damaged(
                f"{len(properties)} properties are announced at byte {group}, {len(children) - 1} are there"
            )
        for member, entry in zip(properties, children[:-1], strict=True):
            if member.kind == COMPOUND:
                waiting.append(entry)
            elif member.samples:
                entries = container.children(entry)
                for number in range(member.samples if frames else 1):
                    _check_sample(container, member, entries, number)


def _properties(container: Container, data: bytes, metadata_count: int) -> list[_Property]:
    cursor = _Cursor(container, data)
    found = []
    while not cursor.done:
        info = cursor.number(4)
        kind, width, pod, extent = info & 0x3, (info >> 2) & 0x3, (info >> 4) & 0xF, (info >> 12) & 0xFF
        if width > 2:
            raise container.damaged("a property's header makes no sense")
        width = 1 << width
        samples = 0
        if kind != COMPOUND:
            if pod > WSTRING or extent == 0:
                raise container.damaged("a property is of an unknown type")
            samples = cursor.number(width)
            first, last = (0, 0) if info & CONSTANT else (1, samples - 1)
            if info & CHANGES:
                first, last = cursor.number(width), cursor.number(width)
                if first > last or (samples and last >= samples):
                    raise container.damaged("a property's samples are out of order")
            if samples:
                samples = last - first + 2 if last > 0 else 1
            if info & 0x100:
                cursor.number(width)
        name = cursor.text(cursor.number(width))
        metadata = (info >> 20) & 0xFF
        if metadata == INLINE_METADATA:
            cursor.text(cursor.number(width), least=0)
        elif metadata >= metadata_count:
            raise container.damaged(f"the metadata of {name!r} are missing")
        found.append(_Property(name, kind, pod, extent, samples))
    return found


def _check_sample(container: Container, member: _Property, entries: list[int], number: int) -> None:
    """Check one stored sample of a scalar or array property against its type and dimensions."""
    needed = 1 if member.kind == SCALAR else 2
    entries = entries[number * needed : (number + 1) * needed]
    if len(entries) < needed:
        raise container.damaged(f"the values of {member.name!r} are missing")
    size = container.data_size(entries[0])
    if 0 < size < KEY_BYTES:
        raise container.damaged(f"the values of {member.name!r} are cut short")
    payload = max(0, size - KEY_BYTES)
    is_text = member.pod in (STRING, WSTRING)
    unit = member.extent * (1 if is_text else POD_BYTES[member.pod])
    if member.kind == SCALAR:
        if payload != unit and not is_text:
            raise container.damaged(f"{member.name!r} holds {payload} bytes, its type says {unit}")
        if is_text and _count_texts(container.data(entries[0]), member.pod) != member.extent:
            raise container.damaged(f"{member.name!r} holds another number of texts than its type says")
        return
    if container.data_size(entries[1]) == 0:
        if is_text and payload:
            raise container.damaged(f"{member.name!r} does not say how many texts it holds")
        if payload % unit:
            raise container.damaged(f"{member.name!r} holds {payload} bytes, not a multiple of {unit}")
        return
    dimensions = container.data(entries[1])
    if len(dimensions) % 8:
        raise container.damaged(f"the dimensions of {member.name!r} are cut short")
    count = math.prod(struct.unpack(f"<{len(dimensions) // 8}Q", dimensions))
    if is_text:
        if count * member.extent != _count_texts(container.data(entries[0]), member.pod):
            raise container.damaged(f"{member.name!r} holds another number of texts than it says")
    elif count * unit != payload:
        raise container.damaged(f"{member.name!r} holds {payload} bytes, its dimensions say {count * unit}")


def _count_texts(data: bytes, pod: int) -> int:
    if pod == STRING:
        return data.count(0, KEY_BYTES)
    characters = data[KEY_BYTES:]
    return sum(
        1 for (c,) in struct.iter_unpack("<I", characters[: len(characters) // WSTRING_CHARACTER_BYTES * 4]) if c == 0
    )


class _Cursor:
    """Reads headers field by field, never past their end."""

    def __init__(self, container: Container, data: bytes) -> None:
        self._container = container
        self._data = data
        self._position = 0

    @property
    def done(self) -> bool:
        return self._position >= len(self._data)

    def number(self, width: int) -> int:
        return int.from_bytes(self._take(width), "little")

    def text(self, size: int, least: int = 1) -> str:
        if size < least:
            raise self._container.damaged("something has no name")
        return self._take(size).decode("utf-8", "replace")

    def _take(self, size: int) -> bytes:
        if size > len(self._data) - self._position:
            raise self._container.damaged("a header is cut short")
        self._position += size
        return self._data[self._position - size : self._position]
