"""A structure from UFL forms of one's own on a mesh of DOLFINx.

The program assembles them, leaves out the dofs that Dirichlet conditions hold, and pairs the nodes
of crack faces as those of its own meshes (:mod:`fenics_crack.fem.build`). These faces are two sets
of exterior facets in the same places, which share the nodes of tips and fronts and no other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.basics.errors import InputError, check_number, reading
from fenics_crack.basics.ranks import collect_garbage, gather_rows, on_each
from fenics_crack.fem import compat
from fenics_crack.fem.build import LIPS, pair_lips
from fenics_crack.fem.compat import dolfinx, ufl
from fenics_crack.fem.crack_surface import Lips, cracks_between
from fenics_crack.fem.elasticity import constants
from fenics_crack.fem.lips import find_lips
from fenics_crack.fem.plate import Dofs, PlateMesh
from fenics_crack.model.matrices import checked, petsc_matrix
from fenics_crack.model.structure import DampingRule, Structure

CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")
PARTS = ("mean", "sin", "cos")
"""Parts of a load, in the order in which their forms are given."""


def structure_of_forms(
    space: Any,
    stiffness: Any,
    mass: Any,
    bcs: Any,
    loads: Any,
    crack: Any,
    thickness: float,
    clearance: Any,
    damping: Any,
) -> Structure:
    """Return the structure of :meth:`Structure.from_forms` (collective)."""
    _check_space(space)
    check_number("thickness", thickness, 0.0, above=True)
    bilinear = {"stiffness": stiffness, "mass": mass}
    if not isinstance(damping, DampingRule | None):
        bilinear["damping"] = damping
    linear = _parts(loads)
    for key, form in (bilinear | linear).items():
        _check_form(space, key, form, 2 if key in bilinear else 1)
    comm = _communicator(space.mesh.comm)
    collect_garbage(comm)  # of structures made before
    held = on_each(comm, lambda: _held(space, bcs))
    try:
        dofs = Dofs(_plate(space, crack, comm), space, comm, held)
        gap, tangential, pairs = pair_lips(dofs, constants(space, thickness)[0])
    except InputError as error:
        raise InputError("crack", error.value, error.allowed) from None
    if not comm.allreduce(len(dofs.free)):
        raise InputError("bcs", "all dofs", "conditions that leave some of them free")
    matrices, forces = {}, dict.fromkeys(("loads.mean", "loads.cos", "loads.sin"))
    for key, form in (linear | bilinear).items():
        with reading(key, "a form", "one that DOLFINx can assemble"):
            if key in linear:
                own = compat.assembled_vector(form)[dofs.free]
                forces[key] = gather_rows(comm, own)  # type: ignore[assignment]
            else:
                matrices[key] = dofs.free_block(compat.assembled_matrix(form))
    every = sparse.vstack(comm.allgather(gap)) if gap.shape[1] else None
    parts = checked(matrices["mass"], matrices["stiffness"], every, forces, clearance, comm)
    if "damping" in matrices:
        damping = petsc_matrix("damping", matrices["damping"], comm)
    for matrix in matrices.values():
        matrix.destroy()
    made = Structure(**parts, damping=damping, nodes=dofs.nodes(), pairs=pairs)
    return made.with_tangents(tangential)


def _communicator(comm: MPI.Comm) -> MPI.Comm:
    """All ranks, or this one alone, by the communicators that do not go with a mesh."""
    alike = MPI.IDENT, MPI.CONGRUENT
    lasting = (MPI.COMM_WORLD, MPI.COMM_SELF)
    return next((one for one in lasting if MPI.Comm.Compare(one, comm) in alike), comm)


def _check_space(space: Any) -> None:
    """Raise InputError unless a structure can have the displacements of a space."""
    fits, shown = isinstance(space, dolfinx.fem.FunctionSpace), type(space).__name__
    if fits:
        mesh, shown = space.mesh, str(space.ufl_element())
        fits = mesh.topology.cell_type.name in CELLS and not len(space.component())
        fits &= mesh.geometry.dim == mesh.topology.dim > 1
        fits = fits and space.ufl_element() in [compat.element(mesh, order) for order in (1, 2)]
    if not fits:
        allowed = (
            "a space of vectors of DOLFINx, Lagrange elements of order 1 or 2 with as many "
            f"components as the mesh has dimensions, not part of another, on one of {CELLS}"
        )
        raise InputError("space", shown, allowed)


def _parts(loads: Any) -> dict[str, Any]:
    """The forms of a load by their names."""
    if loads is None:
        return {}
    if not isinstance(loads, list | tuple) or len(loads) != len(PARTS):
        allowed = "(mean, sin, cos): each a linear form, or None"
        raise InputError("loads", type(loads).__name__, allowed)
    named = zip(PARTS, loads, strict=True)
    return {f"loads.{name}": form for name, form in named if form is not None}


def _check_form(space: Any, key: str, form: Any, rank: int) -> None:
    """Raise InputError unless a form is linear, or bilinear, on a space."""
    if isinstance(form, ufl.Form):
        with reading(key, "a form", "one that UFL understands"):
            spaces = [argument.ufl_function_space() for argument in form.arguments()]
        if len(spaces) == rank and all(other == space for other in spaces):
            return
        form = f"a form of {len(spaces)} arguments, {sum(o == space for o in spaces)} on the space"
    kind = ("linear form, with a test function", "bilinear form, with a trial and a test function")
    shown = form if isinstance(form, str) else type(form).__name__
    raise InputError(key, shown, f"a {kind[rank - 1]} of UFL on the space")


def _held(space: Any, bcs: Any) -> np.ndarray:
    """This rank's dofs that Dirichlet conditions hold: (n_dofs,) bool."""
    allowed = "a list of DOLFINx's Dirichlet conditions on the space, of value zero"
    if not isinstance(bcs, list | tuple):
        raise InputError("bcs", type(bcs).__name__, allowed)
    with reading("bcs", "conditions", allowed):
        return compat.held_dofs(space, bcs)


def _plate(space: Any, crack: Any, comm: MPI.Comm) -> PlateMesh:
    """The mesh of a space, with the faces of its cracks (collective)."""
    mesh = space.mesh
    if crack is None:
        return PlateMesh(mesh, None, {}, {}, ())
    allowed = (
        "(facet_tags, lower, upper): tags of facets of the space's mesh, and those of the two "
        "faces, different whole numbers"
    )
    given = isinstance(crack, list | tuple) and len(crack) == 3 and compat.is_on(crack[0], mesh)
    if not given or not all(type(tag) is int for tag in crack[1:]) or crack[1] == crack[2]:
        shown = crack[1:] if given else type(crack).__name__
        raise InputError("crack", shown, allowed)
    groups: dict[str, tuple[int, ...]] = {LIPS[0]: (crack[1],), LIPS[1]: (crack[2],)}
    plate = PlateMesh(mesh, crack[0], groups, {}, ())
    sides = [_face(plate, name, comm) for name in LIPS]
    numbers, places = (np.concatenate(part) for part in zip(*sides, strict=True))
    _, first, which = np.unique(numbers, return_index=True, return_inverse=True)
    places = places.reshape(-1, places.shape[2])[first]
    lower, upper = np.split(which.reshape(numbers.shape), [len(sides[0][0])])
    find = find_lips if mesh.topology.dim == 2 else cracks_between
    lips: Lips = find(lower, upper, places)
    return PlateMesh(mesh, crack[0], groups, {}, lips)


def _face(plate: PlateMesh, name: str, comm: MPI.Comm) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (n, k) of the corners of the facets of a face, and their positions (n, k, d) [m]
    (collective)."""
    mesh, facets = plate.mesh, plate.facets(name)
    topology, tag = mesh.topology, plate.groups[name][0]
    facets = facets[facets < topology.index_map(topology.dim - 1).size_local]
    corners = compat.facet_corners(mesh, facets)
    inside = np.setdiff1d(facets, dolfinx.mesh.exterior_facet_indices(topology))
    every, wrong = comm.allreduce(np.array([len(facets), len(inside)]))
    if every == 0 or wrong:
        shown = f"tag {tag} of {every} facets" + f", {wrong} of them inside" * bool(wrong)
        allowed = "two faces of exterior facets, with a cell on one side: an opening of the mesh"
        raise InputError("crack", shown, allowed)
    numbers = mesh.geometry.index_map().local_to_global(corners.ravel().astype(np.int32))
    numbers = np.asarray(numbers).reshape(corners.shape)
    places = mesh.geometry.x[corners][..., : topology.dim]
    return gather_rows(comm, numbers), gather_rows(comm, places)
