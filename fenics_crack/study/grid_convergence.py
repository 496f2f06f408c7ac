"""The error of a number that is computed with two or three step sizes (Roache's index).

Of values f_i with sizes h_1 < h_2 < h_3 it is assumed that f_i = f + C h_i^p. Then

    (f_3 - f_2) / (f_2 - f_1) = (h_3^p - h_2^p) / (h_2^p - h_1^p)

gives the observed order p, and f = f_1 + (f_1 - f_2) / ((h_2/h_1)^p - 1) the extrapolated value.
The uncertainty of f_i is F |f_i - f|; with i = 1, relative to f_1, it is the grid-convergence index

    GCI = F |(f_1 - f_2) / f_1| / ((h_2/h_1)^p - 1).

The factor of safety F is 1.25 where three sizes show an order near that of theory, or one between
that and the best that the elements have, else 3. An order better than that of theory is not used:
the part of an error that falls slowly comes last, and of errors that are sums of powers from that
of theory on, with coefficients of one sign, no more can be left. Values that oscillate, come no
closer, or come closer faster than the elements can are not in the asymptotic range; nothing is
extrapolated from them, and their uncertainty is 3 times their spread.

Roache, Journal of Fluids Engineering 116, 1994, 405; Celik and others, the same 130, 2008, 078001;
ASME V&V 20-2009, section 2; the rule for orders follows Oberkampf and Roy, Verification and
Validation in Scientific Computing, 2010, chapter 8.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fenics_crack.errors import InputError, check_number
from fenics_crack.model.matrices import numbers
from fenics_crack.table import Described

__all__ = ["SAFE", "GridConvergence", "grid_convergence"]

SAFE, CAUTIOUS = 1.25, 3.0
"""Factors of safety."""
LEAST_ORDER, MOST_OVER_FORMAL = 0.5, 1.5
"""Observed orders that are believed: the least; and the largest relative to that of theory, where
no highest one is known."""
HIGHEST_ORDER = 50.0
"""Largest order that is told."""
UNCHANGED = 1e-9
"""Relative spread of values that are the same but for rounding."""


@dataclass(frozen=True, repr=False)
class GridConvergence(Described):
    """Values over a step size, and the error that they show.

    Attributes
    ----------
    sizes, values : tuple of float
        h_i, smallest first, and f_i.
    behaviour : str
        "asymptotic": the observed order is near that of theory, or between that and the highest;
        "outside": it falls, with another order; "oscillating", "diverging" or "irregular" (too fast
        to be an order): not in the asymptotic range; "two sizes": no order is observed;
        "unchanged": the same to rounding; "carried": the values are those at a shifted resonance;
        "exact orbit": the first is the limit.
    order : float
        p, observed; nan where there is none.
    exponent : float
        The order that is extrapolated with from the two smallest sizes; nan where nothing is.
    factor : float
        F.
    extrapolated : float
        f; nan outside the asymptotic range.
    """

    sizes: tuple[float, ...]
    values: tuple[float, ...]
    behaviour: str
    order: float
    exponent: float
    factor: float
    extrapolated: float

    @property
    def is_asymptotic(self) -> bool:
        """Whether something could be extrapolated."""
        return self.behaviour in ("asymptotic", "outside", "two sizes", "unchanged", "exact orbit")

    def uncertainty(self, place: int = 0) -> float:
        """F abs(f_i - f) of a value, by default that of the smallest size; or F times their
        spread."""
        if self.is_asymptotic:
            return self.factor * abs(self.values[place] - self.extrapolated)
        return self.factor * (max(self.values) - min(self.values))

    @property
    def gci(self) -> float:
        """The uncertainty of the value of the smallest size, relative to it."""
        return self.uncertainty() / abs(self.values[0]) if self.values[0] else math.nan

    def to_dict(self) -> dict[str, Any]:
        """All of it by name."""
        return {**vars(self), "gci": self.gci}

    def _title(self) -> str:
        return f"{self.behaviour}, order {self.order:.3g}, GCI {self.gci:.3g}"


def grid_convergence(
    sizes: Sequence[float],
    values: Sequence[float],
    *,
    formal: float = 2.0,
    highest: float = math.inf,
) -> GridConvergence:
    """The observed order, the extrapolated value and the grid-convergence index of some values.

    Parameters
    ----------
    sizes : (2,) or (3,)
        Of elements or steps, in any unit, all different; or reciprocals of numbers of something.
    values : (2,) or (3,)
        What was computed with these.
    formal : float
        The order that theory expects.
    highest : float
        Order that the scheme has where nothing disturbs it; above it values are not in the
        asymptotic range.

    Returns
    -------
    GridConvergence
        With the smallest size first.

    Raises
    ------
    InputError
        These are not two or three finite values with different sizes.

    Examples
    --------
    >>> found = fc.grid_convergence([0.5, 0.25, 0.125], [1.25, 1.0625, 1.015625])
    >>> order, value = found.order, found.extrapolated
    """
    check_number("formal", formal, 0.0, above=True)
    h, f = numbers(sizes), numbers(values)
    if h.shape not in ((2,), (3,)) or not np.all((h > 0.0) & (h < np.inf)):
        raise InputError("sizes", sizes, "two or three finite numbers > 0")
    if len(np.unique(h)) < len(h):
        raise InputError("sizes", sizes, "all different")
    if f.shape != h.shape or not np.all(np.isfinite(f)):
        raise InputError("values", values, f"{len(h)} finite numbers, one for each size")
    places = np.argsort(h)
    h, f = h[places], f[places]

    def found(
        behaviour: str, order: float, exponent: float, factor: float = CAUTIOUS
    ) -> GridConvergence:
        finest = float(f[0])
        if not math.isnan(exponent):
            finest += float((f[0] - f[1]) / math.expm1(exponent * math.log(h[1] / h[0])))
        elif behaviour != "unchanged":
            finest = math.nan
        return GridConvergence(
            tuple(h.tolist()), tuple(f.tolist()), behaviour, order, exponent, factor, finest
        )

    if np.ptp(f) <= UNCHANGED * np.abs(f).max():
        return found("unchanged", math.nan, math.nan)
    if len(h) == 2:
        return found("two sizes", math.nan, formal)
    if (f[2] - f[1]) * (f[1] - f[0]) < 0.0:
        return found("oscillating", math.nan, math.nan)
    order = _observed(h, f)
    if order <= 0.0:
        return found("diverging", order, math.nan)
    if order > highest or math.isinf(order):
        return found("irregular", order, math.nan)
    most = highest if math.isfinite(highest) else MOST_OVER_FORMAL * formal
    if LEAST_ORDER <= order <= most:
        return found("asymptotic", order, min(order, formal), SAFE)
    return found("outside", order, min(max(order, LEAST_ORDER), formal))


def _observed(h: np.ndarray, f: np.ndarray) -> float:
    """p of three values that do not oscillate; negative where they come no closer."""
    fine, coarse = np.log(h[1] / h[0]), np.log(h[2] / h[1])
    if f[1] == f[0] or f[2] == f[1]:
        return math.inf if f[1] == f[0] else -math.inf
    wanted = math.log((f[2] - f[1]) / (f[1] - f[0]))

    def excess(p: float) -> float:
        """log of the ratio with an order, less that of the values; it rises with the order."""
        if p == 0.0:
            return math.log(coarse / fine) - wanted
        return p * fine + math.log(math.expm1(p * coarse) / math.expm1(p * fine)) - wanted

    steepest = HIGHEST_ORDER / max(fine, coarse)
    if excess(steepest) < 0.0 or excess(-steepest) > 0.0:
        return math.copysign(math.inf, wanted)
    import scipy.optimize  # takes a while, and is needed here alone

    return float(scipy.optimize.brentq(excess, -steepest, steepest))
