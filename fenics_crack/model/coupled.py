"""Contact of all pairs at one instant, seen through a compliance that couples them.

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
which changes one pair at a time (``kernel/sets.c``); where rounding spoils that, or D is singular,
as the minimum of lambda^T D lambda / 2 - lambda^T s for lambda >= 0, a least-squares problem with
bounds, for which the method of Lawson and Hanson is finite. A law that is not piecewise linear is
solved by Newton's method at all instants together.

One step of time integration asks the same, D being the compliance of the step and s the gaps that
it would reach without contact forces.

Sources: Lawson and Hanson, Solving Least Squares Problems (1974), chapter 23; MacNeal, Computers &
Structures 1 (1971) 581 (statics of what modes leave out);
Monjaraz-Tec, Gross and Krack, Computers & Structures 267 (2022) 106810 (boundaries without mass).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fenics_crack.errors import ConvergenceError
from fenics_crack.kernel import doubles, kernel, owned, shaped, signs
from fenics_crack.model.contact import ContactLaw
from fenics_crack.numerics.equations import ROUNDING

__all__ = [
    "KEPT",
    "REGULAR",
    "ActiveSets",
    "by_least_squares",
    "is_regular",
    "smooth_forces",
    "solve_complementarity",
    "solve_forces",
]

KEPT = 2**27
"""Bytes of what is kept of sets of closed pairs."""
MAX_NEWTON = 200
"""Iterations for forces that are not piecewise linear in the gaps."""
REGULAR = 1e-6
"""Smallest eigenvalue of R_inf, relative to the largest, with which a constraint is solved; the
softness of a penalty that stands for one."""


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
        most = KEPT // max(compliance.nbytes, 8)
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


def solve_complementarity(
    matrix: np.ndarray, gap: np.ndarray, closed: np.ndarray | None = None
) -> np.ndarray:
    """Find lambda with 0 <= lambda, D lambda - g >= 0, lambda^T (D lambda - g) = 0: (n,).

    D is positive definite, and symmetric but for a small part; ``closed`` is a first guess of where
    lambda > 0. Raises ConvergenceError where there is no solution, or it was not found.
    """
    guess = None if closed is None else np.array(closed)[None]
    found: np.ndarray = ActiveSets(matrix).solve(shaped(gap, len(matrix))[None], guess)[0][0]
    return found


def by_least_squares(matrix: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """The same by least squares with bounds; what of D is not symmetric follows by iteration."""
    import scipy.optimize  # takes a while, and is rarely needed

    symmetric = 0.5 * (matrix + matrix.T)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(symmetric), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(scale[:, None] * symmetric * scale)
    root = np.sqrt(np.maximum(values, 1e-15 * values.max(initial=0.0)))
    allowed = 1e-10 * float(np.abs(gap).max(initial=0.0))
    force = np.zeros(len(gap))
    for _ in range(MAX_NEWTON):
        target = (vectors.T @ (scale * (gap - (matrix - symmetric) @ force))) / root
        try:
            force = scale * scipy.optimize.nnls((vectors * root).T, target)[0]
        except RuntimeError:
            break
        opening = matrix @ force - gap
        if opening.min() >= -allowed and np.abs(opening[force > 0.0]).max(initial=0.0) <= allowed:
            return force
    raise ConvergenceError("contact: no set of closed pairs satisfies the step's constraints")


def smooth_forces(
    law: ContactLaw, compliance: np.ndarray, gap: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """lambda = h(s - D lambda) of gaps s (n, n_pairs), and its derivative by s (n, n_pairs,
    n_pairs), for a law whose force does not fall where the gap grows, from the penalty law's
    solution.

    Raises ConvergenceError as :func:`solve_forces`.
    """
    springs = np.broadcast_to(1.0 / np.asarray(law.stiffness, dtype=float), gap.shape[1:])
    guess = ActiveSets(compliance + np.diag(springs)).solve(gap)[0]
    force = solve_forces(lambda g: (law.force(g), law.tangent(g)), compliance, gap, guess)
    slope = law.tangent(gap - force @ compliance)
    jacobian = np.eye(gap.shape[1]) + compliance * slope[:, None, :]
    return force, slope[:, :, None] * np.linalg.inv(jacobian)


def solve_forces(
    response: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    matrix: np.ndarray,
    gap: np.ndarray,
    guess: np.ndarray,
) -> np.ndarray:
    """Find lambda = h(s - D lambda) of gaps s (n, n_pairs), D symmetric, by Newton's method at all
    instants together: (n, n_pairs).

    ``response`` gives h(g) and its derivative, pair by pair; h may not fall where g grows. The
    solution is then the minimum of a convex function, whose slope along a step shortens steps that
    go too far. Raises ConvergenceError where Newton's method fails.
    """

    def evaluate(force: np.ndarray, given: np.ndarray) -> tuple[np.ndarray, ...]:
        reached = given - force @ matrix
        return (reached, *response(reached))

    found, left = np.array(guess), np.arange(len(gap))
    unit, (reached, answer, tangent) = np.eye(gap.shape[1]), evaluate(found, gap)
    for _ in range(MAX_NEWTON):
        force, given = found[left], gap[left]
        excess = force - answer
        if not np.any(excess):
            return found
        try:
            change = -np.linalg.solve(unit + tangent[:, :, None] * matrix, excess[:, :, None])
        except np.linalg.LinAlgError:
            break
        moved, trial = change[:, :, 0] @ matrix, force + change[:, :, 0]
        if not np.all(np.isfinite(trial)):
            break
        found[left] = trial
        size = (np.abs(given) + np.abs(given - reached)).max(axis=1)
        more = np.abs(moved).max(axis=1) > ROUNDING * size
        if not np.any(more):
            return found
        left, force, moved, given = left[more], force[more], moved[more], given[more]
        slope = np.sum(moved * excess[more], axis=1)
        reached, answer, tangent = evaluate(found[left], given)
        ends = np.sum(moved * (found[left] - answer), axis=1)
        too_far = np.flatnonzero((slope < 0.0) & (ends > -0.1 * slope))
        for row in too_far:
            at = slice(row, row + 1)
            step = found[left[at]] - force[at]
            found[left[at]] = force[at] + _lowest(evaluate, force[at], step, given[at]) * step
        if len(too_far):
            reached, answer, tangent = evaluate(found[left], given)
    raise ConvergenceError("contact: Newton's method for the forces of a step does not converge")


def _lowest(
    evaluate: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, ...]],
    force: np.ndarray,
    step: np.ndarray,
    gap: np.ndarray,
) -> float:
    """Share of a step (1, n_pairs) where the convex function is lowest along it."""
    import scipy.optimize

    moved = evaluate(force, gap)[0] - evaluate(force + step, gap)[0]  # D times the step

    def slope(share: float) -> float:
        trial = force + share * step
        return float(np.sum(moved * (trial - evaluate(trial, gap)[1])))

    return float(scipy.optimize.brentq(slope, 0.0, 1.0, xtol=1e-6))
