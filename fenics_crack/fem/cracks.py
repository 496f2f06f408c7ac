"""Find the cracks of a mesh, and double the nodes along them.

In a plate, a crack face is a chain of edges from a mouth to a tip, from tip to tip, or from mouth
to mouth. In a solid it is a surface. The rim of this surface is a front inside the solid, and a
mouth at its boundary. Nodes on a tip or front belong to both faces.

If a mesh has a crack as curve or surface inside, all nodes of the crack are doubled except those of
tips and fronts. Each cell then has one of the two nodes. A walk around the original node decides:
it goes from cell to cell across facets outside the crack, and cells that it connects share a node.
If all corners of a facet are on fronts, the facet stays whole and its nodes exist once.

The material of the lower face lies below the crack. Its outward normals, summed along the face,
point up; if the sum is level, they point to the right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
import scipy.sparse as sparse

from fenics_crack.basics.errors import InputError
from fenics_crack.model.nodes import format_point

CRACK_FACE_NAMES = ("lower_lip", "upper_lip")
"""Names of the lower and upper faces of all cracks in a mesh."""
RELATIVE_POSITION_TOLERANCE = 1e-6
"""Maximum distance between positions that count as equal, relative to the size of mesh or crack.
Text files keep six digits or more."""
RELATIVE_COINCIDENCE_TOLERANCE = 1e-3
"""Maximum distance between nodes to be merged along cracks, relative to the shortest edge. Also the
smallest relative component of a normal that is not level."""
FACET_CORNERS_BY_CORNER_COUNT = {
    4: np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]),
    8: np.array(
        [[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    ),
}
"""Corners of each facet of a solid's cell, in cyclic order, by the cell's number of corners."""


@dataclass(frozen=True)
class CrackPath:
    """Path of a crack in a plate, a chain of straight edges.

    Attributes
    ----------
    points : (n, 2) [m]
        Corners from the mouth to the tip; for a crack inside, from the left tip to the right tip.
        A straight path has only two points, the ends.
    has_mouth : bool
        True if the path begins at the edge of the plate.
    """

    points: np.ndarray
    has_mouth: bool

    @property
    def edges(self) -> np.ndarray:
        """Return start and end point of each edge: (n - 1, 2, 2) [m]."""
        return np.stack([self.points[:-1], self.points[1:]], axis=1)

    @property
    def corner_arc_lengths(self) -> np.ndarray:
        """Return the distance of each corner from the first point, along the path: (n,) [m]."""
        edge_lengths = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(edge_lengths)])

    @property
    def watched_name_and_distance(self) -> tuple[str, float]:
        """Return the name of the watched contact pair, and the distance along the path [m].

        Results report this pair. It is at the mouth, distance 0, or for a crack inside in the
        middle.
        """
        if self.has_mouth:
            return "the mouth", 0.0
        return "the middle", 0.5 * self.corner_arc_lengths[-1]

    def find_distances_and_positions(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the nearest point on the path for each of n points (n, 2) [m].

        Returns
        -------
        distances : (n,) [m]
            Distance between each point and the path.
        positions : (n,) [m]
            Distance along the path from the first point to the nearest point.
        """
        distances_to_edges, edge_fractions = _distances_and_fractions_on_edges(points, self.edges)
        corner_arc_lengths = self.corner_arc_lengths
        nearest_arc_lengths = corner_arc_lengths[:-1] + edge_fractions * np.diff(corner_arc_lengths)
        edge_index, point_index = distances_to_edges.argmin(axis=1), np.arange(len(points))
        return distances_to_edges[point_index, edge_index], nearest_arc_lengths[
            point_index, edge_index
        ]

    def points_beside(self, point: Sequence[float]) -> tuple[list[float], list[float]] | None:
        """Return a point below and a point above a given point on the crack [m].

        Used to propose a point on either crack face in an error message. Both results lie 1e-3 of
        the crack's length away. The result is None if the given point is at a tip, or farther from
        the crack than 1e-6 of the length.
        """
        (distance_to_crack,), (arc_length,) = self.find_distances_and_positions(np.array([point]))
        path_length = float(self.corner_arc_lengths[-1])
        tip_distance = (
            path_length - arc_length
            if self.has_mouth
            else min(arc_length, path_length - arc_length)
        )
        edge_index = np.searchsorted(self.corner_arc_lengths[1:-1], arc_length)
        return _points_on_both_sides(
            point,
            distance_to_crack,
            tip_distance,
            size_weighted_normals(self.edges[[edge_index]])[0],
            path_length,
        )


@dataclass(frozen=True)
class CrackSurface:
    """Surface of a crack in a solid, as triangles with front and mouth.

    Attributes
    ----------
    triangle_corner_points : (n, 3, 3) [m]
        Corners of the triangles on the lower face. Quadrilaterals are cut into two triangles.
    front_chords : (m, 2, 3) [m]
        End points of element edges along the front. Empty if the crack separates two bodies.
    has_mouth : bool
        True if the crack reaches the solid's surface.
    """

    triangle_corner_points: np.ndarray
    front_chords: np.ndarray
    has_mouth: bool

    @property
    def watched_name_and_distance(self) -> tuple[str, float]:
        """Return the name of the watched contact pair, and infinity as distance from the front.

        Results report this pair. Infinity selects the pair farthest from the front.
        """
        return "the mouth" if self.has_mouth else "the middle", np.inf

    @property
    def size(self) -> float:
        """Return the crack's largest extent along x, y or z [m]."""
        return float(np.ptp(self.triangle_corner_points.reshape(-1, 3), axis=0).max())

    def find_distances_and_positions(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances of points (n, 3) [m] from the crack's surface and front.

        Returns
        -------
        distances : (n,) [m]
            Distance between each point and the surface.
        front_distances : (n,) [m]
            Distance between each point and the front, at most twice the crack's size. Without a
            front all distances are this maximum.
        """
        from fenics_crack.fem.solid_mesher import point_to_triangle_distances  # it imports gmsh

        surface_distances, front_distances = np.empty(len(points)), np.empty(len(points))
        # Limit the memory: two million distances at a time.
        block_size = max(
            1, 2_000_000 // max(len(self.triangle_corner_points), len(self.front_chords))
        )
        for block_start in range(0, len(points), block_size):
            point_slice = slice(block_start, block_start + block_size)
            surface_distances[point_slice] = point_to_triangle_distances(
                points[point_slice], self.triangle_corner_points
            ).min(axis=1)
            front_edge_distances, _ = _distances_and_fractions_on_edges(
                points[point_slice], self.front_chords
            )
            # The bound is larger than any distance between the surface and its front.
            front_distances[point_slice] = front_edge_distances.min(axis=1, initial=2.0 * self.size)
        return surface_distances, front_distances

    def points_beside(self, point: Sequence[float]) -> tuple[list[float], list[float]] | None:
        """Return a point below and a point above a given point on the crack [m].

        Used to propose a point on either crack face in an error message. Both results lie 1e-3 of
        the crack's size away. The result is None if the given point is on a front, or farther from
        the crack than 1e-6 of the size.
        """
        from fenics_crack.fem.solid_mesher import point_to_triangle_distances  # it imports gmsh

        position = np.asarray(point, dtype=float)
        (distance_to_crack,), (front_distance,) = self.find_distances_and_positions(position[None])
        nearest_triangle = point_to_triangle_distances(
            position[None], self.triangle_corner_points
        ).argmin()
        normal = size_weighted_normals(self.triangle_corner_points[[nearest_triangle]])[0]
        return _points_on_both_sides(point, distance_to_crack, front_distance, normal, self.size)


def size_weighted_normals(facets: np.ndarray) -> np.ndarray:
    """Return a normal for each edge (n, 2, 2) or triangle (n, 3, 3): (n, 2) or (n, 3).

    ``facets`` [m] are the corner positions. A normal's length is the edge's length [m], or twice
    the triangle's area [m^2]. The direction follows the order of corners.
    """
    sides = facets[:, 1:] - facets[:, :1]
    if facets.shape[2] == 2:
        return np.asarray(sides[:, 0] @ [[0.0, -1.0], [1.0, 0.0]])
    return np.asarray(np.cross(sides[:, 0], sides[:, 1]))


Cracks = tuple[CrackPath, ...] | tuple[CrackSurface, ...]
"""Crack paths of a plate, or crack surfaces of a solid."""
NamedParts = tuple[dict[str, tuple[int, ...]], dict[str, tuple[float, ...]]]
"""gmsh's facet group tags by name of a curve or surface, and positions by name of a point [m]."""


def _distances_and_fractions_on_edges(
    points: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find the nearest point on each of m edges (m, 2, d) to each of n points (n, d).

    Returns
    -------
    distances : (n, m)
        Distance between the edge and the given point.
    fractions : (n, m)
        Position of the nearest point on the edge, from 0 at the start to 1 at the end.
    """
    edge_vectors = edges[:, 1] - edges[:, 0]
    start_offsets = points[:, None] - edges[:, 0]
    fractions = np.clip(
        (start_offsets * edge_vectors).sum(axis=2) / (edge_vectors**2).sum(axis=1), 0.0, 1.0
    )
    offsets = start_offsets - fractions[..., None] * edge_vectors
    return np.linalg.norm(offsets, axis=2), fractions


def _points_on_both_sides(
    point: Sequence[float],
    distance_to_crack: float,
    front_distance: float,
    crack_normal: np.ndarray,
    crack_size: float,
) -> tuple[list[float], list[float]] | None:
    """Return two points next to a point on a crack, below and above it.

    Parameters
    ----------
    point : sequence of float [m]
        Point on the crack.
    distance_to_crack, front_distance : float [m]
        Distance from the point to the crack, and to the tip or front.
    crack_normal : (d,)
        Normal of the crack at the point, in either direction and of any length.
    crack_size : float [m]
        Extent of the crack. The results are 1e-3 of this size from the point.

    Returns
    -------
    (lower_point, upper_point) or None
        Two lists of float [m]. None if ``distance_to_crack`` is above 1e-6 of the size, or
        ``front_distance`` below.
    """
    tolerance = RELATIVE_POSITION_TOLERANCE * crack_size
    if distance_to_crack > tolerance or front_distance <= tolerance:
        return None
    offset_to_upper_point = (
        1e-3 * crack_size * upward_sign(crack_normal) * crack_normal / np.linalg.norm(crack_normal)
    )
    return np.round(point - offset_to_upper_point, 9).tolist(), np.round(
        point + offset_to_upper_point, 9
    ).tolist()


def make_matrix_extending_pressures_to_front(overlaps: sparse.csr_matrix) -> sparse.csr_matrix:
    """Return the matrix that distributes the pressure functions of front nodes to neighbours.

    A pressure function distributes a node's contact force over the crack face, as a pressure. Nodes
    on a front have no contact force, so neighbours inside the crack take over the pressure
    functions of front nodes. A neighbour's share is proportional to the overlap: the integral over
    both nodes' basis functions, multiplied by each other.

    Parameters
    ----------
    overlaps : (n_front, n_inside)
        Overlaps between basis functions at front nodes and at nodes inside the crack.

    Returns
    -------
    (n_inside + n_front, n_inside)
        Identity for the nodes inside. Then, for each front node, a row with the shares of the nodes
        inside; the sum is 1.
    """
    inverse_row_sums = sparse.diags(1.0 / np.asarray(overlaps.sum(axis=1)).ravel())
    return sparse.vstack([sparse.eye(overlaps.shape[1]), inverse_row_sums @ overlaps]).tocsr()


def upward_sign(normal: np.ndarray) -> float:
    """Return 1 if a normal (2,) or (3,) points up, otherwise -1.

    Up means along y. If the component along y is below 1e-3 of the largest one, the sign is that of
    the component along x, or else z.
    """
    for axis_index in (1, 0, 2)[: len(normal)]:
        if abs(normal[axis_index]) > RELATIVE_COINCIDENCE_TOLERANCE * np.abs(normal).max():
            return float(np.sign(normal[axis_index]))
    return 1.0


def locate_on_cracks(cracks: Sequence[Any], points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the crack nearest to each point (n, d) [m], and the position on the crack.

    ``cracks`` are paths in a plate, or surfaces in a solid.

    Returns
    -------
    nearest_crack_of_point : (n,) int
        Index of the nearest crack.
    positions : (n,) [m]
        In a plate: distance along the path from its first point. In a solid: distance from the
        front.
    """
    distances_to_cracks, positions_on_cracks = np.array(
        [crack.find_distances_and_positions(points) for crack in cracks]
    ).transpose(1, 0, 2)
    nearest_crack_of_point = distances_to_cracks.argmin(axis=0)
    return nearest_crack_of_point, positions_on_cracks[
        nearest_crack_of_point, np.arange(len(points))
    ]


def label_connected_rows(node_rows: np.ndarray) -> np.ndarray:
    """Label connected rows of node numbers, such as facets: (n,) int.

    ``node_rows`` (n, k) has k nodes for each facet. Two rows have the same label if a chain of rows
    with common nodes connects them. Labels count from 0.
    """
    from scipy.sparse.csgraph import connected_components  # slow to import, and few meshes need it

    link_ends = node_rows[:, :-1].ravel(), node_rows[:, 1:].ravel()
    n_node_numbers = int(node_rows.max(initial=0)) + 1
    node_link_graph = sparse.coo_matrix(
        (np.ones(len(link_ends[0]), bool), link_ends), (n_node_numbers, n_node_numbers)
    )
    row_labels = connected_components(node_link_graph, directed=False)[1][node_rows[:, 0]]
    return np.unique(row_labels, return_inverse=True)[1]


def find_unique_rows(node_rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the distinct rows among rows of nodes (n, k).

    The order of nodes in a row does not matter.

    Returns
    -------
    first_rows : (n_unique,) int
        Index of the first occurrence of each distinct row.
    unique_row_of_row : (n,) int
        Index of each row among the distinct rows.
    unique_row_counts : (n_unique,) int
        Number of occurrences of each distinct row.
    """
    _, first_rows, unique_row_of_row, unique_row_counts = np.unique(
        np.sort(node_rows, axis=1),
        axis=0,
        return_index=True,
        return_inverse=True,
        return_counts=True,
    )
    return first_rows, unique_row_of_row.ravel(), unique_row_counts


def count_equal_rows(rows: np.ndarray) -> np.ndarray:
    """Return how often each row of nodes occurs among all rows: (n,) int.

    The order of nodes in a row does not matter.
    """
    _, index_of_unique_row, counts = find_unique_rows(rows)
    return np.asarray(counts[index_of_unique_row])


def are_rows_in(node_rows: np.ndarray, other_node_rows: np.ndarray) -> np.ndarray:
    """Return True for each row of ``node_rows`` that ``other_node_rows`` has, too: (n,) bool.

    A row has k nodes, in any order. The arrays are (n, k) and (m, k).
    """
    _, unique_row_of_row, _ = find_unique_rows(np.concatenate([other_node_rows, node_rows]))
    return np.asarray(
        np.isin(
            unique_row_of_row[len(other_node_rows) :], unique_row_of_row[: len(other_node_rows)]
        )
    )


# --- cracks of given faces ------------------------------------------------------------------------


def find_crack_paths(
    lower_edges: np.ndarray, upper_edges: np.ndarray, positions: np.ndarray
) -> tuple[CrackPath, ...]:
    """Return the paths of all cracks in a plate from the edges of both crack faces.

    Paths are sorted by the first point, from bottom to top, then from left to right.

    Parameters
    ----------
    lower_edges, upper_edges : (n, 2) int
        Nodes of each edge on the lower and upper faces.
    positions : (n_nodes, 2) [m]
        Node positions.

    Raises
    ------
    InputError
        The two faces are the same curve, or a crack branches or is closed.
    """
    nodes_on_both_faces = np.intersect1d(lower_edges, upper_edges)
    if len(nodes_on_both_faces) == len(np.unique(lower_edges)):
        requirement = (
            "different nodes at the same places, except at the tips; or name one curve 'crack'"
        )
        raise InputError("lips", "the same nodes for 'lower_lip' and 'upper_lip'", requirement)
    crack_paths = []
    _check_cracks_do_not_branch(lower_edges, nodes_on_both_faces, positions)
    # Cracks that share a tip are different: number the tips of each edge anew.
    distinct_tip_numbers = len(positions) + np.arange(lower_edges.size).reshape(lower_edges.shape)
    is_tip = np.isin(lower_edges, nodes_on_both_faces)
    node_of_number = np.append(np.arange(len(positions)), lower_edges.ravel())
    for chain_numbers in find_node_chains(np.where(is_tip, distinct_tip_numbers, lower_edges)):
        chain_nodes = node_of_number[chain_numbers]
        if chain_nodes[0] == chain_nodes[-1]:
            requirement = (
                "cracks with two ends; a closed curve would cut a piece out of the structure"
            )
            raise InputError("lips", "a closed curve", requirement)
        first_end_position, last_end_position = (
            tuple(positions[chain_nodes[end_index]]) for end_index in (0, -1)
        )
        are_ends_at_mouths = (
            chain_nodes[0] not in nodes_on_both_faces,
            chain_nodes[-1] not in nodes_on_both_faces,
        )
        is_reversed = (
            last_end_position < first_end_position
            if are_ends_at_mouths[0] == are_ends_at_mouths[1]
            else are_ends_at_mouths[1]
        )
        path_points = positions[chain_nodes[::-1] if is_reversed else chain_nodes]
        crack_paths.append(CrackPath(path_points, any(are_ends_at_mouths)))
    return tuple(sorted(crack_paths, key=lambda crack_path: tuple(crack_path.points[0, ::-1])))


def _check_cracks_do_not_branch(
    edges: np.ndarray, tip_nodes: np.ndarray, positions: np.ndarray
) -> None:
    """Raise InputError if more than two edges of a crack face meet at a node.

    The crack would branch or cross another crack there.

    Parameters
    ----------
    edges : (n, 2) int
        Nodes of each edge on one face of all cracks.
    tip_nodes : (m,) int
        Nodes shared by both faces. At these nodes any number of edges may meet.
    positions : (n_nodes, 2) [m]
        Node positions.
    """
    edge_nodes, n_edges_at_nodes = np.unique(edges, return_counts=True)
    for edge_node, n_node_edges in zip(edge_nodes, n_edges_at_nodes, strict=True):
        if n_node_edges > 2 and edge_node not in tip_nodes:
            problem = (
                f"{n_node_edges} edges of a crack face at {format_point(positions[edge_node], 'g')}"
            )
            requirement = "cracks that neither branch nor cross; draw each crack as a single line"
            raise InputError("lips", problem, requirement)


def find_node_chains(edges: np.ndarray) -> list[np.ndarray]:
    """Connect edges (n, 2) to chains of nodes.

    An open chain begins at the end with the lower number. A closed chain begins at the lowest
    number, and ends with the same node. Open chains come first, each kind sorted by the first node.
    """
    from scipy.sparse.csgraph import depth_first_order

    edge_labels, chains = label_connected_rows(edges), []
    for label in range(edge_labels.max(initial=-1) + 1):
        chain_edges = edges[edge_labels == label]
        nodes, edge_ends, n_edges_at_nodes = np.unique(
            chain_edges, return_inverse=True, return_counts=True
        )
        end_node_indices = np.flatnonzero(n_edges_at_nodes == 1)
        graph_triplets = np.ones(len(chain_edges)), tuple(edge_ends.reshape(-1, 2).T)
        graph = sparse.csr_matrix(graph_triplets, (len(nodes), len(nodes)))
        first_node_index = end_node_indices[0] if len(end_node_indices) else 0
        chain = nodes[depth_first_order(graph, first_node_index, directed=False)[0]]
        chains.append(chain if len(end_node_indices) else np.append(chain, chain[0]))
    return sorted(chains, key=lambda chain: (chain[0] == chain[-1], chain[0]))


def find_crack_surfaces(
    lower_facets: np.ndarray, upper_facets: np.ndarray, positions: np.ndarray
) -> tuple[CrackSurface, ...]:
    """Return the surfaces of all cracks in a solid from the facets of both crack faces.

    Surfaces are sorted from bottom to top.

    Parameters
    ----------
    lower_facets, upper_facets : (m, k), (m', k) int
        Corner nodes of the facets on each face. Both faces share only nodes on fronts.
    positions : (n_nodes, 3) [m]
        Node positions.
    """
    polygon_edges, edge_facet_counts = np.unique(
        _edges_of_polygons(lower_facets), axis=0, return_counts=True
    )
    rim_edges = polygon_edges[edge_facet_counts == 1]
    is_front_edge = np.isin(rim_edges, upper_facets).all(axis=1)
    facet_labels, crack_surfaces = label_connected_rows(lower_facets), []
    triangle_corner_columns = [[0, 1, 2], [0, 2, 3]][: lower_facets.shape[1] - 2]
    for crack_index in range(facet_labels.max() + 1):
        crack_facets = lower_facets[facet_labels == crack_index]
        is_edge_on_crack = np.isin(rim_edges, crack_facets).all(axis=1)
        triangle_positions = positions[
            np.concatenate(
                [
                    crack_facets[:, columns_of_triangle_corners]
                    for columns_of_triangle_corners in triangle_corner_columns
                ]
            )
        ]
        front_edge_end_points = positions[rim_edges[is_edge_on_crack & is_front_edge]]
        crack_surfaces.append(
            CrackSurface(
                triangle_positions,
                front_edge_end_points,
                bool(np.any(is_edge_on_crack & ~is_front_edge)),
            )
        )
    crack_surfaces.sort(
        key=lambda crack: tuple(crack.triangle_corner_points.mean(axis=(0, 1))[[1, 0, 2]])
    )
    return tuple(crack_surfaces)


# --- doubling nodes along cracks ------------------------------------------------------------------


@dataclass(frozen=True)
class Cells:
    """Cells of a mesh, all of the same kind, in a plate or solid.

    Attributes
    ----------
    cell_nodes : (n_cells, k) int
        Nodes in gmsh's order: corners first.
    facet_corner_columns : (n_facets, n) int
        Corners of each facet of a cell, as columns of ``cell_nodes``.
    is_corner_function_nonzero_at_node : (k, n_corners) bool
        Row for each node of a cell: True for the corners with a nonzero linear basis function
        there. A middle node has the two ends of the edge.
    """

    cell_nodes: np.ndarray
    facet_corner_columns: np.ndarray
    is_corner_function_nonzero_at_node: np.ndarray

    @property
    def n_corners(self) -> int:
        """Return the number of corners of a cell."""
        return int(self.facet_corner_columns.max()) + 1

    @cached_property
    def sorted_facets_and_owners(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the facets of all cells, sorted so that equal facets are neighbours.

        A facet between two cells occurs twice, a facet on the boundary once.

        Returns
        -------
        facets : (n, m) int
            Corner nodes of each facet, in ascending order.
        owner : (n,) int
            Cell that has the facet.
        local_corners : (n, m) int
            For each corner, the column in ``cell_nodes`` of the owner.
        """
        facet_corners = self.cell_nodes[:, self.facet_corner_columns].reshape(
            -1, self.facet_corner_columns.shape[1]
        )
        corner_order = np.argsort(facet_corners, axis=1)
        local_corners = np.take_along_axis(
            np.tile(self.facet_corner_columns, (len(self.cell_nodes), 1)), corner_order, axis=1
        )
        facet_corners = np.take_along_axis(facet_corners, corner_order, axis=1)
        facet_order = np.lexsort(facet_corners.T[::-1])
        return (
            facet_corners[facet_order],
            facet_order // len(self.facet_corner_columns),
            local_corners[facet_order],
        )

    @cached_property
    def is_facet_equal_to_next(self) -> np.ndarray:
        """Return True for each facet that equals the next facet: (n - 1,) bool.

        The facets are in the order of ``sorted_facets_and_owners``. Equal facets belong to two
        cells.
        """
        facets = self.sorted_facets_and_owners[0]
        return np.asarray(np.all(facets[1:] == facets[:-1], axis=1))

    @cached_property
    def is_boundary_facet(self) -> np.ndarray:
        """Return True for each facet of a single cell, on the mesh's boundary: (n,) bool.

        The facets are in the order of ``sorted_facets_and_owners``.
        """
        is_shared = np.concatenate([[False], self.is_facet_equal_to_next, [False]])
        return ~(is_shared[1:] | is_shared[:-1])


def merge_crack_nodes(
    crack_facets: np.ndarray, positions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Merge coincident nodes along cracks, so that every crack node is single.

    gmsh's plugin "Crack" may have doubled nodes already; :func:`split_cracks` needs a mesh without
    doubled nodes.

    Parameters
    ----------
    crack_facets : (m, k) int
        Nodes of the facets on all cracks.
    positions : (n_nodes, d) [m]
        Node positions.

    Returns
    -------
    kept_nodes : (n_kept,) int
        Nodes that remain after the merge.
    node_map : (n_nodes,) int
        New number of each old node: the index in ``kept_nodes``.
    """
    from scipy.spatial import cKDTree  # slow to import, and only mesh files need it

    edge_lengths = np.linalg.norm(
        positions[crack_facets[:, 0]] - positions[crack_facets[:, 1]], axis=1
    )
    node_map = np.arange(len(positions))
    crack_node_positions = positions[np.unique(crack_facets)]
    for coincident_nodes in cKDTree(positions).query_ball_point(
        crack_node_positions, RELATIVE_COINCIDENCE_TOLERANCE * float(edge_lengths.min())
    ):
        node_map[coincident_nodes] = min(coincident_nodes)
    return np.unique(node_map, return_inverse=True)


def split_cracks(
    cells: Cells, crack_facets: np.ndarray, positions: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Double the nodes along cracks, except at tips and fronts.

    Parameters
    ----------
    cells : Cells
        Cells of the mesh; nodes are rows of ``positions``.
    crack_facets : (m, k) int
        Nodes of the facets of all cracks, corners first.
    positions : (n_nodes, d) [m]
        Node positions.

    Returns
    -------
    nodes : (n_cells, k) int
        Nodes of the cells. Cells above a crack have new nodes, numbered after the old ones.
    copied_nodes : (n_new,) int
        Original of each new node.
    lips : (m', 2, k) int
        Facets of the lower face, and the coincident facets of the upper face.

    Raises
    ------
    InputError
        A crack's facet is not between two cells. Or a crack branches, crosses another crack, does
        not have two sides, or has all nodes on the front.
    """
    n_corners = cells.facet_corner_columns.shape[1]
    facet_word = ("edges", "facets")[positions.shape[1] - 2]
    crack_facet_corners, unique_facet_index = np.unique(
        np.sort(crack_facets[:, :n_corners], axis=1), axis=0, return_index=True
    )
    crack_facets = crack_facets[unique_facet_index]  # in the same order as the sorted facets
    (facets, owner, local_corners), is_facet_equal_to_next = (
        cells.sorted_facets_and_owners,
        cells.is_facet_equal_to_next,
    )
    is_crack_node = np.isin(np.arange(len(positions)), crack_facet_corners)
    is_crack_facet = is_crack_node[facets].all(axis=1)
    is_crack_facet[is_crack_facet] = are_rows_in(facets[is_crack_facet], crack_facet_corners)
    inner_facets = np.flatnonzero(is_facet_equal_to_next & is_crack_facet[:-1])
    check_mesh(
        len(inner_facets) == len(crack_facets),
        f"{len(crack_facets) - len(inner_facets)} of the {len(crack_facets)} {facet_word}"
        " of cracks not between cells",
        f"a mesh whose cracks are inside the structure, with a cell on either side of {facet_word}",
    )
    outer_facets = facets[cells.is_boundary_facet & is_crack_node[facets].any(axis=1)]
    is_split_node = is_crack_node.copy()
    is_split_node[_front_edges_or_tips(crack_facets[:, :n_corners], outer_facets)] = False
    facet_labels = label_connected_rows(crack_facet_corners)
    labels_of_unsplit_cracks = np.setdiff1d(
        facet_labels, facet_labels[is_split_node[crack_facet_corners].any(axis=1)]
    )
    check_mesh(
        not len(labels_of_unsplit_cracks), "all nodes of a crack on its front", "a finer mesh"
    )

    # Each crack facet has two sides. Sides are connected if they share a star, the set of cells
    # around a node that is not cut by the crack.
    star_labels = _label_corner_stars(
        cells, is_facet_equal_to_next & ~is_crack_facet[:-1], is_split_node
    ).reshape(-1, cells.n_corners)
    side_facet_index = np.concatenate([inner_facets, inner_facets + 1])
    cell_of_facet_side, is_fixed_corner = (
        owner[side_facet_index],
        ~is_split_node[facets[side_facet_index]],
    )
    side_corner_stars = star_labels[cell_of_facet_side[:, None], local_corners[side_facet_index]]
    side_corner_stars[is_fixed_corner] = star_labels.size + np.arange(is_fixed_corner.sum())
    side_labels = label_connected_rows(side_corner_stars)
    side_label_pairs = np.unique(np.sort(np.split(side_labels, 2), axis=0), axis=1)  # in pairs
    is_split_corner = is_split_node[cells.cell_nodes[:, : cells.n_corners]]
    check_mesh(
        side_label_pairs.size == side_labels.max() + 1
        and np.all(side_label_pairs[0] != side_label_pairs[1])
        and np.all(np.isin(star_labels[is_split_corner], side_corner_stars)),
        "not two sides everywhere along a crack",
        "a mesh whose cracks neither branch nor cross, and end inside or at the boundary",
    )
    side_corner_positions = np.tile(positions[crack_facets[:, :n_corners]], (2, 1, 1))
    outward_normals = size_weighted_normals(side_corner_positions)
    cell_offsets = positions[cells.cell_nodes[cell_of_facet_side, : cells.n_corners]].mean(
        axis=1
    ) - side_corner_positions.mean(axis=1)
    outward_normals[(cell_offsets * outward_normals).sum(axis=1) > 0.0] *= -1.0
    side_normals = np.zeros((side_label_pairs.size, positions.shape[1]))
    np.add.at(side_normals, side_labels, outward_normals)
    is_first_side_lower = np.array(
        [upward_sign(side_normal) > 0.0 for side_normal in side_normals[side_label_pairs[0]]]
    )
    upper_side_labels = np.where(is_first_side_lower, side_label_pairs[1], side_label_pairs[0])
    is_upper_corner = is_split_corner & np.isin(
        star_labels, side_corner_stars[np.isin(side_labels, upper_side_labels)]
    )
    # A node between corners is doubled if any of these corners is.
    is_crack_node[crack_facets] = True
    has_node_upper_corner = is_upper_corner @ cells.is_corner_function_nonzero_at_node.T
    is_node_above = is_crack_node[cells.cell_nodes] & has_node_upper_corner
    copied_nodes, node_map = np.unique(cells.cell_nodes[is_node_above]), np.arange(len(positions))
    node_map[copied_nodes] = len(positions) + np.arange(len(copied_nodes))
    lower_facets = crack_facets[is_split_node[crack_facets[:, :n_corners]].any(axis=1)]
    nodes = np.where(is_node_above, node_map[cells.cell_nodes], cells.cell_nodes)
    return nodes, copied_nodes, np.stack([lower_facets, node_map[lower_facets]], axis=1)


def check_mesh(is_mesh_valid: object, problem_text: str, requirement: str) -> None:
    """Raise InputError for the key "mesh" if ``is_mesh_valid`` is false.

    The error's texts are ``problem_text``, the fault in the mesh, and ``requirement``, the allowed
    meshes.
    """
    if not is_mesh_valid:
        raise InputError("mesh", problem_text, requirement)


def _edges_of_polygons(polygons: np.ndarray) -> np.ndarray:
    """Return the edges of polygons (n, k), each with nodes in ascending order: (n k, 2)."""
    polygon_edges = np.stack([polygons, np.roll(polygons, -1, axis=1)], axis=2)
    return np.sort(polygon_edges.reshape(-1, 2), axis=1)


def _front_edges_or_tips(crack_facets: np.ndarray, boundary_facets: np.ndarray) -> np.ndarray:
    """Return the edges on crack fronts of a solid, or the nodes at crack tips of a plate.

    An edge is on a front if a single crack facet and no facet of the mesh's boundary has the edge.
    A tip is found in the same way from nodes.

    Parameters
    ----------
    crack_facets, boundary_facets : (n, k), (m, k) int
        Corner nodes of the facets on cracks, and of the facets on the mesh's boundary.

    Returns
    -------
    (n_edges, 2) or (n_tips, 1) int
        Nodes of each edge in a solid, or node of each tip in a plate.

    Raises
    ------
    InputError
        More than two crack facets meet at an edge or node.
    """
    n_corners = crack_facets.shape[1]
    edges_or_nodes = (
        crack_facets.reshape(-1, 1) if n_corners == 2 else _edges_of_polygons(crack_facets)
    )
    edges_or_nodes, facet_counts = np.unique(edges_or_nodes, axis=0, return_counts=True)
    requirement = "a mesh whose cracks neither branch nor cross"
    check_mesh(np.all(facet_counts <= 2), "more than two sides of a crack meeting", requirement)
    rim_edges_or_nodes = edges_or_nodes[facet_counts == 1]
    # The four sorted corners of a quadrilateral are not in cyclic order: take all pairs.
    mesh_boundary_edges_or_nodes = [
        boundary_facets[:, corner_columns]
        for corner_columns in combinations(range(n_corners), edges_or_nodes.shape[1])
    ]
    return np.asarray(
        rim_edges_or_nodes[
            ~are_rows_in(rim_edges_or_nodes, np.concatenate(mesh_boundary_edges_or_nodes))
        ]
    )


def _label_corner_stars(
    cells: Cells, is_passable: np.ndarray, is_split_node: np.ndarray
) -> np.ndarray:
    """Label the corners of all cells; corners with equal labels keep a common node.

    Used to split a mesh along cracks. At a node to be doubled, cells on opposite sides of the crack
    get different labels. Two cells get the same label if a chain of cells around the node connects
    them. Neighbours in the chain share a facet that has the node and is not on a crack. At all
    other nodes every corner has a different label.

    Parameters
    ----------
    cells : Cells
        The mesh's cells.
    is_passable : (n_facets - 1,) bool
        True for a facet between two cells that is not on a crack. Facets are in the order of
        ``cells.sorted_facets_and_owners``.
    is_split_node : (n_nodes,) bool
        True for nodes to be doubled.

    Returns
    -------
    (n_cells n_corners,) int
        Label of each corner, cell after cell.
    """
    from scipy.sparse.csgraph import connected_components

    sorted_facets, cell_of_sorted_facet, local_corners = cells.sorted_facets_and_owners
    passable_facets = np.flatnonzero(is_passable & is_split_node[sorted_facets[:-1]].any(axis=1))
    is_split_corner = is_split_node[sorted_facets[passable_facets]]
    flat_corner_index, neighbour_corner_index = (
        cell_of_sorted_facet[sorted_facet_indices][:, None] * cells.n_corners
        + local_corners[sorted_facet_indices]
        for sorted_facet_indices in (passable_facets, passable_facets + 1)
    )
    n_all_corners = len(cells.cell_nodes) * cells.n_corners
    graph_triplets = (
        np.ones(int(is_split_corner.sum()), dtype=np.int8),
        (flat_corner_index[is_split_corner], neighbour_corner_index[is_split_corner]),
    )
    return np.asarray(
        connected_components(sparse.coo_matrix(graph_triplets, (n_all_corners, n_all_corners)))[1]
    )
