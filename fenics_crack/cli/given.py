"""Inputs and output of a command, and new scenes.

Inputs are a scene with changes, measurements and arrivals, all read from text. Output goes to a
folder and a console. This module loads NumPy alone, in a tenth of the time of the libraries that
compute.

In the template of a plate, lines for the options of ``new`` end in a mark, as ``(--blade)``. With
the option ``--blade``, a marked comment becomes a line of the scene, and a marked line becomes a
comment. The options make a blade on a rotor, add probes in the casing, or make the crack unknown.
"""

from __future__ import annotations

import itertools
import os
import re
import shlex
import sys
import time
import tomllib
from argparse import Namespace
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fenics_crack.basics.atomic_files import (
    BACKUP_FOLDER_NAME,
    back_up_files,
    make_or_check_results_folder,
    write_file_whole,
)
from fenics_crack.basics.errors import MAX_VALUES_OF_AXIS, InputError, check_count
from fenics_crack.basics.progress import USER_MESSAGE_LOGGER, StageLineHandler, begin_stage
from fenics_crack.basics.tables import RAD_PER_S_PER_RPM, Table, have_equal_numbers
from fenics_crack.basics.untrusted_files import read_regular_file, read_utf8_text
from fenics_crack.scene.scene import Scene
from fenics_crack.version import read_packaged_text

if TYPE_CHECKING:
    from mpi4py import MPI

    from fenics_crack.arrivals.arrival_times import ArrivalTimes
    from fenics_crack.monitoring.identification.measurements import Measurements
    from fenics_crack.study.prepare import Study

    ArrivalSource = Path | dict[int, ArrivalTimes] | None

PLATE_TEMPLATE_PATH = "cli/new_scene.toml"
ARRIVAL_OR_RESULT_FILE_SUFFIXES = (".csv", ".h5")
"""Endings of files with measured arrivals, and of results to compute arrivals from."""
KEPT_STRUCTURE_FILE_NAME = "prepared.h5"
"""Name of the file with a meshed and reduced structure, stored for later commands."""
PERIOD_FRAMES_FOLDER_NAME = "solution_period"
"""Folder for a period's frames for ParaView, inside the results folder."""
RESULT_FILE_ENDINGS = (".h5", ".csv", ".json", ".png", ".pdf", ".svg")
"""Endings of all files belonging to a result."""
COMMANDS_FOR_PREPARED_FILES = ("solve", "curve")
"""Commands that accept a file from ``reduce`` in place of a scene."""
COMBINABLE_NEW_SCENE_OPTIONS = ("blade", "timing", "identify")
"""Options of ``new`` that change the plate's template, also together."""
EXCLUSIVE_NEW_SCENE_OPTIONS = ("solid", "disk")
"""Options of ``new`` with a separate template, not combined with any further option."""


@dataclass(frozen=True)
class CommandInputs:
    """Hold a command's inputs, read from files and options.

    Attributes
    ----------
    scene : Scene
    results_folder : Path
        Folder for results.
    measurements : Measurements or None
        Measurements for ``identify``.
    arrival_source : dict of ArrivalTimes, Path or None
        Blade tip arrivals measured, by blade number. Or the path to a result, to compute arrivals
        from.
    uncracked_arrival_source : dict of ArrivalTimes, Path or None
        The same for the blade before the crack.
    speeds : (n_speeds,) [rad/s] or None
        Speeds of a Campbell diagram; None for any command but ``campbell``.
    prepared_study : Study or None
        Study from a file of ``reduce``. None: the scene must be meshed.
    """

    scene: Scene
    results_folder: Path
    measurements: Measurements | None = None
    arrival_source: ArrivalSource = None
    uncracked_arrival_source: ArrivalSource = None
    speeds: np.ndarray | None = None
    prepared_study: Study | None = None


def read_inputs(arguments: Namespace) -> CommandInputs | None:
    """Read a command's scene, measurements and arrivals from text files.

    Returns None for a command without a scene, such as ``timing`` with a record (.csv).

    Raises
    ------
    InputError
        A file or an option cannot be used.
    """
    is_arrival_record = arguments.command == "timing" and arguments.scene.suffix.lower() == ".csv"
    if "scene" not in arguments or is_arrival_record:
        return None
    changes_by_key = parse_changes(arguments.set)
    try:
        scene = Scene.load(arguments.scene, changes_by_key)
    except InputError as scene_error:
        scene_error.others = tuple(
            _yield_further_errors(scene_error, arguments.scene, changes_by_key)
        )
        raise
    _check_option_numbers(arguments, scene)
    output_path = vars(arguments).get("output")
    if arguments.command == "reduce" and output_path is not None:
        if output_path.suffix.lower() != ".h5":
            raise InputError("--output", str(output_path), "a file name that ends in .h5")
        output_path = output_path.parent
    result_folder = output_path or Path("output") / arguments.scene.stem
    arrival_source = _read_arrivals(scene, arguments, vars(arguments).get("arrivals"))
    if arguments.command != "identify":
        return CommandInputs(
            scene,
            result_folder,
            arrival_source=arrival_source,
            speeds=_find_campbell_speeds_or_none(arguments, scene),
        )
    has_uncracked_record = (
        arguments.before is not None
        and arguments.before.suffix.lower() in ARRIVAL_OR_RESULT_FILE_SUFFIXES
    )
    uncracked_arrival_source = (
        _read_arrivals(scene, arguments, arguments.before) if has_uncracked_record else None
    )
    measurements = _read_measurements(
        arguments, scene, None if has_uncracked_record else arguments.before
    )
    return CommandInputs(
        scene, result_folder, measurements, arrival_source, uncracked_arrival_source
    )


def read_prepared_inputs(arguments: Namespace, comm: MPI.Comm) -> CommandInputs:
    """Read a file written by the command ``reduce`` in place of a scene (collective).

    Raises
    ------
    InputError
        The file cannot be used, or the command or a changed key needs a mesh.
    """
    if arguments.command not in COMMANDS_FOR_PREPARED_FILES:
        raise InputError(
            "scene",
            str(arguments.scene),
            f"a scene (.toml) for the command {arguments.command}; only "
            f"{' and '.join(COMMANDS_FOR_PREPARED_FILES)} take a file of reduce (.h5)",
        )
    from fenics_crack.study.artefact import load_prepared  # the solver

    study = load_prepared(arguments.scene, parse_changes(arguments.set), comm)
    return CommandInputs(
        study.scene, arguments.output or Path("output") / arguments.scene.stem, prepared_study=study
    )


def _yield_further_errors(
    error: InputError, scene_path: Path, changes_by_key: dict[str, Any]
) -> Iterator[InputError]:
    """Yield errors of further keys of a scene, after the first ``error``.

    ``changes_by_key`` are the changes by ``--set``. After each error the scene is corrected and
    read again:

    - A missing key or table, and a wrong number, get the value of the template for new scenes.
    - An unknown key is removed.
    - A wrong word is replaced by the suggestion in the error.

    Once a template's value is in the scene, only missing and unknown keys are reported: errors
    about wrong values may be due to the template. A key that fails again ends the search.
    """
    corrected_values_by_key, reported_keys = {**changes_by_key}, {"scene"}
    suggestions_text, scene_has_no_template_values = "", True
    tables_by_name = {} if error.key == "scene" else tomllib.loads(read_utf8_text(scene_path))
    while error.key not in reported_keys:
        reported_keys.add(error.key)
        table_name, _, key_name = error.key.partition(".")
        suggestion_match = re.search(r"; did you mean (.+)\?$", error.allowed)
        if error.allowed.startswith("left out; "):
            suggestions_text += error.allowed.partition(" known ")[0]
            corrected_values_by_key.pop(error.key, None)
            table_with_key = tables_by_name.get(table_name) if key_name else tables_by_name
            if isinstance(table_with_key, dict):
                table_with_key.pop(key_name or table_name, None)
        else:
            correction_toml_text = (
                find_example_line(error.key, error.allowed)
                if key_name
                else find_example_table_text(table_name)
            )
            correction_toml_text = (
                f"{key_name} = {suggestion_match[1]}" if suggestion_match else correction_toml_text
            )
            with suppress(ValueError):  # no value is meant
                table_with_key = tomllib.loads(correction_toml_text)
                for key, template_value in (
                    table_with_key if key_name else table_with_key.get(table_name, {})
                ).items():
                    if (
                        error.value is None
                        or suggestion_match
                        or not isinstance(template_value, str)
                    ):
                        corrected_values_by_key[f"{table_name}.{key}"] = template_value
            scene_has_no_template_values = (
                scene_has_no_template_values and suggestion_match is not None
            )
        try:
            Scene.from_mapping(tables_by_name, scene_path.parent, corrected_values_by_key)
            return
        except InputError as next_error:
            error = next_error
        is_reportable = (
            scene_has_no_template_values
            or error.value is None
            or error.allowed.startswith("left out; ")
        )
        if (
            is_reportable
            and error.key not in reported_keys
            and f"{error.key}?" not in suggestions_text
        ):
            yield error


def _check_option_numbers(arguments: Namespace, scene: Scene) -> None:
    """Check the numbers of the options --count, --patterns and --deviation.

    Raises InputError unless --count is at least 1 mode, --patterns is 0 to
    :data:`MAX_VALUES_OF_AXIS`, and --deviation is 0 to 0.1.
    """
    if (mode_count := vars(arguments).get("count")) is not None:
        check_count("--count", mode_count, 1)
    if arguments.command == "disk":
        scene.given("disk")
        check_count("--patterns", arguments.patterns, 0, MAX_VALUES_OF_AXIS)
        if not 0.0 <= arguments.deviation <= 0.1:
            raise InputError("--deviation", arguments.deviation, "a number from 0 to 0.1")


def _find_campbell_speeds_or_none(arguments: Namespace, scene: Scene) -> np.ndarray | None:
    """Return a Campbell diagram's speeds (n_speeds,) [rad/s]; None for other commands.

    The option ``--speeds`` START STOP COUNT is in rpm if the scene's speed is, otherwise in rad/s.
    By default, 13 speeds go from 0 to 1.5 times the scene's. Raises InputError unless 0 <= START <
    STOP and COUNT >= 2.
    """
    if arguments.command != "campbell":
        return None
    scene.given("rotation")
    unit_factor = RAD_PER_S_PER_RPM if scene.is_speed_in_rpm else 1.0
    first_speed, last_speed, n_speeds = arguments.speeds or (
        0.0,
        1.5 * scene.speed / unit_factor,
        13,
    )
    if not (
        0.0 <= first_speed < last_speed < np.inf
        and 2 <= n_speeds <= MAX_VALUES_OF_AXIS
        and n_speeds % 1 == 0
    ):
        raise InputError(
            "--speeds",
            arguments.speeds or (first_speed, last_speed, n_speeds),
            "START STOP COUNT with 0 <= START < STOP, and COUNT a whole number from 2 to "
            f"{MAX_VALUES_OF_AXIS}",
        )
    return unit_factor * np.linspace(first_speed, last_speed, int(n_speeds))


def _read_measurements(
    arguments: Namespace, scene: Scene, uncracked_path: Path | None
) -> Measurements | None:
    """Read the measurement files for ``identify``, and join their rows in one object.

    ``uncracked_path`` is a file of frequency responses before the crack, or None. Returns None if
    only arrivals are given.

    Raises
    ------
    InputError
        Nothing is given, ``--modes`` has no frequency responses, or a file does not fit the scene.
    """
    measurement_paths, mode_numbers = arguments.measurements, arguments.modes
    if not measurement_paths and arguments.arrivals is None:
        raise InputError(
            "measurements",
            None,
            "given: a CSV file (fenics-crack new --identify writes one), or --arrivals FILE",
        )
    if not measurement_paths and uncracked_path is None and not mode_numbers:
        return None
    from fenics_crack.monitoring.identification.measurements import (
        UNIVERSAL_FILE_SUFFIXES,
        Measurements,
    )

    if (
        mode_numbers
        and uncracked_path is None
        and not any(path.suffix.lower() in UNIVERSAL_FILE_SUFFIXES for path in measurement_paths)
    ):
        raise InputError(
            "--modes",
            list(mode_numbers),
            "left out without a file of frequency responses "
            f"({', '.join(UNIVERSAL_FILE_SUFFIXES)})",
        )
    measurement_sets = [Measurements.read(path, mode_numbers) for path in measurement_paths]
    if uncracked_path is not None:
        measurement_sets.append(
            Measurements.from_responses(
                uncracked_path, mode_numbers, quantity="frequency_uncracked"
            )
        )
    measurements = sum(measurement_sets[1:], measurement_sets[0])
    if measurement_paths:
        measurements.check(scene)
    return measurements


def _read_arrivals(scene: Scene, arguments: Namespace, path: Path | None) -> ArrivalSource:
    """Read measured arrivals by blade number; a path to a result (.h5) is returned unchanged.

    A bladed disk has arrivals at all blades. Otherwise the option --blade selects a blade. If
    ``path`` is None, None is returned.
    """
    if path is None or path.suffix.lower() == ".h5":
        return path
    timing_table = scene.given("tip_timing")
    from fenics_crack.arrivals.arrival_times import find_probe_angles_by_blade, read_record

    probe_angles: Any = np.radians(timing_table.probes)
    if scene.disk is not None:
        probe_angles = find_probe_angles_by_blade(probe_angles, scene.disk.sectors)
    arrivals_by_blade = read_record(path, tip_radius=timing_table.tip_radius, probes=probe_angles)
    return select_blades(
        arrivals_by_blade, arguments.blade, path, allows_several=scene.disk is not None
    )


def select_blades(
    arrivals_by_blade: dict[int, ArrivalTimes],
    blade_number: int | None,
    record_path: Path,
    *,
    allows_several: bool = True,
) -> dict[int, ArrivalTimes]:
    """Select a single blade, or all blades, from a record of arrivals.

    Parameters
    ----------
    arrivals_by_blade : dict of int to ArrivalTimes
        Arrivals in the record by blade number.
    blade_number : int or None
        Blade to select; None: all blades.
    record_path : Path
        Path to the record, for errors.
    allows_several : bool
        If False, ``blade_number`` None is allowed only for a record with a single blade.

    Raises
    ------
    InputError
        The number is missing, or is not in the record.
    """
    if blade_number is None and (allows_several or len(arrivals_by_blade) == 1):
        return arrivals_by_blade
    if blade_number is None or blade_number not in arrivals_by_blade:
        raise InputError(
            "--blade",
            blade_number,
            f"{'given: ' if blade_number is None else ''}one of the blades in {record_path}: "
            f"{', '.join(map(str, arrivals_by_blade))}",
        )
    return {blade_number: arrivals_by_blade[blade_number]}


def parse_changes(assignments: Sequence[str]) -> dict[str, Any]:
    """Parse the assignments ``key=value`` of ``--set`` into values by full key.

    A value is TOML, or otherwise a word. The word ``none`` becomes None, to remove the key. Raises
    InputError for an assignment without key or "=".
    """
    values_by_key: dict[str, Any] = {}
    for assignment in assignments:
        key_text, equals_sign, value_text = assignment.partition("=")
        if not equals_sign or not key_text.strip():
            raise InputError("--set", assignment, "key=value, for example contact.stiffness=1e9")
        value_text = value_text.strip()
        try:
            value_of_scene_key = tomllib.loads(f"value = {value_text}")["value"]
        except (ValueError, RecursionError):
            value_of_scene_key = None if value_text == "none" else value_text
        values_by_key[key_text.strip()] = value_of_scene_key
    return values_by_key


def format_command(*words: object) -> str:
    """Return a command line of the program, quoted for a shell."""
    return shlex.join(["fenics-crack", *map(str, words)])


# --- console and folder of the output -------------------------------------------------------------


@dataclass(frozen=True)
class Console:
    """Print a command's table to standard output, and all further text to standard error.

    Attributes
    ----------
    comm : MPI.Comm
        MPI ranks of the command; rank 0 writes files.
    table_format : str
        "text", "csv" or "json".
    is_quiet : bool
        Print the table and warnings alone.
    is_verbose : bool
        Print how long each stage took.
    picture_format : str
        Ending of pictures: "png", "pdf" or "svg".
    printed_remark_texts : set of str
        Remarks that were printed already.
    """

    comm: MPI.Comm
    table_format: str
    is_quiet: bool
    is_verbose: bool
    picture_format: str = "png"
    printed_remark_texts: set[str] = field(default_factory=set)

    @property
    def shows_progress(self) -> bool:
        """True if progress bars are shown.

        This holds unless quiet, and only at a terminal or if verbose.
        """
        return not self.is_quiet and (self.is_verbose or sys.stderr.isatty())

    def print_table(self, table: Table) -> None:
        """Print a table to standard output, in ``table_format``."""
        print(table.format_as(self.table_format), end="", flush=True)

    def print_notes(self, *note_texts: str) -> None:
        """Print all notes except empty texts, unless quiet."""
        for note_text in filter(None, note_texts):
            USER_MESSAGE_LOGGER.info("%s", note_text)

    def print_remarks(self, *remarks: object) -> None:
        """Print remarks about unusual values of a scene, each once, unless quiet."""
        unprinted_texts = [
            remark_text
            for remark_text in map(str, remarks)
            if remark_text not in self.printed_remark_texts
        ]
        self.printed_remark_texts.update(unprinted_texts)
        self.print_notes(*(f"remark: {remark_text}" for remark_text in unprinted_texts))

    def print_warnings(self, *warning_texts: str) -> None:
        """Print warnings, even if quiet."""
        for warning_text in warning_texts:
            USER_MESSAGE_LOGGER.warning("%s", warning_text)

    @contextmanager
    def report_stage(self, stage_name: str, *, has_bars: bool = False) -> Iterator[None]:
        """Print the progress of the code in a ``with`` block, and the duration if verbose.

        Without a terminal, a message is printed every few seconds.

        Parameters
        ----------
        stage_name : str
            Printed name of the stage.
        has_bars : bool
            True if the code in the block shows progress bars. No further progress is printed while
            bars are shown.
        """
        start_time = time.perf_counter()
        is_silent = self.is_quiet or (has_bars and self.shows_progress)
        with nullcontext() if is_silent else StageLineHandler(keeps_lines=self.shows_progress):
            begin_stage(stage_name)
            yield
        if self.is_verbose:
            USER_MESSAGE_LOGGER.info("%s: %.2f s", stage_name, time.perf_counter() - start_time)


@dataclass
class PictureFiles:
    """Record paths and captions of pictures, drawn into a folder.

    Attributes
    ----------
    folder : Path
        Folder for all files.
    file_format : str
        Ending of the pictures: "png", "pdf" or "svg".
    has_vtk_files : bool
        True if files for ParaView are written, too.
    captions_by_path : dict of Path to str
        Sentence below each picture; empty for files for ParaView.
    notes : list of str
        Pictures left out, with the reasons.
    """

    folder: Path
    file_format: str = "png"
    has_vtk_files: bool = False
    captions_by_path: dict[Path, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def __call__(self, file_stem: str, caption: str, file_format: str = "") -> Path:
        """Return the path of a new picture, and record the caption.

        ``file_stem`` is the file's name without ending. ``file_format`` is the ending; empty: the
        attribute ``file_format``.
        """
        picture_path = self.folder / f"{file_stem}.{file_format or self.file_format}"
        self.captions_by_path[picture_path] = caption
        return picture_path


def make_writable_folder(folder: Path, comm: MPI.Comm) -> None:
    """Create a folder for results; raise InputError if files cannot be written (collective)."""
    from fenics_crack.basics.ranks import on_root  # PETSc

    on_root(
        comm,
        lambda: make_or_check_results_folder(
            folder, (BACKUP_FOLDER_NAME, PERIOD_FRAMES_FOLDER_NAME)
        ),
    )


def keep_previous_files_and_return_note(
    table_path: Path, table_text: str, comm: MPI.Comm, *other_result_file_stems: str
) -> str:
    """Keep the previous result's files in the folder ``before`` (collective).

    The folder keeps a single previous result. If previous and new table have the same text, within
    the rounding of their numbers, nothing is kept.

    Parameters
    ----------
    table_path : Path
        Path of the table, previous and new. All result files with the same stem (name without
        ending) are kept.
    table_text : str
        Text of the new table.
    comm : MPI.Comm
        MPI ranks; rank 0 keeps the files.
    other_result_file_stems : str
        Further stems of files to keep.

    Returns
    -------
    str
        Note on the kept files, or why keeping has failed. Empty if nothing was to be kept.
    """
    from fenics_crack.basics.ranks import on_root  # PETSc

    previous_folder = table_path.with_name(BACKUP_FOLDER_NAME)
    file_names = [
        f"{file_stem}{file_suffix}"
        for file_stem in (table_path.stem, *other_result_file_stems)
        for file_suffix in RESULT_FILE_ENDINGS
    ]

    def keep_files_on_root() -> str:
        try:
            previous_text = read_regular_file(table_path, follows_links=False).decode()
            if have_equal_numbers(previous_text, table_text):
                return ""
        except FileNotFoundError:
            return ""
        except (OSError, ValueError):  # no table of ours
            pass
        try:
            if not back_up_files(file_names, table_path.parent, previous_folder):
                return ""
        except OSError as error:
            return (
                f"{previous_folder}: the previous result could not be kept here "
                f"({error.strerror}) and is overwritten; use another --output to keep results"
            )
        return f"{previous_folder}: the previous result, now replaced, is kept here"

    return on_root(comm, keep_files_on_root)


# --- new scenes -----------------------------------------------------------------------------------


def write_new_scene(arguments: Namespace, _: None, console: Console) -> None:
    """Run the command ``new``: write a commented scene to start from.

    Raises InputError if the file exists, or if the options cannot be combined.
    """
    from fenics_crack.basics.ranks import on_root  # PETSc

    scene_path: Path = arguments.file
    all_new_scene_options = (*EXCLUSIVE_NEW_SCENE_OPTIONS, "cad", *COMBINABLE_NEW_SCENE_OPTIONS)
    chosen_new_scene_options = [
        new_scene_option
        for new_scene_option in all_new_scene_options
        if vars(arguments)[new_scene_option]
    ]
    combinable_options = [
        new_scene_option
        for new_scene_option in chosen_new_scene_options
        if new_scene_option in COMBINABLE_NEW_SCENE_OPTIONS
    ]
    has_exclusive_option = len(combinable_options) < len(chosen_new_scene_options)
    if has_exclusive_option and len(chosen_new_scene_options) > 1:
        raise InputError(
            f"--{chosen_new_scene_options[0]}",
            f"with --{chosen_new_scene_options[1]}",
            "used alone, as it writes another scene",
        )
    measurements_path = scene_path.with_name(f"{scene_path.stem}_measured.csv")
    if arguments.cad:
        from fenics_crack.cli.part import propose_scene_and_draw_faces  # gmsh and VTK

        scene_text, picture_path = on_root(
            console.comm, lambda: propose_scene_and_draw_faces(arguments.cad, scene_path)
        )
        console.print_notes(
            f"{picture_path}: picture of the faces of {arguments.cad}, with their numbers"
        )
        texts_by_path = {scene_path: scene_text}
    elif has_exclusive_option:
        scene_text = read_packaged_text(f"cli/new_{chosen_new_scene_options[0]}.toml")
        texts_by_path = {scene_path: scene_text.replace("SCENE", shlex.quote(scene_path.name))}
    else:
        texts_by_path = {
            scene_path: build_scene_text(
                scene_path.name, measurements_path.name, combinable_options
            )
        }
    if "identify" in combinable_options:
        texts_by_path[measurements_path] = read_packaged_text("cli/new_measured.csv")

    def write_files() -> None:
        for file_path in texts_by_path:
            if os.path.exists(file_path):  # False for a name too long, which writing will say
                raise InputError(
                    "scene", str(file_path), "the name of a new file; this file exists"
                )
        for file_path, scene_text in texts_by_path.items():
            write_file_whole(file_path, scene_text, "scene")

    on_root(console.comm, write_files)
    console.print_notes(
        f"{scene_path}: a scene to start from; next: {format_command('check', scene_path)}"
    )
    if measurements_path in texts_by_path:
        console.print_notes(
            f"{measurements_path}: example measurements, to be replaced by yours; then: "
            f"{format_command('identify', scene_path, measurements_path)}"
        )


def build_scene_text(
    scene_name: str, measurements_name: str, combinable_options: Collection[str]
) -> str:
    """Build the text of a new scene from the template of a plate.

    Parameters
    ----------
    scene_name, measurements_name : str
        File names of scene and measurements, for commands in the comments.
    combinable_options : collection of str
        Options of the command ``new``, from :data:`COMBINABLE_NEW_SCENE_OPTIONS`. Each adds lines
        to the scene.
    """
    chosen_option_marks = [
        f"(--{new_scene_option})"
        for new_scene_option in {
            *combinable_options,
            *(["blade"] if "timing" in combinable_options else []),
        }
    ]
    scene_lines = [
        _toggle_comment(template_line)
        if template_line.endswith(tuple(chosen_option_marks))
        else template_line
        for template_line in read_packaged_text(PLATE_TEMPLATE_PATH).splitlines()
    ]
    scene_text = "\n".join([*map(_remove_option_mark, scene_lines), ""])
    return scene_text.replace("SCENE", shlex.quote(scene_name)).replace(
        "MEASURED", shlex.quote(measurements_name)
    )


def find_example_line(key: str, requirement_text: str) -> str:
    """Return an example line for a scene key, to print below an error; "" without an example.

    The line, for example "young = 2.1e11", comes from a template of the command ``new``. If no
    template has the key, the example is for another key proposed in the error.

    Parameters
    ----------
    key : str
        Key with table: "material.young".
    requirement_text : str
        Text of the error after "must be". Keys of the same table in this text may be used for the
        example.
    """
    table_name, _, key_name = key.partition(".")
    key_names = key_name, *re.findall(rf"\b{re.escape(table_name)}\.(\w+)", requirement_text)
    template_lines = [
        template_line.partition("  #")[0].strip()
        for table_lines in _yield_table_lines(table_name)
        for template_line in table_lines
    ]
    return next(
        (
            template_line
            for name in key_names
            for template_line in template_lines
            if template_line.startswith(f"{name} = ")
        ),
        "",
    )


def find_example_table_text(table_name: str) -> str:
    """Return example lines for a scene table; "" without an example.

    The lines come from the first template with this table, among the templates of the command
    ``new``.
    """
    return "\n".join(next(_yield_table_lines(table_name), ()))


def _yield_table_lines(table_name: str) -> Iterator[list[str]]:
    """Yield the lines of a scene table, each time a template has this table.

    Templates are the scenes of the command ``new``. If a table is commented out, the comment marks
    are removed. A mark for an option of ``new``, for example ``(--blade)``, is removed, too.
    """
    scene_template_texts = map(
        read_packaged_text,
        (
            PLATE_TEMPLATE_PATH,
            *(
                f"cli/new_{new_scene_option_name}.toml"
                for new_scene_option_name in EXCLUSIVE_NEW_SCENE_OPTIONS
            ),
        ),
    )
    for block_text in itertools.chain.from_iterable(
        scene_template_text.split("\n\n") for scene_template_text in scene_template_texts
    ):
        block_lines = block_text.splitlines()
        for block_line_index, line in enumerate(block_lines):
            if line.removeprefix("# ").startswith((f"[{table_name}]", f"[{table_name}.")):
                is_commented = line.startswith("#")
                table_lines = (
                    line
                    for line in block_lines[block_line_index:]
                    if line.startswith("#") == is_commented
                )
                yield [
                    _remove_option_mark(_toggle_comment(line) if is_commented else line)
                    for line in table_lines
                ]


def _remove_option_mark(line: str) -> str:
    """Return a template line without a mark for an option at the end, ``(--blade)``."""
    return re.sub(r"\s+(# )?\(--\w+\)$", "", line)


def _toggle_comment(line: str) -> str:
    """Return a template line with the comment mark "# " removed or, if missing, added.

    A remark at the end of the line stays in the same column.
    """
    if line.startswith("# "):
        return line.removeprefix("# ").replace("  #", "    #", 1)
    return "# " + line.replace("    #", "  #", 1)
