"""Inputs of a command: a scene with its changes, measurements and arrivals, read from text, and the
folder and console for its output; and the scene that ``new`` writes.

Reading it needs NumPy alone, which loads in a tenth of the time of the libraries that compute.

Lines of the template of ``new`` that end in a mark, ``(--blade)``, are commented out, or in, where
that is requested: a blade on a rotor in place of a plate, probes in its casing, a crack that is
looked for.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import tempfile
import time
import tomllib
from argparse import Namespace
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fenics_crack.basics.atomic_files import not_written, write_whole
from fenics_crack.basics.errors import MAX_CASES, InputError, check_count
from fenics_crack.basics.progress import LOGGER, StageLines, begin
from fenics_crack.basics.tables import Table
from fenics_crack.basics.untrusted_files import content_of
from fenics_crack.scene.fields import Mistuning
from fenics_crack.scene.scene import Scene
from fenics_crack.version import packaged

if TYPE_CHECKING:
    from mpi4py import MPI

    from fenics_crack.monitoring.identification.measurements import Measurements
    from fenics_crack.monitoring.tip_timing.arrival_times import ArrivalTimes

    Source = ArrivalTimes | Path | dict[int, ArrivalTimes] | None

COMMENTED = "cli/new_scene.toml"
RECORDS = (".csv", ".h5")
"""Endings of files of arrivals, and of results from which arrivals are computed."""
BEFORE = "before"
WRITTEN = (".h5", ".csv", ".json", ".png", ".pdf", ".svg")
"""Folder in which a result is kept that another one replaces, and what its files end in."""
KINDS = ("blade", "timing", "identify")
"""Scenes that ``new`` writes besides a plate."""
ALONE = ("solid", "disk")
"""Scenes that have files of their own."""


@dataclass(frozen=True)
class Inputs:
    """Inputs that were read; None where the command has no such input beside its scene."""

    scene: Scene
    folder: Path  # for results
    measurements: Measurements | None = None
    arrivals: Source = None  # or the result from which they are computed
    before: Source = None  # of the blade before it had a crack


def read_inputs(given: Namespace) -> Inputs | None:
    """Read the text files that a command is given; None where it has no scene, as with a record
    of ``timing``.

    Raises
    ------
    InputError
        One of them cannot be used.
    """
    if "scene" not in given or _is_record(given):
        return None
    scene = Scene.load(given.scene, changes(given.set))
    _check_options(given, scene)
    folder = vars(given).get("output") or Path("output") / given.scene.stem
    arrivals = _arrivals(scene, given, vars(given).get("arrivals"))
    if given.command != "identify":
        return Inputs(scene, folder, arrivals=arrivals)
    seen = given.before is not None and given.before.suffix.lower() in RECORDS
    before = _arrivals(scene, given, given.before) if seen else None
    rows = _measurements(given, scene, None if seen else given.before)
    return Inputs(scene, folder, rows, arrivals, before)


def _check_options(given: Namespace, scene: Scene) -> None:
    """Raise InputError for a number of a command's options that it cannot take."""
    if (count := vars(given).get("count")) is not None:
        check_count("--count", count, 1)
    if given.command == "campbell":
        scene.given("rotation")
        start, stop, steps = given.speeds or (0.0, scene.speed, 2)
        if not (0.0 <= start < stop < np.inf and 2 <= steps <= MAX_CASES and steps % 1 == 0):
            allowed = f"0 <= START < STOP, and COUNT a whole number from 2 to {MAX_CASES}"
            raise InputError("--speeds", given.speeds or (start, stop, steps), allowed)
    if given.command == "disk":
        scene.given("disk")
        check_count("--patterns", given.patterns, 0, MAX_CASES)
        Mistuning(given.deviation)


def _measurements(given: Namespace, scene: Scene, before: Path | None) -> Measurements | None:
    """Read the measurements of all files, and responses before the crack; None: arrivals only."""
    files, modes = given.measurements, given.modes
    if not files and given.arrivals is None:
        allowed = "given: a CSV file (fenics-crack new --identify writes one), or --arrivals"
        raise InputError("measurements", None, allowed)
    if not files and before is None and not modes:
        return None
    from fenics_crack.monitoring.identification.measurements import UNIVERSAL, Measurements

    if modes and before is None and not any(one.suffix.lower() in UNIVERSAL for one in files):
        allowed = f"left out without frequency responses ({', '.join(UNIVERSAL)})"
        raise InputError("--modes", list(modes), allowed)
    parts = [Measurements.read(one, modes) for one in files]
    if before is not None:
        parts.append(Measurements.from_responses(before, modes, quantity="frequency_uncracked"))
    rows = sum(parts[1:], parts[0])
    if files:
        rows.check(scene)
    return rows


def _arrivals(scene: Scene, given: Namespace, source: Path | None) -> Source:
    """Measured arrivals, of the blade that is given if the file has several, of a bladed disk of
    all by their numbers; of a result its
    path."""
    if source is None or source.suffix.lower() == ".h5":
        return source
    table = scene.given("tip_timing")
    from fenics_crack.monitoring.tip_timing.arrival_times import probes_of_blades, read_record

    probes: Any = np.radians(table.probes)
    if scene.disk is not None:
        probes = probes_of_blades(probes, scene.disk.sectors)
    blades = read_record(source, tip_radius=table.tip_radius, probes=probes)
    if scene.disk is not None:
        return one_of(blades, given.blade, source)
    [(_, arrivals), *others] = one_of(blades, given.blade, source).items()
    if others:
        raise InputError(
            "--blade", None, f"given: one of {', '.join(map(str, blades))} in {source}"
        )
    return arrivals


def one_of(
    blades: dict[int, ArrivalTimes], blade: int | None, source: Path
) -> dict[int, ArrivalTimes]:
    """All blades of a record, or the one whose number is given."""
    if blade is None:
        return blades
    if blade not in blades:
        allowed = f"one of {', '.join(map(str, blades))} in {source}"
        raise InputError("--blade", blade, allowed)
    return {blade: blades[blade]}


def _is_record(given: Namespace) -> bool:
    """Return True if ``timing`` is given a record of arrivals in place of a scene."""
    return bool(given.command == "timing" and given.scene.suffix.lower() == ".csv")


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


# --- where it prints and writes -------------------------------------------------------------------


@dataclass(frozen=True)
class Console:
    """Prints a command's table to standard output, all else to standard error."""

    comm: MPI.Comm  # rank 0 writes files
    form: str  # of the table: "text", "csv" or "json"
    quiet: bool  # print the table alone
    verbose: bool  # print how long each part took
    pictures: str = "png"  # their kind

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
        """Print what is unusual about a scene, likewise."""
        self.note(*(f"remark: {remark}" for remark in remarks))

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
    """Make a folder for results; raise InputError unless a file can be written there."""
    from fenics_crack.basics.ranks import on_root  # PETSc

    def work() -> None:
        before = folder / BEFORE
        if before.is_symlink() or (before.exists() and not before.is_dir()):
            raise InputError("--output", str(before), "a folder, in which earlier results are kept")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError as error:
            raise not_written("--output", folder, error, "a folder that can be written") from None

    on_root(comm, work)


def keep_before(table: Path, text: str, comm: MPI.Comm, *others: str) -> str:
    """Keep an earlier result in the folder :data:`BEFORE` beside it, too, one generation, where the
    text of its table is not that of the one that takes its place; return a line that says so, or
    why it could not be kept, or nothing (collective).

    Its files are those of the name of the table and of the ``others``.
    """
    from fenics_crack.basics.ranks import on_root  # PETSc

    before = table.with_name(BEFORE)

    def files(folder: Path) -> list[Path]:
        names = table.stem, *others
        found = (folder / f"{name}{kind}" for name in names for kind in WRITTEN)
        return [path for path in found if path.is_file() and not path.is_symlink()]

    def work() -> str:
        try:
            if content_of(table, links=False) == text.encode():
                return ""
        except FileNotFoundError:
            return ""
        except OSError:  # no table of ours
            pass
        try:
            before.mkdir(exist_ok=True)
            for path in files(before):
                path.unlink()
            for path in files(table.parent):
                try:
                    os.link(path, before / path.name)  # a new file takes the place of this name
                except OSError:  # a file system without links
                    shutil.copy2(path, before / path.name)
        except OSError as error:
            return f"{before}: the previous result could not be kept here ({error.strerror})"
        return f"{before}: the previous result, which this one has replaced, is kept here"

    return on_root(comm, work)


# --- the scene that is written --------------------------------------------------------------------


def new(given: Namespace, _: None, console: Console) -> None:
    """Write a commented scene to start from."""
    from fenics_crack.basics.ranks import on_root  # PETSc

    path: Path = given.file
    kinds = [kind for kind in KINDS if vars(given)[kind]]
    alone = [name for name in ALONE if vars(given)[name]]
    if alone and len(alone + kinds) > 1:
        other = f"with --{(alone[1:] + kinds)[0]}"
        raise InputError(f"--{alone[0]}", other, "used alone: it is another scene")
    rows = path.with_name(f"{path.stem}_measured.csv")
    if alone:
        files = {path: packaged(f"cli/new_{alone[0]}.toml").replace("SCENE", path.name)}
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
    console.note(f"{path}: a scene to start from; now: fenics-crack check {path}")
    if rows in files:
        console.note(f"{rows}: what was measured; then: fenics-crack identify {path} {rows}")


def new_scene(name: str, rows: str, kinds: Collection[str]) -> str:
    """The scene of some :data:`KINDS`, written under a name, beside a file of measurements."""
    marks = [f"(--{kind})" for kind in {*kinds, *(["blade"] if "timing" in kinds else [])}]
    lines = (
        _turned(line) if line.endswith(tuple(marks)) else line
        for line in packaged(COMMENTED).splitlines()
    )
    whole = "\n".join([*map(_without_mark, lines), ""])
    return whole.replace("SCENE", name).replace("MEASURED", rows)


def lines_of(table: str) -> str:
    """The lines by which the template gives a scene a table; empty where it has none."""
    for block in packaged(COMMENTED).split("\n\n"):
        lines = block.splitlines()
        for place, line in enumerate(lines):
            if line.removeprefix("# ").startswith((f"[{table}]", f"[{table}.")):
                asleep = line.startswith("#")
                chosen = (one for one in lines[place:] if one.startswith("#") == asleep)
                return "\n".join(_without_mark(_turned(one) if asleep else one) for one in chosen)
    return ""


def _without_mark(line: str) -> str:
    return re.sub(r"\s+(# )?\(--\w+\)$", "", line)


def _turned(line: str) -> str:
    """A line without the ``#`` that it begins with, or with one; its remark stays in place."""
    if line.startswith("# "):
        return line.removeprefix("# ").replace("  #", "    #", 1)
    return "# " + line.replace("    #", "  #", 1)
