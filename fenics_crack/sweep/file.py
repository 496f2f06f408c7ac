"""The file of a sweep: filled while the sweep runs, and valid after a kill at any time.

HDF5 keeps metadata in memory and decides when to write them. A program killed in between
leaves a file that cannot be opened, and a full disk ends HDF5 itself. So no metadata changes after
the file has its name, and HDF5 writes to memory only:

- The file is made under another name, closed, and renamed.
- Each dataset has its full size from the start, in one contiguous block at a fixed offset (early
  allocation). The oldest file format does not mark a file as open.
- A finished case overwrites the case's bytes: first all numbers, then ``state``. A case with a
  state is complete and not written again. A case that a kill left half written has no state and is
  computed again.
- Each case has a checksum for numbers and state. A damaged case is not read; a continued
  sweep computes it again.

Unwritten parts take no space if the file system supports sparse files. The file can be read while a
sweep writes it. A lock, also used by HDF5, keeps other sweeps from writing.
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
"""Text in a case's status before the reason for undecided stability."""
CONTRADICTION_PREFIX = "; yet "
"""Text in a case's status before the remark that more modes contradict the verdict."""


def load_column_name(quantity: str) -> str:
    """Return the column name for a quantity at the load, in the load's direction."""
    return "response" if quantity == "amplitude" else quantity


MODE_NUMBERS = range(1, FEW_MODES + 1)
"""Numbers of the modes whose natural frequencies each case keeps."""
NATURAL_FREQUENCY_COLUMNS = {
    f"omega_{lips}_{mode}": (words.format(mode), "rad/s")
    for lips, words in (
        ("open", "natural frequency {}, crack open"),
        ("tied", "natural frequency {}, crack bonded"),
        ("bilinear", "bilinear frequency of open mode {}"),
    )
    for mode in MODE_NUMBERS
}
"""Label and unit of natural frequencies, by column name."""
POINT_QUANTITY_UNITS = {
    name: UNITS[name] for name in names_of(Place.POINT) if name != "ratio_half_1"
}
"""Units of the quantities at each point and direction, by quantity.

``ratio_half_1`` is left out, since no case has a longer period.
"""
KEPT_ORDERS = (1, 2, 3, 4, 5, 6)
"""Orders of the harmonics whose cosine and sine parts are kept."""
HARMONIC_PART_UNITS = {
    f"{part}_{order}": "m" for order in KEPT_ORDERS for part in ("cosine", "sine")
}
"""Units of cosine and sine parts, by column name.

``harmonic_1`` to ``harmonic_3`` are the amplitudes for these parts.
"""
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
"""Unit and type of each column, without states, named points and quantities on request."""
UNUSED_TABLE_REMOVALS = dict.fromkeys(
    name for name in RESULT_TABLES if name not in ("sweep", "output", "growth")
)
"""Changes that remove the tables without effect on any case."""
WAVE_UNITS = {"gap": "m", "force": "N"}
"""Units of the coefficients that converged cases keep."""
WAVES_CHECKSUM_COLUMN, CASE_CHECKSUM_COLUMN = "waves_checksum", "checksum"
"""Columns with the CRC-32 of a case's waves, and of all columns and the state (never 0)."""
REQUIRED_COLUMNS = {"state", WAVES_CHECKSUM_COLUMN, CASE_CHECKSUM_COLUMN, "harmonics"}
"""Columns required in each file; files from earlier versions may lack further columns."""
BLANK_VALUE_BY_KIND: dict[str, Any] = {"f": np.nan, "i": 0, "S": b""}
"""Values that mean "no value", by the kind of the NumPy type."""


def column_formats_of(scene: Scene) -> dict[str, tuple[str, str]]:
    """Return unit and type of all columns for a scene's sweep, by name.

    Named points have columns such as "tip.ux.ratio_2_1".
    """
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
    """File of a sweep, open for writing; an existing file is continued.

    Parameters
    ----------
    path : Path
        File.
    scene : Scene
        Scene with its sweep.
    max_harmonics, max_gap_rows : int
        Upper bounds for all cases; without gap rows no waves are kept.
    omitted_options : sequence of str
        Options that the cases lack.

    Attributes
    ----------
    is_new : bool
        True if the file did not exist.
    sweep_header : Stored
        Header with the offset of each dataset.
    case_states : array of int
        States in the shape of the axes; State.PENDING for damaged cases.

    Raises
    ------
    InputError
        The file cannot be written, or holds another sweep or other columns.
        Or cases are pending while another program writes the file.
    """

    def __init__(
        self,
        path: Path,
        scene: Scene,
        max_harmonics: int,
        max_gap_rows: int,
        omitted_options: Sequence[str] = (),
    ) -> None:
        self._path, self._column_formats = path, column_formats_of(scene)
        with reported(path, "path", "a file that can be written, by one sweep at a time"):
            new_header = (
                None
                if os.path.lexists(path)
                else _make_file(path, scene, max_harmonics, max_gap_rows, omitted_options)
            )
            bytes_of(path, None, links=False)  # nothing is written elsewhere
            self._descriptor = os.open(path, os.O_RDWR)
            try:
                lock_error = _lock_file(self._descriptor)
                self.sweep_header = new_header or _read_matching_header(path, scene)
                self.case_states = _read_intact_states(self.sweep_header, scene)
                if np.any(self.case_states == State.PENDING):  # else nothing is written
                    if lock_error:
                        raise lock_error
                    _check_omitted(self.sweep_header, omitted_options)
            except BaseException:
                os.close(self._descriptor)
                raise
        self.is_new = new_header is not None

    def record(self, case_numbers: np.ndarray, cases: Sequence[Mapping[str, Any]]) -> None:
        """Write the given cases that are still pending.

        Parameters
        ----------
        case_numbers : (n,) int
            Numbers of the cases.
        cases : sequence of mappings
            Values by column name, with waves if a case converged.

        Raises
        ------
        InputError
            The disk is full, or the file was moved; earlier cases stay written.
        """
        pending_positions = np.flatnonzero(self.case_states.flat[case_numbers] == State.PENDING)
        if len(pending_positions):
            self.write(
                case_numbers[pending_positions], [cases[position] for position in pending_positions]
            )

    def write(self, case_numbers: np.ndarray, cases: Sequence[Mapping[str, Any]]) -> None:
        """Write cases by number (n,): all values first, then the states."""
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
            column_type = self.sweep_header.columns[name].dtype
            column_values = [
                _encode_value(
                    case.get(name, BLANK_VALUE_BY_KIND[column_type.kind]), column_type.itemsize
                )
                for case in cases
            ]
            column_by_name[name] = np.array(column_values, column_type)
        wave_checksums = [
            _compute_waves_checksum(*gap_and_force)
            for gap_and_force in zip(*waves_by_name.values(), strict=True)
        ]
        column_by_name[WAVES_CHECKSUM_COLUMN] = np.array(wave_checksums, "u4")
        column_by_name[CASE_CHECKSUM_COLUMN] = _compute_case_checksums(column_by_name, case_states)
        with reported(self._path, "path"):
            self._write_column("state", case_numbers, np.full(len(case_states), State.PENDING))
            for name, waves in waves_by_name.items():
                if name in self.sweep_header.columns:
                    padded_waves = _pad_waves(waves, self.sweep_header.columns[name].shape[-1])
                    self._write_column(name, case_numbers, padded_waves)
            for name, values in column_by_name.items():  # the checksum last, which confirms a case
                self._write_column(name, case_numbers, values)
            self._write_column("state", case_numbers, case_states)
        self.case_states.flat[case_numbers] = case_states

    def close(self, *, remove: bool = False) -> None:
        """Close the file, or remove it too; raise InputError on failure."""
        with reported(self._path, "path"):
            if remove and self._is_in_place():
                self._path.unlink()
            os.close(self._descriptor)

    def _write_column(self, name: str, case_numbers: np.ndarray, values: np.ndarray) -> None:
        """Write values of cases into a column or a wave, from each case's offset on."""
        column = self.sweep_header.columns[name]
        bytes_per_case = column.size // self.case_states.size
        byte_rows = np.ascontiguousarray(values, column.dtype).view("u1").reshape(len(values), -1)
        # Bytes of rows: NumPy drops trailing zeros from a single text.
        for case_number, case_bytes in zip(case_numbers, byte_rows, strict=True):
            offset = column.offset + int(case_number) * bytes_per_case
            put(self._descriptor, case_bytes.tobytes(), offset)

    def _is_in_place(self) -> bool:
        """Return True if the path still leads to the open file."""
        try:
            return os.path.samestat(os.fstat(self._descriptor), os.stat(self._path))
        except OSError:
            return False


def _lock_file(descriptor: int) -> OSError | None:
    """Lock an open file; return the error if another program holds the lock."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        return error
    return None


def _pad_waves(waves: list[np.ndarray], n_columns: int) -> np.ndarray:
    """Return waves as one array (n_waves, n_rows, n_columns), padded with nan."""
    padded_waves = np.full((len(waves), max(map(len, waves)), n_columns), np.nan)
    for padded_wave, wave in zip(padded_waves, waves, strict=True):
        padded_wave[: wave.shape[0], : wave.shape[1]] = wave
    return padded_waves


def _encode_value(value: Any, max_bytes: int) -> Any:
    """Return a value for the file: texts as UTF-8, cut between characters."""
    if not isinstance(value, str):
        return value
    return value.encode()[:max_bytes].decode("utf-8", "ignore").encode()


def _make_file(
    path: Path, scene: Scene, max_harmonics: int, max_gap_rows: int, omitted_options: Sequence[str]
) -> store.Stored | None:
    """Make a new file and return its header; None if another program made one first."""
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
            sweep_header = _write_image(image, path, scene, dataset_formats, omitted_options)
            _copy_written_parts(image.fileno(), new_file.fileno())
        return sweep_header
    return None


def _write_image(
    image: BinaryIO,
    path: Path,
    scene: Scene,
    dataset_formats: Mapping[str, tuple[str, str, tuple[int, ...]]],
    omitted_options: Sequence[str],
) -> store.Stored:
    """Write a new file's datasets to memory, and return the header.

    ``dataset_formats`` holds unit, type and shape by name.
    """
    import h5py  # what only reads has its reader

    with h5py.File(image, "w", libver="earliest") as file:
        store.write_header(file, KIND, scene)
        file.attrs["omitted"] = " ".join(omitted_options)
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
    """Copy the size and written parts of an open file to another; raises OSError."""
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
    """Return a description of a column or wave; empty if unknown."""
    if name in WAVE_UNITS:
        return f"axes of the sweep; {about(f'{name}_coefficients', {})['about']}"
    quantity = "amplitude" if name == "response" else name.rpartition(".")[2]
    words_by_quantity = {name: row.words for name, row in QUANTITIES.items()}
    return words_by_quantity.get(quantity) or NATURAL_FREQUENCY_COLUMNS.get(quantity, ("",))[0]


def _compute_waves_checksum(gap: np.ndarray, force: np.ndarray) -> int:
    """Return the checksum of a case's waves."""
    return zlib.crc32(force.tobytes(), zlib.crc32(gap.tobytes()))


def _compute_case_checksums(
    column_by_name: Mapping[str, np.ndarray], case_states: np.ndarray
) -> np.ndarray:
    """Return checksums of cases (n,) from their columns and states."""
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
    """Return a file's header; raise InputError unless it fits the scene and version."""
    sweep_header = store.header(path)
    sweep_header.fitting_argument(KIND)
    stored_scene = sweep_header.scene()
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
    if (version := sweep_header.attributes["version"]) != VERSION:
        raise sweep_header.refused(
            f"a new name: it was begun by version {version}, this is {VERSION}"
        )
    sweep_header.check_files(stored_scene)
    if not _stored_column_formats(scene).keys() <= sweep_header.columns.keys():
        raise sweep_header.refused("a whole sweep")
    scene_of_sweep(sweep_header)
    return sweep_header


def _check_omitted(sweep_header: store.Stored, omitted_options: Sequence[str]) -> None:
    """Raise InputError if a file was begun with other omitted options.

    Files from earlier versions do not state the options and are accepted.
    """
    stored_options = sweep_header.attributes.get("omitted", " ".join(omitted_options)).split()
    changed_options = [
        f"{name}={name not in stored_options}"
        for name in sorted({*stored_options} ^ {*omitted_options})
    ]
    if changed_options:
        path_text = f"{sweep_header.path}, begun with {', '.join(changed_options)}"
        requirement = "continued as it was begun; for other columns choose a new folder"
        raise InputError("path", path_text, requirement)


# --- reading --------------------------------------------------------------------------------------


def _stored_column_formats(scene: Scene) -> dict[str, tuple[str, str]]:
    """Return unit and type of all columns in a file, by name."""
    checksums = dict.fromkeys((WAVES_CHECKSUM_COLUMN, CASE_CHECKSUM_COLUMN), ("", "u4"))
    return {"state": ("", "u1")} | column_formats_of(scene) | checksums


def scene_of_sweep(sweep_header: store.Stored) -> Scene:
    """Return the scene in a sweep's file; raise InputError if columns do not fit."""
    sweep_header.fitting_argument(KIND)
    scene = sweep_header.scene()
    if scene is None or scene.sweep is None:
        raise sweep_header.refused("a sweep with its scene")
    n_bytes, column_formats = 0, _stored_column_formats(scene)
    for name in sorted(column_formats.keys() & (sweep_header.columns.keys() | REQUIRED_COLUMNS)):
        column = sweep_header.columns.get(name)
        if column is None:
            requirement = f"a sweep with a column {name!r}: this one is of an older version"
            raise sweep_header.refused(f"{requirement}; solve it anew in another folder")
        column_type = np.dtype(column_formats[name][1])
        if column.shape != scene.given("sweep").shape or column.dtype != column_type:
            raise sweep_header.refused("a whole sweep")
        n_bytes += column.size
    if n_bytes > MOST_BYTES:
        raise sweep_header.refused(f"a sweep with at most {MOST_BYTES} bytes of columns")
    return scene


def _read_cases(
    sweep_header: store.Stored, scene: Scene
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Read all cases, as flat columns, and find damaged ones.

    A case whose state has no matching checksum is pending.

    Returns
    -------
    column_by_name : dict of str to (n_cases,)
        ``state`` and all columns.
    is_damaged : (n_cases,) bool
        True for cases whose stored state does not match the checksum.
    """
    column_by_name, is_damaged = _confirm_states(_read_flat_columns(sweep_header, scene))
    if is_damaged.any():  # or is being written at this moment
        column_by_name, is_damaged_again = _confirm_states(_read_flat_columns(sweep_header, scene))
        is_damaged &= is_damaged_again
    return column_by_name, is_damaged


def _read_flat_columns(sweep_header: store.Stored, scene: Scene) -> dict[str, np.ndarray]:
    """Read all stored columns, (n_cases,) each, by name."""
    try:  # the state first: what is written later counts as pending
        names = [name for name in _stored_column_formats(scene) if name in sweep_header.columns]
        return {name: sweep_header.columns[name].of(sweep_header.path).ravel() for name in names}
    except (OSError, ValueError):
        raise sweep_header.refused("a whole sweep") from None


def _confirm_states(
    column_by_name: dict[str, np.ndarray],
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Replace stored states by states that match the checksums.

    Returns
    -------
    column_by_name : dict of str to (n_cases,)
        ``state`` and the columns, without the checksum.
    is_damaged : (n_cases,) bool
        True for cases with a state that no checksum confirms.
    """
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


def _read_intact_states(sweep_header: store.Stored, scene: Scene) -> np.ndarray:
    """Return states in the shape of the axes; State.PENDING for damaged cases."""
    case_states: np.ndarray = _read_cases(sweep_header, scene)[0]["state"].reshape(
        scene.given("sweep").shape
    )
    for index in np.argwhere(case_states == State.CONVERGED):
        if _read_intact_waves(sweep_header, tuple(map(int, index))) is None:
            case_states[tuple(index)] = State.PENDING
    return case_states


def read_columns(sweep_header: store.Stored, scene: Scene) -> dict[str, np.ndarray]:
    """Read ``state`` and all columns, in the shape of the axes.

    Pending cases and missing columns have nan, 0 for whole numbers, and empty texts.
    """
    flat_column_by_name, is_damaged = _read_cases(sweep_header, scene)
    shape, column_by_name = scene.given("sweep").shape, {}
    if is_damaged.any():
        first_damaged_index = tuple(map(int, np.unravel_index(int(np.argmax(is_damaged)), shape)))
        damage_text = (
            f"{is_damaged.sum()} of its cases are damaged, the first at {first_damaged_index}"
        )
        raise sweep_header.refused(
            f"a whole sweep: {damage_text}; the command sweep computes them again"
        )
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
    """Read the gap [m] and force [N] coefficients of a converged case: (2H+1, n_rows) each.

    With friction, tangential rows follow the normal ones.
    """
    sweep_header = store.header(path)
    sweep_header.fitting_argument(KIND)
    waves = _read_intact_waves(sweep_header, index)
    if waves is None:
        requirement = (
            f"a whole sweep: its case {index} is damaged; the command sweep computes it again"
        )
        raise sweep_header.refused(requirement)
    return waves


def _read_intact_waves(
    sweep_header: store.Stored, index: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Read the same coefficients; None if they are damaged."""
    columns, path, waves = sweep_header.columns, sweep_header.path, []
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
