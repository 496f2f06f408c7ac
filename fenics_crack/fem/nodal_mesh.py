"""Gather the whole mesh of a structure, for files and pictures."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.fem.cracks import FACET_CORNERS_BY_CORNER_COUNT, find_unique_rows
from fenics_crack.model.structure import Structure

_TRIANGLES_BY_NODE_COUNT = {
    3: [(0, 1, 2)],
    4: [(0, 1, 2), (0, 2, 3)],
    6: [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)],
    9: [(0, 4, 8), (4, 1, 8), (1, 5, 8), (5, 2, 8), (2, 6, 8), (6, 3, 8), (3, 7, 8), (7, 0, 8)],
}
"""Nodes of the triangles into which a plate's cell is cut for pictures, by number of nodes in a
cell."""


class NodalMesh:
    """Whole mesh of a structure, gathered on every rank.

    All ranks must create the object together. A structure made from matrices without a mesh raises
    InputError.

    Attributes
    ----------
    points : (n_nodes, d) [m]
        Node positions: d = 2 for a plate, 3 for a solid.
    cells : (n_cells, k) int
        Nodes of each cell, in VTK's order.
    vtk_type : int
        VTK's number of the cell type.
    size : float [m]
        Largest extent along x, y or z.
    is_clamped : (n_nodes,) bool
        True if no displacement component of the node is free.
    """

    def __init__(self, structure: Structure) -> None:
        if structure.nodes is None or structure.local_nodes_with_cells_or_none is None:
            requirement = (
                "a structure made from a mesh, as fc.build_structure(scene) returns for a scene "
                "with [geometry] or mesh.file"
            )
            raise InputError("structure", "made from matrices", requirement)
        whole_structure = structure.whole
        nodes, comm = structure.nodes, whole_structure.comm
        self.structure = whole_structure
        self.points = gather_rows(comm, nodes.points)
        self.size = float(np.ptp(self.points, axis=0).max())
        self._node_dofs = gather_rows(comm, nodes.dofs)
        self._frames = None if nodes.frames is None else gather_rows(comm, nodes.frames)
        self.is_clamped = np.all(self._node_dofs < 0, axis=1)
        self.cells = np.concatenate(
            [rank_cells for rank_cells in comm.allgather(nodes.cells) if len(rank_cells)]
        )
        self.vtk_type = nodes.vtk_type

    def nodal_vectors(self, dof_rows: np.ndarray) -> np.ndarray:
        """Convert values of dofs (m, n_local) to vectors at nodes (m, n_nodes, d) (collective).

        The vectors have components along x, y (and z), 0 if clamped. In a bladed disk, dofs are
        components along each sector's own axes, so the vectors are rotated.
        """
        dof_values = np.concatenate(self.structure.comm.allgather(dof_rows), axis=1)
        vectors = np.where(self._node_dofs >= 0, dof_values[:, np.maximum(self._node_dofs, 0)], 0.0)
        return vectors if self._frames is None else np.einsum("nij,mnj->mni", self._frames, vectors)

    def to_nodal_frames(self, vectors: np.ndarray) -> np.ndarray:
        """Convert vectors at nodes from components along x, y, z to components like the dofs.

        ``vectors`` and the result are (m, n_nodes, d). In a bladed disk, the dofs are components
        along each sector's own axes. In other structures the vectors come back unchanged.
        """
        frames = self._frames
        return vectors if frames is None else np.einsum("nji,mnj->mni", frames, vectors)

    @property
    def dimension(self) -> int:
        """Return the number of coordinates: 2 for a plate, 3 for a solid."""
        return int(self.points.shape[1])

    @property
    def triangles(self) -> np.ndarray:
        """Cut a plate's cells into triangles and return the nodes: (n, 3)."""
        return self.cells[:, _TRIANGLES_BY_NODE_COUNT[self.cells.shape[1]]].reshape(-1, 3)

    @cached_property
    def pair_centres_and_pressures_at_nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return patch centres and pressure functions of a solid's contact pairs, at nodes.

        A pressure function distributes a pair's contact force over the crack faces, as a pressure.
        On the pair's patch the function is not zero.

        Returns
        -------
        centre_matrix : (n_nodes, n_pairs)
            1 at the two nodes, on both crack faces, in the centre of each pair's patch; else 0.
        nodal_pressure_matrix : (n_nodes, n_pairs)
            Value of each pair's pressure function at the nodes of crack faces, linear between facet
            corners. If the structure has no ``pressure_functions_at_nodes``, the function is 1 at
            the corners nearest to the pair and 0 on fronts.
        """
        from scipy.spatial import cKDTree

        points, tolerance, structure_pairs = self.points, 1e-6 * self.size, self.structure.pairs
        corners = np.unique(crack_facets := self.crack_face_sides)
        corner_points = points[corners]
        distances_to_nearest_pair_or_edge, nearest_pair_of_corner_node = cKDTree(
            self.structure.pair_points
        ).query(corner_points)
        has_corner_node_a_twin = (
            cKDTree(corner_points).query_ball_point(corner_points, tolerance, return_length=True)
            > 1
        )
        is_pair_centre_node_matrix, nodal_pressure_matrix = np.zeros(
            (2, len(points), self.structure.n_pairs)
        )
        is_pair_centre_node_matrix[
            corners[distances_to_nearest_pair_or_edge <= tolerance],
            nearest_pair_of_corner_node[distances_to_nearest_pair_or_edge <= tolerance],
        ] = 1.0
        if (
            structure_pairs.nodes is not None
            and structure_pairs.pressure_functions_at_nodes is not None
        ):
            nodal_pressure_matrix[corners] = structure_pairs.pressure_functions_at_nodes[
                cKDTree(structure_pairs.nodes).query(corner_points)[1]
            ].toarray()
        else:
            nodal_pressure_matrix[
                corners[has_corner_node_a_twin], nearest_pair_of_corner_node[has_corner_node_a_twin]
            ] = 1.0
        edge_end_nodes = np.stack(
            [crack_facets, np.roll(crack_facets, -1, axis=1)], axis=2
        ).reshape(-1, 2)
        edge_end_nodes = (
            np.concatenate([edge_end_nodes, crack_facets[:, [0, 2]]])
            if crack_facets.shape[1] == 4
            else edge_end_nodes
        )
        non_corner_nodes = np.setdiff1d(np.arange(len(points)), corners)
        distances_to_nearest_pair_or_edge, nearest_edge_of_non_corner_node = cKDTree(
            points[edge_end_nodes].mean(axis=1)
        ).query(points[non_corner_nodes])
        is_on_edge = distances_to_nearest_pair_or_edge <= tolerance
        nodal_pressure_matrix[non_corner_nodes[is_on_edge]] = nodal_pressure_matrix[
            edge_end_nodes[nearest_edge_of_non_corner_node[is_on_edge]]
        ].mean(axis=1)
        return is_pair_centre_node_matrix, nodal_pressure_matrix

    @cached_property
    def _all_cell_sides(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return all edges of a plate's cells, or all facets of a solid's cells.

        Returns
        -------
        sides : (n, k) int
            Nodes of each edge, a middle node between the ends. For a facet, the corners in cyclic
            order.
        cell_counts : (n,) int
            Number of cells with this side: 1 on the boundary.
        cell_index : (n,) int
            First cell with this side.
        """
        n_nodes_per_cell = self.cells.shape[1]
        n_cell_corners = 3 if n_nodes_per_cell in (3, 6) else 4
        corner_indices = np.arange(n_cell_corners)
        local_sides = np.column_stack(
            [corner_indices, n_cell_corners + corner_indices, np.roll(corner_indices, -1)]
        )
        local_sides = local_sides if n_nodes_per_cell > n_cell_corners else local_sides[:, ::2]
        if self.dimension == 3:
            local_sides = FACET_CORNERS_BY_CORNER_COUNT[4 if n_nodes_per_cell in (4, 10) else 8]
        sides = self.cells[:, local_sides].reshape(-1, local_sides.shape[1])
        first_index_of_unique_side, _, n_cells_at_side = find_unique_rows(
            sides if self.dimension == 3 else sides[:, [0, -1]]
        )
        order_of_first_occurrences = np.argsort(first_index_of_unique_side)
        return (
            sides[first_index_of_unique_side[order_of_first_occurrences]],
            n_cells_at_side[order_of_first_occurrences],
            first_index_of_unique_side[order_of_first_occurrences] // len(local_sides),
        )

    @property
    def edges(self) -> np.ndarray:
        """Return the nodes of element edges in a plate: (n_edges, 2) or (n_edges, 3).

        Elements of order 2 have three nodes on an edge: the middle node between the ends.
        """
        return self._all_cell_sides[0]

    @cached_property
    def boundary_sides(self) -> np.ndarray:
        """Return the nodes of boundary edges or facets, crack faces included: (n, k) int.

        For a plate, a row has both ends of an edge; with elements of order 2, the middle node
        stands between the ends. For a solid, a row has the 3 or 4 corners of a facet, anticlockwise
        seen from outside.
        """
        sides, n_cells_at_side, cell_index = self._all_cell_sides
        sides, cells = sides[n_cells_at_side == 1], self.cells[cell_index[n_cells_at_side == 1]]
        if self.dimension == 3:
            positions_of_side_nodes, n_cell_corners = (
                self.points[sides],
                4 if sides.shape[1] == 3 else 8,
            )
            outward_vectors = positions_of_side_nodes.mean(axis=1) - self.points[
                cells[:, :n_cell_corners]
            ].mean(axis=1)
            area_normals = np.cross(
                positions_of_side_nodes[:, 1] - positions_of_side_nodes[:, 0],
                positions_of_side_nodes[:, 2] - positions_of_side_nodes[:, 0],
            )
            is_inward = (area_normals * outward_vectors).sum(axis=1) < 0.0
            sides[is_inward] = sides[is_inward, ::-1]
        return np.asarray(sides)

    @cached_property
    def crack_face_sides(self) -> np.ndarray:
        """Return the nodes of edges or facets on crack faces: (n, k) int.

        The rows are selected from ``boundary_sides``: edges of a plate, facets of a solid. An edge
        lies on a crack face if its centre coincides with the centre of another edge, on the
        opposite face. The same holds for facets.
        """
        from scipy.spatial import cKDTree  # slow to import, and few pictures need it

        side_centres = self.points[self.boundary_sides].mean(axis=1)
        coincident_side_pairs = cKDTree(side_centres).query_pairs(
            1e-6 * self.size, output_type="ndarray"
        )
        return np.asarray(self.boundary_sides[np.unique(coincident_side_pairs)])
