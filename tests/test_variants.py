"""What data sets are made of: the same bytes however they are asked for, and labels that are what the strands are.

Strands as constructed are checked against winding, which counts turns and knows no curvature; hung ones against the
helix they hang from, under weights that must make no difference or a known one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from detangled.geometry.winding import winding
from detangled.groom import offsets_of
from detangled.kernels import set_threads, thread_count
from detangled.texture import HAIR_TYPES, TWISTS_PER_CM, WAVELENGTH_LIMITS, arc_of_a_turn
from detangled_training import variants
from detangled_training.material import Fibres
from detangled_training.signals import margins, straightened
from detangled_training.strands import Recipes, draw_recipes, make_strands
from detangled_training.variants import (
    AXIS_RATIOS,
    FIBRE_COLUMNS,
    FILE_DIGITS,
    NOISE,
    POINTS_PER_TURN,
    THICKNESSES,
    WET_SHEAR,
    WET_YOUNGS,
    Columns,
    VariantOptions,
    _frames,
    _local,
    bent,
    bodies,
    draw_fibres,
    make_variants,
    means_between,
    upright,
)

COUNT = 24
SEED = 1
PLAIN, HUNG = VariantOptions(), VariantOptions(hung=2)
COLUMNS = {
    *("radius", "wavelength", "position", "base", "kind", "twist", "twists", "length", "hand", "turns"),
    *("variant", "stretched", "read", "laid", "points_per_turn", "noise", "world", *FIBRE_COLUMNS),
}
SOMETIMES = {"points_per_turn", "noise", *FIBRE_COLUMNS}  # NaN where nothing was done that they tell of
# Centrelines of twisted and of short strands are off by some percent, winding by a turn's part.
AGREEMENT = 0.05

Made = tuple[NDArray[np.float32], Columns]


@pytest.fixture(autouse=True)
def same_threads() -> Iterator[None]:
    threads = thread_count()
    yield
    set_threads(threads)


@pytest.fixture(scope="module", params=[PLAIN, HUNG], ids=["constructed", "hung"])
def made(request: pytest.FixtureRequest) -> tuple[VariantOptions, Made]:
    """Variants made on one thread."""
    threads = thread_count()
    set_threads(1)
    whole = make_variants(0, COUNT, SEED, request.param)
    set_threads(threads)
    return request.param, whole


@pytest.fixture(scope="module")
def plain() -> Made:
    return make_variants(0, 80, SEED, PLAIN)


@pytest.fixture(scope="module")
def hung() -> Made:
    """Strands of a seed among whose weak waves one is found to bend the other way."""
    return make_variants(0, 60, SEED, VariantOptions(hung=1, read_share=0.0))


def assert_same(one: Made, other: Made) -> None:
    assert one[0].tobytes() == other[0].tobytes()
    assert list(one[1]) == list(other[1])
    for name in one[1]:
        assert one[1][name].dtype == other[1][name].dtype, name
        assert one[1][name].tobytes() == other[1][name].tobytes(), name


def joined(*parts: Made) -> Made:
    return np.concatenate([p[0] for p in parts]), {n: np.concatenate([p[1][n] for p in parts]) for n in parts[0][1]}


# ---- the same bytes


def test_the_same_bytes_of_any_parts_and_threads(made: tuple[VariantOptions, Made]) -> None:
    options, whole = made
    parts = []
    for first, end, threads in ((0, 1, 2), (1, 9, 1), (9, COUNT, 2)):
        set_threads(threads)
        parts.append(make_variants(first, end - first, SEED, options))
    assert_same(joined(*parts), whole)


def test_other_seeds_and_numbers_make_other_strands() -> None:
    one, other, later = (make_variants(first, 4, seed, PLAIN) for first, seed in ((0, 1), (0, 2), (4, 1)))
    for strand in (other, later):
        assert not np.array_equal(one[1]["length"], strand[1]["length"])


def test_the_times_it_is_hung_do_not_change_what_was_before() -> None:
    values, columns = make_variants(0, 8, SEED, HUNG)
    once = make_variants(0, 8, SEED, replace(HUNG, hung=1))
    first = columns["variant"] == 0
    assert_same(once, (values[first], {name: column[first] for name, column in columns.items()}))


def test_fewer_read_strands_leave_the_others_alone(plain: Made) -> None:
    none = make_variants(0, 80, SEED, VariantOptions(read_share=0.0))
    unread = ~plain[1]["read"]
    assert not none[1]["read"].any()
    assert_same(none, (plain[0][unread], {name: column[unread] for name, column in plain[1].items()}))


# ---- columns


def test_columns_are_complete_and_finite(made: tuple[VariantOptions, Made]) -> None:
    options, (values, columns) = made
    assert set(columns) == COLUMNS
    assert (values.dtype, values.shape[1:]) == (np.float32, (options.cells, 3))
    assert np.isfinite(values).all()
    assert (values[:, :, 2] > 0.0).all()
    for name, column in columns.items():
        assert len(column) == len(values), name
        if name not in SOMETIMES:
            assert np.isfinite(column).all(), name
    assert (np.diff(columns["base"]) >= 0).all()
    position = columns["position"]
    assert ((position >= 0.0) & (position <= 1.0 + 1e-12)).all()
    assert (position[:, 1] > position[:, 0]).all()
    # v is per t of the signal: its mean is the arc that the signal covers.
    covered = (position[:, 1] - position[:, 0]) * columns["length"]
    assert np.median(np.abs(values[:, :, 2].mean(axis=1) / covered - 1.0)) < 0.02
    assert set(columns["kind"]) <= set(range(len(HAIR_TYPES)))


def test_fibres_are_told_where_strands_were_hung(made: tuple[VariantOptions, Made]) -> None:
    options, (_, columns) = made
    if not options.hung:
        assert all(np.isnan(columns[name]).all() for name in FIBRE_COLUMNS)
        assert set(columns["variant"]) == {-1}
        assert not columns["stretched"].any()
        return
    limits = (THICKNESSES, AXIS_RATIOS, (0.0, 1.0), WET_YOUNGS, WET_SHEAR)
    for name, (low, high) in zip(FIBRE_COLUMNS, limits, strict=True):
        assert ((columns[name] >= low) & (columns[name] <= high)).all(), name
    assert set(columns["variant"]) == {0, 1}
    for number in np.unique(columns["base"]):
        for variant in (0, 1):
            fibres, _ = draw_fibres(np.array([number]), SEED, variant)
            rows = (columns["base"] == number) & (columns["variant"] == variant)
            for name in FIBRE_COLUMNS:
                np.testing.assert_array_equal(columns[name][rows], getattr(fibres, name)[0])
    pairs = {(number, thickness) for number, thickness in zip(columns["base"], columns["thickness"], strict=True)}
    # Another fibre each time; a strand that one of them lets hang straight is left out then.
    assert 1.5 * len(np.unique(columns["base"])) < len(pairs) <= 2 * len(np.unique(columns["base"]))


def test_all_variants_of_a_strand_share_its_number_and_what_it_was_made_of(made: tuple[VariantOptions, Made]) -> None:
    options, (_, columns) = made
    recipes = draw_recipes(COUNT, SEED)
    left_out = set(range(COUNT)) - set(columns["base"])
    assert set(columns["base"]) <= set(range(COUNT))
    assert len(left_out) <= (0.15 * COUNT if options.hung else 0)
    assert all(recipes.kind[number] <= 1 for number in left_out)  # types I and II alone are pulled straight
    at = columns["base"]
    for name in ("kind", "twist", "length", "hand"):
        np.testing.assert_array_equal(columns[name], getattr(recipes, name)[at])
    np.testing.assert_array_equal(columns["twists"], np.round(TWISTS_PER_CM * recipes.twist * recipes.length)[at])
    times = np.bincount(at)
    assert times.max() <= 4 * max(options.hung, 1)
    unread = ~columns["read"] & ~columns["stretched"]
    times = np.bincount(at[unread], minlength=COUNT)
    assert times.max() == max(options.hung, 1)
    assert (times[recipes.kind > 1] == max(options.hung, 1)).all()


def test_what_was_read_says_how_and_the_rest_says_nothing(made: tuple[VariantOptions, Made]) -> None:
    _, (_, columns) = made
    read = columns["read"]
    assert 0.15 < read.mean() < 0.5
    for name in ("points_per_turn", "noise"):
        assert np.isnan(columns[name][~read]).all()
        assert np.isfinite(columns[name][read]).all()
    per_turn, noise = columns["points_per_turn"][read], columns["noise"][read]
    assert POINTS_PER_TURN[0] <= per_turn.min() < per_turn.max() <= POINTS_PER_TURN[1]
    strands = make_strands(draw_recipes(COUNT, SEED), SEED)
    share = (noise - FILE_DIGITS) / strands.radius[columns["base"][read]]
    assert NOISE[0] * 0.999 <= share.min() < share.max() <= NOISE[1] * 1.001
    # Where there are more turns than cells can hold, the lowest are read.
    np.testing.assert_array_equal(columns["position"][read, 1], 1.0)


def test_a_share_of_strands_is_read_half_of_them_laid_straight() -> None:
    values, columns = make_variants(0, 32, SEED, VariantOptions(read_share=1.0))
    read, laid = columns["read"], columns["laid"]
    assert 20 <= read.sum() <= 32
    assert not laid[~read].any()
    assert 0.2 < laid[read].mean() < 0.8
    # What lies as retextured hair does is in the world what it is in canonical space, but for its style.
    off = np.abs(np.median(columns["world"][:, :, 0], axis=1) / np.median(values[:, :, 0], axis=1) - 1.0)
    curls = read & (columns["kind"] >= 4)
    assert np.median(off[curls & laid]) < 0.5 * np.median(off[curls & ~laid])


def test_the_world_says_what_a_strand_was_made_as(plain: Made) -> None:
    """Between twists a strand is a helix as it was constructed; straightening it has stretched that."""
    values, columns = plain
    curls = (columns["kind"] >= 4) & ~columns["read"]
    off = []
    for signals in (values, columns["world"]):
        lower = signals[curls][:, values.shape[1] // 3 :].astype(np.float64)
        kappa, tau = lower[:, :, 0], np.abs(lower[:, :, 1])
        total = kappa**2 + tau**2
        radius, wavelength = np.median(kappa / total, axis=1), np.median(2.0 * np.pi * tau / total, axis=1)
        of = columns["radius"][curls], columns["wavelength"][curls]
        off.append([np.median(np.abs(x / y - 1.0)) for x, y in zip((radius, wavelength), of, strict=True)])
    assert max(off[1]) < 0.02
    assert max(off[1]) < 0.5 * min(off[0])


def test_a_style_bends_strands_and_keeps_their_arcs() -> None:
    across = np.zeros((200, 3))
    across[:, 0] = np.linspace(0.0, 20.0, 200)
    offsets = np.array([0, 200, 320])
    points = np.concatenate([across, np.linspace([5.0, 1.0, 0.0], [5.0, 1.0, 12.0], 120)])
    style = np.zeros((2, 2, 3))
    style[0, 1, 0], style[1, 0, 0] = 0.1, -0.2  # about y, about x
    out = bent(points, offsets, style)
    for (a, b), rate in zip(pairwise(offsets), (0.1, 0.2), strict=True):
        np.testing.assert_allclose(out[a], points[a], atol=1e-12)
        steps, before = np.diff(out[a:b], axis=0), np.diff(points[a:b], axis=0)
        np.testing.assert_allclose(np.linalg.norm(steps, axis=1), np.linalg.norm(before, axis=1), rtol=1e-9)
        turned = np.arccos(
            np.clip((steps[0] @ steps[-1]) / (np.linalg.norm(steps[0]) * np.linalg.norm(steps[-1])), -1, 1)
        )
        along = np.linalg.norm(before, axis=1).sum() - np.linalg.norm(before[0])
        assert turned == pytest.approx(rate * along, rel=1e-6)
    np.testing.assert_allclose(bent(points, offsets, np.zeros((2, 2, 3))), points, atol=1e-12)
    # A style that would wind hair up is weakened.
    wild = bent(points, offsets, 100.0 * style)
    assert np.isfinite(wild).all()
    first, last = wild[1] - wild[0], wild[199] - wild[198]
    assert np.arccos(first @ last / (np.linalg.norm(first) * np.linalg.norm(last))) == pytest.approx(
        2.0 * np.pi - variants.MOST_BENT, rel=0.02
    )


# ---- labels of strands as constructed


def test_labels_agree_with_winding_in_canonical_space() -> None:
    recipes = replace(draw_recipes(60, 5, kinds=np.tile(np.arange(3, 8), 12)), twist=np.zeros(60))
    strands = make_strands(recipes, 5, margins(recipes))
    canonical = straightened(strands)
    assert canonical.found.all()
    about = variants._unhung(60)
    (_, columns), *_ = variants._both(strands, recipes, None, None, 5, VariantOptions(read_share=0.0), about)
    # The part of each body that its label is of.
    begin, end = columns["position"].T
    begin = end - 2.0 / 3.0 * (end - begin)
    counts = np.diff(canonical.offsets)
    parts = [
        canonical.points[a + round(low * (n - 1)) : a + round(high * (n - 1)) + 1]
        for a, n, low, high in zip(canonical.offsets[:-1], counts, begin, end, strict=True)
    ]
    radius, wavelength = winding(np.concatenate(parts), offsets_of([len(part) for part in parts]))
    for name, counted in (("radius", radius), ("wavelength", wavelength)):
        off = np.abs(counted / columns[name] - 1.0)
        assert np.median(off) < 0.01, name
        assert np.quantile(off, 0.9) < AGREEMENT, name


def test_twists_do_not_change_what_an_untwisted_strand_is_labelled(plain: Made) -> None:
    columns = plain[1]
    recipes = draw_recipes(80, SEED)
    unread = ~columns["read"]
    whole = unread & (columns["position"][:, 0] == 0.0) & (columns["position"][:, 1] == 1.0)
    constant = np.ptp(np.log(recipes.radius), axis=1)[columns["base"]] < 1e-9
    assert (whole & constant).sum() > 20
    np.testing.assert_allclose(
        columns["radius"][whole & constant], recipes.radius[columns["base"][whole & constant], 0], rtol=1e-9
    )
    steady = np.ptp(np.log(recipes.wavelength), axis=1)[columns["base"]] < 1e-9
    np.testing.assert_allclose(
        columns["wavelength"][whole & steady], recipes.wavelength[columns["base"][whole & steady], 0], rtol=1e-9
    )


def test_signals_of_curls_say_their_labels(plain: Made) -> None:
    """By the helix equations of the lower part's median, which a twist here and there leaves alone."""
    values, columns = plain
    curls = (columns["kind"] >= 3) & ~columns["read"] & (columns["twist"] < 0.4)
    lower = values[curls][:, values.shape[1] // 3 :]
    kappa, tau = np.median(lower[:, :, 0], axis=1), np.abs(np.median(lower[:, :, 1], axis=1))
    total = kappa**2 + tau**2
    assert curls.sum() > 10
    assert np.median(np.abs(kappa / total / columns["radius"][curls] - 1.0)) < AGREEMENT
    assert np.median(np.abs(2.0 * np.pi * tau / total / columns["wavelength"][curls] - 1.0)) < 2.0 * AGREEMENT


# ---- labels of hung strands


def coils(kind: int, count: int = 8) -> tuple[Recipes, NDArray[np.int64]]:
    """Helices of a type's means, each of another place on the circle and either hand."""
    hair = HAIR_TYPES[kind]
    length = np.full(count, min(hair.length.mean, 15.0))
    hand, phase = np.tile([1, -1], count)[:count], np.linspace(0.0, 5.0, count)
    return Recipes.asked(hair.radius.mean, hair.wavelength.mean, 0.0, length, hand, phase), np.arange(count)


def with_fibres(fibres: Fibres, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        variants,
        "draw_fibres",
        lambda numbers, seed, variant: (
            Fibres(*(np.broadcast_to(getattr(fibres, name), len(numbers)) for name in FIBRE_COLUMNS)),
            np.zeros(len(numbers)),
        ),
    )


def hung_labels(kind: int, fibres: Fibres, monkeypatch: pytest.MonkeyPatch) -> tuple[Columns, Columns]:
    """Labels of a type's coils as hung with some fibre, and as constructed."""
    recipes, everyone = coils(kind)
    strands = make_strands(recipes, 0, margins(recipes))
    options = VariantOptions(read_share=0.0)
    (_, constructed), *_ = variants._both(strands, recipes, None, None, 0, options, variants._unhung(len(everyone)))
    with_fibres(fibres, monkeypatch)
    rest = next(variants.hung_strands(recipes, 0, 0))
    about = {
        "stretched": np.zeros(len(rest.recipes), dtype=bool),
        "variant": np.zeros(len(rest.recipes), dtype=np.int8),
    }
    ((_, hung),) = variants._both(
        rest.strands, rest.recipes, rest.radius, rest.wavelength, 0, options, about | rest.fibres
    )
    return hung, constructed


STIFF = Fibres(180.0, 1.0, 0.0, 10.0, 10.0)
USUAL = Fibres(70.0, 0.8, 0.5, 1.6, 0.22)
SOFT = Fibres(40.0, 0.6, 1.0, 1.3, 0.15)


@pytest.mark.parametrize("kind", [6, 7])
def test_a_stiff_light_fibre_hangs_as_it_was_constructed(kind: int, monkeypatch: pytest.MonkeyPatch) -> None:
    hung, constructed = hung_labels(kind, STIFF, monkeypatch)
    assert len(hung["radius"]) == len(constructed["radius"])
    for name in ("radius", "wavelength", "turns"):
        np.testing.assert_allclose(hung[name], constructed[name], rtol=0.02, err_msg=name)


@pytest.mark.parametrize("kind", [3, 4, 5, 6])
def test_the_softer_and_heavier_a_fibre_the_longer_and_narrower_it_hangs(
    kind: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    labels = [hung_labels(kind, fibres, monkeypatch)[0] for fibres in (STIFF, USUAL, SOFT)]
    radius, wavelength, turns = (
        [np.median(columns[name]) for columns in labels] for name in ("radius", "wavelength", "turns")
    )
    assert radius[0] > radius[1] > radius[2] > 0.0
    assert wavelength[0] < wavelength[1] < wavelength[2]
    hair = HAIR_TYPES[kind]
    assert wavelength[2] < arc_of_a_turn(hair.radius.mean, hair.wavelength.mean) * 1.5
    # The tip is free to turn, so turns are not kept, but neither do they go.
    np.testing.assert_allclose(turns, turns[0], rtol=0.4)


def test_hair_has_a_radius_and_a_wavelength_above_zero(hung: Made) -> None:
    """Weak waves hang almost straight, and their normals then may be any; a radius is one all the same."""
    columns = hung[1]
    assert (columns["radius"] > 0.0).all(), columns["base"][columns["radius"] <= 0.0]
    assert (columns["wavelength"] > 0.0).all()
    curls = columns["kind"] >= 1
    assert columns["wavelength"][curls].max() < WAVELENGTH_LIMITS[1]


def test_hanging_makes_no_curl_wider_than_it_was(hung: Made) -> None:
    columns = hung[1]
    constructed = make_variants(0, 60, SEED, VariantOptions(read_share=0.0))[1]
    was = dict(zip(constructed["base"], constructed["radius"], strict=True))
    ratio = columns["radius"] / np.array([was[number] for number in columns["base"]])
    curls = columns["kind"] >= 1
    assert np.median(ratio[curls]) < 0.95
    assert ratio[curls].max() < 1.25


def test_a_hung_strand_is_labelled_as_it_hangs_without_twists(monkeypatch: pytest.MonkeyPatch) -> None:
    options = VariantOptions(hung=1, read_share=0.0)
    twisted = make_variants(0, 12, SEED, options)[1]
    monkeypatch.setattr(
        variants,
        "draw_recipes",
        lambda *given, **more: replace(draw_recipes(*given, **more), twist=np.zeros(given[0])),
    )
    plain = make_variants(0, 12, SEED, options)[1]
    assert (twisted["twists"] > 0).any()
    for name in ("radius", "wavelength"):
        labels = [dict(zip(columns["base"], columns[name], strict=True)) for columns in (twisted, plain)]
        assert labels[0] == pytest.approx(labels[1], rel=1e-12), name


def test_of_a_hung_coil_kappa_and_tau_give_radius_and_wavelength_at_each_place() -> None:
    recipes, everyone = coils(5)
    strands = make_strands(recipes, 0)
    radius, wavelength = _local(strands.points, strands.offsets)
    inside = slice(16, -16)  # a spline's ends are known less well
    np.testing.assert_allclose(radius[:, inside], HAIR_TYPES[5].radius.mean, rtol=0.02)
    np.testing.assert_allclose(wavelength[:, inside], HAIR_TYPES[5].wavelength.mean, rtol=0.02)
    rise = np.tile(np.linspace(1.0, 3.0, 256), (len(everyone), 1))
    begin, end = np.full(len(everyone), 0.25), np.full(len(everyone), 0.75)
    found, _ = means_between(rise, np.ones_like(rise), begin, end)
    np.testing.assert_allclose(found, 2.0, rtol=0.01)
    found, _ = means_between(rise, np.ones_like(rise), begin + 0.25, end + 0.25)
    np.testing.assert_allclose(found, 2.5, rtol=0.01)


def test_another_rest_is_kept_only_where_it_is_another(hung: Made) -> None:
    values, columns = hung
    stretched = np.flatnonzero(columns["stretched"])
    assert 0 < len(stretched) < 20
    for row in stretched:
        twin = np.flatnonzero((columns["base"] == columns["base"][row]) & ~columns["stretched"])
        assert len(twin) == 1
        assert np.abs(values[row] - values[twin[0]]).max() > 1e-3
        np.testing.assert_array_equal(columns["thickness"][row], columns["thickness"][twin[0]])


# ---- how strands are prepared


def test_upright_strands_begin_as_their_twins_and_are_as_they_were() -> None:
    recipes = draw_recipes(12, 3)
    strands = make_strands(recipes, 3, margins(recipes))
    twins = make_strands(replace(recipes, twist=np.zeros(12)), 3)
    turned = upright(strands, twins)
    np.testing.assert_allclose(turned.points[turned.body[:, 0]], twins.points[twins.offsets[:-1]], atol=1e-9)
    np.testing.assert_allclose(
        _frames(turned.points, turned.body[:, 0], 1), _frames(twins.points, twins.offsets[:-1], 1), atol=1e-6
    )
    for a, b in pairwise(strands.offsets):
        before, after = strands.points[a:b], turned.points[a:b]
        distance = np.linalg.norm(before - before[0], axis=1)
        np.testing.assert_allclose(np.linalg.norm(after - after[0], axis=1), distance, atol=1e-9)
        e, f = np.diff(before, axis=0), np.diff(after, axis=0)
        volume = [np.einsum("ij,ij->i", np.cross(d[:-2], d[1:-1]), d[2:]) for d in (e, f)]
        np.testing.assert_allclose(volume[1], volume[0], atol=1e-12)


def test_bodies_are_what_lies_between_the_margins() -> None:
    recipes = draw_recipes(6, 3)
    points, offsets = bodies(make_strands(recipes, 3, margins(recipes)))
    lengths = [np.linalg.norm(np.diff(points[a:b], axis=0), axis=1).sum() for a, b in pairwise(offsets)]
    np.testing.assert_allclose(lengths, recipes.length, rtol=6e-3)
    bare = make_strands(recipes, 3)
    np.testing.assert_array_equal(bodies(bare)[0], bare.points)
