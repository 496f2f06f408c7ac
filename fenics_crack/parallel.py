"""What one rank does for all, and how an error on one rank reaches every rank."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["collect_garbage", "gather_rows", "on_root", "raise_together"]

Result = TypeVar("Result")


def raise_together(comm: MPI.Comm, error: Exception | None) -> None:
    """Raise on every rank the error that the lowest failing rank met (collective).

    Without it one rank would raise while the others wait in a collective call for ever.
    """
    errors = [found for found in comm.allgather(error) if found is not None]
    if errors:
        raise errors[0]


def on_root(comm: MPI.Comm, function: Callable[[], Result]) -> Result:
    """Call ``function`` on rank 0 and hand its result, or its exception, to every rank."""
    result, error = None, None
    if comm.rank == 0:
        try:
            result = function()
        except Exception as caught:
            error = caught
    error = comm.bcast(error)
    if error is not None:
        raise error
    return comm.bcast(result)


def collect_garbage(comm: MPI.Comm) -> None:
    """Free PETSc objects that nobody refers to any more (collective).

    petsc4py does not free them when Python forgets them, since ranks could do so in another order.
    """
    PETSc.garbage_cleanup(comm)


def gather_rows(comm: MPI.Comm, rows: np.ndarray) -> np.ndarray[Any, Any]:
    """Stack the rows of all ranks, in rank order, on every rank (collective)."""
    return np.concatenate(comm.allgather(np.asarray(rows)), axis=0)
