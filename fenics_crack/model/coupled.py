"""Contact of all pairs at one instant, seen through a static compliance that couples them.

What a basis of modes leaves out of a structure answers contact forces at once, without mass:

    g = s - R_inf lambda,

with s the gap that the modes and the load alone would make, and R_inf symmetric and positive
semidefinite. The forces then follow from s instant by instant,

    0 <= lambda,     (R_inf + I/k) lambda - s >= 0,     complementary,         k infinite: rigid,

a linear complementarity problem in a positive definite matrix D = R_inf + I/k: it has one solution,
which is piecewise linear in s. Where the set A of pairs is closed,

    lambda_A = (D_AA)^-1 s_A,       opening of the others = (D lambda - s) >= 0.

The sets are found for all instants together by the primal-dual active set method (a semismooth
Newton method; Hintermueller, Ito and Kunisch, SIAM Journal on Optimization 13, 2002, 865); the few
instants where it cycles, by least squares with bounds. A law that is not piecewise linear is solved
by Newton's method at all instants together.

Sources: MacNeal, Computers & Structures 1 (1971) 581 (statics of what modes leave out);
Monjaraz-Tec, Gross and Krack, Computers & Structures 267 (2022) 106810 (boundaries without mass).
"""

from __future__ import annotations

import numpy as np

from fenics_crack.errors import ConvergenceError
from fenics_crack.kernel import doubles, kernel, owned
from fenics_crack.model.complementarity import by_least_squares
from fenics_crack.model.contact import ContactLaw

__all__ = ["ActiveSets", "smooth_forces", "unique_sets"]

MAX_ITERATIONS = 30
"""Of the active sets of all instants; afterwards by least squares."""
MAX_KEPT = 2**28
"""Bytes of inverses that are kept."""
MAX_NEWTON = 200
"""Of a law that is not piecewise linear."""
ROUNDING = 1e-13
"""Forces and openings relative to the largest that count as zero."""


def unique_sets(closed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Different rows of sets (n, n_pairs): (m, n_pairs), and which of them each row is: (n,)."""
    packed = np.packbits(np.ascontiguousarray(closed), axis=1)
    packed = np.ascontiguousarray(packed)
    keys = packed.view([("", packed.dtype)] * packed.shape[1]).ravel()
    _, first, which = np.unique(keys, return_index=True, return_inverse=True)
    return closed[first], which.ravel()


class ActiveSets:
    """Inverses of D on sets of closed pairs, kept once they are computed.

    Attributes
    ----------
    compliance : (n_pairs, n_pairs) [m/N]
        D = R_inf + I/k.
    scale : float
        Mean of its diagonal, which turns forces into gaps of their size [m/N].
    """

    def __init__(self, compliance: np.ndarray) -> None:
        self.compliance = compliance
        self.scale = float(np.mean(np.diag(compliance)))
        self._kept: dict[bytes, np.ndarray] = {}
        count = len(compliance)
        most = max(16, MAX_KEPT // (8 * max(1, count * count)))
        matrix = np.ascontiguousarray(compliance, dtype=float)
        self.handle = owned(kernel.new_sets(count, doubles(matrix), most), kernel.free_sets)
        """The same in the kernel."""

    def stiffness(self, closed: np.ndarray) -> np.ndarray:
        """(D_AA)^-1 with zeros outside A, of a set (n_pairs,): (n_pairs, n_pairs) [N/m]."""
        key = closed.tobytes()
        if key not in self._kept:
            if (len(self._kept) + 1) * self.compliance.nbytes > MAX_KEPT:
                self._kept.clear()
            found = np.zeros_like(self.compliance)
            places = np.flatnonzero(closed)
            block = np.ix_(places, places)
            found[block] = np.linalg.inv(self.compliance[block])
            self._kept[key] = 0.5 * (found + found.T)
        return self._kept[key]

    def stack(self, sets: np.ndarray) -> np.ndarray:
        """The same of many sets (m, n_pairs): (m, n_pairs, n_pairs)."""
        return np.array([self.stiffness(closed) for closed in sets]).reshape(
            len(sets), *self.compliance.shape
        )

    def forces(self, gap: np.ndarray, closed: np.ndarray) -> np.ndarray:
        """(D_AA)^-1 s_A of gaps s (n, n_pairs) with the sets closed (n, n_pairs)."""
        sets, which = unique_sets(closed)
        force = np.empty_like(gap)
        order = np.argsort(which, kind="stable")
        ends = np.searchsorted(which[order], np.arange(len(sets) + 1))
        for number, members in enumerate(sets):
            rows = order[ends[number] : ends[number + 1]]
            force[rows] = gap[rows] @ self.stiffness(members)
        return force

    def solve(
        self, gap: np.ndarray, closed: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces [N] and sets of closed pairs of gaps s (n, n_pairs) [m], from a guess of these."""
        closed = gap > 0.0 if closed is None else closed.copy()
        force = np.zeros_like(gap)
        allowed = ROUNDING * float(np.abs(gap).max(initial=0.0))
        open_rows: np.ndarray = np.arange(len(gap))
        for _ in range(MAX_ITERATIONS):
            here, sets = gap[open_rows], closed[open_rows]
            found = self.forces(here, sets)
            opening = found @ self.compliance - here
            now = np.where(sets, found > 0.0, opening < -allowed)
            force[open_rows] = found
            closed[open_rows] = now
            open_rows = open_rows[np.any(now != sets, axis=1)]
            if not len(open_rows):
                return force, closed
        for row in open_rows:
            force[row] = by_least_squares(self.compliance, gap[row])
            closed[row] = force[row] > 0.0
        return force, closed


def smooth_forces(
    law: ContactLaw, compliance: np.ndarray, gap: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """lambda = h(s - D lambda) of gaps s (n, n_pairs), and its derivative by s (n, n_pairs,
    n_pairs), for a law whose force does not fall where the gap grows.

    Newton's method in g = s - D lambda at all instants together, from the penalty law's solution;
    where the residual of an instant grows, its step is halved. Raises ConvergenceError where that
    does not lead to a solution.
    """
    springs = np.broadcast_to(1.0 / np.asarray(law.stiffness, dtype=float), gap.shape[1:])
    closed = gap - ActiveSets(compliance + np.diag(springs)).solve(gap)[0] @ compliance
    unit, allowed = np.eye(gap.shape[1]), ROUNDING * float(np.abs(gap).max(initial=0.0))
    left, share = np.arange(len(gap)), np.ones(len(gap))
    change = np.zeros_like(gap)
    before = np.full(len(gap), np.inf)
    for _ in range(MAX_NEWTON):
        here = closed[left]
        force = law.force(here)
        residual = here + force @ compliance - gap[left]
        size = np.abs(residual).max(axis=1)
        worse = ~(size < before[left])
        share[left[worse]] *= 0.5
        closed[left[worse]] -= share[left[worse], None] * change[left[worse]]
        good = left[~worse]
        if len(good):
            before[good] = size[~worse]
            jacobian = unit + compliance * law.tangent(here[~worse])[:, None, :]
            step = np.linalg.solve(jacobian, -residual[~worse][:, :, None])[:, :, 0]
            change[good], share[good] = step, 1.0
            closed[good] += step
        done = (before[left] <= 4.0 * allowed) | (share[left] < 1e-6)
        left = left[~done]
        if not len(left):
            break
    if len(left) or np.any(before > 1e-6 * np.abs(gap).max(initial=0.0)):
        raise ConvergenceError("contact: no forces of the law were found at an instant")
    slope = law.tangent(closed)
    jacobian = unit + compliance * slope[:, None, :]
    return law.force(closed), slope[:, :, None] * np.linalg.inv(jacobian)
