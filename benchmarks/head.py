"""How long a head's distance field takes, and its look-ups, beside trimesh's own signed distance; and how exact it is.

python benchmarks/head.py [HEAD] [--points 10000000] [--compared 2000]

Without a HEAD: vitruvian_head.obj of the sample grooms, else a sphere of 40,000 faces.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import time
from pathlib import Path

import numpy as np
import trimesh

from detangled.formats.meshes import read_head
from detangled.grooming.head_distance import exact_distances, head_distance
from detangled.grooming.head_inside import winding_tree
from detangled.head import Head
from detangled.kernels import thread_count

SEED = 1
FIELD_BOUND_S, LOOKUP_BOUND_S, LOOKUPS = 20.0, 2.0, 10_000_000
NEAR = 0.1  # [cm] around the surface, where hair is kept out


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("head", nargs="?", type=Path)
    parser.add_argument("--points", type=int, default=LOOKUPS)
    parser.add_argument("--compared", type=int, default=2000)
    options = parser.parse_args(arguments)
    head = _head(options.head)
    rng = np.random.default_rng(SEED)
    head_distance(head, finest=2.0).at(np.zeros((1, 3)))  # compiled before the clock runs

    began = time.perf_counter()
    field = head_distance(head)
    made = time.perf_counter() - began
    points = rng.uniform(head.vertices.min(axis=0), head.vertices.max(axis=0), (options.points, 3))
    began = time.perf_counter()
    field.at(points)
    read = time.perf_counter() - began
    print(f"{len(head.faces)} faces, {thread_count()} threads, nodes {field.step:.3f} cm apart")
    print(f"field made           {made:7.2f} s   bound {FIELD_BOUND_S:.0f}")
    print(f"{options.points} look-ups {read:6.2f} s   bound {LOOKUP_BOUND_S * options.points / LOOKUPS:.1f}")

    few = points[: options.compared]
    began = time.perf_counter()
    exact = exact_distances(winding_tree(head), few)
    brute = time.perf_counter() - began
    print(f"a look-up {1e9 * read / len(points):.0f} ns; from every triangle {1e9 * brute / len(few):.0f} ns")
    if importlib.util.find_spec("rtree") is None:
        print("trimesh's signed distance needs rtree, which is not installed: pip install rtree")
    else:
        mesh = trimesh.Trimesh(head.vertices, head.faces, process=False)
        began = time.perf_counter()
        theirs = -trimesh.proximity.signed_distance(mesh, few)
        slow = (time.perf_counter() - began) / len(few)
        print(f"by trimesh {1e9 * slow:.0f} ns, {slow * len(points) / read:.0f} times a look-up")
        with_field = (made + read) / len(points)
        print(f"with the field's making, {slow / with_field:.0f} times as long for {len(points)} points")
        print(f"its sign is another than that of the winding number at {np.mean((theirs < 0) != (exact < 0)):.1%}")
    tri = rng.integers(len(head.faces), size=options.compared)
    weights = rng.dirichlet([1, 1, 1], size=options.compared)
    surface = np.einsum("pc,pck->pk", weights, head.vertices[head.faces[tri]])
    top = surface[:, 1] > head.vertices[:, 1].max() - 6.0
    near = surface + rng.normal(scale=NEAR, size=surface.shape)
    error = np.abs(field.at(near) - exact_distances(winding_tree(head), near))
    for name, some in (("all over", np.ones_like(top)), ("on its top", top)):
        if some.any():
            mean, most, worst = error[some].mean(), np.quantile(error[some], 0.99), error[some].max()
            print(f"error near the surface {name}: mean {mean:.4f}, 99 % {most:.3f}, worst {worst:.3f} cm")
    if made > FIELD_BOUND_S or read > LOOKUP_BOUND_S * options.points / LOOKUPS:
        raise SystemExit("beyond a bound")


def _head(path: Path | None) -> Head:
    grooms = Path(os.environ.get("DETANGLED_GROOMS", Path(__file__).resolve().parents[2] / "shared" / "grooms"))
    sample = grooms / "heads" / "vitruvian_head.obj"
    if path is None and not sample.is_file():
        mesh = trimesh.creation.uv_sphere(10.0, count=[142, 142])
        return Head(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    return read_head(path or sample)


if __name__ == "__main__":
    main()
