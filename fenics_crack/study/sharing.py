"""One structure for scenes of one mesh: what the last of them has computed serves the next.

What is kept is the last structure with all that hangs on it, the coarser mesh among it, and it is
let go before another mesh is made. Frequencies, laws, harmonics, modes and what is requested of
results do not change it; another load, damping or clearance of a plate or solid at rest shares its
matrices. Files count by their content: a copy may keep the time of a file that it replaces, and
times are coarse.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any, NamedTuple

from mpi4py import MPI

from fenics_crack.basics.observables import QUANTITIES
from fenics_crack.basics.ranks import on_root
from fenics_crack.fem.setting import clearance_of, damping_rule_of
from fenics_crack.files.store import digests_of
from fenics_crack.model.body import DEFAULT_SETTING
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene


class Made(NamedTuple):
    """A structure and what it was made of: parts that mesh and matrices depend on, loads, and the
    rest."""

    structure: Structure
    comm: MPI.Comm
    parts: tuple[Any, Any, Any]


LAST: list[Made] = []
"""The structure made last in this process, alone."""


def kept(structure: Structure) -> list[Made]:
    """Return the place for structures of coarser meshes."""
    return []


SHELVES: list[Any] = []
"""Where a command keeps its structure (:class:`fenics_crack.study.shelf.Shelf`), or nothing."""


def assembled(scene: Scene, comm: MPI.Comm, last: list[Made] = LAST) -> Structure:
    """Return the structure of a scene whose crack length is known (collective).

    The last structure, or the structure in a file, is used if it has the same mesh. The result is
    the new entry in ``last``.

    Parameters and errors are those of :func:`fenics_crack.build_structure`.
    """
    parts = parts_shared(scene, comm)
    bound = scene.speed > 0.0 or scene.disk is not None or scene.structure is not None
    shelves = [] if (  # what is integrated over a mesh of DOLFINx needs one
        bound or last is not LAST or scene.geometry.file is not None
        or any(QUANTITIES[name].of.on_request for name in scene.quantities or ())
    ) else SHELVES  # fmt: skip
    if not comm.allreduce(bool(last) and _fits(last[0], parts, comm, bound), MPI.LAND):
        last.clear()
        last += [made for shelf in shelves if (made := shelf.take(scene, comm)) is not None]
    if not last:
        from fenics_crack.fem.build import assemble_structure  # DOLFINx

        last.append(Made(assemble_structure(scene, comm), comm, parts))
    elif (known := last[0]).parts != parts:
        pairs = known.structure.pairs
        changes = {
            "clearance": clearance_of(scene, pairs),
            "damping": damping_rule_of(scene.damping),
        }
        if known.parts[1] != parts[1]:
            from fenics_crack.fem.build import assemble_load_fields

            changes |= assemble_load_fields(scene, known.structure)
        last[:] = [Made(known.structure._in_setting(DEFAULT_SETTING, **changes), comm, parts)]
    for shelf in shelves:
        shelf.note(last[0], scene)
    return last[0].structure


def _fits(entry: Made, parts: tuple[Any, Any, Any], comm: MPI.Comm, bound: bool) -> bool:
    """Return True if a structure is of the same mesh and ranks; of all the same if ``bound``, of
    the same loads if it has no mesh for others. One of a shelf serves its command alone."""
    parts_match = getattr(entry.structure.nodes, "mesh_dofs", None) is not None
    same_ranks = MPI.Comm.Compare(entry.comm, comm) in (MPI.IDENT, MPI.CONGRUENT)
    is_served = parts_match or bool(SHELVES) or not entry.structure.has_matrices
    is_match = (
        entry.parts[0] == parts[0] and (parts_match or entry.parts[1] == parts[1]) and is_served
    )
    return (entry.comm == comm if parts_match else same_ranks) and (
        entry.parts == parts if bound else is_match
    )


def parts_shared(scene: Scene, comm: MPI.Comm) -> tuple[Any, Any, Any]:
    """Of the keys of a scene, what mesh and matrices depend on; its loads; clearances and
    damping."""
    cracks = [*scene.all_cracks.values()]
    contact = scene.contact is not None and scene.contact.pairs
    matrices = (
        scene.geometry, scene.material, _without(scene.mesh, "error", "coarser"), contact,
        [_without(crack, "clearance") for crack in cracks], scene.rotation, scene.disk,
        scene.structure, on_root(comm, lambda: digests_of(scene)),
    )  # fmt: skip
    return matrices, loads_of(scene), ([crack.clearance for crack in cracks], scene.damping)


def loads_of(scene: Scene) -> tuple[Any, ...]:
    """Of the keys of a scene, what its loads depend on."""
    return _without(scene.excitation, "omega", "frequency"), scene.loads, scene.base


def _without(table: Any, *names: str) -> Any:
    """Values of a table but those of some keys; None without the table."""
    return table and {
        item.name: getattr(table, item.name) for item in fields(table) if item.name not in names
    }
