"""The structure of a command in a file beside its results, for the commands after it.

The file has the matrices, the modes that were needed so far, and the same of the coarser mesh. It
serves scenes with all that these follow from (:func:`key_of`): another frequency, amplitude of the
load, damping, clearance, law or tolerance finds it valid, another mesh does not. It has structures
of meshes at rest.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.observables import QUANTITIES
from fenics_crack.basics.ranks import on_root
from fenics_crack.fem.setting import parts_of
from fenics_crack.files.codec import WRONG, packed, unpacked
from fenics_crack.files.store import fingerprint, read, write
from fenics_crack.model.receptance import held_receptance
from fenics_crack.scene.scene import Scene
from fenics_crack.study.artefact import PreparedFile, PreparedStructure, load_weights
from fenics_crack.study.meshes import coarser_scene
from fenics_crack.study.sharing import SHELVES, Made, kept, parts_shared

KIND = "structure of a command"
MAX_BYTES = 500 * 10**6
"""Largest size of the numbers that are kept [byte]."""
AMPLITUDES = ("force_mean", "force_cos", "force_sin", "harmonics")
"""Keys of the excitation in which the load is linear."""


def key_of(parts: tuple[Any, ...]) -> str:
    """Digest of what a structure follows from, but for amplitudes of the excitation."""
    excitation, *loads = parts[1]
    fixed = {name: value for name, value in excitation.items() if name not in AMPLITUDES}
    return hashlib.sha256(repr((parts[0], fixed, loads, fingerprint())).encode()).hexdigest()


class Shelf:
    """Where a command looks for its structure, and keeps it.

    Parameters
    ----------
    path : Path
        The file.
    say : callable
        Prints a line.
    fresh : bool
        Do not read the file.
    """

    def __init__(self, path: Path, say: Callable[[str], None], *, fresh: bool) -> None:
        self._path, self._say = path, say
        self._files: list[PreparedFile | None] = [None] if fresh else []
        self._made: list[tuple[Made, Scene]] = []
        self._size = 0

    def take(self, scene: Scene, comm: MPI.Comm) -> Made | None:
        """Return the structure of a scene if the file has it (collective)."""
        try:
            if not self._files:
                self._files.append(self._read(comm))
            file = self._files[0]
            if file is None or file.whole.key != key_of(parts_shared(scene, comm)):
                return None
            made = file.made(scene, load_weights(file.whole.excitation, scene), comm)
        except (InputError, *WRONG) as error:
            self._files[:] = [None]
            self._say(f"{self._path}: not used, {error}")
            return None
        self._made[:], self._size = [(made, scene)], _size(made)
        self._say(f"{self._path}: the structure is taken from here; --fresh computes it anew")
        return made

    def _read(self, comm: MPI.Comm) -> PreparedFile | None:
        """Return what the file has; None if there is none."""
        if not on_root(comm, self._path.exists):
            return None
        stored = read(self._path, comm)
        stored.fitting_argument(KIND)
        with stored.taken() as parts:
            return unpacked(PreparedFile, parts)

    def note(self, made: Made, scene: Scene) -> None:
        """Note a structure that was made: the first is kept, or what takes its place."""
        if not self._made or self._made[0][0].parts[0] == made.parts[0]:
            self._made[:] = [(made, scene)]

    def keep(self, rank: int) -> None:
        """Write the file if more is known than it has (collective)."""
        for made, scene in self._made:
            if _size(made) > self._size and (made.comm.size > 1 or not rank):
                self._size = _size(made)
                self._write(made, scene)

    def _write(self, made: Made, scene: Scene) -> None:
        coarse, twins = coarser_scene(scene), made.structure.once(kept, of_matrices=True)
        pairs = [(made, scene), *((twin, coarse) for twin in twins)]
        structures = (
            PreparedStructure.of(
                one.structure, key=key_of(one.parts), excitation=np.array(parts_of(its), float)
            )
            for one, its in pairs
        )
        parts = packed(PreparedFile(*structures))
        size = sum(np.asarray(part).nbytes for part in parts.values())
        try:
            if size > MAX_BYTES:
                raise InputError("path", str(self._path), f"of at most {MAX_BYTES / 1e6:g} MB")
            write(parts, self._path, KIND, scene, made.comm, compressed=False)
        except InputError as error:
            self._say(f"the structure is not kept: {error}")


def _size(made: Made) -> int:
    """Return how much is known of a structure, in numbers of its receptances; at least 1."""
    every = [made.structure, *(twin.structure for twin in made.structure.once(kept, of_matrices=True))]
    both = {id(one): one for each in every for one in (each.original, each.original.with_tangents())}
    seen = [held for one in both.values() for held in one.once(held_receptance)]
    return len(every) + sum(one.n_modes * (len(one.modal) + len(one.rows)) for one in seen)


def keep_structures(rank: int) -> None:
    """Write the structure of the command (collective)."""
    for shelf in SHELVES:
        shelf.keep(rank)


def has_place(scene: Scene) -> bool:
    """Return True if results of a scene need no mesh of DOLFINx beside its structure."""
    asked = [QUANTITIES[name].of.on_request for name in scene.quantities or ()]
    return not any(asked) and scene.geometry is not None and scene.geometry.file is None
