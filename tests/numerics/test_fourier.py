"""Fourier coefficients, and samples of them."""

import numpy as np
import pytest

from fenics_crack import UnilateralPenalty
from fenics_crack.balance.contact_integrals import SampledIntegrals
from fenics_crack.numerics.fourier import (
    balanced,
    evaluate,
    from_complex,
    instants,
    resized,
    sampled,
    to_complex,
)

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


@pytest.mark.parametrize("harmonics", [0, 1, 6, 70])
def test_products_are_ffts(harmonics: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Values and coefficients are the same by matrices of waves and by FFTs; and as many instants
    as `instants` says give means of products without aliasing."""
    wave, other = np.random.default_rng(3).normal(size=(2, 2 * harmonics + 1, 4))
    found = []
    for limit in (10**6, 0):
        monkeypatch.setattr("fenics_crack.numerics.fourier.AS_MATRIX", limit)
        count = instants(harmonics)
        assert count > 4 * harmonics
        values = sampled(wave, 300), sampled(other, count) * sampled(wave, count)
        found.append([values[0], balanced(values[0], harmonics), balanced(values[1], harmonics)])
    for one, same in zip(*found, strict=True):
        np.testing.assert_allclose(one, same, atol=1e-12)
    np.testing.assert_allclose(found[0][1], wave, atol=1e-12)
    time = np.arange(300) * 2.0 * np.pi / 300
    np.testing.assert_allclose(found[0][0], evaluate(wave, 1.0, time), atol=1e-11)


def test_resized_cuts_and_pads(coefficients: np.ndarray) -> None:
    """Harmonics are cut off at the end, and padded with zeros."""
    longer = resized(coefficients, HARMONICS + 2)
    assert np.array_equal(longer[: len(coefficients)], coefficients)
    assert not np.any(longer[len(coefficients) :])
    assert np.array_equal(resized(longer, HARMONICS), coefficients)
    assert len(resized(coefficients, 2)) == 5
