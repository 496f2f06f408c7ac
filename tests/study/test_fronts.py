"""Stress intensity along the fronts of cracks in solids."""

import math
from collections.abc import Callable
from functools import cache
from itertools import combinations, combinations_with_replacement, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from helpers import ROOT, gmsh_model
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse
from scipy.sparse.linalg import spsolve

import fenics_crack as fc
from fenics_crack.fem.fronts import EDGES, front_functionals
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


@pytest.mark.parametrize("elements", [3, 4])
def test_patches(elements: int) -> None:
    """Rigid rotations, and uniform stresses that leave the free faces of the plate without loads,
    whose crack is pressed open by what they are: no K at any station."""
    study = prepare(solid(mesh__lip_elements=elements), MPI.COMM_SELF, whole=True)
    structure = study.structure
    stations, rows, of_forces = tip_rows(study)
    radius = DEEP / elements  # about the domain's
    assert structure.nodes is not None and structure.pairs.areas is not None
    away = structure.nodes.points - np.array([0.015, 0.03, 0.006])
    free = structure.nodes.numbered.free_part
    for axis in np.eye(3):
        turned = rows @ free(np.cross(axis, away).ravel())
        assert np.abs(turned).max() < 0.015 * YOUNG * np.sqrt(radius)
    for one, other in ((0, 0), (1, 1), (0, 1)):
        stress = np.zeros((3, 3))
        stress[one, other] = stress[other, one] = STRESS
        strain = ((1.0 + POISSON) * stress - POISSON * np.trace(stress) * np.eye(3)) / YOUNG
        found = rows @ free((away @ strain).ravel())
        found -= stress[1, 1] * of_forces @ structure.pairs.areas
        kinds = found.reshape(len(stations), 3).T[: 1 if one != other else 3]
        assert np.abs(kinds).max() < 0.01 * STRESS * np.sqrt(np.pi * radius)
    assert structure.pairs.areas.sum() == pytest.approx(0.5 * np.pi * LONG * DEEP, rel=2e-3)


def test_patches_of_a_straight_front() -> None:
    """All rotations, and six uniform stresses with what they do at the faces of a crack through the
    plate: shear there acts on K_II and K_III as pressure does on K_I. At the surface alone they
    leave loads, which no displacement of the plate has."""
    straight = {"crack__edge": "left", "crack__length": 0.01, "mesh__lip_elements": 6}
    left_out = dict.fromkeys(("crack__center", "crack__depth", "crack__front"))
    scene = solid(**straight, **left_out)
    structure = prepare(scene, MPI.COMM_SELF, whole=True).structure
    stations, rows, of_forces = front_functionals(scene, structure)
    assert structure.nodes is not None and len(stations) == 3
    away, free = structure.nodes.points - [0.015, 0.03, 0.003], structure.nodes.numbered.free_part
    ahead, size = stations[0].ahead, np.sqrt(1.5e-3)
    pressed = of_forces[::3] @ structure.pair_areas
    for axis in np.eye(3):
        turned = rows @ free(np.cross(axis, away).ravel())
        assert np.abs(turned).max() < 1e-3 * YOUNG * size
    for one, other in combinations_with_replacement(range(3), 2):
        stress = np.zeros((3, 3))
        stress[one, other] = stress[other, one] = STRESS
        strain = ((1.0 + POISSON) * stress - POISSON * np.trace(stress) * np.eye(3)) / YOUNG
        found = (rows @ free((away @ strain).ravel())).reshape(3, 3)
        on = stress[1]
        found -= np.outer(pressed, [on[1], on @ ahead, on @ np.cross(ahead, [0.0, 1.0, 0.0])])
        assert np.abs(found[1]).max() < 1e-3 * STRESS * np.sqrt(np.pi) * size
        if other != 2:
            assert np.abs(found).max() < 1e-3 * STRESS * np.sqrt(np.pi) * size


@cache
def flapping(comm: MPI.Comm = MPI.COMM_SELF) -> fc.Run:
    return fc.solve(solid(), comm)


def test_a_front_that_breathes(tmp_path: Path) -> None:
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
    fc.write_fronts(found, tmp_path / "fronts.vtu")
    written = pyvista.read(tmp_path / "fronts.vtu")
    assert written.n_cells == 12 and np.array_equal(written["K_max"], found.largest)
    panels = fc.draw_stress_intensity(found).axes
    assert [len(panel.lines) for panel in panels] == [4, 4]  # zero, K_I, K_II, K_III


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


def meshed(
    path: Path, make: Callable[[Any], tuple[list[Any], list[Any]]], front: np.ndarray,
    sizes: np.ndarray, growth: float, largest: float,
) -> fc.Scene:  # fmt: skip
    """A solid and the faces that cut it, in a mesh file: clamped below, the crack in y = 0;
    elements are so long at points of the front, and longer away from it."""

    def size(_dimension: int, _tag: int, *place: float) -> float:
        aways = np.linalg.norm(front - place[:3], axis=1)
        own, away = sizes[aways.argmin()], aways.min()
        return float(min(own + growth * max(away - 1.5 * own, 0.0), largest))

    with gmsh_model() as model:
        body, face = make(model.occ)
        face = model.occ.intersect(face, body, removeTool=False)[0]
        model.occ.fragment(body, face)
        model.occ.synchronize()
        ends = {tag: np.array(model.getBoundingBox(2, tag)) for _, tag in model.getEntities(2)}
        low = min(at[1] for at in ends.values())
        below = [tag for tag, at in ends.items() if at[4] < 0.9 * low]
        crack = [tag for tag, at in ends.items() if np.abs(at[[1, 4]]).max() < 1e-3 * abs(low)]
        for dimension, tags, name in ((3, [1], "solid"), (2, below, "clamp"), (2, crack, "crack")):
            model.setPhysicalName(dimension, model.addPhysicalGroup(dimension, tags), name)
        from gmsh import option, write

        for key in ("MeshSizeFromPoints", "MeshSizeExtendFromBoundary", "MeshSizeFromCurvature"):
            option.setNumber(f"Mesh.{key}", 0)
        model.mesh.setSizeCallback(size)
        model.mesh.generate(3)
        write(str(path))
    given = {"mesh.layout": "file", "mesh.file": str(path), "crack": None, "sweep": None}
    given |= {"mesh.size": None, "mesh.lip_elements": None, "geometry.width": None}
    given |= {"geometry.height": None, "geometry.thickness": None}
    return solid().replace(given | {"excitation.point": (0.0, round(-low, 6), 0.0)})


def ellipse(
    path: Path, long: float, deep: float, side: float, element: float, bent: float = 0.1,
    corner: bool = False,
) -> fc.Scene:  # fmt: skip
    """A block with an elliptical crack in its middle, or a quarter of both; elements at the front
    are no longer than a part of its radius of curvature."""

    def make(occ: Any) -> tuple[list[Any], list[Any]]:
        low = 0.0 if corner else -0.5 * side
        box = [(3, occ.addBox(low, -0.5 * side, low, 0.5 * side - low, side, 0.5 * side - low))]
        face = [(2, occ.addDisk(0.0, 0.0, 0.0, long, deep))]
        occ.rotate(face, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.5 * math.pi)
        return box, face

    t = np.linspace(0.0, 2.0 * np.pi, 400)
    front = np.column_stack([long * np.cos(t), 0.0 * t, deep * np.sin(t)])
    radius = ((long * np.sin(t)) ** 2 + (deep * np.cos(t)) ** 2) ** 1.5 / (long * deep)
    return meshed(path, make, front, np.minimum(element, bent * radius), 0.5, side / 4.0)


def displaced(structure: fc.Structure, load: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Displacement under forces, where dofs (n_nodes, 3) are held."""
    assert structure.nodes is not None
    dofs = structure.nodes.dofs[held]
    matrix = structure.stiffness.copy()
    diagonal = matrix.getDiagonal()
    diagonal.array[dofs[dofs >= 0]] += 1e3 * YOUNG
    matrix.setDiagonal(diagonal)
    solver, (found, forces) = PETSc.KSP().create(), matrix.createVecs()
    solver.setOperators(matrix)
    solver.setType("preonly")
    solver.getPC().setType("cholesky")
    solver.getPC().setFactorSolverType("mumps")
    forces.array[:] = load
    solver.solve(forces, found)
    return np.array(found.array_r)


def pressed_open(scene: fc.Scene, corner: bool = False) -> tuple[list[Any], np.ndarray, int]:
    """Stations, K_I, K_II, K_III (n, 3) of a crack under a uniform pressure of 1 MPa, and the
    number of dofs; with planes of symmetry at x = 0 and z = 0."""
    structure = prepare(scene, MPI.COMM_SELF, whole=True).structure
    stations, rows, of_forces = front_functionals(scene, structure)
    forces = STRESS * structure.pair_areas
    assert structure.nodes is not None
    held = (np.abs(structure.nodes.points) < 1e-9) & [corner, False, corner]
    values = rows @ displaced(structure, -(structure.gap @ forces), held) + of_forces @ forces
    return stations, values.reshape(-1, 3), structure.n_dofs


def penny(path: Path, element: float) -> np.ndarray:
    """K of a penny of 10 mm in a block of 100 mm, relative to 2 s sqrt(a / pi)."""
    scene = ellipse(path, 0.01, 0.01 * (1.0 - 1e-9), 0.1, element)
    return pressed_open(scene)[1] / (2.0 * STRESS * np.sqrt(0.01 / np.pi))


@pytest.mark.nightly
def test_penny(tmp_path: Path) -> None:
    """Sneddon's, of a body without end."""
    found = penny(tmp_path / "penny.msh", 1.2e-3)
    assert len(found) >= 12
    assert found[:, 0] == pytest.approx(1.0, abs=0.015)
    assert np.abs(found[:, 1:]).max() < 0.01


@pytest.mark.nightly
def test_ellipse(tmp_path: Path) -> None:
    """25 and 6 mm in a block of 150 mm: the mean of the closed form over the hat of a station,
    which reaches 7.5 degrees to both sides."""
    long, deep, step = 0.025, 0.006, np.pi / 24.0
    scene = ellipse(tmp_path / "ellipse.msh", long, deep, 0.15, 1e-3, 0.04, corner=True)
    stations, found, count = pressed_open(scene, corner=True)
    x, _, z = np.array([station.point for station in stations]).T
    t = np.linspace(0.0, 0.5 * np.pi, 4001)
    hats = np.maximum(0.0, 1.0 - np.abs(t - np.arctan2(z / deep, x / long)[:, None]) / step)
    hats *= np.hypot(long * np.sin(t), deep * np.cos(t))
    exact = 4.068e6 * np.sqrt(1e-3) * (np.sin(t) ** 2 + (deep / long * np.cos(t)) ** 2) ** 0.25
    means = hats @ exact / hats.sum(axis=1)
    means[0], means[-1] = 1.5 * means[[0, -1]] - 0.5 * means[[1, -2]]
    assert len(found) == 13 and count < 45_000
    assert found[:, 0] == pytest.approx(means, rel=0.025)
    assert found[1:-1, 0] == pytest.approx(means[1:-1], rel=0.02)
    assert np.sqrt(np.mean((found[:, 0] / means) ** 2)) == pytest.approx(1.0, abs=0.01)
    assert np.abs(found[:, 1:]).max() < 0.02 * means.max()


def line(x: np.ndarray, power: int) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Integrals of N_i N_j x^power and N_i' N_j' x^power of quadratic elements between points."""
    mass, stiffness = np.zeros((2, 2 * len(x) - 1, 2 * len(x) - 1))
    q, w = np.polynomial.legendre.leggauss(5)
    q, w = 0.5 * (1.0 + q), 0.5 * w
    shape = np.array([(1.0 - q) * (1.0 - 2.0 * q), 4.0 * q * (1.0 - q), q * (2.0 * q - 1.0)])
    slope = np.array([4.0 * q - 3.0, 4.0 - 8.0 * q, 4.0 * q - 1.0])
    for number, (a, b) in enumerate(pairwise(x)):
        its, weights = slice(2 * number, 2 * number + 3), w * (a + (b - a) * q) ** power
        mass[its, its] += (b - a) * (shape * weights) @ shape.T
        stiffness[its, its] += (slope * weights) @ slope.T / (b - a)
    return sparse.csr_matrix(mass), sparse.csr_matrix(stiffness)


def ring(radius: float, ligament: float, half: float, count: int = 18) -> float:
    """K_III over the torque of a bar with a crack from its surface to a ligament: by what its
    compliance changes with the ligament. The angle phi(r, z) minimises int r^3 |grad phi|^2."""

    def torque(c: float) -> float:
        parts = np.append(0.55 ** np.arange(count), 0.0)
        r = np.append(c * (1.0 - parts), (c + (radius - c) * parts[::-1])[1:])
        (m_r, s_r), (m_z, s_z) = line(r, 3), line(half * parts[::-1], 0)
        matrix = (sparse.kron(s_r, m_z) + sparse.kron(m_r, s_z)).tocsr()
        places = np.arange(matrix.shape[0]).reshape(m_r.shape[0], -1)
        angle = np.zeros(matrix.shape[0])
        angle[places[:, -1]] = 1.0
        fixed = np.append(places[:, -1], places[: 2 * count + 1, 0])
        free = np.setdiff1d(places, fixed)
        angle[free] = spsolve(matrix[free][:, free].tocsc(), -(matrix[free] @ angle))
        return float(2.0 * np.pi * angle @ (matrix @ angle))

    step = 1e-3 * ligament
    rise = (1.0 / torque(ligament - step) - 1.0 / torque(ligament + step)) / step
    return float(np.sqrt(rise / (2.0 * np.pi * ligament)))


@pytest.mark.nightly
def test_torsion(tmp_path: Path) -> None:
    """A quarter of a bar of 10 mm with a ligament of 6 mm, whose planes hold all but what is normal
    to them: K_III by the torque of the mesh is the axisymmetric one, K_I and K_II are none."""
    radius, ligament, half = 0.01, 0.006, 0.015

    def make(occ: Any) -> tuple[list[Any], list[Any]]:
        bar = [(3, occ.addCylinder(0, -half, 0, 0, 2 * half, 0, radius, angle=0.5 * math.pi))]
        disks = [[(2, occ.addDisk(0.0, 0.0, 0.0, r, r))] for r in (radius, ligament)]
        face = occ.cut(*disks)[0]
        occ.rotate(face, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.5 * math.pi)
        return bar, face

    t = np.linspace(0.0, 0.5 * np.pi, 400)
    front = ligament * np.column_stack([np.cos(t), 0.0 * t, np.sin(t)])
    scene = meshed(tmp_path / "bar.msh", make, front, np.full(400, 1.2e-4), 0.6, radius / 3.0)
    structure = prepare(scene, MPI.COMM_SELF, whole=True).structure
    assert structure.nodes is not None and structure.n_dofs < 60_000
    points, cells = structure.nodes.points, structure.nodes.cells
    load = np.zeros_like(points)
    for corners in combinations(range(4), 3):
        for cell in cells[np.all(points[cells[:, corners], 1] > half - 1e-9, axis=1)]:
            a, b, c = points[cell[list(corners)]]
            area = 0.5 * np.linalg.norm(np.cross(b - a, c - a))
            for edge in combinations(corners, 2):
                node = cell[4 + EDGES.index(edge)]
                load[node] += area / 3.0 * np.cross([0.0, 1.0, 0.0], points[node])
    torque = 4.0 * np.cross(points, load)[:, 1].sum()
    on = np.abs(points) < 1e-9
    held = np.column_stack([on[:, 2], on[:, 0] | on[:, 2], on[:, 0]])
    moved = displaced(structure, structure.nodes.numbered.free_part(load.ravel()), held)
    _, rows, _ = front_functionals(scene, structure)
    found = (rows @ moved).reshape(-1, 3) / (torque * ring(radius, ligament, half))
    assert np.abs(found[:, :2]).max() < 0.025
    assert np.abs(found[:, 2]) == pytest.approx(1.0, abs=0.025)
    assert np.sqrt(np.mean(found[:, 2] ** 2)) == pytest.approx(1.0, abs=0.015)
