"""What measurements tell of a crack, and how much one more of them would."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtrc

from fenics_crack.arrivals.harmonics import MISFIT
from fenics_crack.errors import InputError
from fenics_crack.files.store import write
from fenics_crack.identification.measurements import Measurement, Measurements
from fenics_crack.identification.posterior import Branch, Posterior
from fenics_crack.identification.where_to_measure import Worth, worth_of
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.words import key_in_words, unit_of, value_in_words
from fenics_crack.table import Table, Tabular
from fenics_crack.whole import write_whole

__all__ = ["SHARE", "Identification"]

SHARE = 0.95
"""Probability of the regions and intervals that are stated."""
STRONG = 3.0
"""Logarithm of the ratio of evidences, 20 to 1, from which a hypothesis is preferred."""
LEAST_PART = 0.03
"""Probability of a part of the region that is mentioned."""


@dataclass(frozen=True, repr=False)
class Identification(Tabular):
    """The unknowns, how sure they are, and whether there is a crack at all.

    Attributes
    ----------
    scene : Scene
        The scene with its table ``[identify]``.
    measurements : Measurements
        What was measured.
    posterior : Posterior
        The probability of the unknowns, on a grid.
    uncracked : float
        log of the evidence of the plate without its crack; nan where this was not considered.
    remarks : tuple of str
        What these measurements cannot tell.
    """

    scene: Scene
    measurements: Measurements
    posterior: Posterior
    uncracked: float
    remarks: tuple[str, ...]

    @property
    def unknown(self) -> tuple[str, ...]:
        """The unknowns that are numbers."""
        return self._branch.likelihood.quantities.model.keys

    @property
    def estimate(self) -> dict[str, Any]:
        """The unknowns at which the likelihood is largest, words too."""
        x = self.posterior.best[1]
        model = self._branch.likelihood.quantities.model
        return model.fixed | dict(zip(self.unknown, x.tolist(), strict=True))

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """Bounds of each unknown with a probability of 95 %."""
        found = self.posterior.interval
        return {key: found(place, SHARE) for place, key in enumerate(self.unknown)}

    @property
    def log_bayes_factor(self) -> float:
        """log of the evidence of a crack over that of none; nan where none was not considered."""
        return self.posterior.log_evidence - self.uncracked

    @property
    def verdict(self) -> str:
        """The word "crack" or "no crack" where one is 20 times as likely as the other, else
        "undecided"; "crack" where no crack was not considered."""
        ratio = self.log_bayes_factor
        if np.isnan(ratio) or ratio > STRONG:
            return "crack"
        return "no crack" if ratio < -STRONG else "undecided"

    @property
    def misfit(self) -> tuple[float, float]:
        """chi^2 at the estimate, and the probability of more, by chance, with as many measurements
        (of displacements three fewer, for what is not known of the load)."""
        likelihood, x = self._branch.likelihood, self.posterior.best[1][None]
        total = float(np.sum(likelihood.residuals(x)[0, :-1] ** 2))
        count = len(likelihood.values) - likelihood.quantities(x).free.shape[2]
        return total, float(chdtrc(max(count, 1), total))

    @property
    def alternatives(self) -> list[tuple[dict[str, Any], float]]:
        """The separate cracks that explain the measurements, best first, with probabilities; more
        than one: they cannot be told apart."""
        found = []
        for name, x, mass in self.posterior.parts(SHARE, LEAST_PART):
            model = self.posterior.branches[name].likelihood.quantities.model
            values = model.fixed | dict(zip(self.unknown, x.tolist(), strict=True))
            found.append((values, mass))
        return found

    def contains(self, values: Mapping[str, Any], share: float = SHARE) -> bool:
        """Tell whether given values of all unknowns are in the region that holds a share of
        the probability.

        Raises
        ------
        InputError
            An unknown is missing.
        """
        for name, branch in self.posterior.branches.items():
            model = branch.likelihood.quantities.model
            missing = [key for key in (*model.keys, *model.fixed) if key not in values]
            if missing:
                raise InputError("values", dict(values), f"with {', '.join(missing)}")
            if all(values[key] == word for key, word in model.fixed.items()):
                x = np.array([[float(values[key]) for key in model.keys]])
                height = float(self.posterior.branches[name].likelihood(x)[0])
                return height >= self.posterior.level(share)
        return False

    def where_to_measure(
        self,
        measurements: Sequence[Measurement] | None = None,
        *,
        frequency_deviation: float = 1e-3,
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
        return worth_of(self._branch.likelihood, self.posterior.best[1], measurements, deviations)

    def save(self, folder: str | Path) -> None:
        """Write ``identify.h5``, the posterior on its grid, and ``identify.json`` (collective).

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
        write(parts, Path(folder) / "identify.h5", "identification", self.scene)
        text = json.dumps(self.summary(), indent=1, ensure_ascii=False)
        write_whole(Path(folder) / "identify.json", text + "\n")

    @property
    def _branch(self) -> Branch:
        return self.posterior.branches[self.posterior.best[0]]

    # --- shown ------------------------------------------------------------------------------------

    def summary(self) -> dict[str, Any]:
        """Everything in words and numbers, as ``identify.json`` has it."""
        ratio = self.log_bayes_factor
        total, chance = self.misfit
        return {
            "verdict": self.verdict,
            "log_bayes_factor": None if np.isnan(ratio) else ratio,
            "estimate": self.estimate,
            "intervals": {key: list(ends) for key, ends in self.intervals.items()},
            "alternatives": [
                {"values": values, "probability": mass} for values, mass in self.alternatives
            ],
            "chi_square": total,
            "probability_of_misfit": chance,
            "remarks": list(self.remarks),
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
        likelihood, x = self._branch.likelihood, self.posterior.best[1][None]
        found = likelihood.quantities(x)
        predicted, spread = found.values[0], found.deviations[0]
        residuals = (likelihood.values - predicted) / np.hypot(likelihood.deviations, spread)
        columns = (likelihood.values, likelihood.deviations, predicted, spread, residuals)
        names = [row.name for row in likelihood.quantities.rows]
        rows = [list(row) for row in zip(names, *(c.tolist() for c in columns), strict=True)]
        head = ("measurement", "value", "deviation", "predicted", "of the model", "residual")
        return Table(head, rows)

    @property
    def warnings(self) -> list[str]:
        """Points to be careful about: several cracks that fit, a misfit, an estimate at a bound."""
        found = []
        others = self.alternatives
        if len(others) > 1:
            told = [
                " and ".join(f"{key_in_words(k)} {value_in_words(k, v)}" for k, v in values.items())
                + f" ({mass:.0%})"
                for values, mass in others
            ]
            found.append(f"these cracks cannot be told apart: {'; '.join(told)}")
        total, chance = self.misfit
        if chance < MISFIT:
            count = len(self._branch.likelihood.values)
            found.append(
                f"no crack of this kind explains the measurements: chi^2 = {total:.3g} of {count}"
            )
        cube = self._branch.likelihood.quantities.model.cube
        bounds = zip(self.unknown, self.posterior.best[1], cube.low, cube.high, strict=True)
        for key, value, low, high in bounds:
            margin = 1e-3 * (high - low)
            if not low + margin < value < high - margin:
                found.append(f"{key_in_words(key)} is at the end of where it was looked for")
        return found

    def _title(self) -> str:
        parts = [self.verdict]
        if not np.isnan(self.log_bayes_factor):
            parts[0] += f" (log Bayes factor {self.log_bayes_factor:.3g})"
        for place, key in enumerate(self.unknown):
            value = value_in_words(key, self.estimate[key])
            spread = value_in_words(key, self.posterior.spread(place))
            parts.append(f"{key} = {value} ± {spread}")
        if len(self.alternatives) > 1:
            parts.append("NOT THE ONLY ONE")
        return ", ".join(parts)
