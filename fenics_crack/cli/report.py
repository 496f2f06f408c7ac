"""Commands ``plot`` and ``report``: pictures of results, and an HTML page.

The page has pictures, errors and verdicts in words. Nothing is solved again: all follows from the
files of the results, with scenes and meshes. The page contains the data of its pictures, and all
words are escaped.
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

from fenics_crack.basics.atomic_files import make_folder_until_exit, write_file_whole
from fenics_crack.basics.errors import InputError, WriteError
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.tables import Table
from fenics_crack.basics.untrusted_files import read_regular_file
from fenics_crack.cli.account import make_printed_table
from fenics_crack.cli.given import Console, PictureFiles, make_writable_folder
from fenics_crack.cli.kinds import RESULT_KIND_BY_NAME, build_report, draw_result, restore_result
from fenics_crack.cli.pictures import draw_scene_mesh
from fenics_crack.cli.scenes import format_harmonic_count
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.draw import plot_curve
from fenics_crack.draw.figure import Picture, distinct_colours
from fenics_crack.files.store import StoredFile, library_versions_text, read_result_file
from fenics_crack.runs.conclusion import frequency_in_words
from fenics_crack.runs.run import Run
from fenics_crack.scene.keys import unit_of_key
from fenics_crack.scene.scene import Scene, file_keys_and_paths
from fenics_crack.scene.words import (
    describe_differences,
    file_value_by_key,
    key_in_words,
    value_in_words,
)
from fenics_crack.study.shelf import STRUCTURE_FILE_KIND
from fenics_crack.sweep.result import has_omitted_options
from fenics_crack.version import VERSION, read_packaged_text

LISTED_SCENE_TABLE_NAMES = (
    "geometry", "structure", "material", "damping", "crack", "cracks", "contact", "rotation",
    "excitation", "loads", "base", "growth",
)  # fmt: skip
"""Scene tables with values listed on the report page, in this order."""
DATE_FORMAT = "%d %B %Y, %H:%M %Z"


def plot_results(arguments: Namespace, _: None, console: Console) -> None:
    """Run the command ``plot``: draw results, a picture of several curves, or a mesh.

    Several files, or a ``--label``, give a single picture of curves; a folder gives the pictures of
    all results inside. Rank 0 draws.
    """
    first_result_path, curve_labels = arguments.results[0], arguments.label
    is_scene_file = first_result_path.suffix.lower() == ".toml"
    picture_folder = arguments.output or (
        Path("output") / first_result_path.stem if is_scene_file else first_result_path.parent
    )
    if first_result_path.is_dir():
        picture_folder = arguments.output or first_result_path
    make_writable_folder(picture_folder, console.comm)

    def draw_pictures() -> list[str]:
        if is_scene_file and len(arguments.results) == 1 and not curve_labels:
            return [
                str(
                    draw_scene_mesh(
                        Scene.load(first_result_path),
                        picture_folder,
                        file_format=console.picture_format,
                    )
                )
            ]
        result_files, exclusion_note = _read_result_files_and_note(arguments.results)
        if not first_result_path.is_dir() and (len(result_files) > 1 or curve_labels):
            return [
                str(
                    _draw_curves_in_one_picture(
                        result_files, curve_labels, picture_folder, console.picture_format
                    )
                )
            ]
        picture_files = PictureFiles(picture_folder, console.picture_format, has_vtk_files=True)
        for stored_file in result_files:
            draw_result(restore_result(stored_file), picture_files)
        return [
            *map(str, picture_files.captions_by_path),
            *dict.fromkeys(picture_files.notes),
            exclusion_note,
        ]

    with console.report_stage("pictures"):
        output_lines = on_root(console.comm, draw_pictures)
    console.print_notes(*output_lines)


def write_report_page(arguments: Namespace, _: None, console: Console) -> None:
    """Run the command ``report``: write an HTML page about results.

    Rank 0 writes the page, by default report.html beside the first result.
    """
    first_result_path = arguments.results[0]
    page_path = (
        arguments.output
        or (first_result_path if first_result_path.is_dir() else first_result_path.parent)
        / "report.html"
    )
    command_words = ["fenics-crack", *arguments.words]

    def write_page() -> str:
        result_files, exclusion_note = _read_result_files_and_note(arguments.results)
        _write_page(result_files, page_path, command_words)
        return exclusion_note

    with console.report_stage("report"):
        exclusion_note = on_root(console.comm, write_page)
    console.print_notes(str(page_path), exclusion_note)


def _read_result_files_and_note(result_paths: Sequence[Path]) -> tuple[list[StoredFile], str]:
    """Read result files, and all .h5 files in result folders.

    Two kinds of files are left out unless nothing else is left: sweeps made as a part of another
    computation, and structures stored for later commands.

    Returns
    -------
    result_files : list of StoredFile
        The files that are not left out.
    exclusion_note : str
        Printed note with the names of sweeps left out; empty if none is.

    Raises
    ------
    InputError
        A file cannot be read, or a folder has no result.
    """
    result_files: list[StoredFile] = []
    for result_path in result_paths:
        file_paths = sorted(result_path.glob("*.h5")) if result_path.is_dir() else [result_path]
        if not file_paths:
            raise InputError("result", str(result_path), "a folder with results (.h5 files)")
        result_files += map(read_result_file, file_paths)
    result_files = [
        stored_file for stored_file in result_files if stored_file.kind != STRUCTURE_FILE_KIND
    ] or result_files
    standalone_result_files = [
        stored_file for stored_file in result_files if not has_omitted_options(stored_file)
    ]
    excluded_paths_text = (
        ", ".join(
            str(stored_file.path)
            for stored_file in result_files
            if has_omitted_options(stored_file)
        )
        if standalone_result_files
        else ""
    )
    return (
        standalone_result_files or result_files,
        f"left out, as they are parts of other results: {excluded_paths_text}"
        if excluded_paths_text
        else "",
    )


def _draw_curves_in_one_picture(
    result_files: Sequence[StoredFile],
    given_labels: Sequence[str],
    picture_folder: Path,
    picture_format: str,
) -> Path:
    """Draw several response curves into a common picture, and return the picture's path.

    Parameters
    ----------
    result_files : sequence of StoredFile
        Files with the curves.
    given_labels : sequence of str
        Labels of the curves. If empty, differences between the scenes are the labels; file names
        are added if two labels are equal.
    picture_folder : Path
        Folder for the picture.
    picture_format : str
        Ending of the picture.

    Raises
    ------
    InputError
        The files are no curves over the same parameter, or the label count is wrong.
    """
    if given_labels and len(given_labels) != len(result_files):
        raise InputError(
            "--label", list(given_labels), f"given {len(result_files)} times, once for each result"
        )
    curve_file_paths = [stored_file.path for stored_file in result_files]
    if {stored_file.kind for stored_file in result_files} != {ResponseCurve.KIND}:
        kind_names = [stored_file.kind for stored_file in result_files]
        raise InputError(
            "result",
            kind_names,
            "response curves, to be drawn in one picture; plot others one by one",
        )
    curve_runs: list[Any] = [*map(restore_result, result_files)]
    curve_labels = list(given_labels) or describe_differences(
        [curve_run.scene for curve_run in curve_runs]
    )
    if len(set(curve_labels)) < len(curve_labels):
        curve_file_path_texts = [
            str(Path(curve_file_path).with_suffix("")) for curve_file_path in curve_file_paths
        ]
        curve_labels = [
            ", ".join(filter(None, label_and_path))
            for label_and_path in zip(curve_labels, curve_file_path_texts, strict=True)
        ]
    if len(set(curve_labels)) < len(curve_labels):
        raise InputError(
            "result",
            [str(curve_file_path) for curve_file_path in curve_file_paths],
            "different files, each once",
        )
    if len(parameter_names := {curve_run.result.parameter for curve_run in curve_runs}) > 1:
        raise InputError(
            "result",
            sorted(parameter_names),
            "curves over the same parameter; plot others one by one",
        )
    watched_names = {curve_run.watched_description for curve_run in curve_runs}
    title = watched_names.pop() if len(watched_names) == 1 else None
    [axes] = overlay_picture = Picture(
        size=(7.0, 4.6), path=picture_folder / f"overlay_curve.{picture_format}", title=title
    )
    for curve_label, curve_run, line_colour in zip(
        curve_labels, curve_runs, distinct_colours(len(curve_runs)), strict=True
    ):
        plot_curve.draw_curve(
            curve_run.result,
            curve_run.watched_dof,
            axes=axes,
            label=curve_label,
            colour=line_colour,
            in_hertz=curve_run.scene.is_frequency_in_hertz,
        )
    overlay_picture.save_with_title()
    return picture_folder / f"overlay_curve.{picture_format}"


# --- the page -------------------------------------------------------------------------------------


def _write_page(
    stored_files: Sequence[StoredFile], page_path: Path, command_words: Sequence[str]
) -> None:
    """Write the HTML page about results.

    Parameters
    ----------
    stored_files : sequence of StoredFile
        Results in any order; the page has the order of :data:`RESULT_KIND_BY_NAME`, each file once.
    page_path : Path
        The .html file.
    command_words : sequence of str
        Command line, printed on the page.

    Raises
    ------
    InputError
        A file is no result of a command, or the page cannot be written.
    """
    if page_path.suffix.lower() not in (".html", ".htm"):
        raise InputError("--output", str(page_path), "a file name that ends in .html")
    from jinja2 import Environment  # which plots do without

    kind_order = list(RESULT_KIND_BY_NAME)
    files_and_results = [
        (stored_file, restore_result(stored_file))
        for stored_file in {stored_file.path: stored_file for stored_file in stored_files}.values()
    ]
    files_and_results.sort(
        key=lambda file_and_result: (
            kind_order.index(file_and_result[0].kind),
            file_and_result[1].scene is None,
        )
    )
    results_with_scene = [
        result for _, result in files_and_results if result.scene is not None
    ]  # tip timing of a measured record has no scene
    scene_difference_texts = iter(
        describe_differences(
            [result.scene.replace({"reduction": None}) for result in results_with_scene]
        )
    )
    kind_names = [stored_file.kind for stored_file, _ in files_and_results]
    result_file_stems = [stored_file.path.stem for stored_file, _ in files_and_results]
    picture_folder = make_folder_until_exit()
    page_fields_of_results = []
    for result_index, (stored_file, result) in enumerate(files_and_results):
        result_fields = _build_result_fields(
            stored_file, result, picture_folder / str(result_index)
        ) | {"differs": next(scene_difference_texts, "")}
        if kind_names.count(stored_file.kind) > 1:
            is_file_stem_repeated = result_file_stems.count(stored_file.path.stem) > 1
            result_fields["heading"] += ": " + (
                str(stored_file.path.with_suffix(""))
                if is_file_stem_repeated
                else stored_file.path.stem
            )
        page_fields_of_results.append(result_fields)
    page_fields = {
        **(
            _build_scene_fields(results_with_scene[0], picture_folder) if results_with_scene else {}
        ),
        "title": f"Vibration of {files_and_results[0][0].path.resolve().parent.name}",
        "under": f"{datetime.now(UTC).astimezone():{DATE_FORMAT}}, fenics_crack {VERSION}",
        "parts": page_fields_of_results,
        "doubts": [
            f"{result_fields['heading']}: {doubt_text}"
            for result_fields in page_fields_of_results
            for doubt_text in result_fields["doubts"]
        ],
        "versions": _tabulate_versions([stored_file for stored_file, _ in files_and_results]),
        "command": shlex.join(command_words),
    }
    template_environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    write_file_whole(
        page_path,
        template_environment.from_string(read_packaged_text("cli/report.html")).render(page_fields),
        "--output",
    )


def _build_result_fields(
    stored_file: StoredFile, result: Any, picture_folder: Path
) -> dict[str, Any]:
    """Draw a result into a folder, and return variables for the report page.

    Returns
    -------
    dict
        Variables of the template report.html: heading, sentences, pictures as data URLs, tables.
        "box" is the colour: "bad" if not converged, "doubtful" with warnings or above the
        tolerance, else "good".
    """
    report, picture_files = build_report(result), PictureFiles(picture_folder)
    try:
        draw_result(result, picture_files)
    except WriteError:
        raise
    except InputError as error:  # for instance, a sweep over text values
        picture_files.notes.append(f"no picture: {error}")
    file_time = datetime.fromtimestamp(stored_file.path.stat().st_mtime, UTC).astimezone()
    box_class = (
        "bad"
        if not report.has_converged
        else "doubtful"
        if report.misses_tolerance or report.warnings
        else "good"
    )
    tables_by_caption = report.html_page_tables or {"In numbers": make_printed_table(report)}
    return {
        "heading": RESULT_KIND_BY_NAME[stored_file.kind].page_heading,
        "closing": f"{_capitalize_sentence(report.closing_sentence)}.",
        "box": box_class,
        "notes": [
            *map(
                _capitalize_sentence,
                filter(None, (*report.notes, *dict.fromkeys(picture_files.notes))),
            )
        ],
        "doubts": [
            *map(_capitalize_sentence, report.warnings),
            *map(str, report.remarks),
        ],  # with keys
        "pictures": [
            _encode_picture(picture_path, caption)
            for picture_path, caption in picture_files.captions_by_path.items()
            if picture_path.exists()
        ],
        "tables": {**tables_by_caption, **report.further_tables},
        "path": stored_file.path,
        "written": f"{file_time:{DATE_FORMAT}}",
    }


def _capitalize_sentence(sentence: str) -> str:
    """Return a sentence with a capital first letter; all other letters stay."""
    return sentence[:1].upper() + sentence[1:]


def _build_scene_fields(result: Any, picture_folder: Path) -> dict[str, Any]:
    """Return variables for the report page about the scene of a result.

    Returns
    -------
    dict
        Variables of the template report.html. "mesh": picture, or None without a mesh. "scene":
        table of keys and values. "toml": the scene's text, with
        names in place of paths.
    """
    scene, mesh_picture = result.scene, None
    if scene.geometry is not None:
        structure = result.structure.whole if isinstance(result, Run) else None
        mesh_picture = _encode_picture(
            draw_scene_mesh(scene, picture_folder, structure), "The mesh with its named parts."
        )
    values_by_key = file_value_by_key(scene)
    scene_keys_to_list = [
        key
        for table_name in LISTED_SCENE_TABLE_NAMES
        for key in values_by_key
        if key.startswith(f"{table_name}.")
    ]
    quantity_rows: list[tuple[str, object]] = [
        (key_in_words(key), _format_value(key, values_by_key[key])) for key in scene_keys_to_list
    ]
    if scene.excitation.order is not None:
        quantity_rows.append(("load frequency", frequency_in_words(scene, scene.excitation.omega)))
    quantity_rows.append(("harmonics", format_harmonic_count(scene)))
    scene_text = scene.as_toml()
    for _, path in file_keys_and_paths(scene):  # of this machine, and no reader's
        scene_text = scene_text.replace(path, Path(path).name)
    return {
        "mesh": mesh_picture,
        "scene": Table(("quantity", "value"), quantity_rows),
        "toml": scene_text,
    }


def _format_value(key: str, value: object) -> str:
    """Return a scene key's value in words with unit; a vector keeps all components."""
    if isinstance(value, list):
        return f"{value} {unit_of_key(key)}".rstrip()
    return value_in_words(key, value)


def _tabulate_versions(stored_files: Sequence[StoredFile]) -> Table:
    """Tabulate the versions of program and libraries, for each file and for the report page.

    For a file, the versions at the time of writing; for the page, the present versions.
    """
    version_rows = []
    for stored_file in stored_files:
        file_versions_text = (
            f"fenics_crack {stored_file.attributes['version']}, "
            f"{stored_file.attributes['versions']}"
        )
        version_rows.append((str(stored_file.path), file_versions_text))
    page_versions_text = (
        f"Python {platform.python_version()}, {library_versions_text()}, h5py {h5py.__version__}"
    )
    version_rows.append(("this page", f"fenics_crack {VERSION}, {page_versions_text}"))
    return Table(("file", "made with"), version_rows)


def _encode_picture(picture_path: Path, caption: str) -> dict[str, str]:
    """Return a picture as variables for the report page.

    The variables are "words", the caption, and "data", the picture's file as data URL.
    """
    base64_text = base64.b64encode(read_regular_file(picture_path, None)).decode("ascii")
    return {"words": caption, "data": f"data:image/{picture_path.suffix[1:]};base64,{base64_text}"}
