"""Find the contact pairs of another program's model.

Coincident nodes without connection in the stiffness become pairs.

Models with solid cells
-----------------------
A facet is on a crack face if it belongs to one cell only, and coincides with another such facet
with other nodes. Pairs are those of :mod:`fenics_crack.fem.build`:

    g_i = 1 / w_i int psi_i (n . u_lower + n . u_upper) ds,      w_i = int psi_i ds,

with psi_i linear, and 1 at a corner that exists twice. Facets are as flat as their corners. Each
normal n points out of its own cell, so the lower face need not be known.

Models without cells
--------------------
Pairs are nodes: g = n . (u_a - u_b) for two coincident nodes. A node connected to u_a only, by the
stiffness, lies on the side of a. A node connected to both lies on the front. The normal n belongs
to the plane through the neighbouring pairs, or to a line in a plane model or shell. It points from
the side of a to the side of b.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse

from fenics_crack.basics.errors import InputError
from fenics_crack.fem.cracks import (
    FACET_CORNERS_BY_CORNER_COUNT,
    RELATIVE_POSITION_TOLERANCE,
    count_equal_rows,
    make_matrix_extending_pressures_to_front,
)
from fenics_crack.fem.model_files import ModelFileMesh
from fenics_crack.model.nodes import Pairs, format_point

FACETS_BY_CORNER_COUNT = {
    4: [FACET_CORNERS_BY_CORNER_COUNT[4]], 8: [FACET_CORNERS_BY_CORNER_COUNT[8]],
    6: [np.array([[0, 1, 2], [3, 4, 5]]), np.array([[0, 1, 4, 3], [1, 2, 5, 4], [2, 0, 3, 5]])],
}  # fmt: skip
"""Corners of a cell's facets, by the cell's number of corners: triangles, then quadrilaterals."""
N_CORNERS_BY_VTK_TYPE = {10: 4, 24: 4, 13: 6, 26: 6, 12: 8, 25: 8}
"""Number of corners of a cell, by VTK's cell type."""
CELL_EDGES_BY_CORNER_COUNT = {
    4: [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
    6: [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)],
    8: [*((i, (i + 1) % 4) for i in range(4)), *((4 + i, 4 + (i + 1) % 4) for i in range(4)),
        *((i, 4 + i) for i in range(4))],
}  # fmt: skip
"""Edges between a cell's corners, in VTK's order of middle nodes."""


def find_coincident_node_pairs(points: np.ndarray) -> np.ndarray:
    """Return pairs of nodes at the same position, as indices: (n, 2) int.

    The tolerance is 1e-6 of the model's largest extent.
    """
    from scipy.spatial import cKDTree  # slow to import, and only foreign models need it

    tolerance = RELATIVE_POSITION_TOLERANCE * float(np.ptp(points, axis=0).max())
    node_pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    return np.asarray(node_pairs[np.lexsort(node_pairs.T[::-1])])


class _TwinNodes:
    """Pairs of coincident nodes of a model that the stiffness does not connect.

    These twin nodes lie on opposite crack faces. Both have dofs.

    Attributes
    ----------
    points : (n_nodes, 3) [m]
        Node positions.
    dofs : (n_nodes, 3) int
        Row of each node along x, y, z in the matrices; -1 without a row.
    n_dofs : int
        Number of rows of the matrices.
    first_nodes, second_nodes : (n_pairs,) int
        Both nodes of each pair.
    pair_index : (n_nodes,) int
        Index of each node's pair; -1 for all other nodes.
    coincident_group_number_of_node : (n_nodes,) int
        Number of each node's position, equal for coincident nodes.
    are_nodes_linked_by_stiffness : (n_nodes, n_nodes) bool
        True if the stiffness connects two nodes.
    is_in_half_held_pair : (n_nodes,) bool
        True for two coincident nodes if only one node has dofs. The other node is clamped, or tied
        by equations.
    """

    def __init__(
        self, model: ModelFileMesh, dofs: np.ndarray, stiffness: sparse.csr_matrix
    ) -> None:
        n_model_nodes, node_pairs = len(dofs), find_coincident_node_pairs(model.points)
        self.points, self.dofs, self.n_dofs = model.points, dofs, stiffness.shape[0]
        node_of_row = np.full(self.n_dofs, n_model_nodes)
        node_of_row[dofs[dofs >= 0]] = np.nonzero(dofs >= 0)[0]
        stiffness_coo = stiffness.tocoo()
        nodes_of_stiffness_entries = (
            node_of_row[stiffness_coo.row].astype(np.int64),
            node_of_row[stiffness_coo.col],
        )
        link_values_and_indices = np.ones(len(stiffness_coo.data), bool), nodes_of_stiffness_entries
        self.are_nodes_linked_by_stiffness = sparse.csr_matrix(
            link_values_and_indices, (n_model_nodes + 1, n_model_nodes + 1)
        )[:n_model_nodes, :n_model_nodes]
        is_free_node = np.any(dofs >= 0, axis=1)
        is_contact_pair = is_free_node[node_pairs].all(axis=1) & ~np.isin(
            n_model_nodes * node_pairs[:, 0] + node_pairs[:, 1],
            n_model_nodes * nodes_of_stiffness_entries[0] + nodes_of_stiffness_entries[1],
        )
        self.coincident_group_number_of_node = np.arange(n_model_nodes)
        self.coincident_group_number_of_node[node_pairs[:, 1]] = node_pairs[:, 0]
        self.is_in_half_held_pair = np.zeros(n_model_nodes, dtype=bool)
        self.is_in_half_held_pair[
            node_pairs[is_free_node[node_pairs[:, 0]] != is_free_node[node_pairs[:, 1]]]
        ] = True
        self.first_nodes, self.second_nodes = node_pairs[is_contact_pair].T
        unique_paired_nodes, n_pairs_of_node = np.unique(
            np.append(self.first_nodes, self.second_nodes), return_counts=True
        )
        if np.any(n_pairs_of_node > 1):
            node_in_most_pairs = unique_paired_nodes[np.argmax(n_pairs_of_node)]
            place_text = format_point(model.points[node_in_most_pairs], "g")
            place_text += f", one of them is node {model.labels[node_in_most_pairs]}"
            requirement = (
                "a model with two nodes at each place of a crack, as cracks neither branch"
                " nor cross"
            )
            raise InputError("model", f"more than two nodes at {place_text}", requirement)
        if not len(self.first_nodes):
            problem_text = (
                f"{len(node_pairs)} pairs of nodes at the same place, all connected or clamped"
            )
            raise InputError(
                "model",
                problem_text,
                "a model with two nodes at each place of a crack, free and not connected",
            )
        self.pair_index = np.full(n_model_nodes, -1)
        self.pair_index[self.first_nodes] = self.pair_index[self.second_nodes] = np.arange(
            len(self.first_nodes)
        )


def find_gap_matrix_and_pairs(
    model: ModelFileMesh, dofs: np.ndarray, stiffness: sparse.csr_matrix, *, has_rotations: bool
) -> tuple[sparse.csr_matrix, Pairs]:
    """Find a model's contact pairs, crack by crack, from front to mouth.

    Parameters
    ----------
    model : Model
        Model with n nodes.
    dofs : (n, 3) int
        Row of each node along x, y, z in the stiffness; -1 without a row.
    stiffness : (n_dofs, n_dofs)
        Stiffness; an entry connects two nodes.
    has_rotations : bool
        True if nodes have rotations, as in shells. Crack faces are then lines, not surfaces.

    Returns
    -------
    gap : (n_dofs, n_pairs)
        Matrix B from the displacement u to the gaps B^T u.
    pairs : Pairs
        Positions, areas (None without cells) and crack of each pair.

    Raises
    ------
    InputError
        The stiffness connects all coincident nodes with dofs, so there is no pair. Or three nodes
        coincide, or both nodes of a pair lie on the same side of the crack.
    """
    twins = _TwinNodes(model, dofs, stiffness)
    facets = _crack_face_facets(model, twins)
    if facets:
        gap, areas, twin_index_of_contact_pair, front_nodes = _assemble_patch_gap_matrix(
            twins, facets
        )
    else:
        has_surface_cracks = not has_rotations and np.all(np.any(dofs >= 0, axis=0))
        gap, front_nodes = _assemble_normal_gap_matrix(twins, 2 if has_surface_cracks else 1)
        areas, twin_index_of_contact_pair = None, np.arange(len(twins.first_nodes))
    pair_points = model.points[twins.first_nodes[twin_index_of_contact_pair]]
    crack_of_pair = _find_crack_of_each_pair(twins, twin_index_of_contact_pair)
    front_distances = np.zeros(len(twin_index_of_contact_pair))
    if len(front_nodes):
        from scipy.spatial import cKDTree

        front_distances = cKDTree(model.points[front_nodes]).query(pair_points)[0]
    pair_order = np.lexsort((front_distances, crack_of_pair))
    crack_of_pair, front_distances = crack_of_pair[pair_order], front_distances[pair_order]
    mouth_pairs = np.flatnonzero(np.append(np.diff(crack_of_pair), 1))
    mouth_names = [
        f"the mouth of crack {crack_number + 1}" if len(mouth_pairs) > 1 else "the mouth"
        for crack_number in crack_of_pair[mouth_pairs]
    ]
    contact_pairs = Pairs(
        pair_points[pair_order], None if areas is None else areas[pair_order], crack_of_pair,
        front_distances,
        dict(zip(mouth_names, mouth_pairs.tolist(), strict=True)),
    )  # fmt: skip
    return gap[:, pair_order], contact_pairs


def _find_crack_of_each_pair(
    twins: _TwinNodes, twin_index_of_contact_pair: np.ndarray
) -> np.ndarray:
    """Return the crack number of each contact pair: (n_pairs,) int.

    Two pairs are neighbours if the stiffness connects their nodes on both crack faces. A chain of
    neighbours belongs to the same crack. Cracks are numbered from 0, from bottom to top.

    Parameters
    ----------
    twins : _TwinNodes
        All pairs of coincident nodes.
    twin_index_of_contact_pair : (n_pairs,) int
        Index of each contact pair in ``twins``.
    """
    from scipy.sparse.csgraph import connected_components

    # A first node may be on either face.
    first_node_of_pair = twins.first_nodes[twin_index_of_contact_pair]
    second_node_of_pair = twins.second_nodes[twin_index_of_contact_pair]
    links_of_first_with_first_nodes = twins.are_nodes_linked_by_stiffness[first_node_of_pair][
        :, first_node_of_pair
    ].multiply(twins.are_nodes_linked_by_stiffness[second_node_of_pair][:, second_node_of_pair])
    links_between_pairs = links_of_first_with_first_nodes + twins.are_nodes_linked_by_stiffness[
        first_node_of_pair
    ][:, second_node_of_pair].multiply(
        twins.are_nodes_linked_by_stiffness[second_node_of_pair][:, first_node_of_pair]
    )
    n_cracks, unsorted_crack_of_pair = connected_components(links_between_pairs)
    crack_centre_x, crack_centre_y, crack_centre_z = np.transpose(
        [
            twins.points[first_node_of_pair[unsorted_crack_of_pair == unsorted_crack]].mean(axis=0)
            for unsorted_crack in range(n_cracks)
        ]
    )
    sorted_crack_number = np.lexsort((crack_centre_z, crack_centre_x, crack_centre_y)).argsort()
    return np.asarray(sorted_crack_number[unsorted_crack_of_pair])


# --- of facets ------------------------------------------------------------------------------------

Facets = tuple[np.ndarray, np.ndarray]
"""Facets of cells: nodes (m, 2 k), and centres of the facets' cells (m, 3) [m].

The nodes are k corners, then the middle nodes of k edges, or -1 for cells of order 1.
"""


def _crack_face_facets(model: ModelFileMesh, twins: _TwinNodes) -> list[Facets]:
    """Return the facets on crack faces: triangles, then quadrilaterals; empty without any.

    A facet is on a crack face under three conditions:

    - A single cell has the facet.
    - Exactly one facet of another cell has the same position.
    - A corner of the facet is a node in ``twins``.

    A facet is left out if one of its nodes coincides with another node, and only one of both has
    matrix rows.
    """
    facets_of_each_shape = []
    for n_facet_corners in (3, 4):
        facets_and_centres_of_kinds = [
            _cell_facets_and_cell_centres(
                model.points, cells, N_CORNERS_BY_VTK_TYPE[vtk_type], facet_corner_columns
            )
            for vtk_type, cells in model.cells_by_vtk_type.items()
            for facet_corner_columns in FACETS_BY_CORNER_COUNT[N_CORNERS_BY_VTK_TYPE[vtk_type]]
            if facet_corner_columns.shape[1] == n_facet_corners
        ]
        if not facets_and_centres_of_kinds:
            continue
        facet_nodes, cell_centres = (
            np.concatenate(arrays_of_all_cell_kinds)
            for arrays_of_all_cell_kinds in zip(*facets_and_centres_of_kinds, strict=True)
        )
        is_boundary = count_equal_rows(facet_nodes[:, :n_facet_corners]) == 1
        is_on_crack = is_boundary.copy()
        is_on_crack[is_boundary] = (
            count_equal_rows(
                twins.coincident_group_number_of_node[facet_nodes[is_boundary, :n_facet_corners]]
            )
            == 2
        )
        is_on_crack &= np.any(twins.pair_index[facet_nodes[:, :n_facet_corners]] >= 0, axis=1)
        is_on_crack &= ~np.any(twins.is_in_half_held_pair[facet_nodes] & (facet_nodes >= 0), axis=1)
        if np.any(is_on_crack):
            facets_of_each_shape.append((facet_nodes[is_on_crack], cell_centres[is_on_crack]))
    return facets_of_each_shape


def _cell_facets_and_cell_centres(
    points: np.ndarray, cells: np.ndarray, n_corners: int, facet_corner_columns: np.ndarray
) -> Facets:
    """Return the facets of all cells of the same kind, with the cells' centres.

    Parameters
    ----------
    points : (n_nodes, 3) [m]
        Node positions.
    cells : (n, k) int
        Nodes of each cell: corners, then the middle nodes of edges, if any.
    n_corners : int
        Number of corners per cell.
    facet_corner_columns : (m, n_facet_corners) int
        Corners of each of a cell's m facets, as columns of ``cells``.

    Returns
    -------
    facet_nodes : (n m, 2 n_facet_corners) int
        Nodes of each facet, cell after cell: corners, then middle nodes. -1 for missing middle
        nodes.
    cell_centres : (n m, 3) [m]
        Centre of each facet's cell.
    """
    n_facet_corners = facet_corner_columns.shape[1]
    middle_column_by_edge = {
        frozenset(edge): n_corners + edge_index
        for edge_index, edge in enumerate(CELL_EDGES_BY_CORNER_COUNT[n_corners])
    }
    edge_ends = np.stack([facet_corner_columns, np.roll(facet_corner_columns, -1, axis=1)], axis=2)
    facet_middle_columns = np.array(
        [[middle_column_by_edge[frozenset(edge)] for edge in facet] for facet in edge_ends.tolist()]
    )
    facet_nodes = np.full((len(cells), len(facet_corner_columns), 2 * n_facet_corners), -1)
    facet_nodes[..., :n_facet_corners] = cells[:, facet_corner_columns]
    if cells.shape[1] > n_corners:
        facet_nodes[..., n_facet_corners:] = cells[:, facet_middle_columns]
    cell_centres_of_facets = np.repeat(
        points[cells[:, :n_corners]].mean(axis=1), len(facet_corner_columns), axis=0
    )
    return facet_nodes.reshape(-1, 2 * n_facet_corners), cell_centres_of_facets


def _facet_basis_at_gauss_points(n_corners: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evaluate the basis functions of a facet at 3 x 3 Gauss points.

    The facet has k = ``n_corners`` corners, 3 or 4.

    Returns
    -------
    weighted_functions : (2, k, 9)
        Basis functions times the Gauss weights: k linear functions, 1 at a corner, then k quadratic
        functions, 1 at the middle of an edge.
    linear : (k, 9)
        The linear functions without weights.
    slopes : (2, k, 9)
        Derivatives of the linear functions by the facet's two coordinates.
    """
    gauss_points, gauss_weights = (
        0.5 * coordinates for coordinates in np.polynomial.legendre.leggauss(3)
    )
    r, s = (
        coordinates.ravel() for coordinates in np.meshgrid(gauss_points + 0.5, gauss_points + 0.5)
    )
    point_weights = np.outer(gauss_weights, gauss_weights).ravel()
    if n_corners == 3:
        s, point_weights = s * (1.0 - r), point_weights * (1.0 - r)
        linear_functions = np.array([1.0 - r - s, r, s])
        linear_function_slopes = np.broadcast_to(
            [[[-1.0], [1.0], [0.0]], [[-1.0], [0.0], [1.0]]], (2, 3, len(r))
        )
        edge_functions = 4.0 * linear_functions * np.roll(linear_functions, -1, axis=0)
    else:
        linear_functions = np.array([(1 - r) * (1 - s), r * (1 - s), r * s, (1 - r) * s])
        linear_function_slopes = np.array([[s - 1, 1 - s, s, -s], [r - 1, -r, r, 1 - r]])
        edge_end_functions = linear_functions, np.roll(linear_functions, -1, axis=0)
        edge_functions = (
            4.0
            * edge_end_functions[0]
            * edge_end_functions[1]
            / (edge_end_functions[0] + edge_end_functions[1])
        )
    return (
        point_weights * np.stack([linear_functions, edge_functions]),
        linear_functions,
        linear_function_slopes,
    )


def _assemble_patch_gap_matrix(
    twins: _TwinNodes, facets: list[Facets]
) -> tuple[sparse.csr_matrix, np.ndarray, np.ndarray, np.ndarray]:
    """Assemble normal gaps averaged over patches of crack faces.

    Each pair of facet corners has a patch: the facets with this corner. The gap is weighted by a
    pressure function, 1 at the corner and linear to 0 at all other corners. The functions for
    corners on fronts are distributed to neighbours.

    Returns
    -------
    gap : (n_dofs, n)
        Matrix B from the displacement u to the gaps B^T u.
    areas : (n,) [m^2]
        Areas of the patches.
    twin_pair_index : (n,) int
        Index in ``twins`` of the pair at each patch's centre.
    front_nodes : (m,) int
        Corner nodes on the crack fronts.
    """
    n_pairs = len(twins.first_nodes)
    corner_nodes = [nodes[:, : nodes.shape[1] // 2] for nodes, _ in facets]
    all_face_nodes = np.unique(np.concatenate([nodes.ravel() for nodes in corner_nodes]))
    front_nodes = all_face_nodes[twins.pair_index[all_face_nodes] < 0]
    patch_index_of_node = twins.pair_index.copy()
    # Patches of front nodes go to their neighbours.
    patch_index_of_node[front_nodes] = n_pairs + np.arange(len(front_nodes))
    patch_areas = np.zeros(n_pairs + len(front_nodes))
    gap = sparse.csr_matrix((twins.n_dofs, len(patch_areas)))
    overlap_matrix = sparse.csr_matrix((len(patch_areas), len(patch_areas)))
    for nodes, cell_centres in facets:
        n_corners = nodes.shape[1] // 2
        (weighted_linear_functions, edge_functions), pressure_basis, basis_function_slopes = (
            _facet_basis_at_gauss_points(n_corners)
        )
        corner_points = twins.points[nodes[:, :n_corners]]
        position_derivative_1, position_derivative_2 = np.einsum(
            "akq,fkx->afqx", basis_function_slopes, corner_points
        )
        area_normals = np.cross(position_derivative_1, position_derivative_2)
        is_inward = (
            np.einsum("fqx,fx->f", area_normals, corner_points.mean(axis=1) - cell_centres) < 0.0
        )
        area_normals[is_inward] *= -1.0
        surface_jacobians = np.linalg.norm(area_normals, axis=2)
        patch_index_of_facet_corner = patch_index_of_node[nodes[:, :n_corners]]
        np.add.at(
            patch_areas,
            patch_index_of_facet_corner,
            0.5 * np.einsum("kq,fq->fk", weighted_linear_functions, surface_jacobians),
        )
        integrals = np.einsum(
            "iq,jq,fq->fij", pressure_basis, weighted_linear_functions, surface_jacobians
        )
        row_and_column_patch_indices = np.broadcast_arrays(
            patch_index_of_facet_corner[:, :, None], patch_index_of_facet_corner[:, None]
        )
        overlap_matrix += sparse.csr_matrix(
            (
                integrals.ravel(),
                [patch_indices.ravel() for patch_indices in row_and_column_patch_indices],
            ),
            overlap_matrix.shape,
        )
        # A quadratic corner function is the linear one less half of its two edge functions.
        half_sum_of_edge_functions_at_corner = 0.5 * (
            edge_functions + np.roll(edge_functions, 1, axis=0)
        )
        is_quadratic = np.all(nodes[:, n_corners:] >= 0, axis=1)[:, None, None]
        corner_integrals = np.einsum(
            "iq,jq,fqx->fijx", pressure_basis, weighted_linear_functions, area_normals
        )
        corner_integrals -= (
            np.einsum(
                "iq,jq,fqx->fijx",
                pressure_basis,
                half_sum_of_edge_functions_at_corner,
                area_normals,
            )
            * is_quadratic[..., None]
        )
        edge_function_integrals_over_facet = (
            np.einsum("iq,jq,fqx->fijx", pressure_basis, edge_functions, area_normals)
            * is_quadratic[..., None]
        )
        # Axes: facet, pressure, node, direction.
        integrals = np.concatenate([corner_integrals, edge_function_integrals_over_facet], axis=2)
        rows = np.broadcast_to(twins.dofs[nodes][:, None], integrals.shape)
        patch_columns = np.broadcast_to(
            patch_index_of_facet_corner[:, :, None, None], integrals.shape
        )
        is_kept_entry = (rows >= 0) & (integrals != 0.0)
        gap += sparse.csr_matrix(
            (integrals[is_kept_entry], (rows[is_kept_entry], patch_columns[is_kept_entry])),
            gap.shape,
        )
    pressure_extension_to_front_matrix = make_matrix_extending_pressures_to_front(
        overlap_matrix[n_pairs:, :n_pairs]
    )
    patch_areas = pressure_extension_to_front_matrix.T @ patch_areas
    twin_index_of_contact_pair = np.flatnonzero(patch_areas)
    gap = (gap @ pressure_extension_to_front_matrix)[:, twin_index_of_contact_pair] @ sparse.diags(
        1.0 / patch_areas[twin_index_of_contact_pair]
    )
    return (
        gap.tocsr(),
        patch_areas[twin_index_of_contact_pair],
        twin_index_of_contact_pair,
        front_nodes,
    )


# --- of nodes -------------------------------------------------------------------------------------


def _assemble_normal_gap_matrix(
    twins: _TwinNodes, crack_dimension: int
) -> tuple[sparse.csr_matrix, np.ndarray]:
    """Assemble the normal gaps between pairs of coincident nodes, for a model without cells.

    The crack's normal at a pair is found from the nodes that the stiffness connects to the pair.

    Parameters
    ----------
    twins : _TwinNodes
        Pairs of coincident nodes.
    crack_dimension : int
        2 if crack faces are surfaces, 1 if they are lines.

    Returns
    -------
    gap : (n_dofs, n_pairs)
        Matrix B from the displacement u to the gaps B^T u.
    front_nodes : (m,) int
        Nodes on the crack fronts. The stiffness connects them to both nodes of a pair.

    Raises
    ------
    InputError
        Both nodes of a pair lie on the same side of the crack.
    """
    model_points = twins.points
    gap_matrix = sparse.lil_matrix((twins.n_dofs, len(twins.first_nodes)))
    front_nodes: list[np.ndarray] = []
    model_extent = float(np.ptp(model_points, axis=0).max())
    for pair_column, (a, b) in enumerate(zip(twins.first_nodes, twins.second_nodes, strict=True)):
        linked_nodes_of_both = [
            twins.are_nodes_linked_by_stiffness[pair_node].indices for pair_node in (a, b)
        ]
        front_nodes.append(np.intersect1d(*linked_nodes_of_both))
        nearby_crack_nodes = np.unique(np.concatenate(linked_nodes_of_both))
        nearby_crack_nodes = np.append(
            nearby_crack_nodes[twins.pair_index[nearby_crack_nodes] >= 0], front_nodes[-1]
        )
        if (
            len(np.unique(twins.coincident_group_number_of_node[nearby_crack_nodes]))
            <= crack_dimension
        ):
            nearby_crack_nodes = twins.first_nodes
        nearby_points_about_their_centre = model_points[nearby_crack_nodes] - model_points[
            nearby_crack_nodes
        ].mean(axis=0)
        tangents = np.linalg.svd(nearby_points_about_their_centre, full_matrices=False)[2][
            :crack_dimension
        ]
        pair_normal = model_points[linked_nodes_of_both[1]].mean(axis=0) - model_points[
            linked_nodes_of_both[0]
        ].mean(axis=0)
        pair_normal -= tangents.T @ (tangents @ pair_normal)
        if np.linalg.norm(pair_normal) <= RELATIVE_POSITION_TOLERANCE * model_extent:
            place_text = format_point(model_points[a], "g")
            requirement = (
                "a crack with material on both sides; or give a model file that has the elements"
            )
            raise InputError(
                "model", f"two nodes at {place_text} that lie on the same side", requirement
            )
        pair_normal /= np.linalg.norm(pair_normal)
        for pair_node, face_sign in ((a, 1.0), (b, -1.0)):
            for dof, normal_component in zip(
                twins.dofs[pair_node], face_sign * pair_normal, strict=True
            ):
                if dof >= 0 and abs(normal_component) > RELATIVE_POSITION_TOLERANCE:
                    gap_matrix[dof, pair_column] = normal_component
    return gap_matrix.tocsr(), np.unique(np.concatenate(front_nodes))
