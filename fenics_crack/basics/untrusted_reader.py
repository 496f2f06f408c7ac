"""Read strange files in a program of its own: ``untrusted_reader.py READER SOCKET``.

READER is a Python file with ``read(path, max_bytes)``; its libraries are loaded once. SOCKET is the
number of an open socket, at which requests arrive. A copy of this process (fork) reads each
requested file. Arrays with up to ``max_bytes`` bytes of numbers, or the reason for an error, go as
.npz to the file that comes with the request. A strange file may crash the copy, ask for all memory
or not end, so memory and times are limited. The answer at the socket is the copy's exit status.
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


def serve_requests(reader_file: str, request_socket: socket.socket) -> None:
    """Wait for requests, and read a file for each in a forked copy of this process.

    The function returns when the socket is closed.

    Parameters
    ----------
    reader_file : str
        Python file with the function ``read``.
    request_socket : socket
        Socket from which requests come, and to which the copy's exit status is sent.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the program that asks
    end_with_parent()
    with contextlib.suppress(Exception):  # what fails now fails again in the copy
        runpy.run_path(reader_file)
    while True:
        request_bytes, array_file_descriptors, *_ = socket.recv_fds(request_socket, 2**16, 1)
        if not request_bytes:
            return
        copy_process_id = os.fork()
        if copy_process_id == 0:
            exit_status = 1
            try:
                end_with_parent()
                request_socket.close()  # no file answers for the next one
                read_requested_file(
                    reader_file, array_file_descriptors[0], json.loads(request_bytes)
                )
                exit_status = 0
            finally:
                os._exit(exit_status)
        os.close(array_file_descriptors[0])
        request_socket.send(
            str(os.waitstatus_to_exitcode(os.waitpid(copy_process_id, 0)[1])).encode()
        )


def end_with_parent() -> None:
    """Let Linux kill this process as soon as the parent process ends."""
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def set_resource_limit(resource_number: int, soft_limit: int, margin: int = 0) -> None:
    """Set a soft limit for a resource of this process, and a hard limit higher by ``margin``.

    The system signals at the soft limit, and kills the process at the hard limit. Neither limit
    exceeds the earlier hard limit. ``resource_number`` is a constant such as
    ``resource.RLIMIT_CPU``.
    """
    hard_limit = resource.getrlimit(resource_number)[1]
    if not 0 <= hard_limit <= soft_limit + margin:  # infinity may be negative
        hard_limit = soft_limit + margin
    resource.setrlimit(resource_number, (min(soft_limit, max(hard_limit - margin, 1)), hard_limit))


def read_requested_file(
    reader_file: str, array_file_descriptor: int, request_entries: dict
) -> None:
    """Limit this process's memory and time, read a file, and write the arrays.

    If the file cannot be read, the only array is "error" with the reason.

    Parameters
    ----------
    reader_file : str
        Python file with the function ``read``, which returns arrays by name.
    array_file_descriptor : int
        Descriptor of an open file, into which the arrays are written as .npz.
    request_entries : dict
        File to read, limits of memory and time, and further arguments of ``read``. The entries are
        made by :func:`fenics_crack.basics.untrusted_files.run_reader_for_arrays`.
    """
    os.chdir(request_entries["folder"])
    signal.alarm(request_entries["wait"])
    set_resource_limit(resource.RLIMIT_AS, request_entries["memory"])
    set_resource_limit(resource.RLIMIT_FSIZE, sys.maxsize)  # what is handed over lies in memory
    set_resource_limit(resource.RLIMIT_CPU, request_entries["seconds"], 1)
    read_function = runpy.run_path(reader_file)["read"]
    try:
        array_by_name = read_function(
            request_entries["path"], request_entries["most"], **request_entries["request"]
        )
    except Exception as error:  # whatever a damaged file leads a library to
        array_by_name = {"error": np.array(str(error) or type(error).__name__)}
    with os.fdopen(array_file_descriptor, "wb") as array_file:
        np.savez(array_file, **array_by_name)


if __name__ == "__main__":
    serve_requests(sys.argv[1], socket.socket(fileno=int(sys.argv[2])))
    os._exit(0)  # what is loaded needs no taking apart
