"""From a scene to what is solved: its structure, reduced as it says, and its contact law.

The memory that this is going to take is stated before it is spent. Modes are counted by a second
factor while the first one is held.
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
from fenics_crack.basics.threads import machine_memory, memory_of_process
from fenics_crack.disk.wheel import Wheel, count_basis_families, reduce_wheel
from fenics_crack.model.contact import (
    ContactLaw,
    CoulombFriction,
    SmoothedPenalty,
    UnilateralConstraint,
    UnilateralPenalty,
)
from fenics_crack.model.factor import MAX_BLOCK_COLUMNS, factor_memory
from fenics_crack.model.modes import krylov_size
from fenics_crack.model.nodes import AXES
from fenics_crack.model.reduction import DEFAULT_LARGE_MODES, reduce_structure
from fenics_crack.model.rotation import N_SPEEDS
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import LOOKED_AT, Scene
from fenics_crack.scene.tables import Contact, Reduction
from fenics_crack.study.sharing import LAST, Made, assembled

REFUSALS = (InputError, ConvergenceError, np.linalg.LinAlgError)
"""Errors that fail one run while others go on."""
FEW_DOFS = 100
"""Maximum dofs of a structure that is reduced only on request."""


@dataclass(frozen=True)
class Watched:
    """A displacement that is watched.

    Attributes
    ----------
    name : str
        "tip.ux", with which the names of its quantities begin; empty for the load's.
    words : str
        "x displacement of tip".
    dof : int
        Of the whole structure.
    distance : float [m]
        From the point in the scene to the node that is watched.
    """

    name: str
    words: str
    dof: int
    distance: float = 0.0

    def column(self, quantity: str) -> str:
        """The name of one of its quantities: "tip.ux.ratio_2_1", or "ratio_2_1"."""
        return f"{self.name}.{quantity}" if self.name else quantity


@dataclass(frozen=True, repr=False)
class Study:
    """A scene prepared for solution.

    Attributes
    ----------
    scene : Scene
        With the crack length found and the reduction chosen.
    structure : Structure
        Reduced as the scene says.
    contact : ContactLaw or None
        Law of all pairs; None without a crack.
    watched : tuple of Watched
        The displacements that are printed, written and drawn: ``watched[0].dof`` is the first one.
    """

    scene: Scene
    structure: Structure
    contact: ContactLaw | None
    watched: tuple[Watched, ...]

    def __repr__(self) -> str:
        parts = (self.structure, self.contact, self.scene)
        return f"{type(self).__name__}({', '.join(map(repr, parts))})"


def prepare(
    scene: Scene,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    whole: bool = False,
    like: Study | None = None,
    judged: bool = True,
    last: list[Made] = LAST,
) -> Study:
    """Find a scene's crack length, build its structure, reduce it, and make its law (collective).

    Parameters
    ----------
    scene : Scene
        Scene to prepare.
    comm : MPI.Comm
        Ranks that share the mesh.
    whole : bool
        Do not reduce, whatever the scene says.
    like : Study, optional
        Of another scene, whose mesh and matrices are taken if the rotor's speed is all that
        differs.
    judged : bool
        Reduce with what estimates the error of the reduction (:func:`reduce_structure`).
    last : list
        The structure with which it is shared if it is of the same mesh, and whose place it takes;
        default: that of the last scene.

    Returns
    -------
    Study
        Scene, structure and law, and the dofs that the scene watches.

    Raises
    ------
    InputError
        As :func:`build_structure` and :func:`reduce_structure`; a point of ``[output.points]`` is
        not near a node of its own; or solving the scene would take more than 80 % of the machine's
        memory.

    Examples
    --------
    >>> plate = fc.prepare(scene)
    >>> structure, contact = plate.structure, plate.contact
    """
    if scene.crack is not None and scene.crack.first_omega is not None:
        from fenics_crack.fem.build import with_crack_length  # DOLFINx

        scene = with_crack_length(scene, comm)
    known = None if like is None else _at_another_speed(scene, like)
    structure = assembled(scene, comm, last) if known is None else known
    structure = structure.with_tangents() if scene.has_friction else structure
    watched = _watched_dofs(scene, structure)
    if watched[0].name:
        structure = structure.watching(watched[0].dof)
    study = Study(scene, structure, law_of(scene, structure), watched)
    return study if whole else reduced(study, judged=judged)


def _watched_dofs(scene: Scene, structure: Structure) -> tuple[Watched, ...]:
    """Return the watched dofs of a scene's structure, not reduced (collective).

    The points of ``[output.points]``, x before y, where they are free to move; without them what
    the structure watches, or the dof that carries most of the load.

    Raises
    ------
    InputError
        A point is not near a node of its own, or the structure has no nodes.
    """
    if not scene.points:
        dof = structure.watched_dof
        return (Watched("", structure.dof_name(dof), dof),)
    found, part = [], structure.sector_structure  # points are those of a blade
    for point in scene.points:
        key = f"output.points.{point.key}"
        if part.nodes is None:
            raise InputError(key, point.values, "left out: the structure has no positions")
        place, dofs = part.nodes.find_nearest(part.comm, key, point.values)
        distance = float(np.linalg.norm(place - point.values).round(12))
        for axis, dof in zip(AXES, dofs, strict=False):
            if dof >= 0:
                name, own = (
                    f"{point.key}.u{axis}",
                    structure.dof_of(structure.watched_sector + 1, int(dof)),
                )
                found.append(Watched(name, scene.point_names[name], own, distance))
    return tuple(found)


def _at_another_speed(scene: Scene, like: Study) -> Structure | None:
    """The structure of a scene from that of one which differs in the rotor's speed alone, and in
    the load's frequency; of a bladed disk in its mistuning; else None (collective)."""
    other, whole = like.scene, like.structure.whole
    if other.disk is not None:
        same = dict.fromkeys(LOOKED_AT) | {
            f"disk.{key}": None for key in ("mistuning", "deviation", "seed")
        }
        same["excitation.omega"] = 1.0
        if scene.disk is None or scene.replace(same) != other.replace(same):
            return None
        return whole.mistuned(scene.disk.deviations)
    rotation = whole.rotation
    if rotation is None or scene.speed == 0.0:
        return None
    same = {"rotation.speed": 1.0, "excitation.omega": 1.0} | dict.fromkeys(LOOKED_AT)
    same["reduction"] = None
    if scene.replace(same) != other.replace(same):
        return None
    return rotation.at(scene.speed)


def reduced(study: Study, *, judged: bool = True) -> Study:
    """A study, reduced as its scene says unless it has been reduced, with the reference of the
    reduction unless that is not needed (collective).

    Raises
    ------
    InputError
        As :func:`check_memory_of` and :func:`reduce_structure`.
    """
    scene, whole = study.scene, study.structure
    if whole.whole is not whole:
        return study
    if whole.has_matrices:
        check_memory_of(scene, whole)
    if (disk := scene.disk) is not None:
        wheel = study.structure.whole
        structure = reduce_wheel(wheel, disk.families, more=disk.modes, reference=judged)
        return replace(study, structure=structure)
    kept = reduction_of(scene, whole)
    if kept is None:
        return study
    settled = scene.replace({"reduction.method": kept.method, "reduction.modes": kept.modes})
    structure = reduce_structure(whole, modes=kept.modes, method=kept.method, reference=judged)
    return replace(study, scene=settled, structure=structure)


class Kept(NamedTuple):
    """Method of a reduction, and the number of modes kept."""

    method: str
    modes: int


def reduction_of(scene: Scene, structure: Structure) -> Kept | None:
    """Return the reduction of a scene's structure; None if it is not reduced.

    Without the table ``[reduction]`` a structure of up to 100 dofs on one rank is not reduced. If
    all modes are damped and no number of modes is given, 50 are kept. Crack faces lose their mass
    unless the scene names another method, there are none, all modes are kept, or the structure
    would not be reduced on one rank.
    """
    table = scene.reduction
    if scene.disk is not None:
        many = scene.disk.families * scene.disk.sectors + scene.disk.modes
        return Kept("massless" if structure.n_pairs else "free_interface", many)
    if table is None:
        few = structure.n_dofs <= FEW_DOFS
        if few and structure.comm.size == 1:
            return None
        table = Reduction("free_interface" if few else None)
    if table.method == "off":
        return None
    modes = table.modes or scene.damped_modes
    if isinstance(modes, str):  # "all"
        modes = min(DEFAULT_LARGE_MODES, structure.n_dofs)
    lips = structure.n_pairs > 0 and modes < structure.n_dofs
    return Kept(table.method or ("massless" if lips else "free_interface"), modes)


def check_memory_of(scene: Scene, structure: Structure, *, run_up: bool = False) -> float:
    """Memory that solving a scene is going to need, or its run-up, estimated [byte] (collective).

    Raises
    ------
    InputError
        This machine has not so much.
    """
    needed, machine = _memory_needed(scene, structure, run_up), machine_memory()
    most = 0.8 * machine
    if needed > most:
        give_back_freed()  # not before: what needs memory next would have to be given it again
        needed = _memory_needed(scene, structure, run_up)
    if needed > most:
        memory = f"{needed / 2**30:.3g} GiB of this machine's {machine / 2**30:.3g}"
        sizes = f"{structure.n_dofs} degrees of freedom need {memory}"
        if scene.structure is not None:
            mass = scene.structure.mass
            raise InputError("structure.mass", mass, f"that of a smaller structure: {sizes}")
        key = {"grid": "columns", "file": "file"}.get(scene.mesh.layout, "size")
        value = getattr(scene.mesh, key)
        raise InputError(f"mesh.{key}", value, f"that of a coarser mesh: {sizes}")
    return needed


def _memory_needed(scene: Scene, structure: Structure, run_up: bool) -> float:
    if (disk := scene.disk) is not None:
        return wheel_memory(structure.whole, count_basis_families(disk.families, disk.modes))
    kept = reduction_of(scene, structure)
    if kept is None:
        return whole_memory(structure, scene.harmonic_balance.harmonics)
    if run_up:
        return run_up_memory(structure, kept.modes)
    return reduction_memory(structure, kept.modes, kept.method)


def reduction_memory(structure: Structure, modes: int, method: str) -> float:
    """Most memory of all ranks during :func:`reduce_structure`, what is held already included
    [byte] (collective)."""
    dofs, columns = structure.n_dofs, structure.n_pairs + 1
    kept = modes + max(modes // 2, 10) if method == "massless" else modes
    # Blocks of static responses, or all of them in a basis and that of its reference.
    static = 8.0 * dofs * (4 * MAX_BLOCK_COLUMNS if method == "massless" else 10 * columns)
    most = max(static, _memory_for_modes(structure, kept))
    return _memory_held(structure) + _factor_memory(structure) + 8.0 * dofs * kept + most


def wheel_memory(wheel: Wheel, families: int) -> float:
    """The same of :func:`reduce_wheel` with a basis of so many families (collective)."""
    sector = wheel.sector
    size, dofs = 2 * len(sector.dof_numbering.own_members), sector.structure.n_dofs
    solid = sector.structure.nodes is not None and sector.structure.nodes.points.shape[1] == 3
    of_modes = 2.0 * factor_memory(size, solid=solid) + 16.0 * size * krylov_size(families)
    modes = 16.0 * len(sector.nodal_diameters) * dofs * families
    # Answers to the opening of the crack by sectors, their products with a matrix, and as much
    # again while either is made; bonds have up to 40 patterns of forces beyond those of the pairs.
    columns = min(2 * sector.structure.n_pairs + 40, len(sector.dof_numbering.upper_members))
    opened = 32.0 * sector.n_sectors * dofs * columns
    return _memory_held(wheel) + wheel.comm.size * (of_modes + modes + opened)


def whole_memory(structure: Structure, harmonics: int) -> float:
    """The same of solving it as it is: a factor for each harmonic, all kept (collective)."""
    return _memory_held(structure) + (harmonics + 1) * _factor_memory(structure)


def run_up_memory(structure: Structure, modes: int) -> float:
    """The same of :func:`run_up_structure`: the modes of another speed, with its stiffness, beside
    the basis of the others; or three bases at a time, the old one, the addition, and the result of
    both (collective)."""
    basis = 8.0 * structure.n_dofs * N_SPEEDS * (modes + structure.n_pairs + 1)
    of_modes = _factor_memory(structure) + _memory_for_modes(structure, modes) + basis
    return _memory_held(structure) + _matrix_memory(structure) + max(of_modes, 3.0 * basis)


def _memory_for_modes(structure: Structure, count: int) -> float:
    """Return the memory to find modes: vectors, or another factor, of a matrix and its copy."""
    krylov = 8.0 * structure.n_dofs * krylov_size(count)
    return max(krylov, _factor_memory(structure) + 2 * _matrix_memory(structure))


def _matrix_memory(structure: Structure) -> float:
    """A matrix of the stiffness's pattern (collective)."""
    entry = np.dtype(PETSc.ScalarType).itemsize + np.dtype(PETSc.IntType).itemsize
    found: float = structure.stiffness.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
    return entry * found


def _factor_memory(structure: Structure) -> float:
    solid = structure.nodes is not None and structure.nodes.points.shape[1] == 3
    return factor_memory(structure.n_dofs, solid=solid)


def give_back_freed() -> None:
    """Give memory that is free but kept back to the system: it counts as held."""
    with suppress(AttributeError):  # a C library without it
        ctypes.CDLL(None).malloc_trim(0)


def _memory_held(structure: Structure) -> float:
    """Memory that all ranks hold now [byte]."""
    return float(structure.comm.allreduce(memory_of_process("VmRSS")))


def law_of(scene: Scene, structure: Structure) -> ContactLaw | None:
    """The contact law of a scene's pairs; None if there are no pairs."""
    if structure.n_pairs == 0 or scene.contact is None:
        return None
    contact, kept = scene.contact, reduction_of(scene, structure)
    massless = structure.light_lips or (kept is not None and kept.method == "massless")
    if contact.friction and not massless:  # pairs that stick must give a little
        also = "with friction of crack faces that keep their mass; or reduction.method = 'massless'"
        contact.require(contact.law == "penalty", "law", f"'penalty' {also}")
        contact.given("tangential_stiffness_per_area", f"given [N/m^3] {also}")
    return contact_law(contact, structure)


def contact_law(contact: Contact, structure: Structure | None = None) -> ContactLaw:
    """The law that a scene's contact table describes.

    A stiffness per area [N/m^3] becomes that of each pair [N/m] by the structure's ``pair_areas``,
    so that refining the mesh does not change the physics.

    Parameters
    ----------
    contact : Contact
        The table: ``scene.contact``.
    structure : Structure, optional
        Needed for a stiffness per area.

    Returns
    -------
    ContactLaw
        Of all pairs.

    Raises
    ------
    InputError
        There is a stiffness per area, and no structure with areas.

    Examples
    --------
    >>> law = fc.contact_law(scene.contact, structure)
    """
    if not isinstance(contact, Contact):
        raise InputError("contact", contact, "the contact table of a scene")
    law = _normal_law(contact, structure)
    if not contact.friction:
        return law
    if structure is not None and structure.tangential is None:
        allowed = "0, or left out, of a structure without tangents"
        raise InputError("contact.friction", contact.friction, allowed)
    per_area = contact.tangential_stiffness_per_area
    if per_area is None:
        return CoulombFriction(law, contact.friction)
    areas = _areas("tangential_stiffness_per_area", per_area, structure)
    return CoulombFriction(law, contact.friction, per_area * areas)


def _areas(key: str, value: float, structure: Structure | None) -> np.ndarray:
    """Areas of the pairs; InputError where they are not known."""
    if structure is None or structure.pair_areas is None:
        allowed = "used with a structure made from a mesh: contact_law(scene.contact, structure)"
        raise InputError(f"contact.{key}", value, allowed)
    return structure.pair_areas


def _normal_law(contact: Contact, structure: Structure | None) -> ContactLaw:
    if contact.law == "unilateral":
        return UnilateralConstraint()
    stiffness: float | np.ndarray | None = contact.stiffness
    if (per_area := contact.stiffness_per_area) is not None:
        stiffness = per_area * _areas("stiffness_per_area", per_area, structure)
    assert stiffness is not None
    if contact.law == "smoothed":
        assert contact.sharpness is not None
        return SmoothedPenalty(stiffness, contact.sharpness)
    return UnilateralPenalty(stiffness)
