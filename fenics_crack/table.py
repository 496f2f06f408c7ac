"""Tables for people (text, HTML), for shells (CSV) and for programs (JSON); results as tables.

A result derives from :class:`Described`, or from :class:`Tabular` where it is a table, and writes
``to_dict``: from it follow its one line, its table in a notebook, and its CSV file.
"""

from __future__ import annotations

import csv
import html
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.errors import InputError

__all__ = ["Described", "Table", "Tabular", "counted", "quantity", "readable", "with_unit"]

SHOWN_ROWS = 40
"""More are left to the file."""
NOTEBOOK_ROWS = 20
"""Likewise, in a notebook."""
UNITS = {
    "omega": "rad/s", "frequency": "Hz", "energy": "J", "opening": "m", "penetration": "m",
    "clearance": "m",
}  # fmt: skip
"""Of what results name so; all else has none."""


@dataclass(frozen=True)
class Table:
    """Rows under names of columns.

    Attributes
    ----------
    columns : sequence of str
        Names with their units.
    rows : sequence of sequences
        Numbers, words, truth values; nan for what is not known.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]

    @classmethod
    def of(cls, values: Mapping[str, Any], units: Mapping[str, str]) -> Table:
        """Columns given as lists of equal length; single values as rows under each other."""
        names = [with_unit(name, units.get(name, "")) for name in values]
        if any(isinstance(value, list) for value in values.values()):
            return cls(names, [list(row) for row in zip(*values.values(), strict=True)])
        return cls(("quantity", "value"), list(zip(names, values.values(), strict=True)))

    def of_columns(self, places: Sequence[int]) -> Table:
        """Some of the columns."""
        columns = [self.columns[place] for place in places]
        return Table(columns, [[row[place] for place in places] for row in self.rows])

    def formatted(self, how: str) -> str:
        """The table as "text" (the first rows of a long one), "csv" or "json"."""
        return {"text": self._text, "csv": self._csv, "json": self._json}[how]()

    def html(self, caption: str) -> str:
        """The table for a notebook (the first rows of a long one)."""
        rows = [_html_row("th", self.columns)]
        rows += [_html_row("td", map(_words, row)) for row in self.rows[:NOTEBOOK_ROWS]]
        if len(self.rows) > NOTEBOOK_ROWS:
            caption += f"; the first {NOTEBOOK_ROWS} of {len(self.rows)} rows"
        return f"<table><caption>{html.escape(caption)}</caption>{''.join(rows)}</table>"

    def save(self, path: str | Path) -> None:
        """Write it as CSV, or as JSON where the name ends so.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        text = self._json() if Path(path).suffix == ".json" else self._csv()
        try:
            Path(path).parent.mkdir(parents=True, exist_ok=True)
            Path(path).write_text(text, encoding="utf-8")
        except OSError as error:
            raise InputError("path", str(path), f"a file that can be written ({error})") from None

    def _text(self) -> str:
        shown = self.rows[:SHOWN_ROWS]
        cells = [list(map(str, self.columns)), *([_words(v) for v in row] for row in shown)]
        widths = [max(len(row[i]) for row in cells) for i in range(len(self.columns))]
        right = [
            all(isinstance(row[i], float | int | np.number) for row in shown)
            for i in range(len(widths))
        ]
        lines = [
            "  ".join(
                cell.rjust(width) if numbers else cell.ljust(width)
                for cell, width, numbers in zip(row, widths, right, strict=True)
            ).rstrip()
            for row in cells
        ]
        lines.insert(1, "  ".join("-" * width for width in widths))
        if len(self.rows) > len(shown):
            lines.append(f"... and {len(self.rows) - len(shown)} more")
        return "\n".join(lines) + "\n"

    def _csv(self) -> str:
        file = io.StringIO()
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows([_plain(value) for value in row] for row in self.rows)
        return file.getvalue()

    def _json(self) -> str:
        records = [
            {name: _known(_plain(value)) for name, value in zip(self.columns, row, strict=True)}
            for row in self.rows
        ]
        return json.dumps(records, indent=1, ensure_ascii=False) + "\n"


class Described:
    """A result that says what it is: in one line, as a small table in a notebook, as a dict."""

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and words by their names, or lists of equal length; SI units.

        ``pandas.DataFrame`` takes a dict of lists, and a list of dicts of numbers, as they are.
        """
        raise NotImplementedError

    def table(self) -> Table:
        """The same as a table, whose names have their units."""
        return Table.of(self.to_dict(), self._units())

    def _units(self) -> Mapping[str, str]:
        """Units by the names of the dict."""
        return UNITS

    def _title(self) -> str:
        """What stands between the brackets of the one line."""
        return ", ".join(f"{name} = {_words(value)}" for name, value in self.to_dict().items())

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._title()})"

    def _repr_html_(self) -> str:
        return self.table().html(repr(self))


class Tabular(Described):
    """A result that is a table: its dict has lists of equal length."""

    def to_csv(self, path: str | Path) -> None:
        """Write :meth:`table` as CSV.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        self.table().save(path)


# --- numbers for people ---------------------------------------------------------------------------

_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


def readable(largest: float, unit: str) -> tuple[float, str]:
    """Factor and unit with which numbers up to a largest one read well: (1e6, "µm")."""
    exponent = 3 * int(np.floor(np.log10(largest) / 3.0)) if 0.0 < largest < math.inf else 0
    prefix = _PREFIXES.get(exponent)
    return 10.0 ** (-exponent), f"10^{exponent} {unit}" if prefix is None else prefix + unit


def quantity(value: float, unit: str) -> str:
    """A number with its unit: "1.452 µm"."""
    factor, unit = readable(abs(value), unit)
    return f"{factor * value:.4g} {unit}"


def with_unit(name: str, unit: str) -> str:
    """A heading: "omega [rad/s]"."""
    return f"{name} [{unit}]" if unit not in ("", "1") else name


def counted(count: int, thing: str) -> str:
    """A number of things: "1 pair", "2 pairs"."""
    return f"{count} {thing}{'' if count == 1 else 's'}"


def _html_row(tag: str, cells: Iterable[str]) -> str:
    inner = "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells)
    return f"<tr>{inner}</tr>"


def _plain(value: Any) -> Any:
    """A value of Python's own kinds."""
    return value.item() if isinstance(value, np.generic) else value


def _known(value: Any) -> Any:
    """None for what JSON has no number for."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _words(value: Any) -> str:
    value = _plain(value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return "-" if math.isnan(value) else f"{value:.6g}"
    return str(value)
