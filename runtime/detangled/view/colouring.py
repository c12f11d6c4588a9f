"""Colours that mean something: each strand by its radius, wavelength or twist, or one of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from detangled.errors import DetangledError
from detangled.groom import Groom, Scope
from detangled.labeling import label
from detangled.view.lettering import Legend

MEASURES = ("radius", "wavelength", "twist")
CHOICES = (*MEASURES, "guide", "none")
CLOSEST_GUIDES = "groom_closest_guides"  # Unreal's attribute: a strand's guides, the nearest first

# Viridis (Smith and van der Walt, 2015, CC0) at nine places, sRGB: lightness rises evenly, for the colour-blind too.
_VIRIDIS = "440154 472d7b 3b528b 2c728e 21918c 28ae80 5ec962 addc30 fde725"
UNREAD = (0.09, 0.09, 0.09)
BRIGHTNESS = 0.62  # of a colour, so that highlights on it are not lost
SPAN = (2.0, 98.0)  # percentiles at the scale's ends
NARROWEST = 1.25  # ratio of a scale's ends, or all would be noise


def strand_colours(
    grooms: Sequence[Groom], by: str, progress: Callable[[int], object] | None = None
) -> tuple[list[NDArray[np.float64]], Legend]:
    """Linear RGB for each strand, (S, 3) a groom, on one scale for all, and what it means.

    by: ``"radius"``, ``"wavelength"`` or ``"twist"``, as ``detangled.label`` reads them, or ``"guide"``: a colour for
    each closest guide where the groom knows them, else for each object where it has several, else for each strand.
    progress: told how many strands were read. Raises ModelError where the labelers are missing.
    """
    if by == "guide":
        return _by_guide(grooms)
    if by not in MEASURES:
        raise DetangledError(f"strands cannot be coloured by {by!r}: use one of {', '.join(CHOICES)}")
    found = [getattr(label(groom, progress), by) for groom in grooms]
    every = np.concatenate(found)
    # A straight strand has radius 0 and no wavelength: no place on a scale of ratios.
    usable = np.isfinite(every) & ((every > 0.0) | (by == "twist"))
    if by == "twist":
        low, high = 0.0, 1.0
        places = found
    else:
        ends = np.percentile(every[usable], SPAN) if usable.any() else np.array([0.1, 1.0])
        middle, ratio = np.sqrt(ends[0] * ends[1]), max(float(np.sqrt(ends[1] / ends[0])), np.sqrt(NARROWEST))
        low, high = float(middle / ratio), float(middle * ratio)
        with np.errstate(divide="ignore", invalid="ignore"):
            places = [np.log(values / low) / np.log(high / low) for values in found]
    scale = viridis()
    colours = []
    for values, place in zip(found, places, strict=True):
        readable = np.isfinite(values) & np.isfinite(place)
        shown = np.clip(np.where(readable, place, 0.0), 0.0, 1.0)
        colour = np.stack([np.interp(shown, np.linspace(0, 1, len(scale)), scale[:, c]) for c in range(3)], axis=1)
        colours.append(np.where(readable[:, None], BRIGHTNESS * colour, UNREAD))
    return colours, Legend(_title(by, bool((~usable).any())), scale, _ticks(by, low, high))


def viridis() -> NDArray[np.float64]:
    """The scale's colours, (9, 3) linear RGB."""
    coded = np.array([[int(word[k : k + 2], 16) for k in (0, 2, 4)] for word in _VIRIDIS.split()]) / 255.0
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def distinct(numbers: NDArray[np.integer]) -> NDArray[np.float64]:
    """A colour for each number, linear RGB (n, 3); neighbours differ in hue by the golden angle, and in lightness."""
    hue = (numbers * 0.61803398875) % 1.0
    value = 0.55 + 0.4 * ((numbers * 0.7548776662) % 1.0)
    saturation = 0.55 + 0.3 * ((numbers * 0.5698402909) % 1.0)
    waves = np.abs((6.0 * hue[:, None] + np.array([0.0, 4.0, 2.0])) % 6.0 - 3.0) - 1.0
    coded = value[:, None] * (1.0 - saturation[:, None] * (1.0 - np.clip(waves, 0.0, 1.0)))
    return np.asarray(((coded + 0.055) / 1.055) ** 2.4)


def _by_guide(grooms: Sequence[Groom]) -> tuple[list[NDArray[np.float64]], Legend]:
    whats, colours = [], []
    for groom in grooms:
        numbers, what = _guides(groom)
        whats.append(what)
        colours.append(BRIGHTNESS * distinct(numbers))
    different = sorted(set(whats))
    return colours, Legend(f"a colour for each {' or '.join(different)}")


def _guides(groom: Groom) -> tuple[NDArray[np.int64], str]:
    closest = groom.attributes.get(CLOSEST_GUIDES)
    if closest is not None and closest.scope is Scope.STRAND and closest.values.dtype.kind in "iu":
        return closest.values.reshape(groom.strand_count, -1)[:, 0].astype(np.int64), "guide"
    held = groom.attributes.get("object")
    if held is not None and held.scope is Scope.STRAND and len(np.unique(held.values)) > 1:
        return held.values.astype(np.int64), "object"
    return np.arange(groom.strand_count), "strand"


def _title(by: str, some_unread: bool) -> str:
    unit = "" if by == "twist" else " [cm]"
    return f"{by}{unit}" + ("   (grey: straight, or not to be read)" if some_unread and by != "twist" else "")


def _ticks(by: str, low: float, high: float) -> tuple[tuple[float, str], ...]:
    if by == "twist":
        return tuple((place, f"{place:g}") for place in (0.0, 0.25, 0.5, 0.75, 1.0))
    return tuple((place, f"{low * (high / low) ** place:.2g}") for place in (0.0, 0.25, 0.5, 0.75, 1.0))
