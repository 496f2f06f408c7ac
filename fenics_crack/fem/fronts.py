"""Find the crack fronts of a solid, as curves.

A front is a curve c(t), with derivatives c_1, c_2, c_3. It is an ellipse if its nodes lie on one;
otherwise it is a cubic spline over their distance along the front. At each point, xi is ahead of
the crack, y across it, and s along the front. Their unit vectors are e_1, e_2, e_3. The curvature
kappa is positive if the crack is convex.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from fenics_crack.basics.ranks import gather_rows
from fenics_crack.fem.cracks import (
    RELATIVE_POSITION_TOLERANCE,
    CrackSurface,
    find_node_chains,
    size_weighted_normals,
    upward_sign,
)
from fenics_crack.model.structure import Structure

RADIUS_IN_ELEMENTS = 2.0
"""Radius of the integration domain, in lengths of the longest element along the front. A smaller
radius gives noise in K, a larger one averages over more of the front."""
MAX_RADIUS_TO_CURVATURE_RADIUS = 0.6
"""Maximum radius of the integration domain, relative to the front's radius of curvature. At 1 the
front's normals meet."""
MAX_RADIUS_TO_CLEARANCE = 0.8
"""Maximum radius of the integration domain, relative to the front's distance from the clamp or
another crack."""
MIN_EDGES_PER_STATION = 3
"""Minimum number of element edges between two stations. So each hat function has four nodes or
more."""
MAX_STATION_INTERVALS = 12
"""Maximum number of intervals between stations on an open front; twice as many on a closed front.
"""
MIN_CORNER_ANGLE = np.pi / 4.0
"""Minimum angle between neighbouring edges at a corner of the front [rad]. Corners cut a front into
smooth parts."""


@dataclass(frozen=True)
class Front:
    """Smooth part of a crack front in a solid, as a curve c(t).

    Attributes
    ----------
    name : str
        "the crack front", or "the crack front 2" if there are several.
    crack_index : int
        Index of the crack in the mesh.
    node_positions : (n, 3) [m]
        Corners of elements along the front, in order. If the front is closed, the last node
        equals the first.
    node_normals : (n, 3)
        Normals of the crack at the nodes, from the lower to the upper face.
    node_parameters : (n,)
        Parameter t of each node: the angle on an ellipse [rad], or the distance along the front
        [m].
    curve_function : callable
        Takes t and an order. Order 0 returns positions c(t) [m], order k the k-th derivative by t:
        (..., 3).
    is_closed : bool
        True if the front has no ends.
    is_each_end_at_surface : tuple of bool
        True for each end at the solid's surface. Other ends are corners of the front.
    allowed_domain_radius : float [m]
        Stress intensities are integrals over a domain around the front. Upper bound for the
        domain's radius: 0.8 times the distance from the clamp or another crack.
    """

    name: str
    crack_index: int
    node_positions: np.ndarray
    node_normals: np.ndarray
    node_parameters: np.ndarray
    curve_function: Callable[[np.ndarray, int], np.ndarray]
    is_closed: bool
    is_each_end_at_surface: tuple[bool, bool]
    allowed_domain_radius: float

    @cached_property
    def hat_peak_parameters(self) -> np.ndarray:
        """Return the curve parameters t at the peaks of the hat functions, equally spaced: (n,).

        A hat is 1 at its peak and falls linearly in t to 0 at the neighbouring peaks. Peaks are the
        stations, the points for stress intensities.

        On a closed front the last value is the first peak again, a turn later. So n is the number
        of stations plus 1. An open front with two intervals or more has a peak in the middle, where
        a half-ellipse is deepest.
        """
        n_station_intervals = max(
            1,
            min(
                MAX_STATION_INTERVALS * (1 + self.is_closed),
                (len(self.node_positions) - 1) // MIN_EDGES_PER_STATION,
            ),
        )
        n_station_intervals -= (
            n_station_intervals % 2 if n_station_intervals > 1 and not self.is_closed else 0
        )
        return np.linspace(
            self.node_parameters[0],
            self.node_parameters[-1],
            max(n_station_intervals, 3 if self.is_closed else 1) + 1,
        )

    @property
    def station_parameters(self) -> np.ndarray:
        """Return the stations' curve parameters t: (n_stations,).

        A station is a point on the front at which K is computed (:class:`Station`).
        """
        return self.hat_peak_parameters[:-1] if self.is_closed else self.hat_peak_parameters

    @property
    def corner_station_indices(self) -> list[int]:
        """Return the indices of stations at corners of the crack front.

        Stress intensities are undefined at a corner, so the stations are left out of results. A
        corner is an end of this smooth part of the front, inside the solid.
        """
        if self.is_closed:
            return []
        end_stations = np.array([0, len(self.station_parameters) - 1])
        return end_stations[~np.array(self.is_each_end_at_surface)].tolist()

    def hats_and_slopes(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the stations' hat functions h at curve parameters t (...).

        A hat is 1 at a station and falls linearly in t to 0 at the neighbouring stations.

        Returns
        -------
        hat_values, hat_slopes : (..., n_stations)
            Hats and their derivatives with respect to t.
        """
        station_spacing = self.hat_peak_parameters[1] - self.hat_peak_parameters[0]
        distances_in_spacings = (t[..., None] - self.station_parameters) / station_spacing
        if self.is_closed:
            distances_in_spacings -= len(self.station_parameters) * np.round(
                distances_in_spacings / len(self.station_parameters)
            )
        hat_values = np.maximum(0.0, 1.0 - np.abs(distances_in_spacings))
        return hat_values, np.where(
            hat_values > 0.0, -np.sign(distances_in_spacings) / station_spacing, 0.0
        )

    def hat_integrals(self) -> np.ndarray:
        """Integrate each station's hat function h along the front, int h ds: (n_stations,) [m].

        h is 1 at the station and falls to 0 at the neighbouring stations.
        """
        gauss_points, gauss_weights = np.polynomial.legendre.leggauss(8)
        half_spacing = 0.5 * (self.hat_peak_parameters[1] - self.hat_peak_parameters[0])
        t = (self.hat_peak_parameters[:-1, None] + half_spacing * (1.0 + gauss_points)).ravel()
        length_weights = np.linalg.norm(self.curve_function(t, 1), axis=1) * np.tile(
            half_spacing * gauss_weights, len(self.hat_peak_parameters) - 1
        )
        return np.asarray(length_weights @ self.hats_and_slopes(t)[0])

    def frame_and_curvature(
        self, t: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the front's unit vectors, parameter speed and curvature at parameters t (...).

        Returns
        -------
        frame_vectors : (..., 3, 3)
            Rows: unit vectors e_1 ahead of the crack, e_2 normal to it, e_3 along the front.
        speed : (...,)
            ds/dt with the length s along the front.
        curvature, curvature_slope : (...,) [1/m], [1/m^2]
            Curvature, positive if the crack is convex, and the derivative by s.
        """
        first_derivative, second_derivative, third_derivative = (
            self.curve_function(t, order) for order in (1, 2, 3)
        )
        speed = np.linalg.norm(first_derivative, axis=-1)
        e_3 = first_derivative / speed[..., None]
        e_2 = np.stack(
            [
                np.interp(t, self.node_parameters, normal_components)
                for normal_components in self.node_normals.T
            ],
            axis=-1,
        )
        e_2 -= (e_2 * e_3).sum(-1, keepdims=True) * e_3
        e_2 /= np.linalg.norm(e_2, axis=-1, keepdims=True)
        e_1 = np.cross(e_2, e_3)
        curvature = -(second_derivative * e_1).sum(-1) / speed**2
        curvature_slope = -(third_derivative * e_1).sum(-1) / speed**3
        curvature_slope -= (
            3.0 * curvature * (first_derivative * second_derivative).sum(-1) / speed**3
        )
        return np.stack([e_1, e_2, e_3], axis=-2), speed, curvature, curvature_slope

    @cached_property
    def straight_domain_radius(self) -> float:
        """Return the radius [m] of the integration domain, without the limit by curvature.

        Stress intensities are integrals over a domain around the front. The radius is twice the
        length of the front's longest element, at most ``allowed_domain_radius``.
        """
        max_edge_length = np.linalg.norm(np.diff(self.node_positions, axis=0), axis=1).max()
        return float(min(RADIUS_IN_ELEMENTS * max_edge_length, self.allowed_domain_radius))

    def is_limited_by_curvature(self, curvature: np.ndarray) -> np.ndarray:
        """Return True where the front's curvature limits the integration domain.

        Stress intensities are integrals over a domain around the front. The domain's radius is at
        most 0.6 times the front's radius of curvature. ``curvature`` [1/m] may have any shape; the
        result has the same shape.
        """
        return np.asarray(
            np.abs(curvature) * self.straight_domain_radius > MAX_RADIUS_TO_CURVATURE_RADIUS
        )

    def domain_radius(self, curvature: np.ndarray) -> np.ndarray:
        """Return the radius [m] of the integration domain at points with given front curvatures.

        Stress intensities are integrals over this domain around the front. The radius is the
        smaller of ``straight_domain_radius`` and 0.6 times the radius of curvature. ``curvature``
        [1/m] may have any shape; the result has the same shape.
        """
        is_limited = self.is_limited_by_curvature(curvature)
        return np.where(
            is_limited,
            MAX_RADIUS_TO_CURVATURE_RADIUS / np.where(is_limited, np.abs(curvature), 1.0),
            self.straight_domain_radius,
        )

    @cached_property
    def _sample_parameters_and_tree(self) -> tuple[np.ndarray, cKDTree]:
        """Return sample points on the front's curve c(t), eight for each node of the front.

        Used to start the search for the nearest front point. The first result has the samples'
        curve parameters t (n,). The second result is a search tree (cKDTree) with the samples'
        positions [m].
        """
        t = np.interp(
            np.linspace(0, len(self.node_parameters) - 1, 8 * len(self.node_parameters)),
            range(len(self.node_parameters)),
            self.node_parameters,
        )
        return t, cKDTree(self.curve_function(t, 0))

    def nearest_parameters(self, points: np.ndarray) -> np.ndarray:
        """Return the parameter t of the nearest front point for points (..., 3) [m]: (...)."""
        sample_parameters, sample_tree = self._sample_parameters_and_tree
        t = sample_parameters[sample_tree.query(points)[1]]
        for _ in range(3):  # Newton's steps
            curve_points, first_derivative, second_derivative = (
                self.curve_function(t, order) for order in range(3)
            )
            offsets_from_curve = points - curve_points
            t = t + (offsets_from_curve * first_derivative).sum(-1) / (
                (first_derivative * first_derivative).sum(-1)
                - (offsets_from_curve * second_derivative).sum(-1)
            )
            if not self.is_closed:
                t = np.clip(t, self.node_parameters[0], self.node_parameters[-1])
        if self.is_closed:
            t = self.node_parameters[0] + np.mod(
                t - self.node_parameters[0], self.node_parameters[-1] - self.node_parameters[0]
            )
        return np.asarray(t)


def find_fronts(structure: Structure) -> list[Front]:
    """Find the smooth parts of all crack fronts in a solid, crack by crack (collective).

    Fronts are cut at corners with 45 degrees or more.
    """
    structure_nodes = structure.nodes
    assert structure_nodes is not None
    cracks: tuple[CrackSurface, ...] = (
        structure_nodes.dolfinx_mesh_and_dofs.part_mesh.crack_paths_or_surfaces
    )
    clamped_points = gather_rows(
        structure.comm, structure_nodes.points[np.all(structure_nodes.dofs < 0, axis=1)]
    )
    front_arguments = []
    for crack_index, crack in enumerate(cracks):
        triangle_corners_of_other_cracks = [
            other_crack.triangle_corner_points.reshape(-1, 3)
            for other_crack in cracks
            if other_crack is not crack
        ]
        obstacle_tree = cKDTree(np.concatenate([clamped_points, *triangle_corners_of_other_cracks]))
        for (
            chain_points,
            node_normals,
            is_closed,
            is_each_end_at_surface,
        ) in _yield_smooth_front_parts(crack):
            allowed_domain_radius = (
                MAX_RADIUS_TO_CLEARANCE * obstacle_tree.query(chain_points)[0].min()
            )
            front_arguments.append(
                (
                    crack_index,
                    chain_points,
                    node_normals,
                    *_fit_parameters_and_curve(chain_points, is_closed),
                    is_closed,
                    is_each_end_at_surface,
                    allowed_domain_radius,
                )
            )
    return [
        Front(
            "the crack front" + (f" {front_index + 1}" if len(front_arguments) > 1 else ""),
            *arguments,
        )
        for front_index, arguments in enumerate(front_arguments)
    ]


def _yield_smooth_front_parts(
    crack: CrackSurface,
) -> Iterator[tuple[np.ndarray, np.ndarray, bool, tuple[bool, bool]]]:
    """Yield the smooth parts of a crack's front, cut at corners of 45 degrees or more.

    Yields
    ------
    points : (n, 3) [m]
        Positions of the front's nodes, in order.
    node_normals : (n, 3)
        Unit normals of the crack at the nodes, from the lower to the upper face.
    is_closed : bool
        True if the front has neither ends nor corners.
    is_each_end_at_surface : tuple of bool
        True for each end at the solid's surface.
    """
    triangle_corner_positions = crack.triangle_corner_points.reshape(-1, 3)
    triangle_corner_tree = cKDTree(triangle_corner_positions)
    coincident_triangle_corners = triangle_corner_tree.query_ball_point(
        triangle_corner_positions, RELATIVE_POSITION_TOLERANCE * crack.size
    )
    node_of_triangle_corner = np.array([min(corners) for corners in coincident_triangle_corners])
    triangle_normals = size_weighted_normals(crack.triangle_corner_points)
    triangle_normals *= np.array([[upward_sign(normal)] for normal in triangle_normals])
    node_normals, triangle_centre_near_node = np.zeros((2, len(triangle_corner_positions), 3))
    np.add.at(node_normals, node_of_triangle_corner, np.repeat(triangle_normals, 3, axis=0))
    np.add.at(
        triangle_centre_near_node,
        node_of_triangle_corner,
        np.repeat(crack.triangle_corner_points.mean(axis=1), 3, axis=0),
    )
    triangle_centre_near_node /= np.maximum(
        np.bincount(node_of_triangle_corner, minlength=len(triangle_centre_near_node)), 1
    )[:, None]
    triangle_corner_of_chord_end = triangle_corner_tree.query(crack.front_chords.reshape(-1, 3))[1]
    for nodes in find_node_chains(
        node_of_triangle_corner[triangle_corner_of_chord_end].reshape(-1, 2)
    ):
        is_closed = bool(nodes[0] == nodes[-1])
        chained_points, point_normals = triangle_corner_positions[nodes], node_normals[nodes]
        inward_vectors = triangle_centre_near_node[nodes] - chained_points
        point_normals /= np.linalg.norm(point_normals, axis=1)[:, None]
        edge_vectors = np.diff(chained_points, axis=0)
        edge_side_vectors = np.cross(point_normals[:-1] + point_normals[1:], edge_vectors)
        if (edge_side_vectors * (inward_vectors[:-1] + inward_vectors[1:])).sum() > 0.0:
            chained_points = chained_points[::-1]
            point_normals = point_normals[::-1]
            edge_vectors = -edge_vectors[::-1]
        edge_vectors /= np.linalg.norm(edge_vectors, axis=1)[:, None]
        corner_indices = np.flatnonzero(
            (np.roll(edge_vectors, 1, axis=0) * edge_vectors).sum(axis=1) < np.cos(MIN_CORNER_ANGLE)
        ).tolist()
        if is_closed and corner_indices:
            start_index = corner_indices[0]
            chained_points, point_normals = (
                np.concatenate(
                    [positions_or_normals[start_index:-1], positions_or_normals[: start_index + 1]]
                )
                for positions_or_normals in (chained_points, point_normals)
            )
            corner_indices = [corner_index - start_index for corner_index in corner_indices]
        for first_index_of_part, last_index_of_part in pairwise(
            sorted({0, *corner_indices, len(edge_vectors)})
        ):
            is_each_end_at_surface = (
                first_index_of_part == 0 and not is_closed,
                last_index_of_part == len(edge_vectors) and not is_closed,
            )
            yield (
                chained_points[first_index_of_part : last_index_of_part + 1],
                point_normals[first_index_of_part : last_index_of_part + 1],
                is_closed and not corner_indices,
                is_each_end_at_surface,
            )


def _fit_parameters_and_curve(
    node_positions: np.ndarray, is_closed: bool
) -> tuple[np.ndarray, Callable[[np.ndarray, int], np.ndarray]]:
    """Fit a curve c(t) through node positions (n, 3) [m].

    If more than five nodes lie on an ellipse, within 1e-5 of the half axes, the curve is the
    ellipse; otherwise a cubic spline.

    Returns
    -------
    node_parameters : (n,)
        Parameter t of each node: angle on the ellipse [rad], or distance along the nodes [m].
    curve_function : callable
        Takes t (...) and an order; returns c(t) [m] for order 0, else the derivative of this order
        by t: (..., 3).
    """
    centroid = node_positions.mean(axis=0)
    _, extents, axes = np.linalg.svd(node_positions - centroid, full_matrices=False)
    scaled_x, scaled_y = ((node_positions - centroid) @ axes[:2].T / extents[0]).T
    if (
        len(node_positions) > 5
        and extents[1] > RELATIVE_POSITION_TOLERANCE * extents[0]
        and extents[2] <= RELATIVE_POSITION_TOLERANCE * extents[0]
    ):
        conic_terms = np.column_stack(
            [
                scaled_x * scaled_x,
                2.0 * scaled_x * scaled_y,
                scaled_y * scaled_y,
                -2.0 * scaled_x,
                -2.0 * scaled_y,
            ]
        )
        xx_coefficient, xy_coefficient, yy_coefficient, x_coefficient, y_coefficient = (
            np.linalg.lstsq(conic_terms, np.ones(len(scaled_x)), rcond=None)[0]
        )
        quadratic_form = np.array(
            [[xx_coefficient, xy_coefficient], [xy_coefficient, yy_coefficient]]
        )
        if np.linalg.det(quadratic_form) > 0.0:
            scaled_ellipse_center = np.linalg.solve(quadratic_form, [x_coefficient, y_coefficient])
            conic_eigenvalues, conic_eigenvectors = np.linalg.eigh(
                quadratic_form
                / (1.0 + scaled_ellipse_center @ quadratic_form @ scaled_ellipse_center)
            )
            unit_points = (
                (np.column_stack([scaled_x, scaled_y]) - scaled_ellipse_center)
                @ conic_eigenvectors
                * np.sqrt(np.abs(conic_eigenvalues))
            )
            if (
                np.all(conic_eigenvalues > 0.0)
                and np.abs(np.linalg.norm(unit_points, axis=1) - 1.0).max() < 1e-5
            ):
                t = np.unwrap(np.arctan2(unit_points[:, 1], unit_points[:, 0]))
                turning_sign = np.sign(t[-1] - t[0])
                half_axes = (
                    extents[0]
                    * (conic_eigenvectors / np.sqrt(conic_eigenvalues))
                    @ np.diag([1.0, turning_sign])
                )
                return turning_sign * t, partial(
                    _evaluate_ellipse,
                    centroid + extents[0] * scaled_ellipse_center @ axes[:2],
                    half_axes.T @ axes[:2],
                )
    edge_lengths = np.linalg.norm(np.diff(node_positions, axis=0), axis=1)
    t = np.append(0.0, np.cumsum(edge_lengths))
    spline = CubicSpline(t, node_positions, bc_type="periodic" if is_closed else "not-a-knot")

    return t, lambda t, order: np.asarray(spline(t, order))


def _evaluate_ellipse(
    center: np.ndarray, half_axes: np.ndarray, t: np.ndarray, order: int
) -> np.ndarray:
    """Evaluate an ellipse or a derivative of given order at parameters t: (..., 3).

    The ellipse is center + half_axes[0] cos t + half_axes[1] sin t; ``half_axes`` is (2, 3).
    """
    angle = np.asarray(t)[..., None] + 0.5 * np.pi * order
    offset_or_derivative = np.cos(angle) * half_axes[0] + np.sin(angle) * half_axes[1]
    return np.asarray(offset_or_derivative + center if order == 0 else offset_or_derivative)
