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

from fenics_crack.basics.atomic_files import put, reported, whole_file
from fenics_crack.basics.errors import FEW_MODES, InputError, WriteError
from fenics_crack.basics.observables import FRICTION, QUANTITIES, Place, names_of
from fenics_crack.basics.tables import UNITS
from fenics_crack.basics.untrusted_files import MOST_BYTES, bytes_of
from fenics_crack.files import store
from fenics_crack.files.store import about
from fenics_crack.scene.scene import RESULT_TABLES, Scene, quantities_on_request
from fenics_crack.scene.words import describe_differences
from fenics_crack.version import VERSION

KIND = "sweep"


class State(IntEnum):
    """State of a case."""

    PENDING = 0
    CONVERGED = 1
    FAILED = 2


UNDECIDED_PREFIX = "undecided: "
"""Beginning, in the status of a case, of the reason for undecided stability."""
CONTRADICTION_PREFIX = "; yet "
"""Beginning of the remark that more modes contradict the verdict."""


def load_column_name(quantity: str) -> str:
    """The column of a quantity at the load's point in the load's direction."""
    return "response" if quantity == "amplitude" else quantity


MODE_NUMBERS = range(1, FEW_MODES + 1)
"""Numbers of the modes whose natural frequencies are kept of each case."""
NATURAL_FREQUENCY_COLUMNS = {
    f"omega_{lips}_{mode}": (words.format(mode), "rad/s")
    for lips, words in (
        ("open", "natural frequency {}, crack open"),
        ("tied", "natural frequency {}, crack bonded"),
        ("bilinear", "bilinear frequency of open mode {}"),
    )
    for mode in MODE_NUMBERS
}
"""Words and unit of these frequencies."""
POINT_QUANTITY_UNITS = {
    name: UNITS[name] for name in names_of(Place.POINT) if name != "ratio_half_1"
}
"""Quantities kept of each point and direction, and their units: no case has a longer period."""
KEPT_ORDERS = (1, 2, 3, 4, 5, 6)
"""Harmonics of which the parts are kept."""
HARMONIC_PART_UNITS = {
    f"{part}_{order}": "m" for order in KEPT_ORDERS for part in ("cosine", "sine")
}
"""Parts of the harmonics kept likewise, of whose amplitudes ``harmonic_1`` to ``harmonic_3``."""
CASE_COLUMN_FORMATS: dict[str, tuple[str, str]] = {
    **{
        load_column_name(name): (unit, "f8")
        for name, unit in (POINT_QUANTITY_UNITS | HARMONIC_PART_UNITS).items()
    },
    **{name: (UNITS[name], "f8") for name in names_of(Place.FACES, Place.MODES, without=FRICTION)},
    **{name: (unit, "f8") for name, (_, unit) in NATURAL_FREQUENCY_COLUMNS.items()},
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
UNUSED_TABLE_REMOVALS = dict.fromkeys(
    name for name in RESULT_TABLES if name not in ("sweep", "output", "growth")
)
"""Tables that no case depends on; without them."""
WAVE_UNITS = {"gap": "m", "force": "N"}
"""Coefficients kept of a case that converged, and their units."""
WAVES_CHECKSUM_COLUMN, CASE_CHECKSUM_COLUMN = "waves_checksum", "checksum"
"""Columns: CRC-32 of the waves of a case; and of all its columns and its state, never 0."""
REQUIRED_COLUMNS = {"state", WAVES_CHECKSUM_COLUMN, CASE_CHECKSUM_COLUMN, "harmonics"}
"""Columns without which no file is read; others may be missing in those of earlier versions."""
BLANK_VALUE_BY_KIND: dict[str, Any] = {"f": np.nan, "i": 0, "S": b""}
"""Value of a case without one, by the kind of the type."""


def column_formats_of(scene: Scene) -> dict[str, tuple[str, str]]:
    """The :data:`COLUMNS` of a scene's sweep, those of its points, "tip.ux.ratio_2_1", and those of
    tips and the clamp that it requests."""
    requested_names = names_of(where=FRICTION) * scene.has_friction + quantities_on_request(scene)
    point_formats = {
        f"{point}.{name}": (unit, "f8")
        for point in scene.point_names
        for name, unit in (POINT_QUANTITY_UNITS | HARMONIC_PART_UNITS).items()
    }
    return (
        CASE_COLUMN_FORMATS
        | {name: (UNITS[name], "f8") for name in requested_names}
        | point_formats
    )


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
        self,
        path: Path,
        scene: Scene,
        max_harmonics: int,
        max_gap_rows: int,
        omitted: Sequence[str] = (),
    ) -> None:
        self._path, self._column_formats = path, column_formats_of(scene)
        with reported(path, "path", "a file that can be written, by one sweep at a time"):
            new_sweep = (
                None
                if os.path.lexists(path)
                else _make_file(path, scene, max_harmonics, max_gap_rows, omitted)
            )
            bytes_of(path, None, links=False)  # nothing is written elsewhere
            self._descriptor = os.open(path, os.O_RDWR)
            try:
                lock_error = _lock_file(self._descriptor)
                self.stored_sweep = new_sweep or _read_matching_header(path, scene)
                self.case_states = _read_intact_states(self.stored_sweep, scene)
                if np.any(self.case_states == State.PENDING):  # else nothing is written
                    if lock_error:
                        raise lock_error
                    _check_omitted(self.stored_sweep, omitted)
            except BaseException:
                os.close(self._descriptor)
                raise
        self.is_new = new_sweep is not None

    def record(self, case_numbers: np.ndarray, cases: Sequence[Mapping[str, Any]]) -> None:
        """Write those of some cases that are not complete: some of its columns each, and its waves
        if it converged; by their numbers (n,).

        Raises
        ------
        InputError
            The disk is full, or the file is no longer where it was; what was written before stays.
        """
        pending_positions = np.flatnonzero(self.case_states.flat[case_numbers] == State.PENDING)
        if len(pending_positions):
            self.write(
                case_numbers[pending_positions], [cases[position] for position in pending_positions]
            )

    def write(self, case_numbers: np.ndarray, cases: Sequence[Mapping[str, Any]]) -> None:
        """Write cases of some numbers (n,): all that is known of them, then their states."""
        if not self._is_in_place():
            requirement = "left alone while the sweep runs; it has been removed or replaced"
            raise WriteError("path", str(self._path), requirement)
        case_states = np.array(
            [State.CONVERGED if "gap" in case else State.FAILED for case in cases]
        )
        waves_by_name = {
            name: [case.get(name, np.zeros((0, 0))) for case in cases] for name in WAVE_UNITS
        }
        column_by_name = {}
        for name in self._column_formats:
            column_type = self.stored_sweep.columns[name].dtype
            encoded_values = [
                _encode_value(
                    case.get(name, BLANK_VALUE_BY_KIND[column_type.kind]), column_type.itemsize
                )
                for case in cases
            ]
            column_by_name[name] = np.array(encoded_values, column_type)
        wave_checksums = [
            _compute_waves_checksum(*gap_and_force)
            for gap_and_force in zip(*waves_by_name.values(), strict=True)
        ]
        column_by_name[WAVES_CHECKSUM_COLUMN] = np.array(wave_checksums, "u4")
        column_by_name[CASE_CHECKSUM_COLUMN] = _compute_case_checksums(column_by_name, case_states)
        with reported(self._path, "path"):
            self._write_column("state", case_numbers, np.full(len(case_states), State.PENDING))
            for name, waves in waves_by_name.items():
                if name in self.stored_sweep.columns:
                    padded_waves = _pad_waves(waves, self.stored_sweep.columns[name].shape[-1])
                    self._write_column(name, case_numbers, padded_waves)
            for name, values in column_by_name.items():  # the checksum last, which confirms a case
                self._write_column(name, case_numbers, values)
            self._write_column("state", case_numbers, case_states)
        self.case_states.flat[case_numbers] = case_states

    def close(self, *, remove: bool = False) -> None:
        """Close the file, or remove it; raises InputError where that reports an error."""
        with reported(self._path, "path"):
            if remove and self._is_in_place():
                self._path.unlink()
            os.close(self._descriptor)

    def _write_column(self, name: str, case_numbers: np.ndarray, values: np.ndarray) -> None:
        """Write the first values of some cases in a column or a wave."""
        column = self.stored_sweep.columns[name]
        bytes_per_case = column.size // self.case_states.size
        byte_rows = np.ascontiguousarray(values, column.dtype).view("u1").reshape(len(values), -1)
        # Bytes of rows: NumPy drops trailing zeros from a single text.
        for case_number, case_bytes in zip(case_numbers, byte_rows, strict=True):
            offset = column.offset + int(case_number) * bytes_per_case
            put(self._descriptor, case_bytes.tobytes(), offset)

    def _is_in_place(self) -> bool:
        """Return True if the name still leads to the file."""
        try:
            return os.path.samestat(os.fstat(self._descriptor), os.stat(self._path))
        except OSError:
            return False


def _lock_file(descriptor: int) -> OSError | None:
    """Lock an open file, or return the error where another program has locked it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        return error
    return None


def _pad_waves(waves: list[np.ndarray], n_columns: int) -> np.ndarray:
    """Waves of some cases as one array, nan where one has fewer rows or pairs."""
    padded_waves = np.full((len(waves), max(map(len, waves)), n_columns), np.nan)
    for padded_wave, wave in zip(padded_waves, waves, strict=True):
        padded_wave[: wave.shape[0], : wave.shape[1]] = wave
    return padded_waves


def _encode_value(value: Any, max_bytes: int) -> Any:
    """A value for the file: words are encoded and cut to some bytes, between characters."""
    if not isinstance(value, str):
        return value
    return value.encode()[:max_bytes].decode("utf-8", "ignore").encode()


def _make_file(
    path: Path, scene: Scene, max_harmonics: int, max_gap_rows: int, omitted: Sequence[str]
) -> store.Stored | None:
    """A new file; None where another program has been quicker."""
    shape = scene.given("sweep").shape
    dataset_formats = {
        name: (unit, type_name, shape)
        for name, (unit, type_name) in _stored_column_formats(scene).items()
    }
    if max_gap_rows:
        wave_shape = (*shape, 2 * max_harmonics + 1, max_gap_rows)
        dataset_formats |= {name: (unit, "f8", wave_shape) for name, unit in WAVE_UNITS.items()}
    with contextlib.suppress(FileExistsError):
        with (
            whole_file(path, new=True) as hidden_path,
            open(hidden_path, "wb", buffering=0) as new_file,
            open(os.memfd_create("sweep"), "w+b", buffering=0) as image,  # zeros take no memory
        ):
            dataset_bytes = (
                math.prod(dataset_shape) * np.dtype(type_name).itemsize
                for _, type_name, dataset_shape in dataset_formats.values()
            )
            # OSError here if file sizes are limited; HDF5 would meet the limit later.
            new_file.truncate(sum(dataset_bytes))
            stored = _write_image(image, path, scene, dataset_formats, omitted)
            _copy_written_parts(image.fileno(), new_file.fileno())
        return stored
    return None


def _write_image(
    image: BinaryIO,
    path: Path,
    scene: Scene,
    dataset_formats: Mapping[str, tuple[str, str, tuple[int, ...]]],
    omitted: Sequence[str],
) -> store.Stored:
    """Write a new file with datasets of some units, types and shapes; its header."""
    import h5py  # what only reads has its reader

    with h5py.File(image, "w", libver="earliest") as file:
        store.write_header(file, KIND, scene)
        file.attrs["omitted"] = " ".join(omitted)
        # Kept as written, since reading them takes longer.
        attribute_by_path, columns = store.texts(file), {}
        for name, (unit, type_name, dataset_shape) in dataset_formats.items():
            creation_properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            creation_properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
            # A new file has zeros: State.PENDING.
            creation_properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
            column = file.create_dataset(name, dataset_shape, type_name, dcpl=creation_properties)
            description = _describe_column(name)
            attribute_texts = {"unit": unit} | ({"about": description} if description else {})
            for attribute_name, text in attribute_texts.items():
                column.attrs[attribute_name] = attribute_by_path[f"{name}/{attribute_name}"] = text
            columns[name] = store.column_of(column)
        attribute_by_path["digest"] = store.digest(attribute_by_path, store.places(columns))
        file.attrs["digest"] = attribute_by_path["digest"]
        return store.Stored(path, attribute_by_path, {}, columns)


def _copy_written_parts(image_descriptor: int, target_descriptor: int) -> None:
    """Copy what has been written of an open file to another, and its size; OSError."""
    image_size, part_end = os.fstat(image_descriptor).st_size, 0
    os.truncate(target_descriptor, image_size)
    while part_end < image_size:
        try:
            part_start = os.lseek(image_descriptor, part_end, os.SEEK_DATA)
        except OSError:  # zeros alone
            return
        part_end = os.lseek(image_descriptor, part_start, os.SEEK_HOLE)
        put(
            target_descriptor,
            os.pread(image_descriptor, part_end - part_start, part_start),
            part_start,
        )


def _describe_column(name: str) -> str:
    """Describe a column or a wave; "" where its name does."""
    if name in WAVE_UNITS:
        return f"axes of the sweep; {about(f'{name}_coefficients', {})['about']}"
    quantity = "amplitude" if name == "response" else name.rpartition(".")[2]
    words_by_quantity = {name: row.words for name, row in QUANTITIES.items()}
    return words_by_quantity.get(quantity) or NATURAL_FREQUENCY_COLUMNS.get(quantity, ("",))[0]


def _compute_waves_checksum(gap: np.ndarray, force: np.ndarray) -> int:
    """Checksum of the waves of a case."""
    return zlib.crc32(force.tobytes(), zlib.crc32(gap.tobytes()))


def _compute_case_checksums(
    column_by_name: Mapping[str, np.ndarray], case_states: np.ndarray
) -> np.ndarray:
    """Checksums of cases (n,), of columns of theirs and a state each."""
    # Rows of bytes take memory: make few at once.
    checksums, n_block_cases = np.zeros(len(case_states), dtype="u4"), 4096
    for start in range(0, len(case_states), n_block_cases):
        block = slice(start, start + n_block_cases)
        block_columns = [
            column[block] for column in (*column_by_name.values(), case_states.astype("u1"))
        ]
        byte_rows = np.hstack(
            [
                block_column.view("u1").reshape(len(block_column), -1)
                for block_column in block_columns
            ]
        )
        checksums[block] = [zlib.crc32(case_bytes) or 1 for case_bytes in byte_rows]
    return checksums


def _read_matching_header(path: Path, scene: Scene) -> store.Stored:
    """The header of a file; InputError unless it is the sweep of a scene by this version of the
    program."""
    stored = store.header(path)
    stored.fitting_argument(KIND)
    stored_scene = stored.scene()
    requested_scene = Scene.from_text(store.scene_text(scene), str(path))  # both with full paths
    if stored_scene is None or stored_scene.replace(
        UNUSED_TABLE_REMOVALS
    ) != requested_scene.replace(UNUSED_TABLE_REMOVALS):
        difference_text = (
            describe_differences([stored_scene, requested_scene])[0]
            if stored_scene is not None
            else ""
        )
        path_text = f"{path}{difference_text and f', begun with {difference_text}'}"
        requirement = "the file of the same scene; for another one choose a new folder"
        raise InputError("path", path_text, requirement)
    if (version := stored.attributes["version"]) != VERSION:
        raise stored.refused(f"a new name: it was begun by version {version}, this is {VERSION}")
    stored.check_files(stored_scene)
    if not _stored_column_formats(scene).keys() <= stored.columns.keys():
        raise stored.refused("a whole sweep")
    scene_of_sweep(stored)
    return stored


def _check_omitted(stored: store.Stored, omitted: Sequence[str]) -> None:
    """Raise InputError where more or less was asked of the cases in a file than is of its others;
    that is not known of older files."""
    stored_omissions = stored.attributes.get("omitted", " ".join(omitted)).split()
    changed_options = [
        f"{name}={name not in stored_omissions}"
        for name in sorted({*stored_omissions} ^ {*omitted})
    ]
    if changed_options:
        path_text = f"{stored.path}, begun with {', '.join(changed_options)}"
        requirement = "continued as it was begun; for other columns choose a new folder"
        raise InputError("path", path_text, requirement)


# --- reading --------------------------------------------------------------------------------------


def _stored_column_formats(scene: Scene) -> dict[str, tuple[str, str]]:
    """Unit and type of all that is kept of each case beside its waves."""
    checksums = dict.fromkeys((WAVES_CHECKSUM_COLUMN, CASE_CHECKSUM_COLUMN), ("", "u4"))
    return {"state": ("", "u1")} | column_formats_of(scene) | checksums


def scene_of_sweep(stored: store.Stored) -> Scene:
    """Return the scene of a sweep's file; InputError unless all its columns fit it."""
    stored.fitting_argument(KIND)
    scene = stored.scene()
    if scene is None or scene.sweep is None:
        raise stored.refused("a sweep with its scene")
    n_bytes, column_formats = 0, _stored_column_formats(scene)
    for name in sorted(column_formats.keys() & (stored.columns.keys() | REQUIRED_COLUMNS)):
        column = stored.columns.get(name)
        if column is None:
            requirement = f"a sweep with a column {name!r}: this one is of an older version"
            raise stored.refused(f"{requirement}; solve it anew in another folder")
        column_type = np.dtype(column_formats[name][1])
        if column.shape != scene.given("sweep").shape or column.dtype != column_type:
            raise stored.refused("a whole sweep")
        n_bytes += column.size
    if n_bytes > MOST_BYTES:
        raise stored.refused(f"a sweep with at most {MOST_BYTES} bytes of columns")
    return scene


def _read_cases(stored: store.Stored, scene: Scene) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """``state`` and the columns (n,) of all cases, and which of them are damaged.

    The state is the one that the checksum confirms: with another one, or none, a case is pending.
    """
    column_by_name, is_damaged = _confirm_states(_read_flat_columns(stored, scene))
    if is_damaged.any():  # or is being written at this moment
        column_by_name, is_damaged_again = _confirm_states(_read_flat_columns(stored, scene))
        is_damaged &= is_damaged_again
    return column_by_name, is_damaged


def _read_flat_columns(stored: store.Stored, scene: Scene) -> dict[str, np.ndarray]:
    """All that is kept of each case (n,), beside its waves."""
    try:  # the state first: what is written later counts as pending
        names = [name for name in _stored_column_formats(scene) if name in stored.columns]
        return {name: stored.columns[name].of(stored.path).ravel() for name in names}
    except (OSError, ValueError):
        raise stored.refused("a whole sweep") from None


def _confirm_states(
    column_by_name: dict[str, np.ndarray],
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The columns of all cases with the state that the checksum confirms, and which it does not."""
    stored_states = column_by_name.pop("state")
    stored_checksums = column_by_name.pop(CASE_CHECKSUM_COLUMN)
    written_cases = np.flatnonzero(stored_checksums)
    case_states = np.full(len(stored_states), State.PENDING, stored_states.dtype)
    written_columns = {name: values[written_cases] for name, values in column_by_name.items()}
    for candidate_state in (State.CONVERGED, State.FAILED):
        is_confirmed = (
            _compute_case_checksums(written_columns, np.full(len(written_cases), candidate_state))
            == stored_checksums[written_cases]
        )
        case_states[written_cases[is_confirmed]] = candidate_state
    is_damaged = (case_states == State.PENDING) & (stored_states != State.PENDING)
    return {"state": case_states} | column_by_name, is_damaged


def _read_intact_states(stored: store.Stored, scene: Scene) -> np.ndarray:
    """The state of each case in the shape of the axes; of damaged ones State.PENDING."""
    case_states: np.ndarray = _read_cases(stored, scene)[0]["state"].reshape(
        scene.given("sweep").shape
    )
    for index in np.argwhere(case_states == State.CONVERGED):
        if _read_intact_waves(stored, tuple(map(int, index))) is None:
            case_states[tuple(index)] = State.PENDING
    return case_states


def read_columns(stored: store.Stored, scene: Scene) -> dict[str, np.ndarray]:
    """``state`` and the columns in the shape of the axes.

    Pending cases, and columns that an earlier version did not write, have nan, 0 in columns of
    whole numbers, and empty words.
    """
    flat_column_by_name, is_damaged = _read_cases(stored, scene)
    shape, column_by_name = scene.given("sweep").shape, {}
    if is_damaged.any():
        first_damaged_index = tuple(map(int, np.unravel_index(int(np.argmax(is_damaged)), shape)))
        damage_text = (
            f"{is_damaged.sum()} of its cases are damaged, the first at {first_damaged_index}"
        )
        raise stored.refused(f"a whole sweep: {damage_text}; the command sweep computes them again")
    for name, (_, type_name) in ({"state": ("", "u1")} | column_formats_of(scene)).items():
        values = flat_column_by_name.get(
            name, np.full(math.prod(shape), BLANK_VALUE_BY_KIND.get(type_name[0], 0), type_name)
        )
        if name != "state":
            values[flat_column_by_name["state"] == State.PENDING] = BLANK_VALUE_BY_KIND[
                values.dtype.kind
            ]
        is_text = values.dtype.kind == "S"
        column_by_name[name] = np.char.decode(values, "utf-8", "replace") if is_text else values
        column_by_name[name] = column_by_name[name].reshape(shape)
    return column_by_name


def read_waves(path: Path, index: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Gap [m] and force [N] coefficients of a case that converged, with friction tangential ones
    behind the normal ones: (2H+1, n_rows) each."""
    stored = store.header(path)
    stored.fitting_argument(KIND)
    waves = _read_intact_waves(stored, index)
    if waves is None:
        requirement = (
            f"a whole sweep: its case {index} is damaged; the command sweep computes it again"
        )
        raise stored.refused(requirement)
    return waves


def _read_intact_waves(
    stored: store.Stored, index: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray] | None:
    """The same, or None if they are damaged."""
    columns, path, waves = stored.columns, stored.path, []
    try:
        case_number = int(np.ravel_multi_index(index, columns["state"].shape))
        n_rows = 2 * int(columns["harmonics"].of(path, case_number, 1)[0]) + 1
        stored_checksum = columns[WAVES_CHECKSUM_COLUMN].of(path, case_number, 1)[0]
        for name in WAVE_UNITS:
            max_rows, n_columns = columns[name].shape[-2:] if name in columns else (n_rows, 0)
            wave_start = case_number * max_rows * n_columns
            n_values = n_rows * n_columns
            wave = columns[name].of(path, wave_start, n_values) if n_values else np.zeros(0)
            waves.append(wave.reshape(n_rows, n_columns))
    except (OSError, ValueError, KeyError):
        return None
    is_finite_column = np.isfinite(waves[0][0])
    gap, force = (np.ascontiguousarray(wave[:, is_finite_column]) for wave in waves)
    is_intact = n_rows <= max_rows and _compute_waves_checksum(gap, force) == stored_checksum
    return (gap, force) if is_intact else None
