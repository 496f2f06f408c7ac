"""Two ranks that tests share: ``mpirun`` starts them once, and they run function after function.

Between two functions a rank waits at a socket: waiting in MPI would keep a processor busy.
"""

from __future__ import annotations

import contextlib
import io
import os
import pickle
import shutil
import signal
import socket
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from multiprocessing.connection import Client, Connection, wait
from pathlib import Path
from typing import Any

import pytest
from surroundings import MPI_ENVIRONMENT, ROOT, main, no_rank

LIMIT = 900.0
"""Wall-clock seconds after which a process that tests start counts as hanging: each takes seconds
on an idle machine, and fifty times as long beside a hundred others."""


HELD = """
import time
from pathlib import Path
import numpy as np
from fenics_crack.sweep.file import SweepFile
record = SweepFile.write_cases_unless_already_stored
def held(self, *given):
    while np.count_nonzero(self.case_states) >= {cases} and not Path({go!r}).exists():
        time.sleep(0.01)
    record(self, *given)
SweepFile.write_cases_unless_already_stored = held
"""
"""Source of a program whose sweep, once its file has so many cases, waits until another file is
there: however fast it is, it can be stopped before its end."""


def launcher(ranks: int) -> list[str]:
    """Return the words that start some ranks, of Open MPI all on one processor.

    There a rank that waits yields the processor to the one that it waits for, and takes no time: on
    a processor of its own it takes all that there is. MPICH does not yield.
    """
    from mpi4py import MPI

    mpirun = shutil.which("mpirun")
    if mpirun is None:
        pytest.skip("mpirun is not installed")
    words = [mpirun, "-n", str(ranks)]
    if MPI.get_vendor()[0] != "Open MPI":
        return words
    processors = sorted(os.sched_getaffinity(0))
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    return ["taskset", "--cpu-list", str(processors[worker % len(processors)]), *words]


def command(program: str | Path, ranks: int) -> list[str]:
    """The words that run a Python program, source or file, on some ranks."""
    source = ["-c", program] if isinstance(program, str) else [str(program)]
    return [*launcher(ranks), sys.executable, *source]


def environment() -> dict[str, str]:
    """What ranks need besides: a program of theirs can import the test files.

    Words of an MPI that has begun already, as in a conftest of the folder asked for, are left out.
    """
    tests = ROOT / "tests"
    test_folders = (item for item in tests.iterdir() if item.is_dir())
    folders = [tests, *test_folders, ROOT / "benchmarks", ROOT, os.environ.get("PYTHONPATH", "")]
    search = os.pathsep.join(filter(None, map(str, folders)))
    return no_rank() | MPI_ENVIRONMENT | {"PYTHONPATH": search}


def kill(process: subprocess.Popen[bytes], pids: Sequence[int]) -> None:
    """kill -9 of a program and its ranks; return when they are gone, and their locks with them."""
    process.kill()
    for pid in pids:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
    process.wait()
    deadline = time.monotonic() + LIMIT
    while any(is_running(pid) for pid in pids):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def run_program(words: list[str], comm: Any) -> tuple[list[int], list[str]]:
    """Exit codes of the program, by rank, and the lines of errors of all ranks (collective)."""
    errors = io.StringIO()
    with contextlib.redirect_stderr(errors):
        codes = comm.allgather(int(main(words)))
    return codes, "".join(comm.allgather(errors.getvalue())).splitlines()


class Ranks:
    """Two ranks, started by the first call, and anew by that after one that failed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.process: subprocess.Popen[bytes] | None = None
        self.lines: list[Connection] = []

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function of a test file on both; return what it returned on the first.

        Its last argument is the communicator. What goes wrong on either rank fails the test.
        """
        try:
            if self.process is None:
                self.start()
            for line in self.lines:
                line.send_bytes(pickle.dumps((function, arguments)))
            return self.answers()[0]
        except BaseException:
            self.end(grace=0.0)  # the other rank may be waiting for ever
            raise

    def start(self) -> None:
        """Let both call back."""
        place = self.folder / "socket"
        place.unlink(missing_ok=True)
        with socket.socket(socket.AF_UNIX) as door, open(self.folder / "said", "wb") as log_file:
            door.bind(str(place))
            door.listen()
            self.process = subprocess.Popen(
                command(f"import ranks; ranks.serve({str(place)!r})", 2),
                env=environment(), stdin=subprocess.DEVNULL, stdout=log_file, stderr=log_file,
            )  # fmt: skip
            self.lines = [Connection(self.accept_connection(door).detach()) for _ in range(2)]

    def accept_connection(self, door: socket.socket) -> socket.socket:
        """The next rank's connection; it comes at once, unless ``mpirun`` has failed."""
        assert self.process is not None
        deadline = time.monotonic() + LIMIT
        while not wait([door], 1.0):
            is_alive = self.process.poll() is None and time.monotonic() < deadline
            assert is_alive, f"mpirun has not started two ranks{self.printed()}"
        return door.accept()[0]

    def answers(self) -> list[Any]:
        """What the ranks return, the first one's first."""
        results: dict[int, Any] = {}
        until = time.monotonic() + LIMIT
        waiting_lines = list(self.lines)
        while waiting_lines:
            ready = wait(waiting_lines, max(0.0, until - time.monotonic()))
            assert ready, f"not finished after {LIMIT:g} s{self.printed()}"
            for line in ready:
                waiting_lines.remove(line)  # type: ignore[arg-type]
                try:
                    rank, result, failure = line.recv()  # type: ignore[union-attr]
                except EOFError:
                    raise AssertionError(f"a rank has ended{self.printed()}") from None
                assert not failure, f"on rank {rank}:\n{failure}{self.printed()}"
                results[rank] = result
        return [results[rank] for rank in sorted(results)]

    def printed(self) -> str:
        """The end of what both have printed."""
        return "\n--- printed\n" + (self.folder / "said").read_text(errors="replace")[-3000:]

    def end(self, grace: float = 10.0) -> None:
        """Let them go: idle ranks end by themselves within some seconds, others by ``mpirun``."""
        for line in self.lines:
            line.close()
        if self.process is not None:
            try:
                self.process.wait(grace)
            except subprocess.TimeoutExpired:
                self.process.terminate()
                self.process.wait()
        self.process, self.lines = None, []


def serve(place: str) -> None:
    """What each rank does: call what is sent, and answer, until nobody asks any more."""
    from mpi4py import MPI  # before PETSc, which would start it for one thread

    comm = MPI.COMM_WORLD
    with Client(place) as line:
        while True:
            try:
                sent = line.recv_bytes()
            except EOFError:
                return
            result, failure = None, ""
            try:
                function, arguments = pickle.loads(sent)
                result = function(*arguments, comm)
            except BaseException:
                failure = traceback.format_exc()
            line.send((comm.rank, result if comm.rank == 0 else None, failure))
