"""What the commands print and store of a result, as tables."""

from __future__ import annotations

import dataclasses

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.curve import PARAMETERS, ResponseCurve
from fenics_crack.model.modes import Modes
from fenics_crack.study.run import Run
from fenics_crack.table import Table
from fenics_crack.time.march import TimeHistory

__all__ = [
    "curve_points",
    "history_quantities",
    "history_waves",
    "mode_frequencies",
    "solution_quantities",
    "solution_waves",
    "special_points",
    "stability_changes",
]

QUANTITIES = ("quantity", "value", "unit")
SHARE = "of the lips' motion"
MOUTH, FORCE = "closing at the mouth [m]", "contact force, all pairs [N]"


def mode_frequencies(run: Run[Modes]) -> Table:
    """Natural frequencies."""
    rows = [(n, omega, omega / (2.0 * np.pi)) for n, omega in enumerate(run.result.omega, 1)]
    return Table(("mode", "omega [rad/s]", "frequency [Hz]"), rows)


# --- a periodic solution --------------------------------------------------------------------------


def solution_quantities(run: Run[PeriodicSolution]) -> Table:
    """A solution in numbers."""
    found = run.result
    time = np.linspace(0.0, found.period, 1024, endpoint=False)
    motion = found.displacement(time, [run.watched_dof])
    rows: list[tuple[str, object, str]] = [
        ("omega", found.omega, "rad/s"),
        ("frequency", found.omega / (2.0 * np.pi), "Hz"),
        *_extremes(run, motion, found.gap(time)),
    ]
    if found.gap_coefficients.size:
        force = found.contact_force(time)
        rows += [
            ("largest contact force of a pair", float(force.max()), "N"),
            ("share of the period closed, mean over pairs", float((force > 0.0).mean()), "-"),
        ]
    if found.stability is not None:
        rows += [
            ("verdict", found.stability.verdict, "-"),
            ("largest multiplier", float(np.abs(found.stability.multipliers[0])), "-"),
        ]
    rows += [("converged", found.converged, "-"), ("iterations", found.iterations, "-")]
    if found.gap_coefficients.size:
        errors = dataclasses.asdict(found.report)
        penetration = errors.pop("penetration")
        rows += [(f"estimated error: {name}", value, SHARE) for name, value in errors.items()]
        rows += [
            ("estimated error: total", found.report.total, SHARE),
            ("penetration", penetration, SHARE),
        ]
    return Table(QUANTITIES, rows)


def solution_waves(run: Run[PeriodicSolution]) -> Table:
    """One period: the load's dof, the mouth and the contact force over time."""
    found = run.result
    time = np.linspace(0.0, found.period, 401)
    waves = [time, found.displacement(time, [run.watched_dof])[:, 0]]
    columns = ["time [s]", f"{run.watched_name} [m]"]
    if found.gap_coefficients.size:
        waves += [found.gap(time)[:, 0], found.contact_force(time).sum(axis=1)]
        columns += [MOUTH, FORCE]
    return Table(columns, np.column_stack(waves).tolist())


def _extremes(run: Run, motion: np.ndarray, gap: np.ndarray) -> list[tuple[str, float, str]]:
    """How far the load's dof moves, and of the pairs, if there are any, how far they do."""
    rows = [(f"half peak-to-peak, {run.watched_name}", float(np.ptp(motion) / 2.0), "m")]
    if gap.size:
        rows.append(("largest opening", float(-gap.min()), "m"))
        rows.append(("largest penetration", float(max(gap.max(), 0.0)), "m"))
    return rows


# --- a curve --------------------------------------------------------------------------------------


def curve_points(run: Run[ResponseCurve]) -> Table:
    """Every point of a curve."""
    found = run.result
    columns = [PARAMETERS[found.parameter], f"{run.watched_name} [m]", "iterations"]
    values = [found.values, found.amplitude(run.watched_dof), found.iterations]
    if found.multipliers is not None:
        columns.append("largest multiplier")
        values.append(np.abs(found.multipliers))
    return Table(columns, list(zip(*[column.tolist() for column in values], strict=True)))


def special_points(run: Run[ResponseCurve]) -> Table:
    """Ends, largest response, bifurcations and changes of stability."""
    found, dof = run.result, run.watched_dof
    amplitude = found.amplitude(dof)
    rows = [
        (name, found.values[index], amplitude[index])
        for name, index in (("start", 0), ("end", -1), ("largest", int(np.argmax(amplitude))))
    ]
    for point in found.bifurcations:
        time = np.linspace(0.0, point.solution.period, 257)
        motion = point.solution.displacement(time, [dof])
        rows.append((point.kind.replace("_", " "), point.value, np.ptp(motion) / 2.0))
    for index in stability_changes(found):
        what = "stability lost after" if found.stable[index] else "stability gained after"
        rows.append((what, found.values[index], amplitude[index]))
    columns = (
        "point", PARAMETERS[found.parameter], f"half peak-to-peak, {run.watched_name} [m]",
    )  # fmt: skip
    return Table(columns, rows)


def stability_changes(curve: ResponseCurve) -> list[int]:
    """Points after which the stability is another, where it is known."""
    if curve.multipliers is None:
        return []
    return [int(index) for index in np.flatnonzero(np.diff(curve.stable))]


# --- a motion in time -----------------------------------------------------------------------------


def history_quantities(run: Run[TimeHistory]) -> Table:
    """A motion in numbers."""
    found = run.result
    rows = [
        ("periods", found.periods, "-"),
        ("steps in a period", found.steps_per_period, "-"),
        ("change over the last period", found.settled, "-"),
        ("energy created", found.created_energy, "-"),
        *_extremes(run, found.displacement([run.watched_dof])[:, 0], found.gap),
    ]
    return Table(QUANTITIES, rows)


def history_waves(run: Run[TimeHistory]) -> Table:
    """Its last periods: the load's dof, the mouth and the contact force over time."""
    found = run.result
    motion = found.displacement([run.watched_dof])[:, 0]
    waves = np.column_stack([found.time, motion, found.gap[:, 0], found.contact_force.sum(axis=1)])
    return Table(("time [s]", f"{run.watched_name} [m]", MOUTH, FORCE), waves.tolist())
