"""Strands are resized until they read as asked: what is read, how far it goes, and where it ends up."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from detangled.base_texture import Texture
from detangled.fitted import FittedTexture, load_texture, save_texture
from detangled.from_numbers import asked, asked_texture
from detangled.generation import generate
from detangled.geometry.arc import arc_lengths
from detangled.geometry.winding import winding
from detangled.groom import Groom
from detangled.grooming.lengths import Length
from detangled.labeling import label
from detangled.retexturing import Options, retexture
from detangled.settling import BY_EXTENT, BY_LABELS, MOST_RESIZED, MOST_WIDENED, Settling, read
from detangled.texture import arc_of_a_turn, hair_type


def helix(radius: float, wavelength: float, length: float) -> NDArray[np.float64]:
    turns = length / float(arc_of_a_turn(radius, wavelength))
    angle = 2.0 * math.pi * np.linspace(0.0, turns, max(round(24 * turns), 24) + 1)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), -wavelength * angle / (2.0 * math.pi)], axis=1)


def helices(*sizes: tuple[float, float], length: float = 24.0) -> Groom:
    return Groom.from_strands([helix(*size, length) for size in sizes], up="z")


SIZES = [(0.3, 1.0), (0.8, 3.0), (0.2, 0.5)]


@pytest.mark.parametrize("by", [BY_EXTENT, BY_LABELS])
def test_a_helix_reads_as_it_is(by: str) -> None:
    np.testing.assert_allclose(read(helices(*SIZES), by)[0], SIZES, rtol=0.03)


def test_waves_too_weak_for_the_labelers_are_read_by_their_extent() -> None:
    waves = [(0.2, 20.0), (0.45, 9.0)]
    assert np.isnan(read(helices(waves[0]), BY_LABELS)[0]).all()
    np.testing.assert_allclose(read(helices(*waves), BY_EXTENT)[0], waves, rtol=0.06)


@pytest.mark.parametrize("by", [BY_EXTENT, BY_LABELS])
def test_strands_are_resized_to_what_is_wanted_but_not_beyond_reason(by: str) -> None:
    groom, lengths = helices(*SIZES), np.full(3, 24.0)
    sizes, _ = Settling(by, 0.33, 0.9).settle(groom.points, groom.offsets, lengths)
    np.testing.assert_allclose(sizes[0], [1.1, 0.9], rtol=0.03)
    np.testing.assert_array_equal(sizes[1], [1.0 / MOST_RESIZED, 1.0 / MOST_RESIZED])
    np.testing.assert_array_equal(sizes[2], [MOST_RESIZED, MOST_RESIZED])


@pytest.mark.parametrize("steep", [1.05, 3.9, 4.1, 16.0])
def test_a_weak_wave_may_become_far_narrower_but_never_much_shorter(steep: float) -> None:
    radius, wide = 0.2, 0.75
    wavelength = steep * 2.0 * math.pi * radius
    groom = helices((wide, wavelength), length=60.0)
    sizes, _ = Settling(BY_EXTENT, radius, wavelength).settle(groom.points, groom.offsets, np.array([60.0]))
    assert (sizes[0, 0] < 1.0 / MOST_RESIZED) == (steep > MOST_WIDENED)
    if steep > MOST_WIDENED:
        np.testing.assert_allclose(sizes[0], [radius / wide, 1.0], rtol=0.03)
    settled = arc_lengths(groom.points * sizes[0][[0, 0, 1]], groom.offsets)
    assert settled[0] > 60.0 / MOST_RESIZED * (1.0 - 1e-6)


def test_only_what_is_kept_of_a_strand_is_read() -> None:
    upper, lower = helix(0.3, 1.0, 20.0), helix(0.6, 1.0, 20.0)
    below = upper[-1] * [0.0, 0.0, 1.0]
    both = np.concatenate([upper, lower + below])
    offsets = np.array([0, len(both)])
    sizes, _ = Settling(BY_EXTENT, 0.3, 1.0).settle(both, offsets, np.array([19.0]))
    np.testing.assert_allclose(sizes, 1.0, rtol=0.03)


def test_what_is_read_of_a_strand_depends_on_no_others() -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        strands = [np.cumsum(rng.normal(size=(count, 3)), axis=0) for count in rng.integers(64, 700, 6)]
        whole, part = (read(Groom.from_strands(some), BY_EXTENT)[0] for some in (strands, strands[:3]))
        np.testing.assert_array_equal(whole[:3], part)


def test_a_strand_without_curl_is_left_as_it_is() -> None:
    straight = np.stack([np.zeros(50), np.zeros(50), -np.linspace(0.0, 20.0, 50)], axis=1)
    sizes, _ = Settling(BY_LABELS, 0.3, 1.0).settle(straight, np.array([0, 50]), np.array([20.0]))
    np.testing.assert_array_equal(sizes, 1.0)


@pytest.fixture(scope="module")
def coily() -> FittedTexture:
    texture = asked_texture(asked(hair_type("4A")))
    assert isinstance(texture, FittedTexture)
    return texture


def off(texture: Texture, seed: int) -> NDArray[np.float64]:
    """How far each of some strands reads off a texture's numbers, in parts of them, (S, 2)."""
    found = label(generate(texture, 32, 20.0, seed))
    return np.abs(np.stack([found.radius / 0.28, found.wavelength / 0.75], axis=1) - 1.0)


def test_each_strand_reads_nearer_to_what_is_asked(coily: FittedTexture) -> None:
    assert coily.settling is not None
    assert coily.settling.by == BY_LABELS
    settled, drawn = (np.median(off(texture, 2), axis=0) for texture in (coily, replace(coily, settling=None)))
    assert (settled < 0.6 * drawn).all()
    assert (settled < 0.06).all()


def test_strands_that_twist_too_often_or_seldom_are_drawn_anew(coily: FittedTexture) -> None:
    assert coily.settling is not None
    wanted = coily.settling.twist
    assert wanted == asked(hair_type("4A")).twist
    once = replace(coily, settling=replace(coily.settling, twist=None))
    first, anew = (label(generate(texture, 48, 20.0, seed=3)).twist for texture in (once, coily))
    assert np.median(np.abs(anew - wanted)) < 0.8 * np.median(np.abs(first - wanted))
    assert np.mean(anew == first) > 0.2  # those that were right are the same


def test_strands_drawn_anew_depend_on_no_others(coily: FittedTexture) -> None:
    few, more = generate(coily, 5, 14.0, seed=4), generate(coily, 11, 14.0, seed=4)
    np.testing.assert_array_equal(few.points, more.points[: len(few.points)])


@pytest.mark.parametrize("twist", [-0.1, 1.5, math.nan])
def test_a_twist_that_is_none_is_refused(twist: float) -> None:
    with pytest.raises(ValueError, match="twist"):
        Settling(BY_LABELS, 0.3, 1.0, twist)


def test_waves_settle_by_their_extent() -> None:
    texture = asked_texture(asked(hair_type("2B")))
    assert texture.settling is not None
    assert texture.settling.by == BY_EXTENT
    wanted = asked(hair_type("2B"))
    errors = []
    for one in (texture, replace(texture, settling=None)):
        groom = generate(one, 32, 30.0, seed=2)
        radius, _ = winding(groom.points, groom.offsets)
        errors.append(float(np.median(np.abs(radius / wanted.radius.values[0] - 1.0))))
    assert errors[0] < min(0.04, 0.5 * errors[1])


@pytest.mark.parametrize("length", [Length.GUIDE, Length.STRAND])
def test_on_guides_strands_settle_and_keep_their_lengths(coily: FittedTexture, length: Length) -> None:
    straight = [np.stack([np.full(9, x), np.zeros(9), -np.linspace(0.0, 16.0, 9)], axis=1) for x in range(0, 48, 3)]
    groom = Groom.from_strands(straight, up="z")
    made = retexture(groom, coily, Options(length=length)).groom
    found = label(made)
    radius, wavelength = np.median(found.radius), np.median(found.wavelength)
    assert radius == pytest.approx(0.28, rel=0.08)
    assert wavelength == pytest.approx(0.75, rel=0.12)
    if length is Length.GUIDE:
        np.testing.assert_allclose(made.points[made.offsets[1:] - 1, 2], -16.0, atol=0.02)
    else:
        np.testing.assert_allclose(arc_lengths(made.points, made.offsets), 16.0, rtol=1e-3)


def test_a_texture_settles_as_before_when_read_from_its_file(coily: FittedTexture, tmp_path: Path) -> None:
    save_texture(coily, tmp_path / "coily.texture")
    again = load_texture(tmp_path / "coily.texture")
    assert again.settling == coily.settling
    np.testing.assert_array_equal(generate(again, 3, 12.0).points, generate(coily, 3, 12.0).points)
