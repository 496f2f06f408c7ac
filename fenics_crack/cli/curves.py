"""Report of a response curve: special points, all points, warnings."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from fenics_crack.basics.errors import INTERRUPTED_CURVE_STATUS
from fenics_crack.basics.observables import IN_SPECIAL_POINTS_TABLE, OBSERVABLES_BY_NAME
from fenics_crack.basics.tables import (
    N_PRINTED_ROWS_OF_LONG_RESULT,
    UNIT_BY_DICT_ENTRY_NAME,
    Report,
    Table,
    add_frequency_entries,
    format_count,
    format_in_unit,
    heading_with_unit,
)
from fenics_crack.cli import account
from fenics_crack.cli.account import EFFECT_IN_TEST_BY_BIFURCATION_KIND
from fenics_crack.curves.curve import (
    DESCRIPTION_BY_PARAMETER,
    ResponseCurve,
    axis_factor_name_and_unit,
    kind_in_words,
)
from fenics_crack.curves.peak import LargestResponse
from fenics_crack.model.modes import BilinearFrequencies, bilinear_frequencies
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.runs.conclusion import explain_unknown_amplitude_error
from fenics_crack.runs.run import Run
from fenics_crack.study.key_figures import highest_harmonic_omega
from fenics_crack.study.observer import observe_quantities

ColumnsByHeading = dict[str, np.ndarray]
"""Columns (n_points,) by heading with unit, "tip.ux.amplitude [m]"."""


def report_of_curve(run: Run[ResponseCurve]) -> Report:
    """Build the report of a response curve (collective).

    The report has the curve's special points, errors and stability, and a .csv table of all points.
    """
    curve, scene = run.result, run.scene
    motion_indicators_by_heading = _motion_indicators_by_heading(run, curve)
    special_point_table = tabulate_special_points(run, motion_indicators_by_heading)
    shortened_special_point_table, n_hidden_special_points = shorten_special_points(
        run, special_point_table
    )
    return account.make_report(
        run,
        special_point_table,
        csv_table=tabulate_curve_points(run, motion_indicators_by_heading),
        printed_table=account.select_printed_quantities(
            shortened_special_point_table, scene, IN_SPECIAL_POINTS_TABLE
        ),
        notes=_yield_curve_notes(run, n_hidden_special_points),
        warnings=[
            *_yield_curve_warnings(run),
            *account.yield_large_motion_warning(run, account.find_largest_displacements(run)),
        ],
        html_page_tables={
            "Special points": account.select_printed_quantities(
                special_point_table, scene, IN_SPECIAL_POINTS_TABLE
            )
        },
        further_tables=account.blade_tables_by_heading(run, "Blades, each at its largest response"),
        has_converged=bool(curve.complete) and curve.status != INTERRUPTED_CURVE_STATUS,
        misses_tolerance=bool(explain_unknown_amplitude_error(run)),
    )


def _yield_curve_notes(run: Run[ResponseCurve], n_hidden_special_points: int) -> Iterator[str]:
    """Yield notes on special points, harmonics, the method and the resolution (collective).

    ``n_hidden_special_points`` is the number of special points left out of the printed table.
    """
    curve, scene = run.result, run.scene
    if n_hidden_special_points:
        yield (
            f"{n_hidden_special_points} more bifurcations and changes of stability are in "
            f"curve.json"
        )
    yield _describe_unstable_peak(run)
    yield account.describe_undamped_harmonics(run.structure, highest_harmonic_omega(scene, "curve"))
    for bifurcation_kind in dict.fromkeys(bifurcation.kind for bifurcation in curve.bifurcations):
        if bifurcation_kind in EFFECT_IN_TEST_BY_BIFURCATION_KIND:
            yield (
                f"{kind_in_words(bifurcation_kind)}: "
                f"{EFFECT_IN_TEST_BY_BIFURCATION_KIND[bifurcation_kind]}"
            )
    indicators = curve.indicators(run.watched_dof)
    peak_index = int(np.argmax(indicators.amplitude))
    if indicators.largest_order[peak_index] > 3:
        place_text = (
            "the largest response" if _is_before_early_end(curve, peak_index) else "the curve's end"
        )
        yield (
            f"at {place_text} the largest harmonic above harmonic 1 is harmonic "
            f"{indicators.largest_order[peak_index]:.0f}, with "
            f"{indicators.ratio_largest[peak_index]:.2g} of harmonic 1: look for it in a spectrum, "
            "rather than for harmonics 2 and 3"
        )
    if scene.harmonic_balance.tolerance is not None and run.structure.n_pairs:
        status_detail = curve.status.partition("; ")[2] if curve.complete else ""
        yield "; ".join(filter(None, (f"method of the curve: {curve.method}", status_detail)))
    if curve.exact:
        curve_resolution_text = format_in_unit(
            axis_factor_name_and_unit(curve.parameter, True), curve.max_missed_window_width
        )
        yield (
            f"unstable ranges narrower than {curve_resolution_text} may lie between the points "
            "of the curve; "
            "a curve over a shorter range has closer points"
        )


def _describe_unstable_peak(run: Run[ResponseCurve]) -> str:
    """Return a remark if a curve's largest response is unstable or irregular (collective).

    The remark describes the motions after a small disturbance of this response. The text is empty
    if the response is stable, undecided or not assessed. The text is also empty if the curve ended
    early at this point, without a peak.
    """
    curve = run.result
    peak_index = int(np.argmax(curve.amplitude(run.watched_dof)))
    is_assessed = curve.multipliers is not None and _is_before_early_end(curve, peak_index)
    verdict = str(curve.verdicts[peak_index]) if is_assessed else ""
    if verdict not in ("unstable", "irregular"):
        return ""
    departing_motion_text = account.describe_departing_motions(
        curve.solution(peak_index), run.watched_dof
    )
    return f"the largest response is {verdict}: a test shows another motion{departing_motion_text}"


def _is_before_early_end(curve: ResponseCurve, point_index: int) -> bool:
    """Return True unless a curve ended early at this point.

    Used for the point with the largest response: an early end need not be a peak. ``point_index``
    is the point's index along the curve.
    """
    return bool(curve.complete) or point_index < len(curve) - 1


def _format_parameters(run: Run[ResponseCurve], *parameter_values: float) -> str:
    """Return values of the curve's parameter with unit as text: "50.1 and 50.3 Hz"."""
    return format_in_unit(
        axis_factor_name_and_unit(run.result.parameter, run.scene.is_frequency_in_hertz),
        *parameter_values,
    )


def _yield_curve_warnings(run: Run[ResponseCurve]) -> Iterator[str]:
    """Yield warnings about large errors, undecided stability and an early end.

    The largest response and five points along the curve are checked for errors above 5 %. A curve
    interrupted by Ctrl-C gives a warning about this alone.
    """
    curve, scene = run.result, run.scene
    if (
        curve.status == INTERRUPTED_CURVE_STATUS
    ):  # errors were not computed; exact orbits have multipliers all the same
        end_text = "" if curve.complete else "ended early: the computation "
        uncomputed_quantities_text = (
            "errors and stability" if curve.multipliers is None else "errors"
        )
        yield (
            f"the curve {end_text}was interrupted; its {uncomputed_quantities_text} were not "
            "computed: run the "
            "command again"
        )
        return
    peak_index = int(np.argmax(curve.amplitude(run.watched_dof)))
    error_checked_point_indices = {
        peak_index,
        *np.linspace(0, len(curve) - 1, 5).astype(int).tolist(),
    }
    error_reports_by_index, harmonic_counts_by_index = {}, {}
    for checked_point_index in sorted(error_checked_point_indices):
        is_peak = checked_point_index == peak_index
        # A part of the curve frees the memory of its solutions.
        solution = (
            curve.solution(peak_index)
            if is_peak
            else curve.part([checked_point_index]).solution(0, search=False)
        )
        error_reports_by_index[checked_point_index] = solution.report
        harmonic_counts_by_index[checked_point_index] = solution.harmonics
    worst_index = max(
        error_reports_by_index,
        key=lambda checked_point_index: error_reports_by_index[checked_point_index].total,
    )
    location_text = f" at {_format_parameters(run, curve.values[worst_index])}"
    yield from account.yield_large_error_warning(
        scene,
        error_reports_by_index[worst_index],
        harmonic_counts_by_index[worst_index],
        location_text,
    )
    if curve.multipliers is not None and _is_before_early_end(curve, peak_index):
        for warning_text in account.yield_mode_dependence_warning(
            run.scene, curve.solution(peak_index), curve.verdicts[peak_index]
        ):
            yield f"at the largest response, {warning_text}"
    undecided_index_ranges = _find_undecided_index_ranges(curve)
    for first_undecided_index, last_undecided_index in undecided_index_ranges[:1]:
        range_text = _format_parameters(
            run, *curve.values[sorted({first_undecided_index, last_undecided_index})]
        )
        location_text = (
            f"between {range_text}" if last_undecided_index > first_undecided_index else range_text
        )
        undecided_reason = curve.reason((first_undecided_index + last_undecided_index) // 2)
        count_text = format_count(last_undecided_index + 1 - first_undecided_index, "point")
        yield f"the stability is undecided at {count_text}, {location_text}: {undecided_reason}"
    if len(undecided_index_ranges) > 1:
        n_further_points = sum(
            last_undecided_index + 1 - first_undecided_index
            for first_undecided_index, last_undecided_index in undecided_index_ranges[1:]
        )
        yield (
            f"the stability is undecided at {format_count(n_further_points, 'other point')}; "
            "in Python curve.reason(index) gives the reasons"
        )
    yield from run.stated.point_force_warnings if run.stated is not None else ()
    if not curve.complete:
        yield f"the curve ended early: {curve.status}"


def _find_undecided_index_ranges(curve: ResponseCurve) -> list[tuple[int, int]]:
    """Find ranges of successive curve points with undecided stability.

    Returns pairs (first index, last index), longest range first; empty without stability.
    """
    if curve.is_undecided is None:
        return []
    padded_flags = np.concatenate([[0], curve.is_undecided, [0]])
    start_indices, stop_indices = (
        np.flatnonzero(np.diff(padded_flags) == flag_step).tolist() for flag_step in (1, -1)
    )
    index_ranges = [
        (start_index, stop_index - 1)
        for start_index, stop_index in zip(start_indices, stop_indices, strict=True)
    ]
    return sorted(index_ranges, key=lambda index_range: index_range[0] - index_range[1])


# --- points of a curve ----------------------------------------------------------------------------


def tabulate_curve_points(
    run: Run[ResponseCurve], columns_by_heading: ColumnsByHeading | None = None
) -> Table:
    """Tabulate all points of a curve.

    The columns are parameter, harmonics and stability, then indicators of motion and contact.

    Parameters
    ----------
    run : Run
        Run with the curve.
    columns_by_heading : dict of str to (n_points,), optional
        Indicators at the points by column heading, from :func:`_motion_indicators_by_heading`.
        None: computed here.
    """
    quantity_names = [name for name in run.result.to_dict() if name not in OBSERVABLES_BY_NAME]
    table = run.result.table(*quantity_names)
    motion_indicators_by_heading = columns_by_heading or _motion_indicators_by_heading(
        run, run.result
    )
    motion_indicator_rows = zip(
        *(column.tolist() for column in motion_indicators_by_heading.values()), strict=True
    )
    point_rows = [
        [*point_row, *motion_indicator_row]
        for point_row, motion_indicator_row in zip(table.rows, motion_indicator_rows, strict=True)
    ]
    return Table((*table.columns, *motion_indicators_by_heading), point_rows)


def tabulate_special_points(
    run: Run[ResponseCurve], columns_by_heading: ColumnsByHeading | None = None
) -> Table:
    """Tabulate a curve's ends, largest response, bifurcations and changes of stability.

    The largest response is the first watched dof's. A curve over the load frequency has columns in
    rad/s and in Hz. A run-up also has the rotor speed, in rad/s and rpm.

    Parameters
    ----------
    run : Run
        Run with the curve.
    columns_by_heading : dict of str to (n_points,), optional
        Indicators at the points by column heading, from :func:`_motion_indicators_by_heading`.
        None: computed here.
    """
    curve = run.result
    columns_by_heading = _parameter_columns_by_heading(curve) | (
        columns_by_heading or _motion_indicators_by_heading(run, curve)
    )
    curve_at_bifurcations = curve.at_bifurcations if curve.bifurcations else curve
    bifurcation_columns_by_heading = _parameter_columns_by_heading(
        curve_at_bifurcations
    ) | _motion_indicators_by_heading(run, curve_at_bifurcations)
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
        (
            point_name,
            *(float(column[source_row_index]) for column in source_columns_by_heading.values()),
        )
        for point_name, source_row_index, source_columns_by_heading in named_row_sources
    ]
    return Table(("point", *columns_by_heading), table_rows)


def _interpolate_peak_columns(
    run: Run[ResponseCurve], peak: LargestResponse, columns_by_heading: ColumnsByHeading
) -> ColumnsByHeading:
    """Return a table row at the largest response: arrays (1,) by column heading.

    The peak of the response lies between curve points. The curve's parameter, and ratios of load
    frequency to natural frequency, are interpolated linearly. The amplitude is the peak's. All
    further columns have the values at the curve point nearest to the peak.

    Parameters
    ----------
    run : Run
        Run with the curve.
    peak : LargestResponse
        Largest response of the first watched dof.
    columns_by_heading : dict of str to (n_points,)
        Columns at all curve points.
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
    """Return columns (n_points,) with the parameter of a curve, by heading with unit.

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
        heading_with_unit(name, UNIT_BY_DICT_ENTRY_NAME[name]): np.asarray(column)
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
    first_rows, bifurcation_and_change_rows = (
        point_rows[:3],
        point_rows[3:],
    )  # start, end and largest come first
    bifurcations = curve.bifurcations
    amplitude_column_index = next(
        column_index
        for column_index, heading in enumerate(table.columns)
        if heading.endswith("amplitude [m]")
    )
    if curve.multipliers is not None and np.all(curve.verdicts == "undecided"):
        bifurcation_and_change_rows = bifurcation_and_change_rows[: len(bifurcations)]

    def rank_row(row_index: int) -> tuple[bool, float]:
        return row_index < len(bifurcations), bifurcation_and_change_rows[row_index][
            amplitude_column_index
        ]

    kept_indices = sorted(
        sorted(range(len(bifurcation_and_change_rows)), key=rank_row, reverse=True)[
            : N_PRINTED_ROWS_OF_LONG_RESULT - 3
        ]
    )
    kept_rows = [
        *first_rows,
        *(bifurcation_and_change_rows[row_index] for row_index in kept_indices),
    ]
    return Table(table.columns, kept_rows), len(bifurcation_and_change_rows) - len(kept_indices)


def _motion_indicators_by_heading(
    run: Run[ResponseCurve], curve: ResponseCurve
) -> ColumnsByHeading:
    """Return indicators of motion and contact at a curve's points, by column heading.

    Indicators are amplitudes, harmonic ratios, crack opening and further quantities. The last
    columns have the natural frequencies of the mode nearest to the load frequency. Each column is
    (n_points,); the heading has the unit.

    Parameters
    ----------
    run : Run
        Run with the structure and the watched dofs.
    curve : ResponseCurve
        The run's curve, or a curve with a selection from the run's points.
    """
    columns_by_heading = {
        heading_with_unit(observation.column_name, observation.unit): observation.value
        for observation in observe_quantities(run, curve)
    }
    frequencies_by_name = _solve_natural_frequencies(run, curve.omega).nearest(curve.omega)
    return columns_by_heading | {
        heading_with_unit(name, unit): value
        for name, _, unit, value in account.yield_natural_frequencies(frequencies_by_name)
    }


def _solve_natural_frequencies(
    run: Run[ResponseCurve], load_omega: np.ndarray
) -> BilinearFrequencies:
    """Compute a structure's natural frequencies, for each point of a run-up.

    In a run-up, the structure depends on the rotor speed W, and W is proportional to the load
    frequency. Natural frequencies are computed at up to nine speeds. Between these speeds, the
    squares are interpolated linearly in W^2.

    Parameters
    ----------
    run : Run
        Run with the curve.
    load_omega : (...) [rad/s]
        Load frequencies, used in a run-up only.

    Returns
    -------
    BilinearFrequencies
        Arrays (..., n_modes) [rad/s] in a run-up, otherwise (n_modes,).
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

    return BilinearFrequencies(
        interpolate_squares([frequencies.omega_open for frequencies in frequencies_of_samples]),
        interpolate_squares([frequencies.omega_tied for frequencies in frequencies_of_samples]),
    )
