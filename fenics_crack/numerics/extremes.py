"""Maxima of periodic functions, to rounding error, from equally spaced samples.

Around each sample that may be the largest, a function is evaluated at nine instants. The
polynomial through the nine values predicts instant and value of the maximum, and the function is
evaluated at the predicted instant. If the prediction is wrong, as next to a kink, nine closer
instants around the largest value follow, and so on. No derivative is used. For a smooth maximum
the error is proportional to the square of the last distance between instants.

Instants are fractions of the period, from 0 to 1.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

PeriodicFunctions = Callable[[np.ndarray], np.ndarray]
"""Callable from instants (n,), fractions of the period, to values (n, m) of m functions."""
RecordFunction = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Callable from instants (n,), fractions of the period, to m observed displacements (n, m), gaps
(n, n_rows) [m] and contact forces (n, n_rows) [N]."""
POLYNOMIAL_SAMPLE_OFFSETS = np.linspace(-1.0, 1.0, 9)
"""Nine offsets from a sample, -1 to 1, in units of the samples' spacing."""
MAX_GRID_REFINEMENTS = 10
"""Maximum number of grid refinements. Each divides the spacing by four: 256 samples per period end
at 4e-9 periods. The square of 4e-9 is rounding error, for up to 100 harmonics."""
POLYNOMIAL_EXPONENTS = np.arange(len(POLYNOMIAL_SAMPLE_OFFSETS))
"""Exponents 0 to 8 of the polynomial through nine values."""
COEFFICIENTS_FROM_VALUES = np.linalg.inv(POLYNOMIAL_SAMPLE_OFFSETS[:, None] ** POLYNOMIAL_EXPONENTS)
"""Matrix from values at ``POLYNOMIAL_SAMPLE_OFFSETS`` to polynomial coefficients."""
MAX_POLYNOMIAL_ERROR = 1e-6
"""Maximum error of a maximum predicted by a polynomial, relative to the range of the nine values.
With a larger error the grid is refined."""


def find_maximum_values(
    samples: np.ndarray, evaluate_functions: PeriodicFunctions | None = None
) -> np.ndarray:
    """Return the maximum over a period of each of m periodic functions: (m,).

    Without ``evaluate_functions``, return the largest sample of each function.

    Parameters
    ----------
    samples : (n, m)
        Values at n equally spaced instants of the period, the first at 0.
    evaluate_functions : callable, optional
        Callable from instants (n,), fractions of the period, to values (n, m).
    """
    function_maxima: np.ndarray = np.max(samples, axis=0)
    previous_samples, next_samples = np.roll(samples, 1, 0), np.roll(samples, -1, 0)
    # A function exceeds its sample by less than the sample exceeds the lower neighbour.
    may_be_largest = 2.0 * samples - np.minimum(previous_samples, next_samples) >= function_maxima
    sample_indices, function_indices = np.nonzero(
        (samples > previous_samples) & (samples >= next_samples) & may_be_largest
    )
    period_fractions, sample_spacing = sample_indices / len(samples), 1.0 / len(samples)
    for refinement_index in range(MAX_GRID_REFINEMENTS):
        if evaluate_functions is None or not len(period_fractions):
            break
        candidate_peak_indices = np.arange(len(period_fractions))
        nearby_fractions = period_fractions[:, None] + sample_spacing * POLYNOMIAL_SAMPLE_OFFSETS
        nearby_values = evaluate_functions(nearby_fractions.ravel())
        nearby_values = nearby_values.reshape(*nearby_fractions.shape, -1)[
            candidate_peak_indices, :, function_indices
        ]
        largest_nearby_indices = nearby_values.argmax(axis=1)
        np.maximum.at(
            function_maxima,
            function_indices,
            nearby_values[candidate_peak_indices, largest_nearby_indices],
        )
        if refinement_index == 0:
            peak_offsets, peak_estimates = _maximise_polynomial(
                nearby_values, POLYNOMIAL_SAMPLE_OFFSETS[largest_nearby_indices]
            )
            peak_values = evaluate_functions(period_fractions + sample_spacing * peak_offsets)[
                candidate_peak_indices, function_indices
            ]
            np.maximum.at(function_maxima, function_indices, peak_values)
            allowed_error = MAX_POLYNOMIAL_ERROR * np.ptp(nearby_values, axis=1)
            is_polynomial_accurate = np.abs(peak_values - peak_estimates) <= allowed_error
            is_equal_to_largest = (
                nearby_values
                == nearby_values[candidate_peak_indices, largest_nearby_indices][:, None]
            )
            is_plateau = is_equal_to_largest.sum(axis=1) > 2  # a gap closed without penetration
            candidate_peak_indices = np.flatnonzero(~(is_polynomial_accurate | is_plateau))
        period_fractions = nearby_fractions[
            candidate_peak_indices, largest_nearby_indices[candidate_peak_indices]
        ]
        function_indices = function_indices[candidate_peak_indices]
        sample_spacing *= POLYNOMIAL_SAMPLE_OFFSETS[1] - POLYNOMIAL_SAMPLE_OFFSETS[0]
    return function_maxima


def _maximise_polynomial(
    nine_values: np.ndarray, start_offset_in_half_windows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Maximise n polynomials, each through nine values, by three Newton steps.

    Parameters
    ----------
    nine_values : (n, 9)
        Values at the offsets ``POLYNOMIAL_SAMPLE_OFFSETS``, equally spaced from -1 to 1.
    start_offset_in_half_windows : (n,)
        First guess for the offset of each maximum, from -1 to 1.

    Returns
    -------
    offset_in_half_windows : (n,)
        Offset of each maximum, from -1 to 1.
    maximum : (n,)
        Value of each polynomial at this offset.
    """
    coefficients = nine_values @ COEFFICIENTS_FROM_VALUES.T
    offset_in_half_windows = start_offset_in_half_windows
    slope_coefficients = coefficients[:, 1:] * POLYNOMIAL_EXPONENTS[1:]
    curvature_coefficients = slope_coefficients[:, 1:] * POLYNOMIAL_EXPONENTS[1:-1]
    for _ in range(3):
        offset_powers = offset_in_half_windows[:, None] ** POLYNOMIAL_EXPONENTS
        slopes = (slope_coefficients * offset_powers[:, :-1]).sum(1)
        curvatures = (curvature_coefficients * offset_powers[:, :-2]).sum(1)
        offset_in_half_windows = offset_in_half_windows - slopes / np.where(
            curvatures < 0.0, curvatures, -np.inf
        )
        offset_in_half_windows = np.minimum(np.maximum(offset_in_half_windows, -1.0), 1.0)
    return offset_in_half_windows, (
        coefficients * offset_in_half_windows[:, None] ** POLYNOMIAL_EXPONENTS
    ).sum(1)
