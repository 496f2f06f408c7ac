"""Report of a result, built once for the terminal, for files and for a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fenics_crack.basics.errors import Exit
from fenics_crack.basics.tables import Conclusion, Table


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
        Scene that selects the units of a printed table with several units.
    csv_table : Table, optional
        Table for the .csv file; default: ``table``.
    printed_table : Table, optional
        Table printed as text; default: ``table``.
    notes, warnings : sequences of str
        Further information, and doubts about the result.
    page_tables : dict of str to Table
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
    page_tables: Mapping[str, Table] = field(default_factory=dict)
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
        """Exit code of the command: DONE, MISSED or NOT_CONVERGED."""
        if not self.has_converged:
            return Exit.NOT_CONVERGED
        return Exit.MISSED if self.misses_tolerance else Exit.DONE
