"""Strands as polylines in Wavefront OBJ: one ``l`` element a strand.

Vertices count from 1, or back from the last one above the element where negative. The text is taken apart
with array operations on its bytes: no Python runs per vertex.
"""

from __future__ import annotations

import codecs
import re
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from detangled.errors import ReadError
from detangled.formats import objects, register
from detangled.groom import Groom, offsets_of

# Stands for a line break that a backslash undoes: blank like a space, yet counted in line numbers.
JOINED = 1
NEWLINE = 10
# Some editors put these before a text to tell its encoding.
UTF8_MARK = codecs.BOM_UTF8
UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
DEFAULT_UP = "y"
# Nine significant digits tell any two float32 values apart.
POINT_FORMAT = "v %.9g %.9g %.9g\n"
POINTS_A_BLOCK = 1 << 16


class _Lines:
    """The tokens of a text: where each begins and ends, and the line it stands in."""

    def __init__(self, text: bytes) -> None:
        self.text = text
        self.bytes = np.frombuffer(text, dtype=np.uint8)
        blank = self.bytes <= 32
        # A text ends with a line break, so every token has a blank behind it.
        edges = np.flatnonzero(np.diff(blank, prepend=True))
        self.starts, self.ends = edges[0::2], edges[1::2]
        breaks = np.flatnonzero(self.bytes == NEWLINE)
        token_line = np.searchsorted(breaks, self.starts)
        is_first = np.diff(token_line, prepend=-1) != 0
        self.first = np.flatnonzero(is_first)
        self.token_count = np.diff(np.append(self.first, len(self.starts)))
        self._keyword = np.zeros(len(self.first), dtype=np.uint8)
        single = (self.ends - self.starts)[self.first] == 1
        self._keyword[single] = self.bytes[self.starts[self.first[single]]]

    def of(self, keyword: str) -> NDArray[np.int64]:
        """Rows (lines that are not blank) that begin with this one-letter keyword."""
        return np.flatnonzero(self._keyword == ord(keyword))

    def tokens(self, rows: NDArray[np.int64], limit: int | None = None) -> NDArray[np.int64]:
        """Tokens behind the keyword of these rows, the first ``limit`` of each."""
        counts = self.token_count[rows] - 1
        if limit is not None:
            counts = np.minimum(counts, limit)
        begin = np.cumsum(counts) - counts
        return np.arange(int(counts.sum())) + np.repeat(self.first[rows] + 1 - begin, counts)

    def joined(self, tokens: NDArray[np.int64]) -> bytes:
        """The texts of these tokens, a blank between them."""
        step = np.zeros(len(self.bytes) + 1, dtype=np.int8)
        step[self.starts[tokens]] += 1
        step[self.ends[tokens] + 1] -= 1
        return self.bytes[np.cumsum(step[:-1], dtype=np.int8).view(bool)].tobytes()

    def word(self, token: int) -> str:
        return self.text[self.starts[token] : self.ends[token]].decode("utf-8", "replace")

    def number_of(self, token: int) -> int:
        """The line in the file, from 1, that holds this token."""
        before = self.bytes[: self.starts[token]]
        return 1 + int(np.count_nonzero((before == NEWLINE) | (before == JOINED)))


def read(path: Path) -> Groom:
    """Read the line elements of an OBJ file. Raises ReadError with the number of a line it cannot read."""
    text = path.read_bytes()
    if text.startswith(UTF16_MARKS):
        raise ReadError(f"{path}: a text in UTF-16: save it as UTF-8 or plain ASCII")
    lines = _Lines(_prepared(text))
    vertices, elements = lines.of("v"), lines.of("l")
    if len(elements) == 0:
        raise ReadError(f"{path}: has no line elements ('l 1 2 3 ...'), so no strands")
    positions = _positions(path, lines, vertices)
    counts = lines.token_count[elements] - 1
    rows = _rows(path, lines, vertices, elements, counts)
    names, owner = _objects(lines, elements)
    faces = len(lines.of("f"))
    notes = (f"skipped {faces} face{'s' if faces > 1 else ''}",) if faces else ()
    offsets = offsets_of(counts)
    return objects.with_owners(Groom(positions[rows], offsets, objects=names, notes=notes), owner)


def write(groom: Groom, path: Path) -> list[str]:
    """Write strands whose lengths are in the file's unit as line elements, in the order of their objects."""
    lost = []
    owner = objects.owners(groom)
    order = np.argsort(owner, kind="stable")
    owner, ordered = owner[order], groom.select(order)
    counts = ordered.point_counts
    empty = int(np.count_nonzero(counts == 0))
    if empty:
        lost.append(
            f"{empty} strand{'s' if empty > 1 else ''} without points {'were' if empty > 1 else 'was'} left out"
        )
    if np.any(np.diff(order) < 0):
        lost.append("strands were put in the order of their objects")
    if groom.up != DEFAULT_UP:
        lost.append(f"{groom.up} stays up, but an OBJ file cannot say so: most programs will take {DEFAULT_UP}")
    lost += [f"attribute {name!r} was not kept: OBJ lines hold none" for name in objects.other_attributes(groom)]
    with np.errstate(over="ignore"):
        points = ordered.points.astype(np.float32)
    with open(path, "wb") as file:
        for begin in range(0, len(points), POINTS_A_BLOCK):
            block = points[begin : begin + POINTS_A_BLOCK]
            file.write(((POINT_FORMAT * len(block)) % tuple(block.ravel().tolist())).encode())
        numbers = list(map(str, range(1, len(points) + 1)))
        bounds = ordered.offsets.tolist()
        for index, name in enumerate(groom.objects):
            file.write(f"o {_one_line(name)}\n".encode())
            strands = np.flatnonzero((owner == index) & (counts > 0)).tolist()
            file.write("".join(f"l {' '.join(numbers[bounds[s] : bounds[s + 1]])}\n" for s in strands).encode())
    return lost


def _prepared(text: bytes) -> bytes:
    text = text.removeprefix(UTF8_MARK)
    if b"\n" not in text:
        text = text.replace(b"\r", b"\n")
    if b"#" in text:
        text = re.sub(rb"#[^\n]*", b"", text)
    if b"\\" in text:
        text = re.sub(rb"\\\r?\n", bytes([32, JOINED]), text)
    return text + b"\n"


def _positions(path: Path, lines: _Lines, vertices: NDArray[np.int64]) -> NDArray[np.float64]:
    short = np.flatnonzero(lines.token_count[vertices] < 4)
    if len(short):
        token = int(lines.first[vertices[short[0]]])
        raise ReadError(f"{path}: line {lines.number_of(token)}: a vertex needs three coordinates")
    tokens = lines.tokens(vertices, limit=3)
    return _numbers(path, lines, tokens, lines.joined(tokens), np.float64).reshape(-1, 3)


def _rows(
    path: Path,
    lines: _Lines,
    vertices: NDArray[np.int64],
    elements: NDArray[np.int64],
    counts: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Indices, from 0, of the vertices that the line elements name, one after another."""
    tokens = lines.tokens(elements)
    text = lines.joined(tokens)
    if b"/" in text:
        text = re.sub(rb"/[^\s\x01]*", b"", text)
    index = _numbers(path, lines, tokens, text, np.int64)
    # Negative ones count back from the last vertex above the element.
    above = np.repeat(np.searchsorted(vertices, elements), counts)
    rows = np.where(index < 0, above + index, index - 1)
    wrong = np.flatnonzero((rows < 0) | (rows >= len(vertices)))
    if len(wrong):
        token = int(tokens[wrong[0]])
        raise ReadError(
            f"{path}: line {lines.number_of(token)}: there is no vertex {lines.word(token)}, "
            f"the file has {len(vertices)}"
        )
    return rows


def _numbers(path: Path, lines: _Lines, tokens: NDArray[np.int64], text: bytes, dtype: type[np.generic]) -> NDArray:
    """Parse as many numbers as there are tokens, or raise ReadError at the first that is none."""
    with warnings.catch_warnings():
        # NumPy warns, and stops, at the first thing that is no number.
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            values = np.fromstring(text.replace(b"\x01", b" "), dtype=dtype, sep=" ") if len(tokens) else None
        except ValueError:
            values = np.empty(0, dtype=dtype)
    if values is None:
        return np.empty(0, dtype=dtype)
    if len(values) == len(tokens):
        return values
    parse = float if np.issubdtype(dtype, np.floating) else int
    for token in tokens.tolist():
        word = lines.word(token)
        try:
            parse(word.partition("/")[0] if parse is int else word)
        except ValueError:
            raise ReadError(f"{path}: line {lines.number_of(token)}: {word!r} is not a number") from None
    raise ReadError(f"{path}: its numbers cannot be read")


def _objects(lines: _Lines, elements: NDArray[np.int64]) -> tuple[tuple[str, ...], NDArray[np.int64]]:
    """Names of the objects that hold line elements, and the one that each element belongs to."""
    headers = lines.of("o")
    owner = np.searchsorted(headers, elements)
    used, owner = np.unique(owner, return_inverse=True)
    names = []
    for number in used.tolist():
        words = lines.tokens(headers[[number - 1]]).tolist() if number else []
        names.append(" ".join(lines.word(token) for token in words) or "hair")
    return tuple(names), owner


def _one_line(name: str) -> str:
    return " ".join(name.split()) or "hair"


register((".obj",), read, write)
