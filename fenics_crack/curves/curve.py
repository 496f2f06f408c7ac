"""Response curves: solutions along a parameter, and where they bifurcate."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from fenics_crack.balance.assessment import Assessment
from fenics_crack.balance.compliance import ModalCompliance
from fenics_crack.balance.contact_system import ContactPoint, ContactSystem
from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import (
    Indicators,
    PeriodicSolution,
    contact_extremes,
    indicators_of,
    solution_of,
)
from fenics_crack.curves.family import FAMILIES, Family
from fenics_crack.curves.peak import Peak, Top, damping_by_width, top_of
from fenics_crack.curves.stability import floquet
from fenics_crack.errors import InputError
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.modal import all_modes
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import evaluate, resized
from fenics_crack.table import (
    Described,
    Tabular,
    counted,
    frequency_axis,
    ranging,
    speed_axis,
    with_frequency,
)

PARAMETERS = {
    "omega": "load frequency [rad/s]",
    "load": "load, as a multiple of the scene's [-]",
    "stiffness": "contact stiffness, as a multiple of the scene's [-]",
    "damping": "damping, as a multiple of the scene's [-]",
    "clearance": "clearance added to the scene's [m]",
    "speed": "rotor speed [rad/s]",
}
"""What a curve may be followed in, by its name in :attr:`ResponseCurve.parameter`."""


PHASES = 2.0 * np.pi * np.arange(256) / 256
"""Of a period, at which points of a curve are looked at."""
SPREAD = 40
"""Places along its range that a picture of a curve tells apart: as many errors are found first."""


def parameter_axis(parameter: str, in_hertz: bool) -> tuple[float, str, str]:
    """What multiplies a curve's parameter, its name and unit: in Hz and rpm, or in rad/s."""
    if parameter in ("omega", "speed"):
        return (frequency_axis if parameter == "omega" else speed_axis)(in_hertz)
    name, _, unit = PARAMETERS[parameter].removesuffix("]").rpartition(" [")
    return 1.0, name, unit


def kind_in_words(kind: str) -> str:
    """The kind of a bifurcation as it is printed."""
    return "Neimark-Sacker" if kind == "neimark_sacker" else kind.replace("_", " ")


def _expanded(problem: Problem, unknown: np.ndarray, *, search: bool) -> PeriodicSolution:
    """The solution that belongs to an unknown; its error by its exact orbit, or as predicted."""
    compliance = problem.compliance()
    at = problem.system(compliance).linearise(unknown)
    found = solution_of(problem, at, status="point of a curve", search=search)
    compliance.destroy()
    return found


@dataclass(frozen=True)
class CurvePoint:
    """A point of a curve as it comes.

    Attributes
    ----------
    value, omega : float
        Of the parameter, and load frequency [rad/s].
    unknown : (2H+1, n_pairs) [m]
        Gap coefficients, or the slow gap's (``ResponseCurve.unknowns``).
    iterations : int
        Newton iterations.
    truncation : float
        Estimated error of the harmonics left out, or nan where it was not estimated.
    bifurcations : tuple of (str, float)
        Kinds and parameters of the special points since the point before.
    """

    value: float
    omega: float
    unknown: np.ndarray
    iterations: int
    truncation: float = math.nan
    bifurcations: tuple[tuple[str, float], ...] = ()


def columns(points: Sequence[CurvePoint]) -> dict[str, np.ndarray]:
    """What points are in a :class:`ResponseCurve`, all with the most harmonics."""
    counts = [len(point.unknown) // 2 for point in points]
    most = max(counts)
    unknowns = [
        point.unknown if count == most else resized(point.unknown, most)
        for point, count in zip(points, counts, strict=True)
    ]
    return {
        "values": np.array([point.value for point in points]),
        "omega": np.array([point.omega for point in points]),
        "unknowns": np.array(unknowns),
        "harmonics": np.array(counts),
        "iterations": np.array([point.iterations for point in points]),
        "truncation": np.array([point.truncation for point in points]),
    }


@dataclass(frozen=True, repr=False)
class Bifurcation(Described):
    """A special point of a curve.

    Attributes
    ----------
    kind : str
        "fold": the curve turns back; "branch_point": another branch crosses; "period_doubling": a
        multiplier leaves the unit circle through -1; "neimark_sacker": a pair of them leaves it
        anywhere else. The last two only with ``stability=True``.
    value : float
        Of the curve's parameter.
    unknown : (2H+1, n_pairs) [m]
        The solution there, as the curve's unknowns.
    problem : Problem
        What is solved there.
    exact : float
        Value of the parameter at the bifurcation of the exact orbits that confirms it
        (:func:`judge_curve`); nan: unconfirmed.
    """

    kind: str
    value: float
    unknown: np.ndarray
    problem: Problem
    exact: float = math.nan

    @property
    def confirmed(self) -> bool:
        """Whether the exact orbits have it."""
        return not math.isnan(self.exact)

    @cached_property
    def solution(self) -> PeriodicSolution:
        """The same, with its displacement and error report."""
        return _expanded(self.problem, self.unknown, search=False)

    @property
    def gap_coefficients(self) -> np.ndarray:
        """Closing of the pairs there: (2H+1, n_pairs) [m]."""
        return self.solution.gap_coefficients

    @property
    def omega(self) -> float:
        """Load frequency [rad/s]."""
        return self.problem.omega

    def to_dict(self) -> dict[str, Any]:
        """Kind, value of the curve's parameter, load frequency, and the exact orbits' value."""
        return with_frequency(
            {
                "kind": self.kind,
                "value": float(self.value),
                "omega": float(self.omega),
                "exact": float(self.exact),
            }
        )

    def _title(self) -> str:
        name, found = kind_in_words(self.kind), f"H = {self.problem.harmonics}"
        if self.confirmed:
            found += f", exact {self.exact:.6g}"
        return f"{name} at {self.value:.6g}, {found}"


class _Waves(Tabular):
    """What the dofs and the lips of solutions do over the period, from their unknowns alone."""

    structure: Structure
    omega: np.ndarray
    unknowns: np.ndarray
    harmonics: np.ndarray
    subharmonic: int
    static_above: float | None

    def __len__(self) -> int:
        return len(self.omega)

    def _linearised(self, places: np.ndarray | None = None) -> Iterator[tuple[int, ContactPoint]]:
        """The equations at all points, or some, with their numbers; not in order."""
        for index, system in self._systems(places):
            yield index, system.linearise(self.unknown(index))

    def _systems(self, places: np.ndarray | None = None) -> Iterator[tuple[int, ContactSystem]]:
        """The equations for all points, or some, likewise."""
        raise NotImplementedError

    def unknown(self, index: int) -> np.ndarray:
        """What was followed at a point, with its own harmonics: (2H+1, n_pairs) [m]."""
        return self.unknowns[index, : 2 * self.harmonics[index] + 1]

    @cached_property
    def gap_coefficients(self) -> np.ndarray:
        """Closing of the pairs: (n, 2H+1, n_pairs) [m]; zeros above a point's own harmonics."""
        if self.static_above is None:
            return self.unknowns
        found = np.zeros_like(self.unknowns)
        for index, at in self._linearised():
            found[index, : len(at.gap)] = at.gap
        return found

    def gap(self, index: int) -> np.ndarray:
        """Gap coefficients of a point with its own harmonics: (2H+1, n_pairs) [m]."""
        return self.gap_coefficients[index, : 2 * self.harmonics[index] + 1]

    def indicators(self, dof: int | None = None) -> Indicators:
        """What a dof, or the watched one, and the lips show of a breathing crack at every point, of
        256 instants."""
        return self.measure([dof])[0]

    def coefficients_at(self, dof: int | None = None) -> np.ndarray:
        """Coefficients of the displacement of a dof, or of the watched one, at every point:
        (n, 2H+1) [m]."""
        return self._seen_at([dof])[0][0]

    def motions(self, places: np.ndarray | None = None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Displacements [m] and velocities [m/s] of all dofs at phase zero, at all points or some:
        (n_dofs,) each."""
        found = {}
        places = np.arange(len(self.omega)) if places is None else places
        for index, at in self._linearised(places):
            waves = at.system.compliance.displacement(at.force)
            order = np.arange(1, len(waves) // 2 + 1) * self.omega[index] / self.subharmonic
            found[index] = waves[0] + waves[1::2].sum(axis=0), order @ waves[2::2]
        return (found[int(place)] for place in places)

    def gaps_in_time(self, places: np.ndarray) -> np.ndarray:
        """Gaps of all pairs over the period at some points: (n, 256, n_pairs) [m]."""
        slow = evaluate(self.unknowns[places].swapaxes(0, 1), 1.0, PHASES).swapaxes(0, 1)
        systems = dict(self._systems(places))
        pairs = zip(places, slow, strict=True)
        return np.array([systems[int(place)].in_time(waves)[0] for place, waves in pairs])

    def amplitude(self, dof: int | None = None) -> np.ndarray:
        """Half the peak-to-peak displacement of a dof, or of the watched one, at every point: (n,)
        [m], of 256 instants."""
        return np.asarray(self.measure([dof])[0].amplitude)

    def measure(self, dofs: Sequence[int | None]) -> list[Indicators]:
        """:meth:`indicators` of some dofs; the equations are formed once for all that are new."""
        seen = self._seen_at(dofs)
        lips = {name: np.array([at[name] for at in self._lips]) for name in self._lips[0]}
        return [
            indicators_of(self.omega, coefficients, amplitude, lips, self.subharmonic)
            for coefficients, amplitude in seen
        ]

    @cached_property
    def _seen(self) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """Coefficients and half peak-to-peak values of dofs once they are known."""
        return {}

    @cached_property
    def _lips(self) -> list[dict[str, float]]:
        """What :func:`contact_extremes` finds at every point, once it is known."""
        return [{} for _ in range(len(self.omega))]

    def _seen_at(self, dofs: Sequence[int | None]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Coefficients (n, 2H+1) and half peak-to-peak values (n,) [m] of some dofs."""
        structure = self.structure
        asked = [structure.watched_dof if dof is None else dof for dof in dofs]
        new = [dof for dof in dict.fromkeys(asked) if dof not in self._seen]
        if new:
            rows = structure.values_at(np.eye(structure.n_dofs), new).T  # u = T q
            seen = np.zeros((len(new), *self.unknowns.shape[:2]))
            sizes = np.zeros((len(new), len(self.omega)))
            for index, waves, motion, gap, force in self.seen_through(rows):
                seen[:, index, : len(waves)] = waves.T
                self._lips[index] = contact_extremes(gap, force, structure.pairs.cracks)
                sizes[:, index] = np.ptp(motion, axis=0) / 2.0
            self._seen.update(zip(new, zip(seen, sizes, strict=True), strict=True))
        return [self._seen[dof] for dof in asked]

    def seen_through(
        self, rows: np.ndarray
    ) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Products of rows (m, n_dofs) with the motion at every point, not in order: its number,
        their coefficients (2H+1, m), and over 256 instants the products (256, m), the gaps [m] and
        the contact forces [N] (256, n_pairs)."""
        moved = None
        if self.static_above is not None:
            moved = rows @ all_modes(self.structure).moved_at_once(self.static_above)
        for index, at in self._linearised():
            assert isinstance(at.system.compliance, ModalCompliance)
            waves = at.system.compliance.seen_through(rows, at.force)
            motion = evaluate(waves, 1.0, PHASES)
            gap, force = at.system.in_time(evaluate(at.unknown, 1.0, PHASES))
            if moved is not None:
                # What answers at once follows the forces as they are, with their kinks.
                motion -= (force - evaluate(at.force, 1.0, PHASES)) @ moved.T
            yield index, waves, motion, gap, force


@dataclass(frozen=True, repr=False)
class ResponseCurve(_Waves):
    """Solutions along a curve, in the order in which it was followed.

    Attributes
    ----------
    structure : Structure
        Whose solutions they are: small or reduced; as given, not as the parameter varies it.
    contact : ContactLaw
        Law of all pairs, likewise.
    parameter : str
        "omega", "load", "stiffness", "damping", "clearance" or "speed".
    values : (n,)
        Of the parameter: load frequencies [rad/s], factors, clearances added [m], or speeds of the
        rotor [rad/s].
    omega : (n,) [rad/s]
        Load frequencies.
    unknowns : (n, 2H+1, n_pairs) [m]
        What was followed: gap coefficients, or those of the slow gap s = g + R_inf lambda where
        pairs are seen through R_inf; zeros above a point's own harmonics.
    harmonics : (n,) int
        H of each point.
    iterations : (n,) int
        Newton iterations of each point.
    truncation : (n,)
        Estimated error of the harmonics left out, where it was estimated; else nan.
    bifurcations : tuple of Bifurcation
        Special points, in order along the curve.
    complete : bool
        Whether the curve reached the end that was asked for, or closed.
    status : str
        How it ended.
    samples, subharmonic : int or None, int
        As given when it was followed.
    multipliers : (n,) complex or None
        Floquet multiplier of largest modulus at each point, of a pair the one with positive
        imaginary part; with ``stability=True``. Of exact orbits it is interpolated between some of
        them, and nan where none is the point's own (:func:`judge_curve`).
    undecided : (n,) bool or None
        Where the stability is left open (:func:`judge_curve`), for a :meth:`reason`; None: not
        judged.
    branch : bool
        Whether :func:`follow_branch` has followed it.
    static_above : float or None
        Where pairs are seen through R_inf, the same for all points: the frequency [rad/s] above
        which modes answer contact forces at once (:class:`fenics_crack.Problem`); else None.
    """

    structure: Structure
    contact: ContactLaw
    parameter: str
    values: np.ndarray
    omega: np.ndarray
    unknowns: np.ndarray
    harmonics: np.ndarray
    iterations: np.ndarray
    truncation: np.ndarray
    bifurcations: tuple[Bifurcation, ...]
    complete: bool
    status: str
    samples: int | None
    subharmonic: int
    multipliers: np.ndarray | None = None
    branch: bool = False
    static_above: float | None = None
    undecided: np.ndarray | None = None

    KIND: ClassVar[str] = "response curve"

    @property
    def stable(self) -> np.ndarray:
        """Whether the largest multiplier is known to lie within the unit circle: (n,) bool.

        Raises
        ------
        InputError
            The curve was followed without ``stability=True``.
        """
        if self.multipliers is None:
            raise InputError("stability", False, "True when the curve is followed")
        return np.asarray((np.abs(self.multipliers) < 1.0) & ~self._open)

    @property
    def verdicts(self) -> np.ndarray:
        """Stable, unstable or undecided, at each point: (n,) str; raises as :attr:`stable`."""
        return np.where(self._open, "undecided", np.where(self.stable, "stable", "unstable"))

    @property
    def _open(self) -> np.ndarray:
        """Where the stability is undecided: (n,) bool."""
        return np.zeros(len(self), dtype=bool) if self.undecided is None else self.undecided

    def reason(self, index: int) -> str:
        """Why the stability is undecided at a point, and what to do; "" where it is decided.

        It is what :func:`fenics_crack.floquet` says of the point's solution by itself.
        """
        if not self._open[index]:
            return ""
        if self._open.all():
            return "no point of the curve has an exact orbit of its own"
        return self.assessment(index).reason or "its largest multiplier is 1 to rounding"

    @property
    def problem(self) -> Problem:
        """What was solved at the first point, with the harmonics of the last one."""
        return Problem(
            self.structure, float(self.omega[0]), self.contact, int(self.harmonics[-1]),
            self.samples, self.subharmonic, self.static_above,
        )  # fmt: skip

    def point(self, index: int) -> CurvePoint:
        """A point as :class:`Continuation` yields it, without the bifurcations before it."""
        return CurvePoint(
            float(self.values[index]), float(self.omega[index]), self.unknown(index),
            int(self.iterations[index]), float(self.truncation[index]),
        )  # fmt: skip

    def solution(self, index: int, *, search: bool = True) -> PeriodicSolution:
        """The solution at a point, with its displacement and error report; without ``search`` for
        its exact orbit the report is what one Newton step predicts."""
        return _expanded(self.problem_of(index), self.unknown(index), search=search)

    def assessment(self, index: int) -> Assessment:
        """What the exact flow says of a point; no error is estimated."""
        problem = self.problem_of(index)
        at = problem.system(problem.compliance()).linearise(self.unknown(index))
        return Assessment(problem.wave(at))

    def top(self, dof: int | None = None) -> Top:
        """Find where the largest response of a dof, or of the watched one, is and how large;
        :meth:`peak` examines it, too."""
        amplitude = self.amplitude(dof)
        index = int(np.argmax(amplitude))
        return Top(index, *top_of(self.values, amplitude, index), index in (0, len(self) - 1))

    def peak(self, dof: int | None = None) -> Peak:
        """The largest response of a dof, or of the watched one: where, how large, how sure, whether
        stable, and the damping by its width."""
        top = self.top(dof)
        index, value = top.index, top.value
        omega, solution = float(self.omega[index]), self.solution(index)
        if self.parameter in ("omega", "speed"):
            omega *= value / float(self.values[index])
        if self.multipliers is None:
            verdict = floquet(solution.structure, solution).verdict
        else:
            verdict = str(self.verdicts[index])
        error = solution.report.displacement
        damping = _damping(self, index, dof)
        return Peak(index, value, omega, top.amplitude, error, verdict, damping, at_end=top.at_end)

    @cached_property
    def at_bifurcations(self) -> ResponseCurve:
        """The first point, the bifurcations and the last point, to be measured: a curve of their
        own, for which no error is estimated."""
        met: list[CurvePoint | Bifurcation] = [self.point(0), *self.bifurcations, self.point(-1)]
        points = columns([CurvePoint(one.value, one.omega, one.unknown, 0) for one in met])
        return replace(self, **points, bifurcations=(), multipliers=None, undecided=None)

    @cached_property
    def displacement_errors(self) -> np.ndarray:
        """Estimated error of the displacement at the load at every point, relative to its root mean
        square, as ``displacement`` of :class:`fenics_crack.ErrorReport`: (n,).

        What one Newton step on the exact flow predicts, where there is one: at points spread evenly
        along the curve, and at those on both sides of where a warning begins to be due; elsewhere
        it is interpolated.
        """
        known: dict[int, float] = {}
        asked = set(np.linspace(0, len(self) - 1, SPREAD).astype(int).tolist())
        while asked:
            for place in asked:
                known[place] = self.solution(place, search=False).report.displacement
            asked = {
                (first + last) // 2
                for first, last in pairwise(sorted(known))
                if last - first > 1 and (known[first] > LARGE_ERROR) != (known[last] > LARGE_ERROR)
            }
        places = sorted(known)
        return np.interp(np.arange(len(self)), places, [known[place] for place in places])

    @property
    def solutions(self) -> list[PeriodicSolution]:
        """The solutions at all points."""
        return [self.solution(index) for index in range(len(self))]

    def _systems(self, places: np.ndarray | None = None) -> Iterator[tuple[int, ContactSystem]]:
        """The equations for all points, or some, likewise."""
        wanted = np.arange(len(self)) if places is None else places
        for count in np.unique(self.harmonics[wanted]):
            family = self.equations(int(count))
            for index in wanted[self.harmonics[wanted] == count]:
                yield int(index), family.system(float(self.values[index]))

    def equations(self, harmonics: int) -> Family:
        """The truncated equations with so many harmonics, along the parameter: from its value at
        the first point to the one farthest from there."""
        if harmonics not in self._families:
            farthest = int(np.argmax(np.abs(self.values - self.values[0])))
            ends = float(self.values[0]), float(self.values[farthest])
            problem = self.problem.with_harmonics(harmonics)
            self._families[harmonics] = FAMILIES[self.parameter](problem, *ends)
        return self._families[harmonics]

    @cached_property
    def _families(self) -> dict[int, Family]:
        """The equations with each number of harmonics, once they are known."""
        return {}

    def bifurcation(self, kind: str, value: float, unknown: np.ndarray) -> Bifurcation:
        """A special point of this curve, where the parameter has a value."""
        return Bifurcation(kind, value, unknown, self._problem_at(value, unknown))

    def problem_of(self, index: int) -> Problem:
        """What was solved at a point, of the structure as the parameter varies it."""
        return self._problem_at(float(self.values[index]), self.unknown(index))

    def _problem_at(self, value: float, unknown: np.ndarray) -> Problem:
        """What is solved where the parameter has a value, with the harmonics of an unknown."""
        problem = self.problem.with_harmonics(len(unknown) // 2)
        return FAMILIES[self.parameter].vary(problem, value)

    # --- shown ------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every point: multipliers where the curve has them, and the indicators
        of the watched dof (collective)."""
        names = "omega", "harmonics", "iterations", "truncation"
        found = {self.parameter: self.values.tolist()}
        found |= {name: getattr(self, name).tolist() for name in names}
        if self.multipliers is not None:
            found["multiplier"] = np.abs(self.multipliers).tolist()
            found["verdict"] = self.verdicts.tolist()
        return with_frequency(found | self.indicators().to_dict())

    def _title(self) -> str:
        parts = [
            f"{self.parameter} {self.values[0]:.6g} to {self.values[-1]:.6g}",
            counted(len(self), "point"),
            f"H = {ranging(self.harmonics)}",
            counted(len(self.bifurcations), "bifurcation"),
        ]
        if self.multipliers is not None:
            parts.append(f"{np.mean(self.stable):.0%} stable")
        return ", ".join([*parts, "complete" if self.complete else "NOT COMPLETE"])


def _damping(curve: ResponseCurve, index: int, dof: int | None) -> float:
    """By the half-power bandwidth next to a point; over a rotor's speed natural frequencies follow
    the load's, and it takes longer to pass them."""
    if curve.parameter not in ("omega", "speed"):
        return math.nan
    waves, structure = curve.coefficients_at(dof), curve.structure
    damping = damping_by_width(curve.values, waves, curve.subharmonic, index)
    if isinstance(structure, RunUpStructure):
        there = structure.at_speed(float(curve.values[index]))
        damping *= 1.0 - there.stiffening(float(curve.omega[index]))
    return damping
