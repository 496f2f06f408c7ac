"""Contact forces and their derivatives: by exact integrals, by samples, and where pairs couple."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import scipy.integrate
from helpers import log_slope, random_stiffness, relative
from scipy.integrate import quad
from switching import switching_instants

import fenics_crack as fc
from fenics_crack import ContactLaw, SmoothedPenalty, UnilateralPenalty
from fenics_crack.balance.contact_integrals import (
    CoupledIntegrals,
    ExactIntegrals,
    PairIntegrals,
    SampledIntegrals,
    contact_integrals,
    default_samples,
)
from fenics_crack.numerics.fourier import (
    balanced,
    evaluate,
    from_complex,
    instants,
    resized,
    sampled,
    to_complex,
)

STIFFNESS = np.array([2.0, 30.0, 0.5, 7.0])


def random_gaps(harmonics: int, pairs: int, seed: int = 1) -> np.ndarray:
    """Coefficients (2H+1, pairs) that fall like 1/k, so that all pairs switch a few times."""
    gap = np.random.default_rng(seed).normal(size=(2 * harmonics + 1, pairs))
    gap[1:] /= np.repeat(np.arange(1, harmonics + 1), 2)[:, None]
    gap[0] *= 0.3
    return gap


def grazing_gaps(depth: np.ndarray, harmonics: int = 4) -> np.ndarray:
    """Gaps whose largest value, at a phase of their own, is the depth."""
    gap = random_gaps(harmonics, len(depth), seed=2)
    phase = 2.0 * np.pi * np.arange(1 << 12) / (1 << 12)
    for pair in range(len(depth)):
        theta = np.array([phase[np.argmax(evaluate(gap[:, pair], 1.0, phase))]])
        order = np.arange(harmonics + 1)
        for _ in range(8):  # Newton's method for g' = 0
            wave = to_complex(gap[:, pair]) * np.exp(1j * order * theta[0])
            theta += np.sum(order * wave.imag) / -np.sum(order**2 * wave.real)
        gap[0, pair] += depth[pair] - evaluate(gap[:, pair], 1.0, theta)[0]
    return gap


def linearised(integrals: PairIntegrals, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forces and their tangent."""
    found = integrals.linearise(gap)
    return found.force, found.tangent


def finite_differences(integrals: PairIntegrals, gap: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Central differences (n_pairs, rows, columns) of the force, with a step for each pair."""
    columns = []
    for column in range(len(gap)):
        change = np.zeros_like(gap)
        change[column] = step
        force = integrals.force(gap + change) - integrals.force(gap - change)
        columns.append((force / (2.0 * step)).T)
    return np.stack(columns, axis=2)


def test_exact_force_against_adaptive_quadrature() -> None:
    """Eq. 7 by QUADPACK with the switching instants as break points, to 1e-11."""
    harmonics = 5
    gap = random_gaps(harmonics, 4)
    found = ExactIntegrals(UnilateralPenalty(STIFFNESS), harmonics).force(gap)
    switching = switching_instants(to_complex(gap))
    for pair in range(4):
        instants = np.sort(switching.theta[switching.pair == pair])
        assert len(instants) >= 2

        def force(t: float, pair: int = pair) -> float:
            return float(STIFFNESS[pair] * max(evaluate(gap[:, pair], 1.0, np.array([t]))[0], 0.0))

        for row in range(2 * harmonics + 1):
            order = (row + 1) // 2
            wave = np.cos if row % 2 or row == 0 else np.sin
            integral, _ = quad(
                lambda t, w=wave, k=order, f=force: f(t) * w(k * t),
                0.0,
                2.0 * np.pi,
                points=instants,
                limit=200,
                epsabs=1e-12,
                epsrel=1e-12,
            )
            expected = integral / np.pi * (0.5 if row == 0 else 1.0)
            assert found[row, pair] == pytest.approx(expected, abs=1e-11 * STIFFNESS[pair])


def test_samples_approach_the_exact_force_with_second_order() -> None:
    """Root mean square over 200 gaps: N^-2 from 64 to 16384 samples, down to 1e-8."""
    harmonics = 6
    gap, law = random_gaps(harmonics, 200), UnilateralPenalty(1.0)
    exact = linearised(ExactIntegrals(law, harmonics), gap)
    counts = 2 ** np.arange(6, 15)
    errors = [
        relative(SampledIntegrals(law, harmonics, int(n)).force(gap), exact[0]) for n in counts
    ]
    assert log_slope(counts, errors) == pytest.approx(-2.0, abs=0.1)
    assert errors[-1] < 1e-7
    tangent = SampledIntegrals(law, harmonics, 1 << 16).linearise(gap).tangent
    assert np.abs(tangent - exact[1]).max() < 1e-3  # first order only: the tangent jumps


def test_smoothed_force_by_samples_against_quadrature() -> None:
    """A smooth law needs no break points: the trapezoidal rule is exact to 1e-10."""
    law, gap = SmoothedPenalty(3.0, 4.0), random_gaps(3, 1)
    found = SampledIntegrals(law, 3, 1024).force(gap)[:, 0]

    def force(t: float) -> float:
        return float(law.force(evaluate(gap[:, 0], 1.0, np.array([t])))[0])

    weights = [lambda t: 0.5, np.cos, np.sin, lambda t: np.cos(2 * t), lambda t: np.sin(2 * t)]
    for row, weight in enumerate(weights):
        integral, _ = quad(
            lambda t, w=weight: force(t) * w(t), 0.0, 2.0 * np.pi, epsabs=1e-12, limit=200
        )
        assert found[row] == pytest.approx(integral / np.pi, abs=1e-10)


@pytest.mark.parametrize("harmonics", [1, 4, 12])
@pytest.mark.parametrize("kind", ["exact", "sampled", "smoothed"])
def test_tangent_against_finite_differences(kind: str, harmonics: int) -> None:
    """All couplings of the harmonics of 4 pairs, to 1e-6 of the stiffness."""
    penalty, smoothed = UnilateralPenalty(STIFFNESS), SmoothedPenalty(STIFFNESS, 5.0)
    integrals = {
        "exact": ExactIntegrals(penalty, harmonics),
        "sampled": SampledIntegrals(penalty, harmonics, 64),
        "smoothed": SampledIntegrals(smoothed, harmonics, 64),
    }[kind]
    gap = random_gaps(harmonics, 4, seed=harmonics)
    force, tangent = linearised(integrals, gap)
    assert np.array_equal(force, integrals.force(gap))
    slopes = finite_differences(integrals, gap, np.full(4, 1e-6))
    assert np.abs((tangent - slopes) / STIFFNESS[:, None, None]).max() < 1e-6
    if harmonics > 1:  # the nonlinearity does couple harmonics
        assert np.linalg.norm(tangent[:, 1:3, 3:5], axis=(1, 2)).min() > 1e-3


def test_exact_tangent_at_grazing() -> None:
    """Peaks 1e-3 to 1e-6 above or below zero, and of -g: to 1e-6 with steps short of grazing."""
    depth = np.array([1e-3, -1e-3, 1e-4, -1e-4, 1e-5, -1e-5, 1e-6, -1e-6])
    gap = grazing_gaps(depth)
    for sign in (1.0, -1.0):
        integrals = ExactIntegrals(UnilateralPenalty(1.0), 4)
        tangent = integrals.linearise(sign * gap).tangent
        slopes = finite_differences(integrals, sign * gap, 1e-3 * np.abs(depth))
        assert np.abs(tangent - slopes).max() < 1e-6
        closed_part = np.abs(tangent - (0.0 if sign > 0.0 else 1.0) * np.eye(9)).max(axis=(1, 2))
        assert np.all((closed_part > 1e-5) == (depth > 0.0))  # the short contact is there, or not


def quotients(integrals: PairIntegrals, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One-sided difference quotients of the mean force of m - 1 + cos(theta) at m = 0."""
    gap = np.array([[-1.0], [1.0], [0.0]])
    rows = []
    for sign in (1.0, -1.0):
        moved = [gap + np.array([[sign * h], [0.0], [0.0]]) for h in steps]
        start = integrals.force(gap)[0, 0]
        forces = np.array([integrals.force(g)[0, 0] for g in moved])
        rows.append((forces - start) / (sign * steps))
    return rows[0], rows[1]


def test_exact_force_is_smooth_across_grazing_and_the_sampled_one_is_not() -> None:
    """Right of grazing the quotient falls to the left one, 0, like 2 sqrt(2 h) / (3 pi).

    int max(h - theta^2 / 2, 0) / (2 pi) = (2 h)^(3/2) / (3 pi). Sampled, it stays at 1/N: one
    sample switches.
    """
    law, steps = UnilateralPenalty(1.0), 10.0 ** -np.arange(4.0, 9.0)
    right, left = quotients(ExactIntegrals(law, 1), steps)
    assert np.allclose(right, 2.0 * np.sqrt(2.0 * steps) / (3.0 * np.pi), rtol=1e-3)
    assert not np.any(left)
    right, left = quotients(SampledIntegrals(law, 1, 64), steps)
    assert np.allclose(right, 1.0 / 64.0, rtol=1e-3)
    assert not np.any(left)


def test_exact_tangent_is_continuous_across_grazing() -> None:
    """On both sides of grazing, h away, the tangents differ like sqrt(h) in every entry's norm."""
    integrals = ExactIntegrals(UnilateralPenalty(1.0), 4)
    depths = 10.0 ** -np.arange(4.0, 11.0)
    jumps = []
    for depth in depths:
        above, below = (
            integrals.linearise(grazing_gaps(np.full(5, side * depth))).tangent
            for side in (1.0, -1.0)
        )
        jumps.append(np.linalg.norm(above - below))
    assert log_slope(depths, jumps) == pytest.approx(0.5, abs=0.02)


def test_always_closed_and_always_open() -> None:
    """lambda = k g and the tangent k on all rows where the pair never opens; else both vanish."""
    gap = random_gaps(3, 4)
    gap[0] = [50.0, -50.0, 50.0, -50.0]
    force, tangent = linearised(ExactIntegrals(UnilateralPenalty(STIFFNESS), 3), gap)
    closed = np.array([1.0, 0.0, 1.0, 0.0])
    assert np.allclose(force, closed * STIFFNESS * gap, rtol=0.0, atol=1e-11)
    expected = (closed * STIFFNESS)[:, None, None] * np.eye(7)
    assert np.allclose(tangent, expected, rtol=0.0, atol=1e-13)


def test_parts_above_and_below_zero_make_up_the_whole() -> None:
    """max(g, 0) - max(-g, 0) = g, and the tangents of both add up to k."""
    gap = random_gaps(8, 4)
    integrals = ExactIntegrals(UnilateralPenalty(STIFFNESS), 8)
    (force, tangent), (mirrored, other) = (linearised(integrals, s * gap) for s in (1.0, -1.0))
    assert np.allclose(force - mirrored, STIFFNESS * gap, rtol=0.0, atol=1e-11)
    assert np.allclose(tangent + other, STIFFNESS[:, None, None] * np.eye(17), atol=1e-11)
    assert np.abs(force).min(axis=0).max() > 0.0


@pytest.mark.parametrize("samples", [None, 64])
def test_scaling(samples: int | None) -> None:
    """L times the gap: L times the force, the same tangent; L times the stiffness: L times both."""
    gap = random_gaps(5, 4)
    made = contact_integrals(UnilateralPenalty(STIFFNESS), 5, samples)
    force, tangent = linearised(made, gap)
    larger = linearised(made, 1e6 * gap)
    assert np.allclose(larger[0], 1e6 * force, rtol=1e-9, atol=1e-6)
    assert np.allclose(larger[1], tangent, rtol=0.0, atol=1e-9)
    law = UnilateralPenalty(STIFFNESS).scaled(1e3)
    stiffer = linearised(contact_integrals(law, 5, samples), gap)
    assert np.allclose(stiffer[0], 1e3 * force) and np.allclose(stiffer[1], 1e3 * tangent)


@pytest.mark.parametrize(
    ("law", "samples"),
    [(UnilateralPenalty, None), (UnilateralPenalty, 64), (lambda k: SmoothedPenalty(k, 5.0), 64)],
    ids=["exact", "sampled", "smoothed"],
)
def test_stiffness_of_each_pair(law: Callable[..., ContactLaw], samples: int | None) -> None:
    """Pairs with stiffnesses of their own give what each gives alone."""
    gap = random_gaps(5, 4)
    force, tangent = linearised(contact_integrals(law(STIFFNESS), 5, samples), gap)
    for pair, stiffness in enumerate(STIFFNESS):
        alone = contact_integrals(law(float(stiffness)), 5, samples)
        one_force, one_tangent = linearised(alone, gap[:, pair : pair + 1])
        assert np.allclose(force[:, pair], one_force[:, 0], rtol=0.0, atol=1e-12)
        assert np.allclose(tangent[pair], one_tangent[0], rtol=0.0, atol=1e-10)


def test_widened_integrals_see_the_same_wave() -> None:
    """With more harmonics the lower rows stay; the samples suffice for the higher ones."""
    gap, law = random_gaps(4, 4), UnilateralPenalty(STIFFNESS)
    padded = resized(gap, 16)
    exact = ExactIntegrals(law, 4)
    wide = exact.widened(16)
    force = wide.force(padded)
    assert wide.harmonics == 16 and force.shape == (33, 4)
    assert np.allclose(force[:9], exact.force(gap), rtol=0.0, atol=1e-12)
    sampled = SampledIntegrals(law, 4, 4096).widened(16)
    assert sampled.samples == 4096
    assert np.allclose(sampled.force(padded), force, rtol=0.0, atol=1e-4)
    few = SampledIntegrals(law, 4, 32).widened(100)
    assert few.harmonics == 100 and few.samples > 400


def test_choice_of_integrals() -> None:
    """Exact for the penalty law unless samples are given; the default samples grow with H."""
    penalty, smoothed = UnilateralPenalty(1.0), SmoothedPenalty(1.0, 1.0)
    assert isinstance(contact_integrals(penalty, 5), ExactIntegrals)
    chosen = contact_integrals(penalty, 5, 64)
    assert isinstance(chosen, SampledIntegrals) and chosen.samples == 64
    chosen = contact_integrals(smoothed, 5, periods=3)
    assert isinstance(chosen, SampledIntegrals) and chosen.samples == 3 * 1024
    assert default_samples(5) == default_samples(32) == 1024
    assert default_samples(33) == 2048


# --- forces that couple the pairs -----------------------------------------------------------------


RIGID = fc.UnilateralConstraint()
COUPLED = np.array([2.0, 300.0, 15.0])
LAWS = {
    "rigid": (RIGID, None),
    "penalty": (fc.UnilateralPenalty(COUPLED), None),
    "sampled": (fc.UnilateralPenalty(COUPLED), 256),
    "smoothed": (fc.SmoothedPenalty(COUPLED, 20.0), 256),
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
def test_coupled_samples_approach_with_second_order(pairs: int, harmonics: int) -> None:
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
def test_coupled_tangent_against_finite_differences(kind: str, harmonics: int) -> None:
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
        other = replace(made, law=law.scaled(np.exp(logarithm)))
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


# --- Fourier coefficients, and samples of them ----------------------------------------------------


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
    values = sampled(coefficients, 32)
    time = np.arange(32) * 2.0 * np.pi / 32
    assert np.allclose(values, evaluate(coefficients, 1.0, time), atol=1e-13)
    assert np.allclose(balanced(values, HARMONICS), coefficients, atol=1e-13)


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
