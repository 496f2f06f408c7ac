"""The structure of a command in a file beside its results, for the commands after it.

The file has the matrices, what has been seen of the modes, and the same of the coarser mesh. It
serves scenes with all that these follow from (:func:`key_of`): another frequency, amplitude of the
load, damping, clearance, law or tolerance finds it valid, another mesh does not. It has structures
of meshes at rest.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.observables import QUANTITIES
from fenics_crack.basics.ranks import gather_rows, on_root
from fenics_crack.fem.setting import clearance_of, damping_of, parts_of
from fenics_crack.files.codec import WRONG, packed, unpacked
from fenics_crack.files.store import check_shapes, fingerprint, read, write
from fenics_crack.model.body import UNVARIED, Body
from fenics_crack.model.factor import local_rows, square_matrix
from fenics_crack.model.nodes import Clamp, Nodes, Pairs
from fenics_crack.model.receptance import Receptance, held_receptance, last_receptance, sources_of
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import ROUNDING
from fenics_crack.scene.scene import Scene
from fenics_crack.study.meshes import coarser_scene
from fenics_crack.study.sharing import SHELVES, Made, kept, parts_shared

KIND = "structure of a command"
MAX_BYTES = 500 * 10**6
"""Largest size of the numbers that are kept [byte]."""
AMPLITUDES = ("force_mean", "force_cos", "force_sin", "harmonics")
"""Keys of the excitation in which the load is linear."""
NODE_ARRAYS = ("points", "dofs", "cells")


def key_of(parts: tuple[Any, ...]) -> str:
    """Digest of what a structure follows from, but for amplitudes of the excitation."""
    excitation, *loads = parts[1]
    fixed = {name: value for name, value in excitation.items() if name not in AMPLITUDES}
    return hashlib.sha256(repr((parts[0], fixed, loads, fingerprint())).encode()).hexdigest()


@dataclass(frozen=True)
class _Rows:
    """A sparse matrix by its rows, those of all ranks."""

    data: np.ndarray
    indices: np.ndarray
    indptr: np.ndarray

    @classmethod
    def of(cls, rows: Any, comm: MPI.Comm) -> _Rows | None:
        """The rows of this rank and the others'; None of None (collective)."""
        if rows is None:
            return None
        lengths = gather_rows(comm, np.diff(rows.indptr))
        starts = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
        return cls(gather_rows(comm, rows.data), gather_rows(comm, rows.indices), starts)

    def matrix(self, *shape: int) -> sparse.csr_matrix:
        """The matrix; ValueError unless it is one of this shape."""
        if self.indices.dtype.kind != "i" or self.indptr.dtype.kind != "i":
            raise ValueError("its indices do not fit")
        rows = sparse.csr_matrix((self.data, self.indices, self.indptr), shape)
        rows.check_format(full_check=True)
        return rows


@dataclass(frozen=True)
class _Kept:
    """A structure as the datasets of a file, with the digest of what it follows from."""

    key: str
    excitation: np.ndarray  # (2K+1, d) [N]
    mass: _Rows
    stiffness: _Rows
    gap: _Rows
    tangential: _Rows | None
    tangents: _Rows | None
    shares: _Rows | None
    force: np.ndarray
    watched: np.ndarray | None
    nodes: Nodes
    pairs: Pairs
    clamp: Clamp
    seen: tuple[Receptance, ...]

    @classmethod
    def of(cls, made: Made, scene: Scene) -> _Kept:
        """The datasets of a structure (collective)."""
        whole, comm = made.structure, made.structure.comm
        nodes, pairs, clamp = whole.nodes, whole.pairs, whole.clamp
        assert nodes is not None and clamp is not None  # of a mesh
        matrices = local_rows(whole.mass), local_rows(whole.stiffness)
        sparse_rows = *matrices, whole.gap, whole.tangential, pairs.tangents
        arrays = {name: gather_rows(comm, getattr(nodes, name)) for name in NODE_ARRAYS}
        return cls(
            key_of(made.parts), np.array(parts_of(scene), dtype=float),
            *(_Rows.of(rows, comm) for rows in sparse_rows), _Rows.of(pairs.shares, MPI.COMM_SELF),
            gather_rows(comm, whole.force.T).T,
            None if whole.watched is None else gather_rows(comm, whole.watched),
            replace(nodes, numbered=None, **arrays), replace(pairs, shares=None, tangents=None),
            replace(clamp, inertia=gather_rows(comm, clamp.inertia.T).T),
            tuple(replace(seen, force=np.zeros(0)) for seen in _seen(whole)),
        )  # fmt: skip

    def structure(self, scene: Scene, comm: MPI.Comm) -> Structure | None:
        """Return the structure under the load of a scene, all of whose rows rank 0 has.

        None if the load is no sum of this one's parts; an error of :data:`WRONG` if the datasets
        are no structure (collective).
        """
        n_dofs, n_pairs = self._check()
        own = slice(None if comm.rank == 0 else 0)

        def rows(part: _Rows | None, columns: int) -> Any:
            return part and part.matrix(n_dofs, columns)[own]

        shares = self.shares and self.shares.matrix(len(self.pairs.nodes), n_pairs)  # type: ignore
        pairs = replace(self.pairs, shares=shares, tangents=rows(self.tangents, 2 * n_pairs))
        arrays = {name: getattr(self.nodes, name)[own] for name in NODE_ARRAYS}
        whole = Structure(Body(
            *(square_matrix(rows(part, n_dofs), comm) for part in (self.mass, self.stiffness)),
            rows(self.gap, n_pairs), self.force[:, own], clearance_of(scene, pairs),
            damping_of(scene.damping), rows(self.tangential, n_pairs),
            replace(self.nodes, **arrays), pairs, None if self.watched is None else self.watched[own],
            replace(self.clamp, inertia=self.clamp.inertia[:, own]), comm=comm,
        ))  # fmt: skip
        for seen in self.seen:
            _put(whole if len(seen.modal) == _n_sources(whole) else whole.with_tangents(), seen)
        before, after = self.excitation, np.array(parts_of(scene), dtype=float)
        if np.array_equal(before, after):
            return whole
        weights = after @ np.linalg.pinv(before)
        missed = np.abs(weights @ before - after).max() > ROUNDING * np.abs(after).max()
        if missed or scene.has_other_loads:
            return None
        force = weights @ whole.force
        return whole._in(UNVARIED, force=force, clamp=self.clamp.varied(weights))

    def _check(self) -> tuple[int, int]:
        """Return the numbers of dofs and pairs; ValueError unless sizes and numbers fit."""
        arrays = {name: array for name, array in packed(self).items() if np.ndim(array)}
        nodes, pairs, free = self.nodes, self.pairs, self.nodes.dofs[self.nodes.dofs >= 0]
        n_parts, dimension = self.excitation.shape
        n_nodes, n_dofs, n_pairs = len(nodes.points), free.size, len(pairs.points)
        shapes = {
            "force": (n_parts, n_dofs), "watched": (n_dofs,), "nodes.points": (n_nodes, dimension),
            "nodes.dofs": (n_nodes, dimension), "nodes.cells": (-1, -1),
            "pairs.points": (n_pairs, dimension), "pairs.nodes": (-1, dimension),
            "clamp.center": (dimension,), "clamp.inertia": (len(self.clamp.inertia), n_dofs),
            "clamp.load": (n_parts, len(self.clamp.inertia)),
        }  # fmt: skip
        shapes |= dict.fromkeys(("pairs.areas", "pairs.cracks", "pairs.positions"), (n_pairs,))
        for place, seen in enumerate(self.seen):
            n_sources, n_modes = seen.modal.shape
            of_seen = {"squares": (n_modes,), "compliance": (n_sources, n_sources)}
            of_seen |= {"inertia": (n_pairs,), "force": (0,)}
            for dof in seen.rows:
                of_seen |= {f"rows.{dof}.0": (n_modes,), f"rows.{dof}.1": (n_sources,)}
            shapes |= {f"seen.{place}.{name}": shape for name, shape in of_seen.items()}
        check_shapes(arrays, shapes)
        fits = {name: bool(np.all(np.isfinite(array))) for name, array in arrays.items()}
        fits["nodes.dofs"] &= np.array_equal(np.sort(free), np.arange(n_dofs))
        indices = {"nodes.cells": nodes.cells, "pairs.cracks": pairs.cracks}
        indices |= {"pairs": [*pairs.places.values()], "seen": [d for s in self.seen for d in s.rows]}
        ends = n_nodes, n_pairs, n_pairs, n_dofs
        for (name, numbers), end in zip(indices.items(), ends, strict=True):
            fits[name] = fits.get(name, True) and all(0 <= n < end and n == int(n) for n in np.ravel(numbers))
        fits["seen"] &= all(np.all(seen.squares >= 0.0) for seen in self.seen)
        if bad := [name for name, fit in fits.items() if not fit]:
            raise ValueError(f"its {bad[0]} does not fit")
        return n_dofs, n_pairs


def _n_sources(structure: Structure) -> int:
    return int(sources_of(structure).shape[1])


def _put(structure: Structure, seen: Receptance) -> None:
    """Let a structure hold a receptance; ValueError unless it is of its sources."""
    if len(seen.modal) != _n_sources(structure):
        raise ValueError("its seen does not fit")
    held = replace(seen, force=structure.force)
    structure.once(held_receptance).append(held)
    structure.once(last_receptance, of_matrices=True)[:] = [held]


def _seen(whole: Structure) -> list[Receptance]:
    """Return the receptances that a structure holds, with the tangents of a solid at last."""
    whole = whole.original
    both = whole, whole.with_tangents()
    return [seen for one in both[: 1 + (both[1] is not whole)] for seen in one.once(held_receptance)]


@dataclass(frozen=True)
class _File:
    """Datasets of a file: a structure and its coarser twin."""

    whole: _Kept
    coarse: _Kept | None


def _twin(made: Made) -> list[Made]:
    return made.structure.once(kept, of_matrices=True)


class Shelf:
    """Where a command looks for its structure, and keeps it.

    Parameters
    ----------
    path : Path
        The file.
    say : callable
        Prints a line.
    fresh : bool
        Do not read it.
    """

    def __init__(self, path: Path, say: Callable[[str], None], *, fresh: bool) -> None:
        self._path, self._say = path, say
        self._files: list[_File | None] = [None] if fresh else []
        self._made: list[tuple[Made, Scene]] = []
        self._size = 0

    def take(self, scene: Scene, comm: MPI.Comm) -> Made | None:
        """Return the structure of a scene if the file has it (collective)."""
        parts = parts_shared(scene, comm)
        try:
            if not self._files:
                self._files.append(self._read(comm))
            file = self._files[0]
            if file is None or file.whole.key != key_of(parts):
                return None
            whole = file.whole.structure(scene, comm)
            if whole is None:
                return None
            made, coarse = Made(whole, comm, parts), coarser_scene(scene)
            if file.coarse is not None and isinstance(coarse, Scene):
                alone = MPI.COMM_SELF  # as of the coarser twin of a reduced structure
                others = parts_shared(coarse, alone)
                twin = file.coarse.structure(coarse, alone) if file.coarse.key == key_of(others) else None
                _twin(made)[:] = [] if twin is None else [Made(twin, alone, others)]
        except (InputError, *WRONG) as error:
            self._say(f"{self._path}: not used, {error}")
            self._files[:] = [None]
            return None
        self._made[:] = [(made, scene)]
        self._size = _size(made)
        self._say(f"{self._path}: the structure is taken from here; --fresh computes it anew")
        return made

    def _read(self, comm: MPI.Comm) -> _File | None:
        """Return what the file has; None if there is none."""
        if not on_root(comm, self._path.exists):
            return None
        stored = read(self._path, comm)
        stored.fitting_argument(KIND)
        with stored.taken() as parts:
            return unpacked(_File, parts)

    def note(self, made: Made, scene: Scene) -> None:
        """Note a structure that was made: the first is kept, and what takes its place."""
        if not self._made or self._made[0][0].parts[0] == made.parts[0]:
            self._made[:] = [(made, scene)]

    def keep(self, rank: int) -> None:
        """Write the file if more is known than it has (collective)."""
        for made, scene in self._made:
            whole = made.structure
            if _size(made) <= self._size or (whole.comm.size == 1 and rank) or whole.nodes is None:
                continue
            self._size = _size(made)
            coarse, twins = coarser_scene(scene), _twin(made)
            twin = _Kept.of(twins[0], coarse) if twins and isinstance(coarse, Scene) else None
            parts = packed(_File(_Kept.of(made, scene), twin))
            size = sum(np.asarray(part).nbytes for part in parts.values())
            if size > MAX_BYTES:
                self._say(f"{self._path}: not written, as it would have {size / 1e6:.0f} MB")
                continue
            try:
                write(parts, self._path, KIND, scene, whole.comm, compressed=False)
            except InputError as error:
                self._say(f"{self._path}: not written, {error}")


def _size(made: Made) -> int:
    """Return how much is known of a structure: numbers of receptances, and 1 for its matrices."""
    every = [made, *_twin(made)]
    seen = [one for each in every for one in _seen(each.structure)]
    return len(every) + sum(one.n_modes * (len(one.modal) + len(one.rows)) for one in seen)


def keep_structures(rank: int) -> None:
    """Write the structure of the command (collective)."""
    for shelf in SHELVES:
        shelf.keep(rank)


def has_place(scene: Scene) -> bool:
    """Return True if the structure of a scene has all that its results need without DOLFINx."""
    asked = [QUANTITIES[name].of.on_request for name in scene.quantities or ()]
    return not any(asked) and scene.geometry is not None and scene.geometry.file is None
