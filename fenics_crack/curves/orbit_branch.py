"""The branch of exact orbits along a curve: nodes, and the bifurcations between them.

Next to every eighth point of the curve an orbit F(x, p) = 0 (:mod:`fenics_crack.motion.shooting`)
is found by Newton's method, from the point's own motion and what had to be added to that of the
node beside: at the point's parameter, or, next to folds, in the plane across the curve. Segments
between these nodes that are in doubt (:mod:`orbit_nodes`) are halved, by the orbit next to
Hermite's cubic through both. Where none is found in the middle orbits are sought next to each
point, from either end on; what is left between these judges no points.

Along a smooth branch (-1)^r t_p keeps its sign (det F_x has that of (-1)^r). Where it does not,
there is a branch point, or the nodes are of different branches: those beyond a fold of the curve
may be the orbits before it once more.

Then a fold (or a branch point) lies on a segment where r changes, a period doubling where d does, a
Neimark-Sacker point where c does. It is found by Brent's method on

    t_p (the tangent's),    the product of 1 + mu,    |mu| - 1 of the pair that leaves,

and becomes a node. Two real multipliers outside that meet and become a pair are no bifurcation.

What is not seen: what :mod:`orbit_nodes` says.

Source: Seydel, Practical Bifurcation and Stability Analysis, chapters 4, 5 and 7.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import scipy.optimize
from scipy.linalg.lapack import dgeqrf, dorgqr

from fenics_crack.curves.orbit_nodes import (
    EVERY,
    LEADING,
    Node,
    OrbitBifurcation,
    bent_through,
    beside,
    broken,
    changes,
    chords,
    hermite,
    in_doubt,
    outside,
    paired,
    straight,
)  # fmt: skip
from fenics_crack.errors import ConvergenceError
from fenics_crack.motion.orbit import KNOWN, SHRINKING, eigenvalues
from fenics_crack.motion.shooting import FlowOrbits, OrbitPoint
from fenics_crack.numerics.equations import CLOSE, LOCATED
from fenics_crack.numerics.newton import (
    FULL_STEPS,
    PATIENCE,
    PathPoint,
    Tangent,
    solve_in_plane,
    tangent_of,
)

KINDS = "fold", "period_doubling", "neimark_sacker"
ALIKE = 0.5
"""Farthest orbit from the motion of its point; whether it is the point's own is asked later."""
REACH = 5e-3
"""Farthest orbit from the parameter of its point, of the whole."""
COLUMNS, SQUARINGS, TURNS = 24, 4, 9
"""Of many multipliers those of M in the span of some columns that M^16 has turned to the leading
ones some times are taken, where these are known well."""
SMOOTH = 0.25
"""Of a test function's largest value, what may be left where it vanishes."""


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
    added : dict
        What is added to x of the motions of points, by their numbers, for that of their orbits.
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
        self.added: dict[int, np.ndarray] = {}
        self._turn = _to_turns(parameters)
        self._halved: set[tuple[float, float]] = set()
        self._missed: set[tuple[float, float]] = set()
        self.nodes: list[Node] = []
        self._refined: list[int] = []
        """Nodes between which no segment is in doubt, by their identities."""
        last = len(parameters) - 1
        places = np.unique(np.append(np.arange(0, last, every), last))
        self.motions(places)
        for place in map(int, places):
            found = self.next_to(place)
            self.nodes += [] if found is None else [found]
        self._refine()

    # --- nodes ------------------------------------------------------------------------------------

    def _refine(self) -> None:
        """Halve segments until each that is in doubt has been."""
        while self._refined != (now := list(map(id, self.nodes))):
            found, linked = [], self.linked
            segments = list(pairwise(self.nodes))
            places = [(first.place, last.place) for first, last in segments]
            whole = np.array([one not in self._halved for one in places], dtype=bool)
            halved = np.flatnonzero(in_doubt(self.nodes, linked, whole))
            self._halved.update(places[number] for number in halved)
            apart = [round(sum(places[number]) / 2) for number in halved if not linked[number]]
            self.motions(np.array(apart, dtype=int))
            for number in halved:
                middle = self._middle(segments[number], bool(linked[number]))
                found += [middle] if middle is not None else self._inside(segments[number])
                self._missed.update([places[number]] if middle is None else [])
            self.nodes = sorted([*self.nodes, *found], key=lambda one: one.place)
            self._refined = now

    @property
    def linked(self) -> np.ndarray:
        """Whether a smooth branch leads beyond doubt from each node to the next: (n - 1,) bool."""
        nodes = self.nodes
        if len(nodes) < 2:
            return np.zeros(0, dtype=bool)
        missed = [(one.place, other.place) in self._missed for one, other in pairwise(nodes)]
        return straight(nodes) & ~broken(nodes) & ~np.array(missed)

    @property
    def breaks(self) -> np.ndarray:
        """Numbers of the nodes behind which the branch is broken."""
        return np.flatnonzero(broken(self.nodes))

    def broken(self, nodes: list[Node]) -> set[float]:
        """Places of those of some nodes beside which the nodes with their r end where the branch is
        broken: their orbits may be those of another part of the curve."""
        return beside(self.nodes, self.breaks, nodes) if len(self.breaks) else set()

    def _middle(self, ends: tuple[Node, Node], linked: bool) -> Node | None:
        """A node between two others; None where none is found."""
        first, last = ends
        whole = round(0.5 * (first.place + last.place))
        inside = first.place < whole < last.place
        found = self.across(first, last, 0.5, {}, CLOSE) if linked or not inside else None
        if found is not None:
            return self.inside(first, last, 0.5, found)
        return self.next_to(whole) if inside else None

    def _inside(self, ends: tuple[Node, Node]) -> list[Node]:
        """Nodes next to points between two others in whose middle none is found, from either end as
        far as one is found next to each."""
        places = range(math.floor(ends[0].place) + 1, math.ceil(ends[1].place))
        nodes: dict[int, Node] = {}
        for side in (places, reversed(places)):
            for place in side:
                node = None if place in nodes else self.next_to(place)
                if node is None:
                    break
                nodes[place] = node
        return list(nodes.values())

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
        changes, _, lengths = chords(self.nodes)
        ways = np.array([one.tangent.x for one in self.nodes])
        first = np.array([one.unknown for one in self.nodes])[segment]
        ends = ways[segment], ways[segment + 1]
        return first + hermite(changes[segment], lengths[segment, None], *ends, share[:, None])

    def anchor(self, place: int) -> Node | None:
        """The node next to a point, from now on one of the branch; None where none is found."""
        number = int(np.searchsorted([one.place for one in self.nodes], place))
        there = [one for one in self.nodes[number : number + 1] if one.place == place]
        if there and there[0].away >= 0.0:
            return there[0]
        if (node := self.next_to(place)) is not None:
            self.nodes[number : number + len(there)] = [node]
        return node

    def next_to(self, place: int, *, across: bool = True) -> Node | None:
        """The node next to a point of the curve, with ``across`` also in the plane across that, or
        else at the point's own parameter, next to folds, too; None where none is found."""
        motion, parameter = self.motion(place), float(self._parameters[place])
        planes = [True] if across and self._turn[place] <= 2 else [False, True][: 1 + across]
        for start in self._starts(place, far=across):
            for plane in planes:
                chord = self._ahead(place, along=True) if plane else None
                found = self._solved(start, parameter, chord)
                if found is None:
                    continue
                away = float(
                    np.linalg.norm(found.unknown - motion) / (np.linalg.norm(motion) or 1.0)
                )
                if away <= ALIKE:
                    self.added[place] = found.unknown - motion
                    return self._node(place, found, self._ahead(place, along=False), away)
        return None

    def added_near(self, place: int) -> np.ndarray | None:
        """What is added for the nearest orbit to a point that is known; None without one."""
        near = [one for one in range(place - EVERY, place + EVERY + 1) if one in self.added]
        if not near:
            return None
        first = min(near, key=lambda one: (abs(one - place), np.linalg.norm(self.added[one])))
        return self.added[first]

    def _starts(self, place: int, *, far: bool) -> Iterator[np.ndarray]:
        """Where the orbit next to a point is sought: from its motion and what is added for the
        nearest one, from its motion, and, ``far`` from all that are known, from where the homotopy
        leads."""
        motion, added = self.motion(place), self.added_near(place)
        if added is not None:
            yield motion + added
        yield motion

    def inside(self, first: Node, last: Node, share: float, found: PathPoint) -> Node:
        """The node of an orbit at a part of the segment between two others."""
        return self._node(first.place + share * (last.place - first.place), found, found.tangent)

    def across(
        self, first: Node, last: Node, share: float, met: dict[float, PathPoint], tolerance: float
    ) -> PathPoint | None:
        """The orbit next to the cubic through two nodes, bent through those that have been met on
        the segment, in the plane across their chord, its tangent."""
        change, rise = last.unknown - first.unknown, last.parameter - first.parameter
        chord = _direction(change, rise, first.unknown)
        start = bent_through(first, last, met, share)
        found = None if chord is None else self._solved(*start, chord, tolerance)
        if found is None:
            return None
        ends = [np.linalg.norm(found.unknown - one.unknown) for one in (first, last)]
        most = 1.5 * np.linalg.norm(change) + 1e-6 * np.linalg.norm(found.unknown)
        return found if max(ends) <= most else None

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
        self, unknown: np.ndarray, parameter: float, plane: Tangent | None, tolerance: float = CLOSE
    ) -> PathPoint | None:
        """The orbit in a plane, or at a given parameter."""
        try:
            return solve_in_plane(
                self.system, unknown, parameter, plane, tolerance=tolerance, iterations=FULL_STEPS,
                reach=self._reach, least_damping=None, patience=PATIENCE, lasting=SHRINKING,
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
            outside(values),
            found.at.events,
            away,
        )

    # --- bifurcations -----------------------------------------------------------------------------

    def locate(self) -> list[OrbitBifurcation]:
        """The bifurcations, in the order of the branch; from now on they are nodes of it."""
        self._refine()
        found: list[Node] = []
        for (first, last), differ in zip(pairwise(self.nodes), changes(self.nodes), strict=True):
            found.append(first)
            if last.place - first.place <= EVERY:
                kinds = [kind for kind, change in zip(KINDS, differ, strict=True) if change]
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
            return float(np.prod(1.0 + paired(leading).sum(axis=1)))
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
        return value if abs(value) > CLOSE * self.largest else 0.0

    def located(self) -> Node:
        """Where it vanishes; not located: where it was smallest, as an orbit is missed, or it has
        one sign, or jumps past zero."""
        try:
            scipy.optimize.brentq(self, 0.0, 1.0, xtol=CLOSE)
            searched = True
        except (ConvergenceError, ValueError):
            searched = False
        one, located = self._ends[0], False
        if self.values:
            share = min(self.values, key=lambda share: abs(self.values[share]))
            one = self._branch.inside(*self._ends, share, self.met[share])
            located = searched and abs(self.values[share]) <= SMOOTH * self.largest
        crossing = OrbitBifurcation(self._kind, one.parameter, one.place, located)
        return replace(one, crossing=crossing)


def _direction(change: np.ndarray, rise: float, at: np.ndarray) -> Tangent | None:
    weight = 1.0 / max(float(at @ at), 1e-300)
    length = float(np.sqrt(weight * (change @ change) + rise**2))
    return Tangent(change / length, rise / length, weight) if length > 1e-12 else None


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
