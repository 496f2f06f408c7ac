"""A prepared structure as a file.

The file holds the modes and static responses at pairs, loads and watched points, for the scene's
mesh and a coarser one, and the pairs' positions and areas. Another frequency, load amplitude,
damping, clearance, law or tolerance then needs no mesh and no matrices.

There are two files of this kind. The command ``reduce`` writes a prepared file, without matrices,
on request. :func:`load_prepared` makes a study from the prepared file; quantities that need
matrices are refused. A structure file, which commands keep for each other
(:mod:`fenics_crack.study.shelf`), has the matrices, too.
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
from fenics_crack.basics.observables import OBSERVABLES_BY_NAME
from fenics_crack.basics.ranks import gather_rows, on_root
from fenics_crack.fem.setting import (
    clearance_of,
    damping_rule_of,
    list_mean_cos_and_sin_force_vectors,
)
from fenics_crack.files.codec import pack_dataclass, unpack_dataclass
from fenics_crack.files.store import StoredFile, check_shapes, read_result_file, write_result_file
from fenics_crack.model.body import SETTING_WITHOUT_CHANGES, Body
from fenics_crack.model.factor import make_square_petsc_matrix
from fenics_crack.model.matrices import AbsentMatrix
from fenics_crack.model.nodes import ClampReactionData, Nodes, Pairs
from fenics_crack.model.receptance import (
    Receptance,
    make_receptance_cache,
    make_shared_receptance_cache,
    modal_and_static_displacement_rows,
    pair_and_load_force_matrix,
    receptance,
)
from fenics_crack.model.structure import DampingRule, Structure
from fenics_crack.numerics.equations import ROUNDING
from fenics_crack.scene.fields import MAX_ALLOWED_MAGNITUDE
from fenics_crack.scene.scene import Scene
from fenics_crack.study.meshes import make_coarser_scene_or_reason, prepare_coarser_study_or_reason
from fenics_crack.study.prepare import Study, prepare, reduce_study
from fenics_crack.study.sharing import (
    SharedStructure,
    dependencies_of_load,
    dependencies_of_structure,
    make_empty_coarser_structure_list,
)
from fenics_crack.study.solve import (
    MAX_MODES_FOR_MANY_SOLUTIONS,
    candidate_mode_counts,
    reduce_to_modes,
)

PREPARED_FILE_KIND = "prepared structure"
CHANGEABLE_KEYS_TEXT = (
    "only load frequency, force_mean, force_cos, force_sin, damping, clearance, contact law, "
    "friction, harmonics, tolerance and [curve] can change in a prepared structure; "
    "for other changes solve the scene"
)
"""Keys that may change for a prepared file, in words for an error message."""
NODE_FIELDS_SPREAD_OVER_RANKS = ("points", "dofs", "cells")
"""Fields of :class:`Nodes` with a row for each node or cell, spread over the ranks."""


@dataclass(frozen=True)
class GatheredCsrMatrix:
    """Sparse matrix in CSR format, with the rows of all ranks.

    ``data``, ``indices`` and ``indptr`` are the arrays of SciPy's ``csr_matrix``.
    """

    data: np.ndarray
    indices: np.ndarray
    indptr: np.ndarray

    @classmethod
    def gather(cls, matrix: Any, comm: MPI.Comm) -> Any:
        """Gather a matrix's rows from all ranks, in rank order (collective).

        Parameters
        ----------
        matrix : scipy.sparse.csr_matrix or None
            Rows on this rank.
        comm : MPI.Comm
            Ranks that share the matrix.

        Returns
        -------
        GatheredCsrMatrix or None
            All rows, on every rank; None if ``matrix`` is None.
        """
        if matrix is None:
            return None
        row_lengths = gather_rows(comm, np.diff(matrix.indptr))
        row_starts = np.concatenate([[0], np.cumsum(row_lengths)]).astype(np.int32)
        return cls(gather_rows(comm, matrix.data), gather_rows(comm, matrix.indices), row_starts)

    def to_matrix(self, *shape: int) -> sparse.csr_matrix:
        """Return the SciPy matrix with the shape (n_rows, n_columns).

        ValueError if the arrays make no matrix with this shape.
        """
        matrix = sparse.csr_matrix((self.data, self.indices, self.indptr), shape)
        if np.diff(matrix.indptr).min(initial=0) < 0:
            raise ValueError("the row starts of a matrix decrease")
        matrix.check_format(full_check=True)
        return matrix


@dataclass(frozen=True)
class PreparedStructure:
    """Data of a whole (unreduced) structure and its receptances, for a file.

    A receptance (:class:`Receptance`) has modes, and static responses at contact pairs, load and
    watched points. The arrays have the rows of all ranks.

    Attributes
    ----------
    gap, tangential : GatheredCsrMatrix or None
        Matrices from displacements to normal gaps (n_dofs, n_pairs), and to tangential gaps, as in
        :class:`Structure`.
    tangents : GatheredCsrMatrix or None
        ``tangential_gap_matrix`` of a solid's pairs (:class:`Pairs`): tangential gaps in two
        directions. The field ``pairs`` leaves it out.
    shares : GatheredCsrMatrix or None
        ``pressure_functions_at_nodes`` of a solid's pairs (:class:`Pairs`): distribution of each
        contact force over nodes. The field ``pairs`` leaves it out.
    force, clearance, watched, nodes, pairs, clamp
        As in :class:`Structure`.
    receptances : tuple of Receptance
        Receptance under this load with normal gaps; then, for a solid, with tangential gaps, too. A
        receptance that was not computed is missing.
    mass, stiffness : GatheredCsrMatrix or None
        Matrices (n_dofs, n_dofs); None if the file does not keep them.
    key : str
        Digest (hash) of all values that determine the structure, by
        :func:`fenics_crack.study.shelf.digest_of_dependencies`. "" in a prepared file.
    excitation : (2K+1, d) [N] or None
        Force of the excitation: mean, then cosine and sine parts of the harmonics 1 to K, with d
        components. None in a prepared file.
    """

    gap: GatheredCsrMatrix
    tangential: GatheredCsrMatrix | None
    tangents: GatheredCsrMatrix | None
    shares: GatheredCsrMatrix | None
    force: np.ndarray
    clearance: np.ndarray
    watched: np.ndarray | None
    nodes: Nodes | None
    pairs: Pairs
    clamp: ClampReactionData | None
    receptances: tuple[Receptance, ...]
    mass: GatheredCsrMatrix | None = None
    stiffness: GatheredCsrMatrix | None = None
    key: str = ""
    excitation: np.ndarray | None = None

    @classmethod
    def gather(cls, structure: Structure, vtk_type: int = 0, **datasets: Any) -> PreparedStructure:
        """Gather a structure's data from all ranks (collective).

        Parameters
        ----------
        structure : Structure
            Whole structure. If it is a copy with varied properties, for example another damping,
            the original structure is gathered.
        vtk_type : int
            VTK's number of the cell type, for :class:`Nodes`.
        datasets
            Values of the fields ``mass``, ``stiffness``, ``key`` and ``excitation``.
        """
        structure, comm = structure.unvaried_structure, structure.comm
        nodes = structure.nodes
        pairs = structure.pairs
        clamp = structure.clamp
        watched_row = structure.watched
        structures_with_tangents = (
            [] if pairs.tangential_gap_matrix is None else [structure.with_tangents()]
        )
        structure_and_with_tangents = [structure, *structures_with_tangents]
        return cls(
            gap=GatheredCsrMatrix.gather(structure.gap, comm),
            tangential=GatheredCsrMatrix.gather(structure.tangential, comm),
            tangents=GatheredCsrMatrix.gather(pairs.tangential_gap_matrix, comm),
            shares=GatheredCsrMatrix.gather(pairs.pressure_functions_at_nodes, MPI.COMM_SELF),
            force=gather_rows(comm, structure.force.T).T, clearance=structure.clearance,
            watched=None if watched_row is None else gather_rows(comm, watched_row),
            nodes=nodes and replace(
                nodes, dolfinx_mesh_and_dofs=None, vtk_type=vtk_type,
                **{name: gather_rows(comm, getattr(nodes, name))
                   for name in NODE_FIELDS_SPREAD_OVER_RANKS},
            ),
            pairs=replace(pairs, pressure_functions_at_nodes=None, tangential_gap_matrix=None),
            clamp=clamp and replace(clamp, inertia=gather_rows(comm, clamp.inertia.T).T),
            receptances=tuple(
                replace(stored_receptance, force=np.zeros(0))
                for structure_or_with_tangents in structure_and_with_tangents
                for stored_receptance in structure_or_with_tangents.compute_once(
                    make_receptance_cache)
            ),
            **datasets,
        )  # fmt: skip

    def make_structure(
        self, scene: Scene, load_weight_matrix: np.ndarray, comm: MPI.Comm
    ) -> Structure:
        """Make the whole structure with a scene's load, damping and clearance (collective).

        Rank 0 has all rows, other ranks none. If the data make no structure, an error of
        :data:`fenics_crack.files.codec.DATASET_ERROR_CLASSES` is raised, for example ValueError.

        Parameters
        ----------
        scene : Scene
            Source of damping and clearance.
        load_weight_matrix : (n, 2K+1)
            Matrix W from the file's load to the scene's load (:func:`weight_matrix_of_load_rows`).
            Columns are rows of the file's load: mean, then cosine and sine parts of the harmonics 1
            to K. Rows are the n rows of the scene's load.
        comm : MPI.Comm
            Ranks that share the structure.
        """
        n_dofs, n_pairs = self._check_arrays_and_count_dofs(), len(self.clearance)
        local_slice = slice(None if comm.rank == 0 else 0)

        def local_matrix(gathered_matrix: GatheredCsrMatrix | None, n_columns: int) -> Any:
            """Return the matrix with all rows on rank 0; None for None."""
            matrix: Any = gathered_matrix and gathered_matrix.to_matrix(n_dofs, n_columns)
            return matrix if comm.rank == 0 or matrix is None else matrix[:0]

        mass_matrix, stiffness_matrix = (
            AbsentMatrix(n_dofs, comm.rank)
            if gathered_matrix is None
            else make_square_petsc_matrix(local_matrix(gathered_matrix, n_dofs), comm)
            for gathered_matrix in (self.mass, self.stiffness)
        )
        nodes, watched_row, clamp, pairs = self.nodes, self.watched, self.clamp, self.pairs
        pairs = replace(
            pairs, tangential_gap_matrix=local_matrix(self.tangents, 2 * n_pairs),
            pressure_functions_at_nodes=self.shares
            and self.shares.to_matrix(len(np.atleast_1d(pairs.nodes)), n_pairs),
        )  # fmt: skip
        structure = Structure(Body(
            mass_matrix, stiffness_matrix, gap=local_matrix(self.gap, n_pairs),
            force=self.force[:, local_slice],
            clearance=self.clearance if pairs.cracks is None else clearance_of(scene, pairs),
            damping=damping_rule_of(scene.given("damping")),
            tangential=local_matrix(self.tangential, n_pairs),
            nodes=nodes and replace(
                nodes,
                **{name: getattr(nodes, name)[local_slice]
                   for name in NODE_FIELDS_SPREAD_OVER_RANKS}
            ),
            pairs=pairs,
            watched=None if watched_row is None else watched_row[local_slice],
            clamp=clamp and replace(clamp, inertia=clamp.inertia[:, local_slice]), comm=comm,
        ))  # fmt: skip
        for stored_receptance in self.receptances:
            structure_and_with_tangents = structure, structure.with_tangents()
            n_pair_and_load_forces = len(stored_receptance.modal)
            structure_of_receptance = next(
                structure_or_with_tangents
                for structure_or_with_tangents in structure_and_with_tangents
                if pair_and_load_force_matrix(structure_or_with_tangents).shape[1]
                == n_pair_and_load_forces
            )
            receptance_with_load = replace(stored_receptance, force=structure_of_receptance.force)
            structure_of_receptance.compute_once(make_receptance_cache)[:] = [receptance_with_load]
            receptances_shared_by_all_loads = structure.compute_once(
                make_shared_receptance_cache, from_matrices=True
            )
            receptances_shared_by_all_loads[:] = [receptance_with_load]
        if not np.array_equal(load_weight_matrix, np.eye(len(structure.force))):
            clamp = structure.clamp and structure.clamp.with_weights(load_weight_matrix)
            weighted_force = load_weight_matrix @ structure.force
            structure = structure._in_setting(
                SETTING_WITHOUT_CHANGES, force=weighted_force, clamp=clamp
            )
        if self.mass is None:
            receptance(structure, 1)
        return structure

    def _check_arrays_and_count_dofs(self) -> int:
        """Check shapes and values of all arrays; return the number of dofs.

        Wrong shapes, and values that are not finite or out of range, raise ValueError.
        """
        nodes, watched_pair_indices = self.nodes, np.array([*self.pairs.places.values()])
        array_by_name = {
            name: array for name, array in pack_dataclass(self).items() if np.ndim(array)
        }
        array_by_name |= {"pairs.places": watched_pair_indices} | (
            {"free dofs": np.unique(nodes.dofs[nodes.dofs >= 0])} if nodes else {}
        )
        n_dofs, n_pairs = len(self.gap.indptr) - 1, len(self.clearance)
        n_nodes, dimension = nodes.points.shape if nodes else (0, 2)
        n_load_rows, n_rigid_motions = len(self.force), len(self.clamp.inertia) if self.clamp else 0
        shape_by_name = {
            "force": (n_load_rows, n_dofs), "watched": (n_dofs,), "clearance": (n_pairs,),
            "excitation": (n_load_rows, dimension), "nodes.dofs": (n_nodes, dimension),
            "nodes.cells": (-1, -1),
            "pairs.points": (n_pairs, dimension), "pairs.nodes": (-1, dimension),
            "clamp.center": (dimension,), "clamp.inertia": (n_rigid_motions, n_dofs),
            "clamp.load": (n_load_rows, n_rigid_motions), "free dofs": (n_dofs,),
            "pairs.areas": (n_pairs,), "pairs.cracks": (n_pairs,), "pairs.positions": (n_pairs,),
        }  # fmt: skip
        range_by_name: dict[str, tuple[float, float]] = {
            "nodes.dofs": (-1, n_dofs), "nodes.cells": (0, n_nodes), "pairs.cracks": (0, n_pairs),
            "pairs.places": (0, n_pairs),
        }  # fmt: skip
        for receptance_index, stored_receptance in enumerate(self.receptances):
            receptance_prefix = f"receptances.{receptance_index}"
            n_pair_and_load_forces, n_modes = stored_receptance.modal.shape
            shape_by_receptance_field = {
                "squares": (n_modes,),
                "compliance": (n_pair_and_load_forces,) * 2,
                "inertia": (n_pairs,),
            }
            for watched_dof in stored_receptance.rows:
                shape_by_receptance_field |= {
                    f"rows.{watched_dof}.0": (n_modes,),
                    f"rows.{watched_dof}.1": (n_pair_and_load_forces,),
                }
            shape_by_name |= {
                f"{receptance_prefix}.{name}": shape
                for name, shape in shape_by_receptance_field.items()
            }
            range_by_name |= {
                f"{receptance_prefix}.squares": (0, MAX_ALLOWED_MAGNITUDE),
                f"{receptance_prefix}.rows": (0, n_dofs),
                f"{receptance_prefix}.n_base": (0, n_modes + 1),
                f"{receptance_prefix}.mode_counts": (1, n_modes + 1),
            }
            array_by_name |= {
                f"{receptance_prefix}.rows": np.array([*stored_receptance.rows]),
                f"{receptance_prefix}.n_base": np.array([stored_receptance.n_base or 0]),
                f"{receptance_prefix}.mode_counts": np.array(stored_receptance.mode_counts),
            }
        check_shapes(array_by_name, shape_by_name)
        for name, array in array_by_name.items():
            lower_limit, upper_limit = range_by_name.get(
                name, (-MAX_ALLOWED_MAGNITUDE, MAX_ALLOWED_MAGNITUDE)
            )
            if array.size and not lower_limit <= array.min() <= array.max() < upper_limit:
                raise ValueError(f"its entry {name!r} has values out of range")
        return n_dofs


@dataclass(frozen=True)
class PreparedFileContent:
    """Data in a prepared file: a structure, perhaps with a coarser structure.

    The coarser structure has a coarser mesh, and serves to estimate the error due to the mesh. It
    is None if there is no coarser mesh.
    """

    structure: PreparedStructure
    coarser_structure: PreparedStructure | None = None

    def make_shared_structure(
        self, scene: Scene, load_weight_matrix: np.ndarray, comm: MPI.Comm
    ) -> SharedStructure:
        """Make the structure for a scene, with its coarser structure, if any (collective).

        Parameters
        ----------
        scene : Scene
            Source of damping and clearance.
        load_weight_matrix : (n, 2K+1)
            Matrix W from the file's load to the scene's load (:func:`weight_matrix_of_load_rows`).
            Columns are rows of the file's load: mean, then cosine and sine parts of the harmonics 1
            to K. Rows are the n rows of the scene's load.
        comm : MPI.Comm
            Ranks that share the structure.
        """
        structure = self.structure.make_structure(scene, load_weight_matrix, comm)
        coarser_scene_or_reason = make_coarser_scene_or_reason(scene)
        single_rank_comm = MPI.COMM_SELF
        if self.coarser_structure is not None and isinstance(coarser_scene_or_reason, Scene):
            # As of a reduced structure.
            coarser_shared_structures = structure.compute_once(
                make_empty_coarser_structure_list, from_matrices=True
            )
            coarser_shared_structures.append(SharedStructure(
                self.coarser_structure.make_structure(
                    coarser_scene_or_reason, load_weight_matrix, single_rank_comm
                ),
                single_rank_comm,
                dependencies_of_structure(coarser_scene_or_reason, single_rank_comm),
            ))  # fmt: skip
        return SharedStructure(structure, comm, dependencies_of_structure(scene, comm))


def save_prepared(prepared: Study, path: str | Path) -> None:
    """Write a prepared scene's modes and static responses to a file (collective).

    :func:`load_prepared` and the commands ``solve`` and ``curve`` read the file, without a mesh.

    Parameters
    ----------
    prepared : Study
        Result of :func:`fenics_crack.prepare`. If it is not reduced (``whole=True``), the file has
        as many modes as a tolerance may choose.
    path : path
        The file; an older one is replaced once the new one is complete.

    Raises
    ------
    InputError
        The scene rotates, is a bladed disk or a solid. Or its structure is not reduced to crack
        faces without mass, its damping is a matrix, or the file cannot be written.

    Examples
    --------
    >>> kept = scene.replace({"reduction.method": "massless", "reduction.modes": 10})
    >>> fc.save_prepared(fc.prepare(kept), "plate.h5")
    """
    candidate_counts_of_modes = candidate_mode_counts(prepared, MAX_MODES_FOR_MANY_SOLUTIONS)
    if candidate_counts_of_modes:
        prepared = replace(
            reduce_to_modes(prepared, candidate_counts_of_modes[-1]), scene=prepared.scene
        )
    prepared = reduce_study(prepared)
    scene, structure = prepared.scene, prepared.structure
    if scene.speed > 0.0 or scene.disk is not None:
        refused_table_name = "disk" if scene.disk is not None else "rotation"
        raise InputError(
            refused_table_name,
            "a table",
            "left out for a prepared structure, which is at rest; solve the scene itself",
        )
    if structure.pairs.pressure_functions_at_nodes is not None:
        raise InputError(
            "geometry.kind",
            "solid",
            "'plate' for a prepared structure; or give matrices in [structure]",
        )
    if not structure.has_massless_crack_faces or not isinstance(
        structure.whole.damping, DampingRule
    ):
        requirement_text = "reduced with reduction.method = 'massless', and damped by [damping]"
        raise InputError("structure", repr(structure), requirement_text)
    coarser_study_or_reason = prepare_coarser_study_or_reason(prepared)
    study_and_coarser_study = (
        prepared,
        *([] if isinstance(coarser_study_or_reason, str) else [coarser_study_or_reason[0]]),
    )
    dataset_by_name = pack_dataclass(
        PreparedFileContent(*map(_gather_prepared_structure, study_and_coarser_study))
    )
    write_result_file(dataset_by_name, path, PREPARED_FILE_KIND, scene, structure.whole.comm)


def _gather_prepared_structure(study: Study) -> PreparedStructure:
    """Gather a reduced study's unreduced structure for a file (collective).

    The file gets the modes of the reduction. If the reference structure for the reduction error has
    more modes, the file gets these.
    """
    reference_structure = getattr(study.structure, "reference", None) or study.structure
    n_modes = max(study.structure.n_modes, reference_structure.n_modes)
    modal_and_static_displacement_rows(
        study.structure.whole,
        n_modes,
        np.array([watched_displacement.dof for watched_displacement in study.watched]),
    )
    return PreparedStructure.gather(study.structure.whole)


def load_prepared(
    path: str | Path, changes: Mapping[str, object] | None = None, comm: MPI.Comm = MPI.COMM_WORLD
) -> Study:
    """Prepare the scene in a file from :func:`save_prepared`, without a mesh (collective).

    :func:`fenics_crack.solve` and :func:`fenics_crack.curve` take the study.

    Parameters
    ----------
    path : path
        The file.
    changes : mapping, optional
        New values by key, as for :meth:`Scene.replace`. Only keys that need no mesh may change,
        such as frequency, damping, clearance and contact law.
    comm : MPI.Comm
        Ranks that share the structure.

    Returns
    -------
    Study
        Study of the scene with these changes, not reduced.

    Raises
    ------
    InputError
        The file cannot be read, is damaged or holds something else; a key needs a mesh; or a mesh
        or matrix file named by the scene has changed.

    Examples
    --------
    >>> kept = scene.replace({"reduction.method": "massless", "reduction.modes": 10})
    >>> fc.save_prepared(fc.prepare(kept), "plate.h5")
    >>> fc.solve(fc.load_prepared("plate.h5", {"excitation.frequency": 800.0}))
    """
    stored_file = read_result_file(path, comm)
    scene = on_root(comm, lambda: _scene_of_file_with_changes(stored_file, changes or {}))
    return prepare(
        scene, comm, whole=True, last=[_make_shared_structure_from_file(stored_file, scene, comm)]
    )


def _scene_of_file_with_changes(stored_file: StoredFile, changes: Mapping[str, object]) -> Scene:
    """Return the scene in a prepared file, with some keys changed.

    ``changes`` has new values by key.

    Raises
    ------
    InputError
        The file is of another kind or has no scene, a changed key needs a mesh, or a requested
        quantity needs matrices (crack tips, clamp).
    """
    stored_file.check_kind(PREPARED_FILE_KIND)
    file_scene = stored_file.scene()
    if file_scene is None:
        raise stored_file.refusal("a prepared structure with its scene; compute it again")
    stored_file.check_files(file_scene, is_required=False)
    scene = file_scene.replace(changes)
    file_dependencies = dependencies_of_structure(file_scene, MPI.COMM_SELF)

    def needs_mesh(changed_scene: Scene) -> bool:
        """Return True if a changed scene needs another mesh than the file's."""
        changed_dependencies = dependencies_of_structure(changed_scene, MPI.COMM_SELF)
        return dependencies_without_amplitudes(
            changed_dependencies
        ) != dependencies_without_amplitudes(file_dependencies) or (
            bool(scene.structure) and changed_dependencies != file_dependencies
        )

    if needs_mesh(scene):
        for changed_key, new_value_of_key in changes.items():
            with suppress(InputError):  # keys that cannot change without another key
                if needs_mesh(file_scene.replace({changed_key: new_value_of_key})):
                    break
        raise InputError(
            changed_key, new_value_of_key, f"as in {stored_file.path}: {CHANGEABLE_KEYS_TEXT}"
        )
    quantities_that_need_matrices = [
        quantity_name
        for quantity_name in scene.quantities or ()
        if OBSERVABLES_BY_NAME[quantity_name].place.is_made_on_request
    ]
    if quantities_that_need_matrices:
        requirement_text = (
            "quantities of points and crack faces in a prepared structure; "
            "for others solve the scene"
        )
        raise InputError("output.quantities", quantities_that_need_matrices, requirement_text)
    _weight_matrix_between_scene_loads(file_scene, scene)
    return scene


def dependencies_without_amplitudes(dependencies: tuple[Any, Any, Any]) -> tuple[Any, ...]:
    """Return the values of a scene that must equal those of a structure file.

    A structure file serves scenes that differ in load amplitudes, clearances or damping. So the
    result leaves out clearances, damping, and the keys force_mean, force_cos, force_sin and
    harmonics of the table ``[excitation]``.

    Parameters
    ----------
    dependencies : tuple of three
        All values that determine a structure, from :func:`dependencies_of_structure`.
    """
    mesh_dependencies, (excitation_value_by_key, *dependencies_of_other_loads), _ = dependencies
    amplitude_keys = ("force_mean", "force_cos", "force_sin", "harmonics")
    kept_value_by_key = excitation_value_by_key and {
        key: value for key, value in excitation_value_by_key.items() if key not in amplitude_keys
    }
    return mesh_dependencies, kept_value_by_key, *dependencies_of_other_loads


def _weight_matrix_between_scene_loads(file_scene: Scene, scene: Scene) -> np.ndarray:
    """Return the matrix W from a prepared file's load to a scene's load: (n, 2K+1).

    The scene's load is W times the file's load. ``file_scene`` is the scene in the file. InputError
    as :func:`weight_matrix_of_load_rows`.
    """
    # Equal loads are not computed: the file of a wave may be gone.
    if dependencies_of_load(file_scene) == dependencies_of_load(scene):
        return np.eye(1 + 2 * file_scene.highest_load_harmonic)
    return weight_matrix_of_load_rows(
        np.array(list_mean_cos_and_sin_force_vectors(file_scene), dtype=float), scene
    )


def weight_matrix_of_load_rows(file_load_rows: np.ndarray, scene: Scene) -> np.ndarray:
    """Return the matrix W from a file's load to a scene's load: (n, 2K+1).

    W is such that F_scene = W F_file. A load matrix F has a row for the mean force, then rows for
    the cosine and sine part of each harmonic. The static responses in the file are computed for
    F_file. W times these responses are the responses to the scene's load.

    Parameters
    ----------
    file_load_rows : (2K+1, d) [N]
        F_file, for the harmonics 1 to K, with d components of the force.
    scene : Scene
        Source of F_scene, with n rows.

    Raises
    ------
    InputError
        F_scene is no linear combination of the file's rows. Or it differs from F_file, and the
        scene has other loads, too.
    """
    scene_load_rows = np.array(list_mean_cos_and_sin_force_vectors(scene), dtype=float)
    has_same_load_rows = np.array_equal(file_load_rows, scene_load_rows)
    weights_of_file_load_rows = (
        np.eye(len(scene_load_rows))
        if has_same_load_rows
        else scene_load_rows @ np.linalg.pinv(file_load_rows)
    )
    is_no_combination_of_file_rows = (
        np.abs(weights_of_file_load_rows @ file_load_rows - scene_load_rows).max()
        > ROUNDING * np.abs(scene_load_rows).max()
    )
    if is_no_combination_of_file_rows or (scene.has_other_loads and not has_same_load_rows):
        requirement_text = (
            f"in the direction of the file's force, without other loads: {CHANGEABLE_KEYS_TEXT}"
        )
        raise InputError("excitation.force_sin", scene.excitation.force_sin, requirement_text)
    return weights_of_file_load_rows


def _make_shared_structure_from_file(
    stored_file: StoredFile, scene: Scene, comm: MPI.Comm
) -> SharedStructure:
    """Make a scene's structure and its coarser structure from a prepared file (collective).

    Raises
    ------
    InputError
        The file was not written by :func:`save_prepared`.
    """
    file_scene = stored_file.scene()
    assert file_scene is not None
    load_weight_matrix = _weight_matrix_between_scene_loads(file_scene, scene)
    with stored_file.yield_datasets_with_valid_numbers() as datasets:
        prepared_file: PreparedFileContent = unpack_dataclass(PreparedFileContent, datasets)
        return prepared_file.make_shared_structure(scene, load_weight_matrix, comm)
