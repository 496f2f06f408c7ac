"""Reports of runs: modes, a steady vibration, a curve, a motion in time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import INTERRUPTED, ConvergenceError, InputError
from fenics_crack.basics.observables import PRINTED, QUANTITIES, SPECIAL, Place, names_of
from fenics_crack.basics.report import Report
from fenics_crack.basics.tables import (
    FEW_ROWS,
    LEAST_ERROR,
    UNITS,
    Table,
    counted,
    in_unit,
    quantity,
    with_frequency,
    with_unit,
)
from fenics_crack.cli import account
from fenics_crack.cli.account import IN_A_TEST, OTHERS
from fenics_crack.cli.scenes import remark_on
from fenics_crack.curves.curve import (
    DESCRIPTION_BY_PARAMETER,
    ResponseCurve,
    kind_in_words,
    parameter_axis,
)
from fenics_crack.curves.peak import LargestResponse
from fenics_crack.curves.stability import attractors
from fenics_crack.errors.numbers import largest_left_out, natural_name
from fenics_crack.model.modes import (
    FREQUENCY_KIND_NAMES,
    BilinearFrequencies,
    Modes,
    bilinear_frequencies,
)
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.runs.conclusion import conclusion_of, unknown_error, unknown_of_solution
from fenics_crack.runs.run import Run
from fenics_crack.runs.stress_intensity import stress_intensity
from fenics_crack.scene.scene import asked_quantities
from fenics_crack.scene.tables import Integration
from fenics_crack.study.observer import observe
from fenics_crack.study.plausibility import highest_omega
from fenics_crack.time.march import TimeHistory

ERROR = "error [%]"
"""Heading of the error due to modes, harmonics and mesh, as far as it is known."""
UNKNOWN_PARTS = ("total_error", "displacement_error")
"""Parts of an error report that mean nothing where the error is unknown."""
Row = tuple[str, str, object, str]
"""Name, words, value, unit."""


def report_of_modes(run: Run[Modes]) -> Report:
    """Natural frequencies and mode shapes with the crack open."""
    table = run.result.table()
    names = [natural_name(run.scene, "open", number) for number in range(1, len(table.rows) + 1)]
    if run.stated is not None:
        rows = [[*row, _errors(run, name)[0]] for row, name in zip(table.rows, names, strict=True)]
        table = Table([*table.columns, ERROR], rows)
    return _report(run, table)


def _report(run: Run[Any], table: Table, **how: Any) -> Report:
    """The report of a run, with what all of them have: notes where friction acts along lines and
    where watched nodes are away from their points, remarks, and the last sentence, also as a
    quantity where the table has those (collective)."""
    lines, turning = account.of_lines(run)
    incomplete_numbers = () if run.stated is None else run.stated.incomplete
    how["notes"] = [*how.get("notes", ()), *lines, *_watched_away(run), *incomplete_numbers]
    how["warnings"] = [*how.get("warnings", ()), *turning]
    if table.columns[0] != "name":
        return Report(table, conclusion_of(run), remarks=run.remarks, **how)
    how |= {"shown": account.in_short(table, run.scene, PRINTED), "tables": _in_numbers(run, table)}
    report = Report(table, conclusion_of(run), remarks=run.remarks, **how)
    row = ["conclusion", OTHERS["conclusion"][0], report.closing, "-"]
    row += ["" for _ in table.columns[len(row) :]]
    return replace(report, table=Table(table.columns, [*table.rows, row]))


def _watched_away(run: Run[Any]) -> list[str]:
    """A note on points whose nearest nodes are watched."""
    away = {w.name.partition(".")[0]: w.distance for w in run.watched if w.distance > 0}
    places = ", ".join(f"{name} {quantity(distance, 'm')}" for name, distance in away.items())
    stated = "; not part of the stated errors" if run.stated is not None else ""
    return [f"watched at the nearest node, at a distance of: {places}{stated}"] if places else []


# --- a steady vibration ---------------------------------------------------------------------------


def report_of_solution(run: Run[PeriodicSolution]) -> Report:
    """A solution, its error and its stability (collective)."""
    found, scene = run.result, run.scene
    table = _quantities(run, found.omega, found.to_dict() | _in_doubt(run))
    notes = [remark_on(run.structure, highest_omega(scene, "solve"))]
    asked = scene.harmonic_balance.error
    if found.converged and found.stability is None and run.contact is not None and asked:
        reduced = "" if scene.disk is not None else "for a reduced structure (reduction.method), "
        where = f"{reduced}with contact.law = 'unilateral' for crack faces without mass"
        notes.append(f"the stability is not assessed, as that would take long; it is {where}")
    if found.converged and (larger := largest_left_out(found, run.watched_dof)) is not None:
        share = f"{larger[1]:.2g} of harmonic 1 in the exact orbit; more harmonics show it"
        left = f"harmonic {larger[0]}, which the solution leaves out"
        notes.append(f"{left}, is the largest of the higher ones: {share}")
    tolerance = scene.harmonic_balance.tolerance
    missed = tolerance is not None and found.report.total > tolerance
    warnings = []
    if not found.converged or missed:
        warnings.append(f"{'' if found.converged else 'not converged: '}{found.status}")
    elif run.structure.n_pairs:
        warnings += account.of_error(scene, found.report, found.harmonics)
    if found.still:
        warnings.append("nothing vibrates: no load changes in time")
    if found.converged:
        judged, seen = found.stability, ""
        if judged is not None:
            if judged.verdict in ("unstable", "irregular"):
                seen = _seen_instead(found, run.watched_dof)
            warnings += account.of_more_modes(run.scene, found, judged.verdict)
        warnings += account.of_stability(scene, run, judged, seen)
        warnings += account.of_size(run, account.largest_seen(run))
        warnings += account.of_friction(found)
        warnings += run.stated.dents if run.stated is not None else ()
    return _report(
        run,
        table,
        rows=_waves(run, waves_of(run)),
        notes=notes,
        warnings=warnings,
        further=_of_blades(run, "Blades") | _along_fronts(run),
        done=found.converged,
        missed=missed or bool(unknown_of_solution(run)),
    )


def _of_blades(run: Run[Any], heading: str) -> dict[str, Table]:
    """The vibration of each blade of a bladed disk (collective)."""
    if run.scene.disk is None:
        return {}
    from fenics_crack.disk.bladed_disk import blades

    return {heading: blades(run).table()}


def _along_fronts(run: Run[Any]) -> dict[str, Table]:
    """Stress intensities along the fronts of a solid's cracks, if one is requested (collective)."""
    places = [QUANTITIES[name].of for name in asked_quantities(run.scene)]
    if run.scene.dimension == 2 or Place.TIPS not in places:
        return {}
    found = stress_intensity(run)
    columns = {"position": found.positions, **found.numbers, "K_I while closed": found.closed}
    units = {name: "m" if name == "position" else "Pa m^0.5" for name in columns}
    lists = {name: [float(f"{x:.4g}") for x in values] for name, values in columns.items()}
    return {"Stress intensity along the crack fronts": Table.of(lists, units)}


def _in_doubt(run: Run[PeriodicSolution]) -> dict[str, object]:
    """Return the values that cast doubt on a solution, by the names of :data:`OTHERS`; without
    those that do not."""
    judged = run.result.stability
    found: dict[str, object] = {"unknown_error": unknown_of_solution(run)}
    found["remarks"] = "; ".join(map(str, run.remarks))
    if judged is not None:
        found |= {"from_rest": judged.from_rest, "rest_amplitude": judged.rest_amplitude}
    known = {name: value for name, value in found.items() if value and value == value}
    return known | (dict.fromkeys(UNKNOWN_PARTS, np.nan) if run.result.report.unknown else {})


def _in_numbers(run: Run[Any], table: Table) -> dict[str, Table]:
    """All numbers, of which a page shows the first ones; before them those that are requested."""
    chosen = run.scene.quantities or ()
    rows = [row for row in table.rows if str(row[0]).rpartition(".")[2] in chosen]
    first = {"Requested by the scene": account.readable_rows(Table(table.columns, rows))}
    return (first if rows else {}) | {"In numbers": account.readable_rows(table)}


def _seen_instead(found: PeriodicSolution, dof: int) -> str:
    """Describe the size of the motions that leave an unstable or irregular solution; empty where
    that is not known (collective)."""
    motions: list[tuple[bool, int, np.ndarray]] = []
    with suppress(ConvergenceError, InputError):
        motions = [
            (motion.orbit is not None, motion.periods, motion.amplitudes(dof))
            for motion in attractors(found.structure, found)
        ]
    settled = dict.fromkeys(_range_of(sizes) for is_orbit, _, sizes in motions if is_orbit)
    parts = [f"settles to {' or '.join(settled)}"] if settled else []
    if varying_motions := [
        (periods, sizes) for is_orbit, periods, sizes in motions if not is_orbit
    ]:
        periods, sizes = zip(*varying_motions, strict=True)
        ends = _range_of(np.concatenate(sizes))
        parts.append(f"still varies after {counted(min(periods), 'period')}, {ends}")
    return f"; the motion {' or '.join(parts)} half peak-to-peak" if parts else ""


def _range_of(sizes: np.ndarray) -> str:
    """Describe the range of some sizes [m]: "1.2 mm", or "between 1.2 mm and 1.5 mm"."""
    ends = dict.fromkeys(quantity(size, "m") for size in (sizes.min(), sizes.max()))
    return f"{'between ' if len(ends) > 1 else ''}{' and '.join(ends)}"


# --- a motion in time -----------------------------------------------------------------------------


def report_of_history(run: Run[TimeHistory]) -> Report:
    """A motion in time, and whether it repeats, or how it decays (collective)."""
    found, scene = run.result, run.scene
    table = _quantities(run, scene.excitation.omega, vars(found) | {"distance": found.distance})
    asked, waves = scene.integration or Integration(), waves_of(run)
    done = found.periods >= asked.periods if asked.free else bool(found.settled <= asked.settle)
    warnings = []
    if not done and not asked.free:
        unsettled = f"the motion has not settled after {found.periods} of {asked.periods} periods"
        warnings.append(f"{unsettled}{_longer_period(found)}")
    warnings += account.of_size(run, np.abs(waves.motion).max(axis=0))
    return _report(run, table, rows=_waves(run, waves), warnings=warnings, done=done)


def _longer_period(found: TimeHistory) -> str:
    """A hint why a motion has not settled: it may repeat after two or three load periods."""
    for count in range(2, len(found.by_period(found.time))):
        if (change := found.change(count)) < 0.1 * found.settled:
            return f", over {count} periods {change:.2g}: its period is {count} times the load's"
    return "; it may need more periods (integration.periods), or be irregular"


# --- their numbers --------------------------------------------------------------------------------


def _quantities(run: Run[Any], omega: float, values: Mapping[str, object]) -> Table:
    """The numbers of a vibration or a motion at a load frequency [rad/s]: indicators of each
    watched dof, those of the crack faces, of a vibration natural frequencies near the load's, and
    others (collective)."""
    rows: list[Row] = [(n, n, v, UNITS[n]) for n, v in with_frequency({"omega": omega}).items()]
    rows += [one[:4] for one in observe(run, run.result)]
    if not run.structure.n_pairs:  # no errors were estimated
        values = {n: v for n, v in values.items() if not n.endswith(("_error", "_share"))}
    elif isinstance(run.result, PeriodicSolution):
        near = bilinear_frequencies(run.structure).nearest(omega)
        rows += (
            (name, f"{words}, mode {near['mode']}", float(value), unit)
            for name, words, unit, value in _with_hertz(near)
        )
    rows += [(n, words, values[n], unit) for n, (words, unit, _) in OTHERS.items() if n in values]
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
    if kind in FREQUENCY_KIND_NAMES:
        mode = bilinear_frequencies(run.structure).nearest(run.result.omega)["mode"]
        name = natural_name(run.scene, kind, int(mode))
    error, cause = run.stated.stated(name)
    percents = 100.0 * max(error, LEAST_ERROR) if error < np.inf else np.nan
    missing_causes = run.stated.missing_causes(name) if name in run.stated.values else {}
    if missing_causes:
        cause += f"; not included: {', '.join(missing_causes)}"
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


def waves_of(run: Run[Any]) -> Waves:
    """Return a solution over one period, or a motion over the time that it has recorded."""
    found, dofs, whole = run.result, [watched.dof for watched in run.watched], run.structure.whole
    if isinstance(found, TimeHistory):
        time, motion = found.time, found.displacement(dofs)
        gap, force = found.gap, found.contact_force
    else:
        time = np.linspace(0.0, found.period, 401)
        motion, gap = found.displacement(time, dofs), found.gap(time)
        force = found.contact_force(time)
    pairs = whole.watched_pairs.values() if gap.size else ()
    return Waves(time, motion, {whole.describe_pair(pair): gap[:, pair] for pair in pairs}, force)


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


def report_of_curve(run: Run[ResponseCurve]) -> Report:
    """A curve, its special points, its errors and its stability (collective)."""
    found, scene = run.result, run.scene
    along = _along(run, found)
    special = special_points(run, along)
    few, hidden = few_special_points(run, special)
    notes = [_seen_at_largest(run), remark_on(run.structure, highest_omega(scene, "curve"))]
    if hidden:
        notes.insert(0, f"{hidden} more bifurcations and changes of stability: curve.json")
    kinds = dict.fromkeys(point.kind for point in found.bifurcations)
    notes += [f"{kind_in_words(kind)}: {IN_A_TEST[kind]}" for kind in kinds if kind in IN_A_TEST]
    warnings = [*_warnings_of_curve(run), *account.of_size(run, account.largest_seen(run))]
    shown = found.indicators(run.watched_dof)
    peak = int(np.argmax(shown.amplitude))
    if shown.largest_order[peak] > 3:
        order = f"harmonic {shown.largest_order[peak]:.0f} is the largest of the higher ones"
        share = f"{shown.ratio_largest[peak]:.2g} of harmonic 1"
        where = "the largest response" if _passed(found, peak) else "its end"
        notes.append(f"at {where} {order}, {share}")
    if scene.harmonic_balance.tolerance is not None and run.structure.n_pairs:
        chosen = found.status.partition("; ")[2] if found.complete else ""
        notes.append("; ".join(filter(None, (f"by the tolerance: {found.method}", chosen))))
    if found.exact:
        width = in_unit(parameter_axis(found.parameter, True), found.resolution)
        notes.append(f"windows of instability narrower than {width} may lie between points")
    return _report(
        run,
        special,
        rows=curve_points(run, along),
        shown=account.in_short(few, scene, SPECIAL),
        notes=notes,
        warnings=warnings,
        tables={"Special points": account.in_short(special, scene, SPECIAL)},
        further=_of_blades(run, "Blades, each at its largest response"),
        done=bool(found.complete) and found.status != INTERRUPTED,
        missed=bool(unknown_error(run)),
    )


def _seen_at_largest(run: Run[ResponseCurve]) -> str:
    """State that the largest response is unstable or irregular, and which motion is seen in its
    place; empty where it is not, or where the curve ended early there (collective)."""
    found = run.result
    place = int(np.argmax(found.amplitude(run.watched_dof)))
    judged = found.multipliers is not None and _passed(found, place)
    verdict = str(found.verdicts[place]) if judged else ""
    if verdict not in ("unstable", "irregular"):
        return ""
    seen = _seen_instead(found.solution(place), run.watched_dof)
    return f"the largest response is {verdict}{seen}"


def _passed(found: ResponseCurve, place: int) -> bool:
    """Return True if the largest response is a peak, not the point where the curve ended early."""
    return bool(found.complete) or place < len(found) - 1


def _place(run: Run[ResponseCurve], *values: float) -> str:
    """Values of the parameter in its unit: "50.1 Hz", "50.1 and 50.3 Hz"."""
    return in_unit(parameter_axis(run.result.parameter, run.scene.in_hertz), *values)


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
    yield from account.of_error(scene, reports[worst], solutions[worst].harmonics, where)
    if found.multipliers is not None and _passed(found, peak):
        for said in account.of_more_modes(run.scene, solutions[peak], found.verdicts[peak]):
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
        own = "each for its own reason: curve.reason(index) in Python"
        yield f"the stability is undecided at {counted(more, 'other point')}, {own}"
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
    rows = [("start", 0, along), ("end", -1, along), (largest, 0, _at_top(run, top, along))]
    for number, point in enumerate(found.bifurcations, 1):
        rows.append((kind_in_words(point.kind), number, there))
    if found.multipliers is not None:
        for index in np.flatnonzero(found.verdicts[1:] != found.verdicts[:-1]):
            after = found.verdicts[index + 1]
            what = {"stable": "gained", "unstable": "lost"}.get(after, after)
            rows.append((f"stability {what} after", int(index), along))
    values = [(name, *(float(column[at]) for column in of.values())) for name, at, of in rows]
    return Table(("point", *along), values)


def _at_top(run: Run[ResponseCurve], top: LargestResponse, along: Columns) -> Columns:
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
    found: dict[str, np.ndarray] = {}
    columns: dict[str, Any] = {"omega": curve.omega}
    if curve.parameter in ("omega", "speed"):
        columns = {curve.parameter: curve.values} | columns
    else:
        found = {DESCRIPTION_BY_PARAMETER[curve.parameter]: curve.values}
        columns = columns if curve.parameter == "resonance" else {}
    every = with_frequency(columns).items()
    return found | {with_unit(name, UNITS[name]): np.asarray(column) for name, column in every}


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
