"""Text files of numbers, and which line of one is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fenics_crack.outside import bytes_of

__all__ = ["numbered_lines", "rows_of"]


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
