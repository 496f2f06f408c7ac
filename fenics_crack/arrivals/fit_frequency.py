"""Asynchronous vibration from arrival times: its frequency by a scan of least-squares fits.

At a frequency that is no multiple of the speed each revolution sees another point of the period,
so few probes suffice; but a probe alone samples once per revolution, and orders p, p + 1, p + 2,
... and their mirror images 1 - p, 2 - p, ... look the same to it. Probes at other angles see the
aliases with other phases: two suffice (Lacaze, arXiv:1711.06135), though not two opposite each
other, which see every second alias alike. The scan fits a constant and K harmonics at each order of
a fine grid (Lomb and Scargle's periodogram with a floating mean: Zechmeister and Kürster, Astronomy
and Astrophysics 496, 2009, 577). Its sums over the revolutions,

    sum_n u_nj exp(-2 pi i n p),

repeat with p + 1 and are FFTs, one for each probe. Gauss-Newton then fits order and harmonics of
the best minima to the arrivals as they are.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.harmonics import LinearFit, TipFit, compared, fit_harmonics, rounding
from fenics_crack.errors import InputError, check_count, check_number

__all__ = ["fit_frequency"]

FINER = 8
"""Orders tried within the resolution, 1 / revolutions."""
MOST_ORDERS = 10**6
SCANNED = 2**17
"""Orders solved together."""
MINIMA = 40
"""Minima of the scan that are refined."""
APART = 2.0
"""Minima nearer to a lower one, in units of the resolution, are its side lobes."""
CHANCE = 1e-5
"""Probability of a vibration in the noise of one probe, above which there is none."""
UNVARIED = 1e-6
"""Largest variation of the speed."""


def fit_frequency(arrivals: ArrivalTimes, low: float, high: float, *, harmonics: int = 1) -> TipFit:
    """Find a vibration of any frequency, at constant speed, by least squares.

    Of frequencies that fit alike, within errors, the one with the smallest vibration is taken and
    the others are reported, as by :func:`fit_order`. Give no more harmonics than needed: with two,
    half a frequency may explain it by its second harmonic, too.

    Parameters
    ----------
    arrivals : ArrivalTimes
        At constant speed, to 1e-6.
    low, high : float [rad/s]
        Where the frequency of the load is sought.
    harmonics : int
        K.

    Returns
    -------
    TipFit
        Its order is any number, with a standard error.

    Raises
    ------
    InputError
        A value cannot be used, the speed varies, there are too few arrivals, or those of a probe
        alone do not vary: a vibration of a whole order looks like none to it.

    Examples
    --------
    >>> fit = fc.fit_frequency(arrivals, 1800.0, 2200.0)
    """
    check_number("low", low, 0.0, above=True)
    check_number("high", high, low, above=True)
    check_count("harmonics", harmonics, 1)
    speeds = arrivals.speed
    if np.ptp(speeds) > UNVARIED * speeds.mean():
        found = f"{speeds.min():.6g} to {speeds.max():.6g} rad/s"
        raise InputError("speed", found, "constant; fit_order and track_order allow a run-up")
    speed = float(2.0 * np.pi * len(arrivals) / (arrivals.marks[-1] - arrivals.marks[0]))
    seen = np.isfinite(arrivals.time)
    angle, values = arrivals.angle[seen], arrivals.displacement[seen]
    unknowns = 2 * harmonics + 2
    if len(values) <= unknowns:
        raise InputError("arrivals", f"{len(values)} arrivals", f"more than {unknowns}")

    finest = 2 ** int(np.ceil(np.log2(FINER * len(arrivals))))
    begin, end = np.ceil(low / speed * finest), np.floor(high / speed * finest) + 1.0
    if not 0.0 < end - begin <= MOST_ORDERS:
        allowed = f"between {1.0 / finest:.3g} and {MOST_ORDERS / finest:.3g} times the speed"
        raise InputError("high - low", high - low, allowed)
    grid = np.arange(begin, end)
    pieces = np.array_split(grid.astype(int), -(-len(grid) // SCANNED))
    scanned = np.concatenate([_scan(arrivals, one, finest, harmonics) for one in pieces])
    if len(arrivals.probes) == 1:
        _check_varies(arrivals, values, float(scanned.min()), unknowns)
    starts = _minima(scanned)
    multiples = np.arange(1.0, harmonics + 1.0)
    bounds = (low / speed, high / speed)
    radius = arrivals.tip_radius
    refined = [
        _refine(angle, values, grid[one] / finest, multiples, radius, bounds) for one in starts
    ]
    order, sums = np.array(refined).T
    order = _distinct(order, sums, APART / len(arrivals))

    def variance_of(fit: LinearFit, _: float = 0.0) -> float:
        return max(fit.total / (len(values) - unknowns), rounding(arrivals) ** 2)

    tried, best, fit, _ = compared(arrivals, order, multiples, variance_of, hidden_too=True)
    variance = variance_of(fit)
    covariance = variance * np.linalg.pinv(fit.jacobian.T @ fit.jacobian)
    return TipFit(
        order=float(order[best]),
        order_error=float(np.sqrt(covariance[-1, -1])),
        speed=speed,
        multiples=multiples,
        coefficients=fit.coefficients,
        covariance=covariance[:-1, :-1],
        scatter=float(np.sqrt(variance)),
        misfit=np.nan,
        candidates=tried,
    )


def _check_varies(arrivals: ArrivalTimes, values: np.ndarray, least: float, unknowns: int) -> None:
    """Raise InputError where the displacements at one probe (n,) vary no more than their scatter
    does about the best fit of the scan, which leaves ``least``: chi-square of the harmonics, once
    for each independent frequency (Scargle, Astrophysical Journal 263, 1982, 835)."""
    variance = max(least / (len(values) - unknowns), rounding(arrivals) ** 2)
    explained = float(((values - values.mean()) ** 2).sum()) - least
    by_chance = 0.5 * len(values) * float(chdtrc(unknowns - 2, max(explained / variance, 0.0)))
    if by_chance > CHANCE:
        found = f"one at {np.degrees(arrivals.probes[0]):g} degrees, whose arrivals do not vary"
        allowed = "two or more: to one a vibration of a whole order is no vibration"
        raise InputError("probes", found, allowed)


def _scan(arrivals: ArrivalTimes, grid: np.ndarray, finest: int, harmonics: int) -> np.ndarray:
    """Sums of squares that fits at the orders grid / finest leave, up to a constant: (n,) [m^2].

    The angles are the nominal ones here; what the vibration moves them is refined later.
    """
    seen = np.isfinite(arrivals.time)
    shifted = np.where(seen, arrivals.displacement - np.nanmean(arrivals.displacement), 0.0)
    sums = [np.fft.fft(part, finest, axis=0) for part in (seen.astype(float), shifted)]
    start = 2.0 * np.pi * arrivals.first + arrivals.probes

    def at(what: np.ndarray, multiple: int) -> np.ndarray:
        """sum over all arrivals of what exp(-i multiple p alpha): (n,)."""
        phase = np.multiply.outer(multiple * grid / finest, start)
        found: np.ndarray = (what[multiple * grid % finest] * np.exp(-1j * phase)).sum(axis=1)
        return found

    # Of exp(i a p alpha), a = -K ... K: a Hermitian Toeplitz matrix at each order.
    size = 2 * harmonics + 1
    ones, moments = (
        np.stack([at(sums[kind], multiple) for multiple in range(count)])
        for kind, count in enumerate((size, harmonics + 1))
    )
    ones, moments = (np.concatenate([part[:0:-1].conj(), part]) for part in (ones, moments))
    place = np.arange(size)
    matrix = ones[size - 1 + place[:, None] - place].transpose(2, 0, 1)
    matrix = matrix + 1e-10 * seen.sum() * np.eye(size)
    found = np.linalg.solve(matrix, moments.T[..., None])[..., 0]
    return np.asarray(float((shifted**2).sum()) - (moments.conj() * found.T).sum(axis=0).real)


def _minima(sums: np.ndarray) -> np.ndarray:
    """Places of the lowest minima of a scan, its ends included."""
    padded = np.concatenate([[np.inf], sums, [np.inf]])
    places = np.flatnonzero((sums <= padded[:-2]) & (sums <= padded[2:]))
    return places[np.argsort(sums[places])[:MINIMA]]


def _refine(
    angle: np.ndarray,
    values: np.ndarray,
    order: float,
    multiples: np.ndarray,
    radius: float,
    bounds: tuple[float, float],
) -> tuple[float, float]:
    """The order near one at which a fit leaves least, and the sum of squares that it leaves."""
    best, least = order, np.inf
    for _ in range(50):
        fit = fit_harmonics(angle, values, order, multiples, radius)
        if fit.total >= least:
            break
        best, least = order, fit.total
        step = np.linalg.lstsq(fit.jacobian, fit.left, rcond=None)[0][-1]
        order = float(np.clip(order + step, *bounds))
    return best, least


def _distinct(order: np.ndarray, sums: np.ndarray, apart: float) -> np.ndarray:
    """Orders without those that are less than a distance from one with a lower sum; increasing."""
    kept: list[int] = []
    for one in np.argsort(sums):
        if all(abs(order[one] - order[other]) >= apart for other in kept):
            kept.append(int(one))
    return np.sort(order[kept])
