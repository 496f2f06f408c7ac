"""Log the stages of a long computation when they begin.

The library calls :func:`begin_stage` before work that takes seconds with a large mesh. This logs a
message of level DEBUG to the logger ``fenics_crack.progress``, and :class:`StageLineHandler` shows
the messages on the program's console.
"""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

PROGRESS_MESSAGE_INTERVAL = 5.0
"""Time between progress messages [s]."""
USER_MESSAGE_LOGGER = logging.getLogger("fenics_crack")
"""Logger of messages for the user: notes, remarks and warnings."""
_STAGE_LOGGER = USER_MESSAGE_LOGGER.getChild("progress")
_stage_prefixes: list[str] = []
_progress_functions: list[Callable[[], str]] = []


def begin_stage(stage: str) -> None:
    """Report the name of the work that begins now, such as "natural modes".

    Handlers of the log show the name until the next report. "" ends the previous stage without a
    new one, for instance before a progress bar.
    """
    _STAGE_LOGGER.debug("%s", ": ".join([*_stage_prefixes, stage]) if stage else "")


@contextmanager
def _append_temporarily(entries: list[Any], entry: Any) -> Iterator[None]:
    """Append an entry to a list, and remove the last entry after the block."""
    entries.append(entry)
    try:
        yield
    finally:
        entries.pop()


def prefix_stages(stage_prefix: str) -> AbstractContextManager[None]:
    """Put a prefix before the stages in a block: "16 modes" gives "16 modes: natural modes"."""
    return _append_temporarily(_stage_prefixes, stage_prefix)


def add_progress_text(describe_progress: Callable[[], str]) -> AbstractContextManager[None]:
    """Add a text to progress messages during a block.

    ``describe_progress`` returns the text for each message: "38% of 780 to 880 Hz, 120 points".
    """
    return _append_temporarily(_progress_functions, describe_progress)


class StageLineHandler(logging.Handler):
    """Handler that shows the stages of a computation during a block.

    On a terminal, the current stage is shown at once. Every 5 s
    (:data:`PROGRESS_MESSAGE_INTERVAL`), a message states the stage and the duration so far: on a
    terminal in place of the last message, otherwise on a new line.

    Parameters
    ----------
    stream : text stream
        Default: standard error.
    keeps_lines : bool
        Write a line after each stage of more than a second; otherwise only messages are shown.
    """

    def __init__(self, stream: Any = None, *, keeps_lines: bool = True) -> None:
        super().__init__()
        self._stream = stream or sys.stderr
        self._is_terminal, self._keeps_lines = bool(self._stream.isatty()), keeps_lines
        self._stage_text, self._start_time, self._end_event = "", 0.0, threading.Event()
        self._write_lock = self.lock or nullcontext()

    def __enter__(self) -> StageLineHandler:
        _STAGE_LOGGER.addHandler(self)
        _STAGE_LOGGER.setLevel(logging.DEBUG)
        return self

    def __exit__(self, *exception: object) -> None:
        _STAGE_LOGGER.setLevel(logging.NOTSET)
        _STAGE_LOGGER.removeHandler(self)
        with self._write_lock:
            self._show_stage("")

    def emit(self, record: logging.LogRecord) -> None:
        """Show the stage in a log record in place of the previous stage.

        ``logging`` calls this with the handler's lock held.
        """
        self._show_stage(record.getMessage())

    def _show_stage(self, stage: str) -> None:
        """End the previous stage, and show the new stage; "" shows none."""
        current_time = time.perf_counter()
        previous_stage, self._stage_text = self._stage_text, stage
        if previous_stage:
            self._write("\r\033[K" if self._is_terminal else "")
            if self._keeps_lines and current_time - self._start_time > 1.0:
                self._write(f"  {previous_stage}: {current_time - self._start_time:.1f} s\n")
        self._start_time = current_time
        if stage and self._is_terminal:
            self._write(f"  {stage} ...")
        if stage and not previous_stage:
            self._end_event = threading.Event()
            threading.Thread(
                target=self._print_messages_until_end, args=(self._end_event,), daemon=True
            ).start()
        elif previous_stage and not stage:
            self._end_event.set()

    def _print_messages_until_end(self, end_event: threading.Event) -> None:
        """Print the current stage and its duration every 5 s until an event is set."""
        while not end_event.wait(PROGRESS_MESSAGE_INTERVAL):
            with self._write_lock:
                elapsed_seconds = time.perf_counter() - self._start_time
                additional_progress_texts = [
                    describe_progress() for describe_progress in _progress_functions
                ]
                stage_text = f"  {self._stage_text} ... {elapsed_seconds:.0f} s"
                progress_text = ", ".join([stage_text, *additional_progress_texts])
                if self._stage_text:
                    self._write(
                        f"\r\033[K{progress_text}" if self._is_terminal else f"{progress_text}\n"
                    )

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()


class NoteAndWarningLogHandler(logging.StreamHandler):
    """Handler that prints notes, remarks and warnings on standard error during a block.

    With ``quiet`` only warnings are printed.
    """

    def __init__(self, *, quiet: bool) -> None:
        super().__init__()
        self.setLevel(logging.WARNING if quiet else logging.INFO)

    def __enter__(self) -> NoteAndWarningLogHandler:
        USER_MESSAGE_LOGGER.addHandler(self)
        USER_MESSAGE_LOGGER.setLevel(logging.INFO)
        USER_MESSAGE_LOGGER.propagate = False  # compilers of forms set up the root's handlers, too
        return self

    def __exit__(self, *exception: object) -> None:
        USER_MESSAGE_LOGGER.removeHandler(self)
        USER_MESSAGE_LOGGER.setLevel(logging.NOTSET)
        USER_MESSAGE_LOGGER.propagate = True

    def format(self, record: logging.LogRecord) -> str:
        """Return the text of a message; a warning begins with "fenics-crack: warning: "."""
        is_warning = record.levelno >= logging.WARNING
        return f"{'fenics-crack: warning: ' if is_warning else ''}{record.getMessage()}"

    def handleError(self, record: logging.LogRecord) -> None:
        """Raise the error of writing to standard error.

        By default, ``logging`` would print the error.
        """
        raise
