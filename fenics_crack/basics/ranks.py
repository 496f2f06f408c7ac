"""Work done by one rank for all, and errors passed from one rank to every rank.

MPI is imported here before PETSc, which would start it for one thread only, and PETSc is started
here; SLEPc when it is first used, but here where there are several ranks. Every folder that uses
them imports this module first.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from importlib.util import find_spec
from itertools import dropwhile
from typing import Any, TypeVar, cast

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.installation import (
    RANK_COUNT_VARIABLES,
    check_launcher,
    report_missing_libraries,
)
from fenics_crack.basics.untrusted_files import leave_working_folder

with leave_working_folder(), report_missing_libraries():  # UCX would read a ucx.conf
    if find_spec("dolfinx_solver"):  # DOLFINx of wheels, and MPICH, which Open MPI's mpirun ends
        check_launcher(0, "MPICH", RANK_COUNT_VARIABLES[:1])
        import dolfinx_solver  # noqa: F401
        import scipy.linalg  # noqa: F401  with an OpenBLAS of its own, which run_single_threaded() has to find
    from mpi4py import MPI
    from petsc4py import init, lib

check_launcher(MPI.COMM_WORLD.size, " ".join(map(str, MPI.get_vendor())))

Result = TypeVar("Result")
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)
"""Signals that stop: of Ctrl-C; what mpirun sends its ranks a second before it kills them; and what
it passes on to them, so that they end by themselves."""


def _start_petsc() -> None:
    """Start PETSc with options from ``~/.petscrc``, PETSC_OPTIONS and this program's arguments from
    the first ``-crack_`` on; the later of them take precedence.

    PETSc itself would also read .petscrc and petscrc in the working folder, which can load code,
    and petsc4py, like slepc4py below, a petsc.cfg that says from where PETSc is loaded.
    """
    given = os.environ.get("PETSC_OPTIONS", "")
    with leave_working_folder():
        _, arch = lib.getPathArchPETSc()
        own = os.path.expanduser("~/.petscrc")
        if os.access(own, os.R_OK):
            os.environ["PETSC_OPTIONS"] = f'-options_file "{own}" {given}'
    options = dropwhile(lambda word: not word.startswith("-crack_"), sys.argv)
    init([sys.executable, "-skip_petscrc", *options], arch)
    os.environ["PETSC_OPTIONS"] = given


if "petsc4py.PETSc" not in sys.modules:  # unless who calls has started it
    _start_petsc()


def check_scalar_type() -> None:
    """Raise InputError unless PETSc computes with real numbers of eight bytes."""
    from petsc4py import PETSc

    if PETSc.ScalarType is not np.float64:
        allowed = "float64: install a PETSc of real numbers (dolfinx-solver-real, petsc=*=real*)"
        raise InputError("PETSc.ScalarType", PETSc.ScalarType.__name__, allowed)


check_scalar_type()


def list_unread_options() -> list[str]:
    """Return the options ``-crack_...`` of this program's arguments that PETSc has not read."""
    from petsc4py import PETSc

    query, is_used = partial(ctypes.CDLL(PETSc.__file__).PetscOptionsUsed, None), ctypes.c_int()
    names = [word for word in sys.argv[1:] if word.startswith("-crack_")]
    return [n for n in names if query(n[1:].encode(), ctypes.byref(is_used)) or not is_used]


def import_slepc() -> Any:
    """The module SLEPc, started (collective)."""
    with leave_working_folder():
        from slepc4py import SLEPc
    return SLEPc


if MPI.COMM_WORLD.size > 1:  # it ends together, too; a rank of a sweep may come to it alone
    import_slepc()


def check_communicator(comm: object) -> None:
    """Raise InputError unless a value is a communicator of mpi4py."""
    if not isinstance(comm, MPI.Comm) or comm == MPI.COMM_NULL:
        allowed = "a communicator of mpi4py, such as MPI.COMM_WORLD"
        if isinstance(comm, Mapping):
            allowed += "; changes are made by scene.replace({...})"
        raise InputError("comm", comm, allowed)


SHORTEST_SLEEP, LONGEST_SLEEP = 5e-5, 2e-3
"""Between two looks at what a rank waits for [s]: each sleep is twice the one before."""


def wait_until(done: Callable[[], bool]) -> None:
    """Sleep until something is done: MPI itself would wait with all of a processor."""
    pause = SHORTEST_SLEEP
    while not done():
        time.sleep(pause)
        pause = min(2.0 * pause, LONGEST_SLEEP)


def raise_first_error(comm: MPI.Comm, error: Exception | None) -> None:
    """Raise on every rank the error that the lowest failing rank met (collective).

    Otherwise one rank would raise while the others wait for ever in a collective call.
    """
    errors = [found for found in comm.allgather(error) if found is not None]
    if errors:
        raise errors[0]


def call_on_each_rank(comm: MPI.Comm, function: Callable[[], Result]) -> Result:
    """Call ``function`` on each rank, which has its own result; input that the lowest failing rank
    refuses is refused on every rank."""
    result, error = None, None
    try:
        result = function()
    except InputError as met:
        error = met
    raise_first_error(comm, error)
    return cast(Result, result)


def on_root(comm: MPI.Comm, function: Callable[[], Result]) -> Result:
    """Call ``function`` on rank 0 and hand its result, or its exception, to every rank."""
    result, error = None, None
    if comm.rank == 0:
        try:
            result = function()
        except BaseException as caught:  # an interrupt too, for which the others would wait
            error = caught
    if comm.size > 1:  # the others have nothing else to do
        wait_until(comm.Ibarrier().Test)
    met = comm.bcast(error)
    if met is not None:
        raise error or met  # rank 0's own, with its cause
    return cast(Result, result if comm.size == 1 else comm.bcast(result))  # packs it


def collect_garbage(comm: MPI.Comm, *, stopped: bool = False) -> None:
    """Free PETSc objects that are no longer referenced (collective).

    petsc4py leaves them alone when Python deletes them: ranks may do so in different orders. So it
    does with those of small structures, which each rank has for itself.
    """
    from petsc4py import PETSc

    with suppress(*[PETSc.Error] if stopped else []):  # of a solver in the middle of a step
        PETSc.garbage_cleanup(comm)
        PETSc.garbage_cleanup(MPI.COMM_SELF)


def gather_rows(comm: MPI.Comm, rows: np.ndarray) -> np.ndarray[Any, Any]:
    """Stack the rows of all ranks, in rank order, on every rank (collective)."""
    return np.concatenate(comm.allgather(np.asarray(rows)), axis=0)


def _install_handlers(handlers: Mapping[signal.Signals, Any]) -> dict[signal.Signals, Any]:
    """Install handlers of signals, as the main thread alone may, and return those before."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    return {number: signal.signal(number, handler) for number, handler in handlers.items()}


@contextmanager
def ignore_stop_signals() -> Iterator[None]:
    """Ignore Ctrl-C while what was found is written."""
    handlers = _install_handlers(dict.fromkeys(STOP_SIGNALS, signal.SIG_IGN))
    try:
        yield
    finally:
        _install_handlers(handlers)


class StopRequest:
    """Ctrl-C, or another of :data:`STOPS`, stops where nothing is lost; a second one stops at once.
    Of two, one within the other, the outer one is then asked, too.

    with StopRequest() as stop:
        while not stop.asked(comm): ...
    """

    def __init__(self) -> None:
        self._asked = False
        self._handlers: dict[signal.Signals, Any] = {}

    def __enter__(self) -> StopRequest:
        self._handlers = _install_handlers(dict.fromkeys(STOP_SIGNALS, self._ask))
        return self

    def __exit__(self, *exception: object) -> None:
        _install_handlers(self._handlers)
        outer = getattr(self._handlers.get(signal.SIGINT), "__self__", None)
        if self._asked and isinstance(outer, StopRequest):
            outer._asked = True

    def _ask(self, number: int, frame: object) -> None:
        if self._asked:
            raise KeyboardInterrupt
        self._asked = True

    def asked(self, comm: MPI.Comm) -> bool:
        """Return True if any rank has been asked to stop (collective)."""
        return bool(comm.allreduce(self._asked, MPI.LOR))
