"""What there is to say of a crack that grows."""

from __future__ import annotations

from fenics_crack.cli.account import Account, in_one_unit
from fenics_crack.growth.result import ENDS, Growth
from fenics_crack.table import Table, quantity

__all__ = ["account_of_growth"]

SHOWN_LENGTHS = 9
"""Rows that are printed; the file has all."""


def account_of_growth(found: Growth) -> Account:
    """The table, the life and how sure it is."""
    table, count = found.table(), len(found.length)
    ends = SHOWN_LENGTHS - 1
    places = sorted({round(n * (count - 1) / ends) for n in range(SHOWN_LENGTHS)})
    shown = in_one_unit(Table(table.columns, [table.rows[n] for n in places]), found.scene)
    hours = found.time[-1] / 3600.0
    first, last = (quantity(float(found.length[end]), "m") for end in (0, -1))
    way = f"from {first} to {last} in {found.life:.4g} cycles ({hours:.4g} h)"
    if found.repeats is not None:
        way += f", {found.repeats[-1]:.4g} repeats of the spectrum"
    fact = f"{way if count > 1 else first}: {ENDS[found.end]}"
    causes = [f"{name} {error:.2g}" for name, error in found.errors.items() if error > 0.0]
    known = f"the cycles are known within a factor of {found.factor:.3g}"
    known += f", standard deviations of their logarithm: {', '.join(causes)}" if causes else ""
    drop = f"the natural frequency of the breathing crack falls by {found.frequency_drop[-1]:.2%}"
    facts = [fact, known, drop]
    return Account(
        "growth",
        table,
        shown=shown,
        facts=[f"{text[0].upper()}{text[1:]}." for text in facts],
        notes=facts,
        warnings=[*found.remarks],
        tables={"The crack over the cycles": shown},
    )
