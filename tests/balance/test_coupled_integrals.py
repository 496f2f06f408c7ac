"""Fourier coefficients of contact forces that couple the pairs, and their derivatives."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import scipy.integrate
from helpers import log_slope, random_stiffness, relative
from test_contact_integrals import grazing_gaps, random_gaps

import fenics_crack as fc
from fenics_crack.balance.contact_integrals import ExactIntegrals
from fenics_crack.balance.coupled_integrals import CoupledIntegrals
from fenics_crack.numerics.fourier import balanced, evaluate, sampled

RIGID = fc.UnilateralConstraint()
STIFFNESS = np.array([2.0, 300.0, 15.0])
LAWS = {
    "rigid": (RIGID, None),
    "penalty": (fc.UnilateralPenalty(STIFFNESS), None),
    "sampled": (fc.UnilateralPenalty(STIFFNESS), 256),
    "smoothed": (fc.SmoothedPenalty(STIFFNESS, 20.0), 256),
}


def residual(pairs: int, seed: int = 1) -> np.ndarray:
    """R_inf that couples all pairs."""
    return np.linalg.inv(random_stiffness(np.random.default_rng(seed), pairs))


def integrals(kind: str, harmonics: int, **options: Any) -> CoupledIntegrals:
    """Of three pairs under a law."""
    law, samples = LAWS[kind]
    return CoupledIntegrals(law, harmonics, residual=residual(3), samples=samples, **options)


def difference(function: Any, place: Any, step: Any) -> np.ndarray:
    """Central difference of a function along a step."""
    found: np.ndarray = 0.5 * (function(place + step) - function(place - step))
    return found


@pytest.mark.parametrize("mean", [0.0, 100.0, -100.0])
def test_products_with_the_tangent(mean: float) -> None:
    """As a matrix, and in a basis, exact and sampled; also without any event, and after another
    point has been asked for."""
    gap, change = random_gaps(4, 3, 2), random_gaps(4, 3, 5)
    gap[0] = mean
    basis = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 2)))[0]
    for kind in ("rigid", "smoothed"):
        made = integrals(kind, 4)
        forces, other = made.linearise(gap), made.linearise(change)
        matrix = forces.tangent().reshape(27, 27)
        assert np.allclose(forces.apply(change).ravel(), matrix @ change.ravel(), atol=1e-9)
        seen = forces.tangent(basis).reshape(18, 18) @ change[:, :2].ravel()
        expected = (matrix @ (change[:, :2] @ basis.T).ravel()).reshape(9, 3) @ basis
        assert np.allclose(seen, expected.ravel(), atol=1e-9)
        assert np.array_equal(other.apply(gap), made.linearise(change).apply(gap))


# --- forces ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", ["rigid", "penalty"])
def test_exact_force_by_gauss_between_events(law: str) -> None:
    """All coefficients of three pairs, the instants of events found by bisection, to 1e-11."""
    harmonics, made = 4, integrals(law, 4)
    gap = random_gaps(harmonics, 3, 2)
    grid = np.linspace(0.0, 2.0 * np.pi, 4097)
    _, closed = made.contact.solve(evaluate(gap, 1.0, grid))
    events = []
    for place in np.flatnonzero(np.any(closed[1:] != closed[:-1], axis=1)):
        low, high = grid[place], grid[place + 1]
        for _ in range(60):
            middle = 0.5 * (low + high)
            same = made.contact.solve(evaluate(gap, 1.0, np.array([middle])))[1][0]
            low, high = (middle, high) if np.array_equal(same, closed[place]) else (low, middle)
        events.append(low)
    assert len(events) >= 6
    ends = np.unique(np.concatenate([[0.0], events, np.linspace(0.0, 2.0 * np.pi, 9)]))
    nodes, weights = np.polynomial.legendre.leggauss(24)
    expected = np.zeros_like(gap)
    for low, high in pairwise(ends):
        theta = 0.5 * (low + high) + 0.5 * (high - low) * nodes
        force = made.forces(evaluate(gap, 1.0, theta)) * (0.5 * (high - low) * weights)[:, None]
        expected[0] += force.sum(axis=0) / (2.0 * np.pi)
        for k in range(1, harmonics + 1):
            expected[2 * k - 1] += np.cos(k * theta) @ force / np.pi
            expected[2 * k] += np.sin(k * theta) @ force / np.pi
    assert relative(made.linearise(gap).force, expected) < 1e-11


@pytest.mark.parametrize(("pairs", "harmonics"), [(2, 8), (6, 4), (20, 3)])
def test_samples_approach_the_exact_force_with_second_order(pairs: int, harmonics: int) -> None:
    """From 64 to 16384 samples, the mean over eight waves; down to 1e-6."""
    compliance, counts = residual(pairs), 2 ** np.arange(6, 15, 2)
    errors = np.zeros(len(counts))
    for seed in range(8):
        gap = random_gaps(harmonics, pairs, seed)
        made = CoupledIntegrals(RIGID, harmonics, residual=compliance)
        for place, count in enumerate(counts):
            found = replace(made, samples=int(count)).force(gap)
            errors[place] += relative(found, made.force(gap)) / 8.0
    assert log_slope(counts, errors) == pytest.approx(-2.0, abs=0.15)
    assert errors[-1] < 1e-6


@pytest.mark.parametrize("softness", [0.0, 0.7])
@pytest.mark.parametrize("stiffness", [np.inf, 5.0])
def test_one_pair_is_a_penalty_behind_a_spring(stiffness: float, softness: float) -> None:
    """R_inf and 1/k in series: the force, and its derivative, of 1 / (R_inf + 1/k)."""
    law = RIGID if np.isinf(stiffness) else fc.UnilateralPenalty(stiffness)
    compliance = 0.4 + 1.0 / stiffness
    alone = ExactIntegrals(fc.UnilateralPenalty(1.0 / (compliance * (1.0 + softness))), 7)
    for seed in range(4):
        gap = random_gaps(7, 1, seed)
        seen: dict[str, Any] = {"residual": np.full((1, 1), 0.4), "softness": softness}
        forces = CoupledIntegrals(law, 7, **seen).linearise(gap)
        pair, spring = ExactIntegrals(law, 7, **seen).linearise(gap), alone.linearise(gap)
        for found in (forces, pair):
            assert relative(found.force, spring.force) < 1e-12
        assert relative(forces.tangent()[:, 0], spring.tangent[0]) < 1e-11
        assert relative(pair.tangent, spring.tangent) < 1e-12
        one, other = (found.by_softness() for found in (forces, pair))
        assert np.allclose(one, other, rtol=1e-10, atol=1e-12)


def test_grazing_contact_against_a_penalty() -> None:
    """Peaks 1e-4 to 1e-8 above and below zero: the force of the search for single pairs."""
    for depth in (1e-4, -1e-4, 1e-6, 1e-8):
        gaps = grazing_gaps(np.full(10, depth))
        for column in range(10):
            gap = gaps[:, [column]]
            for sign in (1.0, -1.0):
                made = CoupledIntegrals(RIGID, 4, residual=np.eye(1)).linearise(sign * gap)
                force = ExactIntegrals(fc.UnilateralPenalty(1.0), 4).force(sign * gap)
                assert np.abs(made.force - force).max() < 1e-13
                assert np.any(made.force) == (depth > 0.0 or sign < 0.0)


def test_smoothed_force_by_quadrature() -> None:
    """lambda(s(t)) of one pair times each wave, by QUADPACK."""
    law, compliance = fc.SmoothedPenalty(3.0, 4.0), np.full((1, 1), 0.2)
    made, gap = CoupledIntegrals(law, 2, residual=compliance), random_gaps(2, 1)
    found = made.linearise(gap).force[:, 0]

    def force(t: float) -> float:
        return float(made.forces(evaluate(gap, 1.0, np.array([t])))[0, 0])

    weights = [lambda t: 0.5, np.cos, np.sin, lambda t: np.cos(2 * t), lambda t: np.sin(2 * t)]
    for row, weight in enumerate(weights):
        integral, _ = scipy.integrate.quad(
            lambda t, w=weight: force(t) * w(t), 0.0, 2.0 * np.pi, epsabs=1e-11, limit=200
        )
        assert found[row] == pytest.approx(integral / np.pi, abs=1e-9)


def test_coefficients_and_samples() -> None:
    """There and back, the values being those of the wave."""
    gap = random_gaps(5, 2)
    values = sampled(gap, 24)
    assert np.allclose(values, evaluate(gap, 1.0, 2.0 * np.pi * np.arange(24) / 24), atol=1e-13)
    assert np.allclose(balanced(values, 5), gap, atol=1e-13)


# --- derivatives ----------------------------------------------------------------------------------


@pytest.mark.parametrize("harmonics", [1, 5])
@pytest.mark.parametrize("kind", LAWS)
def test_tangent_against_finite_differences(kind: str, harmonics: int) -> None:
    """All couplings of harmonics and pairs, to 1e-6 of the largest; T v is the matrix times v."""
    made, gap = integrals(kind, harmonics), random_gaps(harmonics, 3, harmonics)
    forces = made.linearise(gap)
    matrix = forces.tangent().reshape(len(gap), 3, len(gap), 3)
    for row in range(len(gap)):
        for pair in range(3):
            unit = np.zeros_like(gap)
            unit[row, pair] = 1.0
            slope = difference(lambda s: made.linearise(s).force, gap, 1e-6 * unit) / 1e-6
            assert np.abs(matrix[:, :, row, pair] - slope).max() < 2e-6 * np.abs(matrix).max()
    change = np.random.default_rng(1).normal(size=gap.shape)
    assert relative(forces.apply(change), np.tensordot(matrix, change, 2)) < 1e-12
    if harmonics > 1:  # pairs and harmonics are coupled
        assert np.abs(matrix[1, 0, 4, 1]) > 1e-4 * np.abs(matrix).max()


@pytest.mark.parametrize("softness", [0.0, 0.5])
@pytest.mark.parametrize("kind", LAWS)
def test_derivatives_by_softness_and_stiffness(kind: str, softness: float) -> None:
    """By central differences; a rigid law has no stiffness to depend on."""
    gap, made = random_gaps(5, 3, 3), integrals(kind, 5, softness=softness)
    forces, step = made.linearise(gap), 1e-5
    found = forces.by_softness()
    soft = [made.with_softness(softness + s * step).linearise(gap).force for s in (1.0, -1.0)]
    assert relative((soft[0] - soft[1]) / (2.0 * step), found) < 1e-5
    if kind == "rigid":
        assert not np.any(forces.by_stiffness())
        return
    law = made.law

    def scaled(logarithm: float) -> np.ndarray:
        other = made.of_law(law.scaled(np.exp(logarithm)))
        # Softness is measured in the compliance, which changes here: kept in metres per newton.
        kept = other.with_softness(softness * made.unit / other.unit)
        return kept.linearise(gap).force

    assert relative(difference(scaled, 0.0, step) / step, forces.by_stiffness()) < 1e-5


def test_widened_keeps_the_forces() -> None:
    """More harmonics: the first ones stay, exact or by enough samples."""
    for kind in LAWS:
        gap = random_gaps(4, 3)
        wide = np.vstack([gap, np.zeros((8, 3))])
        made = integrals(kind, 4, softness=0.2)
        made = made if kind == "sampled" else replace(made, samples=None)
        found = made.widened(8).linearise(wide).force[:9]
        assert relative(found, made.linearise(gap).force) < (1e-3 if kind == "sampled" else 1e-9)


def test_many_pairs_and_sets() -> None:
    """Forty pairs, hundreds of sets: the forces of many samples, and the tangent along a change."""
    compliance, gap = residual(40), random_gaps(4, 40)
    made = CoupledIntegrals(RIGID, 4, residual=compliance)
    exact = made.linearise(gap)
    fine = replace(made, samples=1 << 13).linearise(gap)
    assert relative(fine.force, exact.force) < 1e-5
    change = 1e-6 * np.random.default_rng(1).normal(size=gap.shape)
    slope = difference(lambda s: made.linearise(s).force, gap, change)
    assert relative(exact.apply(change), slope) < 1e-5
