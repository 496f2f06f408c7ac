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

from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg

from fenics_crack.balance.compliance import FactoredCompliance
from fenics_crack.balance.condensed import respond_to_columns
from fenics_crack.balance.contact_integrals import ContactIntegrals, apply_to_pairs
from fenics_crack.balance.linearisation import Linearisation, determinant_sign

__all__ = ["BlockSystem"]


class BlockSystem:
    """F(u), inverted through its structure; amplitudes are (2H+1, n_local).

    Its parameter is p = ln(k / k of the law), the contact stiffness.

    Attributes
    ----------
    linear : (2H+1, n_local) [m]
        The solution without contact.
    """

    def __init__(self, compliance: FactoredCompliance, integrals: ContactIntegrals) -> None:
        self.compliance, self.integrals = compliance, integrals
        self.structure = compliance.structure
        self.comm = self.structure.comm
        rows = 2 * integrals.harmonics + 1
        self.shape: tuple[int, ...] = (rows, self.structure.n_local)
        self.global_size = rows * self.structure.n_dofs
        self.linear = compliance.solve_blocks(compliance.load)

    def gap(self, amplitude: np.ndarray) -> np.ndarray:
        """g = B^T u - g0: (2H+1, n_pairs)."""
        gap = self.structure.closing(amplitude)
        gap[0] -= self.structure.clearance
        return gap

    def linearise(self, amplitude: np.ndarray, parameter: float = 0.0) -> BlockPoint:
        """The equations at an amplitude and a stiffness."""
        integrals = self.integrals
        if parameter != 0.0:
            integrals = integrals.of_law(integrals.law.scaled(float(np.exp(parameter))))
        return BlockPoint(self, amplitude, integrals)

    def inner(self, first: np.ndarray, second: np.ndarray) -> float:
        """Inner product (collective)."""
        product = np.array([np.vdot(first, second)])
        return float(self.structure.sum_over_ranks(product)[0])


class BlockPoint(Linearisation):
    """:class:`BlockSystem` at an amplitude (collective)."""

    def __init__(
        self, system: BlockSystem, amplitude: np.ndarray, integrals: ContactIntegrals
    ) -> None:
        self._system, self.unknown = system, amplitude
        force, self._tangent = integrals.linearise(system.gap(amplitude))
        self._moved = self._through_structure(force)
        self.residual = amplitude - system.linear + self._moved

    def _through_structure(self, force: np.ndarray) -> np.ndarray:
        """A^-1 B of forces on the pairs."""
        system = self._system
        return system.compliance.solve_blocks(system.structure.spread(force))

    def apply(self, change: np.ndarray) -> np.ndarray:
        """dF = (I + A^-1 B T B^T) du."""
        closing = self._system.structure.closing(change)
        return change + self._through_structure(apply_to_pairs(self._tangent, closing))

    @cached_property
    def _factors(self) -> Any:
        small = respond_to_columns(self._system.compliance.matrices, self._tangent)
        small.flat[:: len(small) + 1] += 1.0
        return scipy.linalg.lu_factor(small)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """(I + A^-1 B T B^T)^-1 r = r - A^-1 B T (I + R T)^-1 B^T r."""
        closing = self._system.structure.closing(right)
        gap = scipy.linalg.lu_solve(self._factors, closing.ravel()).reshape(closing.shape)
        return right - self._through_structure(apply_to_pairs(self._tangent, gap))

    @property
    def by_parameter(self) -> np.ndarray:
        """dF / d ln k = A^-1 B b, for a law proportional to its stiffness."""
        return self._moved

    @property
    def sign(self) -> float:
        """Sign of det(I + R T), which is that of the Jacobian."""
        return determinant_sign(self._factors)
