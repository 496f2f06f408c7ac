"""Reports of sweeps and convergence studies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fenics_crack.balance.error_report import LARGE_ERROR, PART_NAMES_OF_TOTAL_ERROR, ErrorReport
from fenics_crack.basics.observables import IN_SPECIAL_POINTS_TABLE, observable_names
from fenics_crack.basics.tables import (
    N_PRINTED_ROWS_OF_LONG_RESULT,
    Report,
    Table,
    format_count,
    format_in_unit,
    format_percent,
)
from fenics_crack.cli.account import TRUNCATED_MODES_DEPENDENCE_REMARK, yield_large_error_warning
from fenics_crack.errors.verification import Verification
from fenics_crack.scene.keys import unit_of_key
from fenics_crack.study.plausibility import remarks_on_scene
from fenics_crack.sweep.plan import LOAD_FREQUENCY_KEYS
from fenics_crack.sweep.result import (
    VERDICTS_NOT_STABLE,
    SweepResult,
    describe_swept_values,
    iterate_texts_by_reason,
)

ROTOR_SPEED_KEYS = ("rotation.speed", "rotation.rpm")


def report_of_verification(verification: Verification) -> Report:
    """Build the report of a convergence study: errors by cause, notes and warnings.

    Causes are mesh, modes and harmonics, for example.
    """
    return Report(
        verification.table(),
        verification.build_conclusion(),
        printed_table=verification.totals(),
        notes=verification.statement[: -len(verification.warnings) or None],
        warnings=verification.warnings,
        remarks=remarks_on_scene(verification.scene),
        has_converged=not verification.failures,
        misses_tolerance=bool(verification.doubt(next(iter(verification.values)))),
    )


def report_of_sweep(sweep_result: SweepResult) -> Report:
    """Build the report of a sweep: table of cases, failed cases and warnings."""
    short_table, selection_text = shorten_sweep_table(sweep_result)
    counts_by_state = {
        "converged": int(sweep_result.converged.sum()),
        "failed": len(sweep_result.failed_indices_and_reasons),
    }
    counts_by_state["pending"] = sweep_result.converged.size - sum(counts_by_state.values())
    states_text = ", ".join(
        f"{n_cases_in_state} {state_name}"
        for state_name, n_cases_in_state in counts_by_state.items()
        if n_cases_in_state
    )
    n_high_order_cases = int(np.sum(sweep_result["largest_order"] > 3))
    high_harmonic_note = ""
    if n_high_order_cases:
        high_harmonic_note = (
            f"in {format_count(n_high_order_cases, 'case')} the largest harmonic above harmonic 1 "
            "is above harmonic 3; see the columns ratio_largest and largest_order"
        )
    tables_by_heading = {"Cases": short_table}
    if sweep_result.failed_indices_and_reasons:
        failed_rows = [
            (str(case_index), reason_text)
            for case_index, reason_text in sweep_result.failed_indices_and_reasons
        ]
        tables_by_heading["Failed cases"] = Table(("case", "reason"), failed_rows)
    return Report(
        sweep_result.table(),
        sweep_result.build_conclusion(),
        printed_table=short_table,
        notes=[f"cases: {states_text}{selection_text}", high_harmonic_note],
        warnings=[*yield_sweep_warnings(sweep_result)],
        html_page_tables=tables_by_heading,
        remarks=[*remarks_on_scene(sweep_result.scene), *list_skipped_peak_remarks(sweep_result)],
        has_converged=not sweep_result.failed_indices_and_reasons
        and sweep_result.complete,  # mpirun calls all other ends an aborted job
    )


def yield_sweep_warnings(sweep_result: SweepResult) -> Iterator[str]:
    """Yield warnings about failed cases, large errors, doubtful stability and an early stop."""
    yield from iterate_texts_by_reason(
        sweep_result, sweep_result.failed_indices_and_reasons, "failed"
    )
    yield from _yield_large_error_warnings(sweep_result)
    verdicts = sweep_result["verdict"][sweep_result.converged]
    counts_by_verdict = {
        verdict: int(np.sum(verdicts == verdict)) for verdict in VERDICTS_NOT_STABLE
    }
    if counts_by_verdict["undecided"] == verdicts.size > 0:
        yield "the stability is undecided in all cases"
    elif verdict_counts_text := " and ".join(
        f"{n_cases_with_verdict} {verdict}"
        for verdict, n_cases_with_verdict in counts_by_verdict.items()
        if n_cases_with_verdict
    ):
        yield f"stability: {verdict_counts_text} of {format_count(verdicts.size, 'case')}"
    yield from iterate_texts_by_reason(
        sweep_result, sweep_result.undecided_indices_and_reasons, "undecided"
    )
    for warning_text in iterate_texts_by_reason(
        sweep_result,
        sweep_result.cases_contradicted_by_more_modes,
        f"or more with a verdict on stability that {TRUNCATED_MODES_DEPENDENCE_REMARK}",
    ):
        yield f"{warning_text}; raise {sweep_result.scene.modes_key}"
    if not sweep_result.complete:
        yield "the sweep was stopped; run the same command again to continue it"


def _yield_large_error_warnings(sweep_result: SweepResult) -> Iterator[str]:
    """Yield warnings about cases with a large estimated error.

    An error is large above 5 % (:data:`LARGE_ERROR`), or above a lower
    ``harmonic_balance.tolerance``. Cases are grouped by the largest part of the error: harmonics,
    modes, sampling or residual. Each group has a warning about the worst case.
    """
    error_limit = min(LARGE_ERROR, sweep_result.scene.harmonic_balance.tolerance or LARGE_ERROR)
    part_errors = sweep_result.error_parts
    total_errors = np.where(sweep_result.converged, part_errors.sum(axis=0), 0.0)
    largest_part_indices = part_errors.argmax(axis=0)
    for part_index in np.unique(largest_part_indices[total_errors > error_limit]):
        is_in_group = (total_errors > error_limit) & (largest_part_indices == part_index)
        flat_index = np.where(is_in_group, total_errors, 0.0).argmax()
        case_index = tuple(map(int, np.unravel_index(flat_index, total_errors.shape)))
        values_by_key = {
            axis.key: axis.values[value_index]
            for axis, value_index in zip(sweep_result.axes, case_index, strict=True)
        }
        case_scene = sweep_result.scene.replace({"sweep": None} | values_by_key)
        error_report = ErrorReport(
            **dict(
                zip(PART_NAMES_OF_TOTAL_ERROR, part_errors[:, *case_index].tolist(), strict=True)
            )
        )
        count_text = (
            f"{format_count(int(is_in_group.sum()), 'case')} with an error above "
            f"{format_percent(error_limit)}"
        )
        for warning_text in yield_large_error_warning(
            case_scene,
            error_report,
            int(sweep_result["harmonics"][case_index]),
            error_limit=error_limit,
        ):
            yield (
                f"{count_text}, the largest at "
                f"{describe_swept_values(sweep_result.axes, case_index)}: {warning_text}"
            )


def list_skipped_peak_remarks(sweep_result: SweepResult) -> list[str]:
    """Remark that the sweep steps over a resonance peak narrower than a step.

    Across a resonance peak, the phase falls by a quarter turn between the half-power points. If the
    phase falls by more between two neighbouring cases, a peak lies between them. The phase rises
    instead if the rotor speed is swept under a constant load frequency. A single remark describes
    all skipped peaks; without any, the list is empty.
    """
    axis_indices = [
        axis_index
        for axis_index, axis in enumerate(sweep_result.axes)
        if axis.key in (*LOAD_FREQUENCY_KEYS, *ROTOR_SPEED_KEYS)
    ]
    if not axis_indices:
        return []
    swept_axis = sweep_result.axes[axis_indices[0]]
    complex_responses_of_cases = sweep_result["sine_1"] + 1j * sweep_result["cosine_1"]
    sorting_index = np.argsort(swept_axis.values)
    complex_responses_of_cases = np.moveaxis(complex_responses_of_cases, axis_indices[0], -1)[
        ..., sorting_index
    ]
    if swept_axis.key in ROTOR_SPEED_KEYS and sweep_result.scene.excitation.order is None:
        complex_responses_of_cases = (
            complex_responses_of_cases.conj()
        )  # the natural frequency rises past the load's constant frequency
    is_peak_within_step = (
        np.angle(
            complex_responses_of_cases[..., 1:] * np.conj(complex_responses_of_cases[..., :-1])
        )
        < -0.5 * np.pi
    )
    if not is_peak_within_step.any():
        return []
    *value_indices_on_other_axes, step_index = map(int, np.argwhere(is_peak_within_step)[0])
    end_values = (
        swept_axis.values[value_index] for value_index in sorting_index[step_index : step_index + 2]
    )
    range_text = format_in_unit((1.0, swept_axis.key, unit_of_key(swept_axis.key)), *end_values)
    other_axes = [
        axis for axis_index, axis in enumerate(sweep_result.axes) if axis_index != axis_indices[0]
    ]
    location_text = "".join(
        f", {other_axis_values_text}"
        for other_axis_values_text in [
            describe_swept_values(other_axes, value_indices_on_other_axes)
        ]
        if other_axis_values_text
    )
    n_further_steps = int(is_peak_within_step.sum()) - 1
    further_text = (
        f", and at {format_count(n_further_steps, 'other place')}" if n_further_steps else ""
    )
    return [
        f"between {range_text}{location_text}{further_text}, the sweep steps over a peak "
        "that is narrower than the step and holds the largest response; use smaller steps, or "
        "fenics-crack curve"
    ]


def shorten_sweep_table(sweep_result: SweepResult) -> tuple[Table, str]:
    """Tabulate all cases of a small sweep, or the largest responses of a large sweep.

    A small sweep has up to 8 cases (:data:`N_PRINTED_ROWS_OF_LONG_RESULT`). In a large sweep, a
    single axis is chosen: the load frequency or, if not swept, the axis with most values. For each
    combination of values on all further axes, the case with the largest response along the chosen
    axis is kept. If more than 8 cases are kept, only the 8 largest responses remain.

    Returns
    -------
    table : Table
        Columns: swept keys, quantities, and the verdict on stability if known. If a case has not
        converged, also the state: pending, converged or failed.
    selection_text : str
        Selection of cases in words; empty if all cases are kept.
    """
    axis_keys = [axis.key for axis in sweep_result.axes]
    printed_observable_names = (
        "response",
        *observable_names(required_flags=IN_SPECIAL_POINTS_TABLE),
    )  # the amplitude at the load
    quantity_names = [
        quantity_name
        for quantity_name in sweep_result.quantities
        if sweep_result.scene.quantities
        or quantity_name.rpartition(".")[2] in printed_observable_names
    ]
    state_column_names = [] if np.all(sweep_result.converged) else ["state"]
    verdict_set = set(sweep_result["verdict"][sweep_result.converged].tolist())
    has_verdicts = not (verdict_set <= {""} or verdict_set == {"undecided"})
    verdict_column_names = ["verdict"] if has_verdicts else []
    table = sweep_result.table(
        *axis_keys, *state_column_names, *quantity_names, *verdict_column_names
    )
    if len(table.rows) <= N_PRINTED_ROWS_OF_LONG_RESULT:
        return table, ""
    axis_index = int(np.argmax(sweep_result.shape))
    for load_frequency_key in LOAD_FREQUENCY_KEYS:
        axis_index = (
            axis_keys.index(load_frequency_key) if load_frequency_key in axis_keys else axis_index
        )
    responses_of_all_cases = np.nan_to_num(sweep_result["response"], nan=-1.0)
    row_numbers_of_all_cases = np.arange(responses_of_all_cases.size).reshape(
        responses_of_all_cases.shape
    )
    peak_indices_along_axis = np.expand_dims(
        responses_of_all_cases.argmax(axis=axis_index), axis_index
    )
    row_indices = np.take_along_axis(
        row_numbers_of_all_cases, peak_indices_along_axis, axis_index
    ).ravel()
    selection_text = (
        f"; the table has the largest responses over {axis_keys[axis_index]}, "
        f"{sweep_result.path.stem}.csv has all cases"
    )
    if len(row_indices) > N_PRINTED_ROWS_OF_LONG_RESULT:
        descending_order = np.argsort(-responses_of_all_cases.ravel()[row_indices], kind="stable")[
            :N_PRINTED_ROWS_OF_LONG_RESULT
        ]
        selection_text = (
            f"{selection_text}; shown are {N_PRINTED_ROWS_OF_LONG_RESULT} of {len(row_indices)}"
        )
        row_indices = np.sort(row_indices[descending_order])
    return Table(
        table.columns, [table.rows[row_index] for row_index in row_indices]
    ), selection_text
