"""Exact motion between switching instants, and periodic orbits by shooting."""

import numpy as np
import pytest
from helpers import dense_matrices, oscillator, random_stiffness
from scipy.linalg import expm

import fenics_crack as fc
from fenics_crack import floquet, integrate_events


@pytest.mark.parametrize("damping", ["none", "modal", "matrix"])
def test_linear_motion(damping: str) -> None:
    """A stop out of reach: matrix exponential with the load as two more states."""
    rng = np.random.default_rng(2)
    n, omega = 4, 1.7
    stiffness, random = random_stiffness(rng, n), rng.normal(size=(n, n))
    damping_form = {"modal": fc.ModalDamping(0.03), "matrix": 0.1 * random @ random.T}.get(damping)
    force = rng.normal(size=(3, n))
    structure = fc.Structure.from_matrices(
        np.eye(n), stiffness, gap=np.ones(n), force_mean=force[0], force_cos=force[1],
        force_sin=force[2], damping=damping_form, clearance=1e6,
    )  # fmt: skip
    damping_matrix = dense_matrices(structure)[1]
    history = integrate_events(
        structure, omega, fc.UnilateralPenalty(1.0), periods=2, steps_per_period=50
    )
    # states u, v, 1, cos, sin
    flow = np.zeros((2 * n + 3, 2 * n + 3))
    flow[:n, n : 2 * n] = np.eye(n)
    flow[n : 2 * n] = np.hstack([-stiffness, -damping_matrix, force.T])
    flow[2 * n + 1, 2 * n + 2], flow[2 * n + 2, 2 * n + 1] = -omega, omega
    start = np.zeros(2 * n + 3)
    start[2 * n : 2 * n + 2] = 1.0
    exact = np.array([(expm(t * flow) @ start)[:n] for t in history.time])
    assert np.allclose(history.displacement(range(n)), exact, atol=1e-10)


@pytest.mark.parametrize("ratio", [1.5, 4.0, 20.0])
def test_overdamped_motion(ratio: float) -> None:
    """A mass that creeps at 2 ratio w, no contact: the matrix exponential; and a linear solution,
    which has no error and is stable."""
    structure = oscillator(2.0 * ratio, clearance=100.0)
    law = fc.UnilateralPenalty(1.0)
    history = integrate_events(structure, 1.0, law, periods=1, initial=([3.0], [1.0]))
    flow = np.zeros((4, 4))
    flow[0, 1], flow[1, :3], flow[2, 3], flow[3, 2] = 1.0, (-1.0, -2.0 * ratio, 1.0), 1.0, -1.0
    exact = [(expm(time * flow) @ (3.0, 1.0, 1.0, 0.0))[0] for time in history.time]
    assert np.allclose(history.gap[:, 0] + 100.0, exact, atol=1e-12)
    solution = fc.solve_harmonic_balance(structure, 1.0, law, harmonics=3)
    assert solution.report.total < 1e-10 and floquet(structure, solution).verdict == "stable"


def test_brief_contacts_are_not_missed() -> None:
    """Grazing a stiff stop for a time far below the grid: the motion behind it is that of the
    closed form, which is early by the flight that the stop cuts off."""
    structure = fc.Structure.from_matrices(np.eye(1), np.eye(1), gap=np.ones(1), clearance=1.0)
    law, omega_in_contact = fc.UnilateralPenalty(1e4), np.sqrt(1.0 + 1e4)
    for excess in (1e-2, 1e-4, 1e-8, -1e-8):
        amplitude = 1.0 + excess
        start = (np.array([-amplitude]), np.zeros(1))
        history = integrate_events(
            structure, 1.0, law, periods=1, steps_per_period=16, initial=start
        )
        speed = np.sqrt(max(amplitude**2 - 1.0, 0.0))
        meets = np.pi - np.arctan2(speed, 1.0)
        leaves = (
            meets
            + 2.0
            * np.arctan2(speed / omega_in_contact, 1.0 - 1e4 / omega_in_contact**2)
            / omega_in_contact
        )
        later = history.time[history.time > np.pi] - leaves
        exact_motion = np.cos(later) - speed * np.sin(later)
        if speed == 0.0:  # the stop is not met
            exact_motion = -amplitude * np.cos(later + leaves)
        displacement = history.displacement([0])[-len(later) :, 0]
        np.testing.assert_allclose(displacement, exact_motion, rtol=0.0, atol=1e-9)
        final_displacement, rate = (part[0] for part in history.final_state)
        assert final_displacement**2 + rate**2 == pytest.approx(amplitude**2, rel=1e-10)


def test_rigid_pairs_without_mass(has_massless_crack_faces: fc.Structure) -> None:
    """Against exponential steps, whose error falls with their length; no pair is passed."""
    law, errors = fc.UnilateralConstraint(), []
    exact = integrate_events(has_massless_crack_faces, 2000.0, law, periods=2, steps_per_period=64)
    assert np.any(exact.contact_force > 0.0) and exact.gap.max() <= 0.0
    for factor in (16, 256):
        steps = fc.integrate_exponential(
            has_massless_crack_faces, 2000.0, law, periods=2, steps_per_period=64 * factor
        )
        errors.append(np.abs(steps.gap[::factor] - exact.gap).max())
    assert errors[1] < 0.1 * errors[0] and errors[1] < 1e-3 * np.abs(exact.gap).max()


def test_the_papers_data_are_unstable(paper_structure: fc.Structure) -> None:
    """k = 1e11, xi = 0.001 on ten modes: irregular by harmonics, decided to a tolerance."""
    plate, law = fc.reduce_structure(paper_structure, modes=10), fc.UnilateralPenalty(1e11)
    solution = fc.solve_harmonic_balance(plate, 2000.0, law, harmonics=20)
    assert floquet(plate, solution).verdict == "irregular"
    stability = floquet(
        plate, fc.solve_harmonic_balance(plate, 2000.0, law, tolerance=0.1, throw=False)
    )
    assert stability.refined
    assert stability.verdict == "unstable"
    assert np.abs(stability.multipliers[0]) > 1.01


def test_indicators_leave_out_the_beginning() -> None:
    """Of a motion from rest that has settled they are those of the steady vibration, whatever is
    recorded."""
    stiffness = 1e4 * np.array([[2.0, -1.0], [-1.0, 1.0]])
    masses = fc.Structure.from_matrices(
        np.eye(2), stiffness, gap=[0.0, 1.0], force_sin=[10.0, 0.0], clearance=1e-3,
        damping=fc.ModalDamping(0.05),
    )  # fmt: skip
    law = fc.UnilateralPenalty(1e5)
    history = integrate_events(masses, 48.0, law, periods=200)
    assert np.ptp(history.displacement([1])) / 2.0 > 1.1 * history.indicators(1).amplitude
    steady = fc.solve_harmonic_balance(masses, 48.0, law, harmonics=40).indicators(1)
    for name in ("amplitude", "ratio_2_1", "opening", "contact_force"):
        assert getattr(history.indicators(1), name) == pytest.approx(
            getattr(steady, name), rel=2e-2
        )


@pytest.mark.parametrize("steps", [3, 8, 12])
def test_few_instants_tell_few_harmonics(steps: int) -> None:
    """Of orders beyond half of them nothing is known: they are those of others."""
    law = fc.UnilateralPenalty(1.0)
    coarse_run, fine_run = (
        integrate_events(oscillator(), 0.9, law, periods=60, steps_per_period=n).indicators()
        for n in (steps, 256)
    )
    if steps == 3:
        assert np.isnan(
            [coarse_run.ratio_2_1, coarse_run.ratio_largest, coarse_run.largest_order]
        ).all()
        return
    assert coarse_run.ratio_2_1 == pytest.approx(fine_run.ratio_2_1, rel=0.01)
    assert (
        coarse_run.ratio_largest == coarse_run.ratio_2_1
        and coarse_run.largest_order == fine_run.largest_order == 2.0
    )


@pytest.mark.parametrize("rounding", [-1e-17, 0.0, 1e-17])
def test_pairs_that_touch_at_the_start(rounding: float) -> None:
    """At rest on the stop, pressed into it: contact begins at once, despite rounding."""
    structure = fc.Structure.from_matrices(
        np.eye(2),
        np.array([[2.0, -1.0], [-1.0, 2.0]]),
        gap=np.eye(2),
        force_mean=[0.0, 1.0],
        force_cos=[1.0, 0.0],
        clearance=[rounding, 0.3],
    )
    law = fc.UnilateralPenalty(50.0)
    exact = fc.integrate_events(structure, 0.9, law, periods=2, steps_per_period=50)
    steps = fc.integrate_central_difference(structure, 0.9, law, periods=2, steps_per_period=5000)
    size = np.abs(exact.gap).max()
    assert np.abs(steps.gap[::100] - exact.gap).max() < 1e-3 * size
    assert exact.gap[1:4, 0].max() < 0.1 * size
