"""Growth of a crack under the vibration of its plate, and the change of the vibration with it.

At each length a the vibration is periodic and settled: growth by a cycle is far less than what
changes it. With the effective ranges of K_I of the vibration itself, closed faces and all,

    da/dN = C sum_i (delta K_i / (1 - R_i)^(1 - gamma))^m,      N = int da / (da/dN),

over the cycles of K_I in one of the load, of which there is more than one where the crack opens
several times; C in m per cycle at 1 MPa m^1/2 (Paris, Erdogan, Journal of Basic Engineering 85,
1963, 528; closure: Elber, ASTM STP 486, 1971, 230; R: Walker, ASTM STP 462, 1970, 1).

Few lengths are solved, and between them are splines; lengths are halved where a spline misses what
is then found. Each round is a sweep: its cases are shared among ranks, and it goes on where it was
killed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from mpi4py import MPI

from fenics_crack.basics.errors import FEW_MODES, ConvergenceError, InputError, StoppedError
from fenics_crack.basics.ranks import StopRequest, on_root
from fenics_crack.basics.suggestions import checked_call
from fenics_crack.basics.tables import OF_GROWTH, OF_TIPS, TURN, Tabular, counted, with_frequency
from fenics_crack.fem.build import with_crack_length
from fenics_crack.files.store import Stored, check_shapes, read, write
from fenics_crack.model.modes import solve_modes
from fenics_crack.scene.scene import Scene, check_known, without_tips
from fenics_crack.scene.tables import Growth as Law
from fenics_crack.study.plausibility import damping_ratios
from fenics_crack.study.prepare import prepare, reduction_of
from fenics_crack.study.run import solve
from fenics_crack.study.stated_errors import stated_errors
from fenics_crack.sweep.file import NUMBERED
from fenics_crack.sweep.result import UNSOUGHT, SweepResult, resonates, run_sweep

# --- the result, and its file ---------------------------------------------------------------------

ENDS = {
    "reached": "the requested length is reached",
    "arrested": "there it stops: the range falls below growth.threshold, or to nothing",
    "broken": "there the plate breaks: K_max is growth.toughness",
}
"""Descriptions of the end of growth."""


@dataclass(frozen=True, repr=False)
class Growth(Tabular):
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
    end : "reached", "arrested" or "broken"
        Reason: the requested length is reached, the range falls below the threshold, or
        K_max reaches the toughness.
    solved : (k,) [m]
        Lengths that were solved; between them are splines.
    errors : dict of str to float
        Relative standard deviations of the cycles by the "rate", the "exponent", the "vibration"
        (mesh, modes and harmonics, where half of the cycles are over; also by what part of a
        spectrum is above the threshold), and by "interpolation", between lengths and in a run-up.
    remarks : tuple of str
        Doubts about the growth.
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
    end: str
    solved: np.ndarray
    errors: dict[str, float]
    remarks: tuple[str, ...]

    KIND: ClassVar[str] = "crack growth"

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
        """Run-ups, or repeats of the spectrum, until then (n,); None without a spectrum."""
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

    def _title(self) -> str:
        ends = f"{self.length[0]:.4g} to {self.length[-1]:.4g} m"
        drop = f"frequency falls by {self.frequency_drop[-1]:.2%}"
        known = f"{self.life:.4g} cycles within a factor of {self.factor:.3g}"
        return f"{ends}, {known}, {self.end}, {drop}, {counted(len(self.solved), 'length')} solved"

    # --- its file ---------------------------------------------------------------------------------

    @checked_call
    def save(self, path: str | Path, comm: MPI.Comm = MPI.COMM_SELF) -> None:
        """Write a file that :meth:`load`, ``fenics-crack plot`` and ``report`` read (collective).

        Raises
        ------
        InputError
            The file cannot be written.
        """
        parts = {name: getattr(self, name) for name in _ARRAYS} | {"end": self.end}
        words = {name: json.dumps(getattr(self, name)) for name in ("errors", "remarks")}
        write(parts | words, path, self.KIND, self.scene, comm)

    @classmethod
    def load(cls, path: str | Path) -> Growth:
        """Read a file of :meth:`save`; nothing is computed.

        Raises
        ------
        InputError
            The file cannot be read, is damaged, or is of something else.
        """
        return cls.of(read(path))

    @classmethod
    def of(cls, stored: Stored) -> Growth:
        """The same of a file that has been read."""
        with stored.taken() as parts:
            scene, end = stored.scene(), str(parts["end"])
            if stored.kind != cls.KIND or scene is None or scene.growth is None or end not in ENDS:
                raise InputError("path", str(stored.path), f"a file of {cls.KIND}")
            check_shapes(parts, dict.fromkeys(_ARRAYS, (len(parts["length"]),)) | {"solved": (-1,)})
            arrays = {name: np.asarray(parts[name], dtype=float) for name in _ARRAYS}
            errors = {str(name): float(e) for name, e in json.loads(parts["errors"]).items()}
            remarks = tuple(map(str, json.loads(parts["remarks"])))
            return cls(scene, end=end, errors=errors, remarks=remarks, **arrays)


_ARRAYS = [field.name for field in fields(Growth) if field.type == "np.ndarray"]


# --- the growth -----------------------------------------------------------------------------------

POINTS = 200
"""Lengths of the table."""
MEGA = 1e6
"""Pa m^1/2 in which rates are measured."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)
"""Quadrature of the integral over each of the table's steps."""
TURNS_ASIDE = math.radians(10.0)
"""Angle [rad] above which a remark says that a crack does not grow straight on."""
FIRST = 5
"""Lengths of the first round, the fewest that a spline and every other one of them need."""
ROUNDS = 6
"""Maximum rounds in which an interval is halved: these 129 lengths are as close as meshes are
similar."""
REDUCED = 4.0
"""Minimum factor by which an interval's error falls when it is halved; a spline's falls by 16."""
ROUGH = 0.05
"""Error of ln delta K above which an interval is halved even where few cycles pass in it: the peak
of a resonance that passes is seen."""
LOGARITHMIC = ("driving", "coarser", "K_max", "delta_K_effective", "response")
"""Columns whose logarithm is smooth: resonances pass through them."""
LINEAR = ("omega", "omega_open", "omega_bilinear", "K_min", "K_II_max")
NO_COLUMNS = dict.fromkeys((*LOGARITHMIC, *LINEAR), np.zeros(0))
READ = ("K_max", "delta_K_effective", "delta_K_equivalent", "response", *LINEAR)
"""Columns of the sweep: those of a spectrum are of the load that drives the crack most."""
NOTHING = 1e-200
"""Value below which a logarithmic column is zero."""
LEAST = 1e-4
"""Fraction of its largest value below which a logarithmic column counts as that: closed cracks."""
SLICES = 16
"""Slices of the range around a level of a run-up."""
TOP = 1.12
"""Largest range between two levels of a run-up over the larger one of theirs: of a resonance in
their middle, half of its half width from both."""
SETTLES = 2.0
"""Minimum time, in 1 / (xi w), in which the run-up of a single mode passes the width 2 xi f: its
growth with m = 3 is then 3 % below the steady one's."""


def grow(
    scene: Scene,
    folder: str | Path | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    progress: bool = False,
) -> Growth:
    r"""Let the edge crack of a plate grow under its vibration (collective).

    By the table ``[growth]`` of the scene: from ``crack.length`` to ``growth.until``,

    .. math:: N = \int \frac{da}{C \sum_i (\Delta K_i / (1 - R_i)^{1 - \gamma})^m},

    :math:`\Delta K_i` the ranges of K_I while the tip is open, in the cycles that rain flow counts
    in one period of the load.

    Few lengths are solved; between them ln delta K is a spline, refined until the cycles are known
    to ``growth.life_tolerance``. Ranks share the lengths.

    Parameters
    ----------
    scene : Scene
        Of a plate with one crack from an edge, and a table ``[growth]``.
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
    _at_length(alone, law.until, alone.excitation.omega)  # is refused before anything is solved
    where = None if folder is None else Path(folder)
    path, missed = _solve_lengths(alone, where, comm, progress=progress)
    length, cycles, end = _integrated(path, law)
    half = float(np.interp(0.5 * cycles[-1], cycles, length))
    vibration, without = on_root(comm, lambda: _error_at(alone, path, half))
    strength = np.log(path.at("driving", length) / MEGA)
    over = np.diff(cycles)
    weights = _trapezoid(cycles) if cycles[-1] > 0.0 else None
    mean = abs(float(np.average(strength, weights=weights)))
    of_levels = _longer(path, path.columns["coarser"], law, length, cycles) / REDUCED
    errors = {
        "rate": law.rate_deviation,
        "exponent": law.exponent_deviation * mean,
        "vibration": law.exponent * vibration + _lost(path, law, length, cycles, vibration),
        "interpolation": math.hypot(missed, of_levels),
    }
    seen = {name: path.at(name, length) for name in path.columns}
    for name in LOGARITHMIC:
        seen[name][seen[name] <= NOTHING] = 0.0
    pace, rate = TURN / seen["omega"], _rate(path, law, length)
    rate[-1] *= end != "arrested"
    time = np.append(0.0, np.cumsum(0.5 * (pace[1:] + pace[:-1]) * over))
    return Growth(
        scene, length, cycles, time, seen["omega"], seen["omega_open"], seen["omega_bilinear"],
        seen["response"], seen["K_max"], seen["K_min"], seen["delta_K_effective"],
        seen["K_II_max"], rate, end, path.lengths, errors,
        (*_remarks(scene, path, seen, length, vibration, end), *without),
    )  # fmt: skip


def _trapezoid(places: np.ndarray) -> np.ndarray:
    """Weights (n,) of an integral by the trapezoidal rule, of values at some places."""
    steps = np.diff(places)
    return np.asarray(0.5 * (np.append(steps, 0.0) + np.append(0.0, steps)))


def _checked(scene: Scene) -> Scene:
    """A scene whose crack can grow; InputError where it cannot."""
    check_known(without_tips(scene), "growth", "asked for")
    law, crack = scene.given("growth"), scene.given("crack")
    if scene.mesh.layout != "graded":
        allowed = "'graded' with [growth], which meshes many lengths"
        raise InputError("mesh.layout", scene.mesh.layout, allowed)
    if scene.cracks or crack.edge is None:
        allowed = "one crack from an edge with [growth]: its tip is the one that grows"
        raise InputError("crack", "several tips", allowed)
    if law.drive == "spectrum" and scene.excitation.order is not None:
        allowed = "another one with excitation.order: the speed of the rotor sets the frequency"
        raise InputError("growth.drive", law.drive, allowed)
    if law.drive == "resonance" and not resonates(scene):
        raise InputError("growth.drive", law.drive, f"another one {UNSOUGHT}")
    width = scene.geometry.sides[0]
    if not crack.length < law.until < width:
        allowed = f"between crack.length = {crack.length:g} and geometry.width = {width:g}"
        raise InputError("growth.until", law.until, allowed)
    return scene


def _rate(path: LengthPath, law: Law, lengths: np.ndarray) -> np.ndarray:
    """da/dN [m] at some lengths."""
    return np.asarray(law.rate * (path.at("driving", lengths) / MEGA) ** law.exponent)


def _integrated(path: LengthPath, law: Law) -> tuple[np.ndarray, np.ndarray, str]:
    """Lengths, the cycles until then, and how it ends."""
    length = np.linspace(path.lengths[0], path.lengths[-1], POINTS)
    arrested = path.at("delta_K_effective", length) < law.threshold
    arrested |= _rate(path, law, length) == 0.0  # nothing opens it
    broken = path.at("K_max", length) >= (law.toughness or math.inf)
    over = np.flatnonzero(arrested | broken)
    end = "reached"
    if len(over):
        end = "arrested" if arrested[over[0]] else "broken"
        length = length[: int(over[0]) + 1]
    half = 0.5 * np.diff(length)[:, None]
    places = length[:-1, None] + half * (1.0 + NODES)
    steps = np.sum(half * WEIGHTS / _rate(path, law, places.ravel()).reshape(places.shape), axis=1)
    return length, np.append(0.0, np.cumsum(steps)), end


def _at_length(scene: Scene, length: float, omega: float) -> Scene:
    """A scene, without a curve or a sweep, with another crack length [m] at a load frequency
    [rad/s], which replaces an engine order, with the ranges that drive growth as quantities."""
    place = {"crack.length": length, "excitation.omega": omega}
    return scene.replace(place | {"output.quantities": tuple(OF_GROWTH)})


def _error_at(scene: Scene, path: LengthPath, length: float) -> tuple[float, list[str]]:
    """Relative error of the effective range by mesh, modes and harmonics at a length; and a remark
    on what it does not have."""
    drive = scene.given("growth").drive
    omega = float(path.at("omega", np.array([length]))[0])
    if drive == "spectrum":
        omega = float(path.leading[np.abs(path.lengths - length).argmin()])
    run = solve(_at_length(scene, length, omega), MPI.COMM_SELF)
    # A list of frequencies stays where it is, as one frequency does.
    of_peak = drive == "resonance" or scene.given("growth").run_up is not None
    stated = stated_errors(run, run.result, of_peak=of_peak)
    left_out = stated.left_out
    without = [f"vibration: {left_out}"] if left_out else []
    return stated.stated("delta_K_equivalent")[0], without


def _lost(
    path: LengthPath, law: Law, length: np.ndarray, cycles: np.ndarray, error: float
) -> float:
    """Return the rise of ln N, beside the power of the exponent, if all ranges are smaller by a
    relative error: more of a spectrum is below the threshold then."""
    if law.drive != "spectrum" or not law.threshold or not 0.0 < error < 1.0:
        return 0.0
    higher = replace(law, threshold=law.threshold / (1.0 - error))
    less = LengthPath(np.zeros(0), NO_COLUMNS)
    for table in path.tables:
        less = less.joined(table, higher, _levels(law, path.damping)[1])
    return _longer(path, less.columns["driving"], law, length, cycles)


def _longer(
    path: LengthPath, drive: np.ndarray, law: Law, length: np.ndarray, cycles: np.ndarray
) -> float:
    """Return the rise of ln N if another range (k,) drives the crack at the lengths of a path."""
    if not cycles[-1] > 0.0:
        return 0.0
    other = replace(path, columns=path.columns | {"driving": drive})
    middle = 0.5 * (length[1:] + length[:-1])
    ratio = path.at("driving", middle) / other.at("driving", middle)
    return math.log(float(np.average(ratio**law.exponent, weights=np.diff(cycles))))


def _remarks(
    scene: Scene,
    path: LengthPath,
    seen: Mapping[str, np.ndarray],
    length: np.ndarray,
    vibration: float,
    end: str,
) -> list[str]:
    """Return the remarks that cast doubt on a crack's growth."""
    found = []
    one, two = np.maximum(seen["K_max"], NOTHING), seen["K_II_max"]
    turn = 2.0 * np.arctan(2.0 * two / (one + np.sqrt(one**2 + 8.0 * two**2)))
    if np.any(turning := turn > TURNS_ASIDE):
        at = length[np.argmax(turning)]
        found.append(
            f"from {at:.4g} m on a straight crack is no longer right: it would turn by up to "
            f"{math.degrees(turn.max()):.0f} degrees, K_II_max being up to "
            f"{np.max(two / one):.0%} of K_max"
        )
    law = scene.given("growth")
    if law.run_up is not None:
        start, stop, rate = law.run_up
        lowest = max(start, float(seen["omega_bilinear"].min()) / TURN)
        slow = 2.0 * TURN * (path.damping * lowest) ** 2 / rate
        if lowest < stop and slow < SETTLES:
            found.append(
                f"the run-up is through the width of the resonance in {slow:.2g} of the times in "
                "which a vibration settles: it becomes less than the steady one, which is taken, "
                "and the crack grows less"
            )
    unsure, jumps = (
        [at for at in places if at <= length[-1]] for places in (path.not_stable, path.jumps)
    )
    if unsure:
        count = counted(len(unsure), "length")
        found.append(f"at {count} the vibration is unstable, or its stability undecided")
    if jumps:
        found.append(
            f"near {jumps[0]:.4g} m the stress intensity jumps: several vibrations may be "
            "possible there, of which growth takes the one that is found first; a curve shows them"
        )
    found += [f"a crack of {at:.4g} m was not solved: {why}" for at, why in path.failed]
    # A crack that is arrested on its way has been at its threshold, however well that is known.
    near = np.abs(seen["delta_K_effective"] - law.threshold) < vibration * law.threshold
    if np.any(near) and (end != "arrested" or len(length) == 1):
        found.append(
            f"at {length[np.argmax(near)]:.4g} m the effective range is growth.threshold within "
            f"its error of {vibration:.1%}: whether the crack grows there is not known"
        )
    if not math.isfinite(vibration):
        found.append("the error of the vibration is unknown")
    return found


# --- numbers over the length ----------------------------------------------------------------------


@dataclass(frozen=True)
class LengthPath:
    """Columns of a sweep over the crack's length, and splines through them.

    Attributes
    ----------
    lengths : (k,) [m]
        Ascending.
    columns : dict of str to (k,)
        The :data:`LOGARITHMIC` and the linear ones; of a run-up what drives the crack also
        "coarser", by every second level.
    failed : tuple of (float, str)
        Lengths [m] that were not solved, and why.
    not_stable : (j,) [m]
        Lengths at which the vibration is unstable or its stability undecided.
    jumps : (j,) [m]
        Where the spline of ln delta K misses by more than :data:`ROUGH`, however close the lengths,
        the most on the shortest way first.
    leading : (k,) [rad/s]
        Load frequencies at which most of the growth happens.
    damping : float
        Least ratio of critical damping of the lowest modes, with a run-up; else nan.
    tables : tuple of SweepResult
        Of which they are.
    mode : int or None
        Whose natural frequencies the columns have, from 0: the nearest to the leading load of the
        first length; None before there is one.
    """

    lengths: np.ndarray
    columns: dict[str, np.ndarray]
    failed: tuple[tuple[float, str], ...] = ()
    not_stable: tuple[float, ...] = ()
    jumps: tuple[float, ...] = ()
    leading: np.ndarray = field(default_factory=lambda: np.zeros(0))
    damping: float = math.nan
    tables: tuple[SweepResult, ...] = ()
    mode: int | None = None

    def at(self, name: str, lengths: np.ndarray) -> np.ndarray:
        """A column at any lengths within."""
        from scipy.interpolate import CubicSpline  # takes a while, and is needed here alone

        values = self.columns[name]
        if name not in LOGARITHMIC:
            return np.asarray(CubicSpline(self.lengths, values)(lengths))
        floor = LEAST * max(float(values.max()), 1e-300)
        spline = CubicSpline(self.lengths, np.log(np.maximum(values, floor)))
        return np.asarray(np.exp(spline(lengths)))

    def joined(self, table: SweepResult, law: Law, cycles: np.ndarray) -> LengthPath:
        """With the cases of one more sweep, over lengths and the levels of a spectrum, each of
        which has so many cycles."""
        swept = np.array(table.axes[0].values)
        solved = table.converged.reshape(len(swept), -1).all(axis=1)
        lengths = np.append(self.lengths, swept[solved])
        order = np.argsort(lengths)
        rows = {name: table[name].reshape(len(swept), -1)[solved] for name in READ}
        rows["response"] = np.nan_to_num(rows["response"])  # nan where nothing moves
        new, leading = _driving(rows, law, cycles)
        new["coarser"] = new["driving"]
        if law.run_up is not None:
            few = {name: values[:, ::2] for name, values in rows.items()}
            hertz = np.array(table.axes[1].values[::2])
            new["coarser"] = _driving(few, law, hertz * _trapezoid(hertz))[0]["driving"]
        one, two = (
            np.array(
                [table[f"omega_{lips}_{n}"].reshape(len(swept), -1)[solved, 0] for n in NUMBERED]
            )
            for lips in ("open", "bilinear")
        )
        mode = self.mode  # that of the first length, whichever is nearest later on
        if mode is None and solved.any():
            mode = int(np.nanargmin(np.abs(two[:, 0] - leading[0])))
        if mode is not None:
            new["omega_open"], new["omega_bilinear"] = one[mode], two[mode]
        columns = {
            name: np.append(values, new[name])[order] for name, values in self.columns.items()
        }
        failed = {float(swept[at[0]]): reason for at, reason in table.failed}
        unsure = table.not_stable.reshape(len(swept), -1).any(axis=1)
        return replace(
            self,
            lengths=lengths[order],
            columns=columns,
            failed=self.failed + tuple(failed.items()),
            not_stable=self.not_stable + tuple(swept[unsure & solved].tolist()),
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

    of the equivalent ranges, levels below the threshold left out where another is above it; of a
    run-up the integral, and the parts above it."""
    effective, drive = rows["delta_K_effective"], rows["delta_K_equivalent"]
    found = {name: rows[name].max(axis=1) for name in ("K_max", "delta_K_effective")}
    if law.run_up is not None:
        found = {name: _highest(rows[name]) for name in found}
    limit = np.minimum(law.threshold, found["delta_K_effective"])[:, None]
    largest = np.maximum(drive.max(axis=1, keepdims=True), 1e-300)
    if law.run_up is None:
        grown = (effective >= limit) * (drive / largest) ** law.exponent
    else:
        grown = _grown_around(drive, effective, limit, law.exponent)
    shares = cycles / cycles.sum() * grown
    place = shares.argmax(axis=1)[:, None]
    of_place = {name: np.take_along_axis(rows[name], place, axis=1)[:, 0] for name in rows}
    leading = of_place["omega"]
    found["driving"] = largest[:, 0] * shares.sum(axis=1) ** (1.0 / law.exponent)
    found["omega"] = cycles.sum() / (cycles / rows["omega"]).sum(axis=1)
    return of_place | found, leading


def _between_levels(ranges: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Ranges at places (j,) between the levels of a run-up, counted from 0, over the largest range:
    (k, j) of ranges (k, levels). Their logarithms are Akima's splines, which do not ring behind a
    jump."""
    from scipy.interpolate import Akima1DInterpolator  # takes a while, and is needed here alone

    largest = np.maximum(ranges.max(axis=1, keepdims=True), 1e-300)
    known = np.log(np.maximum(ranges / largest, LEAST))
    found = Akima1DInterpolator(np.arange(ranges.shape[1]), known, axis=1)(places)
    left = np.minimum(places.astype(int), ranges.shape[1] - 2)
    most = np.maximum(known[:, left], known[:, left + 1]) + math.log(TOP)
    return np.asarray(np.exp(np.minimum(found, most)))


def _highest(ranges: np.ndarray) -> np.ndarray:
    """The largest range (k,) of a run-up, at its levels (k, levels) or between them."""
    places = np.linspace(0.0, ranges.shape[1] - 1.0, SLICES * (ranges.shape[1] - 1) + 1)
    within = np.maximum(_between_levels(ranges, places).max(axis=1), 1.0)  # closed: none > 0
    return np.asarray(ranges.max(axis=1) * within)


def _grown_around(
    drive: np.ndarray, effective: np.ndarray, limit: np.ndarray, exponent: float
) -> np.ndarray:
    """The mean of what drives a crack, to the power of the exponent, around each level of a run-up,
    (k, levels), over that of the largest at a level; of what is there the part whose effective
    range is above a limit (k, 1), some of the largest at least."""
    levels = drive.shape[1]
    edges = np.clip(np.linspace(-0.5, levels - 0.5, SLICES * levels + 1), 0.0, levels - 1.0)
    width = np.diff(edges)
    limit = limit / np.maximum(effective.max(axis=1, keepdims=True), 1e-300)
    ends = _between_levels(effective, edges)
    low, high = np.minimum(ends[:, 1:], ends[:, :-1]), np.maximum(ends[:, 1:], ends[:, :-1])
    above = np.clip((high - limit) / np.maximum(high - low, 1e-300), 0.0, 1.0)
    above = np.where(low >= limit, 1.0, above)
    power = width * _between_levels(drive, 0.5 * (edges[1:] + edges[:-1])) ** exponent
    both = (part.reshape(-1, levels, SLICES).sum(axis=2) for part in (above * power, power))
    largest = np.maximum(drive.max(axis=1, keepdims=True), 1e-300)
    grown = (drive / largest) ** exponent * np.divide(*both)
    return np.asarray(np.maximum(grown, (drive >= drive.max(axis=1, keepdims=True)) / SLICES))


def _solve_lengths(
    scene: Scene, folder: Path | None, comm: MPI.Comm, *, progress: bool = False
) -> tuple[LengthPath, float]:
    """Solve a scene at lengths from its crack's to its growth's, until the cycles are known to
    ``growth.life_tolerance``; and the error of the cycles by interpolation, relative to them
    (collective). A folder keeps the sweeps, one for each round.

    Raises
    ------
    ConvergenceError
        Ctrl-C has stopped it, or too few lengths were solved.
    """
    law = scene.given("growth")
    start, stop = scene.given("crack").length, law.until
    damping = math.nan if law.run_up is None else _least_damping(scene)
    levels, cycles = _levels(law, damping)
    wanted, missed, own = np.linspace(start, stop, FIRST), np.inf, np.zeros(0)
    path = LengthPath(np.zeros(0), NO_COLUMNS, damping=damping)
    for number in range(1, ROUNDS + 1):
        file = None if folder is None else folder / f"growth_{number}.h5"
        swept = _swept(scene, wanted, levels)
        with StopRequest() as stop:
            table = run_sweep(swept, file, comm, progress=progress, judged=False)
        if stop.asked(comm):
            raise StoppedError("growth was stopped; the same command goes on with it")
        before, path = path, path.joined(table, law, cycles)
        if number == 1:
            if path.failed:
                at, why = path.failed[0]
                raise ConvergenceError(f"growth, a crack of {at:.4g} m: {why}")
            few = {name: values[::2] for name, values in path.columns.items()}
            before, own = LengthPath(path.lengths[::2], few), np.zeros(FIRST // 2)
        own = _missed(before, path, own)
        length, passed, _ = _integrated(path, law)
        steps = np.diff(np.interp(path.lengths, length, passed))
        shares = law.exponent * own * steps / max(float(steps.sum()), 1e-300)
        missed = float(shares.sum())
        left = (shares > law.life_tolerance / len(shares)) & (missed > law.life_tolerance)
        wanted = (0.5 * (path.lengths[1:] + path.lengths[:-1]))[left | (own > ROUGH)]
        wanted = wanted[~np.isin(wanted, [at for at, _ in path.failed])]
        if not len(wanted):
            break
    sharpest = np.argsort(-own / np.diff(path.lengths))
    rough = path.lengths[:-1][sharpest[own[sharpest] > ROUGH]]
    return replace(path, jumps=tuple(rough.tolist())), missed


def _levels(law: Law, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """Load frequencies [rad/s] of a spectrum, none without one, and the cycles of each.

    Those of a run-up are as close as sqrt(2 / m) of the half width of a resonance, and as that
    where m < 2: over 1 / (1 + x^2)^(m / 2) even their sum is within 2 exp(-2 pi) of the integral.
    They are an odd number, so that every second one gives the error."""
    if law.frequencies is not None:
        return TURN * np.array(law.frequencies), np.array(law.cycles)
    if law.run_up is None:
        return np.zeros(0), np.ones(1)
    start, stop, rate = law.run_up
    step = damping / math.sqrt(max(0.5 * law.exponent, 1.0))
    count = 2 * max(math.ceil(0.5 * math.log(stop / start) / math.log1p(step)), 1) + 1
    found = np.geomspace(start, stop, count)
    return TURN * found, found * _trapezoid(found) / rate


def _least_damping(scene: Scene) -> float:
    """Least ratio of critical damping of the lowest modes that are kept."""
    whole = prepare(scene, MPI.COMM_SELF, whole=True).structure
    kept = reduction_of(scene, whole)
    count = min(FEW_MODES, whole.n_modes, kept.modes if kept is not None else FEW_MODES)
    found = float(damping_ratios(whole, solve_modes(whole, count).omega).min())
    if not found > 0.0:
        raise InputError("damping", None, "a ratio of each mode, with growth.run_up")
    return found


def _swept(scene: Scene, lengths: np.ndarray, levels: np.ndarray) -> Scene:
    """The scene with a sweep over some lengths, and over the levels of a spectrum."""
    over = {"crack.length": [float(at) for at in lengths]}
    if len(levels):
        over["excitation.omega"] = [float(omega) for omega in levels]
    return scene.replace(
        {
            "sweep.over": over,
            "sweep.at_resonance": scene.given("growth").drive == "resonance",
            "output.quantities": (*OF_TIPS, *OF_GROWTH),
        }
    )


def _missed(before: LengthPath, path: LengthPath, missed: np.ndarray) -> np.ndarray:
    """Error of the spline's ln delta K on each interval between lengths: of those that are new, by
    what the spline before missed at their ends; of the others what it was, or how far both splines
    are apart in their middle, if that is more: a resonance that passes within shows around it, too.
    (k - 1,)"""

    def apart(lengths: np.ndarray) -> np.ndarray:
        here, there = (one.at("driving", lengths) for one in (path, before))
        return np.abs(np.log(here / there))

    at_ends, new = apart(path.lengths) / REDUCED, ~np.isin(path.lengths, before.lengths)
    middle = 0.5 * (path.lengths[1:] + path.lengths[:-1])
    known = missed[np.searchsorted(before.lengths, middle) - 1]
    old = np.maximum(known, apart(middle))
    return np.where(new[1:] | new[:-1], np.maximum(at_ends[1:], at_ends[:-1]), old)
