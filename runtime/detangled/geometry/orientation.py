"""Which way the faces of a mesh look: outwards, all of them, wherever that can be told."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components


class Orientation(NamedTuple):
    """Which faces (F,) have to be turned over to look outwards, and counts of edges.

    open: of one face alone. crowded: of more than two. askew: whose two faces look to different sides.
    """

    turned: NDArray[np.bool_]
    open: int
    crowded: int
    askew: int


def orientation(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Orientation:
    """Judge the faces (F, 3) of a mesh with vertices (V, 3) by its edges and the volume that they enclose.

    Where neighbours look to different sides each connected part is made to agree, and then to look outwards; else
    all faces are turned over together, or none.
    """
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    low, high = np.minimum(tails, heads), np.maximum(tails, heads)
    order = np.argsort(low * (len(vertices) + 1) + high, kind="stable")
    low, high, tails = low[order], high[order], tails[order]
    first = np.flatnonzero(np.concatenate([[True], (np.diff(low) != 0) | (np.diff(high) != 0)])[: len(low)])
    uses = np.diff(np.append(first, len(low)))
    pairs = first[uses == 2]
    a, b = order[pairs] // 3, order[pairs + 1] // 3
    differ = tails[pairs] == tails[pairs + 1]
    if not differ.any():
        turned = np.full(len(faces), _volume(vertices, faces) < 0.0)
    else:
        turned = _agreed(vertices, faces, a, b, differ)
    return Orientation(turned, int((uses == 1).sum()), int((uses > 2).sum()), int(differ.sum()))


def _agreed(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    a: NDArray[np.int64],
    b: NDArray[np.int64],
    differ: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Which faces to turn so that neighbours a and b (E,) look to one side, and each connected part outwards."""
    count = len(faces)
    graph = csr_array((np.ones(2 * len(a)), (np.append(a, b), np.append(b, a))), shape=(count, count))
    against = dict(zip(zip(a.tolist(), b.tolist(), strict=True), differ.tolist(), strict=True))
    turned = np.zeros(count, dtype=np.bool_)
    parts, part = connected_components(graph, directed=False)
    seeds = np.unique(part, return_index=True)[1]
    for number in range(parts):
        members, before = breadth_first_order(graph, seeds[number], directed=False)
        for face in members[1:].tolist():
            other = int(before[face])
            pair = (other, face) if (other, face) in against else (face, other)
            turned[face] = turned[other] != against[pair]
        own = np.where(turned[members, None], faces[members, ::-1], faces[members])
        if _volume(vertices, own) < 0.0:
            turned[members] = ~turned[members]
    return turned


def _volume(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> float:
    """Volume [cm3] between the faces and the middle of their corners: positive where they look outwards."""
    corners = vertices[faces]
    corners = corners - corners.reshape(-1, 3).mean(axis=0)
    return float(np.einsum("fc,fc->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0)
