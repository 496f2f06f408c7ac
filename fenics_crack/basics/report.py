"""Report of a result, built once for the terminal, for files and for a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fenics_crack.basics.errors import Exit
from fenics_crack.basics.tables import Conclusion, Table


@dataclass(frozen=True)
class Report:
    """Sentences and tables of a result, and the outcome of the command.

    Attributes
    ----------
    table : Table
        Summary in few numbers, written to the .json file.
    conclusion : Conclusion
        Parts of the last sentence, which has the answer.
    scene : Scene, optional
        Scene that chooses the units of the printed table, if the table has several.
    csv_table : Table, optional
        Table for the .csv file; default: ``table``.
    printed_table : Table, optional
        Table printed as text; default: ``table``.
    notes, warnings : sequences of str
        Further information, doubts.
    page_tables : dict of Table
        Tables of a page by caption; default: the printed table.
    further_tables : dict of Table
        Tables below the first table, printed and on a page, by caption.
    remarks : sequence of Remark
        Unusual values of the scene.
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
        """The last sentence, with the numbers of warnings and remarks."""
        return self.conclusion.sentence(len(self.warnings), len(self.remarks))

    @property
    def exit_code(self) -> Exit:
        """The exit code of the command."""
        if not self.has_converged:
            return Exit.NOT_CONVERGED
        return Exit.MISSED if self.misses_tolerance else Exit.DONE
