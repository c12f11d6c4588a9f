"""Values that options take, checked as the command line is read: what is no such value is wrong usage."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from detangled.errors import DetangledError

if TYPE_CHECKING:
    from detangled.texture import HairType, Profile


@contextmanager
def wrong_usage(option: str = "") -> Iterator[None]:
    """Whatever is refused in here is wrong usage, since it stands on the command line and in no file; an option that it
    does not name is named.
    """
    try:
        yield
    except DetangledError as error:
        said = str(error) if option in str(error) else f"{option}: {error}"
        raise click.UsageError(said, click.get_current_context(silent=True)) from error


class Parsed(click.ParamType):
    """What a function makes of a text and the name of its option; what that refuses is wrong usage."""

    def __init__(self, name: str, parse: Callable[[str, str], Any]) -> None:
        self.name = name
        self.parse = parse

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not isinstance(value, str):
            return value
        option = self.name if param is None else param.opts[0]
        with wrong_usage(option):
            return self.parse(value, option)


class FiniteRange(click.FloatRange):
    """A number within bounds; NaN, which compares with none, and infinity are not."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value!r} is no finite number.", param, ctx)
        return number


# Their modules are loaded when a value is given.


def _unit(text: str, _: str) -> str:
    from detangled.units import cm_per_unit

    cm_per_unit(text)
    return text


def _length(text: str, option: str) -> float:
    from detangled.texture import parse_length

    return parse_length(text, option)


def _profile(text: str, option: str) -> Profile:
    from detangled.texture import parse_profile

    return parse_profile(text, option)


def _thickness(text: str, option: str) -> float:
    from detangled.texture import check_thickness

    across = _length(text, option)
    check_thickness(1e4 * across)
    return across


def _hair(text: str, _: str) -> HairType:
    from detangled.texture import hair_type

    return hair_type(text)


def _shares(text: str, option: str) -> Profile:
    from detangled.texture import Profile

    try:
        values = tuple(float(part) for part in text.split(":"))
    except ValueError:
        raise DetangledError(f"{option} {text!r} is no profile: write shares from root to tip, such as 0:1") from None
    if not all(0.0 <= value <= 1.0 for value in values):
        raise DetangledError(f"{option} {text!r} must hold shares from 0 to 1")
    return Profile(values)


def _colour(text: str, _: str) -> tuple[float, float, float]:
    from detangled.view.colours import hair_colour

    return hair_colour(text)


UNIT = Parsed("unit", _unit)  # the unit's name
LENGTH = Parsed("length", _length)  # cm
PROFILE = Parsed("profile", _profile)  # lengths from root to tip, cm
THICKNESS = Parsed("thickness", _thickness)  # of a fibre, cm
HAIR_TYPE = Parsed("hair type", _hair)
SHARES = Parsed("shares", _shares)  # from root to tip
COLOUR = Parsed("colour", _colour)  # linear RGB
SHARE = FiniteRange(0.0, 1.0)
