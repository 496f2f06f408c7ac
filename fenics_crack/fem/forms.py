"""Make a structure from UFL forms on a mesh of DOLFINx.

The program assembles the user's forms, and leaves out dofs held by Dirichlet conditions. It pairs
the nodes of crack faces as on its own meshes (:mod:`fenics_crack.fem.build`). Crack faces are two
sets of exterior facets at the same positions. They share the nodes at tips and fronts, and no
others.
"""

from __future__ import annotations

from dataclasses import replace
from operator import index
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.basics.errors import InputError, check_number, report_read_errors
from fenics_crack.basics.ranks import call_on_each_rank, collect_garbage, gather_rows
from fenics_crack.fem import compat
from fenics_crack.fem.build import pair_crack_faces
from fenics_crack.fem.compat import dolfinx
from fenics_crack.fem.cracks import CRACK_FACE_NAMES, find_crack_paths, find_crack_surfaces
from fenics_crack.fem.elasticity import form_constants
from fenics_crack.fem.plate import Dofs, MeshWithNamedParts
from fenics_crack.model.structure import DampingRule, Structure

CELL_TYPE_NAMES = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")
"""Allowed cells of a mesh, by DOLFINx's names."""
LOAD_KEYS = ("loads.mean", "loads.sin", "loads.cos")
"""Keys for errors of the three parts in the argument ``loads``, in order."""


def structure_from_forms(
    space: Any,
    stiffness: Any,
    mass: Any,
    *,
    bcs: Any = (),
    loads: Any = None,
    crack: Any = None,
    thickness: float = 1.0,
    clearance: Any = 0.0,
    damping: Any = None,
) -> Structure:
    """Make a structure from UFL forms on a mesh of DOLFINx (collective).

    Parameters
    ----------
    space : dolfinx.fem.FunctionSpace
        Space of displacements: vectors, Lagrange elements of order 1 or 2, on a plane or solid
        mesh.
    stiffness, mass : ufl.Form
        Symmetric bilinear forms on the space, without boundary conditions. The mass must be
        positive definite, the stiffness semidefinite. A plate's forms include the thickness.
    bcs : list of dolfinx.fem.DirichletBC
        Boundary conditions with value zero, on the space or on components.
    loads : (mean, sin, cos) or None
        Linear forms for the load's mean, sine and cosine part; None for a zero part or no load.
    crack : (facet_tags, lower, upper) or None
        Tags of the mesh's facets, and the tags of the lower and the upper faces of all cracks. Both
        faces have exterior facets at the same positions, and share nodes only at tips and fronts.
    thickness : float [m]
        A plate's thickness, for the areas of contact pairs.
    clearance : float or (n_pairs,) [m]
        Clearance g_0 of the contact pairs; negative: a preload.
    damping : ModalDamping, RayleighDamping, ufl.Form or None
        Modal or Rayleigh damping, or a bilinear form for the damping matrix C.

    Returns
    -------
    Structure
        Structure on the mesh's ranks.

    Raises
    ------
    InputError
        The space, a condition, a form or the tags do not fit this description. Or the nodes of both
        crack faces do not match, or :meth:`Structure.from_matrices` refuses a matrix.

    Examples
    --------
    >>> import ufl
    >>> space = structure.nodes.dolfinx_mesh_and_dofs.space
    >>> u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    >>> stiffness = 2e9 * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    >>> free = fc.structure_from_forms(space, stiffness, 7800.0 * ufl.inner(u, v) * ufl.dx)
    """
    bilinear_forms = {"stiffness": stiffness, "mass": mass}
    if not isinstance(damping, DampingRule | None):
        bilinear_forms["damping"] = damping
    parts_by_name, *nodes_and_pairs = _assemble_parts_and_places(
        space, bilinear_forms, bcs, loads, crack, thickness
    )
    structure = Structure.from_matrices(**{"damping": damping} | parts_by_name, clearance=clearance)
    for key in bilinear_forms:
        parts_by_name[key].destroy()
    return structure.with_places(*nodes_and_pairs)


def _assemble_parts_and_places(
    space: Any, bilinear_forms: dict[str, Any], bcs: Any, loads: Any, crack: Any, thickness: float
) -> tuple[Any, ...]:
    """Assemble matrices, loads, gaps, nodes and contact pairs from UFL forms (collective).

    Parameters
    ----------
    space : dolfinx.fem.FunctionSpace
        Space of displacements.
    bilinear_forms : dict of str to ufl.Form
        Forms by name: "stiffness", "mass" and, if given, "damping".
    bcs : list of dolfinx.fem.DirichletBC
        Boundary conditions with value zero.
    loads : (mean, sin, cos) or None
        Linear forms for the load's mean, sine and cosine part; None for a zero part or no load.
    crack : (facet_tags, lower, upper) or None
        Tags of the mesh's facets, and the tags of the lower and the upper crack faces.
    thickness : float [m]
        A plate's thickness, for the areas of contact pairs.

    Returns
    -------
    parts_by_name : dict
        Arguments for :meth:`Structure.from_matrices`, by name. The caller destroys the PETSc
        matrices.
    nodes : Nodes
        This rank's nodes and cells.
    pairs : Pairs
        Positions, areas and crack of each contact pair.
    """
    _check_space(space)
    check_number("thickness", thickness, 0.0, excludes_bound=True)
    with report_read_errors(
        "loads", str(loads)[:60], "three entries (mean, sin, cos), each a linear form or None"
    ):
        load_key_form_pairs = zip(LOAD_KEYS, (None,) * 3 if loads is None else loads, strict=True)
        forms_by_key = bilinear_forms | {
            key: form for key, form in load_key_form_pairs if form is not None
        }
    for key, form in forms_by_key.items():
        _check_form(space, key, form, 2 if key in bilinear_forms else 1)
    comm = space.mesh.comm  # it ends with the mesh, so use an equivalent one that lasts
    equal_comm_codes, lasting_comms = (MPI.IDENT, MPI.CONGRUENT), (MPI.COMM_WORLD, MPI.COMM_SELF)
    comm = next(
        (
            lasting_comm
            for lasting_comm in lasting_comms
            if MPI.Comm.Compare(lasting_comm, comm) in equal_comm_codes
        ),
        comm,
    )
    collect_garbage(comm)  # free the matrices of earlier structures
    is_constrained = call_on_each_rank(comm, lambda: compat.constrained_dof_mask(space, bcs))
    try:
        dofs = Dofs(
            _make_part_mesh_from_facet_tags(space.mesh, crack, comm), space, comm, is_constrained
        )
        gap_matrix, tangential_matrix, pairs = pair_crack_faces(
            dofs, form_constants(space, thickness)[0]
        )
    except InputError as error:
        raise InputError("crack", error.value, error.allowed) from None
    parts_by_name: dict[str, Any] = {
        matrix_name: sparse.vstack(comm.allgather(rank_matrix_rows))
        if gap_matrix.shape[1] and rank_matrix_rows is not None
        else None
        for matrix_name, rank_matrix_rows in (
            ("gap", gap_matrix),
            ("tangential", tangential_matrix),
        )
    }
    for key, form in forms_by_key.items():
        with report_read_errors(key, type(form).__name__, "a form that DOLFINx can assemble"):
            if key in bilinear_forms:
                parts_by_name[key] = dofs.restrict_matrix(compat.assembled_petsc_matrix(form))
            else:
                load_values = dofs.restrict_to_free(compat.assembled_vector(form))
                parts_by_name[key.replace("loads.", "force_")] = gather_rows(comm, load_values)
    return parts_by_name, dofs.make_node_data(), pairs


def _check_space(space: Any) -> None:
    """Raise InputError unless a space is allowed for displacements.

    Allowed are vectors with the mesh's dimension, Lagrange elements of order 1 or 2, and no
    subspace.
    """
    requirement = (
        "a vector-valued Lagrange space of order 1 or 2, not a subspace, with a component"
        " for each dimension of the mesh (of a plate gdim = 2)"
    )
    with report_read_errors("space", type(space).__name__, requirement):
        mesh, element = space.mesh, space.ufl_element()
        is_usable = (
            mesh.topology.cell_type.name in CELL_TYPE_NAMES
            and mesh.geometry.dim == mesh.topology.dim
        )
        is_usable = is_usable and element in [
            compat.lagrange_element(mesh, order) for order in (1, 2)
        ]
        if not is_usable or len(space.component()):
            raise ValueError(str(element))


def _check_form(space: Any, key: str, form: Any, n_arguments: int) -> None:
    """Raise InputError unless ``form`` is a UFL form with ``n_arguments`` arguments.

    A linear form has 1 argument, a bilinear form 2. All arguments must be on the function space
    ``space``. The error names ``key``, as "stiffness".
    """
    with report_read_errors(
        key,
        type(form).__name__,
        f"a {'bi' * (n_arguments - 1)}linear form of UFL on the function space",
    ):
        is_on_space = [argument.ufl_function_space() == space for argument in form.arguments()]
        if len(is_on_space) != n_arguments or not all(is_on_space):
            raise ValueError(
                f"test and trial functions: {len(is_on_space)}, on this space: {sum(is_on_space)}, "
                f"needed: {n_arguments}"
            )


def _make_part_mesh_from_facet_tags(mesh: Any, crack: Any, comm: MPI.Comm) -> MeshWithNamedParts:
    """Return a user's mesh, with cracks found from the tags (collective).

    ``crack`` is (facet_tags, lower, upper): tags of the mesh's facets, the tag of all lower faces,
    and the tag of all upper faces. None: no cracks.
    """
    if crack is None:
        return MeshWithNamedParts(mesh, None, {}, {}, ())
    requirement = (
        "(facet_tags, lower, upper): facet tags of the space's mesh, and the tags of both"
        " crack faces"
    )
    with report_read_errors("crack", type(crack).__name__, requirement):
        facet_tags, *lower_and_upper_tags = crack
        lower_tag, upper_tag = map(index, lower_and_upper_tags)
        if lower_tag == upper_tag or not compat.are_facet_tags_of(facet_tags, mesh):
            raise ValueError("facet_tags are not of facets of this mesh, or lower = upper")
    part_mesh = MeshWithNamedParts(
        mesh,
        facet_tags,
        {CRACK_FACE_NAMES[0]: (lower_tag,), CRACK_FACE_NAMES[1]: (upper_tag,)},
        {},
        (),
    )
    node_numbers_and_positions_by_face = [
        _find_corner_numbers_and_positions(part_mesh, face_name, comm)
        for face_name in CRACK_FACE_NAMES
    ]
    face_node_numbers, face_node_positions = (
        np.concatenate(arrays_of_both_faces)
        for arrays_of_both_faces in zip(*node_numbers_and_positions_by_face, strict=True)
    )
    _, first_occurrence_index, node_index = np.unique(
        face_node_numbers, return_index=True, return_inverse=True
    )
    face_corner_nodes = np.split(
        node_index.reshape(face_node_numbers.shape), [len(node_numbers_and_positions_by_face[0][0])]
    )
    find_paths_or_surfaces: Any = (
        find_crack_paths if mesh.topology.dim == 2 else find_crack_surfaces
    )
    return replace(
        part_mesh,
        crack_paths_or_surfaces=find_paths_or_surfaces(
            *face_corner_nodes,
            face_node_positions.reshape(-1, face_node_positions.shape[2])[first_occurrence_index],
        ),
    )


def _find_corner_numbers_and_positions(
    part_mesh: MeshWithNamedParts, face_name: str, comm: MPI.Comm
) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of all facets on the lower or upper crack faces (collective).

    ``face_name`` is "lower_lip" or "upper_lip". InputError without facets, or for facets inside the
    mesh.

    Returns
    -------
    numbers : (n, k) int
        Global node numbers of each facet's corners.
    positions : (n, k, d) [m]
        Positions of the corners.
    """
    mesh, topology, facets = part_mesh.mesh, part_mesh.mesh.topology, part_mesh.facets(face_name)
    facets = facets[facets < topology.index_map(topology.dim - 1).size_local]
    corners = compat.facet_corner_nodes(mesh, facets)
    inner_facets = np.setdiff1d(facets, dolfinx.mesh.exterior_facet_indices(topology))
    n_facets, n_inner_facets = comm.allreduce(np.array([len(facets), len(inner_facets)]))
    if n_facets == 0 or n_inner_facets:
        problem = (
            f"{n_facets} facets of tag {part_mesh.tags_by_group[face_name][0]}, {n_inner_facets} "
            "of them"
            " inside the mesh"
        )
        raise InputError("crack", problem, "two tags of boundary facets, with a cell on one side")
    numbers = mesh.geometry.index_map().local_to_global(corners.ravel().astype(np.int32))
    positions = mesh.geometry.x[corners][..., : topology.dim]
    return gather_rows(comm, np.reshape(numbers, corners.shape)), gather_rows(comm, positions)
