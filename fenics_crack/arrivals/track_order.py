"""A run-up in arrival times: the harmonics of a known engine order, revolution by revolution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.harmonics import columns_of, strengths
from fenics_crack.arrivals.least_squares import nominal_condition, refuse, wanted
from fenics_crack.errors import InputError, check_count
from fenics_crack.table import UNITS, Tabular, counted, with_frequency

__all__ = ["TipTrack", "track_order"]


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
        np.where(seen[..., None], columns_of(np.nan_to_num(part), order, multiples), 0.0)
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
