"""Response curves: solutions followed over a parameter, through resonances, folds and branches.

Pseudo-arc-length continuation (:mod:`arclength`) of the condensed equations (:mod:`family`). Only
the small or reduced structure is touched at a point, in closed form: a curve costs the same on any
mesh. Along it, folds, period doublings and Neimark-Sacker points are located by root finding,
branch points by steps that shrink towards them; from those where another branch begins it can be
followed (:func:`follow_branch`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import scipy.linalg
import scipy.optimize
from tqdm import tqdm

from fenics_crack.balance.arclength import (
    PathPoint,
    Tangent,
    correct,
    follow_path,
    land,
    step_along,
    tangent_at,
)
from fenics_crack.balance.error_report import beyond_truncation, mean_square
from fenics_crack.balance.family import FAMILIES, Family
from fenics_crack.balance.fourier import resized, stretched
from fenics_crack.balance.harmonic_balance import solve_harmonic_balance
from fenics_crack.balance.rounding import EPSILON, stiffness_times_compliance
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.curve import Bifurcation, ResponseCurve
from fenics_crack.errors import ConvergenceError, InputError, check_count, check_number, check_omega
from fenics_crack.model.contact import ContactLaw, check_law
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.stability.floquet import LeadingMultiplier, PiecewiseFlow, doubling_test

__all__ = [
    "Continuation",
    "CurvePoint",
    "continue_frequency",
    "continue_parameter",
    "follow_branch",
]

Answer = TypeVar("Answer")
MOST_HARMONICS = 100
"""Beyond these a curve's harmonics are not raised."""
EVERY = 4
"""Points between two looks at the truncation."""


@dataclass(frozen=True)
class CurvePoint:
    """A point of a curve as it comes.

    Attributes
    ----------
    value, omega : float
        Of the parameter, and load frequency [rad/s].
    gap_coefficients : (2H+1, n_pairs) [m]
        Closing of the pairs.
    iterations : int
        Newton iterations.
    truncation : float
        Estimated error of the harmonics left out, or nan where it was not estimated.
    multiplier : LeadingMultiplier or None
        The Floquet multiplier of largest modulus; with ``stability=True``.
    bifurcations : tuple of (str, float)
        Kinds and parameters of the special points since the point before.
    """

    value: float
    omega: float
    gap_coefficients: np.ndarray
    iterations: int
    truncation: float = math.nan
    multiplier: LeadingMultiplier | None = None
    bifurcations: tuple[tuple[str, float], ...] = ()


class Continuation:
    """A curve that grows point by point: iterate over it, and take :attr:`curve` at any time.

        for point in Continuation(plate, law, "omega", 1000.0, 3000.0):
            ...

    Parameters
    ----------
    structure : Structure
        What vibrates. One with many dofs is reduced first (:func:`reduce_structure`, its default).
    contact : ContactLaw
        Law of all pairs.
    parameter : str
        "omega": load frequency [rad/s]; "load", "stiffness", "damping": factor of the structure's
        load, of the contact stiffness, of the structure's damping, 1 being as given; "clearance":
        added to that of every pair [m].
    start, end : float
        Its values; the end may be below the start.
    omega : float, optional
        Load frequency [rad/s] where it is not the parameter.
    harmonics, samples, subharmonic, initial
        As in :func:`solve_harmonic_balance`; ``initial`` is where to start.
    tolerance : float, optional
        Without ``samples``. Raise and lower H along the curve so that the estimated truncation
        error, looked at every fourth point, stays near or below this, between ``harmonics`` and
        100.
    stability : bool
        Compute the leading Floquet multiplier at every point, and locate where multipliers leave
        the unit circle: through -1, or the leading ones as a pair.
    longest_step : float
        Longest step, relative to the range of the parameter and to the size of the solution; at
        most 1.
    most_points : int
        Give up after so many.
    turning_back : float
        How far the curve may turn back past its start, relative to the range of the parameter; a
        closed curve can only be recognised where it may.
    resume : ResponseCurve, optional
        Go on from the last point of a curve that did not reach its end; ``start`` is then its own,
        or for a branch ``start`` and ``end`` bound the parameter; harmonics, samples, subharmonic
        and initial are left out.
    leaving : Bifurcation, optional
        Start on the branch that begins there; ``start`` and ``end`` then bound the parameter on
        either side. See :func:`follow_branch`.

    Attributes
    ----------
    complete : bool
        Whether the end was reached, or the curve closed.
    status : str
        How it ended.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No first point.
    """

    def __init__(
        self,
        structure: Structure,
        contact: ContactLaw,
        parameter: str,
        start: float,
        end: float,
        *,
        omega: float | None = None,
        harmonics: int | None = None,
        samples: int | None = None,
        subharmonic: int = 1,
        initial: PeriodicSolution | None = None,
        tolerance: float | None = None,
        stability: bool = False,
        longest_step: float = 0.05,
        most_points: int = 50000,
        turning_back: float = 0.02,
        resume: ResponseCurve | None = None,
        leaving: Bifurcation | None = None,
    ) -> None:
        if parameter not in FAMILIES:
            raise InputError("parameter", parameter, "one of " + ", ".join(map(repr, FAMILIES)))
        names = [f"{parameter}_{end}" if parameter == "omega" else end for end in ("start", "end")]
        for name, value in zip(names, (start, end), strict=True):
            FAMILIES[parameter].check(structure, name, value)
        if start == end:
            raise InputError(names[1], end, f"different from {names[0]}")
        if parameter == "omega":
            omega = start
        check_omega(omega)
        assert omega is not None
        check_number("longest_step", longest_step, 0.0, above=True)
        if longest_step > 1.0:
            raise InputError("longest_step", longest_step, "at most 1")
        check_count("subharmonic", subharmonic, 1)
        check_count("most_points", most_points, 1)
        check_number("turning_back", turning_back, 0.0)
        if tolerance is not None:
            check_number("tolerance", tolerance, 0.0, above=True)
            if samples is not None:
                raise InputError("samples", samples, "left out where a tolerance is given")
        check_law(structure, contact)
        if parameter == "load" and start * end <= 0.0 and not np.any(structure.clearance):
            allowed = "both of one sign: without clearance nothing is left of the motion at 0"
            raise InputError("start, end", (start, end), allowed)
        if resume is not None:
            given: dict[str, Any] = {"samples": samples, "initial": initial}
            given |= {"harmonics": harmonics, "subharmonic": None if subharmonic == 1 else 2}
            for key, wrong in given.items():
                if wrong is not None:
                    raise InputError(key, wrong, "left out where a curve is resumed")
        if leaving is not None and not isinstance(leaving, Bifurcation):
            raise InputError("leaving", type(leaving).__name__, "a Bifurcation")
        harmonics = max(5, subharmonic) if harmonics is None else harmonics
        check_count("harmonics", harmonics, subharmonic)
        if not is_small(structure):
            structure = reduce_structure(structure)
            if isinstance(initial, PeriodicSolution):  # its gaps are all that is used
                initial = replace(initial, structure=structure)
        self._structure, self._contact, self._name = structure, contact, parameter
        self._tolerance, self._least = tolerance, harmonics
        self._longest, self._most, self._back = longest_step, most_points, turning_back
        self._points: list[CurvePoint] = []
        self._special: list[tuple[str, float, np.ndarray]] = []
        self._both_ends = False
        self._towards: Tangent | None = None
        self._origin: PathPoint | None = None
        self.complete, self.status = False, "not begun"
        if resume is not None:
            _check_resumed(resume, structure, parameter, (start, end))
            harmonics = int(resume.harmonics[-1])
            samples, subharmonic = resume.samples, resume.subharmonic
        first: PeriodicSolution | None = None
        if resume is None and leaving is None:
            varied, law = FAMILIES[parameter].vary(structure, contact, start)
            count: int | None = harmonics
            while count is not None:
                harmonics = count
                first = initial = solve_harmonic_balance(
                    varied,
                    omega,
                    law,
                    harmonics=harmonics,
                    samples=samples,
                    subharmonic=subharmonic,
                    initial=initial,
                )
                count = _more_harmonics(harmonics, first.report.truncation, tolerance)
        self._family = FAMILIES[parameter](
            structure, omega, contact, start, end, harmonics, samples, subharmonic
        )
        self._flow = PiecewiseFlow(structure, contact) if stability else None
        if resume is not None:
            self._take_over(resume)
        elif leaving is not None:
            self._leave(leaving)
        elif first is not None:
            here = PathPoint(first.gap_coefficients, 0.0, first.iterations, _NOWHERE)
            self._points.append(self._point(here))

    @property
    def curve(self) -> ResponseCurve:
        """All points so far."""
        points, family = self._points, self._family
        counts = np.array([len(point.gap_coefficients) // 2 for point in points])
        gaps = np.array([resized(point.gap_coefficients, counts.max()) for point in points])
        multipliers = None
        if self._flow is not None:
            multipliers = np.array([p.multiplier.value for p in points if p.multiplier])
        curve = ResponseCurve(
            self._structure,
            self._contact,
            self._name,
            np.array([point.value for point in points]),
            np.array([point.omega for point in points]),
            gaps,
            counts,
            np.array([point.iterations for point in points]),
            np.array([point.truncation for point in points]),
            (),
            self.complete,
            self.status,
            family.samples,
            family.subharmonic,
            multipliers,
            self._both_ends,
        )
        return replace(curve, bifurcations=curve.expand_bifurcations(self._special))

    def progress(self) -> float:
        """How much of the way from start to end has been gone, 0 to 1."""
        return min(1.0, max(0.0, self._family.parameter(self._points[-1].value)))

    def __iter__(self) -> Iterator[CurvePoint]:
        """Yield the first point, or the last one of a resumed curve, and all that follow."""
        yield self._points[-1]
        if self.complete:
            return
        last = self._points[-1]
        here = self._with_tangent(last.gap_coefficients, last.value, self._towards)
        self._origin = self._origin or here
        self.status = "the steps became too short"
        step: float | None = 0.2 * self._longest
        while step is not None and not self.complete:
            here, step = yield from self._follow(here, step)

    def _with_tangent(self, gap: np.ndarray, value: float, towards: Tangent | None) -> PathPoint:
        """A point with its tangent, in a direction known roughly."""
        parameter = self._family.parameter(value)
        self._family.set_parameter(parameter)
        tangent = tangent_at(self._family, gap)
        if towards is not None and tangent.along(towards, self._family) < 0.0:
            tangent = tangent.reversed()
        return PathPoint(gap, parameter, 0, tangent)

    def _follow(
        self, here: PathPoint, step: float
    ) -> Generator[CurvePoint, None, tuple[PathPoint, float | None]]:
        """Follow the path with one number of harmonics; return where and how to go on, or None."""
        before, rounding = here, self._rounding()
        path = follow_path(
            self._family,
            here.unknown,
            here.parameter,
            step=step,
            longest_step=self._longest,
            most_steps=self._most,
            tolerance=max(1e-9, rounding),
            shortest_step=1e-10,
            least_cosine=0.85,
            rounding=rounding,
            towards=here.tangent,
        )
        for point in path:
            special = self._special_points(before, point)
            ended, end = self._ended(before, point)
            if ended and end is None:
                return here, None
            point = end or point
            found = self._point(point)
            if self._flow is not None:
                special += self._changes(before, point, self._points[-1], found)
            self._special += [
                (kind, self._family.value(at.parameter), at.unknown) for kind, at in special
            ]
            values = tuple((kind, self._family.value(at.parameter)) for kind, at in special)
            found = replace(found, bifurcations=values)
            if self._tolerance is not None and len(self._points) % EVERY == 0:
                found = replace(found, truncation=self._truncation(point))
            self._points.append(found)
            self._towards = point.tangent
            yield found
            if ended:
                return here, None
            if len(self._points) > self._most:
                self.status = f"{self._most} points were not enough"
                return here, None
            step, before = self._distance(before, point), point
            if self._change_harmonics(found.truncation):
                again = self._again(point)
                if again is None:
                    self.status = f"no solution with H = {self._family.harmonics}"
                    return here, None
                self._towards = again.tangent
                return again, max(0.1 * step, 1e-3 * self._longest)
        return here, None

    def _rounding(self) -> float:
        """What rounding leaves of a residual: see :meth:`Search.penalty`."""
        law = self._contact
        if self._name == "stiffness":
            law = law.scaled(max(self._family.start, self._family.end))
        stiff = stiffness_times_compliance(self._family.system, law)
        return max(1e-13, min(1e-5, 4.0 * EPSILON * stiff))

    # --- one point --------------------------------------------------------------------------------

    def _point(self, point: PathPoint) -> CurvePoint:
        family = self._family
        value = family.value(point.parameter)
        multiplier = None
        if self._flow is not None:
            multiplier = self._at(point, PiecewiseFlow.leading)
        return CurvePoint(
            value, family.omega(value), point.unknown, point.iterations, multiplier=multiplier
        )

    def _at(
        self, point: PathPoint, ask: Callable[[PiecewiseFlow, np.ndarray, float], Answer]
    ) -> Answer:
        """What the flow at a point says."""
        assert self._flow is not None
        family, flow = self._family, self._flow
        value = family.value(point.parameter)
        if self._name in ("stiffness", "damping"):
            flow = PiecewiseFlow(*family.vary(self._structure, self._contact, value))
        return ask(flow, point.unknown, family.omega(value) / family.subharmonic)

    def _truncation(self, point: PathPoint) -> float:
        self._family.set_parameter(point.parameter)
        system = self._family.system
        system.linearise(point.unknown)
        change = beyond_truncation(system, point.unknown)
        closing = point.unknown.copy()
        closing[0] += self._structure.clearance
        size = mean_square(closing)
        return math.sqrt(mean_square(change) / size) if size > 0.0 else 0.0

    def _change_harmonics(self, truncation: float) -> bool:
        """Raise or lower H by the truncation's estimate; True where it has changed."""
        if self._tolerance is None or math.isnan(truncation):
            return False
        count = self._family.harmonics
        wanted = _more_harmonics(count, truncation, self._tolerance)
        if wanted is None and truncation < 0.05 * self._tolerance:
            wanted = max(self._least, math.floor(0.8 * count))
        if wanted in (None, count):
            return False
        self._family = self._family.with_harmonics(int(wanted or count))
        return True

    def _again(self, point: PathPoint) -> PathPoint | None:
        """The point with other harmonics, in the plane across the path."""
        family = self._family
        count = family.harmonics
        tangent = replace(point.tangent, x=resized(point.tangent.x, count))
        start = replace(point, unknown=resized(point.unknown, count))
        tolerance = max(1e-9, self._rounding())
        found = correct(family, start, tangent, 0.0, tolerance, reach=self._longest)
        return found and replace(found, tangent=tangent)

    # --- where it ends ----------------------------------------------------------------------------

    def _ended(self, before: PathPoint, point: PathPoint) -> tuple[bool, PathPoint | None]:
        """Whether the curve ends here, and its last point if that is not the one before."""
        for end in (1.0, 0.0):
            inside = point.parameter < 1.0 if end else point.parameter > 0.0
            if inside or (end == 0.0 and not self._both_ends):
                continue
            landed = land(self._family, before, point, end, max(1e-10, self._rounding()))
            self.complete = landed is not None
            self.status = "reached the end" if self.complete else "no solution at the very end"
            return True, landed
        if point.parameter < -self._back:
            self.status = "the curve turned back past its start"
            return True, None
        if self._closes(before, point):
            self.complete, self.status = True, "closed loop"
            return True, self._origin
        if self._joins(before, point):
            self.complete, self.status = True, "joined the branch that it left"
            return True, None
        return False, None

    def _closes(self, before: PathPoint, point: PathPoint) -> bool:
        """Whether the first point lies between two others."""
        family, origin, tangent = self._family, self._origin, before.tangent
        if origin is None or len(self._points) < 4 or origin.unknown.shape != point.unknown.shape:
            return False
        back, rise = origin.unknown - before.unknown, origin.parameter - before.parameter
        along = tangent.weight * family.inner(back, tangent.x) + rise * tangent.p
        distance = math.sqrt(tangent.weight * family.inner(back, back) + rise**2)
        if not 0.0 < along <= self._distance(before, point) or along < 0.9 * distance:
            return False
        met = step_along(family, before, along, 1e-9)
        if met is None or met.tangent.along(origin.tangent, family) < 0.9:
            return False
        off = family.inner(met.unknown - origin.unknown, met.unknown - origin.unknown)
        return off < 1e-10 * family.inner(origin.unknown, origin.unknown)

    def _joins(self, before: PathPoint, point: PathPoint) -> bool:
        """Whether what tells a branch from the one that it left has changed its sign."""
        if not self._both_ends or before.unknown.shape != point.unknown.shape:
            return False
        odd = _odd_rows(self._family)
        return bool(np.any(odd)) and float(np.vdot(before.unknown[odd], point.unknown[odd])) < 0.0

    def _distance(self, before: PathPoint, after: PathPoint) -> float:
        change = after.unknown - before.unknown
        square = before.tangent.weight * self._family.inner(change, change)
        return math.sqrt(square + (after.parameter - before.parameter) ** 2)

    # --- special points ---------------------------------------------------------------------------

    def _special_points(self, before: PathPoint, point: PathPoint) -> list[tuple[str, PathPoint]]:
        found = []
        if point.crosses_branch:
            found.append(("branch_point", point))
        if point.tangent.p * before.tangent.p < 0.0:
            fold = self._locate(before, point, lambda at: at.tangent.p)
            found.append(("fold", fold))
        return found

    def _changes(
        self, before: PathPoint, after: PathPoint, old: CurvePoint, new: CurvePoint
    ) -> list[tuple[str, PathPoint]]:
        """Where multipliers cross the unit circle at -1, or as a pair, between two points."""

        def at(test: Callable[[np.ndarray], float]) -> Callable[[PathPoint], float]:
            return lambda point: test(self._at(point, PiecewiseFlow.multipliers))

        first, second = old.multiplier, new.multiplier
        assert first is not None and second is not None
        found = []
        if first.doubling * second.doubling < 0.0:
            found.append(("period_doubling", self._locate(before, after, at(doubling_test))))
        unstable = second if first.stable else first
        left = first.stable != second.stable and first.doubling == second.doubling
        if left and unstable.value.imag > 0.0:
            found.append(("neimark_sacker", self._locate(before, after, at(_pair))))
        return found

    def _locate(
        self, before: PathPoint, after: PathPoint, test: Callable[[PathPoint], float]
    ) -> PathPoint:
        """Point between two others where a test function vanishes, by the method of Brent.

        Where that fails, the point met at which the function is smallest.
        """
        met, sharp = [before, after], max(1e-11, self._rounding())

        def value(step: float) -> float:
            point = before if step == 0.0 else step_along(self._family, before, step, sharp)
            if point is None:
                raise ConvergenceError("curve: lost between two points")
            met.append(point)
            return test(point)

        distance = self._distance(before, after)
        for reach in (1.0, 1.2, 0.8, 1.5):  # along the tangent the other point is not quite as far
            try:
                scipy.optimize.brentq(value, 0.0, reach * distance, xtol=1e-12, rtol=1e-12)
                break
            except (ConvergenceError, ValueError):
                continue
        return min(met, key=lambda point: abs(test(point)))

    # --- going on from elsewhere ------------------------------------------------------------------

    def _take_over(self, curve: ResponseCurve) -> None:
        """Begin with the points of another curve, on its way."""
        for index in range(len(curve)):
            multiplier = None
            if self._flow is not None:
                parameter = self._family.parameter(float(curve.values[index]))
                here = PathPoint(curve.gap(index), parameter, 0, _NOWHERE)
                multiplier = self._at(here, PiecewiseFlow.leading)
            self._points.append(
                CurvePoint(
                    float(curve.values[index]),
                    float(curve.omega[index]),
                    curve.gap(index),
                    int(curve.iterations[index]),
                    float(curve.truncation[index]),
                    multiplier,
                )
            )
        self._special = [(b.kind, b.value, b.gap_coefficients) for b in curve.bifurcations]
        self._both_ends = curve.branch
        if len(curve) > 1:
            self._towards = self._chord(curve, -2, -1)
            if len(curve.gap(0)) == len(curve.gap(-1)):
                first, value = curve.gap(0), float(curve.values[0])
                self._origin = self._with_tangent(first, value, self._chord(curve, 0, 1))
        last = curve.gap(-1)
        self._family.set_parameter(self._family.parameter(float(curve.values[-1])))
        residual = self._family.residual(last)
        allowed = max(1e-6, self._rounding()) * np.linalg.norm(last)
        if not np.linalg.norm(residual) <= allowed:
            raise InputError("resume", "a curve of another problem", "of this structure and law")

    def _chord(self, curve: ResponseCurve, first: int, second: int) -> Tangent:
        """From one point of a curve to another."""
        after = curve.gap(second)
        before = resized(curve.gap(first), len(after) // 2)
        values = self._family.parameter(curve.values[first]), curve.values[second]
        rise = self._family.parameter(values[1]) - values[0]
        return Tangent(after - before, float(rise), 1.0 / max(float(np.vdot(after, after)), 1e-300))

    def _leave(self, bifurcation: Bifurcation) -> None:
        """Begin with a point on the branch that begins at a bifurcation.

        The new direction is the null vector of the Jacobian [J, F_p] across the old branch; for a
        period doubling it lies in the odd harmonics of twice the period.

        Raises
        ------
        ConvergenceError
            No point of another branch was found.
        """
        family = self._family
        factor = family.harmonics // (len(bifurcation.gap_coefficients) // 2)
        unknown = stretched(bifurcation.gap_coefficients, factor)
        parameter = family.parameter(bifurcation.value)
        family.set_parameter(parameter)
        old = tangent_at(family, unknown)
        odd = _odd_rows(family) if factor > 1 else np.ones(len(unknown), dtype=bool)
        places = np.flatnonzero(np.repeat(odd, unknown.shape[1]))
        family.linearise(unknown)
        jacobian = family.system.jacobian[np.ix_(places, places)]
        across = np.zeros(unknown.size)
        if factor > 1:
            across[places] = scipy.linalg.svd(jacobian)[2][-1]
            slope = 0.0
        else:
            derivative = family.parameter_derivative(unknown).reshape(-1, 1)
            size = math.sqrt(old.weight)  # the parameter in the units of the gap
            null = scipy.linalg.svd(np.hstack([jacobian, derivative * size]))[2][-2:]
            back = np.append(old.x.ravel(), old.p / size)
            mix = null @ back
            vector = mix[1] * null[0] - mix[0] * null[1]  # in the null space, across the old branch
            across, slope = vector[:-1], vector[-1] * size
        away = Tangent(across.reshape(unknown.shape), float(slope), old.weight)
        length = math.sqrt(away.weight * family.inner(away.x, away.x) + away.p**2)
        away = replace(away, x=away.x / length, p=away.p / length)
        start = PathPoint(unknown, parameter, 0, away)
        for share in (0.1, 0.03, 0.3, 0.01, 1.0):
            step = share * self._longest
            found = correct(family, start, away, step, 1e-9, reach=self._longest)
            if found is not None and self._distance(start, found) < 3.0 * step:
                self._points.append(self._point(found))
                change = found.unknown - unknown
                rise = found.parameter - parameter
                self._towards = Tangent(change, rise, away.weight)
                self._both_ends = True
                return
        raise ConvergenceError(
            f"branch from {bifurcation.kind} at {family.name} = {bifurcation.value:g}: "
            "no point of another branch was found next to it"
        )


_NOWHERE = Tangent(np.zeros(0), 0.0, 0.0)


def continue_frequency(
    structure: Structure,
    omega_start: float,
    omega_end: float,
    contact: ContactLaw,
    *,
    progress: bool = False,
    throw: bool = True,
    **options: Any,
) -> ResponseCurve:
    """Follow the response from one load frequency to another, through resonances and folds.

    Parameters
    ----------
    structure : Structure
        What vibrates. One with many dofs is reduced first (:func:`reduce_structure`, its default).
    omega_start, omega_end : float
        Load frequencies [rad/s]; the end may be below the start.
    contact : ContactLaw
        Law of all pairs.
    progress : bool
        Show a progress bar.
    throw : bool
        Raise if the end is not reached; else return what was found, ``complete`` being False.
        Ctrl-C always returns what was found.
    **options
        As in :class:`Continuation`: harmonics, samples, subharmonic, initial, tolerance, stability,
        longest_step, most_points, turning_back, resume.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No first point, or the end was not reached.
    """
    growing = Continuation(structure, contact, "omega", omega_start, omega_end, **options)
    return _run(growing, progress, throw)


def continue_parameter(
    structure: Structure,
    omega: float,
    contact: ContactLaw,
    parameter: str,
    start: float,
    end: float,
    *,
    progress: bool = False,
    throw: bool = True,
    **options: Any,
) -> ResponseCurve:
    """Follow the response at one load frequency over another parameter.

    Parameters
    ----------
    structure, contact, progress, throw, options
        As in :func:`continue_frequency`.
    omega : float
        Load frequency [rad/s].
    parameter : "load", "stiffness", "damping" or "clearance"
        As in :class:`Continuation`.
    start, end : float
        Its values.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No first point, or the end was not reached.
    """
    growing = Continuation(structure, contact, parameter, start, end, omega=omega, **options)
    return _run(growing, progress, throw)


def follow_branch(
    curve: ResponseCurve,
    bifurcation: Bifurcation,
    start: float | None = None,
    end: float | None = None,
    *,
    progress: bool = False,
    throw: bool = True,
    **options: Any,
) -> ResponseCurve:
    """Follow the branch that begins at a period doubling, or crosses at a branch point.

    The doubled branch has twice the period and twice as many harmonics. It is followed in one
    direction, until the parameter leaves the range or the branch joins the old one again; the
    other direction of a doubled branch is the same orbits half a period later.

    Parameters
    ----------
    curve : ResponseCurve
        The old branch.
    bifurcation : Bifurcation
        One of its bifurcations, of kind "period_doubling" or "branch_point".
    start, end : float, optional
        Range of the parameter; default: the curve's own.
    progress, throw, options
        As in :func:`continue_frequency`; harmonics, samples and subharmonic follow from the curve.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No branch was found, or its end was not reached.
    """
    kinds = ("period_doubling", "branch_point")
    if not isinstance(curve, ResponseCurve):
        raise InputError("curve", type(curve).__name__, "a ResponseCurve")
    if not isinstance(bifurcation, Bifurcation) or bifurcation.kind not in kinds:
        kind = getattr(bifurcation, "kind", type(bifurcation).__name__)
        raise InputError("bifurcation", kind, "a Bifurcation of kind " + " or ".join(kinds))
    for key in ("harmonics", "samples", "subharmonic", "initial", "resume", "leaving"):
        if key in options:
            raise InputError(key, options[key], "left out: it follows from the curve")
    doubled = 2 if bifurcation.kind == "period_doubling" else 1
    bounds = float(curve.values.min()), float(curve.values.max())
    start = bounds[0] if start is None else start
    end = bounds[1] if end is None else end
    if not min(start, end) < bifurcation.value < max(start, end):
        raise InputError("start, end", (start, end), f"on either side of {bifurcation.value:g}")
    growing = Continuation(
        curve.structure,
        curve.contact,
        curve.parameter,
        start,
        end,
        omega=bifurcation.omega,
        harmonics=doubled * (len(bifurcation.gap_coefficients) // 2),
        samples=curve.samples and doubled * curve.samples,
        subharmonic=doubled * curve.subharmonic,
        leaving=bifurcation,
        **options,
    )
    return _run(growing, progress, throw)


def _run(growing: Continuation, progress: bool, throw: bool) -> ResponseCurve:
    """Follow to the end."""
    hidden = not progress or growing.curve.structure.whole.comm.rank != 0
    bar = tqdm(total=100.0, desc="curve", unit="%", disable=hidden, bar_format="{l_bar}{bar}")
    try:
        for _ in growing:
            if not hidden:
                bar.update(max(0.0, 100.0 * growing.progress() - bar.n))
    except KeyboardInterrupt:
        growing.status, throw = "interrupted", False
    except ConvergenceError as error:
        growing.status = str(error)
    finally:
        bar.close()
    curve = growing.curve
    if throw and not curve.complete:
        raise ConvergenceError(
            f"curve in {curve.parameter} from {curve.values[0]:g}: {curve.status} at "
            f"{curve.values[-1]:g} after {len(curve)} points"
        )
    return curve


def _more_harmonics(count: int, truncation: float, tolerance: float | None) -> int | None:
    """As many harmonics as an error that falls like H^-3 asks for; None where these are enough."""
    if tolerance is None or truncation <= tolerance or count >= MOST_HARMONICS:
        return None
    factor = min(2.0, 1.1 * (truncation / tolerance) ** (1.0 / 3.0))
    return min(MOST_HARMONICS, math.ceil(factor * count))


def _odd_rows(family: Family) -> np.ndarray:
    """Rows of the harmonics that a response of half the period has not: (2H+1,) bool."""
    row = np.arange(2 * family.harmonics + 1)
    return ((row + 1) // 2) % 2 == 1 if family.subharmonic % 2 == 0 else np.zeros(len(row), bool)


def _check_resumed(
    curve: ResponseCurve, structure: Structure, parameter: str, span: tuple[float, float]
) -> None:
    if not isinstance(curve, ResponseCurve) or curve.complete:
        raise InputError("resume", type(curve).__name__, "a ResponseCurve that is not complete")
    if curve.structure.n_pairs != structure.n_pairs or curve.parameter != parameter:
        raise InputError("resume", f"curve in {curve.parameter}", "a curve of this problem")
    first, last = float(curve.values[0]), float(curve.values[-1])
    if curve.branch:
        if not min(span) < last < max(span):
            raise InputError("start, end", span, f"on either side of {last:g}")
    elif not math.isclose(span[0], first, rel_tol=1e-9):
        raise InputError("start", span[0], f"where the resumed curve starts, {first:g}")


def _pair(multipliers: np.ndarray) -> float:
    """Largest modulus of the complex multipliers less one."""
    paired = multipliers[np.abs(multipliers.imag) > 1e-6 * np.abs(multipliers)]
    return float(np.abs(paired).max() - 1.0) if len(paired) else -1.0
