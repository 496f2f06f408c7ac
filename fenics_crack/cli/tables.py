"""What the commands print and store of a result, as tables."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution, contact_extremes
from fenics_crack.curves.curve import PARAMETERS, ResponseCurve
from fenics_crack.study.run import Run
from fenics_crack.table import Table
from fenics_crack.time.march import TimeHistory

__all__ = [
    "curve_points",
    "history_quantities",
    "history_waves",
    "solution_quantities",
    "solution_waves",
    "special_points",
    "stability_changes",
]

SHARE = "of the lips' motion"
QUANTITIES = {
    "periods": ("periods", "-"),
    "steps_per_period": ("steps in a period", "-"),
    "settled": ("change over the last period", "-"),
    "created_energy": ("energy created", "-"),
    "omega": ("omega", "rad/s"),
    "frequency": ("frequency", "Hz"),
    "amplitude": ("half peak-to-peak, {}", "m"),
    "opening": ("largest opening", "m"),
    "penetration": ("largest penetration", "m"),
    "contact_force": ("largest contact force of a pair", "N"),
    "closed_share": ("share of the period closed, mean over pairs", "-"),
    "verdict": ("verdict", "-"),
    "multiplier": ("largest multiplier", "-"),
    "converged": ("converged", "-"),
    "iterations": ("iterations", "-"),
    "residual_error": ("estimated error: residual", SHARE),
    "truncation_error": ("estimated error: truncation", SHARE),
    "sampling_error": ("estimated error: sampling", SHARE),
    "reduction_error": ("estimated error: reduction", SHARE),
    "displacement_error": ("estimated error: displacement at the load", SHARE),
    "total_error": ("estimated error: total", SHARE),
    "penetration_share": ("penetration", SHARE),
}
"""Label and unit of what is printed of a solution or a motion, in this order."""


def solution_quantities(run: Run[PeriodicSolution]) -> Table:
    """The numbers of a solution, and its verdict."""
    found = run.result
    values = found.to_dict() | {"frequency": found.omega / (2.0 * np.pi)}
    if not values["pairs"]:  # no errors were estimated
        values = {n: v for n, v in values.items() if not n.endswith(("_error", "_share"))}
    return _quantities(run, values | {"amplitude": found.amplitude(run.watched_dof)})


def history_quantities(run: Run[TimeHistory]) -> Table:
    """The numbers of a motion in time."""
    found = run.result
    motion = found.displacement([run.watched_dof])
    values = vars(found) | {"amplitude": float(np.ptp(motion) / 2.0)}
    return _quantities(run, values | contact_extremes(found.gap, found.contact_force))


def _quantities(run: Run, values: Mapping[str, object]) -> Table:
    rows = [
        (label.format(run.watched_name), values[name], unit)
        for name, (label, unit) in QUANTITIES.items()
        if name in values
    ]
    return Table(("quantity", "value", "unit"), rows)


def solution_waves(run: Run[PeriodicSolution]) -> Table:
    """One period of a solution: the load's dof, the mouth and the contact force over time."""
    found = run.result
    time = np.linspace(0.0, found.period, 401)
    motion = found.displacement(time, [run.watched_dof])
    return _waves(run, time, motion, found.gap(time), found.contact_force(time))


def history_waves(run: Run[TimeHistory]) -> Table:
    """The last periods of a motion, likewise."""
    found = run.result
    motion = found.displacement([run.watched_dof])
    return _waves(run, found.time, motion, found.gap, found.contact_force)


def _waves(
    run: Run, time: np.ndarray, motion: np.ndarray, gap: np.ndarray, force: np.ndarray
) -> Table:
    contact = [gap[:, 0], force.sum(axis=1)] if gap.size else []
    waves = np.column_stack([time, motion, *contact])
    names = ("closing at the mouth [m]", "contact force, all pairs [N]")[: len(contact)]
    return Table(("time [s]", f"{run.watched_name} [m]", *names), waves.tolist())


def curve_points(run: Run[ResponseCurve]) -> Table:
    """Every point of a curve, with the amplitude of the load's dof."""
    table = run.result.table()
    heights = run.result.amplitude(run.watched_dof).tolist()
    rows = [[*row, height] for row, height in zip(table.rows, heights, strict=True)]
    return Table((*table.columns, f"half peak-to-peak, {run.watched_name} [m]"), rows)


def special_points(run: Run[ResponseCurve]) -> Table:
    """Ends, largest response, bifurcations and changes of stability."""
    found, dof = run.result, run.watched_dof
    amplitude = found.amplitude(dof)
    places = [("start", 0), ("end", -1), ("largest", int(np.argmax(amplitude)))]
    rows = [(name, found.values[index], amplitude[index]) for name, index in places]
    for point in found.bifurcations:
        name = point.kind.replace("_", " ")
        if found.undecided is not None:
            name += f", exact {point.exact:.6g}" if point.confirmed else ", unconfirmed"
        rows.append((name, point.value, point.solution.amplitude(dof)))
    for index in stability_changes(found):
        after = found.verdicts[index + 1]
        what = {"stable": "gained", "unstable": "lost", "undecided": "undecided"}[after]
        rows.append((f"stability {what} after", found.values[index], amplitude[index]))
    height = f"half peak-to-peak, {run.watched_name} [m]"
    return Table(("point", PARAMETERS[found.parameter], height), rows)


def stability_changes(curve: ResponseCurve) -> list[int]:
    """Points after which the stability is another, where it is known."""
    if curve.multipliers is None:
        return []
    verdicts = curve.verdicts
    return [int(index) for index in np.flatnonzero(verdicts[1:] != verdicts[:-1])]
