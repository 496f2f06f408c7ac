"""Fourier coefficients of contact forces that follow from the gaps of all pairs, lambda(s).

With S_A the stiffness of the set A of closed pairs (:mod:`fenics_crack.model.coupled`), lambda =
S_A(t) s(t): S is a matrix in time, and the coefficients of its product with a wave s of H harmonics
need no more of it than its means

    S_m = 1/(2 pi) int S(theta) exp(i m theta) d theta,        m = 0 .. 2H.

*Exact*: between two events the set A stays; at each of them one pair opens or closes, and S changes
by a part of rank one. The kernel finds them in order, and the means are sums over them
(``kernel/intervals.h``, ``coupled_forces.h``). *Sampled*, for a law that is not piecewise linear:
S is the tangent at every sample. In both, T v is found on N > 4H instants, with S cut off after 2H
harmonics, where products are exact: v to the instants, times S, and back. T as a matrix is needed
for few unknowns only.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, ClassVar, Self

import numpy as np

from fenics_crack.balance.contact_integrals import (
    ContactForces,
    ContactIntegrals,
    default_samples,
    tangent_by_means,
)
from fenics_crack.errors import ConvergenceError
from fenics_crack.kernel import NULL, doubles, kernel, owned, shaped
from fenics_crack.model.contact import is_unilateral
from fenics_crack.model.coupled import ActiveSets, smooth_forces
from fenics_crack.numerics.fourier import balanced, instants, sampled

__all__ = ["CoupledForces", "CoupledIntegrals"]


@dataclass(frozen=True)
class CoupledIntegrals(ContactIntegrals):
    """Contact forces of pairs that R_inf couples.

    Attributes
    ----------
    samples : int or None
        Instants per period; None: exact integrals.
    contact : ActiveSets
        Of R_inf + I/k and the softness.
    """

    samples: int | None = None
    contact: ActiveSets = field(init=False, repr=False, compare=False)
    coupled: ClassVar[bool] = True

    def __post_init__(self) -> None:
        assert self.residual is not None
        compliance = self.residual.copy()
        diagonal = np.arange(len(compliance))
        if self.piecewise:
            compliance[diagonal, diagonal] += self.springs
        compliance[diagonal, diagonal] += self.softness * self.unit
        object.__setattr__(self, "contact", ActiveSets(compliance))

    @property
    def piecewise(self) -> bool:
        """Whether the forces are piecewise linear in s."""
        return is_unilateral(self.law)

    @property
    def exact(self) -> bool:
        """Whether they are exact integrals."""
        return self.piecewise and self.samples is None

    def widened(self, harmonics: int) -> Self:
        samples = self.samples and max(self.samples, default_samples(harmonics))
        other = replace(self, harmonics=harmonics, samples=samples)
        object.__setattr__(other, "contact", self.contact)  # with the inverses known
        return other

    def finer(self) -> Self | None:
        if self.exact:
            return None
        samples = 4 * (self.samples or default_samples(self.harmonics))
        return replace(self, samples=None if self.piecewise else samples)

    def forces(self, gap: np.ndarray) -> np.ndarray:
        if self.piecewise:
            return self.contact.solve(gap)[0]
        return smooth_forces(self.law, self.contact.compliance, gap)[0]

    def linearise(self, gap: np.ndarray) -> CoupledForces:
        return _ExactForces(self, gap) if self.exact else _SampledForces(self, gap)


class CoupledForces(ContactForces):
    """Forces that follow from the gaps of all pairs."""

    def __init__(self, integrals: CoupledIntegrals) -> None:
        self._integrals, self.harmonics = integrals, integrals.harmonics

    @abstractmethod
    def means(self, basis: np.ndarray | None = None) -> np.ndarray:
        """Of S times exp(i m theta), m = 0 to 2H, rows c_0, c_1, s_1, ...: (4H+1, n_pairs, n_pairs)
        [N/m]; with a basis U those of U^T S U."""

    def tangent(self, basis: np.ndarray | None = None) -> np.ndarray:
        """T as a matrix, between the pairs or the gaps of a basis: (2H+1, n, (2H+1) n)."""
        return tangent_by_means(self.means(basis))

    def identity_plus(self, matrices: np.ndarray, basis: np.ndarray | None = None) -> np.ndarray:
        found = self.tangent(basis)
        even, odd = found[1::2], found[2::2]
        real, imaginary = matrices[1:].real, matrices[1:].imag
        jacobian = np.empty_like(found)
        jacobian[0] = matrices[0].real @ found[0]
        jacobian[1::2] = np.matmul(real, even) + np.matmul(imaginary, odd)
        jacobian[2::2] = np.matmul(real, odd) - np.matmul(imaginary, even)
        whole = jacobian.reshape(found.shape[2], -1)
        whole.flat[:: len(whole) + 1] += 1.0
        return whole


class _Known:
    """The kernel's object for waves of H harmonics of so many pairs, and where it has last been."""

    def __init__(self, harmonics: int, pairs: int) -> None:
        made = kernel.new_coupled_forces(harmonics, pairs)
        self.handle = owned(made, kernel.free_coupled_forces)
        self.at: CoupledForces | None = None


_known = lru_cache(maxsize=16)(_Known)


class _ExactForces(CoupledForces):
    """By the kernel; found again where it has been elsewhere."""

    def __init__(self, integrals: CoupledIntegrals, gap: np.ndarray) -> None:
        super().__init__(integrals)
        pairs = len(integrals.contact.compliance)
        self._gap = shaped(gap, 2 * self.harmonics + 1, pairs)
        self.force = np.empty_like(self._gap)
        self._here()

    def _here(self) -> Any:
        """The kernel's object.

        Raises ConvergenceError where an instant has no forces.
        """
        known, contact = _known(self.harmonics, self._gap.shape[1]), self._integrals.contact
        if known.at is not self:
            known.at = None
            outcome = kernel.find_forces(
                known.handle, doubles(contact.compliance), doubles(self._gap), doubles(self.force)
            )
            if outcome == kernel.NO_MEMORY:
                raise MemoryError("contact forces")
            if outcome != kernel.FOUND:
                raise ConvergenceError("contact: no forces were found at an instant of the period")
            known.at = self
        return known.handle

    def apply(self, change: np.ndarray) -> np.ndarray:
        change, found = shaped(change, *self._gap.shape), np.empty(self._gap.shape)
        kernel.forces_by_gap(self._here(), doubles(change), doubles(found))
        return found

    def means(self, basis: np.ndarray | None = None) -> np.ndarray:
        pairs = self._gap.shape[1]
        count = pairs if basis is None else basis.shape[1]
        found = np.empty((4 * self.harmonics + 1, count, count))
        seen = NULL if basis is None else doubles(shaped(basis, pairs, count))
        if kernel.means_of_stiffness(self._here(), seen, count, doubles(found)):
            raise MemoryError("contact forces")
        return found

    def _by_compliance(self, rate: np.ndarray) -> np.ndarray:
        """Where the diagonal of D grows by a rate."""
        found, rate = np.empty(self._gap.shape), shaped(rate, self._gap.shape[1])
        kernel.forces_by_compliance(self._here(), doubles(rate), doubles(found))
        return found

    def by_softness(self) -> np.ndarray:
        return self._by_compliance(np.full(self._gap.shape[1], self._integrals.unit))

    def by_stiffness(self) -> np.ndarray:
        return self._by_compliance(np.broadcast_to(-self._integrals.springs, self._gap.shape[1]))


class _SampledForces(CoupledForces):
    """At samples, of any law: lambda = h(s - D lambda), d lambda = S (ds - dD lambda), S = h' (I
    + D h')^-1, or where it is piecewise linear the inverse of D on the closed pairs."""

    def __init__(self, integrals: CoupledIntegrals, gap: np.ndarray) -> None:
        super().__init__(integrals)
        contact = integrals.contact
        values = sampled(gap, integrals.samples or default_samples(integrals.harmonics))
        if integrals.piecewise:
            self._force, closed = contact.solve(values)
            self._slope = contact.stack(closed)
        else:
            self._force, self._slope = smooth_forces(integrals.law, contact.compliance, values)
        self._waves = balanced(self._slope, 2 * self.harmonics)
        self._cut_off = sampled(self._waves, instants(self.harmonics))
        self.force = balanced(self._force, self.harmonics)

    def apply(self, change: np.ndarray) -> np.ndarray:
        values = sampled(change, len(self._cut_off))
        forces = np.empty_like(values)
        kernel.multiply_each(*values.shape, *map(doubles, (self._cut_off, values, forces)))
        return balanced(forces, self.harmonics)

    def means(self, basis: np.ndarray | None = None) -> np.ndarray:
        found = np.concatenate([self._waves[:1], 0.5 * self._waves[1:]])
        return found if basis is None else np.ascontiguousarray(basis.T @ found @ basis)

    def _by_gap(self, change: np.ndarray) -> np.ndarray:
        """Of gaps that change by so much, (samples, n_pairs)."""
        return balanced(np.einsum("npq,nq->np", self._slope, change), self.harmonics)

    def by_softness(self) -> np.ndarray:
        return self._by_gap(-self._integrals.unit * self._force)

    def by_stiffness(self) -> np.ndarray:
        if self._integrals.piecewise:
            return self._by_gap(self._force * self._integrals.springs)
        # d lambda = (I + h' D)^-1 lambda = lambda - S D lambda.
        return self.force - self._by_gap(self._force @ self._integrals.contact.compliance)
