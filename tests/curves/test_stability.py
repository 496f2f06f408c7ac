"""Stability of solutions: Floquet multipliers, verdicts, and orbits by shooting."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from helpers import (
    Cubic,
    catch_error,
    chain_stiffness,
    mean_square,
    oscillator,
    random_stiffness,
    relative,
)
from scipy.integrate import solve_ivp

import fenics_crack as fc
from fenics_crack import floquet

RIGID = fc.UnilateralConstraint()


@pytest.mark.parametrize("damping", [0.01, 0.1, 0.5])
def test_product_of_the_multipliers(damping: float) -> None:
    """exp(-T tr c), whatever the contact."""
    structure = oscillator(damping)
    solution = fc.solve_harmonic_balance(structure, 0.8, fc.UnilateralPenalty(3.0), harmonics=12)
    product = np.prod(floquet(structure, solution).multipliers)
    assert product == pytest.approx(np.exp(-damping * solution.period), rel=1e-9)


def test_without_contact_the_flow_is_linear() -> None:
    """An unreachable stop: multipliers are exp(T eigenvalues) of the linear structure, with a
    gyroscopic part."""
    rng = np.random.default_rng(8)
    n = 4
    stiffness, random = random_stiffness(rng, n), rng.normal(size=(n, n))
    damping = 0.05 * (random @ random.T) + 0.1 * (random - random.T)
    structure = fc.Structure.from_matrices(
        np.eye(n), stiffness, gap=rng.normal(size=n), force_sin=np.ones(n), damping=damping,
        clearance=1e6,
    )  # fmt: skip
    solution = fc.solve_harmonic_balance(structure, 1.3, fc.UnilateralPenalty(1.0), harmonics=3)
    flow = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])
    exact = np.linalg.eigvals(scipy.linalg.expm(solution.period * flow))
    multipliers = floquet(structure, solution).multipliers
    assert np.allclose(np.sort(np.abs(multipliers)), np.sort(np.abs(exact)), rtol=1e-9)


def test_a_turning_shaft_with_a_crack() -> None:
    """Seen in the frame that turns with it (Coriolis): stable, slow or fast, with a known error;
    the product of the multipliers is exp(-T tr C)."""
    for speed in (0.1, 0.45):
        damping = 0.08 * np.eye(2) + 2.0 * speed * np.array([[0.0, -1.0], [1.0, 0.0]])
        shaft = fc.Structure.from_matrices(
            np.eye(2), np.diag([0.8, 1.0]) - speed**2 * np.eye(2), gap=[-1.0, 0.0],
            force_cos=[1.0, 0.0], force_sin=[0.0, -1.0], damping=damping,
        )  # fmt: skip
        solution = fc.solve_harmonic_balance(shaft, speed, fc.UnilateralPenalty(0.2), harmonics=40)
        stability = floquet(shaft, solution)
        assert solution.report.truncation < 1e-4 and stability.verdict == "stable", speed
        product = np.prod(stability.multipliers)
        assert product == pytest.approx(np.exp(-0.16 * solution.period), rel=1e-6)


@pytest.mark.parametrize(
    "law", [fc.UnilateralPenalty(2.0), fc.SmoothedPenalty(2.0, 10.0)], ids=["penalty", "smoothed"]
)
@pytest.mark.filterwarnings("error")
def test_against_the_variational_equation(law: fc.UnilateralPenalty | fc.SmoothedPenalty) -> None:
    """Multipliers of two turning masses from SciPy's integration of the linearised motion."""
    stiffness = chain_stiffness(np.ones(3))
    damping = 0.06 * stiffness + 0.5 * np.array([[0.0, -1.0], [1.0, 0.0]])
    gap = np.array([1.0, -1.0])
    structure = fc.Structure.from_matrices(
        np.eye(2), stiffness, gap=gap, force_cos=[0.3, -0.5], damping=damping
    )
    solution = fc.solve_harmonic_balance(structure, 1.1, law, harmonics=40)

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        slope = law.tangent(solution.gap(np.array([t])))[0, 0]
        z = state.reshape(4, 4)
        force = -(stiffness + slope * np.outer(gap, gap)) @ z[:2] - damping @ z[2:]
        return np.concatenate([z[2:], force]).ravel()

    run = solve_ivp(
        rate, (0.0, solution.period), np.eye(4).ravel(), rtol=1e-8, atol=1e-10, max_step=0.01
    )
    exact = np.linalg.eigvals(run.y[:, -1].reshape(4, 4))
    multipliers = floquet(structure, solution).multipliers
    assert np.abs(multipliers[0]) == pytest.approx(np.abs(exact).max(), abs=2e-4)


@pytest.mark.drawn(1)
@pytest.mark.parametrize("ratio", [0.03, 0.01, 0.001])
def test_verdict_agrees_with_exact_motion(paper_scene: fc.Scene, ratio: float) -> None:
    """The paper's plate: a disturbed orbit returns or leaves as the verdict says, at the rate |mu|.

    ``benchmarks/verdicts.py`` has the whole grid.
    """
    plate = fc.build_structure(paper_scene.replace({"damping.ratio": ratio}))
    random = np.random.default_rng(3).normal(size=2 * plate.n_dofs)
    verdicts = []
    for stiffness, omega in (
        (1e8, 2000.0), (1e8, 5200.0), (1e9, 2000.0), (1e9, 5200.0), (1e10, 5200.0),
    ):  # fmt: skip
        law = fc.UnilateralPenalty(stiffness)
        harmonics = 100 if stiffness > 5e9 else 40
        solution = fc.solve_harmonic_balance(plate, omega, law, harmonics=harmonics)
        stability = floquet(plate, solution)
        assert stability.verdict != "undecided"
        verdicts.append(stability.verdict)
        orbit = fc.shoot(plate, solution)
        assert np.abs(orbit.multipliers[0]) == pytest.approx(
            np.abs(stability.multipliers[0]), rel=0.02
        )
        state, distance = orbit.state * (1.0 + 1e-6 * random), [1e-6]
        while 1e-8 < distance[-1] < 1e-4 and len(distance) < 120:
            state = orbit.flow.advance(state, omega, solution.period).state
            distance.append(relative(state, orbit.state))
        late_periods = np.arange(len(distance) // 2, len(distance))
        rate = np.exp(np.polyfit(late_periods, np.log(np.array(distance)[late_periods]), 1)[0])
        assert (rate < 1.0) == (stability.verdict == "stable"), (stiffness, omega, stability, rate)
        assert rate == pytest.approx(np.abs(orbit.multipliers[0]), rel=0.15)
    assert set(verdicts) == {"stable", "unstable"}


def test_poor_truncation_is_not_decided(paper_structure: fc.Structure) -> None:
    """The paper's data with few harmonics: the verdict is undecided."""
    plate = fc.reduce_structure(paper_structure, modes=10)
    solution = fc.solve_harmonic_balance(plate, 2000.0, fc.UnilateralPenalty(1e11), harmonics=5)
    stability = floquet(plate, solution)
    assert solution.report.truncation > 0.005
    assert stability.verdict != "stable"
    assert np.abs(stability.multipliers[0]) > 1.0


def test_what_cannot_be_judged_is_refused() -> None:
    """Multipliers need a law that gives the force from the gap."""
    structure = oscillator()
    catch_error(lambda: floquet(structure, fc.solve_linear(structure, 1.0)), "contact", None)


def test_solution_far_away_from_its_orbit() -> None:
    """Of one 28 % too large the error is known, and the verdict open, with how far the orbit is."""
    structure, law = oscillator(), fc.UnilateralPenalty(1.0)
    solution = fc.solve_harmonic_balance(structure, 0.8, law, harmonics=12)
    names = ("displacement_coefficients", "gap_coefficients", "force_coefficients")
    scaled_solution = replace(solution, **{name: 1.28 * getattr(solution, name) for name in names})
    assert scaled_solution.assessment is not solution.assessment
    assert scaled_solution.assessment.gap_and_displacement_errors() == pytest.approx(
        (0.28, 0.28), rel=1e-4
    )
    stability = floquet(structure, scaled_solution)
    assert floquet(structure, solution).verdict == "stable" and stability.verdict == "undecided"
    assert "which is stable, differs from the solution by 28 % and may be" in stability.reason


def test_a_tangent_that_is_not_the_forces_slope_is_refused() -> None:
    """Of a law of one's own: a third of it called a motion with a multiplier of 1.79 stable. Kinks
    are no fault, nor is a pair that never closes or rests at one."""
    structure = oscillator(0.05, 0.3)

    class Third(Cubic):
        def tangent(self, gap: np.ndarray) -> np.ndarray:
            return self.stiffness * gap**2

        def scaled(self, factor: float) -> Cubic:
            return Third(factor * self.stiffness)

    class Hardening(Cubic):
        def force(self, gap: np.ndarray) -> np.ndarray:
            return self.stiffness / 6.0 * (np.maximum(gap, 0.0) + 5.0 * np.maximum(gap - 0.1, 0.0))

        def tangent(self, gap: np.ndarray) -> np.ndarray:
            return self.stiffness / 6.0 * (1.0 * (gap > 0.0) + 5.0 * (gap > 0.1))

        def scaled(self, factor: float) -> Cubic:
            return Hardening(factor * self.stiffness)

    solution = fc.solve_harmonic_balance(structure, 1.5, Cubic(1.0), harmonics=9)
    assert floquet(structure, solution).verdict == "stable"
    catch_error(lambda: floquet(structure, solution, Third(1.0)), "contact", "Third")
    two, law = np.eye(2), Hardening(6.0)
    for clearance in (0.0, 10.0):
        two_mass_structure = fc.Structure.from_matrices(
            two, two, gap=two, force_cos=[0.3, 0.0], damping=0.05 * two, clearance=clearance
        )
        two_mass_solution = fc.solve_harmonic_balance(two_mass_structure, 1.5, law, harmonics=9)
        assert floquet(two_mass_structure, two_mass_solution).verdict == "stable"


# --- lips without mass ----------------------------------------------------------------------------


@pytest.mark.drawn(3)
@pytest.mark.parametrize("law", [RIGID, fc.UnilateralPenalty(1e9)], ids=["rigid", "penalty"])
@pytest.mark.parametrize("omega", [1500.0, 2000.0, 2600.0])
def test_verdict_is_that_of_the_disturbed_motion(
    has_massless_crack_faces: fc.Structure, omega: float, law: fc.ContactLaw
) -> None:
    """The distance to the orbit shrinks or grows as the leading multiplier says."""
    solution = fc.solve_harmonic_balance(has_massless_crack_faces, omega, law, harmonics=20)
    stability = fc.floquet(has_massless_crack_faces, solution)
    assert stability.refined and stability.verdict in ("stable", "unstable")
    orbit = fc.shoot(has_massless_crack_faces, solution)
    state = orbit.state * (1.0 + 1e-7)
    distances = []
    for _ in range(40):
        state = orbit.flow.advance(state, omega, orbit.period).state
        distances.append(np.linalg.norm(state - orbit.state))
    rate = (distances[-1] / distances[9]) ** (1.0 / 30.0)
    assert (rate < 1.0) == (stability.verdict == "stable")
    assert rate < abs(stability.multipliers[0]) + 0.05


def test_two_ways_to_the_multipliers(has_massless_crack_faces: fc.Structure) -> None:
    """Along the wave of 60 harmonics and on the marched orbit: the leading one to 0.03."""
    solution = fc.solve_harmonic_balance(
        has_massless_crack_faces, 1500.0, fc.UnilateralPenalty(1e9), harmonics=60
    )
    stability = fc.floquet(has_massless_crack_faces, solution)
    prediction = solution.assessment.orbit_prediction_by_newton_step
    assert stability.refined and prediction is not None
    max_multiplier = np.abs(np.linalg.eigvals(prediction.monodromy)).max()
    assert abs(stability.multipliers[0]) == pytest.approx(max_multiplier, abs=0.03)


def test_displacement_error_is_that_of_the_load(has_massless_crack_faces: fc.Structure) -> None:
    """Within a factor 3 of the difference from four times the harmonics."""
    law = fc.UnilateralPenalty(1e9)
    coarse_solution, fine_solution = (
        fc.solve_harmonic_balance(has_massless_crack_faces, 2000.0, law, harmonics=count)
        for count in (8, 32)
    )
    waves = [
        solution.displacement_coefficients @ has_massless_crack_faces.force[2]
        for solution in (coarse_solution, fine_solution)
    ]
    change = waves[1].copy()
    change[: len(waves[0])] -= waves[0]
    true_error = np.sqrt(mean_square(change) / mean_square(waves[1]))
    assert (
        true_error / 3.0
        < coarse_solution.report.displacement
        < 3.0 * true_error + 3.0 * coarse_solution.report.reduction
    )


# --- orbits by shooting ---------------------------------------------------------------------------


def test_failure_names_the_closest_residual() -> None:
    """Where residuals get no further."""
    solution = fc.solve_harmonic_balance(oscillator(), 1.0, fc.UnilateralPenalty(1.0), harmonics=5)
    catch_error(
        lambda: fc.shoot(oscillator(), solution, tolerance=-1.0),
        names=r"residual is (0\.0e\+00|\d\.\de-1[2-9])",
        kind=fc.ConvergenceError,
    )


@pytest.mark.parametrize(
    ("omega", "verdict"),
    [pytest.param(0.5, "stable", marks=pytest.mark.nightly), (0.05, "undecided")],
)
def test_slow_load_beside_high_modes(omega: float, verdict: str) -> None:
    """Modes of 1 and 3e4 rad/s: a period has more pieces than a search had. Where two can be
    followed Newton's method finds the orbit; else more harmonics tell the error, and a line why
    there is no verdict."""
    damping = np.diag([0.04, 1.0])
    slow = fc.Structure.from_matrices(
        np.eye(2), np.diag([1.0, 9e8]), gap=[1.0, 1.0], force_cos=[1.0, 1.0], damping=damping
    )
    solution = fc.solve_harmonic_balance(slow, omega, fc.UnilateralPenalty(1.0), tolerance=1e-2)
    stability = fc.floquet(slow, solution)
    assert stability.verdict == verdict
    assert solution.report.total <= 1e-2
    if verdict == "undecided":
        assert "thousand cycles in a period" in stability.reason
        assert "keep fewer modes" in stability.reason
    else:
        assert fc.shoot(slow, solution).residual <= 1e-10
        product = np.exp(-np.trace(damping) * solution.period)  # Liouville
        assert abs(np.prod(stability.multipliers)) == pytest.approx(product, rel=1e-5)
