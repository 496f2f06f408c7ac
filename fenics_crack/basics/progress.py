"""The stages of a long computation, logged while they begin.

The library calls :func:`begin` where something starts that takes seconds with a large mesh: a
message of the logger ``fenics_crack.progress``, at level DEBUG. The program's console shows them
(:class:`StageLines`).
"""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

MESSAGE_INTERVAL = 5.0
"""Time between progress messages [s]."""
LOGGER = logging.getLogger("fenics_crack")
"""Notes, remarks and warnings for the user."""
_STAGE_LOGGER = LOGGER.getChild("progress")
_stage_prefixes: list[str] = []
_progress_functions: list[Callable[[], str]] = []


def begin_stage(stage: str) -> None:
    """Report what is done from now on; "" ends a stage where a progress bar goes on."""
    _STAGE_LOGGER.debug("%s", ": ".join([*_stage_prefixes, stage]) if stage else "")


@contextmanager
def _append_temporarily(many: list[Any], one: Any) -> Iterator[None]:
    """One more at the end of some, for a while."""
    many.append(one)
    try:
        yield
    finally:
        many.pop()


def prefix_stages(part: str) -> AbstractContextManager[None]:
    """Report stages as those of a part: "16 modes: natural modes"."""
    return _append_temporarily(_stage_prefixes, part)


def add_progress_text(how_far: Callable[[], str]) -> AbstractContextManager[None]:
    """Add to progress messages how far something has come: "38% of 780 to 880 Hz, 120 points"."""
    return _append_temporarily(_progress_functions, how_far)


class StageLines(logging.Handler):
    """Shows the stage that is being done, with a progress message every :data:`BEAT` seconds.

    On a terminal the stage is shown while it is being done; elsewhere a message is a line.

    Parameters
    ----------
    stream : text stream
        Standard error.
    kept : bool
        Keep a line of each stage that took more than a second; else only messages are shown.
    """

    def __init__(self, stream: Any = None, *, kept: bool = True) -> None:
        super().__init__()
        self._stream = stream or sys.stderr
        self._live, self._kept = bool(self._stream.isatty()), kept
        self._stage, self._began, self._over = "", 0.0, threading.Event()
        self._writing = self.lock or nullcontext()

    def __enter__(self) -> StageLines:
        _STAGE_LOGGER.addHandler(self)
        _STAGE_LOGGER.setLevel(logging.DEBUG)
        return self

    def __exit__(self, *exception: object) -> None:
        _STAGE_LOGGER.setLevel(logging.NOTSET)
        _STAGE_LOGGER.removeHandler(self)
        with self._writing:
            self._show("")

    def emit(self, record: logging.LogRecord) -> None:
        """End the stage before, and begin this one; the lock is held."""
        self._show(record.getMessage())

    def _show(self, stage: str) -> None:
        now = time.perf_counter()
        before, self._stage = self._stage, stage
        if before:
            self._write("\r\033[K" if self._live else "")
            if self._kept and now - self._began > 1.0:
                self._write(f"  {before}: {now - self._began:.1f} s\n")
        self._began = now
        if stage and self._live:
            self._write(f"  {stage} ...")
        if stage and not before:
            self._over = threading.Event()
            threading.Thread(target=self._repeat, args=(self._over,), daemon=True).start()
        elif before and not stage:
            self._over.set()

    def _repeat(self, over: threading.Event) -> None:
        """Print every few seconds the current stage and its time."""
        while not over.wait(MESSAGE_INTERVAL):
            with self._writing:
                said = f"  {self._stage} ... {time.perf_counter() - self._began:.0f} s"
                said = ", ".join([said, *(how_far() for how_far in _progress_functions)])
                if self._stage:
                    self._write(f"\r\033[K{said}" if self._live else f"{said}\n")

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()


class Messages(logging.StreamHandler):
    """Prints the messages of the program on standard error: warnings, and unless ``quiet`` is
    requested all others, while its block runs."""

    def __init__(self, *, quiet: bool) -> None:
        super().__init__()
        self.setLevel(logging.WARNING if quiet else logging.INFO)

    def __enter__(self) -> Messages:
        LOGGER.addHandler(self)
        LOGGER.setLevel(logging.INFO)
        LOGGER.propagate = False  # compilers of forms set up the root's handlers, too
        return self

    def __exit__(self, *exception: object) -> None:
        LOGGER.removeHandler(self)
        LOGGER.setLevel(logging.NOTSET)
        LOGGER.propagate = True

    def format(self, record: logging.LogRecord) -> str:
        """The message; a warning says that it is one."""
        warns = record.levelno >= logging.WARNING
        return f"{'fenics-crack: warning: ' if warns else ''}{record.getMessage()}"

    def handleError(self, record: logging.LogRecord) -> None:
        """Raise what keeps standard error from being written."""
        raise
