"""Measured frequency responses in universal files, and their natural frequencies.

Programs for modal tests write universal files. Dataset 58, "function at nodal DOF", is text.
Dataset 58b has the same eleven lines, then binary numbers (Structural Dynamics Research
Laboratory, University of Cincinnati, keeps SDRC's description of the format). All functions of
type 4, frequency response functions, are read; other datasets are left out.

Let H_j be the receptances, displacements over a force. Around each peak in the sum over all
responses, a mode and its neighbours' residuals p_j, q_j are fitted by least squares,

    H_j(w) (a + i b r - r^2) = p_j + q_j (r - 1),        r = w / w_peak.

All responses share a and b. The frequency is w_peak sqrt(a), the damping ratio b / (2 sqrt(a)) (C.
K. Sanathanan and J. Koerner, IEEE Transactions on Automatic Control 8, 1963, 56: weights by the
last denominator).

With a breathing crack, the first harmonic over the force is the response of a nonlinear structure.
Without clearance or a steady load it does not depend on the force. Near a resonance the response is
nearly the response of a linear mode with the resonance frequency. To estimate the difference, each
peak is fitted twice: down to a tenth of its power, and down to half. The change of the frequency is
added to its standard deviation.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from scipy.signal import find_peaks

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.tables import RAD_PER_TURN
from fenics_crack.basics.untrusted_files import MAX_INPUT_FILE_BYTES, read_regular_file

UNIVERSAL_DATASET_BORDER_LINE = b"-1"
"""Line at the beginning and the end of each dataset in a universal file."""
NUMPY_TYPE_BY_COMPLEX_NUMBER_CODE = {5: "f4", 6: "f8"}
"""NumPy type of real and imaginary parts, by the file's code for complex numbers.

5: single precision, 6: double precision.
"""
NUMBER_WITH_OPTIONAL_E_PATTERN = re.compile(
    rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:E[+-]?\d+|[+-]\d{3}(?![\d.]))?"
)
"""Pattern of a number in text; Fortran leaves out the E before exponents of three digits."""
TIME_DERIVATIVE_ORDER_BY_MOTION_CODE = {8: 0, 11: 1, 12: 2}
"""Time derivatives of the displacement by the file's code for the motion.

8: displacement, 11: velocity, 12: acceleration.
"""


@dataclass(frozen=True)
class FrequencyResponse:
    """Measured motion over the exciting force, at rising frequencies.

    Attributes
    ----------
    frequencies : (n,) [Hz]
        Frequencies in ascending order.
    response_values : (n,) complex
        Motion over force.
    derivative_order : int
        Kind of motion: 0 for a displacement, 1 for a velocity, 2 for an acceleration.
    """

    frequencies: np.ndarray
    response_values: np.ndarray
    derivative_order: int


def read_responses(path: Path) -> list[FrequencyResponse]:
    """Read the frequency responses in a universal file (datasets 58 and 58b).

    Raises
    ------
    OSError, ValueError
        The file cannot be read, is damaged, or has no frequency response.
    """
    responses = []
    for header_lines, number_bytes, byte_order in _iterate_response_datasets(
        BytesIO(read_regular_file(path, MAX_INPUT_FILE_BYTES))
    ):
        header_line_texts = [header_line.decode("latin-1") for header_line in header_lines]
        if int(header_line_texts[6][:5]) == 4:  # frequency response functions
            responses.append(_parse_response(header_line_texts, number_bytes, byte_order))
    if not responses:
        raise ValueError("it has no frequency response: no dataset 58 with a function of type 4")
    return responses


def _iterate_response_datasets(universal_file: BytesIO) -> Iterator[tuple[list[bytes], bytes, str]]:
    """Yield the datasets 58 and 58b of a universal file.

    Yields
    ------
    heading_lines : list of bytes
        Line with the dataset's number, and the eleven heading lines.
    number_bytes : bytes
        Numbers of the dataset, as text or binary.
    byte_order : str
        Byte order of binary numbers, "<" or ">"; "" for text.
    """
    while file_line := universal_file.readline():
        if file_line.strip() != UNIVERSAL_DATASET_BORDER_LINE:
            continue
        dataset_number_line, byte_order, number_bytes = universal_file.readline().rstrip(), "", b""
        is_dataset_58 = dataset_number_line[:6].strip() == b"58"
        heading_lines = [
            dataset_number_line,
            *(universal_file.readline().rstrip() for _ in range(11 * is_dataset_58)),
        ]
        if is_dataset_58 and dataset_number_line[6:7].lower() == b"b":
            byte_order = {1: "<", 2: ">"}[int(dataset_number_line[7:13])]
            n_bytes = int(dataset_number_line[31:43].strip() or 0)
            if (
                number_type_code := int(heading_lines[7][:10])
            ) in NUMPY_TYPE_BY_COMPLEX_NUMBER_CODE and int(heading_lines[7][20:30]):
                # Some programs announce half of their bytes.
                n_bytes = (
                    2
                    * int(heading_lines[7][10:20])
                    * int(NUMPY_TYPE_BY_COMPLEX_NUMBER_CODE[number_type_code][1])
                )
            if int(dataset_number_line[13:19]) != 2:
                raise ValueError("its binary numbers are not in the format of IEEE 754")
            number_bytes = universal_file.read(n_bytes)
            if len(number_bytes) < n_bytes:
                raise ValueError(f"it ends early: {len(number_bytes)} of {n_bytes} bytes")
        data_lines = []
        while (file_line := universal_file.readline()).strip() != UNIVERSAL_DATASET_BORDER_LINE:
            if not file_line:
                if is_dataset_58 and not byte_order:
                    raise ValueError("it ends early: a dataset 58 has no last line -1")
                break
            data_lines.append(file_line)
        if is_dataset_58:
            yield heading_lines, number_bytes or b"".join(data_lines), byte_order


def _parse_fixed_width_numbers(number_bytes: bytes) -> np.ndarray:
    """Parse text with numbers of fixed width, with or without blanks between: (n,)."""
    if invalid_words := NUMBER_WITH_OPTIONAL_E_PATTERN.sub(b" ", number_bytes).split():
        raise ValueError(f"it has {invalid_words[0][:20].decode('latin-1')!r} instead of a number")
    number_words = [
        re.sub(rb"(?<=[0-9.])([+-])", rb"E\1", number_word)
        for number_word in NUMBER_WITH_OPTIONAL_E_PATTERN.findall(number_bytes)
    ]
    return np.array(number_words, dtype=float)


def _parse_response(
    header_line_texts: list[str], number_bytes: bytes, byte_order: str
) -> FrequencyResponse:
    """Parse a frequency response from a dataset 58 or 58b.

    Invalid data, for example real instead of complex numbers, or a wrong count, raise ValueError.

    Parameters
    ----------
    header_line_texts : list of str
        Line with the dataset's number, and the eleven heading lines.
    number_bytes : bytes
        Numbers of the dataset, as text or binary.
    byte_order : str
        Byte order of binary numbers, "<" or ">"; "" for text.
    """
    number_type_code, n_spectral_lines, is_equally_spaced = (
        int(header_line_texts[7][start_column : start_column + 10]) for start_column in (0, 10, 20)
    )
    first_frequency, frequency_step = (
        float(header_line_texts[7][start_column : start_column + 13].replace("D", "E"))
        for start_column in (30, 43)
    )
    motion_code = int(header_line_texts[9][:10])
    for is_unsupported, reason_text in (
        (
            number_type_code not in NUMPY_TYPE_BY_COMPLEX_NUMBER_CODE,
            "a frequency response has numbers that are not complex",
        ),
        (
            motion_code not in TIME_DERIVATIVE_ORDER_BY_MOTION_CODE,
            "a frequency response is not of a displacement, velocity or acceleration",
        ),
        (
            byte_order and not is_equally_spaced,
            "a binary frequency response has lines that are not equally spaced",
        ),
    ):
        if is_unsupported:
            raise ValueError(reason_text)
    if byte_order:
        response_numbers = np.frombuffer(
            number_bytes, byte_order + NUMPY_TYPE_BY_COMPLEX_NUMBER_CODE[number_type_code]
        ).astype(float)
    else:
        response_numbers = _parse_fixed_width_numbers(number_bytes.upper().replace(b"D", b"E"))
    if len(response_numbers) != n_spectral_lines * (2 if is_equally_spaced else 3) or not np.all(
        np.isfinite(response_numbers)
    ):
        raise ValueError(
            f"it has {len(response_numbers)} numbers for a frequency response of "
            f"{n_spectral_lines} lines: too many, too few, or not all finite"
        )
    if is_equally_spaced:
        frequencies = first_frequency + frequency_step * np.arange(n_spectral_lines)
    else:
        frequencies = response_numbers[::3]
        response_numbers = np.delete(response_numbers, np.s_[::3])
    if np.any(np.diff(frequencies) <= 0.0):
        raise ValueError("a frequency response has frequencies that do not increase")
    return FrequencyResponse(
        frequencies,
        response_numbers[::2] + 1j * response_numbers[1::2],
        TIME_DERIVATIVE_ORDER_BY_MOTION_CODE[motion_code],
    )


# --- their modes ----------------------------------------------------------------------------------


def fit_resonances(responses: Sequence[FrequencyResponse]) -> np.ndarray:
    """Fit natural frequencies and damping ratios to the peaks of frequency responses.

    All responses are fitted together. Power means the squared velocity over force, summed over the
    responses. A peak counts if its power falls to half on both sides. The standard deviation of its
    frequency must also be less than a tenth of the peak's width, damping ratio times frequency.

    Returns
    -------
    (n, 3)
        Frequency [Hz], its standard deviation [Hz], and damping ratio of each mode, in ascending
        order.

    Raises
    ------
    InputError
        The responses have different frequencies, or no peak counts.
    """
    frequencies = responses[0].frequencies
    if any(not np.array_equal(response.frequencies, frequencies) for response in responses):
        raise InputError(
            "responses", f"{len(responses)} responses", "all measured at the same frequencies"
        )
    is_positive_frequency = frequencies > 0.0
    positive_line_omegas = RAD_PER_TURN * frequencies[is_positive_frequency]
    receptances = np.stack(
        [
            response.response_values[is_positive_frequency]
            / (1j * positive_line_omegas) ** response.derivative_order
            for response in responses
        ]
    )
    response_power, mode_rows = (
        positive_line_omegas**2 * np.sum(np.abs(receptances) ** 2, axis=0),
        [],
    )
    # A peak falls to half of its power on both sides before the power is larger there. It is fitted
    # down to a tenth of its power, and for the error down to half of it.
    peak_indices, prominences_by_property_name = find_peaks(response_power, prominence=0.0)
    for peak_index in peak_indices[
        prominences_by_property_name["prominences"] > 0.5 * response_power[peak_indices]
    ].tolist():
        wide_fit, narrow_fit = (
            _fit_mode_or_none(
                positive_line_omegas,
                receptances,
                peak_index,
                _find_line_slice_around_peak(
                    response_power, peak_index, power_fraction * response_power[peak_index]
                ),
            )
            for power_fraction in (0.1, 0.5)
        )
        if wide_fit is None or narrow_fit is None:
            continue
        mode_frequency, frequency_deviation, damping_ratio = wide_fit
        frequency_deviation = float(np.hypot(frequency_deviation, mode_frequency - narrow_fit[0]))
        # Peaks of noise do not give a frequency to a tenth of the width.
        peak_width_in_hz = damping_ratio * mode_frequency
        distance_of_fit_from_peak = abs(
            mode_frequency - positive_line_omegas[peak_index] / RAD_PER_TURN
        )
        if (
            frequency_deviation < 0.1 * peak_width_in_hz
            and distance_of_fit_from_peak < peak_width_in_hz
        ):
            mode_rows.append((mode_frequency, frequency_deviation, damping_ratio))
    if not mode_rows:
        allowed_text = (
            "enough for a peak that falls to half its power on both sides, of 4 lines or more: "
            "measure a wider range, or with a finer resolution"
        )
        raise InputError("responses", f"{len(frequencies)} lines", allowed_text)
    return np.array(mode_rows)


def _find_line_slice_around_peak(
    response_power: np.ndarray, peak_index: int, min_power: float
) -> slice:
    """Find the frequencies around a peak at which the power is large enough.

    The slice of indices also ends before a frequency with more power than the peak.

    Parameters
    ----------
    response_power : (n,)
        Squared velocity over force at n frequencies, summed over the responses.
    peak_index : int
        Index of the peak.
    min_power : float
        Minimum power.
    """
    is_outside_power_range = (response_power < min_power) | (
        response_power > response_power[peak_index]
    )
    outside_power_range_indices = np.concatenate(
        [[-1], np.flatnonzero(is_outside_power_range), [len(response_power)]]
    )
    position_of_next_outside_index = int(np.searchsorted(outside_power_range_indices, peak_index))
    return slice(
        outside_power_range_indices[position_of_next_outside_index - 1] + 1,
        outside_power_range_indices[position_of_next_outside_index],
    )


def _fit_mode_or_none(
    omega: np.ndarray, receptances: np.ndarray, peak_index: int, line_slice: slice
) -> tuple[float, float, float] | None:
    """Fit one mode to a peak, by ten iterations of Sanathanan and Koerner.

    Parameters
    ----------
    omega : (n,) [rad/s]
        Frequencies.
    receptances : (responses, n) complex
        Displacements over the force.
    peak_index : int
        Index of the frequency at the peak.
    line_slice : slice
        Indices of the frequencies to fit.

    Returns
    -------
    tuple or None
        Frequency [Hz], its standard deviation [Hz] and damping ratio. None if the frequencies are
        too few, or the fitted mode has no positive stiffness and damping.
    """
    frequency_ratios, receptances_in_slice = (
        omega[line_slice] / omega[peak_index],
        receptances[:, line_slice],
    )
    n_responses, n_spectral_lines = receptances_in_slice.shape
    if 2 * receptances_in_slice.size <= 2 + 4 * n_responses:
        return None
    residual_term_columns = np.kron(
        np.eye(n_responses), np.column_stack([np.ones(n_spectral_lines), frequency_ratios - 1.0])
    )
    receptance_vector = receptances_in_slice.ravel()
    tiled_frequency_ratios = np.tile(frequency_ratios, n_responses)
    equation_weights = np.ones(len(receptance_vector))
    for _ in range(10):
        weighted_design_matrix = (
            np.column_stack(
                [
                    receptance_vector,
                    1j * tiled_frequency_ratios * receptance_vector,
                    -residual_term_columns,
                    -1j * residual_term_columns,
                ]
            )
            * equation_weights[:, None]
        )
        weighted_targets = receptance_vector * tiled_frequency_ratios**2 * equation_weights
        real_design_matrix, real_targets = (
            np.concatenate([complex_array.real, complex_array.imag])
            for complex_array in (weighted_design_matrix, weighted_targets)
        )
        fit_coefficients = np.linalg.lstsq(real_design_matrix, real_targets, rcond=None)[0]
        equation_weights = 1.0 / np.abs(
            fit_coefficients[0]
            + 1j * fit_coefficients[1] * tiled_frequency_ratios
            - tiled_frequency_ratios**2
        )
    if fit_coefficients[0] <= 0.0 or fit_coefficients[1] <= 0.0:
        return None
    equation_residuals = real_targets - real_design_matrix @ fit_coefficients
    first_coefficient_variance = (
        equation_residuals
        @ equation_residuals
        / (len(real_targets) - len(fit_coefficients))
        * np.linalg.inv(real_design_matrix.T @ real_design_matrix)[0, 0]
    )
    mode_frequency = omega[peak_index] / RAD_PER_TURN * np.sqrt(fit_coefficients[0])
    frequency_deviation = (
        0.5 * mode_frequency / fit_coefficients[0] * np.sqrt(first_coefficient_variance)
    )
    return (
        float(mode_frequency),
        float(frequency_deviation),
        float(0.5 * fit_coefficients[1] / np.sqrt(fit_coefficients[0])),
    )
