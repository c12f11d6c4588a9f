"""The labelers that are shipped: what they make of real grooms and of strands that they were not trained on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import detangled
from detangled.labeling import LabelGradient, LabelNetwork, Reading, label
from detangled.models import LABELER, LABELER_GRADIENT, load_labeler
from detangled_training.strands import twist_prevalence
from detangled_training.variants import VariantOptions, make_variants

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
UNSEEN = 4242  # a seed that nothing was trained with
STEP = 5e-5  # of a signal's size: labels bend beyond it, and below it float32 rounds their difference


@pytest.fixture(scope="module")
def strands() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    values, columns = make_variants(0, 320, UNSEEN, VariantOptions(read_share=0.0))
    return values.astype(np.float64), columns


def test_coily_strands_read_as_coily_and_straight_ones_as_straight() -> None:
    groom = detangled.read(EXAMPLES / "coily_strands.obj", unit="cm")
    coily, wound = label(groom), detangled.fit(groom)
    assert (coily.reading == Reading.READ).all()
    assert np.median(coily.radius) == pytest.approx(wound.radius, rel=0.15)
    assert np.median(coily.wavelength) == pytest.approx(wound.wavelength, rel=0.3)
    assert (coily.kind >= 4).mean() > 0.9
    bob = label(detangled.read(EXAMPLES / "bob.abc", unit="m"))
    assert (bob.kind <= 1).mean() > 0.9


@pytest.mark.parametrize(("name", "least", "most"), [("coily_swatch.obj", 4, 7), ("eve.abc", 0, 1), ("bob.abc", 0, 1)])
def test_real_grooms_read_as_what_they_are(grooms: Callable[[str], Path], name: str, least: int, most: int) -> None:
    groom = detangled.read(grooms(name))
    found = label(groom.select(np.arange(0, groom.strand_count, max(1, groom.strand_count // 60))))
    assert ((found.kind >= least) & (found.kind <= most)).mean() > 0.9


@pytest.mark.parametrize(("in_world", "median", "most"), [(True, 0.02, 0.06), (False, 0.05, 0.25)])
def test_unseen_strands_are_read_as_well_as_is_said(
    strands: tuple[np.ndarray, dict[str, np.ndarray]], in_world: bool, median: float, most: float
) -> None:
    """Far better where they are also seen as they lie in the world. most: nine of ten are nearer."""
    values, columns = strands
    seen = np.concatenate([values, columns["world"]], axis=2) if in_world else values
    radius, wavelength, twist = LabelNetwork(load_labeler())(seen).T
    for found, name in ((radius, "radius"), (wavelength, "wavelength")):
        off = np.abs(found / columns[name] - 1)
        assert np.median(off) < median, name
        assert np.quantile(off, 0.9) < most, name
    assert np.abs(twist - twist_prevalence(columns["twists"], columns["length"])).mean() < 0.065


def test_both_models_tell_the_same(strands: tuple[np.ndarray, dict[str, np.ndarray]]) -> None:
    values, _ = strands
    labels, _ = LabelGradient(load_labeler(LABELER_GRADIENT))(values, np.ones((len(values), 3)))
    np.testing.assert_allclose(labels, LabelNetwork(load_labeler(LABELER))(values), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("which", [0, 1, 2])
def test_the_gradient_tells_how_labels_change(strands: tuple[np.ndarray, dict[str, np.ndarray]], which: int) -> None:
    values, _ = strands
    values = values[:64]
    tell = LabelGradient(load_labeler(LABELER_GRADIENT))
    weights = np.zeros((len(values), 3))
    weights[:, which] = 1.0
    _, gradient = tell(values, weights)
    # Along the gradient, each channel in its own size, where the labels change the most.
    size = np.abs(values).mean(axis=1, keepdims=True)
    along = gradient * size**2
    along *= STEP / np.sqrt(((along / size) ** 2).mean(axis=(1, 2), keepdims=True))
    told = (gradient * along).sum(axis=(1, 2))
    ahead, behind = (LabelNetwork(load_labeler())(values + sign * along)[:, which] for sign in (1.0, -1.0))
    found = 0.5 * (ahead - behind)
    off = np.abs(found - told) / np.abs(told)
    assert np.median(off) < 1e-3
    assert np.percentile(off, 90) < 2e-2
