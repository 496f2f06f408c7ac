"""A periodic load of any form as a mean and harmonics.

Between samples, at equal or unequal times, the load is linear; two samples of one time are a jump.
The coefficients of a period T, w = 2 pi / T, are then exact,

    c_k = 2/T int f exp(i k w t) dt,      k = 1 .. K,

by parts over each stretch, and by Parseval's theorem so is what K harmonics leave out of it,

    error^2 = 1 - sum_k |c_k|^2 / 2 / (mean square of f less its mean).
"""

from __future__ import annotations

import numpy as np

from fenics_crack.basics.errors import MOST_HARMONICS, InputError, check_count, reading
from fenics_crack.basics.untrusted_files import table_rows
from fenics_crack.model.matrices import numbers
from fenics_crack.numerics.fourier import from_complex


def load_harmonics(time: object, values: object, harmonics: int) -> tuple[np.ndarray, float]:
    """Return the mean and the harmonics of a periodic load given at some times, and what they leave
    out of it.

    Parameters
    ----------
    time : (n,)
        Ascending, in any unit, from the beginning of a period to its end; two equal ones are a
        jump.
    values : (n,) or (n, m)
        The load then, linear in between.
    harmonics : int
        K.

    Returns
    -------
    coefficients : (2K+1,) or (2K+1, m)
        Mean, and cosine and sine of each order.
    error : float
        Root mean square of what is left out, relative to that of what changes in time.

    Raises
    ------
    InputError
        The times do not ascend, or the arrays do not fit.

    Examples
    --------
    >>> square, error = fc.load_harmonics([0.0, 0.5, 0.5, 1.0], [1.0, 1.0, -1.0, -1.0], 9)
    >>> sine = square[2::2]
    """
    at, found = numbers(time), numbers(values)
    check_count("harmonics", harmonics, 1, MOST_HARMONICS)
    ascending = at.ndim == 1 and len(at) > 1 and np.all(np.isfinite(at)) and at[-1] > at[0]
    if not ascending or np.any(np.diff(at) < 0.0):
        raise InputError("time", time, "two or more ascending numbers, of a whole period")
    if found.ndim not in (1, 2) or len(found) != len(at) or not np.all(np.isfinite(found)):
        raise InputError("values", np.shape(values), f"finite, ({len(at)},) or ({len(at)}, m)")
    columns = found.reshape(len(at), -1)
    phase = 2.0 * np.pi * (at - at[0]) / (at[-1] - at[0])
    length, rise = np.diff(phase)[:, None], np.diff(columns, axis=0)
    begin, end = columns[:-1], columns[1:]
    mean = np.sum(length * (begin + end), axis=0) / (4.0 * np.pi)
    square = np.sum(length * (begin**2 + begin * end + end**2), axis=0) / (6.0 * np.pi)
    slope = np.divide(rise, length, out=np.zeros_like(rise), where=length > 0.0)
    rows = [mean.astype(complex)]
    for order in range(1, harmonics + 1):
        turn = np.exp(1j * order * phase)[:, None]
        # int f e = [f e / (i k)] + slope [e] / k^2 over each stretch
        change = (end * turn[1:] - begin * turn[:-1]) / (1j * order)
        change = np.where(length > 0.0, change, 0.0)
        whole = np.sum(change + slope * np.diff(turn, axis=0) / order**2, axis=0)
        rows.append(np.conj(whole) / np.pi)
    coefficients = from_complex(np.array(rows))
    moving = float(np.sum(square - mean**2))
    kept = 0.5 * float(np.sum(coefficients[1:] ** 2))
    error = float(np.sqrt(max(0.0, 1.0 - kept / moving))) if moving > 0.0 else 0.0
    return coefficients.reshape(2 * harmonics + 1, *found.shape[1:]), error


def read_wave(key: str, path: str, harmonics: int, dimension: int) -> tuple[np.ndarray, float]:
    """:func:`load_harmonics` of a table with a column of times and one for each component of a
    force [N], words in its first line: (2K+1, dimension).

    Raises
    ------
    InputError
        The file cannot be read, or is no such table.
    """
    allowed = f"a CSV file with a line of words, then rows of a time and {dimension} forces [N]"
    with reading(key, path, allowed):
        table = np.array([[float(cell) for cell in cells] for _, cells in table_rows(path)[1:]])
    if table.ndim != 2 or table.shape[1] != dimension + 1:
        raise InputError(key, path, allowed)
    try:
        return load_harmonics(table[:, 0], table[:, 1:], harmonics)
    except InputError as error:
        raise InputError(key, f"{path} ({error.key})", f"{allowed}; {error.allowed}") from None
