"""A report: results with their pictures, their errors and verdicts in words, in one HTML page.

Nothing is solved again: what stands in the page follows from the files of the results, their scenes
and their meshes. Pictures stand in the page itself, and all words are escaped.
"""

from __future__ import annotations

import base64
import html
import platform
import shlex
import tempfile
from argparse import Namespace
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from string import Template

import h5py

from fenics_crack.cli.account import frequency_in_words
from fenics_crack.cli.console import Console
from fenics_crack.cli.pictures import can_be_drawn, draw_result
from fenics_crack.cli.results import HEADINGS, IDENTIFIED, Computed, account_of, result_of
from fenics_crack.cli.scenes import draw_scene, harmonics_in_words
from fenics_crack.errors import InputError
from fenics_crack.files.store import IDENTIFICATION, Stored, read, versions
from fenics_crack.parallel import on_root
from fenics_crack.scene.words import (
    differences,
    given_values,
    key_in_words,
    unit_of,
    value_in_words,
)
from fenics_crack.study.run import Run
from fenics_crack.table import Table
from fenics_crack.version import VERSION, packaged
from fenics_crack.whole import write_whole

__all__ = ["report"]

CAPTIONS = {
    "mesh": "The mesh with its named parts.",
    "modes": "Mode shapes with the crack open. No contact acts in them, so the lips may overlap.",
    "solution_waves": "The displacement that is watched, and the closing of the lips.",
    "solution_spectrum": "Amplitudes of the harmonics. There are enough of them where they have "
    "fallen far.",
    "solution_orbits": "The motion in the phase plane; thick where the lips touch.",
    "solution_contact_map": "Where along the crack and when in the period the lips touch.",
    "solution_breathing_crack": "One period, slowed down and magnified as stated above the plate.",
    "solution_tips": "What opens the tips of the crack, over the period.",
    "curve": "Response. Dashed: unstable; dotted: undecided; faint: large estimated error.",
    "curve_content": "Amplitudes of the lowest harmonics.",
    "curve_multipliers": "The orbit is stable where the largest multiplier is below 1.",
    "growth": "The crack over the cycles; dots are the lengths that were solved.",
    "integration_waves": "The last periods of the motion in time.",
}
"""Below the pictures, by the names of their files; others speak for themselves."""


def report(given: Namespace, _: None, console: Console) -> None:
    """The page of some results, by rank 0."""
    target = given.output or given.results[0].parent / "report.html"
    words = ["fenics-crack", *given.words]
    with console.stage("report"):
        left = on_root(console.comm, lambda: write_report(given.results, target, words))
    console.note(str(target), *(f"{path} is left out: {IDENTIFIED}" for path in left))


IN_SHORT = (
    "geometry", "structure", "material", "damping", "crack", "cracks", "contact", "rotation",
    "excitation", "loads", "base", "growth",
)  # fmt: skip
"""Tables of a scene whose keys stand above its text."""
Section = tuple[str, str, list[str]]
"""Name of a part of the page, which links lead to, its heading, and its blocks of HTML."""


def write_report(paths: Sequence[Path], target: Path, command: Sequence[str]) -> list[Path]:
    """Write the page of some results; return the files that are left out beside others.

    Parameters
    ----------
    paths : sequence of Path
        Files of results with their scenes; the page puts them in the order of :data:`HEADINGS`.
    target : Path
        The .html file.
    command : sequence of str
        The words of the command that asked for it.

    Raises
    ------
    InputError
        A file is no result with a scene, or the page cannot be written.
    """
    if target.suffix.lower() not in (".html", ".htm"):
        raise InputError("--output", str(target), "a .html file")
    stored = [read(path) for path in dict.fromkeys(paths)]
    shown = [file for file in stored if file.kind != IDENTIFICATION] or stored
    both = [(file, result_of(file)) for file in shown]
    both.sort(key=lambda one: list(HEADINGS).index(one[0].kind))
    kinds, scenes = [file.kind for file, _ in both], [result.scene for _, result in both]
    sections: list[Section] = []
    facts: list[str] = []
    doubts: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        scene_part = _scene(both[0][1], Path(folder))
        own = differences([scene.replace({"reduction": None}) for scene in scenes])
        for number, ((file, result), differs) in enumerate(zip(both, own, strict=True), 1):
            found = account_of(result)
            place, heading = Path(folder) / str(number), HEADINGS[file.kind]
            place.mkdir()
            if kinds.count(file.kind) > 1:
                heading += f": {differs or file.path}"
            told = [*found.facts]
            blocks = [paragraph(f"In this result {differs}.", "small")] if differs else []
            doubtful = [f"{text[0].upper()}{text[1:]}" for text in found.warnings]
            blocks += [points(told), points(doubtful, "doubtful")]
            blocks += [paragraph(*found.verdict)] if found.verdict else []
            if can_be_drawn(result):
                blocks += [_picture(path) for path in draw_result(result, place)]
            blocks += [_table(rows, caption) for caption, rows in found.tables.items()]
            blocks.append(paragraph(f"From {file.path}, {_made(file.path)}.", "small"))
            sections.append((f"result-{number}", heading, blocks))
            facts += told[:1]
            doubts += [f"{heading}: {text}" for text in found.warnings]
    short = [points(facts), points(doubts, "doubtful")]
    if not doubts:
        short.append(paragraph("The program warned of nothing.", "good"))
    before: list[Section] = [("short", "In short", short), ("scene", "Scene", scene_part)]
    after = "versions", "Versions", _versions([file for file, _ in both], command)
    stem = both[0][0].path.resolve().parent.name
    under = f"{datetime.now(UTC).astimezone():%d %B %Y, %H:%M %Z}, fenics_crack {VERSION}"
    text = page(f"Breathing crack: {stem}", under, [*before, *sections, after])
    write_whole(target, text, "--output")
    return [file.path for file in stored if file.kind == IDENTIFICATION]


# --- parts ----------------------------------------------------------------------------------------


def _scene(result: Computed, folder: Path) -> list[str]:
    """The scene of a result in short, its mesh if it has one, its text."""
    scene, blocks = result.scene, []
    if scene.geometry is not None:
        own = result.structure.whole if isinstance(result, Run) else None
        blocks += [_picture(mesh) for mesh in draw_scene(scene, folder, own)]
    rows: list[tuple[str, object]] = [
        (key_in_words(key), _value(key, value))
        for table in IN_SHORT
        for key, value in given_values(scene).items()
        if key.startswith(f"{table}.")
    ]
    if scene.excitation.order is not None:
        rows.append(("load frequency", frequency_in_words(scene, scene.excitation.omega)))
    rows.append(("harmonics", harmonics_in_words(scene)))
    blocks.append(_table(Table(("quantity", "value"), rows), "The first result's scene"))
    whole = f"<summary>The whole scene (TOML)</summary><pre>{html.escape(scene.as_toml())}</pre>"
    beside = "\n".join(blocks)  # where there is room
    return [f'<div class="beside">{beside}</div>', f"<details>{whole}</details>"]


def _value(key: str, value: object) -> str:
    """A value in words; of a vector both parts."""
    if isinstance(value, list):
        return f"{value} {unit_of(key)}".rstrip()
    return value_in_words(key, value)


def _versions(files: Sequence[Stored], command: Sequence[str]) -> list[str]:
    """What made the results, and what made the page."""
    rows = []
    for file in files:
        made = f"fenics_crack {file.attributes['version']}, {file.attributes['versions']}"
        rows.append((str(file.path), made))
    drawn = f"Python {platform.python_version()}, {versions()}, h5py {h5py.__version__}"
    rows.append(("this page", f"fenics_crack {VERSION}, {drawn}"))
    return [
        _table(Table(("file", "made with"), rows), "What computed the results"),
        paragraph(f"Command: {shlex.join(command)}"),
    ]


def _made(path: Path) -> str:
    """When a file was written."""
    when = datetime.fromtimestamp(path.stat().st_mtime, UTC).astimezone()
    return f"written on {when:%d %B %Y, %H:%M %Z}"


# --- blocks of HTML -------------------------------------------------------------------------------


def page(title: str, under: str, sections: Sequence[Section]) -> str:
    """A whole page: links to its sections, and these."""
    links = (f'<a href="#{name}">{html.escape(heading)}</a>' for name, heading, _ in sections)
    body = [f"<nav>{' '.join(links)}</nav>"]
    for name, heading, blocks in sections:
        inside = "\n".join([f"<h2>{html.escape(heading)}</h2>", *blocks])
        body.append(f'<section id="{name}">{inside}\n</section>')
    words = {"title": html.escape(title), "under": html.escape(under)}
    return Template(packaged("cli/report.html")).substitute(words, body="\n".join(body))


def paragraph(text: str, kind: str = "") -> str:
    """Some words; ``kind`` is "good", "bad" or "doubtful" for a verdict, "small", or empty."""
    return f'<p class="{kind}">{html.escape(text)}</p>' if kind else f"<p>{html.escape(text)}</p>"


def points(texts: Sequence[str], kind: str = "") -> str:
    """A list of words; empty without any."""
    items = "".join(f"<li>{html.escape(text)}</li>" for text in texts)
    return f'<ul class="{kind}">{items}</ul>' if texts else ""


def _table(rows: Table, caption: str) -> str:
    """A table, of a long one the first rows."""
    return f'<div class="table">{rows.html(caption)}</div>'


def _picture(path: Path) -> str:
    """A picture file with its caption, as it is."""
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    words = html.escape(CAPTIONS.get(path.stem, ""))
    image = f'<img alt="{words}" src="data:image/{path.suffix[1:]};base64,{data}">'
    return f"<figure>{image}<figcaption>{words}</figcaption></figure>"
