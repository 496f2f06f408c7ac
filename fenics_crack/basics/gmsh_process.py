"""Import gmsh and keep Python's handler of Ctrl-C.

The program imports this module first: before the libraries of MPI and DOLFINx, those of gmsh load
in a third of the time.
"""

from __future__ import annotations

import ctypes
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from fenics_crack.basics.machine import report_missing_libraries


@contextmanager
def keep_interrupt_handler() -> Iterator[None]:
    """Keep Python's handler of Ctrl-C although gmsh replaces it in the block.

    The handler is restored after the block. In a thread other than the main thread, Python forbids
    to set a handler, and gmsh's replacement has no effect.
    """
    interrupt_handler, original_signal_function = signal.getsignal(signal.SIGINT), signal.signal

    def set_handler_in_main_thread(signal_number: int, handler: Any) -> Any:
        """Set a signal handler, in the main thread only; return the earlier handler."""
        if threading.current_thread() is threading.main_thread():
            return original_signal_function(signal_number, handler)
        return signal.getsignal(signal_number)

    signal.signal = set_handler_in_main_thread  # type: ignore[assignment]
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, interrupt_handler)
        signal.signal = original_signal_function


with keep_interrupt_handler(), report_missing_libraries():
    import gmsh as gmsh

with suppress(AttributeError, ValueError):  # FLTK would write its settings, of root into /etc
    ctypes.c_ubyte.in_dll(gmsh.lib, "_ZN2Fl13options_read_E").value = 1
