"""The largest response of a curve, and the damping that its width stands for.

Of a linear mode with the ratio xi of critical damping the response is above 1/sqrt(2) of its peak,
half of its power, between f_1 and f_2 with

    xi = (f_2 - f_1) / (2 f),

f being the frequency of the peak, and 1/A^2 of its amplitude A is a parabola in f^2: the top and
the width are those of a cubic spline through the 1/A^2 of the points. A crack that breathes without
clearance keeps this, as its response is proportional to the load.

Over the speed W of a rotor, w_n itself follows the load's frequency p W: the width in W is that of
a ratio of xi / (1 - s), s = d ln w_n / d ln W, and xi is reported.

The width is that of the load's own harmonic. Where a higher one resonates, as the second at half
the natural frequency, the load's own goes on beside it without a width, and no width is a damping:
that of the whole motion is too large by what goes on, or, as contact feeds it, too small.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from fenics_crack.basics.tables import Described, hertz_of, quantity, with_frequency

AT_END = "still rising at the end of the range"
"""Description of a largest response that is no peak."""


@dataclass(frozen=True)
class Top:
    """The largest response of a curve at one dof, between its points.

    Its attributes are those of :class:`Peak`.
    """

    index: int
    value: float
    amplitude: float
    at_end: bool


@dataclass(frozen=True, repr=False)
class Peak(Described, Top):
    """The largest response of a curve at one dof.

    Attributes
    ----------
    index : int
        Number of the nearest point of the curve, for ``curve.solution(index)``.
    value, amplitude, at_end
        Of the curve's parameter; half the peak-to-peak displacement [m]; True at an end of the
        curve: no peak, as the response is still rising there.
    omega : float
        Load frequency [rad/s].
    error : float
        Estimated error of the amplitude, relative to it.
    verdict : str
        Stability of the vibration.
    damping : float
        Ratio of critical damping by the half-power bandwidth of the load's own harmonic; nan where
        that does not fall to 1/sqrt(2) on both sides, as where a higher one resonates, or the curve
        is none over the frequency.
    omega_error : float
        Estimated error of the frequency, relative to it; nan where it is not known, or the
        response is still rising.
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

    frequency = hertz_of()

    def to_dict(self) -> dict[str, Any]:
        """The attributes, and the frequency [Hz]."""
        return with_frequency(dict(vars(self)))

    def _title(self) -> str:
        width = f"damping {self.damping:.3g}"
        if self.at_end:
            width = AT_END
        elif math.isnan(self.damping):
            width = "the load's own harmonic has no half-power width"
        error = f"error {self.error:.2g}"
        if not math.isnan(self.omega_error):
            error += f", of the frequency {self.omega_error:.2g}"
        error += f" ({self.without})" if self.without else ""
        place = f"{self.frequency:.6g} Hz ({self.omega:.6g} rad/s)"
        size = quantity(self.amplitude, "m")
        return f"{size} at {place}, {error}, {self.verdict}, {width}"


def top_and_damping(
    value: np.ndarray, amplitude: np.ndarray, peak: int
) -> tuple[float, float, float]:
    """Return place and height of a curve's maximum, between its points in their order (n,), and the
    damping by the half-power bandwidth; nan where one side of it is missing."""
    from scipy.interpolate import CubicSpline  # takes longer to load than a curve to be drawn

    point = float(value[peak]), float(amplitude[peak])
    first, last = (_end_of_side(value, amplitude, peak, step) for step in (-1, 1))
    inside = first < peak < last
    if not inside or (value[peak + 1] - value[peak]) * (value[peak] - value[peak - 1]) <= 0.0:
        return *point, math.nan
    side = slice(first, last + 1)
    at, height = value[side], np.maximum(amplitude[side] / point[1], np.finfo(float).eps)
    forward = 1 if at[-1] > at[0] else -1
    spline = CubicSpline(at[::forward], height[::forward] ** -2.0)
    lowest = spline.derivative().roots(extrapolate=False)
    beside = np.sort(value[[peak - 1, peak + 1]])
    lowest = lowest[(lowest > beside[0]) & (lowest < beside[1])]
    top = float(min(lowest, key=spline, default=point[0]))
    if not spline(top) > 0.0:  # as beside a place where there is no vibration of this kind
        return top, point[1], math.nan
    ends = spline.solve(2.0 * spline(top), extrapolate=False)
    width = ends[ends > top].min(initial=math.inf) - ends[ends < top].max(initial=-math.inf)
    damping = float(width / (2.0 * top)) if math.isfinite(width) else math.nan
    return top, point[1] * float(spline(top) ** -0.5), damping


def damping_by_width(value: np.ndarray, waves: np.ndarray, subharmonic: int, peak: int) -> float:
    """Damping by the half-power bandwidth of the load's own harmonic next to a curve's largest
    response, of coefficients (n, 2H+1); nan where that is missing."""
    cosine, sine = waves[:, 2 * subharmonic - 1], waves[:, 2 * subharmonic]
    return top_and_damping(value, np.hypot(cosine, sine), peak)[2]


def _end_of_side(value: np.ndarray, amplitude: np.ndarray, peak: int, step: int) -> int:
    """The first point beyond half the power on one side of a peak, or the last one before the curve
    ends or turns back."""
    place, way = peak, 0.0
    while amplitude[place] >= amplitude[peak] / math.sqrt(2.0) and 0 <= place + step < len(value):
        there = value[place + step] - value[place]
        if there * way < 0.0 or there == 0.0:
            break
        place, way = place + step, there
    return place
