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
    """One figure against its reference; without an allowed difference it is shown, not judged.

    Differences are relative to the reference unless they are absolute.
    """

    quantity: str
    ours: float
    reference: float
    allowed: float | None
    absolute: bool = False

    @property
    def difference(self) -> float:
        """Absolute value; relative to the reference."""
        return abs(self.ours - self.reference) / (1.0 if self.absolute else abs(self.reference))

    @property
    def holds(self) -> bool:
        """No further off than allowed; never with a value that is no number."""
        return self.allowed is None or self.difference <= self.allowed

    def cells(self) -> list[str]:
        """As they stand in the table: so many digits that the rounding does not matter."""
        allowed = self.allowed or 1e-4
        size = 1.0 if self.absolute else abs(self.reference)
        last = np.log10(allowed * size) - 2.0  # a hundredth of what is allowed
        words = []
        for value in (self.ours, self.reference):
            digits = 1.0 + np.floor(np.log10(abs(value))) - np.floor(last) if value else 1.0
            words.append(f"{value:.{int(np.clip(digits, 1, 15))}g}")
        kind = " absolute" if self.absolute else ""
        bound = "not judged" if self.allowed is None else f"{self.allowed:g}{kind}"
        return [self.quantity, *words, f"{self.difference:.1e}", bound]


def join_series(rows: list[Row]) -> list[list[Row]]:
    """Join rows whose quantities differ by one number, as that of a mode."""
    groups: list[list[Row]] = []
    for row in rows:
        series = next((group for group in groups if _numbers_of([*group, row])), None)
        if series is None:
            groups.append([row])
        else:
            series.append(row)
    return groups


def _numbers_of(rows: list[Row]) -> tuple[str, list[str], str] | None:
    """Return what stands before the number that differs, the numbers, and what stands behind."""
    parts = [NUMBER.split(row.quantity) for row in rows]
    allowed = {(row.allowed, row.absolute) for row in rows}
    if len({len(part) for part in parts}) > 1 or len(allowed) > 1:
        return None
    differing = [i for i, column in enumerate(zip(*parts, strict=True)) if len(set(column)) > 1]
    if len(differing) != 1 or differing[0] % 2 == 0:
        return None
    [i] = differing
    return "".join(parts[0][:i]), [part[i] for part in parts], "".join(parts[0][i + 1 :])


def series_cells(rows: list[Row]) -> list[str]:
    """Return the cells of one line of a table: all values, the largest difference."""
    if len(rows) == 1:
        return rows[0].cells()
    before, numbers, behind = _numbers_of(rows) or ("", [], "")
    _, ours, references, _, allowed = zip(*(row.cells() for row in rows), strict=True)
    if len(set(references)) == 1:
        references = references[:1]
    largest = f"{max(row.difference for row in rows):.1e}"
    quantity = f"{before}{', '.join(numbers)}{behind}"
    return [quantity, ", ".join(ours), ", ".join(references), largest, allowed[0]]


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
        """Where it lies."""
        return PAGES / f"{self.name}.md"

    def write(self, rows: list[Row]) -> None:
        """Page and picture."""
        self.page.write_text(self.render(rows))
        figure = Figure(figsize=(6.4, 3.6), layout="constrained")
        self.draw(figure.subplots())
        figure.savefig(self.page.with_suffix(".png"), dpi=110)

    def render(self, rows: list[Row]) -> str:
        """The page's text."""
        judged = [row for row in rows if row.allowed is not None]
        wrong = [row for row in judged if not row.holds]
        verdict = f"🔴 {len(wrong)} of {len(judged)}" if wrong else f"🟢 All {len(judged)}"
        parts = [
            f"# {self.title}\n",
            f"{verdict} figures {'do not hold' if wrong else 'hold'}.\n",
            f"{self.text}\n",
            HEAD
            + "\n".join(f"| {' | '.join(series_cells(s))} |" for s in join_series(rows))
            + "\n",
            f"![picture]({self.name}.png)\n",
        ]
        if self.maker:
            parts.append(f"The references were made with {self.maker()}.\n")
        parts.append(f"    .venv/bin/python -m pytest tests/verification -k 'book[{self.name}]'\n")
        return "\n".join(parts)


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


def read(text: str) -> tuple[str, list[list[str]]]:
    """A page without its figures, and the cells of its table."""
    before, _, after = text.partition(HEAD)
    table, _, after = after.partition("\n\n")
    cells = [line.strip("| ").split(" | ") for line in table.splitlines()]
    after = re.sub(r"The references were made with .*\n", "", after)  # another version may do
    return before + after, cells


def differences(committed: str, rows: list[Row], rendered: str) -> list[str]:
    """What of a committed page is no longer so.

    Its figures may differ from today's by a fourth of what is allowed: other versions of gmsh or
    PETSc round otherwise.
    """
    (text, cells), (words, fresh) = read(committed), read(rendered)
    series = join_series(rows)
    if text != words or len(cells) != len(series):
        return ["the text or the number of rows"]
    found = []
    for group, old, new in zip(series, cells, fresh, strict=True):
        if (old[0], old[4]) != (new[0], new[4]):
            found.append(f"{new[0]}: quantity or allowed difference")
        for name, values, was in (
            ("ours", [row.ours for row in group], old[1].split(", ")),
            ("reference", [row.reference for row in group], old[2].split(", ")),
        ):
            if len(was) == 1:
                was *= len(group)
            for row, number, now in zip(group, was, values, strict=True):
                unit = 1.0 if row.absolute else abs(row.reference)
                if abs(float(number) - now) > 0.25 * (row.allowed or 1e-3) * unit:
                    found.append(f"{row.quantity}: {name} was {number}, is {now:.12g}")
    return found


def index() -> str:
    """The index, from the pages as they are, and the smaller checks, which it keeps."""
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
    smaller = "".join((PAGES / "index.md").read_text().partition("\n## Smaller checks")[1:])
    return "\n".join(lines) + f"\n```{{toctree}}\n:hidden:\n:glob:\n\n*_*\n```\n{smaller}"


def _line(case: Case) -> str:
    text = case.page.read_text()
    judged = [cells for cells in read(text)[1] if cells[4] != "not judged"]
    bounds = [(float(cells[3]), float(cells[4].split()[0])) for cells in judged]
    share = max((off / bound for off, bound in bounds if bound), default=0.0)  # counts are exact
    sign = "🟢" if "🟢" in text else "🔴"
    count = sum(len(cells[1].split(", ")) for cells in judged)
    return f"| {sign} | [{case.title}]({case.name}.md) | {count} | {share:.0%} |"
