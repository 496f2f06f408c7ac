"""Stress intensity along the fronts of cracks in solids."""

from dataclasses import replace
from functools import cache
from itertools import combinations_with_replacement
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import pyvista
from helpers import ROOT
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack.fem.front_intensities import _rows_by_station, front_functionals
from fenics_crack.fem.fronts import Front
from fenics_crack.study.observer import make_tips_and_intensity_rows
from fenics_crack.study.prepare import prepare

YOUNG, POISSON, STRESS = 2.1e11, 0.3, 1e6
LONG, DEEP = 0.008, 0.003
FEW: dict[str, object] = {
    "reduction__modes": 8, "harmonic_balance__tolerance": None, "harmonic_balance__harmonics": 9,
}  # fmt: skip


@cache
def solid(**changed: object) -> fc.Scene:
    """The solid of ``new --solid`` near its resonance, with four elements on its crack."""
    scene = fc.Scene.load(ROOT / "fenics_crack" / "cli" / "new_solid.toml")
    given = {"mesh.error": False, "mesh.lip_elements": 4, "excitation.frequency": 611.5}
    return scene.replace(given | {key.replace("__", "."): value for key, value in changed.items()})


@cache
def whole(elements: int) -> fc.Study:
    """That solid with so many elements on its crack, not reduced."""
    return prepare(solid(mesh__lip_elements=elements), MPI.COMM_SELF, whole=True)


@pytest.mark.parametrize(
    ("elements", "limit"), [(3, 0.015), pytest.param(4, 0.002, marks=pytest.mark.nightly)]
)
def test_patches(elements: int, limit: float) -> None:
    """Rigid rotations, and uniform stresses that leave the free faces of the plate without loads,
    whose crack is pressed open by what they are: no K at any station."""
    study = whole(elements)
    structure = study.structure
    stations, rows, of_forces = make_tips_and_intensity_rows(study)
    radius = DEEP / elements  # about the domain's
    offsets = structure.nodes.points - np.array([0.015, 0.03, 0.006])
    restrict_to_free = structure.nodes.dolfinx_mesh_and_dofs.restrict_to_free
    for axis in np.eye(3):
        rotation_stress = rows @ restrict_to_free(np.cross(axis, offsets).ravel())
        assert np.abs(rotation_stress).max() < 0.015 * YOUNG * np.sqrt(radius)
    for first_axis, second_axis in ((0, 0), (1, 1), (0, 1)):
        stress = np.zeros((3, 3))
        stress[first_axis, second_axis] = stress[second_axis, first_axis] = STRESS
        strain = ((1.0 + POISSON) * stress - POISSON * np.trace(stress) * np.eye(3)) / YOUNG
        stress_values = rows @ restrict_to_free((offsets @ strain).ravel())
        stress_values -= stress[1, 1] * of_forces @ structure.pairs.areas
        kinds = stress_values.reshape(len(stations), 3).T[: 1 if first_axis != second_axis else 3]
        assert np.abs(kinds).max() < limit * STRESS * np.sqrt(np.pi * radius)
    assert structure.pairs.areas.sum() == pytest.approx(0.5 * np.pi * LONG * DEEP, rel=2e-3)


def test_lengths_of_a_circle() -> None:
    """Stations share a closed front's 2 pi r evenly."""
    angles = np.linspace(0.0, 2.0 * np.pi, 65)

    def curve(t: np.ndarray, order: int = 0) -> np.ndarray:
        turned_angle = t + 0.5 * np.pi * order
        return DEEP * np.stack([np.cos(turned_angle), 0.0 * t, np.sin(turned_angle)], axis=-1)

    normals = np.tile([0.0, 1.0, 0.0], (65, 1))
    no_ends = False, False
    front = Front("front", 0, curve(angles), normals, angles, curve, True, no_ends, DEEP)
    count = len(front.station_parameters)
    assert front.hat_integrals() == pytest.approx(
        2.0 * np.pi * DEEP / count * np.ones(count), rel=1e-12
    )


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
    offsets, restrict_to_free = (
        structure.nodes.points - [0.015, 0.03, 0.003],
        structure.nodes.dolfinx_mesh_and_dofs.restrict_to_free,
    )
    growth_direction, size = stations[0].growth_direction, np.sqrt(1.5e-3)
    pressed = of_forces[::3] @ structure.pair_areas
    for axis in np.eye(3):
        rotation_stress = rows @ restrict_to_free(np.cross(axis, offsets).ravel())
        assert np.abs(rotation_stress).max() < 1e-3 * YOUNG * size
    for first_axis, second_axis in combinations_with_replacement(range(3), 2):
        stress = np.zeros((3, 3))
        stress[first_axis, second_axis] = stress[second_axis, first_axis] = STRESS
        strain = ((1.0 + POISSON) * stress - POISSON * np.trace(stress) * np.eye(3)) / YOUNG
        stress_tensors = (rows @ restrict_to_free((offsets @ strain).ravel())).reshape(3, 3)
        on = stress[1]
        stress_tensors -= np.outer(
            pressed,
            [on[1], on @ growth_direction, on @ np.cross(growth_direction, [0.0, 1.0, 0.0])],
        )
        assert np.abs(stress_tensors[1]).max() < 1e-3 * STRESS * np.sqrt(np.pi) * size
        if second_axis != 2:
            assert np.abs(stress_tensors).max() < 1e-3 * STRESS * np.sqrt(np.pi) * size


@pytest.mark.nightly
def test_a_front_that_breathes(tmp_path: Path) -> None:
    """Closed for half of a period: what is computed then is small, and reported as zero; the crack
    opens alike on both sides of its middle, by less where it is deep."""
    stress_intensity = fc.stress_intensity(fc.solve(solid(**FEW, harmonic_balance__error=False)))
    assert stress_intensity.K_III is not None and len(stress_intensity.tip_names) == 13
    assert (
        0.0
        < stress_intensity.closed_front_errors.max()
        < 0.03 * stress_intensity.max_K_I_by_tip.max()
    )
    assert 0.3 < (stress_intensity.K_I.max(axis=1) == 0.0).mean() < 0.7
    assert stress_intensity.K_I.min() == 0.0
    assert stress_intensity.max_K_I_by_tip == pytest.approx(
        stress_intensity.max_K_I_by_tip[::-1], rel=0.02
    )
    assert stress_intensity.max_K_I_by_tip[6] < 0.8 * stress_intensity.max_K_I_by_tip[0]
    assert stress_intensity.growth_directions[6] == pytest.approx([0.0, 0.0, -1.0], abs=1e-6)
    assert stress_intensity.distances_along_crack[-1] == pytest.approx(
        18.176e-3, rel=1e-3
    )  # half of an ellipse
    assert (
        stress_intensity.tip_names[6]
        == f"the crack front at {stress_intensity.distances_along_crack[6] * 1e3:.4g} mm"
    )
    assert set(stress_intensity.numbers) >= {"K_max", "K_II_max", "K_III_max"}
    fc.write_fronts(stress_intensity, tmp_path / "fronts.vtu")
    front_grid = pyvista.read(tmp_path / "fronts.vtu")
    assert front_grid.n_cells == 12 and np.array_equal(
        front_grid["K_max"], stress_intensity.max_K_I_by_tip
    )
    panels = fc.draw_stress_intensity(stress_intensity).axes
    assert [len(panel.lines) for panel in panels] == [4, 4]  # zero, K_I, K_II, K_III


@pytest.mark.parametrize(
    "changes",
    [pytest.param({"mesh__lip_elements": 2}, marks=pytest.mark.nightly),
     {"crack__depth": None, "crack__front": None, "geometry__thickness": DEEP}],
)  # fmt: skip
def test_a_coarser_mesh_without_stress_intensity(changes: dict[str, object]) -> None:
    """Its elements are too long for them, or its front so short that K is a mean: their errors
    alone are unknown."""
    quantities = ("amplitude", "delta_K_effective")
    few = solid(mesh__error=True, output__quantities=quantities, **FEW, **changes)
    errors = fc.solve(few, MPI.COMM_SELF).errors
    assert errors is not None and not errors.unknown
    assert 0.01 < errors.stated("amplitude")[0] < 1.0
    assert errors.stated("delta_K_effective") == (np.inf, "mesh")
    assert "use a finer mesh" in errors.doubt("delta_K_effective")


@pytest.mark.nightly
def test_a_front_that_is_held_open() -> None:
    """By a pull, and bent so that it is most so at the deepest place, where the load changes it the
    least: K_max is that of the front, and the error of the range is not that of the mean."""
    quantities = ("K_max", "delta_K_effective")
    pulled = solid(
        mesh__lip_elements=3, mesh__error=True, output__quantities=quantities, crack__length=0.008,
        contact__friction_error=False, excitation__frequency=400.0,
        excitation__force_mean=(0.0, 1e3, 5.0), excitation__point=(0.015, 0.09, 0.003), **FEW,
    )  # fmt: skip
    run = fc.solve(pulled, MPI.COMM_SELF)
    stress_intensity, errors = fc.stress_intensity(run), run.errors
    assert errors is not None and stress_intensity.min_K_I_by_tip.min() > 0.0
    assert (
        stress_intensity.max_K_I_by_tip.max()
        > 1.02 * stress_intensity.max_K_I_by_tip[stress_intensity.leading_tip_index]
    )
    assert errors.values["K_max"] == pytest.approx(stress_intensity.max_K_I_by_tip.max(), rel=1e-12)
    assert errors.values["delta_K_effective"] == pytest.approx(
        stress_intensity.effective.max(), rel=1e-12
    )
    mesh_parts = [errors.contributions(name)["mesh"] for name in quantities]
    assert 0.0 < mesh_parts[1] < 0.1 * mesh_parts[0]
    assert errors.stated("delta_K_effective")[0] < 0.5


@pytest.mark.nightly
def test_modes() -> None:
    """Modes enough: forty as twenty."""
    few_modes_result, many_modes_result = (
        fc.stress_intensity(
            fc.solve(solid(reduction__method="massless", reduction__modes=modes), MPI.COMM_SELF)
        ).max_K_I_by_tip
        for modes in (20, 40)
    )
    assert few_modes_result == pytest.approx(many_modes_result, rel=1e-3)


@pytest.mark.nightly
def test_cells_in_another_order() -> None:
    """The numbers of cells, which differ from run to run on several ranks, do not matter."""
    scene, structure = solid(mesh__lip_elements=3), whole(3).structure
    nodes = replace(structure.nodes, cells=structure.nodes.cells[::-1])
    turned_structure = structure._in_setting(structure.load_damping_clearance_changes, nodes=nodes)
    _, rows, _ = front_functionals(scene, structure)
    _, other_functionals, _ = front_functionals(scene, turned_structure)
    np.testing.assert_allclose(other_functionals, rows, rtol=0.0, atol=1e-9 * np.abs(rows).max())


def test_linear_intensity_is_exact_at_the_ends_of_a_front() -> None:
    """Means of K = 2 + 3 s over hats on stations one apart are K at the stations, but at the ends,
    where half a hat has its centroid a third of an element inside."""
    stations = np.arange(4.0)
    intensities = np.stack([2.0 + 3.0 * stations, 5.0 - stations, 0.5 * stations])
    means = intensities.copy()
    means[:, 0] += (intensities[:, 1] - intensities[:, 0]) / 3.0
    means[:, -1] += (intensities[:, -2] - intensities[:, -1]) / 3.0
    front = SimpleNamespace(station_parameters=stations, is_closed=False)
    rows = _rows_by_station(front, means.reshape(-1, 1))  # type: ignore[arg-type]
    assert np.allclose(rows[..., 0], intensities.T, rtol=1e-12, atol=1e-12)
