"""Where to measure: what one more measurement would tell.

With predictions s and the covariance V of measurements and predictions, the Fisher information of
the unknowns x is

    F = (ds / dx)^T V^-1 (ds / dx) + P,

where P is that of the prior. One more measurement j adds what is new in it, with a slope t_j and a
variance v_j given the others; in nats it tells

    log(1 + t_j^T F^-1 t_j / v_j) / 2,
    t_j = ds_j / dx - V_j V^-1 ds / dx,      v_j = V_jj - V_j V^-1 V_j^T

(A. C. Atkinson, A. N. Donev and R. D. Tobias, Optimum Experimental Designs, 2007, chapter 11:
D-optimality).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fenics_crack.errors import check_number
from fenics_crack.identification.measurements import Measurement
from fenics_crack.identification.model import Quantities
from fenics_crack.identification.posterior import PRIOR, Likelihood, scaled_covariance
from fenics_crack.scene.words import key_in_words, unit_of, value_in_words
from fenics_crack.table import Tabular

__all__ = ["BASELINE", "Worth", "advice", "worth_of"]

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
    covariance, slopes = _seen(quantities, x, every)
    span = model.cube.high - model.cube.low
    # What is new in one more measurement, given those that were made.
    mine, mixed = covariance[:count, :count], covariance[:count, count:]
    weights = np.linalg.solve(mine, np.hstack([slopes[:count], mixed]))
    information = slopes[:count].T @ weights[:, : len(x)] + PRIOR * np.eye(len(x))
    left = np.diag(covariance)[count:] - np.sum(mixed * weights[:, len(x) :], axis=0)
    new = (slopes[count:] - mixed.T @ weights[:, : len(x)]) / np.sqrt(left)[:, None]
    before = np.linalg.inv(information)
    moved = new @ before
    gained = np.sum(moved * new, axis=1)
    other = (model.act_as(x[None])[0] / span) ** 2
    after = np.sqrt(np.diag(before) - moved**2 / (1.0 + gained)[:, None] + other) * span
    best = [int(at) for at in np.argsort(-gained, kind="stable") if fit[at]]
    return Worth(
        tuple(
            replace(rows[at], value=float(values[count + at]), deviation=float(noise[at]))
            for at in best
        ),
        0.5 * np.log1p(gained[best]),
        {key: after[best, place] for place, key in enumerate(model.keys)},
        dict(zip(model.keys, (np.sqrt(np.diag(before) + other) * span).tolist(), strict=True)),
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
        modes = ", ".join(map(str, missing))
        what = f"natural frequencies {modes} before there was a crack (frequency_uncracked)"
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
    covariance, slopes = _seen(quantities, x, every)
    span = model.cube.high - model.cube.low
    information = slopes.T @ np.linalg.solve(covariance, slopes) + PRIOR * np.eye(len(x))
    left = np.hypot(np.sqrt(np.diag(np.linalg.inv(information))) * span, model.act_as(x[None])[0])
    return dict(zip(model.keys, left.tolist(), strict=True))


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
