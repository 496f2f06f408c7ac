"""The branch of exact orbits along a curve: nodes, and the bifurcations between them.

Next to every eighth point of the curve an orbit F(x, p) = 0 (:mod:`fenics_crack.balance.orbits`) is
found by Newton's method, from the point's own motion and what had to be added to that of the node
beside: at the point's parameter, or, next to folds, in the plane across the curve. The derivative
at the guess serves as long as steps with it shrink fast. A node has the tangent of the branch and
the leading multipliers mu of its orbit, and of all multipliers

    r = number of real mu > 1,    d = number of real mu < -1,    c = pairs with |mu| > 1.

A segment between two nodes is halved, by the orbit next to Hermite's cubic through both, where the
chord disagrees with their tangents, and where the moduli at a node are not those between its
neighbours', to half of their distance from 1, nor those of pairs whose sums and products are: where
a pair becomes real, moduli have a corner, but its sum and its product are smooth. A segment on
which nothing changes is halved, too, where moduli that went on as they came would pass 1 before its
middle; and one on which several of r, d and c change, until each changes by itself.
Then a fold (or a branch point) lies on a segment where r changes, a period doubling where d does, a
Neimark-Sacker point where c does. It is found by Brent's method on

    t_p (the tangent's),    the product of 1 + mu,    |mu| - 1 of the pair that leaves,

and becomes a node. Two real multipliers outside that meet and become a pair are no bifurcation.

What is not seen: two crossings of one kind on one segment that do not announce themselves.

Source: Seydel, Practical Bifurcation and Stability Analysis, chapters 4, 5 and 7.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np
import scipy.optimize

from fenics_crack.balance.orbits import FlowOrbits, OrbitPoint
from fenics_crack.errors import ConvergenceError
from fenics_crack.motion.orbit import eigenvalues
from fenics_crack.numerics.bordered import PathPoint, Tangent, step_in_plane, tangent_of

__all__ = ["KINDS", "Crossing", "Node", "OrbitBranch", "blended", "cubic"]

KINDS = "fold", "period_doubling", "neimark_sacker"
EVERY = 8
"""Points of a curve from one node to the next."""
NARROWEST = 1.0 / 32.0
"""Segment that is not halved any more, in points of the curve."""
TOLERANCE, SHARP = 1e-8, 1e-12
"""|F| / |x| of nodes, and of bifurcations."""
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
"""Of the distance of a modulus from 1, and of no less, what it may be off that between others."""
FULL, COLUMNS, SQUARINGS, TURNS = 60, 24, 4, 9
"""Up to so many multipliers, all are computed at once; else those of M in the span of some columns
that M^16 has turned
to the leading ones some times, where these leave less than EXACT."""
EXACT = 1e-6
ALONE = 1e-4
"""Of a point, how near bifurcations may lie to each other."""
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
    pairs : (k, 2)
        Sums and products of the multipliers that are pairs, or were or will be.
    away : float
        From the motion of its point, relative; nan where it has none.
    crossing : Crossing or None
        The bifurcation that it is.
    """

    place: float
    unknown: np.ndarray
    parameter: float
    tangent: Tangent
    leading: np.ndarray
    outside: tuple[int, int, int]
    pairs: np.ndarray
    away: float = np.nan
    crossing: Crossing | None = None

    @cached_property
    def moduli(self) -> np.ndarray:
        """Of the leading multipliers."""
        return np.abs(self.leading)

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
        self._known: dict[int, np.ndarray] = {}
        self._turn = _to_turns(parameters)
        self.nodes: list[Node] = []
        last = len(parameters) - 1
        places = np.unique(np.append(np.arange(0, last, every), last))
        self._know(places)
        self._follow([int(place) for place in places])

    # --- nodes ------------------------------------------------------------------------------------

    def _follow(self, places: list[int]) -> None:
        """Nodes next to some points, and between these where they lie too far apart."""
        held: list[Node] = []
        bent = False
        for place in places:
            found = self._next_to(place, held[-1:])
            if found is None:
                continue
            held.append(found)
            if len(held) == 3:
                before, bent = bent, not _fits(*held)
                self._fill(held[0], held[1], before or bent)
                del held[0]
        if len(held) == 2:
            self._fill(held[0], held[1], bent)
        self.nodes += [one for one in held[-1:]]

    def _fill(self, first: Node, last: Node, bent: bool) -> None:
        """A node, and those behind it up to another one: halves, as long as multipliers at a middle
        are not those between its neighbours', or these do not lie on one smooth line."""
        middle, width = None, last.place - first.place
        if width > EVERY or (width > NARROWEST and (bent or not self.linked(first, last))):
            middle = self._middle(first, last)
        if middle is None:
            self.nodes.append(first)
            return
        bent = not _fits(first, middle, last)
        self._fill(first, middle, bent)
        self._fill(middle, last, bent)

    def _middle(self, first: Node, last: Node) -> Node | None:
        """A node between two others; None where none is found."""
        middle = 0.5 * (first.place + last.place)
        whole = round(middle)
        inside = first.place < whole < last.place
        if not inside or self.linked(first, last):
            found = self.between(first, last, 0.5)
            if found is not None:
                return self._node(middle, found, _chord(first, last))
        return self._next_to(whole, [first, last]) if inside else None

    def motion(self, place: int) -> np.ndarray:
        """x of the motion of a point."""
        self._know(np.array([place]))
        return self._known[place]

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

    def _next_to(self, place: int, beside: list[Node]) -> Node | None:
        """The orbit next to a point, with those of some nodes known."""
        motion, parameter = self.motion(place), float(self._parameters[place])
        starts = [motion]
        beside = [one for one in beside if one.away >= 0.0 and abs(one.place - place) <= EVERY]
        if beside:
            near = min(beside, key=lambda one: abs(one.place - place))
            starts.insert(0, motion + near.unknown - self.motion(round(near.place)))
        for start in starts:
            for plane in [self._chord] if self._turn[place] <= 2 else [None, self._chord]:
                found = self._newton(start, parameter, plane and plane(place))
                if found is None:
                    continue
                away = float(np.linalg.norm(found.unknown - motion) / np.linalg.norm(motion))
                if away <= ALIKE:
                    return self._node(place, found, self._ahead(place), away)
        return None

    def between(
        self,
        first: Node,
        last: Node,
        share: float,
        tolerance: float = TOLERANCE,
        used: OrbitPoint | None = None,
    ) -> PathPoint | None:
        """The orbit next to the cubic through two nodes, in the plane across their chord."""
        chord = _chord(first, last)
        if chord is None:
            return None
        steep = min(abs(one.tangent.p) for one in (first, last)) < FLAT
        plane = chord if steep else None
        found = self._newton(*cubic(first, last, share), plane, tolerance, used)
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

    def _chord(self, place: int) -> Tangent | None:
        """Along the curve at one of its points."""
        ends = max(0, place - 1), min(len(self._parameters) - 1, place + 1)
        before, after = (self.motion(end) for end in ends)
        rise = float(self._parameters[ends[1]] - self._parameters[ends[0]])
        return _direction(after - before, rise, self.motion(place))

    def _ahead(self, place: int) -> Tangent | None:
        """A direction onwards: far from where the parameter turns, its own."""
        if self._turn[place] <= EVERY:
            return self._chord(place)
        ends = max(0, place - 1), min(len(self._parameters) - 1, place + 1)
        rise = float(self._parameters[ends[1]] - self._parameters[ends[0]])
        return Tangent(np.zeros_like(self.motion(place)), float(np.sign(rise)), 1.0)

    def _newton(
        self,
        unknown: np.ndarray,
        parameter: float,
        plane: Tangent | None,
        tolerance: float = TOLERANCE,
        used: OrbitPoint | None = None,
    ) -> PathPoint | None:
        """Newton's method in a plane, or at a given parameter, with the derivative at the guess, or
        one given, for as long as steps with it shrink fast."""
        guess, goal = parameter, tolerance * max(float(np.linalg.norm(unknown)), 1e-300)
        slope, sizes = None, [np.inf]
        try:
            at = self.system.linearise(unknown, parameter)
            for _ in range(ITERATIONS):
                size = float(np.linalg.norm(at.residual))
                if size <= goal:
                    flat = plane or Tangent(np.zeros_like(unknown), 1.0, 0.0)
                    return PathPoint(unknown, parameter, len(sizes), flat, at=at)
                if not size < max(sizes[-PATIENCE:]):
                    return None
                if used is None or size > SHRINKING * sizes[-1]:
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

    @cached_property
    def _width(self) -> float:
        return max(1.0, float(np.ptp(self._parameters)))

    def _node(
        self, place: float, found: PathPoint, ahead: Tangent | None, away: float = np.nan
    ) -> Node:
        at = orbit_of(found)
        values = _multipliers(at.monodromy)
        tangent = tangent_of(self.system, found.unknown, at)
        if ahead is not None and tangent.along(ahead, self.system) < 0.0:
            tangent = tangent.reversed()
        leading = values[:LEADING]
        return Node(
            place, found.unknown, found.parameter, tangent, leading, _outside(values),
            _paired(leading), away,
        )  # fmt: skip

    # --- bifurcations -----------------------------------------------------------------------------

    def locate(self, near: float = 1e-3) -> list[Crossing]:
        """The bifurcations, in the order of the branch, to 1e-10 of the parameter and to a part of
        a segment; from now on they are nodes of it."""
        self._look_between()
        found: list[Node] = []
        for first, last in pairwise(self.nodes):
            found.append(first)
            if last.place - first.place <= EVERY:
                found += self._on(first, last, near)
        self.nodes = [*found, *self.nodes[-1:]]
        return [one.crossing for one in self.nodes if one.crossing is not None]

    def _look_between(self) -> None:
        """Halve segments between whose ends nothing seems to change, but behind which moduli went
        so that they would pass 1 before the middle."""
        number, nodes = 0, self.nodes
        while number + 1 < len(nodes):
            first, last = nodes[number : number + 2]
            middle = None
            threes = [nodes[max(0, number - 1) : number + 2], nodes[number : number + 3][::-1]]
            wide = NARROWEST < last.place - first.place <= EVERY
            if wide and any(len(three) == 3 and _pass_one(*three) for three in threes):
                found = self.between(first, last, 0.5)
                if found is not None:
                    place = 0.5 * (first.place + last.place)
                    middle = self._node(place, found, _chord(first, last))
            if middle is None:
                number += 1
            else:
                nodes.insert(number + 1, middle)
                number = max(0, number - 1)

    def _on(self, first: Node, last: Node, near: float) -> Iterator[Node]:
        """Those of a segment; where they are several it is halved until each is alone."""
        change = np.subtract(last.outside, first.outside)
        if change[0] % 2 == 0 and change[1] % 2 == 0 and change @ (1, 1, 2) == 0:
            return
        if np.abs(change).sum() > 1 and last.place - first.place > ALONE:
            found = self.between(first, last, 0.5)
            if found is not None:
                place = 0.5 * (first.place + last.place)
                middle = self._node(place, found, _chord(first, last))
                yield from self._on(first, middle, near)
                yield middle
                yield from self._on(middle, last, near)
                return
        for kind, step in zip(KINDS, change, strict=True):
            if step % 2:
                yield self._located(kind, first, last, near)

    def _located(self, kind: str, first: Node, last: Node, close: float) -> Node:
        """Where a test function vanishes on a segment; not located: where it was smallest, as an
        orbit is missed, or it has one sign, or jumps past zero."""
        pairs, chord = max(first.outside[2], last.outside[2]), _chord(first, last)
        met: list[tuple[float, float, Node]] = []
        used: OrbitPoint | None = None

        def test(one: Node) -> float:
            if kind == KINDS[0]:
                return one.tangent.p
            if kind == KINDS[1]:
                return float(np.prod(1.0 + one.pairs.sum(axis=1)))
            sizes = np.abs(one.leading[one.leading.imag > 0.0])
            return float(sizes[pairs - 1]) - 1.0 if len(sizes) >= pairs else -1.0

        def value(share: float) -> float:
            nonlocal used
            if share in (0.0, 1.0):
                one = last if share else first
            else:
                found = self.between(first, last, share, SHARP, used)
                if found is None:
                    raise ConvergenceError("no orbit")
                used = orbit_of(found)
                place = first.place + share * (last.place - first.place)
                one = self._node(place, found, chord)
                met.append((abs(test(one)), share, one))
            return test(one)

        located, largest = False, max(abs(test(first)), abs(test(last)))
        rise = abs(last.parameter - first.parameter) / max(abs(first.parameter), 1e-300)
        try:
            scipy.optimize.brentq(value, 0.0, 1.0, xtol=min(close, 1e-10 / max(rise, 1e-10)))
            located = min(met)[0] <= SMOOTH * largest
        except (ConvergenceError, ValueError):
            pass
        one = min(met)[2] if met else first
        return replace(one, crossing=Crossing(kind, one.parameter, one.place, located))


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


def cubic(first: Node, last: Node, share: float) -> tuple[np.ndarray, float]:
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


def _to_turns(parameters: np.ndarray) -> np.ndarray:
    """Points from each point to the nearest one where the parameter turns back: (n,)."""
    ahead = np.sign(np.diff(parameters))
    turns = np.flatnonzero(ahead[1:] != ahead[:-1]) + 1
    places = np.arange(len(parameters))
    return np.asarray(np.abs(places[:, None] - turns).min(1, initial=len(places)))


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
        if turn % 3:
            continue
        image = matrix @ columns
        values, vectors = np.linalg.eig(columns.T @ image)
        order = np.argsort(-np.abs(values), kind="stable")[: LEADING + 1]
        vectors = vectors[:, order]
        left = image @ vectors - (columns @ vectors) * values[order]
        if np.linalg.norm(left, axis=0).max() <= EXACT and abs(values[order[-1]]) < 1.0:
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


def _fits(first: Node, middle: Node, last: Node) -> bool:
    """Whether the moduli at a node are those between its neighbours', to a part of what they
    differ from 1."""
    lengths = [_length(first, middle), _length(middle, last)]
    share = lengths[0] / max(sum(lengths), 1e-300)
    count = min(len(one.moduli) for one in (first, middle, last))
    moduli = np.array([one.moduli[:count] for one in (first, middle, last)])
    allowed = FITTING * np.maximum(np.abs(1.0 - moduli).min(axis=0), RESOLVED)

    def off(line: np.ndarray) -> np.ndarray:
        common = min(len(line), count)
        return np.abs(moduli[1, :common] - line[:common]) > allowed[:common]

    return not (
        np.any(off(_line(first.moduli, last.moduli, share)))
        and np.any(off(blended(first, last, share)))
    )


def _pass_one(before: Node, first: Node, last: Node) -> bool:
    """Whether moduli that go on behind a node as they came would pass 1 half on the way to the
    next, where they are on the same side of it."""
    three = [one.moduli - 1.0 for one in (before, first, last)]
    count = min(map(len, three))
    came, here, next_one = (one[:count] for one in three)
    if not np.any(here * next_one > 0.0):
        return False
    ahead = 0.5 * _length(first, last) / max(_length(before, first), 1e-300)
    beyond = here + ahead * (here - came)
    return bool(np.any((here * next_one > 0.0) & (here * beyond < 0.0)))


def _length(first: Node, last: Node) -> float:
    change = last.unknown - first.unknown
    square = first.tangent.weight * (change @ change)
    return float(np.sqrt(square + (last.parameter - first.parameter) ** 2))


def _outside(values: np.ndarray) -> tuple[int, int, int]:
    """r, d and c of multipliers."""
    real, large = values.imag == 0.0, np.abs(values) > 1.0
    kinds = real & (values.real > 1.0), real & (values.real < -1.0), large & (values.imag > 0.0)
    return tuple(int(np.count_nonzero(kind)) for kind in kinds)  # type: ignore[return-value]
