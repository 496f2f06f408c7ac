"""Reports of sweeps and convergence studies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fenics_crack.balance.error_report import ERROR_PARTS, LARGE_ERROR, ErrorReport
from fenics_crack.basics.observables import IN_SPECIAL_POINTS_TABLE, observable_names
from fenics_crack.basics.report import Report
from fenics_crack.basics.tables import (
    N_SELECTED_ROWS,
    Table,
    format_count,
    format_in_unit,
    format_percent,
)
from fenics_crack.cli.account import ON_MODES, of_error
from fenics_crack.errors.verification import Verification
from fenics_crack.scene.scene import unit_of
from fenics_crack.study.plausibility import remarks_on_scene
from fenics_crack.sweep.plan import FREQUENCIES
from fenics_crack.sweep.result import NOT_STABLE, SweepResult, by_reason, in_words

SPEEDS = ("rotation.speed", "rotation.rpm")


def report_of_verification(found: Verification) -> Report:
    """A convergence study."""
    return Report(
        found.table(),
        found.said(),
        printed_table=found.totals(),
        notes=found.statement[: -len(found.warnings) or None],
        warnings=found.warnings,
        remarks=remarks_on_scene(found.scene),
        has_converged=not found.failures,
        misses_tolerance=bool(found.doubt(next(iter(found.values)))),
    )


def report_of_sweep(found: SweepResult) -> Report:
    """The cases of a sweep."""
    shown, how = few_cases(found)
    counts = {"converged": int(found.converged.sum()), "failed": len(found.failed)}
    counts["pending"] = found.converged.size - sum(counts.values())
    states = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    high = int(np.sum(found["largest_order"] > 3))
    higher = f"in {format_count(high, 'case')} the largest higher harmonic is above the third"
    higher = f"{higher}: ratio_largest, largest_order" if high else ""
    tables = {"Cases": shown}
    if found.failed:
        failed = [(str(index), reason) for index, reason in found.failed]
        tables["Failed cases"] = Table(("case", "reason"), failed)
    return Report(
        found.table(),
        found.said(),
        printed_table=shown,
        notes=[f"cases: {states}{how}", higher],
        warnings=[*warnings_of(found)],
        page_tables=tables,
        remarks=[*remarks_on_scene(found.scene), *stepped_over(found)],
        # mpirun calls all other ends an aborted job.
        has_converged=not found.failed and found.complete,
    )


def warnings_of(found: SweepResult) -> Iterator[str]:
    """Failed cases, large errors, and what is not stable; one line for each kind."""
    yield from by_reason(found, found.failed, "failed")
    yield from _large_errors(found)
    verdicts = found["verdict"][found.converged]
    counts = {name: int(np.sum(verdicts == name)) for name in NOT_STABLE}
    if counts["undecided"] == verdicts.size > 0:
        yield "the stability is undecided in all cases"
    elif shares := " and ".join(f"{count} {name}" for name, count in counts.items() if count):
        yield f"{shares} of {format_count(verdicts.size, 'case')}"
    yield from by_reason(found, found.undecided, "undecided")
    for said in by_reason(found, found.contradicted, f"or more whose verdict {ON_MODES}"):
        yield f"{said}; raise {found.scene.modes_key}"
    if not found.complete:
        yield "the sweep was stopped; the same command goes on with it"


def _large_errors(found: SweepResult) -> Iterator[str]:
    """Cases whose error is large, or above the tolerance, those with the same largest part
    together, and what is said of the largest of them as of a solution."""
    limit = min(LARGE_ERROR, found.scene.harmonic_balance.tolerance or LARGE_ERROR)
    errors = found.errors
    total, largest = np.where(found.converged, errors.sum(axis=0), 0.0), errors.argmax(axis=0)
    for number in np.unique(largest[total > limit]):
        cases = (total > limit) & (largest == number)
        place = tuple(map(int, np.unravel_index(np.where(cases, total, 0.0).argmax(), total.shape)))
        values = {axis.key: axis.values[at] for axis, at in zip(found.axes, place, strict=True)}
        scene = found.scene.replace({"sweep": None} | values)
        report = ErrorReport(**dict(zip(ERROR_PARTS, errors[:, *place].tolist(), strict=True)))
        count = (
            f"{format_count(int(cases.sum()), 'case')} with an error above {format_percent(limit)}"
        )
        for text in of_error(scene, report, int(found["harmonics"][place]), limit=limit):
            yield f"{count}, the largest at {in_words(found.axes, place)}: {text}"


def stepped_over(found: SweepResult) -> list[str]:
    """Return a sentence if there is a peak narrower than the distance of two load frequencies or
    speeds.

    Between its half-power points the phase falls by a quarter of a turn (rises, where speeds pass a
    load of one frequency), between others next to it by more.
    """
    over = [at for at, axis in enumerate(found.axes) if axis.key in (*FREQUENCIES, *SPEEDS)]
    if not over:
        return []
    axis, wave = found.axes[over[0]], found["sine_1"] + 1j * found["cosine_1"]
    rising = np.argsort(axis.values)
    wave = np.moveaxis(wave, over[0], -1)[..., rising]
    if axis.key in SPEEDS and found.scene.excitation.order is None:
        wave = wave.conj()  # the resonance rises past the load's frequency
    turns = np.angle(wave[..., 1:] * np.conj(wave[..., :-1])) < -0.5 * np.pi
    if not turns.any():
        return []
    *place, at = map(int, np.argwhere(turns)[0])
    ends = (axis.values[one] for one in rising[at : at + 2])
    between = format_in_unit((1.0, axis.key, unit_of(axis.key)), *ends)
    others = [axis for number, axis in enumerate(found.axes) if number != over[0]]
    where = "".join(f", {words}" for words in [in_words(others, place)] if words)
    more = int(turns.sum()) - 1
    also = f", and at {format_count(more, 'other place')}" if more else ""
    return [
        f"between {between}{where}{also}, the sweep steps over a peak that "
        "is narrower than the step: the largest response lies there; use smaller steps, or the "
        "command curve, to find it"
    ]


def few_cases(found: SweepResult) -> tuple[Table, str]:
    """The cases of a small sweep, of a larger one those of largest response; and which in words.

    They are the largest over the load frequency, or over the longest axis, one for each combination
    of the others.
    """
    keys = [axis.key for axis in found.axes]
    few = (
        "response",
        *observable_names(required_flags=IN_SPECIAL_POINTS_TABLE),
    )  # the amplitude at the load
    shown = [n for n in found.quantities if found.scene.quantities or n.rpartition(".")[2] in few]
    columns = [*keys, *shown, "verdict"]
    if not np.all(found.converged):
        columns.insert(len(keys), "state")
    verdicts = set(found["verdict"][found.converged].tolist())
    if verdicts <= {""} or verdicts == {"undecided"}:
        columns.remove("verdict")
    table = found.table(*columns)
    if len(table.rows) <= N_SELECTED_ROWS:
        return table, ""
    along = int(np.argmax(found.shape))
    for key in FREQUENCIES:
        along = keys.index(key) if key in keys else along
    height = np.nan_to_num(found["response"], nan=-1.0)
    numbers = np.arange(height.size).reshape(height.shape)
    highest = np.expand_dims(height.argmax(axis=along), along)
    places = np.take_along_axis(numbers, highest, along).ravel()
    words = f"; the table has the largest responses over {keys[along]}, {found.path.stem}.csv all"
    if len(places) > N_SELECTED_ROWS:
        order = np.argsort(-height.ravel()[places], kind="stable")[:N_SELECTED_ROWS]
        words += f", {N_SELECTED_ROWS} of {len(places)}"
        places = np.sort(places[order])
    return Table(table.columns, [table.rows[place] for place in places]), words
