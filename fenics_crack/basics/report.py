"""Report of a result, built once for all uses: the terminal, files, a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fenics_crack.basics.errors import Exit
from fenics_crack.basics.tables import Conclusion, Table


@dataclass(frozen=True)
class Report:
    """Sentences and tables of a result, and how its command ended.

    Attributes
    ----------
    table : Table
        Everything in few numbers, the .json file.
    said : Said
        Parts of the last sentence, which has the answer.
    scene : Scene, optional
        Whose units are chosen for the printed table, where that has several.
    rows : Table, optional
        The .csv file; default: the table.
    shown : Table, optional
        Printed as text; default: the table.
    notes, warnings : sequences of str
        Further information, doubts.
    tables : dict of Table
        Of a page, by their captions; default: what is printed.
    further : dict of Table
        Printed below the first one, and on a page.
    remarks : sequence of Remark
        Unusual values of the scene.
    done, missed : bool
        False where something has not converged; True if the error is above the tolerance, or
        unknown.
    """

    table: Table
    said: Conclusion
    scene: Any = None
    rows: Table | None = None
    shown: Table | None = None
    notes: Sequence[str] = ()
    warnings: Sequence[str] = ()
    tables: Mapping[str, Table] = field(default_factory=dict)
    further: Mapping[str, Table] = field(default_factory=dict)
    remarks: Sequence[object] = ()
    done: bool = True
    missed: bool = False

    @property
    def closing(self) -> str:
        """The last sentence."""
        return self.said.closing(len(self.warnings), len(self.remarks))

    @property
    def exit(self) -> Exit:
        """The exit code of its command."""
        return (Exit.MISSED if self.missed else Exit.DONE) if self.done else Exit.NOT_CONVERGED
