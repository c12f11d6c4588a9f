"""What the labels of a groom come to: as JSON takes it, in a page for a person, and in a line that says what it is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detangled.labeling import Labels, Reading
from detangled.texture import HAIR_TYPES
from detangled_cli.info import UNIT_SOURCES

QUANTILES = {"p10": 0.1, "median": 0.5, "p90": 0.9}

# Why a strand was not read, and what can be done about it.
UNREAD = {
    Reading.UNUSABLE: "not finite, fewer than two distinct points, or longer than 20 m",
    Reading.COARSE: "too few points a turn to tell the curl: export the groom with more points",
}

# What the types are called, by their indices: Walker's groups, of which 3C lies in the same type as 4A.
GROUPS = {"straight": (0,), "wavy": (1, 2), "curly": (3, 4), "coily": (5, 6, 7)}
SMALLEST_GROUP = 0.05  # that is named in a mixture
SMALLEST_TYPE = 0.1  # that a range of types reaches to

# Least and greatest diameter [cm] of what people compare curls with.
DIAMETERS = {
    "a coffee stirrer": (0.3, 0.5),
    "a drinking straw": (0.6, 0.8),
    "a marker": (1.2, 1.6),
    "a stick of sidewalk chalk": (2.0, 2.5),
}
ALIKE = 1.1  # by so much a curl may be beyond a thing's diameter and still be about as wide: nobody sees less

NOISE = "the types' numbers are this project's own estimate, within about x1.5: one type either way is noise"
MOSTLY_TWISTED = 0.5  # from this prevalence on, half of a strand or more does not wind (paper, figure of T_f)
TWISTED = "half or more of these strands' length follows no even curl: radius and wavelength describe the rest"


def summary(labels: Labels) -> dict[str, Any]:
    """The labels of a groom as JSON takes them; lengths in cm, None where there is nothing to measure.

    Radius, wavelength and twist prevalence are those of the strands with curls or waves, ``readings["read"]``; the
    shares of the types are of all that could be read, straight ones too; lengths are of all that have one.
    """
    curled = labels.reading == Reading.READ
    known = labels.kind[labels.kind >= 0]
    counts = np.bincount(known, minlength=len(HAIR_TYPES))
    twist = _spread(labels.twist[curled])
    return {
        "strands": len(labels.reading),
        "readings": {kind.name.lower(): int(np.count_nonzero(labels.reading == kind)) for kind in Reading},
        "radius_cm": _spread(labels.radius[curled]),
        "wavelength_cm": _spread(labels.wavelength[curled]),
        "twist": twist,
        "length_cm": _spread(labels.length),
        "types": {
            hair.name: {
                "walker": hair.walker,
                "strands": int(count),
                "share": float(count / len(known)) if len(known) else None,
            }
            for hair, count in zip(HAIR_TYPES, counts, strict=True)
        },
        "called": called(labels),
        "caveats": [NOISE, *([TWISTED] if twist is not None and twist["median"] >= MOSTLY_TWISTED else [])],
    }


def is_readable(facts: dict[str, Any]) -> bool:
    """Whether any strand could be read; straight ones are."""
    return facts["readings"]["read"] + facts["readings"]["straight"] > 0


def why_unread(facts: dict[str, Any]) -> str:
    """How many strands were not read for each reason, in a line."""
    return "; ".join(_reasons(facts))


def called(labels: Labels) -> str | None:
    """What people call this hair, in a line; None where no strand could be read."""
    known = labels.kind[labels.kind >= 0]
    if not len(known):
        return None
    shares = np.bincount(known, minlength=len(HAIR_TYPES)) / len(known)
    groups = {word: float(sum(shares[k] for k in types)) for word, types in GROUPS.items()}
    word = max(groups, key=groups.__getitem__)
    if groups[word] < 0.5:
        parts = [f"{percent(share)} {name}" for name, share in groups.items() if share >= SMALLEST_GROUP]
        return f"mixed: {', '.join(parts[:-1])} and {parts[-1]}"
    of_group = (labels.reading == Reading.READ) & np.isin(labels.kind, GROUPS[word])
    line = f"{word}: {_named(shares, GROUPS[word])}"
    if word == "straight" or not of_group.any():
        return line
    if word == "wavy":
        return f"{line}, a wave every {size(float(np.nanmedian(labels.wavelength[of_group])))} cm"
    return f"{line}, curls {compared(2.0 * float(np.nanmedian(labels.radius[of_group])))}"


def compared(diameter: float) -> str:
    """What a curl of this diameter [cm] is as wide as."""
    for name, (low, high) in DIAMETERS.items():
        if low <= diameter * ALIKE and diameter <= high * ALIKE:
            return f"about as wide as {name}"
    names = list(DIAMETERS)
    thinner = [name for name, (_, high) in DIAMETERS.items() if high < diameter]
    if not thinner:
        return f"narrower than {names[0]}"
    if len(thinner) == len(names):
        return f"wider than {names[-1]}"
    return f"wider than {thinner[-1]} and narrower than {names[len(thinner)]}"


def as_text(facts: dict[str, Any]) -> str:
    """The facts of ``summary``, the file and its unit, for a person."""
    total, readings = facts["strands"], facts["readings"]
    unread = total - readings["read"] - readings["straight"]
    rows = [
        ("unit", f"{facts['unit']}, {UNIT_SOURCES.get(facts['unit_source'], facts['unit_source'])}"),
        ("strands", f"{total:,}"),
        ("curls, waves", _counted(readings["read"], total)),
        ("straight", _counted(readings["straight"], total)),
        ("not read", _counted(unread, total)),
        *(("", reason) for reason in _reasons(facts)),
    ]
    lines = [facts["file"], *(f"  {name:<14}{text}" for name, text in rows), ""]
    lines.append(f"  {'':<14}{'median':>8}   the middle 80 %")
    for name, key, unit in (
        ("radius", "radius_cm", " cm"),
        ("wavelength", "wavelength_cm", " cm"),
        ("twist", "twist", ""),
        ("length", "length_cm", " cm"),
    ):
        lines.append(f"  {name:<14}{_range(facts[key], unit)}")
    lines += ["", f"  {'type':<6}{'Walker':<12}{'share':>6}"]
    for name, about in facts["types"].items():
        if about["strands"]:
            lines.append(f"  {name:<6}{about['walker']:<12}{percent(about['share']):>6}")
    lines += ["", f"  {facts['called']}", *(f"  ({sentence})" for sentence in facts["caveats"])]
    return "\n".join(lines)


def size(value: float) -> str:
    """A length [cm] with as many digits as say something."""
    return f"{value:.2f}" if value < 10.0 else f"{value:.1f}"


def percent(share: float) -> str:
    """A share in whole percent, in which some is never shown as none, nor most as all."""
    if 0.0 < share < 0.005:
        return "<1 %"
    if 0.995 <= share < 1.0:
        return ">99 %"
    return f"{100.0 * share:.0f} %"


def _reasons(facts: dict[str, Any]) -> list[str]:
    counts = {reason: facts["readings"][kind.name.lower()] for kind, reason in UNREAD.items()}
    return [f"{count:,} {reason}" for reason, count in counts.items() if count]


def _named(shares: NDArray[np.float64], group: tuple[int, ...]) -> str:
    """The types of a group that hair is of, with Walker's letters."""
    main = max(group, key=lambda k: shares[k])
    names = [f"{hair.name} ({hair.walker})" for hair in HAIR_TYPES]
    if shares[main] >= 0.5:
        return f"{'all' if math.isclose(shares[main], 1.0) else 'mostly'} {names[main]}"
    found = [k for k in group if shares[k] >= SMALLEST_TYPE]
    if len(found) < 2:
        return f"most often {names[main]}"
    return f"{HAIR_TYPES[found[0]].name} to {HAIR_TYPES[found[-1]].name}, most often {names[main]}"


def _spread(values: NDArray[np.float64]) -> dict[str, float] | None:
    values = values[np.isfinite(values)]
    if not len(values):
        return None
    return {name: float(np.quantile(values, share)) for name, share in QUANTILES.items()}


def _range(spread: dict[str, float] | None, unit: str) -> str:
    if spread is None:
        return f"{'-':>8}"
    return f"{size(spread['median']):>8}   {size(spread['p10'])} to {size(spread['p90'])}{unit}"


def _counted(count: int, total: int) -> str:
    return f"{count:,} ({percent(count / total)})" if count else "none"
