"""The labelers' networks: against a closed form, and their gradients against differences."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")


from detangled.labeling import CELLS, LOWER_PART  # noqa: E402
from detangled.texture import HAIR_TYPES, HairType  # noqa: E402
from detangled_training.labeler import (  # noqa: E402
    LOW_PASS_CELLS,
    LOWER_FROM,
    ROUNDED,
    SPREAD,
    UPPER,
    Labeler,
    bends,
    gaussian_matrix,
    in_canonical_space,
    undisturbed,
)
from detangled_training.labeler_export import (  # noqa: E402
    random_signals,
    stacked,
    with_gradient,
    with_world,
)
from tiny_labeler_network import TINY, tiny_labeler  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")

LOW_PASS = gaussian_matrix(CELLS, LOW_PASS_CELLS)
FLOAT32 = 1e-5  # of sums of some hundred numbers about one, relative


def untrained(factor: float = 1.0) -> Labeler:
    """Labelers as training begins, but for a factor on the torsion, the same for every strand."""
    torch.manual_seed(0)
    network = Labeler(TINY).eval().requires_grad_(False)
    network.helix.tau_factor[-1].bias.fill_(math.log(factor))
    return network


def helix_signals(radius: float, wavelength: float, turns: float = 10.0, hand: float = 1.0) -> Any:
    """The signal (1, CELLS, 3) of an untwisted helix, by the helix equations."""
    per_radian = wavelength / (2.0 * math.pi)
    total = radius**2 + per_radian**2
    values = torch.empty(1, CELLS, 3)
    values[:, :, 0], values[:, :, 1] = radius / total, hand * per_radian / total
    values[:, :, 2] = turns * 2.0 * math.pi * math.sqrt(total)
    return values


def signals(count: int, seed: int) -> Any:
    """Signals (B, CELLS, 5) of strands that lie otherwise in the world."""
    return torch.from_numpy(with_world(count, seed))


MIRRORED = torch.tensor([1.0, -1.0, 1.0, 1.0, -1.0])


# ---- what needs no network


@pytest.mark.parametrize("hand", [1.0, -1.0])
@pytest.mark.parametrize("kind", HAIR_TYPES, ids=lambda kind: kind.name)
def test_an_untwisted_helix_gives_its_radius_and_wavelength_back(kind: HairType, hand: float) -> None:
    radius, wavelength = kind.radius.mean, kind.wavelength.mean
    given = helix_signals(radius, wavelength, hand=hand)
    found = untrained()(given)
    # The torsion is kept from zero by a little of the curvature, which counts only where it is all there is.
    kappa, tau = float(given[0, 0, 0]), abs(float(given[0, 0, 1]))
    floor = math.hypot(1.0, 0.02 * kappa / tau)
    assert float(found.kappa) == pytest.approx(kappa, rel=FLOAT32)
    assert float(found.tau) == pytest.approx(floor * tau, rel=FLOAT32)
    assert float(found.radius) == pytest.approx(radius, rel=2e-3)
    assert float(found.wavelength) == pytest.approx(wavelength, rel=2e-3)
    assert float(found.radius) == pytest.approx(kappa / (kappa**2 + (floor * tau) ** 2), rel=FLOAT32)


@pytest.mark.parametrize("factor", [0.5, 1.0, 1.7])
def test_the_network_says_a_factor_on_the_torsion(factor: float) -> None:
    given = helix_signals(0.42, 1.25)
    kappa, tau = float(given[0, 0, 0]), factor * math.hypot(float(given[0, 0, 1]), 0.02 * float(given[0, 0, 0]))
    found = untrained(factor)(given)
    assert float(found.tau) == pytest.approx(tau, rel=FLOAT32)
    assert float(found.radius) == pytest.approx(kappa / (kappa**2 + tau**2), rel=FLOAT32)
    assert float(found.wavelength) == pytest.approx(2.0 * math.pi * tau / (kappa**2 + tau**2), rel=FLOAT32)


def test_before_training_torsion_is_the_mean_of_the_cells_that_are_disturbed_least() -> None:
    """Of the lower section, but for a twentieth that a cell above it counts; so training begins at a fair guess."""
    given = in_canonical_space(signals(32, seed=7))
    network = untrained()
    kappa, tau = given[:, :, 0].double(), given[:, :, 1].double()

    def steadiness(x: Any) -> Any:
        off = torch.hypot(x - undisturbed(x, LOW_PASS.double()), ROUNDED * x.abs().mean(dim=1, keepdim=True))
        return SPREAD / (off / off.mean(dim=1, keepdim=True) + SPREAD)

    # As in canonical space, and once more as in the world, where the curvature's twists count as well.
    share = steadiness(tau) * (1.0 + steadiness(kappa))
    share[:, :LOWER_FROM] *= math.exp(UPPER)
    plain = (share * tau).sum(dim=1) / share.sum(dim=1)
    found = network(given)
    wanted = torch.hypot(plain.float(), 0.02 * found.kappa)
    torch.testing.assert_close(found.tau, wanted, rtol=1e-3, atol=0.0)
    # A plain mean of the section is further from where most of the cells are.
    usual = given[:, LOWER_FROM:, 1].median(dim=1).values.abs()
    mean = given[:, LOWER_FROM:, 1].mean(dim=1).abs()
    clear = usual > 0.1 * found.kappa
    assert float((found.tau / usual - 1.0).abs()[clear].median()) < 0.5 * float(
        (mean / usual - 1.0).abs()[clear].median()
    )


@pytest.mark.parametrize("factor", [0.8, 1.3])
def test_the_network_says_a_factor_on_the_curvature(factor: float) -> None:
    given, network = helix_signals(0.42, 1.25), untrained()
    network.helix.kappa_factor[-1].bias.fill_(math.log(factor))
    found = network(given)
    assert float(found.kappa) == pytest.approx(factor * float(given[0, 0, 0]), rel=FLOAT32)
    torch.testing.assert_close(found.tau, untrained()(given).tau)
    torch.testing.assert_close(found.radius, found.kappa / (found.kappa**2 + found.tau**2))


@pytest.mark.parametrize("seen", ["canonical", "world"])
def test_the_network_says_where_curvature_of_the_lower_section_counts(seen: str) -> None:
    """With shares that follow the encoder's tokens the curvature is another mean of one signal, within its range."""
    given, network = signals(16, seed=8), untrained()
    which = ("canonical", "world").index(seen)
    network.helix.share.bias[which] = 100.0  # the other does not count
    plain = network(given)
    network.helix.share.weight[which].normal_(std=3.0)
    found = network(given)
    of = (undisturbed(given[:, :, 0], LOW_PASS), given[:, :, 3])[which][:, LOWER_FROM:]
    assert float((found.kappa / plain.kappa - 1.0).abs().max()) > 1e-3
    assert (found.kappa >= of.min(dim=1).values * (1.0 - FLOAT32)).all()
    assert (found.kappa <= of.max(dim=1).values * (1.0 + FLOAT32)).all()


def test_what_lies_as_in_canonical_space_needs_no_world() -> None:
    network, given = tiny_labeler(), signals(4, seed=9)
    for alone, both in zip(network(given[:, :, :3]), network(in_canonical_space(given)), strict=True):
        torch.testing.assert_close(alone, both, rtol=0.0, atol=0.0)
    assert float((network(given).radius / network(given[:, :, :3]).radius - 1.0).abs().min()) > 1e-3


def test_the_lower_section_is_what_is_read() -> None:
    assert round(LOWER_PART * CELLS) == CELLS - LOWER_FROM
    above, below = helix_signals(0.3, 3.0), helix_signals(0.6, 2.0)
    step = above.clone()
    step[:, CELLS // 3 :] = below[:, CELLS // 3 :]
    network = untrained()
    found, wanted = network(step), network(below)
    # The low frequencies reach a sixteenth of the length across where the strand changes.
    for name in ("kappa", "radius", "wavelength"):
        assert float(getattr(found, name)) == pytest.approx(float(getattr(wanted, name)), rel=0.03), name
    turned = above.clone()
    turned[:, : CELLS // 3] = below[:, : CELLS // 3]
    assert float(network(turned).kappa) == pytest.approx(float(network(above).kappa), rel=0.03)


def test_the_characteristic_curvature_is_the_mean_of_the_low_frequencies_of_the_lower_section() -> None:
    x = torch.rand(3, CELLS) + 0.5
    made = bends(x, LOW_PASS)
    torch.testing.assert_close(made.low, undisturbed(x, LOW_PASS))
    torch.testing.assert_close(made.kappa, made.low[:, LOWER_FROM:].mean(dim=1))
    assert float(bends(torch.zeros(1, CELLS), LOW_PASS).kappa) == pytest.approx(1e-3)


@pytest.mark.parametrize("size", [10.0, -0.9])
def test_the_low_frequencies_hardly_move_where_single_cells_spike(size: float) -> None:
    """A twist is a cell or two; a mean over the section would move by their share, 20 % and more here."""
    rng = np.random.default_rng(4)
    at = torch.linspace(0.0, 1.0, CELLS)
    smooth = (2.0 * (1.0 + 0.3 * at))[None]
    spiked = smooth.clone()
    where = rng.choice(np.arange(CELLS), 12, replace=False)
    spiked[:, where] *= 1.0 + size
    assert float((bends(spiked, LOW_PASS).kappa / bends(smooth, LOW_PASS).kappa - 1.0).abs()) < 0.02
    off = (undisturbed(spiked, LOW_PASS) / undisturbed(smooth, LOW_PASS) - 1.0).abs()
    assert float(off.max()) < 0.06
    plain = spiked[:, LOWER_FROM:].mean() / smooth[:, LOWER_FROM:].mean() - 1.0
    assert float(plain.abs()) > 0.03


def test_cells_that_spike_count_less_and_the_steady_ones_alike() -> None:
    x = torch.full((1, CELLS), 2.0)
    x[0, 100] = 9.0
    weight = bends(x, LOW_PASS).weight[0]
    assert set(torch.topk(-weight, 3).indices.tolist()) == {99, 100, 101}
    assert float(weight[100]) < 0.02
    assert float(weight[130:].min()) > 10.0 * float(weight[100])
    torch.testing.assert_close(weight[130:], weight[130:].mean().expand(CELLS - 130), rtol=0.1, atol=0.0)
    steady = bends(torch.full((1, CELLS), 2.0), LOW_PASS).weight
    torch.testing.assert_close(steady, steady.mean().expand(1, CELLS), rtol=0.01, atol=0.0)


# ---- the networks


@pytest.mark.parametrize("scale", [10.0, 0.1])
def test_hair_ten_times_as_large_has_ten_times_the_radius_and_wavelength(scale: float) -> None:
    """With the twist known: how many twists are natural depends on size, how torsion follows from shape does not."""
    network, given = tiny_labeler(), signals(16, seed=1)
    twist = torch.linspace(0.0, 1.0, 16)
    larger = given * torch.tensor([1.0 / scale, 1.0 / scale, scale, 1.0 / scale, 1.0 / scale])
    found, wanted = network.knowing(larger, twist), network.knowing(given, twist)
    # Up to the least rates, which are of hair and do not scale.
    torch.testing.assert_close(found.radius, scale * wanted.radius, rtol=0.01, atol=0.0)
    torch.testing.assert_close(found.wavelength, scale * wanted.wavelength, rtol=0.01, atol=0.0)


def test_a_mirrored_strand_has_the_same_radius_and_wavelength() -> None:
    network, given = tiny_labeler(), signals(16, seed=2)
    twist = torch.linspace(0.0, 1.0, 16)
    mirrored = given * MIRRORED
    found, wanted = network.knowing(mirrored, twist), network.knowing(given, twist)
    torch.testing.assert_close(found.radius, wanted.radius, rtol=FLOAT32, atol=0.0)
    torch.testing.assert_close(found.wavelength, wanted.wavelength, rtol=FLOAT32, atol=0.0)


@pytest.mark.parametrize("name", ["kappa", "tau", "v", "kappa in the world", "tau in the world"])
def test_twist_is_a_share_and_every_channel_counts(name: str) -> None:
    network, given = tiny_labeler(), signals(8, seed=3)
    twist = network(given).twist
    assert twist.shape == (8,)
    assert float(twist.min()) >= 0.0
    assert float(twist.max()) <= 1.0
    changed = given.clone()
    changed[:, :, ["kappa", "tau", "v", "kappa in the world", "tau in the world"].index(name)] *= 1.5
    assert float((network(changed).twist - twist).abs().max()) > 1e-4


def test_what_is_told_of_a_strand_does_not_depend_on_the_others() -> None:
    network, given = tiny_labeler(), signals(6, seed=4)
    together = torch.stack(network(given))
    alone = torch.cat([torch.stack(network(given[k : k + 1])) for k in range(6)], dim=1)
    torch.testing.assert_close(together, alone, rtol=FLOAT32, atol=1e-6)
    assert torch.isfinite(together).all()


def test_the_torsion_depends_on_the_twist_and_on_what_is_above() -> None:
    network, given = tiny_labeler(), signals(8, seed=5)
    without, with_all = (network.knowing(given, torch.full((8,), twist)).tau for twist in (0.0, 1.0))
    assert float((without / with_all - 1.0).abs().max()) > 1e-3
    above = given.clone()
    above[:, : CELLS // 8] *= torch.tensor([2.0, 1.0, 1.0, 1.0, 1.0])
    assert float((network.knowing(above, torch.zeros(8)).tau / without - 1.0).abs().max()) > 1e-3


# ---- gradients


def test_gradients_in_torch_are_central_differences() -> None:
    network = tiny_labeler().double()
    network.twist.lstm.traceable = True
    given = torch.from_numpy(random_signals(2, 6)).double()
    weights = torch.tensor([[1.0, 0.3, 2.0], [-0.5, 1.0, 1.0]], dtype=torch.float64)
    _, gradient = with_gradient(network, given, weights)
    torch.manual_seed(0)
    for channel in range(3):
        direction = torch.zeros_like(given)
        direction[:, :, channel] = torch.randn(2, CELLS, dtype=torch.float64) * given[:, :, channel]
        step = 1e-6
        sums = [(stacked(network, given + way * step * direction) * weights).sum() for way in (1.0, -1.0)]
        assert float((sums[0] - sums[1]) / (2.0 * step)) == pytest.approx(
            float((gradient * direction).sum()), rel=1e-5, abs=1e-9
        )
