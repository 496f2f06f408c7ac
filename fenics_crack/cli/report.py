"""Tables for people, for shells (CSV) and for programs (JSON)."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.errors import InputError
from fenics_crack.files.store import make_folder

__all__ = ["FORMATS", "Table"]

FORMATS = ("text", "csv", "json")
SHOWN_ROWS = 40
"""More are left to the file."""


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

    def of_columns(self, places: Sequence[int]) -> Table:
        """Some of the columns."""
        columns = [self.columns[place] for place in places]
        return Table(columns, [[row[place] for place in places] for row in self.rows])

    def formatted(self, how: str) -> str:
        """The table as "text" (the first rows of a long one), "csv" or "json"."""
        return {"text": self._text, "csv": self._csv, "json": self._json}[how]()

    def save(self, path: str | Path) -> None:
        """Write it as CSV, or as JSON where the name ends so.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        text = self._json() if Path(path).suffix == ".json" else self._csv()
        try:
            make_folder(path)
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
