"""Lips without mass: modes with free lips, and statically all that these leave out."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from helpers import (
    DAMPINGS,
    DEMOS,
    catch_error,
    chain,
    dense_matrices,
    random_stiffness,
    relative,
    wrap,
)
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack import MasslessStructure
from fenics_crack.model.matrices import AbsentMatrix
from fenics_crack.model.receptance import Receptance, make_shared_receptance_cache, receptance


def reduced(structure: fc.Structure, modes: int) -> MasslessStructure:
    """Without mass on the lips."""
    return fc.reduce_structure(structure, modes=modes, method="massless")


def compliance_of(structure: fc.Structure, base: float, harmonics: int) -> Any:
    """R_k, k = 0 to H, and what follows from contact forces."""
    return fc.Problem(structure, base, fc.UnilateralConstraint(), harmonics).compliance_model()


def seen(structure: fc.Structure, base: float, harmonics: int) -> tuple[np.ndarray, np.ndarray]:
    """R_k, k = 0 to H, and the linear gap."""
    compliance = compliance_of(structure, base, harmonics)
    return compliance.matrices, compliance.linear_gap


def flexibility(structure: fc.Structure, modes: int) -> np.ndarray:
    """G, the sum over LAPACK's modes that are left out."""
    mass, _, stiffness = dense_matrices(structure)
    squares, shapes = scipy.linalg.eigh(stiffness, mass)
    left_out = shapes[:, modes:]
    return (left_out / squares[modes:]) @ left_out.T


# --- what pairs see -------------------------------------------------------------------------------


@pytest.mark.parametrize("unconstrained", [False, True])
@pytest.mark.parametrize("modes", [2, 9, 19])
def test_residual_is_what_the_modes_leave_out(modes: int, unconstrained: bool) -> None:
    """R_inf = B^T G B of dense matrices; symmetric, and positive definite."""
    structure = chain("none", 24, unconstrained=unconstrained)
    residual = reduced(structure, modes).residual_compliance
    gap = structure.gap.toarray()
    assert relative(residual, gap.T @ flexibility(structure, modes) @ gap) < 1e-8
    assert np.array_equal(residual, residual.T) and np.linalg.eigvalsh(residual)[0] > 0.0


def test_residual_beside_a_load_like_a_pair() -> None:
    """A load that is a pair's force but for 1e-5 makes S nearly singular; R_inf stays exact."""
    base_chain = chain("none", 24)
    mass, _, stiffness = dense_matrices(base_chain)
    gap = base_chain.gap.toarray()
    load = gap[:, 0] + 1e-5 * np.cos(np.arange(24.0))
    structure = fc.Structure.from_matrices(mass, stiffness, gap=gap, force_cos=load)
    model = reduced(structure, 9)
    exact_residual = gap.T @ flexibility(structure, 9) @ gap
    assert relative(model.residual_compliance, exact_residual) < 1e-11
    assert (
        relative(
            fc.Problem(model, 1.0, fc.UnilateralConstraint(), 3).residual_compliance, exact_residual
        )
        < 1e-11
    )


def test_no_penetration_takes_what_modes_leave_out() -> None:
    """Where that is nothing, the law is named as a scene does, and what to do."""
    problem = fc.Problem(reduced(chain("none", 20), 20), 1.0, fc.UnilateralConstraint(), 3)
    error = catch_error(lambda: problem.residual_compliance, "contact law", "unilateral")
    assert (error.key, error.value) == ("contact law", "unilateral")


def test_residual_of_what_is_hardly_held() -> None:
    """The same where a spring 1e-11 as stiff as others holds a chain: its mode is no part of it."""
    free_chain = chain("none", 24, unconstrained=True)
    mass, _, stiffness = dense_matrices(free_chain)
    stiffness[0, 0] += 1e-11
    structure = fc.Structure.from_matrices(mass, stiffness, gap=free_chain.gap)
    model, gap = reduced(structure, 9), structure.gap.toarray()
    assert 0.0 < model.omega[0] < 1e-6
    assert relative(model.residual_compliance, gap.T @ flexibility(structure, 9) @ gap) < 1e-8


@pytest.mark.parametrize("damping", DAMPINGS)
def test_with_all_modes_nothing_is_left_out(damping: str) -> None:
    """R_inf = 0; R_k, the linear gap, and contact are those of the whole structure."""
    structure, law = chain(damping, 20), fc.UnilateralPenalty(4.0)
    damped_structure = structure
    if damping == "few modes":  # of the reduced one all are damped, by the last ratio
        ratios = (0.05, 0.02, 0.08, *[0.08] * 17)
        damped_structure = structure.damped(fc.ModalDamping(ratios))
    model = reduced(structure, 20)
    assert not np.any(model.residual_compliance)
    base = 0.41 * fc.solve_modes(structure, 1).omega[0]
    for part, exact_part in zip(seen(model, base, 6), seen(damped_structure, base, 6), strict=True):
        assert relative(part, exact_part) < 1e-9
    if damping != "none":  # modes above 2 H w would answer at once
        assert 2 * 8 * 0.8 > fc.solve_modes(structure, 20).omega[-1]
        reduced_solution, full_solution = (
            fc.solve_harmonic_balance(s, 0.8, law, harmonics=8, residual_tolerance=1e-12)
            for s in (model, damped_structure)
        )
        assert relative(reduced_solution.gap_coefficients, full_solution.gap_coefficients) < 1e-8


@pytest.mark.parametrize("damping", DAMPINGS)
def test_static_response_is_exact(damping: str) -> None:
    """R_0 and the mean gap of dense matrices, with three modes of 30."""
    structure = chain(damping, 30)
    _, _, stiffness = dense_matrices(structure)
    gap, base = structure.gap.toarray(), 0.3 * fc.solve_modes(structure, 1).omega[0]
    matrices, linear = seen(reduced(structure, 3), base, 1)
    assert relative(matrices[0].real, gap.T @ np.linalg.solve(stiffness, gap)) < 1e-10
    assert not np.any(matrices[0].imag)
    mean = gap.T @ np.linalg.solve(stiffness, structure.force[0]) - structure.clearance
    assert relative(linear[0], mean) < 1e-10


@pytest.mark.parametrize("damping", ["modal", "rayleigh", "matrix"])
def test_compliance_tends_to_that_of_the_whole(damping: str) -> None:
    """R_k for k = 0 to 5 and the linear gap, errors falling to zero."""
    structure = chain(damping, 40)
    base = 0.7 * fc.solve_modes(structure, 1).omega[0]
    exact, linear = seen(structure, base, 5)
    errors = []
    for modes in (6, 12, 24, 38, 40):
        matrices, gap = seen(reduced(structure, modes), base, 5)
        errors.append(relative(matrices[1:], exact[1:]) + relative(gap, linear))
    assert errors[0] < 0.5 and errors[1] < 0.6 * errors[0] and errors[2] < 0.6 * errors[1]
    assert errors[-1] < 1e-9


def test_error_of_the_compliance_is_of_second_order_in_frequency() -> None:
    """Without damping R(w) is wrong by w^2 B^T G M G B."""
    structure = chain("none", 30)
    mass, _, _ = dense_matrices(structure)
    gap, rest = structure.gap.toarray(), flexibility(structure, 4)
    model = reduced(structure, 4)
    omega = 0.1 * fc.solve_modes(structure, 1).omega[0]
    difference = seen(structure, omega, 1)[0][1] - seen(model, omega, 1)[0][1]
    assert relative(difference, omega**2 * gap.T @ rest @ mass @ rest @ gap) < 1e-2


# --- displacements --------------------------------------------------------------------------------


@pytest.mark.parametrize("unconstrained", [False, True])
def test_displacement_is_that_of_dense_matrices(unconstrained: bool) -> None:
    """u = Phi q + G (f - B lambda) for any coordinates; some dofs of it; and B^T u is the gap."""
    structure = chain("modal", 24, unconstrained=unconstrained)
    model, rng = reduced(structure, 5), np.random.default_rng(2)
    loads = structure.force[np.any(structure.force != 0.0, axis=1)]
    assert model.n_dofs == 5 + 3 + len(loads) and model.n_modes == 5
    coordinates = rng.normal(size=(4, model.n_dofs))
    forces = coordinates[:, 5:8] @ structure.gap.toarray().T + coordinates[:, 8:] @ loads
    dense_displacement = coordinates[:, :5] @ model.basis.T + forces @ flexibility(structure, 5)
    displacement = model.expand(coordinates)
    assert relative(displacement, dense_displacement) < 1e-9
    assert (
        relative(model.values_at(coordinates, [7, 2, 7]), dense_displacement[:, [7, 2, 7]]) < 1e-9
    )
    assert relative(structure.apply_bt(displacement), model.apply_bt(coordinates)) < 1e-9
    catch_error(lambda: model.values_at(coordinates, [24]), "dofs", [24])
    # Rows without static parts need no solution.
    assert relative(model.expand(np.eye(model.n_dofs)[:5]), model.basis.T) < 1e-14


def test_mass_and_stiffness_are_those_of_the_motion() -> None:
    """Energies: half q'^T M q' of the modes alone, half u^T K u of all."""
    structure = chain("modal", 24)
    _, _, stiffness = dense_matrices(structure)
    model = reduced(structure, 5)
    small_mass, _, small_stiffness = dense_matrices(model.damped(None))
    coordinates = np.random.default_rng(3).normal(size=(6, model.n_dofs))
    displacement = model.expand(coordinates)
    energy = np.einsum("ij,jk,ik->i", displacement, stiffness, displacement)
    assert (
        relative(np.einsum("ij,jk,ik->i", coordinates, small_stiffness, coordinates), energy) < 1e-9
    )
    assert np.array_equal(small_mass, np.diag(np.repeat([1.0, 0.0], [5, model.n_dofs - 5])))
    work = np.einsum("pj,ij->ip", structure.force, displacement)
    assert relative(coordinates @ model.force.T, work) < 1e-9


@pytest.mark.parametrize(
    "law", [fc.UnilateralPenalty(1e9), fc.UnilateralConstraint()], ids=["penalty", "rigid"]
)
@pytest.mark.parametrize("kind", ["massless", "whole"])
def test_gap_is_that_of_the_displacement(kind: str, law: Any, wide_plate: fc.Structure) -> None:
    """g(t) = B^T u(t) - g0 at all times, kinks included, and no penetration of a rigid one."""
    structure = reduced(wide_plate, 20) if kind == "massless" else wide_plate
    solution = fc.solve_harmonic_balance(structure, 2000.0, law, harmonics=8)
    time = np.linspace(0.0, solution.period, 40)
    field = solution.displacement_field(time)
    assert relative(wide_plate.apply_bt(field), solution.gap(time)) < 1e-9
    assert relative(solution.displacement(time, [3, 50]), field[:, [3, 50]]) < 1e-9
    penetration_share = solution.gap(time).max() / np.abs(solution.gap(time)).max()
    assert (penetration_share < 1e-9) == isinstance(law, fc.UnilateralConstraint)


# --- varied and damped copies ---------------------------------------------------------------------


def test_varied_copies() -> None:
    """Loads mixed by a matrix, clearances, a factor of the damping: those of a varied whole."""
    structure = chain("modal", 20)
    load_mix = np.random.default_rng(4).normal(size=(3, 3))
    changes = {"load": load_mix, "clearance": [0.1, -0.2, 0.3], "damping": 1.7}
    base = 0.41 * fc.solve_modes(structure, 1).omega[0]
    varied_model = reduced(structure, 6).varied(**changes)
    model_of_varied = reduced(structure.varied(**changes), 6)
    for one_part, other_part in zip(
        seen(varied_model, base, 4), seen(model_of_varied, base, 4), strict=True
    ):
        assert relative(one_part, other_part) < 1e-9
    assert (
        relative(
            seen(varied_model.reference, base, 4)[1], seen(model_of_varied.reference, base, 4)[1]
        )
        < 1e-9
    )
    force = np.random.default_rng(5).normal(size=(9, 3))
    displacements = [
        model.expand(compliance_of(model, base, 4).displacement(force))
        for model in (varied_model, model_of_varied)
    ]
    assert relative(*displacements) < 1e-9


@pytest.mark.parametrize("load", [2.0, 0.0, -1.0, np.roll(np.eye(3), 1, axis=0)])
def test_damped_copies_of_varied_ones(load: Any) -> None:
    """The order of both does not matter; the static rest has the varied load."""
    structure = chain("modal", 20)
    structure = structure.varied(load=np.diag([1.0, 1.0, 0.0]))  # without a sine part
    damping, base = fc.ModalDamping(0.03), 0.41 * fc.solve_modes(structure, 1).omega[0]
    damped_model = reduced(structure, 6).varied(load=load).damped(damping)
    direct_model = reduced(structure.varied(load=load).damped(damping), 6)
    assert np.allclose(
        seen(damped_model, base, 2)[1], seen(direct_model, base, 2)[1], rtol=1e-9, atol=1e-12
    )
    force = np.ones((5, 3))
    damped_motion, direct_motion = (
        compliance_of(s, base, 2).displacement(force) for s in (damped_model, direct_model)
    )
    assert np.allclose(
        damped_model.expand(damped_motion),
        direct_model.expand(direct_motion),
        rtol=1e-9,
        atol=1e-11,
    )


def test_ratios_of_the_kept_modes() -> None:
    """Beyond those given the last one, with more modes in the reference too; none; Rayleigh's."""
    model = reduced(chain("none", 30), 5)
    ratios, mode_ratios = (0.01, 0.02, 0.03), [0.01, 0.02, 0.03, 0.03, 0.03]
    damped_model = model.damped(fc.ModalDamping(ratios))
    assert (
        isinstance(damped_model.reference, MasslessStructure)
        and damped_model.reference.n_modes == 15
    )
    assert np.allclose(damped_model.modal_damping, 2.0 * np.array(mode_ratios) * model.omega)
    assert np.allclose(
        damped_model.reference.modal_damping[5:], 0.06 * damped_model.reference.omega[5:]
    )
    assert np.allclose(model.damped(fc.ModalDamping([0.1] * 9)).modal_damping, 0.2 * model.omega)
    rule = fc.RayleighDamping(0.2, 0.1)
    assert np.allclose(model.damped(rule).modal_damping, 0.2 + 0.1 * model.omega**2)
    assert not np.any(damped_model.damped(None).modal_damping)
    catch_error(lambda: model.damped(0.1), "damping", 0.1)  # type: ignore[arg-type]


# --- unusual structures ---------------------------------------------------------------------------


def test_load_among_the_contact_forces() -> None:
    """A load on a pair itself: the static coordinates depend on each other, and nothing is lost."""
    base = chain("modal", 20)
    mass, _, stiffness = dense_matrices(base)
    gap = base.gap.toarray()
    structure = fc.Structure.from_matrices(
        mass, stiffness, gap=gap, force_cos=2.0 * gap[:, 0] - gap[:, 2], force_sin=gap[:, 1],
        damping=fc.ModalDamping(0.03),
    )  # fmt: skip
    model, omega = reduced(structure, 5), 0.41 * fc.solve_modes(structure, 1).omega[0]
    assert relative(model.residual_compliance, gap.T @ flexibility(structure, 5) @ gap) < 1e-9
    compliance, force = compliance_of(model, omega, 2), np.ones((5, 3))
    displacement = model.expand(compliance.displacement(force))
    assert relative(structure.apply_bt(displacement)[1:], made_gap(compliance, force)[1:]) < 1e-9
    static_displacement = np.linalg.solve(stiffness, -structure.apply_b(force[:1]).T).T
    assert relative(displacement[:1], static_displacement) < 1e-9


def made_gap(compliance: Any, force: np.ndarray) -> np.ndarray:
    """g_lin - R lambda by rows a0, a1, b1, ...."""
    amplitude = force[1::2] - 1j * force[2::2]
    gap_rows = compliance.linear_gap.copy()
    for k, wave in enumerate(amplitude, start=1):
        response = compliance.matrices[k] @ wave
        gap_rows[2 * k - 1] -= response.real
        gap_rows[2 * k] += response.imag
    gap_rows[0] -= compliance.matrices[0].real @ force[0]
    return gap_rows


def test_without_a_load_and_without_pairs() -> None:
    """Only what is there has coordinates."""
    rng = np.random.default_rng(1)
    stiffness, gap = random_stiffness(rng, 12), rng.normal(size=(12, 2))
    unloaded_model = reduced(fc.Structure.from_matrices(np.eye(12), stiffness, gap=gap), 4)
    assert unloaded_model.n_dofs == 6 and not np.any(unloaded_model.force)
    linear = fc.Structure.from_matrices(np.eye(12), stiffness, gap=None, force_cos=gap[:, 0])
    model = reduced(linear, 4)
    assert model.n_dofs == 5 and model.residual_compliance.shape == (0, 0)


def test_what_is_held_does_not_grow_with_the_pairs(paper_scene: fc.Scene) -> None:
    """No array of n_dofs rows for every pair: the modes alone have a row for each dof."""
    plate = fc.build_structure(
        paper_scene.replace({"mesh.columns": 24, "mesh.rows": 24, "damping.ratio": 0.01})
    )
    assert plate.n_dofs > 1000 and plate.n_pairs == 12
    model = reduced(plate, 4)
    solution = fc.solve_harmonic_balance(model, 2000.0, fc.UnilateralPenalty(1e9), harmonics=3)
    solution.displacement_field(np.linspace(0.0, 1e-3, 3))
    solution.displacement(np.zeros(1), [3])
    shared_receptance = receptance(plate, 4)
    assert shared_receptance.n_modes == len(model.reference.omega) == 14
    for owner in (model, model.body, model.reference, model.reference.body, shared_receptance):
        for name, value in vars(owner).items():
            assert not isinstance(value, np.ndarray) or value.size < plate.n_dofs or name == "force"
    [shapes] = [value for value in plate.body.cache_of_matrix_results.values() if len(value) == 2]
    assert shapes[1].shape == (plate.n_dofs, 14) and np.shares_memory(model.basis, shapes[1])


@pytest.mark.drawn(4)
@pytest.mark.parametrize("damping", DAMPINGS)
@pytest.mark.parametrize("unconstrained", [False, True])
def test_any_number_of_modes_from_those_of_another(damping: str, unconstrained: bool) -> None:
    """Extended from fewer, or cut from more, a structure is what it is made anew; in any setting,
    by other dampings, and with displacements of any dof."""
    rigid = int(unconstrained)

    def numbers(structure: fc.Structure, modes: int) -> list[np.ndarray]:
        structure = structure.varied(load=2.0, damping=3.0, clearance=0.1)
        model, motion = reduced(structure, modes), []
        for version in (model, model.reference):
            coordinates = np.sin(np.arange(3.0 * version.n_dofs)).reshape(3, -1)
            field = version.expand(coordinates)
            dofs = [0, 7, structure.n_dofs - 1]
            assert relative(version.values_at(coordinates, dofs), field[:, dofs]) < 1e-8
            motion += [
                version.omega,
                version.residual_compliance,
                version.force,
                version.clearance,
                field,
            ]
            motion += [np.asarray(version.damping_multiplier * version.modal_damping)]
        return motion

    base_chain = chain(damping, 40, unconstrained=unconstrained)
    for modes in (rigid + 12, rigid + 3, rigid + 25, 40, rigid + 5):
        anew = numbers(chain(damping, 40, unconstrained=unconstrained), modes)
        for reused_array, fresh_array in zip(numbers(base_chain, modes), anew, strict=True):
            assert np.linalg.norm(reused_array - fresh_array) <= 1e-7 * np.linalg.norm(fresh_array)


def test_another_load_or_damping_needs_no_factor(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the load is a sum of the parts of another; else statics are solved for."""
    force = np.array(chain("modal", 40).force)
    harmonics = {1: (3.0 * force[2], None), 2: (force[1] - force[0], 0.5 * force[2])}
    load = {3: (None, np.linspace(0.0, 1.0, 40))}
    base_chain, factorisations = chain("modal", 40), list[int]()
    reduced(base_chain, 8)
    fresh_model = reduced(chain("rayleigh", 40).with_added_load_harmonics(harmonics), 6)

    def counted(make: Callable[..., Any], *given: Any, **options: Any) -> Any:
        factorisations.append(1)
        return make(*given, **options)

    wrap(monkeypatch, "fenics_crack.model.receptance.Factor", counted)
    changed_model = reduced(
        base_chain.with_added_load_harmonics(harmonics).damped(fresh_model.whole.damping), 6
    )
    assert not factorisations
    for name in ("omega", "force", "compliance", "modal_damping", "residual_compliance"):
        assert relative(getattr(changed_model, name), getattr(fresh_model, name)) < 1e-9
    dofs, motion = [changed_model.watched_dof], np.cos(np.arange(1.0 * fresh_model.n_dofs))[None]
    assert (
        relative(changed_model.values_at(motion, dofs), fresh_model.values_at(motion, dofs)) < 1e-9
    )
    expected_model = reduced(chain("modal", 40).with_added_load_harmonics(load), 6)
    factorisations.clear()
    assert (
        relative(reduced(base_chain.with_added_load_harmonics(load), 6).force, expected_model.force)
        < 1e-9
        and factorisations
    )


def test_from_arrays_alone() -> None:
    """A receptance gives a reduced structure without matrices; what it has not is refused."""
    full_structure = chain("modal", 30)
    full_model, full_receptance = reduced(full_structure, 6), receptance(full_structure, 16)
    parts = {
        name: getattr(full_receptance, name)
        for name in ("squares", "modal", "compliance", "rows", "inertia", "n_base")
    }
    bare_chain = chain("modal", 30)
    receptances = bare_chain.compute_once(make_shared_receptance_cache, from_matrices=True)
    receptances[:] = [Receptance(**parts, force=bare_chain.force)]
    object.__setattr__(bare_chain.body, "stiffness", AbsentMatrix(bare_chain.n_dofs, 0))
    array_model = reduced(bare_chain, 6)
    assert relative(array_model.residual_compliance, full_model.residual_compliance) < 1e-14
    dof = [full_model.watched_dof]
    motion = np.cos(np.arange(1.0 * array_model.n_dofs))[None]
    assert relative(array_model.values_at(motion, dof), full_model.values_at(motion, dof)) < 1e-12
    for refused_call in (
        lambda: array_model.expand(motion),
        lambda: array_model.values_at(motion, [3]),
    ):
        catch_error(refused_call, "structure", "a file of a prepared structure")


@pytest.mark.parametrize("modes", [4, 20])
@pytest.mark.parametrize("damping", DAMPINGS)
def test_linear_solution(damping: str, modes: int) -> None:
    """Lips that pass through each other: that of the compliance, from which contact starts too."""
    structure = chain(damping, 20)
    model = reduced(structure, modes)
    solution = fc.solve_linear(model, 0.8, harmonics=2)
    assert relative(solution.gap_coefficients, compliance_of(model, 0.8, 2).linear_gap) < 1e-9
    if modes == 20 and damping != "few modes":
        full_coefficients = fc.solve_linear(structure, 0.8, harmonics=2).displacement_coefficients
        assert relative(model.expand(solution.displacement_coefficients), full_coefficients) < 1e-8


def test_what_needs_mass_on_the_lips() -> None:
    """Other schemes in time, and another reduction, say so."""
    model, law = reduced(chain("modal", 20), 4), fc.UnilateralPenalty(4.0)
    for call in (
        lambda: fc.integrate_central_difference(model, 0.8, law, periods=1, steps_per_period=16),
        lambda: fc.stable_steps_per_period(model, 0.8, law),
        lambda: fc.reduce_structure(model, modes=3),
    ):
        catch_error(call, "structure")


# --- several ranks --------------------------------------------------------------------------------


def massless_numbers(scene: fc.Scene, comm: MPI.Comm) -> list[np.ndarray]:
    """Frequencies, R_inf, |R_k|, and the motion of a solution (collective)."""
    plate = fc.build_structure(scene, comm)
    model = reduced(plate, 8)
    solution = fc.solve_harmonic_balance(model, 1500.0, fc.UnilateralConstraint(), harmonics=6)
    time = np.linspace(0.0, solution.period, 7)
    corner = model.find_dof((0.1, 0.1), "x")
    gap = plate.apply_bt(solution.displacement_field(time))
    matrices = np.abs(compliance_of(model, 1500.0, 3).matrices)
    return [
        model.omega,
        model.residual_compliance,
        matrices,
        gap,
        solution.displacement(time, [corner]),
    ]


@pytest.mark.mpi
@pytest.mark.parametrize("cells", ["linear", "quadratic"])
def test_same_on_two_ranks(cells: str, on_ranks: Callable[..., Any], paper_scene: fc.Scene) -> None:
    """The reduction, and a rigid solution of it, agree with one rank's: 6 x 6 cells, and 4,000 dofs
    with 18 pairs."""
    scene = paper_scene.replace({"mesh.columns": 6, "mesh.rows": 6, "damping.ratio": 0.01})
    if cells == "quadratic":
        length = {"crack.length": 0.0428, "crack.first_omega": None}
        scene = fc.Scene.load(DEMOS / "breathing_plate.toml").replace(length)
    parallel = on_ranks(massless_numbers, scene)
    for array_of_ranks, array_of_one_rank in zip(
        parallel, massless_numbers(scene, MPI.COMM_SELF), strict=True
    ):
        assert relative(array_of_ranks, array_of_one_rank) < 1e-8
