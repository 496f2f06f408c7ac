"""Fourier coefficients of the contact force and their derivative, from those of the gap.

    b_0 = 1/T int lambda dt,   b_k = 2/T int lambda cos(k w t) dt  or  sin(k w t)          (eq. 7)

There are two ways. *Sampled*: the trapezoidal rule on N instants, for any law; with kinks the error
falls like N^-2. *Exact*: a law that is linear in contact is integrated in closed form between the
switching instants. In both, a small change of the gap changes the force by kappa(t), the law's
slope. The derivative of the coefficients (eq. 14) consists of c_m and s_m, the means of
kappa cos(m theta) and kappa sin(m theta) at the phase theta = w t. For rows i and columns j

    d a_i/d a_j:  c_{i-j} + c_{i+j}      d a_i/d b_j:  s_{i+j} - s_{i-j}
    d b_i/d a_j:  s_{i+j} + s_{i-j}      d b_i/d b_j:  c_{i-j} - c_{i+j},      i, j >= 1,

a Toeplitz plus a Hankel matrix for each pair. The row of the mean has c_0, c_j, s_j, and the column
of the mean 2 c_i, 2 s_i.

A static compliance couples pairs: the forces lambda follow from all slow gaps s = g + R_inf lambda.
With S the stiffness matrix for the present set of closed pairs (:mod:`fenics_crack.model.contact`),
lambda = S(t) s(t). For s with H harmonics the coefficients of lambda need only the means

    S_m = 1/(2 pi) int S(theta) exp(i m theta) d theta,        m = 0 .. 2H.

*Exact*: the kernel finds the events at which a pair opens or closes, and the means are sums over
events (``kernel/intervals.h``, ``coupled_forces.h``). *Sampled*: S is the law's slope at every
sample. In both, the force change by a gap change v is the product S v at N > 4H instants. S is cut
off above 2H harmonics, so that the change's coefficients up to H are exact.
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
    forces_and_slopes_of_smooth_law,
    is_piecewise_linear,
    is_unilateral,
)
from fenics_crack.numerics.fourier import (
    fourier_coefficients,
    from_complex,
    n_instants_for_products,
    sample_period,
)


class ContactForces(ABC):
    """Fourier coefficients of the contact forces, with derivatives.

    The derivatives are by the slow gap: gap plus residual flexibility times contact force.

    Attributes
    ----------
    force : (2H+1, n_pairs) [N]
        Coefficients: mean, then cosine and sine of harmonics 1 to H.
    """

    force: np.ndarray

    @abstractmethod
    def force_change(self, gap_change: np.ndarray) -> np.ndarray:
        """Return the linearised force change for a change of the slow gaps.

        ``gap_change`` [m] and the result [N] are Fourier coefficients, (2H+1, n_pairs) each. The
        slow gap is the gap plus residual flexibility times contact force.
        """

    @abstractmethod
    def identity_plus_compliance_tangent(
        self, compliance_matrices: np.ndarray, gap_basis: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the dense Jacobian I + R T of the harmonic-balance equations.

        R is the compliance. T is the derivative of the contact forces by the slow gap, the gap plus
        residual flexibility times contact force.

        Parameters
        ----------
        compliance_matrices : (H+1, n, n) complex [m/N]
            Compliance R_k of the pairs at harmonic k.
        gap_basis : (n_pairs, n), optional
            Orthonormal basis U of gaps. The matrix is then I + R U^T T U, with R in this basis.

        Returns
        -------
        ((2H+1) n, (2H+1) n)
            Rows and columns are ordered (coefficient, pair).
        """

    @abstractmethod
    def series_softness_derivative(self) -> np.ndarray:
        """Return the forces' derivative by the softness: (2H+1, n_pairs) [N].

        The softness is a compliance in series with every pair, divided by the mean pair compliance.
        """

    @abstractmethod
    def log_stiffness_derivative(self) -> np.ndarray:
        """Return the forces' derivative by the logarithm of the contact stiffness.

        The derivative of the force coefficients, (2H+1, n_pairs) [N], is taken at fixed slow gaps.
        """


@dataclass(frozen=True)
class ContactIntegrals(ABC):
    """Integrals over a period for the Fourier coefficients of contact forces.

    Attributes
    ----------
    law : ContactLaw
        Law for all pairs.
    harmonics : int
        H, the highest harmonic.
    residual_compliance : (n_pairs, n_pairs) [m/N] or None
        Residual flexibility R_inf in series with contact. The slow gap is s = g + R_inf lambda,
        with gap g and contact force lambda; None: s = g.
    relative_series_softness : float
        Further compliance in series with every pair, divided by ``mean_pair_compliance``.
    """

    law: ContactLaw
    harmonics: int
    residual_compliance: np.ndarray | None = field(default=None, kw_only=True)
    relative_series_softness: float = field(default=0.0, kw_only=True)

    has_coupled_pairs: ClassVar[bool] = False
    """True if the force on a pair depends on all pairs' gaps."""

    @property
    def is_exact(self) -> bool:
        """True if the integrals are exact, without samples in time."""
        return False

    @cached_property
    def spring_compliance(self) -> np.ndarray:
        """Compliance 1/k of the contact springs: (n_pairs,), or one number [m/N].

        Zero for a rigid law.
        """
        return np.asarray(1.0 / np.asarray(self.law.stiffness, dtype=float))

    @cached_property
    def series_compliance_per_pair(self) -> np.ndarray:
        """Compliance in series with each pair: (n_pairs,), or one number [m/N].

        Diagonal of residual flexibility plus contact springs' compliance.
        """
        return (
            self.spring_compliance
            if self.residual_compliance is None
            else np.diag(self.residual_compliance) + self.spring_compliance
        )

    @cached_property
    def mean_pair_compliance(self) -> float:
        """Mean of ``series_compliance_per_pair`` over all pairs [m/N].

        Used as reference value: ``relative_series_softness`` is a compliance divided by this mean.
        """
        return float(np.mean(self.series_compliance_per_pair))

    @abstractmethod
    def forces_at_gap_samples(self, gap_samples: np.ndarray) -> np.ndarray:
        """Return the contact forces for slow gaps at n instants, both (n, n_pairs).

        Slow gap [m]: gap plus residual flexibility times contact force [N].
        """

    @abstractmethod
    def linearise(self, gap_coefficients: np.ndarray) -> ContactForces:
        """Return the forces' coefficients and derivatives at a slow gap.

        ``gap_coefficients`` (2H+1, n_pairs) [m]: gap plus residual flexibility times contact force.
        """

    def force(self, gap_coefficients: np.ndarray) -> np.ndarray:
        """Return the contact forces' coefficients for given slow gaps.

        The slow gaps' coefficients ``gap_coefficients`` [m] and the result [N] are (2H+1, n_pairs)
        each. The slow gap is the gap plus residual flexibility times contact force.
        """
        return self.linearise(gap_coefficients).force

    def with_harmonics(self, harmonics: int) -> Self:
        """Return integrals with another number of harmonics, and enough samples for them."""
        return replace(self, harmonics=harmonics)

    def exact_or_finer_integrals(self) -> ContactIntegrals | None:
        """Return exact integrals if the law permits, else integrals with more samples.

        None: these integrals are exact already.
        """
        return None

    def with_series_softness(self, relative_series_softness: float) -> Self:
        """Return a copy of the integrals with another compliance in series with every pair.

        ``relative_series_softness`` is this compliance, divided by ``mean_pair_compliance``.
        """
        return (
            self
            if relative_series_softness == self.relative_series_softness
            else replace(self, relative_series_softness=relative_series_softness)
        )


def integrals_with_uncoupled_pairs(
    law: ContactLaw, harmonics: int, instants_per_period: int | None = None, n_load_periods: int = 1
) -> PairIntegrals:
    """Return integrals of contact forces for uncoupled pairs, exact if possible.

    Exact integrals require a piecewise linear law, lambda = k max(0, g), for the force lambda and
    the gap g. Other laws are integrated from samples.

    Parameters
    ----------
    law : ContactLaw
        Law for all pairs.
    harmonics : int
        Number of harmonics H of the forces.
    instants_per_period : int, optional
        Number of samples in a period of the response; if given, also piecewise linear laws are
        sampled. Default: exact integrals, or :func:`default_instants_per_period` samples in each
        load period.
    n_load_periods : int
        Load periods in a period of the response.
    """
    if instants_per_period is None and is_piecewise_linear(law):
        return ExactIntegrals(law, harmonics)
    return SampledIntegrals(
        law,
        harmonics,
        instants_per_period or n_load_periods * default_instants_per_period(harmonics),
    )


def default_instants_per_period(harmonics: int) -> int:
    """Return the default number of instants for sampled contact forces.

    The number is 1024, or the next power of two from 32 H on if that is larger; H is ``harmonics``.
    """
    return max(1024, 1 << (32 * harmonics - 1).bit_length())


@dataclass(frozen=True)
class SampledIntegrals(ContactIntegrals):
    """Integrals of uncoupled contact forces by samples at equally spaced instants.

    The trapezoidal rule is applied by the fast Fourier transform, for any law. A relative softness
    in series divides the contact stiffness by 1 + softness. The derivatives need the harmonics of
    the law's slope (force by gap) up to 2 H. With 4 H instants or fewer, high harmonics alias to
    low ones. With 2H+1 instants, as many as coefficients, the method is collocation.
    """

    samples: int
    """Number of instants in the period."""

    def forces_at_gap_samples(self, gap_samples: np.ndarray) -> np.ndarray:
        return self.law.force(gap_samples)

    def linearise(self, gap_coefficients: np.ndarray) -> PairForces:
        gap_samples, softened_law = sample_period(gap_coefficients, self.samples), self.law
        if self.relative_series_softness:
            softened_law = softened_law.scaled(1.0 / (1.0 + self.relative_series_softness))
        # Means of exp(i m theta), m < 2 H + 1; with few instants high orders alias to low ones.
        fft_indices_of_slope_harmonics = np.arange(2 * self.harmonics + 1) % self.samples
        slope_mean_harmonics = (
            np.fft.fft(softened_law.tangent(gap_samples), axis=0)[fft_indices_of_slope_harmonics]
            / self.samples
        )
        pair_tangents = [
            tangent_from_means(pair_slope_means[:, None, None])[:, 0]
            for pair_slope_means in from_complex(slope_mean_harmonics).T
        ]
        force_coefficients = fourier_coefficients(softened_law.force(gap_samples), self.harmonics)
        return PairForces(
            force_coefficients,
            np.array(pair_tangents),
            -force_coefficients / (1.0 + self.relative_series_softness),
        )

    def exact_or_finer_integrals(self) -> ContactIntegrals:
        if is_piecewise_linear(self.law):
            return ExactIntegrals(self.law, self.harmonics)
        return replace(
            self, samples=max(4 * self.samples, default_instants_per_period(self.harmonics))
        )

    def with_harmonics(self, harmonics: int) -> Self:
        n_samples = max(self.samples, 1 << (8 * harmonics - 1).bit_length())
        return replace(self, harmonics=harmonics, samples=n_samples)


@dataclass(frozen=True)
class ExactIntegrals(ContactIntegrals):
    """Exact integrals of uncoupled contact forces, for lambda = k max(g, 0).

    lambda is the force, g the gap (positive: penetration), and k the contact stiffness. The
    integrals have a closed form between the instants at which a pair opens or closes. The slope
    kappa is k while the pair is closed, else 0. With the phase theta, the means over a period are

        c_m + i s_m = 1 / (2 pi) int kappa exp(i m theta) d theta.

    The derivative of the force coefficients consists of these means. Since lambda = kappa g, the
    force coefficients are this derivative times the gap coefficients. A diagonal residual
    flexibility D_0 replaces k by 1 / (D_0 + 1/k), and k may then be infinite.
    """

    @property
    def is_exact(self) -> bool:
        return True

    @property
    def stiffness_of_closed_pair(self) -> np.ndarray:
        """Slope of a closed pair's force by its slow gap: (n_pairs,), or one number [N/m].

        The slow gap is the gap plus residual flexibility times contact force. The slope is 1 over
        the compliance in series with the pair, softness included.
        """
        return np.asarray(
            1.0
            / (
                self.series_compliance_per_pair
                + self.relative_series_softness * self.mean_pair_compliance
            )
        )

    def forces_at_gap_samples(self, gap_samples: np.ndarray) -> np.ndarray:
        return np.asarray(self.stiffness_of_closed_pair * np.maximum(gap_samples, 0.0))

    def linearise(self, gap_coefficients: np.ndarray) -> PairForces:
        n_rows, n_pairs = gap_coefficients.shape
        gap_coefficients = require_shape(gap_coefficients, 2 * self.harmonics + 1, n_pairs)
        pair_stiffnesses = np.full(n_pairs, self.stiffness_of_closed_pair)
        force_coefficients = np.empty((n_rows, n_pairs))
        tangent_by_pair = np.empty((n_pairs, n_rows, n_rows))
        is_out_of_memory = kernel.contact_integrals(
            self.harmonics, n_pairs, pointer(gap_coefficients), pointer(pair_stiffnesses),
            pointer(cosines_and_sines_on_quarter_period(self.harmonics)),
            pointer(np.empty(2 * n_pairs * n_rows)), pointer(force_coefficients),
            pointer(tangent_by_pair),
        )  # fmt: skip
        if is_out_of_memory:
            raise MemoryError("contact integrals")
        return PairForces(
            force_coefficients,
            tangent_by_pair,
            -self.mean_pair_compliance * pair_stiffnesses * force_coefficients,
        )


PairIntegrals = ExactIntegrals | SampledIntegrals
"""Integrals for uncoupled pairs."""


class PairForces(ContactForces):
    """Fourier coefficients of the forces on uncoupled pairs, with derivatives.

    Attributes
    ----------
    tangent : (n_pairs, 2H+1, 2H+1) [N/m]
        Derivative of each pair's force coefficients by its gap coefficients.
    """

    def __init__(
        self, force: np.ndarray, tangent: np.ndarray, series_softness_derivative: np.ndarray
    ) -> None:
        self.force, self.tangent, self._series_softness_derivative = (
            force,
            tangent,
            series_softness_derivative,
        )

    def force_change(self, gap_change: np.ndarray) -> np.ndarray:
        return np.matmul(self.tangent, gap_change.T[:, :, None])[:, :, 0].T

    def identity_plus_compliance_tangent(
        self, compliance_matrices: np.ndarray, gap_basis: np.ndarray | None = None
    ) -> np.ndarray:
        assert gap_basis is None
        jacobian_matrix = multiply_compliance_and_tangent(compliance_matrices, self.tangent)
        jacobian_matrix.flat[:: len(jacobian_matrix) + 1] += 1.0
        return jacobian_matrix

    def log_stiffness_derivative(self) -> np.ndarray:
        """Return the forces' derivative by the logarithm of the contact stiffness.

        Forces of uncoupled pairs are proportional to the contact stiffness. So the derivative,
        (2H+1, n_pairs) [N], equals the forces.
        """
        return self.force

    def series_softness_derivative(self) -> np.ndarray:
        return self._series_softness_derivative


def multiply_compliance_and_force(
    compliance_matrices: np.ndarray, force_coefficients: np.ndarray
) -> np.ndarray:
    """Return the gap response to contact forces, harmonic by harmonic: (2H+1, n_pairs) [m].

    ``compliance_matrices`` (H+1, n_pairs, n_pairs) complex [m/N] are the compliance at each
    harmonic, ``force_coefficients`` (2H+1, n_pairs) [N] the contact forces' coefficients.
    """
    n_rows, n_pairs = force_coefficients.shape
    compliance_matrices = require_shape(
        compliance_matrices, n_rows // 2 + 1, n_pairs, n_pairs, kind=complex
    )
    force_coefficients = require_shape(force_coefficients, 2 * (n_rows // 2) + 1, n_pairs)
    gap_response = np.empty((n_rows, n_pairs))
    kernel.respond(
        n_rows // 2,
        n_pairs,
        pointer(compliance_matrices),
        pointer(force_coefficients),
        pointer(gap_response),
    )
    return gap_response


def multiply_compliance_and_tangent(
    compliance_matrices: np.ndarray, tangent: np.ndarray
) -> np.ndarray:
    """Return the compliance times the forces' derivative as a dense matrix.

    On coefficients (a, b) of a force a - i b, the compliance R_k is the real matrix [[Re R_k, Im
    R_k], [-Im R_k, Re R_k]].

    Parameters
    ----------
    compliance_matrices : (H+1, n_pairs, n_pairs) complex
        Compliance R_k at harmonic k.
    tangent : (n_pairs, 2H+1, n)
        For each pair: derivative of the force's coefficients by n unknowns.

    Returns
    -------
    ((2H+1) n_pairs, n n_pairs)
        Rows are ordered (coefficient, pair), columns (unknown, pair).
    """
    n_pairs, n_rows, n_columns = tangent.shape
    compliance_matrices = require_shape(
        compliance_matrices, n_rows // 2 + 1, n_pairs, n_pairs, kind=complex
    )
    tangent = require_shape(tangent, n_pairs, 2 * (n_rows // 2) + 1, n_columns)
    compliance_times_tangent = np.empty((n_rows * n_pairs, n_columns * n_pairs))
    array_pointers = map(pointer, (compliance_matrices, tangent, compliance_times_tangent))
    kernel.respond_to_columns(n_rows // 2, n_pairs, n_columns, *array_pointers)
    return compliance_times_tangent


@lru_cache(maxsize=64)
def cosines_and_sines_on_quarter_period(harmonics: int) -> np.ndarray:
    """Return cos k theta and sin k theta on a quarter period: (H, 2, n_instants).

    k is 1 to H = ``harmonics``. The kernel searches for sign changes of gaps on this grid of
    instants.
    """
    cosines_and_sines = np.empty((harmonics, 2, kernel.switching_cells(harmonics) // 4 + 1))
    kernel.switching_waves(harmonics, pointer(cosines_and_sines))
    return cosines_and_sines


def tangent_from_means(stiffness_means: np.ndarray) -> np.ndarray:
    """Return the derivative of contact forces by gaps from means of the contact stiffness.

    Parameters
    ----------
    stiffness_means : (4H+1, n, n)
        Means over the period of the stiffness matrix of n pairs. First the plain mean. Then, for
        m = 1 to 2H, the means with the factors cos(m theta) and sin(m theta), with the phase theta.

    Returns
    -------
    (2H+1, n, (2H+1) n)
        Derivative of force coefficient i of pair p, at index (i, p). The last axis has all gap
        coefficients, ordered (coefficient, pair).
    """
    harmonics, n_pairs = len(stiffness_means) // 4, stiffness_means.shape[1]
    stiffness_means = require_shape(stiffness_means, 4 * harmonics + 1, n_pairs, n_pairs)
    n_rows = 2 * harmonics + 1
    tangent = np.empty((n_rows, n_pairs, n_rows * n_pairs))
    for k in range(harmonics + 1):
        first_row_index = max(0, 2 * k - 1)
        kernel.tangent_of_harmonic(
            harmonics, n_pairs, k, pointer(stiffness_means), pointer(tangent[first_row_index:])
        )
    return tangent


# --- coupled pairs -------------------------------------------------------------------------------


@dataclass(frozen=True)
class CoupledIntegrals(ContactIntegrals):
    """Integrals of contact forces over a period, for pairs coupled by a residual flexibility.

    Attributes
    ----------
    samples : int or None
        Instants per period; None: exact integrals, or for a smooth law
        :func:`default_instants_per_period`.
    shared_active_set_solver : ActiveSetSolver or None
        Solver from other integrals with the same law and residual flexibility. Inverse matrices
        that it keeps for sets of closed pairs are used again.
    """

    samples: int | None = None
    shared_active_set_solver: ActiveSetSolver | None = field(
        default=None, repr=False, compare=False
    )
    has_coupled_pairs: ClassVar[bool] = True

    @cached_property
    def active_set_solver(self) -> ActiveSetSolver:
        """Solver for contact forces by sets of closed pairs.

        The solver's compliance is the sum of residual flexibility, contact springs' compliance and
        ``relative_series_softness`` times the mean pair compliance. A smooth law has no contact
        springs: their compliance is left out.
        """
        if self.shared_active_set_solver is not None:
            return self.shared_active_set_solver
        assert self.residual_compliance is not None
        series_compliance = self.relative_series_softness * self.mean_pair_compliance + (
            self.spring_compliance if self.has_piecewise_linear_law else 0.0
        )
        return ActiveSetSolver(
            self.residual_compliance + series_compliance * np.eye(len(self.residual_compliance))
        )

    @property
    def has_piecewise_linear_law(self) -> bool:
        """True if the contact forces are piecewise linear in the slow gap.

        The law is then a penalty law or a constraint. The slow gap is the gap plus residual
        flexibility times contact force.
        """
        return is_unilateral(self.law)

    @property
    def is_exact(self) -> bool:
        """True if the integrals are exact: a piecewise linear law, and no samples requested."""
        return self.has_piecewise_linear_law and self.samples is None

    def with_harmonics(self, harmonics: int) -> Self:
        n_samples = self.samples and max(self.samples, default_instants_per_period(harmonics))
        return replace(
            self,
            harmonics=harmonics,
            samples=n_samples,
            shared_active_set_solver=self.active_set_solver,
        )

    def exact_or_finer_integrals(self) -> Self | None:
        if self.is_exact:
            return None
        n_samples = 4 * (self.samples or default_instants_per_period(self.harmonics))
        return replace(self, samples=None if self.has_piecewise_linear_law else n_samples)

    def forces_at_gap_samples(self, gap_samples: np.ndarray) -> np.ndarray:
        if self.has_piecewise_linear_law:
            return self.active_set_solver.solve(gap_samples)[0]
        return forces_and_slopes_of_smooth_law(
            self.law, self.active_set_solver.compliance_matrix, gap_samples
        )[0]

    def linearise(self, gap_coefficients: np.ndarray) -> CoupledForces:
        return (
            _ExactForces(self, gap_coefficients)
            if self.is_exact
            else _SampledForces(self, gap_coefficients)
        )


class CoupledForces(ContactForces):
    """Fourier coefficients of contact forces on coupled pairs, with derivatives.

    Pairs are coupled by a residual flexibility, or their normal and tangential forces by friction.
    """

    @abstractmethod
    def tangent(self, gap_basis: np.ndarray | None = None) -> np.ndarray:
        """Return the derivative T of the force coefficients by the slow gap coefficients.

        The slow gap is the gap plus residual flexibility times contact force. With a basis U
        (n_pairs, n) of gaps, return U^T T U; else n = n_pairs.

        Returns
        -------
        (2H+1, n, (2H+1) n) [N/m]
            Derivative of force coefficient i of pair p, at index (i, p). The last axis has all gap
            coefficients, ordered (coefficient, pair).
        """

    def identity_plus_compliance_tangent(
        self, compliance_matrices: np.ndarray, gap_basis: np.ndarray | None = None
    ) -> np.ndarray:
        tangent = self.tangent(gap_basis)
        cosine_tangent_rows, sine_tangent_rows = tangent[1::2], tangent[2::2]
        compliance_real = compliance_matrices[1:].real
        compliance_imaginary = compliance_matrices[1:].imag
        compliance_times_tangent = np.empty_like(tangent)
        compliance_times_tangent[0] = compliance_matrices[0].real @ tangent[0]
        compliance_times_tangent[1::2] = np.matmul(
            compliance_real, cosine_tangent_rows
        ) + np.matmul(compliance_imaginary, sine_tangent_rows)
        compliance_times_tangent[2::2] = np.matmul(compliance_real, sine_tangent_rows) - np.matmul(
            compliance_imaginary, cosine_tangent_rows
        )
        jacobian_matrix = compliance_times_tangent.reshape(tangent.shape[2], -1)
        jacobian_matrix.flat[:: len(jacobian_matrix) + 1] += 1.0
        return jacobian_matrix


class _KernelExactForceEvaluator:
    """C object to compute exact forces for given numbers of harmonics and pairs.

    Several :class:`_ExactForces` share the C object. At a time it holds the results of a single
    object.

    Attributes
    ----------
    handle : cffi pointer
        Address of the C object.
    evaluated_forces : CoupledForces or None
        Object for which the C object holds the results at present.
    """

    def __init__(self, harmonics: int, n_pairs: int) -> None:
        object_pointer = kernel.new_coupled_forces(harmonics, n_pairs)
        self.handle = attach_destructor(object_pointer, kernel.free_coupled_forces)
        self.evaluated_forces: CoupledForces | None = None


_kernel_evaluator_for = lru_cache(maxsize=16)(_KernelExactForceEvaluator)
"""Return the shared C object for numbers of harmonics and pairs. The last 16 are kept."""


class _ExactForces(CoupledForces):
    """Exact contact forces on pairs coupled by a residual flexibility, by the C kernel."""

    def __init__(self, integrals: CoupledIntegrals, gap_coefficients: np.ndarray) -> None:
        self._integrals, self.harmonics = integrals, integrals.harmonics
        n_pairs = len(integrals.active_set_solver.compliance_matrix)
        self._gap_coefficients = require_shape(gap_coefficients, 2 * self.harmonics + 1, n_pairs)
        self.force = np.empty_like(self._gap_coefficients)
        self._evaluated_kernel_handle()

    def _evaluated_kernel_handle(self) -> Any:
        """Return the C object after it evaluated the forces at this object's gap.

        Nothing is evaluated again if the C object still holds these results. ConvergenceError: at
        an instant, no contact forces are found.
        """
        kernel_evaluator = _kernel_evaluator_for(self.harmonics, self._gap_coefficients.shape[1])
        active_set_solver = self._integrals.active_set_solver
        if kernel_evaluator.evaluated_forces is not self:
            kernel_evaluator.evaluated_forces = None
            array_pointers = map(
                pointer, (active_set_solver.compliance_matrix, self._gap_coefficients, self.force)
            )
            outcome_code = kernel.find_forces(kernel_evaluator.handle, *array_pointers)
            if outcome_code == kernel.NO_MEMORY:
                raise MemoryError("contact forces")
            if outcome_code != kernel.FOUND:
                raise ConvergenceError(
                    "contact: no forces solve the law at an instant; use a smaller stiffness"
                )
            kernel_evaluator.evaluated_forces = self
        return kernel_evaluator.handle

    def force_change(self, gap_change: np.ndarray) -> np.ndarray:
        gap_change = require_shape(gap_change, *self._gap_coefficients.shape)
        force_change = np.empty(self._gap_coefficients.shape)
        kernel.forces_by_gap(
            self._evaluated_kernel_handle(), pointer(gap_change), pointer(force_change)
        )
        return force_change

    def tangent(self, gap_basis: np.ndarray | None = None) -> np.ndarray:
        n_pairs = self._gap_coefficients.shape[1]
        n_columns = n_pairs if gap_basis is None else gap_basis.shape[1]
        stiffness_means = np.empty((4 * self.harmonics + 1, n_columns, n_columns))
        basis_pointer = (
            NULL if gap_basis is None else pointer(require_shape(gap_basis, n_pairs, n_columns))
        )
        if kernel.means_of_stiffness(
            self._evaluated_kernel_handle(), basis_pointer, n_columns, pointer(stiffness_means)
        ):
            raise MemoryError("contact forces")
        return tangent_from_means(stiffness_means)

    def _force_derivative_by_compliances(self, compliance_rates: np.ndarray) -> np.ndarray:
        """Return the forces' derivative by a parameter p of the compliances: (2H+1, n_pairs).

        Each pair has compliances in series: residual flexibility, contact spring, and an added
        softness. Their sum is a matrix with a diagonal d (n_pairs,) [m/N]. Only d depends on p;
        ``compliance_rates`` (n_pairs,) is dd/dp.
        """
        force_derivative = np.empty(self._gap_coefficients.shape)
        compliance_rates = require_shape(compliance_rates, self._gap_coefficients.shape[1])
        kernel.forces_by_compliance(
            self._evaluated_kernel_handle(), pointer(compliance_rates), pointer(force_derivative)
        )
        return force_derivative

    def series_softness_derivative(self) -> np.ndarray:
        return self._force_derivative_by_compliances(
            np.full(self._gap_coefficients.shape[1], self._integrals.mean_pair_compliance)
        )

    def log_stiffness_derivative(self) -> np.ndarray:
        return self._force_derivative_by_compliances(
            np.broadcast_to(-self._integrals.spring_compliance, self._gap_coefficients.shape[1])
        )


class _SampledForces(CoupledForces):
    """Contact forces on pairs coupled by a residual flexibility, from samples, for any law h(g).

        lambda = h(s - D lambda),    d lambda = S (ds - dD lambda),    S = h' (I + D h')^-1

    lambda is the force, s the slow gap (gap plus residual flexibility times force). D is the
    residual flexibility plus the diagonal compliance by the softness. If the law is piecewise
    linear, D includes the contact springs' compliance 1/k, and S is the inverse of D on the
    closed pairs.
    """

    def __init__(self, integrals: CoupledIntegrals, gap_coefficients: np.ndarray) -> None:
        self._integrals, self.harmonics = integrals, integrals.harmonics
        active_set_solver = integrals.active_set_solver
        gap_samples = sample_period(
            gap_coefficients, integrals.samples or default_instants_per_period(integrals.harmonics)
        )
        if integrals.has_piecewise_linear_law:
            self._force_samples, is_closed = active_set_solver.solve(gap_samples)
            self._stiffness_matrix_samples = active_set_solver.invert_compliance_on_sets(is_closed)
        else:
            self._force_samples, self._stiffness_matrix_samples = forces_and_slopes_of_smooth_law(
                integrals.law, active_set_solver.compliance_matrix, gap_samples
            )
        self._stiffness_matrix_coefficients = fourier_coefficients(
            self._stiffness_matrix_samples, 2 * self.harmonics
        )
        self._band_limited_stiffness_samples = sample_period(
            self._stiffness_matrix_coefficients, n_instants_for_products(self.harmonics)
        )
        self.force = fourier_coefficients(self._force_samples, self.harmonics)

    def force_change(self, gap_change: np.ndarray) -> np.ndarray:
        gap_change_samples = sample_period(gap_change, len(self._band_limited_stiffness_samples))
        force_change_samples = np.empty_like(gap_change_samples)
        kernel.multiply_each(
            *gap_change_samples.shape,
            *map(
                pointer,
                (self._band_limited_stiffness_samples, gap_change_samples, force_change_samples),
            ),
        )
        return fourier_coefficients(force_change_samples, self.harmonics)

    def tangent(self, gap_basis: np.ndarray | None = None) -> np.ndarray:
        stiffness_means = np.concatenate(
            [self._stiffness_matrix_coefficients[:1], 0.5 * self._stiffness_matrix_coefficients[1:]]
        )
        return tangent_from_means(
            stiffness_means if gap_basis is None else gap_basis.T @ stiffness_means @ gap_basis
        )

    def _force_coefficient_change(self, gap_change_samples: np.ndarray) -> np.ndarray:
        """Return the forces' change (2H+1, n_pairs) [N] by a change of slow gaps.

        ``gap_change_samples`` (n_instants, n_pairs) [m] are the gap changes at the instants of the
        period.
        """
        return fourier_coefficients(
            np.einsum("npq,nq->np", self._stiffness_matrix_samples, gap_change_samples),
            self.harmonics,
        )

    def series_softness_derivative(self) -> np.ndarray:
        return self._force_coefficient_change(
            -self._integrals.mean_pair_compliance * self._force_samples
        )

    def log_stiffness_derivative(self) -> np.ndarray:
        if self._integrals.has_piecewise_linear_law:
            return self._force_coefficient_change(
                self._force_samples * self._integrals.spring_compliance
            )
        # d lambda = (I + h' D)^-1 lambda = lambda - S D lambda.
        return self.force - self._force_coefficient_change(
            self._force_samples @ self._integrals.active_set_solver.compliance_matrix
        )
