"""Where a command prints and writes."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

from fenics_crack.parallel import on_root
from fenics_crack.stages import StageLines, listening
from fenics_crack.table import Table
from fenics_crack.whole import not_written

__all__ = ["Console", "make_writable"]


@dataclass(frozen=True)
class Console:
    """Prints a command's table to standard output, all else to standard error."""

    comm: MPI.Comm  # rank 0 writes files
    form: str  # of the table: "text", "csv" or "json"
    quiet: bool  # print the table alone
    verbose: bool  # print how long each part took

    @property
    def progress(self) -> bool:
        """Whether to show a progress bar."""
        return not self.quiet and (self.verbose or sys.stderr.isatty())

    def table(self, table: Table) -> None:
        """Print a table."""
        print(table.formatted(self.form), end="", flush=True)

    def note(self, *texts: str) -> None:
        """Print remarks, unless they are empty or quiet is asked for."""
        for text in texts:
            if text and not self.quiet:
                print(text, file=sys.stderr, flush=True)

    def warn(self, *texts: str) -> None:
        """Print warnings, even if quiet."""
        for text in texts:
            print(f"fenics-crack: warning: {text}", file=sys.stderr, flush=True)

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Print how long a part took, if verbose."""
        started = time.perf_counter()
        yield
        if self.verbose:
            print(f"{name}: {time.perf_counter() - started:.2f} s", file=sys.stderr, flush=True)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """The same, and unless quiet is asked for what is done in that part while it is done: where
        no progress is shown, now and then."""
        lines = nullcontext() if self.quiet else listening(StageLines(kept=self.progress))
        with self.timed(name), lines:
            yield


def make_writable(folder: Path, comm: MPI.Comm) -> None:
    """Make a folder for results; raise InputError unless a file can be written there."""

    def work() -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError as error:
            raise not_written("--output", folder, error, "a folder that can be written") from None

    on_root(comm, work)
