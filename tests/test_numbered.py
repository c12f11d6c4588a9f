"""Textures asked of the pretrained network by their numbers: told them, guided to them, or both."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from detangled import draws, engines
from detangled.errors import ModelError, TextureError
from detangled.fitted import METHODS as FITTING
from detangled.from_network import LONGEST_WINDOW, network_texture
from detangled.from_numbers import METHODS as ASKING
from detangled.from_numbers import asked, asked_texture
from detangled.generation import generate
from detangled.geometry.arc import arc_lengths
from detangled.groom import Groom
from detangled.grooming.lengths import Length
from detangled.kernels import set_threads, thread_count
from detangled.labeling import CELLS, label
from detangled.models import FOLDER_VARIABLE
from detangled.numbered import BOTH, CONDITIONED, GUIDED, METHODS, NumberedTexture
from detangled.retexturing import Options, retexture
from detangled.settling import BY_LABELS, Settling
from detangled.shape import Shape
from detangled.texture import hair_type
from detangled_cli import targets
from detangled_cli.main import detangled as command

RADIUS, WAVELENGTH, TWIST = 0.42, 1.25, 0.4  # type VI
LENGTHS = np.array([18.0, 60.0, 9.0, 18.0])


@pytest.fixture(autouse=True, scope="module")
def few_drawn() -> Iterator[None]:
    """A few strands say well enough how far off a texture is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(draws, "DRAWN", 8)
        yield


@pytest.fixture(autouse=True)
def as_many_threads() -> Iterator[None]:
    threads = thread_count()
    yield
    set_threads(threads)


def plain(method: str, **more: object) -> NumberedTexture:
    """Without corrections, which take the most time."""
    return replace(network_texture(RADIUS, WAVELENGTH, TWIST, method, as_drawn=True), **more)


@pytest.fixture(scope="module")
def told() -> NumberedTexture:
    return network_texture(RADIUS, WAVELENGTH, TWIST, CONDITIONED)


def test_strands_read_as_the_network_was_told(told: NumberedTexture) -> None:
    groom = generate(told, 24, 24.0, seed=1)
    np.testing.assert_allclose(arc_lengths(groom.points, groom.offsets), 24.0, rtol=1e-3)
    found = label(groom)
    assert np.median(np.abs(found.radius / RADIUS - 1.0)) < 0.08
    assert np.median(np.abs(found.wavelength / WAVELENGTH - 1.0)) < 0.12
    assert abs(float(np.median(found.twist)) - TWIST) < 0.1


@pytest.mark.parametrize(("name", "wider"), [("radius", 1.4), ("wavelength", 1.5)])
def test_more_of_a_number_makes_more_of_it(name: str, wider: float) -> None:
    texture = plain(CONDITIONED)
    more = replace(texture, **{f"asked_{name}": wider * getattr(texture, f"asked_{name}")})
    sizes = [float(np.median(getattr(label(generate(one, 16, 24.0)), name))) for one in (texture, more)]
    assert 1.0 + 0.5 * (wider - 1.0) < sizes[1] / sizes[0] < 1.5 * wider


@pytest.mark.slow
def test_more_twists_are_told_and_made() -> None:
    found = [
        float(np.median(label(generate(plain(CONDITIONED, asked_twist=twist), 16, 24.0)).twist))
        for twist in (0.05, 0.4, 0.8)
    ]
    assert found[0] + 0.1 < found[1] < found[2] - 0.1


@pytest.mark.parametrize("method", [GUIDED, BOTH])
def test_guided_strands_read_nearer_to_what_is_asked(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    texture = plain(method)
    guided = off(generate(texture, 16, 24.0))
    # The same noise, and the network told the same, but nothing guided.
    monkeypatch.setattr(engines, "_counted", lambda method, step: np.zeros(3, dtype=np.bool_))
    drawn = off(generate(texture, 16, 24.0))
    assert guided < (0.5 if method == GUIDED else 0.9) * drawn


def off(groom: Groom) -> float:
    """How far strands read off the numbers asked for, in the median."""
    found = label(groom)
    away = np.abs(np.log(np.maximum(found.radius, 0.01) / RADIUS)) + np.abs(np.log(found.wavelength / WAVELENGTH))
    return float(np.median(np.nan_to_num(away, nan=3.0)))


@pytest.mark.slow
def test_finite_differences_guide_to_the_same_strands() -> None:
    strands = [
        generate(plain(BOTH, finite_differences=finite), 3, 20.0, seed=4, steps=8).points for finite in (False, True)
    ]
    away = np.linalg.norm(strands[0] - strands[1], axis=1)
    assert 0.0 < np.median(away) < 0.5 * RADIUS


@pytest.mark.parametrize("method", METHODS)
def test_a_strand_is_the_same_in_any_company_and_on_any_number_of_threads(method: str) -> None:
    texture = plain(method, settling=Settling(BY_LABELS, RADIUS, WAVELENGTH))
    set_threads(1)
    whole = generate(texture, len(LENGTHS), LENGTHS, seed=5, steps=3)
    set_threads(2)
    again = generate(texture, 2, LENGTHS[:2], seed=5, steps=3)
    for s in range(2):
        np.testing.assert_array_equal(again.strand(s), whole.strand(s))
    assert np.abs(whole.strand(0) - whole.strand(3)).max() > 0.1


def test_strands_come_with_both_hands(told: NumberedTexture) -> None:
    groom = generate(told, 24, 15.0)
    turned = [
        np.unwrap(np.arctan2(*groom.strand(s)[:, 1::-1].T))[[0, -1]] @ [-1.0, 1.0] for s in range(groom.strand_count)
    ]
    assert 0.2 < np.mean(np.array(turned) > 0.0) < 0.8


def test_grids_are_as_the_network_was_trained() -> None:
    coils, waves = (network_texture(*sizes, 0.1, CONDITIONED, as_drawn=True) for sizes in ((0.2, 0.5), (0.2, 20.0)))
    assert (coils.grid_cells(np.array([0.5, 10.0])) == CELLS).all()
    long = coils.grid_cells(np.array([60.0]))[0]
    assert 16.0 <= long * coils.turn / 60.0 <= 24.0
    # No window is of longer hair than the network has seen.
    cells = waves.grid_cells(np.array([150.0]))[0]
    assert 150.0 * CELLS / cells <= 1.03 * LONGEST_WINDOW


def test_a_groom_is_retextured_and_tapers(told: NumberedTexture) -> None:
    straight = [np.stack([np.full(9, x), np.zeros(9), -np.linspace(0.0, 14.0, 9)], axis=1) for x in (0.0, 3.0, 6.0)]
    groom = Groom.from_strands(straight, up="z")
    made = retexture(groom, told, Options(length=Length.GUIDE)).groom
    np.testing.assert_array_equal(made.points[made.offsets[:-1]], groom.points[groom.offsets[:-1]])
    np.testing.assert_allclose(made.points[made.offsets[1:] - 1, 2], -14.0, atol=0.02)
    found = label(made)
    assert np.median(found.radius) == pytest.approx(RADIUS, rel=0.15)
    tapering = replace(told, shape=Shape((0.7, 0.4, 0.2), (WAVELENGTH,) * 3, RADIUS, WAVELENGTH))
    strands = generate(tapering, 12, 24.0)
    thirds = [np.array_split(np.hypot(*strands.strand(s)[:, :2].T), 3) for s in range(12)]
    upper, lower = (float(np.median([third[k].mean() for third in thirds])) for k in (0, 2))
    assert upper > 1.4 * lower


def test_the_command_offers_the_methods_that_there_are() -> None:
    assert targets.ASKING == ASKING
    assert targets.FITTING == FITTING


def test_an_unknown_method_is_told() -> None:
    with pytest.raises(TextureError, match="no method 'magic': it is one of library, conditioned, guided, both"):
        asked_texture(asked(hair_type("4A")), "magic")


def test_missing_models_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    texture = plain(CONDITIONED)
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    with pytest.raises(ModelError, match=r"denoiser.json: cannot be read"):
        generate(texture, 1, 10.0)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("--target", "a.obj", "--method", "guided"), "go with a type or numbers"),
        (("--target", "a.obj", "--finite-differences"), "go with a type or numbers"),
        (("--type", "4A", "--method", "patches"), "go with --target"),
        (("--type", "4A", "--finite-differences"), "goes with --method guided or both"),
        (("--type", "4A", "--method", "conditioned", "--finite-differences"), "goes with --method guided or both"),
    ],
)
def test_what_does_not_go_together_is_told_in_one_line(tmp_path: Path, given: tuple[str, ...], words: str) -> None:
    done = CliRunner().invoke(command, ["generate", str(tmp_path / "out.npz"), *given])
    assert done.exit_code == 2, done.stderr
    errors = [line for line in done.stderr.splitlines() if "error:" in line]
    assert len(errors) == 1
    assert words in errors[0]
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_command_generates_by_the_network(tmp_path: Path) -> None:
    given = ["--type", "4A", "--method", "conditioned", "--count", "3", "--length", "8cm"]
    done = CliRunner().invoke(command, ["generate", str(tmp_path / "out.npz"), *given])
    assert done.exit_code == 0, done.stderr
    assert (tmp_path / "out.npz").exists()
