"""Common parts of reports: warnings, notes, and tables to be printed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from fenics_crack.balance.error_report import LARGE_ERROR, NO_EXACT_ORBIT_TEXT, ErrorReport
from fenics_crack.balance.solution import PeriodicSolution, Stability
from fenics_crack.basics.errors import MAX_HARMONIC_ORDER, ConvergenceError, InputError
from fenics_crack.basics.observables import (
    IN_PRINTED_TABLE,
    OBSERVABLES_BY_NAME,
    ObservableTableFlag,
    Place,
    observable_names,
)
from fenics_crack.basics.tables import Report, Table, format_count, format_percent, format_quantity
from fenics_crack.curves.stability import attractors
from fenics_crack.model.contact import friction_of
from fenics_crack.model.modes import damped_count_and_max_omega_or_none
from fenics_crack.model.structure import Structure
from fenics_crack.runs.conclusion import make_conclusion
from fenics_crack.runs.run import Run
from fenics_crack.scene.scene import Scene
from fenics_crack.study.key_figures import distances_from_clamp
from fenics_crack.study.plausibility import MAX_SMALL_ROTATION

MAX_TRUSTED_TRANSVERSE_SLIDING_RATIO = 0.3
"""Maximum sliding across friction lines, over sliding along the lines, without a warning."""
PRINT_ALWAYS, PRINT_BY_DEFAULT, PRINT_NEVER = range(3)
"""Levels at which a quantity is printed in the result's table.

PRINT_BY_DEFAULT: unless ``output.quantities`` requests quantities. PRINT_NEVER: in files alone, for
parts of an error, and for sentences printed below the table.
"""
DESCRIPTION_UNIT_AND_PRINT_LEVEL_BY_QUANTITY = {
    "periods": ("periods", "-", PRINT_BY_DEFAULT),
    "steps_per_period": ("steps in a period", "-", PRINT_BY_DEFAULT),
    "settled": ("change over the last period", "-", PRINT_BY_DEFAULT),
    "distance": ("estimated distance from the settled motion", "-", PRINT_ALWAYS),
    "created_energy": (
        "energy created by the time steps, relative to the energy put in",
        "-",
        PRINT_BY_DEFAULT,
    ),
    "verdict": ("verdict on the stability", "-", PRINT_ALWAYS),
    "multiplier": ("largest Floquet multiplier", "-", PRINT_BY_DEFAULT),
    "converged": ("converged", "-", PRINT_ALWAYS),
    "harmonics": ("harmonics", "-", PRINT_BY_DEFAULT),
    "iterations": ("iterations", "-", PRINT_BY_DEFAULT),
    "residual_error": ("relative error of the gap: residual", "-", PRINT_NEVER),
    "truncation_error": ("relative error of the gap: harmonics", "-", PRINT_NEVER),
    "sampling_error": ("relative error of the gap: AFT sampling", "-", PRINT_NEVER),
    "reduction_error": ("relative error of the gap: modal truncation", "-", PRINT_NEVER),
    "displacement_error": ("relative error of the displacement at the load", "-", PRINT_NEVER),
    "total_error": ("relative error of the gap by modes and harmonics", "-", PRINT_ALWAYS),
    "penetration_share": ("relative penetration", "-", PRINT_BY_DEFAULT),
    "from_rest": ("the motion from rest", "-", PRINT_NEVER),
    "rest_amplitude": ("half peak-to-peak of the motion from rest", "m", PRINT_BY_DEFAULT),
    "unknown_error": ("reason why the error is unknown", "-", PRINT_NEVER),
    "remarks": ("remarks", "-", PRINT_NEVER),
    "conclusion": ("conclusion", "-", PRINT_NEVER),
}
"""Description, unit and printing level by name, for quantities on the computation.

:data:`OBSERVABLES_BY_NAME` has the motion's quantities.
"""
PROPOSED_TOLERANCE_OPTION = "--set harmonic_balance.tolerance=1e-2"
"""Command-line option proposed in warnings: the solver then chooses the number of harmonics."""
TRUNCATED_MODES_DEPENDENCE_REMARK = "depends on truncated modes"
EFFECT_IN_TEST_BY_BIFURCATION_KIND = {
    "fold": "the curve turns back here; in a test the amplitude jumps",
    "period_doubling": "beyond this point the vibration repeats after two periods of the load; in "
    "a test half the load's frequency appears in the spectrum",
    "neimark_sacker": "beyond this point the vibration does not repeat each period; in a test the "
    "amplitude slowly rises and falls, and the spectrum has sidebands of the load's frequency",
}
"""Sentence by kind of bifurcation: the effect in a test."""
SI_UNITS_OF_VALUES_ROUNDED_TO_ZERO = ("m", "N", "Pa m^0.5")
"""Units with values written as 0 up to 1e-15, as these are rounding errors."""


# --- sentences ------------------------------------------------------------------------------------


def yield_large_motion_warning(
    run: Run[Any], largest_displacements: Sequence[float] | np.ndarray
) -> Iterator[str]:
    """Yield a warning if displacements are too large for small rotations (collective).

    The equations hold for small rotations. The rotation [rad] of a node is estimated as the
    displacement divided by the node's distance from the clamp. The limit is
    :data:`MAX_SMALL_ROTATION`, 0.1. The warning names the dof with the largest rotation.

    Parameters
    ----------
    run : Run
        Run with the watched dofs.
    largest_displacements : (n_watched,) [m]
        Each watched dof's largest displacement, from :func:`find_largest_displacements`.
    """
    clamp_distances = distances_from_clamp(
        run.structure.whole, [watched_displacement.dof for watched_displacement in run.watched]
    )
    rotation_angles = np.asarray(largest_displacements) / clamp_distances
    worst_index = int(np.argmax(rotation_angles))
    if rotation_angles[worst_index] > MAX_SMALL_ROTATION:
        yield (
            f"the {run.watched[worst_index].words} reaches "
            f"{format_quantity(largest_displacements[worst_index], 'm')}, a rotation of about "
            f"{rotation_angles[worst_index]:.2g} rad around the clamp; the equations hold for "
            "small rotations, and the stated errors do not include this; reduce the load"
        )


def find_largest_displacements(run: Run[Any]) -> list[float]:
    """Return each watched dof's largest displacement: (n_watched,) [m] (collective).

    This is |mean| + half the peak-to-peak displacement; for a curve, the maximum over all points.
    """
    watched_indicators = run.result.indicators_of_dofs(
        [watched_displacement.dof for watched_displacement in run.watched]
    )
    return [
        float(np.max(np.abs(indicators.mean) + indicators.amplitude))
        for indicators in watched_indicators
    ]


def yield_large_error_warning(
    scene: Scene,
    report: ErrorReport,
    n_harmonics: int,
    location_text: str = "",
    error_limit: float = LARGE_ERROR,
) -> Iterator[str]:
    """Yield a warning if the estimated error of the gap exceeds a limit.

    The warning names the main cause, for example too few harmonics, and a remedy not yet used in
    the scene. Nothing is yielded if errors were not requested.

    Parameters
    ----------
    scene : Scene
        Scene of the solution.
    report : ErrorReport
        Estimated gap errors by cause, divided by the root mean square of the gaps' motion.
    n_harmonics : int
        Number of harmonics in the solution.
    location_text : str
        Place on a curve, " at 50.1 Hz"; empty for a single solution.
    error_limit : float
        Maximum relative error, by default 5 %.
    """
    if not report.total > error_limit:  # also for nan: errors were not requested
        return
    balance_table = scene.harmonic_balance
    if balance_table.tolerance is None:
        can_tolerance_choose_harmonics = (
            balance_table.samples is None and balance_table.form != "block"
        )
        refinement_text = "more harmonics" + (
            f": {PROPOSED_TOLERANCE_OPTION} chooses them"
            if can_tolerance_choose_harmonics
            else " (harmonic_balance.harmonics)"
        )
    elif n_harmonics < MAX_HARMONIC_ORDER:
        refinement_text = "a smaller harmonic_balance.tolerance"
    else:
        refinement_text = "more damping: the number of harmonics H is at its limit"
    is_unilateral = scene.contact is not None and scene.contact.law == "unilateral"
    residual_remedy_text = (
        "a load that opens the crack further"
        if is_unilateral
        else "a lower contact stiffness, or contact.law = 'unilateral'"
    )
    cause_text, remedy_text = {
        "truncation": ("truncated harmonics", refinement_text),
        "reduction": ("truncated modes", f"more modes ({scene.modes_key})"),
        "sampling": ("AFT sampling", "more samples (harmonic_balance.samples)"),
        "residual": ("rounding in the residual", residual_remedy_text),
    }[report.largest_part]
    error_text = (
        f"the estimated relative error of the gap is {format_percent(report.total)}{location_text}"
        f", mostly due to {cause_text}{'' if report.confirmed else f' ({NO_EXACT_ORBIT_TEXT})'}"
    )
    if report.unknown:
        error_text = (
            f"the error is unknown{location_text}: the estimate for {cause_text} did not converge"
        )
    yield f"{error_text}; use {remedy_text}" if report.confirmed or location_text else error_text


def yield_instability_warning(
    scene: Scene, run: Run, stability: Stability | None, motion_text: str = ""
) -> Iterator[str]:
    """Yield a warning if a solution is unstable, irregular or undecided.

    Irregular means: no periodic orbit was found, and disturbances grow.

    Parameters
    ----------
    scene, run : Scene, Run
        Scene and run with the solution.
    stability : Stability or None
        Verdict on stability; None gives no warning.
    motion_text : str
        Result of :func:`describe_departing_motions`: a motion started near the solution, in words.
        Empty if unknown.
    """
    if stability is None or stability.verdict == "stable":
        return
    reason_text = f" ({stability.reason})" if stability.reason else ""
    hint_texts = [] if scene.harmonic_balance.tolerance else [PROPOSED_TOLERANCE_OPTION]
    if stability.verdict == "irregular":
        hints_text = f"; {hint_texts[0]} may find a periodic orbit" if hint_texts else ""
        yield f"{stability.reason}{motion_text}{hints_text}"
    elif stability.verdict == "undecided":
        damping_table = scene.damping  # None: a damping matrix; the damped modes are unknown
        if damping_table and not (
            damping_table.damps_all_modes
            or damped_count_and_max_omega_or_none(run.structure) is None
        ):
            hint_texts.append("damping of all modes (damping.modes = 'all')")
        hints_text = f"; {' or '.join(hint_texts)} may decide it" if hint_texts else ""
        yield f"the stability of the orbit is undecided{reason_text}{motion_text}{hints_text}"
    else:
        multiplier_of_largest_modulus = complex(stability.multipliers[0])
        motion_description = "with another amplitude"
        if multiplier_of_largest_modulus.imag != 0.0:
            motion_description = "that does not repeat each period: its amplitude slowly varies"
        elif multiplier_of_largest_modulus.real <= 0.0:
            motion_description = "that repeats after two periods of the load"
        yield (
            f"the orbit is unstable{reason_text}: a test shows another motion, {motion_description}"
            f"{motion_text or '; fenics-crack integrate computes the motion from rest'}"
        )


def list_friction_line_notes_and_warnings(run: Run[Any]) -> tuple[list[str], list[str]]:
    """Describe friction along lines in a solid, and warn if the sliding direction turns.

    At each contact pair friction acts along a fixed line. Sliding across this line has no friction.
    The warning is given if sliding across exceeds :data:`MAX_TRUSTED_TRANSVERSE_SLIDING_RATIO`,
    0.3, times sliding along the line.

    Returns
    -------
    notes, warnings : list of str
        At most one text each; empty lists for plates and without friction.
    """
    if not (transverse_sliding_ratio := getattr(friction_of(run.contact), "turning", None)):
        return [], []
    warning_text = (
        "the crack faces slide across the direction of friction, by "
        f"{transverse_sliding_ratio:.2g} of the sliding along it; do not trust the effect of "
        "friction"
    )
    note_text = (
        "at each contact pair friction acts along one direction; sliding across it has no "
        f"friction, and is {transverse_sliding_ratio:.2g} of the sliding along it"
    )
    if transverse_sliding_ratio > MAX_TRUSTED_TRANSVERSE_SLIDING_RATIO:
        return [note_text], [warning_text]
    return [
        f"{note_text}; up to {MAX_TRUSTED_TRANSVERSE_SLIDING_RATIO:g} nothing needs to be done"
    ], []


def yield_nonunique_contact_force_warning(solution: PeriodicSolution) -> Iterator[str]:
    """Yield a warning if friction may make contact forces ambiguous.

    Above a critical coefficient of friction, the contact forces at an instant may not be unique.
    The warning is given from half the critical coefficient on. Nothing is yielded without friction,
    or if ``solution`` was not also integrated in time exactly.
    """
    exact_flow = solution.assessment.flow
    if exact_flow is None or exact_flow.friction_law is None:
        return
    largest_coefficient = float(np.max(exact_flow.friction_law.coefficient))
    critical_coefficient = exact_flow.critical_friction_coefficient
    if largest_coefficient > 0.5 * critical_coefficient:
        yield (
            f"the coefficient of friction, {largest_coefficient:g}, is above half of "
            f"{critical_coefficient:.2g}; above {critical_coefficient:.2g} the contact forces at "
            "an instant may not be unique: reduce contact.friction"
        )


def yield_mode_dependence_warning(
    scene: Scene, solution: PeriodicSolution, verdict: str
) -> Iterator[str]:
    """Yield a warning if the verdict on stability changes with more modes.

    A reduced structure lacks higher modes, so the verdict may be wrong. A check with at least twice
    the modes finds an orbit near the solution, and assesses this orbit. Nothing is yielded if the
    verdicts agree, or if the check was not made.

    Parameters
    ----------
    scene : Scene
        Scene of the solution; the warning names the key for the number of modes.
    solution : PeriodicSolution
        Solution with the result of the check.
    verdict : str
        The solution's own verdict.
    """
    assessment_with_more_modes = solution.assessment.more_modes
    if assessment_with_more_modes is not None and (
        contradiction_text := assessment_with_more_modes.describe_contradiction(verdict)
    ):
        yield (
            f"{contradiction_text}: the verdict {verdict!r} "
            f"{TRUNCATED_MODES_DEPENDENCE_REMARK}; raise "
            f"{scene.modes_key}"
        )


def describe_departing_motions(solution: PeriodicSolution, watched_dof: int) -> str:
    """Describe the motions after a small disturbance (collective).

    Motions are started near ``solution``, an unstable or irregular solution. Each is computed until
    periodic, or up to a time limit.

    Returns
    -------
    str
        Half peak-to-peak displacement at ``watched_dof``, for motions now periodic, and for motions
        still varying at the end. Empty if no motion was found.
    """
    departing_motions: list[tuple[bool, int, np.ndarray]] = []
    with suppress(ConvergenceError, InputError):
        departing_motions = [
            (
                attractor.orbit is not None,
                attractor.n_integrated_load_periods,
                attractor.amplitude_in_each_period(watched_dof),
            )
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
        n_periods_of_varying_motions, amplitude_arrays = zip(*varying_motions, strict=True)
        amplitude_range_text = _describe_range(np.concatenate(amplitude_arrays))
        clause_texts.append(
            f"still varies after {format_count(min(n_periods_of_varying_motions), 'period')}, "
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


def describe_undamped_harmonics(structure: Structure, highest_omega: float) -> str:
    """Return a remark if the highest harmonic lies above all damped modes (collective).

    The text is empty if a damped mode lies above the harmonic. The text is also empty without
    contact pairs, as only contact excites harmonics.

    Parameters
    ----------
    structure : Structure
        Structure with the damped modes.
    highest_omega : float [rad/s]
        Frequency of the highest harmonic.
    """
    n_damped_modes_and_their_max_omega = (
        damped_count_and_max_omega_or_none(structure) if structure.n_pairs else None
    )
    if (
        n_damped_modes_and_their_max_omega is None
        or highest_omega <= n_damped_modes_and_their_max_omega[1]
    ):
        return ""
    n_damped_modes, highest_damped_omega = n_damped_modes_and_their_max_omega
    if n_damped_modes == 0:
        return (
            f"harmonics reach H w = {highest_omega:g} rad/s, but no mode is damped; set [damping]"
        )
    damped_modes_text = (
        "the damped mode" if n_damped_modes == 1 else f"the {n_damped_modes} damped modes"
    )
    return (
        f"harmonics reach H w = {highest_omega:g} rad/s, beyond {damped_modes_text} "
        f"({highest_damped_omega:g} rad/s); higher modes are not damped: raise damping.modes"
    )


# --- the report -----------------------------------------------------------------------------------


def make_report(
    run: Run[Any],
    table: Table,
    *,
    notes: Iterable[str] = (),
    warnings: Iterable[str] = (),
    **report_fields: Any,
) -> Report:
    """Build a run's report, with notes common to all kinds of runs (collective).

    The common notes are about friction along lines, and output points away from nodes. Further
    notes name causes not included in the stated errors.

    Parameters
    ----------
    run : Run
        Run with the result.
    table : Table
        Table to write to files. If the first column is "name", each row is a quantity. The report's
        closing sentence is then added as the last row.
    notes, warnings : iterable of str
        Notes and warnings for this kind of run.
    report_fields
        Further fields of the :class:`Report`, by name.
    """
    friction_notes, friction_warnings = list_friction_line_notes_and_warnings(run)
    incomplete_error_notes = () if run.stated is None else run.stated.incomplete_error_notes
    report = Report(
        table,
        make_conclusion(run),
        notes=[*notes, *friction_notes, *_yield_node_distance_note(run), *incomplete_error_notes],
        warnings=[*warnings, *friction_warnings],
        remarks=run.remarks,
        **report_fields,
    )
    if table.columns[0] != "name":
        return report
    conclusion_description = DESCRIPTION_UNIT_AND_PRINT_LEVEL_BY_QUANTITY["conclusion"][0]
    empty_error_cells = ["" for _ in table.columns[4:]]
    conclusion_row = [
        "conclusion",
        conclusion_description,
        report.closing_sentence,
        "-",
        *empty_error_cells,
    ]
    return replace(
        report,
        table=Table(table.columns, [*table.rows, conclusion_row]),
        printed_table=select_printed_quantities(table, run.scene, IN_PRINTED_TABLE),
        html_page_tables=_quantity_text_tables_by_heading(run, table),
    )


def _yield_node_distance_note(run: Run[Any]) -> Iterator[str]:
    """Yield a note on the distances between output points and watched nodes.

    Output points are watched at the nearest nodes. No note is given if all points are nodes.
    """
    distance_by_point = {
        watched_displacement.name.partition(".")[0]: watched_displacement.distance_to_node
        for watched_displacement in run.watched
        if watched_displacement.distance_to_node > 0
    }
    distances_text = ", ".join(
        f"{point_name} {format_quantity(node_distance, 'm')}"
        for point_name, node_distance in distance_by_point.items()
    )
    distance_not_in_errors_text = (
        "; the stated errors do not include this distance" if run.stated is not None else ""
    )
    if distances_text:
        yield (
            "each output point is observed at its nearest node, at a distance of: "
            f"{distances_text}{distance_not_in_errors_text}; if this is too far, use smaller "
            "elements there"
        )


def _quantity_text_tables_by_heading(run: Run[Any], table: Table) -> dict[str, Table]:
    """Tabulate quantities for the report page, by heading above the table.

    "In numbers" has all quantities. "Requested by the scene" has the quantities in the scene's key
    ``output.quantities``; without this key, the table is omitted.

    Parameters
    ----------
    run : Run
        Run with the scene.
    table : Table
        A quantity in each row: name, description, value and unit.
    """
    requested_names = run.scene.quantities or ()
    requested_rows = [
        row for row in table.rows if str(row[0]).rpartition(".")[2] in requested_names
    ]
    requested_table_by_heading = {
        "Requested by the scene": tabulate_known_quantities_as_text(
            Table(table.columns, requested_rows)
        )
    }
    return (requested_table_by_heading if requested_rows else {}) | {
        "In numbers": tabulate_known_quantities_as_text(table)
    }


def blade_tables_by_heading(run: Run[Any], heading: str) -> dict[str, Table]:
    """Tabulate the vibration of each blade of a bladed disk (collective).

    The result is a dict with a single table, for the key ``heading``. Without a disk in the scene,
    the dict is empty.
    """
    if run.scene.disk is None:
        return {}
    from fenics_crack.disk.bladed_disk import blades

    return {heading: blades(run).table()}


def yield_natural_frequencies(
    frequencies_by_name: Mapping[str, np.ndarray],
) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Yield natural frequencies in rad/s and Hz, and ratios of the load frequency to them.

    Used for tables of quantities.

    Parameters
    ----------
    frequencies_by_name : dict of str to ndarray
        Result of :meth:`BilinearFrequencies.nearest`: frequencies [rad/s] and ratios.

    Yields
    ------
    name, words, unit : str
        Name, description and unit. "omega_open" in rad/s is followed by the same frequency as
        "frequency_open" in Hz. A ratio, for example "over_open", has the unit 1.
    value : ndarray
        Numbers in this unit.
    """
    for quantity_name in observable_names(Place.MODE_NEAREST_TO_LOAD_FREQUENCY):
        observable, value = OBSERVABLES_BY_NAME[quantity_name], frequencies_by_name[quantity_name]
        yield quantity_name, observable.words, observable.unit, value
        if observable.unit == "rad/s":
            name_of_frequency_in_hertz = quantity_name.replace("omega", "frequency")
            yield name_of_frequency_in_hertz, observable.words, "Hz", value / (2.0 * np.pi)


# --- printed parts of tables ----------------------------------------------------------------------


def select_printed_quantities(
    table: Table, scene: Scene, table_kind_flag: ObservableTableFlag
) -> Table:
    """Select the quantities of a result's table to print.

    The scene's key ``output.quantities`` chooses the quantities. Without this key, the default
    quantities are printed. Each frequency and each speed is printed in a single unit, the scene's.

    Parameters
    ----------
    table : Table
        Table with all quantities. If the first column is "name", each row is a quantity. Otherwise
        the columns are quantities. Columns with anything else are all kept.
    scene : Scene
        Scene with the keys and units.
    table_kind_flag : ObservableTableFlag
        Flag for the kind of table; selects the default quantities.

    Returns
    -------
    Table
        Table to print. If each row is a quantity, the column "name" and rows with the value nan are
        left out. Rows about the computation, for example the harmonic count, are printed as listed
        in :data:`DESCRIPTION_UNIT_AND_PRINT_LEVEL_BY_QUANTITY`.
    """
    requested_names, default_names = (
        scene.quantities,
        observable_names(required_flags=table_kind_flag),
    )
    table = _round_to_zero(table)

    def is_printed(name: str, unit: str) -> bool:
        name = name.rpartition(".")[2]
        if _is_in_unused_unit(name, unit, scene):
            return False
        name = name.replace("frequency_", "omega_")
        return name in (requested_names or default_names) if name in OBSERVABLES_BY_NAME else True

    if table.columns[0] == "name":
        printed_levels = (
            (PRINT_ALWAYS, PRINT_BY_DEFAULT) if requested_names is None else (PRINT_ALWAYS,)
        )
        printed_rows = [
            table_row[1:]
            for table_row in table.rows
            if is_printed(table_row[0], table_row[3])
            and not (isinstance(table_row[2], float) and np.isnan(table_row[2]))
            and DESCRIPTION_UNIT_AND_PRINT_LEVEL_BY_QUANTITY.get(
                table_row[0], ("", "", PRINT_ALWAYS)
            )[2]
            in printed_levels
        ]
        return Table(table.columns[1:], printed_rows)
    return _select_columns(table, is_printed)


def _round_to_zero(table: Table) -> Table:
    """Replace rounding errors in a table by 0.

    A value up to 1e-15, in a unit of :data:`SI_UNITS_OF_VALUES_ROUNDED_TO_ZERO`, is a rounding
    error. The units are in the column "unit". In a table without this column, the units are in the
    headings: "gap [m]".
    """
    column_units = [heading.partition("[")[2].rstrip("]") for heading in table.columns]
    unit_column_index = table.columns.index("unit") if "unit" in table.columns else None

    def round_value(cell_value: Any, unit: str) -> Any:
        can_round = isinstance(cell_value, float) and unit in SI_UNITS_OF_VALUES_ROUNDED_TO_ZERO
        return 0.0 if can_round and abs(cell_value) <= 1e-15 else cell_value

    rounded_rows = []
    for table_row in table.rows:
        cell_units = (
            column_units
            if unit_column_index is None
            else len(column_units) * [str(table_row[unit_column_index])]
        )
        rounded_rows.append(
            [
                round_value(*cell_and_unit)
                for cell_and_unit in zip(table_row, cell_units, strict=True)
            ]
        )
    return Table(table.columns, rounded_rows)


def make_printed_table(report: Report) -> Table:
    """Return the table printed for a report.

    If the report has a scene, each frequency and each speed is printed in a single unit. The unit
    is the scene's: Hz or rad/s for a frequency, rpm or rad/s for a speed.
    """
    table, scene = report.printed_table or report.table, report.scene
    if scene is None:
        return table
    return _select_columns(table, lambda name, unit: not _is_in_unused_unit(name, unit, scene))


def _is_in_unused_unit(name: str, unit: str, scene: Scene) -> bool:
    """Return True for a frequency or speed in a unit not used in the scene.

    A scene uses a single unit for frequencies, rad/s or Hz. For speeds the unit is rad/s or rpm.

    Parameters
    ----------
    name : str
        Quantity: "omega..." or "frequency..." for a frequency, "speed" [rad/s] or "rpm" for a
        speed. Any other name gives False.
    unit : str
        Unit of the quantity.
    scene : Scene
        Scene with the units.
    """
    unused_name_prefix, unused_unit = (
        ("omega", "rad/s") if scene.is_frequency_in_hertz else ("frequency", "Hz")
    )
    unused_speed_name = "speed" if scene.is_speed_in_rpm else "rpm"
    return name == unused_speed_name or (
        name.startswith(unused_name_prefix) and unit == unused_unit
    )


def _select_columns(table: Table, is_selected: Callable[[str, str], bool]) -> Table:
    """Return a table with the columns selected by ``is_selected(name, unit)``.

    The heading "gap [m]" has the name "gap" and the unit "m".
    """
    names_and_units = (heading.rstrip("]").partition(" [") for heading in table.columns)
    column_indices = [
        column_index
        for column_index, (name, _, unit) in enumerate(names_and_units)
        if is_selected(name, unit)
    ]
    return Table(
        [table.columns[column_index] for column_index in column_indices],
        [[table_row[column_index] for column_index in column_indices] for table_row in table.rows],
    )


def tabulate_known_quantities_as_text(table: Table) -> Table:
    """Tabulate quantities with values as text, "7.916 µm"; omit quantities with the value nan.

    ``table`` has the columns name, description, value and unit. A relative quantity becomes a
    percentage: "5.7 %". Further columns, for errors and causes, are copied.
    """
    known_rows = [
        table_row[1:] for table_row in _round_to_zero(table).rows if table_row[2] == table_row[2]
    ]
    return Table(
        ("quantity", "value", *table.columns[4:]),
        [(table_row[0], _format_value(*table_row[:3]), *table_row[3:]) for table_row in known_rows],
    )


def _format_value(description: str, quantity_value: Any, unit: str) -> Any:
    """Return a quantity's value with unit as text.

    Parameters
    ----------
    description : str
        Description of the quantity. After the first word "relative", a number becomes a percentage.
    quantity_value
        Number, text, True ("yes") or False ("no").
    unit : str
        SI unit; "-", "1" and "" are not printed.
    """
    is_finite_number = isinstance(quantity_value, float) and np.isfinite(quantity_value)
    if is_finite_number and unit in SI_UNITS_OF_VALUES_ROUNDED_TO_ZERO:
        return format_quantity(quantity_value, unit)
    if is_finite_number and description.startswith("relative "):
        return format_percent(quantity_value)
    value_text = (
        f"{quantity_value:.6g}"
        if is_finite_number
        else {True: "yes", False: "no"}.get(quantity_value, quantity_value)
    )
    return value_text if unit in ("-", "1", "") else f"{value_text} {unit}"
