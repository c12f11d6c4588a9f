"""The tables of a PLY file: elements of scalar properties, in text or binary of either byte order, read whole.

Own code rather than trimesh's reader, which keeps what a mesh has and asks for memory before it looks at the size.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detangled.errors import ReadError

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
}
_TYPES |= {f"{kind}{8 * size}": f"{kind[0]}{size}" for kind in ("int", "uint") for size in (1, 2, 4)}
_TYPES |= {"float32": "f4", "float64": "f8"}
_NAMES = {code: name for name, code in reversed(_TYPES.items())} | {"f4": "float", "f8": "double"}
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
MAGIC = b"ply"
END = b"end_header"
# A header longer than this is none.
MOST_HEADER_BYTES = 1 << 20

Table = NDArray[np.void]


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    fields: tuple[tuple[str, str], ...]
    has_lists: bool = False


def read_tables(path: Path) -> tuple[dict[str, Table], list[str], list[str]]:
    """Tables by the names of their elements, the header's comments, and names of elements that were not read.

    Elements from the first that has lists on are not read, since their size is known only by going through them.
    Raises ReadError where the header is none, or tells of more than the file holds.
    """
    content = path.read_bytes()
    order, elements, comments, body = _header(path, content)
    tables: dict[str, Table] = {}
    at = body
    tokens: list[bytes] = content[body:].split() if order == "=" else []
    for number, element in enumerate(elements):
        if element.has_lists:
            return tables, comments, [later.name for later in elements[number:]]
        dtype = np.dtype([(name, order + code) for name, code in element.fields])
        if order == "=":
            size = element.count * len(element.fields)
            tables[element.name] = _from_text(path, element, dtype, tokens[:size])
            tokens = tokens[size:]
            continue
        end = at + element.count * dtype.itemsize
        if end > len(content):
            raise ReadError(
                f"{path}: damaged or cut short: by its header the element {element.name!r} reaches to byte {end:,}, "
                f"the file has {len(content):,}"
            )
        tables[element.name] = np.frombuffer(content, dtype=dtype, count=element.count, offset=at)
        at = end
    return tables, comments, []


def write_tables(path: Path, tables: dict[str, Table], comments: list[str]) -> None:
    """Write tables of scalar fields as a binary PLY file, little-endian."""
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {comment}" for comment in comments)]
    for name, table in tables.items():
        lines.append(f"element {name} {len(table)}")
        fields: Any = table.dtype.fields or {}
        lines += [f"property {_NAMES[fields[field][0].str[1:]]} {field}" for field in table.dtype.names or ()]
    with open(path, "wb") as file:
        file.write("\n".join([*lines, "end_header", ""]).encode("ascii"))
        for table in tables.values():
            table.tofile(file)


def _header(path: Path, content: bytes) -> tuple[str, list[_Element], list[str], int]:
    """Byte order, elements, comments, and where the first element begins."""
    head = content[:MOST_HEADER_BYTES]
    if not head.startswith(MAGIC):
        raise ReadError(f"{path}: no PLY file: it does not begin with 'ply'")
    at = head.find(END)
    line_end = head.find(b"\n", at)
    if at < 0 or line_end < 0:
        raise ReadError(f"{path}: damaged or cut short: its header has no end")
    order, elements, comments = "", [], []
    for number, line in enumerate(head[:at].decode("utf-8", "replace").splitlines()[1:], start=2):
        words = line.split()
        if not words or words[0] == "obj_info":
            continue
        if words[0] == "comment":
            comments.append(line.partition("comment")[2].strip())
        elif words[0] == "format" and len(words) == 3 and words[1] in _ORDERS:
            order = _ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3 and words[2].isdecimal():
            elements.append(_Element(words[1], int(words[2]), ()))
        elif words[0] == "property" and elements and len(words) == 5 and words[1] == "list":
            elements[-1] = _Element(elements[-1].name, elements[-1].count, elements[-1].fields, True)
        elif words[0] == "property" and elements and len(words) == 3 and words[1] in _TYPES:
            last = elements[-1]
            if words[2] in dict(last.fields):
                raise ReadError(f"{path}: line {number}: a second property {words[2]!r} of the element {last.name!r}")
            elements[-1] = _Element(last.name, last.count, (*last.fields, (words[2], _TYPES[words[1]])), last.has_lists)
        else:
            raise ReadError(f"{path}: line {number}: not what a PLY header holds: {line[:80]!r}")
    if not order:
        raise ReadError(f"{path}: its header names no format (ascii, or binary of either byte order)")
    return order, elements, comments, line_end + 1


def _from_text(path: Path, element: _Element, dtype: np.dtype[Any], tokens: list[bytes]) -> Table:
    if len(tokens) < element.count * len(element.fields):
        raise ReadError(
            f"{path}: damaged or cut short: {element.count:,} {element.name!r} of {len(element.fields)} numbers "
            f"are in its header, {len(tokens):,} numbers follow"
        )
    table = np.empty(element.count, dtype=dtype)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            grid = np.array(tokens, dtype=np.float64).reshape(element.count, len(element.fields))
            for column, (name, _) in enumerate(element.fields):
                table[name] = grid[:, column]
        except (ValueError, OverflowError) as error:
            raise ReadError(f"{path}: {error}") from None
    return table
