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
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from fenics_crack.kernel import doubles, kernel, shaped
from fenics_crack.model.contact import ContactLaw, is_piecewise_linear
from fenics_crack.numerics.fourier import balanced, sampled

__all__ = [
    "ContactIntegrals",
    "ExactIntegrals",
    "SampledIntegrals",
    "apply_to_pairs",
    "contact_integrals",
    "default_samples",
    "grid_waves",
]


@dataclass(frozen=True)
class ContactIntegrals(ABC):
    """A way of integrating the contact force of gaps (2H+1, n_pairs)."""

    law: ContactLaw
    harmonics: int

    @abstractmethod
    def force(self, gap: np.ndarray) -> np.ndarray:
        """Coefficients of the contact force: (2H+1, n_pairs) [N]."""

    @abstractmethod
    def linearise(self, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (2H+1, n_pairs) [N] and their derivative (n_pairs, 2H+1, 2H+1) [N/m]."""

    @abstractmethod
    def widened(self, harmonics: int) -> ContactIntegrals:
        """The same with more harmonics, and samples enough for them."""

    def of_law(self, law: ContactLaw) -> ContactIntegrals:
        """The same of another law of the same kind."""
        return replace(self, law=law)


def contact_integrals(
    law: ContactLaw, harmonics: int, samples: int | None = None, periods: int = 1
) -> ContactIntegrals:
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

    def force(self, gap: np.ndarray) -> np.ndarray:
        return self.balance(self.law.force(self.sample(gap)))

    def linearise(self, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = self.sample(gap)
        means = self._means(values, 2 * self.harmonics)
        return self.balance(self.law.force(values)), _tangent(means, self.harmonics)

    def widened(self, harmonics: int) -> SampledIntegrals:
        samples = max(self.samples, 1 << (8 * harmonics - 1).bit_length())
        return SampledIntegrals(self.law, harmonics, samples)

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


class ExactIntegrals(ContactIntegrals):
    """Closed form between the switching instants, for lambda = k max(g, 0).

    With kappa = k where the pair is closed, else 0,

        c_m + i s_m = k / (2 pi) sum int exp(i m theta) d theta,

    and since lambda = kappa g, the coefficients of the force are just the tangent times the gap's.
    """

    def force(self, gap: np.ndarray) -> np.ndarray:
        return self.linearise(gap)[0]

    def linearise(self, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows, pairs = gap.shape
        gap = shaped(gap, 2 * self.harmonics + 1, pairs)
        stiffness = np.empty(pairs)
        stiffness[:] = self.law.stiffness
        force, tangent = np.empty((rows, pairs)), np.empty((pairs, rows, rows))
        failed = kernel.contact_integrals(
            self.harmonics, pairs, doubles(gap), doubles(stiffness),
            doubles(grid_waves(self.harmonics)), doubles(np.empty(2 * pairs * rows)),
            doubles(force), doubles(tangent),
        )  # fmt: skip
        if failed:
            raise MemoryError("contact integrals")
        return force, tangent

    def widened(self, harmonics: int) -> ExactIntegrals:
        return ExactIntegrals(self.law, harmonics)


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
