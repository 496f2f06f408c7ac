"""Fourier coefficients, and contact balanced from samples."""

import numpy as np
import pytest
from scipy.integrate import quad

from fenics_crack.contact import SmoothedPenalty, UnilateralPenalty
from fenics_crack.contact_integrals import SampledIntegrals
from fenics_crack.fourier import evaluate, from_complex, resized, to_complex

HARMONICS = 6
PAIRS = 3


@pytest.fixture
def coefficients() -> np.ndarray:
    """Random coefficients of three pairs."""
    return np.random.default_rng(1).normal(size=(2 * HARMONICS + 1, PAIRS))


def test_complex_form_is_inverse_and_evaluates(coefficients: np.ndarray) -> None:
    """x(t) = Re sum X_k exp(ikwt), and both forms turn into each other."""
    harmonics = to_complex(coefficients)
    omega, time = 3.0, np.linspace(0.0, 2.0, 7)
    phases = np.exp(1j * omega * np.outer(time, np.arange(HARMONICS + 1)))
    assert np.allclose((phases @ harmonics).real, evaluate(coefficients, omega, time), atol=1e-13)
    assert np.array_equal(from_complex(harmonics), coefficients)


def test_sampling_and_balancing_are_inverse(coefficients: np.ndarray) -> None:
    """Samples are values at i T / N, and a band-limited wave comes back exactly."""
    contact = SampledIntegrals(UnilateralPenalty(1.0), HARMONICS, 32)
    values = contact.sample(coefficients)
    time = np.arange(32) * 2.0 * np.pi / 32
    assert np.allclose(values, evaluate(coefficients, 1.0, time), atol=1e-13)
    assert np.allclose(contact.balance(values), coefficients, atol=1e-13)


def test_resized_cuts_and_pads(coefficients: np.ndarray) -> None:
    """Harmonics are cut off at the end, and padded with zeros."""
    longer = resized(coefficients, HARMONICS + 2)
    assert np.array_equal(longer[: len(coefficients)], coefficients)
    assert not np.any(longer[len(coefficients) :])
    assert np.array_equal(resized(longer, HARMONICS), coefficients)
    assert len(resized(coefficients, 2)) == 5


def test_balance_converges_to_the_integrals_of_the_paper(coefficients: np.ndarray) -> None:
    """Eq. 7 by adaptive quadrature; the trapezoidal rule approaches it like N^-2 at the kinks."""
    law = UnilateralPenalty(2.0)

    def force(t: float) -> float:
        return float(law.force(evaluate(coefficients, 1.0, np.array([t])))[0, 0])

    exact = np.empty(3)
    for row, weight in enumerate((lambda t: 0.5, np.cos, np.sin)):
        integral, _ = quad(
            lambda t, w=weight: force(t) * w(t), 0.0, 2.0 * np.pi, limit=400, epsabs=1e-11
        )
        exact[row] = integral / np.pi
    errors = []
    counts = np.array([64, 128, 256, 512, 1024, 2048])
    for count in counts:
        found = SampledIntegrals(law, HARMONICS, int(count)).force(coefficients)
        errors.append(np.linalg.norm(found[:3, 0] - exact))
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert errors[-1] < 1e-5
    assert -2.6 < slope < -1.5


@pytest.mark.parametrize("law", [UnilateralPenalty(2.0), SmoothedPenalty(2.0, 5.0)])
def test_tangent_is_the_derivative_of_the_balance(
    coefficients: np.ndarray, law: UnilateralPenalty | SmoothedPenalty
) -> None:
    """Central finite differences; all couplings of the harmonics of a pair, none between pairs."""
    contact = SampledIntegrals(law, HARMONICS, 64)

    balance = contact.force
    force, tangent = contact.linearise(coefficients)
    assert np.array_equal(force, balance(coefficients))
    step = 1e-6
    for column in range(2 * HARMONICS + 1):
        for pair in range(PAIRS):
            change = np.zeros_like(coefficients)
            change[column, pair] = step
            slope = (balance(coefficients + change) - balance(coefficients - change)) / (2 * step)
            expected = np.zeros_like(coefficients)
            expected[:, pair] = tangent[pair, :, column]
            assert np.allclose(slope, expected, atol=1e-6)
    off_diagonal = tangent[:, 1:3, 3:5]
    assert np.abs(off_diagonal).min() > 1e-3  # the nonlinearity does couple harmonics
