"""Read files that may come from strangers, with limits, and keep out of the working folder.

A library that parses a damaged file may crash, ask for all memory or not end, and data may hide a
script. So :func:`run_reader_for_arrays` lets a separate small program parse the files of gmsh and
HDF5, with limited memory and time, and hand over plain arrays. The program loads the library once,
and reads each file in a copy of its process.
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

MAX_INPUT_FILE_BYTES = 2**31
"""Maximum bytes of a file with a mesh, a matrix or a result, and of the numbers in it."""
HIDDEN_ENVIRONMENT_VARIABLE_PREFIXES = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDRA_", "HDF5_")
"""Prefixes of environment variables that a reader process does not get.

The process is then no rank of MPI, and HDF5 loads no plug-ins.
"""
READER_PROCESS_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "HDF5_PLUGIN_PRELOAD": "::",
}  # fmt: skip
"""Environment variables for a reader process: one thread, no plug-ins."""
READER_PROGRAM_PATH = Path(__file__).with_name("untrusted_reader.py")
REFUSED_ENCODING_BY_BYTE_ORDER_MARK = {
    codecs.BOM_UTF32_LE: "UTF-32", codecs.BOM_UTF32_BE: "UTF-32", codecs.BOM_UTF16_LE: "UTF-16",
    codecs.BOM_UTF16_BE: "UTF-16",
}  # fmt: skip
"""Names of refused encodings by byte order mark, the longer marks first."""
COMMA_NUMBER_PATTERN, POINT_NUMBER_PATTERN = (
    re.compile(rf"[+-]?\d*{mark}\d+(?:[eE][+-]?\d+)?") for mark in (",", r"\.")
)
"""Patterns of numbers with a decimal comma, and with a decimal point."""
FACTOR_BY_HEADING_UNIT_PREFIX = {"": 1.0, "k": 1e3, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6}
"""Factor from a prefixed unit in a heading to the unit."""
SI_UNIT_AND_FACTOR_BY_HEADING_UNIT = {
    "rad": ("rad", 1.0),
    **dict.fromkeys(("deg", "°"), ("rad", math.pi / 180.0)),
    **{
        prefix + unit: (unit, factor)
        for prefix, factor in FACTOR_BY_HEADING_UNIT_PREFIX.items()
        for unit in ("m", "Hz")
    },
}
"""SI unit and factor, by the unit of a heading that is converted."""


@contextmanager
def leave_working_folder() -> Iterator[None]:
    """Work in the folder of Python's modules during a block.

    Libraries look for settings in the working folder. In a stranger's folder, settings may load
    code, run programs or change numbers. After the block the process returns to the earlier folder,
    if this user may enter it.
    """
    working_folder_descriptor = os.open("/proc/self/cwd", os.O_PATH)
    try:
        os.chdir(os.path.dirname(os.__file__))
        yield
    finally:
        with suppress(PermissionError):
            os.fchdir(working_folder_descriptor)
        os.close(working_folder_descriptor)


def regular_file_size(
    path: str | Path, max_bytes: int | None = MAX_INPUT_FILE_BYTES, *, follows_links: bool = True
) -> int:
    """Return the size [byte] of a regular file, or refuse the file.

    Devices and pipes are refused, since they may not end. With ``follows_links=False`` a link is
    refused, too.

    Raises
    ------
    OSError
        The file is missing, refused, or larger than ``max_bytes`` (None: no limit).
    """
    try:
        file_status = os.stat(path, follow_symlinks=follows_links)
    except ValueError as error:  # no name of a file
        raise OSError(str(error)) from None
    if not stat.S_ISREG(file_status.st_mode):
        raise OSError("it is not a regular file, but a folder, link, pipe or device")
    if max_bytes is not None and file_status.st_size > max_bytes:
        raise OSError(f"it has more than {max_bytes} bytes")
    return file_status.st_size


def read_regular_file(
    path: str | Path, max_bytes: int | None = 2**26, *, follows_links: bool = True
) -> bytes:
    """Return the content of a regular file up to ``max_bytes``.

    The default, 64 MiB, suits scenes and tables: a million rows have 40 MiB. With
    ``follows_links=False`` a link is refused.

    Raises
    ------
    OSError
        The file is missing, larger, or no regular file.
    """
    regular_file_size(path, max_bytes, follows_links=follows_links)
    return Path(path).read_bytes()


def read_first_bytes(path: str | Path, n_bytes: int) -> bytes:
    """Return the first ``n_bytes`` of a regular file of any size.

    OSError if the file is missing, or is a device or a pipe.
    """
    regular_file_size(path, None)
    with open(path, "rb") as file:
        return file.read(n_bytes)


@contextmanager
def copy_to_temporary_folder(path: str | Path, copy_name: str) -> Iterator[Path]:
    """Copy a file under another name into an empty temporary folder, during a block.

    Yields the copy's path. OSError if the file is missing, too large, or a device or pipe.
    """
    regular_file_size(path)
    with tempfile.TemporaryDirectory() as folder:
        yield Path(shutil.copyfile(path, Path(folder) / copy_name))


def max_allowed_unpacked_bytes(packed_bytes: int) -> int:
    """Return the maximum allowed size [byte] of a compressed file's content.

    This is 50 times ``packed_bytes``, the size of the compressed file, but at least 16 MiB, and at
    most 2 GiB. For files of this program, the factor is 1 to 10.
    """
    return min(max(2**24, 50 * packed_bytes), MAX_INPUT_FILE_BYTES)


def file_sha256(path: str | Path) -> str:
    """Return the SHA-256 of a regular file up to 2 GiB, in hexadecimal digits.

    OSError if the file is missing, larger, or a device or pipe.
    """
    n_remaining_bytes, hash_object = regular_file_size(path), hashlib.sha256()
    with open(path, "rb") as file:
        while n_remaining_bytes > 0 and (block := file.read(min(n_remaining_bytes, 2**20))):
            hash_object.update(block)
            n_remaining_bytes -= len(block)
    return hash_object.hexdigest()


def read_utf8_text(path: str | Path) -> str:
    """Return the text of a UTF-8 file, with or without a byte order mark.

    Raises
    ------
    OSError
        From :func:`read_regular_file`.
    ValueError
        The file has another encoding.
    """
    content = read_regular_file(path)
    for (
        refused_byte_order_mark,
        refused_encoding_name,
    ) in REFUSED_ENCODING_BY_BYTE_ORDER_MARK.items():
        if content.startswith(refused_byte_order_mark):
            raise ValueError(
                f"it begins with the byte order mark (BOM) of {refused_encoding_name}; save it "
                "as UTF-8"
            )
    return content.decode("utf-8-sig")


def read_numbered_csv_rows(path: str | Path) -> list[tuple[int, list[str]]]:
    """Return line number and cells for each line of a CSV file.

    Cells are separated by commas, semicolons or tabs: the first of these in the headings. Decimal
    commas become points. Empty lines and lines that begin with # are left out. A first column
    without a heading is left out if it numbers the rows from 0.

    Raises
    ------
    OSError
        From :func:`read_utf8_text`.
    ValueError
        The text has another encoding, or a separator or a decimal mark is ambiguous.
    """
    numbered_lines = enumerate(read_utf8_text(path).splitlines(), 1)
    numbered_content_lines = [
        (line_number, line)
        for line_number, line in numbered_lines
        if line.strip()[:1] not in ("", "#")
    ]
    heading_line = (
        re.sub('"[^"]*"', "", numbered_content_lines[0][1]) if numbered_content_lines else ""
    )
    cell_separator = next(
        (cell_separator for cell_separator in ",;\t" if cell_separator in heading_line), ","
    )
    numbered_rows = [
        (line_number, [cell.strip() for cell in next(csv.reader([line], delimiter=cell_separator))])
        for line_number, line in numbered_content_lines
    ]
    numbered_extra_cells = (
        (line_number, cell)
        for line_number, cells in numbered_rows
        for cell in cells[len(numbered_rows[0][1]) :]
    )
    if bad_line_numbers := [
        line_number
        for line_number, cell in numbered_extra_cells
        if re.fullmatch(r"[\d.eE+-]+", cell)
    ]:
        raise ValueError(
            f"line {bad_line_numbers[0]} has more cells than headings; write decimal points, "
            "not commas"
        )
    if [cells[0] for _, cells in numbered_rows] == ["", *map(str, range(len(numbered_rows) - 1))]:
        numbered_rows = [(line_number, cells[1:]) for line_number, cells in numbered_rows]
    point_text_by_comma_cell = _map_decimal_commas_to_points(
        [cell for _, cells in numbered_rows[1:] for cell in cells]
    )
    return [
        (line_number, [point_text_by_comma_cell.get(cell, cell) for cell in cells])
        for line_number, cells in numbered_rows
    ]


def _map_decimal_commas_to_points(cells: Sequence[str]) -> dict[str, str]:
    """Return the cells with a decimal comma, mapped to texts with a decimal point.

    The result is a dict, such as {"0,5": "0.5"}. Cells without a comma are not in it.

    Raises
    ------
    ValueError
        A comma may also separate thousands or cells.
    """
    number_pattern = re.compile(r"[+-]?[\d.,]*\d[\d.,eE+-]*")
    comma_cells = [cell for cell in cells if "," in cell and number_pattern.fullmatch(cell)]
    ambiguous_cells = [cell for cell in comma_cells if not COMMA_NUMBER_PATTERN.fullmatch(cell)]
    ambiguous_cells += [
        cell for cell in cells if comma_cells and POINT_NUMBER_PATTERN.fullmatch(cell)
    ]
    if ambiguous_cells or (
        comma_cells and all(re.fullmatch(r"[+-]?[1-9]\d{0,2},\d{3}", cell) for cell in comma_cells)
    ):
        example_text = " and ".join(sorted({comma_cells[0], *ambiguous_cells[:1]}))
        raise ValueError(
            f"the decimal mark is ambiguous: {example_text}; write decimal points only"
        )
    return {cell: cell.replace(",", ".") for cell in comma_cells}


def convert_heading_to_si(heading: str) -> tuple[str, float]:
    """Convert the unit in a column's heading to SI.

    Returns
    -------
    heading : str
        Heading with the SI unit in brackets at the end; unchanged if the unit is unknown.
    factor : float
        Factor for the column's numbers; 1 if the unit is unknown.
    """
    heading_match = re.fullmatch(r"(.*?)\s*[\[(]\s*([^][()]*?)\s*[])]", heading)
    si_unit, factor = (
        SI_UNIT_AND_FACTOR_BY_HEADING_UNIT.get(heading_match[2], ("", 1.0))
        if heading_match
        else ("", 1.0)
    )
    return f"{heading_match[1]} [{si_unit}]" if heading_match and si_unit else heading, factor


@contextmanager
def open_lines_and_byte_limit(
    path: str | Path, errors: str = "strict"
) -> Iterator[tuple[Iterable[str], int]]:
    """Open a text file by lines; the file may be compressed as .gz or .bz2.

    ``errors`` says how to treat bytes that are not UTF-8, as in ``open``.

    Yields
    ------
    lines : iterable of str
        The lines of the file.
    max_bytes : int
        Maximum size of the lines [byte].

    Raises
    ------
    OSError
        From :func:`regular_file_size`.
    ValueError
        While lines are read: a compressed file has more than ``max_bytes``.
    """
    file_size = regular_file_size(path)
    open_function: Any = {".gz": gzip.open, ".bz2": bz2.open}.get(Path(path).suffix)
    max_bytes = file_size if open_function is None else max_allowed_unpacked_bytes(file_size)
    with (open_function or open)(path, "rt", encoding="utf-8", errors=errors) as file:
        yield (
            file if open_function is None else _yield_lines_up_to_total_length(file, max_bytes),
            max_bytes,
        )


def parse_number_rows(
    lines: Iterable[str],
    comment_mark: str = "#",
    delimiter: str | None = None,
    max_rows: int | None = None,
) -> np.ndarray:
    """Return the numbers in lines of text: (n, columns).

    Parameters are those of ``numpy.loadtxt``, which may raise ValueError.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of no lines
        return np.loadtxt(
            iter(lines), comments=comment_mark, delimiter=delimiter, ndmin=2, max_rows=max_rows
        )


def _yield_lines_up_to_total_length(file: TextIO, max_characters: int) -> Iterator[str]:
    """Yield the lines of an unpacked file.

    ValueError as soon as the lines have more than ``max_characters`` in sum.
    """
    while line := file.readline(max_characters + 1):
        max_characters -= len(line)
        if max_characters < 0:
            raise ValueError(
                "its unpacked text is too large for a packed file of its size; unpack the file"
            )
        yield line


def run_reader_for_arrays(
    reader_file: Path, path: Path, max_seconds: int, base_memory_bytes: int = 2**30, **request: Any
) -> dict[str, np.ndarray] | str:
    """Read a file in a separate process, with limited memory and time, in the file's folder.

    Parameters
    ----------
    reader_file : Path
        Python file with a function ``read(path, max_bytes, **request)``, which returns arrays by
        name.
    path : Path
        File to read.
    max_seconds : int
        Maximum processor time [s]; the wall-clock time may be four times as long.
    base_memory_bytes : int
        Address space [byte] of the process without the arrays. The limit is this plus four times
        the largest allowed size of the arrays. gmsh needs 0.2 GiB, h5py half as much.
    **request
        Further arguments of ``read``, sent as JSON.

    Returns
    -------
    dict or str
        The arrays by name; or a text with the reason why the file cannot be read.

    Raises
    ------
    OSError
        From :func:`regular_file_size`.
    """
    max_array_bytes = max_allowed_unpacked_bytes(regular_file_size(path, None))
    request_entries = {
        "folder": str(path.absolute().parent),
        "path": str(path.absolute()),
        "seconds": max_seconds,
        "wait": 4 * max_seconds,
        "most": max_array_bytes,
        "memory": base_memory_bytes + 4 * max_array_bytes,
        "request": request,
    }
    with os.fdopen(os.memfd_create("numbers"), "w+b") as array_file:  # a disk may be full
        exit_status = _send_request_for_exit_status(
            reader_file, json.dumps(request_entries).encode(), array_file.fileno()
        )
        if exit_status in (-signal.SIGXCPU, -signal.SIGALRM):
            return (
                f"reading it takes more than {max_seconds} s: the file is damaged, or too large; "
                "write it again, or smaller"
            )
        if exit_status:
            return (
                "the program that reads it crashed: the file is damaged, or too large; write it "
                "again, or smaller"
            )
        array_file.seek(0)
        try:
            with np.load(array_file, allow_pickle=False) as npz_arrays:
                array_by_name = dict(npz_arrays)
        except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
            return "the program that reads it returned nothing: the file is damaged; write it again"
    return str(array_by_name["error"]) if "error" in array_by_name else array_by_name


def _send_request_for_exit_status(
    reader_file: Path, request_bytes: bytes, array_file_descriptor: int
) -> int:
    """Send a request to the reader process, and return the exit status of reading.

    A forked copy of the reader process reads the file, while the process waits for further
    requests. If the reader process does not answer, the process is started again once. Without an
    answer the status is 1.

    Parameters
    ----------
    reader_file : Path
        Python file with the function ``read``.
    request_bytes : bytes
        Request as JSON.
    array_file_descriptor : int
        Descriptor of an open file, into which the copy writes the arrays.
    """
    descriptor_message = socket.SOL_SOCKET, socket.SCM_RIGHTS, array("i", [array_file_descriptor])
    for _ in range(2):  # the one that waits may have been killed meanwhile
        reader_socket, answer_bytes = _start_reader(reader_file, os.getpid(), get_ident())[1], b""
        try:
            # PETSc ends the program at a signal of a line that is broken.
            reader_socket.sendmsg([request_bytes], [descriptor_message], socket.MSG_NOSIGNAL)
            answer_bytes = reader_socket.recv(64)
        except OSError:
            continue
        finally:
            if (
                not answer_bytes
            ):  # of one that is interrupted no answer is taken for the next file's
                _start_reader.cache_clear()
        if answer_bytes:
            return int(answer_bytes)
    return 1


@lru_cache
def _start_reader(
    reader_file: Path, process_id: int, thread_id: int
) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """Start a process that reads files with ``reader_file``; return process and socket.

    The socket sends requests to the process, which ends when the socket is closed. The result is
    cached: ``process_id`` and ``thread_id`` give each process and thread of this program its own
    reader.
    """
    environment = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(HIDDEN_ENVIRONMENT_VARIABLE_PREFIXES)
    }
    own_socket, reader_socket = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    reader_descriptor = reader_socket.fileno()
    with reader_socket:
        reader_process = subprocess.Popen(
            [
                sys.executable, "-I", str(READER_PROGRAM_PATH), str(reader_file),
                str(reader_descriptor),
            ],
            env=environment | READER_PROCESS_ENVIRONMENT, pass_fds=[reader_descriptor],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    return reader_process, own_socket
