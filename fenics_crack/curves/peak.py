"""Largest response of a curve, and the damping ratio from its half-power width.

A linear mode with the damping ratio xi has a response above 1/sqrt(2) of its peak, half the power,
between the frequencies f_1 and f_2 with

    xi = (f_2 - f_1) / (2 f),

where f is the peak's frequency. Its inverse square amplitude 1/A^2 is a parabola in f^2. The peak
and the width therefore come from a cubic spline through 1/A^2 at the points of the curve. For a
breathing crack without clearance this holds, too: the response is proportional to the load.

Over the speed W of a rotor the natural frequency w_n changes with the load frequency p W. The width
in W then yields xi / (1 - s) with s = d ln w_n / d ln W; xi is reported.

The width is that of the first harmonic of the load. If a higher harmonic resonates, for example the
second at half the natural frequency, the first harmonic has no half-power width. No damping is then
reported: the width of the whole motion would be too large by its first harmonic, or too small
because contact feeds the higher harmonic.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from fenics_crack.basics.tables import (
    Described,
    add_frequency_entries,
    format_quantity,
    hertz_property,
)

RISING_AT_END_TEXT = "still rising at the end of the range"
"""Description of a largest response that is no peak."""


@dataclass(frozen=True)
class LargestResponse:
    """Largest response of a curve at one dof, interpolated between its points.

    The attributes are described in :class:`Peak`.
    """

    index: int
    value: float
    amplitude: float
    at_end: bool


@dataclass(frozen=True, repr=False)
class Peak(Described, LargestResponse):
    """Largest response of a curve at one dof.

    Attributes
    ----------
    index : int
        Index of the nearest point of the curve, for ``curve.solution(index)``.
    value : float
        Value of the curve's parameter.
    amplitude : float
        Half the peak-to-peak displacement [m].
    at_end : bool
        True at an end of the curve: the response is still rising, and there is no peak.
    omega : float
        Load frequency [rad/s].
    error : float
        Estimated error of the amplitude, relative to it.
    verdict : str
        Stability of the vibration.
    damping : float
        Damping ratio by the half-power width of the load's own harmonic. nan if this harmonic does
        not fall to 1/sqrt(2) on both sides, as if a higher one resonates, or if the curve is over
        neither the frequency nor the speed.
    omega_error : float
        Estimated error of the frequency, relative to it; nan if unknown, or if the response is
        still rising.
    without : str
        Causes missing in the errors: "error due to the mesh not included" for a curve alone
        (:class:`ErrorReport`); empty for :func:`fenics_crack.curve`, whose scene has a mesh.
    """

    omega: float
    error: float
    verdict: str
    damping: float
    omega_error: float = math.nan
    without: str = "error due to the mesh not included"

    frequency = hertz_property()

    def to_dict(self) -> dict[str, Any]:
        """Return the attributes and the frequency [Hz]."""
        return add_frequency_entries(dict(vars(self)))

    def _repr_text(self) -> str:
        damping_words = f"damping {self.damping:.3g}"
        if self.at_end:
            damping_words = RISING_AT_END_TEXT
        elif math.isnan(self.damping):
            damping_words = "damping unknown: no half-power width at the load frequency"
        error_words = f"error {self.error:.2g}"
        if not math.isnan(self.omega_error):
            error_words += f", of the frequency {self.omega_error:.2g}"
        error_words += f" ({self.without})" if self.without else ""
        frequency_words = f"{self.frequency:.6g} Hz ({self.omega:.6g} rad/s)"
        amplitude_words = format_quantity(self.amplitude, "m")
        peak_words = f"{amplitude_words} at {frequency_words}"
        return f"{peak_words}, {error_words}, {self.verdict}, {damping_words}"


def interpolate_peak_and_damping(
    values: np.ndarray, amplitudes: np.ndarray, peak_index: int
) -> tuple[float, float, float]:
    """Return the maximum of a curve between its points, and the damping ratio.

    Parameters
    ----------
    values, amplitudes : (n,)
        Parameter and amplitude of the points, in order along the curve.
    peak_index : int
        Index of the largest amplitude.

    Returns
    -------
    value, amplitude : float
        Maximum of the interpolated amplitude.
    damping : float
        Damping ratio by the half-power width; nan if a side of the peak is missing.
    """
    from scipy.interpolate import CubicSpline  # loading takes longer than drawing a curve

    peak_value, peak_amplitude = float(values[peak_index]), float(amplitudes[peak_index])
    first_index, last_index = (
        _half_power_index(values, amplitudes, peak_index, index_step) for index_step in (-1, 1)
    )
    if not first_index < peak_index < last_index:
        return peak_value, peak_amplitude, math.nan
    value_steps = np.diff(values[peak_index - 1 : peak_index + 2])
    if value_steps[0] * value_steps[1] <= 0.0:
        return peak_value, peak_amplitude, math.nan
    peak_slice = slice(first_index, last_index + 1)
    values_around_peak = values[peak_slice]
    relative_amplitudes = np.maximum(amplitudes[peak_slice] / peak_amplitude, np.finfo(float).eps)
    ascending_step = 1 if values_around_peak[-1] > values_around_peak[0] else -1
    spline = CubicSpline(
        values_around_peak[::ascending_step], relative_amplitudes[::ascending_step] ** -2.0
    )
    values_at_minima = spline.derivative().roots(extrapolate=False)
    neighbour_values = np.sort(values[[peak_index - 1, peak_index + 1]])
    values_at_minima = values_at_minima[
        (values_at_minima > neighbour_values[0]) & (values_at_minima < neighbour_values[1])
    ]
    top_value = float(min(values_at_minima, key=spline, default=peak_value))
    if not spline(top_value) > 0.0:  # as next to a zero response
        return top_value, peak_amplitude, math.nan
    half_power_values = spline.solve(2.0 * spline(top_value), extrapolate=False)
    band_start_value = half_power_values[half_power_values < top_value].max(initial=-math.inf)
    band_end_value = half_power_values[half_power_values > top_value].min(initial=math.inf)
    width = band_end_value - band_start_value
    damping = float(width / (2.0 * top_value)) if math.isfinite(width) else math.nan
    return top_value, peak_amplitude * float(spline(top_value) ** -0.5), damping


def damping_by_half_power_width(
    values: np.ndarray, coefficients: np.ndarray, subharmonic: int, peak_index: int
) -> float:
    """Return the damping ratio by the half-power width of the load's own harmonic.

    ``coefficients`` are (n, 2H+1), and ``peak_index`` is the point of the largest response. The
    result is nan if a side of the peak is missing.
    """
    cosine, sine = coefficients[:, 2 * subharmonic - 1], coefficients[:, 2 * subharmonic]
    return interpolate_peak_and_damping(values, np.hypot(cosine, sine), peak_index)[2]


def _half_power_index(
    values: np.ndarray, amplitudes: np.ndarray, peak_index: int, index_step: int
) -> int:
    """Return the first index below half the peak's power, on one side.

    If the curve ends or turns back before, return the last point before. ``index_step`` is
    -1 or 1.
    """
    index, last_value_change = peak_index, 0.0
    half_power_amplitude = amplitudes[peak_index] / math.sqrt(2.0)
    while amplitudes[index] >= half_power_amplitude and 0 <= index + index_step < len(values):
        value_change = values[index + index_step] - values[index]
        if value_change * last_value_change < 0.0 or value_change == 0.0:
            break
        index, last_value_change = index + index_step, value_change
    return index
