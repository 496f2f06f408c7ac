"""Matrices that are written for other programs: what SciPy reads of them, and the way back."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sparse
from helpers import SOLID, catch_error, csr
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack import Scene

pytestmark = pytest.mark.usefixtures("predicted_errors")

ORDERS = [{"order": 7, "cos": [3.0, 0.0], "sin": [1.0, 2.0]}]
QUADRATIC = {"mesh.order": 2, "mesh.columns": 4, "reduction.modes": 12}
PLATES: dict[str, dict[str, Any]] = {
    "modal damping": {"damping.ratio": 0.01},
    "some modes": {**QUADRATIC, "damping.ratio": [0.01, 0.02, 0.03], "damping.modes": 3},
    "Rayleigh damping": {
        "damping.ratio": None, "damping.ratios": [0.01, 0.02], "damping.frequencies": [300, 9000],
    },
    "friction": {
        **QUADRATIC, "contact.law": "unilateral", "contact.stiffness": None,
        "contact.friction": 0.3, "excitation.force_mean": [0.0, -50.0],
    },
    "harmonics": {
        "excitation.harmonics": ORDERS, "harmonic_balance.harmonics": None, "damping.ratio": 0.01,
    },
    "clearance": {"crack.clearance": 1e-7, "contact.pairs": "mouth", **QUADRATIC},
    "stiffness per area": {
        **QUADRATIC, "contact.stiffness": None, "contact.stiffness_per_area": 1e11,
        "contact.friction": 0.2, "contact.tangential_stiffness_per_area": 5e10,
    },
    "rotation": {
        "rotation.rpm": 100.0, "rotation.hub_radius": 0.1, "excitation.order": 200,
        "excitation.omega": None, "excitation.force_mean": [0.0, 1e5],
    },
    "shaken": {
        "base.acceleration_sin": [9.81, 0.0], "excitation.point": None,
        "excitation.force_sin": [0.0, 0.0], "harmonic_balance.form": "block",
    },
}  # fmt: skip
"""Changes of the paper's plate."""
PER_AREA = {
    "contact.stiffness": None, "contact.stiffness_per_area": 1e13, "harmonic_balance.harmonics": 5,
    "harmonic_balance.error": False, "mesh.size": 0.02, "mesh.lip_elements": 1,
}  # fmt: skip
"""Changes of the solid: quadratic penalty weights, and fewer dofs."""
FORCES = "force_mean", "force_cos", "force_sin"


def matrices_of(structure: fc.Structure) -> dict[str, Any]:
    """What the files have to hold."""
    force = structure.force
    parts = {"mass": csr(structure.mass), "stiffness": csr(structure.stiffness)}
    parts |= dict(zip(FORCES, (force[:1].T, force[1::2].T, force[2::2].T), strict=True))
    parts |= {"gap": structure.gap, "tangential": structure.tangential}
    parts |= {"clearance": structure.clearance, "areas": structure.pair_areas}
    return {
        name: sparse.csr_matrix(part if np.ndim(part) != 1 else part[:, None])
        for name, part in parts.items()
        if part is not None
    }


def differences(structure: fc.Structure, folder: Path) -> dict[str, float]:
    """Of what SciPy reads, relative to the largest entry."""
    found = {}
    for name, matrix in matrices_of(structure).items():
        file_matrix = sparse.csr_matrix(scipy.io.mmread(folder / f"{name}.mtx"))
        assert file_matrix.shape == matrix.shape
        found[name] = abs(file_matrix - matrix).max() / (abs(matrix).max() or 1.0)
    return found


def solved(scene: Scene) -> fc.PeriodicSolution:
    """As the scene's harmonic balance says, but without a tolerance."""
    study, balance = fc.prepare(scene), scene.harmonic_balance
    return fc.solve_harmonic_balance(
        study.structure, scene.excitation.omega, study.contact,
        harmonics=balance.harmonics, form=balance.form,
    )  # fmt: skip


def check_way_back(scene: Scene, folder: Path) -> None:
    """Matrices and solution are the same."""
    structure = fc.build_structure(scene)
    fc.write_matrices(structure, folder, scene)
    assert max(differences(structure, folder).values()) <= 1e-15
    read_scene = Scene.load(folder / "matrices.toml")
    assert fc.build_structure(read_scene).force == pytest.approx(
        structure.force, rel=1e-15, abs=0.0
    )
    first_solution, second = solved(scene), solved(read_scene)
    assert (
        first_solution.converged
        and first_solution.contact_force(np.linspace(0.0, first_solution.period, 50)).max() > 0.0
    )
    for name in ("gap_coefficients", "displacement_coefficients"):
        first_array, second_array = getattr(first_solution, name), getattr(second, name)
        assert np.abs(second_array - first_array).max() <= 1e-12 * np.abs(first_array).max()


@pytest.mark.drawn(3)
@pytest.mark.parametrize("name", PLATES)
def test_plate(name: str, paper_scene: Scene, tmp_path: Path) -> None:
    """Whatever a plate may have."""
    check_way_back(paper_scene.replace({"contact.stiffness": 1e9} | PLATES[name]), tmp_path)


def test_solid(tmp_path: Path) -> None:
    """With penalties per area."""
    check_way_back(SOLID.replace(PER_AREA), tmp_path)


def test_damping_matrix_and_varied_structure(tmp_path: Path) -> None:
    """C need not be symmetric; load, damping and clearance are those of the varied structure."""
    generator = np.random.default_rng(1)
    damping_matrix = np.diag([3.0, 2.0, 1.0]) + 0.1 * generator.random((3, 3))
    stiffness = 100.0 * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    chain = fc.Structure.from_matrices(
        np.eye(3), stiffness, gap=[[1.0, 0.0], [0.0, 1.0], [0.0, -1.0]],
        force_sin=[0.0, 0.0, 1.0 / 3.0], damping=damping_matrix,
    ).varied(load=2.0, damping=0.5, clearance=[0.1, -1e-3])  # fmt: skip
    fc.write_matrices(chain, tmp_path)
    assert np.array_equal(scipy.io.mmread(tmp_path / "damping.mtx").toarray(), 0.5 * damping_matrix)
    assert differences(chain, tmp_path).keys().isdisjoint({"tangential", "areas"})
    changes = {"excitation.omega": 5.0, "contact.stiffness": 1e3}
    read_structure = fc.build_structure(Scene.load(tmp_path / "matrices.toml", changes))
    law = fc.UnilateralPenalty(1e3)
    first, second = (
        fc.solve_harmonic_balance(chain_structure, 5.0, law, harmonics=8)
        for chain_structure in (chain, read_structure)
    )
    assert np.array_equal(first.displacement_coefficients, second.displacement_coefficients)


@pytest.mark.parametrize("name", ["modal damping", "some modes", "Rayleigh damping"])
def test_equations_of_other_programs(name: str, paper_scene: Scene, tmp_path: Path) -> None:
    """C of the files damps each mode by its ratio, and what they make of the load is the linear
    answer: (K + i w C - w^2 M) u = f_c - i f_s."""
    structure = fc.build_structure(paper_scene.replace(PLATES[name])).varied(damping=1.5)
    fc.write_matrices(structure, tmp_path, paper_scene)
    assert fc.build_structure(Scene.load(tmp_path / "matrices.toml")).damping == structure.damping
    names = "mass", "stiffness", "damping", "force_cos", "force_sin"
    mass, stiffness, damping, cosine, sine = (
        scipy.io.mmread(tmp_path / f"{name}.mtx").toarray() for name in names
    )
    modes, rule = fc.solve_modes(structure, 5), structure.damping
    ratios = np.zeros(5)
    if isinstance(rule, fc.RayleighDamping):
        ratios += 0.5 * (rule.mass / modes.omega + rule.stiffness * modes.omega)
    else:
        ratios[: rule.modes] = rule.ratio
    modal_damping = modes.shapes.T @ damping @ modes.shapes
    assert modal_damping == pytest.approx(
        np.diag(2.0 * ratios * modes.omega), abs=1e-6 * modal_damping.max()
    )
    omega = 2000.0
    motion = np.linalg.solve(stiffness + 1j * omega * damping - omega**2 * mass, cosine - 1j * sine)
    linear = fc.solve_linear(structure, omega).displacement_coefficients
    assert linear[1] == pytest.approx(motion.real[:, 0], rel=1e-8, abs=1e-8 * np.abs(motion).max())
    assert linear[2] == pytest.approx(-motion.imag[:, 0], rel=1e-8, abs=1e-8 * np.abs(motion).max())


def test_symmetric_matrices_stay_so(tmp_path: Path) -> None:
    """One triangle of those that are, every entry of others, however little they differ."""
    stiffness = np.array([[2.0, -1.0], [np.nextafter(-1.0, 0.0), 1.0]])
    pair = fc.Structure.from_matrices(np.eye(2), stiffness, gap=None, force_sin=[1.0, 0.0])
    fc.write_matrices(pair, tmp_path)
    assert scipy.io.mminfo(tmp_path / "mass.mtx")[3:] == ("coordinate", "real", "symmetric")
    assert np.array_equal(scipy.io.mmread(tmp_path / "stiffness.mtx").toarray(), stiffness)


def test_many_dofs_have_no_dense_matrix(
    paper_scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Modal damping is then by its ratios alone."""
    monkeypatch.setattr("fenics_crack.fem.matrix_files.MAX_DOFS_TO_WRITE_MODAL_DAMPING", 49)
    structure = fc.build_structure(paper_scene)
    fc.write_matrices(structure, tmp_path)
    assert not (tmp_path / "damping.mtx").exists()
    assert "[damping]\nratio = 0.001" in (tmp_path / "matrices.toml").read_text()
    fc.write_matrices(structure.damped(fc.RayleighDamping(1.0)), tmp_path)
    assert (tmp_path / "damping.mtx").exists()
    fc.write_matrices(structure.damped(None), tmp_path, paper_scene)
    assert not (tmp_path / "damping.mtx").exists()
    read_structure = fc.build_structure(Scene.load(tmp_path / "matrices.toml"))
    assert read_structure.damping == fc.RayleighDamping()


def test_earlier_files(paper_scene: Scene, tmp_path: Path) -> None:
    """They are kept, one generation, and none is left among those of another structure."""
    cracked_structure = fc.build_structure(paper_scene)
    for structure in (cracked_structure, cracked_structure.tied(1e9)):
        fc.write_matrices(structure, tmp_path, paper_scene)
    contact_files = {"gap.mtx", "tangential.mtx", "clearance.mtx", "areas.mtx"}
    earlier_names, later_names = (
        {path.name for path in folder.iterdir()} for folder in (tmp_path / "before", tmp_path)
    )
    assert (
        later_names - {"before"} == earlier_names - contact_files and contact_files < earlier_names
    )
    assert Scene.load(tmp_path / "matrices.toml").contact is None
    assert not max(differences(cracked_structure, tmp_path / "before").values())


def test_refused(paper_scene: Scene, tmp_path: Path) -> None:
    """By one error, before anything is written."""
    study = fc.prepare(paper_scene.replace({"reduction.modes": 4}))
    catch_error(lambda: fc.write_matrices(study.structure, tmp_path), "structure")
    whole_structure = study.structure.whole
    catch_error(
        lambda: fc.write_matrices(
            whole_structure, tmp_path, paper_scene.replace({"contact": None, "crack": None})
        ),
        "contact",
        None,
        names=r"structure\.gap",
    )
    catch_error(
        lambda: fc.write_matrices(whole_structure.damped(fc.ModalDamping(2.0)), tmp_path),
        "damping.ratio",
        2.0,
    )
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").touch()
    catch_error(
        lambda: fc.write_matrices(whole_structure, tmp_path / "file"),
        "folder",
        str(tmp_path / "file"),
    )
    (tmp_path / "before").symlink_to(tmp_path)
    catch_error(
        lambda: fc.write_matrices(whole_structure, tmp_path), "folder", str(tmp_path / "before")
    )


def test_columns_of_a_load() -> None:
    """Column k of cosine and sine is the part of order k."""
    cosine, sine = np.arange(4.0).reshape(2, 2), [1.0, 2.0]
    parts: dict[str, Any] = {"mass": np.eye(2), "stiffness": np.eye(2), "gap": None}
    structure = fc.Structure.from_matrices(
        **parts, force_cos=cosine, force_sin=sine, force_mean=sine
    )
    assert np.array_equal(structure.force, [sine, cosine[:, 0], sine, cosine[:, 1], [0.0, 0.0]])
    for name, part in {"force_mean": cosine, "force_sin": np.ones((2, 101))}.items():
        catch_error(partial(fc.Structure.from_matrices, **parts, **{name: part}), name, part.shape)


def write_and_solve(scene: Scene, folder: str, comm: MPI.Comm) -> np.ndarray:
    """Frequencies of a structure whose rows ranks share; its files are written (collective)."""
    structure = fc.build_structure(scene, comm)
    fc.write_matrices(structure, folder, scene)
    return fc.solve_modes(structure, 6).omega


@pytest.mark.mpi
def test_on_two_ranks(paper_scene: Scene, tmp_path: Path, on_ranks: Callable[..., Any]) -> None:
    """The first one writes the rows of both."""
    scene = paper_scene.replace(PLATES["friction"])
    numbers_on_ranks = on_ranks(write_and_solve, scene, str(tmp_path))
    read_scene = Scene.load(tmp_path / "matrices.toml")
    assert fc.solve_modes(fc.build_structure(read_scene), 6).omega == pytest.approx(
        numbers_on_ranks, rel=1e-9
    )
    own_gap, read_gap = (solved(part).gap_coefficients for part in (scene, read_scene))
    assert np.abs(read_gap - own_gap).max() < 1e-6 * np.abs(own_gap).max()
