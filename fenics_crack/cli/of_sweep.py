"""What there is to say of a sweep."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.cli.account import FINER, MORE, Account
from fenics_crack.scene.words import key_in_words
from fenics_crack.sweep.plan import FREQUENCIES
from fenics_crack.sweep.result import SweepResult, by_reason, in_words
from fenics_crack.table import Table, counted, frequency_axis

__all__ = ["account_of_sweep", "few_cases", "warnings_of"]

TERMINAL_WIDTH, SHOWN_CASES = 120, 12
"""Columns and rows of a table of cases that are printed; the file has all."""
SHORT = ("response", "opening", "amplitude", "ratio_2_1")
"""Columns printed where the scene does not choose; the response is the amplitude at the load."""
SPEEDS = ("rotation.speed", "rotation.rpm")


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


# --- sentences ------------------------------------------------------------------------------------


def warnings_of(found: SweepResult) -> Iterator[str]:
    """Failed cases, large errors, and what is not stable; one line for each kind."""
    yield from by_reason(found, found.failed, "failed")
    if large := int(np.sum(found.inexact)):
        given = found.scene.harmonic_balance.tolerance is not None
        wanted = FINER if given else MORE
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


# --- what is printed ------------------------------------------------------------------------------


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
