"""Result of an identification: unknowns with intervals, the verdict, and its reasons in words."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.basics.atomic_files import write_file_whole
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import Table, Tabular, format_count
from fenics_crack.files.store import IDENTIFICATION_FILE_KIND, write_result_file
from fenics_crack.monitoring.identification.measurements import Measurement, Measurements
from fenics_crack.monitoring.identification.nuisance import CRACK_SIZE_KEYS
from fenics_crack.monitoring.identification.options import IDENTIFICATION_VALUES
from fenics_crack.monitoring.identification.posterior import Posterior, PosteriorForTextValues
from fenics_crack.monitoring.identification.worth import (
    Worth,
    list_advice_texts,
    rank_measurements_by_information,
)
from fenics_crack.scene.keys import unit_of_key
from fenics_crack.scene.result_tables import Identify
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.words import key_in_words, value_in_words

MEASUREMENT_FIT_COLUMN_NAMES = (
    "measurement",
    "value",
    "deviation",
    "predicted",
    "of the model",
    "residual",
)
"""Columns of the table that compares measurements with predictions.

"of the model" is the standard deviation of a prediction.
"""


NO_CRACK_VERDICT = "no crack"
"""Verdict that the plate has no crack."""


@keep_old_attribute_names(misfit="misfit_chi_square_and_p_value", plain="posterior_without_crack")
@dataclass(frozen=True, repr=False)
class Identification(Tabular):
    """Result of :func:`identify`: unknowns with intervals, and whether there is a crack.

    Attributes
    ----------
    scene : Scene
        Scene with its table ``[identify]``.
    measurements : Measurements
        Measurements that the forward model predicts; others are left out.
    posterior : Posterior
        Posterior of the unknowns, on a grid.
    posterior_without_crack : Posterior, optional
        Posterior for the plate without its crack; None if the crack cannot be removed.
    remarks : tuple of str
        Limits of these measurements.
    doubts : tuple of str
        Failed cases of the forward model, and measurements left out for that reason.
    """

    scene: Scene
    measurements: Measurements
    posterior: Posterior
    posterior_without_crack: Posterior | None
    remarks: tuple[str, ...]
    doubts: tuple[str, ...]

    @property
    def unknown(self) -> tuple[str, ...]:
        """Return the keys of the unknowns with numbers, such as "crack.length"."""
        return self._branch_and_unknowns_of_estimate[0].likelihood.predictor.model.unknown_keys

    @property
    def priors(self) -> dict[str, float]:
        """Return prior standard deviations and confidence levels by key of ``[identify]``."""
        return self._identify_table.inference_setting_by_key

    @property
    def _identify_table(self) -> Identify:
        """Return the table ``[identify]``, with the default of temperature_deviation filled in."""
        return next(
            iter(self.posterior.posterior_by_text_values.values())
        ).likelihood.predictor.model.uncracked_plate.identify_table

    @cached_property
    def _region_parts(self) -> list[tuple[str, np.ndarray, float]]:
        """Return separate parts of the credible region, most probable first.

        Each part has text values (as "left" for crack.edge), the middle (d,) of the unknowns with
        numbers, and the probability. Parts with a probability below 0.03
        (:attr:`Options.min_part_probability`) are left out.
        """
        return self.posterior.find_region_parts(
            self._identify_table.confidence, IDENTIFICATION_VALUES.min_part_probability
        )

    @cached_property
    def _branch_and_unknowns_of_estimate(self) -> tuple[PosteriorForTextValues, np.ndarray]:
        """Return the posterior branch with the estimate, and the estimate (d,).

        A branch is the posterior for one choice of text values, as "left" for crack.edge. The
        estimate is the middle of the most probable part of the credible region. If all parts have a
        probability below 0.03, the estimate is the maximum of the likelihood.
        """
        words_text, x = (
            self._region_parts[0][:2]
            if self._region_parts
            else self.posterior.best_words_and_unknowns
        )
        return self.posterior.posterior_by_text_values[words_text], x

    @property
    def estimate(self) -> dict[str, Any]:
        """Return the estimate of all unknowns by key.

        Numbers are the mean over the most probable part of the credible region. Text values, as
        "left" for crack.edge, are those of this part.
        """
        branch, x = self._branch_and_unknowns_of_estimate
        return branch.get_unknown_values_by_key(x)

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """Return lower and upper end of each unknown's credible interval, by key.

        Unknowns with text values, as "left" for crack.edge, have no interval. The interval contains
        the unknown with the probability ``identify.confidence``.
        """
        return {
            key: self.posterior.compute_interval(unknown_index, self._identify_table.confidence)
            for unknown_index, key in enumerate(self.unknown)
        }

    @property
    def log_bayes_factor(self) -> float:
        """Return ln(evidence with a crack / evidence without a crack).

        nan if the crack cannot be removed from the scene.
        """
        if self.posterior_without_crack is None:
            return math.nan
        return self.posterior.log_evidence - self.posterior_without_crack.log_evidence

    @property
    def verdict(self) -> str:
        """Return the verdict: "crack", "no crack" or "undecided".

        The verdict "crack" needs a :attr:`log_bayes_factor` above ``identify.log_bayes_factor``;
        "no crack" needs it below the negative value. Misfits can also leave the verdict undecided;
        :attr:`reason` explains it.
        """
        return self._verdict_and_reason[0]

    @property
    def conclusion(self) -> str:
        """Return the verdict with its limit, as text.

        The verdict "no crack" is followed by crack sizes, the upper ends of :attr:`intervals`. A
        smaller crack may exist all the same.
        """
        if self.verdict != NO_CRACK_VERDICT:
            return self.verdict
        size_texts = [
            f"{value_in_words(key, upper_end)} of {key_in_words(key)}"
            for key, (_, upper_end) in self.intervals.items()
            if key in CRACK_SIZE_KEYS
        ]
        above_text = f" above {' or '.join(size_texts)}" if size_texts else " of the scene's size"
        return self.verdict + above_text

    @property
    def reason(self) -> str:
        """Return the reason for the verdict, as text."""
        return self._verdict_and_reason[1]

    @cached_property
    def _verdict_and_reason(self) -> tuple[str, str]:
        """Return the verdict, and the reason for it, as texts.

        Both follow from the p-values with and without a crack, the log Bayes factor, and the
        intervals.
        """
        undecided_verdict, inference_setting_by_key = "undecided", self.priors
        if self.posterior_without_crack is None:
            return (
                undecided_verdict,
                "there is no plate without a crack to compare with; name its mesh file in "
                "identify.uncracked",
            )
        required_p_value = 1.0 - inference_setting_by_key["confidence"]
        is_plate_possible = (
            self.posterior_without_crack.misfit_chi_square_and_p_value[1] >= required_p_value
        )
        log_bayes_factor = self.log_bayes_factor
        is_crack_favoured = log_bayes_factor > inference_setting_by_key["log_bayes_factor"]
        bayes_factor_text = f"the log Bayes factor of crack over no crack is {log_bayes_factor:.3g}"
        if self.misfit_chi_square_and_p_value[1] < required_p_value and not is_plate_possible:
            reason_text = (
                "neither a crack of this kind nor a plate without one explains the measurements"
            )
            possible_causes_text = (
                "possible causes are two cracks, a crack of another kind or place, and a wrong "
                "measurement"
            )
            return undecided_verdict, f"{reason_text}; {possible_causes_text} ({bayes_factor_text})"
        plate_condition_text = _describe_unchanged_plate_condition_or_empty(self)
        if is_crack_favoured and is_plate_possible:
            reason_text = (
                "a plate without a crack, changed within the priors, explains the measurements, too"
            )
            return undecided_verdict, f"{reason_text} ({bayes_factor_text}){plate_condition_text}"
        if log_bayes_factor < -inference_setting_by_key["log_bayes_factor"]:
            unseen_crack_text = (
                f"{bayes_factor_text}; an undetected crack would have {_describe_intervals(self)}"
            )
            return NO_CRACK_VERDICT, unseen_crack_text + plate_condition_text
        conditions_text = _describe_single_crack_condition_or_empty(self) + plate_condition_text
        if is_crack_favoured:
            warming_text = _describe_warming_condition_or_empty(self)
            return "crack", f"{bayes_factor_text}{warming_text}{conditions_text}"
        return (
            undecided_verdict,
            f"{bayes_factor_text}, within ±{inference_setting_by_key['log_bayes_factor']:.3g}, "
            "which decides "
            f"nothing: measure more; if there is a crack, it has {_describe_intervals(self)}"
            f"{conditions_text}",
        )

    @property
    def misfit_chi_square_and_p_value(self) -> tuple[float, float]:
        """Return (chi^2, p-value) at the maximum of the likelihood.

        The degrees of freedom are the number of measurements less the number of unknowns. Each load
        frequency and point with displacements subtracts 3 more. The minimum is 1.
        """
        return self.posterior.misfit_chi_square_and_p_value

    @property
    def advice(self) -> list[str]:
        """Return advice on the next measurements, as sentences.

        If the plate's natural frequencies before the crack are missing, the first advice is to give
        them. Another advice names the most informative further measurement.
        """
        branch, x = self._branch_and_unknowns_of_estimate
        return list_advice_texts(branch.likelihood, x, self.where_to_measure())

    @property
    def alternatives(self) -> list[tuple[dict[str, Any], float]]:
        """Return separate cracks that explain the measurements, with probabilities.

        Each crack is a dict of the unknowns' values by key; the most probable crack comes first. If
        there are several cracks, the measurements cannot distinguish them.
        """
        posterior_by_text_values = self.posterior.posterior_by_text_values
        return [
            (
                posterior_by_text_values[words_text].get_unknown_values_by_key(part_middle),
                part_probability,
            )
            for words_text, part_middle, part_probability in self._region_parts
        ]

    def contains(self, values: Mapping[str, Any], share: float | None = None) -> bool:
        """Return True if given values of the unknowns lie in the credible region.

        Parameters
        ----------
        values : mapping of str to number or str
            Values of all unknowns by key.
        share : float, optional
            Probability of the credible region; default: ``identify.confidence``.

        Raises
        ------
        InputError
            An unknown is missing.
        """
        for branch in self.posterior.posterior_by_text_values.values():
            model = branch.likelihood.predictor.model
            missing_keys = [
                key
                for key in (*model.unknown_keys, *model.text_value_by_unknown_key)
                if key not in values
            ]
            if missing_keys:
                raise InputError(
                    "values", dict(values), f"given with {', '.join(missing_keys)}, too"
                )
            if all(
                values[key] == text_value
                for key, text_value in model.text_value_by_unknown_key.items()
            ):
                x = np.array([float(values[key]) for key in model.unknown_keys])
                return branch.interpolate_log_likelihood(
                    x
                ) >= self.posterior.find_region_border_log_likelihood(
                    share or self._identify_table.confidence
                )
        return False

    def where_to_measure(
        self,
        measurements: Sequence[Measurement] | None = None,
        *,
        frequency_deviation: float = IDENTIFICATION_VALUES.relative_frequency_deviation_in_advice,
        harmonic_deviation: float = 0.05,
    ) -> Worth:
        """Rank candidates for one more measurement by the information that each adds.

        The information is the Fisher information about the unknowns, at the estimate.

        Parameters
        ----------
        measurements : sequence of Measurement, optional
            Candidates; their values do not matter. Default: natural frequencies, ratios of
            harmonics at all load frequencies and points of the forward model, and displacements at
            24 phases if displacements were measured.
        frequency_deviation : float
            Relative standard deviation of natural frequencies among the default candidates.
        harmonic_deviation : float
            Relative standard deviation of ratios of harmonics among the default candidates.

        Raises
        ------
        InputError
            A measurement does not fit the forward model, or a standard deviation is not > 0.
        """
        branch, x = self._branch_and_unknowns_of_estimate
        return rank_measurements_by_information(
            branch.likelihood, x, measurements, (frequency_deviation, harmonic_deviation)
        )

    def save(self, folder: str | Path) -> None:
        """Write ``identify.json`` and ``identify.h5`` to a folder, on this rank alone.

        Both have the :meth:`summary`; the second has the scene and the posterior, too.

        Raises
        ------
        InputError
            A file cannot be written.
        """
        data_by_name: dict[str, Any] = {"log_bayes_factor": self.log_bayes_factor}
        for branch_number, (words_text, branch) in enumerate(
            self.posterior.posterior_by_text_values.items()
        ):
            data_by_name[f"words_{branch_number}"] = words_text
            data_by_name[f"log_likelihood_{branch_number}"] = branch.grid_log_likelihood
            data_by_name[f"probability_{branch_number}"] = (
                self.posterior.grid_probabilities_by_words[words_text]
            )
            for unknown_key, axis_values in zip(self.unknown, branch.axes, strict=True):
                data_by_name[f"{unknown_key}_{branch_number}"] = axis_values
        summary_text = json.dumps(self.summary(), indent=1, ensure_ascii=False)
        data_by_name["summary"] = summary_text
        write_result_file(
            data_by_name, Path(folder) / "identify.h5", IDENTIFICATION_FILE_KIND, self.scene
        )
        write_file_whole(Path(folder) / "identify.json", summary_text + "\n")

    # --- shown ------------------------------------------------------------------------------------

    def summary(self) -> dict[str, Any]:
        """Return the whole result in words and numbers by key, as in ``identify.json``."""
        log_bayes_factor = self.log_bayes_factor
        chi_square, p_value = self.misfit_chi_square_and_p_value
        return {
            "verdict": self.verdict,
            "conclusion": self.conclusion,
            "reason": self.reason,
            "log_bayes_factor": None if np.isnan(log_bayes_factor) else log_bayes_factor,
            "estimate": self.estimate,
            "priors": self.priors,
            "intervals": {
                key: list(interval_ends) for key, interval_ends in self.intervals.items()
            },
            "alternatives": [
                {"values": value_by_key, "probability": part_probability}
                for value_by_key, part_probability in self.alternatives
            ],
            "chi_square": chi_square,
            "probability_of_misfit": p_value,
            "remarks": list(self.remarks),
            "warnings": self.warnings,
            "advice": self.advice,
            "measurements": self.fit_table().rows,
        }

    def to_dict(self) -> dict[str, Any]:
        """Return columns by name, with a row for every unknown with numbers."""
        estimate_by_key, interval_by_key = self.estimate, self.intervals
        return {
            "unknown": list(self.unknown),
            "estimate": [estimate_by_key[key] for key in self.unknown],
            "deviation": [
                self.posterior.compute_deviation(unknown_index)
                for unknown_index in range(len(self.unknown))
            ],
            "low": [interval_by_key[key][0] for key in self.unknown],
            "high": [interval_by_key[key][1] for key in self.unknown],
            "unit": [unit_of_key(key) for key in self.unknown],
        }

    def fit_table(self) -> Table:
        """Return a table of measurements with their predictions at the estimate.

        Columns are ``MEASUREMENT_FIT_COLUMN_NAMES``. A residual is (measured - predicted) over
        the standard deviation of this difference.
        """
        branch, x = self._branch_and_unknowns_of_estimate
        likelihood = branch.likelihood
        prediction = likelihood.predict_for_likeliest_face_state(x)
        prediction_deviations = np.where(
            prediction.is_predictable, np.sqrt(np.diag(prediction.covariance[0])), np.inf
        )
        residuals = (likelihood.measurement_values - prediction.values[0]) / np.hypot(
            likelihood.measurement_deviations, prediction_deviations
        )
        number_rows = np.column_stack(
            [
                likelihood.measurement_values,
                likelihood.measurement_deviations,
                prediction.values[0],
                prediction_deviations,
                residuals,
            ]
        ).tolist()
        table_rows = [
            [measurement.name, *numbers]
            for measurement, numbers in zip(likelihood.predictor.rows, number_rows, strict=True)
        ]
        return Table(MEASUREMENT_FIT_COLUMN_NAMES, table_rows)

    @property
    def warnings(self) -> list[str]:
        """Return warnings about the result, as sentences.

        Warnings are about failed cases, tiny standard deviations, several possible cracks, and the
        fit of the measurements. The last warnings are about unknowns that may lie outside the
        bounds of the search. With the verdict "no crack", only the first two kinds are returned.
        """
        warning_texts = [*self.doubts, *_list_implausible_deviation_warnings(self.measurements)]
        alternatives = self.alternatives
        if self.verdict == NO_CRACK_VERDICT:
            return warning_texts
        if len(alternatives) > 1:
            possible_crack_texts = [
                " and ".join(
                    f"{key_in_words(unknown_key)} {value_in_words(unknown_key, unknown_value)}"
                    for unknown_key, unknown_value in value_by_key.items()
                )
                + f" ({part_probability:.0%})"
                for value_by_key, part_probability in alternatives
            ]
            warning_texts.append(
                f"these cracks cannot be distinguished: {'; '.join(possible_crack_texts)}; "
                "where_to_measure "
                "lists measurements that help most"
            )
        warning_texts += _list_misfit_warnings(self)
        for unknown_index, side_text, bound_value in self.posterior.iterate_reached_bounds(
            self._identify_table.confidence
        ):
            unknown_key = self.unknown[unknown_index]
            bound_text = f"{side_text} {value_in_words(unknown_key, bound_value)}"
            warning_texts.append(
                f"{key_in_words(unknown_key)} may be {bound_text}, outside the bounds of the "
                "search: give wider bounds in identify.unknown"
            )
        return warning_texts

    def _repr_text(self) -> str:
        title_parts = [self.conclusion]
        if not np.isnan(self.log_bayes_factor):
            title_parts[0] += f" (log Bayes factor {self.log_bayes_factor:.3g})"
        if self.verdict == NO_CRACK_VERDICT:
            return title_parts[0]
        for unknown_index, unknown_key in enumerate(self.unknown):
            estimate_text = value_in_words(unknown_key, self.estimate[unknown_key])
            deviation_text = value_in_words(
                unknown_key, self.posterior.compute_deviation(unknown_index)
            )
            title_parts.append(f"{unknown_key} = {estimate_text} ± {deviation_text}")
        if len(self.alternatives) > 1:
            title_parts.append("NOT THE ONLY ONE")
        if _describe_single_crack_condition_or_empty(self):
            title_parts.append("IF IT IS ONE CRACK")
        if self.verdict == "crack" and _describe_unchanged_plate_condition_or_empty(self):
            title_parts.append("IF ITS CLAMP HOLDS AS BEFORE")
        return ", ".join(title_parts)


def _list_implausible_deviation_warnings(measurements: Measurements) -> list[str]:
    """Return a warning about a natural frequency with a tiny standard deviation.

    The list has one sentence, for the first natural frequency with a standard deviation below 1e-5
    times its value. A temperature change of 0.1 K has a larger effect. If there is no such
    frequency, the list is empty.
    """
    rows = [
        measurement
        for measurement in measurements.rows
        if measurement.is_natural_frequency and measurement.deviation < 1e-5 * measurement.value
    ]
    return [
        f"{measurement.name} has a standard deviation of {measurement.deviation:.3g} Hz, less than "
        "its change by 0.1 K: if you mean a relative one, give "
        f"{measurement.deviation * measurement.value:.3g} Hz"
        for measurement in rows[:1]
    ]


def _list_misfit_warnings(identification: Identification) -> list[str]:
    """List warnings about the fit of the measurements, as sentences.

    There are three possible warnings:

    - The grid does not resolve the posterior.
    - No crack explains the measurements. The warning names the measurement without which chi^2 is
      smallest.
    - A plate without a crack explains all measurements but one. The warning names this measurement.
      If several measurements are possible, it names all.
    """
    chi_square, p_value = identification.misfit_chi_square_and_p_value
    rows, warning_texts = identification.measurements.rows, []
    required_p_value = 1.0 - identification.priors["confidence"]
    if identification.posterior.unresolved_probability > IDENTIFICATION_VALUES.min_part_probability:
        warning_texts.append(
            "the grid does not resolve "
            f"{identification.posterior.unresolved_probability:.0%} of the probability: the "
            "intervals may be far too small; use larger priors (identify.*_deviation), or measure "
            "more"
        )
    n_measurements_after_baseline = sum(
        measurement.quantity != "frequency_uncracked" for measurement in rows
    )
    if p_value < required_p_value:
        total_chi_square_text = (
            f"chi^2 is {chi_square:.3g} for {format_count(len(rows), 'measurement')}"
        )
        if n_measurements_after_baseline > 1:
            chi_squares_without_row = [
                chi_square
                for chi_square, _ in identification.posterior.misfits_without_each_measurement
            ]
            worst_row_index = int(np.argmin(chi_squares_without_row))
            total_chi_square_text += (
                f", and {chi_squares_without_row[worst_row_index]:.3g} without "
                f"{rows[worst_row_index].name}: check this measurement"
            )
        warning_texts.append(
            f"no crack of this kind explains the measurements: {total_chi_square_text}"
        )
    if (
        n_measurements_after_baseline > 1
        and identification.posterior_without_crack is not None
        and identification.posterior_without_crack.misfit_chi_square_and_p_value[1]
        < required_p_value
    ):
        rows_and_misfits_without_row = zip(
            rows,
            identification.posterior_without_crack.misfits_without_each_measurement,
            strict=True,
        )
        if suspect_measurement_names := [
            measurement.name
            for measurement, (_, p_value_without_row) in rows_and_misfits_without_row
            if p_value_without_row >= required_p_value
        ]:
            rows_pronoun = "these" if len(suspect_measurement_names) > 1 else "it"
            uncracked_plate_fits_others_text = (
                "a plate without a crack explains the measurements without "
                f"{' or without '.join(suspect_measurement_names)}"
            )
            warning_texts.append(
                f"{uncracked_plate_fits_others_text}: measure {rows_pronoun} again"
            )
    return warning_texts


def _describe_single_crack_condition_or_empty(identification: Identification) -> str:
    """Return the condition that there is only one crack, as text.

    The condition is needed if all measurements are natural frequencies, of few modes. Two cracks
    have twice as many unknowns as one crack. With at most this number of measured modes, two cracks
    may explain all measurements. If the condition is not needed, return "".
    """
    identify_table, rows = identification._identify_table, identification.measurements.rows
    n_crack_unknowns = len(identify_table.mesh_parameter_axes) + sum(
        unknown_axis.key.startswith("crack.") and not isinstance(unknown_axis.values[0], str)
        for unknown_axis in identify_table.unknown
    )
    measured_modes = {
        measurement.mode for measurement in rows if measurement.quantity != "frequency_uncracked"
    }
    if (
        not all(measurement.is_natural_frequency for measurement in rows)
        or len(measured_modes) > 2 * n_crack_unknowns
    ):
        return ""
    frequencies_text = (
        f"may have the same frequencies of {format_count(len(measured_modes), 'mode')}: "
        "measure more modes"
    )
    return (
        "; place and size hold for a single crack: two cracks, or a crack elsewhere, "
        f"{frequencies_text}"
    )


def _describe_unchanged_plate_condition_or_empty(identification: Identification) -> str:
    """Return the condition that clamp and temperature have not changed, as text.

    A changed clamp or temperature may look like a crack. The changes happen between the baseline,
    natural frequencies measured before the crack, and later measurements. The text is returned in
    two cases:

    - A plate without a crack explains the measurements, but not without any change.
    - A plate without a crack does not explain the measurements with the prior standard deviations
      of the changes. It does so with frequency changes as large as ``identify.clamp_deviation``.

    Otherwise, and without a baseline, return "".
    """
    identify_table, rows = identification._identify_table, identification.measurements.rows
    uncracked_posterior = identification.posterior_without_crack
    has_baseline = any(measurement.quantity == "frequency_uncracked" for measurement in rows)
    thermal_frequency_change = abs(
        0.5
        * identify_table.temperature_coefficient
        * identification.priors["temperature_deviation"]
    )
    required_p_value = 1.0 - identify_table.confidence
    largest_stated_change = max(identify_table.before_deviation, thermal_frequency_change)
    frequency_deviation_by_clamp = identify_table.clamp_deviation
    if uncracked_posterior is None or not has_baseline or largest_stated_change == 0.0:
        return ""
    is_uncracked_explained = (
        uncracked_posterior.misfit_chi_square_and_p_value[1] >= required_p_value
    )
    if (
        is_uncracked_explained
        and uncracked_posterior.compute_misfit_with_change_factors(temperature_factor=0.0)[1]
        < required_p_value
    ):
        return (
            f"; {_describe_modulus_change(identification, uncracked_posterior)}, "
            "explains the measurements without a crack: measure the temperature, too; or open and "
            "close the clamp, measure again, and give the change as identify.before_deviation"
        )
    clamp_deviation_factor, temperature_deviation_factor = (
        0.0
        if is_uncracked_explained
        else max(1.0, frequency_deviation_by_clamp / stated_change)
        if stated_change
        else 1.0
        for stated_change in (identify_table.before_deviation, thermal_frequency_change)
    )
    misfit_with_changes = uncracked_posterior.compute_misfit_with_change_factors(
        clamp_factor=clamp_deviation_factor, temperature_factor=temperature_deviation_factor
    )
    if (misfit_with_changes[1] >= required_p_value) == is_uncracked_explained:
        return ""
    modulus_alternative_text = (
        f", or {_describe_modulus_change(identification, uncracked_posterior)},"
        if is_uncracked_explained
        else ""
    )
    return (
        "; a clamp, temperature or sensor that has changed frequencies by a relative "
        f"{largest_stated_change if is_uncracked_explained else frequency_deviation_by_clamp:.2g}"
        f"{modulus_alternative_text} explains the measurements without a crack: open and close "
        "the clamp, "
        "measure again, and give the change as identify.before_deviation (now "
        f"{identify_table.before_deviation:.2g})"
    )


def _describe_warming_condition_or_empty(identification: Identification) -> str:
    """Describe the change of Young's modulus that the crack needs to explain the measurements.

    The text begins with ";" and names the modulus change, and the temperature change that causes
    it. Return "" if the crack explains the measurements without a change of temperature.
    """
    if (
        identification.posterior.compute_misfit_with_change_factors(temperature_factor=0.0)[1]
        >= 1.0 - identification.priors["confidence"]
    ):
        return ""
    return (
        "; the crack explains the measurements only with "
        f"{_describe_modulus_change(identification, identification.posterior)}: measure the "
        "temperature, too"
    )


def _describe_modulus_change(identification: Identification, posterior: Posterior) -> str:
    """Describe the posterior mean of the change in Young's modulus.

    An example is "a Young's modulus 1.00% lower than before, as about 25 K more cause".
    """
    kelvin_change = (
        identification.priors["temperature_deviation"]
        * posterior.mean_normalised_temperature_change
    )
    relative_modulus_change = identification.priors["temperature_coefficient"] * kelvin_change
    direction_text = "lower" if relative_modulus_change < 0.0 else "higher"
    kelvin_text = f"{abs(kelvin_change):.2g} K {'more' if kelvin_change > 0.0 else 'less'}"
    modulus_text = (
        f"a Young's modulus {abs(relative_modulus_change):.2%} {direction_text} than before"
    )
    return f"{modulus_text}, as about {kelvin_text} cause"


def _describe_intervals(identification: Identification) -> str:
    """Describe the credible intervals of all unknowns.

    An example is "crack length 2 mm to 3 mm, or below 1 mm, outside the bounds of the search". The
    text from "or" on is added for crack sizes: the measurements may not exclude cracks below the
    smallest solved size.
    """
    posterior = identification.posterior
    branch = posterior.posterior_by_text_values[posterior.best_words_and_unknowns[0]]
    lower_bounds = branch.likelihood.predictor.model.grid_of_solved_cases.lower_bounds
    interval_texts = []
    for (key, (lower_end, upper_end)), search_lower_bound in zip(
        identification.intervals.items(), lower_bounds, strict=True
    ):
        lower_text, upper_text = value_in_words(key, lower_end), value_in_words(key, upper_end)
        interval_texts.append(f"{key_in_words(key)} {lower_text} to {upper_text}")
        if key in CRACK_SIZE_KEYS:
            interval_texts[-1] += (
                f", or below {value_in_words(key, search_lower_bound)}, "
                "outside the bounds of the search"
            )
    return "; ".join(interval_texts)
