"""Least squares of harmonics at a given order, and what tells two orders apart."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.harmonics import Candidates
from fenics_crack.errors import InputError, check_count, check_number
from fenics_crack.numerics.fourier import waves
from fenics_crack.table import counted

__all__ = [
    "LinearFit",
    "compared",
    "fit_harmonics",
    "nominal_condition",
    "refuse",
    "rounding",
    "wanted",
]

ALIKE = 9.0
"""Two candidates fit alike if their sums of squares differ by less, in units of the variance:
three standard deviations."""


def wanted(
    orders: Iterable[float], harmonics: int, subharmonic: int
) -> tuple[np.ndarray, np.ndarray]:
    """Candidates (n,) and multiples (K,), checked."""
    check_count("harmonics", harmonics, 1)
    check_count("subharmonic", subharmonic, 1)
    tried = list(orders)
    if not tried:
        raise InputError("orders", tried, "one or more numbers > 0")
    for one in tried:
        check_number("orders", one, 0.0, above=True)
    return np.unique(np.array(tried, dtype=float)), np.arange(1, harmonics + 1) / subharmonic


@dataclass(frozen=True)
class LinearFit:
    """Harmonics fitted at a given order.

    Attributes
    ----------
    coefficients : (2K+1,) [m]
        a0, a1, b1, ....
    left : (n,) [m]
        What is left, divided by 1 + u' / R: R W times the errors of the arrivals.
    jacobian : (n, 2K+2)
        Of the fit by its coefficients and, last, by the order, divided likewise.
    forwards : bool
        Whether the tip moves forwards at all arrivals, 1 + u' / R > 0. Where it does not, errors of
        the arrivals have been amplified beyond sense.
    """

    coefficients: np.ndarray
    left: np.ndarray
    jacobian: np.ndarray
    forwards: bool

    @property
    def total(self) -> float:
        """Sum of squares [m^2]."""
        return float(self.left @ self.left)

    @property
    def is_usable(self) -> bool:
        """Whether the tip moves forwards at all arrivals, and these tell all coefficients."""
        columns = self.jacobian[:, :-1]
        return self.forwards and bool(np.linalg.matrix_rank(columns) == columns.shape[1])


def fit_harmonics(
    angle: np.ndarray, values: np.ndarray, order: float, multiples: np.ndarray, radius: float
) -> LinearFit:
    """Fit harmonics of an order to displacements (n,) at rotor angles (n,), by least squares.

    An arrival that is late by e is an error of -R W e in u and of W e in alpha; together they leave
    -R W e (1 + u' / R). Least squares of e itself is what makes orders comparable: aliases of the
    same displacements have other slopes u'. Its weights, from the fit before, settle at once.
    """
    columns, slope = waves(order * angle, multiples), np.ones_like(values)
    for _ in range(3):
        weights = 1.0 / np.maximum(slope, 0.1)
        weighted = weights[:, None] * columns
        found = np.linalg.lstsq(weighted, weights * values, rcond=1e-10)[0]
        sines, cosines = columns[:, 2::2], columns[:, 1::2]
        turns = (multiples * (cosines * found[2::2] - sines * found[1::2])).sum(axis=1)
        slope = 1.0 + order * turns / radius
        jacobian = np.column_stack([weighted, weights * angle * turns])
        left = weights * (values - columns @ found)
        result = LinearFit(found, left, jacobian, bool(np.all(slope > 0.0)))
    return result


def nominal_condition(angle: np.ndarray, order: float, multiples: np.ndarray) -> float:
    """Condition number of the columns at nominal angles (n,), scaled to length 1; inf where they
    are dependent."""
    columns = waves(order * angle, multiples)
    sizes = np.linalg.norm(columns, axis=0)
    if len(columns) < len(sizes) or sizes.min() < 1e-8 * sizes.max():
        return np.inf
    values = np.linalg.svd(columns / sizes, compute_uv=False)
    return np.inf if values[-1] < 1e-8 else float(values[0] / values[-1])


def refuse(arrivals: ArrivalTimes, unknowns: int) -> NoReturn:
    """Raise InputError: these probes cannot tell so many unknowns."""
    angles = ", ".join(f"{angle:g}" for angle in np.degrees(arrivals.probes))
    found = f"{counted(len(arrivals.probes), 'probe')} at {angles} degrees"
    allowed = f"able to tell the {unknowns} unknowns of a fit: more probes, unequally spaced, or "
    allowed += "fewer harmonics"
    raise InputError("probes", found, allowed)


def rounding(arrivals: ArrivalTimes) -> float:
    """Displacement below which nothing is told [m]: rounding of the angles, 1e-9 of the motion."""
    largest = float(np.nanmax(np.abs(arrivals.angle)))
    motion = float(np.nanmax(np.abs(arrivals.displacement)))
    return 1e-9 * motion + 4.0 * float(np.spacing(largest)) * arrivals.tip_radius


def compared(
    arrivals: ArrivalTimes,
    orders: np.ndarray,
    multiples: np.ndarray,
    variance_of: Callable[[LinearFit, float], float],
    *,
    hidden_too: bool = False,
) -> tuple[Candidates, int, LinearFit, tuple[LinearFit, float]]:
    """Orders that may explain arrivals, the number of the one that is taken and its fit; and the
    fit that leaves least, with its order.

    Of those that fit alike it is the one with the smallest vibration (within 20 %, the one that
    leaves least).

    Parameters
    ----------
    arrivals : ArrivalTimes
        Of steady vibration.
    orders : (n,)
        Candidates.
    multiples : (K,)
        Harmonics.
    variance_of : callable
        The variance of a displacement [m^2] by the fit that leaves least, and its order.
    hidden_too : bool
        Whether one that these probes cannot measure is taken where no other fits alike.

    Raises
    ------
    InputError
        The columns of all candidates are dependent at these probes.
    """
    seen, radius = np.isfinite(arrivals.time), arrivals.tip_radius
    angle, values = arrivals.angle[seen], arrivals.displacement[seen]
    nominal = arrivals.nominal_angle[seen]
    conditions = np.array([nominal_condition(nominal, one, multiples) for one in orders])
    # Dependent columns stay so at the nominal angles; elsewhere they would fit noise.
    dependent = np.isinf(conditions)
    at_nominal = dependent & (not hidden_too)
    fits = [
        fit_harmonics(nominal if planned else angle, values, one, multiples, radius)
        for one, planned in zip(orders, at_nominal, strict=True)
    ]
    hidden = dependent | ~np.array([fit.is_usable for fit in fits])
    left_out = hidden & (not hidden_too)
    if np.all(left_out):
        refuse(arrivals, 2 * len(multiples) + 1)
    sums = np.array([fit.total for fit in fits])
    least = int(np.argmin(np.where(left_out, np.inf, sums)))
    lowest = fits[least], float(orders[least])
    limit = ALIKE * variance_of(*lowest)
    alike = sums - sums[least] < limit
    sizes = np.array([float(np.linalg.norm(fit.coefficients[1:])) for fit in fits])
    known = alike & ~hidden if np.any(alike & ~hidden) else alike
    small = known & (sizes <= 1.2 * sizes[known].min())
    best = int(np.argmin(np.where(small, sums, np.inf)))
    wave = waves(float(orders[best]) * nominal, multiples) @ fits[best].coefficients
    alike |= _unexplained(nominal, wave, orders, multiples) < limit
    tried = Candidates(orders, np.sqrt(sums / len(values)), conditions, alike, hidden)
    return tried, best, fits[best], lowest


def _unexplained(
    nominal: np.ndarray, wave: np.ndarray, orders: np.ndarray, multiples: np.ndarray
) -> np.ndarray:
    """The sum of squares of a wave at the nominal angles of the arrivals that orders do not
    explain: (n,) [m^2]. What tells aliases apart besides, that arrivals are not at these angles,
    is too little to rely on."""
    found = []
    for order in orders:
        columns = waves(order * nominal, multiples)
        left = wave - columns @ np.linalg.lstsq(columns, wave, rcond=1e-10)[0]
        found.append(float(left @ left))
    return np.array(found)
