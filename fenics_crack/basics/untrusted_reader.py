"""A program of its own that reads strange files: ``untrusted_reader.py READER SOCKET``.

READER is a file of Python with ``read(path, most)``; its libraries are loaded once. Each file that
is requested at the open socket of number SOCKET is read by a copy of this process (fork): arrays of
up to MOST bytes of numbers go to the file that is handed over, as .npz; or the reason why there are
none. What is read may crash the copy, ask for all memory or not end, so its memory and its times
are limited. The answer is how it ended.
"""

import contextlib
import ctypes
import json
import os
import resource
import runpy
import signal
import socket
import sys

import numpy as np


def serve_requests(reader: str, line: socket.socket) -> None:
    """Have files read until nobody asks any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the program that asks
    end_with_parent()
    with contextlib.suppress(Exception):  # what fails now fails again in the copy
        runpy.run_path(reader)
    while True:
        words, handed, *_ = socket.recv_fds(line, 2**16, 1)
        if not words:
            return
        copy = os.fork()
        if copy == 0:
            end = 1
            try:
                end_with_parent()
                line.close()  # no file answers for the next one
                read_requested_file(reader, handed[0], json.loads(words))
                end = 0
            finally:
                os._exit(end)
        os.close(handed[0])
        line.send(str(os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1])).encode())


def end_with_parent() -> None:
    """Let the system kill this process when the one that started it has ended (Linux)."""
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def set_resource_limit(kind: int, soft_limit: int, margin: int = 0) -> None:
    """Set a soft limit of this process, and the hard one at which it is killed, up to its own."""
    hard_limit = resource.getrlimit(kind)[1]
    if not 0 <= hard_limit <= soft_limit + margin:  # infinity may be negative
        hard_limit = soft_limit + margin
    resource.setrlimit(kind, (min(soft_limit, max(hard_limit - margin, 1)), hard_limit))


def read_requested_file(reader: str, handed: int, asked: dict) -> None:
    """Read a file, and hand over what it holds."""
    os.chdir(asked["folder"])
    signal.alarm(asked["wait"])
    set_resource_limit(resource.RLIMIT_AS, asked["memory"])
    set_resource_limit(resource.RLIMIT_FSIZE, sys.maxsize)  # what is handed over lies in memory
    set_resource_limit(resource.RLIMIT_CPU, asked["seconds"], 1)
    read = runpy.run_path(reader)["read"]
    try:
        found = read(asked["path"], asked["most"], **asked["request"])
    except Exception as error:  # whatever a damaged file leads a library to
        found = {"error": np.array(str(error) or type(error).__name__)}
    with os.fdopen(handed, "wb") as out:
        np.savez(out, **found)


if __name__ == "__main__":
    serve_requests(sys.argv[1], socket.socket(fileno=int(sys.argv[2])))
    os._exit(0)  # what is loaded needs no taking apart
