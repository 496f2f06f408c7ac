"""Where to measure: what one more measurement would tell.

With predictions s_i and variances v_i, the Fisher information of the unknowns x is

    F = sum_i (ds_i / dx) (ds_i / dx)^T / v_i + P,

where P is that of the prior. One more measurement j adds a term of its own; in nats it tells

    log(1 + (ds_j / dx)^T F^-1 (ds_j / dx) / v_j) / 2

(A. C. Atkinson, A. N. Donev and R. D. Tobias, Optimum Experimental Designs, 2007, chapter 11:
D-optimality).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fenics_crack.errors import check_number
from fenics_crack.identification.measurements import Measurement
from fenics_crack.identification.posterior import Likelihood
from fenics_crack.scene.words import unit_of
from fenics_crack.table import Tabular

__all__ = ["Worth", "worth_of"]

STEP = 1e-3
"""Of an unknown, over its range, for derivatives."""


@dataclass(frozen=True, repr=False)
class Worth(Tabular):
    """What might be measured, most informative first.

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
    """What more measurements would tell at an estimate x (d,) from some measurements.

    Raises
    ------
    InputError
        A standard deviation is not > 0, or a measurement is not one of the forward model.
    """
    names = ("frequency_deviation", "harmonic_deviation")
    for name, deviation in zip(names, deviations, strict=True):
        check_number(name, deviation, 0.0, above=True)
    model = likelihood.quantities.model
    rows = model.candidates() if measurements is None else tuple(measurements)
    quantities = model.quantities(rows)
    span = model.cube.high - model.cube.low
    values, spread = (part[0] for part in quantities(x[None]))
    if measurements is None:
        shares = np.array([deviations[0] if row.natural else deviations[1] for row in rows])
        noise = shares * values
    else:
        noise = np.array([row.deviation for row in rows])
    slopes = _slopes(quantities, x, span, model.cube.low, model.cube.high)
    variance = noise**2 + spread**2
    known = np.isfinite(variance) & (variance > 0.0) & np.all(np.isfinite(slopes), axis=1)
    mine = _slopes(likelihood.quantities, x, span, model.cube.low, model.cube.high)
    total = likelihood.residuals(x[None])[1][0]
    information = (mine / total[:, None]).T @ (mine / total[:, None]) + 12.0 * np.eye(len(x))
    before = np.linalg.inv(information)
    found = []
    for place in np.flatnonzero(known):
        slope = slopes[place] / np.sqrt(variance[place])
        gain = 0.5 * np.log1p(slope @ before @ slope)
        after = np.sqrt(np.diag(np.linalg.inv(information + np.outer(slope, slope)))) * span
        row = rows[place]
        told = Measurement(
            row.quantity, float(values[place]), float(noise[place]), row.mode, row.frequency,
            row.point,
        )  # fmt: skip
        found.append((gain, told, after))
    found.sort(key=lambda item: -item[0])
    now = np.sqrt(np.diag(before)) * span
    return Worth(
        tuple(told for _, told, _ in found),
        np.array([gain for gain, _, _ in found]),
        {key: np.array([after[k] for *_, after in found]) for k, key in enumerate(model.keys)},
        dict(zip(model.keys, now.tolist(), strict=True)),
    )


def _slopes(
    quantities: Any, x: np.ndarray, span: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Derivatives by the unknowns over their ranges: (q, d)."""
    steps = np.diag(STEP * span)
    above, below = np.minimum(x + steps, high), np.maximum(x - steps, low)
    distance = np.diag(above - below) / span
    difference = quantities(above)[0] - quantities(below)[0]
    return np.asarray((difference / distance[:, None]).T)
