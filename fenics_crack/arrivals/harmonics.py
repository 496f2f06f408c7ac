"""Hold vibrations fitted to arrival times: amplitudes, standard errors, candidate orders."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from scipy.special import ndtr

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.robust import SIGNIFICANCE_LIMITS
from fenics_crack.basics.errors import InputError, check_count, check_number
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import (
    Tabular,
    add_frequency_entries,
    format_count,
    format_quantity,
    hertz_property,
)
from fenics_crack.numerics.fourier import fourier_basis

DEFAULT_TRIAL_ORDERS = range(1, 25)
"""Default engine orders to try."""


@dataclass(frozen=True, repr=False)
class Candidates(Tabular):
    """Hold the candidate orders with the residual of each.

    Attributes
    ----------
    orders : (n,)
        Periods of the load in a revolution.
    residuals : (n,) [m]
        Root mean square residual of the fit.
    conditions : (n,)
        Condition number of the fit's columns at these probes; each column is scaled to length 1. A
        large number amplifies errors of the probes.
    equivalent : (n,) bool
        True if the order fits as well as the best order, within errors. Also true if the order and
        the best order can give the same displacements at the probes.
    hidden : (n,) bool
        True if these probes cannot measure the order, for one of three reasons. Constants could
        explain the vibration, harmonics look alike at the probes, or the fit is so inaccurate that
        the fitted blade tip moves backwards.
    """

    orders: np.ndarray
    residuals: np.ndarray
    conditions: np.ndarray
    equivalent: np.ndarray
    hidden: np.ndarray

    def to_dict(self) -> dict[str, Any]:
        """Return lists by name, with an entry for every order.

        The names are "order", "residual" [m], "condition", "equivalent" and "hidden".
        """
        column_names = "order", "residual", "condition", "equivalent", "hidden"
        return {
            column_name: column_values.tolist()
            for column_name, column_values in zip(column_names, vars(self).values(), strict=True)
        }

    def _unit_by_name(self) -> Mapping[str, str]:
        return {"residual": "m"}

    def _repr_text(self) -> str:
        counts_text = f"{int(self.equivalent.sum())} equivalent, {int(self.hidden.sum())} hidden"
        return f"{len(self.orders)} orders, {counts_text}"


@keep_old_attribute_names(may_be_folded="may_contain_aliased_harmonics")
class HarmonicFit(Tabular):
    """Hold harmonics fitted to arrivals, and tests of the fit.

    ``misfit`` is the probability that chance alone makes residuals as large, or as correlated
    between revolutions, as measured. ``folded`` is the probability that harmonics outside the fit
    change a fitted amplitude by over three standard errors. Both are nan if unknown.
    """

    misfit: float
    folded: float

    @property
    def does_not_fit(self) -> bool:
        """True if residuals this large are too improbable: ``misfit`` is below 0.001.

        Harmonics are then missing, or the order is wrong. False without a test.
        """
        return self.misfit < SIGNIFICANCE_LIMITS.misfit_significance_level

    @property
    def may_contain_aliased_harmonics(self) -> bool:
        """True if harmonics outside the fit may have changed a fitted amplitude.

        The property is True if ``folded`` exceeds 0.0455, the probability of a normal number beyond
        two standard deviations. False if ``folded`` is nan.
        """
        return bool(self.folded > 2.0 * ndtr(-2.0))

    @property
    def _doubt_texts(self) -> list[str]:
        """List with the text of the gravest doubt about the fit; empty without a doubt."""
        if self.does_not_fit:
            return ["DOES NOT FIT: fit more harmonics, or try other orders"]
        folding_text = (
            "harmonics that are not fitted may be aliased onto these: fit more harmonics, or use "
            "more probes"
        )
        return [folding_text] * self.may_contain_aliased_harmonics


@keep_old_attribute_names(
    ratio="ratio_and_error", ambiguous="ambiguous_orders", phases="angles_at_arrivals"
)
@dataclass(frozen=True, repr=False)
class TipFit(HarmonicFit):
    """Hold a periodic vibration fitted to arrival times.

        u = a0 + sum_k a_k cos(m_k p alpha) + b_k sin(m_k p alpha)

    is the displacement over the rotor angle alpha. The load has p periods in a revolution, and the
    sum is over k = 1 ... K fitted harmonics.

    Attributes
    ----------
    order : float
        Order p of the best candidate; look at :attr:`ambiguous_orders` and :attr:`hidden`, too.
    order_error : float
        Standard error of the order; 0 for a choice among given orders.
    speed : float [rad/s]
        Mean speed of rotation.
    multiples : (K,)
        Multiples m_k: 1, 2, ...; or 1/2, 1, ... for a response with twice the load's period.
    coefficients : (2K+1,) [m]
        a0, a1, b1, ....
    covariance : (2K+1, 2K+1) [m^2]
        Coefficient covariance.
    scatter : float [m]
        Standard deviation of displacements from the fit; nan without more arrivals than unknowns.
        Standard errors follow Student's t, and are nan for one or two more arrivals than unknowns.
    misfit : float
        Probability that chance alone makes the probes' mean displacements differ from the fit as
        much as measured, given the scatter at each probe. If it is tiny, harmonics are missing,
        probes are out of place, or the order is wrong. nan with too few probes or revolutions, and
        for :func:`fit_frequency`.
    candidates : Candidates
        Candidate orders.
    spare : int
        Number of probe means less number of unknowns. For :func:`fit_frequency`, number of arrivals
        less number of unknowns. With 0, nothing tests the order or the number of harmonics.
    asynchronous : tuple of TipFit
        Vibrations at no engine order, found in the same arrivals.
    folded : float
        Probability that harmonics outside the fit change an amplitude by over three standard
        errors. Assumed sizes are 0, or 0.7 down to 0.006 times the highest fitted harmonic,
        equally probable on a logarithmic scale. nan for unknown errors, and for
        :func:`fit_frequency`.
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

    frequency = hertz_property()

    @property
    def omega(self) -> float:
        """Angular frequency of the load [rad/s]."""
        return self.order * self.speed

    @property
    def amplitudes(self) -> np.ndarray:
        """Amplitudes of the harmonics: (K,) [m]."""
        return compute_amplitudes_and_errors(self.coefficients, self.covariance)[0]

    @property
    def amplitude_errors(self) -> np.ndarray:
        """Standard errors for the amplitudes: (K,) [m]."""
        return compute_amplitudes_and_errors(self.coefficients, self.covariance)[1]

    @property
    def ambiguous_orders(self) -> tuple[float, ...]:
        """Further orders that explain these arrivals equally well."""
        is_other_equivalent = self.candidates.equivalent & (self.candidates.orders != self.order)
        return tuple(self.candidates.orders[is_other_equivalent].tolist())

    @property
    def hidden(self) -> tuple[float, ...]:
        """Candidate orders that these probes cannot measure, even if the blade vibrates at them."""
        return tuple(self.candidates.orders[self.candidates.hidden].tolist())

    @property
    def in_doubt(self) -> bool:
        """True if a test of the fit fails, or cannot be made.

        A test fails if ``misfit`` is below 0.001, or harmonics outside the fit may have changed an
        amplitude (:attr:`may_contain_aliased_harmonics`). No test is possible with as many unknowns
        as probe means, or if no probe sees the vibration twice (:attr:`seen_once`).
        """
        return (
            self.does_not_fit
            or self.may_contain_aliased_harmonics
            or self.spare < 1
            or self.seen_once
        )

    @property
    def seen_once(self) -> bool:
        """True if no probe sees the same motion twice, as in a single revolution.

        Errors of arrivals then follow from the residuals alone, and no test shows missing
        harmonics. False for results of :func:`fit_frequency`, and if ``spare`` is 0.
        """
        return self.spare > 0 and bool(np.isnan(self.misfit)) and not self.order_error

    def ratio_and_error(self, multiple: float = 2.0) -> tuple[float, float]:
        """Return the ratio of a harmonic's amplitude to the first, and its standard error.

        ``multiple`` is the harmonic's frequency over the load's frequency. A breathing crack has a
        second harmonic, an open crack none.

        Raises
        ------
        InputError
            The fit has no harmonic at this multiple, or none at the load's frequency.
        """
        harmonic_indices = []
        for required_multiple in (1.0, multiple):
            matching_harmonic_indices = np.flatnonzero(
                np.isclose(self.multiples, required_multiple)
            )
            if not len(matching_harmonic_indices):
                raise InputError(
                    "multiple",
                    required_multiple,
                    f"one of the fitted multiples {self.multiples.tolist()}",
                )
            harmonic_indices.append(int(matching_harmonic_indices[0]))
        base_amplitude, multiple_harmonic_amplitude = self.amplitudes[harmonic_indices]
        amplitude_errors = self.amplitude_errors[harmonic_indices]
        base_slice, other_slice = (
            slice(2 * harmonic_index + 1, 2 * harmonic_index + 3)
            for harmonic_index in harmonic_indices
        )
        weighted_covariance = (
            self.coefficients[base_slice]
            @ self.covariance[base_slice, other_slice]
            @ self.coefficients[other_slice]
        )
        amplitude_ratio = multiple_harmonic_amplitude / base_amplitude
        amplitude_covariance = weighted_covariance / (base_amplitude * multiple_harmonic_amplitude)
        variance_of_ratio_times_base = (
            amplitude_errors[1] ** 2
            - 2.0 * amplitude_ratio * amplitude_covariance
            + (amplitude_ratio * amplitude_errors[0]) ** 2
        )
        return float(amplitude_ratio), float(np.sqrt(variance_of_ratio_times_base) / base_amplitude)

    def displacement(self, angle: np.ndarray) -> np.ndarray:
        """Return the fitted displacement [m] at angles [rad], both (n,).

        The angles are rotor angles; :meth:`angles_at_arrivals` returns them for arrivals.
        """
        return fourier_basis(self.order * np.asarray(angle), self.multiples) @ self.coefficients

    def angles_at_arrivals(self, arrivals: ArrivalTimes) -> np.ndarray:
        """Return the angles at the arrivals for :meth:`displacement`: (revolutions, probes) [rad].

        The angles are rotor angles; for a result of :func:`fit_frequency`, the mean speed times
        the time since the first mark.
        """
        if self.order_error:
            return self.speed * (arrivals.time - arrivals.marks[0])
        return arrivals.angle

    # --- shown ------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Return lists by name: the mean displacement first, then every harmonic.

        A harmonic is A cos(m p alpha - phase), with the load's order p and the rotor angle alpha.
        The lists are the multiple m, the order m p, the frequency in rad/s and Hz, the amplitude A
        [m] with the standard error, and the phase [rad].
        """
        load_frequency_multiples = np.concatenate([[0.0], self.multiples])
        cosines, sines = self.coefficients[1::2], self.coefficients[2::2]
        mean_and_error = self.coefficients[:1], np.sqrt(self.covariance[:1, 0])
        amplitudes, amplitude_errors = compute_amplitudes_and_errors(
            self.coefficients, self.covariance
        )
        column_by_name = {
            "multiple": load_frequency_multiples.tolist(),
            "order": (load_frequency_multiples * self.order).tolist(),
            "omega": (load_frequency_multiples * self.omega).tolist(),
            "amplitude": np.concatenate([mean_and_error[0], amplitudes]).tolist(),
            "amplitude_error": np.concatenate([mean_and_error[1], amplitude_errors]).tolist(),
            "phase": np.concatenate([[0.0], np.arctan2(sines, cosines)]).tolist(),
        }
        return add_frequency_entries(column_by_name)

    def _repr_text(self) -> str:
        title_parts = [f"order {self.order:.6g}, {self.omega:.6g} rad/s"]
        harmonic_rows = zip(self.multiples, self.amplitudes, self.amplitude_errors, strict=True)
        title_parts += [
            f"{multiple:g}x {format_quantity(amplitude, 'm')} ± {format_quantity(error, 'm')}"
            for multiple, amplitude, error in harmonic_rows
        ]
        title_parts += self._doubt_texts
        if self.spare < 1:
            title_parts.append(
                "not tested, as there are as many unknowns as probes: use more probes, or fit "
                "fewer harmonics"
            )
        elif self.seen_once:
            title_parts.append(
                "not tested, as each probe measures the vibration once: record more revolutions"
            )
        title_parts += [
            f"beside {asynchronous_fit.omega:.6g} rad/s" for asynchronous_fit in self.asynchronous
        ]
        for orders_label, listed_orders in (
            ("as well", self.ambiguous_orders),
            ("not measured", self.hidden),
        ):
            title_parts += [f"{orders_label}: {format_first_orders(listed_orders)}"] * bool(
                listed_orders
            )
        return ", ".join(title_parts)


def format_first_orders(orders: Sequence[float]) -> str:
    """Return the first six orders as text: "1, 2.5, ..."."""
    return ", ".join([*(f"{order:.6g}" for order in orders[:6]), *["..."] * (len(orders) > 6)])


def compute_amplitudes_and_errors(
    coefficients: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the amplitudes of harmonics, and their standard errors.

    The amplitude A of harmonic k is the length of the vector (a_k, b_k). The vector's errors have
    two components. The component along the vector changes A directly. A component e across the
    vector lengthens A by about e^2 / (2 A). With the mean v of e^2, this adds 3/4 (v / A)^2 to the
    variance.

    Two cases are treated apart, as the probes may measure only the cosine or the sine. If A is
    below sqrt(v), the added variance is 3/4 v. If A is 0, the direction of the cosine is "along".

    Parameters
    ----------
    coefficients : (..., 2K+1)
        Constant, and coefficients of K harmonics: a0, a1, b1, ....
    covariance : (..., 2K+1, 2K+1)
        Covariance of the coefficients.

    Returns
    -------
    amplitudes, errors : (..., K)
        Amplitudes, and standard errors.
    """
    cosine_sine_pairs = np.stack([coefficients[..., 1::2], coefficients[..., 2::2]])
    amplitudes = np.hypot(*cosine_sine_pairs)
    unit_directions = np.stack([np.ones_like(amplitudes), np.zeros_like(amplitudes)])
    direction_cosines, direction_sines = np.divide(
        cosine_sine_pairs, amplitudes, out=unit_directions, where=amplitudes > 0.0
    )
    cosine_indices = np.arange(1, coefficients.shape[-1], 2)
    pair_covariances = np.array(
        [
            [
                covariance[..., cosine_indices + pair_row_index, cosine_indices + pair_column_index]
                for pair_column_index in (0, 1)
            ]
            for pair_row_index in (0, 1)
        ]
    )
    radial_variances, tangential_variances = (
        np.maximum(np.einsum("i...,ij...,j...->...", direction, pair_covariances, direction), 0.0)
        for direction in (
            np.stack([direction_cosines, direction_sines]),
            np.stack([-direction_sines, direction_cosines]),
        )
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        mean_lengthenings = np.nan_to_num(
            tangential_variances / np.maximum(amplitudes, np.sqrt(tangential_variances))
        )
    return amplitudes, np.sqrt(radial_variances + 0.75 * mean_lengthenings**2)


# --- fits -----------------------------------------------------------------------------------------


def make_orders_and_multiples(
    orders: Iterable[float], harmonics: int, subharmonic: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return sorted candidate orders (n,), and multiples (K,) of the load's frequency.

    The multiples are 1 to ``harmonics``, each divided by ``subharmonic``. InputError if an order is
    not above 0, or a count is below 1.
    """
    check_count("harmonics", harmonics, 1)
    check_count("subharmonic", subharmonic, 1)
    candidate_orders = list(orders)
    if not candidate_orders:
        raise InputError("orders", candidate_orders, "one or more numbers > 0")
    for order in candidate_orders:
        check_number("orders", order, 0.0, excludes_bound=True)
    return np.unique(np.array(candidate_orders, dtype=float)), np.arange(
        1, harmonics + 1
    ) / subharmonic


def select_candidate(
    residual_square_sums: np.ndarray,
    vibration_sizes: np.ndarray,
    allowed_difference: float,
    is_measurable: np.ndarray | bool = True,
) -> tuple[np.ndarray, int]:
    """Select the smallest vibration among candidates with equally small residuals.

    Parameters
    ----------
    residual_square_sums, vibration_sizes : (n,)
        Sum of squared residuals, and size of the fitted vibration, for each candidate.
    allowed_difference : float
        A candidate is equivalent to the best if its sum exceeds the least sum by less than this.
    is_measurable : (n,) bool or bool
        True if the probes can measure the candidate. If any equivalent candidate is measurable, the
        selected candidate is measurable.

    Returns
    -------
    is_equivalent : (n,) bool
        True for an equivalent candidate.
    index : int
        Index of the selected candidate. Only equivalent candidates are considered, and only
        measurable ones if there are any. Sizes up to 20 % above the smallest count as equal. Among
        these, the candidate with the least sum is selected.
    """
    is_equivalent = residual_square_sums - residual_square_sums.min() < allowed_difference
    is_eligible = (
        is_equivalent & is_measurable if np.any(is_equivalent & is_measurable) else is_equivalent
    )
    is_near_smallest_vibration = is_eligible & (
        vibration_sizes <= 1.2 * vibration_sizes[is_eligible].min()
    )
    return is_equivalent, int(
        np.argmin(np.where(is_near_smallest_vibration, residual_square_sums, np.inf))
    )


def condition_number(columns: np.ndarray) -> float:
    """Return the condition number of columns (n, m), each scaled to length 1.

    inf for dependent columns: fewer rows than columns, lengths below 1e-8 of the longest, or a
    condition number of 1e8 or more.
    """
    column_lengths = np.linalg.norm(columns, axis=0)
    if len(columns) < len(column_lengths) or column_lengths.min() < 1e-8 * column_lengths.max():
        return np.inf
    scaled_condition_number = float(np.linalg.cond(columns / column_lengths))
    return scaled_condition_number if scaled_condition_number < 1e8 else np.inf


def raise_too_few_probes(arrivals: ArrivalTimes, n_unknowns: int) -> NoReturn:
    """Raise InputError: the probes cannot determine ``n_unknowns`` coefficients."""
    angles_text = ", ".join(f"{angle:g}" for angle in np.degrees(arrivals.probes))
    probes_text = f"{format_count(len(arrivals.probes), 'probe')} at {angles_text} degrees"
    requirement_text = (
        f"enough for the {n_unknowns} unknowns of the fit: use more probes at unequal angles, "
    )
    requirement_text += "fewer harmonics, or more accurate arrivals"
    raise InputError("probes", probes_text, requirement_text)
