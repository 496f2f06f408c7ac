"""Extremes of periodic functions, from samples at equal parts of the period to rounding.

Next to each sample that may be the largest one the function is evaluated at places around it, and
where the polynomial through these has its maximum. Where it is not that polynomial, as next to a
kink, it is evaluated around the largest of them again, ever nearer: nothing is differentiated, and
the error of a smooth maximum is the square of the last distance.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

PeriodicFunctions = Callable[[np.ndarray], np.ndarray]
"""Columns (n, m) of functions at parts (n,) of the period, 0 to 1 and beyond."""
RecordFunction = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Likewise columns of a motion [m], and gaps [m] and contact forces [N] of all rows."""
OFFSETS, N_REFINEMENTS = np.linspace(-1.0, 1.0, 9), 10
"""Places around the largest, a quarter as far apart at each step: 4e-9 of the period from 256
samples on, whose square is rounding with 100 harmonics."""
POWERS = np.arange(len(OFFSETS))
POLYNOMIAL_FROM_VALUES = np.linalg.inv(OFFSETS[:, None] ** POWERS)
"""Coefficients of the polynomial through values there."""
MAX_POLYNOMIAL_ERROR = 1e-6
"""Maximum distance of a function from its polynomial, over the range of its values next to a
maximum, of which that is then as small a part."""


def find_maxima(values: np.ndarray, at: PeriodicFunctions | None = None) -> np.ndarray:
    """Largest values (m,) of functions by their samples at equal parts of the period (n, m), and
    by the functions themselves where they are given."""
    tops: np.ndarray = np.max(values, axis=0)
    before, after = np.roll(values, 1, 0), np.roll(values, -1, 0)
    # Next to a peak the function rises by less than it falls to its neighbours.
    high = 2.0 * values - np.minimum(before, after) >= tops
    rows, columns = np.nonzero((values > before) & (values >= after) & high)
    places, distance = rows / len(values), 1.0 / len(values)
    for step in range(N_REFINEMENTS):
        if at is None or not len(places):
            break
        each, near = np.arange(len(places)), places[:, None] + distance * OFFSETS
        seen = at(near.ravel()).reshape(*near.shape, -1)[each, :, columns]
        best = seen.argmax(axis=1)
        np.maximum.at(tops, columns, seen[each, best])
        if step == 0:
            there, expected = _maximise_polynomial(seen, OFFSETS[best])
            top = at(places + distance * there)[each, columns]
            np.maximum.at(tops, columns, top)
            smooth = np.abs(top - expected) <= MAX_POLYNOMIAL_ERROR * np.ptp(seen, axis=1)
            flat = (seen == seen[each, best][:, None]).sum(axis=1) > 2  # closed without penetration
            each = np.flatnonzero(~(smooth | flat))
        places, columns = near[each, best[each]], columns[each]
        distance *= OFFSETS[1] - OFFSETS[0]
    return tops


def _maximise_polynomial(values: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (n,) from -1 to 1, and values, of the maxima of polynomials through values (n, 9), by
    Newton's method from places nearby."""
    known, place = values @ POLYNOMIAL_FROM_VALUES.T, start
    slopes = known[:, 1:] * POWERS[1:]
    bends = slopes[:, 1:] * POWERS[1:-1]
    for _ in range(3):
        powers = place[:, None] ** POWERS
        slope, bend = (slopes * powers[:, :-1]).sum(1), (bends * powers[:, :-2]).sum(1)
        place = place - slope / np.where(bend < 0.0, bend, -np.inf)
        place = np.minimum(np.maximum(place, -1.0), 1.0)
    return place, (known * place[:, None] ** POWERS).sum(1)
