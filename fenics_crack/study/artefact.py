"""A prepared structure as a file that its user owns.

It holds what a mesh gives: modes and statics seen at pairs, loads and watched points, of the
scene's mesh and of a coarser one, with places and areas of the pairs. What follows from it, another
frequency, amplitude of the load, damping, clearance, law or tolerance, needs no mesh and no
matrices. :func:`load_prepared` makes a study of it, whose structure no scene shares: what needs
matrices takes the scene itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.observables import QUANTITIES
from fenics_crack.basics.ranks import gather_rows, on_root
from fenics_crack.fem.setting import clearance_of, damping_of, force_parts
from fenics_crack.files.codec import Parts, packed, unpacked
from fenics_crack.files.store import Stored, check_shapes, read, write
from fenics_crack.model.body import Body
from fenics_crack.model.matrices import AbsentMatrix
from fenics_crack.model.nodes import Nodes, Pairs
from fenics_crack.model.receptance import Receptance, held_receptance, receptance, rows_at
from fenics_crack.model.structure import DampingRule, Structure
from fenics_crack.numerics.equations import ROUNDING
from fenics_crack.scene.scene import Scene
from fenics_crack.study.meshes import coarser, coarser_scene
from fenics_crack.study.prepare import Study, prepare, reduced
from fenics_crack.study.sharing import Made, kept, loads_of, parts_shared
from fenics_crack.study.solve import MOST_OF_MANY, modes_chosen, reduced_to

KIND = "prepared structure"
COARSER = "coarser."
"""Beginning of the names of datasets of the coarser mesh."""
VARIED = (
    "a key that needs no mesh: the frequency, force_mean, force_cos and force_sin of the load, "
    "damping, clearances, the contact law and its friction, harmonics, the tolerance, [curve]; "
    "else the scene itself is solved"
)
"""What a file can vary, in words."""
MIN_LOAD_BYTES, LOAD_RATIO = 2**26, 16
"""Size of the load on all dofs that any file may have [byte], and that relative to all arrays."""


@dataclass(frozen=True)
class _Prepared:
    """Datasets of one structure; columns (row, column, value) of sparse matrices."""

    n_dofs: int
    gap: np.ndarray
    force: np.ndarray
    clearance: np.ndarray
    pairs: Pairs
    squares: np.ndarray
    modal: np.ndarray
    compliance: np.ndarray
    inertia: np.ndarray
    dofs: np.ndarray
    shapes: np.ndarray
    static: np.ndarray
    watched_dof: int
    tangential: np.ndarray | None = None
    points: np.ndarray | None = None
    node_dofs: np.ndarray | None = None
    cells: np.ndarray | None = None

    @classmethod
    def of(cls, study: Study) -> _Prepared:
        """Those of a reduced study (collective)."""
        whole = study.structure.whole.original
        reference = getattr(study.structure, "reference", None) or study.structure
        count = max(study.structure.n_modes, reference.n_modes)
        rows_at(whole, count, np.array([watched.dof for watched in study.watched]))
        known, comm, nodes = receptance(whole, count), whole.comm, whole.nodes
        shapes, static = (np.array(rows) for rows in zip(*known.rows.values(), strict=True))
        places = () if nodes is None else (nodes.points, nodes.dofs, nodes.cells)
        tangents = whole.tangential
        return cls(
            whole.n_dofs, _entries(whole, whole.gap), _entries(whole, whole.force.T),
            whole.clearance, whole.pairs, known.squares, known.modal, known.compliance,
            known.inertia, np.array([*known.rows]), shapes, static, whole.watched_dof,
            None if tangents is None else _entries(whole, tangents),
            *(gather_rows(comm, rows) for rows in places),
        )  # fmt: skip

    def _check(self, n_parts: int) -> None:
        """Raise ValueError unless all sizes, indices and numbers fit a load of ``n_parts`` rows."""
        n_dofs, n_pairs, n_watched = self.n_dofs, self.clearance.size, self.dofs.size
        n_sources, n_modes = self.modal.shape
        n_nodes, dimension = (0, 2) if self.points is None else self.points.shape
        fields = vars(self) | {f"pairs.{name}": value for name, value in vars(self.pairs).items()}
        arrays = {name: value for name, value in fields.items() if isinstance(value, np.ndarray)}
        shapes = {
            "squares": (n_modes,), "compliance": (n_sources, n_sources), "dofs": (n_watched,),
            "shapes": (n_watched, n_modes), "static": (n_watched, n_sources), "cells": (-1, -1),
            "clearance": (n_pairs,), "inertia": (n_pairs,), "node_dofs": (n_nodes, dimension),
            "pairs.points": (n_pairs, dimension),
        }  # fmt: skip
        shapes |= dict.fromkeys(("gap", "force", "tangential"), (3, -1))
        shapes |= dict.fromkeys(("pairs.areas", "pairs.cracks", "pairs.positions"), (n_pairs,))
        check_shapes(arrays, shapes)
        ranges = {
            "dofs": (0, n_dofs), "watched_dof": (0, n_dofs), "node_dofs": (-1, n_dofs),
            "cells": (0, n_nodes), "pairs.cracks": (0, n_pairs), "pairs.places": (0, n_pairs),
        }  # fmt: skip
        indices = fields | {"pairs.places": [*self.pairs.places.values()]}
        ends = {"gap": n_pairs, "tangential": n_pairs, "force": n_parts}
        for name in ends.keys() & arrays.keys():
            indices |= {f"{name} rows": arrays[name][0], f"{name} columns": arrays[name][1]}
            ranges |= {f"{name} rows": (0, n_dofs), f"{name} columns": (0, ends[name])}
        bad_names = [name for name, value in arrays.items() if not np.all(np.isfinite(value))]
        bad_names += [
            name
            for name, (start, end) in ranges.items()
            if (values := indices[name]) is not None
            and not np.all((np.round(values) == values) & np.less_equal(start, values)
                           & np.less(values, end))
        ]  # fmt: skip
        n_free = n_dofs if self.node_dofs is None else np.count_nonzero(self.node_dofs >= 0)
        n_bytes = sum(value.nbytes for value in arrays.values())
        if n_free != n_dofs or 8 * n_parts * n_dofs > max(MIN_LOAD_BYTES, LOAD_RATIO * n_bytes):
            bad_names.append("n_dofs")
        n_contacts = n_pairs * (1 if self.tangential is None else 2)
        if n_contacts + len(np.unique(self.force[1])) != n_sources:
            bad_names.append("modal")
        if np.any(self.squares < 0.0):
            bad_names.append("squares")
        if bad_names:
            raise ValueError(f"its {bad_names[0]} does not fit")

    def structure(self, scene: Scene, weights: np.ndarray, comm: MPI.Comm) -> Structure:
        """The structure in the setting of a scene, its load's rows weighted (collective)."""
        self._check(weights.shape[1])
        first, count = comm.rank == 0, len(self.clearance)
        n_local = self.n_dofs if first else 0

        def rows(entries: np.ndarray, columns: int) -> sparse.csr_matrix:
            places = entries[:2].astype(int)
            shape = self.n_dofs, columns
            made = sparse.csr_matrix((entries[2], (places[0], places[1])), shape)
            return made[:n_local]

        force = (rows(self.force, weights.shape[1]) @ weights.T).T
        nodes = None
        if self.points is not None and self.node_dofs is not None and self.cells is not None:
            own = slice(None) if first else slice(0)
            nodes = Nodes(self.points[own], self.node_dofs[own], self.cells[own], 0)
        clearance = self.clearance if self.pairs.cracks is None else clearance_of(scene, self.pairs)
        sizes = AbsentMatrix(self.n_dofs, comm.rank)
        made = Structure(Body(
            sizes, sizes, rows(self.gap, count), force, clearance,
            damping_of(scene.given("damping")),
            None if self.tangential is None else rows(self.tangential, count),
            nodes, self.pairs, comm=comm,
        )).watching(self.watched_dof)  # fmt: skip
        loaded = np.unique(self.force[1].astype(int))  # parts that are not zero
        of_loads = weights[np.any(weights[:, loaded] != 0.0, axis=1)][:, loaded].T
        of_pairs = np.eye(len(self.modal) - len(loaded))
        change = scipy.linalg.block_diag(of_pairs, of_loads)
        held = dict(zip(map(int, self.dofs), zip(self.shapes, self.static @ change, strict=True),
                        strict=True))  # fmt: skip
        made.cached_result(held_receptance).append(Receptance(
            self.squares, change.T @ self.modal, change.T @ self.compliance @ change, held, force,
            self.inertia,
        ))  # fmt: skip
        return made


def _entries(whole: Structure, rows: Any) -> np.ndarray:
    """Entries of the rows of all ranks: (3, n), of row, column and value (collective)."""
    found = sparse.coo_matrix(rows)
    found.eliminate_zeros()
    own = np.column_stack([found.row + whole.first_dof, found.col, found.data])
    return gather_rows(whole.comm, own).T


def save_prepared(prepared: Study, path: str | Path) -> None:
    """Write what the mesh of a prepared scene gives, for :func:`load_prepared` and the commands
    ``solve`` and ``curve`` (collective).

    Parameters
    ----------
    prepared : Study
        What :func:`fenics_crack.prepare` returns. Not reduced (``whole=True``), the file has as
        many modes as a tolerance may choose.
    path : path
        The file; an older one is replaced once the new one is complete.

    Raises
    ------
    InputError
        The scene rotates or is a bladed disk, its structure is not reduced to crack faces without
        mass, or its damping is a matrix; or the file cannot be written.

    Examples
    --------
    >>> kept = scene.replace({"reduction.method": "massless", "reduction.modes": 10})
    >>> fc.save_prepared(fc.prepare(kept), "plate.h5")
    """
    chosen = modes_chosen(prepared, MOST_OF_MANY)
    if chosen:
        prepared = replace(reduced_to(prepared, chosen[-1]), scene=prepared.scene)
    prepared = reduced(prepared)
    scene, structure = prepared.scene, prepared.structure
    if scene.speed > 0.0 or scene.disk is not None:
        key = "disk" if scene.disk is not None else "rotation"
        raise InputError(key, "given", "left out, for a file: it holds structures at rest")
    if structure.pairs.shares is not None:
        raise InputError("geometry.kind", "solid", "'plate', or matrices, for a file")
    if not structure.light_lips or not isinstance(structure.whole.damping, DampingRule):
        allowed = "reduced to crack faces without mass, and damped by [damping], for a file"
        raise InputError("structure", repr(structure), allowed)
    parts, twin = packed(_Prepared.of(prepared)), coarser(prepared)
    if not isinstance(twin, str):
        coarse = packed(_Prepared.of(twin[0]))
        parts |= {f"{COARSER}{name}": value for name, value in coarse.items()}
        parts[f"{COARSER}pairs"] = coarse["pairs"].replace('"pairs.', f'"{COARSER}pairs.')
    write(parts, path, KIND, scene, structure.whole.comm)


def load_prepared(
    path: str | Path, changes: Mapping[str, object] | None = None, comm: MPI.Comm = MPI.COMM_WORLD
) -> Study:
    """Read a file of :func:`save_prepared`: its scene, changed, prepared without a mesh, for
    :func:`fenics_crack.solve` and :func:`fenics_crack.curve` (collective).

    Parameters
    ----------
    path : path
        The file.
    changes : mapping, optional
        As of :meth:`Scene.replace`, of keys that need no mesh.
    comm : MPI.Comm
        Ranks that share the structure.

    Returns
    -------
    Study
        Of the scene with these changes, not reduced.

    Raises
    ------
    InputError
        The file cannot be read, is damaged or of something else; a key needs a mesh; or a file of
        its mesh or matrices has changed.

    Examples
    --------
    >>> kept = scene.replace({"reduction.method": "massless", "reduction.modes": 10})
    >>> fc.save_prepared(fc.prepare(kept), "plate.h5")
    >>> fc.solve(fc.load_prepared("plate.h5", {"excitation.frequency": 800.0}))
    """
    stored = read(path, comm)
    scene = on_root(comm, lambda: _scene_of(stored, changes or {}))
    return prepare(scene, comm, whole=True, last=[_made(stored, scene, comm)])


def _scene_of(stored: Stored, changes: Mapping[str, object]) -> Scene:
    """The scene of a file that has been read, changed.

    Raises
    ------
    InputError
        It is of another kind, or a changed key needs a mesh.
    """
    stored.fitting_argument(KIND)
    known = stored.scene()
    if known is None:
        raise stored.refused("one with its scene")
    stored.check_files(known, needed=False)
    scene, before = known.replace(changes), parts_shared(known, MPI.COMM_SELF)

    def needs_mesh(changed: Scene) -> bool:
        after = parts_shared(changed, MPI.COMM_SELF)
        moved = _without_amplitudes(after[1]) != _without_amplitudes(before[1])
        return after[0] != before[0] or moved or (bool(scene.structure) and after != before)

    if needs_mesh(scene):
        for key, value in changes.items():
            with suppress(InputError):  # of keys that need another one beside them
                if needs_mesh(known.replace({key: value})):
                    break
        raise InputError(key, value, f"{VARIED}, for {stored.path}")
    beyond = [name for name in scene.quantities or () if QUANTITIES[name].of.on_request]
    if beyond:
        allowed = "those of points and crack faces, for a file; else the scene itself is solved"
        raise InputError("output.quantities", beyond, allowed)
    _weights(known, scene)
    return scene


def _without_amplitudes(loads: tuple[Any, ...]) -> tuple[Any, ...]:
    """Loads of a scene but for the amplitudes of the excitation."""
    excitation, *others = loads
    of_parts = ("force_mean", "force_cos", "force_sin", "harmonics")
    given = excitation and {key: one for key, one in excitation.items() if key not in of_parts}
    return given, *others


def _weights(known: Scene, scene: Scene) -> np.ndarray:
    """The matrix that maps rows of the load of one scene to those of another whose forces act in
    the same place and in the same directions."""
    if loads_of(known) == loads_of(scene):  # a file with its wave may have gone
        return np.eye(1 + 2 * known.highest_order)
    before, after = (np.array(force_parts(one), dtype=float) for one in (known, scene))
    weights = after @ np.linalg.pinv(before)
    missed = np.abs(weights @ before - after).max() > ROUNDING * np.abs(after).max()
    if missed or known.has_other_loads:
        allowed = f"in the directions of the file's, without other loads; or {VARIED}"
        raise InputError("excitation.force_sin", scene.excitation.force_sin, allowed)
    return weights


def _made(stored: Stored, scene: Scene, comm: MPI.Comm) -> Made:
    """The structure of a file for a scene, with that of its coarser mesh (collective).

    Raises
    ------
    InputError
        The file is not one of :func:`save_prepared`.
    """
    known = stored.scene()
    assert known is not None
    weights = _weights(known, scene)
    with stored.taken() as parts:
        whole = _structure(parts, scene, weights, comm)
        coarse = coarser_scene(scene)
        if f"{COARSER}squares" in parts and isinstance(coarse, Scene):
            cut = len(COARSER)
            its = {name[cut:]: one for name, one in parts.items() if name.startswith(COARSER)}
            its["pairs"] = its["pairs"].replace(f'"{COARSER}', '"')
            alone = MPI.COMM_SELF  # as of the coarser twin of a reduced structure
            twin = _structure(its, coarse, weights, alone)
            made = Made(twin, alone, parts_shared(coarse, alone))
            whole.cached_result(kept, from_matrices=True).append(made)
    return Made(whole, comm, parts_shared(scene, comm))


def _structure(parts: Parts, scene: Scene, weights: np.ndarray, comm: MPI.Comm) -> Structure:
    return unpacked(_Prepared, parts).structure(scene, weights, comm)
