"""The contact problem of one time step: a small dense one, in the forces on the pairs.

With the gaps that the step would reach without contact forces, g_free, and the compliance D of the
step, symmetric and positive definite, the gaps at its end are g = g_free - D lambda. A constraint
asks for

    0 <= lambda,     g <= 0,     lambda^T g = 0,

a linear complementarity problem. The kernel solves it by the primal-dual active set method, a
semismooth Newton method that ends with the exact solution after few steps: pairs taken as closed
have g = 0, the others lambda = 0; pairs then pulled are opened, those that penetrate are closed.
Where it cycles, one pair at a time is changed (``kernel/sets.h``). Where D is singular, the
solution is found as the minimum of lambda^T D lambda / 2 - lambda^T g_free for lambda >= 0, a
least-squares problem with bounds, for which the method of Lawson and Hanson is finite.

With forces that follow from the gap, lambda = h(g) pair by pair, Newton's method solves
lambda = h(g_free - D lambda).

Sources: Hintermueller, Ito and Kunisch, SIAM Journal on Optimization 13 (2002) 865; Lawson and
Hanson, Solving Least Squares Problems (1974), chapter 23.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fenics_crack.errors import ConvergenceError
from fenics_crack.kernel import NULL, doubles, kernel, owned, shaped, signs

__all__ = ["by_least_squares", "solve_complementarity", "solve_forces"]

ROUNDING = 1e-14
"""Gaps relative to the largest one that count as zero."""
MAX_ITERATIONS = 100
MAX_SETS = 8
"""Of closed pairs whose inverses are kept while one instant is solved."""


def solve_complementarity(
    matrix: np.ndarray, gap: np.ndarray, closed: np.ndarray | None = None
) -> np.ndarray:
    """Find lambda with 0 <= lambda, D lambda - g >= 0, lambda^T (D lambda - g) = 0: (n,).

    D is positive definite, and symmetric but for a small part; ``closed`` is a first guess of where
    lambda > 0. Raises ConvergenceError where there is no solution, or it was not found.
    """
    count = len(gap)
    matrix, gap = shaped(matrix, count, count), shaped(gap, count)
    contact = owned(kernel.new_sets(count, doubles(matrix), MAX_SETS), kernel.free_sets)
    guess = shaped(gap > 0.0 if closed is None else np.array(closed), count, kind=bool)
    force = np.empty(count)
    if not kernel.forces_at(contact, doubles(gap), ROUNDING, NULL, signs(guess), doubles(force)):
        return force
    return by_least_squares(matrix, gap)


def by_least_squares(matrix: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """The same by least squares with bounds; what of D is not symmetric follows by iteration."""
    import scipy.optimize  # takes a while, and is rarely needed

    symmetric = 0.5 * (matrix + matrix.T)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(symmetric), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(scale[:, None] * symmetric * scale)
    root = np.sqrt(np.maximum(values, 1e-15 * values.max(initial=0.0)))
    allowed = 1e-10 * float(np.abs(gap).max(initial=0.0))
    force = np.zeros(len(gap))
    for _ in range(MAX_ITERATIONS):
        target = (vectors.T @ (scale * (gap - (matrix - symmetric) @ force))) / root
        try:
            force = scale * scipy.optimize.nnls((vectors * root).T, target)[0]
        except RuntimeError:
            break
        opening = matrix @ force - gap
        if opening.min() >= -allowed and np.abs(opening[force > 0.0]).max(initial=0.0) <= allowed:
            return force
    raise ConvergenceError("contact: no set of closed pairs satisfies the step's constraints")


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
    for _ in range(MAX_ITERATIONS):
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
