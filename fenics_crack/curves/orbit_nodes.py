"""Nodes of a branch of orbits, and what they tell of the segments between them.

A node has the tangent of the branch and the multipliers mu of its orbit, and of all of these

    r = number of real mu > 1,    d = number of real mu < -1,    c = pairs with |mu| > 1.

A segment between two nodes is in doubt, and is halved,

- where the chord disagrees with their tangents;
- where -ln |mu| of a multiplier, followed from node to node by its angle too, is not that between
  its neighbours', to a quarter of the least of the three: the longer of the two segments;
- where moduli that went on as they came would pass 1 before its middle;
- where the angles of two pairs that went on as they came from both sides would pass each other, or
  that of one 0 or pi, or from one side before its middle: there pairs of a motion without damping
  leave the unit circle, and meet it again;
- once at either end of the curve, where nothing comes from beyond;
- where pairs of lips open and close a quarter more often at one end than at the other: multipliers
  turn on like a square root where a motion begins to touch;
- where several of r, d and c change, or one by more than 1, until each changes by itself.

Angles that differ by g where the pairs do not act on each other are the same, and moduli r apart
by factors of e^s, s^2 = e^2 - (g / 2)^2, where these act by e. One passes 1 if e > -ln r: a node
as near to g = 0 as a quarter of -ln r shows it, all but where it passes 1 by less than 1 % of
1 - r. So angles that pass are no doubt where a node is as near as that, or where both ends together
are no farther than twice -ln r.

What is not seen: two crossings of one kind on one segment that do not announce themselves, as where
a pair of lips begins to touch and ceases to on one.

Source: Seydel, Practical Bifurcation and Stability Analysis, chapters 5 and 7.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.optimize
from scipy.interpolate import barycentric_interpolate

from fenics_crack.numerics.newton import PathPoint, Tangent
from fenics_crack.numerics.path import STRAIGHT

EVERY = 8
"""Points of a curve from one node to the next."""
NARROWEST, ALONE = 1.0 / 8.0, 1.0 / 32.0
"""Segments that are not halved any more, in points of the curve, and those that are not smooth or
where several numbers change."""
LEADING = 8
"""Multipliers by which points are judged."""
RESOLVED = 0.01
"""What -ln |mu| may be off that between others, if a quarter of it is less."""


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
    crossing : OrbitBifurcation or None
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
    crossing: OrbitBifurcation | None = None

    @cached_property
    def leading(self) -> np.ndarray:
        """Those by which points are judged: (8,) complex, or fewer."""
        return self.multipliers[:LEADING]

    @cached_property
    def turns(self) -> np.ndarray:
        """-ln r and angles in (0, pi) of the pairs of multipliers: (k, 2)."""
        return _turned(self.multipliers[self.multipliers.imag > 0.0])

    @cached_property
    def upper(self) -> np.ndarray:
        """The same of the leading ones, with those that are real, at 0 and pi: (k, 2)."""
        return _turned(self.leading[self.leading.imag >= 0.0])

    @cached_property
    def moduli(self) -> np.ndarray:
        """Of the leading multipliers."""
        return np.abs(self.leading)

    @cached_property
    def pairs(self) -> np.ndarray:
        """Sums and products of the multipliers that are pairs, or were or will be: (k, 2)."""
        return paired(self.leading)

    @cached_property
    def real(self) -> float:
        """How many more of them are positive than negative, of those that are real."""
        return float(np.sign(self.leading.real[self.leading.imag == 0.0]).sum())


@dataclass(frozen=True)
class OrbitBifurcation:
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


def in_doubt(nodes: list[Node], linked: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Whether orbits or multipliers on each segment that is still ``whole`` may be others than
    those between its ends, as the module says: (n - 1,) bool."""
    doubt = np.zeros_like(linked)
    if len(nodes) < 2:
        return doubt
    wide = np.diff([one.place for one in nodes])
    if len(nodes) > 2:
        lengths, moduli = chords(nodes)[2], np.array([one.moduli for one in nodes])
        before, behind = wide[:-1] >= wide[1:], wide[1:] >= wide[:-1]
        left = whole & (wide > 1.0)
        asked = (left[:-1] & before) | (left[1:] & behind)
        asked &= np.maximum(wide[:-1], wide[1:]) <= EVERY
        bent = asked & _bent(nodes, lengths)
        doubt[:-1] |= bent & before
        doubt[1:] |= bent & behind
        doubt[1:] |= _pass_one(moduli, lengths)
        doubt[:-1] |= _pass_one(moduli[::-1], lengths[::-1])[::-1]
        doubt |= _pass_each_other(nodes, lengths)
    events = np.array([one.events for one in nodes])
    least, most = np.sort([events[:-1], events[1:]], axis=0)
    doubt |= (most > least) & (most >= 1.25 * least) & (wide > 1.0)
    doubt[[0, -1]] |= wide[[0, -1]] > EVERY // 2
    several = ~linked | (_steps(nodes).sum(axis=1) > 1)
    doubt &= wide > NARROWEST
    return whole & ((wide > EVERY) | doubt | (several & (wide > ALONE)))


def chords(nodes: list[Node]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """From each node to the next: changes of x, (n - 1, 2n), and of p, and lengths."""
    changes = np.diff([one.unknown for one in nodes], axis=0)
    rises = np.diff([one.parameter for one in nodes])
    weights = np.array([one.tangent.weight for one in nodes])[:-1]
    return changes, rises, np.sqrt(weights * np.sum(changes**2, axis=1) + rises**2)


def straight(nodes: list[Node]) -> np.ndarray:
    """Whether the chord from each node to the next agrees with the tangents at both: (n - 1,)
    bool."""
    changes, rises, lengths = chords(nodes)
    weights = np.array([one.tangent.weight for one in nodes])[:-1]
    ways = np.array([one.tangent.x for one in nodes])
    slopes = np.array([one.tangent.p for one in nodes])
    cosines = []
    for way, slope in ((ways[:-1], slopes[:-1]), (ways[1:], slopes[1:])):
        along = weights * np.sum(way * changes, axis=1) + slope * rises
        cosines.append(along / np.sqrt(weights * np.sum(way**2, axis=1) + slope**2))
    return np.asarray((lengths <= 1e-12) | (np.minimum(*cosines) > STRAIGHT * lengths))


def broken(nodes: list[Node]) -> np.ndarray:
    """Whether (-1)^r t_p changes its sign from each node to the next: (n - 1,) bool."""
    slopes = [0.0 if one.crossing else (-1.0) ** one.outside[0] * one.tangent.p for one in nodes]
    return np.asarray(np.array(slopes[:-1]) * slopes[1:] < 0.0)


def beside(nodes: list[Node], ends: np.ndarray, asked: list[Node]) -> set[float]:
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
    unknown = hermite(change, length, first.tangent.x, last.tangent.x, share)
    parameter = hermite(rise, length, first.tangent.p, last.tangent.p, share)
    return first.unknown + unknown, first.parameter + parameter


def hermite(change: Any, length: Any, begin: Any, end: Any, share: Any) -> Any:
    """The cubic that changes by so much over a length, with these slopes at its ends."""
    s, left = share, 1.0 - share
    return s * s * (3.0 - 2.0 * s) * change + s * left * length * (left * begin - s * end)


def bent_through(
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


def paired(values: np.ndarray) -> np.ndarray:
    """Sums and products of pairs, largest product first: of conjugate multipliers, and of real ones
    of one sign, which leave a pair and meet again; one that is left has zero beside it."""
    upper = values[values.imag > 0.0]
    sums, products = [2.0 * upper.real], [np.abs(upper) ** 2]
    alone = values.real[values.imag == 0.0]
    for real in (alone[alone > 0.0], alone[alone < 0.0]) if len(alone) else ():
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
    return -np.sort(-np.concatenate(_sizes(found[:, 0], found[:, 1])), axis=0)


def _sizes(sums: np.ndarray, products: np.ndarray) -> np.ndarray:
    """Moduli of both multipliers of pairs with these sums and products: (2, ...)."""
    half = 0.5 * sums
    root = np.sqrt(half**2 - products + 0j)
    return np.abs([half + root, half - root])


def _line(begin: np.ndarray, end: np.ndarray, share: float | np.ndarray) -> np.ndarray:
    """Between two arrays, as far as both go."""
    count = min(len(begin), len(end))
    rest = 1.0 - np.asarray(share)
    return np.multiply.outer(begin[:count], rest) + np.multiply.outer(end[:count], share)


def _bent(nodes: list[Node], lengths: np.ndarray) -> np.ndarray:
    """Whether -ln |mu| of a multiplier at each inner node is not that between its neighbours', to
    a quarter of the least of the three: (n - 2,) bool."""
    rows, way = _followed([one.upper for one in nodes])
    before, here, behind = (rows[begin : begin + len(rows) - 2, :, 0] for begin in range(3))
    before = np.take_along_axis(before, np.argsort(way[:-1], axis=1), 1)
    behind = np.take_along_axis(behind, way[1:], 1)
    share = (lengths[:-1] / np.maximum(lengths[:-1] + lengths[1:], 1e-300))[:, None]
    off = np.abs(here - before - share * (behind - before))
    least = np.abs([before, here, behind]).min(axis=0)
    return np.asarray(np.any(off > np.maximum(0.25 * least, RESOLVED), axis=1))


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
    if not cost.size:
        return found, np.zeros(cost.shape[:2], dtype=int)
    ways = np.argmin(cost, axis=2)
    shared = np.any(np.diff(np.sort(ways, axis=1), axis=1) == 0, axis=1)
    for one in np.flatnonzero(shared):  # of the others each has its nearest
        ways[one] = scipy.optimize.linear_sum_assignment(cost[one])[1]
    return found, ways


def _steps(nodes: list[Node]) -> np.ndarray:
    """By how much r, d and c change between each node and the next: (n - 1, 3); zero where nothing
    but two real multipliers meet, or part."""
    changes = np.diff(np.array([one.outside for one in nodes], dtype=int).reshape(-1, 3), axis=0)
    meet = ~np.any(changes[:, :2] % 2, axis=1) & (changes @ (1, 1, 2) == 0)
    return np.abs(changes) * ~meet[:, None]


def changes(nodes: list[Node]) -> np.ndarray:
    """Whether a bifurcation of each kind is between each node and the next: (n - 1, 3) bool."""
    return np.asarray(_steps(nodes) % 2 == 1)


def _turned(values: np.ndarray) -> np.ndarray:
    """-ln |mu| and angles of multipliers: (k, 2)."""
    return np.column_stack([-np.log(np.maximum(np.abs(values), 1e-300)), np.angle(values)])


def outside(values: np.ndarray) -> tuple[int, int, int]:
    """r, d and c of multipliers."""
    large = values[np.abs(values) > 1.0].tolist()
    real = [one.real > 0.0 for one in large if one.imag == 0.0]
    return sum(real), len(real) - sum(real), sum(one.imag > 0.0 for one in large)
