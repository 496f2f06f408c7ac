"""Files for ParaView, and pictures."""

import ast
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import pyvista
from helpers import catch_error, log_slope, relative

import fenics_crack as fc
from fenics_crack.draw.vtk import PeriodFields, make_grid_at_rest, nodal_stress, von_mises
from fenics_crack.fem.nodal_mesh import NodalMesh


@pytest.fixture(scope="module")
def quadratic_plate(paper_scene: fc.Scene) -> fc.Structure:
    """A cracked plate of quadratic elements: nodes on edges and in cells."""
    return fc.build_structure(
        paper_scene.replace(
            {"mesh.order": 2, "mesh.columns": 4, "mesh.rows": 4, "contact.stiffness": 1e9}
        )
    )


@pytest.fixture(scope="module")
def breathing(quadratic_plate: fc.Structure) -> fc.PeriodicSolution:
    """Its vibration with contact."""
    return fc.solve_harmonic_balance(quadratic_plate, 2000.0, fc.UnilateralPenalty(1e9))


def test_period_for_paraview(breathing: fc.PeriodicSolution, tmp_path: Path) -> None:
    """All nodes at rest, the displacement true to scale, lips apart once it is warped, their
    state."""
    path = tmp_path / "files" / "period.pvd"
    magnification = fc.write_period(breathing, path, frames=12)
    entries = ElementTree.parse(path).getroot().findall("./Collection/DataSet")
    assert len(entries) == 12
    times = [float(entry.attrib["timestep"]) for entry in entries]
    assert np.allclose(times, np.arange(12) * breathing.period / 12)
    structure = breathing.structure
    field = breathing.displacement_field(np.array(times))
    gap, force = breathing.gap(np.array(times)), breathing.contact_force(np.array(times))
    states = []
    for frame, entry in enumerate(entries):
        grid = pyvista.read(path.parent / entry.attrib["file"])
        assert grid.n_points == len(structure.nodes.points)
        assert set(grid.celltypes) == {70}  # VTK_LAGRANGE_QUADRILATERAL, nine nodes
        displacement = grid["displacement"]
        is_free = structure.nodes.dofs >= 0
        assert np.allclose(
            displacement[:, :2][is_free], field[frame][structure.nodes.dofs[is_free]]
        )
        assert not np.any(displacement[:, :2][~is_free])
        assert np.allclose(grid.points[:, :2], structure.nodes.points)
        warped_points = grid.warp_by_vector("displacement", factor=magnification).points
        assert np.allclose(warped_points - grid.points, magnification * displacement, atol=1e-6)
        state = grid["contact state"]
        states.append(state)
        assert np.count_nonzero(state >= 0.0) == 2 * structure.n_pairs
        assert np.count_nonzero(state == 1.0) == 2 * np.count_nonzero(gap[frame] > 0.0)
        assert grid["contact force"].sum() == pytest.approx(2.0 * force[frame].sum())
        drawn_opening = -magnification * gap[frame].min()
        if gap[frame].max() < 0.0:
            assert drawn_opening > 1e-3  # more than 1 % of the plate: seen in the picture
    assert {-1.0, 0.0, 1.0} == set(np.unique(states))


SOLID = """
geometry = { kind = "solid", width = 0.03, height = 0.09, thickness = 0.006 }
crack = { height = 0.03, center = 0.015, length = 0.016, depth = 0.003, front = "elliptical" }
material = { young = 2.1e11, poisson = 0.3, density = 7850.0 }
damping = { ratio = 0.002 }
excitation = { point = [0.0, 0.09, 0.003], force_cos = [0.0, 0.0, 1.0], omega = 3500.0 }
contact = { law = "unilateral" }
mesh = { layout = "graded", order = 2, size = 0.012, lip_elements = 2, error = false }
"""


def test_patches_of_a_solid() -> None:
    """The forces of all nodes are those of both lips, and the pressure, linear between the middles
    of patches and zero at the front, has their integral, by the areas of the facets."""
    study = fc.prepare(fc.Scene.from_text(SOLID))
    solution = fc.solve_harmonic_balance(study.structure, 3500.0, study.contact, harmonics=5)
    fields = PeriodFields(solution, 8)
    mesh, force = fields.mesh, fields.contact_forces
    facets = mesh.crack_face_sides
    assert len(
        np.setdiff1d(np.flatnonzero(fields.nodal_weights_of_pair_pressures.any(axis=1)), facets)
    )  # of edges
    first_side, two = (mesh.points[facets[:, k]] - mesh.points[facets[:, 0]] for k in (1, 2))
    areas = 0.5 * np.linalg.norm(np.cross(first_side, two), axis=1)
    assert force.max() > 0.0
    for frame in range(8):
        grid = pyvista.wrap(fields.make_frame_grid(frame))
        assert grid["contact force"].sum() == pytest.approx(2.0 * force[frame].sum())
        pressure = grid["contact pressure"]
        assert pressure.max() == pytest.approx((force[frame] / fields.pair_areas).max())
        integral = areas @ pressure[facets].mean(axis=1)
        assert integral == pytest.approx(2.0 * force[frame].sum(), rel=1e-6)
        assert np.all(grid["contact state"][pressure > 0.0] >= 0.0)
        assert set(np.unique(grid["contact state"])) <= {-1.0, 0.0, 1.0}


# --- stresses and pressures -----------------------------------------------------------------------

KINDS = [(cells, order) for cells in ("triangle", "quadrilateral") for order in (1, 2)]


def graded(scene: fc.Scene, cells: str, order: int, size: float = 0.02) -> fc.Scene:
    """The paper's plate on a graded mesh of some kind of cells."""
    return scene.replace(
        {
            "mesh.layout": "graded", "mesh.columns": None, "mesh.rows": None, "mesh.size": size,
            "mesh.lip_elements": 3, "mesh.cells": cells, "mesh.order": order,
        }
    )  # fmt: skip


def hooke(scene: fc.Scene, gradient: np.ndarray) -> np.ndarray:
    """Plane stresses xx, yy, xy of displacement gradients (..., 2, 2), by the textbook."""
    young, poisson = scene.material.young, scene.material.poisson
    xx, yy = gradient[..., 0, 0], gradient[..., 1, 1]
    twice = gradient[..., 0, 1] + gradient[..., 1, 0]
    normal = young / (1.0 - poisson**2)
    shear = young / (2.0 * (1.0 + poisson))
    return np.stack(
        [normal * (xx + poisson * yy), normal * (yy + poisson * xx), shear * twice], axis=-1
    )


def quadratic(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A displacement of second degree, and its gradient."""
    x, y = points.T
    field = np.column_stack([x**2 + 3.0 * x * y - y**2, 2.0 * x**2 - x * y + y**2])
    gradient = [[2.0 * x + 3.0 * y, 3.0 * x - 2.0 * y], [4.0 * x - y, 2.0 * y - x]]
    return field, np.moveaxis(np.array(gradient), 2, 0)


@pytest.mark.parametrize(("cells", "order"), KINDS)
def test_linear_displacement_has_its_constant_stress(
    paper_scene: fc.Scene, cells: str, order: int
) -> None:
    """The patch test, at every node; and the energy of the stress is that of the stiffness."""
    scene = graded(paper_scene, cells, order)
    structure = fc.build_structure(scene)
    mesh = NodalMesh(structure)
    gradient = np.array([[2.0, -3.0], [4.0, 5.0]])
    stress = nodal_stress(mesh, mesh.points @ gradient.T + [7.0, 8.0], scene.material)
    assert stress.shape == (len(mesh.points), 3)
    assert np.allclose(stress, hooke(scene, gradient), rtol=1e-10, atol=0.0)

    gradient[:, 0] = 0.0  # the clamped nodes stay
    stress = nodal_stress(mesh, mesh.points @ gradient.T, scene.material)
    strain = np.array([0.0, gradient[1, 1], gradient[0, 1]])
    u, ku = structure.stiffness.createVecs()
    is_free = structure.nodes.dofs >= 0
    u.array[structure.nodes.dofs[is_free]] = (mesh.points @ gradient.T)[is_free]
    structure.stiffness.mult(u, ku)
    assert scene.geometry.width and scene.geometry.height
    volume = scene.geometry.width * scene.geometry.height * scene.geometry.thickness
    assert u.dot(ku) == pytest.approx(volume * stress[0] @ strain)


@pytest.mark.parametrize("cells", ["triangle", "quadrilateral"])
def test_quadratic_displacement(paper_scene: fc.Scene, cells: str) -> None:
    """Its stress is exact with quadratic elements, and of first order with linear ones."""
    scene = graded(paper_scene, cells, 2)
    mesh = NodalMesh(fc.build_structure(scene))
    field, gradient = quadratic(mesh.points)
    exact = hooke(scene, gradient)
    assert np.allclose(
        nodal_stress(mesh, field, scene.material), exact, rtol=0.0, atol=1e-10 * exact.max()
    )
    sizes, errors = (0.02, 0.01, 0.005), []
    for size in sizes:
        scene = graded(paper_scene, cells, 1, size).replace(
            {"crack": None, "contact": None, "mesh.lip_elements": None}
        )
        mesh = NodalMesh(fc.build_structure(scene))
        field, gradient = quadratic(mesh.points)
        stress, exact = nodal_stress(mesh, field, scene.material), hooke(scene, gradient)
        errors.append(np.abs(stress - exact).max() / np.abs(exact).max())
    assert errors[0] < 0.2
    assert 0.8 < log_slope(sizes, errors) < 1.4


@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_stress_in_slim_tetrahedra(paper_scene: fc.Scene, size: float) -> None:
    """That of a quadratic displacement in single cells of ten nodes, of metres and of millimetres;
    VTK's own derivative misses its cells' nodes in the latter."""
    corners = size * np.random.default_rng(0).random((100, 4, 3)) * [1.0, 1.0, 0.01]
    edges = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)])
    nodes = np.concatenate([corners, corners[:, edges].mean(axis=2)], axis=1)
    mesh = object.__new__(NodalMesh)
    mesh.points, mesh.vtk_type = nodes.reshape(-1, 3), 71  # VTK_LAGRANGE_TETRAHEDRON
    mesh.cells = np.arange(len(mesh.points)).reshape(-1, 10)
    x, y, z = mesh.points.T
    field = np.column_stack([x**2 + 3.0 * x * y - y * z, 2.0 * x * z + y**2, z**2 + y * z])
    gradient = [
        [2.0 * x + 3.0 * y, 3.0 * x - z, -y],
        [2.0 * z, 2.0 * y, 2.0 * x],
        [0 * x, z, 2 * z + y],
    ]
    strain = np.moveaxis(np.array(gradient) + np.swapaxes(gradient, 0, 1), 2, 0) / 2.0
    young, nu = paper_scene.material.young, paper_scene.material.poisson
    volume = np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    expected_stress = young / (1.0 + nu) * (strain + nu / (1.0 - 2.0 * nu) * volume)
    exact = expected_stress[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    assert relative(nodal_stress(mesh, field, paper_scene.material), exact) < 1e-9


def test_stress_is_not_smeared_across_the_crack(paper_scene: fc.Scene) -> None:
    """One constant stress above the lips and another below: exact on both, though in one place."""
    scene = graded(paper_scene, "quadrilateral", 2)
    mesh = NodalMesh(fc.build_structure(scene))
    grid = pyvista.wrap(make_grid_at_rest(mesh))
    centres = grid.cell_centers().points
    is_above = (centres[:, 0] < 0.035) & (centres[:, 1] > 0.05)
    is_upper = np.zeros(len(mesh.points), dtype=bool)
    is_upper[
        np.concatenate([grid.get_cell(cell).point_ids for cell in np.flatnonzero(is_above)])
    ] = True
    one, two = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[-5.0, 6.0], [0.0, -1.0]])
    field = np.where(is_upper[:, None], mesh.points @ one.T, mesh.points @ two.T)
    stress = nodal_stress(mesh, field, scene.material)
    lips = np.unique(mesh.crack_face_sides)
    near_lips = lips[mesh.points[lips, 0] < 0.015]
    assert np.count_nonzero(is_upper[near_lips]) == np.count_nonzero(~is_upper[near_lips]) >= 2
    assert np.allclose(stress[near_lips[is_upper[near_lips]]], hooke(scene, one), rtol=1e-10)
    assert np.allclose(stress[near_lips[~is_upper[near_lips]]], hooke(scene, two), rtol=1e-10)


@pytest.mark.parametrize(("cells", "order"), KINDS)
def test_lips_and_boundary_are_found(paper_scene: fc.Scene, cells: str, order: int) -> None:
    """The boundary's edges are as long as the plate's sides and both lips."""
    structure = fc.build_structure(graded(paper_scene, cells, order))
    mesh = NodalMesh(structure)
    for edges, length in ((mesh.boundary_sides, 0.5), (mesh.crack_face_sides, 0.1)):
        assert edges.shape[1] == order + 1
        ends = mesh.points[edges]
        assert np.linalg.norm(ends[:, -1] - ends[:, 0], axis=1).sum() == pytest.approx(length)
        assert np.allclose(ends[:, order // 2], 0.5 * (ends[:, 0] + ends[:, -1])) or order == 1
    assert len(np.unique(mesh.crack_face_sides)) == 2 * structure.n_pairs + 1  # the tip
    assert np.array_equal(mesh.is_clamped, mesh.points[:, 1] < 1e-12)


def test_von_mises() -> None:
    """Uniaxial stress is itself, shear counts sqrt(3) times, equal biaxial stress is itself."""
    stresses = von_mises(np.array([[-2.0, 0.0, 0.0], [0.0, 0.0, 2.0], [2.0, 2.0, 0.0]]))
    assert np.allclose(stresses, [2.0, 2.0 * np.sqrt(3.0), 2.0])


def test_stresses_for_paraview(
    paper_scene: fc.Scene, breathing: fc.PeriodicSolution, tmp_path: Path
) -> None:
    """Stresses and points are those of the unmoved plate, whatever the magnification, rounded to
    single precision; pressures add up."""
    single = np.finfo(np.float32).eps
    frames = {}
    for magnification in (1.0, 9000.0):
        path = tmp_path / f"{magnification:g}.pvd"
        found = fc.write_period(
            breathing, path, frames=6, magnification=magnification, material=paper_scene.material
        )
        assert found == magnification
        files = sorted(path.with_suffix("").glob("*.vtu"))
        frames[magnification] = [pyvista.read(file) for file in files]
    structure = breathing.structure
    mesh = NodalMesh(structure)
    time = np.arange(6) * breathing.period / 6
    displacement = mesh.nodal_vectors(breathing.displacement_field(time))
    pressure = breathing.contact_force(time) / structure.pair_areas
    assert pressure.max() > 0.0
    for frame, (still_frame, moved_frame) in enumerate(zip(*frames.values(), strict=True)):
        stress = nodal_stress(mesh, displacement[frame], paper_scene.material)
        assert np.array_equal(still_frame.points, moved_frame.points)
        for grid in (still_frame, moved_frame):
            assert relative(grid["stress"], stress) < single
            assert relative(grid["von Mises stress"], von_mises(stress)) < single
            array = grid.GetPointData().GetAbstractArray("stress")
            assert [array.GetComponentName(i) for i in range(3)] == ["xx", "yy", "xy"]
            shown = grid["contact pressure"]
            assert shown.sum() == pytest.approx(2.0 * pressure[frame].sum())
            assert set(np.flatnonzero(shown)) == set(np.flatnonzero(grid["contact state"] == 1.0))


@pytest.mark.parametrize("with_stress", [True, False])
def test_script_for_paraview(
    paper_scene: fc.Scene, breathing: fc.PeriodicSolution, tmp_path: Path, with_stress: bool
) -> None:
    """It is Python, and names the series and a field that is in it."""
    material = paper_scene.material if with_stress else None
    fc.write_period(breathing, tmp_path / "a period.pvd", frames=2, material=material)
    tree = ast.parse((tmp_path / "a period_paraview.py").read_text())
    constants = {
        node.targets[0].id: node.value.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Name)
        and isinstance(node.value, ast.Constant)
    }
    frame = pyvista.read(tmp_path / "a period" / "frame_0000.vtu")
    assert constants["field"] == ("von Mises stress" if with_stress else "displacement")
    assert constants["field"] in frame.point_data
    words = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)}
    assert {word for word in words if str(word).endswith(".pvd")} == {"a period.pvd"}
    assert f"{constants['field']} [{'Pa' if with_stress else 'm'}]" in words
    factor = float(frame.field_data["magnification"][0])
    assert f"displacement x {factor:.3g}" in words
    assert {"displacement", float(f"{factor:.9g}")} <= words  # of WarpByVector


@pytest.mark.parametrize(
    ("key", "value"), [("frames", 0), ("magnification", -1.0), ("material", "steel")]
)
def test_period_refuses(
    breathing: fc.PeriodicSolution, tmp_path: Path, key: str, value: object
) -> None:
    """What cannot be used is named, and nothing is written."""
    catch_error(lambda: fc.write_period(breathing, tmp_path / "p.pvd", **{key: value}), key, value)
    assert not list(tmp_path.iterdir())


# --- modes and pictures ---------------------------------------------------------------------------


def test_frames_follow_no_link(breathing: fc.PeriodicSolution, tmp_path: Path) -> None:
    """One in place of their folder is refused, and nothing is written."""
    (tmp_path / "outside").mkdir()
    (tmp_path / "period").symlink_to(tmp_path / "outside")
    catch_error(
        lambda: fc.write_period(breathing, tmp_path / "period.pvd", frames=2),
        "path",
        str(tmp_path / "period"),
    )
    assert len([*tmp_path.rglob("*")]) == 2


@pytest.mark.parametrize("reduced", [False, True])
def test_modes_for_paraview(quadratic_plate: fc.Structure, reduced: bool, tmp_path: Path) -> None:
    """One vector field a mode, named by its frequency, a tenth of the plate large."""
    plate = fc.reduce_structure(quadratic_plate, modes=3) if reduced else quadratic_plate
    modes = fc.solve_modes(plate, 3)
    fc.write_modes(modes, tmp_path / "modes.vtu")
    grid = pyvista.read(tmp_path / "modes.vtu")
    assert list(grid.point_data) == [
        f"mode {number}: {omega:.1f} rad/s" for number, omega in enumerate(modes.omega, 1)
    ]
    for number, name in enumerate(grid.point_data):
        assert np.linalg.norm(grid[name], axis=1).max() == pytest.approx(0.01)
        factor = float(grid.field_data[f"magnification of mode {number + 1}"][0])
        shape = plate.expand(modes.shapes[:, number])
        assert np.isclose(np.abs(grid[name]).max(), factor * np.abs(shape).max())


def test_what_has_no_mesh_cannot_be_drawn(tmp_path: Path) -> None:
    """A structure from matrices has no positions: one clear error."""
    structure = fc.Structure.from_matrices(np.eye(2), np.eye(2), gap=np.eye(2))
    catch_error(
        lambda: fc.write_modes(fc.solve_modes(structure, 1), tmp_path / "modes.vtu"),
        "structure",
        "made from matrices",
    )
    catch_error(lambda: fc.draw_contact_map(fc.solve_linear(structure, 0.5)), "pairs", 2)
