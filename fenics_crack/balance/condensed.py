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

from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.linalg.lapack import dgetrf, dgetrs

from fenics_crack.balance.compliance import Compliance, WidenedCompliance
from fenics_crack.balance.contact_integrals import (
    ContactIntegrals,
    ExactIntegrals,
    apply_to_pairs,
)
from fenics_crack.balance.fourier import from_complex, to_complex
from fenics_crack.errors import InputError
from fenics_crack.model.contact import ContactLaw, UnilateralPenalty

__all__ = [
    "CondensedSystem",
    "ConstraintSystem",
    "default_weight",
    "determinant_sign",
    "respond",
    "respond_to_columns",
]


def respond(matrices: np.ndarray, force: np.ndarray) -> np.ndarray:
    """R lambda of coefficients (2H+1, n_pairs)."""
    harmonics = np.matmul(matrices, to_complex(force)[:, :, None])[:, :, 0]
    return from_complex(harmonics)


def respond_to_columns(matrices: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """R T as a dense matrix for unknowns ordered (row, pair); of many points at once.

    A force a - i b on harmonic k moves the gap by R_k (a - i b), that is by the real matrix
    [[Re R_k, Im R_k], [-Im R_k, Re R_k]] on (a, b).

    Parameters
    ----------
    matrices : (..., H+1, n_pairs, n_pairs)
        R_k.
    tangent : (..., n_pairs, 2H+1, 2H+1)
        T of every pair.
    """
    *points, pairs, rows, _ = tangent.shape
    harmonics, lead = rows // 2, range(len(points))
    at = len(points)
    product = np.empty((*points, rows, pairs, rows, pairs))
    mean = tangent[..., :, 0, :].swapaxes(-1, -2)
    static = matrices[..., 0, :, :].real
    np.multiply(static[..., :, None, :], mean[..., None, :, :], out=product[..., 0, :, :, :])
    # For each harmonic and each pair that carries a force: (a, b) of all pairs from (a, b) of it.
    through = matrices[..., 1:, :, :].swapaxes(-1, -2)
    blocks = np.empty((*points, harmonics, pairs, 2, pairs, 2))
    blocks[..., 0, :, 0] = blocks[..., 1, :, 1] = through.real
    blocks[..., 0, :, 1] = through.imag
    np.subtract(0.0, through.imag, out=blocks[..., 1, :, 0])
    forces = tangent[..., 1:, :].reshape(*points, pairs, harmonics, 2, rows)
    forces = forces.transpose(*lead, at + 1, at, at + 2, at + 3)
    gaps = np.matmul(blocks.reshape(*points, harmonics, pairs, 2 * pairs, 2), forces)
    gaps = gaps.reshape(*points, harmonics, pairs, 2, pairs, rows)
    gaps = gaps.transpose(*lead, at, at + 2, at + 3, at + 4, at + 1)
    product[..., 1:, :, :, :].reshape(*points, harmonics, 2, pairs, rows, pairs)[:] = gaps
    return product.reshape(*points, rows * pairs, rows * pairs)


def determinant_sign(factors: tuple[np.ndarray, np.ndarray]) -> float:
    """Sign of the determinant of a matrix from its LU factors as LAPACK gives them."""
    matrix, pivots = factors
    swaps = np.count_nonzero(pivots != np.arange(len(pivots)))
    negative = np.count_nonzero(np.diag(matrix) < 0.0)
    return -1.0 if (swaps + negative) % 2 else 1.0


class _DenseSystem:
    """What both condensed systems share: a small dense Jacobian, the same on every rank."""

    comm = MPI.COMM_SELF

    def __init__(self, compliance: Compliance, integrals: ContactIntegrals) -> None:
        self.compliance = compliance
        self.integrals = integrals
        self.linear = compliance.linear_gap
        self.shape: tuple[int, ...] = self.linear.shape
        self.global_size = self.linear.size
        self._at: np.ndarray | None = None
        self._force = self._tangent = np.zeros(0)
        self._factors: Any = None
        self.jacobian = np.zeros((0, 0))

    def _evaluate(self, argument: np.ndarray) -> None:
        """Contact force and tangent at an argument, once where it is asked for again."""
        if self._at is None or not (argument == self._at).all():
            self._force, self._tangent = self.integrals.linearise(argument)
            self._at = argument.copy()

    def apply_jacobian(self, change: np.ndarray) -> np.ndarray:
        """dF."""
        return (self.jacobian @ change.ravel()).reshape(self.shape)

    def solve_jacobian(self, residual: np.ndarray) -> np.ndarray:
        """Solve J dx = r."""
        if self._factors is None:
            # The transpose is in Fortran's order, which LAPACK takes without a transposing copy.
            matrix, pivots, _ = dgetrf(self.jacobian.T)
            self._factors = matrix, pivots
        found, _ = dgetrs(*self._factors, residual.ravel(), trans=1)
        return found.reshape(self.shape)

    def determinant_sign(self) -> float:
        """Sign of det J where :meth:`solve_jacobian` was called last."""
        return determinant_sign(self._factors)

    def norm(self, values: np.ndarray) -> float:
        """Euclidean norm."""
        return float(np.linalg.norm(values))

    def inner(self, first: np.ndarray, second: np.ndarray) -> float:
        """Inner product."""
        return float(np.vdot(first, second))


class CondensedSystem(_DenseSystem):
    """F(g) = g - g_lin + R b(g) for a law that gives the force from the gap."""

    def with_law(self, law: ContactLaw) -> None:
        """Replace the contact law by one of the same kind."""
        self.integrals.law = law
        self._at = None

    def residual(self, gap: np.ndarray) -> np.ndarray:
        """F(g) [m]."""
        self._evaluate(gap)
        return gap - self.linear + respond(self.compliance.matrices, self._force)

    def linearise(self, gap: np.ndarray) -> None:
        """J = I + R T."""
        self._evaluate(gap)
        self.jacobian = respond_to_columns(self.compliance.matrices, self._tangent)
        self.jacobian.flat[:: len(self.jacobian) + 1] += 1.0
        self._factors = None

    def stiffness_derivative(self, gap: np.ndarray) -> np.ndarray:
        """dF / d ln k = R b, for a law proportional to its stiffness."""
        self._evaluate(gap)
        return respond(self.compliance.matrices, self._force)

    def gap_and_force(self, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of the gap and of the contact force at a solution."""
        self._evaluate(gap)
        return gap, self._force

    def widened(self, harmonics: int) -> CondensedSystem:
        """The same equations with more harmonics, to the accuracy of an error estimate."""
        return CondensedSystem(
            WidenedCompliance(self.compliance, harmonics), self.integrals.widened(harmonics)
        )

    def gap_of_change(self, change: np.ndarray) -> np.ndarray:
        """Change of the gap that belongs to a change of the unknowns."""
        return change

    def gap_change(self, force_change: np.ndarray) -> np.ndarray:
        """Change of the gap if the contact force were changed: -J^-1 R d."""
        return self.gap_change_of_free_gap(-respond(self.compliance.matrices, force_change))

    def gap_change_of_free_gap(self, change: np.ndarray) -> np.ndarray:
        """Change of the gap if that without contact, g_lin, were changed: J^-1 d."""
        return self.solve_jacobian(change)


def default_weight(compliance: Compliance) -> float:
    """Inverse of the static compliance: the stiffness that the pairs see [N/m]."""
    largest = float(np.abs(compliance.matrices[0]).sum(axis=1).max())
    if not largest > 0.0:
        raise InputError("structure", "static compliance 0", "one whose pairs can move")
    return 1.0 / largest


class ConstraintSystem(_DenseSystem):
    """F(y) = y - P(g_lin + y - eps R y): no penetration, in the frequency-time sense.

    Parameters
    ----------
    compliance : Compliance
        Of the structure.
    harmonics : int
        H.
    weight : float [N/m]
        eps > 0. Truncated solutions depend on it a little, less the more harmonics there are.
    """

    def __init__(self, compliance: Compliance, harmonics: int, weight: float) -> None:
        super().__init__(compliance, ExactIntegrals(UnilateralPenalty(1.0), harmonics))
        self.weight = weight
        self.share = 1.0

    def set_parameter(self, parameter: float) -> None:
        """Set t in y = P(g_lin + t y - eps R y): a penalty of stiffness eps (0), constraint (1)."""
        self.share = parameter
        self._at = None

    def parameter_derivative(self, unknown: np.ndarray) -> np.ndarray:
        """dF/dt = -T y."""
        self._evaluate(self._argument(unknown))
        return -apply_to_pairs(self._tangent, unknown)

    def _argument(self, unknown: np.ndarray) -> np.ndarray:
        return self.linear + self.share * unknown + self.gap_of_change(unknown)

    def residual(self, unknown: np.ndarray) -> np.ndarray:
        """F(y) [m]."""
        self._evaluate(self._argument(unknown))
        return unknown - self._force

    def linearise(self, unknown: np.ndarray) -> None:
        """J = I - T (I - eps R), T the derivative of the projection."""
        self._evaluate(self._argument(unknown))
        rows, pairs = self.shape
        identity = np.broadcast_to(np.eye(rows), (pairs, rows, rows))
        inner = -self.weight * respond_to_columns(self.compliance.matrices, identity)
        inner.flat[:: len(inner) + 1] += self.share
        inner = inner.reshape(rows, pairs, -1).transpose(1, 0, 2)
        product = np.matmul(self._tangent, inner).transpose(1, 0, 2)
        self.jacobian = -product.reshape(rows * pairs, rows * pairs)
        self.jacobian.flat[:: len(self.jacobian) + 1] += 1.0
        self._factors = None

    def from_force(self, force: np.ndarray) -> np.ndarray:
        """The unknown that stands for a contact force."""
        return force / self.weight

    def gap_and_force(self, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of the gap and of the contact force at a solution."""
        force = self.weight * unknown
        return self.linear - respond(self.compliance.matrices, force), force

    def widened(self, harmonics: int) -> ConstraintSystem:
        """The same equations with more harmonics, to the accuracy of an error estimate."""
        return ConstraintSystem(
            WidenedCompliance(self.compliance, harmonics), harmonics, self.weight
        )

    def gap_of_change(self, change: np.ndarray) -> np.ndarray:
        """Change of the gap that belongs to a change of the unknowns."""
        return -respond(self.compliance.matrices, self.weight * change)

    def gap_change(self, force_change: np.ndarray) -> np.ndarray:
        """Change of the gap if the contact force were changed."""
        return self.gap_of_change(self.solve_jacobian(force_change / self.weight))

    def gap_change_of_free_gap(self, change: np.ndarray) -> np.ndarray:
        """Change of the gap if that without contact, g_lin, were changed."""
        return change + self.gap_change(self.weight * apply_to_pairs(self._tangent, change))
