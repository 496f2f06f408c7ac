"""Arrival times of a blade's tip at stationary probes, measured or simulated."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from fenics_crack.errors import InputError, check_count, check_number, reading
from fenics_crack.outside import text_of
from fenics_crack.table import Tabular, counted

__all__ = ["MOST_PASSAGES", "RADIUS", "ArrivalTimes", "check_probes", "one_radius", "smoothed"]

UNITS = {"angle": "rad", "mark": "s", "next_mark": "s", "arrival": "s", "displacement": "m"}
UNITS |= {"speed": "rad/s", "tip_radius": "m"}
COLUMNS = ("revolution", "angle [rad]", "mark [s]", "next_mark [s]", "arrival [s]")
"""What a CSV file must have."""
STEADY = 1e-2
MOST_PASSAGES = 10**7
RADIUS = "tip_radius [m]"
"""What it may have."""
FEWEST_REVOLUTIONS = 10
"""Whose speed is smoothed, and of a passage."""
FOURTH = 70.0 * 0.455
"""Median of the squares of fourth differences of normal errors of variance 1."""


@dataclass(frozen=True, repr=False)
class ArrivalTimes(Tabular):
    """When the tip of one blade passed stationary probes.

    The rotor's angle alpha(t) follows from a mark on the shaft, seen once per revolution: it is 0
    at the first mark of revolution 0 and 2 pi n at the mark that begins revolution n, with a cubic
    spline between the marks, which constant speed and constant acceleration meet exactly. A
    vibration that moves the tip by u in the direction of rotation makes it arrive early. At its
    arrival

        u = R (phi + 2 pi n - alpha(t)),    at constant speed W:  u = -R W (t - t_expected)

    is the displacement at that very instant, not where the tip was expected: nothing is linearised.

    Attributes
    ----------
    time : (revolutions, probes) [s]
        Arrivals; nan where one is missing.
    marks : (revolutions + 1,) [s]
        Beginnings of the revolutions, and the end of the last one.
    probes : (probes,) [rad]
        Angles phi of the probes from the tip's place at a mark, without vibration, in the direction
        of rotation; from 0 to 2 pi, increasing.
    tip_radius : float [m]
        R.
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
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))
        check_number("tip_radius", self.tip_radius, 0.0, above=True)
        check_probes(self.probes)
        if self.marks.ndim != 1 or len(self.marks) < 2 or not np.all(np.diff(self.marks) > 0.0):
            raise InputError("marks", self.marks, "two or more increasing times")
        shape = (len(self.marks) - 1, len(self.probes))
        if self.time.shape != shape:
            allowed = f"of shape {shape}: a row for each revolution, a column for each probe"
            raise InputError("time", f"of shape {self.time.shape}", allowed)
        if not np.any(np.isfinite(self.time)):
            raise InputError("time", "no finite number", "the times of some arrivals")
        turn, after = np.diff(self.marks)[:, None], self.time - self.marks[:-1, None]
        wrong = (after < -turn) | (after > 2.0 * turn)
        if np.any(wrong):
            allowed = "within the revolution of the row, the one before or the one after; or nan"
            raise InputError("time", float(self.time[wrong][0]), allowed)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def speed(self) -> np.ndarray:
        """Mean speed of each revolution: (revolutions,) [rad/s]."""
        return np.asarray(2.0 * np.pi / np.diff(self.marks))

    @property
    def mean_speed(self) -> float:
        """Speed over the revolutions from which there are arrivals [rad/s]."""
        turns = np.flatnonzero(np.isfinite(self.time).any(axis=1))
        begin, end = int(turns[0]), int(turns[-1]) + 1
        return float(2.0 * np.pi * (end - begin) / (self.marks[end] - self.marks[begin]))

    @property
    def steady(self) -> bool:
        """Tell whether the speed varies by less than 1 %; else these are arrivals of a run-up."""
        speed = self.speed
        return bool(np.ptp(speed) <= STEADY * speed.mean())

    @cached_property
    def nominal_angle(self) -> np.ndarray:
        """Rotor angle phi + 2 pi n where a tip without vibration arrives: (revolutions, probes)."""
        turns = self.first + np.arange(len(self))
        return np.asarray(2.0 * np.pi * turns[:, None] + self.probes)

    @cached_property
    def angle(self) -> np.ndarray:
        """Rotor angle alpha at the arrivals: (revolutions, probes) [rad]."""
        from scipy.interpolate import CubicSpline  # takes longer than to read the arrivals

        turns = self.first + np.arange(len(self.marks))
        return np.asarray(CubicSpline(self.marks, 2.0 * np.pi * turns)(self.time))

    @cached_property
    def expected(self) -> np.ndarray:
        """Times at the nominal angles, seen or not: (revolutions, probes) [s]."""
        from scipy.interpolate import CubicSpline

        turns = self.first + np.arange(len(self.marks))
        return np.asarray(CubicSpline(2.0 * np.pi * turns, self.marks)(self.nominal_angle))

    @cached_property
    def displacement(self) -> np.ndarray:
        """Tangential displacement u at the arrivals: (revolutions, probes) [m]."""
        return np.asarray(self.tip_radius * (self.nominal_angle - self.angle))

    def zeroed(self, begin: int, end: int) -> Self:
        """The same with the probes where the mean tip of the revolutions begin to end - 1, counted
        from 0, stands: displacements are those from there, as of quiet revolutions."""
        check_count("begin", begin, 0)
        check_count("end", end, begin + 1)
        quiet = np.nanmedian(self.displacement[begin:end], axis=0)
        return replace(self, probes=self.probes - quiet / self.tip_radius)

    def between(self, begin: int, end: int) -> Self:
        """The same with the arrivals of the revolutions begin to end - 1, counted from 0, alone."""
        check_count("begin", begin, 0)
        check_count("end", end, begin + 1)
        kept = np.zeros(len(self), dtype=bool)
        kept[begin:end] = True
        return replace(self, time=np.where(kept[:, None], self.time, np.nan))

    @classmethod
    def from_csv(cls, path: str | Path, *, tip_radius: float | None = None) -> Self:
        """Read arrivals from a CSV file with these columns, in any order, and any others.

        ``revolution`` (a whole number), ``angle [rad]`` of the probe, ``mark [s]`` and
        ``next_mark [s]`` (begin and end of the revolution), ``arrival [s]``; and ``tip_radius [m]``
        unless it is given here. A row is a passage; passages may be missing, revolutions may not.
        :meth:`to_csv` writes such a file, from which the same arrivals are read to the last bit.

        Raises
        ------
        InputError
            The file cannot be read, a column is missing, or rows contradict each other or the
            radius given.
        """
        (turn, angle, mark, after, arrival), radius = _columns(path)
        tip_radius = one_radius(path, radius, tip_radius)
        turns, row = np.unique(turn, return_inverse=True)
        probes, where = np.unique(angle, return_inverse=True)
        if np.any(np.diff(turns) != 1.0):
            raise InputError("path", str(path), "a file without gaps between its revolutions")
        if len(turns) * len(probes) > MOST_PASSAGES:
            size = f"{len(turns)} revolutions, {len(probes)} probes"
            raise InputError("path", f"{path}: {size}", f"{MOST_PASSAGES:.0e} passages at most")
        begins, ends = np.empty(len(turns)), np.empty(len(turns))
        begins[row], ends[row] = mark, after
        time = np.full((len(turns), len(probes)), np.nan)
        time[row, where] = arrival
        same = [begins[row] == mark, ends[row] == after]
        same += [begins[1:] == ends[:-1], len(set(zip(row, where, strict=True))) == len(row)]
        if not all(map(np.all, same)):
            allowed = "a file in which each revolution has one mark and one next_mark, that of the "
            raise InputError("path", str(path), allowed + "one after, and passes a probe once")
        return cls(time, np.append(begins, ends[-1]), probes, tip_radius, int(turns[0]))

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every passage."""
        count, probes = self.time.shape
        rows = np.arange(count)
        return {
            "revolution": np.repeat(self.first + rows, probes).tolist(),
            "probe": np.tile(np.arange(1, probes + 1), count).tolist(),
            "angle": np.tile(self.probes, count).tolist(),
            "mark": np.repeat(self.marks[:-1], probes).tolist(),
            "next_mark": np.repeat(self.marks[1:], probes).tolist(),
            "arrival": self.time.ravel().tolist(),
            "displacement": self.displacement.ravel().tolist(),
            "speed": np.repeat(self.speed, probes).tolist(),
            "tip_radius": [float(self.tip_radius)] * self.time.size,
        }

    def _units(self) -> Mapping[str, str]:
        return UNITS

    def _title(self) -> str:
        speed, missing = self.speed, int(np.isnan(self.time).sum())
        parts = [counted(len(self), "revolution"), counted(len(self.probes), "probe")]
        steady = np.ptp(speed) <= 1e-6 * speed[0]
        parts.append(f"{speed[0]:.6g}{'' if steady else f' to {speed[-1]:.6g}'} rad/s")
        return ", ".join(parts + [f"{missing} missing"] * (missing > 0))


def smoothed(values: np.ndarray) -> np.ndarray:
    """Values (n,) along the revolutions without their errors, as far as they tell them.

    Quadratics over 2 h + 1 neighbours (Savitzky and Golay, Analytical Chemistry 36, 1964, 1627),
    with h from 0 up of the least risk by Stein's estimate (Annals of Statistics 9, 1981, 1135); the
    variance of the errors is that of the fourth differences.
    """
    if len(values) < FEWEST_REVOLUTIONS:
        return values
    from scipy.signal import savgol_coeffs, savgol_filter

    variance = float(np.median(np.diff(values, 4) ** 2)) / FOURTH
    found, least = values, variance
    for half in 2 ** np.arange(1, int(np.log2(len(values) / 4.0)) + 1):
        tried = savgol_filter(values, 2 * half + 1, 2)
        share = float(savgol_coeffs(2 * half + 1, 2)[half])
        risk = float(np.mean((values - tried) ** 2)) + (2.0 * share - 1.0) * variance
        if risk < least:
            found, least = tried, risk
    return np.asarray(found)


def check_probes(probes: np.ndarray) -> None:
    """Raise InputError unless probes are angles from 0 to 2 pi, increasing."""
    fit = probes.ndim == 1 and len(probes) > 0 and np.all(np.isfinite(probes))
    if not fit or probes[0] < 0.0 or probes[-1] >= 2.0 * np.pi or np.any(np.diff(probes) <= 0.0):
        raise InputError("probes", probes, "increasing angles [rad] from 0 to less than 2 pi")


def one_radius(path: str | Path, of_file: np.ndarray | None, given: float | None) -> float:
    """The tip's radius [m], from a column of a file or given; InputError unless it is one."""
    if of_file is None:
        if given is None:
            allowed = f"given for {path}, which has no column '{RADIUS}'"
            raise InputError("tip_radius", None, allowed)
        return given
    values = np.unique(np.append(of_file, of_file[0] if given is None else given))
    if len(values) > 1:
        allowed = "one number, in all rows" + ("" if given is None else f" {given:g}, as given")
        raise InputError("path", f"{path}, {RADIUS} = {values.tolist()}", allowed)
    return float(values[0])


def _columns(path: str | Path) -> tuple[np.ndarray, np.ndarray | None]:
    """The columns of a file that are needed: (5, rows), and the radii (rows,) if it has them."""
    with reading("path", path, "a table of numbers"):
        with io.StringIO(text_of(path)) as file:
            names = [name.strip() for name in next(csv.reader(file), [])]
            for name in COLUMNS:
                if name not in names:
                    has = f"it has {', '.join(names)}" if any(names) else "it is empty"
                    allowed = f"a file with the column '{name}'; {has}"
                    raise InputError("path", str(path), allowed)
            wanted = [*COLUMNS, *([RADIUS] if RADIUS in names else [])]
            places = [names.index(name) for name in wanted]
            lines = [line for line in file if line.strip()]
        rows = np.genfromtxt(lines, delimiter=",", usecols=places, ndmin=2) if lines else None
    finite = rows is not None and np.all(np.isfinite(rows[:, :4]))
    if rows is None or not finite or np.any(rows[:, 0] % 1.0) or np.abs(rows[:, 0]).max() >= 2**53:
        allowed = "a file whose rows have finite numbers but for the arrival, and whole revolutions"
        raise InputError("path", str(path), allowed)
    return rows.T[:5], rows.T[5] if len(wanted) > 5 else None
