"""Growth of a crack under the vibration of its plate, and the change of the vibration with it.

At each length a the vibration is periodic and settled: growth by a cycle is far less than what
changes it. With the effective ranges of K_I of the vibration itself, closed faces and all,

    da/dN = C sum_i (delta K_i / (1 - R_i)^(1 - gamma))^m,      N = int da / (da/dN),

over the cycles of K_I in one of the load, of which there is more than one where the crack opens
several times; C in m per cycle at 1 MPa m^1/2 (Paris, Erdogan, Journal of Basic Engineering 85,
1963, 528; closure: Elber, ASTM STP 486, 1971, 230; R: Walker, ASTM STP 462, 1970, 1).

Few lengths are solved, and between them are splines; lengths are halved where a spline misses what
is then found. Each round is a sweep: its cases are shared among ranks, and it goes on where it was
killed. Of a solid whose crack is half of an ellipse they are depths and lengths
(:mod:`fenics_crack.fatigue.ellipse`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from mpi4py import MPI

from fenics_crack.basics.errors import ConvergenceError, InputError, StoppedError
from fenics_crack.basics.observables import Place, Where, names_of
from fenics_crack.basics.ranks import StopRequest, on_root
from fenics_crack.basics.report import Report
from fenics_crack.basics.tables import (
    FEW_ROWS,
    TURN,
    Said,
    Table,
    counted,
    hertz_of,
    quantity,
    with_frequency,
)
from fenics_crack.errors.stated import STATED_CAUSES, stated_errors
from fenics_crack.fatigue.ellipse import DRIVING, EllipsePath, EllipseTable, End, grown
from fenics_crack.fem.build import with_crack_length
from fenics_crack.fem.solid import section_ends
from fenics_crack.files.saved import Saved
from fenics_crack.numerics.equations import SMALLEST_NORMAL
from fenics_crack.runs.solve import solve
from fenics_crack.scene.scene import Scene, check_known, without_tips
from fenics_crack.scene.tables import Growth as Law
from fenics_crack.study.plausibility import remarks_on_scene
from fenics_crack.sweep.file import NUMBERED
from fenics_crack.sweep.result import NO_PEAK_SOUGHT, SweepResult, resonates, run_sweep

# --- the result, and its file ---------------------------------------------------------------------

ENDS: dict[End, str] = {
    "reached": "growth.until is reached",
    "arrested": "there it stops: the range falls below growth.threshold, or to nothing",
    "broken": "there it breaks: K_max is growth.toughness",
    "side": "there its ends come near to the sides",
}
"""Descriptions of the end of growth."""


@dataclass(frozen=True, repr=False)
class Growth(Saved):
    """A crack's length over the cycles, and what the vibration does meanwhile.

    Attributes
    ----------
    scene : Scene
        With the length of the crack at the beginning.
    length, cycles, time : (n,) [m], [-], [s]
        Of the crack, the cycles until then, and how long they take; one row where it does not grow.
    omega, omega_open, omega_bilinear : (n,) [rad/s]
        Of the load, the mean of a spectrum, and natural frequencies with the crack open and of the
        breathing crack, of the mode that is nearest to the load, or to that load of a spectrum
        which drives the crack most.
    response : (n,) [m]
        Half the peak-to-peak displacement of the load's point, in the load's direction.
    largest, smallest, effective, sliding : (n,) [Pa m^1/2]
        K_max, K_min, delta_K_effective and K_II_max; the largest of a spectrum, K_min and K_II_max
        of the load that drives most.
    rate : (n,) [m]
        In a cycle; the mean of a spectrum; 0 where the crack is arrested.
    end : "reached", "arrested", "broken" or "side"
        Reason: ``growth.until`` is reached, the range falls below the threshold, K_max reaches the
        toughness, or the ends of a half-ellipse come near to the sides of the solid.
    solved : (k,) [m]
        Lengths that were solved, of a half-ellipse (k, 2) depths and lengths; between them are
        splines.
    errors : dict of str to float
        Relative standard deviations of the cycles by the "rate", the "exponent", the "vibration"
        (mesh, modes and harmonics, where half of the cycles are over; also by what part of a
        spectrum is above the threshold), and by "interpolation" between lengths.
    remarks : tuple of str
        Doubts about the growth.
    depth : (n,) [m] or None
        Of a crack in a solid that is half of an ellipse, or a quarter of one.
    """

    scene: Scene
    length: np.ndarray
    cycles: np.ndarray
    time: np.ndarray
    omega: np.ndarray
    omega_open: np.ndarray
    omega_bilinear: np.ndarray
    response: np.ndarray
    largest: np.ndarray
    smallest: np.ndarray
    effective: np.ndarray
    sliding: np.ndarray
    rate: np.ndarray
    end: End
    solved: np.ndarray
    errors: dict[str, float]
    remarks: tuple[str, ...]
    depth: np.ndarray | None = None

    KIND: ClassVar[str] = "crack growth"
    frequency, frequency_open = hertz_of(), hertz_of("omega_open")
    frequency_bilinear = hertz_of("omega_bilinear")

    @property
    def life(self) -> float:
        """Cycles to the last length."""
        return float(self.cycles[-1])

    @property
    def factor(self) -> float:
        """Factor, > 1, within which the life is known with 68 %: its logarithm is normal."""
        return math.exp(math.hypot(*self.errors.values()))

    @property
    def repeats(self) -> np.ndarray | None:
        """Repeats of the spectrum until then (n,); None without a spectrum."""
        repeat = self.scene.given("growth").repeat
        return None if repeat is None else self.cycles / repeat[0]

    @property
    def frequency_drop(self) -> np.ndarray:
        """Decrease of the breathing crack's natural frequency, relative to the first: (n,) [-]."""
        return np.asarray(1.0 - self.omega_bilinear / self.omega_bilinear[0])

    def at(self, cycles: float) -> float:
        """The crack's length after some cycles [m]; nan beyond the last."""
        return float(np.interp(cycles, self.cycles, self.length, right=math.nan))

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every length."""
        found = {
            "cycles": self.cycles,
            "time": self.time,
            "crack_length": self.length,
            **({} if self.depth is None else {"crack_depth": self.depth}),
            "rate": self.rate,
            "omega": self.omega,
            "omega_open": self.omega_open,
            "omega_bilinear": self.omega_bilinear,
            "frequency_drop": self.frequency_drop,
            "response": self.response,
            "K_max": self.largest,
            "K_min": self.smallest,
            "delta_K_effective": self.effective,
            "K_II_max": self.sliding,
        }
        if self.repeats is not None:
            found = {"repeats": self.repeats} | found
        return with_frequency({name: values.tolist() for name, values in found.items()})

    def said(self) -> Said:
        """What the last sentence on the growth says."""
        first, last = (self._size(end) for end in (0, -1))
        if len(self.length) == 1:
            return Said(f"the crack stays at {first}: {ENDS[self.end]}")
        way = f"from {first} to {last} in {self.life:.4g} cycles ({self.time[-1] / 3600.0:.4g} h)"
        if self.repeats is not None:
            way += f", {self.repeats[-1]:.4g} repeats of the spectrum"
        causes = [f"{name} {error:.2g}" for name, error in self.errors.items() if error > 0.0]
        known = f"the cycles are uncertain by a factor of {self.factor:.3g}"
        known += f", standard deviations of their logarithm: {', '.join(causes)}" if causes else ""
        drop = f"the breathing crack's natural frequency falls by {self.frequency_drop[-1]:.2%}"
        return Said(f"the crack grows {way}: {ENDS[self.end]}", known, others=[drop])

    def _size(self, row: int) -> str:
        length = quantity(float(self.length[row]), "m")
        if self.depth is None:
            return length
        return f"{length} x {quantity(float(self.depth[row]), 'm')} deep"

    def _title(self) -> str:
        ends = f"{self._size(0)} to {self._size(-1)}"
        drop = f"frequency falls by {self.frequency_drop[-1]:.2%}"
        known = f"{self.life:.4g} cycles within a factor of {self.factor:.3g}"
        return f"{ends}, {known}, {self.end}, {drop}, {counted(len(self.solved), 'size')} solved"


def report_of_growth(found: Growth) -> Report:
    """The table, the life and how sure it is."""
    table, count = found.table(), len(found.length)
    places = sorted({*np.linspace(0, count - 1, FEW_ROWS).round().astype(int).tolist()})
    return Report(
        table,
        found.said(),
        found.scene,
        shown=Table(table.columns, [table.rows[place] for place in places]),
        warnings=found.remarks,
        remarks=remarks_on_scene(found.scene),
    )


# --- the growth -----------------------------------------------------------------------------------

NOT_STABLE = "the vibration is unstable or irregular, or its stability undecided"
UNKNOWN_VIBRATION = "the error of the vibration is unknown"
SHAPES, SHAPE_MODES = 5, 20
"""Depths and lengths of half-ellipses, in equal ratios: the cycles to 0.8 % where K is Newman's and
Raju's (tests/fatigue/test_ellipse.py), in equal steps to 6 %; and modes, whose neglect
changes every K by 1e-4."""
WIDEST = 0.9
"""Largest length of a half-ellipse, of what the sides leave."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)
"""Quadrature of the integral over each of the table's steps."""
ROUGH = 0.05
"""Error of ln delta K above which an interval is halved even where few cycles pass in it: the peak
of a resonance that passes is seen."""
LOGARITHMIC_COLUMNS = ("driving", "K_max", "delta_K_effective", "response")
"""Columns whose logarithm is smooth: resonances pass through them."""
LINEAR_COLUMNS = ("omega", "omega_open", "omega_bilinear", "K_min", "K_II_max")
NO_COLUMNS = dict.fromkeys((*LOGARITHMIC_COLUMNS, *LINEAR_COLUMNS), np.zeros(0))
SWEEP_COLUMNS = ("K_max", "delta_K_effective", "delta_K_equivalent", "response", *LINEAR_COLUMNS)
"""Columns of the sweep: those of a spectrum are of the load that drives the crack most."""


def grow(
    scene: Scene,
    folder: str | Path | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    progress: bool = False,
) -> Growth:
    r"""Let the crack of a plate, or of a solid, grow under its vibration (collective).

    By the table ``[growth]`` of the scene: from ``crack.length`` to ``growth.until``,

    .. math:: N = \int \frac{da}{C \sum_i (\Delta K_i / (1 - R_i)^{1 - \gamma})^m},

    :math:`\Delta K_i` the ranges of K_I while the tip is open, in the cycles that rain flow counts
    in one period of the load.

    Few lengths are solved; between them ln delta K is a spline, refined until the cycles are known
    to ``growth.life_tolerance``. Ranks share the lengths. Of a crack through a solid
    :math:`\Delta K_i` is that of the place of its front where it is largest, and the front stays
    straight. One that is half of an ellipse grows from ``crack.depth`` to ``growth.until`` by the
    range at its deepest place, and along the face by the mean of those at its ends: 5 x 5 shapes
    are solved.

    Parameters
    ----------
    scene : Scene
        Of a plate with one crack from an edge, or of a solid with one that is through or half of an
        ellipse, and a table ``[growth]``.
    folder : path, optional
        For the files of what is solved. Where they exist, of the same scene, they are taken: so a
        run that was killed goes on. Default: nothing is kept.
    comm : MPI.Comm
        The ranks.
    progress : bool
        Show bars.

    Returns
    -------
    Growth
        Length, frequencies and stress intensities over the cycles, and how sure the life is.

    Raises
    ------
    InputError
        The scene has no such crack or table, or its crack does not become longer.
    ConvergenceError
        A length cannot be solved.

    Examples
    --------
    >>> keys = {"until": 0.055, "rate": 1e-11, "exponent": 3.0}
    >>> growing = scene.replace({f"growth.{key}": value for key, value in keys.items()})
    >>> fc.grow(growing).life  # doctest: +SKIP
    """
    scene = _checked(with_crack_length(scene, comm))
    law, alone = scene.given("growth"), scene.replace({"curve": None, "sweep": None})
    where = None if folder is None else Path(folder)
    if alone.given("crack").is_elliptical:
        return _grow_ellipse(alone, where, comm, progress=progress)
    _at_size(alone, alone.excitation.omega, law.until)  # is refused before anything is solved
    path, missed, jumps = _solve_lengths(alone, where, comm, progress=progress)
    length, cycles, end = _integrated(path, law)
    half = float(np.interp(0.5 * cycles[-1], cycles, length))
    vibration, without = on_root(comm, lambda: _error_at(alone, path, half))
    rate = _rate(path, law, length)
    errors = _errors(law, rate, cycles, vibration, missed)
    errors["vibration"] += _lost(path, law, length, cycles, vibration)
    seen = {name: path.at(name, length) for name in path.columns}
    for name in LOGARITHMIC_COLUMNS:
        seen[name][seen[name] <= SMALLEST_NORMAL] = 0.0
    rate[-1] *= end != "arrested"
    time = _summed(TURN / seen["omega"], cycles)
    return Growth(
        scene, length, cycles, time, seen["omega"], seen["omega_open"], seen["omega_bilinear"],
        seen["response"], seen["K_max"], seen["K_min"], seen["delta_K_effective"],
        seen["K_II_max"], rate, end, path.lengths, errors,
        (*_remarks(scene, path, jumps, seen, length, vibration, end), *without),
    )  # fmt: skip


def _summed(values: np.ndarray, cycles: np.ndarray) -> np.ndarray:
    """Integral of values (n,) over the cycles until each of them (n,)."""
    return np.append(0.0, np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(cycles)))


def _errors(
    law: Law, rate: np.ndarray, cycles: np.ndarray, vibration: float, missed: float
) -> dict[str, float]:
    """The errors of the cycles by those of the law, of the range and of the interpolation."""
    strength = np.log(np.maximum(rate, SMALLEST_NORMAL) / law.rate) / law.exponent
    mean = float(_summed(strength, cycles)[-1]) / max(float(cycles[-1]), SMALLEST_NORMAL)
    return {
        "rate": law.rate_deviation,
        "exponent": law.exponent_deviation * abs(mean),
        "vibration": law.exponent * vibration,
        "interpolation": missed,
    }


def _checked(scene: Scene) -> Scene:
    """A scene whose crack can grow; InputError where it cannot."""
    check_known(without_tips(scene), "growth", "asked for")
    law, crack = scene.given("growth"), scene.given("crack")
    if scene.mesh.layout != "graded":
        allowed = "'graded' with [growth], which meshes many lengths"
        raise InputError("mesh.layout", scene.mesh.layout, allowed)
    if crack.front == "straight":
        allowed = "'elliptical' with [growth], or a crack through the solid: a rectangle changes"
        raise InputError("crack.front", crack.front, allowed)
    ellipse = crack.is_elliptical
    if scene.cracks or (crack.edge is None and crack.point is None and not ellipse):
        allowed = "one crack from an edge with [growth]: its tip is the one that grows"
        raise InputError("crack", "several tips", allowed)
    if law.drive == "spectrum" and scene.excitation.order is not None:
        allowed = "another one with excitation.order: the speed of the rotor sets the frequency"
        raise InputError("growth.drive", law.drive, allowed)
    if law.drive == "spectrum" and ellipse:
        allowed = "another one with crack.front = 'elliptical': each of its shapes has one load"
        raise InputError("growth.drive", law.drive, allowed)
    if law.drive == "resonance" and not resonates(scene):
        raise InputError("growth.drive", law.drive, f"another one {NO_PEAK_SOUGHT}")
    key, side = ("depth", "thickness") if ellipse else ("length", "width")
    allowed = "given with [growth], and crack.length: these are what changes"
    least, most = crack.given(key, allowed), getattr(scene.geometry, side) or math.inf
    if not least < law.until < most:
        allowed = f"between crack.{key} = {least:g} and geometry.{side} = {most:g}"
        raise InputError("growth.until", law.until, allowed)
    return scene


def _grow_ellipse(
    scene: Scene, folder: Path | None, comm: MPI.Comm, *, progress: bool = False
) -> Growth:
    """The growth of a half-ellipse (collective)."""
    law, crack = scene.given("growth"), scene.given("crack")
    if scene.reduction is None:
        scene = scene.replace({"reduction.method": "massless", "reduction.modes": SHAPE_MODES})
    ends = 1 if crack.edge else 2
    most = on_root(comm, lambda: _longest(scene))
    if crack.given("length") >= most:
        raise InputError("crack.length", crack.length, f"below {most:g} with [growth]: the sides")
    over = {
        "crack.depth": np.geomspace(crack.given("depth"), law.until, SHAPES),
        "crack.length": np.geomspace(crack.given("length"), most, SHAPES),
    }
    file = None if folder is None else folder / "growth_1.h5"
    swept = _swept(scene, over, file, comm, progress=progress)
    table = _of_shapes(swept)
    path = grown(table, law, ends)
    half = int(np.searchsorted(path.cycles, 0.5 * path.cycles[-1]))
    vibration, without = on_root(comm, lambda: _error_of_shape(scene, table, path, half))
    missed = missed_by(table, path, law, ends)
    errors = _errors(law, path.rates.sum(axis=1), path.cycles, vibration, missed)
    seen = {name: table.at(name, path.depth, path.length) for name in table.columns}
    time = _summed(TURN / seen["omega"], path.cycles)
    unsure = int((swept.not_stable & swept.converged).sum())
    said = _not_solved(swept, table, path)
    said += [f"at {counted(unsure, 'shape')} {NOT_STABLE}"] if unsure else []
    said += _turning(seen["K_max"], seen["K_II_max"], path.length)
    said += [] if math.isfinite(vibration) else [UNKNOWN_VIBRATION]
    above = seen["omega"] > seen["omega_bilinear"]
    if law.drive == "frequency" and np.any(above != above[0]):
        said.append(
            f"at a length of {path.length[np.argmax(above != above[0])]:.4g} m the natural "
            "frequency passes that of the load, a resonance between few shapes: the life is not "
            "known, with growth.drive = 'resonance' it is"
        )
    solved = np.stack(np.meshgrid(table.depths, table.lengths, indexing="ij"), axis=-1)
    return Growth(
        scene, path.length, path.cycles, time, seen["omega"], seen["omega_open"],
        seen["omega_bilinear"], seen["response"], seen["K_max"], seen["K_min"],
        seen["delta_K_effective"], seen["K_II_max"], path.rates[:, 1], path.end,
        solved[swept.converged], errors, (*said, *without), path.depth,
    )  # fmt: skip


def _longest(scene: Scene) -> float:
    """Return the largest length of a half-ellipse in the table [m].

    Around a point it is at most that of one which grows three times as fast along the face.
    """
    crack, law, sides = scene.given("crack"), scene.given("growth"), section_ends(scene)
    room = WIDEST * (max(sides) if crack.edge else 2.0 * min(sides))
    longest = crack.given("length") * (law.until / crack.given("depth")) ** 3
    return room if crack.point is None else min(room, longest)


def missed_by(table: EllipseTable, path: EllipsePath, law: Law, ends: int) -> float:
    """Error of the cycles by interpolation, relative to them: every other depth and length changes
    them by several times as much."""
    some = grown(table.coarser(), law, ends).cycles[-1]
    return abs(math.log(some / path.cycles[-1])) / 4.0 if some * path.cycles[-1] > 0.0 else 0.0


def _of_shapes(swept: SweepResult) -> EllipseTable:
    """The table of a sweep over depths and lengths."""
    from scipy.interpolate import RBFInterpolator  # takes a while, and is needed here alone

    depths, lengths = (np.array(axis.values) for axis in swept.axes)
    solved = swept.converged
    if not solved[0, 0] or solved.sum() < SHAPES:
        at, why = swept.failed[0]
        raise ConvergenceError(f"growth, {_shape(swept, at)}: {why}")
    bilinear = [swept[f"omega_bilinear_{number}"][0, 0] for number in NUMBERED]
    mode = NUMBERED[int(np.nanargmin(np.abs(bilinear - swept["omega"][0, 0])))]
    numbered = {f"omega_{kind}": f"omega_{kind}_{mode}" for kind in ("open", "bilinear")}
    names = (*SWEEP_COLUMNS, *names_of(Place.ELLIPSE))
    columns = {name: swept[numbered.get(name, name)].copy() for name in names}
    columns["response"] = np.nan_to_num(columns["response"])  # nan where nothing moves
    places = np.stack(np.meshgrid(np.log(depths), np.log(lengths), indexing="ij"), axis=-1)
    for values in columns.values() if swept.failed else ():
        rest = RBFInterpolator(places[solved], values[solved])(places[~solved])
        values[~solved] = np.maximum(rest, 0.0)
    return EllipseTable(depths, lengths, columns)


def _shape(swept: SweepResult, at: tuple[int, ...]) -> str:
    depth, length = (axis.values[place] for axis, place in zip(swept.axes, at, strict=True))
    return f"a crack {depth:.4g} m deep and {length:.4g} m long"


def _not_solved(swept: SweepResult, table: EllipseTable, path: EllipsePath) -> list[str]:
    """A remark on the shapes that were not solved, away from the path; ConvergenceError where the
    path is next to one."""
    sides = (table.depths, path.depth), (table.lengths, path.length)
    for at, why in swept.failed:
        near = np.full(len(path.depth), fill_value=True)
        for place, (values, along) in zip(at, sides, strict=True):
            low, high = values[max(place - 1, 0)], values[min(place + 1, SHAPES - 1)]
            near &= (low <= along) & (along <= high)
        if np.any(near):
            raise ConvergenceError(f"growth, {_shape(swept, at)}: {why}")
    if not swept.failed:
        return []
    at, why = swept.failed[0]
    count = counted(len(swept.failed), "shape")
    return [f"{count} away from the growth not solved, as {_shape(swept, at)}: {why}"]


def _error_of_shape(
    scene: Scene, table: EllipseTable, path: EllipsePath, row: int
) -> tuple[float, list[str]]:
    """Relative error of the range that grows the crack most at a row of its path, and a remark on
    what it does not have."""
    at = path.depth[row : row + 1], path.length[row : row + 1]
    omega = float(table.at("omega", *at)[0])
    one = _at_size(scene, omega, float(at[1][0]), float(at[0][0]))
    return _error_of(one, DRIVING[int(path.rates[row].argmax())])


def _rate(path: LengthPath, law: Law, lengths: np.ndarray) -> np.ndarray:
    """da/dN [m] at some lengths."""
    in_mega = path.at("driving", lengths) / 1e6  # MPa m^0.5, of which the rate is
    return np.asarray(law.rate * in_mega**law.exponent)


def _integrated(path: LengthPath, law: Law) -> tuple[np.ndarray, np.ndarray, End]:
    """Lengths, the cycles until then, and how it ends."""
    length = np.linspace(path.lengths[0], path.lengths[-1], 200)
    arrested = path.at("delta_K_effective", length) < law.threshold
    arrested |= _rate(path, law, length) == 0.0  # nothing opens it
    broken = path.at("K_max", length) >= (law.toughness or math.inf)
    over = np.flatnonzero(arrested | broken)
    end: End = "reached"
    if len(over):
        end = "arrested" if arrested[over[0]] else "broken"
        length = length[: int(over[0]) + 1]
    half = 0.5 * np.diff(length)[:, None]
    places = length[:-1, None] + half * (1.0 + NODES)
    steps = np.sum(half * WEIGHTS / _rate(path, law, places.ravel()).reshape(places.shape), axis=1)
    return length, np.append(0.0, np.cumsum(steps)), end


def _at_size(scene: Scene, omega: float, length: float, depth: float | None = None) -> Scene:
    """A scene, without a curve or a sweep, with another crack length [m], and depth, at a load
    frequency [rad/s], which replaces an engine order, with the ranges that drive growth as
    quantities."""
    place = {"crack.length": length, "excitation.omega": omega}
    asked = names_of(Place.TIPS if depth is None else Place.ELLIPSE, where=Where.GROWING)
    deep = {} if depth is None else {"crack.depth": depth}
    return scene.replace(place | deep | {"output.quantities": asked})


def _error_at(scene: Scene, path: LengthPath, length: float) -> tuple[float, list[str]]:
    """Relative error of the effective range by mesh, modes and harmonics at a length; and a remark
    on what it does not have."""
    omega = float(path.at("omega", np.array([length]))[0])
    if scene.given("growth").drive == "spectrum":
        omega = float(path.leading[np.abs(path.lengths - length).argmin()])
    return _error_of(_at_size(scene, omega, length), "delta_K_equivalent")


def _error_of(scene: Scene, name: str) -> tuple[float, list[str]]:
    """The same of a number of a scene."""
    run = solve(scene, MPI.COMM_SELF)
    causes = [cause for cause in STATED_CAUSES if cause != "friction"]
    of_peak = scene.given("growth").drive == "resonance"
    stated = stated_errors(run, run.result, of_peak=of_peak, causes=causes)
    without = [f"vibration: {stated.left_out}"] if stated.left_out else []
    return stated.stated(name)[0], without


def _lost(
    path: LengthPath, law: Law, length: np.ndarray, cycles: np.ndarray, error: float
) -> float:
    """Return the rise of ln N, beside the power of the exponent, if all ranges are smaller by a
    relative error: more of a spectrum is below the threshold then."""
    above = law.drive == "spectrum" and law.threshold and cycles[-1] > 0.0
    if not (above and 0.0 < error < 1.0):
        return 0.0
    higher = replace(law, threshold=law.threshold / (1.0 - error))
    less = LengthPath(np.zeros(0), NO_COLUMNS, ())
    for table in path.tables:
        less = less.joined(table, higher, _levels(law)[1])
    middle = 0.5 * (length[1:] + length[:-1])
    ratio = path.at("driving", middle) / less.at("driving", middle)
    return math.log(float(np.average(ratio**law.exponent, weights=np.diff(cycles))))


def _remarks(
    scene: Scene,
    path: LengthPath,
    jumps: list[float],
    seen: Mapping[str, np.ndarray],
    length: np.ndarray,
    vibration: float,
    end: str,
) -> list[str]:
    """Return the remarks that cast doubt on a crack's growth."""
    remarks = _turning(seen["K_max"], seen["K_II_max"], length)
    law = scene.given("growth")
    passed = (path.not_stable, jumps)
    unsure, jumps = ([at for at in places if at <= length[-1]] for places in passed)
    if unsure:
        count = counted(len(unsure), "length")
        remarks.append(f"at {count} {NOT_STABLE}")
    if jumps:
        remarks.append(
            f"near {jumps[0]:.4g} m the stress intensity jumps: several vibrations may be "
            "possible there, of which growth takes the one that is found first; a curve shows them"
        )
    remarks += [f"a crack of {at:.4g} m was not solved: {why}" for at, why in path.failed]
    # A crack that is arrested on its way has been at its threshold, however well that is known.
    near = np.abs(seen["delta_K_effective"] - law.threshold) < vibration * law.threshold
    if np.any(near) and (end != "arrested" or len(length) == 1):
        remarks.append(
            f"at {length[np.argmax(near)]:.4g} m the effective range is growth.threshold within "
            f"its error of {vibration:.1%}: whether the crack grows there is not known"
        )
    if not math.isfinite(vibration):
        remarks.append(UNKNOWN_VIBRATION)
    return remarks


def _turning(largest: np.ndarray, two: np.ndarray, length: np.ndarray) -> list[str]:
    """A remark where a crack would turn, by K_max and K_II_max at its lengths."""
    one = np.maximum(largest, SMALLEST_NORMAL)
    turn = 2.0 * np.arctan(2.0 * two / (one + np.sqrt(one**2 + 8.0 * two**2)))
    if not np.any(turning := turn > math.radians(10.0)):
        return []
    return [
        f"from {length[np.argmax(turning)]:.4g} m on a straight crack is no longer right: it would "
        f"turn by up to {math.degrees(turn.max()):.0f} degrees, K_II_max being up to "
        f"{np.max(two / one):.0%} of K_max"
    ]


# --- numbers over the length ----------------------------------------------------------------------


@dataclass(frozen=True)
class LengthPath:
    """Columns of a sweep over the crack's length, and splines through them.

    Attributes
    ----------
    lengths : (k,) [m]
        Ascending.
    columns : dict of str to (k,)
        The :data:`LOGARITHMIC_COLUMNS` and the linear ones.
    tables : tuple of SweepResult
        Of which they are.
    leading : (k,) [rad/s]
        Load frequencies at which most of the growth happens.
    mode : int or None
        Whose natural frequencies the columns have, from 1: the nearest to the leading load of the
        first length; None before there is one.
    """

    lengths: np.ndarray
    columns: dict[str, np.ndarray]
    tables: tuple[SweepResult, ...]
    leading: np.ndarray = field(default_factory=lambda: np.zeros(0))
    mode: int | None = None

    @property
    def failed(self) -> list[tuple[float, str]]:
        """Lengths [m] that were not solved, and why."""
        found = {t.axes[0].values[at[0]]: why for t in self.tables for at, why in t.failed}
        return list(found.items())

    @property
    def not_stable(self) -> list[float]:
        """Lengths [m] at which the vibration is unstable, irregular or undecided."""
        cases = ((t, at) for t in self.tables for at in np.argwhere(t.not_stable & t.converged))
        return list(dict.fromkeys(t.axes[0].values[at[0]] for t, at in cases))

    def at(self, name: str, lengths: np.ndarray) -> np.ndarray:
        """A column at any lengths within."""
        from scipy.interpolate import CubicSpline  # takes a while, and is needed here alone

        values = self.columns[name]
        if name not in LOGARITHMIC_COLUMNS:
            return np.asarray(CubicSpline(self.lengths, values)(lengths))
        floor = 1e-4 * max(float(values.max()), SMALLEST_NORMAL)  # closed cracks
        spline = CubicSpline(self.lengths, np.log(np.maximum(values, floor)))
        return np.asarray(np.exp(spline(lengths)))

    def joined(self, table: SweepResult, law: Law, cycles: np.ndarray) -> LengthPath:
        """With the cases of one more sweep, over lengths and the levels of a spectrum, each of
        which has so many cycles."""
        swept = np.array(table.axes[0].values)
        solved = table.converged.reshape(len(swept), -1).all(axis=1)

        def of_lengths(name: str) -> np.ndarray:
            return table[name].reshape(len(swept), -1)[solved]

        lengths = np.append(self.lengths, swept[solved])
        order = np.argsort(lengths)
        rows = {name: of_lengths(name) for name in SWEEP_COLUMNS}
        rows["response"] = np.nan_to_num(rows["response"])  # nan where nothing moves
        new, leading = _driving(rows, law, cycles)
        mode = self.mode  # that of the first length, whichever is nearest later on
        if mode is None and solved.any():
            bilinear = [of_lengths(f"omega_bilinear_{number}")[0, 0] for number in NUMBERED]
            mode = NUMBERED[int(np.nanargmin(np.abs(bilinear - leading[0])))]
        if mode is not None:
            for name in ("omega_open", "omega_bilinear"):
                new[name] = of_lengths(f"{name}_{mode}")[:, 0]
        columns = {name: np.append(old, new[name])[order] for name, old in self.columns.items()}
        return replace(
            self,
            lengths=lengths[order],
            columns=columns,
            leading=np.append(self.leading, leading)[order],
            tables=(*self.tables, table),
            mode=mode,
        )


def _driving(
    rows: dict[str, np.ndarray], law: Law, cycles: np.ndarray
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Columns of lengths, and their leading frequencies, from those of their levels (k, levels).

    What drives the crack is the range of constant amplitude that makes it grow as much,

        (sum n_i delta K_i^m / sum n_i)^(1 / m)

    of the equivalent ranges, levels below the threshold left out where another is above it."""
    effective, drive = rows["delta_K_effective"], rows["delta_K_equivalent"]
    found = {name: rows[name].max(axis=1) for name in ("K_max", "delta_K_effective")}
    limit = np.minimum(law.threshold, found["delta_K_effective"])[:, None]
    largest = np.maximum(drive.max(axis=1, keepdims=True), SMALLEST_NORMAL)
    grown = (effective >= limit) * (drive / largest) ** law.exponent
    shares = cycles / cycles.sum() * grown
    place = shares.argmax(axis=1)[:, None]
    of_place = {name: np.take_along_axis(rows[name], place, axis=1)[:, 0] for name in rows}
    leading = of_place["omega"]
    found["driving"] = largest[:, 0] * shares.sum(axis=1) ** (1.0 / law.exponent)
    found["omega"] = cycles.sum() / (cycles / rows["omega"]).sum(axis=1)
    return of_place | found, leading


def _solve_lengths(
    scene: Scene, folder: Path | None, comm: MPI.Comm, *, progress: bool = False
) -> tuple[LengthPath, float, list[float]]:
    """Solve a scene at lengths from its crack's to its growth's, until the cycles are known to
    ``growth.life_tolerance``; the error of the cycles by interpolation, relative to them; and the
    lengths [m] at which the spline of ln delta K misses by more than :data:`ROUGH`, however close
    they are, the steepest first (collective). A folder keeps the sweeps, one for each round.

    Raises
    ------
    ConvergenceError
        Ctrl-C has stopped it, or too few lengths were solved.
    """
    law = scene.given("growth")
    start, stop = scene.given("crack").length, law.until
    levels, cycles = _levels(law)
    # Five are the fewest of which a spline through every other one can be made.
    wanted, missed, own = np.linspace(start, stop, 5), np.inf, np.zeros(0)
    path = LengthPath(np.zeros(0), NO_COLUMNS, ())
    for number in range(1, 7):  # 129 lengths are as close as meshes are similar
        file = None if folder is None else folder / f"growth_{number}.h5"
        over = {"crack.length": wanted} | ({"excitation.omega": levels} if len(levels) else {})
        table = _swept(scene, over, file, comm, progress=progress)
        before, path = path, path.joined(table, law, cycles)
        if number == 1:
            if path.failed:
                at, why = path.failed[0]
                raise ConvergenceError(f"growth, a crack of {at:.4g} m: {why}")
            few = {name: values[::2] for name, values in path.columns.items()}
            before, own = LengthPath(path.lengths[::2], few, ()), np.zeros(len(path.lengths) // 2)
        own = _missed(before, path, own)
        length, passed, _ = _integrated(path, law)
        steps = np.diff(np.interp(path.lengths, length, passed))
        shares = law.exponent * own * steps / max(float(steps.sum()), SMALLEST_NORMAL)
        missed = float(shares.sum())
        left = (shares > law.life_tolerance / len(shares)) & (missed > law.life_tolerance)
        wanted = (0.5 * (path.lengths[1:] + path.lengths[:-1]))[left | (own > ROUGH)]
        wanted = wanted[~np.isin(wanted, [at for at, _ in path.failed])]
        if not len(wanted):
            break
    sharpest = np.argsort(-own / np.diff(path.lengths))
    rough = path.lengths[:-1][sharpest[own[sharpest] > ROUGH]]
    return path, missed, rough.tolist()


def _levels(law: Law) -> tuple[np.ndarray, np.ndarray]:
    """Load frequencies [rad/s] of a spectrum, none without one, and the cycles of each."""
    if law.frequencies is None:
        return np.zeros(0), np.ones(1)
    return TURN * np.array(law.frequencies), np.array(law.cycles)


def _swept(
    scene: Scene,
    over: dict[str, np.ndarray],
    file: Path | None,
    comm: MPI.Comm,
    *,
    progress: bool = False,
) -> SweepResult:
    """A sweep of the scene over sizes of its crack, and the levels of a spectrum (collective)."""
    resonant = scene.given("growth").drive == "resonance"
    swept = {key: values.tolist() for key, values in over.items()}
    table = {"sweep.over": swept, "sweep.at_resonance": resonant}
    places = (Place.TIPS, Place.ELLIPSE) if "crack.depth" in over else (Place.TIPS,)
    asked = names_of(*places, without=Where.SOLID)
    with StopRequest() as stop:
        found = run_sweep(
            scene.replace({**table, "output.quantities": asked}),
            file, comm, progress=progress, judged=False,
        )  # fmt: skip
    if stop.asked(comm):
        raise StoppedError("growth was stopped; the same command goes on with it")
    return found


def _missed(before: LengthPath, path: LengthPath, missed: np.ndarray) -> np.ndarray:
    """Return the error of the spline's ln delta K on each interval between lengths: (k - 1,).

    Of new intervals it is what the spline before missed at their ends. Of the others it is what it
    was, or how far both splines are apart in their middle, if that is more: a resonance that passes
    within shows around it, too.
    """

    def apart(lengths: np.ndarray) -> np.ndarray:
        here, there = (one.at("driving", lengths) for one in (path, before))
        return np.abs(np.log(here / there))

    # Halved, a spline's error falls by 16, and here by 4 at least.
    at_ends, new = apart(path.lengths) / 4.0, ~np.isin(path.lengths, before.lengths)
    middle = 0.5 * (path.lengths[1:] + path.lengths[:-1])
    known = missed[np.searchsorted(before.lengths, middle) - 1]
    old = np.maximum(known, apart(middle))
    return np.where(new[1:] | new[:-1], np.maximum(at_ends[1:], at_ends[:-1]), old)
