"""The verification book: cases, their rows, and the pages made of them.

A case is a function that returns rows. Its docstring is the page's text, the first line its title;
the first line of its file is the topic in the index. The test runs it, and writes or checks its
page from the same rows (test_book.py).
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

PAGES = Path(__file__).parents[2] / "docs" / "verification"
HEAD = "| quantity | fenics_crack | reference | difference | allowed |\n|---|---|---|---|---|\n"
NUMBER = re.compile(r"(?<!\de)(\d+(?:\.\d+)?(?: to \d+(?:\.\d+)?)?)(?![\w.])")
"""A number or a range in a quantity, unless a name or an exponent has it."""
CASES: dict[str, Case] = {}
"""All cases by name, in the order of their files."""


@dataclass(frozen=True)
class Row:
    """Compare one figure with its reference.

    Without a tolerance the figure is shown, not judged. Differences are relative to the reference
    unless they are absolute.
    """

    quantity: str
    ours: float
    reference: float
    tolerance: float | None
    absolute: bool = False

    @property
    def difference(self) -> float:
        """Return the difference, relative to the reference unless ``absolute``."""
        return abs(self.ours - self.reference) / (1.0 if self.absolute else abs(self.reference))

    @property
    def holds(self) -> bool:
        """Return True if the difference is within a tolerance, if any."""
        return self.tolerance is None or self.difference <= self.tolerance

    def cells(self) -> list[str]:
        """Return the table cells, with digits enough that rounding is irrelevant."""
        tolerance = self.tolerance or 1e-4
        size = 1.0 if self.absolute else abs(self.reference)
        log_resolution = np.log10(tolerance * size) - 2.0  # a hundredth of what is allowed
        numbers = []
        for value in (self.ours, self.reference):
            digits = (
                1.0 + np.floor(np.log10(abs(value))) - np.floor(log_resolution) if value else 1.0
            )
            numbers.append(f"{value:.{int(np.clip(digits, 1, 15))}g}")
        kind = " absolute" if self.absolute else ""
        bound = "not judged" if self.tolerance is None else f"{self.tolerance:g}{kind}"
        return [self.quantity, *numbers, f"{self.difference:.1e}", bound]


def join_series(rows: list[Row]) -> list[list[Row]]:
    """Join rows whose quantities differ by one number, as modes do."""
    groups: list[list[Row]] = []
    for row in rows:
        matching_group = next((group for group in groups if _split_at_number([*group, row])), None)
        if matching_group is None:
            groups.append([row])
        else:
            matching_group.append(row)
    return groups


def _split_at_number(rows: list[Row]) -> tuple[str, list[str], str] | None:
    """Split quantities into text before a number, the numbers, and text behind.

    None unless exactly one number differs, and all tolerances are equal.
    """
    parts = [NUMBER.split(row.quantity) for row in rows]
    tolerances = {(row.tolerance, row.absolute) for row in rows}
    if len({len(part) for part in parts}) > 1 or len(tolerances) > 1:
        return None
    indices = [i for i, column in enumerate(zip(*parts, strict=True)) if len(set(column)) > 1]
    if len(indices) != 1 or indices[0] % 2 == 0:
        return None
    [i] = indices
    return "".join(parts[0][:i]), [part[i] for part in parts], "".join(parts[0][i + 1 :])


def series_cells(rows: list[Row]) -> list[str]:
    """Return a table line: all values, and the largest difference."""
    if len(rows) == 1:
        return rows[0].cells()
    prefix, numbers, suffix = _split_at_number(rows) or ("", [], "")
    _, ours, references, _, tolerances = zip(*(row.cells() for row in rows), strict=True)
    if len(set(references)) == 1:
        references = references[:1]
    max_difference = f"{max(row.difference for row in rows):.1e}"
    quantity = f"{prefix}{', '.join(numbers)}{suffix}"
    return [quantity, ", ".join(ours), ", ".join(references), max_difference, tolerances[0]]


@dataclass(frozen=True)
class Case:
    """A page of the book."""

    name: str
    title: str
    text: str
    topic: str
    rows: Callable[[], list[Row]]
    draw: Callable[[Any], None]
    """Draws into matplotlib axes."""
    maker: Callable[[], str | None] | None
    """The other program that made the references, with its version; None if it is missing."""

    @property
    def page(self) -> Path:
        """Return the path of the page."""
        return PAGES / f"{self.name}.md"

    def write(self, rows: list[Row]) -> None:
        """Write the page and its picture."""
        self.page.write_text(self.render(rows))
        figure = Figure(figsize=(6.4, 3.6), layout="constrained")
        self.draw(figure.subplots())
        figure.savefig(self.page.with_suffix(".png"), dpi=110)

    def render(self, rows: list[Row]) -> str:
        """Return the text of the page."""
        judged_rows = [row for row in rows if row.tolerance is not None]
        misses = [row for row in judged_rows if not row.holds]
        verdict = (
            f"🔴 {len(misses)} of {len(judged_rows)}" if misses else f"🟢 All {len(judged_rows)}"
        )
        paragraphs = [
            f"# {self.title}\n",
            f"{verdict} figures {'do not hold' if misses else 'hold'}.\n",
            f"{self.text}\n",
            HEAD
            + "\n".join(f"| {' | '.join(series_cells(series))} |" for series in join_series(rows))
            + "\n",
            f"![picture]({self.name}.png)\n",
        ]
        if self.maker:
            paragraphs.append(f"The references were made with {self.maker()}.\n")
        paragraphs.append(
            f"    .venv/bin/python -m pytest tests/verification -k 'book[{self.name}]'\n"
        )
        return "\n".join(paragraphs)


def label(axes: Any, **words: Any) -> None:
    """Name the axes, set their ranges and show the legend."""
    axes.set(**words)
    axes.legend()


def case(
    *, draw: Callable[[Any], None], maker: Callable[[], str | None] | None = None
) -> Callable[[Callable[[], list[Row]]], Callable[[], list[Row]]]:
    """Put a function into the book."""

    def enter(function: Callable[[], list[Row]]) -> Callable[[], list[Row]]:
        title, _, text = inspect.getdoc(function).partition("\n")  # type: ignore[union-attr]
        module = sys.modules[function.__module__]
        topic = inspect.getdoc(module).partition("\n")[0].rstrip(".")  # type: ignore[union-attr]
        CASES[function.__name__] = Case(
            function.__name__, title.rstrip("."), text.strip(), topic,
            function, draw, maker,
        )  # fmt: skip
        return function

    return enter


def split_page(text: str) -> tuple[str, list[list[str]]]:
    """Split a page into its text without figures, and the table's cells."""
    head, _, rest = text.partition(HEAD)
    table, _, rest = rest.partition("\n\n")
    cells = [line.strip("| ").split(" | ") for line in table.splitlines()]
    rest = re.sub(r"The references were made with .*\n", "", rest)  # another version may do
    return head + rest, cells


def differences(page: str, rows: list[Row], fresh_page: str) -> list[str]:
    """List what a committed page has that is no longer so.

    The figures may differ from today's by a fourth of the tolerance: other versions of gmsh or
    PETSc round otherwise.
    """
    (text, cells), (fresh_text, fresh_cells) = split_page(page), split_page(fresh_page)
    series = join_series(rows)
    if text != fresh_text or len(cells) != len(series):
        return ["the text or the number of rows"]
    messages = []
    for group, old_row, fresh_row in zip(series, cells, fresh_cells, strict=True):
        if (old_row[0], old_row[4]) != (fresh_row[0], fresh_row[4]):
            messages.append(f"{fresh_row[0]}: quantity or allowed difference")
        for name, values, old_numbers in (
            ("ours", [row.ours for row in group], old_row[1].split(", ")),
            ("reference", [row.reference for row in group], old_row[2].split(", ")),
        ):
            if len(old_numbers) == 1:
                old_numbers *= len(group)
            for row, number, value in zip(group, old_numbers, values, strict=True):
                unit = 1.0 if row.absolute else abs(row.reference)
                if abs(float(number) - value) > 0.25 * (row.tolerance or 1e-3) * unit:
                    messages.append(f"{row.quantity}: {name} was {number}, is {value:.12g}")
    return messages


def index() -> str:
    """Return the index of the pages, with its smaller checks kept."""
    lines = [
        "# The verification book\n",
        "One page a case: the problem, the source of its reference, our figures beside it, and the",
        "command that makes them. A case is a function in `tests/verification/`; the tests make",
        "every table again and fail where a figure no longer holds. A line of several figures has",
        "their largest difference; *furthest off* is a page's largest over what is allowed. 🟢:",
        "all figures are within that; 🔴: at least one is not. After a change (references of",
        "CalculiX need `apt-get install calculix-ccx`):\n",
        "    .venv/bin/python -m pytest tests/verification --write-book\n",
        "[Smaller checks](#smaller-checks-a-line-each) follow, a line each.\n",
    ]
    for topic in dict.fromkeys(case.topic for case in CASES.values()):
        lines += [f"## {topic}\n", "| | case | figures | furthest off |"]
        lines += ["|---|---|---|---|"]
        lines += [_line(case) for case in CASES.values() if case.topic == topic]
        lines += [""]
    smaller_checks = "".join((PAGES / "index.md").read_text().partition("\n## Smaller checks")[1:])
    return "\n".join(lines) + f"\n```{{toctree}}\n:hidden:\n:glob:\n\n*_*\n```\n{smaller_checks}"


def _line(case: Case) -> str:
    text = case.page.read_text()
    judged_cells = [cells for cells in split_page(text)[1] if cells[4] != "not judged"]
    bounds = [(float(cells[3]), float(cells[4].split()[0])) for cells in judged_cells]
    share = max((diff / bound for diff, bound in bounds if bound), default=0.0)  # counts are exact
    sign = "🟢" if "🟢" in text else "🔴"
    count = sum(len(cells[1].split(", ")) for cells in judged_cells)
    return f"| {sign} | [{case.title}]({case.name}.md) | {count} | {share:.0%} |"
