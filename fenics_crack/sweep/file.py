"""The file of a sweep: filled in while the sweep runs, and sound whenever the program is killed.

HDF5 keeps metadata in memory and writes it at times of its own; a program killed in between leaves
a file that cannot be opened. So no metadata changes once the file has its name:

- it is made whole under another name, closed, and then renamed;
- every dataset has its full size from the start, in one contiguous piece whose place is fixed
  (early allocation), and the oldest file format, which keeps no mark of who has it open;
- finished cases overwrite their own bytes: first all their numbers, which are handed to the system
  (flush), and only then their ``state``. What has a state is complete; what a kill has left half
  written has none, and is computed again.

Unwritten parts take no space where the file system supports sparse files. The file can be read
while it is being written. A lock keeps a second sweep from writing to it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fenics_crack.errors import InputError
from fenics_crack.files import store
from fenics_crack.scene.scene import Scene
from fenics_crack.version import VERSION

__all__ = [
    "COLUMNS",
    "CONVERGED",
    "FAILED",
    "PENDING",
    "SweepFile",
    "read_columns",
    "read_waves",
    "shape_of",
]

KIND = "sweep"
PENDING, CONVERGED, FAILED = 0, 1, 2
"""The states of a case."""
STATUS_BYTES = 200
COLUMNS: dict[str, tuple[str, str]] = {
    "response": ("m", "f8"),
    "opening": ("m", "f8"),
    "penetration": ("m", "f8"),
    "contact_force": ("N", "f8"),
    "closed_share": ("1", "f8"),
    "multiplier": ("1", "f8"),
    "verdict": ("", "S12"),
    "residual_error": ("1", "f8"),
    "truncation_error": ("1", "f8"),
    "sampling_error": ("1", "f8"),
    "reduction_error": ("1", "f8"),
    "penetration_share": ("1", "f8"),
    "harmonics": ("1", "i4"),
    "iterations": ("1", "i4"),
    "crack_length": ("m", "f8"),
    "seconds": ("s", "f8"),
    "status": ("", f"S{STATUS_BYTES}"),
}
"""Of each case, beside its state: unit and type."""


def shape_of(scene: Scene) -> tuple[int, ...]:
    """How many values each axis of a scene's sweep has."""
    assert scene.sweep is not None
    return tuple(len(axis.values) for axis in scene.sweep.over)


class SweepFile:
    """A sweep's file, open for writing.

    Parameters
    ----------
    path : path
        An existing file is continued; without one it is made.
    scene : Scene
        With its table ``[sweep]``.
    harmonics, pairs : int
        Most harmonics and most contact pairs of any case.

    Raises
    ------
    InputError
        The file cannot be written, is being written by another program, is not a sweep, or is one
        of another scene.
    """

    def __init__(self, path: Path, scene: Scene, harmonics: int, pairs: int) -> None:
        self._path = path
        try:
            self.made = not path.exists()
            if self.made:
                try:
                    _make(path, scene, harmonics, pairs)
                except FileExistsError:
                    self.made = False
            if not self.made:
                _check(path, scene)
            self._file = h5py.File(path, "r+", libver="earliest")
        except OSError as error:
            raise InputError(
                "path", str(path), f"a file that can be written, by one sweep at a time ({error})"
            ) from None
        self.state: np.ndarray = self._file["state"][()]
        """PENDING, CONVERGED or FAILED, in the shape of the axes."""

    def write(
        self,
        index: tuple[Any, ...],
        state: np.ndarray,
        columns: Mapping[str, np.ndarray],
        waves: Mapping[str, list[np.ndarray]],
    ) -> None:
        """Write some cases: all of their numbers, and then their states.

        Parameters
        ----------
        index : tuple of int and slice
            Which; one of them a slice.
        state : (n,)
            CONVERGED or FAILED.
        columns : mapping
            :data:`COLUMNS`, (n,) each.
        waves : mapping
            "gap" [m] and "force" [N]: n arrays (2H+1, n_pairs), empty where a case failed.
        """
        for name, values in columns.items():
            self._file[name][index] = values
        for name, arrays in waves.items():
            if name in self._file:
                wave = self._file[name]
                padded = np.full((len(arrays), *wave.shape[-2:]), np.nan)
                for row, array in zip(padded, arrays, strict=True):
                    row[: array.shape[0], : array.shape[1]] = array
                wave[index] = padded
        self._file.flush()
        self._file["state"][index] = state
        self._file.flush()
        self.state[index] = state

    def close(self, *, remove: bool = False) -> None:
        """Close the file, or remove it."""
        self._file.close()
        if remove:
            self._path.unlink(missing_ok=True)


def _make(path: Path, scene: Scene, harmonics: int, pairs: int) -> None:
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    shape = shape_of(scene)
    sizes = {"state": ("", "u1", shape)}
    sizes |= {name: (unit, kind, shape) for name, (unit, kind) in COLUMNS.items()}
    if pairs:
        wave = (*shape, 2 * harmonics + 1, pairs)
        sizes |= {"gap": ("m", "f8", wave), "force": ("N", "f8", wave)}
    store.make_folder(path)
    try:
        with h5py.File(partial, "w", libver="earliest") as file:
            store.write_header(file, KIND, scene)
            for name, (unit, kind, size) in sizes.items():
                plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
                plan.set_layout(h5py.h5d.CONTIGUOUS)
                plan.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
                plan.set_fill_time(h5py.h5d.FILL_TIME_NEVER)  # a new file is zero: pending
                plan.set_obj_track_times(False)
                space = h5py.h5s.create_simple(size)
                kept = h5py.h5t.py_create(np.dtype(kind))
                h5py.h5d.create(file.id, name.encode(), kept, space, plan)
                file[name].attrs["unit"] = unit
        os.link(partial, path)  # fails where another program has been quicker
    finally:
        partial.unlink(missing_ok=True)


def _check(path: Path, scene: Scene) -> None:
    """Raise InputError unless a file is the sweep of a scene, by this version of the program."""
    with store.opened(path, KIND) as file:
        same = file.attrs.get("scene") == store.scene_text(scene)
        version = str(file.attrs.get("version"))
        store.check_meshes(file, scene)
    if not same:
        raise InputError(
            "path", str(path), "the file of the same scene; for another one choose a new folder"
        )
    if version != VERSION:
        allowed = f"a new name: it was begun by version {version}, this is {VERSION}"
        raise InputError("path", str(path), allowed)


def read_columns(path: Path) -> tuple[Scene, dict[str, np.ndarray]]:
    """The scene, and ``state`` and the columns in the shape of the axes.

    Numbers of pending cases are nan (0 where they are whole numbers), words are empty.
    """
    with store.opened(path, KIND) as file:
        scene = Scene.from_text(str(file.attrs["scene"]), str(path))
        if any(file[name].shape != shape_of(scene) for name in ("state", *COLUMNS)):
            raise InputError("path", str(path), "a whole sweep")
        found = {"state": file["state"][()]}  # first: what is written later counts as pending
        for name in COLUMNS:
            values = file[name][()]
            if values.dtype.kind == "f":
                values[found["state"] == PENDING] = np.nan
            elif values.dtype.kind == "S":
                values = np.char.decode(values, "utf-8", "replace")
                values[found["state"] == PENDING] = ""
            else:
                values[found["state"] == PENDING] = 0
            found[name] = values
    return scene, found


def read_waves(path: Path, index: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Gap [m] and force [N] coefficients of a case that converged: (2H+1, n_pairs) each."""
    with store.opened(path, KIND) as file:
        if "gap" not in file:
            empty = np.zeros((2 * int(file["harmonics"][index]) + 1, 0))
            return empty, empty
        gap, force = file["gap"][index], file["force"][index]
    rows, pairs = np.isfinite(gap[:, 0]), np.isfinite(gap[0])
    return gap[rows][:, pairs], force[rows][:, pairs]
