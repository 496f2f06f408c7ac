"""One structure shared by scenes of one mesh: the next scene uses the results of the last.

The last structure is kept with its modes, responses and coarser mesh. It is released before
another mesh is made. A structure does not depend on frequency, law, harmonics, modes and requested
results. For a plate or solid at rest, another load, damping or clearance shares the matrices. Files
are compared by content, not by time: a copy may keep the old time, and times are coarse.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any, NamedTuple

from mpi4py import MPI

from fenics_crack.basics.observables import OBSERVABLES_BY_NAME
from fenics_crack.basics.ranks import on_root
from fenics_crack.fem.setting import clearance_of, damping_rule_of
from fenics_crack.files.store import list_scene_file_digests
from fenics_crack.model.body import SETTING_WITHOUT_CHANGES
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene


class SharedStructure(NamedTuple):
    """A structure kept for further scenes, with the values that determine it.

    Attributes
    ----------
    structure : Structure
        Unreduced structure.
    comm : MPI.Comm
        Ranks that were asked to share the structure.
    dependencies : tuple of three
        Values that determine mesh, loads, and clearances with damping, from
        :func:`dependencies_of_structure`.
    """

    structure: Structure
    comm: MPI.Comm
    dependencies: tuple[Any, Any, Any]


LAST_STRUCTURE_OR_EMPTY_LIST: list[SharedStructure] = []
"""The structure made last in this process, for the next scene to use: at most one entry."""


def make_empty_coarser_structure_list(structure: Structure) -> list[SharedStructure]:
    """Return an empty list, in which a structure keeps its structure on a coarser mesh.

    :meth:`Structure.compute_once` calls this function once, and returns the same list later. The
    coarser structure is put into the list when it is made.
    """
    return []


CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST: list[Any] = []
"""The file in which a command keeps its structure for later commands
(:class:`fenics_crack.study.shelf.StructureFile`): at most one entry."""


def assemble_or_reuse_structure(
    scene: Scene,
    comm: MPI.Comm,
    last_shared_structures: list[SharedStructure] = LAST_STRUCTURE_OR_EMPTY_LIST,
) -> Structure:
    """Return a scene's structure, an existing one if possible (collective).

    First the last structure is tried, then a structure file. If neither fits, the structure is made
    from a new mesh or from matrices. The scene must give the crack length, not a natural frequency
    instead.

    Parameters
    ----------
    scene : Scene
        Scene of the structure.
    comm : MPI.Comm
        Ranks that share the structure.
    last_shared_structures : list of SharedStructure
        List with at most one structure, used if it has the same mesh (:func:`_can_reuse`).
        Afterwards the list has the result alone.

    Raises
    ------
    InputError
        As :func:`fenics_crack.build_structure`.
    """
    dependencies = dependencies_of_structure(scene, comm)
    needs_equal_dependencies = (
        scene.speed > 0.0 or scene.disk is not None or scene.structure is not None
    )
    structure_files = [] if (  # what is integrated over a mesh of DOLFINx needs one
        needs_equal_dependencies or last_shared_structures is not LAST_STRUCTURE_OR_EMPTY_LIST
        or scene.geometry.file is not None
        or any(
            OBSERVABLES_BY_NAME[name].place.is_made_on_request for name in scene.quantities or ()
        )
    ) else CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST  # fmt: skip
    if not comm.allreduce(
        bool(last_shared_structures)
        and _can_reuse(last_shared_structures[0], dependencies, comm, needs_equal_dependencies),
        MPI.LAND,
    ):
        last_shared_structures.clear()
        last_shared_structures += [
            shared_structure
            for structure_file in structure_files
            if (shared_structure := structure_file.read_shared_structure_or_none(scene, comm))
            is not None
        ]
    if not last_shared_structures:
        from fenics_crack.fem.build import assemble_structure  # DOLFINx

        last_shared_structures.append(
            SharedStructure(assemble_structure(scene, comm), comm, dependencies)
        )
    elif (last_shared_structure := last_shared_structures[0]).dependencies != dependencies:
        pairs = last_shared_structure.structure.pairs
        setting_changes = {
            "clearance": clearance_of(scene, pairs),
            "damping": damping_rule_of(scene.damping),
        }
        if last_shared_structure.dependencies[1] != dependencies[1]:
            from fenics_crack.fem.build import assemble_force_watched_and_clamp

            setting_changes |= assemble_force_watched_and_clamp(
                scene, last_shared_structure.structure
            )
        last_shared_structures[:] = [
            SharedStructure(
                last_shared_structure.structure._in_setting(
                    SETTING_WITHOUT_CHANGES, **setting_changes
                ),
                comm,
                dependencies,
            )
        ]
    for structure_file in structure_files:
        structure_file.note_structure_for_writing(last_shared_structures[0], scene)
    return last_shared_structures[0].structure


def _can_reuse(
    shared_structure: SharedStructure,
    dependencies: tuple[Any, Any, Any],
    comm: MPI.Comm,
    needs_equal_dependencies: bool,
) -> bool:
    """Return True if a kept structure can serve a scene.

    Mesh and ranks must be the same. If the structure is from a file, without a mesh of DOLFINx, the
    loads must be the same, too. A structure with matrices but without a mesh serves only a command
    that keeps a structure file (:data:`CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST`).

    Parameters
    ----------
    shared_structure : SharedStructure
        Kept structure.
    dependencies : tuple of three
        Values that determine the scene's structure (:func:`dependencies_of_structure`).
    comm : MPI.Comm
        Ranks that shall share the structure.
    needs_equal_dependencies : bool
        True if loads, clearances and damping must be the same, too. This is needed with rotation, a
        disk or given matrices.
    """
    has_mesh = getattr(shared_structure.structure.nodes, "dolfinx_mesh_and_dofs", None) is not None
    has_same_ranks = MPI.Comm.Compare(shared_structure.comm, comm) in (MPI.IDENT, MPI.CONGRUENT)
    has_usable_matrices = (
        has_mesh
        or bool(CURRENT_STRUCTURE_FILE_OR_EMPTY_LIST)
        or not shared_structure.structure.has_matrices
    )
    has_same_mesh_and_loads = (
        shared_structure.dependencies[0] == dependencies[0]
        and (has_mesh or shared_structure.dependencies[1] == dependencies[1])
        and has_usable_matrices
    )
    return (shared_structure.comm == comm if has_mesh else has_same_ranks) and (
        shared_structure.dependencies == dependencies
        if needs_equal_dependencies
        else has_same_mesh_and_loads
    )


def dependencies_of_structure(scene: Scene, comm: MPI.Comm) -> tuple[Any, Any, Any]:
    """Return the values in a scene that determine its structure (collective).

    Two scenes with equal values have the same structure.

    Returns
    -------
    mesh_dependencies : tuple
        Tables that determine mesh and matrices, and digests of the files that they name.
    loads : tuple
        Values that determine the loads, from :func:`dependencies_of_load`.
    clearances_and_damping : tuple
        Clearance of each crack, and the table ``[damping]``.
    """
    cracks = [*scene.crack_by_name.values()]
    pair_kind = scene.contact is not None and scene.contact.pairs
    mesh_dependencies = (
        scene.geometry, scene.material, _value_by_key_without(scene.mesh, "error", "coarser"),
        pair_kind, [_value_by_key_without(crack, "clearance") for crack in cracks],
        scene.rotation, scene.disk, scene.structure,
        on_root(comm, lambda: list_scene_file_digests(scene)),
    )  # fmt: skip
    return (
        mesh_dependencies,
        dependencies_of_load(scene),
        ([crack.clearance for crack in cracks], scene.damping),
    )


def dependencies_of_load(scene: Scene) -> tuple[Any, ...]:
    """Return the values in a scene that determine the load vectors.

    Returns
    -------
    tuple of three
        Values of the table ``[excitation]`` by key, without the frequency; other loads; and the
        base motion.
    """
    return _value_by_key_without(scene.excitation, "omega", "frequency"), scene.loads, scene.base


def _value_by_key_without(table: Any, *omitted_keys: str) -> Any:
    """Return a table's values by key, without ``omitted_keys``; None without a table."""
    return table and {
        field.name: getattr(table, field.name)
        for field in fields(table)
        if field.name not in omitted_keys
    }
