"""Contact: laws, force from the closing g of a pair of face nodes (g > 0: penetration), and the
forces of all pairs at one instant.

A law is a function of the gap alone, pair by pair; the force enters the equation of motion on the
left, M u'' + C u' + K u + B lambda(g) = f, so lambda >= 0 pushes the crack faces apart. To add a
law, write a class with the four members of :class:`ContactLaw`.

What else a method requires of a law, :func:`is_unilateral`, :func:`is_rigid` and
:func:`is_piecewise_linear` return: no other module uses a law's class.

**All pairs at one instant**, coupled by a residual flexibility: what a basis of modes truncates of
a structure responds quasi-statically to contact forces, without mass,

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
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Protocol, Self, TypeGuard

import numpy as np

from fenics_crack.basics.errors import ConvergenceError, InputError
from fenics_crack.basics.threads import machine_memory
from fenics_crack.kernel import kernel, owned, pointer, shaped
from fenics_crack.model.matrices import numbers
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.equations import CENTRAL_DIFFERENCE_STEP, MACHINE_EPSILON, ROUNDING


class ContactLaw(Protocol):
    """Interface of every contact law."""

    @property
    def stiffness(self) -> float | np.ndarray:
        """Largest tangent, of a firmly closed pair: one for all pairs or (n_pairs,) [N/m]."""

    def force(self, gap: np.ndarray) -> np.ndarray:
        """lambda(g) for gaps (..., n_pairs) [m]: the same shape [N]."""

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """d lambda / d g for gaps (..., n_pairs) [m]: the same shape [N/m]."""

    def scaled(self, factor: float) -> Self:
        """Return the same law with its stiffness multiplied by a factor."""


@dataclass(frozen=True)
class _Penalty:
    """Common part of the laws with a penalty stiffness."""

    stiffness: float | np.ndarray

    def __post_init__(self) -> None:
        stiffness = _positive("contact stiffness", self.stiffness, each_pair=True)
        object.__setattr__(self, "stiffness", stiffness)

    def scaled(self, factor: float) -> Self:
        """The same law with factor * k."""
        return replace(self, stiffness=np.multiply(factor, self.stiffness))


@dataclass(frozen=True)
class UnilateralPenalty(_Penalty):
    """Penalty law: lambda = k g for g > 0, else 0 (paper, eq. 11).

    The tangent jumps from 0 to k where the pair closes; at g = 0 itself it is 0.

    Attributes
    ----------
    stiffness : float or (n_pairs,) [N/m]
        k, for all pairs or pair by pair.

    Raises
    ------
    InputError
        The stiffness is not positive and finite.
    """

    def force(self, gap: np.ndarray) -> np.ndarray:
        """lambda(g) [N]."""
        return self.stiffness * np.maximum(gap, 0.0)

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """d lambda / d g [N/m]."""
        return self.stiffness * (gap > 0.0)


@dataclass(frozen=True)
class SmoothedPenalty(_Penalty):
    """Smoothed penalty: lambda = k g (1/2 + arctan(s g) / pi) (paper, eq. 12, sign corrected).

    It tends to the penalty law as s grows, but not faster than 1/s: an open crack keeps feeling a
    pull of k / (pi s), and at the same distance into contact k / (pi s) is missing. Choose s so
    that this is small against the contact force.

    Attributes
    ----------
    stiffness : float or (n_pairs,) [N/m]
        k.
    sharpness : float [1/m]
        s.

    Raises
    ------
    InputError
        The stiffness or the sharpness is not positive and finite.
    """

    sharpness: float

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "sharpness", _positive("contact sharpness", self.sharpness))

    def force(self, gap: np.ndarray) -> np.ndarray:
        """lambda(g) [N]."""
        return self.stiffness * gap * (0.5 + np.arctan(self.sharpness * gap) / np.pi)

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """d lambda / d g = k (1/2 + arctan(s g)/pi + s g / (pi (1 + (s g)^2))) [N/m]."""
        x = self.sharpness * gap
        return self.stiffness * (0.5 + (np.arctan(x) + x / (1.0 + x * x)) / np.pi)


@dataclass(frozen=True)
class UnilateralConstraint:
    """No penetration at all: g <= 0, lambda >= 0, lambda g = 0 (Signorini).

    The limit of the penalty law for k to infinity. It gives no force from the gap alone. Where
    pairs have a residual flexibility (:class:`fenics_crack.Problem`) the force follows from the
    slow gap; else it is balanced in frequency, with the truncated series of gap and force,
    lambda = eps max(0, g + lambda / eps).

    Attributes
    ----------
    weight : float or None [N/m]
        eps > 0, for crack faces with mass; the truncated solution depends on it a little, and less
        the more harmonics there are. None: where one is needed, the inverse of the static
        compliance that the pairs see.
    """

    weight: float | None = None

    def __post_init__(self) -> None:
        if self.weight is not None:
            object.__setattr__(self, "weight", _positive("contact weight", self.weight))

    @property
    def stiffness(self) -> float:
        """Infinite."""
        return np.inf

    def force(self, gap: np.ndarray) -> np.ndarray:
        """Refused: it does not follow from the gap."""
        raise InputError("contact", self, "a law that gives the force from the gap")

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """Refused likewise."""
        return self.force(gap)

    def scaled(self, factor: float) -> UnilateralConstraint:
        """The same: nothing is stiffer."""
        return self


@dataclass(frozen=True)
class CoulombFriction:
    """Coulomb friction beside a law of normal contact, along a line for each pair.

        -mu lambda_n <= lambda_t <= mu lambda_n,      h' = 0 where <,      lambda_t h' >= 0 where =,

    with the tangential force lambda_t, on the left of the equation of motion as lambda_n, and h =
    g_t - lambda_t / k_t, the place of the slider in the tangential gap g_t: a pair that is closed
    sticks or slips. One coefficient holds at rest and in motion.

    Attributes
    ----------
    law : UnilateralPenalty or UnilateralConstraint
        Of normal contact.
    coefficient : float or (n_pairs,)
        mu.
    tangential_stiffness : float or (n_pairs,) [N/m]
        k_t; infinite: without elastic slip.
    direction : (n_pairs,) [rad] or None
        Of a solid, whose tangential gaps have two directions: angles of the lines along which pairs
        slide, from the first to the second direction (:func:`fenics_crack.slide_along_lines`).
    turning : float or None
        Sliding across these lines over that along them, of the motion that they were chosen for.

    Raises
    ------
    InputError
        The law is another one, or a number is not positive.
    """

    law: Any
    coefficient: float | np.ndarray
    tangential_stiffness: float | np.ndarray = np.inf
    direction: np.ndarray | None = None
    turning: float | None = None

    def __post_init__(self) -> None:
        if not is_unilateral(self.law):
            raise InputError("law", self.law, "UnilateralPenalty or UnilateralConstraint")
        mu = _positive("friction coefficient", self.coefficient, each_pair=True)
        object.__setattr__(self, "coefficient", mu)
        if not np.array_equal(self.tangential_stiffness, np.inf):
            stiffness = _positive("tangential stiffness", self.tangential_stiffness, each_pair=True)
            object.__setattr__(self, "tangential_stiffness", stiffness)

    @property
    def stiffness(self) -> float | np.ndarray:
        """Of the law of normal contact [N/m]."""
        return self.law.stiffness

    def force(self, gap: np.ndarray) -> np.ndarray:
        """lambda_n(g) [N]."""
        return np.asarray(self.law.force(gap))

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """d lambda_n / d g [N/m]."""
        return np.asarray(self.law.tangent(gap))

    def scaled(self, factor: float) -> CoulombFriction:
        """The same with factor * k and factor * k_t."""
        stiffness = np.multiply(factor, self.tangential_stiffness)
        return replace(self, law=self.law.scaled(factor), tangential_stiffness=stiffness)


def friction_of(contact: object) -> CoulombFriction | None:
    """The friction of a law; None without."""
    return contact if isinstance(contact, CoulombFriction) else None


def coefficient_of(contact: object) -> float | np.ndarray | None:
    """mu of a law; None without friction."""
    return getattr(friction_of(contact), "coefficient", None)


def normal_law(contact: ContactLaw) -> ContactLaw:
    """The law of normal contact alone."""
    return contact.law if isinstance(contact, CoulombFriction) else contact


def as_penalty(contact: ContactLaw, stiffness: float) -> ContactLaw:
    """The law with a penalty in the place of its normal contact [N/m]."""
    penalty = UnilateralPenalty(stiffness)
    return replace(contact, law=penalty) if isinstance(contact, CoulombFriction) else penalty


def seen_by(contact: object, structure: Structure) -> Structure:
    """The structure with all gaps on which a law acts as its pairs: with friction the normal ones,
    and behind them the tangential ones."""
    friction = friction_of(contact)
    return structure if friction is None else structure.with_tangential_pairs(friction.direction)


def springs_of(contact: ContactLaw, pairs: int) -> np.ndarray:
    """1/k of the pairs, with friction behind it 1/k_t: (n_pairs,) or (2 n_pairs,) [m/N]."""
    friction, ones = friction_of(contact), np.ones(pairs)
    found = ones / np.asarray(contact.stiffness, dtype=float)
    if friction is None:
        return found
    return np.concatenate([found, ones / np.asarray(friction.tangential_stiffness, dtype=float)])


@lru_cache
def gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss's nodes between 0 and 1, and their weights: for means of forces between two gaps."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 + 0.5 * nodes, 0.5 * weights


def potential(contact: ContactLaw, gap: np.ndarray) -> np.ndarray:
    """V(g), the integral of lambda from 0, by Gauss's rule: (..., n_pairs) [J]."""
    nodes, weights = gauss(32)
    forces = contact.force(np.multiply.outer(nodes, gap))
    return np.asarray(gap * np.tensordot(weights, forces, 1))


def is_rigid(contact: object) -> TypeGuard[UnilateralConstraint]:
    """Return True if no force follows from the gap: :class:`UnilateralConstraint`."""
    return isinstance(getattr(contact, "law", contact), UnilateralConstraint)


def is_piecewise_linear(contact: object) -> TypeGuard[UnilateralPenalty]:
    """Return True if lambda = k max(0, g), linear between switching instants: the penalty law."""
    return isinstance(getattr(contact, "law", contact), UnilateralPenalty)


def is_unilateral(contact: object) -> bool:
    """Return True if a pair is open or closed and nothing between, as exact integrals and flows
    require: the penalty law, or the constraint."""
    return is_piecewise_linear(contact) or is_rigid(contact)


def check_law(structure: Structure, contact: Any, *, rigid: bool = False) -> None:
    """Raise InputError unless an object is a contact law for a structure's pairs.

    :class:`UnilateralConstraint` is one only with ``rigid``.
    """
    members = ("stiffness", "force", "tangent", "scaled")
    is_class = isinstance(contact, type)
    absent_members = [name for name in members if is_class or not hasattr(contact, name)]
    if absent_members or (is_rigid(contact) and not rigid):
        lacks = f", with {', '.join(absent_members)}, which it lacks" if absent_members else ""
        raise InputError("contact", contact, f"a contact law such as UnilateralPenalty(1e9){lacks}")
    stiffness = np.asarray(contact.stiffness, dtype=np.float64)
    if stiffness.shape not in ((), (structure.n_pairs,)):
        allowed = f"one number or {structure.n_pairs}, one per pair"
        raise InputError("contact stiffness", stiffness.shape, allowed)
    if not is_rigid(contact) and not np.all(np.isfinite(stiffness)):
        raise InputError("contact stiffness", contact, "finite")
    if not is_unilateral(contact):
        _check_returned(contact, structure.n_pairs)


def _check_returned(law: ContactLaw, pairs: int) -> None:
    """Raise InputError unless a user's law returns valid values for gaps (n, n_pairs)."""
    gap, kind = (
        np.outer([-MACHINE_EPSILON, 0.0, MACHINE_EPSILON], np.ones(pairs)),
        type(law).__name__,
    )
    for name in ("force", "tangent"):
        try:
            found = numbers(getattr(law, name)(gap))
        except (ArithmeticError, TypeError, ValueError, IndexError):
            found = np.asarray(np.nan)
        if found.shape != gap.shape or not np.all(np.isfinite(found)):
            allowed = f"a law with a finite {name}(gap) for each gap, (n, n_pairs)"
            raise InputError("contact", kind, allowed)
    if np.any(found < -MACHINE_EPSILON * np.abs(found).max(initial=0.0)):
        raise InputError("contact", kind, "a law with tangent(gap) >= 0, a stiffness in N/m")
    try:
        softer = law.scaled(0.5)
        same = isinstance(softer, type(law)) and np.allclose(
            numbers(softer.stiffness), 0.5 * numbers(law.stiffness), atol=0.0
        )
    except (ArithmeticError, TypeError, ValueError):
        same = False
    if not same:
        allowed = "a law whose scaled(factor) is a law of its kind, factor times as stiff"
        raise InputError("contact", kind, allowed)


def check_slope(law: ContactLaw, gap: np.ndarray) -> None:
    """Raise InputError unless the tangent of a law is the slope of its force along gaps (n,
    n_pairs), at kinks one between those on both sides."""
    step = CENTRAL_DIFFERENCE_STEP * float(np.abs(gap).max(initial=0.0))
    values = [np.asarray(law.force(gap + side * step)) for side in (-2.0, -1.0, 0.0, 1.0, 2.0)]
    rises, stated = np.diff(values, axis=0), step * law.tangent(gap)
    sizes = np.maximum(np.abs(rises).max(axis=0), np.abs(stated))
    off = np.maximum(rises[1:3].min(axis=0) - stated, stated - rises[1:3].max(axis=0))
    # Rises beside these differ from them by rounding, and where the slope bends within a step. Half
    # of the digits that differences leave may be wrong.
    unsure = float(np.abs(rises[[0, 3]] - rises[[1, 2]]).max(initial=0.0))
    if np.any(off > np.sqrt(CENTRAL_DIFFERENCE_STEP) * sizes + unsure):
        allowed = "a law whose tangent(gap) is the slope of its force(gap)"
        raise InputError("contact", type(law).__name__, allowed)


def _positive(key: str, value: object, *, each_pair: bool = False) -> float | np.ndarray:
    """A number > 0, or an array of them, one per pair; else InputError."""
    found = numbers(value)
    positive = found.size > 0 and np.all(np.isfinite(found) & (found > 0.0))
    if isinstance(value, str | bool) or found.ndim > each_pair or not positive:
        allowed = "a finite number > 0" + (", or one per pair" if each_pair else "")
        raise InputError(key, value, allowed)
    return found.copy() if found.ndim else float(found)


class FrictionSets:
    """Contact with friction at instants under a compliance D of normals, then tangents; what is
    known of the states of the pairs is kept.

    Attributes
    ----------
    compliance : (2 n_pairs, 2 n_pairs) [m/N]
        D = R_inf + diag(1/k, 1/k_t).
    """

    def __init__(self, compliance: np.ndarray, coefficient: float | np.ndarray) -> None:
        rows = len(compliance)
        self.compliance = compliance = shaped(compliance, rows, rows)
        mu = np.ascontiguousarray(np.broadcast_to(coefficient, rows // 2), dtype=float)
        self._held = np.zeros((rows, 1)), compliance, mu  # which the kernel does not copy all
        most = int(KEPT * machine_memory()) // 8
        made = kernel.new_closed_sets(1, rows // 2, *map(pointer, self._held), most)
        self.handle = owned(made, kernel.free_closed_sets)
        """The kernel's own object."""

    def solve(
        self, gap: np.ndarray, places: np.ndarray, turns: int = 1
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return forces [N], states and places [m] at instants, and origins (n_pairs,) of places.

        Of gaps (n, 2 n_pairs) [m] at instants that follow each other, from the places (n_pairs,)
        before; of the last turn, in which the places repeat or which is the last of so many. The
        origin is the instant at which a pair did not stick last, or 0.

        Raises ConvergenceError where an instant has no forces, or more than one solution.
        """
        count, rows = gap.shape
        gap, held = shaped(gap, count, rows), np.array(places, dtype=float)
        forces, found = np.empty_like(gap), np.empty((count, rows // 2))
        states, origins = np.empty(found.shape, dtype=np.int8), np.empty(rows // 2, dtype=np.intc)
        arrays = map(pointer, (gap, held, forces, states, found, origins))
        if kernel.march_friction(self.handle, count, turns, *arrays):
            raise ConvergenceError("contact: an instant has no forces, or more than one solution")
        return forces, states, found, origins


KEPT = 1 / 32
"""Fraction of the machine's memory for the sets of closed pairs of one compliance, or of one flow:
some of them may be in each of several processes. A set that is found anew takes the time of five
pieces of a motion."""
MAX_NEWTON_SMOOTH = 200
"""Maximum iterations for forces that are not piecewise linear in the gaps."""
REGULAR: float = kernel.REGULAR
"""Smallest eigenvalue of R_inf, relative to the largest, with which a constraint is solved; the
softness of a penalty that stands for one."""


def is_regular(matrix: np.ndarray) -> bool:
    """Return True if a symmetric matrix is positive definite, and not badly scaled."""
    values = np.linalg.eigvalsh(matrix)
    return not len(values) or bool(values[0] > REGULAR * values[-1] > 0.0)


class ActiveSets:
    """Contact at instants under a compliance D; inverses on sets of closed pairs are kept.

    Attributes
    ----------
    compliance : (n_pairs, n_pairs) [m/N]
        D = R_inf + I/k.
    """

    def __init__(self, compliance: np.ndarray) -> None:
        self.compliance = compliance = shaped(compliance, len(compliance), len(compliance))
        most = int(KEPT * machine_memory()) // max(compliance.nbytes, 8)
        count = len(compliance)
        self.handle = owned(kernel.new_sets(count, pointer(compliance), most), kernel.free_sets)
        """The kernel's own object."""

    def stack(self, sets: np.ndarray) -> np.ndarray:
        """(D_AA)^-1 with zeros outside A, of sets (m, n_pairs): (m, n_pairs, n_pairs) [N/m]."""
        closed = shaped(sets, len(sets), len(self.compliance), kind=bool)
        found = np.empty((*closed.shape, closed.shape[1]))
        if kernel.inverses_of(self.handle, len(closed), pointer(closed), pointer(found)):
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
            self.handle, len(gap), pointer(gap), pointer(closed), pointer(force), pointer(failed)
        )
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
    return np.asarray(ActiveSets(matrix).solve(shaped(gap, len(matrix))[None], guess)[0][0])


def by_least_squares(matrix: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """The same by least squares with bounds; what of D is not symmetric follows by iteration."""
    import scipy.optimize  # takes a while, and is rarely needed

    symmetric = 0.5 * (matrix + matrix.T)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(symmetric), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(scale[:, None] * symmetric * scale)
    root = np.sqrt(np.maximum(values, 1e-15 * values.max(initial=0.0)))
    allowed = 1e-10 * float(np.abs(gap).max(initial=0.0))
    force = np.zeros(len(gap))
    for _ in range(MAX_NEWTON_SMOOTH):
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
    for _ in range(MAX_NEWTON_SMOOTH):
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
        flat = -0.1 * np.sum(moved * excess[more], axis=1)
        reached, answer, tangent = evaluate(found[left], given)
        slope = np.sum(moved * (found[left] - answer), axis=1)
        too_far = (flat > 0.0) & (slope > flat)
        if np.any(too_far):
            rows, start = left[too_far], force[too_far]
            step = found[rows] - start
            share = _lowest(evaluate, start, step, given[too_far], flat[too_far])
            found[rows] = start + share[:, None] * step
            reached, answer, tangent = evaluate(found[left], given)
    raise ConvergenceError("contact: Newton's method for the forces of a step does not converge")


def _lowest(
    evaluate: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, ...]],
    force: np.ndarray,
    step: np.ndarray,
    gap: np.ndarray,
    flat: np.ndarray,
) -> np.ndarray:
    """Shares of steps (n, n_pairs) where the convex functions are lowest along them, by bisection
    of their slopes until these are flat (n,): (n,)."""
    moved = evaluate(force, gap)[0] - evaluate(force + step, gap)[0]  # D times the step
    share, size = np.full(len(force), 0.5), 0.5
    while size > MACHINE_EPSILON:
        trial = force + share[:, None] * step
        slope = np.sum(moved * (trial - evaluate(trial, gap)[1]), axis=1)
        steep = np.abs(slope) > flat
        if not np.any(steep):
            break
        size *= 0.5
        share -= np.where(steep, np.copysign(size, slope), 0.0)
    return share
