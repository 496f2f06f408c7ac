"""Fourier coefficients of contact forces that follow from the gaps of all pairs, lambda(s).

With S_A the stiffness of the set A of closed pairs (:mod:`fenics_crack.model.coupled`), lambda =
S_A(t) s(t): S is a matrix in time, and the coefficients of its product with a wave s of H harmonics
need no more of it than its means

    S_m = 1/(2 pi) int S(theta) exp(i m theta) d theta,        m = 0 .. 2H,

which are exact sums over the intervals between the events (:mod:`active_sets`), or sums over
samples. From the means follows S cut off after 2H harmonics, on N > 4H instants. There products are
exact: s, and every change of it, to the instants, times S, and back. At each event one pair opens
or closes, and S changes by a part of rank one. So T v costs N n_pairs^2, or twice n_events n_pairs
where S is not formed; T as a matrix is needed for few unknowns only.

Of laws that are not piecewise linear, S is the tangent at every sample.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.fft

from fenics_crack.balance.active_sets import contact_intervals
from fenics_crack.balance.contact_integrals import default_samples
from fenics_crack.kernel import doubles, kernel
from fenics_crack.model.contact import ContactLaw, is_piecewise_linear, is_rigid
from fenics_crack.model.coupled import ActiveSets, smooth_forces, unique_sets
from fenics_crack.numerics.fourier import balanced, instants, sampled

__all__ = ["CoupledForces", "CoupledIntegrals", "CoupledTangent"]

MAX_NUMBERS = 4_000_000
"""In the stiffnesses of sets that are treated together."""
PRODUCTS = 40
"""With T at a point, as many as GMRES takes."""


class CoupledTangent:
    """T, the derivative of the forces' coefficients by those of s.

    S cut off after 2H harmonics, at N > 4H instants i T / N, is ``base`` + sum_e w_e v_e v_e^T, in
    which every event e of a pair adds a part of rank one. The sum is formed where that is less work
    than some products with its parts.

    Parameters
    ----------
    harmonics : int
        H.
    base : (N or 1, n_pairs, n_pairs) [N/m]
    vectors : (n_events, n_pairs), optional
        v.
    weights : (N, n_events), optional
        w [N/m].
    """

    def __init__(
        self,
        harmonics: int,
        base: np.ndarray,
        vectors: np.ndarray | None = None,
        weights: np.ndarray | None = None,
    ) -> None:
        self.harmonics, self._base = harmonics, base
        pairs = base.shape[1]
        self._vectors = np.zeros((0, pairs)) if vectors is None else vectors
        self._weights = np.zeros((len(base), 0)) if weights is None else weights
        events = len(self._vectors)
        self._parts = events * pairs > PRODUCTS * (2 * events - pairs) or not events

    @cached_property
    def stiffness(self) -> np.ndarray:
        """S at N instants: (N, n_pairs, n_pairs) [N/m]."""
        events, pairs = self._vectors.shape
        count = len(self._weights)
        if not events:
            return np.broadcast_to(self._base, (count, pairs, pairs))
        found = np.repeat(self._base.reshape(1, -1), count, axis=0)
        some = max(1, MAX_NUMBERS // (pairs * pairs))
        for begin in range(0, events, some):
            v = self._vectors[begin : begin + some]
            products = (v[:, :, None] * v[:, None, :]).reshape(len(v), -1)
            found += self._weights[:, begin : begin + some] @ products
        return found.reshape(count, pairs, pairs)

    def apply(self, change: np.ndarray, *, once: bool = False) -> np.ndarray:
        """T v of coefficients (2H+1, n_pairs); S is not formed for one product alone."""
        values = sampled(change, len(self._weights))
        if len(self._base) > 1 or not (self._parts or once):
            forces = np.empty_like(values)
            kernel.multiply_each(*values.shape, *map(doubles, (self.stiffness, values, forces)))
        else:
            forces = values @ self._base[0]
            forces += ((values @ self._vectors.T) * self._weights) @ self._vectors
        return balanced(forces, self.harmonics)

    def seen(self, basis: np.ndarray) -> CoupledTangent:
        """U^T T U for gaps that a basis U (n_pairs, n) spans."""
        base, vectors = basis.T @ self._base @ basis, self._vectors @ basis
        return CoupledTangent(self.harmonics, base, vectors, self._weights)

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

    @property
    def exact(self) -> bool:
        """Whether they are exact integrals."""
        return self.piecewise and self.samples is None

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
        return _ExactForces(self, gap) if self.exact else _SampledForces(self, gap)


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


class _ExactForces(CoupledForces):
    """lambda = S_A s: with a compliance E added to D, d lambda = - S E S s."""

    def __init__(self, integrals: CoupledIntegrals, gap: np.ndarray) -> None:
        self._integrals, self._gap = integrals, gap
        self._found = found = contact_intervals(gap, integrals.contact)
        rests = found.rests(2 * integrals.harmonics)
        count = instants(integrals.harmonics)
        self._rests = scipy.fft.irfft(count * rests.conj(), n=count, axis=1).T  # (N, m)
        weights = np.ascontiguousarray(self._rests[:, 1:] * found.gains)
        self.tangent = CoupledTangent(
            integrals.harmonics, found.stiffness[None], found.vectors, weights
        )
        self.force = self.tangent.apply(gap, once=True)

    def _by_compliance(self, added: float | np.ndarray) -> np.ndarray:
        """-S E S s for a diagonal E, S cut off as a product."""
        weights = np.broadcast_to(np.asarray(added, dtype=float), self._gap.shape[1])
        sets, which = unique_sets(self._found.closed)
        shares = np.zeros((len(self._rests), len(sets)))
        lasts = np.hstack([self._rests[:, 1:], np.zeros((len(shares), 1))])
        np.add.at(shares.T, which, (self._rests - lasts).T)
        values = sampled(self._gap, len(shares))
        some = max(1, MAX_NUMBERS // max(1, weights.size**2))
        found = np.zeros_like(values)
        for begin in range(0, len(sets), some):
            stack = self._integrals.contact.stack(sets[begin : begin + some])
            moved = np.matmul(values, stack) * weights
            found += np.einsum("sn,snp->np", shares.T[begin : begin + some], moved @ stack)
        return -balanced(found, self._integrals.harmonics)

    def by_softness(self) -> np.ndarray:
        return self._by_compliance(self._integrals.unit)

    def by_stiffness(self) -> np.ndarray:
        return self._by_compliance(-1.0 / np.asarray(self._integrals.law.stiffness))


class _SampledForces(CoupledForces):
    """At samples, of any law: lambda = h(s - D lambda), d lambda = S (ds - dD lambda), S = h' (I
    + D h')^-1, or where it is piecewise linear the inverse of D on the closed pairs."""

    def __init__(self, integrals: CoupledIntegrals, gap: np.ndarray) -> None:
        self._integrals, contact = integrals, integrals.contact
        samples = integrals.samples or default_samples(integrals.harmonics)
        values = sampled(gap, samples)
        if integrals.piecewise:
            self._force, closed = contact.solve(values)
            self._slope = contact.stack(closed)
        else:
            self._force, self._slope = smooth_forces(integrals.law, contact.compliance, values)
        count = instants(integrals.harmonics)
        spectrum = scipy.fft.rfft(self._slope, axis=0)[: 2 * integrals.harmonics + 1]
        cut_off = scipy.fft.irfft(spectrum * (count / samples), n=count, axis=0)
        self.tangent = CoupledTangent(integrals.harmonics, cut_off)
        self.force = balanced(self._force, integrals.harmonics)

    def _by_gap(self, change: np.ndarray) -> np.ndarray:
        """Of gaps that change by so much, (samples, n_pairs)."""
        return balanced(np.einsum("npq,nq->np", self._slope, change), self._integrals.harmonics)

    def by_softness(self) -> np.ndarray:
        return self._by_gap(-self._integrals.unit * self._force)

    def by_stiffness(self) -> np.ndarray:
        if self._integrals.piecewise:
            return self._by_gap(self._force / np.asarray(self._integrals.law.stiffness))
        # d lambda = (I + h' D)^-1 lambda = lambda - S D lambda.
        return self.force - self._by_gap(self._force @ self._integrals.contact.compliance)
