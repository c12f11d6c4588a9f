"""retexture with heads as others make them, from the command to the file: a group of many, texture on two tiles."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from detangled.formats import read, write
from detangled.formats.meshes import read_head
from detangled.grooming.head_distance import exact_distances
from detangled.grooming.head_inside import winding_tree
from detangled.grooming.interpenetration import ROOT
from detangled.grooming.scalp_mesh import places_on
from detangled_cli.main import detangled
from heads import scalp_hair

COILY = Path(__file__).resolve().parents[1] / "examples" / "coily_strands.obj"
COUNT = 24
NEAR = 1e-3  # [cm] float32 of 1.7 m above the ground, turned to another axis
SKIN = 0.05  # [cm] that hair may be in


@pytest.mark.parametrize(
    ("name", "group", "tiles"),
    [("makehuman_base", "took the faces of body", {0}), ("ict_head", "took the faces of M_BackHead, M_Face", {0, 1})],
)
def test_a_groom_on_another_head(
    grooms: Callable[[str], Path], tmp_path: Path, name: str, group: str, tiles: set[int]
) -> None:
    mesh = grooms(f"heads/{name}.obj")
    head = read_head(mesh)
    groom = scalp_hair(head, COUNT)
    source, target = tmp_path / "hair.abc", tmp_path / "coily.abc"
    write(groom, source)
    options = ["--target", COILY, "--unit", "cm", "--head", mesh, "--density", 3, "--preset", "unreal"]
    done = CliRunner().invoke(detangled, ["retexture", *map(str, [source, target, *options])])
    assert done.exit_code == 0, done.stderr
    assert group in done.stderr
    assert "spherical projection" not in done.stderr

    made = read(target, unit="cm", up="y")
    assert 2 * COUNT < made.strand_count <= 3 * COUNT
    roots = made.points[made.offsets[:-1]]
    np.testing.assert_allclose(roots[:COUNT], groom.points[groom.offsets[:-1]], atol=NEAR)
    places = places_on(roots, head)
    np.testing.assert_allclose(places.positions, roots, atol=NEAR)
    uv = made.attributes["groom_root_uv"].values
    np.testing.assert_allclose(uv, places.uv(head), atol=1e-3)
    # Those of the new strands among them, not of the old ones alone.
    assert set(np.floor(uv[COUNT:, 0])) == tiles
    assert set(np.floor(uv[:, 1])) == {0}

    strands = [made.strand(k) for k in range(made.strand_count)]
    along = np.concatenate([np.cumsum(np.linalg.norm(np.diff(s, axis=0, prepend=s[:1]), axis=1)) for s in strands])
    distances = exact_distances(winding_tree(head), made.points[along > ROOT][::5])
    assert np.count_nonzero(distances < 0.0) < 0.001 * len(distances)
    assert distances.min() > -SKIN
