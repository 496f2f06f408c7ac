"""What there is to say of a sweep, and its pictures: lines over one axis, maps over two."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.cli.account import FINER, MORE, Account
from fenics_crack.errors import InputError
from fenics_crack.scene.fields import Axis
from fenics_crack.scene.words import WHOLE, key_in_words, unit_of, value_in_words
from fenics_crack.sweep.result import SweepResult
from fenics_crack.table import Table, counted, readable, with_unit

__all__ = ["account_of_sweep", "few_cases", "shown_axes", "warnings_of"]

WIDEST, SHOWN_CASES = 120, 12
"""Columns and rows of a table of cases that are printed; the file has all."""
SHORT = ("response", "opening", "amplitude", "ratio_2_1")
"""Columns printed where the scene does not choose; the response is the amplitude at the load."""
SHOWN_FAILURES = 4
"""Kinds of failures that are told."""
FREQUENCIES = ("excitation.omega", "excitation.frequency")
FEW_LINES, LEAST_OF_A_MAP, MAX_PICTURES = 6, 4, 12
"""Lines in a picture, at most; values of each axis from which there is a map; pictures of a
quantity, at most."""


def account_of_sweep(found: SweepResult, note: str = "") -> Account:
    """The cases of a sweep, with a note about its scene."""
    table = found.table()
    shown, how = few_cases(found)
    counts = {"converged": int(found.converged.sum()), "failed": len(found.failed)}
    counts["pending"] = found.converged.size - sum(counts.values())
    told = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    swept = ", ".join(f"{len(a.values)} values of {key_in_words(a.key)}" for a in found.axes)
    tables = {f"Cases{how}": shown}
    if found.failed:
        failed = [(str(index), reason) for index, reason in found.failed]
        tables["Failed cases"] = Table(("case", "reason"), failed)
    return Account(
        "sweep",
        table,
        shown=shown,
        facts=[
            f"Of the sweep ({swept}) {counts['converged']} of {found.converged.size} cases "
            f"converged, {counts['failed']} failed."
        ],
        notes=[note, f"cases: {told}{how}"],
        warnings=[*warnings_of(found)],
        tables=tables,
        draw=lambda folder: _draw(found, folder),
        done=not found.failed and found.complete,
    )


# --- sentences ------------------------------------------------------------------------------------


def warnings_of(found: SweepResult) -> Iterator[str]:
    """Failed cases, large errors, and what is not stable; one line for each kind."""
    yield from _failures(found)
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
    if not found.complete:
        yield "the sweep was stopped; the same command goes on with it"


def _failures(found: SweepResult) -> Iterator[str]:
    """Failed cases, those of one reason together: reasons that differ in numbers alone are one."""
    kinds: dict[str, list[tuple[tuple[int, ...], str]]] = {}
    for index, reason in found.failed:
        kinds.setdefault(re.sub(r"[-+]?\d[\d.e+-]*", "#", reason), []).append((index, reason))
    ordered = sorted(kinds.values(), key=len, reverse=True)
    for cases in ordered[:SHOWN_FAILURES]:
        index, reason = cases[0]
        number = f"{counted(len(cases), 'case')} failed, the first at"
        yield f"{number} {_place(found, index)}: {reason}"
    if more := ordered[SHOWN_FAILURES:]:
        left = sum(map(len, more))
        yield f"{counted(left, 'case')} failed for other reasons: column status of the table"


def _place(found: SweepResult, index: Sequence[int]) -> str:
    """The swept values of a case."""
    return ", ".join(
        f"{axis.key.rpartition('.')[2]} = {axis.values[at]}"
        for axis, at in zip(found.axes, index, strict=True)
    )


# --- what is printed ------------------------------------------------------------------------------


def few_cases(found: SweepResult) -> tuple[Table, str]:
    """The cases of a small sweep, of a larger one those of largest response; and which in words.

    They are the largest over the load frequency, or over the longest axis, one for each combination
    of the others.
    """
    keys = [axis.key for axis in found.axes]
    output = found.scene.output
    chosen = SHORT if output is None or output.quantities is None else found.quantities
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
    output, left = found.scene.output, [*found.quantities]
    chosen = output is not None and output.quantities is not None
    while True:
        table = found.table(*columns)
        if len(table.formatted("text").splitlines()[1]) <= WIDEST or chosen or len(left) < 2:
            break
        columns = [name for name in columns if name != left[-1]]
        left.pop()
    whole = len(left) == len(found.quantities)
    return table, "" if whole else f"; {found.path.stem}.csv has more columns"


# --- pictures -------------------------------------------------------------------------------------


def shown_axes(found: SweepResult) -> list[int]:
    """Places of the one or two axes that are drawn: the frequency, then the longest.

    Raises InputError if no axis has two or more numbers, or no case has converged.
    """
    axes = found.axes
    numbers = [
        place
        for place, axis in enumerate(axes)
        if len(axis.values) > 1 and all(isinstance(value, float | int) for value in axis.values)
    ]
    if not numbers:
        raise InputError("sweep.over", [a.key for a in axes], "over numbers, to be drawn")
    if not np.any(found.converged):
        raise InputError("path", str(found.path), "a sweep with a case that converged")
    numbers.sort(key=lambda place: (axes[place].key not in FREQUENCIES, -len(axes[place].values)))
    return numbers[:2]


def _draw(found: SweepResult, folder: Path) -> list[Path]:
    """Draw the quantities of a sweep over the swept numbers; return the files.

    To the right goes the frequency, else the longest axis. The next in length gets a line for each
    value if these are few, and makes a map if they are not too few. Each combination of the other
    axes has its own pictures, up to a limit. Raises InputError as :func:`shown_axes`.
    """
    axes, shown = found.axes, shown_axes(found)
    others = [place for place in range(len(axes)) if place not in shown]

    def pages(values: np.ndarray) -> np.ndarray:
        """Values by picture, then to the right, then up if there are two axes: (n, x, y)."""
        sizes = [*(len(axes[place].values) for place in shown), 1][:2]
        return values.transpose(*others, *shown).reshape(-1, *sizes)

    doubtful = pages(found.converged & (found.not_stable | found.inexact))
    files: list[Path] = []
    fixed = itertools.product(*(axes[place].values for place in others))
    for number, at in enumerate(itertools.islice(fixed, MAX_PICTURES)):
        keys = [axes[place].key for place in others]
        words = [f"{key_in_words(k)} {value_in_words(k, v)}" for k, v in zip(keys, at, strict=True)]
        for name, (quantity, unit) in found.quantities.items():
            values = pages(np.where(found.converged, found[name], np.nan))[number]
            if np.any(np.isfinite(values)):
                page = _Page([axes[place] for place in shown], values, doubtful[number])
                base = folder / f"sweep_{name}{f'_{number + 1}' if others else ''}.png"
                files += page.draw(quantity, unit, base, ", ".join(words))
    return files


class _Page:
    """Values (x, y) over one axis or two, and where they are doubtful."""

    def __init__(self, axes: list[Axis], values: np.ndarray, doubtful: np.ndarray) -> None:
        self.axes = axes
        places = [np.array(axis.values, dtype=float) for axis in axes]
        order = [np.argsort(place) for place in places]
        self.places = [place[by] for place, by in zip(places, order, strict=True)]
        across = np.ix_(*[*order, np.zeros(1, dtype=int)][:2])
        self.values, self.doubtful = values[across], doubtful[across]

    def draw(self, quantity: str, unit: str, path: Path, where: str) -> list[Path]:
        """Draw lines, a map, or both; return the files."""
        names = [key_in_words(axis.key) for axis in self.axes]
        title = f"{quantity[0].upper()}{quantity[1:]}{', ' if where else ''}{where}"
        counts = [*map(len, self.places), 1][:2]
        is_map = len(self.axes) > 1 and min(counts) >= LEAST_OF_A_MAP
        files = []
        if counts[1] <= FEW_LINES:
            files.append(path)
            self._lines(quantity, unit, names, path=path, title=title)
        if is_map or counts[1] > FEW_LINES:
            beside = path.with_name(f"{path.stem}_map.png")
            files.append(beside)
            self._map(quantity, unit, path=beside, title=title)
        return files

    def _lines(self, quantity: str, unit: str, names: list[str], **file: Any) -> None:
        factor, over = _axis_words(self.axes[0], self.places[0])
        labels = [quantity]
        if len(self.axes) > 1:
            key = self.axes[1].key
            labels = [f"{names[1]} {value_in_words(key, float(at))}" for at in self.places[1]]
        lines, rings = (
            dict(zip(labels, values.T, strict=True)) for values in (self.values, self.doubtful)
        )
        how: dict[str, Any] = {"over": over, "doubtful": rings, "unit": unit}
        from fenics_crack.draw.plot import draw_response

        draw_response(factor * self.places[0], lines, quantity=quantity, **how, **file)

    def _map(self, quantity: str, unit: str, **file: Any) -> None:
        ends = (_axis_words(a, place) for a, place in zip(self.axes, self.places, strict=True))
        (right, x_label), (up, y_label) = ends
        scale, prefixed = 1.0, unit
        if unit in ("m", "N"):
            scale, prefixed = readable(float(np.nanmax(np.abs(self.values))), unit)
        from fenics_crack.draw.plot import draw_map

        draw_map(
            right * self.places[0],
            up * self.places[1],
            scale * self.values.T,
            x_label=x_label,
            y_label=y_label,
            value_label=with_unit(quantity, prefixed),
            doubtful=self.doubtful.T,
            **file,
        )


def _axis_words(axis: Axis, values: np.ndarray) -> tuple[float, str]:
    """What multiplies the values of an axis in a picture, and its label."""
    unit, factor = unit_of(axis.key), 1.0
    if unit and unit not in WHOLE:
        factor, unit = readable(float(np.abs(values).max()), unit)
    return factor, with_unit(key_in_words(axis.key), unit)
