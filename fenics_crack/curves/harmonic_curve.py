"""Response curves of harmonic balance: points that solve the truncated equations."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fenics_crack.balance.assessment import Assessment
from fenics_crack.balance.compliance import ModalCompliance
from fenics_crack.balance.contact_system import ContactPoint, ContactSystem
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution, solution_of
from fenics_crack.curves.curve import PHASES, Bifurcation, ResponseCurve
from fenics_crack.curves.family import FAMILIES, Family
from fenics_crack.model.modal import all_modes
from fenics_crack.numerics.fourier import evaluate, resized
from fenics_crack.table import ranging


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
        Gap coefficients, or the slow gap's (``HarmonicCurve.unknowns``).
    iterations : int
        Newton iterations.
    bifurcations : tuple of (str, float)
        Kinds and parameters of the special points since the point before.
    """

    value: float
    omega: float
    unknown: np.ndarray
    iterations: int
    bifurcations: tuple[tuple[str, float], ...] = ()


def columns(points: Sequence[CurvePoint]) -> dict[str, np.ndarray]:
    """What points are in a :class:`HarmonicCurve`, all with the most harmonics."""
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
    }


@dataclass(frozen=True, repr=False, kw_only=True)
class HarmonicBifurcation(Bifurcation):
    """A special point of a :class:`HarmonicCurve`.

    Attributes
    ----------
    kind, value, problem
        As of any :class:`Bifurcation`.
    unknown : (2H+1, n_pairs) [m]
        The solution there, as the curve's unknowns.
    """

    unknown: np.ndarray

    @property
    def exact(self) -> float:
        """nan: it is one of the truncated equations."""
        return math.nan

    @cached_property
    def solution(self) -> PeriodicSolution:
        """The same, with its displacement and error report."""
        return _expanded(self.problem, self.unknown, search=False)

    def _title(self) -> str:
        return f"{super()._title()}, H = {self.problem.harmonics}"


@dataclass(frozen=True, repr=False, kw_only=True)
class HarmonicCurve(ResponseCurve):
    """Solutions of harmonic balance along a curve.

    Attributes
    ----------
    structure, contact, parameter, values, omega, iterations, complete, status, subharmonic, branch
        As of any :class:`ResponseCurve`.
    unknowns : (n, 2H+1, n_pairs) [m]
        What was followed: gap coefficients, or those of the slow gap s = g + R_inf lambda where
        pairs are seen through R_inf; zeros above a point's own harmonics.
    harmonics : (n,) int
        H of each point.
    bifurcations : tuple of HarmonicBifurcation
        Special points, in order along the curve.
    samples : int or None
        As given when it was followed.
    multipliers : (n,) complex or None
        With ``stability=True``, as of any :class:`ResponseCurve`; nan where no exact orbit is the
        point's own (:func:`judge_curve`).
    undecided : (n,) bool or None
        Where the stability is left open (:func:`judge_curve`), for a :meth:`reason`; None: not
        judged.
    static_above : float or None
        Where pairs are seen through R_inf, the same for all points: the frequency [rad/s] above
        which modes answer contact forces at once (:class:`fenics_crack.Problem`); else None.
    """

    unknowns: np.ndarray
    harmonics: np.ndarray
    bifurcations: tuple[HarmonicBifurcation, ...]
    samples: int | None
    static_above: float | None = None
    undecided: np.ndarray | None = None

    @property
    def method(self) -> str:
        """Its harmonics: "H = 5"; of older versions' curves "H = 5 to 40"."""
        return f"H = {ranging(self.harmonics)}"

    @property
    def problem(self) -> Problem:
        """What was solved at the first point, with the harmonics of the last one."""
        return Problem(
            self.structure, float(self.omega[0]), self.contact, int(self.harmonics[-1]),
            self.samples, self.subharmonic, self.static_above,
        )  # fmt: skip

    def problem_of(self, index: int) -> Problem:
        """What was solved at a point, of the structure as the parameter varies it."""
        return self._problem_at(float(self.values[index]), self.unknown(index))

    def _problem_at(self, value: float, unknown: np.ndarray) -> Problem:
        """What is solved where the parameter has a value, with the harmonics of an unknown."""
        problem = self.problem.with_harmonics(len(unknown) // 2)
        return FAMILIES[self.parameter].vary(problem, value)

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

    def solution(self, index: int, *, search: bool = True) -> PeriodicSolution:
        """The solution at a point, with its displacement and error report; without ``search`` for
        its exact orbit the report is what one Newton step predicts."""
        return _expanded(self.problem_of(index), self.unknown(index), search=search)

    def assessment(self, index: int) -> Assessment:
        """What the exact flow says of a point; no error is estimated."""
        problem = self.problem_of(index)
        at = problem.system(problem.compliance()).linearise(self.unknown(index))
        return Assessment(problem.wave(at))

    def reason(self, index: int) -> str:
        """Why the stability is undecided at a point, as :func:`fenics_crack.floquet` says of the
        point's solution by itself; "" where it is decided."""
        if not self._open[index]:
            return ""
        if self._open.all():
            return "no point of the curve has an exact orbit of its own"
        return self.assessment(index).reason or "its largest multiplier is 1 to rounding"

    def point(self, index: int) -> CurvePoint:
        """A point as :class:`Continuation` yields it, without the bifurcations before it."""
        return CurvePoint(
            float(self.values[index]), float(self.omega[index]), self.unknown(index),
            int(self.iterations[index]),
        )  # fmt: skip

    @cached_property
    def at_bifurcations(self) -> HarmonicCurve:
        """The first point, the bifurcations and the last point, to be measured: a curve of their
        own, for which no error is estimated."""
        met: list[CurvePoint | HarmonicBifurcation]
        met = [self.point(0), *self.bifurcations, self.point(-1)]
        points = columns([CurvePoint(one.value, one.omega, one.unknown, 0) for one in met])
        return replace(self, **points, bifurcations=(), multipliers=None, undecided=None)

    def bifurcation(self, kind: str, value: float, unknown: np.ndarray) -> HarmonicBifurcation:
        """A special point of this curve, where the parameter has a value."""
        problem = self._problem_at(value, unknown)
        return HarmonicBifurcation(kind=kind, value=value, problem=problem, unknown=unknown)

    # --- the equations at its points --------------------------------------------------------------

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

    def _systems(self, places: np.ndarray | None = None) -> Iterator[tuple[int, ContactSystem]]:
        """The equations for all points, or some, with their numbers; not in order."""
        wanted = np.arange(len(self)) if places is None else places
        for count in np.unique(self.harmonics[wanted]):
            family = self.equations(int(count))
            for index in wanted[self.harmonics[wanted] == count]:
                yield int(index), family.system(float(self.values[index]))

    def _linearised(self, places: np.ndarray | None = None) -> Iterator[tuple[int, ContactPoint]]:
        """The equations at all points, or some, likewise."""
        for index, system in self._systems(places):
            yield index, system.linearise(self.unknown(index))

    @property
    def _rows(self) -> int:
        return int(self.unknowns.shape[1])

    def seen_through(
        self, rows: np.ndarray
    ) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """As of any curve, by the unknowns alone."""
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

    def _columns(self) -> dict[str, np.ndarray]:
        return {name: getattr(self, name) for name in ("omega", "harmonics", "iterations")}
