"""What measurements tell of a crack, and how much one more of them would.

With predictions s and the covariance V of measurements and predictions, the Fisher information of
the unknowns x is

    F = (ds / dx)^T V^-1 (ds / dx) + P,

where P is that of the prior. One more measurement, with which it is F', tells in nats

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
from fenics_crack.monitoring.identification.model import Model, Quantities
from fenics_crack.monitoring.identification.nuisance import OF_SIZE, Whole
from fenics_crack.monitoring.identification.posterior import (
    EXPLAINS,
    PRIOR,
    Branch,
    Likelihood,
    Posterior,
    scaled_covariance,
)
from fenics_crack.scene.scene import Scene, unit_of
from fenics_crack.scene.tables import Identify
from fenics_crack.scene.words import key_in_words, value_in_words

# --- where to measure -----------------------------------------------------------------------------

FITTED = "measurement", "value", "deviation", "predicted", "of the model", "residual"
"""What is said of each measurement."""
BASELINE = 1e-3
"""Relative standard deviation of frequencies that are advised, if nothing else is said."""

PROBES = 24
"""Phases of the load's period at which one more probe is considered."""
WORTH_STEP = 1e-3
"""Of an unknown, over its range, for derivatives."""


@dataclass(frozen=True, repr=False)
class Worth(Tabular):
    """Possible measurements, most informative first.

    Attributes
    ----------
    measurements : tuple of Measurement
        With the predicted values and the standard deviations assumed.
    information : (n,)
        What each would tell beside what is known [nats].
    deviations : dict of str to (n,)
        The standard deviation that each unknown would have.
    now : dict of str to float
        The one that it has.
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
        return f"{self.measurements[0].name} tells {self.information[0]:.3g} nats"


def worth_of(
    likelihood: Likelihood,
    x: np.ndarray,
    measurements: Sequence[Measurement] | None,
    deviations: tuple[float, float],
) -> Worth:
    """Judge what more measurements would tell at an estimate x (d,) from some measurements.

    Raises
    ------
    InputError
        A standard deviation is not > 0, or a measurement is not one of the forward model.
    """
    names = ("frequency_deviation", "harmonic_deviation")
    for name, deviation in zip(names, deviations, strict=True):
        check_number(name, deviation, 0.0, above=True)
    model, made = likelihood.quantities.model, likelihood.quantities.rows
    rows = tuple(measurements or ())
    for row in rows:
        row.check(model.scene)
    if measurements is None:
        rows = (*model.candidates(), *_more_probes(made))
    count = len(made)
    quantities = model.quantities(made, rows)
    values = quantities(x[None]).values[0]
    noise = np.array([row.deviation for row in rows])
    if measurements is None:
        of_row = {True: deviations[0], False: deviations[1]}
        at_probe = np.array([row.quantity == "displacement" for row in rows])
        shares = np.array([of_row[row.natural] for row in rows])
        noise = np.where(at_probe, noise, shares * values[count:])
    fit = np.isfinite(values[count:]) & (noise > 0.0)
    every = np.concatenate([likelihood.deviations, np.where(fit, noise, 1.0)])
    seen, first = _seen(quantities, x, every), np.arange(count)
    before, now = _known(model, x, seen, first)
    each = [_known(model, x, seen, np.append(first, count + at)) for at in range(len(rows))]
    told = 0.5 * np.maximum([after - before for after, _ in each], 0.0)  # below 0 by rounding
    best = [int(at) for at in np.argsort(-told, kind="stable") if fit[at]]
    return Worth(
        tuple(
            replace(rows[at], value=float(values[count + at]), deviation=float(noise[at]))
            for at in best
        ),
        told[best],
        {key: np.array([each[at][1][key] for at in best]) for key in model.keys},
        now,
    )


def advice(likelihood: Likelihood, x: np.ndarray, worth: Worth) -> list[str]:
    """What to measure next, in words: the frequencies of the plate before it had a crack where they
    are missing, and what else tells most; nothing that does not change what is printed."""
    model, rows = likelihood.quantities.model, likelihood.quantities.rows
    measured = {row.mode for row in rows if row.natural} or {1, 2}
    known = {row.mode for row in rows if row.quantity == "frequency_uncracked"}
    found = []
    if model.coarse.bare is not None and (missing := sorted(measured - known)):
        more = [
            Measurement("frequency_uncracked", hertz, BASELINE * hertz, mode=mode)
            for mode, hertz in enumerate(model.whole.frequencies.tolist(), 1)
            if mode in missing
        ]
        modes = f"{'ies' if len(missing) > 1 else 'y'} {', '.join(map(str, missing))}"
        what = f"natural frequenc{modes} before there was a crack (frequency_uncracked)"
        if gained := _gained(worth.now, _left_with(likelihood, x, more)):
            found.append(f"{what}, to {BASELINE:.1%}: {gained}")
    if worth.measurements:
        left = {key: float(values[0]) for key, values in worth.deviations.items()}
        if gained := _gained(worth.now, left):
            found.append(f"{worth.measurements[0].words}: {gained}")
    return found


def _gained(now: Mapping[str, float], after: Mapping[str, float]) -> str:
    """What measuring brings, in words: "crack length to 0.2 mm in place of 1 mm"; of the unknowns
    that it makes more sure in the digits that are printed, empty without any."""
    pairs = ((key, value_in_words(key, after[key]), value_in_words(key, now[key])) for key in now)
    told = (
        f"{key_in_words(key)} to {new} in place of {old}" for key, new, old in pairs if new != old
    )
    return ", ".join(told)


def _left_with(
    likelihood: Likelihood, x: np.ndarray, more: Sequence[Measurement]
) -> dict[str, float]:
    """Standard deviation of each unknown, with some measurements more, all of them."""
    model = likelihood.quantities.model
    quantities = model.quantities(likelihood.quantities.rows, more)
    every = np.concatenate([likelihood.deviations, [row.deviation for row in more]])
    return _known(model, x, _seen(quantities, x, every), np.arange(len(every)))[1]


def _known(
    model: Model, x: np.ndarray, seen: tuple[np.ndarray, np.ndarray], places: np.ndarray
) -> tuple[float, dict[str, float]]:
    """log det F of the measurements in some places (n,), by the covariance and the derivatives of
    all; and the standard deviation that each unknown has by them."""
    covariance, slopes = seen[0][np.ix_(places, places)], seen[1][places]
    information = slopes.T @ np.linalg.solve(covariance, slopes) + PRIOR * np.eye(len(x))
    own = np.sqrt(np.diag(np.linalg.inv(information))) * (model.cube.high - model.cube.low)
    left = np.hypot(own, model.act_as(x[None])[0])
    volume = float(np.linalg.slogdet(information)[1])
    return volume, dict(zip(model.keys, left.tolist(), strict=True))


def _more_probes(made: Sequence[Measurement]) -> list[Measurement]:
    """One more probe anywhere in the period, beside those whose displacements were measured."""
    groups: dict[tuple[float, str], list[float]] = {}
    for row in made:
        if row.quantity == "displacement":
            groups.setdefault((row.frequency, row.point), []).append(row.deviation)
    phases = 2.0 * np.pi * np.arange(PROBES) / PROBES
    return [
        Measurement(
            "displacement", 0.0, float(np.median(own)), frequency=frequency, point=point,
            phase=float(phase),
        )
        for (frequency, point), own in groups.items()
        for phase in phases
    ]  # fmt: skip


def _seen(
    quantities: Quantities, x: np.ndarray, deviations: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Covariance (q, q) of measurements and predictions, over standard deviations (q,), and the
    derivatives of these by the unknowns over their ranges (q, d); 0 of what is not known."""
    predicted, cube = quantities(x[None]), quantities.model.cube
    covariance = scaled_covariance(predicted, np.nan_to_num(predicted.values[0]), deviations)[0]
    steps = np.diag(WORTH_STEP * (cube.high - cube.low))
    above, below = np.minimum(x + steps, cube.high), np.maximum(x - steps, cube.low)
    distance = np.diag(above - below) / (cube.high - cube.low)
    difference = quantities(above).values - quantities(below).values
    slopes = (difference / distance[:, None]).T / deviations[:, None]
    slopes[~np.isfinite(slopes).all(axis=1)] = 0.0
    return covariance, slopes


# --- the result -----------------------------------------------------------------------------------

SHARE = 0.95
"""Probability of the regions and intervals that are stated."""
LEAST_PART = 0.03
"""Probability of a part of the region that is mentioned."""
NO_CRACK = "no crack"
SINCE = (
    "before_deviation",
    "temperature_deviation",
    "temperature_coefficient",
    "coefficient_deviation",
    "thermometer_deviation",
)
"""Keys of what may have changed since there was no crack."""
KNOWN_TO = 1e-5
"""Relative standard deviation of a natural frequency that a warning says to be too small: a tenth
of a degree changes that of steel by more."""
STRONG = 3.0
"""Logarithm of the ratio of evidences, 20 to 1, from which a hypothesis is preferred."""


@dataclass(frozen=True, repr=False)
class Identification(Tabular):
    """The unknowns, how sure they are, and whether there is a crack at all.

    Attributes
    ----------
    scene : Scene
        The scene with its table ``[identify]``.
    measurements : Measurements
        What was measured, without what the forward model could not predict.
    posterior : Posterior
        The probability of the unknowns, on a grid.
    plain : Posterior, optional
        That of the plate without its crack; None where there is no such plate.
    remarks : tuple of str
        What these measurements cannot tell.
    doubts : tuple of str
        Which cases of the forward model failed, and measurements that are not used for that.
    """

    scene: Scene
    measurements: Measurements
    posterior: Posterior
    plain: Posterior | None
    remarks: tuple[str, ...]
    doubts: tuple[str, ...] = ()

    @property
    def unknown(self) -> tuple[str, ...]:
        """The unknowns that are numbers."""
        return self._at[0].likelihood.quantities.model.keys

    @cached_property
    def _parts(self) -> list[tuple[str, np.ndarray, float]]:
        return self.posterior.parts(SHARE, LEAST_PART)

    @cached_property
    def _at(self) -> tuple[Branch, np.ndarray]:
        """The branch and the unknowns of the estimate."""
        name, x = self._parts[0][:2] if self._parts else self.posterior.best
        return self.posterior.branches[name], x

    @property
    def estimate(self) -> dict[str, Any]:
        """The unknowns in the middle of where they most probably are, words too."""
        branch, x = self._at
        return branch.values(x)

    @property
    def mesh(self) -> str | None:
        """Of meshes with numbers the file whose are nearest to the estimate."""
        assert self.scene.identify is not None
        return self.scene.identify.nearest_mesh(self.estimate)

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """Bounds of each unknown with a probability of 95 %."""
        found = self.posterior.interval
        return {key: found(place, SHARE) for place, key in enumerate(self.unknown)}

    @property
    def log_bayes_factor(self) -> float:
        """log of the evidence of a crack over that of none; nan where none was not considered."""
        other = np.nan if self.plain is None else self.plain.log_evidence
        return self.posterior.log_evidence - other

    @property
    def verdict(self) -> str:
        """The word "crack" or "no crack" where one is 20 times as likely as the other, else, and
        where :attr:`reason` says why, "cannot be told"."""
        return self._judged[0]

    @property
    def reason(self) -> str:
        """Reason for the verdict, in words."""
        return self._judged[1]

    @cached_property
    def _judged(self) -> tuple[str, str]:
        return _verdict_of(self)

    @property
    def since_before(self) -> dict[str, float]:
        """Standard deviations of what may have changed since there was no crack, by their keys of
        ``[identify]``, and the likeliest difference of temperature without a crack and with one
        [K]."""
        table, whole = self.scene.given("identify"), _whole_of(self)
        found = {name: getattr(table, name) for name in SINCE}
        found["temperature_deviation"] = whole.warmer
        for name, one in (("without", self.plain), ("with", self.posterior)):
            if one is not None:
                found[f"warmer_{name}_a_crack"] = whole.warmer * one.warmer
        return found

    @property
    def misfit(self) -> tuple[float, float]:
        """chi^2 where the likelihood is largest, and the probability of more, by chance, with as
        many measurements less the unknowns (and of displacements three, for what is not known of
        the load)."""
        return self.posterior.misfit

    @property
    def advice(self) -> list[str]:
        """What to measure next, in words: the frequencies of the plate before it had a crack where
        they are missing, and what else tells most."""
        branch, x = self._at
        return advice(branch.likelihood, x, self.where_to_measure())

    @property
    def alternatives(self) -> list[tuple[dict[str, Any], float]]:
        """The separate cracks that explain the measurements, best first, with probabilities; more
        than one: they cannot be told apart."""
        branches = self.posterior.branches
        return [(branches[name].values(x), mass) for name, x, mass in self._parts]

    def contains(self, values: Mapping[str, Any], share: float = SHARE) -> bool:
        """Tell whether given values of all unknowns are in the region that holds a share of
        the probability.

        Raises
        ------
        InputError
            An unknown is missing.
        """
        for branch in self.posterior.branches.values():
            model = branch.likelihood.quantities.model
            missing = [key for key in (*model.keys, *model.fixed) if key not in values]
            if missing:
                raise InputError("values", dict(values), f"with {', '.join(missing)}")
            if all(values[key] == word for key, word in model.fixed.items()):
                x = np.array([float(values[key]) for key in model.keys])
                return branch.at(x) >= self.posterior.level(share)
        return False

    def where_to_measure(
        self,
        measurements: Sequence[Measurement] | None = None,
        *,
        frequency_deviation: float = BASELINE,
        harmonic_deviation: float = 0.05,
    ) -> Worth:
        """Worth of one more measurement, from the Fisher information at the estimate.

        Parameters
        ----------
        measurements : sequence of Measurement, optional
            What might be measured; the values do not matter. Default: natural frequencies, and
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
        return worth_of(branch.likelihood, x, measurements, deviations)

    def save(self, folder: str | Path) -> None:
        """Write ``identify.json``, and ``identify.h5``, with it and the posterior (collective).

        Raises
        ------
        InputError
            A file cannot be written.
        """
        parts: dict[str, Any] = {"log_bayes_factor": self.log_bayes_factor}
        for number, (name, branch) in enumerate(self.posterior.branches.items()):
            parts[f"words_{number}"] = name
            parts[f"log_likelihood_{number}"] = branch.height
            parts[f"probability_{number}"] = self.posterior.mass[name]
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
            "reason": self.reason,
            "log_bayes_factor": None if np.isnan(ratio) else ratio,
            "estimate": self.estimate,
            "mesh": self.mesh,
            "intervals": {key: list(ends) for key, ends in self.intervals.items()},
            "since_before": self.since_before,
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
            "deviation": [self.posterior.spread(place) for place in range(len(self.unknown))],
            "low": [intervals[key][0] for key in self.unknown],
            "high": [intervals[key][1] for key in self.unknown],
            "unit": [unit_of(key) for key in self.unknown],
        }

    def fit_table(self) -> Table:
        """Each measurement with what the estimate predicts, both standard deviations, and the
        difference in units of both together."""
        branch, x = self._at
        likelihood = branch.likelihood
        found = likelihood.likeliest(x)
        predicted, spread = found.values[0], found.deviations[0]
        residuals = (likelihood.values - predicted) / np.hypot(likelihood.deviations, spread)
        columns = (likelihood.values, likelihood.deviations, predicted, spread, residuals)
        names = [row.name for row in likelihood.quantities.rows]
        rows = [list(row) for row in zip(names, *(c.tolist() for c in columns), strict=True)]
        return Table(FITTED, rows)

    @property
    def warnings(self) -> list[str]:
        """Points to be careful about: cases that failed, several cracks that fit, a misfit, a crack
        by one measurement alone, an interval that the bounds cut."""
        found, others = [*self.doubts, *_too_sure(self.measurements)], self.alternatives
        if self.verdict == NO_CRACK:
            return found
        if len(others) > 1:
            cracks = [
                " and ".join(f"{key_in_words(k)} {value_in_words(k, v)}" for k, v in values.items())
                + f" ({mass:.0%})"
                for values, mass in others
            ]
            found.append(f"these cracks cannot be told apart: {'; '.join(cracks)}")
        found += _of_fit(self)
        for place, beyond, bound in self.posterior.cut(SHARE):
            key = self.unknown[place]
            where = f"{beyond} {value_in_words(key, bound)}"
            found.append(f"{key_in_words(key)} may be {where}, where it was not looked for")
        return found

    def _title(self) -> str:
        parts = [self.verdict]
        if not np.isnan(self.log_bayes_factor):
            parts[0] += f" (log Bayes factor {self.log_bayes_factor:.3g})"
        if self.verdict == NO_CRACK:
            return parts[0]
        for place, key in enumerate(self.unknown):
            value = value_in_words(key, self.estimate[key])
            parts.append(f"{key} = {value} ± {value_in_words(key, self.posterior.spread(place))}")
        if len(self.alternatives) > 1:
            parts.append("NOT THE ONLY ONE")
        return ", ".join([*parts, *_conditions(self)])


def _too_sure(measurements: Measurements) -> list[str]:
    """Natural frequencies that are said to be known better than any is."""
    rows = [row for row in measurements.rows if row.natural]
    rows = [row for row in rows if row.deviation < KNOWN_TO * row.value]
    if not rows:
        return []
    name, value, deviation = rows[0].name, rows[0].value, rows[0].deviation
    told = f"{name} is said to be known to {deviation:.3g} Hz; a tenth of a degree changes it more"
    return [f"{told}: if that is meant over its value, it is {deviation * value:.3g} Hz"]


def _of_fit(found: Identification) -> list[str]:
    """Probabilities that are not resolved; that no crack explains the measurements, and without
    which one it would be nearest; or that one alone is not explained without a crack."""
    (total, chance), rows, said = found.misfit, found.measurements.rows, []
    if found.posterior.unresolved > LEAST_PART:
        said.append(
            "what is measured leaves less than the places at which probabilities are computed tell "
            f"apart ({found.posterior.unresolved:.0%} of it): the intervals may be far too small; "
            "state all that is not known of the plate (identify.*_deviation), or measure more"
        )
    now = sum(row.quantity != "frequency_uncracked" for row in rows)
    if chance < EXPLAINS:
        told = f"chi^2 = {total:.3g} of {len(rows)}"
        if now > 1:
            left = [one[0] for one in found.posterior.misfits_without_one]
            at = int(np.argmin(left))
            told += f", {left[at]:.3g} without {rows[at].name}"
        said.append(f"no crack of this kind explains the measurements: {told}")
    if now > 1 and found.plain is not None and found.plain.misfit[1] < EXPLAINS:
        pairs = zip(rows, found.plain.misfits_without_one, strict=True)
        if names := [row.name for row, (_, without) in pairs if without >= EXPLAINS]:
            that = "these" if len(names) > 1 else "that"
            alone = f"a plate without a crack explains all but {' or '.join(names)}"
            said.append(f"{alone}: measure {that} again")
    return said


def _verdict_of(found: Identification) -> tuple[str, str]:
    """The verdict and its reason, by what both hypotheses explain, the logarithm of the ratio of
    their evidences, and where a crack would be."""
    open_question = "cannot be told"
    if found.plain is None:
        return open_question, "there is no plate without a crack to compare with"
    fits, healthy, ratio = found.misfit[1], found.plain.misfit[1], found.log_bayes_factor
    told = f"log Bayes factor {ratio:.3g}, crack over no crack"
    if max(fits, healthy) < EXPLAINS:
        why = "neither a crack of this kind nor a plate without one explains the measurements"
        other = "two cracks, one of another kind or elsewhere, or a wrong measurement might"
        return open_question, f"{why}; {other} ({told})"
    if ratio > STRONG and healthy >= EXPLAINS:
        why = "a plate without a crack explains the measurements, as little as is known of it"
        return open_question, f"{why} ({told}){_if_as_before(found)}"
    if ratio < -STRONG:
        unseen = f"{told}; one that is not seen would be at {_where(found)}"
        return NO_CRACK, unseen + _if_as_before(found)
    conditions = _if_alone(found) + _if_as_before(found)
    if ratio > STRONG:
        return "crack", told + _if_warmer(found) + conditions
    return open_question, f"{told}; if there is one it is at {_where(found)}{conditions}"


def _conditions(found: Identification) -> list[str]:
    """Conditions of what is stated, as the title has them."""
    claimed = found.verdict == "crack" and _if_as_before(found)
    alone = ["IF IT IS ONE CRACK"] if _if_alone(found) else []
    return alone + (["IF ITS CLAMP HOLDS AS BEFORE"] if claimed else [])


def _if_alone(found: Identification) -> str:
    """Condition of what is stated, in words, where two cracks have as many unknowns as there are
    measured modes, or more, so that no misfit speaks against two; else empty."""
    table, rows = found.scene.given("identify"), found.measurements.rows
    keys = [axis.key for axis in table.unknown if not isinstance(axis.values[0], str)]
    numbers = len(table.mesh_axes) + sum(key.startswith("crack.") for key in keys)
    modes = {row.mode for row in rows if row.quantity != "frequency_uncracked"}
    if not all(row.natural for row in rows) or len(modes) > 2 * numbers:
        return ""
    told = f"may have the same frequencies of {counted(len(modes), 'mode')}"
    return f"; place and size are those of one crack: two of them, or one elsewhere, {told}"


def _if_as_before(found: Identification) -> str:
    """Condition of what is stated, in words, where a plate without a crack does not explain what is
    measured, but would if as much has changed since before as a clamp may take at all; or where it
    does, but only by what is said to have changed; else empty."""
    table, rows = found.scene.given("identify"), found.measurements.rows
    plain, known = found.plain, any(row.quantity == "frequency_uncracked" for row in rows)
    heat = _by_temperature(table, _whole_of(found).warmer)
    stated, most = max(table.before_deviation, heat), table.clamp_deviation
    if plain is None or not known or stated == 0.0:
        return ""
    healthy = plain.misfit[1] >= EXPLAINS
    if healthy and plain.misfit_since(warmer=0.0)[1] < EXPLAINS:
        return (
            f"; {_modulus(found, plain)}, explains the measurements without a crack: measure the "
            "temperature, too, before and since (temperature), or open the clamp, close it, "
            "measure again and state by what they change (identify.before_deviation)"
        )
    factors = [
        0.0 if healthy else max(1.0, most / one) if one else 1.0
        for one in (table.before_deviation, heat)
    ]
    other = plain.misfit_since(clamp=factors[0], warmer=factors[1])
    if (other[1] >= EXPLAINS) == healthy:
        return ""
    such = f", or {_modulus(found, plain)}," if healthy else ""
    return (
        "; a clamp, a temperature or a sensor that has changed frequencies by "
        f"{stated if healthy else most:.2g} since before{such} explains the measurements without a "
        f"crack (identify.before_deviation = {table.before_deviation:.2g}): open the clamp, close "
        "it, measure again and state there by what they change"
    )


def _if_warmer(found: Identification) -> str:
    """The change of Young's modulus without which a crack does not explain what is measured, in
    words; else empty."""
    if found.posterior.misfit_since(warmer=0.0)[1] >= EXPLAINS:
        return ""
    return f"; with {_modulus(found, found.posterior)}"


def _by_temperature(table: Identify, kelvin: float) -> float:
    """Relative change of all natural frequencies at rest by so many kelvin."""
    return abs(0.5 * table.temperature_coefficient * kelvin)


def _whole_of(found: Identification) -> Whole:
    """The plate without its crack."""
    return next(iter(found.posterior.branches.values())).likelihood.quantities.model.whole


def _modulus(found: Identification, posterior: Posterior) -> str:
    """How Young's modulus likeliest differs from before, in words, "a modulus 1 % lower than
    before, as about 25 K make it"."""
    whole = _whole_of(found)
    kelvin = whole.warmer * posterior.warmer
    change = whole.table.temperature_coefficient * kelvin
    way = "lower" if change < 0.0 else "higher"
    how = f"as about {abs(kelvin):.2g} K {'more' if kelvin > 0.0 else 'less'} make it"
    return f"a Young's modulus {abs(change):.2%} {way} than before, {how}"


def _where(found: Identification) -> str:
    """Bounds of the unknowns with a probability of 95 %, in words, and what is not in the prior."""
    cube = found.posterior.branches[found.posterior.best[0]].likelihood.quantities.model.cube
    told = []
    for (key, ends), least in zip(found.intervals.items(), cube.low, strict=True):
        low, high = (value_in_words(key, end) for end in ends)
        shorter = f", or below {value_in_words(key, least)}, where it was not looked for"
        told.append(f"{key_in_words(key)} {low} to {high}{shorter * (key in OF_SIZE)}")
    return "; ".join(told)
