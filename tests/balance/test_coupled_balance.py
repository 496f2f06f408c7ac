"""Harmonic balance of contact behind a static compliance: equations, solutions, searches."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, catch_error, chain, log_slope, relative, true_error
from test_inside_balance import random_gaps

import fenics_crack as fc
from fenics_crack import integrate_exponential

RIGID = fc.UnilateralConstraint()
LAWS = {
    "rigid": RIGID,
    "penalty": fc.UnilateralPenalty(np.array([4.0, 1e3, 20.0])),
    "smoothed": fc.SmoothedPenalty(20.0, 10.0),
}


def massless(structure: fc.Structure, modes: int) -> fc.Structure:
    """Modes, and the static rest."""
    return fc.reduce_structure(structure, modes=modes, method="massless")


@pytest.fixture(scope="module")
def short_chain() -> fc.Structure:
    """Three pairs with clearance, none, and preload; four modes of ten; a damping matrix."""
    return massless(chain("matrix"), 4)


@pytest.fixture(scope="module")
def plate(soft_plate: fc.Structure) -> fc.Structure:
    """The paper's plate by ten modes."""
    return massless(soft_plate, 10)


@pytest.fixture(scope="module")
def coarse_breathing_plate() -> fc.Structure:
    """776 dofs, 8 pairs, 1 % of critical for all modes."""
    scene = fc.Scene.load(DEMOS / "breathing_plate.toml")
    changes = {"damping.ratio": 0.01, "damping.modes": "all"}
    return fc.build_structure(scene.replace(changes | {"mesh.size": 0.02, "mesh.lip_elements": 4}))


def system_of(structure: fc.Structure, law: Any, harmonics: int) -> Any:
    """The equations at 0.8 rad/s."""
    problem = fc.Problem(structure, 0.8, law, harmonics)
    system = problem.system(problem.compliance_model())
    assert system.integrals.has_coupled_pairs
    return system


# --- equations ------------------------------------------------------------------------------------


@pytest.mark.parametrize("softness", [0.0, 2.0])
@pytest.mark.parametrize("law", LAWS)
def test_jacobian_against_finite_differences(
    law: str, softness: float, short_chain: fc.Structure
) -> None:
    """By every unknown and by the parameter of the softness."""
    hard = system_of(short_chain, LAWS[law], 2)
    system = type(hard)(hard.compliance_model, hard.integrals, softness)
    unknown = random_gaps(2, 3)
    point = system.linearise(unknown, 0.4)
    matrix, step = point.jacobian, 1e-7
    for column in range(unknown.size):
        change = step * np.eye(unknown.size)[column].reshape(unknown.shape)
        upper_point, lower_point = (
            system.linearise(unknown + s * change, 0.4) for s in (1.0, -1.0)
        )
        slope = (upper_point.residual - lower_point.residual).ravel() / (2.0 * step)
        assert np.abs(matrix[:, column] - slope).max() < 1e-5 * np.abs(matrix).max()
        gap = (upper_point.gap - lower_point.gap) / (2.0 * step)
        assert np.abs(point.gap_change(change / step) - gap).max() < 1e-5
    ends = [system.linearise(unknown, 0.4 + s * step).residual for s in (1.0, -1.0)]
    slope, by_parameter = (ends[0] - ends[1]) / (2.0 * step), point.by_parameter
    if softness:
        assert relative(by_parameter, slope) < 1e-5
    else:
        assert not np.any(by_parameter) and not np.any(slope)


def test_fewer_modes_than_pairs(coarse_breathing_plate: fc.Structure) -> None:
    """Steps and determinants found in the modes' coordinates are those of the whole Jacobian."""
    problem = fc.Problem(massless(coarse_breathing_plate, 3), 2000.0, RIGID, 4)
    system = problem.system(problem.compliance_model())
    assert system.reachable_gap_basis is not None
    unknown = 1e-6 * random_gaps(4, system.shape[1])
    point = system.linearise(unknown)
    residual = random_gaps(4, system.shape[1])
    exact_solution = np.linalg.solve(point.jacobian, residual.ravel())
    assert len(point.matrix_to_factorise()) == 9 * 3 < unknown.size
    assert relative(point.solve(residual).ravel(), exact_solution) < 1e-10
    assert point.sign == np.linalg.slogdet(point.jacobian)[0]


def test_matrix_free_is_dense(short_chain: fc.Structure) -> None:
    """J v, J^-1 r, and what follows from these."""
    unknown, vector = random_gaps(6, 3), random_gaps(6, 3, 5)
    points, hard = [], system_of(short_chain, RIGID, 6)
    for is_matrix_free in (False, True):
        system = type(hard)(hard.compliance_model, hard.integrals, 0.5)
        assert not system.is_matrix_free
        system.is_matrix_free = is_matrix_free
        points.append(system.linearise(unknown, 0.4))
    dense, iterative = points
    assert relative(dense.apply(vector), (dense.jacobian @ vector.ravel()).reshape(13, 3)) < 1e-12
    for name in ("apply", "solve", "gap_change", "gap_change_by_force_error"):
        assert relative(getattr(iterative, name)(vector), getattr(dense, name)(vector)) < 1e-7
    assert np.isnan(iterative.sign) and abs(dense.sign) == 1.0


# --- solutions ------------------------------------------------------------------------------------


@pytest.mark.usefixtures("predicted_errors")
@pytest.mark.parametrize("law", LAWS)
def test_law_holds_at_every_instant(law: str, short_chain: fc.Structure) -> None:
    """The force is that of the gap in time, each pair with its own stiffness; or no penetration."""
    solution = fc.solve_harmonic_balance(short_chain, 0.8, LAWS[law], harmonics=15)
    assert solution.converged
    time = np.linspace(0.0, solution.period, 400)
    gap, force = solution.gap(time), solution.contact_force(time)
    assert np.all(np.ptp(force, axis=0) > 0.0)
    if law == "rigid":
        assert gap.max() < 1e-12 * np.abs(gap).max() and force.min() >= 0.0
        assert np.abs(gap * force).max() < 1e-12
    else:
        assert relative(force, LAWS[law].force(gap)) < 1e-8


@pytest.mark.parametrize("law", ["rigid", "penalty"])
@pytest.mark.parametrize("clearance", [0.0, 0.4, -0.4])
def test_clearance_and_preload_against_a_march(
    clearance: float, law: str, short_chain: fc.Structure
) -> None:
    """Settled exponential steps, 0.3 %; clearances from -0.7 to 0.7."""
    structure = short_chain.varied(clearance=clearance)
    solution = fc.solve_harmonic_balance(structure, 0.8, LAWS[law], harmonics=60)
    history = integrate_exponential(
        structure, 0.8, LAWS[law], periods=400, steps_per_period=1024, settle=1e-8,
        record_periods=1, initial=solution,
    )  # fmt: skip
    assert relative(solution.gap(history.time), history.gap) < 3e-3
    assert history.settled < 1e-3


def test_rigid_is_the_limit_of_stiff(plate: fc.Structure) -> None:
    """The difference falls like 1/k."""
    rigid = fc.solve_harmonic_balance(plate, 2000.0, RIGID, harmonics=20)
    stiffness = (1e11, 1e12, 1e13, 1e14)
    errors = [
        relative(
            fc.solve_harmonic_balance(
                plate, 2000.0, fc.UnilateralPenalty(k), harmonics=20, residual_tolerance=1e-12
            ).gap_coefficients,
            rigid.gap_coefficients,
        )
        for k in stiffness
    ]
    assert log_slope(stiffness, errors) == pytest.approx(-1.0, abs=0.1)
    assert errors[0] < 5e-2


def test_order_in_the_harmonics(plate: fc.Structure) -> None:
    """One rigid pair: the gap in time, with its kinks, falls faster than its own Fourier series."""
    exact = fc.solve_harmonic_balance(plate, 2000.0, RIGID, harmonics=320)
    time = np.arange(4096) * exact.period / 4096
    gap, counts = exact.gap(time), (10, 20, 40, 80)
    errors = [
        relative(fc.solve_harmonic_balance(plate, 2000.0, RIGID, harmonics=H).gap(time), gap)
        for H in counts
    ]
    assert log_slope(counts, errors) < -3.5
    assert errors[1] < 2e-3 and errors[2] < 1e-4 and errors[3] < 5e-6
    for harmonics, error in zip(counts[1:], errors[1:], strict=True):
        truncated_gap = exact.gap_coefficients.copy()
        truncated_gap[2 * harmonics + 1 :] = 0.0
        series = replace(exact, gap_coefficients=truncated_gap, static_above=None)
        assert error < 0.7 * relative(series.gap(time), gap)


def test_twice_the_period(short_chain: fc.Structure) -> None:
    """With twice the harmonics, the solution of the load's own period."""
    single_solution = fc.solve_harmonic_balance(short_chain, 0.8, RIGID, harmonics=8)
    twice = fc.solve_harmonic_balance(short_chain, 0.8, RIGID, harmonics=16, subharmonic=2)
    time = np.linspace(0.0, twice.period, 100)
    assert relative(twice.gap(time), single_solution.gap(time)) < 1e-7
    restarted_solution = fc.solve_harmonic_balance(
        short_chain, 0.8, RIGID, harmonics=16, subharmonic=2, initial=single_solution
    )
    assert restarted_solution.status.startswith("full Newton steps: converged (0 iterations)")


def test_lips_with_mass_against_lips_without(paper_scene: fc.Scene) -> None:
    """One pair at the mouth, a third of the modes: the difference falls with the mesh."""
    law, errors = fc.UnilateralPenalty(1e9), []
    for columns in (2, 4, 8):
        changes = {"mesh.columns": columns, "mesh.rows": 2 * columns, "contact.pairs": "mouth"}
        full_structure = fc.build_structure(paper_scene.replace(changes | {"damping.ratio": 0.01}))
        massless_solution, massive_solution = (
            fc.solve_harmonic_balance(model, 2000.0, law, harmonics=80)
            for model in (massless(full_structure, full_structure.n_dofs // 3), full_structure)
        )
        errors.append(true_error(massless_solution, massive_solution))
    assert errors[2] < 0.5 * errors[1] < 0.1 * errors[0] and errors[2] < 2e-3


# --- searches -------------------------------------------------------------------------------------


def test_fewer_harmonics_lead_to_the_solution(plate: fc.Structure) -> None:
    """The orbit of the rigid plate, cold, H = 20, as from a solution with more."""
    solution = fc.solve_harmonic_balance(plate, 2000.0, RIGID, harmonics=20)
    assert solution.converged and "from fewer harmonics: converged" in solution.status
    finer_solution = fc.solve_harmonic_balance(plate, 2000.0, RIGID, harmonics=40)
    restarted_solution = fc.solve_harmonic_balance(
        plate, 2000.0, RIGID, harmonics=20, initial=finer_solution
    )
    assert true_error(solution, restarted_solution) < 1e-8


def test_nothing_converges(plate: fc.Structure) -> None:
    """To a tolerance below rounding: an error that names all starts and says what to do, or the
    last iterate."""
    options: dict[str, Any] = {"harmonics": 12, "residual_tolerance": 1e-25}
    starts = "from fewer harmonics", "from an exact orbit", "continuation in the contact compliance"
    attempts = "; then ".join(rf"{start}: failed \(\d+ iterations\)" for start in starts)
    message = (
        attempts
        + r"; no solution in \d+ iterations: try a tolerance: the solution is then the exact orbit"
    )
    catch_error(
        lambda: fc.solve_harmonic_balance(plate, 2000.0, RIGID, **options),
        names=message,
        kind=fc.ConvergenceError,
    )
    solution = fc.solve_harmonic_balance(plate, 2000.0, RIGID, **options, throw=False)
    assert not solution.converged and re.match(message, solution.status)


@pytest.mark.parametrize("modes", [30, 40, 49])
def test_rigid_contact_where_few_modes_are_left_out(modes: int, soft_plate: fc.Structure) -> None:
    """Of 50 modes; the reference, which has more, may have all: the error is estimated."""
    solution, exact = (
        fc.solve_harmonic_balance(massless(soft_plate, count), 2000.0, RIGID, harmonics=20)
        for count in (modes, 49)
    )
    assert solution.converged and solution.report.reduction < 0.1
    if modes < 49:
        assert solution.report.reduction > true_error(solution, exact) / 5.0


# --- errors ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("modes", [10, pytest.param(20, marks=pytest.mark.nightly)])
def test_truncation_of_the_breathing_plate(
    modes: int, coarse_breathing_plate: fc.Structure
) -> None:
    """Against H = 160 with the same modes: a factor 3 under the penalty law; of rigid contact
    where it is small, and else nowhere much too low."""
    structure = massless(coarse_breathing_plate, modes)
    for law in (fc.UnilateralPenalty(1e9), RIGID):
        exact = fc.solve_harmonic_balance(structure, 2000.0, law, harmonics=160)
        for harmonics in (5, 10, 20, 40):
            solution = fc.solve_harmonic_balance(structure, 2000.0, law, harmonics=harmonics)
            time = np.linspace(0.0, exact.period, 2048, endpoint=False)
            error = relative(solution.gap(time), exact.gap(time))  # without clearance: B^T u
            estimate = solution.report.truncation
            assert error > 1e-5 and estimate > error / 3.0
            if law is not RIGID or harmonics == 40:
                assert estimate < 3.0 * error


def test_reduction_of_the_breathing_plate(coarse_breathing_plate: fc.Structure) -> None:
    """10, 20, 40 modes with H = 80, against 160 modes: within a factor 3."""
    law = fc.UnilateralPenalty(1e9)
    exact = fc.solve_harmonic_balance(
        massless(coarse_breathing_plate, 160), 2000.0, law, harmonics=80
    )
    errors = []
    for modes in (10, 20, 40):
        structure = massless(coarse_breathing_plate, modes)
        solution = fc.solve_harmonic_balance(structure, 2000.0, law, harmonics=80)
        errors.append(true_error(solution, exact))
        assert errors[-1] / 3.0 < solution.report.reduction < 3.0 * errors[-1]
    assert 1e-3 < errors[-1] < errors[0] / 3.0


def test_sampling_and_penetration(plate: fc.Structure) -> None:
    """Few samples against exact integrals, and the depth by its definition."""
    law = fc.UnilateralPenalty(1e9)
    exact = fc.solve_harmonic_balance(plate, 2000.0, law, harmonics=10)
    assert exact.report.sampling == 0.0
    for samples in (64, 256):
        solution = fc.solve_harmonic_balance(plate, 2000.0, law, harmonics=10, samples=samples)
        error = true_error(solution, exact)
        assert error / 3.0 < solution.report.sampling < 3.0 * error
    fine_solution = fc.solve_harmonic_balance(plate, 2000.0, law, harmonics=80)
    gap = fine_solution.gap(np.arange(4096) * fine_solution.period / 4096)
    share = np.sqrt(np.mean(np.maximum(gap, 0.0) ** 2) / np.mean(gap**2))
    assert fine_solution.report.penetration == pytest.approx(share, rel=0.02)
    rigid = fc.solve_harmonic_balance(plate, 2000.0, RIGID, harmonics=10)
    assert rigid.report.penetration == 0.0
