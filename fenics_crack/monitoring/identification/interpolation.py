"""Smooth interpolation of many quantities over a few unknowns, with its error.

Quantities on a grid of unknowns are interpolated by tensor products of cubic splines, without knots
next to the ends (C. de Boor, A Practical Guide to Splines, 1978, chapters 4 and 17).

The error along each axis is estimated by leaving out an inner node. A spline through the other
nodes on the line misses its value by the error of twice the spacing. This difference is 16 times
the true error for a smooth quantity. It is 4/3 times the true error if the meshes of different
cracks make the values uneven. Therefore 30 % of the difference are taken. The errors at the nodes
around a point, in all quantities together, give the covariance at this point.

A thin-plate spline through the solved cases replaces the values of a failed case. At least half of
the nodes must be known, and one more than a quadratic polynomial has terms: with one unknown and
four nodes, none may fail. The error at a failed case is estimated at the nearest known node, as the
full difference from a spline without this node. The estimate holds between known nodes; beyond the
last known node, the spline misses poles of harmonics.

Quantities are interpolated in three smooth forms. Natural frequencies without the crack are
logarithms. Natural frequencies with the crack are changes of these logarithms by the crack, divided
by the crack size if the size is an unknown. Harmonics are complex numbers, a - i b for
a cos + b sin, since amplitudes have kinks at zeros. Harmonics also have poles, which move with the
crack. A pole lies at the crack for which k times the load frequency W equals a natural frequency
w_j of the breathing crack; its width depends on the damping ratio z.

The first harmonic moves the crack faces, and their contact drives the harmonics k > 1. A pole of
the first harmonic makes the whole motion larger and later. It therefore multiplies the size of the
k-th harmonic once, and its phase k times. With the displacement U_k of the k-th harmonic, the
smooth form is

    U_k p_k |p_1| exp(i k arg p_1) / s^n,      p_k = prod_j (1 - r^2 + 2 i z r),      r = k W / w_j,

without p_1 for the first harmonic. The bilinear frequencies w_j are those of the same nodes. The
split s sums over the modes the relative difference between frequencies with the crack bonded and
open, times its static compliance relative to the first mode, 1 / w_j^2. The split measures how much
the load bends the plate at the crack, and how much the crack softens the plate. A short crack,
which is closed for half of the period, has a small split. Its even harmonics are then proportional
to s (n = 1), the odd harmonics above the first to s^2 (n = 2).

Shapes: m points x of d unknowns, n nodes of the grid, q quantities, f features.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import RBFInterpolator, make_interp_spline
from scipy.spatial.distance import cdist
from scipy.special import softmax

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.tables import RAD_PER_TURN
from fenics_crack.monitoring.identification.measurements import Measurement
from fenics_crack.monitoring.identification.options import IDENTIFICATION_VALUES
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.scene import Scene
from fenics_crack.sweep.file import STORED_HARMONIC_ORDERS, STORED_MODE_NUMBER_RANGE, CaseState
from fenics_crack.sweep.result import SweepResult


@dataclass(frozen=True)
class UnknownGrid:
    """Grid of the values of d unknowns at which cases are solved.

    An unknown is a key of the scene, such as the crack length, that identification shall find.

    Attributes
    ----------
    axes : tuple of (n_i,) arrays
        Values of each unknown in ascending order; empty without unknowns.
    """

    axes: tuple[np.ndarray, ...]

    @property
    def lower_bounds(self) -> np.ndarray:
        """Return the smallest value of each unknown: (d,)."""
        return np.array([axis_values[0] for axis_values in self.axes])

    @property
    def upper_bounds(self) -> np.ndarray:
        """Return the largest value of each unknown: (d,)."""
        return np.array([axis_values[-1] for axis_values in self.axes])

    @cached_property
    def nodes(self) -> np.ndarray:
        """Return all grid nodes, the combinations of the unknowns' values: (n, d).

        The last unknown varies fastest.
        """
        value_grids = np.array(np.meshgrid(*self.axes, indexing="ij"), dtype=float)
        return value_grids.reshape(len(self.axes), math.prod(self.shape)).T

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the number of values of each unknown."""
        return tuple(len(axis_values) for axis_values in self.axes)

    def find_node_coordinates(self, x: np.ndarray) -> np.ndarray:
        """Convert values of the unknowns to positions on the axes.

        ``x`` (m, d) has m values of the d unknowns; the result has the same shape. The i-th value
        on an axis has the position i, counted from 0. Positions between two values are interpolated
        linearly.
        """
        axis_position_columns = [
            np.interp(x_column, axis_values, np.arange(len(axis_values)))
            for x_column, axis_values in zip(x.T, self.axes, strict=True)
        ]
        return np.stack(axis_position_columns, axis=1)


def _fit_spline(axis_values: np.ndarray, node_values: np.ndarray) -> Any:
    """Return a cubic spline through values (n, ...) at the points of an axis (n,).

    The spline is a function of points on the axis. With fewer than four values the degree is n - 1.
    """
    return make_interp_spline(axis_values, node_values, k=min(3, len(axis_values) - 1))


def compute_leave_one_out_errors(axis_values: np.ndarray, node_values: np.ndarray) -> np.ndarray:
    """Return a spline's error at each grid node if this node is left out.

    ``axis_values`` (n,) are the nodes; ``node_values`` (n, ...) are the quantities at the nodes.
    The errors have the shape (n, ...), in the units of the quantities. An end node is never left
    out, and gets its neighbour's error.
    """
    node_errors = np.zeros_like(node_values)
    for node_index in range(1, len(axis_values) - 1):
        is_other_node = np.arange(len(axis_values)) != node_index
        node_errors[node_index] = node_values[node_index] - _fit_spline(
            axis_values[is_other_node], node_values[is_other_node]
        )(axis_values[node_index])
    node_errors[0], node_errors[-1] = node_errors[1], node_errors[-2]
    return node_errors


class Interpolation:
    """Interpolation of q quantities over the unknowns by splines, with its errors.

    A grid node is known for a quantity if the case there was solved.

    Parameters
    ----------
    grid_of_solved_cases : UnknownGrid
        Grid of the solved values of the unknowns.
    node_values : (n, q)
        Quantities at all grid nodes; nan for failed cases.

    Attributes
    ----------
    has_enough_known_nodes : (q,) bool
        True for a quantity with enough known nodes to fill its failed cases
        (:func:`_fill_unknown_nodes`).
    are_failed_cases_between_known : (q,) bool
        True for a quantity if every failed case lies between two known nodes along an axis.
    """

    def __init__(self, grid_of_solved_cases: UnknownGrid, node_values: np.ndarray) -> None:
        self.grid_of_solved_cases = grid_of_solved_cases
        self.are_failed_cases_between_known = _has_only_inner_gaps(
            grid_of_solved_cases, np.isfinite(node_values)
        )
        node_values, self.has_enough_known_nodes, fill_errors = _fill_unknown_nodes(
            grid_of_solved_cases, node_values
        )
        self._node_values = node_values
        # Cardinal splines of each axis: 1 at one value, 0 at all other values.
        self._basis_splines = [
            _fit_spline(axis_values, np.eye(len(axis_values)))
            for axis_values in grid_of_solved_cases.axes
        ]
        if grid_of_solved_cases.axes:
            node_values_on_grid = node_values.reshape(
                *grid_of_solved_cases.shape, node_values.shape[1]
            )
            leave_one_out_errors_along_axes = (
                np.moveaxis(
                    compute_leave_one_out_errors(
                        axis_values, np.moveaxis(node_values_on_grid, axis_index, 0)
                    ),
                    0,
                    axis_index,
                )
                for axis_index, axis_values in enumerate(grid_of_solved_cases.axes)
            )
            self._node_errors_along_axes = [
                IDENTIFICATION_VALUES.error_per_leave_one_out_error
                * errors_along_axis.reshape(node_values.shape)
                for errors_along_axis in leave_one_out_errors_along_axes
            ]
            if fill_errors.any():
                self._node_errors_along_axes.append(fill_errors)

    def interpolate(self, x: np.ndarray) -> np.ndarray:
        """Interpolate the quantities to values x (m, d) of the unknowns: (m, q).

        Values outside the bounds move to the bounds. Quantities with too many failed cases are 0.
        """
        node_weights = np.ones((len(x), 1))
        for x_column, axis_values, basis_spline in zip(
            x.T, self.grid_of_solved_cases.axes, self._basis_splines, strict=True
        ):
            weights_along_axis = basis_spline(np.clip(x_column, axis_values[0], axis_values[-1]))
            node_weights = (node_weights[:, :, None] * weights_along_axis[:, None, :]).reshape(
                len(x), -1
            )
        return np.asarray(node_weights @ self._node_values)

    def list_weighted_node_errors(self, x: np.ndarray) -> np.ndarray:
        """Return independent interpolation errors of q quantities: (m, k, q).

        The variance at a point is a weighted mean of the variances at grid nodes around the point.
        Each node adds one error for each axis, and one for failed cases, if any: together k errors.
        The sum of the k squares is the variance of the quantity. ``x`` (m, d) are m points, each
        with values of the d unknowns.
        """
        errors_along_axes = self.list_weighted_node_errors_along_axes(x)
        return (
            np.concatenate(errors_along_axes, axis=1)
            if errors_along_axes
            else np.zeros((len(x), 0, len(self.has_enough_known_nodes)))
        )

    def list_weighted_node_errors_along_axes(self, x: np.ndarray) -> list[np.ndarray]:
        """Return independent interpolation errors of q quantities along each axis.

        The errors are those of :meth:`list_weighted_node_errors`, separated by their cause. ``x``
        (m, d) are m points, each with values of the d unknowns.

        Returns
        -------
        list of (m, k, q)
            An array for each axis, with the errors from k grid nodes around each point. If a case
            failed, a last array has the errors due to failed cases. Without unknowns the list is
            empty.
        """
        if not self.grid_of_solved_cases.axes:
            return []
        node_coordinates = self.grid_of_solved_cases.find_node_coordinates(
            self.grid_of_solved_cases.nodes
        )
        weight_exponents = (
            -0.5
            / IDENTIFICATION_VALUES.error_averaging_width_in_nodes**2
            * cdist(
                self.grid_of_solved_cases.find_node_coordinates(x), node_coordinates, "sqeuclidean"
            )
        )
        n_averaged_nodes = min(
            IDENTIFICATION_VALUES.max_nodes_in_error_average, len(node_coordinates)
        )
        nearest_node_indices = np.argpartition(-weight_exponents, n_averaged_nodes - 1, axis=1)[
            :, :n_averaged_nodes
        ]
        weight_exponents = np.take_along_axis(weight_exponents, nearest_node_indices, axis=1)
        node_weights = softmax(weight_exponents, axis=1)
        return [
            np.sqrt(node_weights)[..., None] * node_errors[nearest_node_indices]
            for node_errors in self._node_errors_along_axes
        ]


def _has_only_inner_gaps(grid_of_solved_cases: UnknownGrid, is_known: np.ndarray) -> np.ndarray:
    """Return True for each quantity whose failed cases lie between solved cases: (q,).

    Each failed case must have solved cases on both sides along at least one axis. ``is_known`` (n,
    q) is True for solved cases at n grid nodes.
    """
    is_known_on_grid = is_known.reshape(*grid_of_solved_cases.shape, is_known.shape[1])
    is_known_or_between = is_known_on_grid.copy()
    for axis_index in range(len(grid_of_solved_cases.axes)):
        is_known_on_lines = np.moveaxis(is_known_on_grid, axis_index, 0)
        is_known_below, is_known_above = (
            np.logical_or.accumulate(is_known_in_order)
            for is_known_in_order in (is_known_on_lines, is_known_on_lines[::-1])
        )
        is_known_or_between |= np.moveaxis(is_known_below & is_known_above[::-1], 0, axis_index)
    return np.asarray(is_known_or_between.reshape(is_known.shape).all(axis=0))


def _fill_unknown_nodes(
    grid_of_solved_cases: UnknownGrid, node_values: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fill the values of failed cases by a thin-plate spline through the solved cases.

    A quantity has enough known nodes if at least half of the n grid nodes are solved. The number of
    solved nodes must also exceed (d + 1)(d + 2) / 2, the number of terms in a quadratic polynomial
    of d unknowns. A quantity without failed cases always has enough.

    Parameters
    ----------
    grid_of_solved_cases : UnknownGrid
        Grid with n nodes.
    node_values : (n, q)
        Quantities at the nodes; nan for failed cases.

    Returns
    -------
    gapless_node_values : (n, q)
        Values without gaps; 0 for quantities without enough known nodes.
    has_enough_known_nodes : (q,) bool
        True for a quantity with enough known nodes.
    fill_errors : (n, q)
        Estimated errors at filled nodes; 0 at solved nodes.
    """
    is_known, n_unknowns = np.isfinite(node_values), len(grid_of_solved_cases.axes)
    min_total_of_known_nodes = max(
        (n_unknowns + 1) * (n_unknowns + 2) // 2 + 1, len(node_values) / 2
    )
    has_enough_known_nodes = is_known.all(axis=0) | (
        (is_known.sum(axis=0) >= min_total_of_known_nodes) & (n_unknowns > 0)
    )
    gapless_node_values = np.where(is_known & has_enough_known_nodes, node_values, 0.0)
    fill_errors = np.zeros_like(gapless_node_values)
    for quantity_index in np.flatnonzero(has_enough_known_nodes & ~is_known.all(axis=0)):
        is_known_node, quantity_values = is_known[:, quantity_index], node_values[:, quantity_index]
        scaled_node_coordinates = (
            grid_of_solved_cases.nodes - grid_of_solved_cases.lower_bounds
        ) / (grid_of_solved_cases.upper_bounds - grid_of_solved_cases.lower_bounds)
        gapless_node_values[~is_known_node, quantity_index] = _interpolate_thin_plate(
            scaled_node_coordinates[is_known_node],
            quantity_values[is_known_node],
            scaled_node_coordinates[~is_known_node],
        )
        for unknown_node_index in np.flatnonzero(~is_known_node):
            node_distances = np.linalg.norm(
                scaled_node_coordinates - scaled_node_coordinates[unknown_node_index], axis=1
            )
            nearest_node_index = np.argmin(np.where(is_known_node, node_distances, np.inf))
            is_other_known_node = is_known_node & (
                np.arange(len(is_known_node)) != nearest_node_index
            )
            leave_out_estimate_at_nearest_node = _interpolate_thin_plate(
                scaled_node_coordinates[is_other_known_node],
                quantity_values[is_other_known_node],
                scaled_node_coordinates[nearest_node_index, None],
            )
            fill_errors[unknown_node_index, quantity_index] = (
                quantity_values[nearest_node_index] - leave_out_estimate_at_nearest_node[0]
            )
    return gapless_node_values, has_enough_known_nodes, fill_errors


def _interpolate_thin_plate(
    nodes: np.ndarray, node_values: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Interpolate values (n,) at nodes (n, d) by a thin-plate spline.

    Return values (m,) at points (m, d).
    """
    return np.asarray(RBFInterpolator(nodes, node_values, kernel="thin_plate_spline")(points))


# --- interpolated quantities ----------------------------------------------------------------------

MESH_FILE_AXIS_KEY = "mesh.file"
"""Key of a sweep's axis over the files of ``[identify.meshes]``."""


class SweptLoads:
    """Loads at which the cases of the forward model are solved.

    If the load has an engine order, each load frequency belongs to a rotor speed. The first load
    then has the scene's rotor speed. A natural frequency that was measured without a stated speed
    is taken from the first load.

    Attributes
    ----------
    frequencies : tuple of float
        Load frequencies [Hz].
    frequency_or_rpm_axis : Axis
        Last axis of the sweep over all cases: load frequencies [Hz]; with an engine order, rotor
        speeds [rpm].
    """

    def __init__(self, scene: Scene, frequencies: Sequence[float]) -> None:
        """Take load frequencies [Hz], each value once.

        If the load has an engine order, the scene's own load frequency comes first. Without an
        engine order, the scene's frequency is taken only if ``frequencies`` is empty.
        """
        engine_order, sorted_frequencies = scene.excitation.order, sorted(set(frequencies))
        scene_load_frequency = float(
            f"{scene.excitation.omega / RAD_PER_TURN:.9g}"
        )  # rounded as the load frequency of arrivals
        if engine_order is None:
            self.frequencies = tuple(sorted_frequencies) or (scene_load_frequency,)
            self.frequency_or_rpm_axis = Axis("excitation.frequency", self.frequencies)
        else:
            self.frequencies = (
                scene_load_frequency,
                *(
                    frequency
                    for frequency in sorted_frequencies
                    if frequency != scene_load_frequency
                ),
            )
            speeds_rpm = tuple(60.0 * frequency / engine_order for frequency in self.frequencies)
            self.frequency_or_rpm_axis = Axis("rotation.rpm", speeds_rpm)

    @property
    def has_rotor_speeds(self) -> bool:
        """Return True if each load has a rotor speed, by an engine order."""
        return self.frequency_or_rpm_axis.key == "rotation.rpm"

    @property
    def rotor_speed_ratios(self) -> np.ndarray:
        """Return each load's rotor speed over the scene's speed: (n_loads,).

        All are 1 without an engine order.
        """
        frequency_array = np.array(self.frequencies)
        return (
            frequency_array / frequency_array[0]
            if self.has_rotor_speeds
            else np.ones(len(frequency_array))
        )


class SolvedCases:
    """Solved cases of a sweep over unknowns and loads.

    Some unknowns have text values, for example crack.edge with "left" and "right". The cases belong
    to one chosen value of each. The n grid nodes are all combinations of the values of the
    remaining unknowns, which are numbers. ``uncracked_cases`` are the same cases without the crack,
    or None.
    """

    def __init__(
        self,
        sweep_result: SweepResult,
        swept_loads: SweptLoads,
        mesh_number_axes: Sequence[Axis],
        text_value_by_unknown_key: Mapping[str, Any],
        uncracked_cases: SolvedCases | None = None,
    ) -> None:
        """Take the solved cases for one value of each unknown with text values.

        Parameters
        ----------
        sweep_result : SweepResult
            Sweep with the loads on its last axis.
        swept_loads : SweptLoads
            Loads of the sweep.
        mesh_number_axes : sequence of Axis
            Used with ``[identify.meshes]``: unknowns whose numbers belong to the mesh files, such
            as the crack length in each file. They replace the axis over the files. Empty without
            mesh files.
        text_value_by_unknown_key : dict
            Chosen text value by key of the unknown.
        uncracked_cases : SolvedCases, optional
            Cases without the crack.
        """
        self.sweep_result = sweep_result
        self.swept_loads = swept_loads
        self.uncracked_cases = uncracked_cases
        unknown_axes = sweep_result.axes[:-1]
        self.sweep_slices_for_text_values = tuple(
            axis.values.index(text_value_by_unknown_key[axis.key])
            if axis.key in text_value_by_unknown_key
            else slice(None)
            for axis in unknown_axes
        )
        number_axes: list[Axis] = []
        for axis in unknown_axes:
            if axis.key not in text_value_by_unknown_key:
                number_axes += mesh_number_axes if axis.key == MESH_FILE_AXIS_KEY else [axis]
        self.grid_of_solved_cases = UnknownGrid(
            tuple(np.array(axis.values, dtype=float) for axis in number_axes)
        )
        self.unknown_keys = tuple(axis.key for axis in number_axes)

    def get_column(self, column_name: str) -> np.ndarray:
        """Return a result column of the sweep at all grid nodes and loads: (n, n_loads).

        ``column_name`` is the name in the sweep's table, such as "harmonics".
        """
        column = self.sweep_result[column_name][self.sweep_slices_for_text_values]
        return np.asarray(column.reshape(-1, column.shape[-1]), dtype=float)

    def get_natural_frequencies(self, crack_state: str, mode: int) -> np.ndarray:
        """Return natural frequencies of a mode [Hz]: (n, n_loads).

        The frequencies are at all n combinations of the unknowns (grid nodes), and all loads.
        ``crack_state`` is "open", "tied" (bonded), "bilinear" or "uncracked"; ``mode`` counts from
        1. If the crack cannot be removed, the bonded crack replaces "uncracked". nan marks unknown
        frequencies.
        """
        if crack_state == "uncracked":
            if self.uncracked_cases is None:
                return self.get_natural_frequencies("tied", mode)
            frequencies = self.uncracked_cases.get_natural_frequencies("tied", mode)
            broadcast_shape_of_uncracked_grid = [
                n_values if key in self.uncracked_cases.unknown_keys else 1
                for key, n_values in zip(
                    self.unknown_keys, self.grid_of_solved_cases.shape, strict=True
                )
            ]
            n_loads = frequencies.shape[1]
            frequencies = np.broadcast_to(
                frequencies.reshape(*broadcast_shape_of_uncracked_grid, n_loads),
                (*self.grid_of_solved_cases.shape, n_loads),
            )
            return frequencies.reshape(-1, n_loads)
        frequencies = self.get_column(f"omega_{crack_state}_{mode}") / (2.0 * np.pi)
        if self.swept_loads.has_rotor_speeds:
            return frequencies
        largest_frequency_over_loads = np.fmax.reduce(frequencies, axis=1, keepdims=True)
        return np.broadcast_to(largest_frequency_over_loads, frequencies.shape)

    def get_harmonic_amplitudes(
        self, point_name: str, load_frequency: float, harmonic_order: int
    ) -> np.ndarray:
        """Return complex amplitudes of a harmonic at all grid nodes: (n,) [m].

        An amplitude a - i b stands for the motion a cos + b sin. It is 0 in cases with fewer
        harmonics, and nan in failed cases.

        Parameters
        ----------
        point_name : str
            Point and direction, such as "tip.ux"; "" for the load's point.
        load_frequency : float [Hz]
            Load frequency.
        harmonic_order : int
            Order of the harmonic, from 1.
        """
        column_prefix = f"{point_name}." if point_name else ""
        cosine_amplitudes, sine_amplitudes = (
            self.get_column(f"{column_prefix}{part_name}_{harmonic_order}")
            for part_name in ("cosine", "sine")
        )
        load_index = self.find_load_index(load_frequency)
        has_too_few_harmonics = self.get_column("harmonics")[:, load_index] < harmonic_order
        complex_amplitudes = np.where(
            has_too_few_harmonics, 0.0, (cosine_amplitudes - 1j * sine_amplitudes)[:, load_index]
        )
        return np.where(
            self.get_column("state")[:, load_index] == CaseState.CONVERGED,
            complex_amplitudes,
            np.nan,
        )

    def find_smallest_harmonic_count(self, load_frequency: float) -> int:
        """Find the smallest number of harmonics in any solved case at a load.

        The load frequency is in Hz. Return 1 if no case is solved.
        """
        load_index = self.find_load_index(load_frequency)
        is_solved = self.get_column("state")[:, load_index] == CaseState.CONVERGED
        return (
            int(self.get_column("harmonics")[is_solved, load_index].min()) if is_solved.any() else 1
        )

    def find_load_index(self, load_frequency: float) -> int:
        """Find the position of a load frequency [Hz] among the solved ones.

        0 Hz stands for the first load.

        Raises
        ------
        InputError
            The frequency is not solved.
        """
        solved_frequencies = self.swept_loads.frequencies
        if load_frequency == 0.0:
            return 0
        if load_frequency not in solved_frequencies:
            frequencies_text = ", ".join(
                f"{solved_frequency:.9g}" for solved_frequency in solved_frequencies
            )
            solved_loads_text = f"one of the solved load frequencies, {frequencies_text} Hz"
            allowed_text = f"{solved_loads_text}; add others to identify.frequencies"
            raise InputError("measurements.frequency", load_frequency, allowed_text)
        return solved_frequencies.index(load_frequency)

    @cached_property
    def frequency_drop_root_and_frequencies(self) -> np.ndarray:
        """Return sqrt(s) and natural frequencies: (n, n_loads, 1 + 2 modes).

        They are used to find the poles of harmonics, which are removed before interpolation. The
        split s measures how much the crack changes the stiffness:

            s = sum_j (w_b,j - w_o,j) / w_b,j (w_b,1 / w_b,j)^2.

        Mode j has the frequency w_b,j with the crack bonded and w_o,j with the crack open. The
        first two dimensions are the n grid nodes and the loads. The last dimension has sqrt(s),
        then the bilinear frequencies of all modes, then their uncracked frequencies [Hz]. Missing
        frequencies are nan. If s is below 1e-9, as without a crack, 1 replaces sqrt(s).
        """
        bonded_frequencies, open_frequencies, bilinear_frequencies, uncracked_frequencies = (
            np.stack(
                [
                    self.get_natural_frequencies(crack_state, mode)
                    for mode in STORED_MODE_NUMBER_RANGE
                ],
                axis=2,
            )
            for crack_state in ("tied", "open", "bilinear", "uncracked")
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            mode_splits = (
                (bonded_frequencies - open_frequencies)
                / bonded_frequencies
                * (bonded_frequencies[..., :1] / bonded_frequencies) ** 2
            )
            split_sum = np.nan_to_num(mode_splits, posinf=0.0, neginf=0.0).sum(axis=2)
        root_of_crack_split = np.where(split_sum > 1e-9, np.sqrt(np.abs(split_sum)), 1.0)
        return np.concatenate(
            [root_of_crack_split[..., None], bilinear_frequencies, uncracked_frequencies], axis=2
        )


CRACK_STATES_AT_RESONANCE = ("bilinear", "open", "tied")
"""Motion of the crack faces at a resonance: breathing, always open, always closed."""


@dataclass(frozen=True)
class Feature:
    """Interpolated quantity (feature): a natural frequency, or a harmonic of a point.

    Attributes
    ----------
    crack_state : str
        "open", "tied" (bonded), "bilinear" or "uncracked" for a natural frequency; "" for a
        harmonic.
    mode : int
        Mode number from 1; 0 for a harmonic.
    measured_point_name : str
        Point and direction of a harmonic, as "tip.ux"; "" for the load's point.
    load_frequency : float [Hz]
        Load frequency. A natural frequency is at the rotor speed of this load; 0 stands for the
        scene's speed.
    harmonic_order : int
        Order of a harmonic, from 1; 0 for a natural frequency.
    """

    crack_state: str = ""
    mode: int = 0
    measured_point_name: str = ""
    load_frequency: float = 0.0
    harmonic_order: int = 0

    @classmethod
    def list_features_of_measurement(
        cls, measurement: Measurement, scene: Scene
    ) -> tuple[Feature, ...]:
        """List the features from which a measurement is predicted.

        For a ratio of harmonics the numerator comes first. A resonance has the three frequencies of
        :data:`CRACK_STATES_AT_RESONANCE`, a displacement all harmonics.
        """
        if measurement.is_natural_frequency:
            state_name = measurement.quantity.removeprefix("frequency_")
            crack_states = CRACK_STATES_AT_RESONANCE if state_name == "resonance" else (state_name,)
            return tuple(
                cls(
                    crack_state,
                    measurement.mode,
                    load_frequency=measurement.get_load_frequency(scene),
                )
                for crack_state in crack_states
            )
        harmonic_orders = measurement.harmonic_orders_of_quantity or STORED_HARMONIC_ORDERS
        return tuple(
            cls("", 0, measurement.point, measurement.get_load_frequency(scene), harmonic_order)
            for harmonic_order in harmonic_orders
        )

    @property
    def error_group_key(self) -> tuple[float, float, float]:
        """Return a key that is equal for features with a common mesh error.

        A common mesh error belongs to all natural frequencies of a mode, or to a harmonic at all
        points under a load. The key is (mode, load frequency [Hz], harmonic order). The last two
        are 0 for a natural frequency, the mode is 0 for a harmonic.
        """
        return (
            self.mode,
            0.0 if self.is_natural_frequency else self.load_frequency,
            self.harmonic_order,
        )

    @property
    def uncracked_frequency_feature(self) -> Feature:
        """Return the same mode's natural frequency without the crack."""
        return replace(self, crack_state="uncracked")

    def get_node_values(self, solved_cases: SolvedCases) -> np.ndarray:
        """Return the feature's values at all grid nodes of solved cases: (n,) complex.

        Values are ln(frequency [Hz]), or complex amplitudes [m].
        """
        if self.is_natural_frequency:
            frequencies = solved_cases.get_natural_frequencies(self.crack_state, self.mode)[
                :, solved_cases.find_load_index(self.load_frequency)
            ]
            return np.log(frequencies).astype(complex)
        return solved_cases.get_harmonic_amplitudes(
            self.measured_point_name, self.load_frequency, self.harmonic_order
        )

    @property
    def crack_split_exponent(self) -> int:
        """Return the exponent n of a feature that is proportional to s^n for short cracks.

        The split s measures how much the crack changes the stiffness
        (:attr:`SolvedCases.frequency_drop_root_and_frequencies`). n is 1 for even harmonics, and 2
        for odd harmonics above the first. n is 0 for the first harmonic and natural frequencies.
        """
        return 1 + self.harmonic_order % 2 if self.harmonic_order > 1 else 0

    @property
    def is_natural_frequency(self) -> bool:
        """Return True for a natural frequency, False for a harmonic."""
        return bool(self.crack_state)

    @property
    def is_cracked_frequency(self) -> bool:
        """Return True for a natural frequency of the plate with the crack."""
        return self.crack_state in ("open", "tied", "bilinear")


def find_frequency_ratios_and_pole_factors(
    features: Sequence[Feature],
    damping_ratio_of_points: np.ndarray,
    frequency_drop_root_and_frequencies: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return frequency ratios r and pole factors, for each mode: (m, f, modes) each.

    A harmonic is large where its frequency meets a natural frequency: it has a pole. The product of
    harmonic and pole factors has no poles. So it can be interpolated.

    For harmonic k at the load frequency W, the ratio to mode j is r = k W / w_j, with the bilinear
    frequency w_j of the mode. The pole factor is 1 - r^2 + 2 i z r, with the damping ratio z. For
    natural frequencies and missing modes, r is 0 and the factor 1.

    Parameters
    ----------
    features : sequence of Feature
        f natural frequencies and harmonics.
    damping_ratio_of_points : (m, 1)
        Damping ratios z at m values of the unknowns.
    frequency_drop_root_and_frequencies : (m, f, 1 + 2 modes)
        :attr:`SolvedCases.frequency_drop_root_and_frequencies` at the load of each feature.
    """
    mode_frequencies = frequency_drop_root_and_frequencies[..., STORED_MODE_NUMBER_RANGE]
    harmonic_frequencies = np.array(
        [feature.harmonic_order * feature.load_frequency for feature in features]
    )
    harmonic_to_mode_ratios = harmonic_frequencies[:, None] / np.where(
        np.isfinite(mode_frequencies), mode_frequencies, np.inf
    )
    return harmonic_to_mode_ratios, (
        1.0
        - harmonic_to_mode_ratios**2
        + 2j * damping_ratio_of_points[..., None] * harmonic_to_mode_ratios
    )


def compute_log_factors_by_first_harmonic(
    first_harmonic_logs: np.ndarray, features: Sequence[Feature]
) -> np.ndarray:
    """Return logarithms of factors on higher harmonics from those on first harmonics.

    The first harmonic drives the harmonics k > 1. If the first harmonic changes by a complex factor
    p, harmonic k changes by the factor abs(p) exp(i k arg p).

    Parameters
    ----------
    first_harmonic_logs : (m, f, ...) complex
        ln p for each of f features: the factor on the first harmonic at the same point and load.
    features : sequence of Feature
        f natural frequencies and harmonics.

    Returns
    -------
    (m, f, ...) complex
        Logarithm of the factor on each feature; 0 for first harmonics and natural frequencies.
    """
    higher_harmonic_order_or_zero = np.array(
        [feature.harmonic_order if feature.harmonic_order > 1 else 0 for feature in features]
    )
    higher_harmonic_order_or_zero = higher_harmonic_order_or_zero.reshape(
        -1, *np.ones(first_harmonic_logs.ndim - 2, dtype=int)
    )
    return (
        np.where(higher_harmonic_order_or_zero > 0, first_harmonic_logs.real, 0.0)
        + 1j * higher_harmonic_order_or_zero * first_harmonic_logs.imag
    )


def replace_by_driving_first_harmonics(features: Sequence[Feature]) -> list[Feature]:
    """Replace each higher harmonic by the first harmonic at the same point and load.

    The result has the pole factors of the first harmonics
    (:func:`find_frequency_ratios_and_pole_factors`). Natural frequencies and first harmonics are
    driven by no first harmonic. They are returned with the harmonic order 0, which gives the pole
    factor 1.
    """
    return [
        replace(feature, harmonic_order=int(feature.harmonic_order > 1)) for feature in features
    ]


def compute_smoothing_factors(
    features: Sequence[Feature],
    damping_ratio_of_points: np.ndarray,
    frequency_drop_root_and_frequencies: np.ndarray,
    relative_crack_sizes: np.ndarray,
) -> np.ndarray:
    """Return factors that make features smooth functions of the unknowns: (m, f).

    A feature is a natural frequency or a harmonic. Feature times factor is smooth, and is
    interpolated instead of the feature:

    - A harmonic's factor removes its poles (:func:`find_frequency_ratios_and_pole_factors`) and its
      growth with a short crack.
    - For a natural frequency with the crack, the feature is ln(frequency with the crack / frequency
      without). Its factor is 1 / relative crack size.
    - For a natural frequency without the crack, the factor is 1.

    Parameters
    ----------
    features : sequence of Feature
        f natural frequencies and harmonics.
    damping_ratio_of_points : (m, 1)
        Damping ratios at m values of the unknowns.
    frequency_drop_root_and_frequencies : (m, f, 1 + 2 modes)
        :attr:`SolvedCases.frequency_drop_root_and_frequencies` at the load of each feature.
    relative_crack_sizes : (m,)
        Crack sizes, 1 for the largest crack.
    """
    split_exponents = np.array([feature.crack_split_exponent for feature in features])
    is_cracked_frequency = np.array([feature.is_cracked_frequency for feature in features])
    smoothing_factors_of_harmonics = find_frequency_ratios_and_pole_factors(
        features, damping_ratio_of_points, frequency_drop_root_and_frequencies
    )[1].prod(axis=2) / frequency_drop_root_and_frequencies[..., 0] ** (2 * split_exponents)
    first_harmonic_pole_factors = find_frequency_ratios_and_pole_factors(
        replace_by_driving_first_harmonics(features),
        damping_ratio_of_points,
        frequency_drop_root_and_frequencies,
    )[1].prod(axis=2)
    smoothing_factors_of_harmonics = smoothing_factors_of_harmonics * np.exp(
        compute_log_factors_by_first_harmonic(np.log(first_harmonic_pole_factors), features)
    )
    return np.where(
        is_cracked_frequency, 1.0 / relative_crack_sizes[:, None], smoothing_factors_of_harmonics
    )
