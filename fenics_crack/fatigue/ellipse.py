"""Growth of a crack shaped as half or a quarter of an ellipse, in depth and along the face.

Let delta K_a be the range of K_I at the deepest point, and delta K_c the range at the ends, on the
solid's face. The depth a and the half axis c along the face grow in a cycle by

    da/dN = C delta K_a^m,      dc/dN = C delta K_c^m.

The front stays an ellipse (Newman, Raju, NASA TM-83200, 1981). Ranges are known on a grid of
depths and lengths. Between them, K / a^(1/2) is a spline over ln a and ln c. The spline has no
logarithm of K, since in bending K falls to zero at the deepest point.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.basics.observables import Place, observable_names
from fenics_crack.basics.tables import format_count
from fenics_crack.fatigue.lengths import (
    GROWTH_SWEEP_COLUMN_NAMES,
    GrowthEnd,
    find_nearest_mode_number,
)
from fenics_crack.scene.result_tables import Growth as Law
from fenics_crack.sweep.result import SweepResult

N_ELLIPSE_SIZES_PER_AXIS = 5
"""Number of solved depths, and of lengths, for a half-ellipse.

Neighbours have equal ratios. With five, the cycles are right to 0.8 % for the K of Newman and Raju;
in equal steps, to 6 % (tests/fatigue/test_ellipse.py).
"""
N_ELLIPSE_PATH_SIZES = 200
"""Number of sizes in an :class:`EllipseSizePath`; a crack without growth has one."""
THRESHOLD_RAMP_FRACTION = 0.01
"""Relative excess over the threshold at which growth has its full rate.

With the effective range delta K of K_I, the rate rises linearly from 0 at growth.threshold to the
growth law at 1.01 times the threshold. The fraction is below the errors of K. With a jump instead,
a shape that grows along the threshold, as deep cracks in bending do, needs endless steps.
"""
EQUIVALENT_RANGE_COLUMN_NAMES = ("delta_K_equivalent_deepest", "delta_K_equivalent_surface")
EFFECTIVE_RANGE_COLUMN_NAMES = ("delta_K_effective_deepest", "delta_K_effective_surface")
"""Columns with ranges of K_I at the deepest point and at the ends on the face.

An equivalent range begins at K_I = 0, and causes the same growth as all cycles of K_I in a load
period. An effective range is the range of K_I while the crack tip is open.
"""


@dataclass(frozen=True)
class EllipseTable:
    """Solutions at a grid of crack depths and lengths, with splines between them.

    Attributes
    ----------
    depths : (k,) [m]
        Depths a in ascending order.
    lengths : (l,) [m]
        Lengths of the crack along the face in ascending order: 2 c for a half-ellipse, c for a
        quarter at an edge.
    column_by_name : dict of str to (k, l)
        Frequencies, response and stress intensities of all shapes, by name of the sweep's column.
        Names of stress intensities and their ranges begin with "K" or "delta_K".
    """

    depths: np.ndarray
    lengths: np.ndarray
    column_by_name: Mapping[str, np.ndarray]

    @cached_property
    def _spline_by_column(self) -> dict[str, Any]:
        """Fit a spline over ln(depth) and ln(length) to each column.

        Keys are column names. Stress intensities are divided by sqrt(depth) before the fit. The
        degree is 3, or k - 1 for an axis with k < 4 sizes.
        """
        from scipy.interpolate import RectBivariateSpline  # takes a while, and is needed here alone

        log_depths_and_lengths = np.log(self.depths), np.log(self.lengths)
        depth_degree, length_degree = (
            min(3, len(log_sizes) - 1) for log_sizes in log_depths_and_lengths
        )
        return {
            column_name: RectBivariateSpline(
                *log_depths_and_lengths,
                column / _compute_column_scales_at_depths(column_name, self.depths)[:, None],
                kx=depth_degree,
                ky=length_degree,
            )
            for column_name, column in self.column_by_name.items()
        }

    def interpolate_column(
        self, column_name: str, depths: np.ndarray, lengths: np.ndarray
    ) -> np.ndarray:
        """Interpolate a column at depths and lengths (n,) [m] inside the grid.

        Return (n,) in the unit of the column. Negative interpolated ranges ("delta_K...") become 0.
        """
        column_values = self._spline_by_column[column_name].ev(np.log(depths), np.log(lengths))
        if column_name.startswith("delta_K"):
            column_values = column_values.clip(0.0)
        return np.asarray(column_values * _compute_column_scales_at_depths(column_name, depths))

    def with_every_second_size(self) -> EllipseTable:
        """Return a coarser table with every second depth and length.

        The life with this table is compared with the full table's life, to estimate the
        interpolation error.
        """
        coarse_column_by_name = {
            column_name: column[::2, ::2] for column_name, column in self.column_by_name.items()
        }
        return EllipseTable(self.depths[::2], self.lengths[::2], coarse_column_by_name)


def _compute_column_scales_at_depths(column_name: str, depths: np.ndarray) -> np.ndarray:
    """Return a column's divisors for interpolation.

    Stress intensities and their ranges grow like sqrt(depth), and have the factor sqrt(depth).
    Other columns have the factor 1.

    Parameters
    ----------
    column_name : str
        Names of stress intensities and ranges begin with "K" or "delta_K".
    depths : (n,) [m]
        Crack depths.

    Returns
    -------
    (n,)
        Factors.
    """
    is_stress_intensity = column_name.startswith(("K", "delta_K"))
    return np.sqrt(depths) if is_stress_intensity else np.ones_like(depths)


class EllipseSizePath(NamedTuple):
    """Depth and length of a growing half-ellipse over the load cycles.

    Attributes
    ----------
    depth, length_along_face : (n,) [m]
        Depth, and length along the face.
    cycles : (n,)
        Load cycles from the beginning until each size.
    growth_per_cycle : (n, 2) [m]
        Growth of depth and length in a load cycle.
    end_reason : str
        Why growth ends: "reached" (depth growth.until), "arrested" (no growth in either direction),
        "broken" (K_max reaches the toughness), or "side" (the largest length in the table).
    """

    depth: np.ndarray
    length_along_face: np.ndarray
    cycles: np.ndarray
    growth_per_cycle: np.ndarray
    end_reason: GrowthEnd


def compute_growth_per_cycle(
    ellipse_table: EllipseTable,
    law: Law,
    n_surface_ends: int,
    depths: np.ndarray,
    lengths: np.ndarray,
) -> np.ndarray:
    """Return the growth of depth and length in a load cycle: (n, 2) [m].

    Let a be the depth, l the length along the face, and N the number of cycles. Growth is driven by
    equivalent ranges of K_I [MPa m^0.5]: delta K_a at the deepest point, and delta K_c at the ends
    on the face (:data:`EQUIVALENT_RANGE_COLUMN_NAMES`). With C and m of the growth law,

        da/dN = C delta K_a^m,      dl/dN = n_surface_ends C delta K_c^m.

    The effective range is the range of K_I while the crack tip is open. Below ``growth.threshold``
    nothing grows. Just above the threshold, growth rises linearly from 0
    (:data:`THRESHOLD_RAMP_FRACTION`).

    Parameters
    ----------
    ellipse_table : EllipseTable
        Ranges of K_I over the shapes.
    law : Growth
        Table ``[growth]`` with C, m and the threshold.
    n_surface_ends : int
        Number of crack ends on the face: 2, or 1 for a quarter-ellipse at an edge.
    depths, lengths : (n,) [m]
        Shapes inside the table.
    """
    growth_rates = []
    for equivalent_column_name, effective_column_name in zip(
        EQUIVALENT_RANGE_COLUMN_NAMES, EFFECTIVE_RANGE_COLUMN_NAMES, strict=True
    ):
        growth_rate = (
            law.rate
            * (ellipse_table.interpolate_column(equivalent_column_name, depths, lengths) / 1e6)
            ** law.exponent
        )
        if law.threshold > 0.0:
            relative_threshold_excess = (
                ellipse_table.interpolate_column(effective_column_name, depths, lengths)
                / law.threshold
                - 1.0
            )
            growth_rate = growth_rate * np.clip(
                relative_threshold_excess / THRESHOLD_RAMP_FRACTION, 0.0, 1.0
            )
        growth_rates.append(growth_rate)
    return np.stack([growth_rates[0], n_surface_ends * growth_rates[1]], axis=-1)


def integrate_ellipse_growth(
    ellipse_table: EllipseTable, law: Law, n_surface_ends: int
) -> EllipseSizePath:
    """Integrate the growth of a half-ellipse from a table's first shape.

    Growth ends as :attr:`EllipseSizePath.end_reason` describes. The integration variable is the sum
    s of the growth in depth a and in length l. With the load cycles N, dN/ds = 1 / (da/dN + dl/dN).
    With this variable, da/ds and dl/ds are bounded, and integration also works if the depth stops
    growing.

    Parameters
    ----------
    ellipse_table : EllipseTable
        Solved shapes; growth starts from the smallest depth and length.
    law : Growth
        Table ``[growth]``.
    n_surface_ends : int
        Number of crack ends on the face: 2, or 1 for a quarter-ellipse at an edge.
    """
    from scipy.integrate import solve_ivp

    toughness = law.toughness or np.inf

    def compute_growth_rates(depth_length_cycles: np.ndarray) -> np.ndarray:
        return compute_growth_per_cycle(
            ellipse_table, law, n_surface_ends, *depth_length_cycles[:2, None]
        )[0]

    def compute_state_slope(_s: float, depth_length_cycles: np.ndarray) -> np.ndarray:
        growth_per_cycle = compute_growth_rates(depth_length_cycles)
        total_growth_per_cycle = growth_per_cycle.sum()
        return (
            np.append(growth_per_cycle, 1.0) / total_growth_per_cycle
            if total_growth_per_cycle > 0.0
            else np.zeros(3)
        )

    event_function_by_reason: dict[GrowthEnd, Any] = {
        "reached": lambda _s, depth_length_cycles: (
            depth_length_cycles[0] - ellipse_table.depths[-1]
        ),
        "side": lambda _s, depth_length_cycles: depth_length_cycles[1] - ellipse_table.lengths[-1],
        "broken": lambda _s, depth_length_cycles: (
            float(ellipse_table.interpolate_column("K_max", *depth_length_cycles[:2, None])[0])
            / toughness
            - 1.0
        ),
        "arrested": lambda _s, depth_length_cycles: (
            -1.0 if compute_growth_rates(depth_length_cycles).any() else 0.0
        ),
    }
    for event_function in event_function_by_reason.values():
        event_function.terminal = True
    start_depth_length_cycles = np.array([ellipse_table.depths[0], ellipse_table.lengths[0], 0.0])
    growth_sum_bound = np.ptp(ellipse_table.depths) + np.ptp(ellipse_table.lengths)
    ode_solution = solve_ivp(
        compute_state_slope, (0.0, growth_sum_bound), start_depth_length_cycles, "LSODA",
        rtol=1e-8, atol=1e-12, max_step=growth_sum_bound / N_ELLIPSE_PATH_SIZES,
        events=list(event_function_by_reason.values()), dense_output=True,
    )  # fmt: skip
    end_reason: GrowthEnd = next(
        (
            reason
            for reason, growth_sums_at_event in zip(
                event_function_by_reason, ode_solution.t_events, strict=True
            )
            if len(growth_sums_at_event)
        ),
        "arrested",
    )
    if event_function_by_reason["broken"](0.0, start_depth_length_cycles) >= 0.0:
        end_reason, last_growth_sum = "broken", 0.0
    else:
        last_growth_sum = (
            ode_solution.t[-1] if compute_growth_rates(start_depth_length_cycles).any() else 0.0
        )
    depths, lengths, cycles = ode_solution.sol(
        np.linspace(0.0, last_growth_sum, N_ELLIPSE_PATH_SIZES if last_growth_sum else 1)
    )
    growth_per_cycle = compute_growth_per_cycle(ellipse_table, law, n_surface_ends, depths, lengths)
    return EllipseSizePath(depths, lengths, cycles, growth_per_cycle, end_reason)


def estimate_ellipse_life_error(
    ellipse_table: EllipseTable, ellipse_path: EllipseSizePath, law: Law, n_surface_ends: int
) -> float:
    """Estimate the relative error of the cycles by interpolation between shapes.

    N cycles are in ``ellipse_path``, and N_coarse cycles follow with every second depth and length.
    The error is abs(ln(N_coarse / N)) / 4, or 0 if N or N_coarse is 0.

    Parameters
    ----------
    ellipse_table, ellipse_path : EllipseTable, EllipseSizePath
        Solved shapes, and the growth through them.
    law : Growth
        Table ``[growth]``.
    n_surface_ends : int
        Number of crack ends on the face: 2, or 1 for a quarter-ellipse at an edge.
    """
    coarse_life = integrate_ellipse_growth(
        ellipse_table.with_every_second_size(), law, n_surface_ends
    ).cycles[-1]
    return (
        abs(math.log(coarse_life / ellipse_path.cycles[-1])) / 4.0
        if coarse_life * ellipse_path.cycles[-1] > 0.0
        else 0.0
    )


def tabulate_ellipses(sweep_result: SweepResult) -> EllipseTable:
    """Make the table of shapes from a sweep over depth and length.

    Values of failed shapes are interpolated by thin-plate splines, and at least 0.

    Raises
    ------
    ConvergenceError
        The first shape has failed, or fewer than :data:`N_ELLIPSE_SIZES_PER_AXIS` are solved.
    """
    from scipy.interpolate import RBFInterpolator  # takes a while, and is needed here alone

    depths, lengths = (np.array(axis.values) for axis in sweep_result.axes)
    is_solved = sweep_result.converged
    if not is_solved[0, 0] or is_solved.sum() < N_ELLIPSE_SIZES_PER_AXIS:
        case_index, failure_text = sweep_result.failed_indices_and_reasons[0]
        raise ConvergenceError(
            f"{_ellipse_in_words(sweep_result, case_index)} was not solved: {failure_text}"
        )
    nearest_mode_number = find_nearest_mode_number(sweep_result, sweep_result["omega"][0, 0])
    sweep_column_name_by_table_column = {
        f"omega_{frequency_kind}": f"omega_{frequency_kind}_{nearest_mode_number}"
        for frequency_kind in ("open", "bilinear")
    }
    column_by_name = {
        column_name: sweep_result[
            sweep_column_name_by_table_column.get(column_name, column_name)
        ].copy()
        for column_name in (
            *GROWTH_SWEEP_COLUMN_NAMES,
            *observable_names(Place.DEEPEST_PLACE_AND_ELLIPSE_ENDS),
        )
    }
    column_by_name["response"] = np.nan_to_num(column_by_name["response"])  # nan if nothing moves
    log_size_grid = np.stack(np.meshgrid(np.log(depths), np.log(lengths), indexing="ij"), axis=-1)
    for column in column_by_name.values() if sweep_result.failed_indices_and_reasons else ():
        interpolated_column_values = RBFInterpolator(log_size_grid[is_solved], column[is_solved])(
            log_size_grid[~is_solved]
        )
        column[~is_solved] = np.maximum(interpolated_column_values, 0.0)
    return EllipseTable(depths, lengths, column_by_name)


def _ellipse_in_words(sweep_result: SweepResult, case_index: tuple[int, ...]) -> str:
    """Describe a crack in a sweep as text, with depth and length.

    ``case_index`` has the crack's positions on the sweep's axes, depth and length.
    """
    depth, length = (
        axis.values[size_index]
        for axis, size_index in zip(sweep_result.axes, case_index, strict=True)
    )
    return f"a crack of {depth:.4g} m depth and {length:.4g} m length"


def list_failed_ellipse_remarks(
    sweep_result: SweepResult, ellipse_table: EllipseTable, ellipse_path: EllipseSizePath
) -> list[str]:
    """Return a list with a remark on unsolved shapes.

    The remark says: growth stays away from failed shapes. The list is empty if no shape has failed.

    Parameters
    ----------
    sweep_result : SweepResult
        Cases over depth and length.
    ellipse_table, ellipse_path : EllipseTable, EllipseSizePath
        Shapes of the sweep, and along the growth.

    Raises
    ------
    ConvergenceError
        Growth comes near to a failed shape: depth and length are both between the next smaller and
        next larger sizes in the table.
    """
    table_and_path_sizes = (
        (ellipse_table.depths, ellipse_path.depth),
        (ellipse_table.lengths, ellipse_path.length_along_face),
    )
    for case_index, failure_text in sweep_result.failed_indices_and_reasons:
        is_near_failed_case = np.full(len(ellipse_path.depth), fill_value=True)
        for size_index, (table_sizes, path_sizes) in zip(
            case_index, table_and_path_sizes, strict=True
        ):
            smaller_size = table_sizes[max(size_index - 1, 0)]
            larger_size = table_sizes[min(size_index + 1, N_ELLIPSE_SIZES_PER_AXIS - 1)]
            is_near_failed_case &= (smaller_size <= path_sizes) & (path_sizes <= larger_size)
        if np.any(is_near_failed_case):
            raise ConvergenceError(
                f"{_ellipse_in_words(sweep_result, case_index)} was not solved: {failure_text}"
            )
    if not sweep_result.failed_indices_and_reasons:
        return []
    case_index, failure_text = sweep_result.failed_indices_and_reasons[0]
    count_text = format_count(len(sweep_result.failed_indices_and_reasons), "shape")
    return [
        f"{count_text} not solved, but away from the growth, so that the life hardly changes; one "
        f"is {_ellipse_in_words(sweep_result, case_index)}: {failure_text}"
    ]
