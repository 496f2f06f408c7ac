"""Fourier coefficients in the paper's order.

    x(t) = a0 + sum_{k=1}^{H} a_k cos(k w t) + b_k sin(k w t)

Rows of real coefficients are a0, a1, b1, ..., aH, bH (eq. 9). Complex harmonics are
X_k = a_k - i b_k, so that x = Re sum_k X_k exp(i k w t).
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # importing it takes a tenth of NumPy's own time
    from numpy.typing import ArrayLike

MAX_MATRIX_ENTRIES = 45_000
"""Maximum size (2H+1) n_instants of the matrix between coefficients and samples. A larger transform
uses an FFT. Measured for 1 to 100 columns and H = 20 to 100: up to this size a matrix product takes
about as long as an FFT, and SciPy's FFT need not be loaded."""


def to_complex(coefficients: np.ndarray) -> np.ndarray:
    """Convert real Fourier coefficients (2H+1, ...) to complex harmonics (H+1, ...).

    X_k = a_k - i b_k from the rows a0, a1, b1, ..., aH, bH.
    """
    complex_harmonics = np.zeros(
        (len(coefficients) // 2 + 1, *coefficients.shape[1:]), dtype=complex
    )
    complex_harmonics.real[0], complex_harmonics.real[1:] = coefficients[0], coefficients[1::2]
    # Not np.negative: NumPy 2.2 misreads strided input where the output is strided too.
    np.subtract(0.0, coefficients[2::2], out=complex_harmonics.imag[1:])
    return complex_harmonics


def from_complex(complex_harmonics: np.ndarray) -> np.ndarray:
    """Convert complex harmonics (H+1, ...) to real Fourier coefficients (2H+1, ...).

    From X_k = a_k - i b_k come the rows a0, a1, b1, ..., aH, bH. The imaginary part of X_0 is
    ignored.
    """
    coefficients = np.empty((2 * len(complex_harmonics) - 1, *complex_harmonics.shape[1:]))
    coefficients[0] = complex_harmonics[0].real
    coefficients[1::2] = complex_harmonics[1:].real
    coefficients[2::2] = -complex_harmonics[1:].imag
    return coefficients


def fourier_basis(phase: np.ndarray, orders: ArrayLike = (1.0,)) -> np.ndarray:
    """Return the Fourier basis 1, cos k theta, sin k theta, ... at phases theta.

    Parameters
    ----------
    phase : (...) [rad]
        Phases theta.
    orders : (K,)
        Harmonic orders k, not necessarily integers. Default: 1.

    Returns
    -------
    (..., 2K+1)
        The constant 1, then cosine and sine for each order.
    """
    order_times_phase = np.multiply.outer(phase, orders)
    basis_values = np.ones((*order_times_phase.shape[:-1], 2 * order_times_phase.shape[-1] + 1))
    basis_values[..., 1::2], basis_values[..., 2::2] = (
        np.cos(order_times_phase),
        np.sin(order_times_phase),
    )
    return basis_values


def fourier_basis_for(coefficients: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """Return the Fourier basis 1, cos theta, sin theta, ... for given coefficients.

    ``phases`` (...) [rad] holds the phases theta; the result is (..., 2H+1), up to harmonic H. Of
    ``coefficients`` (2H+1, ...) only the number of rows is used.
    """
    phases, n_harmonics = np.asarray(phases, dtype=float), len(coefficients) // 2
    exponential_powers = np.ones((n_harmonics + 1, *phases.shape), dtype=complex)
    if n_harmonics:
        exponential_powers[1] = np.exp(1j * phases)
    n_computed_powers = 1
    while (
        n_computed_powers < n_harmonics
    ):  # exp(i k theta): a fifth of the time of sines and cosines
        n_new_powers = min(n_computed_powers, n_harmonics - n_computed_powers)
        exponential_powers[n_computed_powers + 1 : n_computed_powers + 1 + n_new_powers] = (
            exponential_powers[1 : 1 + n_new_powers] * exponential_powers[n_computed_powers]
        )
        n_computed_powers += n_new_powers
    basis_values = np.empty((len(coefficients), *phases.shape))
    basis_values[0], basis_values[1::2], basis_values[2::2] = (
        1.0,
        exponential_powers[1:].real,
        exponential_powers[1:].imag,
    )
    return np.moveaxis(basis_values, 0, -1)


def evaluate_series(coefficients: np.ndarray, omega: float, time: np.ndarray) -> np.ndarray:
    """Evaluate a Fourier series x(t) at times (n,) [s]: (n, ...).

    ``coefficients`` (2H+1, ...) have the rows a0, a1, b1, ..., aH, bH. ``omega`` [rad/s] is the
    angular frequency of harmonic 1.
    """
    phase = omega * np.atleast_1d(np.asarray(time, dtype=float))
    return np.tensordot(fourier_basis_for(coefficients, phase), coefficients, 1)


def differentiate(coefficients: np.ndarray, omega: float) -> np.ndarray:
    """Return the Fourier coefficients (2H+1, n) of x'(t) from those of x(t).

    ``omega`` [rad/s] is the angular frequency of harmonic 1.
    """
    harmonic_omegas = omega * np.arange(1, len(coefficients) // 2 + 1)[:, None]
    derivative_coefficients = np.zeros_like(coefficients)
    derivative_coefficients[1::2] = harmonic_omegas * coefficients[2::2]
    derivative_coefficients[2::2] = -harmonic_omegas * coefficients[1::2]
    return derivative_coefficients


def sample_period(coefficients: np.ndarray, n_instants: int) -> np.ndarray:
    """Evaluate a Fourier series at equally spaced instants of a period: (n_instants, ...).

    ``coefficients`` are (2H+1, ...). The first instant has phase 0. ``n_instants`` must exceed 2H.
    """
    if len(coefficients) * n_instants <= MAX_MATRIX_ENTRIES:
        return _multiply_first_axis(
            fourier_basis_over_period(len(coefficients) // 2, n_instants), coefficients
        )
    import scipy.fft  # slow to import, and needed for long series only

    spectrum = 0.5 * n_instants * to_complex(coefficients)
    spectrum[0] *= 2.0
    return np.asarray(scipy.fft.irfft(spectrum, n=n_instants, axis=0))


def fourier_coefficients(samples: np.ndarray, harmonics: int) -> np.ndarray:
    """Return Fourier coefficients (2H+1, ...) of samples over a period.

    ``samples`` (n, ...) are n > 2H equally spaced values from phase 0 on; H = ``harmonics``.
    """
    if (2 * harmonics + 1) * len(samples) <= MAX_MATRIX_ENTRIES:
        return _multiply_first_axis(
            _samples_to_coefficients_matrix(harmonics, len(samples)), samples
        )
    import scipy.fft

    spectrum = scipy.fft.rfft(samples, axis=0)[: harmonics + 1] * (2.0 / len(samples))
    spectrum[0] *= 0.5
    return from_complex(spectrum)


def n_instants_for_products(harmonics: int) -> int:
    """Return the number of samples per period for products of Fourier series.

    The factors have H = ``harmonics`` and 2H harmonics. With 4H + 1 samples or more, the product's
    harmonics up to H are exact. The result may be a little larger, to suit the FFT.
    """
    min_instants = 4 * harmonics + 1
    if (2 * harmonics + 1) * min_instants <= MAX_MATRIX_ENTRIES:
        return min_instants
    import scipy.fft

    return int(scipy.fft.next_fast_len(min_instants, real=True))


@lru_cache(maxsize=16)
def fourier_basis_over_period(harmonics: int, n_instants: int) -> np.ndarray:
    """Return the Fourier basis at equally spaced instants of a period.

    Returns
    -------
    (n_instants, 2H+1)
        Columns 1, cos, sin, ... up to H = ``harmonics``. Read-only: all callers share the array.
    """
    instant_indices, orders = np.arange(n_instants), np.arange(1, harmonics + 1)
    roots_of_unity = np.exp(2j * np.pi / n_instants * instant_indices)
    exponentials = roots_of_unity[np.outer(instant_indices, orders) % n_instants]
    basis_values = np.ones((n_instants, 2 * harmonics + 1))
    basis_values[:, 1::2], basis_values[:, 2::2] = exponentials.real, exponentials.imag
    basis_values.flags.writeable = False  # all callers share it
    return basis_values


@lru_cache(maxsize=16)
def _samples_to_coefficients_matrix(harmonics: int, n_instants: int) -> np.ndarray:
    """Return the matrix from samples of a period to Fourier coefficients: (2H+1, n_instants)."""
    coefficients_from_samples = (
        2.0 / n_instants * fourier_basis_over_period(harmonics, n_instants).T
    )
    coefficients_from_samples[0] *= 0.5
    return coefficients_from_samples


def _multiply_first_axis(matrix: np.ndarray, array: np.ndarray) -> np.ndarray:
    """Multiply a matrix (m, n) by an array (n, ...) along the first axis: (m, ...)."""
    product: np.ndarray = matrix @ array.reshape(len(array), -1)
    return product.reshape(len(matrix), *array.shape[1:])


def resize_harmonics(coefficients: np.ndarray, harmonics: int) -> np.ndarray:
    """Truncate or zero-pad Fourier coefficients (2K+1, ...) to H harmonics: (2H+1, ...).

    H = ``harmonics``.
    """
    resized_coefficients = np.zeros((2 * harmonics + 1, *coefficients.shape[1:]))
    n_kept_rows = min(len(resized_coefficients), len(coefficients))
    resized_coefficients[:n_kept_rows] = coefficients[:n_kept_rows]
    return resized_coefficients


def stretch_period(coefficients: np.ndarray, period_factor: int) -> np.ndarray:
    """Return the Fourier coefficients of the same motion for a longer base period.

    The new period is ``period_factor`` times the old one. Harmonic k becomes harmonic k *
    period_factor, and the harmonics between are zero. ``coefficients`` (2H+1, ...) become (2H
    period_factor + 1, ...).
    """
    complex_harmonics = to_complex(coefficients)
    stretched_harmonics = np.zeros(
        (period_factor * (len(complex_harmonics) - 1) + 1, *complex_harmonics.shape[1:]),
        dtype=complex,
    )
    stretched_harmonics[::period_factor] = complex_harmonics
    return from_complex(stretched_harmonics)
