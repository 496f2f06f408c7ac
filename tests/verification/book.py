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


@dataclass(frozen=True)
class Case:
    """A page of the book."""

    name: str
    title: str
    text: str
    topic: str
    file: str
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
            HEAD + "\n".join(f"| {' | '.join(row.cells())} |" for row in rows) + "\n",
            f"![{self.title}]({self.name}.png)\n",
        ]
        if self.maker:
            parts.append(f"The references were made with {self.maker()}.\n")
        parts.append(f"Made by `tests/verification/{self.file}`:\n")
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
            Path(str(module.__file__)).name, function, draw, maker,
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
    if text != words or len(cells) != len(rows):
        return ["the text or the number of rows"]
    found = []
    for row, old, new in zip(rows, cells, fresh, strict=True):
        if (old[0], old[4]) != (new[0], new[4]):
            found.append(f"{row.quantity}: quantity or allowed difference")
        unit = 1.0 if row.absolute else abs(row.reference)
        for name, was, now in (("ours", old[1], row.ours), ("reference", old[2], row.reference)):
            if abs(float(was) - now) > 0.25 * (row.allowed or 1e-3) * unit:
                found.append(f"{row.quantity}: {name} was {was}, is {now:.12g}")
    return found


def index() -> str:
    """The index, from the pages as they are, and the smaller checks, which it keeps."""
    lines = [
        "# The verification book\n",
        "One page a case: the problem, the source of its reference, our figures beside it, and the",
        "command that makes them. The tests make every table again and fail where a figure no longer",
        "holds. 🟢: all figures are within the difference allowed; 🔴: at least one is not. After a",
        "change (references of CalculiX need `apt-get install calculix-ccx`):\n",
        "    .venv/bin/python -m pytest tests/verification --write-book\n",
        "[Smaller checks](#smaller-checks-a-line-each) follow, a line each.\n",
    ]
    for topic in dict.fromkeys(case.topic for case in CASES.values()):
        lines += [f"## {topic}\n", "| | case | figures | furthest off, of what is allowed |"]
        lines += ["|---|---|---|---|"]
        lines += [_line(case) for case in CASES.values() if case.topic == topic]
        lines += [""]
    names = "\n".join(CASES)
    smaller = "".join((PAGES / "index.md").read_text().partition("\n## Smaller checks")[1:])
    return "\n".join(lines) + f"\n```{{toctree}}\n:hidden:\n\n{names}\n```\n{smaller}"


def _line(case: Case) -> str:
    text = case.page.read_text()
    judged = [cells for cells in read(text)[1] if cells[4] != "not judged"]
    bounds = [(float(cells[3]), float(cells[4].split()[0])) for cells in judged]
    share = max((off / bound for off, bound in bounds if bound), default=0.0)  # counts are exact
    sign = "🟢" if "🟢" in text else "🔴"
    return f"| {sign} | [{case.title}]({case.name}.md) | {len(judged)} | {share:.0%} |"
