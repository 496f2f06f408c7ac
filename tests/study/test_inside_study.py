"""Insides of the commands: key figures of a scene against dense algebra and solutions, remarks on
what is unusual, memory, failed runs of a study, schemes of an integration."""

import functools
import gc
import math
import resource
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gmsh
import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sparse
from helpers import DEMOS, ROOT, catch_error, chain_stiffness, gmsh_model
from mpi4py import MPI
from petsc4py import PETSc
from test_verify import plate

import fenics_crack as fc
from fenics_crack.balance.solution import HarmonicBalanceSolver
from fenics_crack.errors.numbers import compute_numbers
from fenics_crack.fem import blocks
from fenics_crack.fem.interaction_integral import Tip
from fenics_crack.model.factor import Factor, make_matrix_from_local_rows
from fenics_crack.study import prepare
from fenics_crack.study.key_figures import (
    PreSolutionKeyFigures,
    _round_to_three_digits,
    find_key_figures,
    highest_harmonic_omega,
    is_response_proportional_to_load,
    lowest_and_highest_load_omega,
)
from fenics_crack.study.meshes import refine_scene_or_none
from fenics_crack.study.observer import compute_crack_tip_histories
from fenics_crack.study.plausibility import remarks_on_scene

PAPER = fc.Scene.load(DEMOS / "paper_plate.toml").replace({"damping.ratio": 0.01})
GRID = PAPER.replace({"mesh.columns": 6, "mesh.rows": 6})


def figures_of(scene: fc.Scene) -> PreSolutionKeyFigures:
    """Of the whole structure."""
    return find_key_figures(fc.prepare(scene, whole=True))


def study_of(structure: fc.Structure) -> fc.Study:
    """A study of a structure from matrices, with a law."""
    names = ("mass", "stiffness", "gap", "force_sin")
    text = "".join(f"{name} = '{name}.mtx'\n" for name in names)
    text = f"[structure]\n{text}[damping]\nratio = 0.1\n[excitation]\nomega = 1.1\n"
    scene = fc.Scene.from_text(f"{text}[contact]\nstiffness = 10.0\n")
    return fc.Study(scene, structure, fc.UnilateralPenalty(10.0), ())


def test_of_what_nothing_holds() -> None:
    """Static figures are those of the deformation, as the structure accelerates; the motion at a
    frequency is that of the whole equations."""
    free_stiffness = chain_stiffness(np.array([0.0, 1.0, 2.0, 0.0]))
    zero = np.zeros((3, 3))
    stiffness, mass = (
        np.block([[free_stiffness, zero], [zero, free_stiffness]]),
        np.diag(np.arange(1.0, 7.0)),
    )
    gap, force = np.array([0.0, 0.0, 1.0, -1.0, 0.0, 0.0]), np.arange(6.0)
    structure = fc.Structure.from_matrices(
        mass, stiffness, gap=gap, force_sin=force, damping=fc.ModalDamping(0.1)
    )
    figures = find_key_figures(study_of(structure))
    squares, shapes = scipy.linalg.eigh(stiffness, mass)
    elastic_shapes = shapes[:, 2:]
    compliance = (elastic_shapes / squares[2:]) @ elastic_shapes.T
    assert list(figures.omega_open[:2]) == [0.0, 0.0]
    assert figures.face_stiffness_at_pairs[0] == pytest.approx(
        1.0 / (gap @ compliance @ gap), rel=1e-9
    )
    assert figures.largest_static_gap_motion == pytest.approx(
        abs(gap @ compliance @ force), rel=1e-9
    )
    omega = np.sqrt(np.abs(squares))
    omega[:2] = 0.0
    modal_response = 1.0 / (omega**2 - 1.1**2 + 0.2j * omega * 1.1)
    modal_response[4:] = 1.0 / omega[4:] ** 2  # only four modes move, the others follow
    gap_response = gap @ (shapes * modal_response) @ shapes.T @ force
    assert figures.peak_open_crack_gap_motion == pytest.approx(abs(gap_response), rel=1e-7)


def test_all_harmonics_of_a_load_count() -> None:
    """The motion of the faces is at most the sum of those at each multiple of the frequency."""
    stiffness, mass = chain_stiffness(np.array([1.0, 2.0, 1.0, 0.5])), np.diag([1.0, 1.2, 0.9])
    gap, first_force, third = np.array([[1.0, -1.0, 0.0], [0.5, 0.0, 1.0], [0.0, 2.0, -1.0]])
    structure = fc.Structure.from_matrices(
        mass, stiffness, gap=gap, force_sin=first_force, damping=fc.ModalDamping(0.1)
    )
    figures = find_key_figures(study_of(structure.with_added_load_harmonics({3: (None, third)})))
    squares, shapes = scipy.linalg.eigh(stiffness, mass)

    def moved(omega: float, force: np.ndarray) -> float:
        modal_response = 1.0 / (squares - omega**2 + 0.2j * np.sqrt(squares) * omega)
        return float(abs(gap @ (shapes * modal_response) @ shapes.T @ force))

    assert figures.peak_open_crack_gap_motion == pytest.approx(
        moved(1.1, first_force) + moved(3.3, third), rel=1e-9
    )
    assert figures.largest_static_gap_motion == pytest.approx(
        moved(0.0, first_force) + moved(0.0, third), rel=1e-9
    )


def test_all_motions_are_tied() -> None:
    """As many pairs as dofs: there is no tied motion, and a closed half takes no time."""
    structure = fc.Structure.from_matrices(
        np.eye(2), np.diag([1.0, 4.0]), gap=np.eye(2), force_sin=[1.0, 0.0]
    )
    figures = find_key_figures(study_of(structure))
    np.testing.assert_allclose(figures.omega_open, [1.0, 2.0], rtol=1e-12)
    assert list(figures.omega_tied) == [np.inf, np.inf]
    assert figures.omega_bilinear[0] == pytest.approx(2.0, rel=1e-12)


@pytest.mark.parametrize(("mode", "expected_modes"), [(2, (1, 2, 3)), (4, (1, 2, 3, 4))])
def test_natural_frequencies_beside_other_numbers(mode: int, expected_modes: tuple) -> None:
    """The lowest three, and that of the mode; of a chain mode k has 2 sin(k pi / (2 n + 2))."""
    structure = fc.Structure.from_matrices(
        np.eye(5), chain_stiffness(np.ones(6)), gap=np.eye(5)[2], force_sin=np.eye(5)[0],
        damping=fc.ModalDamping(0.1),
    )  # fmt: skip
    study = replace(study_of(structure), watched=(prepare.WatchedDisplacement("", "last mass", 4),))
    solution = fc.solve_harmonic_balance(structure, 1.1, study.contact, harmonics=3)
    numbers = compute_numbers(study, solution, mode)
    is_open = {
        name: value for name, value in numbers.values_by_name.items() if "omega_open" in name
    }
    assert is_open == pytest.approx(
        {f"omega_open_{k}": 2.0 * np.sin(k * np.pi / 12.0) for k in expected_modes}, rel=1e-9
    )


def test_against_dense_algebra() -> None:
    """Stiffness of the lips, frequencies, and static motion under mean and amplitude."""
    loads = {"excitation.force_mean": (-30.0, 9.0), "excitation.force_cos": (5.0, 2.0)}
    scene = GRID.replace(loads)
    structure, figures = fc.build_structure(scene), figures_of(scene)
    mass, stiffness = (
        matrix.convert("dense").getDenseArray() for matrix in (structure.mass, structure.stiffness)
    )
    gap = structure.gap.toarray()
    compliance = gap.T @ np.linalg.solve(stiffness, gap)
    np.testing.assert_allclose(
        figures.face_stiffness_at_pairs, 1.0 / np.diag(compliance), rtol=1e-9
    )
    np.testing.assert_allclose(
        figures.contact_stiffness_ratio, 1e11 * np.diag(compliance), rtol=1e-9
    )
    mean, cosine, sine = (gap.T @ np.linalg.solve(stiffness, f) for f in structure.force)
    assert figures.opening_under_mean_load == pytest.approx(max(0.0, -mean.min()), rel=1e-9)
    assert figures.largest_static_gap_motion == pytest.approx(
        np.hypot(cosine, sine).max(), rel=1e-9
    )
    omega = np.sqrt(scipy.linalg.eigh(stiffness, mass, eigvals_only=True))
    np.testing.assert_allclose(figures.omega_open, omega[:4], rtol=1e-8)
    assert figures.n_modes_below_highest_harmonic == np.sum(omega < 5 * 2000.0)
    tied_omega = np.sqrt(scipy.linalg.eigh(stiffness + 1e16 * gap @ gap.T, mass, eigvals_only=True))
    np.testing.assert_allclose(figures.omega_tied, tied_omega[:4], rtol=1e-3)
    ratio = scene.damping.ratio
    dynamic = stiffness - 2000.0**2 * mass
    shapes = scipy.linalg.eigh(stiffness, mass)[1]
    rates = mass @ shapes * (2.0 * ratio * omega) @ (mass @ shapes).T
    motion = np.linalg.solve(
        dynamic + 2000.0j * rates, structure.force[1] - 1j * structure.force[2]
    )
    assert figures.peak_open_crack_displacement == pytest.approx(
        abs(motion[structure.watched_dof]), rel=1e-3
    )
    assert figures.peak_open_crack_gap_motion == pytest.approx(
        np.abs(gap.T @ motion).max(), rel=2e-2
    )


@pytest.mark.usefixtures("predicted_errors")
@pytest.mark.parametrize("share", [0.8, 1.2])
def test_lips_that_never_meet_or_part(share: float) -> None:
    """One pair: a clearance, or a preload, just below and just above what the load moves."""
    free_figures = figures_of(PAPER)
    assert free_figures.breathes and free_figures.n_pairs_closed_by_mean_load == 0
    law = fc.UnilateralPenalty(1e11)
    distant_scene = PAPER.replace(
        {"crack.clearance": share * free_figures.peak_open_crack_gap_motion}
    )
    open_solution = fc.solve_harmonic_balance(fc.build_structure(distant_scene), 2000.0, law)
    is_touching = np.abs(open_solution.force_coefficients).max() > 1e-6
    assert figures_of(distant_scene).breathes == is_touching == (share < 1.0)
    # Of closed lips a constant preload is F = g0 / R(0); the load carries |s(w) / R(w)|.
    times = np.linspace(0.0, open_solution.period, 400)
    pressed_scene = PAPER.replace({"crack.clearance": -1.0})
    closed_solution = fc.solve_harmonic_balance(fc.build_structure(pressed_scene), 2000.0, law)
    force = closed_solution.contact_force(times)[:, 0]
    depth = np.ptp(force) / 2.0 / force.mean()  # clearance of -1 m: where the force just vanishes
    near_scene = PAPER.replace({"crack.clearance": -float(depth) / share})
    orbit = fc.solve_harmonic_balance(fc.build_structure(near_scene), 2000.0, law)
    assert figures_of(near_scene).n_pairs_closed_by_mean_load == 1
    assert (
        figures_of(near_scene).breathes
        == (orbit.contact_force(times).min() <= 0.0)
        == (share > 1.0)
    )


def test_mean_load_keeps_lips_apart_or_together() -> None:
    """Like a clearance and like a preload, and remarked on as such."""
    for force, texts in (((-1e5, 0.0), ("never closes", "never opens")), ((3.0, 0.0), ())):
        words = []
        for sign in (1.0, -1.0):
            scene = PAPER.replace({"excitation.force_mean": (sign * force[0], 0.0)})
            words += [
                str(remark) for remark in remarks_on_scene(scene, key_figures=figures_of(scene))
            ]
        assert len(words) == len(texts)
        assert all(any(text in word for word in words) for text in texts)


@pytest.mark.drawn(4)
@pytest.mark.parametrize(
    "demo",
    [
        pytest.param(
            path, marks=[pytest.mark.nightly] * (path.stem in ("bladed_disk", "solid_blade"))
        )
        for path in sorted(DEMOS.glob("*.toml"))
    ],
    ids=lambda path: path.stem,
)
def test_no_remark_on_demos(demo: Path, tmp_path: Path) -> None:
    """Every scene of demos is usual; a part is made as its demo makes it."""
    scene = fc.Scene.load(demo)
    if scene.geometry is not None and scene.geometry.file is not None:
        part = str(tmp_path / "part.step")
        with gmsh_model():
            gmsh.merge(str(ROOT / "meshes" / f"{demo.stem}.geo"))
            gmsh.write(part)
        scene = scene.replace({"geometry.file": part})
    study = fc.prepare(scene, whole=True)
    assert not remarks_on_scene(study.scene, study.structure, find_key_figures(study))


def test_uncracked_plate() -> None:
    """Frequencies alone; nothing meets or parts."""
    scene = PAPER.replace({"crack": None, "contact": None})
    figures = figures_of(scene)
    assert figures.n_elements_along_face is None and not figures.face_stiffness_at_pairs.size
    np.testing.assert_array_equal(figures.omega_open, figures.omega_tied)
    assert not remarks_on_scene(scene, key_figures=figures)


def test_breathing_frequency() -> None:
    """Half a period open, half of it tied: 1 / w = (1 / w_open + 1 / w_tied) / 2."""
    figures = figures_of(PAPER)
    inverse = (1.0 / figures.omega_open[0] + 1.0 / figures.omega_tied[0]) / 2.0
    assert figures.omega_bilinear[0] == pytest.approx(1.0 / inverse)


def test_breathing_frequency_is_of_one_shape() -> None:
    """Two masses that a pair ties, 1 open and sqrt(4.2 / 1.05) = 2 tied, and one alone of 1.5,
    which the tie takes them past."""
    mass, stiffness = np.diag([1.0, 0.05, 1.0]), np.diag([1.0, 3.2, 2.25])
    damping = fc.ModalDamping(0.1)
    structure = fc.Structure.from_matrices(
        mass, stiffness, gap=[1.0, -1.0, 0.0], force_sin=np.ones(3), damping=damping
    )
    figures = find_key_figures(study_of(structure))
    assert figures.omega_bilinear[0] == pytest.approx(2.0 / (1.0 + 0.5))
    assert figures.omega_tied == pytest.approx([1.5, 2.0, np.inf])


def test_frequencies_asked_for() -> None:
    """Of each command, from its own table or the excitation."""
    scene = PAPER.replace({"curve.start": 3000.0, "curve.stop": 1000.0})
    assert lowest_and_highest_load_omega(scene, "curve") == (1000.0, 3000.0)
    assert (
        lowest_and_highest_load_omega(scene, "solve")
        == lowest_and_highest_load_omega(scene, "sweep")
        == (2000.0, 2000.0)
    )
    assert highest_harmonic_omega(scene, "curve") == 5 * 3000.0


def test_proportional_to_the_load() -> None:
    """Without a clearance, and with a law that has no length of its own: so is the solution."""
    plate, law = fc.build_structure(PAPER), fc.UnilateralPenalty(1e9)
    single_solution, seven = (
        fc.solve_harmonic_balance(plate.varied(load=factor), 2000.0, law) for factor in (1.0, 7.0)
    )
    np.testing.assert_allclose(
        seven.gap_coefficients, 7.0 * single_solution.gap_coefficients, rtol=1e-6
    )
    assert is_response_proportional_to_load(PAPER)
    assert not is_response_proportional_to_load(PAPER.replace({"crack.clearance": 1e-7}))
    smoothed_settings = {"contact.law": "smoothed", "contact.sharpness": 1e8}
    assert not is_response_proportional_to_load(PAPER.replace(smoothed_settings))
    assert not is_response_proportional_to_load(fc.Scene.load(DEMOS / "chain.toml"))


def test_a_rotor_that_keeps_its_crack_open() -> None:
    """It is named by the key of its speed."""
    figures = figures_of(PAPER.replace({"excitation.force_sin": (1.0, 0.0)}))
    open_by_speed = replace(figures, breathes=False, n_pairs_closed_by_mean_load=0)
    turning_scene = PAPER.replace({"rotation.rpm": 100.0, "rotation.hub_radius": 0.2})
    [remark] = remarks_on_scene(turning_scene, key_figures=open_by_speed)
    assert remark.key == "rotation.rpm" and "never closes" in remark.text


def test_elements_along_each_lip() -> None:
    """As many as the scene asks for, also of a crack inside, whose tips are no pairs."""
    mesh = {"layout": "graded", "columns": None, "rows": None, "order": 2}
    changes = {f"mesh.{key}": value for key, value in mesh.items()}
    scene = PAPER.replace(changes | {"mesh.size": 0.05, "mesh.lip_elements": 4})
    inner_crack = {"crack.edge": None, "crack.center": 0.05, "crack.length": 0.04}
    for changed_scene in (scene, scene.replace(inner_crack)):
        assert figures_of(changed_scene).n_elements_along_face == 4
        remarks = remarks_on_scene(changed_scene, key_figures=figures_of(changed_scene))
        assert not any("elements" in str(remark) for remark in remarks)


# --- memory ---------------------------------------------------------------------------------------


def test_what_does_not_fit_is_refused(
    paper_scene: fc.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before it is reduced, with what it needs; and before it is meshed."""
    scene = paper_scene.replace({"mesh.columns": 8, "mesh.rows": 8})
    monkeypatch.setattr(prepare, "machine_memory", lambda: 1e7)
    catch_error(
        lambda: prepare.prepare(scene, MPI.COMM_SELF),
        "mesh.columns",
        8,
        names="152 degrees of freedom",
    )
    assert prepare.prepare(scene, MPI.COMM_SELF, whole=True).structure.n_dofs == 152
    monkeypatch.setattr(blocks, "machine_memory", lambda: 1e5)
    catch_error(lambda: fc.build_structure(scene, MPI.COMM_SELF), "mesh.columns", 8, names=" 64 ")


def test_more_modes_and_harmonics_need_more(wide_plate: fc.Structure) -> None:
    """Krylov vectors and shapes; a factor for each harmonic."""
    few_modes_memory = prepare.estimate_reduction_memory(wide_plate, 10, "massless")
    assert few_modes_memory < prepare.estimate_reduction_memory(wide_plate, 100, "massless")
    assert prepare.estimate_unreduced_memory(wide_plate, 5) < prepare.estimate_unreduced_memory(
        wide_plate, 50
    )


def test_parts_of_what_a_solid_needs() -> None:
    """A factor of a cube's stiffness and one of a plate's are within a factor of two of what is
    said, a matrix is what it holds."""
    for thickness in (0.03, 0.004):
        sides = {"width": 0.03, "height": 0.03, "thickness": thickness}
        solid = fc.Scene.from_mapping(
            {
                "geometry": {"kind": "solid"} | sides,
                "material": {"young": 2.1e11, "poisson": 0.3, "density": 7850.0},
                "damping": {"ratio": 0.01},
                "excitation": {"omega": 100.0},
                "loads": [{"edge": "front", "pressure_cos": 100.0}],
                "mesh": {"layout": "graded", "order": 2, "size": 0.005, "error": False},
            }
        )
        structure = fc.build_structure(solid, MPI.COMM_SELF)
        with Factor(structure.stiffness) as factor:
            entries = int(factor._factor.getMumpsInfog(9))
        assert 0.5 < prepare._estimate_factor_memory(structure) / (8.0 * entries) < 2.0
        _, columns, values = structure.stiffness.getValuesCSR()
        assert prepare._memory_of_unfactored_matrix(structure) == columns.nbytes + values.nbytes


def test_memory_that_is_freed_does_not_count(
    paper_scene: fc.Scene, wide_plate: fc.Structure, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is given back where there would not be enough otherwise."""
    prepare.release_freed_memory()
    needed_memory = prepare.estimate_and_check_solution_memory(paper_scene, wide_plate)
    pieces = [np.ones(10_000) for _ in range(1000)]
    machine = (needed_memory + 4e7) / 0.8
    monkeypatch.setattr(prepare, "machine_memory", lambda: machine)
    catch_error(
        lambda: prepare.estimate_and_check_solution_memory(paper_scene, wide_plate),
        "mesh.columns",
        2,
    )
    pieces[:-1] = []  # the last one holds the others' memory for the process
    assert prepare.estimate_and_check_solution_memory(paper_scene, wide_plate) < needed_memory + 1e7


def ordered_by(sides: int, dimension: int, dofs: int) -> int:
    """How MUMPS has ordered the rows of so many nodes a side, each with ``dofs`` unknowns and
    coupled to all that are next to it."""
    line = sparse.diags([-1.0, 2.5, -1.0], [-1, 0, 1], (sides, sides))
    nodes = functools.reduce(sparse.kron, [line] * dimension)
    matrix = make_matrix_from_local_rows(sparse.kron(nodes, np.eye(dofs) + 0.1), MPI.COMM_SELF)
    with Factor(matrix) as factor:
        return int(factor._factor.getMumpsInfog(7))


def test_rows_are_ordered_for_their_dimension() -> None:
    """A plane's for least fill, a solid's as MUMPS chooses for so many, both as a user says."""
    least_fill, degree = 2, 0
    assert ordered_by(75, 2, 2) == least_fill != ordered_by(18, 3, 2)
    options = PETSc.Options("crack_factor_")
    options["mat_mumps_icntl_7"] = degree
    try:
        assert ordered_by(75, 2, 2) == ordered_by(18, 3, 2) == degree
    finally:
        options.delValue("mat_mumps_icntl_7")
    assert ordered_by(75, 2, 2) == least_fill


@pytest.mark.nightly
def test_what_was_prepared_is_given_back(paper_scene: fc.Scene) -> None:
    """Matrices, factors and communicators of a scene are freed by the next ones: below 0.2 MiB in
    one of two stretches, as what is lost each time grows in both, and a heap now and then."""
    scene = paper_scene.replace({"mesh.columns": 30, "mesh.rows": 30, "damping.modes": 6})
    sizes = []
    for _ in range(40):
        fc.prepare(scene, MPI.COMM_SELF)
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        sizes.append(pages * resource.getpagesize() / 2**20)
    assert np.diff(sizes[9::15]).min() / 15 < 0.2


# --- how the commands compute ---------------------------------------------------------------------


@pytest.mark.nightly
def test_failed_runs_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that does not converge leaves two sizes and a factor of 3; two leave a cause unknown: of
    a smoothed law, which has no exact orbit."""
    bad: set[int] = set()
    law = {"contact.law": "smoothed", "contact.sharpness": 1e8}
    scene = plate(law | {"harmonic_balance.samples": 64})

    solve_function = HarmonicBalanceSolver.solve

    def failing(solver: HarmonicBalanceSolver, *how: Any, **more: Any) -> fc.PeriodicSolution:
        solution = solve_function(solver, *how, **more)
        if solution.harmonics in bad:
            return replace(solution, converged=False, status="lost")
        if solution.structure.n_modes == 24:
            raise fc.InputError("reduction.modes", 24, "less")
        return solution

    monkeypatch.setattr(HarmonicBalanceSolver, "solve", failing)
    bad.add(10)
    verification = fc.verify(scene)
    assert verification.failures == (
        "24 modes: reduction.modes = 24: must be less",
        "10 harmonics: lost",
    )
    part = verification.parts["harmonics"]["opening"]
    assert part.behaviour == "two sizes" and part.factor == 3.0
    assert any("10 harmonics: lost" in line for line in verification.statement)
    bad.add(20)
    verification = fc.verify(scene)
    assert "harmonics" in verification.unknown and "harmonics" not in verification.parts
    bad.add(5)
    catch_error(
        lambda: fc.verify(scene), names="the scene's settings: lost", kind=fc.ConvergenceError
    )


def test_stages_name_the_run(caplog: pytest.LogCaptureFixture) -> None:
    """Each stage is that of a run."""
    caplog.set_level("DEBUG", "fenics_crack")
    fc.verify(plate())
    stages = caplog.messages
    assert "the scene's settings: mesh" in stages and "a mesh 1.5 times finer: mesh" in stages
    assert any(text.startswith("24 modes: ") for text in stages)


def test_meshes_of_a_solid_are_similar() -> None:
    """Elements at the front, and what each next one is longer by, have the same ratio in all."""
    solid = fc.Scene.load(DEMOS.parent / "fenics_crack" / "cli" / "new_solid.toml")
    finer_scenes = [refine_scene_or_none(solid, factor) for factor in (1.5, 2.0)]
    meshes = [solid.mesh, *(scene.mesh for scene in finer_scenes if scene is not None)]
    fronts, rises = [], []
    for mesh in meshes:
        ratio = mesh.grading ** (1.0 / (mesh.lip_elements - 1))
        fronts.append(sum(ratio**number for number in range(mesh.lip_elements)))
        rises.append(1.0 / (ratio - 1.0))
    factors = [front / fronts[0] for front in fronts]
    assert factors == pytest.approx([1.0, 1.5, 2.0], rel=0.1)  # of whole elements
    assert factors == pytest.approx([rise / rises[0] for rise in rises], rel=1e-9)
    thickness = solid.geometry.thickness  # elements are no longer than that, whatever is asked for
    assert [mesh.size for mesh in meshes[1:]] == pytest.approx([thickness / f for f in factors[1:]])


FINE = {
    "mesh.columns": 8, "damping.ratio": 0.02, "reduction.modes": 10, "contact.stiffness": 1e9,
    "harmonic_balance.harmonics": 10,
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "scheme"),
    [
        ({}, "integrate_exponential"),
        ({"integration.method": "exponential"}, "integrate_exponential"),
        ({"reduction.method": "free_interface"}, "integrate_central_difference"),
        (
            {"reduction.method": "free_interface", "integration.method": "exponential"},
            "integrate_exponential",
        ),
        (
            {"reduction.method": "free_interface", "integration.method": "central_difference"},
            "integrate_central_difference",
        ),
        ({"reduction.method": "off", "integration.method": "events"}, "integrate_events"),
    ],
)
def test_method_of_integration(
    paper_scene: fc.Scene, changes: dict[str, Any], scheme: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scene's, or that of the structure."""
    call_options: list[dict[str, Any]] = []
    module = "central_differences" if scheme == "integrate_central_difference" else "flows"
    monkeypatch.setattr(
        f"fenics_crack.time.{module}.{scheme}", lambda *given, **rest: call_options.append(rest)
    )
    fc.integrate(paper_scene.replace(FINE | changes), MPI.COMM_SELF)
    assert len(call_options) == 1
    if scheme == "integrate_exponential":
        assert call_options[0]["steps_per_period"] == 512


@pytest.mark.parametrize(("value", "below", "above"), [
    (1234.5, 1230.0, 1240.0), (0.0987654, 0.0987, 0.0988), (7.0, 7.0, 7.0),
])  # fmt: skip
def test_ends_of_a_proposed_range(value: float, below: float, above: float) -> None:
    """Three digits, outwards."""
    assert _round_to_three_digits(value, math.floor) == pytest.approx(below, rel=1e-14)
    assert _round_to_three_digits(value, math.ceil) == pytest.approx(above, rel=1e-14)


def test_stress_intensity_is_zero_while_pairs_at_a_front_are_closed() -> None:
    """K_I is zero where all pairs that touch a station are closed, and never negative there; at a
    plate's tip, which no pair touches, it is what the rows say."""
    motion = np.array([[3.0, 1.0, 0.5], [3.0, 1.0, 0.5], [-2.0, 1.0, 0.5]])
    force = np.array([[7.0, 0.0], [7.0, 5.0], [0.0, 0.0]])
    structure = SimpleNamespace(clearance=np.zeros(2))
    record = SimpleNamespace(
        row_products=motion, forces=force, n_pairs=2, structure=structure, periods=1.0
    )
    station = SimpleNamespace(adjacent_pairs=np.array([0, 1]))
    (at_station,) = compute_crack_tip_histories(record, [station], np.zeros((3, 2)), None)  # type: ignore[arg-type, list-item]
    assert np.array_equal(at_station.K_I, [3.0, 0.0, 0.0]) and at_station.closed_front_error == 3.0
    record.row_products = motion[:, :2]
    tip = Tip("the crack tip", 0, np.zeros(2), np.ones(2), 0.01, domain_radius=0.001)
    (at_plate_tip,) = compute_crack_tip_histories(record, [tip], np.zeros((2, 2)), None)  # type: ignore[arg-type]
    assert np.array_equal(at_plate_tip.K_I, motion[:, 0])
