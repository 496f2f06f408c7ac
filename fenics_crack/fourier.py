"""Fourier coefficients in the paper's order, and contact balanced between time and frequency.

    x(t) = a0 + sum_{k=1}^{H} a_k cos(k w t) + b_k sin(k w t),   rows a0, a1, b1, ..., aH, bH (eq. 9)

The complex form of the k-th harmonic is X_k = a_k - i b_k, so that x = Re sum_k X_k exp(i k w t).
"""

from __future__ import annotations

import numpy as np

__all__ = ["SampledContact", "evaluate", "from_complex", "resized", "to_complex"]


def to_complex(coefficients: np.ndarray) -> np.ndarray:
    """Rows a0, a1, b1, ... (2H+1, ...) as complex harmonics X_0, ..., X_H (H+1, ...)."""
    harmonics = coefficients[1::2] - 1j * coefficients[2::2]
    return np.concatenate([coefficients[:1].astype(complex), harmonics])


def from_complex(harmonics: np.ndarray) -> np.ndarray:
    """Complex harmonics (H+1, ...) as rows a0, a1, b1, ... (2H+1, ...)."""
    coefficients = np.empty((2 * len(harmonics) - 1, *harmonics.shape[1:]))
    coefficients[0] = harmonics[0].real
    coefficients[1::2] = harmonics[1:].real
    coefficients[2::2] = -harmonics[1:].imag
    return coefficients


def evaluate(coefficients: np.ndarray, omega: float, time: np.ndarray) -> np.ndarray:
    """x(t) at times (n,) [s] of coefficients (2H+1, ...): (n, ...)."""
    phase = omega * np.multiply.outer(
        np.atleast_1d(np.asarray(time, dtype=float)), np.arange(1, (len(coefficients) + 1) // 2)
    )
    basis = np.ones((len(phase), len(coefficients)))
    basis[:, 1::2] = np.cos(phase)
    basis[:, 2::2] = np.sin(phase)
    return np.tensordot(basis, coefficients, axes=1)


def resized(coefficients: np.ndarray, harmonics: int) -> np.ndarray:
    """Coefficients cut off or padded with zeros to a number of harmonics."""
    padded = np.zeros((2 * harmonics + 1, *coefficients.shape[1:]))
    rows = min(len(padded), len(coefficients))
    padded[:rows] = coefficients[:rows]
    return padded


class SampledContact:
    """Contact force balanced in frequency from equally spaced samples of the gap (eqs 7 and 14).

    The trapezoidal rule on N instants; by the fast Fourier transform, for all pairs at once. The
    tangent of one pair is a Toeplitz plus a Hankel matrix in the harmonics of d lambda / d g: with
    c_m and s_m the means of the tangent times cos(m w t) and sin(m w t),

        d a0_i / d ...:  row 0:      c_0,              c_j,               s_j
                         row a_i:    2 c_i,   c_{i-j} + c_{i+j},   s_{i+j} - s_{i-j}
                         row b_i:    2 s_i,   s_{i+j} + s_{i-j},   c_{i-j} - c_{i+j}

    Parameters
    ----------
    harmonics : int
        H.
    samples : int
        N > 4 H, so that no product of two harmonics is aliased.
    """

    def __init__(self, harmonics: int, samples: int) -> None:
        self.harmonics = harmonics
        self.samples = samples

    def sample(self, coefficients: np.ndarray) -> np.ndarray:
        """Values (N, n_pairs) at the instants i T / N of coefficients (2H+1, n_pairs)."""
        spectrum = 0.5 * self.samples * to_complex(coefficients)
        spectrum[0] *= 2.0
        return np.fft.irfft(spectrum, n=self.samples, axis=0)

    def balance(self, values: np.ndarray) -> np.ndarray:
        """Coefficients (2H+1, n_pairs) of samples (N, n_pairs)."""
        spectrum = np.fft.rfft(values, axis=0)[: self.harmonics + 1] * (2.0 / self.samples)
        spectrum[0] *= 0.5
        return from_complex(spectrum)

    def tangent(self, slopes: np.ndarray) -> np.ndarray:
        """Derivative of the balanced force by the gap's coefficients: (n_pairs, 2H+1, 2H+1).

        Parameters
        ----------
        slopes : (N, n_pairs)
            d lambda / d g at the instants.
        """
        count = self.harmonics
        spectrum = np.fft.rfft(slopes, axis=0)[: 2 * count + 1].T / self.samples
        cosine, sine = spectrum.real, -spectrum.imag
        order = np.arange(1, count + 1)
        total = order[:, None] + order
        difference = order[:, None] - order
        sign = np.sign(difference)
        cosine_of_difference = cosine[:, np.abs(difference)]
        sine_of_difference = sign * sine[:, np.abs(difference)]
        matrix = np.empty((slopes.shape[1], 2 * count + 1, 2 * count + 1))
        matrix[:, 0, 0] = cosine[:, 0]
        matrix[:, 0, 1::2] = cosine[:, order]
        matrix[:, 0, 2::2] = sine[:, order]
        matrix[:, 1::2, 0] = 2.0 * cosine[:, order]
        matrix[:, 2::2, 0] = 2.0 * sine[:, order]
        matrix[:, 1::2, 1::2] = cosine_of_difference + cosine[:, total]
        matrix[:, 1::2, 2::2] = sine[:, total] - sine_of_difference
        matrix[:, 2::2, 1::2] = sine[:, total] + sine_of_difference
        matrix[:, 2::2, 2::2] = cosine_of_difference - cosine[:, total]
        return matrix
