"""Curves that grow point by point: what those of harmonic balance and of exact orbits share.

A curve is a path (:mod:`fenics_crack.numerics.path`) of the equations of a family over a parameter
(:mod:`family`, :mod:`orbit_family`). It begins at a solution, or on a branch that leaves another
curve at a bifurcation.

Branches are entered along the null vector of [J, F_p] across the old one; at a period doubling
along that of the equations of twice the period.

Sources: Keller, in Applications of Bifurcation Theory, 1977; Seydel, Practical Bifurcation and
Stability Analysis, chapters 4, 5 and 7.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, ClassVar, TypedDict

import numpy as np
import scipy.linalg

from fenics_crack.balance.problem import Problem
from fenics_crack.basics.errors import (
    ConvergenceError,
    InputError,
    check_choice,
    check_count,
    check_number,
)
from fenics_crack.basics.tables import counted, in_unit
from fenics_crack.curves.curve import CurvePoint, ResponseCurve, parameter_axis
from fenics_crack.curves.family import FAMILIES, Family
from fenics_crack.curves.orbit_family import OrbitFamily
from fenics_crack.model.contact import is_rigid
from fenics_crack.model.modal import is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.numerics.equations import System
from fenics_crack.numerics.newton import (
    PathPoint,
    Tangent,
    correct,
    distance,
    norm_at,
    point_on_path,
    tangent_of,
)
from fenics_crack.numerics.path import (
    ARRIVED,
    STRAIGHT,
    BranchPoint,
    Closed,
    Ended,
    Ends,
    Event,
    Fold,
    Path,
    PathOptions,
    StepControl,
    Stretch,
    Target,
    observed,
)


class Steps(TypedDict, total=False):
    """Length and number of steps of a curve, as in :class:`fenics_crack.Continuation`."""

    longest_step: float
    most_points: int
    turning_back: float


class Growing(ABC):
    """A curve that grows, as :class:`fenics_crack.Continuation`: iterate over it, or :meth:`run`
    it. ``points`` are all so far."""

    def __init__(
        self, problem: Problem, parameter: str, start: float, end: float, *,
        longest_step: float = 0.05, most_points: int = 50_000, turning_back: float = 0.1,
    ) -> None:  # fmt: skip
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
        self._problem = problem
        self._longest, self.most_points, self._back = longest_step, most_points, turning_back
        self.points: list[CurvePoint] = []
        self._special: list[tuple[str, float, np.ndarray, np.ndarray | None]] = []
        self._branch = False
        self._towards: Tangent | None = None
        self._origin: PathPoint | None = None
        self.complete, self.returned, self.status = False, False, "not begun"

    # --- what each kind knows ---------------------------------------------------------------------

    _family: Family | OrbitFamily
    _control: StepControl | None = None

    @property
    @abstractmethod
    def _at_once(self) -> int:
        """Points that are followed in one call."""

    _events: ClassVar[Sequence[type[Event]]]
    """Special points between two points, but for the ends of the curve."""
    _kind: ClassVar[type[ResponseCurve]]

    @property
    @abstractmethod
    def _own(self) -> dict[str, Any]:
        """Fields of this kind of curve beyond the common ones."""

    # --- where it begins --------------------------------------------------------------------------

    def _begin(self, value: float, unknown: np.ndarray, iterations: int = 0) -> None:
        """At a solution."""
        family = self._family
        at = family.linearise(unknown, family.parameter(value))
        multipliers = _multipliers(observed(family, at))
        self.points = [CurvePoint(value, family.omega(value), unknown, iterations, multipliers)]

    def _begin_on_branch(
        self, kind: str, value: float, unknown: np.ndarray, old: Tangent | None = None
    ) -> None:
        """On the branch that begins at a bifurcation, with its solution as one of this family, and
        the direction in which the other one passes it."""
        family, self._branch = self._family, True
        found = branch_start(family, kind, unknown, family.parameter(value), self._longest, old)
        self._towards = found.tangent
        self._begin(family.value(found.parameter), found.unknown, found.iterations)

    # --- what there is so far ---------------------------------------------------------------------

    @property
    def followed(self) -> ResponseCurve:
        """All points so far, without verdicts that are requested."""
        problem, points, state = self._problem, self.points, self._family.state
        found = self._kind(
            structure=problem.structure,
            contact=problem.contact,
            parameter=self._family.name,
            values=np.array([point.value for point in points]),
            omega=np.array([point.omega for point in points]),
            iterations=np.array([point.iterations for point in points]),
            bifurcations=(),
            complete=self.complete,
            status=self.status,
            subharmonic=problem.subharmonic,
            branch=self._branch,
            **{self._kind.FOUND: np.array([state(one.unknown, one.value) for one in points])},
            **self._own,
        )
        special = tuple(
            found.bifurcation(kind, value, state(unknown, value), multipliers)
            for kind, value, unknown, multipliers in self._special
        )
        return replace(found, bifurcations=special)

    @property
    def curve(self) -> ResponseCurve:
        """All points so far, with verdicts."""
        return self.followed

    @property
    def size(self) -> int:
        """Unknowns of a point."""
        return int(np.prod(self._family.shape))

    def progress(self) -> float:
        """Return the fraction of the way from start to end that is done, 0 to 1."""
        return min(1.0, max(0.0, self._family.parameter(self.points[-1].value)))

    def how_far(self) -> str:
        """The same in words, with the range and how many points there are."""
        family = self._family
        ends = in_unit(parameter_axis(family.name, True), family.start, family.end)
        return (
            f"{self.progress():.0%} of the way between {ends}, {counted(len(self.points), 'point')}"
        )

    # --- how it goes on ---------------------------------------------------------------------------

    def __iter__(self) -> Iterator[CurvePoint]:
        """Yield the last point so far, at first the first one, and all that follow."""
        yield self.points[-1]
        for part in self._parts():
            for one in part.singly():
                yield self._record(one)

    def run(self) -> None:
        """Follow to the end: as iterating over all points does, but faster, since those between
        which nothing happens are recorded many at once."""
        for part in self._parts():
            self._record(part)

    def _parts(self) -> Iterator[Stretch]:
        """The path behind the last point, to where the curve ends."""
        if self.complete:
            return
        last, family = self.points[-1], self._family
        here = point_on_path(family, last.unknown, family.parameter(last.value), self._towards)
        self._origin, self.status = self._origin or here, "under way"
        ends: list[Event] = [Target(1.0), Closed(self._origin, family)]
        events = [kind() for kind in self._events]
        if self._branch:
            ends.append(Target(0.0))
            if self._problem.subharmonic % 2 == 0:
                events.insert(0, Joined(family))
        options = PathOptions(
            initial_step=0.2 * self._longest,
            max_step=self._longest,
            min_step=max(ARRIVED, family.rounding(here.parameter)),
            max_steps=self.most_points + 1 - len(self.points),
            at_once=max(1, min(PathOptions.at_once, self._at_once)),
            span=(-self._back, np.inf),
        )
        path = Path(family, here, options, [*events, *ends], self._control)
        yield from path
        assert path.ended is not None
        self.complete = path.event is not None
        self.status = path.event.words if path.event else path.ended.in_words(self.most_points)
        self.returned = path.ended is Ended.LEFT or isinstance(path.event, Closed)

    def _record(self, points: Stretch) -> CurvePoint:
        """Take up points, and what lies before the last of them; return that one."""
        family, many = self._family, len(points)
        seen = points.observed if "observed" in vars(points) else [None] * many
        values = map(family.value, points.parameters.tolist())
        self.points += [
            CurvePoint(value, family.omega(value), unknown, count, _multipliers(one))
            for value, unknown, count, one in zip(
                values, points.unknowns, points.iterations.tolist(), seen, strict=True
            )
        ]
        special = [
            (event.kind, family.value(at.parameter), at.unknown, _multipliers(at.observed))
            for event, at in points.met
            if event.kind
        ]
        self._special += special
        met = tuple((kind, value) for kind, value, _, _ in special)
        self._towards = points[-1].tangent
        self.points[-1] = replace(self.points[-1], bifurcations=met)
        return self.points[-1]


def _multipliers(seen: np.ndarray | None) -> np.ndarray | None:
    """Return the multipliers in the observed values of exact orbits (:mod:`orbit_events`)."""
    return None if seen is None else seen[:-3]


class Joined(Event):
    """Junction of a branch of twice the period with the one that it left: that crosses, the
    parameter turns back, and the motion repeats itself after half its period."""

    terminal, words = True, "joined the branch that it left"

    def __init__(self, family: Family | OrbitFamily) -> None:
        self._family, self._signs = family, (Fold(), BranchPoint())

    def between(self, points: Stretch) -> np.ndarray:
        return np.asarray(np.any([one.between(points) for one in self._signs], axis=0))

    def locate(self, system: System, ends: Ends, rtol: float) -> PathPoint | None:
        for one in self._signs:
            found = one.locate(system, ends, rtol)
            if found is not None:
                off = self._family.half_off(found.unknown, found.parameter)
                if off <= math.sqrt(ARRIVED):
                    return found
        return None


def points_of(
    family: Family | OrbitFamily, curve: ResponseCurve, places: Sequence[int]
) -> list[tuple[float, np.ndarray]]:
    """Values of the parameter, and unknowns, at some points of a curve."""
    values, found = curve.values[places].tolist(), getattr(curve, curve.FOUND)[places]
    return [(value, family.unknown(x, value)) for value, x in zip(values, found, strict=True)]


def chord(
    family: Family | OrbitFamily, before: tuple[float, np.ndarray], after: tuple[float, np.ndarray]
) -> Tangent:
    """From one point, its value of the parameter and its unknowns, to another one."""
    rise = family.parameter(after[0]) - family.parameter(before[0])
    return Tangent(after[1] - before[1], rise, *norm_at(family, after[1]))


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


def branch_start(
    family: Family | OrbitFamily,
    kind: str,
    unknown: np.ndarray,
    parameter: float,
    longest_step: float,
    old: Tangent | None = None,
) -> PathPoint:
    """The first point on the branch that begins at a bifurcation; its tangent is the way to it.

    Raises
    ------
    ConvergenceError
        No point of another branch was found.
    """
    if doubled := kind == "period_doubling":
        away = _doubling(family, unknown, parameter)
    else:
        away = _across(family, unknown, parameter, old)
    start = PathPoint(unknown, parameter, 0, away)
    sharp = max(PathOptions.rtol, family.rounding(parameter))
    # Distances from the bifurcation, in longest steps, tried in turn.
    for step in (share * longest_step for share in (0.1, 0.03, 0.3, 0.01, 1.0)):
        with suppress(ConvergenceError):
            found = correct(family, start, step, sharp, reach=longest_step)
            if found is None or STRAIGHT * distance(family, start, found) > step:
                continue
            # Of the way by +1 and by -1 half a period changes twice the step.
            new = not doubled or family.half_off(found.unknown, found.parameter) > step
            if new and 0.0 <= found.parameter <= 1.0:
                change, rise = found.unknown - unknown, found.parameter - parameter
                return replace(found, tangent=replace(away, x=change, p=rise))
    raise ConvergenceError(
        f"branch from {kind} at {family.name} = {family.value(parameter):g}: "
        "no point of another branch was found next to it"
    )


def _doubling(family: Family | OrbitFamily, unknown: np.ndarray, parameter: float) -> Tangent:
    """Unit direction of the branch of twice the period at a period doubling."""
    weight, of_means = norm_at(family, unknown)
    change = family.doubling(unknown, parameter)
    return Tangent(change / math.sqrt(weight), 0.0, weight, of_means)


def _across(
    family: Family | OrbitFamily, unknown: np.ndarray, parameter: float, old: Tangent | None
) -> Tangent:
    """Unit direction in the null space of [J, F_p] at a branch point, across the old branch."""
    at = family.linearise(unknown, parameter)
    old = old or tangent_of(family, unknown, at)
    size = math.sqrt(old.weight)  # the parameter in the units of the unknowns
    derivative = at.by_parameter.reshape(-1, 1)
    null = scipy.linalg.svd(np.hstack([at.jacobian, derivative * size]))[2][-2:]
    mix = null @ np.append(old.x.ravel(), old.p / size)
    vector = mix[1] * null[0] - mix[0] * null[1]
    slope = float(vector[-1]) * size
    length = math.sqrt(old.weight * float(vector[:-1] @ vector[:-1]) + slope**2)
    return Tangent(vector[:-1].reshape(old.x.shape) / length, slope / length, old.weight)
