"""Curves of exact periodic orbits: pseudo-arc-length continuation over a parameter.

A path (:mod:`path`) of the equations of :class:`fenics_crack.curves.orbit_family.OrbitFamily`.
Newton's method forms the monodromy matrix of each point for its tangent: multipliers, steps that
resolve them, and all bifurcations (:mod:`orbit_events`) cost its eigenvalues.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from fenics_crack.curves.orbit_events import (
    MultiplierControl,
    NeimarkSacker,
    PeriodDoubling,
    multipliers,
)
from fenics_crack.curves.orbit_family import OrbitFamily
from fenics_crack.errors import ConvergenceError
from fenics_crack.numerics.equations import System
from fenics_crack.numerics.newton import (
    PathPoint,
    Tangent,
    correct,
    distance,
    norm_at,
    point_on_path,
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
    Stretch,
    Target,
)

AT_ONCE = 2**13
"""Numbers of monodromy matrices that are found at a time: those behind a rejected step are lost,
and of large ones few pay for the time between calls."""
ASIDE = 0.1, 0.03, 0.3, 0.01, 1.0
"""How far from a period doubling its branch is entered, in longest steps, one tried after the
other."""


@dataclass(frozen=True)
class OrbitBifurcation:
    """A bifurcation of periodic orbits.

    Attributes
    ----------
    kind : str
        "fold", "branch_point", "period_doubling" or "neimark_sacker".
    value : float
        Of the parameter.
    state : (2 n_modes,)
        q, q' at phase zero of the load.
    multipliers : (8,) complex
        The leading ones, largest modulus first.
    """

    kind: str
    value: float
    state: np.ndarray
    multipliers: np.ndarray


@dataclass(frozen=True)
class OrbitCurvePoint:
    """An orbit on a curve.

    Attributes
    ----------
    value, omega : float
        Of the parameter; of the load [rad/s].
    state : (2 n_modes,)
        q, q' at phase zero of the load, in the modes of the structure at the value.
    multipliers : (8,) complex
        The leading ones, largest modulus first.
    iterations : int
        Newton steps.
    bifurcations : tuple of OrbitBifurcation
        Between the point before and this one.
    """

    value: float
    omega: float
    state: np.ndarray
    multipliers: np.ndarray
    iterations: int
    bifurcations: tuple[OrbitBifurcation, ...] = ()


class OrbitPath:
    """A curve of exact orbits that grows point by point: iterate over it, or :meth:`run` it.

    Parameters
    ----------
    family : OrbitFamily
    state : (2 n_modes,)
        Of the first orbit.
    longest_step : float
        Longest step, relative to the range of the parameter and to the size of the solution.
    most_points : int
        Give up after so many.
    turning_back : float
        How far the curve may turn back past its start, relative to the range of the parameter.
    value : float, optional
        Of the parameter at the first orbit, by default the family's start.
    towards : Tangent, optional
        Roughly the direction to go in (:meth:`OrbitFamily.direction`), by default towards the end.
    origin : PathPoint, optional
        First point of a curve that goes on here, where it may close; by default this one.
    branch : bool
        Of a branch that begins at a bifurcation between the family's start and end: it ends at
        either, and one of twice the period where it joins the branch that it left.

    Attributes
    ----------
    points : list of OrbitCurvePoint
        All so far.
    complete : bool
        Whether the end was reached, or the curve closed.
    returned : bool
        Whether the curve came back to its start, or went past it.
    status : str
        How it ended.
    """

    def __init__(
        self, family: OrbitFamily, state: np.ndarray, *, longest_step: float, most_points: int,
        turning_back: float, value: float | None = None, towards: Tangent | None = None,
        origin: PathPoint | None = None, branch: bool = False,
    ) -> None:  # fmt: skip
        self.family, self._branch, self._most = family, branch, most_points
        self._longest, self._back = longest_step, turning_back
        self.complete, self.returned, self.status = False, False, "not begun"
        value = family.start if value is None else value
        unknown, parameter = family.unknown(state, value), family.parameter(value)
        self._here = point_on_path(family, unknown, parameter, towards)
        self._origin = origin or self._here
        self._path = self._path_on()
        leading = multipliers(self._path.last)
        self.points = [OrbitCurvePoint(value, family.omega(value), state, leading, 0)]

    def progress(self) -> float:
        """How much of the way from start to end has been gone, 0 to 1."""
        return min(1.0, max(0.0, self.family.parameter(self.points[-1].value)))

    def __iter__(self) -> Iterator[OrbitCurvePoint]:
        """Yield the first point and all that follow."""
        yield self.points[-1]
        for part in self._parts():
            for stretch in part.singly():
                yield self._record(stretch)
        self._end()

    def run(self) -> None:
        """Follow to the end, many points at once."""
        for part in self._parts():
            self._record(part)
        self._end()

    def _parts(self) -> Iterator[Stretch]:
        self.status = "under way"
        yield from self._path

    def _end(self) -> None:
        path = self._path
        assert path.ended is not None
        self.complete = path.event is not None
        self.status = path.event.told if path.event else path.ended.told(self._most)
        self.returned = path.ended is Ended.LEFT or isinstance(path.event, Closed)

    def _path_on(self) -> Path:
        """The path behind the first point, to where the curve ends."""
        family = self.family
        doubled = self._branch and family.subharmonic % 2 == 0
        events: list[Event] = [Joined(family)] if doubled else []
        events += [Fold(), BranchPoint(), PeriodDoubling(), NeimarkSacker(), Target(1.0)]
        events += [Target(0.0)] if self._branch else []
        events.append(Closed(self._origin, family))
        options = PathOptions(
            initial_step=0.2 * self._longest,
            max_step=self._longest,
            max_steps=self._most,
            at_once=max(1, min(PathOptions.at_once, AT_ONCE // family.records)),
            span=(-self._back, np.inf),
        )
        return Path(family, self._here, options, events, MultiplierControl(self._longest))

    def _record(self, points: Stretch) -> OrbitCurvePoint:
        """Take up points, and what lies before the last of them; return that one."""
        family = self.family
        values = [family.value(p) for p in points.parameters.tolist()]
        states = [family.state(x, v) for x, v in zip(points.unknowns, values, strict=True)]
        self.points += [
            OrbitCurvePoint(value, family.omega(value), state, leading, count)
            for value, state, leading, count in zip(
                values, states, points.observed[:, :-3], points.iterations.tolist(), strict=True
            )
        ]
        met = tuple(self._bifurcation(event.kind, at) for event, at in points.met if event.kind)
        if met:
            self.points[-1] = replace(self.points[-1], bifurcations=met)
        return self.points[-1]

    def _bifurcation(self, kind: str, at: PathPoint) -> OrbitBifurcation:
        value = self.family.value(at.parameter)
        return OrbitBifurcation(kind, value, self.family.state(at.unknown, value), multipliers(at))


class Joined(Event):
    """Where a branch of twice the period joins the one that it left: that crosses, the parameter
    turns back, and the orbit repeats itself after half its period."""

    terminal, told = True, "joined the branch that it left"

    def __init__(self, family: OrbitFamily) -> None:
        self._family, self._signs = family, (Fold(), BranchPoint())

    def between(self, points: Stretch) -> np.ndarray:
        return np.asarray(np.any([one.between(points) for one in self._signs], axis=0))

    def locate(self, system: System, ends: Ends, rtol: float) -> PathPoint | None:
        for one in self._signs:
            found = one.locate(system, ends, rtol)
            if found is not None and half_off(self._family, found) <= np.sqrt(ARRIVED):
                return found
        return None


def half_off(family: OrbitFamily, point: PathPoint) -> float:
    """Change of an orbit over half its periods of the load, relative to its size."""
    change = family.moved(point.unknown, point.parameter, 0.5) - point.unknown
    return float(np.linalg.norm(change) / (np.linalg.norm(point.unknown) or 1.0))


# --- branches of twice the period -----------------------------------------------------------------


@dataclass(frozen=True)
class OrbitStart:
    """The first orbit of a branch, and the direction away from where it begins.

    Attributes
    ----------
    value : float
        Of the parameter.
    state : (2 n_modes,)
    towards : Tangent
    """

    value: float
    state: np.ndarray
    towards: Tangent


def doubled_start(
    family: OrbitFamily, bifurcation: OrbitBifurcation, longest_step: float
) -> OrbitStart:
    """Enter the branch of twice the period at a period doubling, along the eigenvector of -1.

    Parameters
    ----------
    family : OrbitFamily
        With twice the subharmonic of the orbits that the bifurcation is on.
    bifurcation : OrbitBifurcation
    longest_step : float
        Of the branch.

    Raises
    ------
    ConvergenceError
        No orbit of twice the period is found next to it.
    """
    unknown = family.unknown(bifurcation.state, bifurcation.value)
    parameter = family.parameter(bifurcation.value)
    monodromy = family.monodromy(unknown, parameter, 0.5)
    across = scipy.linalg.svd(np.eye(len(unknown)) + monodromy)[2][-1]
    weight, of_means = norm_at(family, unknown)
    away = Tangent(across / np.sqrt(weight), 0.0, weight, of_means)
    start = PathPoint(unknown, parameter, 0, away)
    for share in ASIDE:
        step = share * longest_step
        with suppress(ConvergenceError):
            found = correct(family, start, step, PathOptions.rtol, reach=longest_step)
            if found is None or STRAIGHT * distance(family, start, found) > step:
                continue
            if (
                0.0 <= found.parameter <= 1.0 and half_off(family, found) > step
            ):  # of the way by +1 and by -1: twice the step
                value, change = family.value(found.parameter), found.unknown - unknown
                towards = Tangent(change, found.parameter - parameter, weight, of_means)
                return OrbitStart(value, family.state(found.unknown, value), towards)
    raise ConvergenceError(
        f"branch from period_doubling at {family.name} = {bifurcation.value:g}: no orbit of twice "
        "the period was found next to it"
    )
