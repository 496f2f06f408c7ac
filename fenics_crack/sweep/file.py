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

from fenics_crack.basics.atomic_files import partial_file, report_write_errors, write_bytes_at
from fenics_crack.basics.errors import N_NATURAL_MODES_PER_CRACK_STATE, WriteError
from fenics_crack.basics.observables import (
    OBSERVABLES_BY_NAME,
    REQUIRES_FRICTION,
    Place,
    observable_names,
)
from fenics_crack.basics.tables import UNIT_BY_DICT_ENTRY_NAME
from fenics_crack.basics.untrusted_files import MAX_INPUT_FILE_BYTES, regular_file_size
from fenics_crack.files import store
from fenics_crack.files.store import dataset_attribute_texts
from fenics_crack.scene.keys import RESULT_SETTINGS_TABLE_NAMES
from fenics_crack.scene.scene import Scene, list_requested_extra_quantities
from fenics_crack.scene.words import describe_differences
from fenics_crack.version import VERSION

KIND = "sweep"


class CaseState(IntEnum):
    """Progress of a sweep case, as stored in the column ``state``.

    PENDING: not tried yet, or stored data are damaged. CONVERGED: solved. FAILED: tried without a
    solution, or only the natural frequencies were requested.
    """

    PENDING = 0
    CONVERGED = 1
    FAILED = 2


UNDECIDED_STATUS_PREFIX = "undecided: "
"""Text in the column ``status`` before the reason why a case's stability is undecided."""
CONTRADICTION_STATUS_PREFIX = "; yet "
"""Text in the column ``status`` before a remark that more modes contradict the verdict on
stability."""


def column_name_at_load(quantity: str) -> str:
    """Return the name of the sweep column for a quantity at the load's point.

    For ``quantity`` "amplitude" this is "response". For any other quantity it is the quantity's
    name.
    """
    return "response" if quantity == "amplitude" else quantity


STORED_MODE_NUMBER_RANGE = range(1, N_NATURAL_MODES_PER_CRACK_STATE + 1)
"""Numbers of the modes, 1 to 6, whose natural frequencies are stored for each case."""
LABEL_AND_UNIT_BY_FREQUENCY_COLUMN = {
    f"omega_{lips}_{mode}": (words.format(mode), "rad/s")
    for lips, words in (
        ("open", "natural frequency {}, crack open"),
        ("tied", "natural frequency {}, crack bonded"),
        ("bilinear", "bilinear frequency of open mode {}"),
    )
    for mode in STORED_MODE_NUMBER_RANGE
}
"""Label and unit of the columns with natural frequencies, by column name ("omega_open_1")."""
UNIT_BY_OUTPUT_POINT_QUANTITY = {
    name: UNIT_BY_DICT_ENTRY_NAME[name]
    for name in observable_names(Place.WATCHED_POINT)
    if name != "ratio_half_1"
}
"""Units of the quantities stored for each point and direction, by quantity name.

``ratio_half_1`` (subharmonic amplitude ratio) is left out: no case has a period longer than the
load's.
"""
STORED_HARMONIC_ORDERS = (1, 2, 3, 4, 5, 6)
"""Orders of the displacement's harmonics that are stored, with cosine and sine part."""
UNIT_BY_HARMONIC_PART = {
    f"{part}_{order}": "m" for order in STORED_HARMONIC_ORDERS for part in ("cosine", "sine")
}
"""Units of the stored harmonics' parts, by column name ("cosine_1", "sine_1").

``harmonic_1`` to ``harmonic_3`` are the amplitudes sqrt(cosine^2 + sine^2).
"""
UNIT_AND_NUMPY_TYPE_BY_COLUMN: dict[str, tuple[str, str]] = {
    **{
        column_name_at_load(name): (unit, "f8")
        for name, unit in (UNIT_BY_OUTPUT_POINT_QUANTITY | UNIT_BY_HARMONIC_PART).items()
    },
    **{
        name: (UNIT_BY_DICT_ENTRY_NAME[name], "f8")
        for name in observable_names(
            Place.CRACK_FACES,
            Place.MODE_NEAREST_TO_LOAD_FREQUENCY,
            excluded_flags=REQUIRES_FRICTION,
        )
    },
    **{name: (unit, "f8") for name, (_, unit) in LABEL_AND_UNIT_BY_FREQUENCY_COLUMN.items()},
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
"""Unit and NumPy type of the columns that each sweep has, by column name.

The column ``state``, columns of named points, and requested quantities are not included.
"""
CHANGES_REMOVING_UNUSED_TABLES = dict.fromkeys(
    name for name in RESULT_SETTINGS_TABLE_NAMES if name not in ("sweep", "output", "growth")
)
"""Changes for ``Scene.replace`` that remove the tables without effect on any sweep case."""
UNIT_BY_FOURIER_COEFFICIENT_DATASET = {"gap": "m", "force": "N"}
"""Units of the Fourier coefficients ("waves") stored for converged cases, by dataset name."""
WAVES_CHECKSUM_COLUMN_NAME, CASE_CHECKSUM_COLUMN_NAME = "waves_checksum", "checksum"
"""Names of two columns with checksums (CRC-32): for a case's gap and force coefficients, and for
all columns with the state (never 0)."""
REQUIRED_SWEEP_COLUMN_NAMES = {
    "state",
    WAVES_CHECKSUM_COLUMN_NAME,
    CASE_CHECKSUM_COLUMN_NAME,
    "harmonics",
}
"""Columns that each sweep file must have; files from earlier versions may lack other columns."""
SWEEP_COLUMNS_REQUIREMENT = (
    "a sweep with all columns; this file is damaged or older: compute it again in a new folder"
)
"""Requirement on a sweep's file, for an error message."""
BLANK_VALUE_BY_TYPE_KIND: dict[str, Any] = {"f": np.nan, "i": 0, "S": b""}
"""Values that mean "no value", by the letter of the NumPy type ("f" float, "i" integer, "S"
text)."""


def unit_and_type_by_column(scene: Scene) -> dict[str, tuple[str, str]]:
    """Return unit and NumPy type for each column in a scene's sweep, by column name.

    Included are columns for requested quantities, and for points in ``[output.points]``, such as
    "tip.ux.ratio_2_1". The column ``state`` and the checksums are not included.
    """
    requested_quantity_names = (
        *(observable_names(required_flags=REQUIRES_FRICTION) if scene.has_friction else ()),
        *list_requested_extra_quantities(scene),
    )
    unit_and_type_by_output_point_column = {
        f"{point_name}.{column_name}": (unit, "f8")
        for point_name in scene.label_by_displacement_name
        for column_name, unit in (UNIT_BY_OUTPUT_POINT_QUANTITY | UNIT_BY_HARMONIC_PART).items()
    }
    return (
        UNIT_AND_NUMPY_TYPE_BY_COLUMN
        | {
            column_name: (UNIT_BY_DICT_ENTRY_NAME[column_name], "f8")
            for column_name in requested_quantity_names
        }
        | unit_and_type_by_output_point_column
    )


class SweepFile:
    """File of a sweep, open for writing; an existing file is continued.

    Parameters
    ----------
    path : Path
        File path.
    scene : Scene
        Scene with its sweep.
    n_harmonics_upper_bound, n_gap_rows_upper_bound : int
        Largest number of harmonics, and of gaps, in any case. A contact pair has a normal gap, and
        with friction also a tangential gap. The numbers set the datasets' size. With 0 gaps, no
        Fourier coefficients of gaps and forces are stored.
    omitted_options : sequence of str
        Names of computations that are left out. "verdicts": stability. "judged": reduction error.
        "vibration_2": the cases with value 2, counted from 0, of the last swept key; only natural
        frequencies are computed for them.

    Attributes
    ----------
    is_new : bool
        True if the file did not exist.
    sweep_header : StoredFile
        Header with each dataset's offset.
    case_states : int array
        Each case's state (:class:`CaseState`), in the shape of the sweep axes; PENDING for damaged
        cases.

    Raises
    ------
    InputError
        The file cannot be written, or holds another sweep or other columns. Or cases are pending
        while another program writes the file.
    """

    def __init__(
        self,
        path: Path,
        scene: Scene,
        n_harmonics_upper_bound: int,
        n_gap_rows_upper_bound: int,
        omitted_options: Sequence[str] = (),
    ) -> None:
        self._path, self._unit_and_type_by_column = path, unit_and_type_by_column(scene)
        with report_write_errors(
            path,
            "path",
            "a file that can be written; if another sweep writes it, wait, or choose a new folder",
        ):
            new_header = (
                None
                if os.path.lexists(path)
                else _make_file_and_header_unless_exists(
                    path, scene, n_harmonics_upper_bound, n_gap_rows_upper_bound, omitted_options
                )
            )
            regular_file_size(path, None, follows_links=False)  # nothing is written elsewhere
            self._file_descriptor = os.open(path, os.O_RDWR)
            try:
                lock_error = _lock_file_or_return_error(self._file_descriptor)
                self.sweep_header = new_header or _read_matching_header(path, scene)
                self.case_states = _read_intact_states(self.sweep_header, scene)
                if np.any(self.case_states == CaseState.PENDING):  # else nothing is written
                    if lock_error:
                        raise lock_error
                    _check_omitted_options_match(self.sweep_header, omitted_options)
            except BaseException:
                os.close(self._file_descriptor)
                raise
        self.is_new = new_header is not None

    def write_cases_unless_already_stored(
        self, case_numbers: np.ndarray, values_of_cases: Sequence[Mapping[str, Any]]
    ) -> None:
        """Write the given cases into the file, except those converged or failed already.

        Parameters
        ----------
        case_numbers : (n,) int
            Case numbers; the position on the last sweep axis changes fastest.
        values_of_cases : sequence of mappings
            Values by column name for each case. Converged cases have the Fourier coefficients "gap"
            [m] and "force" [N].

        Raises
        ------
        InputError
            The disk is full, or the file was moved; earlier cases stay written.
        """
        pending_given_case_indices = np.flatnonzero(
            self.case_states.flat[case_numbers] == CaseState.PENDING
        )
        if len(pending_given_case_indices):
            self.write_cases(
                case_numbers[pending_given_case_indices],
                [
                    values_of_cases[pending_given_case_index]
                    for pending_given_case_index in pending_given_case_indices
                ],
            )

    def write_cases(
        self, case_numbers: np.ndarray, values_of_cases: Sequence[Mapping[str, Any]]
    ) -> None:
        """Write cases into the file: all values first, then the states.

        Parameters
        ----------
        case_numbers : (n,) int
            Case numbers; the position on the last sweep axis changes fastest.
        values_of_cases : sequence of mappings
            Values by column name for each case. A case with the key "gap" has converged, any other
            case has failed.

        Raises
        ------
        InputError
            The disk is full, or the file was moved; earlier cases stay written.
        """
        if not self._is_file_still_at_path():
            requirement_text = (
                "kept in place during the sweep; it was moved or replaced: run the same command "
                "again"
            )
            raise WriteError("path", str(self._path), requirement_text)
        case_states = np.array(
            [
                CaseState.CONVERGED if "gap" in case_values else CaseState.FAILED
                for case_values in values_of_cases
            ]
        )
        waves_by_name = {
            wave_name: [
                case_values.get(wave_name, np.zeros((0, 0))) for case_values in values_of_cases
            ]
            for wave_name in UNIT_BY_FOURIER_COEFFICIENT_DATASET
        }
        column_by_name = {
            column_name: _encode_column(
                [case_values.get(column_name) for case_values in values_of_cases],
                self.sweep_header.columns[column_name].dtype,
            )
            for column_name in self._unit_and_type_by_column
        }
        wave_checksums = [
            _compute_waves_checksum(*gap_and_force)
            for gap_and_force in zip(*waves_by_name.values(), strict=True)
        ]
        column_by_name[WAVES_CHECKSUM_COLUMN_NAME] = np.array(wave_checksums, "u4")
        column_by_name[CASE_CHECKSUM_COLUMN_NAME] = _compute_case_checksums(
            column_by_name, case_states
        )
        with report_write_errors(self._path, "path"):
            self._write_column("state", case_numbers, np.full(len(case_states), CaseState.PENDING))
            for wave_name, waves in waves_by_name.items():
                if wave_name in self.sweep_header.columns:
                    self._write_column(
                        wave_name,
                        case_numbers,
                        _pad_waves(waves, self.sweep_header.columns[wave_name].shape[-1]),
                    )
            # The checksum, which confirms a case, is the last column.
            for column_name, column_values in column_by_name.items():
                self._write_column(column_name, case_numbers, column_values)
            self._write_column("state", case_numbers, case_states)
        self.case_states.flat[case_numbers] = case_states

    def close(self, *, remove: bool = False) -> None:
        """Close the file; with ``remove`` delete it, too. Failure raises InputError."""
        with report_write_errors(self._path, "path"):
            if remove and self._is_file_still_at_path():
                self._path.unlink()
            os.close(self._file_descriptor)

    def _write_column(self, column_name: str, case_numbers: np.ndarray, values: np.ndarray) -> None:
        """Write values for given cases into a dataset in the file.

        Parameters
        ----------
        column_name : str
            Dataset name.
        case_numbers : (n,) int
            Case numbers; the position on the last sweep axis changes fastest.
        values : (n, ...)
            Each case's value. A value may be an array smaller than the place reserved for a case.
            The rest of the place then stays unchanged.
        """
        stored_column = self.sweep_header.columns[column_name]
        bytes_per_case = stored_column.n_bytes // self.case_states.size
        byte_rows = (
            np.ascontiguousarray(values, stored_column.dtype).view("u1").reshape(len(values), -1)
        )
        # Bytes of rows: NumPy drops trailing zeros from a single text.
        for case_number, case_bytes in zip(case_numbers, byte_rows, strict=True):
            write_bytes_at(
                self._file_descriptor,
                case_bytes.tobytes(),
                stored_column.offset + int(case_number) * bytes_per_case,
            )

    def _is_file_still_at_path(self) -> bool:
        """Return True if the path still leads to the open file.

        The result is False if the file was removed or replaced.
        """
        try:
            return os.path.samestat(os.fstat(self._file_descriptor), os.stat(self._path))
        except OSError:
            return False


def _lock_file_or_return_error(file_descriptor: int) -> OSError | None:
    """Lock an open file, so that no other program writes into it.

    ``file_descriptor`` is the open file. Returns None on success, and the error if another program
    holds the lock.
    """
    try:
        fcntl.flock(file_descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        return error
    return None


def _pad_waves(waves: list[np.ndarray], n_columns: int) -> np.ndarray:
    """Stack the Fourier coefficients of several cases in an array, padded with nan.

    Parameters
    ----------
    waves : list of (n_coefficients, n_gaps)
        Each case's Fourier coefficients; both numbers may differ between cases.
    n_columns : int
        Columns in the result, at least the largest n_gaps.

    Returns
    -------
    (n_cases, n_rows, n_columns)
        n_rows is the largest n_coefficients.
    """
    padded_waves = np.full((len(waves), max(map(len, waves)), n_columns), np.nan)
    for padded_wave, unpadded_wave in zip(padded_waves, waves, strict=True):
        padded_wave[: unpadded_wave.shape[0], : unpadded_wave.shape[1]] = unpadded_wave
    return padded_waves


def _encode_column(column_values: Sequence[Any], column_type: np.dtype[Any]) -> np.ndarray:
    """Return a column's values (n,) in the form stored in the file.

    A text becomes UTF-8, shortened to the column's size without cutting a character. None is a
    missing value. It becomes nan in a column with floats, 0 in a column with whole numbers, and an
    empty text.

    Parameters
    ----------
    column_values : sequence
        A number, text or None for each case.
    column_type : dtype
        The column's NumPy type in the file.
    """
    encoded_column = [
        value.encode()[: column_type.itemsize].decode("utf-8", "ignore").encode()
        if isinstance(value, str)
        else value
        for value in column_values
    ]
    blank_value = BLANK_VALUE_BY_TYPE_KIND[column_type.kind]
    return np.array(
        [blank_value if value is None else value for value in encoded_column], column_type
    )


def _make_file_and_header_unless_exists(
    path: Path,
    scene: Scene,
    n_harmonics_upper_bound: int,
    n_gap_rows_upper_bound: int,
    omitted_options: Sequence[str],
) -> store.StoredFile | None:
    """Make a new sweep file with all cases pending, and return the file's header.

    Returns None if another program has made the file first.

    Parameters
    ----------
    path : Path
        File path.
    scene : Scene
        Scene with its sweep.
    n_harmonics_upper_bound, n_gap_rows_upper_bound : int
        Largest number of harmonics, and of gaps, in any case.
    omitted_options : sequence of str
        Computations that are left out, as in :class:`SweepFile`.
    """
    axes_shape = scene.given("sweep").shape
    unit_type_shape_by_dataset = {
        dataset_name: (unit, type_name, axes_shape)
        for dataset_name, (unit, type_name) in _unit_and_type_by_dataset(scene).items()
    }
    if n_gap_rows_upper_bound:
        wave_shape = (*axes_shape, 2 * n_harmonics_upper_bound + 1, n_gap_rows_upper_bound)
        unit_type_shape_by_dataset |= {
            dataset_name: (unit, "f8", wave_shape)
            for dataset_name, unit in UNIT_BY_FOURIER_COEFFICIENT_DATASET.items()
        }
    with contextlib.suppress(FileExistsError):
        with (
            partial_file(path, must_be_new=True) as hidden_path,
            open(hidden_path, "wb", buffering=0) as new_file,
            open(
                os.memfd_create("sweep"), "w+b", buffering=0
            ) as memory_file,  # zeros take no memory
        ):
            byte_counts_of_datasets = (
                math.prod(dataset_shape) * np.dtype(type_name).itemsize
                for _, type_name, dataset_shape in unit_type_shape_by_dataset.values()
            )
            # OSError here if file sizes are limited; HDF5 would meet the limit later.
            new_file.truncate(sum(byte_counts_of_datasets))
            new_sweep_header = _write_datasets_and_make_header(
                memory_file, path, scene, unit_type_shape_by_dataset, omitted_options
            )
            _copy_written_parts(memory_file.fileno(), new_file.fileno())
        return new_sweep_header
    return None


def _write_datasets_and_make_header(
    memory_file: BinaryIO,
    path: Path,
    scene: Scene,
    unit_type_shape_by_dataset: Mapping[str, tuple[str, str, tuple[int, ...]]],
    omitted_options: Sequence[str],
) -> store.StoredFile:
    """Write a sweep file without values into memory, and return the file's header.

    All numbers in the datasets are 0, so all cases are pending.

    Parameters
    ----------
    memory_file : binary file
        Open file in memory.
    path : Path
        Path at which the file will be; the header names it.
    scene : Scene
        Scene with its sweep.
    unit_type_shape_by_dataset : dict of str to (str, str, tuple)
        Unit, NumPy type and shape, by dataset name.
    omitted_options : sequence of str
        Computations that are left out, as in :class:`SweepFile`.
    """
    import h5py  # what only reads has its reader

    with h5py.File(memory_file, "w", libver="earliest") as hdf5_file:
        store.write_header(hdf5_file, KIND, scene)
        hdf5_file.attrs["omitted"] = " ".join(omitted_options)
        # Kept as written, since reading them takes longer.
        attribute_text_by_path, located_column_by_name = store.attribute_texts(hdf5_file), {}
        for dataset_name, (unit, type_name, dataset_shape) in unit_type_shape_by_dataset.items():
            creation_properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            creation_properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
            # A new file has zeros: State.PENDING.
            creation_properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
            hdf5_dataset = hdf5_file.create_dataset(
                dataset_name, dataset_shape, type_name, dcpl=creation_properties
            )
            description_text = _describe_column(dataset_name)
            attribute_text_by_name = {"unit": unit} | (
                {"about": description_text} if description_text else {}
            )
            for attribute_name, attribute_text in attribute_text_by_name.items():
                hdf5_dataset.attrs[attribute_name] = attribute_text
                attribute_text_by_path[f"{dataset_name}/{attribute_name}"] = attribute_text
            located_column_by_name[dataset_name] = store.locate_dataset_in_file(hdf5_dataset)
        attribute_text_by_path["digest"] = store.content_digest(
            attribute_text_by_path, store.dataset_location_texts(located_column_by_name)
        )
        hdf5_file.attrs["digest"] = attribute_text_by_path["digest"]
        return store.StoredFile(path, attribute_text_by_path, {}, located_column_by_name)


def _copy_written_parts(memory_descriptor: int, target_descriptor: int) -> None:
    """Copy a sparse file to another open file; unwritten ranges take no disk space.

    Parameters
    ----------
    memory_descriptor, target_descriptor : int
        File descriptors to copy from, and to copy to. The target gets the same size.

    Raises
    ------
    OSError
        The target cannot be written.
    """
    file_size, part_end = os.fstat(memory_descriptor).st_size, 0
    os.truncate(target_descriptor, file_size)
    while part_end < file_size:
        try:
            part_start = os.lseek(memory_descriptor, part_end, os.SEEK_DATA)
        except OSError:  # zeros alone
            return
        part_end = os.lseek(memory_descriptor, part_start, os.SEEK_HOLE)
        write_bytes_at(
            target_descriptor,
            os.pread(memory_descriptor, part_end - part_start, part_start),
            part_start,
        )


def _describe_column(column_name: str) -> str:
    """Return a column's description, to be stored in the file; empty if unknown."""
    if column_name in UNIT_BY_FOURIER_COEFFICIENT_DATASET:
        return (
            "axes of the sweep; "
            f"{dataset_attribute_texts(f'{column_name}_coefficients', {})['about']}"
        )
    quantity = "amplitude" if column_name == "response" else column_name.rpartition(".")[2]
    words_by_quantity = {
        column_name: observable.words for column_name, observable in OBSERVABLES_BY_NAME.items()
    }
    return (
        words_by_quantity.get(quantity)
        or LABEL_AND_UNIT_BY_FREQUENCY_COLUMN.get(quantity, ("",))[0]
    )


def _compute_waves_checksum(gap: np.ndarray, force: np.ndarray) -> int:
    """Return a checksum (CRC-32) over a case's Fourier coefficients.

    ``gap`` [m] and ``force`` [N] are the coefficients (2H+1, n_gaps), with H harmonics.
    """
    return zlib.crc32(force.tobytes(), zlib.crc32(gap.tobytes()))


def _compute_case_checksums(
    column_by_name: Mapping[str, np.ndarray], case_states: np.ndarray
) -> np.ndarray:
    """Return a checksum (CRC-32, never 0) over each case's values and state: (n,).

    Parameters
    ----------
    column_by_name : mapping of str to (n,)
        Values for n cases, by column name.
    case_states : (n,)
        Each case's state.
    """
    # Rows of bytes take memory: make few at once.
    checksums, n_block_cases = np.zeros(len(case_states), dtype="u4"), 4096
    for block_start in range(0, len(case_states), n_block_cases):
        block_slice = slice(block_start, block_start + n_block_cases)
        block_columns = [
            column[block_slice] for column in (*column_by_name.values(), case_states.astype("u1"))
        ]
        byte_rows = np.hstack(
            [
                block_column.view("u1").reshape(len(block_column), -1)
                for block_column in block_columns
            ]
        )
        checksums[block_slice] = [zlib.crc32(case_bytes) or 1 for case_bytes in byte_rows]
    return checksums


def _read_matching_header(path: Path, scene: Scene) -> store.StoredFile:
    """Return the header of a sweep file, after checking that the file can be continued.

    Raises
    ------
    InputError
        The file was begun with another scene, other mesh files or another program version, or lacks
        columns.
    """
    sweep_header = store.read_result_file_without_numbers(path)
    sweep_header.check_kind(KIND)
    stored_scene = sweep_header.scene()
    requested_scene = Scene.from_text(store.scene_text(scene), str(path))  # both with full paths
    if stored_scene is None or stored_scene.replace(
        CHANGES_REMOVING_UNUSED_TABLES
    ) != requested_scene.replace(CHANGES_REMOVING_UNUSED_TABLES):
        difference_text = (
            describe_differences([stored_scene, requested_scene])[0]
            if stored_scene is not None
            else ""
        )
        stored_scene_difference_clause = (
            f" (this one was begun with {difference_text})" if difference_text else ""
        )
        requirement_text = (
            f"a sweep of the same scene{stored_scene_difference_clause}; for another scene choose "
            f"a new folder"
        )
        raise sweep_header.refusal(requirement_text)
    if (stored_program_version := sweep_header.attributes["version"]) != VERSION:
        raise sweep_header.refusal(
            f"a sweep that version {VERSION} began; version {stored_program_version} began it: "
            "choose a new folder"
        )
    sweep_header.check_files(stored_scene)
    if not _unit_and_type_by_dataset(scene).keys() <= sweep_header.columns.keys():
        raise sweep_header.refusal(SWEEP_COLUMNS_REQUIREMENT)
    scene_of_sweep(sweep_header)
    return sweep_header


def _check_omitted_options_match(
    sweep_header: store.StoredFile, omitted_options: Sequence[str]
) -> None:
    """Raise InputError if the file was begun with other computations left out.

    Parameters
    ----------
    sweep_header : StoredFile
        Header of the file. Files from earlier versions do not say what was left out; they are
        accepted.
    omitted_options : sequence of str
        Computations to leave out now, as in :class:`SweepFile`.
    """
    stored_omitted_option_names = sweep_header.attributes.get(
        "omitted", " ".join(omitted_options)
    ).split()
    changed_option_texts = [
        f"{option_name}={option_name not in stored_omitted_option_names}"
        for option_name in sorted({*stored_omitted_option_names} ^ {*omitted_options})
    ]
    if changed_option_texts:
        original_options_text = f"this one was begun with {', '.join(changed_option_texts)}"
        requirement_text = (
            f"a sweep with the same options ({original_options_text}); for others choose a new "
            f"folder"
        )
        raise sweep_header.refusal(requirement_text)


# --- reading --------------------------------------------------------------------------------------


def _unit_and_type_by_dataset(scene: Scene) -> dict[str, tuple[str, str]]:
    """Return unit and NumPy type of all datasets in a sweep's file.

    The datasets are ``state``, all columns and the checksums, by name.
    """
    unit_and_type_by_checksum = dict.fromkeys(
        (WAVES_CHECKSUM_COLUMN_NAME, CASE_CHECKSUM_COLUMN_NAME), ("", "u4")
    )
    return {"state": ("", "u1")} | unit_and_type_by_column(scene) | unit_and_type_by_checksum


def scene_of_sweep(sweep_header: store.StoredFile) -> Scene:
    """Return the scene in a sweep's file.

    InputError if the file is no sweep, or if its columns do not fit the scene or exceed 2 GiB.
    """
    sweep_header.check_kind(KIND)
    scene = sweep_header.scene()
    if scene is None or scene.sweep is None:
        raise sweep_header.refusal("a sweep with its scene; compute it again in a new folder")
    if column_name := min(REQUIRED_SWEEP_COLUMN_NAMES - sweep_header.columns.keys(), default=""):
        requirement_text = (
            f"a sweep with the column {column_name!r}; this one is of an older version"
        )
        raise sweep_header.refusal(f"{requirement_text}: compute it again in a new folder")
    axes_shape, n_column_bytes = scene.given("sweep").shape, 0
    for column_name, (_, type_name) in _unit_and_type_by_dataset(scene).items():
        if (checked_column := sweep_header.columns.get(column_name)) is not None:
            if checked_column.shape != axes_shape or checked_column.dtype != np.dtype(type_name):
                raise sweep_header.refusal(SWEEP_COLUMNS_REQUIREMENT)
            n_column_bytes += checked_column.n_bytes
    if n_column_bytes > MAX_INPUT_FILE_BYTES:
        raise sweep_header.refusal(
            f"a sweep with at most {MAX_INPUT_FILE_BYTES / 2**30:g} GiB of columns; sweep "
            "fewer values"
        )
    return scene


def _read_columns_and_find_damage(
    sweep_header: store.StoredFile, scene: Scene
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Read all columns of a sweep's file, and find damaged cases.

    If cases seem damaged, another program may be writing them at this time. The file is then read
    again.

    Returns
    -------
    column_by_name : dict of str to (n_cases,)
        ``state`` and all columns, without the case checksum. Damaged cases are pending.
    is_damaged : (n_cases,) bool
        True for cases whose stored state does not match the checksum.
    """
    column_by_name, is_case_damaged = _read_columns_and_damage_flags_once(sweep_header, scene)
    if is_case_damaged.any():  # or is being written at this moment
        column_by_name, is_case_damaged_again = _read_columns_and_damage_flags_once(
            sweep_header, scene
        )
        is_case_damaged &= is_case_damaged_again
    return column_by_name, is_case_damaged


def _read_columns_and_damage_flags_once(
    sweep_header: store.StoredFile, scene: Scene
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Read all columns of a sweep's file, and compare states with checksums.

    A file that cannot be read raises InputError.

    Returns
    -------
    column_by_name : dict of str to (n_cases,)
        ``state`` and all columns, without the case checksum. A case is converged or failed if its
        checksum fits this state, otherwise pending.
    is_damaged : (n_cases,) bool
        True for cases whose stored state does not match the checksum.
    """
    try:  # the state first: what is written later counts as pending
        column_by_name = {
            column_name: sweep_header.columns[column_name].read_numbers(sweep_header.path).ravel()
            for column_name in _unit_and_type_by_dataset(scene)
            if column_name in sweep_header.columns
        }
    except (OSError, ValueError):
        raise sweep_header.refusal(SWEEP_COLUMNS_REQUIREMENT) from None
    stored_states, stored_checksums = map(column_by_name.pop, ("state", CASE_CHECKSUM_COLUMN_NAME))
    written_case_numbers = np.flatnonzero(stored_checksums)
    case_states = np.full(len(stored_states), CaseState.PENDING, stored_states.dtype)
    column_of_written_cases_by_name = {
        column_name: column_values[written_case_numbers]
        for column_name, column_values in column_by_name.items()
    }
    for candidate_state in (CaseState.CONVERGED, CaseState.FAILED):
        has_matching_checksum = (
            _compute_case_checksums(
                column_of_written_cases_by_name, np.full(len(written_case_numbers), candidate_state)
            )
            == stored_checksums[written_case_numbers]
        )
        case_states[written_case_numbers[has_matching_checksum]] = candidate_state
    is_case_damaged = (case_states == CaseState.PENDING) & (stored_states != CaseState.PENDING)
    return {"state": case_states} | column_by_name, is_case_damaged


def _read_intact_states(sweep_header: store.StoredFile, scene: Scene) -> np.ndarray:
    """Return each case's state (:class:`CaseState`), in the shape of the axes.

    Cases with damaged columns or Fourier coefficients are PENDING.
    """
    case_states: np.ndarray = _read_columns_and_find_damage(sweep_header, scene)[0][
        "state"
    ].reshape(scene.given("sweep").shape)
    for case_index in np.argwhere(case_states == CaseState.CONVERGED):
        if _read_intact_coefficients(sweep_header, tuple(map(int, case_index))) is None:
            case_states[tuple(case_index)] = CaseState.PENDING
    return case_states


def read_column_by_name(sweep_header: store.StoredFile, scene: Scene) -> dict[str, np.ndarray]:
    """Read all columns of a sweep's file by name, in the shape of the axes.

    The column ``state`` is included. Pending cases have no values. A missing value is nan; it is 0
    in a column with whole numbers, and empty in a column with texts. Damaged cases raise
    InputError.
    """
    flat_column_by_name, is_case_damaged = _read_columns_and_find_damage(sweep_header, scene)
    axes_shape, column_by_name = scene.given("sweep").shape, {}
    if is_case_damaged.any():
        first_damaged_case_index = tuple(
            map(int, np.unravel_index(int(np.argmax(is_case_damaged)), axes_shape))
        )
        damage_text = (
            f"{is_case_damaged.sum()} of its cases are damaged, the first at index "
            f"{first_damaged_case_index}"
        )
        raise sweep_header.refusal(
            f"undamaged: {damage_text}; run the same command again to compute them"
        )
    for column_name, (_, type_name) in (
        {"state": ("", "u1")} | unit_and_type_by_column(scene)
    ).items():
        column_values = flat_column_by_name.get(
            column_name,
            np.full(
                math.prod(axes_shape), BLANK_VALUE_BY_TYPE_KIND.get(type_name[0], 0), type_name
            ),
        )
        if column_name != "state":
            column_values[flat_column_by_name["state"] == CaseState.PENDING] = (
                BLANK_VALUE_BY_TYPE_KIND[column_values.dtype.kind]
            )
        is_text = column_values.dtype.kind == "S"
        column_by_name[column_name] = (
            np.char.decode(column_values, "utf-8", "replace") if is_text else column_values
        )
        column_by_name[column_name] = column_by_name[column_name].reshape(axes_shape)
    return column_by_name


def read_gap_and_force_coefficients(
    path: Path, index: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Read Fourier coefficients of a converged case's gaps [m] and forces [N].

    Parameters
    ----------
    path : Path
        The sweep's file.
    index : tuple of int
        The case's position on each sweep axis.

    Returns
    -------
    gap, force : (2H+1, n_rows)
        Mean, then cosine and sine for each of H harmonics. Rows are contact pairs; with friction,
        tangential ones follow the normal ones.

    Raises
    ------
    InputError
        The case's stored data are damaged.
    """
    sweep_header = store.read_result_file_without_numbers(path)
    sweep_header.check_kind(KIND)
    waves = _read_intact_coefficients(sweep_header, index)
    if waves is None:
        requirement_text = (
            f"undamaged: its case {index} is damaged; run the same command again to compute it"
        )
        raise sweep_header.refusal(requirement_text)
    return waves


def _read_intact_coefficients(
    sweep_header: store.StoredFile, index: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Read Fourier coefficients of a case's gaps [m] and forces [N].

    Each array is (2H+1, n_rows), with H harmonics. ``index`` is the case's position on each sweep
    axis. The result is None if the arrays cannot be read or do not match the checksum.
    """
    stored_column_by_name, file_path, waves = sweep_header.columns, sweep_header.path, []
    try:
        case_number = int(np.ravel_multi_index(index, stored_column_by_name["state"].shape))
        n_coefficients = (
            2 * int(stored_column_by_name["harmonics"].read_numbers(file_path, case_number, 1)[0])
            + 1
        )
        stored_checksum = stored_column_by_name[WAVES_CHECKSUM_COLUMN_NAME].read_numbers(
            file_path, case_number, 1
        )[0]
        for wave_name in UNIT_BY_FOURIER_COEFFICIENT_DATASET:
            n_stored_coefficients, n_gap_rows = (
                stored_column_by_name[wave_name].shape[-2:]
                if wave_name in stored_column_by_name
                else (n_coefficients, 0)
            )
            first_dataset_value_index = case_number * n_stored_coefficients * n_gap_rows
            n_values = n_coefficients * n_gap_rows
            wave = (
                stored_column_by_name[wave_name].read_numbers(
                    file_path, first_dataset_value_index, n_values
                )
                if n_values
                else np.zeros(0)
            )
            waves.append(wave.reshape(n_coefficients, n_gap_rows))
    except (OSError, ValueError, KeyError):
        return None
    is_used_gap_row = np.isfinite(waves[0][0])
    gap_coefficients, contact_force_coefficients = (
        np.ascontiguousarray(wave[:, is_used_gap_row]) for wave in waves
    )
    is_intact = (
        n_coefficients <= n_stored_coefficients
        and _compute_waves_checksum(gap_coefficients, contact_force_coefficients) == stored_checksum
    )
    return (gap_coefficients, contact_force_coefficients) if is_intact else None
