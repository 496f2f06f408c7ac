"""Hold, read and write a blade tip's arrival times at stationary probes.

Measured records from data systems have a row for each revolution. A row has the rotor's speed, or
the time at which the mark on the shaft begins the revolution. Then follows the angle or time of
arrival for each blade and probe; an empty cell is a missed passage. Probe angles are often unknown.
Then the median arrival angle at a probe replaces the angle, and displacements count from there.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from fenics_crack.basics.errors import InputError, check_count, check_number, report_read_errors
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import RAD_PER_S_PER_RPM, RAD_PER_TURN, Table, Tabular, format_count
from fenics_crack.basics.untrusted_files import (
    SI_UNIT_AND_FACTOR_BY_HEADING_UNIT,
    convert_heading_to_si,
    read_numbered_csv_rows,
)

REQUIRED_ARRIVAL_COLUMN_NAMES = (
    "revolution",
    "angle [rad]",
    "mark [s]",
    "next_mark [s]",
    "arrival [s]",
)
"""Required columns of a CSV file."""
TIP_RADIUS_COLUMN_NAME = "tip_radius [m]"
"""Optional column of a CSV file."""
MISSING_TIP_RADIUS_ADVICE = "on the command line, --set tip_timing.tip_radius=0.5"
"""Advice in the error for a missing tip radius."""
MAX_RELATIVE_RANGE_OF_CONSTANT_SPEED = 1e-2
"""Maximum range of a constant speed, relative to the mean."""
MAX_TIP_PASSAGES_IN_RECORD = 10**7
"""Maximum number of passages in a record, which limits the memory."""
MIN_REVOLUTIONS_FOR_SPEED_OR_RESONANCE = 10
"""Minimum number of revolutions for a smoothed speed, and for a passage through a resonance."""


@keep_old_attribute_names(
    nominal_angle="rotor_angle_without_vibration", rounding="displacement_rounding"
)
@dataclass(frozen=True, repr=False)
class ArrivalTimes(Tabular):
    """Hold the times at which one blade's tip passed stationary probes.

    A mark on the shaft, seen once per revolution, gives the rotor angle alpha(t). The angle is 0 at
    the first mark of revolution 0, and 2 pi n at the mark that begins revolution n. A cubic spline
    connects the marks; it is exact for constant speed and constant acceleration. A blade tip
    arrives early if a vibration moves it in the direction of rotation. With tip radius R, time t,
    probe angle phi and speed W, its displacement u at an arrival in revolution n is

        u = R (phi + 2 pi n - alpha(t)),    at constant speed W:  u = -R W (t - t_expected).

    This is the displacement at the arrival, not at the expected arrival: nothing is linearised.

    Attributes
    ----------
    time : (revolutions, probes) [s]
        Arrivals; nan for a missing arrival.
    marks : (revolutions + 1,) [s]
        Times of the shaft's mark: beginnings of the revolutions, and the end of the last
        revolution.
    probes : (probes,) [rad]
        Angles phi between the probes and the undisturbed blade tip at a mark, in the direction of
        rotation; from 0 to 2 pi, increasing.
    tip_radius : float [m]
        Radius R.
    first : int
        Number n of the first row's revolution.

    Raises
    ------
    InputError
        Shapes do not fit, or marks, probes or radius cannot be used.
    """

    time: np.ndarray
    marks: np.ndarray
    probes: np.ndarray
    tip_radius: float
    first: int = 0

    def __post_init__(self) -> None:
        for field_name in ("time", "marks", "probes"):
            try:
                values = np.asarray(getattr(self, field_name), dtype=float)
            except (TypeError, ValueError):
                raise InputError(
                    field_name, getattr(self, field_name), "an array of numbers"
                ) from None
            object.__setattr__(self, field_name, values)
        check_number("tip_radius", self.tip_radius, 0.0, excludes_bound=True)
        check_probe_angles(self.probes)
        if self.marks.ndim != 1 or len(self.marks) < 2:
            marks_shape_text = f"of shape {self.marks.shape}"
            raise InputError(
                "marks", marks_shape_text, "an array of two or more increasing times [s]"
            )
        if not np.all(is_next_mark_later := np.diff(self.marks) > 0.0):
            mark, next_mark = self.marks[int(np.argmin(is_next_mark_later)) :][:2]
            raise InputError("marks", f"{next_mark:.9g} s after {mark:.9g} s", "increasing times")
        check_revolution_durations("marks", np.diff(self.marks), self.first)
        required_shape = (len(self.marks) - 1, len(self.probes))
        if self.time.shape != required_shape:
            requirement_text = (
                f"of shape {required_shape}: a row for each revolution, a column for each probe"
            )
            raise InputError("time", f"of shape {self.time.shape}", requirement_text)
        if not np.any(np.isfinite(self.time)):
            raise InputError(
                "time", "no finite number", "an array with at least one arrival time [s]"
            )
        revolution_durations = np.diff(self.marks)[:, None]
        delays_after_mark = self.time - self.marks[:-1, None]
        is_misplaced = (delays_after_mark < -revolution_durations) | (
            delays_after_mark > 2.0 * revolution_durations
        )
        if np.any(is_misplaced):
            requirement_text = (
                "a time [s] in the revolution of its row, or in the one before or after it; or nan"
            )
            raise InputError("time", float(self.time[is_misplaced][0]), requirement_text)

    def __len__(self) -> int:
        return len(self.time)

    @cached_property
    def speed(self) -> np.ndarray:
        """Mean speed of each revolution: (revolutions,) [rad/s]."""
        return np.asarray(2.0 * np.pi / np.diff(self.marks))

    @property
    def mean_speed(self) -> float:
        """Mean speed from the first to the last revolution with arrivals [rad/s]."""
        rows_with_arrivals = np.flatnonzero(np.isfinite(self.time).any(axis=1))
        begin_row, end_row = int(rows_with_arrivals[0]), int(rows_with_arrivals[-1]) + 1
        return float(
            2.0 * np.pi * (end_row - begin_row) / (self.marks[end_row] - self.marks[begin_row])
        )

    @property
    def steady(self) -> bool:
        """True if the highest and lowest speed differ by at most 1 % of the mean speed."""
        revolution_speeds = self.speed
        return bool(
            np.ptp(revolution_speeds)
            <= MAX_RELATIVE_RANGE_OF_CONSTANT_SPEED * revolution_speeds.mean()
        )

    @cached_property
    def rotor_angle_without_vibration(self) -> np.ndarray:
        """Rotor angle when an undisturbed blade tip passes a probe: (revolutions, probes) [rad].

        The angle is phi + 2 pi n, with the probe's angle phi and the revolution's number n.
        """
        return self._rotor_angles_at_marks[:-1, None] + self.probes

    @property
    def _rotor_angles_at_marks(self) -> np.ndarray:
        """Rotor angle at the marks: (revolutions + 1,) [rad]."""
        return find_mark_angles(self.first, len(self.marks))

    @cached_property
    def angle(self) -> np.ndarray:
        """Rotor angle alpha at the arrivals: (revolutions, probes) [rad].

        nan for a missing arrival.
        """
        return interpolate_by_splines(self.marks, self._rotor_angles_at_marks, self.time)

    @cached_property
    def expected(self) -> np.ndarray:
        """Arrival times of a blade without vibration: (revolutions, probes) [s].

        Missing arrivals also have an expected time.
        """
        return interpolate_by_splines(
            self._rotor_angles_at_marks, self.marks, self.rotor_angle_without_vibration
        )

    @cached_property
    def displacement(self) -> np.ndarray:
        """Tangential displacement u at the arrivals: (revolutions, probes) [m].

        nan for a missing arrival.
        """
        return np.asarray(self.tip_radius * (self.rotor_angle_without_vibration - self.angle))

    @cached_property
    def displacement_rounding(self) -> float:
        """Rounding error of displacements [m].

        The sum of two errors: 1e-9 times the largest displacement, and the tip radius times the
        largest rotor angle's rounding error (4 units in the last place).
        """
        largest_angle, largest_displacement = (
            float(np.nanmax(np.abs(angles_or_displacements)))
            for angles_or_displacements in (self.angle, self.displacement)
        )
        return (
            1e-9 * largest_displacement + 4.0 * float(np.spacing(largest_angle)) * self.tip_radius
        )

    def check_places(self, angle_deviation: float) -> None:
        """Check that arrivals are at the right probe and in the right revolution.

        Used before a fit, which would take a wrong place for a vibration. The check compares each
        probe's angle with the median measured angle. A difference common to all probes is allowed.

        Parameters
        ----------
        angle_deviation : float [rad]
            Probe angles' standard deviation. Must be >= 0; the comparison does not use this number.

        Raises
        ------
        InputError
            A probe's arrivals are nearer to another probe, or belong to the revolution before or
            after their row.
        """
        check_number("angle_deviation", angle_deviation, 0.0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a probe without arrivals
            angle_shifts = np.nanmedian(self.rotor_angle_without_vibration - self.angle, axis=0)
        angle_shifts -= np.nanmedian(angle_shifts)
        wrong_row_probe_indices = np.flatnonzero(np.abs(angle_shifts) > 0.5 * RAD_PER_TURN)
        if len(wrong_row_probe_indices):
            wrong_row_probe_text = (
                f"arrivals at {np.degrees(self.probes[wrong_row_probe_indices[0]]):g} degrees"
            )
            belongs_to_previous_revolution = angle_shifts[wrong_row_probe_indices[0]] > 0.0
            problem_text = (
                f"{wrong_row_probe_text} belong to the revolution "
                f"{'before' if belongs_to_previous_revolution else 'after'} their row"
            )
            requirement_text = (
                "arrivals in the row of their revolution; move this probe's column "
                f"{'up' if belongs_to_previous_revolution else 'down'} by one row"
            )
            raise InputError("time", problem_text, requirement_text)
        angle_distances = np.abs(
            self.probes - angle_shifts - self.probes[:, None]
        )  # [stated, passed]
        nearest_probe_indices = np.argmin(
            np.minimum(angle_distances % RAD_PER_TURN, -angle_distances % RAD_PER_TURN), axis=0
        )
        swapped_probe_indices = np.flatnonzero(
            np.isfinite(angle_shifts) & (nearest_probe_indices != np.arange(len(angle_shifts)))
        )
        if len(swapped_probe_indices):
            stated_degrees, nearest_probe_degrees = np.degrees(
                self.probes[
                    [swapped_probe_indices[0], nearest_probe_indices[swapped_probe_indices[0]]]
                ]
            )
            problem_text = (
                f"arrivals of the probe at {stated_degrees:g} degrees "
                f"fit the angle of the probe at {nearest_probe_degrees:g} degrees"
            )
            requirement_text = (
                "in the order of the arrivals' columns: swap these two angles; if they are right, "
                "record the arrivals with a finer clock"
            )
            raise InputError("probes", problem_text, requirement_text)

    def zeroed(self, begin: int, end: int) -> Self:
        """Return a copy with the probe angles corrected by revolutions without vibration.

        In rows ``begin`` to ``end`` - 1, counted from 0, the blade must not vibrate. Each probe's
        median displacement in these rows, divided by the tip radius, is subtracted from the probe's
        angle. The median displacement then becomes zero. The arrival times stay.
        """
        median_displacements = np.nanmedian(
            self.between(begin, end).displacement[begin:end], axis=0
        )
        return replace(self, probes=self.probes - median_displacements / self.tip_radius)

    def between(self, begin: int, end: int) -> Self:
        """Return a copy with only the arrivals in rows begin to end - 1.

        Rows are counted from 0. The number of rows stays: times in all other rows become nan.
        """
        check_count("begin", begin, 0)
        check_count("end", end, begin + 1)
        is_kept_revolution = np.zeros(len(self), dtype=bool)
        is_kept_revolution[begin:end] = True
        return replace(self, time=np.where(is_kept_revolution[:, None], self.time, np.nan))

    def without(self, probes: np.ndarray) -> Self:
        """Return the arrivals without some probes.

        ``probes`` (n,) are indices of columns, from 0.
        """
        time = np.delete(self.time, probes, axis=1)
        return replace(self, time=time, probes=np.delete(self.probes, probes))

    @classmethod
    def from_csv(cls, path: str | Path, *, tip_radius: float | None = None) -> Self:
        """Read arrivals from a CSV file with a row for each revolution and probe.

        The columns may have any order, and other columns are ignored:

        - ``revolution``: whole number of the revolution,
        - ``angle [rad]``: angle of the probe,
        - ``mark [s]`` and ``next_mark [s]``: begin and end of the revolution,
        - ``arrival [s]``: time of arrival; the cell is empty for a missed arrival,
        - ``tip_radius [m]``: required unless ``tip_radius`` [m] is given as an argument.

        Other units are converted, as by :func:`read_record`. Every revolution needs a row.
        :meth:`to_csv` writes this kind of file; the same arrivals are read back to the last bit.

        Raises
        ------
        InputError
            The file cannot be read, a column is missing, or rows contradict each other or the given
            radius.
        """
        (
            (
                passage_revolutions,
                passage_probe_angles,
                passage_marks,
                passage_next_marks,
                arrival_times,
            ),
            file_radii,
        ) = _read_passages_and_tip_radii(path)
        tip_radius = choose_tip_radius(path, file_radii, tip_radius)
        revolution_numbers, first_row_indices, row_indices = np.unique(
            passage_revolutions, return_index=True, return_inverse=True
        )
        probe_angles, probe_indices = np.unique(passage_probe_angles, return_inverse=True)
        if np.any(np.diff(revolution_numbers) != 1.0):
            raise InputError(
                "path",
                str(path),
                "a file with all revolutions; add the missing rows, with an empty arrival cell",
            )
        if len(revolution_numbers) * len(probe_angles) > MAX_TIP_PASSAGES_IN_RECORD:
            size_text = f"{len(revolution_numbers)} revolutions, {len(probe_angles)} probes"
            raise InputError(
                "path",
                f"{path}: {size_text}",
                f"at most {MAX_TIP_PASSAGES_IN_RECORD:.0e} passages; split the file into "
                "shorter records",
            )
        begin_times = passage_marks[first_row_indices]
        end_times = passage_next_marks[first_row_indices]
        time = np.full((len(revolution_numbers), len(probe_angles)), np.nan)
        time[row_indices, probe_indices] = arrival_times
        if (
            np.any(begin_times[row_indices] != passage_marks)
            or np.any(end_times[row_indices] != passage_next_marks)
            or np.any(begin_times[1:] != end_times[:-1])
            or len(set(zip(row_indices, probe_indices, strict=True))) < len(row_indices)
        ):
            requirement_text = (
                "a file with one row per revolution and probe, in which next_mark is the mark of "
            )
            raise InputError("path", str(path), requirement_text + "the next revolution")
        return cls(
            time,
            np.append(begin_times, end_times[-1]),
            probe_angles,
            tip_radius,
            int(revolution_numbers[0]),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return lists by name, with an entry for each revolution and probe.

        The names are the columns of :meth:`from_csv` without units, and "probe" (numbered from 1),
        "displacement" [m] and "speed" [rad/s]. A missing arrival has the value nan.
        """
        n_revolutions, n_probes = self.time.shape
        revolution_indices = np.arange(n_revolutions)
        return {
            "revolution": np.repeat(self.first + revolution_indices, n_probes).tolist(),
            "probe": np.tile(np.arange(1, n_probes + 1), n_revolutions).tolist(),
            "angle": np.tile(self.probes, n_revolutions).tolist(),
            "mark": np.repeat(self.marks[:-1], n_probes).tolist(),
            "next_mark": np.repeat(self.marks[1:], n_probes).tolist(),
            "arrival": self.time.ravel().tolist(),
            "displacement": self.displacement.ravel().tolist(),
            "speed": np.repeat(self.speed, n_probes).tolist(),
            "tip_radius": [float(self.tip_radius)] * self.time.size,
        }

    def _repr_text(self) -> str:
        revolution_speeds, n_missing = self.speed, int(np.isnan(self.time).sum())
        is_steady = np.ptp(revolution_speeds) <= 1e-6 * revolution_speeds[0]
        title_parts = [
            format_count(len(self), "revolution"),
            format_count(len(self.probes), "probe"),
            f"{revolution_speeds[0]:.6g}"
            f"{'' if is_steady else f' to {revolution_speeds[-1]:.6g}'} rad/s",
            *[f"{n_missing} missing"] * (n_missing > 0),
        ]
        return ", ".join(title_parts)


def find_mark_angles(first_revolution: int, n_marks: int) -> np.ndarray:
    """Return the rotor angles at successive marks: (n_marks,) [rad].

    The first mark begins ``first_revolution``; the angle is 0 at the mark that begins revolution 0.
    """
    return RAD_PER_TURN * (first_revolution + np.arange(n_marks))


def interpolate_by_splines(knots: np.ndarray, values: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Interpolate values (n, ...) at increasing knots (n,) by cubic splines.

    Returns the interpolated values at ``points``, any shape; nan at a point nan.
    """
    from scipy.interpolate import CubicSpline  # takes longer than to read the arrivals

    return np.asarray(CubicSpline(knots, values)(points))


def smooth_series(values: np.ndarray) -> np.ndarray:
    """Smooth a series (n,) with a value for each revolution: (n,).

    Each value is replaced by a quadratic fitted to 2 h + 1 values around it (Savitzky and Golay,
    Analytical Chemistry 36, 1964, 1627). The half width h is 0, 2, 4, 8, ...: the one with the
    least expected error, by Stein's estimate (Annals of Statistics 9, 1981, 1135). The estimate
    needs the variance of a value's error, from fourth differences of the series.
    Fewer than 10 values are returned unchanged.
    """
    if len(values) < MIN_REVOLUTIONS_FOR_SPEED_OR_RESONANCE:
        return values
    from scipy.signal import savgol_coeffs, savgol_filter

    # Fourth differences of white errors have 70 times their variance; the median of chi^2 is 0.455.
    error_variance = float(np.median(np.diff(values, 4) ** 2)) / (70.0 * 0.455)
    best_series, best_series_expected_error = values, error_variance
    for half_width in 2 ** np.arange(1, int(np.log2(len(values) / 4.0)) + 1):
        smoothed_series = savgol_filter(values, 2 * half_width + 1, 2)
        centre_weight = float(savgol_coeffs(2 * half_width + 1, 2)[half_width])
        expected_error = (
            float(np.mean((values - smoothed_series) ** 2))
            + (2.0 * centre_weight - 1.0) * error_variance
        )
        if expected_error < best_series_expected_error:
            best_series, best_series_expected_error = smoothed_series, expected_error
    return np.asarray(best_series)


def check_revolution_durations(key: str, durations: np.ndarray, first_revolution: int = 0) -> None:
    """Raise InputError if a shaft mark was missed or counted twice.

    Each revolution's duration is compared with the median duration of five: two before, this, and
    two after. Above 1.4 times the median, a mark was missed. Below the median divided by 1.4, a
    mark was counted twice.

    Parameters
    ----------
    key : str
        Name of the input, for the error.
    durations : (n,) [s]
        Durations of successive revolutions.
    first_revolution : int
        Number of the first revolution, for the error.
    """
    duration_windows = np.lib.stride_tricks.sliding_window_view(
        np.pad(durations, 2, mode="symmetric"), 5
    )
    median_durations = np.median(duration_windows, axis=1)
    is_outlier = np.abs(np.log(durations / median_durations)) > np.log(1.4)
    if np.any(is_outlier):
        outlier_index = int(np.argmax(is_outlier))
        problem_text = (
            f"revolution {first_revolution + outlier_index} takes "
            f"{durations[outlier_index] / median_durations[outlier_index]:.3g} times "
            "as long as the revolutions"
        )
        requirement_text = (
            "marks of which none was missed or counted twice; remove the rows of such revolutions, "
        )
        raise InputError(
            key,
            f"{problem_text} around it",
            f"{requirement_text}and keep the other revolution numbers",
        )


def check_probe_angles(probes: np.ndarray) -> None:
    """Raise InputError unless probe angles (n,) [rad] are increasing, >= 0 and below 2 pi."""
    is_finite_vector = probes.ndim == 1 and len(probes) > 0 and np.all(np.isfinite(probes))
    if (
        not is_finite_vector
        or probes[0] < 0.0
        or probes[-1] >= 2.0 * np.pi
        or np.any(np.diff(probes) <= 0.0)
    ):
        raise InputError("probes", probes, "increasing angles [rad] from 0 to less than 2 pi")


def choose_tip_radius(
    path: str | Path, file_radii: np.ndarray | None, given_radius: float | None
) -> float:
    """Return the tip radius [m] from a file's column or from the caller.

    Parameters
    ----------
    path : path
        The file, for errors.
    file_radii : (rows,) [m] or None
        Column with the radius; None if the file has no such column.
    given_radius : float [m] or None
        Radius from the caller, if any.

    Raises
    ------
    InputError
        Both radii are None, the column has different radii, or the caller's radius is another.
    """
    if file_radii is None:
        if given_radius is None:
            requirement_text = (
                "given: the distance from the axis to the blade tips [m], for which "
                f"{path} has no column '{TIP_RADIUS_COLUMN_NAME}'; {MISSING_TIP_RADIUS_ADVICE}"
            )
            raise InputError("tip_radius", None, requirement_text)
        return given_radius
    distinct_radii = np.unique(
        np.append(file_radii, file_radii[0] if given_radius is None else given_radius)
    )
    if len(distinct_radii) > 1:
        requirement_text = "the same radius in all rows" + (
            "" if given_radius is None else f", equal to the given tip_radius = {given_radius:g} m"
        )
        raise InputError(
            "path",
            f"{path}, {TIP_RADIUS_COLUMN_NAME} = {distinct_radii.tolist()}",
            requirement_text,
        )
    return float(distinct_radii[0])


def _read_headings_and_number_table(path: str | Path) -> tuple[list[str], list[int], np.ndarray]:
    """Read a CSV file as headings and a table of numbers.

    Lines beginning with # are left out.

    Returns
    -------
    headings : list of str
        Headings, with units converted to SI.
    line_numbers : list of int
        Number in the file for each of the n lines below the headings.
    number_table : (columns, n)
        Numbers in SI; nan in cells without a number.
    """
    with report_read_errors("path", path, "a CSV file with a table of numbers"):
        (_, original_headings), *numbered_rows = read_numbered_csv_rows(path) or [(0, [])]
        for line_number, cells in numbered_rows:
            if len(cells) < len(original_headings):
                requirement_text = (
                    f"a row with a cell for each of the {len(original_headings)} headings; "
                    f"it has {len(cells)}"
                )
                raise InputError("path", f"{path}, line {line_number}", requirement_text)
    heading_factor_pairs = [convert_heading_to_si(heading) for heading in original_headings]
    number_columns = [
        [factor * _parse_number_or_nan(cells[column_index]) for _, cells in numbered_rows]
        for column_index, (_, factor) in enumerate(heading_factor_pairs)
    ]
    number_table = np.array(number_columns).reshape(len(original_headings), len(numbered_rows))
    return (
        [heading for heading, _ in heading_factor_pairs],
        [line_number for line_number, _ in numbered_rows],
        number_table,
    )


def _parse_number_or_nan(cell: str) -> float:
    """Return the number in a cell; nan for an empty cell or a word."""
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _read_passages_and_tip_radii(path: str | Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Read the columns of a file with a row for each passage.

    Returns
    -------
    passages : (5, rows)
        Columns :data:`REQUIRED_ARRIVAL_COLUMN_NAMES`; nan for a missing arrival.
    radii : (rows,) [m] or None
        Tip radius of each row; None without the column :data:`TIP_RADIUS_COLUMN_NAME`.
    """
    headings, line_numbers, number_columns = _read_headings_and_number_table(path)
    for required_heading in REQUIRED_ARRIVAL_COLUMN_NAMES:
        if required_heading not in headings:
            contents_text = f"it has {', '.join(headings)}" if any(headings) else "it is empty"
            raise InputError(
                "path", str(path), f"a file with the column '{required_heading}'; {contents_text}"
            )
    passage_columns = number_columns[
        [headings.index(required_heading) for required_heading in REQUIRED_ARRIVAL_COLUMN_NAMES]
    ]
    if not line_numbers:
        raise InputError("path", str(path), "a file with rows of numbers below its headings")
    is_finite = np.isfinite(passage_columns[:4]).all(axis=0)
    revolution_numbers = np.nan_to_num(passage_columns[0])
    if not np.all(
        is_valid := is_finite
        & (revolution_numbers % 1.0 == 0.0)
        & (np.abs(revolution_numbers) < 2**53)
    ):
        requirement_text = (
            "a row of finite numbers, with a whole revolution number; only the arrival may be empty"
        )
        raise InputError(
            "path", f"{path}, line {line_numbers[int(np.argmin(is_valid))]}", requirement_text
        )
    return passage_columns, number_columns[
        headings.index(TIP_RADIUS_COLUMN_NAME)
    ] if TIP_RADIUS_COLUMN_NAME in headings else None


# --- records --------------------------------------------------------------------------------------

BLADE_AND_PROBE_HEADING_PATTERN = re.compile(r"(?:blade\s*(\d+))?.*?\bprobe\s*(\d+)", re.IGNORECASE)
"""Pattern of the heading for a blade's arrivals at a probe.

Groups: number of the blade, or None for the only blade; number of the probe.
"""
RAD_PER_S_BY_SPEED_UNIT = {"rpm": RAD_PER_S_PER_RPM, "rad/s": 1.0, "Hz": RAD_PER_TURN}
RAD_BY_ANGLE_UNIT = {"rad": 1.0, "deg": SI_UNIT_AND_FACTOR_BY_HEADING_UNIT["deg"][1]}
SECONDS_BY_TIME_UNIT = {"s": 1.0}
"""Factors to rad/s, rad and s by unit, in the three tables for speeds, angles and times.

A heading without a unit has the first unit of the table.
"""


def read_record(
    path: str | Path,
    *,
    tip_radius: float | None = None,
    probes: Sequence[float] | np.ndarray | Mapping[int, np.ndarray] | None = None,
) -> dict[int, ArrivalTimes]:
    """Read the arrivals of one or more blades.

    The file has a row for each revolution. Headings identify the columns, in any order, with units
    in brackets. Other columns are ignored, and so are lines that begin with #. The radius may be in
    mm, too. Commas, semicolons or tabs separate the cells.

    ``revolution``
        Number of the revolution; rows may be missing. Without this column, rows are numbered from
        0.
    ``speed [rpm]`` (or rad/s, Hz; "shaft speed" too)
        Mean speed of the revolution. Or ``mark [s]``: the time of the shaft's mark at the
        revolution's beginning.
    ``blade 2 probe 1 [rad]`` (or deg; further words such as "AoA" are allowed)
        Rotor angle from the mark to the arrival. With the unit ``[s]``, the time of arrival; this
        needs the column ``mark [s]``. The cell of a missed passage is empty or nan. Headings
        without "blade 2" belong to the only blade, number 1.
    ``tip_radius [m]``
        Radius, unless given as an argument.

    Files for :meth:`ArrivalTimes.from_csv`, with a row for each passage, are read as well.

    Parameters
    ----------
    path : str or Path
        The file.
    tip_radius : float [m]
        Distance between the blade tips and the axis.
    probes : (n_probes,) [rad], or a mapping
        Angles from the blade tip to the probes, when the shaft is at a mark. A mapping has an array
        of angles by blade number. Default: the median arrival angle at each probe.
        Displacements are then relative to the median position of the tip.

    Returns
    -------
    dict of int to ArrivalTimes
        The blades by their numbers.

    Raises
    ------
    InputError
        The file cannot be read, or lacks what is needed.

    Examples
    --------
    >>> arrivals.to_csv("record.csv")
    >>> blades = fc.read_record("record.csv")
    """
    headings, _, number_table = _read_headings_and_number_table(path)
    if not any(map(BLADE_AND_PROBE_HEADING_PATTERN.search, headings)):
        return {1: ArrivalTimes.from_csv(path, tip_radius=tip_radius)}
    column_by_heading = dict(zip(headings, number_table, strict=True))
    probe_headings_by_blade: dict[int, dict[int, str]] = {}
    for heading in headings:
        if heading_match := BLADE_AND_PROBE_HEADING_PATTERN.search(heading):
            probe_headings_by_blade.setdefault(int(heading_match[1] or 1), {})[
                int(heading_match[2])
            ] = heading
    if len(column_by_heading) != len(headings):
        raise InputError(
            "path", f"{path}: {', '.join(headings)}", "a file in which each heading occurs once"
        )
    if number_table.shape[1] < 2:
        problem_text = f"{path}: {format_count(number_table.shape[1], 'revolution')}"
        raise InputError("path", problem_text, "a file with two or more revolutions")
    revolution_numbers = _check_revolution_numbers(
        path, column_by_heading.get("revolution", np.arange(float(number_table.shape[1])))
    )
    marks = _read_mark_times(path, column_by_heading, revolution_numbers)
    tip_radius = choose_tip_radius(path, column_by_heading.get(TIP_RADIUS_COLUMN_NAME), tip_radius)
    arrivals_by_blade = {}
    for blade_number, heading_by_probe in sorted(probe_headings_by_blade.items()):
        arrival_angles = np.full((len(marks) - 1, len(heading_by_probe)), np.nan)
        for probe_index, (_, heading) in enumerate(sorted(heading_by_probe.items())):
            if not np.any(np.isfinite(column_by_heading[heading])):
                raise InputError(
                    "path",
                    f"{path}: {heading}",
                    "a column with at least one number; remove the column of a probe without "
                    "arrivals",
                )
            arrival_angles[revolution_numbers - revolution_numbers[0], probe_index] = (
                _read_arrival_angles(
                    path, heading, column_by_heading[heading], revolution_numbers, marks
                )
            )
        given_angles = probes.get(blade_number) if isinstance(probes, Mapping) else probes
        probe_angles = None if given_angles is None else np.asarray(given_angles, dtype=float)
        arrivals_by_blade[blade_number] = _build_arrivals(
            arrival_angles, marks, tip_radius, probe_angles, int(revolution_numbers[0])
        )
    return arrivals_by_blade


def has_probe_angles(path: str | Path) -> bool:
    """Return True if a file of arrivals has the angles of its probes.

    Only a file with a row for each passage has the angles, in the column "angle [rad]". For other
    files, :func:`read_record` takes the angles from the argument ``probes``. Without this argument,
    it takes the median arrival angles.
    """
    return REQUIRED_ARRIVAL_COLUMN_NAMES[1] in _read_headings_and_number_table(path)[0]


def find_probe_angles_by_blade(
    probes: Sequence[float] | np.ndarray, n_blades: int
) -> dict[int, np.ndarray]:
    """Return the angles from each blade's tip to the probes, by blade number.

    Blades are numbered from 1. Blade j + 1 is 2 pi / n_blades ahead of blade j.

    Parameters
    ----------
    probes : (n_probes,) [rad]
        Angles from the tip of blade 1 to the probes, when the shaft is at a mark.
    n_blades : int
        Number of blades.

    Returns
    -------
    dict of int to (n_probes,) [rad]
        Angles from 0 to 2 pi, in the order of ``probes``.
    """
    first_blade_angles = np.asarray(probes, dtype=float)
    return {
        blade_number: (first_blade_angles - RAD_PER_TURN * (blade_number - 1) / n_blades)
        % RAD_PER_TURN
        for blade_number in range(1, n_blades + 1)
    }


def write_record(
    blades: Mapping[int, ArrivalTimes], path: str | Path, probes: Sequence[float] | np.ndarray
) -> None:
    """Write the arrivals of a disk's blades as one record.

    The record has a row for each revolution, and a column for each blade and probe;
    :func:`read_record` reads it.

    Parameters
    ----------
    blades : mapping of int to ArrivalTimes
        The blades by their numbers, with common marks.
    path : str or Path
        The file.
    probes : (n_probes,) [rad]
        Angles from the first blade's tip at a mark to the probes, numbered in this order.

    Raises
    ------
    InputError
        The file cannot be written.

    Examples
    --------
    >>> arrivals, run = fc.arrivals_of_blades(disk)
    >>> fc.write_record(arrivals, "record.csv", np.radians(disk.tip_timing.probes))
    """
    if not blades:
        raise InputError("blades", blades, "a dict with the arrivals of at least one blade")
    arrivals_of_first_blade = next(iter(blades.values()))
    column_by_heading: dict[str, Any] = {
        "revolution": (
            arrivals_of_first_blade.first + np.arange(len(arrivals_of_first_blade))
        ).tolist(),
        "mark [s]": arrivals_of_first_blade.marks[:-1].tolist(),
    }
    probe_angles_by_blade = find_probe_angles_by_blade(probes, len(blades))
    for blade_number, arrivals in blades.items():
        for probe_number, probe_column_index in enumerate(
            np.argsort(np.argsort(probe_angles_by_blade[blade_number])), 1
        ):
            column_by_heading[f"blade {blade_number} probe {probe_number} [s]"] = arrivals.time[
                :, probe_column_index
            ].tolist()
    column_by_heading[TIP_RADIUS_COLUMN_NAME] = [arrivals_of_first_blade.tip_radius] * len(
        arrivals_of_first_blade
    )
    Table.from_dict(column_by_heading, {}).save(path)


def _find_unit_factor(path: str | Path, heading: str, factor_by_unit: dict[str, float]) -> float:
    """Return the factor from a heading's unit to SI.

    Parameters
    ----------
    path : path
        The file, for the error.
    heading : str
        Column heading, with the unit in brackets: "speed [rpm]".
    factor_by_unit : dict of str to float
        Factors by allowed unit. A heading without brackets has the first unit.

    Raises
    ------
    InputError
        The unit is not allowed.
    """
    unit_match = re.search(r"\[(.*)\]", heading)
    unit_name = unit_match[1] if unit_match else next(iter(factor_by_unit))
    if unit_name not in factor_by_unit:
        raise InputError(
            "path",
            f"{path}: {heading}",
            f"a heading with one of the units {', '.join(factor_by_unit)}",
        )
    return factor_by_unit[unit_name]


def _check_revolution_numbers(path: str | Path, revolution_numbers: np.ndarray) -> np.ndarray:
    """Return a record's revolution numbers (rows,) as integers.

    InputError, with the file's ``path``, unless they are whole, >= 0 and increasing. The
    last may exceed the first by at most 1e7.
    """
    are_whole_numbers = (
        np.all(np.isfinite(revolution_numbers))
        and not np.any(revolution_numbers % 1.0)
        and revolution_numbers[0] >= 0.0
    )
    if (
        not are_whole_numbers
        or np.any(np.diff(revolution_numbers) <= 0.0)
        or np.ptp(revolution_numbers) > MAX_TIP_PASSAGES_IN_RECORD
    ):
        raise InputError("path", f"{path}: revolution", "a column of increasing whole numbers >= 0")
    return revolution_numbers.astype(int)


def _read_mark_times(
    path: str | Path, column_by_heading: dict[str, np.ndarray], revolution_numbers: np.ndarray
) -> np.ndarray:
    """Return the times of the marks on the shaft: (revolutions + 1,) [s].

    Times follow from a column of marks or a column of speeds, whichever comes first in the file.
    Missing rows are interpolated linearly; then the column is smoothed. The last time is the end of
    the last revolution.

    Parameters
    ----------
    path : path
        The file, for errors.
    column_by_heading : dict of str to (rows,)
        Columns by heading.
    revolution_numbers : (rows,)
        Revolution number for each row.
    """
    all_revolution_numbers = np.arange(revolution_numbers[0], revolution_numbers[-1] + 1)
    for heading, column_values in column_by_heading.items():
        if re.match("mark", heading, re.IGNORECASE):
            column_values = column_values * _find_unit_factor(path, heading, SECONDS_BY_TIME_UNIT)
            mean_durations = np.diff(column_values) / np.diff(revolution_numbers)
            if not np.all((mean_durations > 0.0) & np.isfinite(mean_durations)):
                raise InputError("path", f"{path}: {heading}", "a column of increasing times")
            marks = np.interp(all_revolution_numbers, revolution_numbers, column_values)
            check_revolution_durations(
                f"{path}: {heading}", np.diff(marks), int(revolution_numbers[0])
            )
            marks = smooth_series(marks)
            # End of the last revolution: the duration changes as between the previous two.
            last_two_durations = np.diff(marks)[-2:]
            return np.append(
                marks, marks[-1] + 2.0 * last_two_durations[-1] - last_two_durations[0]
            )
        if "speed" in heading.lower() and not BLADE_AND_PROBE_HEADING_PATTERN.search(heading):
            speeds = column_values * _find_unit_factor(path, heading, RAD_PER_S_BY_SPEED_UNIT)
            if not np.all(speeds > 0.0):
                raise InputError("path", f"{path}: {heading}", "a column of numbers > 0")
            speeds = np.interp(all_revolution_numbers, revolution_numbers, speeds)
            check_revolution_durations(
                f"{path}: {heading}", RAD_PER_TURN / speeds, int(revolution_numbers[0])
            )
            durations = RAD_PER_TURN / smooth_series(speeds)
            return np.concatenate([[0.0], np.cumsum(durations)])
    requirement_text = "a file with a column 'speed [rpm]' (or rad/s, Hz) or 'mark [s]'"
    raise InputError(
        "path", str(path), f"{requirement_text}; it has {', '.join(column_by_heading)}"
    )


def _read_arrival_angles(
    path: str | Path,
    heading: str,
    column: np.ndarray,
    revolution_numbers: np.ndarray,
    marks: np.ndarray,
) -> np.ndarray:
    """Return rotor angles from the mark to the arrivals: (rows,) [rad].

    Parameters
    ----------
    path, heading : path, str
        The file, for errors, and the column's heading. The heading's unit is an angle's unit or s.
    column : (rows,)
        Angles in the heading's unit, or times of arrival [s]; nan for a missed passage.
    revolution_numbers : (rows,)
        Revolution number for each row.
    marks : (revolutions + 1,) [s]
        The shaft's mark times.
    """
    if "[s]" not in heading:
        angles = column * _find_unit_factor(path, heading, RAD_BY_ANGLE_UNIT)
        if np.nanmedian(np.abs(angles)) > 2.0 * RAD_PER_TURN:
            requirement_text = (
                "an angle of at most 2 revolutions; for degrees, write [deg] in the heading"
            )
            raise InputError(
                "path", f"{path}: {heading} = {np.nanmedian(column):g}", requirement_text
            )
        return angles
    rotor_angles_at_marks = find_mark_angles(int(revolution_numbers[0]), len(marks))
    return (
        interpolate_by_splines(marks, rotor_angles_at_marks, column)
        - RAD_PER_TURN * revolution_numbers
    )


def _build_arrivals(
    angles: np.ndarray,
    marks: np.ndarray,
    tip_radius: float,
    given_probe_angles: np.ndarray | None,
    first_revolution: int,
) -> ArrivalTimes:
    """Build a blade's arrivals from rotor angles after the mark.

    Parameters
    ----------
    angles : (revolutions, probes) [rad]
        Rotor angles from the mark to the arrival; nan for a missed passage. Changed in place.
    marks : (revolutions + 1,) [s]
        The shaft's mark times.
    tip_radius : float [m]
        Blade tip radius.
    given_probe_angles : (probes,) [rad] or None
        Angles from the blade tip at a mark to the probes. If None, the median arrival angles.
    first_revolution : int
        First revolution's number.
    """
    for probe_arrival_angles in angles.T:  # near the mark, angles jump between 0 and 2 pi
        probe_arrival_angles -= RAD_PER_TURN * np.round(
            (probe_arrival_angles - probe_arrival_angles[np.isfinite(probe_arrival_angles)][0])
            / RAD_PER_TURN
        )
    median_angles = np.nanmedian(angles, axis=0)
    probe_angles = (
        median_angles % RAD_PER_TURN if given_probe_angles is None else given_probe_angles
    )
    if len(probe_angles) != angles.shape[1]:
        raise InputError(
            "probes", probe_angles, f"{angles.shape[1]} angles, one for each probe of the record"
        )
    probe_order = np.argsort(probe_angles)
    row_indices = np.arange(len(angles))
    for probe_index, n_revolutions_to_move in enumerate(
        np.round((median_angles - probe_angles) / RAD_PER_TURN).astype(int)
    ):
        # An arrival before the row's mark, or after the next mark, moves to its own revolution.
        kept_row_indices = row_indices[
            (row_indices >= n_revolutions_to_move)
            & (row_indices - n_revolutions_to_move < len(row_indices))
        ]
        angles_in_own_revolution = (
            angles[kept_row_indices - n_revolutions_to_move, probe_index]
            - RAD_PER_TURN * n_revolutions_to_move
        )
        angles[:, probe_index] = np.nan
        angles[kept_row_indices, probe_index] = angles_in_own_revolution
    angles = angles[:, probe_order]
    rotor_angles_at_marks = find_mark_angles(first_revolution, len(marks))
    time = interpolate_by_splines(
        rotor_angles_at_marks, marks, rotor_angles_at_marks[:-1, None] + angles
    )
    return ArrivalTimes(time, marks, probe_angles[probe_order], tip_radius, first_revolution)
