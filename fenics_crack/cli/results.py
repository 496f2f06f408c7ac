"""The results of commands: how they are read, who speaks of them, their headings in a report."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mpi4py import MPI

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.cli.account import Account, in_one_unit
from fenics_crack.cli.of_curve import account_of_curve
from fenics_crack.cli.of_motion import account_of_history, account_of_modes, account_of_solution
from fenics_crack.cli.of_sweep import account_of_sweep
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.errors import InputError
from fenics_crack.files.store import IDENTIFICATION, Stored
from fenics_crack.growth.result import ENDS, Growth
from fenics_crack.model.modes import Modes
from fenics_crack.study.run import Run, run_of
from fenics_crack.study.verification import Verification, verification_of
from fenics_crack.sweep.result import SweepResult
from fenics_crack.table import Table, quantity
from fenics_crack.time.march import TimeHistory

__all__ = [
    "HEADINGS", "IDENTIFIED", "Computed", "account_of", "account_of_verification",
    "result_of",
]  # fmt: skip

Computed = Run[Any] | SweepResult | Verification | Growth
"""What commands write."""

HEADINGS = {
    Modes.KIND: "Natural frequencies and modes",
    PeriodicSolution.KIND: "Steady vibration",
    ResponseCurve.KIND: "Response curve",
    SweepResult.KIND: "Sweep",
    TimeHistory.KIND: "Motion in time",
    Growth.KIND: "Growth of the crack",
    Verification.KIND: "Convergence study",
}
"""By kind, in the order of a report."""
IDENTIFIED = (
    "what identify has found is in identify.json, fit.csv and, of two unknowns or more, "
    "posterior.png beside it"
)
SHOWN_LENGTHS = 9
"""Rows that are printed; the file has all."""


def account_of_verification(found: Verification) -> Account:
    """A convergence study."""
    told = found.statement[: -len(found.warnings) or None]
    return Account(
        "verify",
        found.table(),
        shown=found.totals(),
        facts=told,
        notes=told,
        warnings=found.warnings,
        tables={"Contributions": found.totals()},
        done=not found.failures,
    )


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


SPEAKERS: dict[str, Callable[[Any], Account]] = {
    Modes.KIND: account_of_modes,
    PeriodicSolution.KIND: account_of_solution,
    ResponseCurve.KIND: account_of_curve,
    SweepResult.KIND: account_of_sweep,
    TimeHistory.KIND: account_of_history,
    Growth.KIND: account_of_growth,
    Verification.KIND: account_of_verification,
}


def account_of(result: Computed) -> Account:
    """What there is to say of a result (collective)."""
    return SPEAKERS[result.KIND](result)


def result_of(stored: Stored) -> Computed:
    """The result of a file that one rank has read.

    Raises
    ------
    InputError
        It is no result of a command.
    """
    if stored.kind == IDENTIFICATION:
        raise InputError("result", str(stored.path), f"another kind of result; {IDENTIFIED}")
    if stored.kind not in HEADINGS:
        allowed = f"a result of one of these kinds: {', '.join(HEADINGS)}"
        raise InputError("result", str(stored.path), allowed)
    if stored.kind == SweepResult.KIND:
        return SweepResult.load(stored.path)
    if stored.kind == Growth.KIND:
        return Growth.of(stored)
    study = verification_of(stored) if stored.kind == Verification.KIND else None
    judged = stored.kind != PeriodicSolution.KIND  # whose errors are in the file
    return study or run_of(stored, MPI.COMM_SELF, judged=judged)
