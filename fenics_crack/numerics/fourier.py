"""Fourier coefficients in the paper's order.

    x(t) = a0 + sum_{k=1}^{H} a_k cos(k w t) + b_k sin(k w t),  rows a0, a1, b1, ..., aH, bH (eq. 9)

The complex form of the k-th harmonic is X_k = a_k - i b_k, so that x = Re sum_k X_k exp(i k w t).
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # which takes a tenth of NumPy's own time
    from numpy.typing import ArrayLike

MAX_MATRIX_SIZE = 45_000
"""Numbers in the values of all harmonics at all instants up to which a product with them is about
the work of an FFT (measured with 1 to 100 columns, H = 20 to 100), whose library need not load."""


def to_complex(coefficients: np.ndarray) -> np.ndarray:
    """Rows a0, a1, b1, ... (2H+1, ...) as complex harmonics X_0, ..., X_H (H+1, ...)."""
    harmonics = np.zeros((len(coefficients) // 2 + 1, *coefficients.shape[1:]), dtype=complex)
    harmonics.real[0], harmonics.real[1:] = coefficients[0], coefficients[1::2]
    # Not np.negative: NumPy 2.2 misreads strided input where the output is strided too.
    np.subtract(0.0, coefficients[2::2], out=harmonics.imag[1:])
    return harmonics


def from_complex(harmonics: np.ndarray) -> np.ndarray:
    """Complex harmonics (H+1, ...) as rows a0, a1, b1, ... (2H+1, ...)."""
    coefficients = np.empty((2 * len(harmonics) - 1, *harmonics.shape[1:]))
    coefficients[0] = harmonics[0].real
    coefficients[1::2] = harmonics[1:].real
    coefficients[2::2] = -harmonics[1:].imag
    return coefficients


def fourier_basis(phase: np.ndarray, orders: ArrayLike = (1.0,)) -> np.ndarray:
    """1, cos k theta, sin k theta, ... of orders k (K,) at phases (...): (..., 2K+1)."""
    angle = np.multiply.outer(phase, orders)
    terms = np.ones((*angle.shape[:-1], 2 * angle.shape[-1] + 1))
    terms[..., 1::2], terms[..., 2::2] = np.cos(angle), np.sin(angle)
    return terms


def fourier_basis_for(rows: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """1, cos theta, sin theta, cos 2 theta, ... of as many rows at phases (...): (..., rows)."""
    phase, last = np.asarray(phase, dtype=float), len(rows) // 2
    powers = np.ones((last + 1, *phase.shape), dtype=complex)
    if last:
        powers[1] = np.exp(1j * phase)
    done = 1
    while done < last:  # exp(i k theta): a fifth of the time of sines and cosines
        more = min(done, last - done)
        powers[done + 1 : done + 1 + more] = powers[1 : 1 + more] * powers[done]
        done += more
    terms = np.empty((len(rows), *phase.shape))
    terms[0], terms[1::2], terms[2::2] = 1.0, powers[1:].real, powers[1:].imag
    return np.moveaxis(terms, 0, -1)


def evaluate(coefficients: np.ndarray, omega: float, time: np.ndarray) -> np.ndarray:
    """x(t) at times (n,) [s] of coefficients (2H+1, ...): (n, ...)."""
    phase = omega * np.atleast_1d(np.asarray(time, dtype=float))
    return np.tensordot(fourier_basis_for(coefficients, phase), coefficients, 1)


def differentiate(coefficients: np.ndarray, omega: float) -> np.ndarray:
    """Coefficients of x'(t) by those of x(t), rows a0, a1, b1, ...: (2H+1, n)."""
    rate = omega * np.arange(1, len(coefficients) // 2 + 1)[:, None]
    found = np.zeros_like(coefficients)
    found[1::2], found[2::2] = rate * coefficients[2::2], -rate * coefficients[1::2]
    return found


def sample_period(coefficients: np.ndarray, count: int) -> np.ndarray:
    """Values at the instants i T / count of coefficients (2H+1, ...), 2H < count: (count, ...)."""
    if len(coefficients) * count <= MAX_MATRIX_SIZE:
        return _multiply_columns(
            fourier_basis_over_period(len(coefficients) // 2, count), coefficients
        )
    import scipy.fft  # takes a while, and long series alone need it

    spectrum = 0.5 * count * to_complex(coefficients)
    spectrum[0] *= 2.0
    return np.asarray(scipy.fft.irfft(spectrum, n=count, axis=0))


def fourier_coefficients(values: np.ndarray, harmonics: int) -> np.ndarray:
    """Coefficients (2H+1, ...) of values at equally spaced instants, more than 2H."""
    if (2 * harmonics + 1) * len(values) <= MAX_MATRIX_SIZE:
        return _multiply_columns(_analysis_matrix(harmonics, len(values)), values)
    import scipy.fft

    spectrum = scipy.fft.rfft(values, axis=0)[: harmonics + 1] * (2.0 / len(values))
    spectrum[0] *= 0.5
    return from_complex(spectrum)


def count_instants(harmonics: int) -> int:
    """As few equally spaced instants as products of waves of H and 2H harmonics need, or a few more
    with which an FFT is fast."""
    least = 4 * harmonics + 1
    if (2 * harmonics + 1) * least <= MAX_MATRIX_SIZE:
        return least
    import scipy.fft

    return int(scipy.fft.next_fast_len(least, real=True))


@lru_cache(maxsize=16)
def fourier_basis_over_period(harmonics: int, count: int) -> np.ndarray:
    """Values of 1, cos k theta, sin k theta at the instants i T / count: (count, 2H+1)."""
    instants, order = np.arange(count), np.arange(1, harmonics + 1)
    turned = np.exp(2j * np.pi / count * instants)[np.outer(instants, order) % count]
    found = np.ones((count, 2 * harmonics + 1))
    found[:, 1::2], found[:, 2::2] = turned.real, turned.imag
    found.flags.writeable = False  # all have the same
    return found


@lru_cache(maxsize=16)
def _analysis_matrix(harmonics: int, count: int) -> np.ndarray:
    """What makes coefficients of values there: (2H+1, count)."""
    means = 2.0 / count * fourier_basis_over_period(harmonics, count).T
    means[0] *= 0.5
    return means


def _multiply_columns(matrix: np.ndarray, columns: np.ndarray) -> np.ndarray:
    found: np.ndarray = matrix @ columns.reshape(len(columns), -1)
    return found.reshape(len(matrix), *columns.shape[1:])


def resize_harmonics(coefficients: np.ndarray, harmonics: int) -> np.ndarray:
    """Coefficients cut off or padded with zeros to a number of harmonics."""
    padded = np.zeros((2 * harmonics + 1, *coefficients.shape[1:]))
    rows = min(len(padded), len(coefficients))
    padded[:rows] = coefficients[:rows]
    return padded


def stretch_period(coefficients: np.ndarray, factor: int) -> np.ndarray:
    """The same wave as one of ``factor`` times the period: harmonic k becomes harmonic factor k."""
    harmonics = to_complex(coefficients)
    longer = np.zeros((factor * (len(harmonics) - 1) + 1, *harmonics.shape[1:]), dtype=complex)
    longer[::factor] = harmonics
    return from_complex(longer)
