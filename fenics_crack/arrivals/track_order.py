"""Track the harmonics of a known engine order through a run-up.

Groups of revolutions are fitted one by one, as in :mod:`fit_order`. Neighbouring groups together
give the variance of an arrival, and the size of omitted harmonics.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtri

from fenics_crack.arrivals.arrival_times import ArrivalTimes, smooth_series
from fenics_crack.arrivals.fit_order import TRIAL_OMITTED_HARMONIC_RATIOS, OrderFit, Sample
from fenics_crack.arrivals.harmonics import (
    HarmonicFit,
    compute_amplitudes_and_errors,
    condition_number,
    make_orders_and_multiples,
    raise_too_few_probes,
)
from fenics_crack.arrivals.robust import (
    SIGNIFICANCE_LIMITS,
    correlation_p_value,
    student_variance_ratio,
)
from fenics_crack.basics.errors import InputError, check_count
from fenics_crack.basics.tables import (
    RAD_PER_TURN,
    UNIT_BY_DICT_ENTRY_NAME,
    add_frequency_entries,
    format_count,
    hertz_property,
)
from fenics_crack.numerics.fourier import fourier_basis

N_NEIGHBOUR_GROUPS_PER_SIDE = 16
"""Number of neighbouring groups on either side in a run-up.

A group and its neighbours share the size ratio of omitted harmonics.
"""


@dataclass(frozen=True, repr=False)
class TipTrack(HarmonicFit):
    """Hold harmonics at a known engine order in n successive groups of revolutions.

    Attributes
    ----------
    order : float
        Periods of the load in a revolution.
    speed : (n,) [rad/s]
        Mean speed of each group of revolutions.
    multiples : (K,)
        Fitted harmonics, as multiples of the load's frequency.
    coefficients : (n, 2K+1) [m]
        Constant, and cosine and sine coefficients of the harmonics: a0, a1, b1, ....
    amplitudes, amplitude_errors : (n, K) [m]
        Amplitudes with standard errors. Both are nan in a group with too few arrivals. Errors are
        also nan with as many unknowns as arrivals, or with two or fewer degrees of freedom. The
        degrees of freedom are a sum: arrivals less unknowns in the group, plus the degrees of
        freedom with which an arrival's variance was estimated.
    misfit : float
        Probability that chance alone correlates the residuals in successive revolutions as much as
        measured. If tiny, harmonics outside the fit change the fitted ones. nan without more probes
        than unknowns, since everything then fits.
    folded : float
        Probability that harmonics outside the fit change an amplitude by over three standard
        errors. For each harmonic, the group with the largest amplitude counts. nan if unknown.
    """

    order: float
    speed: np.ndarray
    multiples: np.ndarray
    coefficients: np.ndarray
    amplitudes: np.ndarray
    amplitude_errors: np.ndarray
    misfit: float
    folded: float = np.nan

    @property
    def in_doubt(self) -> bool:
        """True if a test of the fit fails, or cannot be made.

        A test fails if ``misfit`` is below 0.001, or harmonics outside the fit may have changed an
        amplitude (:attr:`may_contain_aliased_harmonics`). A test cannot be made if ``misfit`` or
        ``folded`` is nan, for instance with as many unknowns as probes.
        """
        is_test_probability_unknown = np.isnan([self.misfit, self.folded])
        return (
            self.does_not_fit
            or self.may_contain_aliased_harmonics
            or bool(np.any(is_test_probability_unknown))
        )

    frequency = hertz_property()

    @property
    def omega(self) -> np.ndarray:
        """Angular frequency of the load for each group of revolutions: (n,) [rad/s]."""
        return np.asarray(self.order * self.speed)

    def to_dict(self) -> dict[str, Any]:
        """Return columns by name, with a row for every group of revolutions."""
        column_by_name = add_frequency_entries(
            {"speed": self.speed.tolist(), "omega": self.omega.tolist()}
        )
        for multiple_index, multiple in enumerate(self.multiples):
            column_by_name[f"amplitude_{multiple:g}"] = self.amplitudes[:, multiple_index].tolist()
            column_by_name[f"amplitude_error_{multiple:g}"] = self.amplitude_errors[
                :, multiple_index
            ].tolist()
        return column_by_name

    def _unit_by_name(self) -> Mapping[str, str]:
        return UNIT_BY_DICT_ENTRY_NAME | {
            name: "m" for name in self.to_dict() if name.startswith("amplitude")
        }

    def _repr_text(self) -> str:
        speeds_text = f"{self.speed[0]:.6g} to {self.speed[-1]:.6g} rad/s"
        points_text = format_count(len(self.speed), "point")
        return ", ".join([f"order {self.order:g}", speeds_text, points_text, *self._doubt_texts])


def track_order(
    arrivals: ArrivalTimes,
    order: float,
    *,
    harmonics: int = 1,
    subharmonic: int = 1,
    revolutions: int = 1,
    angle_deviation: float = 0.0,
) -> TipTrack:
    """Fit the harmonics of a known engine order in a run-up.

    The record is divided into groups of ``revolutions`` successive revolutions. Each group is
    fitted, as by :func:`fit_order` with one order. If the response has twice the load's period and
    the order is odd, a group needs two or more revolutions.

    During a group, the vibration changes with the speed. The linear part is subtracted before the
    fit. If a group's arrivals are not centred in the group, the standard errors include the change
    up to the middle. The variance of an arrival follows from differences between the residuals of
    neighbouring groups.

    Harmonics outside the fit change the fitted coefficients, and leave similar residuals in
    successive revolutions. As in :func:`fit_order`, the next higher harmonics are further unknowns.
    The ratio to the fitted vibration is assumed equal in neighbouring groups. If these harmonics
    are significant, the standard errors include the change. Otherwise ``folded`` is the probability
    of a large change.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Arrivals in a run-up or run-down.
    order : float
        Periods of the load in a revolution.
    harmonics : int
        Number of fitted harmonics.
    subharmonic : int
        Response period divided by the load's period. For 2, harmonics are 1/2, 1, ... times the
        load's frequency.
    revolutions : int
        Number of revolutions in each group.
    angle_deviation : float [rad]
        Probe angles' standard deviation, the same in every revolution.

    Returns
    -------
    TipTrack
        Amplitudes and phases with standard errors, and the speed of each group.

    Raises
    ------
    InputError
        A value cannot be used, or these probes cannot measure this order in so few revolutions.

    Examples
    --------
    >>> track = fc.track_order(arrivals, 6)
    """
    _, multiples = make_orders_and_multiples([order], harmonics, subharmonic)
    check_count("revolutions", revolutions, 1)
    arrivals.check_places(angle_deviation)
    n_groups, n_unknowns = len(arrivals) // revolutions, 2 * len(multiples) + 1
    n_probes = len(arrivals.probes)
    if not n_groups:
        raise InputError("revolutions", revolutions, f"at most {len(arrivals)}, all of the record")
    first_group_load_phases = order * arrivals.rotor_angle_without_vibration[:revolutions].ravel()
    if np.isinf(condition_number(fourier_basis(first_group_load_phases, multiples))):
        raise_too_few_probes(arrivals, n_unknowns)
    angles, rotor_angles_without_vibration, displacements = (
        angles_or_displacements[: n_groups * revolutions].reshape(n_groups, revolutions * n_probes)
        for angles_or_displacements in (
            arrivals.angle,
            arrivals.rotor_angle_without_vibration,
            arrivals.displacement,
        )
    )
    has_arrival = np.isfinite(displacements)
    n_arrivals, displacements = has_arrival.sum(axis=1), np.where(has_arrival, displacements, 0.0)
    wave_columns, nominal_columns = (
        np.where(has_arrival[..., None], fourier_basis(order * angle_array, multiples), 0.0)
        for angle_array in (np.nan_to_num(angles), rotor_angles_without_vibration)
    )
    has_fit = np.linalg.matrix_rank(nominal_columns, tol=1e-6) == n_unknowns
    column_pseudoinverses = np.linalg.pinv(wave_columns)
    rotor_angle_per_group = RAD_PER_TURN * revolutions
    relative_positions_in_group = (
        rotor_angles_without_vibration - rotor_angles_without_vibration[:, :1] + arrivals.probes[0]
    ) / rotor_angle_per_group - 0.5
    displacements, coefficient_changes = _subtract_linear_changes(
        displacements,
        column_pseudoinverses,
        wave_columns,
        relative_positions_in_group,
        np.flatnonzero(has_fit),
    )
    coefficients = column_pseudoinverses @ displacements[..., None]
    residuals = np.where(
        has_arrival & has_fit[:, None], displacements - (wave_columns @ coefficients)[..., 0], 0.0
    )
    revolution_and_probe_indices = np.nonzero(has_arrival.reshape(-1, n_probes))
    n_spare = n_probes * (subharmonic if revolutions > 1 else 1) - n_unknowns
    misfit_p_value = np.nan
    if n_spare > 0:
        misfit_p_value = correlation_p_value(
            residuals.reshape(-1, n_probes)[revolution_and_probe_indices],
            revolution_and_probe_indices,
        )
    variance, freedom = _estimate_variance_and_freedom(
        residuals, has_arrival, np.where(has_fit, n_arrivals - n_unknowns, 0)
    )
    variance = max(variance, arrivals.displacement_rounding**2)
    sample_fit_by_group = _fit_samples_by_group(
        arrivals, order, multiples, rotor_angles_without_vibration, displacements, has_arrival,
        np.flatnonzero(has_fit), variance, freedom, angle_deviation,
    )  # fmt: skip
    if n_spare > 1 and freedom > 0:
        sample_fit_by_group = _refit_groups_with_higher_harmonics(sample_fit_by_group)
    coefficients, covariances = _find_coefficients_and_covariances(
        sample_fit_by_group, n_arrivals, coefficient_changes, freedom
    )
    amplitudes, amplitude_errors = compute_amplitudes_and_errors(coefficients, covariances)
    amplitude_error_probability = np.nan
    if n_spare > 1 and freedom > 0 and sample_fit_by_group:
        peak_group_indices = {
            int(np.nanargmax(amplitudes_over_groups)) for amplitudes_over_groups in amplitudes.T
        }
        amplitude_error_probability = max(
            sample.compute_amplitude_error_probability(fit)
            for sample, fit in map(sample_fit_by_group.__getitem__, peak_group_indices)
        )
    group_marks = arrivals.marks[: n_groups * revolutions + 1 : revolutions]
    speeds = 2.0 * np.pi * revolutions / np.diff(group_marks)
    return TipTrack(
        order,
        speeds,
        multiples,
        coefficients,
        amplitudes,
        amplitude_errors,
        misfit_p_value,
        amplitude_error_probability,
    )


def _fit_samples_by_group(
    arrivals: ArrivalTimes,
    order: float,
    multiples: np.ndarray,
    rotor_angles_without_vibration: np.ndarray,
    displacements: np.ndarray,
    has_arrival: np.ndarray,
    fitted_groups: np.ndarray,
    variance: float,
    freedom: int,
    angle_deviation: float,
) -> dict[int, tuple[Sample, OrderFit]]:
    """Fit an engine order to each group of revolutions.

    There are n groups with up to m arrivals each.

    Parameters
    ----------
    arrivals : ArrivalTimes
        Record with the probes and the blade tip radius.
    order : float
        Periods of the load in a revolution.
    multiples : (K,)
        Fitted harmonics, as multiples of the load's frequency.
    rotor_angles_without_vibration : (n, m) [rad]
        Rotor angles at which the blade tip would pass the probes without vibration.
    displacements : (n, m) [m]
        Measured displacements.
    has_arrival : (n, m) bool
        True for an arrival; other entries are ignored.
    fitted_groups : (k,)
        Indices of groups with enough arrivals.
    variance : float [m^2]
        Estimated variance of a measured displacement.
    freedom : int
        Degrees of freedom with which ``variance`` was estimated.
    angle_deviation : float [rad]
        Probe angles' standard deviation.

    Returns
    -------
    dict of int to (Sample, OrderFit)
        Displacements and fit by group index; groups without a fit are left out
        (:meth:`Sample.fit_order_or_none`).
    """
    probe_indices = np.arange(has_arrival.shape[1]) % len(arrivals.probes)
    is_same_probe = probe_indices[:, None] == probe_indices
    covariance = variance * np.eye(len(probe_indices))
    covariance += (arrivals.tip_radius * angle_deviation) ** 2 * is_same_probe
    sample_fit_by_group = {}
    for group_index in fitted_groups.tolist():
        is_used = has_arrival[group_index]
        sample = Sample(
            rotor_angles_without_vibration[group_index, is_used],
            displacements[group_index, is_used],
            covariance[np.ix_(is_used, is_used)],
            freedom,
            arrivals.tip_radius,
        )
        if (fit := sample.fit_order_or_none(order, multiples)) is not None:
            sample_fit_by_group[group_index] = sample, fit
    return sample_fit_by_group


def _find_coefficients_and_covariances(
    sample_fit_by_group: dict[int, tuple[Sample, OrderFit]],
    n_arrivals: np.ndarray,
    coefficient_changes: np.ndarray,
    freedom: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return coefficients and covariances of n groups; nan without a fit.

    Parameters
    ----------
    sample_fit_by_group : dict of int to (Sample, OrderFit)
        Displacements and fit by group index.
    n_arrivals : (n,)
        Number of arrivals in each group.
    coefficient_changes : (n, 2K+1) [m]
        Coefficient error if a group's arrivals are not centred in the group, from
        :func:`_subtract_linear_changes`. The square is added to the covariance.
    freedom : int
        Degrees of freedom with which the variance of a measured displacement was estimated.

    Returns
    -------
    coefficients : (n, 2K+1) [m]
        Constant, and coefficients of K harmonics: a0, a1, b1, ....
    covariances : (n, 2K+1, 2K+1) [m^2]
        Covariances of the coefficients; also nan with no more arrivals than unknowns.
    """
    coefficients = np.full(coefficient_changes.shape, np.nan)
    n_unknowns = coefficient_changes.shape[1]
    covariances = np.full((len(n_arrivals), n_unknowns, n_unknowns), np.nan)
    for group_index, (sample, fit) in sample_fit_by_group.items():
        coefficients[group_index] = fit.coefficients
        if n_arrivals[group_index] > n_unknowns:
            factor, _, total_freedom = sample.run_misfit_f_test(fit.sum_of_squares, n_unknowns)
            factor = max(factor, 1.0) if freedom else factor
            covariances[group_index] = (
                factor * student_variance_ratio(total_freedom) * fit.covariance
            )
            covariances[group_index] += np.outer(
                coefficient_changes[group_index], coefficient_changes[group_index]
            )
    return coefficients, covariances


def _subtract_linear_changes(
    displacements: np.ndarray,
    column_pseudoinverses: np.ndarray,
    wave_columns: np.ndarray,
    group_positions: np.ndarray,
    fitted_groups: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Subtract the linear change of the vibration within each group.

    The change would look like further harmonics. The rate follows from the coefficients of
    neighbouring groups. There are n groups with m arrivals each.

    Parameters
    ----------
    displacements : (n, m) [m]
        Displacements; 0 without an arrival.
    column_pseudoinverses : (n, 2K+1, m)
        Pseudoinverses of ``wave_columns``.
    wave_columns : (n, m, 2K+1)
        Derivatives of the fitted displacements by the coefficients.
    group_positions : (n, m)
        Position of each arrival in the group: -1/2 at the group's begin, 1/2 at its end.
    fitted_groups : (k,)
        Indices of groups with enough arrivals.

    Returns
    -------
    displacements : (n, m) [m]
        Displacements without the change.
    coefficient_changes : (n, 2K+1) [m]
        Change of the coefficients from the group's middle to the mean of ``group_positions``.
    """
    coefficient_rates = np.zeros(column_pseudoinverses.shape[:2])
    if len(fitted_groups) > 1:
        coefficient_rows = (column_pseudoinverses @ displacements[..., None])[fitted_groups, :, 0].T
        coefficient_rates[fitted_groups] = np.gradient(
            [smooth_series(coefficient_series) for coefficient_series in coefficient_rows],
            fitted_groups,
            axis=1,
        ).T
    displacement_changes = group_positions * (wave_columns @ coefficient_rates[..., None])[..., 0]
    return displacements - displacement_changes, group_positions.mean(
        axis=1, keepdims=True
    ) * coefficient_rates


def _refit_groups_with_higher_harmonics(
    sample_fit_by_group: dict[int, tuple[Sample, OrderFit]],
) -> dict[int, tuple[Sample, OrderFit]]:
    """Repeat the fits of all groups with omitted harmonics as further unknowns.

    An omitted harmonic's size is the assumed standard deviation of the coefficients, divided by the
    fitted vibration's size. A few probes in one group do not determine this size. The size used is
    therefore the likeliest in a group and up to 16 neighbours on either side. Groups with wrong
    arrivals, recognised by large residuals, do not count.

    Parameters
    ----------
    sample_fit_by_group : dict of int to (Sample, OrderFit)
        Displacements and fit by group index.

    Returns
    -------
    dict of int to (Sample, OrderFit)
        The same displacements with the new fits.
    """
    costs_and_fits_of_groups = [
        sample.list_refits_by_harmonic_size(
            fit,
            np.minimum(
                np.linalg.norm(fit.coefficients[1:]) * TRIAL_OMITTED_HARMONIC_RATIOS,
                sample.max_trial_deviation_for_accuracy,
            ),
        )
        for sample, fit in sample_fit_by_group.values()
    ]
    cost_by_group_and_size = np.array([costs for costs, _ in costs_and_fits_of_groups])
    residual_square_sums = np.array([fit.sum_of_squares for _, fit in sample_fit_by_group.values()])
    spare_counts = [
        len(sample.displacements) - len(fit.coefficients)
        for sample, fit in sample_fit_by_group.values()
    ]
    freedoms = np.maximum(spare_counts, 1)
    sample_and_refit_by_group = {}
    for sample_position, (group_index, (sample, _)) in enumerate(sample_fit_by_group.items()):
        window_slice = slice(
            max(sample_position - N_NEIGHBOUR_GROUPS_PER_SIDE, 0),
            sample_position + N_NEIGHBOUR_GROUPS_PER_SIDE + 1,
        )
        max_trusted_residual_square_sums = _estimate_quartile_variance(
            residual_square_sums[window_slice], freedoms[window_slice]
        ) * chdtri(freedoms[window_slice], SIGNIFICANCE_LIMITS.misfit_significance_level)
        # Groups above the limit have wrong arrivals.
        trusted_cost_rows = cost_by_group_and_size[window_slice][
            residual_square_sums[window_slice] <= max_trusted_residual_square_sums
        ]
        best_harmonic_size_index = int(np.argmin(trusted_cost_rows.sum(axis=0)))
        _, fits_by_harmonic_size = costs_and_fits_of_groups[sample_position]
        sample_and_refit_by_group[group_index] = (
            sample,
            fits_by_harmonic_size[best_harmonic_size_index],
        )
    return sample_and_refit_by_group


def _estimate_variance_and_freedom(
    residuals: np.ndarray, has_arrival: np.ndarray, freedoms: np.ndarray
) -> tuple[float, int]:
    """Estimate the variance of an arrival from the residuals of groups.

    The variance follows from differences between the residuals of neighbouring groups. Wrong
    arrivals hardly change it. Without two usable neighbours, the variance is the sum of squared
    residuals divided by the degrees of freedom; 1 without degrees of freedom.

    Parameters
    ----------
    residuals, has_arrival : (n, m) [m]
        Residuals in n groups with up to m arrivals, and True for an arrival.
    freedoms : (n,)
        Number of arrivals less number of unknowns in each group.

    Returns
    -------
    variance : float [m^2]
        A measured displacement's variance.
    freedom : int
        Degrees of freedom with which the variance was estimated; 0 without two usable neighbours.
    """
    total_freedom, has_arrival_pair = freedoms.sum(), has_arrival[1:] & has_arrival[:-1]
    freedoms = np.minimum(freedoms[1:], freedoms[:-1])
    is_usable = freedoms > 0
    if not np.any(is_usable):
        return (float((residuals**2).sum()) / total_freedom if total_freedom else 1.0), 0
    residual_difference_square_sums = 0.5 * (
        np.where(has_arrival_pair, np.diff(residuals, axis=0), 0.0) ** 2
    ).sum(axis=1)
    return _estimate_quartile_variance(
        residual_difference_square_sums[is_usable], freedoms[is_usable]
    ), int(freedoms[is_usable].sum()) // 2


def _estimate_quartile_variance(residual_square_sums: np.ndarray, freedoms: np.ndarray) -> float:
    """Estimate an arrival's variance from the groups' sums of squared residuals.

    The lower quartile of the sums is used. The quartile stays right even if nearly three quarters
    contain wrong arrivals. ``residual_square_sums`` (n,) have the degrees of freedom ``freedoms``
    (n,).
    """
    return float(np.quantile(residual_square_sums / chdtri(freedoms, 0.75), 0.25))
