"""Frequency responses of universal files, as programs for modal tests write them.

Dataset 58, "function at nodal DOF", as text, and 58b, which has the same eleven lines and then
numbers in binary form (Structural Dynamics Research Laboratory, University of Cincinnati, which
keeps SDRC's description of the format). Of a file all functions of type 4 are read, frequency
response functions; its other datasets are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_crack.outside import bytes_of

__all__ = ["FrequencyResponse", "read_responses"]

BORDER = b"-1"
HEADING = 11
"""Lines before the numbers."""
RESPONSE = 4
"""Type of a function that is a frequency response."""
COMPLEX = {5: "f4", 6: "f8"}
"""Types of complex numbers, single and double."""
MOTIONS = {8: 0, 11: 1, 12: 2}
"""How often a displacement, a velocity or an acceleration is derived by time."""


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
    bytes_of(path)
    found = []
    for heading, numbers, kind in _functions(path.read_bytes()):
        function = heading[6].decode("latin-1")
        if int(function[:5]) == RESPONSE:
            found.append(_response([line.decode("latin-1") for line in heading], numbers, kind))
    if not found:
        raise ValueError("it has no frequency response: no dataset 58 with a function of type 4")
    return found


def _functions(text: bytes) -> Iterator[tuple[list[bytes], bytes, str]]:
    """Of each dataset 58 its lines up to the numbers, from that with its own number; the numbers;
    and the order of bytes, "" of text."""
    at = 0

    def line() -> bytes:
        nonlocal at
        end = text.find(b"\n", at)
        end = len(text) if end < 0 else end
        found, at = text[at:end].rstrip(), end + 1
        return found

    while at < len(text):
        if line().strip() != BORDER:
            continue
        if (own := line())[:6].strip() != b"58":
            while at < len(text) and line().strip() != BORDER:
                pass
            continue
        heading = [own, *(line() for _ in range(HEADING))]
        if own[6:7].lower() == b"b":
            order, size = {1: "<", 2: ">"}[int(own[7:13])], int(own[31:43])
            if int(own[13:19]) != 2:
                raise ValueError("its binary numbers are not those of IEEE 754")
            numbers, at = text[at : at + size], at + size
            if len(numbers) < size:
                raise ValueError(f"it ends early: {len(numbers)} of {size} bytes")
            yield heading, numbers, order
            continue
        begin = at
        while at < len(text):
            end = at
            if line().strip() == BORDER:
                yield heading, text[begin:end], ""
                break
        else:
            raise ValueError("it ends early: a dataset 58 has no end")


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
        values = np.array(numbers.upper().replace(b"D", b"E").split(), dtype=float)
    if len(values) != count * (2 if even else 3) or not np.all(np.isfinite(values)):
        raise ValueError(f"{len(values)} finite numbers instead of those of {count} lines")
    if even:
        frequency = least + step * np.arange(count)
    else:
        frequency, values = values[::3], np.delete(values, np.s_[::3])
    if np.any(np.diff(frequency) <= 0.0):
        raise ValueError("a frequency response whose frequencies do not increase")
    return FrequencyResponse(frequency, values[::2] + 1j * values[1::2], MOTIONS[motion])
