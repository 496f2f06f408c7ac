"""The contact problem of one time step: a small dense one, in the forces on the pairs.

With the gaps that the step would reach without contact forces, g_free, and the compliance D of the
step, the gaps at its end are g = g_free - D lambda. A constraint asks for

    0 <= lambda,     g <= 0,     lambda^T g = 0,

a linear complementarity problem with the matrix D; the penalty law lambda = k max(g, 0) for the
same with D + diag(1/k) and g - lambda/k in place of g; any other law for lambda = lambda(g).

The first two are solved by the primal-dual active set method, a semismooth Newton method that ends
with the exact solution after few steps: pairs taken as closed have g = 0, the others lambda = 0;
pairs then pulled are opened, those that penetrate are closed. Where it cycles, the same solution is
the minimum of lambda^T D lambda / 2 - lambda^T g_free for lambda >= 0, a least-squares problem with
bounds, for which the method of Lawson and Hanson always ends.

Sources: Hintermueller, Ito and Kunisch, SIAM Journal on Optimization 13 (2002) 865; Lawson and
Hanson, Solving Least Squares Problems (1974), chapter 23.
"""

from __future__ import annotations

import numpy as np
import scipy.optimize

from fenics_crack.contact import ContactLaw, UnilateralConstraint, UnilateralPenalty
from fenics_crack.errors import ConvergenceError

__all__ = ["solve_complementarity", "solve_contact"]

ROUNDING = 1e-14
"""Gaps relative to the largest one that count as zero."""
MOST_ITERATIONS = 100


def solve_contact(
    contact: ContactLaw | UnilateralConstraint,
    compliance: np.ndarray,
    gap: np.ndarray,
    guess: np.ndarray,
) -> np.ndarray:
    """Forces on the pairs at the end of a step: (n_pairs,) [N].

    Parameters
    ----------
    contact : ContactLaw or UnilateralConstraint
        Law of all pairs.
    compliance : (n_pairs, n_pairs) [m/N]
        D, symmetric but for damping that couples, positive semidefinite.
    gap : (n_pairs,) [m]
        Gaps without contact forces, g_free.
    guess : (n_pairs,) [N]
        Forces to start from, those of the step before.

    Raises
    ------
    ConvergenceError
        No forces were found that satisfy the law.
    """
    if isinstance(contact, UnilateralConstraint):
        return solve_complementarity(compliance, gap, guess > 0.0)
    if isinstance(contact, UnilateralPenalty):
        softness = np.broadcast_to(1.0 / np.asarray(contact.stiffness), gap.shape)
        return solve_complementarity(compliance + np.diag(softness), gap, guess > 0.0)
    return _newton(contact, compliance, gap, guess)


def solve_complementarity(
    matrix: np.ndarray, gap: np.ndarray, closed: np.ndarray | None = None
) -> np.ndarray:
    """Find lambda with 0 <= lambda, D lambda - g >= 0, lambda^T (D lambda - g) = 0: (n,).

    Parameters
    ----------
    matrix : (n, n)
        D, positive semidefinite, and close to symmetric.
    gap : (n,)
        g.
    closed : (n,) bool, optional
        First guess of where lambda > 0; default: where g > 0.

    Raises
    ------
    ConvergenceError
        There is no solution, or it was not found.
    """
    allowed = ROUNDING * float(np.abs(gap).max(initial=0.0))
    closed = gap > 0.0 if closed is None else closed
    seen: set[bytes] = set()
    while closed.tobytes() not in seen and len(seen) < MOST_ITERATIONS:
        seen.add(closed.tobytes())
        force = np.zeros(len(gap))
        try:
            force[closed] = np.linalg.solve(matrix[np.ix_(closed, closed)], gap[closed])
        except np.linalg.LinAlgError:
            break
        now = np.where(closed, force > 0.0, matrix @ force - gap < -allowed)
        if np.array_equal(now, closed):
            return force
        closed = now
    return _by_least_squares(matrix, gap)


def _by_least_squares(matrix: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """The same by least squares with bounds; what of D is not symmetric follows by iteration."""
    symmetric = 0.5 * (matrix + matrix.T)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(symmetric), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(scale[:, None] * symmetric * scale)
    root = np.sqrt(np.maximum(values, 1e-15 * values.max(initial=0.0)))
    allowed = 1e-10 * float(np.abs(gap).max(initial=0.0))
    force = np.zeros(len(gap))
    for _ in range(MOST_ITERATIONS):
        target = scale * (gap - (matrix - symmetric) @ force)
        try:
            found, _ = scipy.optimize.nnls((vectors * root).T, (vectors.T @ target) / root)
        except RuntimeError:
            break
        force = scale * found
        opening = matrix @ force - gap
        if opening.min() >= -allowed and np.abs(opening[force > 0.0]).max(initial=0.0) <= allowed:
            return force
    raise ConvergenceError("contact: no set of closed pairs satisfies the constraints of the step")


def _newton(
    contact: ContactLaw, compliance: np.ndarray, gap: np.ndarray, guess: np.ndarray
) -> np.ndarray:
    """lambda = lambda(g_free - D lambda) by Newton's method.

    For a law that does not fall with the gap the solution is the minimum of a convex potential,
    whose slope along a step is used to shorten steps that go too far.
    """
    force = guess.copy()

    def excess(trial: np.ndarray) -> np.ndarray:
        return trial - contact.force(gap - compliance @ trial)

    for _ in range(MOST_ITERATIONS):
        tangent = contact.tangent(gap - compliance @ force)
        jacobian = np.eye(len(gap)) + tangent[:, None] * compliance
        try:
            change = np.linalg.solve(jacobian, -excess(force))
        except np.linalg.LinAlgError:
            break
        moved = compliance @ change
        size = np.abs(gap).max(initial=0.0) + np.abs(compliance @ force).max(initial=0.0)
        if not np.all(np.isfinite(change)):
            break
        if np.abs(moved).max(initial=0.0) <= 1e-13 * size:
            return force + change

        def slope(
            share: float,
            start: np.ndarray = force,
            change: np.ndarray = change,
            moved: np.ndarray = moved,
        ) -> float:
            return float(moved @ excess(start + share * change))

        share, before = 1.0, slope(0.0)
        if before < 0.0 and slope(1.0) > -0.1 * before:
            share = float(scipy.optimize.brentq(slope, 0.0, 1.0, xtol=1e-6))
        force = force + share * change
    raise ConvergenceError("contact: Newton's method for the forces of the step does not converge")
