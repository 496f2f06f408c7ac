"""Bifurcations of periodic orbits along a path, and steps that resolve their Floquet multipliers.

Of the leading multipliers mu of each point,

    r = number of real mu > 1,    d = number of real mu < -1,    c = pairs with |mu| > 1.

Between two points lies a fold where the parameter turns back, a period doubling where d changes, a
Neimark-Sacker point where c does; two real multipliers outside the circle that meet and become a
pair are none. Where multipliers cross the unit circle is located by the Illinois
method (:func:`fenics_crack.numerics.path.find_zero`) on

    the product of all 1 + mu,    |mu_k| - 1 of the k-th pair.

Where no orbit between the two has it within 1e-6 of the circle it jumps, which is no bifurcation.

With light damping all |mu| = exp(-d) are next to the circle, and along the curve the angles of mu
turn: what leaves the circle between two points are two that meet, a pair at -1 or 1 or two pairs
anywhere, and part again. In the eigenvectors of the first point, M there is diag(mu) and M of the
second one B. Of M interpolated linearly between them two multipliers j and k have, at the share s,
the difference g (1 - s) - s b with g = |mu_j - mu_k| and b = |B_jj - B_kk|, and the coupling
s^2 c^2 with c^2 = 4 |B_jk B_kj|, all relative to |mu_j mu_k|: where B_jk B_kj / (B_jj - B_kk)^2 < 0
(opposite signatures in Krein's sense) they part in ln |mu| by up to

    max over s of sqrt(s^2 c^2 - (s (g + b) - g)^2),    at s = g (g + b) / ((g + b)^2 - c^2).

One leaves the unit circle where this is above 2 sqrt(d_j d_k). Others stay on the circle as they
pass each other, and those do not meet whose order along it is the same in both matrices: where the
angle of mu_j / mu_k and that of B_jj / B_kk, by the shorter way from there, have one sign.

Sources: Seydel, Practical Bifurcation and Stability Analysis, chapters 5 and 7; Yakubovich and
Starzhinskii, Linear Differential Equations with Periodic Coefficients, 1975, chapter 3.
"""

from __future__ import annotations

import math

import numpy as np

from fenics_crack.kernel import kernel, pointer
from fenics_crack.motion.orbit import MULTIPLIER_TOLERANCE
from fenics_crack.numerics.equations import ROOT_TOLERANCE, System
from fenics_crack.numerics.newton import PathPoint
from fenics_crack.numerics.path import Event, PathSegment, SegmentEnds, StepControl, find_zero

LEAST = 0.01
"""Change of ln |mu| that is always allowed, and shortest step to resolve it, relative to the
longest."""

MEETING_STEP = 0.02
"""Shortest step to resolve where multipliers meet, relative to the longest: 0.1 % of the range with
the default one."""


def leading_multipliers(values: np.ndarray) -> np.ndarray:
    """The leading ones of multipliers (n, N), largest modulus first, and their r, d and c:
    (n, k + 3) complex, k = 8, or N where that is less. Those within 1e-6 of the circle are not
    outside."""
    size = np.abs(values)
    order = np.argsort(-size, axis=1, kind="stable")[:, :8]
    rows = np.arange(len(order))[:, None]
    values, large = values[rows, order], size[rows, order] > 1.0 + MULTIPLIER_TOLERANCE
    found = np.empty((len(order), order.shape[1] + 3), dtype=complex)
    found[:, :-3] = values
    real = values.imag == 0.0
    found[:, -3] = (large & real & (values.real > 0.0)).sum(axis=1)
    found[:, -2] = (large & real).sum(axis=1) - found[:, -3]
    found[:, -1] = (large & (values.imag > 0.0)).sum(axis=1)
    return found


def changes(observed: np.ndarray) -> np.ndarray:
    """Changes of r, d and c behind each point but the last, (n-1, 3), without those by two real
    multipliers that become a pair, or a pair that becomes two."""
    found = np.diff(observed[:, -3:].real, axis=0)
    some = np.flatnonzero(found[:, 2])
    if not len(some):
        return found
    real, pairs = found[some, :2], found[some, 2]
    meet = (np.abs(real).max(axis=1) == 2.0) & (real.sum(axis=1) == -2.0 * pairs)
    found[some[meet]] = 0.0
    return found


def parting(monodromy: np.ndarray) -> np.ndarray:
    """How far two multipliers part where they meet between neighbours, relative to the distance at
    which one leaves the unit circle: (n-1,) of matrices (n, N, N)."""
    n_points, size = monodromy.shape[:2]
    severity = np.empty(n_points - 1)
    matrices = np.ascontiguousarray(monodromy)
    kernel.collision_severities(
        n_points, size, pointer(matrices), MULTIPLIER_TOLERANCE, pointer(severity)
    )
    return severity


class MultiplierControl(StepControl):
    """Reject steps over which multipliers change too much.

    A leading multiplier may move at most half its distance to the unit circle, be mispredicted by
    as much (linear extrapolation of sorted ln |mu|), and two may part by at most half of what is
    allowed (:func:`parting`), down to a floor. Of r, d and c one may change, by 1.
    """

    def __init__(self, longest_step: float) -> None:
        self._longest, self._floor = longest_step, LEAST * longest_step

    def too_long(self, segment: PathSegment, first_index: int = 0) -> np.ndarray:
        logs = np.log(np.maximum(np.abs(segment.control_values[:, :-3]), MULTIPLIER_TOLERANCE))
        change, lengths = np.diff(logs, axis=0), segment.lengths[1:]
        allowed = np.maximum(0.5 * np.abs(logs[:-1]), LEAST)
        far = np.any(np.abs(change) > allowed, axis=1)
        if len(change) > 1:
            ratio = (lengths[1:] / lengths[:-1])[:, None]
            off = np.abs(change[1:] - ratio * change[:-1])
            far[1:] |= np.any(off > allowed[1:], axis=1)
        size = math.isqrt(segment.records.shape[1])
        apart = parting(segment.records[first_index:].reshape(-1, size, size)) > 0.5
        far, lengths = far[first_index:], lengths[first_index:]
        far = (far & (lengths > self._floor)) | (apart & (lengths > MEETING_STEP * self._longest))
        several = np.abs(changes(segment.control_values[first_index:])).sum(axis=1) > 1
        return np.asarray(far | several)


class PeriodDoubling(Event):
    """A real multiplier crosses -1: the product of all 1 + mu changes its sign."""

    kind = "period_doubling"

    def detect(self, points: PathSegment) -> np.ndarray:
        return np.asarray(changes(points.control_values)[:, 1] != 0.0)

    def locate(self, system: System, ends: SegmentEnds, rtol: float) -> PathPoint | None:
        found = find_zero(system, ends, lambda one: about_minus_one(multipliers(one)), rtol)[0]
        return found if np.abs(1.0 + multipliers(found)).min() <= MULTIPLIER_TOLERANCE else None


class NeimarkSacker(Event):
    """A pair of multipliers crosses the unit circle: |mu_k| - 1 of the k-th pair vanishes."""

    kind = "neimark_sacker"

    def detect(self, points: PathSegment) -> np.ndarray:
        return np.asarray(changes(points.control_values)[:, 2] != 0.0)

    def locate(self, system: System, ends: SegmentEnds, rtol: float) -> PathPoint | None:
        assert ends[0].control_values is not None and ends[1].control_values is not None
        number = int(max(ends[0].control_values[-1].real, ends[1].control_values[-1].real)) - 1
        sides = [beyond_circle(multipliers(one), number) for one in ends]
        # What was within 1e-6 of the circle may have been beyond it all the time.
        shift = 0.0 if sides[0] * sides[1] < 0.0 else MULTIPLIER_TOLERANCE

        def value(point: PathPoint) -> float:
            found = beyond_circle(multipliers(point), number) - shift
            return found if abs(found) > ROOT_TOLERANCE else 0.0

        found, left = find_zero(system, ends, value, rtol)
        return found if abs(left) <= MULTIPLIER_TOLERANCE else None


def multipliers(point: PathPoint) -> np.ndarray:
    """Leading multipliers of a point of a path: (k,) complex."""
    assert point.control_values is not None
    return point.control_values[:-3]


def about_minus_one(values: np.ndarray) -> float:
    """A function of multipliers with the sign and the zeros of the product of all 1 + mu, at most
    1; 0 where it is small enough."""
    factors = np.where(values.imag == 0.0, 1.0 + values.real, np.abs(1.0 + values))
    found = float(np.prod(factors / np.maximum(1.0, np.abs(factors))))
    return found if np.abs(factors).min() > ROOT_TOLERANCE else 0.0


def beyond_circle(values: np.ndarray, number: int) -> float:
    """|mu| - 1 of one of the pairs of multipliers, 0 the largest; -1 where there are fewer."""
    sizes = np.sort(np.abs(values[values.imag > 0.0]))[::-1]
    return float(sizes[number] - 1.0) if len(sizes) > number else -1.0
