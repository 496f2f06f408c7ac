"""Arrival times of a blade tip at stationary probes, measured or simulated.

Measured records, as data systems write them, have a row for each revolution: the rotor's speed, or
the time of the mark that begins it, and for each blade and probe the angle of arrival or its time.
A passage that was missed is an empty cell. Where the probes stand is often not known: their zero is
then the median arrival.
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

from fenics_crack.basics.errors import InputError, check_count, check_number, reading
from fenics_crack.basics.tables import RPM, TURN, Table, Tabular, counted
from fenics_crack.basics.untrusted_files import IN_SI, heading_in_si, table_rows

ARRIVAL_COLUMNS = ("revolution", "angle [rad]", "mark [s]", "next_mark [s]", "arrival [s]")
"""Required columns of a CSV file."""
RADIUS = "tip_radius [m]"
"""Optional column of a CSV file."""
OF_RADIUS = "distance of tips and axis in m; from the shell --set tip_timing.tip_radius=0.5"
"""Remedy where it is missing."""
STEADY = 1e-2
"""Maximum relative variation of a constant speed."""
MOST_PASSAGES = 10**7
"""Maximum number of passages, for the memory."""
FEWEST_REVOLUTIONS = 10
"""Minimum number of revolutions for a smoothed speed, and of a passage."""


@dataclass(frozen=True, repr=False)
class ArrivalTimes(Tabular):
    """Times at which the tip of one blade passed stationary probes.

    The rotor's angle alpha(t) follows from a mark on the shaft, seen once per revolution: it is 0
    at the first mark of revolution 0 and 2 pi n at the mark that begins revolution n, with a cubic
    spline between the marks, which constant speed and constant acceleration meet exactly. A
    vibration that moves the blade tip by u in the direction of rotation makes it arrive early. At
    its arrival

        u = R (phi + 2 pi n - alpha(t)),    at constant speed W:  u = -R W (t - t_expected)

    is the displacement at that very instant, not at the expected one: nothing is linearised.

    Attributes
    ----------
    time : (revolutions, probes) [s]
        Arrivals; nan where one is missing.
    marks : (revolutions + 1,) [s]
        Beginnings of the revolutions, and the end of the last one.
    probes : (probes,) [rad]
        Angles phi of the probes from the blade tip's place at a mark, without vibration, in the
        direction of rotation; from 0 to 2 pi, increasing.
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
            try:
                values = np.asarray(getattr(self, name), dtype=float)
            except (TypeError, ValueError):
                raise InputError(name, getattr(self, name), "numbers") from None
            object.__setattr__(self, name, values)
        check_number("tip_radius", self.tip_radius, 0.0, above=True)
        check_probes(self.probes)
        if self.marks.ndim != 1 or len(self.marks) < 2:
            found = f"of shape {self.marks.shape}"
            raise InputError("marks", found, "two or more increasing times")
        if not np.all(rising := np.diff(self.marks) > 0.0):
            before, after = self.marks[int(np.argmin(rising)) :][:2]
            raise InputError("marks", f"{after:.9g} s after {before:.9g} s", "increasing times")
        check_turns("marks", np.diff(self.marks), self.first)
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
        """True if the speed varies by less than 1 %; else these are arrivals of a run-up."""
        speed = self.speed
        return bool(np.ptp(speed) <= STEADY * speed.mean())

    @cached_property
    def nominal_angle(self) -> np.ndarray:
        """Rotor angle phi + 2 pi n of arrivals without vibration: (revolutions, probes)."""
        turns = self.first + np.arange(len(self))
        return np.asarray(2.0 * np.pi * turns[:, None] + self.probes)

    @cached_property
    def angle(self) -> np.ndarray:
        """Rotor angle alpha at the arrivals: (revolutions, probes) [rad]."""
        turns = self.first + np.arange(len(self.marks))
        return between(self.marks, TURN * turns, self.time)

    @cached_property
    def expected(self) -> np.ndarray:
        """Times at the nominal angles, seen or not: (revolutions, probes) [s]."""
        turns = self.first + np.arange(len(self.marks))
        return between(TURN * turns, self.marks, self.nominal_angle)

    @cached_property
    def displacement(self) -> np.ndarray:
        """Tangential displacement u at the arrivals: (revolutions, probes) [m]."""
        return np.asarray(self.tip_radius * (self.nominal_angle - self.angle))

    @cached_property
    def rounding(self) -> float:
        """Rounding of displacements [m]: of the angles, and 1e-9 of the motion."""
        angle, motion = (float(np.nanmax(np.abs(x))) for x in (self.angle, self.displacement))
        return 1e-9 * motion + 4.0 * float(np.spacing(angle)) * self.tip_radius

    def check_places(self, angle_deviation: float) -> None:
        """Raise InputError where a probe is passed, but for a shift of all of them, nearer to the
        place of another one, or in another revolution: a fit would take that for a vibration; and
        for a standard deviation of the probes' angles [rad] that is none."""
        check_number("angle_deviation", angle_deviation, 0.0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a probe without arrivals
            off = np.nanmedian(self.nominal_angle - self.angle, axis=0)
        off -= np.nanmedian(off)
        late = np.flatnonzero(np.abs(off) > 0.5 * TURN)
        if len(late):
            where = f"those at {np.degrees(self.probes[late[0]]):g} degrees"
            found = f"{where} are of the revolutions {'before' if off[late[0]] > 0.0 else 'after'}"
            raise InputError("time", found, "in the rows of their own revolutions, at all probes")
        apart = np.abs(self.probes - off - self.probes[:, None])  # [said, passed]
        nearest = np.argmin(np.minimum(apart % TURN, -apart % TURN), axis=0)
        wrong = np.flatnonzero(np.isfinite(off) & (nearest != np.arange(len(off))))
        if len(wrong):
            said, passed = np.degrees(self.probes[[wrong[0], nearest[wrong[0]]]])
            found = f"the one at {said:g} degrees is passed where that at {passed:g} degrees is"
            allowed = "where their arrivals are; two are swapped, or times too coarse"
            raise InputError("probes", found, allowed)

    def zeroed(self, begin: int, end: int) -> Self:
        """Return the same with probes at the mean blade tip of the revolutions begin to end - 1,
        counted from 0: displacements are those from there, as of quiet revolutions."""
        quiet = np.nanmedian(self.between(begin, end).displacement[begin:end], axis=0)
        return replace(self, probes=self.probes - quiet / self.tip_radius)

    def between(self, begin: int, end: int) -> Self:
        """Return the arrivals of the revolutions begin to end - 1, counted from 0, alone."""
        check_count("begin", begin, 0)
        check_count("end", end, begin + 1)
        kept = np.zeros(len(self), dtype=bool)
        kept[begin:end] = True
        return replace(self, time=np.where(kept[:, None], self.time, np.nan))

    def without(self, probes: np.ndarray) -> Self:
        """Return the same without some probes (n,), counted from 0."""
        time = np.delete(self.time, probes, axis=1)
        return replace(self, time=time, probes=np.delete(self.probes, probes))

    @classmethod
    def from_csv(cls, path: str | Path, *, tip_radius: float | None = None) -> Self:
        """Read arrivals from a CSV file with these columns, in any order, and any others.

        ``revolution`` (a whole number), ``angle [rad]`` of the probe, ``mark [s]`` and
        ``next_mark [s]`` (begin and end of the revolution), ``arrival [s]``; and ``tip_radius [m]``
        unless it is given here. Other units are converted, as by :func:`read_record`. A row is a
        passage; passages may be missing, revolutions may not. :meth:`to_csv` writes such a file,
        from which the same arrivals are read to the last bit.

        Raises
        ------
        InputError
            The file cannot be read, a column is missing, or rows contradict each other or the
            radius given.
        """
        (turn, angle, mark, after, arrival), radius = _passages(path)
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
        """Return columns, a row for every passage."""
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

    def _title(self) -> str:
        speed, missing = self.speed, int(np.isnan(self.time).sum())
        parts = [counted(len(self), "revolution"), counted(len(self.probes), "probe")]
        steady = np.ptp(speed) <= 1e-6 * speed[0]
        parts.append(f"{speed[0]:.6g}{'' if steady else f' to {speed[-1]:.6g}'} rad/s")
        return ", ".join(parts + [f"{missing} missing"] * (missing > 0))


def between(places: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return values (n,) at rising places (n,), at others between these by cubic splines."""
    from scipy.interpolate import CubicSpline  # takes longer than to read the arrivals

    return np.asarray(CubicSpline(places, values)(at))


def smoothed(values: np.ndarray) -> np.ndarray:
    """Return values (n,) along the revolutions without their errors, by smoothing.

    Quadratics over 2 h + 1 neighbours (Savitzky and Golay, Analytical Chemistry 36, 1964, 1627),
    with h from 0 up of the least risk by Stein's estimate (Annals of Statistics 9, 1981, 1135); the
    variance of the errors is that of the fourth differences.
    """
    if len(values) < FEWEST_REVOLUTIONS:
        return values
    from scipy.signal import savgol_coeffs, savgol_filter

    # Fourth differences of white errors have 70 times their variance; the median of chi^2 is 0.455.
    variance = float(np.median(np.diff(values, 4) ** 2)) / (70.0 * 0.455)
    found, least = values, variance
    for half in 2 ** np.arange(1, int(np.log2(len(values) / 4.0)) + 1):
        tried = savgol_filter(values, 2 * half + 1, 2)
        share = float(savgol_coeffs(2 * half + 1, 2)[half])
        risk = float(np.mean((values - tried) ** 2)) + (2.0 * share - 1.0) * variance
        if risk < least:
            found, least = tried, risk
    return np.asarray(found)


def check_turns(name: str, turns: np.ndarray, first: int = 0) -> None:
    """Raise InputError where the duration of a revolution (n,) [s] is 1.4 times the median of five,
    or less than its part: a mark was missed, or another signal taken for one."""
    five = np.lib.stride_tricks.sliding_window_view(np.pad(turns, 2, mode="symmetric"), 5)
    around = np.median(five, axis=1)
    wrong = np.abs(np.log(turns / around)) > np.log(1.4)
    if np.any(wrong):
        at = int(np.argmax(wrong))
        found = f"revolution {first + at} takes {turns[at] / around[at]:.3g} times as long as those"
        allowed = "marks of which none was missed or seen twice; leave out such rows, but count "
        raise InputError(name, f"{found} around it", f"{allowed}their revolutions")


def check_probes(probes: np.ndarray) -> None:
    """Raise InputError unless probes are angles from 0 to 2 pi, increasing."""
    fit = probes.ndim == 1 and len(probes) > 0 and np.all(np.isfinite(probes))
    if not fit or probes[0] < 0.0 or probes[-1] >= 2.0 * np.pi or np.any(np.diff(probes) <= 0.0):
        raise InputError("probes", probes, "increasing angles [rad] from 0 to less than 2 pi")


def one_radius(path: str | Path, of_file: np.ndarray | None, given: float | None) -> float:
    """Return the radius of the blade tip [m], from a column of a file or given; InputError unless
    it is one."""
    if of_file is None:
        if given is None:
            allowed = f"given for {path}, which has no column '{RADIUS}': {OF_RADIUS}"
            raise InputError("tip_radius", None, allowed)
        return given
    values = np.unique(np.append(of_file, of_file[0] if given is None else given))
    if len(values) > 1:
        allowed = "one number, in all rows" + ("" if given is None else f" {given:g}, as given")
        raise InputError("path", f"{path}, {RADIUS} = {values.tolist()}", allowed)
    return float(values[0])


def _table(path: str | Path) -> tuple[list[str], list[int], np.ndarray]:
    """Return headings of a CSV file, in SI where they name a unit, the numbers of its other lines,
    and its columns, nan where there is no number; lines that begin with # are left out."""
    with reading("path", path, "a table of numbers"):
        (_, names), *rows = table_rows(path) or [(0, [])]
        for number, row in rows:
            if len(row) < len(names):
                allowed = f"a row of {len(names)} cells, as there are headings, not of {len(row)}"
                raise InputError("path", f"{path}, line {number}", allowed)
    headings = [heading_in_si(name) for name in names]
    columns = [[f * _number(row[n]) for _, row in rows] for n, (_, f) in enumerate(headings)]
    table = np.array(columns).reshape(len(names), len(rows))
    return [name for name, _ in headings], [number for number, _ in rows], table


def _number(cell: str) -> float:
    """Return the number in a cell; nan where there is none."""
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _passages(path: str | Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the required columns of a file: (5, rows), and the radii (rows,) if it has them."""
    names, lines, columns = _table(path)
    for name in ARRIVAL_COLUMNS:
        if name not in names:
            has = f"it has {', '.join(names)}" if any(names) else "it is empty"
            raise InputError("path", str(path), f"a file with the column '{name}'; {has}")
    found = columns[[names.index(name) for name in ARRIVAL_COLUMNS]]
    if not lines:
        raise InputError("path", str(path), "a file with rows of numbers below its headings")
    given, turns = np.isfinite(found[:4]).all(axis=0), np.nan_to_num(found[0])
    if not np.all(fine := given & (turns % 1.0 == 0.0) & (np.abs(turns) < 2**53)):
        allowed = "a row of finite numbers but for the arrival, and of a whole revolution"
        raise InputError("path", f"{path}, line {lines[int(np.argmin(fine))]}", allowed)
    return found, columns[names.index(RADIUS)] if RADIUS in names else None


# --- records --------------------------------------------------------------------------------------

PASSAGE = re.compile(r"(?:blade\s*(\d+))?.*?\bprobe\s*(\d+)", re.IGNORECASE)
"""Heading of the arrivals of a blade at a probe; blade 1 where none is named."""
SPEED_UNITS = {"rpm": RPM, "rad/s": 1.0, "Hz": TURN}
ANGLE_UNITS, TIME_UNITS = {"rad": 1.0, "deg": IN_SI["deg"][1]}, {"s": 1.0}
"""Units by what they are in rad/s, rad and s; the first one where a heading has none."""


def read_record(
    path: str | Path,
    *,
    tip_radius: float | None = None,
    probes: Sequence[float] | np.ndarray | Mapping[int, np.ndarray] | None = None,
) -> dict[int, ArrivalTimes]:
    """Read the arrivals of one or more blades, a row for each revolution.

    Columns are known by their headings, in any order, with units in brackets; others, and lines
    that begin with #, are left out. The radius may be in mm, as well; cells are
    separated by commas, semicolons or tabs.

    ``revolution``
        Its number; rows may be missing. Without it they are counted.
    ``speed [rpm]`` (or rad/s, Hz; "shaft speed" too)
        Mean speed of the revolution; or ``mark [s]``, when the mark on the shaft begins it.
    ``blade 2 probe 1 [rad]`` (or deg; "AoA" does no harm)
        Rotor's angle from the mark to the arrival; or ``[s]``, its time (with ``mark [s]``). Empty
        or nan where it was missed; without "blade 2" the file has one blade.
    ``tip_radius [m]``
        Unless it is given here.

    Files of :meth:`ArrivalTimes.from_csv`, a row for each passage, are read as well.

    Parameters
    ----------
    path : str or Path
        The file.
    tip_radius : float [m]
        Distance of the blade tips from the axis.
    probes : (n_probes,) [rad], or a mapping
        Angles of the probes from the blade tip's place at a mark, of each blade by its number where
        they differ. Default: medians of arrivals, so that displacements are those from a place in
        the middle.

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
    names, _, table = _table(path)
    if not any(map(PASSAGE.search, names)):
        return {1: ArrivalTimes.from_csv(path, tip_radius=tip_radius)}
    columns = dict(zip(names, table, strict=True))
    passages: dict[int, dict[int, str]] = {}
    for name in names:
        if found := PASSAGE.search(name):
            passages.setdefault(int(found[1] or 1), {})[int(found[2])] = name
    if len(columns) != len(names):
        raise InputError("path", f"{path}: {', '.join(names)}", "headings, each given once")
    if table.shape[1] < 2:
        given = f"{path}: {counted(table.shape[1], 'revolution')}"
        raise InputError("path", given, "two or more, between which the speed is measured")
    turns = _turns(path, columns.get("revolution", np.arange(float(table.shape[1]))))
    marks = _marks(path, columns, turns)
    tip_radius = one_radius(path, columns.get(RADIUS), tip_radius)
    found_blades = {}
    for blade, headings in sorted(passages.items()):
        seen = np.full((len(marks) - 1, len(headings)), np.nan)
        for place, (_, name) in enumerate(sorted(headings.items())):
            if not np.any(np.isfinite(columns[name])):
                raise InputError("path", f"{path}: {name}", "a column with finite numbers")
            seen[turns - turns[0], place] = _angles(path, name, columns[name], turns, marks)
        angles = probes.get(blade) if isinstance(probes, Mapping) else probes
        own = None if angles is None else np.asarray(angles, dtype=float)
        found_blades[blade] = _arrivals(seen, marks, tip_radius, own, int(turns[0]))
    return found_blades


def has_probe_angles(path: str | Path) -> bool:
    """Return True if a file of arrivals has the angles of its probes."""
    return ARRIVAL_COLUMNS[1] in _table(path)[0]


def probes_of_blades(probes: Sequence[float] | np.ndarray, count: int) -> dict[int, np.ndarray]:
    """Angles of probes from the tip of each of so many blades at the mark, by their numbers from 1,
    in the order of the probes: blade j + 1 is 2 pi / count ahead of blade j [rad]."""
    angles = np.asarray(probes, dtype=float)
    return {blade: (angles - TURN * (blade - 1) / count) % TURN for blade in range(1, count + 1)}


def write_record(
    blades: Mapping[int, ArrivalTimes], path: str | Path, probes: Sequence[float] | np.ndarray
) -> None:
    """Write the arrivals of the blades of a disk as one record, which :func:`read_record` reads: a
    row for each revolution, a column for each blade and probe.

    Parameters
    ----------
    blades : mapping of int to ArrivalTimes
        The blades by their numbers, of the same marks.
    path : str or Path
        The file.
    probes : (n_probes,) [rad]
        Angles of the probes from the first blade's place at a mark, in the order of their numbers.

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
    first = next(iter(blades.values()))
    columns: dict[str, Any] = {
        "revolution": (first.first + np.arange(len(first))).tolist(),
        "mark [s]": first.marks[:-1].tolist(),
    }
    own = probes_of_blades(probes, len(blades))
    for blade, arrivals in blades.items():
        for number, place in enumerate(np.argsort(np.argsort(own[blade])), 1):
            columns[f"blade {blade} probe {number} [s]"] = arrivals.time[:, place].tolist()
    columns[RADIUS] = [first.tip_radius] * len(first)
    Table.of(columns, {}).save(path)


def _unit(path: str | Path, name: str, known: dict[str, float]) -> float:
    """Return the factor of the unit in a heading."""
    unit = re.search(r"\[(.*)\]", name)
    word = unit[1] if unit else next(iter(known))
    if word not in known:
        raise InputError("path", f"{path}: {name}", f"with one of the units {', '.join(known)}")
    return known[word]


def _turns(path: str | Path, column: np.ndarray) -> np.ndarray:
    """Return the numbers of the revolutions (rows,), increasing."""
    whole = np.all(np.isfinite(column)) and not np.any(column % 1.0) and column[0] >= 0.0
    if not whole or np.any(np.diff(column) <= 0.0) or np.ptp(column) > MOST_PASSAGES:
        raise InputError("path", f"{path}: revolution", "increasing whole numbers >= 0")
    return column.astype(int)


def _marks(path: str | Path, columns: dict[str, np.ndarray], turns: np.ndarray) -> np.ndarray:
    """Return the times of the marks of all revolutions, and of the one that ends the last:
    (revolutions + 1,) [s]. Missing ones are interpolated."""
    every = np.arange(turns[0], turns[-1] + 1)
    for name, column in columns.items():
        if re.match("mark", name, re.IGNORECASE):
            column = column * _unit(path, name, TIME_UNITS)
            lasting = np.diff(column) / np.diff(turns)
            if not np.all((lasting > 0.0) & np.isfinite(lasting)):
                raise InputError("path", f"{path}: {name}", "increasing times")
            marks = np.interp(every, turns, column)
            check_turns(f"{path}: {name}", np.diff(marks), int(turns[0]))
            marks = smoothed(marks)
            last = np.diff(marks)[-2:]  # the end of the last revolution, as the speed changes
            return np.append(marks, marks[-1] + 2.0 * last[-1] - last[0])
        if "speed" in name.lower() and not PASSAGE.search(name):
            speed = column * _unit(path, name, SPEED_UNITS)
            if not np.all(speed > 0.0):
                raise InputError("path", f"{path}: {name}", "numbers > 0")
            speed = np.interp(every, turns, speed)
            check_turns(f"{path}: {name}", TURN / speed, int(turns[0]))
            durations = TURN / smoothed(speed)
            return np.concatenate([[0.0], np.cumsum(durations)])
    allowed = "a file with a column 'speed [rpm]' (rad/s, Hz) or 'mark [s]'"
    raise InputError("path", str(path), f"{allowed}; it has {', '.join(columns)}")


def _angles(
    path: str | Path, name: str, column: np.ndarray, turns: np.ndarray, marks: np.ndarray
) -> np.ndarray:
    """Return angles from the mark to the arrivals: (rows,) [rad]."""
    if "[s]" not in name:
        angles = column * _unit(path, name, ANGLE_UNITS)
        if np.nanmedian(np.abs(angles)) > 2.0 * TURN:
            allowed = "angles from the mark to the arrival, in a revolution; in degrees?"
            raise InputError("path", f"{path}: {name} = {np.nanmedian(column):g}", allowed)
        return angles
    every = np.arange(turns[0], turns[0] + len(marks))
    return TURN * (between(marks, every, column) - turns)


def _arrivals(
    seen: np.ndarray, marks: np.ndarray, tip_radius: float, probes: np.ndarray | None, first: int
) -> ArrivalTimes:
    """Return arrivals of a blade by angles from the mark (revolutions, probes) [rad]."""
    for column in seen.T:  # a blade at the mark is seen before it and after it
        column -= TURN * np.round((column - column[np.isfinite(column)][0]) / TURN)
    middle = np.nanmedian(seen, axis=0)
    places = middle % TURN if probes is None else probes
    if len(places) != seen.shape[1]:
        raise InputError("probes", places, f"{seen.shape[1]} angles, as the record has probes")
    order = np.argsort(places)
    rows = np.arange(len(seen))
    for probe, later in enumerate(np.round((middle - places) / TURN).astype(int)):
        # From before its mark, or from after the next one: of another revolution than its row's.
        kept = rows[(rows >= later) & (rows - later < len(rows))]
        angles = seen[kept - later, probe] - TURN * later
        seen[:, probe] = np.nan
        seen[kept, probe] = angles
    seen = seen[:, order]
    turns = first + np.arange(len(marks))
    time = between(TURN * turns, marks, TURN * turns[:-1, None] + seen)
    return ArrivalTimes(time, marks, places[order], tip_radius, first)
