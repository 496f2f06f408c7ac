"""The results of commands: how they are read, who speaks of them, their headings in a report; and
what there is to say of sweeps, of growth and of convergence studies."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from mpi4py import MPI

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.cli.account import FINER, MORE, Account, in_one_unit
from fenics_crack.cli.of_vibration import (
    account_of_curve,
    account_of_history,
    account_of_modes,
    account_of_solution,
)
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.errors import InputError
from fenics_crack.files.store import IDENTIFICATION, Stored
from fenics_crack.model.modes import Modes
from fenics_crack.scene.words import key_in_words
from fenics_crack.study.run import Run, run_of
from fenics_crack.study.verification import Verification, verification_of
from fenics_crack.sweep.growth import ENDS, Growth
from fenics_crack.sweep.plan import FREQUENCIES
from fenics_crack.sweep.result import SweepResult, by_reason, in_words
from fenics_crack.table import Table, counted, frequency_axis, quantity
from fenics_crack.time.march import TimeHistory

__all__ = [
    "HEADINGS", "IDENTIFIED", "Computed", "account_of", "account_of_sweep", "few_cases",
    "result_of", "stepped_over", "warnings_of",
]  # fmt: skip

Computed = Run[Any] | SweepResult | Verification | Growth
"""What commands write."""

HEADINGS = {
    Modes.KIND: "Natural frequencies and modes",
    PeriodicSolution.KIND: "Steady vibration",
    ResponseCurve.KIND: "Response curve",
    SweepResult.KIND: "Sweep",
    TimeHistory.KIND: "Motion in time",
    Growth.KIND: "Growth of the crack",
    Verification.KIND: "Convergence study",
}
"""By kind, in the order of a report."""
IDENTIFIED = (
    "what identify has found is in identify.json, fit.csv and, of two unknowns or more, "
    "posterior.png beside it"
)
SHOWN_LENGTHS = 9
"""Rows that are printed; the file has all."""
TERMINAL_WIDTH, SHOWN_CASES = 120, 12
"""Columns and rows of a table of cases that are printed; the file has all."""
SHORT = ("response", "opening", "amplitude", "ratio_2_1")
"""Columns printed where the scene does not choose; the response is the amplitude at the load."""
SPEEDS = ("rotation.speed", "rotation.rpm")


def account_of_verification(found: Verification) -> Account:
    """A convergence study."""
    told = found.statement[: -len(found.warnings) or None]
    return Account(
        "verify",
        found.table(),
        shown=found.totals(),
        facts=told,
        notes=told,
        warnings=found.warnings,
        tables={"Contributions": found.totals()},
        done=not found.failures,
    )


def account_of_growth(found: Growth) -> Account:
    """The table, the life and how sure it is."""
    table, count = found.table(), len(found.length)
    ends = SHOWN_LENGTHS - 1
    places = sorted({round(n * (count - 1) / ends) for n in range(SHOWN_LENGTHS)})
    shown = in_one_unit(Table(table.columns, [table.rows[n] for n in places]), found.scene)
    hours = found.time[-1] / 3600.0
    first, last = (quantity(float(found.length[end]), "m") for end in (0, -1))
    way = f"from {first} to {last} in {found.life:.4g} cycles ({hours:.4g} h)"
    if found.repeats is not None:
        way += f", {found.repeats[-1]:.4g} repeats of the spectrum"
    fact = f"{way if count > 1 else first}: {ENDS[found.end]}"
    causes = [f"{name} {error:.2g}" for name, error in found.errors.items() if error > 0.0]
    known = f"the cycles are known within a factor of {found.factor:.3g}"
    known += f", standard deviations of their logarithm: {', '.join(causes)}" if causes else ""
    drop = f"the natural frequency of the breathing crack falls by {found.frequency_drop[-1]:.2%}"
    facts = [fact, known, drop] if count > 1 else [fact]
    return Account(
        "growth",
        table,
        shown=shown,
        facts=[f"{text[0].upper()}{text[1:]}." for text in facts],
        notes=facts,
        warnings=[*found.remarks],
        tables={"The crack over the cycles": shown},
    )


# --- sweeps ---------------------------------------------------------------------------------------


def account_of_sweep(found: SweepResult, note: str = "") -> Account:
    """The cases of a sweep, with a note about its scene."""
    table = found.table()
    shown, how = few_cases(found)
    counts = {"converged": int(found.converged.sum()), "failed": len(found.failed)}
    counts["pending"] = found.converged.size - sum(counts.values())
    told = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    swept = ", ".join(f"{len(a.values)} values of {key_in_words(a.key)}" for a in found.axes)
    tables = {f"Cases{how}": shown}
    stepped, high = stepped_over(found), int(np.sum(found["largest_order"] > 3))
    told_high = (
        f"in {counted(high, 'case')} a harmonic above the third is the largest of the higher "
    )
    told_high = f"{told_high}ones: ratio_largest, largest_order" if high else ""
    if found.failed:
        failed = [(str(index), reason) for index, reason in found.failed]
        tables["Failed cases"] = Table(("case", "reason"), failed)
    return Account(
        "sweep",
        table,
        shown=shown,
        facts=[
            f"Of the sweep ({swept}) {counts['converged']} of {found.converged.size} cases "
            f"converged, {counts['failed']} failed.",
            *stepped,
        ],
        notes=[note, f"cases: {told}{how}", told_high, *(f"remark: {text}" for text in stepped)],
        warnings=[*warnings_of(found)],
        tables=tables,
        done=not found.failed and found.complete,
    )


def warnings_of(found: SweepResult) -> Iterator[str]:
    """Failed cases, large errors, and what is not stable; one line for each kind."""
    yield from by_reason(found, found.failed, "failed")
    if large := int(np.sum(found.inexact)):
        wanted = FINER if found.scene.harmonic_balance.tolerance is not None else MORE
        yield f"{counted(large, 'case')} with an error above {LARGE_ERROR:.0%}: {wanted}"
    verdicts = found["verdict"][found.converged]
    unstable, undecided = (int(np.sum(verdicts == name)) for name in ("unstable", "undecided"))
    if undecided and undecided == verdicts.size:
        yield "the stability is undecided in all cases"
    elif unstable or undecided:
        numbers = [f"{n} {word}" for n, word in ((unstable, "unstable"), (undecided, "undecided"))]
        told = " and ".join(text for text in numbers if not text.startswith("0 "))
        yield f"of {counted(verdicts.size, 'case')} {told}"
    yield from by_reason(found, found.undecided, "undecided")
    if not found.complete:
        yield "the sweep was stopped; the same command goes on with it"


def stepped_over(found: SweepResult) -> list[str]:
    """A sentence if between two load frequencies there is a peak that is narrower than their
    distance: between its half-power points the phase falls by a quarter of a turn, between others
    next to it by more."""
    over = [at for at, axis in enumerate(found.axes) if axis.key in (*FREQUENCIES, *SPEEDS)]
    if not over:
        return []
    wave = found["sine_1"] + 1j * found["cosine_1"]
    omega, wave = (np.moveaxis(values, over[0], -1) for values in (found["omega"], wave))
    omega, wave = (np.take_along_axis(v, omega.argsort(axis=-1), -1) for v in (omega, wave))
    turns = np.angle(wave[..., 1:] * np.conj(wave[..., :-1])) < -0.5 * np.pi
    if not turns.any():
        return []
    *place, at = map(int, np.argwhere(turns)[0])
    factor, _, unit = frequency_axis(found.scene.in_hertz)
    low, high = factor * omega[(*place, at)], factor * omega[(*place, at + 1)]
    others = [axis for number, axis in enumerate(found.axes) if number != over[0]]
    where = "".join(f", {words}" for words in [in_words(others, place)] if words)
    more = int(turns.sum()) - 1
    also = f", and at {counted(more, 'other place')}" if more else ""
    return [
        f"between {low:.6g} and {high:.6g} {unit}{where}{also}, the sweep steps over a peak that "
        "is narrower than the step: the largest response lies there; smaller steps or the command "
        "curve find it"
    ]


def few_cases(found: SweepResult) -> tuple[Table, str]:
    """The cases of a small sweep, of a larger one those of largest response; and which in words.

    They are the largest over the load frequency, or over the longest axis, one for each combination
    of the others.
    """
    keys = [axis.key for axis in found.axes]
    chosen = SHORT if found.scene.quantities is None else found.quantities
    shown = (n for n in found.quantities if n in chosen or n.rpartition(".")[2] in chosen)
    columns = [*keys, *shown, "verdict"]
    if not np.all(found.converged):
        columns.insert(len(keys), "state")
    verdicts = set(found["verdict"][found.converged].tolist())
    if verdicts <= {""} or verdicts == {"undecided"}:
        columns.remove("verdict")
    table, words = _fitting(found, columns)
    if len(table.rows) <= SHOWN_CASES:
        return table, words
    along = int(np.argmax(found.shape))
    for key in FREQUENCIES:
        along = keys.index(key) if key in keys else along
    height = np.nan_to_num(found["response"], nan=-1.0)
    numbers = np.arange(height.size).reshape(height.shape)
    highest = np.expand_dims(height.argmax(axis=along), along)
    places = np.take_along_axis(numbers, highest, along).ravel()
    words = f"; the table has the largest responses over {keys[along]}, {found.path.stem}.csv all"
    if len(places) > SHOWN_CASES:
        order = np.argsort(-height.ravel()[places], kind="stable")[:SHOWN_CASES]
        words += f", {SHOWN_CASES} of {len(places)}"
        places = np.sort(places[order])
    return Table(table.columns, [table.rows[place] for place in places]), words


def _fitting(found: SweepResult, columns: list[str]) -> tuple[Table, str]:
    """The table of some columns, without the last quantities if it is too wide; and that in words.

    What a scene asks for by ``output.quantities`` is printed, whatever its width.
    """
    left, chosen = [*found.quantities], found.scene.quantities is not None
    while True:
        table = found.table(*columns)
        width = len(table.formatted("text").splitlines()[1])
        if width <= TERMINAL_WIDTH or chosen or len(left) < 2:
            break
        columns = [name for name in columns if name != left[-1]]
        left.pop()
    whole = len(left) == len(found.quantities)
    return table, "" if whole else f"; {found.path.stem}.csv has more columns"


# --- all of them ----------------------------------------------------------------------------------


SPEAKERS: dict[str, Callable[[Any], Account]] = {
    Modes.KIND: account_of_modes,
    PeriodicSolution.KIND: account_of_solution,
    ResponseCurve.KIND: account_of_curve,
    SweepResult.KIND: account_of_sweep,
    TimeHistory.KIND: account_of_history,
    Growth.KIND: account_of_growth,
    Verification.KIND: account_of_verification,
}


def account_of(result: Computed) -> Account:
    """What there is to say of a result (collective)."""
    return SPEAKERS[result.KIND](result)


def result_of(stored: Stored) -> Computed:
    """The result of a file that one rank has read.

    Raises
    ------
    InputError
        It is no result of a command.
    """
    if stored.kind == IDENTIFICATION:
        raise InputError("result", str(stored.path), f"another kind of result; {IDENTIFIED}")
    if stored.kind not in HEADINGS:
        allowed = f"a result of one of these kinds: {', '.join(HEADINGS)}"
        raise InputError("result", str(stored.path), allowed)
    if stored.kind == SweepResult.KIND:
        return SweepResult.load(stored.path)
    if stored.kind == Growth.KIND:
        return Growth.of(stored)
    study = verification_of(stored) if stored.kind == Verification.KIND else None
    judged = stored.kind != PeriodicSolution.KIND  # whose errors are in the file
    return study or run_of(stored, MPI.COMM_SELF, judged=judged)
