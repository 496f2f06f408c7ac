"""Solve the lengths of a straight crack until the load cycles between them are known.

Splines connect the solved lengths. Intervals are halved if a spline misses the next solutions. Each
round is a sweep: ranks share the cases, and a killed run continues.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from mpi4py import MPI

from fenics_crack.basics.errors import ConvergenceError, StoppedError
from fenics_crack.basics.observables import ObservableTableFlag, Place, observable_names
from fenics_crack.basics.ranks import StopRequest
from fenics_crack.basics.tables import RAD_PER_TURN
from fenics_crack.numerics.equations import SMALLEST_NORMAL
from fenics_crack.scene.result_tables import Growth as Law
from fenics_crack.scene.scene import Scene
from fenics_crack.sweep.file import STORED_MODE_NUMBER_RANGE
from fenics_crack.sweep.result import SweepResult, run_sweep

GrowthEnd = Literal["reached", "arrested", "broken", "side"]
GAUSS_LEGENDRE_NODES, GAUSS_LEGENDRE_WEIGHTS = np.polynomial.legendre.leggauss(3)
"""Quadrature for dN/da in each step between lengths: three points in (-1, 1), and weights."""
MAX_ALLOWED_LOG_RANGE_ERROR = 0.05
"""Maximum error of ln delta K in an interval between solved lengths.

delta K is the range of K_I for the growth law. Intervals with larger errors are halved, even if few
cycles pass there, to find resonances inside.
"""
LOG_INTERPOLATED_COLUMN_NAMES = ("driving", "K_max", "delta_K_effective", "response")
"""Columns with a spline of the logarithm, which is smooth through resonances.

"driving" is the constant range of K_I with the same growth as all loads.
"""
VALUE_INTERPOLATED_COLUMN_NAMES = (
    "omega", "omega_open", "omega_bilinear", "K_min", "K_II_max", "K_II_ratio",
)  # fmt: skip
"""Columns with a spline of the values themselves."""
GROWTH_SWEEP_COLUMN_NAMES = (
    "K_max",
    "delta_K_effective",
    "delta_K_equivalent",
    "response",
    *VALUE_INTERPOLATED_COLUMN_NAMES,
)
"""Columns of a sweep over crack sizes from which growth is computed."""


@dataclass(frozen=True)
class LengthPath:
    """Solutions at crack lengths, with splines between them.

    Attributes
    ----------
    lengths : (k,) [m]
        Solved lengths in ascending order.
    column_values_by_name : dict of str to (k,)
        Values at each length: frequencies [rad/s], response [m], stress intensities and ranges [Pa
        m^0.5]. Names are in :data:`LOG_INTERPOLATED_COLUMN_NAMES` and
        :data:`VALUE_INTERPOLATED_COLUMN_NAMES`.
    sweep_results : sequence of SweepResult
        Sweeps with the solutions.
    load_omega_with_most_growth : (k,) [rad/s]
        Load frequency with most growth in the spectrum, at each length.
    law : Growth
        Table ``[growth]``.
    """

    lengths: np.ndarray
    column_values_by_name: dict[str, np.ndarray]
    sweep_results: Sequence[SweepResult]
    load_omega_with_most_growth: np.ndarray
    law: Law

    @classmethod
    def from_sweeps(cls, sweep_results: Sequence[SweepResult], law: Law) -> LengthPath:
        """Return the path of all lengths solved in sweeps.

        A length is left out if any load of the spectrum is not solved. All natural frequencies
        belong to the same mode (:func:`find_nearest_mode_number`). At the first length, this mode
        is the nearest to the load frequency with most growth.

        Parameters
        ----------
        sweep_results : sequence of SweepResult
            Sweeps over the crack length, and the load frequency for a spectrum. The first sweep has
            no failed case, and begins with the shortest length.
        law : Growth
            Table ``[growth]``.
        """
        solved_masks_of_sweeps = [
            sweep_result.converged.reshape(len(sweep_result.axes[0].values), -1).all(axis=1)
            for sweep_result in sweep_results
        ]
        lengths = np.concatenate(
            [
                np.array(sweep_result.axes[0].values)[is_solved]
                for sweep_result, is_solved in zip(
                    sweep_results, solved_masks_of_sweeps, strict=True
                )
            ]
        )
        length_order = np.argsort(lengths)

        def get_level_values(column_name: str) -> np.ndarray:
            """Return a column at all lengths, ascending, and at each load: (k, levels)."""
            values_of_sweeps = [
                sweep_result[column_name].reshape(len(is_solved), -1)[is_solved]
                for sweep_result, is_solved in zip(
                    sweep_results, solved_masks_of_sweeps, strict=True
                )
            ]
            return np.concatenate(values_of_sweeps)[length_order]

        load_level_values_by_column = {
            name: get_level_values(name) for name in GROWTH_SWEEP_COLUMN_NAMES
        }
        load_level_values_by_column["response"] = np.nan_to_num(
            load_level_values_by_column["response"]
        )  # nan if nothing moves
        level_cycles = np.ones(1) if law.frequencies is None else np.array(law.cycles)
        column_by_name, load_omega_with_most_growth = _reduce_load_levels_to_columns(
            load_level_values_by_column, law, level_cycles
        )
        mode_number = find_nearest_mode_number(sweep_results[0], load_omega_with_most_growth[0])
        for column_name in ("omega_open", "omega_bilinear"):
            column_by_name[column_name] = get_level_values(f"{column_name}_{mode_number}")[:, 0]
        return cls(
            lengths[length_order], column_by_name, sweep_results, load_omega_with_most_growth, law
        )

    @property
    def not_stable_lengths(self) -> list[float]:
        """Return lengths [m] with a vibration that is unstable, irregular or undecided."""
        not_stable_sweep_cases = (
            (sweep_result, case_index)
            for sweep_result in self.sweep_results
            for case_index in np.argwhere(sweep_result.not_stable & sweep_result.converged)
        )
        return list(
            dict.fromkeys(
                sweep_result.axes[0].values[case_index[0]]
                for sweep_result, case_index in not_stable_sweep_cases
            )
        )

    def interpolate_column(self, column_name: str, lengths: np.ndarray) -> np.ndarray:
        """Interpolate a column by a cubic spline at lengths [m]: an array of the same shape.

        Lengths must lie between the first and last solved ones. For
        :data:`LOG_INTERPOLATED_COLUMN_NAMES`, the spline goes through logarithms, with values of at
        least 1e-4 times the largest.
        """
        from scipy.interpolate import CubicSpline  # takes a while, and is needed here alone

        column = self.column_values_by_name[column_name]
        if column_name not in LOG_INTERPOLATED_COLUMN_NAMES:
            return np.asarray(CubicSpline(self.lengths, column)(lengths))
        column_floor = 1e-4 * max(float(column.max()), SMALLEST_NORMAL)  # closed cracks
        column_spline = CubicSpline(self.lengths, np.log(np.maximum(column, column_floor)))
        return np.asarray(np.exp(column_spline(lengths)))

    def with_every_second_length(self) -> LengthPath:
        """Return a coarser path, to estimate the interpolation error."""
        return replace(
            self,
            lengths=self.lengths[::2],
            column_values_by_name={
                name: column[::2] for name, column in self.column_values_by_name.items()
            },
            load_omega_with_most_growth=self.load_omega_with_most_growth[::2],
        )

    def find_load_omega(self, length: float) -> float:
        """Return the load frequency [rad/s] at a length [m].

        For a spectrum: the load with most growth at the nearest solved length.
        """
        if self.law.drive == "spectrum":
            return float(self.load_omega_with_most_growth[np.abs(self.lengths - length).argmin()])
        return float(self.interpolate_column("omega", np.array([length]))[0])

    def compute_growth_rates(self, lengths: np.ndarray) -> np.ndarray:
        """Return da/dN [m] at lengths [m]: an array of the same shape.

        The rate is C delta K^m, with C and m of the growth law. delta K [MPa m^0.5] is a constant
        range of K_I with the same growth as all loads of the spectrum: the column "driving"
        (:func:`_reduce_load_levels_to_columns`).
        """
        driving_ranges = self.interpolate_column("driving", lengths)
        return np.asarray(self.law.rate * (driving_ranges / 1e6) ** self.law.exponent)

    def integrate_cycles_to_end(self) -> tuple[np.ndarray, np.ndarray, GrowthEnd]:
        """Integrate dN = da / (da/dN) over the solved lengths, until growth ends.

        Growth is arrested if the effective range (of K_I while the crack tip is open) is below the
        threshold, or the rate is 0. The structure is broken if K_max reaches the toughness.

        Returns
        -------
        lengths : (n,) [m]
            Up to 200 equally spaced lengths.
        cycles : (n,)
            Load cycles until each length.
        end_reason : str
            "reached", "arrested" or "broken".
        """
        lengths = np.linspace(self.lengths[0], self.lengths[-1], 200)
        is_arrested = self.interpolate_column("delta_K_effective", lengths) < self.law.threshold
        is_arrested |= self.compute_growth_rates(lengths) == 0.0  # nothing opens it
        is_broken = self.interpolate_column("K_max", lengths) >= (self.law.toughness or math.inf)
        end_indices = np.flatnonzero(is_arrested | is_broken)
        end_reason: GrowthEnd = "reached"
        if len(end_indices):
            end_reason = "arrested" if is_arrested[end_indices[0]] else "broken"
            lengths = lengths[: int(end_indices[0]) + 1]
        half_interval_widths = 0.5 * np.diff(lengths)[:, None]
        quadrature_lengths = lengths[:-1, None] + half_interval_widths * (
            1.0 + GAUSS_LEGENDRE_NODES
        )
        quadrature_cycles = (
            half_interval_widths
            * GAUSS_LEGENDRE_WEIGHTS
            / self.compute_growth_rates(quadrature_lengths)
        )
        return lengths, np.append(0.0, np.cumsum(quadrature_cycles.sum(axis=1))), end_reason

    def estimate_life_error_by_threshold(
        self, lengths: np.ndarray, cycles: np.ndarray, range_error: float
    ) -> float:
        """Estimate how an error of K_I changes ln(life) through the threshold.

        All ranges of K_I may be too high by the relative error e. Loads of a spectrum may then in
        truth be below the threshold, and cause no growth. Lower ranges act like a threshold raised
        to threshold / (1 - e), so the life is longer.

        Parameters
        ----------
        lengths, cycles : (n,) [m], [-]
            Crack lengths along the growth, and load cycles until each length.
        range_error : float
            The relative error e.

        Returns
        -------
        float
            Increase of ln(life); 0 without a spectrum, without a threshold, or unless 0 < e < 1.
        """
        law = self.law
        is_threshold_relevant = law.drive == "spectrum" and law.threshold and cycles[-1] > 0.0
        if not (is_threshold_relevant and 0.0 < range_error < 1.0):
            return 0.0
        path_with_raised_threshold = LengthPath.from_sweeps(
            self.sweep_results, replace(law, threshold=law.threshold / (1.0 - range_error))
        )
        middle_lengths = 0.5 * (lengths[1:] + lengths[:-1])
        range_ratios_by_raised_threshold = self.interpolate_column(
            "driving", middle_lengths
        ) / path_with_raised_threshold.interpolate_column("driving", middle_lengths)
        return math.log(
            float(
                np.average(range_ratios_by_raised_threshold**law.exponent, weights=np.diff(cycles))
            )
        )


def find_nearest_mode_number(sweep_result: SweepResult, omega: float) -> int:
    """Return the number, from 1, of the mode nearest to a load frequency ``omega`` [rad/s].

    Compared are the modes' bilinear frequencies for the first crack size of the sweep.
    """
    bilinear_omega_of_modes = np.array(
        [
            sweep_result[f"omega_bilinear_{mode_number}"].flat[0]
            for mode_number in STORED_MODE_NUMBER_RANGE
        ]
    )
    return STORED_MODE_NUMBER_RANGE[int(np.nanargmin(np.abs(bilinear_omega_of_modes - omega)))]


def list_failed_lengths_and_reasons(
    sweep_results: Sequence[SweepResult],
) -> list[tuple[float, str]]:
    """Return each length [m] that could not be solved, with the reason."""
    failure_text_by_length = {
        sweep_result.axes[0].values[case_index[0]]: failure_text
        for sweep_result in sweep_results
        for case_index, failure_text in sweep_result.failed_indices_and_reasons
    }
    return list(failure_text_by_length.items())


def _reduce_load_levels_to_columns(
    load_level_values_by_column: dict[str, np.ndarray], law: Law, level_cycles: np.ndarray
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Combine values at the loads of a spectrum to a value for each length.

    The column "driving" is a constant range of K_I with the same growth as all loads,

        (sum n_i delta K_i^m / sum n_i)^(1 / m),

    with n_i cycles at load i, and m of the growth law. A cycle of K_I from 0 to delta K_i causes
    the same growth as a period of load i. The effective range is the range of K_I while the crack
    tip is open. If any load has an effective range above the threshold, loads below the threshold
    are left out.

    Parameters
    ----------
    load_level_values_by_column : dict of str to (k, levels)
        Values at k lengths and each load, by column name.
    law : Growth
        Table ``[growth]`` with m and the threshold.
    level_cycles : (levels,)
        Cycles n_i.

    Returns
    -------
    dict of str to (k,)
        "K_max" and "delta_K_effective" are maxima; "omega" is the mean frequency. Other columns are
        from the load with most growth.
    (k,) [rad/s]
        Frequency of the load with most growth.
    """
    effective_ranges = load_level_values_by_column["delta_K_effective"]
    equivalent_ranges = load_level_values_by_column["delta_K_equivalent"]
    column_by_name = {
        column_name: load_level_values_by_column[column_name].max(axis=1)
        for column_name in ("K_max", "delta_K_effective")
    }
    min_counted_effective_range = np.minimum(law.threshold, column_by_name["delta_K_effective"])[
        :, None
    ]
    largest_equivalent_range = np.maximum(
        equivalent_ranges.max(axis=1, keepdims=True), SMALLEST_NORMAL
    )
    growth_over_largest_growth = (effective_ranges >= min_counted_effective_range) * (
        equivalent_ranges / largest_equivalent_range
    ) ** law.exponent
    growth_shares = level_cycles / level_cycles.sum() * growth_over_largest_growth
    level_index_with_most_growth = growth_shares.argmax(axis=1)[:, None]
    value_with_most_growth_by_column = {
        column_name: np.take_along_axis(
            load_level_values_by_column[column_name], level_index_with_most_growth, axis=1
        )[:, 0]
        for column_name in load_level_values_by_column
    }
    load_omega_with_most_growth = value_with_most_growth_by_column["omega"]
    column_by_name["driving"] = largest_equivalent_range[:, 0] * growth_shares.sum(axis=1) ** (
        1.0 / law.exponent
    )
    column_by_name["omega"] = level_cycles.sum() / (
        level_cycles / load_level_values_by_column["omega"]
    ).sum(axis=1)
    return value_with_most_growth_by_column | column_by_name, load_omega_with_most_growth


def solve_lengths_to_tolerance(
    scene: Scene, folder: Path | None, comm: MPI.Comm, *, progress: bool = False
) -> tuple[LengthPath, float, list[float]]:
    """Solve crack lengths until interpolation gives the cycles precisely (collective).

    The first round has five lengths from ``crack.length`` to ``growth.until``. Up to five further
    rounds halve intervals. The rounds end when two errors are small:

    - the relative error of the cycles is at most ``growth.life_tolerance``;
    - the error of ln delta K, with the range delta K of K_I, is at most 0.05 in every interval
      (:data:`MAX_ALLOWED_LOG_RANGE_ERROR`).

    Round n is stored in ``folder``/growth_n.h5; nothing is stored if ``folder`` is None.

    Returns
    -------
    LengthPath
        Solved lengths.
    float
        Relative error of the cycles by interpolation.
    list of float
        Lower ends [m] of the intervals in which ln delta K still has a larger error. The largest
        error per interval length comes first.

    Raises
    ------
    ConvergenceError
        A length of the first round cannot be solved.
    StoppedError
        Ctrl-C was pressed.
    """
    law = scene.given("growth")
    # A coarser spline needs three lengths or more: every second one of five.
    next_lengths = np.linspace(scene.given("crack").length, law.until, 5)
    sweep_results: tuple[SweepResult, ...] = ()
    for round_number in range(1, 7):  # 129 lengths are as close as meshes are similar
        swept_values_by_key = {"crack.length": next_lengths}
        if law.frequencies is not None:
            swept_values_by_key["excitation.omega"] = RAD_PER_TURN * np.array(law.frequencies)
        sweep_results += (
            sweep_crack_sizes(
                scene,
                swept_values_by_key,
                folder,
                comm,
                round_number=round_number,
                progress=progress,
            ),
        )
        failed_lengths_and_reasons = list_failed_lengths_and_reasons(sweep_results)
        if round_number == 1 and failed_lengths_and_reasons:
            failed_length, failure_text = failed_lengths_and_reasons[0]
            raise ConvergenceError(
                f"a crack of {failed_length:.4g} m was not solved: {failure_text}"
            )
        length_path = LengthPath.from_sweeps(sweep_results, law)
        if round_number == 1:
            previous_path = length_path.with_every_second_length()
            interval_errors = np.zeros(len(previous_path.lengths) - 1)
        interval_errors = _estimate_interval_log_range_errors(
            previous_path, length_path, interval_errors
        )
        integration_lengths, integration_cycles, _ = length_path.integrate_cycles_to_end()
        interval_cycles = np.diff(
            np.interp(length_path.lengths, integration_lengths, integration_cycles)
        )
        interval_life_errors = (
            law.exponent
            * interval_errors
            * interval_cycles
            / max(float(interval_cycles.sum()), SMALLEST_NORMAL)
        )
        life_error = float(interval_life_errors.sum())
        is_interval_life_error_large = (
            interval_life_errors > law.life_tolerance / len(interval_life_errors)
        ) & (life_error > law.life_tolerance)
        next_lengths = (0.5 * (length_path.lengths[1:] + length_path.lengths[:-1]))[
            is_interval_life_error_large | (interval_errors > MAX_ALLOWED_LOG_RANGE_ERROR)
        ]
        failed_lengths = [failed_length for failed_length, _ in failed_lengths_and_reasons]
        next_lengths = next_lengths[~np.isin(next_lengths, failed_lengths)]
        if not len(next_lengths):
            break
        previous_path = length_path
    indices_by_falling_error_density = np.argsort(-interval_errors / np.diff(length_path.lengths))
    intensity_jump_lengths = length_path.lengths[:-1][
        indices_by_falling_error_density[
            interval_errors[indices_by_falling_error_density] > MAX_ALLOWED_LOG_RANGE_ERROR
        ]
    ]
    return length_path, life_error, intensity_jump_lengths.tolist()


def sweep_crack_sizes(
    scene: Scene,
    swept_values_by_key: dict[str, np.ndarray],
    folder: Path | None,
    comm: MPI.Comm,
    *,
    round_number: int = 1,
    progress: bool = False,
) -> SweepResult:
    """Solve a scene at crack sizes and at the loads of a spectrum (collective).

    Parameters
    ----------
    scene : Scene
        Scene with a table ``[growth]``.
    swept_values_by_key : dict of str to array
        Values by scene key: "crack.length" and "crack.depth" [m], "excitation.omega" [rad/s].
    folder : path or None
        Folder for the file growth_n.h5. An existing file is continued; None keeps nothing.
    round_number : int
        The number n in the file name.

    Raises
    ------
    StoppedError
        Ctrl-C was pressed.
    """
    observable_places = (
        (Place.MOST_LOADED_TIP, Place.DEEPEST_PLACE_AND_ELLIPSE_ENDS)
        if "crack.depth" in swept_values_by_key
        else (Place.MOST_LOADED_TIP,)
    )
    swept_scene = scene.replace(
        {
            "sweep.over": {key: values.tolist() for key, values in swept_values_by_key.items()},
            "sweep.at_resonance": scene.given("growth").drive == "resonance",
            "output.quantities": observable_names(
                *observable_places, excluded_flags=ObservableTableFlag.REQUIRES_SOLID
            ),
        }
    )
    sweep_path = None if folder is None else folder / f"growth_{round_number}.h5"
    with StopRequest() as stop_request:
        sweep_result = run_sweep(swept_scene, sweep_path, comm, progress=progress, judged=False)
    if stop_request.is_requested(comm):
        raise StoppedError("growth was stopped; run the same command again to continue it")
    return sweep_result


def _estimate_interval_log_range_errors(
    previous_path: LengthPath, length_path: LengthPath, previous_errors: np.ndarray
) -> np.ndarray:
    """Return errors of the spline for ln delta K between k solved lengths: (k - 1,).

    delta K is the column "driving" (:func:`_reduce_load_levels_to_columns`). Two splines are
    compared: through the lengths before and after the last sweep. In an interval halved by the
    sweep, the error is a quarter of the larger difference at the ends. In other intervals it is the
    previous error or, if larger, the difference in the middle. A resonance found by the sweep
    changes the spline in these intervals, too.

    Parameters
    ----------
    previous_path, length_path : LengthPath
        Solved lengths before and after the last sweep: j and k lengths.
    previous_errors : (j - 1,)
        Errors between the j lengths, for the previous path's spline.
    """

    def compute_log_range_difference(lengths: np.ndarray) -> np.ndarray:
        driving_range, previous_driving_range = (
            compared_path.interpolate_column("driving", lengths)
            for compared_path in (length_path, previous_path)
        )
        return np.abs(np.log(driving_range / previous_driving_range))

    # Half the spacing divides a spline's error by 16 in theory, and by 4 or more here.
    end_errors = compute_log_range_difference(length_path.lengths) / 4.0
    is_new_length = ~np.isin(length_path.lengths, previous_path.lengths)
    middle_lengths = 0.5 * (length_path.lengths[1:] + length_path.lengths[:-1])
    inherited_errors = previous_errors[np.searchsorted(previous_path.lengths, middle_lengths) - 1]
    kept_interval_errors = np.maximum(
        inherited_errors, compute_log_range_difference(middle_lengths)
    )
    return np.where(
        is_new_length[1:] | is_new_length[:-1],
        np.maximum(end_errors[1:], end_errors[:-1]),
        kept_interval_errors,
    )
