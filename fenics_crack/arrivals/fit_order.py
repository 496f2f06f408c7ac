"""Synchronous vibration from arrival times: its engine order and harmonics by least squares, and
its harmonics along a run-up.

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

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import fdtrc

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.harmonics import (
    LinearFit,
    TipFit,
    compared,
    nominal_condition,
    refuse,
    rounding,
    strengths,
    wanted,
)
from fenics_crack.errors import InputError, check_count
from fenics_crack.numerics.fourier import waves
from fenics_crack.table import UNITS, Tabular, counted, with_frequency

__all__ = ["TipTrack", "fit_order", "track_order"]

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
    turn, probe = np.nonzero(seen)
    same = probe + len(arrivals.probes) * ((arrivals.first + turn) % subharmonic)

    def variance_of(fit: LinearFit, order: float) -> tuple[float, float]:
        """Variance and misfit; with a whole order probes see the same points in every turn."""
        found, chance = _variance(fit, same if order % 1.0 == 0.0 else None)
        return max(found, rounding(arrivals) ** 2), chance

    found = compared(arrivals, tried, multiples, lambda *least: variance_of(*least)[0])
    candidates, best, fit, least = found
    variance, misfit = variance_of(*least)
    columns = fit.jacobian[:, :-1]
    known = variance if np.isfinite(variance) else np.nan
    return TipFit(
        order=float(tried[best]),
        order_error=0.0,
        speed=_mean_speed(arrivals, seen),
        multiples=multiples,
        coefficients=fit.coefficients,
        covariance=known * np.linalg.inv(columns.T @ columns),
        scatter=float(np.sqrt(known)),
        misfit=misfit,
        candidates=candidates,
    )


def _mean_speed(arrivals: ArrivalTimes, seen: np.ndarray) -> float:
    """Speed over the revolutions from which there are arrivals [rad/s]."""
    turns = np.flatnonzero(seen.any(axis=1))
    begin, end = turns[0], turns[-1] + 1
    return float(2.0 * np.pi * (end - begin) / (arrivals.marks[end] - arrivals.marks[begin]))


def _variance(fit: LinearFit, group: np.ndarray | None) -> tuple[float, float]:
    """Variance of a displacement [m^2], inf where no arrival is to spare, and the probability of
    the misfit between groups of arrivals that see the same point of the period, if there are."""
    left, unknowns = fit.left, len(fit.coefficients)
    plain = fit.total / (len(left) - unknowns) if len(left) > unknowns else np.inf
    if group is None:
        return plain, np.nan
    _, where, sizes = np.unique(group, return_inverse=True, return_counts=True)
    between, within = len(sizes) - unknowns, len(left) - len(sizes)
    if between < 1 or within < 1:
        return plain, np.nan
    means = np.bincount(where, left) / sizes
    pure, lack = float(np.sum((left - means[where]) ** 2)), float(sizes @ means**2) / between
    chance = float(fdtrc(between, within, lack / pure * within)) if pure > 0.0 else 0.0
    return (lack if chance < SIGNIFICANT else plain), chance


# --- run-ups --------------------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class TipTrack(Tabular):
    """Harmonics of a vibration of known engine order, revolution by revolution.

    Attributes
    ----------
    order : float
        Periods of the load in a revolution.
    speed : (n,) [rad/s]
        Mean speed of each group of revolutions.
    multiples : (K,)
        Harmonics, as of :class:`TipFit`.
    coefficients : (n, 2K+1) [m]
        a0, a1, b1, ....
    amplitudes, amplitude_errors : (n, K) [m]
        And standard errors; nan where too many arrivals are missing, and errors of fits without
        an arrival to spare.
    """

    order: float
    speed: np.ndarray
    multiples: np.ndarray
    coefficients: np.ndarray
    amplitudes: np.ndarray
    amplitude_errors: np.ndarray

    @property
    def omega(self) -> np.ndarray:
        """Angular frequency of the load: (n,) [rad/s]."""
        return np.asarray(self.order * self.speed)

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every group of revolutions."""
        values = {"speed": self.speed.tolist(), "omega": self.omega.tolist()}
        found = with_frequency(values)
        for place, multiple in enumerate(self.multiples):
            found[f"amplitude_{multiple:g}"] = self.amplitudes[:, place].tolist()
            found[f"amplitude_error_{multiple:g}"] = self.amplitude_errors[:, place].tolist()
        return found

    def _units(self) -> Mapping[str, str]:
        return UNITS | {n: "m" for n in self.to_dict() if n.startswith("amplitude")}

    def _title(self) -> str:
        speeds = f"{self.speed[0]:.6g} to {self.speed[-1]:.6g} rad/s"
        return f"order {self.order:g}, {speeds}, {counted(len(self.speed), 'point')}"


def track_order(
    arrivals: ArrivalTimes,
    order: float,
    *,
    harmonics: int = 1,
    subharmonic: int = 1,
    revolutions: int = 1,
) -> TipTrack:
    """Fit the harmonics of a known engine order to each few revolutions of a run-up.

    The fit of :func:`fit_order` with one candidate, to ``revolutions`` revolutions at a time.
    A vibration of twice the load's period and an odd order needs two or more.

    Parameters
    ----------
    arrivals, harmonics, subharmonic
        As of :func:`fit_order`.
    order : float
        Periods of the load in a revolution.
    revolutions : int
        Fitted together.

    Returns
    -------
    TipTrack
        Amplitudes and phases with their standard errors, and the speed of each fit.

    Raises
    ------
    InputError
        A value cannot be used, or these probes cannot measure this order in so few revolutions.

    Examples
    --------
    >>> track = fc.track_order(arrivals, 6)
    """
    _, multiples = wanted([order], harmonics, subharmonic)
    check_count("revolutions", revolutions, 1)
    groups, unknowns = len(arrivals) // revolutions, 2 * len(multiples) + 1
    if not groups:
        raise InputError("revolutions", revolutions, f"at most {len(arrivals)}, what there is")
    if np.isinf(nominal_condition(arrivals.nominal_angle[:revolutions].ravel(), order, multiples)):
        refuse(arrivals, unknowns)
    shape = (groups, revolutions * len(arrivals.probes))
    angle, nominal, values = (
        part[: groups * revolutions].reshape(shape)
        for part in (arrivals.angle, arrivals.nominal_angle, arrivals.displacement)
    )
    seen = np.isfinite(values)
    count, values = seen.sum(axis=1), np.where(seen, values, 0.0)
    columns, planned = (
        np.where(seen[..., None], waves(order * np.nan_to_num(part), multiples), 0.0)
        for part in (angle, nominal)
    )
    enough = np.linalg.matrix_rank(planned, tol=1e-6) == unknowns
    inverse = np.linalg.pinv(columns)
    found = np.where(enough[:, None], (inverse @ values[..., None])[..., 0], np.nan)
    left = values - (columns @ found[..., None])[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = np.where(count > unknowns, (left**2).sum(axis=1) / (count - unknowns), np.nan)
    covariance = variance[:, None, None] * (inverse @ inverse.transpose(0, 2, 1))
    times = arrivals.marks[: groups * revolutions + 1 : revolutions]
    speed = 2.0 * np.pi * revolutions / np.diff(times)
    return TipTrack(order, speed, multiples, found, *strengths(found, covariance))
