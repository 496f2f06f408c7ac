"""The file of a sweep: filled in while the sweep runs, and valid whenever the program is killed.

HDF5 keeps metadata in memory and writes it at times of its own choice. A program killed in between
leaves a file that cannot be opened, and a full disk ends HDF5 itself. So no metadata changes once
the file has its name, and HDF5 writes to memory alone:

- the file is made under another name, closed, and renamed;
- every dataset has its full size from the start, in one contiguous piece whose place is fixed
  (early allocation), in the oldest file format, which does not mark a file as open;
- a finished case overwrites its own bytes: first all its numbers, which are handed to the operating
  system, and only then its ``state``. A case with a state is complete, and not written again; one
  that a kill or a full disk left half written has none and is computed again;
- a case has a checksum of its numbers and its state, and it is what this confirms. A damaged case
  is not read, and computed again if the sweep is continued.

Unwritten parts take no space if the file system supports sparse files. The file can be read while
it is being written. A lock, the one that HDF5 takes too, keeps other sweeps from writing to it.
"""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import zlib
from collections.abc import Mapping, Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from fenics_crack.basics.atomic_files import partial_file, report_write_errors, write_bytes_at
from fenics_crack.basics.errors import N_LOWEST_MODES, InputError, WriteError
from fenics_crack.basics.observables import (
    OBSERVABLES_BY_NAME,
    REQUIRES_FRICTION,
    Place,
    observable_names,
)
from fenics_crack.basics.tables import UNIT_BY_NAME
from fenics_crack.basics.untrusted_files import MAX_FILE_BYTES, regular_file_size
from fenics_crack.files import store
from fenics_crack.files.store import describe_dataset
from fenics_crack.scene.scene import LOOKED_AT, Scene, asked_quantities
from fenics_crack.scene.words import differences
from fenics_crack.version import VERSION

KIND = "sweep"


class State(IntEnum):
    """State of a case."""

    PENDING = 0
    CONVERGED = 1
    FAILED = 2


UNSURE = "undecided: "
"""Beginning, in the status of a case, of the reason for undecided stability."""
YET = "; yet "
"""Beginning of the remark that more modes contradict the verdict."""


def of_load(quantity: str) -> str:
    """The column of a quantity at the load's point in the load's direction."""
    return "response" if quantity == "amplitude" else quantity


NUMBERED = range(1, N_LOWEST_MODES + 1)
"""Numbers of the modes whose natural frequencies are kept of each case."""
NATURAL = {
    f"omega_{lips}_{mode}": (words.format(mode), "rad/s")
    for lips, words in (
        ("open", "natural frequency {}, crack open"),
        ("tied", "natural frequency {}, crack bonded"),
        ("bilinear", "bilinear frequency of open mode {}"),
    )
    for mode in NUMBERED
}
"""Words and unit of these frequencies."""
AT_POINTS = {
    name: UNIT_BY_NAME[name] for name in observable_names(Place.POINT) if name != "ratio_half_1"
}
"""Quantities kept of each point and direction, and their units: no case has a longer period."""
KEPT_ORDERS = (1, 2, 3, 4, 5, 6)
"""Harmonics of which the parts are kept."""
PHASES = {f"{part}_{order}": "m" for order in KEPT_ORDERS for part in ("cosine", "sine")}
"""Parts of the harmonics kept likewise, of whose amplitudes ``harmonic_1`` to ``harmonic_3``."""
COLUMNS: dict[str, tuple[str, str]] = {
    **{of_load(name): (unit, "f8") for name, unit in (AT_POINTS | PHASES).items()},
    **{
        name: (UNIT_BY_NAME[name], "f8")
        for name in observable_names(Place.FACES, Place.MODES, excluded_flags=REQUIRES_FRICTION)
    },
    **{name: (unit, "f8") for name, (_, unit) in NATURAL.items()},
    "multiplier": ("1", "f8"),
    "verdict": ("", "S12"),
    **{f"{by}_error": ("1", "f8") for by in ("residual", "truncation", "sampling", "reduction")},
    "penetration_share": ("1", "f8"),
    "harmonics": ("1", "i4"),
    "iterations": ("1", "i4"),
    "omega": ("rad/s", "f8"),
    "frequency": ("Hz", "f8"),
    "crack_length": ("m", "f8"),
    "seconds": ("s", "f8"),
    "status": ("", "S400"),  # and its remark on the verdict; cut where it is longer
}
"""Unit and type of the columns of each case beside its state and the motion at points."""
UNUSED = dict.fromkeys(name for name in LOOKED_AT if name not in ("sweep", "output", "growth"))
"""Tables that no case depends on; without them."""
WAVES = {"gap": "m", "force": "N"}
"""Coefficients kept of a case that converged, and their units."""
WAVES_CHECKSUM, CHECKSUM = "waves_checksum", "checksum"
"""Columns: CRC-32 of the waves of a case; and of all its columns and its state, never 0."""
REQUIRED_COLUMNS = {"state", WAVES_CHECKSUM, CHECKSUM, "harmonics"}
"""Columns without which no file is read; others may be missing in those of earlier versions."""
BLANKS: dict[str, Any] = {"f": np.nan, "i": 0, "S": b""}
"""Value of a case without one, by the kind of the type."""


def columns_of(scene: Scene) -> dict[str, tuple[str, str]]:
    """The :data:`COLUMNS` of a scene's sweep, those of its points, "tip.ux.ratio_2_1", and those of
    tips and the clamp that it requests."""
    asked = observable_names(
        required_flags=REQUIRES_FRICTION
    ) * scene.has_friction + asked_quantities(scene)
    at_points = {
        f"{point}.{name}": (unit, "f8")
        for point in scene.point_names
        for name, unit in (AT_POINTS | PHASES).items()
    }
    return COLUMNS | {name: (UNIT_BY_NAME[name], "f8") for name in asked} | at_points


class SweepFile:
    """A sweep's file, open for writing; continued if it exists, else made.

    ``harmonics`` and ``rows`` are upper bounds for all cases, ``omitted`` names what is not asked
    of them. Raises InputError if the file cannot be written, cases are left and another program is
    writing it, it is not a sweep of this scene, or other cases would have other columns than those
    in it.

    Attributes
    ----------
    made : bool
        True if it is new.
    stored : Stored
        Where everything is in it.
    state : array of int
        In the shape of the axes; of damaged cases State.PENDING.
    """

    def __init__(
        self, path: Path, scene: Scene, harmonics: int, rows: int, omitted: Sequence[str] = ()
    ) -> None:
        self._path, self._columns = path, columns_of(scene)
        with report_write_errors(
            path, "path", "a file that can be written, by one sweep at a time"
        ):
            made = None if os.path.lexists(path) else _made(path, scene, harmonics, rows, omitted)
            regular_file_size(path, None, follows_links=False)  # nothing is written elsewhere
            self._file = os.open(path, os.O_RDWR)
            try:
                busy = _lock(self._file)
                self.stored = made or _of_scene(path, scene)
                self.state = _whole_cases(self.stored, scene)
                if np.any(self.state == State.PENDING):  # else nothing is written
                    if busy:
                        raise busy
                    _check_omitted(self.stored, omitted)
            except BaseException:
                os.close(self._file)
                raise
        self.made = made is not None

    def record(self, numbers: np.ndarray, cases: Sequence[Mapping[str, Any]]) -> None:
        """Write those of some cases that are not complete: some of its columns each, and its waves
        if it converged; by their numbers (n,).

        Raises
        ------
        InputError
            The disk is full, or the file is no longer where it was; what was written before stays.
        """
        left = np.flatnonzero(self.state.flat[numbers] == State.PENDING)
        if len(left):
            self.write(numbers[left], [cases[place] for place in left])

    def write(self, places: np.ndarray, cases: Sequence[Mapping[str, Any]]) -> None:
        """Write cases of some numbers (n,): all that is known of them, then their states."""
        if not self._is_there():
            allowed = "left alone while the sweep runs; it has been removed or replaced"
            raise WriteError("path", str(self._path), allowed)
        state = np.array([State.CONVERGED if "gap" in case else State.FAILED for case in cases])
        waves = {name: [case.get(name, np.zeros((0, 0))) for case in cases] for name in WAVES}
        columns = {}
        for name in self._columns:
            kind = self.stored.columns[name].dtype
            given = [_stored(case.get(name, BLANKS[kind.kind]), kind.itemsize) for case in cases]
            columns[name] = np.array(given, kind)
        checksums = [_of_waves(*both) for both in zip(*waves.values(), strict=True)]
        columns[WAVES_CHECKSUM] = np.array(checksums, "u4")
        columns[CHECKSUM] = _of_cases(columns, state)
        with report_write_errors(self._path, "path"):
            self._put("state", places, np.full(len(state), State.PENDING))
            for name, arrays in waves.items():
                if name in self.stored.columns:
                    self._put(name, places, _padded(arrays, self.stored.columns[name].shape[-1]))
            for name, values in columns.items():  # the checksum last, which confirms a case
                self._put(name, places, values)
            self._put("state", places, state)
        self.state.flat[places] = state

    def close(self, *, remove: bool = False) -> None:
        """Close the file, or remove it; raises InputError where that reports an error."""
        with report_write_errors(self._path, "path"):
            if remove and self._is_there():
                self._path.unlink()
            os.close(self._file)

    def _put(self, name: str, places: np.ndarray, values: np.ndarray) -> None:
        """Write the first values of some cases in a column or a wave."""
        column = self.stored.columns[name]
        size = column.size // self.state.size
        rows = np.ascontiguousarray(values, column.dtype).view("u1").reshape(len(values), -1)
        for number, row in zip(places, rows, strict=True):  # a word by itself would lose its end
            write_bytes_at(self._file, row.tobytes(), column.offset + int(number) * size)

    def _is_there(self) -> bool:
        """Return True if the name still leads to the file."""
        try:
            return os.path.samestat(os.fstat(self._file), os.stat(self._path))
        except OSError:
            return False


def _lock(file: int) -> OSError | None:
    """Lock an open file, or return the error where another program has locked it."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        return error
    return None


def _padded(arrays: list[np.ndarray], pairs: int) -> np.ndarray:
    """Waves of some cases as one array, nan where one has fewer rows or pairs."""
    found = np.full((len(arrays), max(map(len, arrays)), pairs), np.nan)
    for whole, array in zip(found, arrays, strict=True):
        whole[: array.shape[0], : array.shape[1]] = array
    return found


def _stored(value: Any, size: int) -> Any:
    """A value for the file: words are encoded and cut to some bytes, between characters."""
    if not isinstance(value, str):
        return value
    return value.encode()[:size].decode("utf-8", "ignore").encode()


def _made(
    path: Path, scene: Scene, harmonics: int, rows: int, omitted: Sequence[str]
) -> store.StoredFile | None:
    """A new file; None where another program has been quicker."""
    shape = scene.given("sweep").shape
    sizes = {name: (unit, kind, shape) for name, (unit, kind) in _kept(scene).items()}
    if rows:
        wave = (*shape, 2 * harmonics + 1, rows)
        sizes |= {name: (unit, "f8", wave) for name, unit in WAVES.items()}
    with contextlib.suppress(FileExistsError):
        with (
            partial_file(path, must_be_new=True) as partial,
            open(partial, "wb", buffering=0) as whole,
            open(os.memfd_create("sweep"), "w+b", buffering=0) as image,  # zeros take no memory
        ):
            least = (math.prod(size) * np.dtype(kind).itemsize for _, kind, size in sizes.values())
            whole.truncate(sum(least))  # OSError where files are limited, which HDF5 would meet
            stored = _image(image, path, scene, sizes, omitted)
            _copy_written(image.fileno(), whole.fileno())
        return stored
    return None


def _image(
    image: BinaryIO,
    path: Path,
    scene: Scene,
    sizes: Mapping[str, tuple[str, str, tuple[int, ...]]],
    omitted: Sequence[str],
) -> store.StoredFile:
    """Write a new file with datasets of some units, types and shapes; its header."""
    import h5py  # what only reads has its reader

    with h5py.File(image, "w", libver="earliest") as file:
        store.write_header(file, KIND, scene)
        file.attrs["omitted"] = " ".join(omitted)
        texts, columns = (
            store.attribute_texts(file),
            {},
        )  # kept as written: to read them takes longer
        for name, (unit, kind, size) in sizes.items():
            plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            plan.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
            plan.set_fill_time(h5py.h5d.FILL_TIME_NEVER)  # a new file is zero: pending
            column = file.create_dataset(name, size, kind, dcpl=plan)
            said = {"unit": unit} | ({"about": words} if (words := _words(name)) else {})
            for key, text in said.items():
                column.attrs[key] = texts[f"{name}/{key}"] = text
            columns[name] = store.locate_column(column)
        texts["digest"] = store.content_digest(texts, store.column_texts(columns))
        file.attrs["digest"] = texts["digest"]
        return store.StoredFile(path, texts, {}, columns)


def _copy_written(image: int, whole: int) -> None:
    """Copy what has been written of an open file to another, and its size; OSError."""
    size, end = os.fstat(image).st_size, 0
    os.truncate(whole, size)
    while end < size:
        try:
            first = os.lseek(image, end, os.SEEK_DATA)
        except OSError:  # zeros alone
            return
        end = os.lseek(image, first, os.SEEK_HOLE)
        write_bytes_at(whole, os.pread(image, end - first, first), first)


def _words(name: str) -> str:
    """Describe a column or a wave; "" where its name does."""
    if name in WAVES:
        return f"axes of the sweep; {describe_dataset(f'{name}_coefficients', {})['about']}"
    quantity = "amplitude" if name == "response" else name.rpartition(".")[2]
    known = {name: row.words for name, row in OBSERVABLES_BY_NAME.items()}
    return known.get(quantity) or NATURAL.get(quantity, ("",))[0]


def _of_waves(gap: np.ndarray, force: np.ndarray) -> int:
    """Checksum of the waves of a case."""
    return zlib.crc32(force.tobytes(), zlib.crc32(gap.tobytes()))


def _of_cases(columns: Mapping[str, np.ndarray], state: np.ndarray) -> np.ndarray:
    """Checksums of cases (n,), of columns of theirs and a state each."""
    found, count = np.zeros(len(state), dtype="u4"), 4096  # at once, for their rows take memory
    for start in range(0, len(state), count):
        block = slice(start, start + count)
        parts = [column[block] for column in (*columns.values(), state.astype("u1"))]
        rows = np.hstack([part.view("u1").reshape(len(part), -1) for part in parts])
        found[block] = [zlib.crc32(row) or 1 for row in rows]
    return found


def _of_scene(path: Path, scene: Scene) -> store.StoredFile:
    """The header of a file; InputError unless it is the sweep of a scene by this version of the
    program."""
    stored = store.read_header(path)
    stored.check_kind(KIND)
    begun = stored.scene()
    asked = Scene.from_text(store.scene_text(scene), str(path))  # both with full paths
    if begun is None or begun.replace(UNUSED) != asked.replace(UNUSED):
        there = differences([begun, asked])[0] if begun is not None else ""
        value = f"{path}{there and f', begun with {there}'}"
        allowed = "the file of the same scene; for another one choose a new folder"
        raise InputError("path", value, allowed)
    if (version := stored.attributes["version"]) != VERSION:
        raise stored.refusal(f"a new name: it was begun by version {version}, this is {VERSION}")
    stored.check_files(begun)
    if not _kept(scene).keys() <= stored.columns.keys():
        raise stored.refusal("a whole sweep")
    scene_of(stored)
    return stored


def _check_omitted(stored: store.StoredFile, omitted: Sequence[str]) -> None:
    """Raise InputError where more or less was asked of the cases in a file than is of its others;
    that is not known of older files."""
    begun = stored.attributes.get("omitted", " ".join(omitted)).split()
    differ = [f"{name}={name not in begun}" for name in sorted({*begun} ^ {*omitted})]
    if differ:
        value = f"{stored.path}, begun with {', '.join(differ)}"
        allowed = "continued as it was begun; for other columns choose a new folder"
        raise InputError("path", value, allowed)


# --- reading --------------------------------------------------------------------------------------


def _kept(scene: Scene) -> dict[str, tuple[str, str]]:
    """Unit and type of all that is kept of each case beside its waves."""
    checksums = dict.fromkeys((WAVES_CHECKSUM, CHECKSUM), ("", "u4"))
    return {"state": ("", "u1")} | columns_of(scene) | checksums


def scene_of(stored: store.StoredFile) -> Scene:
    """Return the scene of a sweep's file; InputError unless all its columns fit it."""
    stored.check_kind(KIND)
    scene = stored.scene()
    if scene is None or scene.sweep is None:
        raise stored.refusal("a sweep with its scene")
    total, column_formats = 0, _kept(scene)
    for name in sorted(column_formats.keys() & (stored.columns.keys() | REQUIRED_COLUMNS)):
        column = stored.columns.get(name)
        if column is None:
            requirement = f"a sweep with a column {name!r}: this one is of an older version"
            raise stored.refusal(f"{requirement}; solve it anew in another folder")
        column_type = np.dtype(column_formats[name][1])
        if column.shape != scene.given("sweep").shape or column.dtype != column_type:
            raise stored.refusal("a whole sweep")
        total += column.size
    if total > MAX_FILE_BYTES:
        raise stored.refusal(f"a sweep with at most {MAX_FILE_BYTES} bytes of columns")
    return scene


def _cases(stored: store.StoredFile, scene: Scene) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """``state`` and the columns (n,) of all cases, and which of them are damaged.

    The state is the one that the checksum confirms: with another one, or none, a case is pending.
    """
    columns, damaged = _confirmed(_numbers(stored, scene))
    if damaged.any():  # or is being written at this moment
        columns, again = _confirmed(_numbers(stored, scene))
        damaged &= again
    return columns, damaged


def _numbers(stored: store.StoredFile, scene: Scene) -> dict[str, np.ndarray]:
    """All that is kept of each case (n,), beside its waves."""
    try:  # the state first: what is written later counts as pending
        names = [name for name in _kept(scene) if name in stored.columns]
        return {name: stored.columns[name].read_numbers(stored.path).ravel() for name in names}
    except (OSError, ValueError):
        raise stored.refusal("a whole sweep") from None


def _confirmed(found: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The columns of all cases with the state that the checksum confirms, and which it does not."""
    stated, known = found.pop("state"), found.pop(CHECKSUM)
    begun, state = np.flatnonzero(known), np.full(len(stated), State.PENDING, stated.dtype)
    own = {name: values[begun] for name, values in found.items()}
    for one in (State.CONVERGED, State.FAILED):
        same = _of_cases(own, np.full(len(begun), one)) == known[begun]
        state[begun[same]] = one
    return {"state": state} | found, (state == State.PENDING) & (stated != State.PENDING)


def _whole_cases(stored: store.StoredFile, scene: Scene) -> np.ndarray:
    """The state of each case in the shape of the axes; of damaged ones State.PENDING."""
    state: np.ndarray = _cases(stored, scene)[0]["state"].reshape(scene.given("sweep").shape)
    for index in np.argwhere(state == State.CONVERGED):
        if _waves(stored, tuple(map(int, index))) is None:
            state[tuple(index)] = State.PENDING
    return state


def read_columns(stored: store.StoredFile, scene: Scene) -> dict[str, np.ndarray]:
    """``state`` and the columns in the shape of the axes.

    Pending cases, and columns that an earlier version did not write, have nan, 0 in columns of
    whole numbers, and empty words.
    """
    columns, damaged = _cases(stored, scene)
    shape, found = scene.given("sweep").shape, {}
    if damaged.any():
        first = tuple(map(int, np.unravel_index(int(np.argmax(damaged)), shape)))
        cases = f"{damaged.sum()} of its cases are damaged, the first at {first}"
        raise stored.refusal(f"a whole sweep: {cases}; the command sweep computes them again")
    for name, (_, kind) in ({"state": ("", "u1")} | columns_of(scene)).items():
        values = columns.get(name, np.full(math.prod(shape), BLANKS.get(kind[0], 0), kind))
        if name != "state":
            values[columns["state"] == State.PENDING] = BLANKS[values.dtype.kind]
        words = values.dtype.kind == "S"
        found[name] = np.char.decode(values, "utf-8", "replace") if words else values
        found[name] = found[name].reshape(shape)
    return found


def read_waves(path: Path, index: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Gap [m] and force [N] coefficients of a case that converged, with friction tangential ones
    behind the normal ones: (2H+1, n_rows) each."""
    stored = store.read_header(path)
    stored.check_kind(KIND)
    found = _waves(stored, index)
    if found is None:
        allowed = f"a whole sweep: its case {index} is damaged; the command sweep computes it again"
        raise stored.refusal(allowed)
    return found


def _waves(
    stored: store.StoredFile, index: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray] | None:
    """The same, or None if they are damaged."""
    columns, path, found = stored.columns, stored.path, []
    try:
        case = int(np.ravel_multi_index(index, columns["state"].shape))
        rows = 2 * int(columns["harmonics"].read_numbers(path, case, 1)[0]) + 1
        known = columns[WAVES_CHECKSUM].read_numbers(path, case, 1)[0]
        for name in WAVES:
            most, pairs = columns[name].shape[-2:] if name in columns else (rows, 0)
            first = case * most * pairs
            wave = columns[name].read_numbers(path, first, rows * pairs) if pairs else np.zeros(0)
            found.append(wave.reshape(rows, pairs))
    except (OSError, ValueError, KeyError):
        return None
    own = np.isfinite(found[0][0])
    gap, force = (np.ascontiguousarray(wave[:, own]) for wave in found)
    return (gap, force) if rows <= most and _of_waves(gap, force) == known else None
