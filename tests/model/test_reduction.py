"""Reduced structures: exact at zero frequency, convergent, their errors estimated."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers import (
    DAMPINGS,
    ROOT,
    catch_error,
    chain,
    dense_matrices,
    log_slope,
    relative,
    true_error,
    wrap,
)
from mpi4py import MPI
from reference_flow import size_of_motion

import fenics_crack as fc


def compliances(structure: fc.Structure, base: float, harmonics: int) -> tuple[np.ndarray, ...]:
    """R_k, k = 0 to H, and the linear gap."""
    compliance = fc.Problem(
        structure, base, fc.UnilateralPenalty(1.0), harmonics
    ).compliance_model()
    return compliance.matrices, compliance.linear_gap


# --- compliance -----------------------------------------------------------------------------------


@pytest.mark.parametrize("structure", [*DAMPINGS, "plate", "wide plate"])
def test_static_compliance_is_exact(
    structure: str, soft_plate: fc.Structure, wide_plate: fc.Structure
) -> None:
    """With three modes, to 1e-9: of the pairs, and of the mean load."""
    full_structure = {"plate": soft_plate, "wide plate": wide_plate}.get(structure) or chain(
        structure, 60
    )
    reduced_structure = fc.reduce_structure(full_structure, modes=3)
    assert reduced_structure.n_dofs < 0.3 * full_structure.n_dofs
    base = 0.3 * fc.solve_modes(full_structure, 1).omega[0]
    (matrices, linear), (exact, exact_linear) = (
        compliances(model, base, 1) for model in (reduced_structure, full_structure)
    )
    assert relative(matrices[0], exact[0]) < 1e-9
    assert np.allclose(linear[0], exact_linear[0], rtol=0.0, atol=1e-9 * np.abs(exact_linear).max())
    # At the first harmonic below the first mode the error is there, and small.
    assert 1e-15 < relative(matrices[1], exact[1]) < 1e-2


def test_what_one_soft_motion_hides() -> None:
    """A chain held by a spring 1e-11 as stiff as its others: a static response to any force is its
    motion as a rigid body, but for 1e-10. All pairs and the load have their shapes in the basis,
    and as many more in that of the reference."""
    mass, _, stiffness = dense_matrices(chain("none", 24, unconstrained=True))
    stiffness[0, 0] += 1e-11
    gap, force = np.eye(24)[:, [3, 10, 17]], np.eye(24)[23]
    full_structure = fc.Structure.from_matrices(mass, stiffness, gap=gap, force_sin=force)
    reduced_structure = fc.reduce_structure(full_structure, modes=4)
    assert (reduced_structure.n_dofs, reduced_structure.reference.n_dofs) == (8, 12)
    exact = fc.solve_modes(full_structure, 4).omega
    np.testing.assert_allclose(reduced_structure.omega[1:4], exact[1:], rtol=1e-2)


def test_free_interface_is_exact_to_the_second_order_in_frequency() -> None:
    """Without damping the error of R(w) near w = 0 starts with w^4."""
    full_structure = chain("none", 60)
    first_omega = fc.solve_modes(full_structure, 1).omega[0]
    omega = first_omega * np.array([0.05, 0.1, 0.2])
    reduced_structure = fc.reduce_structure(full_structure, modes=2)
    errors = [
        np.linalg.norm(
            compliances(reduced_structure, w, 1)[0][1] - compliances(full_structure, w, 1)[0][1]
        )
        for w in omega
    ]
    assert log_slope(omega, errors) == pytest.approx(4.0, abs=0.3)


@pytest.mark.parametrize("structure", [*DAMPINGS, "plate"])
def test_with_all_modes_nothing_is_lost(structure: str, soft_plate: fc.Structure) -> None:
    """Every method spans the whole space then: R_k and the linear gap to 1e-9."""
    full_structure = soft_plate if structure == "plate" else chain(structure, n=20)
    reduced_structure = fc.reduce_structure(full_structure, modes=full_structure.n_dofs)
    assert reduced_structure.n_dofs == full_structure.n_dofs
    base = 0.41 * fc.solve_modes(full_structure, 1).omega[0]
    matrices, linear = compliances(reduced_structure, base, 7)
    exact, exact_linear = compliances(full_structure, base, 7)
    assert relative(matrices, exact) < 1e-9
    assert relative(linear, exact_linear) < 1e-9


@pytest.mark.parametrize("structure", ["modal", "none", "wide plate"])
def test_compliance_converges_with_the_modes(structure: str, wide_plate: fc.Structure) -> None:
    """Up to the 5th harmonic within the modes: the error falls by orders of magnitude."""
    full_structure = wide_plate if structure == "wide plate" else chain(structure, 60)
    base = 0.7 * fc.solve_modes(full_structure, 1).omega[0]
    exact = compliances(full_structure, base, 5)[0]
    errors = [
        relative(compliances(fc.reduce_structure(full_structure, modes=m), base, 5)[0], exact)
        for m in (10, 20, 40)
    ]
    assert errors[0] < 0.05
    assert errors[1] < 0.5 * errors[0] and errors[2] < 0.5 * errors[1]


# --- estimated error ------------------------------------------------------------------------------

CASES: list[tuple[str, int, tuple[int, ...]]] = [
    # Modes that reach the highest harmonic or almost: fewer leave a resonance out altogether.
    ("plate", 5, (3, 5, 10, 20)),
    ("plate", 10, (10, 20)),
    ("wide plate", 5, (3, 5, 10, 20, 40, 80)),
    ("wide plate", 10, (10, 20, 40, 80)),
    ("modal", 7, (3, 5, 10, 20, 30)),
    ("matrix", 7, (3, 5, 10, 20, 30)),
    ("few modes", 7, (5, 10, 20)),
    ("none", 7, (3, 5, 10, 20, 30)),
]


@pytest.mark.drawn(4)
@pytest.mark.parametrize(("structure", "harmonics", "counts"), CASES)
def test_estimated_error_is_the_true_one(
    structure: str,
    harmonics: int,
    counts: tuple[int, ...],
    soft_plate: fc.Structure,
    wide_plate: fc.Structure,
) -> None:
    """Within a factor 3 of the error against the exact compliance, from 1e-8 to 3e-2."""
    plates = {"plate": soft_plate, "wide plate": wide_plate}
    length = 30 if structure == "few modes" else 60  # a longer one moves without a period
    full_structure = plates.get(structure) or chain(structure, length)
    omega, stiffness = (2000.0, 1e9) if structure in plates else (3.0 / length, 4.0)
    law = fc.UnilateralPenalty(stiffness)

    def solve(model: fc.Structure) -> fc.PeriodicSolution:
        return fc.solve_harmonic_balance(
            model, omega, law, harmonics=harmonics, residual_tolerance=1e-12
        )

    exact = solve(full_structure)
    assert exact.report.reduction == 0.0
    n_compared = 0
    for modes in counts:
        solution = solve(fc.reduce_structure(full_structure, modes=modes))
        error = true_error(solution, exact)
        if 1e-8 < error < 3e-2:
            n_compared += 1
            assert error / 3.0 < solution.report.reduction < 3.0 * error
    assert n_compared >= 2


# --- what is asked of a reduced structure ---------------------------------------------------------


def test_reduced_solution_speaks_of_the_whole_structure(wide_plate: fc.Structure) -> None:
    """Dofs, displacements and pairs are those of the whole; motion agrees to 1e-4."""
    reduced_structure = fc.reduce_structure(wide_plate, modes=30)
    assert reduced_structure.whole is wide_plate
    for point, component in (((0.1, 0.1), "x"), ((0.05, 0.025), 1)):
        assert reduced_structure.find_dof(point, component) == wide_plate.find_dof(point, component)
    assert np.array_equal(reduced_structure.pair_points, wide_plate.pair_points)
    assert np.array_equal(reduced_structure.pair_areas, wide_plate.pair_areas)
    corner, middle = (
        reduced_structure.find_dof((0.1, 0.1), "x"),
        reduced_structure.find_dof((0.05, 0.025), "y"),
    )
    law = fc.UnilateralPenalty(1e9)
    reduced_solution, full_solution = (
        fc.solve_harmonic_balance(model, 2000.0, law, harmonics=5)
        for model in (reduced_structure, wide_plate)
    )
    t = np.linspace(0.0, reduced_solution.period, 50)
    for reduced_array, full_array in (
        (
            reduced_solution.displacement(t, [corner, middle]),
            full_solution.displacement(t, [corner, middle]),
        ),
        (
            reduced_solution.coefficients_at([middle, corner]),
            full_solution.coefficients_at([middle, corner]),
        ),
        (reduced_solution.displacement_field(t), full_solution.displacement_field(t)),
        (reduced_solution.gap(t), full_solution.gap(t)),
    ):
        assert reduced_array.shape == full_array.shape
        assert relative(reduced_array, full_array) < 1e-4
    catch_error(lambda: reduced_solution.coefficients_at([wide_plate.n_dofs]), "dofs")


def test_basis_is_orthonormal_and_diagonal(wide_plate: fc.Structure) -> None:
    """T^T M T = I, T^T K T = diag(omega^2): its columns are the modes of the reduced structure."""
    mass, stiffness = wide_plate.mass[:, :], wide_plate.stiffness[:, :]
    reduced_structure = fc.reduce_structure(wide_plate, modes=9)
    basis = reduced_structure.basis
    assert np.abs(basis.T @ mass @ basis - np.eye(reduced_structure.n_dofs)).max() < 1e-8
    diagonal = np.diag(reduced_structure.omega**2)
    assert np.abs(basis.T @ stiffness @ basis - diagonal).max() < 1e-8 * diagonal.max()
    modes = fc.solve_modes(wide_plate, 9).omega
    assert np.allclose(fc.reduce_structure(wide_plate, modes=9).omega[:9], modes, rtol=1e-9)


def test_basis_does_not_depend_on_the_size_of_the_load(paper_scene: fc.Scene) -> None:
    """A load a million times larger is the same load for the choice of a basis."""
    omegas = []
    for force in (1e-4, 1e2):
        scene = paper_scene.replace({"mesh.columns": 4, "excitation.force_sin": (force, 0.0)})
        omegas.append(fc.reduce_structure(fc.build_structure(scene), modes=6).omega)
    assert np.allclose(*omegas, rtol=1e-6)


def test_damped_reduction(wide_plate: fc.Structure) -> None:
    """Other damping of its own coordinates; it still speaks of the plate's dofs."""
    reduced_structure = fc.reduce_structure(wide_plate.damped(None), modes=5)
    damped_model = reduced_structure.damped(fc.ModalDamping(0.02))
    assert damped_model.whole is reduced_structure.whole and damped_model.reference is not None
    assert damped_model.damping == damped_model.reference.damping == fc.ModalDamping(0.02)
    modes = fc.solve_modes(damped_model, 3)
    solution = fc.solve_linear(damped_model, 1.01 * modes.omega[0], harmonics=1)
    full_solution = fc.solve_linear(wide_plate.damped(fc.ModalDamping(0.02)), solution.omega)
    dof = [wide_plate.n_dofs - 1]
    np.testing.assert_allclose(
        solution.coefficients_at(dof)[:3],
        full_solution.coefficients_at(dof)[:3],
        rtol=1e-4,
        atol=1e-12,
    )


def test_changed_reduction_has_no_positions(wide_plate: fc.Structure) -> None:
    """Its coordinates are no longer dofs of the plate, and it says so."""
    catch_error(
        lambda: fc.reduce_structure(wide_plate, modes=5).tied(1.0).find_dof((0.1, 0.1), "x"),
        "point",
        (0.1, 0.1),
    )


# --- arguments ------------------------------------------------------------------------------------


def test_default_modes_are_the_damped_ones(soft_plate: fc.Structure) -> None:
    """As many as are damped, else 20."""
    models = [fc.reduce_structure(chain(kind, 60), method="massless") for kind in DAMPINGS]
    assert [len(model.omega) for model in models] == [60, 60, 20, 3, 20]
    assert len(fc.reduce_structure(soft_plate, method="massless").omega) == 50


@pytest.fixture(scope="module")
def fine_plate(paper_scene: fc.Scene) -> fc.Structure:
    """1,652 dofs, one pair, all modes damped; to compute them all takes minutes."""
    changes = {"mesh.columns": 28, "mesh.rows": 28, "contact.pairs": "mouth", "damping.ratio": 0.02}
    return fc.build_structure(paper_scene.replace(changes))


@pytest.fixture
def counts(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many modes are asked for from now on."""
    mode_counts: list[int] = []

    def counted(
        solve: Callable[..., fc.Modes], factor: Any, structure: Any, count: int, *ties: Any
    ) -> fc.Modes:
        mode_counts.append(count)
        return solve(factor, structure, count, *ties)

    for module in ("receptance", "reduction", "modes"):
        wrap(monkeypatch, f"fenics_crack.model.{module}.solve_modes_with_factor", counted)
    return mode_counts


def test_of_a_large_structure_few_modes_are_computed(
    fine_plate: fc.Structure, counts: list[int]
) -> None:
    """50, or as many as are wanted; one ratio damps the modes of the reduced structure."""
    assert fine_plate.n_dofs == 1652
    for modes in (None, 12):
        reduced_structure = fc.reduce_structure(fine_plate, modes=modes)
        assert counts == [modes or 50]
        del counts[:]
        assert reduced_structure.damping == fc.ModalDamping(0.02)
        assert reduced_structure.reference.damping == reduced_structure.damping


def test_one_ratio_of_all_coordinates(fine_plate: fc.Structure) -> None:
    """The same as with the damping given to the reduced structure, and as a number of modes."""
    reduced_structure = fc.reduce_structure(fine_plate)
    later = fc.reduce_structure(fine_plate.damped(None), modes=50).damped(fc.ModalDamping(0.02))
    damping_of_all = fc.ModalDamping(0.02, fine_plate.n_dofs)
    exact = compliances(reduced_structure, 1000.0, 5)[0]
    assert relative(compliances(later, 1000.0, 5)[0], exact) < 1e-12
    reduced_plate = fc.reduce_structure(fine_plate.damped(damping_of_all))
    assert relative(compliances(reduced_plate, 1000.0, 5)[0], exact) < 1e-12


@pytest.mark.parametrize("modes", [None, 10])
def test_a_ratio_for_each_of_too_many_modes(
    modes: int | None, fine_plate: fc.Structure, counts: list[int]
) -> None:
    """They would all have to be computed: refused at once, with what is allowed."""
    damped_plate = fine_plate.damped(fc.ModalDamping(np.linspace(0.01, 0.02, fine_plate.n_dofs)))
    catch_error(
        lambda: fc.reduce_structure(damped_plate, modes=modes),
        "damping ratio",
        "1652 ratios for all 1652 modes",
        names=" 600 dofs",
    )
    assert counts == []
    plate_of_8_ratios = fine_plate.damped(fc.ModalDamping(np.linspace(0.01, 0.02, 8), 8))
    assert fc.reduce_structure(plate_of_8_ratios, modes=modes).n_dofs < 16


def test_what_reduces_by_itself(fine_plate: fc.Structure, counts: list[int]) -> None:
    """Curves and solutions to a tolerance ask for few modes of the whole structure."""
    law = fc.UnilateralPenalty(1e9)
    curve = fc.continue_frequency(fine_plate, 1500.0, 1600.0, law)
    assert curve.complete and counts[0] == 100  # 50, and those of the reference
    solution = fc.solve_harmonic_balance(fine_plate, 1500.0, law, tolerance=0.03)
    assert solution.converged and solution.structure.whole is fine_plate
    assert max(counts) <= 100  # all of a reduced structure are few


@pytest.mark.parametrize("modes", [0, -1, 51, 2.5, True, "all", np.inf])
def test_bad_number_of_modes_is_named(soft_plate: fc.Structure, modes: object) -> None:
    """Between 1 and the number of dofs."""
    catch_error(
        lambda: fc.reduce_structure(soft_plate, modes=modes),
        "modes",
        modes,
        names="50" if type(modes) is int else None,
    )


def test_bad_method_is_named(soft_plate: fc.Structure) -> None:
    """One of three."""
    catch_error(lambda: fc.reduce_structure(soft_plate, method="guyan"), "method", "guyan")


def test_numpy_counts_are_counts(soft_plate: fc.Structure) -> None:
    """A number of NumPy's kinds is accepted as a count."""
    assert fc.reduce_structure(soft_plate, modes=np.int64(4), method="massless").n_dofs == 7


def reductions(scene: fc.Scene, comm: MPI.Comm) -> list[np.ndarray]:
    """Frequencies and |R_k| of a basis (collective)."""
    plate = fc.build_structure(scene, comm)
    arrays = []
    reduced_structure = fc.reduce_structure(plate, modes=8)
    arrays += [reduced_structure.omega, np.abs(compliances(reduced_structure, 1500.0, 4)[0])]
    return arrays


@pytest.mark.mpi
def test_same_reduction_on_two_ranks(paper_scene: fc.Scene, on_ranks: Callable[..., Any]) -> None:
    """Frequencies of a basis, and R_k, agree with one rank's to 1e-7."""
    changes = {"mesh.columns": 6, "mesh.rows": 6, "damping.ratio": 0.01, "damping.modes": 8}
    scene = paper_scene.replace(changes)
    parallel = on_ranks(reductions, scene)
    for array_of_ranks, array_of_one_rank in zip(
        parallel, reductions(scene, MPI.COMM_SELF), strict=True
    ):
        assert relative(array_of_ranks, array_of_one_rank) < 1e-7


def test_all_modes_damped_whatever_the_mesh() -> None:
    """A scene with all modes damped: those of the reduced structure, within its error."""
    scene = fc.Scene.load(ROOT / "benchmarks" / "plate.toml").replace(
        {
            "mesh.size": 0.03, "mesh.order": 1, "mesh.lip_elements": 3, "reduction.modes": 10,
            "reduction.method": "free_interface", "contact.law": "penalty",
            "contact.stiffness_per_area": 3e11,
        }
    )  # fmt: skip
    assert scene.contact is not None and scene.damping.modes == "all"
    solutions = [
        fc.solve_harmonic_balance(study.structure, 2000.0, study.contact, harmonics=9)
        for study in (fc.prepare(scene), fc.prepare(scene.replace({"reduction.method": "off"})))
    ]
    reduced_gap, full_gap = (solution.gap_coefficients for solution in solutions)
    difference = np.linalg.norm(reduced_gap - full_gap) / np.linalg.norm(full_gap)
    assert solutions[0].structure.n_dofs < solutions[1].structure.n_dofs == 402
    assert difference < 3.0 * solutions[0].report.reduction < 1e-3
    fine_scene = scene.replace({"mesh.size": 0.004, "mesh.order": 2})
    fine_structure = fc.prepare(fine_scene).structure  # else minutes
    assert fine_structure.whole.n_dofs > 4000 and fine_structure.n_dofs < 50


@pytest.mark.parametrize("modes", [6, 7])
@pytest.mark.parametrize("uneven", [0.0, 0.3])
def test_a_reference_of_few_more_modes_tells_what_these_leave_out(
    modes: int, uneven: float
) -> None:
    """Two alike chains of four masses and a crack between them: every other mode does not move its
    lips, and a seventh mode told 2e-4 where six are 6 % from the whole structure."""
    stiffness = 200.0 * np.eye(8) - 100.0 * (np.eye(8, k=1) + np.eye(8, k=-1))
    stiffness[3:5, 3:5] = [[120.0, -20.0], [-20.0, 120.0]]
    gap = np.zeros(8)
    gap[3:5] = 1.0, -1.0
    force, mass = np.zeros(8), np.diag(0.1 * (1.0 + uneven * np.sin(np.arange(8.0))))
    force[-1] = 1.0
    full_structure = fc.Structure.from_matrices(
        mass, stiffness, gap=gap, force_sin=force, force_mean=0.3 * force, clearance=2e-3,
        damping=fc.ModalDamping(0.02),
    )  # fmt: skip
    reduced_structure = fc.reduce_structure(full_structure, modes=modes, method="massless")
    solution, exact = (
        fc.solve_harmonic_balance(model, 7.0, fc.UnilateralPenalty(1e3), harmonics=60)
        for model in (reduced_structure, full_structure)
    )
    time = np.linspace(0.0, exact.period, 500, endpoint=False)
    size = size_of_motion(exact.gap(time) + full_structure.clearance)
    error = np.linalg.norm(solution.gap(time) - exact.gap(time)) / size
    assert 0.01 < 0.5 * error < solution.report.reduction < 2.0 * error
