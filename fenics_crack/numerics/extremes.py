"""Extremes of periodic functions, from samples at equal parts of the period to rounding.

Next to each sample that may be the largest one a maximum is enclosed by three places, the largest
value between the others. At the vertex of the parabola through them the function is evaluated anew:
where it is smooth they are a hundredth as far apart behind each step, at a kink less than half, and
nothing is differentiated.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Motion = Callable[[np.ndarray], np.ndarray]
"""Columns (n, m) of functions at parts (n,) of the period, 0 to 1 and beyond."""
InPeriod = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Likewise columns of a motion [m], and gaps [m] and contact forces [N] of all rows."""
BESIDE = np.array([-0.23, -0.05, -4e-3, -1e-4, 1e-4, 4e-3, 0.05, 0.23])
"""Places next to a vertex over the distance of the outer ones; none falls upon the middle one."""
NARROW, STEPS = 1e-14, 60
"""Part of the period that is not divided any more, and steps after which noise ends the search."""
NOISE = 16.0
"""Times as steep as before: a function that falls so next to its maximum is noise there."""
SHARP = 1e-12
"""Relative error of an extreme, of the range of the function and a tenth of its size."""


def largest(values: np.ndarray, at: Motion | None = None) -> np.ndarray:
    """Largest values (m,) of functions by their samples at equal parts of the period (n, m), and
    by the functions themselves where they are given."""
    found: np.ndarray = np.max(values, axis=0)
    if at is None:
        return found
    before, after = np.roll(values, 1, 0), np.roll(values, -1, 0)
    # Of two equal samples the first; of more there is no peak. Next to one the function rises by
    # less than it falls to its neighbours.
    tops = (values > before) & (values >= after) & (values > np.roll(values, -2, 0))
    rows, columns = np.nonzero(tops & (2.0 * values - np.minimum(before, after) >= found))
    near = rows[:, None] + np.arange(-1, 2)
    x, y = near / len(values), values[near % len(values), columns[:, None]]
    size = SHARP * (np.ptp(values, axis=0) + 0.1 * np.abs(found))
    limit = np.full(len(x), np.inf)
    for _ in range(STEPS):
        side, fall = np.abs(x[:, 1:2] - x[:, ::2]) + NARROW, y[:, 1:2] - y[:, ::2]
        bent = fall * side[:, ::-1]
        rate = (fall / side).max(axis=1)
        left = ((bent / side).max(axis=1) > size[columns]) & (rate <= limit)
        left &= side.max(axis=1) > 2.0 * NARROW
        if not left.any():
            break
        limit = np.minimum(limit, NOISE * rate)
        x, y, side, bent, columns, limit = (one[left] for one in (x, y, side, bent, columns, limit))
        lean = (bent * side[:, ::-1]) @ (0.5, -0.5)
        vertex = x[:, 1] + lean / bent.sum(axis=1)
        places = vertex[:, None] + (x[:, 2:] - x[:, :1]) * BESIDE
        places = np.minimum(np.maximum(places, x[:, :1]), x[:, 2:])
        every = np.arange(len(x))[:, None]
        seen = at(places.ravel()).reshape(*places.shape, -1)[every[:, 0], :, columns]
        x, y = np.hstack([x, places]), np.hstack([y, seen])
        order = x.argsort(axis=1)
        top = y[every, order].argmax(axis=1).clip(1, x.shape[1] - 2)
        three = order[every, top[:, None] + np.arange(-1, 2)]
        x, y = x[every, three], y[every, three]
        np.maximum.at(found, columns, y[:, 1])
    return found


def half_range(values: np.ndarray, at: Motion | None = None) -> np.ndarray:
    """Half the peak-to-peak values (m,) of functions, given as for :func:`largest`."""
    both = np.hstack([values, -values])
    tops = largest(both, at and (lambda parts: np.hstack([seen := at(parts), -seen])))
    return np.asarray(tops.reshape(2, -1).sum(axis=0)) / 2.0
