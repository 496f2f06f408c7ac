"""Reports of runs: modes, a steady vibration, a curve, a motion in time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import INTERRUPTED_CURVE_STATUS, ConvergenceError, InputError
from fenics_crack.basics.observables import (
    IN_PRINTED_TABLE,
    IN_SPECIAL_POINTS_TABLE,
    OBSERVABLES_BY_NAME,
    Place,
    observable_names,
)
from fenics_crack.basics.report import Report
from fenics_crack.basics.tables import (
    MIN_REPORTED_ERROR,
    N_SELECTED_ROWS,
    UNIT_BY_NAME,
    Table,
    add_frequency_entries,
    format_count,
    format_in_unit,
    format_quantity,
    heading_with_unit,
)
from fenics_crack.cli import account
from fenics_crack.cli.account import DESCRIPTION_UNIT_AND_LEVEL_BY_NAME, MEANING_BY_BIFURCATION
from fenics_crack.cli.scenes import describe_undamped_harmonics
from fenics_crack.curves.curve import (
    DESCRIPTION_BY_PARAMETER,
    ResponseCurve,
    axis_factor_name_and_unit,
    kind_in_words,
)
from fenics_crack.curves.peak import LargestResponse
from fenics_crack.curves.stability import attractors
from fenics_crack.errors.numbers import find_largest_omitted_harmonic, natural_frequency_name
from fenics_crack.model.modes import (
    FREQUENCY_KIND_NAMES,
    BilinearFrequencies,
    Modes,
    bilinear_frequencies,
)
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.runs.conclusion import (
    explain_unknown_amplitude_error,
    explain_unknown_solution_error,
    make_conclusion,
)
from fenics_crack.runs.run import Run
from fenics_crack.runs.stress_intensity import stress_intensity
from fenics_crack.scene.result_tables import Integration
from fenics_crack.scene.scene import list_requested_extra_quantities
from fenics_crack.study.observer import observe_quantities
from fenics_crack.study.plausibility import highest_harmonic_omega
from fenics_crack.time.march import TimeHistory

ERROR_COLUMN_HEADING = "error [%]"
"""Heading of the table column with stated errors."""
ERROR_NAMES_NAN_IF_UNKNOWN = ("total_error", "displacement_error")
"""Names of error quantities set to nan if the error report is unknown."""
QuantityRow = tuple[str, str, object, str]
"""Row of a table of quantities: name, description, value and unit."""


def report_of_modes(run: Run[Modes]) -> Report:
    """Build the report of natural frequencies with the crack open, with mesh errors if known."""
    table = run.result.table()
    frequency_names = [
        natural_frequency_name(run.scene, "open", mode_number)
        for mode_number in range(1, len(table.rows) + 1)
    ]
    if run.stated is not None:
        rows_with_errors = [
            [*mode_row, _find_error_and_cause(run, frequency_name)[0]]
            for mode_row, frequency_name in zip(table.rows, frequency_names, strict=True)
        ]
        table = Table([*table.columns, ERROR_COLUMN_HEADING], rows_with_errors)
    return _make_report(run, table)


def _make_report(run: Run[Any], table: Table, **report_fields: Any) -> Report:
    """Build a run's report, with notes common to all kinds of runs (collective).

    Notes describe friction along lines, watched nodes away from the output points, and quantities
    with an incomplete error. In a table of quantities, the closing sentence becomes the last row.

    Parameters
    ----------
    run : Run
    table : Table
        Table for files; the first column "name" marks a table of quantities.
    report_fields
        Further fields of the :class:`Report`.
    """
    friction_notes, friction_warnings = account.list_friction_line_notes_and_warnings(run)
    incomplete_notes = () if run.stated is None else run.stated.incomplete_error_notes
    report_fields["notes"] = [
        *report_fields.get("notes", ()),
        *friction_notes,
        *_list_node_distance_notes(run),
        *incomplete_notes,
    ]
    report_fields["warnings"] = [*report_fields.get("warnings", ()), *friction_warnings]
    if table.columns[0] != "name":
        return Report(table, make_conclusion(run), remarks=run.remarks, **report_fields)
    report_fields |= {
        "printed_table": account.select_printed_quantities(table, run.scene, IN_PRINTED_TABLE),
        "page_tables": _quantity_text_tables_by_heading(run, table),
    }
    report = Report(table, make_conclusion(run), remarks=run.remarks, **report_fields)
    conclusion_row = [
        "conclusion",
        DESCRIPTION_UNIT_AND_LEVEL_BY_NAME["conclusion"][0],
        report.closing_sentence,
        "-",
    ]
    conclusion_row += ["" for _ in table.columns[len(conclusion_row) :]]
    return replace(report, table=Table(table.columns, [*table.rows, conclusion_row]))


def _list_node_distance_notes(run: Run[Any]) -> list[str]:
    """Note how far watched nodes are from the output points of the scene.

    Returns a list with a single note; empty if all points are nodes.
    """
    distance_by_point = {
        watched_displacement.name.partition(".")[0]: watched_displacement.distance
        for watched_displacement in run.watched
        if watched_displacement.distance > 0
    }
    distances_text = ", ".join(
        f"{point_name} {format_quantity(node_distance, 'm')}"
        for point_name, node_distance in distance_by_point.items()
    )
    exclusion_text = (
        "; the stated errors do not include this distance" if run.stated is not None else ""
    )
    return (
        [
            f"each output point is observed at its nearest node, at a distance of: {distances_text}"
            f"{exclusion_text}"
        ]
        if distances_text
        else []
    )


# --- a steady vibration ---------------------------------------------------------------------------


def report_of_solution(run: Run[PeriodicSolution]) -> Report:
    """Build the report of a steady vibration, with errors and stability (collective)."""
    solution, scene = run.result, run.scene
    table = _tabulate_quantities(
        run, solution.omega, solution.to_dict() | _collect_doubts_by_name(run)
    )
    note_texts = [
        describe_undamped_harmonics(run.structure, highest_harmonic_omega(scene, "solve"))
    ]
    is_error_requested = scene.harmonic_balance.error
    if (
        solution.converged
        and solution.stability is None
        and run.contact is not None
        and is_error_requested
    ):
        reduction_text = "" if scene.disk is not None else "a reduction (reduction.method), and "
        note_texts.append(
            "the stability is not assessed, as that would take long; to assess it, use "
            f"{reduction_text}contact.law = 'unilateral' if crack faces have no mass"
        )
    if (
        solution.converged
        and (order_and_ratio := find_largest_omitted_harmonic(solution, run.watched_dof))
        is not None
    ):
        note_texts.append(
            f"the largest harmonic above harmonic 1 is harmonic {order_and_ratio[0]}, with "
            f"{order_and_ratio[1]:.2g} of harmonic 1 in the exact orbit; this solution leaves it "
            "out: use more harmonics"
        )
    tolerance = scene.harmonic_balance.tolerance
    is_tolerance_missed = tolerance is not None and solution.report.total > tolerance
    warning_texts = []
    if not solution.converged or is_tolerance_missed:
        warning_texts.append(f"{'' if solution.converged else 'not converged: '}{solution.status}")
    elif run.structure.n_pairs:
        warning_texts += account.yield_large_error_warning(
            scene, solution.report, solution.harmonics
        )
    if solution.still:
        warning_texts.append(
            "nothing vibrates: no load varies in time; give one, for example excitation.force_sin"
        )
    if solution.converged:
        stability, motion_text = solution.stability, ""
        if stability is not None:
            if stability.verdict in ("unstable", "irregular"):
                motion_text = _describe_departing_motions(solution, run.watched_dof)
            warning_texts += account.yield_mode_dependence_warning(
                run.scene, solution, stability.verdict
            )
        warning_texts += account.yield_instability_warning(scene, run, stability, motion_text)
        warning_texts += account.list_large_motion_warnings(
            run, account.find_largest_displacements(run)
        )
        warning_texts += account.yield_nonunique_contact_force_warning(solution)
        warning_texts += run.stated.point_force_warnings if run.stated is not None else ()
    return _make_report(
        run,
        table,
        csv_table=_tabulate_waveforms(run, sample_waveforms(run)),
        notes=note_texts,
        warnings=warning_texts,
        further_tables=_blade_tables_by_heading(run, "Blades") | _front_tables_by_heading(run),
        has_converged=solution.converged,
        misses_tolerance=is_tolerance_missed or bool(explain_unknown_solution_error(run)),
    )


def _blade_tables_by_heading(run: Run[Any], heading: str) -> dict[str, Table]:
    """Tabulate the vibration of each blade of a bladed disk (collective).

    The table stands under ``heading``; without a disk the dict is empty.
    """
    if run.scene.disk is None:
        return {}
    from fenics_crack.disk.bladed_disk import blades

    return {heading: blades(run).table()}


def _front_tables_by_heading(run: Run[Any]) -> dict[str, Table]:
    """Tabulate stress intensities along the crack fronts of a solid (collective).

    The result is a table by heading; empty in two dimensions, or if the scene requests no stress
    intensities at tips.
    """
    requested_places = [
        OBSERVABLES_BY_NAME[name].place for name in list_requested_extra_quantities(run.scene)
    ]
    if run.scene.dimension == 2 or Place.TIPS not in requested_places:
        return {}
    stress_intensities = stress_intensity(run)
    columns_by_name = {
        "position": stress_intensities.positions,
        **stress_intensities.numbers,
        "K_I while closed": stress_intensities.closed_front_errors,
    }
    units_by_name = {name: "m" if name == "position" else "Pa m^0.5" for name in columns_by_name}
    lists_by_name = {
        name: [float(f"{cell_value:.4g}") for cell_value in column]
        for name, column in columns_by_name.items()
    }
    return {
        "Stress intensity along the crack fronts": Table.from_dict(lists_by_name, units_by_name)
    }


def _collect_doubts_by_name(run: Run[PeriodicSolution]) -> dict[str, object]:
    """Collect reasons to doubt a solution, by quantity name.

    Names are "unknown_error", the reason; "remarks" on the scene; "from_rest" and "rest_amplitude"
    of the motion from rest. Empty texts, zeros and nan are left out. If the error is unknown,
    "total_error" and "displacement_error" are nan.
    """
    stability = run.result.stability
    doubts_by_name: dict[str, object] = {"unknown_error": explain_unknown_solution_error(run)}
    doubts_by_name["remarks"] = "; ".join(map(str, run.remarks))
    if stability is not None:
        doubts_by_name |= {
            "from_rest": stability.from_rest,
            "rest_amplitude": stability.rest_amplitude,
        }
    known_doubts_by_name = {
        name: doubt for name, doubt in doubts_by_name.items() if doubt and doubt == doubt
    }
    return known_doubts_by_name | (
        dict.fromkeys(ERROR_NAMES_NAN_IF_UNKNOWN, np.nan) if run.result.report.unknown else {}
    )


def _quantity_text_tables_by_heading(run: Run[Any], table: Table) -> dict[str, Table]:
    """Tabulate quantities as text for the report page.

    "Requested by the scene" has the quantities in ``output.quantities``, left out without any; "In
    numbers" has all.
    """
    requested_names = run.scene.quantities or ()
    requested_rows = [
        row for row in table.rows if str(row[0]).rpartition(".")[2] in requested_names
    ]
    requested_table_by_heading = {
        "Requested by the scene": account.tabulate_known_quantities_as_text(
            Table(table.columns, requested_rows)
        )
    }
    return (requested_table_by_heading if requested_rows else {}) | {
        "In numbers": account.tabulate_known_quantities_as_text(table)
    }


def _describe_departing_motions(solution: PeriodicSolution, watched_dof: int) -> str:
    """Describe the motions reached from an unstable or irregular solution (collective).

    The text has the half peak-to-peak displacement at ``watched_dof``, for periodic motions and for
    motions still varying. The text is empty if no motion was found.
    """
    departing_motions: list[tuple[bool, int, np.ndarray]] = []
    with suppress(ConvergenceError, InputError):
        departing_motions = [
            (attractor.orbit is not None, attractor.periods, attractor.amplitudes(watched_dof))
            for attractor in attractors(solution.structure, solution)
        ]
    settled_range_texts = dict.fromkeys(
        _describe_range(amplitudes) for is_orbit, _, amplitudes in departing_motions if is_orbit
    )
    clause_texts = [f"settles to {' or '.join(settled_range_texts)}"] if settled_range_texts else []
    if varying_motions := [
        (n_periods, amplitudes)
        for is_orbit, n_periods, amplitudes in departing_motions
        if not is_orbit
    ]:
        period_counts, amplitude_arrays = zip(*varying_motions, strict=True)
        amplitude_range_text = _describe_range(np.concatenate(amplitude_arrays))
        clause_texts.append(
            f"still varies after {format_count(min(period_counts), 'period')}, "
            f"{amplitude_range_text}"
        )
    return (
        f"; a disturbed motion {' or '.join(clause_texts)} half peak-to-peak"
        if clause_texts
        else ""
    )


def _describe_range(amplitudes: np.ndarray) -> str:
    """Describe a range of amplitudes [m]: "between 1.2 mm and 1.5 mm".

    Equal ends give a single value.
    """
    end_texts = dict.fromkeys(
        format_quantity(amplitude, "m") for amplitude in (amplitudes.min(), amplitudes.max())
    )
    return f"{'between ' if len(end_texts) > 1 else ''}{' and '.join(end_texts)}"


# --- a motion in time -----------------------------------------------------------------------------


def report_of_history(run: Run[TimeHistory]) -> Report:
    """Build the report of a motion in time, and warn if not settled (collective).

    A settled motion changes over the last period by at most ``integration.settle``.
    """
    history, scene = run.result, run.scene
    table = _tabulate_quantities(
        run, scene.excitation.omega, vars(history) | {"distance": history.distance}
    )
    integration_table, waveforms = scene.integration or Integration(), sample_waveforms(run)
    is_finished = (
        history.periods >= integration_table.periods
        if integration_table.free
        else bool(history.settled <= integration_table.settle)
    )
    warning_texts = []
    if not is_finished and not integration_table.free:
        unsettled_text = (
            f"the motion has not settled after {history.periods} of {integration_table.periods} "
            "periods"
        )
        warning_texts.append(f"{unsettled_text}{_describe_longer_period(history)}")
    warning_texts += account.list_large_motion_warnings(
        run, np.abs(waveforms.displacement).max(axis=0)
    )
    return _make_report(
        run,
        table,
        csv_table=_tabulate_waveforms(run, waveforms),
        warnings=warning_texts,
        has_converged=is_finished,
    )


def _describe_longer_period(history: TimeHistory) -> str:
    """Describe why a motion has not settled: a longer period, or too few periods.

    The period is n load periods if the motion's change over n periods is below a tenth of the
    change over a single period.
    """
    for n_periods in range(2, len(history.by_period(history.time))):
        if (relative_change := history.change(n_periods)) < 0.1 * history.settled:
            return (
                f"; over {n_periods} periods it changes by {relative_change:.2g} only, so its "
                f"period is {n_periods} times the load's"
            )
    return "; raise integration.periods, unless the motion is irregular"


# --- numbers of vibrations and motions ------------------------------------------------------------


def _tabulate_quantities(
    run: Run[Any], omega: float, values_by_name: Mapping[str, object]
) -> Table:
    """Tabulate the quantities of a vibration or a motion in time (collective).

    Rows are the load frequency ``omega`` [rad/s], indicators of watched dofs and crack faces, and
    quantities of the computation. A vibration with contact pairs also has natural frequencies near
    the load's. Without contact pairs, errors and shares are left out.

    Parameters
    ----------
    run : Run
    omega : float [rad/s]
        Load frequency.
    values_by_name : mapping of str to object
        Quantities of the computation; names not in :data:`DESCRIPTION_UNIT_AND_LEVEL_BY_NAME` are
        ignored.

    Returns
    -------
    Table
        Columns name, quantity, value and unit; with stated errors also error [%] and main cause.
    """
    quantity_rows: list[QuantityRow] = [
        (name, name, value, UNIT_BY_NAME[name])
        for name, value in add_frequency_entries({"omega": omega}).items()
    ]
    quantity_rows += [observation[:4] for observation in observe_quantities(run, run.result)]
    if not run.structure.n_pairs:  # no errors were estimated
        values_by_name = {
            name: value
            for name, value in values_by_name.items()
            if not name.endswith(("_error", "_share"))
        }
    elif isinstance(run.result, PeriodicSolution):
        frequencies_by_name = bilinear_frequencies(run.structure).nearest(omega)
        quantity_rows += (
            (name, f"{description}, mode {frequencies_by_name['mode']}", float(value), unit)
            for name, description, unit, value in _yield_natural_frequencies(frequencies_by_name)
        )
    quantity_rows += [
        (name, description, values_by_name[name], unit)
        for name, (description, unit, _) in DESCRIPTION_UNIT_AND_LEVEL_BY_NAME.items()
        if name in values_by_name
    ]
    headings = ["name", "quantity", "value", "unit"]
    quantity_rows = [
        (*quantity_row[:3], "-" if quantity_row[3] == "1" else quantity_row[3])
        for quantity_row in quantity_rows
    ]
    if run.stated is None:
        return Table(headings, quantity_rows)
    return Table(
        [*headings, ERROR_COLUMN_HEADING, "most by"],
        [
            (*quantity_row, *_find_error_and_cause(run, quantity_row[0]))
            for quantity_row in quantity_rows
        ],
    )


def _find_error_and_cause(run: Run[Any], quantity_name: str) -> tuple[float, str]:
    """Return a quantity's stated error, and the main cause.

    A natural frequency has the error of the mode nearest to the load.

    Returns
    -------
    error_percent : float [%]
        At least 0.001; nan if the error is unknown, or as large as the value.
    cause_text : str
        Main cause, and causes not included; empty if the error is unknown and no cause is missing.
    """
    assert run.stated is not None
    frequency_kind = quantity_name.rpartition("_")[2]
    if frequency_kind in FREQUENCY_KIND_NAMES:
        mode_number = bilinear_frequencies(run.structure).nearest(run.result.omega)["mode"]
        quantity_name = natural_frequency_name(run.scene, frequency_kind, int(mode_number))
    relative_error, cause_text = run.stated.stated(quantity_name)
    error_percent = (
        100.0 * max(relative_error, MIN_REPORTED_ERROR) if relative_error < np.inf else np.nan
    )
    missing_cause_reasons = (
        run.stated.find_reasons_by_missing_cause(quantity_name)
        if quantity_name in run.stated.values
        else {}
    )
    if missing_cause_reasons:
        cause_text += f"; not included: {', '.join(missing_cause_reasons)}"
    return float(f"{error_percent:.3g}"), cause_text


def _yield_natural_frequencies(
    frequencies_by_name: Mapping[str, np.ndarray],
) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Yield natural frequencies, and load frequency over natural frequency, with units.

    Parameters
    ----------
    frequencies_by_name : dict of str to ndarray
        Result of :meth:`BilinearFrequencies.nearest`, in rad/s.

    Yields
    ------
    name, words, unit : str
        "omega_open" in rad/s, then "frequency_open" in Hz.
    value : ndarray
    """
    for quantity_name in observable_names(Place.NEAREST_MODE):
        description = OBSERVABLES_BY_NAME[quantity_name].words
        unit = OBSERVABLES_BY_NAME[quantity_name].unit
        yield quantity_name, description, unit, frequencies_by_name[quantity_name]
        if unit == "rad/s":
            yield (
                quantity_name.replace("omega", "frequency"),
                description,
                "Hz",
                frequencies_by_name[quantity_name] / (2.0 * np.pi),
            )


# --- waveforms ------------------------------------------------------------------------------------


class Waveforms(NamedTuple):
    """Hold displacements, gaps and contact forces at n times.

    Attributes
    ----------
    time : (n,) [s]
    displacement : (n, n_watched) [m]
        Watched displacements.
    closings_by_place : dict of str to (n,) [m]
        Gaps at watched pairs, positive if closed, by description of the pair.
    contact_force : (n, n_pairs) [N]
    """

    time: np.ndarray
    displacement: np.ndarray
    closings_by_place: dict[str, np.ndarray]
    contact_force: np.ndarray


def sample_waveforms(run: Run[Any]) -> Waveforms:
    """Sample displacements, gaps and contact forces over time.

    A periodic solution is sampled at 401 instants of a period, a motion in time at the recorded
    instants.
    """
    motion, structure = run.result, run.structure.whole
    watched_dofs = [watched_displacement.dof for watched_displacement in run.watched]
    if isinstance(motion, TimeHistory):
        instants, displacement = motion.time, motion.displacement(watched_dofs)
        gap, contact_force = motion.gap, motion.contact_force
    else:
        instants = np.linspace(0.0, motion.period, 401)
        displacement, gap = motion.displacement(instants, watched_dofs), motion.gap(instants)
        contact_force = motion.contact_force(instants)
    watched_pairs = structure.watched_pairs.values() if gap.size else ()
    closings_by_place = {
        structure.describe_pair(pair_index): gap[:, pair_index] for pair_index in watched_pairs
    }
    return Waveforms(instants, displacement, closings_by_place, contact_force)


def _tabulate_waveforms(run: Run, waveforms: Waveforms) -> Table:
    """Tabulate watched displacements, crack closings and total contact force over time.

    Without contact pairs the table has displacements alone.
    """
    headings = [
        "time [s]",
        *(f"{watched_displacement.words} [m]" for watched_displacement in run.watched),
    ]
    headings += [f"closing {crack_place} [m]" for crack_place in waveforms.closings_by_place]
    column_arrays = [
        waveforms.time,
        *waveforms.displacement.T,
        *waveforms.closings_by_place.values(),
    ]
    if waveforms.closings_by_place:
        headings.append("contact force, all pairs [N]")
        column_arrays.append(waveforms.contact_force.sum(axis=1))
    return Table(headings, np.column_stack(column_arrays).tolist())


# --- a curve --------------------------------------------------------------------------------------


def report_of_curve(run: Run[ResponseCurve]) -> Report:
    """Build the report of a response curve (collective).

    The report has the curve's special points, errors and stability, and a .csv table of all points.
    """
    curve, scene = run.result, run.scene
    indicator_columns_by_heading = _indicator_columns_by_heading(run, curve)
    special_point_table = tabulate_special_points(run, indicator_columns_by_heading)
    shortened_table, n_hidden_points = shorten_special_points(run, special_point_table)
    note_texts = [
        _describe_unstable_peak(run),
        describe_undamped_harmonics(run.structure, highest_harmonic_omega(scene, "curve")),
    ]
    if n_hidden_points:
        note_texts.insert(
            0, f"{n_hidden_points} more bifurcations and changes of stability are in curve.json"
        )
    bifurcation_kinds = dict.fromkeys(bifurcation.kind for bifurcation in curve.bifurcations)
    note_texts += [
        f"{kind_in_words(bifurcation_kind)}: {MEANING_BY_BIFURCATION[bifurcation_kind]}"
        for bifurcation_kind in bifurcation_kinds
        if bifurcation_kind in MEANING_BY_BIFURCATION
    ]
    warning_texts = [
        *_yield_curve_warnings(run),
        *account.list_large_motion_warnings(run, account.find_largest_displacements(run)),
    ]
    indicators = curve.indicators(run.watched_dof)
    peak_index = int(np.argmax(indicators.amplitude))
    if indicators.largest_order[peak_index] > 3:
        place_text = (
            "the largest response" if _is_before_early_end(curve, peak_index) else "the curve's end"
        )
        note_texts.append(
            f"at {place_text} the largest harmonic above harmonic 1 is harmonic "
            f"{indicators.largest_order[peak_index]:.0f}, with "
            f"{indicators.ratio_largest[peak_index]:.2g} of harmonic 1"
        )
    if scene.harmonic_balance.tolerance is not None and run.structure.n_pairs:
        status_detail = curve.status.partition("; ")[2] if curve.complete else ""
        note_texts.append(
            "; ".join(filter(None, (f"method of the curve: {curve.method}", status_detail)))
        )
    if curve.exact:
        width_text = format_in_unit(
            axis_factor_name_and_unit(curve.parameter, True), curve.resolution
        )
        note_texts.append(
            f"unstable ranges narrower than {width_text} may lie between the points of the curve"
        )
    return _make_report(
        run,
        special_point_table,
        csv_table=tabulate_curve_points(run, indicator_columns_by_heading),
        printed_table=account.select_printed_quantities(
            shortened_table, scene, IN_SPECIAL_POINTS_TABLE
        ),
        notes=note_texts,
        warnings=warning_texts,
        page_tables={
            "Special points": account.select_printed_quantities(
                special_point_table, scene, IN_SPECIAL_POINTS_TABLE
            )
        },
        further_tables=_blade_tables_by_heading(run, "Blades, each at its largest response"),
        has_converged=bool(curve.complete) and curve.status != INTERRUPTED_CURVE_STATUS,
        misses_tolerance=bool(explain_unknown_amplitude_error(run)),
    )


def _describe_unstable_peak(run: Run[ResponseCurve]) -> str:
    """State that the curve's largest response is unstable or irregular (collective).

    The text adds the motion seen in a test instead. The text is empty for any other verdict,
    without stability, or if the curve ended early at this point.
    """
    curve = run.result
    peak_index = int(np.argmax(curve.amplitude(run.watched_dof)))
    is_assessed = curve.multipliers is not None and _is_before_early_end(curve, peak_index)
    verdict = str(curve.verdicts[peak_index]) if is_assessed else ""
    if verdict not in ("unstable", "irregular"):
        return ""
    motion_text = _describe_departing_motions(curve.solution(peak_index), run.watched_dof)
    return f"the largest response is {verdict}{motion_text}"


def _is_before_early_end(curve: ResponseCurve, point_index: int) -> bool:
    """Return False for the last point of a curve that ended early.

    At this point the response may still rise.
    """
    return bool(curve.complete) or point_index < len(curve) - 1


def _format_parameters(run: Run[ResponseCurve], *parameter_values: float) -> str:
    """Return values of the curve's parameter with unit: "50.1 and 50.3 Hz"."""
    return format_in_unit(
        axis_factor_name_and_unit(run.result.parameter, run.scene.is_frequency_in_hertz),
        *parameter_values,
    )


def _yield_curve_warnings(run: Run[ResponseCurve]) -> Iterator[str]:
    """Yield warnings about large errors, undecided stability and an early end.

    The largest response and eight points along the curve are checked for errors above 5 %. A curve
    interrupted by Ctrl-C gives a warning about this alone.
    """
    curve, scene = run.result, run.scene
    if (
        curve.status == INTERRUPTED_CURVE_STATUS
    ):  # nothing more is assessed; exact orbits have their verdicts
        end_text = "" if curve.complete else "ended early: the computation "
        skipped_text = "errors and stability" if curve.multipliers is None else "errors"
        yield (
            f"the curve {end_text}was interrupted; its {skipped_text} were not computed: run the "
            "command again"
        )
        return
    peak_index = int(np.argmax(curve.amplitude(run.watched_dof)))
    checked_indices = {peak_index, *np.linspace(0, len(curve) - 1, 8).astype(int).tolist()}
    solutions_by_index = {index: curve.solution(index) for index in sorted(checked_indices)}
    error_reports_by_index = {
        index: solution.report for index, solution in solutions_by_index.items()
    }
    worst_index = max(error_reports_by_index, key=lambda index: error_reports_by_index[index].total)
    location_text = f" at {_format_parameters(run, curve.values[worst_index])}"
    yield from account.yield_large_error_warning(
        scene,
        error_reports_by_index[worst_index],
        solutions_by_index[worst_index].harmonics,
        location_text,
    )
    if curve.multipliers is not None and _is_before_early_end(curve, peak_index):
        for warning_text in account.yield_mode_dependence_warning(
            run.scene, solutions_by_index[peak_index], curve.verdicts[peak_index]
        ):
            yield f"at the largest response, {warning_text}"
    undecided_ranges = _find_undecided_ranges(curve)
    for first_index, last_index in undecided_ranges[:1]:
        end_values = (
            curve.values[[first_index, last_index]]
            if last_index > first_index
            else curve.values[[first_index]]
        )
        location_text = "between " if last_index > first_index else ""
        location_text += _format_parameters(run, *end_values)
        undecided_reason = curve.reason((first_index + last_index) // 2)
        count_text = format_count(last_index + 1 - first_index, "point")
        yield f"the stability is undecided at {count_text}, {location_text}: {undecided_reason}"
    if len(undecided_ranges) > 1:
        n_further_points = sum(
            last_index + 1 - first_index for first_index, last_index in undecided_ranges[1:]
        )
        yield (
            f"the stability is undecided at {format_count(n_further_points, 'other point')}; "
            "in Python curve.reason(index) gives the reasons"
        )
    yield from run.stated.point_force_warnings if run.stated is not None else ()
    if not curve.complete:
        yield f"the curve ended early: {curve.status}"


def _find_undecided_ranges(curve: ResponseCurve) -> list[tuple[int, int]]:
    """Find ranges of successive curve points with undecided stability.

    Returns pairs (first index, last index), longest range first; empty without stability.
    """
    if curve.undecided is None:
        return []
    padded_flags = np.concatenate([[0], curve.undecided, [0]])
    start_indices, stop_indices = (
        np.flatnonzero(np.diff(padded_flags) == flag_step).tolist() for flag_step in (1, -1)
    )
    index_ranges = [
        (start_index, stop_index - 1)
        for start_index, stop_index in zip(start_indices, stop_indices, strict=True)
    ]
    return sorted(index_ranges, key=lambda index_range: index_range[0] - index_range[1])


# --- points of a curve ----------------------------------------------------------------------------


ColumnsByHeading = dict[str, np.ndarray]
"""Columns (n_points,) by heading with unit, "tip.ux.amplitude [m]"."""


def tabulate_curve_points(
    run: Run[ResponseCurve], columns_by_heading: ColumnsByHeading | None = None
) -> Table:
    """Tabulate all points of a curve: parameter, harmonics, verdicts and indicators.

    ``columns_by_heading`` are the indicators, if known already.
    """
    quantity_names = [name for name in run.result.to_dict() if name not in OBSERVABLES_BY_NAME]
    table = run.result.table(*quantity_names)
    indicator_columns_by_heading = columns_by_heading or _indicator_columns_by_heading(
        run, run.result
    )
    indicator_rows = zip(
        *(column.tolist() for column in indicator_columns_by_heading.values()), strict=True
    )
    point_rows = [
        [*point_row, *indicator_row]
        for point_row, indicator_row in zip(table.rows, indicator_rows, strict=True)
    ]
    return Table((*table.columns, *indicator_columns_by_heading), point_rows)


def tabulate_special_points(
    run: Run[ResponseCurve], columns_by_heading: ColumnsByHeading | None = None
) -> Table:
    """Tabulate a curve's ends, largest response, bifurcations and changes of stability.

    The response is the amplitude of the first watched dof. A curve over the load frequency has
    columns in rad/s and in Hz; a run-up also has the speed, in rad/s and rpm.
    ``columns_by_heading`` are the indicators at all points, if known already.
    """
    curve = run.result
    columns_by_heading = _parameter_columns_by_heading(curve) | (
        columns_by_heading or _indicator_columns_by_heading(run, curve)
    )
    curve_at_bifurcations = curve.at_bifurcations if curve.bifurcations else curve
    bifurcation_columns_by_heading = _parameter_columns_by_heading(
        curve_at_bifurcations
    ) | _indicator_columns_by_heading(run, curve_at_bifurcations)
    peak = curve.top(run.watched_dof)
    peak_name = "largest, still rising" if peak.at_end else "largest"
    peak_name = peak_name if _is_before_early_end(curve, peak.index) else "largest so far"
    named_row_sources = [
        ("start", 0, columns_by_heading),
        ("end", -1, columns_by_heading),
        (peak_name, 0, _interpolate_peak_columns(run, peak, columns_by_heading)),
    ]
    for bifurcation_number, bifurcation in enumerate(curve.bifurcations, 1):
        named_row_sources.append(
            (kind_in_words(bifurcation.kind), bifurcation_number, bifurcation_columns_by_heading)
        )
    if curve.multipliers is not None:
        for point_index in np.flatnonzero(curve.verdicts[1:] != curve.verdicts[:-1]):
            next_verdict = curve.verdicts[point_index + 1]
            change_text = {"stable": "gained", "unstable": "lost"}.get(next_verdict, next_verdict)
            named_row_sources.append(
                (f"stability {change_text} after", int(point_index), columns_by_heading)
            )
    table_rows = [
        (point_name, *(float(column[row_index]) for column in source_columns_by_heading.values()))
        for point_name, row_index, source_columns_by_heading in named_row_sources
    ]
    return Table(("point", *columns_by_heading), table_rows)


def _interpolate_peak_columns(
    run: Run[ResponseCurve], peak: LargestResponse, columns_by_heading: ColumnsByHeading
) -> ColumnsByHeading:
    """Return columns (1,) at the largest response of the first watched dof.

    ``columns_by_heading`` are (n_points,). The parameter and the ratios to natural frequencies are
    linear between neighbouring points. The amplitude is the peak's; all other columns have the
    value of the nearest point.
    """
    neighbour_slice = slice(max(peak.index - 1, 0), peak.index + 2)
    parameter_sorting = np.argsort(run.result.values[neighbour_slice])
    parameter_values = run.result.values[neighbour_slice][parameter_sorting]
    parameter_columns_by_heading = _parameter_columns_by_heading(run.result)
    row_by_heading = {
        name: np.interp([peak.value], parameter_values, column[neighbour_slice][parameter_sorting])
        if name in parameter_columns_by_heading or name.startswith("over_")
        else column[[peak.index]]
        for name, column in columns_by_heading.items()
    }
    return row_by_heading | {
        heading_with_unit(run.watched[0].column_name("amplitude"), "m"): np.array([peak.amplitude])
    }


def _parameter_columns_by_heading(curve: ResponseCurve) -> dict[str, np.ndarray]:
    """Return columns (n_points,) with the parameter of a curve.

    Frequencies are in rad/s and Hz, speeds in rad/s and rpm.
    """
    columns_by_heading: dict[str, np.ndarray] = {}
    columns_by_name: dict[str, Any] = {"omega": curve.omega}
    if curve.parameter in ("omega", "speed"):
        columns_by_name = {curve.parameter: curve.values} | columns_by_name
    else:
        columns_by_heading = {DESCRIPTION_BY_PARAMETER[curve.parameter]: curve.values}
        columns_by_name = columns_by_name if curve.parameter == "resonance" else {}
    named_columns = add_frequency_entries(columns_by_name).items()
    return columns_by_heading | {
        heading_with_unit(name, UNIT_BY_NAME[name]): np.asarray(column)
        for name, column in named_columns
    }


def shorten_special_points(run: Run[ResponseCurve], table: Table) -> tuple[Table, int]:
    """Shorten the table of a curve's special points to at most 8 rows.

    Ends and the largest response stay. Bifurcations are kept before changes of stability, larger
    responses before smaller ones. If all points are undecided, no change of stability is kept.

    Returns
    -------
    table : Table
    n_hidden : int
        Number of rows left out.
    """
    curve, point_rows = run.result, [*table.rows]
    first_rows, other_rows = point_rows[:3], point_rows[3:]  # start, end and largest come first
    bifurcations = curve.bifurcations
    amplitude_column_index = next(
        column_index
        for column_index, heading in enumerate(table.columns)
        if heading.endswith("amplitude [m]")
    )
    if curve.multipliers is not None and np.all(curve.verdicts == "undecided"):
        other_rows = other_rows[: len(bifurcations)]

    def rank_row(row_index: int) -> tuple[bool, float]:
        return row_index < len(bifurcations), other_rows[row_index][amplitude_column_index]

    kept_indices = sorted(
        sorted(range(len(other_rows)), key=rank_row, reverse=True)[: N_SELECTED_ROWS - 3]
    )
    kept_rows = [*first_rows, *(other_rows[row_index] for row_index in kept_indices)]
    return Table(table.columns, kept_rows), len(other_rows) - len(kept_indices)


def _indicator_columns_by_heading(
    run: Run[ResponseCurve], curve: ResponseCurve
) -> ColumnsByHeading:
    """Return columns (n_points,) with indicators of motion and contact, by heading with unit.

    Indicators are amplitudes, harmonic ratios, opening and further quantities. Natural frequencies
    of the mode nearest to the load follow. ``curve`` is the run's curve, or a part with fewer
    points.
    """
    columns_by_heading = {
        heading_with_unit(observation.column_name, observation.unit): observation.value
        for observation in observe_quantities(run, curve)
    }
    frequencies_by_name = _solve_natural_frequencies(run, curve.omega).nearest(curve.omega)
    return columns_by_heading | {
        heading_with_unit(name, unit): value
        for name, _, unit, value in _yield_natural_frequencies(frequencies_by_name)
    }


def _solve_natural_frequencies(
    run: Run[ResponseCurve], load_omega: np.ndarray
) -> BilinearFrequencies:
    """Compute natural frequencies, in a run-up at the speed of each load frequency.

    A run-up's load frequencies ``load_omega`` (...) [rad/s] are proportional to the speeds W.
    Squared natural frequencies, (..., n_modes), are interpolated linearly in W^2 between at most
    nine speeds. Without a run-up, the frequencies are (n_modes,).
    """
    structure, curve = run.structure, run.result
    if not isinstance(structure, RunUpStructure):
        return bilinear_frequencies(structure)
    speeds = load_omega * (curve.values[0] / curve.omega[0])
    sample_speeds = np.linspace(speeds.min(), speeds.max(), min(speeds.size, 9))
    frequencies_of_samples = [
        bilinear_frequencies(structure.at_speed(float(sample_speed)))
        for sample_speed in sample_speeds
    ]

    def interpolate_squares(omega_rows: list[np.ndarray]) -> np.ndarray:
        mode_omega_columns = [
            np.interp(speeds**2, sample_speeds**2, mode_omega**2)
            for mode_omega in np.transpose(omega_rows)
        ]
        return np.sqrt(np.stack(mode_omega_columns, axis=-1))

    open_omega_rows, bonded_omega_rows = (
        [getattr(frequencies, f"omega_{frequency_kind}") for frequencies in frequencies_of_samples]
        for frequency_kind in ("open", "tied")
    )
    return BilinearFrequencies(
        interpolate_squares(open_omega_rows), interpolate_squares(bonded_omega_rows)
    )
