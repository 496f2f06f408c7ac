"""Fourier coefficients, and samples of them."""

import numpy as np
import pytest

from fenics_crack.balance.contact_integrals import SampledIntegrals
from fenics_crack.balance.fourier import evaluate, from_complex, resized, to_complex
from fenics_crack.model.contact import UnilateralPenalty

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
