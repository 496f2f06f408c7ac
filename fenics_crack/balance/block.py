"""Harmonic balance in all degrees of freedom: the reference for the condensed form.

The Fourier coefficients u of the displacement, (2H+1, n) in the paper's order, solve (eqs 5 to 9)

    R(u) = A u + B b(B^T u - g0) - c = 0,

A block diagonal in the harmonics (Z_k of :mod:`dynamic_stiffness`), b the coefficients of the
contact force, c those of the load. Newton's method (eqs 13 to 15, the update with its minus sign)
runs on the system multiplied by A^-1,

    F(u) = A^-1 R(u) = u - u_lin + A^-1 B b = 0,     u_lin = A^-1 c,

whose steps are the same and whose residual is a displacement: no rounding error of the elastic
forces, huge beside the load near a resonance, hides it. The Jacobian I + A^-1 B T B^T, T = db/dg
coupling all harmonics of one pair (eq. 14), is never formed: with the compliance R = B^T A^-1 B,

    (I + A^-1 B T B^T)^-1 r = r - A^-1 B T (I + R T)^-1 B^T r,

one small dense system of (2H+1) n_pairs unknowns and one solution with the factors of each
harmonic.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg

from fenics_crack.balance.compliance import FactoredCompliance
from fenics_crack.balance.condensed import determinant_sign, respond_to_columns
from fenics_crack.balance.contact_integrals import ContactIntegrals, apply_to_pairs
from fenics_crack.model.contact import ContactLaw

__all__ = ["BlockSystem"]


class BlockSystem:
    """F(u) and its Jacobian, inverted through its structure; amplitudes are (2H+1, n_local).

    Attributes
    ----------
    linear : (2H+1, n_local) [m]
        The solution without contact.
    """

    def __init__(self, compliance: FactoredCompliance, integrals: ContactIntegrals) -> None:
        self.compliance = compliance
        self.structure = compliance.structure
        self.comm = self.structure.comm
        self.integrals = integrals
        rows = 2 * integrals.harmonics + 1
        self.shape: tuple[int, ...] = (rows, self.structure.n_local)
        self.global_size = rows * self.structure.n_dofs
        self.linear = compliance.solve_blocks(compliance.load)
        self._tangent = np.zeros(0)
        self._factors: Any = None

    def with_law(self, law: ContactLaw) -> None:
        """Replace the contact law by one of the same kind."""
        self.integrals.law = law

    def gap(self, amplitude: np.ndarray) -> np.ndarray:
        """g = B^T u - g0: (2H+1, n_pairs)."""
        gap = self.structure.closing(amplitude)
        gap[0] -= self.structure.clearance
        return gap

    # --- residual ---------------------------------------------------------------------------------

    def residual(self, amplitude: np.ndarray) -> np.ndarray:
        """F(u) = A^-1 (A u + B b(g) - c) [m] (eq. 5, divided by A)."""
        return amplitude - self.linear + self.stiffness_derivative(amplitude)

    # --- Jacobian ---------------------------------------------------------------------------------

    def linearise(self, amplitude: np.ndarray) -> None:
        """Evaluate the tangent T of the contact force (eq. 14)."""
        self._tangent = self.integrals.linearise(self.gap(amplitude))[1]
        self._factors = None

    def apply_jacobian(self, change: np.ndarray) -> np.ndarray:
        """dF = (I + A^-1 B T B^T) du."""
        contact = apply_to_pairs(self._tangent, self.structure.closing(change))
        return change + self.compliance.solve_blocks(self.structure.spread(contact))

    def solve_jacobian(self, residual: np.ndarray) -> np.ndarray:
        """(I + A^-1 B T B^T)^-1 r = r - A^-1 B T (I + R T)^-1 B^T r."""
        if self._factors is None:
            small = respond_to_columns(self.compliance.matrices, self._tangent)
            small.flat[:: len(small) + 1] += 1.0
            self._factors = scipy.linalg.lu_factor(small)
        closing = self.structure.closing(residual)
        gap = scipy.linalg.lu_solve(self._factors, closing.ravel()).reshape(closing.shape)
        return residual - self.compliance.solve_blocks(
            self.structure.spread(apply_to_pairs(self._tangent, gap))
        )

    def determinant_sign(self) -> float:
        """Sign of det(I + R T), which is that of the Jacobian."""
        return determinant_sign(self._factors)

    def stiffness_derivative(self, amplitude: np.ndarray) -> np.ndarray:
        """dF / d ln k = A^-1 B b, for a law proportional to its stiffness."""
        contact = self.structure.spread(self.integrals.force(self.gap(amplitude)))
        return self.compliance.solve_blocks(contact)

    # --- over all ranks ---------------------------------------------------------------------------

    def inner(self, first: np.ndarray, second: np.ndarray) -> float:
        """Inner product (collective)."""
        product = np.array([np.vdot(first, second)])
        return float(self.structure.sum_over_ranks(product)[0])

    def norm(self, values: np.ndarray) -> float:
        """Euclidean norm (collective)."""
        return float(np.sqrt(self.inner(values, values)))
