"""The commands ``plot`` and ``report``: pictures of results, of several curves in one, and an HTML
page with pictures, errors and verdicts in words.

Nothing is solved again: all of it follows from the files of the results, their scenes and their
meshes. In the page stand the pictures themselves, and all words are escaped.
"""

from __future__ import annotations

import base64
import platform
import shlex
from argparse import Namespace
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py

from fenics_crack.basics.atomic_files import passing_folder, write_whole
from fenics_crack.basics.errors import InputError, WriteError
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.tables import Table
from fenics_crack.basics.untrusted_files import content_of
from fenics_crack.cli.account import printed
from fenics_crack.cli.drawn import Drawn
from fenics_crack.cli.given import Console, make_writable
from fenics_crack.cli.kinds import KINDS, draw, report_of, result_of
from fenics_crack.cli.pictures import draw_scene
from fenics_crack.cli.scenes import harmonics_in_words
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.draw import plot_curve
from fenics_crack.draw.figure import Picture, distinct_colours
from fenics_crack.files.store import Stored, read, versions
from fenics_crack.runs.conclusion import frequency_in_words
from fenics_crack.runs.run import Run
from fenics_crack.scene.scene import Scene, unit_of
from fenics_crack.scene.words import differences, given_values, key_in_words, value_in_words
from fenics_crack.study.shelf import KIND as KEPT_KIND
from fenics_crack.sweep.result import is_part
from fenics_crack.version import VERSION, packaged

IN_SHORT = (
    "geometry", "structure", "material", "damping", "crack", "cracks", "contact", "rotation",
    "excitation", "loads", "base", "growth",
)  # fmt: skip
"""Tables of a scene whose keys are listed above its text."""
WHEN = "%d %B %Y, %H:%M %Z"


def plot_results(given: Namespace, _: None, console: Console) -> None:
    """Pictures of results, of several curves in one, or of a scene's mesh; by rank 0."""
    first, labels = given.results[0], given.label
    is_scene = first.suffix.lower() == ".toml"
    folder = given.output or (Path("output") / first.stem if is_scene else first.parent)
    if first.is_dir():
        folder = given.output or first
    make_writable(folder, console.comm)

    def work() -> list[str]:
        if is_scene and len(given.results) == 1 and not labels:
            return [str(draw_scene(Scene.load(first), folder, kind=console.pictures))]
        stored, left = _results_in(given.results)
        if not first.is_dir() and (len(stored) > 1 or labels):
            return [str(_draw_curves(stored, labels, folder, console.pictures))]
        drawn = Drawn(folder, console.pictures, meshes=True)
        for file in stored:
            draw(result_of(file), drawn)
        return [*map(str, drawn.files), *dict.fromkeys(drawn.notes), left]

    with console.stage("pictures"):
        lines = on_root(console.comm, work)
    console.note(*lines)


def report(given: Namespace, _: None, console: Console) -> None:
    """The page of some results, by rank 0."""
    first = given.results[0]
    target = given.output or (first if first.is_dir() else first.parent) / "report.html"
    words = ["fenics-crack", *given.words]

    def work() -> str:
        stored, left = _results_in(given.results)
        _write_report(stored, target, words)
        return left

    with console.stage("report"):
        left = on_root(console.comm, work)
    console.note(str(target), left)


def _results_in(paths: Sequence[Path]) -> tuple[list[Stored], str]:
    """Results of files and folders, but for sweeps that are parts of other ones among them; and a
    note on these.

    Raises
    ------
    InputError
        A file cannot be read, or there is no result in a folder.
    """
    found: list[Stored] = []
    for path in paths:
        files = sorted(path.glob("*.h5")) if path.is_dir() else [path]
        if not files:
            raise InputError("result", str(path), "a folder with results, .h5 files")
        found += map(read, files)
    found = [file for file in found if file.kind != KEPT_KIND] or found
    whole = [file for file in found if not is_part(file)]
    left = ", ".join(str(file.path) for file in found if is_part(file)) if whole else ""
    return whole or found, f"left out, as parts of other results: {left}" if left else ""


def _draw_curves(stored: Sequence[Stored], labels: Sequence[str], folder: Path, kind: str) -> Path:
    """Draw the responses of several curves on the same axes; return the file.

    ``labels`` name the results; without any they are called by what differs between their scenes,
    and by their files where nothing does.

    Raises
    ------
    InputError
        The files are no curves in the same parameter, or the labels are not as many.
    """
    if labels and len(labels) != len(stored):
        allowed = f"given {len(stored)} times, once for each result"
        raise InputError("--label", list(labels), allowed)
    paths = [file.path for file in stored]
    if {file.kind for file in stored} != {ResponseCurve.KIND}:
        kinds = [file.kind for file in stored]
        raise InputError("result", kinds, "curves, where several are drawn in one picture")
    found: list[Any] = [*map(result_of, stored)]
    names = list(labels) or differences([one.scene for one in found])
    if len(set(names)) < len(names):
        places = [str(Path(path).with_suffix("")) for path in paths]
        names = [", ".join(filter(None, both)) for both in zip(names, places, strict=True)]
    if len(set(names)) < len(names):
        raise InputError("result", [str(path) for path in paths], "different files")
    if len(parameters := {run.result.parameter for run in found}) > 1:
        raise InputError("result", sorted(parameters), "curves in one parameter")
    watched = {run.watched_name for run in found}
    title = watched.pop() if len(watched) == 1 else None
    [panel] = picture = Picture(size=(7.0, 4.6), path=folder / f"overlay_curve.{kind}", title=title)
    for label, run, colour in zip(names, found, distinct_colours(len(found)), strict=True):
        look = {"label": label, "colour": colour, "in_hertz": run.scene.in_hertz}
        plot_curve.draw_curve(run.result, run.watched_dof, axes=panel, **look)
    picture.saved()
    return folder / f"overlay_curve.{kind}"


# --- the page -------------------------------------------------------------------------------------


def _write_report(files: Sequence[Stored], target: Path, command: Sequence[str]) -> None:
    """Write the page of some results.

    Parameters
    ----------
    files : sequence of Stored
        Results with their scenes; the page puts them in the order of :data:`KINDS`.
    target : Path
        The .html file.
    command : sequence of str
        The words of the command that requested it.

    Raises
    ------
    InputError
        A file is no result with a scene, or the page cannot be written.
    """
    if target.suffix.lower() not in (".html", ".htm"):
        raise InputError("--output", str(target), "a .html file")
    from jinja2 import Environment  # which plots do without

    order = list(KINDS)
    both = [(file, result_of(file)) for file in {file.path: file for file in files}.values()]
    both.sort(key=lambda one: (order.index(one[0].kind), one[1].scene is None))
    scened = [result for _, result in both if result.scene is not None]  # or a record
    differs = iter(differences([result.scene.replace({"reduction": None}) for result in scened]))
    kinds, stems = [file.kind for file, _ in both], [file.path.stem for file, _ in both]
    folder = passing_folder()
    page = _scene(scened[0], folder) if scened else {}
    parts = []
    for number, (file, result) in enumerate(both):
        part = _part(file, result, folder / str(number)) | {"differs": next(differs, "")}
        if kinds.count(file.kind) > 1:
            alike = stems.count(file.path.stem) > 1
            part["heading"] += f": {file.path.with_suffix('') if alike else file.path.stem}"
        parts.append(part)
    page |= {
        "title": f"Vibration of {both[0][0].path.resolve().parent.name}",
        "under": f"{datetime.now(UTC).astimezone():{WHEN}}, fenics_crack {VERSION}",
        "parts": parts,
        "doubts": [f"{part['heading']}: {text}" for part in parts for text in part["doubts"]],
        "versions": _versions([file for file, _ in both]),
        "command": shlex.join(command),
    }
    form = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    write_whole(target, form.from_string(packaged("cli/report.html")).render(page), "--output")


def _part(file: Stored, result: Any, folder: Path) -> dict[str, Any]:
    """A result as the page shows it."""
    found, drawn = report_of(result), Drawn(folder)
    try:
        draw(result, drawn)
    except WriteError:
        raise
    except InputError as error:  # a sweep over words
        drawn.notes.append(f"no picture: {error}")
    written = datetime.fromtimestamp(file.path.stat().st_mtime, UTC).astimezone()
    box = "bad" if not found.done else "doubtful" if found.missed or found.warnings else "good"
    tables = found.tables or {"In numbers": printed(found)}
    return {
        "heading": KINDS[file.kind].heading,
        "closing": f"{_sentence(found.closing)}.",
        "box": box,
        "notes": [*map(_sentence, filter(None, (*found.notes, *dict.fromkeys(drawn.notes))))],
        "doubts": [*map(_sentence, found.warnings), *map(str, found.remarks)],  # with keys
        "pictures": [_picture(path, words) for path, words in drawn.files.items() if path.exists()],
        "tables": {**tables, **found.further},
        "path": file.path,
        "written": f"{written:{WHEN}}",
    }


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _scene(result: Any, folder: Path) -> dict[str, Any]:
    """The scene of a result in short, its mesh if it has one, its text."""
    scene, mesh = result.scene, None
    if scene.geometry is not None:
        own = result.structure.whole if isinstance(result, Run) else None
        mesh = _picture(draw_scene(scene, folder, own), "The mesh with its named parts.")
    given = given_values(scene)
    keys = [key for table in IN_SHORT for key in given if key.startswith(f"{table}.")]
    rows: list[tuple[str, object]] = [(key_in_words(k), _value(k, given[k])) for k in keys]
    if scene.excitation.order is not None:
        rows.append(("load frequency", frequency_in_words(scene, scene.excitation.omega)))
    rows.append(("harmonics", harmonics_in_words(scene)))
    return {"mesh": mesh, "scene": Table(("quantity", "value"), rows), "toml": scene.as_toml()}


def _value(key: str, value: object) -> str:
    """A value in words; of a vector both parts."""
    if isinstance(value, list):
        return f"{value} {unit_of(key)}".rstrip()
    return value_in_words(key, value)


def _versions(files: Sequence[Stored]) -> Table:
    """List the versions that made the results, and those that made the page."""
    rows = []
    for file in files:
        made = f"fenics_crack {file.attributes['version']}, {file.attributes['versions']}"
        rows.append((str(file.path), made))
    drawn = f"Python {platform.python_version()}, {versions()}, h5py {h5py.__version__}"
    rows.append(("this page", f"fenics_crack {VERSION}, {drawn}"))
    return Table(("file", "made with"), rows)


def _picture(path: Path, words: str) -> dict[str, str]:
    """A picture file with the sentence below it."""
    data = base64.b64encode(content_of(path, None)).decode("ascii")
    return {"words": words, "data": f"data:image/{path.suffix[1:]};base64,{data}"}
