"""Hold, read and write a blade tip's arrival times at stationary probes.

Measured records from data systems have a row for each revolution. It has the rotor's speed, or the
time of the mark at its beginning, and for each blade and probe the angle or time of arrival. A
missed passage is an empty cell. Probe angles are often unknown: the median arrival is then their
zero.
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
from fenics_crack.basics.tables import RAD_PER_S_PER_RPM, RAD_PER_TURN, Table, Tabular, format_count
from fenics_crack.basics.untrusted_files import (
    SI_UNIT_AND_FACTOR,
    convert_heading_to_si,
    read_csv_rows,
)

ARRIVAL_COLUMNS = ("revolution", "angle [rad]", "mark [s]", "next_mark [s]", "arrival [s]")
"""Required columns of a CSV file."""
RADIUS_COLUMN = "tip_radius [m]"
"""Optional column of a CSV file."""
RADIUS_HINT = "distance of tips and axis in m; from the shell --set tip_timing.tip_radius=0.5"
"""Hint of the error that the radius is missing."""
STEADY = 1e-2
"""Maximum relative variation of a constant speed."""
MOST_PASSAGES = 10**7
"""Maximum number of passages in a record, which limits the memory."""
FEWEST_REVOLUTIONS = 10
"""Minimum number of revolutions for a smoothed speed, and for a passage through a resonance."""


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
        Beginnings of the revolutions, and the end of the last revolution.
    probes : (probes,) [rad]
        Angles phi between the probes and the undisturbed blade tip at a mark, in the direction of
        rotation; from 0 to 2 pi, increasing.
    tip_radius : float [m]
        Radius R.
    first : int
        Number of the first revolution.

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
        for name in ("time", "marks", "probes"):
            try:
                values = np.asarray(getattr(self, name), dtype=float)
            except (TypeError, ValueError):
                raise InputError(name, getattr(self, name), "numbers") from None
            object.__setattr__(self, name, values)
        check_number("tip_radius", self.tip_radius, 0.0, excludes_bound=True)
        check_probes(self.probes)
        if self.marks.ndim != 1 or len(self.marks) < 2:
            problem = f"of shape {self.marks.shape}"
            raise InputError("marks", problem, "two or more increasing times")
        if not np.all(is_rising := np.diff(self.marks) > 0.0):
            mark, next_mark = self.marks[int(np.argmin(is_rising)) :][:2]
            raise InputError("marks", f"{next_mark:.9g} s after {mark:.9g} s", "increasing times")
        check_turns("marks", np.diff(self.marks), self.first)
        shape = (len(self.marks) - 1, len(self.probes))
        if self.time.shape != shape:
            requirement = f"of shape {shape}: a row for each revolution, a column for each probe"
            raise InputError("time", f"of shape {self.time.shape}", requirement)
        if not np.any(np.isfinite(self.time)):
            raise InputError("time", "no finite number", "the times of some arrivals")
        turn, delay = np.diff(self.marks)[:, None], self.time - self.marks[:-1, None]
        is_misplaced = (delay < -turn) | (delay > 2.0 * turn)
        if np.any(is_misplaced):
            requirement = (
                "within the revolution of the row, the one before or the one after; or nan"
            )
            raise InputError("time", float(self.time[is_misplaced][0]), requirement)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def speed(self) -> np.ndarray:
        """Mean speed of each revolution: (revolutions,) [rad/s]."""
        return np.asarray(2.0 * np.pi / np.diff(self.marks))

    @property
    def mean_speed(self) -> float:
        """Mean speed between the first and last revolutions with arrivals [rad/s]."""
        turns = np.flatnonzero(np.isfinite(self.time).any(axis=1))
        begin, end = int(turns[0]), int(turns[-1]) + 1
        return float(2.0 * np.pi * (end - begin) / (self.marks[end] - self.marks[begin]))

    @property
    def steady(self) -> bool:
        """True if the speed varies by at most 1 %."""
        speed = self.speed
        return bool(np.ptp(speed) <= STEADY * speed.mean())

    @cached_property
    def nominal_angle(self) -> np.ndarray:
        """Rotor angle phi + 2 pi n at arrivals without vibration: (revolutions, probes) [rad]."""
        turns = self.first + np.arange(len(self))
        return np.asarray(2.0 * np.pi * turns[:, None] + self.probes)

    @cached_property
    def angle(self) -> np.ndarray:
        """Rotor angle alpha at the arrivals: (revolutions, probes) [rad]."""
        turns = self.first + np.arange(len(self.marks))
        return between(self.marks, RAD_PER_TURN * turns, self.time)

    @cached_property
    def expected(self) -> np.ndarray:
        """Times at the nominal angles, with or without arrivals: (revolutions, probes) [s]."""
        turns = self.first + np.arange(len(self.marks))
        return between(RAD_PER_TURN * turns, self.marks, self.nominal_angle)

    @cached_property
    def displacement(self) -> np.ndarray:
        """Tangential displacement u at the arrivals: (revolutions, probes) [m]."""
        return np.asarray(self.tip_radius * (self.nominal_angle - self.angle))

    @cached_property
    def rounding(self) -> float:
        """Rounding of displacements [m]: by rounded angles, and 1e-9 of the motion."""
        angle, motion = (float(np.nanmax(np.abs(x))) for x in (self.angle, self.displacement))
        return 1e-9 * motion + 4.0 * float(np.spacing(angle)) * self.tip_radius

    def check_places(self, angle_deviation: float) -> None:
        """Check that arrivals are at their probes, apart from a common shift.

        Raise InputError if arrivals are nearer to another probe, or in another revolution: a fit
        would take the difference for a vibration. The standard deviation of the probes' angles
        [rad] must be a number >= 0.
        """
        check_number("angle_deviation", angle_deviation, 0.0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a probe without arrivals
            shifts = np.nanmedian(self.nominal_angle - self.angle, axis=0)
        shifts -= np.nanmedian(shifts)
        far_probes = np.flatnonzero(np.abs(shifts) > 0.5 * RAD_PER_TURN)
        if len(far_probes):
            probe_text = f"those at {np.degrees(self.probes[far_probes[0]]):g} degrees"
            problem = (
                f"{probe_text} are of the revolutions "
                f"{'before' if shifts[far_probes[0]] > 0.0 else 'after'}"
            )
            raise InputError("time", problem, "in the rows of their own revolutions, at all probes")
        distances = np.abs(self.probes - shifts - self.probes[:, None])  # [stated, passed]
        nearest_probes = np.argmin(
            np.minimum(distances % RAD_PER_TURN, -distances % RAD_PER_TURN), axis=0
        )
        swapped_probes = np.flatnonzero(
            np.isfinite(shifts) & (nearest_probes != np.arange(len(shifts)))
        )
        if len(swapped_probes):
            angle, passed_angle = np.degrees(
                self.probes[[swapped_probes[0], nearest_probes[swapped_probes[0]]]]
            )
            problem = (
                f"the one at {angle:g} degrees is passed where that at {passed_angle:g} degrees is"
            )
            requirement = "where their arrivals are; two are swapped, or times too coarse"
            raise InputError("probes", problem, requirement)

    def zeroed(self, begin: int, end: int) -> Self:
        """Return these arrivals with displacements from quiet revolutions.

        The probes move to the median blade tip in revolutions begin to end - 1, counted from 0.
        """
        median_displacement = np.nanmedian(self.between(begin, end).displacement[begin:end], axis=0)
        return replace(self, probes=self.probes - median_displacement / self.tip_radius)

    def between(self, begin: int, end: int) -> Self:
        """Keep only the arrivals in revolutions begin to end - 1, from 0."""
        check_count("begin", begin, 0)
        check_count("end", end, begin + 1)
        is_kept = np.zeros(len(self), dtype=bool)
        is_kept[begin:end] = True
        return replace(self, time=np.where(is_kept[:, None], self.time, np.nan))

    def without(self, probes: np.ndarray) -> Self:
        """Return these arrivals without the probes of indices (n,), from 0."""
        time = np.delete(self.time, probes, axis=1)
        return replace(self, time=time, probes=np.delete(self.probes, probes))

    @classmethod
    def from_csv(cls, path: str | Path, *, tip_radius: float | None = None) -> Self:
        """Read arrivals from a CSV file with a row for each passage.

        Columns have any order, and others are ignored: ``revolution`` (a whole number), ``angle
        [rad]`` of the probe, ``mark [s]`` and ``next_mark [s]`` (begin and end of the revolution),
        ``arrival [s]``; and ``tip_radius [m]`` unless given as an argument. Other units are
        converted, as by :func:`read_record`. Passages may be missing, but revolutions may not.
        :meth:`to_csv` writes such a file; the same arrivals are read back to the last bit.

        Raises
        ------
        InputError
            The file cannot be read, a column is missing, or rows contradict each other or the given
            radius.
        """
        (turn, angle, mark, next_mark, arrival), radius = _read_passages(path)
        tip_radius = choose_radius(path, radius, tip_radius)
        turns, row = np.unique(turn, return_inverse=True)
        probes, column = np.unique(angle, return_inverse=True)
        if np.any(np.diff(turns) != 1.0):
            raise InputError("path", str(path), "a file without gaps between its revolutions")
        if len(turns) * len(probes) > MOST_PASSAGES:
            size = f"{len(turns)} revolutions, {len(probes)} probes"
            raise InputError("path", f"{path}: {size}", f"{MOST_PASSAGES:.0e} passages at most")
        begins, ends = np.empty(len(turns)), np.empty(len(turns))
        begins[row], ends[row] = mark, next_mark
        time = np.full((len(turns), len(probes)), np.nan)
        time[row, column] = arrival
        checks = [begins[row] == mark, ends[row] == next_mark]
        checks += [begins[1:] == ends[:-1], len(set(zip(row, column, strict=True))) == len(row)]
        if not all(map(np.all, checks)):
            requirement = (
                "a file in which each revolution has one mark and one next_mark, that of the "
            )
            raise InputError("path", str(path), requirement + "one after, and passes a probe once")
        return cls(time, np.append(begins, ends[-1]), probes, tip_radius, int(turns[0]))

    def to_dict(self) -> dict[str, Any]:
        """Return columns, a row for every passage."""
        n_turns, n_probes = self.time.shape
        rows = np.arange(n_turns)
        return {
            "revolution": np.repeat(self.first + rows, n_probes).tolist(),
            "probe": np.tile(np.arange(1, n_probes + 1), n_turns).tolist(),
            "angle": np.tile(self.probes, n_turns).tolist(),
            "mark": np.repeat(self.marks[:-1], n_probes).tolist(),
            "next_mark": np.repeat(self.marks[1:], n_probes).tolist(),
            "arrival": self.time.ravel().tolist(),
            "displacement": self.displacement.ravel().tolist(),
            "speed": np.repeat(self.speed, n_probes).tolist(),
            "tip_radius": [float(self.tip_radius)] * self.time.size,
        }

    def _title(self) -> str:
        speed, n_missing = self.speed, int(np.isnan(self.time).sum())
        parts = [format_count(len(self), "revolution"), format_count(len(self.probes), "probe")]
        is_steady = np.ptp(speed) <= 1e-6 * speed[0]
        parts.append(f"{speed[0]:.6g}{'' if is_steady else f' to {speed[-1]:.6g}'} rad/s")
        return ", ".join(parts + [f"{n_missing} missing"] * (n_missing > 0))


def between(knots: np.ndarray, values: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Interpolate values (n, ...) at increasing knots (n,) by cubic splines."""
    from scipy.interpolate import CubicSpline  # takes longer than to read the arrivals

    return np.asarray(CubicSpline(knots, values)(points))


def smooth_series(values: np.ndarray) -> np.ndarray:
    """Smooth values (n,) in successive revolutions, to reduce their errors.

    Quadratics are fitted over 2 h + 1 neighbours (Savitzky and Golay, Analytical Chemistry 36,
    1964, 1627). The half width h = 0, 2, 4, 8, ... has the least risk by Stein's estimate (Annals
    of Statistics 9, 1981, 1135). Fourth differences give the variance of errors. Fewer than 10
    values are returned unchanged.
    """
    if len(values) < FEWEST_REVOLUTIONS:
        return values
    from scipy.signal import savgol_coeffs, savgol_filter

    # Fourth differences of white errors have 70 times their variance; the median of chi^2 is 0.455.
    variance = float(np.median(np.diff(values, 4) ** 2)) / (70.0 * 0.455)
    best_series, min_risk = values, variance
    for half_width in 2 ** np.arange(1, int(np.log2(len(values) / 4.0)) + 1):
        candidate = savgol_filter(values, 2 * half_width + 1, 2)
        centre_weight = float(savgol_coeffs(2 * half_width + 1, 2)[half_width])
        risk = float(np.mean((values - candidate) ** 2)) + (2.0 * centre_weight - 1.0) * variance
        if risk < min_risk:
            best_series, min_risk = candidate, risk
    return np.asarray(best_series)


def check_turns(name: str, turns: np.ndarray, first_turn: int = 0) -> None:
    """Raise InputError unless durations of revolutions (n,) [s] vary smoothly.

    A duration more than 1.4 times the median of five, or less than 1 / 1.4 times, shows a missed
    mark or a false one.
    """
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(turns, 2, mode="symmetric"), 5)
    medians = np.median(windows, axis=1)
    is_outlier = np.abs(np.log(turns / medians)) > np.log(1.4)
    if np.any(is_outlier):
        index = int(np.argmax(is_outlier))
        problem = (
            f"revolution {first_turn + index} takes {turns[index] / medians[index]:.3g} times "
            "as long as those"
        )
        requirement = (
            "marks of which none was missed or seen twice; leave out such rows, but count "
        )
        raise InputError(name, f"{problem} around it", f"{requirement}their revolutions")


def check_probes(probes: np.ndarray) -> None:
    """Raise InputError unless probes are angles from 0 to 2 pi, increasing."""
    valid = probes.ndim == 1 and len(probes) > 0 and np.all(np.isfinite(probes))
    if not valid or probes[0] < 0.0 or probes[-1] >= 2.0 * np.pi or np.any(np.diff(probes) <= 0.0):
        raise InputError("probes", probes, "increasing angles [rad] from 0 to less than 2 pi")


def choose_radius(path: str | Path, file_radii: np.ndarray | None, radius: float | None) -> float:
    """Return the tip radius [m], from a file's column or as given.

    Raise InputError without a radius, or for contradictory ones.
    """
    if file_radii is None:
        if radius is None:
            requirement = f"given for {path}, which has no column '{RADIUS_COLUMN}': {RADIUS_HINT}"
            raise InputError("tip_radius", None, requirement)
        return radius
    radii = np.unique(np.append(file_radii, file_radii[0] if radius is None else radius))
    if len(radii) > 1:
        requirement = "one number, in all rows" + (
            "" if radius is None else f" {radius:g}, as given"
        )
        raise InputError("path", f"{path}, {RADIUS_COLUMN} = {radii.tolist()}", requirement)
    return float(radii[0])


def _read_table(path: str | Path) -> tuple[list[str], list[int], np.ndarray]:
    """Read a CSV file without lines that begin with #.

    Returns
    -------
    headings : list of str
        Headings, with units converted to SI.
    line_numbers : list of int
        Numbers of the lines (n,) below the headings.
    table : (columns, n)
        Numbers in SI; nan in cells without a number.
    """
    with report_read_errors("path", path, "a table of numbers"):
        (_, names), *rows = read_csv_rows(path) or [(0, [])]
        for number, row in rows:
            if len(row) < len(names):
                requirement = (
                    f"a row of {len(names)} cells, as there are headings, not of {len(row)}"
                )
                raise InputError("path", f"{path}, line {number}", requirement)
    headings = [convert_heading_to_si(name) for name in names]
    columns = [[f * _number(row[n]) for _, row in rows] for n, (_, f) in enumerate(headings)]
    table = np.array(columns).reshape(len(names), len(rows))
    return [name for name, _ in headings], [number for number, _ in rows], table


def _number(cell: str) -> float:
    """Return the number in a cell, or nan without one."""
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _read_passages(path: str | Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Read a file's required columns (5, rows), and radii (rows,) or None."""
    names, lines, columns = _read_table(path)
    for name in ARRIVAL_COLUMNS:
        if name not in names:
            contents = f"it has {', '.join(names)}" if any(names) else "it is empty"
            raise InputError("path", str(path), f"a file with the column '{name}'; {contents}")
    passages = columns[[names.index(name) for name in ARRIVAL_COLUMNS]]
    if not lines:
        raise InputError("path", str(path), "a file with rows of numbers below its headings")
    is_finite, turns = np.isfinite(passages[:4]).all(axis=0), np.nan_to_num(passages[0])
    if not np.all(is_valid := is_finite & (turns % 1.0 == 0.0) & (np.abs(turns) < 2**53)):
        requirement = "a row of finite numbers but for the arrival, and of a whole revolution"
        raise InputError("path", f"{path}, line {lines[int(np.argmin(is_valid))]}", requirement)
    return passages, columns[names.index(RADIUS_COLUMN)] if RADIUS_COLUMN in names else None


# --- records --------------------------------------------------------------------------------------

PASSAGE_HEADING = re.compile(r"(?:blade\s*(\d+))?.*?\bprobe\s*(\d+)", re.IGNORECASE)
"""Heading of a blade's arrivals at a probe; the default is blade 1."""
SPEED_UNITS = {"rpm": RAD_PER_S_PER_RPM, "rad/s": 1.0, "Hz": RAD_PER_TURN}
ANGLE_UNITS, TIME_UNITS = {"rad": 1.0, "deg": SI_UNIT_AND_FACTOR["deg"][1]}, {"s": 1.0}
"""Factors of units to rad/s, rad and s; the first unit is the default of a heading."""


def read_record(
    path: str | Path,
    *,
    tip_radius: float | None = None,
    probes: Sequence[float] | np.ndarray | Mapping[int, np.ndarray] | None = None,
) -> dict[int, ArrivalTimes]:
    """Read the arrivals of one or more blades.

    The file has a row for each revolution.
    Headings identify the columns, in any order, with units in brackets. Other columns are ignored,
    and so are lines that begin with #. The radius may be in mm, too. Commas, semicolons or tabs
    separate the cells.

    ``revolution``
        Number of the revolution; rows may be missing. Without this column rows are counted.
    ``speed [rpm]`` (or rad/s, Hz; "shaft speed" too)
        Mean speed of the revolution; or ``mark [s]``, the time of the shaft's mark at its
        beginning.
    ``blade 2 probe 1 [rad]`` (or deg; "AoA" does no harm)
        Rotor angle from the mark to the arrival; or ``[s]``, the time of arrival (with ``mark
        [s]``). Empty or nan for a missed passage; without "blade 2" the file has one blade.
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
        Angles from the blade tip at a mark to the probes; a mapping has the angles for each blade
        number. Default: medians of the arrivals, so that displacements are relative to a middle
        position.

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
    names, _, table = _read_table(path)
    if not any(map(PASSAGE_HEADING.search, names)):
        return {1: ArrivalTimes.from_csv(path, tip_radius=tip_radius)}
    columns = dict(zip(names, table, strict=True))
    blade_headings: dict[int, dict[int, str]] = {}
    for name in names:
        if match := PASSAGE_HEADING.search(name):
            blade_headings.setdefault(int(match[1] or 1), {})[int(match[2])] = name
    if len(columns) != len(names):
        raise InputError("path", f"{path}: {', '.join(names)}", "headings, each given once")
    if table.shape[1] < 2:
        problem = f"{path}: {format_count(table.shape[1], 'revolution')}"
        raise InputError("path", problem, "two or more, between which the speed is measured")
    turns = _read_turns(path, columns.get("revolution", np.arange(float(table.shape[1]))))
    marks = _read_marks(path, columns, turns)
    tip_radius = choose_radius(path, columns.get(RADIUS_COLUMN), tip_radius)
    blades = {}
    for blade, headings in sorted(blade_headings.items()):
        angles = np.full((len(marks) - 1, len(headings)), np.nan)
        for probe, (_, name) in enumerate(sorted(headings.items())):
            if not np.any(np.isfinite(columns[name])):
                raise InputError("path", f"{path}: {name}", "a column with finite numbers")
            angles[turns - turns[0], probe] = _read_angles(path, name, columns[name], turns, marks)
        blade_probes = probes.get(blade) if isinstance(probes, Mapping) else probes
        probe_angles = None if blade_probes is None else np.asarray(blade_probes, dtype=float)
        blades[blade] = _build_arrivals(angles, marks, tip_radius, probe_angles, int(turns[0]))
    return blades


def has_probe_angles(path: str | Path) -> bool:
    """Return True if a file has the angles of its probes."""
    return ARRIVAL_COLUMNS[1] in _read_table(path)[0]


def probes_of_blades(probes: Sequence[float] | np.ndarray, count: int) -> dict[int, np.ndarray]:
    """Return probe angles (n_probes,) [rad] from each blade's tip at the mark.

    Keys are the numbers of the blades, from 1 to count; blade j + 1 is 2 pi / count ahead of
    blade j.
    """
    angles = np.asarray(probes, dtype=float)
    return {
        blade: (angles - RAD_PER_TURN * (blade - 1) / count) % RAD_PER_TURN
        for blade in range(1, count + 1)
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
        raise InputError("blades", blades, "arrivals of one blade or more")
    first_blade = next(iter(blades.values()))
    columns: dict[str, Any] = {
        "revolution": (first_blade.first + np.arange(len(first_blade))).tolist(),
        "mark [s]": first_blade.marks[:-1].tolist(),
    }
    angles_of_blades = probes_of_blades(probes, len(blades))
    for blade, arrivals in blades.items():
        for number, probe in enumerate(np.argsort(np.argsort(angles_of_blades[blade])), 1):
            columns[f"blade {blade} probe {number} [s]"] = arrivals.time[:, probe].tolist()
    columns[RADIUS_COLUMN] = [first_blade.tip_radius] * len(first_blade)
    Table.from_dict(columns, {}).save(path)


def _unit_factor(path: str | Path, name: str, factors: dict[str, float]) -> float:
    """Return the factor to SI for the unit in a heading."""
    match = re.search(r"\[(.*)\]", name)
    unit_name = match[1] if match else next(iter(factors))
    if unit_name not in factors:
        raise InputError("path", f"{path}: {name}", f"with one of the units {', '.join(factors)}")
    return factors[unit_name]


def _read_turns(path: str | Path, column: np.ndarray) -> np.ndarray:
    """Check and return the increasing numbers of the revolutions (rows,)."""
    is_whole = np.all(np.isfinite(column)) and not np.any(column % 1.0) and column[0] >= 0.0
    if not is_whole or np.any(np.diff(column) <= 0.0) or np.ptp(column) > MOST_PASSAGES:
        raise InputError("path", f"{path}: revolution", "increasing whole numbers >= 0")
    return column.astype(int)


def _read_marks(path: str | Path, columns: dict[str, np.ndarray], turns: np.ndarray) -> np.ndarray:
    """Return times of the marks: (revolutions + 1,) [s].

    The file has marks or speeds.
    Marks of missing rows are interpolated; the last one ends the last revolution.
    """
    all_turns = np.arange(turns[0], turns[-1] + 1)
    for name, column in columns.items():
        if re.match("mark", name, re.IGNORECASE):
            column = column * _unit_factor(path, name, TIME_UNITS)
            mark_durations = np.diff(column) / np.diff(turns)
            if not np.all((mark_durations > 0.0) & np.isfinite(mark_durations)):
                raise InputError("path", f"{path}: {name}", "increasing times")
            marks = np.interp(all_turns, turns, column)
            check_turns(f"{path}: {name}", np.diff(marks), int(turns[0]))
            marks = smooth_series(marks)
            # The end of the last revolution, as the speed changes.
            last_durations = np.diff(marks)[-2:]
            return np.append(marks, marks[-1] + 2.0 * last_durations[-1] - last_durations[0])
        if "speed" in name.lower() and not PASSAGE_HEADING.search(name):
            speed = column * _unit_factor(path, name, SPEED_UNITS)
            if not np.all(speed > 0.0):
                raise InputError("path", f"{path}: {name}", "numbers > 0")
            speed = np.interp(all_turns, turns, speed)
            check_turns(f"{path}: {name}", RAD_PER_TURN / speed, int(turns[0]))
            durations = RAD_PER_TURN / smooth_series(speed)
            return np.concatenate([[0.0], np.cumsum(durations)])
    requirement = "a file with a column 'speed [rpm]' (rad/s, Hz) or 'mark [s]'"
    raise InputError("path", str(path), f"{requirement}; it has {', '.join(columns)}")


def _read_angles(
    path: str | Path, name: str, column: np.ndarray, turns: np.ndarray, marks: np.ndarray
) -> np.ndarray:
    """Return angles from the mark to the arrivals (rows,) [rad]."""
    if "[s]" not in name:
        angles = column * _unit_factor(path, name, ANGLE_UNITS)
        if np.nanmedian(np.abs(angles)) > 2.0 * RAD_PER_TURN:
            requirement = "angles from the mark to the arrival, in a revolution; in degrees?"
            raise InputError("path", f"{path}: {name} = {np.nanmedian(column):g}", requirement)
        return angles
    mark_numbers = np.arange(turns[0], turns[0] + len(marks))
    return RAD_PER_TURN * (between(marks, mark_numbers, column) - turns)


def _build_arrivals(
    angles: np.ndarray,
    marks: np.ndarray,
    tip_radius: float,
    probes: np.ndarray | None,
    first_turn: int,
) -> ArrivalTimes:
    """Return a blade's arrivals from angles after the mark (revolutions, probes) [rad]."""
    for column in angles.T:  # a blade at the mark is seen before it and after it
        column -= RAD_PER_TURN * np.round((column - column[np.isfinite(column)][0]) / RAD_PER_TURN)
    medians = np.nanmedian(angles, axis=0)
    probe_angles = medians % RAD_PER_TURN if probes is None else probes
    if len(probe_angles) != angles.shape[1]:
        raise InputError(
            "probes", probe_angles, f"{angles.shape[1]} angles, as the record has probes"
        )
    probe_order = np.argsort(probe_angles)
    rows = np.arange(len(angles))
    for probe, lag in enumerate(np.round((medians - probe_angles) / RAD_PER_TURN).astype(int)):
        # From before its mark, or from after the next one: of another revolution than its row's.
        kept_rows = rows[(rows >= lag) & (rows - lag < len(rows))]
        moved_angles = angles[kept_rows - lag, probe] - RAD_PER_TURN * lag
        angles[:, probe] = np.nan
        angles[kept_rows, probe] = moved_angles
    angles = angles[:, probe_order]
    turns = first_turn + np.arange(len(marks))
    time = between(RAD_PER_TURN * turns, marks, RAD_PER_TURN * turns[:-1, None] + angles)
    return ArrivalTimes(time, marks, probe_angles[probe_order], tip_radius, first_turn)
