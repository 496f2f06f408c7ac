"""Contact of all pairs at one instant, seen through a static compliance that couples them.

What a basis of modes leaves out of a structure answers contact forces at once, without mass:

    g = s - R_inf lambda,

with s the gap that the modes and the load alone would make, and R_inf symmetric and positive
semidefinite. The forces then follow from s instant by instant,

    0 <= lambda,     (R_inf + I/k) lambda - s >= 0,     complementary,         k infinite: rigid,

a linear complementarity problem in a positive definite matrix D = R_inf + I/k: it has one solution,
which is piecewise linear in s. Where the set A of pairs is closed,

    lambda_A = (D_AA)^-1 s_A,       opening of the others = (D lambda - s) >= 0.

The sets are found by the primal-dual active set method (a semismooth Newton method; Hintermueller,
Ito and Kunisch, SIAM Journal on Optimization 13, 2002, 865), and where it cycles by Murty's method,
which changes one pair at a time (``kernel/sets.c``); where rounding spoils that, by least squares
with bounds. A law that is not piecewise linear is solved
by Newton's method at all instants together.

Sources: MacNeal, Computers & Structures 1 (1971) 581 (statics of what modes leave out);
Monjaraz-Tec, Gross and Krack, Computers & Structures 267 (2022) 106810 (boundaries without mass).
"""

from __future__ import annotations

import numpy as np

from fenics_crack.errors import ConvergenceError
from fenics_crack.kernel import doubles, kernel, owned, shaped, signs
from fenics_crack.model.complementarity import by_least_squares
from fenics_crack.model.contact import ContactLaw

__all__ = ["ActiveSets", "is_regular", "smooth_forces"]

MAX_KEPT = 2**28
"""Bytes of inverses that are kept."""
MAX_NEWTON = 200
"""Of a law that is not piecewise linear."""
ROUNDING = 1e-13
"""Openings relative to the largest gap of an instant that count as zero."""
REGULAR = 1e-6
"""Smallest eigenvalue of R_inf, relative to the largest, with which a constraint is solved."""


def is_regular(matrix: np.ndarray) -> bool:
    """Whether a symmetric matrix is positive definite, and not badly scaled."""
    values = np.linalg.eigvalsh(matrix)
    return not len(values) or bool(values[0] > REGULAR * values[-1] > 0.0)


class ActiveSets:
    """Contact at instants under a compliance D; inverses on sets of closed pairs are kept.

    Attributes
    ----------
    compliance : (n_pairs, n_pairs) [m/N]
        D = R_inf + I/k.
    scale : float
        Mean of its diagonal, which turns forces into gaps of their size [m/N].
    """

    def __init__(self, compliance: np.ndarray) -> None:
        self.compliance = compliance = shaped(compliance, len(compliance), len(compliance))
        self.scale = float(np.mean(np.diag(compliance))) if compliance.size else 0.0
        most = MAX_KEPT // max(compliance.nbytes, 8)
        count = len(compliance)
        self.handle = owned(kernel.new_sets(count, doubles(compliance), most), kernel.free_sets)
        """The kernel's own object."""

    def stack(self, sets: np.ndarray) -> np.ndarray:
        """(D_AA)^-1 with zeros outside A, of sets (m, n_pairs): (m, n_pairs, n_pairs) [N/m]."""
        closed = shaped(sets, len(sets), len(self.compliance), kind=bool)
        found = np.empty((*closed.shape, closed.shape[1]))
        if kernel.inverses_of(self.handle, len(closed), signs(closed), doubles(found)):
            raise ConvergenceError("contact: the compliance of the closed pairs is singular")
        return found

    def solve(
        self, gap: np.ndarray, closed: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces [N] and sets of closed pairs of gaps s (n, n_pairs) [m], from a guess of these."""
        gap = shaped(gap, len(gap), len(self.compliance))
        guess = gap > 0.0 if closed is None else np.array(closed)
        closed = shaped(guess, *gap.shape, kind=bool)
        force, failed = np.zeros_like(gap), np.empty(len(gap), dtype=bool)
        kernel.forces_of(
            self.handle, len(gap), doubles(gap), ROUNDING, signs(closed), doubles(force),
            signs(failed),
        )  # fmt: skip
        for row in np.flatnonzero(failed):
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
