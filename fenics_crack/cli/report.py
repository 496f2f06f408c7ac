"""Commands ``plot`` and ``report``: pictures of results, and an HTML page.

The page has pictures, errors and verdicts in words. Nothing is solved again: pictures and words
follow from the files of the results, their scenes and their meshes. The page holds the pictures
themselves, and all words are escaped.
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

LISTED_TABLES = (
    "geometry", "structure", "material", "damping", "crack", "cracks", "contact", "rotation",
    "excitation", "loads", "base", "growth",
)  # fmt: skip
"""Tables of a scene whose keys are listed above its text."""
DATE_FORMAT = "%d %B %Y, %H:%M %Z"


def plot_results(arguments: Namespace, _: None, console: Console) -> None:
    """Draw results, several curves in one picture, or a scene's mesh, on rank 0."""
    path, labels = arguments.results[0], arguments.label
    is_scene = path.suffix.lower() == ".toml"
    folder = arguments.output or (Path("output") / path.stem if is_scene else path.parent)
    if path.is_dir():
        folder = arguments.output or path
    make_writable(folder, console.comm)

    def work() -> list[str]:
        if is_scene and len(arguments.results) == 1 and not labels:
            return [str(draw_scene(Scene.load(path), folder, kind=console.pictures))]
        result_files, note = _read_result_files(arguments.results)
        if not path.is_dir() and (len(result_files) > 1 or labels):
            return [str(_draw_curves(result_files, labels, folder, console.pictures))]
        pictures = Drawn(folder, console.pictures, meshes=True)
        for file in result_files:
            draw(result_of(file), pictures)
        return [*map(str, pictures.files), *dict.fromkeys(pictures.notes), note]

    with console.stage("pictures"):
        lines = on_root(console.comm, work)
    console.note(*lines)


def report(arguments: Namespace, _: None, console: Console) -> None:
    """Write the page of some results, on rank 0."""
    path = arguments.results[0]
    target = arguments.output or (path if path.is_dir() else path.parent) / "report.html"
    words = ["fenics-crack", *arguments.words]

    def work() -> str:
        result_files, note = _read_result_files(arguments.results)
        _write_report(result_files, target, words)
        return note

    with console.stage("report"):
        note = on_root(console.comm, work)
    console.note(str(target), note)


def _read_result_files(paths: Sequence[Path]) -> tuple[list[Stored], str]:
    """Read result files and those in folders, without sweeps that are parts of others.

    Returns
    -------
    list of Stored
        All files if there are only parts; structures that commands keep only if there are no other
        files.
    str
        Note that names the files left out; empty without any.

    Raises
    ------
    InputError
        A file cannot be read, or there is no result in a folder.
    """
    result_files: list[Stored] = []
    for path in paths:
        files = sorted(path.glob("*.h5")) if path.is_dir() else [path]
        if not files:
            raise InputError("result", str(path), "a folder with results, .h5 files")
        result_files += map(read, files)
    result_files = [file for file in result_files if file.kind != KEPT_KIND] or result_files
    whole_files = [file for file in result_files if not is_part(file)]
    part_paths = (
        ", ".join(str(file.path) for file in result_files if is_part(file)) if whole_files else ""
    )
    return (
        whole_files or result_files,
        f"left out, as parts of other results: {part_paths}" if part_paths else "",
    )


def _draw_curves(
    result_files: Sequence[Stored], labels: Sequence[str], folder: Path, kind: str
) -> Path:
    """Draw the responses of several curves on the same axes; return the file.

    ``labels`` name the results. Without labels the differences between the scenes name them, or the
    files if two scenes have no difference.

    Raises
    ------
    InputError
        The files are no curves in the same parameter, or the labels are not as many.
    """
    if labels and len(labels) != len(result_files):
        requirement = f"given {len(result_files)} times, once for each result"
        raise InputError("--label", list(labels), requirement)
    paths = [file.path for file in result_files]
    if {file.kind for file in result_files} != {ResponseCurve.KIND}:
        kinds = [file.kind for file in result_files]
        raise InputError("result", kinds, "curves, where several are drawn in one picture")
    runs: list[Any] = [*map(result_of, result_files)]
    names = list(labels) or differences([run.scene for run in runs])
    if len(set(names)) < len(names):
        places = [str(Path(path).with_suffix("")) for path in paths]
        names = [", ".join(filter(None, words)) for words in zip(names, places, strict=True)]
    if len(set(names)) < len(names):
        raise InputError("result", [str(path) for path in paths], "different files")
    if len(parameters := {run.result.parameter for run in runs}) > 1:
        raise InputError("result", sorted(parameters), "curves in one parameter")
    watched_names = {run.watched_name for run in runs}
    title = watched_names.pop() if len(watched_names) == 1 else None
    [panel] = picture = Picture(size=(7.0, 4.6), path=folder / f"overlay_curve.{kind}", title=title)
    for label, run, colour in zip(names, runs, distinct_colours(len(runs)), strict=True):
        look = {"label": label, "colour": colour, "in_hertz": run.scene.in_hertz}
        plot_curve.draw_curve(run.result, run.watched_dof, axes=panel, **look)
    picture.save_with_title()
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
    entries = [(file, result_of(file)) for file in {file.path: file for file in files}.values()]
    entries.sort(key=lambda entry: (order.index(entry[0].kind), entry[1].scene is None))
    scene_results = [result for _, result in entries if result.scene is not None]  # or a record
    scene_differences = iter(
        differences([result.scene.replace({"reduction": None}) for result in scene_results])
    )
    kinds, stems = [file.kind for file, _ in entries], [file.path.stem for file, _ in entries]
    folder = passing_folder()
    page = _describe_scene(scene_results[0], folder) if scene_results else {}
    parts = []
    for number, (file, result) in enumerate(entries):
        part = _describe_result(file, result, folder / str(number)) | {
            "differs": next(scene_differences, "")
        }
        if kinds.count(file.kind) > 1:
            is_repeated = stems.count(file.path.stem) > 1
            part["heading"] += f": {file.path.with_suffix('') if is_repeated else file.path.stem}"
        parts.append(part)
    page |= {
        "title": f"Vibration of {entries[0][0].path.resolve().parent.name}",
        "under": f"{datetime.now(UTC).astimezone():{DATE_FORMAT}}, fenics_crack {VERSION}",
        "parts": parts,
        "doubts": [f"{part['heading']}: {text}" for part in parts for text in part["doubts"]],
        "versions": _versions([file for file, _ in entries]),
        "command": shlex.join(command),
    }
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    write_whole(
        target, environment.from_string(packaged("cli/report.html")).render(page), "--output"
    )


def _describe_result(file: Stored, result: Any, folder: Path) -> dict[str, Any]:
    """Return parts of the page about a result, by the template's names."""
    summary, pictures = report_of(result), Drawn(folder)
    try:
        draw(result, pictures)
    except WriteError:
        raise
    except InputError as error:  # a sweep over words
        pictures.notes.append(f"no picture: {error}")
    file_time = datetime.fromtimestamp(file.path.stat().st_mtime, UTC).astimezone()
    box = (
        "bad" if not summary.done else "doubtful" if summary.missed or summary.warnings else "good"
    )
    tables = summary.tables or {"In numbers": printed(summary)}
    return {
        "heading": KINDS[file.kind].heading,
        "closing": f"{_sentence(summary.closing)}.",
        "box": box,
        "notes": [*map(_sentence, filter(None, (*summary.notes, *dict.fromkeys(pictures.notes))))],
        "doubts": [*map(_sentence, summary.warnings), *map(str, summary.remarks)],  # with keys
        "pictures": [
            _picture(path, words) for path, words in pictures.files.items() if path.exists()
        ],
        "tables": {**tables, **summary.further},
        "path": file.path,
        "written": f"{file_time:{DATE_FORMAT}}",
    }


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _describe_scene(result: Any, folder: Path) -> dict[str, Any]:
    """Return parts of the page about a scene: values, mesh, text."""
    scene, mesh = result.scene, None
    if scene.geometry is not None:
        structure = result.structure.whole if isinstance(result, Run) else None
        mesh = _picture(draw_scene(scene, folder, structure), "The mesh with its named parts.")
    values_by_key = given_values(scene)
    keys = [key for table in LISTED_TABLES for key in values_by_key if key.startswith(f"{table}.")]
    rows: list[tuple[str, object]] = [(key_in_words(k), _value(k, values_by_key[k])) for k in keys]
    if scene.excitation.order is not None:
        rows.append(("load frequency", frequency_in_words(scene, scene.excitation.omega)))
    rows.append(("harmonics", harmonics_in_words(scene)))
    return {"mesh": mesh, "scene": Table(("quantity", "value"), rows), "toml": scene.as_toml()}


def _value(key: str, value: object) -> str:
    """Return a scene's value in words, of a vector with all components."""
    if isinstance(value, list):
        return f"{value} {unit_of(key)}".rstrip()
    return value_in_words(key, value)


def _versions(files: Sequence[Stored]) -> Table:
    """List the versions that made the results, and those that made the page."""
    rows = []
    for file in files:
        file_versions = f"fenics_crack {file.attributes['version']}, {file.attributes['versions']}"
        rows.append((str(file.path), file_versions))
    page_versions = f"Python {platform.python_version()}, {versions()}, h5py {h5py.__version__}"
    rows.append(("this page", f"fenics_crack {VERSION}, {page_versions}"))
    return Table(("file", "made with"), rows)


def _picture(path: Path, words: str) -> dict[str, str]:
    """Return a picture as data for the page, with the sentence below it."""
    data = base64.b64encode(content_of(path, None)).decode("ascii")
    return {"words": words, "data": f"data:image/{path.suffix[1:]};base64,{data}"}
