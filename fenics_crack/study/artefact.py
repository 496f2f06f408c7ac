"""A prepared structure as a file.

It holds what a mesh gives: modes and statics seen at pairs, loads and watched points, of the
scene's mesh and of a coarser one, with places and areas of the pairs. What follows from it, another
frequency, amplitude of the load, damping, clearance, law or tolerance, needs no mesh and no
matrices.

A file of ``reduce`` is its user's. :func:`load_prepared` makes a study of it, whose structure no
scene shares: what needs matrices takes the scene itself. The file that a command keeps
(:mod:`fenics_crack.study.shelf`) has the matrices, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.observables import QUANTITIES
from fenics_crack.basics.ranks import gather_rows, on_root
from fenics_crack.fem.setting import clearance_of, damping_rule_of, force_vector_by_part
from fenics_crack.files.codec import packed, unpacked
from fenics_crack.files.store import Stored, check_shapes, read, write
from fenics_crack.model.body import DEFAULT_SETTING, Body
from fenics_crack.model.factor import square_matrix
from fenics_crack.model.matrices import AbsentMatrix
from fenics_crack.model.nodes import Clamp, Nodes, Pairs
from fenics_crack.model.receptance import (
    Receptance,
    displacement_rows,
    make_empty_receptance_list,
    make_empty_shared_receptance_list,
    receptance,
    sources_of,
)
from fenics_crack.model.structure import DampingRule, Structure
from fenics_crack.numerics.equations import ROUNDING
from fenics_crack.scene.fields import LARGEST
from fenics_crack.scene.scene import Scene
from fenics_crack.study.meshes import coarser, coarser_scene
from fenics_crack.study.prepare import Study, prepare, reduced
from fenics_crack.study.sharing import Made, kept, loads_of, parts_shared
from fenics_crack.study.solve import MOST_OF_MANY, modes_chosen, reduced_to

KIND = "prepared structure"
VARIED = (
    "a key that needs no mesh: the frequency, force_mean, force_cos and force_sin of the load, "
    "damping, clearances, the contact law and its friction, harmonics, the tolerance, [curve]; "
    "else the scene itself is solved"
)
"""What a file can vary, in words."""
NODE_ARRAYS = ("points", "dofs", "cells")


@dataclass(frozen=True)
class Rows:
    """A sparse matrix by its rows, those of all ranks."""

    data: np.ndarray
    indices: np.ndarray
    indptr: np.ndarray

    @classmethod
    def of(cls, rows: Any, comm: MPI.Comm) -> Any:
        """Gather the rows of all ranks; None of None (collective)."""
        if rows is None:
            return None
        lengths = gather_rows(comm, np.diff(rows.indptr))
        starts = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
        return cls(gather_rows(comm, rows.data), gather_rows(comm, rows.indices), starts)

    def matrix(self, *shape: int) -> sparse.csr_matrix:
        """Return the matrix; ValueError unless it is one of this shape.

        SciPy looks at the starts of rows only if the last of them is above zero.
        """
        rows = sparse.csr_matrix((self.data, self.indices, self.indptr), shape)
        if np.diff(rows.indptr).min(initial=0) < 0:
            raise ValueError("its rows do not follow one another")
        rows.check_format(full_check=True)
        return rows


@dataclass(frozen=True)
class PreparedStructure:
    """Datasets of a whole structure and of the receptances that it holds.

    Attributes
    ----------
    gap, tangential, tangents, shares : Rows or None
        As of :class:`Structure` and its pairs, which have none of their own here.
    force, clearance, watched, nodes, pairs, clamp
        As of :class:`Structure`; arrays of all ranks.
    receptances : tuple of Receptance
        Of this load; with the tangents of a solid at last.
    mass, stiffness : Rows or None
        Its matrices, where they are kept.
    key : str
        Digest of what the structure follows from.
    excitation : (2K+1, d) [N]
        Force of the excitation.
    """

    gap: Rows
    tangential: Rows | None
    tangents: Rows | None
    shares: Rows | None
    force: np.ndarray
    clearance: np.ndarray
    watched: np.ndarray | None
    nodes: Nodes | None
    pairs: Pairs
    clamp: Clamp | None
    receptances: tuple[Receptance, ...]
    mass: Rows | None = None
    stiffness: Rows | None = None
    key: str = ""
    excitation: np.ndarray | None = None

    @classmethod
    def of(cls, structure: Structure, vtk_type: int = 0, **datasets: Any) -> PreparedStructure:
        """Gather the datasets of a structure, with further ones in ``datasets`` (collective)."""
        structure, comm = structure.original, structure.comm
        nodes, pairs, clamp, watched = (
            structure.nodes,
            structure.pairs,
            structure.clamp,
            structure.watched,
        )
        sources = [
            structure,
            *([] if pairs.tangential_gap_matrix is None else [structure.with_tangents()]),
        ]
        places = NODE_ARRAYS if nodes else ()
        arrays = {name: gather_rows(comm, getattr(nodes, name)) for name in places}
        return cls(
            gap=Rows.of(structure.gap, comm), tangential=Rows.of(structure.tangential, comm),
            tangents=Rows.of(pairs.tangential_gap_matrix, comm),
            shares=Rows.of(pairs.pressure_matrix, MPI.COMM_SELF),
            force=gather_rows(comm, structure.force.T).T, clearance=structure.clearance,
            watched=None if watched is None else gather_rows(comm, watched),
            nodes=nodes and replace(nodes, mesh_dofs=None, vtk_type=vtk_type, **arrays),
            pairs=replace(pairs, pressure_matrix=None, tangential_gap_matrix=None),
            clamp=clamp and replace(clamp, inertia=gather_rows(comm, clamp.inertia.T).T),
            receptances=tuple(replace(known_receptance, force=np.zeros(0)) for source in sources
                       for known_receptance in source.compute_once(make_empty_receptance_list)),
            **datasets,
        )  # fmt: skip

    def structure(self, scene: Scene, weights: np.ndarray, comm: MPI.Comm) -> Structure:
        """Return the structure in the setting of a scene, its load's rows weighted.

        Rank 0 has all rows. An error of :data:`fenics_crack.files.codec.WRONG` where the datasets
        are no structure (collective).
        """
        n_dofs, n_pairs = self._check(), len(self.clearance)
        own = slice(None if comm.rank == 0 else 0)

        def rows(part: Rows | None, columns: int) -> Any:
            matrix: Any = part and part.matrix(n_dofs, columns)
            return matrix if comm.rank == 0 or matrix is None else matrix[:0]

        mass, stiffness = (
            AbsentMatrix(n_dofs, comm.rank)
            if part is None
            else square_matrix(rows(part, n_dofs), comm)
            for part in (self.mass, self.stiffness)
        )
        nodes, watched, clamp, pairs = self.nodes, self.watched, self.clamp, self.pairs
        pairs = replace(
            pairs, tangential_gap_matrix=rows(self.tangents, 2 * n_pairs),
            pressure_matrix=self.shares
            and self.shares.matrix(len(np.atleast_1d(pairs.nodes)), n_pairs),
        )  # fmt: skip
        arrays = {name: getattr(nodes, name)[own] for name in (NODE_ARRAYS if nodes else ())}
        made = Structure(Body(
            mass, stiffness, gap=rows(self.gap, n_pairs), force=self.force[:, own],
            clearance=self.clearance if pairs.cracks is None else clearance_of(scene, pairs),
            damping=damping_rule_of(scene.given("damping")),
            tangential=rows(self.tangential, n_pairs),
            nodes=nodes and replace(nodes, **arrays), pairs=pairs,
            watched=None if watched is None else watched[own],
            clamp=clamp and replace(clamp, inertia=clamp.inertia[:, own]), comm=comm,
        ))  # fmt: skip
        for known_receptance in self.receptances:
            sources = made, made.with_tangents()
            n_sources = len(known_receptance.modal)
            source = next(
                candidate for candidate in sources if sources_of(candidate).shape[1] == n_sources
            )
            loaded_receptance = replace(known_receptance, force=source.force)
            source.compute_once(make_empty_receptance_list)[:] = [loaded_receptance]
            made.compute_once(make_empty_shared_receptance_list, from_matrices=True)[:] = [
                loaded_receptance
            ]
        if not np.array_equal(weights, np.eye(len(made.force))):
            force, of_load = weights @ made.force, made.clamp and made.clamp.with_weights(weights)
            made = made._in_setting(DEFAULT_SETTING, force=force, clamp=of_load)
        if self.mass is None:
            receptance(made, 1)
        return made

    def _check(self) -> int:
        """Return the number of dofs; ValueError unless all sizes, indices and numbers fit."""
        nodes, places = self.nodes, np.array([*self.pairs.places.values()])
        arrays = {name: array for name, array in packed(self).items() if np.ndim(array)}
        arrays |= {"pairs.places": places} | (
            {"free dofs": np.unique(nodes.dofs[nodes.dofs >= 0])} if nodes else {}
        )
        n_dofs, n_pairs, n_parts = len(self.gap.indptr) - 1, len(self.clearance), len(self.force)
        n_nodes, dimension = nodes.points.shape if nodes else (0, 2)
        n_rigid = len(self.clamp.inertia) if self.clamp else 0
        shapes = {
            "force": (n_parts, n_dofs), "watched": (n_dofs,), "excitation": (n_parts, dimension),
            "nodes.dofs": (n_nodes, dimension), "nodes.cells": (-1, -1), "clearance": (n_pairs,),
            "pairs.points": (n_pairs, dimension), "pairs.nodes": (-1, dimension),
            "clamp.center": (dimension,), "clamp.inertia": (n_rigid, n_dofs),
            "clamp.load": (n_parts, n_rigid), "free dofs": (n_dofs,), "pairs.areas": (n_pairs,),
            "pairs.cracks": (n_pairs,), "pairs.positions": (n_pairs,),
        }  # fmt: skip
        ranges: dict[str, tuple[float, float]] = {
            "nodes.dofs": (-1, n_dofs), "nodes.cells": (0, n_nodes), "pairs.cracks": (0, n_pairs),
            "pairs.places": (0, n_pairs),
        }  # fmt: skip
        for place, known_receptance in enumerate(self.receptances):
            name, (n_sources, n_modes) = f"receptances.{place}", known_receptance.modal.shape
            sizes = {"squares": (n_modes,), "compliance": (n_sources,) * 2, "inertia": (n_pairs,)}
            for dof in known_receptance.rows:
                sizes |= {f"rows.{dof}.0": (n_modes,), f"rows.{dof}.1": (n_sources,)}
            shapes |= {f"{name}.{key}": size for key, size in sizes.items()}
            ranges |= {f"{name}.squares": (0, LARGEST), f"{name}.rows": (0, n_dofs)}
            arrays[f"{name}.rows"] = np.array([*known_receptance.rows])
        check_shapes(arrays, shapes)
        for name, array in arrays.items():
            start, end = ranges.get(name, (-LARGEST, LARGEST))
            if array.size and not start <= array.min() <= array.max() < end:
                raise ValueError(f"its {name} does not fit")
        return n_dofs


@dataclass(frozen=True)
class PreparedFile:
    """Datasets of a file: a structure, and that of its coarser mesh if there is one."""

    structure: PreparedStructure
    coarser_structure: PreparedStructure | None = None

    def make_structures(self, scene: Scene, weights: np.ndarray, comm: MPI.Comm) -> Made:
        """Return the structure for a scene, with that of its coarser mesh (collective)."""
        structure = self.structure.structure(scene, weights, comm)
        coarse = coarser_scene(scene)
        if self.coarser_structure is not None and isinstance(coarse, Scene):
            # As of a reduced structure.
            structure.compute_once(kept, from_matrices=True).append(Made(
                self.coarser_structure.structure(coarse, weights, MPI.COMM_SELF), MPI.COMM_SELF,
                parts_shared(coarse, MPI.COMM_SELF),
            ))  # fmt: skip
        return Made(structure, comm, parts_shared(scene, comm))


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
    if structure.pairs.pressure_matrix is not None:
        raise InputError("geometry.kind", "solid", "'plate', or matrices, for a file")
    if not structure.light_lips or not isinstance(structure.whole.damping, DampingRule):
        allowed = "reduced to crack faces without mass, and damped by [damping], for a file"
        raise InputError("structure", repr(structure), allowed)
    twin = coarser(prepared)
    studies = prepared, *([] if isinstance(twin, str) else [twin[0]])
    parts = packed(PreparedFile(*map(_of_study, studies)))
    write(parts, path, KIND, scene, structure.whole.comm)


def _of_study(study: Study) -> PreparedStructure:
    """Return the datasets of a reduced study, with all its modes (collective)."""
    reference = getattr(study.structure, "reference", None) or study.structure
    count = max(study.structure.n_modes, reference.n_modes)
    displacement_rows(
        study.structure.whole, count, np.array([watched.dof for watched in study.watched])
    )
    return PreparedStructure.of(study.structure.whole)


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
        moved = without_amplitudes(after[1]) != without_amplitudes(before[1])
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


def without_amplitudes(loads: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the loads of a scene without the amplitudes of its excitation."""
    excitation, *other_loads = loads
    of_parts = ("force_mean", "force_cos", "force_sin", "harmonics")
    entries = excitation and {key: load for key, load in excitation.items() if key not in of_parts}
    return entries, *other_loads


def _weights(known: Scene, scene: Scene) -> np.ndarray:
    """The matrix that maps rows of the load of one scene to those of another whose forces act in
    the same place and in the same directions."""
    if loads_of(known) == loads_of(scene):  # a file with its wave may have gone
        return np.eye(1 + 2 * known.highest_order)
    return load_weights(np.array(force_vector_by_part(known), dtype=float), scene)


def load_weights(old_rows: np.ndarray, scene: Scene) -> np.ndarray:
    """The same for an excitation (2K+1, d) before.

    Raises
    ------
    InputError
        The scene's is no sum of its rows.
    """
    new_rows = np.array(force_vector_by_part(scene), dtype=float)
    is_same = np.array_equal(old_rows, new_rows)
    weights = np.eye(len(new_rows)) if is_same else new_rows @ np.linalg.pinv(old_rows)
    is_no_sum = np.abs(weights @ old_rows - new_rows).max() > ROUNDING * np.abs(new_rows).max()
    if is_no_sum or (scene.has_other_loads and not is_same):
        requirement = f"in the directions of the file's, without other loads; or {VARIED}"
        raise InputError("excitation.force_sin", scene.excitation.force_sin, requirement)
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
        file: PreparedFile = unpacked(PreparedFile, parts)
        return file.make_structures(scene, weights, comm)
