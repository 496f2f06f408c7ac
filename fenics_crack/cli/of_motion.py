"""What there is to say of modes, of a steady vibration and of a motion in time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.cli.account import (
    OTHERS,
    Account,
    frequency_in_words,
    how_it_is_left,
    in_short,
    known_to,
    largest_seen,
    of_error,
    of_size,
    of_stability,
    readable_rows,
)
from fenics_crack.cli.scenes import remark_on
from fenics_crack.model.bilinear import KINDS, bilinear_frequencies
from fenics_crack.model.modes import Modes
from fenics_crack.scene.quantities import OF_FREQUENCIES, OF_LIPS, OF_POINTS, QUANTITIES, SHORT
from fenics_crack.scene.tables import Integration
from fenics_crack.study.asked import asked_of_motion
from fenics_crack.study.coarser_mesh import natural_name
from fenics_crack.study.key_figures import highest_omega
from fenics_crack.study.prepare import Watched
from fenics_crack.study.run import Run
from fenics_crack.table import Table, quantity
from fenics_crack.time.march import TimeHistory

__all__ = [
    "account_of_history", "account_of_modes", "account_of_solution", "closings", "with_hertz",
]  # fmt: skip

ERROR = "error [%]"
"""Of modes, harmonics and mesh, as far as it is known."""
Row = tuple[str, str, object, str]
"""Name, words, value, unit."""


def account_of_modes(run: Run[Modes]) -> Account:
    """Natural frequencies and mode shapes with the crack open."""
    found, table = run.result, run.result.table()
    first = float(found.omega[0])
    hertz = first / (2.0 * np.pi)
    names = [natural_name(run.scene, "open", number + 1) for number in range(len(found.omega))]
    known = known_to(run, names[0])
    fact = f"The first natural frequency with the crack open is {hertz:.5g} Hz ({first:.5g} rad/s)"
    fact += f", known to {known}." if known else "."
    if run.stated is not None:
        rows = [[*row, _errors(run, name)[0]] for row, name in zip(table.rows, names, strict=True)]
        table = Table([*table.columns, ERROR], rows)
    tables = {"Natural frequencies with the crack open": table}
    return Account("modes", table, facts=[fact], tables=tables, run=run)


# --- a steady vibration ---------------------------------------------------------------------------


def account_of_solution(run: Run[PeriodicSolution]) -> Account:
    """A solution, its error and its stability (collective)."""
    found, scene = run.result, run.scene
    table = _quantities(run, found.to_dict())
    notes = [remark_on(run.structure, highest_omega(scene, "solve"))]
    if found.converged and found.stability is None and run.structure.n_pairs:
        notes.append(
            "the stability is not judged, as that would take long: it is for a reduced structure, "
            "with contact.law = 'unilateral' for lips without mass (reduction.method)"
        )
    known = known_to(run, run.watched[0].column("amplitude"))
    tolerance = scene.harmonic_balance.tolerance
    missed = tolerance is not None and found.report.total > tolerance
    warnings = []
    if not found.converged or missed:
        failed = "" if found.converged else "not converged: "
        warnings.append(f"{failed}{found.status}")
    elif run.structure.n_pairs:
        warnings += of_error(scene, found.report, found.harmonics)
    if found.still:
        warnings.append("nothing vibrates: no load changes in time")
    if found.converged and not missed and known:
        notes.insert(0, f"solved; the half peak-to-peak displacement is known to {known}")
    if found.converged:
        warnings += of_stability(scene, run, found.stability)
        warnings += of_size(run, largest_seen(run))
        warnings += run.stated.dents if run.stated is not None else ()
    return Account(
        "solution",
        table,
        rows=_solution_waves(run),
        shown=in_short(table, scene, SHORT),
        facts=_facts(run),
        verdict=_verdict(found),
        notes=notes,
        warnings=warnings,
        tables={"In numbers": readable_rows(table)},
        done=found.converged,
        missed=missed,
        run=run,
    )


def _facts(run: Run[PeriodicSolution]) -> Iterator[str]:
    """The response, and the error report sentence by sentence."""
    found, report = run.result, run.result.report
    size = quantity(found.amplitude(run.watched_dof), "m")
    fact = f"At {frequency_in_words(run.scene, found.omega)} the {run.watched_name} is {size} half "
    known = known_to(run, run.watched[0].column("amplitude"))
    fact += f"peak-to-peak (known to {known})" if known else "peak-to-peak"
    if not found.gap_coefficients.size:
        yield f"{fact}."
        yield "There is no contact: the solution is exact for its mesh and modes."
        return
    values = found.to_dict()
    yield (
        f"{fact}; the crack opens by {quantity(values['opening'], 'm')} and is closed "
        f"for {values['closed_share']:.0%} of the period."
    )
    causes = {
        "the harmonics left out": report.truncation,
        "the modes left out": report.reduction,
        "contact forces taken from samples": report.sampling,
        "equations not solved exactly": report.residual,
    }
    name = max(causes, key=causes.__getitem__)
    yield (
        f"Without the mesh, the motion of the lips is known to about {report.total:.2%}; most of "
        f"that is due to {name} ({causes[name]:.2%})."
    )
    yield f"The displacement at the load is then known to about {report.displacement:.2%}."
    if report.penetration > 0.0:
        yield (
            f"The contact law lets the lips penetrate by {report.penetration:.2%} of their motion; "
            "this belongs to the law, and is no error of its solution."
        )


def _verdict(found: PeriodicSolution) -> tuple[str, str]:
    """Whether the vibration lasts, and the kind of this verdict."""
    if not found.converged:
        return "Not converged: there is no orbit to be judged.", "bad"
    if found.stability is None:
        return "The stability was not examined.", "doubtful"
    judged = found.stability
    grows = f"grows, and a motion in time leaves it{how_it_is_left(judged)}"
    undecided = f"Undecided: {judged.reason or 'more harmonics may decide'}", "doubtful"
    text, kind = {
        "stable": ("Stable: a small disturbance dies out", "good"),
        "unstable": (f"Unstable: a small disturbance {grows}", "bad"),
    }.get(judged.verdict, undecided)
    return f"{text} (largest multiplier {np.abs(judged.multipliers).max():.6g}).", kind


# --- a motion in time -----------------------------------------------------------------------------


def account_of_history(run: Run[TimeHistory]) -> Account:
    """A motion from rest, and whether it repeats (collective)."""
    found, scene = run.result, run.scene
    distance = found.distance
    values = vars(found) | {"distance": distance} | found.indicators().to_dict()
    table = _quantities(run, values)
    asked = scene.integration or Integration()
    change = f"a period changes it by {found.settled:.2g}"
    left = f", and it is {distance:.2g} from where it settles" if distance < 1.0 else ""
    facts = [f"The motion in time has settled after {found.periods} periods: {change}{left}."]
    warnings = []
    if not found.settled <= asked.settle:
        facts = [f"The motion in time was followed over {found.periods} periods."]
        warnings = [
            f"the motion has not settled after {found.periods} of {asked.periods} periods: "
            f"{change}{_longer_period(found)}"
        ]
    motion = found.displacement([watched.dof for watched in run.watched])

    return Account(
        "integration",
        table,
        rows=_waves(run, found.time, motion, found.gap, found.contact_force),
        shown=in_short(table, scene, SHORT),
        facts=facts,
        warnings=[*warnings, *of_size(run, np.abs(motion).max(axis=0))],
        tables={"In numbers": readable_rows(table)},
        done=bool(found.settled <= asked.settle),
        run=run,
    )


def _longer_period(found: TimeHistory) -> str:
    """A hint why a motion has not settled: it may repeat after two or three load periods."""
    waves = found.by_period(found.gap)
    for count in range(2, len(waves)):
        change = np.linalg.norm(waves[-1] - waves[-1 - count]) / np.linalg.norm(waves[-1])
        if change < 0.1 * found.settled:
            return f", {count} periods only by {change:.2g}: its period is {count} times the load's"
    return "; it may need more of them (integration.periods), or be irregular"


# --- their numbers --------------------------------------------------------------------------------


def _quantities(run: Run[Any], values: Mapping[str, object]) -> Table:
    """The numbers of a vibration or a motion: indicators of each watched dof, those of the lips,
    natural frequencies, and others (collective)."""
    omega = run.scene.excitation.omega if isinstance(run.result, TimeHistory) else run.result.omega
    rows: list[Row] = [("omega", "omega", omega, "rad/s")]
    rows.append(("frequency", "frequency", omega / (2.0 * np.pi), "Hz"))
    for watched in run.watched:
        rows += _of_point(watched, run.result.indicators(watched.dof).to_dict())
    if not run.structure.n_pairs:  # no errors were estimated
        values = {n: v for n, v in values.items() if not n.endswith(("_error", "_share"))}
    rows += _named(OF_LIPS, values)
    rows += _named(QUANTITIES, asked_of_motion(run, run.result))
    if run.structure.n_pairs and isinstance(run.result, PeriodicSolution):
        near = bilinear_frequencies(run.structure).nearest(omega)
        rows += (
            (name, f"{words}, mode {near['mode']}", float(value), _shown(unit))
            for name, words, unit, value in with_hertz(near)
        )
    columns, rows = ["name", "quantity", "value", "unit"], [*rows, *_named(OTHERS, values)]
    if run.stated is None:
        return Table(columns, rows)
    return Table([*columns, ERROR, "most by"], [(*row, *_errors(run, row[0])) for row in rows])


def _errors(run: Run[Any], name: str) -> tuple[float, str]:
    """Error of a number [%], and what most of it is by; of natural frequencies that of the mode
    which is named."""
    assert run.stated is not None
    kind = name.rpartition("_")[2]
    if kind in KINDS:
        mode = bilinear_frequencies(run.structure).nearest(run.result.omega)["mode"]
        name = natural_name(run.scene, kind, int(mode))
    error, cause = run.stated.stated(name)
    return float(f"{100.0 * error:.3g}"), cause


def _of_point(watched: Watched, values: Mapping[str, object]) -> list[Row]:
    """What is known of a watched dof; the load's is said once."""
    order = values["largest_order"]
    largest = {"ratio_largest": (f"largest harmonic ratio, {order:.0f}/1", "1")}
    return [
        (
            watched.column(name),
            f"{words}, {watched.words}" if watched.name or name == "amplitude" else words,
            value,
            unit,
        )
        for name, words, value, unit in _named(OF_POINTS | largest, values)
    ]


def _named(known: Mapping[str, tuple[str, str]], values: Mapping[str, object]) -> list[Row]:
    """Those of some values that have words and a unit."""
    return [
        (n, words, values[n], _shown(unit)) for n, (words, unit) in known.items() if n in values
    ]


def _shown(unit: str) -> str:
    return "-" if unit == "1" else unit


def with_hertz(near: Mapping[str, np.ndarray]) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Names, words, units and values of natural frequencies: "omega_open", "frequency_open"..."""
    for name, (words, unit) in OF_FREQUENCIES.items():
        yield name, words, unit, near[name]
        if unit == "rad/s":
            yield name.replace("omega", "frequency"), words, "Hz", near[name] / (2.0 * np.pi)


# --- their waves ----------------------------------------------------------------------------------


def _solution_waves(run: Run[PeriodicSolution]) -> Table:
    """One period of a solution."""
    found = run.result
    time = np.linspace(0.0, found.period, 401)
    motion = found.displacement(time, [watched.dof for watched in run.watched])
    return _waves(run, time, motion, found.gap(time), found.contact_force(time))


def _waves(
    run: Run, time: np.ndarray, motion: np.ndarray, gap: np.ndarray, force: np.ndarray
) -> Table:
    """Watched dofs, the mouths of the cracks and the contact force over time."""
    columns = [f"{watched.words} [m]" for watched in run.watched]
    values = [time, *motion.T]
    if gap.size:
        for words, wave in closings(run, gap):
            columns.append(f"{words} [m]")
            values.append(wave)
        columns.append("contact force, all pairs [N]")
        values.append(force.sum(axis=1))
    return Table(("time [s]", *columns), np.column_stack(values).tolist())


def closings(run: Run, gap: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Where each crack is watched, and how far its lips close there."""
    structure = run.structure.whole
    for pair in structure.watched_pairs.values():
        yield f"closing {structure.where(pair)}", gap[:, pair]
