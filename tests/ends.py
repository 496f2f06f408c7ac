"""A process that dies or hangs where :func:`fuzzing.work` would try a case.

Imports nothing that computes: each such process would do so anew.
"""

from __future__ import annotations

import os
import signal
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any


def _dies(*_: Any) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def _hangs(*_: Any) -> None:
    time.sleep(3600.0)


ENDS = {"DEATH": _dies, "TOO LONG": _hangs}


def work(connection: Connection, base: Path, folder: Path) -> None:
    """What :func:`fuzzing.work` does, of a program that dies or hangs."""
    os.setsid()
    folder.mkdir(parents=True, exist_ok=True)
    folder.with_suffix(".log").touch()
    while (request := connection.recv()) is not None:
        connection.send("what")
        ENDS[request[0]]()
