"""Parts of harmonic balance that the public face does not show: integrals of contact forces,
dynamic stiffness, starts of a search, indicators of known coefficients."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from helpers import (
    catch_error,
    chain,
    dense,
    dense_matrices,
    log_slope,
    oscillator,
    random_stiffness,
    relative,
)
from mpi4py import MPI
from scipy.integrate import quad
from switching import switching_instants
from test_indicators import bilinear_wave
from test_to_tolerance import OMEGA, bouncing

import fenics_crack as fc
from fenics_crack import (
    ContactLaw,
    ConvergenceError,
    ModalDamping,
    RayleighDamping,
    Scene,
    SmoothedPenalty,
    Structure,
    UnilateralPenalty,
    build_structure,
    solve_modes,
)
from fenics_crack.balance.compliance import (
    DEFLATION_BAND,
    FactorisedDynamicStiffness,
    make_compliance_model,
)
from fenics_crack.balance.contact_integrals import (
    CoupledIntegrals,
    ExactIntegrals,
    PairIntegrals,
    SampledIntegrals,
    default_instants_per_period,
    integrals_with_uncoupled_pairs,
)
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.model.modes import modes_with_modal_damping, multiply_columns
from fenics_crack.model.nodes import Pairs
from fenics_crack.motion.motions import Indicators, MotionRecord, ObservedMotion
from fenics_crack.numerics.fourier import (
    evaluate_series,
    fourier_coefficients,
    from_complex,
    n_instants_for_products,
    resize_harmonics,
    sample_period,
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
        theta = np.array([phase[np.argmax(evaluate_series(gap[:, pair], 1.0, phase))]])
        order = np.arange(harmonics + 1)
        for _ in range(8):  # Newton's method for g' = 0
            wave = to_complex(gap[:, pair]) * np.exp(1j * order * theta[0])
            theta += np.sum(order * wave.imag) / -np.sum(order**2 * wave.real)
        gap[0, pair] += depth[pair] - evaluate_series(gap[:, pair], 1.0, theta)[0]
    return gap


def linearised(integrals: PairIntegrals, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forces and their tangent."""
    point = integrals.linearise(gap)
    return point.force, point.tangent


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
    force_rows = ExactIntegrals(UnilateralPenalty(STIFFNESS), harmonics).force(gap)
    events = switching_instants(to_complex(gap))
    for pair in range(4):
        instants = np.sort(events.theta[events.pair == pair])
        assert len(instants) >= 2

        def force(t: float, pair: int = pair) -> float:
            return float(
                STIFFNESS[pair] * max(evaluate_series(gap[:, pair], 1.0, np.array([t]))[0], 0.0)
            )

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
            expected_force = integral / np.pi * (0.5 if row == 0 else 1.0)
            assert force_rows[row, pair] == pytest.approx(
                expected_force, abs=1e-11 * STIFFNESS[pair]
            )


def test_samples_approach_the_exact_force_with_second_order() -> None:
    """Root mean square over 50 gaps: N^-2 from 64 to 16384 samples, down to 1e-8."""
    harmonics = 6
    gap, law = random_gaps(harmonics, 50), UnilateralPenalty(1.0)
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
    force_rows = SampledIntegrals(law, 3, 1024).force(gap)[:, 0]

    def force(t: float) -> float:
        return float(law.force(evaluate_series(gap[:, 0], 1.0, np.array([t])))[0])

    weights = [lambda t: 0.5, np.cos, np.sin, lambda t: np.cos(2 * t), lambda t: np.sin(2 * t)]
    for row, weight in enumerate(weights):
        integral, _ = quad(
            lambda t, w=weight: force(t) * w(t), 0.0, 2.0 * np.pi, epsabs=1e-12, limit=200
        )
        assert force_rows[row] == pytest.approx(integral / np.pi, abs=1e-10)


@pytest.mark.parametrize("harmonics", [1, 4, 12])
@pytest.mark.parametrize("kind", ["exact", "sampled", "smoothed"])
def test_tangent_against_finite_differences(kind: str, harmonics: int) -> None:
    """All couplings of the harmonics of 4 pairs, to 1e-6 of the stiffness."""
    penalty, smoothed_law = UnilateralPenalty(STIFFNESS), SmoothedPenalty(STIFFNESS, 5.0)
    integrals = {
        "exact": ExactIntegrals(penalty, harmonics),
        "sampled": SampledIntegrals(penalty, harmonics, 64),
        "smoothed": SampledIntegrals(smoothed_law, harmonics, 64),
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
        shifted_gaps = [gap + np.array([[sign * h], [0.0], [0.0]]) for h in steps]
        start = integrals.force(gap)[0, 0]
        forces = np.array([integrals.force(g)[0, 0] for g in shifted_gaps])
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
        upper_tangent, lower_tangent = (
            integrals.linearise(grazing_gaps(np.full(5, side * depth))).tangent
            for side in (1.0, -1.0)
        )
        jumps.append(np.linalg.norm(upper_tangent - lower_tangent))
    assert log_slope(depths, jumps) == pytest.approx(0.5, abs=0.02)


def test_always_closed_and_always_open() -> None:
    """lambda = k g and the tangent k on all rows where the pair never opens; else both vanish."""
    gap = random_gaps(3, 4)
    gap[0] = [50.0, -50.0, 50.0, -50.0]
    force, tangent = linearised(ExactIntegrals(UnilateralPenalty(STIFFNESS), 3), gap)
    closed_share = np.array([1.0, 0.0, 1.0, 0.0])
    assert np.allclose(force, closed_share * STIFFNESS * gap, rtol=0.0, atol=1e-11)
    expected_tangent = (closed_share * STIFFNESS)[:, None, None] * np.eye(7)
    assert np.allclose(tangent, expected_tangent, rtol=0.0, atol=1e-13)


def test_parts_above_and_below_zero_make_up_the_whole() -> None:
    """max(g, 0) - max(-g, 0) = g, and the tangents of both add up to k."""
    gap = random_gaps(8, 4)
    integrals = ExactIntegrals(UnilateralPenalty(STIFFNESS), 8)
    (force, tangent), (mirrored_force, mirrored_tangent) = (
        linearised(integrals, s * gap) for s in (1.0, -1.0)
    )
    assert np.allclose(force - mirrored_force, STIFFNESS * gap, rtol=0.0, atol=1e-11)
    assert np.allclose(
        tangent + mirrored_tangent, STIFFNESS[:, None, None] * np.eye(17), atol=1e-11
    )
    assert np.abs(force).min(axis=0).max() > 0.0


@pytest.mark.parametrize("samples", [None, 64])
def test_scaling(samples: int | None) -> None:
    """L times the gap: L times the force, the same tangent; L times the stiffness: L times both."""
    gap = random_gaps(5, 4)
    integrals = integrals_with_uncoupled_pairs(UnilateralPenalty(STIFFNESS), 5, samples)
    force, tangent = linearised(integrals, gap)
    scaled_point = linearised(integrals, 1e6 * gap)
    assert np.allclose(scaled_point[0], 1e6 * force, rtol=1e-9, atol=1e-6)
    assert np.allclose(scaled_point[1], tangent, rtol=0.0, atol=1e-9)
    law = UnilateralPenalty(STIFFNESS).scaled(1e3)
    stiffer = linearised(integrals_with_uncoupled_pairs(law, 5, samples), gap)
    assert np.allclose(stiffer[0], 1e3 * force) and np.allclose(stiffer[1], 1e3 * tangent)


@pytest.mark.parametrize(
    ("law", "samples"),
    [(UnilateralPenalty, None), (UnilateralPenalty, 64), (lambda k: SmoothedPenalty(k, 5.0), 64)],
    ids=["exact", "sampled", "smoothed"],
)
def test_stiffness_of_each_pair(law: Callable[..., ContactLaw], samples: int | None) -> None:
    """Pairs with stiffnesses of their own give what each gives alone."""
    gap = random_gaps(5, 4)
    force, tangent = linearised(integrals_with_uncoupled_pairs(law(STIFFNESS), 5, samples), gap)
    for pair, stiffness in enumerate(STIFFNESS):
        pair_integrals = integrals_with_uncoupled_pairs(law(float(stiffness)), 5, samples)
        one_force, one_tangent = linearised(pair_integrals, gap[:, pair : pair + 1])
        assert np.allclose(force[:, pair], one_force[:, 0], rtol=0.0, atol=1e-12)
        assert np.allclose(tangent[pair], one_tangent[0], rtol=0.0, atol=1e-10)


def test_widened_integrals_see_the_same_wave() -> None:
    """With more harmonics the lower rows stay; the samples suffice for the higher ones."""
    gap, law = random_gaps(4, 4), UnilateralPenalty(STIFFNESS)
    padded_gap = resize_harmonics(gap, 16)
    exact = ExactIntegrals(law, 4)
    wide_integrals = exact.with_harmonics(16)
    force = wide_integrals.force(padded_gap)
    assert wide_integrals.harmonics == 16 and force.shape == (33, 4)
    assert np.allclose(force[:9], exact.force(gap), rtol=0.0, atol=1e-12)
    sampled_integrals = SampledIntegrals(law, 4, 4096).with_harmonics(16)
    assert sampled_integrals.samples == 4096
    assert np.allclose(sampled_integrals.force(padded_gap), force, rtol=0.0, atol=1e-4)
    coarse_integrals = SampledIntegrals(law, 4, 32).with_harmonics(100)
    assert coarse_integrals.harmonics == 100 and coarse_integrals.samples > 400


def test_choice_of_integrals() -> None:
    """Exact for the penalty law unless samples are given; the default samples grow with H."""
    penalty, smoothed_law = UnilateralPenalty(1.0), SmoothedPenalty(1.0, 1.0)
    assert isinstance(integrals_with_uncoupled_pairs(penalty, 5), ExactIntegrals)
    integrals = integrals_with_uncoupled_pairs(penalty, 5, 64)
    assert isinstance(integrals, SampledIntegrals) and integrals.samples == 64
    integrals = integrals_with_uncoupled_pairs(smoothed_law, 5, n_load_periods=3)
    assert isinstance(integrals, SampledIntegrals) and integrals.samples == 3 * 1024
    assert default_instants_per_period(5) == default_instants_per_period(32) == 1024
    assert default_instants_per_period(33) == 2048


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
    return CoupledIntegrals(
        law, harmonics, residual_compliance=residual(3), samples=samples, **options
    )


def difference(function: Any, place: Any, step: Any) -> np.ndarray:
    """Central difference of a function along a step."""
    return 0.5 * (function(place + step) - function(place - step))


@pytest.mark.parametrize("mean", [0.0, 100.0, -100.0])
def test_products_with_the_tangent(mean: float) -> None:
    """As a matrix, and in a basis, exact and sampled; also without any event, and after another
    point has been asked for."""
    gap, change = random_gaps(4, 3, 2), random_gaps(4, 3, 5)
    gap[0] = mean
    basis = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 2)))[0]
    for kind in ("rigid", "smoothed"):
        contact = integrals(kind, 4)
        forces, change_forces = contact.linearise(gap), contact.linearise(change)
        matrix = forces.tangent().reshape(27, 27)
        assert np.allclose(forces.force_change(change).ravel(), matrix @ change.ravel(), atol=1e-9)
        projected_product = forces.tangent(basis).reshape(18, 18) @ change[:, :2].ravel()
        expected_product = (matrix @ (change[:, :2] @ basis.T).ravel()).reshape(9, 3) @ basis
        assert np.allclose(projected_product, expected_product.ravel(), atol=1e-9)
        assert np.array_equal(
            change_forces.force_change(gap), contact.linearise(change).force_change(gap)
        )


# --- forces ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", ["rigid", "penalty"])
def test_exact_force_by_gauss_between_events(law: str) -> None:
    """All coefficients of three pairs, the instants of events found by bisection, to 1e-11."""
    harmonics, contact = 4, integrals(law, 4)
    gap = random_gaps(harmonics, 3, 2)
    grid = np.linspace(0.0, 2.0 * np.pi, 4097)
    _, closed_sets = contact.active_set_solver.solve(evaluate_series(gap, 1.0, grid))
    events = []
    for place in np.flatnonzero(np.any(closed_sets[1:] != closed_sets[:-1], axis=1)):
        lower_theta, upper_theta = grid[place], grid[place + 1]
        for _ in range(60):
            middle = 0.5 * (lower_theta + upper_theta)
            middle_set = contact.active_set_solver.solve(
                evaluate_series(gap, 1.0, np.array([middle]))
            )[1][0]
            lower_theta, upper_theta = (
                (middle, upper_theta)
                if np.array_equal(middle_set, closed_sets[place])
                else (lower_theta, middle)
            )
        events.append(lower_theta)
    assert len(events) >= 6
    ends = np.unique(np.concatenate([[0.0], events, np.linspace(0.0, 2.0 * np.pi, 9)]))
    nodes, weights = np.polynomial.legendre.leggauss(24)
    expected_force = np.zeros_like(gap)
    for lower_theta, upper_theta in pairwise(ends):
        theta = 0.5 * (lower_theta + upper_theta) + 0.5 * (upper_theta - lower_theta) * nodes
        force = (
            contact.forces_at_gap_samples(evaluate_series(gap, 1.0, theta))
            * (0.5 * (upper_theta - lower_theta) * weights)[:, None]
        )
        expected_force[0] += force.sum(axis=0) / (2.0 * np.pi)
        for k in range(1, harmonics + 1):
            expected_force[2 * k - 1] += np.cos(k * theta) @ force / np.pi
            expected_force[2 * k] += np.sin(k * theta) @ force / np.pi
    assert relative(contact.linearise(gap).force, expected_force) < 1e-11


@pytest.mark.parametrize(("pairs", "harmonics"), [(2, 8), (6, 4), (20, 3)])
def test_coupled_samples_approach_with_second_order(pairs: int, harmonics: int) -> None:
    """From 64 to 16384 samples, the mean over eight waves; down to 1e-6."""
    compliance, counts = residual(pairs), 2 ** np.arange(6, 15, 2)
    errors = np.zeros(len(counts))
    for seed in range(8):
        gap = random_gaps(harmonics, pairs, seed)
        contact = CoupledIntegrals(RIGID, harmonics, residual_compliance=compliance)
        exact = contact.force(gap)
        for place, count in enumerate(counts):
            sampled_force = replace(contact, samples=int(count)).force(gap)
            errors[place] += relative(sampled_force, exact) / 8.0
    assert log_slope(counts, errors) == pytest.approx(-2.0, abs=0.15)
    assert errors[-1] < 1e-6


@pytest.mark.parametrize("softness", [0.0, 0.7])
@pytest.mark.parametrize("stiffness", [np.inf, 5.0])
def test_one_pair_is_a_penalty_behind_a_spring(stiffness: float, softness: float) -> None:
    """R_inf and 1/k in series: the force, and its derivative, of 1 / (R_inf + 1/k)."""
    law = RIGID if np.isinf(stiffness) else fc.UnilateralPenalty(stiffness)
    compliance = 0.4 + 1.0 / stiffness
    spring_integrals = ExactIntegrals(
        fc.UnilateralPenalty(1.0 / (compliance * (1.0 + softness))), 7
    )
    for seed in range(4):
        gap = random_gaps(7, 1, seed)
        options: dict[str, Any] = {
            "residual_compliance": np.full((1, 1), 0.4),
            "relative_series_softness": softness,
        }
        forces = CoupledIntegrals(law, 7, **options).linearise(gap)
        pair, spring = (
            ExactIntegrals(law, 7, **options).linearise(gap),
            spring_integrals.linearise(gap),
        )
        for point in (forces, pair):
            assert relative(point.force, spring.force) < 1e-12
        assert relative(forces.tangent()[:, 0], spring.tangent[0]) < 1e-11
        assert relative(pair.tangent, spring.tangent) < 1e-12
        coupled_slope, pair_slope = (point.series_softness_derivative() for point in (forces, pair))
        assert np.allclose(coupled_slope, pair_slope, rtol=1e-10, atol=1e-12)


def test_grazing_contact_against_a_penalty() -> None:
    """Peaks 1e-4 to 1e-8 above and below zero: the force of the search for single pairs."""
    for depth in (1e-4, -1e-4, 1e-6, 1e-8):
        gaps = grazing_gaps(np.full(10, depth))
        for column in range(10):
            gap = gaps[:, [column]]
            for sign in (1.0, -1.0):
                point = CoupledIntegrals(RIGID, 4, residual_compliance=np.eye(1)).linearise(
                    sign * gap
                )
                force = ExactIntegrals(fc.UnilateralPenalty(1.0), 4).force(sign * gap)
                assert np.abs(point.force - force).max() < 1e-13
                assert np.any(point.force) == (depth > 0.0 or sign < 0.0)


def test_smoothed_force_by_quadrature() -> None:
    """lambda(s(t)) of one pair times each wave, by QUADPACK."""
    law, compliance = fc.SmoothedPenalty(3.0, 4.0), np.full((1, 1), 0.2)
    contact, gap = CoupledIntegrals(law, 2, residual_compliance=compliance), random_gaps(2, 1)
    force = contact.linearise(gap).force[:, 0]

    def products(t: float) -> np.ndarray:
        waves = np.array([0.5, np.cos(t), np.sin(t), np.cos(2 * t), np.sin(2 * t)])
        return waves * contact.forces_at_gap_samples(evaluate_series(gap, 1.0, np.array([t])))[0, 0]

    integrals, _ = scipy.integrate.quad_vec(products, 0.0, 2.0 * np.pi, epsabs=1e-11, limit=200)
    assert force == pytest.approx(integrals / np.pi, abs=1e-9)


# --- derivatives ----------------------------------------------------------------------------------


@pytest.mark.parametrize("harmonics", [1, 5])
@pytest.mark.parametrize("kind", LAWS)
def test_coupled_tangent_against_finite_differences(kind: str, harmonics: int) -> None:
    """All couplings of harmonics and pairs, to 1e-6 of the largest; T v is the matrix times v."""
    contact, gap = integrals(kind, harmonics), random_gaps(harmonics, 3, harmonics)
    forces = contact.linearise(gap)
    matrix = forces.tangent().reshape(len(gap), 3, len(gap), 3)
    for row in range(len(gap)):
        for pair in range(3):
            unit = np.zeros_like(gap)
            unit[row, pair] = 1.0
            slope = difference(lambda s: contact.linearise(s).force, gap, 1e-6 * unit) / 1e-6
            assert np.abs(matrix[:, :, row, pair] - slope).max() < 2e-6 * np.abs(matrix).max()
    change = np.random.default_rng(1).normal(size=gap.shape)
    assert relative(forces.force_change(change), np.tensordot(matrix, change, 2)) < 1e-12
    if harmonics > 1:  # pairs and harmonics are coupled
        assert np.abs(matrix[1, 0, 4, 1]) > 1e-4 * np.abs(matrix).max()


@pytest.mark.parametrize("softness", [0.0, 0.5])
@pytest.mark.parametrize("kind", LAWS)
def test_derivatives_by_softness_and_stiffness(kind: str, softness: float) -> None:
    """By central differences; a rigid law has no stiffness to depend on."""
    gap, contact = random_gaps(5, 3, 3), integrals(kind, 5, relative_series_softness=softness)
    forces, step = contact.linearise(gap), 1e-5
    slope = forces.series_softness_derivative()
    shifted_forces = [
        contact.with_series_softness(softness + s * step).linearise(gap).force for s in (1.0, -1.0)
    ]
    assert relative((shifted_forces[0] - shifted_forces[1]) / (2.0 * step), slope) < 1e-5
    if kind == "rigid":
        assert not np.any(forces.log_stiffness_derivative())
        return
    law = contact.law

    def scaled(logarithm: float) -> np.ndarray:
        scaled_contact = replace(contact, law=law.scaled(np.exp(logarithm)))
        # Softness is measured in the compliance, which changes here: kept in metres per newton.
        softened_contact = scaled_contact.with_series_softness(
            softness * contact.mean_pair_compliance / scaled_contact.mean_pair_compliance
        )
        return softened_contact.linearise(gap).force

    assert relative(difference(scaled, 0.0, step) / step, forces.log_stiffness_derivative()) < 1e-5


def test_widened_keeps_the_forces() -> None:
    """More harmonics: the first ones stay, exact or by enough samples."""
    for kind in LAWS:
        gap = random_gaps(4, 3)
        padded_gap = np.vstack([gap, np.zeros((8, 3))])
        contact = integrals(kind, 4, relative_series_softness=0.2)
        contact = contact if kind == "sampled" else replace(contact, samples=None)
        force = contact.with_harmonics(8).linearise(padded_gap).force[:9]
        assert relative(force, contact.linearise(gap).force) < (1e-3 if kind == "sampled" else 1e-9)


def test_many_pairs_and_sets() -> None:
    """Forty pairs, hundreds of sets: the forces of many samples, and the tangent along a change."""
    compliance, gap = residual(40), random_gaps(4, 40)
    contact = CoupledIntegrals(RIGID, 4, residual_compliance=compliance)
    exact = contact.linearise(gap)
    assert relative(replace(contact, samples=1 << 13).linearise(gap).force, exact.force) < 1e-5
    change = 1e-6 * np.random.default_rng(1).normal(size=gap.shape)
    slope = difference(lambda s: contact.linearise(s).force, gap, change)
    assert relative(exact.force_change(change), slope) < 1e-5


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
    assert np.allclose(
        (phases @ harmonics).real, evaluate_series(coefficients, omega, time), atol=1e-13
    )
    assert np.array_equal(from_complex(harmonics), coefficients)


def test_sampling_and_balancing_are_inverse(coefficients: np.ndarray) -> None:
    """Samples are values at i T / N, and a band-limited wave comes back exactly."""
    values = sample_period(coefficients, 32)
    time = np.arange(32) * 2.0 * np.pi / 32
    assert np.allclose(values, evaluate_series(coefficients, 1.0, time), atol=1e-13)
    assert np.allclose(fourier_coefficients(values, HARMONICS), coefficients, atol=1e-13)


@pytest.mark.parametrize("harmonics", [0, 1, 6, 70])
def test_products_are_ffts(harmonics: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Values and coefficients are the same by matrices of waves and by FFTs; and as many instants
    as `instants` says give means of products without aliasing."""
    wave, second_wave = np.random.default_rng(3).normal(size=(2, 2 * harmonics + 1, 4))
    results_by_count = []
    for limit in (10**6, 0):
        monkeypatch.setattr("fenics_crack.numerics.fourier.MAX_MATRIX_ENTRIES", limit)
        count = n_instants_for_products(harmonics)
        assert count > 4 * harmonics
        values = (
            sample_period(wave, 300),
            sample_period(second_wave, count) * sample_period(wave, count),
        )
        results_by_count.append(
            [
                values[0],
                fourier_coefficients(values[0], harmonics),
                fourier_coefficients(values[1], harmonics),
            ]
        )
    for matrix_result, fft_result in zip(*results_by_count, strict=True):
        np.testing.assert_allclose(matrix_result, fft_result, atol=1e-12)
    np.testing.assert_allclose(results_by_count[0][1], wave, atol=1e-12)
    time = np.arange(300) * 2.0 * np.pi / 300
    np.testing.assert_allclose(results_by_count[0][0], evaluate_series(wave, 1.0, time), atol=1e-11)


def test_resized_cuts_and_pads(coefficients: np.ndarray) -> None:
    """Harmonics are cut off at the end, and padded with zeros."""
    padded_rows = resize_harmonics(coefficients, HARMONICS + 2)
    assert np.array_equal(padded_rows[: len(coefficients)], coefficients)
    assert not np.any(padded_rows[len(coefficients) :])
    assert np.array_equal(resize_harmonics(padded_rows, HARMONICS), coefficients)
    assert len(resize_harmonics(coefficients, 2)) == 5


# --- dynamic stiffness and compliance -------------------------------------------------------------


N, N_PAIRS = 12, 3


def with_frequencies(omega: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Mass and stiffness, full, with given natural frequencies."""
    n = len(omega)
    shapes = np.eye(n) + 0.3 / np.sqrt(n) * np.random.default_rng(seed).standard_normal((n, n))
    inverse = np.linalg.inv(shapes)
    mass, stiffness = inverse.T @ inverse, inverse.T @ np.diag(omega**2) @ inverse
    return (mass + mass.T) / 2.0, (stiffness + stiffness.T) / 2.0


def random_structure(damping: Any = None, seed: int = 0) -> Structure:
    """A structure of N dofs with natural frequencies from 1 to 30 rad/s."""
    rng = np.random.default_rng(seed)
    omega = np.sort(rng.uniform(1.0, 30.0, N))
    gap = rng.standard_normal((N, N_PAIRS))
    return Structure.from_matrices(*with_frequencies(omega, seed), gap=gap, damping=damping)


def dense_stiffness(structure: Structure, omega: float) -> np.ndarray:
    """Z = K - omega^2 M + i omega C, from dense matrices."""
    mass, damping, stiffness = dense_matrices(structure)
    return stiffness - omega**2 * mass + 1j * omega * damping


def applied(structure: Structure, omega: float, amplitude: np.ndarray) -> np.ndarray:
    """Z u of amplitudes (m, n_local), from the distributed matrices (collective)."""

    def product(matrix: Any) -> np.ndarray:
        return (
            multiply_columns(matrix, amplitude.real.T)
            + 1j * multiply_columns(matrix, amplitude.imag.T)
        ).T

    product_rows = product(structure.stiffness) - omega**2 * product(structure.mass)
    if structure.damping_matrix is not None:
        product_rows += 1j * omega * product(structure.damping_matrix)
    if (modes := modes_with_modal_damping(structure)) is not None:
        modal_velocity = structure.sum_over_ranks(amplitude @ modes.mass_shapes)
        product_rows += 1j * omega * (modal_velocity * modes.damping_rates) @ modes.mass_shapes.T
    return product_rows


def modal_sum(structure: Structure, omega: float, rigid: int = 0) -> np.ndarray:
    """Z^-1 where all modes are damped: sum of phi phi^T / (omega_j^2 - omega^2 + ...).

    Nothing cancels in it, and nothing in it is nearly singular, however close omega is to omega_j.
    The first so many modes are rigid: their frequency is 0.
    """
    squares, shapes = scipy.linalg.eigh(dense(structure.stiffness), dense(structure.mass))
    squares[:rigid] = 0.0
    assert isinstance(structure.damping, ModalDamping) and structure.damping.modes is None
    rate = 2.0 * np.asarray(structure.damping.ratio) * np.sqrt(squares)
    return (shapes / (squares - omega**2 + 1j * omega * rate)) @ shapes.T


def relative_error(solution: np.ndarray, reference: np.ndarray) -> float:
    """Largest difference, relative to the largest entry."""
    return float(np.abs(solution - reference).max() / np.abs(reference).max())


RNG = np.random.default_rng(7)
DAMPINGS = {
    "none": None,
    "all modes": ModalDamping(0.02),
    "all modes, a ratio each": ModalDamping(RNG.uniform(0.0, 0.1, N).tolist()),
    "four modes": ModalDamping(0.02, 4),
    "four modes, a ratio each": ModalDamping([0.01, 0.0, 0.03, 0.1], 4),
    "Rayleigh": RayleighDamping(0.3, 0.002),
    "symmetric matrix": np.eye(N) + 0.1,
    "any matrix": RNG.standard_normal((N, N)),
}


# --- against dense matrices -----------------------------------------------------------------------


@pytest.mark.drawn(10)
@pytest.mark.parametrize("omega", [0.0, 0.5, 7.77, 20.0, 300.0])
@pytest.mark.parametrize("damping", DAMPINGS.values(), ids=DAMPINGS)
def test_against_dense_matrices(damping: Any, omega: float) -> None:
    """Z u, Z^-1 f and B^T Z^-1 B are those of the dense matrix, for real and complex amplitudes."""
    for seed in range(3):
        structure = random_structure(damping, seed)
        matrix = dense_stiffness(structure, omega)
        gap = structure.gap.toarray()
        rng = np.random.default_rng(seed)
        real_rows = rng.standard_normal((4, N))
        with FactorisedDynamicStiffness(structure, omega) as stiffness:
            for rows in (real_rows, real_rows + 1j * rng.standard_normal((4, N)), real_rows[:1]):
                assert relative_error(applied(structure, omega, rows), rows @ matrix.T) < 1e-12
                exact_solution = np.linalg.solve(matrix, rows.T).T
                assert relative_error(stiffness.solve(rows), exact_solution) < 1e-10
            exact_solution = gap.T @ np.linalg.solve(matrix, gap)
            assert relative_error(stiffness.pair_compliance_matrix(), exact_solution) < 1e-10


@pytest.mark.parametrize("damping", [None, ModalDamping(0.001), ModalDamping(0.001, 10)])
@pytest.mark.parametrize("omega", [0.0, 1000.0, 2000.0, 10000.0])
def test_paper_plate_against_dense_matrices(
    paper_structure: Structure, damping: ModalDamping | None, omega: float
) -> None:
    """The same on the paper's plate, sparse, with its load and between its resonances."""
    structure = paper_structure.damped(damping)
    matrix = dense_stiffness(structure, omega)
    gap = structure.gap.toarray()
    with FactorisedDynamicStiffness(structure, omega) as stiffness:
        solution = stiffness.solve(structure.force)
        assert relative_error(solution, np.linalg.solve(matrix, structure.force.T).T) < 1e-10
        assert relative_error(applied(structure, omega, solution), solution @ matrix.T) < 1e-12
        exact_compliance = gap.T @ np.linalg.solve(matrix, gap)
        assert relative_error(stiffness.pair_compliance_matrix(), exact_compliance) < 1e-10


@pytest.mark.parametrize("damping", DAMPINGS.values(), ids=DAMPINGS)
def test_symmetry_of_the_compliance(damping: Any) -> None:
    """Reciprocity: R = R^T, but for a damping matrix that is not symmetric itself."""
    with FactorisedDynamicStiffness(random_structure(damping), 7.77) as stiffness:
        compliance = stiffness.pair_compliance_matrix()
    asymmetry = relative_error(compliance, compliance.T)
    if isinstance(damping, np.ndarray) and not np.array_equal(damping, damping.T):
        assert asymmetry > 1e-3
    else:
        assert asymmetry < 1e-10


def test_dissipation() -> None:
    """Damping takes energy out: the imaginary part of f^T Z^-1 f is negative for every f."""
    for damping in (ModalDamping(0.02), np.eye(N)):
        with FactorisedDynamicStiffness(random_structure(damping), 7.77) as stiffness:
            work = stiffness.pair_compliance_matrix().imag
        assert np.linalg.eigvalsh((work + work.T) / 2.0).max() < 0.0


# --- at and near natural frequencies --------------------------------------------------------------
SAMPLE_OFFSETS = [
    0.0, 1e-15, -1e-15, 1e-12, 1e-8, -1e-8, 1e-5, 9e-4, 1.1e-3, -1.1e-3, 0.49 * DEFLATION_BAND,
    0.51 * DEFLATION_BAND, -0.51 * DEFLATION_BAND, 0.1,
]  # fmt: skip


def check_near_resonance(structure: Structure, mode: int, offset: float) -> None:
    """Z^-1 f and B^T Z^-1 B within 1e-8 where omega is relatively ``offset`` off a resonance."""
    omega = float(solve_modes(structure, mode + 1).omega[mode]) * (1.0 + offset)
    inverse = modal_sum(structure, omega)
    rng = np.random.default_rng(mode)
    gap = structure.gap.toarray()
    force = rng.standard_normal((2, structure.n_dofs)) + 1j * rng.standard_normal(structure.n_dofs)
    with FactorisedDynamicStiffness(structure, omega) as stiffness:
        assert relative_error(stiffness.solve(force), force @ inverse.T) < 1e-8
        assert relative_error(stiffness.pair_compliance_matrix(), gap.T @ inverse @ gap) < 1e-8


@pytest.mark.drawn(10)
@pytest.mark.parametrize("offset", SAMPLE_OFFSETS)
@pytest.mark.parametrize("ratio", [0.1, 0.001])
def test_near_a_resonance(ratio: float, offset: float) -> None:
    """Nothing is lost to cancellation, at a resonance or close to it."""
    for mode in (0, 5, N - 1):
        check_near_resonance(random_structure(ModalDamping(ratio)), mode, offset)


@pytest.mark.drawn(10)
@pytest.mark.parametrize("offset", SAMPLE_OFFSETS)
@pytest.mark.parametrize("ratio", [0.1, 0.001])
def test_paper_plate_near_a_resonance(
    paper_structure: Structure, ratio: float, offset: float
) -> None:
    """The same on the paper's plate, at its first, second and tenth frequency."""
    for mode in (0, 1, 9):
        check_near_resonance(paper_structure.damped(ModalDamping(ratio)), mode, offset)


@pytest.mark.drawn(10)
@pytest.mark.parametrize("offset", SAMPLE_OFFSETS)
@pytest.mark.parametrize("split", [0.0, 1e-12, 1e-7, 1e-3])
def test_near_several_resonances_at_once(split: float, offset: float) -> None:
    """A double frequency, and frequencies that nearly coincide, three of them."""
    omega = np.linspace(1.0, 20.0, N)
    omega[3:6] = omega[4] * np.array([1.0 - split, 1.0, 1.0 + split])
    gap = np.random.default_rng(0).standard_normal((N, N_PAIRS))
    structure = Structure.from_matrices(
        *with_frequencies(omega), gap=gap, damping=ModalDamping(0.01)
    )
    for mode in (3, 5):
        check_near_resonance(structure, mode, offset)


def test_near_resonances_with_different_damping() -> None:
    """Neighbours within the band keep the damping ratio of each."""
    omega = np.linspace(1.0, 20.0, N)
    omega[4] = omega[3] * (1.0 + 1e-4)
    ratios = np.linspace(0.001, 0.1, N)
    structure = Structure.from_matrices(
        *with_frequencies(omega), gap=np.eye(N)[:, :N_PAIRS], damping=ModalDamping(ratios)
    )
    for offset in SAMPLE_OFFSETS:
        check_near_resonance(structure, 3, offset)


@pytest.mark.parametrize("offset", SAMPLE_OFFSETS)
def test_near_a_resonance_of_the_damped_modes_alone(offset: float) -> None:
    """With few damped modes: LAPACK's solution of the dense system, which damping keeps regular."""
    structure = random_structure(ModalDamping([0.05, 0.02, 0.03, 0.1], 4))
    omega = float(solve_modes(structure, 2).omega[1]) * (1.0 + offset)
    matrix = dense_stiffness(structure, omega)
    force = np.random.default_rng(1).standard_normal((3, N))
    with FactorisedDynamicStiffness(structure, omega) as stiffness:
        assert relative_error(stiffness.solve(force), np.linalg.solve(matrix, force.T).T) < 1e-8


def test_deflated_undamped_mode() -> None:
    """Close to an undamped resonance the response is phi phi^T f / (omega_j^2 - omega^2)."""
    omega = np.arange(1.0, N + 1.0)
    ratios = np.where(omega == 3.0, 0.0, 0.01)
    structure = Structure.from_matrices(
        np.eye(N), np.diag(omega**2), gap=np.ones(N), damping=ModalDamping(ratios)
    )
    nearby_omega = 3.0 * (1.0 + 2.0**-20)
    with FactorisedDynamicStiffness(structure, nearby_omega) as stiffness:
        solution = stiffness.solve(np.eye(N))
    denominators = omega**2 - nearby_omega**2 + 2j * ratios * omega * nearby_omega
    denominators[2] = (3.0 - nearby_omega) * (3.0 + nearby_omega)
    np.testing.assert_allclose(solution, np.diag(1.0 / denominators), rtol=1e-8, atol=1e-9)


# --- refused --------------------------------------------------------------------------------------
@pytest.mark.parametrize("damping", [None, ModalDamping(0.01), np.eye(N)])
def test_free_structure(damping: Any) -> None:
    """A structure that can move as a rigid body has no static answer, and one at a frequency."""
    omega = np.append([0.0, 0.0], np.linspace(1.0, 20.0, N - 2))
    structure = Structure.from_matrices(*with_frequencies(omega), gap=np.ones(N), damping=damping)
    catch_error(
        lambda: FactorisedDynamicStiffness(structure, 0.0),
        names="rigid body",
        kind=ConvergenceError,
    )
    if isinstance(damping, ModalDamping):
        inverse = modal_sum(structure, 0.3, rigid=2)
    else:
        inverse = np.linalg.inv(dense_stiffness(structure, 0.3))
    with np.errstate(all="raise"), FactorisedDynamicStiffness(structure, 0.3) as stiffness:
        assert relative_error(stiffness.solve(np.eye(N)), inverse.T) < 1e-6


def test_a_light_stiff_part_is_no_rigid_body() -> None:
    """A sensor of 1e-9 kg on a mass, whose own frequency is 1e8 times the mass's: the static
    answer is the spring's."""
    mass, part_stiffness = 1e-9, 1e7
    stiffness = np.array(
        [[1.0 + part_stiffness, -part_stiffness], [-part_stiffness, part_stiffness]]
    )
    sensor = Structure.from_matrices(np.diag([1.0, mass]), stiffness, gap=[1.0, 0.0], damping=None)
    compliance = make_compliance_model(sensor, 0.5, 1)
    assert compliance.matrices[:, 0, 0].real == pytest.approx([1.0, 1.0 / 0.75], rel=1e-6)


@pytest.mark.parametrize("mode", [0, 4, N - 1])
def test_undamped_resonance(mode: int) -> None:
    """At a natural frequency that is exactly known, without damping, there is no answer."""
    omega = np.arange(1.0, N + 1.0)
    structure = Structure.from_matrices(np.eye(N), np.diag(omega**2), gap=np.ones(N))
    catch_error(
        lambda: FactorisedDynamicStiffness(structure, omega[mode]),
        names="undamped resonance",
        kind=ConvergenceError,
    )


@pytest.mark.parametrize("mode", [0, 1, 9])
def test_resonance_of_an_undamped_mode(paper_structure: Structure, mode: int) -> None:
    """At the natural frequency of a mode whose ratio is 0 the frequency is refused."""
    omega = solve_modes(paper_structure, 50).omega
    ratios = np.full(50, 0.01)
    ratios[mode] = 0.0
    for damping in (ModalDamping(0.0), ModalDamping(ratios)):
        catch_error(
            partial(FactorisedDynamicStiffness, paper_structure.damped(damping), omega[mode]),
            "omega",
        )


@pytest.mark.parametrize("omega", [-1.0, np.nan, np.inf])
def test_frequency_that_cannot_be(omega: float) -> None:
    """A frequency is finite and not negative."""
    catch_error(lambda: FactorisedDynamicStiffness(random_structure(), omega), "omega", omega)


# --- several ranks --------------------------------------------------------------------------------
def responses(scene: Scene, cases: list[Any], comm: MPI.Comm) -> list[Any]:
    """Static compliance and the load's response at the nodes by position (collective)."""
    built = build_structure(scene, comm)
    local = built.nodes.dofs - np.where(built.nodes.dofs >= 0, built.first_dof, 0)
    lip = np.append(built.gap.toarray().sum(axis=1), 0.0)[local[:, 1]]  # clamped: number -1
    places = gather_rows(comm, np.column_stack([built.nodes.points.round(9), lip.round(9)]))
    order = np.lexsort(places.T)
    results_by_case = []
    for ratio, modes, omega in cases:
        damped_structure = built.damped(None if ratio is None else ModalDamping(ratio, modes))
        with FactorisedDynamicStiffness(damped_structure, omega) as stiffness:
            response = stiffness.solve(built.force.astype(complex))
            load_rows = applied(damped_structure, omega, response)
            compliance = stiffness.pair_compliance_matrix()
        shape = gather_rows(comm, np.append(response[2], 0.0)[local])[order]
        residual = comm.allreduce(np.abs(load_rows - built.force).max(), MPI.MAX)
        results_by_case.append({"shape": shape, "compliance": compliance, "residual": residual})
    return results_by_case


@pytest.mark.mpi
def test_two_ranks_give_the_same_responses(
    on_ranks: Callable[..., Any], paper_scene: Scene, paper_structure: Structure
) -> None:
    """Response and compliance of the paper's plate, at a resonance too, are those of one rank."""
    first_omega, second_omega = solve_modes(paper_structure, 2).omega
    cases = [
        (None, None, 0.0),
        (None, None, 2000.0),
        (0.001, None, 2000.0),
        (0.001, 10, 2000.0),
        (0.01, None, float(first_omega)),
        (0.01, None, float(second_omega) * (1.0 + 1e-4)),
    ]
    parallel = on_ranks(responses, paper_scene, cases)
    for parallel_run, serial_run in zip(
        parallel, responses(paper_scene, cases, MPI.COMM_SELF), strict=True
    ):
        for name in ("shape", "compliance"):
            assert relative_error(parallel_run[name], serial_run[name]) < 1e-8
        assert (
            parallel_run["residual"] < 1e-6 and serial_run["residual"] < 1e-6
        )  # of a load of 100 N


def compliances(kinds: list[str], comm: MPI.Comm) -> list[np.ndarray]:
    """B^T Z^-1 B with some kinds of damping (collective)."""
    compliance_matrices = []
    for kind in kinds:
        structure = random_structure(damping := DAMPINGS[kind])
        mass, _, stiffness = dense_matrices(structure)
        distributed_structure = Structure.from_matrices(
            mass, stiffness, gap=structure.gap, damping=damping, comm=comm
        )
        with FactorisedDynamicStiffness(distributed_structure, 7.77) as dynamic:
            compliance_matrices.append(dynamic.pair_compliance_matrix())
    return compliance_matrices


@pytest.mark.mpi
def test_damping_matrix_on_two_ranks(on_ranks: Callable[..., Any]) -> None:
    """Spread over two ranks, one that is not symmetric and Rayleigh's give the dense compliance."""
    kinds = ["any matrix", "Rayleigh"]
    for kind, compliance in zip(kinds, on_ranks(compliances, kinds), strict=True):
        structure = random_structure(DAMPINGS[kind])
        gap = structure.gap.toarray()
        exact_compliance = gap.T @ np.linalg.solve(dense_stiffness(structure, 7.77), gap)
        assert relative_error(compliance, exact_compliance) < 1e-10


def test_reduced_chain_that_is_not_fixed() -> None:
    """A chain that is not fixed: K is singular; compliance at w > 0, and the linear response."""
    for damping in ("matrix", "none"):
        full_structure = chain(damping, 60, unconstrained=True)
        mode_omegas = fc.solve_modes(full_structure, 2).omega
        assert mode_omegas[0] < 1e-4 * mode_omegas[1]
        previous = np.inf
        for modes in (6, 12, 40):
            reduced_structure = fc.reduce_structure(full_structure, modes=modes)
            errors = []
            for factor in (0.5, 1.3, 2.5):
                omega = factor * mode_omegas[1]
                with (
                    FactorisedDynamicStiffness(reduced_structure, omega) as reduced_stiffness,
                    FactorisedDynamicStiffness(full_structure, omega) as full_stiffness,
                ):
                    errors.append(
                        relative(
                            reduced_stiffness.pair_compliance_matrix(),
                            full_stiffness.pair_compliance_matrix(),
                        )
                    )
            assert max(errors) < previous
            previous = max(errors)
        assert previous < 1e-5
        dofs = list(range(full_structure.n_dofs))
        motions = [
            fc.solve_linear(model, 1.3 * mode_omegas[1]).coefficients_at(dofs)
            for model in (reduced_structure, full_structure)
        ]
        assert relative(*motions) < 1e-3


# --- starts of a search ---------------------------------------------------------------------------


FREQUENCIES = np.linspace(0.3, 2.0, 300)


def prevent(monkeypatch: pytest.MonkeyPatch, *starts: str) -> None:
    """Let starts of a search have no guesses."""
    for start in starts:
        monkeypatch.setattr(f"fenics_crack.balance.problem.Search.{start}", lambda *_: iter(()))


@pytest.mark.parametrize("harmonics", [10, 20])
def test_lands_where_the_path_bends_at_its_end(
    harmonics: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Landing from the chord fails here, and the path does not come back: from its last point."""
    prevent(monkeypatch, "_yield_guesses_from_fewer_harmonics")
    structure = oscillator(0.02, 0.1)
    omega = FREQUENCIES[82]
    law = fc.UnilateralPenalty(10.0)
    solution = fc.solve_harmonic_balance(structure, omega, law, harmonics=harmonics)
    assert solution.status.endswith(
        f"continuation in the contact compliance: converged ({solution.iterations} iterations)"
    )
    assert solution.iterations < 500


def stopped_chain(pairs: int, damping: float) -> fc.Structure:
    """Six masses, the last ones next to stops."""
    stiffness = np.diag(np.full(6, 2.0)) - np.eye(6, k=1) - np.eye(6, k=-1)
    return fc.Structure.from_matrices(
        np.eye(6), stiffness, gap=np.eye(6)[:, -pairs:], force_cos=np.eye(6)[0],
        damping=damping * stiffness,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("start", "name", "omega", "law", "harmonics"),
    [
        (
            "_yield_guesses_from_fewer_harmonics",
            "full Newton steps",
            0.45,
            fc.SmoothedPenalty(1.0, 10.0),
            5,
        ),
        (
            "_yield_guesses_from_fewer_harmonics",
            "from fewer harmonics",
            0.45,
            fc.SmoothedPenalty(1.0, 10.0),
            40,
        ),
        (
            "_yield_guesses_by_continuation",
            "continuation in the contact compliance",
            0.9,
            fc.UnilateralPenalty(1e4),
            5,
        ),
    ],
)
def test_each_start_is_needed(
    start: str, name: str, omega: float, law: Any, harmonics: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a structure whose solution it finds: without it there is none, or it takes more than twice
    the iterations."""

    def solution() -> fc.PeriodicSolution:
        structure = stopped_chain(3, 2e-2)
        return fc.solve_harmonic_balance(structure, omega, law, harmonics=harmonics, throw=False)

    with_all_starts = solution()
    assert with_all_starts.converged and f"{name}: converged" in with_all_starts.status
    prevent(monkeypatch, start)
    without_start = solution()
    assert (
        not without_start.converged or without_start.iterations > 2 * with_all_starts.iterations
    ), without_start.status


def test_a_search_ends_and_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """294 unknowns, hardly damped, by a quarter of the iterations, besides those of five smaller
    numbers of harmonics: what was tried, what to do."""
    monkeypatch.setattr("fenics_crack.balance.problem.MAX_SEARCH_ITERATIONS", 1250)
    structure, law = stopped_chain(6, 2e-4), fc.UnilateralPenalty(1e3)
    solution = fc.solve_harmonic_balance(structure, 0.3, law, harmonics=24, throw=False)
    assert not solution.converged
    messages = solution.status.split("; ")
    assert [attempt.split(" (")[0] for attempt in messages[:2]] == [
        "from fewer harmonics: failed",
        "then continuation in the contact compliance: failed",
    ]
    assert messages[2] == (
        f"no solution in {solution.iterations} iterations: try other harmonics, a softer contact, "
        "more damping, or a neighbouring solution as initial"
    )
    assert solution.iterations < 1250 * (300 / 294) ** 2 + 20 + 5 * 28


# --- a tolerance that is missed -------------------------------------------------------------------


def test_tolerance_out_of_reach(soft_plate: fc.Structure, monkeypatch: pytest.MonkeyPatch) -> None:
    """The best solution is returned, with the word of what it lacks; it is solved all the same.
    With ``throw`` it is an error."""
    monkeypatch.setattr("fenics_crack.balance.harmonic_balance.MAX_HARMONICS", 40)
    law = fc.UnilateralPenalty(1e11)
    message = (
        r"solved; error [\d.]+ %, but 0.001 % was requested; what helps: more damping.* \(H = 40\)"
    )
    catch_error(
        lambda: fc.solve_harmonic_balance(soft_plate, 1000.0, law, tolerance=1e-5),
        names=message,
        kind=fc.ConvergenceError,
    )
    solution = fc.solve_harmonic_balance(soft_plate, 1000.0, law, tolerance=1e-5, throw=False)
    assert solution.converged and solution.harmonics == 40 and re.match(message, solution.status)
    assert 1e-5 < solution.report.total < 1e-2


def test_harmonics_out_of_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the tolerance asks for more harmonics than are kept, the best is returned, and says
    what it lacks."""
    structure, law = bouncing("three masses")
    monkeypatch.setattr("fenics_crack.balance.harmonic_balance.MAX_HARMONICS", 20)
    solution = fc.solve_harmonic_balance(
        structure, OMEGA["three masses"], law, tolerance=1e-3, throw=False
    )
    assert solution.converged and solution.harmonics == 20 and solution.report.total > 1e-3
    error_text = f"{100.0 * solution.report.total:.2g} %"
    words = f"solved; error {error_text}, but 0.1 % was requested; what helps: more"
    assert solution.status.startswith(words)


# --- indicators of known coefficients -------------------------------------------------------------


class Given(ObservedMotion):
    """A motion by its record."""

    structure = oscillator()

    def __init__(self, waves: np.ndarray, **given: Any) -> None:
        nothing = np.zeros((2, 0))
        values = {
            "omega": 7.0,
            "subharmonic": 1,
            "time": np.zeros(2),
            "coefficients": waves[:, None],
        }
        values |= {"row_products": np.array([[11.0], [-11.0]]), "gaps": nothing, "forces": nothing}
        self._record = MotionRecord(**values | {"structure": self.structure} | given)

    def yield_motion_records(self, rows: np.ndarray) -> Any:
        yield self._record


def indicators_of(waves: np.ndarray, **given: Any) -> Indicators:
    """Indicators of a displacement by its coefficients (2H+1,), and what else is given."""
    return Given(waves, **given).indicators()


def test_known_coefficients() -> None:
    """U_1 = 5, U_2 = 10, U_3 = 13, a0 = -2.5: ratios 2, 2.6 and -0.5."""
    indicators = indicators_of(np.array([-2.5, 3.0, 4.0, 6.0, -8.0, 5.0, 12.0]))
    assert (indicators.omega, indicators.amplitude, indicators.mean) == (7.0, 11.0, -2.5)
    assert (indicators.harmonic_1, indicators.harmonic_2, indicators.harmonic_3) == (
        5.0,
        10.0,
        13.0,
    )
    assert (indicators.ratio_2_1, indicators.ratio_3_1, indicators.mean_shift) == (2.0, 2.6, -0.5)
    assert (indicators.ratio_largest, indicators.largest_order) == (2.6, 3.0)
    assert np.isnan(
        [indicators.ratio_half_1, indicators.contact_force, indicators.closed_share]
    ).all()


@pytest.mark.parametrize(("periods", "half"), [(2, 2.0), (3, np.nan)])
def test_longer_periods(periods: int, half: float) -> None:
    """Rows count parts of the load's frequency: harmonic m is U_1, and m / 2 is U_1/2."""
    rows = np.zeros(2 * 3 * periods + 1)
    rows[1], rows[2 * periods], rows[4 * periods - 1], rows[6 * periods] = 6.0, 3.0, 1.5, 0.75
    indicators = indicators_of(rows, subharmonic=periods)
    assert (indicators.harmonic_1, indicators.ratio_2_1, indicators.ratio_3_1) == (3.0, 0.5, 0.25)
    assert (indicators.ratio_largest, indicators.largest_order) == (0.5, 2.0)
    np.testing.assert_equal(indicators.ratio_half_1, half)


@pytest.mark.parametrize(("first", "shift"), [(2.0, 0.5), (0.0, np.nan)])
def test_few_harmonics_and_no_motion(first: float, shift: float) -> None:
    """What is not known is nan, and no division warns."""
    indicators = indicators_of(np.array([1.0, first, 0.0]))
    np.testing.assert_equal(indicators.mean_shift, shift)
    assert np.isnan([indicators.ratio_2_1, indicators.ratio_3_1, indicators.harmonic_2]).all()
    assert np.isnan([indicators.ratio_largest, indicators.largest_order]).all()


@pytest.mark.parametrize(("second", "order"), [(1e-11, np.nan), (1e-9, 2.0)])
def test_rounding_has_no_largest_harmonic(second: float, order: float) -> None:
    """Of the whole motion, to which the mean belongs: 1e-13 of it is no harmonic, 1e-11 is one."""
    indicators = indicators_of(np.array([100.0, 1.0, 0.0, 0.0, second]))
    np.testing.assert_equal(indicators.largest_order, order)
    assert indicators.ratio_largest == second


def test_force_of_each_crack() -> None:
    """Pairs of one crack count together at each instant, those of another one by themselves."""
    force = np.array([[3.0, 0.0, 4.0], [2.0, 2.0, 0.0]])
    for cracks, crack_force in ((None, 7.0), ([0, 0, 1], 4.0), ([0, 1, 1], 4.0), ([0, 1, 2], 4.0)):
        pairs = Pairs(cracks=None if cracks is None else np.array(cracks))
        structure = oscillator().with_places(None, pairs)
        indicators = indicators_of(
            np.ones(3), gaps=-np.ones((2, 3)), forces=force, structure=structure
        )
        assert (indicators.contact_force, indicators.crack_force) == (4.0, crack_force)


@pytest.mark.parametrize("ratio", [1.2, 2.0, 4.0])
def test_wave_of_a_bilinear_oscillator(ratio: float) -> None:
    """Half sines of lengths A (peak -1) and B (peak 1/r) of the period, of which one alone has

    int_0^A sin(pi t / A) exp(-2 pi i k t) dt = A (1 + exp(-2 pi i k A)) / (pi (1 - 4 k^2 A^2)).
    """
    is_open, closed_share = ratio / (1.0 + ratio), 1.0 / (1.0 + ratio)

    def part(order: int) -> float:
        """|U_k| from the integral of each half sine, from t = 0 and from t = B."""

        def half_sine(length: float) -> complex:
            turn = np.exp(-2j * np.pi * order * length)
            return length / np.pi * (1.0 + turn) / (1.0 - 4.0 * (order * length) ** 2)

        shift = np.exp(-2j * np.pi * order * closed_share)
        return abs(2.0 * (half_sine(closed_share) / ratio - shift * half_sine(is_open)))

    wave = bilinear_wave(ratio, 8192)
    gap = wave[:, None]
    indicators = indicators_of(
        fourier_coefficients(wave, 5),
        time=wave,
        row_products=gap,
        gaps=gap,
        forces=np.maximum(gap, 0.0),
    )
    mean = 2.0 * closed_share / (np.pi * ratio) - 2.0 * is_open / np.pi
    assert indicators.harmonic_1 == pytest.approx(part(1), rel=1e-6)
    assert indicators.ratio_2_1 == pytest.approx(part(2) / part(1), rel=1e-6)
    assert indicators.ratio_3_1 == pytest.approx(part(3) / part(1), rel=1e-5)
    assert indicators.mean_shift == pytest.approx(mean / part(1), rel=1e-6)
    assert indicators.amplitude == pytest.approx((1.0 + 1.0 / ratio) / 2.0, rel=1e-5)
    assert indicators.closed_share == pytest.approx(closed_share, abs=1e-3)
    assert indicators.opening == pytest.approx(1.0, rel=1e-6)
    assert (
        indicators.penetration == indicators.contact_force == pytest.approx(1.0 / ratio, rel=1e-5)
    )
