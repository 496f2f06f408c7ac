"""Files that may come from strangers: what is read of them is limited before it is read, and what
merely lies in the working folder is not read at all.

A library that parses a damaged file may crash, ask for all memory or not end, and a script language
may hide in what looks like data. So what gmsh and HDF5 parse is parsed by a small program of its
own, :func:`run_reader`, with limited memory and time; it hands over plain arrays. It loads its
library once, and reads each file in a copy of itself.
"""

from __future__ import annotations

import bz2
import codecs
import csv
import gzip
import hashlib
import json
import math
import os
import re
import shutil
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import warnings
import zipfile
from array import array
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from threading import get_ident
from typing import Any, TextIO

import numpy as np

MAX_FILE_BYTES = 2**31
"""Bytes of a file of a mesh, a matrix or a result, and of the numbers in it."""
HIDDEN_VARIABLE_PREFIXES = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDRA_", "HDF5_")
"""Variables that are hidden from a reader: it is no rank, and loads no plug-ins."""
READER_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "HDF5_PLUGIN_PRELOAD": "::",
}  # fmt: skip
READER_PROGRAM = Path(__file__).with_name("untrusted_reader.py")
ENCODING_BY_BYTE_ORDER_MARK = {
    codecs.BOM_UTF32_LE: "UTF-32", codecs.BOM_UTF32_BE: "UTF-32", codecs.BOM_UTF16_LE: "UTF-16",
    codecs.BOM_UTF16_BE: "UTF-16",
}  # fmt: skip
"""Byte order marks, the longer ones first."""
COMMA_NUMBER_PATTERN, POINT_NUMBER_PATTERN = (
    re.compile(rf"[+-]?\d*{mark}\d+(?:[eE][+-]?\d+)?") for mark in (",", r"\.")
)
"""Numbers with a decimal comma, and with a decimal point."""
FACTOR_BY_HEADING_PREFIX = {"": 1.0, "k": 1e3, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6}
SI_UNIT_AND_FACTOR = {"rad": ("rad", 1.0), **dict.fromkeys(("deg", "°"), ("rad", math.pi / 180.0))}
SI_UNIT_AND_FACTOR |= {
    name + unit: (unit, part)
    for name, part in FACTOR_BY_HEADING_PREFIX.items()
    for unit in ("m", "Hz")
}
"""Units of headings that are converted: to which, and the factor."""


@contextmanager
def leave_working_folder() -> Iterator[None]:
    """Leave the working folder for that of Python's own modules while a library looks for settings.

    A stranger's folder may hold some that load code, run programs or change numbers. One that this
    user may not enter, as root's, is left for good.
    """
    here = os.open("/proc/self/cwd", os.O_PATH)
    try:
        os.chdir(os.path.dirname(os.__file__))
        yield
    finally:
        with suppress(PermissionError):
            os.fchdir(here)
        os.close(here)


def regular_file_size(
    path: str | Path, most: int | None = MAX_FILE_BYTES, *, links: bool = True
) -> int:
    """Size of a regular file: neither a device nor a pipe, which need not end; without ``links``
    no link to one either.

    Raises
    ------
    OSError
        There is no such file, or it is larger than ``most``.
    """
    try:
        found = os.stat(path, follow_symlinks=links)
    except ValueError as error:  # no name of a file
        raise OSError(str(error)) from None
    if not stat.S_ISREG(found.st_mode):
        raise OSError("it is not a regular file")
    if most is not None and found.st_size > most:
        raise OSError(f"it has more than {most} bytes")
    return found.st_size


def read_regular_file(path: str | Path, most: int | None = 2**26, *, links: bool = True) -> bytes:
    """Content of a file that is read whole, as a scene or a table, whose million rows have 40 MiB;
    OSError as of :func:`bytes_of`."""
    regular_file_size(path, most, links=links)
    return Path(path).read_bytes()


def read_first_bytes(path: str | Path, count: int) -> bytes:
    """First bytes of a regular file of any size; OSError as of :func:`bytes_of`."""
    regular_file_size(path, None)
    with open(path, "rb") as file:
        return file.read(count)


@contextmanager
def copy_to_temporary_folder(path: str | Path, name: str) -> Iterator[Path]:
    """A copy of a file under another name, alone in a folder; OSError as of :func:`bytes_of`."""
    regular_file_size(path)
    with tempfile.TemporaryDirectory() as folder:
        yield Path(shutil.copyfile(path, Path(folder) / name))


def max_unpacked_bytes(size: int) -> int:
    """Bytes that the content of a compressed file of ``size`` bytes may take: 50 times as many, of
    ours it takes 1 to 10 times; of any file 16 MiB, of which text takes seconds."""
    return min(max(2**24, 50 * size), MAX_FILE_BYTES)


def file_sha256(path: str | Path) -> str:
    """SHA-256 of a regular file; OSError as :func:`bytes_of`."""
    left, total = regular_file_size(path), hashlib.sha256()
    with open(path, "rb") as file:
        while left > 0 and (block := file.read(min(left, 2**20))):
            total.update(block)
            left -= len(block)
    return total.hexdigest()


def read_utf8_text(path: str | Path) -> str:
    """Text of a file in UTF-8, with or without a byte order mark.

    Raises
    ------
    OSError, ValueError
        As of :func:`content_of`; or its text is in another encoding.
    """
    content = read_regular_file(path)
    for mark, name in ENCODING_BY_BYTE_ORDER_MARK.items():
        if content.startswith(mark):
            raise ValueError(
                f"it begins with the byte order mark (BOM) of {name}; save it as UTF-8"
            )
    return content.decode("utf-8-sig")


def read_csv_rows(path: str | Path) -> list[tuple[int, list[str]]]:
    """Lines of a CSV file as their numbers and cells, with decimal points, without empty ones and
    those that begin with #.

    Commas, semicolons or tabs may separate the cells, and numbers may have decimal commas. A first
    column without a heading that numbers the rows from 0 is left out.

    Raises
    ------
    OSError, ValueError
        As :func:`text_of`; or a separator or a decimal mark is ambiguous.
    """
    every = enumerate(read_utf8_text(path).splitlines(), 1)
    lines = [(number, line) for number, line in every if line.strip()[:1] not in ("", "#")]
    heading = re.sub('"[^"]*"', "", lines[0][1]) if lines else ""
    mark = next((mark for mark in ",;\t" if mark in heading), ",")
    rows = [
        (number, [cell.strip() for cell in next(csv.reader([line], delimiter=mark))])
        for number, line in lines
    ]
    beyond = ((number, cell) for number, cells in rows for cell in cells[len(rows[0][1]) :])
    if more := [number for number, cell in beyond if re.fullmatch(r"[\d.eE+-]+", cell)]:
        raise ValueError(f"line {more[0]} has more cells than headings; use decimal points")
    if [cells[0] for _, cells in rows] == ["", *map(str, range(len(rows) - 1))]:
        rows = [(number, cells[1:]) for number, cells in rows]
    point = _replace_decimal_commas([cell for _, cells in rows[1:] for cell in cells])
    return [(number, [point.get(cell, cell) for cell in cells]) for number, cells in rows]


def _replace_decimal_commas(cells: Sequence[str]) -> dict[str, str]:
    """Return numbers with decimal commas by cells that have them; ValueError where a comma may be
    another mark."""
    number = re.compile(r"[+-]?[\d.,]*\d[\d.,eE+-]*")
    commas = [cell for cell in cells if "," in cell and number.fullmatch(cell)]
    odd = [cell for cell in commas if not COMMA_NUMBER_PATTERN.fullmatch(cell)]
    odd += [cell for cell in cells if commas and POINT_NUMBER_PATTERN.fullmatch(cell)]
    if odd or (commas and all(re.fullmatch(r"[+-]?[1-9]\d{0,2},\d{3}", cell) for cell in commas)):
        pair = " and ".join(sorted({commas[0], *odd[:1]}))
        raise ValueError(f"the decimal mark is ambiguous: {pair}; use points alone")
    return {cell: cell.replace(",", ".") for cell in commas}


def convert_heading_to_si(heading: str) -> tuple[str, float]:
    """Return a heading with the unit in brackets at its end to which it is converted, and the
    factor of the numbers below; other units stay."""
    parts = re.fullmatch(r"(.*?)\s*[\[(]\s*([^][()]*?)\s*[])]", heading)
    unit, factor = SI_UNIT_AND_FACTOR.get(parts[2], ("", 1.0)) if parts else ("", 1.0)
    return f"{parts[1]} [{unit}]" if parts and unit else heading, factor


@contextmanager
def open_text_lines(
    path: str | Path, errors: str = "strict"
) -> Iterator[tuple[Iterable[str], int]]:
    """The lines of a large file of text, as of a matrix, which may be packed (.gz, .bz2), and how
    many bytes they have at most.

    Raises
    ------
    OSError, ValueError
        As of :func:`bytes_of`; or, while lines are taken, unpacked it is too large for its size.
    """
    size = regular_file_size(path)
    unpack: Any = {".gz": gzip.open, ".bz2": bz2.open}.get(Path(path).suffix)
    most = size if unpack is None else max_unpacked_bytes(size)
    with (unpack or open)(path, "rt", encoding="utf-8", errors=errors) as file:
        yield file if unpack is None else _yield_limited_lines(file, most), most


def parse_number_rows(
    lines: Iterable[str], comment: str = "#", delimiter: str | None = None, most: int | None = None
) -> np.ndarray:
    """The numbers in some lines, or in ``most`` of them: (n, columns); ValueError."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of no lines
        return np.loadtxt(
            iter(lines), comments=comment, delimiter=delimiter, ndmin=2, max_rows=most
        )


def _yield_limited_lines(file: TextIO, most: int) -> Iterator[str]:
    """Lines of a file that is unpacked while it is read; ValueError where there are too many."""
    while line := file.readline(most + 1):
        most -= len(line)
        if most < 0:
            raise ValueError("unpacked it is too large for its size")
        yield line


def run_reader(
    reader: Path, path: Path, seconds: int, memory: int = 2**30, **request: Any
) -> dict[str, np.ndarray] | str:
    """Let a program of its own read a file (:mod:`fenics_crack.basics.untrusted_reader`).

    Its processor time [s] and its address space [bytes] are limited: ``memory``, and four times
    what its arrays may take. gmsh needs 0.2 GiB, h5py half of it. Its function ``read`` takes
    ``request`` (JSON) as keyword arguments.

    Returns
    -------
    dict or str
        The arrays; or why there are none, their array ``error``.
    """
    most = max_unpacked_bytes(regular_file_size(path, None))
    asked = {"folder": os.getcwd(), "path": str(path), "seconds": seconds, "wait": 4 * seconds}
    asked |= {"most": most, "memory": memory + 4 * most, "request": request}
    with os.fdopen(os.memfd_create("numbers"), "w+b") as handed:  # a disk may be full
        ended = _send_request(reader, json.dumps(asked).encode(), handed.fileno())
        if ended in (-signal.SIGXCPU, -signal.SIGALRM):
            return f"it is not read in {seconds} s"
        if ended:
            return "it crashes its reader"
        handed.seek(0)
        try:
            with np.load(handed, allow_pickle=False) as arrays:
                found = dict(arrays)
        except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
            return "its reader has handed over nothing"
    return str(found["error"]) if "error" in found else found


def _send_request(reader: Path, words: bytes, handed: int) -> int:
    """Return the exit status of a copy of a reader; the reader waits for the next file."""
    rights = socket.SOL_SOCKET, socket.SCM_RIGHTS, array("i", [handed])
    for _ in range(2):  # the one that waits may have been killed meanwhile
        line, answer = _start_reader(reader, os.getpid(), get_ident())[1], b""
        try:
            # PETSc ends the program at a signal of a line that is broken.
            line.sendmsg([words], [rights], socket.MSG_NOSIGNAL)
            answer = line.recv(64)
        except OSError:
            continue
        finally:
            if not answer:  # of one that is interrupted no answer is taken for the next file's
                _start_reader.cache_clear()
        if answer:
            return int(answer)
    return 1


@lru_cache
def _start_reader(
    reader: Path, process: int, thread: int
) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """A reader, one for each process and thread that asks, and the line to it; it ends when this is
    closed."""
    inner = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(HIDDEN_VARIABLE_PREFIXES)
    }
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        started = subprocess.Popen(
            [sys.executable, "-I", str(READER_PROGRAM), str(reader), str(theirs.fileno())],
            env=inner | READER_ENVIRONMENT, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    return started, ours
