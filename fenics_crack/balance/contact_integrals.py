"""Fourier coefficients of the contact force and their derivative, from those of the gap.

    b_0 = 1/T int lambda dt,   b_k = 2/T int lambda cos(k w t) dt  or  sin(k w t)          (eq. 7)

Two ways. *Sampled*: the trapezoidal rule on N instants; any law; the error falls like N^-2 because
of the kinks, and the coefficients have corners where a sample changes its state. *Exact*: a law
that is linear in contact is integrated in closed form between the switching instants; the
coefficients are then continuously differentiable, and nothing is left to choose.

In both the force is locally kappa(t) g(t), so that both tangents (eq. 14) consist of the same
numbers, c_m and s_m, the means of kappa cos(m theta) and kappa sin(m theta): for rows and columns
i, j

    d a_i/d a_j:  c_{i-j} + c_{i+j}      d a_i/d b_j:  s_{i+j} - s_{i-j}
    d b_i/d a_j:  s_{i+j} + s_{i-j}      d b_i/d b_j:  c_{i-j} - c_{i+j},      i, j >= 1,

a Toeplitz plus a Hankel matrix for each pair, with c_0, c_j, s_j in the row of the mean and 2 c_i,
2 s_i in its column.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import ClassVar, Self

import numpy as np

from fenics_crack.kernel import doubles, ints, kernel, shaped
from fenics_crack.model.contact import ContactLaw, is_piecewise_linear
from fenics_crack.numerics.fourier import balanced, sampled

__all__ = [
    "ContactForces",
    "ContactIntegrals",
    "ExactIntegrals",
    "LowRank",
    "PairForces",
    "PairIntegrals",
    "SampledIntegrals",
    "apply_to_pairs",
    "contact_integrals",
    "default_samples",
    "grid_waves",
    "respond",
    "respond_to_columns",
]


class ContactForces(ABC):
    """Coefficients of the contact forces of a wave s, and their derivatives.

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
        """Derivative of the coefficients by the softness."""

    @abstractmethod
    def by_stiffness(self) -> np.ndarray:
        """Derivative of the coefficients by ln k."""

    def low_rank(self) -> LowRank | None:
        """T by what it has of a rank; None where it has not."""
        return None


@dataclass(frozen=True)
class ContactIntegrals(ABC):
    """A way of integrating the contact forces of waves s (2H+1, n_pairs).

    Attributes
    ----------
    law : ContactLaw
        Of all pairs.
    harmonics : int
        H.
    residual : (n_pairs, n_pairs) [m/N] or None
        R_inf, through which the pairs are seen, s = g + R_inf lambda; None: by themselves, s = g.
    softness : float
        Compliance put in series with every pair that is seen so, in parts of ``unit``.
    """

    law: ContactLaw
    harmonics: int
    residual: np.ndarray | None = field(default=None, kw_only=True)
    softness: float = field(default=0.0, kw_only=True)

    coupled: ClassVar[bool] = False
    """Whether the force of a pair depends on the gaps of others."""

    @property
    def exact(self) -> bool:
        """Whether nothing is sampled."""
        return False

    @cached_property
    def springs(self) -> np.ndarray:
        """1/k of each pair, zero without penetration: (n_pairs,) [m/N]."""
        assert self.residual is not None
        stiffness = np.asarray(self.law.stiffness, dtype=float)
        return np.asarray(np.broadcast_to(1.0 / stiffness, len(self.residual)))

    @cached_property
    def unit(self) -> float:
        """Mean diagonal of R_inf + I/k [m/N]."""
        assert self.residual is not None
        return float(np.mean(np.diag(self.residual) + self.springs))

    @abstractmethod
    def forces(self, gap: np.ndarray) -> np.ndarray:
        """lambda(s) at instants, of values (n, n_pairs): the same shape [N]."""

    @abstractmethod
    def linearise(self, gap: np.ndarray) -> ContactForces:
        """The forces' coefficients and their derivatives."""

    def force(self, gap: np.ndarray) -> np.ndarray:
        """The coefficients alone: (2H+1, n_pairs) [N]."""
        return self.linearise(gap).force

    @abstractmethod
    def widened(self, harmonics: int) -> Self:
        """The same with more harmonics, and samples enough for them."""

    def with_softness(self, softness: float) -> Self:
        """The same with another compliance in series."""
        return self if softness == self.softness else replace(self, softness=softness)

    def of_law(self, law: ContactLaw) -> Self:
        """The same of another law of the same kind."""
        return replace(self, law=law)


def contact_integrals(
    law: ContactLaw, harmonics: int, samples: int | None = None, periods: int = 1
) -> PairIntegrals:
    """Exact integrals where the law is piecewise linear and no samples are asked for; else sampled
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

    N > 4 H is the usual choice. N = 2H+1, as many instants as coefficients, is the least: the
    equation of motion then holds at just these instants (collocation).
    """

    samples: int
    """N."""

    def sample(self, gap: np.ndarray) -> np.ndarray:
        """Values (N, n_pairs) at the instants i T / N of coefficients (2H+1, n_pairs)."""
        return sampled(gap, self.samples)

    def balance(self, values: np.ndarray) -> np.ndarray:
        """Coefficients (2H+1, n_pairs) of samples (N, n_pairs)."""
        return balanced(values, self.harmonics)

    def forces(self, gap: np.ndarray) -> np.ndarray:
        return self.law.force(gap)

    def linearise(self, gap: np.ndarray) -> PairForces:
        values = self.sample(gap)
        force = self.balance(self.law.force(values))
        return PairForces(force, _tangent(self._means(values, 2 * self.harmonics), self.harmonics))

    def widened(self, harmonics: int) -> Self:
        samples = max(self.samples, 1 << (8 * harmonics - 1).bit_length())
        return replace(self, harmonics=harmonics, samples=samples)

    def _means(self, values: np.ndarray, highest: int) -> np.ndarray:
        """Complex c_m + i s_m of the slope, m = 0 to highest < N: (n_pairs, highest + 1).

        At the instants exp(i m theta) and exp(i (m - N) theta) are the same: on few of them the
        means of high order are those of low order, conjugate.
        """
        spectrum = np.fft.rfft(self.law.tangent(values), axis=0)
        if highest >= len(spectrum):
            folded = self.samples - np.arange(len(spectrum), highest + 1)
            spectrum = np.concatenate((spectrum, spectrum[folded].conj()))
        return spectrum[: highest + 1].T.conj() / self.samples


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
        if self.residual is None:
            return np.asarray(self.law.stiffness, dtype=float)
        return 1.0 / (np.diag(self.residual) + self.springs + self.softness * self.unit)

    def forces(self, gap: np.ndarray) -> np.ndarray:
        return np.asarray(self.stiffness * np.maximum(gap, 0.0))

    def linearise(self, gap: np.ndarray) -> PairForces:
        rows, pairs = gap.shape
        gap = shaped(gap, 2 * self.harmonics + 1, pairs)
        stiffness = np.empty(pairs)
        stiffness[:] = self.stiffness
        force, tangent = np.empty((rows, pairs)), np.empty((pairs, rows, rows))
        failed = kernel.contact_integrals(
            self.harmonics, pairs, doubles(gap), doubles(stiffness),
            doubles(grid_waves(self.harmonics)), doubles(np.empty(2 * pairs * rows)),
            doubles(force), doubles(tangent),
        )  # fmt: skip
        if failed:
            raise MemoryError("contact integrals")
        if self.residual is None:
            return PairForces(force, tangent)
        by_softness = -self.unit * stiffness * force
        return PairForces(force, tangent, self.springs * stiffness * force, by_softness)

    def widened(self, harmonics: int) -> Self:
        return replace(self, harmonics=harmonics)


PairIntegrals = ExactIntegrals | SampledIntegrals


class PairForces(ContactForces):
    """Forces of pairs that nothing couples.

    Attributes
    ----------
    tangent : (n_pairs, 2H+1, 2H+1) [N/m]
        T, pair by pair.
    """

    def __init__(
        self,
        force: np.ndarray,
        tangent: np.ndarray,
        by_stiffness: np.ndarray | None = None,
        by_softness: np.ndarray | None = None,
    ) -> None:
        self.force, self.tangent = force, tangent
        self._by_stiffness = force if by_stiffness is None else by_stiffness
        self._by_softness = by_softness

    def apply(self, change: np.ndarray) -> np.ndarray:
        return apply_to_pairs(self.tangent, change)

    def identity_plus(self, matrices: np.ndarray, basis: np.ndarray | None = None) -> np.ndarray:
        assert basis is None
        found = respond_to_columns(matrices, self.tangent)
        found.flat[:: len(found) + 1] += 1.0
        return found

    def by_stiffness(self) -> np.ndarray:
        """Forces of pairs by themselves are proportional to k."""
        return self._by_stiffness

    def by_softness(self) -> np.ndarray:
        assert self._by_softness is not None
        return self._by_softness

    def low_rank(self) -> LowRank | None:
        found = LowRank(self.tangent)
        return found if found.complete else None


class LowRank:
    """T = P Q of pairs that are closed for a part of the period only, and with it

        (I + R P Q)^-1 r = r - R P (I + Q R P)^-1 Q r,       det(I + R P Q) = det(I + Q R P).

    kappa >= 0 makes each pair's T symmetric and positive semidefinite where the mean counts
    sqrt(2) times: E T E^-1 = C C^T, P = E^-1 C, Q = C^T E, C by Cholesky's method with pivots, of
    which those of rounding are left out.

    Attributes
    ----------
    complete : bool
        Whether P Q is all of T: not so for a law whose force falls where the gap grows.
    """

    def __init__(self, tangent: np.ndarray) -> None:
        pairs, count, _ = tangent.shape
        tangent = shaped(tangent, pairs, 2 * (count // 2) + 1, count)
        self._ranks, room = np.zeros(pairs, np.intc), np.empty((pairs + 1, count, count))
        rank = kernel.tangent_rows(
            count // 2, pairs, doubles(tangent), count * float(np.finfo(float).eps),
            count * 1e-12, ints(self._ranks), doubles(room[:pairs]),
            doubles(room[pairs]),
        )  # fmt: skip
        self.complete = rank >= 0
        self._rows = room.reshape(-1, count)[: max(rank, 0)]  # C^T
        self._pairs = np.repeat(np.arange(pairs), self._ranks if self.complete else 0)

    def condense(self, matrices: np.ndarray) -> np.ndarray:
        """I + Q R P; 1 where all pairs are open, for LAPACK takes no empty matrix."""
        if not len(self._rows):
            return np.eye(1)
        columns, found = np.ascontiguousarray(self._rows.T), np.empty((len(self._rows),) * 2)
        of_each = (len(columns) // 2 + 1, len(self._ranks), len(self._ranks))
        kernel.small_matrix(
            len(columns) // 2, len(self._ranks), ints(self._ranks), doubles(self._rows),
            doubles(columns), doubles(shaped(matrices, *of_each, kind=complex)),
            doubles(np.empty_like(columns)), doubles(found),
        )  # fmt: skip
        return found

    def solve(
        self, right: np.ndarray, matrices: np.ndarray, solve: Callable[[np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """J^-1 r of (2H+1, n_pairs), with solutions of the condensed matrix."""
        if not len(self._rows):
            return right
        weight = np.ones(len(right))
        weight[0] = np.sqrt(2.0)
        drive = np.einsum("ji,ji->j", self._rows, (weight * right.T)[self._pairs])
        moved, used = solve(drive)[:, None] * self._rows, self._ranks > 0
        force = np.zeros_like(right.T)
        force[used] = np.add.reduceat(moved, (np.cumsum(self._ranks) - self._ranks)[used])
        return right - respond(matrices, np.ascontiguousarray((force / weight).T))


def respond(matrices: np.ndarray, force: np.ndarray) -> np.ndarray:
    """R lambda of coefficients (2H+1, n_pairs)."""
    rows, pairs = force.shape
    matrices = shaped(matrices, rows // 2 + 1, pairs, pairs, kind=complex)
    force, found = shaped(force, 2 * (rows // 2) + 1, pairs), np.empty((rows, pairs))
    kernel.respond(rows // 2, pairs, doubles(matrices), doubles(force), doubles(found))
    return found


def respond_to_columns(matrices: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """R T as a dense matrix for unknowns ordered (row, pair), from R_k (..., H+1, n_pairs, n_pairs)
    and T (..., n_pairs, 2H+1, n), at many points at once: (..., (2H+1) n_pairs, n n_pairs).

    A force a - i b on harmonic k moves the gap by R_k (a - i b), that is by the real matrix
    [[Re R_k, Im R_k], [-Im R_k, Re R_k]] on (a, b).
    """
    *points, pairs, rows, columns = tangent.shape
    of_each = (*points, rows // 2 + 1, pairs, pairs)
    matrices = shaped(np.broadcast_to(matrices, of_each), *of_each, kind=complex)
    tangent = shaped(tangent, *points, pairs, 2 * (rows // 2) + 1, columns)
    product = np.empty((*points, rows * pairs, columns * pairs))
    for at in np.ndindex(*points):
        kernel.respond_to_columns(
            rows // 2, pairs, columns, doubles(matrices[at]), doubles(tangent[at]),
            doubles(product[at]),
        )  # fmt: skip
    return product


@lru_cache(maxsize=64)
def grid_waves(harmonics: int) -> np.ndarray:
    """Waves on the first grid of the search, as the kernel takes them."""
    waves = np.empty((harmonics, 2, kernel.switching_cells(harmonics) // 4 + 1))
    kernel.switching_waves(harmonics, doubles(waves))
    return waves


def apply_to_pairs(tangent: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """Each pair's matrix (n_pairs, rows, columns) times its column of (columns, n_pairs)."""
    return np.matmul(tangent, gap.T[:, :, None])[:, :, 0].T


def _tangent(means: np.ndarray, harmonics: int) -> np.ndarray:
    """The Toeplitz plus Hankel matrix of every pair from c_m + i s_m: (n_pairs, 2H+1, 2H+1)."""
    lag, lag_sign, total, total_sign = _places(harmonics)
    parts = means[:, : 2 * harmonics + 1].copy().view(float)  # c_0, s_0, c_1, s_1, ...
    matrix: np.ndarray = parts.take(lag, axis=1)
    matrix *= lag_sign
    hankel = parts.take(total, axis=1)
    hankel *= total_sign
    matrix += hankel
    return matrix


@lru_cache(maxsize=64)
def _places(harmonics: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Where c_{i-j} or s_{i-j}, and c_{i+j} or s_{i+j}, stand among the means; with which signs."""
    row = np.arange(2 * harmonics + 1)
    order, sine = (row + 1) // 2, (row > 0) & (row % 2 == 0)
    difference = order[:, None] - order
    total = order[:, None] + order
    # Products of sines and cosines: a cosine of both kinds, or a sine where one is a sine.
    mixed = sine[:, None] != sine
    lag_sign = np.where(mixed, np.sign(difference) * np.where(sine, -1.0, 1.0), 1.0)
    total_sign = np.where(sine[:, None] & sine, -1.0, 1.0)
    # The row and column of the mean: each of them once, and twice in the column.
    lag_sign[0, :] = lag_sign[:, 0] = 0.0
    total_sign[1:, 0] = 2.0
    return 2 * np.abs(difference) + mixed, lag_sign, 2 * total + mixed, total_sign
