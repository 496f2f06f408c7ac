"""Estimate a number's error from two or three step sizes (grid convergence).

Roache's index assumes f_i = f + C h_i^p for values f_i with sizes h_1 < h_2 < h_3. Then

    (f_3 - f_2) / (f_2 - f_1) = (h_3^p - h_2^p) / (h_2^p - h_1^p)

gives the observed order p, and f = f_1 + (f_1 - f_2) / ((h_2/h_1)^p - 1) the extrapolated value.
The uncertainty of f_i is F |f_i - f|. The grid-convergence index is the relative uncertainty of f_1

    GCI = F |(f_1 - f_2) / f_1| / ((h_2/h_1)^p - 1).

The safety factor F is 1.25 if three sizes show an order from 0.5 up to the scheme's order;
otherwise F is 3. If no scheme's order is given, the upper bound is 1.5 times the theoretical order.
The extrapolation uses at most the theoretical order, as the slowest part of an error comes last.
This bounds an error with powers from the theoretical order on, if all coefficients have equal sign.

Values are irregular if they oscillate, diverge, or converge faster than the scheme can. Nothing is
extrapolated from irregular values, and the uncertainty is 3 times the spread.

Roache, Journal of Fluids Engineering 116, 1994, 405; Celik et al., the same 130, 2008, 078001;
ASME V&V 20-2009, section 2; the rule for orders follows Oberkampf and Roy, Verification and
Validation in Scientific Computing, 2010, chapter 8.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError, check_number
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import Described
from fenics_crack.model.matrices import floats_or_single_nan
from fenics_crack.scene.scene import Scene

ASYMPTOTIC_SAFETY_FACTOR, CAUTIOUS_SAFETY_FACTOR = 1.25, 3.0
"""Safety factors F of the grid-convergence index.

The first holds for three sizes with an observed order from 0.5 to the scheme's order, the second
otherwise.
"""
MAX_RELATIVE_ROUNDING_SPREAD = 1e-9
"""Largest spread due to rounding alone, relative to the largest absolute value."""
TIP_CONVERGENCE_ORDER, CLAMP_CONVERGENCE_ORDER = 1.0, 1.5
"""Theoretical orders p of the error C h^p with element length h: at a crack tip, at a clamp's ends.
"""
MIN_TRUSTED_CONVERGENCE_ORDER = 0.5
"""Minimum observed order with the smaller safety factor, and minimum order for extrapolation."""


@keep_old_attribute_names(is_asymptotic="has_error_from_limit")
@dataclass(frozen=True, repr=False)
class GridConvergence(Described):
    """Hold a number's values at two or three step sizes, and the estimated error.

    The error model is f_i = f + C h_i^p, with the limit f for h = 0.

    Attributes
    ----------
    sizes, values : tuple of float
        Step sizes h_i, smallest first, and the value f_i computed with each size.
    behaviour : str
        How the values converge:

        - "asymptotic": the observed order is at least 0.5, and not above the scheme's order,
        - "outside": the values converge with an order outside this range,
        - "irregular": the values oscillate, diverge, or converge too fast to show an order,
        - "two sizes": two sizes show no order,
        - "unchanged": the values agree to rounding,
        - "two parameter values": the sizes are two values of a parameter, such as a friction
          coefficient, the answer's first; "two coefficients" in files of version 0.4,
        - "carried": both values are on the same mesh, the first at a shifted load frequency,
        - "exact orbit": the first value, taken as the limit, is from a periodic motion without
          truncated harmonics.
    order : float
        Observed order p; nan if none is observed.
    exponent : float
        Order p used to extrapolate from the two smallest sizes; nan without an extrapolation.
    factor : float
        Safety factor F on the distance between a value and the limit.
    extrapolated : float
        Limit f; nan if nothing is extrapolated.
    """

    sizes: tuple[float, ...]
    values: tuple[float, ...]
    behaviour: str
    order: float = math.nan
    exponent: float = math.nan
    factor: float = CAUTIOUS_SAFETY_FACTOR
    extrapolated: float = math.nan

    @property
    def has_error_from_limit(self) -> bool:
        """True if a value's error is the distance to the extrapolated value.

        For the behaviours "irregular", "carried" and "two parameter values", False: the error is
        then the spread of all values.
        """
        return self.behaviour not in (
            "irregular",
            "carried",
            "two parameter values",
            "two coefficients",  # of version 0.4
        )

    def uncertainty(self, value_index: int = 0) -> float:
        """Return a value's uncertainty F abs(f_i - f), in the value's unit.

        F is the safety factor (``factor``), and f is the limit (``extrapolated``). If
        :attr:`has_error_from_limit` is False, return F times the spread between all values instead.
        If the values differ by rounding alone, return 0.

        Parameters
        ----------
        value_index : int
            Index for the value f_i, from 0. The default selects the value at the smallest size.
        """
        if self.behaviour == "unchanged":
            return 0.0
        if self.has_error_from_limit:
            return self.factor * abs(self.values[value_index] - self.extrapolated)
        return self.factor * (max(self.values) - min(self.values))

    @property
    def gci(self) -> float:
        """Grid-convergence index: uncertainty over absolute value, at the smallest size.

        nan if this value is 0.
        """
        return self.uncertainty() / abs(self.values[0]) if self.values[0] else math.nan

    def to_dict(self) -> dict[str, Any]:
        """Return all attributes by name, and the grid-convergence index as "gci"."""
        return {**vars(self), "gci": self.gci}

    def _repr_text(self) -> str:
        return f"{self.behaviour}, order {self.order:.3g}, GCI {self.gci:.3g}"


def grid_convergence(
    sizes: Sequence[float],
    values: Sequence[float],
    *,
    formal: float = 2.0,
    highest: float = math.inf,
) -> GridConvergence:
    """Find the observed order, extrapolated value and grid-convergence index.

    The error is assumed to be C h^p, with the step size h, a constant C and the order p.

    Parameters
    ----------
    sizes : (2,) or (3,)
        Different step sizes h in any unit: element lengths or time steps. For counts, such as modes
        or harmonics, the step size is 1 / count.
    values : (2,) or (3,)
        Value computed with each size.
    formal : float
        Order p expected by theory. The extrapolation uses at most this order.
    highest : float
        The numerical scheme's order p for a smooth solution. If the observed order is larger, the
        values are irregular.

    Returns
    -------
    GridConvergence
        Sizes and values, smallest size first, with order, safety factor and limit.

    Raises
    ------
    InputError
        There are not two or three finite values with different sizes, or ``formal`` is not
        positive.

    Examples
    --------
    >>> convergence = fc.grid_convergence([0.5, 0.25, 0.125], [1.25, 1.0625, 1.015625])
    >>> order, value = convergence.order, convergence.extrapolated
    """
    check_number("formal", formal, 0.0, excludes_bound=True)
    h, f = floats_or_single_nan(sizes), floats_or_single_nan(values)
    if h.shape not in ((2,), (3,)) or not np.all((h > 0.0) & (h < np.inf)):
        raise InputError("sizes", sizes, "two or three finite numbers > 0")
    if len(np.unique(h)) < len(h):
        raise InputError("sizes", sizes, "different from each other")
    if f.shape != h.shape or not np.all(np.isfinite(f)):
        raise InputError("values", values, f"{len(h)} finite numbers, one for each of sizes")
    ascending_indices = np.argsort(h)
    h, f = h[ascending_indices], f[ascending_indices]
    behaviour, observed_order, exponent = _find_behaviour_and_orders(h, f, formal, highest)
    if behaviour == "unchanged":
        extrapolated_limit = float(f[0])
    else:
        extrapolated_limit = float(
            f[0] + (f[0] - f[1]) / math.expm1(exponent * math.log(h[1] / h[0]))
        )
    return GridConvergence(
        tuple(h.tolist()),
        tuple(f.tolist()),
        behaviour,
        observed_order,
        exponent,
        ASYMPTOTIC_SAFETY_FACTOR if behaviour == "asymptotic" else CAUTIOUS_SAFETY_FACTOR,
        extrapolated_limit,
    )


def _find_behaviour_and_orders(
    h: np.ndarray, f: np.ndarray, formal_order: float, scheme_order: float
) -> tuple[str, float, float]:
    """Classify the convergence of values with ascending sizes.

    Parameters
    ----------
    h, f : (2,) or (3,)
        Sizes in ascending order, and the value computed with each size.
    formal_order : float
        Order expected by theory, the maximum for the extrapolation.
    scheme_order : float
        Largest possible order, inf if unknown; a larger observed order makes the values irregular.

    Returns
    -------
    str
        Behaviour, as in :class:`GridConvergence`.
    float
        Observed order; nan if none is observed.
    float
        Order of the extrapolation; nan if nothing is extrapolated.
    """
    if np.ptp(f) <= MAX_RELATIVE_ROUNDING_SPREAD * np.abs(f).max():
        return "unchanged", math.nan, math.nan
    if len(h) == 2:
        return "two sizes", math.nan, formal_order
    is_oscillating = (f[2] - f[1]) * (f[1] - f[0]) < 0.0
    observed_order = math.nan if is_oscillating else _find_observed_order(h, f)
    if not 0.0 < observed_order <= scheme_order or math.isinf(observed_order):
        return "irregular", observed_order, math.nan
    max_credible_order = scheme_order if math.isfinite(scheme_order) else 1.5 * formal_order
    behaviour = (
        "asymptotic"
        if MIN_TRUSTED_CONVERGENCE_ORDER <= observed_order <= max_credible_order
        else "outside"
    )
    return (
        behaviour,
        observed_order,
        min(max(observed_order, MIN_TRUSTED_CONVERGENCE_ORDER), formal_order),
    )


def _find_observed_order(h: np.ndarray, f: np.ndarray) -> float:
    """Solve for the order p of three monotonic values with ascending sizes.

        (f_3 - f_2) / (f_2 - f_1) = (h_3^p - h_2^p) / (h_2^p - h_1^p)

    The order is negative if the values diverge with refinement. It is inf if f_1 = f_2, and -inf if
    f_2 = f_3; a root beyond the range of floats is infinite, too.
    """
    fine_log_size_ratio, coarse_log_size_ratio = np.log(h[1] / h[0]), np.log(h[2] / h[1])
    if f[1] == f[0] or f[2] == f[1]:
        return math.inf if f[1] == f[0] else -math.inf
    log_value_difference_ratio = math.log((f[2] - f[1]) / (f[1] - f[0]))

    def excess(p: float) -> float:
        """Return ln((h_3^p - h_2^p) / (h_2^p - h_1^p)) - ln((f_3 - f_2) / (f_2 - f_1))."""
        if p == 0.0:
            return (
                math.log(coarse_log_size_ratio / fine_log_size_ratio) - log_value_difference_ratio
            )
        return (
            p * fine_log_size_ratio
            + math.log(math.expm1(p * coarse_log_size_ratio) / math.expm1(p * fine_log_size_ratio))
            - log_value_difference_ratio
        )

    max_order_without_overflow = (
        0.5 * math.log(np.finfo(float).max) / max(fine_log_size_ratio, coarse_log_size_ratio)
    )  # else expm1 overflows
    if excess(max_order_without_overflow) < 0.0 or excess(-max_order_without_overflow) > 0.0:
        return math.copysign(math.inf, log_value_difference_ratio)
    import scipy.optimize  # takes a while, and is needed here alone

    return float(
        scipy.optimize.brentq(excess, -max_order_without_overflow, max_order_without_overflow)
    )


# --- parts of a cause -----------------------------------------------------------------------------


ErrorPart = tuple[tuple[int, ...], dict[str, GridConvergence]]
"""Part of a cause in the errors: counts in all runs, and convergence by quantity name.

Counts are the runs' numbers of elements, modes, harmonics or samples, the answer's first. If runs
differ in a parameter, such as friction, counts are two equal numbers of modes or harmonics.
"""
PartOrReason = ErrorPart | str
"""An :data:`ErrorPart`, or the reason for no part as text; "" if the cause does not apply."""
CountAndValues = tuple[int, Mapping[str, float]]
"""A run's number of elements, modes, harmonics or samples, and values by quantity name."""


def estimate_error_part_from_runs(
    cause: str,
    counts_and_values: Sequence[CountAndValues],
    scene: Scene,
    *,
    size_ratio: float | None = None,
    formal_order: float = TIP_CONVERGENCE_ORDER,
    scheme_order: float = math.inf,
) -> ErrorPart:
    """Estimate a cause's part in each quantity's error from several runs.

    Parameters
    ----------
    cause : str
        Varied cause: "mesh", "modes", "harmonics" or "samples".
    counts_and_values : sequence of CountAndValues
        Count and values by quantity name for two or three runs, the answer first. A quantity
        missing in a further run counts as 0 there.
    scene : Scene
        The answer's scene. For the cause "mesh", the body's side lengths give the mean element
        size.
    size_ratio : float, optional
        Ratio h_2 / h_1 between the second run's and the answer's step sizes. By default the ratio
        follows from the counts. If given, the safety factor is 1: the error is an expected value,
        not a bound.
    formal_order : float
        Convergence order expected by theory.
    scheme_order : float
        Largest possible order. Values with a larger observed order are irregular.

    Returns
    -------
    ErrorPart
        Counts in the runs, and each quantity's convergence by name.
    """
    counts, values_of_runs = zip(*counts_and_values, strict=True)
    step_sizes = [_find_mean_step_size(cause, count, scene) for count in counts]
    if size_ratio is not None:
        step_sizes[1] = size_ratio * step_sizes[0]
    convergence_by_name = {}
    for quantity_name in values_of_runs[0]:
        values = [run_values.get(quantity_name, 0.0) for run_values in values_of_runs]
        convergence = grid_convergence(
            step_sizes, values, formal=formal_order, highest=scheme_order
        )
        convergence_by_name[quantity_name] = (
            convergence if size_ratio is None else replace(convergence, factor=1.0)
        )
    return counts, convergence_by_name


def _find_mean_step_size(cause: str, count: int, scene: Scene) -> float:
    """Return the step size h for a count of elements, modes, harmonics or samples.

    For the cause "mesh", h [m] is the side of the mean element, a square or cube (Celik et al.,
    equation 1). For any further cause, h is 1 / count.
    """
    if cause != "mesh":
        return 1.0 / count
    return float((math.prod(scene.geometry.sides) / count) ** (1.0 / scene.dimension))
