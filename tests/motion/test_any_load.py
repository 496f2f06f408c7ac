"""Loads of several harmonics: closed forms, an integration that shares no code, and curves."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import scipy.integrate
from helpers import catch_error, chain_stiffness, relative

import fenics_crack as fc

N, PAIRS = 6, 2
HARMONICS = {k: 1.0 / k**1.5 for k in range(2, 6)}
LAW = fc.UnilateralPenalty(20.0)


def loaded() -> fc.Structure:
    """A damped chain with two pairs under a mean load and five harmonics of all phases."""
    random = np.random.default_rng(5)
    stiffness, mass = chain_stiffness(random.uniform(1.0, 3.0, N + 1)), random.uniform(1.0, 2.0, N)
    gap = np.zeros((N, PAIRS))
    gap[[0, 1, 3, 4], [0, 0, 1, 1]] = -1.0, 1.0, -1.0, 1.0
    parts = {k: tuple(size * random.normal(size=(2, N))) for k, size in HARMONICS.items()}
    load_rows = random.normal(size=(3, N))
    structure = fc.Structure.from_matrices(
        np.diag(mass), stiffness, gap=gap, damping=0.1 * np.diag(mass) + 0.05 * stiffness,
        force_mean=0.3 * load_rows[0], force_cos=load_rows[1], force_sin=load_rows[2],
        clearance=0.05,
    )  # fmt: skip
    return structure.with_added_load_harmonics(parts)


def dense(structure: fc.Structure) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """M, C, K and B."""
    rows = range(N)
    matrices = structure.mass, structure.damping, structure.stiffness
    mass, damping, stiffness = (np.asarray(matrix.getValues(rows, rows)) for matrix in matrices)
    return mass, damping, stiffness, structure.gap.toarray()


def test_linear_answer() -> None:
    """Harmonic by harmonic (K - k^2 w^2 M + i k w C)^-1 f_k."""
    structure, omega = loaded(), 0.7
    solution = fc.solve_linear(structure, omega, harmonics=7)
    mass, damping, stiffness, _ = dense(structure)
    for k in range(8):
        row, harmonic_omega = 2 * k - 1, k * omega
        if k == 0:
            static_motion = np.linalg.solve(stiffness, structure.force[0])
            np.testing.assert_allclose(
                solution.displacement_coefficients[0], static_motion, rtol=1e-10
            )
            continue
        amplitude_rows = solution.displacement_coefficients[row : row + 2]
        if k > 5:
            assert not amplitude_rows.any()
            continue
        cosine, sine = structure.force[row : row + 2]
        impedance = stiffness - harmonic_omega**2 * mass + 1j * harmonic_omega * damping
        amplitude = np.linalg.solve(impedance, cosine - 1j * sine)
        assert relative(amplitude_rows, np.array([amplitude.real, -amplitude.imag])) < 1e-10


def followed(structure: fc.Structure, omega: float, state: np.ndarray, end: float) -> np.ndarray:
    """State (u, u') at the end of a motion, by an integrator of order 8."""
    mass, damping, stiffness, gap = dense(structure)
    waves = structure.force

    def rate(time: float, z: np.ndarray) -> np.ndarray:
        k = np.arange(1, len(waves) // 2 + 1)
        load = (
            waves[0]
            + np.cos(k * omega * time) @ waves[1::2]
            + np.sin(k * omega * time) @ waves[2::2]
        )
        u, v = np.split(z, 2)
        force = LAW.stiffness * np.maximum(gap.T @ u - structure.clearance, 0.0)
        return np.concatenate(
            [v, np.linalg.solve(mass, load - damping @ v - stiffness @ u - gap @ force)]
        )

    integration = scipy.integrate.solve_ivp(
        rate, (0.0, end), state, method="DOP853", rtol=1e-12, atol=1e-13, max_step=end / 300
    )
    return np.asarray(integration.y[:, -1])


def test_exact_orbit_against_integration() -> None:
    structure, omega = loaded(), 0.8
    orbit = fc.solve_harmonic_balance(structure, omega, LAW, tolerance=1e-3).orbit
    assert orbit is not None and orbit.n_events >= 4
    shapes = orbit.flow.modal_model.shapes.T
    start = np.concatenate([part @ shapes for part in np.split(orbit.state, 2)])
    end_state = followed(structure, omega, start, orbit.period)
    assert relative(end_state[:N], orbit.displacement_at(np.array([orbit.period]))[0]) < 1e-8


def test_harmonic_balance_within_its_stated_error() -> None:
    structure, omega = loaded(), 0.8
    exact = fc.solve_harmonic_balance(structure, omega, LAW, tolerance=1e-4).orbit
    for harmonics in (5, 10, 20):
        solution = fc.solve_harmonic_balance(structure, omega, LAW, harmonics=harmonics)
        gap = exact.period_samples.gap + structure.clearance
        error = relative(
            solution.gap(exact.period_samples.time) - exact.period_samples.gap + gap, gap
        )
        assert error <= 2.0 * solution.report.total + 1e-6
    catch_error(
        lambda: fc.solve_harmonic_balance(structure, omega, LAW, harmonics=4),
        "harmonics",
        4,
        names=" 5$",
    )


def test_integrators_converge_to_the_orbit() -> None:
    structure, omega = loaded(), 0.8
    exact = fc.solve_harmonic_balance(structure, omega, LAW, tolerance=1e-3)
    goal = exact.orbit.coefficients(5).displacement
    for method in (fc.integrate_central_difference, fc.integrate_exponential):
        errors = []
        for steps in (512, 1024):
            history = method(
                structure, omega, LAW, periods=90, steps_per_period=steps, settle=1e-12
            )
            phase = omega * history.time[-steps:]
            errors.append(relative(fourier(phase, history.recorded[-steps:], 5), goal))
        assert errors[1] < 1e-3 and 3.0 < errors[0] / errors[1] < 5.0


def fourier(phase: np.ndarray, values: np.ndarray, harmonics: int) -> np.ndarray:
    """Rows a0, a1, b1, ... of values at phases, equal parts of a period."""
    rows = [np.mean(values, axis=0)]
    for k in range(1, harmonics + 1):
        rows += [2.0 * wave(k * phase) @ values / len(values) for wave in (np.cos, np.sin)]
    return np.array(rows)


def test_curves() -> None:
    """Points of curves over the frequency and the load are the solutions there."""
    structure = loaded()
    curve = fc.continue_frequency(structure, 0.7, 0.9, LAW, tolerance=1e-3)
    assert curve.complete
    for index in (len(curve) // 3, len(curve) - 2):
        solution = fc.solve_harmonic_balance(
            structure, float(curve.omega[index]), LAW, tolerance=1e-3
        )
        assert solution.amplitude() == pytest.approx(curve.solution(index).amplitude(), rel=1e-3)
    twice = fc.continue_parameter(structure, 0.8, LAW, "load", 1.0, 2.0, harmonics=12)
    solution = fc.solve_harmonic_balance(structure.varied(load=2.0), 0.8, LAW, harmonics=12)
    assert twice.solution(len(twice) - 1).amplitude() == pytest.approx(
        solution.amplitude(), rel=1e-8
    )


# --- by a table -----------------------------------------------------------------------------------


def test_square_wave() -> None:
    """4 / (pi k) of odd orders; what K harmonics leave out, by Parseval."""
    time, values = [2.0, 3.0, 3.0, 4.0], [1.0, 1.0, -1.0, -1.0]
    for count in (1, 7, 20):
        coefficients, error = fc.load_harmonics(time, values, count)
        odd_orders = np.arange(1, count + 1, 2)
        exact_coefficients = np.zeros(2 * count + 1)
        exact_coefficients[2 * odd_orders] = 4.0 / (np.pi * odd_orders)
        np.testing.assert_allclose(coefficients, exact_coefficients, atol=1e-15)
        rest_square = 1.0 - 0.5 * np.sum((4.0 / (np.pi * odd_orders)) ** 2)
        assert error == pytest.approx(np.sqrt(rest_square), rel=1e-10)


def test_table_of_unequal_times() -> None:
    """A cosine by ever finer samples: order 2; columns apart; a mean is no error."""
    errors = []
    for count in (50, 100):
        time = np.sort(np.append(np.random.default_rng(1).uniform(0, 1, count), [0.0, 1.0]))
        values = np.column_stack([3.0 + np.cos(2 * np.pi * time), np.sin(6 * np.pi * time)])
        coefficients, error = fc.load_harmonics(time, values, 3)
        exact_coefficients = np.zeros((7, 2))
        exact_coefficients[0, 0], exact_coefficients[1, 0], exact_coefficients[6, 1] = 3.0, 1.0, 1.0
        errors.append(float(np.abs(coefficients - exact_coefficients).max()))
        assert error < 0.2
    assert errors[1] < 0.5 * errors[0] < 0.05
    assert fc.load_harmonics([0.0, 1.0], [2.0, 2.0], 2)[1] == 0.0


@pytest.mark.parametrize(
    ("time", "values", "key"),
    [([0.0, 2.0, 1.0], [1.0, 2.0, 3.0], "time"), ([0.0], [1.0], "time"),
     ([0.0, 1.0], [1.0, 2.0, 3.0], "values"), ([0.0, 1.0], [1.0, np.nan], "values")],
)  # fmt: skip
def test_bad_tables(time: list[float], values: list[float], key: str) -> None:
    catch_error(lambda: fc.load_harmonics(time, values, 3), key)


def test_bad_harmonics() -> None:
    structure = fc.Structure.from_matrices(np.eye(3), np.eye(3), gap=None)
    for harmonics, key, value in (
        ({0: (None, None)}, "order in harmonics", 0),
        ({2: (np.zeros(2), None)}, "harmonics[2]", (2,)),
        ({2: 1.0}, "harmonics[2]", 1.0),
        ([1], "harmonics", [1]),
    ):
        catch_error(partial(structure.with_added_load_harmonics, harmonics), key, value)
