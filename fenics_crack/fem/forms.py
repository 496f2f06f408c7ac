"""A structure from UFL forms of one's own on a mesh of DOLFINx.

The program assembles them, leaves out the dofs that Dirichlet conditions hold, and pairs the nodes
of crack faces as those of its own meshes (:mod:`fenics_crack.fem.build`). These faces are two sets
of exterior facets in the same places, which share the nodes of tips and fronts and no other.
"""

from __future__ import annotations

from dataclasses import replace
from operator import index
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.basics.errors import InputError, check_number, reading
from fenics_crack.basics.ranks import collect_garbage, gather_rows, on_each
from fenics_crack.fem import compat
from fenics_crack.fem.build import pair_crack_faces
from fenics_crack.fem.compat import dolfinx
from fenics_crack.fem.cracks import LIP_TAGS, find_crack_paths, find_crack_surfaces
from fenics_crack.fem.elasticity import constants
from fenics_crack.fem.plate import Dofs, PlateMesh

CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")
LOADS = ("loads.mean", "loads.sin", "loads.cos")
"""Parts of a load, in the order in which their forms are given."""


def parts_of_forms(
    space: Any, bilinear: dict[str, Any], bcs: Any, loads: Any, crack: Any, thickness: float
) -> tuple[Any, ...]:
    """Return what :meth:`Structure.from_matrices` takes by its names, the matrices to be destroyed,
    and the nodes and pairs, of what :meth:`Structure.from_forms` is given (collective)."""
    _check_space(space)
    check_number("thickness", thickness, 0.0, above=True)
    with reading("loads", type(loads).__name__, "(mean, sin, cos), linear forms or None"):
        linear = zip(LOADS, (None,) * 3 if loads is None else loads, strict=True)
        forms = bilinear | {key: form for key, form in linear if form is not None}
    for key, form in forms.items():
        _check_form(space, key, form, 2 if key in bilinear else 1)
    comm = space.mesh.comm  # which goes with the mesh
    alike, lasting = (MPI.IDENT, MPI.CONGRUENT), (MPI.COMM_WORLD, MPI.COMM_SELF)
    comm = next((other for other in lasting if MPI.Comm.Compare(other, comm) in alike), comm)
    collect_garbage(comm)  # of structures made before
    held = on_each(comm, lambda: compat.constrained_dofs(space, bcs))
    try:
        dofs = Dofs(_plate(space.mesh, crack, comm), space, comm, held)
        gap, tangential, pairs = pair_crack_faces(dofs, constants(space, thickness)[0])
    except InputError as error:
        raise InputError("crack", error.value, error.allowed) from None
    parts: dict[str, Any] = {
        name: sparse.vstack(comm.allgather(rows)) if gap.shape[1] and rows is not None else None
        for name, rows in (("gap", gap), ("tangential", tangential))
    }
    for key, form in forms.items():
        with reading(key, "a form", "one that DOLFINx can assemble"):
            if key in bilinear:
                parts[key] = dofs.free_block(compat.assembled_matrix(form))
            else:
                part = dofs.free_part(compat.assembled_vector(form))
                parts[key.replace("loads.", "force_")] = gather_rows(comm, part)
    return parts, dofs.nodes(), pairs


def _check_space(space: Any) -> None:
    """Raise InputError unless a structure can have the displacements of a space."""
    allowed = "vectors of the mesh's dimension (of a plate gdim = 2), Lagrange of order 1 or 2"
    with reading("space", type(space).__name__, f"{allowed}, whole"):
        mesh, element = space.mesh, space.ufl_element()
        fits = mesh.topology.cell_type.name in CELLS and mesh.geometry.dim == mesh.topology.dim
        fits = fits and element in [compat.lagrange_element(mesh, order) for order in (1, 2)]
        if not fits or len(space.component()):
            raise ValueError(str(element))


def _check_form(space: Any, key: str, form: Any, rank: int) -> None:
    """Raise InputError unless a form is linear, or bilinear, on a space."""
    with reading(key, type(form).__name__, f"a {'bi' * (rank - 1)}linear form of UFL on the space"):
        same = [argument.ufl_function_space() == space for argument in form.arguments()]
        if len(same) != rank or not all(same):
            raise ValueError(f"it has {len(same)} arguments, {sum(same)} of them on the space")


def _plate(mesh: Any, crack: Any, comm: MPI.Comm) -> PlateMesh:
    """A mesh with the faces of its cracks (collective)."""
    if crack is None:
        return PlateMesh(mesh, None, {}, {}, ())
    allowed = "(facet_tags, lower, upper): tags of facets of the space's mesh, and two of them"
    with reading("crack", type(crack).__name__, allowed):
        tags, *sides = crack
        lower, upper = map(index, sides)
        if lower == upper or not compat.are_facet_tags_of(tags, mesh):
            raise ValueError("of another mesh, of other entities, or one tag twice")
    plate = PlateMesh(mesh, tags, {LIP_TAGS[0]: (lower,), LIP_TAGS[1]: (upper,)}, {}, ())
    faces = [_face(plate, name, comm) for name in LIP_TAGS]
    numbers, places = (np.concatenate(part) for part in zip(*faces, strict=True))
    _, first, which = np.unique(numbers, return_index=True, return_inverse=True)
    corners = np.split(which.reshape(numbers.shape), [len(faces[0][0])])
    find: Any = find_crack_paths if mesh.topology.dim == 2 else find_crack_surfaces
    return replace(plate, cracks=find(*corners, places.reshape(-1, places.shape[2])[first]))


def _face(plate: PlateMesh, name: str, comm: MPI.Comm) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (n, k) of the corners of the facets of a face, and their positions (n, k, d) [m]
    (collective)."""
    mesh, topology, facets = plate.mesh, plate.mesh.topology, plate.facets(name)
    facets = facets[facets < topology.index_map(topology.dim - 1).size_local]
    corners = compat.facet_corners(mesh, facets)
    inside = np.setdiff1d(facets, dolfinx.mesh.exterior_facet_indices(topology))
    every, wrong = comm.allreduce(np.array([len(facets), len(inside)]))
    if every == 0 or wrong:
        shown = f"{every} facets of tag {plate.groups[name][0]}, {wrong} of them inside the mesh"
        raise InputError("crack", shown, "two faces of exterior facets, with a cell on one side")
    numbers = mesh.geometry.index_map().local_to_global(corners.ravel().astype(np.int32))
    places = mesh.geometry.x[corners][..., : topology.dim]
    return gather_rows(comm, np.reshape(numbers, corners.shape)), gather_rows(comm, places)
