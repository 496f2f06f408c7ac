"""The structure that a scene asks for: crack length found, reduced as it says; and its law."""

from __future__ import annotations

from mpi4py import MPI

from fenics_crack.compliance import is_small
from fenics_crack.contact import ContactLaw, UnilateralConstraint, contact_law
from fenics_crack.finite_elements import build_structure, find_crack_length
from fenics_crack.reduction import reduce_structure
from fenics_crack.scene import Scene
from fenics_crack.structure import Structure

__all__ = ["law_of", "prepare", "with_crack_length"]


def with_crack_length(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Scene:
    """Return the scene with the length found from ``crack.first_omega``, if that is given."""
    if scene.crack is None or scene.crack.first_omega is None:
        return scene
    length = find_crack_length(scene, comm)
    return scene.replace({"crack.length": length, "crack.first_omega": None})


def prepare(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Structure:
    """Build the structure of a scene and reduce it as its table ``[reduction]`` says (collective).

    Without the table a small structure on one rank is left as it is, any other is reduced.

    Raises
    ------
    InputError
        As :func:`build_structure` and :func:`reduce_structure`.
    """
    structure = build_structure(scene, comm)
    table = scene.reduction
    if table is None:
        return structure if is_small(structure) else reduce_structure(structure)
    if table.method == "none":
        return structure
    return reduce_structure(structure, modes=table.modes, method=table.method)


def law_of(scene: Scene, structure: Structure) -> ContactLaw | UnilateralConstraint | None:
    """The contact law of a scene's pairs; None where there are none."""
    if structure.n_pairs == 0 or scene.contact is None:
        return None
    return contact_law(scene.contact, structure)
