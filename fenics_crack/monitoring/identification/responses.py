"""Measured frequency responses: universal files, as programs for modal tests write them, and the
natural frequencies that they show.

Dataset 58, "function at nodal DOF", as text, and 58b, which has the same eleven lines and then
numbers in binary form (Structural Dynamics Research Laboratory, University of Cincinnati, which
keeps SDRC's description of the format). Of a file all functions of type 4 are read, frequency
response functions; its other datasets are left out.

Around each peak of all responses together, H_j in the form of displacements over a force, a mode
and the neighbouring ones are fitted by least squares,

    H_j(w) (a + i b r - r^2) = p_j + q_j (r - 1),        r = w / w_peak,

with a and b the same in all responses: the frequency is w_peak sqrt(a), the damping ratio
b / (2 sqrt(a)) (C. K. Sanathanan and J. Koerner, IEEE Transactions on Automatic Control 8, 1963,
56: weights by the last denominator). A crack that breathes makes its first harmonic over the force
the response of a nonlinear structure. Without clearance or a steady load it does not depend on the
force, and near a resonance it is nearly that of a mode of the frequency at which the crack
resonates; the difference is seen when less of the peak is fitted, and counted as an error.
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
from fenics_crack.basics.untrusted_files import MAX_FILE_BYTES, read_regular_file

BORDER = b"-1"
COMPLEX = {5: "f4", 6: "f8"}
"""Types of complex numbers, single and double."""
FORTRAN_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:E[+-]?\d+|[+-]\d{3}(?![\d.]))?")
"""A number in text; Fortran leaves out the E of an exponent of three digits."""
MOTIONS = {8: 0, 11: 1, 12: 2}
"""Time derivatives of a displacement, a velocity or an acceleration, by their codes."""


@dataclass(frozen=True)
class FrequencyResponse:
    """A motion over the force that makes it.

    Attributes
    ----------
    frequency : (n,) [Hz]
    values : (n,) complex
    derived : int
        0 of a displacement over a force, 1 of a velocity, 2 of an acceleration.
    """

    frequency: np.ndarray
    values: np.ndarray
    derived: int


def read_responses(path: Path) -> list[FrequencyResponse]:
    """Read the frequency responses of a universal file.

    Raises
    ------
    OSError, ValueError
        The file cannot be read, contradicts itself, or has none.
    """
    responses = []
    for heading, numbers, order in _functions(BytesIO(read_regular_file(path, MAX_FILE_BYTES))):
        lines = [line.decode("latin-1") for line in heading]
        if int(lines[6][:5]) == 4:  # frequency response functions
            responses.append(_response(lines, numbers, order))
    if not responses:
        raise ValueError("it has no frequency response: no dataset 58 with a function of type 4")
    return responses


def _functions(file: BytesIO) -> Iterator[tuple[list[bytes], bytes, str]]:
    """Each dataset 58: its lines up to the numbers, from the one with the dataset's number; the
    numbers; and the order of bytes, "" of text."""
    while line := file.readline():
        if line.strip() != BORDER:
            continue
        own, order, numbers = file.readline().rstrip(), "", b""
        response = own[:6].strip() == b"58"
        heading = [own, *(file.readline().rstrip() for _ in range(11 * response))]
        if response and own[6:7].lower() == b"b":
            order, size = {1: "<", 2: ">"}[int(own[7:13])], int(own[31:43].strip() or 0)
            if (stored := int(heading[7][:10])) in COMPLEX and int(heading[7][20:30]):
                # Some programs announce half of their bytes.
                size = 2 * int(heading[7][10:20]) * int(COMPLEX[stored][1])
            if int(own[13:19]) != 2:
                raise ValueError("its binary numbers are not those of IEEE 754")
            numbers = file.read(size)
            if len(numbers) < size:
                raise ValueError(f"it ends early: {len(numbers)} of {size} bytes")
        rest = []
        while (line := file.readline()).strip() != BORDER:
            if not line:
                if response and not order:
                    raise ValueError("it ends early: a dataset 58 has no end")
                break
            rest.append(line)
        if response:
            yield heading, numbers or b"".join(rest), order


def _numbers(text: bytes) -> np.ndarray:
    """Numbers of fixed width, perhaps without blanks between them."""
    if left := FORTRAN_NUMBER.sub(b" ", text).split():
        raise ValueError(f"{left[0][:20].decode('latin-1')!r} instead of a number")
    words = [re.sub(rb"(?<=[0-9.])([+-])", rb"E\1", word) for word in FORTRAN_NUMBER.findall(text)]
    return np.array(words, dtype=float)


def _response(heading: list[str], numbers: bytes, order: str) -> FrequencyResponse:
    """A frequency response from its lines, the first of which has the dataset's number."""
    stored, count, even = (int(heading[7][at : at + 10]) for at in (0, 10, 20))
    least, step = (float(heading[7][at : at + 13].replace("D", "E")) for at in (30, 43))
    motion = int(heading[9][:10])
    if stored not in COMPLEX:
        raise ValueError("a frequency response whose numbers are not complex")
    if motion not in MOTIONS:
        raise ValueError("a frequency response of no displacement, velocity or acceleration")
    if order and not even:
        raise ValueError("a binary frequency response whose lines are not equally spaced")
    if order:
        values = np.frombuffer(numbers, order + COMPLEX[stored]).astype(float)
    else:
        values = _numbers(numbers.upper().replace(b"D", b"E"))
    if len(values) != count * (2 if even else 3) or not np.all(np.isfinite(values)):
        raise ValueError(f"{len(values)} finite numbers instead of those of {count} lines")
    if even:
        frequency = least + step * np.arange(count)
    else:
        frequency, values = values[::3], np.delete(values, np.s_[::3])
    if np.any(np.diff(frequency) <= 0.0):
        raise ValueError("a frequency response whose frequencies do not increase")
    return FrequencyResponse(frequency, values[::2] + 1j * values[1::2], MOTIONS[motion])


# --- their modes ----------------------------------------------------------------------------------


def resonances(responses: Sequence[FrequencyResponse]) -> np.ndarray:
    """Find the modes of frequency responses: rows of frequency [Hz], its standard deviation, and
    the ratio of damping, in ascending order.

    Raises
    ------
    InputError
        The responses have different lines, or no peak that falls to half its power on both sides.
    """
    lines = responses[0].frequency
    if any(not np.array_equal(response.frequency, lines) for response in responses):
        raise InputError("responses", "of different frequencies", "all at the same frequencies")
    kept = lines > 0.0
    omega = RAD_PER_TURN * lines[kept]
    values = np.stack(
        [response.values[kept] / (1j * omega) ** response.derived for response in responses]
    )
    power, found = omega**2 * np.sum(np.abs(values) ** 2, axis=0), []
    # A peak falls to half of its power on both sides before the power is larger there. It is fitted
    # down to a tenth of its power, and for the error down to half of it.
    peaks, seen = find_peaks(power, prominence=0.0)
    for peak in peaks[seen["prominences"] > 0.5 * power[peaks]].tolist():
        wide, half = (
            _fitted(omega, values, peak, _around(power, peak, share * power[peak]))
            for share in (0.1, 0.5)
        )
        if wide is None or half is None:
            continue
        frequency, error, damping = wide
        error = float(np.hypot(error, frequency - half[0]))
        # Peaks of noise do not give a frequency to a tenth of the width.
        width, off = damping * frequency, abs(frequency - omega[peak] / RAD_PER_TURN)
        if error < 0.1 * width and off < width:
            found.append((frequency, error, damping))
    if not found:
        allowed = "with peaks that fall to half their power on both sides, of 4 lines or more"
        raise InputError("responses", f"{len(lines)} lines", allowed)
    return np.array(found)


def _around(power: np.ndarray, peak: int, least: float) -> slice:
    """Lines around a peak with at least a given power, and no more than the peak's."""
    ends = np.flatnonzero((power < least) | (power > power[peak]))
    before, after = ends[ends < peak], ends[ends > peak]
    return slice(before[-1] + 1 if len(before) else 0, after[0] if len(after) else len(power))


def _fitted(
    omega: np.ndarray, values: np.ndarray, peak: int, lines: slice
) -> tuple[float, float, float] | None:
    """Frequency [Hz], its standard deviation and the ratio of damping of a mode, by ten iterations
    of Sanathanan and Koerner; None of too few lines."""
    r, seen = omega[lines] / omega[peak], values[:, lines]
    count, size = seen.shape
    if 2 * seen.size <= 2 + 4 * count:
        return None
    own = np.kron(np.eye(count), np.column_stack([np.ones(size), r - 1.0]))
    flat, every = seen.ravel(), np.tile(r, count)
    weights = np.ones(len(flat))
    for _ in range(10):
        columns = np.column_stack([flat, 1j * every * flat, -own, -1j * own]) * weights[:, None]
        right = flat * every**2 * weights
        stacked, wanted = (np.concatenate([part.real, part.imag]) for part in (columns, right))
        found = np.linalg.lstsq(stacked, wanted, rcond=None)[0]
        weights = 1.0 / np.abs(found[0] + 1j * found[1] * every - every**2)
    if found[0] <= 0.0 or found[1] <= 0.0:
        return None
    left = wanted - stacked @ found
    variance = left @ left / (len(wanted) - len(found)) * np.linalg.inv(stacked.T @ stacked)[0, 0]
    frequency = omega[peak] / RAD_PER_TURN * np.sqrt(found[0])
    error = 0.5 * frequency / found[0] * np.sqrt(variance)
    return float(frequency), float(error), float(0.5 * found[1] / np.sqrt(found[0]))
