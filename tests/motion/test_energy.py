"""Where the load's work goes, beside powers integrated otherwise."""

import numpy as np
import pytest
from helpers import catch_error

import fenics_crack as fc
from fenics_crack.motion.energy import EnergyBudget


def chain(damping: float = 0.1) -> fc.Structure:
    """Three masses on springs, the last one at a stop."""
    stiffness = 2.0 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
    return fc.Structure.from_matrices(
        np.eye(3), stiffness, gap=[0.0, 0.0, 1.0], force_cos=[0.3, 0.0, 0.1],
        force_sin=[0.0, 0.2, 0.0], damping=damping * stiffness + 0.01 * np.diag([1.0, 0.0, 0.0]),
    )  # fmt: skip


@pytest.fixture(scope="module")
def solution() -> fc.PeriodicSolution:
    """Of contact thirty times as stiff as a spring; the damping couples modes."""
    return fc.solve_harmonic_balance(chain(), 0.6, fc.UnilateralPenalty(30.0), harmonics=20)


def test_work_and_losses_of_an_orbit(solution: fc.PeriodicSolution) -> None:
    """By Gauss points between events, and physical velocities by the flow's states."""
    orbit = solution.assessment.nearest_orbit
    assert orbit is not None and orbit.n_events >= 2
    nodes, weights = np.polynomial.legendre.leggauss(60)
    ends = np.cumsum(orbit.motion.track.lengths)
    lengths = np.diff(np.append(0.0, ends))
    times = (ends[:, None] + 0.5 * lengths[:, None] * (nodes - 1.0)).ravel()
    weights = np.outer(0.5 * lengths, weights).ravel()
    structure, n_modes = orbit.structure, orbit.flow.n_modes
    velocity = (
        orbit.samples(times).states[:, n_modes : 2 * n_modes] @ orbit.flow.modal_model.shapes.T
    )
    phase = orbit.omega * times
    load = np.outer(np.cos(phase), [0.3, 0.0, 0.1]) + np.outer(np.sin(phase), [0.0, 0.2, 0.0])
    stiffness = 2.0 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
    damping = 0.1 * stiffness + 0.01 * np.diag([1.0, 0.0, 0.0])
    budget = orbit.energy_budget
    assert budget.load == pytest.approx(weights @ np.sum(load * velocity, axis=1), rel=1e-9)
    loss = weights @ np.einsum("ti,ij,tj->t", velocity, damping, velocity)
    assert budget.damping.sum() == pytest.approx(loss, rel=1e-9)
    assert sum(budget.shares.values()) == pytest.approx(1.0, abs=1e-9)
    assert structure.n_pairs == 1 and not budget.friction.size


def test_budget_of_a_series(solution: fc.PeriodicSolution) -> None:
    """Harmonic balance has that of the orbit, but for truncated harmonics."""
    orbit = solution.assessment.nearest_orbit
    assert orbit is not None and solution.energy_budget is not None
    for name, share in orbit.energy_budget.shares.items():
        assert solution.energy_budget.shares[name] == pytest.approx(share, abs=2e-3)
    assert sum(solution.energy_budget.shares.values()) == pytest.approx(1.0, abs=1e-9)
    assert solution.indicators().far_share == solution.energy_budget.shares["far_share"]


def test_budget_beside_steps_in_time(solution: fc.PeriodicSolution) -> None:
    """Central differences have the same work of load and damping, to second order."""
    orbit = solution.assessment.nearest_orbit
    assert orbit is not None
    structure, errors = orbit.structure, []
    for steps in (400, 800):
        history = fc.integrate_central_difference(
            structure, 0.6, fc.UnilateralPenalty(30.0), periods=150, steps_per_period=steps
        )
        u = history.displacement([0, 1, 2])[-steps - 2 :]
        velocity = (u[2:] - u[:-2]) / (history.time[2] - history.time[0])
        phase = 0.6 * history.time[-steps - 1 : -1]
        load = np.outer(np.cos(phase), [0.3, 0.0, 0.1]) + np.outer(np.sin(phase), [0.0, 0.2, 0.0])
        work = np.sum(load * velocity) * (history.time[1] - history.time[0])
        errors.append(abs(work / orbit.energy_budget.load - 1.0))
    assert errors[0] < 2e-3 and errors[0] / errors[1] == pytest.approx(4.0, rel=0.5)


def test_share_that_moves() -> None:
    """Half the sum of what modes and friction take more or less."""
    omega, friction = np.arange(1.0, 4.0), np.array([0.2])
    few = EnergyBudget(2.0, 4.0, np.array([1.0, 0.8]), friction, omega[:2], 5.0)
    many = EnergyBudget(1.0, 1.0, np.array([0.5, 0.2, 0.2]), np.array([0.1]), omega, 5.0)
    assert few.power_factor == 0.5 and few.moved_share(few) == 0.0
    assert few.moved_share(many) == pytest.approx(0.2) == many.moved_share(few)


def test_damping_that_rises_with_frequency() -> None:
    """A ratio in all modes and stiffness b: xi + b omega / 2, in the response of each mode."""
    stiffness = np.diag([1.0, 4.0])
    structure = fc.Structure.from_matrices(
        np.eye(2), stiffness, gap=None, force_cos=[1.0, 1.0],
        damping=fc.ModalDamping(0.01, stiffness=0.04),
    )  # fmt: skip
    for dof, omega in enumerate((1.0, 2.0)):
        amplitude = fc.solve_linear(structure, omega).amplitude(dof)
        assert amplitude == pytest.approx(1.0 / (2.0 * (0.01 + 0.02 * omega) * omega**2), rel=1e-9)
    assert structure.damping.scaled(2.0) == fc.ModalDamping(0.02, stiffness=0.08)
    catch_error(lambda: fc.ModalDamping(0.01, stiffness=-1.0), "damping stiffness", -1.0)
