"""From a scene to what is solved: its structure, reduced as it says, and its contact law."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np
from mpi4py import MPI

from fenics_crack.errors import InputError
from fenics_crack.fem.assembly import assemble
from fenics_crack.fem.build import with_crack_length
from fenics_crack.model.contact import (
    ContactLaw,
    SmoothedPenalty,
    UnilateralConstraint,
    UnilateralPenalty,
)
from fenics_crack.model.memory import machine_memory, reduction_memory, whole_memory
from fenics_crack.model.reduction import MODES, reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Contact, Reduction, Scene

__all__ = ["Study", "check_memory_of", "contact_law", "law_of", "prepare", "reduction_of"]

FEW_DOFS = 100
"""A structure with at most so many dofs is reduced only on request."""
SHARE = 0.8
"""Of the machine's memory that may be used."""


@dataclass(frozen=True)
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
    """

    scene: Scene
    structure: Structure
    contact: ContactLaw | None


def prepare(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD, *, whole: bool = False) -> Study:
    """Find a scene's crack length, build its structure, reduce it, and make its law (collective).

    Parameters
    ----------
    scene : Scene
        What to prepare.
    comm : MPI.Comm
        Ranks that share the mesh.
    whole : bool
        Do not reduce, whatever the scene says.

    Raises
    ------
    InputError
        As :func:`build_structure`, :func:`check_memory_of` and :func:`reduce_structure`.
    """
    scene = with_crack_length(scene, comm)
    structure = assemble(scene, comm)
    law = law_of(scene, structure)
    if whole:
        return Study(scene, structure, law)
    check_memory_of(scene, structure)
    table = reduction_of(scene, structure)
    if table is None:
        return Study(scene, structure, law)
    assert table.method is not None
    settled = scene.replace({f"reduction.{name}": value for name, value in asdict(table).items()})
    return Study(settled, reduce_structure(structure, modes=table.modes, method=table.method), law)


def reduction_of(scene: Scene, structure: Structure) -> Reduction | None:
    """How the structure of a scene is reduced; None if it is not.

    Without the table ``[reduction]`` a structure of up to 100 dofs on one rank is not reduced. If
    all modes are damped and no number of modes is given, 50 are kept. Lips lose their mass unless
    the scene names another method, there are none, all modes are kept, or the structure would not
    be reduced on one rank.
    """
    table = scene.reduction
    if table is None:
        few = structure.n_dofs <= FEW_DOFS
        if few and structure.comm.size == 1:
            return None
        table = Reduction("free_interface" if few else None)
    if table.method == "off":
        return None
    kept = scene.damping.modes if table.modes is None else table.modes
    if isinstance(kept, str):  # "all"
        kept = min(MODES, structure.n_dofs)
        table = replace(table, modes=kept)
    if table.method is None:
        lips = structure.n_pairs > 0 and kept < structure.n_dofs
        table = replace(table, method="massless" if lips else "free_interface")
    return table


def check_memory_of(scene: Scene, structure: Structure) -> float:
    """Memory that solving a scene is going to need, estimated [byte] (collective).

    Raises
    ------
    InputError
        This machine has not so much.
    """
    table = reduction_of(scene, structure)
    if table is None:
        needed = whole_memory(structure, scene.harmonic_balance.harmonics)
    else:
        assert table.method is not None
        needed = reduction_memory(structure, _modes(scene, table), table.method)
    machine = machine_memory()
    if needed > SHARE * machine:
        key = {"grid": "columns", "file": "file"}.get(scene.mesh.layout, "size")
        allowed = (
            f"that of a coarser mesh: {structure.n_dofs} degrees of freedom need "
            f"{needed / 2**30:.3g} GiB of this machine's {machine / 2**30:.3g}"
        )
        raise InputError(f"mesh.{key}", getattr(scene.mesh, key), allowed)
    return needed


def _modes(scene: Scene, table: Reduction) -> int:
    return int(scene.damping.modes if table.modes is None else table.modes)


def law_of(scene: Scene, structure: Structure) -> ContactLaw | None:
    """The contact law of a scene's pairs; None if there are no pairs."""
    if structure.n_pairs == 0 or scene.contact is None:
        return None
    return contact_law(scene.contact, structure)


def contact_law(contact: Contact, structure: Structure | None = None) -> ContactLaw:
    """The law that a scene's contact table describes.

    A stiffness per area [N/m^3] becomes that of each pair [N/m] by the structure's ``pair_areas``,
    so that refining the mesh does not change the physics.

    Raises
    ------
    InputError
        There is a stiffness per area, and no structure with areas.
    """
    if not isinstance(contact, Contact):
        raise InputError("contact", contact, "the contact table of a scene")
    if contact.law == "unilateral":
        return UnilateralConstraint()
    stiffness: float | np.ndarray | None = contact.stiffness
    if contact.stiffness_per_area is not None:
        if structure is None or structure.pair_areas is None:
            allowed = (
                "used with a structure made from a mesh: contact_law(scene.contact, structure)"
            )
            raise InputError("contact.stiffness_per_area", contact.stiffness_per_area, allowed)
        stiffness = contact.stiffness_per_area * structure.pair_areas
    assert stiffness is not None
    if contact.law == "smoothed":
        assert contact.sharpness is not None
        return SmoothedPenalty(stiffness, contact.sharpness)
    return UnilateralPenalty(stiffness)
