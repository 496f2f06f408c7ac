"""The results of commands: how they are read, who speaks of them, their headings in a report."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mpi4py import MPI

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.cli.account import Account
from fenics_crack.cli.of_curve import account_of_curve
from fenics_crack.cli.of_motion import account_of_history, account_of_modes, account_of_solution
from fenics_crack.cli.of_sweep import account_of_sweep
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.errors import InputError
from fenics_crack.files.store import Stored
from fenics_crack.model.modes import Modes
from fenics_crack.study.run import Run, run_of
from fenics_crack.sweep.file import KIND as SWEEP
from fenics_crack.sweep.result import SweepResult
from fenics_crack.time.march import TimeHistory

__all__ = ["HEADINGS", "account_of", "account_of_file"]

HEADINGS = {
    Modes.KIND: "Natural frequencies and modes",
    PeriodicSolution.KIND: "Steady vibration",
    ResponseCurve.KIND: "Response curve",
    SWEEP: "Sweep",
    TimeHistory.KIND: "Motion in time",
}
"""By kind, in the order of a report."""
SPEAKERS: dict[str, Callable[[Run[Any]], Account]] = {
    Modes.KIND: account_of_modes,
    PeriodicSolution.KIND: account_of_solution,
    ResponseCurve.KIND: account_of_curve,
    TimeHistory.KIND: account_of_history,
}


def account_of(run: Run[Any]) -> Account:
    """What there is to say of the result of a run (collective)."""
    return SPEAKERS[run.result.KIND](run)


def account_of_file(stored: Stored) -> Account:
    """The same of a file that one rank has read.

    Raises
    ------
    InputError
        It is no result of a command.
    """
    if stored.kind not in HEADINGS:
        allowed = f"a result of one of these kinds: {', '.join(HEADINGS)}"
        raise InputError("result", str(stored.path), allowed)
    if stored.kind == SWEEP:
        return account_of_sweep(SweepResult.load(stored.path))
    return account_of(run_of(stored, MPI.COMM_SELF))
