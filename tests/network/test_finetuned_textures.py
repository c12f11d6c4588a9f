"""Textures of the trained network: their files, and the commands that make and use them."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("onnx", reason="the tiny models are written by onnx")

from commands import (
    COILY,
    LENGTH_ACCURACY,
    Command,
    Floats,
    assert_refused,
    warnings_in,
)
from tiny_models import (
    ARCHITECTURE,
    PARAMETERS,
    WEIGHTS,
)

from detangled.archives import read_arrays, write_arrays
from detangled.errors import ModelError
from detangled.fitted import FINETUNE, FittedTexture, load_texture, save_texture
from detangled.fitting import fit
from detangled.formats import read, write
from detangled.geometry.spline import chord_lengths, spline_slopes
from detangled.groom import Groom
from detangled.grooming.guides import style_guides
from detangled.models import (
    FOLDER_VARIABLE,
)


def test_a_trained_texture_is_saved_and_loaded(texture: FittedTexture, tmp_path: Path) -> None:
    assert (texture.method, texture.architecture) == (FINETUNE, ARCHITECTURE)
    assert texture.weights.tobytes() != WEIGHTS.tobytes()
    save_texture(texture, tmp_path / "one.texture")
    loaded = load_texture(tmp_path / "one.texture")
    for name in ("signals", "starts", "weights", "calibration"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(texture, name))
    assert loaded.weights.dtype == np.float16
    for name in ("method", "architecture", "whitening", "schedule", "cell_width", "turn", "median_arc", "radius"):
        assert getattr(loaded, name) == getattr(texture, name)
    save_texture(loaded, tmp_path / "two.texture")
    assert (tmp_path / "two.texture").read_bytes() == (tmp_path / "one.texture").read_bytes()
    with np.load(tmp_path / "one.texture", allow_pickle=False) as archive:
        assert not any(archive[name].dtype.hasobject for name in archive.files)


def test_fitting_twice_writes_the_same_bytes(tmp_path: Path, command: Command) -> None:
    written = []
    for name, options in {"a": (), "b": ("--threads", 1), "c": ("--threads", 2), "d": ("--seed", 1)}.items():
        path = tmp_path / f"{name}.texture"
        code, said = command("fit", COILY, path, "--method", FINETUNE, *options)
        assert code == 0, said
        written.append(path.read_bytes())
    assert written[0] == written[1] == written[2] != written[3]


def changed(texture: FittedTexture, path: Path, **arrays: NDArray[Any]) -> Path:
    """A texture's file with other arrays."""
    save_texture(texture, path)
    write_arrays(path, read_arrays(path) | arrays)
    return path


@pytest.mark.parametrize(
    "weights",
    [
        np.where(np.arange(PARAMETERS) == 5, np.nan, WEIGHTS).astype(np.float16),
        np.where(np.arange(PARAMETERS) == 5, np.inf, WEIGHTS).astype(np.float16),
        WEIGHTS.astype(np.float32),
        WEIGHTS.reshape(3, 4),
        WEIGHTS[:0],
    ],
)
def test_damaged_weights_are_refused(
    texture: FittedTexture, few: Path, tmp_path: Path, command: Command, weights: NDArray[Any]
) -> None:
    bad = changed(texture, tmp_path / "bad.texture", weights=weights)
    assert_refused(command("retexture", few, tmp_path / "o.abc", "--target", bad), 4, str(bad), "damaged")
    assert not (tmp_path / "o.abc").exists()


@pytest.mark.parametrize("size", [5.0, 100.0, 60000.0, -60000.0])
def test_senseless_weights_make_no_file(
    texture: FittedTexture, few: Path, tmp_path: Path, command: Command, size: float
) -> None:
    bad = changed(texture, tmp_path / "bad.texture", weights=np.full(PARAMETERS, size, np.float16))
    refused = command("retexture", few, tmp_path / "o.abc", "--target", bad)
    assert_refused(refused, 4, "no finite strands", "fit it again")
    assert not (tmp_path / "o.abc").exists()


def test_weights_do_not_go_with_patches(tmp_path: Path, texture: FittedTexture) -> None:
    plain = fit(read(COILY, unit="cm"))
    assert len(plain.weights) == 0
    bad = changed(plain, tmp_path / "bad.texture", weights=texture.weights)
    with pytest.raises(ModelError, match=r"bad\.texture: .*damaged"):
        load_texture(bad)


def test_a_texture_keeps_its_method(texture: FittedTexture, few: Path, tmp_path: Path, command: Command) -> None:
    save_texture(texture, tmp_path / "finetune.texture")
    save_texture(fit(read(COILY, unit="cm")), tmp_path / "patches.texture")
    out = tmp_path / "o.abc"
    for own, other in (("finetune", "patches"), ("patches", "finetune")):
        words = ("retexture", few, out, "--target", tmp_path / f"{own}.texture", "--method")
        said = (f"{own}.texture", f"fitted by {own}, not {other}", "leave --method out")
        assert_refused(command(*words, other), 4, *said)
        assert not out.exists()
        assert command(*words, own, "--steps", 2)[0] == 0
        out.unlink()


@pytest.mark.parametrize("difference", ["sizes", "weights", "missing"])
def test_a_texture_of_another_network_is_refused(
    texture: FittedTexture, few: Path, tmp_path: Path, command: Command, difference: str, models: Path
) -> None:
    words = ["fitted with another network", str(models / "denoiser.onnx"), "fit it again"]
    if difference == "sizes":
        texture = replace(texture, architecture={"features": 5})
    elif difference == "weights":
        texture = replace(texture, weights=np.tile(texture.weights, 2))
    else:
        os.environ[FOLDER_VARIABLE] = str(tmp_path / "nowhere")
        words = [str(tmp_path / "nowhere" / "denoiser.json"), "install detangled again"]
    save_texture(texture, tmp_path / "other.texture")
    refused = command("retexture", few, tmp_path / "o.abc", "--target", tmp_path / "other.texture")
    assert_refused(refused, 4, *words)
    assert not (tmp_path / "o.abc").exists()


def roots(groom: Groom) -> NDArray[np.float32]:
    return (groom.points / groom.unit_cm).astype(np.float32)[groom.offsets[:-1]]


def test_a_groom_gets_the_texture_of_a_trained_network(few: Path, tmp_path: Path, command: Command) -> None:
    words = ("--target", COILY, "--method", FINETUNE)
    for name, options in {"1": ("--threads", 1), "2": ("--threads", 2), "other": ("--seed", 1)}.items():
        code, said = command("retexture", few, tmp_path / f"{name}.abc", *words, *options)
        assert code == 0, said
        assert "texture of 6 strands" in said
    assert (tmp_path / "1.abc").read_bytes() == (tmp_path / "2.abc").read_bytes()
    old, new, other = read(few), read(tmp_path / "1.abc"), read(tmp_path / "other.abc")
    assert (new.strand_count, new.unit_cm, new.up, new.objects) == (old.strand_count, old.unit_cm, old.up, old.objects)
    np.testing.assert_array_equal(roots(new), roots(old))
    assert new.attributes.keys() == old.attributes.keys() == {"uv", "width", "groom_id", "groom_group_id"}
    for name in ("uv", "groom_id", "groom_group_id"):
        np.testing.assert_array_equal(new.attributes[name].values, old.attributes[name].values)
    assert len(new.attributes["width"].values) == len(new.points)
    guides = style_guides(old)
    for s in range(old.strand_count):
        guide = np.ascontiguousarray(guides.points[old.offsets[s] : old.offsets[s + 1]])
        end = spline_slopes(chord_lengths(guide), guide)[-1]
        beyond = (new.strand(s)[-1] - guide[-1]) @ end / np.linalg.norm(end)
        assert abs(beyond) < LENGTH_ACCURACY * guides.lengths[s]
        # Other hair, not the same hair turned about its axis: distances within a strand differ.
        near, far = (np.linalg.norm(g.strand(s)[8:60] - g.strand(s)[:52], axis=1) for g in (new, other))
        assert np.abs(far / near - 1.0).mean() > 0.02


def test_strands_are_the_networks_and_depend_on_its_weights(
    texture: FittedTexture, few: Path, tmp_path: Path, command: Command
) -> None:
    grooms = []
    for k, one in enumerate([texture, replace(texture, weights=WEIGHTS), fit(read(COILY, unit="cm"))]):
        save_texture(one, tmp_path / f"{k}.texture")
        assert command("retexture", few, tmp_path / f"{k}.npz", "--target", tmp_path / f"{k}.texture")[0] == 0
        grooms.append((tmp_path / f"{k}.npz").read_bytes())
    assert len(set(grooms)) == 3


def straight(length: float = 30.0, points: int = 20, at: float = 0.0) -> Floats:
    """A straight strand [cm]."""
    return np.stack([np.full(points, at), -np.linspace(0, length, points), np.zeros(points)], axis=1)


def coil(radius: float = 0.3, pitch: float = 0.4, turns: int = 20, at: float = 5.0) -> Floats:
    """A helix [cm]."""
    angle = np.linspace(0, 2 * np.pi * turns, 20 * turns + 1)
    return np.stack([at + radius * np.cos(angle), -pitch * angle / (2 * np.pi), radius * np.sin(angle)], axis=1)


TARGETS = {
    "a coil": [coil()],
    "a straight strand": [straight()],
    "two points": [straight(points=2)],
    "two coils": [coil(), coil(0.25, at=8.0)],
    "a straight strand and a coil": [straight(), coil()],
    "a coil, two points and a short hair": [coil(), straight(points=2), straight(0.4, 3, 9.0)],
}


@pytest.mark.parametrize("method", ["patches", "finetune"])
@pytest.mark.parametrize("name", list(TARGETS))
def test_one_two_and_wildly_different_targets(
    few: Path, tmp_path: Path, command: Command, name: str, method: str
) -> None:
    write(Groom.from_strands(TARGETS[name], unit_source="file"), tmp_path / "target.npz")
    words = ("retexture", few, tmp_path / "o.abc", "--target", tmp_path / "target.npz", "--method", method)
    code, said = command(*words)
    assert code == 0, said
    assert f"texture of {len(TARGETS[name])} strand" in said
    assert warnings_in(said) == []
    old, new = read(few), read(tmp_path / "o.abc")
    np.testing.assert_array_equal(roots(new), roots(old))
    assert np.isfinite(new.points).all()
    # No strand flies off.
    reach = np.linalg.norm(new.points[new.offsets[1:] - 1] - new.points[new.offsets[:-1]], axis=1)
    assert np.all(reach < 1.5 * old.polyline_lengths())


NO_TORCH = """
import sys

class Nothing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "onnx"):
            raise ImportError(f"{name} is not for the runtime")

sys.meta_path.insert(0, Nothing())
from detangled_cli.main import detangled

fitted, made = sys.argv[3], sys.argv[4]
words = [["fit", sys.argv[1], fitted, "--method", "finetune"], ["retexture", sys.argv[2], made, "--target", fitted]]
codes = [detangled.main(line, standalone_mode=False) or 0 for line in words]
sys.exit(10 * max(codes) + 5 * ("torch" in sys.modules or "onnx" in sys.modules))
"""


def test_all_of_it_runs_where_torch_cannot_be_imported(
    few: Path, models: Path, tmp_path: Path, texture: FittedTexture
) -> None:
    made = tmp_path / "o.abc"
    done = subprocess.run(
        [sys.executable, "-c", NO_TORCH, str(COILY), str(few), str(tmp_path / "a.texture"), str(made)],
        env={**os.environ, FOLDER_VARIABLE: str(models)},
        capture_output=True,
        text=True,
        timeout=240.0,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal(load_texture(tmp_path / "a.texture").weights, texture.weights)
    np.testing.assert_array_equal(roots(read(made)), roots(read(few)))
