"""Response curves: solutions followed over a parameter, through resonances, folds and branches.

Pseudo-arc-length continuation (:mod:`path`) of the condensed equations (:mod:`family`). Only
the small or reduced structure is touched at a point, in closed form: a curve costs the same on any
mesh. Along it folds are located by root finding, branch points by steps that shrink towards them
(:mod:`beginnings`). Verdicts come after it (:mod:`exact`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from fenics_crack.balance.harmonic_balance import check_initial
from fenics_crack.balance.problem import ON_PATH, Problem, check_memory
from fenics_crack.balance.solution import PeriodicSolution, Solver
from fenics_crack.curves.beginnings import check_resumed, directions, first_of_branch, odd_rows
from fenics_crack.curves.curve import parameter_axis
from fenics_crack.curves.exact import FOLLOWED, judge_curve
from fenics_crack.curves.family import FAMILIES, Family
from fenics_crack.curves.harmonic_curve import (
    CurvePoint,
    HarmonicBifurcation,
    HarmonicCurve,
    columns,
)
from fenics_crack.errors import MOST_HARMONICS, InputError, check_choice, check_count, check_number
from fenics_crack.model.contact import is_rigid
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.motion.flow import exact_flow
from fenics_crack.numerics.equations import System
from fenics_crack.numerics.newton import PathPoint, Tangent, point_on_path
from fenics_crack.numerics.path import (
    ARRIVED,
    BranchPoint,
    Closed,
    Ended,
    Ends,
    Event,
    Fold,
    Path,
    PathOptions,
    Stretch,
    Target,
)
from fenics_crack.table import counted, in_unit

LONGEST_STEP = 0.05
"""Longest step, unless another one is asked for."""


class Continuation:
    """A curve that grows point by point: iterate over it, and take its ``curve`` at any time.

        for point in Continuation(Problem(plate, 1000.0, law), "omega", 1000.0, 3000.0):
            ...

    Parameters
    ----------
    problem : Problem
        What is solved at the first point. A structure with many dofs is reduced first, to lips
        without mass (``reduce_structure(structure, method="massless")``); ``omega`` counts where it
        is not the parameter. Modes that answer at once do so for all of the curve: those above
        ``static_above``, by default 2 H times the highest base frequency, with the first point's H.
    parameter : str
        "omega": load frequency [rad/s]; "load", "stiffness", "damping": factor of the structure's
        load, of the contact stiffness, of the structure's damping, 1 being as given; "clearance":
        added to that of every pair [m]; "speed": of the rotor [rad/s], which ``omega`` follows.
    start, end : float
        Its values; the end may be below the start.
    initial : PeriodicSolution, HarmonicCurve or HarmonicBifurcation, optional
        Where to start. A solution: near the first point. A curve that did not reach its end: from
        its last point; ``start`` is then its own, or for a branch ``start`` and ``end`` bound the
        parameter. A bifurcation: on the branch that begins there; ``start`` and ``end`` bound the
        parameter on either side (:func:`follow_branch`).
    tolerance : float, optional
        Without ``samples``. Choose H, between the problem's ``harmonics`` and 100, so that the
        estimated truncation error of the first point is below this.
    stability : bool
        Judge ``curve`` each time that it is taken (:func:`judge_curve`).
    longest_step : float
        Longest step, relative to the range of the parameter and to the size of the solution; at
        most 1.
    most_points : int
        Give up after so many.
    turning_back : float
        How far the curve may turn back past its start, relative to the range of the parameter, but
        not to a frequency or a damping of zero; a closed curve can only be recognised where it may.

    Attributes
    ----------
    complete : bool
        Whether the end was reached, or the curve closed.
    returned : bool
        Whether the curve came back to its start, or went past it, instead of reaching the end.
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
        problem: Problem,
        parameter: str,
        start: float,
        end: float,
        *,
        initial: PeriodicSolution | HarmonicCurve | HarmonicBifurcation | None = None,
        tolerance: float | None = None,
        stability: bool = False,
        longest_step: float = LONGEST_STEP,
        most_points: int = 50000,
        turning_back: float = 0.1,
    ) -> None:
        if problem.samples is not None:
            check_count("samples", problem.samples, 4 * problem.harmonics + 1)
        if tolerance is not None:
            check_number("tolerance", tolerance, 0.0, above=True)
            if problem.samples is not None:
                raise InputError("samples", problem.samples, "left out where a tolerance is given")
        large = not is_small(problem.structure)
        problem, self._back = checked(
            problem, parameter, start, end, longest_step, most_points, turning_back
        )
        if large and isinstance(initial, PeriodicSolution):  # its gaps are all that is used
            initial = replace(initial, structure=problem.structure)
        if stability and is_rigid(problem.contact):
            exact_flow(problem.structure, problem.contact)
        self._longest, self._most = longest_step, most_points
        self._at_once, self._judged = False, stability
        self._points: list[CurvePoint] = []
        self._special: list[tuple[str, float, np.ndarray]] = []
        self._branch = False
        self._towards: Tangent | None = None
        self._origin: PathPoint | None = None
        self.complete, self.returned, self.status = False, False, "not begun"

        def family_of(problem: Problem) -> Family:
            return FAMILIES[parameter](problem, start, end)

        if isinstance(initial, HarmonicCurve):
            self._family = family_of(problem.with_harmonics(int(initial.harmonics[-1])))
            self._take_over(initial)
        elif isinstance(initial, HarmonicBifurcation):
            self._family, self._branch = family_of(problem), True
            begun = first_of_branch(self._family, initial, longest_step)
            self._towards = begun.tangent
            unknown, place, iterations = begun.unknown, begun.parameter, begun.iterations
        else:
            place, found = 0.0, _first_solution(problem, family_of, initial, tolerance)
            self._family, unknown, iterations = found
        if not self._points:
            value = self._family.value(place)
            self._points.append(CurvePoint(value, self._family.omega(value), unknown, iterations))

    @property
    def curve(self) -> HarmonicCurve:
        """All points so far; judged with ``stability=True``."""
        return judge_curve(self.followed) if self._judged else self.followed

    @property
    def followed(self) -> HarmonicCurve:
        """All points so far, without verdicts."""
        problem = self._family.problem
        curve = HarmonicCurve(
            structure=problem.structure,
            contact=problem.contact,
            parameter=self._family.name,
            **columns(self._points),
            bifurcations=(),
            complete=self.complete,
            status=self.status,
            samples=problem.samples,
            subharmonic=problem.subharmonic,
            branch=self._branch,
            static_above=problem.static_cutoff,
        )
        special = tuple(curve.bifurcation(*one) for one in self._special)
        return replace(curve, bifurcations=special)

    @property
    def size(self) -> int:
        """Unknowns of a point."""
        return int(np.prod(self._family.shape))

    def progress(self) -> float:
        """How much of the way from start to end has been gone, 0 to 1."""
        return min(1.0, max(0.0, self._family.parameter(self._points[-1].value)))

    def how_far(self) -> str:
        """The same in words, with the range and how many points there are."""
        ends = in_unit(
            parameter_axis(self._family.name, True), self._family.start, self._family.end
        )
        points = counted(len(self._points), "point")
        return f"{self.progress():.0%} of the way between {ends}, {points}"

    def __iter__(self) -> Iterator[CurvePoint]:
        """Yield the first point, or the last one of a resumed curve, and all that follow."""
        last, family = self._points[-1], self._family
        yield last
        if self.complete:
            return
        here = point_on_path(family, last.unknown, family.parameter(last.value), self._towards)
        self._origin, self.status = self._origin or here, "under way"
        path = self._path(here)
        for stretch in path:
            for part in [stretch] if self._at_once else stretch.singly():
                yield self._record(part)
        assert path.ended is not None
        self.complete = path.event is not None
        self.status = path.event.told if path.event else path.ended.told(self._most)
        self.returned = path.ended is Ended.LEFT or isinstance(path.event, Closed)

    def run(self) -> None:
        """Follow to the end: as iterating over all points does, but faster, since those between
        which nothing happens are recorded many at once."""
        self._at_once = True
        try:
            for _ in self:
                pass
        finally:
            self._at_once = False

    def _path(self, here: PathPoint) -> Path:
        """The path behind a point, to where the curve ends."""
        events: list[Event] = [Fold(), BranchPoint(), Target(1.0)]
        if self._branch:
            events.append(Target(0.0))
            if np.any(odd := odd_rows(self._family)):
                events.append(_Joined(odd))
        if self._origin is not None and self._origin.unknown.shape == here.unknown.shape:
            events.append(Closed(self._origin, self._family))
        options = PathOptions(
            initial_step=0.2 * self._longest,
            max_step=self._longest,
            min_step=max(1e-10, self._family.rounding(here.parameter)),
            max_steps=self._most + 1 - len(self._points),
            at_once=max(1, min(PathOptions.at_once, ON_PATH // here.unknown.size)),
            span=(-self._back, np.inf),
        )
        return Path(self._family, here, options, events)

    def _record(self, points: Stretch) -> CurvePoint:
        """Take up points, and what lies before the last of them; return that one."""
        value, omega = self._family.value, self._family.omega
        special = [
            (event.kind, value(at.parameter), at.unknown) for event, at in points.met if event.kind
        ]
        self._special += special
        self._towards = points[-1].tangent
        places = map(value, points.parameters.tolist())
        for there, unknown, count in zip(places, points.unknowns, points.iterations, strict=True):
            self._points.append(CurvePoint(there, omega(there), unknown, int(count)))
        met = tuple((kind, there) for kind, there, _ in special)
        self._points[-1] = replace(self._points[-1], bifurcations=met)
        return self._points[-1]

    # --- going on ---------------------------------------------------------------------------------

    def _take_over(self, curve: HarmonicCurve) -> None:
        """Begin with the points of another curve, on its way."""
        check_resumed(curve, self._family)
        self._points = [curve.point(index) for index in range(len(curve))]
        self._special = [
            (b.kind, b.value, b.unknown) for b in curve.bifurcations if b.kind in FOLLOWED
        ]
        self._branch = curve.branch
        self._towards, self._origin = directions(self._family, curve)


def _first_solution(
    problem: Problem,
    family_of: Callable[[Problem], Family],
    initial: PeriodicSolution | None,
    tolerance: float | None,
) -> tuple[Family, np.ndarray, int]:
    """The family, with as many harmonics as a tolerance asks for at its start, the unknowns there
    and the iterations that they took."""
    while True:
        family = family_of(problem)
        first, count = family.at(family.start), problem.harmonics
        check_memory(first.structure, count)
        if initial is not None:
            check_initial(first, initial)
        initial = Solver(first).solve(initial, reported=tolerance is not None)
        more = more_harmonics(count, initial.report.truncation, tolerance)
        if more is None:
            return family, initial.slow_gap_coefficients, initial.iterations
        problem = problem.with_harmonics(more)


def more_harmonics(count: int, truncation: float, tolerance: float | None) -> int | None:
    """As many harmonics as an error that falls like H^-3 asks for; None where these are enough, or
    the most."""
    if tolerance is None or truncation <= tolerance or count >= MOST_HARMONICS:
        return None
    factor = min(2.0, 1.1 * (truncation / tolerance) ** (1.0 / 3.0))
    return min(MOST_HARMONICS, math.ceil(factor * count))


class _Joined(Event):
    """Where what tells a branch from the one that it left vanishes; the branch ends with the point
    before. It changes its sign there; where nothing is left of much of it, a step led onto the old
    branch, and shorter ones come nearer."""

    terminal, sought, told = True, True, "joined the branch that it left"

    def __init__(self, odd: np.ndarray) -> None:
        self._odd = odd

    def between(self, points: Stretch) -> np.ndarray:
        odd = points.unknowns[:, self._odd].reshape(len(points), -1)
        turned = np.einsum("ij,ij->i", odd[1:], odd[:-1]) < 0.0
        return np.asarray(turned | (self._share(points.unknowns[1:]) <= ARRIVED))

    def locate(self, system: System, ends: Ends, rtol: float) -> PathPoint | None:
        before, after = self._share(np.array([one.unknown for one in ends]))
        return ends[0] if after > ARRIVED or before <= math.sqrt(ARRIVED) else None

    def _share(self, unknowns: np.ndarray) -> np.ndarray:
        """The size of what tells points from the branch that was left, relative to theirs: (n,)."""
        odd = np.linalg.norm(unknowns[:, self._odd], axis=(1, 2))
        return np.asarray(odd / np.linalg.norm(unknowns, axis=(1, 2)))


def checked(
    problem: Problem,
    parameter: str,
    start: float,
    end: float,
    longest_step: float,
    most_points: int,
    turning_back: float,
) -> tuple[Problem, float]:
    """The problem at the start of a curve, of a small structure, and how far the curve may turn
    back; InputError where an argument cannot be used."""
    check_range(problem, parameter, start, end)
    check_number("longest_step", longest_step, 0.0, above=True)
    if longest_step > 1.0:
        raise InputError("longest_step", longest_step, "at most 1")
    check_count("most_points", most_points, 1)
    check_number("turning_back", turning_back, 0.0)
    if parameter in ("omega", "speed"):
        problem = FAMILIES[parameter].vary(problem, start)
    if not is_small(problem.structure):
        reduced = reduce_structure(problem.structure, method="massless")
        problem = replace(problem, structure=reduced)
    if 0.0 < start < end and parameter in ("omega", "damping", "speed"):  # not to 0
        turning_back = min(turning_back, 0.9 * start / (end - start))
    return problem, turning_back


def check_range(problem: Problem, parameter: str, start: float, end: float) -> None:
    """Raise InputError unless a curve can go from one value of a parameter to another."""
    structure = problem.structure
    check_choice("parameter", parameter, FAMILIES)
    if is_rigid(problem.contact) and parameter == "stiffness":
        raise InputError("parameter", parameter, "another one: a rigid contact has no stiffness")
    names = ("omega_start", "omega_end") if parameter == "omega" else ("start", "end")
    for name, value in zip(names, (start, end), strict=True):
        FAMILIES[parameter].check(structure, name, value)
    if start == end:
        raise InputError(names[1], end, f"different from {names[0]}")
    if parameter == "load" and start * end <= 0.0 and not np.any(structure.clearance):
        allowed = "both of one sign: without clearance nothing is left of the motion at 0"
        raise InputError("start, end", (start, end), allowed)
