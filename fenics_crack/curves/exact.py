"""The exact orbits behind a curve: verdicts at its points, and bifurcations of the motion itself.

The multipliers of the truncated equations' waves cross the unit circle where those of the motion
need not, above all where contact is stiff and modes beyond the harmonics are lightly damped. So
next to each point of the curve an orbit F(x, p) = 0 (:mod:`fenics_crack.stability.shooting`) is
found by Newton's method, from the point's own motion and what had to be added to that of the point
before: at the point's frequency, or, next to folds, in the plane across the curve. With the
multipliers mu of an orbit, let

    r = number of real mu > 1,    d = number of real mu < -1,    c = pairs with |mu| > 1.

Between the orbits of neighbouring points lies a fold (or a branch point) where r changes by one, a
period doubling where d does, a Neimark-Sacker point where c does. Where more than one of them
changes the chord is halved. The place is found along the chord by Brent's method on

    det(I - M),    det(I + M),    |mu| - 1 of the pair that leaves.

Two real multipliers outside that meet and become a pair are no bifurcation.

The orbits lie so close to each other that the multipliers of the fastest modes turn by a small
angle from one to the next: between the points of the curve they are looked for as well.

The exact flow from event to event needs no more. Orbits by exponential steps, of second order, are
found with N steps in a period, and with 2N at the curve's points and next to bifurcations: the
difference is the uncertainty of |mu|, and a bifurcation is known where both have it at the same
frequency. What is not seen: two crossings of one kind between neighbouring orbits.

Source: Seydel, Practical Bifurcation and Stability Analysis, chapters 5 and 7.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy.optimize
from scipy.interpolate import CubicSpline

from fenics_crack.balance.bordered import PathPoint, Tangent, solve_at, solve_in_plane
from fenics_crack.balance.family import FrequencyFamily
from fenics_crack.balance.fourier import resized
from fenics_crack.balance.orbits import OrbitPoint
from fenics_crack.curves.bifurcations import attainable
from fenics_crack.curves.curve import Bifurcation, ResponseCurve
from fenics_crack.curves.judged_points import judge_points
from fenics_crack.curves.nearness import NO_DOUBT, near_points
from fenics_crack.errors import ConvergenceError
from fenics_crack.model.contact import is_piecewise_linear, is_rigid
from fenics_crack.model.exact_flow import MAX_PAIRS
from fenics_crack.model.modal import all_modes, between_pairs
from fenics_crack.stability.floquet import floquet
from fenics_crack.stability.piecewise_flow import doubling_test
from fenics_crack.stability.refinement import bifurcation_between
from fenics_crack.stability.shooting import CLOSE, ExactOrbits, leaves, orbits_near
from fenics_crack.stages import begin

__all__ = ["judge_curve", "verified"]

STEPS = (2048, 4096)
"""Of marched orbits in a period of the load."""
TOLERANCE = 1e-6
"""|z(T) - z| / |z| of the orbits."""
ITERATIONS, PATIENCE = 6, 3
"""Newton steps to an orbit, and how many may together fail to halve the residual."""
ALIKE = 0.25
"""Farthest orbit from the motion of its point, relative."""
REACH = 5e-3
"""Farthest orbit from the frequency of its point, relative."""
SURE = 1e-6
"""Distance of the leading multiplier from the unit circle that decides, at least."""
LONGEST, TURN = (1e-3, 1e-2), 0.05
"""Step in the frequency from orbit to orbit, relative, and the angle [rad] by which multipliers may
turn in it: that of a mode w_j turns by 2 pi w_j / w times as much as the step, and lightly damped
ones that meet may leave the unit circle for no longer. Where the angle asks for more than the first
step allows, this is taken."""
ROUNDING, IDENTICAL = 1e-5, 1e-6
"""Of the frequency, relative: an orbit at another one judges no point, as next to a fold there may
be one on either side; folds that are not located and lie as near to each other are none;
bifurcations found on a branch that lie within the second are the same one."""
MISSED = 4
"""Places one after the other without an orbit, behind which every fourth of those between points is
tried."""
HALVINGS = 5
"""Of a chord."""
SHARP = 0.03
"""Of a bifurcation's place, relative to its chord."""
SMOOTH = 0.25
"""Of a test function's largest value, what may be left where it vanishes."""
SAME = 5e-4
"""Of the frequency, relative: how far a bifurcation may move when steps are halved."""
SINGLY = 40
"""Points left undecided that are judged one by one, as a solution is (:func:`floquet`)."""
NEARBY = 0.02
"""Of the frequency, relative: how far a bifurcation of the truncated equations may lie from that of
the orbits which confirms it."""
KINDS = "fold", "period_doubling", "neimark_sacker"


@dataclass(frozen=True)
class _Orbit:
    """An orbit next to the curve; ``outside`` are r, d and c."""

    unknown: np.ndarray
    parameter: float
    leading: complex
    outside: tuple[int, int, int]


_Found = tuple[np.ndarray, float, np.ndarray]
"""x, p and M of an orbit."""


@dataclass(frozen=True)
class _Crossing:
    """A bifurcation of the orbits, and the point of the curve next to it."""

    kind: str
    omega: float
    point: int
    located: bool
    """Whether all orbits were found that its place needs."""


class _Orbits:
    """The orbits next to a curve, and their bifurcations.

    ``steps``: in a period of the load, None: from event to event. ``before``: the same with other
    steps: the orbits are looked for at the curve's points and next to its bifurcations only.

    Attributes
    ----------
    at : (n,)
        Places: numbers of the curve's points, and between them.
    found : list of _Orbit or None
        At each place.
    """

    def __init__(
        self, curve: ResponseCurve, steps: int | None, before: _Orbits | None = None
    ) -> None:
        self._system = orbits_near(curve.structure, curve.contact, curve.solution(0), steps)
        if before is None:
            motions = np.array([self._system.unknown_of(*one) for one in curve.motions()])
            parameters = curve.omega / self._system.omega
            longest = np.clip(TURN / (2.0 * np.pi * _highest(curve)) * curve.omega, *LONGEST)
            self.at, self._motions, self._parameters = _filled(motions, parameters, longest)
            self._turning = _near_turns(self._parameters)
            starts: list[np.ndarray | None] = list(self._motions)
        else:
            places = before.wanted()
            self.at, self._motions = before.at[places], before._motions[places]
            self._parameters, self._turning = before._parameters[places], before._turning[places]
            starts = [one and one.unknown for one in (before.found[place] for place in places)]
        self.found: list[_Orbit | None] = _judged(list(self._next_to(starts)))
        self.crossings = _distinct(list(self._crossings()))

    def gap(self, place: int) -> np.ndarray:
        """Gaps [m] of the orbit next to a point of the curve: (512, n_pairs)."""
        orbit = self.found[np.searchsorted(self.at, place)]
        assert orbit is not None
        return self._system.gap(orbit.unknown, orbit.parameter)

    def doubtful(self, place: int) -> bool:
        """Whether the motion of a point of the curve is farther away than is beyond doubt."""
        number = int(np.searchsorted(self.at, place))
        return self._away(self.found[number], number) > NO_DOUBT

    def turned(self, curve: ResponseCurve) -> np.ndarray:
        """Whether orbits lie on the other side of a fold than their points, or these at a fold:
        (n,) bool.

        The sign of det(I - M), (-1)^r, changes with the direction of the frequency along a branch,
        and with neither alone but at branch points.
        """
        ahead = np.sign(np.diff(curve.omega))
        ways = np.concatenate([ahead[:1], ahead, ahead[-1:]])
        ways = np.where(ways[1:] == ways[:-1], ways[1:], 0.0)  # 0: at the fold
        for one in curve.bifurcations:
            if one.kind == "branch_point":
                ways[_place(curve, one) :] *= -1.0
        found = [self.found[place] for place in np.searchsorted(self.at, np.arange(len(curve)))]
        product = ways * [(-1.0) ** one.outside[0] if one else 0.0 for one in found]
        return np.asarray(product * np.sign(product.sum()) <= 0.0)

    def disputed(self, place: int) -> bool:
        """Whether the motion of a point of the curve leads straight to another orbit, nearer to it
        than that of its neighbours, and of another stability."""
        number = int(np.searchsorted(self.at, place))
        own, found = self.found[number], self._solve(self._motions[number], number)
        if own is None or found is None:
            return False
        [other] = _judged([(found.unknown, found.parameter, _orbit(found).monodromy)])
        nearer = self._away(other, number) < self._away(own, number)
        return nearer and (abs(own.leading) < 1.0) != (other is None or abs(other.leading) < 1.0)

    def left(self, place: int) -> bool:
        """Whether the exact motion that begins with a point of the curve leaves the stable orbit
        next to it."""
        number = int(np.searchsorted(self.at, place))
        orbit, motion = self.found[number], self._motions[number]
        if not isinstance(self._system, ExactOrbits) or orbit is None or abs(orbit.leading) >= 1.0:
            return False
        off = self._away(orbit, number)
        return off > CLOSE and leaves(self._system, motion, orbit.unknown, orbit.parameter)

    def _away(self, orbit: _Orbit | None, number: int) -> float:
        """Distance of an orbit from the motion of its place, relative to this."""
        assert orbit is not None
        motion = self._motions[number]
        return float(np.linalg.norm(orbit.unknown - motion) / np.linalg.norm(motion))

    def wanted(self) -> np.ndarray:
        """Places that are the curve's points, or next to bifurcations."""
        wanted = self.at == np.round(self.at)
        for place, (first, last) in enumerate(pairwise(self.found)):
            if first is not None and last is not None and first.outside != last.outside:
                wanted[max(0, place - 2) : place + 4] = True
        return np.flatnonzero(wanted)

    def _next_to(self, starts: list[np.ndarray | None]) -> Iterator[_Found | None]:
        """The orbits at all places; what has to be added to a start is extrapolated. Behind some
        places without an orbit few of those between the curve's points are tried.
        """
        added: list[np.ndarray] = []
        missed = 0
        for place, start in enumerate(starts):
            point = None
            if missed % MISSED and missed > MISSED and self.at[place] % 1.0:
                start = None
            if start is not None and added:
                point = self._solve(start + 2.0 * added[-1] - added[0], place)
            if start is not None and point is None:
                point = self._solve(start, place)
            if start is None or point is None:
                added, missed = [], missed + 1
                yield None
            else:
                added, missed = [*added, point.unknown - start][-2:], 0
                yield point.unknown, point.parameter, _orbit(point).monodromy

    def _solve(self, start: np.ndarray, place: int) -> PathPoint | None:
        """The orbit at the frequency of a place; across the curve where that turns, or fails."""
        motion, parameter = self._place(place)
        for across in (True,) if self._turning[place] else (False, True):
            plane = None
            if across:
                ends = max(0, place - 1), min(len(self._motions) - 1, place + 1)
                plane = _chord(*(self._place(end) for end in ends))
            found = self._in_plane(start, parameter, plane)
            if found is not None:
                away = found.unknown - motion
                if away @ away <= ALIKE**2 * (motion @ motion):
                    return found
        return None

    def _place(self, place: int) -> tuple[np.ndarray, float]:
        return self._motions[place], float(self._parameters[place])

    def _in_plane(
        self, unknown: np.ndarray, parameter: float, plane: Tangent | None
    ) -> PathPoint | None:
        try:
            return solve_in_plane(
                self._system, unknown, parameter, plane,
                tolerance=TOLERANCE, iterations=ITERATIONS, patience=PATIENCE, reach=REACH,
            )  # fmt: skip
        except ConvergenceError:  # pairs chatter
            return None

    # --- bifurcations -----------------------------------------------------------------------------

    def _crossings(self) -> Iterator[_Crossing]:
        for place, (first, last) in enumerate(pairwise(self.found)):
            if first is not None and last is not None:
                turning = self._turning[place] or self._turning[place + 1]
                for kind, parameter, located in self._between(first, last, turning):
                    nearer = abs(parameter - first.parameter) > abs(parameter - last.parameter)
                    point = round(float(self.at[place + int(nearer)]))
                    yield _Crossing(kind, parameter * self._system.omega, point, located)

    def _between(
        self, first: _Orbit, last: _Orbit, turning: bool, halvings: int = HALVINGS
    ) -> Iterator[tuple[str, float, bool]]:
        """Kinds and places of the bifurcations between two orbits, and whether these are sure."""
        change = np.subtract(last.outside, first.outside)
        if change[0] % 2 == 0 and change[1] % 2 == 0 and change @ (1, 1, 2) == 0:
            return
        simple = np.abs(change).sum() == 1
        if halvings > 0 and not simple:
            found = self._point(first, last, 0.5, turning)
            if found is not None:
                [middle] = _judged([(found.unknown, found.parameter, _orbit(found).monodromy)])
                assert middle is not None
                yield from self._between(first, middle, turning, halvings - 1)
                yield from self._between(middle, last, turning, halvings - 1)
                return
        for kind, step in zip(KINDS, change, strict=True):
            if step % 2 and (simple or kind != "neimark_sacker"):
                yield kind, *self._located(kind, first, last, turning)

    def _located(self, kind: str, first: _Orbit, last: _Orbit, turning: bool) -> tuple[float, bool]:
        """Where a bifurcation lies between two orbits, and True; about where, and False, if nothing
        shows that there is one."""
        if isinstance(self._system, ExactOrbits) and kind != "neimark_sacker":
            ends = [(one.unknown, one.parameter) for one in (first, last)]
            for start, goal in (ends, ends[::-1]):
                found = bifurcation_between(self._system, start, goal, kind)
                if found is not None:
                    return found.parameter, True
            return 0.5 * (first.parameter + last.parameter), False
        return self._along_chord(kind, first, last, turning)

    def _along_chord(
        self, kind: str, first: _Orbit, last: _Orbit, turning: bool
    ) -> tuple[float, bool]:
        """Where a test function vanishes along a chord, and True; its smallest value that was met,
        and False, where an orbit is missed, or it has one sign, or jumps past zero: from one branch
        of orbits to another."""
        pairs = max(first.outside[2], last.outside[2])
        met: list[tuple[float, float]] = []

        def test(share: float) -> float:
            found = self._point(first, last, share, turning)
            if found is None:
                raise ConvergenceError("no orbit")
            value = _test(kind, found, pairs)
            met.append((abs(value), found.parameter))
            return value

        try:
            scipy.optimize.brentq(test, 0.0, 1.0, xtol=SHARP, rtol=1e-12)
        except (ConvergenceError, ValueError):
            return (min(met)[1] if met else first.parameter), False
        return min(met)[1], min(met)[0] <= SMOOTH * max(met)[0]

    def _point(self, first: _Orbit, last: _Orbit, share: float, turning: bool) -> PathPoint | None:
        """The orbit between two others."""
        unknown = first.unknown + share * (last.unknown - first.unknown)
        parameter = first.parameter + share * (last.parameter - first.parameter)
        ends = (first.unknown, first.parameter), (last.unknown, last.parameter)
        return self._in_plane(unknown, parameter, _chord(*ends) if turning else None)


def _chord(first: tuple[np.ndarray, float], last: tuple[np.ndarray, float]) -> Tangent | None:
    """Direction from one motion to another; None where they are the same."""
    change, rise = last[0] - first[0], last[1] - first[1]
    weight = 1.0 / max(float(first[0] @ first[0]), 1e-300)
    length = float(np.sqrt(weight * (change @ change) + rise**2))
    return Tangent(change / length, rise / length, weight) if length > 1e-9 else None


def _highest(curve: ResponseCurve) -> float:
    """Natural frequency [rad/s] of the fastest motion, all pairs closed; infinite where lips have
    no mass."""
    modes = all_modes(curve.structure)
    if curve.structure.light_lips or is_rigid(curve.contact):
        return np.inf
    springs = np.broadcast_to(curve.contact.stiffness, curve.structure.n_pairs)
    closed = np.diag(modes.squares) + between_pairs(modes, springs)
    return float(np.sqrt(np.abs(np.linalg.eigvalsh(closed)).max()))


def _filled(
    motions: np.ndarray, parameters: np.ndarray, longest: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Numbers, motions and parameters of points, and of others between these by cubic splines over
    the distance along the curve, so that no step in the parameter is longer than allowed, relative.
    """
    if len(parameters) < 2:
        return np.zeros(len(parameters)), motions, parameters
    size = float(np.linalg.norm(motions, axis=1).mean()) or 1.0
    rise = np.log(parameters[1:] / parameters[:-1])
    both = np.column_stack([motions / size, parameters])
    length = np.maximum(np.linalg.norm(np.diff(both, axis=0), axis=1), 1e-12)
    counts = np.maximum(np.ceil(np.abs(rise) / longest[:-1]), 1.0)
    at = np.concatenate([n + np.arange(count) / count for n, count in enumerate(counts)])
    between = at.astype(int)
    growth = np.where(rise == 0.0, 1e-30, rise)[between]  # by the same factor from place to place
    shares = np.expm1(growth * (at - between)) / np.expm1(growth)
    along = np.concatenate([[0.0], np.cumsum(length)])
    places = np.append(along[between] + shares * length[between], along[-1])
    found = CubicSpline(along, both)(places)
    return np.append(at, len(length)), size * found[:, :-1], found[:, -1]


def _distinct(crossings: list[_Crossing]) -> list[_Crossing]:
    """Each that is found on a branch once. Without pairs of folds at the same frequency that are
    not: M - I is singular there to rounding."""
    left: list[_Crossing] = []
    for one in crossings:
        near = [other for other in left if other.kind == one.kind and other.located == one.located]
        apart = [abs(one.omega / other.omega - 1.0) for other in near]
        if one.located and min(apart, default=1.0) <= IDENTICAL:
            continue
        fold = near and near[-1] is left[-1] and one.kind == KINDS[0] and not one.located
        if fold and apart[-1] <= ROUNDING:
            left.pop()
        else:
            left.append(one)
    return left


def _near_turns(omega: np.ndarray) -> np.ndarray:
    """Whether the frequency turns back at a point or at the next one on either side: (n,) bool."""
    ahead = np.sign(np.diff(omega))
    turns = np.flatnonzero(ahead[1:] != ahead[:-1]) + 1
    return np.asarray(np.min(np.abs(np.arange(len(omega))[:, None] - turns), 1, initial=9) <= 2)


def _judged(found: Sequence[_Found | None]) -> list[_Orbit | None]:
    """Orbits with their multipliers, which are computed for all at once."""
    known = [one for one in found if one is not None]
    if not known:
        return [None] * len(found)
    values = np.linalg.eigvals(np.array([monodromy for _, _, monodromy in known])) + 0j
    real, large = values.imag == 0.0, np.abs(values) > 1.0
    kinds = real & (values.real > 1.0), real & (values.real < -1.0), large & (values.imag > 0.0)
    outside = np.sum(kinds, axis=2).T.tolist()
    first = np.argmax(np.abs(values), axis=1)
    leading = values[np.arange(len(values)), first]
    leading = leading.real + 1j * np.abs(leading.imag)
    judged = (
        _Orbit(unknown, parameter, complex(value), (counts[0], counts[1], counts[2]))
        for (unknown, parameter, _), value, counts in zip(known, leading, outside, strict=True)
    )
    return [None if one is None else next(judged) for one in found]


def _orbit(found: PathPoint) -> OrbitPoint:
    assert isinstance(found.at, OrbitPoint)
    return found.at


def _test(kind: str, found: PathPoint, pairs: int) -> float:
    """A function that changes its sign at a bifurcation."""
    at = _orbit(found)
    if kind != "neimark_sacker":
        return doubling_test(at.monodromy if kind == KINDS[1] else -at.monodromy)
    values = at.multipliers
    sizes = np.abs(values[values.imag > 0.0])
    return float(sizes[pairs - 1]) - 1.0 if len(sizes) >= pairs else -1.0


def judge_curve(curve: ResponseCurve) -> ResponseCurve:
    """Judge a curve by the exact orbits next to its points.

    A curve over the load frequency is judged by the branch of orbits along it. With at most 12
    pairs with mass and a penalty law these are those of the exact flow from event to event, else of
    2048 and 4096 exponential steps in a period.

    A curve over another parameter is judged point by point, as :func:`floquet` judges a solution.
    Its bifurcations stay those of the truncated equations; the orbits confirm those between whose
    neighbouring points a multiplier of theirs crosses, ``exact`` being interpolated between these.

    Parameters
    ----------
    curve : ResponseCurve
        Followed with or without ``stability=True``, with a law that is linear in contact or rigid.

    Returns
    -------
    ResponseCurve
        The same points, with multipliers and verdicts of the orbits next to them; over the load
        frequency "undecided" where
        there is none, or one at another frequency (by more than 0.001 %), or farther away than 1 %
        and three times the estimated error, or where it does not tell ``|mu|`` from 1, or the exact
        motion that begins with a point leaves it; if these are
        at most 40 points, where :func:`floquet` does not decide
        either. Its bifurcations are those of the orbits, at their frequencies ``exact``,
        each with the nearest one of the truncated equations of the same kind within 2 %, which it
        confirms. Where there is none, ``value`` and ``unknown`` are the solution of the truncated
        equations at the same frequency, or the nearest point of the curve: not a bifurcation of
        these equations, so that :func:`follow_branch` may find no branch there, and says so.
        Unconfirmed are those of the orbits by 4096 steps that those by 2048 do not have, and those
        of the truncated equations where the verdict is open. Those that the orbits refute are left
        out.

    Raises
    ------
    InputError
        As :func:`fenics_crack.shoot`.
    """
    begin("stability by exact orbits")
    if curve.parameter != "omega":
        return judge_points(curve, [_place(curve, one) for one in curve.bifurcations])
    with_mass = not curve.structure.light_lips and is_piecewise_linear(curve.contact)
    if with_mass and curve.structure.n_pairs <= MAX_PAIRS:
        fine = coarse = _Orbits(curve, None)
    else:
        coarse = _Orbits(curve, STEPS[0])
        fine = _Orbits(curve, STEPS[1], coarse)
    multipliers = np.full(len(curve), np.nan + 0j)
    if curve.multipliers is not None:
        multipliers[:] = curve.multipliers
    undecided = np.ones(len(curve), dtype=bool)
    others = dict(zip(coarse.at, coarse.found, strict=True))
    for at, one in zip(fine.at, fine.found, strict=True):
        other = others[at]
        if at == round(at) and one is not None and other is not None:
            place, size = int(at), abs(one.leading)
            multipliers[place] = one.leading
            shift = abs(one.parameter * curve.omega[0] / curve.omega[place] - 1.0)
            sure = abs(size - 1.0) > max(SURE, abs(size - abs(other.leading)))
            undecided[place] = shift > ROUNDING or not sure
    asked = np.array([place for place in np.flatnonzero(~undecided) if fine.doubtful(place)], int)
    undecided[asked] = ~near_points(curve, asked, fine.gap)
    undecided |= fine.turned(curve)
    for place in asked[~undecided[asked]]:
        undecided[place] = fine.disputed(int(place)) or fine.left(int(place))
    special = _special(curve, fine.crossings, _known(fine.crossings, coarse.crossings), undecided)
    left = np.flatnonzero(undecided)
    if len(left) <= SINGLY:
        for place in map(int, left):
            alone = floquet(curve.structure, curve.solution(place))
            if alone.verdict != "undecided":
                multipliers[place], undecided[place] = alone.multipliers[0], False
    return replace(curve, bifurcations=special, multipliers=multipliers, undecided=undecided)


def verified(curve: ResponseCurve) -> ResponseCurve:
    """The same curve with the verdicts and bifurcations of :func:`judge_curve`, and those of the
    truncated equations that the orbits refute, unconfirmed."""
    judged = judge_curve(curve)
    kept = {id(one.unknown) for one in judged.bifurcations}
    refuted = [one for one in curve.bifurcations if id(one.unknown) not in kept]
    special = sorted([*judged.bifurcations, *refuted], key=lambda one: _place(curve, one))
    return replace(judged, bifurcations=tuple(special))


def _known(fine: list[_Crossing], coarse: list[_Crossing]) -> list[bool]:
    """Which bifurcations are also there with other steps, each taken once."""
    left, known = list(coarse), []
    for one in fine:
        alike = [
            (abs(other.omega - one.omega), number)
            for number, other in enumerate(left)
            if other.kind == one.kind and abs(other.point - one.point) <= 2
        ]
        sure = one.located and bool(alike)
        known.append(sure and min(alike)[0] <= SAME * one.omega)
        if known[-1]:
            left.pop(min(alike)[1])
    return known


def _special(
    curve: ResponseCurve, crossings: list[_Crossing], known: list[bool], undecided: np.ndarray
) -> tuple[Bifurcation, ...]:
    """Bifurcations of the orbits at their places on the curve, and those without an orbit."""
    special = [(_place(curve, one), one) for one in curve.bifurcations]
    near = _matched(crossings, special, max(10, len(curve) // 30))
    found: list[tuple[int, Bifurcation]] = []
    for number, (crossing, sure) in enumerate(zip(crossings, known, strict=True)):
        if number in near:
            one = special[near[number]][1]
        else:
            [one] = curve.expand_bifurcations([(crossing.kind, *_solution_at(curve, crossing))])
        found.append((crossing.point, replace(one, exact=crossing.omega if sure else np.nan)))
    for number, (place, one) in enumerate(special):
        open_there = undecided[place] or one.kind == "branch_point"
        if open_there and number not in near.values():
            found.append((place, one))
    return tuple(one for _, one in sorted(found, key=lambda pair: pair[0]))


def _matched(
    crossings: list[_Crossing], special: list[tuple[int, Bifurcation]], points: int
) -> dict[int, int]:
    """The bifurcation of the truncated equations nearest to each of the orbits, by their numbers.

    Those of one kind are assigned so that the sum of their squared distances, in points along the
    curve and in frequency, is smallest: never crosswise. None is farther than ``points`` and
    :data:`NEARBY`.
    """
    far = 2.0
    cost = np.full((len(crossings), len(special)), far)
    for row, crossing in enumerate(crossings):
        for column, (place, one) in enumerate(special):
            along = (place - crossing.point) / points
            apart = (one.value / crossing.omega - 1.0) / NEARBY
            if one.kind == crossing.kind and max(abs(along), abs(apart)) <= 1.0:
                cost[row, column] = min(along**2 + apart**2, 0.99 * far)
    pairs = zip(*scipy.optimize.linear_sum_assignment(cost), strict=True)
    return {int(row): int(column) for row, column in pairs if cost[row, column] < far}


def _solution_at(curve: ResponseCurve, crossing: _Crossing) -> tuple[float, np.ndarray]:
    """The solution of the curve's equations at the frequency of a bifurcation of the orbits, or
    that of the nearest point where none is near: frequency and unknown."""
    unknown, near = curve.unknown(crossing.point), float(curve.values[crossing.point])
    span = near, near * (1.0 + NEARBY)
    family = FrequencyFamily(curve.problem.with_harmonics(len(unknown) // 2), *span)
    parameter = family.parameter(crossing.omega)
    sharp = attainable(family, parameter, 1e-9)
    found = solve_at(family, unknown, parameter, tolerance=sharp)
    if found is None or np.linalg.norm(found.unknown - unknown) > ALIKE * np.linalg.norm(unknown):
        return near, unknown
    return crossing.omega, found.unknown


def _place(curve: ResponseCurve, one: Bifurcation) -> int:
    """The point of a curve nearest to a bifurcation of it."""
    unknown = resized(one.unknown, curve.unknowns.shape[1] // 2)
    sizes = np.linalg.norm(curve.unknowns - unknown, axis=(1, 2)) / np.linalg.norm(unknown)
    wide = float(np.ptp(curve.values)) or 1.0
    return int(np.argmin(np.hypot(sizes, (curve.values - one.value) / wide)))
