"""Store results in HDF5 files that describe themselves.

A file has the attributes ``kind`` (of the contents), ``program``, ``version``, ``versions`` of
the libraries, and ``scene`` as TOML text if there is a scene. The datasets are numbers and words,
with the attributes ``unit`` and ``about``. Nothing in a file is pickled, and nothing in it is ever
executed. The attribute ``digest`` is verified when the file is read; ``meshes`` holds digests of
the scene's files.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import io
import json
import math
import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_crack.basics.atomic_files import write_file_whole
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.suggestions import check_calls
from fenics_crack.basics.tables import UNIT_BY_DICT_ENTRY_NAME, Tabular
from fenics_crack.basics.untrusted_files import (
    file_sha256,
    read_first_bytes,
    regular_file_size,
    run_reader_for_arrays,
)
from fenics_crack.fem.model_files import list_included_files
from fenics_crack.files.codec import (
    DATASET_ERROR_CLASSES,
    Datasets,
    check_arrays,
    pack_dataclass,
    unpack_dataclass,
)
from fenics_crack.scene.scene import Scene, file_keys_and_paths, with_file_paths
from fenics_crack.version import VERSION

if TYPE_CHECKING:
    import h5py


IDENTIFICATION_FILE_KIND = "identification"
"""Kind in files from ``identify``."""
PROGRAM_NAME = "fenics_crack"
"""Value for the attribute ``program`` in every result file."""
UNREADABLE_FILE_DIGEST = "missing"
"""Text in place of a digest for a scene's file that cannot be read."""
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""First bytes in an HDF5 file."""


def write_result_file(
    datasets: Mapping[str, Any],
    path: str | Path,
    kind: str,
    scene: Scene | None = None,
    comm: MPI.Comm = MPI.COMM_SELF,
    *,
    is_compressed: bool = True,
) -> None:
    """Write datasets to an HDF5 result file, whole or not at all (collective).

    Only rank 0 writes.

    Parameters
    ----------
    datasets : mapping
        Datasets by name: arrays, numbers, words, lists of words; None is left out.
    path : path
        The file; an older file is replaced once the new file is complete.
    kind : str
        Kind of result, for example "response curve".
    scene : Scene, optional
        The result's scene.
    comm : MPI.Comm
        Communicator of the ranks that call.
    is_compressed : bool
        Compress arrays with over 1000 entries. Writing then takes 30 times as long.

    Raises
    ------
    InputError
        The file cannot be written.
    """

    def write_on_root() -> None:
        import h5py  # what only reads has its reader

        # In memory: HDF5 cannot be trusted with a full disk, and would load an old file.
        file_buffer = io.BytesIO()
        with h5py.File(file_buffer, "w") as file:
            write_header(file, kind, scene)
            for dataset_name, content in datasets.items():
                if content is not None:
                    compression_options = (
                        {"compression": "gzip"} if is_compressed and np.size(content) > 1000 else {}
                    )
                    file_dataset = file.create_dataset(
                        dataset_name, data=content, **compression_options
                    )
                    file_dataset.attrs.update(dataset_attribute_texts(dataset_name, datasets))
            file.attrs["digest"] = content_digest(attribute_texts(file), datasets)
        write_file_whole(path, file_buffer.getvalue())

    on_root(comm, write_on_root)


def write_header(file: h5py.File, kind: str, scene: Scene | None) -> None:
    """Write a result file's attributes: kind, program, versions and scene.

    If there is a scene, digests for its mesh and matrix files are written, too.

    Parameters
    ----------
    file : h5py.File
        File open for writing.
    kind : str
        Kind of result, for example "response curve".
    scene : Scene or None
        The result's scene.
    """
    file.attrs.update(
        kind=kind, program=PROGRAM_NAME, version=VERSION, versions=library_versions_text()
    )
    if scene is not None:
        file.attrs["scene"] = scene_text(scene)
        file.attrs["meshes"] = "\n".join(list_scene_file_digests(scene))


def library_versions_text() -> str:
    """Return library versions as text: "PETSc 3.22.0, NumPy 2.1.0".

    PETSc is always named. SLEPc, NumPy, DOLFINx and gmsh are named only if already imported.
    """
    module_by_name = {"PETSc": PETSc, "SLEPc": sys.modules.get("slepc4py.SLEPc")}
    version_by_name = {
        name: ".".join(map(str, library_module.Sys.getVersion()))
        for name, library_module in module_by_name.items()
        if library_module
    }
    for name, module_name in (("NumPy", "numpy"), ("DOLFINx", "dolfinx"), ("gmsh", "gmsh")):
        if module_name in sys.modules:
            version_by_name[name] = sys.modules[module_name].__version__
    return ", ".join(f"{name} {version}" for name, version in version_by_name.items())


@functools.cache
def program_fingerprint_text() -> str:
    """Return a text that changes if the program or a main library is changed.

    Used to tell whether a stored structure comes from the same program. The text lists path, size
    and modification time for the program's source files, and for a main file from each library.
    """
    module_specs = map(
        find_spec, ("dolfinx", "ufl", "ffcx", "basix", "petsc4py", "slepc4py", "gmsh")
    )
    file_names = [
        str(spec.origin) for spec in module_specs if spec is not None and spec.has_location
    ]
    file_names += sorted(map(str, Path(__file__).parents[1].rglob("*.py")))
    return repr([(file, os.stat(file).st_size, os.stat(file).st_mtime_ns) for file in file_names])


def scene_text(scene: Scene) -> str:
    """Return a scene as TOML text with absolute paths."""
    return scene_with_full_paths(scene).as_toml()


def scene_with_full_paths(scene: Scene) -> Scene:
    """Return a scene with absolute file paths."""
    return with_file_paths(scene, lambda path: str(Path(path).absolute()))


def attribute_texts(file: h5py.File) -> dict[str, str]:
    """Return a file's attributes, and the datasets' attributes, as texts by name.

    A dataset's attribute has a name like "omega/unit".
    """
    text_by_name = {name: str(value) for name, value in file.attrs.items()}
    for name, dataset in file.items():
        text_by_name |= {f"{name}/{key}": str(value) for key, value in dataset.attrs.items()}
    return text_by_name


def locate_dataset_in_file(dataset: h5py.Dataset) -> DatasetLocation:
    """Return type, shape and offset in the file for a sweep's dataset.

    With the offset [byte], numbers can be written into the file later, without HDF5.
    """
    return DatasetLocation(dataset.dtype, dataset.shape, dataset.id.get_offset())


def dataset_location_texts(
    location_by_dataset_name: Mapping[str, DatasetLocation],
) -> dict[str, str]:
    """Return type, shape and offset as text for each dataset in a sweep, by name.

    Used for the digest: a sweep's numbers change while cases are added, but this text does not.
    """
    return {name: str(location) for name, location in location_by_dataset_name.items()}


def content_digest(attributes: Mapping[str, str], datasets: Mapping[str, Any]) -> str:
    """Return the SHA-256 for attributes and datasets, in hexadecimal digits.

    Names, types, shapes and bytes count, but not the attribute ``digest``.

    Parameters
    ----------
    attributes : mapping of str to str
        Texts by attribute name, from :func:`attribute_texts`.
    datasets : mapping
        Datasets by name: arrays, numbers, words; None is left out. For a sweep:
        :func:`dataset_location_texts`.
    """
    hash_object = hashlib.sha256()
    for name, attribute_text in sorted(attributes.items()):
        if name != "digest":
            hash_object.update(json.dumps([name, attribute_text]).encode())
    for name, content in sorted(datasets.items()):
        if content is None:
            continue
        array = np.asarray(content)
        if array.dtype.kind in "UO":
            hash_object.update(json.dumps([name, array.tolist()]).encode())
        else:
            hash_object.update(json.dumps([name, array.dtype.str, array.shape]).encode())
            hash_object.update(array.tobytes())
    return hash_object.hexdigest()


# --- reading --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class DatasetLocation:
    """Hold type, shape and offset [byte] for a dataset with numbers to be written later."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    offset: int

    def __str__(self) -> str:
        return f"{self.dtype.str} {self.shape} {self.offset}"

    @property
    def n_bytes(self) -> int:
        """Dataset size in the file [byte]."""
        return math.prod(self.shape) * self.dtype.itemsize

    def read_numbers(
        self, path: Path, first_index: int = 0, count: int | None = None
    ) -> np.ndarray:
        """Read the dataset's numbers from a file.

        Parameters
        ----------
        path : Path
            The file.
        first_index : int
            First number to read, counted from 0 in the flattened dataset.
        count : int or None
            How many numbers to read; None: all, with ``first_index`` 0.

        Returns
        -------
        array
            (count,), or the dataset's shape if ``count`` is None.

        Raises
        ------
        OSError, ValueError
            The file cannot be read, or ends too early.
        """
        start_byte = self.offset + first_index * self.dtype.itemsize
        n_numbers = math.prod(self.shape) if count is None else count
        numbers = np.fromfile(path, self.dtype, n_numbers, offset=start_byte)
        if len(numbers) < n_numbers:
            raise ValueError("it ends before its last number")
        return numbers.reshape(self.shape) if count is None else numbers


@dataclass(frozen=True)
class StoredFile:
    """Hold a result file's contents, after the digest was verified.

    Attributes
    ----------
    path : Path
        The file.
    attributes : dict of str to str
        Attributes by name; a dataset's attribute has a name like "omega/unit".
    datasets : dict
        Datasets by name: arrays, numbers and words. Empty for a sweep, or if read by
        :func:`read_result_file_without_numbers`.
    columns : dict of str to DatasetLocation
        For a sweep: each dataset's type, shape and offset, by name. Otherwise empty.
    """

    path: Path
    attributes: dict[str, str]
    datasets: dict[str, Any]
    columns: dict[str, DatasetLocation]

    @property
    def kind(self) -> str:
        """Kind of result in the file, for example "response curve"."""
        return self.attributes["kind"]

    def scene(self) -> Scene | None:
        """Return the file's scene, or None; the scene's files are not opened.

        Raises
        ------
        InputError
            The scene cannot be used, or has no digests for its mesh or matrices.
        """
        if "scene" not in self.attributes:
            return None
        scene = Scene.from_text(self.attributes["scene"], str(self.path))
        if len(self._stored_scene_file_digests) < len(file_keys_and_paths(scene)):
            raise self._older_version_error("checksums of its mesh or matrices")
        return scene

    def check_files(self, scene: Scene, *, is_required: bool = True) -> None:
        """Raise InputError if the scene's mesh or matrix files have changed.

        Digests are compared with those stored in this file. A missing file is an error only if
        ``is_required``.
        """
        key_path_pairs = _list_scene_files(scene)
        for (key, path), stored_digest in zip(
            key_path_pairs, self._stored_scene_file_digests, strict=False
        ):
            file_digest = _file_digest(path)
            if file_digest != stored_digest and (
                is_required or file_digest != UNREADABLE_FILE_DIGEST
            ):
                requirement_text = (
                    f"unchanged since {self.path} was computed; restore it, "
                    "or compute the result again"
                )
                raise InputError(key, path, requirement_text)
        if is_required and len(self._stored_scene_file_digests) != len(key_path_pairs):
            raise self._older_version_error("checksums of all files of its matrices")

    def refusal(self, requirement_text: str) -> InputError:
        """Return an InputError with this file's path, for the caller to raise.

        ``requirement_text`` says what the file must be. The message has it after "must be".
        """
        return InputError("path", str(self.path), requirement_text)

    def check_kind(self, kind: str) -> None:
        """Raise InputError unless the file holds this kind of result."""
        if self.kind != kind:
            raise self.refusal(f"a file with a {kind}; it holds a {self.kind}")

    @contextlib.contextmanager
    def yield_datasets_with_valid_numbers(self) -> Iterator[dict[str, Any]]:
        """Check the numbers, and yield the datasets in a new dict (context manager).

        Used to build a result from the datasets in a ``with`` block. InputError is raised if
        :func:`check_arrays` finds invalid numbers. InputError also replaces an error in
        ``DATASET_ERROR_CLASSES`` in the block, since a dataset then does not fit the result.
        """
        try:
            check_arrays(self.datasets)
            yield dict(self.datasets)
        except InputError:
            raise
        except DATASET_ERROR_CLASSES as error:
            raise self.refusal(
                f"a {self.kind} as fc.save writes it; compute it again ({error})"
            ) from None

    @property
    def _stored_scene_file_digests(self) -> list[str]:
        """SHA-256 digests for the scene's files, stored when the result was written."""
        return self.attributes.get("meshes", "").split()

    def check_digest(self) -> None:
        """Raise InputError if the contents do not match the file's digest.

        A file without a digest, from an older version, is refused, too.
        """
        stored_digest = self.attributes.get("digest")
        if stored_digest is None:
            raise self._older_version_error("a checksum")
        if (
            content_digest(self.attributes, self.datasets or dataset_location_texts(self.columns))
            != stored_digest
        ):
            raise self.refusal("a whole file; this one is damaged: compute it again")

    def _older_version_error(self, content: str) -> InputError:
        """Return an InputError for a file by an older version, for the caller to raise.

        ``content`` names what the file lacks, such as "a checksum".
        """
        version = self.attributes.get("version", "unknown")
        requirement_text = (
            f"a file with {content}, which older versions did not write (this file: {version})"
        )
        remedy_text = "compute it again with the same command, a sweep in a new folder"
        return self.refusal(f"{requirement_text}; {remedy_text}")


def read_result_file(path: str | Path, comm: MPI.Comm = MPI.COMM_SELF) -> StoredFile:
    """Read a result file, and verify the digest (collective).

    Rank 0 lets a separate process read the file, since a damaged file may crash HDF5.

    Raises
    ------
    InputError
        The file cannot be read, is damaged, has an older version, or comes from another program.
    """
    return on_root(comm, lambda: _read_and_check_result_file(Path(path)))


def _read_and_check_result_file(path: Path) -> StoredFile:
    """Read a result file in a separate process, and check origin and digest.

    Raises as :func:`read_result_file`.
    """

    def refusal(reason: str) -> InputError:
        """Return the error for an unreadable file, with the reason in brackets."""
        kinds_text = (
            "an .h5 file that solve, curve or another command wrote; compute a damaged one again"
        )
        return InputError("path", str(path), f"a readable result file, {kinds_text} ({reason})")

    try:
        file_size = regular_file_size(path, None)
        if (
            read_first_bytes(path, len(HDF5_SIGNATURE)) != HDF5_SIGNATURE
        ):  # where it may also begin later
            raise refusal("it is not an HDF5 file")
        max_seconds = 5 + file_size // 10**7  # processor time: files are read at 10 MB/s and more
        array_by_name = run_reader_for_arrays(
            Path(__file__).with_name("h5_reader.py"), path, max_seconds, 2**28 + 2**27
        )
    except FileNotFoundError:
        raise InputError("path", str(path), "an existing file") from None
    except OSError as error:
        raise refusal(error.strerror or str(error)) from None
    if isinstance(array_by_name, str):
        raise refusal(array_by_name)
    try:
        stored_file = _stored_file_from_arrays(path, array_by_name)
    except (KeyError, TypeError, ValueError) as error:  # its reader has been led astray
        raise refusal(str(error)) from None
    if (
        stored_file.attributes.get("program") != PROGRAM_NAME
        or "kind" not in stored_file.attributes
    ):
        raise InputError("path", str(path), f"a result file of {PROGRAM_NAME}")
    stored_file.check_digest()
    if missing_attributes := {"version", "versions"} - stored_file.attributes.keys():
        raise InputError(
            "path",
            str(path),
            f"a file with the attribute {min(missing_attributes)}; compute it again",
        )
    return stored_file


def _stored_file_from_arrays(path: Path, array_by_name: Mapping[str, np.ndarray]) -> StoredFile:
    """Return a file's contents as a :class:`StoredFile`.

    ``path`` is the file. ``array_by_name`` comes from :func:`fenics_crack.files.h5_reader.read`: a
    header as JSON text, and numbered arrays.
    """
    contents = json.loads(str(array_by_name["head"]))
    stored_array_by_dataset_name = {
        name: array_by_name[f"arr_{array_index}"]
        for array_index, name in enumerate(contents["arrays"])
    }
    array_or_number_by_name = {
        name: array if array.ndim else array.item()
        for name, array in stored_array_by_dataset_name.items()
    }
    location_by_dataset_name = {
        name: DatasetLocation(np.dtype(dtype_text), tuple(shape), offset)
        for name, (dtype_text, shape, offset) in contents["columns"].items()
    }
    return StoredFile(
        path,
        contents["attributes"],
        contents["words"] | array_or_number_by_name,
        location_by_dataset_name,
    )


def check_shapes(datasets: Mapping[str, Any], shape_by_name: Mapping[str, tuple[int, ...]]) -> None:
    """Raise ValueError if a dataset has another shape than ``shape_by_name`` requires.

    -1 in a required shape allows any length. A name without a dataset is not checked.
    """
    for name, required_shape in shape_by_name.items():
        stored_shape = np.shape(datasets[name]) if name in datasets else required_shape
        has_same_dimension = len(stored_shape) == len(required_shape)
        if not has_same_dimension or any(
            required_length not in (-1, stored_length)
            for required_length, stored_length in zip(required_shape, stored_shape, strict=True)
        ):
            raise ValueError(f"its entry '{name}' has the wrong shape")


def read_result_file_without_numbers(path: str | Path) -> StoredFile:
    """Read a result file, and return its contents without the datasets' numbers.

    The result has the file's attributes. For a sweep, it also has each dataset's type, shape and
    offset in the file (``columns``), to read single cases later. The last 32 files' contents are
    cached until a file changes. InputError if the file cannot be read, is damaged, has an older
    version, or comes from another program.
    """
    try:
        file_status = os.stat(path)
    except (OSError, ValueError):
        return read_result_file(path)  # which says why it cannot be
    return _read_without_numbers_cached(
        Path(path),
        (file_status.st_dev, file_status.st_ino, file_status.st_size, file_status.st_mtime_ns),
    )


@functools.lru_cache(maxsize=32)
def _read_without_numbers_cached(path: Path, file_identity: tuple[int, ...]) -> StoredFile:
    """Read a result file without the datasets' numbers; results are cached.

    ``file_identity`` has numbers that change with the file, so a changed file is read again.
    """
    return replace(_read_and_check_result_file(path), datasets={})


def _list_scene_files(scene: Scene) -> list[tuple[str, str]]:
    """Return (key, path) for each file that a scene needs.

    Files named in the scene come first. Files to which the matrix files refer follow, with the
    matrix file's key. If the scene names a dof file, referenced ".dof" files are left out.
    """
    named_key_path_pairs = file_keys_and_paths(scene)
    # A named file of dofs takes the place of the file beside the matrices.
    has_named_dofs = any(key == "structure.dofs" for key, _ in named_key_path_pairs)
    key_path_pairs_of_referenced_files = [
        (key, str(referenced_file_path))
        for key, path in named_key_path_pairs
        for referenced_file_path in list_included_files(Path(path))
    ]
    return named_key_path_pairs + [
        key_path_pair
        for key_path_pair in key_path_pairs_of_referenced_files
        if not (has_named_dofs and key_path_pair[1].endswith(".dof"))
    ]


def list_scene_file_digests(scene: Scene) -> list[str]:
    """Return a SHA-256 digest for each file that a scene reads.

    The order is as in :func:`_list_scene_files`. A file that cannot be read has
    :data:`UNREADABLE_FILE_DIGEST`.
    """
    return [_file_digest(path) for _, path in _list_scene_files(scene)]


def _file_digest(path: str) -> str:
    """Return a file's SHA-256 digest, or :data:`UNREADABLE_FILE_DIGEST`."""
    try:
        return file_sha256(path)
    except OSError:
        return UNREADABLE_FILE_DIGEST


# --- results that need no structure ---------------------------------------------------------------


class SavableResult(Tabular):
    """Base class for a result with a scene that can be saved without a structure.

    Subclasses are frozen dataclasses with a class variable ``KIND``, the kind of contents in a
    file.
    """

    KIND: ClassVar[str]
    scene: Scene | None

    @check_calls
    def save(self, path: str | Path, comm: MPI.Comm = MPI.COMM_SELF) -> None:
        """Write a file that ``load``, ``fenics-crack plot`` and ``report`` read (collective).

        Raises
        ------
        InputError
            The file cannot be written.
        """
        write_result_file(self._pack_fields(), path, self.KIND, self.scene, comm)

    @classmethod
    @check_calls
    def load(cls, path: str | Path) -> Self:
        """Read a file written by ``save``; nothing is computed.

        Raises
        ------
        InputError
            The file cannot be read, is damaged, or holds something else.
        """
        return cls.from_stored_file(read_result_file(path))

    @classmethod
    def from_stored_file(cls, stored_file: StoredFile) -> Self:
        """Return the result in a result file that was read.

        Raises as :meth:`load`.
        """
        stored_file.check_kind(cls.KIND)
        with stored_file.yield_datasets_with_valid_numbers() as datasets:
            result = cls._from_datasets(datasets, stored_file.scene())
            repr(result), result.table()  # whose columns are of one length
            return result

    def _pack_fields(self) -> Datasets:
        """Return the fields as datasets by name."""
        return pack_dataclass(self)

    @classmethod
    def _from_datasets(cls, datasets: Datasets, scene: Scene | None) -> Self:
        """Return the result from datasets by field name.

        ``scene`` is the scene in the file, or None.
        """
        return unpack_dataclass(cls, datasets, scene)


# --- units ----------------------------------------------------------------------------------------

FOURIER_COEFFICIENT_ROWS_MEANING = (
    "rows a0, a1, b1, ..., aH, bH of a0 + sum_k a_k cos(k w t) + b_k sin(k w t), "
    "w = omega / subharmonic"
)
GAP_COEFFICIENT_ROWS_MEANING = (
    f"{FOURIER_COEFFICIENT_ROWS_MEANING}; a column for each pair; positive: penetration"
)
UNIT_AND_MEANING_BY_DATASET_NAME: dict[str, tuple[str, str]] = {
    "omega": ("rad/s", "load frequency, or natural frequency"),
    "gap_coefficients": ("m", GAP_COEFFICIENT_ROWS_MEANING),
    "force_coefficients": ("N", f"{FOURIER_COEFFICIENT_ROWS_MEANING}; a column for each pair"),
    "tangential_gap_coefficients": (
        "m",
        f"{FOURIER_COEFFICIENT_ROWS_MEANING}; a column for each pair",
    ),
    "tangential_force_coefficients": (
        "N",
        f"{FOURIER_COEFFICIENT_ROWS_MEANING}; a column for each pair",
    ),
    "watched_coefficients": (
        "m",
        f"{FOURIER_COEFFICIENT_ROWS_MEANING}; along a curve points before rows; last: 'watched'",
    ),
    "watched_displacement": ("m", "instants; 'watched'"),
    "multipliers": ("1", "Floquet multipliers; of a curve, the largest of each point"),
    "rest_amplitude": ("m", "half peak-to-peak of the motion from rest at the watched dof"),
    "static_above": ("rad/s", "frequency above which modes are quasi-static"),
    "weight": ("N/m", "of the constraint"),
    "law_stiffness": ("N/m", "of all pairs, or of each"),
    "law_sharpness": ("1/m", ""),
    "law_layer_depth": ("m", "of the layer on the crack faces"),
    "law_layer_share": ("1", ""),
    "law_coefficient": ("1", "of friction, of all pairs, or of each"),
    "law_direction": ("rad", "angle of the line along which each pair of a solid slides"),
    "law_turning": ("1", "sliding across these lines over sliding along them"),
    "law_tangential_stiffness": ("N/m", "of all pairs, or of each"),
    "law_force": ("N", "of a user's law, sum of all pairs, at gaps of 1e-12 to 10 m"),
    "unknowns": (
        "m",
        f"points; {GAP_COEFFICIENT_ROWS_MEANING}; gaps, or slow gaps where static_above is there",
    ),
    "states": ("m, m/s", "points; displacement and velocity at phase zero of the load; dofs"),
    "places": ("m", "points; tangential gaps at which pairs stick at phase zero; pairs"),
    "bifurcation_places": ("m", "bifurcations; pairs"),
    "bifurcation_states": ("m, m/s", "bifurcations; displacement and velocity; dofs"),
    "bifurcation_multipliers": ("1", "the largest Floquet multiplier of each bifurcation"),
    "shapes": ("kg^-1/2", "modes; nodes; x and y"),
    "nodes": ("m", "nodes; x and y, then x and y of the centre of the cells around the node"),
    "time": ("s", "instants"),
    "gap": ("m", "instants; pairs; positive: penetration"),
    **dict.fromkeys(("contact_force", "tangential_force"), ("N", "instants; pairs")),
    "tangential_gap": ("m", "instants; pairs"),
    "friction": ("1", "coefficient of friction, of all pairs, or of each"),
    "recorded": ("m", "instants; recorded_dofs"),
    "final_state": ("m, m/s", "displacement and velocity; dofs"),
    "final_places": ("m", "tangential gaps where pairs stick at the end; pairs"),
    "couplings": ("1, N", "pairs, then mean, cosine and sine part of the load; dofs"),
    "seconds": ("s", "wall-clock time"),
    "length": ("m", "of the crack"),
    "solved": ("m", "lengths that were solved; splines connect them"),
    "cycles": ("1", "of the load, until the crack has this length"),
    "rate": ("m", "growth in a cycle"),
    "response": ("m", "half peak-to-peak, at the load"),
    **dict.fromkeys(("largest", "smallest"), ("Pa m^0.5", "K_I over a cycle")),
    "effective": ("Pa m^0.5", "range of K_I while the crack tip is open"),
    "sliding": ("Pa m^0.5", "largest K_II"),
    "omega_open": ("rad/s", "natural frequencies with the crack open: speeds; modes"),
    "omega_tied": ("rad/s", "natural frequencies with the crack bonded: speeds; modes"),
    "omega_partly": ("rad/s", "natural frequencies with the pressed pairs bonded: speeds; modes"),
    "tuned": ("m", "largest amplitude of the tuned wheel"),
    "tuned_omega": ("rad/s", "frequency of that amplitude"),
    "marks": ("s", "beginnings of the revolutions, and the end of the last one"),
    "probes": ("rad", "angles of the probes"),
    "coefficients": ("m", "a0, a1, b1, ... over the rotor's angle"),
    "covariance": ("m^2", "of the coefficients"),
    "residuals": ("m", "root mean square of the fit of each order"),
    "amplitudes": ("m", "speeds; harmonics"),
    "amplitude_errors": ("m", "standard errors: speeds; harmonics"),
    "forces": ("m", "amplitude of each passage if the resonance lasted"),
    "omegas": ("rad/s", "natural frequency of each passage by itself"),
    "omega_errors": ("rad/s", "standard errors of these frequencies"),
}
"""Unit and meaning by dataset name; a meaning lists the axes in order."""


def dataset_attribute_texts(name: str, datasets: Mapping[str, Any]) -> dict[str, str]:
    """Return a dataset's HDF5 attributes: ``unit``, and ``about`` for the meaning.

    An attribute is left out if empty: counts and words have none.

    Parameters
    ----------
    name : str
        Dataset name.
    datasets : mapping
        All datasets in the file. For a curve's "values", the dataset "parameter" tells the unit.
    """
    if name in ("values", "bifurcation_values") and "parameter" in datasets:
        parameter_name = str(datasets["parameter"])  # most are factors
        unit_and_meaning = (
            UNIT_BY_DICT_ENTRY_NAME.get(parameter_name, "1"),
            f"of the parameter {parameter_name}",
        )
    elif name.startswith("error_"):
        unit_and_meaning = "1", "estimated, relative to the gap"
    elif name.removeprefix("bifurcation_").isdigit():
        unit_and_meaning = (
            UNIT_AND_MEANING_BY_DATASET_NAME["unknowns"][0],
            GAP_COEFFICIENT_ROWS_MEANING,
        )
    else:  # of a dataclass in others its last part
        last_name_part = name.rpartition(".")[2]
        unit_and_meaning = UNIT_AND_MEANING_BY_DATASET_NAME.get(
            last_name_part, (UNIT_BY_DICT_ENTRY_NAME.get(last_name_part, ""), "")
        )
    return {
        key: attribute_text
        for key, attribute_text in zip(("unit", "about"), unit_and_meaning, strict=True)
        if attribute_text
    }
