"""The branch of exact orbits along a curve: nodes, and the bifurcations between them.

Next to every eighth point of the curve an orbit F(x, p) = 0 (:mod:`fenics_crack.motion.shooting`)
is found by Newton's method, from the point's own motion and what had to be added to that of the
node beside: at the point's parameter, or, next to folds, in the plane across the curve. A node has
the tangent of the branch and the leading multipliers mu of its orbit, and of all multipliers

    r = number of real mu > 1,    d = number of real mu < -1,    c = pairs with |mu| > 1.

A segment between two nodes is halved, by the orbit next to Hermite's cubic through both,

- where the chord disagrees with their tangents;
- where the moduli at a node are not those between its neighbours', to their distance from 1, nor
  those of pairs whose sums and products are (where a pair becomes real, moduli have a corner, but
  its sum and its product are smooth): the longer of the two segments;
- where moduli that went on as they came would pass 1 before its middle;
- where the angles of two pairs that went on as they came from both sides would pass each other, or
  that of one 0 or pi, or from one side before its middle: there pairs of a motion without damping
  leave the unit circle, and meet it again;
- where pairs of lips open and close a quarter more often at one end than at the other: multipliers
  turn on like a square root where a motion begins to touch;
- once at either end of the curve, where nothing comes from beyond;
- where several of r, d and c change, or one by more than 1, until each changes by itself.

Along a smooth branch (-1)^r t_p keeps its sign (det F_x has that of (-1)^r). Where it does not,
there is a branch point, or the nodes are of different branches: those beyond a fold of the curve
may be the orbits before it once more.

Then a fold (or a branch point) lies on a segment where r changes, a period doubling where d does, a
Neimark-Sacker point where c does. It is found by Brent's method on

    t_p (the tangent's),    the product of 1 + mu,    |mu| - 1 of the pair that leaves,

and becomes a node. Two real multipliers outside that meet and become a pair are no bifurcation.

Angles that differ by g where the pairs do not act on each other are the same, and moduli r apart
by factors of e^s, s^2 = e^2 - (g / 2)^2, where these act by e. One passes 1 if e > -ln r, so that a
node as near to g = 0 as a quarter of -ln r shows it, all but where it passes 1 by less than 1 % of
1 - r.

What is not seen: two crossings of one kind on one segment that do not announce themselves.

Source: Seydel, Practical Bifurcation and Stability Analysis, chapters 4, 5 and 7.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.optimize
from scipy.interpolate import barycentric_interpolate
from scipy.linalg.lapack import dgeqrf, dorgqr

from fenics_crack.errors import ConvergenceError
from fenics_crack.motion.orbit import KNOWN, SHRINKING, eigenvalues
from fenics_crack.motion.shooting import FlowOrbits, Homotopy, OrbitPoint
from fenics_crack.numerics.bordered import (
    FULL_STEPS,
    PATIENCE,
    PathPoint,
    Tangent,
    solve_in_plane,
    tangent_of,
)
from fenics_crack.numerics.path import LOCATED, STRAIGHT

__all__ = ["KINDS", "Crossing", "Node", "OrbitBranch", "blended", "cubic"]

KINDS = "fold", "period_doubling", "neimark_sacker"
EVERY = 8
"""Points of a curve from one node to the next."""
NARROWEST, ALONE = 1.0 / 8.0, 1.0 / 32.0
"""Segments that are not halved any more, in points of the curve, and those that are not smooth or
where several numbers change."""
TOLERANCE = 1e-8
"""|F| / |x| of nodes, and to what part of a segment bifurcations are located."""
ALIKE = 0.5
"""Farthest orbit from the motion of its point; whether it is the point's own is asked later."""
REACH = 5e-3
"""Farthest orbit from the parameter of its point, of the whole."""
LEADING = 8
"""Multipliers that are kept."""
RESOLVED = 0.02
"""What a modulus may be off that between others, if it does not differ more from 1."""
COLUMNS, SQUARINGS, TURNS = 24, 4, 9
"""Of many multipliers those of M in the span of some columns that M^16 has turned to the leading
ones some times are taken, where these are known well."""
SMOOTH = 0.25
"""Of a test function's largest value, what may be left where it vanishes."""


@dataclass(frozen=True)
class Node:
    """An orbit of the branch.

    Attributes
    ----------
    place : float
        Along the curve, in points.
    unknown, parameter, tangent
        x, p and the tangent onwards.
    multipliers : (k,) complex
        Of largest modulus, in their order; of systems that are not large all.
    outside : tuple of int
        r, d and c.
    events : int
        How often pairs open and close in a period.
    away : float
        From the motion of its point, relative; nan where it has none.
    crossing : Crossing or None
        The bifurcation that it is.
    """

    place: float
    unknown: np.ndarray
    parameter: float
    tangent: Tangent
    multipliers: np.ndarray
    outside: tuple[int, int, int]
    events: int
    away: float = np.nan
    crossing: Crossing | None = None

    @cached_property
    def leading(self) -> np.ndarray:
        """Those by which points are judged: (8,) complex, or fewer."""
        return self.multipliers[:LEADING]

    @cached_property
    def turns(self) -> np.ndarray:
        """-ln r and angles in (0, pi) of the pairs of multipliers: (k, 2)."""
        upper = self.multipliers[self.multipliers.imag > 0.0]
        return np.column_stack([-np.log(np.abs(upper)), np.angle(upper)])

    @cached_property
    def moduli(self) -> np.ndarray:
        """Of the leading multipliers."""
        return np.abs(self.leading)

    @cached_property
    def pairs(self) -> np.ndarray:
        """Sums and products of the multipliers that are pairs, or were or will be: (k, 2)."""
        return _paired(self.leading)

    @cached_property
    def real(self) -> float:
        """How many more of them are positive than negative, of those that are real."""
        return float(np.sign(self.leading.real[self.leading.imag == 0.0]).sum())


@dataclass(frozen=True)
class Crossing:
    """A bifurcation of the orbits.

    Attributes
    ----------
    kind : str
    parameter : float
    place : float
        Along the curve, in points.
    located : bool
        Whether all orbits were found that its place needs.
    """

    kind: str
    parameter: float
    place: float
    located: bool


class OrbitBranch:
    """The orbits next to a curve.

    Parameters
    ----------
    system : FlowOrbits
        F(x, p).
    parameters : (n,)
        p of the curve's points.
    motions : callable
        x of the motions of points, by their numbers: (m, 2n).

    Attributes
    ----------
    nodes : list of Node
        Ascending places.
    """

    def __init__(
        self,
        system: FlowOrbits,
        parameters: np.ndarray,
        motions: Callable[[np.ndarray], np.ndarray],
        every: int = EVERY,
    ) -> None:
        self.system, self._parameters, self._motions = system, parameters, motions
        self._reach = REACH * max(1.0, float(np.ptp(parameters)))
        self._known: dict[int, np.ndarray] = {}
        self._homotopy = Homotopy(system)
        self._turn = _to_turns(parameters)
        self._halved: set[tuple[float, float]] = set()
        self._missed: set[tuple[float, float]] = set()
        self.nodes: list[Node] = []
        last = len(parameters) - 1
        places = np.unique(np.append(np.arange(0, last, every), last))
        self.motions(places)
        for place in map(int, places):
            found = self._next_to(place, self.nodes[-1:])
            self.nodes += [] if found is None else [found]
        self._refine()

    # --- nodes ------------------------------------------------------------------------------------

    def _refine(self) -> None:
        """Halve segments until each that is in doubt has been."""
        found: list[Node] | None = None
        while found is None or found:
            found, linked = [], self.linked
            segments = list(pairwise(self.nodes))
            places = [(first.place, last.place) for first, last in segments]
            whole = np.array([one not in self._halved for one in places], dtype=bool)
            halved = np.flatnonzero(self._in_doubt(linked, whole))
            self._halved.update(places[number] for number in halved)
            apart = [round(sum(places[number]) / 2) for number in halved if not linked[number]]
            self.motions(np.array(apart, dtype=int))
            for number in halved:
                middle = self._middle(segments[number], bool(linked[number]))
                found += [] if middle is None else [middle]
                self._missed.update([places[number]] if middle is None else [])
            self.nodes = sorted([*self.nodes, *found], key=lambda one: one.place)

    def _in_doubt(self, linked: np.ndarray, whole: np.ndarray) -> np.ndarray:
        """Whether orbits or multipliers on each segment that is still ``whole`` may be others than
        those between its ends: (n - 1,) bool."""
        nodes, doubt = self.nodes, np.zeros_like(linked)
        if len(nodes) < 2:
            return doubt
        wide = np.diff([one.place for one in nodes])
        if len(nodes) > 2:
            lengths, moduli = _chords(nodes)[2], np.array([one.moduli for one in nodes])
            before, behind = wide[:-1] >= wide[1:], wide[1:] >= wide[:-1]
            left = whole & (wide > NARROWEST)
            asked = (left[:-1] & before) | (left[1:] & behind)
            asked &= np.maximum(wide[:-1], wide[1:]) <= EVERY
            bent = _bent(nodes, moduli, lengths, asked)
            doubt[:-1] |= bent & before
            doubt[1:] |= bent & behind
            doubt[1:] |= _pass_one(moduli, lengths)
            doubt[:-1] |= _pass_one(moduli[::-1], lengths[::-1])[::-1]
            doubt |= _pass_each_other(nodes, lengths) | _leave_between(nodes, lengths)
        events = np.array([one.events for one in nodes])
        least, most = np.sort([events[:-1], events[1:]], axis=0)
        doubt |= (most > least) & (most >= 1.25 * least) & (wide > 1.0)
        doubt[[0, -1]] |= wide[[0, -1]] > EVERY // 2
        several = ~linked | (_steps(nodes).sum(axis=1) > 1)
        doubt &= wide > NARROWEST
        return whole & ((wide > EVERY) | doubt | (several & (wide > ALONE)))

    @property
    def linked(self) -> np.ndarray:
        """Whether a smooth branch leads beyond doubt from each node to the next: (n - 1,) bool."""
        nodes = self.nodes
        if len(nodes) < 2:
            return np.zeros(0, dtype=bool)
        missed = [(one.place, other.place) in self._missed for one, other in pairwise(nodes)]
        return _straight(nodes) & ~_broken(nodes) & ~np.array(missed)

    @property
    def breaks(self) -> np.ndarray:
        """Numbers of the nodes behind which the branch is broken."""
        return np.flatnonzero(_broken(self.nodes))

    def broken(self, nodes: list[Node]) -> set[float]:
        """Places of those of some nodes beside which the nodes with their r end where the branch is
        broken: their orbits may be those of another part of the curve."""
        return _beside(self.nodes, self.breaks, nodes) if len(self.breaks) else set()

    def _middle(self, ends: tuple[Node, Node], linked: bool) -> Node | None:
        """A node between two others; None where none is found."""
        first, last = ends
        whole = round(0.5 * (first.place + last.place))
        inside = first.place < whole < last.place
        found = self.across(first, last, 0.5, {}, TOLERANCE) if linked or not inside else None
        if found is not None:
            return self.inside(first, last, 0.5, found)
        return self._next_to(whole, [first, last]) if inside else None

    def motion(self, place: int) -> np.ndarray:
        """x of the motion of a point."""
        return np.asarray(self.motions(np.array([place]))[0])

    def motions(self, places: np.ndarray) -> np.ndarray:
        """x of the motions of some points, found at once and kept: (m, 2n)."""
        new = [place for place in places.tolist() if place not in self._known]
        if new:
            self._known.update(zip(new, self._motions(np.array(new)), strict=True))
        return np.array([self._known[place] for place in places.tolist()])

    def at(self, segment: np.ndarray, share: np.ndarray) -> np.ndarray:
        """x at parts of segments, given by their numbers: (m, 2n)."""
        changes, _, lengths = _chords(self.nodes)
        ways = np.array([one.tangent.x for one in self.nodes])
        first = np.array([one.unknown for one in self.nodes])[segment]
        ends = ways[segment], ways[segment + 1]
        return first + _hermite(changes[segment], lengths[segment, None], *ends, share[:, None])

    def anchor(self, place: int) -> Node | None:
        """The node next to a point of the curve; None where none is found."""
        number = int(np.searchsorted([one.place for one in self.nodes], place))
        there = [one for one in self.nodes[number : number + 1] if one.place == place]
        if there and there[0].away >= 0.0:
            return there[0]
        node = self._next_to(place, self.nodes[max(0, number - 1) : number + 1])
        if node is not None:
            self.nodes[number : number + len(there)] = [node]
        return node

    def alone(self, place: int) -> Node | None:
        """The node next to a point of the curve at the point's own parameter, also next to folds;
        None where none is found."""
        number = int(np.searchsorted([one.place for one in self.nodes], place))
        return self._next_to(place, self.nodes[max(0, number - 1) : number + 2], across=False)

    def _next_to(self, place: int, beside: list[Node], *, across: bool = True) -> Node | None:
        """The orbit next to a point, with those of some nodes known; with ``across`` also in the
        plane across the curve."""
        motion, parameter = self.motion(place), float(self._parameters[place])
        planes = [True] if across and self._turn[place] <= 2 else [False, True][: 1 + across]
        for start in self._starts(place, beside, far=across):
            for plane in planes:
                chord = self._ahead(place, along=True) if plane else None
                found = self._solved(start, parameter, chord)
                if found is None:
                    continue
                away = float(np.linalg.norm(found.unknown - motion) / np.linalg.norm(motion))
                if away <= ALIKE:
                    return self._node(place, found, self._ahead(place, along=False), away)
        return None

    def _starts(self, place: int, beside: list[Node], *, far: bool) -> Iterator[np.ndarray]:
        """Where the orbit next to a point is sought: from its motion and what had to be added to
        that of the nearest node, from its motion, and, ``far`` from all nodes, from where the
        homotopy leads."""
        motion = self.motion(place)
        known = [one for one in beside if one.away >= 0.0 and abs(one.place - place) <= EVERY]
        if known:
            near = min(known, key=lambda one: (abs(one.place - place), one.away))
            yield motion + near.unknown - self.motion(round(near.place))
        yield motion
        if far and not known:
            end = self._homotopy.end(motion, float(self._parameters[place]))
            if end is not None:
                yield end

    def inside(self, first: Node, last: Node, share: float, found: PathPoint) -> Node:
        """The node of an orbit at a part of the segment between two others."""
        return self._node(first.place + share * (last.place - first.place), found, found.tangent)

    def across(
        self, first: Node, last: Node, share: float, met: dict[float, PathPoint], tolerance: float
    ) -> PathPoint | None:
        """The orbit next to the cubic through two nodes, bent through those that have been met on
        the segment, in the plane across their chord, its tangent."""
        chord = _direction(
            last.unknown - first.unknown, last.parameter - first.parameter, first.unknown
        )
        if chord is None:
            return None
        found = self._solved(*_bent_through(first, last, met, share), chord, tolerance)
        if found is None:
            return None
        size = np.linalg.norm(first.unknown - last.unknown)
        ends = [np.linalg.norm(found.unknown - one.unknown) for one in (first, last)]
        return found if max(ends) <= 1.5 * size + 1e-6 * np.linalg.norm(found.unknown) else None

    def _ahead(self, place: int, *, along: bool) -> Tangent | None:
        """A direction onwards at a point: along the curve, or, unless that is asked for, the
        parameter's own where it does not turn nearby."""
        ends = np.array([max(0, place - 1), min(len(self._parameters) - 1, place + 1)])
        rise = float(np.diff(self._parameters[ends])[0])
        if not along and self._turn[place] > EVERY:
            return Tangent(np.zeros_like(self.motion(place)), float(np.sign(rise)), 1.0)
        before, after = self.motions(ends)
        return _direction(after - before, rise, self.motion(place))

    def _solved(
        self,
        unknown: np.ndarray,
        parameter: float,
        plane: Tangent | None,
        tolerance: float = TOLERANCE,
    ) -> PathPoint | None:
        """The orbit in a plane, or at a given parameter."""
        try:
            return solve_in_plane(
                self.system, unknown, parameter, plane, tolerance=tolerance, iterations=FULL_STEPS,
                reach=self._reach, least_damping=None, patience=PATIENCE,
                lasting=SHRINKING,
            )  # fmt: skip
        except ConvergenceError:  # pairs chatter without end
            return None

    def _node(
        self, place: float, found: PathPoint, ahead: Tangent | None, away: float = np.nan
    ) -> Node:
        assert isinstance(found.at, OrbitPoint)
        values = _multipliers(found.at.monodromy)
        tangent = tangent_of(self.system, found.unknown, found.at, ahead)
        return Node(
            place,
            found.unknown,
            found.parameter,
            tangent,
            values[:LEADING],
            _outside(values),
            found.at.events,
            away,
        )

    # --- bifurcations -----------------------------------------------------------------------------

    def locate(self) -> list[Crossing]:
        """The bifurcations, in the order of the branch; from now on they are nodes of it."""
        self._refine()
        found: list[Node] = []
        for (first, last), changes in zip(pairwise(self.nodes), _changes(self.nodes), strict=True):
            found.append(first)
            if last.place - first.place <= EVERY:
                kinds = [kind for kind, change in zip(KINDS, changes, strict=True) if change]
                there = [_Test(self, kind, first, last).located() for kind in kinds]
                there.sort(key=lambda one: one.place)
                if (first.place, last.place) in self._missed:
                    self._missed.update(pairwise(one.place for one in (first, *there, last)))
                found += there
        self.nodes = [*found, *self.nodes[-1:]]
        return [one.crossing for one in self.nodes if one.crossing is not None]


class _Test:
    """A function of the orbits on a segment of a branch that vanishes at a bifurcation.

    Attributes
    ----------
    met : dict
        Orbits by their parts of the segment.
    values : dict
        Of the function there.
    """

    def __init__(self, branch: OrbitBranch, kind: str, first: Node, last: Node) -> None:
        self._branch, self._kind, self._ends = branch, kind, (first, last)
        self._pairs = max(first.outside[2], last.outside[2])
        self.met: dict[float, PathPoint] = {}
        self.values: dict[float, float] = {}
        fold = kind == KINDS[0]
        self._at_ends = [one.tangent.p if fold else self._of(one.leading) for one in self._ends]
        self.largest = max(map(abs, self._at_ends))

    def _of(self, leading: np.ndarray) -> float:
        """Of leading multipliers."""
        if self._kind == KINDS[1]:
            return float(np.prod(1.0 + _paired(leading).sum(axis=1)))
        sizes = np.abs(leading[leading.imag > 0.0])
        return float(sizes[self._pairs - 1]) - 1.0 if len(sizes) >= self._pairs else -1.0

    def __call__(self, share: float) -> float:
        """Its value at a part of the segment, 0 where it is small enough.

        Raises
        ------
        ConvergenceError
            No orbit is found there.
        """
        if share in (0.0, 1.0):
            return self._at_ends[int(share)]
        if share not in self.met:
            found = self._branch.across(*self._ends, share, self.met, LOCATED)
            if found is None:
                raise ConvergenceError("no orbit")
            self.met[share] = found
            assert isinstance(found.at, OrbitPoint)
            if self._kind == KINDS[0]:  # the multipliers are no matter
                system, chord = self._branch.system, found.tangent
                self.values[share] = tangent_of(system, found.unknown, found.at, chord).p
            else:
                self.values[share] = self._of(_multipliers(found.at.monodromy)[:LEADING])
        value = self.values[share]
        return value if abs(value) > TOLERANCE * self.largest else 0.0

    def located(self) -> Node:
        """Where it vanishes; not located: where it was smallest, as an orbit is missed, or it has
        one sign, or jumps past zero."""
        try:
            scipy.optimize.brentq(self, 0.0, 1.0, xtol=TOLERANCE)
            searched = True
        except (ConvergenceError, ValueError):
            searched = False
        one, located = self._ends[0], False
        if self.values:
            share = min(self.values, key=lambda share: abs(self.values[share]))
            one = self._branch.inside(*self._ends, share, self.met[share])
            located = searched and abs(self.values[share]) <= SMOOTH * self.largest
        crossing = Crossing(self._kind, one.parameter, one.place, located)
        return replace(one, crossing=crossing)


def _direction(change: np.ndarray, rise: float, at: np.ndarray) -> Tangent | None:
    weight = 1.0 / max(float(at @ at), 1e-300)
    length = float(np.sqrt(weight * (change @ change) + rise**2))
    return Tangent(change / length, rise / length, weight) if length > 1e-12 else None


def _chords(nodes: list[Node]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """From each node to the next: changes of x, (n - 1, 2n), and of p, and lengths."""
    changes = np.diff([one.unknown for one in nodes], axis=0)
    rises = np.diff([one.parameter for one in nodes])
    weights = np.array([one.tangent.weight for one in nodes])[:-1]
    return changes, rises, np.sqrt(weights * np.sum(changes**2, axis=1) + rises**2)


def _straight(nodes: list[Node]) -> np.ndarray:
    """Whether the chord from each node to the next agrees with the tangents at both: (n - 1,)
    bool."""
    changes, rises, lengths = _chords(nodes)
    weights = np.array([one.tangent.weight for one in nodes])[:-1]
    ways = np.array([one.tangent.x for one in nodes])
    slopes = np.array([one.tangent.p for one in nodes])
    cosines = []
    for way, slope in ((ways[:-1], slopes[:-1]), (ways[1:], slopes[1:])):
        along = weights * np.sum(way * changes, axis=1) + slope * rises
        cosines.append(along / np.sqrt(weights * np.sum(way**2, axis=1) + slope**2))
    return np.asarray((lengths <= 1e-12) | (np.minimum(*cosines) > STRAIGHT * lengths))


def _broken(nodes: list[Node]) -> np.ndarray:
    """Whether (-1)^r t_p changes its sign from each node to the next: (n - 1,) bool."""
    slopes = [0.0 if one.crossing else (-1.0) ** one.outside[0] * one.tangent.p for one in nodes]
    return np.asarray(np.array(slopes[:-1]) * slopes[1:] < 0.0)


def _beside(nodes: list[Node], ends: np.ndarray, asked: list[Node]) -> set[float]:
    """Places of those asked for beside which a stretch of nodes with their r ends at a break."""
    numbers = np.array([one.outside[0] for one in nodes])
    stretch = np.append(0, np.cumsum(np.diff(numbers) != 0))
    places, ended = [one.place for one in nodes], stretch[[*ends, *ends + 1]]
    found = set()
    for node in asked:
        place = int(np.searchsorted(places, node.place))
        beside = np.arange(max(0, place - 1), min(place + 1, len(stretch)))
        if np.isin(stretch[beside[numbers[beside] == node.outside[0]]], ended).any():
            found.add(node.place)
    return found


def cubic(first: Node, last: Node, share: float) -> tuple[np.ndarray, float]:
    """Hermite's cubic through two nodes."""
    change, rise = last.unknown - first.unknown, last.parameter - first.parameter
    length = np.sqrt(first.tangent.weight * (change @ change) + rise**2)
    unknown = _hermite(change, length, first.tangent.x, last.tangent.x, share)
    parameter = _hermite(rise, length, first.tangent.p, last.tangent.p, share)
    return first.unknown + unknown, first.parameter + parameter


def _hermite(change: Any, length: Any, begin: Any, end: Any, share: Any) -> Any:
    """The cubic that changes by so much over a length, with these slopes at its ends."""
    s, left = share, 1.0 - share
    return s * s * (3.0 - 2.0 * s) * change + s * left * length * (left * begin - s * end)


def _bent_through(
    first: Node, last: Node, met: dict[float, PathPoint], share: float
) -> tuple[np.ndarray, float]:
    """The cubic through two nodes, bent through some points between them by s^2 (1 - s)^2 times a
    polynomial."""
    unknown, parameter = cubic(first, last, share)
    if len(met) < 2:  # one says nothing of what lies between it and the ends
        return unknown, parameter
    shares, off = np.array(list(met)), []
    for one, (x, p) in zip(met.values(), [cubic(first, last, s) for s in shares], strict=True):
        off.append([*(one.unknown - x), one.parameter - p])
    bump = np.square(shares * (1.0 - shares))[:, None]
    change = barycentric_interpolate(shares, off / bump, share) * (share * (1.0 - share)) ** 2
    return unknown + change[:-1], parameter + change[-1]


def _to_turns(parameters: np.ndarray) -> np.ndarray:
    """Points from each point to the nearest one where the parameter turns back: (n,)."""
    ahead = np.sign(np.diff(parameters))
    turns = np.flatnonzero(ahead[1:] != ahead[:-1]) + 1
    places = np.arange(len(parameters))
    return np.asarray(np.abs(places[:, None] - turns).min(1, initial=len(places)))


def _multipliers(monodromy: np.ndarray) -> np.ndarray:
    """Floquet multipliers, largest modulus first; of many those that matter."""
    values = _leading(monodromy) if len(monodromy) > 2 * COLUMNS else None
    if values is None:
        values = eigenvalues(monodromy)
    return values[np.argsort(-np.abs(values), kind="stable")]


@lru_cache
def _start(size: int) -> np.ndarray:
    """Columns that favour no direction."""
    return np.linalg.qr(np.random.default_rng(0).normal(size=(size, COLUMNS)))[0]


def _leading(matrix: np.ndarray) -> np.ndarray | None:
    """The leading eigenvalues of a large matrix; None where few columns do not hold them."""
    power, columns = matrix, _start(len(matrix))
    for _ in range(SQUARINGS):
        power = power @ power
    for turn in range(1, TURNS + 1):
        factors, scales, _, _ = dgeqrf(power @ columns)  # NumPy's qr takes thrice as long
        columns = dorgqr(factors, scales)[0]
        if turn % 3:
            continue
        image = matrix @ columns
        values, vectors = np.linalg.eig(columns.T @ image)
        order = np.argsort(-np.abs(values), kind="stable")[: LEADING + 1]
        vectors = vectors[:, order]
        left = image @ vectors - (columns @ vectors) * values[order]
        if np.linalg.norm(left, axis=0).max() <= KNOWN and abs(values[order[-1]]) < 1.0:
            return values[order] + 0j
    return None


def _paired(values: np.ndarray) -> np.ndarray:
    """Sums and products of pairs, largest product first: of conjugate multipliers, and of real ones
    of one sign, which leave a pair and meet again; one that is left has zero beside it."""
    upper = values[values.imag > 0.0]
    sums, products = [2.0 * upper.real], [np.abs(upper) ** 2]
    for sign in (1.0, -1.0):
        real = values.real[(values.imag == 0.0) & (sign * values.real > 0.0)]
        if len(real) % 2:
            real = np.insert(real, len(real) // 2 + 1, 0.0)
        outer, inner = real[: len(real) // 2], real[: len(real) // 2 - 1 : -1]
        sums.append(outer + inner)
        products.append(outer * inner)
    found = np.column_stack([np.concatenate(sums), np.concatenate(products)])
    return found[np.argsort(-found[:, 1], kind="stable")]


def blended(first: Node, last: Node, share: float | np.ndarray) -> np.ndarray:
    """Moduli between two nodes, largest first: those between, or, where a pair becomes real and
    they have a corner, of pairs with the sums and products between; (k,) of a share of the segment,
    (k, n) of some."""
    if first.real == last.real and len(first.pairs) == len(last.pairs):
        return _line(first.moduli, last.moduli, share)
    found = _line(first.pairs, last.pairs, share)
    half = 0.5 * found[:, 0]
    root = np.sqrt(half**2 - found[:, 1] + 0j)
    return -np.sort(-np.abs(np.concatenate([half + root, half - root])), axis=0)


def _line(begin: np.ndarray, end: np.ndarray, share: float | np.ndarray) -> np.ndarray:
    """Between two arrays, as far as both go."""
    count = min(len(begin), len(end))
    rest = 1.0 - np.asarray(share)
    return np.multiply.outer(begin[:count], rest) + np.multiply.outer(end[:count], share)


def _bent(
    nodes: list[Node], moduli: np.ndarray, lengths: np.ndarray, asked: np.ndarray
) -> np.ndarray:
    """Whether the moduli at each inner node that is asked for are not those between its
    neighbours', to what they differ from 1: (n - 2,) bool."""
    shares = lengths[:-1] / np.maximum(lengths[:-1] + lengths[1:], 1e-300)
    away = np.abs(1.0 - moduli)
    away = np.minimum(np.minimum(away[:-2], away[2:]), away[1:-1])
    allowed = np.maximum(away, RESOLVED)
    line = moduli[:-2] + shares[:, None] * (moduli[2:] - moduli[:-2])
    bent = asked & np.any(np.abs(moduli[1:-1] - line) > allowed, axis=1)
    for place in np.flatnonzero(bent):
        smooth = blended(nodes[place], nodes[place + 2], shares[place])[: moduli.shape[1]]
        off = np.abs(moduli[place + 1, : len(smooth)] - smooth)
        bent[place] = np.any(off > allowed[place, : len(smooth)])
    return bent


def _pass_one(moduli: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Whether moduli that go on behind each inner node as they came would pass 1 half on the way to
    the next, where they are on the same side of it: (n - 2,) bool."""
    came, here, ahead = moduli[:-2] - 1.0, moduli[1:-1] - 1.0, moduli[2:] - 1.0
    part = 0.5 * lengths[1:] / np.maximum(lengths[:-1], 1e-300)
    beyond = here + part[:, None] * (here - came)
    return np.asarray(np.any((here * ahead > 0.0) & (here * beyond < 0.0), axis=1))


def _pass_each_other(nodes: list[Node], lengths: np.ndarray) -> np.ndarray:
    """Whether between two nodes angles pass each other, or 0 or pi, if they go on as they come from
    both sides, or from the one side that tells, or before the middle from either, and may do more
    there than the nodes show: (n - 1,) bool."""
    turns, way = _followed([one.turns for one in nodes])
    logs, here = np.moveaxis(turns[:-1], 2, 0)
    there = np.take_along_axis(turns[1:, :, 1], way, 1)
    came, ahead = np.full((2, *here.shape), np.nan)
    change, part = there - here, (lengths[1:] / np.maximum(lengths[:-1], 1e-300))[:, None]
    came[1:] = np.take_along_axis(change[:-1], np.argsort(way[:-1], axis=1), 1) * part
    ahead[:-1] = np.take_along_axis(change[1:], way[:-1], 1) / np.maximum(part, 1e-300)
    one, other = np.triu_indices(turns.shape[1], 1)

    def apart(angles: np.ndarray) -> np.ndarray:
        across = angles[:, one] - angles[:, other]
        return np.concatenate([across, 2.0 * angles, 2.0 * (np.pi - angles)], axis=1)

    begin, end = apart(here), apart(there)
    on, soon = begin * apart(here + came), begin * apart(here + 0.5 * came)
    back, late = end * apart(there - ahead), end * apart(there - 0.5 * ahead)
    damped = np.concatenate([0.5 * (logs[:, one] + logs[:, other]), logs, logs], axis=1)
    ends = np.abs([begin, end])
    hidden = (ends.min(axis=0) > 0.25 * damped) & (ends.sum(axis=0) > 2.0 * damped)
    hidden &= damped > 0.0
    both = ~(on >= 0.0) & ~(back >= 0.0) & ~(np.isnan(on) & np.isnan(back))
    return np.asarray(np.any(hidden & (both | (soon < 0.0) | (late < 0.0)), axis=1))


def _followed(rows: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """What nodes have of their pairs, (n, k, 2), nan behind the last; and which of the next node's
    each of them is, by the smallest changes: (n - 1, k)."""
    found = np.full((len(rows), max(map(len, rows)), 2), np.nan)
    for own, row in zip(found, rows, strict=True):
        own[: len(row)] = row
    cost = np.abs(found[:-1, :, None] - found[1:, None]).sum(axis=3)
    cost[np.isnan(cost)] = 1.0 + np.nansum(cost)  # one that is not there is far from all others
    ways = [scipy.optimize.linear_sum_assignment(one)[1] for one in cost]
    return found, np.array(ways, dtype=int).reshape(cost.shape[:2])


def _leave_between(nodes: list[Node], lengths: np.ndarray) -> np.ndarray:
    """Whether on segments with both ends on one side of 1 the parabolas through sums and products
    of pairs at three nodes go to the other side: (n - 1,) bool."""
    pairs, way = _followed([one.pairs for one in nodes])
    before = np.take_along_axis(pairs[:-2], np.argsort(way[:-1], axis=1)[..., None], 1)
    behind = np.take_along_axis(pairs[2:], way[1:, :, None], 1)
    first, last = np.maximum(lengths[:-1], 1e-300), np.maximum(lengths[1:], 1e-300)
    first, last = first[:, None, None], last[:, None, None]
    slope = (pairs[1:-1] - before) / first
    bend = ((behind - pairs[1:-1]) / last - slope) / (first + last)
    shares = np.array([0.25, 0.5, 0.75])[:, None, None, None]
    outside = np.array([one.moduli[0] > 1.0 for one in nodes])
    counts = np.array([len(one.pairs) for one in nodes])
    alike = (counts[:-2] == counts[1:-1]) & (counts[1:-1] == counts[2:])
    found = np.zeros(len(lengths), dtype=bool)
    for at, segment in ((first * shares, slice(0, -1)), (first + last * shares, slice(1, None))):
        total, product = np.moveaxis(before + at * (slope + (at - first) * bend), -1, 0)
        root = np.sqrt(0.25 * total**2 - product + 0j)
        sizes = np.fmax(np.abs(0.5 * total + root), np.abs(0.5 * total - root))
        leaves = np.any((np.fmax.reduce(sizes, axis=2) > 1.0) != outside[segment][:-1], axis=0)
        found[segment] |= leaves & alike
    return found & (outside[:-1] == outside[1:])


def _steps(nodes: list[Node]) -> np.ndarray:
    """By how much r, d and c change between each node and the next: (n - 1, 3); zero where nothing
    but two real multipliers meet, or part."""
    changes = np.diff(np.array([one.outside for one in nodes], dtype=int).reshape(-1, 3), axis=0)
    meet = ~np.any(changes[:, :2] % 2, axis=1) & (changes @ (1, 1, 2) == 0)
    return np.abs(changes) * ~meet[:, None]


def _changes(nodes: list[Node]) -> np.ndarray:
    """Whether a bifurcation of each kind is between each node and the next: (n - 1, 3) bool."""
    return np.asarray(_steps(nodes) % 2 == 1)


def _outside(values: np.ndarray) -> tuple[int, int, int]:
    """r, d and c of multipliers."""
    large = values[np.abs(values) > 1.0].tolist()
    real = [one.real > 0.0 for one in large if one.imag == 0.0]
    return sum(real), len(real) - sum(real), sum(one.imag > 0.0 for one in large)
