"""Harmonic balance of the full block system."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from helpers import (
    Cubic,
    block_system,
    catch_error,
    chain,
    dense_matrices,
    oscillator,
    relative,
    two_masses,
)
from petsc4py import PETSc

import fenics_crack as fc
from fenics_crack import ContactLaw

pytestmark = pytest.mark.usefixtures("predicted_errors")

NAN, INF = float("nan"), float("inf")


def test_linear_solution_is_the_complex_frequency_response(paper_structure: fc.Structure) -> None:
    """Z^-1 f by dense complex arithmetic, to 1e-10; also for a random chain with a mean load."""
    for structure, omega in ((paper_structure, 2000.0), (chain(n=6, pairs=2, seed=3), 1.1)):
        mass, damping, stiffness = dense_matrices(structure)
        impedance = stiffness - omega**2 * mass + 1j * omega * damping
        mean, cosine, sine = structure.force
        response = np.linalg.solve(impedance, cosine - 1j * sine)
        coefficients = fc.solve_linear(structure, omega, harmonics=3).displacement_coefficients
        expected_coefficients = np.zeros_like(coefficients)
        expected_coefficients[0] = np.linalg.solve(stiffness, mean)
        expected_coefficients[1], expected_coefficients[2] = response.real, -response.imag
        assert relative(coefficients, expected_coefficients) < 1e-10


@pytest.mark.parametrize("damping", ["matrix", "modal", "few modes", "rayleigh"])
@pytest.mark.parametrize(
    "law",
    [fc.UnilateralPenalty(np.array([5.0, 8.0])), fc.SmoothedPenalty(5.0, 20.0)],
    ids=["penalty", "smoothed"],
)
def test_jacobian_against_finite_differences(
    law: fc.UnilateralPenalty | fc.SmoothedPenalty, damping: str
) -> None:
    """Both laws, all couplings, to 1e-6."""
    structure = chain(damping, n=6, pairs=2, seed=3)
    rng = np.random.default_rng(5)
    with block_system(fc.Problem(structure, 0.9, law, 4, 128)) as (_, residual, jacobian):
        amplitude = rng.normal(size=(9, 6))
        for _ in range(4):
            direction = rng.normal(size=amplitude.shape)
            step = 1e-6
            sides = [residual(amplitude + s * direction) for s in (step, -step)]
            slope = (sides[0] - sides[1]) / (2.0 * step)
            product = jacobian(amplitude) @ direction.ravel()
            assert relative(slope.ravel(), product) < 1e-6


@pytest.mark.parametrize("damping", ["matrix", "modal", "few modes", "rayleigh", "none"])
def test_residual_of_the_block_system_is_that_of_the_paper(damping: str) -> None:
    """r(u) = A u + b - c (eq. 13) by dense arithmetic and samples."""
    structure, law = chain(damping, n=6, pairs=2, seed=3), fc.UnilateralPenalty(5.0)
    omega, harmonics, samples = 0.9, 3, 64
    mass, damping, stiffness = dense_matrices(structure)
    amplitude = np.random.default_rng(7).normal(size=(2 * harmonics + 1, 6))

    def apply(rows: np.ndarray) -> np.ndarray:
        """A u."""
        product = np.zeros_like(rows)
        product[0] = stiffness @ rows[0]
        for k in range(1, harmonics + 1):
            a, b = rows[2 * k - 1], rows[2 * k]
            block, coupling = stiffness - (k * omega) ** 2 * mass, k * omega * damping
            product[2 * k - 1], product[2 * k] = block @ a + coupling @ b, block @ b - coupling @ a
        return product

    residual = apply(amplitude)
    residual[:3] -= structure.force
    phase = 2.0 * np.pi * np.arange(samples) / samples
    basis = np.ones((samples, 2 * harmonics + 1))
    for k in range(1, harmonics + 1):
        basis[:, 2 * k - 1], basis[:, 2 * k] = np.cos(k * phase), np.sin(k * phase)
    gap_matrix = structure.gap.toarray()
    gap = basis @ amplitude @ gap_matrix - structure.clearance
    force = law.force(gap) @ gap_matrix.T
    weights = np.full(2 * harmonics + 1, 2.0 / samples)
    weights[0] = 1.0 / samples
    residual += weights[:, None] * (basis.T @ force)
    with block_system(fc.Problem(structure, omega, law, harmonics, samples)) as (
        _,
        evaluate_residual,
        _,
    ):
        assert relative(evaluate_residual(amplitude), residual) < 1e-12


@pytest.mark.parametrize("omega", [0.3, 0.55, 0.9, 1.3, 1.8])
def test_solution_satisfies_the_equation_of_motion_in_the_mean(omega: float) -> None:
    """The projected residual of M u'' + C u' + K u + B lambda - f vanishes by fine quadrature."""
    structure, law, harmonics = chain(n=6, pairs=2, seed=3), fc.UnilateralPenalty(4.0), 9
    solution = fc.solve_harmonic_balance(structure, omega, law, harmonics=harmonics, samples=4096)
    assert solution.converged and solution.report.residual < 1e-10
    mass, damping, stiffness = dense_matrices(structure)
    count = 65536
    t = np.arange(count) * solution.period / count
    u = solution.displacement(t, range(6))
    spectrum = np.fft.fft(u, axis=0)
    rate = 2j * np.pi * np.fft.fftfreq(count, solution.period / count)[:, None]
    velocity = np.fft.ifft(rate * spectrum, axis=0).real
    acceleration = np.fft.ifft(rate**2 * spectrum, axis=0).real
    load = structure.force[0] + np.outer(np.cos(omega * t), structure.force[1])
    load += np.outer(np.sin(omega * t), structure.force[2])
    contact = solution.contact_force(t) @ structure.gap.toarray().T
    unbalance = acceleration @ mass + velocity @ damping.T + u @ stiffness + contact - load
    unbalance_spectrum = np.fft.fft(unbalance, axis=0)[: harmonics + 1] / count
    assert np.abs(unbalance_spectrum).max() < 1e-5 * np.abs(load).max()


@pytest.mark.parametrize("method", [None, "massless"])
def test_response_with_lips_open_and_tied(
    paper_structure: fc.Structure, method: str | None
) -> None:
    """That of linear solutions, and of lips tied by stiff springs; with and without mass there."""
    plate = paper_structure.damped(fc.RayleighDamping(20.0))
    model = plate if method is None else fc.reduce_structure(plate, modes=20, method=method)
    dof, omega = plate.find_dof((0.1, 0.1), "x"), np.array([1000.0, 2500.0, 4000.0])
    bonded_plate = plate.tied(1e15)
    for lips, reference in (("open", plate), ("tied", bonded_plate)):
        rows = [
            fc.solve_linear(reference, load_omega).coefficients_at([dof])[1:3, 0]
            for load_omega in omega
        ]
        amplitudes = fc.linear_response(model, dof, omega, lips=lips)
        np.testing.assert_allclose(amplitudes, np.hypot(*np.transpose(rows)), rtol=5e-3)
    catch_error(lambda: fc.linear_response(model, dof, omega, lips="closed"), "lips", "closed")
    assert fc.linear_response(oscillator(damping=0.0), 0, np.array([1.0]))[0] == np.inf


def test_cold_start_on_soft_contact_of_all_pairs(breathing_plate: fc.Structure) -> None:
    """breathing_plate, 18 pairs, k = 1e7 to 1e9, from the linear solution."""
    assert breathing_plate.n_pairs == 18
    assert 3500 < breathing_plate.n_dofs < 4500
    assert fc.solve_modes(breathing_plate, 1).omega[0] == pytest.approx(2300.0, abs=0.1)
    for stiffness in (1e7, 1e8, 1e9):
        solution = fc.solve_harmonic_balance(
            breathing_plate, 2000.0, fc.UnilateralPenalty(stiffness)
        )
        assert solution.converged and solution.report.residual < 1e-10
        assert solution.gap(np.linspace(0.0, solution.period, 200)).max() > 0.0


@pytest.mark.parametrize("stiffness", [1e9, 1e10, 1e11])
@pytest.mark.parametrize("ratio", [0.001, 0.01])
def test_cold_start_on_the_paper_plate(
    paper_scene: fc.Scene, stiffness: float, ratio: float
) -> None:
    """H = 5, both laws, the paper's stiffness among others, from the linear solution."""
    plate = fc.build_structure(paper_scene.replace({"damping.ratio": ratio}))
    hard = fc.solve_harmonic_balance(plate, 2000.0, fc.UnilateralPenalty(stiffness))
    smoothed_solution = fc.solve_harmonic_balance(
        plate, 2000.0, fc.SmoothedPenalty(stiffness, 1e11)
    )
    assert hard.report.residual < 1e-10 and smoothed_solution.report.residual < 1e-10
    t = np.linspace(0.0, hard.period, 400)
    penetration = hard.gap(t).max()
    assert 0.0 < penetration
    assert hard.contact_force(t).max() == pytest.approx(stiffness * penetration)
    assert np.all(hard.contact_force(t) >= 0.0)


def test_continues_from_a_given_solution() -> None:
    """From the solution itself no iteration is needed; the number of harmonics may differ."""
    law = fc.UnilateralPenalty(1.0)
    solution = fc.solve_harmonic_balance(oscillator(), 1.0, law, harmonics=6)
    restarted_solution = fc.solve_harmonic_balance(
        oscillator(), 1.0, law, harmonics=6, initial=solution
    )
    assert restarted_solution.iterations == 0
    finer_solution = fc.solve_harmonic_balance(
        oscillator(), 1.0, law, harmonics=9, initial=solution
    )
    assert finer_solution.harmonics == 9 and finer_solution.iterations <= solution.iterations


def test_failure_is_an_error_with_its_history() -> None:
    """A tolerance below rounding cannot be met: an error, or a solution marked as not converged."""
    law, options = fc.UnilateralPenalty(10.0), {"residual_tolerance": 1e-25, "harmonics": 20}
    error = catch_error(
        lambda: fc.solve_harmonic_balance(oscillator(), 0.7, law, **options),
        names="full Newton steps: failed",
        kind=fc.ConvergenceError,
    )
    assert len(error.history) > 3
    solution = fc.solve_harmonic_balance(oscillator(), 0.7, law, **options, throw=False)
    assert not solution.converged
    assert "failed" in solution.status


@pytest.mark.parametrize(
    ("key", "arguments"),
    [
        ("omega", {"omega": 0.0}),
        ("omega", {"omega": -1.0}),
        ("omega", {"omega": NAN}),
        ("omega", {"omega": "fast"}),
        ("harmonics", {"harmonics": 0}),
        ("harmonics", {"harmonics": 2.5}),
        ("harmonics", {"harmonics": 2, "subharmonic": 3}),
        ("subharmonic", {"subharmonic": 0}),
        ("samples", {"samples": 20}),
        ("samples", {"samples": 64, "contact": fc.UnilateralConstraint()}),
        ("samples", {"samples": 64, "tolerance": 1e-3}),
        *(("residual_tolerance", {"residual_tolerance": x}) for x in (0.0, -1.0, "small")),
        *(("tolerance", {"tolerance": x}) for x in (0.0, -1e-3, NAN, INF, "small")),
        ("tolerance", {"tolerance": 1e-3, "harmonics": 5}),
        ("contact stiffness", {"contact": fc.UnilateralPenalty(np.ones(2))}),
        ("contact", {"contact": None}),
        ("contact", {"contact": 5.0}),
        ("contact", {"contact": fc.UnilateralPenalty}),
        *(("initial", {"initial": x}) for x in ("solution", np.zeros((11, 1)), 1.0)),
    ],
    ids=str,
)
def test_bad_arguments_are_named(key: str, arguments: dict[str, object]) -> None:
    """One error with key, value and what is allowed."""
    call_arguments: dict[str, object] = {
        "omega": 1.0,
        "contact": fc.UnilateralPenalty(1.0),
    } | arguments
    catch_error(lambda: fc.solve_harmonic_balance(oscillator(), **call_arguments), key)


def test_initial_of_another_structure_is_refused() -> None:
    """The number of dofs and of pairs must fit, and the subharmonic."""
    law = fc.UnilateralPenalty(1.0)
    linear = [
        fc.solve_linear(structure, 1.0) for structure in (oscillator(), two_masses(), chain())
    ]
    for foreign_solution, subharmonic in (
        (linear[1], 1),  # two dofs, one pair
        (linear[2], 1),  # ten dofs, three pairs
        (replace(linear[0], subharmonic=2), 1),
        (replace(linear[0], subharmonic=2), 3),
    ):
        catch_error(
            partial(
                fc.solve_harmonic_balance,
                oscillator(),
                1.0,
                law,
                initial=foreign_solution,
                subharmonic=subharmonic,
            ),
            "initial",
        )


@pytest.mark.parametrize(
    ("law", "lips"),
    [
        (fc.UnilateralPenalty(4.0), "with mass"),
        (fc.UnilateralConstraint(), "with mass"),
        (fc.UnilateralPenalty(4.0), "massless"),
        (fc.UnilateralConstraint(), "massless"),
    ],
)
def test_the_kernel_finds_what_snes_finds(law: ContactLaw, lips: str) -> None:
    """Pair by pair, projected, and coupled pairs of either law: the same solution to 1e-10."""
    structure = chain()
    if lips == "massless":
        structure = fc.reduce_structure(structure, modes=4, method="massless")
    options, solutions = PETSc.Options("crack_hb_"), []
    for uses_snes in (False, True):
        if uses_snes:
            options["snes_max_it"] = 50
        solutions.append(
            fc.solve_harmonic_balance(structure, 0.8, law, harmonics=7, residual_tolerance=1e-13)
        )
    options.delValue("snes_max_it")
    assert solutions[0].converged and np.any(solutions[0].force_coefficients)
    assert relative(solutions[0].gap_coefficients, solutions[1].gap_coefficients) < 1e-10
    assert relative(solutions[0].force_coefficients, solutions[1].force_coefficients) < 1e-9


def test_one_rank_alone(mpirun: Callable[..., str]) -> None:
    """A rank that solves by itself waits for none: PETSc starts on all of them with the import, and
    MPI before it, for threads."""
    script = """
import fenics_crack as fc
from mpi4py import MPI
assert MPI.Query_thread() > MPI.THREAD_FUNNELED
if MPI.COMM_WORLD.rank == 1:
    from helpers import oscillator
    print(fc.solve_harmonic_balance(oscillator(), 1.0, fc.UnilateralPenalty(1.0)).converged)
MPI.COMM_WORLD.barrier()
"""
    assert mpirun(script, 2).split() == ["True"]


class Steep(Cubic):
    """With a tangent that is five times the slope of its force."""

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """15 c g^2."""
        return 5.0 * super().tangent(gap)

    def scaled(self, factor: float) -> Cubic:
        """The same with another c."""
        return Steep(factor * self.stiffness)


@pytest.mark.drawn(1)
@pytest.mark.parametrize("throw", [True, False])
def test_a_wrong_tangent_is_named_where_newton_fails(throw: bool) -> None:
    """Advice on harmonics and damping helps nobody then; it stays that of a law that is right."""
    solutions = {}
    for force in (0.3, 3.0):
        solve = partial(fc.solve_harmonic_balance, oscillator(0.05, force), 1.5, harmonics=9)
        catch_error(
            partial(solve, Steep(100.0), throw=throw), "contact", "Steep", names=r"tangent\(gap\)"
        )
        solutions[force] = solve(Cubic(100.0), throw=False)
    assert solutions[0.3].converged and not solutions[3.0].converged
    assert "try other harmonics" in solutions[3.0].status


@pytest.mark.parametrize("law", [fc.SmoothedPenalty(1.0, 10.0), fc.UnilateralConstraint()])
def test_no_orbit_judges_where_no_flow_is_exact(law: ContactLaw) -> None:
    """A smoothed law, and rigid lips with mass: nothing is decided, and it is said why."""
    assessment = fc.solve_harmonic_balance(oscillator(), 1.0, law).assessment
    assert assessment.nearest_orbit is None and assessment.predicted_error == np.inf
    assert not assessment.is_accepted and np.isnan(assessment.relative_orbit_distance)
    assert assessment.rejection_reason == (
        "no exact orbit can be computed: use the contact law 'penalty' or 'unilateral', and a "
        "reduction with method = 'massless'"
    )
