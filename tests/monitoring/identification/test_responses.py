"""Natural frequencies from frequency responses in universal files, written after SDRC's description
of dataset 58 and the University of Cincinnati's of 58b."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import catch_error

import fenics_crack as fc

OMEGA = 2.0 * np.pi * np.array([112.3, 148.7, 391.2])
DAMPING = np.array([0.004, 0.01, 0.006])
SHAPES = np.array([[1.0, 0.7, -0.4], [0.5, -0.9, 0.8]])


def responses(frequency: np.ndarray, noise: float = 0.0) -> np.ndarray:
    """Displacements of two points over a force at the first, with a noise of their largest."""
    w = 2.0 * np.pi * frequency[:, None]
    modes = SHAPES[0] / (OMEGA**2 - w**2 + 2j * DAMPING * OMEGA * w)
    response_array = np.array([modes @ shape for shape in SHAPES])
    rng = np.random.default_rng(4)
    both = rng.standard_normal((2, *response_array.shape))
    return np.asarray(
        response_array + noise * np.abs(response_array).max() * (both[0] + 1j * both[1])
    )


def universal(
    frequency: np.ndarray, values: np.ndarray, derived: int = 2, form: str = "even", stored: int = 5
) -> bytes:
    """Dataset 58 of a response: "even" or "uneven" lines as text, or "<" or ">", 58b."""
    values = values * (2j * np.pi * frequency) ** derived
    is_even, digits = form != "uneven", {5: 5, 6: 12}[stored]
    own = f"{58:6}"
    pairs = np.column_stack([values.real, values.imag])
    if form in "<>":
        body = pairs.astype(form + {5: "f4", 6: "f8"}[stored]).tobytes()
        own += f"b{'<>'.index(form) + 1:6}{2:6}{11:12}{len(body):12}{0:6}{0:6}{0:12}{0:12}"
    elif is_even:
        width, numbers_per_line = (13, 6) if stored == 5 else (20, 4)
        words = [f"{x:{width}.{digits}E}" for x in pairs.ravel()]
        rows = [
            "".join(words[start : start + numbers_per_line])
            for start in range(0, len(words), numbers_per_line)
        ]
        body = ("\n".join(rows) + "\n").encode()
    else:
        width = 13 if stored == 5 else 20
        rows = [
            f"{f:13.5E}{x:{width}.{digits}E}{y:{width}.{digits}E}"
            for f, (x, y) in zip(frequency, pairs, strict=True)
        ]
        body = ("\n".join(rows) + "\n").encode()
    step = frequency[1] - frequency[0] if is_even else 0.0
    motion = {0: 8, 1: 11, 2: 12}[derived]
    lines = [
        f"{-1:6}", own, "a response", "NONE", "22-Nov-26  15:00:00", "NONE", "NONE",
        f"{4:5}{0:10}{1:5}{0:10} {'NONE':10}{12:10}{3:4} {'NONE':10}{7:10}{3:4}",
        f"{stored:10}{len(values):10}{int(is_even):10}{frequency[0]:13.5E}{step:13.5E}{0.0:13.5E}",
        f"{18:10}{0:5}{0:5}{0:5} {'Frequency':20} {'Hz':20}",
        f"{motion:10}{0:5}{0:5}{0:5} {'motion':20} {'SI':20}",
        f"{13:10}{0:5}{0:5}{0:5} {'Force':20} {'N':20}",
        f"{0:10}{0:5}{0:5}{0:5} {'NONE':20} {'NONE':20}",
    ]  # fmt: skip
    return "\n".join(lines).encode() + b"\n" + body + f"{-1:6}\n".encode()


def file_of(path: Path, frequency: np.ndarray, values: np.ndarray, **how: object) -> Path:
    """A file with units (dataset 164), a spectrum, which is none, and responses."""
    units = f"{-1:6}\n{164:6}\n{1:10}SI\n{-1:6}\n".encode()
    spectrum = universal(frequency, values[0]).replace(
        f"{4:5}{0:10}".encode(), f"{2:5}{0:10}".encode()
    )
    parts = [universal(frequency, number, **how) for number in values]  # type: ignore[arg-type]
    path.write_bytes(units + spectrum + b"".join(parts))
    return path


@pytest.mark.parametrize(
    ("form", "stored", "derived"),
    [("even", 5, 2), ("even", 6, 1), ("uneven", 5, 0), ("uneven", 6, 2), ("<", 5, 2), (">", 6, 0)],
)
def test_modes_of_responses(form: str, stored: int, derived: int, tmp_path: Path) -> None:
    """Three modes from two responses in all forms of the file, to a hundredth of their width."""
    frequency = np.linspace(50.0, 450.0, 1601)
    options = {"form": form, "stored": stored, "derived": derived}
    path = file_of(tmp_path / "one.uff", frequency, responses(frequency), **options)
    rows = fc.Measurements.read(path).rows
    assert [(row.quantity, row.mode) for row in rows] == [
        ("frequency_resonance", mode) for mode in (1, 2, 3)
    ]
    row_values = np.array([row.value for row in rows])
    assert np.all(np.abs(row_values - OMEGA / (2.0 * np.pi)) < 0.01 * DAMPING * row_values)


@pytest.mark.parametrize("form", ["even", "<", ">"])
def test_every_response_of_a_file_counts(form: str, tmp_path: Path) -> None:
    """The first two are at nodes of the second mode; some numbers of text touch, as exponents have
    three digits, and Fortran leaves out the E of these; some programs announce half of the
    bytes."""
    frequency = np.linspace(50.0, 450.0, 1601)
    w = 2.0 * np.pi * frequency[:, None]
    modes = 1.0 / (OMEGA**2 - w**2 + 2j * DAMPING * OMEGA * w)
    modes[:8] = -1e-106 * (1.0 + 1.0j)
    parts = [
        universal(frequency, modes @ shape, form=form, stored=6)
        for shape in ([1.0, 0.0, 1.0], [0.5, 0.0, -1.0], [0.5, 1.0, -1.0])
    ]
    size = f"{16 * len(frequency):12}".encode()
    text = b"".join(parts).replace(size, f"{8 * len(frequency):12}".encode())
    path = tmp_path / "one.uff"
    path.write_bytes(text.replace(b"E-10", b"-10") if form == "even" else text)
    rows = fc.Measurements.read(path).rows
    assert [row.value for row in rows] == pytest.approx(OMEGA / (2.0 * np.pi), rel=1e-4)


def test_errors_of_responses_with_noise(tmp_path: Path) -> None:
    """Frequencies within three standard deviations, which are a few thousandths of a hertz; noise
    makes no modes."""
    frequency = np.linspace(50.0, 450.0, 1601)
    path = file_of(tmp_path / "one.unv", frequency, responses(frequency, 1e-3), stored=6)
    rows = fc.Measurements.from_responses(path, [1, 2, 4], quantity="frequency_uncracked").rows
    assert [row.mode for row in rows] == [1, 2, 4]
    frequency_errors = np.array([row.value for row in rows]) - OMEGA / (2.0 * np.pi)
    errors = np.array([row.deviation for row in rows])
    assert np.all(np.abs(frequency_errors) < 3.0 * errors) and np.all(
        errors < 0.1 * DAMPING * OMEGA / 6.28
    )
    catch_error(
        lambda: fc.Measurements.from_responses(path, [1, 2]),
        "modes",
        [1, 2],
        names=r"3 numbers.* 112\.29",
    )


def test_a_breathing_crack(tmp_path: Path) -> None:
    """The first harmonic of a bilinear mass over its force, computed as a curve: the resonance is
    near the bilinear frequency, the same under ten times the force."""
    one, found = np.ones((1, 1)), []
    for force in (0.4, 4.0):
        mode = fc.Structure.from_matrices(
            one, 1e6 * one, gap=one, force_cos=[force], damping=10.0 * one
        )
        law = fc.UnilateralPenalty(1e5)
        curve = fc.continue_frequency(mode, 980.0, 1070.0, law, harmonics=8)
        omega = np.linspace(982.0, 1068.0, 300)
        wave = curve.coefficients_at(0)
        first_harmonic = np.interp(omega, curve.omega, wave[:, 1]) - 1j * np.interp(
            omega, curve.omega, wave[:, 2]
        )
        path = file_of(tmp_path / "one.uff", omega / (2.0 * np.pi), first_harmonic[None] / force)
        [row] = fc.Measurements.read(path).rows
        found.append(row)
    bilinear = 2.0 * 1000.0 * np.sqrt(1.1e6) / (1000.0 + np.sqrt(1.1e6)) / (2.0 * np.pi)
    assert found[0].value == pytest.approx(found[1].value, rel=1e-5)
    assert found[0].value == pytest.approx(bilinear, abs=0.04 * 0.0488 * 1000.0 / (2.0 * np.pi))
    assert found[0].deviation < 0.05


@pytest.mark.parametrize(
    ("old", "new", "names"),
    [
        (b"    4         0", b"    1         0", "58 .* type 4"),
        (b"         6      1601", b"         4      1601", None),
        (b"        12    0", b"         1    0", None),
        (b"      1601", b"      1602", "3202 .* 1602"),
    ],
    ids=range(4),
)
def test_files_that_cannot_be_used(
    old: bytes, new: bytes, names: str | None, tmp_path: Path
) -> None:
    frequency = np.linspace(50.0, 450.0, 1601)
    path = file_of(tmp_path / "one.uff", frequency, responses(frequency), stored=6)
    file_content = path.read_bytes()
    path.write_bytes(file_content.replace(old, new))
    catch_error(lambda: fc.Measurements.read(path), "measurements", str(path), names=names)
    path.write_bytes(file_content[:-200])
    catch_error(lambda: fc.Measurements.read(path), "measurements", str(path), names="58 ")


def test_noise_has_no_modes(tmp_path: Path) -> None:
    frequency = np.linspace(50.0, 450.0, 1601)
    rng = np.random.default_rng(8)
    noise = rng.standard_normal((2, 1601)) + 1j * rng.standard_normal((2, 1601))
    path = file_of(tmp_path / "one.uff", frequency, noise, stored=6)
    catch_error(lambda: fc.Measurements.read(path), "responses", "1601 lines")
