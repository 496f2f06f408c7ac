"""Stress intensity along the fronts of cracks in solids."""

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import ROOT, gmsh_model
from mpi4py import MPI
from petsc4py import PETSc

import fenics_crack as fc
from fenics_crack.study.observer import tip_rows
from fenics_crack.study.prepare import prepare

YOUNG, POISSON, STRESS = 2.1e11, 0.3, 1e6
LONG, DEEP = 0.008, 0.003


@cache
def solid(**changed: object) -> fc.Scene:
    """The solid of ``new --solid`` near its resonance, with four elements on its crack."""
    scene = fc.Scene.load(ROOT / "fenics_crack" / "cli" / "new_solid.toml")
    given = {"mesh.error": False, "mesh.lip_elements": 4, "excitation.frequency": 611.5}
    return scene.replace(given | {key.replace("__", "."): one for key, one in changed.items()})


def test_patches() -> None:
    """Rigid rotations, and uniform stresses that leave the free faces of the plate without loads,
    whose crack is pressed open by what they are: no K at any station."""
    study = prepare(solid(), MPI.COMM_SELF, whole=True)
    structure = study.structure
    stations, rows, of_forces = tip_rows(study)
    radius = DEEP / 4.0  # less than the domain's
    assert structure.nodes is not None and structure.pairs.areas is not None
    away = structure.nodes.points - np.array([0.015, 0.03, 0.006])
    free = structure.nodes.numbered.free_part
    for axis in np.eye(3):
        turned = rows @ free(np.cross(axis, away).ravel())
        assert np.abs(turned).max() < 0.01 * YOUNG * np.sqrt(radius)
    for one, other in ((0, 0), (1, 1), (0, 1)):
        stress = np.zeros((3, 3))
        stress[one, other] = stress[other, one] = STRESS
        strain = ((1.0 + POISSON) * stress - POISSON * np.trace(stress) * np.eye(3)) / YOUNG
        found = rows @ free((away @ strain).ravel())
        found -= stress[1, 1] * of_forces @ structure.pairs.areas
        kinds = found.reshape(len(stations), 3).T[: 1 if one != other else 3]
        assert np.abs(kinds).max() < 0.01 * STRESS * np.sqrt(np.pi * radius)
    assert structure.pairs.areas.sum() == pytest.approx(0.5 * np.pi * LONG * DEEP, rel=2e-3)


@cache
def flapping(comm: MPI.Comm = MPI.COMM_SELF) -> fc.Run:
    return fc.solve(solid(), comm)


def test_a_front_that_breathes() -> None:
    """Closed for half of a period: what is computed then is small, and reported as zero; the crack
    opens alike on both sides of its middle, by less where it is deep."""
    found = fc.stress_intensity(flapping())
    assert found.three is not None and len(found.tips) == 13
    assert 0.0 < found.closed.max() < 0.03 * found.largest.max()
    assert 0.3 < (found.one.max(axis=1) == 0.0).mean() < 0.7
    assert found.one.min() == 0.0
    assert found.largest == pytest.approx(found.largest[::-1], rel=0.02)
    assert found.largest[6] < 0.8 * found.largest[0]
    assert found.ahead[6] == pytest.approx([0.0, 0.0, -1.0], abs=1e-6)
    assert found.positions[-1] == pytest.approx(18.176e-3, rel=1e-3)  # half of an ellipse
    assert found.tips[6] == f"the crack front at {found.positions[6] * 1e3:.4g} mm"
    assert set(found.numbers) >= {"K_max", "K_II_max", "K_III_max"}


@pytest.mark.nightly
def test_modes() -> None:
    """Modes enough: forty as twenty."""
    few, many = (
        fc.stress_intensity(
            fc.solve(solid(reduction__method="massless", reduction__modes=modes), MPI.COMM_SELF)
        ).largest
        for modes in (20, 40)
    )
    assert few == pytest.approx(many, rel=1e-3)


def largest_on(scene: fc.Scene, comm: MPI.Comm) -> np.ndarray:
    """Largest K_I of all ranks together."""
    return fc.stress_intensity(fc.solve(scene, comm)).largest


@pytest.mark.nightly
def test_same_on_two_ranks(on_ranks: Callable[..., Any]) -> None:
    """A mesh that is spread over ranks has the same."""
    scene = solid(mesh__lip_elements=3, reduction__method="massless", reduction__modes=10)
    assert on_ranks(largest_on, scene) == pytest.approx(largest_on(scene, MPI.COMM_SELF), rel=1e-8)


def ellipse(
    path: Path, long: float, deep: float, side: float, element: float, corner: bool = False
) -> fc.Scene:
    """A block, clamped below, with an elliptical crack in its middle, in a mesh file; or a quarter
    of both."""
    with gmsh_model() as model:
        occ, low = model.occ, 0.0 if corner else -0.5 * side
        box = [(3, occ.addBox(low, -0.5 * side, low, 0.5 * side - low, side, 0.5 * side - low))]
        face = [(2, occ.addDisk(0.0, 0.0, 0.0, long, deep))]
        occ.rotate(face, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.5 * math.pi)
        face = occ.intersect(face, box, removeTool=False)[0]
        occ.fragment(box, face)
        occ.synchronize()
        ends = {tag: np.array(model.getBoundingBox(2, tag)) for _, tag in model.getEntities(2)}
        below = [tag for tag, at in ends.items() if at[4] < -0.49 * side]
        crack = [tag for tag, at in ends.items() if np.abs(at).max() < 1.01 * long]
        for dimension, tags, name in ((3, [1], "solid"), (2, below, "clamp"), (2, crack, "crack")):
            model.setPhysicalName(dimension, model.addPhysicalGroup(dimension, tags), name)
        t = np.linspace(0.0, 2.0 * np.pi, 400)
        front = np.column_stack([long * np.cos(t), 0.0 * t, deep * np.sin(t)])
        # No longer than what is integrated over where the front is sharply curved.
        bent = ((long * np.sin(t)) ** 2 + (deep * np.cos(t)) ** 2) ** 1.5 / (long * deep)
        there = np.minimum(element, 0.1 * bent)

        def size(_dimension: int, _tag: int, x: float, y: float, z: float, *_: float) -> float:
            aways = np.linalg.norm(front - (x, y, z), axis=1)
            own, away = there[aways.argmin()], aways.min()
            return float(min(own + 0.4 * max(away - 1.5 * own, 0.0), side / 5.0))

        from gmsh import option, write

        for key in ("MeshSizeFromPoints", "MeshSizeExtendFromBoundary", "MeshSizeFromCurvature"):
            option.setNumber(f"Mesh.{key}", 0)
        model.mesh.setSizeCallback(size)
        model.mesh.generate(3)
        write(str(path))
    given = {"mesh.layout": "file", "mesh.file": str(path), "crack": None, "sweep": None}
    given |= {"mesh.size": None, "mesh.lip_elements": None, "geometry.width": None}
    given |= {"geometry.height": None, "geometry.thickness": None}
    return solid().replace(given | {"excitation.point": (0.0, 0.5 * side, 0.0)})


def pressed_open(scene: fc.Scene, corner: bool = False) -> tuple[list[Any], np.ndarray, int]:
    """Stations, K_I, K_II, K_III (n, 3) of a crack under a uniform pressure of 1 MPa, and the
    number of dofs; with planes of symmetry at x = 0 and z = 0."""
    study = prepare(scene, MPI.COMM_SELF, whole=True)
    structure = study.structure
    stations, rows, of_forces = tip_rows(study)
    forces = STRESS * structure.pair_areas
    solver, (found, load) = PETSc.KSP().create(), structure.stiffness.createVecs()
    assert structure.nodes is not None
    nodes, held = structure.nodes, np.zeros(structure.n_local)
    for axis in (0, 2) if corner else ():
        dofs = nodes.dofs[np.abs(nodes.points[:, axis]) < 1e-9, axis]
        held[dofs[dofs >= 0]] = 1e3 * YOUNG
    matrix = structure.stiffness.copy()
    diagonal = matrix.getDiagonal()
    diagonal.array[:] += held
    matrix.setDiagonal(diagonal)
    solver.setOperators(matrix)
    solver.setType("preonly")
    solver.getPC().setType("cholesky")
    solver.getPC().setFactorSolverType("mumps")
    load.array[:] = -(structure.gap @ forces)
    solver.solve(load, found)
    values = rows @ found.array_r + of_forces @ forces
    return stations, values.reshape(-1, 3), structure.n_dofs


def penny(path: Path, element: float) -> np.ndarray:
    """K of a penny of 10 mm in a block of 100 mm, relative to 2 s sqrt(a / pi)."""
    scene = ellipse(path, 0.01, 0.01 * (1.0 - 1e-9), 0.1, element)
    return pressed_open(scene)[1] / (2.0 * STRESS * np.sqrt(0.01 / np.pi))


@pytest.mark.nightly
def test_penny(tmp_path: Path) -> None:
    """Sneddon's, of a body without end."""
    found = penny(tmp_path / "penny.msh", 1.2e-3)
    assert len(found) == 12
    assert found[:, 0] == pytest.approx(1.0, abs=0.03)
    assert np.abs(found[:, 1:]).max() < 0.01
