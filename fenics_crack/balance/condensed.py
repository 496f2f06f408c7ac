"""Harmonic balance condensed onto the crack: the gap's harmonics are the only unknowns.

    F(g) = g - g_lin + R b(g) = 0

with the compliance R of :mod:`compliance`, block diagonal in the harmonics, and the coefficients b
of the contact force from :mod:`contact_integrals`, block diagonal in the pairs. The same equation
as the full block system's, multiplied by B^T A^-1: both have the same solutions. Without
penetration at all (:class:`UnilateralConstraint`) the unknowns are y = lambda / eps, and with
s = g_lin + y - eps R y,

    F(y) = y - P(s) = 0,       P(s): coefficients of max(s, 0),

the projection form of lambda >= 0, g <= 0, lambda g = 0 balanced in frequency (dynamic Lagrangian;
Nacivet, Pierre, Thouverez, Jezequel, Journal of Sound and Vibration 265, 2003, 201-219).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.compiled import CompiledSystem, ModalPart
from fenics_crack.balance.compliance import Compliance, WidenedCompliance
from fenics_crack.balance.contact_integrals import ContactIntegrals, ExactIntegrals, apply_to_pairs
from fenics_crack.balance.rounding import stiffness_times_compliance
from fenics_crack.errors import InputError
from fenics_crack.kernel import doubles, ints, kernel, shaped
from fenics_crack.model.contact import ContactLaw, UnilateralPenalty
from fenics_crack.numerics.linearisation import DenseLinearisation, factored, solve_factored

__all__ = [
    "CondensedEquations",
    "CondensedPoint",
    "CondensedSystem",
    "ConstraintSystem",
    "default_weight",
    "respond",
    "respond_to_columns",
]

LOW_RANK, ROUGHLY = 400, 200
"""Unknowns from which solutions go through the rank of the contact's tangent, and those to the
accuracy of an error estimate."""
ROUGH = 1e-4
"""That accuracy."""
IN_KERNEL = 2000
"""Unknowns up to which the kernel follows paths: their Jacobian is dense there, but many points
share its factors."""


def respond(matrices: np.ndarray, force: np.ndarray) -> np.ndarray:
    """R lambda of coefficients (2H+1, n_pairs)."""
    rows, pairs = force.shape
    matrices = shaped(matrices, rows // 2 + 1, pairs, pairs, kind=complex)
    force, found = shaped(force, 2 * (rows // 2) + 1, pairs), np.empty((rows, pairs))
    kernel.respond(rows // 2, pairs, doubles(matrices), doubles(force), doubles(found))
    return found


def respond_to_columns(matrices: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """R T as a dense matrix for unknowns ordered (row, pair), from R_k (..., H+1, n_pairs, n_pairs)
    and T (..., n_pairs, 2H+1, n), at many points at once: (..., (2H+1) n_pairs, n n_pairs).

    A force a - i b on harmonic k moves the gap by R_k (a - i b), that is by the real matrix
    [[Re R_k, Im R_k], [-Im R_k, Re R_k]] on (a, b).
    """
    *points, pairs, rows, columns = tangent.shape
    of_each = (*points, rows // 2 + 1, pairs, pairs)
    matrices = shaped(np.broadcast_to(matrices, of_each), *of_each, kind=complex)
    tangent = shaped(tangent, *points, pairs, 2 * (rows // 2) + 1, columns)
    product = np.empty((*points, rows * pairs, columns * pairs))
    for at in np.ndindex(*points):
        kernel.respond_to_columns(
            rows // 2, pairs, columns, doubles(matrices[at]), doubles(tangent[at]),
            doubles(product[at]),
        )  # fmt: skip
    return product


class CondensedPoint(DenseLinearisation, ABC):
    """Condensed equations at a point, and what changes of them do to the gap."""

    system: CondensedSystem | ConstraintSystem
    tangent: np.ndarray
    """T, derivative of the contact integrals: (n_pairs, 2H+1, 2H+1)."""
    gap: np.ndarray
    """Coefficients (2H+1, n_pairs) [m]."""
    force: np.ndarray
    """Coefficients of the contact force, (2H+1, n_pairs) [N]."""

    @abstractmethod
    def gap_of(self, change: np.ndarray) -> np.ndarray:
        """Change of the gap that belongs to a change of the unknowns."""

    @abstractmethod
    def force_of(self, change: np.ndarray) -> np.ndarray:
        """Change of the contact force that belongs to a change of the unknowns."""

    @abstractmethod
    def gap_by_force(self, change: np.ndarray) -> np.ndarray:
        """Change of the gap if the contact force were changed."""

    @abstractmethod
    def gap_by_linear_gap(self, change: np.ndarray) -> np.ndarray:
        """Change of the gap if that without contact, g_lin, were changed."""

    def solve_roughly(self, right: np.ndarray) -> np.ndarray:
        """J^-1 r to the accuracy of an error estimate."""
        return self.solve(right)


class CondensedEquations:
    """What condensed systems share: they are small, and the same on every rank."""

    comm, matrix_free = MPI.COMM_SELF, False

    def __init__(self, compliance: Compliance) -> None:
        self.compliance = compliance
        self.linear = compliance.linear_gap
        """g_lin: (2H+1, n_pairs) [m]."""
        self.shape: tuple[int, ...] = self.linear.shape
        self.global_size = self.linear.size

    def inner(self, first: np.ndarray, second: np.ndarray) -> float:
        """Inner product."""
        return float(np.vdot(first, second))


class CondensedSystem(CondensedEquations):
    """F(g) = g - g_lin + R b(g) for a law that gives the force from the gap.

    Its parameter is p = ln(k / k of the law), the contact stiffness.
    """

    def __init__(self, compliance: Compliance, integrals: ContactIntegrals) -> None:
        super().__init__(compliance)
        self.integrals, self.moving = integrals, compliance.matrices

    def linearise(self, gap: np.ndarray, parameter: float = 0.0) -> _GapPoint:
        """The equations at a gap and a stiffness; J = I + R T, dF/dp = R b."""
        integrals = self.integrals
        if parameter != 0.0:
            integrals = integrals.of_law(integrals.law.scaled(float(np.exp(parameter))))
        matrices = self.compliance.matrices
        return _GapPoint(self, gap, integrals, lambda at: respond(matrices, at.force))

    def along(
        self, gap: np.ndarray, by_parameter: Callable[[CondensedPoint], np.ndarray]
    ) -> _GapPoint:
        """The equations at a gap, with the derivative by another parameter."""
        return _GapPoint(self, gap, self.integrals, by_parameter)

    def with_compliance(self, compliance: Compliance) -> CondensedSystem:
        """The same with another compliance."""
        return CondensedSystem(compliance, self.integrals)

    def widened(self, harmonics: int) -> CondensedSystem:
        """The same equations with more harmonics, to the accuracy of an error estimate."""
        compliance = WidenedCompliance(self.compliance, harmonics)
        return CondensedSystem(compliance, self.integrals.widened(harmonics))

    @property
    def stiffness(self) -> np.ndarray:
        """Of the pairs: (n_pairs,) [N/m]."""
        found = np.asarray(self.integrals.law.stiffness, dtype=float)
        return np.broadcast_to(found, self.linear.shape[1:])

    def steepest_force(self, law: ContactLaw) -> float:
        """Largest slope of the contact forces."""
        return float(np.max(law.stiffness))

    @property
    def in_kernel(self) -> bool:
        """Whether the kernel has these equations: with this law, and unless they are too many."""
        return isinstance(self.integrals, ExactIntegrals) and self.global_size <= IN_KERNEL

    @cached_property
    def compiled(self) -> CompiledSystem | None:
        """The same along its parameter in the kernel, where it has them."""
        return self.compile(self.linear, self.moving, growth=1.0) if self.in_kernel else None

    def compile(
        self, linear: np.ndarray, compliance: np.ndarray | ModalPart, **along: Any
    ) -> CompiledSystem:
        """The kernel's equations of these pairs."""
        return CompiledSystem(self.stiffness, linear, compliance, **along)


class _GapPoint(CondensedPoint):
    """:class:`CondensedSystem` at a gap."""

    def __init__(
        self,
        system: CondensedSystem,
        gap: np.ndarray,
        integrals: ContactIntegrals,
        by_parameter: Callable[[CondensedPoint], np.ndarray],
    ) -> None:
        self.system, self.gap, self._derivative = system, gap, by_parameter
        self._law = integrals.law
        self._low_rank: _LowRank | None = None
        self._rough: tuple[_LowRank, tuple[np.ndarray, np.ndarray]] | None = None
        self.force, self.tangent = integrals.linearise(gap)
        residual = gap - system.linear + respond(system.compliance.matrices, self.force)
        super().__init__(gap, residual)

    def assemble(self) -> np.ndarray:
        jacobian = respond_to_columns(self.system.compliance.matrices, self.tangent)
        jacobian.flat[:: len(jacobian) + 1] += 1.0
        return jacobian

    def condense(self) -> np.ndarray:
        if self.unknown.size >= LOW_RANK:
            found = _LowRank(self.tangent)
            if found.complete:
                self._low_rank = found
                return found.condense(self.system.compliance.matrices)
        return super().condense()

    def solve(self, right: np.ndarray) -> np.ndarray:
        factors = self._factors
        if self._low_rank is None:
            return super().solve(right)
        matrices = self.system.compliance.matrices
        return self._low_rank.solve(right, matrices, lambda drive: solve_factored(factors, drive))

    def solve_roughly(self, right: np.ndarray) -> np.ndarray:
        """What is left out of T counts k R times."""
        if self._lu is not None or self.unknown.size < ROUGHLY:
            return self.solve(right)
        matrices = self.system.compliance.matrices
        if self._rough is None:
            product = stiffness_times_compliance(self.system.compliance, self._law)
            part = _LowRank(self.tangent, ROUGH / max(1.0 / ROUGH, product))
            if not part.complete:
                return self.solve(right)
            self._rough = part, factored(part.condense(matrices))
        part, factors = self._rough
        return part.solve(right, matrices, lambda drive: solve_factored(factors, drive))

    def differentiate(self) -> np.ndarray:
        return self._derivative(self)

    def gap_of(self, change: np.ndarray) -> np.ndarray:
        return change

    def force_of(self, change: np.ndarray) -> np.ndarray:
        return apply_to_pairs(self.tangent, change)

    def gap_by_force(self, change: np.ndarray) -> np.ndarray:
        return self.gap_by_linear_gap(-respond(self.system.compliance.matrices, change))

    def gap_by_linear_gap(self, change: np.ndarray) -> np.ndarray:
        return self.solve(change)


class _LowRank:
    """T = P Q of pairs that are closed for a part of the period only, and with it

        (I + R P Q)^-1 r = r - R P (I + Q R P)^-1 Q r,       det(I + R P Q) = det(I + Q R P).

    kappa >= 0 makes each pair's T symmetric and positive semidefinite where the mean counts
    sqrt(2) times: E T E^-1 = C C^T, P = E^-1 C, Q = C^T E, C by Cholesky's method with pivots, of
    which those below ``tolerance`` times the first are left out.

    Attributes
    ----------
    complete : bool
        Whether P Q is all of T: not so for a law whose force falls where the gap grows.
    """

    def __init__(self, tangent: np.ndarray, tolerance: float = 0.0) -> None:
        pairs, count, _ = tangent.shape
        tangent = shaped(tangent, pairs, 2 * (count // 2) + 1, count)
        self._ranks, room = np.zeros(pairs, np.intc), np.empty((pairs + 1, count, count))
        least = max(tolerance, count * float(np.finfo(float).eps))
        rank = kernel.tangent_rows(
            count // 2, pairs, doubles(tangent), least,
            count * max(least, 1e-12), ints(self._ranks), doubles(room[:pairs]),
            doubles(room[pairs]),
        )  # fmt: skip
        self.complete = rank >= 0
        self._rows = room.reshape(-1, count)[: max(rank, 0)]  # C^T
        self._pairs = np.repeat(np.arange(pairs), self._ranks if self.complete else 0)

    def condense(self, matrices: np.ndarray) -> np.ndarray:
        """I + Q R P; 1 where all pairs are open, for LAPACK takes no empty matrix."""
        if not len(self._rows):
            return np.eye(1)
        columns, found = np.ascontiguousarray(self._rows.T), np.empty((len(self._rows),) * 2)
        of_each = (len(columns) // 2 + 1, len(self._ranks), len(self._ranks))
        kernel.small_matrix(
            len(columns) // 2, len(self._ranks), ints(self._ranks), doubles(self._rows),
            doubles(columns), doubles(shaped(matrices, *of_each, kind=complex)),
            doubles(np.empty_like(columns)), doubles(found),
        )  # fmt: skip
        return found

    def solve(
        self, right: np.ndarray, matrices: np.ndarray, solve: Callable[[np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """J^-1 r of (2H+1, n_pairs), with solutions of the condensed matrix."""
        if not len(self._rows):
            return right
        weight = np.ones(len(right))
        weight[0] = np.sqrt(2.0)
        drive = np.einsum("ji,ji->j", self._rows, (weight * right.T)[self._pairs])
        moved, used = solve(drive)[:, None] * self._rows, self._ranks > 0
        force = np.zeros_like(right.T)
        force[used] = np.add.reduceat(moved, (np.cumsum(self._ranks) - self._ranks)[used])
        return right - respond(matrices, np.ascontiguousarray((force / weight).T))


def default_weight(compliance: Compliance) -> float:
    """Inverse of the static compliance: the stiffness that the pairs see [N/m]."""
    largest = float(np.abs(compliance.matrices[0]).sum(axis=1).max())
    if not largest > 0.0:
        raise InputError("structure", "static compliance 0", "one whose pairs can move")
    return 1.0 / largest


class ConstraintSystem(CondensedEquations):
    """F(y) = y - P(g_lin + t y - eps R y): no penetration, in the frequency-time sense.

    Its parameter is t: a penalty of stiffness eps (0), the constraint (1). Truncated solutions
    depend a little on ``weight`` = eps [N/m], less the more harmonics there are.
    """

    def __init__(self, compliance: Compliance, harmonics: int, weight: float) -> None:
        super().__init__(compliance)
        self.integrals = ExactIntegrals(UnilateralPenalty(1.0), harmonics)
        self.weight = weight

    def linearise(self, unknown: np.ndarray, parameter: float = 1.0) -> _ConstraintPoint:
        """The equations at an unknown; J = I - T (t I - eps R), dF/dt = -T y."""
        return _ConstraintPoint(self, unknown, parameter)

    def from_force(self, force: np.ndarray) -> np.ndarray:
        """The unknown that stands for a contact force."""
        return force / self.weight

    def widened(self, harmonics: int) -> ConstraintSystem:
        """As :meth:`CondensedSystem.widened`."""
        compliance = WidenedCompliance(self.compliance, harmonics)
        return ConstraintSystem(compliance, harmonics, self.weight)


class _ConstraintPoint(CondensedPoint):
    """:class:`ConstraintSystem` at an unknown y, s = g_lin + t y - eps R y."""

    system: ConstraintSystem

    def __init__(self, system: ConstraintSystem, unknown: np.ndarray, share: float) -> None:
        self.system, self._share = system, share
        self.force = system.weight * unknown
        self.gap = system.linear - respond(system.compliance.matrices, self.force)
        projected, self.tangent = system.integrals.linearise(self.gap + share * unknown)
        super().__init__(unknown, unknown - projected)

    def assemble(self) -> np.ndarray:
        """I - T (t I - eps R), with T R = (R^T T^T)^T."""
        rows, pairs = self.unknown.shape
        conjugate = self.system.compliance.matrices.conj()  # R^T in its real form
        jacobian = respond_to_columns(conjugate, self.tangent.transpose(0, 2, 1)).T
        jacobian *= self.system.weight
        blocks = jacobian.reshape(rows, pairs, rows, pairs)
        for pair, tangent in enumerate(self.tangent):
            blocks[:, pair, :, pair] -= self._share * tangent
        jacobian.flat[:: len(jacobian) + 1] += 1.0
        return jacobian

    def differentiate(self) -> np.ndarray:
        return -apply_to_pairs(self.tangent, self.unknown)

    def gap_of(self, change: np.ndarray) -> np.ndarray:
        return -respond(self.system.compliance.matrices, self.force_of(change))

    def force_of(self, change: np.ndarray) -> np.ndarray:
        return self.system.weight * change

    def gap_by_force(self, change: np.ndarray) -> np.ndarray:
        return self.gap_of(self.solve(change / self.system.weight))

    def gap_by_linear_gap(self, change: np.ndarray) -> np.ndarray:
        return change + self.gap_of(self.solve(apply_to_pairs(self.tangent, change)))
