"""Extremes of periodic functions, from samples at equal parts of the period to rounding.

Next to each sample that may be the largest one the function is evaluated at places around it, and
again around the largest of these, ever nearer: nothing is differentiated, and a kink is found as
well as a smooth maximum, whose error is the square of the last distance.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Motion = Callable[[np.ndarray], np.ndarray]
"""Columns (n, m) of functions at parts (n,) of the period, 0 to 1 and beyond."""
InPeriod = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Likewise columns of a motion [m], and gaps [m] and contact forces [N] of all rows."""
AROUND, STEPS = np.linspace(-1.0, 1.0, 9), 10
"""Places around the largest, a quarter as far apart at each step: 4e-9 of the period from 256
samples on, whose square is rounding with 100 harmonics."""


def largest(values: np.ndarray, at: Motion | None = None) -> np.ndarray:
    """Largest values (m,) of functions by their samples at equal parts of the period (n, m), and
    by the functions themselves where they are given."""
    tops: np.ndarray = np.max(values, axis=0)
    before, after = np.roll(values, 1, 0), np.roll(values, -1, 0)
    # Next to a peak the function rises by less than it falls to its neighbours.
    peaks = (
        (values > before) & (values >= after) & (2.0 * values - np.minimum(before, after) >= tops)
    )
    rows, columns = np.nonzero(peaks)
    places, distance, each = rows / len(values), 1.0 / len(values), np.arange(len(rows))
    for _ in range(STEPS):
        if at is None or not len(rows):
            break
        near = places[:, None] + distance * AROUND
        seen = at(near.ravel()).reshape(*near.shape, -1)[each, :, columns]
        best = seen.argmax(axis=1)
        np.maximum.at(tops, columns, seen[each, best])
        places, distance = near[each, best], distance * (AROUND[1] - AROUND[0])
    return tops
