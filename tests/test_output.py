"""Files for ParaView, and pictures."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import pyvista
from matplotlib.image import imread

import fenics_crack as fc
from fenics_crack.output import write_modes, write_period
from fenics_crack.plot import (
    Wave,
    draw_contact_map,
    draw_laws,
    draw_modes,
    draw_response,
    draw_waves,
)


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


def assert_drawn(path: Path) -> None:
    """The picture is there, large enough and not blank."""
    picture = imread(path)
    assert picture.shape[0] > 400 and picture.shape[1] > 400
    assert picture[..., :3].std() > 0.02


def test_period_for_paraview(breathing: fc.PeriodicSolution, tmp_path: Path) -> None:
    """All nodes, the displacement true to scale, lips apart in the magnified mesh, their state."""
    path = tmp_path / "files" / "period.pvd"
    magnification = write_period(breathing, path, frames=12)
    entries = ElementTree.parse(path).getroot().findall("./Collection/DataSet")
    assert len(entries) == 12
    times = [float(entry.attrib["timestep"]) for entry in entries]
    assert np.allclose(times, np.arange(12) * breathing.period / 12)
    structure = breathing.structure
    assert structure.nodes is not None
    field = breathing.displacement_field(np.array(times))
    gap, force = breathing.gap(np.array(times)), breathing.contact_force(np.array(times))
    states = []
    for frame, entry in enumerate(entries):
        grid = pyvista.read(path.parent / entry.attrib["file"])
        assert grid.n_points == len(structure.nodes.points)
        assert set(grid.celltypes) == {70}  # VTK_LAGRANGE_QUADRILATERAL, nine nodes
        shown = grid["displacement"]
        free = structure.nodes.dofs >= 0
        assert np.allclose(shown[:, :2][free], field[frame][structure.nodes.dofs[free]])
        assert not np.any(shown[:, :2][~free])
        assert np.allclose(
            grid.points[:, :2] - structure.nodes.points, magnification * shown[:, :2]
        )
        state = grid["contact state"]
        states.append(state)
        assert np.count_nonzero(state >= 0.0) == 2 * structure.n_pairs
        assert np.count_nonzero(state == 1.0) == 2 * np.count_nonzero(gap[frame] > 0.0)
        assert grid["contact force"].sum() == pytest.approx(2.0 * force[frame].sum())
        apart = -magnification * gap[frame].min()
        if gap[frame].max() < 0.0:
            assert apart > 1e-3  # more than 1 % of the plate: seen in the picture
    assert {-1.0, 0.0, 1.0} == set(np.unique(states))


def test_modes_for_paraview(quadratic_plate: fc.Structure, tmp_path: Path) -> None:
    """One vector field a mode, named by its frequency, a tenth of the plate large."""
    modes = fc.solve_modes(quadratic_plate, 3)
    write_modes(quadratic_plate, modes, tmp_path / "modes.vtu")
    grid = pyvista.read(tmp_path / "modes.vtu")
    assert list(grid.point_data) == [
        f"mode {number}: {omega:.1f} rad/s" for number, omega in enumerate(modes.omega, 1)
    ]
    for name in grid.point_data:
        assert np.linalg.norm(grid[name], axis=1).max() == pytest.approx(0.01)


def test_pictures(
    quadratic_plate: fc.Structure, breathing: fc.PeriodicSolution, tmp_path: Path
) -> None:
    """Every kind of picture is made, off screen."""
    t = np.linspace(0.0, breathing.period, 100)
    gap = breathing.gap(t)[:, 0]
    wave = Wave("gap", t, gap, spread=0.1 * np.abs(gap))
    draw_waves(
        tmp_path / "waves.png", [wave], title="t", quantity="q", period=t[-1], zero="lips touch"
    )
    draw_laws(
        tmp_path / "laws.png", {"penalty": fc.UnilateralPenalty(1e9)}, 1e-6 * (t / t[-1] - 0.5)
    )
    draw_contact_map(tmp_path / "map.png", breathing)
    draw_response(tmp_path / "r.png", t, {"a": np.abs(gap)}, title="t", quantity="q")
    draw_modes(quadratic_plate, fc.solve_modes(quadratic_plate, 6), tmp_path / "modes.png")
    for name in ("waves", "laws", "map", "r", "modes"):
        assert_drawn(tmp_path / f"{name}.png")


def test_what_has_no_mesh_cannot_be_drawn(tmp_path: Path) -> None:
    """A structure from matrices has no positions: one clear error."""
    structure = fc.Structure.from_matrices(np.eye(2), np.eye(2), np.eye(2))
    with pytest.raises(fc.InputError, match="structure"):
        write_modes(structure, fc.solve_modes(structure, 1), tmp_path / "modes.vtu")
    solution = fc.solve_linear(structure, 0.5)
    with pytest.raises(fc.InputError, match="pairs"):
        draw_contact_map(tmp_path / "map.png", solution)
