"""The stages of a long computation, reported to listeners while they begin.

The library calls :func:`begin` where something starts that takes seconds with a large mesh. Without
a listener nothing happens; the program's console is one (:class:`StageLines`).
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

LONG = 1.0
"""Minimum time of a stage that is reported again after its end [s]."""
BEAT = 5.0
"""Time between progress messages [s]."""
_listeners: list[Callable[[str], None]] = []
_parts: list[str] = []
_reached: list[Callable[[], str]] = []


def begin(stage: str) -> None:
    """Report what is done from now on; "" ends a stage where a progress bar goes on."""
    text = ": ".join([*_parts, stage]) if stage else ""
    for listener in _listeners:
        listener(text)


@contextmanager
def within(part: str) -> Iterator[None]:
    """Report stages as those of a part: "16 modes: natural modes"."""
    _parts.append(part)
    try:
        yield
    finally:
        _parts.pop()


@contextmanager
def reaching(how_far: Callable[[], str]) -> Iterator[None]:
    """Add to signs of life how far something has come: "38% of 780 to 880 Hz, 120 points"."""
    _reached.append(how_far)
    try:
        yield
    finally:
        _reached.pop()


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
    """Shows the stage that is being done, with a sign of life every :data:`BEAT` seconds.

    On a terminal the stage is shown while it is being done; elsewhere a sign of life is a line.

    Parameters
    ----------
    stream : text stream
        Standard error.
    kept : bool
        Keep a line of each long stage; else only signs of life are shown.
    """

    def __init__(self, stream: Any = None, *, kept: bool = True) -> None:
        self._stream = stream or sys.stderr
        self._live, self._kept = bool(self._stream.isatty()), kept
        self._stage, self._began = "", 0.0
        self._writing, self._over = threading.Lock(), threading.Event()

    def __call__(self, stage: str) -> None:
        """End the stage before, and begin this one."""
        now = time.perf_counter()
        with self._writing:
            before, self._stage = self._stage, stage
            if before:
                self._write("\r\033[K" if self._live else "")
                if self._kept and now - self._began > LONG:
                    self._write(f"  {before}: {now - self._began:.1f} s\n")
            self._began = now
            if stage and self._live:
                self._write(f"  {stage} ...")
        if stage and not before:
            self._over = threading.Event()
            threading.Thread(target=self._live_on, args=(self._over,), daemon=True).start()
        elif before and not stage:
            self._over.set()

    def _live_on(self, over: threading.Event) -> None:
        """Print every few seconds the current stage and its time."""
        while not over.wait(BEAT):
            with self._writing:
                said = f"  {self._stage} ... {time.perf_counter() - self._began:.0f} s"
                said = ", ".join([said, *(how_far() for how_far in _reached)])
                if self._stage:
                    self._write(f"\r\033[K{said}" if self._live else f"{said}\n")

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()
