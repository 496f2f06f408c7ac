"""Pseudo-arc-length continuation of solutions F(x, p) = 0 along a parameter p, through its folds.

A step of length h

1. predicts   (x, p) + h (t_x, t_p) + the cubic terms that follow from the point before and its
   tangent,
2. corrects by Newton's method in the plane orthogonal to the tangent (:mod:`newton`),
3. is lengthened where few iterations were needed, and halved where they failed or where the path
   was left, which a large angle between the new tangent and the old one shows. Of the two tangents
   at a point the right one keeps the sign of t_p det J, which changes only where another branch
   crosses. Where J is not formed its determinant is unknown: the tangent is taken that goes on at
   the smaller angle, the chord must agree with both tangents, lest a step across a narrow turn
   leads back, and branches that cross go unnoticed. There a system may judge angles by counting
   some unknowns less (``counts``).

The steps are the kernel's (``kernel/path.c``), many of them in one call where the equations are
compiled (:mod:`equations`). What may happen between two points is an :class:`Event`: a fold, a
value of the parameter that is sought, a path that closes, a branch that crosses, any function that
vanishes. A path ends at those that are terminal. A :class:`StepControl` may require shorter steps,
by what it observes of the points.

Source: Keller, in Applications of Bifurcation Theory, 1977; Seydel, Practical Bifurcation and
Stability Analysis, chapter 4.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum
from typing import overload

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.kernel import NULL, Struct, kernel, pointer
from fenics_crack.numerics.equations import (
    EPSILON,
    LOCATED,
    ROUNDING,
    Linearisation,
    System,
    equations_of,
)
from fenics_crack.numerics.newton import (
    STRAY,
    PathPoint,
    Tangent,
    correction,
    distance,
    solve_at,
    solve_in_plane,
    step_along,
    tangent_of,
)

STRAIGHT = 0.9
"""Minimum cosine of the angle between two directions that count as one."""
FEW = 3
"""Points that are computed at once where steps were halved."""
ARRIVED = math.sqrt(EPSILON)
"""Distance to a point of a path at which it counts as found, and the shortest step: where the
parameter turns, it is then known to the square of that."""


@dataclass(frozen=True)
class PathOptions:
    """Options of path following, with steps measured in the norm of the tangent."""

    initial_step: float
    max_step: float
    min_step: float = ARRIVED
    """Minimum step; the path ends where steps would be shorter."""
    max_steps: int = 1000
    rtol: float = 1e-9
    """Maximum |F| / |x| of the points; less where steps are short."""
    min_cosine: float = 0.85
    """Minimum cosine of the angle between neighbouring tangents."""
    rounding: float = ROUNDING
    """Rounding error of |F| / |x|, for a system without ``rounding``."""
    at_once: int = 64
    """Maximum points of one call of the kernel."""
    span: tuple[float, float] = (-np.inf, np.inf)
    """Range of the parameter: the path ends where it is left."""


NARROW = PathOptions(0.3, 0.3, min_cosine=0.5, span=(0.0, 2.0))
"""Options for paths whose parameter runs from 0 to 1; one that goes as far beyond is left."""


class Ended(Enum):
    """Reason for the end of a path."""

    MET = "reached the end"
    LOST = "no solution at the very end"
    LEFT = "turned back past its start"
    MANY = "{most} points were not enough"
    SHORT = "the steps became too short"

    def in_words(self, most: int) -> str:
        """In words, where there were so many points at most."""
        return str(self.value).format(most=most)


NOT_IN_KERNEL = "met", "observed"
"""Members that the kernel does not have of a stretch."""


class Stretch(Sequence[PathPoint]):
    """Points of a path in the kernel's arrays, one after the other; each is made where it is asked
    for.

    Attributes
    ----------
    unknowns, tangents : (n, *shape)
        x, and its tangent's t_x.
    parameters, slopes, weights, of_means, lengths : (n,)
        p, its tangent's t_p and norm, and the chord from the point before.
    iterations : (n,) int
    crossings : (n,) int
        1 where another branch has been crossed since the point before.
    met : list of (Event, PathPoint)
        Events between its last point and the one before it, and their places.
    records, observed : (n, records) and (n, ...), optional
        What a step control uses: records of linearisations, and values that follow from them.
    """

    observed: np.ndarray

    def __init__(self, known: Sequence[PathPoint], room: int, records: int = 0) -> None:
        shape = known[0].unknown.shape
        if records:
            self.records = np.zeros((room, records))
        self.unknowns, self.tangents = np.zeros((room, *shape)), np.zeros((room, *shape))
        self.parameters, self.slopes, self.lengths = np.zeros((3, room))
        self.weights, self.of_means = np.zeros((2, room))
        self.iterations, self.crossings = np.zeros(room, np.intc), np.zeros(room, np.int8)
        self.met: list[tuple[Event, PathPoint]] = []
        for place, point in enumerate(known):
            self.put(place, point)

    def put(self, place: int, point: PathPoint) -> None:
        """Set a point."""
        self.unknowns[place], self.tangents[place] = point.unknown, point.tangent.x
        self.parameters[place], self.slopes[place] = point.parameter, point.tangent.p
        self.weights[place], self.of_means[place] = point.tangent.weight, point.tangent.of_means
        self.lengths[place] = point.length
        if "records" in vars(self) and point.record is not None:
            self.records[place] = point.record
        if "observed" in vars(self):
            self.observed[place] = point.observed
        self.iterations[place], self.crossings[place] = point.iterations, point.crosses_branch

    def struct(self, known: int, **numbers: float) -> Struct:
        """The kernel's path, of which so many points are known."""
        arrays = {name: array for name, array in vars(self).items() if name not in NOT_IN_KERNEL}
        return Struct("path", room=len(self), known=known, **arrays, **numbers)

    def __len__(self) -> int:
        return len(self.parameters)

    def singly(self) -> Iterator[Stretch]:
        """Each point by itself."""
        for place in range(len(self)):
            part = self[place : place + 1]
            part.met = self.met if place == len(self) - 1 else []
            yield part

    @overload
    def __getitem__(self, place: int) -> PathPoint: ...
    @overload
    def __getitem__(self, place: slice) -> Stretch: ...
    def __getitem__(self, place: int | slice) -> PathPoint | Stretch:
        if isinstance(place, slice):
            part = object.__new__(Stretch)
            arrays = {name: array for name, array in vars(self).items() if name != "met"}
            vars(part).update({name: array[place] for name, array in arrays.items()}, met=[])
            return part
        norm = float(self.weights[place]), float(self.of_means[place])
        tangent = Tangent(self.tangents[place], float(self.slopes[place]), *norm)
        return PathPoint(
            self.unknowns[place], float(self.parameters[place]), int(self.iterations[place]),
            tangent, bool(self.crossings[place]), length=float(self.lengths[place]),
            record=self.records[place] if "records" in vars(self) else None,
            observed=self.observed[place] if "observed" in vars(self) else None,
        )  # fmt: skip


# --- events ---------------------------------------------------------------------------------------

Ends = tuple[PathPoint, PathPoint]
"""Two neighbours on a path."""


class Event(ABC):
    """Special point that may lie between two neighbours on a path.

    Attributes
    ----------
    terminal : bool
        True if the path ends there,
    words : str
        and the reason in words.
    sought : bool
        True if the path goes back, and on by a shorter step, where it may be there and is not
        found: a long step may have met another part.
    kind : str
        Name if it is a special point.
    """

    terminal, sought, words, kind = False, False, "", ""

    @abstractmethod
    def between(self, points: Stretch) -> np.ndarray:
        """Return True where it may lie behind a point, for each but the last: (n-1,) bool."""

    @abstractmethod
    def locate(self, system: System, ends: Ends, rtol: float) -> PathPoint | None:
        """Locate it; None where it is not there, or is not found."""


class BranchPoint(Event):
    """Crossing of another branch: t_p det J changes its sign. The step is halved as long as the
    path is found there."""

    kind = "branch_point"

    def between(self, points: Stretch) -> np.ndarray:
        return np.asarray(points.crossings[1:] > 0)

    def locate(self, system: System, ends: Ends, rtol: float) -> PathPoint | None:
        before, behind = ends
        near, far = 0.0, distance(system, before, behind)
        side = _orientation(system, before)
        while far - near > ARRIVED:
            middle = 0.5 * (near + far)
            point = step_along(system, before, middle, rtol)
            if point is None:
                break
            if _orientation(system, point) == side:
                near = middle
            else:
                behind, far = point, middle
        return behind


def _orientation(system: System, point: PathPoint) -> float:
    """The sign of t_p det J."""
    at = point.at or system.linearise(point.unknown, point.parameter)
    return float(at.sign * np.sign(point.tangent.p))


class Crossing(Event):
    """Zero of a function of points (:func:`zero_between`)."""

    def __init__(self, test: Callable[[PathPoint], float]) -> None:
        self._test = test

    def between(self, points: Stretch) -> np.ndarray:
        values = np.array([self._test(point) for point in points])
        return np.asarray(values[1:] * values[:-1] < 0.0)

    def locate(self, system: System, ends: Ends, rtol: float) -> PathPoint | None:
        return zero_between(system, ends, self._test, rtol)[0]


def zero_between(
    system: System, ends: Ends, test: Callable[[PathPoint], float], rtol: float
) -> tuple[PathPoint, float]:
    """The point between two neighbours where a function vanishes, by the Illinois method, and the
    function there; where that fails the point at which it was smallest.

    Points are found in the planes across the chord, from Hermite's cubic through both ends. (SciPy
    has such methods, and takes longer to load than many curves to be followed.)

    Source: Dowell and Jarratt, BIT 11, 1971, 168.
    """
    before, after = ends
    change, rise = after.unknown - before.unknown, after.parameter - before.parameter
    length = distance(system, before, after) or 1.0
    chord = replace(before.tangent, x=change / length, p=rise / length)
    met = {share: (point, test(point)) for share, point in zip((0.0, 1.0), ends, strict=True)}

    def value(share: float) -> float:
        if share not in met:
            lean = share * (1.0 - share) * length * np.array([1.0 - share, -share])
            smooth = share * share * (3.0 - 2.0 * share)
            x = before.unknown + smooth * change
            x = x + lean[0] * before.tangent.x + lean[1] * after.tangent.x
            p = before.parameter + smooth * rise
            p += lean[0] * before.tangent.p + lean[1] * after.tangent.p
            crossing = solve_in_plane(system, x, p, chord, tolerance=rtol, reach=STRAY * length)
            if crossing is None or crossing.at is None:
                raise ConvergenceError("path: lost between two points")
            tangent = tangent_of(system, crossing.unknown, crossing.at, chord)
            point = replace(crossing, tangent=tangent, observed=observed(system, crossing.at))
            met[share] = point, test(point)
        return met[share][1]

    kept, last = 0.0, 1.0
    size, left = value(kept), value(last)
    with suppress(ConvergenceError):
        while size * left < 0.0 and abs(last - kept) > 1e-12:
            share = last - left * (last - kept) / (left - size)
            if share in (kept, last):
                break
            there = value(share)
            if there * left < 0.0:
                kept, size = last, left
            else:  # so that this end does not stay
                size *= 0.5
            last, left = share, there
    return min(met.values(), key=lambda found: abs(found[1]))


class Fold(Crossing):
    """Turning point of the parameter."""

    kind = "fold"

    def __init__(self) -> None:
        super().__init__(lambda point: point.tangent.p)

    def between(self, points: Stretch) -> np.ndarray:
        return np.asarray(points.slopes[1:] * points.slopes[:-1] < 0.0)

    def locate(self, system: System, ends: Ends, rtol: float) -> PathPoint | None:
        near, length = _between(system, ends, None, rtol), distance(system, *ends)
        if near is None and length > 4.0 * ARRIVED:  # by shorter steps
            closer = PathOptions(0.25 * length, 0.25 * length, max_steps=8)
            for stretch in Path(system, ends[0], closer, [Fold()]):
                if stretch.met:
                    return stretch.met[0][1]
        return near or super().locate(system, ends, rtol)


@dataclass(frozen=True)
class Target(Event):
    """Point where the parameter has a given value."""

    parameter: float
    terminal, sought, words = True, True, Ended.MET.value

    def between(self, points: Stretch) -> np.ndarray:
        off = points.parameters - self.parameter
        return np.asarray((off[:-1] != 0.0) & (off[1:] * off[:-1] <= 0.0))

    def locate(self, system: System, ends: Ends, rtol: float) -> PathPoint | None:
        near = _between(system, ends, self.parameter, rtol)
        if near is None:
            return None
        at = solve_at(system, near.unknown, self.parameter, tolerance=rtol)
        return at and replace(at, tangent=near.tangent)


@dataclass(frozen=True)
class Closed(Event):
    """Return of a path to a point of it, by more than some steps."""

    origin: PathPoint
    system: System
    terminal, words = True, "closed loop"

    def between(self, points: Stretch) -> np.ndarray:
        lengths = points.lengths[1:]
        near = np.abs(points.parameters[:-1] - self.origin.parameter) <= lengths / STRAIGHT
        for place in np.flatnonzero(near):
            here = points[int(place)]
            ahead, back = here.tangent, self.origin.unknown - here.unknown
            way = ahead.product(self.system, back, ahead.x)
            way += ahead.p * (self.origin.parameter - here.parameter)
            near[place] = 0.0 < way <= lengths[place]
        return np.asarray(near)

    def locate(self, system: System, ends: Ends, rtol: float) -> PathPoint | None:
        before, origin = ends[0], self.origin
        chord = distance(system, before, origin)
        back, rise = origin.unknown - before.unknown, origin.parameter - before.parameter
        along = replace(before.tangent, x=back, p=rise).along(before.tangent, system)
        if along < STRAIGHT:
            return None
        met = step_along(system, before, along * chord, rtol)
        if met is None or met.tangent.along(origin.tangent, system) < STRAIGHT:
            return None
        off = met.unknown - origin.unknown
        return origin if origin.tangent.product(system, off, off) < 1e-10 else None


def _between(system: System, ends: Ends, target: float | None, rtol: float) -> PathPoint | None:
    """The point between two others of a path where the parameter turns back, or where it is a
    ``target``; None where it is not found.

    Where the next point is looked for follows from Hermite's cubic polynomial p(s) through the two
    points that enclose it, with s along the tangent of the first one.
    """
    equations, found = equations_of(system, ends[0].unknown.shape), Stretch(ends, 3)
    how = Struct("stepping", shortest=ARRIVED, newton=correction(rtol, STRAY))
    wanted = NULL if target is None else pointer(np.array([target]))
    path = found.struct(2)
    outcome = equations.run(kernel.find_between, how.at, wanted, path.at)
    return found[path.at.known] if equations.check(outcome) else None


# --- the path -------------------------------------------------------------------------------------


class StepControl(ABC):
    """Control of the step length by more than the path itself."""

    @abstractmethod
    def too_long(self, points: Stretch, first: int = 0) -> np.ndarray:
        """Return True where a step is too long, behind each point from one on but the last:
        (n-1-first,) bool."""


def observed(system: System, at: Linearisation) -> np.ndarray | None:
    """Return the values that a step control uses at a point, if the system has them."""
    observe = getattr(system, "observe", None)
    return None if observe is None else np.asarray(observe(at.record[None])[0])


class Path:
    """The path from a solution on: iterate over it once, by stretches at whose ends something
    happens, or by as many points as come together.

    Parameters
    ----------
    system : System
    start : PathPoint
        Its tangent gives the direction.
    options : PathOptions
    events : sequence of Event
    control : StepControl, optional
        The system must have ``records`` and ``observe`` then.

    Attributes
    ----------
    last : PathPoint
        The last point so far.
    ended : Ended or None
        Reason for the end, if it has ended.
    event : Event or None
        The terminal one that it has met.
    """

    def __init__(
        self, system: System, start: PathPoint, options: PathOptions, events: Sequence[Event] = (),
        control: StepControl | None = None,
    ) -> None:  # fmt: skip
        self._system, self._options, self._events = system, options, events
        self._equations, self._control = equations_of(system, start.unknown.shape), control
        self._longest = options.max_step
        self._at_once = options.at_once if control is None else min(FEW, options.at_once)
        self.last = start = self._observed(start)
        self.ended: Ended | None = None
        self.event: Event | None = None
        self._begin(start, options.initial_step)

    def points(self) -> Iterator[PathPoint]:
        """One point after the other."""
        for stretch in self:
            yield from stretch

    def run(self) -> PathPoint | None:
        """The terminal event's point, all of the path at once; None where it meets none."""
        for _ in self:
            pass
        return self.last if self.ended is Ended.MET else None

    def __iter__(self) -> Iterator[Stretch]:
        left, shorter = self._options.max_steps, math.inf
        while self.ended is None:
            if not left:
                self.ended = Ended.MANY
                return
            stretch = self._follow(left)
            if stretch is None:
                continue
            if len(stretch) == 1:
                self.ended = Ended.SHORT
                return
            for found, place in self._eventful(stretch):
                left -= len(found)
                if place is None:
                    self._known[:] = [*self._known, *found[-2:]][-2:]
                else:
                    shorter = 0.25 * min(shorter, float(stretch.lengths[place + 1]))
                    if shorter < self._options.min_step:
                        self.ended = Ended.LOST
                    else:
                        self._begin(stretch[place], shorter)
                if len(found):
                    self.last = found[-1]
                    yield found
                if place is not None or self.ended is not None:
                    break

    def _eventful(self, stretch: Stretch) -> Iterator[tuple[Stretch, int | None]]:
        """The points behind the first one in parts that end where something happens; with the place
        behind which what is sought was not found."""
        lowest, highest = self._options.span
        outside = (stretch.parameters[1:] < lowest) | (stretch.parameters[1:] > highest)
        flags = np.array([event.between(stretch) for event in self._events], dtype=bool)
        flags = flags.reshape(len(self._events), len(stretch) - 1)
        begin = 1
        for place in map(int, np.flatnonzero(flags.any(axis=0) | outside)):
            ends = stretch[place], stretch[place + 1]
            sharp = max(LOCATED, self._rounding(ends[1]))
            found = stretch[begin : place + 2]
            for event, near in zip(self._events, flags[:, place], strict=True):
                at = event.locate(self._system, ends, sharp) if near else None
                if at is not None:
                    at = self._observed(at)
                    found.met.append((event, at))
                if at is not None and event.terminal:
                    if at is ends[0]:
                        found = stretch[begin : place + 1]
                    else:
                        found.put(-1, at)
                    self.ended, self.event = Ended.MET, event
                    yield found, None
                    return
                if near and at is None and event.sought:
                    yield stretch[begin : place + 1], place
                    return
            if outside[place]:
                self.ended = Ended.LEFT
                yield stretch[begin : place + 1], None
                return
            if found.met:
                yield found, None
                begin = place + 2
        if begin < len(stretch):
            yield stretch[begin:], None

    # --- its steps --------------------------------------------------------------------------------

    def _observed(self, point: PathPoint) -> PathPoint:
        """A point with what a step control sees of it."""
        if self._control is None or point.observed is not None:
            return point
        at = point.at or self._system.linearise(point.unknown, point.parameter)
        return replace(point, record=at.record.ravel(), observed=observed(self._system, at))

    def _rounding(self, point: PathPoint) -> float:
        """Return the rounding error of |F| / |x| at a point."""
        of_system = getattr(self._system, "rounding", None)
        return self._options.rounding if of_system is None else float(of_system(point.parameter))

    def _begin(self, point: PathPoint, step: float) -> None:
        """Go on from a point, with a step."""
        self._known, self._step, self._orientation = [point], step, 0.0

    def _up_to_halved_step(self, found: Stretch, known: int, step: float) -> Stretch | None:
        """The last point that was known, and those behind it, of which the first was sought by a
        step, up to the first step that is halved; None if that is the first."""
        assert self._control is not None
        new = self._system.observe(found.records[known:])  # type: ignore[attr-defined]
        found.observed = np.concatenate([[point.observed for point in self._known], new])
        lengths = found.lengths[known:].copy()
        lengths[0] = min(lengths[0], step)  # where the path jumps its chord is no step
        long = lengths > 2.0 * self._options.min_step
        halved = np.flatnonzero(self._control.too_long(found, known - 1) & long)
        if not len(halved):
            self._longest = min(2.0 * self._longest, self._options.max_step)
            if self._longest == self._options.max_step:
                self._at_once = min(2 * self._at_once, self._options.at_once)
            return found[known - 1 :]
        last = known - 1 + int(halved[0])
        if found.crossings[last + 1 :].sum() % 2:
            self._orientation = -self._orientation
        self._step = self._longest = 0.5 * float(lengths[halved[0]])
        self._at_once = min(FEW, self._options.at_once)
        return found[known - 1 : last + 1] if last >= known else None

    def _follow(self, left: int) -> Stretch | None:
        """The last point that is known, and those behind it, if no step is too short, no more than
        are left; None where a step control halves the first step."""
        options, known = self._options, self._known
        here, rounding = known[-1].parameter, self._rounding(known[-1])
        targets = [event.parameter for event in self._events if isinstance(event, Target)]
        bounds = [*options.span, *targets]
        many = min(left, self._at_once if self._equations.many else 1)
        records = 0 if self._control is None else int(self._equations.table.records)
        found = Stretch(known, len(known) + many, records)
        path = found.struct(len(known), step=self._step, orientation=self._orientation)
        how = Struct(
            "stepping", longest=self._longest, shortest=options.min_step,
            least_cosine=options.min_cosine, rounding=rounding,
            newton=correction(max(options.rtol, rounding), STRAY),
            lowest=max(p for p in bounds if p <= here),
            highest=min(p for p in bounds if p >= here),
        )  # fmt: skip
        step = self._step
        outcome = self._equations.run(kernel.follow, how.at, path.at)
        self._orientation, self._step = path.at.orientation, path.at.step
        if path.at.known == len(known):
            self._equations.check(outcome)
        if path.at.known == len(known) or self._control is None:
            return found[len(known) - 1 : path.at.known]
        return self._up_to_halved_step(found[: path.at.known], len(known), step)
