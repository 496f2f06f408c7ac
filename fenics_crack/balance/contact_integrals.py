"""Fourier coefficients of the contact force and their derivative, from those of the gap.

    b_0 = 1/T int lambda dt,   b_k = 2/T int lambda cos(k w t) dt  or  sin(k w t)          (eq. 7)

There are two ways. *Sampled*: the trapezoidal rule on N instants, for any law; kinks let the error
fall like N^-2. *Exact*: a law that is linear in contact is integrated in closed form between the
switching instants. In both the force is locally kappa(t) g(t). Both tangents (eq. 14) consist of
c_m and s_m, the means of kappa cos(m theta) and kappa sin(m theta): for rows i and columns j

    d a_i/d a_j:  c_{i-j} + c_{i+j}      d a_i/d b_j:  s_{i+j} - s_{i-j}
    d b_i/d a_j:  s_{i+j} + s_{i-j}      d b_i/d b_j:  c_{i-j} - c_{i+j},      i, j >= 1,

a Toeplitz plus a Hankel matrix for each pair. The row of the mean has c_0, c_j, s_j, and the column
of the mean 2 c_i, 2 s_i.

A static compliance couples pairs: the forces lambda follow from all slow gaps s = g + R_inf lambda.
With S_A the stiffness for the set A of closed pairs (:mod:`fenics_crack.model.contact`), lambda =
S_A(t) s(t). For s with H harmonics the product needs only the means

    S_m = 1/(2 pi) int S(theta) exp(i m theta) d theta,        m = 0 .. 2H.

*Exact*: the kernel finds the events at which a pair opens or closes, and the means are sums over
events (``kernel/intervals.h``, ``coupled_forces.h``). *Sampled*: S is the tangent at every sample.
In both, T v is found on N > 4H instants. S is cut off above 2H harmonics, so that products are
exact.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Self

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.kernel import NULL, attach_destructor, kernel, pointer, require_shape
from fenics_crack.model.contact import (
    ActiveSetSolver,
    ContactLaw,
    is_piecewise_linear,
    is_unilateral,
    smooth_forces_and_slopes,
)
from fenics_crack.numerics.fourier import (
    count_instants,
    fourier_coefficients,
    from_complex,
    sample_period,
)


class ContactForces(ABC):
    """Fourier coefficients b of the contact forces, and derivatives.

    T = db/ds is the derivative by the coefficients of the slow gap s, the gap less its quasi-static
    part.

    Attributes
    ----------
    force : (2H+1, n_pairs) [N]
        b.
    """

    force: np.ndarray

    @abstractmethod
    def apply(self, change: np.ndarray) -> np.ndarray:
        """Return the forces' change T ds by a gap's change ds, both (2H+1, n_pairs)."""

    @abstractmethod
    def identity_plus(self, matrices: np.ndarray, basis: np.ndarray | None = None) -> np.ndarray:
        """Return the dense Jacobian I + R T of s + R b(s), with T = db/ds.

        Parameters
        ----------
        matrices : (H+1, n, n) complex [m/N]
            R_k, compliance of the pairs at harmonic k.
        basis : (n_pairs, n), optional
            Orthonormal basis U of gaps. The matrix is then I + R U^T T U, with R in this basis.

        Returns
        -------
        ((2H+1) n, (2H+1) n)
            Entries are ordered (coefficient, pair).
        """

    @abstractmethod
    def by_softness(self) -> np.ndarray:
        """Return the derivative of the forces b by the softness: (2H+1, n_pairs) [N].

        The softness is a compliance in series with all pairs, over the problem's unit of it.
        """

    @abstractmethod
    def by_log_stiffness(self) -> np.ndarray:
        """Return the derivative of b by ln k, k the contact stiffness: (2H+1, n_pairs) [N]."""


@dataclass(frozen=True)
class ContactIntegrals(ABC):
    """Integrals of the contact forces over a period, for slow gaps s (2H+1, n_pairs).

    Attributes
    ----------
    law : ContactLaw
        Law for all pairs.
    harmonics : int
        H, the highest harmonic.
    residual_compliance : (n_pairs, n_pairs) [m/N] or None
        R_inf, the compliance in series with contact: s = g + R_inf lambda; None: s = g.
    softness : float
        Further compliance in series with every pair, in units of ``unit``.
    """

    law: ContactLaw
    harmonics: int
    residual_compliance: np.ndarray | None = field(default=None, kw_only=True)
    softness: float = field(default=0.0, kw_only=True)

    has_coupled_pairs: ClassVar[bool] = False
    """True if the force on a pair depends on the gaps of others."""

    @property
    def exact(self) -> bool:
        """True if the integrals are exact, without samples in time."""
        return False

    @cached_property
    def spring_compliance(self) -> np.ndarray:
        """Return 1/k, with the contact stiffness k of each pair or of all [m/N].

        A law without penetration has zero.
        """
        return np.asarray(1.0 / np.asarray(self.law.stiffness, dtype=float))

    @cached_property
    def compliance_diagonal(self) -> np.ndarray:
        """Return each pair's own compliance: (n_pairs,), or one number [m/N].

        It is the diagonal of static compliance plus contact springs, R_inf + I/k.
        """
        return (
            self.spring_compliance
            if self.residual_compliance is None
            else np.diag(self.residual_compliance) + self.spring_compliance
        )

    @cached_property
    def unit(self) -> float:
        """Return the pairs' mean compliance, the mean diagonal of R_inf + I/k [m/N]."""
        return float(np.mean(self.compliance_diagonal))

    @abstractmethod
    def forces_in_time(self, gap: np.ndarray) -> np.ndarray:
        """Return the contact forces for slow gaps at n instants, both (n, n_pairs) [m], [N]."""

    @abstractmethod
    def linearise(self, gap: np.ndarray) -> ContactForces:
        """Return the forces' coefficients and derivatives for a gap (2H+1, n_pairs) [m]."""

    def force(self, gap: np.ndarray) -> np.ndarray:
        """Return the forces' coefficients for a gap (2H+1, n_pairs) [m]: same shape [N]."""
        return self.linearise(gap).force

    def with_harmonics(self, harmonics: int) -> Self:
        """Return integrals with another number of harmonics, and enough samples for them."""
        return replace(self, harmonics=harmonics)

    def refine(self) -> ContactIntegrals | None:
        """Return exact integrals, or integrals with more samples; None if exact already."""
        return None

    def with_softness(self, softness: float) -> Self:
        """Return integrals with another compliance in series with every pair."""
        return self if softness == self.softness else replace(self, softness=softness)


def contact_integrals(
    law: ContactLaw, harmonics: int, samples: int | None = None, periods: int = 1
) -> PairIntegrals:
    """Return integrals for uncoupled pairs.

    The integrals are exact if the law is piecewise linear and no samples are requested. Otherwise
    ``samples`` is the number of instants in the period; default: :func:`default_samples` for each
    of the load's ``periods`` in it.
    """
    if samples is None and is_piecewise_linear(law):
        return ExactIntegrals(law, harmonics)
    return SampledIntegrals(law, harmonics, samples or periods * default_samples(harmonics))


def default_samples(harmonics: int) -> int:
    """Return the default number of instants.

    It is 1024, or the next power of two from 32 H on if that is larger.
    """
    return max(1024, 1 << (32 * harmonics - 1).bit_length())


@dataclass(frozen=True)
class SampledIntegrals(ContactIntegrals):
    """Trapezoidal rule on N equally spaced instants, by the fast Fourier transform.

    Forces are proportional to k, and a softness in series divides k by 1 + softness. N > 4 H; with
    N = 2H+1, as many instants as coefficients, the method is collocation.
    """

    samples: int
    """N, number of instants in the period."""

    def forces_in_time(self, gap: np.ndarray) -> np.ndarray:
        return self.law.force(gap)

    def linearise(self, gap: np.ndarray) -> PairForces:
        gap_samples, law = sample_period(gap, self.samples), self.law
        if self.softness:
            law = law.scaled(1.0 / (1.0 + self.softness))
        # Means of exp(i m theta), m < 2 H + 1; with few instants high orders alias to low ones.
        order = np.arange(2 * self.harmonics + 1) % self.samples
        slope_means = np.fft.fft(law.tangent(gap_samples), axis=0)[order] / self.samples
        tangents = [
            tangent_from_means(means[:, None, None])[:, 0] for means in from_complex(slope_means).T
        ]
        force = fourier_coefficients(law.force(gap_samples), self.harmonics)
        return PairForces(force, np.array(tangents), -force / (1.0 + self.softness))

    def refine(self) -> ContactIntegrals:
        if is_piecewise_linear(self.law):
            return ExactIntegrals(self.law, self.harmonics)
        return replace(self, samples=max(4 * self.samples, default_samples(self.harmonics)))

    def with_harmonics(self, harmonics: int) -> Self:
        samples = max(self.samples, 1 << (8 * harmonics - 1).bit_length())
        return replace(self, harmonics=harmonics, samples=samples)


@dataclass(frozen=True)
class ExactIntegrals(ContactIntegrals):
    """Integrals in closed form between the switching instants, for lambda = k max(g, 0).

    With kappa = k while the pair is closed, else 0,

        c_m + i s_m = k / (2 pi) sum int exp(i m theta) d theta.

    Since lambda = kappa g, the coefficients of the force are the tangent times those of the gap. A
    diagonal R_inf = D_0 replaces k by 1 / (D_0 + 1/k), and k may then be infinite.
    """

    @property
    def exact(self) -> bool:
        return True

    @property
    def closed_stiffness(self) -> np.ndarray:
        """Return the slope d lambda / ds of a closed pair's force: (n_pairs,), or one [N/m]."""
        return np.asarray(1.0 / (self.compliance_diagonal + self.softness * self.unit))

    def forces_in_time(self, gap: np.ndarray) -> np.ndarray:
        return np.asarray(self.closed_stiffness * np.maximum(gap, 0.0))

    def linearise(self, gap: np.ndarray) -> PairForces:
        n_rows, n_pairs = gap.shape
        gap = require_shape(gap, 2 * self.harmonics + 1, n_pairs)
        stiffness = np.full(n_pairs, self.closed_stiffness)
        force, tangent = np.empty((n_rows, n_pairs)), np.empty((n_pairs, n_rows, n_rows))
        is_out_of_memory = kernel.contact_integrals(
            self.harmonics, n_pairs, pointer(gap), pointer(stiffness),
            pointer(grid_waves(self.harmonics)), pointer(np.empty(2 * n_pairs * n_rows)),
            pointer(force), pointer(tangent),
        )  # fmt: skip
        if is_out_of_memory:
            raise MemoryError("contact integrals")
        return PairForces(force, tangent, -self.unit * stiffness * force)


PairIntegrals = ExactIntegrals | SampledIntegrals


class PairForces(ContactForces):
    """Fourier coefficients of the forces on uncoupled pairs.

    Attributes
    ----------
    tangent : (n_pairs, 2H+1, 2H+1) [N/m]
        Derivative of a pair's force by its gap.
    """

    def __init__(self, force: np.ndarray, tangent: np.ndarray, by_softness: np.ndarray) -> None:
        self.force, self.tangent, self._by_softness = force, tangent, by_softness

    def apply(self, change: np.ndarray) -> np.ndarray:
        return np.matmul(self.tangent, change.T[:, :, None])[:, :, 0].T

    def identity_plus(self, matrices: np.ndarray, basis: np.ndarray | None = None) -> np.ndarray:
        assert basis is None
        jacobian = respond_to_columns(matrices, self.tangent)
        jacobian.flat[:: len(jacobian) + 1] += 1.0
        return jacobian

    def by_log_stiffness(self) -> np.ndarray:
        """Return the forces' derivative by ln k.

        Forces of uncoupled pairs are proportional to k: the derivative is the forces.
        """
        return self.force

    def by_softness(self) -> np.ndarray:
        return self._by_softness


def respond(matrices: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Multiply contact forces (2H+1, n_pairs) [N] by the compliance R_k of each harmonic.

    ``matrices`` are R_k: (H+1, n_pairs, n_pairs) complex [m/N].
    """
    n_rows, n_pairs = force.shape
    matrices = require_shape(matrices, n_rows // 2 + 1, n_pairs, n_pairs, kind=complex)
    force, response = (
        require_shape(force, 2 * (n_rows // 2) + 1, n_pairs),
        np.empty((n_rows, n_pairs)),
    )
    kernel.respond(n_rows // 2, n_pairs, pointer(matrices), pointer(force), pointer(response))
    return response


def respond_to_columns(matrices: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """Return the compliance times the forces' derivative, R T, as a dense matrix.

    On coefficients (a, b) of a force a - i b, R_k is the real matrix [[Re R_k, Im R_k], [-Im R_k,
    Re R_k]].

    Parameters
    ----------
    matrices : (H+1, n_pairs, n_pairs) complex
        Compliance R_k at harmonic k.
    tangent : (n_pairs, 2H+1, n)
        T of each pair: derivative of a force's coefficients by n unknowns.

    Returns
    -------
    ((2H+1) n_pairs, n n_pairs)
        Rows are ordered (coefficient, pair), columns (unknown, pair).
    """
    n_pairs, n_rows, n_columns = tangent.shape
    matrices = require_shape(matrices, n_rows // 2 + 1, n_pairs, n_pairs, kind=complex)
    tangent = require_shape(tangent, n_pairs, 2 * (n_rows // 2) + 1, n_columns)
    product = np.empty((n_rows * n_pairs, n_columns * n_pairs))
    arrays = map(pointer, (matrices, tangent, product))
    kernel.respond_to_columns(n_rows // 2, n_pairs, n_columns, *arrays)
    return product


@lru_cache(maxsize=64)
def grid_waves(harmonics: int) -> np.ndarray:
    """Return cos k theta and sin k theta on a quarter period.

    The kernel searches for sign changes of gaps on this grid: (H, 2, n_instants), k = 1 to H.
    """
    waves = np.empty((harmonics, 2, kernel.switching_cells(harmonics) // 4 + 1))
    kernel.switching_waves(harmonics, pointer(waves))
    return waves


def tangent_from_means(means: np.ndarray) -> np.ndarray:
    """Return the derivative of forces by gaps from means of the contact stiffness.

    Parameters
    ----------
    means : (4H+1, n, n)
        Means over the period of the stiffness of n pairs: c_0, c_1, s_1, ..., with factors
        cos(m theta) and sin(m theta).

    Returns
    -------
    (2H+1, n, (2H+1) n)
        For each coefficient of a pair's force: by the gaps' coefficients, ordered (coefficient,
        pair).
    """
    harmonics, n_pairs = len(means) // 4, means.shape[1]
    means, n_rows = require_shape(means, 4 * harmonics + 1, n_pairs, n_pairs), 2 * harmonics + 1
    tangent = np.empty((n_rows, n_pairs, n_rows * n_pairs))
    for k in range(harmonics + 1):
        row = max(0, 2 * k - 1)
        kernel.tangent_of_harmonic(harmonics, n_pairs, k, pointer(means), pointer(tangent[row:]))
    return tangent


# --- coupled pairs -------------------------------------------------------------------------------


@dataclass(frozen=True)
class CoupledIntegrals(ContactIntegrals):
    """Integrals of contact forces on pairs that the static compliance R_inf couples.

    Attributes
    ----------
    samples : int or None
        Instants per period; None: exact integrals.
    shared_sets : ActiveSetSolver or None
        Active sets of other integrals with the same law and R_inf, with their inverses.
    """

    samples: int | None = None
    shared_sets: ActiveSetSolver | None = field(default=None, repr=False, compare=False)
    has_coupled_pairs: ClassVar[bool] = True

    @cached_property
    def active_sets(self) -> ActiveSetSolver:
        """Return the sets of closed pairs for R_inf + I/k and the softness."""
        if self.shared_sets is not None:
            return self.shared_sets
        assert self.residual_compliance is not None
        softness = self.softness * self.unit + (
            self.spring_compliance if self.is_piecewise else 0.0
        )
        return ActiveSetSolver(
            self.residual_compliance + softness * np.eye(len(self.residual_compliance))
        )

    @property
    def is_piecewise(self) -> bool:
        """True if the forces are piecewise linear in the slow gap s."""
        return is_unilateral(self.law)

    @property
    def exact(self) -> bool:
        """True if the integrals are exact."""
        return self.is_piecewise and self.samples is None

    def with_harmonics(self, harmonics: int) -> Self:
        samples = self.samples and max(self.samples, default_samples(harmonics))
        return replace(self, harmonics=harmonics, samples=samples, shared_sets=self.active_sets)

    def refine(self) -> Self | None:
        if self.exact:
            return None
        samples = 4 * (self.samples or default_samples(self.harmonics))
        return replace(self, samples=None if self.is_piecewise else samples)

    def forces_in_time(self, gap: np.ndarray) -> np.ndarray:
        if self.is_piecewise:
            return self.active_sets.solve(gap)[0]
        return smooth_forces_and_slopes(self.law, self.active_sets.compliance, gap)[0]

    def linearise(self, gap: np.ndarray) -> CoupledForces:
        return _ExactForces(self, gap) if self.exact else _SampledForces(self, gap)


class CoupledForces(ContactForces):
    """Coefficients of contact forces that follow from the gaps of all pairs."""

    @abstractmethod
    def tangent(self, basis: np.ndarray | None = None) -> np.ndarray:
        """Return the derivative T of forces by gaps.

        With a basis U (n_pairs, n) of gaps, return U^T T U.

        Returns
        -------
        (2H+1, n, (2H+1) n) [N/m]
            For each coefficient of a pair's force: by the gaps', ordered (coefficient, pair).
        """

    def identity_plus(self, matrices: np.ndarray, basis: np.ndarray | None = None) -> np.ndarray:
        tangent = self.tangent(basis)
        cosine_rows, sine_rows = tangent[1::2], tangent[2::2]
        real_part, imaginary_part = matrices[1:].real, matrices[1:].imag
        jacobian = np.empty_like(tangent)
        jacobian[0] = matrices[0].real @ tangent[0]
        jacobian[1::2] = np.matmul(real_part, cosine_rows) + np.matmul(imaginary_part, sine_rows)
        jacobian[2::2] = np.matmul(real_part, sine_rows) - np.matmul(imaginary_part, cosine_rows)
        matrix = jacobian.reshape(tangent.shape[2], -1)
        matrix.flat[:: len(matrix) + 1] += 1.0
        return matrix


class _KernelEvaluator:
    """C object that computes forces for given numbers of harmonics and pairs.

    ``evaluated_forces`` are the forces whose gap it evaluated last.
    """

    def __init__(self, harmonics: int, n_pairs: int) -> None:
        new_object = kernel.new_coupled_forces(harmonics, n_pairs)
        self.handle = attach_destructor(new_object, kernel.free_coupled_forces)
        self.evaluated_forces: CoupledForces | None = None


_kernel_evaluator_for = lru_cache(maxsize=16)(_KernelEvaluator)


class _ExactForces(CoupledForces):
    """Exact forces by the kernel, whose C object may serve several gaps in turn."""

    def __init__(self, integrals: CoupledIntegrals, gap: np.ndarray) -> None:
        self._integrals, self.harmonics = integrals, integrals.harmonics
        n_pairs = len(integrals.active_sets.compliance)
        self._gap = require_shape(gap, 2 * self.harmonics + 1, n_pairs)
        self.force = np.empty_like(self._gap)
        self._evaluate_in_kernel()

    def _evaluate_in_kernel(self) -> Any:
        """Return the C object, evaluated at the gap of these forces.

        Raises ConvergenceError if an instant has no forces.
        """
        kernel_evaluator = _kernel_evaluator_for(self.harmonics, self._gap.shape[1])
        active_sets = self._integrals.active_sets
        if kernel_evaluator.evaluated_forces is not self:
            kernel_evaluator.evaluated_forces = None
            arrays = map(pointer, (active_sets.compliance, self._gap, self.force))
            outcome = kernel.find_forces(kernel_evaluator.handle, *arrays)
            if outcome == kernel.NO_MEMORY:
                raise MemoryError("contact forces")
            if outcome != kernel.FOUND:
                raise ConvergenceError("contact: no forces were found at an instant of the period")
            kernel_evaluator.evaluated_forces = self
        return kernel_evaluator.handle

    def apply(self, change: np.ndarray) -> np.ndarray:
        change, force_change = require_shape(change, *self._gap.shape), np.empty(self._gap.shape)
        kernel.forces_by_gap(self._evaluate_in_kernel(), pointer(change), pointer(force_change))
        return force_change

    def tangent(self, basis: np.ndarray | None = None) -> np.ndarray:
        n_pairs = self._gap.shape[1]
        n_columns = n_pairs if basis is None else basis.shape[1]
        means = np.empty((4 * self.harmonics + 1, n_columns, n_columns))
        basis_pointer = NULL if basis is None else pointer(require_shape(basis, n_pairs, n_columns))
        if kernel.means_of_stiffness(
            self._evaluate_in_kernel(), basis_pointer, n_columns, pointer(means)
        ):
            raise MemoryError("contact forces")
        return tangent_from_means(means)

    def _by_diagonal_compliance(self, rate: np.ndarray) -> np.ndarray:
        """Return the forces' derivative (2H+1, n_pairs) by the series compliance.

        The diagonal of D = R_inf + I/k plus the softness grows at a rate (n_pairs,).
        """
        derivative, rate = np.empty(self._gap.shape), require_shape(rate, self._gap.shape[1])
        kernel.forces_by_compliance(self._evaluate_in_kernel(), pointer(rate), pointer(derivative))
        return derivative

    def by_softness(self) -> np.ndarray:
        return self._by_diagonal_compliance(np.full(self._gap.shape[1], self._integrals.unit))

    def by_log_stiffness(self) -> np.ndarray:
        return self._by_diagonal_compliance(
            np.broadcast_to(-self._integrals.spring_compliance, self._gap.shape[1])
        )


class _SampledForces(CoupledForces):
    """Forces from samples in time, for any law h(g).

        lambda = h(s - D lambda),    d lambda = S (ds - dD lambda),    S = h' (I + D h')^-1

    D is R_inf plus the softness. If the law is piecewise linear, D includes I/k, and S is the
    inverse of D on the closed pairs.
    """

    def __init__(self, integrals: CoupledIntegrals, gap: np.ndarray) -> None:
        self._integrals, self.harmonics = integrals, integrals.harmonics
        active_sets = integrals.active_sets
        gap_samples = sample_period(gap, integrals.samples or default_samples(integrals.harmonics))
        if integrals.is_piecewise:
            self._force_samples, closed_sets = active_sets.solve(gap_samples)
            self._slope_samples = active_sets.invert_sets(closed_sets)
        else:
            self._force_samples, self._slope_samples = smooth_forces_and_slopes(
                integrals.law, active_sets.compliance, gap_samples
            )
        self._slope_coefficients = fourier_coefficients(self._slope_samples, 2 * self.harmonics)
        self._band_limited_slope = sample_period(
            self._slope_coefficients, count_instants(self.harmonics)
        )
        self.force = fourier_coefficients(self._force_samples, self.harmonics)

    def apply(self, change: np.ndarray) -> np.ndarray:
        gap_changes = sample_period(change, len(self._band_limited_slope))
        force_changes = np.empty_like(gap_changes)
        kernel.multiply_each(
            *gap_changes.shape,
            *map(pointer, (self._band_limited_slope, gap_changes, force_changes)),
        )
        return fourier_coefficients(force_changes, self.harmonics)

    def tangent(self, basis: np.ndarray | None = None) -> np.ndarray:
        means = np.concatenate([self._slope_coefficients[:1], 0.5 * self._slope_coefficients[1:]])
        return tangent_from_means(means if basis is None else basis.T @ means @ basis)

    def _force_change(self, change: np.ndarray) -> np.ndarray:
        """Return the forces' change (2H+1, n_pairs) for gaps' changes (samples, n_pairs)."""
        return fourier_coefficients(
            np.einsum("npq,nq->np", self._slope_samples, change), self.harmonics
        )

    def by_softness(self) -> np.ndarray:
        return self._force_change(-self._integrals.unit * self._force_samples)

    def by_log_stiffness(self) -> np.ndarray:
        if self._integrals.is_piecewise:
            return self._force_change(self._force_samples * self._integrals.spring_compliance)
        # d lambda = (I + h' D)^-1 lambda = lambda - S D lambda.
        return self.force - self._force_change(
            self._force_samples @ self._integrals.active_sets.compliance
        )
