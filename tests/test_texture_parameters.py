"""Texture in numbers: the table's types sample as they should, and what people type is understood or explained."""

from __future__ import annotations

import numpy as np
import pytest

from detangled.errors import TextureError
from detangled.labeling import nearest_types
from detangled.texture import (
    HAIR_TYPES,
    LENGTH_LIMITS,
    RADIUS_LIMITS,
    SHARE_LIMITS,
    THINGS,
    WALKER,
    WAVELENGTH_LIMITS,
    Profile,
    Spread,
    TextureParameters,
    arc_of_a_turn,
    hair_type,
    parse_length,
    parse_profile,
)

# The parameters.


def test_parameters_at_their_limits_are_taken() -> None:
    for values in ((0.05, 0.15, 0.0, 20.0, 0.55, 0.0), (3.0, 60.0, 1.0, 180.0, 1.0, 1.0)):
        taken = TextureParameters(*values)
        assert (taken.radius, taken.wavelength, taken.twist) == values[:3]
        assert (taken.thickness, taken.axis_ratio, taken.porosity) == values[3:]


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"radius": 0.01}, ["curl radius of 0.01 cm", "0.05 to 3 cm"]),
        ({"radius": 4.0}, ["did you mean 4mm"]),
        ({"radius": float("nan")}, ["curl radius of nan"]),
        ({"wavelength": 70.0}, ["curl wavelength", "did you mean 70mm"]),
        ({"twist": 1.1}, ["twist prevalence of 1.1", "0 to 1"]),
        ({"twist": -0.1}, ["twist prevalence"]),
        ({"thickness": 0.07}, ["thickness of 0.07 um", "20 to 180 um"]),
        ({"axis_ratio": 0.5}, ["axis ratio of 0.5", "0.55 to 1"]),
        ({"porosity": 2.0}, ["porosity of 2"]),
    ],
)
def test_parameters_beyond_them_are_explained(values: dict[str, float], words: list[str]) -> None:
    with pytest.raises(TextureError) as error:
        TextureParameters(**{"radius": 0.5, "wavelength": 1.0, **values})
    assert all(word in str(error.value) for word in words)


# The types.


def test_a_spread_is_a_normal_distribution_cut_off() -> None:
    spread = Spread(0.2, 0.25, 0.05, 3.0)
    drawn = np.random.default_rng(0).normal(0.2, 0.25, 400_000)
    kept = drawn[(drawn >= 0.05) & (drawn <= 3.0)]
    shares = np.linspace(0.05, 0.95, 7)
    np.testing.assert_allclose(spread.at(shares), np.quantile(kept, shares), atol=0.004)
    assert (spread.at(0.0), spread.at(1.0)) == (0.05, 3.0)


def test_types_are_sampled_within_their_limits_and_near_their_means() -> None:
    limits = np.array([RADIUS_LIMITS, WAVELENGTH_LIMITS, SHARE_LIMITS, LENGTH_LIMITS])
    for kind in HAIR_TYPES:
        drawn = kind.sample(np.random.default_rng(1), 4000)
        assert ((drawn >= limits[:, 0]) & (drawn <= limits[:, 1])).all()
        spreads = (kind.radius, kind.wavelength, kind.twist, kind.length)
        for column, spread in zip(drawn.T, spreads, strict=True):
            assert abs(np.median(column) - spread.mean) < 0.45 * spread.deviation
        np.testing.assert_array_equal(drawn, kind.sample(np.random.default_rng(1), 4000))


def test_types_are_in_order_from_straight_to_coily() -> None:
    assert [kind.name for kind in HAIR_TYPES] == ["I", "II", "III", "IV", "V", "VI", "VII", "VIII"]
    assert all(np.diff([kind.wavelength.mean for kind in HAIR_TYPES]) < 0)
    assert all(np.diff([kind.twist.mean for kind in HAIR_TYPES]) > 0)
    means = [kind.parameters() for kind in HAIR_TYPES]
    assert all(np.diff([arc_of_a_turn(m.radius, m.wavelength) for m in means]) < 0)


# Their names.


@pytest.mark.parametrize("index", range(8))
def test_types_go_by_their_numerals(index: int) -> None:
    numeral = HAIR_TYPES[index].name
    for name in (numeral, numeral.lower(), f" type {numeral} ", f"Hair_Type {numeral}"):
        assert hair_type(name) is HAIR_TYPES[index]


def test_every_letter_of_walkers_and_every_thing_is_known() -> None:
    for letters in WALKER:
        assert letters[0] in hair_type(letters.lower()).walker
    for thing, letters in THINGS.items():
        assert hair_type(thing.upper()) is hair_type(letters)


@pytest.mark.parametrize(
    ("name", "expected"),
    [("1c", "I"), ("2A", "II"), ("2c", "III"), ("3A", "IV"), ("3C", "VI"), ("4a", "VII"), ("4C", "VIII"),
     ("4B", "VII-VIII"), ("vii-viii", "VII-VIII"), ("5", "V"),
     ("8", "VIII"), ("Sidewalk  Chalk", "IV"), ("MARKER", "V"), ("straw", "VI"), ("coffee-stirrer", "VII")],
)  # fmt: skip
def test_names_that_people_know(name: str, expected: str) -> None:
    assert hair_type(name).name == expected


def test_a_letter_in_two_types_is_their_middle() -> None:
    middle = hair_type("4B")
    low, high = HAIR_TYPES[7], HAIR_TYPES[6]
    assert low.radius.mean < middle.radius.mean < high.radius.mean
    assert middle.wavelength.mean**2 == pytest.approx(low.wavelength.mean * high.wavelength.mean)
    middle.parameters()


@pytest.mark.parametrize("name", ["1", "2", "type 3", "4"])
def test_a_bare_number_that_means_two_things_is_refused(name: str) -> None:
    with pytest.raises(TextureError, match=r"of the eight types, or .A to .C: say which"):
        hair_type(name)


@pytest.mark.parametrize(
    ("name", "words"),
    [("4D", ["4D", "4A"]), ("sidewalk chlk", ["sidewalk chalk"]), ("IX", ["did you mean"]), ("", ["I to VIII"]),
     ("rope", ["'rope'"])],
)  # fmt: skip
def test_unknown_names_get_the_nearest_ones(name: str, words: list[str]) -> None:
    with pytest.raises(TextureError) as error:
        hair_type(name)
    assert all(word in str(error.value) for word in words)


# What people type.


@pytest.mark.parametrize(
    ("text", "cm"),
    [("4mm", 0.4), ("0.4cm", 0.4), (" 0.4 ", 0.4), (".4", 0.4), ("4 MM", 0.4), ("0.05in", 0.127), ('1"', 2.54),
     ("2 inches", 5.08), ("0.01m", 1.0), ("5e-1", 0.5), ("3.", 3.0), ("+2cm", 2.0), ("500um", 0.05)],
)  # fmt: skip
def test_lengths_are_read(text: str, cm: float) -> None:
    assert parse_length(text) == pytest.approx(cm)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0,4cm", ["write 0.4cm"]),
        ("4 mmm", ["unit 'mmm'", "did you mean mm"]),
        ("4 parsecs", ["parsecs"]),
        ("", ["4mm, 0.4cm"]),
        ("cm", ["not a length"]),
        ("nan", ["not a length"]),
        ("-1", ["more than zero"]),
        ("0mm", ["more than zero"]),
        ("1e999", ["finite"]),
        ("1cm 2", ["not a length"]),
    ],
)
def test_what_is_no_length_is_explained(text: str, words: list[str]) -> None:
    with pytest.raises(TextureError) as error:
        parse_length(text, "--radius")
    assert "--radius" in str(error.value)
    assert all(word in str(error.value) for word in words)


def test_profiles_run_from_root_to_tip() -> None:
    profile = parse_profile("0.6:0.3")
    np.testing.assert_allclose(profile([0.0, 0.5, 1.0]), [0.6, 0.45, 0.3])
    np.testing.assert_allclose(parse_profile("6mm : 4mm:3mm")(np.array([0.0, 0.25, 0.5, 1.0])), [0.6, 0.5, 0.4, 0.3])
    assert parse_profile("4mm").constant
    assert parse_profile("4mm") == Profile((0.4,))
    assert not profile.constant
    np.testing.assert_allclose(Profile((0.4,))([0.0, 0.7]), 0.4)


@pytest.mark.parametrize("text", ["6:3mm", "0.6:", ":", "0.6:x", "0.6;0.3"])
def test_profiles_that_cannot_be_read_are_refused(text: str) -> None:
    with pytest.raises(TextureError, match="wavelength"):
        parse_profile(text, "wavelength")


def test_the_middle_of_each_type_is_of_that_type() -> None:
    means = np.array([(kind.radius.mean, kind.wavelength.mean, kind.twist.mean) for kind in HAIR_TYPES])
    found = nearest_types(*means.T)
    assert found.dtype == np.int8
    assert found.tolist() == list(range(8))
    assert nearest_types(*np.empty((3, 0))).shape == (0,)


def test_the_nearest_type_is_the_likeliest() -> None:
    """By the normal densities of the types' own spreads, all types alike."""
    from scipy.stats import norm

    rng = np.random.default_rng(5)
    values = np.concatenate([kind.sample(rng, 50)[:, :3] for kind in HAIR_TYPES])
    density = np.zeros((len(values), len(HAIR_TYPES)))
    for k, kind in enumerate(HAIR_TYPES):
        for c, spread in enumerate((kind.radius, kind.wavelength, kind.twist)):
            density[:, k] += norm.logpdf(values[:, c], spread.mean, spread.deviation)
    np.testing.assert_array_equal(nearest_types(*values.T), density.argmax(axis=1))
