"""Fourier coefficients of the contact force and their derivative, from those of the gap.

    b_0 = 1/T int lambda dt,   b_k = 2/T int lambda cos(k w t) dt  or  sin(k w t)          (eq. 7)

Two ways. *Sampled*: the trapezoidal rule on N instants; any law; the error falls like N^-2 because
of the kinks. *Exact*: a law that is linear in contact is integrated in closed form between the
switching instants. In both the force is locally kappa(t) g(t), so that both tangents (eq. 14)
consist of c_m and s_m, the means of kappa cos(m theta) and kappa sin(m theta): for rows and columns
i, j

    d a_i/d a_j:  c_{i-j} + c_{i+j}      d a_i/d b_j:  s_{i+j} - s_{i-j}
    d b_i/d a_j:  s_{i+j} + s_{i-j}      d b_i/d b_j:  c_{i-j} - c_{i+j},      i, j >= 1,

a Toeplitz plus a Hankel matrix for each pair, with c_0, c_j, s_j in the row of the mean and 2 c_i,
2 s_i in its column.

Forces of pairs that a static compliance couples follow from the gaps of all: with S_A the stiffness
of the set A of closed pairs (:mod:`fenics_crack.model.contact`), lambda = S_A(t) s(t). The
coefficients of its product with a wave s of H harmonics need no more of S than its means

    S_m = 1/(2 pi) int S(theta) exp(i m theta) d theta,        m = 0 .. 2H.

*Exact*: the kernel finds the events at which a pair opens or closes, and the means are sums over
them (``kernel/intervals.h``, ``coupled_forces.h``). *Sampled*: S is the tangent at every sample. In
both, T v is found on N > 4H instants, with S cut off after 2H harmonics, where products are exact.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Self

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.kernel import NULL, kernel, owned, pointer, shaped
from fenics_crack.model.contact import (
    ActiveSets,
    ContactLaw,
    is_piecewise_linear,
    is_unilateral,
    smooth_forces,
)
from fenics_crack.numerics.fourier import (
    count_instants,
    fourier_coefficients,
    from_complex,
    sample_period,
)


class ContactForces(ABC):
    """Coefficients of the contact forces of a gap s, and their derivatives.

    Attributes
    ----------
    force : (2H+1, n_pairs) [N]
    """

    force: np.ndarray

    @abstractmethod
    def apply(self, change: np.ndarray) -> np.ndarray:
        """T ds of a change (2H+1, n_pairs)."""

    @abstractmethod
    def identity_plus(self, matrices: np.ndarray, basis: np.ndarray | None = None) -> np.ndarray:
        """I + R T from R_k (H+1, n, n), as a dense matrix for unknowns ordered (row, pair); with a
        basis U (n_pairs, n) that of U^T T U."""

    @abstractmethod
    def by_softness(self) -> np.ndarray:
        """Derivative of the coefficients by the series compliance."""

    @abstractmethod
    def by_stiffness(self) -> np.ndarray:
        """Derivative of the coefficients by ln k."""


@dataclass(frozen=True)
class ContactIntegrals(ABC):
    """A way of integrating the contact forces of gaps s (2H+1, n_pairs).

    Attributes
    ----------
    law : ContactLaw
        Of all pairs.
    harmonics : int
        H.
    residual : (n_pairs, n_pairs) [m/N] or None
        R_inf, through which the pairs are seen, s = g + R_inf lambda; None: by themselves, s = g.
    softness : float
        Compliance put in series with every pair, in parts of ``unit``.
    """

    law: ContactLaw
    harmonics: int
    residual: np.ndarray | None = field(default=None, kw_only=True)
    softness: float = field(default=0.0, kw_only=True)

    coupled: ClassVar[bool] = False
    """True if the force of a pair depends on the gaps of others."""

    @property
    def exact(self) -> bool:
        """True if the integrals are exact, without AFT samples."""
        return False

    @cached_property
    def springs(self) -> np.ndarray:
        """1/k of each pair, or one for all; zero without penetration [m/N]."""
        return np.asarray(1.0 / np.asarray(self.law.stiffness, dtype=float))

    @cached_property
    def seen(self) -> np.ndarray:
        """Diagonal of R_inf + I/k: (n_pairs,), or one for all [m/N]."""
        return self.springs if self.residual is None else np.diag(self.residual) + self.springs

    @cached_property
    def unit(self) -> float:
        """Mean diagonal of R_inf + I/k [m/N]."""
        return float(np.mean(self.seen))

    @abstractmethod
    def forces(self, gap: np.ndarray) -> np.ndarray:
        """lambda(s) at instants, of values (n, n_pairs): the same shape [N]."""

    @abstractmethod
    def linearise(self, gap: np.ndarray) -> ContactForces:
        """The forces' coefficients and their derivatives."""

    def force(self, gap: np.ndarray) -> np.ndarray:
        """The coefficients alone: (2H+1, n_pairs) [N]."""
        return self.linearise(gap).force

    def widened(self, harmonics: int) -> Self:
        """The same with more harmonics, and samples enough for them."""
        return replace(self, harmonics=harmonics)

    def finer(self) -> ContactIntegrals | None:
        """The same exactly, or with more samples; None where nothing is sampled."""
        return None

    def with_softness(self, softness: float) -> Self:
        """The same with another compliance in series."""
        return self if softness == self.softness else replace(self, softness=softness)


def contact_integrals(
    law: ContactLaw, harmonics: int, samples: int | None = None, periods: int = 1
) -> PairIntegrals:
    """Exact integrals where the law is piecewise linear and no samples are requested; else sampled
    ones, by default :func:`default_samples` for each of the load's ``periods``."""
    if samples is None and is_piecewise_linear(law):
        return ExactIntegrals(law, harmonics)
    return SampledIntegrals(law, harmonics, samples or periods * default_samples(harmonics))


def default_samples(harmonics: int) -> int:
    """1024 instants, or the power of two from 32 H on."""
    return max(1024, 1 << (32 * harmonics - 1).bit_length())


@dataclass(frozen=True)
class SampledIntegrals(ContactIntegrals):
    """Trapezoidal rule on N equally spaced instants, by the fast Fourier transform.

    Forces are proportional to k, and a softness in series divides it by 1 + softness. N > 4 H;
    N = 2H+1, as many instants as coefficients, is collocation.
    """

    samples: int
    """N, AFT samples of the period."""

    def forces(self, gap: np.ndarray) -> np.ndarray:
        return self.law.force(gap)

    def linearise(self, gap: np.ndarray) -> PairForces:
        values, law = sample_period(gap, self.samples), self.law
        if self.softness:
            law = law.scaled(1.0 / (1.0 + self.softness))
        # Means of exp(i m theta), m < 2 H + 1; at few instants those of high order are others'.
        order = np.arange(2 * self.harmonics + 1) % self.samples
        slopes = np.fft.fft(law.tangent(values), axis=0)[order] / self.samples
        tangent = [tangent_by_means(means[:, None, None])[:, 0] for means in from_complex(slopes).T]
        force = fourier_coefficients(law.force(values), self.harmonics)
        return PairForces(force, np.array(tangent), -force / (1.0 + self.softness))

    def finer(self) -> ContactIntegrals:
        if is_piecewise_linear(self.law):
            return ExactIntegrals(self.law, self.harmonics)
        return replace(self, samples=max(4 * self.samples, default_samples(self.harmonics)))

    def widened(self, harmonics: int) -> Self:
        samples = max(self.samples, 1 << (8 * harmonics - 1).bit_length())
        return replace(self, harmonics=harmonics, samples=samples)


@dataclass(frozen=True)
class ExactIntegrals(ContactIntegrals):
    """Closed form between the switching instants, for lambda = k max(g, 0).

    With kappa = k where the pair is closed, else 0,

        c_m + i s_m = k / (2 pi) sum int exp(i m theta) d theta,

    and since lambda = kappa g, the coefficients of the force are just the tangent times the gap's.
    A diagonal R_inf = D_0 puts 1 / (D_0 + 1/k) in the place of k, which may then be infinite.
    """

    @property
    def exact(self) -> bool:
        return True

    @property
    def stiffness(self) -> np.ndarray:
        """Slope of the forces of closed pairs: (n_pairs,) or one for all [N/m]."""
        return np.asarray(1.0 / (self.seen + self.softness * self.unit))

    def forces(self, gap: np.ndarray) -> np.ndarray:
        return np.asarray(self.stiffness * np.maximum(gap, 0.0))

    def linearise(self, gap: np.ndarray) -> PairForces:
        rows, pairs = gap.shape
        gap = shaped(gap, 2 * self.harmonics + 1, pairs)
        stiffness = np.full(pairs, self.stiffness)
        force, tangent = np.empty((rows, pairs)), np.empty((pairs, rows, rows))
        failed = kernel.contact_integrals(
            self.harmonics, pairs, pointer(gap), pointer(stiffness),
            pointer(grid_waves(self.harmonics)), pointer(np.empty(2 * pairs * rows)),
            pointer(force), pointer(tangent),
        )  # fmt: skip
        if failed:
            raise MemoryError("contact integrals")
        return PairForces(force, tangent, -self.unit * stiffness * force)


PairIntegrals = ExactIntegrals | SampledIntegrals


class PairForces(ContactForces):
    """Forces of uncoupled pairs: local contact.

    Attributes
    ----------
    tangent : (n_pairs, 2H+1, 2H+1) [N/m]
        T, pair by pair.
    """

    def __init__(self, force: np.ndarray, tangent: np.ndarray, by_softness: np.ndarray) -> None:
        self.force, self.tangent, self._by_softness = force, tangent, by_softness

    def apply(self, change: np.ndarray) -> np.ndarray:
        return np.matmul(self.tangent, change.T[:, :, None])[:, :, 0].T

    def identity_plus(self, matrices: np.ndarray, basis: np.ndarray | None = None) -> np.ndarray:
        assert basis is None
        found = respond_to_columns(matrices, self.tangent)
        found.flat[:: len(found) + 1] += 1.0
        return found

    def by_stiffness(self) -> np.ndarray:
        """Forces of pairs by themselves are proportional to k."""
        return self.force

    def by_softness(self) -> np.ndarray:
        return self._by_softness


def respond(matrices: np.ndarray, force: np.ndarray) -> np.ndarray:
    """R lambda of coefficients (2H+1, n_pairs)."""
    rows, pairs = force.shape
    matrices = shaped(matrices, rows // 2 + 1, pairs, pairs, kind=complex)
    force, found = shaped(force, 2 * (rows // 2) + 1, pairs), np.empty((rows, pairs))
    kernel.respond(rows // 2, pairs, pointer(matrices), pointer(force), pointer(found))
    return found


def respond_to_columns(matrices: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """R T as a dense matrix for unknowns ordered (row, pair), from R_k (H+1, n_pairs, n_pairs)
    and T (n_pairs, 2H+1, n): ((2H+1) n_pairs, n n_pairs).

    A force a - i b on harmonic k moves the gap by R_k (a - i b), that is by the real matrix
    [[Re R_k, Im R_k], [-Im R_k, Re R_k]] on (a, b).
    """
    pairs, rows, columns = tangent.shape
    matrices = shaped(matrices, rows // 2 + 1, pairs, pairs, kind=complex)
    tangent = shaped(tangent, pairs, 2 * (rows // 2) + 1, columns)
    product = np.empty((rows * pairs, columns * pairs))
    arrays = map(pointer, (matrices, tangent, product))
    kernel.respond_to_columns(rows // 2, pairs, columns, *arrays)
    return product


@lru_cache(maxsize=64)
def grid_waves(harmonics: int) -> np.ndarray:
    """Waves on the first grid of the search, as the kernel takes them."""
    waves = np.empty((harmonics, 2, kernel.switching_cells(harmonics) // 4 + 1))
    kernel.switching_waves(harmonics, pointer(waves))
    return waves


def tangent_by_means(means: np.ndarray) -> np.ndarray:
    """T from the means c_0, c_1, s_1, ... of slopes of n pairs, (4H+1, n, n): row by row, each for
    unknowns ordered (row, pair), (2H+1, n, (2H+1) n)."""
    harmonics, count = len(means) // 4, means.shape[1]
    means, rows = shaped(means, 4 * harmonics + 1, count, count), 2 * harmonics + 1
    found = np.empty((rows, count, rows * count))
    for k in range(harmonics + 1):
        first = max(0, 2 * k - 1)
        kernel.tangent_of_harmonic(harmonics, count, k, pointer(means), pointer(found[first:]))
    return found


# --- coupled pairs -------------------------------------------------------------------------------


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
        softness = self.softness * self.unit + (self.springs if self.piecewise else 0.0)
        compliance = self.residual + softness * np.eye(len(self.residual))
        object.__setattr__(self, "contact", ActiveSets(compliance))

    @property
    def piecewise(self) -> bool:
        """True if the forces are piecewise linear in s."""
        return is_unilateral(self.law)

    @property
    def exact(self) -> bool:
        """True if the integrals are exact."""
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

    @abstractmethod
    def tangent(self, basis: np.ndarray | None = None) -> np.ndarray:
        """T as a matrix for unknowns ordered (row, pair), with a basis U (n_pairs, n) U^T T U:
        (2H+1, n, (2H+1) n) [N/m]."""

    def identity_plus(self, matrices: np.ndarray, basis: np.ndarray | None = None) -> np.ndarray:
        tangent = self.tangent(basis)
        even, odd = tangent[1::2], tangent[2::2]
        real, imaginary = matrices[1:].real, matrices[1:].imag
        jacobian = np.empty_like(tangent)
        jacobian[0] = matrices[0].real @ tangent[0]
        jacobian[1::2] = np.matmul(real, even) + np.matmul(imaginary, odd)
        jacobian[2::2] = np.matmul(real, odd) - np.matmul(imaginary, even)
        whole = jacobian.reshape(tangent.shape[2], -1)
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
        self._integrals, self.harmonics = integrals, integrals.harmonics
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
            arrays = map(pointer, (contact.compliance, self._gap, self.force))
            outcome = kernel.find_forces(known.handle, *arrays)
            if outcome == kernel.NO_MEMORY:
                raise MemoryError("contact forces")
            if outcome != kernel.FOUND:
                raise ConvergenceError("contact: no forces were found at an instant of the period")
            known.at = self
        return known.handle

    def apply(self, change: np.ndarray) -> np.ndarray:
        change, found = shaped(change, *self._gap.shape), np.empty(self._gap.shape)
        kernel.forces_by_gap(self._here(), pointer(change), pointer(found))
        return found

    def tangent(self, basis: np.ndarray | None = None) -> np.ndarray:
        pairs = self._gap.shape[1]
        count = pairs if basis is None else basis.shape[1]
        means = np.empty((4 * self.harmonics + 1, count, count))
        seen = NULL if basis is None else pointer(shaped(basis, pairs, count))
        if kernel.means_of_stiffness(self._here(), seen, count, pointer(means)):
            raise MemoryError("contact forces")
        return tangent_by_means(means)

    def _by_compliance(self, rate: np.ndarray) -> np.ndarray:
        """Return the derivative of the forces where the diagonal of D grows by a rate."""
        derivative, rate = np.empty(self._gap.shape), shaped(rate, self._gap.shape[1])
        kernel.forces_by_compliance(self._here(), pointer(rate), pointer(derivative))
        return derivative

    def by_softness(self) -> np.ndarray:
        return self._by_compliance(np.full(self._gap.shape[1], self._integrals.unit))

    def by_stiffness(self) -> np.ndarray:
        return self._by_compliance(np.broadcast_to(-self._integrals.springs, self._gap.shape[1]))


class _SampledForces(CoupledForces):
    """At samples, of any law: lambda = h(s - D lambda), d lambda = S (ds - dD lambda), S = h' (I
    + D h')^-1, or where it is piecewise linear the inverse of D on the closed pairs."""

    def __init__(self, integrals: CoupledIntegrals, gap: np.ndarray) -> None:
        self._integrals, self.harmonics = integrals, integrals.harmonics
        contact = integrals.contact
        values = sample_period(gap, integrals.samples or default_samples(integrals.harmonics))
        if integrals.piecewise:
            self._force, closed = contact.solve(values)
            self._slope = contact.stack(closed)
        else:
            self._force, self._slope = smooth_forces(integrals.law, contact.compliance, values)
        self._waves = fourier_coefficients(self._slope, 2 * self.harmonics)
        self._cut_off = sample_period(self._waves, count_instants(self.harmonics))
        self.force = fourier_coefficients(self._force, self.harmonics)

    def apply(self, change: np.ndarray) -> np.ndarray:
        values = sample_period(change, len(self._cut_off))
        forces = np.empty_like(values)
        kernel.multiply_each(*values.shape, *map(pointer, (self._cut_off, values, forces)))
        return fourier_coefficients(forces, self.harmonics)

    def tangent(self, basis: np.ndarray | None = None) -> np.ndarray:
        means = np.concatenate([self._waves[:1], 0.5 * self._waves[1:]])
        return tangent_by_means(means if basis is None else basis.T @ means @ basis)

    def _by_gap(self, change: np.ndarray) -> np.ndarray:
        """Return the change of the forces due to a change of the gaps, (samples, n_pairs)."""
        return fourier_coefficients(np.einsum("npq,nq->np", self._slope, change), self.harmonics)

    def by_softness(self) -> np.ndarray:
        return self._by_gap(-self._integrals.unit * self._force)

    def by_stiffness(self) -> np.ndarray:
        if self._integrals.piecewise:
            return self._by_gap(self._force * self._integrals.springs)
        # d lambda = (I + h' D)^-1 lambda = lambda - S D lambda.
        return self.force - self._by_gap(self._force @ self._integrals.contact.compliance)
