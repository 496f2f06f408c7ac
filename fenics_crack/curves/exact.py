"""Verdicts along curves: by the exact orbits next to their points, or else by the waves themselves.

The multipliers of the truncated equations' waves cross the unit circle where those of the motion
need not, above all where contact is stiff and modes beyond the harmonics are lightly damped. So the
branch of exact orbits along a curve is found (:mod:`orbit_branch`), and a point is judged by the
segment of it at its own value of the parameter, on its own side of a fold, if the orbits there are
near enough and the point's own (:mod:`fenics_crack.balance.judgement`): no farther than 1 %, or
than three times the error predicted. Points of branches of twice the period, and some of those
without such an orbit beside them, are judged as :func:`floquet` does.

Laws without an exact flow are judged by their waves, each point as a single solution is. Between
two points lies

- a period doubling where another number of multipliers lies beyond -1: det(I + M) changes its sign;
- a Neimark-Sacker point where the leading pair leaves the unit circle otherwise.

It is located on the path between them (:class:`fenics_crack.numerics.path.Crossing`).

Source: Seydel, Practical Bifurcation and Stability Analysis, chapters 4 and 7.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from copy import copy
from dataclasses import replace
from itertools import pairwise

import numpy as np
import scipy.optimize

from fenics_crack.balance.judgement import BELIEVED, FARTHEST, NO_DOUBT
from fenics_crack.balance.solution import Stability
from fenics_crack.curves.beginnings import chord
from fenics_crack.curves.curve import Bifurcation, ResponseCurve
from fenics_crack.curves.family import Family
from fenics_crack.curves.orbit_branch import ALIKE, OrbitBranch
from fenics_crack.curves.orbit_nodes import EVERY, Node, OrbitBifurcation, blended, cubic
from fenics_crack.curves.stability import floquet, leaves, monodromy, stability_of
from fenics_crack.errors import ConvergenceError, InputError, check_kind
from fenics_crack.model.contact import is_unilateral
from fenics_crack.motion.flow import Budget, ContactFlow, Motion, exact_flow
from fenics_crack.motion.orbit import FORMED, KNOWN, PIECES, doubling_test, eigenvalues
from fenics_crack.motion.shooting import FlowOrbits, OrbitPoint, Patience
from fenics_crack.numerics.equations import CLOSE, DIFFERENCE
from fenics_crack.numerics.fourier import resized
from fenics_crack.numerics.newton import PathPoint, point_on_path, relative_to_motion, solve_at
from fenics_crack.numerics.path import Crossing, PathOptions
from fenics_crack.stages import begin


class VariedOrbits(FlowOrbits):
    """F(x, p) of the exact flows along a family, p its parameter; x in the modes of p = 0."""

    @property
    def compiled(self) -> None:
        """The kernel's loops know one flow."""

    def __init__(
        self, family: Family, displacement: np.ndarray, velocity: np.ndarray, budget: Budget
    ) -> None:
        self._family = family
        first = family.at(family.start)
        flow = exact_flow(first.structure, first.contact)
        state = flow.state(displacement, velocity)
        super().__init__(flow, first.omega, state, first.subharmonic, budget)
        self._there = 0.0, flow, np.eye(flow.size)

    def _at(self, parameter: float) -> tuple[ContactFlow, np.ndarray]:
        """The flow where the parameter has a value, and its states by those of the first."""
        if self._there[0] != parameter:
            try:
                problem = self._family.at(self._family.value(parameter))
            except InputError as error:  # Newton's method has left what the parameter may be
                raise ConvergenceError(str(error)) from None
            flow = exact_flow(problem.structure, problem.contact)
            change = flow.modes.inverse @ self.flow.modes.shapes
            self._there = parameter, flow, np.kron(np.eye(2), change)
        return self._there[1:]

    def _motion(self, unknown: np.ndarray, parameter: float, instants: np.ndarray) -> Motion:
        flow, change = self._at(parameter)
        omega = self._family.omega(self._family.value(parameter))
        period = 2.0 * np.pi * self.subharmonic / omega
        state = change @ self.state(unknown)
        return flow.advance(state, omega, period, instants=instants * period, budget=self.budget)

    def moved(self, unknown: np.ndarray, parameter: float) -> np.ndarray:
        motion = self._motion(unknown, parameter, np.zeros(0))
        return self.unknown(np.linalg.solve(self._at(parameter)[1], motion.state))

    def linearise(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        motion = self._motion(unknown, parameter, np.zeros(0))
        change = self._at(parameter)[1]
        residual = self.unknown(np.linalg.solve(change, motion.state)) - unknown

        def monodromy() -> np.ndarray:
            inner = np.linalg.solve(change, motion.track.tangent @ change)
            return self.of_unknowns(inner)

        def by_parameter() -> np.ndarray:
            # Not beyond the ends of the family: there may be no structure.
            low = max(parameter - DIFFERENCE, min(parameter, 0.0))
            high = min(parameter + DIFFERENCE, max(parameter, 1.0))
            change = self.moved(unknown, high) - self.moved(unknown, low)
            return np.asarray(change / (high - low))

        events, pieces = motion.events, motion.pieces
        return OrbitPoint(unknown, residual, monodromy, by_parameter, events, pieces)


FOR_EVENTS = PIECES // 10
"""Pieces of a motion, beside those that it has without events where the derivatives of all are
formed: ten may take what a search for an orbit may. Where the motions of none of some points keep
to it, no orbits are sought."""
NEARBY = 0.02
"""Of the parameter, relative: how far a bifurcation of the truncated equations may lie from that of
the orbits which confirms it."""


MISSED = 64
"""Points judged by themselves, one after the other, that decide nothing, behind which none is asked
any more: of those of a curve that are open fewer than one in twenty would tell."""


class _Judge:
    """The branch of orbits along a curve, and which of its nodes are the points' own."""

    def __init__(self, curve: ResponseCurve) -> None:
        self._curve = curve
        self.system: FlowOrbits
        [first] = curve.motions(np.zeros(1, dtype=int))
        flow, omega = exact_flow(curve.structure, curve.contact), float(curve.omega[0])
        budget = _budget(curve, flow)
        self._flow = flow if curve.parameter == "omega" else None
        if curve.parameter == "omega":
            self.system = FlowOrbits(flow, omega, flow.state(*first), curve.subharmonic, budget)
            self.parameters = curve.omega / omega
        else:
            family = curve.equations(curve.problem.harmonics)
            self.system = VariedOrbits(family, *first, budget)
            self.parameters = np.array([family.parameter(value) for value in curve.values])
            self._family = family
        self._own: dict[float, bool] = {}
        self._away: dict[float, float] = {}
        self._bounces = not curve.structure.light_lips
        self.affordable = _is_followed(self.system, self._motions, self.parameters)
        """Whether the motion of some point is followed within the budget."""
        if self.affordable:
            self.branch = OrbitBranch(self.system, self.parameters, self._motions)
            self._judge()

    def value(self, parameter: float) -> float:
        """Of the curve's parameter."""
        if self._curve.parameter == "omega":
            return parameter * self.system.omega
        return self._family.value(parameter)

    def _motions(self, places: np.ndarray) -> np.ndarray:
        displacements, velocities = zip(*self._curve.motions(places), strict=True)
        return self.system.unknown_of(np.array(displacements), np.array(velocities))

    # --- which orbits are the points' own ---------------------------------------------------------

    def _judge(self) -> None:
        """Judge nodes next to points, some points apart, and others between those that differ."""
        asked: list[Node] = []
        for one in self.branch.nodes:
            if one.away >= 0.0 and (not asked or one.place - asked[-1].place >= EVERY):
                asked.append(one)
        tried: set[int] = set()
        while asked:
            self._ask(asked)
            between = {
                round(first + last) // 2
                for first, last in pairwise(sorted(self._own))
                if self._own[first] != self._own[last] and last - first > 1.0
            } - tried
            tried |= between
            found = [self.branch.anchor(place) for place in between]
            asked = [one for one in found if one is not None]
        self._anchors = np.array(sorted(self._own))

    def _ask(self, nodes: list[Node]) -> None:
        """Judge some nodes: beyond doubt where the gaps, or all the more the states, are near; but
        where the branch is broken, as it may have gone on along itself where the curve turns back,
        points are judged by themselves."""
        broken = self.branch.broken(nodes)
        self._own.update({one.place: one.place not in broken for one in nodes})
        self._away.update({one.place: one.away for one in nodes})
        apart = [one for one in nodes if self._own[one.place] and one.away > NO_DOUBT**2]
        places = np.array([round(one.place) for one in apart], dtype=int)
        waves = self._curve.gaps_in_time(places) if apart else ()
        for node, place, wave in zip(apart, map(int, places), waves, strict=True):
            off = self._off(wave, node.unknown, node.parameter)
            near = max(off, node.away) <= NO_DOUBT
            self._own[node.place] = near or self._is_own(node, place, off)

    def _off(self, wave: np.ndarray, unknown: np.ndarray, parameter: float) -> float:
        """How far the gaps of a point are from those of an orbit, relative."""
        gap = self.system.gap(unknown, parameter, len(wave))
        return relative_to_motion(gap - wave, gap + self._curve.structure.clearance)

    def _is_own(self, node: Node, place: int, off: float) -> bool:
        """Whether a solution is judged by a node's orbit."""
        judged, orbit = self._curve.judged(place, self._flow), None
        if self._curve.parameter == "omega" and node.parameter == self.parameters[place]:
            found = PathPoint(node.unknown, node.parameter, 0, node.tangent)
            orbit = self.system.orbit(found)
        admitted = judged.admits(off, node.away, orbit)
        if not admitted or not self._bounces or any(node.outside):
            return admitted
        motion = self.branch.motion(place)  # the exact one may leave the stable orbit next to it
        return not leaves(self.system, motion, node.unknown, node.parameter)

    # --- points -----------------------------------------------------------------------------------

    def points(self) -> np.ndarray:
        """Leading multiplier of each point; nan where no orbit is its own. Where orbits at its
        value of the parameter lie on both sides of a fold it is that of the nearest one, if its
        gaps are clearly nearer, too; where several motions are as near, or none is near enough,
        there is none. Points that no node judges are judged by the orbits next to them; so are all
        of a branch of twice the period, next to whose end the old orbit is as near as the new."""
        found, (accepted, expected) = np.full(len(self._curve), np.nan + 0j), self._accepted()
        if self.branch.linked.any() and self._curve.subharmonic % 2:
            self._by_segments(found, accepted, expected)
        self._singly(found)
        return found

    def _by_segments(self, found: np.ndarray, accepted: np.ndarray, expected: np.ndarray) -> None:
        """Judge points that segments tell, of those accepted: no more where they do not tell."""
        count = len(found)
        segment, place, share = self._parts(accepted)
        value = _between(self.branch, segment, share)
        side = _side(value)

        def disagree(chosen: np.ndarray) -> np.ndarray:
            """Whether multipliers of chosen parts beside each point may lie on both sides of 1."""
            one_side = np.abs(np.bincount(place[chosen], side[chosen], count))
            return one_side < np.bincount(place[chosen], minlength=count)

        sided = np.flatnonzero(disagree(told := np.full(len(place), True)))
        waves = self._curve.gaps_in_time(sided) if len(sided) else ()
        for one, wave in zip(sided, waves, strict=True):
            beside = place == one
            told[beside] = self._told(wave, segment[beside], share[beside], side[beside])
            accepted[one] = told[beside].any()
        places = np.array([one.place for one in self.branch.nodes])
        inside = (places[segment] <= place) & (place <= places[segment + 1])
        inside &= expected[place] <= FARTHEST
        apart, least = np.zeros(len(place)), np.full(count, np.inf)
        asked = ~inside | (np.bincount(place, minlength=count)[place] > 1)
        if asked.any():
            motions = self.branch.motions(place[asked])
            off = self.branch.at(segment[asked], share[asked]) - motions
            sizes = np.maximum(np.linalg.norm(motions, axis=1), 1e-300)
            apart[asked] = np.linalg.norm(off, axis=1) / sizes
        apart[~told] = np.inf
        np.minimum.at(least, place, apart)
        order = np.lexsort((apart, place))
        nearest = order[np.unique(place[order], return_index=True)[1]]
        near = inside[nearest] | (apart <= np.minimum(expected, FARTHEST)[place])[nearest]
        near &= (accepted & ~disagree(apart <= BELIEVED * least[place]))[place[nearest]]
        chosen = nearest[near]
        found[place[chosen]] = value[chosen]
        for one in place[chosen[_uncertain(self.branch, segment[chosen], share[chosen])]]:
            if (node := self._node_at(int(one))) is not None:
                found[one] = _upper(node.leading[0])

    def _parts(self, accepted: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where a segment, linked or not, has the parameter of a point near it that is accepted:
        the segment, the point, and the part of the segment, (m,) each."""
        nodes, last = self.branch.nodes, len(self._curve) - 1
        parameters = np.array([one.parameter for one in nodes])
        places, rises = np.array([one.place for one in nodes]).astype(int), np.diff(parameters)
        number = np.flatnonzero(rises)
        first = np.maximum(0, places[number] - 2 * EVERY)
        counts = np.minimum(last, places[number + 1] + 2 * EVERY) - first + 1
        segment, begins = np.repeat(number, counts), np.cumsum(counts) - counts
        place = np.arange(len(segment)) + np.repeat(first - begins, counts)
        share = (self.parameters[place] - parameters[segment]) / rises[segment]
        there = (np.abs(share - 0.5) <= 0.5 + CLOSE) & accepted[place]
        return segment[there], place[there], share[there]

    def _singly(self, found: np.ndarray) -> None:
        """Judge points whose orbits nodes do not tell one by one: the ends of stretches, every
        other between them, and those next to one that is decided; without homotopies once two have
        decided nothing, and without paths a little later. Those far apart come first, until too
        many decide nothing."""
        left, missed = set(np.flatnonzero(np.isnan(found)).tolist()), 0
        patience = Patience(2, MISSED // 4)
        asked = [place for place in sorted(left) if place % 2 or {place - 1, place + 1} - left]
        order = sorted(range(len(asked)), key=lambda number: number & -number)
        asked = [asked[number] for number in order]
        while asked and missed < MISSED:
            place = asked.pop()
            if place in left:
                left.remove(place)
                before = copy(patience)
                found[place], missed = self.by_itself(place, patience), missed + 1
                if not np.isnan(found[place]):
                    asked += [place - 1, place + 1]
                    patience, missed = before, 0

    def by_itself(self, place: int, patience: Patience | None = None) -> complex:
        """Leading multiplier of a point judged as a single solution is, with the ``patience`` of
        :func:`orbit_next_to`; nan where that is open, or where the branch has an orbit there that
        is as near and may be on the other side of 1: next to a fold the error is that of both."""
        near = None if self._flow is None else self.branch.added_near(place)
        added = None if near is None else self.system.state(near)
        judged = self._curve.judged(place, self._flow, patience=patience, added=added)
        alone = stability_of(judged)
        if alone.verdict == "undecided":
            return complex(np.nan)
        assert judged.orbit is not None
        leading = alone.multipliers[0]
        if self._flow is not None:
            added = self.system.unknown(judged.orbit.state - judged.states[0])
            self.branch.added[place] = added
        segment, _, share = self._parts(np.arange(len(self._curve)) == place)
        other = _side(_between(self.branch, segment, share, linked=False)) != _side(leading)
        if other.any():
            [wave] = self._curve.gaps_in_time(np.array([place]))
            away = self._apart(wave, segment[other], share[other])
            leading = np.nan if np.any(away <= (1.0 + FARTHEST) * alone.distance) else leading
        return complex(_upper(np.complex128(leading)))

    def _told(
        self, wave: np.ndarray, segment: np.ndarray, share: np.ndarray, side: np.ndarray
    ) -> np.ndarray:
        """Which parts next to a point are on the side of 1 of that with the nearest gaps; none
        where one on the other has as near ones: the error next to a fold is that of both."""
        away = self._apart(wave, segment, share)
        near = side[away <= BELIEVED * away.min()]
        return (side == near[0]) & (np.abs(near.sum()) == len(near))

    def _apart(self, wave: np.ndarray, segment: np.ndarray, share: np.ndarray) -> np.ndarray:
        """How far the gaps of a point are from those at parts of segments: (m,), relative."""
        parts = ((*self.branch.nodes[k : k + 2], s) for k, s in zip(segment, share, strict=True))
        return np.array([self._off(wave, *cubic(*part)) for part in parts])

    def _node_at(self, place: int) -> Node | None:
        """The node next to a point at its value of the parameter; None where there is none, or it
        is not its own, or does not tell."""
        node = self.branch.next_to(place, across=False)
        if node is None or abs(node.moduli[0] - 1.0) <= KNOWN:
            return None
        self._ask([node])
        return node if self._own[place] else None

    def _accepted(self) -> tuple[np.ndarray, np.ndarray]:
        """Whether the orbits on both sides of a point are the points' own and the branch is not
        broken between them, (n,) bool, and how far away its own orbit may be, by those: (n,)."""
        places = np.arange(len(self._curve))
        if not len(self._anchors):
            return np.zeros(len(places), dtype=bool), np.zeros(len(places))
        own = np.array([self._own[place] for place in self._anchors])
        away = BELIEVED * np.array([self._away[place] for place in self._anchors])
        before = np.clip(np.searchsorted(self._anchors, places, "right") - 1, 0, None)
        after = np.clip(np.searchsorted(self._anchors, places), None, len(own) - 1)
        breaks = [self.branch.nodes[number].place for number in self.branch.breaks]
        stretch = np.searchsorted(breaks, self._anchors)
        accepted = own[before] & own[after] & (stretch[before] == stretch[after])
        return accepted, np.maximum(away[before], away[after])


def _budget(curve: ResponseCurve, flow: ContactFlow) -> Budget:
    """Of each motion: of a few modes what the longest period takes, and events."""
    longest = 2.0 * np.pi * curve.subharmonic / float(curve.omega.min())
    without_events = min(flow.pieces(longest), Budget().pieces) if flow.size <= FORMED else 0.0
    return Budget(pieces=FOR_EVENTS + math.ceil(without_events))


def _is_followed(
    system: FlowOrbits, motions: Callable[[np.ndarray], np.ndarray], parameters: np.ndarray
) -> bool:
    """Whether the motion of the first, the middle or the last point keeps to the budget."""
    for place in np.unique([0, len(parameters) // 2, len(parameters) - 1]):
        with suppress(ConvergenceError):
            system.moved(motions(np.array([place]))[0], float(parameters[place]))
            return True
    return False


def _side(leading: np.ndarray) -> np.ndarray:
    """Of the unit circle on which multipliers are: 1 outside, -1 inside; 0 where they are nan."""
    return np.nan_to_num(np.sign(np.abs(leading) - 1.0))


def _between(
    branch: OrbitBranch, segment: np.ndarray, share: np.ndarray, *, linked: bool = True
) -> np.ndarray:
    """Leading multipliers at parts of segments, (n,) complex, on the side of 1 of their ends that
    are no bifurcations; nan where these differ, or do not tell it from 1, or where one that is a
    bifurcation is not located, and where they have to be ``linked`` and are not. Nodes at an end
    tell by themselves."""
    nodes = branch.nodes
    if not len(segment):  # nor is there any node, perhaps
        return np.zeros(0, dtype=complex)
    leading = np.array([one.leading[0] for one in nodes])
    size, met = np.abs(leading), np.array([one.crossing is not None for one in nodes])
    lost = np.array([one.crossing is not None and not one.crossing.located for one in nodes])
    first, last = segment, segment + 1
    sides = np.where(met[first], last, first), np.where(met[last], first, last)
    begin, end = size[sides[0]], size[sides[1]]
    unknown = lost[first] | lost[last] | (met[first] & met[last]) | ((begin > 1.0) != (end > 1.0))
    unknown |= np.minimum(np.abs(begin - 1.0), np.abs(end - 1.0)) <= KNOWN
    moduli = (1.0 - share) * size[first] + share * size[last]
    kinds = np.sign(leading.real) * (leading.imag == 0.0)
    for one in np.unique(segment[kinds[first] != kinds[last]]):  # perhaps a pair becomes real
        there = segment == one
        moduli[there] = blended(nodes[one], nodes[one + 1], share[there])[0]
    inside = np.minimum(moduli, 1.0 - 2.0 * KNOWN), np.maximum(moduli, 1.0 + 2.0 * KNOWN)
    found = np.where(begin > 1.0, inside[1], inside[0]) + 0j
    found *= (_upper(leading) / np.maximum(size, 1e-300))[np.where(share < 0.5, *sides)]
    found[unknown | (linked & ~branch.linked[segment])] = np.nan
    known = ~met & (np.abs(size - 1.0) > KNOWN)
    for end, there in ((first, share <= CLOSE), (last, share >= 1.0 - CLOSE)):
        told = there & known[end]
        found[told] = _upper(leading[end[told]])
    return found


def _uncertain(branch: OrbitBranch, segment: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Whether ln |mu| of the leading multiplier changes on a segment by more than it differs from
    zero at a part of it, that is not an end: (n,) bool."""
    logs = np.log(np.maximum([abs(one.leading[0]) for one in branch.nodes], 1e-300))
    begin, end = logs[segment], logs[segment + 1]
    there = np.abs(begin + share * (end - begin))
    return np.asarray((there < np.abs(end - begin)) & (np.minimum(share, 1.0 - share) > CLOSE))


def judge_curve(curve: ResponseCurve) -> ResponseCurve:
    """Judge a curve over any parameter by the branch of exact orbits along it.

    Laws that are not linear in contact have no exact orbits: their points are judged one by one, as
    :func:`floquet` does, and period doublings and Neimark-Sacker points are where multipliers of
    the waves leave the unit circle, unconfirmed.

    Parameters
    ----------
    curve : ResponseCurve
        Followed with or without ``stability=True``.

    Returns
    -------
    ResponseCurve
        The same points, with verdicts of the orbits next to them, and multipliers interpolated
        between these; "undecided" (and nan) where there is none at the point's value of the
        parameter on its own side of a fold, or none that is the point's own, as farther away than
        1 % and three times the error predicted, or where it does not tell ``|mu|`` from 1. Its
        bifurcations are those of the orbits, at their values ``exact``, each with the nearest one
        of the truncated equations of the same kind within 2 %, which it confirms. Where there is
        none, ``value`` and ``unknown`` are the solution of the truncated equations at the same
        value, or the nearest point of the curve: not a bifurcation of these equations, so that
        :func:`follow_branch` may find no branch there, and says so. Unconfirmed are those that are
        not located, and those of the truncated equations where the verdict is open. Those that the
        orbits refute are left out.

    Raises
    ------
    InputError
        As :func:`fenics_crack.shoot`.

    Examples
    --------
    >>> judged = fc.judge_curve(curve)
    >>> verdicts = judged.verdicts
    """
    check_kind("curve", curve, ResponseCurve)
    if not is_unilateral(curve.contact):
        return judged_by_waves(curve)
    begin("stability by exact orbits")
    judge = _Judge(curve)
    if not judge.affordable:
        nothing = np.full(len(curve), np.nan + 0j)
        return replace(curve, multipliers=nothing, undecided=np.ones(len(curve), dtype=bool))
    crossings = _distinct(judge.branch.locate())
    multipliers = judge.points()
    undecided = np.isnan(multipliers)
    special = _special(curve, judge, crossings, undecided)
    return replace(curve, bifurcations=special, multipliers=multipliers, undecided=undecided)


def _upper(value: np.ndarray) -> np.ndarray:
    """With positive imaginary parts."""
    return np.asarray(value.real + 1j * np.abs(value.imag))


def verified(curve: ResponseCurve) -> ResponseCurve:
    """The same curve with the verdicts and bifurcations of :func:`judge_curve`, and of pairs with
    mass those of the truncated equations that the orbits refute, unconfirmed."""
    judged = judge_curve(curve)
    if curve.structure.light_lips:
        return judged
    kept = {id(one.unknown) for one in judged.bifurcations}
    had = [one for one in curve.bifurcations if one.kind in FOLLOWED]
    refuted = [one for one in had if id(one.unknown) not in kept]
    special = sorted([*judged.bifurcations, *refuted], key=lambda one: place_on(curve, one))
    return replace(judged, bifurcations=tuple(special))


def _special(
    curve: ResponseCurve, judge: _Judge, crossings: list[OrbitBifurcation], undecided: np.ndarray
) -> tuple[Bifurcation, ...]:
    """Bifurcations of the orbits at their places on the curve, and those without an orbit."""
    special = [(place_on(curve, one), one) for one in curve.bifurcations]
    values = [judge.value(crossing.parameter) for crossing in crossings]
    near = _matched(curve, list(zip(crossings, values, strict=True)), special)
    found: list[tuple[float, Bifurcation]] = []
    for number, crossing in enumerate(crossings):
        if number in near:
            one = special[near[number]][1]
        else:
            there = _solution_at(curve, round(crossing.place), values[number])
            one = curve.bifurcation(crossing.kind, *there)
        exact = values[number] if crossing.located else np.nan
        found.append((crossing.place, replace(one, exact=exact)))
    for number, (place, one) in enumerate(special):
        open_there = undecided[place] or one.kind == "branch_point"
        if open_there and number not in near.values():
            found.append((place, one))
    return tuple(one for _, one in sorted(found, key=lambda pair: pair[0]))


def _distinct(crossings: list[OrbitBifurcation]) -> list[OrbitBifurcation]:
    """Each that is located once, as nodes may come back a little; without pairs that are not, as
    where M - I is singular to rounding."""
    left: list[OrbitBifurcation] = []
    for one in crossings:
        known = [other for other in left if other.kind == one.kind]
        apart = [abs(one.parameter - other.parameter) for other in known if other.located]
        if one.located and min(apart, default=1.0) <= CLOSE:
            continue
        if known and not one.located and not known[-1].located and known[-1] is left[-1]:
            left.pop()
        else:
            left.append(one)
    return left


def _matched(
    curve: ResponseCurve,
    crossings: list[tuple[OrbitBifurcation, float]],
    special: list[tuple[int, Bifurcation]],
) -> dict[int, int]:
    """The bifurcation of the truncated equations nearest to each of the orbits, by their numbers.

    Those of one kind are assigned so that the sum of their squared distances, in points along the
    curve and in the parameter, is smallest: never crosswise. None is farther than a thirtieth of
    the points and :data:`NEARBY`.
    """
    far, points = 2.0, max(10, len(curve) // 30)
    wide = 0.0 if curve.parameter == "omega" else float(np.ptp(curve.values))
    cost = np.full((len(crossings), len(special)), far)
    for row, (crossing, value) in enumerate(crossings):
        for column, (place, one) in enumerate(special):
            along = (place - crossing.place) / points
            apart = (one.value - value) / (NEARBY * max(abs(value), wide))
            if one.kind == crossing.kind and max(abs(along), abs(apart)) <= 1.0:
                cost[row, column] = min(along**2 + apart**2, 0.99 * far)
    pairs = zip(*scipy.optimize.linear_sum_assignment(cost), strict=True)
    return {int(row): int(column) for row, column in pairs if cost[row, column] < far}


def _solution_at(curve: ResponseCurve, place: int, value: float) -> tuple[float, np.ndarray]:
    """The solution of the curve's equations where the orbits bifurcate, or that of the nearest
    point where none is near: value and unknown."""
    unknown, near = curve.unknown(place), float(curve.values[place])
    family = curve.equations(len(unknown) // 2)
    try:
        parameter = family.parameter(value)
        sharp = max(PathOptions.rtol, family.rounding(parameter))
        found = solve_at(family, unknown, parameter, tolerance=sharp)
    except ConvergenceError:
        found = None
    if found is None or np.linalg.norm(found.unknown - unknown) > ALIKE * np.linalg.norm(unknown):
        return near, unknown
    return value, found.unknown


FOLLOWED = "fold", "branch_point"
"""Kinds of bifurcations that a curve has before it is judged."""


def judged_by_waves(curve: ResponseCurve) -> ResponseCurve:
    """The same curve with verdicts, and with bifurcations where multipliers of its waves leave the
    unit circle."""
    begin("stability of each point")
    solutions = (curve.solution(place, search=False) for place in range(len(curve)))
    found = [floquet(one.structure, one) for one in solutions]
    special = [one for one in curve.bifurcations if one.kind in FOLLOWED]
    for place in range(len(curve) - 1):
        kind = _crossed(*found[place : place + 2])
        if kind is not None:
            special.append(curve.bifurcation(kind, *_located(curve, place, kind)))
    special.sort(key=lambda one: place_on(curve, one))
    multipliers = np.array([one.multipliers[0] for one in found])
    return replace(
        curve,
        bifurcations=tuple(special),
        multipliers=multipliers.real + 1j * np.abs(multipliers.imag),
        undecided=np.array([one.verdict == "undecided" for one in found]),
    )


def _crossed(before: Stability, after: Stability) -> str | None:
    """The kind of what lies between two points."""
    sides = [one.multipliers for one in (before, after)]
    beyond, outside = (
        [int(np.count_nonzero(among(values))) for values in sides]
        for among in (lambda mu: (mu.imag == 0.0) & (mu.real < -1.0), lambda mu: np.abs(mu) > 1.0)
    )
    if not np.all(np.isfinite([values[0] for values in sides])):
        return None
    if beyond[0] % 2 != beyond[1] % 2:
        return "period_doubling"
    leaving = sides[0] if outside[0] else sides[1]
    pair = bool(outside[0]) != bool(outside[1]) and leaving[0].imag != 0.0
    return "neimark_sacker" if pair else None


def _located(curve: ResponseCurve, place: int, kind: str) -> tuple[float, np.ndarray]:
    """Value of the parameter and unknown of a bifurcation behind a point."""
    count = int(max(curve.harmonics[place : place + 2]))
    family = curve.equations(count)
    way = chord(family, curve, place, place + 1)
    first, last = (
        point_on_path(
            family, resized(curve.unknown(one), count), family.parameter(curve.values[one]), way
        )
        for one in (place, place + 1)
    )

    def test(at: PathPoint) -> float:
        matrix = _monodromy(family, at)
        if kind == "period_doubling":
            return doubling_test(matrix)
        return float(np.abs(eigenvalues(matrix)[0])) - 1.0

    found = Crossing(test).locate(family, (first, last), family.rounding(last.parameter))
    assert found is not None
    return family.value(found.parameter), found.unknown


def _monodromy(family: Family, at: PathPoint) -> np.ndarray:
    """M of the wave at a point."""
    problem = family.at(family.value(at.parameter))
    above = problem.static_cutoff
    return monodromy(problem.structure, problem.contact, at.unknown, problem.base_omega, above)


def place_on(curve: ResponseCurve, one: Bifurcation) -> int:
    """The point of a curve nearest to a bifurcation of it."""
    unknown = resized(one.unknown, curve.unknowns.shape[1] // 2)
    sizes = np.linalg.norm(curve.unknowns - unknown, axis=(1, 2)) / np.linalg.norm(unknown)
    wide = float(np.ptp(curve.values)) or 1.0
    return int(np.argmin(np.hypot(sizes, (curve.values - one.value) / wide)))
