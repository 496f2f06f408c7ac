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
from fenics_crack.numerics.rounding import ROUNDING

__all__ = [
    "ActiveSets",
    "by_least_squares",
    "is_regular",
    "smooth_forces",
    "solve_complementarity",
    "solve_forces",
]

MAX_KEPT = 2**28
"""Bytes of inverses that are kept."""
MAX_NEWTON = 200
"""Iterations for forces that are not piecewise linear in the gaps."""
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


def solve_forces(
    response: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    matrix: np.ndarray,
    gap: np.ndarray,
    guess: np.ndarray,
) -> np.ndarray:
    """Find lambda = h(g - D lambda) by Newton's method, D symmetric and positive definite: (n,).

    ``response`` gives h(g) and its derivative, pair by pair; h may not fall where g grows. The
    solution is then the minimum of a convex function, whose slope along a step shortens steps that
    go too far. Raises ConvergenceError where Newton's method fails.
    """

    def evaluate(force: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        reached = gap - matrix @ force
        return (reached, *response(reached))

    force, (reached, found, tangent) = guess, evaluate(guess)
    for _ in range(MAX_NEWTON):
        excess = force - found
        if not np.any(excess):
            return force
        jacobian = np.eye(len(gap)) + tangent[:, None] * matrix
        try:
            change = np.linalg.solve(jacobian, -excess)
        except np.linalg.LinAlgError:
            break
        if not np.all(np.isfinite(change)):
            break
        moved, trial = matrix @ change, force + change
        if np.abs(moved).max() <= ROUNDING * (np.abs(gap).max() + np.abs(gap - reached).max()):
            return trial
        slope, (reached, found, tangent) = float(moved @ excess), evaluate(trial)
        if slope < 0.0 and moved @ (trial - found) > -0.1 * slope:
            trial = force + _lowest(evaluate, force, change, moved) * change
            reached, found, tangent = evaluate(trial)
        force = trial
    raise ConvergenceError("contact: Newton's method for the forces of a step does not converge")


def _lowest(
    evaluate: Callable[[np.ndarray], tuple[np.ndarray, ...]],
    force: np.ndarray,
    change: np.ndarray,
    moved: np.ndarray,
) -> float:
    """Share of a step where the convex function is lowest along it; D times the step is given."""
    import scipy.optimize

    def slope(share: float) -> float:
        trial = force + share * change
        return float(moved @ (trial - evaluate(trial)[1]))

    return float(scipy.optimize.brentq(slope, 0.0, 1.0, xtol=1e-6))
