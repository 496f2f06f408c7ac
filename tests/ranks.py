"""Two ranks that tests share: ``mpirun`` starts them once, and they run function after function.

Between two functions a rank waits at a socket: waiting in MPI would keep a processor busy.
"""

from __future__ import annotations

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
from surroundings import MPI_ENVIRONMENT, ROOT

PATIENCE = 180.0
"""Seconds for a start, and for a call."""


def command(program: str | Path, ranks: int) -> list[str]:
    """The words that run a Python program, source or file, on some ranks."""
    launcher = shutil.which("mpirun")
    if launcher is None:
        pytest.skip("mpirun is not installed")
    source = ["-c", program] if isinstance(program, str) else [str(program)]
    return [launcher, "-n", str(ranks), sys.executable, *source]


def environment() -> dict[str, str]:
    """What ranks need besides: a program of theirs can import the test files."""
    tests = ROOT / "tests"
    inner = (item for item in tests.iterdir() if item.is_dir())
    folders = [tests, *inner, ROOT / "benchmarks", ROOT, os.environ.get("PYTHONPATH", "")]
    search = os.pathsep.join(filter(None, map(str, folders)))
    return os.environ | MPI_ENVIRONMENT | {"PYTHONPATH": search}


def kill(process: subprocess.Popen[bytes], pids: Sequence[int]) -> None:
    """kill -9 of a program and its ranks; return when they are gone, and their locks with them."""
    process.kill()
    for pid in pids:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
    process.wait()
    deadline = time.monotonic() + PATIENCE
    while any(_is_running(pid) for pid in pids):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def _is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


class Ranks:
    """Two ranks, started by the first call, and anew by that after one that failed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        self._lines: list[Connection] = []

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function of a test file on both; return what it returned on the first.

        Its last argument is the communicator. What goes wrong on either rank fails the test.
        """
        try:
            if self._process is None:
                self._start()
            for line in self._lines:
                line.send_bytes(pickle.dumps((function, arguments)))
            return self._answers()[0]
        except BaseException:
            self.end(patience=0.0)  # the other rank may be waiting for ever
            raise

    def _start(self) -> None:
        """Let both call back."""
        place = self._folder / "socket"
        place.unlink(missing_ok=True)
        with socket.socket(socket.AF_UNIX) as door, open(self._folder / "said", "wb") as said:
            door.bind(str(place))
            door.listen()
            door.settimeout(PATIENCE)
            self._process = subprocess.Popen(
                command(f"import ranks; ranks.serve({str(place)!r})", 2),
                env=environment(), stdin=subprocess.DEVNULL, stdout=said, stderr=said,
            )  # fmt: skip
            self._lines = [Connection(door.accept()[0].detach()) for _ in range(2)]

    def _answers(self) -> list[Any]:
        """What the ranks return, the first one's first."""
        found: dict[int, Any] = {}
        until = time.monotonic() + PATIENCE
        waiting = list(self._lines)
        while waiting:
            ready = wait(waiting, max(0.0, until - time.monotonic()))
            assert ready, f"not finished after {PATIENCE:g} s{self._said()}"
            for line in ready:
                waiting.remove(line)  # type: ignore[arg-type]
                try:
                    rank, returned, failure = line.recv()  # type: ignore[union-attr]
                except EOFError:
                    raise AssertionError(f"a rank has ended{self._said()}") from None
                assert not failure, f"on rank {rank}:\n{failure}{self._said()}"
                found[rank] = returned
        return [found[rank] for rank in sorted(found)]

    def _said(self) -> str:
        """The end of what both have printed."""
        return "\n--- printed\n" + (self._folder / "said").read_text(errors="replace")[-3000:]

    def end(self, patience: float = 10.0) -> None:
        """Let them go: idle ranks end by themselves within some seconds, others by ``mpirun``."""
        for line in self._lines:
            line.close()
        if self._process is not None:
            try:
                self._process.wait(patience)
            except subprocess.TimeoutExpired:
                self._process.terminate()
                self._process.wait()
        self._process, self._lines = None, []


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
            found, failure = None, ""
            try:
                function, arguments = pickle.loads(sent)
                found = function(*arguments, comm)
            except BaseException:
                failure = traceback.format_exc()
            line.send((comm.rank, found if comm.rank == 0 else None, failure))
