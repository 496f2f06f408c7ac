"""Build the structure of a scene: matrices, contact pairs and loads.

DOLFINx assembles the matrices, with sigma and t of :mod:`fenics_crack.fem.elasticity`:

    u^T K v = t int sigma(u) : eps(v) dx,                     u^T M v = t rho int u . v dx.

Clamped dofs are left out, so they cause no spurious modes.

Contact pairs
-------------
The crack faces have gaps g = B^T u. A pair consists of two basis functions psi of a pressure, at
the same position on both faces. Let n be the outward normal of either face. Then the pair's gap g
and area w are

    g = b_lower . u + b_upper . u,        w = t int psi ds.

On a plate, psi_i is the basis function N_i of a node, and b_i gives the node's displacement along
int N_i n ds. On a solid, a quadratic N_i cannot be used: its integral over a triangle vanishes at
corners. So pressures are linear, and b_i gives the mean over a patch:

    b_i . u = 1 / w_i int psi_i n . u ds.

Nodes of tips and fronts have no pair. On a solid, the basis function of a front's node is
distributed to its neighbours on the face. Each share is proportional to the overlap, the integral
of both basis functions' product: psi_j = sum_i S_ij psi_i with sum_j S_ij = 1. So the areas sum to
the crack's area, and a uniform pressure is exact. Also, the pressure acts up to the front, where
closed faces would otherwise interpenetrate.

With ``mesh.patches`` there are fewer pressures, each a weighted sum of linear ones. Nodes of tips
and fronts belong to the nearest patch. On a plate, psi_j is linear between selected nodes. On a
solid, it is the sum for all nodes nearest to a selected node.

Tangential gaps of a solid have two directions t, at right angles to the pair's mean normal m = int
psi n ds / |int psi n ds|:

    b_i . u = 1 / w_i int psi_i (m . n) t . u ds.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.progress import begin_stage
from fenics_crack.basics.ranks import call_on_each_rank, collect_garbage, gather_rows, on_root
from fenics_crack.fem import compat
from fenics_crack.fem.compat import ufl
from fenics_crack.fem.cracks import (
    CRACK_FACE_NAMES,
    RELATIVE_POSITION_TOLERANCE,
    Cracks,
    locate_on_cracks,
    make_matrix_extending_pressures_to_front,
)
from fenics_crack.fem.elasticity import (
    assemble_rotation,
    form_constants,
    stress_expression,
    thickness_constant,
)
from fenics_crack.fem.loads import assemble_loads, make_clamp_for_reactions
from fenics_crack.fem.plate import Dofs, build_plate_or_solid_mesh
from fenics_crack.fem.setting import clearance_of, damping_rule_of
from fenics_crack.model.body import Body
from fenics_crack.model.factor import local_rows
from fenics_crack.model.modes import solve_modes
from fenics_crack.model.nodes import Pairs, format_point
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene


def pair_crack_faces(
    dofs: Dofs, t: Any, *, mouth_only: bool = False, max_patches: int | None = None
) -> tuple[sparse.csr_matrix, sparse.csr_matrix | None, Pairs]:
    """Make contact pairs from nodes at equal positions on both crack faces (collective).

    Pairs are ordered crack by crack. On a plate they run from the mouth to the tip. In a crack
    without a mouth they run from the left to the right tip. On a solid they run from the front to
    the mouth.

    Parameters
    ----------
    dofs : Dofs
        The mesh's free dofs.
    t : ufl expression [m]
        A plate's thickness t, 1 for a solid.
    mouth_only : bool
        True to keep a single pair for each crack: at the mouth, or without a mouth in the middle.
    max_patches : int, optional
        Maximum number of pairs for each crack. Default: a pair for each node, except nodes at tips
        and fronts.

    Returns
    -------
    gap : (n_local, n_pairs)
        Matrix B for normal gaps B^T u with the displacement u. Rows are this rank's free dofs.
    tangential : (n_local, n_pairs) or None
        Matrix B_t for tangential gaps B_t^T u: B with each node's normal turned by a right angle.
        None for a solid, where ``pairs.tangential_gap_matrix`` has two directions per pair.
    pairs : Pairs
        Positions, areas and crack of each pair.

    Raises
    ------
    InputError
        The two faces have different nodes.
    """
    dimension, part_mesh = dofs.dimension, dofs.part_mesh
    if not part_mesh.has_cracks:
        empty_fields = np.zeros((0, dimension)), np.zeros(0), np.zeros(0, dtype=int), np.zeros(0)
        return sparse.csr_matrix((len(dofs.free_dofs), 0)), None, Pairs(*empty_fields)
    assemble_columns = (
        _assemble_nodal_gap_columns
        if dimension == 2 and max_patches is None
        else _assemble_pressure_gap_columns
    )
    both_faces_measure = part_mesh.measure_on(*CRACK_FACE_NAMES)
    pressure_space, node_areas, pressure_gap_columns = assemble_columns(dofs, t, both_faces_measure)
    first_node = pressure_space.dofmap.index_map.local_range[0]
    points = pressure_space.tabulate_dof_coordinates()[:, :dimension]
    node_table_by_face = []
    for face_name in CRACK_FACE_NAMES:
        nodes = dofs.nodes_on(face_name, pressure_space)
        face_node_table = np.column_stack([nodes + first_node, node_areas[nodes], points[nodes]])
        node_table_by_face.append(gather_rows(dofs.comm, face_node_table))
    lower_node_table, upper_node_table, crack_of_pair, distances_on_crack, n_inside = (
        _match_face_nodes(part_mesh.crack_paths_or_surfaces, *node_table_by_face)
    )
    lower_nodes = lower_node_table[:, 0].astype(int)
    lower_gap_matrix = pressure_gap_columns[:, lower_nodes]
    gap_matrix = lower_gap_matrix + pressure_gap_columns[:, upper_node_table[:, 0].astype(int)]
    points = lower_node_table[:, 2:]
    areas = lower_node_table[:, 1]
    if max_patches is not None:
        pair_node_index, pressure_shares = _find_patch_nodes_and_shares(
            points, crack_of_pair, distances_on_crack, n_inside, max_patches
        )
    else:
        pair_node_index, pressure_shares = (
            np.arange(n_inside),
            sparse.eye(len(points), n_inside).tocsr(),
        )
        if dimension == 3:
            pressure_shares = _matrix_distributing_front_pressure(
                dofs, pressure_space, both_faces_measure, lower_nodes, n_inside
            )
        if mouth_only:
            pair_node_index = np.array([*_watched_pair_by_name(
                part_mesh.crack_paths_or_surfaces,
                crack_of_pair[:n_inside], distances_on_crack[:n_inside],
            ).values()])  # fmt: skip
            pressure_shares = pressure_shares[:, pair_node_index]
    nodal_force_shares = sparse.csc_matrix(pressure_shares.multiply(areas[:, None]))
    areas = pressure_shares.T @ areas
    nodal_force_shares.data /= np.repeat(areas, np.diff(nodal_force_shares.indptr))
    gap_matrix, lower_gap_matrix = (
        gap_matrix @ nodal_force_shares,
        lower_gap_matrix @ nodal_force_shares,
    )
    pair_fields_of_solid: dict[str, Any] = (
        {"nodes": points, "pressure_functions_at_nodes": pressure_shares} if dimension == 3 else {}
    )
    points, crack_of_pair, distances_on_crack = (
        node_values[pair_node_index] for node_values in (points, crack_of_pair, distances_on_crack)
    )
    if dimension == 3:
        pair_fields_of_solid["tangential_gap_matrix"] = _free_rows(
            _make_tangential_gap_matrix(gap_matrix, lower_gap_matrix, dofs.comm), dofs
        )
    pairs = Pairs(
        points, areas, crack_of_pair, distances_on_crack,
        _watched_pair_by_name(part_mesh.crack_paths_or_surfaces, crack_of_pair, distances_on_crack),
        **pair_fields_of_solid,
    )  # fmt: skip
    tangential = (
        _free_rows(_rotate_nodal_vectors_90_degrees(gap_matrix), dofs) if dimension == 2 else None
    )
    return _free_rows(gap_matrix, dofs), tangential, pairs


def _matrix_distributing_front_pressure(
    dofs: Dofs, space: Any, both_faces_measure: Any, node_numbers: np.ndarray, n_inside: int
) -> sparse.csr_matrix:
    """Return the matrix S that distributes pressure functions at crack fronts to neighbours.

    A pressure function psi_i distributes the contact force at node i over the crack faces, as a
    pressure. Nodes on fronts have no contact force. So node j off the fronts gets the function
    sum_i S_ij psi_i, with the sum over all nodes i.

    Parameters
    ----------
    dofs : Dofs
        The mesh's dofs.
    space : dolfinx function space
        Space of the functions psi_i.
    both_faces_measure : ufl.Measure
        Measure for integrals over both crack faces.
    node_numbers : (n,) int
        Global numbers of the nodes on a face: first ``n_inside`` nodes off the fronts, then the
        nodes on fronts.
    n_inside : int
        Number of nodes off the fronts.

    Returns
    -------
    (n, n_inside)
        Matrix S, with rows and columns in the order of ``node_numbers``.
    """
    basis_overlap_form = (
        ufl.inner(ufl.TrialFunction(space), ufl.TestFunction(space)) * both_faces_measure
    )
    petsc_basis_overlap_matrix = compat.assembled_petsc_matrix(basis_overlap_form)
    local_basis_overlap_coo = local_rows(petsc_basis_overlap_matrix).tocoo()
    petsc_basis_overlap_matrix.destroy()
    first_node = space.dofmap.index_map.local_range[0]
    basis_overlap_triplets = gather_rows(
        dofs.comm,
        np.column_stack(
            [
                local_basis_overlap_coo.row + first_node,
                local_basis_overlap_coo.col,
                local_basis_overlap_coo.data,
            ]
        ),
    )
    n_global_nodes = space.dofmap.index_map.size_global
    basis_overlap_matrix = sparse.csr_matrix(
        (basis_overlap_triplets[:, 2], basis_overlap_triplets[:, :2].astype(int).T),
        (n_global_nodes, n_global_nodes),
    )
    return make_matrix_extending_pressures_to_front(
        basis_overlap_matrix[node_numbers[n_inside:]][:, node_numbers[:n_inside]]
    )


def _make_tangential_gap_matrix(gap: Any, lower_gap: Any, comm: MPI.Comm) -> sparse.csr_matrix:
    """Return the matrix B_t of a solid's tangential gaps: (3 n_nodes, 2 m) (collective).

    The tangential gaps are B_t^T u with the displacement u. First come m gaps along the pairs'
    first tangents, then m along the second tangents. Both tangents are at right angles to the
    pair's mean normal.

    Parameters
    ----------
    gap : (3 n_nodes, m)
        Matrix B of the m pairs' normal gaps B^T u.
    lower_gap : (3 n_nodes, m)
        Part of B from the lower crack face.
    comm : MPI.Comm
        Ranks that share the mesh.
    """
    normals = comm.allreduce(
        np.array([lower_gap[axis_index::3].sum(axis=0) for axis_index in range(3)])[:, 0].T
    )
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    first_tangents = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    first_tangents /= np.linalg.norm(first_tangents, axis=1)[:, None]
    gap_components_along_normal = sum(
        gap[axis_index::3] @ sparse.diags(normals[:, axis_index]) for axis_index in range(3)
    )
    return sparse.hstack([
        sum(
            sparse.kron(
                gap_components_along_normal @ sparse.diags(tangent_components_along_axis),
                axis_direction[:, None]
            )
            for tangent_components_along_axis,
            axis_direction in zip(tangent_vectors.T, np.eye(3), strict=True)
        )
        for tangent_vectors in np.round([first_tangents, np.cross(normals, first_tangents)], 12)
    ]).tocsr()  # fmt: skip


def _find_patch_nodes_and_shares(
    points: np.ndarray,
    crack_of_node: np.ndarray,
    distances_on_crack: np.ndarray,
    n_inside: int,
    max_patches: int,
) -> tuple[np.ndarray, sparse.csr_matrix]:
    """Choose nodes as centres of patches, and compute the patches' pressure functions.

    Each patch becomes a contact pair. The patch's pressure function distributes the contact force
    over the crack face, as a pressure. On a plate a pressure function is linear between chosen
    nodes. On a solid it is 1 at all nodes nearest to the chosen node, otherwise 0.

    Parameters
    ----------
    points : (n, d) [m]
        Nodes of a face. The first ``n_inside`` are off tips and fronts, in order along each
        crack.
    crack_of_node : (n,) int
        Crack of each node.
    distances_on_crack : (n,) [m]
        Distance of each node along the crack path, or from the front of a surface.
    n_inside : int
        Number of nodes off tips and fronts.
    max_patches : int
        Maximum number of patches for each crack.

    Returns
    -------
    patch_nodes : (m,) int
        Node at the centre of each patch.
    pressure_shares : (n, m)
        Value of each patch's pressure function at each node, 0 to 1.
    """
    patch_center_nodes, pressure_shares = np.zeros(0, dtype=int), np.zeros((len(points), 0))
    for crack_number in np.unique(crack_of_node):
        crack_nodes = np.flatnonzero(crack_of_node[:n_inside] == crack_number)
        n_patches_on_crack = min(max_patches, len(crack_nodes))
        if points.shape[1] == 2:
            crack_nodes = crack_nodes[
                np.arange(n_patches_on_crack)
                * (len(crack_nodes) - 1)
                // max(n_patches_on_crack - 1, 1)
            ]
            patch_value_arrays = [
                np.interp(
                    distances_on_crack, distances_on_crack[crack_nodes], patch_values_at_centers
                )
                for patch_values_at_centers in np.eye(n_patches_on_crack)
            ]
        else:
            crack_nodes = crack_nodes[
                _select_distant_points(points[crack_nodes], n_patches_on_crack)
            ]
            distances_to_patch_centers = np.linalg.norm(
                points[:, None] - points[crack_nodes], axis=2
            )
            patch_value_arrays = [
                distances_to_patch_centers.argmin(axis=1) == patch_index
                for patch_index in range(n_patches_on_crack)
            ]
        patch_center_nodes = np.append(patch_center_nodes, crack_nodes)
        pressure_shares = np.column_stack(
            [
                pressure_shares,
                *(
                    patch_values * (crack_of_node == crack_number)
                    for patch_values in patch_value_arrays
                ),
            ]
        )
    return patch_center_nodes, sparse.csr_matrix(pressure_shares)


def _select_distant_points(points: np.ndarray, n_points: int) -> np.ndarray:
    """Select ``n_points`` points far from each other among ``points`` (n, d).

    The first choice is the last point. Each further choice is the point farthest from the selected
    points. Returns the indices of the selected points in ascending order: (n_points,).
    """
    selected_indices, distances_to_selected = [len(points) - 1], np.full(len(points), np.inf)
    while len(selected_indices) < n_points:
        distances_to_selected = np.minimum(
            distances_to_selected, np.linalg.norm(points - points[selected_indices[-1]], axis=1)
        )
        selected_indices.append(int(distances_to_selected.argmax()))
    return np.sort(selected_indices)


def _rotate_nodal_vectors_90_degrees(columns: Any) -> sparse.csr_matrix:
    """Rotate the plane vectors at nodes by a right angle, anticlockwise.

    Each of the m ``columns`` (2 n_nodes, m) holds x and y of a vector at every node. The result has
    the same shape.
    """
    rotation = sparse.kron(sparse.eye(columns.shape[0] // 2), [[0.0, -1.0], [1.0, 0.0]])
    return rotation.tocsr() @ columns


def _free_rows(columns: Any, dofs: Dofs) -> sparse.csr_matrix:
    """Select the rows of this rank's free dofs from a sparse matrix.

    ``columns`` (n_owned_dofs, m) has a row for each dof of this rank, clamped dofs included. The
    result (n_local, m) stores no zeros.
    """
    free_rows_matrix = sparse.csr_matrix(columns.tocsr()[dofs.free_dofs])
    free_rows_matrix.eliminate_zeros()
    return free_rows_matrix


def _assemble_nodal_gap_columns(
    dofs: Dofs, thickness: Any, both_faces_measure: Any
) -> tuple[Any, np.ndarray, sparse.csc_matrix]:
    """Assemble the gap vector b of every node on crack faces, for a plate.

    A contact pair has a node on the lower and a node on the upper face. With their vectors b_lower
    and b_upper and the displacement u, the pair's gap is b_lower . u + b_upper . u. b holds the
    mean outward normal at the node. The node's pressure function psi is the displacement's basis
    function.

    Parameters
    ----------
    dofs : Dofs
        The mesh's dofs.
    thickness : ufl expression [m]
        Thickness t of the plate.
    both_faces_measure : ufl.Measure
        Measure ds for integrals over both crack faces.

    Returns
    -------
    space : dolfinx function space
        Space of the pressure functions.
    node_areas : (n_owned,) [m^2]
        Area of each owned node, |t int psi n ds| with the outward normal n.
    columns : (n_owned_dofs, n_nodes)
        Vector b of every node, with the rows of this rank's dofs.
    """
    space, dimension = dofs.space, dofs.dimension
    facet_normal = ufl.FacetNormal(space.mesh)
    normal_integrals = compat.assembled_vector(
        thickness * ufl.inner(facet_normal, ufl.TestFunction(space)) * both_faces_measure
    )
    normal_integrals = normal_integrals.reshape(-1, dimension)
    node_areas = np.linalg.norm(normal_integrals, axis=1)
    face_nodes = np.flatnonzero(node_areas)
    node_normals = normal_integrals[face_nodes] / node_areas[face_nodes, None]
    row_indices = dimension * face_nodes[:, None] + np.arange(dimension)
    column_indices = np.repeat(dofs.first_node + face_nodes, dimension)
    matrix_shape = len(dofs.structure_dof_numbers), space.dofmap.index_map.size_global
    return (
        space,
        node_areas,
        sparse.csc_matrix(
            (node_normals.ravel(), (row_indices.ravel(), column_indices)), matrix_shape
        ),
    )


def _assemble_pressure_gap_columns(
    dofs: Dofs, thickness: Any, both_faces_measure: Any
) -> tuple[Any, np.ndarray, sparse.csc_matrix]:
    """Assemble the gap vector b of every facet corner on crack faces.

    A corner's pressure function psi is linear between the corners of each facet. With the
    displacement u and the outward normal n, the product b . u is the mean of n . u weighted by psi:

        b . u = t int psi n . u ds / w,      w = t int psi ds

    A contact pair has a corner on the lower and a corner on the upper face. The pair's gap is the
    sum of both products.

    Parameters
    ----------
    dofs : Dofs
        The mesh's dofs.
    thickness : ufl expression [m]
        A plate's thickness t, 1 for a solid.
    both_faces_measure : ufl.Measure
        Measure ds for integrals over both crack faces.

    Returns
    -------
    space : dolfinx function space
        Space of the pressure functions.
    node_areas : (n_owned,) [m^2]
        Area w of each owned corner.
    columns : (n_owned_dofs, n_nodes)
        Vector b of every corner, with the rows of this rank's dofs.
    """
    pressure_space = compat.function_space(dofs.space.mesh, 1, vectors=False)
    facet_normal, pressure_trial_function = (
        ufl.FacetNormal(pressure_space.mesh),
        ufl.TrialFunction(pressure_space),
    )
    work_form = (
        ufl.inner(thickness * pressure_trial_function * facet_normal, ufl.TestFunction(dofs.space))
        * both_faces_measure
    )
    petsc_gap_matrix = compat.assembled_petsc_matrix(work_form)
    gap_columns = local_rows(petsc_gap_matrix).tocsc()
    petsc_gap_matrix.destroy()
    node_areas = compat.assembled_vector(
        thickness * ufl.TestFunction(pressure_space) * both_faces_measure
    )
    all_node_areas = gather_rows(dofs.comm, node_areas)
    reciprocal_areas = np.divide(
        1.0, all_node_areas, out=np.zeros_like(all_node_areas), where=all_node_areas > 0.0
    )
    return (
        pressure_space,
        node_areas,
        sparse.csc_matrix(gap_columns @ sparse.diags(reciprocal_areas)),
    )


def _match_face_nodes(
    cracks: Cracks, lower_node_table: np.ndarray, upper_node_table: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int]:
    """Match the nodes of both crack faces one to one.

    Parameters
    ----------
    cracks : Cracks
        Cracks of the mesh.
    lower_node_table, upper_node_table : (n, 2 + d)
        Rows with node number, area and position of the nodes on each face.

    Returns
    -------
    lower_node_table, upper_node_table : (n, 2 + d)
        Matched rows in order along the cracks; nodes of tips and fronts come last. Tips and fronts
        belong to both faces, so their areas are halved in the lower table.
    crack_of_pair : (n,) int
        Crack of each row.
    distances_on_crack : (n,) [m]
        Distance along the crack path, or from the front of a surface.
    n_inside : int
        Number of rows off tips and fronts.

    Raises
    ------
    InputError
        The faces have different nodes; the tolerance is 1e-6 of the cracks' extent.
    """
    crack_extent = np.ptp(lower_node_table[:, 2:], axis=0).max()
    is_front_node = np.isin(lower_node_table[:, 0], upper_node_table[:, 0])
    lower_node_table[is_front_node, 1] *= 0.5
    crack_of_pair, distances_on_crack = locate_on_cracks(cracks, lower_node_table[:, 2:])
    # Equal distances, as along a front, are sorted by coordinates.
    sort_positions = np.round(lower_node_table[:, 2:] / crack_extent, 7).T
    node_order = np.lexsort(
        (
            *sort_positions,
            np.round(distances_on_crack / crack_extent, 7),
            crack_of_pair,
            is_front_node,
        )
    )
    lower_node_table, crack_of_pair = lower_node_table[node_order], crack_of_pair[node_order]
    distances_on_crack = distances_on_crack[node_order]
    n_front = int(is_front_node.sum())
    n_inside = len(lower_node_table) - n_front
    has_matching_faces = len(lower_node_table) == len(upper_node_table) and n_inside > 0
    mismatch_reason = "one face has more nodes than the other"
    if has_matching_faces:
        distances_to_upper_nodes = [
            np.linalg.norm(upper_node_table[:, 2:] - lower_point, axis=1)
            for lower_point in lower_node_table[:, 2:]
        ]
        nearest_distances = np.min(distances_to_upper_nodes, axis=1)
        upper_partner_indices = np.argmin(distances_to_upper_nodes, axis=1)
        has_matching_faces = (
            nearest_distances.max() <= RELATIVE_POSITION_TOLERANCE * crack_extent
            and len(np.unique(upper_partner_indices)) == len(upper_partner_indices)
        )
        lower_point = lower_node_table[int(np.argmax(nearest_distances)), 2:]
        mismatch_reason = (
            f"the upper node nearest to the lower node at {format_point(lower_point, 'g')} m"
            f" is {nearest_distances.max():.2g} m away"
        )
    if not has_matching_faces:
        problem_text = f"{n_inside} lower and {len(upper_node_table) - n_front} upper nodes"
        advice_text = (
            "in a mesh file, name one curve or surface 'crack': it is split into both faces"
        )
        requirement = f"crack faces with the same nodes, but {mismatch_reason}"
        raise InputError("lips", problem_text, f"{requirement}; {advice_text}")
    return (
        lower_node_table,
        upper_node_table[upper_partner_indices],
        crack_of_pair,
        distances_on_crack,
        n_inside,
    )


def _watched_pair_by_name(
    cracks: Cracks, crack_of_pair: np.ndarray, distances_on_crack: np.ndarray
) -> dict[str, int]:
    """Return the index of each crack's watched pair, by name.

    Results report this pair, with a name such as "the mouth of crack 1". A crack without pairs has
    no entry. ``crack_of_pair`` (n_pairs,) is the index of each pair's crack. ``distances_on_crack``
    (n_pairs,) [m] is the distance along a plate's crack path, or from the front in a solid.
    """
    pair_by_name: dict[str, int] = {}
    crack: Any
    for crack_number, crack in enumerate(cracks):
        pair_indices_of_crack = np.flatnonzero(crack_of_pair == crack_number)
        place_name, watched_distance = crack.watched_name_and_distance
        if len(cracks) > 1:
            place_name += f" of crack {crack_number + 1}"
        if len(pair_indices_of_crack):
            largest_distance_on_crack = float(distances_on_crack[pair_indices_of_crack].max())
            offsets = np.abs(
                distances_on_crack[pair_indices_of_crack]
                - min(watched_distance, largest_distance_on_crack)
            )
            # Of pairs with equal distances the first, whatever the rounding.
            is_nearest = (
                offsets <= offsets.min() + RELATIVE_POSITION_TOLERANCE * largest_distance_on_crack
            )
            pair_by_name[place_name] = int(pair_indices_of_crack[np.argmax(is_nearest)])
    return pair_by_name


def assemble_structure(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Structure:
    """Mesh a scene and assemble the structure, or read matrix files (collective).

    Unlike :func:`fenics_crack.build_structure`, the crack length must be known.

    Parameters
    ----------
    scene : Scene
        Scene to build, without ``crack.first_omega``.
    comm : MPI.Comm
        Ranks that share the mesh.

    Returns
    -------
    Structure
        Structure that is not reduced; each rank has part of the rows.

    Raises
    ------
    InputError
        The mesh file or a matrix is unusable, the load is off the mesh or clamped, or the crack
        faces do not match.
    """
    collect_garbage(comm)  # free the matrices of earlier structures
    if scene.structure is not None:
        from fenics_crack.fem.matrix_files import read_structure

        damping_rule = None if scene.damping is None else damping_rule_of(scene.damping)
        return read_structure(scene, damping_rule, comm)
    coarser_file = scene.mesh.coarser
    if coarser_file is not None:  # read last, so check it now
        from fenics_crack.fem.msh_file import check_file_exists

        on_root(comm, lambda: check_file_exists("mesh.coarser", coarser_file))
    if scene.disk is not None:  # every rank has the sector
        from fenics_crack.disk.sector import assemble_wheel

        structure, dofs = call_on_each_rank(
            comm, lambda: _assemble_structure_at_rest(scene, MPI.COMM_SELF)
        )
        return assemble_wheel(scene, dofs, structure, comm)
    structure, dofs = _assemble_structure_at_rest(scene, comm)
    if scene.speed > 0.0:
        begin_stage("rotation")
        structure = assemble_rotation(scene, dofs, structure).structure_rotating_at_speed(
            scene.speed
        )
    return structure


def assemble_force_watched_and_clamp(scene: Scene, structure: Structure) -> dict[str, Any]:
    """Assemble a scene's loads on the mesh of a structure without rotation (collective).

    Returns
    -------
    dict
        Fields of :class:`Body`, by name. "force" is the load (2K+1, n_local) [N]: mean, then cosine
        and sine parts up to the order K. "watched" is a vector (n_local,) or None; results report
        its product with the displacement. "clamp" has the data for the reaction at the clamp.
    """
    dofs: Dofs = structure.nodes.dolfinx_mesh_and_dofs  # type: ignore[union-attr]
    _, mass_form = _make_stiffness_and_mass_forms(scene, dofs.space)
    mass_matrix = compat.assembled_petsc_matrix(mass_form)
    nodal_force_harmonics, watched_vector = assemble_loads(scene, dofs, mass_matrix)
    clamp_for_reactions = make_clamp_for_reactions(dofs, mass_matrix, nodal_force_harmonics)
    mass_matrix.destroy()
    return {
        "force": dofs.restrict_to_free(nodal_force_harmonics),
        "watched": watched_vector,
        "clamp": clamp_for_reactions,
    }


def _assemble_structure_at_rest(scene: Scene, comm: MPI.Comm) -> tuple[Structure, Dofs]:
    """Assemble a scene's structure without rotation (collective).

    Returns the structure and the dofs of the mesh. For a bladed disk the structure is a single
    sector with free sides.
    """
    begin_stage("mesh")
    part_mesh = build_plate_or_solid_mesh(scene, comm)
    begin_stage("matrices")
    if (
        not part_mesh.has_cracks
        and scene.mesh.layout == "file"
        and (scene.contact or scene.crack_by_name)
    ):
        curves_or_surfaces_word = "curves" if scene.dimension == 2 else "surfaces"
        requirement = (
            f"a mesh with {curves_or_surfaces_word} named 'crack', or 'lower_lip' and 'upper_lip'"
        )
        requirement += ", as the scene has [crack] or [contact]"
        raise InputError("mesh.file", scene.mesh.file, requirement)
    space = compat.function_space(part_mesh.mesh, scene.mesh.order)
    dofs = Dofs(part_mesh, space, comm)
    if scene.disk is not None:
        from fenics_crack.disk.sector import record_matched_side_nodes

        record_matched_side_nodes(scene, dofs)
    stiffness_with_clamped_dofs, mass_with_clamped_dofs = map(
        compat.assembled_petsc_matrix, _make_stiffness_and_mass_forms(scene, space)
    )
    mouth_only = scene.contact is not None and scene.contact.pairs == "mouth"
    thickness, max_patches = thickness_constant(scene, space), scene.mesh.patches
    gap_matrix, tangential, pairs = pair_crack_faces(
        dofs, thickness, mouth_only=mouth_only, max_patches=max_patches
    )
    nodal_force_harmonics, watched_vector = assemble_loads(scene, dofs, mass_with_clamped_dofs)
    clamp_for_reactions = make_clamp_for_reactions(
        dofs, mass_with_clamped_dofs, nodal_force_harmonics
    )
    body = Body(
        dofs.restrict_matrix(mass_with_clamped_dofs),
        dofs.restrict_matrix(stiffness_with_clamped_dofs), gap_matrix,
        dofs.restrict_to_free(nodal_force_harmonics), clearance_of(scene, pairs),
        damping=damping_rule_of(scene.damping), tangential=tangential, nodes=dofs.make_node_data(),
        pairs=pairs, watched=watched_vector, clamp=clamp_for_reactions,
    )  # fmt: skip
    return Structure(body), dofs


# --- matrices -------------------------------------------------------------------------------------


def _make_stiffness_and_mass_forms(scene: Scene, space: Any) -> tuple[Any, Any]:
    """Return the UFL forms for stiffness and mass, without boundary conditions.

    The forms are t int sigma(u) : eps(v) dx and t int rho u . v dx. u and v are trial and test
    function, sigma and eps stress and strain. t is the thickness of a plate, 1 for a solid, and rho
    the density.
    """
    (density,), thickness = (
        form_constants(space, scene.material.density),
        thickness_constant(scene, space),
    )
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    trial_strain = ufl.sym(ufl.grad(u))
    stiffness_form = (
        thickness
        * ufl.inner(stress_expression(scene, space, trial_strain), ufl.sym(ufl.grad(v)))
        * ufl.dx
    )
    return stiffness_form, thickness * density * ufl.inner(u, v) * ufl.dx


# --- cracks ---------------------------------------------------------------------------------------


def build_structure(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Structure:
    """Mesh a scene and assemble the structure, or read matrix files (collective).

    If the scene has ``crack.first_omega``, :func:`find_crack_length` finds the crack's length.

    Parameters
    ----------
    scene : Scene
        Scene to build.
    comm : MPI.Comm
        Ranks that share the mesh.

    Returns
    -------
    Structure
        Structure that is not reduced; each rank has part of the rows.

    Raises
    ------
    InputError
        The mesh file or a matrix is unusable, the load is off the mesh or clamped, or the crack
        faces do not match.

    Examples
    --------
    >>> whole = fc.build_structure(scene)
    """
    return assemble_structure(with_crack_length(scene, comm), comm)


def with_crack_length(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> Scene:
    """Replace ``crack.first_omega`` in a scene by the crack length (collective).

    The length comes from :func:`find_crack_length`. A scene without ``crack.first_omega`` is
    returned unchanged.
    """
    if scene.crack is None or scene.crack.first_omega is None:
        return scene
    return _replace_crack_length(scene, find_crack_length(scene, comm))


_CRACK_LENGTH_OF_LAST_SEARCH: list[tuple[str, float]] = []
"""Crack length [m] found last in this process, with the text of the scene's tables for geometry,
crack, material and mesh. Empty before the first search."""


def find_crack_length(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> float:
    """Find the crack length [m] for a given first natural frequency (collective).

    The frequency ``crack.first_omega`` is for the open crack without rotation, and falls with the
    length. Brent's method finds the length to 1e-5 of the width; the plate is meshed for each
    trial. Another call for the same plate returns the stored length.

    Parameters
    ----------
    scene : Scene
        Plate with ``crack.first_omega`` or ``crack.first_frequency``.
    comm : MPI.Comm
        Ranks that share the mesh.

    Returns
    -------
    float
        Length [m].

    Raises
    ------
    InputError
        No length from 1 % to 95 % of the plate's width gives the frequency. For a crack inside, the
        limits are 1 % and 95 % of twice the center's distance from the nearer edge.

    Examples
    --------
    >>> given = {"crack.length": None, "crack.first_omega": 4700.0}
    >>> length = fc.find_crack_length(blade.replace(given))
    """
    crack, width = scene.crack, None if scene.structure else scene.geometry.width
    if crack is None or crack.first_omega is None or width is None:
        raise InputError("crack.first_omega", None, "given: a finite number > 0 [rad/s]")
    tables_text = repr((scene.geometry, crack, scene.material, scene.mesh))
    if (
        stored_crack_length := comm.bcast(dict(_CRACK_LENGTH_OF_LAST_SEARCH).get(tables_text))
    ) is not None:
        return float(stored_crack_length)
    target_omega, scene_at_rest = crack.first_omega, scene.without_rotation()

    @cache
    def excess_frequency(length: float) -> float:
        """Return the first natural frequency at a crack length [m], less the target [rad/s]."""
        trial_structure = assemble_structure(_replace_crack_length(scene_at_rest, length), comm)
        return float(solve_modes(trial_structure, 1).omega[0]) - target_omega

    available_width, width_words = width, "width"
    if crack.center is not None:
        available_width = 2.0 * min(crack.center, width - crack.center)
        width_words = "free width around crack.center"
    min_length, max_length = 0.01 * available_width, 0.95 * available_width
    max_omega = target_omega + excess_frequency(min_length)
    min_omega = target_omega + excess_frequency(max_length)
    if not min_omega <= target_omega <= max_omega:
        omega_range_text = f"between {min_omega:.1f} and {max_omega:.1f} rad/s"
        requirement = f"{omega_range_text}, as for cracks of 95 % and 1 % of the {width_words}"
        raise InputError("crack.first_omega", target_omega, requirement)
    import scipy.optimize  # slow to import, and most scenes give a length

    crack_length_at_target = float(
        scipy.optimize.brentq(excess_frequency, min_length, max_length, xtol=1e-5 * width)
    )
    _CRACK_LENGTH_OF_LAST_SEARCH[:] = [(tables_text, crack_length_at_target)]
    return crack_length_at_target


def _replace_crack_length(scene: Scene, length: float) -> Scene:
    """Return a scene with ``crack.length`` [m] instead of ``crack.first_omega``."""
    return scene.replace({"crack.length": length, "crack.first_omega": None})
