"""What a scene asks for: its structure, reduced as it says."""

from __future__ import annotations

from mpi4py import MPI

from fenics_crack.compliance import is_small
from fenics_crack.finite_elements import build_structure
from fenics_crack.reduction import reduce_structure
from fenics_crack.scene import Scene
from fenics_crack.structure import Structure

__all__ = ["prepare"]


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
