"""Do work on one rank for all ranks, and pass errors to every rank.

This module imports MPI before PETSc, since PETSc would start MPI for one thread only. It starts
PETSc, too. SLEPc is started at the first use, with several ranks here. Every folder that uses these
libraries imports this module first.
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
from fenics_crack.basics.machine import (
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
"""Signals that stop the program: Ctrl-C, and two signals from mpirun.

SIGTERM goes to the ranks a second before mpirun kills them; SIGUSR1 is passed on to the ranks, to
let them end by themselves.
"""


def _start_petsc() -> None:
    """Start PETSc with options from a file, the environment and the command line.

    The file is ``~/.petscrc`` and the variable is PETSC_OPTIONS. From the command line, PETSc gets
    all arguments from the first ``-crack_`` on. The command line takes precedence over the
    variable, and the variable over the file. While PETSc starts, the process leaves the working
    folder. Files ``.petscrc``, ``petscrc`` and ``petsc.cfg`` there would be read otherwise, and can
    load code.
    """
    user_option_text = os.environ.get("PETSC_OPTIONS", "")
    with leave_working_folder():
        _, petsc_architecture = lib.getPathArchPETSc()
        options_file_path = os.path.expanduser("~/.petscrc")
        if os.access(options_file_path, os.R_OK):
            os.environ["PETSC_OPTIONS"] = f'-options_file "{options_file_path}" {user_option_text}'
    petsc_options = dropwhile(lambda word: not word.startswith("-crack_"), sys.argv)
    init([sys.executable, "-skip_petscrc", *petsc_options], petsc_architecture)
    os.environ["PETSC_OPTIONS"] = user_option_text


if "petsc4py.PETSc" not in sys.modules:  # unless who calls has started it
    _start_petsc()


def check_scalar_type() -> None:
    """Raise InputError unless PETSc computes with real numbers in double precision."""
    from petsc4py import PETSc

    if PETSc.ScalarType is not np.float64:
        requirement_text = (
            "float64: install PETSc for real numbers (dolfinx-solver-real, petsc=*=real*)"
        )
        raise InputError("PETSc.ScalarType", PETSc.ScalarType.__name__, requirement_text)


check_scalar_type()


def list_unread_options() -> list[str]:
    """Return options ``-crack_...`` of the command line that PETSc has not used."""
    from petsc4py import PETSc

    query_if_option_is_used = partial(ctypes.CDLL(PETSc.__file__).PetscOptionsUsed, None)
    is_used_out = ctypes.c_int()
    option_names = [argument for argument in sys.argv[1:] if argument.startswith("-crack_")]
    return [
        option_name
        for option_name in option_names
        if query_if_option_is_used(option_name[1:].encode(), ctypes.byref(is_used_out))
        or not is_used_out
    ]


def import_slepc() -> Any:
    """Import and start SLEPc, and return the module (collective)."""
    with leave_working_folder():
        from slepc4py import SLEPc
    return SLEPc


if MPI.COMM_WORLD.size > 1:  # it ends together, too; a rank of a sweep may come to it alone
    import_slepc()


def check_communicator(comm: object) -> None:
    """Raise InputError unless a value is a communicator of mpi4py."""
    if not isinstance(comm, MPI.Comm) or comm == MPI.COMM_NULL:
        requirement_text = "a communicator of mpi4py, such as MPI.COMM_WORLD"
        if isinstance(comm, Mapping):
            requirement_text += "; to change a scene, call scene.replace({...})"
        raise InputError("comm", comm, requirement_text)


MIN_SLEEP_SECONDS, MAX_SLEEP_SECONDS = 5e-5, 2e-3
"""Shortest and longest time between two checks in :func:`wait_until` [s].

Each sleep is twice as long as the last.
"""


def wait_until(is_done: Callable[[], bool]) -> None:
    """Sleep until a function returns True.

    MPI itself would wait with a busy processor.
    """
    sleep_seconds = MIN_SLEEP_SECONDS
    while not is_done():
        time.sleep(sleep_seconds)
        sleep_seconds = min(2.0 * sleep_seconds, MAX_SLEEP_SECONDS)


def raise_first_error(comm: MPI.Comm, error: Exception | None) -> None:
    """Raise the error of the lowest failing rank on every rank (collective).

    ``error`` is this rank's error, or None. A single rank must not raise alone: the others would
    wait forever in a collective call.
    """
    rank_errors = [rank_error for rank_error in comm.allgather(error) if rank_error is not None]
    if rank_errors:
        raise rank_errors[0]


def call_on_each_rank(comm: MPI.Comm, function: Callable[[], Result]) -> Result:
    """Call a function on each rank, and return this rank's result (collective).

    An InputError of the lowest failing rank is raised on every rank. Other exceptions are raised on
    their rank alone.
    """
    rank_result, rank_error = None, None
    try:
        rank_result = function()
    except InputError as caught_error:
        rank_error = caught_error
    raise_first_error(comm, rank_error)
    return cast(Result, rank_result)


def on_root(comm: MPI.Comm, function: Callable[[], Result]) -> Result:
    """Call a function on rank 0, and return the result on every rank (collective).

    An exception of rank 0 is raised on every rank.
    """
    root_result, root_error = None, None
    if comm.rank == 0:
        try:
            root_result = function()
        except BaseException as caught_error:  # an interrupt too, for which the others would wait
            root_error = caught_error
    if comm.size > 1:  # the others have nothing else to do
        wait_until(comm.Ibarrier().Test)
    shared_error = comm.bcast(root_error)
    if shared_error is not None:
        raise root_error or shared_error  # rank 0's own, with its cause
    return cast(Result, root_result if comm.size == 1 else comm.bcast(root_result))  # packs it


def collect_garbage(comm: MPI.Comm, *, was_stopped: bool = False) -> None:
    """Free PETSc objects that are no longer referenced (collective).

    petsc4py does not free objects when Python deletes them, since ranks may do so in different
    orders. Freed are the objects on ``comm``, and those on this rank alone. With ``was_stopped``,
    PETSc errors are ignored: a solver may have been stopped within a step.
    """
    from petsc4py import PETSc

    with suppress(*[PETSc.Error] if was_stopped else []):  # of a solver in the middle of a step
        PETSc.garbage_cleanup(comm)
        PETSc.garbage_cleanup(MPI.COMM_SELF)


def gather_rows(comm: MPI.Comm, rows: np.ndarray) -> np.ndarray[Any, Any]:
    """Stack the rows (n, ...) of all ranks on every rank, in rank order (collective)."""
    return np.concatenate(comm.allgather(np.asarray(rows)), axis=0)


def _install_handlers(handler_by_signal: Mapping[signal.Signals, Any]) -> dict[signal.Signals, Any]:
    """Install signal handlers, and return the previous handlers by signal.

    Only the main thread may do so; in another thread nothing is installed and the dict is empty.
    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    return {
        signal_number: signal.signal(signal_number, handler)
        for signal_number, handler in handler_by_signal.items()
    }


@contextmanager
def ignore_stop_signals() -> Iterator[None]:
    """Ignore :data:`STOP_SIGNALS` during the block, while results are written."""
    previous_handler_by_signal = _install_handlers(dict.fromkeys(STOP_SIGNALS, signal.SIG_IGN))
    try:
        yield
    finally:
        _install_handlers(previous_handler_by_signal)


class StopRequest:
    """Turn Ctrl-C into a request to stop, for the block to check between steps.

    Any signal in :data:`STOP_SIGNALS` makes the request; a second signal raises KeyboardInterrupt
    at once. After the block, the request passes to an enclosing StopRequest.

        with StopRequest() as stop:
            while not stop.is_requested(comm): ...
    """

    def __init__(self) -> None:
        self._is_requested = False
        self._previous_handler_by_signal: dict[signal.Signals, Any] = {}

    def __enter__(self) -> StopRequest:
        self._previous_handler_by_signal = _install_handlers(
            dict.fromkeys(STOP_SIGNALS, self._request_stop)
        )
        return self

    def __exit__(self, *exception: object) -> None:
        _install_handlers(self._previous_handler_by_signal)
        outer_request = getattr(
            self._previous_handler_by_signal.get(signal.SIGINT), "__self__", None
        )
        if self._is_requested and isinstance(outer_request, StopRequest):
            outer_request._is_requested = True

    def _request_stop(self, signal_number: int, frame: object) -> None:
        """Handle a signal: note the request, or raise KeyboardInterrupt at the second signal."""
        if self._is_requested:
            raise KeyboardInterrupt
        self._is_requested = True

    def is_requested(self, comm: MPI.Comm) -> bool:
        """Return True if a rank of the communicator has received a stop signal (collective)."""
        return bool(comm.allreduce(self._is_requested, MPI.LOR))
