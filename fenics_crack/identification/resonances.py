"""Natural frequencies from measured frequency responses.

Around each peak of all responses together, H_j in the form of displacements over a force, a mode
and what lies beside it are fitted by least squares,

    H_j(w) (a + i b r - r^2) = p_j + q_j (r - 1),        r = w / w_peak,

with a and b the same in all responses: the frequency is w_peak sqrt(a), the damping ratio
b / (2 sqrt(a)) (C. K. Sanathanan and J. Koerner, IEEE Transactions on Automatic Control 8, 1963,
56: weights by the last denominator). A crack that breathes makes its first harmonic over the force
the response of a nonlinear structure. Without clearance or a steady load it does not depend on the
force, and near a resonance it is nearly that of a mode of the frequency at which the crack
resonates; the difference is seen when less of the peak is fitted, and counted as an error.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import find_peaks

from fenics_crack.errors import InputError
from fenics_crack.exchange.universal import FrequencyResponse
from fenics_crack.table import TURN

__all__ = ["resonances"]

HALF = 0.5
"""Of a peak's power: down to it on both sides a peak is one, and its damping is told."""
FITTED_DOWN_TO = 0.1
"""Of a peak's power, down to which it is fitted; and, for the error, down to half of it."""
WEIGHINGS = 10
"""By turns with the weights."""


def resonances(responses: Sequence[FrequencyResponse]) -> np.ndarray:
    """Find the modes that responses show: rows of frequency [Hz], its standard deviation, and the
    ratio of damping, in ascending order.

    Raises
    ------
    InputError
        The responses have different lines, or no peak that falls to half its power on both sides.
    """
    lines = responses[0].frequency
    if any(not np.array_equal(one.frequency, lines) for one in responses):
        raise InputError("responses", "of different frequencies", "all at the same frequencies")
    kept = lines > 0.0
    omega = TURN * lines[kept]
    values = np.stack([one.values[kept] / (1j * omega) ** one.derived for one in responses])
    power, found = omega**2 * np.sum(np.abs(values) ** 2, axis=0), []
    # A peak falls to half of its power on both sides, before that is higher there.
    peaks, seen = find_peaks(power, prominence=0.0)
    for peak in peaks[seen["prominences"] > HALF * power[peaks]].tolist():
        wide, half = (
            _fitted(omega, values, peak, _around(power, peak, share * power[peak]))
            for share in (FITTED_DOWN_TO, HALF)
        )
        if wide is None or half is None:
            continue
        frequency, error, damping = wide
        error = float(np.hypot(error, frequency - half[0]))
        # Noise has peaks, too, but no mode there that is known to a tenth of its width.
        width, off = damping * frequency, abs(frequency - omega[peak] / TURN)
        if error < FITTED_DOWN_TO * width and off < width:
            found.append((frequency, error, damping))
    if not found:
        allowed = "with peaks that fall to half their power on both sides, of 4 lines or more"
        raise InputError("responses", f"{len(lines)} lines", allowed)
    return np.array(found)


def _around(power: np.ndarray, peak: int, least: float) -> slice:
    """The lines around a peak that have so much power, and no more than it."""
    ends = np.flatnonzero((power < least) | (power > power[peak]))
    before, after = ends[ends < peak], ends[ends > peak]
    return slice(before[-1] + 1 if len(before) else 0, after[0] if len(after) else len(power))


def _fitted(
    omega: np.ndarray, values: np.ndarray, peak: int, lines: slice
) -> tuple[float, float, float] | None:
    """Frequency [Hz], its standard deviation and the damping of a mode; None of too few lines."""
    r, seen = omega[lines] / omega[peak], values[:, lines]
    count, size = seen.shape
    if 2 * seen.size <= 2 + 4 * count:
        return None
    own = np.kron(np.eye(count), np.column_stack([np.ones(size), r - 1.0]))
    flat, every = seen.ravel(), np.tile(r, count)
    weights = np.ones(len(flat))
    for _ in range(WEIGHINGS):
        columns = np.column_stack([flat, 1j * every * flat, -own, -1j * own]) * weights[:, None]
        right = flat * every**2 * weights
        stacked, wanted = (np.concatenate([part.real, part.imag]) for part in (columns, right))
        found = np.linalg.lstsq(stacked, wanted, rcond=None)[0]
        weights = 1.0 / np.abs(found[0] + 1j * found[1] * every - every**2)
    if found[0] <= 0.0 or found[1] <= 0.0:
        return None
    left = wanted - stacked @ found
    variance = left @ left / (len(wanted) - len(found)) * np.linalg.inv(stacked.T @ stacked)[0, 0]
    frequency = omega[peak] / TURN * np.sqrt(found[0])
    error = 0.5 * frequency / found[0] * np.sqrt(variance)
    return float(frequency), float(error), float(0.5 * found[1] / np.sqrt(found[0]))
