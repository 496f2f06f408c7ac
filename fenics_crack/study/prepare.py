"""Preparation of a scene: structure, reduction and contact law.

The memory for the solution is estimated before it is allocated. The estimates include that a second
matrix is factorized to count modes, while the first factor is still held.
"""

from __future__ import annotations

import ctypes
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_crack.basics.errors import ConvergenceError, InputError
from fenics_crack.basics.machine import machine_memory, process_memory
from fenics_crack.disk.wheel import Wheel, count_basis_families, reduce_wheel
from fenics_crack.model.contact import (
    ContactLaw,
    CoulombFriction,
    LayeredPenalty,
    SmoothedPenalty,
    UnilateralConstraint,
    UnilateralPenalty,
)
from fenics_crack.model.factor import MAX_BLOCK_COLUMNS, estimate_factor_bytes
from fenics_crack.model.modes import n_krylov_vectors
from fenics_crack.model.nodes import AXES
from fenics_crack.model.reduction import DEFAULT_MODES_OF_LARGE_STRUCTURE, reduce_structure
from fenics_crack.model.rotation import N_BASIS_SPEEDS
from fenics_crack.model.structure import Structure
from fenics_crack.scene.keys import RESULT_SETTINGS_TABLE_NAMES
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Contact, Reduction
from fenics_crack.study.sharing import (
    LAST_STRUCTURE_OR_EMPTY_LIST,
    SharedStructure,
    assemble_or_reuse_structure,
)

SINGLE_COMPUTATION_FAILURES = (InputError, ConvergenceError, np.linalg.LinAlgError)
"""Exceptions by which one computation fails while others, such as a sweep's cases, continue."""
MAX_DOFS_UNREDUCED_BY_DEFAULT = 100
"""Maximum dofs of a structure that is not reduced by default, on one rank. A table ``[reduction]``
requests a reduction."""


@dataclass(frozen=True)
class WatchedDisplacement:
    """Displacement component whose numbers are printed, written and drawn.

    Attributes
    ----------
    name : str
        Prefix of its quantities' names, "tip.ux"; empty without points in the scene.
    words : str
        Description, such as "x displacement of tip".
    dof : int
        Number of its dof in the unreduced structure.
    distance_to_node : float [m]
        Distance from the point in the scene to the node used.
    """

    name: str
    words: str
    dof: int
    distance_to_node: float = 0.0

    def column_name(self, quantity: str) -> str:
        """Return the column name of this displacement's quantity: "tip.ux.ratio_2_1".

        Without ``[output.points]`` in the scene it is the quantity alone: "ratio_2_1".
        """
        return f"{self.name}.{quantity}" if self.name else quantity


@dataclass(frozen=True, repr=False)
class Study:
    """A scene prepared for solution, with structure and contact law.

    Attributes
    ----------
    scene : Scene
        Scene with known crack length and chosen reduction.
    structure : Structure
        Structure, reduced as the scene says; unreduced if prepared with ``whole=True``.
    contact : ContactLaw or None
        Law of all contact pairs; None without a crack.
    watched : tuple of WatchedDisplacement
        Displacements that are printed, written and drawn; ``watched[0].dof`` is the first dof.
    """

    scene: Scene
    structure: Structure
    contact: ContactLaw | None
    watched: tuple[WatchedDisplacement, ...]

    def __repr__(self) -> str:
        shown_objects = (self.structure, self.contact, self.scene)
        return f"{type(self).__name__}({', '.join(map(repr, shown_objects))})"


def prepare(
    scene: Scene,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    whole: bool = False,
    like: Study | None = None,
    judged: bool = True,
    last: list[SharedStructure] = LAST_STRUCTURE_OR_EMPTY_LIST,
) -> Study:
    """Prepare a scene: build and reduce its structure, and make its law (collective).

    If a natural frequency stands for the crack length in the scene, the length is found first.

    Parameters
    ----------
    scene : Scene
        Scene to prepare.
    comm : MPI.Comm
        Ranks that share the mesh.
    whole : bool
        Do not reduce, whatever the scene says.
    like : Study, optional
        Study of another scene, to use its mesh and matrices. This is possible if only rotor speed
        and load frequency differ; for a bladed disk, mistuning and load frequency.
    judged : bool
        Reduce with a reference structure of more modes, for the error of the reduction
        (:func:`reduce_structure`).
    last : list
        List with at most one structure, which is used if it has the same mesh. Afterwards the list
        has the new structure. Default: the structure of the last prepared scene.

    Returns
    -------
    Study
        Scene, structure, law and watched displacements.

    Raises
    ------
    InputError
        As :func:`build_structure` and :func:`reduce_structure`. Or a watched point is off the mesh
        by more than 5 % of the mesh's size, or next to a clamped node or a crack face. Or solving
        the scene would take more than 80 % of the machine's memory.

    Examples
    --------
    >>> plate = fc.prepare(scene)
    >>> structure, contact = plate.structure, plate.contact
    """
    if scene.crack is not None and scene.crack.first_omega is not None:
        from fenics_crack.fem.build import with_crack_length  # DOLFINx

        scene = with_crack_length(scene, comm)
    reused_structure = None if like is None else _find_structure_in_reference_study(scene, like)
    structure = (
        assemble_or_reuse_structure(scene, comm, last)
        if reused_structure is None
        else reused_structure
    )
    structure = structure.with_tangents() if scene.has_friction else structure
    watched_displacements = _find_watched_displacements(scene, structure)
    if watched_displacements[0].name:
        structure = structure.watching(watched_displacements[0].dof)
    study = Study(scene, structure, scene_contact_law(scene, structure), watched_displacements)
    return study if whole else reduce_study(study, with_reference=judged)


def _find_watched_displacements(
    scene: Scene, structure: Structure
) -> tuple[WatchedDisplacement, ...]:
    """Find the displacements to be printed, written and drawn (collective).

    Each point in ``[output.points]`` is watched in its free directions, x before y before z.
    Without points, the structure's watched dof is taken: by default the dof with the largest load.

    Raises
    ------
    InputError
        A point is off the mesh by more than 5 % of the mesh's size, or next to a clamped node or a
        crack face. Or the structure has no nodes.
    """
    if not scene.output_points:
        dof = structure.watched_dof
        return (WatchedDisplacement("", structure.dof_name(dof), dof),)
    watched_displacements = []
    sector_structure = structure.sector_structure
    for named_output_point in scene.output_points:
        full_point_key = f"output.points.{named_output_point.key}"
        if sector_structure.nodes is None:
            raise InputError(
                full_point_key,
                named_output_point.values,
                "left out, as the structure has no positions; or give structure.model",
            )
        node_position, node_dofs = sector_structure.nodes.find_nearest_position_and_dofs(
            sector_structure.comm, full_point_key, named_output_point.values
        )
        distance = float(np.linalg.norm(node_position - named_output_point.values).round(12))
        for axis_letter, dof in zip(AXES, node_dofs, strict=False):
            if dof >= 0:
                quantity_prefix = f"{named_output_point.key}.u{axis_letter}"
                words = scene.label_by_displacement_name[quantity_prefix]
                global_dof = structure.dof_of(structure.watched_sector_index + 1, int(dof))
                watched_displacements.append(
                    WatchedDisplacement(quantity_prefix, words, global_dof, distance)
                )
    return tuple(watched_displacements)


def _find_structure_in_reference_study(scene: Scene, reference_study: Study) -> Structure | None:
    """Make a scene's structure from another study's mesh and matrices (collective).

    ``scene`` may differ from the scene of ``reference_study`` in rotor speed, load frequency and
    reduction. For a bladed disk, it may differ in mistuning and load frequency. Tables that only
    choose results may always differ.

    None if more differs. Also None if a structure other than a disk does not rotate.
    """
    reference_scene, reference_structure = reference_study.scene, reference_study.structure.whole
    if reference_scene.disk is not None:
        ignored_key_changes = dict.fromkeys(RESULT_SETTINGS_TABLE_NAMES) | {
            f"disk.{ignored_disk_key}": None
            for ignored_disk_key in ("mistuning", "deviation", "seed")
        }
        ignored_key_changes["excitation.omega"] = 1.0
        if scene.disk is None or scene.replace(ignored_key_changes) != reference_scene.replace(
            ignored_key_changes
        ):
            return None
        return reference_structure.mistuned(scene.disk.deviations)
    rotation = reference_structure.rotation
    if rotation is None or scene.speed == 0.0:
        return None
    ignored_key_changes = {"rotation.speed": 1.0, "excitation.omega": 1.0} | dict.fromkeys(
        RESULT_SETTINGS_TABLE_NAMES
    )
    ignored_key_changes["reduction"] = None
    if scene.replace(ignored_key_changes) != reference_scene.replace(ignored_key_changes):
        return None
    return rotation.structure_rotating_at_speed(scene.speed)


def reduce_study(study: Study, *, with_reference: bool = True) -> Study:
    """Reduce a study as the scene says, unless already reduced (collective).

    With ``with_reference`` the reduced structure has a reference structure of more modes, for the
    reduction error.

    Raises
    ------
    InputError
        As :func:`estimate_and_check_solution_memory` and :func:`reduce_structure`.
    """
    scene, whole_structure = study.scene, study.structure
    if whole_structure.whole is not whole_structure:
        return study
    if whole_structure.has_matrices:
        estimate_and_check_solution_memory(scene, whole_structure)
    if (disk_table := scene.disk) is not None:
        structure = reduce_wheel(
            study.structure.whole,
            disk_table.families,
            more=disk_table.modes,
            reference=with_reference,
        )
        return replace(study, structure=structure)
    reduction = modal_reduction_or_none(scene, whole_structure)
    if reduction is None:
        return study
    scene_with_reduction = scene.replace(
        {"reduction.method": reduction.method, "reduction.modes": reduction.n_modes}
    )
    structure = reduce_structure(
        whole_structure, modes=reduction.n_modes, method=reduction.method, reference=with_reference
    )
    return replace(study, scene=scene_with_reduction, structure=structure)


class ModalReduction(NamedTuple):
    """Method of a modal reduction, and number of kept modes.

    The methods are "massless" (crack faces lose their mass) and "free_interface" (crack faces keep
    it).
    """

    method: str
    n_modes: int


def modal_reduction_or_none(scene: Scene, structure: Structure) -> ModalReduction | None:
    """Return method and number of modes of a scene's reduction; None without reduction.

    A structure is not reduced if ``reduction.method = 'off'``. On one rank, a structure with at
    most 100 dofs and no table ``[reduction]`` is not reduced, either. If all modes are damped and
    no number of modes is given, 50 are kept. In a bladed disk, the keys of ``[disk]`` give the
    number of modes.

    ``reduction.method`` sets the method. The default is "massless": crack faces lose their mass. In
    three cases the default is "free_interface", and crack faces keep their mass: without contact
    pairs, if all modes are kept, or for at most 100 dofs and no table.
    """
    reduction_table = scene.reduction
    if scene.disk is not None:
        n_modes = scene.disk.families * scene.disk.sectors + scene.disk.modes
        return ModalReduction("massless" if structure.n_pairs else "free_interface", n_modes)
    if reduction_table is None:
        is_small = structure.n_dofs <= MAX_DOFS_UNREDUCED_BY_DEFAULT
        if is_small and structure.comm.size == 1:
            return None
        reduction_table = Reduction("free_interface" if is_small else None)
    if reduction_table.method == "off":
        return None
    n_kept_modes = reduction_table.modes or scene.n_damped_modes_or_all
    if isinstance(n_kept_modes, str):  # "all"
        n_kept_modes = min(DEFAULT_MODES_OF_LARGE_STRUCTURE, structure.n_dofs)
    has_massless_faces = structure.n_pairs > 0 and n_kept_modes < structure.n_dofs
    return ModalReduction(
        reduction_table.method or ("massless" if has_massless_faces else "free_interface"),
        n_kept_modes,
    )


def estimate_and_check_solution_memory(
    scene: Scene, structure: Structure, *, is_run_up: bool = False
) -> float:
    """Estimate the memory to solve a scene, or its run-up [byte] (collective).

    A run-up (``is_run_up``) is a curve over the rotor speed. ``structure`` is not reduced.

    Raises
    ------
    InputError
        The memory exceeds 80 % of this machine's.
    """
    needed_bytes = _estimate_memory_to_solve(scene, structure, is_run_up)
    machine_bytes = machine_memory()
    byte_limit = 0.8 * machine_bytes
    if needed_bytes > byte_limit:
        release_freed_memory()  # only now: later steps must allocate it again
        needed_bytes = _estimate_memory_to_solve(scene, structure, is_run_up)
    if needed_bytes > byte_limit:
        memory_text = (
            f"{needed_bytes / 2**30:.3g} GiB of this machine's {machine_bytes / 2**30:.3g} GiB"
        )
        size_text = f"{structure.n_dofs} degrees of freedom need {memory_text}"
        if scene.structure is not None:
            raise InputError(
                "structure.mass",
                scene.structure.mass,
                f"the file of a smaller structure: {size_text}",
            )
        mesh_key = {"grid": "columns", "file": "file"}.get(scene.mesh.layout, "size")
        raise InputError(
            f"mesh.{mesh_key}",
            getattr(scene.mesh, mesh_key),
            f"changed to a coarser mesh: {size_text}",
        )
    return needed_bytes


def _estimate_memory_to_solve(scene: Scene, structure: Structure, is_run_up: bool) -> float:
    """Estimate the peak memory to solve a scene, or its run-up [byte] (collective).

    A run-up (``is_run_up``) is a curve over the rotor speed. ``structure`` is not reduced. The
    memory is not compared with a limit.
    """
    if (disk := scene.disk) is not None:
        return estimate_wheel_memory(
            structure.whole, count_basis_families(disk.families, disk.modes)
        )
    reduction = modal_reduction_or_none(scene, structure)
    if reduction is None:
        return estimate_unreduced_memory(structure, scene.harmonic_balance.harmonics)
    if is_run_up:
        return estimate_run_up_memory(structure, reduction.n_modes)
    return estimate_reduction_memory(structure, reduction.n_modes, reduction.method)


def estimate_reduction_memory(structure: Structure, n_modes: int, method: str) -> float:
    """Estimate the peak memory of :func:`reduce_structure` [byte] (collective).

    The estimate is a sum over all ranks and includes the memory held already.

    Parameters
    ----------
    structure : Structure
        Unreduced structure.
    n_modes : int
        Number of kept modes.
    method : str
        Method of the reduction: "massless" or "free_interface".
    """
    n_dofs, n_static_columns = structure.n_dofs, structure.n_pairs + 1
    n_reference_modes = n_modes + max(n_modes // 2, 10) if method == "massless" else n_modes
    # Blocks of static responses, or all static responses in a basis and its reference's basis.
    static_bytes = (
        8.0 * n_dofs * (4 * MAX_BLOCK_COLUMNS if method == "massless" else 10 * n_static_columns)
    )
    temporary_bytes = max(static_bytes, _estimate_mode_memory(structure, n_reference_modes))
    return (
        _measure_process_memory_of_all_ranks(structure)
        + _estimate_factor_memory(structure)
        + 8.0 * n_dofs * n_reference_modes
        + temporary_bytes
    )


def estimate_wheel_memory(wheel: Wheel, n_families: int) -> float:
    """Estimate the peak memory of :func:`reduce_wheel` [byte] (collective).

    The estimate is a sum over all ranks and includes the memory held already. ``n_families`` is the
    number of modes per nodal diameter in the basis.
    """
    sector = wheel.sector
    n_real_dofs, n_dofs = 2 * len(sector.dof_numbering.own_members), sector.structure.n_dofs
    is_solid = sector.structure.nodes is not None and sector.structure.nodes.points.shape[1] == 3
    solver_bytes = 2.0 * estimate_factor_bytes(
        n_real_dofs, solid=is_solid
    ) + 16.0 * n_real_dofs * n_krylov_vectors(n_families)
    bytes_of_modes = 16.0 * len(sector.nodal_diameter_range) * n_dofs * n_families
    # Responses of the sectors to the crack's opening, their products with a matrix, and as much
    # again while either is made. Bonds have up to 40 force patterns beyond those of the pairs.
    n_opening_columns = min(
        2 * sector.structure.n_pairs + 40, len(sector.dof_numbering.upper_crack_face_members)
    )
    opening_bytes = 32.0 * sector.n_sectors * n_dofs * n_opening_columns
    return _measure_process_memory_of_all_ranks(wheel) + wheel.comm.size * (
        solver_bytes + bytes_of_modes + opening_bytes
    )


def estimate_unreduced_memory(structure: Structure, n_harmonics: int) -> float:
    """Estimate the memory to solve an unreduced structure [byte] (collective).

    Each harmonic 0 to ``n_harmonics`` keeps a factor of its dynamic stiffness. The memory held
    already is included.
    """
    return _measure_process_memory_of_all_ranks(structure) + (
        n_harmonics + 1
    ) * _estimate_factor_memory(structure)


def estimate_run_up_memory(structure: Structure, n_modes: int) -> float:
    """Estimate the peak memory of :func:`run_up_structure` [byte] (collective).

    A run-up uses a common basis of the modes at 3 rotor speeds. The peak is the larger of two:

    - a basis, with the factor and the modes at a further speed;
    - three bases, while a basis is extended: old basis, addition and union.

    The memory held already is included. ``n_modes`` is the number of modes at each speed.
    """
    basis_bytes = 8.0 * structure.n_dofs * N_BASIS_SPEEDS * (n_modes + structure.n_pairs + 1)
    bytes_of_modes = (
        _estimate_factor_memory(structure) + _estimate_mode_memory(structure, n_modes) + basis_bytes
    )
    return (
        _measure_process_memory_of_all_ranks(structure)
        + _memory_of_unfactored_matrix(structure)
        + max(bytes_of_modes, 3.0 * basis_bytes)
    )


def _estimate_mode_memory(structure: Structure, n_modes: int) -> float:
    """Estimate the memory to find ``n_modes`` modes [byte] (collective).

    The estimate is the larger of two: the Krylov vectors of the eigensolver; or the memory to count
    modes, a second factor with a matrix and its copy. The existing factor of the stiffness is not
    included.
    """
    krylov_bytes = 8.0 * structure.n_dofs * n_krylov_vectors(n_modes)
    return max(
        krylov_bytes,
        _estimate_factor_memory(structure) + 2 * _memory_of_unfactored_matrix(structure),
    )


def _memory_of_unfactored_matrix(structure: Structure) -> float:
    """Return the memory of a matrix with as many nonzeros as the stiffness [byte] (collective)."""
    bytes_per_entry = np.dtype(PETSc.ScalarType).itemsize + np.dtype(PETSc.IntType).itemsize
    n_entries: float = structure.stiffness.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
    return bytes_per_entry * n_entries


def _estimate_factor_memory(structure: Structure) -> float:
    """Estimate the memory of a factorization of the stiffness matrix [byte]."""
    is_solid = structure.nodes is not None and structure.nodes.points.shape[1] == 3
    return estimate_factor_bytes(structure.n_dofs, solid=is_solid)


def release_freed_memory() -> None:
    """Return memory freed by the program to the operating system.

    Without this, freed memory still counts as memory of this program. Nothing happens if the C
    library has no ``malloc_trim``.
    """
    with suppress(AttributeError):  # a C library without it
        ctypes.CDLL(None).malloc_trim(0)


def _measure_process_memory_of_all_ranks(structure: Structure) -> float:
    """Return the memory that all ranks hold now [byte] (collective)."""
    return float(structure.comm.allreduce(process_memory("VmRSS")))


def scene_contact_law(scene: Scene, structure: Structure) -> ContactLaw | None:
    """Return the contact law of a scene's pairs.

    None without pairs or without a table ``[contact]``.

    Raises
    ------
    InputError
        Friction acts on crack faces with mass, and the contact is not a penalty law with a
        tangential stiffness.
    """
    if structure.n_pairs == 0 or scene.contact is None:
        return None
    contact_table, reduction = scene.contact, modal_reduction_or_none(scene, structure)
    has_massless_faces = structure.has_massless_crack_faces or (
        reduction is not None and reduction.method == "massless"
    )
    if contact_table.friction and not has_massless_faces:  # pairs that stick must give a little
        condition_text = (
            "with friction of crack faces with mass; or set reduction.method = 'massless'"
        )
        contact_table.require(contact_table.law == "penalty", "law", f"'penalty' {condition_text}")
        contact_table.given(
            "tangential_stiffness_per_area", f"given: a stiffness [N/m^3], {condition_text}"
        )
    return contact_law(contact_table, structure)


def contact_law(contact: Contact, structure: Structure | None = None) -> ContactLaw:
    """Make the contact law of a scene's contact table.

    A stiffness per area [N/m^3] is multiplied by the area of each contact pair, which gives a
    stiffness per pair [N/m]. So refining the mesh does not change the physics.

    Parameters
    ----------
    contact : Contact
        The table: ``scene.contact``.
    structure : Structure, optional
        Structure with areas of pairs, needed for a stiffness per area.

    Returns
    -------
    ContactLaw
        Law of all pairs.

    Raises
    ------
    InputError
        The table has a stiffness per area, but no structure with areas is given. Or it has
        friction, and the structure has no tangential gaps.

    Examples
    --------
    >>> law = fc.contact_law(scene.contact, structure)
    """
    if not isinstance(contact, Contact):
        raise InputError("contact", contact, "a Contact, such as scene.contact")
    law = _make_normal_contact_law(contact, structure)
    if not contact.friction:
        return law
    if structure is not None and structure.tangential is None:
        requirement_text = (
            "0, or left out, as the structure has no tangential gaps; a solid gets them by "
            "structure.with_tangents()"
        )
        raise InputError("contact.friction", contact.friction, requirement_text)
    tangential_stiffness_per_area = contact.tangential_stiffness_per_area
    if tangential_stiffness_per_area is None:
        return CoulombFriction(law, contact.friction)
    tangential_stiffness = _stiffness_of_pairs(
        "tangential_stiffness_per_area", tangential_stiffness_per_area, structure
    )
    return CoulombFriction(law, contact.friction, tangential_stiffness)


def _stiffness_of_pairs(
    stiffness_key: str, stiffness_per_area: float, structure: Structure | None
) -> np.ndarray:
    """Return the stiffness of a structure's contact pairs: (n_pairs,) [N/m].

    Parameters
    ----------
    stiffness_key : str
        Key of ``[contact]`` with the stiffness, for the message of an InputError.
    stiffness_per_area : float [N/m^3]
        Stiffness, which is multiplied by the area of each pair.
    structure : Structure or None
        Structure with the areas; InputError if they are unknown.
    """
    if structure is None or structure.pair_areas is None:
        requirement_text = (
            "used with a structure from a mesh: call contact_law(scene.contact, structure)"
        )
        raise InputError(f"contact.{stiffness_key}", stiffness_per_area, requirement_text)
    return stiffness_per_area * structure.pair_areas


def _make_normal_contact_law(contact_table: Contact, structure: Structure | None) -> ContactLaw:
    """Make the normal contact law of a table ``[contact]``, without friction.

    InputError if the table has a stiffness per area, but no ``structure`` with areas is given.
    """
    if contact_table.law == "unilateral":
        return UnilateralConstraint()
    pair_stiffness: float | np.ndarray | None = contact_table.stiffness
    if (stiffness_per_area := contact_table.stiffness_per_area) is not None:
        pair_stiffness = _stiffness_of_pairs("stiffness_per_area", stiffness_per_area, structure)
    assert pair_stiffness is not None
    if contact_table.layer_depth is not None:
        assert contact_table.layer_share is not None
        return LayeredPenalty(pair_stiffness, contact_table.layer_depth, contact_table.layer_share)
    if contact_table.law == "smoothed":
        assert contact_table.sharpness is not None
        return SmoothedPenalty(pair_stiffness, contact_table.sharpness)
    return UnilateralPenalty(pair_stiffness)
