"""Measured tip-timing records, as data systems write them: a row for each revolution.

Of each revolution such a table has the rotor's speed, or the time of the mark that begins it, and
for each blade and probe the angle of arrival or its time. A passage that was missed is an empty
cell. Where the probes stand is often not known: their zero is then the median arrival.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fenics_crack.arrivals.arrival_times import (
    MOST_PASSAGES,
    RADIUS,
    ArrivalTimes,
    one_radius,
    smoothed,
)
from fenics_crack.errors import InputError, reading
from fenics_crack.outside import text_of
from fenics_crack.table import RPM, TURN

__all__ = ["read_record"]

PASSAGE = re.compile(r"(?:blade\s*(\d+))?.*?\bprobe\s*(\d+)", re.IGNORECASE)
"""Heading of what a probe sees of a blade; 1 where no blade is named."""
SPEEDS = {"rpm": RPM, "rad/s": 1.0, "Hz": TURN}
ANGLES = {"rad": 1.0, "deg": np.pi / 180.0}
"""Units by what they are in rad/s and rad; the first one where a heading has none."""
HAS = (
    "a file with a column 'speed [rpm]' (rad/s, Hz) or 'mark [s]', and columns 'probe 1 [rad]' "
    "(deg, s) or 'blade 1 probe 1 [rad]'"
)


def read_record(
    path: str | Path,
    *,
    tip_radius: float | None = None,
    probes: Sequence[float] | np.ndarray | None = None,
) -> dict[int, ArrivalTimes]:
    """Read the arrivals of one or more blades, a row for each revolution.

    Columns are known by their headings, in any order, with units in brackets; others, and lines
    that begin with #, are left out.

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
        Distance of the tips from the axis.
    probes : (n_probes,) [rad]
        Angles of the probes from the tip's place at a mark. Default: the medians of the arrivals,
        so that displacements are those from a place in the middle.

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
    with reading("path", path, "a table of numbers"):
        lines = [line for line in text_of(path).splitlines() if line.strip()[:1] not in ("", "#")]
        names = [name.strip() for name in next(csv.reader(lines), [])]
        if not any(map(PASSAGE.search, names)):
            return {1: ArrivalTimes.from_csv(path, tip_radius=tip_radius)}
        table = np.genfromtxt(lines[1:], delimiter=",", ndmin=2) if lines[1:] else np.empty((0, 1))
    columns = dict(zip(names, table.T, strict=False))
    passages: dict[int, dict[int, str]] = {}
    for name in names:
        if found := PASSAGE.search(name):
            passages.setdefault(int(found[1] or 1), {})[int(found[2])] = name
    if len(columns) != len(names) or len(table) < 2:
        raise InputError("path", str(path), f"{HAS}; it has {', '.join(names)}")
    turns = _turns(path, columns.get("revolution", np.arange(float(len(table)))))
    marks = _marks(path, columns, turns)
    tip_radius = one_radius(path, columns.get(RADIUS), tip_radius)
    found_blades = {}
    for blade, headings in sorted(passages.items()):
        seen = np.full((len(marks) - 1, len(headings)), np.nan)
        for place, (_, name) in enumerate(sorted(headings.items())):
            if not np.any(np.isfinite(columns[name])):
                raise InputError("path", f"{path}: {name}", "a column with finite numbers")
            seen[turns - turns[0], place] = _angles(path, name, columns[name], turns, marks)
        found_blades[blade] = _arrivals(seen, marks, tip_radius, probes, int(turns[0]))
    return found_blades


def _unit(path: str | Path, name: str, known: dict[str, float]) -> float:
    """What the unit in a heading is worth."""
    unit = re.search(r"\[(.*)\]", name)
    word = unit[1] if unit else next(iter(known))
    if word not in known:
        raise InputError("path", f"{path}: {name}", f"with one of the units {', '.join(known)}")
    return known[word]


def _turns(path: str | Path, column: np.ndarray) -> np.ndarray:
    """Numbers of the revolutions (rows,), increasing."""
    whole = np.all(np.isfinite(column)) and not np.any(column % 1.0) and column[0] >= 0.0
    if not whole or np.any(np.diff(column) <= 0.0) or np.ptp(column) > MOST_PASSAGES:
        raise InputError("path", f"{path}: revolution", "increasing whole numbers >= 0")
    return column.astype(int)


def _marks(path: str | Path, columns: dict[str, np.ndarray], turns: np.ndarray) -> np.ndarray:
    """Times of the marks of all revolutions, and of the one that ends the last: (revolutions + 1,)
    [s]. Those of revolutions that are missing lie between, at a speed that changes evenly."""
    every = np.arange(turns[0], turns[-1] + 1)
    for name, column in columns.items():
        if re.match("mark", name, re.IGNORECASE):
            ends = np.append(turns, turns[-1] + 1), np.append(column, 2 * column[-1] - column[-2])
            return smoothed(np.interp(np.append(every, every[-1] + 1), *ends))
        if "speed" in name.lower() and not PASSAGE.search(name):
            speed = column * _unit(path, name, SPEEDS)
            if not np.all(speed > 0.0):
                raise InputError("path", f"{path}: {name}", "numbers > 0")
            durations = TURN / smoothed(np.interp(every, turns, speed))
            return np.concatenate([[0.0], np.cumsum(durations)])
    raise InputError("path", str(path), f"{HAS}; it has {', '.join(columns)}")


def _angles(
    path: str | Path, name: str, column: np.ndarray, turns: np.ndarray, marks: np.ndarray
) -> np.ndarray:
    """Angles from the mark to the arrivals: (rows,) [rad]."""
    if "[s]" not in name:
        return column * _unit(path, name, ANGLES)
    from scipy.interpolate import CubicSpline

    every = np.arange(turns[0], turns[0] + len(marks))
    return np.asarray(TURN * (CubicSpline(marks, every)(column) - turns))


def _arrivals(
    seen: np.ndarray,
    marks: np.ndarray,
    tip_radius: float,
    probes: Sequence[float] | np.ndarray | None,
    first: int,
) -> ArrivalTimes:
    """Arrivals of a blade from angles from the mark (revolutions, probes) [rad]."""
    from scipy.interpolate import CubicSpline

    for column in seen.T:  # a blade at the mark is seen before it and after it
        column -= TURN * np.round((column - column[np.isfinite(column)][0]) / TURN)
    places = (
        np.nanmedian(seen, axis=0) % TURN if probes is None else np.asarray(probes, dtype=float)
    )
    if len(places) != seen.shape[1]:
        raise InputError("probes", places, f"{seen.shape[1]} angles, as the record has probes")
    order = np.argsort(places)
    seen = (seen - TURN * np.round((seen - places) / TURN))[:, order]
    turns = first + np.arange(len(marks))
    time = CubicSpline(TURN * turns, marks)(TURN * turns[:-1, None] + seen)
    return ArrivalTimes(time, marks, places[order], tip_radius, first)
