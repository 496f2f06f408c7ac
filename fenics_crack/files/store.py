"""Results on disk: HDF5 files that describe themselves.

A file has the attributes ``kind`` (what is in it), ``program`` and ``version``, ``versions`` of
what it was computed with, and, where there is one, the ``scene`` as TOML text; its datasets are
numbers and words, with the attributes ``unit`` and ``about``. Nothing in it is pickled, and nothing
of it is ever executed. The attribute ``digest`` is verified when it is read, ``meshes`` holds those
of the files of the scene.
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
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_crack.basics.atomic_files import write_file_whole
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.tables import UNIT_BY_NAME
from fenics_crack.basics.untrusted_files import (
    file_sha256,
    read_first_bytes,
    regular_file_size,
    run_reader,
)
from fenics_crack.fem.model_files import list_included_files
from fenics_crack.files.codec import DATASET_ERRORS, check_arrays
from fenics_crack.scene.scene import Scene, files_of, with_files
from fenics_crack.version import VERSION

if TYPE_CHECKING:
    import h5py


IDENTIFICATION_KIND = "identification"
"""Kind of the file of ``identify``, which draws its picture itself."""
PROGRAM_NAME = "fenics_crack"
MISSING_FILE_DIGEST = "missing"
"""In place of the digest of a file that cannot be read."""
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def write_result_file(
    parts: Mapping[str, Any],
    path: str | Path,
    kind: str,
    scene: Scene | None = None,
    comm: MPI.Comm = MPI.COMM_SELF,
    *,
    is_compressed: bool = True,
) -> None:
    """Write a file, whole or not at all (collective; rank 0 writes).

    Parameters
    ----------
    parts : mapping
        Datasets by their names: arrays, numbers, words, lists of words; None is left out.
    path : path
        The file; an older one is replaced once the new one is complete.
    kind : str
        Kind of its contents, for example "response curve".
    scene : Scene, optional
        Its scene.
    is_compressed : bool
        Compress large arrays, which takes 30 times as long.

    Raises
    ------
    InputError
        The file cannot be written.
    """

    def work() -> None:
        import h5py  # what only reads has its reader

        # In memory: HDF5 cannot be trusted with a full disk, and would load an old file.
        image = io.BytesIO()
        with h5py.File(image, "w") as file:
            write_header(file, kind, scene)
            for name, value in parts.items():
                if value is not None:
                    packed = (
                        {"compression": "gzip"} if is_compressed and np.size(value) > 1000 else {}
                    )
                    dataset = file.create_dataset(name, data=value, **packed)
                    dataset.attrs.update(describe_dataset(name, parts))
            file.attrs["digest"] = content_digest(attribute_texts(file), parts)
        write_file_whole(path, image.getvalue())

    on_root(comm, work)


def write_header(file: h5py.File, kind: str, scene: Scene | None) -> None:
    """Write the attributes: what is in the file, what made it, and from which scene."""
    file.attrs.update(kind=kind, program=PROGRAM_NAME, version=VERSION, versions=library_versions())
    if scene is not None:
        file.attrs["scene"] = scene_text(scene)
        file.attrs["meshes"] = "\n".join(scene_file_digests(scene))


def library_versions() -> str:
    """Versions of what the program uses; of SLEPc, DOLFINx and gmsh where they are loaded."""
    parts = {"PETSc": PETSc, "SLEPc": sys.modules.get("slepc4py.SLEPc")}
    found = {name: ".".join(map(str, one.Sys.getVersion())) for name, one in parts.items() if one}
    for name, module in (("NumPy", "numpy"), ("DOLFINx", "dolfinx"), ("gmsh", "gmsh")):
        if module in sys.modules:
            found[name] = sys.modules[module].__version__
    return ", ".join(f"{name} {version}" for name, version in found.items())


@functools.cache
def program_fingerprint() -> str:
    """What this program is, and what is installed that meshes and assembles: sizes and times of its
    sources, and of the files that load these."""
    specs = map(find_spec, ("dolfinx", "ufl", "ffcx", "basix", "petsc4py", "slepc4py", "gmsh"))
    files = [str(spec.origin) for spec in specs if spec is not None and spec.has_location]
    files += sorted(map(str, Path(__file__).parents[1].rglob("*.py")))
    return repr([(file, os.stat(file).st_size, os.stat(file).st_mtime_ns) for file in files])


def scene_text(scene: Scene) -> str:
    """The scene as it stands in a file: TOML, with the full paths of its files."""
    return scene_with_full_paths(scene).as_toml()


def scene_with_full_paths(scene: Scene) -> Scene:
    """The scene with the full paths of its files."""
    return with_files(scene, lambda path: str(Path(path).absolute()))


def attribute_texts(file: h5py.File) -> dict[str, str]:
    """Attributes of a file, and of its datasets by names like "omega/unit"."""
    found = {name: str(value) for name, value in file.attrs.items()}
    for name, item in file.items():
        found |= {f"{name}/{key}": str(value) for key, value in item.attrs.items()}
    return found


def locate_column(dataset: h5py.Dataset) -> Column:
    """Type, shape and place of a dataset that is filled in later."""
    return Column(dataset.dtype, dataset.shape, dataset.id.get_offset())


def column_texts(columns: Mapping[str, Column]) -> dict[str, str]:
    """The same in words."""
    return {name: str(column) for name, column in columns.items()}


def content_digest(attributes: Mapping[str, str], parts: Mapping[str, Any]) -> str:
    """SHA-256 of attributes, but for the digest, and of datasets: names, types, shapes and bytes.

    Parameters
    ----------
    attributes : mapping of str to str
        As :func:`texts` names them.
    parts : mapping
        Datasets by their names: arrays, numbers, words; None is left out. Of a sweep its
        :func:`places`.
    """
    total = hashlib.sha256()
    for name, text in sorted(attributes.items()):
        if name != "digest":
            total.update(json.dumps([name, text]).encode())
    for name, value in sorted(parts.items()):
        if value is None:
            continue
        array = np.asarray(value)
        if array.dtype.kind in "UO":
            total.update(json.dumps([name, array.tolist()]).encode())
        else:
            total.update(json.dumps([name, array.dtype.str, array.shape]).encode())
            total.update(array.tobytes())
    return total.hexdigest()


# --- reading --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Column:
    """Type, shape and place of a dataset that is filled in while the file is there."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    offset: int

    def __str__(self) -> str:
        return f"{self.dtype.str} {self.shape} {self.offset}"

    @property
    def size(self) -> int:
        """Bytes."""
        return math.prod(self.shape) * self.dtype.itemsize

    def read_values(self, path: Path, first: int = 0, count: int | None = None) -> np.ndarray:
        """Its numbers, or ``count`` of them from the ``first`` on (count,); OSError, ValueError."""
        start = self.offset + first * self.dtype.itemsize
        wanted = math.prod(self.shape) if count is None else count
        values = np.fromfile(path, self.dtype, wanted, offset=start)
        if len(values) < wanted:
            raise ValueError("it ends too early")
        return values.reshape(self.shape) if count is None else values


@dataclass(frozen=True)
class StoredFile:
    """Contents of a file whose digest has been verified.

    Attributes
    ----------
    path : Path
        The file.
    attributes : dict of str to str
        As :func:`texts` names them.
    parts : dict
        Datasets by their names: arrays, numbers and words. Of a sweep there are none.
    columns : dict of str to Column
        Of a sweep: where its datasets are.
    """

    path: Path
    attributes: dict[str, str]
    parts: dict[str, Any]
    columns: dict[str, Column]

    @property
    def kind(self) -> str:
        """Kind of result in the file, for example "response curve"."""
        return self.attributes["kind"]

    def scene(self) -> Scene | None:
        """Its scene, or None; no file that the scene names is opened.

        Raises
        ------
        InputError
            The scene cannot be used, or its mesh or matrices have no digests.
        """
        if "scene" not in self.attributes:
            return None
        scene = Scene.from_text(self.attributes["scene"], str(self.path))
        if len(self._digests) < len(files_of(scene)):
            raise self._older("digests of its mesh or matrices")
        return scene

    def check_files(self, scene: Scene, *, needed: bool = True) -> None:
        """Raise InputError if a file of the scene, of its mesh or matrices, has changed, or has
        gone where it is needed."""
        files = _list_scene_files(scene)
        for (key, path), known in zip(files, self._digests, strict=False):
            found = _file_digest(path)
            if found != known and (needed or found != MISSING_FILE_DIGEST):
                allowed = f"the file with which {self.path} was computed; it has changed or gone"
                raise InputError(key, path, allowed)
        if needed and len(self._digests) != len(files):
            raise self._older("digests of all files of its matrices")

    def refusal(self, allowed: str) -> InputError:
        """The error of a file that is not as allowed."""
        return InputError("path", str(self.path), allowed)

    def check_kind(self, kind: str) -> None:
        """Raise InputError if something else is in the file."""
        if self.kind != kind:
            raise self.refusal(f"a file with a {kind}; in this one is a {self.kind}")

    @contextlib.contextmanager
    def checked_datasets(self) -> Iterator[dict[str, Any]]:
        """Its datasets, to be taken apart; InputError if they are not as expected."""
        try:
            check_arrays(self.parts)
            yield dict(self.parts)
        except InputError:
            raise
        except DATASET_ERRORS as error:
            raise self.refusal(f"a {self.kind} written by save ({error})") from None

    @property
    def _digests(self) -> list[str]:
        return self.attributes.get("meshes", "").split()

    def check_digest(self) -> None:
        """Raise InputError unless the file is what was written."""
        known = self.attributes.get("digest")
        if known is None:
            raise self._older("a digest")
        if content_digest(self.attributes, self.parts or column_texts(self.columns)) != known:
            raise self.refusal("a whole file; this one is damaged")

    def _older(self, what: str) -> InputError:
        version = self.attributes.get("version", "unknown")
        older = f"a file with {what}, which older versions did not write (this one: {version})"
        remedy = "make it again with the command that wrote it, a sweep in a new folder"
        return self.refusal(f"{older}; {remedy}")


def read_result_file(path: str | Path, comm: MPI.Comm = MPI.COMM_SELF) -> StoredFile:
    """Read a file and verify its digest (collective); rank 0 lets a program of its own read it.

    Raises
    ------
    InputError
        The file cannot be read, is damaged, of an older version, or not one of this program.
    """
    return on_root(comm, lambda: _read_and_check(Path(path)))


def _read_and_check(path: Path) -> StoredFile:
    def refusal(why: str) -> InputError:
        kinds = "one of the .h5 files that solve, curve and the other commands write"
        return InputError("path", str(path), f"a readable result file, {kinds} ({why})")

    try:
        size = regular_file_size(path, None)
        if (
            read_first_bytes(path, len(HDF5_SIGNATURE)) != HDF5_SIGNATURE
        ):  # where it may also begin later
            raise refusal("it does not begin as HDF5 files do")
        seconds = 5 + size // 10**7  # of processor time: any file is read at 10 MB/s and more
        found = run_reader(Path(__file__).with_name("h5_reader.py"), path, seconds, 2**28 + 2**27)
    except FileNotFoundError:
        raise InputError("path", str(path), "a file that exists") from None
    except OSError as error:
        raise refusal(error.strerror or str(error)) from None
    if isinstance(found, str):
        raise refusal(found)
    try:
        stored = _stored_file_from_arrays(path, found)
    except (KeyError, TypeError, ValueError) as error:  # its reader has been led astray
        raise refusal(str(error)) from None
    if stored.attributes.get("program") != PROGRAM_NAME or "kind" not in stored.attributes:
        raise InputError("path", str(path), f"a result file of {PROGRAM_NAME}")
    stored.check_digest()
    if missing := {"version", "versions"} - stored.attributes.keys():
        raise InputError("path", str(path), f"a file with the attribute {min(missing)}")
    return stored


def _stored_file_from_arrays(path: Path, found: Mapping[str, np.ndarray]) -> StoredFile:
    """Return the file's contents from the arrays that the reader hands over."""
    head = json.loads(str(found["head"]))
    arrays = {name: found[f"arr_{number}"] for number, name in enumerate(head["arrays"])}
    numbers = {name: one if one.ndim else one.item() for name, one in arrays.items()}
    columns = {
        name: Column(np.dtype(kind), tuple(shape), offset)
        for name, (kind, shape, offset) in head["columns"].items()
    }
    return StoredFile(path, head["attributes"], head["words"] | numbers, columns)


def check_shapes(parts: Mapping[str, Any], shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise ValueError unless the datasets that are there have these shapes; -1 is any length."""
    for name, shape in shapes.items():
        found = np.shape(parts[name]) if name in parts else shape
        same = len(found) == len(shape)
        if not same or any(n not in (-1, m) for n, m in zip(shape, found, strict=True)):
            raise ValueError(f"its {name} does not fit")


def read_header(path: str | Path) -> StoredFile:
    """A file without its numbers, which are verified too; raises as :func:`read`.

    It is read again when it has changed.
    """
    try:
        now = os.stat(path)
    except (OSError, ValueError):
        return read_result_file(path)  # which says why it cannot be
    return _read_header_cached(Path(path), (now.st_dev, now.st_ino, now.st_size, now.st_mtime_ns))


@functools.lru_cache(maxsize=32)
def _read_header_cached(path: Path, state: tuple[int, ...]) -> StoredFile:
    return replace(_read_and_check(path), parts={})


def _list_scene_files(scene: Scene) -> list[tuple[str, str]]:
    """The keys that name files of a scene, and these; then those that are read with them."""
    found = files_of(scene)
    named = any(key == "structure.dofs" for key, _ in found)  # takes the place of those beside
    beside = [(key, str(more)) for key, path in found for more in list_included_files(Path(path))]
    return found + [one for one in beside if not (named and one[1].endswith(".dof"))]


def scene_file_digests(scene: Scene) -> list[str]:
    """SHA-256 of the files that a scene names, and of those that are read with them."""
    return [_file_digest(path) for _, path in _list_scene_files(scene)]


def _file_digest(path: str) -> str:
    """SHA-256 of a file, or :data:`MISSING`."""
    try:
        return file_sha256(path)
    except OSError:
        return MISSING_FILE_DIGEST


# --- units ----------------------------------------------------------------------------------------

COEFFICIENT_ROWS_TEXT = (
    "rows a0, a1, b1, ..., aH, bH of a0 + sum_k a_k cos(k w t) + b_k sin(k w t), "
    "w = omega / subharmonic"
)
GAP_ROWS_TEXT = f"{COEFFICIENT_ROWS_TEXT}; a column for each pair; positive: penetration"
UNIT_AND_MEANING_BY_NAME: dict[str, tuple[str, str]] = {
    "omega": ("rad/s", "load frequency, or natural frequency"),
    "gap_coefficients": ("m", GAP_ROWS_TEXT),
    "force_coefficients": ("N", f"{COEFFICIENT_ROWS_TEXT}; a column for each pair"),
    "tangential_gap_coefficients": ("m", f"{COEFFICIENT_ROWS_TEXT}; a column for each pair"),
    "tangential_force_coefficients": ("N", f"{COEFFICIENT_ROWS_TEXT}; a column for each pair"),
    "watched_coefficients": (
        "m",
        f"{COEFFICIENT_ROWS_TEXT}; along a curve points before rows; last: 'watched'",
    ),
    "watched_displacement": ("m", "instants; 'watched'"),
    "multipliers": ("1", "Floquet multipliers, those of a curve the largest of each point"),
    "rest_amplitude": ("m", "half peak-to-peak of the motion from rest at the watched dof"),
    "static_above": ("rad/s", "modes of higher frequencies are quasi-static"),
    "weight": ("N/m", "of the constraint"),
    "law_stiffness": ("N/m", "of all pairs, or of each"),
    "law_sharpness": ("1/m", ""),
    "law_coefficient": ("1", "of friction, of all pairs, or of each"),
    "law_direction": ("rad", "of the line along which each pair of a solid slides"),
    "law_turning": ("1", "sliding across these lines over that along them"),
    "law_tangential_stiffness": ("N/m", "of all pairs, or of each"),
    "law_force": ("N", "of a law of one's own, of all pairs together, at gaps of 1e-12 to 10 m"),
    "unknowns": ("m", f"points; {GAP_ROWS_TEXT}; gaps, or slow gaps where static_above is there"),
    "states": ("m, m/s", "points; displacement and velocity at phase zero of the load; dofs"),
    "places": ("m", "points; tangential gaps at which pairs stick at phase zero; pairs"),
    "bifurcation_places": ("m", "bifurcations; pairs"),
    "bifurcation_states": ("m, m/s", "bifurcations; displacement and velocity; dofs"),
    "bifurcation_multipliers": ("1", "the largest Floquet multiplier of each bifurcation"),
    "shapes": ("kg^-1/2", "modes; nodes; x and y"),
    "nodes": ("m", "nodes; x and y, and those of the middle of the cells around it"),
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
    "solved": ("m", "lengths that were solved; between them are splines"),
    "cycles": ("1", "of the load, until the crack is so long"),
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
    "forces": ("m", "amplitude of each passage in a resonance that lasts"),
    "omegas": ("rad/s", "natural frequency of each passage by itself"),
    "omega_errors": ("rad/s", "standard error of these"),
}
"""Unit, and what it is, axis by axis."""


def describe_dataset(name: str, parts: Mapping[str, Any]) -> dict[str, str]:
    """The attributes of a dataset, of those of its file; none where it is a count or a word."""
    if name in ("values", "bifurcation_values") and "parameter" in parts:
        parameter = str(parts["parameter"])  # most are factors
        found = UNIT_BY_NAME.get(parameter, "1"), f"of the parameter {parameter}"
    elif name.startswith("error_"):
        found = "1", "estimated, relative to the gap"
    elif name.removeprefix("bifurcation_").isdigit():
        found = UNIT_AND_MEANING_BY_NAME["unknowns"][0], GAP_ROWS_TEXT
    else:  # of a dataclass in others its last part
        last = name.rpartition(".")[2]
        found = UNIT_AND_MEANING_BY_NAME.get(last, (UNIT_BY_NAME.get(last, ""), ""))
    return {key: words for key, words in zip(("unit", "about"), found, strict=True) if words}
