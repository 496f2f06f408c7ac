"""The stages of a long computation, told to whoever listens while they begin.

The library calls :func:`begin` where something starts that takes seconds with a large mesh. Without
a listener nothing happens; the program's console is one (:class:`StageLines`).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["StageLines", "begin", "listening", "within"]

LONG = 1.0
"""Stages are told after their end, with their time, if they took longer [s]."""
_listeners: list[Callable[[str], None]] = []
_parts: list[str] = []


def begin(stage: str) -> None:
    """Tell what is done from now on; "" ends a stage where a progress bar goes on."""
    told = ": ".join([*_parts, stage]) if stage else ""
    for listener in _listeners:
        listener(told)


@contextmanager
def within(part: str) -> Iterator[None]:
    """Tell stages as those of a part: "16 modes: natural modes"."""
    _parts.append(part)
    try:
        yield
    finally:
        _parts.pop()


@contextmanager
def listening(listener: Callable[[str], None]) -> Iterator[None]:
    """Call a function with the name of each stage that begins, and with "" at the end."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)
        listener("")


class StageLines:
    """Shows the stage that is being done on a terminal, and keeps a line of each long one.

    Parameters
    ----------
    stream : text stream
        Standard error.
    indent : str
        Before the lines.
    """

    def __init__(self, stream: Any = None, indent: str = "  ") -> None:
        self._stream = stream or sys.stderr
        self._live, self._indent = bool(self._stream.isatty()), indent
        self._stage, self._began = "", 0.0

    def __call__(self, stage: str) -> None:
        """End the stage before, and begin this one."""
        now = time.perf_counter()
        if self._stage:
            self._write("\r\033[K" if self._live else "")
            if now - self._began > LONG:
                self._write(f"{self._indent}{self._stage}: {now - self._began:.1f} s\n")
        self._stage, self._began = stage, now
        if stage and self._live:
            self._write(f"{self._indent}{stage} ...")

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()
