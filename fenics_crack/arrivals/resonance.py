"""Fit a mode and an engine order to the passages through one resonance.

Frequency and damping follow from least squares that begin at the best point of a grid; all passages
through a resonance are fitted together. The order follows from comparing the candidates. For two
neighbours, each order of the first is paired with each order of the second, and both modes are
fitted; the margin of an order is the margin of its best pair. An order is tested by three probes or
more: two probes see only a phase difference, and some order of a mode always comes near to it.
Standard errors are computed as in :mod:`robust`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fenics_crack.arrivals.arrival_times import ArrivalTimes
from fenics_crack.arrivals.fit_frequency import MIN_RELATIVE_PEAK_POWER
from fenics_crack.arrivals.harmonics import TipFit
from fenics_crack.arrivals.robust import SIGNIFICANCE_LIMITS
from fenics_crack.arrivals.transient import (
    DAMPING_RATIO_BOUNDS,
    FITTED_SPEEDS_RELATIVE_HALF_WIDTH,
    ArrivalsWithStiffeningLaw,
    Fit,
    Mode,
    Run,
    compute_poles,
    make_stiffening_function,
)
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import (
    RAD_PER_S_PER_RPM,
    Tabular,
    format_count,
    format_quantity,
    hertz_property,
)

MAX_REFINED_ORDERS = 4
"""Maximum number of orders with refined fits; half as many for each of two neighbours."""
INITIAL_DAMPING_RATIO = 0.004
"""Damping ratio in the scan of speeds and at the start of fits."""
MAX_REFIT_ROUNDS = 5
"""Maximum rounds of refits of neighbours, of pairs of orders, and of weights in a search."""


@keep_old_attribute_names(
    ambiguous="ambiguous_orders",
    apart="relative_frequency_range",
    compared="compute_measured_and_fitted_motion",
    disagree="passages_disagree",
    untested="is_order_untested",
    disagreement="disagreement_in_words",
)
@dataclass(frozen=True, repr=False)
class PassageFit(Tabular):
    """Hold the fit to all passages through one resonance: a mode and an engine order.

    Attributes
    ----------
    order : float
        Periods of the load in a revolution, for the best candidate.
    omega, omega_error : float [rad/s]
        Natural frequency, and its standard error from the scatter of the arrivals alone. For the
        error of the result take :attr:`deviation`, with two further causes. ``frequency_error`` is
        :attr:`deviation` in Hz.
    damping, damping_error : float
        Ratio of critical damping, and its standard error. If the blade's stiffening s is not given
        to the fit, this ratio is 1 / (1 - s) times too large.
    amplitude : float [m]
        Largest vibration amplitude in the passages.
    forces : (passages,) complex [m]
        Load of each passage. The number is the complex vibration amplitude that the blade would
        reach if the rotor stayed at the resonance.
    ends : (passages, 2) int
        First revolution of each passage, and the one after the last, counted from 0.
    omegas, omega_errors : (passages,) [rad/s]
        Natural frequency and error from each passage alone.
    dampings, damping_errors : (passages,)
        Damping ratio and error from each passage alone.
    orders : (n,)
        Candidate orders.
    margins : (n,)
        -2 log likelihood of each candidate order, less the value of the best order. Another
        resonance near in speed is fitted jointly, with the best order for each candidate. Two
        resonances may be the same vibration if one lies within the other's width. The order of the
        other resonance then also has the margin 0.
    probes : int
        Number of probes with arrivals.
    scatter : float [m]
        Standard deviation of a displacement from the fit.
    whiteness : float
        Probability that errors of arrivals and shaft marks alone correlate the residuals of
        successive revolutions as much as measured; nan without a test. Standard errors include the
        correlation. They do not include the bias by another vibration near this speed
        (:attr:`in_doubt`).
    asynchronous : tuple of TipFit
        Vibrations with constant frequency in the record, which follow no order.
    blind : tuple of float [rad]
        Angles of probes left out, since they do not measure the vibration seen by most probes.
    stiffening : float
        s = d ln w_n / d ln W, with natural frequency w_n and speed W.
    """

    order: float
    omega: float
    omega_error: float
    damping: float
    damping_error: float
    amplitude: float
    forces: np.ndarray
    ends: np.ndarray
    omegas: np.ndarray
    omega_errors: np.ndarray
    dampings: np.ndarray
    damping_errors: np.ndarray
    orders: np.ndarray
    margins: np.ndarray
    probes: int
    scatter: float
    whiteness: float
    asynchronous: tuple[TipFit, ...]
    blind: tuple[float, ...]
    stiffening: float

    frequency, frequencies = hertz_property(), hertz_property("omegas")
    frequency_error, frequency_errors = hertz_property("deviation"), hertz_property("omega_errors")

    @property
    def speed(self) -> float:
        """Rotor speed at which the order excites the natural frequency [rad/s]."""
        return self.omega / self.order

    @property
    def margin(self) -> float:
        """Difference in -2 log likelihood between the second best order and the best.

        With a large margin, all other orders are unlikely; inf for a single candidate order.
        """
        return float(np.min(self.margins[self.orders != self.order], initial=np.inf))

    @property
    def is_order_untested(self) -> bool:
        """True with several candidate orders and fewer than three probes.

        Two probes give a single phase difference, and one of several orders nearly always fits.
        The stated frequency then holds only if the order is right.
        """
        return self.probes < 3 and len(self.orders) > 1

    @property
    def ambiguous_orders(self) -> tuple[float, ...]:
        """Further orders that explain the arrivals within three standard deviations.

        The margin (``margins``) is below 9. If the fit is :attr:`is_order_untested`, all further
        candidate orders are returned.
        """
        is_other_equal = (
            (self.margins < SIGNIFICANCE_LIMITS.allowed_cost_difference) | self.is_order_untested
        ) & (self.orders != self.order)
        return tuple(self.orders[is_other_equal].tolist())

    @property
    def relative_frequency_range(self) -> float:
        """Range of the frequencies from single passages, over the frequency of the fit."""
        return float(np.ptp(self.omegas)) / self.omega

    @property
    def passages_disagree(self) -> bool:
        """True if passages differ by over three standard errors in frequency or damping.

        Different amplitudes are no disagreement: the load need not be the same.
        """
        return bool(self.disagreement_in_words)

    @property
    def disagreement_in_words(self) -> str:
        """Text on the values in which passages differ; "" without :attr:`passages_disagree`."""
        difference_texts = []
        if _differ_significantly(self.omegas, self.omega_errors):
            difference_texts.append(
                f"by {self.relative_frequency_range:.2%} in frequency, which the error covers"
            )
        if _differ_significantly(self.dampings, self.damping_errors):
            difference_texts.append(
                f"in damping, {self.dampings.min():.2g} to {self.dampings.max():.2g}"
            )
        return (
            f"passages differ by more than their errors: {', '.join(difference_texts)}"
            if difference_texts
            else ""
        )

    @property
    def in_doubt(self) -> bool:
        """True if residuals are correlated between revolutions, or cannot be tested.

        ``whiteness`` is then below 0.001, or nan. Causes are another vibration near this speed,
        drift, or a nonlinear blade. Frequency, damping and order may be wrong by more than their
        errors.
        """
        return not self.whiteness >= SIGNIFICANCE_LIMITS.misfit_significance_level

    @property
    def deviation(self) -> float:
        """Standard deviation of the natural frequency, the error of this result [rad/s].

        The largest of three values: the standard error ``omega_error``; half the range of
        ``omegas`` if the passages :attr:`passages_disagree`, as for a breathing crack; and half the
        resonance's width, zeta w_n, if the fit is :attr:`in_doubt`. Here zeta is the damping ratio,
        and w_n the natural frequency.
        """
        half_frequency_range = 0.5 * float(np.ptp(self.omegas)) if self.passages_disagree else 0.0
        half_resonance_width = self.damping * self.omega if self.in_doubt else 0.0
        return max(self.omega_error, half_frequency_range, half_resonance_width)

    @property
    def in_words(self) -> str:
        """Text with the frequency, its :attr:`deviation`, the engine order and the speed."""
        frequency_text = f"{self.frequency:.6g} ± {self.frequency_error:.2g} Hz"
        return (
            f"{frequency_text}, engine order {self.order:g} at "
            f"{self.speed / RAD_PER_S_PER_RPM:.6g} rpm"
        )

    def compute_measured_and_fitted_motion(
        self, arrivals: ArrivalTimes
    ) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Return measured and fitted displacements for each passage.

        ``arrivals`` are the fitted record. Probes in ``blind`` are left out: P probes remain.

        Returns
        -------
        list of (speed, measured, fitted)
            For each passage of R revolutions: speeds (R,) [rad/s]; measured displacements (R, P)
            [m] without drift, nan without an arrival; and fitted displacements (R, P) [m].
        """
        arrivals = arrivals.without(np.flatnonzero(np.isin(arrivals.probes, self.blind)))
        mode_pole = complex(compute_poles(self.omega, self.damping / (1.0 - self.stiffening)))
        record = ArrivalsWithStiffeningLaw(arrivals, make_stiffening_function(self.stiffening))
        runs = [
            Run(record, arrivals.displacement, *map(int, begin_and_end_revolution))
            for begin_and_end_revolution in self.ends
        ]
        speed_measured_fitted_triples = []
        for run, complex_force in zip(runs, self.forces, strict=True):
            fitted_motion = (complex_force * run.compute_wave(Mode(self.order, mode_pole))).real
            drift_free_residuals = run.subtract_weighted_drifts(
                run.displacements - fitted_motion, run.has_arrival.astype(float)
            )
            drift_free_displacements = np.where(
                run.has_arrival, drift_free_residuals + fitted_motion, np.nan
            )
            speed_measured_fitted_triples.append(
                (run.revolution_speeds, drift_free_displacements, fitted_motion)
            )
        return speed_measured_fitted_triples

    def to_dict(self) -> dict[str, Any]:
        """Return the fit's numbers by name.

        Most names are attributes. "rpm" is the speed in revolutions per minute, "passages" the
        number of passages.
        """
        number_names = (
            "order",
            "margin",
            "frequency",
            "frequency_error",
            "damping",
            "damping_error",
            "stiffening",
            "amplitude",
        )
        return {
            "speed": self.speed,
            "rpm": self.speed / RAD_PER_S_PER_RPM,
            **{number_name: getattr(self, number_name) for number_name in number_names},
            "passages": len(self.ends),
            "apart": self.relative_frequency_range,
            "whiteness": self.whiteness,
        }

    def _repr_text(self) -> str:
        title_parts = [
            f"order {self.order:g}, {self.speed / RAD_PER_S_PER_RPM:.6g} rpm",
            f"{self.frequency:.6g} ± {self.frequency_error:.2g} Hz",
            f"damping {self.damping:.3g} ± {self.damping_error:.2g}",
            format_quantity(self.amplitude, "m"),
        ]
        if self.is_order_untested:
            title_parts.append(f"order untested by {format_count(self.probes, 'probe')}")
        elif self.ambiguous_orders:
            title_parts.append(
                f"as well: {', '.join(f'{order:g}' for order in self.ambiguous_orders)}"
            )
        title_parts += ["residuals are correlated"] * self.in_doubt
        return ", ".join(title_parts)


def _differ_significantly(values: np.ndarray, errors: np.ndarray) -> bool:
    """Return True if any two values differ by over three standard errors of their difference.

    ``values`` and standard errors ``errors`` are (n,).
    """
    pairwise_differences = np.abs(values[:, None] - values)
    return not np.all(
        pairwise_differences
        <= SIGNIFICANCE_LIMITS.n_standard_errors_of_equal_fits * np.hypot(errors[:, None], errors)
    )


class Resonance:
    """Hold fits of several orders to the passages through a resonance.

    Parameters
    ----------
    runs : sequence of Run
        Passages through the resonance.
    speed : float [rad/s]
        Speed near the resonance.
    orders : (n,)
        Candidate orders.

    Attributes
    ----------
    best_fit : Fit
        Fit for the most likely order.
    margins : dict of float to float
        For each order, -2 log likelihood less the best order's; 0 for the best.
    compared_neighbours : list of Resonance
        Neighbours at the last comparison of orders.
    """

    best_fit: Fit

    def __init__(self, runs: Sequence[Run], speed: float, orders: np.ndarray) -> None:
        self.compared_neighbours: list[Resonance] = []
        self.compare_orders(runs, speed, orders)

    def compare_orders(self, runs: Sequence[Run], speed: float, orders: np.ndarray) -> None:
        """Fit each order to the passages near a speed [rad/s], and keep the best.

        ``orders`` (n,) are the candidates. Sets the attributes ``best_fit`` and ``margins``.
        """
        self._runs = runs
        weights_of_runs = [run.has_arrival.astype(float) for run in runs]
        fit_by_mode: dict[Mode, Fit] = {}
        # The first round has no weights, and single wrong arrivals may hide the order. Further
        # rounds have the weights of the best fit, until the same order is best again.
        for is_last_round in (False, False, True):
            gain_mode_pairs = _list_best_gains_and_modes(
                zip(runs, weights_of_runs, strict=True), orders, speed, INITIAL_DAMPING_RATIO
            )
            gain_mode_pairs.sort(key=lambda gain_mode_pair: -gain_mode_pair[0])
            is_last_round = is_last_round or (
                len(fit_by_mode) > 0
                and gain_mode_pairs[0][1].order == self.best_fit.first_mode.order
            )
            for gain, mode in gain_mode_pairs[: MAX_REFINED_ORDERS if is_last_round else 1]:
                if (
                    gain > MIN_RELATIVE_PEAK_POWER * gain_mode_pairs[0][0]
                    and mode not in fit_by_mode
                ):
                    fit_by_mode[mode] = Fit(runs, [mode], weights_of_runs)
            self.best_fit = min(fit_by_mode.values(), key=lambda fit: fit.noise_model.cost)
            if is_last_round:
                break
            weights_of_runs = self.best_fit.weights
        gain_by_order = {mode.order: gain for gain, mode in gain_mode_pairs}
        self.margins = _compute_margin_by_order(gain_by_order, fit_by_mode.values(), self.best_fit)

    @property
    def is_clear(self) -> bool:
        """True if the resonance is passed, significant, and has a plausible damping ratio.

        It is passed if a run has speeds on both sides, and significant if -2 log likelihood falls
        by more than 60. The damping ratio must exceed three of its standard errors: otherwise a
        vibration with constant frequency may explain the peak. The ratio must be below 0.00875:
        otherwise slow drift may explain it.
        """
        fit = self.best_fit
        is_speed_crossed = any(
            run.revolution_speeds.min() < self.speed < run.revolution_speeds.max()
            for run in self._runs
        )
        if not (
            is_speed_crossed
            and fit.likelihood_gain > SIGNIFICANCE_LIMITS.min_resonance_likelihood_gain
        ):
            return False
        return (
            SIGNIFICANCE_LIMITS.n_standard_errors_of_equal_fits
            * float(fit.omega_and_damping_errors[1])
            < fit.first_mode.damping_ratio
            < 0.5 * DAMPING_RATIO_BOUNDS[1]
        )

    @property
    def speed(self) -> float:
        """Rotor speed at which the order excites the natural frequency [rad/s]."""
        return self.best_fit.first_mode.speed

    def is_near(
        self,
        other_resonance: Resonance,
        allowed_relative_distance: float = 2.0 * FITTED_SPEEDS_RELATIVE_HALF_WIDTH,
    ) -> bool:
        """Return True if another resonance is near in speed.

        ``allowed_relative_distance`` is the maximum difference in speed, relative to the speed of
        this resonance. The default is 7 %, twice the half width of fitted speeds.
        """
        return (
            other_resonance is not self
            and abs(other_resonance.speed / self.speed - 1.0) < allowed_relative_distance
        )

    def list_neighbours(self, resonances: Sequence[Resonance]) -> list[Resonance]:
        """Return the other resonances within 7 % in speed: their fitted speeds overlap."""
        return [resonance for resonance in resonances if self.is_near(resonance)]

    def has_within_width(self, other_resonance: Resonance) -> bool:
        """Return True if another resonance is within this resonance's width.

        The speeds then differ by less than twice the damping ratio, relative to this resonance's
        speed.
        """
        return self.is_near(other_resonance, 2.0 * self.best_fit.first_mode.damping_ratio)

    def may_be_residual_of(self, other_resonance: Resonance) -> bool:
        """Return True if this may be the residual of another, larger resonance.

        The other resonance then has the same order and a larger amplitude, and this resonance is
        within the other's width.
        """
        other_resonance_fit, own_fit = other_resonance.best_fit, self.best_fit
        return (
            other_resonance.has_within_width(self)
            and other_resonance_fit.first_mode.order == own_fit.first_mode.order
            and other_resonance_fit.largest_first_mode_amplitude
            > own_fit.largest_first_mode_amplitude
        )

    def refit_and_test_clarity(
        self,
        record: ArrivalsWithStiffeningLaw,
        displacements: np.ndarray,
        initial_mode: Mode | None = None,
    ) -> bool:
        """Refit the mode to displacements (revolutions, probes) [m], and test the result.

        The fit begins at ``initial_mode``, by default the best fit's mode. Returns :attr:`is_clear`
        after the fit; False without a fit if no run passes the speed.
        """
        runs = record.find_runs(displacements, self.speed)
        if not runs:
            return False
        self.best_fit = Fit(
            runs, [initial_mode or self.best_fit.first_mode], self._make_initial_weights(runs)
        )
        self._runs = runs
        return self.is_clear

    def _make_initial_weights(self, runs: Sequence[Run]) -> list[np.ndarray]:
        """Return the arrivals' weights at the start of a fit: (R, P) for each run.

        A run has R revolutions and P probes. If the runs have the same arrivals as the best fit,
        the fit's weights are returned. Otherwise the weights are 1, and 0 without an arrival.
        """
        if [run.has_arrival.tobytes() for run in runs] == [
            run.has_arrival.tobytes() for run in self._runs
        ]:
            return self.best_fit.weights
        return [run.has_arrival.astype(float) for run in runs]

    def compare_order_pairs_with(
        self,
        neighbour: Resonance,
        record: ArrivalsWithStiffeningLaw,
        displacements: np.ndarray,
        orders: np.ndarray,
    ) -> None:
        """Fit this resonance and a neighbour jointly with pairs of orders, and keep the best.

        Both resonances get new attributes ``best_fit`` and ``margins``.

        Parameters
        ----------
        neighbour : Resonance
            Resonance near in speed.
        record, displacements : ArrivalsWithStiffeningLaw, (revolutions, probes) [m]
            Record, and displacements with the motion of both resonances, but no further one.
        orders : (n,)
            Candidate orders of both resonances.
        """
        resonance_pair = self, neighbour
        runs = record.find_runs(displacements, self.speed)
        weights_of_runs = [run.has_arrival.astype(float) for run in runs]
        best_fit = Fit(
            runs,
            [pair_member.best_fit.first_mode for pair_member in resonance_pair],
            weights_of_runs,
        )
        modes_of_pair_members: list[list[Mode]] = []
        for pair_member, partner_resonance in (resonance_pair, resonance_pair[::-1]):
            displacements_without_partner = (
                displacements - partner_resonance.best_fit.displacements_by_mode[0]
            )
            run_weight_pairs = zip(
                record.find_runs(displacements_without_partner, self.speed),
                best_fit.weights,
                strict=True,
            )
            mode = pair_member.best_fit.first_mode
            gain_mode_pairs = _list_best_gains_and_modes(
                run_weight_pairs, orders, pair_member.speed, mode.damping_ratio
            )
            modes_of_pair_members.append(
                [
                    mode if grid_mode.order == mode.order else grid_mode
                    for _, grid_mode in gain_mode_pairs
                ]
            )
        fit_by_modes = {best_fit.modes: best_fit}
        for _ in range(MAX_REFIT_ROUNDS):
            weights_of_runs, best_fit_of_previous_round = best_fit.weights, best_fit
            pair_gains = _compute_squares_reductions_by_pairs(
                runs, modes_of_pair_members, weights_of_runs
            )
            for index_pair in _choose_order_index_pairs(pair_gains):
                modes = (
                    modes_of_pair_members[0][index_pair[0]],
                    modes_of_pair_members[1][index_pair[1]],
                )
                if modes not in fit_by_modes:
                    fit_by_modes[modes] = Fit(runs, modes, weights_of_runs)
            best_fit = min(fit_by_modes.values(), key=lambda fit: fit.noise_model.cost)
            if best_fit is best_fit_of_previous_round:
                break
        for index_in_resonance_pair, pair_member in enumerate(resonance_pair):
            max_gain_by_order = dict(
                zip(
                    orders.tolist(),
                    pair_gains.max(axis=1 - index_in_resonance_pair).tolist(),
                    strict=True,
                )
            )
            pair_member.margins = _compute_margin_by_order(
                max_gain_by_order, fit_by_modes.values(), best_fit, index_in_resonance_pair
            )
            displacements_without_partner = (
                displacements - best_fit.displacements_by_mode[1 - index_in_resonance_pair]
            )
            pair_member.refit_and_test_clarity(
                record, displacements_without_partner, best_fit.modes[index_in_resonance_pair]
            )

    def to_passage_fit(
        self,
        record: ArrivalsWithStiffeningLaw,
        residuals: np.ndarray,
        resonances: Sequence[Resonance] = (),
        line_fits: tuple[TipFit, ...] = (),
    ) -> PassageFit:
        """Return the resonance as a public result, with a fit for each run through it.

        A run is a passage through the resonance. Resonances within 3.5 % in speed are fitted
        jointly, so that errors include their uncertainty.

        Parameters
        ----------
        record : ArrivalsWithStiffeningLaw
            Arrivals, and the stiffening of modes.
        residuals : (revolutions, probes) [m]
            Displacements without the motion of ``resonances``.
        resonances : sequence of Resonance
            All resonances of the record.
        line_fits : tuple of TipFit
            Vibrations with constant frequency, stored in the result.
        """
        neighbours = [
            other_resonance
            for other_resonance in resonances
            if self.is_near(other_resonance, FITTED_SPEEDS_RELATIVE_HALF_WIDTH)
        ]
        best_fit, runs = self.best_fit, self._runs
        modes = [
            jointly_fitted_resonance.best_fit.first_mode
            for jointly_fitted_resonance in (self, *neighbours)
        ]
        if neighbours:
            resonance_motions = [
                jointly_fitted_resonance.best_fit.displacements_by_mode[0]
                for jointly_fitted_resonance in (self, *neighbours)
            ]
            runs = record.find_runs(residuals + sum(resonance_motions), self.speed)
            best_fit = Fit(runs, modes, self._make_initial_weights(runs))
        mode = best_fit.first_mode
        stiffening = record.stiffening(self.speed, best_fit.first_mode.omega)
        run_weight_pairs = list(zip(runs, best_fit.weights, strict=True))
        single_run_fits = (
            [Fit([run], best_fit.modes, [run_weights]) for run, run_weights in run_weight_pairs]
            if len(runs) > 1
            else [best_fit]
        )
        # Resonances within the width of each other may be the same vibration with other orders.
        rival_resonances = [
            other_resonance
            for other_resonance in resonances
            if self.has_within_width(other_resonance) or other_resonance.has_within_width(self)
        ]
        margin_by_order = self.margins | {
            rival_resonance.best_fit.first_mode.order: 0.0 for rival_resonance in rival_resonances
        }
        omega_and_damping_errors = best_fit.omega_and_damping_errors
        compared_orders = np.array(sorted(margin_by_order))
        return PassageFit(
            order=mode.order,
            omega=mode.omega,
            omega_error=float(omega_and_damping_errors[0]),
            damping=(1.0 - stiffening) * mode.damping_ratio,
            damping_error=(1.0 - stiffening) * float(omega_and_damping_errors[1]),
            amplitude=best_fit.largest_first_mode_amplitude,
            forces=best_fit.forces[0],
            ends=np.array([(run.begin_revolution, run.end_revolution) for run in runs]),
            omegas=np.array([fit.first_mode.omega for fit in single_run_fits]),
            omega_errors=np.array([fit.omega_and_damping_errors[0] for fit in single_run_fits]),
            dampings=(1.0 - stiffening)
            * np.array([fit.first_mode.damping_ratio for fit in single_run_fits]),
            damping_errors=(1.0 - stiffening)
            * np.array([fit.omega_and_damping_errors[1] for fit in single_run_fits]),
            orders=compared_orders,
            margins=np.array(
                [margin_by_order[compared_order] for compared_order in compared_orders]
            ),
            probes=max(run.n_probes for run in runs),
            scatter=float(np.sqrt(best_fit.noise_model.equivalent_normal_variance)),
            whiteness=best_fit.whiteness_p_value,
            asynchronous=line_fits,
            blind=(),
            stiffening=stiffening,
        )


def _list_best_gains_and_modes(
    run_weight_pairs: Iterable[tuple[Run, np.ndarray]],
    orders: np.ndarray,
    speed: float,
    damping_ratio: float,
) -> list[tuple[float, Mode]]:
    """Find the best mode for each order on a grid of frequencies.

    For each order, the grid has 11 frequencies around the order times the speed. The relative
    spacing is half the damping ratio.

    Parameters
    ----------
    run_weight_pairs : iterable of (Run, (R, P))
        Passages, and weights of the arrivals, for R revolutions and P probes.
    orders, speed, damping_ratio : (n,), float [rad/s], float
        Candidate orders, speed of the resonance, and damping ratio of all modes.

    Returns
    -------
    list of (float, Mode)
        Reduction in the weighted sum of squares [m^2], and the mode, for each order.
    """
    omega_rows = orders[:, None] * speed * (1.0 + damping_ratio * np.linspace(-2.5, 2.5, 11))
    trial_poles_by_order = compute_poles(omega_rows, damping_ratio)
    gains = sum(
        run.compute_squares_reductions(orders, trial_poles_by_order, weights)
        for run, weights in run_weight_pairs
    )
    best_pole_indices, all_order_indices = np.argmax(gains, axis=1), np.arange(len(orders))
    best_modes = map(
        Mode, orders.tolist(), trial_poles_by_order[all_order_indices, best_pole_indices].tolist()
    )
    return list(
        zip(
            np.asarray(gains)[all_order_indices, best_pole_indices].tolist(),
            best_modes,
            strict=True,
        )
    )


def _compute_squares_reductions_by_pairs(
    runs: Sequence[Run],
    modes_of_pair_members: Sequence[Sequence[Mode]],
    weights_of_runs: Sequence[np.ndarray],
) -> np.ndarray:
    """Return reductions in the sum of squared residuals by pairs of modes: (n, m) [m^2].

    Both modes of a pair are fitted jointly to all runs.

    Parameters
    ----------
    runs : sequence of Run
        Passages, each with R revolutions and P probes.
    modes_of_pair_members : pair of lists
        n modes for the first of a pair, and m modes for the second.
    weights_of_runs : sequence of (R, P)
        Arrival weights in each run.
    """
    n_first_modes, all_modes = (
        len(modes_of_pair_members[0]),
        [mode for modes in modes_of_pair_members for mode in modes],
    )
    first_indices, second_indices = np.indices((n_first_modes, len(all_modes) - n_first_modes))
    pair_column_indices = np.stack(
        [
            2 * first_indices,
            2 * first_indices + 1,
            2 * (n_first_modes + second_indices),
            2 * (n_first_modes + second_indices) + 1,
        ],
        -1,
    )
    reductions_summed_over_runs = np.zeros(first_indices.shape)
    for run, run_weights in zip(runs, weights_of_runs, strict=True):
        waves_and_displacements = np.array([*map(run.compute_wave, all_modes), run.displacements])
        *real_and_imaginary_waves, weighted_displacements = run.subtract_weighted_drifts(
            waves_and_displacements, run_weights
        )
        real_and_imaginary_waves = np.stack(
            [np.real(real_and_imaginary_waves), -np.imag(real_and_imaginary_waves)], axis=1
        )[..., run.has_arrival]
        wave_columns = real_and_imaginary_waves.reshape(2 * len(all_modes), -1)
        gram_matrix = wave_columns @ wave_columns.T
        projections = wave_columns @ weighted_displacements[run.has_arrival].real
        pair_inverses = np.linalg.pinv(
            gram_matrix[pair_column_indices[..., :, None], pair_column_indices[..., None, :]],
            hermitian=True,
        )
        reductions_summed_over_runs += np.einsum(
            "nmi,nmij,nmj->nm",
            projections[pair_column_indices],
            pair_inverses,
            projections[pair_column_indices],
        )
    return reductions_summed_over_runs


def _choose_order_index_pairs(squares_reductions: np.ndarray) -> set[tuple[int, int]]:
    """Choose pairs of modes for refined fits, as index pairs.

    ``squares_reductions`` (n, m) [m^2] has the reduction by each pair of n first and m second
    modes. The best two first modes and the best two second modes are chosen, each with its best
    partner. Pairs with less than half the largest reduction are left out.
    """
    best_first_mode_indices, best_second_mode_indices = (
        np.argsort(-squares_reductions.max(axis=1 - axis))[: MAX_REFINED_ORDERS // 2]
        for axis in (0, 1)
    )
    index_pairs = [
        (first_mode_index, squares_reductions[first_mode_index].argmax())
        for first_mode_index in best_first_mode_indices
    ]
    index_pairs += [
        (squares_reductions[:, second_mode_index].argmax(), second_mode_index)
        for second_mode_index in best_second_mode_indices
    ]
    return {
        (int(paired_first_mode_index), int(paired_second_mode_index))
        for paired_first_mode_index, paired_second_mode_index in index_pairs
        if squares_reductions[paired_first_mode_index, paired_second_mode_index]
        > MIN_RELATIVE_PEAK_POWER * squares_reductions.max()
    }


def _compute_margin_by_order(
    gain_by_order: Mapping[float, float], fits: Iterable[Fit], best_fit: Fit, mode_index: int = 0
) -> dict[float, float]:
    """Return -2 log likelihood of each order, less the value of the best fit.

    A refined fit gives the value. For orders without a refined fit, an estimate follows from the
    reduction of squares, divided by the variance of the noise.

    Parameters
    ----------
    gain_by_order : dict of float to float
        Reduction in the weighted sum of squared residuals [m^2] for each order.
    fits : iterable of Fit
        Refined fits. If an order has several, the best one gives the value.
    best_fit : Fit
        Best fit; the order in this fit has the value 0.
    mode_index : int
        Index of the compared mode among the jointly fitted modes.
    """
    max_gain = max(gain_by_order.values())
    margin_by_order = {
        order: (max_gain - gain) / best_fit.noise_model.scale**2
        for order, gain in gain_by_order.items()
    }
    for fit in sorted(fits, key=lambda fit: -fit.noise_model.cost):
        margin_by_order[fit.modes[mode_index].order] = (
            fit.noise_model.cost - best_fit.noise_model.cost
        )
    return margin_by_order
