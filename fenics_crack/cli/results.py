"""Reports of modes, a steady vibration and a motion in time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.observables import OBSERVABLES_BY_NAME, Place
from fenics_crack.basics.tables import (
    MIN_REPORTED_RELATIVE_ERROR,
    UNIT_BY_DICT_ENTRY_NAME,
    Report,
    Table,
    add_frequency_entries,
)
from fenics_crack.cli import account
from fenics_crack.cli.account import DESCRIPTION_UNIT_AND_PRINT_LEVEL_BY_QUANTITY
from fenics_crack.errors.numbers import find_largest_omitted_harmonic, natural_frequency_name
from fenics_crack.model.modes import FREQUENCY_KIND_NAMES, Modes, bilinear_frequencies
from fenics_crack.runs.conclusion import explain_unknown_solution_error
from fenics_crack.runs.run import Run
from fenics_crack.runs.stress_intensity import stress_intensity
from fenics_crack.scene.result_tables import Integration
from fenics_crack.scene.scene import list_requested_extra_quantities
from fenics_crack.study.key_figures import highest_harmonic_omega
from fenics_crack.study.observer import observe_quantities
from fenics_crack.time.march import TimeHistory

ERROR_COLUMN_HEADING = "error [%]"
"""Heading of the table column with stated errors."""
ERROR_NAMES_NAN_IF_UNKNOWN = ("total_error", "displacement_error")
"""Names of error quantities set to nan if the error report is unknown."""
QuantityRow = tuple[str, str, object, str]
"""Row of a table of quantities: name, description, value and unit."""


def report_of_modes(run: Run[Modes]) -> Report:
    """Build the report of natural frequencies with the crack open.

    If errors are known, the table has a column for them.
    """
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
    return account.make_report(run, table)


# --- a steady vibration ---------------------------------------------------------------------------


def report_of_solution(run: Run[PeriodicSolution]) -> Report:
    """Build the report of a steady vibration, with errors and stability (collective)."""
    solution, scene = run.result, run.scene
    table = _tabulate_quantities(
        run, solution.omega, solution.to_dict() | _collect_doubts_by_name(run)
    )
    tolerance = scene.harmonic_balance.tolerance
    is_tolerance_missed = tolerance is not None and solution.report.total > tolerance
    return account.make_report(
        run,
        table,
        csv_table=_tabulate_waveforms(run, sample_waveforms(run)),
        notes=_yield_solution_notes(run),
        warnings=_yield_solution_warnings(run, is_tolerance_missed=is_tolerance_missed),
        further_tables=account.blade_tables_by_heading(run, "Blades")
        | _front_tables_by_heading(run),
        has_converged=solution.converged,
        misses_tolerance=is_tolerance_missed or bool(explain_unknown_solution_error(run)),
    )


def _yield_solution_notes(run: Run[PeriodicSolution]) -> Iterator[str]:
    """Yield notes on a steady vibration; a note may be empty.

    Notes are about harmonics above all damped modes, a large harmonic left out in the solution, and
    a stability not assessed.
    """
    solution, scene = run.result, run.scene
    yield account.describe_undamped_harmonics(run.structure, highest_harmonic_omega(scene, "solve"))
    if not solution.converged:
        return
    if solution.stability is None and run.contact is not None and scene.harmonic_balance.error:
        reduction_text = "" if scene.disk is not None else "a reduction (reduction.method), and "
        yield (
            "the stability is not assessed, as that would take long; to assess it, use "
            f"{reduction_text}contact.law = 'unilateral' if crack faces have no mass"
        )
    if (
        omitted_harmonic_order_and_ratio := find_largest_omitted_harmonic(solution, run.watched_dof)
    ) is not None:
        yield (
            "the largest harmonic above harmonic 1 is harmonic "
            f"{omitted_harmonic_order_and_ratio[0]}, with "
            f"{omitted_harmonic_order_and_ratio[1]:.2g} of harmonic 1 in the exact orbit; this "
            "solution leaves it "
            "out: use more harmonics"
        )


def _yield_solution_warnings(
    run: Run[PeriodicSolution], *, is_tolerance_missed: bool
) -> Iterator[str]:
    """Yield warnings about convergence, errors, stability and large motions (collective).

    ``is_tolerance_missed`` is True for an error above ``harmonic_balance.tolerance``.
    """
    solution, scene, stability = run.result, run.scene, run.result.stability
    if not solution.converged or is_tolerance_missed:
        yield f"{'' if solution.converged else 'not converged: '}{solution.status}"
    elif run.structure.n_pairs:
        yield from account.yield_large_error_warning(scene, solution.report, solution.harmonics)
    if solution.is_still:
        yield "nothing vibrates: no load varies in time; give one, for example excitation.force_sin"
    if not solution.converged:
        return
    departing_motion_text = ""
    if stability is not None:
        if stability.verdict in ("unstable", "irregular"):
            departing_motion_text = account.describe_departing_motions(solution, run.watched_dof)
        yield from account.yield_mode_dependence_warning(scene, solution, stability.verdict)
    yield from account.yield_instability_warning(scene, run, stability, departing_motion_text)
    yield from account.yield_large_motion_warning(run, account.find_largest_displacements(run))
    yield from account.yield_nonunique_contact_force_warning(solution)
    yield from run.stated.point_force_warnings if run.stated is not None else ()


def _front_tables_by_heading(run: Run[Any]) -> dict[str, Table]:
    """Tabulate stress intensities along the crack fronts of a solid (collective).

    The result is a dict with a single table by heading. The dict is empty in two dimensions, or if
    the scene requests no stress intensities at crack tips.
    """
    places_of_requested_quantities = [
        OBSERVABLES_BY_NAME[name].place for name in list_requested_extra_quantities(run.scene)
    ]
    if run.scene.dimension == 2 or Place.MOST_LOADED_TIP not in places_of_requested_quantities:
        return {}
    stress_intensities = stress_intensity(run)
    columns_by_name = {
        "position": stress_intensities.distances_along_crack,
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
    """Collect reasons to doubt a solution, for the table of quantities, by name.

    Returns
    -------
    dict
        "unknown_error": reason why the error is unknown. "remarks": unusual values in the scene.
        "from_rest": outcome of a motion started at rest, unless the motion settles to the solution.
        "rest_amplitude": half the peak-to-peak displacement [m] after this motion has settled.
        Empty texts, zeros and nan are left out. If the error is unknown, "total_error" and
        "displacement_error" are nan; otherwise both are missing.
    """
    stability = run.result.stability
    doubts_by_name: dict[str, object] = {
        "unknown_error": explain_unknown_solution_error(run),
        "remarks": "; ".join(map(str, run.remarks)),
        "from_rest": "" if stability is None else stability.from_rest,
        "rest_amplitude": np.nan if stability is None else stability.rest_amplitude,
    }
    nonempty_doubts_by_name = {
        name: doubt for name, doubt in doubts_by_name.items() if doubt and doubt == doubt
    }
    return nonempty_doubts_by_name | (
        dict.fromkeys(ERROR_NAMES_NAN_IF_UNKNOWN, np.nan) if run.result.report.unknown else {}
    )


# --- a motion in time -----------------------------------------------------------------------------


def report_of_history(run: Run[TimeHistory]) -> Report:
    """Build the report of a motion in time, and warn if not settled (collective).

    A settled motion changes over the last period by at most ``integration.settle``, relative.
    """
    history, scene = run.result, run.scene
    table = _tabulate_quantities(
        run, scene.excitation.omega, vars(history) | {"distance": history.distance_to_steady_motion}
    )
    integration_table, waveforms = scene.integration or Integration(), sample_waveforms(run)
    is_finished = (
        history.periods >= integration_table.periods
        if integration_table.free
        else bool(history.settled <= integration_table.settle)
    )
    warning_texts = []
    if not is_finished and not integration_table.free:
        warning_texts.append(
            f"the motion has not settled after {history.periods} of {integration_table.periods} "
            f"periods{_describe_longer_period(history)}"
        )
    warning_texts += account.yield_large_motion_warning(
        run, np.abs(waveforms.displacement).max(axis=0)
    )
    return account.make_report(
        run,
        table,
        csv_table=_tabulate_waveforms(run, waveforms),
        warnings=warning_texts,
        has_converged=is_finished,
    )


def _describe_longer_period(history: TimeHistory) -> str:
    """Describe why a motion has not settled: a longer period, or too few periods.

    The motion repeats after n load periods if the change over n periods is below a tenth of the
    change over a single period. Otherwise too few periods were integrated.
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

    Rows are the load frequency, indicators of watched dofs and crack faces, and quantities of the
    computation. A vibration with contact pairs also has natural frequencies near the load's.
    Without contact pairs, no errors are known. Quantities with names "..._error" or "..._share" are
    then left out.

    Parameters
    ----------
    run : Run
        Run with the motion.
    omega : float [rad/s]
        Load frequency.
    values_by_name : mapping of str to object
        Quantities of the computation; names not in
        :data:`DESCRIPTION_UNIT_AND_PRINT_LEVEL_BY_QUANTITY` are ignored.

    Returns
    -------
    Table
        Columns name, quantity, value and unit; with stated errors also error [%] and main cause.
    """
    quantity_rows: list[QuantityRow] = [
        (name, name, value, UNIT_BY_DICT_ENTRY_NAME[name])
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
            for name, description, unit, value in account.yield_natural_frequencies(
                frequencies_by_name
            )
        )
    quantity_rows += [
        (name, description, values_by_name[name], unit)
        for name, (description, unit, _) in DESCRIPTION_UNIT_AND_PRINT_LEVEL_BY_QUANTITY.items()
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

    For natural frequencies of the mode nearest to the load, the error is this mode's.

    Returns
    -------
    error_percent : float [%]
        Relative error, at least 0.001 %. nan if the error is unknown, or as large as the quantity.
    cause_text : str
        Main cause of the error, then causes not included in the error. Empty without both.
    """
    assert run.stated is not None
    frequency_kind = quantity_name.rpartition("_")[2]
    if frequency_kind in FREQUENCY_KIND_NAMES:
        mode_number = bilinear_frequencies(run.structure).nearest(run.result.omega)["mode"]
        quantity_name = natural_frequency_name(run.scene, frequency_kind, int(mode_number))
    relative_error, cause_text = run.stated.stated(quantity_name)
    error_percent = (
        100.0 * max(relative_error, MIN_REPORTED_RELATIVE_ERROR)
        if relative_error < np.inf
        else np.nan
    )
    missing_cause_reasons = (
        run.stated.find_reasons_by_missing_cause(quantity_name)
        if quantity_name in run.stated.values
        else {}
    )
    if missing_cause_reasons:
        cause_text += f"; not included: {', '.join(missing_cause_reasons)}"
    return float(f"{error_percent:.3g}"), cause_text


# --- waveforms ------------------------------------------------------------------------------------


class Waveforms(NamedTuple):
    """Hold displacements, gaps and contact forces at n times.

    Attributes
    ----------
    time : (n,) [s]
        Times.
    displacement : (n, n_watched) [m]
        Watched displacements.
    gap_waveforms_by_place : dict of str to (n,) [m]
        Gaps at watched pairs, by description of the pair. A gap is positive while the pair is in
        contact.
    contact_force : (n, n_pairs) [N]
        Contact forces of all pairs.
    """

    time: np.ndarray
    displacement: np.ndarray
    gap_waveforms_by_place: dict[str, np.ndarray]
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
    gap_waveforms_by_place = {
        structure.describe_pair(pair_index): gap[:, pair_index] for pair_index in watched_pairs
    }
    return Waveforms(instants, displacement, gap_waveforms_by_place, contact_force)


def _tabulate_waveforms(run: Run, waveforms: Waveforms) -> Table:
    """Tabulate watched displacements, crack closings and total contact force over time.

    Without contact pairs the table has displacements alone.
    """
    headings = [
        "time [s]",
        *(f"{watched_displacement.words} [m]" for watched_displacement in run.watched),
        *(f"closing {crack_place} [m]" for crack_place in waveforms.gap_waveforms_by_place),
    ]
    column_arrays = [
        waveforms.time,
        *waveforms.displacement.T,
        *waveforms.gap_waveforms_by_place.values(),
    ]
    if waveforms.gap_waveforms_by_place:
        headings.append("contact force, all pairs [N]")
        column_arrays.append(waveforms.contact_force.sum(axis=1))
    return Table(headings, np.column_stack(column_arrays).tolist())
