"""Harmonic balance of contact seen through a static compliance: the gap s of the slow modes.

With R_inf the static compliance of what answers contact forces at once
(:mod:`fenics_crack.model.coupled`) the gap is g = s - R_inf lambda(s), and

    F(s) = s - g_lin + (R_k - R_inf) b_k(lambda(s)) = 0,       J = I + (R - R_inf) T.

R_k - R_inf falls like k^-2: s is smooth, and only s is truncated; g keeps its kinks. The slope of
lambda(s) is bounded by the inverse of R_inf, however stiff the contact: the penalty law and the
constraint are one law, with a stiffness or without.

Where modes are fewer than pairs, R_k - R_inf = U R'_k U^T with an orthonormal basis U of the gaps
that modes can make, and steps are found in its coordinates:

    J^-1 r = r - U (I + R' U^T T U)^-1 R' U^T T r,       det J = det(I + R' U^T T U).

With many unknowns J is not formed: J v costs two FFTs (:mod:`coupled_integrals`), and GMRES needs
some dozens of them.

Sources: Monjaraz-Tec, Gross and Krack, arXiv 2111.07693 and 2207.00795 (in time), 2603.26446 (in
frequency).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from fenics_crack.balance.compiled import SHARP, CompiledCoupled, ModalPart
from fenics_crack.balance.compliance import Compliance, WidenedCompliance
from fenics_crack.balance.condensed import CondensedEquations, CondensedPoint, respond
from fenics_crack.balance.coupled_integrals import CoupledIntegrals, CoupledTangent
from fenics_crack.model.contact import ContactLaw
from fenics_crack.numerics.krylov import gmres
from fenics_crack.numerics.linearisation import solve_factored

__all__ = ["MATRIX_FREE", "CoupledPoint", "CoupledSystem"]

MATRIX_FREE, PRODUCTS = 350, 225
"""The Jacobian is not formed for n unknowns of a step where n^3 is larger than 350^3, what GMRES
costs in any case, and 225 (2H+1) n_pairs^2 for its products. Both ways take equally long with about
300 to 350 unknowns of 18 pairs (measured with H = 8 to 40), and with 600 of 30 modes and 100 pairs.
"""
ROUGH = 1e-2
"""Relative residual of GMRES in an estimate."""


class CoupledSystem(CondensedEquations):
    """F(s) = s - g_lin + (R_k - R_inf) b(lambda(s)).

    Its parameter is the softness in series with the pairs, ``softness`` |1 - p|^3: 0 at p = 1.
    """

    def __init__(
        self, compliance: Compliance, integrals: CoupledIntegrals, softness: float = 0.0
    ) -> None:
        super().__init__(compliance)
        self.integrals, self._softness = integrals, softness
        self.residual = integrals.residual
        """R_inf [m/N]."""
        self.moving = compliance.matrices - self.residual
        """R_k - R_inf."""
        self.basis = compliance.basis
        """U, None where modes are as many as pairs."""
        rows, pairs = self.linear.shape
        size = rows * (pairs if self.basis is None else self.basis.shape[1])
        self.matrix_free = size**3 > MATRIX_FREE**3 + PRODUCTS * rows * pairs**2

    @property
    def in_kernel(self) -> bool:
        """Whether the kernel has these equations: with exact integrals."""
        return self.integrals.exact

    @cached_property
    def compiled(self) -> CompiledCoupled | None:
        """The same along its parameter in the kernel, where it has them."""
        if not self.in_kernel:
            return None
        softness = self._softness * self.integrals.unit
        return self.compile(self.linear, self.moving, softness=softness)

    def compile(
        self, linear: np.ndarray, compliance: np.ndarray | ModalPart, **along: Any
    ) -> CompiledCoupled:
        """The kernel's equations of these pairs."""
        springs = np.broadcast_to(1.0 / np.asarray(self.integrals.law.stiffness), self.shape[1:])
        return CompiledCoupled(
            self.residual, springs, self.basis, linear, compliance,
            formed=not self.matrix_free, **along,
        )  # fmt: skip

    @cached_property
    def moving_seen(self) -> np.ndarray:
        """R'_k = U^T (R_k - R_inf) U."""
        assert self.basis is not None
        found: np.ndarray = self.basis.T @ self.moving @ self.basis
        return found

    def linearise(self, unknown: np.ndarray, parameter: float = 1.0) -> CoupledPoint:
        """The equations at s, with a softness in series."""
        integrals = self.integrals.with_softness(self._softness * abs(1.0 - parameter) ** 3)

        def by_parameter(at: CoupledPoint) -> np.ndarray:
            rate = -3.0 * self._softness * (1.0 - parameter) * abs(1.0 - parameter)
            return respond(self.moving, rate * at.forces.by_softness())

        return CoupledPoint(self, unknown, integrals, by_parameter)

    def along(
        self, unknown: np.ndarray, by_parameter: Callable[[CoupledPoint], np.ndarray]
    ) -> CoupledPoint:
        """The equations at s, with the derivative by another parameter."""
        return CoupledPoint(self, unknown, self.integrals, by_parameter)

    @property
    def enough(self) -> float:
        """Softness with which pairs hardly touch each other: the compliance is larger than that of
        what moves."""
        largest = float(np.abs(self.moving).sum(axis=2).max())
        return largest / (0.5 * self.integrals.unit)

    def steepness(self, law: ContactLaw) -> float:
        """Largest slope of (R_k - R_inf) lambda(s) by s, for a stiffness of the pairs."""
        return float(np.abs(self.moving).sum(axis=2).max()) * self.steepest_force(law)

    def steepest_force(self, law: ContactLaw) -> float:
        """Largest slope of lambda(s), the inverse of the smallest eigenvalue of R_inf + I/k."""
        softness = 1.0 / np.broadcast_to(np.asarray(law.stiffness, dtype=float), self.shape[1:])
        least = float(np.linalg.eigvalsh(self.residual + np.diag(softness))[0])
        return 1.0 / max(least, float(softness.min()), 1e-300)

    def softened(self, softness: float) -> CoupledSystem:
        """The same equations, whose parameter starts at another softness."""
        return CoupledSystem(self.compliance, self.integrals, softness)

    def with_compliance(self, compliance: Compliance) -> CoupledSystem:
        """The same with another compliance."""
        return CoupledSystem(compliance, self.integrals, self._softness)

    def widened(self, harmonics: int) -> CoupledSystem:
        """The same equations with more harmonics, to the accuracy of an error estimate."""
        compliance = WidenedCompliance(self.compliance, harmonics)
        return CoupledSystem(compliance, self.integrals.widened(harmonics))


class CoupledPoint(CondensedPoint):
    """:class:`CoupledSystem` at s."""

    system: CoupledSystem  # type: ignore[assignment]

    def __init__(
        self,
        system: CoupledSystem,
        unknown: np.ndarray,
        integrals: CoupledIntegrals,
        by_parameter: Callable[[CoupledPoint], np.ndarray],
    ) -> None:
        self.system, self._derivative = system, by_parameter
        self.forces = integrals.linearise(unknown)
        self.force, self.tangent = self.forces.force, self.forces.tangent
        self.gap = unknown - self.force @ system.residual
        super().__init__(unknown, unknown - system.linear + respond(system.moving, self.force))

    def assemble(self) -> np.ndarray:
        """I + (R - R_inf) T."""
        return _identity_plus(self.system.moving, self.forces.tangent)

    def condense(self) -> np.ndarray:
        basis = self.system.basis
        if basis is None:
            return super().condense()
        return _identity_plus(self.system.moving_seen, self.forces.tangent.seen(basis))

    def apply(self, change: np.ndarray) -> np.ndarray:
        return change + respond(self.system.moving, self.forces.tangent.apply(change))

    def solve(self, right: np.ndarray) -> np.ndarray:
        """J^-1 r, as sharply as GMRES finds it."""
        return self._solve(right, SHARP)

    def solve_roughly(self, right: np.ndarray) -> np.ndarray:
        return self._solve(right, ROUGH)

    def _solve(self, right: np.ndarray, tolerance: float) -> np.ndarray:
        if self.system.matrix_free:
            return gmres(self.apply, right, tolerance)
        basis = self.system.basis
        if basis is None:
            return super().solve(right)
        drive = respond(self.system.moving, self.forces.tangent.apply(right)) @ basis
        return right - solve_factored(self._factors, drive) @ basis.T

    @property
    def sign(self) -> float:
        """Sign of det J; nan where J is not formed."""
        return np.nan if self.system.matrix_free else super().sign

    def differentiate(self) -> np.ndarray:
        return self._derivative(self)

    def gap_of(self, change: np.ndarray) -> np.ndarray:
        """ds - R_inf T ds."""
        return change - self.force_of(change) @ self.system.residual

    def force_of(self, change: np.ndarray) -> np.ndarray:
        return self.forces.tangent.apply(change)

    def gap_by_force(self, change: np.ndarray) -> np.ndarray:
        moved = self.solve(-respond(self.system.moving, change))
        return self.gap_of(moved) - change @ self.system.residual

    def gap_by_linear_gap(self, change: np.ndarray) -> np.ndarray:
        return self.gap_of(self.solve(change))


def _identity_plus(moving: np.ndarray, tangent: CoupledTangent) -> np.ndarray:
    """I + R T for R (H+1, n, n) and T between n pairs, or n gaps of a basis."""
    found = tangent.matrix()
    rows, pairs = found.shape[:2]
    jacobian = np.empty_like(found)
    even, odd = (found[first::2].reshape(rows // 2, pairs, -1) for first in (1, 2))
    real, imaginary = moving[1:].real, moving[1:].imag
    shape = (rows // 2, pairs, rows, pairs)
    jacobian[0] = np.tensordot(moving[0].real, found[0], 1)
    jacobian[1::2] = (np.matmul(real, even) + np.matmul(imaginary, odd)).reshape(shape)
    jacobian[2::2] = (np.matmul(real, odd) - np.matmul(imaginary, even)).reshape(shape)
    whole = jacobian.reshape(rows * pairs, rows * pairs)
    whole.flat[:: len(whole) + 1] += 1.0
    return whole
