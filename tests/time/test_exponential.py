"""Direct integration by exponential steps."""

from functools import partial
from typing import Any

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.optimize
from helpers import (
    DAMPINGS,
    catch_error,
    chain,
    dense_matrices,
    free_bar,
    log_slope,
    oscillator,
    relative,
)

import fenics_crack as fc
from fenics_crack import integrate_exponential

RIGID, PENALTY = fc.UnilateralConstraint(), fc.UnilateralPenalty(4.0)
COUNTS = (64, 128, 256, 512, 1024)


def massless(structure: fc.Structure, modes: int) -> fc.Structure:
    """Modes, and the static rest."""
    return fc.reduce_structure(structure, modes=modes, method="massless")


def by_runge_kutta(
    structure: fc.Structure, omega: float, springs: float, duration: float, instants: np.ndarray
) -> np.ndarray:
    """Gaps from rest by DOP853, contact at each instant by Lawson and Hanson's method."""
    rows, shapes, squares = structure.gap.toarray(), structure.shapes, structure.omega**2
    pairs, count, modal_rows = structure.n_pairs, len(squares), shapes.T @ rows
    damping = (
        np.diag(structure.modal_damping)
        if structure.modal_damping.ndim == 1
        else structure.modal_damping
    )
    residual = rows.T @ structure.residual_flexibility @ rows
    root = np.linalg.cholesky(residual + springs * np.eye(pairs))
    load, static_motion = structure.force @ shapes, structure.force @ structure.residual_flexibility

    def parts(t: float, state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        wave = np.array([1.0, np.cos(omega * t), np.sin(omega * t)])
        gap = state[:count] @ modal_rows + (wave @ static_motion) @ rows - structure.clearance
        return wave, gap, scipy.optimize.nnls(root.T, np.linalg.solve(root, gap))[0]

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        wave, _, force = parts(t, state)
        spring = squares * state[:count] + damping @ state[count:]
        return np.concatenate([state[count:], wave @ load - spring - modal_rows @ force])

    history = scipy.integrate.solve_ivp(
        rate, (0.0, duration), np.zeros(2 * count), "DOP853", instants, rtol=1e-9, atol=1e-11
    )
    assert history.success
    gaps = []
    for t, state in zip(history.t, history.y.T, strict=True):
        _, gap, force = parts(t, state)
        gaps.append(gap - residual @ force)
    return np.array(gaps)


# --- without contact ------------------------------------------------------------------------------


@pytest.mark.parametrize("steps", [1, 3, 20])
@pytest.mark.parametrize("damping", DAMPINGS)
def test_exact_without_contact(damping: str, steps: int) -> None:
    """Dense matrices' exponential, mean load and load in both phases, from any state."""
    structure, omega = chain(damping).varied(clearance=1e3), 0.8
    mass, matrix, stiffness = dense_matrices(structure)
    system = np.zeros((23, 23))
    system[:10, 10:20] = np.eye(10)
    acceleration_rows = np.hstack([-stiffness, -matrix, structure.force.T])
    system[10:20] = np.linalg.solve(mass, acceleration_rows)
    system[21, 22], system[22, 21] = -omega, omega  # 1, cos and sin
    rng = np.random.default_rng(1)
    start = rng.normal(size=10), rng.normal(size=10)
    history = integrate_exponential(
        structure, omega, PENALTY, periods=2, steps_per_period=steps, initial=start
    )
    initial_state = np.concatenate([*start, [1.0, 1.0, 0.0]])
    exact = np.array([scipy.linalg.expm(t * system) @ initial_state for t in history.time])
    assert relative(history.displacement(range(10)), exact[:, :10]) < 1e-9
    final_state = scipy.linalg.expm(4.0 * np.pi / omega * system) @ initial_state
    assert relative(np.concatenate(history.final_state), final_state[:20]) < 1e-9


def test_free_motion_of_a_free_structure() -> None:
    """No load, no damping, not held: it flies off at its mean speed, to rounding."""
    structure = chain("none", unconstrained=True).varied(load=0.0, clearance=1e3)
    mass, _, _ = dense_matrices(structure)
    speed = np.random.default_rng(2).normal(size=10)
    history = integrate_exponential(
        structure, 1.0, PENALTY, periods=3, steps_per_period=7, initial=(np.zeros(10), speed)
    )
    centre = history.displacement(range(10)) @ np.diag(mass) / np.trace(mass)
    exact_centre = history.time * (np.diag(mass) @ speed) / np.trace(mass)
    assert relative(centre, exact_centre) < 1e-11
    assert abs(history.created_energy) < 1e-12


# --- order ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", ["modal", "matrix"])
@pytest.mark.parametrize("springs", [0.0, 0.25], ids=["rigid", "penalty"])
def test_second_order_on_lips_without_mass(springs: float, damping: str) -> None:
    """A chain with three pairs, four modes, against Runge and Kutta's method."""
    structure = massless(chain(damping), 4)
    law = fc.UnilateralPenalty(1.0 / springs) if springs else RIGID
    period = 2.0 * np.pi / 0.8
    exact = by_runge_kutta(structure, 0.8, springs, 2.0 * period, np.arange(128) * period / 64)
    errors = []
    for steps in COUNTS:
        history = integrate_exponential(structure, 0.8, law, periods=2, steps_per_period=steps)
        errors.append(relative(history.gap[:: steps // 64], exact))
    assert np.any(exact < 0.0) and log_slope(COUNTS, errors) == pytest.approx(-2.0, abs=0.2)
    assert errors[-1] < 3e-4


@pytest.mark.parametrize("damping", DAMPINGS)
@pytest.mark.parametrize("kind", ["oscillator", "chain"])
def test_second_order_on_lips_with_mass(kind: str, damping: str) -> None:
    """One dof and one pair, and a chain with three, against the event-driven motion."""
    if kind == "oscillator":
        structure, omega, law = oscillator(clearance=0.1), 1.0, fc.UnilateralPenalty(3.0)
    else:
        structure, omega, law = chain(damping), 0.8, PENALTY
    exact = fc.integrate_events(structure, omega, law, periods=2, steps_per_period=64)
    errors = []
    for steps in COUNTS:
        history = integrate_exponential(structure, omega, law, periods=2, steps_per_period=steps)
        errors.append(relative(history.gap[:: steps // 64], exact.gap))
        assert relative(history.contact_force, law.force(history.gap)) < 1e-9
    assert log_slope(COUNTS, errors) == pytest.approx(-2.0, abs=0.2)
    assert errors[-1] < 3e-4


@pytest.mark.parametrize("damping", ["none", "modal", "matrix"])
def test_energy_balance_is_of_second_order(damping: str) -> None:
    """Of contact that begins and ends, without penetration; the load's work by trapezoids."""
    structure, errors = massless(chain(damping), 4), []
    for steps in COUNTS:
        histories = [
            integrate_exponential(structure, omega, RIGID, periods=4, steps_per_period=steps)
            for omega in (0.6, 0.7, 0.8, 0.9)
        ]
        errors.append(np.mean([abs(history.created_energy) for history in histories]))
    assert log_slope(COUNTS, errors) < -1.7 and errors[-1] < 1e-4


# --- verification ---------------------------------------------------------------------------------


@pytest.mark.verification
@pytest.mark.parametrize(("modes", "steps"), [(50, 100), (100, 100), (150, 100), (20, 1000)])
def test_bar_against_a_rigid_wall(modes: int, steps: int) -> None:
    """Contact from 2e-5 to 1e-4 s without a break, rho c v = 4e9 Pa, leaves at 100 m/s: 2 %."""
    bar = free_bar(200)
    structure = massless(bar, modes)
    speed = np.zeros(structure.n_dofs)
    speed[:modes] = structure.basis.T @ dense_matrices(bar)[0] @ np.full(201, 100.0)
    period = 1.4e-4
    history = integrate_exponential(
        structure, 2.0 * np.pi / period, RIGID, periods=1, steps_per_period=steps,
        initial=(np.zeros(structure.n_dofs), speed),
    )  # fmt: skip
    force, step = history.contact_force[:, 0], history.time[1]
    closed_steps = np.flatnonzero(force > 0.0)
    assert closed_steps[-1] - closed_steps[0] + 1 == len(closed_steps)
    assert closed_steps[0] * step == pytest.approx(2e-5, abs=step)
    assert (closed_steps[-1] + 1) * step == pytest.approx(1e-4, rel=0.01)
    assert force[closed_steps].mean() == pytest.approx(4e9, rel=0.02)
    assert force.sum() * step == pytest.approx(4e9 * 8e-5, rel=0.01)
    rebound_speed = history.final_state[1][0] / np.sqrt(
        8000.0 * 0.2
    )  # of the motion as a rigid body
    assert abs(rebound_speed) == pytest.approx(100.0, rel=0.02)
    assert np.sign(rebound_speed) == -np.sign(speed[0])
    assert history.gap.max() < 1e-9 * np.abs(history.gap).max()


def test_long_steps_of_a_stiff_contact(soft_plate: fc.Structure) -> None:
    """16 to 256 steps a period, rigid, 40 modes: bounded, and no energy out of nothing."""
    structure = massless(soft_plate, 40)
    for steps in (16, 32, 64, 256):
        history = integrate_exponential(
            structure, 2000.0, RIGID, periods=60, steps_per_period=steps, record_periods=1
        )
        assert np.abs(history.gap).max() < 3e-6
        assert history.created_energy < 0.05


# --- record ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", ["none", "modal"])
def test_created_energy_is_refused(damping: str) -> None:
    """All modes but one of ten, rigid: R_inf is a thousandth of the static compliance.

    Steps of 1/16 and 1/64 of a period end up with 1e8 times the energy put in, and more; with 8
    modes all is well.
    """
    structure = chain(n=10, pairs=1, damping=damping)
    for steps in (16, 64):
        catch_error(
            partial(
                integrate_exponential,
                massless(structure, 9),
                0.5,
                RIGID,
                periods=60,
                steps_per_period=steps,
            ),
            names="energy",
            kind=fc.ConvergenceError,
        )
        history = integrate_exponential(
            massless(structure, 8), 0.5, RIGID, periods=60, steps_per_period=steps
        )
        assert abs(history.created_energy) < 0.05


def test_march_goes_on_from_its_end() -> None:
    """Two periods, and one after the other; fewer records are the same records."""
    structure = massless(chain(), 4)
    options: dict[str, Any] = {"steps_per_period": 32}
    whole_run = integrate_exponential(structure, 0.8, RIGID, periods=3, **options)
    first_run = integrate_exponential(structure, 0.8, RIGID, periods=2, **options)
    last_run = integrate_exponential(
        structure, 0.8, RIGID, periods=1, initial=first_run.final_state, **options
    )
    assert relative(last_run.gap, whole_run.gap[64:]) < 1e-11
    short_record = integrate_exponential(
        structure, 0.8, RIGID, periods=3, record_periods=1, dofs=[4], **options
    )
    assert np.array_equal(short_record.gap, whole_run.gap[64:])
    assert relative(short_record.displacement([4]), whole_run.displacement([4])[64:]) < 1e-12
    closing_gap = whole_run.structure.whole.apply_bt(whole_run.structure.expand(whole_run.recorded))
    assert relative(closing_gap - structure.clearance, whole_run.gap) < 1e-9


def test_settled_march_is_the_balanced_orbit(soft_plate: fc.Structure) -> None:
    """Rigid, ten modes: the orbit of harmonic balance with H = 80, to the error of the steps."""
    structure = massless(soft_plate, 10)
    history = integrate_exponential(
        structure, 2000.0, RIGID, periods=400, steps_per_period=1024, settle=1e-7,
        record_periods=1,
    )  # fmt: skip
    assert history.settled < 1e-7
    solution = fc.solve_harmonic_balance(structure, 2000.0, RIGID, harmonics=80)
    assert relative(history.gap, solution.gap(history.time)) < 1e-3
    assert relative(history.displacement([5]), solution.displacement(history.time, [5])) < 1e-3


@pytest.mark.filterwarnings("error")
def test_an_undamped_resonance_is_refused_without_warnings() -> None:
    """No steady response is divided by zero before that is said."""
    structure = fc.Structure.from_matrices(
        [[1.0]], [[1.0]], gap=[1.0], force_sin=[1.0], clearance=9.0
    )
    catch_error(
        lambda: fc.integrate_exponential(structure, 1.0, fc.UnilateralPenalty(3.0), periods=2),
        names="resonance",
        kind=fc.ConvergenceError,
    )
