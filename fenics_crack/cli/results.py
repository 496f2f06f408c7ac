"""Accounts of modes, of a steady vibration, of a curve and of a motion in time; and the results of
all commands: their readers, their accounts, their headings in a report."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import INTERRUPTED, ConvergenceError, InputError
from fenics_crack.basics.observables import PRINTED, QUANTITIES, SPECIAL, Place, names_of
from fenics_crack.basics.tables import (
    FEW_ROWS,
    LEAST_ERROR,
    UNITS,
    Table,
    counted,
    in_unit,
    percent,
    quantity,
    with_frequency,
    with_unit,
)
from fenics_crack.basics.untrusted_files import content_of
from fenics_crack.cli.account import (
    IN_A_TEST,
    OTHERS,
    Account,
    account_of_growth,
    account_of_sweep,
    account_of_verification,
    frequency_in_words,
    how_it_is_left,
    in_short,
    largest_seen,
    of_error,
    of_friction,
    of_more_modes,
    of_size,
    of_stability,
    readable_rows,
)  # fmt: skip
from fenics_crack.cli.scenes import remark_on
from fenics_crack.curves.curve import PARAMETERS, ResponseCurve, kind_in_words, parameter_axis
from fenics_crack.curves.orbit_curve import OrbitCurve
from fenics_crack.curves.peak import AT_END, Top
from fenics_crack.curves.stability import attractors
from fenics_crack.fatigue.growth import Growth
from fenics_crack.files.store import IDENTIFICATION, Stored
from fenics_crack.model.modes import KINDS, BilinearFrequencies, Modes, bilinear_frequencies
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Integration
from fenics_crack.scene.words import key_in_words, value_in_words
from fenics_crack.study.bladed_disk import blades
from fenics_crack.study.coarser_mesh import natural_name
from fenics_crack.study.conclusion import conclusion, known_to, unknown_error
from fenics_crack.study.observer import observe
from fenics_crack.study.plausibility import highest_omega
from fenics_crack.study.run import Run, run_of
from fenics_crack.study.stated_errors import largest_left_out
from fenics_crack.study.verification import Verification
from fenics_crack.sweep.result import SweepResult
from fenics_crack.time.march import TimeHistory

PNG = b"\x89PNG\r\n\x1a\n"
"""Beginning of a PNG file."""
ERROR = "error [%]"
"""Heading of the error due to modes, harmonics and mesh, as far as it is known."""
UNKNOWN_PARTS = ("total_error", "displacement_error")
"""Parts of an error report that mean nothing where the error is unknown."""
Row = tuple[str, str, object, str]
"""Name, words, value, unit."""


def _account_of_modes(run: Run[Modes]) -> Account:
    """Natural frequencies and mode shapes with the crack open."""
    found, table = run.result, run.result.table()
    first = float(found.omega[0])
    hertz = first / (2.0 * np.pi)
    names = [natural_name(run.scene, "open", number + 1) for number in range(len(found.omega))]
    known = known_to(run, names[0])
    fact = f"The first natural frequency with the crack open is {hertz:.5g} Hz ({first:.5g} rad/s)"
    fact += f", estimated error {known}." if known else "."
    if run.stated is not None:
        rows = [[*row, _errors(run, name)[0]] for row, name in zip(table.rows, names, strict=True)]
        table = Table([*table.columns, ERROR], rows)
    tables = {"Natural frequencies with the crack open": table}
    how: dict[str, Any] = {"remarks": run.remarks, "closing": conclusion(run)}
    return Account("modes", table, facts=[fact], tables=tables, run=run, **how)


# --- a steady vibration ---------------------------------------------------------------------------


def _account_of_solution(run: Run[PeriodicSolution]) -> Account:
    """A solution, its error and its stability (collective)."""
    found, scene = run.result, run.scene
    table = _quantities(run, found.to_dict() | _in_doubt(run))
    notes = [remark_on(run.structure, highest_omega(scene, "solve"))]
    asked = scene.harmonic_balance.error
    if found.converged and found.stability is None and run.contact is not None and asked:
        notes.append(
            "the stability is not assessed, as that would take long; it is for a reduced "
            "structure, with contact.law = 'unilateral' for one without mass at the crack faces "
            "(reduction.method)"
        )
    if found.converged and (larger := largest_left_out(found, run.watched_dof)) is not None:
        notes.append(
            f"harmonic {larger[0]}, which the solution leaves out, is the largest of the higher "
            f"ones: {larger[1]:.2g} of harmonic 1 in the exact orbit; more harmonics show it"
        )
    seen = ""
    if found.stability is not None and found.stability.verdict == "unstable":
        seen = _seen_instead(found, run.watched_dof)
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
    if found.converged:
        warnings += of_stability(scene, run, found.stability, seen)
        if found.stability is not None:
            warnings += of_more_modes(run.scene, found, found.stability.verdict)
        warnings += of_size(run, largest_seen(run))
        warnings += of_friction(found)
        warnings += run.stated.dents if run.stated is not None else ()
    return Account(
        "solution",
        table,
        rows=_waves(run, over_time(run)),
        shown=in_short(table, scene, PRINTED),
        facts=_facts(run),
        verdict=_verdict(found, seen),
        notes=[*notes, *_on_blades(run)],
        warnings=warnings,
        tables=_in_numbers(table, scene) | _of_blades(run),
        remarks=run.remarks,
        closing=conclusion(run, len(warnings)),
        done=found.converged,
        missed=missed or bool(unknown_error(run)),
        run=run,
    )


def _of_blades(run: Run[Any]) -> dict[str, Table]:
    """The vibration of each blade of a bladed disk (collective)."""
    if run.scene.disk is None:
        return {}
    heading = "Blades"
    if isinstance(run.result, ResponseCurve):
        heading += ", each at its largest response"
    return {heading: blades(run).table()}


def _on_blades(run: Run[Any]) -> Iterator[str]:
    """The same as text (collective)."""
    for heading, table in _of_blades(run).items():
        yield f"{heading}:\n{table.formatted('text')}".rstrip()


def _in_doubt(run: Run[PeriodicSolution]) -> dict[str, object]:
    """Return the values that cast doubt on a solution, by the names of :data:`OTHERS`; without
    those that do not."""
    judged = run.result.stability
    found: dict[str, object] = {"unknown_error": unknown_error(run)}
    found["remarks"] = "; ".join(map(str, run.remarks))
    if judged is not None:
        found |= {"from_rest": judged.from_rest, "rest_amplitude": judged.rest_amplitude}
    known = {name: value for name, value in found.items() if value and value == value}
    return known | (dict.fromkeys(UNKNOWN_PARTS, np.nan) if run.result.report.unknown else {})


def _in_numbers(table: Table, scene: Scene) -> dict[str, Table]:
    """All numbers, of which a page shows the first ones; before them those that are requested."""
    chosen = scene.quantities or ()
    rows = [row for row in table.rows if str(row[0]).rpartition(".")[2] in chosen]
    first = {"Requested by the scene": readable_rows(Table(table.columns, rows))} if rows else {}
    return first | {"In numbers": readable_rows(table)}


def _facts(run: Run[PeriodicSolution]) -> Iterator[str]:
    """The response, what the crack does, and the error that is known of each."""
    found, report = run.result, run.result.report
    size = quantity(found.amplitude(run.watched_dof), "m")
    fact = f"At {frequency_in_words(run.scene, found.omega)} the {run.watched_name} is {size} half "
    fact += f"peak-to-peak{_known(run)}"
    if not found.gap_coefficients.size:
        yield f"{fact}."
        yield "There is no contact: the solution is exact for its mesh and modes."
        return
    values = found.to_dict()
    if found.breathes:
        yield (
            f"{fact}; the crack opens by {quantity(values['opening'], 'm')}{_known(run, 'opening')}"
            f" and is closed for {values['closed_share']:.0%} of the period."
        )
    else:
        held = "open" if values["closed_share"] == 0.0 else "partly or wholly closed"
        yield f"{fact}; the crack stays {held} over the period: the vibration is linear."
    if unknown := unknown_error(run):
        yield f"The error is unknown: {unknown}."
    elif not report.estimated:
        yield "Its error is not estimated (harmonic_balance.error = false)."
    elif not known_to(run):
        yield f"The estimated relative error of the gap is {percent(report.total)}."
    if report.penetration > 0.0:
        yield (
            f"The crack faces penetrate by {report.penetration:.2%} of their motion, as the "
            "contact law allows; this is no error of the solution."
        )


def _known(run: Run[Any], name: str = "") -> str:
    """ " (estimated error 2.4 %)", where that is stated."""
    known = known_to(run, name)
    return f" (estimated error {known})" if known else ""


def _seen_instead(found: PeriodicSolution, dof: int) -> str:
    """Describe the size of the motions that leave an unstable solution; empty where that is not
    known (collective)."""
    settled, said = [], []
    with suppress(ConvergenceError, InputError):
        for one in attractors(found.structure, found):
            sizes = one.amplitudes(dof)
            least, most = (quantity(size, "m") for size in (sizes.min(), sizes.max()))
            size = most if least == most else f"between {least} and {most}"
            if one.orbit:
                settled.append(size)
            else:
                said.append(f"still varies after {counted(one.periods, 'period')}, {size}")
    if settled:
        said.insert(0, f"settles to {' or '.join(dict.fromkeys(settled))}")
    seen = " or ".join(dict.fromkeys(said))
    return f"; after a disturbance the motion {seen} half peak-to-peak" if seen else ""


def _verdict(found: PeriodicSolution, seen: str) -> tuple[str, str]:
    """Return a sentence on the vibration's stability, with the motion seen instead, and its
    kind."""
    if not found.converged:
        return "Not converged: there is no orbit to assess.", "bad"
    if found.stability is None:
        return "The stability was not examined.", "doubtful"
    judged = found.stability
    grows = f"grows, and the motion leaves this orbit{how_it_is_left(judged)}{seen}"
    undecided = f"Undecided: {judged.reason or 'more harmonics may decide'}", "doubtful"
    text, kind = {
        "stable": ("Stable: a small disturbance dies out", "good"),
        "unstable": (f"Unstable: a small disturbance {grows}", "bad"),
    }.get(judged.verdict, undecided)
    return f"{text} (largest multiplier {np.abs(judged.multipliers).max():.6g}).", kind


# --- a motion in time -----------------------------------------------------------------------------


def _account_of_history(run: Run[TimeHistory]) -> Account:
    """A motion in time, and whether it repeats, or how it decays (collective)."""
    found, scene = run.result, run.scene
    distance = found.distance
    table = _quantities(run, vars(found) | {"distance": distance})
    asked = scene.integration or Integration()
    change = "one period shows no change"
    if np.isfinite(found.settled):
        change = f"relative change over the last one {found.settled:.2g}"
    left = f", estimated distance from the settled motion {distance:.2g}" if distance < 1.0 else ""
    facts = [f"The motion has settled after {found.periods} periods: {change}{left}."]
    warnings = []
    done = bool(found.settled <= asked.settle)
    if asked.free:
        done = found.periods >= asked.periods
        sizes = np.ptp(found.by_period(found.displacement()[:, 0]), axis=1) / 2.0
        first, last = (quantity(float(size), "m") for size in sizes[[0, -1]])
        facts = [
            f"Free decay over {found.periods} periods, from {first} to {last} half peak-to-peak."
        ]
    elif not done:
        facts = [f"The time integration has {found.periods} periods."]
        warnings = [
            f"the motion has not settled after {found.periods} of {asked.periods} periods: "
            f"{change}{_longer_period(found)}"
        ]
    waves = over_time(run)
    warnings += of_size(run, np.abs(waves.motion).max(axis=0))
    return Account(
        "integration",
        table,
        rows=_waves(run, waves),
        shown=in_short(table, scene, PRINTED),
        facts=facts,
        warnings=warnings,
        tables=_in_numbers(table, scene),
        remarks=run.remarks,
        closing=conclusion(run, len(warnings)),
        done=done,
        run=run,
    )


def _longer_period(found: TimeHistory) -> str:
    """A hint why a motion has not settled: it may repeat after two or three load periods."""
    for count in range(2, len(found.by_period(found.time))):
        if (change := found.change(count)) < 0.1 * found.settled:
            return f", over {count} periods {change:.2g}: its period is {count} times the load's"
    return "; it may need more periods (integration.periods), or be irregular"


# --- their numbers --------------------------------------------------------------------------------


def _quantities(run: Run[Any], values: Mapping[str, object]) -> Table:
    """The numbers of a vibration or a motion: indicators of each watched dof, those of the crack
    faces, natural frequencies, and others (collective)."""
    omega = run.scene.excitation.omega if isinstance(run.result, TimeHistory) else run.result.omega
    rows: list[Row] = [(n, n, v, UNITS[n]) for n, v in with_frequency({"omega": omega}).items()]
    rows += [one[:4] for one in observe(run, run.result)]
    if not run.structure.n_pairs:  # no errors were estimated
        values = {n: v for n, v in values.items() if not n.endswith(("_error", "_share"))}
    if run.structure.n_pairs and isinstance(run.result, PeriodicSolution):
        near = bilinear_frequencies(run.structure).nearest(omega)
        rows += (
            (name, f"{words}, mode {near['mode']}", float(value), unit)
            for name, words, unit, value in _with_hertz(near)
        )
    rows += [(n, words, values[n], unit) for n, (words, unit) in OTHERS.items() if n in values]
    columns = ["name", "quantity", "value", "unit"]
    rows = [(*row[:3], "-" if row[3] == "1" else row[3]) for row in rows]
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
    percents = 100.0 * max(error, LEAST_ERROR) if error < np.inf else np.nan
    return float(f"{percents:.3g}"), cause


def _with_hertz(near: Mapping[str, np.ndarray]) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Names, words, units and values of natural frequencies: "omega_open", "frequency_open"..."""
    for name in names_of(Place.MODES):
        words, unit = QUANTITIES[name].words, QUANTITIES[name].unit
        yield name, words, unit, near[name]
        if unit == "rad/s":
            yield name.replace("omega", "frequency"), words, "Hz", near[name] / (2.0 * np.pi)


# --- their waves ----------------------------------------------------------------------------------


class Waves(NamedTuple):
    """One period of a solution, or the record of a motion in time.

    Attributes
    ----------
    time : (n,) [s]
    motion : (n, n_watched) [m]
        Displacements of what is watched.
    closings : dict of str to (n,) [m]
        Closing of the faces of each crack, by where it is watched.
    force : (n, n_pairs) [N]
        Of the contact.
    """

    time: np.ndarray
    motion: np.ndarray
    closings: dict[str, np.ndarray]
    force: np.ndarray


def over_time(run: Run[Any]) -> Waves:
    """Return a motion over time."""
    found, dofs = run.result, [watched.dof for watched in run.watched]
    if isinstance(found, TimeHistory):
        time, motion, gap = found.time, found.displacement(dofs), found.gap
        force = found.contact_force
    else:
        time = np.linspace(0.0, found.period, 401)
        motion, gap = found.displacement(time, dofs), found.gap(time)
        force = found.contact_force(time)
    whole = run.structure.whole
    pairs = whole.watched_pairs.values() if gap.size else ()
    return Waves(time, motion, {whole.where(pair): gap[:, pair] for pair in pairs}, force)


def _waves(run: Run, waves: Waves) -> Table:
    """Watched dofs, the mouths of the cracks and the contact force over time."""
    columns = ["time [s]", *(f"{watched.words} [m]" for watched in run.watched)]
    columns += [f"closing {place} [m]" for place in waves.closings]
    values = [waves.time, *waves.motion.T, *waves.closings.values()]
    if waves.closings:
        columns.append("contact force, all pairs [N]")
        values.append(waves.force.sum(axis=1))
    return Table(columns, np.column_stack(values).tolist())


# --- a curve --------------------------------------------------------------------------------------


def _account_of_curve(run: Run[ResponseCurve]) -> Account:
    """A curve, its special points, its errors and its stability (collective)."""
    found, scene = run.result, run.scene
    along = _along(run, found)
    special = special_points(run, along)
    few, hidden = few_special_points(run, special)
    seen = _seen_at_largest(run)
    largest = _largest(run, seen)
    notes = [
        largest if seen or not found.complete else "",
        remark_on(run.structure, highest_omega(scene, "curve")),
    ]
    if hidden:
        notes.insert(0, f"{hidden} more bifurcations and changes of stability: curve.json")
    kinds = dict.fromkeys(point.kind for point in found.bifurcations)
    notes += [f"{kind_in_words(kind)}: {IN_A_TEST[kind]}" for kind in kinds if kind in IN_A_TEST]
    warnings = [*_warnings_of_curve(run), *of_size(run, largest_seen(run))]
    shown = found.indicators(run.watched_dof)
    peak = int(np.argmax(shown.amplitude))
    if shown.largest_order[peak] > 3:
        order = f"harmonic {shown.largest_order[peak]:.0f} is the largest of the higher ones"
        share = f"{shown.ratio_largest[peak]:.2g} of harmonic 1"
        where = "the largest response" if _passed(found, peak) else "its end"
        notes.append(f"at {where} {order}, {share}")
    if scene.harmonic_balance.tolerance is not None and run.structure.n_pairs:
        notes.append(f"by the tolerance: {found.method}")
    if isinstance(found, OrbitCurve):
        width = in_unit(parameter_axis(found.parameter, True), found.resolution)
        notes.append(f"windows of instability narrower than {width} may lie between points")
    return Account(
        "curve",
        special,
        rows=curve_points(run, along),
        shown=in_short(few, scene, SPECIAL),
        facts=_facts_of_curve(run, largest),
        notes=[*notes, *_on_blades(run)],
        warnings=warnings,
        tables={"Special points": in_short(special, scene, SPECIAL)} | _of_blades(run),
        remarks=run.remarks,
        closing=conclusion(run, len(warnings)),
        done=bool(found.complete) and found.status != INTERRUPTED,
        missed=bool(unknown_error(run)),
        run=run,
    )


def _seen_at_largest(run: Run[ResponseCurve]) -> str:
    """State that the largest response is unstable, and which motion is seen in its place; empty
    where it is not, or where the curve ended early there (collective)."""
    found = run.result
    place = int(np.argmax(found.amplitude(run.watched_dof)))
    judged = found.multipliers is not None and _passed(found, place)
    if not judged or found.verdicts[place] != "unstable":
        return ""
    return f"; it is unstable{_seen_instead(found.solution(place), run.watched_dof)}"


def _largest(run: Run[ResponseCurve], seen: str) -> str:
    """The largest response, how well it is known, and what is seen in place of it."""
    found = run.result
    top = found.top(run.watched_dof)
    size, place = quantity(top.amplitude, "m"), _place(run, top.value)
    if not _passed(found, top.index):
        return (
            f"The response grows up to where the curve ended early, {size} half peak-to-peak "
            f"({run.watched_name}) at {place}."
        )
    known, where = known_to(run), ""
    if top.at_end:
        place = f"{AT_END}, {place}: a peak lies beyond it, if there is one"
    else:
        where = "" if run.stated is None else known_to(run, run.stated.resonance)
        place = f"at {place}{where and f', estimated error {where}'}"
    return (
        f"The largest response of the curve, {size} half peak-to-peak "
        f"({run.watched_name}{known and f', estimated error {known}'}), is {place}{seen}."
    )


def _passed(found: ResponseCurve, place: int) -> bool:
    """Return True if the largest response is a peak, not the point where the curve ended early."""
    return bool(found.complete) or place < len(found) - 1


def _place(run: Run[ResponseCurve], *values: float) -> str:
    """Values of the parameter in its unit: "50.1 Hz", "50.1 and 50.3 Hz"."""
    return in_unit(parameter_axis(run.result.parameter, run.scene.in_hertz), *values)


def _facts_of_curve(run: Run[ResponseCurve], largest: str) -> Iterator[str]:
    """The largest response, shares of stability, and where the error is large."""
    yield largest
    found = run.result
    if found.multipliers is not None:
        states = ("stable", "unstable", "undecided")
        shares = [f"{np.mean(found.verdicts == state):.0%} {state}" for state in states]
        yield f"Of {len(found)} points {', '.join(shares)}."
    if found.status == INTERRUPTED:
        return
    inexact = found.displacement_errors > LARGE_ERROR
    if inexact.any():
        at = found.values[inexact]
        yield (
            f"At {np.mean(inexact):.0%} of the points, between {_place(run, at.min(), at.max())}, "
            f"the estimated error of the displacement is above {LARGE_ERROR:.0%}; these are faint "
            "in the picture."
        )


def _warnings_of_curve(run: Run[ResponseCurve]) -> Iterator[str]:
    """A large error, where and why the stability is undecided, and an early end."""
    found, scene = run.result, run.scene
    if found.status == INTERRUPTED:  # nothing more is assessed; exact orbits have their verdicts
        early = "" if found.complete else "ended early: it "
        left = "errors and stability" if found.multipliers is None else "errors"
        yield f"the curve {early}was interrupted; its {left} were not examined"
        return
    peak = int(np.argmax(found.amplitude(run.watched_dof)))
    looked_at = {peak, *np.linspace(0, len(found) - 1, 8).astype(int).tolist()}
    solutions = {index: found.solution(index) for index in sorted(looked_at)}
    reports = {index: one.report for index, one in solutions.items()}
    worst = max(reports, key=lambda index: reports[index].total)
    where = f" at {_place(run, found.values[worst])}"
    yield from of_error(scene, reports[worst], solutions[worst].harmonics, where)
    if found.multipliers is not None and _passed(found, peak):
        for said in of_more_modes(run.scene, solutions[peak], found.verdicts[peak]):
            yield f"at the largest response, {said}"
    stretches = _undecided_stretches(found)
    for first, last in stretches[:1]:
        ends = found.values[[first, last]] if last > first else found.values[[first]]
        where = f"{'between ' if last > first else ''}{_place(run, *ends)}"
        reason = found.reason((first + last) // 2)
        count = counted(last + 1 - first, "point")
        yield f"the stability is undecided at {count}, {where}: {reason}"
    if len(stretches) > 1:
        more = sum(last + 1 - first for first, last in stretches[1:])
        yield (
            f"the stability is undecided at {counted(more, 'other point')}, each for its own "
            "reason: curve.reason(index) in Python"
        )
    yield from run.stated.dents if run.stated is not None else ()
    if not found.complete:
        yield f"the curve ended early: {found.status}"


def _undecided_stretches(found: ResponseCurve) -> list[tuple[int, int]]:
    """First and last points of stretches along which no point is decided, the longest first."""
    if found.undecided is None:
        return []
    left = np.concatenate([[0], found.undecided, [0]])
    first, behind = (np.flatnonzero(np.diff(left) == change).tolist() for change in (1, -1))
    stretches = [(one, other - 1) for one, other in zip(first, behind, strict=True)]
    return sorted(stretches, key=lambda ends: ends[0] - ends[1])


# --- its points -----------------------------------------------------------------------------------


Columns = dict[str, np.ndarray]
"""Values at every point of a curve, by their headings."""


def curve_points(run: Run[ResponseCurve], along: Columns | None = None) -> Table:
    """Every point of a curve with its indicators, perhaps known already."""
    names = [name for name in run.result.to_dict() if name not in QUANTITIES]
    table, found = run.result.table(*names), along or _along(run, run.result)
    values = zip(*(column.tolist() for column in found.values()), strict=True)
    rows = [[*row, *more] for row, more in zip(table.rows, values, strict=True)]
    return Table((*table.columns, *found), rows)


def special_points(run: Run[ResponseCurve], along: Columns | None = None) -> Table:
    """Ends, largest response of the first watched dof, bifurcations and changes of stability.

    Of a curve over the load frequency both columns, rad/s and Hz; of a run-up also the speed, in
    rad/s and rpm.
    """
    found = run.result
    along = _places(found) | (along or _along(run, found))
    special = found.at_bifurcations if found.bifurcations else found
    there = _places(special) | _along(run, special)
    top = found.top(run.watched_dof)
    largest = "largest, still rising" if top.at_end else "largest"
    largest = largest if _passed(found, top.index) else "largest so far"
    at_top = _at_top(run, top, along)
    rows = [("start", 0, along), ("end", -1, along), (largest, 0, at_top)]
    for number, point in enumerate(found.bifurcations, 1):
        rows.append((kind_in_words(point.kind), number, there))
    if found.multipliers is not None:
        for index in np.flatnonzero(found.verdicts[1:] != found.verdicts[:-1]):
            after = found.verdicts[index + 1]
            what = {"stable": "gained", "unstable": "lost", "undecided": "undecided"}[after]
            rows.append((f"stability {what} after", int(index), along))
    values = [(name, *(float(column[at]) for column in of.values())) for name, at, of in rows]
    return Table(("point", *along), values)


def _at_top(run: Run[ResponseCurve], top: Top, along: Columns) -> Columns:
    """Columns of one row at the largest response of the first watched dof: the parameter and its
    ratios to natural frequencies, linear between the neighbouring points, and the amplitude; all
    else is of the nearest point."""
    near = slice(max(top.index - 1, 0), top.index + 2)
    order = np.argsort(run.result.values[near])
    values, moved = run.result.values[near][order], _places(run.result)
    row = {
        name: np.interp([top.value], values, column[near][order])
        if name in moved or name.startswith("over_")
        else column[[top.index]]
        for name, column in along.items()
    }
    return row | {with_unit(run.watched[0].column("amplitude"), "m"): np.array([top.amplitude])}


def _places(curve: ResponseCurve) -> dict[str, np.ndarray]:
    """Columns of a curve's parameter, of frequencies and speeds in both of their units."""
    if curve.parameter not in ("omega", "speed"):
        return {PARAMETERS[curve.parameter]: curve.values}
    columns = with_frequency({curve.parameter: curve.values, "omega": curve.omega})
    return {with_unit(name, UNITS[name]): np.asarray(column) for name, column in columns.items()}


def few_special_points(run: Run[ResponseCurve], table: Table) -> tuple[Table, int]:
    """The first rows of :func:`special_points` and some others, and how many are left out.

    Bifurcations come before changes of stability, and of one kind those with the larger response.
    Where no point is decided, none changes.
    """
    found, rows = run.result, [*table.rows]
    ends, others = rows[:3], rows[3:]  # start, end and largest come first
    points = found.bifurcations
    amplitude = next(n for n, name in enumerate(table.columns) if name.endswith("amplitude [m]"))
    if found.multipliers is not None and np.all(found.verdicts == "undecided"):
        others = others[: len(points)]

    def weight(place: int) -> tuple[bool, float]:
        return place < len(points), others[place][amplitude]

    kept = sorted(sorted(range(len(others)), key=weight, reverse=True)[: FEW_ROWS - 3])
    shown = [*ends, *(others[place] for place in kept)]
    return Table(table.columns, shown), len(others) - len(kept)


def _along(run: Run[ResponseCurve], curve: ResponseCurve) -> Columns:
    """Columns of indicators of the watched dofs, by their names with units: a value for every point
    of a curve of the run."""
    found = {with_unit(one.column, one.unit): one.value for one in observe(run, curve)}
    near = _natural_along(run, curve.omega).nearest(curve.omega)
    return found | {with_unit(name, unit): value for name, _, unit, value in _with_hertz(near)}


def _natural_along(run: Run[ResponseCurve], omega: np.ndarray) -> BilinearFrequencies:
    """Natural frequencies; of a run-up those at the speeds where the load has some frequencies
    (...) [rad/s]: (..., n). Squares are linear in W^2 between nine of them."""
    structure, found = run.structure, run.result
    if not isinstance(structure, RunUpStructure):
        return bilinear_frequencies(structure)
    speed = omega * (found.values[0] / found.omega[0])
    known = np.linspace(speed.min(), speed.max(), min(speed.size, 9))
    there = [bilinear_frequencies(structure.at_speed(float(one))) for one in known]

    def at_speeds(rows: list[np.ndarray]) -> np.ndarray:
        columns = [np.interp(speed**2, known**2, row**2) for row in np.transpose(rows)]
        return np.sqrt(np.stack(columns, axis=-1))

    is_open, tied = ([getattr(one, f"omega_{kind}") for one in there] for kind in ("open", "tied"))
    return BilinearFrequencies(at_speeds(is_open), at_speeds(tied))


# --- what identify has found ----------------------------------------------------------------------


@dataclass(frozen=True)
class Identified:
    """Result of ``identify`` and the files that it has written."""

    KIND: ClassVar[str] = IDENTIFICATION
    scene: Scene
    summary: Mapping[str, Any]
    """Contents of ``identify.json``."""
    picture: Path
    """Picture of the posterior, a PNG file and no link."""


def _identified(stored: Stored) -> Identified:
    """By its file and the picture beside it."""
    picture = stored.path.with_name("posterior.png")
    with stored.taken() as parts:
        scene, summary = stored.scene(), json.loads(parts["summary"])
        if scene is None:
            raise LookupError("scene")
        if "priors" not in summary:
            raise LookupError("priors")
    drawn = b""
    with suppress(OSError):
        drawn = content_of(picture, links=False)
    if not drawn.startswith(PNG):
        raise InputError("result", str(stored.path), f"with {picture.name} in its folder")
    return Identified(scene, summary, picture)


def priors_in_words(priors: Mapping[str, float]) -> str:
    """Priors of an identification by their keys: "priors: young_deviation = 0.03, ..."."""
    pairs = ((key, value_in_words(f"identify.{key}", value)) for key, value in priors.items())
    return f"priors: {', '.join(f'{key} = {value}' for key, value in pairs)}"


def _account_of_identified(found: Identified) -> Account:
    """Verdict, estimates with their intervals, and the fit."""
    from fenics_crack.monitoring.identification.result import (
        FITTED,  # SciPy's optimize, interpolate
    )

    values, rows = found.summary, []
    share = f"{100.0 * values['priors']['confidence']:g} %"
    for key, value in values["estimate"].items():
        ends = values["intervals"].get(key)  # of a word there are none
        limits = [value_in_words(key, end) for end in ends] if ends else ["", ""]
        rows.append([key_in_words(key), value_in_words(key, value), *limits])
    summary = Table(("unknown", "estimate", f"{share} from", "to"), rows)
    where = [f"{key} {value} ({share}: {low} to {high})" for key, value, low, high in rows if low]
    said = [*(where if values["verdict"] == "crack" else []), values["reason"]]
    facts = [f"{values.get('conclusion', values['verdict'])}: {'; '.join(said)}"]
    facts.append(priors_in_words(values["priors"]))
    facts += [f"remark: {remark}" for remark in values["remarks"]]
    facts += [f"next to measure: {advice}" for advice in values["advice"]]
    tables = {
        "Unknowns": summary,
        "Measurements and predictions of the estimate": Table(FITTED, values["measurements"]),
    }
    return Account("identify", summary, facts=facts, warnings=values["warnings"], tables=tables)


# --- all of them ----------------------------------------------------------------------------------

Computed = Run[Any] | SweepResult | Verification | Growth | Identified
"""Results that commands write."""
RESULTS: dict[str, tuple[str, Callable[[Any], Account]]] = {
    Modes.KIND: ("Natural frequencies and modes", _account_of_modes),
    PeriodicSolution.KIND: ("Steady vibration", _account_of_solution),
    ResponseCurve.KIND: ("Response curve", _account_of_curve),
    SweepResult.KIND: ("Sweep", account_of_sweep),
    TimeHistory.KIND: ("Motion in time", _account_of_history),
    Growth.KIND: ("Growth of the crack", account_of_growth),
    Identified.KIND: ("Identification of the crack", _account_of_identified),
    Verification.KIND: ("Convergence study", account_of_verification),
}
"""Heading and account of each kind of result, in the order of a report."""


def account_of(result: Computed) -> Account:
    """Return the account of a result (collective)."""
    return RESULTS[result.KIND][1](result)


def result_of(stored: Stored) -> Computed:
    """The result of a file that one rank has read.

    Raises
    ------
    InputError
        It is no result of a command.
    """
    if stored.kind not in RESULTS:
        allowed = f"a result of one of these kinds: {', '.join(RESULTS)}"
        raise InputError("result", str(stored.path), allowed)
    if stored.kind == SweepResult.KIND:
        return SweepResult.load(stored.path)
    if stored.kind == Identified.KIND:
        return _identified(stored)
    if stored.kind == Growth.KIND:
        return Growth.of(stored)
    if stored.kind == Verification.KIND:
        return Verification.of(stored)
    judged = stored.kind != PeriodicSolution.KIND  # whose errors are in the file
    return run_of(stored, MPI.COMM_SELF, judged=judged)
