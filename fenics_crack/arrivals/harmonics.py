"""Vibrations fitted to arrival times: amplitudes with their errors, and other candidates."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from scipy.special import ndtr

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.robust import LEVELS
from fenics_crack.basics.errors import InputError, check_count, check_number
from fenics_crack.basics.tables import Tabular, counted, hertz_of, quantity, with_frequency
from fenics_crack.numerics.fourier import fourier_basis

ORDERS = range(1, 25)
"""Engine orders that are tried where none are given."""


@dataclass(frozen=True, repr=False)
class Candidates(Tabular):
    """Orders that were tried, and the residual of each.

    Attributes
    ----------
    orders : (n,)
        Periods of the load in a revolution.
    residuals : (n,) [m]
        Root mean square residual of the fit.
    conditions : (n,)
        Condition number of the fit's columns, scaled to length 1, at these probes; large: errors
        of the probes are amplified.
    equivalent : (n,) bool
        True if it fits as well as the best one, or could explain the best fit at the angles of the
        probes, within errors.
    hidden : (n,) bool
        True if these probes cannot measure it: to them it looks like a constant, or like one of
        its own harmonics; or so nearly that errors of the arrivals become larger than the turning.
    """

    orders: np.ndarray
    residuals: np.ndarray
    conditions: np.ndarray
    equivalent: np.ndarray
    hidden: np.ndarray

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every order."""
        names = "order", "residual", "condition", "equivalent", "hidden"
        return {n: part.tolist() for n, part in zip(names, vars(self).values(), strict=True)}

    def _units(self) -> Mapping[str, str]:
        return {"residual": "m"}

    def _title(self) -> str:
        counts = f"{int(self.equivalent.sum())} equivalent, {int(self.hidden.sum())} hidden"
        return f"{len(self.orders)} orders, {counts}"


class Fitted(Tabular):
    """Harmonics fitted to arrivals, and doubts about them."""

    misfit: float
    folded: float

    @property
    def does_not_fit(self) -> bool:
        """True if the misfit is below 0.001: harmonics are missing, or the order is wrong."""
        return self.misfit < LEVELS.misfit

    @property
    def may_be_folded(self) -> bool:
        """True if three errors hold an amplitude with no more than the probability of two: too few
        probes for the harmonics that are left out."""
        return bool(self.folded > 2.0 * ndtr(-2.0))

    @property
    def _doubts(self) -> list[str]:
        """The largest of the doubts, in words."""
        if self.does_not_fit:
            return ["DOES NOT FIT"]
        return ["harmonics left out may be folded"] * self.may_be_folded


@dataclass(frozen=True, repr=False)
class TipFit(Fitted):
    """A periodic vibration fitted to arrival times.

        u = a0 + sum_k a_k cos(m_k p alpha) + b_k sin(m_k p alpha)

    over the rotor's angle alpha, with p the periods of the load in a revolution.

    Attributes
    ----------
    order : float
        p, of the candidate that was taken; look at :attr:`ambiguous` and :attr:`hidden`, too.
    order_error : float
        Its standard error; 0 where it was chosen among given ones.
    speed : float [rad/s]
        Mean speed of rotation.
    multiples : (K,)
        m_k: 1, 2, ...; 1/2, 1, ... where the response has twice the load's period.
    coefficients : (2K+1,) [m]
        a0, a1, b1, ....
    covariance : (2K+1, 2K+1) [m^2]
        Covariance of the coefficients.
    scatter : float [m]
        Standard deviation of a displacement about the fit; nan where there are no more arrivals
        than unknowns. Errors from it are those of Student's t, and nan up to two more.
    misfit : float
        Probability of residuals as large between the means of the probes, given the scatter within
        a probe. If it is tiny, harmonics are missing, probes are out of place, or the order is
        wrong. nan with too few probes.
    candidates : Candidates
        The orders that were tried.
    spare : int
        Number of means of probes less unknowns of the fit. With none nothing is tested: neither
        the order, nor that the harmonics kept are enough.
    asynchronous : tuple of TipFit
        Vibrations of frequencies that follow no order, found beside it.
    folded : float
        Probability that harmonics which are left out put an amplitude more than three of its errors
        off without being seen, were each as likely to be as large as the last one kept as 1/100 of
        it. nan where errors are not known, and at frequencies that follow no order.
    """

    order: float
    order_error: float
    speed: float
    multiples: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    scatter: float
    misfit: float
    candidates: Candidates
    spare: int
    asynchronous: tuple[TipFit, ...]
    folded: float = np.nan

    frequency = hertz_of()

    @property
    def omega(self) -> float:
        """Angular frequency of the load [rad/s]."""
        return self.order * self.speed

    @property
    def amplitudes(self) -> np.ndarray:
        """Amplitudes of the harmonics: (K,) [m]."""
        return strengths(self.coefficients, self.covariance)[0]

    @property
    def amplitude_errors(self) -> np.ndarray:
        """Their standard errors: (K,) [m]."""
        return strengths(self.coefficients, self.covariance)[1]

    @property
    def ambiguous(self) -> tuple[float, ...]:
        """Other orders that explain these arrivals as well."""
        others = self.candidates.equivalent & (self.candidates.orders != self.order)
        return tuple(self.candidates.orders[others].tolist())

    @property
    def hidden(self) -> tuple[float, ...]:
        """Orders that these probes cannot measure, present or not."""
        return tuple(self.candidates.orders[self.candidates.hidden].tolist())

    @property
    def in_doubt(self) -> bool:
        """True if it does not fit, harmonics left out may be folded, it has as many unknowns as
        there are probes, which fits anything, or no probe sees the vibration twice."""
        return self.does_not_fit or self.may_be_folded or self.spare < 1 or self.seen_once

    @property
    def seen_once(self) -> bool:
        """True if no probe sees the same twice, as in one revolution: errors of arrivals are then
        known from the residuals alone, and nothing tests that the harmonics are enough."""
        return self.spare > 0 and bool(np.isnan(self.misfit)) and not self.order_error

    def ratio(self, multiple: float = 2.0) -> tuple[float, float]:
        """Return the amplitude at a multiple of the load's frequency relative to that at it, and
        its standard error; a breathing crack has a second harmonic, an open crack none.

        Raises
        ------
        InputError
            The fit has no such harmonic.
        """
        places = []
        for wanted in (1.0, multiple):
            found = np.flatnonzero(np.isclose(self.multiples, wanted))
            if not len(found):
                raise InputError("multiple", wanted, f"one of {self.multiples.tolist()}")
            places.append(int(found[0]))
        (first, other), errors = self.amplitudes[places], self.amplitude_errors[places]
        one, two = (slice(2 * place + 1, 2 * place + 3) for place in places)
        mixed = self.coefficients[one] @ self.covariance[one, two] @ self.coefficients[two]
        value, both = other / first, mixed / (first * other)
        square = errors[1] ** 2 - 2.0 * value * both + (value * errors[0]) ** 2
        return float(value), float(np.sqrt(square) / first)

    def displacement(self, angle: np.ndarray) -> np.ndarray:
        """Return the fitted vibration at rotor angles: (n,) [m]."""
        return fourier_basis(self.order * np.asarray(angle), self.multiples) @ self.coefficients

    def phases(self, arrivals: ArrivalTimes) -> np.ndarray:
        """Return the angles at which :meth:`displacement` has the vibration at arrivals: the
        rotor's; at any frequency the time since the first mark, times the mean speed."""
        if self.order_error:
            return self.speed * (arrivals.time - arrivals.marks[0])
        return arrivals.angle

    # --- shown ------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Return columns, a row for the mean and for every harmonic: its multiple of the load's
        frequency, order, frequency, amplitude and phase in A cos(m p alpha - phase)."""
        multiples = np.concatenate([[0.0], self.multiples])
        cosines, sines = self.coefficients[1::2], self.coefficients[2::2]
        mean = self.coefficients[:1], np.sqrt(self.covariance[:1, 0])
        amplitudes, errors = strengths(self.coefficients, self.covariance)
        values = {
            "multiple": multiples.tolist(),
            "order": (multiples * self.order).tolist(),
            "omega": (multiples * self.omega).tolist(),
            "amplitude": np.concatenate([mean[0], amplitudes]).tolist(),
            "amplitude_error": np.concatenate([mean[1], errors]).tolist(),
            "phase": np.concatenate([[0.0], np.arctan2(sines, cosines)]).tolist(),
        }
        return with_frequency(values)

    def _title(self) -> str:
        parts = [f"order {self.order:.6g}, {self.omega:.6g} rad/s"]
        sizes = zip(self.multiples, self.amplitudes, self.amplitude_errors, strict=True)
        parts += [f"{m:g}x {quantity(a, 'm')} ± {quantity(e, 'm')}" for m, a, e in sizes]
        parts += self._doubts
        if self.spare < 1:
            parts.append("as many unknowns as probes")
        elif self.seen_once:
            parts.append("no probe sees it twice")
        parts += [f"beside {line.omega:.6g} rad/s" for line in self.asynchronous]
        for words, orders in (("as well", self.ambiguous), ("not measured", self.hidden)):
            parts += [f"{words}: {in_words(orders)}"] * bool(orders)
        return ", ".join(parts)


def in_words(orders: Sequence[float]) -> str:
    """Return the first six of some orders in words."""
    return ", ".join([*(f"{one:.6g}" for one in orders[:6]), *["..."] * (len(orders) > 6)])


def strengths(coefficients: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return amplitudes of coefficients (..., 2K+1) and their standard errors: two (..., K).

    Errors e along the phase lengthen an amplitude A by e^2 / (2 A), in the mean and in variance 3/4
    (E e^2 / A)^2 together, or of it where A is smaller than e: probes may measure one part of a
    harmonic and not the other. Of an amplitude 0 the error of its cosine part is the first.
    """
    parts = np.stack([coefficients[..., 1::2], coefficients[..., 2::2]])
    sizes = np.hypot(*parts)
    turned = np.stack([np.ones_like(sizes), np.zeros_like(sizes)])
    cosine, sine = np.divide(parts, sizes, out=turned, where=sizes > 0.0)
    places = np.arange(1, coefficients.shape[-1], 2)
    own, other = covariance[..., places, places], covariance[..., places + 1, places + 1]
    both = covariance[..., places, places + 1]
    along = cosine**2 * own + 2.0 * cosine * sine * both + sine**2 * other
    across = np.maximum(sine**2 * own - 2.0 * cosine * sine * both + cosine**2 * other, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        curved = np.nan_to_num(across / np.maximum(sizes, np.sqrt(across)))
    return sizes, np.sqrt(np.maximum(along, 0.0) + 0.75 * curved**2)


# --- fits -----------------------------------------------------------------------------------------


def wanted(
    orders: Iterable[float], harmonics: int, subharmonic: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return candidates (n,) and multiples (K,), checked."""
    check_count("harmonics", harmonics, 1)
    check_count("subharmonic", subharmonic, 1)
    tried = list(orders)
    if not tried:
        raise InputError("orders", tried, "one or more numbers > 0")
    for one in tried:
        check_number("orders", one, 0.0, above=True)
    return np.unique(np.array(tried, dtype=float)), np.arange(1, harmonics + 1) / subharmonic


def taken(
    sums: np.ndarray, sizes: np.ndarray, limit: float, known: np.ndarray | bool = True
) -> tuple[np.ndarray, int]:
    """Return the candidates (n,) that fit equally well, by their sums of squares.

    The second value is the one to be taken: of those with the smallest vibration, to 20 %, and that
    are known if any is, the one of the least sum.
    """
    equivalent = sums - sums.min() < limit
    kept = equivalent & known if np.any(equivalent & known) else equivalent
    small = kept & (sizes <= 1.2 * sizes[kept].min())
    return equivalent, int(np.argmin(np.where(small, sums, np.inf)))


def condition(columns: np.ndarray) -> float:
    """Return the condition number of columns (n, m), scaled to length 1; inf: dependent."""
    sizes = np.linalg.norm(columns, axis=0)
    if len(columns) < len(sizes) or sizes.min() < 1e-8 * sizes.max():
        return np.inf
    value = float(np.linalg.cond(columns / sizes))
    return value if value < 1e8 else np.inf


def refuse(arrivals: ArrivalTimes, unknowns: int) -> NoReturn:
    """Raise InputError: these probes cannot determine so many unknowns."""
    angles = ", ".join(f"{angle:g}" for angle in np.degrees(arrivals.probes))
    found = f"{counted(len(arrivals.probes), 'probe')} at {angles} degrees"
    allowed = f"able to determine {unknowns} unknowns of a fit: more probes, unequally spaced, "
    allowed += "fewer harmonics, or arrivals that scatter less"
    raise InputError("probes", found, allowed)
