"""Response curves: solutions followed over a parameter, through resonances, folds and branches.

Pseudo-arc-length continuation (:mod:`fenics_crack.numerics.path`) of a system
(:mod:`curve_system`): of the condensed equations of harmonic balance (:mod:`waves`), or of exact
periodic orbits (:mod:`orbits`). Only the small or reduced structure is touched at a point, in
closed form: a curve costs the same on any mesh.

Along a curve of harmonic balance folds are located by root finding, branch points by steps that
shrink towards them, by the sign of det J, so only where J is formed
(:data:`fenics_crack.balance.contact_system.MATRIX_FREE`); verdicts come after it
(:mod:`verdicts`). Of orbits Newton's method forms the monodromy matrix of each point for its
tangent: multipliers, steps that resolve them, and all bifurcations (:mod:`orbit_events`) cost its
eigenvalues.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypedDict, Unpack

import numpy as np

from fenics_crack.balance.harmonic_balance import check_initial, initial_orbit, solve_beside
from fenics_crack.balance.problem import Problem, check_memory
from fenics_crack.balance.solution import PeriodicSolution, Solver
from fenics_crack.basics.errors import (
    TOLERANCE,
    ConvergenceError,
    InputError,
    check_choice,
    check_count,
    check_number,
)
from fenics_crack.basics.suggestions import fitting_argument
from fenics_crack.basics.tables import counted, in_unit
from fenics_crack.curves.branch import Joined, branch_start
from fenics_crack.curves.curve import (
    MIN_HARMONICS,
    Bifurcation,
    CurvePoint,
    ResponseCurve,
    leading,
    parameter_axis,
)
from fenics_crack.curves.curve_system import CurveSystem
from fenics_crack.curves.orbits import system_along
from fenics_crack.curves.verdicts import judge_curve
from fenics_crack.curves.waves import WAVES
from fenics_crack.model.contact import is_rigid
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.motion.flow import exact_flow, flow_of
from fenics_crack.motion.orbit import MAX_MODES_FOR_MONODROMY, PeriodicOrbit, is_too_slow
from fenics_crack.numerics.newton import PathPoint, Tangent, tangent_of
from fenics_crack.numerics.path import (
    ARRIVAL_DISTANCE,
    ClosedLoop,
    EndReason,
    Event,
    Path,
    PathOptions,
    PathSegment,
    Target,
    observe_point,
)


class StepOptions(TypedDict, total=False):
    """Options of the :class:`Steps` of a curve, by their names."""

    longest_step: float
    most_points: int
    turning_back: float


@dataclass(frozen=True)
class Steps:
    """Length and number of steps of a curve, as in :class:`Continuation`."""

    longest_step: float = 0.05
    most_points: int = 50_000
    turning_back: float = 0.1

    def __post_init__(self) -> None:
        check_number("longest_step", self.longest_step, 0.0, above=True)
        if self.longest_step > 1.0:
            raise InputError("longest_step", self.longest_step, "at most 1")
        check_count("most_points", self.most_points, 1)
        check_number("turning_back", self.turning_back, 0.0)


class GrowingCurve:
    """A curve of any system that grows from a first point: iterate over it, or :meth:`run` it.

    Parameters
    ----------
    system : CurveSystem
        Its equations, followed from there to p = 1; a branch goes to p = 0, too.
    here : PathPoint
        The first point, with the direction.
    steps : Steps
    tolerance : float, optional
        Of curves of exact orbits.
    branch : bool
        True if it has left another curve.

    Attributes
    ----------
    system : CurveSystem
    points : list of CurvePoint
        All so far.
    complete, returned, status
        As of :class:`Continuation`.
    """

    def __init__(
        self, system: CurveSystem, here: PathPoint, steps: Steps,
        tolerance: float | None = None, branch: bool = False,
    ) -> None:  # fmt: skip
        self.system, self._steps = system, steps
        self._tolerance, self._branch = tolerance, branch
        self.most_points = steps.most_points
        self._origin = self._here = here
        self.points = [
            self._point(here.parameter, here.unknown, here.iterations, here.control_values)
        ]
        self._special: list[tuple[str, CurvePoint]] = []
        self.complete, self.returned, self.status = False, False, "not begun"

    def _point(
        self, parameter: float, unknown: np.ndarray, iterations: int, seen: np.ndarray | None
    ) -> CurvePoint:
        """A point of the path as one of the curve."""
        value = self.system.value(parameter)
        omega = self.system.omega(value, unknown)
        multipliers = None if seen is None else seen[:-3]  # (orbit_events)
        return CurvePoint(value, omega, unknown, iterations, multipliers)

    # --- what there is so far ---------------------------------------------------------------------

    @property
    def followed(self) -> ResponseCurve:
        """All points so far, without verdicts that are requested."""
        system, points = self.system, self.points
        problem, exact = system.problem, self._tolerance is not None
        multipliers = [leading(one.multipliers) for one in points if one.multipliers is not None]
        found = ResponseCurve(
            structure=problem.structure,
            contact=problem.contact,
            parameter=system.name,
            values=np.array([point.value for point in points]),
            omega=np.array([point.omega for point in points]),
            iterations=np.array([point.iterations for point in points]),
            bifurcations=(),
            complete=self.complete,
            status=self.status,
            subharmonic=problem.subharmonic,
            points=np.array([system.state(point.unknown, point.value) for point in points]),
            tolerance=self._tolerance,
            samples=problem.samples,
            static_above=None if exact else problem.static_cutoff,
            multipliers=np.array(multipliers) if exact else None,
            branch=self._branch,
        )
        special = []
        for kind, at in self._special:
            state = system.state(at.unknown, at.value)
            special.append(found.bifurcation(kind, at.value, at.omega, state, at.multipliers))
        return replace(found, bifurcations=tuple(special))

    @property
    def curve(self) -> ResponseCurve:
        """All points so far, with verdicts."""
        return self.followed

    def progress(self) -> float:
        """Return the fraction of the way from start to end that is done, 0 to 1."""
        return min(1.0, max(0.0, self._here.parameter))

    def how_far(self) -> str:
        """The same in words, with the range and how many points there are."""
        ends = self.system.start, self.system.end
        return f"{self.progress():.0%} of the way between {self.where(*ends)}"

    def where(self, *values: float) -> str:
        """Values of the parameter in its unit, by default the last one so far, and how many points
        there are."""
        axis, count = parameter_axis(self.system.name, True), counted(len(self.points), "point")
        return f"{in_unit(axis, *(values or (self.points[-1].value,)))}, {count}"

    # --- how it goes on ---------------------------------------------------------------------------

    def __iter__(self) -> Iterator[CurvePoint]:
        """Yield the last point so far, at first the first one, and all that follow."""
        yield self.points[-1]
        for part in self._parts():
            for one in part.split_points():
                yield self._record(one)

    def run(self) -> None:
        """Follow to the end: as iterating over all points does, but faster, since those between
        which nothing happens are recorded many at once."""
        for part in self._parts():
            self._record(part)

    def _parts(self) -> Iterator[PathSegment]:
        """The path behind the last point, to where the curve ends."""
        if self.complete:
            return
        system, here, longest = self.system, self._here, self._steps.longest_step
        self.status = "under way"
        events: list[Event] = [kind() for kind in system.events]
        events += [Target(1.0), ClosedLoop(self._origin, system)]
        if self._branch:
            events.append(Target(0.0))
            if system.problem.subharmonic % 2 == 0:
                events.insert(0, Joined(system))
        options = PathOptions(
            initial_step=0.2 * longest,
            max_step=longest,
            min_step=max(ARRIVAL_DISTANCE, system.rounding(here.parameter)),
            max_steps=self.most_points + 1 - len(self.points),
            points_per_call=max(1, min(PathOptions.points_per_call, system.at_once)),
            span=(-self._steps.turning_back, np.inf),
        )
        path = Path(system, here, options, events, system.control(longest))
        yield from path
        assert path.end_reason is not None
        self.complete = path.event is not None
        self.status = (
            path.event.description if path.event else path.end_reason.describe(self.most_points)
        )
        self.returned = path.end_reason is EndReason.RANGE_LEFT or isinstance(
            path.event, ClosedLoop
        )

    def _record(self, points: PathSegment) -> CurvePoint:
        """Take up points, and what lies before the last of them; return that one."""
        special = [
            (event.kind, self._point(at.parameter, at.unknown, at.iterations, at.control_values))
            for event, at in points.located_events
            if event.kind
        ]
        self._special += special
        seen = points.control_values if "control_values" in vars(points) else [None] * len(points)
        columns = points.parameters.tolist(), points.unknowns, points.iterations.tolist(), seen
        self.points += map(self._point, *columns)
        self._here = points[-1]
        met = tuple((kind, at.value) for kind, at in special)
        self.points[-1] = replace(self.points[-1], bifurcations=met)
        return self.points[-1]


class Continuation(GrowingCurve):
    """A curve that grows point by point: iterate over it, and take its ``curve`` at any time.

        for point in Continuation(Problem(plate, 1000.0, law), "omega", 1000.0, 3000.0):
            ...

    Parameters
    ----------
    problem : Problem
        Problem solved at the first point. A structure with many dofs is reduced first, to crack
        faces without mass (``reduce_structure(structure, method="massless")``); ``omega`` counts
        where it is not the parameter. Modes that are quasi-static are so for all of the curve:
        those above ``static_above``, by default 2 H times the highest base frequency, with the
        first point's H.
    parameter : str
        "omega": load frequency [rad/s]; "load", "stiffness", "damping": factor of the structure's
        load, of the contact stiffness, of the structure's damping, 1 being as given, and so
        "friction": of its coefficient; "clearance": added to that of every pair [m]; "speed": of
        the rotor [rad/s], which ``omega`` follows.
    start, end : float
        Its values; the end may be below the start.
    exact : bool
        Follow exact periodic orbits; the problem's harmonics play no part then.
    initial : PeriodicSolution, PeriodicOrbit or Bifurcation, optional
        Where to start. A solution: near the first point; of exact orbits also the orbit at
        ``start``. A bifurcation: on the branch that begins there; ``start`` and ``end`` bound the
        parameter on either side (:func:`follow_branch`).
    branch_of : ResponseCurve, optional
        The curve of the bifurcation.
    tolerance : float, optional
        Without ``samples``. Choose H, between the problem's ``harmonics`` and 100, so that the
        estimated truncation error of the first point is below this. Of exact orbits the
        ``tolerance`` of the curve; default: that of ``branch_of``, or 0.01.
    stability : bool
        Assess ``curve`` each time that it is taken (:func:`judge_curve`); exact orbits always have
        their stability.
    longest_step : float
        Longest step, relative to the range of the parameter and to the size of the solution; at
        most 1; default: 0.05.
    most_points : int
        Give up after so many; default: 50,000.
    turning_back : float
        Maximum return of the curve past its start, relative to the range of the parameter, but
        not to a frequency or a damping of zero; a closed curve can only be recognised where it may.
        Default: 0.1.

    Attributes
    ----------
    complete : bool
        True if the end was reached, or the curve closed.
    returned : bool
        True if the curve came back to its start, or went past it, instead of reaching the end.
    status : str
        Reason for the end.

    Raises
    ------
    InputError
        An argument cannot be used, or there is no exact flow whose orbits can be followed.
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
        exact: bool = False,
        initial: PeriodicSolution | PeriodicOrbit | Bifurcation | None = None,
        branch_of: ResponseCurve | None = None,
        tolerance: float | None = None,
        stability: bool = False,
        **steps: Unpack[StepOptions],
    ) -> None:
        if parameter == "resonance":
            raise InputError("parameter", parameter, "another one: follow_resonance follows it")
        how = Steps(**steps)
        fitting_argument("problem", problem, "Problem", ("Problem",))
        fitting_argument("stability", stability, "bool", ())
        if exact and tolerance is None:
            tolerance = TOLERANCE if branch_of is None else branch_of.tolerance
        if tolerance is not None:
            check_number("tolerance", tolerance, 0.0, above=True)
        if problem.samples is not None:
            check_count("samples", problem.samples, 4 * problem.harmonics + 1)
            if tolerance is not None:
                raise InputError("samples", problem.samples, "left out where a tolerance is given")
        check_range(problem, parameter, start, end)
        if 0.0 < start < end and parameter in ("omega", "damping", "speed"):  # not to 0
            back = min(how.turning_back, 0.9 * start / (end - start))
            how = replace(how, turning_back=back)
        if exact:
            problem = problem.with_harmonics(problem.response_harmonics(MIN_HARMONICS))
        if parameter in ("omega", "speed"):
            problem = WAVES[parameter].vary(problem, start)
        if not is_small(problem.structure):
            reduced = reduce_structure(problem.structure, method="massless")
            problem = replace(problem, structure=reduced)
            if isinstance(initial, PeriodicSolution) and not exact:  # its gaps are all that is used
                initial = replace(initial, structure=reduced)
        self._judged = stability and not exact
        if self._judged and is_rigid(problem.contact):
            exact_flow(problem.structure, problem.contact)

        at_start = WAVES[parameter].vary(problem, start)
        branch = isinstance(initial, Bifurcation)
        if not (exact or branch):
            if initial is not None:
                check_initial(at_start, initial)  # type: ignore[arg-type]
            if tolerance is not None:
                initial = solve_beside(at_start, initial, tolerance)  # type: ignore[arg-type]
                problem = problem.with_harmonics(initial.harmonics)
            check_memory(problem.structure, problem.harmonics)
        system = system_along(exact, problem, parameter, start, end)
        if isinstance(initial, Bifurcation):
            begun = branch_start(system, initial, how.longest_step, branch_of)
            here = first_point(
                system, begun.unknown, begun.parameter, begun.iterations, begun.tangent
            )
        elif exact:
            orbit = initial if isinstance(initial, PeriodicOrbit) else _orbit_at(at_start, initial)
            here = first_point(system, system.unknown(orbit.state, start), 0.0, orbit.iterations)
        else:
            found = Solver(system.at(start)).solve(initial)  # type: ignore[arg-type]
            here = first_point(system, found.slow_gap_coefficients, 0.0, found.iterations)
        super().__init__(system, here, how, tolerance if exact else None, branch)

    @property
    def curve(self) -> ResponseCurve:
        """All points so far; assessed with ``stability=True``."""
        return judge_curve(self.followed) if self._judged else self.followed


def first_point(
    system: CurveSystem, unknown: np.ndarray, parameter: float, iterations: int,
    towards: Tangent | None = None,
) -> PathPoint:  # fmt: skip
    """A solution as the first point of a curve, with its direction, towards growing p or roughly
    known, and what a step control uses."""
    at = system.linearise(unknown, parameter)
    tangent, seen = tangent_of(system, unknown, at, towards), observe_point(system, at)
    record = None if seen is None else at.record.ravel()
    return PathPoint(unknown, parameter, iterations, tangent, record=record, control_values=seen)


def has_orbits(problem: Problem, parameter: str, start: float, end: float) -> bool:
    """True if exact orbits can be followed along a parameter: a small structure has a flow, of so
    few modes that the monodromy matrix is formed, and the load is not too slow."""
    check_range(problem, parameter, start, end)
    flow = flow_of(problem.structure, problem.contact)
    if flow is None or flow.n_modes > MAX_MODES_FOR_MONODROMY:
        return False
    ends = [WAVES[parameter].vary(problem, value).omega for value in (start, end)]
    return not any(is_too_slow(flow, omega, problem.subharmonic) for omega in ends)


def check_range(problem: Problem, parameter: str, start: float, end: float) -> None:
    """Raise InputError unless a curve can go from one value of a parameter to another."""
    structure = problem.structure
    check_choice("parameter", parameter, WAVES)
    if is_rigid(problem.contact) and parameter == "stiffness":
        raise InputError("parameter", parameter, "another one: a rigid contact has no stiffness")
    names = ("omega_start", "omega_end") if parameter == "omega" else ("start", "end")
    for name, value in zip(names, (start, end), strict=True):
        WAVES[parameter].check(structure, name, value)
    if start == end:
        raise InputError(names[1], end, f"different from {names[0]}")
    if parameter == "load" and start * end <= 0.0 and not np.any(structure.clearance):
        allowed = "both of one sign: without clearance nothing is left of the motion at 0"
        raise InputError("start, end", (start, end), allowed)


def _orbit_at(problem: Problem, initial: PeriodicSolution | None) -> PeriodicOrbit:
    """The orbit at the start of a curve."""
    if initial is not None:
        check_initial(problem, initial)
    search = initial_orbit(problem, initial)
    if search.orbit is None:
        missing = f"no exact orbit at {problem.omega:g} rad/s: {search.reason}"
        way = "with harmonics in place of a tolerance the curve of harmonic balance is followed"
        raise ConvergenceError(f"{missing}; {way}")
    return search.orbit
