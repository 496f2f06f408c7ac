"""Result of an identification, and the information of further measurements.

With predictions s and the covariance V of measurements and predictions, the Fisher information of
the unknowns x is

    F = (ds / dx)^T V^-1 (ds / dx) + P,

where P is that of the prior. One more measurement, with which it is F', adds in nats

    log(det F' / det F) / 2

(A. C. Atkinson, A. N. Donev and R. D. Tobias, Optimum Experimental Designs, 2007, chapter 11:
D-optimality).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.basics.atomic_files import write_whole
from fenics_crack.basics.errors import InputError, check_number
from fenics_crack.basics.tables import Table, Tabular, counted
from fenics_crack.files.store import IDENTIFICATION, write
from fenics_crack.monitoring.identification.measurements import Measurement, Measurements
from fenics_crack.monitoring.identification.model import ForwardModel, Predictor, ProbeDisplacements
from fenics_crack.monitoring.identification.nuisance import CRACK_SIZE_KEYS
from fenics_crack.monitoring.identification.options import OPTIONS
from fenics_crack.monitoring.identification.posterior import (
    Branch,
    Likelihood,
    Posterior,
    add_uniform_prior,
    compute_scaled_covariance,
)
from fenics_crack.scene.scene import Scene, unit_of
from fenics_crack.scene.tables import Identify
from fenics_crack.scene.words import key_in_words, value_in_words

# --- where to measure -----------------------------------------------------------------------------

FIT_COLUMN_NAMES = "measurement", "value", "deviation", "predicted", "of the model", "residual"
"""Columns of the table of measurements and predictions."""


@dataclass(frozen=True, repr=False)
class Worth(Tabular):
    """Possible measurements, most informative first.

    Attributes
    ----------
    measurements : tuple of Measurement
        With the predicted values and the standard deviations assumed.
    information : (n,)
        Information gained by each [nats].
    deviations : dict of str to (n,)
        Standard deviation of each unknown with it.
    now : dict of str to float
        Standard deviation of each unknown without it.
    """

    measurements: tuple[Measurement, ...]
    information: np.ndarray
    deviations: dict[str, np.ndarray]
    now: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every measurement."""
        rows = self.measurements
        found: dict[str, Any] = {
            "measurement": [row.name for row in rows],
            "value": [row.value for row in rows],
            "deviation": [row.deviation for row in rows],
            "information": self.information.tolist(),
        }
        return found | {f"left_of_{key}": part.tolist() for key, part in self.deviations.items()}

    def _units(self) -> Mapping[str, str]:
        units = {f"left_of_{key}": unit_of(key) for key in self.now}
        return units | {"information": "nats"}

    def _title(self) -> str:
        if not self.measurements:
            return "nothing to measure"
        return f"{self.measurements[0].name} adds {self.information[0]:.3g} nats"


def rank_measurements(
    likelihood: Likelihood,
    x: np.ndarray,
    measurements: Sequence[Measurement] | None,
    deviations: tuple[float, float],
) -> Worth:
    """Return the worth of further measurements at an estimate x (d,) from some measurements.

    Raises
    ------
    InputError
        A standard deviation is not > 0, or a measurement is not one of the forward model.
    """
    names = ("frequency_deviation", "harmonic_deviation")
    for name, deviation in zip(names, deviations, strict=True):
        check_number(name, deviation, 0.0, above=True)
    model, made = likelihood.predictor.model, likelihood.predictor.rows
    rows = tuple(measurements or ())
    for row in rows:
        row.check(model.scene)
    if measurements is None:
        rows = (*model.list_candidates(), *_more_probes(made))
    count = len(made)
    quantities = model.make_predictor(made, rows)
    values = quantities(x[None]).values[0]
    noise = np.array([row.deviation for row in rows])
    if measurements is None:
        at_probe = np.array([row.quantity == "displacement" for row in rows])
        shares = np.where([row.natural for row in rows], *deviations)
        noise = np.where(at_probe, noise, shares * values[count:])
    fit = np.isfinite(values[count:]) & (noise > 0.0)
    every = np.concatenate([likelihood.deviations, np.where(fit, noise, 1.0)])
    seen, first = _seen(quantities, x, every), np.arange(count)
    before, now = _known(model, x, seen, first)
    each = [_known(model, x, seen, np.append(first, count + at)) for at in range(len(rows))]
    gains = 0.5 * np.maximum([after - before for after, _ in each], 0.0)  # below 0 by rounding
    best = [int(at) for at in np.argsort(-gains, kind="stable") if fit[at]]
    return Worth(
        tuple(
            replace(rows[at], value=float(values[count + at]), deviation=float(noise[at]))
            for at in best
        ),
        gains[best],
        {key: np.array([each[at][1][key] for at in best]) for key in model.unknown_keys},
        now,
    )


def list_advice(likelihood: Likelihood, x: np.ndarray, worth: Worth) -> list[str]:
    """Return in words the next measurements: missing frequencies of the plate before it had a
    crack, and the most informative other one; none that changes no printed digit."""
    model, rows = likelihood.predictor.model, likelihood.predictor.rows
    measured = {row.mode for row in rows if row.natural} or {1, 2}
    known = {row.mode for row in rows if row.quantity == "frequency_uncracked"}
    found, relative = [], OPTIONS.advised_frequency_deviation
    if model.coarse_cases.uncracked_cases is not None and (missing := sorted(measured - known)):
        more = [
            Measurement("frequency_uncracked", hertz, relative * hertz, mode=mode)
            for mode, hertz in enumerate(model.uncracked_plate.natural_frequencies.tolist(), 1)
            if mode in missing
        ]
        modes = f"{'ies' if len(missing) > 1 else 'y'} {', '.join(map(str, missing))}"
        what = f"natural frequenc{modes} before there was a crack (frequency_uncracked)"
        if gained := _gained(worth.now, _left_with(likelihood, x, more)):
            found.append(f"{what}, to {relative:.1%}: {gained}")
    if worth.measurements:
        left = {key: float(values[0]) for key, values in worth.deviations.items()}
        if gained := _gained(worth.now, left):
            found.append(f"{worth.measurements[0].name}: {gained}")
    return found


def _gained(now: Mapping[str, float], after: Mapping[str, float]) -> str:
    """Gain of a measurement, in words: "crack length to 0.2 mm in place of 1 mm", of the unknowns
    whose printed standard deviations change."""
    pairs = ((key, value_in_words(key, after[key]), value_in_words(key, now[key])) for key in now)
    return ", ".join(f"{key_in_words(k)} to {a} in place of {b}" for k, a, b in pairs if a != b)


def _left_with(
    likelihood: Likelihood, x: np.ndarray, more: Sequence[Measurement]
) -> dict[str, float]:
    """Standard deviation of each unknown with some further measurements, all of them."""
    model = likelihood.predictor.model
    quantities = model.make_predictor(likelihood.predictor.rows, more)
    every = np.concatenate([likelihood.deviations, [row.deviation for row in more]])
    return _known(model, x, _seen(quantities, x, every), np.arange(len(every)))[1]


def _known(
    model: ForwardModel, x: np.ndarray, seen: tuple[np.ndarray, np.ndarray], places: np.ndarray
) -> tuple[float, dict[str, float]]:
    """log det F of some (n,) of the measurements, from the covariance and the derivatives of all;
    and the standard deviation of each unknown by them."""
    covariance, slopes = seen[0][np.ix_(places, places)], seen[1][places]
    information = add_uniform_prior(slopes.T @ np.linalg.solve(covariance, slopes))
    own = np.sqrt(np.diag(np.linalg.inv(information))) * (
        model.unknown_grid.upper_bounds - model.unknown_grid.lower_bounds
    )
    left = np.hypot(own, model.compute_crack_deviations(x[None])[0])
    volume = float(np.linalg.slogdet(information)[1])
    return volume, dict(zip(model.unknown_keys, left.tolist(), strict=True))


def _more_probes(made: Sequence[Measurement]) -> list[Measurement]:
    """Possible displacements of one more probe, at 24 phases of the period."""
    phases, probes = 2.0 * np.pi * np.arange(24) / 24, []
    for passages in ProbeDisplacements.group_measurements(made, ()):
        rows = [made[place] for place in passages.row_indices]
        deviation = float(np.median([row.deviation for row in rows]))
        one = replace(rows[0], value=0.0, deviation=deviation)
        probes += [replace(one, phase=phase) for phase in phases.tolist()]
    return probes


def _seen(
    quantities: Predictor, x: np.ndarray, deviations: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Covariance (q, q) of measurements and predictions, over standard deviations (q,), and their
    derivatives by the unknowns over their ranges (q, d); 0 without a prediction."""
    predicted, cube = quantities(x[None]), quantities.model.unknown_grid
    covariance = compute_scaled_covariance(
        predicted, np.nan_to_num(predicted.values[0]), deviations
    )[0]
    steps = np.diag(1e-3 * (cube.upper_bounds - cube.lower_bounds))
    above = np.minimum(x + steps, cube.upper_bounds)
    below = np.maximum(x - steps, cube.lower_bounds)
    distance = np.diag(above - below) / (cube.upper_bounds - cube.lower_bounds)
    difference = quantities(above).values - quantities(below).values
    slopes = (difference / distance[:, None]).T / deviations[:, None]
    slopes[~np.isfinite(slopes).all(axis=1)] = 0.0
    return covariance, slopes


# --- the result -----------------------------------------------------------------------------------

NO_CRACK_VERDICT = "no crack"


@dataclass(frozen=True, repr=False)
class Identification(Tabular):
    """Unknowns with their intervals, and the verdict on whether there is a crack.

    Attributes
    ----------
    scene : Scene
        The scene with its table ``[identify]``.
    measurements : Measurements
        The measurements, without those that the forward model could not predict.
    posterior : Posterior
        The probability of the unknowns, on a grid.
    plain : Posterior, optional
        That of the plate without its crack; None where there is no such plate.
    remarks : tuple of str
        Limits of these measurements.
    doubts : tuple of str
        Failed cases of the forward model, and measurements that are not used for that.
    """

    scene: Scene
    measurements: Measurements
    posterior: Posterior
    plain: Posterior | None
    remarks: tuple[str, ...]
    doubts: tuple[str, ...]

    @property
    def unknown(self) -> tuple[str, ...]:
        """The unknowns that are numbers."""
        return self._at[0].likelihood.predictor.model.unknown_keys

    @property
    def priors(self) -> dict[str, float]:
        """Priors and levels of confidence by their keys of ``[identify]``."""
        return self._table.priors

    @property
    def _table(self) -> Identify:
        """The table ``[identify]`` with the standard deviation of the temperature."""
        return next(
            iter(self.posterior.branch_by_words.values())
        ).likelihood.predictor.model.uncracked_plate.identify_table

    @cached_property
    def _parts(self) -> list[tuple[str, np.ndarray, float]]:
        return self.posterior.find_region_parts(
            self._table.confidence, OPTIONS.min_part_probability
        )

    @cached_property
    def _at(self) -> tuple[Branch, np.ndarray]:
        """The branch and the unknowns of the estimate."""
        name, x = self._parts[0][:2] if self._parts else self.posterior.best_words_and_unknowns
        return self.posterior.branch_by_words[name], x

    @property
    def estimate(self) -> dict[str, Any]:
        """Mean of the unknowns over the most probable part of the region, words too."""
        branch, x = self._at
        return branch.get_value_by_key(x)

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """Interval of each unknown with the probability ``identify.confidence``."""
        found, share = self.posterior.compute_interval, self._table.confidence
        return {key: found(place, share) for place, key in enumerate(self.unknown)}

    @property
    def log_bayes_factor(self) -> float:
        """log of the evidence of a crack over that of none; nan without a plate without a crack."""
        other = np.nan if self.plain is None else self.plain.log_evidence
        return self.posterior.log_evidence - other

    @property
    def verdict(self) -> str:
        """The word "crack" or "no crack" where the evidence prefers it by
        ``identify.log_bayes_factor``, else, and by :attr:`reason`, "undecided"."""
        return self._assessed[0]

    @property
    def conclusion(self) -> str:
        """The verdict in words: of no crack with the sizes, ends of :attr:`intervals`, up to which
        there may be one all the same."""
        ends = [(key, end) for key, (_, end) in self.intervals.items() if key in CRACK_SIZE_KEYS]
        sizes = [f"{value_in_words(key, end)} of {key_in_words(key)}" for key, end in ends]
        above = f" above {' or '.join(sizes)}" if sizes else " of the scene's size"
        return self.verdict + above * (self.verdict == NO_CRACK_VERDICT)

    @property
    def reason(self) -> str:
        """Reason for the verdict, in words."""
        return self._assessed[1]

    @cached_property
    def _assessed(self) -> tuple[str, str]:
        """Verdict and reason, from the misfits of both hypotheses, the logarithm of the ratio of
        their evidences, and the interval of a crack."""
        undecided, priors = "undecided", self.priors
        if self.plain is None:
            return undecided, "there is no plate without a crack to compare with"
        least, strong = 1.0 - priors["confidence"], priors["log_bayes_factor"]
        fits, healthy, ratio = self.misfit[1], self.plain.misfit[1], self.log_bayes_factor
        factor = f"log Bayes factor {ratio:.3g}, crack over no crack"
        if max(fits, healthy) < least:
            why = "neither a crack of this kind nor a plate without one explains the measurements"
            other = "two cracks, one of another kind or elsewhere, or a wrong measurement might"
            return undecided, f"{why}; {other} ({factor})"
        if ratio > strong and healthy >= least:
            why = "a plate without a crack explains the measurements within its priors"
            return undecided, f"{why} ({factor}){_if_as_before(self)}"
        if ratio < -strong:
            unseen = f"{factor}; an undetected one would be at {_where(self)}"
            return NO_CRACK_VERDICT, unseen + _if_as_before(self)
        conditions = _if_alone(self) + _if_as_before(self)
        if ratio > strong:
            return "crack", factor + _if_warmer(self) + conditions
        return undecided, f"{factor}; if there is one it is at {_where(self)}{conditions}"

    @property
    def misfit(self) -> tuple[float, float]:
        """chi^2 where the likelihood is largest, and its p-value with as many degrees of freedom as
        there are measurements more than unknowns (and three of the load of displacements)."""
        return self.posterior.misfit

    @property
    def advice(self) -> list[str]:
        """The next measurements, in words: missing frequencies of the plate before it had a crack,
        and the most informative other one."""
        branch, x = self._at
        return list_advice(branch.likelihood, x, self.where_to_measure())

    @property
    def alternatives(self) -> list[tuple[dict[str, Any], float]]:
        """Separate cracks that explain the measurements, best first, with probabilities; more than
        one cannot be distinguished."""
        branches = self.posterior.branch_by_words
        return [(branches[name].get_value_by_key(x), mass) for name, x, mass in self._parts]

    def contains(self, values: Mapping[str, Any], share: float | None = None) -> bool:
        """Return True if given values of all unknowns are in the region with a probability, by
        default ``identify.confidence``.

        Raises
        ------
        InputError
            An unknown is missing.
        """
        for branch in self.posterior.branch_by_words.values():
            model = branch.likelihood.predictor.model
            missing = [
                key for key in (*model.unknown_keys, *model.word_by_key) if key not in values
            ]
            if missing:
                raise InputError("values", dict(values), f"with {', '.join(missing)}")
            if all(values[key] == word for key, word in model.word_by_key.items()):
                x = np.array([float(values[key]) for key in model.unknown_keys])
                return branch.interpolate_log_likelihood(x) >= self.posterior.find_region_level(
                    share or self._table.confidence
                )
        return False

    def where_to_measure(
        self,
        measurements: Sequence[Measurement] | None = None,
        *,
        frequency_deviation: float = OPTIONS.advised_frequency_deviation,
        harmonic_deviation: float = 0.05,
    ) -> Worth:
        """Worth of one more measurement, from the Fisher information at the estimate.

        Parameters
        ----------
        measurements : sequence of Measurement, optional
            Possible measurements; the values do not matter. Default: natural frequencies, and
            ratios of harmonics at all load frequencies and points of the forward model, with the
            two deviations below.
        frequency_deviation, harmonic_deviation : float
            Standard deviations over the value.

        Raises
        ------
        InputError
            A measurement is not one of the forward model.
        """
        deviations = frequency_deviation, harmonic_deviation
        branch, x = self._at
        return rank_measurements(branch.likelihood, x, measurements, deviations)

    def save(self, folder: str | Path) -> None:
        """Write ``identify.json``, and ``identify.h5``, with it and the posterior (collective).

        Raises
        ------
        InputError
            A file cannot be written.
        """
        parts: dict[str, Any] = {"log_bayes_factor": self.log_bayes_factor}
        for number, (name, branch) in enumerate(self.posterior.branch_by_words.items()):
            parts[f"words_{number}"] = name
            parts[f"log_likelihood_{number}"] = branch.log_likelihood
            parts[f"probability_{number}"] = self.posterior.mass_by_words[name]
            for key, axis in zip(self.unknown, branch.axes, strict=True):
                parts[f"{key}_{number}"] = axis
        text = json.dumps(self.summary(), indent=1, ensure_ascii=False)
        parts["summary"] = text
        write(parts, Path(folder) / "identify.h5", IDENTIFICATION, self.scene)
        write_whole(Path(folder) / "identify.json", text + "\n")

    # --- shown ------------------------------------------------------------------------------------

    def summary(self) -> dict[str, Any]:
        """Everything in words and numbers, as ``identify.json`` has it."""
        ratio = self.log_bayes_factor
        total, chance = self.misfit
        return {
            "verdict": self.verdict,
            "conclusion": self.conclusion,
            "reason": self.reason,
            "log_bayes_factor": None if np.isnan(ratio) else ratio,
            "estimate": self.estimate,
            "priors": self.priors,
            "intervals": {key: list(ends) for key, ends in self.intervals.items()},
            "alternatives": [
                {"values": values, "probability": mass} for values, mass in self.alternatives
            ],
            "chi_square": total,
            "probability_of_misfit": chance,
            "remarks": list(self.remarks),
            "warnings": self.warnings,
            "advice": self.advice,
            "measurements": self.fit_table().rows,
        }

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every unknown that is a number."""
        estimate, intervals = self.estimate, self.intervals
        return {
            "unknown": list(self.unknown),
            "estimate": [estimate[key] for key in self.unknown],
            "deviation": [
                self.posterior.compute_deviation(place) for place in range(len(self.unknown))
            ],
            "low": [intervals[key][0] for key in self.unknown],
            "high": [intervals[key][1] for key in self.unknown],
            "unit": [unit_of(key) for key in self.unknown],
        }

    def fit_table(self) -> Table:
        """Each measurement with the prediction of the estimate, both standard deviations, and the
        residual over both together."""
        branch, x = self._at
        likelihood = branch.likelihood
        found = likelihood.predict_most_probable(x)
        predicted = found.values[0]
        spread = np.where(found.is_predictable, np.sqrt(np.diag(found.covariance[0])), np.inf)
        residuals = (likelihood.values - predicted) / np.hypot(likelihood.deviations, spread)
        columns = (likelihood.values, likelihood.deviations, predicted, spread, residuals)
        names = [row.name for row in likelihood.predictor.rows]
        rows = [list(row) for row in zip(names, *(c.tolist() for c in columns), strict=True)]
        return Table(FIT_COLUMN_NAMES, rows)

    @property
    def warnings(self) -> list[str]:
        """Points to be careful about: cases that failed, several cracks that fit, a misfit, a crack
        by one measurement alone, an interval that the bounds cut."""
        found, others = [*self.doubts, *_too_sure(self.measurements)], self.alternatives
        if self.verdict == NO_CRACK_VERDICT:
            return found
        if len(others) > 1:
            cracks = [
                " and ".join(f"{key_in_words(k)} {value_in_words(k, v)}" for k, v in values.items())
                + f" ({mass:.0%})"
                for values, mass in others
            ]
            found.append(f"these cracks cannot be distinguished: {'; '.join(cracks)}")
        found += _of_fit(self)
        for place, beyond, bound in self.posterior.iterate_reached_bounds(self._table.confidence):
            key = self.unknown[place]
            where = f"{beyond} {value_in_words(key, bound)}"
            found.append(f"{key_in_words(key)} may be {where}, outside the bounds of the search")
        return found

    def _title(self) -> str:
        parts = [self.conclusion]
        if not np.isnan(self.log_bayes_factor):
            parts[0] += f" (log Bayes factor {self.log_bayes_factor:.3g})"
        if self.verdict == NO_CRACK_VERDICT:
            return parts[0]
        for place, key in enumerate(self.unknown):
            value = value_in_words(key, self.estimate[key])
            parts.append(
                f"{key} = {value} ± {value_in_words(key, self.posterior.compute_deviation(place))}"
            )
        if len(self.alternatives) > 1:
            parts.append("NOT THE ONLY ONE")
        parts += ["IF IT IS ONE CRACK"] * bool(_if_alone(self))
        held = self.verdict == "crack" and _if_as_before(self)
        return ", ".join(parts + ["IF ITS CLAMP HOLDS AS BEFORE"] * bool(held))


def _too_sure(measurements: Measurements) -> list[str]:
    """Natural frequencies whose standard deviation is smaller than their change by 0.1 K."""
    rows = [row for row in measurements.rows if row.natural and row.deviation < 1e-5 * row.value]
    return [
        f"{row.name} has a standard deviation of {row.deviation:.3g} Hz, less than its change by "
        f"0.1 K: if a relative one is meant, it is {row.deviation * row.value:.3g} Hz"
        for row in rows[:1]
    ]


def _of_fit(found: Identification) -> list[str]:
    """Warnings of a posterior that the grid does not resolve; of measurements that no crack
    explains, with the one without which chi^2 is smallest; and of one alone that only a crack
    explains."""
    (total, chance), rows, said = found.misfit, found.measurements.rows, []
    least = 1.0 - found.priors["confidence"]
    if found.posterior.unresolved_probability > OPTIONS.min_part_probability:
        said.append(
            f"the grid does not resolve {found.posterior.unresolved_probability:.0%} of the probability: the "
            "intervals may be far too small; use larger priors (identify.*_deviation), or measure "
            "more"
        )
    now = sum(row.quantity != "frequency_uncracked" for row in rows)
    if chance < least:
        misfit = f"chi^2 = {total:.3g} of {len(rows)}"
        if now > 1:
            left = [one[0] for one in found.posterior.misfits_without_measurement]
            at = int(np.argmin(left))
            misfit += f", {left[at]:.3g} without {rows[at].name}"
        said.append(f"no crack of this kind explains the measurements: {misfit}")
    if now > 1 and found.plain is not None and found.plain.misfit[1] < least:
        pairs = zip(rows, found.plain.misfits_without_measurement, strict=True)
        if names := [row.name for row, (_, without) in pairs if without >= least]:
            that = "these" if len(names) > 1 else "that"
            alone = f"a plate without a crack explains all but {' or '.join(names)}"
            said.append(f"{alone}: measure {that} again")
    return said


def _if_alone(found: Identification) -> str:
    """Condition of the verdict, in words, where two cracks have as many unknowns as there are
    measured modes, or more, so that no misfit excludes two; else empty."""
    table, rows = found._table, found.measurements.rows
    keys = [axis.key for axis in table.unknown if not isinstance(axis.values[0], str)]
    numbers = len(table.mesh_axes) + sum(key.startswith("crack.") for key in keys)
    modes = {row.mode for row in rows if row.quantity != "frequency_uncracked"}
    if not all(row.natural for row in rows) or len(modes) > 2 * numbers:
        return ""
    same = f"may have the same frequencies of {counted(len(modes), 'mode')}"
    return f"; place and size are those of one crack: two of them, or one elsewhere, {same}"


def _if_as_before(found: Identification) -> str:
    """Condition of the verdict, in words, where a plate without a crack does not explain the
    measurements, but would with changes since before as large as a clamp can make.

    The same where it does, but only by the prior of changes since before; else empty.
    """
    table, rows = found._table, found.measurements.rows
    plain, known = found.plain, any(row.quantity == "frequency_uncracked" for row in rows)
    heat = abs(0.5 * table.temperature_coefficient * found.priors["temperature_deviation"])
    least = 1.0 - table.confidence
    stated, most = max(table.before_deviation, heat), table.clamp_deviation
    if plain is None or not known or stated == 0.0:
        return ""
    healthy = plain.misfit[1] >= least
    if healthy and plain.compute_misfit_with_changes(temperature=0.0)[1] < least:
        return (
            f"; {_modulus_change(found, plain)}, explains the measurements without a crack: "
            "measure the temperature, too, before and since (temperature), or open the clamp, "
            "close it, measure again and give their change as identify.before_deviation"
        )
    factors = [
        0.0 if healthy else max(1.0, most / one) if one else 1.0
        for one in (table.before_deviation, heat)
    ]
    other = plain.compute_misfit_with_changes(clamp=factors[0], temperature=factors[1])
    if (other[1] >= least) == healthy:
        return ""
    such = f", or {_modulus_change(found, plain)}," if healthy else ""
    return (
        "; a clamp, a temperature or a sensor that has changed frequencies by "
        f"{stated if healthy else most:.2g} since before{such} explains the measurements without a "
        f"crack (identify.before_deviation = {table.before_deviation:.2g}): open the clamp, close "
        "it, measure again and give their change there"
    )


def _if_warmer(found: Identification) -> str:
    """The change of Young's modulus without which a crack does not explain the measurements, in
    words; else empty."""
    if (
        found.posterior.compute_misfit_with_changes(temperature=0.0)[1]
        >= 1.0 - found.priors["confidence"]
    ):
        return ""
    return f"; with {_modulus_change(found, found.posterior)}"


def _modulus_change(found: Identification, posterior: Posterior) -> str:
    """Posterior mean of the change of Young's modulus, in words: "a Young's modulus 1 % lower than
    before, as about 25 K more make it"."""
    kelvin = found.priors["temperature_deviation"] * posterior.mean_temperature_change
    change = found.priors["temperature_coefficient"] * kelvin
    way = "lower" if change < 0.0 else "higher"
    how = f"as about {abs(kelvin):.2g} K {'more' if kelvin > 0.0 else 'less'} make it"
    return f"a Young's modulus {abs(change):.2%} {way} than before, {how}"


def _where(found: Identification) -> str:
    """Intervals of the unknowns, in words, and sizes below the bounds of the search."""
    cube = found.posterior.branch_by_words[
        found.posterior.best_words_and_unknowns[0]
    ].likelihood.predictor.model.unknown_grid
    places = []
    for (key, ends), least in zip(found.intervals.items(), cube.lower_bounds, strict=True):
        low, high = (value_in_words(key, end) for end in ends)
        shorter = f", or below {value_in_words(key, least)}, outside the bounds of the search"
        places.append(f"{key_in_words(key)} {low} to {high}{shorter * (key in CRACK_SIZE_KEYS)}")
    return "; ".join(places)
