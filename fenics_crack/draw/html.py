"""Pages of HTML in one file: words, tables and pictures, and nothing from outside.

A block is a piece of HTML that a function here has made; all words are escaped. Pictures stand in
the page itself, as PNG with a palette of 256 colours, or as the GIF that they are.
"""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path
from string import Template

from PIL import Image

from fenics_crack.table import Table

__all__ = [
    "beside",
    "contents",
    "folded",
    "page",
    "paragraph",
    "picture",
    "points",
    "section",
    "table",
]

RARE_TOO = Image.Quantize.MAXCOVERAGE
"""Keeps the colours of a few points and thin lines."""
WIDE = 1400
"""Pixels of the wider side of a picture in a page, at most."""


def page(title: str, under: str, blocks: Sequence[str]) -> str:
    """A whole page."""
    words = {"title": html.escape(title), "under": html.escape(under)}
    return PAGE.substitute(words, body="\n".join(blocks))


def section(name: str, title: str, blocks: Sequence[str]) -> str:
    """A part of a page with its heading; ``name`` is what :func:`contents` leads to."""
    heading = f"<h2>{html.escape(title)}</h2>"
    return f'<section id="{html.escape(name)}">{heading}\n' + "\n".join(blocks) + "\n</section>"


def contents(titles: dict[str, str]) -> str:
    """Leads to sections: their titles by their names."""
    links = (f'<a href="#{html.escape(n)}">{html.escape(title)}</a>' for n, title in titles.items())
    return "<nav>" + " ".join(links) + "</nav>"


def paragraph(text: str, kind: str = "") -> str:
    """Some words; ``kind`` is "good", "bad" or "doubtful" for a verdict, "small", or empty."""
    return f'<p class="{kind}">{html.escape(text)}</p>' if kind else f"<p>{html.escape(text)}</p>"


def points(texts: Sequence[str], kind: str = "") -> str:
    """A list of words; empty without any."""
    items = "".join(f"<li>{html.escape(text)}</li>" for text in texts)
    return f'<ul class="{kind}">{items}</ul>' if texts else ""


def table(rows: Table, caption: str) -> str:
    """A table, of a long one the first rows."""
    return f'<div class="table">{rows.html(caption)}</div>'


def folded(title: str, text: str) -> str:
    """Text as it is, behind a title that unfolds it."""
    inside = f"<summary>{html.escape(title)}</summary><pre>{html.escape(text)}</pre>"
    return f"<details>{inside}</details>"


def beside(blocks: Sequence[str]) -> str:
    """Blocks next to each other, where there is room."""
    return '<div class="beside">' + "\n".join(blocks) + "</div>"


def picture(path: Path, caption: str) -> str:
    """A picture file with its caption."""
    kind, content = "png", path.read_bytes()
    if path.suffix == ".gif":
        kind = "gif"
    else:
        with Image.open(io.BytesIO(content)) as image:
            shown = image.convert("RGB")
            shown.thumbnail((WIDE, WIDE))
            file = io.BytesIO()
            few = shown.quantize(256, RARE_TOO, dither=Image.Dither.NONE)
            few.save(file, "PNG", optimize=True)
            content = file.getvalue()
    data = base64.b64encode(content).decode("ascii")
    words = html.escape(caption)
    image_tag = f'<img alt="{words}" src="data:image/{kind};base64,{data}">'
    return f"<figure>{image_tag}<figcaption>{words}</figcaption></figure>"


PAGE = Template("""\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
:root { --ink: #1b1f24; --soft: #5c6570; --line: #d8dde3; --blue: #0072b2; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 62rem; padding: 2rem 1.5rem 4rem; color: var(--ink);
  font: 16px/1.5 "DejaVu Sans", "Segoe UI", Helvetica, Arial, sans-serif; background: white; }
h1 { font-size: 1.8rem; margin: 0 0 .2rem; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .8rem; padding-bottom: .3rem;
  border-bottom: 2px solid var(--blue); }
.under, figcaption, caption, .small { color: var(--soft); font-size: .88rem; }
nav { margin: 1rem 0; }
nav a { display: inline-block; margin: 0 .9rem .3rem 0; color: var(--blue); text-decoration: none; }
section { display: flow-root; }
figure { margin: 1rem 0; text-align: center; break-inside: avoid; clear: both; }
img { max-width: min(100%, 46rem); max-height: 42rem; }
.beside { display: flex; flex-wrap: wrap; gap: 0 3rem; align-items: center; }
.beside img { max-height: 30rem; }
figcaption { margin: .2rem auto 0; max-width: 46rem; }
.table { overflow-x: auto; }
table { border-collapse: collapse; margin: 1rem 0; font-size: .82rem;
  font-variant-numeric: tabular-nums; break-inside: avoid; }
caption { text-align: left; padding-bottom: .3rem; }
th, td { padding: .25rem .7rem .25rem 0; text-align: left; border-bottom: 1px solid var(--line); }
td { white-space: nowrap; }
th { border-bottom: 2px solid var(--ink); }
details { margin: 1rem 0; border: 1px solid var(--line); border-radius: 4px; padding: .5rem .9rem; }
summary { cursor: pointer; }
pre { overflow-x: auto; font-size: .82rem; line-height: 1.35; margin: .6rem 0 .2rem; }
.good, .bad, .doubtful { padding: .5rem .9rem; border-left: 5px solid; margin: 1rem 0; }
ul.doubtful { padding-left: 2rem; }
.good { border-color: #009e73; background: #eaf7f2; }
.bad { border-color: #d55e00; background: #fdf0e7; }
.doubtful { border-color: #e0a100; background: #fdf7e3; }
@media print { body { max-width: none; padding: 0; font-size: 11pt; } nav { display: none; }
  h2 { break-after: avoid; } img { max-height: 18cm; } }
</style>
</head>
<body>
<h1>$title</h1>
<p class="under">$under</p>
$body
</body>
</html>
""")
