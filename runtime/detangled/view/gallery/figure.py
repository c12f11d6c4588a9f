"""What a figure of the gallery is, and what it is made with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from PIL import Image

from detangled.groom import Groom
from detangled.head import Head


@dataclass(frozen=True)
class Style:
    """A hairstyle to show textures on. head: what it grows on, where there is one."""

    name: str
    groom: Groom
    head: Head | None = None


def _ignored(_: int) -> None:
    """Told of progress."""


@dataclass(frozen=True)
class Setting:
    """How figures are made.

    width: of a figure [px]; letters and lines grow with it. strands: of a style at most, thinned evenly. sample:
    strands of a texture that are read. training: steps of a network on two strands. styles: makes four of them.
    progress: told of steps done, of a figure's ``steps``.
    """

    width: int = 2000
    seed: int = 0
    strands: int = 128
    sample: int = 16
    training: int = 300
    styles: Callable[[], tuple[Style, ...]] = tuple
    progress: Callable[[int], object] = field(default=_ignored)

    def px(self, size: float) -> int:
        """Pixels of what is so large in a figure 1600 px wide."""
        return max(1, round(size * self.width / 1600))


@dataclass(frozen=True)
class Drawn:
    """A figure's picture, and what was measured for it: sentences that its caption ends with."""

    image: Image.Image
    said: tuple[str, ...] = ()


@dataclass(frozen=True)
class Figure:
    """A figure of the gallery.

    caption: what it shows. paper: the paper's figure that it answers to. short: in what it does not show what that
    does, empty where it does. steps: that ``draw`` tells of.
    """

    title: str
    caption: str
    paper: str
    short: str
    steps: int
    draw: Callable[[Setting], Drawn]
