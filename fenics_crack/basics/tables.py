"""Make tables for people (text, HTML), shells (CSV) and programs (JSON).

A result derives from :class:`Described`, or from :class:`Tabular` for a table, and defines
``to_dict``. Its one line, its table in a notebook and its CSV file follow from this dict.
"""

from __future__ import annotations

import csv
import html
import io
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.basics.atomic_files import write_file_whole
from fenics_crack.basics.errors import Exit
from fenics_crack.basics.observables import OBSERVABLES_BY_NAME
from fenics_crack.basics.suggestions import keep_old_attribute_names

MAX_PRINTED_ROWS = 40
"""Maximum rows of a table as text and as HTML; files have all rows."""
N_PRINTED_ROWS_OF_LONG_RESULT = 8
"""Number of rows printed of a long result: the rows with largest values, or evenly spread rows."""
RAD_PER_TURN = 2.0 * math.pi
"""Factor from Hz to rad/s."""
RAD_PER_S_PER_RPM = RAD_PER_TURN / 60.0
"""Factor from revolutions per minute to rad/s."""
NUMBER_PATTERN = re.compile(r"[+-]?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
"""Pattern of a number in the text of a table."""

_NAMES_OF_DICT_ENTRIES_BY_UNIT = {
    "rad/s": "omega omega_partly speed",
    "Hz": "frequency frequency_open frequency_tied frequency_partly frequency_bilinear "
    "frequency_error",
    "rpm": "rpm",
    "rad": "angle phase",
    "s": "time mark next_mark arrival",
    "m": "amplitude_error displacement response clearance crack_length tip_radius rest_amplitude",
    "m/cycle": "rate",
}
UNIT_BY_DICT_ENTRY_NAME = {
    **{name: observable.unit for name, observable in OBSERVABLES_BY_NAME.items()},
    **{
        name: unit
        for unit, names in _NAMES_OF_DICT_ENTRIES_BY_UNIT.items()
        for name in names.split()
    },
}
"""Units for the entries of ``to_dict`` by name; all further entries have none."""


def have_equal_numbers(text: str, other_text: str) -> bool:
    """Return True for texts of tables that differ by rounding alone.

    Words must be equal, and numbers to a relative 1e-9 or to 1e-13 in SI units.
    """
    numbers_of_texts = (
        np.array(NUMBER_PATTERN.findall(one_text), dtype=float) for one_text in (text, other_text)
    )
    return NUMBER_PATTERN.split(text) == NUMBER_PATTERN.split(other_text) and np.allclose(
        *numbers_of_texts, rtol=1e-9, atol=1e-13
    )


@keep_old_attribute_names(formatted="format_as")
@dataclass(frozen=True)
class Table:
    """Hold a table with named columns of numbers and words.

    Attributes
    ----------
    columns : sequence of str
        Headings with units: "omega [rad/s]".
    rows : sequence of sequences
        Numbers, words and truth values in each row; nan for an unknown value.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]

    @classmethod
    def from_dict(cls, values_by_name: Mapping[str, Any], unit_by_name: Mapping[str, str]) -> Table:
        """Return a table from values by name, with units in the headings.

        Parameters
        ----------
        values_by_name : dict
            Lists by name, which become columns; or single values by name, which become rows with
            the columns "quantity" and "value". If any value is a list, all must be lists.
        unit_by_name : dict of str to str
            Units; a name without an entry has no unit.
        """
        headings = [heading_with_unit(name, unit_by_name.get(name, "")) for name in values_by_name]
        if any(isinstance(column_or_value, list) for column_or_value in values_by_name.values()):
            return cls(
                headings,
                [list(row_values) for row_values in zip(*values_by_name.values(), strict=True)],
            )
        return cls(("quantity", "value"), list(zip(headings, values_by_name.values(), strict=True)))

    def format_as(self, format_name: str) -> str:
        """Return the table as text in the format "text", "csv" or "json".

        "text" has at most 40 rows.
        """
        return {"text": self._as_text, "csv": self._as_csv, "json": self._as_json}[format_name]()

    def html(self, caption: str) -> str:
        """Return the table as HTML with a caption, for a notebook; at most 40 rows."""
        cell_tags_and_rows = [("th", self.columns)]
        cell_tags_and_rows += [
            ("td", [_value_text(value) for value in row]) for row in self.rows[:MAX_PRINTED_ROWS]
        ]
        if len(self.rows) > MAX_PRINTED_ROWS:
            caption += f"; the first {MAX_PRINTED_ROWS} of {len(self.rows)} rows"
        row_html_texts = (
            "".join(f"<{cell_tag}>{html.escape(cell)}</{cell_tag}>" for cell in cells)
            for cell_tag, cells in cell_tags_and_rows
        )
        rows_html = "".join(f"<tr>{row_html}</tr>" for row_html in row_html_texts)
        return f"<table><caption>{html.escape(caption)}</caption>{rows_html}</table>"

    def save(self, path: str | Path) -> None:
        """Write the table as CSV, or as JSON if the name ends in ``.json``.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        write_file_whole(path, self._as_json() if Path(path).suffix == ".json" else self._as_csv())

    def _as_text(self) -> str:
        """Return the table in aligned columns; at most 40 rows."""
        printed_rows = self.rows[:MAX_PRINTED_ROWS]
        text_columns = []
        for column_index, column_heading in enumerate(self.columns):
            column_values = [row[column_index] for row in printed_rows]
            column_texts = [column_heading, *map(_value_text, column_values)]
            column_width = max(map(len, column_texts))
            column_texts.insert(1, column_width * "-")
            is_numeric = all(isinstance(value, float | int | np.number) for value in column_values)
            text_columns.append(
                [
                    text.rjust(column_width) if is_numeric else text.ljust(column_width)
                    for text in column_texts
                ]
            )
        lines = [
            "  ".join(line_cell_texts).rstrip()
            for line_cell_texts in zip(*text_columns, strict=True)
        ]
        if len(self.rows) > len(printed_rows):
            lines.append(f"... and {len(self.rows) - len(printed_rows)} more")
        return "\n".join(lines) + "\n"

    def _as_csv(self) -> str:
        csv_buffer = io.StringIO()
        csv_writer = csv.writer(csv_buffer, lineterminator="\n")
        csv_writer.writerow(self.columns)
        csv_writer.writerows(map(_python_value, row) for row in self.rows)
        return csv_buffer.getvalue()

    def _as_json(self) -> str:
        row_dicts = [
            dict(zip(self.columns, map(_json_value, row), strict=True)) for row in self.rows
        ]
        return json.dumps(row_dicts, indent=1, ensure_ascii=False) + "\n"


@dataclass(frozen=True)
class Conclusion:
    """Hold the parts of the closing sentence that a command prints on a result.

    Attributes
    ----------
    computation_outcome : str
        How the computation ended: "solved", "not converged".
    answer : str
        Main number of the result, and the accuracy.
    unknown_error_reason : str
        Reason why the error is unknown; "" if the error is known.
    further_clauses : sequence of str
        Verdict on the stability, and facts that the numbers do not show. Empty texts are left out.
    """

    computation_outcome: str
    answer: str = ""
    unknown_error_reason: str = ""
    further_clauses: Sequence[str] = ()

    def sentence(self, n_warnings: int = 0, n_remarks: int = 0) -> str:
        """Return the closing sentence, with the numbers of warnings and remarks at the end."""
        message_count_by_noun = {"warning": n_warnings, "remark": n_remarks}
        warning_count_text = " and ".join(
            format_count(n_messages, message_noun)
            for message_noun, n_messages in message_count_by_noun.items()
            if n_messages
        )
        unknown_error_clause = (
            f"the error is unknown: {self.unknown_error_reason}"
            if self.unknown_error_reason
            else ""
        )
        return "; ".join(
            filter(
                None,
                (
                    self.computation_outcome,
                    self.answer,
                    unknown_error_clause,
                    *self.further_clauses,
                    warning_count_text,
                ),
            )
        )


@dataclass(frozen=True)
class Report:
    """Hold the sentences and tables that a command prints and writes.

    Attributes
    ----------
    table : Table
        Summary of the result, written to the .json file.
    conclusion : Conclusion
        Parts of the closing sentence, with the answer.
    scene : Scene, optional
        Scene that selects the printed unit if a table has both, such as Hz and rad/s.
    csv_table : Table, optional
        Table for the .csv file; default: ``table``.
    printed_table : Table, optional
        Table printed as text; default: ``table``.
    notes, warnings : sequences of str
        Further information, and doubts about the result.
    html_page_tables : dict of str to Table
        Tables of the HTML page by caption; default: the printed table.
    further_tables : dict of str to Table
        Tables below the first table, printed and on the page, by caption.
    remarks : sequence of Remark
        Notes on unusual values in the scene.
    has_converged : bool
        False if any part of the result has not converged.
    misses_tolerance : bool
        True if the error is unknown or above the tolerance.
    """

    table: Table
    conclusion: Conclusion
    scene: Any = None
    csv_table: Table | None = None
    printed_table: Table | None = None
    notes: Sequence[str] = ()
    warnings: Sequence[str] = ()
    html_page_tables: Mapping[str, Table] = field(default_factory=dict)
    further_tables: Mapping[str, Table] = field(default_factory=dict)
    remarks: Sequence[object] = ()
    has_converged: bool = True
    misses_tolerance: bool = False

    @property
    def closing_sentence(self) -> str:
        """Last sentence that the command prints: answer, and numbers of warnings and remarks."""
        return self.conclusion.sentence(len(self.warnings), len(self.remarks))

    @property
    def exit_code(self) -> Exit:
        """Exit code of the command: DONE, TOLERANCE_MISSED or NOT_CONVERGED."""
        if not self.has_converged:
            return Exit.NOT_CONVERGED
        return Exit.TOLERANCE_MISSED if self.misses_tolerance else Exit.DONE


@keep_old_attribute_names(said="build_conclusion")
class Described:
    """Base class for a result that can show itself: as a line, a table or a dict."""

    def to_dict(self) -> dict[str, Any]:
        """Return the result's numbers and words by name, or lists of equal length by name.

        Units are SI. ``pandas.DataFrame`` accepts a dict of lists, and a list of several such dicts
        of numbers.
        """
        raise NotImplementedError

    def table(self, *names: str) -> Table:
        """Return the entries of :meth:`to_dict` with these names as a table with units.

        Without ``names``, the table has all entries.
        """
        values_by_name = self.to_dict()
        return Table.from_dict(
            {name: values_by_name[name] for name in names or values_by_name}, self._unit_by_name()
        )

    def _unit_by_name(self) -> Mapping[str, str]:
        """Return the units for entries of :meth:`to_dict` by name."""
        return UNIT_BY_DICT_ENTRY_NAME

    def _repr_text(self) -> str:
        """Return the text between the brackets of ``repr``."""
        return ", ".join(f"{name} = {_value_text(value)}" for name, value in self.to_dict().items())

    def build_conclusion(self) -> Conclusion | None:
        """Return the parts of the closing sentence; None if the text of ``repr`` is enough."""
        return None

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._repr_text()})"

    def __str__(self) -> str:
        conclusion = self.build_conclusion()
        return repr(self) if conclusion is None else f"{self!r}: {conclusion.sentence()}"

    def _repr_html_(self) -> str:
        return self.table().html(str(self))


class Tabular(Described):
    """Base class for a result that can be saved as a table with several rows.

    The dict from :meth:`to_dict` has a list for each column, all of equal length. This class adds
    the table as a CSV file and as a ``pandas.DataFrame``.
    """

    def to_csv(self, path: str | Path) -> None:
        """Write :meth:`table` as CSV, or as JSON if the name ends in ``.json``.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        self.table().save(path)

    def to_dataframe(self) -> Any:
        """Return :meth:`to_dict` as a ``pandas.DataFrame``, without units in the headings.

        Raises
        ------
        ImportError
            pandas is not installed: the package does without it.
        """
        return import_optional("pandas", "to_dataframe").DataFrame(self.to_dict())


def import_optional(library: str, method: str) -> Any:
    """Import and return an optional library that a method needs.

    Without the library, the ImportError names the method and an alternative.
    """
    try:
        return import_module(library)
    except ImportError as error:
        alternative_text = (
            "without it, to_dict() returns the same columns, and to_csv(path) writes them"
        )
        raise ImportError(
            f"{method} needs {library} (pip install {library}); {alternative_text}"
        ) from error


# --- numbers for people ---------------------------------------------------------------------------

MIN_REPORTED_RELATIVE_ERROR = 1e-5
"""Relative error below which the text is "less than 0.001 %": tables have six digits."""
UNITS_WITHOUT_PREFIX = ("", "1", "-", "%", "Hz", "rad/s", "rpm", "rad", "deg", "degrees", "1/K")
"""Units that are shown without a prefix such as k or m."""
_PREFIX_BY_EXPONENT = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


def choose_factor_and_prefixed_unit(largest_magnitude: float, unit: str) -> tuple[float, str]:
    """Choose a prefixed unit for numbers: (1e6, "µm") for micrometres.

    ``largest_magnitude`` is the largest absolute number in ``unit``. The result is the factor from
    ``unit`` to the prefixed unit, and the prefixed unit.
    """
    exponent = (
        3 * int(np.floor(np.log10(largest_magnitude) / 3.0))
        if 0.0 < largest_magnitude < math.inf
        else 0
    )
    prefix = _PREFIX_BY_EXPONENT.get(exponent)
    return 10.0 ** (-exponent), f"10^{exponent} {unit}" if prefix is None else prefix + unit


def format_quantity(value: float, unit: str) -> str:
    """Return a number with a prefixed unit as text: "1.452 µm"."""
    factor, unit = (
        (1.0, unit.strip("1-"))
        if unit in UNITS_WITHOUT_PREFIX
        else choose_factor_and_prefixed_unit(abs(value), unit)
    )
    return f"{factor * value:.4g} {unit}".rstrip()


def heading_with_unit(quantity_name: str, unit: str) -> str:
    """Return a column's heading: "omega [rad/s]".

    Without a unit, or if the name ends in the unit ("rotation.rpm"), the heading is the name.
    """
    return (
        quantity_name
        if unit in ("", "1", quantity_name.rpartition(".")[2])
        else f"{quantity_name} [{unit}]"
    )


def choose_frequency_factor_name_unit(in_hertz: bool) -> tuple[float, str, str]:
    """Return factor, name and unit to print a load frequency in Hz or rad/s.

    The factor converts from rad/s to the unit. The unit is Hz if ``in_hertz`` is True.
    """
    return (0.5 / math.pi, "load frequency", "Hz") if in_hertz else (1.0, "load frequency", "rad/s")


def choose_speed_factor_name_unit(in_rpm: bool) -> tuple[float, str, str]:
    """Return factor, name and unit to print a rotor speed in rpm or rad/s.

    The factor converts from rad/s to the unit. The unit is rpm if ``in_rpm`` is True.
    """
    return (
        (1.0 / RAD_PER_S_PER_RPM, "rotor speed", "rpm") if in_rpm else (1.0, "rotor speed", "rad/s")
    )


def format_speed(speed: float, in_rpm: bool) -> str:
    """Return a rotor's speed [rad/s] as text with its unit: "3000 rpm"."""
    return format_in_unit(choose_speed_factor_name_unit(in_rpm), speed)


def format_in_unit(factor_name_unit: tuple[float, str, str], *values: float) -> str:
    """Return numbers in an axis' unit as text: "50.1 Hz", "50.1 and 50.3 Hz".

    Parameters
    ----------
    factor_name_unit : (float, str, str)
        Factor from ``values`` to the printed unit, name (not printed), and the unit.
    values : float
        Numbers, such as frequencies in rad/s.
    """
    factor, _, unit = factor_name_unit
    numbers_text = " and ".join(f"{factor * value:.6g}" for value in values)
    return f"{numbers_text} {unit}".removesuffix(" -")


def add_frequency_entries(values_by_name: dict[str, Any]) -> dict[str, Any]:
    """Return a copy of a dict, with frequencies in Hz and speeds in rpm added.

    ``values_by_name`` has numbers or lists by name. After "omega" [rad/s] the entry "frequency"
    [Hz] is added, and after "speed" [rad/s] the entry "rpm" [1/min].
    """
    added_name_and_factor_by_name = {
        "omega": ("frequency", RAD_PER_TURN),
        "speed": ("rpm", RAD_PER_S_PER_RPM),
    }
    extended_value_by_name: dict[str, Any] = {}
    for name, value in values_by_name.items():
        extended_value_by_name[name] = value
        if name in added_name_and_factor_by_name:
            added_name, rad_per_s_per_added_unit = added_name_and_factor_by_name[name]
            extended_value_by_name[added_name] = (
                np.array(value) / rad_per_s_per_added_unit
            ).tolist()
    return extended_value_by_name


def hertz_property(attribute_name: str = "omega") -> Any:
    """Return a property for a class: an attribute in rad/s, converted to Hz.

    ``attribute_name`` is the attribute with the angular frequency [rad/s].
    """

    def frequency(self: Any) -> Any:
        return getattr(self, attribute_name) / RAD_PER_TURN

    return property(frequency, doc=f"``{attribute_name}`` in Hz.")


def format_percent(share: float) -> str:
    """Return a ratio in per cent with two significant digits: "2.4 %".

    From 99.5 % on the number is whole: "140 %".
    """
    return format(100.0 * share, ".2g" if share < 0.995 else ".0f") + " %"


def format_error(error: float) -> str:
    """Return a relative error in per cent: "2.4 %", "less than 0.001 %"."""
    return (
        f"less than {format_percent(MIN_REPORTED_RELATIVE_ERROR)}"
        if 0.0 < error < MIN_REPORTED_RELATIVE_ERROR
        else format_percent(error)
    )


def describe_omitted_causes(cause_names: Iterable[str]) -> str:
    """Return a text on causes that an error estimate does not include.

    An example is "error due to the mesh not included", for the cause "mesh". The text is "" without
    causes.
    """
    cause_text = " and the ".join(cause_names)
    return f"error due to the {cause_text} not included" if cause_text else ""


def format_count(count: int, noun: str) -> str:
    """Return a number with a noun as text: "1 pair", "2 pairs"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def format_range(values: np.ndarray, number_format: str = ".0f") -> str:
    """Return minimum and maximum of values (n,) as text: "5 to 40".

    A single number if both are equal as text.
    """
    return " to ".join(
        dict.fromkeys(
            format(extreme_function(values), number_format) for extreme_function in (np.min, np.max)
        )
    )


def _python_value(value: Any) -> Any:
    """Return a NumPy number as a Python number, and another value unchanged."""
    return value.item() if isinstance(value, np.generic) else value


def _json_value(value: Any) -> Any:
    """Return a value for JSON; nan and infinity become None."""
    value = _python_value(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _value_text(value: Any) -> str:
    """Return a table's value as text: a number with six digits; "yes" or "no"; "-" for nan."""
    value = _python_value(value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return "-" if math.isnan(value) else f"{value:.6g}"
    return str(value)
