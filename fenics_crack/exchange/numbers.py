"""Text files of numbers: rows of them, and Matrix Market files, read strictly.

SciPy's reader believes what a file announces: depending on its version it does not end, asks for
all memory, or crashes where the file is damaged. Here no file has more entries than it has bytes
for, and a packed one is unpacked up to a limit that follows from its own size.

Source: Boisvert, Pozo and Remington, The Matrix Market exchange formats, NISTIR 5935, 1996.
"""

from __future__ import annotations

import bz2
import gzip
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse

from fenics_crack.outside import allowance, bytes_of, lines_of

__all__ = ["matrix_market_shape", "numbered_lines", "read_matrix_market", "rows_of"]

SHORTEST = {"coordinate": 4, "array": 2}
"""Bytes of an entry and the end of its line."""
LAYOUTS, FIELDS = ("coordinate", "array"), ("real", "integer", "pattern")
SYMMETRIES = ("general", "symmetric", "skew-symmetric")


def read_matrix_market(path: Path, rows: int | None = None) -> np.ndarray | sparse.csr_matrix:
    """Read a real matrix, dense or sparse as the file is, of ``rows`` rows; .gz and .bz2 too.

    Raises
    ------
    OSError, ValueError
        The file cannot be read, or contradicts itself.
    """
    with _opened(path) as (lines, most):
        (layout, field, symmetry), sizes, entries = _announced(lines, most)
        shape = sizes[0], sizes[1]
        if rows is not None and shape[0] != rows:
            raise ValueError(f"it has {shape[0]} rows instead of {rows}")
        if symmetry != "general" and shape[0] != shape[1]:
            raise ValueError(f"{symmetry}, but of shape {shape}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of an empty body
            body = np.loadtxt(lines, comments="%", ndmin=2, max_rows=entries + 1)
    if layout == "array":
        return _dense(body.ravel(), shape, symmetry)
    if len(body) != entries:
        raise ValueError(f"it has {_count(body, entries)} entries instead of {entries}")
    if max(shape) > max(len(body), rows or 1):
        raise ValueError(f"of shape {shape}, it has only {len(body)} entries")
    return _sparse(body, shape, symmetry, field)


def matrix_market_shape(path: Path) -> tuple[int, int]:
    """Rows and columns that a file announces; sparse columns have an entry each.

    Raises
    ------
    OSError, ValueError
        As :func:`read_matrix_market`.
    """
    with _opened(path) as (lines, most):
        _, sizes, _ = _announced(lines, most)
    if len(sizes) == 3 and sizes[1] > sizes[2]:
        raise ValueError(f"{sizes[1]} columns, but only {sizes[2]} entries")
    return sizes[0], sizes[1]


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Iterator[str], int]]:
    """The lines of a file, and how many bytes they may have."""
    size = bytes_of(path)
    unpack: Any = {".gz": gzip.open, ".bz2": bz2.open}.get(path.suffix)
    most = size if unpack is None else allowance(size)
    with (unpack or open)(path, "rt", encoding="utf-8") as file:
        yield lines_of(file, most), most


def _announced(lines: Iterator[str], most: int) -> tuple[tuple[str, str, str], list[int], int]:
    """Layout, field and symmetry, the numbers of the line with the size, and those of entries."""
    header = _header(next(lines, ""))
    line = next((line for line in lines if line.strip() and not line.startswith("%")), "")
    sizes = [int(word) for word in line.split()]
    if len(sizes) != (3 if header[0] == "coordinate" else 2) or min(sizes) < 0:
        raise ValueError("the line with its size is missing or wrong")
    if len(sizes) == 3:
        entries = sizes[2]
    else:
        entries = _entries(sizes[0], sizes[1], header[2])
    if entries * SHORTEST[header[0]] > most:
        raise ValueError(f"it announces {entries} entries, more than it can hold")
    return header, sizes, entries


def _header(line: str) -> tuple[str, str, str]:
    words = line.lower().split()
    if len(words) != 5 or words[:2] != ["%%matrixmarket", "matrix"]:
        raise ValueError("it does not begin with %%MatrixMarket matrix")
    layout, field, symmetry = words[2:]
    for word, known in ((layout, LAYOUTS), (field, FIELDS), (symmetry, SYMMETRIES)):
        if word not in known:
            raise ValueError(f"{word!r} instead of one of {', '.join(known)}")
    if (layout, field) == ("array", "pattern"):
        raise ValueError("an array without values")
    return layout, field, symmetry


def _entries(rows: int, columns: int, symmetry: str) -> int:
    """Number of entries of a dense file: of a symmetric matrix from the diagonal down."""
    sign = {"symmetric": 1, "skew-symmetric": -1}.get(symmetry)
    return rows * columns if sign is None else rows * (rows + sign) // 2


def _count(found: np.ndarray, expected: int) -> str:
    """Number of entries found, in words; no more are read than one too many."""
    return "more" if len(found) > expected else str(len(found))


def _dense(values: np.ndarray, shape: tuple[int, int], symmetry: str) -> np.ndarray:
    """Columns one after the other; of a symmetric matrix their part from the diagonal down."""
    expected = _entries(*shape, symmetry)
    if len(values) != expected:
        raise ValueError(f"it has {_count(values, expected)} entries instead of {expected}")
    if symmetry == "general":
        return values.reshape(shape, order="F")
    sign = -1 if symmetry == "skew-symmetric" else 1
    matrix = np.zeros(shape)
    columns, rows = np.triu_indices(shape[0], 1 if sign < 0 else 0)
    matrix[columns, rows] = sign * values
    matrix[rows, columns] = values
    return matrix


def _sparse(
    body: np.ndarray, shape: tuple[int, int], symmetry: str, field: str
) -> sparse.csr_matrix:
    """Entries of row, column and value; of a symmetric matrix the lower triangle."""
    width = 2 if field == "pattern" else 3
    if len(body) and body.shape[1] != width:
        raise ValueError(f"its entries have {body.shape[1]} numbers instead of {width}")
    body = body.reshape(-1, width)
    if not np.all((body[:, :2] >= 1) & (body[:, :2] <= shape) & (body[:, :2] % 1 == 0)):
        raise ValueError("an entry lies outside of the matrix")
    rows, columns = body[:, :2].astype(np.int64).T - 1
    values = np.ones(len(body)) if field == "pattern" else body[:, 2]
    if symmetry != "general":
        if np.any(rows < columns):
            raise ValueError(f"{symmetry}, but with entries above the diagonal")
        below = rows > columns
        sign = 1.0 if symmetry == "symmetric" else -1.0
        rows, columns = np.append(rows, columns[below]), np.append(columns, rows[below])
        values = np.append(values, sign * values[below])
    return sparse.csr_matrix((values, (rows, columns)), shape=shape)


def numbered_lines(path: Path, comment: str) -> Iterator[tuple[int, str]]:
    """Lines that hold more than a comment, without it, and their numbers from 1."""
    bytes_of(path)
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, 1):
            if text := line.partition(comment)[0].rstrip():
                yield number, text


def rows_of(path: Path, columns: int, comment: str, delimiter: str | None = None) -> np.ndarray:
    """Rows of so many numbers: (n, columns).

    Raises
    ------
    OSError, ValueError
        The file cannot be read; or the line that is no such row.
    """
    bytes_of(path)
    try:
        rows = np.loadtxt(path, comments=comment, delimiter=delimiter, ndmin=2, encoding="utf-8")
        if rows.shape[1] == columns and len(rows) and np.all(np.isfinite(rows)):
            return rows
    except ValueError:  # its words count other lines than an editor does
        pass
    for number, line in numbered_lines(path, comment):
        try:
            values = [float(word) for word in line.split(delimiter)]
        except ValueError:
            values = []
        if len(values) != columns or not np.all(np.isfinite(values)):
            raise ValueError(f"line {number}: {line[:80]!r} instead of {columns} numbers")
    raise ValueError("it holds no numbers")
