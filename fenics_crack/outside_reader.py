"""A program of its own that reads a strange file: ``outside_reader.py READER FILE HANDED MEMORY
SECONDS MOST``.

READER is a file of Python with ``read(path, most)``, whose arrays, of up to MOST bytes of numbers,
go to the open file of number HANDED, as .npz; or the reason why there are none. What it reads may
crash it, ask for all memory or not end, so MEMORY and SECONDS are limited.
"""

import os
import resource
import runpy
import sys

import numpy as np


def main(reader: str, path: str, handed: int, memory: int, seconds: int, most: int) -> None:
    """Read a file and hand over what it holds."""
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    room = resource.getrlimit(resource.RLIMIT_FSIZE)[1]  # what is handed over lies in memory
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    read = runpy.run_path(reader)["read"]
    try:
        found = read(path, most)
    except Exception as error:  # whatever a damaged file leads a library to
        found = {"error": np.array(str(error) or type(error).__name__)}
    with os.fdopen(handed, "wb") as out:
        np.savez(out, **found)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], *map(int, sys.argv[3:]))
