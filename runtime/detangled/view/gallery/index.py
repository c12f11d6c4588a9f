"""The gallery's page: the figures that lie in a folder, with their captions, in plain HTML that opens offline.

A figure's PNG holds its own caption, so that a page can be made of figures drawn at different times.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngInfo

from detangled.formats import replacing
from detangled.view.gallery.figure import Drawn, Figure

COLOURS = 256  # of the files: strands on paper need no more
TITLE, CAPTION, MEASURED, PAPER_SAYS, SHORT = KEYS = ("Title", "Caption", "Measured", "Paper", "Short")

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Gallery of detangled</title>
<style>
body {{ margin: 0 auto; max-width: 1240px; padding: 3rem 1.5rem 5rem; background: #fff; color: #222226;
  font: 17px/1.55 "Helvetica Neue", Helvetica, Arial, sans-serif; }}
h1 {{ font-size: 2rem; font-weight: 600; margin: 0 0 .3rem; }}
h2 {{ font-size: 1.25rem; font-weight: 600; margin: 0 0 .8rem; }}
header p, figcaption {{ max-width: 46rem; }}
header p, .said, .short {{ color: #66666c; }}
nav a {{ color: #265cd6; margin-right: 1.1em; text-decoration: none; white-space: nowrap; }}
section {{ margin-top: 3.5rem; border-top: 1px solid #d6d6da; padding-top: 1.6rem; }}
figure {{ margin: 0; }}
img {{ display: block; width: 100%; height: auto; }}
figcaption {{ margin: .8rem auto 0; font-size: 16px; }}
figcaption p {{ margin: 0 0 .5rem; }}
</style>
</head>
<body>
<header>
<h1>Gallery</h1>
<p>Figures after those of Jobalia, Deng, Smith and Fedkiw, <em>Detangled: A Framework for Creating, Editing, and
Inferencing Feature Rich Hair Strands</em>, made by detangled {version} on its own models.</p>
<nav>{links}</nav>
</header>
{figures}
</body>
</html>
"""
_FIGURE = """<section id="{name}">
<h2>{number}. {title}</h2>
<figure>
<a href="{name}.png"><img src="{name}.png" width="{width}" height="{height}" alt="{title}"></a>
<figcaption>
<p>{caption}</p>
{more}</figcaption>
</figure>
</section>
"""


def save_figure(figure: Figure, drawn: Drawn, path: Path) -> None:
    """Write a figure as a PNG that holds its caption. Raises WriteError where it cannot be written."""
    info = PngInfo()
    texts = (figure.title, figure.caption, " ".join(drawn.said), figure.paper, figure.short)
    for key, text in zip(KEYS, texts, strict=True):
        info.add_itxt(key, text)
    image = drawn.image.quantize(COLOURS, dither=Image.Dither.NONE)
    with replacing(path) as beside:
        image.save(beside, format="PNG", optimize=True, pnginfo=info)


def write_index(folder: Path, names: Sequence[str], version: str) -> list[str]:
    """Write index.html of those of the figures that lie in the folder, in the order of ``names``, which are returned.

    Raises WriteError where it cannot be written.
    """
    found: list[str] = []
    parts = []
    for name in names:
        read = _read(folder / f"{name}.png")
        if read is None:
            continue
        found.append(name)
        texts, size = read
        more = f'<p class="said">{escape(texts[MEASURED])}</p>\n' if texts[MEASURED] else ""
        after = f"After the paper's figure: {texts[PAPER_SAYS]}."
        more += f'<p class="short">{escape(f"{after} {texts[SHORT]}".strip())}</p>\n'
        parts.append(
            _FIGURE.format(
                name=name,
                number=len(found),
                title=escape(texts[TITLE]),
                caption=escape(texts[CAPTION]),
                width=size[0],
                height=size[1],
                more=more,
            )
        )
    links = "\n".join(f'<a href="#{name}">{name}</a>' for name in found)
    with replacing(folder / "index.html") as beside:
        beside.write_text(_PAGE.format(version=version, links=links, figures="".join(parts)), encoding="utf-8")
    return found


def _read(path: Path) -> tuple[dict[str, str], tuple[int, int]] | None:
    """The texts and the size of a figure; None where there is none, or another picture has its name."""
    try:
        with Image.open(path) as image:
            texts = {key: str(image.info[key]) for key in KEYS}
            return texts, image.size
    except (OSError, KeyError, SyntaxError):  # what Pillow raises of a damaged PNG
        return None
