"""Fourier coefficients of contact forces that follow from the gaps of all pairs, lambda(s).

With S_A the stiffness of the set A of closed pairs (:mod:`fenics_crack.model.coupled`), lambda =
S_A(t) s(t): S is a matrix in time, and the coefficients of its product with a wave s of H harmonics
need no more of it than its means

    S_m = 1/(2 pi) int S(theta) exp(i m theta) d theta,        m = 0 .. 2H,

which are exact sums over the intervals between the events (:mod:`active_sets`), or sums over
samples. From the means follows S cut off after 2H harmonics, on 4H + 2 instants. There products are
exact: s, and every change of it, to the instants, times S, and back, both by FFT. So T v costs
(4H + 2) n_pairs^2, whatever the number of events; T as a matrix is needed for few unknowns only.

Of laws that are not piecewise linear, S is the tangent at every sample.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from fenics_crack.balance.active_sets import contact_intervals
from fenics_crack.balance.contact_integrals import default_samples
from fenics_crack.balance.fourier import balanced, sampled, to_complex
from fenics_crack.model.contact import ContactLaw, is_piecewise_linear, is_rigid
from fenics_crack.model.coupled import ActiveSets, smooth_forces, unique_sets

__all__ = ["CoupledForces", "CoupledIntegrals", "CoupledTangent"]

MAX_NUMBERS = 4_000_000
"""In the stiffnesses of sets that are treated together."""


@dataclass(frozen=True)
class CoupledTangent:
    """T, the derivative of the forces' coefficients by those of s.

    Attributes
    ----------
    stiffness : (N, n_pairs, n_pairs) [N/m]
        S cut off after 2H harmonics at N > 4H instants i T / N.
    harmonics : int
        H.
    """

    stiffness: np.ndarray
    harmonics: int

    def apply(self, change: np.ndarray) -> np.ndarray:
        """T v of coefficients (2H+1, n_pairs)."""
        values = sampled(change, len(self.stiffness))
        return balanced(np.matmul(self.stiffness, values[:, :, None])[:, :, 0], self.harmonics)

    def seen(self, basis: np.ndarray) -> CoupledTangent:
        """U^T T U for gaps that a basis U (n_pairs, n) spans."""
        return CoupledTangent(basis.T @ self.stiffness @ basis, self.harmonics)

    def matrix(self) -> np.ndarray:
        """T: (2H+1, n_pairs, 2H+1, n_pairs)."""
        count, pairs = self.stiffness.shape[:2]
        rows = 2 * self.harmonics + 1
        waves = sampled(np.eye(rows), count)
        weights = waves * np.where(np.arange(rows) == 0, 1.0, 2.0) / count
        products = (weights[:, :, None] * waves[:, None, :]).reshape(count, -1)
        found = products.T @ self.stiffness.reshape(count, -1)
        return found.reshape(rows, rows, pairs, pairs).transpose(0, 2, 1, 3)


@dataclass(frozen=True)
class CoupledIntegrals:
    """Coefficients of the contact forces of waves s (2H+1, n_pairs) behind R_inf.

    Attributes
    ----------
    law : ContactLaw
        Of all pairs.
    residual : (n_pairs, n_pairs) [m/N]
        R_inf.
    harmonics : int
        H.
    samples : int or None
        Instants per period; None: exact integrals.
    softness : float
        Compliance put in series with every pair, in parts of ``unit``.
    unit : float
        Mean diagonal of R_inf + I/k [m/N].
    contact : ActiveSets
        Of R_inf + I/k and the softness.
    """

    law: ContactLaw
    residual: np.ndarray
    harmonics: int
    samples: int | None = None
    softness: float = 0.0
    unit: float = field(init=False, repr=False, compare=False)
    contact: ActiveSets = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        compliance = self.residual.copy()
        diagonal = np.arange(len(compliance))
        if self.piecewise:
            compliance[diagonal, diagonal] += 1.0 / np.asarray(self.law.stiffness, dtype=float)
        object.__setattr__(self, "unit", float(np.mean(np.diag(compliance))))
        compliance[diagonal, diagonal] += self.softness * self.unit
        object.__setattr__(self, "contact", ActiveSets(compliance))

    @property
    def piecewise(self) -> bool:
        """Whether the forces are piecewise linear in s."""
        return is_piecewise_linear(self.law) or is_rigid(self.law)

    def with_softness(self, softness: float) -> CoupledIntegrals:
        """The same with another compliance in series."""
        return self if softness == self.softness else replace(self, softness=softness)

    def widened(self, harmonics: int) -> CoupledIntegrals:
        """The same with more harmonics, and samples enough for them."""
        samples = self.samples and max(self.samples, default_samples(harmonics))
        other = replace(self, harmonics=harmonics, samples=samples)
        object.__setattr__(other, "contact", self.contact)  # with the inverses known
        return other

    def forces(self, gap: np.ndarray) -> np.ndarray:
        """lambda(s) at instants, of values (n, n_pairs): the same shape [N]."""
        if self.piecewise:
            return self.contact.solve(gap)[0]
        return smooth_forces(self.law, self.contact.compliance, gap)[0]

    def linearise(self, gap: np.ndarray) -> CoupledForces:
        """The forces' coefficients and their derivatives."""
        if self.piecewise:
            return _PiecewiseForces(self, gap)
        return _SmoothForces(self, gap)


class CoupledForces(ABC):
    """Coefficients of the contact forces of a wave s, and their derivatives.

    Attributes
    ----------
    force : (2H+1, n_pairs) [N]
    tangent : CoupledTangent
        By s.
    """

    force: np.ndarray
    tangent: CoupledTangent

    @abstractmethod
    def by_softness(self) -> np.ndarray:
        """Derivative of the coefficients by the softness."""

    @abstractmethod
    def by_stiffness(self) -> np.ndarray:
        """Derivative of the coefficients by ln k."""


class _PiecewiseForces(CoupledForces):
    """lambda = S_A s: with a compliance E added to D, d lambda = - S E S s."""

    def __init__(self, integrals: CoupledIntegrals, gap: np.ndarray) -> None:
        self._integrals, self._gap, contact = integrals, gap, integrals.contact
        highest = 2 * integrals.harmonics
        if integrals.samples is None:
            intervals = contact_intervals(to_complex(gap), contact)
            sets, means = intervals.sets, intervals.means(highest)
        else:
            _, closed = contact.solve(sampled(gap, integrals.samples))
            sets, which = unique_sets(closed)
            present = np.equal.outer(np.arange(len(sets)), which).astype(float)
            means = np.fft.rfft(present, axis=1)[:, : highest + 1].conj() / integrals.samples
        count = 2 * highest + 2
        self._weights = np.fft.irfft(count * means.conj(), n=count, axis=1).T  # (N, n_sets)
        self._sets = sets
        self.tangent = self._cut_off(lambda stack: stack)
        self.force = self.tangent.apply(gap)

    def _cut_off(self, of_sets: Callable[[np.ndarray], np.ndarray]) -> CoupledTangent:
        """What depends on the stiffness of each set, over time; some sets at a time."""
        pairs = self._sets.shape[1]
        found: np.ndarray = np.zeros((len(self._weights), pairs * pairs))
        some = max(1, MAX_NUMBERS // max(1, pairs * pairs))
        for begin in range(0, len(self._sets), some):
            stack = self._integrals.contact.stack(self._sets[begin : begin + some])
            flat = of_sets(stack).reshape(len(stack), -1)
            found += self._weights[:, begin : begin + some] @ flat
        return CoupledTangent(found.reshape(-1, pairs, pairs), self._integrals.harmonics)

    def _by_compliance(self, added: float | np.ndarray) -> np.ndarray:
        weights = np.broadcast_to(np.asarray(added, dtype=float), self._sets.shape[1])
        return -self._cut_off(lambda stack: np.matmul(stack * weights, stack)).apply(self._gap)

    def by_softness(self) -> np.ndarray:
        return self._by_compliance(self._integrals.unit)

    def by_stiffness(self) -> np.ndarray:
        return self._by_compliance(-1.0 / np.asarray(self._integrals.law.stiffness))


class _SmoothForces(CoupledForces):
    """lambda = h(s - D lambda) at samples: d lambda = S (ds - dD lambda), S = h' (I + D h')^-1."""

    def __init__(self, integrals: CoupledIntegrals, gap: np.ndarray) -> None:
        self._integrals = integrals
        samples = integrals.samples or default_samples(integrals.harmonics)
        values = sampled(gap, samples)
        self._force, self._slope = smooth_forces(
            integrals.law, integrals.contact.compliance, values
        )
        count = 4 * integrals.harmonics + 2
        spectrum = np.fft.rfft(self._slope, axis=0)[: 2 * integrals.harmonics + 1]
        cut_off = np.fft.irfft(spectrum * (count / samples), n=count, axis=0)
        self.tangent = CoupledTangent(cut_off, integrals.harmonics)
        self.force = balanced(self._force, integrals.harmonics)

    def by_softness(self) -> np.ndarray:
        change = np.einsum("npq,nq->np", self._slope, self._force)
        return balanced(-self._integrals.unit * change, self._integrals.harmonics)

    def by_stiffness(self) -> np.ndarray:
        # d lambda = (I + h' D)^-1 lambda = lambda - S D lambda.
        pressed = self._force @ self._integrals.contact.compliance
        change = self._force - np.einsum("npq,nq->np", self._slope, pressed)
        return balanced(change, self._integrals.harmonics)
