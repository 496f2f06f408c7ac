"""The branch of exact orbits along a curve: nodes, and the bifurcations between them.

Next to every eighth point of the curve an orbit F(x, p) = 0 (:mod:`fenics_crack.balance.orbits`) is
found by Newton's method, from the point's own motion and what had to be added to that of the node
before: at the point's parameter, or, next to folds, in the plane across the curve. A node has the
tangent of the branch and the leading multipliers mu of its orbit, and of all multipliers

    r = number of real mu > 1,    d = number of real mu < -1,    c = pairs with |mu| > 1.

A segment between two nodes is halved, by the orbit next to Hermite's cubic through both, where the
chord disagrees with their tangents, where the moduli at a node are not those between its
neighbours', to half of their distance from 1, and where r, d and c change by more than one.
Then a fold (or a branch point) lies on a segment where r changes, a period doubling where d does, a
Neimark-Sacker point where c does. It is found by Brent's method on

    t_p (the tangent's),    det(I + M),    |mu| - 1 of the pair that leaves.

Two real multipliers outside that meet and become a pair are no bifurcation.

What is not seen: two crossings of one kind on one segment.

Source: Seydel, Practical Bifurcation and Stability Analysis, chapters 4, 5 and 7.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
import scipy.optimize

from fenics_crack.balance.bordered import PathPoint, Tangent, step_in_plane, tangent_of
from fenics_crack.balance.orbits import FlowOrbits, OrbitPoint
from fenics_crack.errors import ConvergenceError
from fenics_crack.motion.orbit import doubling_test, eigenvalues

__all__ = ["KINDS", "Crossing", "Node", "OrbitBranch"]

KINDS = "fold", "period_doubling", "neimark_sacker"
EVERY = 8
"""Points of a curve from one node to the next."""
NARROWEST = 1.0 / 32.0
"""Segment that is not halved any more, in points of the curve."""
TOLERANCE, SHARP = 1e-8, 1e-12
"""|F| / |x| of nodes, and of bifurcations."""
SAME = 1e-6
"""Of a state, how far away a derivative may be that serves a node."""
ITERATIONS, PATIENCE, SHRINKING = 12, 3, 0.1
"""Newton steps to an orbit, how many may together fail to shrink the residual, and by how much a
step has to shrink it that another one with the same derivative may follow."""
ALIKE = 0.5
"""Farthest orbit from the motion of its point, in the norm of the energy, where fast modes that a
wave leaves out weigh; whether it is the point's own is asked later."""
REACH = 5e-3
"""Farthest orbit from the parameter of its point, of the whole."""
FLAT = 0.3
"""Of the tangent, along the parameter, above which an orbit is found at a given one."""
STRAIGHT = 0.8
"""Cosine of the angle between a chord and the tangents at its ends."""
LEADING = 8
"""Multipliers that are kept."""
FITTING, RESOLVED = 0.5, 0.02
"""Of the distance of a modulus from 1, and of no less, what it may be off its neighbours' mean."""
FULL, COLUMNS, SQUARINGS, TURNS = 60, 24, 4, 8
"""Up to so many multipliers, all are computed at once; else those of M in the span of some columns
that M^16 has turned
to the leading ones some times, where these leave less than EXACT."""
EXACT = 1e-6
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
    leading : (8,) complex
        Multipliers of largest modulus, in their order; all where there are fewer.
    outside : tuple of int
        r, d and c.
    away : float
        From the motion of its point, relative; nan where it has none.
    """

    place: float
    unknown: np.ndarray
    parameter: float
    tangent: Tangent
    leading: np.ndarray
    outside: tuple[int, int, int]
    away: float = np.nan


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
    orbit : PathPoint or None
        There, where it is located.
    """

    kind: str
    parameter: float
    place: float
    located: bool
    orbit: PathPoint | None = None


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
    every : int
        Points from one node to the next.
    known : sequence of Node
        Some that are known.

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
        known: Sequence[Node] = (),
    ) -> None:
        self.system, self._parameters, self._motions = system, parameters, motions
        self._known: dict[int, np.ndarray] = {}
        self._turning = _near_turns(parameters)
        self._given_up: set[tuple[float, float]] = set()
        self.nodes: list[Node] = list(known)
        last = len(parameters) - 1
        first = np.unique(np.append(np.arange(0, last, every), last))
        beside = (first[:, None] + [-1, 0, 1]).ravel()
        self._know(np.unique(np.clip(beside, 0, last)))
        for place in first:
            self.anchor(int(place))
        while self._halved():
            pass

    # --- nodes ------------------------------------------------------------------------------------

    def motion(self, place: int) -> np.ndarray:
        """x of the motion of a point."""
        self._know(np.array([place]))
        return self._known[place]

    def anchor(self, place: int) -> Node | None:
        """The node next to a point of the curve; None where none is found."""
        number = self._number(place)
        there = [one for one in self.nodes[number : number + 1] if one.place == place]
        if there and there[0].away >= 0.0:
            return there[0]
        motion, parameter = self.motion(place), float(self._parameters[place])
        starts = [motion]
        beside = [one for one in self.nodes[max(0, number - 1) : number + 1] if one.away >= 0.0]
        beside = [one for one in beside if abs(one.place - place) <= EVERY]
        if beside:
            near = min(beside, key=lambda one: abs(one.place - place))
            starts.insert(0, motion + near.unknown - self.motion(round(near.place)))
        chord = self._chord(place)
        planes = [chord] if self._turning[place] else [None, chord]
        for start in starts:
            for plane in planes:
                found = self._solved(start, parameter, plane)
                if found is None:
                    continue
                away = float(np.linalg.norm(found.unknown - motion) / np.linalg.norm(motion))
                if away <= ALIKE:
                    node = self._node(place, found, chord, away)
                    self.nodes[number : number + len(there)] = [node]
                    return node
        return None

    def between(
        self, first: Node, last: Node, share: float, sharp: bool = False
    ) -> PathPoint | None:
        """The orbit next to the cubic through two nodes, in the plane across their chord."""
        chord = _chord(first, last)
        if chord is None:
            return None
        steep = min(abs(one.tangent.p) for one in (first, last)) < FLAT
        found = self._solved(*_cubic(first, last, share), chord if steep else None, sharp)
        if found is None:
            return None
        size = np.linalg.norm(first.unknown - last.unknown)
        ends = [np.linalg.norm(found.unknown - one.unknown) for one in (first, last)]
        far = max(ends) > 1.5 * size + 1e-6 * np.linalg.norm(found.unknown)
        return None if far else found

    def linked(self, first: Node, last: Node) -> bool:
        """Whether a smooth branch leads from one node to another."""
        return self._straight(first, last) > STRAIGHT

    def _straight(self, first: Node, last: Node) -> float:
        chord = _chord(first, last)
        if chord is None:
            return 1.0
        return min(one.tangent.along(chord, self.system) for one in (first, last))

    def _know(self, places: np.ndarray) -> None:
        new = [int(place) for place in places if int(place) not in self._known]
        if new:
            self._known.update(zip(new, self._motions(np.array(new)), strict=True))

    def _number(self, place: float) -> int:
        return int(np.searchsorted([one.place for one in self.nodes], place))

    def _chord(self, place: int) -> Tangent | None:
        """Along the curve at one of its points."""
        ends = max(0, place - 1), min(len(self._parameters) - 1, place + 1)
        before, after = (self.motion(end) for end in ends)
        rise = float(self._parameters[ends[1]] - self._parameters[ends[0]])
        return _direction(after - before, rise, self.motion(place))

    def _solved(
        self, unknown: np.ndarray, parameter: float, plane: Tangent | None, sharp: bool = False
    ) -> PathPoint | None:
        """Newton's method in a plane, or at a given parameter, with one derivative for as long as
        steps with it shrink fast; unless the orbit is wanted sharply, a near one is its own."""
        guess, goal = (
            parameter,
            (SHARP if sharp else TOLERANCE) * max(float(np.linalg.norm(unknown)), 1e-300),
        )
        slope, sizes = None, [np.inf]
        try:
            at = used = self.system.linearise(unknown, parameter)
            for _ in range(ITERATIONS):
                size = float(np.linalg.norm(at.residual))
                if size <= goal:
                    flat = plane or Tangent(np.zeros_like(unknown), 1.0, 0.0)
                    moved = np.linalg.norm(unknown - used.unknown)
                    if not sharp and moved <= SAME * np.linalg.norm(unknown):
                        at = used
                    return PathPoint(unknown, parameter, len(sizes), flat, at=at)
                if not size < max(sizes[-PATIENCE:]):
                    return None
                if size > SHRINKING * sizes[-1]:
                    used, slope = at, None
                change, shift = -used.solve(at.residual), 0.0
                if plane is not None:
                    slope = -used.solve(used.by_parameter) if slope is None else slope
                    change, shift = step_in_plane(plane, change, slope, self.system.inner)
                unknown, parameter = unknown + change, parameter + shift
                if not abs(parameter - guess) <= REACH * self._width:
                    return None
                sizes.append(size)
                at = self.system.linearise(unknown, parameter)
        except (ConvergenceError, ValueError):  # pairs chatter
            pass
        return None

    @property
    def _width(self) -> float:
        return max(1.0, float(np.ptp(self._parameters)))

    def _node(
        self, place: float, found: PathPoint, ahead: Tangent | None, away: float = np.nan
    ) -> Node:
        at = orbit_of(found)
        tangent = tangent_of(self.system, found.unknown, at)
        if ahead is not None and tangent.along(ahead, self.system) < 0.0:
            tangent = tangent.reversed()
        values = _multipliers(at.monodromy)
        return Node(
            place, found.unknown, found.parameter, tangent, values[:LEADING], _outside(values), away
        )

    # --- where they lie closer --------------------------------------------------------------------

    def _halved(self) -> bool:
        """Whether segments had to be halved, and were."""
        wanted = self._wanted()
        any_new = False
        for first, last in wanted:
            self._given_up.add((first.place, last.place))
            any_new |= self._halve(first, last)
        return any_new

    def _wanted(self) -> list[tuple[Node, Node]]:
        """Segments that are too long."""
        found, off = [], self._misfits()
        for number, (first, last) in enumerate(pairwise(self.nodes)):
            width = last.place - first.place
            if width <= NARROWEST or (first.place, last.place) in self._given_up:
                continue
            change = np.abs(np.subtract(first.outside, last.outside))
            smooth = self.linked(first, last) and max(off[number : number + 2]) <= FITTING
            if not smooth or change.sum() > 1:
                found.append((first, last))
        return found

    def _misfits(self) -> np.ndarray:
        """How far moduli are off the line between those of both neighbours, relative to what they
        differ from 1: (n_nodes,)."""
        found = np.zeros(len(self.nodes))
        if len(self.nodes) < 3:
            return found
        moduli = np.array([np.abs(one.leading) for one in self.nodes])
        lengths = np.array([self._length(*two) for two in pairwise(self.nodes)])
        share = (lengths[:-1] / np.maximum(lengths[:-1] + lengths[1:], 1e-300))[:, None]
        line = (1.0 - share) * moduli[:-2] + share * moduli[2:]
        near = np.min(np.abs(1.0 - np.array([moduli[:-2], moduli[1:-1], moduli[2:]])), axis=0)
        off = np.abs(moduli[1:-1] - line) / np.maximum(near, RESOLVED)
        found[1:-1] = np.nanmax(off, axis=1, initial=0.0)
        return found

    def _length(self, first: Node, last: Node) -> float:
        change = last.unknown - first.unknown
        square = first.tangent.weight * (change @ change)
        return float(np.sqrt(square + (last.parameter - first.parameter) ** 2))

    def _halve(self, first: Node, last: Node) -> bool:
        """Whether a node between two others has been found."""
        middle = 0.5 * (first.place + last.place)
        whole = round(middle)
        if first.place < whole < last.place and not self.linked(first, last):
            return self.anchor(whole) is not None
        found = self.between(first, last, 0.5)
        if found is None:
            return first.place < whole < last.place and self.anchor(whole) is not None
        self.nodes.insert(self._number(middle), self._node(middle, found, _chord(first, last)))
        return True

    # --- bifurcations -----------------------------------------------------------------------------

    def crossings(self, near: float = 1e-3) -> list[Crossing]:
        """The bifurcations, in the order of the branch; located to 1e-10 of the parameter, and to a
        part of a segment."""
        return [
            found
            for first, last in pairwise(self.nodes)
            if last.place - first.place <= EVERY
            for found in self._on(first, last, near)
        ]

    def _on(self, first: Node, last: Node, near: float) -> Iterator[Crossing]:
        """Those of a segment."""
        change = np.subtract(last.outside, first.outside)
        if change[0] % 2 == 0 and change[1] % 2 == 0 and change @ (1, 1, 2) == 0:
            return
        simple = np.abs(change).sum() == 1
        for kind, step in zip(KINDS, change, strict=True):
            if step % 2 and (simple or kind != "neimark_sacker"):
                share, found, located = self._located(kind, first, last, near)
                place = first.place + share * (last.place - first.place)
                parameter = 0.5 * (first.parameter + last.parameter)
                if found is not None:
                    parameter = found.parameter
                yield Crossing(kind, parameter, place, located, found if located else None)

    def _located(
        self, kind: str, first: Node, last: Node, near: float
    ) -> tuple[float, PathPoint | None, bool]:
        """Where a test function vanishes on a segment, and True; where it was smallest, and False,
        where an orbit is missed, or it has one sign, or jumps past zero."""
        test = self._test(kind, first, last)
        met: list[tuple[float, float, PathPoint]] = []

        def value(share: float) -> float:
            found = self.between(first, last, share, True)
            if found is None:
                raise ConvergenceError("no orbit")
            value = test(found)
            met.append((abs(value), share, found))
            return value

        rise = abs(last.parameter - first.parameter) / max(abs(first.parameter), 1e-300)
        try:
            scipy.optimize.brentq(value, 0.0, 1.0, xtol=min(near, 1e-10 / max(rise, 1e-10)))
            sizes = [size for size, _, _ in met]
            smooth = min(sizes) <= SMOOTH * max(sizes)
        except (ConvergenceError, ValueError):
            smooth = False
        if not met:
            return 0.5, None, False
        _, share, found = min(met, key=lambda one: one[0])
        return share, found, smooth

    def _test(self, kind: str, first: Node, last: Node) -> Callable[[PathPoint], float]:
        """A function that changes its sign at a bifurcation on a segment."""
        pairs, chord = max(first.outside[2], last.outside[2]), _chord(first, last)
        assert chord is not None

        def turning(found: PathPoint) -> float:
            tangent = tangent_of(self.system, found.unknown, orbit_of(found))
            onwards = tangent.along(chord, self.system) >= 0.0
            return tangent.p if onwards else -tangent.p

        def doubling(found: PathPoint) -> float:
            return doubling_test(orbit_of(found).monodromy)

        def pair(found: PathPoint) -> float:
            values = _multipliers(orbit_of(found).monodromy)
            sizes = np.abs(values[values.imag > 0.0])
            return float(sizes[pairs - 1]) - 1.0 if len(sizes) >= pairs else -1.0

        return {KINDS[0]: turning, KINDS[1]: doubling, KINDS[2]: pair}[kind]


def orbit_of(found: PathPoint) -> OrbitPoint:
    """The equations at an orbit."""
    assert isinstance(found.at, OrbitPoint)
    return found.at


def _direction(change: np.ndarray, rise: float, at: np.ndarray) -> Tangent | None:
    weight = 1.0 / max(float(at @ at), 1e-300)
    length = float(np.sqrt(weight * (change @ change) + rise**2))
    return Tangent(change / length, rise / length, weight) if length > 1e-12 else None


def _chord(first: Node, last: Node) -> Tangent | None:
    """Direction from one node to another; None where they are the same."""
    return _direction(last.unknown - first.unknown, last.parameter - first.parameter, first.unknown)


def _cubic(first: Node, last: Node, share: float) -> tuple[np.ndarray, float]:
    """Hermite's cubic through two nodes."""
    change, rise = last.unknown - first.unknown, last.parameter - first.parameter
    length = np.sqrt(first.tangent.weight * (change @ change) + rise**2)
    s, left = share, 1.0 - share
    begin, end = left * left * s * length, -s * s * left * length
    unknown = first.unknown + s * s * (3.0 - 2.0 * s) * change
    parameter = first.parameter + s * s * (3.0 - 2.0 * s) * rise
    for scale, tangent in ((begin, first.tangent), (end, last.tangent)):
        unknown = unknown + scale * tangent.x
        parameter += scale * tangent.p
    return unknown, parameter


def _near_turns(parameters: np.ndarray) -> np.ndarray:
    """Whether the parameter turns back at a point or at the next one on either side: (n,) bool."""
    ahead = np.sign(np.diff(parameters))
    turns = np.flatnonzero(ahead[1:] != ahead[:-1]) + 1
    near = np.abs(np.arange(len(parameters))[:, None] - turns)
    return np.asarray(np.min(near, 1, initial=9) <= 2)


def _multipliers(monodromy: np.ndarray) -> np.ndarray:
    """Floquet multipliers, largest modulus first; of many those that matter."""
    values = _leading(monodromy) if len(monodromy) > FULL else None
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
        columns = np.linalg.qr(power @ columns)[0]
        if turn % 2:
            continue
        image = matrix @ columns
        values, vectors = np.linalg.eig(columns.T @ image)
        order = np.argsort(-np.abs(values), kind="stable")[: LEADING + 1]
        vectors = vectors[:, order]
        left = image @ vectors - (columns @ vectors) * values[order]
        if np.linalg.norm(left, axis=0).max() <= EXACT and abs(values[order[-1]]) < 1.0:
            return values[order] + 0j
    return None


def _outside(values: np.ndarray) -> tuple[int, int, int]:
    """r, d and c of multipliers."""
    real, large = values.imag == 0.0, np.abs(values) > 1.0
    kinds = real & (values.real > 1.0), real & (values.real < -1.0), large & (values.imag > 0.0)
    return tuple(int(np.count_nonzero(kind)) for kind in kinds)  # type: ignore[return-value]
