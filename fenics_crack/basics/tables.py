"""Tables for people (text, HTML), shells (CSV) and programs (JSON), and results that become tables.

A result derives from :class:`Described`, or from :class:`Tabular` where it is a table, and defines
``to_dict``. Its one line, its table in a notebook and its CSV file follow from that.
"""

from __future__ import annotations

import csv
import html
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.basics.atomic_files import write_file_whole
from fenics_crack.basics.observables import OBSERVABLES_BY_NAME

MAX_PRINTED_ROWS = 40
"""Rows of a table shown as text and as HTML; files have all of them."""
N_SELECTED_ROWS = 8
"""Rows of a long result that are chosen to be printed: the largest, or spread evenly."""
RAD_PER_TURN = 2.0 * math.pi
"""Factor from Hz to rad/s."""
RAD_PER_S_PER_RPM = RAD_PER_TURN / 60.0
"""Factor from revolutions per minute to rad/s."""

_NAMES_BY_UNIT = {
    "rad/s": "omega omega_partly speed",
    "Hz": "frequency frequency_open frequency_tied frequency_partly frequency_bilinear "
    "frequency_error",
    "rpm": "rpm",
    "rad": "angle phase",
    "s": "time mark next_mark arrival",
    "m": "amplitude_error displacement response clearance crack_length tip_radius rest_amplitude",
    "m/cycle": "rate",
}
UNIT_BY_NAME = {name: one.unit for name, one in OBSERVABLES_BY_NAME.items()}
UNIT_BY_NAME |= {name: unit for unit, names in _NAMES_BY_UNIT.items() for name in names.split()}
"""Units of the entries of ``to_dict``; all others have none."""


@dataclass(frozen=True)
class Table:
    """Named columns of numbers and words.

    Attributes
    ----------
    columns : sequence of str
        Names with their units.
    rows : sequence of sequences
        Numbers, words, truth values; nan where a value is unknown.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]

    @classmethod
    def of(cls, values: Mapping[str, Any], units: Mapping[str, str]) -> Table:
        """A table of lists, one for each column, or of single values, one for each row."""
        names = [heading_with_unit(name, units.get(name, "")) for name in values]
        if any(isinstance(value, list) for value in values.values()):
            return cls(names, [list(row) for row in zip(*values.values(), strict=True)])
        return cls(("quantity", "value"), list(zip(names, values.values(), strict=True)))

    def formatted(self, how: str) -> str:
        """The table as "text" (the first rows of a long one), "csv" or "json"."""
        return {"text": self._text, "csv": self._csv, "json": self._json}[how]()

    def html(self, caption: str) -> str:
        """The table for a notebook (the first rows of a long one)."""
        rows = [("th", self.columns)]
        rows += [
            ("td", [_value_text(value) for value in row]) for row in self.rows[:MAX_PRINTED_ROWS]
        ]
        if len(self.rows) > MAX_PRINTED_ROWS:
            caption += f"; the first {MAX_PRINTED_ROWS} of {len(self.rows)} rows"
        lines = ("".join(f"<{tag}>{html.escape(c)}</{tag}>" for c in cells) for tag, cells in rows)
        body = "".join(f"<tr>{line}</tr>" for line in lines)
        return f"<table><caption>{html.escape(caption)}</caption>{body}</table>"

    def save(self, path: str | Path) -> None:
        """Write the table as JSON if the name ends in ``.json``, else as CSV.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        write_file_whole(path, self._json() if Path(path).suffix == ".json" else self._csv())

    def _text(self) -> str:
        shown = self.rows[:MAX_PRINTED_ROWS]
        columns = []
        for place, name in enumerate(self.columns):
            values = [row[place] for row in shown]
            words = [name, *map(_value_text, values)]
            width = max(map(len, words))
            words.insert(1, width * "-")
            numbers = all(isinstance(value, float | int | np.number) for value in values)
            columns.append([w.rjust(width) if numbers else w.ljust(width) for w in words])
        lines = ["  ".join(line).rstrip() for line in zip(*columns, strict=True)]
        if len(self.rows) > len(shown):
            lines.append(f"... and {len(self.rows) - len(shown)} more")
        return "\n".join(lines) + "\n"

    def _csv(self) -> str:
        file = io.StringIO()
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(map(_python_value, row) for row in self.rows)
        return file.getvalue()

    def _json(self) -> str:
        records = [dict(zip(self.columns, map(_json_value, row), strict=True)) for row in self.rows]
        return json.dumps(records, indent=1, ensure_ascii=False) + "\n"


@dataclass(frozen=True)
class Conclusion:
    """Parts of the last sentence on a result, wherever it is said.

    Attributes
    ----------
    outcome : str
        How it ended: "solved", "not converged".
    known : str
        The answer, and its accuracy.
    unknown : str
        Why the error is unknown.
    others : sequence of str
        The verdict on the stability, and what a reader of the numbers alone would miss; empty ones
        are left out.
    """

    outcome: str
    known: str = ""
    unknown: str = ""
    others: Sequence[str] = ()

    def closing(self, warnings: int = 0, remarks: int = 0) -> str:
        """The sentence, after so many warnings and remarks."""
        counts = {"warning": warnings, "remark": remarks}
        before = " and ".join(format_count(count, name) for name, count in counts.items() if count)
        doubt = f"the error is unknown: {self.unknown}" if self.unknown else ""
        return "; ".join(filter(None, (self.outcome, self.known, doubt, *self.others, before)))


class Described:
    """A result that describes itself: in one line, as a table in a notebook, as a dict."""

    def to_dict(self) -> dict[str, Any]:
        """Numbers and words by name, or lists of equal length; SI units.

        ``pandas.DataFrame`` takes such a dict of lists, and a list of dicts of numbers.
        """
        raise NotImplementedError

    def table(self, *names: str) -> Table:
        """:meth:`to_dict`, or some entries of it, as a table with units."""
        values = self.to_dict()
        return Table.of({name: values[name] for name in names or values}, self._units())

    def _units(self) -> Mapping[str, str]:
        """Units of the entries of :meth:`to_dict`."""
        return UNIT_BY_NAME

    def _title(self) -> str:
        """The text between the brackets of the one line."""
        return ", ".join(f"{name} = {_value_text(value)}" for name, value in self.to_dict().items())

    def said(self) -> Conclusion | None:
        """What the last sentence on it says; None where the one line says it all."""
        return None

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._title()})"

    def __str__(self) -> str:
        said = self.said()
        return repr(self) if said is None else f"{self!r}: {said.closing()}"

    def _repr_html_(self) -> str:
        return self.table().html(str(self))


class Tabular(Described):
    """A result that is a table: :meth:`to_dict` has lists of equal length."""

    def to_csv(self, path: str | Path) -> None:
        """Write :meth:`table` as CSV; as JSON if the name ends in ``.json``.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        self.table().save(path)

    def to_dataframe(self) -> Any:
        """The same as a ``pandas.DataFrame``.

        Raises
        ------
        ImportError
            pandas is not installed: the package does without it.
        """
        return import_optional("pandas", "to_dataframe").DataFrame(self.to_dict())


def import_optional(library: str, method: str) -> Any:
    """A library that one method needs; the ImportError without it says how to go on."""
    try:
        return import_module(library)
    except ImportError as error:
        other = "to_dict() has the same columns, and to_csv(path) writes them"
        raise ImportError(f"{method} needs {library} (pip install {library}); {other}") from error


# --- numbers for people ---------------------------------------------------------------------------

MIN_REPORTED_ERROR = 1e-5
"""Relative error below which none is reported: tables have six digits."""
UNITS_WITHOUT_PREFIX = ("", "1", "-", "%", "Hz", "rad/s", "rpm", "rad", "deg", "degrees")
"""Units shown without a prefix."""
_PREFIX_BY_EXPONENT = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


def choose_unit_prefix(largest: float, unit: str) -> tuple[float, str]:
    """Factor and prefixed unit for numbers up to a largest one: (1e6, "µm")."""
    exponent = 3 * int(np.floor(np.log10(largest) / 3.0)) if 0.0 < largest < math.inf else 0
    prefix = _PREFIX_BY_EXPONENT.get(exponent)
    return 10.0 ** (-exponent), f"10^{exponent} {unit}" if prefix is None else prefix + unit


def format_quantity(value: float, unit: str) -> str:
    """A number with its unit: "1.452 µm"; "0.9" of one without."""
    factor, unit = (
        (1.0, unit.strip("1-"))
        if unit in UNITS_WITHOUT_PREFIX
        else choose_unit_prefix(abs(value), unit)
    )
    return f"{factor * value:.4g} {unit}".rstrip()


def heading_with_unit(name: str, unit: str) -> str:
    """A heading: "omega [rad/s]"; "rotation.rpm" says its unit itself."""
    return name if unit in ("", "1", name.rpartition(".")[2]) else f"{name} [{unit}]"


def frequency_axis(in_hertz: bool) -> tuple[float, str, str]:
    """Return factor of rad/s, name and unit of an axis or a column of load frequencies."""
    return (0.5 / math.pi, "load frequency", "Hz") if in_hertz else (1.0, "load frequency", "rad/s")


def speed_axis(in_rpm: bool) -> tuple[float, str, str]:
    """The same of a rotor's speeds."""
    return (
        (1.0 / RAD_PER_S_PER_RPM, "rotor speed", "rpm") if in_rpm else (1.0, "rotor speed", "rad/s")
    )


def format_speed(speed: float, in_rpm: bool) -> str:
    """A rotor's speed [rad/s] with its unit: "3000 rpm"."""
    return format_in_unit(speed_axis(in_rpm), speed)


def format_in_unit(axis: tuple[float, str, str], *values: float) -> str:
    """Values in the unit of an axis: "50.1 Hz", "50.1 and 50.3 Hz"; "0.9" of one without."""
    factor, _, unit = axis
    numbers = " and ".join(f"{factor * value:.6g}" for value in values)
    return f"{numbers} {unit}".removesuffix(" -")


def add_frequency_entries(values: dict[str, Any]) -> dict[str, Any]:
    """Entries with the "frequency" [Hz] of their "omega" [rad/s], a number or a list, behind it,
    and with the "rpm" of their "speed" [rad/s]."""
    twins = {"omega": ("frequency", RAD_PER_TURN), "speed": ("rpm", RAD_PER_S_PER_RPM)}
    found: dict[str, Any] = {}
    for name, value in values.items():
        found[name] = value
        if name in twins:
            twin, unit = twins[name]
            found[twin] = (np.array(value) / unit).tolist()
    return found


def hertz_property(omega: str = "omega") -> Any:
    """A property: the frequency [Hz] of what an attribute of the same object has in rad/s."""

    def frequency(self: Any) -> Any:
        return getattr(self, omega) / RAD_PER_TURN

    return property(frequency, doc=f"``{omega}`` in Hz.")


def format_percent(share: float) -> str:
    """A share in per cent, with two digits, or all before the point: "2.4 %", "140 %"."""
    return format(100.0 * share, ".2g" if share < 0.995 else ".0f") + " %"


def format_error(error: float) -> str:
    """A relative error in per cent: "2.4 %", "less than 0.001 %"."""
    return (
        f"less than {format_percent(MIN_REPORTED_ERROR)}"
        if 0.0 < error < MIN_REPORTED_ERROR
        else format_percent(error)
    )


def describe_omitted_causes(causes: Iterable[str]) -> str:
    """Name the causes that an error leaves out: "error due to the mesh not included"."""
    names = " and the ".join(causes)
    return f"error due to the {names} not included" if names else ""


def format_count(count: int, thing: str) -> str:
    """A number of things: "1 pair", "2 pairs"."""
    return f"{count} {thing}{'' if count == 1 else 's'}"


def format_range(values: np.ndarray, digits: str = ".0f") -> str:
    """From the least of some numbers, by default counts, to the most: "9", "5 to 40"."""
    return " to ".join(dict.fromkeys(format(f(values), digits) for f in (np.min, np.max)))


def _python_value(value: Any) -> Any:
    """A value as one of Python's own types."""
    return value.item() if isinstance(value, np.generic) else value


def _json_value(value: Any) -> Any:
    """A value for JSON: None where a number is nan or infinite."""
    value = _python_value(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _value_text(value: Any) -> str:
    value = _python_value(value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return "-" if math.isnan(value) else f"{value:.6g}"
    return str(value)
