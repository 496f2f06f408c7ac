"""A periodic load of any form as a mean and harmonics.

Between samples, at equal or unequal times, the load is linear. Two samples at one time are a jump.
The coefficients with period T, w = 2 pi / T, are exact:

    c_k = 2/T int f exp(i k w t) dt,      k = 1 .. K

Each interval is integrated by parts. By Parseval's theorem, the error of K harmonics is exact, too:

    error^2 = 1 - sum_k |c_k|^2 / 2 / (mean square of f less its mean)
"""

from __future__ import annotations

import numpy as np

from fenics_crack.basics.errors import (
    MAX_HARMONIC_ORDER,
    InputError,
    check_count,
    report_read_errors,
)
from fenics_crack.basics.untrusted_files import read_numbered_csv_rows
from fenics_crack.model.matrices import floats_or_single_nan
from fenics_crack.numerics.fourier import from_complex


def load_harmonics(time: object, values: object, harmonics: int) -> tuple[np.ndarray, float]:
    """Return mean and harmonics of a periodic load, and their error.

    Parameters
    ----------
    time : (n,)
        Ascending, in any unit, from the beginning of a period to its end; two equal times are a
        jump.
    values : (n,) or (n, m)
        Load at these times, linear in between; m columns for several components.
    harmonics : int
        Number K of harmonics, 1 to 100.

    Returns
    -------
    coefficients : (2K+1,) or (2K+1, m)
        Mean, then cosine and sine part of each order 1 to K.
    error : float
        Root mean square of the load's rest beyond harmonic K, relative to the load's root mean
        square without mean.

    Raises
    ------
    InputError
        The times do not ascend, or the arrays do not fit.

    Examples
    --------
    >>> square, error = fc.load_harmonics([0.0, 0.5, 0.5, 1.0], [1.0, 1.0, -1.0, -1.0], 9)
    >>> sine = square[2::2]
    """
    instants, load_samples = floats_or_single_nan(time), floats_or_single_nan(values)
    check_count("harmonics", harmonics, 1, MAX_HARMONIC_ORDER)
    are_sample_times_valid = (
        instants.ndim == 1
        and len(instants) > 1
        and np.all(np.isfinite(instants))
        and instants[-1] > instants[0]
    )
    if not are_sample_times_valid or np.any(np.diff(instants) < 0.0):
        raise InputError(
            "time", time, "two or more ascending times [s], from the first to the last of a period"
        )
    if (
        load_samples.ndim not in (1, 2)
        or len(load_samples) != len(instants)
        or not np.all(np.isfinite(load_samples))
    ):
        raise InputError(
            "values",
            np.shape(values),
            f"finite numbers ({len(instants)},) or ({len(instants)}, m), one row per time",
        )
    sample_columns = load_samples.reshape(len(instants), -1)
    sample_phases = 2.0 * np.pi * (instants - instants[0]) / (instants[-1] - instants[0])
    interval_phase_lengths, value_steps = (
        np.diff(sample_phases)[:, None],
        np.diff(sample_columns, axis=0),
    )
    interval_start_values, interval_end_values = sample_columns[:-1], sample_columns[1:]
    mean = np.sum(
        interval_phase_lengths * (interval_start_values + interval_end_values), axis=0
    ) / (4.0 * np.pi)
    interval_square_sums = (
        interval_start_values**2
        + interval_start_values * interval_end_values
        + interval_end_values**2
    )
    mean_squares = np.sum(interval_phase_lengths * interval_square_sums, axis=0) / (6.0 * np.pi)
    interval_slopes = np.divide(
        value_steps,
        interval_phase_lengths,
        out=np.zeros_like(value_steps),
        where=interval_phase_lengths > 0.0,
    )
    complex_coefficient_rows = [mean.astype(complex)]
    for harmonic_order in range(1, harmonics + 1):
        positive_exponentials_at_phases = np.exp(1j * harmonic_order * sample_phases)[:, None]
        # int f e = [f e / (i k)] + slope [e] / k^2 over each interval
        boundary_term = (
            interval_end_values * positive_exponentials_at_phases[1:]
            - interval_start_values * positive_exponentials_at_phases[:-1]
        ) / (1j * harmonic_order)
        boundary_term = np.where(interval_phase_lengths > 0.0, boundary_term, 0.0)
        fourier_integral = np.sum(
            boundary_term
            + interval_slopes
            * np.diff(positive_exponentials_at_phases, axis=0)
            / harmonic_order**2,
            axis=0,
        )
        complex_coefficient_rows.append(np.conj(fourier_integral) / np.pi)
    coefficients = from_complex(np.array(complex_coefficient_rows))
    variance = float(np.sum(mean_squares - mean**2))
    variance_of_kept_harmonics = 0.5 * float(np.sum(coefficients[1:] ** 2))
    truncation_error = (
        float(np.sqrt(max(0.0, 1.0 - variance_of_kept_harmonics / variance)))
        if variance > 0.0
        else 0.0
    )
    return coefficients.reshape(2 * harmonics + 1, *load_samples.shape[1:]), truncation_error


def read_load_harmonics_and_error(
    key: str, path: str, harmonics: int, dimension: int
) -> tuple[np.ndarray, float]:
    """Read a CSV table of a periodic force, and return its harmonics.

    The first line has headings. Each further line has a time [s] and ``dimension`` components of
    the force [N].

    Parameters
    ----------
    key : str
        Scene key, named in error messages.
    path : str
        The file.
    harmonics : int
        Number K of harmonics to return.
    dimension : int
        Number of force components.

    Returns
    -------
    coefficients : (2K+1, dimension) [N]
        Mean, then cosine and sine part of each order 1 to K.
    error : float
        Error of the truncated series, as :func:`load_harmonics` returns.

    Raises
    ------
    InputError
        The file cannot be read, or is no such table.
    """
    requirement = f"a CSV file with a line of headings, then rows: time [s], {dimension} forces [N]"
    with report_read_errors(key, path, requirement):
        table = np.array(
            [[float(cell) for cell in cells] for _, cells in read_numbered_csv_rows(path)[1:]]
        )
    if table.ndim != 2 or table.shape[1] != dimension + 1:
        raise InputError(key, path, requirement)
    try:
        return load_harmonics(table[:, 0], table[:, 1:], harmonics)
    except InputError as error:
        raise InputError(key, f"{path} ({error.key})", f"{requirement}; {error.allowed}") from None
