"""Synchronous vibration from arrival times: its engine order and harmonics by least squares.

The circumferential Fourier fit. At engine order p each probe at phi sees, in every revolution, the
same point of

    u = a0 + sum_k a_k cos(k p alpha) + b_k sin(k p alpha)

so the probes around the casing are what samples a period: K harmonics need 2K + 1 probes, and two
orders that agree at all probes cannot be told apart. Heath and Imregun (Journal of Engineering for
Gas Turbines and Power 120, 1998, 784) survey such methods; Diamond and Heyns (Journal of Vibration
and Acoustics 140, 2018, 061003) choose the spacing of the probes. As in the improved fit of Applied
Sciences 10, 2020, 3675, alpha is the rotor's angle at the arrival itself, which depends on the
vibration, and not where the tip was expected.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.special import fdtrc

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.harmonics import Candidates, TipFit
from fenics_crack.arrivals.least_squares import (
    ALIKE,
    LinearFit,
    fit_harmonics,
    nominal_condition,
    refuse,
    rounding,
    smallest,
    unexplained,
    wanted,
)

__all__ = ["fit_order"]

SIGNIFICANT = 0.01
"""Below this probability what is left between the probes' means is no chance."""


def fit_order(
    arrivals: ArrivalTimes,
    orders: Iterable[float] = range(1, 25),
    *,
    harmonics: int = 1,
    subharmonic: int = 1,
) -> TipFit:
    """Find the engine order of a vibration, and its harmonics, by linear least squares.

    Each candidate is fitted. All whose sum of squares is less than 9 variances above the least one
    are alike: the one with the smallest vibration is taken (within 20 %, the one that leaves
    least), and the others are reported. So are those whose columns are dependent at these probes,
    as hidden (:class:`Candidates`). The variance is that of the residuals; where the means of the
    probes are off by more than their scatter explains (F test), it is that of the means, so that
    harmonics left out do not pass for information.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Measured or simulated; of steady vibration. :func:`track_order` is for run-ups.
    orders : iterable of float
        Candidates: periods of the load in a revolution. Those that a Campbell diagram allows are
        told apart most easily.
    harmonics : int
        K; 2 or more show a breathing crack by :meth:`TipFit.ratio`.
    subharmonic : int
        2: the response has twice the load's period, and harmonics 1/2, 1, ..., K/2 of the load.

    Returns
    -------
    TipFit
        The order, its harmonics with their standard errors, and other orders that fit alike.

    Raises
    ------
    InputError
        A value cannot be used, or these probes can measure none of the candidates.

    Examples
    --------
    >>> fit = fc.fit_order(arrivals, range(1, 13))
    """
    tried, multiples = wanted(orders, harmonics, subharmonic)
    seen = np.isfinite(arrivals.time)
    angle, values = arrivals.angle[seen], arrivals.displacement[seen]
    nominal = arrivals.nominal_angle[seen]
    conditions = np.array([nominal_condition(nominal, one, multiples) for one in tried])
    radius = arrivals.tip_radius
    # Dependent columns stay so at the nominal angles; elsewhere they would fit noise.
    fits = [
        fit_harmonics(nominal if dependent else angle, values, one, multiples, radius)
        for one, dependent in zip(tried, np.isinf(conditions), strict=True)
    ]
    hidden = np.isinf(conditions) | ~np.array([fit.is_usable for fit in fits])
    if np.all(hidden):
        refuse(arrivals, 2 * len(multiples) + 1)
    sums = np.array([fit.total for fit in fits])
    least = int(np.argmin(np.where(hidden, np.inf, sums)))
    group = np.full(len(values), -1)
    if tried[least] % 1.0 == 0.0:
        turn, probe = np.nonzero(seen)
        group = probe + len(arrivals.probes) * ((arrivals.first + turn) % subharmonic)
    variance, misfit = _variance(fits[least], group)
    variance = max(variance, rounding(arrivals) ** 2)
    alike = sums - sums[least] < ALIKE * variance
    best = smallest(fits, alike & ~hidden)
    alike |= unexplained(nominal, fits[best].coefficients, float(tried[best]), tried, multiples) < (
        ALIKE * variance
    )
    columns = fits[best].jacobian[:, :-1]
    known = variance if np.isfinite(variance) else np.nan
    return TipFit(
        order=float(tried[best]),
        order_error=0.0,
        speed=_mean_speed(arrivals, seen),
        multiples=multiples,
        coefficients=fits[best].coefficients,
        covariance=known * np.linalg.inv(columns.T @ columns),
        scatter=float(np.sqrt(known)),
        misfit=misfit,
        candidates=Candidates(tried, np.sqrt(sums / len(values)), conditions, alike, hidden),
    )


def _mean_speed(arrivals: ArrivalTimes, seen: np.ndarray) -> float:
    """Speed over the revolutions from which there are arrivals [rad/s]."""
    turns = np.flatnonzero(seen.any(axis=1))
    begin, end = turns[0], turns[-1] + 1
    return float(2.0 * np.pi * (end - begin) / (arrivals.marks[end] - arrivals.marks[begin]))


def _variance(fit: LinearFit, group: np.ndarray) -> tuple[float, float]:
    """Variance of a displacement [m^2], inf where no arrival is to spare, and the probability of
    the misfit between groups of arrivals that see the same point of the period; group -1: no such
    groups."""
    left, unknowns = fit.left, len(fit.coefficients)
    plain = fit.total / (len(left) - unknowns) if len(left) > unknowns else np.inf
    _, where, sizes = np.unique(group, return_inverse=True, return_counts=True)
    between, within = len(sizes) - unknowns, len(left) - len(sizes)
    if group[0] < 0 or between < 1 or within < 1:
        return plain, np.nan
    means = np.bincount(where, left) / sizes
    pure, lack = float(np.sum((left - means[where]) ** 2)), float(sizes @ means**2) / between
    chance = float(fdtrc(between, within, lack / pure * within)) if pure > 0.0 else 0.0
    return (lack if chance < SIGNIFICANT else plain), chance
