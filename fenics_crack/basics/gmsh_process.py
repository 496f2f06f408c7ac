"""gmsh, without its hold on Ctrl-C.

Its libraries load in a third of the time where MPI's and DOLFINx's are not there yet: the program
imports this module before them.
"""

from __future__ import annotations

import ctypes
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from fenics_crack.basics.installation import report_missing_libraries


@contextmanager
def keep_interrupt_handler() -> Iterator[None]:
    """Restore the handler of Ctrl-C afterwards: gmsh 4.8 replaces it and leaves it so.

    gmsh also sets it where Python forbids that, in threads other than the main one: left out there.
    """
    handler, set_handler = signal.getsignal(signal.SIGINT), signal.signal

    def set_in_main_thread(number: int, handler: Any) -> Any:
        if threading.current_thread() is threading.main_thread():
            return set_handler(number, handler)
        return signal.getsignal(number)

    signal.signal = set_in_main_thread  # type: ignore[assignment]
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        signal.signal = set_handler


with keep_interrupt_handler(), report_missing_libraries():
    import gmsh as gmsh

with suppress(AttributeError, ValueError):  # FLTK would write its settings, of root into /etc
    ctypes.c_ubyte.in_dll(gmsh.lib, "_ZN2Fl13options_read_E").value = 1
