"""Scenes of matrices from files: the same numbers as of the plate that they were taken from."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sparse
from helpers import DEMOS, catch_error, csr, relative, scene_of_matrices
from mpi4py import MPI
from surroundings import RunCommand

import fenics_crack as fc
from fenics_crack import Scene, run_sweep

LOAD = {"contact.stiffness": 1e9, "damping.ratio": 0.02, "harmonic_balance.harmonics": 5}
CURVE = {"curve.start": 2000.0, "curve.stop": 2050.0, "curve.stability": False}


@pytest.fixture
def plate(paper_scene: Scene) -> Scene:
    """The plate, whose matrices are written to files; preloaded, so that the clearance counts."""
    return paper_scene.replace(LOAD | {"crack.clearance": -1e-7})


@pytest.fixture
def scene(plate: Scene, tmp_path: Path) -> Scene:
    """The scene of the files."""
    whole_structure = fc.build_structure(plate, MPI.COMM_SELF)
    columns = {"force_sin": whole_structure.force[2], "clearance": whole_structure.clearance}
    parts = {name: sparse.csr_matrix(column[:, None]) for name, column in columns.items()}
    parts |= {
        "mass": csr(whole_structure.mass),
        "stiffness": csr(whole_structure.stiffness),
        "gap": whole_structure.gap,
    }
    tables = {
        "excitation": {"omega": 2000.0}, "damping": {"ratio": 0.02}, "contact": {"stiffness": 1e9},
        "harmonic_balance": {"harmonics": 5},
    }  # fmt: skip
    return scene_of_matrices(tmp_path, parts, tables)


def test_results_are_those_of_the_plate(plate: Scene, scene: Scene) -> None:
    """Modes, a solution, a curve, a motion in time."""
    comm = MPI.COMM_SELF
    pairs = [
        (fc.modes(plate, 4, comm).result.omega, fc.modes(scene, 4, comm).result.omega),
        *[
            tuple(
                fc.solve(source_scene, comm).result.gap_coefficients
                for source_scene in (plate, scene)
            ),
            tuple(
                fc.curve(source_scene.replace(CURVE), comm).result.gap_coefficients
                for source_scene in (plate, scene)
            ),
        ],
    ]
    for plate_array, matrices_array in pairs:
        assert relative(matrices_array, plate_array) < 1e-9
    time = {"integration.periods": 3}
    histories = [
        fc.integrate(source_scene.replace(time), comm).result for source_scene in (plate, scene)
    ]
    assert relative(histories[1].gap, histories[0].gap) < 1e-9
    runs = [fc.solve(source_scene, comm) for source_scene in (plate, scene)]
    assert runs[0].watched_dof == runs[1].watched_dof
    assert runs[1].watched_description == f"displacement of dof {runs[1].watched_dof}"


def test_they_are_reduced_and_swept(plate: Scene, scene: Scene, tmp_path: Path) -> None:
    """To lips without mass; over the frequency, and over the preload."""
    changes: dict[str, Any] = {"reduction.modes": 10, "reduction.method": "massless"}
    run = fc.solve(scene.replace(changes), MPI.COMM_SELF)
    assert isinstance(run.structure, fc.MasslessStructure)
    expected_solution = fc.solve(plate.replace(changes), MPI.COMM_SELF).result
    assert relative(run.result.gap_coefficients, expected_solution.gap_coefficients) < 1e-8
    sweep_axes = {"excitation.omega": [1900.0, 2000.0], "structure.clearance": [-1e-7, 0.0]}
    sweep = run_sweep(scene.replace(changes | {"sweep.over": sweep_axes}), tmp_path / "sweep.h5")
    assert sweep.converged.all()
    assert relative(sweep.gap((1, 0)), expected_solution.gap_coefficients) < 1e-6
    assert sweep["response"][1, 0] == pytest.approx(
        expected_solution.amplitude(run.watched_dof), rel=1e-3
    )
    solution = sweep.solution((1, 1))
    assert relative(solution.gap_coefficients, sweep.gap((1, 1))) < 1e-9


def test_results_belong_to_their_files(scene: Scene, tmp_path: Path) -> None:
    """Modes and solutions are read back; a changed matrix is refused by its key."""
    runs = {"solution": fc.solve(scene, MPI.COMM_SELF), "modes": fc.modes(scene, 3, MPI.COMM_SELF)}
    for name, run in runs.items():
        fc.save(run.result, tmp_path / f"{name}.h5", run.scene)
        stored_run = fc.load_run(tmp_path / f"{name}.h5", MPI.COMM_SELF)
        assert stored_run.scene.structure == run.scene.structure
    modes = stored_run.result
    np.testing.assert_array_equal(modes.shapes, runs["modes"].result.shapes)  # type: ignore[union-attr]
    with open(tmp_path / "gap.mtx", "a") as file:
        file.write("% changed\n")
    catch_error(lambda: fc.load_run(tmp_path / "solution.h5", MPI.COMM_SELF), "structure.gap")


def test_rigid_contact_of_masses_gets_a_remark(run_command: RunCommand) -> None:
    """Its verdict and its curve are not to be had; without mass at the pairs they are."""
    words = ["check", str(DEMOS / "chain.toml"), "--set", "contact.stiffness=none"]
    for more_options, is_remarked in ((), True), (("--set", "reduction.method=massless"), False):
        messages = run_command(*words, "--set", "contact.law=unilateral", *more_options).err
        assert (
            "remark: contact.law = unilateral: rigid contact of crack faces" in messages
        ) == is_remarked


@pytest.mark.drawn(3)
@pytest.mark.usefixtures("not_drawn")
@pytest.mark.parametrize("commands", [["check"], ["modes"], ["solve"], ["integrate"], ["sweep"]])
def test_the_example_runs_from_the_shell(
    commands: list[str], tmp_path: Path, run_command: RunCommand
) -> None:
    """Every command; what is drawn needs no mesh, and what needs one is left out with a word."""
    (name,) = commands
    output = [] if name == "check" else ["--output", str(tmp_path)]
    process = run_command(name, DEMOS / "chain.toml", *output)
    remarks = [line for line in process.err.splitlines() if line.startswith("remark")]
    has_remark = [
        "steps over a peak" in line for line in remarks
    ]  # narrower than the steps of 1 Hz
    assert has_remark == [True] * (name == "sweep") and "warning" not in process.err
    result = {"solve": "solution", "integrate": "integration"}.get(name, name)
    if name == "check":  # of masses: nothing that plates alone have
        assert not re.search("crack|lips|flap|torsion|plate|mesh", process.out)
        return
    messages = run_command("plot", tmp_path / f"{result}.h5").err
    pictures = {path.name for path in tmp_path.glob("*.*") if path.suffix not in (".csv", ".json")}
    expected_pictures = {
        "solve": {"solution_waves.png", "solution_orbits.png"},
        "integrate": {"integration_waves.png"},
        "sweep": {"sweep_response.png"},
        "modes": {"modes.h5"},
    }[name]
    assert expected_pictures <= pictures
    assert ("no mesh" in messages) == (name in ("solve", "modes"))


def test_few_masses_take_more_steps_than_stability_asks_for(tmp_path: Path) -> None:
    """Of two masses that is 18 of a period, and twice as many make a motion of two periods of one
    that has one; a length of a crack is not sought in them."""
    matrices = {"mass": np.eye(2), "stiffness": 1e4 * np.array([[2.0, -1.0], [-1.0, 1.0]])}
    matrices |= {"gap": [[0.0], [1.0]], "force_sin": [[10.0], [0.0]]}
    tables = {
        "structure": {"clearance": 1e-3}, "damping": {"ratio": 0.05}, "excitation": {"omega": 60.0},
        "contact": {"stiffness": 1e5}, "harmonic_balance": {"harmonics": 40},
    }  # fmt: skip
    scene = scene_of_matrices(tmp_path, matrices, tables)
    time_history, orbit_solution = (
        way(scene, MPI.COMM_SELF).result for way in (fc.integrate, fc.solve)
    )
    assert time_history.settled < 1e-4
    assert time_history.indicators(0).amplitude == pytest.approx(
        orbit_solution.amplitude(0), rel=1e-3
    )
    catch_error(lambda: fc.find_crack_length(scene, MPI.COMM_SELF), "crack.first_omega", None)


def test_the_example_meets_its_stop() -> None:
    """The first natural frequency of a chain of n masses held at one end is
    2 sqrt(k / m) sin(pi / (2 (2 n + 1))); at resonance the stop takes most of the motion."""
    scene = Scene.load(DEMOS / "chain.toml")
    omega = fc.modes(scene, 1, MPI.COMM_SELF).result.omega[0]
    assert omega == pytest.approx(2.0 * np.sqrt(2e4 / 0.1) * np.sin(np.pi / 50.0), rel=1e-12)
    run = fc.solve(scene, MPI.COMM_SELF)
    march_settings = {"integration.settle": 1e-6, "integration.steps_per_period": 2000}
    history = fc.integrate(scene.replace(march_settings), MPI.COMM_SELF).result
    marched_range = float(
        np.ptp(history.displacement([run.watched_dof])[-history.steps_per_period :])
    )
    assert run.result.amplitude(run.watched_dof) == pytest.approx(marched_range / 2.0, rel=5e-3)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"structure.mass": "gap.mtx"}, "structure.mass"),
        ({"structure.mass": "missing.mtx"}, "structure.mass"),
        ({"structure.gap": "stiff.mtx"}, "structure.gap"),
        ({"structure.force_mean": "mass.mtx"}, "structure.force_mean"),
        ({"structure.clearance": "force_sin.mtx"}, "structure.clearance"),
        ({"structure.force_sin": None}, "structure.force_sin"),
        ({"contact": None}, "contact"),
        (
            {"contact.stiffness": None, "contact.stiffness_per_area": 1e9},
            "contact.stiffness_per_area",
        ),
        ({"contact.pairs": "mouth"}, "contact.pairs"),
        ({"excitation.force_sin": [1.0, 0.0]}, "excitation.force_sin"),
        ({"excitation.point": [1.0, 0.0]}, "excitation.point"),
        ({"geometry.thickness": 1.0}, "geometry"),
        ({"base.acceleration_sin": [1.0, 0.0]}, "base"),
        ({"structure.damping": "mass.mtx"}, "damping"),
        ({"structure": None}, "geometry"),
        ({"damping.ratio": None}, "damping.ratio"),
    ],
    ids=str,
)
def test_bad_matrices_are_named(
    scene: Scene, changes: dict[str, Any], key: str, tmp_path: Path
) -> None:
    """By the key of the scene."""
    settings = {k: str(tmp_path / v) if str(v).endswith("mtx") else v for k, v in changes.items()}
    catch_error(lambda: fc.build_structure(scene.replace(settings), MPI.COMM_SELF), key)


def list_refusal_values(scene: Scene, name: str, comm: MPI.Comm) -> list[str]:
    """Return the value that each rank is told if the last one does not see a file (collective)."""
    missing_settings = {f"structure.{name}": "missing.mtx"} if comm.rank == comm.size - 1 else {}
    error = catch_error(
        lambda: fc.build_structure(scene.replace(missing_settings), comm), f"structure.{name}"
    )
    return comm.allgather(error.value)


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["mass", "force_sin"])
def test_a_file_that_one_rank_does_not_see(on_ranks: Callable[..., Any], name: str) -> None:
    """It is refused on every rank; none waits for the other."""
    scene = Scene.load(DEMOS / "chain.toml")
    assert all("missing.mtx" in value for value in on_ranks(list_refusal_values, scene, name))


def test_a_matrix_of_damping(scene: Scene, tmp_path: Path) -> None:
    """C from a file, and no table [damping]: the same as Rayleigh's C = a M."""
    mass = scipy.io.mmread(tmp_path / "mass.mtx")
    scipy.io.mmwrite(tmp_path / "damping.mtx", 50.0 * mass, precision=17)
    text = scene.as_toml().replace("[structure]", '[structure]\ndamping = "damping.mtx"')
    text = text.replace("[damping]\nratio = 0.02\n", "")
    matrix = Scene.from_text(text, folder=tmp_path)
    assert matrix.damping is None and Scene.from_text(matrix.as_toml()) == matrix
    rule = scene.replace({"damping.ratio": None, "damping.mass": 50.0})
    matrix_gap, rule_gap = (
        fc.solve(damped_scene, MPI.COMM_SELF).result.gap_coefficients
        for damped_scene in (matrix, rule)
    )
    assert relative(matrix_gap, rule_gap) < 1e-9
