"""The structure that a scene asks for: crack length found, reduced as it says; and its law."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

from fenics_crack.contact import ContactLaw, UnilateralConstraint, contact_law
from fenics_crack.finite_elements import build_structure, find_crack_length
from fenics_crack.reduction import reduce_structure
from fenics_crack.scene import Reduction, Scene
from fenics_crack.structure import ModalDamping, Structure

__all__ = ["law_of", "prepare", "reduction_of", "with_crack_length"]

FEW_DOFS = 100
"""So many need no reduction."""
MODES = 50


def with_crack_length(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Scene:
    """Return the scene with the length found from ``crack.first_omega``, if that is given."""
    if scene.crack is None or scene.crack.first_omega is None:
        return scene
    length = find_crack_length(scene, comm)
    return scene.replace({"crack.length": length, "crack.first_omega": None})


def prepare(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Structure:
    """Build the structure of a scene and reduce it as :func:`reduction_of` says (collective).

    Raises
    ------
    InputError
        As :func:`build_structure` and :func:`reduce_structure`.
    """
    structure = build_structure(scene, comm)
    table = reduction_of(scene, structure)
    if table is None:
        return structure
    if scene.damping.modes == "all" and isinstance(scene.damping.ratio, float):
        # All that are kept: those of a large structure cannot be computed.
        undamped = structure.damped(None)
        reduced = reduce_structure(undamped, modes=table.modes, method=table.method)
        return reduced.damped(ModalDamping(scene.damping.ratio))
    return reduce_structure(structure, modes=table.modes, method=table.method)


def reduction_of(scene: Scene, structure: Structure) -> Reduction | None:
    """How the structure of a scene is reduced; None: not at all.

    Without the table ``[reduction]`` a structure of up to 100 dofs on one rank is left as it is.
    Where all modes are damped and no number of modes is given, 50 are kept.
    """
    table = scene.reduction
    if table is None:
        if structure.comm.size == 1 and structure.n_dofs <= FEW_DOFS:
            return None
        table = Reduction()
    if table.method == "off":
        return None
    if table.modes is None and scene.damping.modes == "all":
        table = replace(table, modes=min(MODES, structure.n_dofs))
    return table


def law_of(scene: Scene, structure: Structure) -> ContactLaw | UnilateralConstraint | None:
    """The contact law of a scene's pairs; None where there are none."""
    if structure.n_pairs == 0 or scene.contact is None:
        return None
    return contact_law(scene.contact, structure)
