"""No penetration at all: the limit of stiff penalties, and a rigid stop."""

import numpy as np
import pytest
import scipy.optimize
from helpers import evaluate, log_slope, mean_square, oscillator, relative, resized

import fenics_crack as fc

pytestmark = pytest.mark.usefixtures("predicted_errors")

COUNTS = (5, 10, 20, 40, 80)


WEIGHT = 7e7
"""Of the projection [N/m], the inverse of the plate's static compliance."""


@pytest.fixture(scope="module")
def constrained(soft_plate: fc.Structure) -> dict[int, fc.PeriodicSolution]:
    """Its vibration without penetration by projection, by the number of harmonics."""
    law = fc.UnilateralConstraint(WEIGHT)
    return {h: fc.solve_harmonic_balance(soft_plate, 2000.0, law, harmonics=h) for h in COUNTS}


def distance(coefficients: np.ndarray, reference: np.ndarray) -> float:
    """Root mean square of a difference of waves relative to the second, by coefficients."""
    harmonics = max(len(coefficients), len(reference)) // 2
    coefficients, reference = resized(coefficients, harmonics), resized(reference, harmonics)
    return float(np.sqrt(mean_square(coefficients - reference) / mean_square(reference)))


def test_penalty_approaches_the_constraint_like_one_over_k(
    soft_plate: fc.Structure, never_penetrating: fc.PeriodicSolution
) -> None:
    """Error and penetration halve where k doubles, from 8e8 to 1.3e10 N/m.

    H = 80 against the constraint with H = 160. Below 5e8 the error is no longer small (20 % and
    more); truncation puts a floor under it, 4e-3 of the gap as measured by other H, reached at
    3e10 N/m, so that the largest k here still has an error of 0.7 %.
    """
    stiffness = 8e8 * 2.0 ** np.arange(5)
    errors, penetrations = [], []
    for k in stiffness:
        solution = fc.solve_harmonic_balance(
            soft_plate, 2000.0, fc.UnilateralPenalty(k), harmonics=80
        )
        errors.append(distance(solution.gap_coefficients, never_penetrating.gap_coefficients))
        penetrations.append(solution.report.penetration)
    assert errors[0] < 0.12 and errors[-1] < 0.01
    for values in (errors, penetrations):
        assert log_slope(stiffness, values) == pytest.approx(-1.0, abs=0.06)


def test_penetration_falls_with_the_harmonics(constrained: dict[int, fc.PeriodicSolution]) -> None:
    """What the truncated wave still penetrates, by sampling and by the report: order 1 or more."""
    sampled_shares, reported_shares = [], []
    for solution in constrained.values():
        gap = solution.gap(np.linspace(0.0, solution.period, 20001))
        sampled_shares.append(gap.max() / np.abs(gap).max())
        reported_shares.append(solution.report.penetration)
    assert np.all(np.diff(reported_shares) < 0.0)
    assert sampled_shares[0] < 0.03 and sampled_shares[-1] < 0.005
    assert log_slope(COUNTS, reported_shares) < -1.0


def test_contact_force_pushes_only_and_is_complementary(
    constrained: dict[int, fc.PeriodicSolution],
) -> None:
    """lambda >= 0; the truncated waves of force and gap work on each other ever less.

    The force's own wave is the projection's, mean and all; it dips below zero by little.
    """
    works = []
    for solution in constrained.values():
        t = np.arange(20000) * solution.period / 20000
        gap, force = solution.gap(t)[:, 0], solution.contact_force(t)[:, 0]
        assert force.min() == 0.0 and force.max() > 50.0
        assert force.mean() == pytest.approx(solution.force_coefficients[0, 0], rel=1e-4)
        wave = evaluate(solution.force_coefficients[:, 0], solution.base_omega, t)
        assert wave.min() > -0.1 * wave.max()
        works.append(abs(np.mean(wave * gap)) / (np.abs(wave).mean() * np.abs(gap).mean()))
    assert np.all(np.diff(works) < 0.0)
    assert works[0] < 1e-2 and works[-1] < 1e-4


def test_mean_forces_are_in_balance(
    soft_plate: fc.Structure, constrained: dict[int, fc.PeriodicSolution]
) -> None:
    """K a0 + B lambda0 = f0 in all degrees of freedom."""
    stiffness, gap = soft_plate.stiffness[:, :], soft_plate.gap.toarray()
    for solution in constrained.values():
        elastic_force = stiffness @ solution.displacement_coefficients[0]
        contact = gap @ solution.force_coefficients[0]
        assert np.linalg.norm(contact) > 10.0
        unbalance = elastic_force + contact - soft_plate.force[0]
        assert np.linalg.norm(unbalance) < 1e-6 * np.linalg.norm(contact)


def test_impulse_is_that_of_a_stiff_penalty(
    soft_plate: fc.Structure, constrained: dict[int, fc.PeriodicSolution]
) -> None:
    """With k = 1e12 N/m and H = 40 the impulse of a period agrees to 0.2 %; with 1e9 to 3 %."""
    exact = constrained[40].force_coefficients[0, 0]
    for k, max_error, min_error in ((1e9, 0.03, 0.01), (1e12, 2e-3, 0.0)):
        solution = fc.solve_harmonic_balance(
            soft_plate, 2000.0, fc.UnilateralPenalty(k), harmonics=40
        )
        assert min_error <= abs(solution.force_coefficients[0, 0] / exact - 1.0) < max_error


def test_weights_agree_with_more_harmonics(
    soft_plate: fc.Structure, constrained: dict[int, fc.PeriodicSolution]
) -> None:
    """The default weight and ten times as much: 8 % apart with H = 5, 0.15 % with H = 80."""
    counts, differences = (5, 10, 20, 80), []
    for harmonics in counts:
        solution = constrained[harmonics]
        assert isinstance(solution.contact, fc.UnilateralConstraint) and solution.contact.weight
        law = fc.UnilateralConstraint(10.0 * solution.contact.weight)
        heavier_solution = fc.solve_harmonic_balance(soft_plate, 2000.0, law, harmonics=harmonics)
        differences.append(distance(heavier_solution.gap_coefficients, solution.gap_coefficients))
    assert np.all(np.diff(differences) < 0.0)
    assert differences[0] > 1e-2 and differences[-1] < 3e-3


@pytest.mark.drawn(2)
@pytest.mark.parametrize(("harmonics", "step"), [(5, 100.0), (10, 100.0), (20, 500.0), (40, 1e3)])
def test_constraint_over_the_frequencies(
    paper_structure: fc.Structure, harmonics: int, step: float
) -> None:
    """The paper's data at 1000 to 3000 rad/s in steps, every one from a cold start."""
    for omega in np.arange(1000.0, 3001.0, step):
        solution = fc.solve_harmonic_balance(
            paper_structure, omega, fc.UnilateralConstraint(), harmonics=harmonics
        )
        assert solution.converged and solution.report.residual < 1e-9
        assert solution.force_coefficients[0, 0] > 0.0 and solution.report.penetration < 0.1


def test_starts_from_a_solution_nearby(
    soft_plate: fc.Structure, constrained: dict[int, fc.PeriodicSolution]
) -> None:
    """Started from itself it needs no iteration; it also starts a solution with more harmonics."""
    law = fc.UnilateralConstraint(WEIGHT)
    start = constrained[10]
    restarted_solution = fc.solve_harmonic_balance(
        soft_plate, 2000.0, law, harmonics=10, initial=start
    )
    assert restarted_solution.iterations == 0
    assert distance(restarted_solution.gap_coefficients, start.gap_coefficients) < 1e-9
    finer_solution = fc.solve_harmonic_balance(soft_plate, 2000.0, law, harmonics=20, initial=start)
    assert distance(finer_solution.gap_coefficients, constrained[20].gap_coefficients) < 1e-8


def test_several_pairs(wide_plate: fc.Structure) -> None:
    """Four pairs: as a penalty of 1e12 N/m with the same H, to 1e-3; none penetrates."""
    differences = []
    for harmonics in (5, 10, 20):
        rigid_solution, penalty_solution = (
            fc.solve_harmonic_balance(wide_plate, 2000.0, law, harmonics=harmonics)
            for law in (fc.UnilateralConstraint(), fc.UnilateralPenalty(1e12))
        )
        t = np.linspace(0.0, rigid_solution.period, 2000)
        gap, penalty_gap = rigid_solution.gap(t), penalty_solution.gap(t)
        size = np.abs(penalty_gap).max(axis=0)
        differences.append(float((np.abs(gap - penalty_gap).max(axis=0) / size).max()))
        assert np.all(gap.max(axis=0) < 0.05 * size)
        assert np.all(rigid_solution.force_coefficients[0] > 5.0)
    assert max(differences) < 1e-3


def test_stop_out_of_reach_and_stop_never_left() -> None:
    """Out of reach: the linear solution, no force. Always closed: at rest, the stop bears the load.

    x = -100 at rest: lambda = cos(W t) + 100.
    """
    law = fc.UnilateralConstraint()
    open_structure = oscillator(clearance=100.0)
    linear = fc.solve_linear(open_structure, 0.5)
    solution = fc.solve_harmonic_balance(open_structure, 0.5, law)
    assert np.allclose(solution.gap_coefficients, linear.gap_coefficients, atol=1e-12)
    assert not np.any(solution.force_coefficients)
    closed_solution = fc.solve_harmonic_balance(oscillator(clearance=-100.0), 0.5, law)
    expected_force = np.zeros(11)
    expected_force[:2] = 100.0, 1.0
    assert np.allclose(closed_solution.force_coefficients[:, 0], expected_force, atol=1e-8)
    assert np.abs(closed_solution.gap_coefficients).max() < 1e-8
    assert np.allclose(closed_solution.displacement_coefficients[0], -100.0)


# --- a mass that hits a rigid stop ----------------------------------------------------------------


def rebounding_orbit(omega: float, damping: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Period-1 orbit with one elastic impact a period: times, x, and the impact's phase.

    Between impacts the motion is linear and known in closed form. Unknown are the phase and the
    speed of the impact: a period later it must be the same again. A rigid stop that stores no
    energy, the limit of ever stiffer springs, returns the speed as it was.
    """
    damped_omega, period = np.sqrt(1.0 - 0.25 * damping**2), 2.0 * np.pi / omega
    response = 1.0 / (1.0 - omega**2 + 1j * damping * omega)

    def flight(t: np.ndarray, phase: float, speed: float) -> tuple[np.ndarray, np.ndarray]:
        forced_motion = response * np.exp(1j * (omega * t + phase))
        start = response * np.exp(1j * phase)
        a = -start.real
        b = (-speed - (1j * omega * start).real + 0.5 * damping * a) / damped_omega
        decay, cosine, sine = (
            np.exp(-0.5 * damping * t),
            np.cos(damped_omega * t),
            np.sin(damped_omega * t),
        )
        free_motion = decay * (a * cosine + b * sine)
        rate = decay * damped_omega * (b * cosine - a * sine) - 0.5 * damping * free_motion
        return forced_motion.real + free_motion, (1j * omega * forced_motion).real + rate

    def mismatch(unknown: np.ndarray) -> np.ndarray:
        x, speed = flight(period, *unknown)
        return np.array([x, speed - unknown[1]])

    unknown, _, status, _ = scipy.optimize.fsolve(mismatch, [3.0, 2.0], full_output=True)
    assert status == 1 and unknown[1] > 0.1
    t = np.arange(8000) * period / 8000
    x = flight(t, *unknown)[0]
    assert x.max() < 1e-9 and x.min() < -1.0  # free of the stop between the impacts
    return t, x, unknown[0]


def test_rigid_stop_against_linear_flight_between_impacts() -> None:
    """W = 2.2, c = 0.1, no clearance: 53 % off with H = 5, 9 % with H = 80, order almost 1.

    The force is an impulse, whose harmonics do not fall at all: no faster is possible.
    """
    omega, damping = 2.2, 0.1
    t, x, phase = rebounding_orbit(omega, damping)
    errors, penetrations = [], []
    for harmonics in COUNTS:
        solution = fc.solve_harmonic_balance(
            oscillator(damping), omega, fc.UnilateralConstraint(), harmonics=harmonics
        )
        wave = solution.gap(t + phase / omega)[:, 0]
        errors.append(relative(wave, x))
        penetrations.append(solution.report.penetration)
    assert np.all(np.diff(errors) < 0.0) and np.all(np.diff(penetrations) < 0.0)
    assert errors[-1] < 0.1
    assert np.log2(errors[-2] / errors[-1]) > 0.7
    # Stiff springs lead to the same orbit, like the time that they need to turn the mass round.
    stiffness, errors = np.array([1e3, 1e4, 1e5]), []
    for k in stiffness:
        law = fc.UnilateralPenalty(k)
        spring = fc.solve_harmonic_balance(oscillator(damping), omega, law, harmonics=200)
        wave = spring.gap(t + phase / omega)[:, 0]
        errors.append(relative(wave, x))
    assert log_slope(stiffness, errors) == pytest.approx(-0.45, abs=0.08)
    assert errors[-1] < 0.05
