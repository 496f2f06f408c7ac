"""Compute stress intensities along crack fronts in solids.

They are linear functionals of the displacement. The front is a curve with unit vectors e_1, e_2,
e_3, coordinates xi, y, s along them and curvature kappa (:mod:`fenics_crack.fem.fronts`);
g = 1 + kappa xi, and k = kappa / g. Let a = a_i(xi, y) e_i be the plane field with unit K_I, K_II
(plane strain) or K_III, and the gradient

    a_i,1 = d_xi a_i,   a_i,2 = d_y a_i,   a_1,3 = -kappa a_3 / g,   a_3,3 = kappa a_1 / g,

and the stress S = C sym grad a. The front is extended virtually by Q = q(r / R) h(s) e_1, with r =
(xi^2 + y^2)^1/2, the radius R of the domain and a hat function h. The interaction integral is

    I = int [sigma(u)_ij a_i,k Q_k,j + S_ij u_i,k Q_k,j - sigma(u) : grad a div Q] dV
        + int [(div S)_i u_i,1 + rho u''_i a_i,1] Q_1 dV
        - int [(S m)_i u_i,1 - S : grad u m_1] Q_1 dA
        + (2 / pi)^1/2 2 (1 - nu^2) / E int p Q_1 r^-1/2 dA,

with the outward normal m of the solid's surface and of the crack faces, and the contact pressure p
on these faces. The stress intensities are

    K_I, K_II = E / (2 (1 - nu^2)) I / int h ds,      K_III = mu I / int h ds.

Inertia and other volume forces act as nodal forces. Let w hold the nodal values of Q_1 a_,1. Then
these forces contribute -w . (K u + B lambda), and I is linear in the displacement and the contact
forces.

At a closed front K_I is zero. Two measures ensure this: triangles at the front are mapped to the
curve, and the pressure is the pressure of the contact patches.

References
----------
Nakamura and Parks, International Journal of Solids and Structures 25, 1989, 1411.
Gosz and Moran, Engineering Fracture Mechanics 69, 2002, 299: curved fronts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree
from scipy.special import roots_jacobi

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.basics.tables import format_quantity
from fenics_crack.fem.cracks import RELATIVE_POSITION_TOLERANCE, CrackSurface, count_equal_rows
from fenics_crack.fem.fronts import Front, find_fronts
from fenics_crack.fem.interaction_integral import Station, find_weight_and_slope
from fenics_crack.model.nodes import Nodes, format_point
from fenics_crack.model.receptance import check_has_matrices
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene

MAX_ELEMENT_LENGTH_TO_RADIUS = 1.25
"""Maximum element length along the front, relative to the integration domain's radius. At the limit
K is in error by up to 20 %, allowed on the coarser mesh of an error estimate."""
GAUSS_POINTS_AT_FRONT, GAUSS_POINTS_ELSEWHERE = 6, 5
"""Gauss points per direction, in cells at the front and in other cells. At the front, 4 points give
1 to 3 % noise in K. Elsewhere, 5 points change K by 0.1 %, and 4 points by 0.3 %."""
MAX_POINTS_IN_MEMORY = 100_000
"""Maximum number of quadrature points with arrays in memory at the same time."""


def front_functionals(
    scene: Scene, structure: Structure
) -> tuple[list[Station], np.ndarray, np.ndarray]:
    """Return the stations of all fronts, and the factors for K_I, K_II and K_III (collective).

    Stations are points on a crack front at which the stress intensities K_I, K_II and K_III are
    computed. Stations at corners of a front are left out. With the displacement u and the contact
    forces lambda, the stress intensities are ``displacement_factors`` u + ``force_factors`` lambda.

    Parameters
    ----------
    scene : Scene
        Solid with a crack.
    structure : Structure
        Structure of the scene, not reduced.

    Returns
    -------
    stations : list of Station
        Stations, front after front.
    displacement_factors : (3 n_stations, n_local) [Pa m^1/2 / m]
        Factors of this rank's displacement u. Each station has three rows: K_I, K_II and K_III.
    force_factors : (3 n_stations, n_pairs) [Pa m^1/2 / N]
        Factors of the pairs' contact forces lambda, in the same order of rows.

    Raises
    ------
    InputError
        Cells are not tetrahedra of order 2. Or an element along a front is too long: over 1.25
        times the radius of the domain for the integrals K_I, K_II and K_III.
    """
    check_has_matrices(structure, "stress intensities")
    nodes, comm = structure.nodes, structure.comm
    assert nodes is not None
    if scene.mesh.order != 2 or comm.allreduce(nodes.cells.shape[1]) != 10 * comm.size:
        requirement = "a mesh of tetrahedra with mesh.order = 2, for stress intensities"
        raise InputError("mesh", f"cells with {nodes.cells.shape[1]} nodes", requirement)
    points, cells = gather_rows(comm, nodes.points), gather_rows(comm, nodes.cells)
    stations: list[Station] = []
    displacement_factor_rows: list[np.ndarray] = []
    contact_force_factor_rows: list[np.ndarray] = []
    for front in find_fronts(structure):
        _check_front_is_resolved(front)
        integration_domain = _IntegrationDomain(scene, front, points, cells)
        displacement_factors, nodal_fields = (
            _values_at_free_dofs(nodes, integration_domain.nodes, domain_node_values)
            for domain_node_values in integration_domain.find_displacement_factors_and_fields(comm)
        )
        force_factors = np.zeros((len(displacement_factors), structure.n_pairs))
        if structure.pairs.nodes is not None:
            force_factors -= integration_domain.intensity_per_integral[
                :, None
            ] * structure.apply_bt(nodal_fields)
            force_factors[: len(front.station_parameters)] += _contact_force_factors(
                structure, front
            )
        front_stations = _make_stations(structure, front)
        smooth_station_indices = np.setdiff1d(
            range(len(front_stations)), front.corner_station_indices
        )
        stations += [front_stations[station_index] for station_index in smooth_station_indices]
        displacement_factor_rows += [
            *_rows_by_station(front, displacement_factors)[smooth_station_indices]
        ]
        contact_force_factor_rows += [
            *_rows_by_station(front, force_factors)[smooth_station_indices]
        ]
    return (
        stations,
        np.concatenate(displacement_factor_rows),
        np.concatenate(contact_force_factor_rows),
    )


def _values_at_free_dofs(
    nodes: Nodes, node_numbers: np.ndarray, node_values: np.ndarray
) -> np.ndarray:
    """Select this rank's free dofs from vectors given at nodes: (n, n_local).

    Parameters
    ----------
    nodes : Nodes
        Nodes of this rank.
    node_numbers : (m,) int
        Global numbers of the given nodes. At all other nodes the values are 0.
    node_values : (m, n, 3)
        Values of n vector fields at the given nodes.
    """
    local_nodes = node_numbers - nodes.dolfinx_mesh_and_dofs.first_node
    is_owned = (local_nodes >= 0) & (
        local_nodes < nodes.dolfinx_mesh_and_dofs.n_nodes_owned_by_rank
    )
    own_node_values = np.zeros(
        (node_values.shape[1], nodes.dolfinx_mesh_and_dofs.n_nodes_owned_by_rank, 3)
    )
    own_node_values[:, local_nodes[is_owned]] = node_values[is_owned].swapaxes(0, 1)
    return np.asarray(
        nodes.dolfinx_mesh_and_dofs.restrict_to_free(
            own_node_values.reshape(len(own_node_values), -1)
        )
    )


def _make_stations(structure: Structure, front: Front) -> list[Station]:
    """Return a front's stations, the points at which stress intensities are computed.

    Each station has a name, position and growth direction, and the indices of the contact pairs at
    the front nearby.
    """
    pairs = structure.pairs
    is_node_in_hats = front.hats_and_slopes(front.node_parameters)[0] > 0.0
    contact_pairs_by_station = [np.zeros(0, dtype=int)] * len(front.station_parameters)
    if pairs.nodes is not None and pairs.pressure_functions_at_nodes is not None:
        nearest_crack_nodes = cKDTree(pairs.nodes).query(front.node_positions)[1]
        contact_pairs_by_station = [
            np.unique(
                pairs.pressure_functions_at_nodes[nearest_crack_nodes[is_node_in_hat]].nonzero()[1]
            )
            for is_node_in_hat in is_node_in_hats.T
        ]
    fine_parameters = np.linspace(
        front.node_parameters[0], front.node_parameters[-1], 50 * len(front.hat_peak_parameters)
    )
    arc_lengths = np.append(
        0.0,
        np.linalg.norm(np.diff(front.curve_function(fine_parameters, 0), axis=0), axis=1).cumsum(),
    )
    station_arc_lengths = np.interp(front.station_parameters, fine_parameters, arc_lengths)
    station_points = front.curve_function(front.station_parameters, 0)
    growth_directions = front.frame_and_curvature(front.station_parameters)[0][:, 0]
    return [
        Station(
            f"{front.name} at {format_quantity(float(station_arc_length), 'm')}",
            front.crack_index,
            station_point,
            growth_direction,
            float(station_arc_length),
            contact_pairs_near_station,
        )
        for station_point, growth_direction, station_arc_length, contact_pairs_near_station in zip(
            station_points,
            growth_directions,
            station_arc_lengths,
            contact_pairs_by_station,
            strict=True,
        )
    ]


def _check_front_is_resolved(front: Front) -> None:
    """Raise InputError if an element along a front is too long for stress intensities.

    Stress intensities are integrals over a domain around the front. The limit is 1.25 times the
    domain's radius.
    """
    edge_lengths = np.linalg.norm(np.diff(front.node_positions, axis=0), axis=1)
    domain_radii_at_edges = front.domain_radius(
        front.frame_and_curvature(0.5 * (front.node_parameters[1:] + front.node_parameters[:-1]))[2]
    )
    worst_edge = (edge_lengths / domain_radii_at_edges).argmax()
    if edge_lengths[worst_edge] > MAX_ELEMENT_LENGTH_TO_RADIUS * domain_radii_at_edges[worst_edge]:
        allowed_edge_length = MAX_ELEMENT_LENGTH_TO_RADIUS * domain_radii_at_edges[worst_edge]
        requirement = (
            f"elements of at most {allowed_edge_length:.3g} m along the crack front"
            f" at {format_point(front.node_positions[worst_edge], '.4g')} m; refine the mesh there"
        )
        raise InputError("mesh", f"elements of {edge_lengths[worst_edge]:.3g} m", requirement)


def _rows_by_station(front: Front, functional_rows: np.ndarray) -> np.ndarray:
    """Arrange the factors for K_I, K_II and K_III by station: (n_stations, 3, m).

    Stations are points along the front. A row of factors gives the mean of a stress intensity
    around its station. The mean is weighted by a hat function, 1 at the station and 0 at the
    neighbours.

    At an end of an open front there is only half a hat, so the mean belongs to a point inside. With
    three stations or more, the rows of an end station are extrapolated linearly from the last two.

    Parameters
    ----------
    front : Front
        Front with the stations.
    functional_rows : (3 n_stations, m)
        Factors of m dofs or contact pairs: all stations for K_I, then for K_II, then for K_III.
    """
    rows_by_mode = functional_rows.reshape(3, len(front.station_parameters), -1)
    rows_by_station = rows_by_mode.swapaxes(0, 1).copy()
    if not front.is_closed and len(rows_by_station) > 2:
        rows_by_station[[0, -1]] = 1.5 * rows_by_station[[0, -1]] - 0.5 * rows_by_station[[1, -2]]
    return rows_by_station


def _collapsed_gauss_rule(dimension: int, n_side_points: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a Gauss rule for a triangle (d = 2) or a tetrahedron (d = 3).

    The rule is made from a square or cube with ``n_side_points`` per side, collapsed at the first
    corner. d is ``dimension``.

    Returns
    -------
    coordinates : (n_side_points^d, d + 1)
        Barycentric coordinates.
    weights : (n_side_points^d,)
        Weights that sum to 1.
    """
    remaining_coordinate, weights = np.ones(1), np.ones(1)
    coordinates: list[np.ndarray] = []
    for jacobi_exponent in range(dimension - 1, -1, -1):
        points_1d, weights_1d = roots_jacobi(n_side_points, jacobi_exponent, 0)
        points_1d, weights_1d = 0.5 * (1.0 + points_1d), weights_1d / weights_1d.sum()
        coordinates = [np.repeat(coordinate, n_side_points) for coordinate in coordinates]
        coordinates.append((remaining_coordinate[:, None] * points_1d).ravel())
        remaining_coordinate = (remaining_coordinate[:, None] * (1.0 - points_1d)).ravel()
        weights = (weights[:, None] * weights_1d).ravel()
    return np.column_stack([*coordinates, remaining_coordinate]), weights


def _split_into_chunks(cells: np.ndarray, n_cell_points: int) -> list[np.ndarray]:
    """Split cell indices (n,) into a list of arrays, to limit the memory for integration.

    Each array has at most about ``MAX_POINTS_IN_MEMORY`` quadrature points. A cell has
    ``n_cell_points``.
    """
    return np.array_split(cells, 1 + len(cells) * n_cell_points // MAX_POINTS_IN_MEMORY)


TETRAHEDRON_EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
"""Corners at the ends of a tetrahedron's six edges, in VTK's order of the nodes on edges."""


class _IntegrationDomain:
    """Cells around a front, over which the interaction integral is computed.

    The interaction integral I is linear in the displacement and gives the stress intensities.
    Equations are in the module's docstring. There is an integral for each mode (K_I, K_II, K_III)
    and each station, a point on the front. So arrays have 3 n_stations rows: all stations for K_I,
    then for K_II, then for K_III.

    Attributes
    ----------
    intensity_per_integral : (3 n_stations,)
        Stress intensity divided by the interaction integral I.
    nodes : (n_nodes,) int
        Global numbers of the cells' nodes.
    points : (n_nodes, 3) [m]
        Positions of the nodes.
    cells : (n_cells, 10) int
        Nodes of each cell, as rows of ``points``.
    corners_sorted_by_front_distance : (n_cells, 4) int
        Columns 0 to 3 of ``cells``, sorted by the corners' distance from the front.
    corner_positions : (n_cells, 4, 3) [m]
        Positions of the corners, sorted by the distance from the front.
    is_facet_of_single_cell : (n_cells, 4) bool
        For each sorted corner: True if no other cell has the facet opposite the corner.
    cell_volumes : (n_cells,) [m^3]
        Volume of each cell.
    barycentric_gradients : (n_cells, 4, 3) [1/m]
        Gradient of each sorted corner's barycentric coordinate.
    cell_side_signs : (n_cells,)
        1 if the cell's centre is above the crack, -1 if below.
    """

    def __init__(self, scene: Scene, front: Front, points: np.ndarray, cells: np.ndarray) -> None:
        self.front = front
        youngs_modulus, self.nu = scene.material.young, scene.material.poisson
        self.mu = 0.5 * youngs_modulus / (1.0 + self.nu)
        self.lame_lambda = youngs_modulus * self.nu / (1.0 + self.nu) / (1.0 - 2.0 * self.nu)
        half_plane_strain_modulus = 0.5 * youngs_modulus / (1.0 - self.nu**2)
        intensity_moduli_by_mode_and_station = np.repeat(
            [half_plane_strain_modulus, half_plane_strain_modulus, self.mu],
            len(front.station_parameters),
        )
        self.intensity_per_integral = intensity_moduli_by_mode_and_station / np.tile(
            front.hat_integrals(), 3
        )
        front_distances = front._sample_parameters_and_tree[1].query(points)[0][cells]
        # Cells with all corners outside R touch the domain only where q is below 1e-5.
        is_near_cell = front_distances.min(axis=1) < front.straight_domain_radius
        self.nodes, local_nodes = np.unique(cells[is_near_cell], return_inverse=True)
        self.points, self.cells = points[self.nodes], local_nodes.reshape(-1, cells.shape[1])
        corner_positions = self.points[self.cells[:, :4]]
        # Nearest to the front first; equally near corners by position. So the order is the same
        # on all ranks, and the rule for an edge on the front takes its ends in a fixed order.
        sort_keys = np.dstack([corner_positions, front_distances[is_near_cell, :4]]).transpose(
            2, 0, 1
        )
        self.corners_sorted_by_front_distance = corner_order = np.lexsort(
            np.round(sort_keys / (RELATIVE_POSITION_TOLERANCE * front.straight_domain_radius)),
            axis=-1,
        )
        self.corner_positions = np.take_along_axis(
            corner_positions, corner_order[..., None], axis=1
        )
        corner_nodes = np.take_along_axis(self.cells[:, :4], corner_order, axis=1)
        facets = np.concatenate(
            [np.delete(corner_nodes, corner_index, axis=1) for corner_index in range(4)]
        )
        self.is_facet_of_single_cell = (count_equal_rows(facets) == 1).reshape(4, -1).T
        cell_edge_vectors = self.corner_positions[:, 1:] - self.corner_positions[:, :1]
        self.cell_volumes = np.abs(np.linalg.det(cell_edge_vectors)) / 6.0
        inverse_cell_edge_matrices = np.linalg.inv(cell_edge_vectors).swapaxes(
            1, 2
        )  # rows: gradients of lambda_1 to lambda_3
        self.barycentric_gradients = np.concatenate(
            [-inverse_cell_edge_matrices.sum(axis=1, keepdims=True), inverse_cell_edge_matrices],
            axis=1,
        )
        cell_centres = self.corner_positions.mean(axis=1)
        front_parameters_of_centres = front.nearest_parameters(cell_centres)
        self.cell_side_signs = np.sign(
            (
                (cell_centres - front.curve_function(front_parameters_of_centres, 0))
                * front.frame_and_curvature(front_parameters_of_centres)[0][:, 1]
            ).sum(-1)
        )

    def _basis_gradients(self, cell_indices: np.ndarray) -> np.ndarray:
        """Differentiate the cells' quadratic basis functions N_a: (n, 10, 4, 3) [1/m].

        A gradient is linear in the cell. So the result D has grad N_a = sum_b D_ab lambda_b, with
        the barycentric coordinate lambda_b of corner b. Axis 1 (a) follows the cell's 10 nodes.
        Axis 2 (b) follows the corners in ``corner_positions``. Axis 3 is x, y, z. ``cell_indices``
        (n,) selects the cells.
        """
        inverse_corner_order = self.corners_sorted_by_front_distance[cell_indices].argsort(axis=1)
        barycentric_gradients = np.take_along_axis(
            self.barycentric_gradients[cell_indices], inverse_corner_order[..., None], axis=1
        )
        gradient_coefficients = np.zeros((len(cell_indices), 10, 4, 3))
        for corner_index in range(4):
            gradient_coefficients[:, corner_index] = -barycentric_gradients[:, corner_index, None]
            gradient_coefficients[:, corner_index, corner_index] += (
                4.0 * barycentric_gradients[:, corner_index]
            )
        for edge_index, (corner_index, other_corner_index) in enumerate(TETRAHEDRON_EDGES):
            gradient_coefficients[:, 4 + edge_index, corner_index] = (
                4.0 * barycentric_gradients[:, other_corner_index]
            )
            gradient_coefficients[:, 4 + edge_index, other_corner_index] = (
                4.0 * barycentric_gradients[:, corner_index]
            )
        return np.take_along_axis(
            gradient_coefficients,
            self.corners_sorted_by_front_distance[cell_indices][:, None, :, None],
            axis=2,
        )

    def find_displacement_factors_and_fields(self, comm: MPI.Comm) -> tuple[np.ndarray, np.ndarray]:
        """Compute the factors of nodal displacements and nodal forces in K (collective).

        K stands for K_I, K_II or K_III at a station. Each rank integrates over a part of the cells;
        the results are equal on all ranks.

        Returns
        -------
        displacement_factors : (n_nodes, 3 n_stations, 3) [Pa m^1/2 / m]
            Factors of the nodes' displacements along x, y, z. Axis 1: all stations for K_I, then
            for K_II, then for K_III.
        nodal_fields : (n_nodes, 3 n_stations, 3)
            Field w = q h a_,1 at the nodes, with the same axes. Forces f at the nodes add -w . f to
            the interaction integral. q is a weight, 1 near the front and 0 at the domain's border.
            h is the station's hat function, 1 at the station and 0 at the neighbours. a is the
            displacement field with K = 1, and a_,1 the derivative in the direction ahead of the
            crack.
        """
        n_rows = 3 * len(self.front.station_parameters)
        displacement_factors, nodal_fields = np.zeros((2, len(self.points), n_rows, 3))
        for chunk_cells in _split_into_chunks(np.arange(len(self.cells)), 10):
            nodal_fields[self.cells[chunk_cells]] = self._weighted_nodal_fields(chunk_cells)
        is_cell_at_front = (
            cKDTree(self.front.node_positions).query(self.corner_positions[:, 0])[0]
            < RELATIVE_POSITION_TOLERANCE * self.front.straight_domain_radius
        )
        cells_and_gauss_point_counts = (
            (np.flatnonzero(is_cell_at_front), GAUSS_POINTS_AT_FRONT),
            (np.flatnonzero(~is_cell_at_front), GAUSS_POINTS_ELSEWHERE),
        )
        for chunk_cells, n_side_gauss_points in (
            (cell_chunk, n_gauss_points_per_direction)
            for group_cells, n_gauss_points_per_direction in cells_and_gauss_point_counts
            for cell_chunk in _split_into_chunks(
                group_cells[comm.rank :: comm.size], n_gauss_points_per_direction**3
            )
        ):
            (rule_points, weights), (facet_rule_points, facet_weights) = (
                _collapsed_gauss_rule(dimension, n_side_gauss_points) for dimension in (3, 2)
            )
            tensor_integrals = self._integrate_tensors(
                chunk_cells, rule_points, self.cell_volumes[chunk_cells, None] * weights, None
            )
            for corner_index in range(4):
                has_cell_outer_facet = self.is_facet_of_single_cell[chunk_cells, corner_index]
                if np.any(has_cell_outer_facet):
                    facet_points_in_cell_coordinates = np.insert(
                        facet_rule_points, corner_index, 0.0, axis=1
                    )
                    corner_gradients = self.barycentric_gradients[
                        chunk_cells[has_cell_outer_facet], corner_index
                    ]
                    areas = (
                        3.0
                        * self.cell_volumes[chunk_cells[has_cell_outer_facet]]
                        * np.linalg.norm(corner_gradients, axis=1)
                    )
                    outward_facet_normals = (
                        -corner_gradients / np.linalg.norm(corner_gradients, axis=1)[:, None]
                    )
                    tensor_integrals[has_cell_outer_facet] += self._integrate_tensors(
                        chunk_cells[has_cell_outer_facet],
                        facet_points_in_cell_coordinates,
                        areas[:, None] * facet_weights,
                        outward_facet_normals,
                    )
            basis_gradients = self._basis_gradients(chunk_cells).reshape(len(chunk_cells), 10, 12)
            nodal_fields_of_cells = (
                nodal_fields[self.cells[chunk_cells]]
                .reshape(len(chunk_cells), 10, -1)
                .swapaxes(1, 2)
            )
            corner_stress = self._stress(
                (nodal_fields_of_cells @ basis_gradients)
                .reshape(len(chunk_cells), -1, 3, 4, 3)
                .swapaxes(2, 3)
            )
            barycentric_product_integrals = (
                self.cell_volumes[chunk_cells, None, None, None, None] / 20.0
            )
            tensor_integrals -= barycentric_product_integrals * (
                corner_stress + corner_stress.sum(axis=2, keepdims=True)
            )
            tensor_integrals = tensor_integrals.swapaxes(2, 3).reshape(len(chunk_cells), -1, 12)
            displacement_factors_of_cells = basis_gradients @ tensor_integrals.swapaxes(1, 2)
            np.add.at(
                displacement_factors,
                self.cells[chunk_cells],
                displacement_factors_of_cells.reshape(len(chunk_cells), 10, n_rows, 3),
            )
        return self.intensity_per_integral[:, None] * comm.allreduce(
            displacement_factors
        ), nodal_fields

    def _stress(self, displacement_gradients: np.ndarray) -> np.ndarray:
        """Return the stress [Pa] from displacement gradients (..., 3, 3), by Hooke's law."""
        stress = self.mu * (displacement_gradients + displacement_gradients.swapaxes(-1, -2))
        volumetric_stress = self.lame_lambda * np.trace(displacement_gradients, axis1=-2, axis2=-1)
        for axis_index in range(3):
            stress[..., axis_index, axis_index] += volumetric_stress
        return stress

    def _front_coordinates(
        self, positions: np.ndarray, cell_indices: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Convert points in cells to coordinates relative to the nearest front point.

        ``positions`` (n, m, 3) [m] are m points in each of the n cells ``cell_indices``.

        Returns
        -------
        frame_vectors : (n, m, 3, 3)
            Rows: unit vectors e_1 ahead of the crack, e_2 normal to it, e_3 along the front.
        xi, y, r : (n, m) [m]
            Coordinates along e_1 and e_2, and distance from the front.
        hat, hat_slope : (n, m, n_stations)
            Hat functions, 1 at a station and 0 at the neighbours, and their derivatives by the
            length along the front.
        curvature, curvature_slope : (n, m) [1/m], [1/m^2]
            Front curvature, and the derivative by the length along the front.
        domain_radius : (n, m) [m]
            Radius of the integration domain around the front.
        """
        front = self.front
        t = front.nearest_parameters(positions)
        frame_vectors, speed, curvature, curvature_slope = front.frame_and_curvature(t)
        offsets_from_front = positions - front.curve_function(t, 0)
        xi_ahead_of_front, y = (
            (offsets_from_front * frame_vectors[..., axis_index, :]).sum(-1)
            for axis_index in range(2)
        )
        domain_radius = front.domain_radius(curvature)
        r = np.hypot(xi_ahead_of_front, y)
        y = np.where(
            np.abs(y) < 1e-6 * r, 1e-12 * r * self.cell_side_signs[cell_indices][:, None], y
        )
        hat, hat_slope_by_t = front.hats_and_slopes(t)
        return (
            frame_vectors,
            xi_ahead_of_front,
            y,
            r,
            hat,
            hat_slope_by_t / speed[..., None],
            curvature,
            curvature_slope,
            domain_radius,
        )

    def _weighted_nodal_fields(self, cell_indices: np.ndarray) -> np.ndarray:
        """Return the fields w = q h a_,1 at the cells' nodes: (n, 10, 3 n_stations, 3).

        Used to add the nodal forces to the interaction integral. q is a weight, 1 near the front
        and 0 at the domain's border. h is the station's hat function, 1 at the station and 0 at the
        neighbours. a is the displacement field with K_I, K_II or K_III = 1. a_,1 is its derivative
        in the direction ahead of the crack.

        ``cell_indices`` (n,) selects the cells. Axis 1 follows the nodes of a cell. Axis 2 has all
        stations for K_I, then for K_II, then for K_III. Axis 3 is x, y, z. At all nodes of edges
        along the front, w is 0: a straight edge cuts the curved front short, so its middle is on
        neither side of the crack.
        """
        node_positions = self.points[self.cells[cell_indices]]
        frame_vectors, xi, y, r, hat, _, _, _, domain_radius = self._front_coordinates(
            node_positions, cell_indices
        )
        is_node_at_front = r < 1e-6 * domain_radius
        is_node_at_front[:, 4:] = is_node_at_front[:, np.array(TETRAHEDRON_EDGES)].all(axis=2)
        r = np.where(is_node_at_front, domain_radius, r)
        q = np.where(is_node_at_front, 0.0, find_weight_and_slope(r / domain_radius)[0])
        mode_fields = []
        for mode in range(3):
            _, da_dxi, _ = self._plane_field_and_derivatives(mode, xi, y, r)
            weighted_field = np.einsum("icp,cpij->cpj", da_dxi, frame_vectors) * q[..., None]
            mode_fields.append(hat[..., None] * weighted_field[..., None, :])
        return np.concatenate(mode_fields, axis=2)

    def _plane_field_and_derivatives(
        self, mode: int, xi: np.ndarray, y: np.ndarray, r: np.ndarray
    ) -> Any:
        """Return the displacement field a around a front with K_I, K_II or K_III = 1.

        Parameters
        ----------
        mode : int
            0, 1, 2 for K_I, K_II, K_III.
        xi, y, r : (...) [m]
            Coordinates ahead of the crack and normal to it, and distance from the front.

        Returns
        -------
        a, a_by_xi, a_by_y : (3, ...)
            Components along e_1, e_2, e_3, and their derivatives by xi and y.
        """
        half_angle = 0.5 * np.arctan2(y, xi)
        cos_half_angle = np.cos(half_angle)
        sin_half_angle = np.sin(half_angle)
        cos_angle = xi / r
        sin_angle = y / r
        kolosov, zeros = 3.0 - 4.0 * self.nu, np.zeros_like(r)
        if mode == 0:
            angular_part = np.array(
                [
                    cos_half_angle * (kolosov - cos_angle),
                    sin_half_angle * (kolosov - cos_angle),
                    zeros,
                ]
            )
            angular_slope = np.array([
                -0.5 * sin_half_angle * (kolosov - cos_angle) + cos_half_angle * sin_angle,
                0.5 * cos_half_angle * (kolosov - cos_angle) + sin_half_angle * sin_angle, zeros,
            ])  # fmt: skip
        elif mode == 1:
            angular_part = np.array(
                [
                    sin_half_angle * (kolosov + 2.0 + cos_angle),
                    -cos_half_angle * (kolosov - 2.0 + cos_angle),
                    zeros,
                ]
            )
            angular_slope = np.array([
                0.5 * cos_half_angle * (kolosov + 2.0 + cos_angle) - sin_half_angle * sin_angle,
                0.5 * sin_half_angle * (kolosov - 2.0 + cos_angle) + cos_half_angle * sin_angle,
                zeros,
            ])  # fmt: skip
        else:
            angular_part = np.array([zeros, zeros, 4.0 * sin_half_angle])
            angular_slope = np.array([zeros, zeros, 2.0 * cos_half_angle])
        field_scale = 0.5 / self.mu / np.sqrt(2.0 * np.pi)
        root_r = np.sqrt(r)
        return (
            field_scale * root_r * angular_part,
            field_scale / root_r * (0.5 * cos_angle * angular_part - sin_angle * angular_slope),
            field_scale / root_r * (0.5 * sin_angle * angular_part + cos_angle * angular_slope),
        )

    def _integrate_tensors(
        self,
        cell_indices: np.ndarray,
        rule_points: np.ndarray,
        weights: np.ndarray,
        normals: np.ndarray | None,
    ) -> np.ndarray:
        """Integrate T lambda_b over cells, or over facets of cells.

        T is the factor of the displacement gradient grad u in the interaction integral I. Volume
        and surface terms of I are int T : grad u. lambda_b is the barycentric coordinate of a
        cell's corner b, 1 at the corner and 0 on the facet opposite.

        Parameters
        ----------
        cell_indices : (n,) int
            Cells.
        rule_points : (m, 4)
            Barycentric coordinates lambda_b of m integration points.
        weights : (n, m) [m^3] or [m^2]
            Weights of the points in each cell, or on a facet of each cell.
        normals : (n, 3) or None
            Outward normals of the facets. None: integrate over the cells.

        Returns
        -------
        (n, 3 n_stations, 4, 3, 3)
            Integrals for each cell, row (mode and station), corner b, and component of T.
        """
        positions = rule_points @ self.corner_positions[cell_indices]
        frame_vectors, xi, y, r, hat, hat_slope, curvature, curvature_slope, domain_radius = (
            self._front_coordinates(positions, cell_indices)
        )
        if normals is not None:  # At a concave front, crack faces reach ahead of the curve.
            xi = np.where(np.abs(y) < 1e-9 * r, -r, xi)
        q, q_slope = find_weight_and_slope(r / domain_radius)
        q_slope /= domain_radius
        metric_factor = 1.0 + curvature * xi
        curvature_over_metric = curvature / metric_factor
        is_limited = self.front.is_limited_by_curvature(curvature)
        domain_radius_log_slope = np.where(
            is_limited, -curvature_slope / np.where(is_limited, curvature, 1.0), 0.0
        )
        q_gradient = np.stack(
            [
                q_slope * xi / r,
                q_slope * y / r,
                -q_slope * r * domain_radius_log_slope / metric_factor,
            ],
            axis=-1,
        )
        weights_times_coordinates = weights[..., None] * rule_points
        mode_integrals = []
        for mode in range(3):
            a, da_dxi, da_dy = self._plane_field_and_derivatives(mode, xi, y, r)
            gradient = np.zeros((*r.shape, 3, 3))
            gradient[..., 0], gradient[..., 1] = (
                np.moveaxis(da_dxi, 0, -1),
                np.moveaxis(da_dy, 0, -1),
            )
            gradient[..., 0, 2], gradient[..., 2, 2] = (
                -curvature_over_metric * a[2],
                curvature_over_metric * a[0],
            )
            auxiliary_stress = self._stress(gradient)
            if normals is not None:
                normals_in_frame = np.einsum("cpij,cj->cpi", frame_vectors, normals)
                surface_tensor = (
                    q[..., None, None] * normals_in_frame[..., 0, None, None] * auxiliary_stress
                )
                surface_tensor[..., 0] -= (
                    q[..., None] * (auxiliary_stress @ normals_in_frame[..., None])[..., 0]
                )
                hats_and_tensors = [(hat, surface_tensor)]
            else:
                hats_and_tensors = self._hats_and_volume_tensors(
                    a,
                    da_dxi,
                    da_dy,
                    gradient,
                    auxiliary_stress,
                    (
                        q,
                        q_gradient,
                        metric_factor,
                        curvature_over_metric,
                        curvature_slope,
                        hat,
                        hat_slope,
                    ),
                )
            hat_weighted_integral: Any = 0.0
            for hat_values, tensor in hats_and_tensors:
                tensor_in_global_axes = frame_vectors.swapaxes(-1, -2) @ tensor @ frame_vectors
                weighted_tensors = weights_times_coordinates[
                    ..., None
                ] * tensor_in_global_axes.reshape(*r.shape, 1, 9)
                weighted_tensors = weighted_tensors.reshape(*r.shape, 36)
                hat_weighted_integral = (
                    hat_weighted_integral + hat_values.swapaxes(-1, -2) @ weighted_tensors
                )
            mode_integrals.append(hat_weighted_integral.reshape(len(cell_indices), -1, 4, 3, 3))
        return np.concatenate(mode_integrals, axis=1)

    def _hats_and_volume_tensors(
        self, a: np.ndarray, da_dxi: np.ndarray, da_dy: np.ndarray,
        gradient: np.ndarray, auxiliary_stress: np.ndarray,
        weights_and_geometry: tuple[np.ndarray, ...],
    ) -> list[tuple[np.ndarray, np.ndarray]]:  # fmt: skip
        """Return the factor T of grad u in the volume integral of K_I, K_II or K_III.

        The volume integral is int T : grad u dV with the displacement u. For each station, T is the
        sum of two products: hat function times a first tensor, and hat slope times a second tensor.
        The hat function is 1 at the station and 0 at the neighbours.

        Components refer to e_1 ahead of the crack, e_2 normal to it, and e_3 along the front. xi
        and y are the coordinates along e_1 and e_2. a is the displacement field with K_I, K_II or
        K_III = 1.

        Parameters
        ----------
        a, da_dxi, da_dy : (3, ...)
            Components of a, and their derivatives by xi and y.
        gradient, auxiliary_stress : (..., 3, 3)
            Gradient of a, and the stress of a.
        weights_and_geometry : tuple of arrays
            Seven arrays, in this order: weight q, 1 near the front and 0 at the domain's border;
            gradient of q; metric g = 1 + kappa xi with the front's curvature kappa; kappa / g;
            derivative of kappa along the front; hat functions; hat slopes.

        Returns
        -------
        list of ((..., n_stations), (..., 3, 3))
            Two pairs: hat functions and first tensor, then hat slopes and second tensor.
        """
        q, q_gradient, metric_factor, curvature_over_metric, curvature_slope, hat, hat_slope = (
            weights_and_geometry
        )
        q_times_curvature = (q * curvature_over_metric)[..., None]
        tensor_multiplied_by_hat = gradient[..., :, :1] * q_gradient[..., None, :]
        tensor_multiplied_by_hat[..., 2] += gradient[..., 2] * q_times_curvature
        tensor_multiplied_by_hat = (
            self._stress(tensor_multiplied_by_hat)
            - (q_gradient[..., :1] + q_times_curvature)[..., None] * auxiliary_stress
        )
        tensor_multiplied_by_hat[..., 0] += (auxiliary_stress @ q_gradient[..., None])[..., 0]
        tensor_multiplied_by_hat[..., 2] += auxiliary_stress[..., 2] * q_times_curvature
        gradient_slope_by_curvature = np.zeros_like(gradient)
        gradient_slope_by_curvature[..., 0, 2], gradient_slope_by_curvature[..., 2, 2] = (
            -a[2] / metric_factor**2,
            a[0] / metric_factor**2,
        )
        stress_divergence = (curvature_slope / metric_factor)[..., None] * self._stress(
            gradient_slope_by_curvature
        )[..., 2]
        stress_divergence[..., 0] += curvature_over_metric * (
            auxiliary_stress[..., 0, 0] - auxiliary_stress[..., 2, 2]
        )
        stress_divergence[..., 0] += (
            self.lame_lambda * curvature_over_metric * (da_dxi[0] - curvature_over_metric * a[0])
        )
        stress_divergence[..., 1] += (
            curvature_over_metric * auxiliary_stress[..., 1, 0]
            + self.lame_lambda * curvature_over_metric * da_dy[0]
        )
        stress_divergence[..., 2] += 2.0 * curvature_over_metric * auxiliary_stress[
            ..., 2, 0
        ] - self.mu * curvature_over_metric * (da_dxi[2] - curvature_over_metric * a[2])
        tensor_multiplied_by_hat[..., 0] += q[..., None] * stress_divergence
        tensor_multiplied_by_hat_slope = np.zeros_like(gradient)
        tensor_multiplied_by_hat_slope[..., 2] = gradient[..., 0] * (q / metric_factor)[..., None]
        tensor_multiplied_by_hat_slope = self._stress(tensor_multiplied_by_hat_slope)
        tensor_multiplied_by_hat_slope[..., 0] += (
            auxiliary_stress[..., 2] * (q / metric_factor)[..., None]
        )
        return [(hat, tensor_multiplied_by_hat), (hat_slope, tensor_multiplied_by_hat_slope)]


def _contact_force_factors(structure: Structure, front: Front) -> np.ndarray:
    """Return factors of the contact forces in K_I: (n_stations, n_pairs) [Pa m^1/2 / N].

    K_I at a station is a sum over the pairs of factor times contact force, plus a part from the
    displacement. Each contact force acts as a pressure on the crack faces, distributed by the
    pair's pressure function. The factor is this pressure's term in the interaction integral.
    ``front`` has the stations.
    """
    pairs = structure.pairs
    assert (
        pairs.nodes is not None
        and pairs.pressure_functions_at_nodes is not None
        and pairs.areas is not None
    )
    crack: CrackSurface = structure.nodes.dolfinx_mesh_and_dofs.part_mesh.crack_paths_or_surfaces[  # type: ignore[union-attr]
        front.crack_index
    ]
    crack_node_tree, front_tree = cKDTree(pairs.nodes), cKDTree(front.node_positions)
    corner_front_distances, nearest_front_node_of_corner = front_tree.query(
        crack.triangle_corner_points
    )
    triangle_enclosing_radii = np.linalg.norm(
        crack.triangle_corner_points - crack.triangle_corner_points.mean(axis=1)[:, None], axis=2
    ).max(axis=1)
    is_triangle_near_front = (
        corner_front_distances.min(axis=1)
        < front.straight_domain_radius + 2.0 * triangle_enclosing_radii
    )
    nodal_pressure_factors = np.zeros((len(front.station_parameters), len(pairs.nodes)))
    rule_points, facet_weights = _collapsed_gauss_rule(2, GAUSS_POINTS_AT_FRONT)
    x, w = np.polynomial.legendre.leggauss(2 * GAUSS_POINTS_AT_FRONT)
    x, w = 0.5 * (1.0 + x), 0.5 * w
    sqrt_fractions, edge_fractions = (
        coordinate_grid.ravel() for coordinate_grid in np.meshgrid(x, x, indexing="ij")
    )
    mapped_rule_weights, fractions_towards_corner = (
        2.0 * sqrt_fractions * np.outer(w, w).ravel(),
        sqrt_fractions**2,
    )
    mapped_shape_values = np.column_stack(
        [
            fractions_towards_corner,
            (1.0 - fractions_towards_corner) * (1.0 - edge_fractions),
            (1.0 - fractions_towards_corner) * edge_fractions,
        ]
    )
    for triangle, corner_distances, front_node_nearest_to_corner in zip(
        crack.triangle_corner_points[is_triangle_near_front],
        corner_front_distances[is_triangle_near_front],
        nearest_front_node_of_corner[is_triangle_near_front],
        strict=True,
    ):
        corner_order = corner_distances.argsort()
        is_on_front = corner_distances < RELATIVE_POSITION_TOLERANCE * crack.size
        if is_on_front.sum() == 2:
            corner_order = np.append(np.flatnonzero(~is_on_front), np.flatnonzero(is_on_front))
            edge_end_parameters = front.node_parameters[
                front_node_nearest_to_corner[corner_order[1:]]
            ]
            if front.is_closed:
                edge_end_parameters = np.unwrap(
                    edge_end_parameters, period=front.node_parameters[-1] - front.node_parameters[0]
                )
            t_start, t_stop = edge_end_parameters
            t = t_start + edge_fractions * (t_stop - t_start)
            offsets_to_corner = triangle[corner_order[0]] - front.curve_function(t, 0)
            points = (
                front.curve_function(t, 0) + fractions_towards_corner[:, None] * offsets_to_corner
            )
            area_vectors = np.cross(
                offsets_to_corner,
                (1.0 - fractions_towards_corner)[:, None]
                * front.curve_function(t, 1)
                * (t_stop - t_start),
            )
            quadrature_area_weights = mapped_rule_weights * np.linalg.norm(area_vectors, axis=1)
            shape_values = mapped_shape_values
        else:
            points, shape_values = (rule_points @ triangle[corner_order], rule_points)
            triangle_sides = triangle[1:] - triangle[0]
            quadrature_area_weights = (
                0.5 * np.linalg.norm(np.cross(*triangle_sides)) * facet_weights
            )
        t = front.nearest_parameters(points)
        r = np.linalg.norm(points - front.curve_function(t, 0), axis=1)
        domain_radii_at_points = front.domain_radius(front.frame_and_curvature(t)[2])
        kernel = (
            find_weight_and_slope(r / domain_radii_at_points)[0]
            / np.sqrt(r)
            * quadrature_area_weights
        )
        corner_crack_nodes = crack_node_tree.query(triangle[corner_order])[1]
        nodal_pressure_factors[:, corner_crack_nodes] += front.hats_and_slopes(t)[0].T @ (
            kernel[:, None] * shape_values
        )
    nodal_pressure_factors *= np.sqrt(2.0 / np.pi) / front.hat_integrals()[:, None]
    return np.asarray(
        (pairs.pressure_functions_at_nodes.T @ nodal_pressure_factors.T).T / pairs.areas
    )
