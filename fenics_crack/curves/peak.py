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
"""Words printed with a largest response at an end of the curve."""


@dataclass(frozen=True)
class LargestResponse:
    """Largest response of a curve at one dof, interpolated between its points.

    Attributes
    ----------
    index : int
        Index of the nearest point of the curve.
    value : float
        Curve parameter at the peak.
    amplitude : float
        Half the peak-to-peak displacement [m].
    at_end : bool
        True if the largest response is the first or last point.
    """

    index: int
    value: float
    amplitude: float
    at_end: bool


@dataclass(frozen=True, repr=False)
class Peak(Described, LargestResponse):
    """Largest response of a curve at one dof, with error, stability and damping.

    Attributes
    ----------
    index : int
        Index of the nearest point of the curve, for ``curve.solution(index)``.
    value : float
        Curve parameter at the peak, for example the load frequency [rad/s].
    amplitude : float
        Half the peak-to-peak displacement [m].
    at_end : bool
        True if the largest response is the first or last point: the curve then has no peak.
    omega : float
        Load frequency [rad/s].
    error : float
        Estimated relative error of the amplitude; 1: unknown.
    verdict : str
        Stability of the vibration: "stable", "unstable", "irregular" or "undecided".
    damping : float
        Damping ratio by the half-power width of the load's own harmonic. nan if this harmonic does
        not fall to 1/sqrt(2) on both sides; an example: a higher harmonic resonates. Also nan if
        the parameter is neither the frequency nor the speed.
    omega_error : float
        Estimated relative error of the frequency; nan if unknown, or if the response is still
        rising.
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
        """Return the attributes by name, with the frequency in Hz."""
        return add_frequency_entries(dict(vars(self)))

    def _repr_text(self) -> str:
        damping_text = f"damping {self.damping:.3g}"
        if self.at_end:
            damping_text = RISING_AT_END_TEXT
        elif math.isnan(self.damping):
            damping_text = "damping unknown: no half-power width at the load frequency"
        error_text = f"error {self.error:.2g}"
        if not math.isnan(self.omega_error):
            error_text += f", of the frequency {self.omega_error:.2g}"
        error_text += f" ({self.without})" if self.without else ""
        frequency_text = f"{self.frequency:.6g} Hz ({self.omega:.6g} rad/s)"
        amplitude_text = format_quantity(self.amplitude, "m")
        peak_text = f"{amplitude_text} at {frequency_text}"
        return f"{peak_text}, {error_text}, {self.verdict}, {damping_text}"


def interpolate_peak_and_damping(
    parameter_values: np.ndarray, amplitudes: np.ndarray, peak_index: int
) -> tuple[float, float, float]:
    """Return the peak of a curve between its points, and the damping ratio.

    A cubic spline through 1/A^2 gives both, where A is the amplitude.

    Parameters
    ----------
    parameter_values, amplitudes : (n,)
        Parameter and amplitude of the points, in order along the curve.
    peak_index : int
        Index of the largest amplitude.

    Returns
    -------
    value, amplitude : float
        Parameter and amplitude at the peak. If the point at ``peak_index`` has no neighbour on a
        side, or if the curve turns back there, they are those of this point.
    damping_ratio : float
        Width at 1/sqrt(2) of the peak's amplitude, divided by twice the peak's parameter. nan if
        the amplitude does not fall so far on both sides.
    """
    from scipy.interpolate import CubicSpline  # loading takes longer than drawing a curve

    peak_parameter, peak_amplitude = (
        float(parameter_values[peak_index]),
        float(amplitudes[peak_index]),
    )
    first_index, last_index = (
        _first_index_below_half_power(parameter_values, amplitudes, peak_index, search_direction)
        for search_direction in (-1, 1)
    )
    if not first_index < peak_index < last_index:
        return peak_parameter, peak_amplitude, math.nan
    parameter_steps = np.diff(parameter_values[peak_index - 1 : peak_index + 2])
    if parameter_steps[0] * parameter_steps[1] <= 0.0:
        return peak_parameter, peak_amplitude, math.nan
    peak_slice = slice(first_index, last_index + 1)
    parameters_around_peak = parameter_values[peak_slice]
    relative_amplitudes = np.maximum(amplitudes[peak_slice] / peak_amplitude, np.finfo(float).eps)
    ascending_slice_stride = 1 if parameters_around_peak[-1] > parameters_around_peak[0] else -1
    inverse_square_spline = CubicSpline(
        parameters_around_peak[::ascending_slice_stride],
        relative_amplitudes[::ascending_slice_stride] ** -2.0,
    )
    parameters_at_spline_minima = inverse_square_spline.derivative().roots(extrapolate=False)
    neighbour_parameters = np.sort(parameter_values[[peak_index - 1, peak_index + 1]])
    parameters_at_spline_minima = parameters_at_spline_minima[
        (parameters_at_spline_minima > neighbour_parameters[0])
        & (parameters_at_spline_minima < neighbour_parameters[1])
    ]
    interpolated_peak_parameter = float(
        min(parameters_at_spline_minima, key=inverse_square_spline, default=peak_parameter)
    )
    if not inverse_square_spline(interpolated_peak_parameter) > 0.0:  # as next to a zero response
        return interpolated_peak_parameter, peak_amplitude, math.nan
    half_power_parameters = inverse_square_spline.solve(
        2.0 * inverse_square_spline(interpolated_peak_parameter), extrapolate=False
    )
    band_start_parameter = half_power_parameters[
        half_power_parameters < interpolated_peak_parameter
    ].max(initial=-math.inf)
    band_end_parameter = half_power_parameters[
        half_power_parameters > interpolated_peak_parameter
    ].min(initial=math.inf)
    half_power_width = band_end_parameter - band_start_parameter
    damping_ratio = (
        float(half_power_width / (2.0 * interpolated_peak_parameter))
        if math.isfinite(half_power_width)
        else math.nan
    )
    return (
        interpolated_peak_parameter,
        peak_amplitude * float(inverse_square_spline(interpolated_peak_parameter) ** -0.5),
        damping_ratio,
    )


def damping_by_half_power_width(
    parameter_values: np.ndarray, coefficients: np.ndarray, subharmonic: int, peak_index: int
) -> float:
    """Return the damping ratio by the half-power width of the load's own harmonic.

    The width is measured at 1/sqrt(2) of the harmonic's amplitude at the peak.

    Parameters
    ----------
    parameter_values : (n,)
        Parameter at each point, in order along the curve.
    coefficients : (n, 2H+1)
        Displacement coefficients of a dof at each point: mean, then cosine and sine of harmonics 1
        to H.
    subharmonic : int
        Number of load periods in a response period; the load's own harmonic is this one.
    peak_index : int
        Index of the point with the largest response.

    Returns
    -------
    float
        Damping ratio; nan if the harmonic does not fall to 1/sqrt(2) on both sides.
    """
    cosine_coefficients, sine_coefficients = (
        coefficients[:, 2 * subharmonic - 1],
        coefficients[:, 2 * subharmonic],
    )
    return interpolate_peak_and_damping(
        parameter_values, np.hypot(cosine_coefficients, sine_coefficients), peak_index
    )[2]


def _first_index_below_half_power(
    parameter_values: np.ndarray, amplitudes: np.ndarray, peak_index: int, search_direction: int
) -> int:
    """Return the index of the first point below half power, on one side of the peak.

    Below half power, the amplitude is less than 1/sqrt(2) times the peak's amplitude. If the curve
    ends or turns back first, the last index before the turn is returned.

    Parameters
    ----------
    parameter_values, amplitudes : (n,)
        Parameter and amplitude of the points, in order along the curve.
    peak_index : int
        Index of the largest amplitude.
    search_direction : -1 or 1
        -1: search the points before the peak. 1: search the points after the peak.
    """
    point_index, last_parameter_change = peak_index, 0.0
    half_power_amplitude = amplitudes[peak_index] / math.sqrt(2.0)
    while amplitudes[
        point_index
    ] >= half_power_amplitude and 0 <= point_index + search_direction < len(parameter_values):
        parameter_change = (
            parameter_values[point_index + search_direction] - parameter_values[point_index]
        )
        if parameter_change * last_parameter_change < 0.0 or parameter_change == 0.0:
            break
        point_index, last_parameter_change = point_index + search_direction, parameter_change
    return point_index
