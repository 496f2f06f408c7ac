"""The structure of a command in a file beside its results, for the commands after it.

The file has the matrices and modes of a mesh at rest, and of its coarser mesh. A scene of the same
:func:`key_of` can use the file: frequency, amplitude of the load, damping, clearance, law and
tolerance may differ, the mesh may not.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.basics.errors import InputError
from fenics_crack.fem.setting import force_vector_by_part
from fenics_crack.files.codec import WRONG, packed, unpacked
from fenics_crack.files.store import fingerprint, read, write
from fenics_crack.model.factor import local_rows
from fenics_crack.scene.scene import Scene
from fenics_crack.study.artefact import (
    PreparedFile,
    PreparedStructure,
    Rows,
    load_weights,
    without_amplitudes,
)
from fenics_crack.study.sharing import Made, kept, parts_shared

KIND = "structure of a command"
MAX_BYTES = 500 * 10**6
"""Largest size of the numbers that are kept [byte]."""


def key_of(parts: tuple[Any, ...]) -> str:
    """Return the digest of everything a structure depends on, except load amplitudes."""
    dependencies = parts[0], without_amplitudes(parts[1]), fingerprint()
    return hashlib.sha256(repr(dependencies).encode()).hexdigest()


class Shelf:
    """Keep the structure of a command in a file.

    Parameters
    ----------
    path : Path
        The file.
    say : callable
        Prints a line.
    is_read : bool
        Look for the structure in the file.
    """

    def __init__(self, path: Path, say: Callable[[str], None], *, is_read: bool) -> None:
        self._path, self._say, self._n_bytes = path, say, 0
        self._files: list[PreparedFile | None] = [] if is_read else [None]
        self._made: list[tuple[Made, Scene]] = []

    def take(self, scene: Scene, comm: MPI.Comm) -> Made | None:
        """Return the structure of a scene if the file has it (collective)."""
        try:
            if not self._files:
                stored_file = read(self._path, comm)
                stored_file.fitting_argument(KIND)
                with stored_file.taken() as parts:
                    self._files.append(unpacked(PreparedFile, parts))
            file = self._files[0]
            if file is None or file.structure.key != key_of(parts_shared(scene, comm)):
                return None
            entry = file.make_structures(
                scene, load_weights(file.structure.excitation, scene), comm
            )
        except (InputError, *WRONG) as error:
            self._files[:] = [None]
            self._say(f"{self._path}: not used, {error}")
            return None
        self._made[:], self._n_bytes = [(entry, scene)], _n_bytes(packed(file))
        words = f"the structure is taken from here ({self._n_bytes / 1e6:.3g} MB)"
        self._say(f"{self._path}: {words}; --fresh computes it anew")
        return entry

    def note(self, entry: Made, scene: Scene) -> None:
        """Note a structure; the file gets the first one, or its replacement."""
        if not self._made or self._made[0][0].parts[0] == entry.parts[0]:
            self._made[:] = [(entry, scene)]

    def keep(self, comm: MPI.Comm) -> None:
        """Write the file unless it has everything already (collective)."""
        for entry, scene in self._made:
            if entry.comm.size < comm.size and comm.rank:
                return  # each rank has one for itself
            twins = entry.structure.compute_once(kept, from_matrices=True)
            twins = [twin for twin in twins if twin.parts[1] == entry.parts[1]]  # of this load
            parts = packed(
                PreparedFile(*(_datasets(kept_entry, scene) for kept_entry in (entry, *twins)))
            )
            if not self._n_bytes < (n_bytes := _n_bytes(parts)):
                return
            try:
                if n_bytes > MAX_BYTES:
                    raise InputError("path", str(self._path), f"of at most {MAX_BYTES / 1e6:g} MB")
                write(parts, self._path, KIND, scene, entry.comm, is_compressed=False)
            except InputError as error:
                self._say(f"the structure is not kept: {error}")


def _datasets(entry: Made, scene: Scene) -> PreparedStructure:
    """Gather the datasets of a structure of a mesh (collective)."""
    return PreparedStructure.of(
        entry.structure, entry.structure.nodes.vtk_type,  # type: ignore[union-attr]
        mass=Rows.of(local_rows(entry.structure.mass), entry.comm), key=key_of(entry.parts),
        stiffness=Rows.of(local_rows(entry.structure.stiffness), entry.comm),
        excitation=np.array(force_vector_by_part(scene), dtype=float),
    )  # fmt: skip


def _n_bytes(parts: Mapping[str, Any]) -> int:
    """Return the size of all arrays among datasets [byte]."""
    return sum(part.nbytes for part in parts.values() if isinstance(part, np.ndarray))
