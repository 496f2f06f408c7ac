"""Inputs of a command: a scene with its changes, measurements and arrivals, read from text, and the
folder and console for its output; and the scene that ``new`` writes.

Reading it needs NumPy alone, which loads in a tenth of the time of the libraries that compute.

Lines of the template of ``new`` that end in a mark, ``(--blade)``, are commented out, or in, where
that is requested: a blade on a rotor in place of a plate, probes in its casing, a crack that is
looked for.
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

from fenics_crack.basics.atomic_files import BEFORE, keep_files, prepare_folder, write_whole
from fenics_crack.basics.errors import MAX_CASES, InputError, check_count
from fenics_crack.basics.progress import LOGGER, StageLines, begin
from fenics_crack.basics.tables import RPM, Table
from fenics_crack.basics.untrusted_files import content_of, text_of
from fenics_crack.scene.scene import Scene
from fenics_crack.version import packaged

if TYPE_CHECKING:
    from mpi4py import MPI

    from fenics_crack.arrivals.arrival_times import ArrivalTimes
    from fenics_crack.monitoring.identification.measurements import Measurements
    from fenics_crack.study.prepare import Study

    Source = Path | dict[int, ArrivalTimes] | None

COMMENTED = "cli/new_scene.toml"
RECORDS = (".csv", ".h5")
"""Endings of files of arrivals, and of results from which arrivals are computed."""
STRUCTURE_FILE = "prepared.h5"
"""Name of the file of a command's structure."""
PERIOD = "solution_period"
"""Folder below that for results, of the frames of a period."""
RESULT_ENDINGS = (".h5", ".csv", ".json", ".png", ".pdf", ".svg")
"""Endings of the files of a result."""
OF_PREPARED = ("solve", "curve")
"""Commands that a file of ``reduce`` has all for."""
JOINABLE_SCENES = ("blade", "timing", "identify")
"""Scenes that ``new`` writes besides a plate."""
WHOLE_SCENES = ("solid", "disk")
"""Scenes that have files of their own."""


@dataclass(frozen=True)
class Inputs:
    """Inputs that were read; None where the command has no such input beside its scene."""

    scene: Scene
    folder: Path  # for results
    measurements: Measurements | None = None
    arrivals: Source = None  # or the result from which they are computed
    before: Source = None  # of the blade before it had a crack
    speeds: np.ndarray | None = None  # of a Campbell diagram [rad/s]
    prepared: Study | None = None  # of a file, for its scene


def read_inputs(given: Namespace) -> Inputs | None:
    """Read the text files that a command is given; None where it has no scene, as with a record
    of ``timing``.

    Raises
    ------
    InputError
        One of them cannot be used.
    """
    of_record = given.command == "timing" and given.scene.suffix.lower() == ".csv"
    if "scene" not in given or of_record:
        return None
    changed = changes(given.set)
    try:
        scene = Scene.load(given.scene, changed)
    except InputError as error:
        error.others = tuple(_errors_behind(error, given.scene, changed))
        raise
    _check_options(given, scene)
    output = vars(given).get("output")
    if given.command == "reduce" and output is not None:
        if output.suffix.lower() != ".h5":
            raise InputError("--output", str(output), "a .h5 file")
        output = output.parent
    folder = output or Path("output") / given.scene.stem
    arrivals = _arrivals(scene, given, vars(given).get("arrivals"))
    if given.command != "identify":
        return Inputs(scene, folder, arrivals=arrivals, speeds=_speeds(given, scene))
    seen = given.before is not None and given.before.suffix.lower() in RECORDS
    before = _arrivals(scene, given, given.before) if seen else None
    rows = _measurements(given, scene, None if seen else given.before)
    return Inputs(scene, folder, rows, arrivals, before)


def read_prepared(given: Namespace, comm: MPI.Comm) -> Inputs:
    """Read the file of ``reduce`` that a command is given in place of a scene (collective).

    Raises
    ------
    InputError
        It cannot be used, a changed key needs a mesh, or the command does.
    """
    if given.command not in OF_PREPARED:
        allowed = f"a scene for {given.command}; a file of reduce is one for "
        raise InputError("scene", str(given.scene), allowed + " and ".join(OF_PREPARED))
    from fenics_crack.study.artefact import load_prepared  # the solver

    study = load_prepared(given.scene, changes(given.set), comm)
    return Inputs(study.scene, given.output or Path("output") / given.scene.stem, prepared=study)


def _errors_behind(error: InputError, path: Path, given: dict[str, Any]) -> Iterator[InputError]:
    """Yield the errors of further keys of a scene with the changes that are given.

    From then on a missing key or table, and a wrong number, are those of the template, an unknown
    key is left out, and a wrong word is the one that may be meant, or ends it. Behind a value of
    the template only what is missing or unknown is reported: other errors may be due to that value.
    """
    changed, passed, meant, alone = {**given}, {"scene"}, "", True
    tables = {} if error.key == "scene" else tomllib.loads(text_of(path))
    while error.key not in passed:
        passed.add(error.key)
        table, _, name = error.key.partition(".")
        value = re.search(r"; did you mean (.+)\?$", error.allowed)
        if error.allowed.startswith("left out; "):
            meant += error.allowed.partition(" known ")[0]
            changed.pop(error.key, None)
            held = tables.get(table) if name else tables
            if isinstance(held, dict):
                held.pop(name or table, None)
        else:
            lines = line_of(error.key, error.allowed) if name else lines_of(table)
            lines = f"{name} = {value[1]}" if value else lines
            with suppress(ValueError):  # no value is meant
                held = tomllib.loads(lines)
                for key, right in (held if name else held.get(table, {})).items():
                    if error.value is None or value or not isinstance(right, str):
                        changed[f"{table}.{key}"] = right
            alone = alone and value is not None
        try:
            Scene.from_mapping(tables, path.parent, changed)
            return
        except InputError as later:
            error = later
        reported = alone or error.value is None or error.allowed.startswith("left out; ")
        if reported and error.key not in passed and f"{error.key}?" not in meant:
            yield error


def _check_options(given: Namespace, scene: Scene) -> None:
    """Raise InputError for a number of a command's options that it cannot take."""
    if (count := vars(given).get("count")) is not None:
        check_count("--count", count, 1)
    if given.command == "disk":
        scene.given("disk")
        check_count("--patterns", given.patterns, 0, MAX_CASES)
        if not 0.0 <= given.deviation <= 0.1:
            raise InputError("--deviation", given.deviation, "a number from 0 to 0.1")


def _speeds(given: Namespace, scene: Scene) -> np.ndarray | None:
    """The speeds of a Campbell diagram [rad/s]; None of other commands."""
    if given.command != "campbell":
        return None
    scene.given("rotation")
    factor = RPM if scene.in_rpm else 1.0
    start, stop, steps = given.speeds or (0.0, 1.5 * scene.speed / factor, 13)
    if not (0.0 <= start < stop < np.inf and 2 <= steps <= MAX_CASES and steps % 1 == 0):
        allowed = f"0 <= START < STOP, and COUNT a whole number from 2 to {MAX_CASES}"
        raise InputError("--speeds", given.speeds or (start, stop, steps), allowed)
    return factor * np.linspace(start, stop, int(steps))


def _measurements(given: Namespace, scene: Scene, before: Path | None) -> Measurements | None:
    """Read the measurements of all files, and responses before the crack; None: arrivals only."""
    files, modes = given.measurements, given.modes
    if not files and given.arrivals is None:
        allowed = "given: a CSV file (fenics-crack new --identify writes one), or --arrivals"
        raise InputError("measurements", None, allowed)
    if not files and before is None and not modes:
        return None
    from fenics_crack.monitoring.identification.measurements import (
        UNIVERSAL_FILE_SUFFIXES,
        Measurements,
    )

    if (
        modes
        and before is None
        and not any(one.suffix.lower() in UNIVERSAL_FILE_SUFFIXES for one in files)
    ):
        allowed = f"left out without frequency responses ({', '.join(UNIVERSAL_FILE_SUFFIXES)})"
        raise InputError("--modes", list(modes), allowed)
    parts = [Measurements.read(one, modes) for one in files]
    if before is not None:
        parts.append(Measurements.from_responses(before, modes, quantity="frequency_uncracked"))
    rows = sum(parts[1:], parts[0])
    if files:
        rows.check(scene)
    return rows


def _arrivals(scene: Scene, given: Namespace, source: Path | None) -> Source:
    """Measured arrivals by the numbers of the blades: of a bladed disk all, else of the one that is
    given if the file has several; of a result its path."""
    if source is None or source.suffix.lower() == ".h5":
        return source
    table = scene.given("tip_timing")
    from fenics_crack.arrivals.arrival_times import probes_of_blades, read_record

    probes: Any = np.radians(table.probes)
    if scene.disk is not None:
        probes = probes_of_blades(probes, scene.disk.sectors)
    blades = read_record(source, tip_radius=table.tip_radius, probes=probes)
    return one_of(blades, given.blade, source, several=scene.disk is not None)


def one_of(
    blades: dict[int, ArrivalTimes], blade: int | None, source: Path, *, several: bool = True
) -> dict[int, ArrivalTimes]:
    """All blades of a record, where ``several`` may be taken, or the one whose number is given."""
    if blade is None and (several or len(blades) == 1):
        return blades
    if blade is None or blade not in blades:
        allowed = f"one of {', '.join(map(str, blades))} in {source}"
        raise InputError("--blade", blade, f"{'given: ' if blade is None else ''}{allowed}")
    return {blade: blades[blade]}


def changes(given: Sequence[str]) -> dict[str, Any]:
    """Keys and values of ``--set key=value``: TOML, or else a word; ``none`` removes a key."""
    found: dict[str, Any] = {}
    for text in given:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise InputError("--set", text, "key=value, for example contact.stiffness=1e9")
        value = value.strip()
        try:
            parsed = tomllib.loads(f"value = {value}")["value"]
        except (ValueError, RecursionError):
            parsed = None if value == "none" else value
        found[key.strip()] = parsed
    return found


def command(*words: object) -> str:
    """A call of the program, as a shell takes it."""
    return shlex.join(["fenics-crack", *map(str, words)])


# --- where it prints and writes -------------------------------------------------------------------


@dataclass(frozen=True)
class Console:
    """Prints a command's table to standard output, all else to standard error."""

    comm: MPI.Comm  # rank 0 writes files
    form: str  # of the table: "text", "csv" or "json"
    quiet: bool  # print the table alone
    verbose: bool  # print how long each part took
    pictures: str = "png"  # their kind
    printed_remarks: set[str] = field(default_factory=set)

    @property
    def progress(self) -> bool:
        """True if a progress bar is to be shown."""
        return not self.quiet and (self.verbose or sys.stderr.isatty())

    def table(self, table: Table) -> None:
        """Print a table."""
        print(table.formatted(self.form), end="", flush=True)

    def note(self, *texts: str) -> None:
        """Print notes, unless they are empty or quiet is requested."""
        for text in filter(None, texts):
            LOGGER.info("%s", text)

    def remark(self, *remarks: object) -> None:
        """Print remarks on a scene, each once, unless quiet is requested."""
        unprinted_texts = [text for text in map(str, remarks) if text not in self.printed_remarks]
        self.printed_remarks.update(unprinted_texts)
        self.note(*(f"remark: {text}" for text in unprinted_texts))

    def warn(self, *texts: str) -> None:
        """Print warnings, even if quiet."""
        for text in texts:
            LOGGER.warning("%s", text)

    @contextmanager
    def stage(self, name: str, *, bars: bool = False) -> Iterator[None]:
        """Print how long a part took, if verbose, and unless quiet is requested its stages while
        they are done: where no progress is shown, now and then, and none beside ``bars`` of all
        that is done."""
        started, silent = time.perf_counter(), self.quiet or (bars and self.progress)
        with nullcontext() if silent else StageLines(kept=self.progress):
            begin(name)
            yield
        if self.verbose:
            LOGGER.info("%s: %.2f s", name, time.perf_counter() - started)


def make_writable(folder: Path, comm: MPI.Comm) -> None:
    """Make a folder for results; InputError unless files can be written there (collective)."""
    from fenics_crack.basics.ranks import on_root  # PETSc

    on_root(comm, lambda: prepare_folder(folder, (BEFORE, PERIOD)))


def keep_before(table: Path, text: str, comm: MPI.Comm, *others: str) -> str:
    """Keep an earlier result in the folder :data:`BEFORE` beside it, too, one generation, where the
    text of its table is not that of the one that takes its place; return a line that says so, or
    why it could not be kept, or nothing (collective).

    Its files are those of the name of the table and of the ``others``.
    """
    from fenics_crack.basics.ranks import on_root  # PETSc

    before = table.with_name(BEFORE)
    files = [f"{name}{kind}" for name in (table.stem, *others) for kind in RESULT_ENDINGS]

    def work() -> str:
        try:
            if content_of(table, links=False) == text.encode():
                return ""
        except FileNotFoundError:
            return ""
        except OSError:  # no table of ours
            pass
        try:
            if not keep_files(files, table.parent, before):
                return ""
        except OSError as error:
            return f"{before}: the previous result could not be kept here ({error.strerror})"
        return f"{before}: the previous result, which this one has replaced, is kept here"

    return on_root(comm, work)


# --- the scene that is written --------------------------------------------------------------------


def new(given: Namespace, _: None, console: Console) -> None:
    """Write a commented scene to start from."""
    from fenics_crack.basics.ranks import on_root  # PETSc

    path: Path = given.file
    kinds = [kind for kind in JOINABLE_SCENES if vars(given)[kind]]
    alone = [name for name in WHOLE_SCENES if vars(given)[name]]
    alone += ["cad"] if given.cad else []
    if alone and len(alone + kinds) > 1:
        other = f"with --{(alone[1:] + kinds)[0]}"
        raise InputError(f"--{alone[0]}", other, "used alone: it is another scene")
    rows = path.with_name(f"{path.stem}_measured.csv")
    if given.cad:
        from fenics_crack.cli.part import part_scene  # gmsh and VTK

        text, picture = on_root(console.comm, lambda: part_scene(given.cad, path))
        console.note(f"{picture}: the faces of {given.cad}, with numbers")
        files = {path: text}
    elif alone:
        text = packaged(f"cli/new_{alone[0]}.toml")
        files = {path: text.replace("SCENE", shlex.quote(path.name))}
    else:
        files = {path: new_scene(path.name, rows.name, kinds)}
    if "identify" in kinds:
        files[rows] = packaged("cli/new_measured.csv")

    def write() -> None:
        for file in files:
            if os.path.exists(file):  # False for a name too long, which writing will say
                raise InputError("scene", str(file), "the name of a new file; this one exists")
        for file, text in files.items():
            write_whole(file, text, "scene")

    on_root(console.comm, write)
    console.note(f"{path}: a scene to start from; now: {command('check', path)}")
    if rows in files:
        console.note(f"{rows}: what was measured; then: {command('identify', path, rows)}")


def new_scene(name: str, rows: str, kinds: Collection[str]) -> str:
    """A scene of some :data:`JOINABLE_SCENES` under a name, with a file of measurements."""
    marks = [f"(--{kind})" for kind in {*kinds, *(["blade"] if "timing" in kinds else [])}]
    lines = packaged(COMMENTED).splitlines()
    lines = [_turned(line) if line.endswith(tuple(marks)) else line for line in lines]
    whole = "\n".join([*map(_without_mark, lines), ""])
    return whole.replace("SCENE", shlex.quote(name)).replace("MEASURED", shlex.quote(rows))


def line_of(key: str, allowed: str) -> str:
    """The line by which a template gives a key, or another of its table that the allowed values of
    an error name; empty where none gives it."""
    table, _, name = key.partition(".")
    names = name, *re.findall(rf"\b{re.escape(table)}\.(\w+)", allowed)
    lines = [line.partition("  #")[0].strip() for block in _blocks(table) for line in block]
    return next((line for one in names for line in lines if line.startswith(f"{one} = ")), "")


def lines_of(table: str) -> str:
    """The lines by which a template gives a scene a table; empty where none has it."""
    return "\n".join(next(_blocks(table), ()))


def _blocks(table: str) -> Iterator[list[str]]:
    """Lines by which templates give a table."""
    texts = map(packaged, (COMMENTED, *(f"cli/new_{name}.toml" for name in WHOLE_SCENES)))
    for block in itertools.chain.from_iterable(text.split("\n\n") for text in texts):
        lines = block.splitlines()
        for place, line in enumerate(lines):
            if line.removeprefix("# ").startswith((f"[{table}]", f"[{table}.")):
                asleep = line.startswith("#")
                chosen = (one for one in lines[place:] if one.startswith("#") == asleep)
                yield [_without_mark(_turned(one) if asleep else one) for one in chosen]


def _without_mark(line: str) -> str:
    return re.sub(r"\s+(# )?\(--\w+\)$", "", line)


def _turned(line: str) -> str:
    """A line without the ``#`` that it begins with, or with one; its remark stays in place."""
    if line.startswith("# "):
        return line.removeprefix("# ").replace("  #", "    #", 1)
    return "# " + line.replace("    #", "  #", 1)
